# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A fused axis whose plant limited its voltage: the recorded voltage is the output, and the return to the path ends."""

from __future__ import annotations

import numpy as np
from loop_support import assert_same_bits, parameters

from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.watch import STALE

RATE = 200.0
FAST = {
    "plant_simulator": {"voltage_timeout": 0.1, "safe_slew_rate": 1.0, "late_limit": -1},
    "hysteresis_compensator": {"safe_slew_rate": 1.0},
    "reference_generator": {
        "waveform__type": "triangle",
        "waveform__amplitude": 15e-6,
        "waveform__frequency": 2.0,
        "initial_setpoint": 20e-6,
        "maximum": 44e-6,
    },
}


def made(time_mode, skipped, **more):
    given = parameters("picma_stage", every={"time_mode": time_mode}, **(FAST | more))
    axis = Axis(given)
    return axis.run(axis.default_setpoints(len(skipped)), skipped=skipped)


def test_after_samples_that_were_missed_until_the_plant_went_to_safe_the_way_back_ends_and_everything_is_true():
    skipped = np.zeros(2000)
    skipped[600:700] = 1.0
    table = made("fused", skipped)
    plain = made("fused", np.zeros(2000))
    held = table["plant_mode"] == STALE
    assert np.flatnonzero(held)[0] == 619 and np.flatnonzero(held)[-1] == 699
    # the triangle requires about 6 V/s, the return has 1 V/s
    assert np.ptp(plain["voltage"][700:]) > 1.0 and np.max(np.abs(np.diff(plain["voltage"][700:]))) > 2.5 * 1.0 / RATE
    np.testing.assert_allclose(table["voltage"], table["plant_voltage"], rtol=0.0, atol=1e-9)
    # requested and output voltage differ at most in the first sample of the return
    assert np.all(table["saturated"][held] == 1.0) and np.sum(table["saturated"][700:]) <= 3
    error = np.abs(table["displacement"] - table["reference"])
    before = np.max(np.abs(plain["displacement"] - plain["reference"])[1600:])
    assert np.max(error[600:800]) > 5e-6
    assert np.max(error[1600:]) < 1.2 * before
    # the twin gives the same
    assert_same_bits(table, made("fused", skipped))


def test_without_a_cut_the_fused_loop_is_that_of_the_nodes_bit_for_bit():
    skipped = np.zeros(1500)
    skipped[400:410] = 1.0
    for limits in ({}, {"plant_simulator": FAST["plant_simulator"] | {"limits__bits": 12}}):
        assert_same_bits(made("fused", skipped, **limits), made("realtime", skipped, **limits))
