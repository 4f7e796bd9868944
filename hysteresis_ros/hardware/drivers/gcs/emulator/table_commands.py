# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Wave generator and data recorder of the emulated controller."""

from __future__ import annotations

from hysteresis_ros.hardware.drivers.gcs.emulator.axis import Axis
from hysteresis_ros.hardware.drivers.gcs.emulator.controller import Controller
from hysteresis_ros.hardware.drivers.gcs.emulator.dictionary import (
    Refusal,
    axis_of,
    command,
    pairs_of,
    real,
    require_free,
    whole,
)
from hysteresis_ros.hardware.drivers.gcs.emulator.recorder import AT_ONCE, OPTIONS, POINTS
from hysteresis_ros.hardware.drivers.gcs.emulator.waves import LONGEST, TABLES, segment
from hysteresis_ros.hardware.drivers.gcs.protocol import (
    NO_TABLE,
    NO_WAVE,
    OUT_OF_RANGE,
    POSITION_LIMIT,
    RANGE_MAXIMUM,
    RANGE_MINIMUM,
    SYNTAX,
    VOLTAGE_LIMIT,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
    WAVE_LENGTH,
    WRONG_COUNT,
)


@command("WAV")
def _define_wave(controller, words):
    """Set waveform definition."""
    if len(words) < 4:
        raise Refusal(WRONG_COUNT)
    table, append, kind = whole(words[0], 1, TABLES), words[1].upper(), words[2].upper()
    if append not in ("X", "&"):
        raise Refusal(SYNTAX)
    points = segment(kind, [real(word) for word in words[3:]])
    before = controller.waves.get(table, []) if append == "&" else []
    # PI's own writewavepoints says where further points begin; 1 puts them behind those that there are
    start = whole(words[3], 1, LONGEST) - 1 if kind == "PNT" else 0
    if start > len(before):
        raise Refusal(OUT_OF_RANGE)
    start = start or len(before)
    if start + len(points) > LONGEST:
        raise Refusal(WAVE_LENGTH)
    controller.waves[table] = before[:start] + points + before[start + len(points) :]


@command("WAV?")
def _wave_length(controller, words):
    """Get length of waveforms."""
    tables = [whole(word, 1, TABLES) for word in words[:1]] or range(1, TABLES + 1)
    return [f"{table} 1={len(controller.waves.get(table, []))}" for table in tables]


@command("GWD?")
def _wave_data(controller, words):
    """Get wave table data."""
    if len(words) != 3:
        raise Refusal(WRONG_COUNT)
    start, count, table = (whole(word, 1, LONGEST) for word in words)
    points = controller.waves.get(table, [])[start - 1 : start - 1 + count]
    head = {"TYPE": 1, "SEPARATOR": 32, "DIM": 1, "SAMPLE_TIME": f"{controller.cycle:.9g}", "NDATA": len(points)}
    return [f"# {name} = {value}" for name, value in head.items()] + [
        "# END_HEADER",
        *(f"{item:.7g}" for item in points),
    ]


@command("WCL")
def _clear_waves(controller, words):
    """Clear wave table data."""
    for word in words:
        controller.waves.pop(whole(word, 1, TABLES), None)


@command("WSL")
def _choose_wave(controller, words):
    """Set connection of wave table to wave generator."""
    for axis, value in pairs_of(controller, words):
        table = whole(str(value), 0, TABLES)
        controller.chosen[axis.name] = table


@command("WSL?")
def _chosen_wave(controller, words):
    """Get connection of wave table to wave generator."""
    return [f"{axis.name}={controller.chosen.get(axis.name, 0)}" for axis in _axes_of(controller, words)]


@command("TWG?")
def _generator_count(controller, words):
    """Get number of wave generators."""
    return [str(len(controller.axes))]


@command("WGC?")
def _repeated(controller, words):
    """Get number of wave generator cycles."""
    return [f"{axis.name}={controller.repeats[axis.name]}" for axis in _axes_of(controller, words)]


def _axes_of(controller: Controller, words: list[str]) -> list[Axis]:
    """Return the axes that are named, or all."""
    return [axis_of(controller, word) for word in words] or list(controller.axes.values())


@command("WGC")
def _repeat_wave(controller, words):
    """Set number of wave generator cycles."""
    for axis, value in pairs_of(controller, words):
        controller.repeats[axis.name] = whole(str(value), 0, 10**9)


@command("WTR")
def _hold_wave(controller, words):
    """Set wave generator table rate."""
    if len(words) != 3:
        raise Refusal(WRONG_COUNT)
    controller.wave_rate = whole(words[1], 1, 10**6)


