# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inchworm sequencer: state machine that computes clamp voltages and the extender's reference; file of a learned walk.

Both clamps close first. From then on, a clamp changes only while the other one is closed: *holding* (both closed) is
the only state from which a clamp opens. While both hold, the sequencer chooses the next phase from the setpoint, the
measurements and the requests. A phase runs to its end unless the motor must stop; in this case the open clamp closes
immediately while the extender brakes.

The sequencer replaces the reference generator. The motion controller's measurement is the slider position minus
:attr:`origin`. The origin is chosen so that the measurement is the displacement of the extender while the motor walks,
and the displacement of the slider in fine positioning. While both clamps hold, the controller receives its own
reference as measurement, because nothing can move and an integrator would wind up.
"""

from __future__ import annotations

import math
import pathlib
from typing import NamedTuple

import numpy as np
import yaml

from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.files import BoundsError, read_text, read_yaml, write_text
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, kernel
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_parameters import (
    BINS_PER_SPLINE,
    InchwormSequencerParameters,
    contacts,
    cycloid,
    inertia,
    learning_matrices,
    phase_bounds,
    ramp,
)
from hysteresis_ros.references.inchworm_steps import (
    GAIN,
    OFFSET,
    account,
    drive_front,
    drive_rear,
    enter,
    fail,
    feel,
    forget_all,
    highest,
    hold,
    let_go,
    load_time,
    lowest,
    move,
    moving,
    must_stop,
    next_step,
    next_walk,
    pretension,
    pretensioning,
    stop_here,
    weigh,
)
from hysteresis_ros.references.inchworm_walk import begin_walk, coast, stride
from hysteresis_ros.units import micrometres

#: First key of the file of a learned walk.
KIND = "inchworm_walk"
_HEADER = """\
# Learned correction of an inchworm's walk over the phase of its cycle; load it with walk.file of inchworm_sequencer.
# step [m]; coefficients [m] of a periodic cubic spline, forward and backward.
"""


class LearnedWalk(NamedTuple):
    """A learned walk: length of a cycle [m], and coefficients of each direction's correction [m], shape (splines,)."""

    step: float
    forward: np.ndarray
    backward: np.ndarray


def write_walk(path, learned: LearnedWalk) -> None:
    """Write a learned walk to a file; an existing file is replaced atomically."""
    values = {"step": learned.step, "forward": learned.forward.tolist(), "backward": learned.backward.tolist()}
    text = _HEADER + yaml.safe_dump({KIND: values}, sort_keys=False, default_flow_style=None, width=118)
    write_text(pathlib.Path(path).expanduser(), text, ConfigurationError)


def read_walk(path, splines: int, step: float, bound: float) -> LearnedWalk:
    """Read the file of a learned walk with ``splines`` coefficients for each direction.

    ``step`` is the length of a cycle, and ``bound`` the largest allowed coefficient, both from the parameters [m].
    ParameterError: the file is missing, is not a learned walk, or does not fit the parameters.
    """

    def refused(text):
        return ParameterError([Problem("walk.file", str(path), text)])

    try:
        found = read_yaml(read_text(path))[KIND]
        arrays = [np.array(found[name], dtype=float) for name in ("forward", "backward")]
        learned = LearnedWalk(float(found["step"]), *arrays)
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror or error}") from None
    except (BoundsError, KeyError, TypeError, ValueError, OverflowError, UnicodeDecodeError):
        raise refused("is not a file of a learned walk, as ~/save of inchworm_sequencer writes it") from None
    if learned.step != step:
        raise refused(f"was learned with steps of {learned.step:g} m; walk.step is {step:g} m: learn again")
    for array in arrays:
        if array.shape != (splines,):
            raise refused(f"has {array.size} coefficients; walk.splines is {splines}: learn again")
        if not np.all(np.abs(array) <= bound):
            raise refused(
                f"has a coefficient that is not finite or exceeds walk.bound = {bound:g} m: raise it or learn again"
            )
    return learned


