# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A relay between the plant and the others: what it does to measurements is what sensors, drivers and networks do."""

from __future__ import annotations

import copy
import math
import threading
import time
from collections import deque

from sensor_msgs.msg import JointState

from hysteresis_ros.nodes.campaign.witness import DEPTH, Witness

#: Topic on which the plant publishes what the relay passes on, and how the plant is told.
SOURCE = "joint_states_of_plant"
REMAP = (f"plant_simulator:joint_states:={SOURCE}",)
#: One measurement in so many is a spike.
SPIKE_EVERY = 10
#: Joint of somebody else's message.
FOREIGN = "gripper"


class Relay:
    """Passes ``joint_states`` on, changed by whatever :attr:`change` is.

    Parameters
    ----------
    witness : Witness
        In whose node and thread it works.
    stroke : float
        Of the axis [m].
    random : numpy.random.Generator

    Attributes
    ----------
    change : str
        Name of what is done to the messages; empty: nothing.
    amount : float
        Of it.
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
        """Do something else from now on.

        Parameters
        ----------
        change : str
        amount : float
        """
        self._kept = None
        self._do = getattr(self, f"_{change}") if change else self._publisher.publish
        self.amount = amount

    def _pass(self, message: JointState) -> None:
        self._count += 1
        self._do(message)

    def _deliver(self) -> None:
        """Publish what is late when its time has come."""
        while not self._leaving.wait(5e-4):
            while self._late and self._late[0][0] <= time.monotonic():
                self._publisher.publish(self._late.popleft()[1])

    def close(self) -> None:
        """End the thread."""
        self._leaving.set()
        self._thread.join()

    # -- what can be done ------------------------------------------------------------------------------------------

    def _stopped(self, message: JointState) -> None:
        """None is passed on."""

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
