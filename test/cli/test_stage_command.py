# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage with ``hysteresis simulate`` and ``hr.simulate``, and commands that refuse a stage."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import yaml
from command_support import hysteresis, hysteresis_process

import hysteresis_ros as hr
from hysteresis_ros.analysis.scan_report import scan_figures
from hysteresis_ros.cli.options import triggering
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError, RecordingError
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import with_scan
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.units import readable


@pytest.fixture(scope="module")
def run():
    return hr.simulate("xy_scanner", duration=0.2)


def test_a_stage_is_simulated_judged_and_written(tmp_path, run):
    path = tmp_path / "run.npz"
    said = hysteresis_process("simulate", "xy_scanner", "-o", path, "--duration", 0.2)
    assert "2000 samples at 10000 Hz (0.2 s), axes x, y" in said
    assert "x: RMS error" in said
    assert "y: RMS error" in said
    assert "coupling: x scans 16.0" in said
    found = hr.load(path)
    assert found.axes == ("x", "y")
    for name, values in run.signals.items():
        np.testing.assert_array_equal(values, found.signals[name], err_msg=name)
    assert np.array_equal(hr.load(path, namespace="y")["displacement"], run["y/displacement"])
    both = hysteresis("report", path)
    assert "run.npz x" in both
    assert "run.npz y" in both
    assert "RMS error" in hysteresis("report", path, "--namespace", "x")


def test_one_axis_gets_the_reference_that_is_asked_for(tmp_path):
    path = tmp_path / "run.npz"
    words = ("--reference", "sine", "--frequency", "20Hz", "--amplitude", "3um", "--namespace", "y")
    said = hysteresis("simulate", "xy_scanner", "-o", path, "--duration", 0.1, *words)
    assert "coupling: y scans 6.0" in said
    assert np.ptp(load_run(path, "y")["reference"]) == pytest.approx(6e-6, rel=1e-3)


def test_the_setpoints_of_a_run_of_a_stage_are_replayed(tmp_path):
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    setpoints = {name: np.where(np.arange(600) > start, 12e-6, 9e-6) for name, start in (("x", 200), ("y", 300))}
    save_run(hr.simulate("xy_scanner", setpoints=setpoints), first)
    hysteresis("simulate", "xy_scanner", "-o", second, "--setpoints", first)
    for name in ("x/setpoint", "y/displacement"):
        np.testing.assert_array_equal(load_run(first)[name], load_run(second)[name])


@pytest.mark.parametrize(
    "words",
    [
        ("urdf", "xy_scanner"),
    ],
)
def test_commands_of_a_single_axis_refuse_a_stage(words, tmp_path):
    said = hysteresis_process(*words, code=2)
    assert "describes a stage of coupled axes" in said
    assert "Traceback" not in said


def test_commands_of_a_single_axis_say_what_to_do_with_the_recording_of_a_stage(tmp_path):
    time, rng = np.arange(400) * 1e-4, np.random.default_rng(1)
    signals = {f"{axis}/voltage": rng.normal(size=400) for axis in "xy"}
    signals |= {f"{axis}/measured": 1e-7 * signals[f"{axis}/voltage"] for axis in "xy"}
    path = tmp_path / "both.csv"
    units = {name: "V" if name.endswith("voltage") else "m" for name in signals}
    save_run(Recording(time, signals, units), path)
    # y moves too: a response of x alone would contain the effect of y
    assert "omit --namespace for the response matrix" in hysteresis("frf", path, "--namespace", "x", code=2)
    assert "--held-out" in hysteresis("validate", "kim2009", path, code=2)
    alone = tmp_path / "alone.csv"
    save_run(Recording(time, signals | {"y/voltage": np.zeros(400)}, units), alone)
    assert "is the recording of a stage" not in hysteresis("frf", alone, "--namespace", "x", "--loop", "open")


