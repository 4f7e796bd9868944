# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From a recording to a parameter file and back, through the commands: every model, and messages for bad input."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_support import run
from measured_data import measured_data

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.identification.parameter_file import load_chain
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import PlantNodeParameters, part
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters, BoucWenOscillator
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import LinearParameters

RATE = 200.0
STACK = PrandtlIshlinskiiParameters(
    radii=tuple(np.linspace(0.0, 45.0, 16)), weights=(8e-8, *[3e-9] * 15), thresholds=(6e-6,), zone_weights=(-0.05,)
)
LAG = float(np.exp(-1.0 / (RATE * 0.01)))


def refused(result) -> str:
    """One line on stderr, after lines of progress on a slow machine, and exit code 2."""
    assert result.exit_code == 2, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    lines = [line for line in result.stderr.strip().splitlines() if not line.lstrip().startswith("…")]
    assert len(lines) == 1, lines
    return lines[0]


def loops(samples: int = 1600) -> np.ndarray:
    """Two cycles of 0 … 100 V, then cycles of decreasing amplitude: voltage [V] at 200 Hz."""
    phase = np.arange(samples) / 200.0
    fall = np.where(phase < 2.0, 1.0, np.exp(-(phase - 2.0) / 3.0))
    return 50.0 - 50.0 * fall * np.cos(2.0 * np.pi * phase)


def measured(voltage, lag=LAG, offset=-3e-6, noise=5e-9, seed=1) -> np.ndarray:
    """Return the measured displacement [m] of a Prandtl-Ishlinskii stack with a lag of 10 ms."""
    parameters = ActuatorParameters(
        limits=LimitsParameters(minimum=-200.0, maximum=200.0),
        hysteresis=HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=STACK),
        dynamics=LinearParameters(A=(lag,), B=(1.0 - lag,), C=(1.0,)),
    )
    plant = Actuator(parameters, 1.0 / RATE)
    found = np.empty(len(voltage))
    for k, volts in enumerate(voltage):
        found[k] = plant.measure()
        plant.advance(volts)
    return found + offset + noise * np.random.default_rng(seed).standard_normal(len(voltage))


def write(path, voltage, displacement, rate=RATE, header="t_s,control_V,gauge_um"):
    table = np.column_stack([np.arange(len(voltage)) / rate, voltage, np.asarray(displacement) * 1e6])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    voltage = loops()
    return write(tmp_path_factory.mktemp("data") / "loops.csv", voltage, measured(voltage))


@pytest.fixture(scope="module")
def oscillation(tmp_path_factory):
    rate, random = 750.0, np.random.default_rng(3)
    phases = random.uniform(0.0, 2.0 * np.pi, 60)
    time = np.arange(1024) / rate
    u = 8.0 * np.sum(np.cos(2.0 * np.pi * np.outer(time, np.arange(4, 64)) * rate / 512.0 + phases), axis=1)
    truth = BoucWenMechanicalParameters(
        mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1, substeps=16
    )
    y = BoucWenOscillator(truth, 1.0 / rate).response(u) + 1e-6 * random.standard_normal(u.size)
    path = tmp_path_factory.mktemp("data") / "oscillation.csv"
    return write(path, u, y, rate, "t_s,u_V,y_um")


#: Largest residual [% of stroke] of each model on held-out loops; the truth is a modified Prandtl-Ishlinskii model.
RESIDUALS = {
    "prandtl_ishlinskii": 0.2,
    "preisach": 0.5,
    "polynomial": 3.0,
    "bouc_wen": 3.0,
    "duhem": 1.5,
    "proportional": 12.0,
}


