# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Use of a measured response in a design and in a model: margins from measured lines, and its own dynamics."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.designs.controller import DesignRequest, design_axis, response_uncertainty
from hysteresis_ros.designs.frequency_response import measured_loop_parts
from hysteresis_ros.designs.measured import (
    measured_lines,
    measured_margins,
    measured_uncertainty,
    with_measured_dynamics,
)
from hysteresis_ros.errors import ConfigurationError, IdentificationError
from hysteresis_ros.identification.frequency_response import Analysis, Distortion, FrequencyResponse, save_response
from hysteresis_ros.loop.reach import single_axis

LINES = np.concatenate([np.arange(1.0, 500.0, 3.0), np.arange(500.0, 800.0, 1.0), np.arange(800.0, 1200.0, 5.0)])


def response(late=0, noise=1e-3, gain=1.0, unit="m", rate=3000.0, last=1200.0):
    """Return the measured response of Kim's dynamics, some samples later."""
    _, plant = measured_loop_parts(single_axis(load_configuration("kim2009")))
    frequency = LINES[: np.searchsorted(LINES, last)]
    z = np.exp(2j * np.pi * frequency / rate)
    G = gain * plant.response(z)[:, 0, 0] * z**-late
    random = np.random.default_rng(1)
    sigma = noise * np.abs(G)
    G = G + sigma * (random.standard_normal(G.size) + 1j * random.standard_normal(G.size)) / np.sqrt(2.0)
    found = FrequencyResponse(frequency, G[:, None, None], 1.0 / rate, (sigma**2)[:, None, None], input_unit=unit)
    levels = Distortion(sigma, 0.0 * sigma, 0.0 * sigma)
    return Analysis(FrequencyResponse(**{**vars(found), "degrees": 8.0}), levels, "multisine")


def designed(measured):
    axis = single_axis(load_configuration("kim2009"))
    return axis, design_axis(axis, DesignRequest("pid"), measured_uncertainty(axis, measured))


@pytest.mark.parametrize("unit, gain", [("m", 1.0), ("V", 9e-8)])
def test_margins_on_the_measured_plant_stand_beside_those_of_the_model(unit, gain):
    measured = response(unit=unit, gain=gain)
    axis, result = designed(measured)
    loop = measured_margins(axis, result.parameters, measured)
    assert loop.delay_margin.value == pytest.approx(result.margins.delay_margin_samples, rel=0.01)
    assert loop.sensitivity_peak.value == pytest.approx(result.margins.sensitivity_peak, rel=0.01)
    assert measured_lines(axis, result, measured)[0].startswith("measured gain crossover")
    assert not any(line.startswith("note") for line in measured_lines(axis, result, measured))
    # with noise the intervals contain worse margins than the required ones; that alone is no reason for a note
    noisy = response(unit=unit, gain=gain, noise=0.1)
    peak = measured_margins(axis, result.parameters, noisy).sensitivity_peak
    assert peak.low < 2.0 < peak.high
    assert not any(line.startswith("note") for line in measured_lines(axis, result, noisy))


@pytest.mark.slow
def test_two_samples_that_the_model_does_not_know_are_said_and_a_model_with_them_bears_them():
    measured = response(late=2)
    axis, result = designed(response())
    late = measured_margins(axis, result.parameters, measured)
    assert result.margins.delay_margin_samples - late.delay_margin.value == pytest.approx(2.0, abs=0.02)
    assert "update its dynamics" in measured_lines(axis, result, measured)[-1]
    found = with_measured_dynamics(load_configuration("kim2009"), None, measured, "late.npz")
    path_free = single_axis(parse_configuration(found.text, "written"))
    assert path_free.motion_controller.model.dynamics.order >= 5 and path_free.plant_simulator.dynamics.order >= 5
    assert path_free.plant_simulator.hysteresis == axis.plant_simulator.hysteresis
    assert found.figures["rmse_of_response_percent"] < 1.0
    again = design_axis(path_free, DesignRequest("pid"), measured_uncertainty(path_free, measured))
    loop = measured_margins(path_free, again.parameters, measured)
    assert loop.sensitivity_peak.value == pytest.approx(again.margins.sensitivity_peak, rel=0.02)
    assert loop.delay_margin.value == pytest.approx(again.margins.delay_margin_samples, rel=0.02)
    assert not again.margins.misses()


def test_the_uncertainty_is_how_far_model_and_measurement_are_apart():
    found = measured_uncertainty(single_axis(load_configuration("kim2009")), response(late=1, noise=1e-4))
    assert found.at([300.0, 900.0]) == pytest.approx(2.0 * np.sin(np.pi * np.array([300.0, 900.0]) / 3000.0), rel=2e-3)
    wide = measured_uncertainty(single_axis(load_configuration("kim2009")), response(noise=0.05))
    assert np.median(wide.relative) == pytest.approx(0.05 * (np.sqrt(4.0) + np.sqrt(np.log(2.0))), rel=0.15)


@pytest.mark.slow
def test_a_design_is_slowed_where_nothing_was_measured():
    # up to 200 Hz only: there may be a resonance above
    _, slow = designed(response(last=200.0))
    assert slow.margins.bandwidth < 0.8 * 262.6, "below the bandwidth that the model alone would allow"
    found = with_measured_dynamics(load_configuration("kim2009"), None, response(last=800.0), "narrow.npz")
    known = response_uncertainty(parse_configuration(found.text, "written"))
    assert known.known_to == 799.0 and known.at([600.0])[0] < 0.02 and known.at([1499.0])[0] > 1.0


@pytest.mark.slow
def test_what_does_not_fit_the_axis_is_refused(tmp_path):
    axis = single_axis(load_configuration("kim2009"))
    with pytest.raises(ConfigurationError, match="measured at a sample rate of 2000 Hz, but the axis runs at 3000 Hz"):
        measured_uncertainty(axis, response(rate=2000.0, last=900.0))
    with pytest.raises(IdentificationError, match="order 0: must be within 1"):
        with_measured_dynamics(load_configuration("kim2009"), None, response(), "a.npz", 0)
    path = tmp_path / "response.npz"
    save_response(path, response(), {}, {})

    def hysteresis(*words):
        return CliRunner().invoke(main, [str(word) for word in words])

    result = hysteresis("identify", path, "-o", tmp_path / "a.yaml")
    assert result.exit_code == 2 and "give --into CONFIG" in result.output
    result = hysteresis("identify", path, "--into", "kim2009", "-o", tmp_path / "a.yaml")
    assert result.exit_code == 0 and "mode_1" in result.output
    result = hysteresis(
        "design", tmp_path / "a.yaml", "--controller", "pid", "--response", path, "-o", tmp_path / "b.yaml"
    )
    assert result.exit_code == 0 and "measured delay margin" in result.output, result.output
    result = hysteresis("design", "kim2009", "--controller", "pid", "--response", "no.npz", "-o", tmp_path / "b.yaml")
    assert result.exit_code == 2 and "no.npz: no such file" in result.output
