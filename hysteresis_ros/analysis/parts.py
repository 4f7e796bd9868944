# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parts of a run (steps and holds, approach, scan, path, shutdown), the figures that apply to each, and excerpts.

In a scan the reference equals itself one period later, within 5 % of its range; all samples are compared. Steps lead
from one hold to another. A single move into a scan is the approach to this scan; any other motion is a path. While the
axis is stopped, its voltage goes to the safe value and the axis does not follow the reference, so a shutdown has no
figures.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening, turning_points
from hysteresis_ros.signals import MODE_STALE, MODE_STOPPED, MODE_TRIPPED
from hysteresis_ros.units import quantity

#: Minimum length of a hold, in which the reference is constant [samples].
HOLD_SAMPLES = 10
#: The final value is the mean over the last part of a hold: this fraction of it.
FINAL_PART = 0.1
#: An axis counts as having left its hold if its error exceeds this fraction of the stroke.
LEFT = 0.1
#: The reference jumps if its movement per sample changes by more than this fraction of its stroke.
JUMP = 0.01
#: An extremum of the reference is a reversal if the reference moves back from it by at least this fraction of its
#: stroke.
REVERSAL = 0.1
#: Half width of the settling band, as a fraction of the step.
SETTLING_BAND = 0.02


@dataclass(frozen=True)
class Hold:
    """Samples ``start`` to ``stop`` (exclusive) in which the reference is constant at ``level`` [m]."""

    start: int
    stop: int
    level: float

    @property
    def final(self) -> slice:
        """The last tenth of the hold, at least one sample."""
        length = max(1, int(round((self.stop - self.start) * FINAL_PART)))
        return slice(self.stop - length, self.stop)


@dataclass(frozen=True)
class StepResponse:
    """The response to one step."""

    start: float  #: Time at which the reference began to move [s].
    size: float  #: Step of the reference, signed [m].
    final: float  #: Value finally reached: mean displacement over the last tenth of the hold [m].
    #: Overshoot beyond ``final`` in the direction of the step, as a fraction of the step's ``|size|``; at least 0.
    overshoot: float
    #: Settling time: from ``start`` until the displacement stays within ±2 % of ``|size|`` around ``final``; None if it
    #: has not settled before the last tenth of the hold.
    settling_time: float | None
    steady_state_error: float  #: ``reference - final`` [m].


def find_holds(reference) -> list[Hold]:
    """Return the holds of a reference, shape (N,) [m]."""
    reference = np.asarray(reference, dtype=np.float64)
    if reference.size < HOLD_SAMPLES:
        return []
    moving = np.diff(reference) != 0.0
    edges = np.concatenate(([0], np.flatnonzero(moving | np.isnan(np.diff(reference))) + 1, [reference.size]))
    long = np.flatnonzero(np.diff(edges) >= HOLD_SAMPLES)
    return [
        Hold(start, end, float(reference[start])) for start, end in edges[np.stack([long, long + 1], axis=1)].tolist()
    ]


def scan_start(reference, displacement) -> int:
    """Return the sample from which errors of a scan count: a reversal if the scan begins with a jump, else 0.

    A scan may begin far from the position of the axis at rest; the error before the axis follows does not describe the
    tracking of the scan. The axis begins to follow at the first reversal for which all errors up to the next reversal
    are smaller than the jump. All later errors must be smaller than the jump, or than half of the largest earlier
    error. If they are not, or if the reference has more than one hold, all samples count.

    Units: ``reference`` [m], ``displacement`` [m].
    """
    points = turning_points(reference, REVERSAL)
    if len(points) < 3 or len(find_holds(reference)) > 1:
        return 0
    begins = int(np.argmax(reference != reference[0]))
    error = np.abs(reference - displacement)
    jump = max(error[0], error[begins])
    between = np.maximum.reduceat(error, points[:-1])
    calm = np.flatnonzero(between[1:] < jump)
    if not calm.size or jump <= JUMP * np.ptp(reference):
        return 0
    first = int(points[1 + calm[0]])
    return first if max(jump, 0.5 * np.max(error[:first])) > np.max(error[first:]) else 0


