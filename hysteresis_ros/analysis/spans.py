# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures over spans of a run: whole ones beside each other, and sums from which the page adds up any other span."""

from __future__ import annotations

import contextlib

import numpy as np

from hysteresis_ros.analysis.excerpt import period_ends, within
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.parts import Kind
from hysteresis_ros.analysis.run_charts import Judged
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording

#: Blocks of samples of which the page knows the sums; a span of the page ends where blocks end.
BLOCKS = 1500
#: Periods of the second column of figures.
LAST = 2
#: Kinds of parts that have a column, most of them, and the share of a run from which on a part is all of it.
SHOWN, PARTS, WHOLE = (Kind.STEPS, Kind.SCAN, Kind.PATH), 2, 0.98
#: Figures that the page adds up for the span it shows; the others need every sample of it.
ADDED = (
    *("rms_error_m", "rms_error_percent_of_stroke", "max_error_m", "max_error_percent_of_stroke", "iae_m_s"),
    *("voltage_rate_v_s", "voltage_variation_v", "saturated_percent", "stroke_m", "samples", "duration_s"),
    *("lateness_max_s", "skipped_samples"),
)


def columns_of(recording: Recording, figures: dict) -> list[tuple[str, float, float, dict]]:
    """Return the spans whose figures stand in the page's table: the whole run, its longest parts, and last periods.

    Parameters
    ----------
    recording : Recording
    figures : dict
        Of the whole run.

    Returns
    -------
    list of (str, float, float, dict)
        Name, first and last instant [s] and figures of each span.
    """
    time = recording.time
    found = [("whole run", float(time[0]), float(time[-1]), figures)]
    # a part that is all of the run has its column
    parts = [one for one in figures.get("parts", ()) if one["part"] in SHOWN]
    parts = [one for one in parts if one["to_s"] - one["from_s"] < WHOLE * (time[-1] - time[0])]
    parts = sorted(parts, key=lambda one: one["to_s"] - one["from_s"])[-PARTS:]
    spans = [(one["part"], one["from_s"], one["to_s"]) for one in sorted(parts, key=lambda one: one["from_s"])]
    ends = time[0] + (period_ends(recording) if recording.has("reference") else time[:0])
    count = min(LAST, ends.size - 2)
    if count > 0:
        # a sample at the end begins the next period
        name = "last period" if count == 1 else f"last {count} periods"
        spans.append((name, float(ends[count]), float(ends[0]) - 0.5 * recording.sample_time))
    for name, first, last in spans:
        # the measurement may have ended before the reference
        with contextlib.suppress(RecordingError):
            part = within(recording, first - time[0], last - time[0])
            found.append((name, float(part.time[0]), float(part.time[-1]), compute_metrics(part)))
    return found


def block_sums(run: Judged, blocks: int = BLOCKS) -> dict[str, np.ndarray]:
    """Return sums over blocks of samples from which figures of a span of whole blocks follow exactly.

    A term that joins a sample with the one before it belongs to the later sample's block; ``joint_…`` is that of the
    block's first sample, which a span that begins with the block leaves out.

    ====================== ================================================================================
    ``from``, ``to``       first and last instant of the block [s]
    ``samples``            number of samples
    ``errors``, ``square`` number of errors that count, and Σ e² [m²]
    ``largest``            largest abs(e) [m]
    ``area``               Σ ½ (abs(e_k) + abs(e_(k-1))) (t_k - t_(k-1)) [m s]
    ``low``, ``high``      of the reference, or of the displacement where there is none [m]
    ``volts``, ``rises``   number of voltages, Σ abs(V_k - V_(k-1)) [V]
    ``rates``              Σ ((V_k - V_(k-1)) / (t_k - t_(k-1)))² [V²/s²]
    ``flags``, ``cut``     samples that say whether limits cut them, and those that were cut
    ``late``, ``skipped``  latest beginning [s], skipped samples
    ====================== ================================================================================

    Parameters
    ----------
    run : Judged
    blocks : int
        Most blocks.

    Returns
    -------
    dict of str to array, shape (B,)
        Those that the recording allows.
    """
    recording, time = run.recording, run.recording.time
    size = -(-time.size // blocks)
    block = np.arange(time.size) // size
    count = int(block[-1]) + 1
    starts = np.arange(count) * size
    found = {
        "from": time[starts],
        "to": time[np.minimum(starts + size, time.size) - 1],
        "samples": np.bincount(block, minlength=count),
    }
    judged = np.isfinite(run.displacement) & (True if run.reference is None else np.isfinite(run.reference))
    level = run.displacement if run.reference is None else run.reference
    found["low"] = np.fmin.reduceat(np.where(judged, level, np.nan), starts)
    found["high"] = np.fmax.reduceat(np.where(judged, level, np.nan), starts)
    if run.error is not None:
        found |= _error_sums(block[run.counted], time[run.counted], np.abs(run.error[run.counted]), count)
    volts = judged & np.isfinite(recording["voltage"]) if "voltage" in recording else np.zeros(time.size, dtype=bool)
    if np.count_nonzero(volts) > 2:
        found |= _voltage_sums(block[volts], time[volts], recording["voltage"][volts], count)
    if recording.has("saturated"):
        flags = np.isfinite(recording["saturated"])
        found["flags"] = np.bincount(block[flags], minlength=count)
        found["cut"] = np.bincount(block[flags], recording["saturated"][flags] > 0.0, minlength=count)
    if recording.has("lateness"):
        found["late"] = np.fmax.reduceat(recording["lateness"], starts)
    if recording.has("skipped"):
        found["skipped"] = np.bincount(block, np.nan_to_num(recording["skipped"]), minlength=count)
    return found


def _error_sums(block, time, error, count: int) -> dict[str, np.ndarray]:
    area = np.diff(time) * 0.5 * (error[1:] + error[:-1])
    largest = np.zeros(count)
    np.maximum.at(largest, block, error)
    return {
        "errors": np.bincount(block, minlength=count),
        "square": np.bincount(block, error**2, minlength=count),
        "largest": largest,
        **_joined("area", block, area, count),
    }


def _voltage_sums(block, time, voltage, count: int) -> dict[str, np.ndarray]:
    step = np.diff(voltage)
    return {
        "volts": np.bincount(block, minlength=count),
        **_joined("rises", block, np.abs(step), count),
        **_joined("rates", block, (step / np.diff(time)) ** 2, count),
    }


def _joined(name: str, block, terms, count: int) -> dict[str, np.ndarray]:
    """Return the sums of terms between neighbours, and the terms that lead into each block."""
    joint = np.zeros(count)
    crossing = np.flatnonzero(np.diff(block)) + 1
    joint[block[crossing]] = terms[crossing - 1]
    return {name: np.bincount(block[1:], terms, minlength=count), f"joint_{name}": joint}
