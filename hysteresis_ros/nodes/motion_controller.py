# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``motion_controller``: ``reference`` and ``joint_states`` → ``command``, the displacement that is wanted.

It also monitors saturation, and publishes the messages of ros2_control where the package control_msgs is installed.
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
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, MODE_NAMES, REJECTED, RUNNING, STALE, STOPPED, TRIPPED
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.responder import Input, Responder
from hysteresis_ros.nodes.spin import run

#: A difference counts above this part of the largest command carried out so far: inverses are approximate.
FRACTION = 0.05
#: And above this [m]: before anything moved, rounding is no shortfall.
SMALLEST = 1e-9
#: Answers may be late by as many samples less one on a busy machine.
LATENESS = 20


class Shortfall:
    """Compares commands with what was carried out, and remembers the worst since the last report."""

    def __init__(self):
        self.count = 0
        self._sent = deque([0.0], maxlen=LATENESS)
        self._largest = 0.0
        self._worst = None

    def sent(self, command: float) -> None:
        """Note a command [m] that was sent."""
        self._sent.append(command)

    def carried_out(self, applied: float) -> None:
        """Compare what was carried out [m] with the nearest of the last commands: an answer may be late."""
        self._largest = max(self._largest, abs(applied))
        allowed = max(FRACTION * self._largest, SMALLEST)
        if abs(self._sent[-1] - applied) <= allowed:
            return  # as it is in nearly every sample
        wanted = min(self._sent, key=lambda command: abs(command - applied))
        difference = abs(wanted - applied)
        if difference <= allowed:
            return
        self.count += 1
        if self._worst is None or difference > abs(self._worst[0] - self._worst[1]):
            self._worst = (wanted, applied)

    def report(self) -> str:
        """Return a sentence about the worst since the last call, empty when all was carried out."""
        if self._worst is None:
            return ""
        (wanted, applied), self._worst = self._worst, None
        return f"command saturated: wanted {1e6 * wanted:.4g} µm, carried out {1e6 * applied:.4g} µm"


#: What is said where the package is missing.
MISSING = (
    "~/controller_state and ~/pid_state are not published: the package control_msgs is not installed "
    "(sudo apt install ros-jazzy-control-msgs; it is not among the wheels; controller_state_rate: 0 does without them)"
)


def message_types() -> tuple[type, type] | None:
    """Return the types SingleDOFStateStamped and PidState, None where the package control_msgs is not installed."""
    try:
        found = importlib.import_module("control_msgs.msg")
    except ImportError:
        return None
    return found.SingleDOFStateStamped, found.PidState