def step_responses(time, reference, displacement) -> list[StepResponse]:
    """Return the responses to all steps between consecutive holds of the reference at different levels.

    A step may be a jump or a move of limited velocity. Its time begins at the sample of the jump, or at the last sample
    of the hold before the move.

    Units: ``time`` [s], ``reference`` [m], ``displacement`` [m].
    """
    holds = [hold for hold in find_holds(reference) if np.isfinite(hold.level)]
    responses = []
    for before, after in zip(holds[:-1], holds[1:], strict=True):
        size = after.level - before.level
        if size == 0.0:
            continue
        # a jump at sample k acts from time[k] on; a move of limited velocity begins with the last sample of the hold
        first = after.start if after.start == before.stop else before.stop - 1
        answer = displacement[first : after.stop]
        if not np.all(np.isfinite(answer)):
            continue
        final = float(np.mean(displacement[after.final]))
        overshoot = max(0.0, float(np.max((answer - final) * np.sign(size))) / abs(size))
        outside = np.flatnonzero(np.abs(answer - final) > SETTLING_BAND * abs(size))
        settled = int(outside[-1]) + 1 if outside.size else 0
        inside_before_final = first + settled <= after.final.start
        responses.append(
            StepResponse(
                start=float(time[first]),
                size=size,
                final=final,
                overshoot=overshoot,
                settling_time=float(time[first + settled] - time[first]) if inside_before_final else None,
                steady_state_error=after.level - final,
            )
        )
    return responses


#: Largest difference between a repeating reference and itself one period later, as a fraction of its range; also the
#: largest difference between its periods, as a fraction of a period.
EQUAL = 0.05
#: Larger differences count only if more than this number of consecutive samples differ. The lengths of the periods may
#: always differ by this number of samples.
JITTER = 2
#: Part of another period that must follow the first period of a repeating reference, as a fraction of the period.
EVIDENCE = 0.45
#: Largest number of reversals in a period.
REVERSALS = 40
#: Mode signals from which a stop of the axis is detected.
MODES = ("plant_mode", "compensator_mode", "controller_mode")


class Kind(enum.StrEnum):
    """Kind of a part of a run."""

    APPROACH = "approach"
    STEPS = "steps"
    SCAN = "scan"
    PATH = "path"
    HOLD = "hold"
    SHUTDOWN = "shutdown"


#: Figures of each kind of part, in order; they are defined in :func:`hysteresis_ros.analysis.metrics.compute_metrics`.
JUDGED_BY = {
    Kind.APPROACH: (),
    Kind.STEPS: ("overshoot_percent", "settling_time_s", "steady_state_error_m"),
    Kind.SCAN: (
        *("rms_error_m", "rms_error_percent_of_stroke", "max_error_m", "max_error_percent_of_stroke"),
        "loop_width_percent",
    ),
    Kind.PATH: ("rms_error_m", "rms_error_percent_of_stroke", "max_error_m", "max_error_percent_of_stroke"),
    Kind.HOLD: ("rms_error_m", "max_error_m"),
    Kind.SHUTDOWN: (),
}
#: Kinds of parts without figures, and the reason.
NOT_JUDGED = {
    Kind.APPROACH: "not evaluated: it only leads to the next part",
    Kind.SHUTDOWN: "not evaluated: the axis is stopped, and its voltage goes to the safe value",
}


@dataclass(frozen=True)
class Part:
    """A part of a run of one kind: samples ``start`` to ``stop`` (exclusive).

    ``ends`` are the samples at which whole periods begin and end; ``moves`` is the number of moves from hold to hold.
    """

    kind: Kind
    start: int
    stop: int
    ends: tuple[int, ...] = ()
    moves: int = 1

    def moved(self, by: int) -> Part:
        """Return this part with its sample numbers increased by ``by``."""
        return replace(self, start=self.start + by, stop=self.stop + by, ends=tuple(end + by for end in self.ends))


