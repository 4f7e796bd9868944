# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""PID controller in parallel form with derivative filter, setpoint weights and anti-windup.

.. math::

   u = u_{ff} + K_p (b r - y) + K_i \int e \, dt + K_d \frac{N}{s + N} \frac{d}{dt} (c r - y), \qquad e = r - y

in the model's units (see ``input_scale`` and ``output_scale`` of the linear model), with the cut-off N of the
derivative filter [rad/s].

The discretisation is exact for signals that are straight lines between the samples (first-order hold). With v = c r − y

.. math::

   I_k = I_{k-1} + K_i T \, \frac{e_k + e_{k-1}}{2}, \qquad
   D_k = a D_{k-1} + K_d (1 - a) \frac{v_k - v_{k-1}}{T}, \qquad a = e^{-N T}

(trapezoidal rule; N = 0: no filter, a = 0).

*Roll-off.* With a cut-off ω > 0 [rad/s], r and y each pass through two equal low-passes

.. math::

   f_k = f_{k-1} + (1 - e^{-\omega T}) (r_k - f_{k-1})

before the PID, so that the gain of the feedback falls with the square of the frequency above ω. The low-passes begin at
the measured position. A design uses them if nothing is known about the plant at high frequencies
(:mod:`hysteresis_ros.control.uncertainty`).

The first sample does not act as a step: I starts at the value that continues the command, and D starts at zero.

Anti-windup uses the achieved command. The excess is the part of the last command that lies beyond the controller's own
limits or the limits of the compensator. (The compensator reports the achieved command in ``x[APPLIED]``.) *clamping*
stops the integral while it would increase the excess; *back_calculation* adds −T/T_t · excess to the integral. With an
approximate inverse (Picard steps) the achieved command differs from the command even without saturation, so differences
below a threshold are ignored.

A design places the zeros of the discrete PID on the slowest poles of the model. Then the loop transfer function is g/(z
− 1) times the remaining dynamics. The response to the reference is close to a first-order lag, and its bandwidth
increases with g. The cancelled poles depend on the number of states of the model:

* no dynamics: the pole z = 0 of the one-sample delay (PI),
* one state: the lag's pole (PI),
* more: the slowest pair, or the two slowest real poles (PID).

References
----------
.. [1] Åström & Hägglund, Advanced PID Control, 2006, sections 3.2-3.5 (two degrees of freedom, windup) and 13.4.
.. [2] Auwal et al., equations of section 4 (gains K_P, K_I, K_D).
.. [3] Dahlin, Designing and tuning digital controllers, Instruments and Control Systems 41, 1968 (lambda tuning).
.. [4] Åström & Hägglund, Advanced PID Control, 2006, section 6.4 and 7.3 (M_s between 1.2 and 2).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.law import (
    APPLIED,
    COMMAND,
    ESTIMATED,
    FED,
    FEEDFORWARD,
    HEADER,
    STARTED,
    Controller,
    ControllerLaw,
    DesignTask,
    Tuning,
    bounded,
)
from hysteresis_ros.control.margins import AIMED, REQUIRED, Requirements, judge, plant_state_space
from hysteresis_ros.control.uncertainty import PossiblePlant, judge_worst
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.models.linear_algebra import eigenvalues, polynomial, solve

# Parameter array (begins with FED).
INPUT_SCALE = 1
OUTPUT_SCALE = 2
PRELOAD = 3
PROPORTIONAL = 4  # K_p
INTEGRAL_STEP = 5  # K_i T / 2
DERIVATIVE_STEP = 6  # K_d (1 − a) / T
DECAY = 7  # a
SETPOINT_WEIGHT = 8  # b
DERIVATIVE_WEIGHT = 9  # c
CLAMPING = 10
TRACKING = 11  # T / T_t, 0 without back-calculation
THRESHOLD = 12
LIMITED = 13
MINIMUM = 14
MAXIMUM = 15
REST_COMMAND = 16  # command that holds an output of 1
ROLL_OFF = 17  # exp(−ω T) of the low-passes, 0 without them
PARAMETERS = 18

# State array after the common part, in the model's units.
INTEGRAL = HEADER  # I, the integral's part of the command
DERIVATIVE = HEADER + 1  # D, the derivative's part of the command
LAST_REFERENCE = HEADER + 2  # [m]
LAST_MEASURED = HEADER + 3  # [m]
EXCESS = HEADER + 4  # part of the last command beyond the controller's own limits
LARGEST = HEADER + 5  # largest achieved command so far [m]
PROPORTION = HEADER + 6  # K_p (b r − y) of the last sample
FILTERED = HEADER + 7  # outputs of the low-passes: two of the reference, two of the measurement [m]
STATES = HEADER + 11


