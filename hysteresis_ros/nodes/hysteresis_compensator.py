"""Node ``hysteresis_compensator``: ``command`` [m] → ``voltage`` [V] and ``applied`` [m]."""

from __future__ import annotations

import math
import time

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.compensation.compensator import LIMITS, Compensator, CompensatorParameters
from hysteresis_ros.models.limits import SLEW
from hysteresis_ros.nodes.base import AxisNode, sample_index
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import Pairing
from hysteresis_ros.simulation.node_parameters import part

#: Seconds between two looks at the watchdog.
WATCHDOG_PERIOD = 0.01

#: Seconds that the way to the safe voltage may take when the node leaves; what is left then is one step.
LEAVING_TIME = 0.3


class HysteresisCompensatorNode(AxisNode):
    """Inverts the hysteresis and keeps the voltage within its limits.

    In real time a ``command`` that stops for ``command_timeout`` makes the voltage slew to ``safe_voltage``; when
    commands return, the difference to them fades out. At exit the voltage returns to ``safe_voltage`` too.
    """

    state_names = ("command", "voltage", "applied", "saturated")
    share = 0.9

    def __init__(self, **options):
        super().__init__("hysteresis_compensator", **options)

    def build(self, parameters) -> None:
        """Make the compensator from the parameters."""
        sample_time = 1.0 / parameters.sample_rate
        self.compensator = Compensator(part(parameters, CompensatorParameters), sample_time)
        self.compensator.step(0.0)  # compile now, not at the first sample
        self._clear()

    def _clear(self) -> None:
        self.compensator.reset()
        self.voltage = self.compensator.voltage
        self.refused = 0
        self.silent = False
        self._last_command = 0.0
        self._received = time.monotonic()
        self._commands = 0
        self._stamp = None
        self._pairing = Pairing()

    def connect(self) -> None:
        """Make the topics."""
        self._message = Float64()
        self._applied_message = Float64()
        self._voltage = self.publisher(Float64, "voltage", self.qos(), loop=True)
        self._applied = self.publisher(Float64, "applied", self.qos(), loop=True)
        self.subscriber(JointState, "joint_states", self._on_measurement, self.qos(), partner="plant_simulator")
        self.subscriber(Float64, "command", self._on_command, self.qos(), partner="motion_controller")
        self.subscribe_end()

    def begin(self) -> None:
        """Start the watchdog of the command."""
        if not self.lockstep:
            self._received = time.monotonic()
            self.silent = self.sample > 0  # the first command that comes is where it goes on
            self.timer(WATCHDOG_PERIOD, self._watchdog)

    def reset_blocks(self) -> None:
        """Begin again with everything at rest."""
        self._clear()

    def retune(self, parameters) -> None:
        """Take new model parameters and limits; the voltage does not jump."""
        self.compensator.retune(part(parameters, CompensatorParameters))

    def on_running(self, running: bool) -> None:
        """``~/stop`` slews to the safe voltage; after ``~/start`` the difference to the command fades out."""
        if running:
            self._rejoin()

    def _on_measurement(self, message) -> None:
        if not self.lockstep:
            waiting = self._pairing.measurement(message.header.stamp, time.monotonic())
            if waiting is not None:
                self.publish_state(message.header.stamp, *waiting)
        elif self.expected(sample_index(message.header.stamp, self.parameters.sample_rate)):
            self.heard()
            self._stamp = message.header.stamp
            self.advance()

    def _on_command(self, message) -> None:
        finite = math.isfinite(message.data)
        if not finite:
            self.refused += 1
            self.warn("command", f"command {message.data} m refused, {self._last_command:.6g} m kept")
        if self.lockstep:
            self._commands += 1
            if not self.surplus(self._commands, self.sample + 1, "command", "motion_controller"):
                self.heard()
                self._last_command = message.data if finite else self._last_command
                self.advance()
        elif self.active and finite:
            self._take_command(message.data)

    def _take_command(self, command: float) -> None:
        self.pace.tick()
        self._last_command = command
        self._received = time.monotonic()
        if self.silent:
            self.silent = False
            self.get_logger().info("command is back")
            self._rejoin()
        self._answer()
        # one message from the plant and one from the controller: which of them comes first is chance
        stamp = self._pairing.answer(self._values(), self._received)
        if stamp is not None:
            self.publish_state(stamp, *self._values())

    def advance(self) -> None:
        """Lockstep: answer when measurement k and command k are there."""
        if (
            self._stamp is None
            or self._commands <= self.sample
            or not self.active
            or self.failure
            or not self.matched()
        ):
            return
        self.pace.tick()
        stamp, self._stamp = self._stamp, None
        self._answer()
        self.publish_state(stamp, *self._values())

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        if self._stamp is None:
            return "plant_simulator"
        return "motion_controller" if self._commands <= self.sample else ""

    def _answer(self) -> None:
        if self.running:
            self.voltage = self.compensator.step(self._last_command)
        else:
            self._slew_safe(1.0 / self.parameters.sample_rate)
        self._publish()
        self.sample += 1

    def _values(self) -> tuple[float, float, float, float]:
        compensator = self.compensator
        return self._last_command, self.voltage, compensator.applied, float(compensator.saturated)

    def _publish(self) -> None:
        self._message.data = self.voltage
        self._voltage.publish(self._message)
        self._applied_message.data = self.compensator.applied
        self._applied.publish(self._applied_message)

    def _rejoin(self) -> None:
        """Let the next voltage continue from the present one."""
        self.compensator.resume(self._last_command)

    def _watchdog(self) -> None:
        """Real time: slew to the safe voltage while no command comes."""
        quiet = time.monotonic() - self._received
        if not self.active or self.sample == 0 or quiet < self.parameters.command_timeout:
            return
        if not self.silent:
            self.silent = True
            limit, safe = self.parameters.command_timeout, self.parameters.safe_voltage
            self.warn("silent", f"no command for {limit:g} s: going to safe_voltage {safe:g} V")
        self._slew_safe(WATCHDOG_PERIOD)
        self._publish()

    def _slew_safe(self, duration: float) -> None:
        step = self.parameters.safe_slew_rate * duration
        target = self.parameters.safe_voltage
        self.voltage = self.compensator.hold(self.voltage + min(max(target - self.voltage, -step), step))

    def go_safe(self) -> None:
        """Publish the way to the safe voltage and the safe voltage; in lockstep, which has no time, the latter only."""
        if self.sample == 0:
            return
        period = max(1.0 / self.parameters.sample_rate, 0.001)
        step = self.parameters.safe_slew_rate * period
        deadline = time.monotonic() + LEAVING_TIME
        while (
            not self.lockstep
            and abs(self.voltage - self.parameters.safe_voltage) > step
            and time.monotonic() < deadline
        ):
            self._slew_safe(period)
            self._publish()
            time.sleep(period)
        # the limit of the slew rate, of one sample, must not keep the last message from being the safe voltage
        limits = self.compensator.ps[LIMITS]
        slew, limits[SLEW] = limits[SLEW], 0.0
        self.voltage = self.compensator.hold(self.parameters.safe_voltage)
        limits[SLEW] = slew
        self._message.data = self.voltage
        self._voltage.publish(self._message)

    def health(self):
        """Report saturation, silence and refused commands."""
        values = {
            "voltage_v": f"{self.voltage:.6g}",
            "saturated_samples": self.compensator.limits.limited_samples,
            "refused_commands": self.refused,
            "stale": self.silent,
        }
        refused = self.since_report("refused", self.refused)
        if self.silent:
            return 2, "command is stale", values
        if refused:
            return 1, f"{refused} commands refused", values
        return (1, "voltage saturated", values) if self.compensator.saturated else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([HysteresisCompensatorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
