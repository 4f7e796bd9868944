# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage from its recording: periods are found; a response without periods; a loop with another class of plant."""

from __future__ import annotations

import functools
import json
import pathlib
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from command_support import hysteresis

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "loop"))
from coupled_stages import as_values, configured, internal_structure  # noqa: E402

import hysteresis_ros as hr  # noqa: E402
from hysteresis_ros.analysis.identification_report import write_stage_identification_report  # noqa: E402
from hysteresis_ros.configuration import load_configuration, parse_configuration  # noqa: E402
from hysteresis_ros.designs import stage_identification  # noqa: E402
from hysteresis_ros.designs.coupled import response_uncertainties, stage_rows  # noqa: E402
from hysteresis_ros.designs.setpoint_step import at_setpoint  # noqa: E402
from hysteresis_ros.designs.stage_excitation import StageExcitation, excited_stage  # noqa: E402
from hysteresis_ros.designs.stage_frequency_response import (  # noqa: E402
    level_responses,
    recorded_stage_response,
    save_stage_response,
)
from hysteresis_ros.designs.stage_identification import (  # noqa: E402
    StageRequest,
    _ranges,
    identify_stage,
    put_into,
)
from hysteresis_ros.errors import ConfigurationError, HysteresisError, IdentificationError  # noqa: E402
from hysteresis_ros.identification.data import DataError  # noqa: E402
from hysteresis_ros.identification.excitations import orthogonal_multisines  # noqa: E402
from hysteresis_ros.identification.frequency_response import FrequencyResponse  # noqa: E402
from hysteresis_ros.identification.linear_systems import LinearModel  # noqa: E402
from hysteresis_ros.identification.local_polynomial import local_polynomial_response  # noqa: E402
from hysteresis_ros.identification.response_check import MeasuredPlant  # noqa: E402
from hysteresis_ros.identification.stage_data import (  # noqa: E402
    StageColumns,
    StageReading,
    find_period,
    loops_of,
    planned_realisations,
    read_stage,
    realisations,
)
from hysteresis_ros.loop.parameters import part  # noqa: E402
from hysteresis_ros.loop.stage_parameters import StageParameters  # noqa: E402
from hysteresis_ros.loop.stage_simulation import coupling_errors, simulate_stage  # noqa: E402
from hysteresis_ros.models.compensator import USED, CompensatorParameters, reachable_commands  # noqa: E402
from hysteresis_ros.models.hysteresis import hysteresis_block  # noqa: E402
from hysteresis_ros.recordings.dataset import Recording  # noqa: E402
from hysteresis_ros.recordings.files import save_run  # noqa: E402
from hysteresis_ros.units import readable  # noqa: E402

STEP = 1e-4
CROSSTALK = np.array([[1.0, 0.05], [0.03, 1.0]])


def plant(gain=CROSSTALK) -> LinearModel:
    """Two modes, 400 and 600 Hz, with the static gain 0.4 µm/V times ``gain``, and a sample of delay more."""
    A, B, C = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros((2, 6))
    for i, turn in enumerate((0.04, 0.06)):
        pole = np.exp(2.0 * np.pi * turn * (-0.05 + 1j))
        mode = slice(2 * i, 2 * i + 2)
        A[mode, mode] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        own = np.linalg.solve(np.eye(2) - A[mode, mode], [0.0, 1.0])
        A[2 * i : 2 * i + 2, 4 + i] = [0.0, 1.0]
        B[4 + i, i] = 1.0
        C[:, 2 * i] = 0.4e-6 * np.asarray(gain)[:, i] / own[0]
    return LinearModel(A, B, C, np.zeros((2, 2)), STEP)


def recorded(u, model=None, noise=2e-9, seed=3) -> StageReading:
    """Return a run of a linear plant with noise of the sensors."""
    y = (model or plant()).simulate(u) + noise * np.random.default_rng(seed).standard_normal(u.shape)
    return StageReading(("u1", "u2"), ("y1", "y2"), ((u, y),), STEP, "arrays")


def excitation(period=500, runs=4, repeats=3) -> np.ndarray:
    """Return consecutive realisations of orthogonal multisines with rests between them, shape (N, 2) [V]."""
    table = 5.0 * orthogonal_multisines(2, period, np.arange(1, 241), runs)
    played = np.concatenate([np.tile(one, (repeats, 1)) for one in table])
    return np.concatenate([np.zeros((137, 2)), played, np.zeros((80, 2))])


def test_orthogonal_multisines_are_orthogonal_at_each_line():
    lines = np.arange(3, 90)
    for inputs in (1, 2, 3):
        table = orthogonal_multisines(inputs, 256, lines, 2 * inputs)
        assert np.max(np.abs(table)) == pytest.approx(1.0)
        spectra = np.fft.rfft(table, axis=1)
        for group in (spectra[:inputs], spectra[inputs:]):
            np.testing.assert_allclose(np.linalg.cond(group[:, lines].transpose(1, 0, 2)), 1.0, atol=1e-9)
        others = np.delete(spectra, lines, axis=1)
        assert np.max(np.abs(others)) < 1e-9 * np.max(np.abs(spectra))
    assert not np.allclose(table[:3], table[3:])


def test_periods_and_realisations_are_found_in_one_recording():
    u = excitation()
    assert find_period(u) == 500
    data = realisations(recorded(u))
    assert data.u.shape == (4, 1000, 2)
    # in the first period of each realisation the stage settles
    np.testing.assert_array_equal(data.u[1], u[137 + 1500 + 500 : 137 + 3000])
    assert realisations(recorded(u), StageColumns(settle=2)).u.shape == (4, 500, 2)
    assert realisations(recorded(np.random.default_rng(0).standard_normal((4000, 2)))) is None
    # a run-in of part of a period repeats too: the whole periods are those at the end
    run_in = np.concatenate([u[:137], u[137 + 380 : 137 + 500], u[137 : 137 + 1500], np.zeros((80, 2))])
    found = realisations(recorded(run_in), StageColumns(settle=0))
    np.testing.assert_array_equal(found.u[0], u[137 : 137 + 1500])
    with pytest.raises(DataError, match=r"do not repeat with a period of 0.0301 s"):
        realisations(recorded(u), StageColumns(period=0.0301))


