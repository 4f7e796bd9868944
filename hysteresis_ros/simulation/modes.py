# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the parts of an axis did about faults in a run, in words."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.loop.watch import MODE_NAMES, RUNNING
from hysteresis_ros.recordings.dataset import Recording

#: Columns of modes, and what the parts are called.
PARTS = {
    "source_mode": "source",
    "controller_mode": "controller",
    "compensator_mode": "compensator",
    "plant_mode": "plant",
}
#: Longest list of one part; a fault by chance makes thousands of short entries.
MOST_LINES = 8


def mode_lines(recording: Recording) -> list[str]:
    """Return a line for each stretch of time in which a part did not run as it should.

    Parameters
    ----------
    recording : Recording
        With the modes of the parts.
    """
    lines = []
    for column, part in PARTS.items():
        if column not in recording:
            continue
        modes = recording[column]
        cuts = np.flatnonzero(np.diff(modes) != 0.0) + 1
        stretches = [s for s in np.split(np.arange(len(modes)), cuts) if len(s) and modes[s[0]] != RUNNING]
        for stretch in stretches[:MOST_LINES]:
            first, last = recording.time[stretch[0]], recording.time[stretch[-1]]
            name = MODE_NAMES[int(modes[stretch[0]])]
            lines.append(f"{part}: {name} from {first:.6g} to {last:.6g} s ({len(stretch)} samples)")
        if len(stretches) > MOST_LINES:
            counted = int(np.sum(modes != RUNNING))
            lines.append(f"{part}: … {len(stretches)} such stretches, {counted} samples in all")
    return lines or ["nothing of it made a part do anything else than usual"]
