# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward: the command with which the model follows the reference, by stable inversion of its dynamics.

**Zeros near the unit circle.** A sampled model of two modes, or of a mode above half the sample rate, may have a pair
of zeros half a per cent outside the unit circle, at frequencies far above those of the reference. The exact inverse of
these zeros needs a command that oscillates at their frequency and starts to grow long before the reference changes. A
small model error turns this command into a motion. Zeros just inside the circle, and the zeros near -1 that the
zero-order hold causes, need a command that alternates long after each corner: the displacement is correct at the
samples, but oscillates between them. The inverse leaves out all these zeros, without phase error. Let g(z⁻¹) be their
polynomial with g(1) = 1. The reference passes through

    f = g g* p,   p ≈ 1/(g g* + ε (1 - cos ω)/(1 - cos θ)),

where p is a least-squares inverse [1]_ and θ is the lowest angle of the zeros. f cancels the zeros. At other
frequencies 1 - f ≈ p ε (1 - cos ω)/(1 - cos θ), which is proportional to ω² at low frequencies. p is real and even. ε
is the smallest value with which p decays within :data:`REACH` samples: a larger REACH makes f more accurate and the
preview longer.

**Stable inversion.** The dynamics x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k-1) respond to an input d samples
later, where d is the relative degree: y(k+d) = C A^d x(k) + h u(k). Solved for u(k), this equation is a system with the
input r(k+d); its poles are the zeros of the dynamics. For zeros inside the unit circle the system runs forwards,
exactly. With zeros outside the circle, its state would grow without bound. Therefore the part of the state that belongs
to these zeros is summed backwards over the future references,

    ξ(k) = -Σ_{i≥0} Λ^-(i+1) β r(k+d+i),

which requires all future references. Only N future samples are known; after r(k+N) the reference is assumed constant.
The weights of the unknown future references decay with the preview as |λ|^(-N), where λ is the smallest zero outside
the circle.

**Delay.** A delay of whole samples adds to d. A fraction q of a sample is modelled by c = (1 - q) + q z⁻¹. At q = 1/2
the zero of c is on the unit circle, and the exact inverse of c makes commands alternate from sample to sample. The
fraction is inverted without phase error instead (Tomizuka 1987, doi:10.1115/1.3143822), by c* Σ_{i≤J} (1 - c c*)^i with
c* = (1 - q) + q z. The remaining amplitude error is (4 q (1 - q) sin²(ω/2))^(J+1). With J = 3 it is below 1e-4 up to a
tenth of the sample rate.

:func:`near_zeros` selects the zeros to leave out: zeros near or on the circle, at frequencies far above those of a
reference. The filter f contains these zeros as the factor g, so f and the inverse of these zeros together are the
finite impulse response g* p. If the preview is too short for this response, the zeros inside the circle are inverted.

**Without preview** the response to a reference that changes now is late by the delay of the dynamics. For a smooth
reference, ``velocity`` commands r(k) + τ (r(k) - r(k-1)), with the mean delay τ of the dynamics [samples]: the error of
a ramp is 0, and the error of a sine is about (ω τ T)²/2 of its amplitude instead of ω τ T. At a corner of the reference
the command jumps by τ times the change of velocity.

With ``preview: N`` the reference received at sample k is r(k + N); the controller follows the delayed reference r(k),
and reports evaluate the error against it.

References
----------
.. [1] Tomizuka, Zero phase error tracking algorithm for digital control, J. Dyn. Sys. Meas. Control 109 (1987) 65-68,
   doi:10.1115/1.3143822. With p = 1, as in this paper, f has the amplitude g g*.
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
from hysteresis_ros.models.linear import LinearParameters, StateSpace, accumulate, advance
from hysteresis_ros.models.linear_algebra import eigenvalues, inverse, polynomial, power, product, solve

#: Modulus of zeros outside the circle whose weights need 64 samples to decay to 1e-4. The weights of zeros nearer to
#: the circle need more samples. Zeros inside the circle at the same distance ring as long.
FARTHEST = 1.155
#: Smallest angle of zeros that are left out (a fifth of the sample rate); zeros at lower angles are needed for
#: tracking.
LOWEST_ANGLE = 0.4 * math.pi
#: Number of weights of p on either side of the middle one [samples].
REACH = 10
#: The magnitudes of the weights of p that are left out on both sides must have a sum below this value.
LEFT = 1e-3
#: Candidates for ε.
PENALTIES = tuple(0.01 * 2.0 ** (0.25 * step) for step in range(40))
#: Number of frequencies at which p is computed, and the error of f that limits ``known_to``.
POINTS = 128
TOLD = 0.01