@pytest.mark.slow
def test_skipped_samples_in_which_the_inputs_were_held_do_not_hide_the_realisations():
    """The references repeat; the voltages of a busy machine do not, and the recording contains both."""
    asked = excitation()
    rng = np.random.default_rng(5)
    late = np.zeros(len(asked), dtype=bool)
    for place in rng.choice(np.arange(200, len(asked) - 200), 30, replace=False):
        late[place : place + rng.integers(1, 4)] = True
    held = np.maximum.accumulate(np.where(late, 0, np.arange(len(asked))))
    whole = recorded(asked)
    (u, y), time = recorded(asked[held]).runs[0], STEP * np.arange(len(asked))

    def run(skipped, noise=0.0) -> Recording:
        volts = u + noise * rng.standard_normal(u.shape)
        signals = [
            {"voltage": volts[:, i], "measured": y[:, i], "reference": 1e-7 * asked[:, i], "skipped": skipped * late}
            for i in range(2)
        ]
        units = {"voltage": "V", "measured": "m", "reference": "m", "skipped": "1"}
        return Recording.of_axes(
            {name: Recording(time, one, units, {}) for name, one in zip("xy", signals, strict=True)}, {}
        )

    reading = read_stage(run(1.0))
    assert reading.skipped == np.count_nonzero(late)
    data, expected = realisations(reading), realisations(whole)
    assert data.period == 500 and data.u.shape == expected.u.shape == (4, 1000, 2)
    np.testing.assert_array_equal(data.u[2], u[137 + 3000 + 500 : 137 + 4500])
    found = identify_stage(reading, data, StageRequest(order=6, controller="none"))
    np.testing.assert_allclose(found.figures["gain_m_per_v"], 0.4e-6 * CROSSTALK, atol=0.4e-8)
    assert any(f"too busy for {reading.skipped} of {len(u)} samples" in text for text in found.warnings)
    # without the note of the skipped samples only the voltages count, as in any file
    assert read_stage(run(0.0)).asked == ()
    # of a closed loop the references repeat and the voltages do not
    assert realisations(read_stage(run(1.0, noise=2.0))) is None


def test_realisations_of_a_known_plan_are_those_that_are_found():
    reading = recorded(excitation())
    found, planned = realisations(reading), planned_realisations(reading, 137, 500, 1, 2, 4)
    assert planned.period == found.period == 500
    np.testing.assert_array_equal(planned.u, found.u)
    np.testing.assert_array_equal(planned.y, found.y)
    with pytest.raises(DataError, match="it is cut off"):
        planned_realisations(reading, 137, 500, 1, 2, 5)


def test_a_drift_from_period_to_period_is_no_response():
    u = excitation()
    reading = recorded(u, noise=0.0)
    ramp = 1e-9 * np.arange(len(u))[:, None] * np.array([1.0, -2.0])
    drifting = replace(reading, runs=((u, reading.runs[0][1] + ramp),))
    still, moved = realisations(reading).y, realisations(drifting).y
    still = still - still.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(moved - moved.mean(axis=1, keepdims=True), still, atol=1e-10)


@pytest.mark.slow
def test_the_local_polynomial_bands_contain_the_truth_in_95_of_100_lines():
    """Counted over seeds, for each entry, with correlated noise of the sensors and inputs that never repeat."""
    model, inside, ratio = plant(), [], []
    mixing = np.array([[1.0, 0.0], [0.8, 0.6]])
    for seed in range(10):
        random = np.random.default_rng(seed)
        u = random.standard_normal((1, 8192, 2))
        clean = model.simulate(u[0])[None]
        noise = 0.02 * clean.std() * random.standard_normal(clean.shape) @ mixing.T
        found = local_polynomial_response(u, clean + noise, STEP)
        truth = model.frequency_response(found.response.frequency)
        inside.append(np.mean(np.abs(found.response.response - truth) <= found.response.radius(0.95), axis=0))
        expected = (0.02 * clean.std()) ** 2 * mixing @ mixing.T / 8192
        ratio.append(np.median(found.total.real, axis=0) / expected)
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) < 0.015)
    # the median of a chi-square of 24 degrees is 0.97 of its mean
    np.testing.assert_allclose(np.diag(np.mean(ratio, axis=0)), 0.97, atol=0.05)


def test_a_transient_does_not_bias_the_local_polynomial_response():
    """The initial transient is smooth in frequency; a plain quotient of spectra contains it as an error."""
    model, random = plant(), np.random.default_rng(1)
    u = random.standard_normal((2, 3000, 2))
    y = np.array([model.simulate(one) for one in u])[:, 1000:]
    found = local_polynomial_response(u[:, 1000:], y, STEP)
    truth = model.frequency_response(found.response.frequency)
    # lines away from the narrow modes
    calm = np.abs(found.response.frequency[:, None] - [400.0, 600.0]).min(axis=1) > 60.0
    U, Y = (np.fft.rfft(one[:, :, :], axis=1)[:, 1:1000].transpose(1, 2, 0) for one in (u[:, 1000:], y))
    plain = Y @ np.linalg.inv(U)
    error, without = (np.median(np.abs(one[calm] - truth[calm])) for one in (found.response.response, plain))
    assert error < 2e-3 * np.abs(truth[calm]).mean()
    assert without > 10.0 * error


