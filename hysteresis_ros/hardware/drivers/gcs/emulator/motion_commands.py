# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification, servo, moves, open-loop values, limits, parameters and errors of the emulated controller."""

from __future__ import annotations

from collections.abc import Callable

from hysteresis_ros.hardware.drivers.gcs.emulator.axis import Axis
from hysteresis_ros.hardware.drivers.gcs.emulator.controller import Controller
from hysteresis_ros.hardware.drivers.gcs.emulator.dictionary import (
    COMMANDS,
    Refusal,
    axis_of,
    command,
    pairs_of,
    real,
    require_free,
    whole,
)
from hysteresis_ros.hardware.drivers.gcs.emulator.recorder import BY_MOTION, POINTS
from hysteresis_ros.hardware.drivers.gcs.emulator.waves import LONGEST, TABLES
from hysteresis_ros.hardware.drivers.gcs.protocol import (
    AXIS_UNIT,
    GENERATOR_RUNS,
    OUT_OF_RANGE,
    POSITION_LIMIT,
    RANGE_MAXIMUM,
    RANGE_MINIMUM,
    READ_ONLY,
    RECORD_POINTS,
    RECORD_TABLES,
    SERVO_CYCLE,
    SERVO_OFF,
    SERVO_ON,
    SETTLING,
    SYNTAX,
    TOLERANCE,
    UNITS,
    UNKNOWN_PARAMETER,
    VOLTAGE_LIMIT,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
    WAVE_POINTS,
    WRONG_COUNT,
)

#: Parameters that can be written.
WRITABLE = (AXIS_UNIT, TOLERANCE, SETTLING, RECORD_TABLES, 0x06000500)


def _of_each(name: str, text: str, value: Callable[[Axis], str]) -> None:
    """Add a question that is asked of the axes that are named, or of all."""

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
    """Add a question that is asked of the input signals that are named, or of all; one without an axis measures 0."""

    def ask(controller: Controller, words: list[str]) -> list[str]:
        """Answer it."""
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
    """Set command level; all parameters are as free at any level."""
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
        WAVE_POINTS: LONGEST,
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