@kernel
def reach(p):
    """Return the largest plausible motion of the slider in one step [m], including the oscillation of a load."""
    return p[at.RUNAWAY] + 1.5 * (p[at.HIGHEST] - p[at.LOWEST] + p[at.MARGIN])


@kernel
def take_inputs(p, x, setpoint, slider, extender):
    """Read setpoint, measurements and request of this sample."""
    if x[at.WALKED] != 0.0 and x[at.SPEED] == 0.0:
        # after continuous walking, the motor keeps its position until the next setpoint
        x[at.WALKED] = 0.0
        x[at.TARGET] = min(max(x[at.SLIDER], p[at.MINIMUM]), p[at.MAXIMUM])
    if setpoint != x[at.RECEIVED] and setpoint == setpoint:
        x[at.RECEIVED] = setpoint
        if setpoint >= p[at.MINIMUM] and setpoint <= p[at.MAXIMUM]:
            x[at.TARGET] = setpoint
        else:
            x[at.REFUSED] += 1.0
    finite = slider - slider == 0.0 and extender - extender == 0.0
    if finite:
        if x[at.BAD] > 0.0 and abs(slider - x[at.ANCHOR]) <= reach(p):
            x[at.ANCHOR] = slider  # a step may have continued without measurements
        x[at.SLIDER] = slider
        x[at.EXTENDER] = extender
        x[at.BAD] = 0.0
        if x[at.ERROR] == at.SENSOR_ERROR:
            x[at.ERROR] = at.NO_ERROR
    else:
        x[at.BAD] += 1.0
        if x[at.BAD] > p[at.SENSOR_SAMPLES] and x[at.ERROR] == at.NO_ERROR:
            x[at.ERROR] = at.SENSOR_ERROR
    request = x[at.REQUEST]
    x[at.REQUEST] = at.NO_REQUEST
    if request == at.START_REQUEST:
        x[at.MODE] = at.RUN
        x[at.STILL] = 0.0
        x[at.RETURNS] = 0.0
        x[at.ANCHOR] = x[at.SLIDER]
        x[at.ERROR] = at.SENSOR_ERROR if x[at.BAD] > p[at.SENSOR_SAMPLES] else at.NO_ERROR
    elif x[at.MODE] != at.FAILED:
        if request == at.STOP_REQUEST:
            x[at.MODE] = at.STOP
        elif request == at.HOME_REQUEST:
            x[at.MODE] = at.RUN
            x[at.SPEED] = 0.0
            x[at.TARGET] = p[at.HOME]
        elif request == at.RELEASE_REQUEST:
            x[at.MODE] = at.LET_GO
    if request == at.LEARN_REQUEST or request == at.FREEZE_REQUEST:
        x[at.LEARNS] = 1.0 if request == at.LEARN_REQUEST else 0.0
    elif request == at.FORGET_REQUEST:
        x[at.FORGETS] = 1.0


@kernel
def decide(p, x):
    """Choose the next phase while both clamps hold."""
    if must_stop(p, x):
        x[at.DIRECTION] = 0.0
        return
    if x[at.MODE] == at.LET_GO:
        let_go(x)
        x[at.ANCHOR] = x[at.SLIDER]
        x[at.DIRECTION] = 0.0
        pretension(p, x, 0.0)
        x[at.MOVE_TO] = p[at.RESTING]
        drive_front(x, p[at.RELEASE_VOLTAGE])
        enter(x, at.RELEASING_FRONT)
    elif x[at.SPEED] != 0.0:
        x[at.WALKED] = 1.0
        x[at.ARRIVED] = 0.0
        if p[at.CONTINUOUS] != 0.0:
            begin_walk(p, x)
        else:
            next_walk(p, x)
    else:
        x[at.LIMITED_SPEED] = 0.0
        next_step(p, x)


