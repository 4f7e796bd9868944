# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Continuous walking of an inchworm motor as kernels: extender and clamps as functions of the phase of the cycle.

A cycle consists of the gait's six processes. The phase of the cycle is 0 in the middle of a return and 1 in the middle
of the next return. The path of the slider is a straight line over the phase while the slider is carried, and constant
while the extender returns. A correction learned as a function of the phase
(:mod:`hysteresis_ros.references.inchworm_parameters`) is added to the extender's motion: errors that depend on the
phase repeat at any speed. The outputs lead the path to compensate the known dynamics of slider, extender and clamps,
which depend on time.
"""

from __future__ import annotations

import math

from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import called, kernel
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_parameters import cycloid, ramp
from hysteresis_ros.references.inchworm_steps import (
    EQUAL,
    account,
    drive_front,
    enter,
    fail,
    hold,
    let_go,
    must_stop,
    pretension,
    stop_here,
    turn,
)

#: A new correction fades in during this fraction of the time from the middle of the return until the front clamp begins
#: to close.
GLIDE_PART = 0.8
#: A requested rate is too fast if it exceeds this multiple of the highest rate.
TOO_FAST = 1.05
#: For the learning, speeds with a smaller relative difference count as equal.
SAME_SPEED = 0.02
#: Below this fraction of the highest rate, even quick ramps of the clamps become slower.
SLOWEST = 1.0e-3
#: Value of a ramp's counter after its end.
AT_ONCE = 1.0e9


@kernel
def bounds_of(x):
    """Return the index in p of the ends of the processes for the present direction."""
    return at.FORWARD_BOUNDS if x[at.DIRECTION] > 0.0 else at.BACKWARD_BOUNDS


@called
def carried(blend, part):
    """Return the profile of the carrying motion: a straight line between two smooth ends of length ``blend``."""
    part = min(max(part, 0.0), 1.0)
    near = min(part, 1.0 - part)
    speed = 1.0 / (1.0 - blend)
    if near < blend:
        s = near / blend
        way = speed * blend * (0.5 * s * s + (elementary.cos(2.0 * math.pi * s) - 1.0) / (4.0 * math.pi * math.pi))
    else:
        way = speed * (near - 0.5 * blend)
    return way if part <= 0.5 else 1.0 - way


@kernel
def bend(blend, part):
    """Return the second derivative of the profile of the carrying motion."""
    near = min(part, 1.0 - part)
    if near <= 0.0 or near >= blend:
        return 0.0
    value = (1.0 - elementary.cos(2.0 * math.pi * near / blend)) / (blend * (1.0 - blend))
    return value if part <= 0.5 else -value


@kernel
def wrapped(phase):
    """Return the phase within 0 … 1."""
    return phase - math.floor(phase)


@kernel
def spline(x, first, n, phase):
    """Return the value at ``phase`` of the periodic cubic spline with the coefficients ``x[first:first + n]``."""
    s = phase * n
    i = int(s)
    u = s - i
    v = 1.0 - u
    value = v * v * v * x[first + (i - 1) % n]
    value += (3.0 * u * u * u - 6.0 * u * u + 4.0) * x[first + i % n]
    value += (3.0 * v * v * v - 6.0 * v * v + 4.0) * x[first + (i + 1) % n]
    value += u * u * u * x[first + (i + 2) % n]
    return value / 6.0


@kernel
def spline_bend(x, first, n, phase):
    """Return the second derivative of the spline with respect to the phase."""
    s = phase * n
    i = int(s)
    u = s - i
    v = 1.0 - u
    value = v * x[first + (i - 1) % n] + (3.0 * u - 2.0) * x[first + i % n]
    value += (3.0 * v - 2.0) * x[first + (i + 1) % n] + u * x[first + (i + 2) % n]
    return value * n * n


@kernel
def coefficients(p, x):
    """Return the index in x of the present direction's coefficients: first the new ones, then the previous ones."""
    return at.WALK + (0 if x[at.DIRECTION] > 0.0 else 2 * int(p[at.SPLINES]))


@kernel
def path(p, x, phase):
    """Return the desired position of the slider within its step at ``phase``, as a fraction of the step."""
    b = bounds_of(x)
    return carried(p[at.BLEND], (phase - p[b + at.CARRY]) / (p[b + at.CARRIED] - p[b + at.CARRY]))


