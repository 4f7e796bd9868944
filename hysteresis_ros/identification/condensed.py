# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings as fits use them: as coarse as the loops allow, without outliers, and from where the past is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.weights import plays
from hysteresis_ros.recordings.loops import turning_points

#: Data is made coarser until the voltage moves by this part of its range in one sample …
LARGEST_STEP = 0.02
#: … and no further than needed to come down to this many samples.
ENOUGH_SAMPLES = 6000
#: The fit starts where the input has come within this part of its range of both ends: the past is wiped out there.
WIPED_OUT = 0.05

#: Swings above this part of the range are all of one size.
ONE_SIZE = 0.8
#: What comes after must rise and fall by this part of the range.
LEAST_SWING = 0.5


@dataclass(frozen=True, eq=False)
class Condensed:
    """Data as a fit uses it: uniform, as coarse as the loops allow, centred on block averages.

    Parameters
    ----------
    voltage, displacement : ndarray, shape (N,)
        [V], [m].
    sample_time : float
        [s]
    first : int
        First sample whose residual counts.
    factor : int
        How many samples of the recording make one.
    kept : ndarray of bool, shape (N - first,)
        Which of the samples that count are no outliers.
    remembers : bool
        The past before the recording matters to the samples that count.
    drifts : bool
        Beside a constant the displacement may hold one that grows with time.
    history : tuple of float
        Voltages [V] that the hysteresis went through, from rest at 0 V, before the first sample.
    """

    voltage: np.ndarray
    displacement: np.ndarray
    sample_time: float
    first: int
    factor: int
    kept: np.ndarray
    remembers: bool = False
    drifts: bool = False
    history: tuple[float, ...] = ()

    def counted(self, values) -> np.ndarray:
        """Return of values, shape (N, ...), those whose residual counts."""
        return values[self.first :][self.kept]

    @property
    def constants(self) -> np.ndarray:
        """What is not moved by the voltage, shape (N, 1 or 2): a constant, and a drift that is 1 at the end."""
        places = np.arange(len(self.voltage)) / len(self.voltage)
        return np.column_stack([np.ones(len(places)), places] if self.drifts else [np.ones(len(places))])

    @property
    def reach(self) -> float:
        """Radius [V] from which on no play moves: half the range, from rest the largest voltage."""
        half = 0.5 * self.voltage_range
        return max(half, float(np.max(np.abs([*self.voltage, *self.history])))) if self.remembers else half

    def plays(self, play_radii) -> np.ndarray:
        """Return the outputs, shape (N, m), of plays that went through the history before the first sample."""
        before = plays(np.array([0.0, *self.history]), play_radii)[-1]
        return plays(self.voltage, play_radii, before)

    @property
    def voltage_range(self) -> float:
        """Peak-to-peak voltage [V]."""
        return float(np.ptp(self.voltage))

    @property
    def stroke(self) -> float:
        """Peak-to-peak displacement [m] of the samples that count."""
        return float(np.ptp(self.counted(self.displacement)))


def condense(
    voltage,
    displacement,
    sample_time: float,
    skip: int | None = None,
    *,
    kept=None,
    history: tuple[float, ...] = (),
    enough: int = ENOUGH_SAMPLES,
) -> Condensed:
    """Average blocks of samples, so that a long or finely sampled recording is fitted in seconds.

    Parameters
    ----------
    voltage, displacement : array_like, shape (N,)
        [V] and [m], uniformly sampled, without gaps.
    sample_time : float
        [s]
    skip : int, optional
        Samples left out of the fit at the start (the models see their voltage all the same); by default those until
        the past is wiped out, if a whole cycle comes after them (:func:`wiped_out`).
    kept : array_like of bool, shape (N,), optional
        False for outliers; they are left out of the averages.
    history : tuple of float
        See :class:`Condensed`.
    enough : int
        The data is made no coarser than to this many samples.

    Raises
    ------
    IdentificationError
        Shapes differ, values are not finite or constant, or too few samples are left.
    """
    v, y = (np.ascontiguousarray(values, dtype=np.float64) for values in (voltage, displacement))
    if v.ndim != 1 or v.shape != y.shape or v.size < 50:
        raise IdentificationError(f"voltage {v.shape} and displacement {y.shape}: must have one shape (N,), N ≥ 50")
    if not np.all(np.isfinite(v)) or not np.all(np.isfinite(y)):
        raise IdentificationError("voltage or displacement has NaN or infinite values; cut them out or resample")
    if np.ptp(v) == 0.0 or np.ptp(y) == 0.0:
        raise IdentificationError("voltage or displacement is constant; record a moving input")
    if len(turning_points(v)) < 3:
        raise IdentificationError("the voltage never turns: a loop model needs a rising and a falling branch")
    wiped = wiped_out(v)
    first = wiped or 0 if skip is None else skip
    if not 0 <= first < v.size - 50:
        raise IdentificationError(f"skip = {skip}: must leave at least 50 of the {v.size} samples")
    # the steepest steps of all may be jumps at the start, which no sampling resolves
    step = float(np.quantile(np.abs(np.diff(v)), 0.98)) / float(np.ptp(v))
    coarsest = max(1, int(LARGEST_STEP / step)) if step > 0.0 else 1
    factor = max(1, min(coarsest, v.size // enough))
    blocks = v.size // factor
    used = np.ones(v.size) if kept is None else np.asarray(kept, dtype=float)
    v, used, y = (
        values[: blocks * factor].reshape(blocks, factor).sum(axis=1) for values in (v / factor, used, used * y)
    )
    remembers = wiped is None or first < wiped
    first = math.ceil(first / factor)
    y = y / np.maximum(used, 1.0)
    return Condensed(v, y, factor * sample_time, first, factor, used[first:] > 0.0, remembers, history=history)


def wiped_out(voltage) -> int | None:
    """Return the sample from which the past no longer matters, if a cycle comes after it; else None.

    A voltage that has been at both ends of its range has moved every play operator that the recording moves. It has to
    fall and to rise afterwards, by half of the range each: less would show one branch alone.

    Parameters
    ----------
    voltage : ndarray, shape (N,)
        [V]
    """
    span = np.ptp(voltage)
    top = np.flatnonzero(voltage >= voltage.max() - WIPED_OUT * span)[0]
    bottom = np.flatnonzero(voltage <= voltage.min() + WIPED_OUT * span)[0]
    first = int(max(top, bottom))
    swings = np.diff(voltage[first:][turning_points(voltage[first:])])
    large = swings[np.abs(swings) >= LEAST_SWING * span]
    return first if np.any(large > 0.0) and np.any(large < 0.0) else None


def simple_loops(data: Condensed) -> bool:
    """Return whether all loops that count are of one size: nothing is seen of what happens inside of them.

    Parameters
    ----------
    data : Condensed
    """
    voltage = data.voltage[data.first :]
    swings = np.abs(np.diff(voltage[turning_points(voltage)]))[1:-1]  # the ends may be cut
    return not data.remembers and bool(np.all(swings > ONE_SIZE * data.voltage_range))