def test_correlated_inputs_have_no_local_polynomial_response():
    u = np.random.default_rng(0).standard_normal((1, 4000, 1)) * np.ones((1, 1, 2))
    with pytest.raises(IdentificationError, match=r"correlated: condition number \S+ of the inputs around \S+ Hz"):
        local_polynomial_response(u, u, STEP)


@pytest.fixture(scope="module")
def linear():
    """A linear stage identified with and without periods."""
    u = excitation()
    periodic = recorded(u)
    random = recorded(np.random.default_rng(5).standard_normal((6000, 2)))
    request = StageRequest(controller="none")
    return (
        identify_stage(periodic, realisations(periodic), request),
        identify_stage(random, realisations(random), request),
    )


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_a_linear_stage_is_found_again(linear, which):
    found = linear[which]
    stage = found.parameters.stage
    assert (stage.type, found.figures["order"]) == ("hammerstein", 4)
    # one sample in the plant, and one until a voltage has changed the velocities
    assert found.figures["delay_samples"] in (1, 2)
    np.testing.assert_allclose(found.figures["gain_m_per_v"], 0.4e-6 * CROSSTALK, atol=0.4e-8)
    turns = np.abs(np.angle(stage.structure.linear.poles)) / (2.0 * np.pi * STEP)
    np.testing.assert_allclose(np.unique(np.round(turns, 3))[[0, -1]], [400.0, 600.0], rtol=2e-3)
    # the decoupled commands are displacements
    gain = stage.structure.linear.dc_gain @ stage.matrix("decoupling")
    np.testing.assert_allclose(gain, np.eye(2), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 2e-9])
