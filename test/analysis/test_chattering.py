# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Chattering and effort: closed forms, and the ranking of control laws that theory predicts."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from hysteresis_ros.analysis.metrics import chattering_figures, compute_metrics
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings import Recording

CONFIG = pathlib.Path(__file__).resolve().parents[2] / "config" / "kim2009.yaml"
RATE = 1000.0


def figures(reference, command, voltage=None):
    time = np.arange(len(reference)) / RATE
    return chattering_figures(time, np.asarray(reference), np.asarray(command), voltage)


def test_a_command_that_alternates_has_its_amplitude_as_chattering():
    k = np.arange(1001)
    found = figures(np.full(1001, 1e-6), 1e-6 + 3e-9 * (-1.0) ** k)
    assert found["chattering_m"] == pytest.approx(3e-9)
    assert found["chattering_m_s"] == pytest.approx(6e-9 * RATE)
    assert found["command_reversals_hz"] == pytest.approx(999 / 1.0)


def test_a_command_that_is_the_reference_does_not_chatter():
    k = np.arange(2001)
    for reference in (
        1e-6 * np.sin(2 * np.pi * k / 1000),
        1e-9 * (500 - np.abs(k % 1000 - 500)),
        np.repeat([0, 1e-6, 0], 667),
    ):
        found = figures(reference, reference)
        assert found["chattering_m"] < 1e-4 * np.ptp(reference)
        assert found["chattering_m_s"] == 0.0
        assert found["command_reversals_hz"] == 0.0


def test_a_jump_of_the_reference_is_not_chattering_but_what_goes_on_after_it_is():
    reference = np.repeat([0.0, 1e-6], 500)
    ringing = np.append(np.zeros(500), 1e-6 * (1.0 + (-0.5) ** np.arange(500)))
    assert figures(reference, ringing)["chattering_m"] < 1e-4 * 1e-6
    lasting = np.append(np.zeros(500), 1e-6 * (1.0 + 0.01 * (-1.0) ** np.arange(500)))
    assert figures(reference, lasting)["chattering_m"] == pytest.approx(0.01e-6 * np.sqrt(0.5), rel=0.03)


def test_ten_samples_after_a_jump_do_not_count():
    reference = np.repeat([0.0, 1e-6], 500)
    for place in (505, 509, 510, 520):
        command = reference.copy()
        command[place] += 1e-8  # uneven at this sample and at both beside it
        counted = sum(sample > 510 for sample in (place - 1, place, place + 1))
        assert (figures(reference, command)["chattering_m"] > 1e-12) is bool(counted), place


def test_effort_of_a_ramp_and_a_triangle():
    ramp = 5.0 * np.arange(1001) / RATE
    found = figures(np.zeros(1001), np.zeros(1001), ramp)
    assert found["voltage_rate_v_s"] == pytest.approx(5.0)
    assert found["voltage_variation_v"] == pytest.approx(5.0)
    triangle = np.append(ramp, ramp[-2::-1])
    found = figures(np.zeros(2001), np.zeros(2001), triangle)
    assert found["voltage_rate_v_s"] == pytest.approx(5.0)
    assert found["voltage_variation_v"] == pytest.approx(10.0)


def test_what_is_not_recorded_is_said():
    time = np.arange(50) / RATE
    found = compute_metrics(Recording.from_columns({"time": time, "reference": time, "displacement": time}, None))
    assert found["chattering_m"] is None and "command" in found["notes"]["chattering_m"]
    assert found["voltage_rate_v_s"] is None and "voltage" in found["notes"]["voltage_rate_v_s"]


@pytest.mark.slow
def test_discontinuous_law_chatters_more_than_boundary_layer_and_implicit_super_twisting():
    """Kim's axis with a wrong compensator: the same level β as a sign function, and in a boundary layer of width δ."""
    base = load_configuration(CONFIG).override("hysteresis_compensator", hysteresis__polynomial__scale=1.05)
    estimating = dict(kalman__gain="riccati", kalman__q=0.685, kalman__disturbance="constant")
    sign = dict(type="sliding_mode", sliding_mode__beta=0.02, sliding_mode__delta=0.0)
    twisting = dict(type="super_twisting", super_twisting__bound=10.0)
    laws = {
        "sign": sign,
        "layer": sign | dict(sliding_mode__delta=0.05),
        "explicit": twisting | dict(super_twisting__discretisation="explicit"),
        "implicit": twisting,
    }
    found = {}
    for name, law in laws.items():
        axis = single_axis(base.override("motion_controller", **estimating, **law)).with_duration(1.6)
        found[name] = compute_metrics(simulate(axis))
    for figure in ("chattering_m", "chattering_m_s"):
        values = {name: run[figure] for name, run in found.items()}
        assert values["sign"] > 3 * max(values["layer"], values["implicit"]), (figure, values)
        assert values["explicit"] > values["implicit"], (figure, values)
    reversals = {name: run["command_reversals_hz"] for name, run in found.items()}
    assert reversals["sign"] == max(reversals.values())
    assert found["sign"]["voltage_rate_v_s"] > found["layer"]["voltage_rate_v_s"]