@kernel
def begin_positioning(x):
    """Begin fine positioning: from now on the controller measures the slider, and the origin stays fixed."""
    x[at.SOURCE] = at.FOLLOWING
    x[at.ORIGIN] = x[at.SLIDER] - x[at.EXTENDER] + x[at.PRETENSION]
    x[at.ANCHOR] = x[at.SLIDER]
    x[at.FINE_POSITION] = x[at.TIP] - x[at.PRETENSION]
    x[at.FINE_VELOCITY] = 0.0
    x[at.FINE_ERROR] = x[at.TARGET] - x[at.SLIDER]
    x[at.FINE_SLIP] = 0.0
    x[at.FINE_DRIFT] = 0.0
    x[at.FINE_LATE] = 0.0
    x[at.FINE_GOAL] = x[at.TARGET]
    enter(x, at.POSITIONING)


@kernel
def end_positioning(p, x):
    """End fine positioning: close the rear clamp, while the front one stays closed."""
    x[at.ARRIVED] = 0.0
    x[at.FINE_VELOCITY] = 0.0
    drive_rear(x, p[at.GRIP_VOLTAGE])
    enter(x, at.GRIPPING_REAR)


@kernel
def position(p, x):
    """Compute a sample of fine positioning; end it if the setpoint is out of range, or if the front clamp slips."""
    goal = x[at.TARGET] - x[at.ORIGIN]
    end = goal + x[at.PRETENSION]
    out_of_reach = end < lowest(p, x) - p[at.MARGIN] or end > highest(p, x) + p[at.MARGIN]
    if must_stop(p, x) or x[at.MODE] == at.LET_GO or x[at.SPEED] != 0.0 or out_of_reach:
        end_positioning(p, x)
        return
    x[at.FINE_ERROR] += p[at.SMOOTHING] * (x[at.TARGET] - x[at.SLIDER] - x[at.FINE_ERROR])
    slip = x[at.SLIDER] - x[at.EXTENDER] + x[at.PRETENSION] - x[at.ORIGIN]
    x[at.FINE_SLIP] += p[at.SMOOTHING] * (slip - x[at.FINE_SLIP])
    # drift and creep are slow and may go on without limit; a slipping clamp moves faster
    ahead = x[at.FINE_SLIP] - x[at.FINE_DRIFT]
    most = p[at.DRIFT] * p[at.SAMPLE_TIME]
    x[at.FINE_DRIFT] += min(max(ahead, -most), most)
    x[at.ARRIVED] = 1.0 if abs(x[at.FINE_ERROR]) <= p[at.TOLERANCE] else 0.0
    if x[at.TARGET] != x[at.FINE_GOAL]:
        x[at.FINE_GOAL] = x[at.TARGET]
        x[at.FINE_LATE] = 0.0
        x[at.ANCHOR] = x[at.SLIDER]
    if x[at.ARRIVED] != 0.0:
        x[at.FINE_LATE] = 0.0
        x[at.STILL] = 0.0
        x[at.DIRECTION] = 0.0
    else:
        x[at.FINE_LATE] += 1.0
    slips = abs(x[at.FINE_SLIP] - x[at.FINE_DRIFT]) > p[at.SLIP_LIMIT]
    if slips or x[at.FINE_LATE] > p[at.FINE_TIMEOUT]:
        x[at.SLIP] = -x[at.FINE_SLIP]
        x[at.MISSED] += 1.0
        x[at.STILL] += 1.0
        if x[at.STILL] >= p[at.STILL_STEPS]:
            fail(x, at.SLIP_ERROR if slips else at.NO_MOTION_ERROR)
        end_positioning(p, x)
        return
    # critically damped approach to the goal, no faster than the fine speed
    pull = (goal - x[at.FINE_POSITION]) / p[at.FINE_TIME] - 2.0 * x[at.FINE_VELOCITY]
    velocity = x[at.FINE_VELOCITY] + p[at.SAMPLE_TIME] / p[at.FINE_TIME] * pull
    x[at.FINE_VELOCITY] = min(max(velocity, -p[at.FINE_SPEED]), p[at.FINE_SPEED])
    x[at.FINE_POSITION] += p[at.SAMPLE_TIME] * x[at.FINE_VELOCITY]
    x[at.TIP] = x[at.FINE_POSITION] + x[at.PRETENSION]


