# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Excitations for identification: recipes, transitions between levels, waveforms from text, and axes that apply them.

Amplitudes and offsets are voltages here. An axis in open loop without inverse outputs reference / gain [V], so
:func:`in_metres` converts a recipe to a waveform in metres for the reference generator.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration, ParameterRow
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, did_you_mean
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.references.declaration import PREFIX
from hysteresis_ros.references.waveforms import WAVEFORMS, Waveform, WaveformParameters
from hysteresis_ros.units import quantity, quantity_in

#: Duration of a transition between two levels [s].
WAY = 0.5
#: Duration of the pause before the measurement, and of the pause after it [s].
REST = 0.5


def way(begin: float, end: float, seconds: float, rate: float) -> np.ndarray:
    """Return a half-cosine transition that begins and ends at rest; ``begin`` itself is not one of its samples.

    Parameters
    ----------
    begin, end : float
        [V] or [m]
    seconds : float
    rate : float
        [Hz]
    """
    count = max(round(seconds * rate), 1)
    return begin + (end - begin) * 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))


def hold(level: float, seconds: float, rate: float) -> np.ndarray:
    """Return the samples of a constant level.

    Parameters
    ----------
    level : float
        [V] or [m]
    seconds : float
    rate : float
        [Hz]
    """
    return np.full(max(round(seconds * rate), 1), level)


def there_and_back(middle: np.ndarray, safe: float, rate: float) -> np.ndarray:
    """Return the samples ``middle`` [V] or [m], shape (N,), with transitions from and to ``safe`` at their ends.

    Units: ``rate`` [Hz].
    """
    parts = [hold(safe, REST, rate), way(safe, middle[0], WAY, rate), middle, way(middle[-1], safe, WAY, rate)]
    return np.concatenate([*parts, hold(safe, REST, rate)])


#: Number of peaks of the recipe ``triangles``, and number of levels of the recipe ``steps``.
PEAKS = 20
#: Number of cycles over the whole range in the recipe ``decaying``.
WHOLE_CYCLES = 2
#: Number of decaying cycles in the recipe ``decaying``.
DECAYING_CYCLES = 20
#: Number of cycles after which the amplitude has fallen to 1/e in the recipe ``decaying``.
DECAY_CYCLES = 5.0
LEVELS = (0.25, 0.75, 0.5, 1.0, 0.0)
#: Peak of small excitations as a fraction of the range; large excitations use the whole range.
SMALL = 0.1
#: Highest frequency that may be requested, as a fraction of the sample rate.
HIGHEST = 0.2
#: Multisine and chirp excite up to this fraction of the sample rate. Above the excited frequencies, a design must
#: assume a resonance, which limits the bandwidth of any feedback that has gain there.
EXCITED = 0.48


@dataclass(frozen=True)
class Excitation:
    """Excitation of a recipe for a range of voltages.

    Parameters
    ----------
    waveform : dict
        Flat parameters of the waveform; amplitudes and levels in V.
    duration : float
        [s]
    samples : ndarray or None
        Voltages [V] of all samples if no waveform of the generator can play the recipe (type ``file``); else None.
    """

    waveform: dict
    duration: float
    samples: np.ndarray | None = None


@dataclass(frozen=True)
class _Asked:
    """Inputs of a recipe: range of the amplifier [V], fraction of this range to use, sample rate [Hz], and options."""

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
    # the largest loop is run twice: the first run begins on the virgin curve, the second one is a closed loop
    volts = np.concatenate([[0.0], *(peak * one for peak in (*peaks, highest))])
    return Excitation({"type": "file", "cycles": 1}, volts.size / asked.sample_rate, volts)


def _decaying(asked: _Asked) -> Excitation:
    cycle = max(round(asked.sample_rate / (asked.frequency or asked.sample_rate / 500.0)), 8)
    index = np.arange(WHOLE_CYCLES * cycle + DECAYING_CYCLES * cycle + 1)
    # the voltage first stays at 0 V, then begins at the low end
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
        "multisine.last_harmonic": max(int(EXCITED * asked.sample_rate / line), 1),
    }
    return Excitation(waveform, asked.duration or 6.0 / line)


