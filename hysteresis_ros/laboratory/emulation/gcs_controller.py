# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The emulated GCS controller: axes with plants of the package, wave generator, data recorder and errors."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from hysteresis_ros.hardware.drivers.gcs import (
    AXIS_UNIT,
    CONTROL_VOLTAGE,
    NO_ERROR,
    OPEN_LOOP,
    POSITION,
    POSITION_DISTANCE,
    POSITION_ERROR,
    RANGE_MAXIMUM,
    RANGE_MINIMUM,
    SETTLING,
    START_THRESHOLD,
    STOP_THRESHOLD,
    STOPPED,
    TARGET,
    TOLERANCE,
    TRIGGER_AXIS,
    TRIGGER_MODE,
    TRIGGER_STEP,
    UNITS,
    VOLTAGE,
    VOLTAGE_MAXIMUM,
    VOLTAGE_MINIMUM,
)
from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, EmulatedPlant, Servo
from hysteresis_ros.models.actuator import ActuatorParameters

#: Total number of points of all tables.
POINTS = 65536
#: Recordable signals, with their names in the answer.
OPTIONS = {
    0: "Nothing",
    TARGET: "Target Position of axis",
    POSITION: "Current Position of axis",
    POSITION_ERROR: "Position Error of axis",
    CONTROL_VOLTAGE: "Control Voltage of output chan",
    OPEN_LOOP: "Open-Loop Control of axis",
    VOLTAGE: "Voltage of output chan",
}
#: Triggers of the recorder: the wave generator; the wave generator or any move; no trigger: it starts immediately.
BY_WAVE, BY_MOTION, AT_ONCE = 0, 1, 4


class Recorder:
    """Tables of recorded signals, with a point for every n-th sample."""

    def __init__(self, axes: list[str]):
        self.configuration = [(name, POSITION) for name in axes]
        self.rate, self.trigger, self.running = 1, BY_WAVE, False
        self.tables: list[list[float]] = [[] for _ in axes]
        self._seen = dict.fromkeys(axes, 0)

    @property
    def points(self) -> int:
        """Maximum number of points of each table."""
        return POINTS // len(self.tables)

    def resize(self, count: int) -> None:
        """Set the number of tables."""
        first = self.configuration[0][0]
        self.configuration = (self.configuration + [(first, 0)] * count)[:count]
        self.tables, self.running = [[] for _ in range(count)], False

    def start(self) -> None:
        """Discard all points, and start a recording."""
        self.tables = [[] for _ in self.configuration]
        self._seen = dict.fromkeys(self._seen, 0)
        self.running = any(option for _, option in self.configuration)

    def record(self, axis: str, signals: dict[int, float]) -> None:
        """Record a sample of an axis."""
        if self._seen[axis] % self.rate == 0:
            for (name, option), table in zip(self.configuration, self.tables, strict=True):
                if name == axis and option and len(table) < self.points:
                    table.append(signals[option])
        self._seen[axis] += 1
        self.running = any(
            option and len(table) < self.points
            for (_, option), table in zip(self.configuration, self.tables, strict=True)
        )

    def lines(self, start: int, count: int, tables: list[int], cycle: float) -> list[str]:
        """Return recorded points as a GCS array.

        Units: ``cycle`` [s].
        """
        columns = [self.tables[number - 1][start - 1 : start - 1 + count] for number in tables]
        length = min(map(len, columns))
        head = {
            "TYPE": 1,
            "SEPARATOR": 32,
            "DIM": len(tables),
            "SAMPLE_TIME": f"{cycle * self.rate:.9g}",
            "NDATA": length,
        }
        for place, number in enumerate(tables):
            name, option = self.configuration[number - 1]
            head[f"NAME{place}"] = f"{OPTIONS[option]}{name}"
        lines = [f"# {name} = {value}" for name, value in head.items()] + ["# END_HEADER"]
        return lines + [" ".join(f"{column[row]:.7g}" for column in columns) for row in range(length)]


#: Number of trigger outputs, and number of digital inputs.
LINES = 4


