# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis frf`` with the recording of a stage: response matrix, files, design with it, refusals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.commissioning.bench import OfflineBench
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.designs.stage_frequency_response import (
    command_responses,
    load_stage_response,
    recorded_stage_response,
)
from hysteresis_ros.identification.excitations import orthogonal_multisines
from hysteresis_ros.identification.frequency_response import FrequencyResponse, ResponseMatrix
from hysteresis_ros.identification.stage_data import read_stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import stage_plant
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run

STEP, PERIOD, NOISE = 1e-4, 500, 2e-9
#: Gains [m/V] and time constants [s] of first-order plants, output by input.
GAIN = 1e-7 * np.array([[4.0, 0.2], [0.15, 3.0]])
TIME = 1e-3 * np.array([[0.5, 1.0], [0.8, 0.4]])
#: Refusal of the commands of a single axis.
MATRIX = "contains the response matrix of a stage"


def command(*words, code=0):
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exit_code == code, result.output
    if code:
        assert result.stderr.startswith("hysteresis: ") and len(result.stderr.splitlines()) == 1, result.stderr
    return result


def truth(frequency) -> np.ndarray:
    pole, z = np.exp(-STEP / TIME), np.exp(2j * np.pi * np.asarray(frequency) * STEP)[:, None, None]
    return GAIN * (1.0 - pole) / (z - pole)


def multisines(realisations=8, repeats=3) -> np.ndarray:
    table = 5.0 * orthogonal_multisines(2, PERIOD, np.arange(1, 240), realisations)
    played = np.concatenate([np.tile(one, (repeats, 1)) for one in table])
    return np.concatenate([np.zeros((100, 2)), played, np.zeros((50, 2))])