def test_a_stage_without_dynamics_gets_controllers_for_its_delay(noise):
    """Such is the simulated plant of a new stage; a model of order 2 has states that cannot be controlled."""
    static = LinearModel(np.zeros((2, 2)), np.eye(2), 0.4e-6 * CROSSTALK, np.zeros((2, 2)), STEP)
    reading = recorded(excitation(), static, noise)
    found = identify_stage(reading, realisations(reading), StageRequest(order=2, damping="none"))
    for axis in found.parameters.axes:
        dynamics = axis.motion_controller.model.dynamics
        assert dynamics.A == () and dynamics.delay == pytest.approx(STEP)
        assert axis.motion_controller.type == "pid"
    assert not any("no controller" in text for text in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(("late", "size"), [(1, 0.0), (4, 0.0), (0, 0.0), (1, 0.02), (4, 0.02)])
def test_the_model_of_an_axis_is_a_delay_only_where_nothing_else_is_left(late, size):
    """A resonance at 3 kHz with 2 % of the gain at rest is no delay, and a loop has one sample of delay at least."""
    f = np.linspace(20.0, 4800.0, 240)
    resonance = 1.0 / (1.0 - (f / 3000.0) ** 2 + 0.04j * (f / 3000.0))
    response = (1.0 - size + size * resonance) * np.exp(-2j * np.pi * f * late * STEP)
    values, left = stage_identification._axis_model(FrequencyResponse(f, response[:, None, None], STEP), STEP)
    assert ("model.dynamics.A" in values) == (size > 0.0) and (left < 1.0 or not late)
    if not size:
        assert values["model.dynamics.delay"] == pytest.approx(max(late, 1) * STEP, rel=1e-12)


def response_error(found) -> float:
    """Return the RMS error of the linear part of an identified stage against the plant, up to 1 kHz [m/V]."""
    frequency = found.responses[0].response.frequency
    low = frequency < 1000.0
    return float(np.sqrt(np.mean(np.abs(found.structure - plant().frequency_response(frequency))[low] ** 2)))


@pytest.mark.slow
def test_a_measured_response_matrix_replaces_that_of_a_noisy_recording(tmp_path):
    """The recording has 100 nm of noise, and the matrix 2 nm; the noise of the sensor is that of the recording."""
    matrix = tmp_path / "matrix.npz"
    save_stage_response(matrix, recorded_stage_response(replace(recorded(excitation(runs=6)), axes=("x", "y"))))
    noisy = recorded(excitation(runs=3), noise=1e-7, seed=4)
    request = StageRequest(order=4, controller="none")
    alone, found = (
        identify_stage(noisy, realisations(noisy), one) for one in (request, replace(request, response=matrix))
    )
    assert response_error(found) < 0.2 * response_error(alone)
    for name in ("noise_x_m", "noise_y_m"):
        assert found.figures[name] == alone.figures[name] == pytest.approx(1e-7, rel=0.2)
    assert found.held_out.errors.max() < 1.02 * alone.held_out.errors.max()
    section = dict(parse_configuration(found.text, "stage").entries)["/identification"]
    assert section["linear_source"] == "matrix.npz" and "linear_source" not in alone.text
    # two realisations have no bands, so only the matrix tells a design how accurate the model is
    assert "x.response.uncertainty" in section and "response.uncertainty" not in alone.text


@pytest.mark.slow
def test_a_response_matrix_of_another_stage_is_refused(tmp_path):
    reading = recorded(excitation())
    others = ((("x", "z"), STEP), (("x", "y"), 2.0 * STEP), (("x", "y"), 0.5 * STEP), (("y", "x"), STEP))
    for number, (axes, step) in enumerate(others):
        other = replace(reading, axes=axes, sample_time=step)
        save_stage_response(tmp_path / f"{number}.npz", recorded_stage_response(other))
    request = StageRequest(order=4, controller="none")
    for changes, words in (
        ({"response": tmp_path / "0.npz"}, "0.npz: has the axes x, z, but the recording has x, y; measure"),
        ({"response": tmp_path / "1.npz"}, "1.npz: was measured at 5000 Hz, but the recording has 10000 Hz"),
        ({"response": tmp_path / "2.npz"}, "2.npz: was measured at 20000 Hz, but the recording has 10000 Hz"),
        ({"response": tmp_path / "3.npz"}, "3.npz: has the axes y, x, but the recording has x, y; measure"),
        ({"response": tmp_path / "0.npz", "type": "internal"}, "not to a response matrix: omit --response"),
    ):
        with pytest.raises(IdentificationError, match=words):
            identify_stage(reading, realisations(reading), replace(request, **changes))
    words = ("identify", "one.csv", "--response", tmp_path / "0.npz", "-o", tmp_path / "s.yaml")
    assert "--response is for the recording of a stage" in hysteresis(*words, code=2)


@pytest.mark.slow
def test_an_identified_stage_begins_at_rest(linear):
    """The first voltages are 0 V, and the way to the middle of the ranges keeps the limits of the approach."""
    own = linear[0].parameters
    assert all(axis.generator.approach.from_rest for axis in own.axes)
    jumps = replace(own, axes=tuple(at_setpoint(axis) for axis in own.axes))
    first, jump = (
        simulate_stage(
            StageParameters.from_configuration(parse_configuration(one.configuration_text(), "stage")), duration=0.5
        )
        for one in (own, jumps)
    )
    for name, axis in zip(own.names, own.axes, strict=True):
        there = axis.generator.initial_setpoint
        assert jump[f"{name}/reference"][0] == there == first[f"{name}/reference"][-1]
        steps = np.abs(
            np.diff(first[f"{name}/reference"], prepend=min(max(0.0, axis.generator.minimum), axis.generator.maximum))
        )
        assert steps.max() <= axis.generator.approach.maximum_velocity * STEP * (1.0 + 1e-6)


def test_an_excitation_of_a_stage_that_begins_at_rest_is_as_planned(tmp_path):
    configuration = load_configuration("xy_scanner")
    asked = StageExcitation(realisations=2, rests=(10.0, 30.0))
    resting = configuration.override("reference_generator", approach__from_rest=True)
    found = excited_stage(resting, asked, tmp_path / "m")
    run = simulate_stage(found.stage, duration=0.1)
    for place, name in enumerate("xy"):
        # the slew rate limits the first sample
        np.testing.assert_allclose(run[f"{name}/voltage"][5:], found.voltages[5:1000, place], atol=0.002)


def test_what_is_held_out_does_not_change_the_response():
    data = realisations(recorded(excitation()))
    disturbed = data.y.copy()
    disturbed[-1] += 1e-6 * np.random.default_rng(9).standard_normal(disturbed[-1].shape)
    (plain,), kept = level_responses(data, 1)
    (other,), judged = level_responses(replace(data, y=disturbed), 1)
    np.testing.assert_array_equal(other.response.response, plain.response.response)
    np.testing.assert_array_equal(judged[0].y, disturbed[-1:])
    np.testing.assert_array_equal(kept[0].y, data.y[-1:])
    # without a realisation that is held out, all of them count
    assert level_responses(data, 0)[1] is None
    assert not np.array_equal(level_responses(data, 0)[0][0].response.response, plain.response.response)


@pytest.mark.slow
def test_the_noise_that_was_measured_at_rest_is_that_of_the_file():
    """A recording with irregular samples has noise that no sensor has, here 50 times as much."""
    reading = recorded(excitation(), noise=1e-7)
    request = StageRequest(controller="none", order=4, resting_noise=(2e-9, 3e-9))
    found = identify_stage(reading, realisations(reading), request)
    assert [axis.plant_simulator.sensor.noise for axis in found.parameters.axes] == [2e-9, 3e-9]


@pytest.fixture
def few_plays(monkeypatch):
    """Give the hysteresis of each actuator a fixed number of plays: the search for its structure is not what counts."""
    found = functools.partial(stage_identification.workflow.identify, options={"zone_count": 0, "play_count": 8})
    monkeypatch.setattr(stage_identification.workflow, "identify", found)


@pytest.mark.slow
@pytest.mark.parametrize(("times", "borne"), [(1.0, 1.0), (1.5, 1.5)])
def test_a_gain_that_the_loops_do_not_show_is_borne_by_the_design(few_plays, times, borne):
    """A hysteresis of another class gives fast, small movements another gain than that of the slow loops."""
    reading, request = recorded(excitation()), StageRequest(controller="none", order=4)
    triangle = 25.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, 2001)))
    cycles = np.concatenate([np.tile(triangle, 3), np.zeros(500)])
    still = np.zeros_like(cycles)
    alone = np.concatenate([np.stack([cycles, still], 1), np.stack([still, cycles], 1)])
    loops = recorded(alone, plant(CROSSTALK / times))
    found = identify_stage(reading, realisations(reading), request, loops)
    np.testing.assert_allclose(found.held_out.gains, times, rtol=0.05)
    assert np.all(found.held_out.shapes < 0.05 * found.held_out.motion)
    known = response_uncertainties(parse_configuration(found.text, "found"), found.parameters)
    assert [one.gain for one in known.values()] == pytest.approx([borne, borne], rel=0.05)
    assert sum("times the gain of the file" in text for text in found.warnings) == 2 * (times > 1.0)


