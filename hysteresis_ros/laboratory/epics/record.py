# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motor record of an axis: settings, fields and the effects of writing fields; no ROS, no Channel Access."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

from hysteresis_ros import signals
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.source import GeneratorSource
from hysteresis_ros.loop.stage_parameters import StageParameters, StageScanParameters
from hysteresis_ros.references.approach import HIGH, LOW, effective_limits
from hysteresis_ros.references.moves import Arrival
from hysteresis_ros.units import UNITS

#: Tolerance of a move as a fraction of the range, for an axis without goal tolerance.
NEAR = 0.01
#: Time for which an inchworm motor's slider must stay near its setpoint [s].
DWELL = 0.1


@dataclass(frozen=True)
class MotorSettings:
    """Settings of a motor record and of its axis."""

    name: str  #: Name of the record, with its prefix.
    #: namespace, source, joint: Namespace of the axis, node that takes its setpoints, and moved joint.
    namespace: str
    source: str
    joint: str
    low: float  #: low, high: Range of setpoints [m].
    high: float
    velocity: float  #: velocity, acceleration: Limits of the approach [m/s], [m/s²]; 0: unlimited.
    acceleration: float
    tolerance: float  #: tolerance, dwell: A move is complete after the dwell time [s] within the tolerance [m].
    dwell: float
    timeout: float  #: Time-out of a move, in addition to its duration at full speed [s].
    unit: str  #: Engineering unit, a unit of length.
    precision: int  #: Decimal places.
    deadband: float = 0.0  #: Deadband: a setpoint within this distance from the position does not move the axis [m].

    @property
    def metres(self) -> float:
        """Metres in an engineering unit."""
        return 1.0 / UNITS[self.unit][1]


@dataclass(frozen=True)
class RecordOptions:
    """Options of motor records."""

    prefix: str  #: Prefix of the records' names.
    unit: str  #: Engineering unit.
    precision: int  #: Decimal places.
    timeout: float  #: Time-out of a move, in addition to its duration at full speed [s].
    #: Tolerance of a move, in engineering units; by default the tolerance of the axis.
    tolerance: float | None = None

    def __post_init__(self) -> None:
        if UNITS.get(self.unit, ("",))[0] != "m":
            known = ", ".join(name for name, (base, _) in UNITS.items() if base == "m" and name.isascii())
            raise ConfigurationError(f"--egu {self.unit}: not a unit of length; allowed: {known}")
        if not 0 <= self.precision <= 15:
            raise ConfigurationError(f"--precision {self.precision}: allowed: 0 … 15 digits")
        for name, value in (("timeout", self.timeout), ("tolerance", self.tolerance)):
            if value is not None and not 0.0 < value < math.inf:
                raise ConfigurationError(f"--{name} {value:g}: must be a positive number")

    def name(self, axis: AxisParameters) -> str:
        """Return the name of an axis' record: prefix and namespace, or ``m1`` for an axis without namespace."""
        return self.prefix + (axis.namespace.strip("/").replace("/", ":") or "m1")


def at_rest(axis: AxisParameters) -> AxisParameters:
    """Return the axis without its waveform, so that it follows setpoints only."""
    own = axis.reference_generator
    if own is None:
        return axis
    waveform = replace(own.waveform, type="hold", offset=0.0, phase=0.0)
    return replace(axis, reference_generator=replace(own, waveform=waveform))


def stage_at_rest(configuration: Configuration) -> StageParameters | None:
    """Return the stage of a configuration without its scan and waveforms; None if there is no stage."""
    if configuration.stage is None:
        return None
    stage = StageParameters.from_configuration(configuration).following(StageScanParameters()).in_time()
    return replace(stage, axes=tuple(map(at_rest, stage.axes)))


