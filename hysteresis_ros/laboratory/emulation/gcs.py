# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The protocol of an emulated GCS 2.0 controller: its commands, and the answers to any bytes."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import EmulatedDevice
from hysteresis_ros.hardware.drivers.gcs import (
    AXIS_UNIT,
    BUSY,
    GENERATOR_RUNS,
    GENERATOR_STATUS,
    MOTION_STATUS,
    NO_TABLE,
    NO_WAVE,
    NOT_READY,
    OUT_OF_RANGE,
    POSITION_LIMIT,
    RANGE_MAXIMUM,
    RANGE_MINIMUM,
    READ_ONLY,
    READY,
    READY_STATUS,
    RECORD_POINTS,
    RECORD_TABLES,
    SERVO_CYCLE,
    SERVO_OFF,
    SERVO_ON,
    SETTLING,
    STATUS,
    STOP,
    SYNTAX,
    TOLERANCE,
    TOO_LONG,
    TRIGGER_AXIS,
    UNITS,
    UNKNOWN_COMMAND,
    UNKNOWN_PARAMETER,
    VOLTAGE_LIMIT,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
    WAVE_LENGTH,
    WAVE_POINTS,
    WAVE_TYPE,
    WRONG_AXIS,
    WRONG_COUNT,
    GcsParameters,
)
from hysteresis_ros.laboratory.emulation.bench import Bench, DeviceFaults, Running
from hysteresis_ros.laboratory.emulation.gcs_controller import (
    AT_ONCE,
    BY_MOTION,
    MODELS,
    OPTIONS,
    POINTS,
    Axis,
    Controller,
    TriggerLine,
)
from hysteresis_ros.laboratory.emulation.server import serving

Command = Callable[[Controller, list[str]], list[str] | None]

#: Commands by name; their docstrings describe them.
COMMANDS: dict[str, Command] = {}


class Refusal(Exception):
    """Raised when a command is refused; the argument is the error code."""


def command(*names: str) -> Callable[[Command], Command]:
    """Return a decorator that registers a command under its names."""

    def enter(function: Command) -> Command:
        COMMANDS.update(dict.fromkeys(names, function))
        return function

    return enter


def real(text: str) -> float:
    """Return a word as a number."""
    try:
        value = float(text)
    except ValueError:
        raise Refusal(SYNTAX) from None
    if not math.isfinite(value):
        raise Refusal(SYNTAX)
    return value


def whole(text: str, low: int, high: int) -> int:
    """Return a word as an integer within a range."""
    value = real(text)
    if value != int(value) or not low <= value <= high:
        raise Refusal(OUT_OF_RANGE)
    return int(value)


def axis_of(controller: Controller, name: str) -> Axis:
    """Return the axis with a name."""
    if name not in controller.axes:
        raise Refusal(WRONG_AXIS)
    return controller.axes[name]


def pairs_of(controller: Controller, words: list[str]) -> Iterator[tuple[Axis, float]]:
    """Check all pairs of axis and number, then yield them."""
    if not words or len(words) % 2:
        raise Refusal(WRONG_COUNT)
    pairs = [(axis_of(controller, name), real(text)) for name, text in zip(words[::2], words[1::2], strict=True)]
    return iter(pairs)


def require_free(controller: Controller) -> None:
    """Refuse a command while the controller has an error or is busy."""
    lasting = controller.faults.value("error")
    if lasting is not None:
        raise Refusal(int(lasting))
    if controller.busy:
        raise Refusal(BUSY)


#: Maximum number of points of a wave table.
LONGEST_WAVE = 65536
#: Number of wave tables.
TABLES = 8
#: Number of parameters of each wave type: length of the segment, amplitude, offset, length of the curve, start, and
#: parameters of the shape. A segment of single points (PNT) has the first index, the number of points, and the points.
SHAPES = {"SIN_P": 6, "RAMP": 7, "LIN": 6}


