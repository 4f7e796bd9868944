# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Charts of a run: displacement, error, loops, voltage, adaptation, lateness. Micrometres, because people read them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.analysis.charts import Chart, Line
from hysteresis_ros.analysis.learning_plots import period_errors
from hysteresis_ros.analysis.metrics import actual_name
from hysteresis_ros.analysis.parts import stopped
from hysteresis_ros.analysis.plots import length_unit
from hysteresis_ros.analysis.settings import AxisSettings, axis_settings, judged_reference
from hysteresis_ros.analysis.steps import scan_start
from hysteresis_ros.compensation.recursive import ADAPTING
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening

_MICRO = 1e6


@dataclass(frozen=True)
class Judged:
    """A run as it is judged.

    Parameters
    ----------
    recording : Recording
    settings : AxisSettings
    displacement : array, shape (N,)
        True, or measured, less the preload offset [m].
    reference, error : array, shape (N,), or None
        What the displacement is judged by, and reference - displacement [m], NaN where the axis is stopped; None: the
        recording has no reference.
    start : int
        First sample whose error counts.
    unit : tuple of (str, float)
        Unit in which errors are drawn, and how many of it are in a metre.
    """

    recording: Recording
    settings: AxisSettings
    displacement: np.ndarray
    reference: np.ndarray | None
    error: np.ndarray | None
    start: int
    unit: tuple[str, float] = ("µm", _MICRO)

    @property
    def counted(self) -> np.ndarray:
        """Which samples have an error that counts, shape (N,)."""
        return np.isfinite(self.error) & (np.arange(len(self.recording)) >= self.start)


def judged(recording: Recording) -> Judged:
    """Return a run as it is judged.

    Parameters
    ----------
    recording : Recording

    Raises
    ------
    RecordingError
        There is neither a displacement nor a measurement.
    """
    settings = axis_settings(recording)
    displacement = recording[actual_name(recording)] - settings.offset
    if not recording.has("reference"):
        return Judged(recording, settings, displacement, None, None, 0)
    reference = judged_reference(recording)
    error = np.where(stopped(recording), np.nan, reference - displacement)
    good = np.flatnonzero(np.isfinite(error))
    start = 0
    if good.size and not recording.metadata.get("excerpt"):
        start = int(good[scan_start(reference[good], displacement[good])])
    run = Judged(recording, settings, displacement, reference, error, start)
    return replace(run, unit=length_unit(largest_error(run)))


def largest_error(run: Judged) -> float:
    """Return the largest error that counts [m]; 0 where there is none.

    Parameters
    ----------
    run : Judged
    """
    return 0.0 if run.error is None else float(np.max(np.abs(run.error[run.counted]), initial=0.0))


def traces_chart(run: Judged) -> Chart:
    """Return the chart of setpoint, reference (as late as judged), displacement and estimate over time [µm, s].

    Parameters
    ----------
    run : Judged
    """
    recording, preview = run.recording, run.settings.preview
    styles = {
        "setpoint": dict(dash=(4.0, 3.0), width=1.1),
        "estimated": dict(width=2.4),
        "displacement": dict(width=1.2),
        "reference": dict(width=1.4),
    }
    signals = {name: recording[name] for name in ("setpoint", "estimated") if recording.has(name)}
    signals["displacement"] = run.displacement
    if run.reference is not None:
        signals["reference"] = run.reference
    labels = {"reference": f"reference, {preview} samples later" if preview else "reference"}
    lines = [
        Line(labels.get(name, name), name, recording.time, signals[name] * _MICRO, **style)
        for name, style in styles.items()
        if name in signals
    ]
    return Chart("traces", "Displacement over time", "time [s]", "displacement [µm]", lines, height=3.6)


def error_chart(run: Judged) -> Chart | None:
    """Return the chart of reference - displacement over time [µm or nm, s]; None without a reference.

    Parameters
    ----------
    run : Judged
    """
    if run.error is None or not np.any(run.counted):
        return None
    (unit, factor), time = run.unit, run.recording.time
    line = Line("error", "displacement", time, run.error * factor, 1.0)
    shown: dict = {}
    if run.start:
        # what does not count does not make the rest small
        largest = 1.5 * factor * largest_error(run)
        shown = dict(shaded=(time[0], time[run.start]), shaded_label="not counted: jump into the scan")
        shown["limits"] = (-largest, largest)
    caption = "Error (reference − displacement) over time"
    return Chart("error", caption, "time [s]", f"error [{unit}]", [line], levels=(0.0,), **shown)


