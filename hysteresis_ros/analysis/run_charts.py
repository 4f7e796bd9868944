# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Charts of a run: displacement, error with spectrum and histogram, loops, voltage, adaptation, learning, lateness.

Lengths are drawn in micrometres or nanometres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from hysteresis_ros.analysis.metrics import (
    AxisSettings,
    Tracked,
    actual_name,
    axis_settings,
    judged_reference,
    judged_start,
)
from hysteresis_ros.analysis.parts import REVERSAL, disturbed, period_ends, stopped
from hysteresis_ros.analysis.plots import Chart, Line, length_unit
from hysteresis_ros.models.adaptation import ADAPTING
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import BRANCH_LEVELS, loop_opening, turning_points
from hysteresis_ros.recordings.provenance import configured
from hysteresis_ros.recordings.triggers import triggers_of

#: Approximate maximum number of spans marked in a chart.
MOST_MARKS = 500
#: Minimum number of whole periods for the chart of learning.
LEAST_PERIODS = 3


def period_errors(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return the end of each period of the learning [s], and its RMS error against the undelayed reference [m].

    Both are empty without learning, or if the recording has fewer than three whole periods. If the true displacement is
    unknown, the measured one is used.
    """
    given = configured(recording.configuration, "motion_controller", recording.metadata.get("namespace") or "")
    nothing = np.zeros(0), np.zeros(0)
    if given.get("learning.type", "none") == "none" or not recording.has("reference") or len(recording) < 2:
        return nothing
    samples = round(given.get("learning.period", 0.0) / recording.sample_time)
    count = len(recording) // samples if samples else 0
    if count < LEAST_PERIODS:
        return nothing
    displacement = recording["displacement" if recording.has("displacement") else "measured"]
    error = (recording["reference"] - displacement + given.get("model.preload.offset", 0.0))[: count * samples]
    mean_square = np.nanmean(error.reshape(count, samples) ** 2, axis=1)
    return recording.time[samples - 1 : count * samples : samples], np.sqrt(mean_square)


_MICRO = 1e6


@dataclass(frozen=True)
class Judged:
    """Signals of a run that the charts show."""

    recording: Recording
    settings: AxisSettings
    displacement: np.ndarray  #: shape (N,); True (if unknown, measured) displacement minus the preload offset [m].
    #: reference, error: shape (N,); Reference that is compared with the displacement, and reference - displacement [m];
    #: the error is NaN while the axis is stopped; both are None if the recording has no reference.
    reference: np.ndarray | None
    error: np.ndarray | None
    start: int  #: First sample whose error counts.
    unit: tuple[str, float] = ("µm", _MICRO)  #: Unit of drawn errors, and the factor from metres to it.

    @property
    def disturbed(self) -> np.ndarray:
        """Whether each sample is disturbed by a skipped sample, shape (N,)."""
        if self.error is None or not self.recording.has("skipped"):
            return np.zeros(len(self.recording), dtype=bool)
        error = np.where(self.counted, self.error, np.nan)
        return disturbed(np.nan_to_num(self.recording["skipped"]) > 0.0, error)

    @property
    def counted(self) -> np.ndarray:
        """Whether the error of each sample counts, shape (N,)."""
        if self.error is None:
            return np.zeros(len(self.recording), dtype=bool)
        return np.isfinite(self.error) & (np.arange(len(self.recording)) >= self.start)


def judged(recording: Recording) -> Judged:
    """Return the signals of a run that the charts show."""
    settings = axis_settings(recording)
    displacement = recording[actual_name(recording)] - settings.offset
    if not recording.has("reference"):
        return Judged(recording, settings, displacement, None, None, 0)
    reference = judged_reference(recording)
    error = np.where(stopped(recording), np.nan, reference - displacement)
    good = np.flatnonzero(np.isfinite(error))
    tracked = Tracked(recording.time, reference, displacement).at(good)
    start = int(good[judged_start(recording, tracked)[0]]) if good.size else 0
    run = Judged(recording, settings, displacement, reference, error, start)
    return replace(run, unit=length_unit(largest_error(run)))


def largest_error(run: Judged) -> float:
    """Return the largest magnitude of the errors that count [m]; 0 if no error counts."""
    return 0.0 if run.error is None else float(np.max(np.abs(run.error[run.counted]), initial=0.0))


def _marks(run: Judged) -> dict:
    """Return the fields of a chart that mark the disturbed spans; spans close together are joined."""
    span = run.disturbed
    if not np.any(span):
        return {}
    time = run.recording.time
    starts, ends = np.flatnonzero(np.diff(np.r_[False, span, False].astype(int))).reshape(-1, 2).T
    apart = starts[1:] - ends[:-1] > len(span) // MOST_MARKS
    first, last = time[starts[np.r_[True, apart]]], time[ends[np.r_[apart, True]] - 1]
    count = int(np.sum(np.nan_to_num(run.recording["skipped"]) > 0.0))
    label = f"disturbed by {count} skipped samples ({100.0 * np.mean(span):.2g} % of the run)"
    return {"marked": np.stack([first, last], axis=1), "marked_label": label, "note": f"Orange: {label}."}


def traces_chart(run: Judged) -> Chart:
    """Return the chart of setpoint, reference (delayed by the preview), displacement and estimate over time [µm, s]."""
    recording, preview = run.recording, run.settings.preview
    styles: dict[str, dict] = {
        "setpoint": dict(dash=(4.0, 3.0), width=1.1),
        "estimated": dict(width=2.4),
        "displacement": dict(width=1.2),
        "reference": dict(width=1.4),
    }
    signals = {name: recording[name] for name in ("setpoint", "estimated") if recording.has(name)}
    signals["displacement"] = run.displacement
    if run.reference is not None:
        signals["reference"] = run.reference
    labels = {"reference": f"reference, delayed by {preview} samples" if preview else "reference"}
    lines = [
        Line(labels.get(name, name), name, recording.time, signals[name] * _MICRO, **style)
        for name, style in styles.items()
        if name in signals
    ]
    shown = _marks(run)
    found = triggers_of(recording)
    if found.sample.size:
        places = np.full(len(recording), np.nan)
        places[found.sample] = (found.position - run.settings.offset) * _MICRO
        lines.append(Line(f"triggers ({found.sample.size})", "late", recording.time, places, dots=True))
        lost = f", {found.lost} suppressed because they followed others too fast" if found.lost else ""
        shown["note"] = f"{shown.get('note', '')} {found.sample.size} triggers{lost}.".strip()
    return Chart("traces", "Displacement over time", "time [s]", "displacement [µm]", lines, height=3.6, **shown)


def error_chart(run: Judged) -> Chart | None:
    """Return the chart of reference - displacement over time [µm or nm, s]; None without a reference."""
    if run.error is None or not np.any(run.counted):
        return None
    (unit, factor), time = run.unit, run.recording.time
    line = Line("error", "displacement", time, run.error * factor, 1.0)
    shown: dict = {}
    if run.start:
        # the scale ignores errors that do not count
        largest = 1.5 * factor * largest_error(run)
        shown = dict(shaded=(time[0], time[run.start]), shaded_label="not counted: jump at the beginning of the scan")
        shown["limits"] = (-largest, largest)
    if marks := _marks(run):
        left = run.error[run.counted & ~run.disturbed]
        parts = (("RMS error", run.error[run.counted]), ("without these spans", left))
        figures = ", ".join(
            f"{name} {factor * np.sqrt(np.mean(values**2)):.4g} {unit}" for name, values in parts if values.size
        )
        shown |= marks | {"note": f"{marks['note']} {figures}."}
    caption = "Error (reference − displacement) over time"
    return Chart("error", caption, "time [s]", f"error [{unit}]", [line], levels=(0.0,), **shown)


def loops_chart(run: Judged) -> Chart | None:
    """Return the chart of the loops: displacement versus voltage and, after compensation, versus reference [µm, %].

    None if the reference has no reversals (without a reference: if the voltage has no reversals). A voltage without
    reversals is not drawn.
    """
    recording, voltage = run.recording, run.recording.run_columns()["voltage"]
    inputs = [("before compensation, versus voltage", "voltage", voltage, "V", 1.0)]
    if run.reference is not None:
        inputs.append(("after compensation, versus reference", "reference", run.reference, "µm", _MICRO))
    stroke = np.ptp(_finite(run.displacement if run.reference is None else run.reference))
    lines = []
    for text, colour, values, unit, factor in inputs:
        inside = values if run.error is None else np.where(np.isfinite(run.error), values, np.nan)
        opening = loop_opening(inside, run.displacement) if stroke > 0.0 else None
        if opening is None:
            continue
        low, high = float(np.min(_finite(values))), float(np.max(_finite(values)))
        label = f"{text} ({low * factor:.4g} … {high * factor:.4g} {unit}): {100.0 * opening / stroke:.3g} % of stroke"
        part = 100.0 * (values - low) / (high - low)
        lines.append(Line(label, colour, part, run.displacement * _MICRO, 0.9, key=recording.time))
    # a voltage that jumps up and down with its reference forms no loop either
    if not lines or lines[-1].colour != inputs[-1][1]:
        return None
    across, caption = "voltage or reference [% of its range]", "Hysteresis loop before and after compensation"
    if run.reference is None:
        across, caption = "voltage [% of its range]", "Hysteresis loop"
    return Chart("loops", caption, across, "displacement [µm]", lines, "path", height=4.4)


def voltage_chart(run: Judged) -> Chart | None:
    """Return the chart of the voltage over time [V, s] with the configured limits; None without a voltage."""
    if not run.recording.has("voltage"):
        return None
    line = Line("voltage", "voltage", run.recording.time, run.recording["voltage"], 1.0)
    both = (run.settings.voltage_minimum, run.settings.voltage_maximum)
    limits = tuple(limit for limit in both if limit is not None)
    label = "limits" if limits else ""
    caption = "Voltage and its limits" if limits else "Voltage"
    return Chart("voltage", caption, "time [s]", "voltage [V]", [line], levels=limits, level_label=label)


def adaptation_chart(run: Judged) -> Chart | None:
    """Return the chart of an adapted inverse's gain over time; None without adaptation."""
    recording = run.recording
    if not recording.has("adaptation") or not np.any(np.nan_to_num(recording["adaptation"])):
        return None
    gain, adapts = recording["adapted_gain"], recording["adaptation"] == ADAPTING
    lines = [
        Line("frozen", "limit", recording.time, gain, 1.0),
        Line("adapting", "voltage", recording.time, np.where(adapts, gain, np.nan), 1.8),
    ]
    caption = "Gain of the adapted inverse, relative to the identified one"
    return Chart("adaptation", caption, "time [s]", "gain [1]", lines)


def learned_chart(run: Judged) -> Chart | None:
    """Return the chart of the RMS error of each period [µm or nm] over time [s]; None without learning."""
    ends, errors = period_errors(run.recording)
    if not ends.size:
        return None
    unit, factor = length_unit(float(np.nanmax(errors)))
    line = Line("period", "displacement", ends, errors * factor)
    caption = "RMS error of each period of the learning, against the undelayed reference"
    return Chart("learned", caption, "time [s]", f"RMS of a period [{unit}]", [line], "graph", "y")


def lateness_chart(run: Judged) -> Chart | None:
    """Return the chart of the lateness of each sample over time [µs, s]; None if it was not recorded."""
    if not run.recording.has("lateness"):
        return None
    line = Line("lateness", "late", run.recording.time, run.recording["lateness"] * _MICRO, 0.9)
    return Chart("lateness", "Lateness of each sample over time", "time [s]", "lateness [µs]", [line])


def late_samples_chart(run: Judged) -> Chart | None:
    """Return the chart of the fraction of samples with at least a given lateness [µs]; None if it was not recorded."""
    if not run.recording.has("lateness"):
        return None
    late = np.sort(_finite(run.recording["lateness"]))[::-1] * _MICRO
    # both axes are logarithmic, so all of the largest values are kept, and fewer of the smaller ones
    ranks = np.unique(np.rint(np.geomspace(1, late.size, 400)).astype(np.int64))
    # a lateness of 0 cannot be drawn on a logarithmic axis
    line = Line("samples", "late", np.maximum(late[ranks - 1], 0.1)[::-1], (ranks / late.size)[::-1])
    caption = "Fraction of samples with at least this lateness"
    return Chart("late_samples", caption, "lateness [µs]", "fraction of samples [1]", [line], "graph", "xy")


def _finite(values) -> np.ndarray:
    return values[np.isfinite(values)]


#: Minimum number of segments of a spectrum, counted without overlap, unless they would be too short.
SEGMENTS = 4
#: Maximum number of samples in a segment of a spectrum.
LONGEST_SEGMENT = 2**16
#: Minimum number of samples for a spectrum, and for a segment of it.
LEAST_SAMPLES = 64
#: Maximum number of points of a spectrum. A spectrum with more lines is divided into at most this many frequency
#: intervals, and only the largest line of each is drawn.
SPECTRUM_POINTS = 1500
#: Number of bars of a histogram.
BARS = 60
#: Maximum number of overlaid periods.
PERIODS = 3

_NANO, _TO_MICROMETRES = 1e9, 1e6


def amplitude_spectrum(time, values, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitude spectral density of a signal by Welch's method (Hann windows that overlap by half).

    The mean of each segment is removed. The density is one-sided: the sum of its squares over all lines, times the
    spacing of the lines, is the variance. Missing samples are interpolated linearly.

    Units: ``time`` [s], ``values`` [m], ``sample_time`` [s].
    """
    grid = np.arange(round((time[-1] - time[0]) / sample_time) + 1) * sample_time + time[0]
    even = values if grid.size == values.size else np.interp(grid, time, values)
    segment = int(min(LONGEST_SEGMENT, max(LEAST_SAMPLES, even.size // SEGMENTS), even.size))
    frequency, power = signal.welch(even, 1.0 / sample_time, "hann", segment, detrend="constant")
    return frequency[1:], np.sqrt(power[1:])


def spectrum_chart(run: Judged) -> Chart | None:
    """Return the chart of the error's spectrum [nm/√Hz, Hz]; None without an error, or with too few samples."""
    if run.error is None or np.count_nonzero(run.counted) < LEAST_SAMPLES:
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
        note=f"Largest at {peak:.4g} Hz; half of the variance lies below {half:.4g} Hz. Lines are {frequency[0]:.3g} "
        f"Hz apart (Welch's method, Hann windows, mean removed).",
    )


def histogram_chart(run: Judged) -> Chart | None:
    """Return the histogram chart of the error [nm or µm, %], with the normal distribution of the same mean and σ."""
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
    """Return the chart of the overlaid errors of the last periods [nm]; None if the reference is not periodic."""
    if run.error is None:
        return None
    time = run.recording.time - run.recording.time[0]
    ends = period_ends(run.recording)
    period = float(ends[0] - ends[1]) if ends.size > 1 else 0.0
    unit, factor = ("ms", 1e3) if period < 0.5 else ("s", 1.0)
    names = ("last", "second to last", "third to last")
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
    caption = "Error in the last periods, overlaid"
    across, note = f"time in the period [{unit}]", f"A period lasts {period * factor:.6g} {unit}."
    return Chart("periods", caption, across, "error [nm]", lines[::-1], "graph", levels=(0.0,), note=note)


def last_branches(recording: Recording, reference) -> tuple[slice, slice] | None:
    """Return the samples of the last two branches of a reference; None if the reference does not reverse.

    Units: ``reference`` [m].
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
    """Return the chart of trace and retrace errors [nm] versus the reference [µm]; None without reversals."""
    if run.error is None or run.reference is None:
        return None
    branches = last_branches(run.recording, run.reference)
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
        Line("trace (rising)", "reference", x * _TO_MICROMETRES, trace * _NANO),
        Line("retrace (falling)", "displacement", x_back * _TO_MICROMETRES, retrace * _NANO),
    ]
    said = ""
    if apart.size:
        largest, typical = float(np.max(np.abs(apart))) * _NANO, float(np.sqrt(np.mean(apart**2))) * _NANO
        said = f"At equal reference, trace and retrace differ by {typical:.4g} nm RMS, and by at most {largest:.4g} nm."
    caption = "Trace against retrace: error versus reference, last two branches"
    return Chart("trace", caption, "reference [µm]", "error [nm]", lines, "graph", levels=(0.0,), note=said)
