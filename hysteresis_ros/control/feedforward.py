# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward: the command that makes the model follow the reference, by stable inversion of its dynamics (W6).

A pair of zeros outside the circle by half a per cent, high above what is to be followed, is what the samples of two
modes look like, or of a mode above half of the sample rate. Inverted exactly, it asks for a command that swells at its
frequency long before, and a little mismatch makes a movement of it. Inside the circle, and next to -1 where holding a
mode's input puts one, it asks for a command that alternates long after each corner: right at the samples, and between
them a movement that nobody asked for. Such zeros are left out of the inverse instead,
without phase error. With g(z⁻¹) their polynomial, g(1) = 1, the reference passes through

    f = g g* p,   p ≈ 1/(g g* + ε (1 - cos ω)/(1 - cos θ)),

an inverse in the sense of least squares [1]_, θ the lowest of their angles: f cancels the zeros, and elsewhere it is
one but for ε (1 - cos ω)/(1 - cos θ)/(…), which falls with the square of the frequency. p is real and even; ε is the
smallest one with which it dies out within :data:`REACH` samples: a longer reach makes f better and the preview longer.

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
a reference moves at (:func:`near_zeros`). Behind the filter that cancels them, their part of the inverse is finite.
With a preview that is too short for it, those inside are inverted.

With ``preview: N`` the reference received at sample k is r(k + N); the controller follows, and a report judges, the
delayed one r(k).

References
----------
.. [1] Tomizuka, Zero phase error tracking algorithm for digital control, J. Dyn. Sys. Meas. Control 109 (1987) 65-68,
   doi:10.1115/1.3143822, has p = 1: the amplitude g g*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.law import bounded
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, kernel
from hysteresis_ros.models.linear import LinearParameters, accumulate, advance
from hysteresis_ros.models.linear_algebra import eigenvalues, inverse, polynomial, power, product, solve

#: Zeros outside the circle, but nearer to the origin than this, ask for more than 64 samples to come down to 1e-4, and
#: those inside it that are as near ring as long.
FARTHEST = 1.155
#: They are left out at this angle and above (a fifth of the sample rate): below, what follows a reference needs them.
LOWEST_ANGLE = 0.4 * math.pi
#: Samples to either side within which p dies out to this part.
REACH, LEFT = 10, 1e-3
#: ε that are tried.
PENALTIES = tuple(0.01 * 2.0 ** (0.25 * step) for step in range(40))
#: Points of a half turn on which p is computed, and its smallest error that is told of.
POINTS = 128
TOLD = 0.01


class Notch(NamedTuple):
    """What takes the place of an inverse of zeros near the circle. Weights ascend in time, from the past to the future.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
    factor : ndarray, shape (m + 1,)
        g: weights of r(k-m) … r(k).
    inverse : ndarray, shape (2 REACH + m + 1,)
        g* p: weights of r(k-REACH) … r(k+REACH+m).
    known_to : float
        Up to this part of the sample rate f differs from one by less than :data:`TOLD`.
    """

    zeros: np.ndarray
    factor: np.ndarray
    inverse: np.ndarray
    known_to: float

    @property
    def whole(self) -> np.ndarray:
        """f: weights of r(k-REACH-m) … r(k+REACH+m)."""
        return convolved(self.inverse, self.factor)

    @property
    def reach(self) -> int:
        """How far f reaches to either side [samples]."""
        return REACH + len(self.zeros)


