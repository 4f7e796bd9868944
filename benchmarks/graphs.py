# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The four nodes in lockstep, and a relay of the same graph that computes nothing; started by bench_lockstep.py.

The relay has the same topics, messages, quality of service and executor, reuses its messages as the nodes do, and
forwards what it receives. It performs no checks and does not monitor its partners, so its time is that of the messages.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from array import array

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, UInt64

from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_runners import LockstepPlant
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
from hysteresis_ros.nodes.qos import latched_qos, loop_qos
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.spin import run

try:
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:  # as the nodes do
    from rclpy.executors import SingleThreadedExecutor as Executor


class Turns:
    """Lets the two graphs run in turns of some samples, and measures the time of each turn.

    Other work of the machine, even if it changes, then affects both graphs equally.

    Parameters
    ----------
    samples : int
        Number of samples per turn.
    """

    def __init__(self, samples: int):
        self.samples = samples
        self.seconds: dict[str, list[float]] = {"nodes": [], "relay": []}
        self.whose = "nodes"
        self._start = None

    def may(self, graph: str, sample: int) -> bool:
        """Return whether ``graph`` may publish ``sample``."""
        if self.whose != graph:
            return False
        if self._start is None:
            self._start = time.perf_counter()
        elif sample == self.samples * (len(self.seconds[graph]) + 1):
            self.seconds[graph].append(time.perf_counter() - self._start)
            self._start = None
            self.whose = "relay" if graph == "nodes" else "nodes"
            return False
        return True


class TimedRunner(LockstepPlant):
    """Advances the plant only in its turn."""

    turns: Turns

    def advance(self) -> None:
        """Publish the current sample, if it is this graph's turn; the end of the run is published in any turn."""
        node = self.node
        if self.turns.may("nodes", node.sample) or node.sample == node.parameters.samples:
            super().advance()


class TimedPlant(PlantSimulatorNode):
    """The plant, which advances only in its turn."""

    def make_runner(self) -> TimedRunner:
        """Return the runner that decides when the plant advances."""
        return TimedRunner(self)


class Relay(Node):
    """One node of the relay.

    Parameters
    ----------
    name : str
        Node name.
    signals : int
        Number of signals in ``~/state``.
    """

    def __init__(self, name: str, signals: int, **options):
        super().__init__(name, **options)
        self.ended = False
        self.qos = loop_qos(True, 1000)
        self.state = JointState(name=[f"signal{i}" for i in range(signals)], position=array("d", [0.0] * signals))
        self.signals = range(signals)
        self.state_publisher = self.create_publisher(JointState, "~/state", self.qos)
        self.number = Float64()

    def listen(self, message_type, topic: str, callback) -> None:
        """Subscribe to a topic as the nodes do."""
        self.create_subscription(message_type, topic, callback, self.qos)

    def listen_end(self) -> None:
        """Exit when the plant publishes the end of the run."""
        self.create_subscription(UInt64, "end_of_run", self.on_end, latched_qos())

    def talk(self, topic: str):
        """Return a publisher of numbers like that of the nodes."""
        return self.create_publisher(Float64, topic, self.qos)

    def publish_state(self, value: float) -> None:
        """Fill and publish ``~/state``."""
        position = self.state.position
        for index in self.signals:
            position[index] = value
        self.state_publisher.publish(self.state)

    def on_end(self, message) -> None:
        """Leave."""
        self.ended = True

    def on_sample(self, message) -> None:
        """Keep the stamp of the sample."""
        self.state.header.stamp = message.header.stamp

    def ignore(self, message) -> None:
        """Receive a message that the nodes also receive."""


class RelayPlant(Relay):
    """``voltage`` → ``joint_states``."""

    turns: Turns
    samples: int

    def __init__(self, **options):
        super().__init__("plant_simulator", 6, **options)
        self.sample = 0
        self.message = JointState(
            name=["joint"], position=array("d", [0.0]), velocity=array("d", [0.0]), effort=array("d", [0.0])
        )
        self.joint_states = self.create_publisher(JointState, "joint_states", self.qos)
        self.end = self.create_publisher(UInt64, "end_of_run", latched_qos())
        self.listen(Float64, "voltage", self.on_voltage)
        self.create_timer(0.01, self.begin)
        self.waiting = True

    def begin(self) -> None:
        """Publish the current sample if the relay waits for its turn and the three readers are present."""
        if self.waiting and not self.ended and self.joint_states.get_subscription_count() == 3:
            self.advance()

    def advance(self) -> None:
        """Publish the current sample, if it is this graph's turn."""
        self.waiting = not self.turns.may("relay", self.sample)
        if not self.waiting:
            self.joint_states.publish(self.message)

    def on_voltage(self, message) -> None:
        """Publish the state, then the next sample."""
        stamp = self.message.header.stamp
        self.state.header.stamp = stamp
        self.publish_state(message.data)
        self.sample += 1
        now = self.sample * 1_000_000_000 // 3000
        stamp.sec, stamp.nanosec = now // 1_000_000_000, now % 1_000_000_000
        self.message.position[0] = message.data
        self.advance()
        if self.sample == self.samples:
            self.end.publish(UInt64(data=self.samples))
            self.ended = True


