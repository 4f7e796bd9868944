# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of the learning for an axis: its closed loop, its performance on another plant, and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command_support import refusal
from force_support import IFF

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import close
from hysteresis_ros.control.uncertainty import ALIASED, ResponseUncertainty, drawn_plants
from hysteresis_ros.designs.controller import DesignRequest, design_axis, design_file
from hysteresis_ros.designs.learning import (
    POSSIBLE,
    LearningRequest,
    MeasuredPlant,
    closed_loop,
    design_learning,
    expected_error,
    learning_file,
    learning_lines,
    with_known_noise,
)
from hysteresis_ros.identification.parameter_file import SECTION
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearParameters

NEAR = replace(POSSIBLE, draws=2)


def stage(**controller):
    found = load_configuration("picma_stage").override("motion_controller", **controller)
    waveform = {"waveform.type": "triangle", "waveform.frequency": 5.0, "waveform.amplitude": 8e-6}
    found = found.override("reference_generator", **waveform, initial_setpoint=1e-5)
    return parse_configuration(single_axis(found).configuration_text(), "stage.yaml")


@pytest.mark.parametrize("name", ["kim2009", "picma_stage"])
def test_the_closed_loop_is_that_of_the_state_space_on_the_model_and_on_every_other_plant(name):
    node = single_axis(load_configuration(name)).motion_controller
    assert node.feedforward.type == "none"
    found = closed_loop(node, NEAR)
    z = np.exp(1j * np.linspace(0.0, np.pi, len(found.model))[1::97])
    controller, model = linear_loop(part(node, ControllerParameters), 1.0 / node.sample_rate)
    plants = drawn_plants(node.model.dynamics, 1.0 / node.sample_rate, NEAR)
    np.testing.assert_allclose(found.model[1::97], close(controller, model).response(z)[:, 0, 0], rtol=1e-4, atol=1e-7)
    for values, one in zip(found.possible, plants, strict=True):
        exact = close(controller, one.plant).response(z)[:, 0, 0]
        np.testing.assert_allclose(values[1::97], exact, rtol=1e-4, atol=1e-7)


def test_a_damping_by_force_is_part_of_the_closed_loop():
    configuration = load_configuration("stage700").override("motion_controller", **IFF)
    node = single_axis(configuration).motion_controller
    found = closed_loop(node, NEAR).model
    z = np.exp(1j * np.linspace(0.0, np.pi, len(found))[1::97])
    exact = close(*linear_loop(part(node, ControllerParameters), 1.0 / node.sample_rate)).response(z)[:, 0, 0]
    np.testing.assert_allclose(found[1::97], exact, rtol=1e-4, atol=1e-7)


@pytest.mark.slow
def test_a_mode_that_may_be_an_alias_belongs_to_the_possible_plants():
    node = single_axis(stage(type="open_loop")).motion_controller
    radius, angle = 0.95, 2.0 * np.pi * 67.0 / 200.0
    A = (2.0 * radius * np.cos(angle), -(radius**2), 1.0, 0.0)
    found = {}
    for own in (A, (0.8, 0.0, 1.0, 0.0)):
        dynamics = LinearParameters(A=own, B=(1.0, 0.0), C=(0.1, 0.0), sample_time=1.0 / 200.0, output_scale=1e-6)
        found[own] = closed_loop(replace(node, model=replace(node.model, dynamics=dynamics)), NEAR).possible
    with_mode, without = found.values()
    assert len(with_mode) == len(without) + ALIASED
    # 8 % of 133 Hz is 10.7 Hz: the peaks of these plants lie around 67 Hz, and the others' within 5.4 Hz
    peaks = 100.0 * np.argmax(np.abs(with_mode), axis=1) / (with_mode.shape[1] - 1)
    assert np.ptp(peaks[len(without) :]) > 19.0 > 12.0 > np.ptp(peaks[: len(without)])


@pytest.mark.slow
def test_a_static_feedforward_is_part_of_the_closed_loop():
    node = single_axis(stage(type="open_loop")).motion_controller
    fed = single_axis(stage(type="open_loop", **{"feedforward.type": "static"})).motion_controller
    np.testing.assert_allclose(closed_loop(fed, NEAR).model, closed_loop(node, NEAR).model, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["inversion", "norm_optimal"])