class Notch(NamedTuple):
    """Replacement for the inverse of zeros near the circle; weights are in the order of time, from past to future.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
    factor : ndarray, shape (m + 1,)
        g: weights of r(k-m) … r(k).
    inverse : ndarray, shape (2 REACH + m + 1,)
        g* p: weights of r(k-REACH) … r(k+REACH+m).
    known_to : float
        Fraction of the sample rate up to which f differs from one by less than :data:`TOLD`.
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
        """Range of f on either side [samples]."""
        return REACH + len(self.zeros)


def convolved(weights: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Return the convolution, summed in a fixed order, shape (n + m - 1,)."""
    found = np.zeros(len(weights) + len(taps) - 1)
    for i, tap in enumerate(taps):
        found[i : i + len(weights)] += tap * weights
    return found


def near_zeros(zeros: np.ndarray, margin: float, inside: bool = True) -> np.ndarray:
    """Return the zeros to leave out.

    Zeros are separated by their modulus, so a zero with a smaller modulus than a needed zero at a low angle is kept.
    Zeros nearer to the circle than ``margin`` count as zeros on the circle; ``inside`` includes the zeros inside it.
    """
    sizes, low = np.abs(zeros), np.abs(np.angle(zeros)) < LOWEST_ANGLE
    inner = np.max(sizes[low & (sizes < 1.0 - margin)], initial=1.0 / FARTHEST)
    near = (sizes > (inner * (1.0 + margin) if inside else 1.0 - margin)) & (sizes < FARTHEST)
    return zeros[near] if not np.any(near & low) else zeros[:0]


def notch(zeros: np.ndarray) -> Notch:
    """Return the replacement for the inverse of zeros near the circle.

    Parameters
    ----------
    zeros : ndarray of complex, shape (m,)
        The zeros, in conjugate pairs.
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


#: Fraction of the largest response below which a response h is a rounding error and counts as zero.
SMALLEST_ANSWER = 1e-11
#: Zeros nearer to the unit circle than this distance count as zeros on it.
CIRCLE_MARGIN = 1e-6
#: Largest error of the command, as a fraction of the reference's span, with which a preview counts as long enough.
GOOD_ENOUGH = 1e-3
#: Largest inversion error that a design accepts if no preview is requested.
DESIGNED_ERROR = 1e-4
#: Longest preview of a design if no preview is requested [samples].
LONGEST_PREVIEW = 64
#: Weights of future references are computed until they have decayed by this number of powers of ten ...
DECADES = 18.0
#: ... or for this number of samples: a zero that needs more samples is too near to the circle for any preview.
LONGEST = 200_000
#: J, the number of correction terms in the inverse of a fractional delay.
TERMS = 3
#: Maximum number of Newton steps for the matrix sign function, and change below which it has converged.
SIGN_STEPS = 60
SETTLED = 1e-14
#: The radius of the circle that separates modes is at least the square root of this number, times the smallest modulus
#: of an outer mode.
NEAREST = 0.1


@dataclass(frozen=True)
class InverseFilter:
    """Command from references: u(k) = Σ weights[i] r(k+first+i) + C s(k), s(k+1) = A s(k) + B Σ drive[i] r(k+first+i).

    All quantities are in SI units.

    Parameters
    ----------
    first : int
        Lead of the first weight [samples]: the relative degree d, or less (possibly below 0) with a fractional delay or
        left-out zeros.
    weights : ndarray, shape (m,)
        Weights of r(k+first) … up to the preview; the last weight includes the weights of all references beyond the
        preview.
    drive : ndarray, shape (l,)
        Weights that drive the causal part: 1 without a fractional delay and without left-out zeros.
    A, B, C : ndarray, shapes (n, n), (n,) and (n,)
        The causal part, which belongs to the zeros inside the unit circle, in the coordinates of the dynamics' state.
    rest : ndarray, shape (n,)
        Steady state s for a constant reference of 1 m.
    zeros : ndarray of complex
        Zeros of the dynamics, except zeros at infinity and at 0, which are only a delay.
    error : float
        Largest error of the command at this preview, as a fraction of the span of the reference. It is the sum of the
        magnitudes of the truncated weights, Σ |w_i|, which is a bound for every reference with a span of 1. It is 0 if
        no zero is outside the unit circle.
    left_out : Notch or None
        Zeros near the circle that are not inverted, and their replacement.
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

    def response(self, z: np.ndarray) -> np.ndarray:
        """Return the frequency response from r(k) to u(k) at points of the z plane, shape (F,)."""
        ahead = np.asarray(z) ** self.first
        driving = ahead * np.polynomial.polynomial.polyval(z, self.drive)
        causal = StateSpace(self.A, self.B[:, np.newaxis], self.C[np.newaxis], np.zeros((1, 1)))
        return ahead * np.polynomial.polynomial.polyval(z, self.weights) + driving * causal.response(z)[:, 0, 0]


