# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The frequency response of an axis, from its own run: plant, closed loop, recordings, files, pictures, refusals."""

from __future__ import annotations

import hashlib
import json
import pathlib
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.designs.frequency_response import (
    ResponseRequest,
    axis_response,
    measured_loop_parts,
    recorded_response,
    response_run,
)
from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.identification.excitations import Experiment
from hysteresis_ros.identification.frequency_response import load_response, save_response
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.recordings.provenance import DIGEST, packed_files

#: Kim's axis with a PID of moderate gains, and a sensor of 0.5 nm.
GAINS = {"pid__Kp": -0.1225, "pid__Ki": 410.8, "pid__Kd": 5.522e-5, "pid__derivative_filter": 3770.0}
SHORT = Experiment(period=0.1, realisations=4, periods=3, settle=3)


def axis_file(**controller):
    configuration = load_configuration("kim2009").override("plant_simulator", sensor__noise=5e-10)
    return configuration.override("motion_controller", type="pid", **GAINS, **controller)


def measured(tmp_path, asked, configuration=None):
    configuration = configuration or axis_file()
    axis, plan = response_run(configuration, None, asked, tmp_path / "excitation.npz")
    run = simulate(axis)
    return run, plan, axis_response(run, plan, single_axis(configuration))


def test_the_open_loop_at_the_command_is_the_linear_part_and_at_the_voltage_the_hysteresis_is_odd_distortion(tmp_path):
    _, _, through = measured(tmp_path, ResponseRequest(SHORT, at="command"))
    away = np.abs(through.plant.response.frequency - 635.0) > 100.0
    error = np.abs(through.plant.response.single / through.model - 1.0)
    assert np.median(error[away]) < 0.01 and through.plant.response.input_unit == "m"
    quiet, long = load_configuration("kim2009"), Experiment(period=0.5, settle=3, periods=2, realisations=2)
    _, plan, bare = measured(tmp_path, ResponseRequest(long, amplitude="15V"), quiet)
    _, _, through = measured(tmp_path, ResponseRequest(long, at="command", amplitude="600nm"), quiet)
    assert plan.first == 6000 and (plan.loop, plan.at) == ("open", "voltage")
    assert bare.plant.response.input_unit == "V" and "nm/V" in "\n".join(bare.lines())
    levels = bare.figures
    # the branches of this polynomial are those of one range of voltage; smaller loops in it also have even harmonics
    assert levels["odd_db"] > levels["even_db"] + 5.0 > levels["noise_db"] + 40.0
    assert levels["odd_db"] > through.figures.get("odd_db", -np.inf) + 20.0, "the inverse removes the distortion"


@pytest.mark.slow
@pytest.mark.parametrize("at, kind", [("reference", "multisine"), ("command", "multisine"), ("reference", "noise")])
def test_the_closed_loop_has_the_margins_of_its_model(tmp_path, at, kind):
    experiment = SHORT if kind == "multisine" else Experiment("noise", duration=4.0, period=0.25)
    asked = ResponseRequest(experiment, "closed", at, amplitude="600nm" if at == "reference" else "15nm")
    run, plan, found = measured(tmp_path, asked)
    model, loop = found.margins, found.loop
    assert loop.sensitivity_peak.value == pytest.approx(model.sensitivity_peak, rel=0.1)
    assert loop.delay_margin.value == pytest.approx(model.delay_margin_samples, rel=0.1)
    assert loop.gain_crossovers[0] == pytest.approx(model.gain_crossovers[0], rel=0.1)
    low = found.plant.response.frequency < 400.0
    assert np.median(np.abs(loop.loop / found.model_loop - 1.0)[low]) < 0.06
    if at == "command":
        # the reference gives its part of the command a flat spectrum
        controller, _ = measured_loop_parts(single_axis(axis_file()))
        part = run["reference"][plan.first : plan.first + 300]
        own = np.abs(controller.response(np.exp(2j * np.pi * np.array(plan.lines) / 300))[:, 0, 0])
        sizes = np.abs(np.fft.rfft(part))[list(plan.lines)] * own
        np.testing.assert_allclose(sizes, sizes[0], rtol=1e-6)
    if (at, kind) != ("reference", "multisine"):
        return
    # results of a recording itself, and without the name of its controller
    path = tmp_path / "run.npz"
    save_run(run, path)
    again = recorded_response(load_run(path), plan)
    np.testing.assert_array_equal(again.loop.loop, loop.loop)
    assert again.margins.sensitivity_peak == model.sensitivity_peak
    # the recording of a graph contains the waveform with its plan, or its digest if it is large
    played = tmp_path / "excitation.npz"
    contained = replace(run, metadata=run.metadata | {"files": packed_files([played])})
    np.testing.assert_array_equal(recorded_response(contained, None).loop.loop, loop.loop)
    digest = {str(played): DIGEST + hashlib.sha256(played.read_bytes()).hexdigest()}
    large = replace(run, metadata=run.metadata | {"files": digest})
    np.testing.assert_array_equal(recorded_response(large, None).loop.loop, loop.loop)
    played.write_bytes(b"another file")
    assert recorded_response(large, None).plan != plan
    names = ("reference", "measured")
    foreign = Recording(run.time, {name: run[name] for name in names})
    unknown = recorded_response(foreign, plan)
    assert unknown.margins is None and unknown.plan.loop == "closed"
    # its law does not act on reference − measured alone: that loop has T where this axis has a different response
    assert np.median(np.abs(unknown.loop.complementary[low])) > 0.5
    with pytest.raises(ConfigurationError, match="was made with --loop closed --at reference"):
        recorded_response(foreign, plan, "open")


