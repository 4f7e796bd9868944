# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the inchworm sequencer: gait, fine positioning, learning, guards, continuous walking, schedule."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import Parameters, group, parameter
from hysteresis_ros.references.gait import GaitParameters
from hysteresis_ros.references.walk import WalkParameters


@dataclass(frozen=True)
class FineParameters(Parameters):
    """Fine positioning: the front clamp holds the slider, the controller measures the slider."""

    enabled: bool = parameter(
        True, read_only=True, description="finish on the extender in closed loop; false: on steps, with both clamps"
    )
    tolerance: float = parameter(
        10.0e-9,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="distance to the setpoint (smoothed) at which the motor has arrived",
    )
    speed: float = parameter(
        1.0e-3, unit="m/s", low=1.0e-12, high=1.0, read_only=True, description="highest speed of the reference"
    )
    time: float = parameter(
        2.0e-3,
        unit="s",
        low=1.0e-6,
        high=100.0,
        read_only=True,
        description="time constant of the reference's critically damped approach",
    )
    timeout: float = parameter(
        0.5,
        unit="s",
        low=1.0e-3,
        high=1.0e4,
        read_only=True,
        description="time outside of the tolerance after which the motor grips anew and tries again",
    )
    smoothing_time: float = parameter(
        5.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time constant of the smoothing of the distance to the setpoint and of the slip",
    )


def _model(default: float, which: str, unit: str = ""):
    return parameter(default, unit=unit, low=-2.0, high=2.0, read_only=True, description=which)


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """Learned step length: movement of the slider = gain · extension + offset, for either direction."""

    enabled: bool = parameter(True, read_only=True, description="learn from the measured steps")
    forgetting: float = parameter(
        0.98,
        low=0.5,
        high=1.0,
        read_only=True,
        description="weight of the past at each step (least squares)",
    )
    forward_gain: float = _model(1.0, "gain to start from, forward")
    forward_offset: float = _model(0.0, "offset to start from, forward; negative: a load holds back", "m")
    backward_gain: float = _model(1.0, "gain to start from, backward")
    backward_offset: float = _model(0.0, "offset to start from, backward, along the motion", "m")
    load_deflection: float = _model(0.0, "deflection of the extender by the load to start from", "m")


@dataclass(frozen=True)
class GuardParameters(Parameters):
    """What counts as a fault."""

    still_steps: int = parameter(
        5, low=1, high=1000, read_only=True, description="steps in a row without motion after which the motor gives up"
    )
    missed_part: float = parameter(
        0.5,
        low=0.1,
        high=0.99,
        read_only=True,
        description="a step is missed when the slider moves by less than this part of the extension",
    )
    runaway: float = parameter(
        2.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="motion of a held slider, or beyond what a step can do, that is an error",
    )
    slip: float = parameter(
        1.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="slip of the front clamp in fine positioning after which the motor grips anew",
    )
    drift: float = parameter(
        2.0e-8,
        unit="m/s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="slower than this the grip of the front clamp only seems to slip: sensors drift and creep",
    )
    sensor_timeout: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=10.0,
        read_only=True,
        description="time without a finite measurement after which both clamps close",
    )


@dataclass(frozen=True)
class ScheduleParameters(Parameters):
    """Setpoints over time, so that a run needs no hands."""

    values: tuple[float, ...] = parameter((), unit="m", read_only=True, description="setpoints; empty: none")
    times: tuple[float, ...] = parameter(
        (), unit="s", low=0.0, read_only=True, description="when each of them is given, in rising order"
    )
    duration: float = parameter(
        0.0, unit="s", low=0.0, read_only=True, description="length of a run; 0: the configuration does not say"
    )

    def check(self):
        """There are as many times as values, in rising order."""
        if len(self.times) != len(self.values):
            yield Problem("times", self.times, f"must be {len(self.values)} numbers, one for each of values")
        elif any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            yield Problem("times", self.times, "must rise from one to the next")


@dataclass(frozen=True)
class InchwormSequencerParameters(Parameters):
    """Parameters of the inchworm sequencer."""

    minimum: float = parameter(-5.0e-3, description="lowest setpoint", unit="m", read_only=True)
    maximum: float = parameter(5.0e-3, description="highest setpoint", unit="m", read_only=True)
    initial_setpoint: float = parameter(
        0.0, description="setpoint until the first one is received", unit="m", read_only=True
    )
    home_position: float = parameter(0.0, description="where the service home goes", unit="m", read_only=True)
    resting_extension: float = parameter(
        0.0, description="extension after release, with the front clamp open", unit="m", read_only=True
    )
    gait: GaitParameters = group(GaitParameters)
    fine: FineParameters = group(FineParameters)
    learning: LearningParameters = group(LearningParameters)
    guard: GuardParameters = group(GuardParameters)
    walk: WalkParameters = group(WalkParameters)
    setpoints: ScheduleParameters = group(ScheduleParameters)

    def check(self):
        """The travel is not empty and contains every setpoint of the configuration."""
        if not self.minimum < self.maximum:
            yield Problem("maximum", self.maximum, f"must be > minimum = {self.minimum:g} m")
            return
        places = [("initial_setpoint", self.initial_setpoint), ("home_position", self.home_position)]
        places += [("setpoints.values", value) for value in self.setpoints.values]
        for name, value in places:
            if not self.minimum <= value <= self.maximum:
                allowed = f"outside of the travel, allowed: {self.minimum:g} … {self.maximum:g} m"
                yield Problem(name, value, allowed)
        yield from self.walk.gait_problems(self.gait)

    def refuse_speed(self, speed: float) -> str | None:
        """Say why the motor cannot walk at ``speed`` [m/s], with the number; None when it can."""
        fastest = self.walk.fastest(self.gait)
        if not self.walk.continuous or abs(speed) <= fastest * (1.0 + 1e-9):
            return self.gait.refuse_speed(speed)
        return (
            f"speed {speed:g} m/s refused: continuous walking reaches {fastest:g} m/s ({self.walk.step:g} m at "
            f"{self.gait.frequency:g} Hz); lengthen walk.step, shorten the gait's durations or walk slower"
        )
