# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Compensators of a polynomial stack, and their compiled loop."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models.block import compiled, composite
from hysteresis_ros.models.compensator import Compensator, CompensatorArrays, CompensatorParameters, compensator_step
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import LimitsParameters

GAIN = 0.1025e-6
STROKE = 120.0 * GAIN
SAMPLE_TIME = 1.0 / 3000.0
KINDS = ("none", "picard_steps", "exact")


def parameters(kind="exact", scale=1.0, handover_time=0.002, **limits):
    return CompensatorParameters(
        inverse=InverseParameters(type=kind),
        hysteresis=HysteresisParameters(type="polynomial", polynomial=assumed_stack(scale=scale)),
        limits=LimitsParameters(**{"minimum": -30.0, "maximum": 120.0, **limits}),
        handover_time=handover_time,
    )


def compensator(*arguments, **keywords):
    return Compensator(parameters(*arguments, **keywords), SAMPLE_TIME)


def triangle(count=600):
    return STROKE * np.abs((np.arange(count) / 150.0 + 1.0) % 2.0 - 1.0)


@composite("void", "kernel", "inverse", CompensatorArrays, CompensatorArrays, "array", "array")
def run_compensator(hysteresis, inverse, ps, xs, commands, voltages):
    for k in range(commands.shape[0]):
        voltages[k] = compensator_step(hysteresis, inverse, ps, xs, commands[k])


def offline(kind):
    block = compensator(kind, bits=16, slew_rate=3e4)
    voltages = np.zeros(600)
    compiled(run_compensator)(block.hysteresis_kernel, block.inverse_kernel, block.ps, block.xs, triangle(), voltages)
    return voltages