@pytest.mark.slow
def test_noise_is_told_from_the_response(linear):
    figures = linear[0].figures
    for name in "xy":
        assert figures[f"noise_{name}_m"] == pytest.approx(2e-9, rel=0.1)
        # one realisation held out, the mean of two periods
        assert figures[f"held_out_{name}_rmse_m"] == pytest.approx(2e-9 / np.sqrt(2.0), rel=0.3)
    # one realisation of the second group is held out
    assert figures["largest_condition"] < 1.5


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda u: recorded(u[:, [1, 1]]), r"correlated: condition number \S+ of the inputs at"),
        (
            lambda u: recorded(u, plant([[1.0, 1.0], [1.0, 1.0]])),
            r"static gain.*is singular: the direction .*0.71 actuator x.*0.71 actuator y moves no sensor",
        ),
        (lambda u: recorded(u, plant([[0.0, 1.0], [1.0, 0.0]])), "name inputs and outputs in the order of the axes"),
        (lambda u: recorded(u, plant([[-1.0, 0.0], [0.0, 1.0]])), "axis x: y1 falls when u1 rises"),
        (lambda u: recorded(u[:3200]), "2 realisations of a level: 2 inputs and 1 held out need 3"),
    ],
    ids=["correlated", "singular", "order", "sign", "few"],
)
def test_recordings_that_give_no_stage_are_refused(make, words):
    reading = make(excitation())
    with pytest.raises(HysteresisError, match=words):
        identify_stage(reading, realisations(reading), StageRequest(order=4, controller="none"))


def test_a_multisine_that_a_slew_rate_has_made_too_small_is_named(tmp_path):
    """The way to the middle of the ranges is 50 V, the multisine a few mV: it is not found beside it."""
    slow = load_configuration("xy_scanner").override("plant_simulator", limits__slew_rate=300.0)
    slow = slow.override("reference_generator", waveform__type="hold")  # its triangle needs a larger slew rate
    found = excited_stage(slow, StageExcitation(realisations=3), tmp_path / "weak")
    assert "raise limits.slew_rate of plant_simulator and hysteresis_compensator" in found.words
    assert (
        "raise limits" not in excited_stage(load_configuration("xy_scanner"), StageExcitation(), tmp_path / "m").words
    )
    reading = recorded(found.voltages)
    with pytest.raises(DataError, match="including the move to their centre: excite more strongly; hysteresis excite"):
        identify_stage(reading, realisations(reading), StageRequest(controller="none"))


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"axes": ("x", "x")}, "'x' occurs more than once: give each actuator its own name"),
        ({"axes": ("x",)}, "must be 2 names"),
        ({"order": 3}, "order = 3: must be an even number"),
        ({"type": "internal", "plays": 0}, "plays = 0: must be ≥ 1 with type internal"),
    ],
)
def test_requests_that_fit_no_stage_are_refused(request_, words):
    reading = recorded(excitation())
    with pytest.raises(IdentificationError, match=words):
        identify_stage(reading, realisations(reading), StageRequest(**request_))


@pytest.mark.slow
def test_files_of_a_stage_are_refused_by_name(tmp_path):
    u = excitation()
    y = recorded(u).runs[0][1]
    time = STEP * np.arange(len(u))
    columns = {"t_s": time, "a_V": u[:, 0], "b_V": u[:, 1], "p_um": 1e6 * y[:, 0], "q_um": 1e6 * y[:, 1]}
    np.savez(tmp_path / "good.npz", **columns)
    np.savez(tmp_path / "slow.npz", **columns | {"t_s": 2.0 * time})
    np.savez(tmp_path / "gap.npz", **columns | {"t_s": time + 0.01 * (np.arange(len(time)) > 900)})
    np.save(tmp_path / "table.npy", np.column_stack([u, 1e6 * y]))
    names = ("--input", "a_V", "--input", "b_V", "--output", "p_um", "--output", "q_um", "-o", tmp_path / "s.yaml")
    identify = ("identify", tmp_path / "good.npz")
    for words, said in (
        (
            (*identify, tmp_path / "slow.npz", *names),
            "slow.npz: has a sample time of 0.0002 s, but it is 0.0001 s in good.npz",
        ),
        (("identify", tmp_path / "gap.npz", *names), "gap.npz: not uniformly sampled"),
        ((*identify, "--input", "a_V", "--input", "a_V", *names[4:]), "'a_V' occurs more than once"),
        ((*identify, *names[:6], "-o", "s.yaml"), "2 inputs and 1 outputs"),
        ((*identify, *names, "--axes", "x,x"), "'x' occurs more than once: give each actuator its own name"),
        (("validate", "kim2009", tmp_path / "good.npz", *names[:4]), "this command takes one column"),
    ):
        assert said in hysteresis(*words, code=2)
    chosen = StageColumns(("1:V", "2:V"), ("3:um", "4:um"), sample_time=STEP)
    np.testing.assert_allclose(read_stage(tmp_path / "table.npy", chosen).runs[0][1], y)
    with pytest.raises(DataError, match="an array has no times; give --sample-time"):
        read_stage(tmp_path / "table.npy", replace(chosen, sample_time=None))


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """A scanner whose hysteresis acts inside its structure, a class that the identified model does not have.

    The plays lag behind the motion, and larger amplitudes soften the modes.
    """
    structure = internal_structure()
    structure = replace(structure, C_z=tuple(-value for value in structure.C_z))
    own = {"hysteresis__type": "proportional", "creep__type": "none"}
    configuration = configured(
        stage={"type": "internal", "decoupling": []} | as_values(structure),
        plant_simulator=own | {"hysteresis__proportional__gain": 1.0},
        hysteresis_compensator=own | {"hysteresis__proportional__gain": 0.4e-6},
        motion_controller={"type": "open_loop", "damping__type": "none"},
        reference_generator={"waveform__type": "hold"},
    )
    path = tmp_path_factory.mktemp("truth") / "truth.yaml"
    path.write_text(StageParameters.from_configuration(configuration).configuration_text(), encoding="utf-8")
    for name in ("multisine", "decaying"):
        found = excited_stage(load_configuration(path), StageExcitation(name), path.with_name(name))
        save_run(simulate_stage(found.stage, duration=found.duration), path.with_name(f"{name}.npz"))
    return path