def recording(u, cubic=0.0, noise=NOISE, seed=3) -> Recording:
    """Return the recording of a stage of first-order plants, with a cubic distortion [1/V²] in the voltages."""
    y, pole = np.zeros_like(u), np.exp(-STEP / TIME)
    state = np.zeros((2, 2))
    for k, volts in enumerate(u + cubic * u**3):
        y[k] = state.sum(axis=1)
        state = pole * state + GAIN * (1.0 - pole) * volts
    y += noise * np.random.default_rng(seed).standard_normal(y.shape)
    signals = {f"{axis}/voltage": u[:, i] for i, axis in enumerate("xy")}
    signals |= {f"{axis}/measured": y[:, i] for i, axis in enumerate("xy")}
    units = {name: "V" if name.endswith("voltage") else "m" for name in signals}
    return Recording(STEP * np.arange(len(u)), signals, units)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the folder with the recording and the results, and the result of the command."""
    folder = tmp_path_factory.mktemp("frf")
    path = folder / "run.npz"
    save_run(recording(multisines()), path)
    files = [word for suffix in ("npz", "csv", "yaml") for word in ("-o", folder / f"response.{suffix}")]
    pages = ("--plot", folder / "response.png", "--report", folder / "response.html", "--json", folder / "f.json")
    return folder, command("frf", path, *files, *pages)


def test_the_matrix_is_that_of_the_plants_within_its_bands(written):
    names, found = load_stage_response(written[0] / "response.npz")
    response = found.response
    assert names == ("x", "y") and response.frequency.size == 239
    error = np.abs(response.response - truth(response.frequency))
    inside = np.mean(error <= response.radius(0.95), axis=0)
    # 95 % of 239 lines, ± 4 standard deviations
    assert np.all(np.abs(inside - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 239)), inside
    assert found.condition.max() < 1.01


def test_the_table_has_each_pair_and_the_condition_number(written):
    folder, result = written
    assert "voltages of x, y → displacements of x, y" in result.stdout
    assert "condition number of the inputs  1 at most" in result.stdout
    assert "multisine, 8 realisations of 2 periods of 50 ms" in result.stdout
    figures = json.loads((folder / "f.json").read_text())
    for i, target in enumerate("xy"):
        for j, source in enumerate("xy"):
            pair = figures[f"{target}_from_{source}"]
            assert f"{source} → {target}" in result.stdout
            assert pair["gain_m_per_v"] == pytest.approx(GAIN[i, j] * (1.0 if i == j else 0.85), rel=0.2)
    assert figures["x_from_x"]["signal_to_noise_db"] > figures["x_from_y"]["signal_to_noise_db"] + 10.0


def test_the_files_have_the_same_lines(written):
    folder, _ = written
    _, found = load_stage_response(folder / "response.npz")
    head = (folder / "response.csv").read_text().split("\n", 1)[0].split(",")
    table = np.loadtxt(folder / "response.csv", delimiter=",", skiprows=1)
    place = head.index("y_from_x_magnitude [m/V]")
    np.testing.assert_allclose(table[:, place], np.abs(found.response.response[:, 1, 0]), rtol=1e-8)
    assert "y_from_x_distortion [m/V]" in head and head[-1] == "condition [1]"
    assert "x_from_y_radius_95_percent [m/V]" in (folder / "response.yaml").read_text()
    assert (folder / "response.png").read_bytes()[:4] == b"\x89PNG"
    page = (folder / "response.html").read_text()
    assert "Response of y to each actuator" in page and "condition number of the inputs" in page


def test_noise_and_distortion_are_told_apart():
    u = multisines()
    plain, bent = (recorded_stage_response(read_stage(recording(u, cubic))) for cubic in (0.0, 1e-2))
    # the mean of 8 realisations of 2 periods; each line of an input has 5 V / its own crest
    size = np.abs(np.fft.rfft(u[100 + PERIOD : 100 + 2 * PERIOD, 0]) / PERIOD)[1:240]
    expected = NOISE / np.sqrt(2.0 * PERIOD) / np.sqrt(8.0) / np.sqrt(np.mean(size**2))
    for found in (plain, bent):
        assert np.sqrt(np.mean(found.noise**2)) == pytest.approx(expected, rel=0.1)
    low = slice(0, 50)  # far below the corner frequencies
    assert np.median(plain.distortion[low]) < 0.7 * expected
    assert np.median(bent.distortion[low, 0, 0]) > 3.0 * expected


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda u: u[:, [0, 0]], ("x and y", "the excitations are correlated: condition number", "at most 1000")),
        (lambda u: u * [1.0, 0.0], ("y does not move", "--recipe multisine")),
        (lambda u: u[: 100 + 3 * PERIOD], ("1 experiments cannot separate 2 inputs",)),
        (lambda u: np.concatenate([u, 3.0 * u]), ("several levels", "hysteresis identify")),
        (lambda u: 1e-4 * u, ("the excitation of x is too weak", "--amplitude by a factor")),
        (
            lambda u: np.random.default_rng(1).standard_normal((4000, 1)) * [1.0, 2.0],
            ("x and y", "the excitations are correlated", "around"),
        ),
    ],
    ids=["correlated", "still", "one", "levels", "weak", "noise"],
)
def test_a_recording_without_a_matrix_is_refused_and_nothing_is_written(make, words, tmp_path):
    path, output = tmp_path / "run.npz", tmp_path / "out.npz"
    save_run(recording(make(multisines(4))), path)
    said = command("frf", path, "-o", output, code=2).stderr
    assert all(word in said for word in words), said
    assert not output.exists()


def test_inputs_that_do_not_repeat_give_a_matrix_without_periods(tmp_path):
    path = tmp_path / "run.npz"
    save_run(recording(np.random.default_rng(1).standard_normal((8000, 2))), path)
    said = command("frf", path).stdout
    assert "no periods" in said and "noise and nonlinear distortion are not separated" in said


def test_options_of_a_single_axis_are_refused(written):
    path = written[0] / "run.npz"
    for words in (("--loop", "closed"), ("--at", "command"), ("--excitation", "noise")):
        assert "omit it" in command("frf", path, *words, code=2).stderr
    assert "omit it" in command("frf", "xy_scanner", "--offset", "0.4", code=2).stderr
    said = command("frf", "xy_scanner", "--points", "9", code=2).stderr
    assert "--points 9: " in said and "is of a stage, whose response matrix is measured" in said
    assert "excitation cannot be changed; omit" in command("frf", path, "--points", "9", code=2).stderr
    assert "without a unit" in command("frf", "xy_scanner", "--offline", "--amplitude", "2V", code=2).stderr
    assert "omit --namespace" in command("frf", "xy_scanner", "--namespace", "x", code=2).stderr


def test_samples_for_which_the_machine_was_too_busy_are_told(monkeypatch):
    whole = OfflineBench.run

    def busy(self, stage):
        run = whole(self, stage)
        late = np.minimum(np.arange(len(run)), 7.0)
        return Recording(run.time, run.signals | {f"{axis}/late": late for axis in "xy"}, run.units, run.metadata)

    words = ("frf", "xy_scanner", "--offline", "--realisations", "2", "--periods", "1")
    assert "too busy" not in command(*words).stderr
    monkeypatch.setattr(OfflineBench, "run", busy)
    said = command(*words).stderr
    assert "this machine was too busy for 7 of 28000 samples: " in said and "counts as noise or distortion" in said


def test_commands_of_a_single_axis_refuse_the_matrix(written, tmp_path):
    response, out = written[0] / "response.npz", tmp_path / "out.yaml"
    words = ("design", "kim2009", "--controller", "pid", "--response", response, "-o", out)
    assert MATRIX in command(*words, code=2).stderr
    assert MATRIX in command("identify", response, "-o", out, code=2).stderr
    wrong = ("design", "xy_scanner", "--response", written[0] / "run.npz", "-o", out)
    assert "contains no response matrix" in command(*wrong, "--controller", "pid", code=2).stderr
    mirror = ("design", "steering_mirror", "--controller", "pid", "--response", response, "-o", out)
    assert "has the axes x, y, but the stage has" in command(*mirror, code=2).stderr
    assert not out.exists()


@pytest.mark.parametrize("name", ["frequency", "response", "noise_variance", "condition", "sample_time", "axes"])
def test_a_damaged_file_of_a_matrix_is_refused(name, written, tmp_path):
    path = tmp_path / "response.npz"
    with np.load(written[0] / "response.npz") as held:
        arrays = dict(held)
    arrays[name] = np.atleast_1d(arrays[name])[:-1]
    np.savez(path, **arrays)
    words = ("design", "xy_scanner", "--controller", "pid", "--response", path, "-o", tmp_path / "out.yaml")
    assert "contains no response matrix" in command(*words, code=2).stderr


def test_the_matrix_of_the_model_is_the_plant_of_each_axis():
    """Through the decoupling, a matrix that was measured at the voltages is the plant from the commands."""
    configuration = load_configuration("xy_scanner")
    other = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 0.3e-6}
    configuration = replace(configuration, entries=(*configuration.entries, ("/y/hysteresis_compensator", other)))
    parameters = StageParameters.from_configuration(configuration)
    step = 1.0 / parameters.sample_rate
    frequency = np.linspace(5.0, 2000.0, 300)
    plant = stage_plant(parameters).response(np.exp(2j * np.pi * frequency * step))
    gains = [hysteresis_block(axis.hysteresis_compensator.hysteresis, step).gain for axis in parameters.axes]
    assert gains[0] > 1.2 * gains[1]
    at_voltages = plant @ np.linalg.inv(parameters.stage.matrix("decoupling")) @ np.diag(gains)
    matrix = ResponseMatrix(FrequencyResponse(frequency, at_voltages, step), None, None, np.ones(300))
    found = command_responses(parameters, ("x", "y"), matrix)
    for i, name in enumerate("xy"):
        np.testing.assert_allclose(found[name].response.single, plant[:, i, i], rtol=1e-9)
        assert found[name].response.input_unit == "V"


def test_a_stage_is_measured_and_its_recording_gives_the_same_again(tmp_path):
    path, first, second = tmp_path / "run.npz", tmp_path / "first.json", tmp_path / "second.json"
    words = ("--period", "20ms", "--amplitude", "0.05", "--realisations", "4", "--offline")
    command("frf", "xy_scanner", *words, "--record", path, "--json", first)
    command("frf", path, "--json", second)
    figures = json.loads(first.read_text())
    assert figures == json.loads(second.read_text())
    assert figures["x_from_x"]["largest_at_hz"] == 700.0 and figures["y_from_y"]["largest_at_hz"] == 800.0
    # the cross-talk of the file is 4 %
    assert figures["y_from_x"]["gain_m_per_v"] == pytest.approx(0.04 * figures["x_from_x"]["gain_m_per_v"], rel=0.3)
    assert load_run(path).axes == ("x", "y")