class _Parts(NamedTuple):
    """The inverse in model units: causal part (A, B, C), anti-causal part (Λ⁻¹, β, γ) or None, and feedthrough.

    The anti-causal part is in the coordinates of the dynamics' state, where Λ⁻¹ is zero for the modes inside the
    circle. The zeros that are left out (see the module) are modes of the inverse. ``near`` replaces
    these modes: it contains the weights of the last m samples, oldest first, of the reference filtered by g* p.
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
        """Magnitude of the smallest zero that is inverted backwards in time."""
        sizes = np.abs(self.zeros)
        left_out = 0.0 if self.left_out is None else float(np.max(np.abs(self.left_out.zeros)))
        return float(np.min(sizes[sizes > max(1.0, left_out)]))


def relative_degree(dynamics: LinearParameters) -> int:
    """Return the samples from an input to its first effect, including the delay; ParameterError if it has no effect."""
    return _matrices_degree(dynamics) + dynamics.delayed_samples[0]


def mean_delay(dynamics: LinearParameters) -> float:
    """Return the delay of the model's response to a slow motion [samples]: the mean time of its impulse response."""
    A, B, C, D = _vectors(dynamics)
    identity = np.eye(len(A))
    state = solve(identity - A, B) if len(A) else B
    gain, late = float(product(C, state)) + D, D
    if len(A):
        late += float(product(C, solve(identity - A, state)))
    whole, part = dynamics.delayed_samples
    return late / gain + whole + part


def _matrices_degree(dynamics: LinearParameters) -> int:
    A, B, C, D = _vectors(dynamics)
    answers, state = [], B
    for i in range(len(A) + 1):
        answers.append(float(product(C, state)) + (D if i == 0 else 0.0))
        state = product(A, state)
    size = np.abs(answers)
    if not size.max() > 0.0:
        raise ParameterError(
            [
                Problem(
                    "model.dynamics.C",
                    dynamics.C,
                    "the transfer function from input to output must not be zero; give other matrices",
                )
            ]
        )
    return int(np.argmax(size > SMALLEST_ANSWER * size.max())) + 1


def _vectors(dynamics: LinearParameters):
    """Return A, B, C (vectors, shape (n,)) and D (a float) of a model with one input and output, without delay."""
    model = dynamics.matrices
    return model.A, model.B[:, 0], model.C[0], model.D.item()


def _parts(dynamics: LinearParameters, inside: bool = True) -> _Parts:
    """Return the parts of the inverse; ``inside``: whether ringing zeros inside the circle are left out as well."""
    A, B, C, D = _vectors(dynamics)
    degree = _matrices_degree(dynamics)
    answer = float(product(C, power(A, degree - 1), B)) + (D if degree == 1 else 0.0)
    gain = product(C, power(A, degree)) / answer
    inner, drive = A - np.outer(B, gain), B / answer
    poles = eigenvalues(inner)
    # the inverse has as many poles as the dynamics; poles that are not zeros of the dynamics are at 0
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
    """Return the response of the modes, m … 1 samples after a pulse filtered by the factor that cancels them."""
    state, found = np.zeros(len(inner)), []
    for weight in factor[::-1]:
        found.append(float(product(out, state)))
        state = product(inner, state) + drive * weight
    return np.array(found[:0:-1])


def _beyond(matrix, sizes, edge: float) -> np.ndarray:
    """Return the projection, shape (n, n), onto the modes with modulus above ``edge``, along the other modes.

    The projection follows from the matrix sign function of (M + ρ)(M - ρ)⁻¹, computed by Newton's iteration. The radius
    ρ lies between the larger and the smaller modes.
    """
    identity, larger = np.eye(len(matrix)), sizes > edge
    if np.all(larger):
        return identity
    if not np.any(larger):
        return np.zeros_like(identity)
    # a radius between both groups, but not too small: modes that coincide at 0 make M - ρ nearly singular near 0
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
    """Return the weights w_i [m/m] of r(k+d+i) of the zeros outside the circle, down to the size of rounding errors."""
    if parts.anticausal is None:
        return np.zeros(1)
    backwards, drive, out = parts.anticausal
    length = min(int(DECADES / math.log10(parts.slowest)) + 2, LONGEST)
    # rows γ Λ⁻¹, γ Λ⁻² …: each pass multiplies the present rows by a power of Λ⁻¹, which doubles their number
    rows, further = product(out, backwards)[np.newaxis], backwards
    while len(rows) < length:
        rows, further = np.concatenate([rows, product(rows, further)]), product(further, further)
    return -scale * product(rows[:length], drive)


