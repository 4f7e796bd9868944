# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear algebra in a fixed order: agreement with SciPy, closed forms, and errors if there is no solution."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hysteresis_ros.models import linear_algebra as la

ENTRIES = st.integers(-1000, 1000).map(lambda value: value / 256.0)


@st.composite
def square(draw, largest: int = 6):
    n = draw(st.integers(1, largest))
    return draw(arrays(float, (n, n), elements=ENTRIES))


def close(found, expected, relative=1e-10) -> bool:
    """Return whether two arrays agree to a fraction of the largest entry."""
    return np.max(np.abs(found - expected), initial=0.0) <= relative * max(
        np.max(np.abs(expected), initial=0.0), 1e-300
    )


@pytest.mark.slow
@given(A=square(), vector=st.randoms(use_true_random=False))
def test_products_are_those_of_matmul_in_every_shape(A, vector):
    v = np.array([vector.uniform(-1.0, 1.0) for _ in A])
    for factors in ((A, A), (A, v), (v, A), (v, v), (A, v[:, None]), (v[None], A, A, v)):
        expected = factors[0]
        for factor in factors[1:]:
            expected = expected @ factor
        found = la.product(*factors)
        assert found.shape == np.shape(expected)
        assert np.abs(found - expected).max() <= 1e-12 * (1.0 + np.abs(A).max()) ** 2 * len(A)


def test_a_sum_runs_in_the_order_of_its_index():
    # 1 + 2⁻⁵³ is 1, 2⁻⁵³ + 2⁻⁵³ + 1 is more: another order, or a fused operation, would give another number
    tiny = 2.0**-53
    assert la.product([1.0, tiny, tiny], [1.0, 1.0, 1.0]) == 1.0
    assert la.product([tiny, tiny, 1.0], [1.0, 1.0, 1.0]) == 1.0 + 2.0**-52
    factor = 1.0 + 2.0**-30
    assert la.product([-1.0, factor], [factor * factor, factor]) == 0.0


@pytest.mark.slow
@given(A=square())
def test_solutions_are_those_of_scipy(A):
    assume(np.linalg.cond(A) < 1e4)
    right = np.arange(1.0, 2.0 * len(A) + 1.0).reshape(len(A), 2)
    assert close(la.solve(A, right), scipy.linalg.solve(A, right))
    assert close(la.solve(A, right[:, 0]), scipy.linalg.solve(A, right[:, 0]))
    assert close(la.inverse(A), scipy.linalg.inv(A))


@pytest.mark.slow
@given(A=square())
def test_exponentials_are_those_of_scipy(A):
    assert close(la.exponential(A), scipy.linalg.expm(A))


def test_exponential_of_a_rotation_and_of_nothing():
    angle = 40.0
    rotation = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    assert la.exponential([[0.0, angle], [-angle, 0.0]]) == pytest.approx(np.array(rotation), abs=1e-13)
    assert np.array_equal(la.exponential(np.zeros((3, 3))), np.eye(3))
    assert la.exponential(np.zeros((0, 0))).shape == (0, 0)


def distance(found, expected) -> float:
    """Return the largest distance of an eigenvalue of either array to the nearest one of the other."""
    gaps = np.abs(found[:, None] - expected[None])
    return max(gaps.min(axis=0).max(), gaps.min(axis=1).max())


@pytest.mark.slow
@given(A=square(largest=9), spread=st.integers(0, 20))
def test_eigenvalues_are_those_of_lapack_or_those_of_a_neighbour(A, spread):
    scale = 2.0 ** np.linspace(0, spread, len(A)).round()
    A = A * scale / scale[:, None]
    found = la.eigenvalues(A)
    assert len(found) == len(A)
    assert sorted(found.conj(), key=lambda z: (z.real, z.imag)) == sorted(found, key=lambda z: (z.real, z.imag))
    # A defective eigenvalue of multiplicity k changes by the k-th root of a rounding error; then the characteristic
    # polynomials are compared.
    expected = np.linalg.eigvals(A)
    size = max(np.abs(expected).max(), np.abs(A / scale * scale[:, None]).max(), 1e-300)
    if distance(found, expected) > 1e-10 * size:
        assert close(la.polynomial(found / size), np.real(np.poly(expected / size)), 1e-10)


def test_eigenvalues_of_permutations_triangles_and_nothing():
    for n in range(1, 9):
        roots = np.exp(2j * np.pi * np.arange(n) / n)
        assert distance(la.eigenvalues(np.roll(np.eye(n), 1, axis=0)), roots) < 1e-12
    assert sorted(la.eigenvalues(np.triu(np.ones((4, 4)), 1) + np.diag([1.0, 2.0, 3.0, 4.0])).real) == [1, 2, 3, 4]
    assert la.eigenvalues(np.zeros((0, 0))).size == 0
    assert np.array_equal(la.eigenvalues(np.zeros((3, 3))), np.zeros(3))
    with pytest.raises(np.linalg.LinAlgError):
        la.eigenvalues(np.full((4, 4), np.nan))


