# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``motion_controller``: ``reference`` and ``joint_states`` → ``command``, the desired displacement.

It also monitors saturation, and publishes the messages of ros2_control when the package control_msgs is installed.
"""

from __future__ import annotations

import importlib
import math
from collections import deque

from builtin_interfaces.msg import Duration

from hysteresis_ros import signals
from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.control.laws.pid import INTEGRAL
from hysteresis_ros.control.learning import MODES
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop.controller import ControllerPart, carried_out, control
from hysteresis_ros.loop.parameters import ControllerNodeParameters
from hysteresis_ros.loop.tick import ANSWERED, Laws
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, MODE_NAMES, QUIET, REJECTED, RUNNING, STALE, STOPPED, TRIPPED
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.quiet import QuietHold
from hysteresis_ros.nodes.responder import Input, Responder
from hysteresis_ros.nodes.spin import run

#: Threshold of saturation, as a fraction of the largest achieved command so far, because inverses may be approximate.
FRACTION = 0.05
#: Least threshold of saturation [m], so that rounding errors before the first motion do not count.
SMALLEST = 1e-9
#: Number of stored commands; the achieved command arrives within this number of samples even on a busy machine.
LATENESS = 20


class Shortfall:
    """Compares commands with achieved commands, and stores the largest saturation since the last report."""

    def __init__(self):
        self.count = 0
        self._sent = deque([0.0], maxlen=LATENESS)
        self._largest = 0.0
        self._worst = None

    def sent(self, command: float) -> None:
        """Store a command [m] that was sent."""
        self._sent.append(command)

    def carried_out(self, applied: float) -> None:
        """Compare an achieved command [m], which may arrive late, with the closest of the last commands."""
        self._largest = max(self._largest, abs(applied))
        allowed = max(FRACTION * self._largest, SMALLEST)
        if abs(self._sent[-1] - applied) <= allowed:
            return  # true for almost every sample
        wanted = min(self._sent, key=lambda command: abs(command - applied))
        difference = abs(wanted - applied)
        if difference <= allowed:
            return
        self.count += 1
        if self._worst is None or difference > abs(self._worst[0] - self._worst[1]):
            self._worst = (wanted, applied)

    def report(self) -> str:
        """Return a sentence about the largest saturation since the last call; empty without saturation."""
        if self._worst is None:
            return ""
        (wanted, applied), self._worst = self._worst, None
        return f"command saturated: commanded {1e6 * wanted:.4g} µm, achieved {1e6 * applied:.4g} µm"


#: Log message if the package control_msgs is missing.
MISSING = (
    "~/controller_state and ~/pid_state are not published: the package control_msgs is not installed "
    "(sudo apt install ros-jazzy-control-msgs; it has no wheel; controller_state_rate: 0 turns both topics off)"
)


def message_types() -> tuple[type, type] | None:
    """Return the types SingleDOFStateStamped and PidState; None if the package control_msgs is not installed."""
    try:
        found = importlib.import_module("control_msgs.msg")
    except ImportError:
        return None
    return found.SingleDOFStateStamped, found.PidState


class ControllerState:
    """Publishes ``~/controller_state``, and ``~/pid_state`` while a PID controller is active."""

    def __init__(self, node, state_type: type, pid_type: type):
        self._node = node
        self._state, self._pid = state_type(), pid_type()
        self._state_publisher = node.publisher(state_type, "~/controller_state", setpoint_qos())
        self._pid_publisher = node.publisher(pid_type, "~/pid_state", setpoint_qos())
        self._shown, self._before = -1, (math.nan, math.nan)

    def tell(self, stamp) -> None:
        """Publish the present sample, at ``controller_state_rate`` in the axis' own time."""
        node, row = self._node, self._node.row
        rate, since = node.parameters.sample_rate, node.sample - self._shown
        if self._shown >= 0 and 0 <= since < rate / node.parameters.controller_state_rate:
            return
        reference, measured, command = row[signals.REFERENCE], row[signals.SEEN], row[signals.COMMAND]
        elapsed = max(since, 1) / rate
        error = reference - measured
        velocity, drift = (measured - self._before[0]) / elapsed, (error - self._before[1]) / elapsed
        self._shown, self._before = node.sample, (measured, error)
        state = self._state.dof_state
        self._state.header.stamp = stamp
        state.name, state.time_step = node.parameters.joint, 1.0 / rate
        state.reference, state.feedback, state.feedback_dot = reference, measured, velocity
        state.error, state.error_dot, state.output = error, drift, command
        self._state_publisher.publish(self._state)
        if node.controller_type == "pid":
            self._tell_pid(stamp, error, drift, command)

    def _tell_pid(self, stamp, error: float, drift: float, command: float) -> None:
        """Publish the terms of a PID controller; the field names of its gains depend on the version of control_msgs."""
        gains, message = self._node.parameters.pid, self._pid
        given = {"Kp": gains.Kp, "Ki": gains.Ki, "Kd": gains.Kd, "integral": float(self._node.controller.x[INTEGRAL])}
        renamed = hasattr(message, "p_gain")
        names = ("p_gain", "i_gain", "d_gain", "i_term") if renamed else ("p_term", "i_term", "d_term", "i_error")
        for name, value in zip(names, given.values(), strict=True):
            setattr(message, name, value)
        if not renamed:
            message.p_error, message.d_error, message.i_max, message.i_min = error, drift, math.inf, -math.inf
        message.header.stamp = stamp
        nanoseconds = round(1e9 / self._node.parameters.sample_rate)
        message.timestep = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        message.error, message.error_dot, message.output = error, drift, command
        self._pid_publisher.publish(message)


