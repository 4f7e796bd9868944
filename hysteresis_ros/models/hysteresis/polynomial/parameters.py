# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the polynomial branch hysteresis, and what must hold between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import Parameters, parameter

#: The smallest loop whose branches are checked for monotony, as a part of the range (K2's smallest: 6 V of 120 V).
SMALLEST_LOOP = 0.05
CHECKED_LOOPS = 39

#: Names of the branch coefficients, each three numbers.
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
        0.0, description="lowest voltage down to which the branches must be monotone", unit="V", high=0.0
    )
    voltage_high: float = parameter(description="highest voltage up to which the branches must be monotone", unit="V")
    scale: float = parameter(
        1.0, description="factor on every coefficient, for studies of mismatch", low=1e-3, high=1e3
    )

    def check(self):
        """Yield what is wrong with the coefficients: their number, the range, branches that are not monotone."""
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
        """Yield a Problem for each family of curves that somewhere falls while the voltage rises.

        The branches are those between the corners as the kernel blends them; a slope is linear in V, so its ends
        suffice.
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
                    f"voltage everywhere in {low:g} … {high:g} V: mend the coefficients or narrow the range",
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
    """Return a stack whose loops have given corners and opening.

    This is K7a, an assumption: the numbers of the paper's figure 4 are not in its text.

    Parameters
    ----------
    gain : float
        g [m/V]: virgin curve g V, upper corner of the loop to V_max at g V_max.
    residual_slope : float
        d [m/V]: lower corner at d V_max.
    opening : float
        w0: opening at mid-stroke of the loop to ``opening_voltage``, as a part of g V_max; proportional to V_max.
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
