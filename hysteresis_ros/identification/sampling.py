# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Instants that are not uniform: stamps that jitter where the samples do not, gaps, and a uniform grid for all else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.data_checks import GRID_TOLERANCE, DataError
from hysteresis_ros.units import readable

#: Samples are taken as uniform when that makes the signals this much smoother than their stamps do.
SMOOTHER = 0.7
#: Distances above this many medians are gaps.
GAP = 1.5
#: Gaps of so many samples are bridged without being asked for; of longer ones the longest part without one is taken, if
#: it holds this part of the samples.
SHORT_GAP, LONG_ENOUGH = 3, 0.3


def steadied(data: IdentificationData) -> IdentificationData:
    """Return the data on a uniform grid where the signals say that only their stamps jitter.

    A computer often stamps late what a converter took in time. Each sample is predicted from the two before and the two
    after it by the cubic through them, once with the stamps and once with equal distances: whichever is right predicts
    better.

    Parameters
    ----------
    data : IdentificationData
        Without gaps; otherwise it is returned as it is.
    """
    if len(data) < 20:
        return data
    distances = np.diff(data.time)
    median = float(np.median(distances))
    index = np.arange(len(data)) - 0.5 * (len(data) - 1)
    # the straight line through all: the ends jitter as the others do
    grid = data.time.mean() + index * (np.dot(index, data.time - data.time.mean()) / np.dot(index, index))
    beside = float(np.max(np.abs(data.time - grid)))
    if beside <= GRID_TOLERANCE * median or distances.max() > 2.5 * median or beside > 5.0 * median:
        return data
    finite = np.isfinite(data.input) & np.isfinite(data.output)
    signals = [data.input[finite], data.output[finite]]
    roughness = [
        math.prod(_roughness(instants[finite], values) for values in signals) for instants in (data.time, grid)
    ]
    if not roughness[1] < SMOOTHER**2 * roughness[0]:
        return data
    smoother = math.sqrt(roughness[0] / roughness[1]) if roughness[1] else math.inf
    warning = (
        f"stamps jitter by up to {readable(beside, 's')} beside a grid of {readable(grid[1] - grid[0], 's')}, the "
        f"signals do not (with equal distances they are {smoother:.2g} times smoother): taken as uniform"
    )
    return replace(data, time=grid, warnings=(*data.warnings, warning))


def uninterrupted(data: IdentificationData) -> IdentificationData:
    """Return data of a uniform grid without its gaps: short ones bridged, else the longest part without one.

    What happens in a longer gap is unknown, and so is the memory of a hysteresis after it. Samples whose input or
    output is missing are gaps too. Where no part is long enough, or the samples jitter, the data is returned as it is.

    Parameters
    ----------
    data : IdentificationData
    """
    finite = np.flatnonzero(np.isfinite(data.input) & np.isfinite(data.output))
    if finite.size < 50:
        return data
    distances = np.diff(data.time[finite])
    median = float(np.median(distances))
    steps = np.rint(distances / median)
    if not median > 0.0 or np.max(steps) < 2 or np.max(np.abs(distances - steps * median)) > GRID_TOLERANCE * median:
        return data
    if np.max(steps) <= SHORT_GAP + 1:
        return resample(data, median)
    edges = np.flatnonzero(np.r_[True, steps > 1, True])
    widest = int(np.argmax(np.diff(edges)))
    first, last = int(finite[edges[widest]]), int(finite[edges[widest + 1] - 1]) + 1
    part = (last - first) / finite.size
    if part < LONG_ENOUGH:
        return data
    longest = int(np.argmax(steps))
    warning = (
        f"{np.count_nonzero(steps > 1)} gaps, the longest {distances[longest]:.4g} s at "
        f"{data.time[finite][longest]:.6g} s: the longest part without one is taken, samples {data.first + first} to "
        f"{data.first + last - 1} ({100.0 * part:.0f} %); another part with --range, all with --resample auto, which "
        "bridges the gaps by straight lines"
    )
    return replace(data.part(first, last), warnings=(*data.warnings, warning))


def _roughness(time, values) -> float:
    """Return the RMS error of predicting each sample from four neighbours, in parts of the range."""
    t = [time[k : len(time) - 4 + k] - time[2:-2] for k in range(5)]
    predicted = 0.0
    for k in (0, 1, 3, 4):
        weight = 1.0
        for j in (0, 1, 3, 4):
            if j != k:
                weight = weight * t[j] / (t[j] - t[k])
        predicted = predicted + weight * values[k : len(time) - 4 + k]
    return float(np.sqrt(np.mean((values[2:-2] - predicted) ** 2)) / (np.ptp(values) or 1.0))