def segment(kind: str, numbers: list[float]) -> list[float]:
    """Return the points of a segment."""
    if kind == "PNT":
        if len(numbers) < 3 or numbers[1] != len(numbers) - 2:
            raise Refusal(WRONG_COUNT)
        return numbers[2:]
    if kind not in SHAPES:
        raise Refusal(WAVE_TYPE)
    if len(numbers) != SHAPES[kind]:
        raise Refusal(WRONG_COUNT)
    length, amplitude, offset, curve, start, *shape = numbers
    if not (1.0 <= length <= LONGEST_WAVE and 1.0 <= curve <= LONGEST_WAVE):
        raise Refusal(WAVE_LENGTH)
    if start < 0.0 or start + curve > length or any(not 0.0 <= item <= curve for item in shape):
        raise Refusal(OUT_OF_RANGE)
    form = {"SIN_P": _sine, "RAMP": _ramp, "LIN": _line}[kind]
    begin, count = int(start), int(curve)
    points = [form(point, count, shape) for point in range(count)]
    last = points[-1] if kind == "LIN" else 0.0
    whole = [0.0] * begin + points + [last] * (int(length) - begin - count)
    return [offset + amplitude * point for point in whole]


def _sine(point: int, count: int, shape: list[float]) -> float:
    """Return a point of an inverted cosine with its top at the centre of the curve."""
    centre = shape[0] or 0.5 * count
    part = point / centre if point < centre else 2.0 - (count - point) / max(count - centre, 1.0)
    return 0.5 - 0.5 * math.cos(math.pi * part)


def _line(point: int, count: int, shape: list[float]) -> float:
    """Return a point of a line with parabolic ends of ``shape[0]`` points."""
    bend = min(shape[0], 0.5 * count)
    speed = 1.0 / max(count - bend, 1.0)
    if point < bend:
        return 0.5 * speed * point * point / bend
    if point > count - bend:
        return 1.0 - 0.5 * speed * (count - point) ** 2 / bend
    return speed * (point - 0.5 * bend)


def _ramp(point: int, count: int, shape: list[float]) -> float:
    """Return a point of a curve: a line up to its centre, and then a line down."""
    bend, centre = shape
    centre = centre or 0.5 * count
    if point < centre:
        return _line(point, int(centre), [bend])
    return 1.0 - _line(point - int(centre), max(int(count - centre), 1), [bend])


#: Parameters that can be written.
WRITABLE = (AXIS_UNIT, TOLERANCE, SETTLING, RECORD_TABLES, 0x06000500)


def _of_each(name: str, text: str, value: Callable[[Axis], str]) -> None:
    """Add a query about the named axes, or about all axes."""

    def ask(controller: Controller, words: list[str]) -> list[str]:
        axes = [axis_of(controller, word) for word in words] or list(controller.axes.values())
        return [f"{axis.name}={value(axis)}" for axis in axes]

    ask.__doc__ = text
    command(name)(ask)


def _fixed(value: float) -> str:
    return f"{value:.6f}"


_of_each("POS?", "get real position", lambda axis: _fixed(axis.plant.measured / axis.unit))
_of_each("MOV?", "get target position", lambda axis: _fixed(axis.target / axis.unit))
_of_each("ONT?", "get on-target state", lambda axis: str(int(axis.on_target)))
_of_each("SVO?", "get servo mode", lambda axis: str(int(axis.servo)))
_of_each("SVA?", "get open-loop control value", lambda axis: _fixed(axis.open_value))
_of_each("VOL?", "get voltage of output signal channel", lambda axis: _fixed(axis.plant.voltage))
_of_each("VMI?", "get minimum voltage", lambda axis: _fixed(float(axis.values[VOLTAGE_MINIMUM])))
_of_each("VMA?", "get maximum voltage", lambda axis: _fixed(float(axis.values[VOLTAGE_MAXIMUM])))
_of_each("TMN?", "get minimum commandable position", lambda axis: _fixed(float(axis.values[RANGE_MINIMUM])))
_of_each("TMX?", "get maximum commandable position", lambda axis: _fixed(float(axis.values[RANGE_MAXIMUM])))
_of_each("VEL?", "get closed-loop velocity", lambda axis: _fixed(axis.velocity / axis.unit))
_of_each("CST?", "get stage type", lambda axis: "EMULATED")
_of_each("PUN?", "get position unit", lambda axis: str(axis.values[AXIS_UNIT]))
_of_each("ATZ?", "get automatic zero point calibration", lambda axis: "1")
_of_each("FRF?", "get referencing result; the emulated sensor is absolute", lambda axis: "1")
_of_each("AOS?", "get analog input offset", lambda axis: _fixed(0.0))
_of_each("WGO?", "get wave generator start mode", lambda axis: str(int(axis.generating)))


