# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Data for an identification (time, one input and one output in SI units), and its checks before any fit.

The checks report what makes data unusable (missing samples, non-uniform time, constant signals), what makes the result
less accurate (clipping, delay, drift), and numbers that suggest a wrong unit.
"""

from __future__ import annotations

import math
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from hysteresis_ros.arguments import real_array
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.thresholds import DRIFT
from hysteresis_ros.models.play_operators import plays
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run
from hysteresis_ros.recordings.foreign_tables import (
    TABLE_SUFFIXES,
    Selection,
    Table,
    choose_columns,
    column_unit,
    find_time,
    open_table,
    si_unit,
    split_choice,
)
from hysteresis_ros.recordings.loops import turning_points
from hysteresis_ros.units import readable

#: Plausible ranges of the voltage [V], of the displacement [m] and of their ratio [m/V].
VOLTAGES = (0.02, 2000.0)
STROKES = (5e-9, 2e-3)
GAINS = (1e-9, 2e-4)
#: Longest plausible sample time, shortest plausible duration, longest plausible cycle [s].
LONGEST_SAMPLE_TIME = 0.5
SHORTEST_DURATION = 0.1
LONGEST_CYCLE = 500.0
#: Smallest number of samples per cycle that shows the turning points of the loops.
FEWEST_A_CYCLE = 20.0


def implausible_units(
    sample_time: float, duration: float, u, y, units: tuple[str, str], reversals: int
) -> Iterator[str]:
    """Yield a warning for each number that suggests a wrong unit.

    Units: ``sample_time`` [s], ``duration`` [s].
    """
    span, stroke = float(np.ptp(u)), float(np.ptp(y))
    gain = stroke / span if span > 0.0 else math.nan
    if units[0] == "V" and not VOLTAGES[0] <= span <= VOLTAGES[1]:
        other = "V instead of mV" if span < VOLTAGES[0] else "mV instead of V"
        yield f"the voltage spans {readable(span, 'V')}: is its unit {other}? give it as --input NAME:UNIT"
    odd = not STROKES[0] <= stroke <= STROKES[1] or (units[0] == "V" and not GAINS[0] <= gain <= GAINS[1])
    if units[1] == "m" and odd:
        small = stroke < STROKES[0] or gain < GAINS[0]
        other = "um instead of nm (or V instead of mV)" if small else "um instead of mm (or V instead of mV)"
        each = f", {readable(gain, 'm')}/V" if units[0] == "V" else ""
        yield f"the output moves by {readable(stroke, 'm')}{each}: is its unit {other}? give it as --output NAME:UNIT"
    cycle = 2.0 * duration / reversals if reversals > 1 else 0.0
    if sample_time > LONGEST_SAMPLE_TIME or cycle > LONGEST_CYCLE:
        yield (
            f"samples lie {sample_time:.4g} s apart and a cycle takes {cycle:.4g} s: is the unit of time ms instead of "
            "s? give it as --time NAME:UNIT"
        )
    if duration < SHORTEST_DURATION:
        yield (
            f"all samples lie within {readable(duration, 's')}: is the unit of time s instead of ms? give it as --time "
            "NAME:UNIT"
        )


def swapped(span: float, stroke: float, units: tuple[str, str]) -> bool:
    """Return whether voltage and displacement, and their ratio, are plausible only with the columns exchanged.

    Units: ``span`` [V], ``stroke`` [m].
    """
    return (
        units == ("V", "m")
        and span < VOLTAGES[0]
        and stroke > STROKES[1]
        and STROKES[0] <= span <= STROKES[1]
        and VOLTAGES[0] <= stroke <= VOLTAGES[1]
        and GAINS[0] <= span / stroke <= GAINS[1]
    )


def few_samples_a_cycle(samples: float, reversals: int) -> Iterator[str]:
    """Yield a warning if turning points may fall between the samples."""
    if reversals < 2:
        return
    each = 2.0 * samples / reversals
    if each < FEWEST_A_CYCLE:
        beyond = 50.0 * (1.0 - math.cos(math.pi / each))
        yield (
            f"{each:.3g} samples per cycle: a sine turns up to {beyond:.2g} % of its range beyond the nearest "
            f"sample, so the ends of loops are missing; record {FEWEST_A_CYCLE:.0f} or more per cycle, or give "
            "--intersample"
        )


#: Largest deviation of a sample from the uniform grid, in sample times.
GRID_TOLERANCE = 0.1
#: A signal whose range is below this fraction of its mean level counts as constant.
CONSTANT = 1e-12
#: Smallest number of consecutive equal samples at an extreme that can count as clipping.
CLIPPED_RUN = 3
#: A run of equal samples counts as clipped only if it is at least this many times longer than the mean of the
#: neighbouring runs; at the top of a coarsely quantised sine the ratio is 5.5.
CLIPPED_POPULATION = 8.0
#: A drift above this fraction of the stroke, over the whole data, causes a warning.
DRIFT_SHARE = 0.01
#: Number of plays in the fit that distinguishes drift from hysteresis.
TRIED_PLAYS = 10
#: Largest number of samples in the fit that distinguishes drift from hysteresis.
TRIED_SAMPLES = 4000
#: The drift is known only if input, plays and size of the loops leave at least this fraction of a straight line in time
#: unexplained.
LEAST_LEFT = 0.3


class DataError(IdentificationError):
    """Data that cannot be used for identification."""

    def __init__(self, check: str, message: str):
        self.check = check
        super().__init__(message)


@dataclass(frozen=True)
class Finding:
    """One finding of a check."""

    #: ``short``, ``constant``, ``nan``, ``uniform``, ``swapped``, ``clipping``, ``unit``, ``coarse``, ``delay``,
    #: ``drift``, ``jitter``, ``reading`` …
    check: str
    severity: str  #: ``error`` (data unusable), ``warning`` (result less accurate) or ``note``.
    message: str  #: Sentence with numbers and units.


@dataclass(frozen=True)
class DataReport:
    """Result of the checks."""

    samples: int
    sample_time: float  #: [s]
    jitter: float  #: Largest deviation of a sample from the uniform grid [s].
    missing: int  #: Number of samples at which the input or output is not finite.
    stroke: float  #: Peak-to-peak output in its SI unit.
    input_minimum: float  #: input_minimum, input_maximum: In the input's SI unit.
    input_maximum: float
    clipped_input: float  #: clipped_input, clipped_output: Fraction of samples at a clipped extreme.
    clipped_output: float
    #: Lag of the output behind the input [s] at the best correlation: dead time, dynamics and hysteresis together.
    delay: float
    drift: float  #: Change of the output over the data that the input does not explain, in its SI unit.
    reversals: int  #: Number of reversals of the input.
    findings: tuple[Finding, ...]  #: Findings in the order of the checks.

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that make the data unusable."""
        return tuple(item for item in self.findings if item.severity == "error")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages of the warnings."""
        return tuple(item.message for item in self.findings if item.severity == "warning")

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages of the notes."""
        return tuple(item.message for item in self.findings if item.severity == "note")

    def warned(self, texts) -> DataReport:
        """Return the report with ``texts`` added as warnings before its findings."""
        return replace(self, findings=(*(Finding("reading", "warning", text) for text in texts), *self.findings))

    def raise_errors(self) -> None:
        """Raise DataError if the data is unusable."""
        if self.errors:
            raise DataError(self.errors[0].check, "; ".join(item.message for item in self.errors))