class TriggerLine:
    """A digital output with position compare: a pulse at each position of a grid in one direction of motion.

    Assumed: the first pulse is at the start threshold.
    """

    def __init__(self, axis: str):
        self.values: dict[int, float | str] = {TRIGGER_AXIS: axis, TRIGGER_MODE: POSITION_DISTANCE, TRIGGER_STEP: 0.1}
        self.values |= {START_THRESHOLD: 0.0, STOP_THRESHOLD: 0.0}
        self.on = False
        #: Positions of the pulses [unit of the axis].
        self.pulses: list[float] = []
        self._before = math.nan

    def look(self, position: float) -> None:
        """Compare a position [unit of the axis] with the position in the previous cycle."""
        before, self._before = self._before, position
        start, stop, step = (float(self.values[name]) for name in (START_THRESHOLD, STOP_THRESHOLD, TRIGGER_STEP))
        if not self.on or self.values[TRIGGER_MODE] != POSITION_DISTANCE or not step > 0.0 or start == stop:
            return
        sign = 1.0 if stop > start else -1.0
        passed = [sign * (place - start) / step for place in (before, position)]
        if not passed[1] > passed[0]:
            return
        last = min(math.floor(passed[1]), math.floor(abs(stop - start) / step))
        for number in range(max(math.ceil(passed[0] + 1e-12), 0), last + 1):
            self.pulses.append(start + sign * number * step)


#: Assumed largest velocity of the servo [m/s].
VELOCITY = 1.0e-3
#: Assumed on-target window of the servo [m].
WINDOW = 20.0e-9
#: Assumed time within the window after which the servo is on target [s].
SETTLED = 5.0e-3


class Axis:
    """An axis with its servo."""

    def __init__(self, name: str, plant: EmulatedPlant, recorder: Recorder):
        self.name, self.plant, self._recorder = name, plant, recorder
        low, high = plant.limits.minimum, plant.limits.maximum
        self.values: dict[int, float | str] = {
            AXIS_UNIT: "UM",
            RANGE_MINIMUM: low * plant.gain / UNITS["um"],
            RANGE_MAXIMUM: high * plant.gain / UNITS["um"],
            VOLTAGE_MINIMUM: low,
            VOLTAGE_MAXIMUM: high,
            TOLERANCE: WINDOW / UNITS["um"],
            SETTLING: SETTLED,
        }
        self.servo, self.velocity = False, VELOCITY
        self._servo = Servo(plant)
        self.open_value, self.target = plant.voltage, plant.measured
        self.wave: list[float] = []
        self._played, self._cycles, self._rate, self._inside = 0, 0, 1, 0
        #: Called in each cycle with the position [unit of the axis].
        self.looked: Callable[[float], None] = lambda position: None
        plant.control = self._control

    @property
    def unit(self) -> float:
        """Metres per unit of the axis."""
        return UNITS[str(self.values[AXIS_UNIT]).lower()]

    @property
    def moving(self) -> bool:
        """Whether the servo is moving."""
        return self.servo and not self.on_target

    @property
    def on_target(self) -> bool:
        """Whether the position has been in the window long enough; False if the servo is off."""
        return self.servo and self._inside * self.plant.cycle >= float(self.values[SETTLING])

    @property
    def generating(self) -> bool:
        """Whether the wave generator runs."""
        return bool(self.wave)

    def switch(self, servo: bool) -> None:
        """Switch the servo on at the present position, or off at the present voltage."""
        if servo and not self.servo:
            self._hold_here()
        if self.servo and not servo:
            self.open_value = self._servo.voltage
        self.servo, self._inside = servo, 0

    def _hold_here(self) -> None:
        self._servo.begin()
        self.target = self._servo.way

    def move(self, target: float) -> None:
        """Move the servo to a position.

        Units: ``target`` [m].
        """
        self.target, self._inside = target, 0

    def generate(self, wave: list[float], cycles: int, rate: int) -> None:
        """Start the wave generator.

        Units: ``wave`` [m] if the servo is on, otherwise [V].
        """
        self.wave, self._cycles, self._rate, self._played = wave, cycles, rate, 0

    def stop(self) -> None:
        """Stop the wave generator, and hold the servo at the present position."""
        if self.generating:
            self.wave = []
            self.open_value = self._servo.voltage
        if self.servo:
            self._hold_here()

    def _wanted(self) -> float:
        """Return the target in this sample, from the generator or from the client."""
        if not self.wave:
            return self.target if self.servo else self.open_value
        point, length = self._played // self._rate, len(self.wave)
        self._played += 1
        if self._cycles and point >= self._cycles * length:
            last, self.wave = self.wave[-1], []
            if self.servo:
                self.target = last
            else:
                self.open_value = last
            return last
        return self.wave[point % length]

    def _control(self, measured: float) -> float:
        """Return the voltage of a sample."""
        self.looked(measured / self.unit)
        wanted = self._wanted()
        if self.servo:
            voltage = self._servo.follow(wanted, self.velocity)
            inside = abs(wanted - measured) <= float(self.values[TOLERANCE]) * self.unit
            self._inside = self._inside + 1 if inside else 0
        else:
            voltage = self._servo.put_out(wanted)
        if self._recorder.running:
            self._record(wanted, measured, voltage)
        return voltage

    def _record(self, wanted: float, measured: float, voltage: float) -> None:
        target, position = (wanted if self.servo else math.nan) / self.unit, measured / self.unit
        signals = {
            TARGET: target,
            POSITION: position,
            POSITION_ERROR: target - position,
            CONTROL_VOLTAGE: voltage,
            OPEN_LOOP: self.open_value if self.servo else wanted,
            VOLTAGE: voltage,
        }
        self._recorder.record(self.name, signals)