def loops_chart(run: Judged) -> Chart | None:
    """Return the chart of the loop before compensation (over voltage) on top of that after it (over reference) [µm, %].

    A voltage that does not go to and fro has no loop and is not drawn; None when nothing does.

    Parameters
    ----------
    run : Judged
    """
    recording, voltage = run.recording, run.recording.run_columns()["voltage"]
    inputs = [("before compensation, over the voltage", "voltage", voltage, "V", 1.0)]
    if run.reference is not None:
        inputs.append(("after compensation, over the reference", "reference", run.reference, "µm", _MICRO))
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
    # a voltage that jumps to and fro with its reference has no loop either
    if not lines or lines[-1].colour != inputs[-1][1]:
        return None
    across, caption = "voltage or reference [% of its range]", "Hysteresis loop before and after compensation"
    if run.reference is None:
        across, caption = "voltage [% of its range]", "Hysteresis loop"
    return Chart("loops", caption, across, "displacement [µm]", lines, "path", height=4.4)


def voltage_chart(run: Judged) -> Chart | None:
    """Return the chart of the voltage over time with the limits of the configuration [V, s]; None without a voltage.

    Parameters
    ----------
    run : Judged
    """
    if not run.recording.has("voltage"):
        return None
    line = Line("voltage", "voltage", run.recording.time, run.recording["voltage"], 1.0)
    both = (run.settings.voltage_minimum, run.settings.voltage_maximum)
    limits = tuple(limit for limit in both if limit is not None)
    label = "limits" if limits else ""
    caption = "Voltage and its limits" if limits else "Voltage"
    return Chart("voltage", caption, "time [s]", "voltage [V]", [line], levels=limits, level_label=label)


def adaptation_chart(run: Judged) -> Chart | None:
    """Return the chart of the gain of an inverse that adapts over time; None: it does not.

    Parameters
    ----------
    run : Judged
    """
    recording = run.recording
    if not recording.has("adaptation") or not np.any(np.nan_to_num(recording["adaptation"])):
        return None
    gain, adapts = recording["adapted_gain"], recording["adaptation"] == ADAPTING
    lines = [
        Line("frozen", "limit", recording.time, gain, 1.0),
        Line("adapting", "voltage", recording.time, np.where(adapts, gain, np.nan), 1.8),
    ]
    caption = "Gain of the adapted inverse, as a part of the identified one"
    return Chart("adaptation", caption, "time [s]", "gain [1]", lines)


def learned_chart(run: Judged) -> Chart | None:
    """Return the chart of the error of each period [µm or nm] over time [s]; None where nothing was learned.

    Parameters
    ----------
    run : Judged
    """
    ends, errors = period_errors(run.recording)
    if not ends.size:
        return None
    unit, factor = length_unit(float(np.nanmax(errors)))
    line = Line("period", "displacement", ends, errors * factor)
    caption = "Error of each period that was learned (undelayed reference − displacement)"
    return Chart("learned", caption, "time [s]", f"RMS of a period [{unit}]", [line], "graph", "y")


def lateness_chart(run: Judged) -> Chart | None:
    """Return the chart of how late each sample began over time [µs, s]; None where nobody noted it.

    Parameters
    ----------
    run : Judged
    """
    if not run.recording.has("lateness"):
        return None
    line = Line("lateness", "late", run.recording.time, run.recording["lateness"] * _MICRO, 0.9)
    return Chart("lateness", "Lateness of each sample over time", "time [s]", "lateness [µs]", [line])


def late_samples_chart(run: Judged) -> Chart | None:
    """Return the chart of the part of the samples that began later than so much [µs]; None where nobody noted it.

    Parameters
    ----------
    run : Judged
    """
    if not run.recording.has("lateness"):
        return None
    late = np.sort(_finite(run.recording["lateness"]))[::-1] * _MICRO
    # the latest ones one by one, the others at ever larger distances: both axes are logarithmic
    ranks = np.unique(np.rint(np.geomspace(1, late.size, 400)).astype(np.int64))
    # what begins in time has no place on a logarithmic axis
    line = Line("samples", "late", np.maximum(late[ranks - 1], 0.1)[::-1], (ranks / late.size)[::-1])
    caption = "Part of the samples that began at least so late"
    return Chart("late_samples", caption, "lateness [µs]", "part of the samples [1]", [line], "graph", "xy")


def _finite(values) -> np.ndarray:
    return values[np.isfinite(values)]
