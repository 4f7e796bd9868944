"""Rows of a plant that is worked sample by sample, without the rest of the loop."""

from __future__ import annotations

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.block import interpreted
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.tick import Laws


def rows_of(plant, kernels, voltages) -> np.ndarray:
    """Return the rows of a plant that is given these voltages, NaN for those that do not come."""
    laws = Laws(*kernels, *(kernels[0],) * (len(Laws._fields) - len(kernels)))
    rows, row = [], [0.0] * at.MOTOR_ROW
    for voltage in voltages:
        interpreted(sense)(laws, plant.arrays, row)
        row[at.VOLTAGE] = voltage
        interpreted(actuate)(laws, plant.arrays, row)
        rows.append(row.copy())
    return np.array(rows)
