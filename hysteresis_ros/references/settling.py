# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""When an axis has settled: its error stays within a tolerance, at a reference that rests."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class SettlingParameters(Parameters):
    """When an axis is called settled."""

    tolerance: float = parameter(
        0.0,
        description="largest distance of a measurement from the reference; 0: a hundredth of minimum … maximum",
        unit="m",
        low=0.0,
        read_only=True,
    )
    time: float = parameter(
        0.05, description="for so long without a break", unit="s", low=0.0, high=3600.0, read_only=True
    )


class Settling:
    """Tells sample by sample whether an axis has settled.

    A sample counts when the measurement is within the tolerance of the reference, and the reference moves by less than
    the tolerance within the time. One that does not count, also because nothing was measured, and another setpoint
    begin the time anew: a step has settled when its response has stayed in the band for that time.

    Parameters
    ----------
    tolerance : float
        Half of the band [m], above 0.
    time : float
        How long it has to stay in it [s].
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    settled : bool
        What the last sample said.
    """

    def __init__(self, tolerance: float, time: float, sample_time: float):
        self._tolerance = tolerance
        self._samples = max(math.ceil(time / sample_time - 1e-9), 1)
        self._step = tolerance / self._samples
        self._setpoint = self._reference = math.nan
        self.restart()

    def restart(self) -> None:
        """Begin the time anew."""
        self._count = 0
        self.settled = False

    def look(self, setpoint: float, reference: float, measured: float, stopped: bool) -> bool:
        """Take a sample, and return whether the axis has settled.

        Parameters
        ----------
        setpoint, reference : float
            Of the sample [m].
        measured : float
            [m], NaN: nothing was.
        stopped : bool
            Whether the plant has stopped the axis.
        """
        rests = setpoint == self._setpoint and abs(reference - self._reference) < self._step
        within = abs(measured - reference) <= self._tolerance  # not so with NaN
        self._setpoint, self._reference = setpoint, reference
        self._count = self._count + 1 if rests and within and not stopped else 0
        self.settled = self._count >= self._samples
        return self.settled