@kernel
def held(p, x):
    """Handle closed clamps: evaluate the step, if there was one, and hold."""
    if x[at.JUDGE] != 0.0:
        x[at.JUDGE] = 0.0
        account(p, x)
    hold(x)


@kernel
def open_phase(p, x):
    """Compute a sample of a phase in which one clamp opens or is open and the extender waits or moves."""
    phase = x[at.PHASE]
    if phase == at.CARRYING:
        feel(x)
    if must_stop(p, x):
        stop_here(p, x)
    elif phase == at.RELEASING_REAR:
        # the load is transferred slowly before the clamp opens, so that the extender does not ring
        pretensioning(x, p[at.RELEASE_SAMPLES])
        wait = load_time(p, x)
        if x[at.TIMER] >= wait:
            drive_rear(x, p[at.RELEASE_VOLTAGE])
        if x[at.TIMER] >= wait + p[at.RELEASE_SAMPLES]:
            end = x[at.TIP] + x[at.DIRECTION] * x[at.EXTENSION] * (p[at.HIGHEST] - p[at.LOWEST])
            move(p, x, min(max(end, lowest(p, x)), highest(p, x)))
            x[at.GIVEN_WAY] = x[at.FELT] = 0.0
            enter(x, at.CARRYING)
    elif phase == at.RELEASING_FRONT:
        pretensioning(x, 0.5 * p[at.RELEASE_SAMPLES])
        if x[at.TIMER] >= p[at.RELEASE_SAMPLES]:
            move(p, x, x[at.MOVE_TO])
            enter(x, at.RETURNING)
    elif not moving(p, x):
        if phase == at.CARRYING:
            weigh(p, x)
            if x[at.FINAL] != 0.0:
                account(p, x)
                begin_positioning(x)
            else:
                x[at.JUDGE] = 1.0
                drive_rear(x, p[at.GRIP_VOLTAGE])
                enter(x, at.GRIPPING_REAR)
        elif x[at.MODE] == at.LET_GO and x[at.MOVE_TO] == p[at.RESTING]:
            # the return of a step ends elsewhere; it closes the front clamp, and the release begins from there
            x[at.ANCHOR] = x[at.SLIDER]
            enter(x, at.RELEASED)
        else:
            x[at.RETURNS] += 1.0
            drive_front(x, p[at.GRIP_VOLTAGE])
            enter(x, at.GRIPPING_FRONT)


@kernel
def stopping(p, x):
    """Compute a sample of stopping: the extender brakes within half the closing time of the clamp."""
    if x[at.CYCLE] != 0.0:
        coast(p, x)
    elif x[at.MOVE_RATE] > 0.0:
        x[at.MOVE_RATE] = max(x[at.MOVE_RATE] - 2.0 / p[at.GRIP_SAMPLES], 0.0)
        if x[at.MOVE_RATE] > 0.0:
            moving(p, x)
    if x[at.TIMER] >= p[at.GRIP_SAMPLES]:
        x[at.MOVE_RATE] = 0.0
        x[at.CYCLE] = 0.0
        hold(x)


@kernel
def run_phase(p, x):
    """Compute a sample of the present phase; this sample may begin another phase."""
    phase = x[at.PHASE]
    if x[at.CYCLE] != 0.0 and phase != at.STOPPING:
        stride(p, x)
    elif phase == at.HOLDING:
        decide(p, x)
    elif phase == at.GRIPPING_REAR or phase == at.GRIPPING_FRONT:
        if x[at.TIMER] >= p[at.GRIP_SAMPLES] - p[at.OVERLAP_SAMPLES]:
            held(p, x)
    elif phase == at.POSITIONING:
        position(p, x)
    elif phase == at.RELEASED:
        if x[at.MODE] == at.FAILED:
            stop_here(p, x)
        elif x[at.MODE] != at.LET_GO:
            drive_front(x, p[at.GRIP_VOLTAGE])
            enter(x, at.GRIPPING_FRONT)
    elif phase == at.STOPPING:
        stopping(p, x)
    elif phase == at.STARTING:
        if x[at.TIMER] >= 2.0 * p[at.GRIP_SAMPLES]:
            x[at.STARTED] = 1.0
            hold(x)
    else:
        open_phase(p, x)


