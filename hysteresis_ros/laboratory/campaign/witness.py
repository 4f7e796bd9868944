# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Additional nodes for the axis under test: one observes and publishes setpoints, one disturbs measurements."""

from __future__ import annotations

import contextlib
import copy
import math
import threading
import time
from collections import deque
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from hysteresis_ros.loop.plant import DEVICE_FAILED
from hysteresis_ros.nodes.spin import make_executor

#: Time-out of a service call [s].
PATIENCE = 10.0
#: Time after which a call that may have come too early is repeated [s].
BRIEF = 0.5
#: Polling interval [s].
LOOK = 0.01
#: Queue depth of the observer; large, because the machine may be busy.
DEPTH = 5000


class Witness:
    """The observer, which runs in a separate thread until it is closed."""

    def __init__(self, namespace: str):
        self.namespace = namespace
        self.node = rclpy.create_node(
            "witness", namespace=namespace, start_parameter_services=False, enable_rosout=False
        )
        self.rows: list[tuple[float, ...]] = []
        self.said: list[tuple[float, int, str]] = []
        self.life = 0
        self.tripped = 0.0
        self._counted = (0.0, 0)
        self._names: list[str] = []
        self._clients: dict[str, Any] = {}
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH)
        self.node.create_subscription(JointState, "plant_simulator/state", self._on_plant, qos)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos)
        self.setpoints = self.node.create_publisher(Float64, "setpoint", 10)
        self.executor = make_executor()
        self.executor.add_node(self.node)
        self._leaving = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="witness", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._leaving.is_set():
            with contextlib.suppress(rclpy.executors.ExternalShutdownException):
                self.executor.spin_once(timeout_sec=0.05)

    def _on_plant(self, message) -> None:
        if message.name != self._names:
            self._names = list(message.name)
            place = "displacement" if "displacement" in self._names else "measured"  # unknown for a device
            self._places = [self._names.index(name) for name in ("voltage", place, "tripped")]
        voltage, displacement, tripped = (message.position[place] for place in self._places)
        if tripped == DEVICE_FAILED != self.tripped:
            self.life += 1  # like a restart: the output of a device that does not answer is unknown
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.rows.append((time.time(), stamp, voltage, displacement, self.life))
        self.tripped = tripped

    def _on_diagnostics(self, message) -> None:
        for status in message.status:
            if status.name.startswith(f"{self.namespace}/"):
                level, node = int.from_bytes(status.level, "big"), status.name.split("/")[-1].split(":")[0]
                self.said.append((time.time(), level, f"{node}: {status.message}"))
                # a node has no samples before its start and after its end
                for value in status.values if node == "plant_simulator" else ():
                    if value.key == "samples":
                        self._counted = time.time(), int(value.value)

    # -- waiting and calling ----------------------------------------------------------------------------------------

    def until(self, condition, seconds: float = PATIENCE) -> bool:
        """Wait until a condition holds; return False after a time-out [s]."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._leaving.wait(LOOK)
        return True

    def sample(self, rate: float) -> float:
        """Return the current sample number of an axis in real time, extrapolated from the plant's last diagnostics."""
        when, count = self._counted
        return count + rate * (time.time() - when) if count else 0.0

    @property
    def displacement(self) -> float:
        """Last observed displacement [m]; NaN before the first observation."""
        return self.rows[-1][3] if self.rows else math.nan

    def ask(self, setpoint: float) -> None:
        """Publish a setpoint.

        Units: ``setpoint`` [m].
        """
        self.setpoints.publish(Float64(data=setpoint))

    def call(self, kind, service: str, request=None, seconds: float = PATIENCE):
        """Return the answer of a service of the axis; None after a time-out."""
        name = f"{self.namespace}/{service}"
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
        if not self.until(client.service_is_ready, seconds):
            return None
        future = client.call_async(request or kind.Request())
        return future.result() if self.until(future.done, seconds) else None

    def trigger(self, node: str, action: str) -> bool:
        """Call a service without arguments; return whether there was any answer."""
        return self.call(Trigger, f"{node}/{action}") is not None

    def transition(self, node: str, number: int) -> bool:
        """Request a transition of the lifecycle; return whether there was any answer."""
        request = ChangeState.Request()
        request.transition.id = number
        return self.call(ChangeState, f"{node}/change_state", request) is not None

    def is_active(self, node: str) -> bool:
        """Return whether a node is active."""
        # a killed node stays in the graph for some time and does not answer
        answer = self.call(GetState, f"{node}/get_state", seconds=BRIEF)
        return answer is not None and answer.current_state.id == State.PRIMARY_STATE_ACTIVE

    def gravest(self, since: float) -> str:
        """Return the most severe diagnostic message since a time [s]; empty if there was no problem."""
        found = [(level, text) for when, level, text in list(self.said) if when >= since and level]
        return max(found, key=lambda entry: entry[0])[1] if found else ""

    def close(self) -> None:
        """Leave the graph."""
        self._leaving.set()
        self._thread.join()
        self.executor.remove_node(self.node)
        self.node.destroy_node()


