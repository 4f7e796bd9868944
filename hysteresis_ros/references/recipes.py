# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Excitations that identifications need, as waveforms within the range of an amplifier.

Amplitudes and offsets are voltages here: an axis in open loop without inverse puts out reference / gain, so that
:func:`in_metres` turns a recipe into a waveform of the reference generator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.references.waveforms import WaveformParameters

#: Peaks of the triangles, levels of the steps.
PEAKS = 20
#: Cycles of the decaying recipe: over the whole range, decaying, and those in which the amplitude falls to 1/e.
WHOLE_CYCLES, DECAYING_CYCLES, DECAY_CYCLES = 2, 20, 5.0
LEVELS = (0.25, 0.75, 0.5, 1.0, 0.0)
#: Small excitations take this part of the range (peak), large ones all of it.
SMALL = 0.1
#: Frequencies stay below this part of the sample rate.
HIGHEST = 0.2


@dataclass(frozen=True)
class Excitation:
    """A recipe for one range of voltage.

    Parameters
    ----------
    waveform : dict
        Parameters of the waveform, flat; amplitudes and levels in V.
    duration : float
        [s]
    samples : ndarray or None
        Voltages [V] sample by sample where no waveform of the generator fits (type ``file``).
    """

    waveform: dict
    duration: float
    samples: np.ndarray | None = None


@dataclass(frozen=True)
class _Asked:
    """What a recipe is given: the range [V] of the amplifier and how much of it, sample rate [Hz], and the options."""

    low: float
    high: float
    amplitude: float
    sample_rate: float
    frequency: float | None
    duration: float | None

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> float:
        return 0.5 * (self.high - self.low)

    @property
    def small(self) -> float:
        """Amplitude of a small excitation."""
        return 2.0 * self.half * SMALL * self.amplitude


def _triangles(asked: _Asked) -> Excitation:
    frequency = asked.frequency or asked.sample_rate / 500.0
    branch = max(round(0.5 * asked.sample_rate / frequency), 2)
    rise = np.arange(1, branch + 1) / branch
    highest = asked.high * asked.amplitude
    peaks = highest * np.arange(1, PEAKS + 1) / PEAKS
    one = np.concatenate([rise, 1.0 - rise])
    # the largest loop twice: once on the virgin curve, once closed
    volts = np.concatenate([[0.0], *(peak * one for peak in (*peaks, highest))])
    return Excitation({"type": "file", "cycles": 1}, volts.size / asked.sample_rate, volts)


def _decaying(asked: _Asked) -> Excitation:
    cycle = max(round(asked.sample_rate / (asked.frequency or asked.sample_rate / 500.0)), 8)
    index = np.arange(WHOLE_CYCLES * cycle + DECAYING_CYCLES * cycle + 1)
    # at rest at 0 V first, then from the low end
    fall = np.exp(-np.maximum(index - WHOLE_CYCLES * cycle, 0) / (DECAY_CYCLES * cycle))
    volts = asked.middle - asked.half * asked.amplitude * fall * np.cos(2.0 * np.pi * index / cycle)
    return Excitation({"type": "file", "cycles": 1}, volts.size / asked.sample_rate, volts)


def _multisine(asked: _Asked) -> Excitation:
    line = asked.frequency or asked.sample_rate / 2000.0
    waveform = {
        "type": "multisine",
        "offset": asked.middle,
        "amplitude": asked.small,
        "frequency": line,
        "multisine.last_harmonic": max(int(2.0 * HIGHEST * asked.sample_rate / line), 1),
    }
    return Excitation(waveform, asked.duration or 6.0 / line)


def _chirp(asked: _Asked) -> Excitation:
    length = asked.duration or 10000.0 / asked.sample_rate
    waveform = {
        "type": "chirp",
        "offset": asked.middle,
        "amplitude": asked.small,
        "frequency": asked.frequency or 4.0 / length,
        "chirp.final_frequency": 2.0 * HIGHEST * asked.sample_rate,
        "chirp.duration": length,
        "chirp.sweep": "logarithmic",
    }
    return Excitation(waveform, length)


