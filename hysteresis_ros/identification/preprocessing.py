# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Preprocessing of data for fits, in the order of the steps.

1. :func:`prepared`, once for each recording: time stamps that jitter around a uniform grid are corrected
   (:func:`steadied`). Gaps are bridged or avoided (:func:`uninterrupted`), or the samples are interpolated
   (:func:`resample`). Missing samples at the ends are omitted, and the data is checked. For long data, :func:`reduced`
   selects the interval with most of the different loops, and averages neighbouring samples as far as this removes only
   noise.
2. Voltage history before the recording: samples are omitted until the voltage has been near both ends of its range
   (:func:`wiped_out`), or the earlier voltage that caused a remanent displacement is identified
   (:func:`remanent_voltage`).
3. :func:`condense`, for each fit of plays: blocks of samples are averaged, as large as the loops allow. Models with a
   law for each branch use :func:`split_branches` instead.
4. :func:`repeated`, around each fit: outliers and drift are found in the residual of the fit, and the fit is repeated
   without them. Fits of plays omit outliers and have a column for the drift. Other models need complete branches, so
   outliers and drift are removed from the recording (:func:`cleaned`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import (
    GRID_TOLERANCE,
    DataError,
    DataReport,
    IdentificationData,
    check_behaviour,
    check_samples,
    checked_signals,
    clipped_samples,
)
from hysteresis_ros.identification.drift import drift_of, drift_threshold
from hysteresis_ros.identification.thresholds import (
    MOST_OUTLIERS,
    OUTLIERS_MATTER,
    OUTLYING,
)
from hysteresis_ros.models.play_operators import plays
from hysteresis_ros.recordings.loops import REVERSAL, turning_points
from hysteresis_ros.units import readable


def prepared(
    data: IdentificationData, grid: float | str | None = None, all_samples: bool = False, whole: bool = False
) -> tuple[IdentificationData, DataReport]:
    """Return checked data on a uniform grid, reduced to the informative samples if it is long, and a report.

    ``grid`` is a sample time [s] or ``auto``; by default gaps are bridged or avoided. With ``whole``, no interval is
    omitted.
    """
    data = steadied(data)
    data = uninterrupted(data) if grid is None else resample(data, None if isinstance(grid, str) else grid)
    data = data.trimmed()
    if all_samples or len(data) <= MOST_SAMPLES:
        return data.checked()
    units = data.input_unit, data.output_unit
    report = check_samples(data.time, data.input, data.output, units)
    report.raise_errors()
    data = reduced(data, whole)
    return data, check_behaviour(report, data.time, data.input, data.output, units).warned(data.warnings)


#: Uniform times are assumed if they reduce the roughness of the signals to less than this fraction of the roughness
#: with the recorded stamps.
SMOOTHER = 0.7
#: Intervals longer than this multiple of the median interval are gaps.
GAP_DISTANCE = 1.5
#: Largest number of missing samples in a gap that is bridged automatically.
SHORT_GAP = 3
#: With longer gaps, the longest part without a gap is used if it contains at least this fraction of the samples.
LONG_ENOUGH = 0.3


def steadied(data: IdentificationData) -> IdentificationData:
    """Return the data on a uniform grid if the signals show that only the time stamps jitter.

    A computer often stamps a sample late although the converter took it at the right time. A cubic through the two
    samples before and the two samples after each sample predicts this sample, once with the recorded stamps and once
    with equal intervals. The prediction with the right times is better.
    """
    if len(data) < 20:
        return data
    distances = np.diff(data.time)
    median = float(np.median(distances))
    index = np.arange(len(data)) - 0.5 * (len(data) - 1)
    # a line fitted to all stamps, because the first and last stamps jitter too
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
        f"stamps jitter by up to {readable(beside, 's')} around a grid of {readable(grid[1] - grid[0], 's')}, but the "
        f"signals do not (with equal intervals they are {smoother:.2g} times smoother): assumed to be uniform"
    )
    return replace(data, time=grid, warnings=(*data.warnings, warning))