@pytest.mark.parametrize("model", RESIDUALS)
def test_every_model_goes_from_a_table_to_nodes_and_back(model, recording, tmp_path):
    path = tmp_path / "params.yaml"
    # the choice of the linear dynamics is tried with the models that are found fastest
    options = [] if model in ("prandtl_ishlinskii", "proportional") else ["--linear", "lag"]
    options += ["-p", "shape=spline"] if model == "duhem" else []
    result = run("identify", recording, "--model", model, "-o", path, "--json", "-", *options)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["rmse_percent_of_stroke"] < RESIDUALS[model]
    assert figures["inverse_rmse_v"] < 0.02 * RESIDUALS[model] * 100.0
    # the plant of the nodes, driven with the recorded voltage, measures what the command predicted
    axis = axes(load_configuration(path))[0]
    assert axis.plant_simulator.sample_rate == RATE
    Axis(axis)
    voltage = loops()
    plant = Actuator(part(axis.plant_simulator, ActuatorParameters), 1.0 / RATE)
    found = []
    for volts in voltage:
        found.append(plant.measure())
        plant.advance(volts)
    chain, section = load_chain(path)
    predicted = predict(chain, voltage, 1.0 / RATE, "zoh", "zero")
    # the recording may be quasi-static, where the axis reads one sample later, and creep starts settled at 0 V on both
    shift = int(chain.synchronous)
    assert np.max(np.abs(np.array(found[shift:]) - predicted[: len(found) - shift])) < 1e-12
    assert section["source"] == "loops.csv" and section["converged"] is True
    again = run("validate", path, recording, "--skip", figures["skipped"], "--json", "-", "--no-inverse")
    assert again.exit_code == 0, again.output
    assert json.loads(again.stdout)["rmse_m"] == pytest.approx(figures["rmse_m"], rel=1e-3)


def test_lag_is_told_from_hysteresis_and_the_file_says_where_it_comes_from(recording, tmp_path):
    path = tmp_path / "params.yaml"
    result = run("identify", recording, "--linear", "lag", "--offset", "free", "-o", path, "--json", "-")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    # the lag of the stage, without the half sample by which a held input delays
    assert figures["lag_s"] == pytest.approx(0.010, abs=0.001)
    assert figures["offset_m"] == pytest.approx(-3e-6, abs=2e-7)
    chain, section = load_chain(path)
    assert chain.offset == 0.0 and "preload.A1" not in load_configuration(path).node("plant_simulator")
    assert section["sample_range"] == [0, 1600]
    assert any("assum" in name for name in section) and section["metrics.rmse_m"] == figures["rmse_m"]


def test_oscillator_is_found_without_initial_values(oscillation, tmp_path):
    path = tmp_path / "params.yaml"
    arguments = ["--input", "u_V:V", "--output", "y_um:um", "-o", path, "--json", "-", "-p", "trials=16"]
    result = run("identify", oscillation, "--model", "bouc_wen_mechanical", *arguments)
    assert result.exit_code in (0, 3), result.output
    figures = json.loads(result.stdout)
    assert figures["rmse_m"] < 5e-6 and figures["inverse_rmse_v"] is None
    found = load_chain(path)[0].hysteresis.bouc_wen_mechanical
    assert found.mass == pytest.approx(2.0, rel=0.05)
    assert found.stiffness + found.alpha == pytest.approx(1e5, rel=0.05)
    Axis(axes(load_configuration(path))[0])


