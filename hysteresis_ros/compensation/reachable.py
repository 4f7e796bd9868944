# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a compensator, or a hysteretic actuator, reaches at rest."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hysteresis_ros.compensation.compensator import CompensatorParameters
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.limits import LimitsParameters

#: Samples of one sweep of the voltage.
SWEEP = 257


@lru_cache(maxsize=64)
def _sweep(hysteresis: HysteresisParameters, low: float, high: float, sample_time: float) -> tuple[float, float]:
    block = hysteresis_block(hysteresis, sample_time)
    reached = []
    for voltages in _swept(low, high):
        block.reset()
        reached.append(block.simulate(voltages))
    return float(np.min(reached)), float(np.max(reached))


@lru_cache(maxsize=8)
def _swept(low: float, high: float) -> tuple[np.ndarray, ...]:
    """Return voltages [V] from zero to one end, through all of the range and back, for each end."""
    start = min(max(0.0, low), high)
    return tuple(
        np.concatenate([np.linspace(a, b, SWEEP) for a, b in zip(ends, ends[1:], strict=False)])
        for ends in ((start, high, low, high), (start, low, high, low))
    )


def reachable_commands(compensator: CompensatorParameters, sample_time: float) -> tuple[float, float]:
    """Return the smallest and largest displacement [m] that the compensator can carry out at rest.

    Parameters
    ----------
    compensator : CompensatorParameters
        Model, inverse and limits.
    sample_time : float
        Sample time [s].
    """
    linear = compensator.inverse.type == "none"
    return _reached(compensator.hysteresis, compensator.limits, sample_time, linear)


def commandable(compensator: CompensatorParameters, sample_time: float, *amplifiers: LimitsParameters):
    """Return the smallest and largest displacement [m] that anybody should ask the compensator for.

    One stroke beyond its ends on either side: quick steps and inverse dynamics ask for more than is reached, for a
    moment; beyond this nothing changes any more in the voltage.

    Parameters
    ----------
    compensator : CompensatorParameters
        Model, inverse and limits.
    sample_time : float
        Sample time [s].
    *amplifiers : LimitsParameters
        Limits to which those of the compensator may be widened while the axis runs.
    """
    ranges = compensator.limits, *amplifiers
    widest = LimitsParameters(
        minimum=min(limits.minimum for limits in ranges), maximum=max(limits.maximum for limits in ranges)
    )
    low, high = _reached(compensator.hysteresis, widest, sample_time, compensator.inverse.type == "none")
    return low - (high - low), high + (high - low)


def _reached(hysteresis: HysteresisParameters, limits: LimitsParameters, sample_time: float, linear: bool = False):
    block = hysteresis_block(hysteresis, sample_time)
    if linear or not block.invertible:
        ends = block.gain * limits.minimum, block.gain * limits.maximum
        return min(ends), max(ends)
    return _sweep(hysteresis, limits.minimum, limits.maximum, sample_time)


def resting_displacements(actuator: ActuatorParameters, sample_time: float) -> tuple[float, float]:
    """Return the smallest and largest displacement [m] at which the actuator rests, preload included, creep not.

    Parameters
    ----------
    actuator : ActuatorParameters
    sample_time : float
        Sample time [s].
    """
    dynamics = actuator.dynamics
    gain = dynamics.dc_gain * dynamics.output_scale / dynamics.resolved_input_scale
    ends = [gain * end for end in _reached(actuator.hysteresis, actuator.limits, sample_time)]
    return min(ends) + actuator.preload.offset, max(ends) + actuator.preload.offset
