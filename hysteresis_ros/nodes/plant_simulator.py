# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``plant_simulator``: ``voltage`` [V] → ``joint_states``; it sets the sample times of the axis.

The simulated plant is a part of the loop (:mod:`hysteresis_ros.loop.plant`); an inchworm has three voltages and four
joints. With a driver, a device takes the place of the simulated plant (:mod:`hysteresis_ros.loop.device`). The node's
runner decides when a sample is processed (:mod:`hysteresis_ros.nodes.plant_runners`).
"""

from __future__ import annotations

import math
import threading
import time
from array import array
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64, UInt64

from hysteresis_ros import signals
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.loop.device import fused_plant_of, plant_of
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import PLANTS, actuate, sense
from hysteresis_ros.loop.tick import MEASURED, Laws
from hysteresis_ros.loop.watch import RUNNING
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.inchworm import EFFORT, POSITION, VELOCITY
from hysteresis_ros.nodes.base import ERROR, OK, WARN, AxisNode
from hysteresis_ros.nodes.plant_runners import LockstepPlant, RealTimePlant
from hysteresis_ros.nodes.qos import latched_qos, loop_qos, setpoint_qos
from hysteresis_ros.nodes.responder import TRIPPED_FRAME
from hysteresis_ros.nodes.samples import output_of
from hysteresis_ros.nodes.scan_clock import KEPT
from hysteresis_ros.nodes.scan_clock import TOPIC as SCAN_CLOCK
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import AMPLIFIER, LimitedTime, limited_in_all
from hysteresis_ros.nodes.triggers import INPUT
from hysteresis_ros.nodes.triggers import KEPT as KEPT_TRIGGERS
from hysteresis_ros.nodes.triggers import TOPIC as TRIGGERS
from hysteresis_ros.recordings.dataset import output_tolerance
from hysteresis_ros.references.scan_clock import LEVELS

#: Deviation of the stamps from the wall clock [ns] above which they are set to it again.
OFF_CLOCK = 100_000_000


def _wall_clock() -> int | None:
    """Return the time since 1970 [ns]; None if the clock cannot be read."""
    try:
        return time.time_ns()
    except OSError:
        return None


class Stamps:
    """Conversion of sample numbers to stamps."""

    def __init__(self, parameters):
        self._rate = parameters.sample_rate
        self._is_source = parameters.publish_clock
        self._stands_for_the_clock = not parameters.publish_clock and parameters.real_time_factor == 1.0
        self._factor = parameters.real_time_factor
        self._start = 0
        #: Wall-clock time at which the stamps began [ns]; 0: not yet.
        self._origin = 0
        #: Stamp of the last published sample [ns].
        self.last = 0

    def _since_start(self, sample: int) -> int:
        return round(sample * 1e9 / self._rate)

    def of(self, sample: int) -> int:
        """Return the stamp of a sample [ns]."""
        return self._start + self._since_start(sample)

    def of_all(self, samples: np.ndarray) -> np.ndarray:
        """Return the stamps [ns] of samples, both of shape (N,)."""
        return self._start + np.rint(samples * 1e9 / self._rate).astype(np.int64)

    def begin(self, origin: int = 0) -> None:
        """Set the time of sample 0 [ns since 1970]."""
        self._start = 0 if self._is_source else origin
        self._origin = 0

    def go_on(self, sample: int) -> None:
        """Restart the stamps with this sample: at the present time, or at zero if the stamps are the time source.

        Stamps never go back, even if the clock was set back or cannot be read, because no node accepts an earlier
        stamp. With a real-time factor other than 1, the time in the stamps passes at this factor, also during a pause;
        at the rate of the wall clock, a pause would appear as a gap of too many samples.
        """
        wall = _wall_clock() or 0
        origin = self._origin or wall
        now = max(origin + round(self._factor * (wall - origin)), self.last + self._since_start(1))
        self.begin(now - self._since_start(sample))
        self._origin = origin

    @property
    def are_off_clock(self) -> bool:
        """Whether the stamps deviate from the wall clock because it was set; False if the clock cannot be read."""
        now = _wall_clock() if self._stands_for_the_clock else None
        return now is not None and abs(now - self.last) > OFF_CLOCK + self._since_start(1)


class VoltageInput:
    """One voltage of the plant, received on its topic."""

    def __init__(self, topic: str, signal: int, partner: str):
        self.topic, self.signal, self.partner = topic, signal, partner
        self.clear()

    def clear(self) -> None:
        """Reset to the initial state."""
        self.value = math.nan
        self.received = 0.0
        #: Number of voltages so far, and time of the first voltage since the loop was last open [s].
        self.count, self.first = 0, 0.0
        self.full_name = self.topic


def explain_loss(lost: str, own: str) -> str:
    """Return why the loss of a node has stopped the axis of the plant ``own``, and how to resume."""
    if lost == own:
        cause = "it was inactive or suspended, or this machine was too busy"
        return f"the other nodes received no messages from this node for a while ({cause}); call ~/start to resume"
    return f"{lost} is lost: it sends no messages; start it again, then call ~/start"


def explain_trip(part, runner) -> str:
    """Return why a plant has stopped the axis, and how to resume."""
    if part.failure:
        return f"{part.failure}; ~/start tries the device again, cleanup and configure open it again"
    if part.lost:
        return explain_loss(part.lost, runner.node.get_fully_qualified_name())
    if part.finding_home:
        return "its relative sensor is being homed at the safe voltage; then the axis resumes without ~/start"
    if part.halted:
        return "an emergency stop (~/stop of a fused axis, or estop); call ~/start to resume"
    if part.overtravelled:
        low, high = part.travel
        where = f"the measurement is beyond {1e6 * low:.4g} … {1e6 * high:.4g} µm (overtravel)"
        others = "check sensor and cable, then gains, delay and scaling"
        late = runner.late_samples
        if not late:
            return f"{where}, which an unstable loop or a wrong sensor can cause: {others}; then call ~/start to resume"
        return (
            f"{where} after {late} late samples: many late voltages make a loop unstable (`hysteresis doctor` measures "
            f"the rate that this machine sustains); with few of them, {others}; then call ~/start to resume"
        )
    return runner.explain_trip()


def verdict(part, runner, inputs, late: int, limited: str = "") -> tuple[int, str]:
    """Return level and message of a plant's diagnostics."""
    topics = " or ".join(input_.topic for input_ in inputs)
    if part.tripped:
        return WARN if part.finding_home else ERROR, f"axis stopped: {explain_trip(part, runner)}"
    if part.silent:
        return ERROR, f"{topics} is stale"
    if limited:
        return WARN, f"{limited}; {part.complaint}" if part.complaint else limited
    if part.complaint:
        return WARN, part.complaint
    if part.saturated:
        return WARN, "voltage saturated"
    if late:
        return WARN, f"{late} samples late"
    if runner.by_message and not runner.exact and not any(input_.received for input_ in inputs):
        return WARN, f"no {topics} received yet: no node drives the axis"
    return OK, ""


