# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a run that learned looks like: the error of each of its periods."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.recordings.configured import configured
from hysteresis_ros.recordings.dataset import Recording

#: Fewer whole periods show nothing.
LEAST = 3


def period_errors(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the periods that were learned [s], and the RMS of the undelayed error in each [m].

    Both are empty where nothing was learned, or fewer than three periods long. Without a true displacement the measured
    one counts.

    Parameters
    ----------
    recording : Recording
    """
    given = configured(recording.configuration, "motion_controller", recording.metadata.get("namespace") or "")
    nothing = np.zeros(0), np.zeros(0)
    if given.get("learning.type", "none") == "none" or not recording.has("reference") or len(recording) < 2:
        return nothing
    samples = round(given.get("learning.period", 0.0) / recording.sample_time)
    count = len(recording) // samples if samples else 0
    if count < LEAST:
        return nothing
    displacement = recording["displacement" if recording.has("displacement") else "measured"]
    error = (recording["reference"] - displacement + given.get("model.preload.offset", 0.0))[: count * samples]
    mean_square = np.nanmean(error.reshape(count, samples) ** 2, axis=1)
    return recording.time[samples - 1 : count * samples : samples], np.sqrt(mean_square)
