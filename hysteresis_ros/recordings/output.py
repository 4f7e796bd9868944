# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The voltage that left for the device: what is recorded as ``voltage`` wherever the plant says what it put out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hysteresis_ros.signals import ASKED_VOLTAGE, LEAST_DIFFERENCE, MODE_HOLDING


def output_tolerance(plant: Mapping, compensator: Mapping) -> float:
    """Return by how much [V] converters make differ what was asked and what was put out; infinite: nobody knows.

    Parameters
    ----------
    plant, compensator : mapping
        Flat dotted parameters of ``plant_simulator`` and ``hysteresis_compensator``.
    """
    try:
        # a device rounds by itself, and says what it was given
        own = 0.0 if plant.get("driver") else _step(plant)
        return own + _step(compensator) + LEAST_DIFFERENCE
    except (ArithmeticError, KeyError, TypeError, ValueError):
        return np.inf


def note_output(signals: dict[str, np.ndarray], plant_voltage, plant_mode, tolerance: float) -> None:
    """Let the signals of a run say what has left for the actuator where that is not what was asked.

    Row k of the plant's state holds what it put out for the voltage of sample k. Where that differs by more than the
    converters do, ``voltage`` becomes what left, ``saturated`` 1, and what was asked for is kept as ``asked_voltage``,
    which a run without such samples does not have. A voltage that did not come in time is no limit: what left is the
    one before, and ``saturated`` stays.

    Parameters
    ----------
    signals : dict of str to array
        Those of a run; changed in place, the arrays are not.
    plant_voltage, plant_mode : array_like, shape (N,)
        What the plant put out [V] and what it did, NaN where it did not say.
    tolerance : float
        See :func:`output_tolerance`.
    """
    if "voltage" not in signals:
        return
    asked, left = signals["voltage"], np.asarray(plant_voltage, dtype=float)
    with np.errstate(invalid="ignore"):
        differs = np.abs(left - asked) > tolerance
    if not np.any(differs):
        return
    signals[ASKED_VOLTAGE] = asked
    signals["voltage"] = np.where(differs, left, asked)
    if "saturated" in signals:
        limited = differs & (np.asarray(plant_mode) != MODE_HOLDING)
        signals["saturated"] = np.where(limited, 1.0, signals["saturated"])


def _step(parameters: Mapping) -> float:
    """Return the grid [V] of a converter over its range; 0: there is none."""
    low, high = float(parameters["limits.minimum"]), float(parameters["limits.maximum"])
    bits = int(parameters.get("limits.bits", 0))
    return (high - low) / (2**bits - 1) if bits else 0.0
