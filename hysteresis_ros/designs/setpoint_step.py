# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Voltage during a step of an axis to its farthest setpoint, through the approach of the axis."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.waveforms import WaveformParameters
from hysteresis_ros.units import readable

#: Number of samples before the step.
BEFORE = 20
#: Minimum number of samples after the arrival of the reference, in addition to the preview.
AFTER = 400
#: Simulated time after the arrival [s], if it is longer than AFTER samples.
SETTLING = 0.2
#: Maximum number of samples of the run.
MOST = 400_000


@dataclass(frozen=True)
class SetpointStep:
    """A simulated step to the farthest setpoint."""

    size: float  #: [m]
    #: Overshoot beyond the final displacement, as a fraction of the motion.
    overshoot: float
    largest: float  #: Largest change of the voltage in one sample [V].
    asked: float  #: Largest change of the voltage in one sample if no slew rate applied [V].
    allowed: float  #: Largest change in one sample that the slew rate allows [V]; inf: the file has no slew rate.
    feedforward: str  #: Type of a feedforward that inverts the dynamics; otherwise empty.

    @property
    def share(self) -> float:
        """Ratio of requested to allowed change; above 1 the slew rate limits the voltage."""
        return self.asked / self.allowed

    def rows(self) -> list[tuple[str, str]]:
        """Return the printed rows."""
        share = "no slew rate in the file" if math.isinf(self.allowed) else f"{100.0 * self.share:.3g} %"
        return [
            ("setpoint step", f"{readable(self.size, 'm')} through the approach"),
            ("overshoot of the step", f"{100.0 * self.overshoot:.3g} %"),
            ("largest voltage step", f"{self.largest:.3g} V in a sample"),
            ("share of the slew limit", f"{share}{', cut' if self.share > 1.0 else ''}"),
        ]


def setpoint_step(axis: AxisParameters) -> SetpointStep | None:
    """Simulate the step of an axis from its initial to its farthest setpoint; None for an inchworm motor."""
    if axis.reference_generator is None:
        return None
    axis = at_setpoint(axis)
    own = replace(axis.generator, waveform=WaveformParameters())
    rate = axis.plant_simulator.sample_rate
    generator = ReferenceGenerator(part(own, ReferenceParameters), 1.0 / rate)
    feedforward, start = axis.motion_controller.feedforward, own.initial_setpoint
    target = max((own.minimum, own.maximum), key=lambda end: abs(end - start))
    moving = round(generator.approach.duration(target - start) * rate)
    after = max(AFTER, round(SETTLING * rate)) + feedforward.preview
    setpoints = np.full(min(BEFORE + moving + after, MOST), target)
    setpoints[:BEFORE] = start
    still = replace(axis, reference_generator=own)
    found = simulate(still, setpoints=setpoints, describe=False)
    free = simulate(unlimited(still), setpoints=setpoints, describe=False)
    size = abs(target - start)
    rates = (node.limits.slew_rate for node in (axis.plant_simulator, axis.hysteresis_compensator))
    allowed = min((one / rate for one in rates if one > 0.0), default=math.inf)
    return SetpointStep(
        size=size,
        overshoot=overshoot_of(found["displacement"], target - start),
        largest=_largest(found["voltage"]),
        asked=_largest(free["voltage"]),
        allowed=allowed,
        feedforward=feedforward.type if feedforward.inverts else "",
    )


def overshoot_of(displacement: np.ndarray, move: float) -> float:
    """Return the overshoot of a step beyond the final displacement, as a fraction; ``move`` [m] gives the direction."""
    way = np.sign(move) * (displacement - displacement[0])
    goal = float(way[-1])
    return max(round(float(np.max(way)) / goal - 1.0, 9), 0.0) if goal > 0.0 else math.inf


def step_lines(text: str, namespace: str | None, refuse: bool) -> list[str]:
    """Return the printed lines about the setpoint step of a designed file."""
    step = setpoint_step(single_axis(parse_configuration(text, "the designed file"), namespace))
    if step is None:
        return []
    if refuse:
        require_gentle(step)
    rows = step.rows()
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {words}" for name, words in rows]


def require_gentle(step: SetpointStep | None) -> None:
    """Refuse a feedforward whose voltage changes faster than the slew rate in the step to the farthest setpoint."""
    if step is not None and step.feedforward and step.share > 1.0:
        raise ConfigurationError(
            f"feedforward {step.feedforward}: a setpoint {readable(step.size, 'm')} away needs a change "
            f"of {step.asked:.3g} V in a sample, but limits.slew_rate allows {step.allowed:.3g} V; "
            "lower approach.maximum_velocity, "
            "maximum_acceleration and maximum_jerk of reference_generator, or design without --feedforward"
        )


def _largest(voltage: np.ndarray) -> float:
    return float(np.max(np.abs(np.diff(voltage))))


def at_setpoint(axis: AxisParameters) -> AxisParameters:
    """Return the axis with a reference that begins at the initial setpoint, even with ``approach.from_rest``."""
    own = axis.generator
    return replace(axis, reference_generator=replace(own, approach=replace(own.approach, from_rest=False)))


def unlimited(axis: AxisParameters) -> AxisParameters:
    """Return the axis without slew rates."""

    def free(limits: LimitsParameters) -> LimitsParameters:
        return replace(limits, slew_rate=0.0)

    plant, compensator = axis.plant_simulator, axis.hysteresis_compensator
    return replace(
        axis,
        plant_simulator=replace(plant, limits=free(plant.limits)),
        hysteresis_compensator=replace(compensator, limits=free(compensator.limits)),
    )
