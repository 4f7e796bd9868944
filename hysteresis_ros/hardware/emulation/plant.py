# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A plant with a clock of its own: the actuator of the package, which goes on whether anybody asks it or not."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.linear import zero_order_hold

#: Longest time that is caught up with [s]: a machine that slept does not make its devices hurry.
LONGEST_CATCH_UP = 5.0

#: Stage that stands behind an emulated device when nobody names another one; all of it is assumed: 0.8 µm/V with a loop
#: of some 12 % of the stroke, 1 % creep a decade, a resonance, 2 nm of noise.
WEIGHTS = (0.6e-6, 0.07e-6, 0.06e-6, 0.05e-6)
RADII = (0.0, 5.0, 15.0, 30.0)
CREEP = 0.01
RESONANCE, DAMPING = 300.0, 0.03
NOISE = 2.0e-9
LIMITS = (-30.0, 130.0)


def assumed_stage(cycle: float) -> ActuatorParameters:
    """Return the stage that stands behind an emulated device by default.

    Parameters
    ----------
    cycle : float
        Time between two samples of the plant [s].
    """
    omega = 2.0 * math.pi * RESONANCE
    continuous = [[0.0, omega], [-omega, -2.0 * DAMPING * omega]]
    matrix, entry = zero_order_hold(continuous, [0.0, omega], cycle)
    return ActuatorParameters.from_mapping(
        {
            "limits.minimum": LIMITS[0],
            "limits.maximum": LIMITS[1],
            "hysteresis.type": "prandtl_ishlinskii",
            "hysteresis.prandtl_ishlinskii.radii": RADII,
            "hysteresis.prandtl_ishlinskii.weights": WEIGHTS,
            "creep.type": "logarithmic",
            "creep.logarithmic.rate": CREEP,
            "dynamics.A": tuple(matrix.ravel().tolist()),
            "dynamics.B": tuple(entry.ravel().tolist()),
            "dynamics.C": (1.0, 0.0),
            "dynamics.sample_time": cycle,
            "sensor.noise": NOISE,
        }
    )


class EmulatedPlant:
    """An actuator that makes its samples by a clock, as many as are due whenever it is asked.

    Parameters
    ----------
    parameters : ActuatorParameters
    cycle : float
        Time between two samples [s].
    clock : callable
        Returns the time [s].

    Attributes
    ----------
    measured : float
        Last reading of the sensor [m].
    cycles : int
        Samples so far.
    limits : LimitsParameters
    gain : float
        Displacement of a volt, about [m/V].
    control : callable
        ``control(measured)`` returns the voltage [V] for the next sample; it may keep and record what it likes.
    """

    def __init__(self, parameters: ActuatorParameters, cycle: float, clock: Callable[[], float] = time.monotonic):
        self._actuator = Actuator(parameters, cycle)
        self._actuator.advance(self._actuator.measure())  # compiled now, not at the first question
        self._actuator.reset()
        self.cycle, self._clock = cycle, clock
        self.limits, self.gain = parameters.limits, self._actuator.hysteresis.gain
        self.cycles, self.measured = 0, self._actuator.measure()
        rest = self._actuator.voltage
        self.control: Callable[[float], float] = lambda measured: rest
        self._begun = clock()

    @property
    def voltage(self) -> float:
        """Voltage [V] that the amplifier puts out."""
        return self._actuator.voltage

    def advance(self) -> None:
        """Make the samples that are due."""
        due = math.floor((self._clock() - self._begun) / self.cycle) - self.cycles
        most = round(LONGEST_CATCH_UP / self.cycle)
        if due > most:
            self._begun += (due - most) * self.cycle
            due = most
        advance, measure = self._actuator.advance, self._actuator.measure
        for _ in range(due):
            advance(self.control(self.measured))
            self.measured = measure()
        self.cycles += max(due, 0)