def check_data(time, input, output, input_unit="V", output_unit="m", minimum_samples: int = 50) -> DataReport:
    """Check one input and one output before any fit, without changing them or raising an error.

    Units: ``time`` [s].
    """
    units = input_unit, output_unit
    return check_behaviour(check_samples(time, input, output, units, minimum_samples), time, input, output, units)


def check_samples(time, input, output, units=("V", "m"), minimum_samples: int = 50) -> DataReport:
    """Check the samples themselves: missing values, time, constants, clipping.

    Units: ``time`` [s].
    """
    found: list[Finding] = []
    finite = np.isfinite(input) & np.isfinite(output)
    missing = int(np.count_nonzero(~finite))
    if len(time) < minimum_samples:
        text = f"too short: {len(time)} samples; at least {minimum_samples} are needed"
        found.append(Finding("short", "error", text))
    if missing:
        index = int(np.argmax(~finite))
        text = f"{missing} of {len(time)} samples are missing (NaN), the first of them at index {index}"
        found.append(Finding("nan", "error", f"{text}; choose a range without them (--range) or add --resample auto"))
    sample_time, jitter, finding = check_uniform(time)
    found += finding
    u, y = (input, output) if not missing else (input[finite], output[finite])
    numbers = dict(stroke=np.nan, low=np.nan, high=np.nan, clipped_u=0.0, clipped_y=0.0)
    if u.size:
        numbers |= dict(stroke=np.ptp(y), low=u.min(), high=u.max())
        for role, values, unit in (("input", u, units[0]), ("output", y, units[1])):
            if np.ptp(values) <= CONSTANT * np.max(np.abs(values)):
                text = f"the {role} is constant ({values[0]:.6g} {unit}); excite the actuator and record again"
                found.append(Finding("constant", "error", text))
    if u.size and swapped(np.ptp(u), np.ptp(y), units):
        text = (
            f"the columns seem swapped: the voltage spans {np.ptp(u):.3g} V and the displacement {np.ptp(y):.3g} m; "
            "exchange --input and --output, or the names of the columns in the file"
        )
        found.append(Finding("swapped", "error", text))
    if u.size and not any(item.check in ("constant", "short") for item in found):
        numbers["clipped_u"], numbers["clipped_y"] = clipped_share(u), clipped_share(y, u)
        for role, values, unit, share in (
            ("input", u, units[0], numbers["clipped_u"]),
            ("output", y, units[1], numbers["clipped_y"]),
        ):
            if share > 0.0:
                text = (
                    f"the {role} seems clipped: {100 * share:.2g} % of the samples are exactly at an end of its range "
                    f"({readable(values.min(), unit)} … {readable(values.max(), unit)})"
                )
                found.append(Finding("clipping", "warning", text))
    return DataReport(
        samples=len(time),
        sample_time=sample_time,
        jitter=jitter,
        missing=missing,
        stroke=float(numbers["stroke"]),
        input_minimum=float(numbers["low"]),
        input_maximum=float(numbers["high"]),
        clipped_input=numbers["clipped_u"],
        clipped_output=numbers["clipped_y"],
        delay=np.nan,
        drift=np.nan,
        reversals=0,
        findings=tuple(found),
    )