@pytest.mark.slow
def test_one_axis_after_the_other_goes_through_its_range(truth):
    reading = read_stage(truth.with_name("decaying.npz"))
    u, _ = reading.whole()
    spans = loops_of(reading)
    assert spans[0][1] < spans[1][0]
    for i, (first, last) in enumerate(spans):
        assert np.ptp(u[first:last, i]) == pytest.approx(100.0, rel=1e-3)
        assert np.ptp(u[first:last, 1 - i]) == 0.0
    with pytest.raises(DataError, match="input x/voltage is not excited alone"):
        loops_of(read_stage(truth.with_name("multisine.npz")))


@pytest.mark.slow
def test_a_scanner_of_another_class_is_controlled_by_what_its_recordings_gave(truth):
    """Recorded, identified by the command, controlled on the true plant: hysteresis and 5 % cross-talk are removed."""
    closed, figures = truth.with_name("closed.yaml"), truth.with_name("figures.json")
    page = truth.with_name("page.html")
    words = ("--loops", truth.with_name("decaying.npz"), "--into", truth, "-o", closed, "--json", figures)
    words += ("--report", page)
    said = hysteresis("identify", truth.with_name("multisine.npz"), *words)
    assert "hammerstein, order 4, 1 samples of delay before it" in said
    assert "warning" not in said
    found = json.loads(figures.read_text())
    for name in "xy":
        # motion of 1.5 µm RMS; the nonlinear part is the rest
        assert found[f"held_out_{name}_rmse_m"] < 1e-7
        assert found[f"loops_{name}_rmse_percent_of_stroke"] < 0.1
        assert found[f"noise_{name}_m"] == pytest.approx(5e-9, rel=0.1)
    assert json.loads(figures.read_text())["report"] == str(page)
    shown = page.read_text(encoding="utf-8")
    # responses, held-out realisations and loops of two axes, and the closed loops
    assert shown.count("data:image/png") == 7
    for text in ("Stage x, y identified from multisine.npz", "Response of y to each actuator, with 95 % bands"):
        assert text in shown
    for text in (
        "<td>" + readable(found["held_out_x_rmse_m"], "m"),
        "relative gains of y",
        "disk margin of all jointly",
    ):
        assert text in shown
    # limits of the motion, with their reasons
    for axis in StageParameters.from_configuration(load_configuration(closed)).axes:
        assert axis.hysteresis_compensator.limits.slew_rate > 0.0 and not axis.reference_generator.approach.unlimited
    text = closed.read_text(encoding="utf-8")
    assert text.count("m/s: half of the slew rate over the range") == 2, text
    scan = {"waveform__type": "triangle", "waveform__frequency": 10.0, "waveform__amplitude": 6e-6}
    scan |= {"waveform__cycles": 3, "waveform__polarity": "symmetric"}
    configuration = load_configuration(closed).override("x/reference_generator", **scan)
    parameters = StageParameters.from_configuration(configuration)
    assert parameters.stage.type == "internal"
    (coupled,) = coupling_errors(parameters, 0.45)
    run = simulate_stage(parameters, duration=0.45)
    error = (run["x/displacement"] - run["x/reference"])[1500:]
    assert coupled.scanned > 11e-6
    assert coupled.part < 4e-4
    assert error.std() < 1.5e-7
    untouched = replace(parameters, stage=replace(parameters.stage, decoupling=()))
    assert coupling_errors(untouched, 0.45)[0].part > 5.0 * coupled.part


def test_the_multisines_of_a_stage_leave_no_frequency_unknown(tmp_path):
    """A design assumes a resonance where the response is unknown, which costs nearly all of the bandwidth."""
    found = excited_stage(load_configuration("xy_scanner"), StageExcitation(realisations=2), tmp_path / "multi")
    begun = found.voltages[10000 : 10000 + 2000]
    lines = np.abs(np.fft.rfft(begun - begun.mean(axis=0), axis=0))
    assert np.all(lines[1:1000] > 0.5 * lines[1:1000].max()) and np.all(lines[1000] < 1e-6 * lines.max())
    frequency = np.arange(1, 1000) / (2000 * STEP)
    exact = np.ones(999, dtype=complex)
    assert MeasuredPlant(frequency, exact, np.zeros(999)).uncertainty(exact, STEP).known_to == np.inf
    assert MeasuredPlant(frequency[:-1], exact[:-1], np.zeros(998)).uncertainty(exact[:-1], STEP).known_to < 5000.0


@pytest.mark.slow
def test_the_page_without_periods_loops_and_controllers_has_what_is_known(linear, tmp_path):
    found = linear[1]
    names = found.parameters.names
    write_stage_identification_report(
        tmp_path / "page.html", "arrays", names, found, stage_rows(found.parameters), None
    )
    shown = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert shown.count("data:image/png") == 2 and "Controllers" not in shown and "<td>-</td>" in shown


@pytest.mark.slow
def test_options_of_a_single_axis_are_refused_for_a_stage(truth):
    words = ("identify", truth.with_name("multisine.npz"), "--loops", truth.with_name("decaying.npz"), "-o", "s.yaml")
    for option in (("--linear", "lag"), ("-p", "plays=3"), ("--inverse", "exact")):
        assert "--linear, -p and --inverse are for a single axis" in hysteresis(*words, *option, code=2)


def test_a_stage_with_decoupling_and_feedforward_is_excited_without_them(tmp_path):
    configuration = load_configuration("xy_scanner")
    fed = configuration.override("stage", feedforward__preview=1, feedforward__weights=[0.1] * 8)
    fed = fed.override("motion_controller", feedforward__type="static", feedforward__preview=1)
    assert StageParameters.from_configuration(fed).stage.feedforward.weights
    plain, found = (excited_stage(one, StageExcitation(realisations=2), tmp_path / "m") for one in (configuration, fed))
    assert found.stage.stage.feedforward.weights == () == found.stage.stage.decoupling
    np.testing.assert_array_equal(found.voltages, plain.voltages)


