# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tuning uses the model only and improves its criterion; a designed file runs and keeps its bandwidth."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import hysteresis_ros as hr
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.laws.pid import PidParameters
from hysteresis_ros.control.linearisation import margins
from hysteresis_ros.designs import controller
from hysteresis_ros.designs.controller import DesignRequest, design_axis
from hysteresis_ros.designs.gains import believed_axis, criterion_of, tune
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.laboratory.comparison.candidates import Given
from hysteresis_ros.laboratory.comparison.tasks import Conditions
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.reach import reachable_displacements, single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models import linear_algebra
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.linear import LinearParameters

ROOT = pathlib.Path(__file__).resolve().parents[2]
PICMA = ROOT / "config" / "picma_stage.yaml"


def picma(**changes):
    """Return the measured stage with changed parameters of the plant."""
    return single_axis(load_configuration(PICMA).override("plant_simulator", **changes))


def test_criteria_by_hand():
    error = np.array([1.0, -2.0, 3.0])
    assert criterion_of("iae", error, 0.1) == pytest.approx(0.6)
    assert criterion_of("ise", error, 0.1) == pytest.approx(1.4)
    assert criterion_of("itae", error, 0.1) == pytest.approx((0.1 * 2.0 + 0.2 * 3.0) * 0.1)


def test_tuning_lowers_the_criterion_within_the_sensitivity():
    axis = picma()
    result = tune(axis, "pid", "iae", duration=1.0, iterations=15, start=PidParameters(Kp=0.3, Ki=20.0))
    assert result.after < 0.8 * result.before
    assert result.history[0, :3] == pytest.approx([0.3, 20.0, 0.0])
    assert result.history[0, 3] == result.before and result.history[-1, 3] == result.after
    assert np.all(np.diff(result.history[:, 3]) <= 0.0)
    assert not result.converged, "15 iterations are not enough, which is reported"
    control = part(axis.motion_controller, ControllerParameters)
    assert margins(replace(control, type="pid", pid=result.gains), 0.005).sensitivity_peak < 2.001


def test_tuning_never_looks_at_the_plant():
    options = {"duration": 0.5, "iterations": 4, "start": PidParameters(Kp=0.3, Ki=20.0)}
    one = tune(picma(), "pid", "ise", **options)
    other = picma(sensor__noise=1e-7, creep__type="none", dynamics__A=[0.9], limits__maximum=3.0)
    same = tune(other, "pid", "ise", **options)
    assert same.gains == one.gains and same.after == one.after


def test_a_preload_moves_the_zero_of_the_sensor_and_is_no_error_of_the_tuned_loop():
    axis, options = picma(), {"duration": 0.5, "iterations": 2, "start": PidParameters(Kp=0.3, Ki=20.0)}
    node, preload = axis.motion_controller, PreloadParameters(force=3.0, A1=-0.5e-6, B1=-0.5e-6)
    loaded = replace(axis, motion_controller=replace(node, model=replace(node.model, preload=preload)))
    assert preload.offset == pytest.approx(-2e-6)
    assert tune(loaded, "pid", "iae", **options).before == pytest.approx(tune(axis, "pid", "iae", **options).before)


def test_believed_axis_has_the_compensators_model_as_plant():
    axis = believed_axis(picma(dynamics__A=[0.9], limits__maximum=3.0))
    plant, compensator = axis.plant_simulator, axis.hysteresis_compensator
    assert (plant.limits, plant.hysteresis, plant.creep) == (
        compensator.limits,
        compensator.hysteresis,
        compensator.creep,
    )
    assert plant.dynamics == axis.motion_controller.model.dynamics and plant.sensor.noise == 0.0
    Axis(axis)


def test_tuning_refuses_a_run_without_end_and_gains_without_margins():
    with pytest.raises(ConfigurationError, match="--duration"):
        tune(picma(), "pid", "iae")
    with pytest.raises(ConfigurationError, match="sensitivity"):
        tune(picma(), "pid", "iae", duration=0.5, start=PidParameters(Kp=0.5, Ki=300.0))
    with pytest.raises(ConfigurationError, match="criterion"):
        tune(picma(), "pid", "best", duration=0.5)


