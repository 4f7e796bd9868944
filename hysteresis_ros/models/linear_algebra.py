# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dense linear algebra of small matrices, with identical results on every processor.

BLAS and LAPACK choose their kernels by the type of processor. Sums then have another order, or use fused multiply-add,
so that the last digit differs. Numbers that a running axis uses (gains, steady states, input scales, inverse filters)
are therefore computed here. Every step is one addition, subtraction, multiplication, division or square root of
float64, rounded correctly by IEEE 754; the order of the steps depends only on the sizes. NumPy's elementwise operations
consist of such steps for any vector length; ``@``, ``np.dot``, ``np.einsum`` and ``np.linalg`` do not.

Rank, stability and printed figures may use ``np.linalg``, because the numbers of a running axis do not depend on them.

References
----------
.. [1] Golub & Van Loan, Matrix Computations, 4th ed. 2013, sections 3.4 (elimination) and 7.5 (double-shift QR).
.. [2] Chu, Fan, Lin & Wang, Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations,
   Int. J. Control 77 (2004) 767-788, doi:10.1080/00207170410001714988 (doubling).
.. [3] Higham, The scaling and squaring method for the matrix exponential revisited, SIAM J. Matrix Anal. Appl. 26
   (2005) 1179-1193, doi:10.1137/04061101X.
"""

from __future__ import annotations

import math

import numpy as np

#: Newton steps of a Riccati solution have converged if the relative change is below NEWTON_CHANGE, or if it is below
#: LARGEST_NEWTON_CHANGE and no longer decreases (a slow closed loop multiplies rounding errors). NEWTON_STEPS is the
#: maximum number of steps.
NEWTON_CHANGE = 1e-13
LARGEST_NEWTON_CHANGE = 1e-8
NEWTON_STEPS = 12
#: A Riccati iteration has failed after this number of doublings, which corresponds to 2^60 samples of the closed loop.
DOUBLINGS = 60
#: The search for eigenvalues has failed if one eigenvalue needs more than this number of QR steps.
QR_STEPS = 60
EPSILON = 2.0**-52
#: In balancing, entries smaller than this fraction of the largest entry are ignored.
NEGLIGIBLE = 2.0**-100
#: Significant digits of :func:`rounded`.
DIGITS = 13
#: Coefficients of the diagonal Padé approximant of exp of degree 13 [3]_, and the norm up to which it is accurate.
PADE = tuple(
    math.factorial(26 - k) * math.factorial(13) // (math.factorial(k) * math.factorial(13 - k)) for k in range(14)
)
PADE_NORM = 4.0


def product(*factors) -> np.ndarray:
    """Return the matrix product of all factors, from left to right; each sum is computed in the order of its index.

    Parameters
    ----------
    *factors : array_like, shapes (n, m) or (m,)
        Factors as for ``@``.
    """
    result = np.asarray(factors[0], dtype=float)
    for factor in factors[1:]:
        factor = np.asarray(factor, dtype=float)
        rows, columns = np.atleast_2d(result), factor if factor.ndim == 2 else factor[:, np.newaxis]
        total = np.zeros((len(rows), columns.shape[1]))
        for k in range(len(columns)):
            total += rows[:, k, np.newaxis] * columns[k]
        result = total.reshape(result.shape[:-1] + factor.shape[1:])
    return result


def solve(matrix, right) -> np.ndarray:
    """Return x of ``matrix x = right`` by Gaussian elimination with partial pivoting [1]_.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    upper, given = np.array(matrix, dtype=float), np.array(right, dtype=float)
    n = len(upper)
    x = given if given.ndim == 2 else given[:, np.newaxis]  # a copy, which is changed in place
    for j in range(n):
        pivot = j + int(np.argmax(np.abs(upper[j:, j])))
        if not abs(upper[pivot, j]) > 0.0:
            raise np.linalg.LinAlgError("Singular matrix")
        if pivot != j:
            upper[[j, pivot]], x[[j, pivot]] = upper[[pivot, j]], x[[pivot, j]]
        factors = (upper[j + 1 :, j] / upper[j, j])[:, np.newaxis]
        upper[j + 1 :] -= factors * upper[j]
        x[j + 1 :] -= factors * x[j]
    for j in reversed(range(n)):
        x[j] /= upper[j, j]
        x[:j] -= upper[:j, j, np.newaxis] * x[j]
    return given