def _steps(asked: _Asked) -> Excitation:
    length = asked.duration or 5000.0 / asked.sample_rate
    times = length * (np.arange(len(LEVELS)) + 0.2) / (len(LEVELS) + 0.2)
    values = [asked.high * asked.amplitude * level for level in LEVELS]
    return Excitation({"type": "steps", "steps.values": values, "steps.times": times.tolist()}, length)


def _creep(asked: _Asked) -> Excitation:
    length = asked.duration or 60.0
    waveform = {
        "type": "steps",
        "steps.values": [0.8 * asked.high * asked.amplitude, 0.0],
        "steps.times": [0.02 * length, 0.5 * length],
    }
    return Excitation(waveform, length)


@dataclass(frozen=True)
class Recipe:
    """A recipe, and which identification it serves.

    Parameters
    ----------
    words : str
        What it is and what it is for.
    make : callable
        Returns its :class:`Excitation`.
    small : bool
        Whether it takes a small part of the range by default.
    """

    words: str
    make: Callable[[_Asked], Excitation]
    small: bool = False


#: The recipes by name.
RECIPES = {
    "triangles": Recipe(
        "triangles whose peak grows in equal steps up to the end of the range: loop models", _triangles
    ),
    "decaying": Recipe("two whole cycles, then an amplitude that dies out: minor loops, alpha of Duhem", _decaying),
    "multisine": Recipe(
        "many frequencies at once, small, around the middle of the range: linear dynamics", _multisine, small=True
    ),
    "chirp": Recipe(
        "sine of rising frequency, small, around the middle of the range: linear dynamics", _chirp, small=True
    ),
    "steps": Recipe("steps up and down to several levels: lag, overshoot", _steps),
    "creep": Recipe("one large step that is held, and back: creep", _creep),
}


def recipe(
    name: str,
    low: float,
    high: float,
    sample_rate: float,
    frequency: float | None = None,
    amplitude: float = 1.0,
    duration: float | None = None,
) -> Excitation:
    """Return the excitation ``name`` for voltages ``low`` … ``high`` [V].

    Parameters
    ----------
    name : str
        One of :data:`RECIPES`.
    low, high : float
        Range of the amplifier [V]; 0 V is in it.
    sample_rate : float
        [Hz]
    frequency : float, optional
        Cycles per second of triangles and decaying, distance of lines of the multisine, lowest of the chirp [Hz].
    amplitude : float
        Part of what the recipe takes by default, 0 … 1 (small ones: up to 10).
    duration : float, optional
        [s]; those of triangles and decaying follow from the frequency, a longer run holds their end.

    Raises
    ------
    ConfigurationError
        The recipe is unknown, or a number is out of range.
    """
    if name not in RECIPES:
        near = did_you_mean(name, RECIPES)
        raise ConfigurationError(f"recipe {name!r}: must be one of {', '.join(RECIPES)}{near}")
    chosen = RECIPES[name]
    largest = 0.5 / SMALL if chosen.small else 1.0
    if not 0.0 < amplitude <= largest:
        raise ConfigurationError(f"amplitude {amplitude:g}: must be above 0 and at most {largest:g} for {name}")
    if frequency is not None and not 0.0 < frequency <= HIGHEST * sample_rate:
        raise ConfigurationError(
            f"frequency {frequency:g} Hz: must be above 0 and at most {HIGHEST * sample_rate:g} Hz"
        )
    if duration is not None and not 4.0 / sample_rate < duration < float("inf"):
        raise ConfigurationError(f"duration {duration:g} s: must be above {4.0 / sample_rate:g} s")
    return chosen.make(_Asked(low, high, amplitude, sample_rate, frequency, duration))


def in_metres(excitation: Excitation, gain: float) -> dict:
    """Return the waveform's parameters in SI for a reference that is divided by ``gain`` on its way to the amplifier.

    Parameters
    ----------
    excitation : Excitation
    gain : float
        Of the compensator without inverse [m/V].
    """
    lengths = {row.name for row in WaveformParameters.table() if row.unit == "m"}
    scaled = {}
    for name, value in excitation.waveform.items():
        if name in lengths:
            value = [item * gain for item in value] if isinstance(value, list) else value * gain
        scaled[name] = value
    return scaled
