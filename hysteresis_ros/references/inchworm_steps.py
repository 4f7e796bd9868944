# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Steps of the inchworm sequencer: learned length, motions of clamps and extender, and evaluation of a step.

The model of a step is z = gain u + offset, with the commanded extension u and the motion z of the slider in the same
direction, both as fractions of the full stroke. The offset represents the load (with opposite signs in the two
directions) and the loss when a clamp closes; the gain represents all other effects. Reference: Åström & Wittenmark,
*Adaptive Control*, 2nd edition 1995, section 2.2. Forgetting pauses while a variance is as large as at the start: full
steps alone cannot separate gain and offset, and with forgetting the variance would then grow without bound. The gain is
bounded. The offset is not, because it contains the load.
"""

from __future__ import annotations

import math

from hysteresis_ros.models.block import called, kernel
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_parameters import cycloid

# Layout of the model of one direction in the state x.
GAIN = 0
OFFSET = 1
COVARIANCE = 2  # variance of the gain, covariance of gain and offset, variance of the offset
SIZE = 5

#: Standard deviations of gain and offset before the first step, and of the measured length of a step.
GAIN_DEVIATION = 0.05
OFFSET_DEVIATION = 0.5
STEP_DEVIATION = 2.0e-3

#: Bounds of the gain.
LOWEST_GAIN = 0.5
HIGHEST_GAIN = 1.5

#: Bounds of the length that the model predicts for the longest step, as fractions of the step's extension.
SHORTEST = 0.1
LONGEST = 2.0


@kernel
def forget_all(x, at, gain, offset):
    """Write the initial ``gain`` and ``offset`` into ``x[at:at + 5]``."""
    x[at + GAIN] = gain
    x[at + OFFSET] = offset
    x[at + COVARIANCE] = GAIN_DEVIATION * GAIN_DEVIATION
    x[at + COVARIANCE + 1] = 0.0
    x[at + COVARIANCE + 2] = OFFSET_DEVIATION * OFFSET_DEVIATION


@kernel
def longest_step(x, at, usable):
    """Return the length of the longest step, which has the extension ``usable``, both as fractions of the stroke."""
    return min(max(x[at + GAIN] * usable + x[at + OFFSET], SHORTEST * usable), LONGEST)


@kernel
def extension_for(x, at, length):
    """Return the extension, 0 … 1, with which the slider moves by ``length``, both as fractions of the stroke."""
    return min(max((length - x[at + OFFSET]) / max(x[at + GAIN], LOWEST_GAIN), 0.0), 1.0)


@kernel
def learn(x, at, forgetting, u, z):
    """Update the model by a step in which the extension ``u`` moved the slider by ``z``."""
    a = x[at + COVARIANCE]
    b = x[at + COVARIANCE + 1]
    c = x[at + COVARIANCE + 2]
    first = a * u + b
    second = b * u + c
    scale = STEP_DEVIATION * STEP_DEVIATION * forgetting + first * u + second
    innovation = z - x[at + GAIN] * u - x[at + OFFSET]
    x[at + GAIN] += first / scale * innovation
    x[at + OFFSET] += second / scale * innovation
    a -= first * first / scale
    b -= first * second / scale
    c -= second * second / scale
    bounded = min(max(x[at + GAIN], LOWEST_GAIN), HIGHEST_GAIN)
    x[at + OFFSET] += (x[at + GAIN] - bounded) * u
    x[at + GAIN] = bounded
    gain_limit = GAIN_DEVIATION * GAIN_DEVIATION * forgetting
    if a < gain_limit and c < OFFSET_DEVIATION * OFFSET_DEVIATION * forgetting:
        a /= forgetting
        b /= forgetting
        c /= forgetting
    x[at + COVARIANCE] = a
    x[at + COVARIANCE + 1] = b
    x[at + COVARIANCE + 2] = c


#: A slider that moves by less than this fraction of the commanded extension counts as not moved.
STILL_PART = 0.1
#: Steps shorter than this fraction of the stroke are used neither for learning nor for the detection of faults.
SHORT_STEP = 0.05
#: In slow continuous walking, steps are not made shorter than this fraction of the stroke; the motor pauses instead.
SLOW_STEP = 0.1
#: Largest deflection by the load, as a fraction of the stroke.
LOAD_PART = 0.8
#: Factors on the measured mean deflection that give the correction of the learned deflection. FIRST_LOAD_GAIN applies
#: to the first step, in which the controller's integral has already compensated about half of the deflection. The
#: factor of step n is FIRST_LOAD_GAIN/n, but not less than LOAD_GAIN.
LOAD_GAIN = 0.5
FIRST_LOAD_GAIN = 2.0
#: A mean deflection up to this fraction of the stroke may be the lag of the extender, and is not learned.
LAG_PART = 0.02
#: Tolerance for equal extensions [m].
EQUAL = 1.0e-12


@kernel
def fail(x, error):
    """Stop with an error until the next start; a later error does not replace the first one."""
    if x[at.MODE] != at.FAILED:
        x[at.MODE] = at.FAILED
        x[at.ERROR] = error


@kernel
def enter(x, phase):
    """Begin a phase."""
    x[at.PHASE] = phase
    x[at.TIMER] = 0.0


@kernel
def drive_front(x, voltage):
    """Begin a ramp of the front clamp's voltage to ``voltage`` [V]."""
    if x[at.FRONT_TO] != voltage:
        x[at.FRONT_FROM] = x[at.FRONT_VOLTAGE]
        x[at.FRONT_TO] = voltage
        x[at.FRONT_COUNT] = 0.0


