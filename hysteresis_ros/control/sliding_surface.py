# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the sliding mode controllers share: the switching function on the estimated state, and how commands leave.

With x* the state where the plant should be and x_e = x̂ - x* the distance from it, s = S x_e and Λ = S B:

rest point     x* = N_x r, u* = N_u r: where the model rests under the reference
trajectory     x*⁺ = A x* + B u_ff, u* = u_ff: where the model is under the feedforward ``inverse_dynamics``

The trajectory starts at rest on the reference. With a static feedforward, whose command is that of the rest point, the
rest point stays the target: the model answers a static command by ringing, which nobody wants to be followed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hysteresis_ros.block import kernel
from hysteresis_ros.control import design
from hysteresis_ros.control.base import (
    APPLIED,
    COMMAND,
    DISTURBANCE,
    ESTIMATED,
    FED,
    FEEDFORWARD,
    HEADER,
    STARTED,
    SWITCHING,
    Controller,
    bounded,
)
from hysteresis_ros.control.kalman import (
    ESTIMATE,
    MATRICES,
    OFFSET,
    RUNNING,
    filter_length,
    input_matrix,
    kalman_state_size,
    kalman_step,
    pack_kalman,
    rest_state,
)
from hysteresis_ros.control.sliding_design import design_sliding_mode
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.state_space import advance

# Parameter array: a head (FED first), then K and S (n entries each), then the Kalman filter's.
N = 1
INTEGRATING = 2
INPUT_SCALE = 3
OUTPUT_SCALE = 4
PRELOAD = 5
REST_COMMAND = 6
INTEGRAL_GAIN = 7
INTEGRAL_HYPERPLANE = 8
SLOPE = 9
LEVEL = 10
WIDTH = 11
THRESHOLD = 12
MOVING = 13  # 1.0: the target is the trajectory under the feedforward
LAMBDA = 14  # S B
PHI = 15
OWN = 16  # first of three entries that each law uses for itself
GAINS = 19

# State array after the common part, then the Kalman filter's, then the trajectory and n places for the next one.
INTEGRAL = HEADER  # of the error
LARGEST = HEADER + 1  # largest applied command so far [m]
LINEAR = HEADER + 2  # K x_e
TARGET = HEADER + 3  # u*
MEMORY = HEADER + 4  # first of two entries that each law uses for itself
LAST = HEADER + 6  # last command of the law itself, in the model's units
BEGUN = HEADER + 7  # 0.0: the law has not run yet, or has to begin anew
OBSERVER = HEADER + 8


@kernel
def switching_function(p, x, reference, measured):
    """Update observer, integral and trajectory; return s and leave K x_e, u* and the estimates in x.

    While the measurement is NaN the observer goes on by its model, without an innovation.
    """
    n = int(p[N])
    hyperplane = GAINS + n
    observer = hyperplane + n
    rest = rest_state(p, observer)
    ahead = OBSERVER + filter_length(p, observer)
    applied = bounded(x[APPLIED])
    if abs(applied) > x[LARGEST]:
        x[LARGEST] = abs(applied)
    r = bounded(reference) / p[OUTPUT_SCALE]
    y = measured
    if measured == measured:
        y = (bounded(measured) - p[PRELOAD]) / p[OUTPUT_SCALE]
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        x[OBSERVER + RUNNING] = 0.0
        for i in range(n):
            x[ahead + i] = bounded(p[rest + i] * r)
    estimated = kalman_step(p, x, observer, OBSERVER, applied / p[INPUT_SCALE], y)
    if y != y:
        y = estimated
    s = 0.0
    linear = 0.0
    if p[MOVING] != 0.0:
        fed = bounded(x[FEEDFORWARD]) / p[INPUT_SCALE]
        x[TARGET] = fed
        for i in range(n):
            distance = x[OBSERVER + ESTIMATE + i] - x[ahead + i]
            s += p[hyperplane + i] * distance
            linear += p[GAINS + i] * distance
        advance(p, observer + MATRICES, input_matrix(p, observer), x, ahead, n, fed)
        for i in range(n):
            x[ahead + i] = bounded(x[ahead + i])
    else:
        x[TARGET] = p[REST_COMMAND] * r
        for i in range(n):
            distance = x[OBSERVER + ESTIMATE + i] - p[rest + i] * r
            s += p[hyperplane + i] * distance
            linear += p[GAINS + i] * distance
    if p[INTEGRATING] != 0.0:
        error = r - y
        # Integrating moves the command by -INTEGRAL_GAIN * error.
        if not widens(p, x, applied, -p[INTEGRAL_GAIN] * error):
            x[INTEGRAL] = bounded(x[INTEGRAL] + error)
        s += p[INTEGRAL_HYPERPLANE] * x[INTEGRAL]
        linear += p[INTEGRAL_GAIN] * x[INTEGRAL]
    x[LINEAR] = linear
    x[ESTIMATED] = bounded(estimated * p[OUTPUT_SCALE] + p[PRELOAD])
    return bounded(s)