@command("WTR?")
def _wave_held(controller, words):
    """Get wave generator table rate."""
    return [f"{name}={controller.wave_rate} 1" for name in words or list(controller.axes)]


@command("WGO")
def _start_wave(controller, words):
    """Set wave generator start or stop mode."""
    require_free(controller)
    started = []
    for axis, value in pairs_of(controller, words):
        mode = whole(str(value), 0, 2**16)
        if mode and not controller.waves.get(controller.chosen.get(axis.name, 0)):
            raise Refusal(NO_WAVE)
        started.append((axis, mode))
    for axis, mode in started:
        axis.stop()
        if mode:
            _generate(controller, axis)
    if any(mode for _, mode in started):
        controller.recorder.start()


def _generate(controller: Controller, axis: Axis) -> None:
    low, high = (RANGE_MINIMUM, RANGE_MAXIMUM) if axis.servo else (VOLTAGE_MINIMUM, VOLTAGE_MAXIMUM)
    wave = controller.waves[controller.chosen[axis.name]]
    if min(wave) < float(axis.values[low]) or max(wave) > float(axis.values[high]):
        raise Refusal(POSITION_LIMIT if axis.servo else VOLTAGE_LIMIT)
    scale = axis.unit if axis.servo else 1.0
    axis.generate([scale * point for point in wave], controller.repeats[axis.name], controller.wave_rate)


def _tables(controller: Controller, words: list[str]) -> list[int]:
    count = len(controller.recorder.tables)
    numbers = [int(real(word)) for word in words] or list(range(1, count + 1))
    if not all(1 <= number <= count for number in numbers):
        raise Refusal(NO_TABLE)
    return numbers


@command("TNR?")
def _table_count(controller, words):
    """Get number of record tables."""
    return [str(len(controller.recorder.tables))]


@command("HDR?")
def _record_options(controller, words):
    """Get all data recorder options."""
    options = [f"{number}={text}" for number, text in OPTIONS.items()]
    return [
        "#RecordOptions",
        *options,
        "#TriggerOptions",
        "0=wave generator",
        "1=motion",
        "4=immediately",
        "end of help",
    ]


@command("DRC")
def _configure_recorder(controller, words):
    """Set data recorder configuration."""
    if not words or len(words) % 3:
        raise Refusal(WRONG_COUNT)
    for first in range(0, len(words), 3):
        (table,), axis = _tables(controller, words[first : first + 1]), axis_of(controller, words[first + 1])
        option = int(real(words[first + 2]))
        if option not in OPTIONS:
            raise Refusal(OUT_OF_RANGE)
        controller.recorder.configuration[table - 1] = axis.name, option


@command("DRC?")
def _recorder_configuration(controller, words):
    """Get data recorder configuration."""
    given = controller.recorder.configuration
    return [f"{number}={given[number - 1][0]} {given[number - 1][1]}" for number in _tables(controller, words)]


@command("DRT")
def _trigger(controller, words):
    """Set data recorder trigger source."""
    if not words or len(words) % 3:
        raise Refusal(WRONG_COUNT)
    trigger = whole(words[1], 0, 4)
    controller.recorder.trigger = trigger
    if trigger == AT_ONCE:
        controller.recorder.start()


@command("DRT?")
def _trigger_now(controller, words):
    """Get data recorder trigger source."""
    return [f"{number}={controller.recorder.trigger} 0" for number in _tables(controller, words)]


@command("RTR")
def _record_rate(controller, words):
    """Set record table rate."""
    if len(words) != 1:
        raise Refusal(WRONG_COUNT)
    controller.recorder.rate = whole(words[0], 1, 10**6)


@command("RTR?")
def _record_rate_now(controller, words):
    """Get record table rate."""
    return [str(controller.recorder.rate)]


@command("DRL?")
def _recorded_points(controller, words):
    """Get number of recorded points."""
    return [f"{number}={len(controller.recorder.tables[number - 1])}" for number in _tables(controller, words)]


@command("DRR?")
def _recorded_data(controller, words):
    """Get recorded data values."""
    recorder = controller.recorder
    start = whole(words[0], 1, POINTS) if words else 1
    count = whole(words[1], 0, POINTS) if len(words) > 1 else POINTS
    tables = _tables(controller, words[2:])
    tables = tables if words[2:] else [number for number in tables if recorder.configuration[number - 1][1]]
    if not tables:
        raise Refusal(OUT_OF_RANGE)
    return recorder.lines(start, count, tables, controller.cycle)
