# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Robustness of linear loops, modelled or measured: loop transfer function, margins, sensitivity and bandwidth.

Controllers are linear close to rest (:mod:`hysteresis_ros.control.linearisation`). The timing is the same as in the
running loop: y_k = C x_k + D u_(k-1) is measured; u_k is computed from y_k in the same sample, and held until the next
sample. It is assumed that commands are achieved, and that the inverse of the hysteresis is exact.

The loop is cut at the command: L(z) = −K_y(z) P(z), sensitivity S = 1/(1 + L), complementary sensitivity T = L/(1 + L).
A further delay of s samples turns L(e^jω) into L(e^jω) e^(−jωs). The loop tolerates the delay until this curve passes
through −1.

Every design must meet the same requirements (:data:`REQUIRED`): M_s ≤ 2, a gain margin of 6 dB, and a delay margin of
one sample in addition to the delay of the model. This additional sample covers the delays of converters, data transport
and a loaded computer, together about one sample. M_s ≤ 2 alone implies a gain margin of 20 log10 2 = 6.02 dB and a
phase margin of 2 asin(1/4) = 29 degrees [1]_. It does not imply a delay margin, because one sample of delay is 180
degrees of phase at half the sample rate.

A measured loop is also cut at the command. To first order an error δ of L causes an error -S² δ of S and S² δ of T. The
range of a margin follows from the circles of uncertainty around L at the measured frequencies. The points of the
circles nearest to −1 give the range of the sensitivity. The circles that meet the real axis give the range of the gain
margin, and those that meet the unit circle give the range of the phase margin.

References
----------
.. [1] Åström & Murray, Feedback Systems, 2nd ed. 2021, chapters 10 and 12 (margins, delay margin, M_s, M_t).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.models.linear import BOUNDARY, StateSpace


def with_acting(dynamics, plant: StateSpace) -> StateSpace:
    """Return a plant with its quasi-static displacement as a second output.

    The second output has only a gain and a delay, no poles or zeros. The force in the stack is a weighted sum of both
    outputs. The plant must have no feedthrough, and its first states must be the states of ``dynamics``.
    """
    row, through = dynamics.acting
    n = plant.order
    A, C = np.zeros((n + 1, n + 1)), np.zeros((2, n + 1))
    A[:n, :n], A[n, : len(row)] = plant.A, row
    C[0, :n], C[1, n] = plant.C[0], dynamics.matrices.dc_gain
    return StateSpace(A, np.vstack([plant.B, [[through]]]), C, np.zeros((2, 1)))


def plant_state_space(dynamics, scaled: bool = True, acting: bool = False) -> StateSpace:
    """Return the model from command to measured displacement; its last state is the previous input.

    Parameters
    ----------
    dynamics : LinearParameters
    scaled : bool
        True: SI units; False: the model's units.
    acting : bool
        Whether to add the second output of :func:`with_acting`.
    """
    held = dynamics.state_space.held()
    if acting:
        held = with_acting(dynamics, held)
    return held.scaled(dynamics.output_scale / dynamics.resolved_input_scale) if scaled else held


def close(controller: StateSpace, plant: StateSpace) -> StateSpace:
    """Return the closed loop from reference to measured displacement.

    Parameters
    ----------
    controller, plant : StateSpace
        Systems of :func:`~hysteresis_ros.control.linearisation.linear_loop`.
    """
    n, m = len(controller.A), len(plant.A)
    reference, measured = controller.B[:, :1], controller.B[:, 1:]
    A = np.block(
        [
            [controller.A, measured @ plant.C],
            [plant.B @ controller.C, plant.A + plant.B @ controller.D[:, 1:] @ plant.C],
        ]
    )
    B = np.vstack([reference, controller.D[0, 0] * plant.B])
    return StateSpace(A, B, np.hstack([np.zeros((1, n)), plant.C[:1]]).reshape(1, n + m), np.zeros((1, 1)))


