# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The failure of a device remains the reported reason, whatever is requested of the axis afterwards."""

from __future__ import annotations

import numpy as np
from driven_support import parameters, run

from hysteresis_ros.loop.device import DrivenPlant
from hysteresis_ros.loop.plant import DEVICE_FAILED, TRIP


def test_an_emergency_stop_does_not_hide_that_the_device_has_failed(device):  # noqa: F811
    plant = DrivenPlant(parameters())
    run(plant, np.full(20, 30.0))
    device.failing = "read"
    run(plant, np.full(2, 30.0))
    assert plant.tripped and "unplugged" in plant.failure
    plant.halt()
    assert not plant.halted and plant._watch_x.trip[TRIP] == DEVICE_FAILED
    # after a stop by hand, a failure becomes the reason
    other = DrivenPlant(parameters())
    device.failing = ""
    run(other, np.full(20, 30.0))
    other.halt()
    assert other.halted
    device.failing = "write"
    run(other, np.full(2, 30.0))
    assert not other.halted and "unplugged" in other.failure


def test_the_watchdog_of_a_device_is_told_the_voltage_that_is_put_out(device):  # noqa: F811
    plant = DrivenPlant(parameters())
    run(plant, np.full(400, 30.0))
    device.last.heard.clear()
    plant.refresh()
    assert device.last.heard == [30.0]
    assert plant.step_to_safe()
    assert device.last.heard[-1] < 30.0