def inverse(matrix) -> np.ndarray:
    """Return the inverse, shape (n, n).

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    return solve(matrix, np.eye(len(matrix)))


def power(matrix, exponent: int) -> np.ndarray:
    """Return ``matrix`` to the power ``exponent`` ≥ 0, by repeated multiplication."""
    result = np.eye(len(matrix))
    for _ in range(exponent):
        result = product(result, matrix)
    return result


def exponential(matrix) -> np.ndarray:
    """Return exp of a matrix, shape (n, n): Padé approximant of degree 13 with scaling and squaring [3]_."""
    matrix = np.asarray(matrix, dtype=float)
    size = max((math.fsum(row) for row in np.abs(matrix).tolist()), default=0.0)
    squarings = max(0, math.frexp(size / PADE_NORM)[1]) if math.isfinite(size) else 0
    scaled = matrix * 2.0**-squarings
    term, even, odd = np.eye(len(matrix)), np.zeros(matrix.shape), np.zeros(matrix.shape)
    for k, coefficient in enumerate(PADE):
        part = even if k % 2 == 0 else odd
        part += (coefficient / PADE[0]) * term
        term = product(term, scaled)
    result = solve(even - odd, even + odd)
    for _ in range(squarings):
        result = product(result, result)
    return result


def polynomial(roots) -> np.ndarray:
    """Return the real coefficients of Π (z - root), with the highest power first, shape (n + 1,).

    Parameters
    ----------
    roots : sequence of complex, shape (n,)
        Roots, complex ones in conjugate pairs, in any order.
    """
    coefficients = np.ones(1)
    for root in map(complex, roots):
        if root.imag < 0.0:
            continue  # the conjugate root represents both
        pair = (-2.0 * root.real, root.real * root.real + root.imag * root.imag)
        factor = pair if root.imag > 0.0 else (-root.real,)
        longer = np.append(coefficients, np.zeros(len(factor)))
        for shift, value in enumerate(factor, 1):
            longer[shift : shift + len(coefficients)] += value * coefficients
        coefficients = longer
    return coefficients


def rounded(values) -> np.ndarray:
    """Return an array rounded to :data:`DIGITS` significant digits, for results of LAPACK or of the C library."""
    values = np.asarray(values, dtype=float)
    return np.array([float(f"{value:.{DIGITS}g}") for value in values.ravel()]).reshape(values.shape)


def balance(matrix) -> np.ndarray:
    """Return powers of two t, shape (n,), for which rows and columns of ``matrix[i, j] t[j] / t[i]`` are balanced."""
    size, scale = np.abs(np.array(matrix, dtype=float)), np.ones(len(matrix))
    np.fill_diagonal(size, 0.0)
    size[size < NEGLIGIBLE * np.max(size, initial=0.0)] = 0.0  # balancing these would need powers that overflow
    for _ in range(20):
        before = scale.copy()
        for i in range(len(size)):
            column, row = float(np.max(size[:, i])), float(np.max(size[i]))
            if column > 0.0 and row > 0.0:
                factor = 2.0 ** ((math.frexp(row)[1] - math.frexp(column)[1]) // 2)
                size[:, i] *= factor
                size[i] /= factor
                scale[i] *= factor
        if np.array_equal(before, scale):
            break
    return scale


def riccati(A, B, Q, R) -> np.ndarray:
    """Return the stabilising P of P = Aᵀ P A − Aᵀ P B (R + Bᵀ P B)⁻¹ Bᵀ P A + Q by structure-preserving doubling [2]_.

    Newton steps refine the solution until they converge, which also verifies the residual.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    Q : array_like, shape (n, n)
        Symmetric, positive semidefinite.
    R : array_like, shape (m, m)
        Symmetric, positive definite.

    Raises
    ------
    numpy.linalg.LinAlgError
        No stabilising solution was found.
    """
    A, B, Q, R = (np.array(matrix, dtype=float, ndmin=2) for matrix in (A, B, Q, R))
    scale = balance(A)  # x = T z: exact, since T are powers of two
    A, B = A * scale / scale[:, np.newaxis], B / scale[:, np.newaxis]
    Q = _symmetric(Q) * scale * scale[:, np.newaxis]
    transition, control, P = A, product(B, solve(R, B.T)), Q
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            both = np.hstack([transition, control])
            both = solve(np.eye(len(A)) + product(control, P), both)
            onward, spread = both[:, : len(A)], both[:, len(A) :]
            following = P + _symmetric(product(transition.T, P, onward))
            control = control + _symmetric(product(transition, spread, transition.T))
            transition = product(transition, onward)
            if not np.all(np.isfinite(following)):
                raise np.linalg.LinAlgError("the iteration diverges")
            settled = np.max(np.abs(following - P)) <= EPSILON * np.max(np.abs(P))
            P = following
            if settled:
                break
        else:
            raise np.linalg.LinAlgError("the iteration does not converge")
    P = _refined(A, B, Q, R, P)
    return P / scale / scale[:, np.newaxis]


def _symmetric(matrix):
    return 0.5 * (matrix + matrix.T)


def _feedback(A, B, R, P):
    return solve(R + product(B.T, P, B), product(B.T, P, A))


def _refined(A, B, Q, R, P):
    """Return P after Newton steps: P of each step is the cost of the feedback from the previous P, summed by doubling.

    Doubling alone loses digits if the input weight is small.
    """
    last = math.inf
    for _ in range(NEWTON_STEPS):
        K = _feedback(A, B, R, P)
        closed, cost = A - product(B, K), Q + _symmetric(product(K.T, R, K))
        for _ in range(DOUBLINGS):
            more = _symmetric(product(closed.T, cost, closed))
            cost = cost + more
            closed = product(closed, closed)
            if not np.max(np.abs(more)) > EPSILON * np.max(np.abs(cost)):
                break
        change, P = np.max(np.abs(cost - P)), cost
        size = np.max(np.abs(P))
        if change <= NEWTON_CHANGE * size or last <= change <= LARGEST_NEWTON_CHANGE * size:
            return P
        last = change
    raise np.linalg.LinAlgError("the solution does not stabilise")


def eigenvalues(matrix) -> np.ndarray:
    """Return the eigenvalues, shape (n,), of a real matrix by double-shift QR steps [1]_, in exact conjugate pairs.

    Raises
    ------
    numpy.linalg.LinAlgError
        The iteration does not converge, for example because an entry is not finite.
    """
    scale = balance(matrix)
    H = np.array(matrix, dtype=float) * scale / scale[:, np.newaxis]
    _to_hessenberg(H, 0)
    size = float(np.max(np.abs(H), initial=0.0))
    found, end, steps = [], len(H), 0
    while end:
        start = end - 1
        while start:
            beside = abs(H[start - 1, start - 1]) + abs(H[start, start])
            if abs(H[start, start - 1]) <= EPSILON * (beside if beside > 0.0 else size):
                break
            start -= 1
        if end - start <= 2:
            found += [complex(H[start, start])] if end - start == 1 else _pair(H[start:end, start:end].tolist())
            end, steps = start, 0
            continue
        steps += 1
        if steps > QR_STEPS:
            raise np.linalg.LinAlgError("the eigenvalues do not converge")
        _qr_step(H[start:end, start:end], exceptional=steps % 10 == 0)
    return np.array(found[::-1], dtype=complex)


def _pair(block) -> list[complex]:
    """Return the two eigenvalues of a 2 × 2 matrix."""
    (a, b), (c, d) = block
    half, product_of_outer = 0.5 * (a - d), b * c
    discriminant = half * half + product_of_outer
    if discriminant < 0.0:
        middle, root = 0.5 * (a + d), math.sqrt(-discriminant)
        return [complex(middle, -root), complex(middle, root)]
    far = half + math.copysign(math.sqrt(discriminant), half)
    return [complex(d - product_of_outer / far if far != 0.0 else d), complex(d + far)]


def _qr_step(H, exceptional: bool) -> None:
    """Do one double-shift QR step on an unreduced Hessenberg matrix of at least three rows, in place."""
    if exceptional:
        corner = abs(H[-1, -2]) + abs(H[-2, -3])
        total, determinant = 1.5 * corner, corner * corner
    else:
        total = H[-2, -2] + H[-1, -1]
        determinant = H[-2, -2] * H[-1, -1] - H[-2, -1] * H[-1, -2]
    first = np.array(
        [
            H[0, 0] * (H[0, 0] - total) + determinant + H[0, 1] * H[1, 0],
            H[1, 0] * (H[0, 0] + H[1, 1] - total),
            H[1, 0] * H[2, 1],
        ]
    )
    _reflect(H, first, 0)
    _to_hessenberg(H, 3)


def _to_hessenberg(H, width: int) -> None:
    """Transform a matrix to Hessenberg form in place; ``width`` > 0 is its number of subdiagonals that are not zero."""
    for j in range(len(H) - 2):
        last = len(H) if not width else min(len(H), j + 1 + width)
        _reflect(H, H[j + 1 : last, j].copy(), j + 1)
        H[j + 2 :, j] = 0.0


def _reflect(H, vector, first: int) -> None:
    """Apply the Householder reflection of ``vector`` (rows from ``first``) onto its first axis, from both sides."""
    largest = float(np.max(np.abs(vector)))
    if not largest > 0.0:
        return
    vector = vector / largest
    length = math.sqrt(product(vector, vector))
    vector[0] += math.copysign(length, vector[0])
    direction = vector * (2.0 / product(vector, vector))
    rows = slice(first, first + len(vector))
    H[rows] -= vector[:, np.newaxis] * product(direction, H[rows])
    H[:, rows] -= product(H[:, rows], direction)[:, np.newaxis] * vector
