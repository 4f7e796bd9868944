# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

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

Zeros next to the circle, inside or out, and those on it are left out without phase error where they are far above what
a reference moves at (:mod:`.near_zeros`). Behind the filter that cancels them, their part of the inverse is finite.
With a preview that is too short for it, those inside are inverted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.control.near_zeros import Notch, convolved, near_zeros, notch
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import eigenvalues, inverse, power, product, solve
from hysteresis_ros.models.linear import LinearParameters

#: An answer h below this part of the largest one is rounding: the dynamics do not answer at that sample.
SMALLEST_ANSWER = 1e-11
#: Zeros nearer to the unit circle than this are on it.
CIRCLE_MARGIN = 1e-6
#: Error of the command, as a part of the reference's span, at which a preview counts as long enough.
GOOD_ENOUGH = 1e-3
#: Error and longest preview of an inverse that is designed without being asked for a preview.
DESIGNED_ERROR, LONGEST_PREVIEW = 1e-4, 64
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
        The relative degree d [samples]; before it, maybe before k, for what inverts a part of a sample or leaves out
        zeros.
    weights : ndarray, shape (m,)
        Of r(k+first) …, none beyond the preview; the last one holds what lies beyond it.
    drive : ndarray, shape (l,)
        What drives the causal part: 1 without a part of a sample and without zeros that are left out.
    A, B, C : ndarray, shapes (n, n), (n,) and (n,)
        The causal part, with the zeros inside the unit circle; in the coordinates of the dynamics' own state.
    rest : ndarray, shape (n,)
        State s at rest under a reference of 1 m.
    zeros : ndarray of complex
        Zeros of the dynamics, those at infinity and at 0 that only delay left out.
    error : float
        What :func:`inversion_error` returns for this preview.
    left_out : Notch or None
        Zeros near the circle that are not inverted, and what takes their place.
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
    left_out: Notch | None = None


class _Parts(NamedTuple):
    """The inverse in two parts, in model units: causal (A, B, C), anti-causal (Λ⁻¹, β, γ) or None, and its feedthrough.

    The anti-causal part is in the coordinates of the dynamics' state: Λ⁻¹ is zero on the inside modes. What is left out
    has ``near``, the weights of the reference behind g* p, one to m samples ago, that its modes make, the oldest first.
    """

    degree: int
    through: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    anticausal: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    zeros: np.ndarray
    left_out: Notch | None
    near: np.ndarray

    @property
    def slowest(self) -> float:
        """Magnitude of the smallest zero that is inverted backwards."""
        sizes = np.abs(self.zeros)
        left_out = 0.0 if self.left_out is None else float(np.max(np.abs(self.left_out.zeros)))
        return float(np.min(sizes[sizes > max(1.0, left_out)]))


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


def _parts(dynamics: LinearParameters, inside: bool = True) -> _Parts:
    """Return the parts of the inverse; ``inside``: without the zeros that ring inside the circle."""
    A, B, C, D = _vectors(dynamics)
    degree = _matrices_degree(dynamics)
    answer = float(product(C, power(A, degree - 1), B)) + (D if degree == 1 else 0.0)
    gain = product(C, power(A, degree)) / answer
    inner, drive = A - np.outer(B, gain), B / answer
    poles = eigenvalues(inner)
    # the inverse has as many poles as the dynamics; those without a zero of the dynamics stand at 0
    finite = len(A) - degree + (1 if D else 0)
    zeros = poles[np.argsort(-np.abs(poles))][: max(finite, 0)]
    near = near_zeros(zeros, CIRCLE_MARGIN, inside)
    on_circle = zeros[np.abs(np.abs(zeros) - 1.0) < CIRCLE_MARGIN]
    if on_circle.size and not near.size:
        found = ", ".join(f"{zero:.6g}" for zero in on_circle)
        allowed = (
            f"model.dynamics has zeros on the unit circle ({found}): no bounded inverse exists; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", allowed)])
    sizes, identity = np.abs(poles), np.eye(len(A))
    edge = max(1.0, float(np.max(np.abs(near), initial=0.0)))
    outside = _beyond(inner, sizes, edge)
    causal = inner, drive, -gain
    left_out, answers = None, np.zeros(0)
    if near.size:
        beside = _beyond(inner, sizes, (1.0 - CIRCLE_MARGIN) * float(np.min(np.abs(near)))) - outside
        left_out = notch(near)
        answers = _answers(inner, product(beside, drive), -gain, left_out.factor)
    else:
        beside = np.zeros_like(identity)
    anticausal = None
    if np.any(sizes > edge):
        backwards = product(outside, inverse(product(inner, outside) + (identity - outside)))
        anticausal = backwards, product(outside, drive), -gain
    if near.size or anticausal is not None:
        inside = identity - outside - beside
        causal = product(inside, inner, inside), product(inside, drive), -product(gain, inside)
    return _Parts(degree, 1.0 / answer, *causal, anticausal, zeros, left_out, answers)


def _answers(inner, drive, out, factor) -> np.ndarray:
    """Return what modes answer 1 … m samples after a pulse through the factor that cancels them, the last one first."""
    state, found = np.zeros(len(inner)), []
    for weight in factor[::-1]:
        found.append(float(product(out, state)))
        state = product(inner, state) + drive * weight
    return np.array(found[:0:-1])