def loop_transfer(controller: StateSpace, plant: StateSpace, z) -> np.ndarray:
    """Return L at the points ``z``, shape (N,), for the controller and plant of :func:`.linear_loop`."""
    return np.sum(loop_parts(controller, plant, z), axis=1)


def loop_parts(controller: StateSpace, plant: StateSpace, z) -> np.ndarray:
    """Return the contribution to L through each measured signal, shape (N, q).

    The signals are the displacement and, if the force is used, the quasi-static displacement.
    """
    return _parts(controller.response(z), plant.response(z))


def _parts(commands, displacements) -> np.ndarray:
    """Return :func:`loop_parts` for given frequency responses of controller and plant."""
    return -commands[:, 0, 1:] * displacements[:, :, 0]


#: Number of frequencies on each scale of the grid (linear, logarithmic), and number of frequencies around each pole.
GRID = 3000
AROUND_POLE = 61
#: Number of equal parts into which an interval with a crossing is divided each time.
PARTS = 64
#: Number of times that such an interval is divided, which is exact to rounding.
ROUNDS = 9
#: Number of times that it is divided in a search, which is exact to 1e-7 of the distance between two points of the
#: grid.
SEARCHED_ROUNDS = 4
#: Magnitude of −3 dB.
HALF_POWER = np.sqrt(0.5)
#: Lowest angle of the grid.
LOWEST = 1e-7


@dataclass(frozen=True)
class Requirements:
    """Requirements of a design.

    Parameters
    ----------
    sensitivity_peak : float
        Largest M_s.
    gain_margin : float
        Least gain margin [dB].
    delay_margin : float
        Least tolerated delay in addition to the modelled delay [samples].
    command_noise_gain : float
        Largest RMS of the command per RMS of the sensor's noise; infinite if the noise is not known.
    late_sensitivity_peak : float
        Largest M_s with one sample of delay in addition to the modelled delay, for designs without a given bandwidth.
    """

    sensitivity_peak: float = 2.0
    gain_margin: float = 6.0
    delay_margin: float = 1.0
    command_noise_gain: float = np.inf
    late_sensitivity_peak: float = np.inf


#: Relative tolerance of a requirement, because a design ends at gains that just meet the requirement.
ROUNDING = 1e-3
#: Requirements of every design.
REQUIRED = Requirements()
#: Requirements at which a design without a given bandwidth aims: even with one more sample of delay, a delay margin of
#: one sample remains. Usual values of M_s are 1.2 to 2 [1]_.
AIMED = Requirements(sensitivity_peak=1.6, delay_margin=2.0, late_sensitivity_peak=3.0)
#: Requirements for gains that are tuned for speed (by a criterion or a comparison): stability with one more sample of
#: delay.
FASTEST = Requirements(delay_margin=1.3)


