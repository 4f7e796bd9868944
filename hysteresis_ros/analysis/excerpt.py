# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A part of a run that is to be judged: from here to there, without its beginning, or its last periods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.analysis.parts import find_parts, stopped
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import quantity


def seconds(text: str, option: str) -> float:
    """Return an instant of the run [s].

    Parameters
    ----------
    text : str
        A number in seconds, or with its unit.
    option : str
        Where it stands, for the message.

    Raises
    ------
    RecordingError
        It is none.
    """
    try:
        value, unit = quantity(text)
        if unit not in ("", "s") or value < 0.0:
            raise ValueError("must be a time of 0 or more")
    except ValueError as error:
        raise RecordingError(f"{option} {text}: {error}; write e.g. 0.5 or 500ms") from None
    return value


def within(recording: Recording, first: float, last: float) -> Recording:
    """Return the samples from one instant to another.

    Parameters
    ----------
    recording : Recording
    first, last : float
        [s] since the first sample; both belong to it.

    Raises
    ------
    RecordingError
        There are fewer than two samples.
    """
    time = recording.time - recording.time[0]
    chosen = (time >= first - 1e-9) & (time <= last + 1e-9)
    if np.count_nonzero(chosen) < 2:
        raise RecordingError(f"from {first:g} s to {last:g} s there is nothing to judge: the run lasts {time[-1]:g} s")
    if np.all(chosen):
        return recording
    note = f"judged from {time[chosen][0]:.6g} s to {time[chosen][-1]:.6g} s of {time[-1]:.6g} s"
    metadata = {**recording.metadata, "notes": [*recording.notes, note]}
    metadata.setdefault("first_s", float(recording.time[0]))
    if not chosen[0]:
        # what a preview looks back to is another than the first reference
        metadata["excerpt"] = True
    signals = {name: values[chosen] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[chosen], signals=signals, metadata=metadata)


def period_ends(recording: Recording) -> np.ndarray:
    """Return the instants at which whole periods of the reference end, the last first, shape (P + 1,) [s].

    They are those of the longest part of the run that repeats, since the first sample. Empty when nothing does.

    Parameters
    ----------
    recording : Recording
    """
    time, reference = recording.time - recording.time[0], recording["reference"]
    finite = np.flatnonzero(np.isfinite(reference))
    parts = [part for part in find_parts(reference[finite], off=stopped(recording)[finite]) if len(part.ends) > 1]
    longest = max(parts, key=lambda part: part.stop - part.start, default=None)
    return time[:0] if longest is None else time[finite[list(longest.ends[::-1])]]


def last_periods(recording: Recording, count: int) -> Recording:
    """Return the last periods of a reference that repeats, up to its last reversal and no rest after it.

    Parameters
    ----------
    recording : Recording
    count : int
        Number of periods.

    Raises
    ------
    RecordingError
        The reference does not repeat, or not so often.
    """
    ends = period_ends(recording)
    if not ends.size:
        raise RecordingError("--last-periods: the reference does not repeat; choose a part with --range or --skip")
    if count > ends.size - 1:
        raise RecordingError(f"--last-periods {count}: the run has {ends.size - 1} whole periods between reversals")
    # a sample at the end begins the next period
    return within(recording, float(ends[count]), float(ends[0]) - 0.5 * recording.sample_time)
