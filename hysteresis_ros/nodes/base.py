# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The shared lifecycle of all nodes: parameters, autostart, topics, services, diagnostics."""

from __future__ import annotations

import math
import time
from array import array
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt64
from std_srvs.srv import Trigger

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError
from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS
from hysteresis_ros.nodes.changes import ChangeLog
from hysteresis_ros.nodes.compatibility import Compatibility
from hysteresis_ros.nodes.diagnostics import diagnostics, introduction
from hysteresis_ros.nodes.endpoints import Endpoints
from hysteresis_ros.nodes.fused import Fused
from hysteresis_ros.nodes.lifecycle import GuardedLifecycleNode
from hysteresis_ros.nodes.lockstep import Lockstep, Partners
from hysteresis_ros.nodes.masters import Masters, require_alone
from hysteresis_ros.nodes.parameters import ParameterInterface, TabledParameters
from hysteresis_ros.nodes.qos import diagnostics_qos, latched_qos
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.services import answered
from hysteresis_ros.nodes.timing import Pace


class AxisNode(TabledParameters, Endpoints, GuardedLifecycleNode):
    """Base of the nodes of an axis.

    Subclasses implement :meth:`build` (blocks from parameters), :meth:`connect` (publishers and subscriptions),
    :meth:`reset_blocks`, :meth:`retune`, and what happens on a sample. When that happens is decided by :attr:`runner`,
    lockstep or real time. A mistake of the user or a broken run ends in :attr:`failure`, a sentence; the process that
    runs the node then leaves with :attr:`exit_code`.

    Parameters
    ----------
    name : str
        Node name; also chooses the parameter table.
    """

    #: Whether the node has ``~/state``.
    has_state = True
    #: Seconds without an input after which it is missed, and after which somebody else may feed it.
    patience: float = math.inf
    #: Whether something is missing of what this node is there for, however it leaves.
    has_lost: bool = False
    #: Whether the part may begin again amid an axis that runs, without a step of its output.
    rests: bool = True
    #: Part of partner_timeout after which this node complains in lockstep. Who waits directly for the culprit complains
    #: first, so that the error names the culprit and not a node that waits itself.
    share = 1.0
    #: Parameters that say what the node is at work as.
    identity: tuple[str, ...] = ()
    #: Seconds at most for which a node that listens at exit does.
    listens_for = 0.3
    #: Services std_srvs/Trigger, each answered by the method of its name with ``_on_`` before it.
    triggers: tuple[str, ...] = ("start", "stop", "reset")

    def __init__(self, name: str, **options):
        super().__init__(name, **options)
        self.kind = name
        self.state_names: tuple[str, ...] = ()
        self.interface = ParameterInterface(self, NODE_PARAMETERS[name], self._retune)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.partners = Partners(self)
        self.masters = Masters(self)
        self.parameters = None
        self.runner = None
        #: With time_mode fused: the axis of which this node is one, in this process.
        self.fused = None
        self.changes = ChangeLog(name)
        self.active = False
        #: Whether the process is about to end.
        self.leaving = False
        self.running = True
        self.finished = False
        self.failure = ""
        self.exit_code = 0
        self.pace = Pace()
        self.sample = 0
        self.end_of_run = -1
        self._topic_handles: list = []
        self._loop_publishers: list = []
        self._work_timers: list = []
        self._warned: dict[str, int] = {}
        self._reported: dict[str, int] = {}
        self.active_since = 0.0
        self.compatibility = Compatibility(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", diagnostics_qos(keeps=True))
        self.create_timer(1.0, self.tell_health, clock=self.steady)
        for service in self.triggers:
            self.create_service(Trigger, f"~/{service}", answered(getattr(self, f"_on_{service}")))

    # -- what subclasses provide -------------------------------------------------------------------------------

    def build(self, parameters) -> None:
        """Make the blocks. Raises HysteresisError when the parameters do not fit together."""

    def unbuild(self) -> None:
        """Let go of what :meth:`build` has taken from outside; called at cleanup, and when configuring has failed."""

    def connect(self) -> None:
        """Make publishers and subscriptions."""

    def begin(self) -> None:
        """Go to work after activation."""

    def make_runner(self):
        """Return what decides when a sample is dealt with."""
        if self.parameters.time_mode == "fused":
            return Fused(self)
        return self.lockstep_runner(self) if self.parameters.time_mode == "lockstep" else self.real_time_runner(self)

    #: Runners of the time modes in which every node makes its part of a sample.
    lockstep_runner: Any = Lockstep
    real_time_runner: Any = RealTime

    @property
    def is_motor(self) -> bool:
        """Whether the axis is an inchworm motor's."""
        return False

    def state_signals(self) -> dict[str, str]:
        """Return what stands in ``~/state``: name in the message → signal."""
        return signals.state_signals(self.kind, self.is_motor)

    @property
    def holds_time(self) -> bool:
        """Whether this node has stopped the time of the axis itself."""
        return False

    def go_safe(self) -> None:
        """Bring the outputs to their safe values at once; called on deactivation and at exit."""

    def release(self) -> None:
        """Let go of threads and files; called on deactivation and at exit, also after the regular end of a run."""

    @property
    def listens_at_exit(self) -> bool:
        """Whether this node still takes what is under way to it before it leaves."""
        return False

    def drained(self) -> bool:
        """Tell whether nothing is under way any more to a node that listens at exit."""
        return True

    def reset_blocks(self) -> None:
        """Return blocks and counters to the beginning."""

    def retune(self, parameters) -> None:
        """Take changed parameters without a jump."""

    def on_running(self, running: bool) -> None:
        """``~/start`` (True) or ``~/stop`` (False) was called."""

    def hindrance(self) -> str:
        """Say why this node does not work though nobody has stopped it; empty when it does."""
        return "" if self.active else "inactive: activate it first"

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs; empty when nobody is awaited."""
        return ""

    def log_change(self, action: str, parameters: dict | None = None) -> None:
        """Publish what was changed and from which sample on, so that a recorded run can be repeated.

        Parameters
        ----------
        action : str
            ``start``, ``stop`` or ``retune``.
        parameters : dict, optional
            With ``retune``: flat dotted parameters with their new values.
        """
        entry = {"sample": self.sample, "node": self.kind, "action": action, **self.change_details()}
        self.changes.publish({**entry, "parameters": parameters or {}})

    def change_details(self) -> dict:
        """Return what else a change's log says: what of the sample has been done before."""
        return {}

    def health(self) -> tuple[int, str, dict]:
        """Return diagnostic level (0 OK, 1 warning, 2 error), message and further values."""
        return 0, "", {}

    # -- lifecycle ---------------------------------------------------------------------------------------------

    def on_configure(self, state):
        """Read and check the parameters, build the blocks, connect the topics."""
        try:
            self.parameters = self.interface.read()
            self.build(self.parameters)
            self.runner = self.make_runner()
            self._connect()
        except HysteresisError as error:
            problems = error.problems if isinstance(error, ParameterError) else (error,)
            return self._not_configured(problems, 2)
        except Exception as error:  # rclpy would swallow it without a word
            return self._not_configured((f"{type(error).__name__}: {error}",), 1)
        self.failure, self.exit_code = "", 0
        return super().on_configure(state)

    def _not_configured(self, problems, exit_code: int):
        lines = [" ".join(str(problem).split()) for problem in problems]
        for line in lines:
            self.get_logger().error(f"not configured: {line}")
        self.failure, self.exit_code = f"not configured: {'; '.join(lines)}", exit_code
        self._disconnect()
        return TransitionCallbackReturn.FAILURE

    def _connect(self) -> None:
        self.pace = self.runner.make_pace()
        names = self.state_names = tuple(self.state_signals()) if self.has_state else ()
        self._state = JointState(name=list(names), position=array("d", bytes(8 * len(names))))
        self._state_publisher = self.publisher(JointState, "~/state", self.qos()) if names else None
        if names:
            self.changes.open(self.publisher(String, "changes", self.changes_qos()), self.parameters.to_mapping())
        self.runner.connect()
        self.connect()

    def _disconnect(self) -> None:
        self.unbuild()
        for destroy, handle in self._topic_handles:
            destroy(handle)
        self._topic_handles.clear()
        self._loop_publishers.clear()
        self.partners.clear()
        self.masters.clear()
        self.interface.typed = None
        self.parameters = None
        self.changes.close()

    def on_activate(self, state):
        """Start working."""
        try:
            require_alone(self)
            self.active, self.active_since = True, time.monotonic()
            self.pace.restart()
            self.runner.begin()
            self.begin()
            self.masters.begin()
        except HysteresisError as error:
            self.get_logger().error(f"not activated: {error}")
            self.exit_code = 2
            self._stop_working()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would swallow it without a word
            self.fail(f"not activated: {type(error).__name__}: {error}")
            self._stop_working()
            return TransitionCallbackReturn.FAILURE
        self.get_logger().info(introduction(self))
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Stop working; outputs go to their safe values. A lockstep run is over: the next one starts at sample 0."""
        self.runner.part()
        self.runner.go_safe()
        self._stop_working()
        self.runner.end()
        self.tell_health()
        return super().on_deactivate(state)

    def _stop_working(self) -> None:
        self.active = False
        self.release()
        for timer in self._work_timers:
            self.destroy_timer(timer)
        self._work_timers.clear()

    def on_cleanup(self, state):
        """Let go of topics and blocks; a loop that has this node's part ends with them."""
        if self.is_fused:
            self.fused.lose_a_part()
        self._disconnect()
        self.running = True
        return super().on_cleanup(state)

    def on_shutdown(self, state):
        """Leave from any state: outputs go to their safe values first."""
        if self.active:
            self.runner.part()
            self.runner.go_safe()
        self._stop_working()
        self.finished = True
        self.tell_health()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Leave the graph, and the axis in this process."""
        if self.fused is not None:
            self.fused.part(self)
        super().destroy_node()

    # -- services and parameters -------------------------------------------------------------------------------

    def _on_start(self, request, response):
        return self._set_running(response, True)

    def _on_stop(self, request, response):
        return self._set_running(response, False)

    def _set_running(self, response, running: bool):
        if self.parameters is not None and self.running != running:
            self.running = running
            self.pace.restart()
            self.on_running(running)
        response = self._answer_service(response, "running" if running else "stopped")
        hindrance = self.hindrance() if running and response.success else ""
        if hindrance:
            response.success, response.message = False, f"not running: {hindrance}"
        return response

    def _on_reset(self, request, response):
        if self.parameters is not None:
            self.runner.require_rest()
            self.failure, self.exit_code = "", 0
            self.masters.release()
            self.pace.restart()
            self.runner.clear()
            if self.runner.by_message:
                self.reset_blocks()
            self.runner.begin_again()
        return self._answer_service(response, "reset")

    def _answer_service(self, response, done: str):
        response.success = self.parameters is not None
        response.message = done if response.success else "not configured yet"
        return response

    def _retune(self, parameters) -> None:
        before, after = self.parameters.to_mapping(), parameters.to_mapping()
        changed = {name: value for name, value in after.items() if value != before.get(name)}
        if self.is_fused:
            self.fused.apply(self.kind, "retune", changed)
            self.retuned(parameters)
            self.parameters = parameters
        else:
            self.retune(parameters)
            self.retuned(parameters)
            self.parameters = parameters
            self.log_change("retune", changed)

    def retuned(self, parameters) -> None:
        """The part has taken changed parameters; those of before are still in :attr:`parameters`."""

    @property
    def is_fused(self) -> bool:
        """Whether a loop makes the samples of this node now."""
        return self.fused is not None and self.fused.loop is not None

    def take_part(self, part) -> None:
        """Show this part of a loop from now on, in the place of the node's own."""
        self.part = part

    # -- the run -------------------------------------------------------------------------------------------------

    def subscribe_end(self) -> None:
        """Listen for the end mark of the plant: the number of samples of the run."""
        self.subscriber(UInt64, "end_of_run", self._on_end, latched_qos())

    def _on_end(self, message) -> None:
        if self.runner.is_old_end(message.data):
            return
        self.end_of_run = message.data
        if self.active and not self.runner.exact:
            self.leave_when_done()

    def sample_of(self, stamp) -> int:
        """Return the number of the sample with this stamp."""
        return round((stamp.sec + stamp.nanosec * 1e-9) * self.parameters.sample_rate)

    def is_done(self) -> bool:
        """Tell whether the last sample of the run has been answered."""
        return self.sample >= self.end_of_run

    def leave_when_done(self) -> None:
        """End the log of changes if the run is over, and leave if the parameter exit_at_end says so."""
        if self.is_done() or not self.runner.exact:
            self.changes.end(self.end_of_run)
            self.finished |= self.parameters.exit_at_end

    def fail(self, text: str, exit_code: int = 1, announce: bool = True) -> None:
        """End the run with an error; the node answers no more samples, and in lockstep the others are told the same."""
        if self.failure:
            return
        self.failure, self.exit_code = text, exit_code
        self.get_logger().error(text)
        if announce and self.runner is not None:
            self.runner.announce(text)

    def since_report(self, key: str, count: int) -> int:
        """Return by how much a counter has grown since it was last reported."""
        before, self._reported[key] = self._reported.get(key, 0), count
        return max(count - before, 0)

    def tell_health(self) -> None:
        """Publish how this node is, whatever the state of its life."""
        self._diagnostics.publish(diagnostics(self))
