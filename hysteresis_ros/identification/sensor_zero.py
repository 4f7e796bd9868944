# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The zero of the sensor: its reading at rest at 0 V, determined from the beginning of a recording.

If the voltage rests at 0 V long enough, the zero is the median reading during this rest. After a rest of only a few
samples, the noise of these readings would shift every displacement. The readings of the first small movement are then
used too: a straight line is fitted to the difference between reading and model, as a function of the movement of the
model. The value of this line at zero movement is the zero, so an error in the gain of the model does not matter.

If a recording begins at another voltage, its first readings may still belong to 0 V, because an axis measures before
its voltage acts and the positioner has a delay; these readings then show the zero. This is assumed if a model that
starts at rest at 0 V fits the readings clearly better than a model that starts at rest at the first voltage. Otherwise
the recording does not show the zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.units import readable

#: The voltage counts as 0 V if its magnitude is at most this fraction of its range.
AT_ZERO = 0.002
#: Number of samples at 0 V that suffice without the movement after them.
ENOUGH = 30
#: Largest movements that are used (the second if the first has too few readings), as fractions of the stroke;
#: hysteresis would bend the line of larger movements.
SMALL_MOVEMENTS = (0.01, 0.05)
#: Largest movement that counts as rest, as a fraction of the stroke.
AT_REST = 1e-4
#: Smallest number of readings during movement that determines a straight line.
FEWEST_MOVING = 8
#: The recording began at rest at 0 V if the error of the model with this start is below this fraction of the error of
#: the model with a start from rest at the first voltage.
CLEARLY = 0.5
#: Least number of samples at the beginning that are compared, if the voltage does not rest there for long enough.
FIRST = 200
#: Number of samples before the recording in which the model comes to rest.
BEFORE = 4000
#: A zero is significant if it differs from 0 by more than this number of standard deviations.
SIGNIFICANT = 3.0
#: Readings farther from the line than this many standard deviations of the bulk of the readings are outliers.
OUTLYING = 4.0


class Chain(Protocol):
    """The members of a :class:`.plant_model.PlantModel` that are needed to determine the zero."""

    @property
    def invertible(self) -> bool:
        """Whether the hysteresis is a separate block."""

    @property
    def initial(self) -> str:
        """Initial state: ``zero``, ``periodic`` or ``estimate``."""

    @property
    def offset(self) -> float:
        """Constant part of the displacement [m]."""

    def simulate(self, voltage) -> np.ndarray:
        """Return the displacement [m] without the offset, from rest at 0 V."""


@dataclass(frozen=True)
class SensorZero:
    """Reading of the sensor at rest at 0 V."""

    value: float  #: [m]
    deviation: float  #: Standard deviation due to the noise of the readings [m]; NaN for a single reading.

    @property
    def significant(self) -> float:
        """The value, or 0 if it does not differ from 0 by more than three standard deviations.

        Most sensors are set to zero at rest, and a zero caused by the noise of a few readings would displace the axis.
        """
        return 0.0 if abs(self.value) <= SIGNIFICANT * self.deviation else self.value


def sensor_zero(data: IdentificationData, chain: Chain) -> SensorZero | None:
    """Return the zero that the beginning of a recording shows; None if the recording does not show it."""
    span = float(np.ptp(data.input))
    away = np.flatnonzero(np.abs(data.input) > AT_ZERO * span)
    standing = int(away[0]) if away.size else len(data)
    if not chain.invertible or chain.initial == "periodic":
        return _at_rest(data.output[:standing], np.zeros(standing)) if standing else None
    first = slice(0, standing if standing >= ENOUGH else min(len(data), max(FIRST, 4 * standing)))
    model = chain.simulate(data.input[first])
    if not standing and not _began_at_zero(data, chain, model):
        return None
    moved, stroke = model - model[0], float(np.ptp(data.output))
    differences = data.output[first] - moved
    rested = _at_rest(differences[:standing], moved[:standing]) if standing else None
    if standing >= ENOUGH:
        return rested
    for size in SMALL_MOVEMENTS:
        large = np.flatnonzero(np.abs(moved) > size * stroke)
        used = slice(0, int(large[0]) if large.size else len(moved))
        if np.count_nonzero(np.abs(moved[used]) > AT_REST * stroke) >= FEWEST_MOVING:
            break
    found = _without_movement(moved[used], differences[used], AT_REST * stroke)
    if found is None or rested is None or len(differences[used]) < FEWEST_MOVING:
        return rested or found
    # white noise of variance s² has second differences of variance 6 s²
    noise = float(np.std(np.diff(differences[used], 2))) / np.sqrt(6.0 * standing)
    rested = SensorZero(rested.value, float(np.hypot(noise, _unsure(moved[:standing]))))
    return found if found.deviation < rested.deviation else rested


def _began_at_zero(data: IdentificationData, chain: Chain, model) -> bool:
    """Return whether the first readings fit a start at rest at 0 V clearly better than one at the first voltage."""
    voltage = np.concatenate([np.full(BEFORE, data.input[0]), data.input[: len(model)]])
    rested = chain.simulate(voltage)[BEFORE:]
    measured = data.output[: len(model)]
    errors = [float(np.std(measured - other)) for other in (model, rested)]
    return errors[0] < CLEARLY * errors[1]


def _at_rest(readings, moved) -> SensorZero:
    """Return the median of readings [m] at rest; the small movement ``moved`` [m] is already subtracted from them."""
    deviation = np.std(readings, ddof=1) / np.sqrt(len(readings)) if len(readings) > 1 else np.nan
    return SensorZero(float(np.median(readings)), float(np.hypot(deviation, _unsure(moved))))


def _unsure(moved) -> float:
    """Return the assumed standard deviation of the small movement of a model: half of the movement."""
    return 0.5 * abs(float(np.median(moved)))


def _without_movement(moved, differences, still: float) -> SensorZero | None:
    """Return the reading at zero movement; ``differences`` are readings minus the model's movement ``moved`` [m]."""
    resting = np.abs(moved) <= still
    if np.count_nonzero(~resting) < FEWEST_MOVING:
        return _at_rest(differences[resting], moved[resting]) if resting.any() else None
    table = np.column_stack([np.ones(len(moved)), moved])
    used = np.ones(len(moved), dtype=bool)
    for _ in range(3):
        found = np.linalg.lstsq(table[used], differences[used], rcond=None)[0]
        left = differences - table @ found
        size = 1.4826 * float(np.median(np.abs(left[used])))
        used = np.abs(left) <= OUTLYING * max(size, np.finfo(float).tiny)
    covariance = np.linalg.pinv(table[used].T @ table[used])
    deviation = np.sqrt(covariance[0, 0] * np.sum(left[used] ** 2) / max(np.count_nonzero(used) - 2, 1))
    return SensorZero(float(found[0]), float(deviation))


def zero_warnings(data: IdentificationData, chain: Chain) -> tuple[str, ...]:
    """Return a sentence if the recording does not show the zero of the sensor."""
    if not chain.invertible or sensor_zero(data, chain) is not None:
        return ()
    return (
        f"the recording does not show the zero of the sensor: it begins at {readable(float(data.input[0]), 'V')}, so "
        f"{readable(chain.offset, 'm')} is extrapolated by the model; begin at rest at 0 V, or correct preload.A1",
    )