def run(*words):
    return CliRunner().invoke(main, ["design", *map(str, words)])


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["pid", "smc", "integral_smc", "super_twisting", "offset_free"])
def test_designed_file_runs_and_keeps_the_rest_of_the_file(tmp_path, controller):
    bandwidth = [] if controller == "super_twisting" else ["--bandwidth", 10.0]
    result = run(PICMA, "--controller", controller, *bandwidth, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 0, result.output
    assert "gain margin" in result.output and "closed-loop poles" in result.output
    text = (tmp_path / "f.yaml").read_text(encoding="utf-8")
    assert text.startswith("# Controller designed by `hysteresis design picma_stage.yaml --controller " + controller)
    # everything else stays as written, except for the slew rate, which a written file limits, and steps of a waveform
    added = (" slew_rate: ", " steps: true  # steps of a waveform keep the limits too")
    given, written = (
        "".join(line for line in lines.splitlines(keepends=True) if not any(words in line for words in added))
        for lines in (PICMA.read_text(encoding="utf-8"), text)
    )
    first = given.index("/**/motion_controller:")
    assert given[:first] in written and given[given.index("/**/reference_generator:") :] in written
    assert single_axis(load_configuration(tmp_path / "f.yaml")).plant_simulator.limits.slew_rate > 0.0
    assert text.count(added[1]) == 1
    recording = simulate(single_axis(load_configuration(tmp_path / "f.yaml")), duration=0.5)
    assert np.all(np.isfinite(recording.signals["displacement"]))
    if bandwidth:
        assert "bandwidth reached       10 Hz" in result.output


@pytest.mark.slow
def test_a_design_of_a_design_replaces_its_header_and_section(tmp_path):
    assert run(PICMA, "--controller", "pid", "-o", tmp_path / "f.yaml").exit_code == 0
    assert run(tmp_path / "f.yaml", "--controller", "offset_free", "-o", tmp_path / "f.yaml").exit_code == 0
    text = (tmp_path / "f.yaml").read_text(encoding="utf-8")
    assert text.count("# Controller designed by") == 1 and "--controller offset_free" in text.splitlines()[0]
    values = load_configuration(tmp_path / "f.yaml").node("motion_controller")
    assert values["type"] == "sliding_mode" and values["pid.Ki"] > 0.0, "the gains of the PID stay for live switching"


@pytest.mark.slow
def test_the_axis_really_has_the_bandwidth(tmp_path):
    """A sine at the bandwidth is attenuated by 3 dB if model and plant are equal."""
    assert run(PICMA, "--controller", "pid", "--bandwidth", 10.0, "-o", tmp_path / "f.yaml").exit_code == 0
    values = {"type": "sine", "amplitude": 2e-6, "frequency": 10.0, "offset": 10e-6}
    configuration = load_configuration(tmp_path / "f.yaml").override(
        "reference_generator", **{f"waveform__{name}": value for name, value in values.items()}
    )
    axis = believed_axis(single_axis(configuration))
    y = simulate(axis, duration=3.0).signals["displacement"][-400:]
    angle = 2.0 * np.pi * 10.0 * np.arange(400) / 200.0
    amplitude = np.hypot(*(2.0 * np.mean(y * f(angle)) for f in (np.sin, np.cos)))
    assert amplitude == pytest.approx(2e-6 / np.sqrt(2.0), rel=0.01)


REFUSED = [
    (["--controller", "pid", "--bandwidth", "-9"], "must be above 0"),
    (["--controller", "smc", "--bandwidth", "150"], "below half the sample rate"),
    (["--controller", "smc", "--criterion", "iae"], "--criterion"),
    (["--controller", "pid", "--criterion", "iae", "--bandwidth", "5"], "exclude each other"),
    (["--controller", "pid", "--q", "5"], "--q"),
    (["--controller", "smc", "--q", "-5"], "--q"),
    (["--controller", "pid", "--preview", "5"], "--feedforward"),
    (["--controller", "super_twisting", "--bandwidth", "10"], "no pole to place"),
    (["--controller", "pid", "--criterion", "iae", "--duration", "nan"], "must be a finite number"),
    (["--controller", "pid", "--criterion", "iae", "--duration", "0"], "positive number of seconds"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("words", "text"), REFUSED)
def test_requests_that_cannot_be_met_end_in_one_line(tmp_path, words, text):
    result = run(PICMA, *words, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 2
    assert text in result.output and len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "f.yaml").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["kim2009", "--controller", "smc", "--bandwidth", "1"],
            "smallest bandwidth of this controller on its model is 9.651 Hz",
        ),
        (["inchworm_travel", "--controller", "pid", "--criterion", "iae"], "sequencer"),
    ],
)
def test_other_axes_name_what_cannot_be_met(tmp_path, words, text):
    result = run(*words, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 2 and text in result.output, result.output


def test_the_axis_of_a_sequencer_is_designed_too(tmp_path):
    result = run("inchworm_travel", "--controller", "pid", "-o", tmp_path / "f.yaml")
    assert result.exit_code == 0, result.output
    simulate(single_axis(load_configuration(tmp_path / "f.yaml")), duration=0.01)


@pytest.mark.slow
def test_doubts_of_a_design_are_printed(tmp_path):
    result = run("kim2009", "--controller", "pid", "--feedforward", "--preview", "2", "-o", tmp_path / "f.yaml")
    assert "note: feedforward.preview = 2: zeros of model.dynamics outside the unit circle" in result.output
    text = (ROOT / "config" / "kim2009.yaml").read_text(encoding="utf-8")
    bare = text[: text.index("/**/motion_controller:")] + text[text.index("/**/reference_generator:") :]
    (tmp_path / "bare.yaml").write_text(bare, encoding="utf-8")
    result = run(tmp_path / "bare.yaml", "--controller", "pid", "-o", tmp_path / "f.yaml")
    assert "note: model.dynamics.A is empty" in result.output


MODEL = "        A: [0.686131723]\n        B: [0.313868277]\n        C: [1.0]\n"


def second_order(B, C):
    return f"        A: [0.7, 0.0, 0.0, 0.4]\n        {B}\n        {C}\n"


@pytest.mark.parametrize(
    ("line", "replacement", "text"),
    [
        ("        A: [0.686131723]", "        A: [1.2]", "unstable"),
        (MODEL, second_order("B: [0.2, 0.3]", "C: [1.0, 0.0]"), "not observable"),
        (MODEL, second_order("B: [0.2, 0.0]", "C: [1.0, 1.0]"), "not controllable"),
        ("        B: [0.313868277]", "        B: [0.1, 0.2]", "as many as A has rows"),
        ("    sample_rate: 200.0", "    sample_rate: 250.0", "sample_time"),
    ],
)
def test_models_that_cannot_be_designed_for_end_in_one_line(tmp_path, line, replacement, text):
    original = PICMA.read_text(encoding="utf-8").replace("type: sliding_mode ", "type: open_loop ")
    at = 0 if "sample_rate" in line else original.index("/**/motion_controller:")
    changed = original[:at] + original[at:].replace(line, replacement, 1)
    assert changed != original
    (tmp_path / "c.yaml").write_text(changed, encoding="utf-8")
    result = run(tmp_path / "c.yaml", "--controller", "offset_free", "-o", tmp_path / "f.yaml")
    assert result.exit_code == 2
    assert text in result.output and len(result.output.strip().splitlines()) == 1, result.output


def test_design_and_comparison_refuse_the_same_inverse_of_the_dynamics():
    """Zeros next to the circle at a low frequency: no truncated inverse, and the same refusal in both."""
    zero, poles = 1.004 * np.exp(0.4j), [0.95 * np.exp(0.3j), 0.6]
    (b0, b1), (a0, a1, a2) = (
        linear_algebra.polynomial([zero, zero.conjugate()])[1:],
        linear_algebra.polynomial([poles[0], poles[0].conjugate(), poles[1]])[1:],
    )
    gain = (1.0 + a0 + a1 + a2) / (1.0 + b0 + b1)
    matrices = {"A": (0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -a2, -a1, -a0), "B": (0.0, 0.0, 1.0)}
    matrices["C"] = (gain * b1, gain * b0, gain)
    changes = {f"model.dynamics.{name}": list(values) for name, values in matrices.items()}
    configuration = load_configuration(PICMA).override("motion_controller", type="open_loop", **changes)
    axis = single_axis(configuration)
    with pytest.raises(HysteresisError, match="more than 64") as refused:
        design_axis(axis, DesignRequest("pid", bandwidth=5.0, feedforward=True))
    conditions = Conditions()
    with pytest.raises(HysteresisError) as other:
        Given(configuration, axis, conditions, (), {}, {}).preview()
    assert str(other.value) in str(refused.value)


@pytest.mark.slow
def test_feedforward_and_tuning_from_the_command_line(tmp_path):
    words = ["--controller", "pid", "--criterion", "itae", "--duration", "0.4", "--feedforward"]
    result = run(PICMA, *words, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 0, result.output
    assert "ITAE before, after" in result.output
    configuration = parse_configuration((tmp_path / "f.yaml").read_text(encoding="utf-8"), "f")
    values = configuration.node("motion_controller")
    assert values["feedforward.type"] == "inverse_dynamics" and values["feedforward.preview"] >= 1


@pytest.mark.slow
def test_a_robust_design_says_for_which_plants_it_is(tmp_path):
    ranges = ["--draws", 2, "--seed", 7, "--gain-range", 0.1]
    result = run(PICMA, "--controller", "pid", "--robust", *ranges, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 0, result.output
    lines = {line[:24].strip(): line[24:].strip() for line in result.output.splitlines()}
    assert lines["plants"].startswith("11: gain ±10 %, hysteresis ±10 %, times ±10 %, up to 1 samples later, seed 7")
    assert lines["worst plant"].startswith("gain +21 %") and float(lines["M_s there"]) < 2.003
    assert lines["requirements"].startswith("met")
    header = (tmp_path / "f.yaml").read_text(encoding="utf-8").splitlines()[0]
    assert header.endswith(
        "--robust --gain-range 0.1 --hysteresis-range 0.1 --resonance-range 0.1 --delay-range 1 --draws 2 --seed 7`"
    )


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--seed", 3], "--seed belongs to --robust"),
        (["--robust", "--gain-range", 0.9], "--gain-range = 0.9: must be within 0 … 0.5"),
        (["--robust", "--bandwidth", 5.0], "--robust and --bandwidth exclude each other"),
        (["--robust", "--criterion", "iae"], "--robust and --criterion exclude each other"),
        (["--noise", 0.0], "--noise 0: must be > 0 m"),
        (["--noise", "2"], "'2': of which unit? Write 2um or 2mm"),
        (["--noise", "2V"], "'2V': is in V, must be in m"),
    ],
)
def test_plants_and_noise_that_make_no_sense_are_refused_in_one_line(tmp_path, options, text):
    result = run(PICMA, "--controller", "pid", *options, "-o", tmp_path / "f.yaml")
    assert result.exit_code == 2 and text in result.output, result.output
    assert not (tmp_path / "f.yaml").exists()


@pytest.mark.slow
def test_a_noisy_sensor_makes_a_calmer_design(tmp_path):
    """0.2 % of the stroke may be noise of the command; a nanometre of it has no influence."""
    reached = {}
    for noise, written in ((1e-9, "1nm"), (1e-7, "100nm")):
        result = run(PICMA, "--controller", "pid", "--noise", written, "-o", tmp_path / "f.yaml")
        rows = {line[:24].strip(): line[24:].strip() for line in result.output.splitlines()}
        reached[noise] = float(rows["noise in command"].split()[0])
        samples, milliseconds = (float(words.split()[0]) for words in rows["delay margin"].split(", "))
        assert milliseconds == pytest.approx(1e3 * samples / picma().motion_controller.sample_rate, rel=0.01)
    low, high = reachable_displacements(picma())
    stroke = high - low
    assert reached[1e-7] == pytest.approx(2e-3 * stroke / 1e-7, rel=0.06) and reached[1e-9] > 1.5 * reached[1e-7]


@pytest.mark.slow
def test_a_damping_of_the_file_is_compared_with_the_design_that_has_none(monkeypatch):
    asked, with_damping = [], controller.with_damping

    def noted(control, sample_time, around, request):
        asked.append(request.damping)
        if len(asked) > 1:
            raise ConfigurationError("only its request counts here")
        return with_damping(control, sample_time, around, request)

    monkeypatch.setattr(controller, "with_damping", noted)
    result = design_axis(single_axis(load_configuration("stage700")), DesignRequest("pid"))
    assert asked == [None, "none"] and result.damped.undamped is None


@pytest.mark.slow
def test_the_bandwidth_without_damping_is_that_of_the_design_without_damping(tmp_path):
    def rows(*options, config="kim2009"):
        result = run(config, "--controller", "pid", *options, "-o", tmp_path / "f.yaml")
        return {line.split("  ")[0]: line.split("  ", 1)[-1].strip() for line in result.output.splitlines()}

    plain, none, damped = rows(), rows("--damping", "none"), rows("--damping", "irc")
    assert plain["bandwidth reached"] == none["bandwidth reached"]
    assert damped["bandwidth without damping"].startswith(plain["bandwidth reached"] + ";")
    # a damping that the file already has is kept, and the design without it is the same
    kept = rows(config=tmp_path / "f.yaml")
    for name in ("damping", "bandwidth reached", "bandwidth without damping", "requirements"):
        assert kept[name] == damped[name]


def test_dynamics_inside_the_hysteresis_model_are_a_requirement_that_is_not_met():
    """A linear model without states has margins, but they are those of another axis."""
    example = replace(hr.models.BoucWenMechanical.example().parameters, substeps=10)
    oscillator = HysteresisParameters(type="bouc_wen_mechanical", bouc_wen_mechanical=example)
    axis = picma()
    inverse = replace(axis.hysteresis_compensator.inverse, type="none")
    compensator = replace(axis.hysteresis_compensator, hysteresis=oscillator, inverse=inverse)
    law = replace(axis.motion_controller, model=replace(axis.motion_controller.model, dynamics=LinearParameters()))
    result = design_axis(replace(axis, hysteresis_compensator=compensator, motion_controller=law), DesignRequest("pid"))
    assert result.misses() == ("the dynamics of hysteresis.type bouc_wen_mechanical are not in model.dynamics",)
    assert any("the closed loop may be unstable" in text for text in controller.doubts(result))
