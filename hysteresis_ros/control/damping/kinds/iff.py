# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Integral force feedback: the integral of the measured force in the stack is subtracted from the command [1]_, [2]_.

u = γ w − α s / ((s + ω_c)(s + ω_h)) f

The force has zeros below its poles (:mod:`hysteresis_ros.models.sensor`), for any mass. Between zeros and poles the
integral of the force is in phase with the velocity, so it damps the poles. With a pure integrator the damping ratio is
at most (ω_p − ω_z)/(2 ω_z) [1]_. A pure integrator would drive the static force k_f y, and with it the displacement, to
zero. Therefore the integrator has a leak at ω_c = α β, which is equivalent to a feedthrough β from the command into the
force [3]_. A high-pass at ω_h removes constant signals. So an offset of the sensor does not move the axis, a slow drift
hardly moves it, and in steady state the command u is γ w; with γ = 1 it equals the law's output w. Without the
high-pass (ω_h = 0) the static force stays in the loop, so γ = 1 + k_f α/ω_c.

The filter is discretised by the bilinear transform with h = 2/T. It does not wind up, because its poles are stable and
its input is measured even while the command is saturated.

If the delay of the loop is more than about a quarter of the resonance's period, damping needs the opposite sign of the
gain, α < 0.

References
----------
.. [1] Preumont, Vibration Control of Active Structures, 3rd ed. 2011 (integral force feedback).
.. [2] Fleming, Nanopositioning system with force feedback for high-performance tracking and vibration control,
   IEEE/ASME Trans. Mechatronics 15 (2010).
.. [3] Teo, Russell, Aphale & Fleming, Optimal integral force feedback and structured PI tracking control:
   Application for objective lens positioner, Mechatronics (2014).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.damping.kind import FORCE, DampingKind, Mode, first_order, second_order, shortened
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.linear import StateSpace


@dataclass(frozen=True)
class IffParameters(Parameters):
    """Gain, leak and high-pass of integral force feedback."""

    gain: float = parameter(
        0.0,
        unit="m/(N s)",
        description="gain α of the integral; below 0 for a delay above about a quarter of the resonance's period",
    )
    leak: float = parameter(
        100.0, unit="rad/s", low=1e-6, description="corner ω_c below which the filter does not integrate"
    )
    high_pass: float = parameter(
        100.0,
        unit="rad/s",
        low=0.0,
        description="corner ω_h of the high-pass; 0: no high-pass, so that the static force acts too",
    )

    def check(self):
        """Yield a Problem if the gain is 0."""
        if self.gain == 0.0:
            yield Problem("gain", self.gain, "must not be 0; `hysteresis design --damping iff` finds a gain")


def iff(parameters: IffParameters, sample_time: float) -> StateSpace:
    """Return −α s/((s + ω_c)(s + ω_h)), from the force to the command."""
    gain, leak, high = parameters.gain, parameters.leak, parameters.high_pass
    if not high:
        return first_order(-gain, leak, sample_time)
    return second_order((0.0, -gain, 0.0), (1.0, leak + high, leak * high), 2.0 / sample_time)


def ranges(mode: Mode) -> tuple:
    """Return the search ranges, for both signs of α, of α times stiffness / ω and of the common corner / ω."""
    corner = (0.03, 3.0, True)
    return ((0.1, 10.0, True), corner), ((-10.0, -0.1, True), corner)


def chosen(point, mode: Mode) -> IffParameters:
    """Return the parameters for a point of the search."""
    omega = 2.0 * math.pi * mode.frequency
    gain, corner = shortened(omega * point[0] / mode.force), shortened(omega * point[1])
    return IffParameters(gain=gain, leak=corner, high_pass=corner)


DAMPING = DampingKind(
    name="iff",
    description="integral feedback of the measured force, from the force joint (Preumont; Fleming 2010)",
    source=FORCE,
    parameters=IffParameters,
    filter=iff,
    ranges=ranges,
    chosen=chosen,
)
