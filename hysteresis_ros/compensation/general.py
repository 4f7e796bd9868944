# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Exact inverse of any hysteresis model whose output is monotone in the voltage of one step, by root search.

The model's own kernel is tried on a copy of its state, so whatever the compensator's model is, the voltage found is the
one at which that model gives the wanted displacement.
"""

from __future__ import annotations

from hysteresis_ros.block import INVERSE, composite, nested

# Layout of p_i; the first three are those of the Picard steps.
GAIN = 2  # nominal gain [m/V]
LOWEST = 3  # voltages between which is searched [V]
HIGHEST = 4

#: Where the search ends: residual as a part of the displacements at hand; a few units in the last place.
TOLERANCE = 4.0e-16
MOST_TRIALS = 120


@nested
def _trial(hysteresis, x_i, p_h, x_h, voltage):
    states = x_h.shape[0]
    trial = x_i[:states]
    for i in range(states):
        trial[i] = x_h[i]
    return hysteresis(p_h, trial, voltage)


@composite(*INVERSE)
def general(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] at which the model's next output is ``displacement`` [m], to rounding; ``x_h`` is left as it is.

    From the last voltage on, trial voltages go in the direction of the wanted change until the model's output has
    passed it; then the bracket is narrowed by regula falsi with the Anderson-Björck weights, and by bisection whenever
    three such trials have not halved it. The number of trials is bounded. A displacement that the model does not reach
    between the lowest and the highest voltage gives that voltage. NaN gives the last voltage.

    Parameters
    ----------
    hysteresis : kernel
        Any model that keeps the last voltage and the last output in ``x[0]`` and ``x[1]``, or has no memory.
    p_i : ndarray, shape (5,)
        Nominal gain [m/V] in place 2, lowest and highest voltage [V] in places 3 and 4.
    x_i : ndarray, shape (>= len(x_h),)
        Scratch.
    p_h, x_h : ndarray
        Parameters and state of the model.
    displacement : float
        Wanted output [m].
    """
    lowest, highest = p_i[LOWEST], p_i[HIGHEST]
    # a model of one state has no memory: any start serves
    near = max(lowest, min(highest, x_h[0])) if x_h.shape[0] > 1 else 0.0
    missing = displacement - _trial(hysteresis, x_i, p_h, x_h, near)
    if not abs(missing) > 0.0:
        return near
    direction = 1.0 if missing > 0.0 else -1.0
    limit = highest if missing > 0.0 else lowest
    near_error = -direction * missing  # below zero on the near side, above on the far side
    size = abs(displacement) + abs(missing)
    step = abs(missing) / p_i[GAIN]
    far, far_error = near, near_error
    trials = 0
    while trials < MOST_TRIALS:
        trials += 1
        far = near + direction * step
        if direction * (far - limit) >= 0.0:
            far = limit
        far_error = direction * (_trial(hysteresis, x_i, p_h, x_h, far) - displacement)
        if abs(far_error) <= TOLERANCE * size or (far_error < 0.0 and far == limit):
            return far
        if far_error > 0.0:
            break
        # by the slope just seen and a little further, at least half as far again
        seen = far_error - near_error
        ahead = 1.1 * step * (-far_error / seen) if seen > 0.0 else 4.0 * step
        step = max(0.5 * step, min(ahead, 8.0 * step))
        near, near_error = far, far_error
    width = abs(far - near)
    near_weight, far_weight = near_error, far_error
    slow = 0
    while trials < MOST_TRIALS:
        trials += 1
        voltage = near + (far - near) * (near_weight / (near_weight - far_weight))
        if slow >= 3:
            voltage = near + 0.5 * (far - near)
            slow = 0
        if (voltage - near) * (voltage - far) >= 0.0:  # no number lies between any more, or the secant left the bracket
            voltage = near + 0.5 * (far - near)
            if voltage in (near, far):
                break
        error = direction * (_trial(hysteresis, x_i, p_h, x_h, voltage) - displacement)
        if abs(error) <= TOLERANCE * size:
            return voltage
        if error < 0.0:
            weight = 1.0 - error / near_weight
            far_weight *= weight if weight > 0.0 else 0.5
            near, near_error, near_weight = voltage, error, error
            far_weight = max(far_weight, 1e-3 * far_error)
        else:
            weight = 1.0 - error / far_weight
            near_weight *= weight if weight > 0.0 else 0.5
            far, far_error, far_weight = voltage, error, error
            near_weight = min(near_weight, 1e-3 * near_error)
        slow += 1
        if abs(far - near) <= 0.5 * width:
            width = abs(far - near)
            slow = 0
    return near if -near_error <= far_error else far
