# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Whether limits kept the output from what was asked for more than a moment: what a summary says first."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import MODE_STALE, MODE_TRIPPED

#: A moment: so long in all [s], or this share of the run.
MOMENT, SHARE = 0.1, 0.01


def limited_text(recording: Recording) -> str:
    """Return for which part of a run the output was limited, and by what; empty: for no more than a moment.

    Parameters
    ----------
    recording : Recording
    """
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
        ends = rest & ((voltage <= np.min(voltage)) | (voltage >= np.max(voltage)))
        still = np.concatenate([[False], voltage[1:] == voltage[:-1]])
        ranged = ends & still
        reasons += [("the range limits.minimum … limits.maximum", ranged)]
        rest = rest & ~ranged
    reasons += [("the way to safe_voltage at safe_slew_rate", cut & away), ("safe_slew_rate or limits.slew_rate", rest)]
    found = sorted(((float(np.mean(which)), name) for name, which in reasons if np.any(which)), reverse=True)
    by = ", ".join(f"{name} ({100.0 * part:.3g} %)" for part, name in found)
    return (
        f"the output was limited for {100.0 * share:.3g} % of the run, {seconds:.3g} s, by {by}: what was asked did "
        "not leave for the actuator then, and the figures of these samples are those of the limits"
    )