@pytest.mark.parametrize(("plant_slew", "own_slew"), [(4000.0, 70000.0), (70000.0, 4000.0), (0.0, 4000.0)])
def test_a_multisine_is_as_slow_as_the_slower_of_amplifier_and_compensator(tmp_path, plant_slew, own_slew):
    configuration = load_configuration("xy_scanner").override("plant_simulator", limits__slew_rate=plant_slew)
    configuration = configuration.override("hysteresis_compensator", limits__slew_rate=own_slew)
    found = excited_stage(configuration, StageExcitation(realisations=2), tmp_path / "slow")
    steps = np.max(np.abs(np.diff(found.voltages, axis=0)), axis=0)
    np.testing.assert_allclose(steps / STEP, 4000.0, rtol=1e-3)
    assert "the slew rate reduces the amplitude to: x " in found.words


def test_each_axis_begins_and_ends_where_it_rests(tmp_path):
    asked = StageExcitation(realisations=2, rests=(10.0, 30.0))
    for one in (asked, replace(asked, name="decaying", realisations=None, duration=0.2)):
        volts = excited_stage(load_configuration("xy_scanner"), one, tmp_path / "rests").voltages
        np.testing.assert_allclose(volts[[0, -1]], [[10.0, 30.0]] * 2, atol=0.1)


@pytest.mark.parametrize("shares", [(0.1, 0.6), (0.6, 0.1)])
def test_every_corner_of_the_ranges_of_the_axes_is_within_those_of_the_actuators(shares):
    """The actuators reach 0 … 40 µm each; the one with most cross-talk needs the share of them that may be used."""
    decoupling = np.array([[1.0, -shares[0]], [-shares[1], 1.0]])
    one = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 0.4e-6}
    one |= {"limits.minimum": 0.0, "limits.maximum": 100.0}
    ranges = _ranges(None, [one, one], decoupling, STEP)
    corners = decoupling @ np.array([(x, y) for x in ranges[0] for y in ranges[1]]).T
    used = np.max(np.abs(corners - 20e-6), axis=1) / 20e-6
    assert np.max(used) == pytest.approx(USED, rel=1e-3)


def test_the_range_of_an_axis_is_what_its_actuator_reaches_again():
    """At its lowest voltage an actuator with hysteresis does not return to the zero from which it first began."""
    axis = StageParameters.from_configuration(load_configuration("xy_scanner")).axes[0]
    given = part(axis.hysteresis_compensator, CompensatorParameters)
    first, last = reachable_commands(given, STEP)
    way = np.concatenate([np.linspace(0.0, 100.0, 400), np.linspace(100.0, 0.0, 400)])
    remains = hysteresis_block(given.hysteresis, STEP).simulate(way)[-1]
    assert remains > first + 0.09 * (last - first)
    ((low, high),) = _ranges(None, [given.to_mapping()], np.eye(1), STEP)
    assert low == pytest.approx(remains + 0.5 * (1.0 - USED) * (last - remains), rel=1e-3)
    assert high == pytest.approx(last - 0.5 * (1.0 - USED) * (last - remains), rel=1e-3)