@kernel
def widens(p, x, applied, change):
    """Tell whether commands are not carried out and ``change`` of the command would lead further beyond the limits."""
    excess = x[COMMAND] - applied
    return abs(excess) > p[THRESHOLD] * x[LARGEST] and change * (excess / p[INPUT_SCALE]) > 0.0


@kernel
def boundary_layer(p, s):
    """Return (η |Λ|⁻¹ |s| + β) sign(Λ) s / (|s| + δ), the nonlinear part of the law."""
    width = abs(s) + p[WIDTH]
    nonlinear = 0.0
    if width > 0.0:
        nonlinear = (p[SLOPE] * abs(s) + p[LEVEL]) * (s / width)
    return nonlinear


@kernel
def leave(p, x, s, command):
    """Note and return the command [m], given in the model's units."""
    command = bounded(command)
    x[LAST] = command
    x[BEGUN] = 1.0
    command = bounded(command * p[INPUT_SCALE])
    x[SWITCHING] = s
    x[COMMAND] = command
    x[DISTURBANCE] = bounded(x[OBSERVER + OFFSET] * p[INPUT_SCALE])
    x[APPLIED] = command
    return command


@lru_cache(maxsize=16)
def pack_surface(parameters, sample_time: float | None):
    """Return design and parameter array of head, K, S and Kalman filter: checked and designed only once.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float or None
        Sample time [s]; only a periodic disturbance needs it.

    Returns
    -------
    gains : SlidingModeDesign
    packed : ndarray
        Read only; the entries from ``OWN`` are zero.

    Raises
    ------
    ParameterError
        The design fails; names are relative to the controller's parameters.
    """
    dynamics, smc, kalman = parameters.model.dynamics, parameters.sliding_mode, parameters.kalman
    if not dynamics.order:
        design.refuse("model.dynamics.A", dynamics.A, "sliding mode needs a model; give A, B, C or choose open_loop")
    integral = smc.tracking == "integral"
    if integral and kalman.disturbance != "none":
        raise ParameterError(
            [
                Problem(
                    "kalman.disturbance",
                    kalman.disturbance,
                    "together with sliding_mode.tracking = 'integral' are two integrators for one offset; "
                    "set kalman.disturbance to none or sliding_mode.tracking to target",
                )
            ]
        )
    model = dynamics.state_space
    n = model.order
    filtering = pack_kalman(kalman, model, sample_time)
    gains = design_sliding_mode(smc, model)
    _, rest_input = design.steady_state(model)
    sign = 1.0 if gains.switching_gain > 0.0 else -1.0
    head = np.zeros(GAINS)
    head[FED] = parameters.feedforward.type != "none"
    head[N] = n
    head[INTEGRATING] = integral
    head[INPUT_SCALE] = dynamics.resolved_input_scale
    head[OUTPUT_SCALE] = dynamics.output_scale
    head[PRELOAD] = parameters.model.preload.offset
    head[REST_COMMAND] = rest_input
    head[INTEGRAL_GAIN] = gains.K[n] if integral else 0.0
    head[INTEGRAL_HYPERPLANE] = gains.S[n] if integral else 0.0
    head[SLOPE] = sign * smc.eta / abs(gains.switching_gain)
    head[LEVEL] = sign * smc.beta
    head[WIDTH] = smc.delta
    head[THRESHOLD] = smc.anti_windup_threshold
    head[MOVING] = parameters.feedforward.type == "inverse_dynamics"
    head[LAMBDA] = gains.switching_gain
    head[PHI] = smc.phi
    packed = np.concatenate([head, gains.K[:n], gains.S[:n], filtering])
    packed.flags.writeable = False
    return gains, packed


