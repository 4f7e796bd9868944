# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Calibration of sensor and amplifier: closed forms, non-invertible curves, and the zero of a relative sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.calibration import (
    AmplifierCalibration,
    AmplifierCalibrationParameters,
    CalibrationParameters,
    SensorCalibration,
    SensorCalibrationParameters,
)

#: A 16-bit gauge with its middle at 50 µm, inverted sign and a nonlinearity of 2 %.
GAUGE = {
    "sensor.unit": "count",
    "sensor.scale": 1.5e-9,
    "sensor.sign": -1,
    "sensor.offset": 98.3025e-6,
    "sensor.polynomial": [120.0, 1.0, -6.0e-7],
    "sensor.minimum": 0.0,
    "sensor.maximum": 65535.0,
}


def sensor(**changes) -> SensorCalibration:
    values = {**GAUGE, **{f"sensor.{name}": value for name, value in changes.items()}}
    return SensorCalibration(CalibrationParameters.from_mapping(values).sensor, 1e-3)


@given(st.floats(-1e9, 1e9))
def test_without_parameters_nothing_is_changed_in_any_bit(value):
    assert SensorCalibration(SensorCalibrationParameters(), 1e-3).step(value) == value
    assert AmplifierCalibration(AmplifierCalibrationParameters()).value(value) == value


@given(st.floats(0.0, 65535.0))
def test_a_reading_becomes_a_displacement_by_the_formula(count):
    expected = -1.5e-9 * (120.0 + count - 6.0e-7 * count**2) + 98.3025e-6
    assert sensor().step(count) == pytest.approx(expected, abs=1e-18)


@pytest.mark.parametrize("bend", [-0.002, 0.002])
@given(count=st.floats(0.0, 100.0))
def test_the_reading_of_a_displacement_is_the_one_within_the_range(bend, count):
    """A second reading with the same displacement is beyond the range, above or below it."""
    block = sensor(polynomial=[0.0, 1.0, bend], minimum=0.0, maximum=100.0)
    assert block.reading(block.step(count)) == pytest.approx(count, abs=1e-6)


@given(st.floats(-20.0, 120.0))
def test_an_amplifier_puts_out_the_voltage_that_was_wanted(voltage):
    # for v it outputs 1 V - 15 V/V · u, where v = u + 0.01 u² corrects its nonlinearity
    values = {"scale": 15.0, "sign": -1, "offset": 1.0, "polynomial": [0.0, 1.0, 0.01]}
    amplifier = AmplifierCalibration(AmplifierCalibrationParameters.from_mapping(values))
    told = amplifier.value(voltage)
    u = (-1.0 + math.sqrt(1.0 + 0.04 * told)) / 0.02
    assert 1.0 - 15.0 * u == pytest.approx(voltage, abs=1e-9)


def test_readings_beyond_the_range_are_no_measurements_and_are_named():
    block = sensor()
    assert math.isfinite(block.step(65535.0)) and not block.complaint
    assert math.isnan(block.step(65536.0)) and math.isnan(block.step(-0.5))
    said = block.complaint
    assert said.startswith("the sensor reads -0.5 count, beyond") and "(2 such readings so far)" in said
    assert math.isfinite(block.step(0.0)) and not block.complaint
    assert math.isnan(block.step(math.nan)) and not block.complaint


@pytest.mark.slow
@given(st.floats(1000.0, 60000.0), st.floats(1000.0, 60000.0))
def test_a_relative_sensor_counts_from_the_mean_of_the_readings_at_home(start, later):
    block, absolute = sensor(reference="relative", home=3e-6, homing_samples=2), sensor()
    assert math.isnan(block.step(start - 10.0)) and block.homing
    assert math.isnan(block.step(math.nan)) and block.homing, "an invalid reading was counted"
    assert math.isnan(block.step(start + 10.0)) and not block.homing
    home = 0.5 * (absolute.step(start - 10.0) + absolute.step(start + 10.0))
    assert block.step(later) == pytest.approx(absolute.step(later) - home + 3e-6, abs=1e-17)
    block.begin_homing()
    assert [math.isnan(block.step(later)) for _ in range(3)] == [True, True, False]
    assert block.step(later) == pytest.approx(3e-6, abs=1e-17)


@example([0.0, 1.0, 0.0, 0.0], 0.0, 1.0)
@example([0.0, 0.0, 0.0, -1.0, 5e-324], 0.0, 1.0)
@given(
    st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=6),
    st.floats(-3.0, 0.0),
    st.floats(0.5, 3.0),
)
def test_a_polynomial_is_refused_exactly_when_it_does_not_rise(coefficients, low, span):
    values = {"polynomial": coefficients, "minimum": low, "maximum": low + span}
    slopes = np.polynomial.Polynomial(coefficients).deriv()(np.linspace(low, low + span, 4001))
    if np.min(slopes) > 1e-3:
        SensorCalibrationParameters.from_mapping(values)
    elif np.min(slopes) < -1e-3:
        with pytest.raises(ParameterError, match="must rise everywhere"):
            SensorCalibrationParameters.from_mapping(values)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sensor.scale": 0.0}, r"sensor\.scale = 0\.0: out of range"),
        ({"sensor.sign": 0}, r"sensor\.sign = 0: must be 1 or -1"),
        ({"sensor.scale": 1.0}, r"is 1 m per count: give the displacement per count"),
        ({"sensor.minimum": 65535.0}, r"sensor\.minimum = 65535\.0: must be below maximum = 65535 count"),
        ({"sensor.minimum": 0.0, "sensor.maximum": 0.0}, "needs the range of readings in which it is valid"),
        ({"sensor.polynomial": [0.0, 1.0, -1.0e-5]}, r"slope -0\.311 at 65535 count: fit a lower order"),
        # it rises at both ends
        ({"sensor.polynomial": [0.0, 2.5, -3.0, 1.0], "sensor.maximum": 2.0}, r"slope -0\.5 at 1 count"),
        ({"sensor.polynomial": [0.0, -1.0]}, "use sign for a reversed direction"),
        ({"sensor.polynomial": [0.0, 1.0, 1.0e300, 1.0e308]}, "must rise everywhere"),
        ({"sensor.polynomial": [0.0] * 9}, "more than 8 coefficients"),
        ({"amplifier.unit": "count"}, r"amplifier\.scale = 1\.0: is 1 V per count"),
    ],
)
def test_what_is_wrong_is_named(changes, words):
    with pytest.raises(ParameterError, match=words):
        CalibrationParameters.from_mapping({**GAUGE, **changes})