def test_a_damping_is_part_of_the_loop_that_was_measured_and_of_no_open_one(tmp_path):
    # at the command, which is the sum of law and damping
    damped = axis_file(damping__type="irc", damping__irc__k=1578.0, damping__irc__feedthrough=-15.52)
    _, _, found = measured(tmp_path, ResponseRequest(SHORT, "closed", amplitude="600nm"), damped)
    near = np.abs(found.plant.response.frequency - 635.0) < 60.0
    law_alone = measured_loop_parts(single_axis(axis_file()))[0]
    z = np.exp(2j * np.pi * found.plant.response.frequency / 3000.0)
    alone = -law_alone.response(z)[:, 0, 1] * found.model
    errors = [np.median(np.abs(found.loop.loop / L - 1.0)[near]) for L in (found.model_loop, alone)]
    assert errors[0] < 0.1 < 1.0 < errors[1]
    for at, amplitude in (("command", "600nm"), ("voltage", "6V")):
        run, _, _ = measured(tmp_path, ResponseRequest(SHORT, "open", at, amplitude), damped)
        np.testing.assert_allclose(run["command"], run["reference"], atol=1e-12)


def test_a_sample_of_delay_that_the_model_does_not_know_is_missing_in_the_measured_delay_margin(tmp_path):
    asked = ResponseRequest(SHORT, "closed", amplitude="600nm")
    late = axis_file().override("", faults=["late:0.0:1000.0:1"])
    _, _, found = measured(tmp_path, asked)
    _, _, slower = measured(tmp_path, asked, late)
    assert found.loop.delay_margin.value - slower.loop.delay_margin.value == pytest.approx(1.0, abs=0.15)
    assert slower.margins.delay_margin == found.margins.delay_margin


def test_a_voltage_that_was_limited_is_stated_with_the_response(tmp_path):
    asked = ResponseRequest(SHORT, "closed", amplitude="600nm")
    _, _, free = measured(tmp_path, asked)
    assert free.figures["limited_percent"] == 0.0 and not free.limitation
    slow = {node: {"limits__slew_rate": 3e3} for node in ("plant_simulator", "hysteresis_compensator")}
    configuration = axis_file()
    for node, values in slow.items():
        configuration = configuration.override(node, **values)
    run, plan, cut = measured(tmp_path, asked, configuration)
    share = np.mean(run["saturated"][plan.first : plan.first + plan.length])
    assert cut.limited == pytest.approx(100.0 * share) and 20.0 < cut.limited < 100.0
    assert f"note: the range or the slew rate limited the voltage in {cut.limited:.3g} %" in "\n".join(cut.lines())