@kernel
def guard(p, x):
    """Stop with an error if the slider has moved more than the present phase can explain."""
    if x[at.STARTED] == 0.0 or x[at.MODE] == at.FAILED or x[at.BAD] > 0.0:
        return
    limit = p[at.RUNAWAY]
    if x[at.PHASE] != at.HOLDING and x[at.PHASE] != at.RELEASED:
        limit = reach(p)
    if abs(x[at.SLIDER] - x[at.ANCHOR]) > limit:
        fail(x, at.RUNAWAY_ERROR)
        if x[at.PHASE] != at.HOLDING:
            stop_here(p, x)


@kernel
def drive_clamps(p, x):
    """Advance both voltage ramps by a sample."""
    x[at.FRONT_COUNT] += 1.0
    length = p[at.GRIP_SAMPLES] if x[at.FRONT_TO] == p[at.GRIP_VOLTAGE] else p[at.RELEASE_SAMPLES]
    if x[at.FRONT_COUNT] >= length:
        x[at.FRONT_VOLTAGE] = x[at.FRONT_TO]
    else:
        part = ramp(p[at.LINEAR_RAMP], x[at.FRONT_COUNT] / length)
        x[at.FRONT_VOLTAGE] = x[at.FRONT_FROM] + (x[at.FRONT_TO] - x[at.FRONT_FROM]) * part
    x[at.REAR_COUNT] += 1.0
    length = p[at.GRIP_SAMPLES] if x[at.REAR_TO] == p[at.GRIP_VOLTAGE] else p[at.RELEASE_SAMPLES]
    if x[at.REAR_COUNT] >= length:
        x[at.REAR_VOLTAGE] = x[at.REAR_TO]
    else:
        part = ramp(p[at.LINEAR_RAMP], x[at.REAR_COUNT] / length)
        x[at.REAR_VOLTAGE] = x[at.REAR_FROM] + (x[at.REAR_TO] - x[at.REAR_FROM]) * part


@kernel
def sequence(p, x, setpoint, slider, extender):
    """Advance by a sample and return the reference [m]; all other outputs are in ``x``.

    Parameters
    ----------
    p, x : ndarray
        Parameters and state, see :mod:`hysteresis_ros.references.inchworm_layout`. The caller may write ``x[REQUEST]``
        and ``x[SPEED]`` before the call.
    setpoint : float
        Setpoint [m]; it is used if it differs from the last one and lies within the travel.
    slider, extender : float
        Measured displacements [m]; NaN if there is no measurement.
    """
    take_inputs(p, x, setpoint, slider, extender)
    guard(p, x)
    before = -1.0
    while x[at.PHASE] != before:  # the next phase begins in the same sample
        before = x[at.PHASE]
        walking = x[at.CYCLE]
        run_phase(p, x)
        if walking != 0.0 and x[at.CYCLE] != 0.0 and x[at.PHASE] != at.STOPPING:
            break  # the phase of the cycle determines the process
    drive_clamps(p, x)
    x[at.REFERENCE] = x[at.TIP] - x[at.PRETENSION]
    if x[at.SOURCE] == at.BLOCKED:
        x[at.ORIGIN] = x[at.SLIDER] - x[at.REFERENCE]
    elif x[at.SOURCE] == at.OWN:
        fading = x[at.BIAS] * (1.0 - cycloid(x[at.MOVE_DONE]))
        x[at.ORIGIN] = x[at.SLIDER] - x[at.EXTENDER] + x[at.PRETENSION] + fading
    x[at.TIMER] += 1.0
    return x[at.REFERENCE]


