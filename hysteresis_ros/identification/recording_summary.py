# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a recording shows before any fit: units, sampling, direction, shape, saturation, drift, repetition, content.

The mean rising and falling branches (:func:`mean_loop`) show the direction and the shape. An output that falls with the
input, or that first falls and then rises (a butterfly), is refused here, because no model with an inverse describes it.
If the output is level at an end of the range but was steep just before, the amplifier saturates there.

The sign of the gain is determined from slow movement, because neither a lag nor a resonance changes its phase. Other
causes of movement (other inputs, vibration, drift) count as noise. The gain is determined in the narrowest band from
the lowest frequency up in which it clearly exceeds its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import HysteresisError, IdentificationError
from hysteresis_ros.identification.data import DataReport, IdentificationData
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.prandtl_ishlinskii import FreeWeights
from hysteresis_ros.identification.preprocessing import condense, highest_frequency
from hysteresis_ros.recordings.loops import loop_opening, turning_points
from hysteresis_ros.units import bare_name, readable

#: Fraction of the input's power in the first band; each further band has twice as many frequencies as the one before.
FIRST_BAND = 0.01
#: The sign of the gain is certain if the gain exceeds this multiple of its standard deviation.
CERTAIN = 3.0
#: Number of levels of the input at which the mean branches are computed.
LEVELS = 50
#: Degree of the polynomial by which a butterfly is recognised.
DEGREE = 4
#: In a butterfly, the polynomial explains at least this fraction of the output's variance.
EXPLAINED = 0.3
#: In a butterfly, the polynomial falls within the range by at least this fraction of its rise, or rises by at least
#: this fraction of its fall.
FALLS = 0.25
#: The output is level at an end of the range if both mean branches together change by at most this fraction of the
#: stroke.
LEVEL = 0.01
#: Smallest number of levels of the input over which the output must be level there.
FEWEST_LEVELS = 3
#: The output becomes level abruptly if the mean slope of the steeper branch just before is at least this fraction of
#: the overall mean slope.
ABRUPT = 0.5
#: The loop saturates at an end, or has a dead zone, if the slope there, over a tenth of the range, is below this
#: fraction of the largest slope.
FLAT = 0.2
#: Jitter of the time stamps is reported if it exceeds this fraction of the sample time.
UNEVEN = 0.01
#: The width of the loops is computed only up to this number of turning points; a multisine has many thousands of them.
MOST_TURNS = 200
#: Loops count as having one size if all swings exceed this fraction of the range.
ONE_SIZE = 0.95


class SlowGain(NamedTuple):
    """Gain of slow movement."""

    gain: float  #: gain, deviation: In the output's unit per input's unit.
    deviation: float
    highest: float  #: Upper end of the band in which the gain was determined [Hz].

    @property
    def certain(self) -> bool:
        """Whether the sign of the gain is certain."""
        return abs(self.gain) > CERTAIN * self.deviation


def slow_gain(u, y, sample_time: float) -> SlowGain:
    """Return the gain of the slowest movement with a certain sign, or else the gain of all movement.

    Units: ``sample_time`` [s].
    """
    window = np.hanning(len(u))
    # the window correlates neighbouring lines, which increases the variance of a sum over lines by this factor
    correlated = len(u) * float(np.sum(window**4)) / float(np.sum(window**2)) ** 2
    U, Y = (np.fft.rfft(window * (values - values.mean()))[1:] for values in (u, y))
    power = np.abs(U) ** 2
    first = int(np.searchsorted(np.cumsum(power), FIRST_BAND * power.sum())) + 1
    ends = [*(first * 2 ** np.arange(int(np.log2(len(U) / first)) + 1)).tolist(), len(U)]
    for end in ends:
        size = float(power[:end].sum())
        response = complex(Y[:end] @ np.conj(U[:end])) / size
        late = response.imag**2 * float(power[:end] @ power[:end])  # a lag: in all lines alike, not noise
        left = float(power[:end] @ np.abs(Y[:end] - response * U[:end]) ** 2)
        deviation = np.sqrt(0.5 * (late + correlated * left)) / size
        found = SlowGain(response.real, float(deviation), end / (len(u) * sample_time))
        if found.certain:
            break
    return found