def stopped(recording: Recording) -> np.ndarray:
    """Return whether the axis is stopped at each sample, shape (N,).

    A stop is reported by the plant, or by a node between reference and voltage. A node without input also counts as
    stopped if a stop of the axis follows, or if the run ends in that state. Without the signals of these nodes, the
    recorded stop and start requests are used. If those are missing too (:func:`stop_is_recorded`), the stop is detected
    from reference, displacement and voltage.
    """
    said = [recording[name] for name in MODES if recording.has(name)]
    tripped = np.nan_to_num(recording["tripped"]) != 0.0 if recording.has("tripped") else np.zeros(0, dtype=bool)
    if not stop_is_recorded(recording):
        return _left_its_hold(recording)
    if not said and not tripped.size:
        return _stopped_by_changes(recording)
    certain = tripped if tripped.size else np.zeros(len(recording), dtype=bool)
    safe = certain.copy()
    for mode in said:
        certain |= (mode == MODE_STOPPED) | (mode == MODE_TRIPPED)
        safe |= mode == MODE_STALE
    safe |= certain
    edges = np.flatnonzero(np.diff(np.concatenate(([False], safe, [False]))))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if last < safe.size and not certain[first:last].any():
            safe[first:last] = False
    return safe


def stop_is_recorded(recording: Recording) -> bool:
    """Return whether the recording contains information about stops: recordings of nodes contain it, tables do not."""
    return any(map(recording.has, (*MODES, "tripped"))) or "changes" in recording.metadata


def _left_its_hold(recording: Recording) -> np.ndarray:
    """Return the samples in which the voltage leaves a settled hold for another constant value, at constant reference.

    A running closed loop does not leave the hold, and a running open loop keeps its voltage. So such a motion at the
    end is a shutdown.
    """
    found = np.zeros(len(recording), dtype=bool)
    if len(recording) < 2 or not all(map(recording.has, ("reference", "voltage", "displacement"))):
        return found
    reference, voltage = recording["reference"], recording["voltage"]
    stroke = float(np.nanmax(reference) - np.nanmin(reference))
    held = int(np.max(np.flatnonzero(np.diff(reference)), initial=-1)) + 1
    constant = int(np.max(np.flatnonzero(np.diff(voltage)), initial=-1)) + 1
    if found.size - constant < HOLD_SAMPLES or constant <= held:
        return found
    away = np.abs(voltage[held : constant + 1] - voltage[-1])
    left = held + int(np.max(np.flatnonzero(np.diff(away) >= 0.0), initial=0)) + 1
    error = np.abs(reference - recording["displacement"])
    if left - held < HOLD_SAMPLES or not np.nanmedian(error[left - HOLD_SAMPLES : left]) <= SETTLING_BAND * stroke:
        return found
    if np.nanmedian(error[constant:]) > LEFT * stroke:
        found[left:] = True
    return found


def _stopped_by_changes(recording: Recording) -> np.ndarray:
    found = np.zeros(len(recording), dtype=bool)
    if len(recording) < 2:
        return found
    since = recording.time - float(recording.metadata.get("first_s", recording.time[0]))
    numbers = np.rint(since / recording.sample_time)
    changes = [change for change in recording.metadata.get("changes") or () if change.get("node") == "plant_simulator"]
    for change in sorted(changes, key=lambda change: change.get("sample", 0)):
        if change.get("action") in ("stop", "halt", "start"):
            found[numbers >= change.get("sample", 0)] = change["action"] != "start"
    return found


