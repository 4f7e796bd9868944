# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Polynomial branch hysteresis of Kim, Kim & Park (2009), with a minor-loop rule, and its exact inverse.

Three families of parabolas: the virgin curve ``x_v(V)``, rising branches ``x_r(V)`` and falling branches ``x_f(V)``
[1]_, eqs 1-2,

.. math::

   x_v = D_v + C_{1v} V + C_{2v} V^2, \qquad x_{r, f} = D(V_{max}) + C_1(V_{max}) V + C_2(V_{max}) V^2

The coefficients of the branches are quadratic polynomials of ``V_max``, the largest peak so far (fig. 5).

The paper fits branches that jump at reversals unless the fit enforces the corners, and says nothing of minor loops.
The rule used here is continuous at every reversal for any coefficients:

* ``V_max`` starts at 0 and becomes the peak at a reversal from rising to falling if that is larger; then the lower
  end ``V_lo`` is 0 again. Otherwise ``V_lo`` is the lowest reversal from falling to rising, if that is below 0.
* Rising from a turning point ``(V_t, x_t)`` the output is
  ``x_r(V) + [x_t - x_r(V_t)] (V_max - V)/(V_max - V_t) + [x_v(V_max) - x_r(V_max)] (V - V_t)/(V_max - V_t)`` up to
  the upper corner ``(V_max, x_v(V_max))``, then the virgin curve.
* Falling from ``(V_t, x_t)`` it is ``x_f(V) + [x_t - x_f(V_t)] (V - V_lo)/(V_t - V_lo)`` down to the lower corner
  ``(V_lo, x_f(V_lo))``, then ``x_f`` itself, also below 0 V. Only where a fall starts at the lower end (the stack at
  rest is driven negative first) is there no room to blend: the difference to ``x_f`` then stays until V_max grows.

Because the blending is affine, a tiny reversal on a branch leads back onto the same branch. Only the two corners are
remembered, not the corners of minor loops.

References
----------
.. [1] Kim, Kim & Park, Development of an inchworm, International Journal of Precision Engineering and Manufacturing,
   2009.