class MeanLoop(NamedTuple):
    """Mean output at levels of the input, on rising and on falling branches; NaN at levels without samples."""

    levels: np.ndarray  #: shape (n,); Middles of the levels, in the input's unit.
    rising: np.ndarray  #: shape (n,); rising, falling: In the output's unit.
    falling: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Mean of both branches, shape (n,); where one branch is missing, the other branch."""
        both = np.stack([self.rising, self.falling])
        count = np.isfinite(both).sum(axis=0)
        return np.where(count > 0, np.nansum(both, axis=0) / np.maximum(count, 1), np.nan)


def mean_loop(u, y, count: int = LEVELS) -> MeanLoop:
    """Return the mean branches of a recording, in ``count`` levels of equal width."""
    edges = np.linspace(u.min(), u.max(), count + 1)
    place = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, count - 1)
    change = np.sign(np.diff(u, append=u[-1]))
    moving = np.flatnonzero(change)
    # samples with a constant input belong to the branch before them
    before = np.maximum(np.searchsorted(moving, np.arange(u.size), side="right") - 1, 0)
    direction = change[moving[before]] if moving.size else np.ones(u.size)
    branches = []
    for sign in (1.0, -1.0):
        there = direction == sign
        samples = np.bincount(place[there], minlength=count)
        sums = np.bincount(place[there], y[there], minlength=count)
        branches.append(np.where(samples > 0, sums / np.maximum(samples, 1), np.nan))
    return MeanLoop(0.5 * (edges[:-1] + edges[1:]), *branches)


def butterfly(u, y) -> float | None:
    """Return the input at which the output of a butterfly reverses; None without a butterfly."""
    v = 2.0 * (u - u.min()) / np.ptp(u) - 1.0
    curve = np.polynomial.Polynomial.fit(v, y, DEGREE, domain=(-1.0, 1.0))
    if float(np.var(y - curve(v))) > (1.0 - EXPLAINED) * float(np.var(y)):
        return None
    grid = np.linspace(-0.9, 0.9, 181)  # a polynomial overshoots at its ends
    steps = np.diff(curve(grid))
    up, down = float(steps[steps > 0.0].sum()), -float(steps[steps < 0.0].sum())
    if min(up, down) < FALLS * max(up, down):
        return None
    values = curve(grid)
    inner = int(np.argmin(values)) if values[0] + values[-1] > 2.0 * values[90] else int(np.argmax(values))
    return float(0.5 * (grid[inner] + 1.0) * np.ptp(u) + u.min())


def level_ends(loop: MeanLoop, stroke: float) -> tuple[tuple[float, bool] | None, ...]:
    """Return, for each end, the input beyond which the output is level (or None), and whether it levels abruptly."""
    found: list[tuple[float, bool] | None] = []
    middle = float(np.nanmax(loop.middle) - np.nanmin(loop.middle)) / loop.levels.size
    for order in (slice(None), slice(None, None, -1)):
        levels, rising, falling = loop.levels[order], loop.rising[order], loop.falling[order]
        count = 0
        while count < levels.size:
            part = np.concatenate([rising[: count + 1], falling[: count + 1]])
            part = part[np.isfinite(part)]
            if part.size and np.ptp(part) > LEVEL * stroke:
                break
            count += 1
        if not FEWEST_LEVELS <= count < levels.size - FEWEST_LEVELS:
            found.append(None)
            continue
        beyond = slice(count - 1, count + FEWEST_LEVELS)
        steepness = max(abs(float(branch[beyond][-1] - branch[beyond][0])) for branch in (rising, falling))
        abrupt = steepness / FEWEST_LEVELS >= ABRUPT * middle
        found.append((float(0.5 * (levels[count - 1] + levels[count])), bool(abrupt)))
    return tuple(found)


@dataclass(frozen=True)
class RecordingSummary:
    """What a recording shows before any fit."""

    #: Label and text of each line.
    lines: tuple[tuple[str, str], ...]
    #: Reason why no model fits; empty if a model may fit.
    refusal: str = ""
    #: Inputs, in their unit, below and above which the output is level after an abrupt change; None: no such input.
    saturation: tuple[float | None, float | None] = (None, None)
    #: Sentences about saturation at an end of the loop, and about a dead zone.
    shapes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the lines as one text."""
        width = max(len(label) for label, _ in self.lines)
        return "\n".join(f"{label:<{width}}  {text}" for label, text in self.lines)