@given(st.lists(st.tuples(ENTRIES, ENTRIES), max_size=4))
def test_polynomials_of_roots_are_those_of_numpy(parts):
    roots = [root for re, im in parts for root in ((complex(re, im), complex(re, -im)) if im else (complex(re),))]
    assert close(la.polynomial(roots), np.real(np.atleast_1d(np.poly(roots))), 1e-12)


@st.composite
def regulator_problem(draw):
    """A, B, Q and R with a well-conditioned solution, in state units that differ by powers of ten."""
    A = draw(square())
    n = len(A)
    radius = np.max(np.abs(np.linalg.eigvals(A)))
    assume(radius > 1e-2)
    A = A / radius * draw(st.floats(0.1, 1.3))
    B = draw(arrays(float, (n, 1), elements=ENTRIES))
    assume(np.linalg.cond(np.column_stack([np.linalg.matrix_power(A, k) @ B for k in range(n)])) < 1e3)
    root = draw(arrays(float, (n, n), elements=ENTRIES))
    units = 10.0 ** draw(arrays(float, n, elements=st.floats(-2.0, 2.0)))
    Q = (root @ root.T + 1e-3 * np.eye(n)) * units * units[:, None]
    return A * units / units[:, None], B / units[:, None], Q, np.array([[10.0 ** draw(st.floats(-4.0, 4.0))]])


@pytest.mark.slow
@settings(deadline=None)
@given(problem=regulator_problem())
def test_riccati_solutions_are_those_of_scipy(problem):
    A, B, Q, R = problem
    expected = scipy.linalg.solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ expected @ B, B.T @ expected @ A)
    assume(np.max(np.abs(np.linalg.eigvals(A - B @ K))) < 0.99)  # a slow closed loop amplifies SciPy's rounding errors
    P = la.riccati(A, B, Q, R)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))  # of each entry in its own units

    def unsolved(P) -> float:
        """Return the residual of the equation for a solution."""
        gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        return np.max(np.abs(A.T @ P @ A - P - A.T @ P @ B @ gain + Q) / size)

    assert unsolved(P) < 1e-11
    # SciPy's residual is up to 1e-8 if weights differ by many decades, and so is its distance from the solution
    assert np.max(np.abs(P - expected) / size) < 1e-10 + 1e3 * unsolved(expected)
    assert np.array_equal(P, P.T)


@pytest.mark.parametrize("coupling", [1e-300, 5e-324])
def test_riccati_with_a_coupling_that_is_next_to_nothing(coupling):
    A, B, Q, R = np.array([[0.5, 1.0], [coupling, 0.3]]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1)
    assert la.riccati(A, B, Q, R) == pytest.approx(scipy.linalg.solve_discrete_are(A, B, Q, R), rel=1e-12)


def test_riccati_of_one_state_is_the_positive_root():
    a, b, q, r = 1.2, 0.5, 2.0, 3.0
    # b² P² + (r (1 - a²) - b² q) P - q r = 0
    middle = r * (1.0 - a * a) - b * b * q
    root = (-middle + np.sqrt(middle * middle + 4.0 * b * b * q * r)) / (2.0 * b * b)
    assert la.riccati(a, b, q, r).item() == pytest.approx(root, rel=1e-14)


def test_riccati_of_a_loop_that_hardly_decays():
    # an undamped oscillator with a large weight on its input: closed-loop poles at 1 - 1e-6
    A, B, Q, R = np.array([[0.0, 0.4], [2.5, 0.0]]), np.array([[0.0], [2.0**-8]]), 1e-3 * np.eye(2), np.eye(1) * 10.0
    P = la.riccati(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    assert np.max(np.abs(A.T @ P @ (A - B @ K) + Q - P)) < 1e-13 * np.max(np.abs(P))
    assert 0.999 < np.max(np.abs(np.linalg.eigvals(A - B @ K))) < 1.0


def test_riccati_without_weight_or_input_costs_what_must_be():
    assert la.riccati(0.5, 1.0, 0.0, 1.0).item() == 0.0
    assert la.riccati(0.5, 0.0, 3.0, 1.0).item() == pytest.approx(4.0, rel=1e-15)
    with pytest.raises(np.linalg.LinAlgError):
        la.riccati(1.1, 0.0, 1.0, 1.0)  # an unstable mode without input
    with pytest.raises(np.linalg.LinAlgError):
        la.riccati(np.nan, 1.0, 1.0, 1.0)


def test_singular_matrices_are_refused():
    for matrix in (np.zeros((2, 2)), [[1.0, 2.0], [2.0, 4.0]]):
        with pytest.raises(np.linalg.LinAlgError):
            la.solve(matrix, np.ones(2))
