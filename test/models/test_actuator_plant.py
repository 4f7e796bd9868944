# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The complete plant: order of its parts, preload, state, and equal numbers compiled and interpreted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from actuator_support import PARAMETERS, SAMPLE_TIME, drive, outputs, run
from interpreted import interpreted

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters, PreloadParameters
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis, assumed_stack
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.sensor import SensorParameters


def test_preload_offset_is_the_stated_stiffness():
    """5.88 N on 0.41 N/µm compress the stack by 14.3 µm (K3)."""
    assert PARAMETERS.preload.offset == pytest.approx(-14.34e-6, abs=0.01e-6)
    quadratic = PreloadParameters(force=2.0, A1=1e-6, B1=-2e-6, B2=0.25e-6)
    assert quadratic.offset == pytest.approx(-2e-6)


def test_at_rest_the_sensor_reads_the_preload():
    actuator = Actuator(replace(PARAMETERS, sensor=SensorParameters()), SAMPLE_TIME)
    np.testing.assert_allclose(run(actuator, np.zeros(5))[:, 0], PARAMETERS.preload.offset, rtol=1e-12)


def test_static_plant_is_the_hysteresis_one_sample_later():
    plain = ActuatorParameters(limits=LimitsParameters(minimum=-30.0, maximum=120.0), hysteresis=PARAMETERS.hysteresis)
    actuator = Actuator(plain, SAMPLE_TIME)
    voltages = np.clip(drive(), -30.0, 120.0)
    measured = run(actuator, voltages)[:, 0]
    expected = PolynomialHysteresis(assumed_stack(), SAMPLE_TIME).simulate(voltages)
    np.testing.assert_allclose(measured[1:], expected[:-1], atol=1e-18)


def test_dynamics_are_behind_the_hysteresis():
    slow = replace(PARAMETERS, sensor=SensorParameters(), preload=PreloadParameters())
    actuator = Actuator(slow, SAMPLE_TIME)
    run(actuator, np.full(2000, 120.0))
    actuator.measure()
    assert actuator.displacement == pytest.approx(12.3e-6, rel=1e-9)
    assert actuator.voltage == pytest.approx(120.0)


def test_starts_at_rest_where_the_range_excludes_zero():
    above = replace(PARAMETERS, limits=LimitsParameters(minimum=6.0, maximum=120.0), sensor=SensorParameters())
    y = run(Actuator(above, SAMPLE_TIME), np.full(20, 6.0))[:, 0] - PARAMETERS.preload.offset
    np.testing.assert_allclose(y, 6.0 * 0.1025e-6, rtol=1e-9)


def test_reset_and_restored_state_repeat_exactly():
    actuator = Actuator(PARAMETERS, SAMPLE_TIME)
    first = run(actuator, drive())
    kept = actuator.state
    ahead = run(actuator, drive())
    actuator.reset()
    np.testing.assert_array_equal(run(actuator, drive()), first)
    other = Actuator(PARAMETERS, SAMPLE_TIME)
    other.state = kept
    np.testing.assert_array_equal(run(other, drive()), ahead)


def test_retune_keeps_the_displacement_and_refuses_another_type():
    actuator = Actuator(replace(PARAMETERS, sensor=SensorParameters()), SAMPLE_TIME)
    run(actuator, np.full(300, 70.0))
    before = actuator.measure()
    changed = HysteresisParameters(type="polynomial", polynomial=assumed_stack(scale=1.05))
    actuator.retune(replace(actuator.parameters, hysteresis=changed))
    assert actuator.measure() == before
    assert run(actuator, np.full(300, 70.0))[-1, 0] == pytest.approx(before, abs=1e-15)
    proportional = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=1e-7))
    with pytest.raises(ParameterError, match="hysteresis.type.*fixed"):
        actuator.retune(replace(actuator.parameters, hysteresis=proportional))


def test_every_wrong_parameter_is_named_with_its_place():
    with pytest.raises(ParameterError) as caught:
        ActuatorParameters.from_mapping(
            {"limits.minimum": 0.0, "limits.maximum": -1.0, "hysteresis.type": "proportional", "sensor.noise": -1.0}
        )
    assert "sensor.noise" in str(caught.value)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
def test_compiled_equals_interpreted(tmp_path):
    other = interpreted("actuator_support", "outputs()", tmp_path)
    np.testing.assert_allclose(outputs(), other, rtol=0, atol=1e-12 * 12.3e-6)
