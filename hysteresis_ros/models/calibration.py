# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Calibration between a driver and an axis: from readings to displacements [m], from voltages to an amplifier's values.

Sensor: displacement = sign · scale · P(reading) + offset. Amplifier: value = P(sign · (voltage − offset) / scale). The
polynomial P, in the driver's unit, linearises the characteristic. A relative sensor measures the distance from the
position at which it was homed. A simulated plant needs no calibration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block, kernel

#: Maximum number of coefficients of a polynomial.
COEFFICIENTS = 8

# Layout of a sensor's p; the coefficients of the polynomial follow, the constant first.
SCALE, OFFSET, LOWEST, HIGHEST, RELATIVE, HOME, HOMING_SAMPLES, SENSOR_POLYNOMIAL = range(8)

# Layout of a sensor's x: the last reading, number of readings beyond the range, subtracted position [m], number of
# readings that homing still needs, and their sum [m].
READING, BEYOND, ORIGIN, HOMING, SUM = range(5)
SENSOR_STATES = 5

# Layout of an amplifier's p.
GAIN, ZERO, AMPLIFIER_POLYNOMIAL = range(3)


@dataclass(frozen=True)
class LineParameters(Parameters):
    """Parameters that sensor and amplifier have in common."""

    sign: int = parameter(
        1,
        low=-1,
        high=1,
        read_only=True,
        description="-1 if displacement or voltage falls when the value rises; else 1",
    )
    polynomial: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="linearisation c0, c1, c2 …: value v of the driver becomes c0 + c1 v + c2 v² …, in the same unit; "
        "empty: none",
    )

    def check(self) -> Iterator[Problem]:
        """Yield a Problem for each inconsistency."""
        if self.sign == 0:
            yield Problem("sign", self.sign, "must be 1 or -1")
        if len(self.polynomial) > COEFFICIENTS:
            yield Problem(
                "polynomial", self.polynomial, f"has more than {COEFFICIENTS} coefficients: fit a lower order"
            )