"""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.block import kernel
from hysteresis_ros.models.hysteresis.polynomial.parameters import BRANCHES, PolynomialParameters
from hysteresis_ros.models.rate_independent import DISPLACEMENT, VOLTAGE, RateIndependentBlock

# Layout of p: every branch coefficient is three numbers, of 1, V_max and V_max².
VIRGIN = 0
RISING_D = 3
RISING_C1 = 6
RISING_C2 = 9
FALLING_D = 12
FALLING_C1 = 15
FALLING_C2 = 18
VOLTAGE_HIGH = 21

# Layout of x, after VOLTAGE and DISPLACEMENT.
DIRECTION = 2  # +1 rising, -1 falling
TURN_VOLTAGE = 3
TURN_DISPLACEMENT = 4
V_MAX = 5
V_LOW = 6
ON_VIRGIN = 7
LOWER_OFFSET = 8  # what x_f lacks at and below V_lo when a fall started there
VIRGIN_OFFSET = 9  # what the virgin curve lacks at VIRGIN_FROM after a retune; fades out up to VOLTAGE_HIGH
VIRGIN_FROM = 10
STATES = 11


@kernel
def _coefficient(p, index, v_max):
    return p[index] + v_max * (p[index + 1] + v_max * p[index + 2])


@kernel
def virgin_curve(p, x, voltage):
    """Virgin curve [m] at ``voltage`` [V], with what a retune left (see :meth:`PolynomialHysteresis.rebase`)."""
    y = p[VIRGIN] + voltage * (p[VIRGIN + 1] + voltage * p[VIRGIN + 2])
    offset = x[VIRGIN_OFFSET]
    if offset != 0.0:
        start, end = x[VIRGIN_FROM], p[VOLTAGE_HIGH]
        if voltage <= start or start >= end:
            y += offset
        elif voltage < end:
            y += offset * ((end - voltage) / (end - start))
    return y


@kernel
def rising_curve(p, v_max, voltage):
    """Rising branch x_r [m] of the loop to ``v_max`` at ``voltage`` [V] (eq. 1)."""
    c2 = _coefficient(p, RISING_C2, v_max)
    return _coefficient(p, RISING_D, v_max) + voltage * (_coefficient(p, RISING_C1, v_max) + voltage * c2)


@kernel
def falling_curve(p, v_max, voltage):
    """Falling branch x_f [m] of the loop to ``v_max`` at ``voltage`` [V] (eq. 2)."""
    c2 = _coefficient(p, FALLING_C2, v_max)
    return _coefficient(p, FALLING_D, v_max) + voltage * (_coefficient(p, FALLING_C1, v_max) + voltage * c2)


@kernel
def _turn_up(x):
    """Make the last point the turning point from falling to rising."""
    x[TURN_VOLTAGE] = x[VOLTAGE]
    x[TURN_DISPLACEMENT] = x[DISPLACEMENT]
    x[V_LOW] = min(x[V_LOW], x[VOLTAGE])
    x[DIRECTION] = 1.0


@kernel
def _turn_down(p, x):
    """Make the last point the turning point from rising to falling; V_max grows if the peak is larger (fig. 5)."""
    voltage = x[VOLTAGE]
    x[TURN_VOLTAGE] = voltage
    x[TURN_DISPLACEMENT] = x[DISPLACEMENT]
    if voltage > x[V_MAX]:
        x[V_MAX] = voltage
        x[V_LOW] = 0.0
        x[LOWER_OFFSET] = 0.0
    if voltage <= x[V_LOW]:
        x[LOWER_OFFSET] = x[DISPLACEMENT] - falling_curve(p, x[V_MAX], voltage)
    x[DIRECTION] = -1.0


@kernel
def polynomial(p, x, u):
    """Displacement [m] after the voltage has moved monotonically to ``u`` [V]; NaN leaves everything as it is."""
    if u > x[VOLTAGE]:
        if x[DIRECTION] < 0.0:
            _turn_up(x)
        v_max = x[V_MAX]
        if u >= v_max:
            x[ON_VIRGIN] = 1.0
            y = virgin_curve(p, x, u)
        else:
            x[ON_VIRGIN] = 0.0
            v_t = x[TURN_VOLTAGE]
            start = x[TURN_DISPLACEMENT] - rising_curve(p, v_max, v_t)
            end = virgin_curve(p, x, v_max) - rising_curve(p, v_max, v_max)
            y = rising_curve(p, v_max, u) + (start * (v_max - u) + end * (u - v_t)) / (v_max - v_t)
    elif u < x[VOLTAGE]:
        if x[DIRECTION] > 0.0:
            _turn_down(p, x)
        x[ON_VIRGIN] = 0.0
        v_low = x[V_LOW]
        y = falling_curve(p, x[V_MAX], u) + x[LOWER_OFFSET]
        if u > v_low:
            v_t = x[TURN_VOLTAGE]
            start = x[TURN_DISPLACEMENT] - falling_curve(p, x[V_MAX], v_t) - x[LOWER_OFFSET]
            y += start * (u - v_low) / (v_t - v_low)
    else:
        return x[DISPLACEMENT]
    x[VOLTAGE] = u
    x[DISPLACEMENT] = y
    return y


@kernel
def _root(rise, slope, bend):
    """Solve ``rise = slope v + bend v²`` for v on the side where the parabola rises; beyond its reach: its extremum.

    K8's form ``2 rise / (slope + √(slope² + 4 bend rise))`` loses no digits while slope ≥ 0.
    """
    discriminant = slope * slope + 4.0 * bend * rise
    if discriminant <= 0.0:
        return -slope / (2.0 * bend) if bend != 0.0 else 0.0
    root = math.sqrt(discriminant)
    if slope >= 0.0:
        return 2.0 * rise / (slope + root)
    return (root - slope) / (2.0 * bend) if bend != 0.0 else rise / slope


@kernel
def _virgin_voltage(p, x, displacement):
    offset, start, end = x[VIRGIN_OFFSET], x[VIRGIN_FROM], p[VOLTAGE_HIGH]
    level, slope = p[VIRGIN], p[VIRGIN + 1]
    if offset != 0.0:
        if start >= end:
            level += offset
        elif displacement < virgin_curve(p, x, end):
            level += offset * end / (end - start)
            slope -= offset / (end - start)
    return _root(displacement - level, slope, p[VIRGIN + 2])


@kernel
def polynomial_inverse(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] at which the model's next output is ``displacement`` [m] (K8, exact branch inverse).

    The state ``x_h`` is left as it is. Beyond the reach of a parabola the voltage of its extremum is returned.

    Parameters
    ----------
    hysteresis : kernel
        Not used: the branches are inverted in closed form.
    p_i : ndarray
        Not used.
    x_i : ndarray, shape (>= 11,)
        Scratch.
    p_h, x_h : ndarray
        Parameters and state of :func:`polynomial`.
    displacement : float
        Wanted output [m]; NaN gives the last voltage.
    """
    x = x_i
    for i in range(STATES):
        x[i] = x_h[i]
    voltage = x[VOLTAGE]
    if displacement > x[DISPLACEMENT]:
        if x[DIRECTION] < 0.0:
            _turn_up(x)
        v_max = x[V_MAX]
        top = virgin_curve(p_h, x, v_max)
        if voltage >= v_max or displacement >= top:
            return max(_virgin_voltage(p_h, x, displacement), voltage, v_max)
        v_t, x_t = x[TURN_VOLTAGE], x[TURN_DISPLACEMENT]
        start = x_t - rising_curve(p_h, v_max, v_t)
        end = top - rising_curve(p_h, v_max, v_max)
        bend = _coefficient(p_h, RISING_C2, v_max)
        slope = _coefficient(p_h, RISING_C1, v_max) + 2.0 * bend * v_t + (end - start) / (v_max - v_t)
        return min(max(v_t + _root(displacement - x_t, slope, bend), voltage), v_max)
    if displacement < x[DISPLACEMENT]:
        if x[DIRECTION] > 0.0:
            _turn_down(p_h, x)
        v_max, v_low, offset = x[V_MAX], x[V_LOW], x[LOWER_OFFSET]
        bend = _coefficient(p_h, FALLING_C2, v_max)
        slope = _coefficient(p_h, FALLING_C1, v_max)
        if voltage <= v_low or displacement <= falling_curve(p_h, v_max, v_low) + offset:
            level = _coefficient(p_h, FALLING_D, v_max) + offset
            return min(_root(displacement - level, slope, bend), voltage, v_low)
        v_t, x_t = x[TURN_VOLTAGE], x[TURN_DISPLACEMENT]
        start = x_t - falling_curve(p_h, v_max, v_t) - offset
        slope += 2.0 * bend * v_t + start / (v_t - v_low)
        return max(min(v_t + _root(displacement - x_t, slope, bend), voltage), v_low)
    return voltage


