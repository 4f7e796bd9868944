# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a commissioning may move and how: the section ``/commissioning`` of a parameter file, which no node reads."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError, Problem
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.parameters import Parameters, parameter

#: The entry of the file.
SECTION = "/commissioning"


@dataclass(frozen=True)
class Plan(Parameters):
    """What a commissioning may move and how."""

    minimum: float = parameter(description="lowest voltage that it may put out", unit="V", low=-1e4, high=1e4)
    maximum: float = parameter(description="highest voltage that it may put out", unit="V", low=-1e4, high=1e4)
    stroke: float = parameter(
        description="displacement that is expected over that range; another one by a factor of 3 stops it",
        unit="m",
        low=1e-12,
        high=1.0,
    )
    slew_rate: float = parameter(
        0.0, description="largest change of the voltage that the amplifier can follow; 0: any", unit="V/s", low=0.0
    )
    current: float = parameter(
        0.0, description="largest current of the amplifier; 0: not known; needs capacitance", unit="A", low=0.0
    )
    capacitance: float = parameter(
        0.0, description="capacitance of the actuator; 0: not known; needs current", unit="F", low=0.0
    )
    noise_duration: float = parameter(
        4.0, description="how long the sensor is listened to", unit="s", low=0.5, high=600
    )
    step: float = parameter(0.05, description="small step, as a part of the range", low=1e-4, high=0.5)
    small: float = parameter(0.02, description="peak of the multisine, as a part of the range", low=1e-5, high=0.2)
    cycle_frequency: float = parameter(1.0, description="of the decaying cycles", unit="Hz", low=1e-3, high=100.0)
    creep_duration: float = parameter(15.0, description="how long a step is held", unit="s", low=1.0, high=3600.0)
    scan_frequency: float = parameter(5.0, description="of the triangle that is judged", unit="Hz", low=1e-3, high=1e4)
    scan_stroke: float = parameter(
        0.0, description="its displacement from peak to peak; 0: seven tenths of what was reached", unit="m", low=0.0
    )

    def check(self):
        """Yield a Problem when the range is empty."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} V)")
        if (self.current > 0.0) != (self.capacitance > 0.0):
            missing = "capacitance" if self.current > 0.0 else "current"
            yield Problem(missing, 0.0, "current and capacitance give the slew rate together: give both, or neither")

    @property
    def span(self) -> float:
        """Width of the range [V]."""
        return self.maximum - self.minimum

    @property
    def amplifier(self) -> float:
        """What the amplifier can follow [V/s]: its slew rate, or its current into the capacitance; 0: not known."""
        charging = self.current / self.capacitance if self.capacitance > 0.0 else 0.0
        return min((rate for rate in (self.slew_rate, charging) if rate > 0.0), default=0.0)

    @property
    def gain(self) -> float:
        """Gain that is expected [m/V]."""
        return self.stroke / self.span


def plan_of(configuration: Configuration, axis: AxisParameters) -> Plan:
    """Return the plan of a parameter file; where it has none, of the limits and the model of the compensator.

    Parameters
    ----------
    configuration : Configuration
    axis : AxisParameters

    Raises
    ------
    ParameterError
        The section has an unknown or wrong entry.
    ConfigurationError
        The safe voltage is out of the range, or the axis is an inchworm motor.
    """
    if axis.inchworm_sequencer is not None:
        raise ConfigurationError(
            f"{configuration.source}: an inchworm motor walks; commission its extender alone, in a file without "
            "inchworm_sequencer"
        )
    compensator = axis.hysteresis_compensator
    low, high = compensator.limits.minimum, compensator.limits.maximum
    gain = hysteresis_block(compensator.hysteresis, 1.0 / axis.plant_simulator.sample_rate).gain
    given = next((values for name, values in configuration.entries if name == SECTION), {})
    values = {"minimum": low, "maximum": high, "stroke": 1.0, **given}
    plan = Plan.from_mapping(values, prefix=f"{SECTION}: ")
    if "stroke" not in given:
        plan = Plan.from_mapping({**values, "stroke": abs(gain) * plan.span}, prefix=f"{SECTION}: ")
    safe = compensator.safe_voltage
    if not plan.minimum <= safe <= plan.maximum:
        raise ConfigurationError(
            f"{configuration.source}: safe_voltage {safe:g} V of hysteresis_compensator is not within the "
            f"{plan.minimum:g} … {plan.maximum:g} V of {SECTION}; change one of them"
        )
    return plan
