# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arrays of the inchworm sequencer: indices of parameters, state and signals, and codes of the sequencer's states."""

from __future__ import annotations

#: Parameters p. Durations are in samples.
(
    SAMPLE_TIME,
    RELEASE_SAMPLES,
    GRIP_SAMPLES,
    EXTEND_SAMPLES,
    CONTRACT_SAMPLES,
    SETTLE_SAMPLES,
    OVERLAP_SAMPLES,
    LINEAR_RAMP,
    GRIP_VOLTAGE,
    RELEASE_VOLTAGE,
    LOWEST,
    HIGHEST,
    MARGIN,
    MINIMUM,
    MAXIMUM,
    HOME,
    RESTING,
    FINE_ENABLED,
    TOLERANCE,
    FINE_SPEED,
    FINE_TIME,
    FINE_TIMEOUT,
    SMOOTHING,
    LEARNING,
    FORGETTING,
    STILL_STEPS,
    MISSED_PART,
    RUNAWAY,
    SLIP_LIMIT,
    SENSOR_SAMPLES,
    CYCLE_SAMPLES,
    WINDOW,
    DRIFT,  # [m/s]
    CONTINUOUS,  # not 0: walk continuously, by the phase of the cycle (with the parameters below)
    WALKING_STEP,  # [m] per cycle
    BLEND,  # fraction of the carrying motion in which the speed rises, and equal fraction in which it falls
    LEAD,  # lead of the outputs over the path [samples]
    BOUND,  # largest correction [m]
    LEARNING_GAIN,
    LEARNING_RATE,  # cycle rate at which the correction is updated [1/sample]
    INERTIA,  # lead of the extender divided by the acceleration of the slider [samples²]
    INERTIA_LAG,  # delay of this lead due to the damping [samples]
    TIP_INERTIA,  # lead of the command divided by the acceleration of the extender [samples²]
    TIP_LAG,  # lead of the command divided by the speed of the extender [samples]
    CLAMP_LEAD,  # lead of the clamps over the extender [samples]
    QUICK_CLAMPS,  # not 0: the clamp ramps have the gait's durations at any speed
    TOUCHES,  # fraction of the closing ramp at which a clamp touches the slider
    LETS_GO,  # fraction of the opening ramp at which a clamp releases the slider
    SPLINES,  # number of splines of the correction
    BINS,  # number of bins of the error
) = range(50)
#: Indices in p of the phases at which the processes of a cycle end, forward and backward; the phases follow below.
FORWARD_BOUNDS = 50
BACKWARD_BOUNDS = 58
#: Matrices of the learning for each direction, row by row: first the matrix that multiplies the errors, (SPLINES,
#: BINS), then the one that multiplies the coefficients, (SPLINES, SPLINES).
LEARNING_MATRICES = 66
PARAMETERS = 66

#: Phases in a cycle: extender has returned; front clamp begins to close; rear clamp begins to open; carrying begins;
#: carrying ends; rear clamp begins to close; front clamp begins to open; returning begins. Phase 0 is the middle of
#: returning.
RETURNED, CLOSE_FRONT, OPEN_REAR, CARRY, CARRIED, CLOSE_REAR, OPEN_FRONT, RETURN = range(8)

