# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Learned length of an inchworm's steps: recursive least squares with forgetting, for either direction.

With u the commanded extension and z the movement of the slider along it, both as parts of the full stroke,
z = gain u + offset: the offset takes the load (it has another sign in each direction) and what a clamp loses whenever
it closes, the gain the rest. Reference: Åström & Wittenmark, *Adaptive Control*, 2nd edition 1995, section 2.2.
Forgetting pauses while a variance is as large as at the start, so that full steps alone, which say nothing about gain
and offset apart, never make it grow without bound. The gain stays within bounds; the offset takes a load.
"""

from __future__ import annotations

from hysteresis_ros.block import kernel

# Layout of the model of one direction in x.
GAIN = 0
OFFSET = 1
COVARIANCE = 2  # of gain and gain, gain and offset, offset and offset
SIZE = 5

#: Standard deviations with which gain and offset are known before the first step, and of one measured step.
GAIN_DEVIATION = 0.05
OFFSET_DEVIATION = 0.5
STEP_DEVIATION = 2.0e-3

#: Bounds of the gain.
LOWEST_GAIN = 0.5
HIGHEST_GAIN = 1.5

#: The model never says that the longest step is shorter than this part of its extension, nor longer than the next.
SHORTEST = 0.1
LONGEST = 2.0


@kernel
def forget_all(x, at, gain, offset):
    """Begin with ``gain`` and ``offset`` in ``x[at:at + 5]``."""
    x[at + GAIN] = gain
    x[at + OFFSET] = offset
    x[at + COVARIANCE] = GAIN_DEVIATION * GAIN_DEVIATION
    x[at + COVARIANCE + 1] = 0.0
    x[at + COVARIANCE + 2] = OFFSET_DEVIATION * OFFSET_DEVIATION


@kernel
def longest_step(x, at, usable):
    """Length of the longest step, whose extension is ``usable``, both as parts of the stroke."""
    return min(max(x[at + GAIN] * usable + x[at + OFFSET], SHORTEST * usable), LONGEST)


@kernel
def extension_for(x, at, length):
    """Extension, 0 … 1, that moves the slider by ``length``, both as parts of the stroke."""
    return min(max((length - x[at + OFFSET]) / max(x[at + GAIN], LOWEST_GAIN), 0.0), 1.0)


@kernel
def learn(x, at, forgetting, u, z):
    """Take in that the extension ``u`` moved the slider by ``z``."""
    a = x[at + COVARIANCE]
    b = x[at + COVARIANCE + 1]
    c = x[at + COVARIANCE + 2]
    first = a * u + b
    second = b * u + c
    scale = STEP_DEVIATION * STEP_DEVIATION * forgetting + first * u + second
    innovation = z - x[at + GAIN] * u - x[at + OFFSET]
    x[at + GAIN] += first / scale * innovation
    x[at + OFFSET] += second / scale * innovation
    a -= first * first / scale
    b -= first * second / scale
    c -= second * second / scale
    bounded = min(max(x[at + GAIN], LOWEST_GAIN), HIGHEST_GAIN)
    x[at + OFFSET] += (x[at + GAIN] - bounded) * u
    x[at + GAIN] = bounded
    gain_limit = GAIN_DEVIATION * GAIN_DEVIATION * forgetting
    if a < gain_limit and c < OFFSET_DEVIATION * OFFSET_DEVIATION * forgetting:
        a /= forgetting
        b /= forgetting
        c /= forgetting
    x[at + COVARIANCE] = a
    x[at + COVARIANCE + 1] = b
    x[at + COVARIANCE + 2] = c