def convolved(weights: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Return the convolution, added up in a fixed order, shape (n + m - 1,).

    Parameters
    ----------
    weights : ndarray, shape (n,)
    taps : ndarray, shape (m,)
    """
    found = np.zeros(len(weights) + len(taps) - 1)
    for i, tap in enumerate(taps):
        found[i : i + len(weights)] += tap * weights
    return found


def near_zeros(zeros: np.ndarray, margin: float, inside: bool = True) -> np.ndarray:
    """Return the zeros to leave out; those that are smaller than one of a low angle cannot be told from it and stay.

    Parameters
    ----------
    zeros : ndarray of complex, shape (n,)
    margin : float
        Zeros nearer to the circle than this are on it.
    inside : bool
        Whether those inside it count.
    """
    sizes, low = np.abs(zeros), np.abs(np.angle(zeros)) < LOWEST_ANGLE
    inner = np.max(sizes[low & (sizes < 1.0 - margin)], initial=1.0 / FARTHEST)
    near = (sizes > (inner * (1.0 + margin) if inside else 1.0 - margin)) & (sizes < FARTHEST)
    return zeros[near] if not np.any(near & low) else zeros[:0]


def notch(zeros: np.ndarray) -> Notch:
    """Return what takes the place of an inverse of zeros near the circle.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
        In conjugate pairs.
    """
    falling = polynomial(zeros)
    falling = falling / math.fsum(falling)  # g: weights of r(k), r(k-1) …
    order = len(falling) - 1
    cosines = np.array([elementary.cos(math.pi * k / POINTS) for k in range(2 * POINTS)])
    turns = np.arange(POINTS + 1)
    size = np.full(POINTS + 1, math.fsum(falling * falling))
    for shift in range(1, order + 1):
        together = math.fsum(falling[shift:] * falling[:-shift])
        size += 2.0 * together * cosines[shift * turns % (2 * POINTS)]
    lowest = max(zero.real / math.sqrt(zero.real * zero.real + zero.imag * zero.imag) for zero in zeros.tolist())
    penalty = (1.0 - cosines[turns]) / (1.0 - lowest)
    ends = np.full(POINTS + 1, 1.0 / POINTS)
    ends[[0, -1]] *= 0.5
    table = cosines[np.outer(np.arange(POINTS), turns) % (2 * POINTS)] * ends
    for weight in PENALTIES:
        half = product(table, 1.0 / (size + weight * penalty))
        if 2.0 * math.fsum(np.abs(half[REACH + 1 :])) < LEFT:
            break
    half = half[: REACH + 1] / (half[0] + 2.0 * math.fsum(half[1 : REACH + 1]))
    even = np.concatenate([half[:0:-1], half])
    response = half[0] + 2.0 * product(cosines[np.outer(turns, np.arange(1, REACH + 1)) % (2 * POINTS)], half[1:])
    wrong = np.flatnonzero(np.abs(1.0 - size * response) > TOLD)
    known_to = 0.5 * (int(wrong[0]) - 1 if wrong.size else POINTS) / POINTS
    return Notch(zeros, falling[::-1].copy(), convolved(even, falling), known_to)


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
        remedy = f"model.dynamics has zeros on the unit circle ({found}): no bounded inverse exists; use static or none"
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", remedy)])
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
        remedy = (
            f"needs {preview} samples of preview, more than {LONGEST_PREVIEW}: model.dynamics has zeros next to the "
            "unit circle, too near to what is followed to be left out; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", remedy)])
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


# Parameter array: a head, the weights of the references (as many places as the ring has), those that drive the causal
# part, then of that A (n·n, row by row), B, C and its state at rest under a reference of one (n each).
PREVIEW = 0
ORDER = 1
FIRST = 2  # how far the first weight stands behind the oldest reference in the ring
TAPS = 3  # weights in use
PAST = 4  # references before the delayed one
DRIVES = 5  # weights that drive the causal part
WEIGHTS = 6

# State array: a head, then the references r(k - past) … r(k + N) in a ring, n states and n numbers of scratch.
COMMAND = 0  # command of the feedforward for the delayed reference [m]
STARTED = 1  # 0.0 makes the next call take the reference for one that has always been there
NEXT = 2  # place of the ring for the next reference
RING = 3


@kernel
def feedforward(p, x, reference):
    """Return the delayed reference [m] for ``reference`` [m]; the feedforward's command [m] is left in ``x[0]``."""
    length = int(p[PREVIEW]) + 1 + int(p[PAST])
    n = int(p[ORDER])
    drive = WEIGHTS + length
    drives = int(p[DRIVES])
    matrix = drive + drives
    inputs = matrix + n * n
    outputs = inputs + n
    rest = outputs + n
    state = RING + length
    reference = bounded(reference)
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(length):
            x[RING + i] = reference
        for i in range(n):
            x[state + i] = p[rest + i] * reference
    newest = int(x[NEXT])
    x[RING + newest] = reference
    oldest = newest + 1
    if oldest == length:
        oldest = 0
    x[NEXT] = float(oldest)
    place = oldest + int(p[FIRST])
    if place >= length:
        place -= length
    ahead = p[drive] * x[RING + place]
    driving = place
    for i in range(1, drives):
        driving += 1
        if driving == length:
            driving = 0
        ahead += p[drive + i] * x[RING + driving]
    command = 0.0
    for i in range(int(p[TAPS])):
        command += p[WEIGHTS + i] * x[RING + place]
        place += 1
        if place == length:
            place = 0
    x[COMMAND] = accumulate(command, p, outputs, x, state, n)
    advance(p, matrix, inputs, x, state, n, ahead)
    present = oldest + int(p[PAST])
    if present >= length:
        present -= length
    return x[RING + present]


@dataclass(frozen=True)
class FeedforwardParameters(Parameters):
    """Feedforward of the motion controller."""

    type: str = parameter(
        "none",
        choices=("none", "static", "inverse_dynamics"),
        read_only=True,
        description="none, static (the delayed reference itself: the model has unit DC gain), or inverse_dynamics "
        "(stable inversion of model.dynamics; needs preview)",
    )
    preview: int = parameter(
        0,
        low=0,
        high=10000,
        read_only=True,
        description="samples the received reference is ahead; errors are judged against the delayed reference",
    )


class Feedforward(Block):
    """The feedforward of a motion controller: from the received to the delayed reference and a command.

    It begins at rest on the first reference it gets.

    Parameters
    ----------
    parameters : ControllerParameters
        Of which ``feedforward`` and ``model.dynamics`` are used.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        The preview does not reach as far as the dynamics delay, the dynamics have no stable inverse, or are for
        another sample time.
    """

    kernel = staticmethod(feedforward)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array."""
        given = parameters.feedforward
        parameters.model.dynamics.require_sample_time(self.sample_time, "model.dynamics.sample_time")
        chosen = _filter(given, parameters.model.dynamics)
        past = max(-chosen.first, 0)
        taps = np.zeros(given.preview + 1 + past)
        taps[: len(chosen.weights)] = chosen.weights
        head = [given.preview, len(chosen.B), chosen.first + past, len(chosen.weights), past, len(chosen.drive)]
        return np.concatenate([head, taps, chosen.drive, chosen.A.ravel(), chosen.B, chosen.C, chosen.rest])

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(RING + _ring_length(self.p) + 2 * int(self.p[ORDER]))

    @property
    def command(self) -> float:
        """Command [m] of the feedforward at the last sample."""
        return float(self.x[COMMAND])

    def retune(self, parameters) -> None:
        """Take another model of the same order while running.

        References and states go on, so nothing jumps while the reference rests; arm the hand-over behind the
        controller for a reference that moves.

        Raises
        ------
        ParameterError
            Type, preview or the order of the model differ, or the new model cannot be inverted; nothing is changed
            then.
        """
        parameters = parameters.validated()
        for name in ("type", "preview"):
            value, present = getattr(parameters.feedforward, name), getattr(self.parameters.feedforward, name)
            if value != present:
                raise ParameterError([Problem(f"feedforward.{name}", value, f"is fixed while running: keep {present}")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [Problem("model.dynamics.A", parameters.model.dynamics.A, "the order of the model cannot change live")]
            )
        self.parameters = parameters
        # what rests stays at rest under the new model too
        length, order = _ring_length(packed), int(packed[ORDER])
        ahead = self.x[RING + (int(self.x[NEXT]) + int(packed[FIRST])) % length]
        rest = len(packed) - order
        self.x[RING + length : RING + length + order] += (packed[rest:] - self.p[rest:]) * ahead
        self.p[:] = packed


def _ring_length(p) -> int:
    return int(p[PREVIEW]) + 1 + int(p[PAST])


def _filter(given: FeedforwardParameters, dynamics) -> InverseFilter:
    if given.type == "inverse_dynamics":
        return inverse_filter(dynamics, given.preview)
    nothing = np.zeros(0)
    weights = np.ones(1) if given.type == "static" else nothing
    return InverseFilter(0, weights, np.ones(1), np.zeros((0, 0)), nothing, nothing, nothing, nothing, 0.0)