#: State x: first the public signals, then the internal state.
(
    REFERENCE,  # commanded extension, or commanded slider position minus origin [m]
    FRONT_VOLTAGE,  # [V]
    REAR_VOLTAGE,  # [V]
    ORIGIN,  # [m]; the motion controller's measurement is slider - origin
    PHASE,
    STEPS,  # number of steps so far, whole and partial, forward minus backward
    DIRECTION,  # +1, -1 or 0
    SLIP,  # extension of the last step minus the resulting motion of the slider [m]
    ERROR,
    MODE,
    ARRIVED,  # 1 while the slider is at the setpoint within the tolerance
    MISSED,  # number of missed steps so far: the slider moved by less than a fraction of the extension
    TOTAL_STEPS,  # number of forward and backward steps so far
    REFUSED,  # number of setpoints outside the travel so far
    LIMITED_SPEED,  # 1 if the requested speed exceeds that of the gait
    COMMANDED_STEP,  # commanded length of the last finished step [m], with the sign of its direction
    ACHIEVED_STEP,  # achieved length of the last finished step [m], from the measured slider position
    TARGET,  # present setpoint [m]
    REQUEST,  # input: request that is executed at the next sample
    SPEED,  # input: requested speed of continuous walking [m/s]; 0: walk to the setpoint
    RECEIVED,  # last received setpoint [m]
    SLIDER,  # last good measurements [m]
    EXTENDER,
    BAD,  # number of samples since the last good measurement
    STARTED,  # 1 after both clamps have closed for the first time
    TIMER,  # samples since the present phase began
    SOURCE,  # source of the controller's measurement
    BIAS,  # extender minus reference [m] when the extender's feedback began; fades out during the next motion
    FRONT_FROM,  # clamp ramps: voltage at the beginning and at the end [V], samples so far
    FRONT_TO,
    FRONT_COUNT,
    REAR_FROM,
    REAR_TO,
    REAR_COUNT,
    MOVE_FROM,  # motion of the extender: start, end [m], progress 0 … 1, samples, rate 0 … 1, samples of waiting so far
    MOVE_TO,
    MOVE_DONE,
    MOVE_SAMPLES,
    MOVE_RATE,
    MOVE_RESTED,
    EXTENSION,  # extension of the present or next step, as a fraction of the stroke
    FINAL,  # 1 if fine positioning follows the step
    STEP_LENGTH,  # commanded length of the step [m], without sign
    STEP_FROM,  # slider position at which the step began to carry [m]
    JUDGE,  # 1 while a finished step is not yet evaluated
    WALKED,  # 1 after continuous walking, until the motor holds its position
    STILL,  # number of consecutive steps in which the slider did not move
    RETURNS,  # number of consecutive returns without a step
    ANCHOR,  # slider position from which the runaway guard measures [m]
    FINE_POSITION,
    FINE_VELOCITY,
    FINE_ERROR,  # smoothed setpoint minus slider position [m]
    FINE_SLIP,  # smoothed slip of the front clamp [m]
    FINE_LATE,  # number of samples outside the tolerance
    FINE_GOAL,
    TIP,  # commanded extension [m]: the reference without the pretension
    LOAD,  # learned deflection of the extender by the load [m]
    PRETENSION,  # part of the load's deflection that is subtracted from the reference [m], and the ends of its ramp
    PRETENSION_FROM,
    PRETENSION_TO,
    GIVEN_WAY,  # sum of the extender's deflections under the load over the samples of a step [m]
    FELT,  # number of these samples
    WEIGHED,  # number of steps from which the load was learned
    FINE_DRIFT,  # part of the slip that counts as drift [m]
) = range(64)
#: Learned step models, forward and backward (see :mod:`hysteresis_ros.references.inchworm_steps`).
FORWARD_MODEL = 64
BACKWARD_MODEL = 69

#: Continuous walking.
(
    CYCLE,  # 1 while the phase of the cycle determines the extender's motion
    CYCLE_PHASE,  # phase of the path, 0 … 1
    CYCLE_RATE,  # [1/sample]
    BRAKING,  # decrease of CYCLE_RATE per sample while the motor stops [1/sample²]
    PATH,  # position at which the path of this cycle began [m]
    PATH_ERROR,  # path minus measured slider position [m]
    CORRECTION,  # correction of the extension [m]
    LEARNS,  # 1: every whole cycle updates the correction
    FORGETS,  # 1: the next cycle resets the correction
    WHOLE,  # 1 while the present cycle is still usable for learning
    STAND_SUM,  # sum of the slider positions while the slider stands still, and number of these samples
    STAND_COUNT,
    SQUARES,  # sum of the squared errors in the present cycle, and number of summed errors
    SQUARE_COUNT,
    RIPPLE,  # RMS of the error over the last whole cycle [m]
    LEARNED_CYCLES,  # number of learned cycles so far
) = range(74, 90)
#: Coefficients of the corrections (lengths SPLINES), then sums and counts of the errors by phase (lengths BINS).
WALK = 90
STATES = 90

#: Phases.
(
    STARTING,
    HOLDING,
    RELEASING_REAR,
    CARRYING,
    GRIPPING_REAR,
    RELEASING_FRONT,
    RETURNING,
    GRIPPING_FRONT,
    POSITIONING,
    RELEASED,
    STOPPING,
) = range(11)
PHASE_NAMES = (
    "starting",
    "holding",
    "releasing_rear",
    "carrying",
    "gripping_rear",
    "releasing_front",
    "returning",
    "gripping_front",
    "positioning",
    "released",
    "stopping",
)

#: Modes.
RUN, STOP, LET_GO, FAILED = range(4)

#: Requests.
NO_REQUEST, START_REQUEST, STOP_REQUEST, HOME_REQUEST, RELEASE_REQUEST = range(5)
LEARN_REQUEST, FREEZE_REQUEST, FORGET_REQUEST = range(5, 8)

#: Errors. A sensor error ends when good measurements return; the other errors stay until the next start.
NO_ERROR, SENSOR_ERROR, NO_MOTION_ERROR, RUNAWAY_ERROR, SLIP_ERROR = range(5)
ERROR_NAMES = ("", "sensor", "no_motion", "runaway", "slip")

#: Sources of the controller's measurement: none (the controller receives its reference), the extender, the slider.
BLOCKED, OWN, FOLLOWING = range(3)