@called
def tip(p, x, phase, glide):
    """Return the desired position [m] of the extender at ``phase``, and store the correction in ``x``.

    ``glide`` is the weight of the new coefficients of the correction; the previous ones have the weight 1 − ``glide``.
    If the slider can oscillate, the extension is increased in proportion to the slider's acceleration.
    """
    b, n, first = bounds_of(x), int(p[at.SPLINES]), coefficients(p, x)
    half = p[b + at.RETURNED]
    late = wrapped(phase - p[at.INERTIA_LAG] * x[at.CYCLE_RATE])
    new, old = spline(x, first, n, phase), spline(x, first + n, n, phase)
    x[at.CORRECTION] = old + glide * (new - old)
    acceleration = 0.0
    if p[at.TIP_INERTIA] > 0.0:  # if the resonance is unknown, this lead might excite it
        new, old = spline_bend(x, first, n, late), spline_bend(x, first + n, n, late)
        acceleration = (old + glide * (new - old)) * x[at.CYCLE_RATE] * x[at.CYCLE_RATE]
    if phase < half or phase >= p[b + at.RETURN]:
        way = 1.0 - cycloid(0.5 + 0.5 * (phase if phase < half else phase - 1.0) / half)
    else:
        way = path(p, x, phase)
        pace = x[at.CYCLE_RATE] / (p[b + at.CARRIED] - p[b + at.CARRY])
        part = (late - p[b + at.CARRY]) / (p[b + at.CARRIED] - p[b + at.CARRY])
        acceleration += x[at.DIRECTION] * p[at.WALKING_STEP] * pace * pace * bend(p[at.BLEND], part)
    middle = 0.5 * (p[at.LOWEST] + p[at.HIGHEST])
    value = middle + x[at.DIRECTION] * p[at.WALKING_STEP] * (way - 0.5) + x[at.CORRECTION]
    return value + p[at.INERTIA] * acceleration


@called
def extension(p, x, phase):
    """Return the commanded extension [m] at ``phase``; its lead compensates the dynamics of the extender."""
    glide = cycloid(x[at.CYCLE_PHASE] / (GLIDE_PART * p[bounds_of(x) + at.CLOSE_FRONT]))
    if p[at.TIP_INERTIA] == 0.0:
        return tip(p, x, phase, glide)
    before = tip(p, x, wrapped(phase - x[at.CYCLE_RATE]), glide)
    after = tip(p, x, wrapped(phase + x[at.CYCLE_RATE]), glide)
    now = tip(p, x, phase, glide)
    return now + 0.5 * p[at.TIP_LAG] * (after - before) + p[at.TIP_INERTIA] * (after - 2.0 * now + before)


@kernel
def clamp_voltage(p, closed):
    """Return the voltage [V] of a clamp that is closed by this fraction."""
    return p[at.RELEASE_VOLTAGE] + (p[at.GRIP_VOLTAGE] - p[at.RELEASE_VOLTAGE]) * closed


@called
def passed(p, rate, phase, first, last, contact):
    """Return the elapsed fraction of a clamp's ramp at ``phase``.

    The ramp takes the whole time between the phases ``first`` and ``last``; quick ramps have the gait's duration, and
    reach the fraction ``contact`` at the same phase.
    """
    part = (phase - first) / (last - first)
    if p[at.QUICK_CLAMPS] != 0.0:
        part = contact + (part - contact) / max(rate * p[at.CYCLE_SAMPLES], SLOWEST)
    return ramp(p[at.LINEAR_RAMP], part)


@kernel
def set_clamps(p, x, phase):
    """Set the voltages of both clamps according to the phase."""
    b, rate, touch, free = bounds_of(x), x[at.CYCLE_RATE], p[at.TOUCHES], p[at.LETS_GO]
    closed = passed(p, rate, phase, p[b + at.CLOSE_FRONT], p[b + at.OPEN_REAR], touch)
    opened = passed(p, rate, phase, p[b + at.OPEN_FRONT], p[b + at.RETURN], free)
    x[at.FRONT_VOLTAGE] = x[at.FRONT_TO] = clamp_voltage(p, closed - opened)
    opened = passed(p, rate, phase, p[b + at.OPEN_REAR], p[b + at.CARRY], free)
    closed = passed(p, rate, phase, p[b + at.CLOSE_REAR], p[b + at.OPEN_FRONT], touch)
    x[at.REAR_VOLTAGE] = x[at.REAR_TO] = clamp_voltage(p, 1.0 - opened + closed)
    x[at.FRONT_COUNT] = x[at.REAR_COUNT] = AT_ONCE