class InchwormSequencer(Block):
    """Sequencer of an inchworm motor: reference and clamp voltages of each sample from setpoint and measurements.

    Parameters
    ----------
    parameters : InchwormSequencerParameters
        Gait, fine positioning, learning and guards.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        A parameter is wrong, or a duration is shorter than a sample.
    """

    kernel = staticmethod(sequence)

    def __init__(self, parameters: InchwormSequencerParameters, sample_time: float):
        walk = parameters.validated().walk
        self._walk = LearnedWalk(walk.step, np.zeros(walk.splines), np.zeros(walk.splines))
        if walk.continuous and walk.file:
            self._walk = read_walk(walk.file, walk.splines, walk.step, walk.bound)
        super().__init__(parameters, sample_time)

    def pack(self, parameters: InchwormSequencerParameters) -> np.ndarray:
        """Return the parameter array p; its layout is in :mod:`hysteresis_ros.references.inchworm_layout`."""
        gait, fine, guard = parameters.gait, parameters.fine, parameters.guard
        p = np.concatenate([np.zeros(at.PARAMETERS), *self._pack_learning(parameters)])

        def samples(duration: float, least: int) -> float:
            return float(max(round(duration / self.sample_time), least))

        p[at.SAMPLE_TIME] = self.sample_time
        p[at.RELEASE_SAMPLES] = samples(gait.release, 2)
        p[at.GRIP_SAMPLES] = samples(gait.grip, 2)
        p[at.EXTEND_SAMPLES] = samples(gait.extend, 2)
        p[at.CONTRACT_SAMPLES] = samples(gait.contract, 2)
        p[at.SETTLE_SAMPLES] = samples(gait.settle, 0)
        p[at.OVERLAP_SAMPLES] = min(samples(gait.overlap, 0), p[at.GRIP_SAMPLES] - 1.0)
        p[at.LINEAR_RAMP] = gait.clamp_ramp == "linear"
        p[at.GRIP_VOLTAGE] = gait.grip_voltage
        p[at.RELEASE_VOLTAGE] = gait.release_voltage
        p[at.LOWEST] = gait.lowest_extension
        p[at.HIGHEST] = gait.highest_extension
        p[at.MARGIN] = gait.fine_margin
        p[at.WINDOW] = gait.fine_window
        p[at.MINIMUM] = parameters.minimum
        p[at.MAXIMUM] = parameters.maximum
        p[at.HOME] = parameters.home_position
        p[at.RESTING] = parameters.resting_extension
        p[at.FINE_ENABLED] = fine.enabled
        p[at.TOLERANCE] = fine.tolerance
        p[at.FINE_SPEED] = fine.speed
        p[at.FINE_TIME] = max(fine.time, 2.0 * self.sample_time)
        p[at.FINE_TIMEOUT] = samples(fine.timeout, 1)
        smooth = fine.smoothing_time
        p[at.SMOOTHING] = 1.0 - elementary.exp(-self.sample_time / smooth) if smooth > 0.0 else 1.0
        p[at.LEARNING] = parameters.learning.enabled
        p[at.FORGETTING] = parameters.learning.forgetting
        p[at.STILL_STEPS] = guard.still_steps
        p[at.MISSED_PART] = guard.missed_part
        p[at.RUNAWAY] = guard.runaway
        p[at.SLIP_LIMIT] = guard.slip
        p[at.DRIFT] = guard.drift
        p[at.SENSOR_SAMPLES] = samples(guard.sensor_timeout, 0)
        exchange = p[at.RELEASE_SAMPLES] + p[at.GRIP_SAMPLES] - p[at.OVERLAP_SAMPLES] + p[at.SETTLE_SAMPLES]
        p[at.CYCLE_SAMPLES] = 2.0 * exchange + p[at.EXTEND_SAMPLES] + p[at.CONTRACT_SAMPLES]
        self._pack_walk(p, parameters)
        return p

    def _pack_walk(self, p: np.ndarray, parameters: InchwormSequencerParameters) -> None:
        gait, walk = parameters.gait, parameters.walk
        p[at.CONTINUOUS] = walk.continuous
        p[at.WALKING_STEP] = walk.step
        p[at.BLEND] = walk.blend
        p[at.LEAD] = 0.5 + walk.lead / self.sample_time
        p[at.BOUND] = walk.bound
        p[at.LEARNING_GAIN] = walk.gain
        p[at.LEARNING_RATE] = walk.learning_speed * self.sample_time / walk.step
        p[at.INERTIA] = inertia(walk.swing) / self.sample_time**2
        p[at.INERTIA_LAG] = 2.0 * walk.swing_damping * math.sqrt(p[at.INERTIA])
        p[at.TIP_INERTIA] = inertia(walk.resonance) / self.sample_time**2
        p[at.TIP_LAG] = 2.0 * walk.resonance_damping * math.sqrt(p[at.TIP_INERTIA])
        p[at.CLAMP_LEAD] = walk.clamp_lead / self.sample_time
        p[at.QUICK_CLAMPS] = walk.quick_clamps
        p[at.TOUCHES], p[at.LETS_GO] = contacts(walk, gait)
        p[at.SPLINES] = walk.splines if walk.continuous else 0.0
        p[at.BINS] = BINS_PER_SPLINE * p[at.SPLINES]
        p[at.FORWARD_BOUNDS : at.FORWARD_BOUNDS + 8] = phase_bounds(gait, 1)
        p[at.BACKWARD_BOUNDS : at.BACKWARD_BOUNDS + 8] = phase_bounds(gait, -1)

    @staticmethod
    def _pack_learning(parameters: InchwormSequencerParameters) -> list[np.ndarray]:
        gait, walk = parameters.gait, parameters.walk
        if not walk.continuous:
            return []
        return [part.ravel() for direction in (1, -1) for part in learning_matrices(walk, gait, direction)]

    def initial_state(self) -> np.ndarray:
        """Return the state x before the first sample: both clamps are about to close."""
        parameters = self.parameters
        gait, learning, walk = parameters.gait, parameters.learning, parameters.walk
        n, m = int(self.p[at.SPLINES]), int(self.p[at.BINS])
        x = np.zeros(at.STATES + 4 * n + 2 * m)
        x[at.LEARNS] = walk.learning
        if n:
            x[at.WALK : at.WALK + n] = self._walk.forward
            x[at.WALK + 2 * n : at.WALK + 3 * n] = self._walk.backward
        x[at.FRONT_VOLTAGE] = x[at.FRONT_FROM] = x[at.REAR_VOLTAGE] = x[at.REAR_FROM] = gait.initial_voltage
        x[at.FRONT_TO] = x[at.REAR_TO] = gait.grip_voltage
        x[at.PHASE] = at.STARTING
        x[at.MODE] = at.RUN
        x[at.MOVE_DONE] = 1.0
        x[at.TARGET] = x[at.RECEIVED] = parameters.initial_setpoint
        x[at.SPEED] = gait.walking_speed
        stroke = gait.stroke
        x[at.LOAD] = learning.load_deflection
        forget_all(x, at.FORWARD_MODEL, learning.forward_gain, learning.forward_offset / stroke)
        forget_all(x, at.BACKWARD_MODEL, learning.backward_gain, learning.backward_offset / stroke)
        return x

    def step(self, setpoint: float, slider: float, extender: float) -> float:
        """Return the reference [m] for setpoint and measurements [m] of this sample; other outputs are properties."""
        return self.kernel(self.p, self.x, float(setpoint), float(slider), float(extender))

    def refuse(self, setpoint: float) -> str | None:
        """Return why a setpoint [m] is refused, with its value and the range; None if it is accepted."""
        low, high = self.parameters.minimum, self.parameters.maximum
        if low <= setpoint <= high:
            return None
        reason = "outside of the travel" if math.isfinite(setpoint) else "not a finite number"
        return f"setpoint {micrometres(setpoint)} refused: {reason}, allowed: {micrometres(low, high)}"

    def request(self, code: int) -> None:
        """Request start, stop, home, release, learn, freeze or forget (codes of the layout), from the next sample on.

        Release opens the front clamp and relaxes the extender; the rear clamp still holds the slider.
        """
        self.x[at.REQUEST] = code

    def walk(self, speed: float) -> str | None:
        """Walk continuously at ``speed`` [m/s] from the next sample on; 0 holds the present position.

        Returns
        -------
        str or None
            Why the speed is refused, with the highest possible speed (nothing is changed then); None if it is accepted.
        """
        reason = self.parameters.refuse_speed(speed)
        if reason is None:
            self.x[at.SPEED] = speed
        return reason

    def scheduled(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] of the schedule at each of the first ``samples`` samples."""
        given = self.parameters.setpoints
        values = np.array([self.parameters.initial_setpoint, *given.values])
        first = [round(time / self.sample_time) for time in given.times]
        return values[np.searchsorted(np.array(first, dtype=float), np.arange(samples), side="right")]

    @property
    def duration_samples(self) -> int:
        """Length of the scheduled run in samples; 0 if no duration is given."""
        return round(self.parameters.setpoints.duration / self.sample_time)

    @property
    def reference(self) -> float:
        """Commanded displacement of the extender, or commanded slider position minus :attr:`origin` [m]."""
        return float(self.x[at.REFERENCE])

    @property
    def front_voltage(self) -> float:
        """Voltage [V] of the front clamp."""
        return float(self.x[at.FRONT_VOLTAGE])

    @property
    def rear_voltage(self) -> float:
        """Voltage [V] of the rear clamp."""
        return float(self.x[at.REAR_VOLTAGE])

    @property
    def origin(self) -> float:
        """Offset that the controller subtracts from the measured slider position [m]."""
        return float(self.x[at.ORIGIN])

    @property
    def phase(self) -> str:
        """Name of the present phase."""
        return at.PHASE_NAMES[int(self.x[at.PHASE])]

    @property
    def error(self) -> str:
        """Name of the present error; empty without an error."""
        return at.ERROR_NAMES[int(self.x[at.ERROR])]

    @property
    def arrived(self) -> bool:
        """Whether the slider is at the setpoint within the tolerance."""
        return bool(self.x[at.ARRIVED])

    @property
    def learned(self) -> dict[str, float]:
        """Learned step lengths, in the form of the initial parameters of ``learning``."""
        stroke = self.parameters.gait.stroke
        found = {"load_deflection": float(self.x[at.LOAD])}
        for way, first in (("forward", at.FORWARD_MODEL), ("backward", at.BACKWARD_MODEL)):
            found[f"{way}_gain"] = float(self.x[first + GAIN])
            found[f"{way}_offset"] = float(self.x[first + OFFSET] * stroke)
        return found

    @property
    def learned_walk(self) -> LearnedWalk:
        """Learned correction of continuous walking, with the length of its cycle."""
        n = int(self.p[at.SPLINES])
        starts = at.WALK, at.WALK + 2 * n
        return LearnedWalk(self.parameters.walk.step, *(self.x[first : first + n].copy() for first in starts))

    def require_continuous(self) -> None:
        """Refuse requests about learning if the motor walks in steps.

        Raises
        ------
        ParameterError
            Continuous walking is off.
        """
        if not self.parameters.walk.continuous:
            raise ParameterError(
                [Problem("walk.continuous", False, "must be true: only continuous walking learns a correction")]
            )

    def save(self, path=None) -> None:
        """Write the learned correction of continuous walking.

        Parameters
        ----------
        path : path-like, optional
            By default ``walk.save_file``.

        Raises
        ------
        ParameterError
            Continuous walking is off, or there is no file name.
        ConfigurationError
            The file cannot be written.
        """
        self.require_continuous()
        walk = self.parameters.walk
        if not (path or walk.save_file):
            raise ParameterError(
                [Problem("walk.save_file", "", "names no file; give one, because only this file can be written")]
            )
        write_walk(path or walk.save_file, self.learned_walk)

    def retune(self, parameters: InchwormSequencerParameters) -> None:
        """Refuse any change: the parameters of a motor are fixed while it is configured.

        Raises
        ------
        ParameterError
            The parameters differ from the present ones.
        """
        if parameters != self.parameters:
            raise ParameterError(
                [Problem("gait", "…", "fixed while the node is configured; clean up and configure again")]
            )