_CONTROL = interpreted(control)


class MotionControllerNode(Responder):
    """Closes the loop: one ``command`` [m] for every measurement of the joint.

    Missing or wrong measurements are handled in the node's part of the loop (:mod:`hysteresis_ros.loop.controller`). In
    real time a measurement counts as missing if its stamp is not later than the last one; while no measurements arrive,
    the clock counts the samples.

    At exit the node publishes no last command, because that would be a step. After its time-out the compensator goes to
    its safe voltage at its slew rate.

    With ``use_origin`` an inchworm_sequencer replaces the reference generator: the controlled variable is the position
    of the measured joint minus ``origin``, which arrives with every reference.
    """

    parameters: ControllerNodeParameters
    identity = ("type",)
    outputs = (("command", signals.COMMAND),)
    share = 0.85
    triggers = (*Responder.triggers, "learn", "freeze", "forget", "save")

    def __init__(self, **options):
        super().__init__("motion_controller", **options)

    def build(self, parameters) -> None:
        """Create the controller from the parameters."""
        source = "inchworm_sequencer" if parameters.use_origin else "reference_generator"
        origin = (Input("origin", signals.ORIGIN, source, strict=True),) if parameters.use_origin else ()
        self.inputs = (
            Input("reference", signals.REFERENCE, source, strict=parameters.use_origin),
            *origin,
            Input("applied", signals.APPLIED, "hysteresis_compensator", previous=True),
        )
        self.part = ControllerPart(parameters)
        self._connect_part()
        self.compile()
        if parameters.time_mode == "realtime":
            self.part.prepare()  # otherwise the loop would wait for a compilation when the controller changes
        self._clear()

    def _connect_part(self) -> None:
        self._laws = Laws(*(self.part.kernel,) * len(Laws._fields))
        self._arrays = self.part.arrays

    def _clear(self) -> None:
        self.shortfall = Shortfall()
        self._mode = RUNNING

    def step(self) -> None:
        """Compute the sample in the row with the controller of the loop."""
        _CONTROL(self._laws, self._arrays, self.row)

    def connect(self) -> None:
        """Create the topics."""
        super().connect()
        self._quiet = QuietHold(self)
        self._state_of_controller = None
        if self.parameters.controller_state_rate:
            types = message_types()
            if types is None:
                self.get_logger().info(MISSING)
            else:
                self._state_of_controller = ControllerState(self, *types)

    def report(self, stamp) -> None:
        """Publish ``~/state`` and the messages of ros2_control."""
        super().report(stamp)
        if self._state_of_controller is not None:
            self._state_of_controller.tell(stamp)

    def begin(self) -> None:
        """In real time, continue from the present state of the axis."""
        if self.runner.by_message and not self.runner.exact and self.sample and self.running:
            self.part.start()

    def reset_blocks(self) -> None:
        """Reset the controller to rest."""
        super().reset_blocks()
        self._quiet.reset()
        self._clear()

    def retune(self, parameters) -> None:
        """Apply new gains, or another type of controller, without a step of the command."""
        self.part.retune(parameters)

    def retuned(self, parameters) -> None:
        """Use the present controller; log a change of its type."""
        self._connect_part()
        before = self.parameters.type
        if parameters.type != before:
            self.get_logger().info(f"{parameters.type} takes over from {before}")

    def take_part(self, part) -> None:
        """Use this part of a fused loop."""
        super().take_part(part)
        self._connect_part()

    @property
    def controller(self):
        """The present controller."""
        return self.part.controller

    @property
    def controller_type(self) -> str:
        """Type of the present controller."""
        return self.part.parameters.type

    @property
    def command(self) -> float:
        """Last command [m]."""
        return self.part.command

    @property
    def rests(self) -> bool:
        """Whether the node is stopped and its command is safe."""
        return not self.running and self.command == self.parameters.safe_command

    def stopped(self) -> str:
        """Return a message about the effect of ``~/stop``."""
        if self.rests:
            return "stopped"
        return f"stopped: the command goes to safe_command = {self.parameters.safe_command:g} m"

    @property
    def rejected(self) -> int:
        """Number of rejected measurements so far."""
        return int(self._arrays.watch_x.guard[REJECTED])

    @property
    def is_stale(self) -> bool:
        """Whether no valid measurement has arrived within the time-out."""
        return self._mode == STALE

    @property
    def stale(self) -> bool:
        """Whether no measurement has arrived within the time-out, or a partner is lost."""
        return self.is_stale or bool(self.runner.latched)

    @property
    def unpaired(self) -> bool:
        """Whether the reference or the origin of a motor is missing."""
        return self.parameters.use_origin and self._mode == HOLDING

    def change_details(self) -> dict:
        """Return the fields of a change that takes effect before the achieved command of the last sample arrives."""
        if self.runner.exact and not self.runner.confirmed:
            return {"sample": self.sample - 1, "after": ANSWERED}
        return {}

    # -- learning ------------------------------------------------------------------------------------------------

    def _on_learn(self, request, response):
        return self._tell_learning("learn", "learning", response)

    def _on_freeze(self, request, response):
        return self._tell_learning("freeze", "learning off: the learned correction is repeated", response)

    def _on_forget(self, request, response):
        return self._tell_learning("forget", "forgetting", response)

    def _tell_learning(self, action: str, done: str, response):
        if self.parameters is not None:
            if self.is_fused:
                self.fused.apply(self.kind, action)
            else:
                getattr(self.part, action)()
                self.log_change(action)
        return self._answer_service(response, done)

    def _on_save(self, request, response):
        path = self.parameters.learning.save_file if self.parameters is not None else ""
        if self.parameters is not None:
            if not path:
                remedy = "names no file; give one at configuration, because only that file is written"
                raise ParameterError([Problem("learning.save_file", path, remedy)])
            self.part.save(path, self.get_fully_qualified_name())
        return self._answer_service(response, f"written to {path}")

    # -- messages ------------------------------------------------------------------------------------------------

    def read(self, message, row) -> bool:
        """Also write the measured force, which some damping laws need, into the row; NaN if no force is measured."""
        if not super().read(message, row):
            return False
        joint, names = self.parameters.force_joint, message.name
        index = names.index(joint) if joint in names else len(message.effort)
        row[signals.FORCE] = message.effort[index] if index < len(message.effort) else math.nan
        if self._lacks_force(row):
            lacks = "has no finite effort" if joint in names else f"is not in joint_states, which has {list(names)}"
            text = f"missing force joint '{joint}': it {lacks}; {self.parameters.damping.type} requires it"
            if self.runner.exact and joint not in names:
                self.fail(text)
                return False
            self.warn("force_joint", text, error=True)
        return True

    def _lacks_force(self, row) -> bool:
        """Return whether a row lacks the force that the damping requires."""
        return self.parameters.damping.source == FORCE and not math.isfinite(row[signals.FORCE])

    def take(self, input_: Input, data: float) -> None:
        """Store a reference, an origin, or an achieved command."""
        if input_.previous:
            carried_out(self._arrays, data)
            self._quiet.follow(data)
            if math.isfinite(data):
                self.shortfall.carried_out(data)
        else:
            self.row[input_.signal] = data

    def refuse_value(self, input_: Input, data: float) -> None:
        """Log that a reference is invalid: the last valid reference is used; for a motor the command is held."""
        if not input_.previous:
            self.warn(input_.topic, f"{input_.topic} = {data} m refused; the last value is kept")

    def show(self, stamp, quiet: bool) -> None:
        """Publish the row of a sample, and compare its command with the achieved command."""
        super().show(stamp, quiet)
        self.shortfall.carried_out(self.row[signals.APPLIED])

    def after_step(self) -> None:
        """Log changes of mode, and store the command for the comparison with the achieved command."""
        self.shortfall.sent(self.row[signals.COMMAND])
        self.after_missing()

    def after_missing(self) -> None:
        """Log changes of mode."""
        mode = int(self.row[signals.CONTROLLER_MODE])
        if mode != self._mode:
            self._tell(self._mode, mode)
            self._mode = mode

    def _tell(self, before: int, mode: int) -> None:
        joint, parameters = self.parameters.joint, self.parameters
        if mode == STALE:
            limit, safe = parameters.measurement_timeout, parameters.safe_command
            self.warn("stale", f"no valid measurement of '{joint}' for {limit:g} s: going to safe_command {safe:g} m")
        elif mode == FOLLOWING:
            text = "no node reports achieved commands: the command follows the displacement until one does"
            self.warn("following", text)
        elif mode == TRIPPED and not self.runner.latched:
            self.warn("tripped", "the plant has stopped the axis: the command follows the voltage", error=True)
        elif mode == QUIET:
            self.get_logger().info("quiet: the command stands still")
        elif mode == RUNNING and before in (STALE, FOLLOWING, TRIPPED, STOPPED, QUIET):
            self.get_logger().info(f"resumed after {MODE_NAMES[before]}")

    def health(self):
        """Report stale and rejected measurements, and saturated commands."""
        joint = self.parameters.joint
        values = {
            "rejected_measurements": self.rejected,
            "command_m": f"{self.command:.9g}",
            "offset_m": f"{self.parameters.model.preload.offset:.9g}",
            "stale": self.stale,
            "mode": MODE_NAMES[self._mode],
            "saturated_commands": self.shortfall.count,
        }
        learning = self.part.learning
        if learning.parameters.in_use:
            values["learning"] = MODES[learning.mode]
            values["samples_not_learned"] = learning.missed
        saturated = self.shortfall.report()
        rejected = self.since_report("rejected", self.rejected)
        if self.wrong_joint:
            return 2, f"joint '{joint}' is not in joint_states", values
        if self._lacks_force(self.row):
            return 2, f"missing force joint '{self.parameters.force_joint}'", values
        if not self.sample and not self.runner.exact:
            return 2, f"no measurement of '{joint}' has arrived yet", values
        if self.runner.latched:
            what = f"measurement of '{joint}' is stale: " if self.runner.silent else ""
            return 2, f"{what}{self.loss}", values
        if self.is_stale:
            return 2, f"measurement of '{joint}' is stale", values
        if self._mode == TRIPPED:
            return 2, "the plant has stopped the axis", values
        if self._mode == FOLLOWING:
            return 2, "no node reports achieved commands", values
        if self._mode == STOPPED:
            return 1, "stopped", values
        if self.unpaired:
            return 2, "reference and origin are stale", values
        if self.runner.absent:
            text = f"{' and '.join(self.runner.absent)} no longer received; the last value is kept"
            self.warn("absent", text, every=10.0)
            return 1, text, values
        if rejected:
            return 1, f"{rejected} measurements rejected", values
        if not saturated and learning.at_maximum:
            saturated = f"the learned correction is at learning.maximum = {self.parameters.learning.maximum:g} m"
        return (1, saturated, values) if saturated else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([MotionControllerNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
