# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Emulated GCS controllers for tests: at a port with the driver's parameters, or without a link, in the test's time."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.drivers.gcs import GcsParameters
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, assumed_stage
from hysteresis_ros.laboratory.emulation.gcs import Session
from hysteresis_ros.laboratory.emulation.gcs_controller import MODELS, Controller
from hysteresis_ros.laboratory.emulation.server import serving

RATE, CYCLE = 100.0, 5.0e-4


class Stand:
    """An emulated controller at a port, with its driver's parameters."""

    def __init__(self, model: str):
        self.faults = DeviceFaults(time.monotonic)
        self.controller = Controller(MODELS[model], assumed_stage(CYCLE), CYCLE, self.faults)
        self.heard: list[str] = []
        self.port = 0
        self.deaf = False

    def given(self, **changes) -> GcsParameters:
        return GcsParameters(**{"port": self.port, "safe_time": 0.02, "timeout": 2.0, "check_period": 0.01} | changes)

    def open(self, **changes) -> Device:
        return Device(DRIVERS["gcs"], self.given(**changes).validated(), RATE)

    def say(self, text: str) -> None:
        """Execute a command, as if given at the controller."""
        Session(self.controller).feed(text.encode() + b"\n")

    def number_readings(self) -> None:
        """Give each answer to POS? a different number, so that a reading shows which answer it is."""
        axis, self._numbers = self.controller.axes["1"], iter(range(1, 10**6))
        self._told: list[float] = [0.0]

        class Plant:
            """The plant, whose measurement increases with each reading."""

            @property
            def measured(_):
                self._told.append(1.0e-9 * next(self._numbers))
                return self._told[-1]

            def __getattr__(_, name):
                return getattr(plant, name)

        plant, axis.plant = axis.plant, Plant()

    def places(self) -> list[float]:
        """Return all readings of the sensor so far, the last one last [m]."""
        return list(self._told)

    def session(self) -> Session:
        """Return a session that stores what it receives."""
        session = Session(self.controller)
        answer = session.answer

        def heard(line: str) -> list[str]:
            self.heard.append(line)
            return [] if self.deaf and line.startswith("SVA ") else answer(line)

        session.answer = heard
        return session


@contextlib.contextmanager
def serving_stand(model: str = "E-754") -> Iterator[Stand]:
    """Serve an emulated controller at a free port."""
    stand = Stand(model)
    with serving(("127.0.0.1", 0), stand.session, stand.controller.tick, stand.faults) as server:
        stand.port = server.port
        yield stand


class Bench:
    """A controller, the session of a master, and a clock controlled by the test."""

    def __init__(self, model: str = "E-754"):
        self.now = 0.0
        self.faults = DeviceFaults(self.clock)
        self.controller = Controller(MODELS[model], assumed_stage(CYCLE), CYCLE, self.faults, self.clock)
        self.session = Session(self.controller)

    def clock(self) -> float:
        return self.now

    def raw(self, data: bytes) -> str:
        return self.session.feed(data).decode("latin-1")

    def ask(self, text: str) -> str:
        """Send lines; return the answers."""
        return self.raw(text.encode() + b"\n").removesuffix("\n")

    def number(self, text: str) -> float:
        return float(self.ask(text).partition("=")[2])

    def error(self) -> int:
        return int(self.ask("ERR?"))

    def wait(self, duration: float) -> None:
        self.now += duration
        self.controller.tick()
