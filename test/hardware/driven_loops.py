# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs of devices that machine code calls, fused without deadlines, and their twins."""

from __future__ import annotations

import math

import numpy as np
from plant_rows import rows_of

from hysteresis_ros import signals as at
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.device import CompiledPlant, fused_plant_of
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.parameters import AxisParameters


def run(plant, voltages) -> np.ndarray:
    return rows_of(plant, CompiledPlant.kernels[:1], voltages)


def fused(parameters: AxisParameters, samples: int) -> tuple[FusedLoop, np.ndarray]:
    """Run an axis in its thread without deadlines; return its rows, too."""
    loop = FusedLoop(Axis(parameters, fused_plant_of(parameters.plant_simulator)), math.inf, samples)
    loop.start()
    assert loop.join(60.0) and not loop.failure
    return loop, loop.take().table


def assert_equal_to_twin(given: AxisParameters, loop: FusedLoop, table: np.ndarray) -> None:
    twin = Axis(given, fused_plant_of(given.plant_simulator, linked=False))
    taken = {"measured": at.MEASURED, "tripped": at.TRIPPED, "plant_voltage": at.PLANT_VOLTAGE}
    answers = {name: table[place] for name, place in taken.items()}
    options = {"changes": loop.changes, "skipped": table[at.SKIPPED], "answers": answers}
    options["pulses"] = table[at.TRIGGER_IN]
    again = twin.run(table[at.SETPOINT], **options)
    for place, signal in enumerate(at.ACTUATOR.row):
        np.testing.assert_array_equal(again[signal.name], table[place], err_msg=signal.name)