@kernel
def pid(p, x, reference, measured):
    """Return the command [m] for ``reference`` [m, without preload offset] and ``measured`` [m]."""
    applied = bounded(x[APPLIED])
    if abs(applied) > x[LARGEST]:
        x[LARGEST] = abs(applied)
    reference = bounded(reference)
    measured = bounded(measured)
    seen = measured
    if p[ROLL_OFF] != 0.0:
        a = p[ROLL_OFF]
        if x[STARTED] == 0.0:
            for i in range(FILTERED, STATES):
                x[i] = measured
        x[FILTERED] = bounded(a * x[FILTERED] + (1.0 - a) * reference)
        x[FILTERED + 1] = bounded(a * x[FILTERED + 1] + (1.0 - a) * x[FILTERED])
        x[FILTERED + 2] = bounded(a * x[FILTERED + 2] + (1.0 - a) * measured)
        x[FILTERED + 3] = bounded(a * x[FILTERED + 3] + (1.0 - a) * x[FILTERED + 2])
        reference = x[FILTERED + 1]
        measured = x[FILTERED + 3]
    r = reference / p[OUTPUT_SCALE]
    y = (measured - p[PRELOAD]) / p[OUTPUT_SCALE]
    fed = 0.0
    if p[FED] != 0.0:
        fed = bounded(x[FEEDFORWARD]) / p[INPUT_SCALE]
    if x[STARTED] == 0.0:
        # assume that the axis was at rest at its measured position, without error, with the achieved command
        x[STARTED] = 1.0
        holding = p[REST_COMMAND] * y
        last = applied / p[INPUT_SCALE]
        if applied == 0.0:
            last = holding  # the achieved command is unknown
        if p[FED] == 0.0:
            holding = 0.0
        x[INTEGRAL] = bounded(last - holding - p[PROPORTIONAL] * (p[SETPOINT_WEIGHT] * y - y))
        x[DERIVATIVE] = 0.0
    else:
        r_last = x[LAST_REFERENCE] / p[OUTPUT_SCALE]
        y_last = (x[LAST_MEASURED] - p[PRELOAD]) / p[OUTPUT_SCALE]
        step = p[INTEGRAL_STEP] * (r - y + r_last - y_last)
        excess = x[EXCESS]
        beyond = x[COMMAND] - applied
        if abs(beyond) > p[THRESHOLD] * x[LARGEST]:
            excess += beyond / p[INPUT_SCALE]
        if p[CLAMPING] != 0.0 and ((excess > 0.0 and step > 0.0) or (excess < 0.0 and step < 0.0)):
            step = 0.0
        x[INTEGRAL] = bounded(x[INTEGRAL] + step - p[TRACKING] * excess)
        change = p[DERIVATIVE_WEIGHT] * (r - r_last) - (y - y_last)
        x[DERIVATIVE] = bounded(p[DECAY] * x[DERIVATIVE] + p[DERIVATIVE_STEP] * change)
    x[LAST_REFERENCE] = reference
    x[LAST_MEASURED] = measured
    x[PROPORTION] = p[PROPORTIONAL] * (p[SETPOINT_WEIGHT] * r - y)
    wanted = bounded(fed + x[PROPORTION] + x[INTEGRAL] + x[DERIVATIVE])
    limited = wanted
    if p[LIMITED] != 0.0:
        limited = min(max(wanted, p[MINIMUM]), p[MAXIMUM])
    x[EXCESS] = wanted - limited
    command = bounded(limited * p[INPUT_SCALE])
    x[ESTIMATED] = seen
    x[COMMAND] = command
    x[APPLIED] = command
    return command