def motor_settings(axis: AxisParameters, options: RecordOptions) -> MotorSettings:
    """Return the settings of an axis' motor record."""
    common: dict[str, Any] = {
        "name": options.name(axis),
        "namespace": axis.namespace,
        "joint": axis.plant_simulator.joint,
        "timeout": options.timeout,
        "unit": options.unit,
        "precision": options.precision,
    }
    given = None if options.tolerance is None else options.tolerance / UNITS[options.unit][1]
    motor = axis.inchworm_sequencer
    if motor is not None:
        return MotorSettings(
            source=signals.MOTOR_SOURCE,
            low=motor.minimum,
            high=motor.maximum,
            velocity=0.0,
            acceleration=0.0,
            tolerance=given or motor.fine.tolerance,
            dwell=DWELL,
            **common,
        )
    own = axis.generator
    approach = GeneratorSource(own).generator.approach.p
    stroke = own.maximum - own.minimum
    velocity, acceleration, _ = effective_limits(own.approach, stroke)
    return MotorSettings(
        source=signals.SOURCE,
        low=float(approach[LOW]),
        high=float(approach[HIGH]),
        velocity=velocity if math.isfinite(velocity) else 0.0,
        acceleration=acceleration if math.isfinite(acceleration) else 0.0,
        tolerance=given or own.trajectory.goal_tolerance or NEAR * stroke,
        dwell=own.trajectory.dwell,
        deadband=own.ready.deadband,
        **common,
    )


#: Time in which the axis must accept a setpoint [s].
TAKEN = 2.0

#: Bits of MSTA.
PLUS, DONE, PROBLEM, MOVING, COMMUNICATION = 1 << 0, 1 << 1, 1 << 9, 1 << 10, 1 << 12

#: Value of READYIN while nothing is predicted [s].
UNPREDICTED = -1.0

#: Fields that may be written but keep the values of the axis.
FIXED = ("VELO", "ACCL", "VMAX", "VBAS", "EGU", "HOMF", "HOMR", "JOGF", "JOGR", "MRES", "ERES", "RVAL", "RDBD")


class Alarm(NamedTuple):
    """Status and severity, in the terms of EPICS."""

    status: str = "NO_ALARM"
    severity: str = "NO_ALARM"


#: Alarms of the possible problems.
SILENT, STOPPED, UNMEASURED = Alarm("COMM", "INVALID"), Alarm("STATE", "MAJOR"), Alarm("READ", "INVALID")
MISSED, TOO_HIGH, TOO_LOW = Alarm("STATE", "MAJOR"), Alarm("HIGH", "MAJOR"), Alarm("LOW", "MAJOR")


class Seen(NamedTuple):
    """State of an axis: measurement and active setpoint [m] (NaN: unknown), and alarm."""

    position: float
    setpoint: float
    alarm: Alarm
    ready: bool = False  #: Whether the displacement stays within the tolerance of the last move.
    ready_in: float = math.nan  #: Predicted time from the setpoint to ``ready`` [s]; 0: ready; NaN: not predicted.


class Axis(Protocol):
    """Interface of a record to an axis."""

    def look(self, now: float) -> Seen:
        """Return the state of the axis at a time [s]."""

    def move(self, setpoint: float) -> None:
        """Move the axis to a setpoint [m]."""

    def stop(self) -> None:
        """Stop any motion."""


