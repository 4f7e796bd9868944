# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Cut a recording of a hysteretic actuator into branches, and refuse what no fit can use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.recordings.loops import REVERSAL, turning_points

#: Fewest samples of a recording, and of one branch that is fitted.
FEWEST_SAMPLES = 20
FEWEST_BRANCH_SAMPLES = 5


@dataclass(frozen=True)
class Branch:
    """A stretch of a recording along which the input moves one way.

    Parameters
    ----------
    start, stop : int
        Indices of its two turning points; both belong to it.
    low, high : float
        Its smallest and its largest input.
    rising : bool
        The input rises.
    """

    start: int
    stop: int
    low: float
    high: float
    rising: bool

    @property
    def samples(self) -> slice:
        """All of its samples, both turning points included."""
        return slice(self.start, self.stop + 1)

    def __len__(self) -> int:
        return self.stop - self.start + 1


def checked_signals(input_, output, names=("voltage", "displacement"), fewest: int = FEWEST_SAMPLES):
    """Return both signals as float arrays of one length, shape (N,).

    Parameters
    ----------
    input_, output : array_like, shape (N,)
        Signals of one recording.
    names : tuple of str
        What they are called in errors.
    fewest : int
        Smallest N.

    Raises
    ------
    IdentificationError
        Lengths differ, there are too few samples, some are not finite, or a signal is constant.
    """
    signals = []
    for name, values in zip(names, (input_, output), strict=True):
        values = np.asarray(values, dtype=np.float64)
        if values.ndim != 1:
            raise IdentificationError(f"{name} has {values.ndim} dimensions; give one column of numbers")
        if values.size < fewest:
            raise IdentificationError(f"{name} has {values.size} samples, too short; at least {fewest} are needed")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise IdentificationError(
                f"{name} is not finite at {bad.size} samples, the first is number {bad[0]}; cut or mend the recording"
            )
        if np.ptp(values) == 0.0:
            raise IdentificationError(f"{name} is constant at {values[0]:g}; record a motion")
        signals.append(np.ascontiguousarray(values))
    if signals[0].size != signals[1].size:
        raise IdentificationError(
            f"{names[0]} has {signals[0].size} samples and {names[1]} {signals[1].size}; they must belong together"
        )
    return signals[0], signals[1]


def split_branches(input_, reversal: float = REVERSAL) -> tuple[Branch, ...]:
    """Return the branches of ``input_``, shape (N,), in order; reversals below ``reversal`` of its range are noise."""
    points = turning_points(input_, reversal)
    branches = []
    for start, stop in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
        a, b = float(input_[start]), float(input_[stop])
        if a != b:
            branches.append(Branch(start, stop, min(a, b), max(a, b), b > a))
    return tuple(branches)


def require_both_directions(branches, model: str) -> None:
    """Raise IdentificationError unless there are rising and falling branches, without which there is no loop."""
    rising = sum(branch.rising for branch in branches)
    if rising == 0 or rising == len(branches):
        found = f"{len(branches)} {'rising' if rising else 'falling'} branch(es) only" if branches else "no branch"
        raise IdentificationError(
            f"the recording has {found}; a {model} needs rising and falling branches: record at least one whole loop"
        )
