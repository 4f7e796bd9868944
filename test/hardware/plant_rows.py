# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rows of a plant that is stepped sample by sample, without the rest of the loop."""

from __future__ import annotations

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.models.block import interpreted


def rows_of(plant, kernels, voltages) -> np.ndarray:
    """Return the rows of a plant under these voltages; NaN: no voltage arrives."""
    laws = Laws(*kernels, *(kernels[0],) * (len(Laws._fields) - len(kernels)))
    rows, row = [], [0.0] * at.MOTOR_ROW
    for voltage in voltages:
        interpreted(sense)(laws, plant.arrays, row)
        row[at.VOLTAGE] = voltage
        interpreted(actuate)(laws, plant.arrays, row)
        rows.append(row.copy())
    return np.array(rows)
