# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage of another class than any model, simulated in process, and the situation of its commissioning.

The state of the stage is kept from stage to stage of the commissioning.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.cli.commissioning.bench import Bench
from hysteresis_ros.cli.commissioning.new_file import NewAxis, write_new
from hysteresis_ros.cli.commissioning.situation import Folder, Situation, plan_of
from hysteresis_ros.cli.commissioning.stages import Attendant
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.laboratory.comparison.tasks import ForeignPlant
from hysteresis_ros.laboratory.foreign import ForeignParameters
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.recordings.dataset import Recording

RATE = 2000.0
#: 420 Hz with 1.5 % of damping, one sample of delay, creep, 100 µm over 100 V.
STAGE = ForeignParameters(
    hysteresis="bouc_wen",
    stroke=100e-6,
    voltage=100.0,
    opening=0.13,
    creep=0.02,
    lag=0.0,
    delay=1.0 / RATE,
    frequencies=(420.0, 1700.0),
    dampings=(0.015, 0.02),
    share=0.0,
)


class ForeignBench(Bench):
    """Runs axes with a foreign actuator instead of the plant, as fast as the machine can.

    Parameters
    ----------
    actuator : ForeignParameters
    noise : float
        RMS [m].
    spoil : callable, optional
        ``spoil(signals)`` modifies the recorded signals.
    """

    name = "foreign"

    def __init__(self, actuator: ForeignParameters = STAGE, noise: float = 3e-9, spoil=None):
        self.actuator, self.noise, self.spoil = actuator, noise, spoil
        self.runs = []
        self._state = None

    def run(self, axis) -> Recording:
        """Run an axis; the actuator begins in the state after the last run."""
        # the sensor's zero does not depend on the file
        plant = replace(axis.plant_simulator, driver="", driver_options=(), preload=PreloadParameters())
        plant = replace(plant, sensor=replace(plant.sensor, noise=self.noise, seed=len(self.runs) + 1))
        self.runs.append(axis)
        in_loop = ForeignPlant(plant, self.actuator).in_loop()
        state = in_loop.actuator.xs.hysteresis
        if self._state is not None:
            state[:] = self._state
        found = Axis(axis, in_loop)
        signals = found.run(np.full(plant.samples, axis.reference_generator.initial_setpoint))
        self._state = state.copy()
        if self.spoil is not None:
            self.spoil(signals)
        return Recording(signals.pop("time"), signals)


class Willing(Attendant):
    """Allows every motion and notes the question."""

    def __init__(self):
        self.asked, self.heard = {}, {}

    def may_move(self, stage, words):
        """Allow."""
        self.asked[stage] = words
        return True

    def told(self, stage, outcome, done_before):
        """Note."""
        self.heard[stage] = (outcome, done_before)


#: Entries of the plan that make a commissioning short.
SHORT = "    noise_duration: 0.5\n    cycle_frequency: 2.0\n    creep_duration: 2.0\n"


def sitting(folder, resumed=False, plan="", **choices):
    """Return the situation of a commissioning of a new axis."""
    path = folder / "stage.yaml"
    if not path.exists():
        write_new(path, NewAxis(100e-6, 0.0, 100.0, RATE))
        path.write_text(path.read_text() + SHORT + plan)
    configuration = load_configuration(path)
    axis = single_axis(configuration)
    kept = Folder(folder / "kept", configuration.text, ForeignBench.name, resumed)
    choices = {"model": "prandtl_ishlinskii", "controller": "pid", "against": ("polynomial",), **choices}
    return Situation(configuration, axis, plan_of(configuration, axis), kept, **choices)
