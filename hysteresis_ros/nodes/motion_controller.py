"""Node ``motion_controller``: ``reference`` and ``joint_states`` → ``command``, the displacement that is wanted."""

from __future__ import annotations

import math
import time

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.control.controller import (
    ControllerParameters,
    controller_block,
    feedforward_block,
    handover_block,
    prepare_controllers,
)
from hysteresis_ros.control.feedforward import STARTED as FEEDFORWARD_STARTED
from hysteresis_ros.control.handover import HandoverParameters, arm
from hysteresis_ros.control.open_loop import (
    APPLIED,
    COMMAND,
    DISTURBANCE,
    ESTIMATED,
    FEEDFORWARD,
    STARTED,
    SWITCHING,
)
from hysteresis_ros.control.succession import History, successor
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.nodes.base import AxisNode, sample_index
from hysteresis_ros.nodes.shortfall import Shortfall
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import Pairing
from hysteresis_ros.simulation.node_parameters import part

#: Seconds between two looks at the watchdog.
WATCHDOG_PERIOD = 0.01


#: Samples without an answer of the compensator after which commands are taken not to be carried out.
UNFOLLOWED = 20


class MotionControllerNode(AxisNode):
    """Closes the loop: one ``command`` [m] for every measurement of the joint.

    In real time a measurement that stops, repeats, goes back in time, is not finite or lacks the joint is skipped;
    after ``measurement_timeout`` without a good one the command slews to ``safe_command``. When good measurements
    return, the controller starts from there and the command continues without a jump.

    With ``use_origin`` an inchworm_sequencer takes the reference generator's place: what is controlled is the measured
    joint less the ``origin`` that comes with every reference, and a command answers reference, origin and measurement
    of the same sample, in real time too.
    """

    state_names = ("reference", "measured", "estimated", "command", "switching", "disturbance")
    share = 0.85

    def __init__(self, **options):
        super().__init__("motion_controller", **options)

    def build(self, parameters) -> None:
        """Make controller and hand-over from the parameters."""
        block = part(parameters, ControllerParameters)
        sample_time = 1.0 / parameters.sample_rate
        self.feedforward = feedforward_block(block, sample_time)
        self.controller = controller_block(block, sample_time)
        self.controller_type = block.type
        self.history = History()
        self.handover = handover_block(block, sample_time)
        self.return_path = handover_block(block, sample_time)
        self.feedforward.step(0.0)  # compile now, not at the first sample
        self.controller.step(0.0, 0.0)
        self.handover.step(0.0)
        if parameters.time_mode == "realtime":
            prepare_controllers()  # or the loop would stand still when another one takes over
        self._clear()

    def _clear(self) -> None:
        self.feedforward.reset()
        self.controller.reset()
        self.history.clear()
        self.handover.reset()
        self.return_path.reset()
        self.shortfall = Shortfall()
        self._returning = False
        self._unanswered = 0
        self.reference = 0.0
        self.origin = 0.0
        self.command = 0.0
        self.rejected = 0
        self.stale = False
        self._last_good = time.monotonic()
        self._last_stamp = -1
        self._measured = None
        self._stamp = None
        self._references = 0
        self._origins = 0
        self._pairing = Pairing()
        self._last_pair = math.inf
        self.unpaired = False
        self._applied = 0
        self._joint_index = -1
        self.wrong_joint = False

    def connect(self) -> None:
        """Make the topics."""
        self._message = Float64()
        self._command = self.publisher(Float64, "command", self.qos(), loop=True)
        self.subscriber(JointState, "joint_states", self._on_measurement, self.qos(), partner="plant_simulator")
        self._source = "inchworm_sequencer" if self.parameters.use_origin else "reference_generator"
        self.subscriber(Float64, "reference", self._on_reference, self.qos(), partner=self._source)
        if self.parameters.use_origin:
            self.subscriber(Float64, "origin", self._on_origin, self.qos(), partner=self._source)
        self.subscriber(Float64, "applied", self._on_applied, self.qos(), partner="hysteresis_compensator")
        self.subscribe_end()

    def begin(self) -> None:
        """Start the watchdog of the measurement."""
        if not self.lockstep:
            self._last_good = time.monotonic()
            self._returning = self.sample > 0
            self.timer(WATCHDOG_PERIOD, self._watchdog)

    def reset_blocks(self) -> None:
        """Begin again with everything at rest."""
        self._clear()

    def retune(self, parameters) -> None:
        """Take new gains, or another type of controller; the command goes on from where it is."""
        block = part(parameters, ControllerParameters)
        lasting = None
        if block.type == self.controller_type:
            self._retune_controller(block)
        else:
            # whatever may be refused is, before anything changes
            controller, lasting = successor(block, 1.0 / parameters.sample_rate, self.controller, self.history)
            self.feedforward.retune(block)
            self.get_logger().info(f"{block.type} takes over from {self.controller_type}")
            self.controller = controller
        self.controller_type = block.type
        self.handover.retune(HandoverParameters(time=block.handover_time))
        arm(self.handover, self.command, lasting)

    def _retune_controller(self, block: ControllerParameters) -> None:
        before, state = self.controller.parameters, self.controller.state
        self.controller.retune(block)
        try:
            self.feedforward.retune(block)
        except ParameterError:
            self.controller.retune(before)
            self.controller.state = state
            raise

    def on_running(self, running: bool) -> None:
        """``~/stop`` slews to the safe command, ``~/start`` goes on without a jump."""
        if running:
            self._returning = True

    # -- inputs ------------------------------------------------------------------------------------------------

    def _on_reference(self, message) -> None:
        finite = math.isfinite(message.data)
        if not finite:
            self.warn("reference", f"reference {message.data} m refused, {self.reference:.6g} m kept")
        if self.lockstep:
            self._references += 1
            if self.surplus(self._references, self.sample + 1, "reference", self._source):
                return
            self.heard()
        self.reference = message.data if finite else self.reference
        if self.lockstep:
            self.advance()
        elif self.parameters.use_origin and self.active:
            # the sequencer publishes the origin first: the last one is that of this reference
            answer = (self.reference, self.origin)
            if self.unpaired or self._last_pair == math.inf:
                self._pairing.begin()
            self._answer_pair(self._pairing.answer(answer, time.monotonic()), answer)

    def _on_origin(self, message) -> None:
        finite = math.isfinite(message.data)
        if not finite:
            self.warn("origin", f"origin {message.data} m refused, {self.origin:.6g} m kept")
        if self.lockstep:
            self._origins += 1
            if self.surplus(self._origins, self.sample + 1, "origin", self._source):
                return
            self.heard()
        self.origin = message.data if finite else self.origin
        if self.lockstep:
            self.advance()

    def _answer_pair(self, measured, answer) -> None:
        """Real time with an origin: answer once measurement, reference and origin of a sample are there."""
        if measured is None or answer is None:
            return
        stamp, value = measured
        self.reference, origin = answer
        self._last_pair = time.monotonic()
        if self.unpaired:
            self.unpaired = False
            self.get_logger().info("reference and origin are back")
            self._returning = True
        if not math.isnan(value):
            self._answer(stamp, value, origin)

    def _on_applied(self, message) -> None:
        if math.isfinite(message.data):
            self.controller.x[APPLIED] = message.data
            self.shortfall.carried_out(message.data)
        if not self.lockstep:
            if self._unanswered > UNFOLLOWED:
                self.get_logger().info("commands are carried out again")
                self._returning = True
            self._unanswered = 0
        self._applied += 1
        if self.lockstep and not self.surplus(self._applied, self.sample, "applied", "hysteresis_compensator"):
            self.heard()
            self.advance()

    def _on_measurement(self, message) -> None:
        if self.lockstep:
            if self.expected(sample_index(message.header.stamp, self.parameters.sample_rate)):
                self.heard()
                self._measured, self._stamp = self._displacement(message), message.header.stamp
                self.advance()
        elif self.active:
            self._on_measurement_realtime(message)

    def _on_measurement_realtime(self, message) -> None:
        self.pace.tick()
        value = self._good_measurement(message)
        if self.parameters.use_origin:
            # a rejected measurement has its reference too
            measured = (message.header.stamp, value)
            self._answer_pair(measured, self._pairing.measurement(measured, time.monotonic()))
        elif not math.isnan(value):
            self._answer(message.header.stamp, value)

    def _good_measurement(self, message) -> float:
        """Real time: return the measurement [m], NaN when it is rejected."""
        value = self._displacement(message)
        if math.isnan(value):
            self.rejected += 1
            return value
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if stamp <= self._last_stamp and not self.stale:
            self.rejected += 1
            self.warn("stamp", f"measurement rejected: stamp {stamp} ns does not follow {self._last_stamp} ns")
            return math.nan
        self.wrong_joint = False
        self._last_stamp = stamp
        self._last_good = time.monotonic()
        if self.stale:
            self.stale = False
            self.get_logger().info("measurement is back")
            self._returning = True
        return value

    def _displacement(self, message) -> float:
        """Return the joint's position [m]; NaN, with a message, when there is none that can be used."""
        joint, names, index = self.parameters.joint, message.name, self._joint_index
        if not 0 <= index < len(names) or names[index] != joint:
            self.wrong_joint = joint not in names
            if self.wrong_joint:
                text = f"joint '{joint}' is not in joint_states, which has {list(names)}: set the parameter joint"
                if self.lockstep:
                    self.fail(text)
                else:
                    self.warn("joint", text, error=True)
                return math.nan
            index = self._joint_index = names.index(joint)
        if index >= len(message.position) or not math.isfinite(message.position[index]):
            self.warn("nan", f"measurement of joint '{joint}' is missing or not finite and was rejected")
            return math.nan
        return message.position[index]

    # -- answers -----------------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Lockstep: answer when measurement k, reference k and what was applied at k-1 are there."""
        if self._measured is None or self._references <= self.sample or self._applied < self.sample:
            return
        if self.parameters.use_origin and self._origins <= self.sample:
            return
        if not self.active or self.failure or not self.matched():
            return
        self.pace.tick()
        value, self._measured = self._measured, None
        self._answer(self._stamp, value, self.origin)

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        if self._measured is None:
            return "plant_simulator"
        if self._references <= self.sample or (self.parameters.use_origin and self._origins <= self.sample):
            return self._source
        return "hysteresis_compensator" if self._applied < self.sample else ""

    def _answer(self, stamp, measured: float, origin: float = 0.0) -> None:
        value = measured - origin
        if not self.running:
            self._slew_safe(1.0 / self.parameters.sample_rate)
        elif math.isnan(value):
            self.rejected += 1
        elif not self.lockstep and self._applied and self._unanswered >= UNFOLLOWED:
            # nobody carries commands out: they follow the displacement until somebody does
            self.command = value - self.parameters.model.preload.offset
        else:
            if self._returning:
                self._resume(value)
            self.command = self.handover.step(self._control(value))
            self.controller.x[COMMAND] = self.command
        self._unanswered += 1
        self.shortfall.sent(self.command)
        self._message.data = self.command
        self._command.publish(self._message)
        x = self.controller.x
        self.publish_state(stamp, self.reference, measured, x[ESTIMATED], self.command, x[SWITCHING], x[DISTURBANCE])
        self.sample += 1

    def _control(self, value: float) -> float:
        delayed = self.feedforward.step(self._reference_now())
        x, fed = self.controller.x, self.feedforward.command
        x[FEEDFORWARD] = fed
        self.history.note(x[APPLIED], delayed, fed, value)
        return self.controller.step(delayed, value)

    def _resume(self, value: float | None = None) -> None:
        """Start the observer anew at the present measurement; the command continues from the last one.

        With the measurement at hand the reference starts from there too and fades to the one received: a reaching law
        answers a step of the reference calmly, but a long difference between its command and what is carried out
        violently (Φ = 0.93 amplifies a constant one by 1/(1 - Φ) = 14).
        """
        self.feedforward.x[FEEDFORWARD_STARTED] = 0.0
        self.controller.x[STARTED] = 0.0
        self.history.clear()
        self._returning = False
        arm(self.handover, self.command)
        if value is not None:
            arm(self.return_path, value - self.parameters.model.preload.offset)
            self._on_return_path = True

    _on_return_path = False

    def _reference_now(self) -> float:
        if not self._on_return_path:
            return self.reference
        reference = self.return_path.step(self.reference)
        self._on_return_path = reference != self.reference
        return reference

    def _watchdog(self) -> None:
        """Real time: slew to the safe command while no good measurement comes."""
        limit = self.parameters.measurement_timeout
        now = time.monotonic()
        if not self.active or self._last_stamp < 0:
            return
        if now - self._last_good < limit:
            if now - self._last_pair >= limit:
                self._hold(limit)
            return
        if not self.stale:
            self.stale = True
            joint, safe = self.parameters.joint, self.parameters.safe_command
            self.warn("stale", f"no good measurement of '{joint}' for {limit:g} s: going to safe_command {safe:g} m")
        self._slew_safe(WATCHDOG_PERIOD)
        self._message.data = self.command
        self._command.publish(self._message)

    def _hold(self, limit: float) -> None:
        """Without an origin nobody knows where the extender should go: it stays, and the clamps of a motor close."""
        if not self.unpaired:
            self.unpaired = True
            self.warn("unpaired", f"no reference and origin for {limit:g} s: holding command {self.command:g} m")
        self._message.data = self.command
        self._command.publish(self._message)

    def _slew_safe(self, duration: float) -> None:
        step = self.parameters.safe_slew_rate * duration
        self.command += min(max(self.parameters.safe_command - self.command, -step), step)

    def go_safe(self) -> None:
        """Publish the safe command; in lockstep, where it would be taken for the one of a sample, nothing."""
        if not self.lockstep and self.sample:
            self.command = self.parameters.safe_command
            self._message.data = self.command
            self._command.publish(self._message)

    def health(self):
        """Report a stale measurement, rejected ones, and commands that the limits did not let through."""
        values = {"rejected_measurements": self.rejected, "command_m": f"{self.command:.9g}", "stale": self.stale}
        values["saturated_commands"] = self.shortfall.count
        saturated = self.shortfall.report()
        rejected = self.since_report("rejected", self.rejected)
        if self.wrong_joint:
            return 2, f"joint '{self.parameters.joint}' is not in joint_states", values
        if self.stale or (self._last_stamp < 0 and not self.lockstep):
            return 2, f"measurement of '{self.parameters.joint}' is stale", values
        if self.unpaired:
            return 2, "reference and origin are stale", values
        if rejected:
            return 1, f"{rejected} measurements rejected", values
        return (1, saturated, values) if saturated else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([MotionControllerNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