@kernel
def drive_rear(x, voltage):
    """Begin a ramp of the rear clamp's voltage to ``voltage`` [V]."""
    if x[at.REAR_TO] != voltage:
        x[at.REAR_FROM] = x[at.REAR_VOLTAGE]
        x[at.REAR_TO] = voltage
        x[at.REAR_COUNT] = 0.0


@kernel
def move(p, x, target):
    """Begin a motion of the extender to ``target`` [m]."""
    x[at.MOVE_FROM] = x[at.TIP]
    x[at.MOVE_TO] = target
    x[at.MOVE_DONE] = 0.0
    x[at.MOVE_RATE] = 1.0
    x[at.MOVE_RESTED] = 0.0
    x[at.MOVE_SAMPLES] = p[at.EXTEND_SAMPLES] if target >= x[at.TIP] else p[at.CONTRACT_SAMPLES]


@kernel
def let_go(x):
    """Switch the controller's measurement to the extender again, before a clamp opens."""
    x[at.SOURCE] = at.OWN
    x[at.BIAS] = x[at.EXTENDER] - x[at.TIP]
    x[at.MOVE_DONE] = 0.0


@kernel
def hold(x):
    """Switch the feedback off, because both clamps are closed."""
    x[at.SOURCE] = at.BLOCKED
    x[at.ANCHOR] = x[at.SLIDER]
    enter(x, at.HOLDING)


@kernel
def must_stop(p, x):
    """Return whether both clamps must close."""
    return x[at.MODE] == at.STOP or x[at.MODE] == at.FAILED or x[at.BAD] > p[at.SENSOR_SAMPLES]


@kernel
def stop_here(p, x):
    """Begin to close the open clamp, or both clamps."""
    drive_front(x, p[at.GRIP_VOLTAGE])
    drive_rear(x, p[at.GRIP_VOLTAGE])
    enter(x, at.STOPPING)


@kernel
def moving(p, x):
    """Advance the extender's motion by a sample; return whether the motion, or the wait after it, still continues."""
    if x[at.MOVE_DONE] < 1.0:
        x[at.MOVE_DONE] = min(x[at.MOVE_DONE] + x[at.MOVE_RATE] / x[at.MOVE_SAMPLES], 1.0)
        if x[at.MOVE_DONE] > 1.0 - 1.0e-9:
            x[at.MOVE_DONE] = 1.0
            x[at.MOVE_RATE] = 0.0
            x[at.TIP] = x[at.MOVE_TO]
        else:
            x[at.TIP] = x[at.MOVE_FROM] + (x[at.MOVE_TO] - x[at.MOVE_FROM]) * cycloid(x[at.MOVE_DONE])
        return True
    x[at.MOVE_RESTED] += 1.0
    return x[at.MOVE_RESTED] <= p[at.SETTLE_SAMPLES]


@kernel
def turn(x, way):
    """Set the direction to the sign of ``way``."""
    direction = 1.0 if way >= 0.0 else -1.0
    if direction != x[at.DIRECTION]:
        x[at.DIRECTION] = direction
        x[at.RETURNS] = 0.0


@kernel
def lowest(p, x):
    """Return the smallest extension in a step [m]; the load reduces the range."""
    return p[at.LOWEST] + max(x[at.LOAD], 0.0)