@pytest.mark.parametrize("linear", ["second_order", "arx2", "frequency_response"])
def test_resonance_comes_back_behind_a_gain(linear, tmp_path):
    rate, w = 1000.0, 2.0 * np.pi * 60.0
    random = np.random.default_rng(5)
    u = 50.0 + 5.0 * random.standard_normal(4000)
    damped = w * np.sqrt(1.0 - 0.1**2)
    poles = np.exp((-0.1 * w + 1j * damped * np.array([1.0, -1.0])) / rate)
    a = np.real(np.poly(poles))
    y = np.zeros(u.size)
    for k in range(2, u.size):
        y[k] = -a[1] * y[k - 1] - a[2] * y[k - 2] + 1e-7 * a.sum() * u[k - 1]
    path = write(tmp_path / "noise.csv", u, y + 1e-10 * random.standard_normal(u.size), rate)
    result = run(
        "identify", path, "--model", "proportional", "--linear", linear, "-o", tmp_path / "p.yaml", "--json", "-"
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["fit_percent"] > (75.0 if linear == "second_order" else 97.0)
    plant = PlantNodeParameters.from_mapping(load_configuration(tmp_path / "p.yaml").node("plant_simulator"))
    found = plant.dynamics.state_space.poles
    fastest = found[np.argmax(np.abs(found.imag))]
    assert abs(np.angle(fastest)) * rate / (2.0 * np.pi) == pytest.approx(60.0, rel=0.05)


def test_quasi_static_sweep_with_a_minor_loop_needs_no_settings(tmp_path):
    parts = [(0, 100, 200), (100, 0, 200), (0, 100, 200), (100, 30, 140), (30, 70, 80), (70, 0, 140)]
    voltage = np.concatenate([np.linspace(start, end, count) for start, end, count in parts])
    y = PrandtlIshlinskiiHysteresis(STACK, 1.0).simulate(voltage)
    y += 2e-9 * np.random.default_rng(0).standard_normal(y.size)
    np.savez(tmp_path / "sweep.npz", voltage=voltage, displacement_nm=y * 1e9)
    arguments = ["--sample-time", "1", "-o", tmp_path / "p.yaml", "--json", "-"]
    result = run("identify", tmp_path / "sweep.npz", "--output", "displacement_nm:nm", *arguments)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["rmse_m"] < 5e-9 and "lag_s" not in figures
    assert load_chain(tmp_path / "p.yaml")[0].synchronous


def test_bipolar_stack_at_another_rate_and_another_sampling(tmp_path):
    voltage = 150.0 * np.sin(2.0 * np.pi * np.arange(8000) / 2000.0)
    y = PrandtlIshlinskiiHysteresis(STACK, 1.0).simulate(voltage)
    path = write(tmp_path / "a.csv", voltage, y + 4e-9 * np.random.default_rng(0).standard_normal(y.size), 2000.0)
    result = run("identify", path, "--model", "preisach", "-o", tmp_path / "p.yaml", "--json", "-")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["rmse_percent_of_stroke"] < 0.5
    limits = load_configuration(tmp_path / "p.yaml").node("plant_simulator")
    assert limits["limits.minimum"] == pytest.approx(-150.0) and limits["limits.maximum"] == pytest.approx(150.0)
    coarse = write(tmp_path / "b.csv", voltage[::4], y[::4], 500.0)
    for intersample in ("zoh", "linear", "bandlimited"):
        again = run("validate", tmp_path / "p.yaml", coarse, "--intersample", intersample, "--json", "-", "--skip", 500)
        assert json.loads(again.stdout)["rmse_percent_of_stroke"] < 0.6, intersample


def test_fit_that_does_not_converge_writes_its_best_point_and_ends_with_3(recording, tmp_path):
    path = tmp_path / "params.yaml"
    result = run("identify", recording, "--model", "bouc_wen", "--linear", "none", "-p", "iterations=4", "-o", path)
    assert result.exit_code == 3, result.output
    assert "did not converge" in result.stderr
    _, section = load_chain(path)
    assert section["converged"] is False
    assert any("did not converge" in text for text in section["warnings"])


def test_clipped_data_is_warned_of_in_file_and_report(tmp_path):
    pytest.importorskip("matplotlib", reason="reports need Matplotlib")
    pytest.importorskip("jinja2", reason="reports need Jinja2")
    voltage = loops(800)
    y = measured(voltage)
    path = write(tmp_path / "clipped.csv", voltage, np.minimum(y, y.max() - 2e-7))
    report = tmp_path / "report.html"
    result = run("identify", path, "--model", "preisach", "-o", tmp_path / "p.yaml", "--report", report)
    assert result.exit_code == 0, result.output
    assert any("clipped" in text for text in load_chain(tmp_path / "p.yaml")[1]["warnings"])
    page = report.read_text(encoding="utf-8")
    assert "clipped" in page and page.count("data:image/png") == 5 and "Assumptions" in page


def test_what_the_recording_shows_is_printed_before_the_figures_in_its_units(tmp_path):
    voltage = loops(800)
    table = np.column_stack([np.arange(800) / RATE, 10.0 * voltage, 1e6 * measured(voltage)])
    path = tmp_path / "brake.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,coil_mA,torque", comments="")
    quick = ("--model", "proportional", "--linear", "none", "-o", tmp_path / "p.yaml")
    result = run("identify", path, *quick, "--output-unit", "N")
    assert result.exit_code == 0, result.output
    before, figures = result.stdout.split("\n\n")
    said = dict(row.split(maxsplit=1) for row in before.splitlines())
    assert said["input"].startswith("coil: 0 A … 1 A") and said["output"].startswith("torque: ")
    assert {"units", "direction", "shape", "saturation", "drift", "repetition", "content"} <= set(said)
    shown = dict(row.split(maxsplit=1) for row in figures.splitlines()[:6])
    assert shown["rmse"].endswith(" N") and shown["inverse_rmse_a"].endswith(" A")
    # with JSON on stdout the summary does not disturb it
    again = run("identify", path, *quick, "--output", "torque:N", "--json", "-")
    assert json.loads(again.stdout)["rmse_n"] > 0.0 and again.stderr.count("direction  ") == 1
    other = ("--input", "coil_mA", "--output", "torque:um")
    result = run("validate", tmp_path / "p.yaml", path, *other)
    assert result.exit_code == 2 and "identified in A and N" in result.stderr