class RelayReference(Relay):
    """``joint_states`` → ``reference``."""

    def __init__(self, **options):
        super().__init__("reference_generator", 3, **options)
        self.output = self.talk("reference")
        self.listen(JointState, "joint_states", self.on_sample)
        self.listen_end()

    def on_sample(self, message) -> None:
        """Publish the reference for a sample."""
        super().on_sample(message)
        self.number.data = message.position[0]
        self.output.publish(self.number)
        self.publish_state(self.number.data)


class RelayController(Relay):
    """``reference`` → ``command``."""

    def __init__(self, **options):
        super().__init__("motion_controller", 7, **options)
        self.output = self.talk("command")
        self.listen(JointState, "joint_states", self.on_sample)
        self.listen(Float64, "applied", self.ignore)
        self.listen(Float64, "reference", self.on_reference)
        self.listen_end()

    def on_reference(self, message) -> None:
        """Publish the reference as command."""
        self.number.data = message.data
        self.output.publish(self.number)
        self.publish_state(message.data)


class RelayCompensator(Relay):
    """``command`` → ``voltage`` and ``applied``."""

    def __init__(self, **options):
        super().__init__("hysteresis_compensator", 5, **options)
        self.output = self.talk("voltage")
        self.applied = self.talk("applied")
        self.listen(JointState, "joint_states", self.on_sample)
        self.listen(Float64, "command", self.on_command)
        self.listen_end()

    def on_command(self, message) -> None:
        """Publish the command as voltage."""
        self.number.data = message.data
        self.output.publish(self.number)
        self.applied.publish(self.number)
        self.publish_state(message.data)


#: Node name: the class of the node, and that of its counterpart in the relay.
PARTS = {
    "plant_simulator": (TimedPlant, RelayPlant),
    "hysteresis_compensator": (HysteresisCompensatorNode, RelayCompensator),
    "motion_controller": (MotionControllerNode, RelayController),
    "reference_generator": (ReferenceGeneratorNode, RelayReference),
}


def relay(parts, arguments) -> None:
    """Run nodes of the relay until the end of the run, with the same loop as the nodes."""
    context = Context()
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    executor = Executor(context=context)
    nodes = [part(context=context) for part in parts]
    for node in nodes:
        executor.add_node(node)
    while not all(node.ended for node in nodes):
        executor.spin_once(timeout_sec=0.05)
    for node in nodes:
        if isinstance(node, RelayPlant):
            node.end.wait_for_all_acked(Duration(seconds=5.0))
        executor.remove_node(node)
        node.destroy_node()
    rclpy.shutdown(context=context)


def main() -> int:
    """Run one process with its nodes of both graphs; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("node", choices=("all", *PARTS))
    parser.add_argument("parameters", help="parameter file of the nodes")
    parser.add_argument("namespace")
    parser.add_argument("turns", type=int)
    parser.add_argument("samples", type=int, help="number of samples per turn")
    options = parser.parse_args()
    parts = list(PARTS.values()) if options.node == "all" else [PARTS[options.node]]
    TimedRunner.turns = RelayPlant.turns = turns = Turns(options.samples)
    RelayPlant.samples = options.turns * options.samples

    def ros(graph):
        return ["benchmark", "--ros-args", "--log-level", "warn", "-r", f"__ns:={options.namespace}/{graph}"]

    # a separate thread, which sleeps during the turns of the nodes; the nodes sleep during its turns
    bare = threading.Thread(target=relay, args=([stand_in for _, stand_in in parts], ros("relay")), daemon=True)
    bare.start()
    code = run([node for node, _ in parts], [*ros("nodes"), "--params-file", options.parameters])
    if code == 0:
        bare.join(60.0)
        if turns.seconds["relay"]:
            print(json.dumps(turns.seconds), flush=True)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