@dataclass(frozen=True)
class SensorCalibrationParameters(LineParameters):
    """Conversion from the readings of a driver to displacements."""

    unit: str = parameter("m", read_only=True, description="unit of the driver's readings, as the driver states it")
    scale: float = parameter(
        1.0,
        unit="m per unit",
        low=1.0e-15,
        high=1.0e6,
        read_only=True,
        description="displacement per unit of the reading",
    )
    offset: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, read_only=True, description="displacement at a linearised reading of 0"
    )
    minimum: float = parameter(
        0.0,
        low=-1.0e12,
        high=1.0e12,
        read_only=True,
        description="lowest valid reading [unit]; minimum = maximum = 0: all are valid",
    )
    maximum: float = parameter(
        0.0, low=-1.0e12, high=1.0e12, read_only=True, description="highest valid reading [unit]"
    )
    reference: str = parameter(
        "absolute",
        choices=("absolute", "relative"),
        read_only=True,
        description="relative: the sensor measures changes only; homing, at the start and by ~/home, defines the "
        "position at safe_voltage as `home`",
    )
    home: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, read_only=True, description="relative: displacement at the homing position"
    )
    homing_samples: int = parameter(
        10, low=1, high=10**6, read_only=True, description="relative: number of readings averaged for homing"
    )

    @property
    def bounded(self) -> bool:
        """Whether readings have a valid range."""
        return self.minimum != 0.0 or self.maximum != 0.0

    def check(self) -> Iterator[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.unit != "m" and self.scale == 1.0:
            remedy = f"is 1 m per {self.unit}: give the displacement per {self.unit} of the sensor"
            yield Problem("scale", self.scale, remedy)
        if self.bounded and not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum = {self.maximum:g} {self.unit}")
        elif len(self.polynomial) > 2 and not self.bounded:
            yield Problem(
                "maximum",
                self.maximum,
                "this polynomial needs the range of readings in which it is valid; give minimum and maximum",
            )
        else:
            yield from rising_problems(self.polynomial, self.minimum, self.maximum, self.unit)


@dataclass(frozen=True)
class AmplifierCalibrationParameters(LineParameters):
    """Conversion from voltages at the actuator to values of a driver."""

    unit: str = parameter(
        "V", read_only=True, description="unit of the driver's output values, as the driver states it"
    )
    scale: float = parameter(
        1.0,
        unit="V per unit",
        low=1.0e-12,
        high=1.0e9,
        read_only=True,
        description="voltage at the actuator per unit of the driver's value: the gain of the amplifier",
    )
    offset: float = parameter(
        0.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage at the actuator at the driver's value 0",
    )

    def check(self) -> Iterator[Problem]:
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.unit != "V" and self.scale == 1.0:
            yield Problem("scale", self.scale, f"is 1 V per {self.unit}: give the volts per {self.unit}")


@dataclass(frozen=True)
class CalibrationParameters(Parameters):
    """Calibration of a driver's values; it has no effect without a driver."""

    sensor: SensorCalibrationParameters = group(SensorCalibrationParameters)
    amplifier: AmplifierCalibrationParameters = group(AmplifierCalibrationParameters)


def rising_problems(coefficients: tuple[float, ...], low: float, high: float, unit: str) -> Iterator[Problem]:
    """Yield a Problem unless a polynomial rises everywhere from ``low`` to ``high`` [unit].

    The first coefficient is the constant; without coefficients, the polynomial is the value itself.
    """
    if not coefficients:
        return
    with np.errstate(all="ignore"):  # a polynomial that overflows counts as not rising
        slope: Any = np.polynomial.Polynomial(coefficients).deriv()
        places = np.array([low, high, *_turns(slope, low, high)])
        slopes = np.nan_to_num(slope(places), nan=-np.inf)
    worst = int(np.argmin(slopes))
    if not slopes[worst] > 0.0:
        remedy = (
            f"must rise everywhere from {low:g} to {high:g} {unit}, but has the slope {slopes[worst]:.3g} at "
            f"{places[worst]:.6g} {unit}: fit a lower order, or narrow the range; use sign for a reversed direction"
        )
        yield Problem("polynomial", coefficients, remedy)


def _turns(slope: Any, low: float, high: float) -> list[float]:
    """Return the values between ``low`` and ``high`` at which the polynomial ``slope`` has an extremum."""
    if not low < high:
        return []
    # for a variable scaled to -1 … 1, the coefficients are comparable, so negligible ones can be dropped
    curve = slope.deriv().convert(domain=[low, high])
    largest = np.max(np.abs(curve.coef))
    if not np.isfinite(largest):
        return []
    turns = curve.trim(1e-12 * largest).roots()
    return [float(turn.real) for turn in turns if abs(turn.imag) <= 1e-9 * (high - low) and low < turn.real < high]


@kernel
def evaluated(p, first, value):
    """Return the polynomial with the coefficients ``p[first:]`` at ``value``."""
    result = 0.0
    for i in range(COEFFICIENTS - 1, -1, -1):
        result = result * value + p[first + i]
    return result


@kernel
def sensor_displacement(p, x, reading):
    """Return the displacement [m] of a reading; NaN if it is invalid, or while a relative sensor is being homed."""
    x[READING] = reading
    if reading != reading:
        return math.nan
    if reading < p[LOWEST] or reading > p[HIGHEST]:
        x[BEYOND] += 1.0
        return math.nan
    displacement = p[SCALE] * evaluated(p, SENSOR_POLYNOMIAL, reading) + p[OFFSET]
    if x[HOMING] > 0.0:
        x[SUM] += displacement
        x[HOMING] -= 1.0
        if x[HOMING] == 0.0:
            x[ORIGIN] = x[SUM] / p[HOMING_SAMPLES] - p[HOME]
        return math.nan
    return displacement - x[ORIGIN]


@kernel
def amplifier_value(p, voltage):
    """Return the driver's value for a voltage [V] at the actuator."""
    return evaluated(p, AMPLIFIER_POLYNOMIAL, (voltage - p[ZERO]) * p[GAIN])


def _padded(coefficients: tuple[float, ...]) -> np.ndarray:
    given = coefficients or (0.0, 1.0)
    return np.array([*given, *(0.0,) * (COEFFICIENTS - len(given))])


class SensorCalibration(Block):
    """Conversion of a driver's readings to displacements [m].

    Parameters
    ----------
    parameters : SensorCalibrationParameters
    sample_time : float
        Sample time [s], not used.
    """

    kernel = staticmethod(sensor_displacement)

    def pack(self, parameters: SensorCalibrationParameters) -> np.ndarray:
        """Return p, shape (15,)."""
        low, high = (parameters.minimum, parameters.maximum) if parameters.bounded else (-math.inf, math.inf)
        relative = float(parameters.reference == "relative")
        line = parameters.sign * parameters.scale, parameters.offset
        numbers = [*line, low, high, relative, parameters.home, parameters.homing_samples]
        return np.concatenate([numbers, _padded(parameters.polynomial)])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (5,); a relative sensor is not homed yet."""
        x = np.zeros(SENSOR_STATES)
        x[READING] = math.nan
        x[HOMING] = self.p[HOMING_SAMPLES] if self.p[RELATIVE] else 0.0
        return x

    def reading(self, displacement: float) -> float:
        """Return the reading of an absolute sensor at a displacement [m], also outside the range of valid readings.

        Parameters
        ----------
        displacement : float
            [m]
        """
        linear = (displacement - self.p[OFFSET]) / self.p[SCALE]
        if not self.parameters.polynomial:
            return float(linear)
        curve: Any = np.polynomial.Polynomial(self.parameters.polynomial) - linear
        roots = curve.roots()
        real = roots[np.abs(roots.imag) <= 1e-9 * np.maximum(np.abs(roots), 1e-300)].real
        low, high = self.p[LOWEST], self.p[HIGHEST]
        # between the valid readings the polynomial increases, so it has at most one root there
        beyond = np.maximum(np.maximum(low - real, real - high), 0.0)
        return float(real[np.argmin(beyond)])

    def begin_homing(self) -> None:
        """Home a relative sensor with its next readings; for an absolute sensor, nothing is done."""
        self.x[HOMING], self.x[SUM] = self.p[HOMING_SAMPLES] if self.p[RELATIVE] else 0.0, 0.0

    @property
    def homing(self) -> bool:
        """Whether a relative sensor still has to be homed."""
        return bool(self.x[HOMING] > 0.0)

    @property
    def complaint(self) -> str:
        """Error message for the last reading; empty if the reading is valid."""
        reading, low, high = self.x[READING], self.p[LOWEST], self.p[HIGHEST]
        if math.isnan(reading) or low <= reading <= high:
            return ""
        unit, count = self.parameters.unit, int(self.x[BEYOND])
        return (
            f"the sensor reads {reading:.6g} {unit}, beyond calibration.sensor.minimum … maximum = {low:g} … {high:g} "
            f"{unit}: the reading is not used ({count} such readings so far); check the sensor, its cable and its range"
        )


class AmplifierCalibration:
    """Conversion of voltages at the actuator to values of a driver.

    Parameters
    ----------
    parameters : AmplifierCalibrationParameters

    Attributes
    ----------
    p : ndarray, shape (10,)
        Parameters of :func:`amplifier_value`.
    """

    def __init__(self, parameters: AmplifierCalibrationParameters):
        self.parameters = parameters.validated()
        line = parameters.sign / parameters.scale, parameters.offset
        self.p = np.concatenate([line, _padded(parameters.polynomial)])

    def value(self, voltage: float) -> float:
        """Return the driver's value for a voltage [V] at the actuator."""
        return amplifier_value(self.p, float(voltage))

    def require_range(self, low: float, high: float, prefix: str) -> None:
        """Raise ParameterError unless the polynomial increases between these voltages [V].

        Otherwise a value would belong to several voltages. ``prefix`` is the prefix of the parameter's name.
        """
        least, most = sorted((voltage - self.p[ZERO]) * self.p[GAIN] for voltage in (low, high))
        found = list(rising_problems(self.parameters.polynomial, least, most, self.parameters.unit))
        if found:
            raise ParameterError(replace(item, name=prefix + item.name) for item in found)
