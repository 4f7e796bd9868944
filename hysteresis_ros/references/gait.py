# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gait of an inchworm motor: the six processes of a cycle (K10) as durations, clamp voltages and strokes.

The rear clamp sits on the body, the front clamp on the tip of the extender, and a slider runs through both. With the
front clamp closed and the rear one open the slider is *carried*: it follows the extender. With the rear clamp closed
and the front one open it stands, and the extender *returns*. One cycle is

    release rear, carry, grip rear, release front, return, grip front

where carry extends and return contracts when the slider moves forward, and the other way round backward. Extension
profiles are cycloidal, e(s) = s − sin(2 π s)/(2 π): velocity and acceleration are zero at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros import elementary
from hysteresis_ros.block import kernel
from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import Parameters, parameter


@kernel
def cycloid(s):
    """Return the cycloidal profile, 0 at s ≤ 0 and 1 at s ≥ 1."""
    if s <= 0.0:
        return 0.0
    if s >= 1.0:
        return 1.0
    return s - elementary.sin(2.0 * math.pi * s) / (2.0 * math.pi)


@kernel
def ramp(linear, s):
    """Return the profile of a clamp's voltage: straight when ``linear`` is not 0, else cycloidal."""
    if linear != 0.0:
        return min(max(s, 0.0), 1.0)
    return cycloid(s)


def crossing(linear: bool, level: float) -> float:
    """Return the part of a ramp's duration after which its profile passes ``level`` (0 … 1)."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ramp(float(linear), middle) < level else (low, middle)
    return 0.5 * (low + high)


def _duration(default: float, description: str):
    return parameter(default, unit="s", low=1.0e-6, high=100.0, read_only=True, description=description)


@dataclass(frozen=True)
class GaitParameters(Parameters):
    """Durations, voltages and strokes of the gait."""

    release: float = _duration(3.0e-3, "duration of the ramp that opens a clamp")
    grip: float = _duration(3.0e-3, "duration of the ramp that closes a clamp")
    extend: float = _duration(6.0e-3, "duration of the extender's motion to larger displacement")
    contract: float = _duration(6.0e-3, "duration of the extender's motion to smaller displacement")
    settle: float = parameter(
        1.0e-3, unit="s", low=0.0, high=100.0, read_only=True, description="rest of the extender before a clamp closes"
    )
    overlap: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time for which one clamp already opens while the other still closes",
    )
    clamp_ramp: str = parameter(
        "cycloidal", choices=("cycloidal", "linear"), read_only=True, description="shape of the clamps' voltage ramps"
    )
    grip_voltage: float = parameter(
        100.0, unit="V", low=-1.0e4, high=1.0e4, read_only=True, description="voltage of a closed clamp"
    )
    release_voltage: float = parameter(
        0.0, unit="V", low=-1.0e4, high=1.0e4, read_only=True, description="voltage of an open clamp"
    )
    initial_voltage: float = parameter(
        0.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage of both clamps before the start: that at which they stand",
    )
    threshold_voltage: float = parameter(
        50.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage above which a clamp counts as closed; the two clamps are never both below it",
    )
    clamp_settling: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time in which a clamp's force follows its voltage; no ramp may be shorter",
    )
    lowest_extension: float = parameter(
        1.0e-6, unit="m", read_only=True, description="extension at one end of a full step"
    )
    highest_extension: float = parameter(
        9.0e-6, unit="m", read_only=True, description="extension at the other end of a full step"
    )
    fine_margin: float = parameter(
        0.5e-6,
        unit="m",
        low=0.0,
        read_only=True,
        description="how far fine positioning may go beyond either end before the extender is re-centred",
    )
    fine_window: float = parameter(
        1.0e-6,
        unit="m",
        low=1.0e-9,
        read_only=True,
        description="fine positioning begins this near to the middle of the range; the extender is re-centred for it",
    )
    walking_speed: float = parameter(
        0.0,
        unit="m/s",
        read_only=True,
        description="continuous walking from the start, negative backward; 0: walk to setpoints",
    )

    @property
    def stroke(self) -> float:
        """Extension of a full step [m]."""
        return self.highest_extension - self.lowest_extension

    @property
    def period(self) -> float:
        """Duration of one cycle [s]."""
        clamps = 2.0 * (self.release + self.grip - self.overlap)
        return clamps + self.extend + self.contract + 2.0 * self.settle

    @property
    def frequency(self) -> float:
        """Cycles per second [Hz]."""
        return 1.0 / self.period

    @property
    def speed(self) -> float:
        """Speed of full steps without slip [m/s]: stroke times frequency."""
        return self.stroke / self.period

    @property
    def closed_margin(self) -> float:
        """Time for which both clamps are above the threshold voltage at an exchange [s]."""
        span = self.grip_voltage - self.release_voltage
        level = (self.threshold_voltage - self.release_voltage) / span
        linear = self.clamp_ramp == "linear"
        closed = self.grip * crossing(linear, level)
        opens = self.grip - self.overlap + self.release * crossing(linear, 1.0 - level)
        return opens - closed

    def refuse_speed(self, speed: float) -> str | None:
        """Say why the gait cannot walk at ``speed`` [m/s], with the number; None when it can."""
        if math.isfinite(speed) and abs(speed) <= self.speed * (1.0 + 1e-9):
            return None
        return (
            f"speed {speed:g} m/s refused: the gait reaches {self.speed:g} m/s ({self.stroke:g} m at "
            f"{self.frequency:g} Hz); shorten its durations or walk slower"
        )

    def check(self):
        """Yield what does not fit together: voltages, durations, strokes, overlap and speed."""
        low, level, high = self.release_voltage, self.threshold_voltage, self.grip_voltage
        if not low < high:
            yield Problem("grip_voltage", high, f"must be above release_voltage = {low:g} V")
            return
        if not low < level < high:
            yield Problem("threshold_voltage", level, f"must lie between {low:g} and {high:g} V (release and grip)")
            return
        if not low <= self.initial_voltage <= high:
            yield Problem("initial_voltage", self.initial_voltage, f"must lie within {low:g} … {high:g} V")
        for name in ("release", "grip"):
            value = getattr(self, name)
            if value < self.clamp_settling:
                allowed = f"shorter than the clamp's settling: must be ≥ clamp_settling = {self.clamp_settling:g} s"
                yield Problem(name, value, allowed)
        if not self.overlap < min(self.release, self.grip):
            yield Problem("overlap", self.overlap, f"must be below {min(self.release, self.grip):g} s (either ramp)")
        elif self.closed_margin < self.clamp_settling:
            allowed = (
                f"leaves both clamps closed for {self.closed_margin:g} s only: must be at least clamp_settling = "
                f"{self.clamp_settling:g} s, or both would be open for a moment; reduce the overlap"
            )
            yield Problem("overlap", self.overlap, allowed)
        if not self.lowest_extension < self.highest_extension:
            allowed = f"must be above lowest_extension = {self.lowest_extension:g} m"
            yield Problem("highest_extension", self.highest_extension, allowed)
        elif refused := self.refuse_speed(self.walking_speed):
            yield Problem("walking_speed", self.walking_speed, refused)