def bad(name):
    """Return voltage, displacement and header of bad data, with words that the message must contain."""
    voltage = loops(800)
    y = measured(voltage)
    header = "t_s,control_V,gauge_um"
    return {
        "short": (voltage[:30], y[:30], header, "too short"),
        "constant": (voltage, np.full(800, 1e-6), header, "constant"),
        "missing": (voltage, np.where(np.arange(800) % 100 < 8, np.nan, y), header, "missing"),
        "single branch": (np.linspace(0.0, 100.0, 800), np.linspace(0.0, 1e-5, 800), header, "reverses"),
        "without units": (voltage, y, "t_s,control_V,gauge", "has no unit"),
        "wrong way round": (voltage, -y, header, "--negate"),
        "two columns in V": (voltage, y, "t_s,left_V,right_V", "the column of the"),
    }[name]


@pytest.mark.parametrize(
    "name",
    ["short", "constant", "missing", "single branch", "without units", "wrong way round", "two columns in V"],
)
def test_bad_data_is_refused_in_one_line(name, tmp_path):
    voltage, y, header, words = bad(name)
    path = write(tmp_path / "bad.csv", voltage, y, header=header)
    result = run("identify", path, "-o", tmp_path / "p.yaml")
    assert words in refused(result)
    assert not (tmp_path / "p.yaml").exists()


@pytest.mark.parametrize("uneven", ["jitter", "holes"])
def test_data_that_is_not_uniform_is_refused_until_it_is_resampled(uneven, tmp_path):
    """No part between two holes is long enough to be used alone."""
    number = np.arange(1000.0)
    if uneven == "jitter":
        number += np.random.default_rng(3).uniform(-0.3, 0.3, 1000)
    else:
        number = number[number % 250.0 < 200.0]
    voltage = np.interp(number, np.arange(1000), loops(1000))
    table = np.column_stack([number / RATE, voltage, measured(voltage) * 1e6])
    path = tmp_path / "uneven.csv"
    np.savetxt(path, table, delimiter=",", header="t_s,control_V,gauge_um", comments="")
    said = refused(run("identify", path, "-o", tmp_path / "p.yaml"))
    assert "not uniformly sampled" in said and "add --resample auto" in said
    quick = ("--model", "preisach", "--linear", "none")
    result = run("identify", path, *quick, "--resample", "auto", "-o", tmp_path / "p.yaml")
    assert result.exit_code == 0, result.output
    assert any("resampled" in text for text in load_chain(tmp_path / "p.yaml")[1]["notes"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--model", "preisac"], "must be one of"),
        (["--linear", "lags"], "must be auto, none"),
        (["--linear", "arx,lag"], "cannot be combined"),
        (["--model", "proportional", "--linear", "creep"], "cannot be used with"),
        (["-p", "plays=3"], "options of prandtl_ishlinskii"),
        (["-p", "play_count=many"], "must be a whole number"),
        (["--inverse", "multiplicative"], "usual has exact"),
        (["--input", "control"], "no column 'control'"),
        (["--output", "gauge_um:furlong"], "unknown unit"),
        (["--range", "5"], "FIRST:LAST"),
        (["--range", "0:99999"], "choose a range inside"),
        (["--skip", "1590"], "skip"),
        (["--sample-time", "0"], "must be above 0"),
    ],
)
def test_wrong_options_are_refused_in_one_line(arguments, words, recording, tmp_path):
    assert words in refused(run("identify", recording, "-o", tmp_path / "p.yaml", *arguments))