def find_parts(reference, displacement=None, off=None, time=None) -> list[Part]:
    """Return the parts of a run in order; together they cover the whole run.

    With ``time``, missing samples are interpolated first; without them a periodic reference would not equal
    itself one period later.

    Units: ``reference`` [m], ``displacement`` [m], ``time`` [s].
    """
    intervals = np.zeros(0) if time is None or len(time) < 2 else np.diff(time)
    # computed here, because Recording.sample_numbers refuses a recording with a long pause
    steps = np.maximum(np.rint(intervals / np.median(intervals)), 1.0) if intervals.size else intervals
    if intervals.size < np.sum(steps) < 2 * intervals.size:
        numbers = np.concatenate([[0], np.cumsum(steps.astype(np.int64))])
        every = np.arange(numbers[-1] + 1)
        before = np.searchsorted(numbers, every, side="right") - 1
        whole, moved = (None if one is None else np.interp(every, numbers, one) for one in (reference, displacement))
        found = find_parts(whole, moved, None if off is None else off[before])
        placed = [
            replace(part, start=start, stop=stop, ends=tuple(np.searchsorted(numbers, part.ends).tolist()))
            for part in found
            for start, stop in [np.searchsorted(numbers, [part.start, part.stop]).tolist()]
        ]
        return [part for part in placed if part.stop > part.start]
    reference = np.asarray(reference, dtype=np.float64)
    off = np.zeros(reference.size, dtype=bool) if off is None else off
    edges = [0, *(np.flatnonzero(np.diff(off)) + 1).tolist(), reference.size]
    parts: list[Part] = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if last > first and off[first]:
            parts.append(Part(Kind.SHUTDOWN, first, last))
        elif last > first:
            own = [part.moved(first) for part in _running(reference[first:last])]
            parts += own if displacement is None else _jumped(own, reference, displacement)
    return parts


