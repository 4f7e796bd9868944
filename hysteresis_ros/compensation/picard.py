# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Approximate inverse of any hysteresis model by Picard's iteration (Kim, Kim & Park 2009, eq. 16; K8)."""

from __future__ import annotations

from hysteresis_ros.block import INVERSE, composite

# Layout of p_i.
STEPS = 0
RATE = 1  # R [V/m]
GAIN = 2  # nominal gain [m/V]


@composite(*INVERSE)
def picard(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] for ``displacement`` [m]: V_0 = V_r = displacement/gain, V_{j+1} = V_j + (V_r - R H(V_j)).

    One step is the paper's compensator in the form that works, 2 V_r - R X. Every trial H(V_j) starts from the state
    ``x_h``, which is left as it is.

    Parameters
    ----------
    hysteresis : kernel
        Any model H.
    p_i : ndarray, shape (3,)
        Number of steps, R [V/m], nominal gain [m/V].
    x_i : ndarray, shape (>= len(x_h),)
        Scratch.
    p_h, x_h : ndarray
        Parameters and state of the model.
    displacement : float
        Wanted output [m].
    """
    wanted = displacement / p_i[GAIN]
    states = x_h.shape[0]
    trial = x_i[:states]
    voltage = wanted
    for _ in range(int(p_i[STEPS])):
        for i in range(states):
            trial[i] = x_h[i]
        voltage += wanted - p_i[RATE] * hysteresis(p_h, trial, voltage)
    return voltage
