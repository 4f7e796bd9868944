# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arrays of the inchworm sequencer: indices of parameters, state and signals, and the codes of its states."""

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
    CONTINUOUS,  # not 0: walk continuously, by the phase of the cycle (parameters below)
    WALKING_STEP,  # [m] per cycle
    BLEND,  # fraction of the carrying motion in which the speed rises; the same fraction in which it falls
    LEAD,  # lead of the outputs over the path [samples]
    BOUND,  # largest correction [m]
    LEARNING_GAIN,
    LEARNING_RATE,  # rate of the cycles that the learning uses [1/sample]
    INERTIA,  # lead of the extender per acceleration of the slider [samples²]
    INERTIA_LAG,  # delay of this lead by the damping [samples]
    TIP_INERTIA,  # lead of the command per acceleration of the extender [samples²]
    TIP_LAG,  # lead of the command per speed of the extender [samples]
    CLAMP_LEAD,  # lead of the clamps over the extender [samples]
    QUICK_CLAMPS,  # not 0: the clamps' ramps take the gait's times at any speed
    TOUCHES,  # fraction of the closing ramp at which a clamp touches the slider
    LETS_GO,  # fraction of the opening ramp at which it lets go
    SPLINES,  # number of splines of the correction
    BINS,  # number of bins of the error
) = range(50)
#: Phases at which the processes of a forward cycle end, then those of a backward cycle (named below).
FORWARD_BOUNDS = 50
BACKWARD_BOUNDS = 58
#: Matrices of the learning for each direction, row by row: of the errors (SPLINES, BINS), then of the coefficients
#: (SPLINES, SPLINES).
LEARNING_MATRICES = 66
PARAMETERS = 66

#: Ends of the processes of a cycle: returned, front clamp begins to close, rear clamp to open, carrying begins, ends,
#: rear clamp begins to close, front clamp to open, returning begins. The middle of returning is phase 0.
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
    SLIP,  # extension of the last step minus the motion of the slider [m]
    ERROR,
    MODE,
    ARRIVED,  # 1 while the slider is at the setpoint within the tolerance
    MISSED,  # missed steps so far: the slider moved by less than a fraction of the extension
    TOTAL_STEPS,  # forward and backward steps so far
    REFUSED,  # setpoints outside of the travel so far
    LIMITED_SPEED,  # 1 when the requested speed exceeds the gait's
    COMMANDED_STEP,  # commanded length of the last finished step [m], with the sign of its direction
    ACHIEVED_STEP,  # achieved length of that step [m], from the measured slider
    TARGET,  # present setpoint [m]
    REQUEST,  # input: request, taken at the next sample
    SPEED,  # input: requested speed of continuous walking [m/s]; 0: walk to the setpoint
    RECEIVED,  # last received setpoint [m]
    SLIDER,  # last good measurements [m]
    EXTENDER,
    BAD,  # number of samples since the last good measurement
    STARTED,  # 1 once both clamps have closed for the first time
    TIMER,  # samples since the present phase began
    SOURCE,  # source of the controller's measurement
    BIAS,  # extender minus reference when its feedback began [m]; fades out over the next motion
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
    EXTENSION,  # extension of the next or present step, as a fraction of the stroke
    FINAL,  # 1 when fine positioning follows the step
    STEP_LENGTH,  # commanded length of the step [m], without sign
    STEP_FROM,  # slider position when the step began to carry [m]
    JUDGE,  # 1 while a finished step has not been evaluated yet
    WALKED,  # 1 after continuous walking, until the motor holds its position
    STILL,  # number of consecutive steps in which the slider did not move
    RETURNS,  # number of consecutive returns without a step
    ANCHOR,  # origin of the runaway guard [m]
    FINE_POSITION,
    FINE_VELOCITY,
    FINE_ERROR,  # smoothed setpoint minus slider position [m]
    FINE_SLIP,  # smoothed slip of the front clamp [m]
    FINE_LATE,  # samples outside of the tolerance
    FINE_GOAL,
    TIP,  # commanded extension [m]: the reference without the pretension
    LOAD,  # learned deflection of the extender by the load [m]
    PRETENSION,  # part of the load's deflection subtracted from the reference [m], and the ends of its ramp
    PRETENSION_FROM,
    PRETENSION_TO,
    GIVEN_WAY,  # sum of the extender's deflection under the load over the samples of a step [m]
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
    BRAKING,  # decrease of the rate per sample when the motor stops
    PATH,  # position of the path when the cycle began [m]
    PATH_ERROR,  # path minus measured slider position [m]
    CORRECTION,  # correction of the extension [m]
    LEARNS,  # 1: every whole cycle updates the correction
    FORGETS,  # 1: the next cycle resets the correction
    WHOLE,  # 1 while the present cycle can be used for learning
    STAND_SUM,  # sum of the slider positions while the slider stands still, and number of samples
    STAND_COUNT,
    SQUARES,  # sum of the squared errors of the present cycle, and number of samples
    SQUARE_COUNT,
    RIPPLE,  # RMS of the error over the last whole cycle [m]
    LEARNED_CYCLES,  # number of learned cycles so far
) = range(74, 90)
#: Coefficients of the corrections, then sums and counts of the errors by phase: the lengths are SPLINES and BINS.
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

#: Errors. The error of a sensor ends when good measurements return; the others stay until start.
NO_ERROR, SENSOR_ERROR, NO_MOTION_ERROR, RUNAWAY_ERROR, SLIP_ERROR = range(5)
ERROR_NAMES = ("", "sensor", "no_motion", "runaway", "slip")

#: Sources of the controller's measurement: none (the controller gets its reference), the extender, the slider.
BLOCKED, OWN, FOLLOWING = range(3)