def test_validate_refuses_the_plant_of_a_stage(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("time [s],voltage [V],measured [m]\n" + "".join(f"{k}e-4,{k},{k}e-7\n" for k in range(50)))
    for namespace in ("", "/x"):
        said = hysteresis("validate", "xy_scanner", path, *(("--namespace", namespace) if namespace else ()), code=2)
        assert "stage of coupled axes" in said


def test_validate_takes_the_axis_of_a_namespace_from_the_recording_of_a_stage(tmp_path, run):
    path = tmp_path / "run.npz"
    run.save(path)
    assert "describes a stage of coupled axes" in hysteresis("validate", "xy_scanner", path, code=2)
    assert "give --namespace AXIS" in hysteresis("validate", "kim2009", path, code=2)
    assert "it has x, y" in hysteresis("validate", "kim2009", path, "--namespace", "z", code=2)
    data = read_data(path, Columns(namespace="x", all_samples=True)).data
    assert np.array_equal(data.input, run["x/voltage"]) and np.array_equal(data.output, run["x/measured"])


def test_verify_repeats_the_recording_of_a_stage(tmp_path, run):
    path, wrong = tmp_path / "run.npz", tmp_path / "wrong.npz"
    run.save(path)
    assert "2000 samples equal the offline twin bit for bit" in hysteresis("verify", path)
    found = load_run(path)
    found.signals["y/command"][700] += 1e-12
    save_run(found, wrong)
    assert "y/command: 1 samples" in hysteresis("verify", wrong, code=1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--rate", "realtime"), "10000 samples/s are too many for the messages between the nodes of a stage"),
        (("--composed",), "10000 samples/s are too many for the messages between the nodes of a stage"),
        (("--namespace", "x"), "run together: --namespace only selects the axis of --fault"),
        (("--reference", "hold", "--namespace", "z", "--duration", "0.1"), "there is no axis 'z' in the stage"),
        (("--fault", "stale:0.1:0.1"), "a fault of a stage needs the name of its axis, one of x, y"),
        (("--plant", "external", "--factor", "0.01"), "external_plant"),
        (("width=20um",), "belongs to a scan: choose a scan, for instance --scan raster; --params-file FILE"),
        (
            ("--scan", "raster", "width=90um", "depth=10um"),
            ", and the other end too, allowed: ≥ -20 µm and ≤ 20 µm",
        ),
        (("--reference", "raster"), "give --scan raster NAME=VALUE"),
        (
            ("--trigger", "positions=200um"),
            "reaches 0.0002 m; allowed: 0 … 4e-05 m (minimum … maximum): trigger within",
        ),
    ],
)
def test_up_refuses_what_a_stage_cannot_do(words, message):
    said = hysteresis("up", "xy_scanner", *words, code=2)
    assert message in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--drift", "0.1", "0"), "--drift is for a single axis"),
        (("--learned", "a.npz"), "--learned is for a single axis"),
        (("--fault", "stale:0.1:0.1"), "a fault of a stage needs the name of its axis, one of x, y"),
        (("--namespace", "x"), "run together: --namespace only selects the axis of --fault"),
        (("--fault", "stale:0.1:0.1", "--namespace", "z"), "there is no axis 'z' in the stage: it has x, y"),
        (("--trigger", "times=0.01s", "--namespace", "z"), "there is no axis 'z' in the stage: it has x, y"),
        (("--fault", "nonsense:0.1:0.1", "--namespace", "x"), "nonsense"),
    ],
)
def test_what_a_stage_cannot_do_is_refused(words, message, tmp_path):
    said = hysteresis("simulate", "xy_scanner", "-o", tmp_path / "never.npz", "--duration", 0.1, *words, code=2)
    assert message in said
    assert not list(tmp_path.iterdir())


def test_a_wrong_stage_is_refused_by_the_command(tmp_path):
    path = tmp_path / "wrong.yaml"
    text = load_configuration("xy_scanner").text
    path.write_text(text.replace('axes: [x, "y"]', "axes: [x, x]"), encoding="utf-8")
    said = hysteresis("simulate", path, "-o", tmp_path / "never.npz", code=2)
    assert "'x' is given twice" in said