@dataclass(frozen=True, eq=False)
class Margins:
    """Result of :func:`margins_of`; a margin is infinite if there is no corresponding crossover.

    Parameters
    ----------
    gain_margin : float
        Factor by which the gain may increase [dB].
    gain_reduction_margin : float
        Factor by which the gain may decrease [dB].
    phase_margin : float
        Smallest distance of the phase from −180 degrees at a gain crossover [degrees].
    delay_margin : float
        Tolerated additional delay [s].
    gain_crossovers, phase_crossovers : ndarray
        Frequencies at which the loop transfer function has gain 1, and frequencies at which its phase is −180 degrees
        [Hz].
    sensitivity_peak, complementary_peak : float
        M_s and M_t.
    bandwidth : float
        Lowest frequency at which the response to the reference, without feedforward, is -3 dB [Hz]; infinite if there
        is no such frequency below half the sample rate.
    noise_gain, command_noise_gain : float
        RMS of displacement and of command per RMS of white sensor noise [m/m].
    poles : ndarray
        Closed-loop poles, the slowest first.
    sample_time : float
        [s]
    """

    gain_margin: float
    gain_reduction_margin: float
    phase_margin: float
    delay_margin: float
    gain_crossovers: np.ndarray
    phase_crossovers: np.ndarray
    sensitivity_peak: float
    complementary_peak: float
    bandwidth: float
    noise_gain: float
    command_noise_gain: float
    poles: np.ndarray
    sample_time: float

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles are inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0 - BOUNDARY))

    @property
    def delay_margin_samples(self) -> float:
        """Tolerated additional delay, in samples."""
        return self.delay_margin / self.sample_time

    def misses(self, required: Requirements = REQUIRED) -> tuple[str, ...]:
        """Return each unmet requirement in a few words; empty if all requirements are met."""
        if not self.stable:
            return ("unstable on its own model",)
        found = []
        if not self.sensitivity_peak <= required.sensitivity_peak * (1.0 + ROUNDING):
            found.append(f"M_s {self.sensitivity_peak:.3g} above {required.sensitivity_peak:g}")
        if not self.gain_margin >= required.gain_margin * (1.0 - ROUNDING):
            found.append(f"gain margin {self.gain_margin:.3g} dB below {required.gain_margin:g} dB")
        if not self.delay_margin_samples >= required.delay_margin * (1.0 - ROUNDING):
            samples = "sample" if required.delay_margin == 1.0 else "samples"
            found.append(
                f"delay margin {self.delay_margin_samples:.3g} samples ({1e3 * self.delay_margin:.3g} ms) below "
                f"{required.delay_margin:g} {samples}"
            )
        return tuple(found)

    @property
    def meets(self) -> bool:
        """Whether the loop meets :data:`REQUIRED`."""
        return not self.misses()


class Judged(NamedTuple):
    """Figures of a loop for a search, on a coarser grid than :class:`Margins`; M_s is infinite for an unstable loop.

    Parameters
    ----------
    bandwidth : float
        [Hz]; NaN if it was not computed.
    sensitivity_peak : float
        M_s.
    delay_margin : float
        [samples]
    noise_gain, command_noise_gain : float
        RMS of displacement and of command per RMS of white sensor noise [m/m].
    rejection : float
        Frequency up to which disturbances are rejected, that is, |S| is below −3 dB [Hz]; 0 if a constant disturbance
        is not rejected.
    feedback : float
        Frequency up to which the feedback acts, that is, |T| is above −3 dB [Hz]; 0 if the feedback does not act at
        frequency zero.
    late_sensitivity_peak : float
        M_s with an additional sample of delay.
    """

    bandwidth: float
    sensitivity_peak: float
    delay_margin: float
    noise_gain: float
    command_noise_gain: float
    rejection: float
    feedback: float
    late_sensitivity_peak: float

    def meets(self, required: Requirements = REQUIRED) -> bool:
        """Whether the loop meets the requirements; M_s ≤ 2 implies the gain margin of 6 dB."""
        least = 1.0 / (1.0 - 10.0 ** (-required.gain_margin / 20.0))
        bounded = self.sensitivity_peak <= min(required.sensitivity_peak, least)
        quiet = self.command_noise_gain <= required.command_noise_gain
        bounded = bounded and self.late_sensitivity_peak <= required.late_sensitivity_peak
        return bounded and quiet and self.delay_margin >= required.delay_margin


#: Figures of an unstable loop.
UNSTABLE = Judged(0.0, np.inf, 0.0, np.inf, np.inf, 0.0, 0.0, np.inf)


