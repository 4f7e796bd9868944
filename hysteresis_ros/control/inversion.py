"""Stable inversion of linear dynamics (W6; Devasia, Chen & Paden 1996, doi:10.1109/9.508898, in discrete time).

Dynamics x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k-1) answer an input d samples later, d the relative degree:
y(k+d) = C A^d x(k) + h u(k). Solved for u(k) this is a system driven by r(k+d) whose poles are the zeros of the
dynamics. Zeros inside the unit circle are run through forwards, exactly. Zeros outside it would grow without bound;
their part of the state is instead summed backwards from the references to come,

    ξ(k) = -Σ_{i≥0} Λ^-(i+1) β r(k+d+i),

which needs the whole future. Known are N samples of it: the reference is taken to stay at r(k+N) from there on. The
weights of what is not known die out as the smallest outside zero to the power of the preview.

A delay of whole samples adds to d. A part f of one is g = (1 - f) + f z⁻¹, whose zero is on the unit circle at f = 1/2
and close to it around; inverted exactly it makes commands that alternate from sample to sample. It is inverted without
phase error instead (Tomizuka 1987, doi:10.1115/1.3143822), h = g* Σ_{i≤J} (1 - g g*)^i with g* = (1 - f) + f z, which
leaves an error of the amplitude, (4 f (1 - f) sin²(ω/2))^(J+1): with J = 3 below 1e-4 up to a tenth of the sample rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import eigenvalues, inverse, power, product, solve
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
#: J of the inverse of a part of a sample.
TERMS = 3
#: Newton steps for the matrix sign function, and the change at which it has settled.
SIGN_STEPS = 60
SETTLED = 1e-14
#: The circle that divides modes is no nearer to 0 than by the root of this part of the slowest outer mode.
NEAREST = 0.1


@dataclass(frozen=True)
class InverseFilter:
    """Command from references: u(k) = Σ weights[i] r(k+first+i) + C s(k), s(k+1) = A s(k) + B Σ drive[i] r(k+first+i).

    All in SI.

    Parameters
    ----------
    first : int
        The relative degree d [samples]; before it, maybe before k, for what inverts a part of a sample.
    weights : ndarray, shape (m,)
        Of r(k+first) …, none beyond the preview; the last one holds what lies beyond it.
    drive : ndarray, shape (l,)
        What drives the causal part: 1 without a part of a sample.
    A, B, C : ndarray, shapes (n, n), (n,) and (n,)
        The causal part, with the zeros inside the unit circle; in the coordinates of the dynamics' own state.
    rest : ndarray, shape (n,)
        State s at rest under a reference of 1 m.
    zeros : ndarray of complex
        Zeros of the dynamics, those at infinity and at 0 that only delay left out.
    error : float
        What :func:`inversion_error` returns for this preview.
    """

    first: int
    weights: np.ndarray
    drive: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    rest: np.ndarray
    zeros: np.ndarray
    error: float


class _Parts(NamedTuple):
    """The inverse in two parts, in model units: causal (A, B, C), anti-causal (Λ⁻¹, β, γ) or None, and its feedthrough.

    The anti-causal part is in the coordinates of the dynamics' state: Λ⁻¹ is zero on the inside modes.
    """

    degree: int
    through: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    anticausal: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    zeros: np.ndarray


def relative_degree(dynamics: LinearParameters) -> int:
    """Return after how many samples the output first answers an input, the delay included.

    Parameters
    ----------
    dynamics : LinearParameters

    Raises
    ------
    ParameterError
        The output never answers.
    """
    return _matrices_degree(dynamics) + dynamics.delayed_samples[0]


def _matrices_degree(dynamics: LinearParameters) -> int:
    A, B, C, D = _vectors(dynamics)
    answers, state = [], B
    for i in range(len(A) + 1):
        answers.append(float(product(C, state)) + (D if i == 0 else 0.0))
        state = product(A, state)
    size = np.abs(answers)
    if not size.max() > 0.0:
        raise ParameterError([Problem("model.dynamics.C", dynamics.C, "the input never reaches the output")])
    return int(np.argmax(size > SMALLEST_ANSWER * size.max())) + 1


def _vectors(dynamics: LinearParameters):
    """Return A, and B, C and D of one input and one output as vectors, shape (n,), and a float, without the delay."""
    model = dynamics.matrices
    return model.A, model.B[:, 0], model.C[0], model.D.item()


def _parts(dynamics: LinearParameters) -> _Parts:
    A, B, C, D = _vectors(dynamics)
    degree = _matrices_degree(dynamics)
    answer = float(product(C, power(A, degree - 1), B)) + (D if degree == 1 else 0.0)
    gain = product(C, power(A, degree)) / answer
    inner, drive = A - np.outer(B, gain), B / answer
    poles = eigenvalues(inner)
    # the inverse has as many poles as the dynamics; those without a zero of the dynamics stand at 0
    finite = len(A) - degree + (1 if D else 0)
    zeros = poles[np.argsort(-np.abs(poles))][: max(finite, 0)]
    on_circle = zeros[np.abs(np.abs(zeros) - 1.0) < CIRCLE_MARGIN]
    if on_circle.size:
        found = ", ".join(f"{zero:.6g}" for zero in on_circle)
        allowed = (
            f"model.dynamics has zeros on the unit circle ({found}): no bounded inverse exists; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", allowed)])
    if not np.any(np.abs(poles) > 1.0):
        return _Parts(degree, 1.0 / answer, inner, drive, -gain, None, zeros)
    outside = _outside(inner, np.abs(poles))
    inside = np.eye(len(A)) - outside
    backwards = product(outside, inverse(product(inner, outside) + inside))
    anticausal = backwards, product(outside, drive), -gain
    causal = product(inside, inner, inside), product(inside, drive), -product(gain, inside)
    return _Parts(degree, 1.0 / answer, *causal, anticausal, zeros)


def _outside(matrix, sizes) -> np.ndarray:
    """Return the projection on the modes outside the unit circle along those inside, shape (n, n).

    The matrix sign function of (M + ρ)(M - ρ)⁻¹, ρ a radius between both, by Newton's iteration.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    sizes : ndarray, shape (n,)
        Magnitudes of the eigenvalues.
    """
    identity = np.eye(len(matrix))
    if np.all(sizes > 1.0):
        return identity
    # between both, and no closer to 0 than needed: there M - ρ is as good as singular where modes coincide at 0
    outer = np.min(sizes[sizes > 1.0])
    radius = math.sqrt(max(np.max(sizes[sizes < 1.0]), NEAREST * outer) * outer)
    sign = product(matrix + radius * identity, inverse(matrix - radius * identity))
    for _ in range(SIGN_STEPS):
        following = 0.5 * (sign + inverse(sign))
        settled = np.max(np.abs(following - sign)) <= SETTLED * np.max(np.abs(following))
        sign = following
        if settled:
            break
    return 0.5 * (identity + sign)


def _future_weights(parts: _Parts, scale: float) -> np.ndarray:
    """Return the weights w_i of r(k+d+i) that the outside zeros give, as far as they are more than rounding [m/m]."""
    if parts.anticausal is None:
        return np.zeros(1)
    backwards, drive, out = parts.anticausal
    sizes = np.abs(parts.zeros)
    slowest = float(np.min(sizes[sizes > 1.0]))
    length = min(int(DECADES / math.log10(slowest)) + 2, LONGEST)
    # rows out N, out N², …: those there are times N to their number are as many more
    rows, further = product(out, backwards)[np.newaxis], backwards
    while len(rows) < length:
        rows, further = np.concatenate([rows, product(rows, further)]), product(further, further)
    return -scale * product(rows[:length], drive)


def _advance(part: float) -> np.ndarray:
    """Return the weights of r(k-J) … r(k+J+1) that invert a delay by a part of a sample; 1 without one."""
    if not part:
        return np.ones(1)
    lost = part * (1.0 - part) * np.array([-1.0, 2.0, -1.0])  # 1 - g g*
    power, total = np.ones(1), np.zeros(2 * TERMS + 1)
    for i in range(TERMS + 1):
        total[TERMS - i : TERMS + i + 1] += power
        power = _spread(power, lost)
    return _spread(total, np.array([1.0 - part, part]))


def _spread(weights: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Return the convolution, added up in a fixed order."""
    found = np.zeros(len(weights) + len(taps) - 1)
    for i, tap in enumerate(taps):
        found[i : i + len(weights)] += tap * weights
    return found


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
    whole, part = dynamics.delayed_samples
    degree, drive = parts.degree + whole, _advance(part)
    ahead = len(drive) // 2
    if not dynamics.order:
        degree = min(degree, preview)
    if preview < degree + ahead:
        beyond = f", and the part of a sample in its delay takes {ahead}" if ahead else ""
        allowed = (
            f"must be at least {degree + ahead}: the model answers {degree} samples after its input{beyond}"
            f"{_enough(dynamics)}"
        )
        raise ParameterError([Problem("feedforward.preview", preview, allowed)])
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    future = _future_weights(parts, scale)
    count = min(preview - ahead - degree + 1, len(future))
    weights = future[:count].copy()
    weights[-1] += math.fsum(future[count:])
    weights[0] += scale * parts.through
    error = float(_remaining(future)[count])
    rest = solve(np.eye(len(parts.A)) - parts.A, parts.B) if len(parts.A) else parts.B
    first, weights = degree - (ahead - 1 if ahead else 0), _spread(weights, drive) if ahead else weights
    return InverseFilter(first, weights, drive, parts.A, parts.B, parts.C * scale, rest, parts.zeros, error)


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
    whole, part = dynamics.delayed_samples
    return parts.degree + whole + len(_advance(part)) // 2 - 1 + int(np.argmax(remaining[1:] <= error)) + 1


def _enough(dynamics: LinearParameters) -> str:
    preview = sufficient_preview(dynamics)
    degree = relative_degree(dynamics) + len(_advance(dynamics.delayed_samples[1])) // 2
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