def resample(data: IdentificationData, sample_time: float | None = None) -> IdentificationData:
    """Return the data on a uniform grid: linear between the samples there are, low-passed where it becomes coarser.

    Parameters
    ----------
    data : IdentificationData
        Missing values are bridged; a warning says how many, and how long the longest gap is.
    sample_time : float, optional
        [s]; the median distance of the data by default.

    Raises
    ------
    DataError
        Fewer than two samples are there, or the sample time is not positive or longer than the data.
    """
    finite = np.isfinite(data.input) & np.isfinite(data.output)
    if np.count_nonzero(finite) < 2:
        raise DataError("short", f"{np.count_nonzero(finite)} samples are there; resampling needs two")
    time = data.time[finite]
    distances = np.diff(time)
    median = float(np.median(distances))
    if np.ptp(distances) > GRID_TOLERANCE * median:
        # jitter moves the median, but not the mean
        median = float(np.mean(distances[~_gaps(distances, median)]))
    target = median if sample_time is None else float(sample_time)
    if not 0.0 < target < time[-1] - time[0]:
        raise DataError("resample", f"sample time {target:g} s: must be in 0 … {time[-1] - time[0]:g} s")
    factor = max(1, math.ceil(target / median - 1e-6)) if target > 1.5 * median else 1
    grid = time[0] + np.arange(int((time[-1] - time[0]) / (target / factor) + 1e-6) + 1) * (target / factor)
    columns = [np.interp(grid, time, values[finite]) for values in (data.input, data.output)]
    if factor > 1:
        columns = [_decimated(values, factor) for values in columns]
    note = f"resampled from {readable(median, 's')} to {readable(target, 's')}"
    grid = grid[::factor]
    rows = data.first + np.flatnonzero(finite)
    warnings = (*data.warnings, *_bridged(time, median, rows), *_jittering(time, median))
    notes = (*data.notes, note)
    return replace(data, time=grid, input=columns[0], output=columns[1], first=0, notes=notes, warnings=warnings)


def _gaps(distances, median):
    """Return which distances are gaps: jitter alone, three of its standard deviations, makes none."""
    jitter = 1.5 * float(np.median(np.abs(distances - median)))
    return distances > max(GAP * median, median + 3.0 * jitter)


def _bridged(time, median, rows):
    """Yield a warning about the gaps that straight lines bridge."""
    distances = np.diff(time)
    gaps = _gaps(distances, median)
    if not gaps.any():
        return
    longest = int(np.argmax(distances))
    lost = int(np.sum(np.rint(distances[gaps] / median) - 1.0))
    stretches = np.flatnonzero(np.r_[True, gaps, True])
    widest = int(np.argmax(np.diff(stretches)))
    first, last = rows[stretches[widest]], rows[stretches[widest + 1] - 1] + 1
    yield (
        f"{np.count_nonzero(gaps)} gaps ({lost} samples) bridged by straight lines, the longest "
        f"{distances[longest]:.4g} s at {time[longest]:.6g} s; what happened in them is unknown (longest part without "
        f"one: --range {first}:{last})"
    )


def _jittering(time, median):
    """Yield a warning about samples beside their places, gaps apart."""
    distances = np.diff(time)
    whole = np.maximum(np.rint(distances / median), 1.0)
    beside = float(np.quantile(np.abs(distances - whole * median), 0.99))
    if beside > GRID_TOLERANCE * median:
        yield (
            f"samples jitter by {readable(beside, 's')} (99 % of the distances) at {readable(median, 's')}: lags "
            "shorter than that are not known"
        )


def _decimated(values, factor):
    taps = scipy.signal.firwin(20 * factor + 1, 0.8 / factor, window=("kaiser", 8.0))
    half = 10 * factor
    # mirrored about the ends, so that a level or a slope there stays what it is
    head, tail = 2 * values[0] - values[half:0:-1], 2 * values[-1] - values[-2 : -half - 2 : -1]
    if len(head) < half or len(tail) < half:
        raise DataError("resample", f"{len(values)} samples are too few to be made {factor} times coarser")
    return np.convolve(np.concatenate([head, values, tail]), taps, mode="valid")[::factor]