def test_a_run_of_a_stage_has_a_run_of_each_axis(run):
    assert isinstance(run, hr.StageRun)
    assert run.axes == ("x", "y")
    assert run["x"].axes == ()
    assert np.array_equal(run["x"]["displacement"], run["x/displacement"])
    assert np.array_equal(run.y.measured, run["y/measured"])
    assert run["x"].units["voltage"] == "V"
    assert run.between(0.1, 0.15)["y"].time.size == 501
    figures = hr.metrics(run)
    assert set(figures) == {"x", "y", "plane"}
    assert hr.metrics(run, namespace="x")["rms_error_m"] < 0.3e-6
    with pytest.raises(AttributeError, match="no signal or attribute 'z'"):
        _ = run.z
    with pytest.raises(RecordingError, match=r"choose one of its axes \(x, y\)"):
        _ = run["displacement"]


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_files_give_the_run_back_bit_for_bit(tmp_path, suffix):
    run = hr.simulate("xy_scanner", duration=0.01)
    path = tmp_path / f"run{suffix}"
    run.save(path)
    found = hr.load(path)
    assert isinstance(found, hr.StageRun)
    for name, values in run.signals.items():
        np.testing.assert_array_equal(found[name], values)
        assert found.units[name] == run.units[name]
    if suffix == ".npz":  # a recording that contains its configuration can be run again
        again = hr.simulate(found, duration=0.01)
        np.testing.assert_array_equal(again["x"].displacement, run["x"].displacement)


def test_a_bag_gives_the_run_of_a_stage_back(tmp_path, run):
    run.save(tmp_path / "run.mcap")
    found = hr.load(tmp_path / "run.mcap")
    assert found.axes == ("x", "y")
    for name in found.axes:
        for signal in ("setpoint", "reference", "command", "voltage", "displacement", "measured"):
            np.testing.assert_array_equal(found[name][signal], run[name][signal], err_msg=signal)
    assert np.array_equal(hr.load(tmp_path / "run.mcap", namespace="y")["measured"], run["y/measured"])


def test_setpoints_of_a_stage_go_by_the_names_of_its_axes():
    held = hr.simulate("xy_scanner", setpoints={"y": [15e-6]}, duration=0.02)
    assert held["y"].setpoint[-1] == 15e-6
    assert held["x"].setpoint[-1] == 20e-6
    with pytest.raises(hr.HysteresisError, match="need the names of its axes"):
        hr.simulate("xy_scanner", setpoints=[1e-6])
    with pytest.raises(hr.HysteresisError, match="there is no axis 'z' in the stage"):
        hr.simulate("xy_scanner", setpoints={"z": [1e-6]})
    with pytest.raises(hr.HysteresisError, match="setpoints by names are for a stage"):
        hr.simulate("kim2009", setpoints={"x": [1e-6]})
    with pytest.raises(hr.HysteresisError, match="requests and speeds are for an inchworm"):
        hr.simulate("xy_scanner", requests=[1.0])


def test_a_recording_of_one_axis_has_no_axes():
    one = Recording(np.arange(3.0), {"voltage": np.zeros(3)})
    assert one.axes == ()
    with pytest.raises(RecordingError, match="it is the recording of a single axis"):
        one.axis("x")


SCAN = ("--scan", "raster", "width=20um", "depth=20um", "lines=4", "flyback=2", "line_rate=50Hz", "slow=ramped")


