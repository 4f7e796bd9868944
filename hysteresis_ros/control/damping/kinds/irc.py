# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Integral resonant control: integral feedback around the plant with an added feedthrough [1]_, [2]_.

With a feedthrough D_f, the plant G + D_f has a zero below its first pole, and integral feedback of the output of G +
D_f damps the resonances. For tracking, [1]_ and [2]_ write the same loop as a controller of the displacement alone,

C₂(s) = −k/(s − k D_f)

which acts on r_c − y. Here the output w of the law is added after C₂, to the command, with a weight γ that keeps the DC
gain: u = γ w + k/(s − k D_f) y. Therefore the path from the reference has a zero at s = k D_f.

If the delay of the loop is more than about a quarter of the resonance's period, damping needs the opposite sign of the
gain, k < 0, with D_f > 0.

References
----------
.. [1] Aphale, Fleming & Moheimani, Integral resonant control of collocated smart structures, Smart Materials and
   Structures 16 (2007) 439-446.
.. [2] Fleming, Aphale & Moheimani, A new method for robust damping and tracking control of scanning probe microscope
   positioning stages, IEEE Trans. Nanotechnology 9 (2010) 438-448.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.damping.kind import MEASUREMENT, DampingKind, Mode, first_order, shortened
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.linear import StateSpace


@dataclass(frozen=True)
class IrcParameters(Parameters):
    """Gain and feedthrough of integral resonant control."""

    k: float = parameter(
        0.0,
        unit="1/s",
        description="integral gain; below 0 for a delay above about a quarter of the resonance's period",
    )
    feedthrough: float = parameter(
        -2.0, description="D_f, with the opposite sign of k: 1/|D_f| is the DC gain of the feedback"
    )

    def check(self):
        """Yield a Problem if the filter would be unstable."""
        if not self.k * self.feedthrough < 0.0:
            remedy = f"must not be 0, and must have the opposite sign of feedthrough = {self.feedthrough:g}"
            yield Problem("k", self.k, remedy + ", or the filter k/(s − k D_f) is unstable")


def irc(parameters: IrcParameters, sample_time: float) -> StateSpace:
    """Return k/(s − k D_f), from the displacement to the command."""
    return first_order(parameters.k, -parameters.k * parameters.feedthrough, sample_time)


def ranges(mode: Mode) -> tuple:
    """Return the search ranges of (DC gain of the loop, corner of the filter [rad/s]), for both signs of the gain."""
    omega = 2.0 * math.pi * mode.frequency
    corner = (0.05 * omega, 20.0 * omega, True)
    # positive feedback with a DC gain of the loop of 0.4 has a gain margin of 8 dB: the required 6 dB, and 25 % for an
    # error of the plant's gain
    return ((0.05, 0.4, True), corner), ((-2.0, -0.05, True), corner)


def chosen(point, mode: Mode) -> IrcParameters:
    """Return the parameters for a DC gain of the loop and a corner."""
    feedback, corner = point[0] / mode.gain, point[1]
    return IrcParameters(k=shortened(feedback * corner), feedthrough=shortened(-1.0 / feedback))


DAMPING = DampingKind(
    name="irc",
    description="integral resonant control of the displacement (Fleming, Aphale & Moheimani 2010)",
    source=MEASUREMENT,
    parameters=IrcParameters,
    filter=irc,
    ranges=ranges,
    chosen=chosen,
)
