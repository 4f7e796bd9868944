# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motion controller as a part of the loop: computation of a sample, blocks, live parameter changes, requests."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.control import feedforward as feeding
from hysteresis_ros.control import law as header
from hysteresis_ros.control.controller import (
    ARMED,
    BIAS,
    DECAY,
    ENTRIES,
    ControllerParameters,
    HandoverParameters,
    History,
    arm,
    controller_block,
    damping_block,
    feedforward_block,
    go_on_from,
    handover,
    handover_block,
    note,
    prepare_controllers,
    successor,
)
from hysteresis_ros.control.damping import inner_loop as damping
from hysteresis_ros.control.damping.inner_loop import as_output, damp
from hysteresis_ros.control.damping.kind import FORCE as BY_FORCE
from hysteresis_ros.control.feedforward import feedforward
from hysteresis_ros.control.law import Controller
from hysteresis_ros.control.learning import (
    FORGETTING,
    FROZEN,
    LEARNING,
    Learning,
    learned_correction,
    shown,
    write_learned,
)
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop import quiet as quieting
from hysteresis_ros.loop.parameters import ControllerNodeParameters, part
from hysteresis_ros.loop.quiet import begin_quiet, end_quiet, held_command, is_quiet, quietened
from hysteresis_ros.loop.watch import (
    FOLLOWING,
    GUARD_STATES,
    HOLDING,
    QUIET,
    RUNNING,
    STALE,
    STAMP,
    STOPPED,
    TRIPPED,
    WatchArrays,
    guard_parameters,
    is_stale,
    receive,
    samples_of,
    towards,
)
from hysteresis_ros.models.block import interpreted, kernel, nested


class ControlArrays(NamedTuple):
    """Parameter arrays, or state arrays, of the blocks of a motion controller."""

    feedforward: np.ndarray
    controller: np.ndarray
    damping: np.ndarray
    handover: np.ndarray
    return_path: np.ndarray
    history: np.ndarray
    learning: np.ndarray


class ControllerArrays(NamedTuple):
    """All arrays of a motion controller in the loop."""

    p: ControlArrays
    x: ControlArrays
    watch_p: WatchArrays
    watch_x: WatchArrays


#: If achieved commands were reported, and then are not for this number of samples, the controller assumes that no node
#: reports them any more.
UNFOLLOWED_SAMPLES = 20

#: Faults that act on the inputs of the controller.
TARGETS = (faulty.MEASUREMENT, faulty.APPLIED, faulty.STOP)

# Own parameters.
SAFE_COMMAND = 0  # [m]
SAFE_STEP = 1  # [m] a sample
PRELOAD = 2  # offset of the model [m]
USE_ORIGIN = 3  # 1: the measurement is relative to the sequencer's origin
PREDICTS = 4  # 1: while a measurement is missing, the law uses the prediction of its observer
LOWEST = 5  # least and largest command that is sent [m]
HIGHEST = 6
NEEDS_FORCE = 7  # 1: the damping feeds back the force; without a measured force there is no command
# the parameters of :mod:`.quiet` follow

# Own state.
STOP = 0  # 1 while stopped
RETURNING = 1  # 1: restart the controller with the next sample, from the last command; AT_SAFE_VOLTAGE
ON_PATH = 2  # 1 while the reference fades from the displacement to the received reference
UNANSWERED = 3  # samples since the last achieved command
ANSWERED = 4  # 1 after the first achieved command
REFERENCE = 5  # last finite reference [m]
COMMANDED = 6  # last command [m]; with active damping this is the output of the damping, not of the law
OFFSET_LEFT = 7  # difference from the offset before a change, decaying to zero [m]
FORCE = 8  # measured force of the last sample [N]
ACHIEVED = 9  # last achieved command [m]
# the state of :mod:`.quiet` follows

#: Value of RETURNING from a stop by the plant on, in which the voltage goes to its safe value by itself. The command is
#: then the achieved one until the controller restarts: from any other command the voltage would begin with a bias, and
#: the controller would take the difference between command and achieved command for a saturation.
AT_SAFE_VOLTAGE = 2.0

#: Smaller offsets count as zero [m].
NO_OFFSET = 1e-18


@kernel
def present_offset(own_p, own, decay):
    """Return the offset of the measurement in this sample [m]; after a change it moves gradually to the new value."""
    left = own[OFFSET_LEFT]
    if left == 0.0:
        return own_p[PRELOAD]
    own[OFFSET_LEFT] = left * decay if abs(left) > NO_OFFSET else 0.0
    return own_p[PRELOAD] + left