def test_a_stage_follows_a_scan_and_its_report_judges_it_in_the_plane(tmp_path):
    path, page = tmp_path / "run.npz", tmp_path / "run.html"
    said = hysteresis("simulate", "xy_scanner", *SCAN, "-o", path)
    assert "2400 samples at 10000 Hz (0.24 s), axes x, y" in said
    assert "scan from 0.12 s on, including the time between samples:" in said
    assert "Coupling: RMS across a line, about its mean" in said and "Trace - retrace along the lines" in said
    answer = subprocess.run(
        [sys.executable, "-m", "hysteresis_ros.cli.main", "report", path, "--json", "-"], capture_output=True, text=True
    )
    figures = json.loads(answer.stdout)
    assert figures["scan"]["samples"] == 5 * 4 * 2 * 80 and figures["scan"]["size_m"] == 20e-6
    printed = re.search(r"RMS error in the plane +(\S+)  µm", said)[1]
    assert float(printed) == pytest.approx(1e6 * figures["scan"]["rms_error_m"], rel=1e-3)
    assert set(figures["runs"]) == {"run.npz x", "run.npz y"}
    axes = hr.metrics(path)
    for name in ("x", "y"):
        # the axes begin far from the path; their errors count where those in the plane do
        found = figures["runs"][f"run.npz {name}"]
        assert found["max_error_m"] == axes[name]["max_error_m"] < 1.01 * figures["scan"]["max_error_m"]
        assert any("evaluated from 0.12 s on" in note for note in found["notes"]["recording"])
        rms = re.search(rf"{name}: RMS error (\S+ .?m), maximum .*, from 0.12 s on", said)[1]
        assert rms == readable(found["rms_error_m"], "m"), "simulate and report agree"
    said = hysteresis("report", path, "-o", page, "--range", "0.12s:0.18s")
    assert "scan, 0.12 … 0.18 s:" in said and "report: " in said
    html = page.read_text(encoding="utf-8")
    for words in ("Map of the error in the plane", "RMS error line by line", "trace against retrace", "% of size"):
        assert words in html
    assert "RMS error" in hysteresis("report", path, "--namespace", "x")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--scan", "raster", "width=50um", "depth=10um"), "exceeds the range by 8.906 µm"),
        (("--scan", "raster", "width=20um", "depth=9um", "line_rate=400Hz"), "times its limit 0.0154 m/s; "),
        (("--scan", "raster", "width=20um", "depth=9um", "line_rate=400Hz"), "a frame in"),
        (("--scan", "rastr", "width=20um"), "did you mean raster"),
        (("width=20um",), "belongs to a scan: choose a scan, for instance --scan raster; --params-file FILE"),
        (("other.yaml",), "other.yaml is neither an option nor NAME=VALUE of a scan; --params-file FILE overrides"),
        ((*SCAN, "--reference", "sine", "--amplitude", "1um"), "--scan and --reference exclude each other"),
    ],
)
def test_a_scan_that_a_stage_cannot_follow_is_refused(words, message, tmp_path):
    assert message in hysteresis("simulate", "xy_scanner", "-o", tmp_path / "never.npz", *words, code=2)
    assert "couples them" in hysteresis("simulate", "kim2009", "-o", tmp_path / "never.npz", *SCAN, code=2)
    assert not list(tmp_path.iterdir())


def test_a_design_of_a_stage_prints_how_its_axes_interact():
    said = hysteresis("design", "xy_scanner")
    assert "relative gains of x         1.002, -0.001603" in said
    assert "disk margin of all jointly  7.4 dB, 44 deg" in said and "coupling at 100 Hz" in said
    assert "missing option '-o'" in hysteresis("design", "kim2009", "--controller", "pid", code=2)
    assert "missing option '-o'" in hysteresis("design", "xy_scanner", "--controller", "pid", code=2)
    assert "nothing to design" in hysteresis("design", "xy_scanner", "-o", "never.yaml", code=2)
    assert "follows no scan" in hysteresis("design", "xy_scanner", "--learning", "inversion", "-o", "a.yaml", code=2)