def judge(
    controller: StateSpace, plant: StateSpace, sample_time: float, grid: int = 300, *, with_bandwidth: bool = True
) -> Judged:
    """Return the figures of a linear loop for a search.

    Parameters
    ----------
    controller, plant : StateSpace
    sample_time : float
        Sample time [s].
    grid : int
        Number of frequencies on each scale of the grid (linear, logarithmic), without those around the poles.
    with_bandwidth : bool
        Whether to search for the bandwidth.
    """
    poles = close(controller, plant).poles
    if np.max(np.abs(poles)) >= 1.0 - BOUNDARY:
        return UNSTABLE
    angles = _grid([*poles, *plant.poles], grid)
    values, feedback, tracking = _responses(controller, plant, angles)
    sensitivity = 1.0 / np.abs(1.0 + values)
    hertz = 1.0 / (2.0 * np.pi * sample_time)
    complementary = np.abs(values) * sensitivity
    return Judged(
        _bandwidth(controller, plant, angles, tracking, SEARCHED_ROUNDS) * hertz if with_bandwidth else np.nan,
        float(np.max(sensitivity)),
        _coarse_delay_margin(angles, values),
        _noise_gain(angles, complementary),
        _noise_gain(angles, feedback * sensitivity),
        _up_to(angles, sensitivity >= HALF_POWER) * hertz,
        _up_to(angles, complementary < HALF_POWER) * hertz,
        float(np.max(1.0 / np.abs(1.0 + values * np.exp(-1j * angles)))),
    )


def _up_to(angles, begun) -> float:
    """Return the first angle at which a condition holds: 0 if it is the first of ``angles``, π if it never holds."""
    first = int(np.argmax(begun))
    if not begun[first]:
        return np.pi
    return float(angles[first]) if first else 0.0


def _coarse_delay_margin(angles, values) -> float:
    """Return the delay margin [samples]; crossovers are interpolated between the points of a grid."""
    size = np.log(np.abs(values) + 1e-300)
    at = np.flatnonzero((size[:-1] < 0.0) != (size[1:] < 0.0))
    part = size[at] / (size[at] - size[at + 1])
    crossovers = angles[at] + part * (angles[at + 1] - angles[at])
    turned = np.angle(values[at + 1] / values[at])
    phases = np.mod(np.angle(values[at]) + part * turned + np.pi, 2.0 * np.pi)
    return _least(phases / crossovers)


def _noise_gain(angles, size) -> float:
    """Return the RMS of the response to white noise of RMS 1, (1/π ∫ |H|² dω)^½, from the magnitude |H|."""
    square = size * size
    area = np.sum(0.5 * (square[1:] + square[:-1]) * np.diff(angles)) + square[0] * angles[0]
    return float(np.sqrt(area / np.pi))


def margins_of(controller: StateSpace, plant: StateSpace, sample_time: float) -> Margins:
    """Return margins, bandwidth and poles of a linear loop.

    ``controller`` has the inputs (reference, measured) and the output command, ``plant`` has the input command and the
    output measured displacement. Units: ``sample_time`` [s].
    """
    poles = close(controller, plant).poles
    poles = poles[np.argsort(-np.abs(poles))]
    angles = _grid([*poles, *plant.poles, *controller.poles], GRID)
    values, feedback, tracking = _responses(controller, plant, angles)

    def loop(angles):
        return loop_transfer(controller, plant, np.exp(1j * angles))

    gain_at = _crossings(lambda angles: np.abs(loop(angles)) - 1.0, angles, np.abs(values) - 1.0)
    phase_at = _crossings(lambda angles: loop(angles).imag, angles, values.imag)
    phase_at = phase_at[loop(phase_at).real < 0.0]
    if values[-1].real < 0.0:
        phase_at = np.append(phase_at, np.pi)  # L is real at half the sample rate
    if _flat_and_negative(loop(LOWEST * np.array([1.0, 2.0]))):
        phase_at = np.append(LOWEST, phase_at)  # L is also real at frequency zero, if the loop has no integrator
    phases = np.mod(np.angle(loop(gain_at)) + np.pi, 2.0 * np.pi)
    factors = -20.0 * np.log10(np.maximum(np.abs(loop(phase_at)), 1e-300))
    difference = np.abs(1.0 + values)
    hertz = 1.0 / (2.0 * np.pi * sample_time)
    return Margins(
        gain_margin=_least(factors[factors > 0.0]),
        gain_reduction_margin=_least(-factors[factors <= 0.0]),
        phase_margin=_least(np.degrees(np.minimum(phases, 2.0 * np.pi - phases))),
        delay_margin=_least(phases / gain_at) * sample_time,
        gain_crossovers=gain_at * hertz,
        phase_crossovers=np.where(phase_at > LOWEST, phase_at, 0.0) * hertz,
        sensitivity_peak=float(np.max(1.0 / difference)),
        complementary_peak=float(np.max(np.abs(values) / difference)),
        bandwidth=_bandwidth(controller, plant, angles, tracking) * hertz,
        noise_gain=_noise_gain(angles, np.abs(values) / difference),
        command_noise_gain=_noise_gain(angles, feedback / difference),
        poles=poles,
        sample_time=sample_time,
    )