#: Topic from which the relay receives the plant's measurements, and the remapping of the plant.
SOURCE = "joint_states_of_plant"
REMAP = (f"plant_simulator:joint_states:={SOURCE}",)
#: Number of measurements per spike.
SPIKE_EVERY = 10
#: Joint in the messages of another device.
FOREIGN = "gripper"


class Relay:
    """Forwards ``joint_states``, with the modification that :meth:`set` selects.

    Units: ``stroke`` [m].
    """

    def __init__(self, witness: Witness, stroke: float, random):
        self._stroke, self._random = stroke, random
        self._count = 0
        self._kept: JointState | None = None
        self._late: deque[tuple[float, JointState]] = deque()
        self._publisher = witness.node.create_publisher(JointState, "joint_states", DEPTH)
        witness.node.create_subscription(JointState, SOURCE, self._pass, DEPTH)
        self._leaving = threading.Event()
        self._thread = threading.Thread(target=self._deliver, name="relay", daemon=True)
        self._thread.start()
        self.set("")

    def set(self, change: str, amount: float = 0.0) -> None:
        """Select the modification of the measurements; empty: no modification."""
        self._kept = None
        self._do = getattr(self, f"_{change}") if change else self._publisher.publish
        self.amount = amount

    def _pass(self, message: JointState) -> None:
        self._count += 1
        self._do(message)

    def _deliver(self) -> None:
        """Publish delayed messages when they are due."""
        while not self._leaving.wait(5e-4):
            while self._late and self._late[0][0] <= time.monotonic():
                self._publisher.publish(self._late.popleft()[1])

    def close(self) -> None:
        """End the thread."""
        self._leaving.set()
        self._thread.join()

    # -- modifications ---------------------------------------------------------------------------------------------

    def _stopped(self, message: JointState) -> None:
        """Forward no messages."""

    def _frozen(self, message: JointState) -> None:
        self._kept = self._kept or copy.deepcopy(message)
        message.position = self._kept.position
        self._publisher.publish(message)

    def _nan(self, message: JointState) -> None:
        message.position = [math.nan] * len(message.position)
        self._publisher.publish(message)

    def _spikes(self, message: JointState) -> None:
        if self._count % SPIKE_EVERY == 0:
            message.position = [place + self.amount * self._stroke for place in message.position]
        self._publisher.publish(message)

    def _disordered(self, message: JointState) -> None:
        if self._kept is None:
            self._kept = copy.deepcopy(message)
            return
        self._publisher.publish(message)
        self._publisher.publish(self._kept)
        self._kept = None

    def _duplicated(self, message: JointState) -> None:
        self._publisher.publish(message)
        self._publisher.publish(message)

    def _delayed(self, message: JointState) -> None:
        self._late.append((time.monotonic() + self.amount, copy.deepcopy(message)))

    def _dropped(self, message: JointState) -> None:
        if self._random.random() >= self.amount:
            self._publisher.publish(message)

    def _partial(self, message: JointState) -> None:
        message.position = []
        self._publisher.publish(message)

    def _foreign(self, message: JointState) -> None:
        self._publisher.publish(message)
        message.name, message.position, message.velocity, message.effort = [FOREIGN], [0.5], [], []
        self._publisher.publish(message)

    def _stamped(self, message: JointState) -> None:
        message.header.stamp.sec += int(self.amount)
        self._publisher.publish(message)
