# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inside of an emulated device: a plant with its own clock, an amplifier, a servo, and faults.

Faults are written like the faults of an axis, ``NAME:START:DURATION[:VALUE]``. Times are in seconds of the device's own
clock, counted from the start of the device or from the addition of the fault. The value of a fault of single lines is
the number of affected lines: the first ones sent during the fault.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.linear import zero_order_hold


class Kind(NamedTuple):
    """A kind of fault of a device."""

    description: str
    #: Default of the value; None: the fault has no value.
    value: float | None = None
    unit: str = ""


FAULTS = {
    "busy": Kind("commands are refused as busy"),
    "error": Kind("commands are refused with the device's error whose code is the value", 1.0, "code"),
    "slow": Kind("each answer is delayed by the value", 0.2, "s"),
    "silent": Kind("there is no answer"),
    "cut": Kind("the link is cut and refuses connections"),
    "repeat": Kind("a line of an answer is repeated", 1.0, "lines"),
    "stale": Kind("the previous line is repeated before the answer", 1.0, "lines"),
    "echo": Kind("the whole previous answer is repeated before the answer", 1.0, "answers"),
    "drop": Kind("a line of an answer is missing", 1.0, "lines"),
    "garbage": Kind("random bytes replace a line", 1.0, "lines"),
    "half": Kind("only half a line is sent, without its end", 1.0, "lines"),
    "close": Kind("only half a line is sent, then the link is closed; new connections are possible", 1.0, "lines"),
}
#: Faults of single lines.
OF_LINES = ("repeat", "stale", "echo", "drop", "garbage", "half", "close")
#: Bytes that replace a line, including the line end.
GARBAGE = b"\xff\x00=\xb5 1e9\n"


class DeviceFaults:
    """The faults of a device with their times.

    Units: ``clock`` [s].
    """

    def __init__(self, clock: Callable[[], float], texts: Iterable[str] = ()):
        self._clock = clock
        self._entries: list[tuple[str, float, float, float]] = []
        self._lines: dict[tuple, int] = {}
        for text in texts:
            self.add(text)

    def add(self, text: str) -> None:
        """Add a fault with times that count from now; ``none`` ends all faults."""
        if text == "none":
            self._entries = []
            return
        name, *numbers = text.split(":")
        if name not in FAULTS:
            near = did_you_mean(name, FAULTS) or f"; there are {', '.join(FAULTS)}"
            raise ConfigurationError(f"fault '{text}': a device has no fault '{name}'{near}")
        kind = FAULTS[name]
        try:
            start, duration, *rest = map(float, numbers)
            sound = all(map(math.isfinite, (start, duration, *rest))) and start >= 0.0 < duration
        except ValueError:
            sound = False
        if not sound or len(rest) > (kind.value is not None) or min(rest, default=0.0) < 0.0:
            form = f"{name}:START:DURATION" + ("" if kind.value is None else f"[:VALUE in {kind.unit}]")
            raise ConfigurationError(f"fault '{text}': write {form}, times in seconds, START ≥ 0 and DURATION > 0")
        begin = self._clock() + start
        self._entries.append((name, begin, begin + duration, rest[0] if rest else kind.value or 0.0))

    def value(self, name: str) -> float | None:
        """Return the value of an active fault (0 if the fault has no value); None if the fault is not active."""
        now = self._clock()
        return next((value for kind, begin, end, value in self._entries if kind == name and begin <= now < end), None)

    def take_line(self) -> str:
        """Return the name of the fault for the next line, and count the line; empty if no fault is active."""
        now = self._clock()
        for entry in self._entries:
            name, begin, end, value = entry
            if name in OF_LINES and begin <= now < end and self._lines.get(entry, 0) < value:
                self._lines[entry] = self._lines.get(entry, 0) + 1
                return name
        return ""

    def __contains__(self, name: str) -> bool:
        return self.value(name) is not None