def white_noise(values) -> float:
    """Return the standard deviation of white noise, from the median of second differences (outliers do not count)."""
    # white noise of variance s² has second differences of variance 6 s²
    return float(np.median(np.abs(np.diff(values, 2)))) / 0.6745 / np.sqrt(6.0)


def summarise(data: IdentificationData, report: DataReport | None = None) -> RecordingSummary:
    """Return the summary of checked data."""
    u, y, step = data.input, data.output, data.sample_time
    report = data.checked()[1] if report is None else report
    loop, turns = mean_loop(u, y), turning_points(u)
    turn, gain = butterfly(u, y), slow_gain(u, y, step)
    ends = level_ends(loop, data.stroke)
    clipped = report.clipped_output > 0.0
    saturation = tuple(end[0] if end and end[1] and not clipped else None for end in ends)
    shapes = _shapes(loop)
    last = int(turns[min(len(turns) - 1, MOST_TURNS)]) + 1
    width = 100.0 * (loop_opening(u[:last], y[:last]) or 0.0) / data.stroke
    moved = data.output_unit
    stamps = f"; stamps off by up to {readable(report.jitter, 's')}" if report.jitter > UNEVEN * step else ""
    noise = white_noise(y)
    lines = [
        ("recording", f"{data.source or 'arrays'}: {len(data)} samples every {readable(step, 's')}, "
                      f"{readable(len(data) * step, 's')}{stamps}"),
        ("input", f"{bare_name(data.input_name)}: {_span(u, data.input_unit)}"),
        ("output", f"{bare_name(data.output_name)}: {_span(y, moved)}, noise about {readable(noise, moved)} RMS"),
        ("units", _found(report, "unit") or "likely"),
        ("direction", _direction(data, turn, gain)),
        ("shape", ", ".join((f"loops up to {width:.2g} % of the stroke wide", *shapes))),
        ("saturation", _saturation(data, report, saturation)),
        ("drift", _drift(report.drift, moved)),
        ("repetition", _repetition(u, turns)),
        ("content", _content(data)),
    ]  # fmt: skip
    return RecordingSummary(tuple(lines), _refusal(data, turn, gain), (saturation[0], saturation[1]), shapes)


def _span(values, unit: str) -> str:
    return f"{readable(float(values.min()), unit)} … {readable(float(values.max()), unit)}"


def _found(report: DataReport, check: str) -> str:
    return "; ".join(item.message for item in report.findings if item.check == check)


def _drift(drift: float, unit: str) -> str:
    if np.isnan(drift):
        return "not known before the fit: the size of the loops changes all the time"
    return f"{readable(drift, unit)} over the recording" if drift else "none seen"


def _direction(data: IdentificationData, turn: float | None, gain: SlowGain) -> str:
    slope = f"{readable(gain.gain, data.output_unit)}/{data.input_unit} below {readable(gain.highest, 'Hz')}"
    if turn is not None:
        return f"turns at an input of {readable(turn, data.input_unit)}"
    if not gain.certain:
        return f"not certain ({slope} ± {readable(gain.deviation, data.output_unit)})"
    return f"the output {'rises' if gain.gain > 0.0 else 'falls'} with the input, {slope}"


def _shapes(loop: MeanLoop) -> tuple[str, ...]:
    """Return sentences about saturation and a dead zone in the mean branches."""
    middle = loop.middle[np.isfinite(loop.middle)]
    if middle.size < LEVELS // 2:
        return ()
    tenth, quarter = middle.size // 10, middle.size // 4
    slopes = np.abs(middle[tenth:] - middle[:-tenth])
    flat = slopes < FLAT * slopes.max()
    found = [f"saturates at the {end} end" for end, there in (("lower", flat[0]), ("upper", flat[-1])) if there]
    inside = np.flatnonzero(flat[quarter:-quarter]) + quarter
    if inside.size and min(slopes[: inside[0]].max(), slopes[inside[-1] :].max()) > 0.5 * slopes.max():
        found.append("has a dead zone")
    return tuple(found)