def uninterrupted(data: IdentificationData) -> IdentificationData:
    """Return data on a uniform grid without gaps: bridge short gaps, or use the longest part without a gap.

    The input during a longer gap is unknown, and so is the memory of a hysteresis after the gap. Samples without input
    or output are gaps too. If no part is long enough, or the samples jitter, the data is returned unchanged.
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
        f"{data.time[finite][longest]:.6g} s: using the longest part without a gap, samples "
        f"{data.first + first} to {data.first + last - 1} ({100.0 * part:.0f} %); choose another part with "
        "--range, or all with --resample auto, which interpolates linearly"
    )
    return replace(data.part(first, last), warnings=(*data.warnings, warning))


def _roughness(time, values) -> float:
    """Return the RMS error of the prediction of each sample from four neighbours, as a fraction of the range."""
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
    """Return the data on a uniform grid: interpolated linearly, and low-passed if the grid is coarser.

    Units: ``sample_time`` [s].
    """
    finite = np.isfinite(data.input) & np.isfinite(data.output)
    if np.count_nonzero(finite) < 2:
        raise DataError("short", f"{np.count_nonzero(finite)} finite samples; resampling needs at least two")
    time = data.time[finite]
    distances = np.diff(time)
    median = float(np.median(distances))
    if np.ptp(distances) > GRID_TOLERANCE * median:
        # jitter changes the median of the intervals, but not the mean
        median = float(np.mean(distances[~_gaps(distances, median)]))
    target = median if sample_time is None else float(sample_time)
    if not 0.0 < target < time[-1] - time[0]:
        raise DataError("resample", f"sample time {target:g} s: must be in 0 … {time[-1] - time[0]:g} s")
    factor = max(1, math.ceil(target / median - 1e-6)) if target > 1.5 * median else 1
    grid = time[0] + np.arange(int((time[-1] - time[0]) / (target / factor) + 1e-6) + 1) * (target / factor)
    columns = [np.interp(grid, time, values[finite]) for values in (data.input, data.output)]
    if factor > 1:
        columns = [_decimated(values, factor) for values in columns]
    before, after = readable(median, "s"), readable(target, "s")
    same = f"resampled at equal intervals of {after}"
    note = same if before == after else f"resampled from {before} to {after}"
    grid = grid[::factor]
    rows = data.first + np.flatnonzero(finite)
    warnings = (*data.warnings, *_bridged(time, median, rows), *_jittering(time, median))
    notes = (*data.notes, note)
    return replace(data, time=grid, input=columns[0], output=columns[1], first=0, notes=notes, warnings=warnings)


def _gaps(distances, median):
    """Return which intervals are gaps; jitter of up to three standard deviations is not a gap."""
    jitter = 1.5 * float(np.median(np.abs(distances - median)))
    return distances > max(GAP_DISTANCE * median, median + 3.0 * jitter)


def _bridged(time, median, rows):
    """Yield a warning about the interpolated gaps."""
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
        f"{np.count_nonzero(gaps)} gaps ({lost} samples) interpolated linearly, the longest "
        f"{distances[longest]:.4g} s at {time[longest]:.6g} s; the signals in the gaps are unknown (longest part "
        f"without a gap: --range {first}:{last})"
    )


def _jittering(time, median):
    """Yield a warning about jitter of the intervals that are not gaps."""
    distances = np.diff(time)
    whole = np.maximum(np.rint(distances / median), 1.0)
    beside = float(np.quantile(np.abs(distances - whole * median), 0.99))
    if beside > GRID_TOLERANCE * median:
        yield (
            f"samples jitter by {readable(beside, 's')} (99 % of the intervals) at {readable(median, 's')}: lags "
            "shorter than this jitter cannot be identified"
        )


def _decimated(values, factor):
    taps = scipy.signal.firwin(20 * factor + 1, 0.8 / factor, window=("kaiser", 8.0))
    half = 10 * factor
    # mirrored about the ends, so that level and slope are continuous
    head, tail = 2 * values[0] - values[half:0:-1], 2 * values[-1] - values[-2 : -half - 2 : -1]
    if len(head) < half or len(tail) < half:
        raise DataError("resample", f"{len(values)} samples are too few for a grid that is {factor} times coarser")
    return np.convolve(np.concatenate([head, values, tail]), taps, mode="valid")[::factor]


#: Recordings with more samples than this are reduced to at most this number (for sweeps, a multiple of it) …
MOST_SAMPLES = 100_000
#: … and to at least this number.
FEWEST_REDUCED = 6000
#: Limits of the length of an interval: number of full strokes (both directions count) and number of samples. They are
#: tried in order until an interval contains at least the fraction AS_GOOD of the information of the whole recording.
#: The first suffices for a simple fit, the second for many different loops, the third for sweeps, whose parts all
#: differ.
STRETCHES = ((40.0, MOST_SAMPLES), (100.0, MOST_SAMPLES), (math.inf, 4 * MOST_SAMPLES))
#: An interval with at least this fraction of the information of the best one (or of the whole recording) is as good.
AS_GOOD = 0.9
#: Number of start samples that are tried for the interval.
TRIED = 20
#: Number of levels of the voltage by which turning points are distinguished.
LEVELS = 20
#: Largest RMS content that averaging may remove, as a fraction of the signal's standard deviation, …
LOST = 3e-4
#: … and smallest ratio of the new sample rate to the highest frequency that is kept.
OVERSAMPLING = 8.0
#: Number of samples in the search for turning points (OVERVIEW) and in a segment of the spectrum (SEGMENT); smallest
#: and largest number of segments.
OVERVIEW = 500_000
SEGMENT = 1 << 14
SEGMENTS = 24
MOST_SEGMENTS = 256
#: Power above this multiple of the noise floor counts as signal.
ABOVE_FLOOR = 3.0


def reduced(data: IdentificationData, whole: bool = False) -> IdentificationData:
    """Return an informative interval of long data, with neighbouring samples averaged; return short data unchanged.

    The time of a returned sample is the mean time of the samples averaged into it; their number is
    :attr:`IdentificationData.factor`.
    """
    if len(data) <= MOST_SAMPLES:
        return data
    size, rate = len(data), 1.0 / data.sample_time
    highest = max(highest_frequency(values, data.sample_time) for values in (data.input, data.output))
    allowed = max(1, int(rate / (OVERSAMPLING * highest))) if highest > 0.0 else size
    first, last, strokes = (0, size, 0.0) if whole else _telling_stretch(data.input, allowed)
    factor = min(allowed, max(1, (last - first) // FEWEST_REDUCED))
    count = (last - first) // factor
    last = first + count * factor
    if (count, factor) == (size, 1):
        return data
    columns = [block_means(values[first:last], factor) for values in (data.time, data.input, data.output)]
    words = [f"{size} samples condensed to {count}"]
    if last - first < size - factor:
        begin, end = data.time[first] - data.time[0], data.time[last - 1] - data.time[0]
        words.append(f"{begin:.4g} to {end:.4g} s show the loops ({strokes:.0f} full strokes in total)")
    if factor > 1:
        held = f"only noise above {readable(highest, 'Hz')}" if highest > 0.0 else "faster movement is only noise"
        words.append(f"averaged over {factor}, {rate:.4g} Hz to {rate / factor:.4g} Hz ({held})")
    note = f"{'; '.join(words)}; --all-samples uses every one"
    time, voltage, output = columns
    first, notes = data.first + first, (*data.notes, note)
    return replace(data, time=time, input=voltage, output=output, first=first, factor=factor, notes=notes)


def block_means(values: np.ndarray, factor: int) -> np.ndarray:
    """Return the means of consecutive blocks of ``factor`` values, shape (N // factor,)."""
    count = values.size // factor
    return values[: count * factor].reshape(count, factor).mean(axis=1)


def _telling_stretch(voltage, averaged: int):
    """Return beginning and end of the most informative interval, and the number of full strokes in all data."""
    block = math.ceil(voltage.size / OVERVIEW)
    coarse = block_means(voltage, block)
    turns = turning_points(coarse)
    span = np.ptp(coarse)
    strokes = np.append(0.0, np.cumsum(np.abs(np.diff(coarse[turns])))) / span
    levels = np.rint((coarse[turns] - coarse.min()) / span * LEVELS).astype(int)
    speeds = np.rint(2.0 * np.log2(np.maximum(np.diff(turns), 1))).astype(int)
    everything = _shown(levels, speeds)
    start, end = 0, len(turns) - 1
    for most, samples in STRETCHES:
        longest = samples * averaged
        if strokes[-1] <= most and voltage.size <= longest:
            return 0, voltage.size, strokes[-1]
        latest = max(
            int(np.searchsorted(strokes, max(strokes[-1] - most, 0.0))),
            int(np.searchsorted(turns, max(coarse.size - longest // block, 0))),
        )
        found = []
        for first in np.unique(np.linspace(0, latest, TRIED).astype(int)):
            last = (
                min(
                    int(np.searchsorted(strokes, strokes[first] + most, side="right")),
                    int(np.searchsorted(turns, turns[first] + longest // block, side="right")),
                )
                - 1
            )
            found.append((_shown(levels[first : last + 1], speeds[first:last]), first, last))
        best = max(found)[0]
        # the earliest of equally good intervals, because it is nearest to rest and shows the beginning of creep
        shown, start, end = next(item for item in found if item[0] >= AS_GOOD * best)
        if shown >= AS_GOOD * everything:
            break
    begin = int(turns[start]) * block if start else 0
    # a hold between two turning points may be longer than the requested interval
    return begin, min((int(turns[end]) + 1) * block if end > start else voltage.size, begin + longest), strokes[-1]


def _shown(levels, speeds) -> float:
    """Return the information in turning points: number of different loops (size and speed), weighted by the range."""
    loops = {*zip(levels[:-1].tolist(), levels[1:].tolist(), speeds.tolist(), strict=True)}
    reach = np.ptp(levels) / LEVELS if levels.size else 0.0
    return reach**4 * len(loops)


def highest_frequency(values, sample_time: float) -> float:
    """Return the frequency [Hz] above which there is only noise; 0 if there is only noise."""
    size = min(SEGMENT, values.size // SEGMENTS)
    # segments are spread over the recording; more segments would not change the result
    starts = np.linspace(0, values.size - size, min(MOST_SEGMENTS, values.size // size)).astype(int)
    values = np.concatenate([values[start : start + size] for start in starts])
    frequencies, power = scipy.signal.welch(values, 1.0 / sample_time, nperseg=size, noverlap=0, detrend="linear")
    floor = float(np.quantile(power, 0.1))
    signal = np.where(power > ABOVE_FLOOR * floor, power, 0.0)
    above = np.cumsum(signal[::-1])[::-1] * frequencies[1]
    there = np.flatnonzero(above > LOST**2 * np.var(values))
    return float(frequencies[there[-1]]) if there.size else 0.0


#: Length [samples] of the interval whose median is subtracted from each sample, so that samples are not outliers if
#: most of the interval deviates.
STRETCH = 11
#: The error of an outlier differs from the median of its neighbours by at least this fraction of the error.
AWAY = 0.5
#: Largest number of fits of a model that has no terms for drift and outliers.
ROUNDS = 3


class Cleaned(NamedTuple):
    """A recording without drift and outliers."""

    data: IdentificationData
    drift: float  #: Removed drift [m/s].
    outliers: int  #: Number of samples replaced by their prediction.

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences about drift and outliers, which are not part of the model."""
        return cleaning_notes(self.drift, self.outliers)

    @property
    def numbers(self) -> dict[str, float]:
        """The figures (drift, outliers) that are not zero."""
        drift = {"drift_m_per_s": self.drift} if self.drift else {}
        return drift | ({"outliers": float(self.outliers)} if self.outliers else {})


def cleaning_notes(drift: float, outliers: int) -> tuple[str, ...]:
    """Return sentences about drift and outliers, which are not part of the model.

    Units: ``drift`` [m/s].
    """
    found = []
    if drift:
        found.append(
            f"the output drifts by {readable(drift, 'm')}/s in addition to creep: fitted, but not part of the model"
        )
    if outliers:
        found.append(f"{outliers} outliers omitted from the fit")
    return tuple(found)


def inliers(error, first: int) -> np.ndarray:
    """Return which samples are not outliers, shape (N,) of bool; samples before ``first`` are never outliers.

    Outliers are single samples and short intervals that differ from their neighbours; longer deviations come from the
    structure of the model.
    """
    alone = error - scipy.ndimage.median_filter(error, STRETCH, mode="nearest")
    good = _within(error, first) | _within(alone, first)
    # the peak of a smooth error is not an outlier, even if it exceeds its neighbours by more than the noise
    good |= np.abs(alone) < AWAY * np.abs(error - np.median(error[first:]))
    # ringing too fast for a median filter is not an outlier: it affects many samples close together
    width = 2 * STRETCH + 1
    near = scipy.ndimage.uniform_filter1d((~good).astype(float), width, mode="constant") * width
    return good | (near > STRETCH // 2 + 0.5)


def _within(error, first: int) -> np.ndarray:
    size = np.abs(error - np.median(error[first:]))
    good = size <= OUTLYING * 1.4826 * float(np.median(size[first:]))
    good[:first] = True
    return good


def notable_outliers(error, first: int, known=None) -> np.ndarray | None:
    """Return which samples are not outliers, shape (N,) of bool; None if outliers are too many or hardly matter.

    New outliers matter if they cause at least the fraction OUTLIERS_MATTER of the squared error of the samples used so
    far (``known``).
    """
    good = inliers(error, first)
    used = np.ones(len(error), dtype=bool) if known is None else known.copy()
    added = used & ~good
    used[:first] = False
    if np.count_nonzero(~good) > MOST_OUTLIERS * (len(error) - first):
        return None
    square = (error - np.median(error[first:])) ** 2
    share = float(np.sum(square[added])) / max(float(np.sum(square[used])), 1e-300)
    return good if share >= OUTLIERS_MATTER else None


def repeated(fit, look, state):
    """Repeat ``fit(state, before)`` until ``look`` finds nothing new; return the last state of the data and the result.

    ``look(result, state)`` returns the data without the outliers and the drift that the result shows; None: no change.
    """
    result = fit(state, None)
    for _ in range(ROUNDS):
        better = look(result, state)
        if better is None:
            break
        state, result = better, fit(better, result)
    return state, result


def cleaned(data: IdentificationData, predicted, first: int = 0, drift: float | None = None) -> Cleaned:
    """Return a recording without the outliers and the drift that a prediction shows.

    Units: ``predicted`` [m], ``drift`` [m/s].
    """
    clipped = clipped_samples(data.output, data.input)
    if clipped.any():  # predicted values replace clipped samples
        data = replace(
            data, output=np.where(clipped, predicted + np.median((data.output - predicted)[~clipped]), data.output)
        )
    error = data.output - predicted
    places = np.arange(len(data))
    if drift is None:
        kept = np.flatnonzero(inliers(error, first)[first:]) + first
        drift = drift_of(error, kept, drift_threshold(data.input[first:])) / data.sample_time
    slope = drift * data.sample_time * places
    error = error - slope
    good = notable_outliers(error, first)
    if good is None:
        return Cleaned(replace(data, output=data.output - slope) if drift else data, drift, 0)
    error = np.interp(places, places[good], error[good])
    return Cleaned(replace(data, output=predicted + error), drift, int(np.count_nonzero(~good)))


#: When blocks of samples are averaged: largest step of the voltage from block to block, as a fraction of its range, …
LARGEST_STEP = 0.02
#: … and number of samples that must remain.
ENOUGH_SAMPLES = 6000
#: The memory of earlier inputs counts as erased after the distance of the input from each end of its range has been at
#: most this fraction of the range; the fit starts there.
WIPED_OUT = 0.05

#: All loops count as equal in size if each swing exceeds this fraction of the range.
ONE_SIZE = 0.8
#: Fraction of the range by which the input must rise and fall after the memory is erased.
LEAST_SWING = 0.5


@dataclass(frozen=True, eq=False)
class Condensed:
    """Data prepared for a fit: uniform block averages, as coarse as the loops allow."""

    voltage: np.ndarray  #: voltage, displacement: shape (N,) [V], [m].
    displacement: np.ndarray
    sample_time: float  #: [s]
    first: int  #: First sample whose residual counts.
    factor: int  #: Number of samples of the recording in each average.
    kept: np.ndarray  #: shape (N - first,); True for the samples from ``first`` on that are not outliers.
    #: First counted sample that is independent of the voltage before the recording; None if all samples depend on it.
    erased: int | None = 0
    drifts: bool = False  #: Whether the displacement may contain a linear drift in addition to a constant.
    #: Voltages [V] from rest at 0 V to the first sample; they determine the memory of the hysteresis.
    history: tuple[float, ...] = ()

    def counted(self, values) -> np.ndarray:
        """Return the rows of ``values``, shape (N, ...), that count: those from ``first`` on, without outliers."""
        counted = values[self.first :]
        return counted if self._all_kept else counted[self.kept]

    @functools.cached_property
    def _all_kept(self) -> bool:
        return bool(self.kept.all())

    @functools.cached_property
    def constants(self) -> np.ndarray:
        """Columns independent of the voltage, shape (N, 1 or 2): a constant, and a drift that is 1 at the end."""
        places = np.arange(len(self.voltage)) / len(self.voltage)
        return np.column_stack([np.ones(len(places)), places] if self.drifts else [np.ones(len(places))])

    @property
    def skipped(self) -> int:
        """Number of samples at the beginning of the recording that do not count."""
        return self.first * self.factor

    @property
    def remembers(self) -> bool:
        """Whether the voltage history before the recording affects counted samples."""
        return self.erased is None or self.erased > self.first

    @property
    def reach(self) -> float:
        """Radius [V] from which on no play moves: half the range or, after a start from rest, the largest voltage."""
        half = 0.5 * self.voltage_range
        return max(half, float(np.max(np.abs([*self.voltage, *self.history])))) if self.remembers else half

    def plays(self, play_radii) -> np.ndarray:
        """Return the outputs, shape (N, m), of plays that have passed through the history before the first sample."""
        before = plays(np.array([0.0, *self.history]), play_radii)[-1]
        return plays(self.voltage, play_radii, before)

    @functools.cached_property
    def voltage_range(self) -> float:
        """Peak-to-peak voltage [V]."""
        return float(np.ptp(self.voltage))

    @functools.cached_property
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
    """Average blocks of samples, so that the fit of a long recording takes seconds.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """
    v, y = checked_signals(voltage, displacement, fewest=50)
    if len(turning_points(v)) < 3:
        raise IdentificationError("the voltage never reverses: a loop model needs a rising and a falling branch")
    wiped = wiped_out(v)
    first = wiped or 0 if skip is None else skip
    if not 0 <= first < v.size - 50:
        raise IdentificationError(f"skip = {skip}: must leave at least 50 of the {v.size} samples")
    # a quantile, because the largest steps may be jumps at the start, which no sample rate resolves
    step = float(np.quantile(np.abs(np.diff(v)), 0.98)) / float(np.ptp(v))
    coarsest = max(1, int(LARGEST_STEP / step)) if step > 0.0 else 1
    factor = max(1, min(coarsest, v.size // enough))
    blocks = v.size // factor
    used = np.ones(v.size) if kept is None else np.asarray(kept, dtype=float)
    v, used, y = (
        values[: blocks * factor].reshape(blocks, factor).sum(axis=1) for values in (v / factor, used, used * y)
    )
    erased = None if wiped is None else math.ceil(max(first, wiped) / factor)
    first = math.ceil(first / factor)
    y = y / np.maximum(used, 1.0)
    return Condensed(v, y, factor * sample_time, first, factor, used[first:] > 0.0, erased, history=history)


def coarser(data: Condensed, enough: int) -> Condensed:
    """Return condensed data averaged further to about ``enough`` samples, if the steps of the voltage allow it."""
    step = float(np.quantile(np.abs(np.diff(data.voltage)), 0.98)) / data.voltage_range
    factor = min(len(data.voltage) // enough, int(LARGEST_STEP / step) if step > 0.0 else len(data.voltage))
    if factor < 2:
        return data
    count = len(data.voltage) // factor
    kept = np.append(np.ones(data.first, dtype=bool), data.kept)[: count * factor].reshape(count, factor)
    first = math.ceil(data.first / factor)
    return replace(
        data,
        voltage=block_means(data.voltage, factor),
        displacement=block_means(data.displacement, factor),
        sample_time=factor * data.sample_time,
        first=first,
        erased=None if data.erased is None else math.ceil(data.erased / factor),
        factor=factor * data.factor,
        kept=np.asarray(kept.all(axis=1))[first:],
    )


def wiped_out(voltage) -> int | None:
    """Return the sample from which earlier voltages no longer matter, if a cycle follows it; otherwise None.

    A voltage that has been at both ends of its range has moved every play that moves during the recording. After that,
    the voltage must rise and fall by at least half of the range, because otherwise only one branch is visible.

    Units: ``voltage`` [V].
    """
    span = np.ptp(voltage)
    top = np.flatnonzero(voltage >= voltage.max() - WIPED_OUT * span)[0]
    bottom = np.flatnonzero(voltage <= voltage.min() + WIPED_OUT * span)[0]
    first = int(max(top, bottom))
    swings = np.diff(voltage[first:][turning_points(voltage[first:])])
    large = swings[np.abs(swings) >= LEAST_SWING * span]
    return first if np.any(large > 0.0) and np.any(large < 0.0) else None


def automatic_skip(data: IdentificationData) -> int:
    """Return the number of samples until the voltage has been near both ends of its range, which erases the memory."""
    return condense(data.input, data.output, data.sample_time).skipped


#: Tried values of the voltage before the recording, as fractions of the largest recorded voltage.
PASTS = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)


def remanent_voltage(cost, largest: float, bipolar: bool) -> tuple[float, float]:
    """Return the voltage before the recording that minimises ``cost`` [V], and the cost at this voltage.

    Units: ``largest`` [V].
    """
    parts = [part for part in PASTS if bipolar or part > 0.0]
    costs = [cost(part * largest) for part in parts]
    place = int(np.argmin(costs))
    ends = parts[max(place - 1, 0)], parts[min(place + 1, len(parts) - 1)]
    fine = scipy.optimize.minimize_scalar(
        lambda part: cost(part * largest), bounds=ends, method="bounded", options={"maxiter": 10}
    )
    least, part = min((costs[place], parts[place]), (float(fine.fun), float(fine.x)))
    return part * largest, least


def simple_loops(data: Condensed) -> bool:
    """Return whether all loops that count have the same size, so that the recording shows no minor loops."""
    if data.erased is None:
        return False
    voltage = data.voltage[data.erased :]
    swings = np.abs(np.diff(voltage[turning_points(voltage)]))[1:-1]  # the first and last loop may be incomplete
    return bool(np.all(swings > ONE_SIZE * data.voltage_range))


#: Least number of samples of one branch that is fitted.
FEWEST_BRANCH_SAMPLES = 5


@dataclass(frozen=True)
class Branch:
    """Part of a recording in which the input moves in one direction."""

    start: int  #: start, stop: Indices of the two turning points; both belong to the branch.
    stop: int
    low: float  #: low, high: Smallest and largest input of the branch.
    high: float
    rising: bool  #: Whether the input rises.

    @property
    def samples(self) -> slice:
        """All samples of the branch, including both turning points."""
        return slice(self.start, self.stop + 1)

    def __len__(self) -> int:
        return self.stop - self.start + 1


def split_branches(input_, reversal: float = REVERSAL) -> tuple[Branch, ...]:
    """Return the branches of ``input_``, shape (N,), in order; reversals below ``reversal`` of its range are noise."""
    points = turning_points(input_, reversal)
    branches = []
    for start, stop in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
        a, b = float(input_[start]), float(input_[stop])
        if a != b:
            branches.append(Branch(start, stop, min(a, b), max(a, b), b > a))
    return tuple(branches)


def require_both_directions(branches, model: str) -> None:
    """Raise IdentificationError unless there are both rising and falling branches, as a loop needs."""
    rising = sum(branch.rising for branch in branches)
    if rising == 0 or rising == len(branches):
        found = f"only {len(branches)} {'rising' if rising else 'falling'} branch(es)" if branches else "no branch"
        raise IdentificationError(
            f"the recording has {found}; a {model} needs rising and falling branches: record at least one whole loop"
        )
