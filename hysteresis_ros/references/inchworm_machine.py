# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The state machine of the inchworm sequencer as a kernel, one call a sample.

Both clamps close first. From then on every change of a clamp begins while the other one is closed: *holding* (both
closed) is the only state from which a clamp opens, and it decides what comes next from the setpoint, the measurements
and the requests. Phases that were begun are finished unless the motor shall stop: then the clamp that is open closes at
once and the extender brakes meanwhile.
"""

from __future__ import annotations

from hysteresis_ros.block import kernel
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.gait import cycloid, ramp
from hysteresis_ros.references.inchworm_steps import (
    account,
    drive_front,
    drive_rear,
    enter,
    fail,
    feel,
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
from hysteresis_ros.references.walk_machine import begin_walk, coast, stride


@kernel
def reach(p):
    """How far a step can move the slider [m], with the swing of a load."""
    return p[at.RUNAWAY] + 1.5 * (p[at.HIGHEST] - p[at.LOWEST] + p[at.MARGIN])


@kernel
def take_inputs(p, x, setpoint, slider, extender):
    """Take setpoint, measurements and request of this sample."""
    if x[at.WALKED] != 0.0 and x[at.SPEED] == 0.0:
        # after walking the motor stays where it is until the next setpoint
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
            x[at.ANCHOR] = slider  # a step may have gone on unseen
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
    """Choose what comes next while both clamps hold."""
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
    """Fine positioning: from now on the slider is measured, and the origin stays."""
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
    """Close the rear clamp too."""
    x[at.ARRIVED] = 0.0
    x[at.FINE_VELOCITY] = 0.0
    drive_rear(x, p[at.GRIP_VOLTAGE])
    enter(x, at.GRIPPING_REAR)


@kernel
def position(p, x):
    """One sample of fine positioning; leaves it when the setpoint is out of reach, or when the front clamp slips."""
    goal = x[at.TARGET] - x[at.ORIGIN]
    end = goal + x[at.PRETENSION]
    out_of_reach = end < lowest(p, x) - p[at.MARGIN] or end > highest(p, x) + p[at.MARGIN]
    if must_stop(p, x) or x[at.MODE] == at.LET_GO or x[at.SPEED] != 0.0 or out_of_reach:
        end_positioning(p, x)
        return
    x[at.FINE_ERROR] += p[at.SMOOTHING] * (x[at.TARGET] - x[at.SLIDER] - x[at.FINE_ERROR])
    slip = x[at.SLIDER] - x[at.EXTENDER] + x[at.PRETENSION] - x[at.ORIGIN]
    x[at.FINE_SLIP] += p[at.SMOOTHING] * (slip - x[at.FINE_SLIP])
    # sensors and creep drift for as long as they like; a clamp slips faster
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
    """A clamp has closed: judge the step, if there was one, and hold."""
    if x[at.JUDGE] != 0.0:
        x[at.JUDGE] = 0.0
        account(p, x)
    hold(x)


@kernel
def open_phase(p, x):
    """One sample of a phase in which one clamp opens or is open and the extender waits or moves."""
    phase = x[at.PHASE]
    if phase == at.CARRYING:
        feel(x)
    if must_stop(p, x):
        stop_here(p, x)
    elif phase == at.RELEASING_REAR:
        # slowly, so that the extender does not ring, and before the clamp opens
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
        elif x[at.MODE] == at.LET_GO:
            x[at.ANCHOR] = x[at.SLIDER]
            enter(x, at.RELEASED)
        else:
            x[at.RETURNS] += 1.0
            drive_front(x, p[at.GRIP_VOLTAGE])
            enter(x, at.GRIPPING_FRONT)


@kernel
def stopping(p, x):
    """One sample of stopping: the extender brakes in half the time the clamp takes to close."""
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
    """One sample of the present phase, which may end in another one."""
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
    """Fail when the slider is where nothing that was begun can have brought it."""
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
    """Advance by a sample and return the reference [m]; everything else is left in ``x``.

    Parameters
    ----------
    p, x : ndarray
        Parameters and state, see :mod:`hysteresis_ros.references.inchworm_layout`. Others may write ``x[REQUEST]`` and
        ``x[SPEED]`` before the call.
    setpoint : float
        Setpoint [m]; taken when it differs from the last one and lies within the travel.
    slider, extender : float
        Measured displacements [m]; NaN when there is none.
    """
    take_inputs(p, x, setpoint, slider, extender)
    guard(p, x)
    before = -1.0
    while x[at.PHASE] != before:  # a phase that ends here begins the next one in the same sample
        before = x[at.PHASE]
        walking = x[at.CYCLE]
        run_phase(p, x)
        if walking != 0.0 and x[at.CYCLE] != 0.0 and x[at.PHASE] != at.STOPPING:
            break  # the phase of the cycle says which process it is
    drive_clamps(p, x)
    x[at.REFERENCE] = x[at.TIP] - x[at.PRETENSION]
    if x[at.SOURCE] == at.BLOCKED:
        x[at.ORIGIN] = x[at.SLIDER] - x[at.REFERENCE]
    elif x[at.SOURCE] == at.OWN:
        fading = x[at.BIAS] * (1.0 - cycloid(x[at.MOVE_DONE]))
        x[at.ORIGIN] = x[at.SLIDER] - x[at.EXTENDER] + x[at.PRETENSION] + fading
    x[at.TIMER] += 1.0
    return x[at.REFERENCE]