@kernel
def resume(x, own, value):
    """Restart the controller at the displacement ``value`` [m]; the command continues from the last command.

    The reference also starts at the displacement and moves gradually to the received reference. A reaching law needs
    this: it responds mildly to a step of the reference, but strongly to a lasting difference between its command and
    the achieved command (Φ = 0.93 amplifies a constant difference by 1/(1 - Φ) = 14). After a quiet hold the controller
    keeps its states, because the axis has stood still.
    """
    own[RETURNING] = 0.0
    own[ON_PATH] = 1.0
    x.feedforward[feeding.STARTED] = 0.0
    x.history[ENTRIES] = 0.0
    x.damping[damping.STARTED] = 0.0
    go_on_from(x.handover, own[COMMANDED])
    go_on_from(x.return_path, value)
    if own[quieting.CONTINUES] != 0.0:
        # the mean of the last measurements, because the noise of a single one would enter the reference
        go_on_from(x.return_path, own[quieting.SEEN])
        # the command differs from the held command only by the noise of one sample, so the difference is halved in each
        # sample instead of fading slowly
        x.handover[ARMED], x.handover[BIAS] = 2.0, 0.0
        own[quieting.CONTINUES] = 0.0
    else:
        x.controller[header.STARTED] = 0.0


@kernel
def foreseeable(own_p, own, state, seen):
    """Tell whether an active observer can predict the displacement that is not measured in this sample."""
    return own_p[PREDICTS] != 0.0 and own[RETURNING] == 0.0 and state[header.STARTED] != 0.0 and seen != seen


@kernel
def corrected(p, x, own, value, followed, skipped):
    """Return the reference [m] plus the learned correction; ``followed``: whether the axis follows the reference."""
    if p.learning.shape[0] == 0:
        return own[REFERENCE]
    error = own[REFERENCE] - value
    if not followed or own[RETURNING] != 0.0 or own[ON_PATH] != 0.0:
        error = math.nan
    shortfall = x.controller[header.APPLIED] - x.controller[header.COMMAND]
    error = shown(p.learning, x.learning, error, shortfall, skipped)
    return own[REFERENCE] + learned_correction(p.learning, x.learning, own[REFERENCE], error)


@kernel
def follow(p, x, own, wanted):
    """Pass the reference ``wanted`` [m] to the feedforward and return the delayed reference [m]."""
    reference = wanted
    if own[ON_PATH] != 0.0:
        reference = handover(p.return_path, x.return_path, wanted)
        if reference == wanted:
            own[ON_PATH] = 0.0
    return feedforward(p.feedforward, x.feedforward, reference)


@kernel
def follow_while_holding(p, x, own, wanted):
    """Pass on the reference [m] while a measurement is missing, so that the feedforward's preview has no gap."""
    if own[RETURNING] == 0.0 and x.feedforward[feeding.STARTED] != 0.0:
        follow(p, x, own, wanted)


@nested
def answer(laws, arrays, value, wanted, force):
    """Return the command [m] for the displacement ``value`` [m] without offset; NaN: the law predicts the displacement.

    ``force`` is the measured force [N].
    """
    p, x, own = arrays.p, arrays.x, arrays.watch_x.own
    if own[RETURNING] != 0.0:
        resume(x, own, value)
    delayed = follow(p, x, own, wanted)
    fed = x.feedforward[feeding.COMMAND]
    known = value if value == value else x.controller[header.ESTIMATED]
    note(x.history, x.controller[header.APPLIED], delayed, fed, known)
    x.controller[header.FEEDFORWARD] = fed
    wanted = laws.controller(p.controller, x.controller, delayed, value)
    seen = value if value == value else x.controller[header.ESTIMATED]
    return handover(p.handover, x.handover, damp(p.damping, x.damping, wanted, seen, force))


@kernel
def resting(own_p, own, mode, value):
    """Return the command [m] of a controller that does not run, in this mode, with the displacement ``value`` [m].

    It slews to the safe command, in a quiet hold to the held command, and without a compensator to the displacement;
    from a stop by the plant on it is the achieved command. The slew rate is also limited while the command follows the
    displacement, because otherwise command and displacement would form a loop with gain 1.
    """
    target = value if mode == FOLLOWING else own_p[SAFE_COMMAND]
    if mode == QUIET:
        target = held_command(own_p, own, value)
    else:
        end_quiet(own)
    if mode == TRIPPED:
        own[RETURNING] = AT_SAFE_VOLTAGE
    if own[RETURNING] == AT_SAFE_VOLTAGE and own[ANSWERED] != 0.0:
        return own[ACHIEVED]
    own[RETURNING] = 1.0
    return towards(own[COMMANDED], target, own_p[SAFE_STEP])