class MotorRecord:
    """A motor record."""

    def __init__(self, settings: MotorSettings, axis: Axis):
        self.settings, self._axis = settings, axis
        self._arrival = Arrival(settings.tolerance, settings.dwell)
        self._target = math.nan
        self._stopping = self._taken = self._refused = False
        self._begun = self._allowed = 0.0
        self._pending: float | None = None
        self._violated = self._missed = Alarm()
        self._seen = Seen(math.nan, math.nan, SILENT)
        self.alarm = SILENT
        low, high, unit = settings.low / settings.metres, settings.high / settings.metres, settings.metres
        tweak = float(f"{0.01 * (high - low):.1g}")
        speed = settings.velocity
        self.fields: dict[str, Any] = {
            **dict.fromkeys(("VAL", "DVAL", "RBV", "DRBV", "OFF", "RLV", "DIFF"), 0.0),
            **dict.fromkeys(("STOP", "TWF", "TWR", "SSET", "SUSE", "SYNC", "LVIO", "HLS", "LLS", "MOVN", "MISS"), 0),
            **{"DHLM": high, "DLLM": low, "HLM": high, "LLM": low, "TWV": tweak, "RDBD": settings.tolerance / unit},
            **{"DIR": "Pos", "SET": "Use", "FOFF": "Variable", "SPMG": "Go", "DMOV": 1, "TDIR": 0, "MSTA": DONE},
            **{"VELO": speed / unit, "VMAX": speed / unit, "SPDB": settings.deadband / unit},
            **{"READY": 0, "READYIN": UNPREDICTED},
            "ACCL": speed / settings.acceleration if settings.acceleration else 0.0,
        }

    # -- positions -----------------------------------------------------------------------------------------------

    @property
    def _sign(self) -> float:
        return -1.0 if self.fields["DIR"] == "Neg" else 1.0

    def _user(self, dial: float) -> float:
        return self._sign * dial + self.fields["OFF"]

    def _dial(self, user: float) -> float:
        return self._sign * (user - self.fields["OFF"])

    def _rescale(self) -> None:
        """Recompute all user positions from dial positions, direction and offset."""
        fields = self.fields
        fields["VAL"], fields["RBV"] = self._user(fields["DVAL"]), self._user(fields["DRBV"])
        ends = self._user(fields["DLLM"]), self._user(fields["DHLM"])
        fields["LLM"], fields["HLM"] = min(ends), max(ends)

    # -- writing fields ------------------------------------------------------------------------------------------

    def put(self, field: str, value, now: float):
        """Write a field, and return its resulting value.

        Units: ``now`` [s].
        """
        if field not in FIXED:
            write = getattr(self, f"_put_{field.lower()}", None)
            if write is not None:
                write(value, now)
            elif isinstance(value, str) or math.isfinite(value):
                self.fields[field] = value
        return self.fields.get(field, 0)

    def _put_val(self, user: float, now: float) -> None:
        if self.fields["SET"] == "Set":
            if self.fields["FOFF"] == "Variable" and math.isfinite(user):
                self._put_off(user - self._sign * self.fields["DVAL"], now)
            return
        self._go(user, now)

    def _put_dval(self, dial: float, now: float) -> None:
        if self.fields["SET"] == "Use":  # in the mode Set, a write must not move the axis
            self._go(self._user(dial), now)

    def _put_rlv(self, distance: float, now: float) -> None:
        self._put_val(self.fields["VAL"] + distance, now)

    def _put_twf(self, pressed: int, now: float) -> None:
        if pressed:
            self._put_val(self.fields["VAL"] + self.fields["TWV"], now)

    def _put_twr(self, pressed: int, now: float) -> None:
        if pressed:
            self._put_val(self.fields["VAL"] - self.fields["TWV"], now)

    def _put_off(self, offset: float, now: float) -> None:
        if math.isfinite(offset):
            self.fields["OFF"] = offset
            self._rescale()

    def _put_dir(self, direction: str, now: float) -> None:
        self.fields["DIR"] = direction
        self._rescale()

    def _put_sset(self, pressed: int, now: float) -> None:
        self.fields["SET"] = "Set"

    def _put_suse(self, pressed: int, now: float) -> None:
        self.fields["SET"] = "Use"

    def _put_hlm(self, user: float, now: float) -> None:
        self._limit("DHLM" if self._sign > 0.0 else "DLLM", self._dial(user))

    def _put_llm(self, user: float, now: float) -> None:
        self._limit("DLLM" if self._sign > 0.0 else "DHLM", self._dial(user))

    def _put_dhlm(self, dial: float, now: float) -> None:
        self._limit("DHLM", dial)

    def _put_dllm(self, dial: float, now: float) -> None:
        self._limit("DLLM", dial)

    def _limit(self, field: str, dial: float) -> None:
        """Move a limit, at most to the end of the axis' range."""
        own = self.settings
        if math.isfinite(dial):
            self.fields[field] = min(max(dial, own.low / own.metres), own.high / own.metres)
            self._rescale()

    def _put_sync(self, pressed: int, now: float) -> None:
        """Set VAL to the position of the axis."""
        self.fields["DVAL"] = self.fields["DRBV"]
        self._rescale()

    def _put_stop(self, pressed: int, now: float) -> None:
        if pressed:
            self._pending = None
            self._halt(now)

    def _put_spmg(self, word: str, now: float) -> None:
        self.fields["SPMG"] = word
        if word in ("Stop", "Pause"):
            moving = not math.isnan(self._target) and not self._stopping
            self._pending = self.fields["VAL"] if word == "Pause" and moving else None
            if not self.fields["DMOV"]:
                self._halt(now)
        elif self._pending is not None:
            wanted, self._pending = self._pending, None
            self._go(wanted, now)

    # -- moves ---------------------------------------------------------------------------------------------------

    def _go(self, user: float, now: float) -> None:
        """Begin a move to a user position, or refuse it."""
        fields, own = self.fields, self.settings
        if fields["SPMG"] in ("Stop", "Pause"):
            self._pending = fields["VAL"] = user
            return
        violated = Alarm()
        if not user <= fields["HLM"]:
            violated = TOO_HIGH
        elif not user >= fields["LLM"]:
            violated = TOO_LOW
        self._violated, self._missed = violated, Alarm()
        fields["LVIO"], fields["MISS"] = int(violated != Alarm()), 0
        self._seen = self._axis.look(now)
        near = fields["DMOV"] and fields["SPDB"] > 0.0 and abs(user - fields["RBV"]) <= fields["SPDB"]
        self._refused = bool(violated != Alarm() or self._seen.alarm != Alarm() or near)
        if not self._refused:
            dial = self._dial(user)
            fields["DVAL"], fields["VAL"] = dial, user
            self._target = min(max(dial * own.metres, own.low), own.high)
            fields["TDIR"] = int(self._target > self._seen.position)
            distance = abs(self._target - self._seen.position)
            self._begin(now, distance / own.velocity if own.velocity else 0.0)
            self._axis.move(self._target)
        fields["DMOV"] = 0  # tick() ends a refused move with an alarm, and a move within the deadband without alarm
        self._sum_up()

    def _begin(self, now: float, takes: float) -> None:
        self._arrival.restart()
        self._begun, self._allowed = now, takes + self.settings.timeout + self.settings.dwell
        self._taken = self._stopping = False
        self.fields["DMOV"], self.fields["MOVN"] = 0, 1

    def _halt(self, now: float) -> None:
        """Stop the axis; the move ends where the axis stops."""
        self._axis.stop()
        self._begin(now, 0.0)
        self._stopping, self._target = True, math.nan

    def tick(self, now: float) -> None:
        """Update the record at a time [s], and continue its move."""
        fields, seen = self.fields, self._axis.look(now)
        self._seen = seen
        if math.isfinite(seen.position):
            fields["DRBV"] = seen.position / self.settings.metres
        fields["READY"] = int(seen.ready)
        fields["READYIN"] = seen.ready_in if math.isfinite(seen.ready_in) else UNPREDICTED
        if self._refused:
            self._refused = False
            self._end(Alarm())
        elif not fields["DMOV"]:
            self._watch(now, seen)
        else:
            self._follow()
        fields["RBV"] = self._user(fields["DRBV"])
        if fields["DMOV"] and self._pending is None:
            fields["VAL"] = self._user(fields["DVAL"])
        fields["DIFF"] = fields["DVAL"] - fields["DRBV"]
        self._sum_up()

    def _watch(self, now: float, seen: Seen) -> None:
        """Check whether a move has arrived, or has failed."""
        target = seen.setpoint if self._stopping else self._target
        if seen.setpoint == target:
            self._taken = True
        elif self._taken or now - self._begun > TAKEN:
            self._end(MISSED)  # the axis received another setpoint, or did not accept this one
            return
        if seen.alarm != Alarm() or now - self._begun > self._allowed:
            self._end(MISSED)
        elif self._arrival.take(now, seen.position - target if self._taken else math.nan):
            self._end(Alarm())

    def _end(self, missed: Alarm) -> None:
        self._missed, self._target, self._stopping = missed, math.nan, False
        fields = self.fields
        self._follow()
        fields["DMOV"], fields["MOVN"], fields["MISS"] = 1, 0, int(missed != Alarm())
        if fields["SPMG"] == "Move":
            fields["SPMG"] = "Pause"

    def _follow(self) -> None:
        """Show the active setpoint from any client, unless a new setpoint is pending."""
        if math.isfinite(self._seen.setpoint) and self._pending is None:
            self.fields["DVAL"] = self._seen.setpoint / self.settings.metres

    def _sum_up(self) -> None:
        """Set alarm and status to the present problem."""
        fields = self.fields
        wrong = (self._seen.alarm, self._violated, self._missed)
        self.alarm = next((alarm for alarm in wrong if alarm != Alarm()), Alarm())
        status = (PLUS if fields["TDIR"] else 0) | (DONE if fields["DMOV"] else 0) | (MOVING if fields["MOVN"] else 0)
        status |= PROBLEM if self.alarm.severity != "NO_ALARM" else 0
        fields["MSTA"] = status | (COMMUNICATION if self._seen.alarm == SILENT else 0)