def test_a_design_of_unstable_loops_states_the_remedy_and_ends_with_code_2(tmp_path):
    path, designed = tmp_path / "unstable.yaml", tmp_path / "designed.yaml"
    text = load_configuration("xy_scanner").text
    right = re.search(r"decoupling: \[(.*)\]", text)[0]
    path.write_text(text.replace(right, "decoupling: [-1.0, 0.0, 0.0, -1.0]"), encoding="utf-8")
    quick = ("--controller", "pid", "--damping", "none", "--bandwidth", "50Hz")
    for words in ((), (*quick, "-o", designed), ("--feedforward", "-o", designed)):
        said = hysteresis("design", path, *words, code=2)
        assert "the loops of x, y together are unstable on the model of the stage" in said
        assert not designed.exists()
    said = hysteresis("design", path, code=2)
    assert "disk margin of all jointly  none: the loop is unstable" in said, "the table is printed too"
    assert "coupling at 10 Hz           none: the loop is unstable" in said
    path.write_text(text.replace(right, re.search(r"decoupling: \[.*\]", said)[0]), encoding="utf-8")
    assert "disk margin of all jointly  7.4 dB, 44 deg" in hysteresis("design", path)
    # nothing that scans moves here; the stage is simulated in spite of that
    path.write_text(text.replace(right, "decoupling: [-1.0, 0.0, 0.0, -1.0]"), encoding="utf-8")
    assert "x scans 0 µm" in hysteresis("simulate", path, "-o", tmp_path / "run.npz")


def test_a_stage_in_open_loop_has_infinite_margins_and_no_coupling(tmp_path):
    path = tmp_path / "new.yaml"
    hysteresis("new", path, "--axes", "x,y", "--stroke", "50um", "--voltage", "0:100V", "--rate", "5kHz")
    said = hysteresis("design", path)
    assert "disk margin of all jointly  infinite" in said and "coupling at 5 Hz            none\n" in said


PATH = ("width=16um", "depth=8um", "lines=5", "frame_rate=40Hz")


def test_a_scan_of_the_command_line_is_learned_as_one_of_the_file(tmp_path):
    source, learns, asked = tmp_path / "scan.yaml", tmp_path / "learns.yaml", tmp_path / "asked.yaml"
    text = load_configuration("xy_scanner").text
    scan = f"    scan:\n      kind: lissajous\n      values: [{', '.join(PATH)}]\n"
    source.write_text(text.replace("    decoupling: [1.0016", f"{scan}    decoupling: [1.0016"), encoding="utf-8")
    hysteresis("design", source, "--learning", "inversion", "-o", learns)
    hysteresis("design", "xy_scanner", "--learning", "inversion", "--scan", "lissajous", *PATH, "-o", asked)
    own, other = (StageParameters.from_configuration(load_configuration(path)) for path in (learns, asked))
    assert other.stage.scan == own.stage.scan and other.stage.scan.values == PATH
    for name in "xy":
        found, wanted = (
            np.array(
                yaml.safe_load((tmp_path / f"{stem}_{name}.yaml").read_text(encoding="utf-8"))["learned_correction"][
                    "correction"
                ]
            )
            for stem in ("asked", "learns")
        )
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-15)
    # runs from which the axes learn together need three periods, and the file has two
    together = tmp_path / "together.yaml"
    hysteresis("design", "xy_scanner", "--learning", "coupled", "--scan", "lissajous", *PATH, "-o", together)
    assert StageParameters.from_configuration(load_configuration(together)).stage.scan.periods == 3


@pytest.mark.parametrize(
    ("config", "words", "message"),
    [
        (
            "xy_scanner",
            ("--scan", "raster", *PATH),
            "--scan raster belongs to --controller or --learning; give one of them",
        ),
        ("xy_scanner", ("--learning", "inversion", *PATH), "width=16um belongs to a scan: choose a scan"),
        ("xy_scanner", ("--learning", "inversion", "--scan", "rastr", *PATH), "did you mean raster"),
        ("xy_scanner", ("--learning", "inversion", "--scan", "raster", "width=90um", "depth=9um"), "exceeds the range"),
        ("kim2009", ("--learning", "inversion", "--scan", "raster", *PATH), "learns the period of its waveform"),
    ],
)
def test_a_scan_that_cannot_be_learned_is_refused(config, words, message, tmp_path):
    assert message in hysteresis("design", config, *words, "-o", tmp_path / "never.yaml", code=2)
    assert not list(tmp_path.iterdir())


