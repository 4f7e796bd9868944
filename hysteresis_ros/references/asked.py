# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A waveform in the words of a command line, ``triangle``, ``5``, ``70um``, as the parameters of the generator."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping
from typing import Any

from hysteresis_ros.errors import ParameterError, Problem, did_you_mean
from hysteresis_ros.parameters import ParameterRow
from hysteresis_ros.references.declaration import PREFIX
from hysteresis_ros.references.waveforms import WAVEFORMS, Waveform, WaveformParameters
from hysteresis_ros.units import quantity, quantity_in


def asked_waveform(kind: str, given: Mapping[str, str], gain: float | None = None) -> dict[str, Any]:
    """Return all parameters of a waveform, those that nobody gave at their defaults.

    Parameters
    ----------
    kind : str
        One of :data:`~hysteresis_ros.references.waveforms.WAVEFORMS`.
    given : mapping of str to str
        Text of each parameter; what belongs to one waveform only may be named without it, ``values`` for
        ``steps.values``. Numbers carry their units or are in SI, those of lists stand between commas.
    gain : float, optional
        Of an axis in open loop without inverse [m/V]: lengths may be given as voltages then, and need a unit.

    Raises
    ------
    ParameterError
        The waveform or a parameter is unknown, missing, or is not what it must be; names begin with ``waveform.``.
    """
    if kind not in WAVEFORMS:
        allowed = f"there is no such waveform; there are {', '.join(WAVEFORMS)}{did_you_mean(kind, WAVEFORMS)}"
        raise ParameterError([Problem(f"{PREFIX}type", kind, allowed)])
    rows = _rows(kind)
    values = {"type": kind, **{name: row.default for name, row in rows.items() if not row.required}}
    problems = []
    for name, text in given.items():
        full = name if name in rows else f"{kind}.{name}"
        if full not in rows:
            words = [known.removeprefix(f"{kind}.") for known in rows]
            allowed = f"{kind} has no such parameter, it has {', '.join(words)}{did_you_mean(name, words)}"
            problems.append(Problem(PREFIX + name, text, allowed))
            continue
        try:
            values[full] = _value(rows[full], text, gain)
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
    if shape.extent != "amplitude":  # levels in metres, at times of their own
        unused |= {"amplitude", "frequency"}
    rows = {row.name: row for row in WaveformParameters.table() if "." not in row.name and row.name not in unused}
    return rows | ({row.name: row for row in shape.parameters.table(f"{kind}.")} if shape.parameters else {})


def played(values: Mapping[str, Any], sample_time: float) -> float:
    """Return how long a waveform lasts [s].

    Parameters
    ----------
    values : mapping of str to object
        Its parameters.
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        It has no end, or cannot be played.
    """
    waveform = Waveform(WaveformParameters.from_mapping(values, PREFIX), sample_time)
    if not waveform.duration_samples:
        allowed = "the waveform has no end; give cycles, or the duration of the run"
        raise ParameterError([Problem(f"{PREFIX}cycles", values["cycles"], allowed)])
    return waveform.duration_samples * sample_time


def _missing(kind: str, values: Mapping[str, Any], rows: Mapping[str, ParameterRow]) -> list[Problem]:
    """Return a Problem for each parameter that has to be given."""
    shape = WAVEFORMS[kind]
    missing = [row.name for row in rows.values() if row.name not in values]
    if shape.extent == "amplitude" and values["amplitude"] == 0.0:
        missing.append("amplitude")
    return [Problem(PREFIX + name, None, f"missing; {kind} needs a {rows[name].allowed()}") for name in missing]


def _value(row: ParameterRow, text: str, gain: float | None):
    """Return the text of a parameter in its type.

    Raises
    ------
    ValueError
        It is none; the text says what is allowed.
    """
    if row.type is str:
        # nodes run elsewhere
        value: Any = str(pathlib.Path(text).expanduser().resolve()) if row.name == "file.path" else text
    elif row.type is int:
        try:
            value = int(text)
        except ValueError:
            raise ValueError(f"must be a whole number, allowed: {row.allowed()}") from None
    elif row.type is float:
        value = _numbers(row, [text], gain)[0]
    else:
        value = _numbers(row, text.split(","), gain)
    try:
        row.convert(value)
    except ParameterError as error:
        raise ValueError(error.problems[0].allowed) from None
    return value


def _numbers(row: ParameterRow, texts: list[str], gain: float | None) -> list[float]:
    """Return numbers in the unit of a parameter.

    Raises
    ------
    ValueError
        One is no number, or has another unit, or none where that is not clear.
    """
    found = [quantity(text) for text in texts]
    voltages = {"V": gain} if gain is not None and row.unit == "m" else {}
    bare = [text for text, (number, unit) in zip(texts, found, strict=True) if number and not unit]
    if bare and voltages:
        raise ValueError(f"{bare[0].strip()} of which unit? Write 60V or 5um")
    if bare and row.unit != "m" and any(unit for _, unit in found):
        raise ValueError(f"{bare[0].strip()} of which unit? Write it behind")
    if not voltages:
        return [quantity_in(text, row.unit) for text in texts]
    allowed = {"": 1.0, row.unit: 1.0} | voltages
    wrong = [unit for _, unit in found if unit not in allowed]
    if wrong:
        raise ValueError(f"is in {wrong[0]}, allowed: {row.allowed()} or in V")
    return [number * allowed[unit] for number, unit in found]
