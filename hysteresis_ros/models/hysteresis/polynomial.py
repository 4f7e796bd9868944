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

The branches of the paper jump at reversals, unless the fit enforces the corners, and the paper does not describe minor
loops. The following rule is continuous at every reversal, for any coefficients:

* ``V_max`` starts at 0. At a reversal from rising to falling with a larger peak, ``V_max`` becomes this peak and the
  lower end ``V_lo`` becomes 0. From then on, ``V_lo`` is the lowest voltage at which the input has reversed from
  falling to rising, if this is below 0.
* Rising from a turning point ``(V_t, x_t)`` the output is
  ``x_r(V) + [x_t - x_r(V_t)] (V_max - V)/(V_max - V_t) + [x_v(V_max) - x_r(V_max)] (V - V_t)/(V_max - V_t)`` up to the
  upper corner ``(V_max, x_v(V_max))``, then the virgin curve.
* Falling from ``(V_t, x_t)`` the output is ``x_f(V) + [x_t - x_f(V_t)] (V - V_lo)/(V_t - V_lo)`` down to the lower
  corner ``(V_lo, x_f(V_lo))``, then ``x_f`` itself, also below 0 V. A falling branch that starts at the lower end (if
  a stack at rest is first driven to a negative voltage) cannot be blended: its difference from ``x_f`` remains until
  V_max grows.

Because the blending is affine, a small reversal on a branch leads back to the same branch. The model stores only these
two corners, and not the corners of minor loops.

References
----------
.. [1] Kim, Kim & Park, Development of an inchworm, International Journal of Precision Engineering and Manufacturing,
   2009.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    DISPLACEMENT,
    VOLTAGE,
    Deviation,
    HysteresisModel,
    Option,
    RateIndependentBlock,
    times,
)

#: Peak of the smallest loop whose branches are checked for monotonicity, as a fraction of the range. (The smallest loop
#: of K2 reaches 6 V of 120 V.)
SMALLEST_LOOP = 0.05
CHECKED_LOOPS = 39

#: Names of the branch coefficients; each has three numbers.
BRANCHES = ("rising_D", "rising_C1", "rising_C2", "falling_D", "falling_C1", "falling_C2")


def _branch(which: str, unit: str):
    return parameter(description=f"{which}: coefficients of 1, V_max and V_max²", unit=f"[{unit}, {unit}/V, {unit}/V²]")


@dataclass(frozen=True)
class PolynomialParameters(Parameters):
    """Coefficients of the virgin curve, the rising and the falling branches (K1), SI units."""

    virgin: tuple[float, ...] = parameter(
        description="virgin curve x = D + C1 V + C2 V²: D, C1 and C2", unit="[m, m/V, m/V²]"
    )
    rising_D: tuple[float, ...] = _branch("rising branch, constant term D_r", "m")
    rising_C1: tuple[float, ...] = _branch("rising branch, linear term C_r1", "m/V")
    rising_C2: tuple[float, ...] = _branch("rising branch, quadratic term C_r2", "m/V²")
    falling_D: tuple[float, ...] = _branch("falling branch, constant term D_f", "m")
    falling_C1: tuple[float, ...] = _branch("falling branch, linear term C_f1", "m/V")
    falling_C2: tuple[float, ...] = _branch("falling branch, quadratic term C_f2", "m/V²")
    voltage_low: float = parameter(
        0.0, description="lower end of the range in which the branches must be monotone", unit="V", high=0.0
    )
    voltage_high: float = parameter(
        description="upper end of the range in which the branches must be monotone", unit="V"
    )
    scale: float = parameter(
        1.0, description="factor on every coefficient, for studies of mismatch", low=1e-3, high=1e3
    )

    def check(self):
        """Yield a Problem for a wrong number of coefficients, an empty range, or branches that are not monotone."""
        counted = True
        for name in ("virgin", *BRANCHES):
            value = getattr(self, name)
            if len(value) != 3:
                counted = False
                yield Problem(name, value, "must be exactly 3 numbers")
        if self.voltage_high <= 0.0:
            yield Problem("voltage_high", self.voltage_high, "must be above 0 V")
        elif counted:
            yield from self._monotony()

    def _monotony(self):
        """Yield a Problem for each family of curves that is not monotone.

        The branches are checked between the corners, as the kernel blends them. The slope is linear in V, so it is
        checked only at both ends.
        """
        low, high = self.voltage_low, self.voltage_high
        _, c1, c2 = self.virgin
        worst = {"virgin": (min(c1, c1 + 2.0 * c2 * high), high)}
        v_max = np.linspace(SMALLEST_LOOP * high, high, CHECKED_LOOPS)
        top = np.polyval(self.virgin[::-1], v_max)
        rising, falling = (
            [np.polyval(getattr(self, f"{branch}_{name}")[::-1], v_max) for name in ("C2", "C1", "D")]
            for branch in ("rising", "falling")
        )
        slopes: dict[str, list[np.ndarray]] = {"rising_C1": [], "falling_C1": []}
        for bottom in (0.0, low):
            start = np.polyval(falling, bottom) - np.polyval(rising, bottom)
            blend = (top - np.polyval(rising, v_max) - start) / (v_max - bottom)
            slopes["rising_C1"] += [2.0 * rising[0] * v + rising[1] + blend for v in (bottom, v_max)]
            blend = (top - np.polyval(falling, v_max)) / (v_max - bottom)
            slopes["falling_C1"] += [2.0 * falling[0] * v + falling[1] + blend for v in (bottom, v_max)]
            slopes["falling_C1"].append(2.0 * falling[0] * bottom + falling[1])
        for name, found in slopes.items():
            least = np.min(found, axis=0)
            k = int(np.argmin(least))
            worst[name] = (float(least[k]), float(v_max[k]))
        for name, (slope, peak) in worst.items():
            if not slope > 0.0:
                family = name.split("_")[0]
                yield Problem(
                    name,
                    getattr(self, name),
                    f"the {family} curve of the loop to {peak:.4g} V has slope {slope:.3g} m/V; it must rise with the "
                    f"voltage everywhere in {low:g} … {high:g} V: change the coefficients or narrow the range",
                )