def test_in_ten_periods_on_another_plant_the_error_falls_to_less_than_a_tenth(kind):
    configuration = stage()
    text = learning_file(configuration, design_learning(single_axis(configuration), LearningRequest(kind)), "")
    other = parse_configuration(text, "designed")
    axis = single_axis(other)
    assert axis.plant_simulator.limits.slew_rate > 0.0 and axis.hysteresis_compensator.limits.slew_rate > 0.0
    assert not axis.reference_generator.approach.unlimited
    dynamics = axis.plant_simulator.dynamics
    plant = replace(axis.plant_simulator, dynamics=replace(dynamics, input_scale=dynamics.resolved_input_scale / 1.05))
    made = Axis(replace(axis, plant_simulator=plant))
    run = made.run(made.default_setpoints(40 * 14))
    error = (run["reference"] - run["measured"]).reshape(14, 40)
    size = np.sqrt(np.mean(error**2, axis=1))
    assert np.max(size[11:]) < 0.1 * size[1]


def noisy(waveform, frequency, noise):
    """Return an axis with a reference of 8 µm whose sensor has noise [m]."""
    reference = {"waveform.type": waveform, "waveform.frequency": frequency, "waveform.amplitude": 8e-6}
    found = load_configuration("picma_stage").override("plant_simulator", sensor__noise=noise)
    return single_axis(found.override("reference_generator", **reference, initial_setpoint=2e-5))