@dataclass(frozen=True)
class PidParameters(Parameters):
    """PID controller; gains are in the model's units."""

    Kp: float = parameter(0.0, description="Proportional gain (input unit over output unit of the model)")
    Ki: float = parameter(0.0, unit="1/s", description="Integral gain (input unit over output unit and second)")
    Kd: float = parameter(0.0, unit="s", description="Derivative gain (input unit times second over output unit)")
    derivative_filter: float = parameter(
        0.0, unit="rad/s", low=0.0, description="Cut-off N of the derivative's filter N/(s + N); 0: no filter"
    )
    roll_off: float = parameter(
        0.0,
        unit="rad/s",
        low=0.0,
        description="Cut-off of two first-order low-passes through which reference and measurement each pass; 0: none",
    )
    setpoint_weight: float = parameter(1.0, low=0.0, high=2.0, description="b: weight of the reference in the P part")
    derivative_weight: float = parameter(
        0.0, low=0.0, high=2.0, description="c: weight of the reference in the D part; 0: no derivative kick at steps"
    )
    anti_windup: str = parameter(
        "back_calculation",
        choices=("none", "clamping", "back_calculation"),
        description="What the integral does while the command is saturated: continue (none), stop (clamping), or "
        "follow the achieved command (back_calculation)",
    )
    tracking_time: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        description="T_t of back-calculation; 0: sqrt(Kd/Ki), or Kp/Ki if Kd = 0, or one sample time if Kp = 0 too",
    )
    anti_windup_threshold: float = parameter(
        0.02,
        low=0.0,
        description="Difference between command and achieved command, as a fraction of the largest achieved command "
        "so far, above which the command counts as saturated; raise it for a less exact inverse",
    )
    output_minimum: float = parameter(0.0, description="Smallest command (input unit); both limits 0: no limits")
    output_maximum: float = parameter(0.0, description="Largest command (input unit); both limits 0: no limits")

    def check(self):
        """Yield a Problem if all gains are 0 or the limits are reversed."""
        if self.Kp == 0.0 and self.Ki == 0.0 and self.Kd == 0.0:
            yield Problem("Kp", self.Kp, "Kp, Ki and Kd are all 0; give gains, or let `hysteresis design` find them")
        if self.limited and not self.output_minimum < self.output_maximum:
            remedy = f"must be above output_minimum = {self.output_minimum:g}; for no limits give 0 for both"
            yield Problem("output_maximum", self.output_maximum, remedy)

    @property
    def limited(self) -> bool:
        """Whether the controller has limits of its own."""
        return self.output_minimum != 0.0 or self.output_maximum != 0.0

    def decay(self, sample_time: float) -> float:
        """Return a = exp(−N T) of the derivative filter for ``sample_time`` [s]; 0 if there is no filter."""
        return elementary.exp(-self.derivative_filter * sample_time) if self.derivative_filter > 0.0 else 0.0

    def filtered(self, sample_time: float) -> float:
        """Return exp(−ω T) of the roll-off for ``sample_time`` [s]; 0 if there is no roll-off."""
        return elementary.exp(-self.roll_off * sample_time) if self.roll_off > 0.0 else 0.0

    def tracking(self, sample_time: float) -> float:
        """Return T / T_t of back-calculation for ``sample_time`` [s], at most 1; 0 for any other anti-windup."""
        if self.anti_windup != "back_calculation":
            return 0.0
        time = self.tracking_time
        if time == 0.0 and self.Ki != 0.0:
            time = math.sqrt(abs(self.Kd / self.Ki)) or abs(self.Kp / self.Ki)
        return min(sample_time / time, 1.0) if time > 0.0 else 1.0


def pid_state_space(parameters: PidParameters, sample_time: float) -> StateSpace:
    """Return the controller from (reference, measured) to command, in the model's units, with setpoint weights of 1.

    The states are the two low-passes of the roll-off, if any, then the integral and the filtered derivative, each only
    if its gain is not 0.
    """
    a = parameters.decay(sample_time)
    slope = parameters.Kd * (1.0 - a) / sample_time
    integral = parameters.Ki * sample_time
    B, D = np.array([[integral], [(a - 1.0) * slope]]), np.array([[parameters.Kp + 0.5 * integral + slope]])
    whole = StateSpace(np.diag([1.0, a]), np.hstack([B, -B]), np.ones((1, 2)), np.hstack([D, -D]))
    used = whole.part([i for i, gain in enumerate((parameters.Ki, parameters.Kd)) if gain != 0.0])
    return used if parameters.roll_off == 0.0 else _rolled_off(used, parameters.filtered(sample_time))


def _rolled_off(controller: StateSpace, a: float) -> StateSpace:
    """Return the series of two low-passes with the pole ``a`` and a controller of the error."""
    b = 1.0 - a
    rows = np.array([[b, -b], [b * b, -b * b]])  # from (reference, measured) to the filters' outputs in this sample
    A = np.block(
        [
            [np.array([[a, 0.0], [a * b, a]]), np.zeros((2, controller.order))],
            [controller.B[:, :1] * np.array([[a * b, a]]), controller.A],
        ]
    )
    B = np.vstack([rows, controller.B[:, :1] * rows[1]])
    C = np.hstack([controller.D[:, :1] * np.array([[a * b, a]]), controller.C])
    return StateSpace(A, B, C, controller.D[:, :1] * rows[1])