def test_learning_of_a_stage_begins_with_the_inverse_and_takes_the_error_of_a_scan_away(tmp_path):
    source, learns = tmp_path / "scan.yaml", tmp_path / "learns.yaml"
    text = load_configuration("xy_scanner").text
    scan = (
        "    scan:\n      kind: lissajous\n      values: [width=16um, depth=16um, lines=5, frame_rate=10Hz]\n"
        "      periods: 10\n"
    )
    source.write_text(text.replace("    decoupling: [1.0016", f"{scan}    decoupling: [1.0016"), encoding="utf-8")
    said = hysteresis("design", source, "--learning", "inversion", "-o", learns)
    assert "axis x" in said and "axis y" in said and "learns_x.yaml" in said
    errors = {}
    for name, path in (("before", source), ("after", learns)):
        run = hr.simulate(path)
        errors[name] = [scan_figures(hr.scan_run(run, *part))["rms_error_percent"] for part in ((0.2, 0.4), (1.8, 2.0))]
    assert errors["before"][0] > 1.0
    # the model's inverse removes most of the error at once; learning removes the part from hysteresis and creep
    assert errors["after"][0] < 0.2 * errors["before"][0]
    assert errors["after"][1] < 0.85 * errors["after"][0]


def test_all_axes_learn_together_from_recorded_runs(tmp_path):
    source = tmp_path / "scan.yaml"
    text = load_configuration("xy_scanner").text
    scan = (
        "    scan:\n      kind: lissajous\n      values: [width=16um, depth=16um, lines=5, frame_rate=10Hz]\n"
        "      periods: 3\n"
    )
    source.write_text(text.replace("    decoupling: [1.0016", f"{scan}    decoupling: [1.0016"), encoding="utf-8")
    files = [tmp_path / f"learns{number}.yaml" for number in range(3)]
    runs = [tmp_path / f"run{number}.npz" for number in range(3)]
    said = hysteresis("design", source, "--learning", "coupled", "-o", files[0])
    assert "written, learning coupled, from 0 runs" in said and "learns0_x.yaml" in said
    given: list = []
    for number in range(3):
        hysteresis("simulate", files[number], "-o", runs[number])
        given += ["--run", runs[number]]
        if number < 2:
            said = hysteresis("design", files[number], "--learning", "coupled", *given, "-o", files[number + 1])
            assert f"run {number + 1}, y: periodic error" in said and f"from {number + 1} runs" in said
            written = files[number + 1].read_text(encoding="utf-8")
            assert written.count("# Learning designed by") == 1 and written.count("from_rest: true") == 2
    left = [scan_figures(hr.scan_run(load_run(run), 0.2, 0.6))["rms_error_percent"] for run in runs]
    # the plant equals its model, except for noise and the residual hysteresis and creep
    assert left[2] < 0.5 * left[0]
    words = ("design", files[0], "--learning", "coupled", "--run", runs[0])
    assert "would replace the corrections of the run" in hysteresis(*words, "-o", files[0], code=2)
    hysteresis("export", runs[0], "-o", tmp_path / "run0.csv")
    words = ("design", files[0], "--learning", "coupled", "--run", tmp_path / "run0.csv", "-o", files[1])
    assert "no configuration, so it is unknown which corrections it used" in hysteresis(*words, code=2)
    words = ("design", files[0], "--learning", "inversion", "--run", runs[0], "-o", files[0])
    assert "--run belongs to --learning coupled" in hysteresis(*words, code=2)
    words = ("design", "kim2009", "--learning", "coupled", "--period", "0.2s", "-o", files[0])
    assert "are for a stage" in hysteresis(*words, code=2)


