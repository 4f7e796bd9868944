# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A driver in place of the plant: replace read_sensor and write_amplifier by those of your card and keep the rest."""

from __future__ import annotations

import math
import threading
import time
from array import array

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

RATE = 500.0  # samples per second [Hz]
LIMITS = (-30.0, 120.0)  # hard limits of the amplifier [V]
WATCHDOG = 0.5  # time without a voltage after which it goes to the safe voltage [s]
SAFE_VOLTAGE = 0.0


class Bench:
    """Placeholder for amplifier and sensor: 0.1 µm/V with a lag of 5 ms. Your version accesses a card."""

    def __init__(self):
        self.displacement = 0.0
        self.voltage = 0.0

    def read_sensor(self) -> float:
        """Return the displacement [m]."""
        self.displacement += (1.0e-7 * self.voltage - self.displacement) / (0.005 * RATE)
        return self.displacement

    def write_amplifier(self, voltage: float) -> None:
        """Output a voltage [V]."""
        self.voltage = voltage


class Driver(Node):
    """Reads the sensor and outputs the voltage, at its own rate."""

    def __init__(self):
        super().__init__("driver")
        self.bench = Bench()
        self.voltage = SAFE_VOLTAGE
        self.received = time.monotonic()
        self.stop = threading.Event()
        self.samples = self.create_publisher(JointState, "joint_states", QoSProfile(depth=100))
        self.create_subscription(Float64, "voltage", self.on_voltage, QoSProfile(depth=10))
        self.thread = threading.Thread(target=self.keep_time)
        self.thread.start()

    def on_voltage(self, message: Float64) -> None:
        """Store a voltage [V] for the next sample; a value that is not a number keeps the last one."""
        if not math.isfinite(message.data):
            return
        self.voltage = min(max(message.data, LIMITS[0]), LIMITS[1])
        self.received = time.monotonic()

    def keep_time(self) -> None:
        """Sample with absolute deadlines, in a separate thread, because an executor's timer would drop periods."""
        message = JointState(name=["extender"], position=array("d", [0.0]))
        deadline = time.monotonic()
        while not self.stop.is_set():
            message.position[0] = self.bench.read_sensor()
            message.header.stamp = self.get_clock().now().to_msg()
            self.samples.publish(message)
            silent = time.monotonic() - self.received > WATCHDOG
            self.bench.write_amplifier(SAFE_VOLTAGE if silent else self.voltage)
            deadline += 1.0 / RATE
            self.stop.wait(max(deadline - time.monotonic(), 0.0))
        self.bench.write_amplifier(SAFE_VOLTAGE)


def main() -> None:
    """Run the driver until Ctrl-C."""
    rclpy.init()
    driver = Driver()
    try:
        rclpy.spin(driver)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        driver.stop.set()
        driver.thread.join()
        driver.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