def _of_inputs(name: str, text: str, value: Callable[[float], str]) -> None:
    """Add a query about the named input signals, or about all input signals; an input without an axis measures 0."""

    def ask(controller: Controller, words: list[str]) -> list[str]:
        """Answer the query."""
        numbers = [whole(word, 1, controller.model.inputs) for word in words] or range(1, controller.model.inputs + 1)
        axes = controller.axes
        measured = [axes[str(n)].plant.measured / axes[str(n)].unit if str(n) in axes else 0.0 for n in numbers]
        return [f"{number}={value(item)}" for number, item in zip(numbers, measured, strict=True)]

    ask.__doc__ = text
    command(name)(ask)


_of_inputs("TSP?", "get input signal position value", _fixed)
_of_inputs("TAD?", "get ADC value of input signal", lambda position: str(round(1000.0 * position)))


@command("*IDN?", "IDN?")
def _identify(controller, words):
    """Get device identification."""
    return [controller.model.identification]


@command("VER?")
def _versions(controller, words):
    """Get versions of firmware and drivers."""
    return [f"FW_DSP: V1.000 of {controller.model.identification.split(', ')[1]} (emulated)"]


@command("SSN?")
def _serial_number(controller, words):
    """Get device serial number."""
    return [controller.model.identification.split(", ")[2]]


@command("CSV?")
def _syntax(controller, words):
    """Get current syntax version."""
    return ["2.0"]


@command("ERR?")
def _error(controller, words):
    """Get error number."""
    return [str(controller.take_error())]


@command("SAI?")
def _axes(controller, words):
    """Get list of current axis identifiers."""
    return list(controller.axes)


@command("HLP?")
def _help(controller, words):
    """Get list of available commands."""
    singles = [
        f"#{code} {text}" for code, text in ((4, "status"), (5, "motion"), (7, "ready"), (9, "generator"), (24, "stop"))
    ]
    named = [f"{name} {(COMMANDS[name].__doc__ or '').rstrip('.').lower()}" for name in sorted(COMMANDS)]
    return ["The following commands are available:", *singles, *named, "end of help"]


@command("HPA?")
def _parameters(controller, words):
    """Get list of available parameters."""
    values = next(iter(controller.axes.values())).values
    return ["The following parameters are valid:", *(f"0x{number:X}=\t0\t1\tFLOAT" for number in values), "end of help"]


@command("IFC?", "IFS?")
def _interface(controller, words):
    """Get interface parameters."""
    given = {
        "RSBAUD": "115200",
        "IPSTART": "1",
        "IPADR": "127.0.0.1:50000",
        "IPMASK": "255.0.0.0",
        "MACADR": "0:0:0:0:0:0",
    }
    names = [word.upper() for word in words] or list(given)
    if not set(names) <= set(given):
        raise Refusal(SYNTAX)
    return [f"{name}={given[name]}" for name in names]


@command("CCL")
def _level(controller, words):
    """Set command level; all parameters are writable at any level."""
    if not words:
        raise Refusal(WRONG_COUNT)


