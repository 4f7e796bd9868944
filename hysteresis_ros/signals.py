# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The signals of an axis: one table of names, units and writers, from which all other lists are derived.

A sample of an axis is a *row* of numbers, one for each signal, in the order of this table. The parts of the loop use
the constants below as indices into a row. Columns of recordings, ``~/state`` messages, Float64 topics, reports and the
comparison with the offline twin come from the same table.
"""

from __future__ import annotations

import enum
from collections.abc import Container
from dataclasses import dataclass

SOURCE, MOTOR_SOURCE = "reference_generator", "inchworm_sequencer"
CONTROLLER, COMPENSATOR, PLANT = "motion_controller", "hysteresis_compensator", "plant_simulator"
#: Writer of signals that the user requests.
USER = "user"


@dataclass(frozen=True)
class Signal:
    """One signal of an axis."""

    name: str  #: Column of recordings.
    unit: str  #: SI unit; ``1`` for counts, codes and values in the units of a model.
    #: Node that writes the signal, or ``user``. On the axis of a motor, the ``inchworm_sequencer`` writes the signals
    #: of the ``reference_generator``.
    writer: str
    description: str  #: Meaning, as a phrase.
    state: tuple[tuple[str, str], ...] = ()  #: Nodes whose ``~/state`` contains the signal, and its name there.
    topic: str = ""  #: Float64 topic with the signal, if any.
    motor: bool = False  #: Whether only an inchworm motor has this signal.


def _at(*nodes: str, name: str):
    return tuple((node, name) for node in nodes)


def _sequencer(name: str, unit: str, description: str, state: str = "", topic: str = "") -> Signal:
    return Signal(name, unit, MOTOR_SOURCE, description, _at(MOTOR_SOURCE, name=state or name), topic, motor=True)


def _motor(name: str, unit: str, description: str, state: str = "") -> Signal:
    return Signal(name, unit, PLANT, description, _at(PLANT, name=state or name), motor=True)


#: All signals in the order of a row; those that only an inchworm motor has are last.
SIGNALS = (
    Signal("setpoint", "m", USER, "valid setpoint", _at(SOURCE, MOTOR_SOURCE, name="setpoint"), "setpoint"),
    Signal(
        "reference",
        "m",
        SOURCE,
        "desired displacement",
        (*_at(SOURCE, MOTOR_SOURCE, CONTROLLER, name="reference"),),
        "reference",
    ),
    Signal(
        "command",
        "m",
        CONTROLLER,
        "commanded displacement of the hysteresis element",
        _at(CONTROLLER, COMPENSATOR, name="command"),
        "command",
    ),
    Signal("voltage", "V", COMPENSATOR, "voltage for the amplifier", _at(COMPENSATOR, name="voltage"), "voltage"),
    Signal("displacement", "m", PLANT, "true displacement of the joint", _at(PLANT, name="displacement")),
    Signal("measured", "m", PLANT, "measured displacement of the joint", _at(PLANT, name="measured")),
    Signal("estimated", "m", CONTROLLER, "displacement estimated by the observer", _at(CONTROLLER, name="estimated")),
    Signal("applied", "m", COMPENSATOR, "achieved command", _at(COMPENSATOR, name="applied"), topic="applied"),
    Signal("switching", "1", CONTROLLER, "switching function", _at(CONTROLLER, name="switching")),
    Signal("disturbance", "1", CONTROLLER, "estimated disturbance", _at(CONTROLLER, name="disturbance")),
    Signal("plant_voltage", "V", PLANT, "output voltage of the amplifier", _at(PLANT, name="voltage")),
    Signal(
        "saturated", "1", COMPENSATOR, "1: range or slew rate limits the voltage", _at(COMPENSATOR, name="saturated")
    ),
    Signal(
        "seen",
        "m",
        CONTROLLER,
        "measurement that the controller used; NaN: no measurement",
        _at(CONTROLLER, name="measured"),
    ),
    Signal("source_mode", "1", SOURCE, "mode of the reference generator", _at(SOURCE, MOTOR_SOURCE, name="mode")),
    Signal("controller_mode", "1", CONTROLLER, "mode of the controller", _at(CONTROLLER, name="mode")),
    Signal("compensator_mode", "1", COMPENSATOR, "mode of the compensator", _at(COMPENSATOR, name="mode")),
    Signal("plant_mode", "1", PLANT, "mode of the plant", _at(PLANT, name="mode")),
    Signal(
        "tripped", "1", PLANT, "not 0: the plant has stopped the axis until it is started", _at(PLANT, name="tripped")
    ),
    Signal("late", "1", PLANT, "number of late voltages so far", _at(PLANT, name="late")),
    Signal("skipped", "1", PLANT, "1: skipped, because its deadline was missed", _at(PLANT, name="skipped")),
    Signal(
        "adaptation",
        "1",
        COMPENSATOR,
        "state of the adaptation; 0: no adaptation",
        _at(COMPENSATOR, name="adaptation"),
    ),
    Signal(
        "adapted_gain",
        "1",
        COMPENSATOR,
        "gain of the inverse, relative to the identified one",
        _at(COMPENSATOR, name="adapted_gain"),
    ),
    Signal("force", "N", PLANT, "measured force in the stack; NaN: no force sensor", _at(PLANT, name="force")),
    Signal(
        "waveform_sample",
        "1",
        SOURCE,
        "number of samples since the waveform began; -1: no waveform runs",
        _at(SOURCE, MOTOR_SOURCE, name="waveform_sample"),
    ),
    Signal(
        "scan_edges",
        "1",
        SOURCE,
        "sum of the edges of a scan at this sample: a frame (1), a line (2) or a pixel (4) begins",
        _at(SOURCE, MOTOR_SOURCE, name="scan_edges"),
    ),
    Signal(
        "trigger",
        "1",
        SOURCE,
        "number of the trigger in this sample; 0: no trigger",
        _at(SOURCE, MOTOR_SOURCE, name="trigger"),
    ),
    Signal(
        "trigger_position",
        "m",
        SOURCE,
        "position of the axis at the trigger",
        _at(SOURCE, MOTOR_SOURCE, name="trigger_position"),
    ),
    Signal(
        "trigger_direction",
        "1",
        SOURCE,
        "direction of motion at the trigger; 1: up, -1: down",
        _at(SOURCE, MOTOR_SOURCE, name="trigger_direction"),
    ),
    Signal(
        "trigger_delay",
        "s",
        SOURCE,
        "time from the trigger to this sample",
        _at(SOURCE, MOTOR_SOURCE, name="trigger_delay"),
    ),
    Signal(
        "trigger_in",
        "1",
        USER,
        "number of pulses of the trigger input at this sample",
        _at(SOURCE, MOTOR_SOURCE, name="trigger_in"),
    ),
    _sequencer("origin", "m", "offset that the controller subtracts from the measurement", topic="origin"),
    _motor("extender", "m", "measured displacement of the extender"),
    _motor("extender_displacement", "m", "true displacement of the extender"),
    _sequencer("front_voltage", "V", "voltage of the front clamp", topic="front_clamp/voltage"),
    _sequencer("rear_voltage", "V", "voltage of the rear clamp", topic="rear_clamp/voltage"),
    _motor("front_force", "N", "normal force of the front clamp"),
    _motor("rear_force", "N", "normal force of the rear clamp"),
    _sequencer("phase", "1", "phase of the gait"),
    _sequencer("steps", "1", "number of steps so far, forward minus backward"),
    _sequencer("direction", "1", "direction of motion"),
    _sequencer("slip", "m", "slip of the last step"),
    _sequencer("error", "1", "error code"),
    _sequencer("arrived", "1", "1: at the setpoint within the tolerance"),
    _sequencer("total_steps", "1", "number of steps so far"),
    _sequencer("missed", "1", "number of missed steps so far"),
    _sequencer("step_commanded", "m", "commanded length of the last step"),
    _sequencer("step_achieved", "m", "achieved length of the last step"),
    Signal("request", "1", USER, "request to the sequencer", _at(MOTOR_SOURCE, name="request"), motor=True),
    Signal("speed", "m/s", USER, "requested walking speed", _at(MOTOR_SOURCE, name="speed"), motor=True),
    _motor("front_plant_voltage", "V", "output voltage of the front clamp's amplifier", "front_voltage"),
    _motor("rear_plant_voltage", "V", "output voltage of the rear clamp's amplifier", "rear_voltage"),
    _sequencer("load_deflection", "m", "learned deflection of the extender by the load"),
    _sequencer("forward_gain", "1", "learned gain of forward steps"),
    _sequencer("backward_gain", "1", "learned gain of backward steps"),
    _sequencer("forward_offset", "m", "learned offset of forward steps"),
    _sequencer("backward_offset", "m", "learned offset of backward steps"),
    _sequencer("cycle_phase", "1", "phase of continuous walking"),
    _sequencer("path_error", "m", "path of continuous walking minus measured slider position"),
    _sequencer("correction", "m", "learned correction of the extension, in continuous walking"),
)

# Indices in a row, written out so that they are constants for compiled code; a test compares them with the table.
(
    SETPOINT,
    REFERENCE,
    COMMAND,
    VOLTAGE,
    DISPLACEMENT,
    MEASURED,
    ESTIMATED,
    APPLIED,
    SWITCHING,
    DISTURBANCE,
    PLANT_VOLTAGE,
    SATURATED,
    SEEN,
    SOURCE_MODE,
    CONTROLLER_MODE,
    COMPENSATOR_MODE,
    PLANT_MODE,
    TRIPPED,
    LATE,
    SKIPPED,
    ADAPTATION,
    ADAPTED_GAIN,
    FORCE,
    WAVEFORM_SAMPLE,
    SCAN_EDGES,
    TRIGGER,
    TRIGGER_POSITION,
    TRIGGER_DIRECTION,
    TRIGGER_DELAY,
    TRIGGER_IN,
    ORIGIN,
    EXTENDER,
    EXTENDER_DISPLACEMENT,
    FRONT_VOLTAGE,
    REAR_VOLTAGE,
    FRONT_FORCE,
    REAR_FORCE,
    PHASE,
    STEPS,
    DIRECTION,
    SLIP,
    ERROR,
    ARRIVED,
    TOTAL_STEPS,
    MISSED,
    STEP_COMMANDED,
    STEP_ACHIEVED,
    REQUEST,
    SPEED,
    FRONT_PLANT_VOLTAGE,
    REAR_PLANT_VOLTAGE,
    LOAD_DEFLECTION,
    FORWARD_GAIN,
    BACKWARD_GAIN,
    FORWARD_OFFSET,
    BACKWARD_OFFSET,
    CYCLE_PHASE,
    PATH_ERROR,
    CORRECTION,
) = range(59)


class Edge(enum.IntFlag):
    """Bits of ``scan_edges``: a frame, a line or a pixel of a scan begins at this sample."""

    FRAME = 1
    LINE = 2
    PIXEL = 4


#: Indices of the user's requests; an actuator has only the first two.
ASKED = (SETPOINT, TRIGGER_IN, REQUEST, SPEED)

#: Indices of the inputs of a run; an actuator has only the first ACTUATOR_GIVEN.
GIVEN = (SETPOINT, SKIPPED, TRIGGER_IN, REQUEST, SPEED)
ACTUATOR_GIVEN = 3

#: Length of a row: for an actuator, and for a motor.
ACTUATOR_ROW = sum(not signal.motor for signal in SIGNALS)
MOTOR_ROW = len(SIGNALS)

#: Frame of ``joint_states`` while the plant has stopped the axis (``tripped`` is not 0).
TRIPPED_FRAME = "tripped"

#: Action in the change log, without a user action, that contains the initial parameters of a node.
CONFIGURED = "configure"
#: Action in the change log, without a user action, at the end of a run.
ENDED = "end"

#: SI unit of each signal by name, and of the time.
UNITS = {"time": "s", **{signal.name: signal.unit for signal in SIGNALS}}

#: Name of the requested voltage in a run with a different ``voltage``.
ASKED_VOLTAGE = "asked_voltage"
UNITS[ASKED_VOLTAGE] = "V"

#: Signals of the triggers of an axis.
TRIGGER_SIGNALS = tuple(signal.name for signal in SIGNALS[TRIGGER : TRIGGER_DELAY + 1])

#: Columns of every recording of a run, and the additional columns for a motor.
COLUMNS = tuple(signal.name for signal in SIGNALS[: ESTIMATED + 1])
MOTOR_COLUMNS = tuple(signal.name for signal in SIGNALS[ORIGIN : STEP_ACHIEVED + 1])

#: Signal → its substitute if a recording lacks it.
SUBSTITUTES = {"voltage": "plant_voltage", "measured": "seen"}

#: The nodes of an axis that write signals, in the order in which a sample passes through them.
WRITERS = (PLANT, SOURCE, MOTOR_SOURCE, CONTROLLER, COMPENSATOR)

#: Signals that come first in ``~/state`` of some nodes; the others follow in the order of the table.
STATE_FIRST = {
    MOTOR_SOURCE: ("setpoint", "request", "speed"),
    CONTROLLER: ("reference", "measured", "estimated", "command"),
    PLANT: ("displacement", "measured", "voltage"),
}

#: External requests to an axis in addition to setpoints; a replay uses them as inputs.
REQUESTS = ("request", "speed")


@dataclass(frozen=True)
class AxisKind:
    """Nodes, row, topics and inputs of an axis, which differ between an actuator and an inchworm motor."""

    source: str  #: Node that writes the reference.
    row: tuple[Signal, ...]  #: Signals of a row, in order.
    given: tuple[int, ...]  #: Row indices of the inputs of a run.
    motor: bool  #: Whether it is an inchworm motor, which walks and accepts requests in addition to setpoints.

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes that write signals, in the order in which a sample passes through them."""
        return tuple(name for name in WRITERS if name == self.source or name not in (SOURCE, MOTOR_SOURCE))

    @property
    def voltages(self) -> tuple[tuple[str, int, str], ...]:
        """Topic, index in a row and writer of each voltage that the plant receives."""
        found = [signal for signal in self.row if signal.unit == "V" and signal.topic]
        return tuple((signal.topic, place(signal.name), signal.writer) for signal in found)

    @property
    def own_topics(self) -> tuple[str, ...]:
        """Float64 topics that other axes do not have; the node ``source`` publishes them."""
        return tuple(signal.topic for signal in self.row if signal.motor and signal.topic)

    def state(self, node: str) -> dict[str, str]:
        """Return the content of a node's ``~/state``: name in the message → signal, in the order of the message."""
        found = {name: signal.name for signal in self.row for where, name in signal.state if where == node}
        first = {name: found.pop(name) for name in STATE_FIRST.get(node, ()) if name in found}
        return first | found