def require_stable_pid(parameters, sample_time: float | None) -> None:
    """Raise ParameterError for gains that make the controller's own model unstable.

    Nothing is checked without a sample time, or without a model. There is no model if A is missing and the input scale
    is not 0, because in this case the gain is unknown.
    """
    dynamics, gains = parameters.model.dynamics, parameters.pid
    if sample_time is None:
        return
    if not dynamics.order and dynamics.input_scale != 0.0:
        return
    plant, controller = dynamics.state_space.held(), pid_state_space(gains, sample_time)
    measured, through = controller.B[:, 1:], controller.D[0, 0]
    loop = np.block(
        [[plant.A - through * plant.B @ plant.C, plant.B @ controller.C], [measured @ plant.C, controller.A]]
    )
    values = (gains.Kp, gains.Ki, gains.Kd)
    state_feedback.require_stable(loop, "pid.Kp, Ki, Kd", values, "the controlled model")


class Pid(Controller):
    """PID controller.

    Parameters
    ----------
    parameters : ControllerParameters
        With ``type`` pid.
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(pid)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array, shape (18,)."""
        gains, dynamics = parameters.pid, parameters.model.dynamics
        require_stable_pid(parameters, self.sample_time)
        a = gains.decay(self.sample_time)
        gain = dynamics.state_space.dc_gain
        p = np.zeros(PARAMETERS)
        p[FED] = parameters.feedforward.type != "none"
        p[INPUT_SCALE] = dynamics.resolved_input_scale
        p[OUTPUT_SCALE] = dynamics.output_scale
        p[PRELOAD] = parameters.model.preload.offset
        p[PROPORTIONAL] = gains.Kp
        p[INTEGRAL_STEP] = 0.5 * gains.Ki * self.sample_time
        p[DERIVATIVE_STEP] = gains.Kd * (1.0 - a) / self.sample_time
        p[DECAY] = a
        p[SETPOINT_WEIGHT] = gains.setpoint_weight
        p[DERIVATIVE_WEIGHT] = gains.derivative_weight
        p[CLAMPING] = gains.anti_windup == "clamping"
        p[TRACKING] = gains.tracking(self.sample_time) if gains.Ki != 0.0 else 0.0
        p[THRESHOLD] = gains.anti_windup_threshold
        p[LIMITED] = gains.limited
        p[MINIMUM] = gains.output_minimum
        p[MAXIMUM] = gains.output_maximum
        p[ROLL_OFF] = gains.filtered(self.sample_time)
        p[REST_COMMAND] = 1.0 / gain if gain != 0.0 else 0.0
        return p

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(STATES)

    def retune(self, parameters) -> None:
        """Change the gains while running; the integral compensates the resulting change of the command.

        Raises
        ------
        ParameterError
            The parameters are wrong or make the controlled model unstable; in this case the controller is not changed.
        """
        before = self.p.copy()
        super().retune(parameters)
        x, p = self.x, self.p
        if x[STARTED] == 0.0:
            return
        if before[ROLL_OFF] == 0.0:
            x[FILTERED : FILTERED + 2], x[FILTERED + 2 : STATES] = x[LAST_REFERENCE], x[LAST_MEASURED]
        for place in (INTEGRAL, DERIVATIVE, PROPORTION, EXCESS):
            x[place] *= before[INPUT_SCALE] / p[INPUT_SCALE]
        r = x[LAST_REFERENCE] / p[OUTPUT_SCALE]
        y = (x[LAST_MEASURED] - p[PRELOAD]) / p[OUTPUT_SCALE]
        proportion = p[PROPORTIONAL] * (p[SETPOINT_WEIGHT] * r - y)
        x[INTEGRAL] += x[PROPORTION] - proportion
        x[PROPORTION] = proportion


#: Requirements of a purely integral controller.
CALM = replace(REQUIRED, sensitivity_peak=1.4)
#: Modulus below which poles count as poles of a delay: if several poles are at 0, computed poles have about this error.
AT_ZERO = 1e-3
#: Default cut-off of the derivative filter, as a fraction of the sampling frequency [rad/s].
FILTER = 0.2
#: A slow pole is not cancelled if it contributes less than this fraction of the step response. (The high-pass of a
#: damping filter has such a pole, with a zero near it.)
LITTLE = 0.02
#: Distance from a pole at which its residue is evaluated, as a fraction of the pole's distance from 1.
NEAR = 1e-4
#: Number of steps of the search for the gain.
STEPS = 60