@command("CCL?")
def _level_now(controller, words):
    """Get command level."""
    return ["0"]


@command("SVO")
def _servo(controller, words):
    """Set servo mode."""
    require_free(controller)
    for axis, value in pairs_of(controller, words):
        if value not in (0.0, 1.0):
            raise Refusal(OUT_OF_RANGE)
        axis.switch(bool(value))


@command("MOV")
def _move(controller, words):
    """Set target position."""
    _set_targets(controller, words, relative=False)


@command("MVR")
def _move_relative(controller, words):
    """Set target relative to the last target position."""
    _set_targets(controller, words, relative=True)


def _set_targets(controller: Controller, words: list[str], relative: bool) -> None:
    require_free(controller)
    targets = []
    for axis, value in pairs_of(controller, words):
        target = value + (axis.target / axis.unit if relative else 0.0)
        if not axis.servo:
            raise Refusal(SERVO_OFF)
        if axis.generating:
            raise Refusal(GENERATOR_RUNS)
        if not float(axis.values[RANGE_MINIMUM]) <= target <= float(axis.values[RANGE_MAXIMUM]):
            raise Refusal(POSITION_LIMIT)
        targets.append((axis, target * axis.unit))
    for axis, target in targets:
        axis.move(target)
    _recorded(controller)


@command("SVA")
def _open_loop(controller, words):
    """Set open-loop control value."""
    _set_open_values(controller, words, relative=False)


@command("SVR")
def _open_loop_relative(controller, words):
    """Set relative open-loop control value."""
    _set_open_values(controller, words, relative=True)


def _set_open_values(controller: Controller, words: list[str], relative: bool) -> None:
    require_free(controller)
    values = []
    for axis, value in pairs_of(controller, words):
        value += axis.open_value if relative else 0.0
        if axis.servo:
            raise Refusal(SERVO_ON)
        if axis.generating:
            raise Refusal(GENERATOR_RUNS)
        if not float(axis.values[VOLTAGE_MINIMUM]) <= value <= float(axis.values[VOLTAGE_MAXIMUM]):
            raise Refusal(VOLTAGE_LIMIT)
        values.append((axis, value))
    for axis, value in values:
        axis.open_value = value
    _recorded(controller)


def _recorded(controller: Controller) -> None:
    if controller.recorder.trigger == BY_MOTION:
        controller.recorder.start()


@command("VEL")
def _velocity(controller, words):
    """Set closed-loop velocity."""
    for axis, value in list(pairs_of(controller, words)):
        if value <= 0.0:
            raise Refusal(OUT_OF_RANGE)
        axis.velocity = value * axis.unit


@command("ATZ")
def _zero(controller, words):
    """Set automatic zero point calibration; the emulated sensor needs none."""
    for word in words[::2]:
        axis_of(controller, word)


@command("FRF")
def _reference(controller, words):
    """Reference axes; the emulated sensor is absolute."""
    for word in words:
        axis_of(controller, word)


@command("STP", "HLT")
def _stop(controller, words):
    """Stop axes."""
    controller.stop([axis_of(controller, word) for word in words] or list(controller.axes.values()))


def _parameter(controller: Controller, words: list[str]) -> tuple[Axis, int]:
    if len(words) < 2:
        raise Refusal(WRONG_COUNT)
    axis = axis_of(controller, words[0])
    try:
        return axis, int(words[1], 0)
    except ValueError:
        raise Refusal(SYNTAX) from None


@command("SPA?", "SEP?")
def _get_parameter(controller, words):
    """Get parameters."""
    axis, place = _parameter(controller, words)
    recorder = controller.recorder
    values = {
        SERVO_CYCLE: controller.cycle,
        WAVE_POINTS: LONGEST_WAVE,
        RECORD_POINTS: POINTS,
        RECORD_TABLES: len(recorder.tables),
        0x3C: "EMULATED",
        **controller.own,
        **axis.values,
    }
    if place not in values:
        raise Refusal(UNKNOWN_PARAMETER)
    value = values[place]
    text = f"{value:.8e}" if isinstance(value, float) else str(value)
    asked = f"0x{place:x}" if controller.model.strips else words[1].lower()
    return [f"{axis.name} {asked}={text}"]


