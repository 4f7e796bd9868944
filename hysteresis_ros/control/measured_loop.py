# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A loop as it was measured: loop transfer, sensitivities and margins from lines of a frequency response, with bands.

The loop is cut at the command as in :mod:`hysteresis_ros.control.margins`: S = 1/(1 + L), T = L/(1 + L), and an error δ
of L is one of -S² δ of S and S² δ of T to first order. What a margin may be follows from the circles around L at the
lines: nearest to −1 for the sensitivity, along the real axis for the gain, across it for the phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.control.closed_loop import loop_parts
from hysteresis_ros.control.margins import Margins
from hysteresis_ros.models.state_space import StateSpace


@dataclass(frozen=True)
class Interval:
    """A figure and what it may be.

    Parameters
    ----------
    value, low, high : float
    """

    value: float
    low: float
    high: float

    def text(self, digits: str = ".3g", unit: str = "") -> str:
        """Return it in words.

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


#: A figure that the band does not show.
NOWHERE = Interval(np.inf, np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """A loop transfer at lines.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        [Hz], rising.
    loop : ndarray of complex, shape (F,)
        L.
    radius : ndarray, shape (F,)
        Of the circle that holds the true one with the probability that was asked for.
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
        """Radius around S, and around T as S + T = 1, shape (F,)."""
        return np.abs(self.sensitivity) ** 2 * self.radius

    @property
    def sensitivity_peak(self) -> Interval:
        """M_s, over the lines."""
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
        """Factor by which the gain may grow [dB]."""
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
        """Further delay that the loop bears [samples]."""
        return self._least_phase(lambda phase, angle: phase / angle, folded=False)

    def rows(self, model: Margins | None = None) -> list[tuple[str, str]]:
        """Return (name, text) of what is printed, beside what the model has.

        Parameters
        ----------
        model : Margins, optional
        """
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
        """Return the least figure of phase above −180 degrees and angle a sample where |L| is one, and its ends.

        A circle around L that reaches the unit circle does so at its angle ± α, cos α = (1 + |L|² − r²)/(2 |L|).
        """
        size, angles = np.abs(self.loop), 2.0 * np.pi * self.frequency * self.sample_time
        touching = np.abs(size - 1.0) <= self.radius
        _, places, parts = self._crossings(np.log(size))
        found = []
        for place, part in zip(places, parts, strict=True):
            turned = np.angle(self.loop[place + 1] / self.loop[place])
            phase = np.mod(np.angle(self.loop[place]) + part * turned + np.pi, 2.0 * np.pi)
            near = _around(place, touching)
            # the phases of the lines around, on the same turn
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
        """Return frequencies [Hz] where values pass zero, the places before, and the parts of the way to the next."""
        places = np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0))
        parts = values[places] / (values[places] - values[places + 1])
        frequencies = self.frequency[places] + parts * np.diff(self.frequency)[places]
        return frequencies, places, parts


def loop_of(
    controller: StateSpace, frequency, plant, radius, sample_time: float, model: StateSpace | None = None
) -> MeasuredLoop:
    """Return the loop of a controller that is known and a plant that was measured.

    Parameters
    ----------
    controller : StateSpace
        Inputs (reference, measured), output command; behind a damping by force what acts as third input.
    frequency : ndarray, shape (F,)
        [Hz]
    plant : ndarray of complex, shape (F,)
        Response from command to measured displacement, of samples at the same time.
    radius : ndarray, shape (F,)
        Of the circles around it.
    sample_time : float
        [s]
    model : StateSpace, optional
        From command to the inputs of the controller behind the reference; needed where those are more than one.
    """
    z = np.exp(2j * np.pi * frequency * sample_time)
    feedback = -controller.response(z)[:, 0, 1]
    loop = feedback * plant
    if model is not None:
        # what acts is gain and delay: nothing that a response would show better
        loop = loop + np.sum(loop_parts(controller, model, z)[:, 1:], axis=1)
    return MeasuredLoop(frequency, loop, np.abs(feedback) * radius, sample_time)


def _between(values, place: int, part: float) -> float:
    return float(values[place] + part * (values[place + 1] - values[place]))


def _around(place: int, touching) -> np.ndarray:
    """Return the places whose circles touch, without a gap around a crossing between ``place`` and the next one."""
    first, last = place + 1, place
    while first > 0 and touching[first - 1]:
        first -= 1
    while last < touching.size - 1 and touching[last + 1]:
        last += 1
    return np.arange(first, last + 1)


def _ends(value: float, wide: float, lows, highs) -> tuple[float, float]:
    """Return the ends of what a figure may be: at the crossing itself, and at the lines around it."""
    return min([value - wide, *lows]), max([value + wide, *highs])
