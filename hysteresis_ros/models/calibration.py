# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What lies between a driver and an axis: readings become displacements in m, voltages what an amplifier is told.

A sensor: displacement = sign · scale · P(reading) + offset, an amplifier: value = P(sign · (voltage − offset) / scale).
P is a polynomial in the driver's own unit that makes a straight line of the characteristic; a simulated plant needs
none of it. A relative sensor counts from where it was homed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block, kernel

#: Most coefficients of a polynomial.
COEFFICIENTS = 8

# Layout of a sensor's p; the polynomial's coefficients follow, from that of the constant on.
SCALE, OFFSET, LOWEST, HIGHEST, RELATIVE, HOME, HOMING_SAMPLES, SENSOR_POLYNOMIAL = range(8)

# Layout of a sensor's x: the last reading, readings so far beyond the range, what is subtracted [m], readings that
# homing still waits for, their sum [m].
READING, BEYOND, ORIGIN, HOMING, SUM = range(5)
SENSOR_STATES = 5

# Layout of an amplifier's p.
GAIN, ZERO, AMPLIFIER_POLYNOMIAL = range(3)


@dataclass(frozen=True)
class LineParameters(Parameters):
    """What sensor and amplifier have in common."""

    sign: int = parameter(
        1, low=-1, high=1, read_only=True, description="1, or -1 where a larger value means a smaller one"
    )
    polynomial: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="linearisation c0, c1, c2 …: value v of the driver becomes c0 + c1 v + c2 v² …, in the same unit; "
        "empty: none",
    )

    def check(self) -> Iterator[Problem]:
        """Yield what is inconsistent."""
        if self.sign == 0:
            yield Problem("sign", self.sign, "must be 1 or -1")
        if len(self.polynomial) > COEFFICIENTS:
            yield Problem(
                "polynomial", self.polynomial, f"has more than {COEFFICIENTS} coefficients: fit a lower order"
            )


@dataclass(frozen=True)
class SensorCalibrationParameters(LineParameters):
    """From the readings of a driver to displacements."""

    unit: str = parameter("m", read_only=True, description="unit of the driver's readings, as it says itself")
    scale: float = parameter(
        1.0,
        unit="m per unit",
        low=1.0e-15,
        high=1.0e6,
        read_only=True,
        description="displacement that a reading stands for",
    )
    offset: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, read_only=True, description="displacement at a linearised reading of 0"
    )
    minimum: float = parameter(
        0.0,
        low=-1.0e12,
        high=1.0e12,
        read_only=True,
        description="lowest reading [unit] that is a measurement; with minimum = maximum = 0 every one is",
    )
    maximum: float = parameter(
        0.0, low=-1.0e12, high=1.0e12, read_only=True, description="highest reading [unit] that is a measurement"
    )
    reference: str = parameter(
        "absolute",
        choices=("absolute", "relative"),
        read_only=True,
        description="relative: the sensor knows changes only, the place at safe_voltage is `home`, found at the start "
        "and by ~/home",
    )
    home: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, read_only=True, description="relative: displacement where it was homed"
    )
    homing_samples: int = parameter(
        10, low=1, high=10**6, read_only=True, description="relative: readings whose mean is the place of home"
    )

    @property
    def bounded(self) -> bool:
        """Whether readings beyond a range are no measurements."""
        return self.minimum != 0.0 or self.maximum != 0.0

    def check(self) -> Iterator[Problem]:
        """Yield what is inconsistent."""
        yield from super().check()
        if self.unit != "m" and self.scale == 1.0:
            remedy = f"is 1 m per {self.unit}: give the displacement that one {self.unit} of the sensor stands for"
            yield Problem("scale", self.scale, remedy)
        if self.bounded and not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum = {self.maximum:g} {self.unit}")
        elif len(self.polynomial) > 2 and not self.bounded:
            yield Problem("maximum", self.maximum, "a polynomial needs the range of readings in which it holds")
        else:
            yield from rising_problems(self.polynomial, self.minimum, self.maximum, self.unit)


@dataclass(frozen=True)
class AmplifierCalibrationParameters(LineParameters):
    """From voltages at the actuator to what a driver is told."""

    unit: str = parameter("V", read_only=True, description="unit of what the driver is told, as it says itself")
    scale: float = parameter(
        1.0,
        unit="V per unit",
        low=1.0e-12,
        high=1.0e9,
        read_only=True,
        description="volts at the actuator for one unit that the driver is told: the gain of the amplifier",
    )
    offset: float = parameter(
        0.0,
        unit="V",
        low=-1.0e4,
        high=1.0e4,
        read_only=True,
        description="voltage at the actuator when the driver is told 0",
    )

    def check(self) -> Iterator[Problem]:
        """Yield what is inconsistent."""
        yield from super().check()
        if self.unit != "V" and self.scale == 1.0:
            yield Problem(
                "scale", self.scale, f"is 1 V per {self.unit}: give the volts that one {self.unit} stands for"
            )


@dataclass(frozen=True)
class CalibrationParameters(Parameters):
    """What the values of a driver mean; without a driver it has no effect."""

    sensor: SensorCalibrationParameters = group(SensorCalibrationParameters)
    amplifier: AmplifierCalibrationParameters = group(AmplifierCalibrationParameters)