def _jumped(parts: list[Part], reference, displacement) -> list[Part]:
    """Separate the approach from a scan, path or hold that begins with a jump.

    The approach lasts until the axis follows (:func:`scan_start`), or until it has settled in the hold.
    """
    if parts[0].kind is Kind.HOLD:
        inside = slice(parts[0].start, parts[0].stop)
        error = np.abs(reference[inside] - displacement[inside])
        far = np.flatnonzero(error > SETTLING_BAND * error[0])
        stroke = max(float(np.ptp(reference)), float(np.ptp(displacement)))
        if error[0] > JUMP * stroke and error[0] >= np.max(error[error.size // 2 :]) and far[-1] + 1 < error.size:
            settled = parts[0].start + int(far[-1]) + 1
            return [Part(Kind.APPROACH, parts[0].start, settled), replace(parts[0], start=settled), *parts[1:]]
    for number, part in enumerate(parts):
        if part.kind in (Kind.SCAN, Kind.PATH) and all(before.kind is Kind.HOLD for before in parts[:number]):
            inside = slice(part.start, part.stop)
            first = part.start + scan_start(reference[inside], displacement[inside])
            if first > part.start:
                ends = tuple(end for end in part.ends if end >= first)
                split = [Part(Kind.APPROACH, part.start, first), replace(part, start=first, ends=ends)]
                return [*parts[:number], *split, *parts[number + 1 :]]
    return parts


def _running(reference) -> list[Part]:
    """Return the parts of a run in which the axis follows its reference."""
    moving = np.flatnonzero(np.diff(reference))
    if not moving.size:
        return [Part(Kind.HOLD, 0, reference.size)]
    first, last = int(moving[0]) + 1, int(moving[-1]) + 2
    found = _repeating(reference, 0 if first < HOLD_SAMPLES else first - 1, min(last, reference.size))
    if found is None:
        return _joined(_between_holds(reference))
    holds = find_holds(reference[found.start : found.stop])
    if sum(hold.stop - hold.start for hold in holds) > 0.5 * (found.stop - found.start):
        # repeating steps include the holds before and after them
        stop = max((hold.stop for hold in find_holds(reference) if hold.start <= found.stop), default=found.stop)
        stop = max(stop, found.stop)
        found = replace(found, kind=Kind.STEPS, moves=len(holds), start=_with_hold(reference, found.start), stop=stop)
    if reference.size - found.stop < HOLD_SAMPLES:
        found = replace(found, stop=reference.size)
    before = _running(reference[: found.start]) if found.start else []
    after = _running(reference[found.stop :]) if found.stop < reference.size else []
    return _joined([*before, found, *(part.moved(found.stop) for part in after)])


def _with_hold(reference, start: int) -> int:
    """Return the start of a part, moved back so that the part includes the end of the hold before it."""
    held = next((hold for hold in find_holds(reference) if hold.start <= start <= hold.stop), None)
    return start if held is None else max(min(start, held.stop) - HOLD_SAMPLES, held.start)


def _repeating(reference, first: int, last: int) -> Part | None:
    """Return the longest interval from ``first`` to ``last`` in which the reference equals itself one period later."""
    points = turning_points(reference[first:last], REVERSAL)[1:-1] + first
    size = EQUAL * float(np.ptp(reference[first:last]))
    # the first reversal may belong to the approach, the last one or two to the return to rest
    counts = range(2, min(points.size, REVERSALS + 1), 2)
    for reversals, skipped, tail in ((n, i, j) for n in counts for i in range(2) for j in range(3)):
        ends = points[: points.size - tail][::-1][::reversals][::-1][skipped:]
        if ends.size < 2:
            continue
        periods = np.diff(ends)
        period = round(float(np.median(periods)))
        if np.ptp(periods) > max(EQUAL * period, JITTER):
            continue
        unlike = np.abs(reference[first + period : last] - reference[first : last - period]) > size
        # a jump between two samples causes a difference in one or two samples
        unlike[JITTER:] &= unlike[1 : unlike.size - JITTER + 1] & unlike[: unlike.size - JITTER]
        begin, end = int(ends[0]) - first, max(int(ends[-1]) - first - period, int(ends[0]) - first + 1)
        if end > unlike.size or unlike[begin:end].any():
            continue
        before, after = np.flatnonzero(unlike[:begin]), np.flatnonzero(unlike[end:])
        start = int(before[-1]) + 1 if before.size else 0
        stop = end + int(after[0]) if after.size else unlike.size
        if stop - start < EVIDENCE * period:
            continue
        begin, end = first + start, first + stop + period
        near = round(EQUAL * period) + JITTER
        begin, end = (first if begin - first <= near else begin), (last if last - end <= near else end)
        return Part(Kind.SCAN, begin, end, tuple(int(k) for k in ends if begin <= k < end))
    return None


def _between_holds(reference) -> list[Part]:
    """Return the parts of a reference that does not repeat: its holds, and the motions between them."""
    holds = find_holds(reference)
    if not holds or holds[0].start > 0:
        holds = [Hold(0, 0, float(reference[0])), *holds]
    if holds[-1].stop < reference.size:
        holds = [*holds, Hold(reference.size, reference.size, float(reference[-1]))]
    parts = [Part(Kind.HOLD, holds[0].start, holds[0].stop)] if holds[0].stop else []
    for before, after in zip(holds[:-1], holds[1:], strict=True):
        first, last = before.stop, after.start
        moves = reference[max(first - 1, 0) : min(last + 1, reference.size)]
        single = len(turning_points(moves, REVERSAL)) <= 2 or last - first <= HOLD_SAMPLES
        if single and before.stop > before.start and after.stop > after.start:
            parts.append(Part(Kind.STEPS, first, after.stop))
            continue
        scan = None if single else _repeating(reference, first, last)
        if scan is None:
            parts.append(Part(Kind.PATH, first, last))
        else:
            parts += [
                Part(Kind.PATH, first, scan.start),
                scan,
                Part(Kind.PATH, scan.stop, last),
            ]
        parts.append(Part(Kind.HOLD, after.start, after.stop))
    parts = [part for part in parts if part.stop > part.start]
    return [
        replace(part, start=_with_hold(reference, part.start)) if part.kind is Kind.STEPS else part for part in parts
    ]


def _joined(parts: list[Part]) -> list[Part]:
    """Join consecutive steps and the end of the hold before them, and mark a single move into a scan as approach."""
    joined: list[Part] = []
    for part in parts:
        if joined and part.kind is Kind.STEPS:
            last = joined[-1]
            if last.kind is Kind.STEPS and not last.ends and not part.ends:
                joined[-1] = replace(last, stop=part.stop, moves=last.moves + part.moves)
                continue
            if last.kind is Kind.HOLD and last.stop > part.start:
                joined[-1] = replace(last, stop=part.start)
                if joined[-1].stop <= joined[-1].start + 1:
                    part = replace(part, start=last.start)
                    joined.pop()
            elif last.stop > part.start:
                part = replace(part, start=last.stop)
        joined.append(part)
    for number, (part, following) in enumerate(zip(joined[:-1], joined[1:], strict=True)):
        if following.kind is Kind.SCAN and part.kind in (Kind.STEPS, Kind.PATH) and part.moves == 1:
            joined[number] = replace(part, kind=Kind.APPROACH)
    return joined


def part_figures(part: Part, time, reference, displacement, stroke: float, against: str = "") -> dict:
    """Return the figures of merit of a part, the number of its steps, and the number of its whole periods.

    The errors and the loop width of a periodic part are computed over its whole periods. ``against`` names the
    reference of the errors; it is empty without a preview.
    """
    found: dict = dict.fromkeys(JUDGED_BY[part.kind])
    inside = slice(part.start, part.stop)
    if part.kind is Kind.STEPS:
        found |= step_figures(time[inside], reference[inside], displacement[inside])
    if part.ends[1:]:
        period = (time[part.ends[-1]] - time[part.ends[0]]) / (len(part.ends) - 1)
        found |= {"periods": len(part.ends) - 1, "period_s": float(period)}
        inside = slice(part.ends[0], part.ends[-1])
    if "rms_error_m" in found:
        error = np.abs(reference[inside] - displacement[inside])
        found |= {"rms_error_m": float(np.sqrt(np.mean(error**2))), "max_error_m": float(np.max(error))}
        for name in ("rms", "max"):
            if f"{name}_error_percent_of_stroke" in found and stroke > 0.0:
                found[f"{name}_error_percent_of_stroke"] = 100.0 * found[f"{name}_error_m"] / stroke
        found |= {"against": against} if against else {}
    if "loop_width_percent" in found:
        opening = loop_opening(reference[inside], displacement[inside])
        found["loop_width_percent"] = None if opening is None else 100.0 * opening / stroke
    return found


def step_figures(time, reference, displacement) -> dict:
    """Return the worst figures of the steps of a part, and the numbers of all steps and of those that do not settle."""
    responses = step_responses(time, reference, displacement)
    found: dict = {"steps": len(responses)}
    if responses:
        times = [response.settling_time for response in responses]
        found["unsettled"] = sum(value is None for value in times)
        found["overshoot_percent"] = 100.0 * max(response.overshoot for response in responses)
        found["settling_time_s"] = None if found["unsettled"] else max(value for value in times if value is not None)
        found["steady_state_error_m"] = max(abs(response.steady_state_error) for response in responses)
    return found


#: A span is disturbed if its median squared error exceeds that of undisturbed samples by more than this fraction.
EXCESS = 0.1
#: Smallest fraction of the samples with an error that must remain for the comparison.
COMPARED = 0.1
#: Shortest disturbed span [samples], because a voltage acts only after the delay of the axis.
SHORTEST_SPAN = 4


def disturbed(skipped, error) -> np.ndarray:
    """Return which samples are disturbed: skipped samples, and the samples after them until the effect has decayed.

    ``skipped`` is a flag for each sample, shape (N,); ``error`` [m], shape (N,), is NaN where it does not count, for
    example without a measurement. All spans after skipped samples have the same length n: the shortest of 4, 8, 16, …
    samples after which the error has decayed. It has decayed if the median squared error in the n samples after the
    spans exceeds that of all samples outside both by at most the fraction :data:`EXCESS`. A mean would often be
    determined by the start of the run, far from the skipped samples.
    """
    places = np.flatnonzero(skipped)
    number, square, counted = np.arange(len(error)), np.square(error), np.isfinite(error)
    if not places.size:
        return np.zeros(number.size, dtype=bool)
    last = np.searchsorted(places, number, side="right") - 1
    since = np.where(last < 0, number.size, number - places[last])
    length = SHORTEST_SPAN
    while True:
        following, apart = counted & (since >= length) & (since < 2 * length), counted & (since >= 2 * length)
        if np.sum(apart) < COMPARED * np.sum(counted) or not np.any(following):
            break
        if np.median(square[following]) <= (1.0 + EXCESS) * np.median(square[apart]):
            break
        length *= 2
    return since < length


def seconds(text: str, option: str) -> float:
    """Return a time within the run [s] from a text or number."""
    try:
        value, unit = quantity(text)
        if unit not in ("", "s") or value < 0.0:
            raise ValueError("must be a time ≥ 0 s")
    except ValueError as error:
        raise RecordingError(f"{option} {text}: {error}; write e.g. 0.5 or 500ms") from None
    return value


def within(recording: Recording, first: float, last: float) -> Recording:
    """Return the recording between two times.

    Units: ``first`` [s], ``last`` [s].
    """
    time = recording.time - recording.time[0]
    chosen = (time >= first - 1e-9) & (time <= last + 1e-9)
    if np.count_nonzero(chosen) < 2:
        raise RecordingError(f"fewer than two samples from {first:g} s to {last:g} s: the run lasts {time[-1]:g} s")
    if np.all(chosen):
        return recording
    note = f"judged from {time[chosen][0]:.6g} s to {time[chosen][-1]:.6g} s of {time[-1]:.6g} s"
    metadata = {**recording.metadata, "notes": [*recording.notes, note]}
    metadata.setdefault("first_s", float(recording.time[0]))
    if not chosen[0]:
        # with a preview, the reference before the excerpt may differ from the first one in the excerpt
        metadata["excerpt"] = True
    signals = {name: values[chosen] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[chosen], signals=signals, metadata=metadata)


def period_ends(recording: Recording) -> np.ndarray:
    """Return the boundaries of the P whole periods of the reference, the latest first, shape (P + 1,) [s].

    The periods belong to the longest periodic part of the run; the result is empty if no part is periodic.

    Times count from the first sample.
    """
    time, reference = recording.time - recording.time[0], recording["reference"]
    finite = np.flatnonzero(np.isfinite(reference))
    found = find_parts(reference[finite], off=stopped(recording)[finite], time=time[finite])
    parts = [part for part in found if len(part.ends) > 1]
    longest = max(parts, key=lambda part: part.stop - part.start, default=None)
    return time[:0] if longest is None else time[finite[list(longest.ends[::-1])]]


def last_periods(recording: Recording, count: int) -> Recording:
    """Return the last ``count`` periods of a periodic reference, up to the end of its last whole period."""
    ends = period_ends(recording)
    if not ends.size:
        raise RecordingError("--last-periods: the reference is not periodic; choose a part with --range or --skip")
    if count > ends.size - 1:
        raise RecordingError(f"--last-periods {count}: the run has {ends.size - 1} whole periods between reversals")
    # the sample at the end of a period belongs to the next period
    return within(recording, float(ends[count]), float(ends[0]) - 0.5 * recording.sample_time)