def test_a_stage_of_other_axes_or_of_another_rate_does_not_take_what_was_identified():
    into = load_configuration("xy_scanner")
    for names, rate, words in (
        (("a", "y"), 10000.0, "has the axes x, y, but the recording has a, y; give the same names with --axes"),
        (("x", "y"), 5000.0, "runs at 10000 Hz, but the recording has 5000 Hz"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            put_into(into, into, SimpleNamespace(names=names, sample_rate=rate))


@pytest.mark.parametrize("driver", ["simulated", ""])
def test_the_plant_of_devices_becomes_the_identified_one_and_a_simulated_plant_stays(driver):
    designed = load_configuration("xy_scanner")
    found = StageParameters.from_configuration(designed)
    into = designed.override("stage", structure__B=tuple(2.0 * value for value in found.stage.structure.B))
    # a plant as it was identified from a recording without noise, creep, or offset
    kept = ("hysteresis.", "limits.", "joint")
    entries = (
        (name, {key: value for key, value in values.items() if key.startswith(kept)})
        if name.endswith("plant_simulator")
        else (name, values)
        for name, values in designed.entries
    )
    designed = replace(designed, entries=tuple(entries))
    for name in found.names:
        into = into.override(
            f"{name}/plant_simulator",
            driver=driver,
            hysteresis__type="proportional",
            hysteresis__proportional__gain=1e-7,
        )
    text = put_into(into, designed, found)
    written = StageParameters.from_configuration(parse_configuration(text, "the stage of devices"))
    assert (written.stage.structure == found.stage.structure) == bool(driver)
    for given, own in zip(written.axes, found.axes, strict=True):
        assert given.plant_simulator.driver == driver
        plant, model = given.plant_simulator.hysteresis, own.plant_simulator.hysteresis
        assert (plant.type == model.type) == bool(driver)
        assert plant.prandtl_ishlinskii == model.prandtl_ishlinskii
        assert own.plant_simulator.sensor.noise > 0.0 and own.plant_simulator.creep.type != "none"
        assert (given.plant_simulator.sensor.noise == 0.0) == bool(driver)
        assert (given.plant_simulator.creep.type == "none") == bool(driver)


@pytest.mark.slow
def test_loops_are_designed_for_the_noisiest_sensor_unless_the_noise_is_given(monkeypatch):
    class Designing(Exception):
        """The design begins."""

    def designing(text, parameters, request, level, *more):
        raise Designing(level)

    def once(make):
        made = []
        return lambda *given: made[0] if made else made.append(make(*given)) or made[0]

    for name in ("_hammerstein", "_file"):  # the same for all of them
        monkeypatch.setattr(stage_identification, name, once(getattr(stage_identification, name)))
    monkeypatch.setattr(stage_identification, "design_identified", designing)
    u = excitation()
    for louder in (0, 1):
        noise = np.where(np.arange(2) == louder, 8e-9, 2e-9)
        data = recorded(u, noise=noise)
        for given, level in ((None, pytest.approx(8e-9, rel=0.2)), (1e-9, 1e-9)):
            with pytest.raises(Designing) as caught:
                identify_stage(data, realisations(data), StageRequest(order=4, noise=given))
            assert caught.value.args == (level,)


@pytest.mark.parametrize(("peak", "warned"), [(1.9, False), (2.1, True)])
def test_a_loop_that_is_too_sensitive_on_the_measured_response_is_warned_of(monkeypatch, peak, warned):
    """The limit of a design is 2."""
    monkeypatch.setattr(stage_identification, "whole_loop", lambda *given: (None, None))
    found = SimpleNamespace(sensitivity_peak=SimpleNamespace(low=peak))
    monkeypatch.setattr(stage_identification, "loop_of", lambda *given: found)
    response = SimpleNamespace(
        degrees=4, sample_time=STEP, frequency=None, single=None, radius=lambda: np.zeros((1, 1, 1))
    )
    unknown = SimpleNamespace(response=SimpleNamespace(degrees=None))
    designs = dict.fromkeys("xy", SimpleNamespace(parameters=None))
    said = stage_identification._measured(designs, [unknown, SimpleNamespace(response=response)])
    assert len(said) == warned and all(text.startswith("axis y: on the measured response") for text in said)


def test_a_loop_slower_than_anything_that_was_measured_is_warned_of():
    response = SimpleNamespace(response=SimpleNamespace(frequency=np.array([2.0, 4.0, 6.0]), degrees=None))
    designs = {name: SimpleNamespace(margins=SimpleNamespace(bandwidth=f)) for name, f in (("x", 2.5), ("y", 0.009))}
    (said,) = stage_identification._too_slow(designs, [response, response], 73e-9)
    assert said.startswith(
        "axis y: the loop has a bandwidth of 0.009 Hz only, below the lowest measured frequency of 2 Hz"
    )
    assert said.endswith("the noise of 73 nm may be the reason: give --noise")
    assert "noise" not in stage_identification._too_slow(designs, [response, response], None)[0]


@pytest.mark.parametrize(("bandwidth", "unsure", "warned"), [(0.05, 0.8, True), (3.0, 0.8, True), (3.0, 0.4, False)])
def test_a_loop_that_is_slow_because_its_response_is_not_known_is_answered_with_more_realisations(
    bandwidth, unsure, warned
):
    """The response at 40 Hz, far above the loop, is less known still, and is not the reason."""
    response = SimpleNamespace(
        frequency=np.array([2.0, 4.0, 40.0]),
        degrees=3.0,
        single=np.ones(3),
        radius=lambda: np.array([unsure, 0.2, 5.0])[:, np.newaxis, np.newaxis],
    )
    designs = {"y": SimpleNamespace(margins=SimpleNamespace(bandwidth=bandwidth))}
    said = stage_identification._too_slow(designs, [SimpleNamespace(response=response)], 5e-9)
    assert len(said) == warned
    if warned:
        assert "its response at 2 Hz is known to ±80 %" in said[0] and "--realisations" in said[0]
        assert "noise" not in said[0]


@pytest.mark.slow
def test_excitations_that_a_stage_cannot_play_are_refused(truth):
    configuration = load_configuration(truth)
    for asked, words in (
        (StageExcitation(realisations=1), "--realisations 1: must be at least 2, one for each of the axes x, y"),
        (StageExcitation("decaying", one_by_one=True), "belong to the recipe multisine"),
        (StageExcitation(amplitude=6.0), "--amplitude 6: must be above 0 and at most 5"),
        (StageExcitation(frequency=2000.0), "must be at most 312.5 Hz"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            excited_stage(configuration, asked, truth)


@pytest.mark.slow
def test_hr_identify_takes_several_inputs_and_outputs(truth):
    found = hr.identify(
        truth.with_name("multisine.npz"), columns=hr.StageColumns(), options={"controller": "none", "order": 4}
    )
    assert found.parameters.names == ("x", "y")
    assert found.parameters.axes[0].motion_controller.type == "open_loop"
    with pytest.raises(HysteresisError, match="rank: no such option of a stage"):
        hr.identify(truth.with_name("multisine.npz"), columns=hr.StageColumns(), options={"rank": 2})


def test_what_the_loops_need_together_is_stated_once_and_not_for_each_axis(monkeypatch):
    design = SimpleNamespace(
        together="the controller is slower; otherwise M_s 2.4 of all loops together above 2",
        margins=SimpleNamespace(bandwidth=100.0),
    )
    for name, value in (("design_controllers", dict.fromkeys("xy", design)), ("controllers_file", "text")):
        monkeypatch.setattr(stage_identification, name, lambda *given, value=value: value)
    for name in ("require_stable", "with_designs"):
        monkeypatch.setattr(stage_identification, name, lambda *given: None)
    for name in ("_measured", "_too_slow"):
        monkeypatch.setattr(stage_identification, name, lambda *given: [])
    given = load_configuration("xy_scanner").text
    _, _, said = stage_identification.design_identified(given, None, StageRequest(), None, (), {})
    assert said == [f"all loops together: {design.together}"]