class Garbler:
    """Applies the faults of single lines to the answers of a device."""

    def __init__(self, faults: DeviceFaults):
        self._faults, self.closed = faults, False
        self._last = self._answer = b""

    def garble(self, answer: bytes) -> bytes:
        """Return the bytes to send instead of an answer."""
        sent = []
        for line in answer.splitlines(keepends=True):
            happens = self._faults.take_line()
            half = line[: len(line) // 2]
            sent.append(
                {
                    "repeat": line + line,
                    "stale": self._last + line,
                    "echo": self._answer + line,
                    "drop": b"",
                    "garbage": GARBAGE,
                    "half": half,
                    "close": half,
                }.get(happens, line)
            )
            self._last = line
            self.closed = happens == "close"
            if self.closed:
                break
        self._answer = answer
        return b"".join(sent)


#: Longest backlog that a device computes [s]; it skips the rest, for example after the machine was suspended.
LONGEST_CATCH_UP = 5.0

#: Assumed weights of the hysteresis of the default stage of an emulated device [m/V]: 0.8 µm/V, and a loop width of
#: about 12 % of the stroke.
WEIGHTS = (0.6e-6, 0.07e-6, 0.06e-6, 0.05e-6)
#: Assumed radii of the hysteresis, one for each weight [V].
RADII = (0.0, 5.0, 15.0, 30.0)
#: Assumed creep per decade, as a fraction.
CREEP = 0.01
#: Assumed resonance frequency [Hz].
RESONANCE = 300.0
#: Assumed damping ratio of the resonance.
DAMPING = 0.03
#: Assumed RMS noise of the sensor [m].
NOISE = 2.0e-9
#: Assumed lowest and highest voltage [V].
LIMITS = (-30.0, 130.0)


def assumed_stage(cycle: float) -> ActuatorParameters:
    """Return the default stage of an emulated device.

    Units: ``cycle`` [s].
    """
    omega = 2.0 * math.pi * RESONANCE
    continuous = [[0.0, omega], [-omega, -2.0 * DAMPING * omega]]
    matrix, entry = zero_order_hold(continuous, [0.0, omega], cycle)
    return ActuatorParameters.from_mapping(
        {
            "limits.minimum": LIMITS[0],
            "limits.maximum": LIMITS[1],
            "hysteresis.type": "prandtl_ishlinskii",
            "hysteresis.prandtl_ishlinskii.radii": RADII,
            "hysteresis.prandtl_ishlinskii.weights": WEIGHTS,
            "creep.type": "logarithmic",
            "creep.logarithmic.rate": CREEP,
            "dynamics.A": tuple(matrix.ravel().tolist()),
            "dynamics.B": tuple(entry.ravel().tolist()),
            "dynamics.C": (1.0, 0.0),
            "dynamics.sample_time": cycle,
            "sensor.noise": NOISE,
        }
    )


class EmulatedPlant:
    """An actuator that follows a clock: each access computes the samples that are due.

    Units: ``cycle`` [s], ``clock`` [s], ``measured`` [m], ``gain`` [m/V].
    """

    def __init__(self, parameters: ActuatorParameters, cycle: float, clock: Callable[[], float] = time.monotonic):
        self._actuator = Actuator(parameters, cycle)
        self._actuator.advance(self._actuator.measure())  # compiles the plant now instead of at the first query
        self._actuator.reset()
        self.cycle, self._clock = cycle, clock
        self.limits, self.gain = parameters.limits, self._actuator.hysteresis.gain
        self.cycles, self.measured = 0, self._actuator.measure()
        rest = self._actuator.voltage
        self.control: Callable[[float], float] = lambda measured: rest
        self._begun = clock()

    @property
    def voltage(self) -> float:
        """Output voltage of the amplifier [V]."""
        return self._actuator.voltage

    def advance(self) -> None:
        """Compute the samples that are due."""
        due = math.floor((self._clock() - self._begun) / self.cycle) - self.cycles
        most = round(LONGEST_CATCH_UP / self.cycle)
        if due > most:
            self._begun += (due - most) * self.cycle
            due = most
        advance, measure = self._actuator.advance, self._actuator.measure
        for _ in range(due):
            advance(self.control(self.measured))
            self.measured = measure()
        self.cycles += max(due, 0)


#: Assumed: integral gain of the servo [1/s].
INTEGRAL_RATE = 60.0


class Servo:
    """A servo that moves a plant to a position with an integrator, or outputs a voltage in open loop.

    Units: ``voltage`` [V], ``way`` [m].
    """

    def __init__(self, plant: EmulatedPlant):
        self._plant, self.voltage, self.way = plant, plant.voltage, plant.measured

    def begin(self) -> None:
        """Begin the next move at the position of the plant."""
        self.way = self._plant.measured

    def put_out(self, voltage: float) -> float:
        """Output a voltage within the amplifier's range, and return it.

        Units: ``voltage`` [V].
        """
        limits = self._plant.limits
        self.voltage = min(max(voltage, limits.minimum), limits.maximum)
        return self.voltage

    def follow(self, target: float, velocity: float) -> float:
        """Move towards a position for one sample, and return the voltage.

        Units: ``target`` [m], ``velocity`` [m/s].
        """
        plant = self._plant
        reach = velocity * plant.cycle
        self.way += min(max(target - self.way, -reach), reach)
        step = INTEGRAL_RATE * plant.cycle * (self.way - plant.measured) / plant.gain
        return self.put_out(self.voltage + step)


#: Sample time of an emulated device [s]. It is longer than in a real controller, so that Python keeps up even while an
#: axis runs on the same machine.
CYCLE = 2.0e-4


@dataclass(frozen=True)
class Bench:
    """The plant of an emulated device, and the faults of the device."""

    plant: ActuatorParameters = field(default_factory=lambda: assumed_stage(CYCLE))
    cycle: float = CYCLE  #: Sample time of the plant [s].
    faults: tuple[str, ...] = ()  #: Texts for :meth:`DeviceFaults.add`.


@dataclass(frozen=True)
class Running:
    """A running device."""

    where: str  #: Description of the device, with its address.
    driver: Parameters  #: Parameters with which the driver opens the device.
    faults: DeviceFaults  #: The device's faults; more may be added while it runs.
    device: object = None  #: The device itself, for inspection of its true state.
