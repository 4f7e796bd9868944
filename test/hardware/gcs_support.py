# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An emulated controller without a link, with a clock controlled by the test."""

from __future__ import annotations

from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, assumed_stage
from hysteresis_ros.laboratory.emulation.gcs import Session
from hysteresis_ros.laboratory.emulation.gcs_controller import MODELS, Controller

CYCLE = 5.0e-4


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
