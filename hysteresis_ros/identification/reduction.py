# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Model reduction by matching time responses (B2), and mass, damping and stiffness from a model of second order.

References
----------
.. [1] Auwal et al., eqs 1-3 and table I.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.identification.continuous import simulate_transfer_function
from hysteresis_ros.identification.state_space import FitError


@dataclass(frozen=True)
class SecondOrder:
    """``G(s) = gain ω²/(s² + 2 ζ ω s + ω²)``.

    Parameters
    ----------
    gain : float
        DC gain, output unit per input unit.
    frequency : float
        ω [rad/s].
    damping : float
        ζ [1].
    rms : float
        Difference of the two step responses, relative to the DC gain.
    """

    gain: float
    frequency: float
    damping: float
    rms: float

    @property
    def numerator(self) -> np.ndarray:
        """b_0, shape (1,)."""
        return np.array([self.gain * self.frequency**2])

    @property
    def denominator(self) -> np.ndarray:
        """1, 2 ζ ω, ω²."""
        return np.array([1.0, 2.0 * self.damping * self.frequency, self.frequency**2])


@dataclass(frozen=True)
class MassSpringDamper:
    """``G(s) = 1/(m s² + b s + K)`` (B2, eq. 3).

    With an input in V and an output in m the units are not those of mechanics: m in V s²/m and so on; they become kg,
    N s/m and N/m when the input is a force.

    Parameters
    ----------
    mass : float
        m [input unit · s²/output unit].
    damping : float
        b [input unit · s/output unit].
    stiffness : float
        K [input unit/output unit].
    """

    mass: float
    damping: float
    stiffness: float


def dominant_second_order(numerator, denominator, horizon: float | None = None, samples: int = 2000) -> SecondOrder:
    """Keep the dominant pole pair's frequency and the DC gain, and fit the damping to the step response (B2).

    The dominant pair is the slowest: the one whose step response decays last.

    Parameters
    ----------
    numerator, denominator : array_like
        Highest power first.
    horizon : float, optional
        Of the step response [s]; by default until the dominant pair has decayed to exp(-10).
    samples : int
        Of the step response.

    Raises
    ------
    FitError
        The model is unstable, has a pole at zero, or no pair of poles.
    """
    denominator = np.atleast_1d(np.asarray(denominator, dtype=float))
    numerator = np.atleast_1d(np.asarray(numerator, dtype=float)) / denominator[0]
    denominator = denominator / denominator[0]
    poles = np.roots(denominator)
    if len(poles) < 2:
        raise FitError(f"a model with {len(poles)} poles has no dominant pair")
    _refuse_unstable(poles)
    slow = poles[np.argsort(-poles.real)]
    second = np.conj(slow[0]) if slow[0].imag else next(p for p in slow[1:] if p.imag == 0.0 or p is slow[-1])
    frequency = float(np.sqrt(abs(slow[0] * second)))
    gain = float(numerator[-1] / denominator[-1])
    duration = horizon or 10.0 / abs(slow[0].real)
    step = duration / samples
    u = np.ones(samples)
    full = simulate_transfer_function(numerator, denominator, u, step) / gain

    def difference(logarithm):
        zeta = np.exp(logarithm[0])
        return simulate_transfer_function([frequency**2], [1.0, 2 * zeta * frequency, frequency**2], u, step) - full

    start = np.log(max(-(slow[0] + second).real / (2 * frequency), 1e-6))
    found = scipy.optimize.least_squares(difference, [start], xtol=1e-14, ftol=1e-14)
    return SecondOrder(gain, frequency, float(np.exp(found.x[0])), float(np.sqrt(np.mean(found.fun**2))))


def mass_spring_damper(numerator, denominator) -> MassSpringDamper:
    """Return m, b and K of ``1/(m s² + b s + K)`` from ``b_0/(a_2 s² + a_1 s + a_0)`` (B2, eq. 3).

    Parameters
    ----------
    numerator : array_like, shape (1,)
        b_0; leading zeros may stand before it.
    denominator : array_like, shape (3,)
        a_2, a_1, a_0.

    Raises
    ------
    FitError
        The model is not of second order, has a zero, or a value is not positive: no such mechanism exists.
    """
    numerator = np.trim_zeros(np.atleast_1d(np.asarray(numerator, dtype=float)), "f")
    denominator = np.trim_zeros(np.atleast_1d(np.asarray(denominator, dtype=float)), "f")
    if len(numerator) != 1 or len(denominator) != 3:
        raise FitError(
            f"{len(denominator) - 1} poles and {len(numerator) - 1} zeros: a mass with spring and damper has 2 and 0; "
            "reduce the model first"
        )
    m, b, K = (float(a / numerator[0]) for a in denominator)
    if not (m > 0.0 and b >= 0.0 and K > 0.0):
        raise FitError(f"m = {m:.6g}, b = {b:.6g}, K = {K:.6g}: must be positive; the model is no mass-spring-damper")
    return MassSpringDamper(m, b, K)


def _refuse_unstable(poles):
    unstable = [p for p in poles if p.real >= 0.0]
    if unstable:
        listed = ", ".join(f"{p:.4g}" for p in unstable)
        raise FitError(f"pole(s) {listed} rad/s are not in the left half plane: there is no settled step response")