def check_behaviour(report: DataReport, time, input, output, units=("V", "m")) -> DataReport:
    """Add findings about the relation of input and output: reversals, implausible units, delay, drift."""
    if any(item.check in ("constant", "short") for item in report.findings):
        return report
    found = list(report.findings)
    finite = np.isfinite(input) & np.isfinite(output)
    u, y = input[finite], output[finite]
    if not u.size:
        return report
    reversals = count_reversals(u)
    duration = float(time[-1] - time[0])
    questions = implausible_units(report.sample_time, duration, u, y, units, reversals)
    found += [Finding("unit", "warning", text) for text in questions]
    found += [
        Finding("coarse", "warning", text) for text in few_samples_a_cycle(duration / report.sample_time, reversals)
    ]
    delay = np.nan
    if not any(item.check in ("uniform", "nan") for item in found):
        delay, finding = _check_delay(u, y, duration / (len(time) - 1))
        found += finding
    drift, finding = _check_drift(time[finite], u, y, units[1])
    return replace(report, delay=delay, drift=drift, reversals=reversals, findings=(*found, *finding))


def check_uniform(time) -> tuple[float, float, list[Finding]]:
    """Return sample time [s], jitter [s] and findings of a time axis of shape (N,).

    Rounded times count as uniform if each of them differs from a uniform grid by at most the rounding error.
    """
    if len(time) < 2:
        return float("nan"), 0.0, []
    index = np.arange(len(time))
    distances = np.diff(time)
    slope = float((time[-1] - time[0]) / (len(time) - 1))
    beside = time - time[0] - slope * index
    jitter = float(np.ptp(beside) / 2)
    if not np.all(distances > 0.0):
        return slope, jitter, [Finding("uniform", "error", "time does not increase; sort the samples")]
    if jitter <= GRID_TOLERANCE * slope or jitter <= 0.51 * _rounding(time):
        if jitter <= 0.01 * slope:
            return slope, jitter, []
        beside = f"by up to {readable(jitter, 's')} from a uniform grid of {readable(slope, 's')}"
        text = f"samples deviate {beside}; assumed to be uniform"
        return slope, jitter, [Finding("jitter", "note", text)]
    median = float(np.median(distances))
    steps = np.rint(distances / median)
    if np.max(np.abs(distances - steps * median)) <= GRID_TOLERANCE * median:
        lost, longest = int(np.sum(steps - 1)), int(np.argmax(distances))
        text = (
            f"not uniformly sampled: {lost} samples are missing from a grid of {median:.6g} s; the longest gap, "
            f"{distances[longest]:.4g} s, begins at {time[longest]:.6g} s"
        )
    else:
        text = f"not uniformly sampled: intervals from {distances.min():.6g} s to {distances.max():.6g} s"
    return (
        slope,
        jitter,
        [Finding("uniform", "error", f"{text}; add --resample auto, or choose a uniform range (--range)")],
    )