@dataclass(frozen=True)
class Model:
    """A model of an emulated controller."""

    #: Answer to ``*IDN?``.
    identification: str
    axes: int
    #: Number of input signals, from sensors and analog inputs.
    inputs: int
    #: Whether answers of the controller omit leading zeros of parameter numbers.
    strips: bool = False


MODELS = {
    "E-709": Model("Physik Instrumente, E-709.CRG, 0000000000, 1.000 (emulated)", 1, 2),
    "E-727": Model("Physik Instrumente, E-727.3CDA, 0000000000, 1.000 (emulated)", 3, 7, strips=True),
    "E-754": Model("Physik Instrumente, E-754.1CD, 0000000000, 1.000 (emulated)", 1, 3),
}


class Controller:
    """A controller with its axes.

    Units: ``cycle`` [s], ``clock`` [s].
    """

    def __init__(
        self,
        model: Model,
        plant: ActuatorParameters,
        cycle: float,
        faults: DeviceFaults,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.model, self.faults, self.cycle = model, faults, cycle
        names = [str(number + 1) for number in range(model.axes)]
        self.recorder = Recorder(names)
        self.axes = {name: Axis(name, EmulatedPlant(plant, cycle, clock), self.recorder) for name in names}
        self.waves: dict[int, list[float]] = {}
        #: Wave table and number of cycles of each wave generator, and samples per point of the tables.
        self.chosen: dict[str, int] = {}
        self.repeats, self.wave_rate = dict.fromkeys(names, 0), 1
        self.lines = {str(number + 1): TriggerLine(names[0]) for number in range(LINES)}
        #: States of the digital inputs.
        self.inputs = dict.fromkeys(self.lines, False)
        for axis in self.axes.values():
            axis.looked = partial(self._compare, axis.name)
        self._error = NO_ERROR
        self.own = {0x02000200: 0.0, 0x02000300: 1.0, 0x07000A00: 0.0, 0x07000A01: 100.0, 0x06000500: 0.0}

    def _compare(self, axis: str, position: float) -> None:
        """Pass the position of an axis to its trigger lines."""
        for line in self.lines.values():
            if line.values[TRIGGER_AXIS] == axis:
                line.look(position)

    def tick(self) -> None:
        """Advance to the present time."""
        for axis in self.axes.values():
            axis.plant.advance()

    @property
    def busy(self) -> bool:
        """Whether the controller is busy."""
        return "busy" in self.faults

    def fail(self, code: int) -> None:
        """Store an error until it is queried."""
        self._error = code

    def take_error(self) -> int:
        """Return the stored error and clear it; a hardware fault stays."""
        lasting = self.faults.value("error")
        code, self._error = self._error, NO_ERROR
        return code if lasting is None else int(lasting)

    def stop(self, axes: Iterable[Axis]) -> None:
        """Stop axes, and store the error that reports the stop."""
        for axis in axes:
            axis.stop()
        self._error = STOPPED
