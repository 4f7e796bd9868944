# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification and validation as functions: from arrays to a parameter file, and messages for wrong calls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

import hysteresis_ros as hr
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.identification.workflow import identify, validate
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters

STACK = PrandtlIshlinskiiParameters(radii=(0.0, 10.0, 20.0, 30.0), weights=(8e-8, 1e-8, 6e-9, 4e-9))


def loops(peak: float = 100.0, constant: float = 0.0) -> IdentificationData:
    """Two cycles and a decay, sampled at 200 Hz, each displacement with the voltage of its own sample."""
    time = np.arange(1600) / 200.0
    voltage = 0.5 * peak * (1.0 - np.where(time < 2.0, 1.0, np.exp((2.0 - time) / 3.0)) * np.cos(2.0 * np.pi * time))
    noise = 2e-9 * np.random.default_rng(0).standard_normal(time.size)
    displacement = PrandtlIshlinskiiHysteresis(STACK, 1.0).simulate(voltage) + noise + constant
    return IdentificationData(time, voltage, displacement, source="arrays")


@pytest.mark.slow
def test_from_arrays_to_a_file_that_predicts_other_arrays(tmp_path):
    reports = []
    found = identify(
        loops(), options={"zone_count": 0, "play_count": 12}, progress=lambda number, text: reports.append(number)
    )
    assert found.converged and found.reason == "" and reports
    assert found.figures["rmse_m"] == found.validation.rmse < 1e-8
    assert found.parameters is found.plant.hysteresis.prandtl_ishlinskii and len(found.parameters.radii) <= 12
    assert found.parameters.thresholds == ()
    np.testing.assert_allclose(found.predicted, loops().output, atol=5e-8)
    found.save(tmp_path / "axis.yaml")
    assert (tmp_path / "axis.yaml").read_text(encoding="utf-8") == found.text
    # no written file moves a stage without limits
    assert all(f"      {name}: " in found.text for name in ("slew_rate", "maximum_velocity", "maximum_jerk"))
    other = validate(tmp_path / "axis.yaml", loops(80.0), skip=50)
    assert other.figures["rmse_m"] < 1.5e-8 and other.figures["inverse_rmse_v"] < 0.2
    assert other.validation.skipped == 50 and other.figures["identified_from"] == "arrays"
    assert validate(tmp_path / "axis.yaml", loops(80.0), inverse=False).inverse is None
    with pytest.raises(IdentificationError, match="cannot be written"):
        found.save(tmp_path / "nowhere" / "axis.yaml")


@pytest.mark.slow
def test_a_free_constant_is_kept_out_of_the_file():
    few = {"zone_count": 0, "play_count": 8}
    kept, free = (identify(loops(constant=5e-6), offset=offset, options=few) for offset in ("kept", "free"))
    assert "A1:" in kept.text
    assert "A1:" not in free.text and free.plant.offset == 0.0
    assert free.validation.offset == pytest.approx(kept.plant.offset, abs=1e-7)


@pytest.mark.slow
def test_a_fit_that_does_not_converge_gives_its_best_point_and_the_reason():
    found = identify(loops(), "bouc_wen", linear="none", options={"iterations": 4})
    assert not found.converged and "did not converge" in found.reason and found.warnings[0] == found.reason
    assert "converged: false" in found.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"skipped": 3}, "skipped: unknown condition; there are skip, offset"),
        ({"offset": "fitted"}, "offset = 'fitted': must be one of kept, free"),
        ({"options": {"plays": 3}}, "options of prandtl_ishlinskii"),
        ({"model": "preisac"}, "must be one of"),
        ({"intersample": "cubic"}, "cubic"),
    ],
)
def test_wrong_calls_are_refused_by_name(arguments, said):
    with pytest.raises(IdentificationError, match=said):
        identify(loops(), **arguments)


def test_columns_are_guessed_by_name_and_it_is_said(tmp_path):
    data = loops()
    table = np.column_stack([data.time, data.input, 0.5 * data.input, data.output * 1e6])
    path = tmp_path / "table.csv"
    np.savetxt(path, table, delimiter=",", header="t_s,control_V,monitor_V,gauge_um", comments="")
    reading = read_data(path)
    assert reading.guessed[0].startswith("assumed input: column 'control_V'")
    assert read_data(reading) is reading
    chosen = read_data(path, Columns(input="monitor_V:V", range=(100, 900), resample=0.01, negate=True))
    assert len(chosen.data) == 400 and chosen.data.input_name == "monitor_V" and chosen.data.output.max() <= 0.0
    volts = Columns(input="control_V:V", output="monitor_V:V")
    with pytest.raises(IdentificationError, match="give its sensitivity"):
        read_data(path, volts)
    assert read_data(path, replace(volts, output_unit="V")).data.output_unit == "V"


@pytest.mark.slow
def test_the_file_says_for_which_sample_time_its_dynamics_are():
    time = np.arange(2000) / 500.0
    voltage = 2.0 - 2.0 * np.cos(2 * np.pi * time)
    output = 1e-6 * scipy.signal.lfilter([0.05], [1.0, -0.95], voltage)
    found = identify(IdentificationData(time, voltage, output), "proportional", linear="lag")
    configuration = parse_configuration(found.text, "identified")
    for node, name in (("plant_simulator", "dynamics"), ("motion_controller", "model.dynamics")):
        section = configuration.node(node)
        assert section[f"{name}.A"] and section[f"{name}.sample_time"] == pytest.approx(1.0 / section["sample_rate"])
        assert section["sample_rate"] == pytest.approx(500.0)


@pytest.mark.slow
def test_validation_leaves_out_the_start_as_identification_does(tmp_path):
    found = identify(loops(), "proportional", linear="none")
    found.save(tmp_path / "axis.yaml")
    left_out = found.figures["skipped"]
    assert left_out > 0 and validate(tmp_path / "axis.yaml", loops()).figures["skipped"] == left_out
    assert validate(tmp_path / "axis.yaml", loops(), initial="zero").figures["skipped"] == 0
    assert validate(tmp_path / "axis.yaml", loops(), skip=7).figures["skipped"] == 7
    assert "omitted" in validate(tmp_path / "axis.yaml", loops()).figures["start"]


@pytest.mark.slow
def test_validation_counts_a_first_rise_from_rest_as_identification_does():
    cycle = 0.5 - 0.5 * np.cos(np.linspace(0.0, 2.0 * np.pi, 200))
    voltage = np.concatenate([100.0 * cycle, 80.0 * cycle, 50.0 * cycle])
    displacement = hr.models.BoucWen.example().simulate(voltage)
    data = IdentificationData(np.arange(voltage.size) * 1e-3, voltage, displacement)
    found = identify(data, "prandtl_ishlinskii", linear="none", options={"play_count": 8, "zone_count": 0})
    checked = validate(found, data)
    assert found.figures["start"].startswith("at rest at 0 V before the recording, which explains its beginning")
    for name in ("start", "skipped", "rmse_m"):
        assert checked.figures[name] == found.figures[name]
    assert validate(found, data, skip=30).figures["start"] == "as requested: the first 30 samples omitted"