def rising_problems(coefficients: tuple[float, ...], low: float, high: float, unit: str) -> Iterator[Problem]:
    """Yield a Problem when a polynomial does not rise everywhere from ``low`` to ``high``.

    Parameters
    ----------
    coefficients : tuple of float
        From that of the constant on; none: the polynomial is the value itself.
    low, high : float
        Range of the value [unit].
    unit : str
    """
    if not coefficients:
        return
    with np.errstate(all="ignore"):  # what overflows does not rise
        slope: Any = np.polynomial.Polynomial(coefficients).deriv()
        places = np.array([low, high, *_turns(slope, low, high)])
        slopes = np.nan_to_num(slope(places), nan=-np.inf)
    worst = int(np.argmin(slopes))
    if not slopes[worst] > 0.0:
        remedy = (
            f"must rise everywhere from {low:g} to {high:g} {unit}, and has the slope {slopes[worst]:.3g} at "
            f"{places[worst]:.6g} {unit}: fit a lower order, or narrow the range; a direction is what sign is for"
        )
        yield Problem("polynomial", coefficients, remedy)


def _turns(slope: Any, low: float, high: float) -> list[float]:
    """Return where a polynomial turns between two places."""
    if not low < high:
        return []
    # in a variable from -1 to 1 coefficients of any unit can be compared: what is nothing beside others is left out
    curve = slope.deriv().convert(domain=[low, high])
    largest = np.max(np.abs(curve.coef))
    if not np.isfinite(largest):
        return []
    turns = curve.trim(1e-12 * largest).roots()
    return [float(turn.real) for turn in turns if abs(turn.imag) <= 1e-9 * (high - low) and low < turn.real < high]


@kernel
def evaluated(p, first, value):
    """Return the polynomial whose coefficients stand in ``p`` from ``first`` on, at ``value``."""
    result = 0.0
    for i in range(COEFFICIENTS - 1, -1, -1):
        result = result * value + p[first + i]
    return result


@kernel
def sensor_displacement(p, x, reading):
    """Displacement [m] of a reading; NaN where it is no measurement, and while a relative sensor is homed."""
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
    """Return what a driver is told for a voltage [V] at the actuator."""
    return evaluated(p, AMPLIFIER_POLYNOMIAL, (voltage - p[ZERO]) * p[GAIN])


def _padded(coefficients: tuple[float, ...]) -> np.ndarray:
    given = coefficients or (0.0, 1.0)
    return np.array([*given, *(0.0,) * (COEFFICIENTS - len(given))])


class SensorCalibration(Block):
    """Turns the readings of a driver into displacements [m].

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
        """Return x, shape (5,); a relative sensor still has to be homed."""
        x = np.zeros(SENSOR_STATES)
        x[READING] = math.nan
        x[HOMING] = self.p[HOMING_SAMPLES] if self.p[RELATIVE] else 0.0
        return x

    def begin_homing(self) -> None:
        """Take the next readings of a relative sensor for those at home; of an absolute one nothing."""
        self.x[HOMING], self.x[SUM] = self.p[HOMING_SAMPLES] if self.p[RELATIVE] else 0.0, 0.0

    @property
    def homing(self) -> bool:
        """Whether home has not been found yet."""
        return bool(self.x[HOMING] > 0.0)

    @property
    def complaint(self) -> str:
        """What is wrong with the last reading; empty: nothing."""
        reading, low, high = self.x[READING], self.p[LOWEST], self.p[HIGHEST]
        if math.isnan(reading) or low <= reading <= high:
            return ""
        unit, count = self.parameters.unit, int(self.x[BEYOND])
        return (
            f"the sensor reads {reading:.6g} {unit}, beyond calibration.sensor.minimum … maximum = {low:g} … {high:g} "
            f"{unit}: no measurement ({count} so far); look at the sensor, its cable and its range"
        )


class AmplifierCalibration:
    """Turns voltages at the actuator into what a driver is told.

    Parameters
    ----------
    parameters : AmplifierCalibrationParameters

    Attributes
    ----------
    p : ndarray, shape (10,)
        What :func:`amplifier_value` takes.
    """

    def __init__(self, parameters: AmplifierCalibrationParameters):
        self.parameters = parameters.validated()
        line = parameters.sign / parameters.scale, parameters.offset
        self.p = np.concatenate([line, _padded(parameters.polynomial)])

    def value(self, voltage: float) -> float:
        """Return what the driver is told for a voltage [V] at the actuator."""
        return amplifier_value(self.p, float(voltage))

    def require_range(self, low: float, high: float, prefix: str) -> None:
        """Check that the polynomial rises between these voltages [V].

        Parameters
        ----------
        low, high : float
            [V]
        prefix : str
            Put before the name of the parameter.

        Raises
        ------
        ParameterError
            It does not: one value would stand for several voltages.
        """
        least, most = sorted((voltage - self.p[ZERO]) * self.p[GAIN] for voltage in (low, high))
        found = list(rising_problems(self.parameters.polynomial, least, most, self.parameters.unit))
        if found:
            raise ParameterError([Problem(prefix + item.name, item.value, item.remedy) for item in found])
