# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What stands behind an emulated device: a plant with a clock of its own, amplifier and servo, and faults.

Faults are written as the faults of an axis are, ``NAME:START:DURATION[:VALUE]``, with times in seconds of the device's
own clock, counted from where the device begins or where the fault is added. Those of single lines happen to the first
ones in that time, as many as the value says.
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
    """What a fault of a device is."""

    description: str
    #: Default of the value; None: it has none.
    value: float | None = None
    unit: str = ""


FAULTS = {
    "busy": Kind("commands are refused as long as something else is being done"),
    "error": Kind("commands are refused with the device's error of that number", 1.0, "code"),
    "slow": Kind("each answer comes so much later", 0.2, "s"),
    "silent": Kind("no answer comes"),
    "cut": Kind("the link is cut and nobody can connect"),
    "repeat": Kind("a line of an answer comes twice", 1.0, "lines"),
    "stale": Kind("the last line that was sent comes again before the answer", 1.0, "lines"),
    "echo": Kind("the last answer comes again, whole, before the answer", 1.0, "answers"),
    "drop": Kind("a line of an answer does not come", 1.0, "lines"),
    "garbage": Kind("bytes without sense come in the place of a line", 1.0, "lines"),
    "half": Kind("half a line comes, without its end", 1.0, "lines"),
    "close": Kind("half a line comes, then the link is closed; others can connect", 1.0, "lines"),
}
#: Faults of single lines.
OF_LINES = ("repeat", "stale", "echo", "drop", "garbage", "half", "close")
#: What a line without sense is: any bytes, and an end.
GARBAGE = b"\xff\x00=\xb5 1e9\n"


class DeviceFaults:
    """The faults of a device, and when they are there.

    Units: ``clock`` [s].
    """

    def __init__(self, clock: Callable[[], float], texts: Iterable[str] = ()):
        self._clock = clock
        self._entries: list[tuple[str, float, float, float]] = []
        self._lines: dict[tuple, int] = {}
        for text in texts:
            self.add(text)

    def add(self, text: str) -> None:
        """Add a fault, its times counted from now on; ``none`` ends all."""
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
        """Return the value of a fault that is there now (0 where it has none), None of one that is not."""
        now = self._clock()
        return next((value for kind, begin, end, value in self._entries if kind == name and begin <= now < end), None)

    def take_line(self) -> str:
        """Return the fault that happens to the next line, which is counted; empty: none."""
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
    """The lines of a link, with what goes wrong with them."""

    def __init__(self, faults: DeviceFaults):
        self._faults, self.closed = faults, False
        self._last = self._answer = b""

    def garble(self, answer: bytes) -> bytes:
        """Return what is sent in the place of an answer."""
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


#: Longest time that is caught up with [s]: a machine that slept does not make its devices hurry.
LONGEST_CATCH_UP = 5.0

#: Stage that stands behind an emulated device when nobody names another one; all of it is assumed: 0.8 µm/V with a loop
#: of some 12 % of the stroke, 1 % creep a decade, a resonance, 2 nm of noise.
WEIGHTS = (0.6e-6, 0.07e-6, 0.06e-6, 0.05e-6)
RADII = (0.0, 5.0, 15.0, 30.0)
CREEP = 0.01
RESONANCE, DAMPING = 300.0, 0.03
NOISE = 2.0e-9
LIMITS = (-30.0, 130.0)


def assumed_stage(cycle: float) -> ActuatorParameters:
    """Return the stage that stands behind an emulated device by default.

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
    """An actuator that makes its samples by a clock, as many as are due whenever it is asked.

    Units: ``cycle`` [s], ``clock`` [s], ``measured`` [m], ``gain`` [m/V].
    """

    def __init__(self, parameters: ActuatorParameters, cycle: float, clock: Callable[[], float] = time.monotonic):
        self._actuator = Actuator(parameters, cycle)
        self._actuator.advance(self._actuator.measure())  # compiled now, not at the first question
        self._actuator.reset()
        self.cycle, self._clock = cycle, clock
        self.limits, self.gain = parameters.limits, self._actuator.hysteresis.gain
        self.cycles, self.measured = 0, self._actuator.measure()
        rest = self._actuator.voltage
        self.control: Callable[[float], float] = lambda measured: rest
        self._begun = clock()

    @property
    def voltage(self) -> float:
        """Voltage [V] that the amplifier puts out."""
        return self._actuator.voltage

    def advance(self) -> None:
        """Make the samples that are due."""
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


#: Assumed: how fast the servo takes up an error [1/s].
INTEGRAL_RATE = 60.0


class Servo:
    """An integrator that takes a plant to a place, or the voltage that somebody wants.

    Units: ``voltage`` [V], ``way`` [m].
    """

    def __init__(self, plant: EmulatedPlant):
        self._plant, self.voltage, self.way = plant, plant.voltage, plant.measured

    def begin(self) -> None:
        """Begin where the plant is."""
        self.way = self._plant.measured

    def put_out(self, voltage: float) -> float:
        """Put out a voltage within the amplifier's range, and return it.

        Units: ``voltage`` [V].
        """
        limits = self._plant.limits
        self.voltage = min(max(voltage, limits.minimum), limits.maximum)
        return self.voltage

    def follow(self, target: float, velocity: float) -> float:
        """Go a sample further towards a place, and return the voltage.

        Units: ``target`` [m], ``velocity`` [m/s].
        """
        plant = self._plant
        reach = velocity * plant.cycle
        self.way += min(max(target - self.way, -reach), reach)
        step = INTEGRAL_RATE * plant.cycle * (self.way - plant.measured) / plant.gain
        return self.put_out(self.voltage + step)


#: Time between two samples of an emulated device [s]: slower than a controller, so that Python keeps up beside an axis.
CYCLE = 2.0e-4


@dataclass(frozen=True)
class Bench:
    """The plant behind a device, and what goes wrong with that."""

    plant: ActuatorParameters = field(default_factory=lambda: assumed_stage(CYCLE))
    cycle: float = CYCLE  #: Time between two of its samples [s].
    faults: tuple[str, ...] = ()  #: As :class:`~hysteresis_ros.laboratory.emulation.bench.DeviceFaults` takes them.


@dataclass(frozen=True)
class Running:
    """A device that runs."""

    where: str  #: What it is and where it is found.
    driver: Parameters  #: With which its driver is opened.
    faults: DeviceFaults  #: Faults may be added while it runs.
    device: object = None  #: The device itself, to look at what it really does.