def _rounding(time):
    """Return the unit [s] to which all times are rounded (a power of ten); 0 if they are not rounded."""
    for digits in range(1, 7):
        scaled = time * 10.0**digits
        if np.max(np.abs(scaled - np.rint(scaled))) < 1e-6 * max(1.0, np.max(np.abs(scaled)) * 1e-7):
            # times rounded to a unit of one sample time or more carry no information
            return 10.0**-digits if 10.0**-digits < np.median(np.diff(time)) else 0.0
    return 0.0


def clipped_share(values, driver=None) -> float:
    """Return the fraction of samples at a clipped extreme, see :func:`clipped_samples`."""
    return float(np.mean(clipped_samples(values, driver)))


def clipped_samples(values, driver=None) -> np.ndarray:
    """Return which samples are at a clipped extreme, shape (N,) of bool.

    A run of at least three equal samples at the extreme counts as clipped if it is many times longer than the runs just
    before and after it. With a ``driver`` (the input that causes this output), only runs during which the driver moves
    count, because an output may be constant while its input is constant. Without a driver, rest at the beginning or end
    of the data does not count as clipping, nor does a signal that rests at many levels (steps).
    """
    tolerance = 1e-9 * np.ptp(values)
    starts = np.flatnonzero(np.r_[True, np.abs(np.diff(values)) > tolerance])
    lengths = np.diff(np.r_[starts, values.size])
    level = values[starts]
    clipped = np.zeros(level.size, dtype=bool)
    ends = [np.abs(level - extreme) <= tolerance for extreme in (values.min(), values.max())]
    others = lengths[~(ends[0] | ends[1])]
    resting = others[others >= CLIPPED_RUN]
    for at in ends:
        long = at & (lengths >= CLIPPED_RUN)
        if driver is not None:
            span = 1e-3 * np.ptp(driver)
            for i in np.flatnonzero(long):
                long[i] = np.ptp(driver[starts[i] : starts[i] + lengths[i]]) > span
        else:
            long[[0, -1]] = False
        if not long.any():
            continue
        longest = int(np.argmax(np.where(long, lengths, 0)))
        beside = np.r_[lengths[max(longest - 2, 0) : longest], lengths[longest + 1 : longest + 3]]
        if beside.size == 0 or lengths[longest] < CLIPPED_POPULATION * np.mean(beside):
            continue
        if driver is None and resting.size and np.max(resting) >= 0.5 * np.max(lengths[long]):
            continue
        clipped |= long
    return np.repeat(clipped, lengths)