def _advance(part: float) -> np.ndarray:
    """Return the weights of r(k-J) … r(k+J+1) that invert a fractional delay; 1 without a fraction."""
    if not part:
        return np.ones(1)
    lost = part * (1.0 - part) * np.array([-1.0, 2.0, -1.0])  # 1 - c c*
    power, total = np.ones(1), np.zeros(2 * TERMS + 1)
    for i in range(TERMS + 1):
        total[TERMS - i : TERMS + i + 1] += power
        power = convolved(power, lost)
    return convolved(total, np.array([1.0 - part, part]))


def _remaining(weights: np.ndarray) -> np.ndarray:
    """Return Σ_{j≥i} |weights[j]| for each i, shape (len(weights) + 1,)."""
    return np.append(np.cumsum(np.abs(weights[::-1]))[::-1], 0.0)


def inverse_filter(dynamics: LinearParameters, preview: int) -> InverseFilter:
    """Return the stable inverse of ``dynamics`` for a reference that is known ``preview`` samples ahead.

    With enough preview, the model's output is equal to the reference r(k) at every sample k. Without dynamics (no A),
    the inverse is the identity; with preview, it compensates the one-sample delay from a command to its displacement.

    Parameters
    ----------
    dynamics : LinearParameters
    preview : int
        N: r(k) … r(k+N) are known.

    Returns
    -------
    InverseFilter
        The inverse in SI, from metres to metres.

    Raises
    ------
    ParameterError
        ``feedforward.preview`` is too short for the dynamics and their delay, or zeros lie on the unit circle.
    """
    parts = _parts(dynamics)
    whole, part = dynamics.delayed_samples
    if preview < parts.degree + whole + _reach(parts, part):
        parts = _parts(dynamics, inside=False)  # with a short preview, zeros inside the circle are inverted and ring
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
    """Return the preview [samples] that a fractional delay or left-out zeros need beyond the relative degree."""
    return len(_advance(part)) // 2 + (0 if parts.left_out is None else parts.left_out.reach)


def _too_short(dynamics: LinearParameters, parts: _Parts, degree: int, ahead: int) -> str:
    beyond = f", and the fraction of a sample in its delay needs {ahead} more" if ahead else ""
    if parts.left_out is not None:
        beyond = f", and leaving out its zeros next to the unit circle needs {ahead} more"
    enough = sufficient_preview(dynamics)
    asked = f"; its zeros outside the unit circle need {enough}" if enough > degree + ahead else ""
    return f"must be at least {degree + ahead}: the model responds {degree} samples after its input{beyond}{asked}"


def sufficient_preview(dynamics: LinearParameters, error: float = GOOD_ENOUGH) -> int:
    """Return the smallest preview [samples] with which the inversion error is at most ``error``.

    ParameterError: the dynamics have no stable inverse.
    """
    parts = _parts(dynamics)
    remaining = _remaining(_future_weights(parts, dynamics.resolved_input_scale / dynamics.output_scale))
    whole, part = dynamics.delayed_samples
    return parts.degree + whole + _reach(parts, part) + int(np.argmax(remaining[1:] <= error))


def designed_preview(dynamics: LinearParameters) -> int:
    """Return the preview [samples] that a design chooses for the inverse of the dynamics.

    ParameterError: the dynamics have no stable inverse, or the inverse needs more preview than :data:`LONGEST_PREVIEW`.
    """
    preview = sufficient_preview(dynamics, DESIGNED_ERROR)
    if preview > LONGEST_PREVIEW:
        remedy = (
            f"needs {preview} samples of preview, more than {LONGEST_PREVIEW}: model.dynamics has zeros next to the "
            "unit circle, at frequencies that are too low to omit them; use static or none"
        )
        raise ParameterError([Problem("feedforward.type", "inverse_dynamics", remedy)])
    return preview