def assumed_stack(
    gain: float = 0.1025e-6,
    residual_slope: float = 0.0125e-6,
    opening: float = 0.15,
    opening_voltage: float = 120.0,
    voltage_low: float = -30.0,
    voltage_high: float = 120.0,
    scale: float = 1.0,
) -> PolynomialParameters:
    """Return the parameters of a stack whose loops have the given corners and width.

    This is the assumption K7a: the text of the paper does not contain the numbers of its figure 4.

    Parameters
    ----------
    gain : float
        g [m/V]: virgin curve g V, upper corner of the loop to V_max at g V_max.
    residual_slope : float
        d [m/V]: lower corner at d V_max.
    opening : float
        w0: loop width at mid-stroke of the loop to ``opening_voltage``, as a fraction of g V_max. The fraction is
        proportional to V_max.
    opening_voltage : float
        [V].
    voltage_low, voltage_high : float
        Range in which the branches must be monotone [V].
    scale : float
        Factor on every coefficient.
    """
    g, d, bend = gain, residual_slope, 2.0 * opening * gain / opening_voltage
    return PolynomialParameters(
        virgin=(0.0, g, 0.0),
        rising_D=(0.0, d, 0.0),
        rising_C1=(g - d, -bend, 0.0),
        rising_C2=(bend, 0.0, 0.0),
        falling_D=(0.0, d, 0.0),
        falling_C1=(g - d, bend, 0.0),
        falling_C2=(-bend, 0.0, 0.0),
        voltage_low=voltage_low,
        voltage_high=voltage_high,
        scale=scale,
    )


# Layout of p: every branch coefficient has three numbers, for 1, V_max and V_max².
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
LOWER_OFFSET = 8  # offset of x_f at and below V_lo, if a falling branch has started at V_lo
VIRGIN_OFFSET = 9  # offset of the virgin curve at VIRGIN_FROM after a retune; it fades out up to VOLTAGE_HIGH
VIRGIN_FROM = 10
STATES = 11


@kernel
def _coefficient(p, index, v_max):
    return p[index] + v_max * (p[index + 1] + v_max * p[index + 2])


@kernel
def virgin_curve(p, x, voltage):
    """Return the virgin curve [m] at ``voltage`` [V], with the offset of :meth:`PolynomialHysteresis.rebase`."""
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
    """Return the rising branch x_r [m] of the loop to ``v_max`` at ``voltage`` [V] (eq. 1)."""
    c2 = _coefficient(p, RISING_C2, v_max)
    return _coefficient(p, RISING_D, v_max) + voltage * (_coefficient(p, RISING_C1, v_max) + voltage * c2)