def count_reversals(values) -> int:
    """Return the number of reversals of ``values``, shape (N,); ripple below 1 % of the range does not count."""
    peaks = [scipy.signal.find_peaks(sign * values, prominence=0.01 * np.ptp(values))[0].size for sign in (1.0, -1.0)]
    return int(sum(peaks))


def estimate_delay(u, y, sample_time: float) -> float:
    """Return the lag [s] of y behind u at which their correlation is highest, interpolated by a parabola.

    The search is limited to half of the input's period, so that the result cannot be wrong by a whole period.
    """
    u, y = (u - u.mean()) / u.std(), (y - y.mean()) / y.std()
    n = u.size
    spectrum = np.abs(np.fft.rfft(u)) ** 2
    main = max(1, int(np.argmax(spectrum[1:]) + 1))
    reach = max(2, min(n // 4, int(0.5 * n / main)))
    products = scipy.signal.correlate(y, u, mode="full", method="fft")[n - 1 - reach : n + reach]
    lags = np.arange(-reach, reach + 1)
    # the correlation coefficient of the overlapping parts, because sums of products are biased towards zero lag
    first_u, first_y = np.maximum(-lags, 0), np.maximum(lags, 0)
    overlap = n - np.abs(lags)
    sums = []
    for values, first in ((u, first_u), (y, first_y), (u * u, first_u), (y * y, first_y)):
        total = np.r_[0.0, np.cumsum(values)]
        sums.append(total[first + overlap] - total[first])
    spread = (sums[2] - sums[0] ** 2 / overlap) * (sums[3] - sums[1] ** 2 / overlap)
    window = (products - sums[0] * sums[1] / overlap) / np.sqrt(np.maximum(spread, 1e-300))
    # an inverted sine fits equally well half a period later, so an inverted output is accepted only if it fits clearly
    # better
    sign = -1.0 if -window.min() > 1.1 * window.max() else 1.0
    best = int(np.argmax(sign * window))
    shift = 0.0
    if 0 < best < window.size - 1:
        left, middle, right = window[best - 1 : best + 2]
        bend = left - 2 * middle + right
        shift = 0.5 * (left - right) / bend if bend else 0.0
    return float((lags[best] + shift) * sample_time)


def _check_delay(u, y, sample_time):
    delay = estimate_delay(u, y, sample_time)
    lag = readable(delay, "s")
    text = f"the output lags the input by {lag} at the best correlation (dead time, dynamics and hysteresis)"
    if delay < -1.5 * sample_time:
        lead = readable(-delay, "s")
        text = f"the output leads the input by {lead}; do both columns use one clock, and are they in the right order?"
        return delay, [Finding("delay", "warning", text)]
    return delay, [Finding("delay", "note", text)]


def _drift_beside_loops(time, u, y) -> float:
    """Return the drift of an output over a recording without a model; 0 if insignificant, NaN if it is not known.

    The output is fitted by the terms of :func:`_terms_of_loops`, and by time. Units: ``time`` [s]; the result has the
    unit of ``y``.
    """
    table, step = _terms_of_loops(u)
    line, y = ((time - time[0]) / np.ptp(time))[::step], y[::step]
    both = np.column_stack([line, y])
    left, residual = (both - table @ np.linalg.lstsq(table, both, rcond=1e-8)[0]).T
    if np.std(left) < LEAST_LEFT * np.std(line):
        return np.nan
    drift = float(left @ residual / (left @ left))
    return drift if DRIFT.improves(float(np.std(residual - drift * left)), float(np.std(residual))) else 0.0


def loops_resemble_drift(u) -> bool:
    """Return whether the loops of an input, shape (N,), grow or shrink all the time.

    Such loops move the mean output like a drift, so an error in the shape of the loops looks like a drift.
    """
    table, step = _terms_of_loops(u)
    line = np.linspace(0.0, 1.0, u.size)[::step]
    left = line - table @ np.linalg.lstsq(table, line, rcond=1e-8)[0]
    return bool(np.std(left) < LEAST_LEFT * np.std(line))


def _terms_of_loops(u) -> tuple[np.ndarray, int]:
    """Return the terms of a loop at every n-th sample of an input, and n.

    The terms are a cubic of the input, plays, the speed of the input, and the size of the present loop and its square.
    """
    span = np.ptp(u)
    scaled, turns = (u - u.mean()) / span, turning_points(u)
    speed = np.gradient(scaled)
    size = np.interp(np.arange(u.size), 0.5 * (turns[1:] + turns[:-1]), np.abs(np.diff(u[turns])) / span)
    radii = span * np.linspace(0.0, 0.5, TRIED_PLAYS + 1)[:-1] + 0.25 * span / TRIED_PLAYS
    powers = np.vander(scaled, 4)
    whole = np.column_stack([powers, plays(u, radii) / span, speed / np.max(np.abs(speed)), size, size**2])
    step = -(-u.size // TRIED_SAMPLES)
    return whole[::step], step


def _check_drift(time, u, y, unit):
    """Return the drift over the data (NaN: not known), and findings."""
    drift, stroke = _drift_beside_loops(time, u, y), float(np.ptp(y))
    if not abs(drift) > DRIFT_SHARE * stroke:
        return drift, []
    text = f"the output drifts by {readable(drift, unit)} ({100 * drift / stroke:.2g} % of stroke) over the data"
    return drift, [Finding("drift", "warning", f"{text}: creep, temperature or a transient at the start")]


__all__ = ["DataError", "DataReport", "IdentificationData", "check_data", "from_recording", "from_table", "load_data"]


@dataclass(frozen=True, eq=False)
class IdentificationData:
    """One input and one output sampled at common times."""

    time: np.ndarray  #: shape (N,) [s], strictly increasing.
    input: np.ndarray  #: shape (N,); SI.
    output: np.ndarray  #: shape (N,); SI.
    input_unit: str = "V"  #: SI unit of the input.
    output_unit: str = "m"  #: SI unit of the output.
    input_name: str = "input"  #: Name of the input's column.
    output_name: str = "output"  #: Name of the output's column.
    source: str = ""  #: Name of the file.
    first: int = 0  #: Index of the first sample in the source.
    notes: tuple[str, ...] = ()  #: Changes to the data (samples omitted, resampled …).
    warnings: tuple[str, ...] = ()  #: Reasons for caution (gaps bridged, rows damaged …).
    factor: int = 1  #: Number of samples of the source averaged into each sample.

    def __post_init__(self):
        """Check shapes and units."""
        for name in ("time", "input", "output"):
            try:
                values = real_array(getattr(self, name))
            except (TypeError, ValueError):
                raise DataError("shape", f"{name}: must be an array of real numbers") from None
            if values.ndim != 1 or values.shape != np.shape(self.time):
                raise DataError("shape", f"{name} has shape {values.shape}; it must be ({np.size(self.time)},)")
            object.__setattr__(self, name, values)
        for name in ("input_unit", "output_unit"):
            if not getattr(self, name):
                raise DataError("unit", f"{name} is empty: data without units cannot be identified; give V, m …")

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    @property
    def sample_time(self) -> float:
        """Interval between two samples [s]; NaN with fewer than two."""
        if len(self) < 2:
            return float("nan")
        return float((self.time[-1] - self.time[0]) / (len(self) - 1))

    @property
    def stroke(self) -> float:
        """Peak-to-peak output in its SI unit, without missing samples; NaN if there are no samples."""
        finite = self.output[np.isfinite(self.output)]
        return float(np.ptp(finite)) if finite.size else float("nan")

    @property
    def input_range(self) -> tuple[float, float]:
        """Lowest and highest input in its SI unit."""
        return float(np.nanmin(self.input)), float(np.nanmax(self.input))

    def part(self, first: int = 0, last: int | None = None) -> IdentificationData:
        """Return the samples ``first … last - 1``; ``last`` may be None (all) or negative (from the end)."""
        start, stop, _ = slice(first, last).indices(len(self))
        if first < 0 or stop <= start or (last is not None and last > len(self)):
            raise DataError("range", f"samples {first}:{last} of {len(self)}: choose a range inside the recording")
        columns = {name: getattr(self, name)[start:stop] for name in ("time", "input", "output")}
        return replace(self, **columns, first=self.first + start)

    def checked(self, minimum_samples: int = 50) -> tuple[IdentificationData, DataReport]:
        """Return the data without missing samples at both ends, and the report of its checks."""
        data = self.trimmed()
        report = check_data(
            data.time, data.input, data.output, data.input_unit, data.output_unit, minimum_samples=minimum_samples
        )
        report.raise_errors()
        return data, report.warned(data.warnings)

    def trimmed(self) -> IdentificationData:
        """Return the data without the samples at its ends whose input or output is missing."""
        finite = np.isfinite(self.input) & np.isfinite(self.output)
        if not finite.any() or (finite[0] and finite[-1]):
            return self
        first, last = int(np.argmax(finite)), len(self) - int(np.argmax(finite[::-1]))
        note = f"{first} samples at the start and {len(self) - last} at the end omitted: input or output missing"
        return replace(self.part(first, last), notes=(*self.notes, note))


def from_recording(
    recording: Recording, input: str | None = None, output: str | None = None, source: str | None = None
) -> IdentificationData:
    """Select input and output of a recording."""
    chosen_input = input or _default(recording.units, ("voltage",), "V", "input", recording)
    chosen_output = output or _default(recording.units, ("measured", "displacement"), "m", "output", recording)
    return IdentificationData(
        recording.time,
        recording[chosen_input],
        recording[chosen_output],
        recording.units.get(chosen_input, ""),
        recording.units.get(chosen_output, ""),
        chosen_input,
        chosen_output,
        source if source is not None else str(recording.metadata.get("source", "")),
        notes=tuple(recording.notes),
        warnings=tuple(recording.metadata.get("warnings", ())),
    )


def _refuse_inchworm(path, columns, input, output) -> None:
    """Raise DataError if inchworm data is read without column names, because the slider follows several voltages."""
    if "front_voltage" in columns and "rear_voltage" in columns and not (input and output):
        raise DataError(
            "inchworm",
            f"{path}: this run of an inchworm motor records the displacement of the slider, which does not follow the "
            "voltage; excite the extender alone, or choose the columns with --input and --output",
        )


def load_data(
    path,
    input: str | None = None,
    output: str | None = None,
    time: str | None = None,
    sample_time: float | None = None,
    namespace: str | None = None,
) -> IdentificationData:
    """Read a bag, a text table or an NPZ, and select one input and one output.

    Units: ``sample_time`` [s].
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in TABLE_SUFFIXES:
        return from_table(open_table(path), Selection((), time, sample_time), input, output)
    recording = load_run(path, namespace)
    _refuse_inchworm(path, recording.signals, input, output)
    names = [choice and _same_unit(recording, choice) for choice in (input, output)]
    return from_recording(recording, names[0], names[1], path.name)


def from_table(
    table: Table, selection: Selection, input: str | None = None, output: str | None = None, progress=None
) -> IdentificationData:
    """Select one input and one output of a table."""
    declared, time = table.units, selection.time
    _refuse_inchworm(table.path, declared, input, output)
    taken = {split_choice(time)[0] if time and time not in declared else time or find_time(declared)}
    taken |= {choice if choice in declared else split_choice(choice)[0] for choice in (input, output) if choice}
    free = {name: unit for name, unit in declared.items() if name not in taken}
    input = input or _default(free, ("voltage",), "V", "input")
    output = output or _default(free, ("measured", "displacement"), "m", "output")
    recording = choose_columns(table, replace(selection, choices=(input, output)), progress)
    names = list(recording.signals)
    if len(names) < 2:
        raise DataError("columns", f"{table.path}: input and output are the same column '{names[0]}'")
    data = from_recording(recording, names[0], names[1], table.path.name)
    return replace(data, first=selection.rows[0])


def _same_unit(recording, choice):
    """Return the name of the chosen signal of a bag; a given unit must be the SI unit of the signal."""
    name, unit = (choice, None) if choice in recording else split_choice(choice)
    there = recording.units.get(name)
    if unit is not None and there is not None and unit != there:
        text = f"signal '{name}' of the recording is in '{there}', not in '{unit}'"
        raise DataError("unit", f"{text}; leave the unit out")
    return name


def _default(units, preferred, unit, role, recording=None):
    for name in preferred:
        if name in units and (recording is None or recording.has(name)):
            return name
    fitting = [name for name, declared in units.items() if declared and _si(name, declared) == unit]
    if len(fitting) == 1:
        return fitting[0]
    found = f"{', '.join(fitting)} are all in {unit}" if fitting else f"no column is in {unit}"
    columns = ", ".join(f"{name} [{declared or '?'}]" for name, declared in units.items())
    raise DataError(
        "columns", f"the column of the {role} is unclear: {found}; columns: {columns}. Choose one as name:unit"
    )


def _si(name, unit):
    return si_unit(column_unit(name, unit))


def refuse_short(samples: int, needed: int, what: str) -> None:
    """Raise DataError if the data has too few samples for a fit."""
    if samples < needed:
        raise DataError("short", f"{samples} samples are too few for {what}; at least {needed} are needed")


#: Least number of samples of a recording.
FEWEST_SAMPLES = 20


def checked_signals(input_, output, names=("voltage", "displacement"), fewest: int = FEWEST_SAMPLES):
    """Return both signals as float arrays of the same length, shape (N,); raise DataError if they cannot be fitted."""
    signals = []
    for name, values in zip(names, (input_, output), strict=True):
        values = np.ascontiguousarray(values, dtype=np.float64)
        if np.ndim(values) != 1:
            raise DataError("shape", f"{name} has {values.ndim} dimensions; give one column of numbers")
        if values.size < fewest:
            raise DataError("short", f"{name} has {values.size} samples, too short; N ≥ {fewest} are needed")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            text = f"{name} is not finite at {bad.size} samples (NaN or infinite), the first of them at index {bad[0]}"
            raise DataError("nan", f"{text}; cut them out or resample")
        if np.ptp(values) <= CONSTANT * np.max(np.abs(values)):
            raise DataError("constant", f"{name} is constant at {values[0]:g}; excite the actuator and record again")
        signals.append(values)
    if signals[0].size != signals[1].size:
        text = f"{names[0]} has {signals[0].size} samples and {names[1]} {signals[1].size}"
        raise DataError("shape", f"{text}; both must have the same number of samples")
    return signals[0], signals[1]


def finite_array(name: str, values) -> np.ndarray:
    """Return ``values`` as float64 array; raise DataError for values that are not finite."""
    try:
        array = real_array(values)
    except (TypeError, ValueError):
        raise DataError("shape", f"{name}: must be an array of real numbers") from None
    bad = ~np.isfinite(array)
    if bad.any():
        index = tuple(map(int, np.argwhere(bad)[0]))
        raise DataError(
            "nan", f"{name}{list(index)} is not finite ({np.count_nonzero(bad)} such values); leave them out"
        )
    return array