@command("SPA")
def _set_parameter(controller, words):
    """Set parameters."""
    axis, place = _parameter(controller, words)
    if len(words) != 3:
        raise Refusal(WRONG_COUNT)
    if place not in WRITABLE:
        raise Refusal(READ_ONLY)
    if place == RECORD_TABLES:
        controller.recorder.resize(whole(words[2], 1, TABLES))
    elif place == AXIS_UNIT:
        if words[2].lower() not in UNITS:
            raise Refusal(OUT_OF_RANGE)
        before = axis.unit
        axis.values[AXIS_UNIT] = words[2].upper()
        for limit in (RANGE_MINIMUM, RANGE_MAXIMUM, TOLERANCE):
            axis.values[limit] = float(axis.values[limit]) * before / axis.unit
    else:
        (axis.values if place in axis.values else controller.own)[place] = real(words[2])


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
    # PI's function writewavepoints passes the start position of the added points; position 1 appends
    start = whole(words[3], 1, LONGEST_WAVE) - 1 if kind == "PNT" else 0
    if start > len(before):
        raise Refusal(OUT_OF_RANGE)
    start = start or len(before)
    if start + len(points) > LONGEST_WAVE:
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
    start, count, table = (whole(word, 1, LONGEST_WAVE) for word in words)
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
    """Return the named axes, or all axes if none is named."""
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


def _line_of(controller: Controller, name: str) -> TriggerLine:
    if name not in controller.lines:
        raise Refusal(OUT_OF_RANGE)
    return controller.lines[name]


@command("CTO")
def _configure_trigger(controller, words):
    """Set configuration of trigger output."""
    if not words or len(words) % 3:
        raise Refusal(WRONG_COUNT)
    given = []
    for first in range(0, len(words), 3):
        line, place = _line_of(controller, words[first]), int(real(words[first + 1]))
        if place not in line.values:
            raise Refusal(OUT_OF_RANGE)
        text = words[first + 2]
        given.append((line, place, axis_of(controller, text).name if place == TRIGGER_AXIS else real(text)))
    for line, place, value in given:
        line.values[place] = value


@command("CTO?")
def _trigger_configuration(controller, words):
    """Get configuration of trigger output."""
    if len(words) != 2:
        raise Refusal(WRONG_COUNT)
    line, place = _line_of(controller, words[0]), int(real(words[1]))
    if place not in line.values:
        raise Refusal(OUT_OF_RANGE)
    return [f"{words[0]} {place}={line.values[place]}"]


@command("TRO")
def _enable_trigger(controller, words):
    """Set trigger output state."""
    if not words or len(words) % 2:
        raise Refusal(WRONG_COUNT)
    pairs = zip(words[::2], words[1::2], strict=True)
    given = [(_line_of(controller, name), whole(text, 0, 1)) for name, text in pairs]
    for line, on in given:
        line.on = bool(on)


@command("TRO?")
def _trigger_enabled(controller, words):
    """Get trigger output state."""
    names = words or list(controller.lines)
    return [f"{name}={int(_line_of(controller, name).on)}" for name in names]


@command("DIO?")
def _digital_inputs(controller, words):
    """Get digital input lines."""
    names = words or list(controller.inputs)
    if not set(names) <= set(controller.inputs):
        raise Refusal(OUT_OF_RANGE)
    return [f"{name}={int(controller.inputs[name])}" for name in names]


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


#: Length of the longest command [characters].
LONGEST_COMMAND = 4096
_SINGLE = re.compile(rb"[\x00-\x09\x0b-\x1f]")


