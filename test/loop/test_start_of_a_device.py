# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The voltage of a device moves from its safe value to the value that the reference needs, without the other rail."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.plant import ActuatorPlant
from hysteresis_ros.loop.reach import single_axis

#: Displacement of the model at 0 V, and reference [m]: a range on both sides of zero, as an identified offset gives it.
AT_REST, REFERENCE = -9e-6, 0.0


@pytest.fixture
def axis(monkeypatch) -> Axis:
    """An axis that begins at its safe voltage, as a device does, with a PID that calculates back from the limits."""
    monkeypatch.setattr(ActuatorPlant, "begins_safe", True)
    models = {"hysteresis__prandtl_ishlinskii__offset": AT_REST}
    wide = {"limits__minimum": -20.0, "safe_slew_rate": 140.0}
    configuration = (
        load_configuration("picma_stage")
        .override("plant_simulator", **models, **wide)
        .override("hysteresis_compensator", **models, **wide)
        .override("motion_controller", type="pid", pid__Kp=0.1, pid__Ki=60.0)
        .override("reference_generator", minimum=-5e-6, waveform__type="hold", initial_setpoint=REFERENCE)
    )
    return Axis(single_axis(configuration))


def restarted(action: str, samples: int) -> list[Change]:
    """Changes of a run: at half of its samples a stop and a start after the voltage is safe, or a reset."""
    begin = samples // 2
    if action == "reset":
        nodes = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
        return [Change(begin, node, "reset") for node in nodes]
    return [Change(begin, "plant_simulator", "halt"), Change(begin + samples // 4, "plant_simulator", "start")]


@pytest.mark.parametrize("action", ["start", "reset"])
def test_the_voltage_of_a_device_begins_at_its_safe_value_and_goes_the_right_way(axis, action):
    samples = 4 * round(axis.sample_rate)
    table = axis.run(np.full(samples, REFERENCE), changes=restarted(action, samples))
    voltage = table["voltage"]
    # 9 µm above its rest, the axis needs 0.8 V
    assert voltage[samples // 2 - 1] == pytest.approx(0.8, abs=0.1) == voltage[-1]
    assert voltage.min() > -0.01 and np.max(np.abs(np.diff(voltage[: samples // 2]))) < 0.1
    np.testing.assert_allclose(table["measured"][-20:], REFERENCE, atol=0.1e-6)