@nested
def control(laws, arrays, row):
    """Read reference and measurement of a sample from its row and write the command."""
    own_p, own = arrays.watch_p.own, arrays.watch_x.own
    guard_p, guard = arrays.watch_p.guard, arrays.watch_x.guard
    faults_p, faults = arrays.watch_p.faults, arrays.watch_x.faults
    state = arrays.x.controller
    if own_p[quieting.ON_PULSE] != 0.0 and row[at.TRIGGER_IN] > 0.0:
        begin_quiet(own_p, own, own_p[quieting.ON_PULSE])
    own[FORCE] = row[at.FORCE]
    # a loop that is designed for the damped stage must stay open while the damping has no measured force
    unforced = own_p[NEEDS_FORCE] != 0.0 and own[FORCE] - own[FORCE] != 0.0
    missing = 1.0 if unforced else row[at.SKIPPED]
    seen = receive(guard_p, guard, faults_p, faults, faulty.MEASUREMENT, row[at.MEASURED], missing)
    command, value = own[COMMANDED], seen
    if row[at.REFERENCE] - row[at.REFERENCE] == 0.0:
        own[REFERENCE] = row[at.REFERENCE]
    elif own_p[USE_ORIGIN] != 0.0:
        # without reference and origin the setpoint of the extender is unknown, so the extender holds
        value = row[at.REFERENCE]
    if own_p[USE_ORIGIN] != 0.0:
        value -= row[at.ORIGIN]
    offset = present_offset(own_p, own, arrays.p.handover[DECAY])
    value -= offset
    mode, answered = RUNNING, False
    unfollowed = own[ANSWERED] != 0.0 and own[UNANSWERED] >= UNFOLLOWED_SAMPLES
    if row[at.TRIPPED] != 0.0:
        mode = TRIPPED
    elif faulty.given_instead(faults_p, faults, faulty.STOP, own[STOP]) != 0.0:
        mode = STOPPED
    elif is_stale(guard_p, guard):
        mode = STALE
    elif is_quiet(own) and not unfollowed:
        mode = QUIET
    elif value != value and (unfollowed or unforced or not foreseeable(own_p, own, state, seen)):
        mode = HOLDING
    elif unfollowed:
        mode = FOLLOWING
    else:
        answered = True
        if value != value:
            mode = HOLDING
    wanted = corrected(arrays.p, arrays.x, own, value, answered, row[at.SKIPPED])
    if answered:
        command = answer(laws, arrays, value, wanted, own[FORCE])
    elif mode != HOLDING:
        command = resting(own_p, own, mode, value)
    else:
        follow_while_holding(arrays.p, arrays.x, own, wanted)
    own[UNANSWERED] += 1.0
    # the law's own command is kept, because its difference from the achieved command shows saturation
    state[header.COMMAND] = as_output(arrays.p.damping, arrays.x.damping, command)
    sent = quietened(own_p, own, wanted, command) if answered else command
    sent = min(max(sent, own_p[LOWEST]), own_p[HIGHEST])
    if sent != command:
        state[header.APPLIED] = as_output(arrays.p.damping, arrays.x.damping, sent)
    own[COMMANDED] = sent
    row[at.COMMAND] = sent
    row[at.SEEN] = seen
    row[at.ESTIMATED] = state[header.ESTIMATED] + offset
    row[at.SWITCHING] = state[header.SWITCHING]
    row[at.DISTURBANCE] = state[header.DISTURBANCE]
    row[at.CONTROLLER_MODE] = mode


@nested
def carried_out(arrays, applied):
    """Give the controller the achieved value [m] of its last command; NaN: unknown."""
    own = arrays.watch_x.own
    heard = faulty.given_instead(arrays.watch_p.faults, arrays.watch_x.faults, faulty.APPLIED, applied)
    if heard - heard == 0.0:
        arrays.x.controller[header.APPLIED] = as_output(arrays.p.damping, arrays.x.damping, heard)
        own[ACHIEVED] = heard
        own[UNANSWERED] = 0.0
        own[ANSWERED] = 1.0