class PolynomialHysteresis(RateIndependentBlock):
    """Polynomial branch hysteresis: voltage [V] to displacement [m].

    Parameters
    ----------
    parameters : PolynomialParameters
        Coefficients.
    sample_time : float
        Sample time [s]; the model is rate independent and does not use it.
    """

    kernel = staticmethod(polynomial)
    inverse = staticmethod(polynomial_inverse)

    def pack(self, parameters: PolynomialParameters) -> np.ndarray:
        """Return p, shape (22,), with the scale multiplied in."""
        rows = [parameters.virgin, *(getattr(parameters, name) for name in BRANCHES)]
        return np.append(parameters.scale * np.array(rows).ravel(), parameters.voltage_high)

    def initial_state(self) -> np.ndarray:
        """Return x of a stack that never saw a voltage: 0 V on the virgin curve."""
        x = np.zeros(STATES)
        x[DISPLACEMENT] = x[TURN_DISPLACEMENT] = self.p[VIRGIN]
        x[DIRECTION] = x[ON_VIRGIN] = 1.0
        return x

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]: mean slope of the virgin curve up to ``voltage_high``."""
        return float(self.p[VIRGIN + 1] + self.p[VIRGIN + 2] * self.p[VOLTAGE_HIGH])

    def rebase(self) -> None:
        """Make the present point a turning point, so that changed coefficients do not move the output.

        From there the output blends into the new corners by the minor-loop rule; on the virgin curve the difference
        fades out linearly up to ``voltage_high``.
        """
        x, p = self.x, self.p
        voltage, displacement = x[VOLTAGE], x[DISPLACEMENT]
        x[VIRGIN_OFFSET] = x[LOWER_OFFSET] = 0.0
        x[TURN_VOLTAGE], x[TURN_DISPLACEMENT] = voltage, displacement
        if voltage >= x[V_MAX]:
            x[VIRGIN_OFFSET] = displacement - virgin_curve(p, x, voltage)
            x[VIRGIN_FROM] = voltage
            x[DIRECTION] = 1.0
        elif x[DIRECTION] < 0.0 and voltage <= x[V_LOW]:
            x[LOWER_OFFSET] = displacement - falling_curve(p, x[V_MAX], voltage)