@kernel
def process(p, x, phase):
    """Return the process of the gait at ``phase``."""
    b = bounds_of(x)
    if phase < p[b + at.CLOSE_FRONT] or phase >= p[b + at.RETURN]:
        return at.RETURNING
    if phase < p[b + at.OPEN_REAR]:
        return at.GRIPPING_FRONT
    if phase < p[b + at.CARRY]:
        return at.RELEASING_REAR
    if phase < p[b + at.CLOSE_REAR]:
        return at.CARRYING
    return at.GRIPPING_REAR if phase < p[b + at.OPEN_FRONT] else at.RELEASING_FRONT


@kernel
def forget(p, x):
    """Reset the learned corrections; the correction in use decays to zero."""
    n, own = int(p[at.SPLINES]), coefficients(p, x)
    for i in range(4 * n):
        if at.WALK + i < own + n or at.WALK + i >= own + 2 * n:
            x[at.WALK + i] = 0.0
    x[at.FORGETS] = 0.0


@called
def correct(p, x):
    """Update the correction with the errors of the last cycle."""
    n, m = int(p[at.SPLINES]), int(p[at.BINS])
    matrix = at.LEARNING_MATRICES + (0 if x[at.DIRECTION] > 0.0 else n * (m + n))
    sums, counts, first = at.WALK + 4 * n, at.WALK + 4 * n + m, coefficients(p, x)
    for j in range(m):
        if x[counts + j] > 0.0:
            x[sums + j] /= x[counts + j]
        elif j > 0:
            x[sums + j] = x[sums + j - 1]
    for i in range(n):
        change = 0.0
        for j in range(m):
            change += p[matrix + i * m + j] * x[sums + j]
        for j in range(n):
            change -= p[matrix + n * m + i * n + j] * x[first + n + j]
        wanted = x[first + i] + p[at.LEARNING_GAIN] * change
        x[first + i] = min(max(wanted, -p[at.BOUND]), p[at.BOUND])
    x[at.LEARNED_CYCLES] += 1.0


@kernel
def begin_cycle(p, x):
    """Reset the statistics of the errors, for the next cycle."""
    n, m = int(p[at.SPLINES]), int(p[at.BINS])
    for i in range(2 * m):
        x[at.WALK + 4 * n + i] = 0.0
    x[at.STAND_SUM] = x[at.STAND_COUNT] = 0.0
    x[at.SQUARES] = x[at.SQUARE_COUNT] = 0.0


@kernel
def end_cycle(p, x):
    """Learn from the cycle, which ends in the middle of the return, and begin the next one."""
    n, first = int(p[at.SPLINES]), coefficients(p, x)
    for i in range(n):
        x[first + n + i] = x[first + i]
    if x[at.SQUARE_COUNT] > 0.0:
        x[at.RIPPLE] = math.sqrt(x[at.SQUARES] / x[at.SQUARE_COUNT])
    if x[at.FORGETS] != 0.0:
        forget(p, x)
    elif x[at.LEARNS] != 0.0 and x[at.WHOLE] != 0.0:
        correct(p, x)
    begin_cycle(p, x)
    x[at.WHOLE] = 1.0
    x[at.PATH] += x[at.DIRECTION] * p[at.WALKING_STEP]


@kernel
def observe(p, x):
    """Compare the slider with its path; the path begins at the slider's position before the front clamp closes."""
    phase = x[at.CYCLE_PHASE]
    stands = phase < p[bounds_of(x) + at.CLOSE_FRONT]
    if stands:
        x[at.STAND_SUM] += x[at.SLIDER]
        x[at.STAND_COUNT] += 1.0
    elif x[at.STAND_COUNT] > 0.0:
        x[at.PATH] = x[at.STAND_SUM] / x[at.STAND_COUNT]
        x[at.STAND_COUNT] = 0.0
    error = x[at.PATH] + x[at.DIRECTION] * p[at.WALKING_STEP] * path(p, x, phase) - x[at.SLIDER]
    x[at.PATH_ERROR] = error
    if not stands:
        n, m = int(p[at.SPLINES]), int(p[at.BINS])
        place = at.WALK + 4 * n + min(int(phase * m), m - 1)
        x[place] += error
        x[place + m] += 1.0
        x[at.SQUARES] += error * error
        x[at.SQUARE_COUNT] += 1.0