class ControllerState:
    """Publishes ``~/controller_state``, and ``~/pid_state`` while a PID controller works."""

    def __init__(self, node, state_type: type, pid_type: type):
        self._node = node
        self._state, self._pid = state_type(), pid_type()
        self._state_publisher = node.publisher(state_type, "~/controller_state", setpoint_qos())
        self._pid_publisher = node.publisher(pid_type, "~/pid_state", setpoint_qos())
        self._shown, self._before = -1, (math.nan, math.nan)

    def tell(self, stamp) -> None:
        """Publish the present sample, ``controller_state_rate`` times a second of the axis."""
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
        """Publish what a PID controller is made of; the names of its gains have changed between versions."""
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

    What it does about measurements that are missing or wrong is its part of the loop
    (:mod:`hysteresis_ros.loop.controller`). In real time a measurement whose stamp does not follow the last one is
    missing, and while none come samples are counted by the clock.

    When it stops working it sends nothing any more: the compensator then goes to its safe voltage by itself, after its
    time-out and at its slew rate. A last command would be a step.

    With ``use_origin`` an inchworm_sequencer takes the reference generator's place: what is controlled is the measured
    joint less the ``origin`` that comes with every reference.
    """

    parameters: ControllerNodeParameters
    identity = ("type",)
    outputs = (("command", signals.COMMAND),)
    share = 0.85
    triggers = (*Responder.triggers, "learn", "freeze", "forget", "save")

    def __init__(self, **options):
        super().__init__("motion_controller", **options)

    def build(self, parameters) -> None:
        """Make the controller from the parameters."""
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
            self.part.prepare()  # or the loop would stand still when another one takes over
        self._clear()

    def _connect_part(self) -> None:
        self._laws = Laws(*(self.part.kernel,) * len(Laws._fields))
        self._arrays = self.part.arrays

    def _clear(self) -> None:
        self.shortfall = Shortfall()
        self._mode = RUNNING

    def step(self) -> None:
        """Run the controller of the loop on the row."""
        _CONTROL(self._laws, self._arrays, self.row)

    def connect(self) -> None:
        """Make the topics."""
        super().connect()
        self._state_of_controller = None
        if self.parameters.controller_state_rate:
            types = message_types()
            if types is None:
                self.get_logger().info(MISSING)
            else:
                self._state_of_controller = ControllerState(self, *types)

    def report(self, stamp) -> None:
        """Publish ``~/state``, and what tools of ros2_control look at."""
        super().report(stamp)
        if self._state_of_controller is not None:
            self._state_of_controller.tell(stamp)

    def begin(self) -> None:
        """In real time go on from where the axis is."""
        if self.runner.by_message and not self.runner.exact and self.sample and self.running:
            self.part.start()

    def reset_blocks(self) -> None:
        """Begin again with everything at rest."""
        super().reset_blocks()
        self._clear()

    def retune(self, parameters) -> None:
        """Take new gains, or another type of controller; the command goes on from where it is."""
        self.part.retune(parameters)

    def retuned(self, parameters) -> None:
        """Show the controller that is there now."""
        self._connect_part()
        before = self.parameters.type
        if parameters.type != before:
            self.get_logger().info(f"{parameters.type} takes over from {before}")

    def take_part(self, part) -> None:
        """Show this part of a loop from now on."""
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
        """Whether it is stopped and its command safe."""
        return not self.running and self.command == self.parameters.safe_command

    def stopped(self) -> str:
        """Say what ``~/stop`` has done."""
        if self.rests:
            return "stopped"
        return f"stopped: the command goes to safe_command = {self.parameters.safe_command:g} m"

    @property
    def rejected(self) -> int:
        """Measurements so far that were not used."""
        return int(self._arrays.watch_x.guard[REJECTED])

    @property
    def is_stale(self) -> bool:
        """Whether there has been no good measurement for the time-out."""
        return self._mode == STALE

    @property
    def stale(self) -> bool:
        """Whether measurements have not come for their time-out, or a partner is lost."""
        return self.is_stale or bool(self.runner.latched)

    @property
    def unpaired(self) -> bool:
        """Whether reference and origin of a motor do not come."""
        return self.parameters.use_origin and self._mode == HOLDING

    def change_details(self) -> dict:
        """Return whether the last sample still lacks what was carried out: a change comes before that then."""
        if self.runner.exact and not self.runner.confirmed:
            return {"sample": self.sample - 1, "after": ANSWERED}
        return {}

    # -- learning ------------------------------------------------------------------------------------------------

    def _on_learn(self, request, response):
        return self._tell_learning("learn", "learning", response)

    def _on_freeze(self, request, response):
        return self._tell_learning("freeze", "repeating what was learned", response)

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
                allowed = "names no file; give one at configuration: nobody writes anywhere else"
                raise ParameterError([Problem("learning.save_file", path, allowed)])
            self.part.save(path, self.get_fully_qualified_name())
        return self._answer_service(response, f"written to {path}")

    # -- messages ------------------------------------------------------------------------------------------------

    def read(self, message, row) -> bool:
        """Put the measured force into the row as well, NaN when there is none; a damping may not do without it."""
        if not super().read(message, row):
            return False
        joint, names = self.parameters.force_joint, message.name
        index = names.index(joint) if joint in names else len(message.effort)
        row[signals.FORCE] = message.effort[index] if index < len(message.effort) else math.nan
        if self._lacks_force(row):
            lacks = "has no finite effort" if joint in names else f"is not in joint_states, which has {list(names)}"
            text = f"missing force joint '{joint}': it {lacks}; {self.parameters.damping.type} cannot do without it"
            if self.runner.exact and joint not in names:
                self.fail(text)
                return False
            self.warn("force_joint", text, error=True)
        return True

    def _lacks_force(self, row) -> bool:
        """Tell whether a row has no force for a damping that needs one."""
        return self.parameters.damping.source == FORCE and not math.isfinite(row[signals.FORCE])

    def take(self, input_: Input, data: float) -> None:
        """Take a reference, an origin, or what was carried out."""
        if input_.previous:
            carried_out(self._arrays, data)
            if math.isfinite(data):
                self.shortfall.carried_out(data)
        else:
            self.row[input_.signal] = data

    def refuse_value(self, input_: Input, data: float) -> None:
        """Say that a reference cannot be used: the last good one serves, of a motor the command stays."""
        if not input_.previous:
            self.warn(input_.topic, f"{input_.topic} {data} m refused, the last one is kept")

    def show(self, stamp, quiet: bool) -> None:
        """Publish what stands in the row, and compare what was wanted in it with what was carried out."""
        super().show(stamp, quiet)
        self.shortfall.carried_out(self.row[signals.APPLIED])

    def after_step(self) -> None:
        """Tell what has changed, and keep what was wanted for the comparison with what is carried out."""
        self.shortfall.sent(self.row[signals.COMMAND])
        self.after_missing()

    def after_missing(self) -> None:
        """Tell what has changed."""
        mode = int(self.row[signals.CONTROLLER_MODE])
        if mode != self._mode:
            self._tell(self._mode, mode)
            self._mode = mode

    def _tell(self, before: int, mode: int) -> None:
        joint, parameters = self.parameters.joint, self.parameters
        if mode == STALE:
            limit, safe = parameters.measurement_timeout, parameters.safe_command
            self.warn("stale", f"no good measurement of '{joint}' for {limit:g} s: going to safe_command {safe:g} m")
        elif mode == FOLLOWING:
            self.warn("following", "nobody carries commands out: they follow the displacement until somebody does")
        elif mode == TRIPPED and not self.runner.latched:
            self.warn("tripped", "the plant has stopped the axis: going to safe_command", error=True)
        elif mode == RUNNING and before in (STALE, FOLLOWING, TRIPPED, STOPPED):
            self.get_logger().info(f"going on after {MODE_NAMES[before]}")

    def health(self):
        """Report a stale measurement, rejected ones, and commands that the limits did not let through."""
        joint = self.parameters.joint
        values = {
            "rejected_measurements": self.rejected,
            "command_m": f"{self.command:.9g}",
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
            return 2, f"no measurement of '{joint}' has come yet", values
        if self.runner.latched:
            what = f"measurement of '{joint}' is stale: " if self.runner.silent else ""
            return 2, f"{what}{self.loss}", values
        if self.is_stale:
            return 2, f"measurement of '{joint}' is stale", values
        if self._mode == TRIPPED:
            return 2, "the plant has stopped the axis", values
        if self._mode == FOLLOWING:
            return 2, "nobody carries commands out", values
        if self._mode == STOPPED:
            return 1, "stopped", values
        if self.unpaired:
            return 2, "reference and origin are stale", values
        if self.runner.absent:
            text = f"nobody sends {' or '.join(self.runner.absent)} any more: the last value is kept"
            self.warn("absent", text, every=10.0)
            return 1, text, values
        if rejected:
            return 1, f"{rejected} measurements rejected", values
        if not saturated and learning.at_maximum:
            saturated = f"the learned correction is at learning.maximum = {self.parameters.learning.maximum:g} m"
        return (1, saturated, values) if saturated else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([MotionControllerNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