class ControllerPart:
    """Feedforward, controller and bumpless transfer of an axis, with their monitoring.

    The control laws receive the measurement minus the offset of the preload. They treat a change of the offset as a
    motion, so their integrated states stay valid.
    """

    def __init__(self, parameters: ControllerNodeParameters):
        self.parameters = parameters
        block = part(parameters, ControllerParameters).without_preload
        sample_time = 1.0 / parameters.sample_rate
        self.feedforward = feedforward_block(block, sample_time)
        self.controller = controller_block(block, sample_time)
        self.damping = damping_block(block, sample_time)
        self.handover = handover_block(block, sample_time)
        self._return_path = handover_block(block, sample_time)
        self.history = History()
        self.learning = Learning(parameters.learning, sample_time, parameters.handover_time)
        faults = faulty.fault_parameters(parameters.faults, TARGETS, parameters.sample_rate)
        self._watch_p = WatchArrays(self._guard(parameters), faults, np.zeros(quieting.OWN_PARAMETERS))
        self._watch_x = WatchArrays(np.zeros(GUARD_STATES), faulty.fault_state(faults), np.zeros(quieting.OWN_STATES))
        self._pack_own(parameters)
        self._connect()
        self._resting_displacement: Callable[[], float] | None = None

    @staticmethod
    def _guard(parameters) -> np.ndarray:
        given = parameters.spike_limit, parameters.spike_samples, parameters.frozen_samples
        return guard_parameters(parameters.measurement_timeout, parameters.sample_rate, *given)

    def _pack_own(self, parameters) -> None:
        own = self._watch_p.own
        own[SAFE_COMMAND] = parameters.safe_command
        own[SAFE_STEP] = parameters.safe_slew_rate / parameters.sample_rate
        own[PRELOAD] = parameters.model.preload.offset
        own[USE_ORIGIN] = parameters.use_origin
        own[PREDICTS] = self.controller.predicts
        own[LOWEST], own[HIGHEST] = parameters.command_range
        own[NEEDS_FORCE] = parameters.damping.source == BY_FORCE
        rate, given = parameters.sample_rate, parameters.quiet
        own[quieting.AVERAGED] = max(samples_of(given.average, rate), 2.0)
        # a separate node receives a pulse as a message, begins the hold itself, and logs the hold as a change
        pulsed = parameters.time_mode == "fused" and given.on_trigger > 0.0
        own[quieting.ON_PULSE] = samples_of(given.on_trigger, rate) if pulsed else 0.0

    @property
    def _blocks(self) -> tuple:
        """The blocks in the order of :class:`ControlArrays`."""
        first = self.feedforward, self.controller, self.damping, self.handover
        return (*first, self._return_path, self.history, self.learning)

    def _connect(self) -> None:
        """Return the arrays of the present blocks together."""
        self.arrays = ControllerArrays(
            ControlArrays(*(block.p for block in self._blocks)),
            ControlArrays(*(block.x for block in self._blocks)),
            self._watch_p,
            self._watch_x,
        )

    @property
    def kernel(self):
        """Law of the controller, for the loop."""
        return self.controller.kernel

    @property
    def command(self) -> float:
        """Last command [m]."""
        return float(self._watch_x.own[COMMANDED])

    def install(self, controller: Controller) -> None:
        """Replace the controller of an axis at rest; :meth:`retune` replaces it while the axis runs."""
        self.controller = controller
        self._pack_own(self.parameters)
        self._connect()

    def prepare(self) -> None:
        """Compile all controllers in advance, because any of them may take over within a sample."""
        prepare_controllers()

    def inject(self, faults: tuple[str, ...]) -> None:
        """Replace the scheduled faults; their times are counted from now."""
        p = faulty.fault_parameters(faults, TARGETS, self.parameters.sample_rate)
        # the sample numbers of the measurements are also counted from now
        self._watch_x.guard[STAMP] = -1.0
        self._watch_p = self._watch_p._replace(faults=p)
        self._watch_x = self._watch_x._replace(faults=faulty.fault_state(p))
        self._connect()

    def stop(self) -> None:
        """Slew to the safe command, beginning with the next sample."""
        self._watch_x.own[STOP] = 1.0

    def start(self) -> None:
        """Continue without a jump."""
        self._watch_x.own[STOP] = 0.0
        self._watch_x.own[RETURNING] = self._watch_x.own[RETURNING] or 1.0

    def quiet(self, duration: float) -> None:
        """Hold the command constant for ``duration`` [s], beginning after twice ``quiet.average``; 0 ends a hold."""
        quieting.require_numbers(duration)
        if self.parameters.use_origin:
            remedy = "an inchworm motor is quiet when its clamps hold it: stop the sequencer instead"
            raise ParameterError([Problem(f"{quieting.QUIET}: {quieting.DURATION}", duration, remedy, "s")])
        samples = samples_of(duration, self.parameters.sample_rate) if duration else 0.0
        interpreted(begin_quiet)(self._watch_p.own, self._watch_x.own, samples)

    def learn(self) -> None:
        """Learn, beginning with the next sample."""
        self.learning.set_mode(LEARNING)

    def freeze(self) -> None:
        """Stop learning and keep applying the learned correction, beginning with the next sample."""
        self.learning.set_mode(FROZEN)

    def forget(self) -> None:
        """Let the learned correction decay to zero."""
        self.learning.set_mode(FORGETTING)

    def save(self, path, configuration: str = "") -> None:
        """Write the learned correction to a file."""
        write_learned(path, self.learning.learned(), configuration)

    def begin_at(self, resting_displacement: Callable[[], float]) -> None:
        """Begin, also after a reset, with the displacement [m] at the safe voltage as achieved command.

        Otherwise the voltage would begin with a bias, as after a stop by the plant (:func:`control`).
        """
        self._resting_displacement = resting_displacement
        self._return_to_rest()

    def _return_to_rest(self) -> None:
        if self._resting_displacement is None:
            return
        own, command = self._watch_x.own, self._resting_displacement()
        own[COMMANDED], own[RETURNING] = command, AT_SAFE_VOLTAGE
        interpreted(carried_out)(self.arrays, command)

    def reset(self) -> None:
        """Return to the state of rest."""
        for block in self._blocks:
            block.reset()
        stopped = self._watch_x.own[STOP]
        self._watch_x.guard[:] = 0.0
        self._watch_x.faults[:] = faulty.fault_state(self._watch_p.faults)
        self._watch_x.own[:] = 0.0
        self._watch_x.own[STOP] = stopped
        self._return_to_rest()

    def retune(self, parameters: ControllerNodeParameters) -> None:
        """Apply new gains, or another type of controller; the command continues without a jump."""
        block = part(parameters, ControllerParameters).without_preload.validated()
        own = block.before_damping(1.0 / parameters.sample_rate)
        learning = self.learning.changed(block.learning, block.handover_time)
        self._require_force(block)
        lasting = None
        if block.type == self.parameters.type:
            self._require_order(block, own)
            self._retune_controller(own)
        else:
            # all checks come before the first change
            controller, lasting = successor(own, 1.0 / parameters.sample_rate, self.controller, self.history)
            self.feedforward.retune(own)
            self.controller = controller
        self.damping.retune(block)
        self.handover.retune(HandoverParameters(time=block.handover_time))
        self._return_path.retune(HandoverParameters(time=block.handover_time))
        arm(self.handover, self.command, None if lasting is None else lasting * self.damping.direct)
        self.learning.take(learning)
        self._watch_p.guard[:] = self._guard(parameters)
        self._watch_x.own[OFFSET_LEFT] += self.parameters.model.preload.offset - parameters.model.preload.offset
        self._pack_own(parameters)
        self.parameters = parameters
        self._connect()

    def _require_force(self, block: ControllerParameters) -> None:
        """Refuse damping by force feedback if no force is measured."""
        if block.damping.source == BY_FORCE and not np.isfinite(self._watch_x.own[FORCE]):
            remedy = f"missing force joint '{self.parameters.force_joint}': no force is measured; use irc or ppf"
            raise ParameterError([Problem("damping.type", block.damping.type, remedy)])

    def _require_order(self, block: ControllerParameters, own: ControllerParameters) -> None:
        """Refuse a change of the type of damping if it would change the order of observer or inverse dynamics."""
        given, present = own.model.dynamics.order, self.controller.parameters.model.dynamics.order
        damping = self.parameters.damping.type
        fixed = "kalman" in own.law.groups or own.feedforward.type == "inverse_dynamics"
        if fixed and given != present and block.damping.type != damping:
            remedy = (
                f"the damped plant would have {given} states, but observer and feedforward were designed "
                f"for {present}: keep {damping}, or clean up and configure again"
            )
            raise ParameterError([Problem("damping.type", block.damping.type, remedy)])

    def _retune_controller(self, block: ControllerParameters) -> None:
        before, state = self.controller.parameters, self.controller.state
        self.controller.retune(block)
        try:
            self.feedforward.retune(block)
        except ParameterError:
            self.controller.retune(before)
            self.controller.state = state
            raise
