# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The triggers in a recording: their exact instants, positions and directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import TRIGGER_SIGNALS


@dataclass(frozen=True, eq=False)
class Triggers:
    """The triggers of an axis in a run, arrays of shape (N,).

    Parameters
    ----------
    sample : ndarray
        Index in the recording of the sample that follows each trigger.
    time : ndarray
        Instant of each trigger [s], a fraction of a sample time before the sample with the index ``sample``.
    number : ndarray
        Number of each trigger, from 1; a gap in the numbers stands for triggers that followed each other too fast.
    position : ndarray
        Position of the axis [m]; for a trigger at a given position, exactly this position.
    direction : ndarray
        1: the axis moved up, -1: down.
    """

    sample: np.ndarray
    time: np.ndarray
    number: np.ndarray
    position: np.ndarray
    direction: np.ndarray

    @property
    def lost(self) -> int:
        """Number of triggers that are missing because they followed other triggers too fast."""
        steps = np.diff(self.number)
        return int(np.sum(steps[steps > 0.0] - 1.0))


def triggers_of(recording: Recording) -> Triggers:
    """Return the triggers of an axis in a recording; the arrays are empty if there are no triggers.

    Parameters
    ----------
    recording : Recording
        Recording of a single axis; for an axis of a stage, :meth:`.Recording.axis` returns its recording.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> from hysteresis_ros.recordings.triggers import triggers_of
    >>> triggers_of(hr.simulate("kim2009", duration=0.01)).number
    array([], dtype=float64)
    """
    if not all(recording.has(name) for name in TRIGGER_SIGNALS):
        return Triggers(np.zeros(0, dtype=np.int64), *(np.zeros(0) for _ in range(4)))
    number, position, direction, delay = (recording[name] for name in TRIGGER_SIGNALS)
    sample = np.flatnonzero(np.nan_to_num(number))
    time = recording.time[sample] - delay[sample]
    return Triggers(sample, time, number[sample], position[sample], direction[sample])