def left(axis, parameters, period):
    """Return the RMS error of the true displacement [m] in the periods 21 to 24 of learning."""
    made = Axis(replace(axis, motion_controller=replace(axis.motion_controller, learning=parameters)))
    run = made.run(made.default_setpoints(24 * period))
    return float(np.std((run["reference"] - run["displacement"])[-4 * period :]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["inversion", "norm_optimal"])
def test_the_error_that_a_bandwidth_leaves_is_predicted(kind):
    axis, period = noisy("triangle", 5.0, 2e-7), 40
    for bandwidth in (10.0, 20.0, 40.0, 70.0):
        found = design_learning(axis, LearningRequest(kind, bandwidth=bandwidth, possible=NEAR))
        predicted = expected_error(axis, NEAR, found.response, period)(found.filters)
        assert predicted == pytest.approx(left(axis, found.parameters, period), rel=0.08), bandwidth


@pytest.mark.slow
@pytest.mark.parametrize(("waveform", "frequency", "gain"), [("sine", 1.0, 2.0), ("triangle", 5.0, 0.98)])
def test_noise_lowers_the_bandwidth_as_far_as_the_reference_permits(waveform, frequency, gain):
    axis, silent = (noisy(waveform, frequency, noise) for noise in (2e-8, 0.0))
    request, period = LearningRequest("inversion", possible=NEAR), round(200.0 / frequency)
    found, highest = (design_learning(one, request) for one in (axis, silent))
    assert highest.filters.highest == 0.0 and found.filters.highest in (0.0, highest.filters.bandwidth)
    assert left(axis, highest.parameters, period) > gain * left(axis, found.parameters, period)
    lines = "\n".join(learning_lines(found))
    assert ("noise would add more" in lines) == (found.filters.bandwidth < highest.filters.bandwidth)


@pytest.mark.slow
def test_nothing_is_learned_where_the_response_is_known_to_less_than_half():
    """Contraction on all plants of an error of 60 % would be slow at best, and none is left for other changes."""
    axis = noisy("triangle", 5.0, 0.0)
    for size, reached in ((0.4, (60.0, 100.0)), (0.6, (20.0, 42.0))):
        known = ResponseUncertainty(np.array([1.0, 39.9, 40.1, 100.0]), np.array([0.05, 0.05, size, size]), np.inf)
        found = design_learning(axis, LearningRequest("inversion", possible=NEAR), known)
        assert reached[0] < found.filters.bandwidth / found.sample_time < reached[1], size


def test_the_noise_that_an_identification_found_counts_unless_the_sensor_has_its_own():
    configuration = load_configuration("picma_stage")
    found = replace(configuration, entries=((SECTION, {"metrics.noise_rms_m": 2e-8}), *configuration.entries))
    for own, expected in ((0.0, 2e-8), (5e-9, 5e-9)):
        axis = single_axis(found.override("plant_simulator", sensor__noise=own))
        assert with_known_noise(axis, found).plant_simulator.sensor.noise == expected
    assert with_known_noise(axis, configuration) is axis


@pytest.mark.slow
@pytest.mark.parametrize("reference", [{"waveform.type": "hold"}, {"waveform.frequency": 0.7}])
def test_a_reference_that_rests_or_has_another_period_predicts_nothing(reference):
    configuration = load_configuration("picma_stage").override("plant_simulator", sensor__noise=2e-8)
    waveform = {"waveform.type": "sine", "waveform.frequency": 1.0, "waveform.amplitude": 8e-6, **reference}
    axis = single_axis(configuration.override("reference_generator", **waveform, initial_setpoint=2e-5))
    assert expected_error(axis, NEAR, closed_loop(axis.motion_controller, NEAR), 200) is None
    lines = "\n".join(learning_lines(design_learning(axis, LearningRequest("inversion", period=1.0, possible=NEAR))))
    assert "noise is weighed only for waveforms sine, triangle, square of 1 s in the file" in lines


@pytest.mark.slow
def test_a_late_sample_stops_learning_for_a_shorter_time_than_a_saturated_command():
    for name in ("stage700", "picma_stage"):
        axis = single_axis(load_configuration(name))
        request = LearningRequest("inversion", period=0.2, possible=replace(POSSIBLE, draws=1))
        given = design_learning(axis, request).parameters
        assert 0.0 < given.late_recovery <= given.recovery, name


@pytest.mark.slow
def test_the_noise_of_a_measured_response_does_not_prolong_the_pauses_of_learning():
    axis, request = single_axis(stage()), LearningRequest("inversion", period=0.2, bandwidth=20.0, possible=NEAR)
    random = np.random.default_rng(1)
    lines = np.linspace(1.0, 95.0, 95)
    noisy = MeasuredPlant(lines, 1.0 + 0.1 * (random.standard_normal(95) + 1j * random.standard_normal(95)))
    found, expected = (design_learning(axis, request, response).parameters for response in (noisy, None))
    assert (found.recovery, found.late_recovery) == (expected.recovery, expected.late_recovery)
    assert found.error_filter != expected.error_filter


@pytest.mark.slow
@pytest.mark.parametrize(
    "words, expected",
    [
        (["--learning", "inverson", "--period", 0.1], "did you mean inversion?"),
        (["--learning", "inversion"], "--period is missing: waveform.type"),
        (["--learning", "inversion", "--period", 0.0123], "2.46 samples"),
        (["--learning", "inversion", "--period", 0.1, "--controller", "pid"], "--controller and --learning exclude"),
        (["--learning", "inversion", "--period", 0.1, "--resonance-range", 0.9], "--resonance-range = 0.9"),
        (["--learning", "inversion", "--period", 0.1, "--bandwidth", 500], "below half the sample rate, 100 Hz"),
        (["--learning", "inversion", "--period", 0.1, "--delay-range", 16], "no bandwidth contracts"),
        (["--learning", "inversion", "--period", 0.1, "--maximum", 0], "--maximum 0"),
        (["--controller", "pid", "--period", 0.1], "--period belongs to --learning"),
        ([], "give --controller NAME or --learning NAME"),
    ],
)
def test_wrong_words_are_refused_in_one_line(tmp_path, words, expected):
    configuration = tmp_path / "stage.yaml"
    configuration.write_text(load_configuration("picma_stage").text)
    assert expected in refusal("design", configuration, *words, "-o", tmp_path / "out.yaml")
    assert not (tmp_path / "out.yaml").exists()


@pytest.mark.slow
def test_a_designed_file_keeps_all_else_and_another_controller_takes_the_learning_away():
    configuration = stage()
    text = learning_file(configuration, design_learning(single_axis(configuration), LearningRequest("inversion")), "")
    learned = parse_configuration(text, "learned")
    before, after = (
        {name: value for name, value in one.node("motion_controller", "").items() if not name.startswith("learning.")}
        for one in (configuration, learned)
    )
    assert before == after
    after = learned.node("motion_controller", "")
    assert after["learning.period"] == pytest.approx(0.2)
    result = design_axis(single_axis(learned), DesignRequest("pid"))
    again = design_file(learned, result, "")
    found = single_axis(parse_configuration(again, "again")).motion_controller
    assert found.learning.type == "none" and found.type == "pid" and "Learning designed" not in again
