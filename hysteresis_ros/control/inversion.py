"""Stable inversion of linear dynamics (W6; Devasia, Chen & Paden 1996, doi:10.1109/9.508898, in discrete time).

Dynamics x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k-1) answer an input d samples later, d the relative degree:
y(k+d) = C A^d x(k) + h u(k). Solved for u(k) this is a system driven by r(k+d) whose poles are the zeros of the
dynamics. Zeros inside the unit circle are run through forwards, exactly. Zeros outside it would grow without bound;
their part of the state is instead summed backwards from the references to come,

    ξ(k) = -Σ_{i≥0} Λ^-(i+1) β r(k+d+i),

which needs the whole future. Known are N samples of it: the reference is taken to stay at r(k+N) from there on. The
weights of what is not known die out as the smallest outside zero to the power of the preview.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear import LinearParameters

#: An answer h below this part of the largest one is rounding: the dynamics do not answer at that sample.
SMALLEST_ANSWER = 1e-11
#: Zeros nearer to the unit circle than this are on it.
CIRCLE_MARGIN = 1e-6
#: Error of the command, as a part of the reference's span, at which a preview counts as long enough.
GOOD_ENOUGH = 1e-3
#: The weights of the future are followed until they have died out by so many powers of ten ...
DECADES = 18.0
#: ... or for so many samples: a zero as near to the circle as that is beyond any preview.
LONGEST = 200_000


@dataclass(frozen=True)
class InverseFilter:
    """Command from references: u(k) = Σ weights[i] r(k+degree+i) + C s(k), s(k+1) = A s(k) + B r(k+degree), in SI.

    Parameters
    ----------
    degree : int
        Relative degree d [samples].
    weights : ndarray, shape (m,)
        Of r(k+d) … r(k+d+m-1), d + m - 1 ≤ preview; the last one holds what lies beyond the preview.
    A, B, C : ndarray, shapes (n, n), (n,) and (n,)
        The causal part, with the zeros inside the unit circle; in the coordinates of the dynamics' own state.
    rest : ndarray, shape (n,)
        State s at rest under a reference of 1 m.
    zeros : ndarray of complex
        Zeros of the dynamics, those at infinity and at 0 that only delay left out.
    error : float
        What :func:`inversion_error` returns for this preview.
    """

    degree: int
    weights: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    rest: np.ndarray
    zeros: np.ndarray
    error: float

    def simulate(self, reference) -> np.ndarray:
        """Return the commands u(0) … u(K-1) [m] for a reference known in advance, from rest on its first sample.

        Parameters
        ----------
        reference : array_like, shape (K,)
            r(0) … r(K-1) [m]; it stays at the last one.
        """
        reference = np.asarray(reference, dtype=np.float64)
        last = self.degree + max(len(self.weights), 1) - 1
        ahead = np.concatenate([reference, np.full(last, reference[-1])])
        state, commands = self.rest * reference[0], np.empty(len(reference))
        for k in range(len(reference)):
            driven = ahead[k + self.degree]
            commands[k] = self.weights @ ahead[k + self.degree : k + last + 1] + self.C @ state
            state = self.A @ state + self.B * driven
        return commands


class _Parts(NamedTuple):
    """The inverse in two parts, in model units: causal (A, B, C), anti-causal (Λ, β, γ), and its feedthrough."""

    degree: int
    through: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    outside: tuple[np.ndarray, np.ndarray, np.ndarray]
    zeros: np.ndarray


def relative_degree(dynamics: LinearParameters) -> int:
    """Return after how many samples the output first answers an input.

    Parameters
    ----------
    dynamics : LinearParameters

    Raises
    ------
    ParameterError
        The output never answers.
    """
    A, B, C, D = dynamics.matrices
    answers, state = [], B
    for i in range(dynamics.order + 1):
        answers.append(float(C @ state) + (D if i == 0 else 0.0))
        state = A @ state
    size = np.abs(answers)
    if not size.max() > 0.0:
        raise ParameterError([Problem("model.dynamics.C", dynamics.C, "the input never reaches the output")])
    return int(np.argmax(size > SMALLEST_ANSWER * size.max())) + 1


def _parts(dynamics: LinearParameters) -> _Parts:
    A, B, C, D = dynamics.matrices
    degree = relative_degree(dynamics)
    answer = float(C @ np.linalg.matrix_power(A, degree - 1) @ B) + (D if degree == 1 else 0.0)
    gain = C @ np.linalg.matrix_power(A, degree) / answer
    inner, drive = A - np.outer(B, gain), B / answer
    poles = np.linalg.eigvals(inner)
    # the inverse has as many poles as the dynamics; those without a zero of the dynamics stand at 0
    finite = dynamics.order - degree + (1 if D else 0)
    zeros = poles[np.argsort(-np.abs(poles))][: max(finite, 0)]
    on_circle = zeros[np.abs(np.abs(zeros) - 1.0) < CIRCLE_MARGIN]
    if on_circle.size:
        found = ", ".join(f"{zero:.6g}" for zero in on_circle)
        allowed = (
            f"model.dynamics has zeros on the unit circle ({found}): no bounded inverse exists; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", allowed)])
    nothing = np.zeros((0, 0)), np.zeros(0), np.zeros(0)
    if not np.any(np.abs(poles) > 1.0):
        return _Parts(degree, 1.0 / answer, inner, drive, -gain, nothing, zeros)
    from scipy.linalg import schur, solve_sylvester  # imported here because most models need no SciPy

    # inside and outside zeros apart: Schur form with the inside first, and the coupling of the two removed
    triangle, basis, count = schur(inner, output="complex", sort=lambda pole: abs(pole) < 1.0)
    coupling = solve_sylvester(triangle[:count, :count], -triangle[count:, count:], -triangle[:count, count:])
    left = basis[:, count:].conj().T
    right = basis[:, :count] @ coupling + basis[:, count:]
    inside = np.eye(dynamics.order) - (right @ left).real
    outside = triangle[count:, count:], left @ drive, -gain @ right
    return _Parts(degree, 1.0 / answer, inside @ inner @ inside, inside @ drive, -gain @ inside, outside, zeros)


def _future_weights(parts: _Parts, scale: float) -> np.ndarray:
    """Return the weights w_i of r(k+d+i) that the outside zeros give, as far as they are more than rounding [m/m]."""
    matrix, drive, out = parts.outside
    if not len(drive):
        return np.zeros(1)
    slowest = float(np.min(np.abs(np.diag(matrix))))
    weights = np.zeros(min(int(DECADES / np.log10(slowest)) + 2, LONGEST))
    inverse = np.linalg.inv(matrix)
    for i in range(len(weights)):
        drive = inverse @ drive
        weights[i] = -scale * (out @ drive).real
    return weights


def _remaining(weights: np.ndarray) -> np.ndarray:
    """Return Σ_{j≥i} |weights[j]| for each i, shape (len(weights) + 1,)."""
    return np.append(np.cumsum(np.abs(weights[::-1]))[::-1], 0.0)


def inverse_filter(dynamics: LinearParameters, preview: int) -> InverseFilter:
    """Return the stable inverse of ``dynamics`` for a reference known ``preview`` samples ahead.

    With enough preview the model's output at sample k is the reference r(k) at every sample. Without dynamics (no A)
    the inverse is the identity; with preview it takes back the sample by which every displacement follows its command.

    Parameters
    ----------
    dynamics : LinearParameters
    preview : int
        N, known are r(k) … r(k+N).

    Returns
    -------
    InverseFilter
        In SI: metres to metres.

    Raises
    ------
    ParameterError
        ``feedforward.preview`` is less than the relative degree, or zeros lie on the unit circle.
    """
    parts = _parts(dynamics)
    degree = parts.degree
    if not dynamics.order:
        degree = min(degree, preview)
    if preview < degree:
        allowed = f"must be at least {degree}: the model answers {degree} samples after its input{_enough(dynamics)}"
        raise ParameterError([Problem("feedforward.preview", preview, allowed)])
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    future = _future_weights(parts, scale)
    count = min(preview - degree + 1, len(future))
    weights = future[:count].copy()
    weights[-1] += np.sum(future[count:])
    weights[0] += scale * parts.through
    error = float(_remaining(future)[count])
    rest = np.linalg.solve(np.eye(dynamics.order) - parts.A, parts.B) if dynamics.order else parts.B
    return InverseFilter(degree, weights, parts.A, parts.B, parts.C * scale, rest, parts.zeros, error)


def inversion_error(dynamics: LinearParameters, preview: int) -> float:
    """Return how wrong the command is at most at this preview, as a part of the span of the reference.

    It is the sum of the magnitudes of the weights that a preview of this length cuts off, Σ |w_i|: no reference that
    stays within a span of one can make the command wrong by more. It is 0 when no zero lies outside the unit circle.

    Parameters
    ----------
    dynamics : LinearParameters
    preview : int

    Raises
    ------
    ParameterError
        As :func:`inverse_filter`.
    """
    return inverse_filter(dynamics, preview).error


def sufficient_preview(dynamics: LinearParameters, error: float = GOOD_ENOUGH) -> int:
    """Return the smallest preview [samples] with an inversion error of at most ``error``.

    Parameters
    ----------
    dynamics : LinearParameters
    error : float

    Raises
    ------
    ParameterError
        The dynamics have no stable inverse.
    """
    parts = _parts(dynamics)
    remaining = _remaining(_future_weights(parts, dynamics.resolved_input_scale / dynamics.output_scale))
    return parts.degree - 1 + int(np.argmax(remaining[1:] <= error)) + 1


def _enough(dynamics: LinearParameters) -> str:
    preview = sufficient_preview(dynamics)
    degree = relative_degree(dynamics)
    return f"; its zeros outside the unit circle ask for {preview}" if preview > degree else ""


def preview_warning(dynamics: LinearParameters, preview: int, prefix: str = "") -> tuple[str, ...]:
    """Return a sentence on what is left of the inversion error at this preview, where that is more than 1e-3.

    Parameters
    ----------
    dynamics : LinearParameters
    preview : int
    prefix : str
        Put before the name of the parameter.
    """
    error = inversion_error(dynamics, preview)
    if error <= GOOD_ENOUGH:
        return ()
    return (
        f"{prefix}feedforward.preview = {preview}: zeros of model.dynamics outside the unit circle leave an error of "
        f"the command of up to {100.0 * error:.3g} % of the reference's span; "
        f"preview {sufficient_preview(dynamics)} brings it below {100.0 * GOOD_ENOUGH:g} %",
    )