def _beyond(matrix, sizes, edge: float) -> np.ndarray:
    """Return the projection on the modes larger than an edge along those that are smaller, shape (n, n).

    The matrix sign function of (M + ρ)(M - ρ)⁻¹, ρ a radius between both, by Newton's iteration.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    sizes : ndarray, shape (n,)
        Magnitudes of the eigenvalues.
    edge : float
    """
    identity, larger = np.eye(len(matrix)), sizes > edge
    if np.all(larger):
        return identity
    if not np.any(larger):
        return np.zeros_like(identity)
    # between both, and no closer to 0 than needed: there M - ρ is as good as singular where modes coincide at 0
    outer = np.min(sizes[larger])
    radius = math.sqrt(max(np.max(sizes[~larger]), NEAREST * outer) * outer)
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
    length = min(int(DECADES / math.log10(parts.slowest)) + 2, LONGEST)
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
        power = convolved(power, lost)
    return convolved(total, np.array([1.0 - part, part]))


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
    if preview < parts.degree + whole + _reach(parts, part):
        parts = _parts(dynamics, inside=False)  # they ask for no preview where they are inverted, and ring
    advance = _advance(part)
    drive = advance if parts.left_out is None else convolved(parts.left_out.whole, advance)
    ahead = _reach(parts, part)
    degree = parts.degree + whole if dynamics.order else min(parts.degree + whole, preview)
    if preview < degree + ahead:
        raise ParameterError([Problem("feedforward.preview", preview, _too_short(dynamics, parts, degree, ahead))])
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    future = _future_weights(parts, scale)
    count = min(preview - ahead - degree + 1, len(future))
    weights = future[:count].copy()
    weights[-1] += math.fsum(future[count:])
    weights[0] += scale * parts.through
    error = float(_remaining(future)[count])
    rest = solve(np.eye(len(parts.A)) - parts.A, parts.B) if len(parts.A) else parts.B
    first, weights = degree - (len(drive) - 1 - ahead), convolved(weights, drive) if ahead else weights
    if parts.left_out is not None:
        beside = scale * convolved(convolved(parts.left_out.inverse, parts.near), advance)
        weights[: len(beside)] += beside
    causal = parts.A, parts.B, parts.C * scale
    return InverseFilter(first, weights, drive, *causal, rest, parts.zeros, error, parts.left_out)


def _reach(parts: _Parts, part: float) -> int:
    """Return how far ahead of the answer must be known what takes back part of a sample or leaves out zeros."""
    return len(_advance(part)) // 2 + (0 if parts.left_out is None else parts.left_out.reach)


def _too_short(dynamics: LinearParameters, parts: _Parts, degree: int, ahead: int) -> str:
    beyond = f", and the part of a sample in its delay takes {ahead}" if ahead else ""
    if parts.left_out is not None:
        beyond = f", and what leaves out its zeros next to the unit circle takes {ahead}"
    enough = sufficient_preview(dynamics)
    asked = f"; its zeros outside the unit circle ask for {enough}" if enough > degree + ahead else ""
    return f"must be at least {degree + ahead}: the model answers {degree} samples after its input{beyond}{asked}"


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
    return parts.degree + whole + _reach(parts, part) + int(np.argmax(remaining[1:] <= error))


def designed_preview(dynamics: LinearParameters) -> int:
    """Return the preview [samples] that a design chooses for the inverse of the dynamics.

    Parameters
    ----------
    dynamics : LinearParameters

    Raises
    ------
    ParameterError
        The dynamics have no stable inverse, or none with a preview that is worth the name: an inverse that was cut off
        would be another one.
    """
    preview = sufficient_preview(dynamics, DESIGNED_ERROR)
    if preview > LONGEST_PREVIEW:
        allowed = (
            f"needs {preview} samples of preview, more than {LONGEST_PREVIEW}: model.dynamics has zeros next to the "
            "unit circle, too near to what is followed to be left out; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", allowed)])
    return preview


def preview_warning(dynamics: LinearParameters, preview: int, prefix: str = "") -> tuple[str, ...]:
    """Return sentences on what the inverse is not: cut off by this preview by more than 1e-3, or without some zeros.

    Parameters
    ----------
    dynamics : LinearParameters
    preview : int
    prefix : str
        Put before the name of the parameter.
    """
    found, given = [], inverse_filter(dynamics, preview)
    if given.left_out is not None:
        rate = 1.0 / dynamics.sample_time if dynamics.sample_time else 1.0
        unit = "Hz" if dynamics.sample_time else "of the sample rate"
        places = (np.angle(zero) / (2.0 * math.pi) * rate for zero in given.left_out.zeros if zero.imag >= 0.0)
        found.append(
            f"{prefix}feedforward.type = inverse_dynamics: zeros of model.dynamics next to the unit circle "
            f"({', '.join(f'{place:.4g}' for place in places)} {unit}) are not inverted; the command is wrong by less "
            f"than 1 % up to {given.left_out.known_to * rate:.3g} {unit}"
        )
    if given.error > GOOD_ENOUGH:
        found.append(
            f"{prefix}feedforward.preview = {preview}: zeros of model.dynamics outside the unit circle leave an error "
            f"of the command of up to {100.0 * given.error:.3g} % of the reference's span; "
            f"preview {sufficient_preview(dynamics)} brings it below {100.0 * GOOD_ENOUGH:g} %"
        )
    return tuple(found)