ACTUATOR = AxisKind(SOURCE, SIGNALS[:ACTUATOR_ROW], GIVEN[:ACTUATOR_GIVEN], motor=False)
INCHWORM = AxisKind(MOTOR_SOURCE, SIGNALS, GIVEN, motor=True)


def kind_of(nodes: Container[str]) -> AxisKind:
    """Return the kind of an axis with these nodes."""
    return INCHWORM if MOTOR_SOURCE in nodes else ACTUATOR


def place(name: str) -> int:
    """Return the index of a signal in a row."""
    return _PLACES[name]


#: Values of the ``mode`` signals. RUNNING: normal operation. HOLDING: no usable input in this sample; the output is
#: held. STALE: no usable input within the time-out. STOPPED: stopped by a request. TRIPPED: stopped by the plant. In
#: STALE, STOPPED and TRIPPED the output goes to its safe value. FOLLOWING: no node reports achieved commands; the
#: command follows the displacement. QUIET: the command stands still on request.
MODE_RUNNING, MODE_HOLDING, MODE_STALE, MODE_STOPPED, MODE_TRIPPED, MODE_FOLLOWING, MODE_QUIET = range(7)

#: Voltages that differ by less than this and are not on a converter's grid count as equal [V].
LEAST_DIFFERENCE = 1e-9

_PLACES = {signal.name: index for index, signal in enumerate(SIGNALS)}


def state_signals(node: str) -> dict[str, str]:
    """Return the content of a node's ``~/state``; on the axis of an actuator, it lacks the signals of a motor."""
    return INCHWORM.state(node)


def float_topics() -> dict[str, str]:
    """Return topic → signal of the Float64 topics with one number per sample, in the order of a sample.

    The origin is published before the reference to which it belongs.
    """
    found = [signal for signal in SIGNALS if signal.topic and signal.writer != USER]
    found.sort(key=lambda signal: (max(WRITERS.index(signal.writer), 2), signal.topic != "origin"))
    return {signal.topic: signal.name for signal in found}


def sources(name: str) -> tuple[tuple[str, str], ...]:
    """Return (node, name in its ``~/state``) for each source of a signal in a recording, the preferred source first."""
    signal = SIGNALS[place(name)]
    substitute = SUBSTITUTES.get(name)
    return signal.state + (SIGNALS[place(substitute)].state if substitute else ())