def test_files_come_back_and_tables_have_units(tmp_path):
    _, _, found = measured(tmp_path, ResponseRequest(SHORT, "closed"))
    for suffix in (".npz", ".csv", ".yaml"):
        save_response(tmp_path / f"response{suffix}", found.plant, found.columns, found.figures)
    back = load_response(tmp_path / "response.npz")
    response = found.plant.response
    np.testing.assert_array_equal(back.response.response, response.response)
    np.testing.assert_array_equal(back.response.radius(), response.radius())
    np.testing.assert_array_equal(back.distortion.odd, found.plant.distortion.odd)
    assert back.kind == "multisine" and back.response.input_unit == "m"
    header, *rows = (tmp_path / "response.csv").read_text().splitlines()
    assert header.startswith("frequency [Hz],magnitude [m/m],phase [deg],radius_95_percent [m/m]")
    assert len(rows) == response.frequency.size and "sensitivity_radius [1]" in header
    assert "sensitivity_peak:" in (tmp_path / "response.yaml").read_text()
    with pytest.raises(RecordingError, match="write .npz, .csv or .yaml"):
        save_response(tmp_path / "response.txt", found.plant, {}, {})
    with pytest.raises(RecordingError, match="contains no frequency response"):
        load_response(tmp_path / "excitation.npz")


def hysteresis(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.mark.slow
def test_the_command_measures_keeps_and_reads(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(single_axis(axis_file()).configuration_text(), encoding="utf-8")
    short = ["--period", "0.1s", "--periods", 3, "--realisations", 2, "--settle", 2]
    kept = ["--record", tmp_path / "run.npz", "-o", tmp_path / "response.npz", "-o", tmp_path / "response.csv"]
    drawn = ["--plot", tmp_path / "plot.png", "--report", tmp_path / "page.html"]
    result = hysteresis("frf", path, "--offline", "--loop", "closed", *short, *kept, *drawn)
    assert result.exit_code == 0, result.output
    assert "delay margin" in result.output and "; model" in result.output and "odd distortion" in result.output
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
    assert "Nyquist" in (tmp_path / "page.html").read_text()
    again = hysteresis("frf", tmp_path / "run.npz", "--json", "-")
    assert again.exit_code == 0, again.output
    figures = json.loads(again.output)
    assert (
        figures["loop"] == "closed"
        and figures["lines"] == load_response(tmp_path / "response.npz").response.frequency.size
    )


@pytest.mark.parametrize(
    "words, said",
    [
        ("--high 1600Hz", "--high 1600 Hz: must be above 0 and below half the sample rate, 1500 Hz"),
        ("--low 0.1Hz", "resolves nothing below 1.5 Hz"),
        ("--amplitude 0", "must be above 0"),
        ("--amplitude 90V", "beyond -30 V … 120 V"),
        ("--amplitude 1Hz", "must be in V"),
        ("--offset 200V", "beyond -30 V … 120 V"),
        ("--loop closed --at voltage", "--at voltage: with --loop closed must be reference or command"),
        ("--amplitude 1e-6V", "is too small for the sensor's noise of 0.5 nm RMS: the signal-to-noise ratio"),
        ("--plot plot.jpg", "give the name of a .png file"),
        ("-o response.txt", "write .npz, .csv or .yaml"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    path = pathlib.Path("axis.yaml")
    path.write_text(single_axis(axis_file()).configuration_text(), encoding="utf-8")
    result = hysteresis("frf", path, "--offline", *words.split())
    assert result.exit_code == 2, result.output
    last = result.output.splitlines()[-1]
    assert last.startswith("hysteresis: ") and said in last, result.output


def test_recordings_and_axes_that_have_none_are_refused(tmp_path):
    open_loop = load_configuration("kim2009").override("motion_controller", type="open_loop")
    with pytest.raises(ConfigurationError, match="closes no loop"):
        response_run(open_loop, None, ResponseRequest(SHORT, "closed"), tmp_path / "e.npz")
    with pytest.raises(ConfigurationError, match="measure its extender alone"):
        response_run(load_configuration("inchworm_travel"), None, ResponseRequest(SHORT), tmp_path / "e.npz")
    time = np.arange(3000) / 1000.0
    noise = np.random.default_rng(1).standard_normal((2, 3000))
    path = tmp_path / "noise.csv"
    save_run(Recording(time, {"voltage": noise[0], "measured": noise[1]}), path)
    result = hysteresis("frf", path)
    assert result.exit_code == 2 and "the excitation is too weak: the signal-to-noise ratio" in result.output
    result = hysteresis("frf", path, "--amplitude", "1V")
    assert result.exit_code == 2 and "is a recording, whose excitation cannot be changed" in result.output
    assert measured_loop_parts(single_axis(axis_file()))[0].D.shape == (1, 2)
