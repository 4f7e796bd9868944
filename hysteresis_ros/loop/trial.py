# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How fast an axis' loop can be on this machine: what a sample costs, and how late samples begin at a rate."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from hysteresis_ros.block import COMPILED
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop import pacing as at
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.fused import FusedLoop, machine, pace_arrays
from hysteresis_ros.loop.ring import Lateness, lateness

#: A rate is held when 99 % of the samples begin within this part of a period, and fewer than this part are skipped.
LATEST, MOST_SKIPPED = 0.5, 0.005
#: Batches, and samples of each, in which the cost of a sample is measured: of the batches the quickest counts.
BATCHES, BATCH = 5, 100


class Trial(NamedTuple):
    """What a loop did at a rate.

    Parameters
    ----------
    rate : float
        Samples per second [Hz].
    lateness : Lateness
        How late its samples began, and how many were skipped.
    warning : str
        What the operating system did not permit; empty when all was.
    """

    rate: float
    lateness: Lateness
    warning: str

    @property
    def is_held(self) -> bool:
        """Whether the machine holds this rate."""
        late = self.lateness
        return late.p99 * self.rate < LATEST and late.missed < MOST_SKIPPED * late.samples


def trial(parameters: AxisParameters, seconds: float, priority: int) -> Trial:
    """Run an axis' fused loop for a moment in real time, and return how it kept the time.

    Parameters
    ----------
    parameters : AxisParameters
        Its plant is simulated, whatever driver it names.
    seconds : float
        Length of the run [s].
    priority : int
        Of its thread, SCHED_FIFO; 0: a normal one.
    """
    plant = parameters.plant_simulator
    realtime = replace(plant.realtime, priority=priority)
    # what a busy machine makes late must not end the trial
    asked = replace(parameters, plant_simulator=replace(plant, realtime=realtime, late_limit=-1))
    loop = FusedLoop(Axis(asked), samples=max(round(seconds * plant.sample_rate), 1))
    loop.start()
    try:
        loop.join()
    finally:
        loop.leave()  # also when somebody interrupts
    if loop.failure:
        raise ConfigurationError(loop.failure)
    return Trial(plant.sample_rate, loop.lateness(), loop.warning)


def tick_cost(parameters: AxisParameters) -> float:
    """Return what a sample of an axis takes on this machine at least, beyond waiting [s]; its plant is simulated."""
    axis = Axis(parameters)
    found = []
    for _ in range(BATCHES):
        own = pace_arrays(axis)
        own.state[at.UNTIL] = own.state[at.SAMPLE] + BATCH
        run, arguments = machine(axis, own)
        run(*arguments)
        found.append(lateness(own).cost)
    return min(found)


def require_speed(parameters: AxisParameters) -> None:
    """Refuse an axis whose samples take longer than they may, before anything moves.

    Raises
    ------
    ConfigurationError
        Names the rate, what a sample takes here, and the option that runs it nevertheless.
    """
    plant = parameters.plant_simulator
    if plant.realtime.force or plant.driver or not COMPILED:
        return  # what a device takes is known only once it is driven; without Numba the loop has its own limit
    rate, cost = plant.sample_rate * plant.real_time_factor, tick_cost(parameters)
    if cost * rate > 1.0:
        raise ConfigurationError(
            f"sample_rate = {plant.sample_rate:g} Hz at real_time_factor {plant.real_time_factor:g}: a sample takes "
            f"{1e6 * cost:.3g} µs on this machine, which holds at most {1.0 / cost:.3g} of them a second; lower one "
            "of the two, or run it nevertheless with --force (realtime.force: true)"
        )
