# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The slider of an inchworm motor: its parameters, its contacts, and the block that moves it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.friction import (
    ANCHOR,
    BEFORE,
    CONVERGED,
    FORCE,
    FREE,
    FRONT_FORCE,
    FRONT_STATIC,
    FRONT_STIFFNESS,
    FRONT_STUCK,
    GRIP,
    MOST_SUBSTEPS,
    POSITION,
    REAR_FORCE,
    REAR_STATIC,
    REAR_STIFFNESS,
    REAR_STUCK,
    STATES,
    STIFFNESS,
    TIP,
    clip,
    slide,
    slide_elastically,
)
from hysteresis_ros.models.sensor import SensorParameters
from hysteresis_ros.parameters import Parameters, group, parameter


@dataclass(frozen=True)
class SliderParameters(Parameters):
    """Slider of an inchworm motor: mass, load and travel."""

    mass: float = parameter(description="mass that moves with the slider", unit="kg", low=1e-6, high=1e4)
    external_force: float = parameter(
        0.0, description="load on the slider, positive toward larger displacement", unit="N", low=-1e6, high=1e6
    )
    inclination: float = parameter(
        0.0,
        description="angle of the direction of larger displacement above the horizontal",
        unit="rad",
        low=-1.5707963267948966,
        high=1.5707963267948966,
    )
    gravity: float = parameter(9.80665, description="acceleration of free fall", unit="m/s²", low=0.0, high=100.0)
    minimum: float = parameter(description="end stop at the smallest displacement", unit="m")
    maximum: float = parameter(description="end stop at the largest displacement", unit="m")
    start: float = parameter(0.0, description="displacement at the start", unit="m")
    damping: float = parameter(
        0.0,
        description="damping ratio of the slider on compliant contacts",
        low=0.0,
        high=10.0,
        read_only=True,
    )
    substeps: int = parameter(
        1,
        description="steps of the friction within a sample, with compliant contacts; 0: as many as converge",
        low=0,
        high=1000,
        read_only=True,
    )
    sensor: SensorParameters = group(SensorParameters)

    @property
    def force(self) -> float:
        """External force and the part of the weight along the travel [N]."""
        return self.external_force - self.mass * self.gravity * elementary.sin(self.inclination)

    def check(self):
        """Yield a Problem when the travel is empty or does not hold the start."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} m)")
        elif not self.minimum <= self.start <= self.maximum:
            allowed = f"must lie within the travel minimum … maximum = {self.minimum:g} … {self.maximum:g} m"
            yield Problem("start", self.start, allowed)
        if self.substeps == 0 and not self.damping > 0.0:
            allowed = "steps converge to the damping of the joint: needs slider.damping above 0, e.g. 0.03"
            yield Problem("substeps", self.substeps, allowed)


@dataclass(frozen=True)
class Contacts:
    """What the contacts are besides friction; all 0: rigid.

    Parameters
    ----------
    front_compliance, rear_compliance : float
        [m/N]
    front_kick, rear_kick : float
        Motion of the contact for each newton of its static friction limit [m/N].
    """

    front_compliance: float = 0.0
    rear_compliance: float = 0.0
    front_kick: float = 0.0
    rear_kick: float = 0.0

    @property
    def rigid(self) -> bool:
        """Whether neither contact gives way."""
        return not (self.front_compliance > 0.0 and self.rear_compliance > 0.0)


class Slider(Block):
    """Slider between two friction contacts; write their limits [N] to ``x[12:16]`` before each step.

    Parameters
    ----------
    parameters : SliderParameters
        Mass, load and travel.
    sample_time : float
        Sample time [s].
    stiffness : float
        Stiffness of the extender that carries the front contact [N/m].
    contacts : Contacts, optional
        Rigid by default.
    """

    def __init__(
        self, parameters: SliderParameters, sample_time: float, stiffness: float, contacts: Contacts | None = None
    ):
        self.stiffness = float(stiffness)
        self.contacts = contacts or Contacts()
        self.kernel = slide if self.contacts.rigid else slide_elastically
        super().__init__(parameters, sample_time)

    def pack(self, parameters: SliderParameters) -> np.ndarray:
        """Return p, shape (13,)."""
        travel = (parameters.minimum, parameters.maximum)
        head = [self.sample_time, parameters.mass, parameters.force, self.stiffness, *travel]
        contacts = self.contacts
        if contacts.rigid:
            return np.array([*head, *np.zeros(7)])
        springs = [1.0 / (1.0 / self.stiffness + contacts.front_compliance), 1.0 / contacts.rear_compliance]
        dampers = [2.0 * parameters.damping * math.sqrt(spring * parameters.mass) for spring in springs]
        steps = parameters.substeps
        if steps == 0:
            numerical = 0.5 * self.sample_time * math.sqrt(springs[0] / parameters.mass)
            steps = min(max(math.ceil(numerical / (CONVERGED * parameters.damping)), 1), MOST_SUBSTEPS)
        return np.array([*head, steps, *springs, *dampers, contacts.front_kick, contacts.rear_kick])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (22,): at rest at the start, both contacts open, the extender at 0."""
        x = np.zeros(STATES)
        x[POSITION] = x[GRIP] = x[ANCHOR] = self.parameters.start
        return x

    def settle(self, free: float) -> None:
        """Put the slider to rest under its load and the limits in ``x``; the rear contact carries what it can.

        Parameters
        ----------
        free : float
            Displacement of the extender without load [m].
        """
        x, load = self.x, self.p[FORCE]
        x[REAR_FORCE] = clip(-load, x[REAR_STATIC])
        x[FRONT_FORCE] = clip(-load - x[REAR_FORCE], x[FRONT_STATIC])
        x[REAR_STUCK], x[FRONT_STUCK] = float(x[REAR_STATIC] > 0.0), float(x[FRONT_STATIC] > 0.0)
        x[TIP] = free - x[FRONT_FORCE] / self.p[STIFFNESS]
        x[GRIP] = x[POSITION] - x[TIP]
        if not self.contacts.rigid:
            x[GRIP] = x[POSITION] - free + x[FRONT_FORCE] / self.p[FRONT_STIFFNESS]
            x[ANCHOR] = x[POSITION] + x[REAR_FORCE] / self.p[REAR_STIFFNESS]
            x[FREE] = free
            x[BEFORE : BEFORE + 4] = x[FRONT_STATIC : FRONT_STATIC + 4]

    def check_travel(self, parameters: SliderParameters) -> None:
        """Raise ParameterError when a new travel leaves the slider outside."""
        position = float(self.x[POSITION])
        for name, inside in (
            ("minimum", parameters.minimum <= position),
            ("maximum", position <= parameters.maximum),
        ):
            if not inside:
                allowed = f"must leave the slider, now at {position:g} m, inside the travel"
                raise ParameterError([Problem(f"inchworm.slider.{name}", getattr(parameters, name), allowed)])