def pid_with_zeros(zeros, gain: float, sample_time: float, derivative_filter: float):
    """Return (K_p, K_i, K_d) of a discrete PID with numerator g (z − z₁)(z − z₂), or g (z − z₁) for a PI.

    ``zeros`` contains one zero for a PI and two zeros (real or a conjugate pair) for a PID; ``gain`` is g. Units:
    ``sample_time`` [s], ``derivative_filter`` [rad/s].
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


def slowest_poles(model: StateSpace, poles: list[complex] | None = None) -> list[complex]:
    """Return the one or two poles that a PI or PID cancels, from ``poles`` or the model's exact poles."""
    if not model.order:
        return [0.0]
    poles = sorted(eigenvalues(model.A) if poles is None else poles, key=_slowness, reverse=True)
    # poles at zero are a delay, which a zero cannot cancel
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
    """Return the fraction of the step response that decays with the given real pole."""
    near = NEAR * (1.0 - pole)
    residue = near * complex(model.response([pole + near])[0, 0, 0])
    return abs(residue / (1.0 - pole) / model.dc_gain)


def _slowness(pole: complex) -> float:
    return pole.real * pole.real + pole.imag * pole.imag  # abs() would use hypot of the C library


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
        Parameters. The design replaces the gains and the setpoint weights, removes a roll-off, and chooses the cut-off
        of the derivative filter if a PID needs it and the given cut-off is 0.
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]
    bandwidth : float, optional
        Frequency at which the response to the reference has fallen by 3 dB [Hz]; by default the highest frequency that
        the plants allow.
    plants : tuple of PossiblePlant, optional
        Plants on which the requirements must hold, the model first; by default the model alone.
    aimed : Requirements, optional
        Requirements of a design without a given bandwidth. With a given bandwidth, :data:`REQUIRED` applies.

    Raises
    ------
    ParameterError
        ``bandwidth`` is larger than the model allows with the margins required of every design.
    """
    if bandwidth is None:
        return _cancelling(given, dynamics, sample_time)(_largest(given, dynamics, sample_time, plants, aimed))
    plants, aimed = plants[:1], REQUIRED
    gains, most = _cancelling(given, dynamics, sample_time), _largest(given, dynamics, sample_time, plants, aimed)

    def judged(g):
        return _judged(gains(g), dynamics, sample_time, plants)

    reachable = judged(most).bandwidth
    if not bandwidth <= reachable:
        remedy = (
            f"a PID reaches at most {reachable:.4g} Hz on this model with M_s ≤ {aimed.sensitivity_peak:g} and "
            f"a delay margin of {aimed.delay_margin:g} sample"
        )
        state_feedback.refuse("bandwidth", bandwidth, remedy)
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


def _cancelling(given: PidParameters, dynamics, sample_time: float) -> Callable[[float], PidParameters]:
    """Return the PID that cancels the slowest poles of a model, as a function of the gain g of its numerator."""
    zeros, cut_off = slowest_poles(dynamics.state_space), given.derivative_filter
    if len(zeros) == 2 and cut_off == 0.0:
        cut_off = FILTER * 2.0 * np.pi / sample_time

    def gains(g):
        Kp, Ki, Kd = pid_with_zeros(zeros, g, sample_time, cut_off)
        weights: dict[str, Any] = {"setpoint_weight": 1.0, "derivative_weight": 1.0, "roll_off": 0.0}
        return replace(given, Kp=Kp, Ki=Ki, Kd=Kd, derivative_filter=cut_off, **weights)

    return gains


def _judged(gains: PidParameters, dynamics, sample_time: float, plants, **options):
    """Return the worst figures over the plants, or the figures of the model if there are no plants."""
    scale = dynamics.resolved_input_scale / dynamics.output_scale
    controller = pid_state_space(gains, sample_time).scaled(scale)
    return judge_worst(controller, plants or (PossiblePlant(plant_state_space(dynamics)),), sample_time, **options)


@functools.lru_cache(maxsize=4)  # a search over bandwidths needs the same gain each time
def _largest(given: PidParameters, dynamics, sample_time: float, plants, aimed: Requirements) -> float:
    """Return the largest gain g of the numerator with which the requirements are met on all plants."""
    gains = _cancelling(given, dynamics, sample_time)

    def judged(g):
        return _judged(gains(g), dynamics, sample_time, plants, required=aimed, with_bandwidth=False)

    return _largest_gain(judged, aimed, dynamics)


def design_integral(given: PidParameters, dynamics, sample_time: float) -> PidParameters:
    """Return the largest gain of a purely integral controller with M_s ≤ 1.4 that meets the other margins.

    ParameterError: there is no such gain.
    """
    plant = plant_state_space(dynamics, scaled=False)

    def gains(Ki):
        return replace(given, Kp=0.0, Ki=Ki, Kd=0.0, roll_off=0.0)

    def judged(Ki):
        return judge(pid_state_space(gains(Ki), sample_time), plant, sample_time, with_bandwidth=False)

    return gains(_largest_gain(judged, CALM, dynamics))


def _largest_gain(judged, required: Requirements, dynamics) -> float:
    """Return the largest gain g for which g and all smaller gains meet the requirements."""
    leading = dynamics.matrices.dc_gain
    sign, start = 1.0 if leading > 0.0 else -1.0, 1.0 / abs(leading)

    def good(g):
        return judged(sign * g).meets(required)

    low = start
    while not good(low):
        low *= 0.5
        if low < 1e-9 * start:
            state_feedback.refuse(
                "model.dynamics.A",
                dynamics.A,
                "no PID that cancels the slowest poles has the required margins; choose another controller",
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


#: Damping ratio below which a cancelled pair of poles rings noticeably after a disturbance.
LITTLE_DAMPING = 0.1


def designed(task: DesignTask):
    """Return the parameters with the gains of :func:`~hysteresis_ros.control.laws.pid.design_pid`."""
    given = task.parameters
    dynamics, T = given.model.dynamics, task.sample_time
    gains = design_pid(given.pid, dynamics, T, task.bandwidth, plants=task.plants, aimed=task.aimed)
    return replace(given, pid=gains)


def near_rest(parameters):
    """Return the parameters without the controller's own limits."""
    return replace(parameters, pid=replace(parameters.pid, output_minimum=0.0, output_maximum=0.0))


