# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Charts of an error: its spectrum, its histogram, the last periods in nanometres, and trace against retrace."""

from __future__ import annotations

import numpy as np
from scipy import signal

from hysteresis_ros.analysis.charts import Chart, Line
from hysteresis_ros.analysis.excerpt import period_ends
from hysteresis_ros.analysis.run_charts import Judged
from hysteresis_ros.analysis.steps import REVERSAL
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import BRANCH_LEVELS, turning_points

#: Segments into which a spectrum divides a run at least, and samples of a segment at most.
SEGMENTS, LONGEST = 4, 2**16
#: Fewer samples have no spectrum.
LEAST = 64
#: Points of a spectrum: above as many lines the largest of each interval is drawn.
SPECTRUM_POINTS = 1500
#: Bars of a histogram.
BARS = 60
#: Periods laid on top of each other.
PERIODS = 3

_NANO, _MICRO = 1e9, 1e6


def amplitude_spectrum(time, values, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitude spectral density of a signal by Welch's method (Hann windows that overlap by half).

    The mean of each segment is left out; the density is one-sided: its square summed over all lines times their
    distance is the variance. Missing samples are replaced by a straight line between their neighbours.

    Parameters
    ----------
    time : array, shape (N,)
        [s]
    values : array, shape (N,)
        Finite [m].
    sample_time : float
        [s]

    Returns
    -------
    frequency : array, shape (F,)
        [Hz], above 0.
    density : array, shape (F,)
        [m/√Hz]
    """
    grid = np.arange(round((time[-1] - time[0]) / sample_time) + 1) * sample_time + time[0]
    even = values if grid.size == values.size else np.interp(grid, time, values)
    segment = int(min(LONGEST, max(LEAST, even.size // SEGMENTS), even.size))
    frequency, power = signal.welch(even, 1.0 / sample_time, "hann", segment, detrend="constant")
    return frequency[1:], np.sqrt(power[1:])


def spectrum_chart(run: Judged) -> Chart | None:
    """Return the chart of the spectrum of the error [nm/√Hz, Hz]; None without an error, or with too few samples.

    Parameters
    ----------
    run : Judged
    """
    if run.error is None or np.count_nonzero(run.counted) < LEAST:
        return None
    error = run.error[run.counted]
    frequency, density = amplitude_spectrum(run.recording.time[run.counted], error, run.recording.sample_time)
    if not np.any(density > 0.0):
        return None
    below = np.cumsum(density**2)
    half = float(frequency[np.searchsorted(below, 0.5 * below[-1])])
    peak = float(frequency[np.argmax(density)])
    edges = np.unique(np.rint(np.geomspace(1, frequency.size, SPECTRUM_POINTS)).astype(np.int64)) - 1
    x, y = frequency[edges], np.maximum.reduceat(density, edges) * _NANO
    positive = y > 0.0
    return Chart(
        "spectrum",
        "Spectrum of the error",
        "frequency [Hz]",
        "amplitude density [nm/√Hz]",
        [Line("error", "displacement", x[positive], y[positive], 1.0)],
        "graph",
        "xy",
        note=f"Largest at {peak:.4g} Hz; half of the variance lies below {half:.4g} Hz. Lines are "
        f"{frequency[0]:.3g} Hz apart (Welch, Hann windows, without the mean).",
    )


def histogram_chart(run: Judged) -> Chart | None:
    """Return the chart of the histogram of the error beside a normal distribution [%, nm or µm].

    Parameters
    ----------
    run : Judged
    """
    if run.error is None or not np.any(run.counted):
        return None
    unit, factor = run.unit
    error = run.error[run.counted] * factor
    mean, deviation = float(np.mean(error)), float(np.std(error))
    low, high = float(np.min(error)), float(np.max(error))
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    counts, edges = np.histogram(error, BARS, (low, high))
    middles, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    normal = width * np.exp(-0.5 * ((middles - mean) / deviation) ** 2) / (deviation * np.sqrt(2.0 * np.pi))
    close = [float(np.percentile(np.abs(error), part)) for part in (95.0, 99.0)]
    lines = [
        Line("samples", "displacement", edges, np.append(100.0 * counts / error.size, 0.0)),
        Line("normal distribution", "limit", edges, np.append(100.0 * normal, 0.0), 1.0, (4.0, 3.0)),
    ]
    return Chart(
        "histogram",
        "Histogram of the error",
        f"error [{unit}]",
        "samples [%]",
        lines,
        "steps",
        note=f"Mean {mean:.4g} {unit}, σ {deviation:.4g} {unit}; 95 % of the samples are within ±{close[0]:.4g} {unit}"
        f", 99 % within ±{close[1]:.4g} {unit}.",
    )


def last_periods_chart(run: Judged) -> Chart | None:
    """Return the chart of the error in the last periods on top of each other [nm]; None where nothing repeats.

    Parameters
    ----------
    run : Judged
    """
    if run.error is None:
        return None
    time = run.recording.time - run.recording.time[0]
    ends = period_ends(run.recording)
    period = float(ends[0] - ends[1]) if ends.size > 1 else 0.0
    unit, factor = ("ms", 1e3) if period < 0.5 else ("s", 1.0)
    names = ("last", "the one before", "the one before that")
    colours = ("displacement", "reference", "setpoint")
    lines = []
    for number in range(min(PERIODS, ends.size - 1)):
        inside = np.flatnonzero((time >= ends[number + 1]) & (time < ends[number] - 0.5 * run.recording.sample_time))
        inside = inside[inside >= run.start]
        if inside.size:
            x = (time[inside] - ends[number + 1]) * factor
            lines.append(
                Line(names[number], colours[number], x, run.error[inside] * _NANO, 1.4 if number == 0 else 1.0)
            )
    if not lines:
        return None
    caption = "Error in the last periods, one on top of the other"
    across, note = f"time in the period [{unit}]", f"A period lasts {period * factor:.6g} {unit}."
    return Chart("periods", caption, across, "error [nm]", lines[::-1], "graph", levels=(0.0,), note=note)


def last_branches(recording: Recording, reference) -> tuple[slice, slice] | None:
    """Return the samples of the last two branches of a reference; None when it does not go to and fro.

    Parameters
    ----------
    recording : Recording
    reference : array, shape (N,)
        [m]; NaN where it is missing.
    """
    finite = np.flatnonzero(np.isfinite(reference))
    points = finite[turning_points(reference[finite], REVERSAL)] if finite.size else finite
    inner = points[1:-1] if points.size >= 5 else points
    if inner.size < 3:
        return None
    first, middle, last = (int(k) for k in inner[-3:])
    found = slice(first, middle + 1), slice(middle, last + 1)
    levels = [np.unique(reference[part][np.isfinite(reference[part])]).size for part in found]
    return found if min(levels) >= BRANCH_LEVELS else None


def trace_retrace_chart(run: Judged) -> Chart | None:
    """Return the chart of the error of trace and retrace over the reference [nm, µm]; None where there are none.

    Parameters
    ----------
    run : Judged
    """
    branches = None if run.error is None else last_branches(run.recording, run.reference)
    if branches is None:
        return None
    found = {}
    for part in branches:
        reference, error = run.reference[part], run.error[part]
        good = np.isfinite(error)
        if np.count_nonzero(good) < BRANCH_LEVELS:
            return None
        rises = reference[good][-1] > reference[good][0]
        order = np.argsort(reference[good], kind="stable")
        found["trace" if rises else "retrace"] = reference[good][order], error[good][order]
    if len(found) < 2:
        return None
    (x, trace), (x_back, retrace) = found["trace"], found["retrace"]
    inside = (x >= x_back[0]) & (x <= x_back[-1])
    apart = np.interp(x[inside], x_back, retrace) - trace[inside]
    lines = [
        Line("trace (rising)", "reference", x * _MICRO, trace * _NANO),
        Line("retrace (falling)", "displacement", x_back * _MICRO, retrace * _NANO),
    ]
    said = ""
    if apart.size:
        largest, typical = float(np.max(np.abs(apart))) * _NANO, float(np.sqrt(np.mean(apart**2))) * _NANO
        said = f"At the same reference the two are apart by {typical:.4g} nm rms and {largest:.4g} nm at most."
    caption = "Trace against retrace: error over the reference, last way there and back"
    return Chart("trace", caption, "reference [µm]", "error [nm]", lines, "graph", levels=(0.0,), note=said)