def require_target(parameters) -> None:
    """Refuse integral tracking beside a law that integrates by itself.

    Raises
    ------
    ParameterError
        ``sliding_mode.tracking``.
    """
    if parameters.sliding_mode.tracking == "integral":
        design.refuse(
            "sliding_mode.tracking",
            "integral",
            f"{parameters.type} integrates by itself: two integrators for one offset; set it to target",
        )


def check_with(packed):
    """Return the check of a sliding mode controller: it is designed once, with ``packed(parameters, sample_time)``.

    Parameters
    ----------
    packed : callable
        Raises ParameterError where the design fails.
    """

    def check(parameters, sample_time: float | None) -> None:
        if sample_time is not None or parameters.kalman.disturbance != "periodic":
            packed(parameters, sample_time)

    return check


class SlidingController(Controller):
    """Base of the sliding mode controllers.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s]; the model is discrete at this time.
    """

    predicts = True
    runs_beside = True

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample; the observer then starts from rest at the measurement."""
        order = self.parameters.model.dynamics.order
        return np.zeros(OBSERVER + kalman_state_size(self.parameters.kalman, order) + 2 * order)

    @property
    def estimate(self) -> np.ndarray:
        """The estimated state in the model's units, shape (n,); a copy."""
        first = OBSERVER + ESTIMATE
        return self.x[first : first + self.parameters.model.dynamics.order].copy()

    def shares_observer(self, other: Controller) -> bool:
        """Tell whether both have the same Kalman filter of the same model, and the same kind of target."""
        if not isinstance(other, SlidingController):
            return False
        mine, theirs = self.parameters, other.parameters
        same = mine.model == theirs.model and mine.kalman == theirs.kalman and self.sample_time == other.sample_time
        return same and mine.feedforward == theirs.feedforward

    def continue_from(self, predecessor: Controller) -> None:
        """Take over the observer and the trajectory of a controller with the same ones."""
        self.x[OBSERVER:] = predecessor.x[OBSERVER:]
        self.x[LARGEST] = predecessor.x[LARGEST]
        self.x[STARTED] = predecessor.x[STARTED]

    def forget(self) -> None:
        """Drop what the law has integrated while another one is in charge, whose errors these are."""
        self.x[INTEGRAL] = 0.0

    def settle(self, applied: float) -> bool:
        """Set what the law integrates so that the command goes on from ``applied`` [m]; False when it cannot."""
        if self.p[INTEGRATING] == 0.0 or self.p[INTEGRAL_GAIN] == 0.0 or self.x[BEGUN] == 0.0:
            return False
        # forgotten, the integral has no part in the last command
        self.x[INTEGRAL] = (self.x[LAST] - applied / self.p[INPUT_SCALE]) / self.p[INTEGRAL_GAIN]
        return True

    def retune(self, parameters) -> None:
        """Take new gains or a new model while running; a new model makes the observer start again from rest.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; the controller is unchanged then.
        """
        before = self.parameters.model
        super().retune(parameters)
        if parameters.model != before:
            # The old estimate is in the coordinates of the old model.
            self.x[STARTED] = 0.0
