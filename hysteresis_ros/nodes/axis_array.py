# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Executable ``hysteresis_array``, node ``axis_array``: many independent axes, with one message per topic and sample.

The parameter file describes one axis, as for the other nodes. The section ``axis_array`` states the number of axes, and
a separate file contains the values that differ between the axes (:mod:`hysteresis_ros.loop.axis_array`). Plants
(simulated actuators), controllers and compensators of all axes are computed in one call per sample. In lockstep the
samples run as fast as the computer allows, or each sample waits for new setpoints; in real time they begin at absolute
deadlines.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from array import array
from functools import partial
from types import SimpleNamespace

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String, UInt64

from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.files import BoundsError, read_arrays
from hysteresis_ros.loop.axis_array import ArrayNodeParameters, AxisArray, parameters_of_each
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.nodes.base import ERROR, OK, WARN, AxisNode
from hysteresis_ros.nodes.plant_simulator import Stamps
from hysteresis_ros.nodes.qos import latched_qos, setpoint_qos
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.spin import given_configuration, refused, run
from hysteresis_ros.recordings.bag_writer import BagWriter, GuardedBag, require_space
from hysteresis_ros.recordings.provenance import RECORD, provenance
from hysteresis_ros.units import micrometres

#: Topics of the array.
SETPOINTS, VOLTAGES, JOINT_STATES = "setpoints", "voltages", "joint_states"
_ARRAY, _JOINTS, _TEXT = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
#: In lockstep, the array waits for acknowledgements each time after this number of samples.
STRIDE = 64
#: Longest duration of one wait for acknowledgements [s].
ACKNOWLEDGED = 0.1
#: Real time: delay [periods] above which the schedule is shifted; the array catches up on smaller delays.
FAR_BEHIND = 10.0
#: Interval between checks while the array is paused, or waits for other nodes [s].
PAUSE = 0.01
#: Interval between checks of the bag [s].
TEND = 0.1


class ArrayRunner(RealTime):
    """Computes the samples in a thread: in lockstep one after the other, in real time at absolute deadlines."""

    by_message = False

    def __init__(self, node):
        self._thread: threading.Thread | None = None
        self._leaving = threading.Event()
        self.exact = self.keeps = node.parameters.time_mode == "lockstep"
        super().__init__(node)

    def start_time(self) -> None:
        """Start the thread."""
        self._leaving.clear()
        self._thread = threading.Thread(target=self._run, name="array", daemon=True)
        self._thread.start()

    def stop_time(self) -> None:
        """Stop the thread after the present sample."""
        self._leaving.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        try:
            self._run_samples()
        except Exception as error:  # otherwise the thread would end without a message
            self.node.fail(f"the samples failed: {type(error).__name__}: {error}")

    def _run_samples(self) -> None:
        node, deadline, paused = self.node, time.monotonic(), True
        samples = node.parameters.samples
        if node.parameters.wait_for_setpoints and not self._await_partners():
            return
        while not self._leaving.is_set() and not (samples and node.sample >= samples):
            if not node.running:
                paused = True
                self._leaving.wait(PAUSE)
                continue
            if paused:
                paused, deadline = False, time.monotonic()
                node.stamps.go_on(node.sample)
            with node.lock:
                node.answered.clear()
                node.compute_sample()
            if self.exact:
                self._await_subscribers()
                if node.parameters.wait_for_setpoints and not self._await_answer(samples):
                    return
                continue
            deadline += self.period
            behind = time.monotonic() - deadline
            node.late += behind > self.period
            if behind > FAR_BEHIND * self.period:
                paused = True  # shift the schedule; samples are never dropped
            elif behind < 0.0:
                self._leaving.wait(-behind)
        if samples and node.sample >= samples:
            node.finish()

    def _await_partners(self) -> bool:
        """Wait for a publisher of setpoints and a subscriber of measurements; return False if the node exits."""
        node = self.node
        joints, _ = node.outputs
        while not (joints.get_subscription_count() and node.count_publishers(node.setpoints_topic)):
            text = "waits for a publisher of setpoints and a subscriber of joint_states"
            node.warn("waiting", text, every=node.parameters.partner_timeout)
            if self._leaving.wait(PAUSE):
                return False
        return True

    def _await_answer(self, samples: int) -> bool:
        """Wait for setpoints after the present sample, unless it is the last one; return False if none arrive."""
        node, patience = self.node, time.monotonic() + self.node.parameters.partner_timeout
        while not node.answered.wait(PAUSE) and not (samples and node.sample >= samples) and node.running:
            if self._leaving.is_set():
                return False
            if time.monotonic() > patience:
                node.fail(
                    f"no setpoints after sample {node.sample - 1} for {node.parameters.partner_timeout:g} s "
                    "(partner_timeout): start their publisher, or set wait_for_setpoints: false"
                )
                return False
        return True

    def _await_subscribers(self) -> None:
        """Wait until all subscribers have acknowledged the samples so far."""
        if self.node.sample % STRIDE:
            return
        for publisher in self.node.outputs:
            while not publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED)):
                if self._leaving.is_set():
                    return


