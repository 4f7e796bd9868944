"""Node ``plant_simulator``: ``voltage`` [V] → ``joint_states``; it owns the time of the axis.

What it simulates is in :mod:`hysteresis_ros.nodes.plants`: an inchworm has three voltages and four joints.
"""

from __future__ import annotations

import threading
import time
from functools import partial

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, UInt64

from hysteresis_ros.nodes.base import AxisNode
from hysteresis_ros.nodes.held_voltage import HeldVoltage
from hysteresis_ros.nodes.lockstep import STARTUP_TIMEOUT, TOGETHER
from hysteresis_ros.nodes.plants import PLANTS
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.spin import QUIET, run

#: Real time: longer waits can be interrupted, the last bit of a wait is slept because that is more exact [s].
EXACT_WAIT = 0.02

#: Nodes of an axis that read joint_states.
READERS = 3

#: Periods behind schedule after which the schedule moves instead of being caught up with.
FAR_BEHIND = 10.0


class PlantSimulatorNode(AxisNode):
    """Simulates an actuator or an inchworm motor in the place of real hardware.

    ``lockstep``: publishes sample k and steps to k+1 only when voltage k has come, an inchworm when all three have.
    ``realtime``: publishes at its rate from a thread with absolute deadlines and holds the last voltages.
    """

    share = 0.95

    def __init__(self, **options):
        super().__init__("plant_simulator", **options)
        self._thread = None
        self._leaving = threading.Event()
        # real time: the thread and the executor both work on the actuator
        self._lock = threading.Lock()
        self._runs = 0

    def build(self, parameters) -> None:
        """Make the plant from the parameters."""
        self.plant = PLANTS[parameters.type](parameters)
        self.state_names = self.plant.state_names
        self.inputs = [HeldVoltage(topic, partner) for topic, partner in self.plant.inputs]
        self._clear()

    def _clear(self) -> None:
        self.plant.reset()
        for held, voltage in zip(self.inputs, self.plant.resting_voltages, strict=True):
            held.reset(voltage)
        self.late = 0
        self._awaited = 0
        self._acknowledged = 0
        self._published = False
        self._ended = False
        self._start_stamp = 0
        self._first = self._last = 0.0
        self._told = False

    def connect(self) -> None:
        """Make the topics."""
        self._message = self.plant.message
        self._joint_states = self.publisher(JointState, "joint_states", self.qos(), loop=True)
        self._end = self.publisher(UInt64, "end_of_run", latched_qos())
        self._clock_publisher = (
            self.publisher(Clock, "/clock", latched_qos()) if self.parameters.publish_clock else None
        )
        self._voltage_names = []
        for held in self.inputs:
            take = partial(self._on_voltage, held)
            heard = self.subscriber(Float64, held.topic, take, self.qos(), partner=held.partner)
            self._voltage_names.append(heard.topic_name)
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
        """Take new parameters of the plant."""
        with self._lock:
            self.plant.retune(parameters)

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
        self.plant.measure(first=not self.sample)
        if not self.sample:
            self._first = time.monotonic()
        self._joint_states.publish(message)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=message.header.stamp))

    def _take(self, *voltages: float) -> None:
        """Advance from sample k to k+1 with the voltages held in between."""
        self.publish_state(self._message.header.stamp, *self.plant.advance(*voltages))
        self.sample += 1

    def _on_voltage(self, held, message) -> None:
        if self.lockstep:
            self._on_voltage_lockstep(held, message.data)
        else:
            self._receive(held, message.data)

    def _receive(self, held, voltage: float) -> None:
        if not held.take(voltage):
            self.warn(held.topic, f"{held.topic} {voltage} V refused, {held.value:.6g} V kept")

    @property
    def silent(self) -> bool:
        """Real time: whether a voltage has stopped."""
        return any(held.silent for held in self.inputs)

    def health(self):
        """Report the voltage, late commands and saturation."""
        values = {
            **{f"{held.topic.replace('/', '_')}_v": f"{held.held:.6g}" for held in self.inputs},
            "late_commands": self.late,
            "stale": self.silent,
            "real_time_factor": f"{self.parameters.real_time_factor:g}",
            "saturated_samples": self.plant.limited_samples,
        }
        late = self.since_report("late", self.late)
        if self.silent:
            stale = " and ".join(held.topic for held in self.inputs if held.silent)
            return 2, f"{stale} {'is' if stale.count(' ') == 0 else 'are'} stale", values
        if self.plant.saturated:
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
        self._awaited = len(self.inputs)
        for held in self.inputs:
            held.there = False
        self.reset_pending = False
        self.pace.tick()
        self._publish_sample()

    def _recorder_behind(self) -> bool:
        return self._acknowledged < 0 or self.sample - self._acknowledged >= self.parameters.lead

    def _on_voltage_lockstep(self, held, voltage: float) -> None:
        if self._ended or not self.active or self.failure:
            return
        if not self._published or held.there:
            # before sample 0, and from a compensator that leaves while the time is held, it is nothing
            if held.there or (self.sample and self.running and not self._recorder_behind()):
                text = f"a voltage came on {held.topic} that sample {self.sample} did not ask for"
                self.fail(f"{text}: {held.partner} was restarted, or there are two; {TOGETHER}")
            return
        self.heard()
        self._receive(held, voltage)
        held.held = held.value
        held.there = True
        self._awaited -= 1
        if not self._awaited:
            self._published = False
            self._take(*[held.value for held in self.inputs])
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
            missing = [held for held in self.inputs if not held.there]
            # the voltage waits for what others wait for: who owes another one is nearer to the culprit
            return f"{missing[-1].partner} (topic {missing[-1].topic})"
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
                self.late += any([held.late() for held in self.inputs])
                self._take(*self._watched_voltages(period))
                if self.parameters.samples and self.sample >= self.parameters.samples:
                    self._finish()

    def _await_partners(self) -> None:
        """Let a run of given length begin when the loop is complete; one without end needs no beginning."""
        readers = READERS + self._waits
        patience = time.monotonic() + STARTUP_TIMEOUT
        while time.monotonic() < patience and not self._leaving.wait(0.02):
            complete = self._joint_states.get_subscription_count() >= readers
            complete = complete and all(self.count_publishers(topic) for topic in self._voltage_names)
            if complete and not (self._waits and self._acknowledged < 0):
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

    def _watched_voltages(self, period: float) -> list[float]:
        """Return the voltages to hold: the last ones received, or on their way to safe ones when they stopped."""
        timeout = self.parameters.voltage_timeout
        safe = self.plant.safe_voltages(self.parameters, [held.held for held in self.inputs])
        for held, voltage in zip(self.inputs, safe, strict=True):
            silent = held.stopped(timeout)
            if silent and not held.silent:
                self.warn(held.topic, f"no {held.topic} for {timeout:g} s: going to {voltage:g} V, which is safe")
            elif held.silent and not silent:
                self.get_logger().info(f"{held.topic} is back")
            held.follow(silent, voltage, self.parameters.safe_slew_rate * period)
        return [held.held for held in self.inputs]

    # -- leaving -----------------------------------------------------------------------------------------------

    @property
    def listens_at_exit(self) -> bool:
        """In real time the voltage's return is still followed."""
        return not self.lockstep

    def drained(self) -> bool:
        """Tell whether no voltage is under way any more."""
        return all(time.monotonic() - held.received > QUIET for held in self.inputs)

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