@kernel
def falling_curve(p, v_max, voltage):
    """Return the falling branch x_f [m] of the loop to ``v_max`` at ``voltage`` [V] (eq. 2)."""
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
    """Return the displacement [m] after a monotone change of the voltage to ``u`` [V]; NaN changes nothing."""
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
    """Solve ``rise = slope v + bend v²`` for v on the rising side of the parabola.

    Beyond the range of the parabola, the result is at the parabola's extremum. The form of K8, ``2 rise / (slope +
    √(slope² + 4 bend rise))``, loses no digits for slope ≥ 0.
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
    """Return the voltage [V] at which the model's next output is ``displacement`` [m] (K8, exact branch inverse).

    ``p_h`` and ``x_h`` are the arrays of :func:`polynomial`; ``x_h`` is not changed. For NaN, the result is the last
    voltage; beyond the range of a parabola, it is the voltage of the parabola's extremum. ``x_i``, shape (≥ 11,), is
    scratch. ``hysteresis`` and ``p_i`` are not used, because the branches are inverted in closed form.
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
        """Return p, shape (22,), with all coefficients multiplied by the scale."""
        rows = [parameters.virgin, *(getattr(parameters, name) for name in BRANCHES)]
        return np.append(parameters.scale * np.array(rows).ravel(), parameters.voltage_high)

    def initial_state(self) -> np.ndarray:
        """Return x of a stack in its initial state: 0 V on the virgin curve."""
        x = np.zeros(STATES)
        x[DISPLACEMENT] = x[TURN_DISPLACEMENT] = self.p[VIRGIN]
        x[DIRECTION] = x[ON_VIRGIN] = 1.0
        return x

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]: mean slope of the virgin curve up to ``voltage_high``."""
        return float(self.p[VIRGIN + 1] + self.p[VIRGIN + 2] * self.p[VOLTAGE_HIGH])

    def rebase(self) -> None:
        """Make the present point a turning point, so that a change of the coefficients does not change the output.

        From this point, the output blends into the new corners by the minor-loop rule. On the virgin curve, the
        difference fades out linearly up to ``voltage_high``.
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


__all__ = ["MODEL", "PolynomialHysteresis", "PolynomialParameters", "assumed_stack"]


def _scaled(parameters: PolynomialParameters, factor: float) -> PolynomialParameters:
    return times(parameters, factor, "scale")


def _shifted(parameters: PolynomialParameters, offset: float) -> PolynomialParameters:
    constant = offset / parameters.scale
    curves = {name: getattr(parameters, name) for name in ("virgin", "rising_D", "falling_D")}
    moved: dict[str, Any] = {name: (curve[0] + constant, *curve[1:]) for name, curve in curves.items()}
    return replace(parameters, **moved)


def _deviated(parameters: PolynomialParameters, deviation: Deviation) -> PolynomialParameters:
    """Scale all coefficients by ``gain`` and the difference of the branches by ``opening``; the branches still meet."""
    changed: dict = {}
    for name in ("C1", "C2"):
        rising, falling = (np.array(getattr(parameters, f"{branch}_{name}")) for branch in ("rising", "falling"))
        middle, half = 0.5 * (rising + falling), 0.5 * (rising - falling)
        changed[f"rising_{name}"] = tuple((middle + deviation.opening * half).tolist())
        changed[f"falling_{name}"] = tuple((middle - deviation.opening * half).tolist())
    return replace(parameters, scale=parameters.scale * deviation.gain, **changed)


MODEL = HysteresisModel(
    name="polynomial",
    title="branch polynomials with coefficients that are quadratics of the peak voltage (Kim et al. 2009)",
    data="loops from about 0 V to positive peaks; three or more peaks that grow, e.g. triangles to 6, 12 … 120 V",
    parameters=PolynomialParameters,
    block=PolynomialHysteresis,
    example=assumed_stack(),
    scaled=_scaled,
    shifted=_shifted,
    deviated=_deviated,
    inverses=("exact", "general", "picard_steps", "none"),
    identify="hysteresis_ros.identification.procedures:polynomial",
    options={
        "method": Option(str, "fit to all samples, or to the coefficients of each loop", ("samples", "loops")),
        "criterion": Option(str, "error norm to minimise", ("automatic", "rms", "maximum")),
    },
)