#: Number of samples of a fused loop after ~/start until it is known whether the axis resumes.
OUTCOME = 3

#: Time in which the voltage of a device can reach its safe value before the node releases the device [s].
RETURN = 1.0

_SENSE, _ACTUATE = interpreted(sense), interpreted(actuate)


class PlantSimulatorNode(AxisNode):
    """Simulates an actuator or an inchworm motor, or runs the device of a driver.

    ``lockstep``: publishes sample k, and continues with k + 1 only when voltage k has arrived (all three of an
    inchworm). ``realtime``: publishes at its rate, from a thread with absolute deadlines, and holds the last voltages.
    """

    parameters: PlantNodeParameters
    identity = ("type", "driver", "hysteresis.type")
    share = 0.95
    triggers = (*AxisNode.triggers, "home")

    def __init__(self, **options):
        self.part = None
        super().__init__("plant_simulator", **options)
        # in real time the thread and the executor both access the plant
        self.lock: Any = threading.Lock()

    @property
    def patience(self) -> float:
        """Time without a voltage after which the output goes to the safe voltage [s]."""
        return self.parameters.voltage_timeout

    lockstep_runner = LockstepPlant
    real_time_runner = RealTimePlant

    @property
    def axis_kind(self) -> signals.AxisKind:
        """Kind of the axis of this plant."""
        return PLANTS[self.parameters.type].kind

    @property
    def is_seen(self) -> bool:
        """Whether a camera measures the plant, which then publishes images instead of joint_states."""
        return self.parameters.type == "camera"

    @property
    def holds_time(self) -> bool:
        """Whether ``~/stop`` has paused the time of the axis."""
        return not self.running

    def build(self, parameters) -> None:
        """Create the plant from the parameters."""
        if parameters.external_plant:
            raise ConfigurationError(
                "external_plant = True: your own node replaces this one; do not start this one (`hysteresis up --plant "
                "external`), or give external_plant: false"
            )
        self.parameters = parameters
        self.part = self.make_part(parameters)
        self.stamps = Stamps(parameters)
        self.inputs = [VoltageInput(*given) for given in self.axis_kind.voltages]
        self.row: Any = [0.0] * signals.MOTOR_ROW
        self._laws = Laws(*self.part.kernels, *(self.part.kernels[0],) * (len(Laws._fields) - 3))
        if parameters.driver:
            self._tell_device()
        # compile all branches of a simulated plant now, not at the first sample; a fused loop has its own code
        for voltage in () if parameters.driver or parameters.time_mode == "fused" else (0.0, math.nan):
            self.sense()
            for input_ in self.inputs:
                self.row[input_.signal] = voltage
            self.actuate()
        given = parameters.to_mapping()
        self._tolerance = output_tolerance(given, given)
        self._limited = LimitedTime()
        self._clear()

    def make_part(self, parameters, travel=None):
        """Return the plant's part of the loop; ``travel`` [m] is the allowed range of a device in a stage."""
        if parameters.time_mode == "fused":
            return fused_plant_of(parameters, travel=travel)
        return plant_of(parameters, travel)

    def _tell_device(self) -> None:
        # two calls, because rclpy allows only one severity per line of code
        if self.part.capabilities.watchdog is None:
            self.get_logger().warning(self.part.description)
        else:
            self.get_logger().info(self.part.description)

    def unbuild(self) -> None:
        """Release the device."""
        if self.is_fused:
            self.fused.end()
        if self.part is not None and not self.is_fused:  # if it is still fused, a call of the device has not returned
            wrong = self.part.close()
            if wrong:
                self.get_logger().error(wrong)

    def _clear(self) -> None:
        self.part.reset()
        self.row[:] = [0.0] * len(self.row)
        for input_ in self.inputs:
            input_.value, input_.received, input_.count, input_.first = math.nan, 0.0, 0, 0.0
        self.held_back = 0
        self.stamps.begin()
        self._first = self._latest = 0.0  # times of the first and the latest sample [s]
        self._told = False
        self._tripped = False

    def connect(self) -> None:
        """Create the topics."""
        self._message = self._joint_states_message()
        self._state_places = [signals.place(name) for name in self.state_signals().values()]
        self._output = output_of(self)
        self._end = self.publisher(UInt64, "end_of_run", latched_qos())
        self._clock_publisher = (
            self.publisher(Clock, "/clock", latched_qos()) if self.parameters.publish_clock else None
        )
        self.subscriber(Bool, "estop", self._on_emergency, setpoint_qos())
        for input_ in self.inputs if self.runner.by_message else ():
            take = partial(self.runner.voltage, input_)
            heard = self.loop_input(Float64, input_.topic, take, self.qos(), input_.partner)
            input_.full_name = heard.topic_name
        if self.parameters.scan_clock and self.runner.by_message:
            qos = loop_qos(self.runner.keeps, KEPT)
            self.subscriber(JointState, SCAN_CLOCK, self._on_scan_clock, qos)
        if self.parameters.trigger_output and self.runner.by_message and not self.part.capabilities.compares:
            self.subscriber(JointState, TRIGGERS, self._on_trigger, loop_qos(self.runner.keeps, KEPT_TRIGGERS))
        takes_pulses = self.parameters.trigger_input and self.runner.by_message
        self._pulses = self.publisher(Empty, INPUT, setpoint_qos()) if takes_pulses else None
        if self.parameters.wait_for_recorder and self.runner.by_message:
            topic, qos = "recorder/acknowledged", latched_qos()
            self.subscriber(UInt64, topic, self.runner.acknowledged_by_recorder, qos, partner="recorder")

    def state_signals(self) -> dict[str, str]:
        """Return the content of ``~/state``, without a device's true displacement or a camera's measurement."""
        unknown = "displacement" if self.parameters.driver else "measured" if self.is_seen else ""
        return {name: signal for name, signal in super().state_signals().items() if name != unknown}

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in ``joint_states``."""
        names: tuple[str, ...] = self.part.joint_names
        return names

    @property
    def joint_states(self) -> JointState:
        """The last message on ``joint_states``."""
        return self._message

    def _joint_states_message(self) -> JointState:
        names = self.joint_names
        message = JointState()
        message.name = list(names)
        message.position, message.velocity, message.effort = (array("d", bytes(8 * len(names))) for _ in range(3))
        message.effort[0] = self.parameters.resting_effort
        return message

    # -- the part of the loop ------------------------------------------------------------------------------------

    def sense(self) -> None:
        """Write the measurements of the present sample into the row."""
        self.row[signals.TRIGGER_IN] = 0.0
        _SENSE(self._laws, self.part.arrays, self.row)

    def actuate(self) -> None:
        """Hold the voltages of the row until the next sample."""
        _ACTUATE(self._laws, self.part.arrays, self.row)

    def reset_blocks(self) -> None:
        """Restart at sample 0; in lockstep reset all other nodes first."""
        with self.lock:
            self._clear()
            self.sample = 0
            self.runner.restart()

    def retune(self, parameters) -> None:
        """Apply new parameters of the plant."""
        with self.lock:
            self.part.retune(parameters)

    def retuned(self, parameters) -> None:
        """Set the present preload in ``joint_states``."""
        if not self.axis_kind.motor:
            self._message.effort[0] = parameters.preload.force

    def change_details(self) -> dict:
        """Return the field of a change that takes effect after the present sample has been measured."""
        return {"after": MEASURED} if self.runner.is_measured else {}

    def _on_emergency(self, message) -> None:
        if not message.data or not self.active:
            return
        self.warn("estop", "emergency stop: the axis moves to its safe state until ~/start", error=True)
        if self.is_fused:
            self.fused.halt()
            return
        with self.lock:
            self.part.halt()
            self.log_change("halt")

    def _on_scan_clock(self, message) -> None:
        """Let the device output the scan edges."""
        numbers = dict(zip(message.name, message.position, strict=False))
        if not self.active or any(not math.isfinite(numbers.get(name, math.nan)) for name in LEVELS[1:]):
            return
        begun = [edge for edge, name in zip(signals.Edge, LEVELS[1:], strict=True) if numbers[name] >= 0.0]
        if begun:
            with self.lock:
                self.part.output_clock(begun[-1])

    def _on_trigger(self, message) -> None:
        """Let the device output a trigger."""
        numbers = dict(zip(message.name, message.position, strict=False))
        number, delay = (numbers.get(name, math.nan) for name in ("number", "delay"))
        if self.active and math.isfinite(number) and math.isfinite(delay) and number >= 1.0:
            with self.lock:
                self.part.output_trigger(int(number), delay)

    def lose(self, name: str) -> None:
        """Stop the axis until ~/start because one of its nodes is lost; called with the lock held."""
        if not self.part.tripped:
            self.log_change("halt")
        elif self.part.lost != name:
            why = explain_loss(name, self.get_fully_qualified_name())
            self.warn("tripped", f"axis stopped: {why}", error=True, every=0.0)
        self.part.lose(name)

    def _on_start(self, request, response):
        if self.parameters is None or self.part is None or not self.part.tripped:
            return super()._on_start(request, response)
        if not self.is_fused:
            with self.lock:
                self.go_on()
        elif self.running:
            self.fused.go_on()
        answer = super()._on_start(request, response)
        if self.is_fused:
            self.fused.await_samples(OUTCOME)
            if self.hindrance():
                answer.success, answer.message = False, f"not running: {self.hindrance()}"
        return answer

    def go_on(self) -> None:
        """Resume the stopped axis unless one of its nodes is lost; called with the lock held."""
        if not self.runner.missing_partners():
            self.part.start()
            if not self.part.tripped:
                self.runner.go_on()
            self.log_change("start")

    def stopped(self) -> str:
        """Return a message about the effect of ``~/stop``: an emergency stop if fused, otherwise a pause."""
        if self.is_fused:
            return f"stopped: the voltage goes to safe_voltage = {self.parameters.safe_voltage:g} V"
        return f"stopped: no samples are computed, and the voltage stays at {self.part.held():.6g} V"

    def hindrance(self) -> str:
        """Return why the axis does not run although it was not stopped by the user; empty if it runs."""
        text = super().hindrance()
        if text or not self.part.tripped or self.part.finding_home:
            return text
        missing = self.runner.missing_partners()
        return f"{missing} is lost: start it again, then call ~/start" if missing else self.explain_trip()

    def _on_home(self, request, response):
        if self.is_fused:
            self.fused.apply(self.kind, "home")
        elif self.part is not None:
            with self.lock:
                self.part.home()
                self.log_change("home")
        return self._answer_service(response, "homing")

    def on_running(self, running: bool) -> None:
        """Pause the time of the axis (``~/stop``), or resume it (``~/start``), also after a trip."""
        self.runner.hold(not running)

    # -- samples -------------------------------------------------------------------------------------------------

    def begin_run(self, origin: int) -> None:
        """Set the time of sample 0 of a fused loop [ns since 1970]."""
        self._first = time.monotonic()
        self._told = self._tripped = False
        self.sample = 0
        self.stamps.begin(origin)

    def publish_sample(self) -> None:
        """Measure the present sample and publish it."""
        self.sense()
        self.publish_measured()

    def publish_measured(self) -> None:
        """Publish the present sample, which is in the row."""
        before = self._message.position[0]
        if not self.sample:
            self._first = time.monotonic()
        self._publish_measured(self.stamps.of(self.sample), before if self.sample else self.row[signals.MEASURED])

    def show(self, sample: int, before: float, quiet: bool):
        """Publish the row of a sample of a fused loop; ``before`` [m] is the previous measurement."""
        self._publish_measured(self.stamps.of(sample), before, quiet)
        self._publish_row()
        return self._message.header.stamp

    def _publish_measured(self, stamp: int, before: float, quiet: bool = False) -> None:
        message, row, self.stamps.last = self._message, self.row, stamp
        message.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        if self.axis_kind.motor:
            joints = self.part.arrays.x.joints
            message.position[:] = array("d", joints[POSITION : POSITION + 4].tobytes())
            message.velocity[:] = array("d", joints[VELOCITY : VELOCITY + 4].tobytes())
            message.effort[:] = array("d", joints[EFFORT : EFFORT + 4].tobytes())
        else:
            message.position[0] = row[signals.MEASURED]
            moved = row[signals.MEASURED] - before
            message.velocity[0] = moved * self.parameters.sample_rate
            if self.part.measures_force:
                message.effort[1] = row[signals.FORCE]
        tripped = row[signals.TRIPPED] != 0.0
        if tripped != self._tripped:
            self._tripped = tripped
            message.header.frame_id = TRIPPED_FRAME if tripped else ""
            if tripped and not quiet:
                self.warn("tripped", f"axis stopped: {self.explain_trip()}", error=True, every=0.0)
            elif not quiet:
                self.get_logger().info("the axis resumes")
        if self._pulses is not None:
            for _ in range(int(row[signals.TRIGGER_IN])):
                self._pulses.publish(Empty())
        self._output.publish(message)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=message.header.stamp))

    def finish_sample(self) -> None:
        """Hold the received voltages, with NaN for missing ones, and advance to the next sample."""
        self.hold_voltages()
        self.close_sample()

    def hold_voltages(self) -> None:
        """Hold the received voltages, with NaN for missing ones."""
        for input_ in self.inputs:
            self.row[input_.signal] = input_.value
            input_.value = math.nan
        self.actuate()
        # counted only while the output returns to the received voltage; a motion to the safe voltage is reported
        # elsewhere
        if self.row[signals.PLANT_MODE] == RUNNING and not self.part.saturated:
            differs = abs(self.row[signals.PLANT_VOLTAGE] - self.row[signals.VOLTAGE]) > self._tolerance
            self.held_back += int(differs)

    def close_sample(self) -> None:
        """Publish the state of the present sample and advance to the next one."""
        self._publish_row()
        self.sample += 1

    def _publish_row(self) -> None:
        self._latest = time.monotonic()
        self.publish_state(self._message.header.stamp, *[self.row[place] for place in self._state_places])

    def receive(self, input_: VoltageInput, voltage: float) -> None:
        """Store a voltage for the present sample; a value that is not finite counts as missing."""
        if math.isfinite(voltage):
            input_.value = voltage
            input_.received = time.monotonic()
            input_.count += 1
            input_.first = input_.first or input_.received
        else:
            self.warn(input_.topic, f"{input_.topic} {voltage} V refused, {self.part.held():.6g} V kept")

    def loop_complete(self) -> bool:
        """Return whether the command and every voltage have a publisher."""
        topics = (self.resolve_topic_name("command"), *(input_.full_name for input_ in self.inputs))
        return all(self.count_publishers(topic) for topic in topics)

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis."""
        return explain_trip(self.part, self.runner)

    def readers(self) -> int:
        """Return the number of subscribers of ``joint_states``."""
        return self._output.get_subscription_count()

    @property
    def silent(self) -> bool:
        """Whether a voltage is no longer received."""
        return self.part.silent

    @property
    def late(self) -> int:
        """Number of late samples so far: samples with a late voltage, or samples that a loop has skipped."""
        return self.runner.late_samples

    def _limited_counts(self) -> dict[str, int]:
        """Return the number of samples with a limited output for each cause; without the amplifiers of a motor."""
        counts = {"safe_slew_rate": self.held_back}
        return counts if self.axis_kind.motor else counts | {AMPLIFIER: self.part.limited_samples}

    def health(self):
        """Report the voltage, late commands and saturation."""
        values = {
            **{
                f"{input_.topic.replace('/', '_')}_v": f"{self.part.held(place):.6g}"
                for place, input_ in enumerate(self.inputs)
            },
            "late_samples": self.late,
            "stale": self.silent,
            "tripped": self.part.tripped,
            "real_time_factor": f"{self.parameters.real_time_factor:g}",
            "saturated_samples": self.part.limited_samples,
            "held_back_samples": self.held_back,
            **self.runner.timeliness(),
        }
        late = self.since_report("late", self.late)
        limited = self._limited.report(self._limited_counts(), self.parameters.sample_rate)
        return *verdict(self.part, self.runner, self.inputs, late, limited), values

    # -- the end -------------------------------------------------------------------------------------------------

    def finish(self) -> None:
        """Publish the end of the run."""
        self._tell()
        self.end_of_run = self.sample
        self._end.publish(UInt64(data=self.sample))
        self.leave_when_done()

    def _tell(self) -> None:
        """Log the summary of the run once."""
        if not self.sample or self._told:
            return
        self._told = True
        # measured only up to the last sample, because making a device safe and closing it takes time
        wall = max(self._latest - self._first, 1e-9)
        rate = self.sample / wall
        factor = rate / self.parameters.sample_rate
        text = f"{self.sample} samples in {wall:.3f} s: {rate:.1f} Hz, real-time factor {factor:.3g}"
        text += f", {self.late} late samples ({100.0 * self.late / self.sample:.3g} %)"
        if self.late and self.parameters.time_mode == "fused":
            text += "; hysteresis report gives the errors with and without the intervals that late samples disturb"
        self.get_logger().info(text)
        limited = limited_in_all(self._limited_counts(), self.sample, self.parameters.sample_rate)
        if limited:
            self.get_logger().warning(limited)

    def begin(self) -> None:
        """Start the time of the axis."""
        self._told = False
        self.runner.start_time()

    def missing_partner(self) -> str:
        """Return the partner whose input for the present sample is missing."""
        return self.runner.missing_voltage()

    @property
    def listens_at_exit(self) -> bool:
        """Whether the node processes pending messages before it exits: in real time, the last voltages."""
        return not self.runner.exact

    def drained(self) -> bool:
        """Return whether no voltage is pending."""
        return self.runner.is_quiet

    def release(self) -> None:
        """Stop the timing thread; move a device to its safe state."""
        if self.runner is not None:
            self.runner.stop_time()
            self.make_safe()
        if self.parameters is not None:
            self._tell()

    def destroy_node(self) -> None:
        """Remove the node from the graph and release the device."""
        self.unbuild()
        super().destroy_node()

    def make_safe(self) -> None:
        """Move a device to its safe state, unless a loop still runs it, which then holds the safe voltage."""
        if self.is_fused and self.fused.loop.running:
            return
        patience = time.monotonic() + RETURN
        while self.part.step_to_safe() and time.monotonic() < patience:
            time.sleep(self.runner.period)
        try:
            self.part.make_safe()
        except HysteresisError as error:
            self.warn("safe", str(error), every=0.0 if self.leaving else 60.0, error=True)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([PlantSimulatorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
