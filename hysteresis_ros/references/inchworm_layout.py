# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arrays of the inchworm sequencer: places of parameters, state and signals, and the codes of its states."""

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
    CONTINUOUS,  # not 0: continuous walking is a motion over the phase of the cycle, below
    WALKING_STEP,  # [m] a cycle
    BLEND,  # part of the carrying motion in which its speed rises, and in which it falls
    LEAD,  # how far the outputs are ahead of the path [samples]
    BOUND,  # of the correction [m]
    LEARNING_GAIN,
    LEARNING_RATE,  # of the cycles from which is learned [1/sample]
    INERTIA,  # extension in advance for each acceleration [samples²]
    SPLINES,  # of the correction
    BINS,  # of the error
) = range(43)
#: Phases at which the processes of a cycle forward end, and of one backward (named below).
FORWARD_BOUNDS = 43
BACKWARD_BOUNDS = 51
#: Learning matrices (SPLINES, BINS) forward and then backward, row by row.
LEARNING_MATRICES = 59
PARAMETERS = 59

#: Ends of the processes of a cycle: returned, front clamp begins to close, rear clamp to open, carrying begins, ends,
#: rear clamp begins to close, front clamp to open, returning begins. The middle of returning is phase 0.
RETURNED, CLOSE_FRONT, OPEN_REAR, CARRY, CARRIED, CLOSE_REAR, OPEN_FRONT, RETURN = range(8)

#: State x: first what others read and write, then what the sequencer keeps for itself.
(
    REFERENCE,  # wanted extension, or wanted slider position less origin [m]
    FRONT_VOLTAGE,  # [V]
    REAR_VOLTAGE,  # [V]
    ORIGIN,  # [m]; the motion controller's measurement is slider - origin
    PHASE,
    STEPS,  # whole and partial steps so far, those forward minus those backward
    DIRECTION,  # +1, -1 or 0
    SLIP,  # extension of the last step less what the slider moved [m]
    ERROR,
    MODE,
    ARRIVED,  # 1 while the slider is at the setpoint within the tolerance
    MISSED,  # steps that moved the slider by less than the missed part of the extension
    TOTAL_STEPS,  # forward and backward steps so far
    REFUSED,  # setpoints outside of the travel so far
    LIMITED_SPEED,  # 1 when the wanted speed is beyond the gait's
    COMMANDED_STEP,  # length the last finished step was to have [m], with the sign of its direction
    ACHIEVED_STEP,  # length it had by the measured slider [m]
    TARGET,  # setpoint in force [m]
    REQUEST,  # written by others, taken at the next sample
    SPEED,  # wanted speed of continuous walking [m/s], written by others; 0: walk to the setpoint
    RECEIVED,  # last setpoint that was received [m]
    SLIDER,  # last good measurements [m]
    EXTENDER,
    BAD,  # samples since the last good measurement
    STARTED,  # 1 once both clamps have closed for the first time
    TIMER,  # samples since the present phase began
    SOURCE,  # what the controller's measurement is
    BIAS,  # extender less reference when the extender was let go [m]; fades out over the next motion
    FRONT_FROM,  # clamp ramps: voltage at the beginning and at the end [V], samples so far
    FRONT_TO,
    FRONT_COUNT,
    REAR_FROM,
    REAR_TO,
    REAR_COUNT,
    MOVE_FROM,  # motion of the extender: from, to [m], progress 0 … 1, samples, rate 0 … 1, samples of rest so far
    MOVE_TO,
    MOVE_DONE,
    MOVE_SAMPLES,
    MOVE_RATE,
    MOVE_RESTED,
    EXTENSION,  # of the coming or present step, as part of the stroke
    FINAL,  # 1 when fine positioning follows the step
    STEP_LENGTH,  # commanded length of the step [m], without sign
    STEP_FROM,  # slider when the step began to carry [m]
    JUDGE,  # 1 when a step has been carried out and not been judged
    WALKED,  # 1 after continuous walking, until the motor holds its position
    STILL,  # steps in a row in which the slider did not move
    RETURNS,  # returns in a row without a step
    ANCHOR,  # where the runaway guard measures from [m]
    FINE_POSITION,
    FINE_VELOCITY,
    FINE_ERROR,  # smoothed setpoint less slider [m]
    FINE_SLIP,  # smoothed slip of the front clamp [m]
    FINE_LATE,  # samples outside of the tolerance
    FINE_GOAL,
    TIP,  # wanted extension [m]: the reference without the pretension
    LOAD,  # learned deflection of the extender by the load [m]
    PRETENSION,  # part of the load that the reference takes off [m], and the ends of its ramp
    PRETENSION_FROM,
    PRETENSION_TO,
    GIVEN_WAY,  # sum over the samples of a step of how far the extender is from where it should be [m]
    FELT,  # how many samples those are
    WEIGHED,  # steps from which the load was learned so far
    FINE_DRIFT,  # the part of the slip that is taken for drift [m]
) = range(64)
#: Learned step models, forward and backward (see :mod:`hysteresis_ros.references.inchworm_steps`).
FORWARD_MODEL = 64
BACKWARD_MODEL = 69

#: Continuous walking.
(
    CYCLE,  # 1 while the extender moves by the phase
    CYCLE_PHASE,  # of the path, 0 … 1
    CYCLE_RATE,  # [1/sample]
    BRAKING,  # by how much the rate falls in a sample when the motor stops
    PATH,  # of the slider when the cycle began [m]
    PATH_ERROR,  # path less measured slider [m]
    CORRECTION,  # of the extension [m]
    LEARNS,  # 1: every whole cycle corrects the correction
    FORGETS,  # 1: it is to be forgotten at the next cycle
    WHOLE,  # 1 while the present cycle is one to learn from
    STAND_SUM,  # of the slider while it stands, and of how many samples
    STAND_COUNT,
    SQUARES,  # sum of the squared errors of the present cycle, and of how many samples
    SQUARE_COUNT,
    RIPPLE,  # RMS of the error over the last whole cycle [m]
    LEARNED_CYCLES,  # so far
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

#: Errors. A bad sensor heals itself; the others stay until start.
NO_ERROR, SENSOR_ERROR, NO_MOTION_ERROR, RUNAWAY_ERROR, SLIP_ERROR = range(5)
ERROR_NAMES = ("", "sensor", "no_motion", "runaway", "slip")

#: Sources of the controller's measurement: none (it reads its reference), the extender, the slider.
BLOCKED, OWN, FOLLOWING = range(3)
