"""Excitations that identifications need, as waveforms within the range of an amplifier.

Amplitudes and offsets are voltages here: an axis in open loop without inverse puts out reference / gain, so that
:func:`in_metres` turns a recipe into a waveform of the reference generator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ConfigurationError

#: Recipes, and which identification each serves.
RECIPES = {
    "triangles": "triangles whose peak grows in equal steps up to the end of the range (6 … 120 V): loop models",
    "decaying": "two whole cycles, then an amplitude that dies out: minor loops, alpha of Duhem",
    "multisine": "many frequencies at once, small, around the middle of the range: linear dynamics",
    "chirp": "sine of rising frequency, small, around the middle of the range: linear dynamics",
    "steps": "steps up and down to several levels: lag, overshoot",
    "creep": "one large step that is held, and back: creep",
}
#: Peaks of the triangles, levels of the steps.
PEAKS = 20
#: Cycles of the decaying recipe: over the whole range, decaying, and those in which the amplitude falls to 1/e.
WHOLE_CYCLES, DECAYING_CYCLES, DECAY_CYCLES = 2, 20, 5.0
LEVELS = (0.25, 0.75, 0.5, 1.0, 0.0)
#: Small excitations take this part of the range (peak), large ones all of it.
SMALL = 0.1
#: Frequencies stay below this part of the sample rate.
HIGHEST = 0.2
#: Names of waveform parameters that are displacements.
LENGTHS = ("amplitude", "offset", "steps.values")


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
        raise ConfigurationError(f"recipe {name!r}: must be one of {', '.join(RECIPES)}")
    small = name in ("multisine", "chirp")
    largest = 0.5 / SMALL if small else 1.0
    if not 0.0 < amplitude <= largest:
        raise ConfigurationError(f"amplitude {amplitude:g}: must be above 0 and at most {largest:g} for {name}")
    if frequency is not None and not 0.0 < frequency <= HIGHEST * sample_rate:
        raise ConfigurationError(
            f"frequency {frequency:g} Hz: must be above 0 and at most {HIGHEST * sample_rate:g} Hz"
        )
    if duration is not None and not 4.0 / sample_rate < duration < float("inf"):
        raise ConfigurationError(f"duration {duration:g} s: must be above {4.0 / sample_rate:g} s")
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if name == "triangles":
        return _triangles(high * amplitude, sample_rate, frequency or sample_rate / 500.0)
    if name == "decaying":
        return _decaying(middle, half * amplitude, sample_rate, frequency or sample_rate / 500.0)
    if name == "multisine":
        line = frequency or sample_rate / 2000.0
        waveform = {
            "type": "multisine",
            "offset": middle,
            "amplitude": 2.0 * half * SMALL * amplitude,
            "frequency": line,
            "multisine.last_harmonic": max(int(2.0 * HIGHEST * sample_rate / line), 1),
        }
        return Excitation(waveform, duration or 6.0 / line)
    if name == "chirp":
        length = duration or 10000.0 / sample_rate
        waveform = {
            "type": "chirp",
            "offset": middle,
            "amplitude": 2.0 * half * SMALL * amplitude,
            "frequency": frequency or 4.0 / length,
            "chirp.final_frequency": 2.0 * HIGHEST * sample_rate,
            "chirp.duration": length,
            "chirp.sweep": "logarithmic",
        }
        return Excitation(waveform, length)
    if name == "steps":
        length = duration or 5000.0 / sample_rate
        times = length * (np.arange(len(LEVELS)) + 0.2) / (len(LEVELS) + 0.2)
        values = [high * amplitude * level for level in LEVELS]
        return Excitation({"type": "steps", "steps.values": values, "steps.times": times.tolist()}, length)
    length = duration or 60.0
    waveform = {
        "type": "steps",
        "steps.values": [0.8 * high * amplitude, 0.0],
        "steps.times": [0.02 * length, 0.5 * length],
    }
    return Excitation(waveform, length)


def _triangles(highest: float, sample_rate: float, frequency: float) -> Excitation:
    branch = max(round(0.5 * sample_rate / frequency), 2)
    rise = np.arange(1, branch + 1) / branch
    peaks = highest * np.arange(1, PEAKS + 1) / PEAKS
    one = np.concatenate([rise, 1.0 - rise])
    # the largest loop twice: once on the virgin curve, once closed
    volts = np.concatenate([[0.0], *(peak * one for peak in (*peaks, highest))])
    return Excitation({"type": "file", "cycles": 1}, volts.size / sample_rate, volts)


def _decaying(middle: float, half: float, sample_rate: float, frequency: float) -> Excitation:
    cycle = max(round(sample_rate / frequency), 8)
    index = np.arange(WHOLE_CYCLES * cycle + DECAYING_CYCLES * cycle + 1)
    # at rest at 0 V first, then from the low end
    fall = np.exp(-np.maximum(index - WHOLE_CYCLES * cycle, 0) / (DECAY_CYCLES * cycle))
    volts = middle - half * fall * np.cos(2.0 * np.pi * index / cycle)
    return Excitation({"type": "file", "cycles": 1}, volts.size / sample_rate, volts)


def in_metres(excitation: Excitation, gain: float) -> dict:
    """Return the waveform's parameters in SI for a reference that is divided by ``gain`` on its way to the amplifier.

    Parameters
    ----------
    excitation : Excitation
    gain : float
        Of the compensator without inverse [m/V].
    """
    scaled = {}
    for name, value in excitation.waveform.items():
        if name in LENGTHS:
            value = [item * gain for item in value] if isinstance(value, list) else value * gain
        scaled[name] = value
    return scaled