class AxisArrayNode(AxisNode):
    """Takes ``setpoints`` [m] of many axes, and publishes ``joint_states`` [m] and ``voltages`` [V] of each sample."""

    parameters: ArrayNodeParameters
    parameters_class = ArrayNodeParameters
    identity = ("axes",)
    has_state = False

    def __init__(self, axis: AxisParameters, text: str = "", **options):
        self._axis, self._text = axis, text
        #: Held while a sample is computed and published, and while the bag changes.
        self.lock = threading.Lock()
        #: Number of samples that began more than a period late, and number of refused messages.
        self.late = self.refused = 0
        self.recording: GuardedBag | None = None
        #: Set if a message on ``setpoints`` has arrived since the last sample.
        self.answered = threading.Event()
        super().__init__("axis_array", **options)

    def make_runner(self) -> ArrayRunner:
        """Return the runner of the time mode."""
        return ArrayRunner(self)

    def build(self, parameters) -> None:
        """Create the axes, and the bag."""
        rate = self._axis.plant_simulator.sample_rate
        if parameters.sample_rate != rate:
            text = f"must equal that of plant_simulator, {rate:g} Hz: give it once, under '/**'"
            raise ParameterError([Problem("sample_rate", parameters.sample_rate, text, "Hz")])
        self._each = parameters_of_each(self._axis, parameters.axes, self._values(parameters.each))
        self._make_array(parameters)
        exact = parameters.time_mode == "lockstep"
        time_of = {"sample_rate": rate, "publish_clock": exact, "real_time_factor": parameters.real_time_factor}
        self.stamps = Stamps(SimpleNamespace(**time_of))
        if parameters.path:
            self.recording = self._open_bag(parameters)

    def _values(self, path: str) -> dict[str, np.ndarray]:
        """Return the values that differ between the axes."""
        if not path:
            return {}
        try:
            return read_arrays(path)
        except (OSError, ValueError, BoundsError) as error:
            text = f"cannot be read: {error}; give an NPZ file with an array NODE.PARAMETER for each parameter"
            raise ParameterError([Problem("each", path, text)]) from None

    def _make_array(self, parameters) -> None:
        self.array = AxisArray(self._each, parameters.threads)
        self._setpoints = self.array.initial_setpoints
        self._before = np.full(parameters.axes, math.nan)
        self.sample = self.late = 0

    def _open_bag(self, parameters) -> GuardedBag:
        require_space(parameters.path, parameters.min_space)
        bag = BagWriter(parameters.path)
        bag.describe(RECORD, provenance())
        return GuardedBag(bag, TEND)

    def connect(self) -> None:
        """Create the topics."""
        count, qos = self.parameters.axes, self.qos()
        self.outputs = [self.publisher(JointState, JOINT_STATES, qos), self.publisher(Float64MultiArray, VOLTAGES, qos)]
        self._names = [publisher.topic_name for publisher in self.outputs]
        width = len(str(count - 1))
        self._joints = JointState(name=[f"{self.parameters.joint}_{i:0{width}d}" for i in range(count)])
        self._joints.effort = array("d", [one.plant_simulator.resting_effort for one in self._each])
        self._voltages = Float64MultiArray()
        self._voltages.layout.dim = [MultiArrayDimension(label="axes", size=count, stride=count)]
        self._refusals = self.publisher(String, "~/refused", setpoint_qos())
        self._end = self.publisher(UInt64, "end_of_run", latched_qos())
        heard = self.subscriber(Float64MultiArray, SETPOINTS, self._on_setpoints, setpoint_qos())
        self.setpoints_topic = heard.topic_name
        if self.recording is not None:
            topic = self.resolve_topic_name("configuration")
            self.recording.attempt(lambda bag: bag.write_string(topic, self._text, time.time_ns()))
            self._record_setpoints()

    def begin(self) -> None:
        """Start to compute samples."""
        self.timer(TEND, self._tend)
        self.runner.start_time()

    def release(self) -> None:
        """Stop the thread of the samples; finish the bag at the end of a run or at exit."""
        if self.runner is not None:
            self.runner.stop_time()
        with self.lock:
            if self.leaving or self.finished:
                self._finish_bag()

    def unbuild(self) -> None:
        """Finish the bag."""
        with self.lock:
            self._finish_bag()

    def _finish_bag(self) -> None:
        if self.recording is not None:
            self.recording.finish()

    def _tend(self) -> None:
        if self.recording is None or self.parameters is None:
            return
        with self.lock:
            self.recording.tend(self.parameters.min_space)
        if self.recording.stopped:
            self.warn("stopped", f"recording ended: {self.recording.stopped}", every=60.0, error=True)

    # -- samples -------------------------------------------------------------------------------------------------

    def compute_sample(self) -> None:
        """Compute, publish and record a sample of all axes; called with the lock held."""
        stamp = self.stamps.last = self.stamps.of(self.sample)
        voltages = self.array.step(self._setpoints)
        measured = self.array["measured"]
        joints = self._joints
        joints.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        joints.position = array("d", measured.tobytes())
        velocity = (measured - self._before) * self.parameters.sample_rate if self.sample else np.zeros(measured.size)
        joints.velocity = array("d", velocity.tobytes())
        self._before = measured
        self._voltages.data = array("d", voltages.tobytes())
        messages = (joints, self._voltages)
        for name, kind, publisher, message in zip(self._names, (_JOINTS, _ARRAY), self.outputs, messages, strict=True):
            data = serialize_message(message)  # the same bytes are published and recorded
            publisher.publish(data)
            if self.recording is not None:
                self.recording.attempt(partial(BagWriter.write, topic=name, type_name=kind, data=data, time_ns=stamp))
        self.pace.tick()
        self.sample += 1

    def _on_setpoints(self, message) -> None:
        """Take setpoints for all axes, one common setpoint, or setpoints for the axes that the label lists."""
        given = np.array(message.data, dtype=float)
        label = message.layout.dim[0].label if message.layout.dim else ""
        with self.lock:
            reason = self._take(given, label)
            self.answered.set()
        if reason:
            self.refused += 1
            text = f"setpoints refused: {reason}; all setpoints are kept"
            self.warn("setpoints", text)
            self._refusals.publish(String(data=text))

    def _take(self, given: np.ndarray, label: str) -> str:
        """Take setpoints [m]; return why they are refused, or an empty text if they are taken."""
        count = self.parameters.axes
        if label:
            words = [word.strip() for word in label.split(",")]
            if not all(word.isdecimal() and int(word) < count for word in words) or len(set(words)) != len(words):
                return f"label '{label[:80]}' is not a list of different axes 0 … {count - 1}, such as '0, 5'"
            axes = np.array(words, dtype=int)
        else:
            axes = np.arange(count)
        if given.size not in (axes.size, 1):
            return f"{given.size} numbers for {axes.size} axes; give one number for each of them, or one for all"
        wanted = np.broadcast_to(given, axes.size)
        low, high = self.array.setpoint_range[axes].T
        wrong = np.flatnonzero(~((wanted >= low) & (wanted <= high)))
        if wrong.size:
            first = wrong[0]
            allowed = f"allowed: {micrometres(low[first], high[first])}"
            return f"axis {axes[first]}: setpoint {micrometres(wanted[first])} is out of range, {allowed}"
        self._setpoints = self._setpoints.copy()
        self._setpoints[axes] = wanted
        self._record_setpoints()
        return ""

    def _record_setpoints(self) -> None:
        """Record the setpoints with the stamp of the first sample that uses them; called with the lock held."""
        if self.recording is not None:
            message = Float64MultiArray(layout=self._voltages.layout, data=array("d", self._setpoints.tobytes()))
            data, stamp = serialize_message(message), self.stamps.of(self.sample)
            self.recording.attempt(lambda bag: bag.write(self.setpoints_topic, _ARRAY, data, stamp))

    def reset_blocks(self) -> None:
        """Restart at sample 0 with all axes at rest and with the configured setpoints."""
        with self.lock:
            self._make_array(self.parameters)
            self.stamps.go_on(0)
            self._record_setpoints()

    def finish(self) -> None:
        """Publish the end of the run; called by the thread that computes the samples."""
        self.end_of_run = self.sample
        self._end.publish(UInt64(data=self.sample))
        self.get_logger().info(f"{self.sample} samples of {self.parameters.axes} axes, {self.late} of them late")
        self.leave_when_done()

    @property
    def has_lost(self) -> bool:
        """Whether the recording ended before the run."""
        return self.recording is not None and bool(self.recording.stopped)

    def health(self):
        """Report stopped and saturated axes, late samples and refused setpoints."""
        stopped = np.flatnonzero(self.array["tripped"])
        saturated = int(np.count_nonzero(self.array["saturated"]))
        values = {"axes": self.parameters.axes, "stopped_axes": stopped.size, "saturated_axes": saturated}
        values |= {"late_samples": self.late, "setpoints_refused": self.refused}
        values["recording"] = self.recording is not None and self.recording.bag is not None
        if self.has_lost and self.recording is not None:
            return ERROR, f"recording ended: {self.recording.stopped}", values
        if stopped.size:
            few = ", ".join(map(str, stopped[:5])) + (" …" if stopped.size > 5 else "")
            return ERROR, f"{stopped.size} axes are stopped ({few}): call ~/reset", values
        late, refused = self.since_report("late", self.late), self.since_report("refused", self.refused)
        if late or refused:
            return WARN, f"{late} samples late, {refused} messages on {SETPOINTS} refused", values
        return OK, "", values


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    arguments = list(sys.argv if arguments is None else arguments)
    try:
        configuration = given_configuration(arguments, "array")
        axis = AxisParameters.from_configuration(configuration)
    except HysteresisError as error:
        return refused(error)
    return run([partial(AxisArrayNode, axis, configuration.original)], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
