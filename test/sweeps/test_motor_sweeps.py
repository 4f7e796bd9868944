# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sweeps of inchworm motors: the worst of their moves, and the metrics of each kind of axis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sweep_support import axis

from hysteresis_ros.analysis.inchworm import inchworm_figures
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.sweeps import study
from hysteresis_ros.laboratory.sweeps.plan import parse_variations, varied
from hysteresis_ros.laboratory.sweeps.study import NOT_ARRIVED, Study, require_metrics
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate


def motor(duration=0.3):
    """An inchworm that goes 6 µm forward and 2 µm back."""
    schedule = {"setpoints.times": [0.02, 0.16], "setpoints.values": [6e-6, 4e-6]}
    return single_axis(load_configuration("inchworm_travel").override("inchworm_sequencer", **schedule)).with_duration(
        duration
    )


def test_a_motor_is_judged_by_the_worst_of_its_moves():
    stage = motor()
    variations = parse_variations(["plant_simulator.gain=±5%"], stage)
    points = np.array([[0.1], [0.9]])
    study = Study(stage, variations, ("final_error_max_m", "time_s", "not_arrived", "steps", "voltage_variation_v"))
    rows = study.runs(0, points).rows
    for row, point in zip(rows, points, strict=True):
        alone = inchworm_figures(simulate(varied(stage, variations, point)))
        moves = alone["moves"]
        assert [move["setpoint_m"] for move in moves] == [6e-6, 4e-6]
        worst = [max(move[name] for move in moves) for name in ("final_error_max_m", "time_s")]
        assert row == [*worst, 0.0, alone["run"]["steps"], alone["voltage_variation_v"], 0.0]
    assert rows[1][1] < rows[0][1]  # longer steps reach the setpoint sooner


def test_a_motor_that_does_not_arrive_has_no_final_error():
    stage = motor(0.18)  # the second move has just begun
    variations = parse_variations(["plant_simulator.gain=±5%"], stage)
    study = Study(stage, variations, ("not_arrived", "final_error_rms_m", "time_s", "steps_forward"))
    (row,) = study.runs(0, np.array([[0.5]])).rows
    assert row[0] == 1.0 and np.isnan(row[1]) and np.isnan(row[2]) and row[3] > 0.0


def test_metrics_are_those_of_the_kind_of_axis():
    assert require_metrics([], motor()) == ("final_error_rms_m",) and require_metrics([], axis()) == ("rms_error_m",)
    with pytest.raises(ConfigurationError, match="rms_error_m: unknown metric of an inchworm motor; there"):
        require_metrics(["rms_error_m"], motor())
    with pytest.raises(ConfigurationError, match="not_arrived: unknown metric of an actuator"):
        require_metrics(["not_arrived"], axis())


@pytest.mark.parametrize("missed", [False, True])
def test_the_worst_move_counts_and_the_slowest_walk(monkeypatch, missed):
    names = ("final_error_rms_m", "final_error_max_m", "time_s", "overshoot_m", "walking_speed_m_s", NOT_ARRIVED)
    tables = [(3e-9, 9e-9, 0.5, 1e-9, 2e-6), (5e-9, 6e-9, 0.2, 4e-9, 7e-6), (1e-9, 2e-9, 0.1, 2e-9, None)]
    moves = [dict(zip(names, values, strict=False), setpoint_m=1e-6, outcome="arrived") for values in tables]
    moves[2]["outcome"] = "not arrived" if missed else "arrived"
    # a motion without a setpoint is no move
    moves.append(dict.fromkeys(names, 1.0) | {"setpoint_m": None, "outcome": "stopped"})
    monkeypatch.setattr(study, "inchworm_run", lambda recording, settings: None)
    monkeypatch.setattr(study, "figures_of", lambda run, recording: {"moves": moves, "run": {}})
    time = np.arange(3.0)
    found = study.judged_motor({"time": time, "measured": time}, None, names)
    arrivals = [math.nan] * 3 if missed else [5e-9, 9e-9, 0.5]
    np.testing.assert_array_equal(found, [*arrivals, 4e-9, 2e-6, float(missed)])