def rows(parameters, sample_time: float):
    """Yield (name, text) of each row that a design prints."""
    gains = parameters.pid
    yield "Kp, Ki, Kd", f"{gains.Kp:.6g}, {gains.Ki:.6g} 1/s, {gains.Kd:.6g} s"
    if gains.Kd:
        yield "derivative filter", f"{gains.derivative_filter:.6g} rad/s"
    if gains.roll_off:
        yield "roll-off", f"two low-passes of {gains.roll_off:.6g} rad/s ({gains.roll_off / (2.0 * np.pi):.4g} Hz)"


def doubts(parameters, sample_time: float, tuned: bool):
    """Yield a warning about cancelled poles with little damping; a controller without zeros cancels nothing."""
    if not (parameters.pid.Kp or parameters.pid.Kd):
        return
    pole = slowest_poles(parameters.model.dynamics.state_space)[0]
    logarithm = np.log(pole) if abs(pole) > 0.0 else -np.inf
    damping = -np.real(logarithm) / abs(logarithm) if np.isfinite(logarithm) else 1.0
    if damping < LITTLE_DAMPING and not tuned:
        hertz = abs(logarithm) / (2.0 * np.pi * sample_time)
        yield (
            f"the pid cancels poles at {hertz:.4g} Hz with damping {damping:.2g}: the reference does "
            "not excite them, but disturbances do, and pid does not damp them; offset_free damps them"
        )


def started(parameters, sample_time: float):
    """Return the parameters with which a tuning starts: the gains of a design by lambda tuning."""
    return replace(parameters, pid=design_pid(parameters.pid, parameters.model.dynamics, sample_time))


def loop(parameters, sample_time: float):
    """Return controller and model in the model's units."""
    return pid_state_space(parameters.pid, sample_time), plant_state_space(parameters.model.dynamics, scaled=False)


CONTROLLER = ControllerLaw(
    name="pid",
    block=Pid,
    description="PID with derivative filter, setpoint weights and anti-windup",
    groups={"pid": PidParameters},
    check=require_stable_pid,
    near_rest=near_rest,
    designs={"pid": designed},
    rows=rows,
    doubts=doubts,
    tuning=Tuning(("Kp", "Ki", "Kd"), started, loop),
)