@kernel
def highest(p, x):
    """Return the largest extension in a step [m]; the load reduces the range."""
    return p[at.HIGHEST] + min(x[at.LOAD], 0.0)


@kernel
def within(p, x, extension):
    """Return whether an ``extension`` [m] is in the range that steps may use."""
    return extension >= lowest(p, x) - EQUAL and extension <= highest(p, x) + EQUAL


@kernel
def pretension(p, x, target):
    """Begin a ramp of the pretension, the compensated deflection of the extender by the load, to ``target`` [m]."""
    x[at.PRETENSION_FROM] = x[at.PRETENSION]
    x[at.PRETENSION_TO] = target


@kernel
def load_time(p, x):
    """Return the number of samples of the load transfer; both clamps stay closed in this time."""
    return p[at.RELEASE_SAMPLES] if x[at.LOAD] != 0.0 else 0.0


@kernel
def pretensioning(x, duration):
    """Advance the pretension by a sample; its ramp takes ``duration`` samples from the beginning of the phase."""
    part = cycloid((x[at.TIMER] + 1.0) / duration)
    x[at.PRETENSION] = x[at.PRETENSION_FROM] + (x[at.PRETENSION_TO] - x[at.PRETENSION_FROM]) * part


@kernel
def feel(x):
    """Add the deflection of the carrying extender to its sum; the oscillation averages out over a step."""
    x[at.GIVEN_WAY] += x[at.EXTENDER] - x[at.TIP] - x[at.BIAS] * (1.0 - cycloid(x[at.MOVE_DONE]))
    x[at.FELT] += 1.0


@kernel
def weigh(p, x):
    """Correct the learned load by the mean deflection after the load transfer; the factor falls to LOAD_GAIN."""
    if p[at.LEARNING] != 0.0 and x[at.FELT] > 0.0:
        stroke = p[at.HIGHEST] - p[at.LOWEST]
        bound = LOAD_PART * stroke
        part = max(FIRST_LOAD_GAIN / (1.0 + x[at.WEIGHED]), LOAD_GAIN)
        mean = x[at.GIVEN_WAY] / x[at.FELT]
        if abs(mean) > LAG_PART * stroke:
            x[at.LOAD] = min(max(x[at.LOAD] + part * mean, -bound), bound)
        x[at.WEIGHED] += 1.0


@called
def account(p, x):
    """Evaluate the last step and learn from it."""
    stroke = p[at.HIGHEST] - p[at.LOWEST]
    direction = x[at.DIRECTION]
    extension = x[at.EXTENSION] * stroke
    moved = direction * (x[at.SLIDER] - x[at.STEP_FROM])
    x[at.STEPS] += direction
    x[at.TOTAL_STEPS] += 1.0
    x[at.SLIP] = extension - moved
    x[at.COMMANDED_STEP] = direction * x[at.STEP_LENGTH]
    x[at.ACHIEVED_STEP] = direction * moved
    x[at.RETURNS] = 0.0
    wanted = max(extension, x[at.STEP_LENGTH])  # with a load or a wrong model, the extension of a step may be zero
    if wanted < SHORT_STEP * stroke:
        return
    # a step whose extension resulted from the load or from a wrong offset of the model does not count as missed,
    # because it corrects the model
    missed = x[at.EXTENSION] >= SHORT_STEP and moved <= p[at.MISSED_PART] * extension
    if missed:
        x[at.MISSED] += 1.0
    x[at.STILL] = x[at.STILL] + 1.0 if moved < STILL_PART * wanted else 0.0
    if x[at.STILL] >= p[at.STILL_STEPS]:
        fail(x, at.NO_MOTION_ERROR)
    if p[at.LEARNING] != 0.0 and not missed and abs(moved) < 2.0 * wanted:
        model = at.FORWARD_MODEL if direction > 0.0 else at.BACKWARD_MODEL
        learn(x, model, p[at.FORGETTING], x[at.EXTENSION], moved / stroke)


@called
def carry_from(p, x, start):
    """Open the rear clamp if the extender is at the step's start, else the front one to move the extender there."""
    if x[at.RETURNS] > p[at.STILL_STEPS]:
        fail(x, at.NO_MOTION_ERROR)
        return
    let_go(x)
    x[at.ANCHOR] = x[at.SLIDER]
    if abs(start - x[at.TIP]) <= EQUAL:
        x[at.STEP_FROM] = x[at.SLIDER]
        pretension(p, x, x[at.LOAD])
        enter(x, at.RELEASING_REAR)
    else:
        x[at.MOVE_TO] = start
        pretension(p, x, 0.0)
        drive_front(x, p[at.RELEASE_VOLTAGE])
        enter(x, at.RELEASING_FRONT)