@called
def begin_walk(p, x):
    """Begin continuous walking: the extender first moves to its position at the phase in which the rear clamp opens."""
    turn(x, x[at.SPEED])
    aim = x[at.SLIDER] + x[at.DIRECTION] * p[at.WALKING_STEP]
    if aim > p[at.MAXIMUM] or aim < p[at.MINIMUM]:
        x[at.DIRECTION] = 0.0
        return
    if x[at.RETURNS] > p[at.STILL_STEPS]:
        fail(x, at.NO_MOTION_ERROR)
        return
    if x[at.FORGETS] != 0.0:
        forget(p, x)
    phase = p[bounds_of(x) + at.OPEN_REAR]
    x[at.CYCLE_PHASE] = phase
    x[at.CYCLE_RATE] = 0.0
    start = extension(p, x, phase)
    x[at.ANCHOR] = x[at.SLIDER]
    if abs(start - x[at.TIP]) <= EQUAL and x[at.PRETENSION] == 0.0:
        begin_cycle(p, x)
        x[at.CYCLE] = 1.0
        x[at.WHOLE] = 0.0
        x[at.PATH] = x[at.SLIDER]
        x[at.STEP_FROM] = x[at.SLIDER]
        x[at.MOVE_FROM] = x[at.TIP]
        enter(x, at.RELEASING_REAR)
    else:
        let_go(x)
        x[at.MOVE_TO] = start
        pretension(p, x, 0.0)
        drive_front(x, p[at.RELEASE_VOLTAGE])
        enter(x, at.RELEASING_FRONT)


@called
def advance(p, x):
    """Advance the phase by a sample; return the phase of the outputs, which lead the path."""
    x[at.CYCLE_PHASE] += x[at.CYCLE_RATE]
    if x[at.CYCLE_PHASE] >= 1.0:
        x[at.CYCLE_PHASE] -= 1.0
        end_cycle(p, x)
    return wrapped(x[at.CYCLE_PHASE] + p[at.LEAD] * x[at.CYCLE_RATE])


@called
def go_on(p, x, phase):
    """Enter the process of the gait at ``phase``; evaluate finished steps, and stop before the limit of the travel."""
    now = process(p, x, phase)
    if now == x[at.PHASE]:
        return
    enter(x, now)
    if now == at.RELEASING_REAR:
        aim = x[at.SLIDER] + x[at.DIRECTION] * p[at.WALKING_STEP]
        if aim > p[at.MAXIMUM] or aim < p[at.MINIMUM]:
            x[at.CYCLE] = x[at.DIRECTION] = 0.0
            hold(x)
            return
        x[at.STEP_FROM] = x[at.ANCHOR] = x[at.SLIDER]
        x[at.MOVE_FROM] = x[at.TIP]
    elif now == at.RELEASING_FRONT:
        x[at.STEP_LENGTH] = p[at.WALKING_STEP]
        x[at.EXTENSION] = abs(x[at.TIP] - x[at.MOVE_FROM]) / (p[at.HIGHEST] - p[at.LOWEST])
        missed = x[at.MISSED]
        account(p, x)
        if x[at.MISSED] != missed:
            x[at.WHOLE] = 0.0


@called
def stride(p, x):
    """Compute a sample of continuous walking; end it in order to stop, reverse, walk to a setpoint, or release."""
    turns = x[at.SPEED] * x[at.DIRECTION] <= 0.0
    if must_stop(p, x) or x[at.MODE] == at.LET_GO or turns:
        x[at.BRAKING] = 2.0 * x[at.CYCLE_RATE] / p[at.GRIP_SAMPLES]
        stop_here(p, x)
        return
    fastest = 1.0 / p[at.CYCLE_SAMPLES]
    wanted = abs(x[at.SPEED]) * p[at.SAMPLE_TIME] / p[at.WALKING_STEP]
    x[at.LIMITED_SPEED] = 1.0 if wanted > TOO_FAST * fastest else 0.0
    wanted = min(wanted, fastest)
    change = wanted - x[at.CYCLE_RATE]
    most = fastest / p[at.CYCLE_SAMPLES]
    x[at.CYCLE_RATE] = wanted if abs(change) <= most else x[at.CYCLE_RATE] + math.copysign(most, change)
    phase = advance(p, x)
    clamps = wrapped(phase + p[at.CLAMP_LEAD] * x[at.CYCLE_RATE])
    if change != 0.0 or abs(wanted - p[at.LEARNING_RATE]) > SAME_SPEED * wanted or x[at.BAD] > 0.0:
        x[at.WHOLE] = 0.0
    observe(p, x)
    go_on(p, x, clamps)
    if x[at.CYCLE] != 0.0:
        x[at.TIP] = extension(p, x, phase)
        set_clamps(p, x, clamps)


@kernel
def coast(p, x):
    """Continue the phase at a decreasing rate, while the open clamp closes."""
    x[at.WHOLE] = 0.0
    x[at.CYCLE_RATE] = max(x[at.CYCLE_RATE] - x[at.BRAKING], 0.0)
    x[at.TIP] = extension(p, x, advance(p, x))