def _saturation(data: IdentificationData, report: DataReport, ends) -> str:
    words = []
    for role, share in (("input", report.clipped_input), ("output", report.clipped_output)):
        if share > 0.0:
            omitted = " (left out of the fit)" if role == "output" else ""
            words.append(f"{role} clipped in {100.0 * share:.2g} % of the samples{omitted}")
    for side, end in zip(("below", "above"), ends, strict=True):
        if end is not None:
            words.append(f"the output stays level {side} an input of {readable(end, data.input_unit)}")
    return "; ".join(words) or "none seen"


def _repetition(u, turns) -> str:
    swings = np.abs(np.diff(u[turns])) / np.ptp(u)
    inner = swings[1:-1]
    if not inner.size:
        return "the input never turns twice: no loop"
    sizes = "all of one size" if inner.min() > ONE_SIZE else f"of {100.0 * inner.min():.2g} … 100 % of the range"
    return f"{len(turns) - 2} reversals, swings {sizes}"


def _content(data: IdentificationData) -> str:
    power = np.abs(np.fft.rfft((data.input - data.input.mean()) * np.hanning(len(data)))) ** 2
    whole = np.cumsum(power) / power.sum()
    line = 1.0 / (len(data) * data.sample_time)
    most = float(np.searchsorted(whole, 0.99)) * line
    high = [highest_frequency(values, data.sample_time) for values in (data.input, data.output)]
    text = f"99 % of the input's power below {readable(most, 'Hz')}"
    reach = [readable(value, "Hz") if value else "no frequency" for value in high]
    return f"{text}; above the noise up to {reach[0]} (input), {reach[1]} (output)"


def _refusal(data: IdentificationData, turn: float | None, gain: SlowGain) -> str:
    if turn is not None:
        where = readable(turn, data.input_unit)
        return (
            f"the output {data.output_name} has a butterfly loop: it reverses at an input of {where}, and no model "
            f"with an inverse describes both sides; {_closest(data, turn)}"
        )
    return _falling(data, gain)


#: Number of plays of a trial fit.
TRIED_PLAYS = 10
#: Number of dead zones of a trial fit.
TRIED_ZONES = 3
#: Least number of samples to which a recording is condensed for a trial fit.
COARSE = 1500


def trial_error(data: IdentificationData, limits: tuple[float, float] = (-np.inf, np.inf)) -> float:
    """Return the RMS residual [% of the stroke] of plays and dead zones on coarse data; NaN if they cannot be fitted.

    The input is limited to ``limits`` before the fit.
    """
    u = np.clip(data.input, *limits)
    try:
        coarse = condense(u, data.output, data.sample_time, enough=COARSE)
        rms = FreeWeights(coarse, TRIED_PLAYS, TRIED_ZONES).behind(LinearPart()).rms
    except HysteresisError:
        return float("nan")
    return 100.0 * rms / data.stroke


def _closest(data: IdentificationData, turn: float) -> str:
    """Return a sentence about the model that describes a butterfly best, and its error."""
    whole = trial_error(data)
    low, high = (readable(float(end), data.input_unit) for end in (data.input.min(), data.input.max()))
    at = readable(turn, data.input_unit)
    return (
        f"closest is prandtl_ishlinskii, with an RMS error of about {whole:.2g} % of the stroke; it describes one "
        f"side: record between {at} and {high}, or between {low} and {at} (one of the two ranges with --negate)"
    )


def _falling(data: IdentificationData, gain: SlowGain) -> str:
    """Return the reason for refusing an output that falls with rising input; empty if it does not fall."""
    if not gain.certain or gain.gain > 0.0:
        return ""
    size, deviation = (readable(value, data.output_unit) for value in (-gain.gain, gain.deviation))
    return (
        f"the output {data.output_name} falls with rising input {data.input_name}, by {size}/{data.input_unit} "
        f"(± {deviation}) below {readable(gain.highest, 'Hz')}; invert it (--negate), or check "
        "that the columns belong together"
    )


def refuse_falling(data: IdentificationData) -> None:
    """Raise IdentificationError for an output that falls with rising input, because no model here describes it."""
    if reason := _falling(data, slow_gain(data.input, data.output, data.sample_time)):
        raise IdentificationError(reason)


def refuse(summary: RecordingSummary) -> None:
    """Raise IdentificationError if no model fits the recording."""
    if summary.refusal:
        raise IdentificationError(summary.refusal)