class Session:
    """The session of a controller with one client."""

    def __init__(self, controller: Controller):
        self._controller, self._rest = controller, b""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to received bytes."""
        answers, self._rest = [], self._rest + data
        while match := re.search(rb"[\x00-\x1f]", self._rest):
            before, mark, self._rest = self._rest[: match.start()], match.group(), self._rest[match.end() :]
            if _SINGLE.match(mark):
                if mark != b"\r":
                    answers.append(self.answer_single(mark.decode("latin-1")))
                self._rest = before + self._rest
            else:
                answers.append(self._line(before))
        if len(self._rest) > LONGEST_COMMAND:
            self._rest = b""
            self._controller.fail(TOO_LONG)
        return b"".join(answers)

    def _line(self, line: bytes) -> bytes:
        if len(line) > LONGEST_COMMAND:
            self._controller.fail(TOO_LONG)
            return b""
        lines = self.answer(line.decode("latin-1"))
        return " \n".join(lines).encode("latin-1") + b"\n" if lines else b""

    def answer(self, line: str) -> list[str]:
        """Return the lines of the answer to a command; empty for a setting or a refused command."""
        words, controller = line.split(), self._controller
        if not words:
            return []
        controller.tick()
        command = COMMANDS.get(words[0].upper())
        if command is None:
            controller.fail(UNKNOWN_COMMAND)
            return []
        try:
            return command(controller, words[1:]) or []
        except Refusal as refusal:
            controller.fail(refusal.args[0])
            return []

    def _status(self) -> int:
        """Return the status register; assumed: four bits per axis (on target, moving, servo on, generator running)."""
        axes = enumerate(self._controller.axes.values())
        return sum(
            (axis.on_target | axis.moving << 1 | axis.servo << 2 | axis.generating << 3) << 4 * place
            for place, axis in axes
        )

    def answer_single(self, character: str) -> bytes:
        """Return the answer to a command of one character."""
        controller = self._controller
        controller.tick()
        axes = list(controller.axes.values())
        if character == STATUS:
            return b"0x%x\n" % self._status()
        if character == MOTION_STATUS:
            return b"%x\n" % sum(axis.moving << place for place, axis in enumerate(axes))
        if character == READY_STATUS:
            return (NOT_READY if controller.busy else READY) + b"\n"
        if character == GENERATOR_STATUS:
            return b"%x\n" % sum(axis.generating << place for place, axis in enumerate(axes))
        if character == STOP:
            controller.stop(axes)
        else:
            controller.fail(UNKNOWN_COMMAND)
        return b""


@dataclass(frozen=True)
class EmulatedControllerParameters(Parameters):
    """Model and address of the emulated controller."""

    model: str = parameter("E-754", choices=tuple(MODELS), description="which controller")
    host: str = parameter("127.0.0.1", description="address to listen on")
    port: int = parameter(50000, description="TCP port; 0: a free one", low=0, high=65535)
    masters: int = parameter(1, description="maximum number of simultaneous connections", low=1, high=100)


@contextlib.contextmanager
def start(given: EmulatedControllerParameters, bench: Bench) -> Iterator[Running]:
    """Run an emulated controller."""
    faults = DeviceFaults(time.monotonic, bench.faults)
    controller = Controller(MODELS[given.model], bench.plant, bench.cycle, faults)
    address = given.host, given.port
    with serving(address, lambda: Session(controller), controller.tick, faults, given.masters) as server:
        where = f"{given.model} with {', '.join(controller.axes)} as axes at {given.host}:{server.port}"
        yield Running(where, GcsParameters(host=given.host, port=server.port), faults, controller)


@contextlib.contextmanager
def emulator() -> Iterator[Parameters]:
    """Run an emulated controller on a free port, and yield the parameters of its driver."""
    with start(EmulatedControllerParameters(port=0), Bench()) as running:
        yield running.driver


DEVICE = EmulatedDevice(EmulatedControllerParameters, start)