def test_the_feedforward_of_a_stage_is_designed_for_its_controllers(tmp_path):
    path = tmp_path / "fed.yaml"
    said = hysteresis("design", "xy_scanner", "--feedforward", "--bandwidth", "800Hz", "-o", path)
    assert "preview                  13 samples, 1.3 ms" in said and "decoupled up to          800 Hz" in said
    plain = hysteresis("design", "xy_scanner", "--controller", "pid", "--damping", "none", "-o", tmp_path / "pid.yaml")
    row = r"largest voltage step +\S+ V in a sample for a setpoint 20 µm away in [xy], \S+ % of .*, overshoot \S+ %"
    assert len(re.findall(row, said)) == len(re.findall(row, plain)) == 2
    # it is that of a setpoint within the range of the voltage: at 0 µm there would be none
    assert all(0.05 < float(one) < 1.0 for one in re.findall(r"overshoot (\S+) %", plain)), plain
    assert "V in a sample for the configured waveforms" in said
    left, before = map(float, re.search(r"coupling, model +(\S+) %; (\S+) % with the inverses alone", said).groups())
    assert left < 0.1 < 5.0 < before
    fed = StageParameters.from_configuration(load_configuration(str(path)))
    assert all(axis.generator.approach.from_rest for axis in fed.axes)
    assert fed.stage.feedforward.matrix(2).shape == (2, 2, 26)
    refused = hysteresis("design", path, "--controller", "pid", "-o", path, code=2)
    assert "its feedforward was designed for its present controllers: give --feedforward too" in refused
    refused = hysteresis("design", path, "--feedforward", "--noise", "5nm", "-o", path, code=2)
    assert "--noise does not belong to --feedforward alone" in refused
    assert "missing option '-o'" in hysteresis("design", path, "--feedforward", code=2)


def test_controllers_of_all_axes_are_designed_and_written(tmp_path):
    path = tmp_path / "designed.yaml"
    said = hysteresis("design", "xy_scanner", "--controller", "pid", "--noise", "5nm", "-o", path)
    assert said.index("axis x") < said.index("axis y") < said.index("\nstage\n") < said.index("written, type pid")
    text = path.read_text(encoding="utf-8")
    assert text.count("# Controller designed by") == 1
    run = hr.simulate(path, duration=0.05)
    assert np.max(np.abs(run["y/reference"] - run["y/displacement"])[400:]) < 50e-9
    # the first motion is an approach; a jump to the middle of the ranges would be 7 V per sample, the slew rate
    for name in "xy":
        assert np.max(np.abs(np.diff(run[f"{name}/plant_voltage"]))) < 3.0


@pytest.mark.parametrize("each", ["frame", "line", "pixel"])
def test_the_axes_that_scan_trigger_by_the_scan_and_the_clock_is_as_fine(each):
    values = ("width=0.5um", "depth=0.5um", "lines=4", "pixels=8", "line_rate=1Hz")
    scanned = with_scan(load_configuration("steering_mirror"), "raster", values)
    found = StageParameters.from_configuration(triggering(scanned, (f"each={each}",)))
    assert len(found.names) == 3 and found.scanning_axes == found.names[:2]
    assert [axis.generator.triggers.each for axis in found.axes] == [each, each, "none"]
    assert found.stage.scan.clock == {"frame": "line", "line": "line", "pixel": "pixel"}[each]
    one = StageParameters.from_configuration(triggering(scanned, (f"each={each}",), found.names[1]))
    assert [axis.generator.triggers.each for axis in one.axes] == ["none", each, "none"]
    with pytest.raises(ParameterError, match="needs a scan"):
        StageParameters.from_configuration(triggering(load_configuration("xy_scanner"), (f"each={each}",)))


def test_a_clock_of_a_stage_that_is_too_coarse_for_its_triggers_is_refused_once_by_its_own_name():
    values = ("width=1um", "depth=1um", "lines=4", "pixels=8", "line_rate=1Hz")
    scanned = with_scan(load_configuration("xy_scanner"), "raster", values)
    with pytest.raises(ParameterError) as refused:
        StageParameters.from_configuration(scanned.override("reference_generator", triggers__each="pixel"))
    assert str(refused.value) == "/stage: scan.clock = 'line': must be pixel or finer for triggers.each: pixel"
