# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What was asked of an inchworm in a recording, so that a simulation can be asked the same."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import REQUESTS


def requests_per_sample(recording: Recording) -> dict[str, np.ndarray]:
    """Return what was asked of an inchworm beside setpoints, for replay by the simulation.

    Parameters
    ----------
    recording : Recording
        Of any axis.

    Returns
    -------
    dict of str to array, shape (M,)
        ``requests`` and ``speeds`` of each sample from the first on; empty for an axis without a sequencer. Samples
        that the recording misses have none.
    """
    if not all(recording.has(name) for name in REQUESTS):
        return {}
    index = recording.sample_numbers()
    requests, speeds = np.zeros(index[-1] + 1), np.full(index[-1] + 1, np.nan)
    requests[index] = np.nan_to_num(recording["request"])
    speeds[index] = recording["speed"]
    return {"requests": requests, "speeds": speeds}
