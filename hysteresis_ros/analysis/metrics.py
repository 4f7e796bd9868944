# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of merit of a run in SI units; :func:`compute_metrics` defines each figure.

The recorded configuration determines the reference and the limits used for the figures (:class:`AxisSettings`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.analysis.parts import (
    HOLD_SAMPLES,
    JUMP,
    NOT_JUDGED,
    Kind,
    disturbed,
    find_holds,
    find_parts,
    part_figures,
    scan_start,
    step_figures,
    stop_is_recorded,
    stopped,
)
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.recordings.dataset import LATENESS, Recording
from hysteresis_ros.recordings.loops import loop_opening
from hysteresis_ros.recordings.provenance import configured
from hysteresis_ros.signals import LEAST_DIFFERENCE, MODE_STALE, MODE_TRIPPED
from hysteresis_ros.units import readable


@dataclass(frozen=True)
class AxisSettings:
    """Settings of the axis that determine its figures of merit."""

    #: voltage_minimum, voltage_maximum: Limits of the compensator [V]; without them, the limits of the plant.
    voltage_minimum: float | None = None
    voltage_maximum: float | None = None
    offset: float = 0.0  #: Preload offset W of the controller's model [m]; the reference does not contain it.
    #: preview: Delay with which the axis follows the recorded reference [samples].
    #: learned_preview: feedforward.preview of an axis that learns, and so follows the undelayed reference.
    preview: int = 0
    learned_preview: int = 0

    @property
    def reference(self) -> str:
        """The reference of the errors, in words; empty for an axis without preview."""
        if self.learned_preview:
            return "the undelayed reference"
        return f"the reference delayed by {self.preview} samples" if self.preview else ""


def reference_delay(preview: int, learning: str) -> int:
    """Return the delay [samples] with which an axis follows its reference: its preview, or 0 if it learns.

    ``learning`` is ``learning.type``. Learning removes the error against the undelayed reference.
    """
    return preview if learning == "none" else 0


def axis_settings(recording: Recording) -> AxisSettings:
    """Return the settings in the recorded configuration; missing settings are None or 0."""
    limits = _voltage_limits(recording, "plant_simulator") | _voltage_limits(recording, "hysteresis_compensator")
    controller = _configured(recording, "motion_controller")
    preview = controller.get("feedforward.preview", 0)
    preview = preview if isinstance(preview, int) and not isinstance(preview, bool) and preview > 0 else 0
    late = reference_delay(preview, controller.get("learning.type", "none"))
    return AxisSettings(
        limits.get("minimum"),
        limits.get("maximum"),
        _offset(_group(controller, "model.preload.")),
        late,
        preview - late,
    )


def _configured(recording: Recording, node: str) -> dict:
    """Return the recorded parameters of a node."""
    return configured(recording.configuration, node, str(recording.metadata.get("namespace", "")))


def _voltage_limits(recording: Recording, node: str) -> dict[str, float]:
    """Return ``minimum`` and ``maximum`` of the recorded limits of a node [V], as far as they are numbers."""
    limits = _group(_configured(recording, node), "limits.")
    found = {name: _number(limits.get(name)) for name in ("minimum", "maximum")}
    return {name: value for name, value in found.items() if value is not None}


def judged_reference(recording: Recording, preview: int | None = None) -> np.ndarray:
    """Return the reference with which the displacement is compared, shape (N,) [m].

    With a preview of P samples, this is the recorded reference delayed by P samples, unless the axis learns to follow
    it without delay (:func:`reference_delay`). The reference before the recording is assumed to equal the first
    recorded value. A value is NaN if the sample P samples earlier is missing or not in an excerpt.
    """
    reference, preview = recording["reference"], axis_settings(recording).preview if preview is None else preview
    if not preview or len(reference) < 2:
        return reference
    # shifted by time, because samples may be missing
    numbers = np.rint((recording.time - recording.time[0]) / recording.sample_time).astype(np.int64)
    places = np.minimum(np.searchsorted(numbers, numbers - preview), len(numbers) - 1)
    found = np.where(numbers[places] == numbers - preview, reference[places], np.nan)
    before = np.nan if recording.metadata.get("excerpt") else reference[0]
    return np.where(numbers < preview, before, found)


def delayed(reference, preview: int) -> np.ndarray:
    """Return the reference delayed by ``preview`` samples, which an axis with this preview follows.

    Units: ``reference`` [m].
    """
    if preview == 0:
        return reference
    return np.concatenate([np.full(preview, reference[0]), reference])[: len(reference)]


def lost_offsets(recording: Recording, path) -> list[str]:
    """Return a warning for each axis whose preload offset is not in the file ``path``: a CSV table has no metadata."""
    if not str(path).lower().endswith(".csv"):
        return []
    axes = {f"{name}: ": recording.axis(name) for name in recording.axes} or {"": recording}
    offsets = {name: axis_settings(axis).offset for name, axis in axes.items()}
    return [
        f"{path}: {name}a CSV table does not contain the preload offset of {offset * 1e6:.6g} µm, so a report of it "
        "counts this offset as an error; write .npz or .mcap, which contain it"
        for name, offset in offsets.items()
        if offset
    ]


def _offset(values: dict) -> float:
    if not values:
        return 0.0
    from hysteresis_ros.models.actuator import PreloadParameters

    try:
        return float(PreloadParameters.from_mapping(values).offset)
    except HysteresisError:
        return 0.0


def _group(values: dict, start: str) -> dict:
    return {name[len(start) :]: value for name, value in values.items() if name.startswith(start)}


def _number(value) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


#: Figures that are computed from command and voltage alone.
SMOOTHNESS = {
    "command": ("chattering_m", "chattering_m_s", "command_reversals_hz"),
    "voltage": ("voltage_rate_v_s", "voltage_variation_v"),
}

#: Figures of a fused run in real time, in the form of :data:`FIGURES`.
TIMELINESS = (
    ("lateness_p50_s", "Lateness of a sample, p50", "µs", 1e6),
    ("lateness_p99_s", "Lateness of a sample, p99", "µs", 1e6),
    ("lateness_p999_s", "Lateness of a sample, p99.9", "µs", 1e6),
    ("lateness_max_s", "Lateness of a sample, largest", "µs", 1e6),
    ("skipped_samples", "Skipped samples", "", 1.0),
)

#: All figures in the order of the tables: name, label, displayed unit, factor that converts from the SI unit.
FIGURES = (
    ("rms_error_m", "RMS error", "µm", 1e6),
    ("rms_error_percent_of_stroke", "RMS error", "% of stroke", 1.0),
    ("max_error_m", "Maximum error", "µm", 1e6),
    ("max_error_percent_of_stroke", "Maximum error", "% of stroke", 1.0),
    ("disturbed_percent", "Samples disturbed by skipped samples", "% of samples", 1.0),
    ("undisturbed_rms_error_m", "RMS error without the disturbed samples", "µm", 1e6),
    ("undisturbed_max_error_m", "Maximum error without the disturbed samples", "µm", 1e6),
    ("iae_m_s", "IAE", "µm s", 1e6),
    ("overshoot_percent", "Overshoot", "%", 1.0),
    ("settling_time_s", "Settling time (2 %)", "ms", 1e3),
    ("steady_state_error_m", "Steady-state error", "µm", 1e6),
    ("residual_m", "Residual at zero command", "µm", 1e6),
    ("loop_width_percent", "Loop width, reference → displacement", "%", 1.0),
    ("voltage_loop_width_percent", "Loop width, voltage → displacement", "%", 1.0),
    ("chattering_m", "Chattering of the command", "nm rms", 1e9),
    ("chattering_m_s", "Variation of the command beyond that of the reference", "µm/s", 1e6),
    ("command_reversals_hz", "Reversals of the command", "1/s", 1.0),
    ("voltage_rate_v_s", "Control effort, voltage rate", "V/s rms", 1.0),
    ("voltage_variation_v", "Total variation of the voltage", "V", 1.0),
    ("saturated_percent", "Samples limited by range or slew rate", "% of samples", 1.0),
    ("stroke_m", "Stroke", "µm", 1e6),
    ("steps", "Steps", "", 1.0),
    ("samples", "Samples", "", 1.0),
    ("missing_samples", "Missing samples", "", 1.0),
    ("duration_s", "Duration", "s", 1.0),
    ("sample_rate_hz", "Sample rate (stamps)", "Hz", 1.0),
    ("rate_hz", "Rate reached (clock)", "Hz", 1.0),
    ("jitter_p99_s", "Jitter p99", "ms", 1e3),
    *TIMELINESS,
)


#: Key in the metadata of an axis of a stage: time from which the errors of all its axes count [s].
STAGE_BEGINS = "stage_begins_s"


def stage_axes(recording: Recording, begin: float | None = None) -> dict[str, Recording]:
    """Return the axes of a stage by name; the errors of all of them count from the same time, ``begin`` [s], on.

    By default this is the time at which the last axis begins its scan. So an axis that holds its position is evaluated
    only while the others scan.
    """
    axes = {name: recording.axis(name) for name in recording.axes}
    if begin is None:
        begin = max((_begin(one) for one in axes.values()), default=0.0)
    return {name: replace(one, metadata={**one.metadata, STAGE_BEGINS: begin}) for name, one in axes.items()}


def _begin(recording: Recording) -> float:
    """Return the time from which the errors of a single axis count [s]."""
    begin = recording.time[0]
    if recording.has("reference"):
        run = _tracked(recording, axis_settings(recording))
        run = run.at(np.isfinite(run.reference - run.displacement) & ~stopped(recording))
        start = judged_start(recording, run)[0] if run.time.size else 0
        begin = run.time[start] if start else begin
    return float(begin)


def judged_start(recording: Recording, run: Tracked) -> tuple[int, str]:
    """Return the first sample of ``run`` whose error counts, and a note about it; empty if all samples count.

    ``run`` has the samples of the recording in which the axis runs. In an excerpt all samples count. An axis of a stage
    counts from the time that :func:`stage_axes` gives, if it still runs then; any other axis from the reversal at which
    it follows its scan (:func:`hysteresis_ros.analysis.parts.scan_start`).
    """
    if recording.metadata.get("excerpt"):
        return 0, ""
    begin = recording.metadata.get(STAGE_BEGINS)
    if begin is not None and begin <= run.time[-1]:
        start = int(np.searchsorted(run.time, begin))
        text = "of all axes of the stage are evaluated from {} s on; the beginning of the scan does not count"
    else:
        start = scan_start(run.reference, run.displacement)
        text = "are evaluated from {} s on: the scan begins with a jump, and the axis follows from this reversal on"
    return start, f"errors {text.format(f'{run.time[start]:.4g}')}" if start else ""


def compute_metrics(recording: Recording, settings: AxisSettings | None = None, parts: bool = True) -> dict:
    """Return the figures of merit of a run.

    The error is e = reference - displacement. The displacement is the true displacement minus the preload offset W of
    the controller's model. If it is unknown, as on hardware, the measured displacement is used, and the notes of the
    recording state this. With ``feedforward.preview`` every figure uses the reference delayed by that many samples,
    unless the axis learns: then every figure uses the undelayed reference, and the notes give the RMS error against the
    delayed reference. Samples without reference or displacement do not count. :func:`judged_start` defines from which
    sample on errors are evaluated: the motion into a scan does not count. Errors, steps, loops and the
    residual omit the samples in which the axis is stopped (:func:`hysteresis_ros.analysis.parts.stopped`). Without a
    reference there are no errors, and the stroke is the range of the displacement.

    ======================================= ==========================================================================
    ``rms_error_m``                         √(mean e²)
    ``max_error_m``                         max abs(e)
    ``…_percent_of_stroke``                 the two errors in % of the stroke
    ``stroke_m``                            largest minus smallest reference of the run
    ``iae_m_s``                             ∫ abs(e) dt, trapezoidal
    ``overshoot_percent``                   farthest displacement beyond the value finally reached, in the direction of
                                            the step, in % of the step; the largest of all steps
    ``settling_time_s``                     from the step until the displacement stays within 2 % of the step around
                                            the value finally reached (mean of the last tenth of the hold); the longest
                                            of all steps
    ``steady_state_error_m``                largest abs(reference - value finally reached) of all steps
    ``residual_m``                          displacement at the end (last tenth) of the last hold at zero reference that
                                            follows a motion
    ``loop_width_percent``                  largest width of the loop displacement versus reference, in % of the stroke
    ``voltage_loop_width_percent``          the same, displacement versus voltage
    ``chattering_m``                        rms of (2 u_k - u_(k-1) - u_(k+1)) / 4 of the command u: a if u alternates
                                            by ±a, 0 if u is smooth. Ten samples after each jump of the reference do not
                                            count (jump: its movement per sample changes by over 1 % of the stroke)
    ``chattering_m_s``                      (Σ abs(u_k - u_(k-1)) - Σ abs(r_k - r_(k-1))) / duration, at least 0: the
                                            variation of the command that the reference does not explain
    ``command_reversals_hz``                changes of sign of u_k - u_(k-1) per second (zeros do not count) minus
                                            those of the reference, at least 0
    ``voltage_rate_v_s``                    rms of (V_k - V_(k-1)) / sample time
    ``voltage_variation_v``                 Σ abs(V_k - V_(k-1))
    ``saturated_percent``                   samples in which range or slew rate of the compensator limit the command [%]
    ``steps``, ``samples``, ``duration_s``  number of steps from hold to hold, number of samples, time of the last
                                            sample minus time of the first
    ``missing_samples``                     samples that are not in the recording, or lack a signal in the bag
    ``sample_rate_hz``                      1 / interval between the stamps, missing samples included
    ``rate_hz``                             achieved rate, from the times of reception; the sample rate if the recording
                                            has no such times
    ``jitter_p99_s``                        99th percentile of abs(interval of two receptions - its median)
    ``lateness_p50_s``, ``…p99_s``,         of a fused run: lateness of the samples, percentiles 50, 99 and 99.9,
    ``…p999_s``, ``…max_s``                 and largest
    ``skipped_samples``                     of a fused run: samples that were skipped because their time had passed
    ``disturbed_percent``                   of a fused run: samples from a skipped sample until the error has
                                            decayed (:func:`hysteresis_ros.analysis.parts.disturbed`), in % of the
                                            samples that count for errors
    ``undisturbed_rms_error_m``,            rms and largest error of the other samples; None if no sample or every
    ``undisturbed_max_error_m``             sample is disturbed
    ``parts``                               list of dicts, the parts of the run in order: ``part`` (approach,
                                            steps, scan, path, hold, shutdown), ``from_s``, ``to_s``, the figures that
                                            apply to the part (for a scan: over whole periods), and for a repeating
                                            reference ``periods`` and ``period_s``
    ``notes``                               dict: figure → why it is None or how to read it; ``recording`` → list
    ======================================= ==========================================================================
    """
    notes: dict = {"recording": recording.notes}
    actual = actual_name(recording)
    if actual == "measured":
        notes["recording"] = [
            *notes["recording"],
            "no true displacement: errors are computed from the measured displacement",
        ]
    settings = settings or axis_settings(recording)
    offset = settings.offset
    if offset:
        notes["recording"] = [*notes["recording"], f"preload offset of {offset * 1e6:.6g} µm subtracted"]
    if not recording.has("reference"):
        return _without_reference(recording, recording[actual] - offset, notes)
    tracked = _tracked(recording, settings)
    good = np.isfinite(tracked.reference) & np.isfinite(tracked.displacement)
    if not np.any(good):
        raise RecordingError("no sample of the recording has both reference and displacement")
    notes["recording"] = [*notes["recording"], *_missing_note(recording, np.isfinite(tracked.displacement))]
    figures: dict = {name: None for name, *_ in FIGURES}
    off = stopped(recording)[good]
    time, reference, displacement = tracked = tracked.at(good)
    found = find_parts(reference, displacement, off, time)
    figures["stroke_m"] = stroke = float(np.ptp(reference))
    judged = np.flatnonzero(~off)
    if judged.size:
        running = tracked.at(judged)
        start, since = judged_start(recording, running)
        notes["recording"] = [*notes["recording"], *filter(None, [since])]
        figures.update(_error_figures(running, start, stroke, notes))
        place = np.flatnonzero(good)[judged[start:]]
        notes["recording"] = notes["recording"] + _reference_note(recording, settings, place, actual)
        figures.update(_undisturbed_figures(recording, place, running.at(slice(start, None)), notes))
        figures.update(_step_figures(found, tracked, notes))
        figures.update(_residual_figure(running, stroke, notes))
        driven = recording["voltage"][good][judged] if recording.has("voltage") else None
        figures.update(_loop_figures(running, start, driven, stroke, notes))
    else:
        notes |= {name: NOT_JUDGED[Kind.SHUTDOWN] for name, *_ in FIGURES if name in _JUDGED}
    if judged.size < off.size:
        lost = float(np.sum(np.diff(time)[off[1:]]))
        text = f"errors, steps and loops exclude {lost:.4g} s of shutdown, in which the axis was stopped"
        if not stop_is_recorded(recording):
            text += " (inferred: the voltage left a settled hold and then stayed constant)"
        notes["recording"] = [*notes["recording"], text]
    command, voltage = _signals(recording, good)
    figures.update(chattering_figures(time, reference, command, voltage, notes))
    figures["saturated_percent"] = _saturated(recording, notes)
    figures.update(sampling_figures(recording, notes))
    figures = {name: _plain(value) for name, value in figures.items()} | {"notes": notes}
    if not parts:
        return figures
    each = [
        dict(part=str(part.kind), from_s=float(time[part.start]), to_s=float(time[part.stop - 1]))
        | part_figures(part, time, reference, displacement, stroke, settings.reference)
        for part in found
    ]
    return {"parts": each, **figures}


#: Figures that exclude a shutdown.
_JUDGED = (
    *("rms_error_m", "rms_error_percent_of_stroke", "max_error_m", "max_error_percent_of_stroke", "iae_m_s"),
    *("overshoot_percent", "settling_time_s", "steady_state_error_m", "residual_m"),
    *("loop_width_percent", "voltage_loop_width_percent"),
)


class Tracked(NamedTuple):
    """Time [s], reference [m] and displacement [m] of a run, shape (N,) each."""

    time: np.ndarray
    reference: np.ndarray
    displacement: np.ndarray

    def at(self, which: np.ndarray | slice) -> Tracked:
        """Return the chosen samples."""
        return Tracked(*(values[which] for values in self))


def _tracked(recording: Recording, settings: AxisSettings) -> Tracked:
    """Return the reference and the displacement that a run is evaluated with."""
    displacement = recording[actual_name(recording)] - settings.offset
    return Tracked(recording.time, judged_reference(recording, settings.preview), displacement)


def _residual_figure(run: Tracked, stroke: float, notes: dict) -> dict[str, float]:
    zero = [hold for hold in find_holds(run.reference) if abs(hold.level) <= 1e-9 * stroke]
    zero = [hold for hold in zero if np.any(np.abs(run.reference[: hold.start]) > 1e-9 * stroke)]
    if not zero:
        notes["residual_m"] = "the reference does not return to zero and hold there"
        return {}
    return {"residual_m": float(np.mean(run.displacement[zero[-1].final]))}


def actual_name(recording: Recording) -> str:
    """Return the name of the signal to evaluate: the true displacement or, if it is unknown, the measured one."""
    if recording.has("displacement"):
        return "displacement"
    if recording.has("measured"):
        return "measured"
    there = ", ".join(name for name in recording.signals if recording.has(name)) or "nothing"
    raise RecordingError(f"the recording has no values of 'displacement' or 'measured'; it has {there}")


def _without_reference(recording: Recording, displacement, notes: dict) -> dict:
    """Return the figures of a run without a reference, for example one for an identification."""
    figures: dict = {name: None for name, *_ in FIGURES}
    notes["recording"] = [*notes["recording"], "no reference in the recording: the error is unknown"]
    for name in figures:
        if "error" in name or name in ("iae_m_s", "overshoot_percent", "settling_time_s", "loop_width_percent"):
            notes[name] = "no reference in the recording"
    notes["residual_m"], notes["stroke_m"] = "no reference in the recording", "of the displacement"
    good = np.isfinite(displacement)
    figures["stroke_m"] = float(np.ptp(displacement[good]))
    voltage = recording["voltage"][good] if recording.has("voltage") else None
    moves = voltage is not None and figures["stroke_m"] > 0.0
    opening = loop_opening(voltage, displacement[good]) if moves else None
    if opening is None:
        notes["voltage_loop_width_percent"] = "no reversing voltage in the recording"
    else:
        figures["voltage_loop_width_percent"] = 100.0 * opening / figures["stroke_m"]
    figures.update(chattering_figures(recording.time[good], displacement[good], None, voltage, notes))
    figures["saturated_percent"] = _saturated(recording, notes)
    figures.update(sampling_figures(recording, notes))
    return {"parts": [], **{name: _plain(value) for name, value in figures.items()}, "notes": notes}


def _error_figures(run: Tracked, start: int, stroke: float, notes: dict) -> dict:
    error = (run.reference - run.displacement)[start:]
    figures = {**error_figures(error, stroke), "iae_m_s": absolute_integral(run.time[start:], error)}
    if stroke == 0.0:
        notes |= {
            f"{name}_error_percent_of_stroke": "the reference never moves, so there is no stroke"
            for name in ("rms", "max")
        }
    return figures


def _reference_note(recording: Recording, settings: AxisSettings, place, actual: str) -> list[str]:
    """Return a note that names the reference of the errors at the samples ``place``; empty without a preview."""
    if not settings.reference:
        return []
    text = f"errors are computed from {settings.reference}"
    if not settings.learned_preview:
        return [f"{text} (feedforward.preview)"]
    text += ", which the axis learns to follow"
    late = judged_reference(recording, settings.learned_preview) - (recording[actual] - settings.offset)
    late = late[place][np.isfinite(late[place])]
    if late.size:
        rms = readable(error_figures(late, 0.0)["rms_error_m"], "m")
        text += (
            f"; against the reference delayed by {settings.learned_preview} samples (feedforward.preview) the RMS "
            f"error is {rms}"
        )
    return [text]


def _missing_note(recording: Recording, there) -> list[str]:
    """Return a note about samples without a measurement, except skipped samples; empty if there are no others."""
    skipped = np.nan_to_num(recording["skipped"]) > 0.0 if recording.has("skipped") else np.zeros_like(there)
    absent = np.flatnonzero(~there & ~skipped)
    if not absent.size:
        return []
    seconds = recording.time[absent[0]] - recording.time[0]
    return [
        f"the sensor gave no measurement in {absent.size} of {len(recording)} samples, first at {seconds:.4g} s; no "
        "figure includes these samples"
    ]


def _undisturbed_figures(recording: Recording, place, run: Tracked, notes: dict) -> dict:
    """Return the errors of the undisturbed samples, and the fraction of disturbed samples [%]."""
    if not recording.has("skipped"):
        return {}
    error = run.reference - run.displacement
    whole = np.full(len(recording), np.nan)  # a skipped sample of a device has no measurement, and therefore no error
    whole[place] = error
    skipped = np.nan_to_num(recording["skipped"]) > 0.0
    span = disturbed(skipped, whole)[place]
    share = 100.0 * float(np.mean(span))
    if not np.any(span) or np.all(span):
        why = "every sample is disturbed" if np.any(span) else "no sample was skipped"
        if np.any(skipped) and not np.any(span):
            why = "samples were skipped, but no evaluated sample is disturbed"
        notes |= {f"undisturbed_{name}_error_m": why for name in ("rms", "max")}
        return {"disturbed_percent": share}
    left = error_figures(error[~span], 0.0)
    return {"disturbed_percent": share} | {f"undisturbed_{name}": value for name, value in left.items()}


def error_figures(error, stroke: float) -> dict[str, float]:
    """Return RMS and largest error as defined by :func:`compute_metrics`; percentages are omitted if the stroke is 0.

    Units: ``error`` [m], ``stroke`` [m].
    """
    size = np.abs(error)
    figures = {"rms_error_m": float(np.sqrt(np.mean(size**2))), "max_error_m": float(np.max(size))}
    if stroke > 0.0:
        parts = {name: 100.0 * figures[f"{name}_error_m"] / stroke for name in ("rms", "max")}
        figures |= {f"{name}_error_percent_of_stroke": value for name, value in parts.items()}
    return figures


def absolute_integral(time, error) -> float:
    """Return the integral of the absolute error [m s], by the trapezoidal rule.

    Units: ``time`` [s], ``error`` [m].
    """
    size = np.abs(error)
    return float(np.sum(0.5 * np.diff(time) * (size[1:] + size[:-1])))


def _step_figures(parts, run: Tracked, notes: dict) -> dict:
    """Return the worst value of each figure over all steps."""
    inside = [slice(part.start, part.stop) for part in parts if part.kind is Kind.STEPS]
    each = [step_figures(*run.at(part)) for part in inside]
    each = [figures for figures in each if figures["steps"]]
    if not each:
        for name in ("overshoot_percent", "settling_time_s", "steady_state_error_m"):
            notes[name] = "the reference has no step from one hold to another"
        return {"steps": 0}
    found: dict = {name: max(one[name] for one in each) for name in ("overshoot_percent", "steady_state_error_m")}
    found["steps"], unsettled = (sum(one[name] for one in each) for name in ("steps", "unsettled"))
    if unsettled:
        notes["settling_time_s"] = (
            f"{unsettled} of {found['steps']} steps do not settle within 2 % before the hold ends"
        )
    else:
        found["settling_time_s"] = max(one["settling_time_s"] for one in each)
    return found


def _loop_figures(run: Tracked, start: int, voltage: np.ndarray | None, stroke: float, notes: dict) -> dict:
    """Return the loop widths from the sample ``start`` on, or of the whole run if it has no loop after ``start``."""
    figures: dict = {}
    opening = loop_opening(run.reference[start:], run.displacement[start:])
    if opening is None and start:
        start, opening = 0, loop_opening(run.reference, run.displacement)
        notes["loop_width_percent"] = notes["voltage_loop_width_percent"] = (
            "includes the motion to the beginning of the scan, because the run has no loop after it"
        )
    if opening is None or stroke <= 0.0:
        why = "no loop: the reference must rise and fall over at least ten levels"
        notes["loop_width_percent"] = notes["voltage_loop_width_percent"] = why
        return figures
    figures["loop_width_percent"] = 100.0 * opening / stroke
    opening = loop_opening(voltage[start:], run.displacement[start:]) if voltage is not None else None
    if opening is None:
        notes["voltage_loop_width_percent"] = "no reversing voltage in the recording"
    else:
        figures["voltage_loop_width_percent"] = 100.0 * opening / stroke
    return figures


def _signals(recording, good):
    return [recording[name][good] if recording.has(name) else None for name in ("command", "voltage")]


def chattering_figures(time, reference, command, voltage, notes: dict | None = None) -> dict:
    """Return chattering of the command and variation of the voltage as :func:`compute_metrics` defines them.

    Units: ``time`` [s], ``reference`` [m], ``command`` [m], ``voltage`` [V].
    """
    figures: dict = {}
    missing = {} if notes is None else notes
    for name, signal in (("command", command), ("voltage", voltage)):
        good = np.isfinite(signal) if signal is not None else np.zeros(len(time), dtype=bool)
        if np.count_nonzero(good) < 3 or not time[good][-1] > time[good][0]:
            missing.update(dict.fromkeys(SMOOTHNESS[name], f"no {name} in the recording"))
        elif name == "command":
            figures.update(_command_figures(time[good], reference[good], signal[good]))
        else:
            step = np.diff(signal[good])
            figures["voltage_rate_v_s"] = float(np.sqrt(np.mean((step / np.diff(time[good])) ** 2)))
            figures["voltage_variation_v"] = float(np.sum(np.abs(step)))
    return figures


def _command_figures(time, reference, command) -> dict:
    duration = float(time[-1] - time[0])
    moved, wanted = np.diff(command), np.diff(reference)
    uneven = (2.0 * command[1:-1] - command[:-2] - command[2:]) / 4.0
    counted = np.ones(len(command), dtype=bool)
    for k in np.flatnonzero(np.abs(np.diff(wanted)) > JUMP * np.ptp(reference)):
        counted[k : k + 2 + HOLD_SAMPLES] = False
    uneven = uneven[counted[1:-1]]
    figures = {
        "chattering_m_s": max(0.0, float(np.sum(np.abs(moved)) - np.sum(np.abs(wanted))) / duration),
        "command_reversals_hz": max(0, _reversals(moved) - _reversals(wanted)) / duration,
    }
    if uneven.size:
        figures["chattering_m"] = float(np.sqrt(np.mean(uneven**2)))
    return figures


def _reversals(steps) -> int:
    signs = np.sign(steps[steps != 0.0])
    return int(np.count_nonzero(signs[1:] != signs[:-1]))


def _saturated(recording: Recording, notes: dict) -> float | None:
    flags = recording["saturated"] if recording.has("saturated") else np.zeros(0)
    flags = flags[np.isfinite(flags)]
    if not len(flags):
        notes["saturated_percent"] = "the recording does not contain the compensator's signal 'saturated'"
        return None
    return 100.0 * float(np.mean(flags > 0.0))


def sampling_figures(recording: Recording, notes: dict) -> dict:
    """Return number of samples, duration, rate and jitter as :func:`compute_metrics` defines them."""
    # computed here, because sample_numbers refuses a recording with a long pause
    slots = np.rint((recording.time[-1] - recording.time[0]) / recording.sample_time) if len(recording) > 1 else 0
    gaps = max(slots + 1 - len(recording), 0)
    figures: dict = {
        "samples": len(recording),
        "missing_samples": int(recording.metadata.get("missing_samples", gaps)),
        "duration_s": float(recording.time[-1] - recording.time[0]),
    }
    timing = recording.metadata.get("timing") or {}
    if len(recording) > 1:
        figures["sample_rate_hz"] = 1.0 / recording.sample_time
    else:
        notes["sample_rate_hz"] = "a single sample"
    if "rate_hz" in timing:
        figures["rate_hz"] = timing["rate_hz"]
        figures["jitter_p99_s"] = timing["jitter_p99_s"]
    else:
        figures["rate_hz"] = figures.get("sample_rate_hz")
        notes["rate_hz"] = "computed from the stamps: the recording has no times of reception"
        notes["jitter_p99_s"] = "no times of reception in the recording (simulated, or a plain table)"
    late = recording["lateness"] if recording.has("lateness") else np.zeros(0)
    late = late[np.isfinite(late)]
    if late.size or "lateness_max_s" in timing:
        # the metadata contain these figures only for the whole run, not for parts of the run
        figures |= {
            name: float(np.percentile(late, part)) if late.size else timing[name] for name, part in LATENESS.items()
        }
        figures["skipped_samples"] = int(np.sum(recording["skipped"])) if recording.has("skipped") else 0
    else:
        notes |= {name: "not a fused run in real time" for name, *_ in TIMELINESS}
        figures |= {name: None for name, *_ in TIMELINESS}
    return figures


def _plain(value):
    return None if isinstance(value, float) and not np.isfinite(value) else value


#: Saturation is reported if it lasts longer than this in total [s], however long the run is.
MOMENT = 0.1
#: Saturation is also reported if it lasts for more than this fraction of the run, however short the run is.
SHARE = 0.01


def limited_text(recording: Recording) -> str:
    """Return how long the output was saturated, and why; empty up to :data:`MOMENT` and :data:`SHARE`."""
    if not recording.has("saturated") or len(recording) < 2:
        return ""
    cut = recording["saturated"] > 0.0
    seconds, share = float(np.count_nonzero(cut)) * recording.sample_time, float(np.mean(cut))
    if seconds <= MOMENT and share <= SHARE:
        return ""
    reasons = []
    away = (
        np.isin(recording["plant_mode"], (MODE_STALE, MODE_TRIPPED))
        if recording.has("plant_mode")
        else np.zeros_like(cut)
    )
    rest = cut & ~away
    if recording.has("voltage"):
        voltage = recording["voltage"]
        # without a recorded range, a voltage that stays at an extreme is at the end of the range
        still = np.concatenate([[False], voltage[1:] == voltage[:-1]])
        ends = still & ((voltage <= np.min(voltage)) | (voltage >= np.max(voltage)))
        for node in ("plant_simulator", "hysteresis_compensator"):
            for limit in _voltage_limits(recording, node).values():
                ends |= np.abs(voltage - limit) <= LEAST_DIFFERENCE
        ranged = rest & ends
        reasons += [("the range limits.minimum … limits.maximum", ranged)]
        rest = rest & ~ranged
    reasons += [
        ("the ramp to safe_voltage at safe_slew_rate", cut & away),
        ("safe_slew_rate or limits.slew_rate", rest),
    ]
    found = sorted(((float(np.mean(which)), name) for name, which in reasons if np.any(which)), reverse=True)
    first, last = recording.time[np.flatnonzero(cut)[[0, -1]]] - recording.time[0]
    by = ", ".join(f"{name} ({100.0 * part:.3g} %)" for part, name in found)
    return (
        f"the output was limited for {100.0 * share:.3g} % of the run, {seconds:.3g} s between {first:.4g} s and "
        f"{last:.4g} s, by {by}: the actuator received less than the command, so the figures of these samples are "
        "determined by the limits"
    )