@kernel
def plan_partial(p, x, length):
    """Choose the extension for a step of ``length`` ≥ 0 [m] and return the extension at which the step starts [m].

    A step before fine positioning ends in the middle of the extender's range; if ``length`` is too large for this,
    another step follows. Without fine positioning, a step starts at the present extension, if it fits into the range.
    """
    stroke = p[at.HIGHEST] - p[at.LOWEST]
    middle = 0.5 * (lowest(p, x) + highest(p, x))
    direction = x[at.DIRECTION]
    model = at.FORWARD_MODEL if direction > 0.0 else at.BACKWARD_MODEL
    usable = (highest(p, x) - lowest(p, x)) / stroke
    x[at.EXTENSION] = min(extension_for(x, model, length / stroke), usable)
    x[at.STEP_LENGTH] = length
    change = direction * x[at.EXTENSION] * stroke
    end = x[at.TIP] + change
    x[at.FINAL] = 0.0
    if p[at.FINE_ENABLED] == 0.0:
        if within(p, x, end):
            return x[at.TIP]
    elif abs(end - middle) <= p[at.WINDOW] + EQUAL:
        x[at.FINAL] = 1.0
        return x[at.TIP]
    elif within(p, x, middle - change):
        x[at.FINAL] = 1.0
    return min(max(middle - change, lowest(p, x)), highest(p, x))


@kernel
def next_walk(p, x):
    """Begin the next step of continuous walking."""
    turn(x, x[at.SPEED])
    stroke = p[at.HIGHEST] - p[at.LOWEST]
    model = at.FORWARD_MODEL if x[at.DIRECTION] > 0.0 else at.BACKWARD_MODEL
    usable = (highest(p, x) - lowest(p, x)) / stroke
    longest = stroke * longest_step(x, model, usable)
    speed = abs(x[at.SPEED])
    cycle = p[at.CYCLE_SAMPLES] + load_time(p, x)
    wanted = speed * p[at.SAMPLE_TIME] * cycle
    x[at.LIMITED_SPEED] = 1.0 if wanted > longest * 1.05 else 0.0
    length = min(max(wanted, SLOW_STEP * stroke), longest)
    aim = x[at.SLIDER] + x[at.DIRECTION] * length
    if aim > p[at.MAXIMUM] or aim < p[at.MINIMUM]:
        x[at.DIRECTION] = 0.0
        return
    pause = max(length / (speed * p[at.SAMPLE_TIME]) - cycle, 0.0)
    if x[at.RETURNS] == 0.0 and x[at.TIMER] < math.floor(pause):
        return
    x[at.EXTENSION] = min(extension_for(x, model, length / stroke), usable)
    x[at.STEP_LENGTH] = length
    x[at.FINAL] = 0.0
    change = x[at.DIRECTION] * x[at.EXTENSION] * stroke
    start = 0.5 * (lowest(p, x) + highest(p, x) - change)
    if x[at.RETURNS] > 0.0 and within(p, x, x[at.TIP] + change):
        start = x[at.TIP]
    carry_from(p, x, start)


@kernel
def next_step(p, x):
    """Begin the next step to the setpoint, if a step is needed."""
    distance = x[at.TARGET] - x[at.SLIDER]
    if p[at.FINE_ENABLED] == 0.0 and abs(distance) <= p[at.TOLERANCE]:
        x[at.DIRECTION] = 0.0
        x[at.ARRIVED] = 1.0
        return
    x[at.ARRIVED] = 0.0
    turn(x, distance)
    stroke = p[at.HIGHEST] - p[at.LOWEST]
    model = at.FORWARD_MODEL if x[at.DIRECTION] > 0.0 else at.BACKWARD_MODEL
    usable = (highest(p, x) - lowest(p, x)) / stroke
    longest = stroke * longest_step(x, model, usable)
    if abs(distance) > longest:
        x[at.EXTENSION] = usable
        x[at.STEP_LENGTH] = longest
        x[at.FINAL] = 0.0
        carry_from(p, x, lowest(p, x) if x[at.DIRECTION] > 0.0 else highest(p, x))
    else:
        carry_from(p, x, plan_partial(p, x, abs(distance)))