def test_missing_files_are_refused(recording, tmp_path):
    assert "no such file" in refused(run("identify", tmp_path / "none.csv", "-o", tmp_path / "p.yaml"))
    assert "no such file" in refused(run("validate", tmp_path / "none.yaml", recording))
    quick = ("--model", "proportional", "--linear", "none")
    assert "cannot be written" in refused(run("identify", recording, *quick, "-o", tmp_path / "none" / "p.yaml"))


def test_validation_beyond_the_range_of_the_identification_is_warned_of(recording, tmp_path):
    run("identify", recording, "--model", "proportional", "--linear", "none", "-o", tmp_path / "p.yaml")
    voltage = 1.2 * loops(800)
    path = write(tmp_path / "more.csv", voltage, measured(voltage))
    result = run("validate", tmp_path / "p.yaml", path)
    assert result.exit_code == 0, result.output
    assert "extrapolated" in result.stdout


def test_models_lists_every_model_with_parameters_units_and_inverses():
    text = run("models").stdout
    for name, model in MODELS.items():
        assert f"{name}: " in text and model.inverses[0] in text
    assert "weights [m/V]" in text and "force_per_input [N/V]" in text
    one = json.loads(run("models", "bouc_wen", "--json").stdout)["bouc_wen"]
    assert one["inverses"][0] == "multiplicative"
    assert {"name": "d_e", "unit": "m/V"}.items() <= one["parameters"][0].items()
    assert "must be one of" in refused(run("models", "nothing"))


def test_unused_creep_leaves_no_trace_in_the_file(recording, tmp_path):
    run("identify", recording, "--linear", "none", "--model", "preisach", "-o", tmp_path / "p.yaml")
    chain, _ = load_chain(tmp_path / "p.yaml")
    assert chain.creep == CreepParameters() and chain.dynamics.order == 0


def test_measured_piezo_predicts_the_recording_it_has_not_seen(tmp_path):
    columns = [
        "--input",
        "control_V:V",
        "--output",
        "cap_sensor_um:um",
        "--skip",
        400,
        "--offset",
        "free",
        "--json",
        "-",
    ]
    path = tmp_path / "params.yaml"
    source = measured_data("yan9a_dbo")
    first = run("identify", source / "model_1Hz_major.csv", "--model", "preisach", "-o", path, *columns)
    assert first.exit_code == 0, first.output
    assert json.loads(first.stdout)["rmse_m"] < 0.12e-6
    second = json.loads(run("validate", path, source / "test_1Hz_variable_amplitude.csv", *columns).stdout)
    assert second["rmse_m"] < 0.23e-6 and second["inverse_rmse_v"] < 0.02


def test_identified_stage_that_comes_with_the_package_runs():
    axis = axes(load_configuration("picma_stage"))[0]
    signals = Axis(axis).run(np.zeros(1040))
    # the last hundred milliseconds of each step
    for start in (0.2, 1.2, 2.2, 3.2, 4.2):
        late = slice(round((start + 0.9) * RATE), round((start + 0.99) * RATE))
        assert np.max(np.abs(signals["reference"][late] - signals["displacement"][late])) < 0.05e-6
    assert np.all((signals["voltage"] >= 0.0) & (signals["voltage"] <= 3.6))


def test_loops_beside_the_recording_of_a_single_axis_are_refused_with_the_way_of_a_single_axis(recording, tmp_path):
    """``--loops`` is for a stage; the message asked for columns of one."""
    result = run("identify", str(recording), "--loops", str(recording), "-o", str(tmp_path / "out.yaml"))
    assert result.exit_code == 2
    assert f"--loops is for a stage, and {recording} is not the recording of a stage" in result.output
    assert "--input and --output" in result.output and not (tmp_path / "out.yaml").exists()
