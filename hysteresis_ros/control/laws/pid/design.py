# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""PID gains from a model: the zeros cancel its slowest poles, the gain sets the bandwidth (lambda tuning).

With the zeros of the discrete PID on the slowest poles of the model, the loop transfer is g/(z − 1) times what is
left of the model, and the response to the reference close to a first-order lag whose bandwidth grows with g:

* no dynamics: the pole is that of the sample of delay, z = 0 (PI),
* one state: the lag's pole (PI),
* more: the slowest pair, or the two slowest real poles (PID).

References
----------
.. [1] Dahlin, Designing and tuning digital controllers, Instruments and Control Systems 41, 1968 (lambda tuning).
.. [2] Åström & Hägglund, Advanced PID Control, 2006, section 6.4 and 7.3 (M_s between 1.2 and 2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.control import design
from hysteresis_ros.control.closed_loop import plant_state_space
from hysteresis_ros.control.laws.pid.law import PidParameters, pid_state_space
from hysteresis_ros.control.margins import AIMED, REQUIRED, Requirements, judge
from hysteresis_ros.control.uncertainty import PossiblePlant, judge_worst
from hysteresis_ros.linear_algebra import eigenvalues, polynomial, solve
from hysteresis_ros.models.state_space import StateSpace

#: What an integrator alone is held to.
CALM = replace(REQUIRED, sensitivity_peak=1.4)
#: Poles below this are those of a delay; several of them at 0 are computed no closer.
AT_ZERO = 1e-3
#: Cut-off of the derivative filter as a part of the sampling angular frequency, when none is given.
FILTER = 0.2
#: A slow pole with less of the answer to a step than this is left: a high-pass in a damping has a zero beside it.
LITTLE = 0.02
#: How near to a pole its residue is looked at, as a part of its distance from 1.
NEAR = 1e-4
#: Steps of the search for the gain.
STEPS = 60


def pid_with_zeros(zeros, gain: float, sample_time: float, derivative_filter: float):
    """Return (K_p, K_i, K_d) of a discrete PID with numerator g (z − z₁)(z − z₂), or g (z − z₁) for a PI.

    Parameters
    ----------
    zeros : sequence of complex
        One for a PI, two (real or a conjugate pair) for a PID.
    gain : float
        g, the leading coefficient.
    sample_time : float
        [s]
    derivative_filter : float
        N [rad/s].
    """
    wanted = gain * polynomial(zeros)
    half = 0.5 * sample_time
    if len(zeros) == 1:
        Kp, Ki = solve(np.array([[1.0, -1.0], [half, half]]).T, wanted)
        return float(Kp), float(Ki), 0.0
    a = elementary.exp(-derivative_filter * sample_time) if derivative_filter > 0.0 else 0.0
    slope = (1.0 - a) / sample_time
    columns = [polynomial([1.0, a]), half * polynomial([-1.0, a]), slope * polynomial([1.0, 1.0])]
    Kp, Ki, Kd = solve(np.array(columns).T, wanted)
    return float(Kp), float(Ki), float(Kd)


def slowest_poles(model: StateSpace) -> list[complex]:
    """Return the poles that a PI or PID cancels: one or two.

    Parameters
    ----------
    model : StateSpace
    """
    if not model.order:
        return [0.0]
    poles = sorted(eigenvalues(model.A), key=_slowness, reverse=True)
    # poles at zero are delay, which no zero takes away
    poles = [pole for pole in poles if _slowness(pole) > AT_ZERO**2] or [0.0]
    while len(poles) > 1 and poles[0].imag == 0.0 and _share(model, poles[0].real) < LITTLE:
        poles = poles[1:]
    if len(poles) == 1:
        return [complex(poles[0])]
    first = poles[0]
    if abs(first.imag) > 0.0:
        return [complex(first), complex(first.conjugate())]
    second = next((pole for pole in poles[1:] if pole.imag == 0.0), None)
    return [complex(first)] + ([] if second is None else [complex(second)])


def _share(model: StateSpace, pole: float) -> float:
    """Return which part of the answer to a step dies out with a real pole."""
    near = NEAR * (1.0 - pole)
    residue = near * complex(model.response([pole + near])[0, 0, 0])
    return abs(residue / (1.0 - pole) / model.dc_gain)


def _slowness(pole: complex) -> float:
    return pole.real * pole.real + pole.imag * pole.imag  # abs() is hypot of the C library


def design_pid(
    given: PidParameters,
    dynamics,
    sample_time: float,
    bandwidth: float | None = None,
    *,
    plants: tuple[PossiblePlant, ...] = (),
    aimed: Requirements = AIMED,
) -> PidParameters:
    """Return the gains of a PID for a model.

    Parameters
    ----------
    given : PidParameters
        All but the gains, the setpoint weights and, where it is 0 and needed, the derivative filter is kept.
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]
    bandwidth : float, optional
        Frequency at which the response to the reference falls by 3 dB [Hz]; by default what the plants allow.
    plants : tuple of PossiblePlant, optional
        On which that is to be met, the model first; by default the model alone.
    aimed : Requirements, optional
        What is to be met where no bandwidth is asked; with one it is what every design is held to.

    Raises
    ------
    ParameterError
        ``bandwidth``: more than the model allows with the margins of every design.
    """
    zeros = slowest_poles(dynamics.state_space)
    cut_off = given.derivative_filter
    if len(zeros) == 2 and cut_off == 0.0:
        cut_off = FILTER * 2.0 * np.pi / sample_time
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    plants = plants or (PossiblePlant(plant_state_space(dynamics)),)
    if bandwidth is not None:
        plants, aimed = plants[:1], REQUIRED

    def gains(g):
        Kp, Ki, Kd = pid_with_zeros(zeros, g, sample_time, cut_off)
        weights: dict[str, Any] = {"setpoint_weight": 1.0, "derivative_weight": 1.0}
        return replace(given, Kp=Kp, Ki=Ki, Kd=Kd, derivative_filter=cut_off, **weights)

    def judged(g):
        return judge_worst(pid_state_space(gains(g), sample_time).scaled(scale), plants, sample_time)

    leading = dynamics.matrices.dc_gain
    most = _largest_gain(judged, aimed, sign=1.0 if leading > 0.0 else -1.0, start=1.0 / abs(leading))
    if bandwidth is None:
        return gains(most)
    reachable = judged(most).bandwidth
    if not bandwidth <= reachable:
        allowed = (
            f"a PID reaches at most {reachable:.4g} Hz on this model with M_s ≤ {aimed.sensitivity_peak:g} and "
            f"a delay margin of {aimed.delay_margin:g} sample"
        )
        design.refuse("bandwidth", bandwidth, allowed)
    low, high = 0.0, 1.0
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        if judged(most * middle).bandwidth < bandwidth:
            low = middle
        else:
            high = middle
        if high - low < 1e-6 * high:
            break
    return gains(most * high)


def design_integral(given: PidParameters, dynamics, sample_time: float) -> PidParameters:
    """Return the largest integral gain, with nothing beside it, whose loop has M_s = 1.4 and the other margins.

    Parameters
    ----------
    given : PidParameters
        All but the gains is kept.
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        There is none.
    """
    plant, leading = plant_state_space(dynamics, scaled=False), dynamics.matrices.dc_gain

    def gains(Ki):
        return replace(given, Kp=0.0, Ki=Ki, Kd=0.0)

    def judged(Ki):
        return judge(pid_state_space(gains(Ki), sample_time), plant, sample_time)

    return gains(_largest_gain(judged, CALM, sign=1.0 if leading > 0.0 else -1.0, start=1.0 / abs(leading)))


def _largest_gain(judged, required: Requirements, sign: float, start: float) -> float:
    """Return the largest g whose loop meets the requirements, as with all smaller ones."""

    def good(g):
        return judged(sign * g).meets(required)

    low = start
    while not good(low):
        low *= 0.5
        if low < 1e-9 * start:
            design.refuse(
                "model.dynamics.A", None, "no PID with these zeros has the margins; choose another controller"
            )
    high = 2.0 * low
    while good(high) and high < 1e9 * start:
        low, high = high, 2.0 * high
    for _ in range(30):
        middle = 0.5 * (low + high)
        if good(middle):
            low = middle
        else:
            high = middle
    return sign * low
