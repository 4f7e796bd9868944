# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a motor record has to know of its axis; imports neither ROS nor caproto."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from hysteresis_ros import signals
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.source import GeneratorSource
from hysteresis_ros.references.approach import HIGH, LOW, effective_limits
from hysteresis_ros.units import UNITS

#: Part of the range that counts as arrived for an axis that does not say so.
NEAR = 0.01
#: How long an inchworm's slider has to stay near its setpoint [s].
DWELL = 0.1


@dataclass(frozen=True)
class MotorSettings:
    """A motor record and the axis behind it.

    Parameters
    ----------
    name : str
        Of the record, with its prefix.
    namespace, source, joint : str
        Where the axis is, which node takes its setpoints, and the joint that is moved.
    low, high : float
        Range of setpoints [m].
    velocity, acceleration : float
        Largest ones of the approach [m/s], [m/s²]; 0: unlimited.
    tolerance, dwell : float
        A move has arrived when it is so near [m] for so long [s].
    timeout : float
        Time for a move beyond what its speed takes [s].
    unit : str
        Engineering unit, one of length.
    precision : int
        Digits behind the point.
    """

    name: str
    namespace: str
    source: str
    joint: str
    low: float
    high: float
    velocity: float
    acceleration: float
    tolerance: float
    dwell: float
    timeout: float
    unit: str
    precision: int

    @property
    def metres(self) -> float:
        """Metres in an engineering unit."""
        return 1.0 / UNITS[self.unit][1]


@dataclass(frozen=True)
class RecordOptions:
    """What a person wants of motor records.

    Parameters
    ----------
    prefix : str
        Of their names.
    unit : str
        Engineering unit.
    precision : int
        Digits behind the point.
    timeout : float
        Time for a move beyond what its speed takes [s].
    tolerance : float, optional
        A move has arrived when it is so near, in engineering units; by default what the axis says.

    Raises
    ------
    ConfigurationError
        The unit is none of length, or a number is no sensible one.
    """

    prefix: str
    unit: str
    precision: int
    timeout: float
    tolerance: float | None = None

    def __post_init__(self) -> None:
        if UNITS.get(self.unit, ("",))[0] != "m":
            known = ", ".join(name for name, (base, _) in UNITS.items() if base == "m" and name.isascii())
            raise ConfigurationError(f"--egu {self.unit}: no unit of length; allowed: {known}")
        if not 0 <= self.precision <= 15:
            raise ConfigurationError(f"--precision {self.precision}: allowed: 0 … 15 digits")
        for name, value in (("timeout", self.timeout), ("tolerance", self.tolerance)):
            if value is not None and not 0.0 < value < math.inf:
                raise ConfigurationError(f"--{name} {value:g}: must be a positive number")

    def name(self, axis: AxisParameters) -> str:
        """Return the name of an axis' record: prefix and namespace, ``m1`` for an axis without."""
        return self.prefix + (axis.namespace.strip("/").replace("/", ":") or "m1")


def at_rest(axis: AxisParameters) -> AxisParameters:
    """Return the axis so that it follows setpoints only: without a waveform."""
    own = axis.reference_generator
    if own is None:
        return axis
    waveform = replace(own.waveform, type="hold", offset=0.0, phase=0.0)
    return replace(axis, reference_generator=replace(own, waveform=waveform))


def motor_settings(axis: AxisParameters, options: RecordOptions) -> MotorSettings:
    """Return the settings of an axis' motor record."""
    common = {
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
    own = axis.reference_generator
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
        **common,
    )