def _chirp(asked: _Asked) -> Excitation:
    length = asked.duration or 10000.0 / asked.sample_rate
    waveform = {
        "type": "chirp",
        "offset": asked.middle,
        "amplitude": asked.small,
        "frequency": asked.frequency or 4.0 / length,
        "chirp.final_frequency": EXCITED * asked.sample_rate,
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
    """A recipe and its purpose.

    Parameters
    ----------
    words : str
        Description and purpose.
    make : callable
        Function that returns the recipe's :class:`Excitation`.
    small : bool
        Whether the recipe uses a small fraction of the range by default.
    """

    words: str
    make: Callable[[_Asked], Excitation]
    small: bool = False


#: The recipes, by name.
RECIPES = {
    "triangles": Recipe(
        "triangles whose peak grows in equal steps up to the end of the range: loop models", _triangles
    ),
    "decaying": Recipe("two full cycles, then decaying loops; for minor loops and the α of a Duhem model", _decaying),
    "multisine": Recipe(
        "many frequencies simultaneously, small amplitude, around the middle of the range: linear dynamics",
        _multisine,
        small=True,
    ),
    "chirp": Recipe(
        "sine of rising frequency, small amplitude, around the middle of the range: linear dynamics", _chirp, small=True
    ),
    "steps": Recipe("steps up and down to several levels: lag, overshoot", _steps),
    "creep": Recipe("one large step, held, and back: creep", _creep),
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
        Range of the amplifier [V], which must contain 0 V.
    sample_rate : float
        [Hz]
    frequency : float, optional
        Frequency of triangles and decaying cycles, line spacing of the multisine, or lowest frequency of the chirp
        [Hz].
    amplitude : float
        Factor on the default amplitude of the recipe: 0 … 1, or up to 10 for recipes with a small amplitude.
    duration : float, optional
        Duration [s]. For ``triangles`` and ``decaying`` it is determined by the frequency; a longer run holds the last
        value.

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
    """Return the waveform's parameters in SI units for an axis whose voltage is reference / ``gain`` [m/V]."""
    lengths = {row.name for row in WaveformParameters.table() if row.unit == "m"}
    scaled = {}
    for name, value in excitation.waveform.items():
        if name in lengths:
            value = [item * gain for item in value] if isinstance(value, list) else value * gain
        scaled[name] = value
    return scaled


def asked_waveform(kind: str, given: Mapping[str, str], gain: float | None = None) -> dict[str, Any]:
    """Return all parameters of a waveform; parameters that are not given have their defaults.

    Parameters
    ----------
    kind : str
        One of :data:`~hysteresis_ros.references.waveforms.WAVEFORMS`.
    given : mapping of str to str
        Text of each parameter. Parameters that only this waveform has may be given by their short names, such as
        ``values`` for ``steps.values``. Numbers have units or are in SI units; commas separate the elements of lists.
    gain : float, optional
        Gain of an axis in open loop without inverse [m/V]. If the gain is given, lengths may also be voltages, and must
        have a unit.

    Raises
    ------
    ParameterError
        The waveform is unknown, or a parameter is unknown, missing or wrong; names in the message begin with
        ``waveform.``.
    """
    if kind not in WAVEFORMS:
        remedy = f"unknown waveform; the waveforms are {', '.join(WAVEFORMS)}{did_you_mean(kind, WAVEFORMS)}"
        raise ParameterError([Problem(f"{PREFIX}type", kind, remedy)])
    rows = _rows(kind)
    values = {"type": kind, **{name: row.default for name, row in rows.items() if not row.required}}
    problems = []
    for name, text in given.items():
        full = name if name in rows else f"{kind}.{name}"
        if full not in rows:
            words = [known.removeprefix(f"{kind}.") for known in rows]
            remedy = f"{kind} has no such parameter; it has {', '.join(words)}{did_you_mean(name, words)}"
            problems.append(Problem(PREFIX + name, text, remedy))
            continue
        try:
            values[full] = parameter_value(rows[full], text, gain)
        except ValueError as error:
            problems.append(Problem(PREFIX + full, text, str(error)))
    problems = problems or _missing(kind, values, rows)
    if problems:
        raise ParameterError(problems)
    return values


def _rows(kind: str) -> dict[str, ParameterRow]:
    """Return the parameters that a waveform uses, by name."""
    shape = WAVEFORMS[kind]
    unused = {"type"} | (set() if shape.takes_phase else {"phase"}) | (set() if shape.takes_polarity else {"polarity"})
    if shape.extent != "amplitude":  # the waveform has levels in metres, at given times
        unused |= {"amplitude", "frequency"}
    rows = {row.name: row for row in WaveformParameters.table() if "." not in row.name and row.name not in unused}
    return rows | ({row.name: row for row in shape.parameters.table(f"{kind}.")} if shape.parameters else {})


def played(values: Mapping[str, Any], sample_time: float) -> float:
    """Return the duration of a waveform [s].

    Parameters
    ----------
    values : mapping of str to object
        Parameters of the waveform.
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        The waveform has no end, or cannot be played.
    """
    waveform = Waveform(WaveformParameters.from_mapping(values, PREFIX), sample_time)
    if not waveform.duration_samples:
        remedy = "the waveform has no end; give cycles, or the duration of the run"
        raise ParameterError([Problem(f"{PREFIX}cycles", values["cycles"], remedy)])
    return waveform.duration_samples * sample_time


def _missing(kind: str, values: Mapping[str, Any], rows: Mapping[str, ParameterRow]) -> list[Problem]:
    """Return a Problem for each missing parameter."""
    shape = WAVEFORMS[kind]
    missing = [row.name for row in rows.values() if row.name not in values]
    if shape.extent == "amplitude" and values["amplitude"] == 0.0:
        missing.append("amplitude")
    found = []
    for name in missing:
        row = rows[name]
        example = getattr(shape.example, name.removeprefix(f"{kind}."), None)
        given = ",".join(f"{value:g}{row.unit}" for value in example) if isinstance(example, tuple) else ""
        such = f", such as {given}" if given else ""
        found.append(Problem(PREFIX + name, None, f"missing; {kind} needs {row.description}: a {row.allowed()}{such}"))
    return found


def parameter_value(row: ParameterRow, text: str, gain: float | None = None) -> Any:
    """Return the value of a parameter's text, in the type of the parameter.

    The text is a number with its unit or in SI units, several such numbers separated by commas for an array, a choice,
    or a path. If the ``gain`` [m/V] of an axis in open loop without inverse is given, lengths may be voltages.
    ValueError: the text is not a value of the parameter; the message states what is allowed.
    """
    if row.type is str:
        # the path is absolute, because nodes may run in another folder
        value: Any = str(pathlib.Path(text).expanduser().resolve()) if row.name == "file.path" else text
    elif row.type is int:
        try:
            value = int(text)
        except ValueError:
            raise ValueError(f"must be a whole number, allowed: {row.allowed()}") from None
    elif row.type is float:
        value = _numbers(row, [text], gain)[0]
    elif row.type == tuple[str, ...]:
        value = [word.strip() for word in text.split(",")]
    else:
        value = _numbers(row, text.split(","), gain)
    try:
        row.convert(value)
    except ParameterError as error:
        raise ValueError(error.problems[0].remedy) from None
    return value


def _numbers(row: ParameterRow, texts: list[str], gain: float | None) -> list[float]:
    """Return numbers in the unit of a parameter."""
    found = [quantity(text) for text in texts]
    voltages = {"V": gain} if gain is not None and row.unit == "m" else {}
    bare = [text for text, (number, unit) in zip(texts, found, strict=True) if number and not unit]
    if bare and voltages:
        raise ValueError(f"{bare[0].strip()} of which unit? Write 60V or 5um")
    if bare and row.unit != "m" and any(unit for _, unit in found):
        raise ValueError(f"{bare[0].strip()} of which unit? Write it after the number")
    if not voltages:
        return [quantity_in(text, row.unit) for text in texts]
    allowed = {"": 1.0, row.unit: 1.0} | voltages
    wrong = [unit for _, unit in found if unit not in allowed]
    if wrong:
        raise ValueError(f"is in {wrong[0]}, allowed: {row.allowed()} or in V")
    return [number * allowed[unit] for number, unit in found]


#: Parameters of the motion controller for measurements that switch the feedforward off.
UNFED = {"feedforward__type": "none", "feedforward__preview": 0}
#: Parameters of the motion controller for measurements that switch the learning off.
PLAYED = {"learning__type": "none"}
#: Parameters of the motion controller for measurements with which it outputs the reference unchanged.
OPEN = {"type": "open_loop", "damping__type": "none", **UNFED, **PLAYED}


def write_samples(path, reference, sample_rate: float, **further) -> str:
    """Write a reference [m], shape (N,), for a waveform of type ``file``; return the path of the ``.npz`` file.

    The path is absolute, and its folder is created. ``further`` contains additional arrays for the file. Units:
    ``sample_rate`` [Hz]. ConfigurationError: the file cannot be written.
    """
    path = pathlib.Path(path).resolve()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, time=np.arange(reference.size) / sample_rate, reference=reference, **further)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    return str(path)


def driven(configuration: Configuration, limits: LimitsParameters, gain: float, waveform: dict) -> Configuration:
    """Return the configuration with the axis in open loop without inverse, and with this waveform.

    Parameters
    ----------
    configuration : Configuration
    limits : LimitsParameters
        Limits of the compensator.
    gain : float
        Gain of the compensator without inverse [m/V].
    waveform : dict
        Flat parameters of the waveform [m]; they replace those of the configuration.
    """
    plain = {
        "cycles": 0,
        "phase": 0.0,
        "steps.period": 0.0,
        "multisine.first_harmonic": 1,
        "multisine.harmonic_step": 1,
    }
    low, high = (gain * end for end in (limits.minimum, limits.maximum))
    configuration = configuration.override("", exit_at_end=True, autostart=True)
    configuration = configuration.override("motion_controller", **OPEN)
    configuration = configuration.override("hysteresis_compensator", inverse__type="none")
    return configuration.override(
        "reference_generator",
        minimum=low,
        maximum=high,
        initial_setpoint=min(max(0.0, low), high),
        approach__maximum_velocity=0.0,
        approach__maximum_acceleration=0.0,
        approach__maximum_jerk=0.0,
        approach__from_rest=False,
        **{f"waveform.{name}": value for name, value in {**plain, **waveform}.items()},
    )


def following(configuration: Configuration, path: str, rest: float = 0.0) -> Configuration:
    """Return a configuration whose axis follows the samples once, from the first to the last one.

    Parameters
    ----------
    configuration : Configuration
    path : str
        Path that :func:`write_samples` returned.
    rest : float
        Setpoint at which the axis begins [m]; the samples are absolute positions, not relative to this setpoint.
    """
    values = {"type": "file", "cycles": 1, "phase": 0.0, "offset": -rest, "file.path": path, "file.column": "reference"}
    configuration = configuration.override(
        "reference_generator",
        initial_setpoint=rest,
        **{f"approach.maximum_{name}": 0.0 for name in ("velocity", "acceleration", "jerk")},
        **{"approach.from_rest": False},
        **{f"waveform.{name}": value for name, value in values.items()},
    )
    return configuration.override("", exit_at_end=True, autostart=True)
