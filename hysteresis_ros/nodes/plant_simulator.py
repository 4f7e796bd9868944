"""Node ``plant_simulator``: ``voltage`` [V] → ``joint_states``; it owns the time of the axis."""

from __future__ import annotations

import math
import threading
import time
from array import array

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, UInt64

from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.nodes.base import AxisNode
from hysteresis_ros.nodes.lockstep import STARTUP_TIMEOUT, TOGETHER
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.spin import QUIET, run
from hysteresis_ros.simulation.node_parameters import part

#: Real time: longer waits can be interrupted, the last bit of a wait is slept because that is more exact [s].
EXACT_WAIT = 0.02

#: Nodes of an axis that read joint_states.
READERS = 3

#: Periods behind schedule after which the schedule moves instead of being caught up with.
FAR_BEHIND = 10.0


class PlantSimulatorNode(AxisNode):
    """Simulates the actuator in the place of real hardware.

    ``lockstep``: publishes sample k and steps to k+1 only when voltage k has come. ``realtime``: publishes at its rate
    from a thread with absolute deadlines and holds the last voltage.
    """

    state_names = ("displacement", "measured", "voltage")
    share = 0.95

    def __init__(self, **options):
        super().__init__("plant_simulator", **options)
        self._thread = None
        self._leaving = threading.Event()
        # real time: the thread and the executor both work on the actuator
        self._lock = threading.Lock()
        self._runs = 0

    def build(self, parameters) -> None:
        """Make the actuator from the parameters."""
        self.actuator = Actuator(part(parameters, ActuatorParameters), 1.0 / parameters.sample_rate)
        self.actuator.measure()  # compile now, not at the first sample
        self.actuator.advance(0.0)
        self._clear()

    def _clear(self) -> None:
        self.actuator.reset()
        self.voltage = self.actuator.voltage
        self.voltages = 0
        self.late = 0
        self.silent = False
        self._held = self.voltage
        self._following = True
        self._voltages_before = 0
        self._received = 0.0
        self._acknowledged = 0
        self._published = False
        self._ended = False
        self._start_stamp = 0
        self._first = self._last = 0.0
        self._told = False

    def connect(self) -> None:
        """Make the topics."""
        joint_states = JointState()
        joint_states.name = [self.parameters.joint]
        joint_states.position = array("d", [0.0])
        joint_states.velocity = array("d", [0.0])
        joint_states.effort = array("d", [self.parameters.preload.force])
        self._message = joint_states
        self._joint_states = self.publisher(JointState, "joint_states", self.qos(), loop=True)
        self._end = self.publisher(UInt64, "end_of_run", latched_qos())
        self._clock_publisher = (
            self.publisher(Clock, "/clock", latched_qos()) if self.parameters.publish_clock else None
        )
        partner = "hysteresis_compensator"
        voltage = self.subscriber(Float64, "voltage", self._on_voltage, self.qos(), partner=partner)
        self._voltage_name = voltage.topic_name
        if self._waits:
            topic, qos = "recorder/acknowledged", latched_qos()
            self.subscriber(UInt64, topic, self._on_acknowledged, qos, partner="recorder")
            self._acknowledged = -1

    @property
    def _waits(self) -> bool:
        return self.parameters.wait_for_recorder

    def begin(self) -> None:
        """Start the thread that keeps the time."""
        self._told = False
        if self.lockstep:
            self.say("running" if self.running else "paused")
        else:
            self._set_start()
            self._start_thread()

    def _start_thread(self) -> None:
        self._leaving.clear()
        self._thread = threading.Thread(target=self._keep_time, name="plant_time", daemon=True)
        self._thread.start()

    def _set_start(self) -> None:
        """Real time: let the stamps go on from now, or from zero where they are the source of time themselves."""
        self._start_stamp = 0 if self.parameters.publish_clock else time.time_ns() - self._stamp_of(self.sample)

    def _stamp_of(self, sample: int) -> int:
        return round(sample * 1e9 / self.parameters.sample_rate)

    def reset_blocks(self) -> None:
        """Begin again at sample 0; in lockstep reset all other nodes first."""
        with self._lock:
            self._clear()
            self.sample = 0
            self._runs += 1
            if not self.lockstep:
                self._set_start()
        if self._thread is not None and not self._thread.is_alive():
            self._start_thread()  # it had left at the end of the run before

    def retune(self, parameters) -> None:
        """Take new parameters of the actuator."""
        with self._lock:
            self.actuator.retune(part(parameters, ActuatorParameters))

    def on_running(self, running: bool) -> None:
        """``~/stop`` holds the time of the axis; ``~/start`` lets it go on."""
        if self.lockstep:
            self.say("running" if running else "paused")
            self.advance()
        elif running:
            with self._lock:
                self._set_start()

    # -- both modes --------------------------------------------------------------------------------------------

    def _publish_sample(self) -> None:
        """Measure sample k and publish it."""
        stamp = self._start_stamp + self._stamp_of(self.sample)
        message = self._message
        message.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        before = message.position[0]
        measured = self.actuator.measure()
        message.position[0] = measured
        message.velocity[0] = (measured - before) * self.parameters.sample_rate if self.sample else 0.0
        if not self.sample:
            self._first = time.monotonic()
        self._joint_states.publish(message)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=message.header.stamp))

    def _take(self, voltage: float) -> None:
        """Advance from sample k to k+1 with the voltage held in between."""
        displacement = self.actuator.displacement
        measured = self._message.position[0]
        really = self.actuator.advance(voltage)
        self.publish_state(self._message.header.stamp, displacement, measured, really)
        self.sample += 1

    def _on_voltage(self, message) -> None:
        finite = math.isfinite(message.data)
        if not finite:
            self.warn("voltage", f"voltage {message.data} V refused, {self.voltage:.6g} V kept")
        if self.lockstep:
            self._on_voltage_lockstep(message.data if finite else self.voltage)
        elif finite:
            self.voltage = message.data
            self.voltages += 1
            self._received = time.monotonic()

    def health(self):
        """Report the voltage, late commands and saturation."""
        values = {
            "voltage_v": f"{self._held:.6g}",
            "late_commands": self.late,
            "stale": self.silent,
            "real_time_factor": f"{self.parameters.real_time_factor:g}",
            "saturated_samples": self.actuator.limits.limited_samples,
        }
        late = self.since_report("late", self.late)
        if self.silent:
            return 2, "voltage is stale", values
        if self.actuator.saturated:
            return 1, "voltage saturated", values
        return (1, f"{late} commands late", values) if late else (0, "", values)

    def _finish(self) -> None:
        self._ended = True
        self._tell()
        self.end_of_run = self.sample
        self._end.publish(UInt64(data=self.sample))
        self.leave_when_done()

    def _tell(self) -> None:
        """Log what the run was; once."""
        if not self.sample or self._told:
            return
        self._told = True
        wall = max(time.monotonic() - self._first, 1e-9)
        rate = self.sample / wall
        factor = rate / self.parameters.sample_rate
        text = f"{self.sample} samples in {wall:.3f} s: {rate:.1f} Hz, real-time factor {factor:.3g}"
        self.get_logger().info(f"{text}, {self.late} late commands, {self.pace.overruns} overruns")

    # -- lockstep ----------------------------------------------------------------------------------------------

    def advance(self) -> None:
        """Publish the present sample when the partners and the recorder allow it."""
        if self._published or self._ended or self.failure or not self.running or not self.active or not self.lockstep:
            return
        if not self.matched() or (self._waits and self._recorder_behind()):
            return
        if self.parameters.samples and self.sample >= self.parameters.samples:
            self._finish()
            return
        self._published = True
        self.reset_pending = False
        self.pace.tick()
        self._publish_sample()

    def _recorder_behind(self) -> bool:
        return self._acknowledged < 0 or self.sample - self._acknowledged >= self.parameters.lead

    def _on_voltage_lockstep(self, voltage: float) -> None:
        if self._ended or not self.active or self.failure:
            return
        if not self._published:
            # before sample 0, and from a compensator that leaves while the time is held, it is nothing
            if self.sample and self.running and not self._recorder_behind():
                text = f"a voltage came that sample {self.sample} did not ask for"
                self.fail(f"{text}: hysteresis_compensator was restarted, or there are two; {TOGETHER}")
            return
        self.heard()
        self._published = False
        self.voltage = self._held = voltage
        self._take(voltage)
        self.advance()

    def _on_acknowledged(self, message) -> None:
        self._acknowledged = message.data
        self.heard()
        self.advance()

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        if not self.matched():
            return "every reader of joint_states"
        if self._published:
            return "hysteresis_compensator (topic voltage)"
        return "recorder" if self._waits and self._recorder_behind() else ""

    # -- real time ---------------------------------------------------------------------------------------------

    def _keep_time(self) -> None:
        try:
            self._keep_time_until_left()
        except Exception as error:  # a thread would die without a word
            self.fail(f"the thread that keeps the time broke: {type(error).__name__}: {error}")

    def _keep_time_until_left(self) -> None:
        period = 1.0 / (self.parameters.sample_rate * self.parameters.real_time_factor)
        if self.sample == 0 and self.parameters.samples:
            self._await_partners()
        deadline = time.monotonic()
        while not self._leaving.is_set() and not self._ended:
            if not self.running:
                self._leaving.wait(0.01)
                deadline = time.monotonic()
                continue
            with self._lock:
                self.pace.tick()
                self._publish_sample()
                published = self._runs
            deadline += period
            if not self._wait_until(deadline):
                return
            if time.monotonic() - deadline > FAR_BEHIND * period:
                deadline = time.monotonic()  # the schedule moves; samples are never dropped
            with self._lock:
                if self._runs != published:
                    continue  # a reset came in between: there is no sample to take
                if self.voltages and self.voltages == self._voltages_before:
                    self.late += 1
                self._voltages_before = self.voltages
                self._take(self._watched_voltage(period))
                if self.parameters.samples and self.sample >= self.parameters.samples:
                    self._finish()

    def _await_partners(self) -> None:
        """Let a run of given length begin when the loop is complete; one without end needs no beginning."""
        readers = READERS + self._waits
        patience = time.monotonic() + STARTUP_TIMEOUT
        while time.monotonic() < patience and not self._leaving.wait(0.02):
            complete = self._joint_states.get_subscription_count() >= readers
            if complete and self.count_publishers(self._voltage_name) and not (self._waits and self._acknowledged < 0):
                break
        with self._lock:
            if not self.sample:
                self._set_start()

    def _wait_until(self, deadline: float) -> bool:
        """Wait; False when the node leaves."""
        wait = deadline - time.monotonic()
        if wait > EXACT_WAIT:
            self._leaving.wait(wait - EXACT_WAIT)
            wait = deadline - time.monotonic()
        if wait > 0.0 and not self._leaving.is_set():
            time.sleep(wait)
        return not self._leaving.is_set()

    def _watched_voltage(self, period: float) -> float:
        """Return the voltage to hold: the last one received; on its way to the safe one when they stopped, and back."""
        if self.voltages and time.monotonic() - self._received > self.parameters.voltage_timeout:
            if not self.silent:
                self.silent, self._following = True, False
                limit, safe = self.parameters.voltage_timeout, self.parameters.safe_voltage
                self.warn("silent", f"no voltage for {limit:g} s: going to safe_voltage {safe:g} V")
        elif self.silent:
            self.silent = False
            self.get_logger().info("voltage is back")
        if self._following:
            self._held = self.voltage
            return self._held
        target = self.parameters.safe_voltage if self.silent else self.voltage
        step = self.parameters.safe_slew_rate * period
        self._held += min(max(target - self._held, -step), step)
        self._following = not self.silent and self._held == target
        return self._held

    # -- leaving -----------------------------------------------------------------------------------------------

    @property
    def listens_at_exit(self) -> bool:
        """In real time the voltage's return is still followed."""
        return not self.lockstep

    def drained(self) -> bool:
        """Tell whether no voltage is under way any more."""
        return time.monotonic() - self._received > QUIET

    def release(self) -> None:
        """Stop the thread that keeps the time."""
        self._leaving.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self.parameters is not None:
            self._tell()


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([PlantSimulatorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
