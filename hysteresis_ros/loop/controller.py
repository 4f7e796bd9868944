# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motion controller as a part of the loop: its blocks, their live changes, and what is asked of it."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.base import Controller
from hysteresis_ros.control.controller import (
    ControllerParameters,
    controller_block,
    damping_block,
    feedforward_block,
    handover_block,
    prepare_controllers,
)
from hysteresis_ros.control.damping.kind import FORCE as BY_FORCE
from hysteresis_ros.control.handover import HandoverParameters, arm
from hysteresis_ros.control.learning.block import Learning
from hysteresis_ros.control.learning.correction import (
    FORGETTING,
    FROZEN,
    LEARNING,
)
from hysteresis_ros.control.learning.file import write_learned
from hysteresis_ros.control.succession import History, successor
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.loop.control_sample import (
    COMMANDED,
    FORCE,
    HIGHEST,
    LOWEST,
    NEEDS_FORCE,
    OFFSET_LEFT,
    OWN_PARAMETERS,
    OWN_STATES,
    PREDICTS,
    PRELOAD,
    RETURNING,
    SAFE_COMMAND,
    SAFE_STEP,
    STOP,
    TARGETS,
    USE_ORIGIN,
    ControlArrays,
    ControllerArrays,
)
from hysteresis_ros.loop.node_parameters import ControllerNodeParameters
from hysteresis_ros.loop.watch import (
    GUARD_STATES,
    STAMP,
    WatchArrays,
    guard_parameters,
)


class ControllerPart:
    """Feedforward, controller and hand-over of an axis, with what watches over them.

    The preload's offset is taken off the measurement before the laws see it: a change of it is nothing to them but a
    measurement that moves, and all they have integrated stays right.

    Parameters
    ----------
    parameters : ControllerNodeParameters
        Checked on construction.

    Raises
    ------
    ParameterError
        Names every wrong parameter.
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
        self._watch_p = WatchArrays(self._guard(parameters), faults, np.zeros(OWN_PARAMETERS))
        self._watch_x = WatchArrays(np.zeros(GUARD_STATES), faulty.fault_state(faults), np.zeros(OWN_STATES))
        self._pack_own(parameters)
        self._connect()

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

    @property
    def _blocks(self) -> tuple:
        """The blocks in the order of :class:`ControlArrays`."""
        first = self.feedforward, self.controller, self.damping, self.handover
        return (*first, self._return_path, self.history, self.learning)

    def _connect(self) -> None:
        """Put the arrays of the present blocks together."""
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
        """Put another controller in the place of the present one, at rest; :meth:`retune` takes one over live."""
        self.controller = controller
        self._pack_own(self.parameters)
        self._connect()

    def prepare(self) -> None:
        """Compile whatever may be needed while running: any controller may take over within a sample."""
        prepare_controllers()

    def inject(self, faults: tuple[str, ...]) -> None:
        """Let these faults happen, their times counted from now on, and no others."""
        p = faulty.fault_parameters(faults, TARGETS, self.parameters.sample_rate)
        # measurements are numbered from now on, too
        self._watch_x.guard[STAMP] = -1.0
        self._watch_p = self._watch_p._replace(faults=p)
        self._watch_x = self._watch_x._replace(faults=faulty.fault_state(p))
        self._connect()

    def stop(self) -> None:
        """Slew to the safe command from the next sample on."""
        self._watch_x.own[STOP] = 1.0

    def start(self) -> None:
        """Go on without a jump."""
        self._watch_x.own[STOP] = 0.0
        self._watch_x.own[RETURNING] = 1.0

    def learn(self) -> None:
        """Learn from the next sample on."""
        self.learning.set_mode(LEARNING)

    def freeze(self) -> None:
        """Repeat what was learned from the next sample on."""
        self.learning.set_mode(FROZEN)

    def forget(self) -> None:
        """Let what was learned go to zero."""
        self.learning.set_mode(FORGETTING)

    def save(self, path, configuration: str = "") -> None:
        """Write what was learned.

        Parameters
        ----------
        path : path-like
        configuration : str
            Name of the configuration of the axis.

        Raises
        ------
        ParameterError
            Nothing was learned.
        ConfigurationError
            The file cannot be written.
        """
        write_learned(path, self.learning.learned(), configuration)

    def reset(self) -> None:
        """Begin again with everything at rest."""
        for block in self._blocks:
            block.reset()
        stopped = self._watch_x.own[STOP]
        self._watch_x.guard[:] = 0.0
        self._watch_x.faults[:] = faulty.fault_state(self._watch_p.faults)
        self._watch_x.own[:] = 0.0
        self._watch_x.own[STOP] = stopped

    def retune(self, parameters: ControllerNodeParameters) -> None:
        """Take new gains, or another type of controller; the command goes on from where it is.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; nothing is changed then.
        """
        block = part(parameters, ControllerParameters).without_preload.validated()
        own = block.before_damping(1.0 / parameters.sample_rate)
        learning = self.learning.changed(block.learning, block.handover_time)
        self._require_force(block)
        lasting = None
        if block.type == self.parameters.type:
            self._require_order(block, own)
            self._retune_controller(own)
        else:
            # whatever may be refused is, before anything changes
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
        """Refuse to begin with a damping of a force that nobody measures."""
        if block.damping.source == BY_FORCE and not np.isfinite(self._watch_x.own[FORCE]):
            allowed = f"missing force joint '{self.parameters.force_joint}': no force is measured; take irc or ppf"
            raise ParameterError([Problem("damping.type", block.damping.type, allowed)])

    def _require_order(self, block: ControllerParameters, own: ControllerParameters) -> None:
        """Refuse another damping under an observer, or an inverse of the dynamics, of the order of the present one."""
        given, present = own.model.dynamics.order, self.controller.parameters.model.dynamics.order
        damping = self.parameters.damping.type
        fixed = "kalman" in own.law.groups or own.feedforward.type == "inverse_dynamics"
        if fixed and given != present and block.damping.type != damping:
            allowed = (
                f"gives the damped plant {given} states, observer and feedforward have {present}: keep {damping}, or "
                "clean up and configure anew"
            )
            raise ParameterError([Problem("damping.type", block.damping.type, allowed)])

    def _retune_controller(self, block: ControllerParameters) -> None:
        before, state = self.controller.parameters, self.controller.state
        self.controller.retune(block)
        try:
            self.feedforward.retune(block)
        except ParameterError:
            self.controller.retune(before)
            self.controller.state = state
            raise
