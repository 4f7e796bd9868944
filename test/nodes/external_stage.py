# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage with its own clock, like a node of another package: subscribes to ``voltage``, publishes ``joint_states``."""

import sys
import threading
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

RATE = float(sys.argv[1])
#: The highest output voltage [V] of its amplifier; if it is given, the stage reports its output voltage.
HIGHEST = float(sys.argv[2]) if len(sys.argv) > 2 else None


class Stage(Node):
    """0.1 µm/V, half of it through a play of ±5 V, then a lag of 3 samples."""

    def __init__(self):
        super().__init__("somebody_elses_stage")
        self.voltage = self.play = self.position = 0.0
        self.gone = threading.Event()
        self.samples = self.create_publisher(JointState, "joint_states", 100)
        self.states = self.create_publisher(JointState, "plant_simulator/state", 100) if HIGHEST is not None else None
        self.create_subscription(Float64, "voltage", self.hear, 10)
        self.thread = threading.Thread(target=self.measure)
        self.thread.start()

    def hear(self, message):
        """Hold a voltage."""
        self.voltage = message.data if HIGHEST is None else min(message.data, HIGHEST)

    def measure(self):
        """Publish the position at each sample."""
        message = JointState(name=["extender"], position=[0.0])
        deadline = time.monotonic()
        while not self.gone.is_set():
            self.play = min(max(self.play, self.voltage - 5.0), self.voltage + 5.0)
            self.position += (0.5e-7 * (self.voltage + self.play) - self.position) / 3.0
            message.position[0] = self.position
            message.header.stamp = self.get_clock().now().to_msg()
            self.samples.publish(message)
            measured = message.header.stamp
            deadline += 1.0 / RATE
            # the clock of the device, which keeps its own time
            self.gone.wait(max(deadline - time.monotonic(), 0.0))
            if self.states is not None:  # its output until the next sample
                state = JointState(name=["voltage"], position=[self.voltage])
                state.header.stamp = measured
                self.states.publish(state)


rclpy.init()
stage = Stage()
try:
    rclpy.spin(stage)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
finally:
    stage.gone.set()
    stage.thread.join()
