# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""State feedback and steady Kalman gains from a discrete linear model: pole placement, Riccati equations, checks.

All quantities are in the model's own units (see ``input_scale`` and ``output_scale`` of the linear model), so that
published matrices give the published gains. Shapes: A (n, n), B (n, 1), C (1, n), D (1, 1). Gains are computed in a
fixed order (:mod:`hysteresis_ros.models.linear_algebra`), so that they are identical on every processor; only the
checks that refuse a design (rank, stability) use LAPACK.

A measurement is taken just before the input of its sample changes: ``y_k = C x_k + D u_(k-1)``.

References
----------
.. [1] Kim, Kim & Park 2009, eqs 6-15 (eq. 9 prints S B instead of S A).
.. [2] Utkin, Sliding Modes in Control and Optimization, 1992 (hyperplanes from Ackermann's formula and from LQ).
.. [3] Anderson & Moore, Optimal Filtering, 1979, chapter 4 (predictor and filter gain).
"""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear import BOUNDARY, StateSpace
from hysteresis_ros.models.linear_algebra import polynomial, product, riccati, solve

#: Relative size below which a singular value counts as zero.
RANK_TOLERANCE = 1e-10


def refuse(name: str, value, remedy: str) -> NoReturn:
    """Raise a ParameterError about the parameter that makes a design impossible.

    Raises
    ------
    ParameterError
        Always; the message contains the name of the parameter, its value and what is allowed.
    """
    raise ParameterError([Problem(name, value, remedy)])


def _equilibrated(matrix):
    """Scale first the rows and then the columns to length 1, so that the numerical rank does not depend on units."""
    for axis in (1, 0):
        length = np.linalg.norm(matrix, axis=axis, keepdims=True)
        matrix = matrix / np.where(length > 0.0, length, 1.0)
    return matrix


def full_rank(matrix) -> bool:
    """Return whether the columns of a matrix are independent, whatever their units."""
    singular = np.linalg.svd(_equilibrated(matrix), compute_uv=False)
    return bool(singular[-1] > RANK_TOLERANCE * singular[0])


def detectable(A, C) -> bool:
    """Return whether every mode of A on or outside the unit circle is observable by C (Popov-Belevitch-Hautus test)."""
    identity = np.eye(len(A))
    return all(
        full_rank(np.vstack([A - value * identity, C]))
        for value in np.linalg.eigvals(A)
        if abs(value) >= 1.0 - BOUNDARY
    )


def stabilisable(A, B) -> bool:
    """Return whether every mode of A on or outside the unit circle is controllable by B."""
    return detectable(A.T, B.T)


def spectral_radius(A) -> float:
    """Return the largest magnitude of the eigenvalues of A."""
    return float(np.max(np.abs(np.linalg.eigvals(A))))


def require_stable(A, name: str, value, what: str) -> None:
    """Refuse a closed loop, or the error dynamics of an estimator, with an unstable state matrix ``A``.

    Raises
    ------
    ParameterError
        ``name``: an eigenvalue of ``A`` is on or outside the unit circle.
    """
    radius = spectral_radius(A)
    if not radius < 1.0 - BOUNDARY:
        refuse(
            name, value, f"makes {what} unstable (largest eigenvalue {radius:.6g}); it must be inside the unit circle"
        )


def steady_state(model: StateSpace):
    """Return N_x and N_u of the rest point for the output r: ``x_r = N_x r``, ``u_r = N_u r``.

    Parameters
    ----------
    model : StateSpace
        Model with one input and one output.

    Returns
    -------
    N_x : ndarray, shape (n,)
    N_u : float

    Raises
    ------
    ParameterError
        ``model.dynamics.C``: the DC gain of the model is zero, so that no input can hold a displacement.
    """
    n = model.order
    system = np.block([[model.A - np.eye(n), model.B], [model.C, model.D]])
    if not full_rank(system):
        refuse(
            "model.dynamics.C",
            tuple(model.C[0].tolist()),
            "the DC gain of the model is zero, so no command holds a displacement; give a model with another DC gain",
        )
    solution = solve(system, np.append(np.zeros(n), 1.0))
    return solution[:n], float(solution[n])


def integral_system(model: StateSpace) -> StateSpace:
    """Append the integral z of the tracking error, z_k = z_(k-1) + r_k - y_k, to the model.

    Because y_k = C x_k + D u_(k-1), z_k includes the error of the present sample: z_(k+1) = z_k - C A x_k - (C B + D)
    u_k + r. The returned system describes deviations from the rest point.

    Parameters
    ----------
    model : StateSpace
        Model with n states, one input and one output.

    Returns
    -------
    StateSpace
        System with n + 1 states and the output of the model.
    """
    A, B, C, D = model.A, model.B, model.C, model.D
    whole = np.block([[A, np.zeros((model.order, 1))], [-product(C, A), np.eye(1)]])
    return StateSpace(whole, np.vstack([B, -(product(C, B) + D)]), np.hstack([C, np.zeros((1, 1))]), D)


def disturbance_system(model: StateSpace, A_d=None, c_d=None) -> StateSpace:
    """Append an input disturbance d (matched: B (u + d)) with the model w⁺ = A_d w, d = c_d w to the plant model.

    In y_k = C x_k + D (u_(k-1) + d_(k-1)), the feedthrough acts on the previous disturbance d_(k-1) = c_d A_d⁻¹ w_k.

    Parameters
    ----------
    model : StateSpace
        Model with n states, one input and one output.
    A_d, c_d : ndarray, shapes (m, m) and (m,), optional
        Model of the disturbance, with A_d invertible. By default the disturbance is constant.

    Returns
    -------
    StateSpace
        System with n + m states.
    """
    A, B, C, D = model.A, model.B, model.C, model.D
    A_d, c_d = (np.eye(1), np.ones(1)) if A_d is None else (A_d, c_d)
    none = np.zeros((len(A_d), 1))
    whole = np.block([[A, B * c_d], [np.zeros((len(A_d), model.order)), A_d]])
    return StateSpace(whole, np.vstack([B, none]), np.hstack([C, D * solve(A_d.T, c_d)]), D)


def sliding_gain(A, B, S, phi: float):
    """Return the linear gain K = Λ⁻¹ (S A − Φ S) and Λ = S B of the control law u = −K x [1]_.

    Without the nonlinear part the switching function obeys s⁺ = Φ s exactly.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n,)
        Model x⁺ = A x + B u.
    S : ndarray, shape (n,)
        Hyperplane s = S x.
    phi : float
        Φ of the reaching law.

    Returns
    -------
    K : ndarray, shape (n,)
    switching_gain : float
        Λ.

    Raises
    ------
    ParameterError
        ``sliding_mode.S``: S B is zero, or the closed loop A − B K is unstable.
    """
    S = np.asarray(S, dtype=float)
    given = tuple(S.tolist())
    switching_gain = product(S, B).item()
    if not abs(switching_gain) > RANK_TOLERANCE * np.linalg.norm(S) * np.linalg.norm(B):
        refuse(
            "sliding_mode.S",
            given,
            "S B is zero, so the input does not affect the switching function; choose another S",
        )
    K = (product(S, A) - phi * S) / switching_gain
    require_stable(A - B @ K[np.newaxis], "sliding_mode.S", given, f"the controlled model (phi = {phi:g})")
    return K, switching_gain


def hyperplane_from_poles(A, B, poles):
    """Return S with S B = 1 for which the sliding motion has the given poles, by Ackermann's formula after Utkin [2]_.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n, 1)
        Model x⁺ = A x + B u.
    poles : array_like, shape (n - 1,)
        Discrete poles; complex poles are in conjugate pairs. The n-th pole of the closed loop is Φ.

    Returns
    -------
    S : ndarray, shape (n,)

    Raises
    ------
    ParameterError
        ``model.dynamics.B``: the model is not controllable.
    """
    n = len(A)
    columns = [B[:, 0]]
    for _ in range(n - 1):
        columns.append(product(A, columns[-1]))
    controllability = np.column_stack(columns)
    if not full_rank(controllability):
        refuse(
            "model.dynamics.B",
            tuple(B[:, 0].tolist()),
            "the model is not controllable, so poles cannot be placed; set sliding_mode.hyperplane to lq",
        )
    S = solve(controllability.T, np.eye(n)[-1])
    result = np.zeros(n)
    for coefficient in polynomial(poles):
        result = product(result, A) + coefficient * S
    return result


def hyperplane_lq(A, B, state_weight, input_weight: float):
    """Return S = Bᵀ P, scaled to S B = 1, where P solves the LQ problem Σ xᵀ Q x + R u² [2]_.

    The sliding motion A_s = (I − B S) A is always stable, because P − A_sᵀ P A_s ≥ Q. For R → 0 and Φ = 0 the linear
    gain is equal to the LQ gain.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n, 1)
        Model x⁺ = A x + B u.
    state_weight : ndarray, shape (n, n)
        Q, symmetric, positive semidefinite.
    input_weight : float
        R > 0.

    Returns
    -------
    S : ndarray, shape (n,)

    Raises
    ------
    ParameterError
        ``model.dynamics.B``: the model is not stabilisable. ``sliding_mode.lq_state_weight``: an unstable mode has no
        weight.
    """
    given = tuple(np.diag(state_weight).tolist())
    if not stabilisable(A, B):
        refuse(
            "model.dynamics.B",
            tuple(B[:, 0].tolist()),
            "the input cannot control an unstable mode; give a model in which it can",
        )
    if not detectable(A, state_weight):
        refuse(
            "sliding_mode.lq_state_weight",
            given,
            "every mode that does not decay must have a weight above 0; one has weight 0",
        )
    P = _riccati(A, B, state_weight, input_weight, "sliding_mode.lq_state_weight", given)
    S = product(B.T, P)[0]
    scale = product(S, B).item()
    if not scale > 0.0:
        refuse(
            "sliding_mode.lq_state_weight",
            given,
            "must weight states that the input affects, such as the output; the input has no effect on this cost",
        )
    return S / scale


def kalman_gain(A, C, process_noise, measurement_noise: float):
    """Return the steady gain P Cᵀ (r + C P Cᵀ)⁻¹ and P of the Kalman filter [1]_ (eqs 13-15).

    This is the gain of the current (filter) form. The predictor form, which [1]_ prints, has A times this gain. P is
    the solution of P = A P Aᵀ − A P Cᵀ (r + C P Cᵀ)⁻¹ C P Aᵀ + Q [3]_ (the paper prints L Q Lᵀ for Q).

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (1, n)
        Model x⁺ = A x, y = C x.
    process_noise : ndarray, shape (n, n)
        Q, symmetric, positive semidefinite.
    measurement_noise : float
        r > 0.

    Returns
    -------
    gain : ndarray, shape (n,)
    P : ndarray, shape (n, n)
        Covariance of the prediction error.

    Raises
    ------
    ParameterError
        ``model.dynamics.C`` or ``kalman.q``: there is no stable filter.
    """
    if not detectable(A, C):
        refuse(
            "model.dynamics.C",
            tuple(C[0].tolist()),
            "a mode that does not decay is not observable in the output; give a model in which it is",
        )
    given = tuple(np.diag(process_noise).tolist())
    P = _riccati(A.T, C.T, process_noise, measurement_noise, "kalman.q", given)
    gain = product(P, C[0]) / (measurement_noise + product(C, P, C.T).item())
    require_stable(A - np.outer(product(A, gain), C[0]), "kalman.q", given, "the Kalman filter")
    return gain, P


def _riccati(A, B, Q, R, name, value):
    try:
        # divided by R, so that the result does not depend on the units of Q and R
        P = riccati(A, B, Q / R, np.eye(1)) * R
    except np.linalg.LinAlgError as error:
        refuse(name, value, f"the Riccati equation has no stabilising solution ({error}); change the weights")
    return P


def square_weight(values, n: int, name: str):
    """Return an (n, n) weight from its n diagonal entries or from its n² entries row by row.

    ParameterError about ``name``: the number of entries is wrong, or the weight is not symmetric or not positive
    semidefinite.
    """
    if len(values) == n and n != 1:
        weight = np.diag(np.array(values, dtype=float))
    elif len(values) == n * n:
        weight = np.array(values, dtype=float).reshape(n, n)
    else:
        refuse(name, values, f"must have {n} entries (diagonal) or {n * n} (rows of a matrix)")
    largest = np.max(np.abs(weight))
    symmetric = np.max(np.abs(weight - weight.T)) <= RANK_TOLERANCE * largest
    if not symmetric or np.linalg.eigvalsh(weight)[0] < -RANK_TOLERANCE * largest:
        refuse(name, values, "must be symmetric and positive semidefinite")
    return 0.5 * (weight + weight.T)