def _responses(controller: StateSpace, plant: StateSpace, angles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return L, |command / measurement| of the controller, and |displacement / reference| of the closed loop."""
    z = np.exp(1j * angles)
    commands, displacements = controller.response(z), plant.response(z)
    loop = np.sum(_parts(commands, displacements), axis=1)
    tracking = np.abs(commands[:, 0, 0] * displacements[:, 0, 0] / (1.0 + loop))
    return loop, np.abs(commands[:, 0, 1]), tracking


def _least(values) -> float:
    return float(min(values, default=np.inf))


def _grid(poles, count: int) -> np.ndarray:
    """Return angles in 0 … π: uniform on a linear and on a logarithmic scale, and denser around the resonances."""
    parts = [np.geomspace(LOWEST, np.pi, count), np.linspace(0.0, np.pi, count)[1:]]
    for pole in poles:
        angle, width = abs(np.angle(pole)), max(1.0 - min(abs(pole), 1.0), 1e-9)
        spread = width * np.sinh(np.linspace(-6.0, 6.0, AROUND_POLE))
        parts.append(angle + spread)
    angles = np.unique(np.concatenate(parts))
    return angles[(angles >= LOWEST) & (angles <= np.pi)]


def _flat_and_negative(values) -> bool:
    """Return whether L at the two lowest angles indicates a finite, negative gain at frequency zero."""
    return bool(values[0].real < 0.0 and abs(values[1] - values[0]) < 1e-3 * abs(values[0]))


def _crossings(function, angles, values, rounds: int = ROUNDS) -> np.ndarray:
    """Return the zeros of a function of angles, sampled at ``angles``; intervals with a zero are divided repeatedly."""
    found = []
    for i in np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0)):
        low, high, below = angles[i], angles[i + 1], values[i] < 0.0
        for _ in range(rounds):
            within = np.linspace(low, high, PARTS + 1)
            beyond = int(np.argmax(np.append((function(within[1:-1]) < 0.0) != below, True))) + 1
            low, high = within[beyond - 1], within[beyond]
        found.append(0.5 * (low + high))
    return np.array(found)


def _bandwidth(controller: StateSpace, plant: StateSpace, angles, tracking, rounds: int = ROUNDS) -> float:
    """Return the lowest angle at which the response to the reference, sampled at ``angles``, is -3 dB."""
    wanted = tracking[0] * HALF_POWER
    below = np.flatnonzero(tracking < wanted)
    if not len(below) or not wanted > 0.0:
        return np.inf
    i = below[0]
    if i == 0:
        return float(angles[0])
    around = slice(i - 1, i + 1)

    def level(within):
        return _responses(controller, plant, within)[2] - wanted

    return float(_crossings(level, angles[around], tracking[around] - wanted, rounds)[0])


@dataclass(frozen=True)
class Interval:
    """A figure and its range of uncertainty.

    Parameters
    ----------
    value, low, high : float
    """

    value: float
    low: float
    high: float

    def text(self, digits: str = ".3g", unit: str = "") -> str:
        """Return the figure as text.

        Parameters
        ----------
        digits : str
            Format of the numbers.
        unit : str
        """
        if not np.isfinite(self.value):
            return "none in the band"
        high = f"{self.high:{digits}}" if np.isfinite(self.high) else "?"
        return f"{self.value:{digits}}{unit} ({self.low:{digits}} … {high})"


#: A figure that has no value in the measured band.
NOWHERE = Interval(np.inf, np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """A loop transfer function at measured frequencies.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        [Hz], rising.
    loop : ndarray of complex, shape (F,)
        L.
    radius : ndarray, shape (F,)
        Radius of the circle around L that contains the true value with the requested probability.
    sample_time : float
        [s]
    """

    frequency: np.ndarray
    loop: np.ndarray
    radius: np.ndarray
    sample_time: float

    @property
    def sensitivity(self) -> np.ndarray:
        """S, shape (F,)."""
        return 1.0 / (1.0 + self.loop)

    @property
    def complementary(self) -> np.ndarray:
        """T, shape (F,)."""
        return self.loop * self.sensitivity

    @property
    def sensitivity_radius(self) -> np.ndarray:
        """Radius of the circles around S and around T, equal because S + T = 1, shape (F,)."""
        return np.abs(self.sensitivity) ** 2 * self.radius

    @property
    def sensitivity_peak(self) -> Interval:
        """M_s over the measured frequencies."""
        distance = np.abs(1.0 + self.loop)
        nearest, farthest = np.maximum(distance - self.radius, 0.0), distance + self.radius
        with np.errstate(divide="ignore"):
            return Interval(*(float(np.max(1.0 / size)) for size in (distance, farthest, nearest)))

    @property
    def gain_crossovers(self) -> np.ndarray:
        """Frequencies at which |L| is one [Hz]."""
        return self._crossings(np.log(np.abs(self.loop)))[0]

    @property
    def gain_margin(self) -> Interval:
        """Factor by which the gain may increase [dB]."""
        L, radius, found = self.loop, self.radius, []
        _, places, parts = self._crossings(L.imag)
        for place, part in zip(places, parts, strict=True):
            value = _between(L.real, place, part)
            if not -1.0 < value < 0.0:
                continue
            wide = _between(radius, place, part)
            near = _around(place, np.abs(L.imag) <= radius)
            reach = np.sqrt(np.maximum(radius[near] ** 2 - L.imag[near] ** 2, 0.0))
            sizes = (-value, *np.abs(_ends(-value, wide, -L.real[near] - reach, -L.real[near] + reach))[::-1])
            found.append(Interval(*(float(-20.0 * np.log10(max(size, 1e-12))) for size in sizes)))
        return min(found, key=lambda one: one.value, default=NOWHERE)

    @property
    def phase_margin(self) -> Interval:
        """Smallest distance of the phase from −180 degrees where |L| is one [degrees]."""
        return self._least_phase(lambda phase, angle: np.degrees(phase), folded=True)

    @property
    def delay_margin(self) -> Interval:
        """Tolerated additional delay [samples]."""
        return self._least_phase(lambda phase, angle: phase / angle, folded=False)

    def rows(self, model: Margins | None = None) -> list[tuple[str, str]]:
        """Return (name, text) of each printed row, with the value of the model if it is given."""
        crossing = ", ".join(f"{value:.4g} Hz" for value in self.gain_crossovers) or "none in the band"
        rows = [
            ("gain crossover", crossing),
            ("gain margin", self.gain_margin.text(".1f", " dB")),
            ("phase margin", self.phase_margin.text(".1f", " deg")),
            ("delay margin", self.delay_margin.text(".2f", " samples")),
            ("sensitivity peak M_s", self.sensitivity_peak.text(".3f")),
        ]
        if model is None:
            return rows
        expected = [
            ", ".join(f"{value:.4g} Hz" for value in model.gain_crossovers) or "none",
            f"{model.gain_margin:.1f} dB",
            f"{model.phase_margin:.1f} deg",
            f"{model.delay_margin_samples:.2f} samples",
            f"{model.sensitivity_peak:.3f}",
        ]
        return [(name, f"{text}; model {other}") for (name, text), other in zip(rows, expected, strict=True)]

    def _least_phase(self, figure, folded: bool) -> Interval:
        """Return the smallest ``figure(phase above −180 degrees, angle per sample)`` where |L| = 1, with its range.

        A circle of radius r around L meets the unit circle at the angle of L ± α, with cos α = (1 + |L|² − r²)/(2 |L|).
        """
        size, angles = np.abs(self.loop), 2.0 * np.pi * self.frequency * self.sample_time
        touching = np.abs(size - 1.0) <= self.radius
        _, places, parts = self._crossings(np.log(size))
        found = []
        for place, part in zip(places, parts, strict=True):
            turned = np.angle(self.loop[place + 1] / self.loop[place])
            phase = np.mod(np.angle(self.loop[place]) + part * turned + np.pi, 2.0 * np.pi)
            near = _around(place, touching)
            # the phases at the adjacent frequencies, without jumps of 360 degrees
            phases = phase + np.angle(self.loop[near] / np.exp(1j * (phase - np.pi)))
            cosine = (1.0 + size[near] ** 2 - self.radius[near] ** 2) / (2.0 * size[near])
            half = np.arccos(np.clip(cosine, -1.0, 1.0))
            if folded and phase > np.pi:
                phase, phases = 2.0 * np.pi - phase, 2.0 * np.pi - phases
            wide = np.arcsin(min(_between(self.radius, place, part), 1.0))
            angle = _between(angles, place, part)
            ends = figure(phases - half, angles[near]), figure(phases + half, angles[near])
            value = figure(phase, angle)
            low, high = _ends(value, figure(wide, angle), *ends)
            found.append(Interval(float(value), float(low), float(high)))
        return min(found, key=lambda one: one.value, default=NOWHERE)

    def _crossings(self, values):
        """Return the zero crossings of values: frequency [Hz], index before it, fraction of the step up to it."""
        places = np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0))
        parts = values[places] / (values[places] - values[places + 1])
        frequencies = self.frequency[places] + parts * np.diff(self.frequency)[places]
        return frequencies, places, parts


def loop_of(
    controller: StateSpace, frequency, plant, radius, sample_time: float, model: StateSpace | None = None
) -> MeasuredLoop:
    """Return the loop of a known controller with a measured plant.

    ``controller`` has the output command, and the inputs reference, measured displacement and, with force damping,
    quasi-static displacement. ``plant``, shape (F,), is the sampled response from command to measured displacement at
    ``frequency`` [Hz]; ``radius``, shape (F,), contains the radii of the circles around it. ``model`` has the input
    command, and as outputs all inputs of the controller except the reference; it is needed if there is more than one
    such input. Units: ``sample_time`` [s].
    """
    z = np.exp(2j * np.pi * frequency * sample_time)
    feedback = -controller.response(z)[:, 0, 1]
    loop = feedback * plant
    if model is not None:
        # the quasi-static displacement has only a gain and a delay, both of which the model contains
        loop = loop + np.sum(loop_parts(controller, model, z)[:, 1:], axis=1)
    return MeasuredLoop(frequency, loop, np.abs(feedback) * radius, sample_time)


def _between(values, place: int, part: float) -> float:
    return float(values[place] + part * (values[place + 1] - values[place]))


def _around(place: int, touching) -> np.ndarray:
    """Return the contiguous ``touching`` indices around a crossing between ``place`` and the next index."""
    first, last = place + 1, place
    while first > 0 and touching[first - 1]:
        first -= 1
    while last < touching.size - 1 and touching[last + 1]:
        last += 1
    return np.arange(first, last + 1)


def _ends(value: float, wide: float, lows, highs) -> tuple[float, float]:
    """Return the range of a figure: the extremes of ``value`` ± ``wide`` and of the figure at nearby frequencies."""
    return min([value - wide, *lows]), max([value + wide, *highs])