def preview_warning(dynamics: LinearParameters, preview: int, prefix: str = "") -> tuple[str, ...]:
    """Return a warning if this preview truncates the inverse by more than 1e-3, and a warning if zeros are left out."""
    found, given = [], inverse_filter(dynamics, preview)
    if given.left_out is not None:
        rate = 1.0 / dynamics.sample_time if dynamics.sample_time else 1.0
        unit = "Hz" if dynamics.sample_time else "of the sample rate"
        places = (np.angle(zero) / (2.0 * math.pi) * rate for zero in given.left_out.zeros if zero.imag >= 0.0)
        found.append(
            f"{prefix}feedforward.type = inverse_dynamics: zeros of model.dynamics next to the unit circle "
            f"({', '.join(f'{place:.4g}' for place in places)} {unit}) are not inverted; the error of the command is "
            f"below 1 % up to {given.left_out.known_to * rate:.3g} {unit}"
        )
    if given.error > GOOD_ENOUGH:
        found.append(
            f"{prefix}feedforward.preview = {preview}: zeros of model.dynamics outside the unit circle leave an error "
            f"of the command of up to {100.0 * given.error:.3g} % of the reference's span; "
            f"preview {sufficient_preview(dynamics)} brings it below {100.0 * GOOD_ENOUGH:g} %"
        )
    return tuple(found)


# Parameter array: a head; the weights of the references, as many as the ring has entries; the weights that drive the
# causal part; then A (n·n, row by row), B, C and the steady state for a reference of 1 (n each) of the causal part.
PREVIEW = 0
ORDER = 1
FIRST = 2  # index of the first weight relative to the oldest reference in the ring
TAPS = 3  # number of weights in use
PAST = 4  # number of references before the delayed reference
DRIVES = 5  # number of weights that drive the causal part
WEIGHTS = 6

# State array: a head; the references r(k - past) … r(k + N) in a ring; n states; and n entries of scratch.
COMMAND = 0  # command of the feedforward for the delayed reference [m]
STARTED = 1  # 0.0: the next call assumes that the reference has been constant so far
NEXT = 2  # index in the ring at which the next reference is stored
GIVEN = 3  # part of the command that the feedforward of a stage adds [m]; 0 for a single axis
NEWEST = 4  # reference of the last call [m]
CALLS = 5  # number of calls since the feedforward of a stage last read the reference
RING = 6


@kernel
def feedforward(p, x, reference):
    """Store ``reference`` [m] and return the delayed reference [m]; store the feedforward's command [m] in ``x[0]``."""
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
    x[NEWEST] = reference
    x[CALLS] += 1.0
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
    x[COMMAND] = accumulate(command, p, outputs, x, state, n) + x[GIVEN]
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
        choices=("none", "static", "velocity", "inverse_dynamics"),
        read_only=True,
        description="none, static (the delayed reference itself: the model has unit DC gain), velocity (the reference "
        "plus its velocity times the mean delay of model.dynamics; for smooth references not known ahead), "
        "or inverse_dynamics (stable inversion of model.dynamics; needs preview)",
    )
    preview: int = parameter(
        0,
        low=0,
        high=10000,
        read_only=True,
        description="number of samples by which the received reference is ahead; the controller follows the "
        "reference delayed by this number",
    )

    @property
    def inverts(self) -> bool:
        """Whether the model follows the reference with this feedforward; ``velocity`` needs a smooth reference."""
        return self.type in ("velocity", "inverse_dynamics")


class Feedforward(Block):
    """The feedforward of a motion controller: from the received reference to the delayed reference and a command.

    It starts in the steady state for the first reference.

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters, of which ``feedforward`` and ``model.dynamics`` are used.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        The preview is shorter than the delay of the dynamics, the dynamics have no stable inverse, or the dynamics are
        for another sample time.
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
        """Change to another model of the same order while running.

        References and states continue, so the command does not jump while the reference is constant. If the reference
        moves, the caller must arm the hand-over behind the controller.

        Raises
        ------
        ParameterError
            The type, the preview or the order of the model differs, or the new model cannot be inverted. In this case
            nothing is changed.
        """
        parameters = parameters.validated()
        for name in ("type", "preview"):
            value, present = getattr(parameters.feedforward, name), getattr(self.parameters.feedforward, name)
            if value != present:
                raise ParameterError([Problem(f"feedforward.{name}", value, f"is fixed while running: keep {present}")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [Problem("model.dynamics.A", parameters.model.dynamics.A, "the model's order is fixed while running")]
            )
        self.parameters = parameters
        # the states are shifted so that a feedforward in steady state is also in steady state with the new model
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
    first, weights = 0, np.ones(1) if given.type == "static" else nothing
    if given.type == "velocity":
        lead = mean_delay(dynamics)
        first, weights = -1, np.array([-lead, 1.0 + lead])
    return InverseFilter(first, weights, np.ones(1), np.zeros((0, 0)), nothing, nothing, nothing, nothing, 0.0)
