# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage of two axes from its file to judged loops: what stops on the way, and what each stage may move."""

from __future__ import annotations

import pathlib
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from commissioning_support import Willing

from hysteresis_ros.analysis import commissioning_report
from hysteresis_ros.cli.commissioning import coupled_fitting as fitting
from hysteresis_ros.cli.commissioning import coupled_loops as loops
from hysteresis_ros.cli.commissioning.bench import Bench, OfflineBench, require_sound
from hysteresis_ros.cli.commissioning.closed_loop import SCANNED
from hysteresis_ros.cli.commissioning.coupled import DESIGNED, StageSituation, plans_of
from hysteresis_ros.cli.commissioning.coupled_loops import Range, repeated, scan_size, steps
from hysteresis_ros.cli.commissioning.coupled_measuring import identification_excitation, noise_stage, predicted_swings
from hysteresis_ros.cli.commissioning.coupled_stages import COUPLED_STAGES
from hysteresis_ros.cli.commissioning.situation import (
    COMMISSIONED,
    IDENTIFIED,
    SECTION,
    CommissioningError,
    Folder,
    Outcome,
)
from hysteresis_ros.cli.commissioning.stages import commission
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.designs.stage_identification import HeldOut
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import SMALL

#: Entries of the plan that make a commissioning short.
SHORT = """
/commissioning:
  ros__parameters:
    noise_duration: 0.5
    cycle_frequency: 100.0
    scan_frequency: 25.0
"""


def written(folder, further="") -> pathlib.Path:
    """Return the path of xy_scanner with a short plan."""
    path = folder / "scanner.yaml"
    if not path.exists():
        path.write_text(load_configuration("xy_scanner").text + SHORT + further, encoding="utf-8")
    return path


def sitting(folder, resumed=False, further="") -> StageSituation:
    """Return the data of a commissioning of xy_scanner."""
    configuration = load_configuration(written(folder, further))
    parameters = StageParameters.from_configuration(configuration)
    kept = Folder(folder / "kept", configuration.text, "offline", resumed)
    plans = plans_of(configuration, parameters)
    return StageSituation(configuration, parameters, plans, kept, "prandtl_ishlinskii", "pid")


def stage_of(parameters: StageParameters) -> str:
    """Return the name of the stage of the commissioning that built these parameters."""
    return pathlib.Path(parameters.axes[0].generator.waveform.file.path).name.split("_")[0]


class Observed(Bench):
    """Runs the simulated stage, keeps what it ran and recorded, and spoils what it is told to."""

    name = "offline"

    def __init__(self):
        self.runs, self.recorded, self.spoil = {}, {}, {}

    def run(self, axis):
        """Run or fail."""
        stage = stage_of(axis)
        self.runs[stage] = axis
        if stage not in self.recorded:
            self.recorded[stage] = OfflineBench().run(axis)
        found = self.recorded[stage]
        copied = Recording(found.time, {k: v.copy() for k, v in found.signals.items()}, found.units, found.metadata)
        self.spoil.get(stage, lambda signals: None)(copied.signals)
        return copied


def unplugged(signals):
    """The bench fails."""
    raise CommissioningError("unplugged")


def swinging(signals):
    """Something swings once the loops are closed."""
    signals["y/measured"] += 2e-6 * np.sin(0.8 * np.arange(signals["y/measured"].size))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A commissioning that was interrupted twice: while the cycles ran, and by a loop that rang."""
    folder, bench = tmp_path_factory.mktemp("coupled"), Observed()
    bench.spoil["hysteresis"] = unplugged
    with pytest.raises(CommissioningError, match="hysteresis: unplugged"):
        commission(sitting(folder), bench, Willing(), (), COUPLED_STAGES)
    bench.spoil = {"loop": swinging}
    second = Willing()
    with pytest.raises(
        CommissioningError, match=r"loop: axis y: does not settle after a step of x .* Outputs are safe"
    ):
        commission(sitting(folder, True), bench, second, (), COUPLED_STAGES)
    assert not (folder / "kept" / COMMISSIONED).exists(), "the file is written at the end"
    bench.spoil, situation, third = {}, sitting(folder, True), Willing()
    assert commission(situation, bench, third, (), COUPLED_STAGES)
    return situation, bench, second, third


def test_an_interrupted_commissioning_repeats_nothing_that_is_done(done):
    _, _, second, third = done
    assert [name for name, (_, before) in second.heard.items() if before] == ["noise", "gain", "resonance", "multisine"]
    assert list(second.asked) == ["hysteresis", "loop"]
    assert list(third.asked) == ["loop", "scan", "judge"] and list(third.heard) == list(COUPLED_STAGES)


def test_each_stage_finds_what_the_stage_has(done):
    situation, _, _, _ = done
    figures = {name: outcome.figures for name, outcome in situation.found.items()}
    for picture in (picture for outcome in situation.found.values() for picture in outcome.pictures):
        assert "[" in picture.across and "[" in picture.up and "[" not in picture.caption, "axes have units"
    for i, name in enumerate("xy"):
        assert figures["noise"][name]["noise_rms_m"] == pytest.approx(5e-9, rel=0.05)
        assert figures["resonance"][name]["resonance_hz"] == pytest.approx((700.0, 800.0)[i], rel=2e-3)
        assert figures["resonance"][name]["damping"] == pytest.approx(0.01, rel=0.2)
        # the drift of creep, 0.05 µm/V in the lowest lines, is removed
        assert figures["resonance"][name]["gain_m_per_v"] == pytest.approx(3.4e-7, rel=0.07)
        # a sample of delay and half a one for which the voltage is held
        assert figures["resonance"][name]["delay_s"] == pytest.approx(1.6e-4, rel=0.1)
        assert figures["multisine"][name]["swing_m"] < figures["multisine"][name]["predicted_swing_m"] < 13e-6
        assert figures["hysteresis"][name]["stroke_m"] == pytest.approx((44e-6, 43e-6)[i], rel=0.15)
        assert figures["identify"][f"file_{name}_rmse_m"] < 0.05 * 1.5e-6
        assert figures["design"][name]["bandwidth_hz"] > 300.0
        assert figures["loop"][name]["rest_rms_m"] < 8e-9
        assert figures["scan"][name]["ratio"] == pytest.approx(1.0, abs=0.1)
        assert figures["judge"][name]["ratio"] == pytest.approx(1.0, abs=0.1)
    gain = np.array(figures["gain"]["gain_m_per_v"])
    np.testing.assert_allclose(gain / np.diag(gain), [[1.0, 0.04], [0.04, 1.0]], rtol=0.05)
    # columns are the actuators, whose gains differ
    assert gain[1, 0] / gain[0, 1] == pytest.approx(1.055, abs=0.02)
    # predictions are those of the identified plant, not those of the stage itself
    assert all(abs(figures[stage][name]["ratio"] - 1.0) > 1e-6 for stage in ("scan", "judge") for name in "xy")
    # 4 % without decoupling; the triangle of 25 Hz moves the other axis by a few parts in 10 000
    assert figures["scan"]["x"]["coupling_y_rms_m"] < 5e-4 * 32e-6
    assert figures["scan"]["as_predicted"] and figures["judge"]["as_predicted"]


def test_no_stage_moves_more_than_it_announces(done):
    _, bench, second, third = done
    limits = {
        name: [(axis.plant_simulator.limits, axis.hysteresis_compensator.limits) for axis in run.axes]
        for name, run in bench.runs.items()
    }
    for name, most in {"noise": 0.01, "gain": 5.01, "resonance": 52.01, "multisine": 60.01}.items():
        for plant, compensator in limits[name]:
            assert (plant.minimum, plant.maximum) == (compensator.minimum, compensator.maximum)
            assert plant.maximum <= most + 1e-9 and plant.minimum == 0.0
    # a sensor that shows more than the range that belongs to these voltages, and half a stroke, stops all axes
    stroke = 56.94e-6
    low, high = bench.runs["gain"].travel()[0]
    assert low == pytest.approx(-0.5 * stroke, rel=0.05) and high == pytest.approx(
        0.5 * stroke + 5.0 * 0.41e-6, rel=0.1
    )
    assert all(
        axis.plant_simulator.overtravel == pytest.approx(0.5 * stroke, rel=1e-3) for axis in bench.runs["scan"].axes
    )
    for name, recording in bench.recorded.items():
        for axis in "xy":
            voltage = recording[f"{axis}/voltage"]
            slew = np.max(np.abs(np.diff(voltage))) * 1e4
            assert slew <= 70000.0 * 1.001, name
            # a loop corrects the identified zero of its model at once, by less than the small step
            room = 5.0 if name in ("loop", "scan", "judge") else 0.1
            assert abs(voltage[0]) < room and abs(voltage[-1]) < room, name
    assert "100 V" in second.asked["hysteresis"] and "at most x 10" in third.asked["loop"]


def test_the_file_has_the_plants_of_the_stage_and_all_limits(done):
    situation, _, _, _ = done
    path = situation.folder.path / COMMISSIONED
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# Commissioned by `hysteresis commission ") and "scanner.yaml`. SI units." in text
    configuration = load_configuration(path)
    found, given = StageParameters.from_configuration(configuration), situation.parameters
    assert found.stage.structure == given.stage.structure
    np.testing.assert_allclose(found.stage.matrix("decoupling"), [[1.0, -0.04], [-0.04, 1.0]], atol=3e-3)
    sections = dict(configuration.entries)
    assert sections[SECTION]["cycle_frequency"] == 100.0 and "metrics.held_out_x_rmse_m" in sections["/identification"]
    for own, axis in zip(found.axes, given.axes, strict=True):
        assert own.plant_simulator.hysteresis == axis.plant_simulator.hysteresis
        assert own.plant_simulator.overtravel == axis.plant_simulator.overtravel
        assert own.plant_simulator.limits.slew_rate == own.hysteresis_compensator.limits.slew_rate == 70000.0
        assert not own.reference_generator.approach.unlimited
        assert own.reference_generator.approach.maximum_velocity < 0.05
        assert own.motion_controller.type == "pid" and own.motion_controller.damping.type == "irc"
    # to the middle of the ranges, 28 µm, it moves as to a setpoint; a jump would be 7 V per sample, the slew rate
    run = simulate_stage(found.with_duration(0.05))
    for name, axis in zip("xy", found.axes, strict=True):
        place = run[f"{name}/reference"][-1]
        assert place > 20e-6
        assert run[f"{name}/reference"][0] == pytest.approx(0.0, abs=0.1e-6) and axis.generator.minimum > 5e-6
        assert np.max(run[f"{name}/displacement"]) < 1.1 * place
        assert np.max(np.abs(np.diff(run[f"{name}/plant_voltage"]))) < 3.0
    predicting = StageParameters.from_configuration(load_configuration(situation.folder.path / DESIGNED))
    assert predicting.stage.structure != given.stage.structure, "runs are predicted by what was identified"


def replayed(done, folder, stage, spoil, further=""):
    """Commission again from the recordings of the fixture, one of them spoiled."""
    bench = Observed()
    bench.recorded, bench.spoil = done[1].recorded, {stage: spoil}
    attendant = Willing()
    with pytest.raises(CommissioningError) as caught:
        commission(sitting(folder, further=further), bench, attendant, (), COUPLED_STAGES)
    assert caught.value.exit_code == 2
    return str(caught.value), attendant


def swapped(signals):
    """The cables of the sensors are swapped."""
    signals["x/measured"], signals["y/measured"] = signals["y/measured"], signals["x/measured"]


def reversed_sign(signals):
    """The sensor of y counts backwards."""
    signals["y/measured"] *= -1.0


def blind(signals):
    """The sensor of y shows another thing."""
    signals["y/measured"] = 5e-9 * np.random.default_rng(1).standard_normal(signals["y/measured"].size)


def alike(signals):
    """Both sensors look at the same side."""
    both = signals["x/measured"] + 0.9 * signals["y/measured"]
    signals["x/measured"], signals["y/measured"] = both, both.copy()


def crossed(signals):
    """Each sensor shows more of the other axis than of its own."""
    x, y = signals["x/measured"], signals["y/measured"]
    signals["x/measured"], signals["y/measured"] = x + 1.5 * y, 1.5 * x + y


def far(signals):
    """The sensor of y reads millimetres."""
    signals["y/measured"] += 5e-3


def tripping(signals):
    """The plant of y stopped itself and the others."""
    signals["y/tripped"][3000:] = 2.0


def losing(signals):
    """Every tenth sample has no measurement."""
    signals["x/measured"][::10] = np.nan


def deaf(signals):
    """The sensor of y is noisy during the multisines."""
    signals["y/measured"] += 2e-6 * np.random.default_rng(1).standard_normal(signals["y/measured"].size)


def short(signals):
    """The sensor of y ends in the middle."""
    np.minimum(signals["y/measured"], 25e-6, out=signals["y/measured"])


WRONG = [
    ("noise", far, "noise: axis y: the sensor reads 5 mm at rest"),
    ("noise", tripping, "noise: axis y: the axis tripped after 0.3 s: a measurement is outside the range"),
    ("noise", losing, "noise: axis x: 10.0 % of 5000 samples have no measurement"),
    ("gain", swapped, "gain: 5 V at the actuator of x move the sensor of y by 1.8"),
    ("gain", reversed_sign, "gain: axis y: the sign is reversed"),
    ("gain", blind, "gain: axis y: the sensor does not move with the actuator"),
    ("gain", alike, "gain: the gains are singular: the direction"),
    ("gain", crossed, "gain: the relative gain of x is -0.8"),
    ("multisine", deaf, "multisine: axis y: the response to the multisine is below its noise"),
    ("hysteresis", short, "hysteresis: axis y: the sensor stays at its highest reading"),
]


@pytest.mark.parametrize(("stage", "spoil", "words"), WRONG, ids=[f"{a}-{b.__name__}" for a, b, _ in WRONG])
def test_what_looks_wrong_stops_it_and_is_named_with_its_axis(done, tmp_path, stage, spoil, words):
    said, attendant = replayed(done, tmp_path, stage, spoil)
    assert words in said
    assert list(attendant.heard) == list(COUPLED_STAGES)[: list(COUPLED_STAGES).index(stage)]


def repeated_stage(done, folder, stage, spoil):
    """Repeat one stage of the finished commissioning, in a copy of its folder, from a spoiled recording."""
    shutil.copytree(done[0].folder.path, folder / "kept")
    bench, attendant = Observed(), Willing()
    bench.recorded, bench.spoil = done[1].recorded, {stage: spoil}
    commission(sitting(folder, resumed=True), bench, attendant, [stage], COUPLED_STAGES)
    return attendant.heard[stage][0]


def test_an_error_beyond_its_prediction_ends_with_exit_code_4(done, tmp_path, monkeypatch):
    def buzzing(signals):
        signals["y/measured"] += 3e-6 * np.sin(0.05 * np.arange(signals["y/measured"].size))

    outcome = repeated_stage(done, tmp_path, "judge", buzzing)
    assert outcome.figures["y"]["ratio"] > 1.5 > outcome.figures["x"]["ratio"] and not outcome.figures["as_predicted"]
    assert "MORE than 1.5 x the prediction" in outcome.lines[1]
    for name in ("picture_figure", "data_uri"):  # only what the command prints is read, not its page
        monkeypatch.setattr(commissioning_report, name, lambda given: "")
    words = ("--offline", "--resume", "--directory", tmp_path / "kept")
    answer = CliRunner().invoke(main, ["commission", *map(str, (tmp_path / "scanner.yaml", *words))])
    assert answer.exit_code == 4 and "judge: already done" in answer.output, answer.output


def test_the_error_of_each_scan_is_its_own_and_is_compared_with_its_prediction(done, tmp_path):
    def buzzing(signals):
        signals["x/measured"] += 2e-6 * np.sin(0.05 * np.arange(signals["x/measured"].size))

    found, before = repeated_stage(done, tmp_path, "scan", buzzing).figures, done[0].found["scan"].figures
    error = np.hypot(before["x"]["rms_error_m"], 2e-6 / np.sqrt(2.0))
    assert found["x"]["rms_error_m"] == pytest.approx(error, rel=0.05)
    assert found["x"]["predicted_rms_m"] == before["x"]["predicted_rms_m"]
    assert (
        found["x"]["ratio"] == pytest.approx(error / before["x"]["predicted_rms_m"], rel=0.05)
        and not found["as_predicted"]
    )
    assert found["y"]["ratio"] == before["y"]["ratio"] < 1.5


def test_a_motion_beyond_the_announced_one_is_a_warning(done, tmp_path):
    def stronger(signals):
        signals["y/measured"] *= 3.0

    quiet, loud = (done[0].found["multisine"], repeated_stage(done, tmp_path, "multisine", stronger))
    assert not any("warning" in text for text in quiet.lines)
    (text,) = (text for text in loud.lines if "warning" in text)
    figures = loud.figures["y"]
    assert f"y: moved {figures['swing_m'] / figures['predicted_swing_m']:.3g} times as far as expected" in text
    assert "more than 28.47 µm beyond the range" in text and "raise `small`" in text
    said = COUPLED_STAGES["multisine"].words(done[0])
    assert f"y ±{1e6 * figures['predicted_swing_m']:.4g} µm as the small multisines predict" in said


def test_a_loop_that_disturbs_another_is_named(done, tmp_path):
    begin = steps(done[0]).spans["x"].start

    def bumped(signals):
        signals["y/measured"][begin + 300 : begin + 400] += 3e-6

    with pytest.raises(CommissioningError, match=r"loop: axis y: moves by 3\.\d+ µm while x steps by"):
        repeated_stage(done, tmp_path, "loop", bumped)


def test_a_stage_that_leaves_its_range_stops_with_all_its_axes(tmp_path):
    """The sensor of y reads half a stroke and more beyond the range of a small step of x: nothing moves any more."""
    run = COUPLED_STAGES["gain"].axis(sitting(tmp_path))
    axes = list(run.axes)
    plant = axes[1].plant_simulator
    _, high = run.travel()[1]
    for beyond, trips in ((0.9, False), (1.1, True)):
        axes[1] = replace(
            axes[1], plant_simulator=replace(plant, sensor=replace(plant.sensor, offset=float(beyond * high)))
        )
        recording = OfflineBench().run(replace(run, axes=tuple(axes)).with_duration(1.0))
        assert recording["x/voltage"].max() == pytest.approx(0.0 if trips else 5.0, abs=0.01)
        assert (recording["x/tripped"].max() > 0.0) == trips
    with pytest.raises(CommissioningError, match=r"axis x: the axis tripped after 0(\.\d+)? s"):
        require_sound(recording, 10000)
    assert recording["y/tripped"].max() == 2.0


def test_a_safe_voltage_within_the_range_is_where_everything_begins_and_ends(tmp_path):
    (tmp_path / "a").mkdir()
    path = written(tmp_path / "a")
    text = path.read_text(encoding="utf-8").replace("safe_voltage: 0.0", "safe_voltage: 30.0")
    path.write_text(text, encoding="utf-8")
    situation = sitting(tmp_path / "a")
    run = COUPLED_STAGES["gain"].axis(situation)
    found = OfflineBench().run(run.with_duration(0.75))
    assert np.allclose(found["x/voltage"], 30.0, atol=0.01) and np.allclose(found["y/voltage"], 30.0, atol=0.01)
    assert run.axes[0].plant_simulator.limits.minimum == pytest.approx(30.0, abs=0.02)


def test_each_axis_is_limited_by_its_own_plan(tmp_path):
    further = "\n/y/commissioning:\n  ros__parameters: {maximum: 60.0, slew_rate: 4000.0}\n"
    found = StageParameters.from_configuration(sitting(tmp_path, further=further).within())
    for axis, most, slew in zip(found.axes, (100.0, 60.0), (70000.0, 4000.0), strict=True):
        for node in (axis.plant_simulator, axis.hysteresis_compensator):
            assert (node.limits.maximum, node.limits.slew_rate) == (most, slew)
    x, y = (axis.plant_simulator.overtravel for axis in found.axes)
    assert x == pytest.approx(0.5 * 56.94e-6, rel=1e-3) and y == pytest.approx(0.6 * x, rel=1e-9)


@pytest.mark.parametrize(("swings", "least"), [((1e-7, 1e-7), None), ((9e-6, 1e-6), "x"), ((1e-6, 9e-6), "y")])
def test_the_multisine_moves_no_axis_by_more_than_a_quarter_of_its_stroke(tmp_path, swings, least):
    situation = sitting(tmp_path)
    figures = {name: {"swing_m": swing} for name, swing in zip("xy", swings, strict=True)}
    situation.found["resonance"] = Outcome([], figures)
    found = identification_excitation(situation)
    moved = predicted_swings(situation, found.amplitude)
    quarter = {name: 0.25 * plan.stroke for name, plan in situation.plans.items()}
    if least is None:
        assert found.amplitude == 1.0 and all(moved[name] < quarter[name] for name in "xy")
    else:
        assert moved[least] == pytest.approx(quarter[least], rel=5e-3)
        assert all(moved[name] <= 1.005 * quarter[name] for name in "xy")


def test_a_scan_beyond_the_range_of_an_axis_is_refused():
    def size(stroke):
        plans = {"x": SimpleNamespace(scan_stroke=stroke)}
        return scan_size(SimpleNamespace(plans=plans), "x", Range(-10e-6, 30e-6, 0.0))

    assert size(0.0) == pytest.approx(SCANNED * 40e-6) and size(39e-6) == 39e-6
    with pytest.raises(CommissioningError, match="axis x: a scan of 41 µm was requested, but it reaches 40 µm"):
        size(41e-6)


@pytest.mark.parametrize(
    ("error", "gain", "loops", "refused", "said"),
    [
        (0.19, 1.0, 4.9, False, "19 % of the motion; loops 4.9 %"),
        (0.21, 1.0, 1.0, True, "21 % of the motion"),
        (0.01, 1.0, 5.1, True, "5.1 % of the stroke: more than 20 %"),
        (0.04, 1.55, 1.0, False, r"36 % of the motion \(4 % with 1.55 times the gain\)"),
        (0.21, 1.55, 1.0, True, r"\(21 % with 1.55 times the gain\)"),
        (0.01, 2.1, 1.0, True, "more than twice or less than half the gain"),
        (0.01, 0.45, 1.0, True, "more than twice or less than half the gain"),
    ],
)
def test_a_model_of_another_shape_than_one_recording_or_of_twice_the_gain_is_refused(
    tmp_path, monkeypatch, error, gain, loops, refused, said
):
    figures = {f"loops_{name}_rmse_percent_of_stroke": loops if name == "y" else 1.0 for name in "xy"}
    figures |= {"type": "hammerstein", "order": 4, "lines": 9}
    phase = 2.0 * np.pi * np.arange(400) / 400
    # the error has another frequency than the motion, so it is no gain; the motion is 1 µm RMS
    own, other = (np.sqrt(2.0) * 1e-6 * np.sin(times * phase) for times in (1, 2))
    measured = np.sqrt(1.0 - error**2) * own + error * other
    y = np.sqrt(1.0 - error**2) / gain * own
    held = HeldOut(phase, np.stack([own, measured], 1), np.stack([own, y], 1))
    found, asked = SimpleNamespace(text="", figures=figures, held_out=held, warnings=()), []
    monkeypatch.setattr(fitting, "identification_data", lambda *given: (None, None))
    monkeypatch.setattr(fitting, "reading_of", lambda *given: None)
    monkeypatch.setattr(fitting, "identify_stage", lambda *given: asked.append(given[2]) or found)
    monkeypatch.setattr(fitting, "write_file", lambda *given: None)
    monkeypatch.setattr(fitting, "_pictures", lambda *given: [])
    monkeypatch.setattr(Folder, "recording", lambda *given: None)
    noise = {name: {"noise_rms_m": level} for name, level in (("x", 7e-9), ("y", 3e-9))}
    situation = replace(sitting(tmp_path), found={"noise": Outcome([], noise)})
    if refused:
        with pytest.raises(CommissioningError, match=f"y: held-out error .*{said}.*the model is not fit for feedback"):
            fitting.identify_coupled(situation)
    else:
        assert re.search(said, fitting.identify_coupled(situation).lines[2])
    assert asked[0].resting_noise == (7e-9, 3e-9)


def test_loops_are_designed_for_the_noisiest_sensor_and_must_be_stable_together(done, monkeypatch):
    situation, heard = done[0], []
    text = (situation.folder.path / DESIGNED).read_text(encoding="utf-8")
    noise = {name: {"noise_rms_m": level} for name, level in (("x", 7e-9), ("y", 3e-9))}
    situation = replace(situation, found={**situation.found, "noise": Outcome([], noise)})

    def designed(given, parameters, request, level, *more):
        heard.append(level)
        return text, {"x": None}, []

    monkeypatch.setattr(fitting, "design_identified", designed)
    margins = SimpleNamespace(together=SimpleNamespace(alpha=-0.1, gain_margin=0.0))
    monkeypatch.setattr(fitting, "disk_margins", lambda *given: margins)
    kept = (situation.folder.path / COMMISSIONED).read_bytes()
    with pytest.raises(CommissioningError, match="each loop is stable alone, but all together are not"):
        fitting.design_coupled(situation)
    assert heard == [7e-9] and not (situation.folder.path / COMMISSIONED).exists(), "a file is of its controllers"
    (situation.folder.path / COMMISSIONED).write_bytes(kept)


def test_a_plan_beyond_the_plants_replaces_their_limits(tmp_path):
    """As for a single axis: limits of a new file are those of manual commands."""
    further = "\n/y/commissioning:\n  ros__parameters: {maximum: 120.0}\n"
    situation = sitting(tmp_path, further=further)
    x, y = (axis.plant_simulator.limits for axis in StageParameters.from_configuration(situation.within()).axes)
    assert (x.maximum, x.slew_rate, y.maximum, y.slew_rate) == (100.0, 70000.0, 120.0, 0.0)


def test_devices_have_the_whole_range_of_the_plan_before_any_movement(tmp_path):
    """A device with a narrower range is refused then, as that of a single axis."""
    (tmp_path / "mine.py").write_text(
        "from hysteresis_ros.hardware.drivers.simulated import DRIVER\n", encoding="utf-8"
    )
    words = ["--axes", "x,y", "--stroke", "40um", "--voltage", "0:100V", "--rate", "1kHz", "--driver", "./mine.py"]
    options = (
        "hysteresis.type=proportional",
        "hysteresis.proportional.gain=4e-7",
        "limits.minimum=0",
        "limits.maximum=100",
    )
    words += [word for option in options for word in ("--driver-option", option)]
    path = tmp_path / "stage.yaml"
    answer = CliRunner().invoke(main, ["new", str(path), *words])
    assert answer.exit_code == 0, answer.output
    configuration = load_configuration(path)
    parameters = StageParameters.from_configuration(configuration)
    folder = Folder(tmp_path / "kept", configuration.text, "graph", False)
    situation = StageSituation(configuration, parameters, plans_of(configuration, parameters), folder, "auto", "pid")
    for axis in noise_stage(situation).axes:
        assert (axis.plant_simulator.limits.minimum, axis.plant_simulator.limits.maximum) == (0.0, 100.0)
        assert axis.hysteresis_compensator.limits.maximum < 0.1


def test_a_range_of_the_compensators_beyond_the_plants_is_no_plan(tmp_path):
    configuration = load_configuration(written(tmp_path)).override("y/hysteresis_compensator", limits__maximum=120.0)
    parameters = StageParameters.from_configuration(configuration)
    with pytest.raises(ConfigurationError, match=r"axis y: limits.maximum = 120 V of its hysteresis_compensator is"):
        plans_of(configuration, parameters)
    asked = replace(configuration, entries=(*configuration.entries, ("/y/commissioning", {"maximum": 90.0})))
    assert plans_of(asked, parameters)["y"].maximum == 90.0


def test_what_repeats_is_told_from_noise():
    random = np.random.default_rng(1)
    period, wave = 200, 1e-9 * np.sin(2.0 * np.pi * np.arange(200) / 200)
    error = np.tile(wave, 10) + 5e-9 * random.standard_normal(2000) + 3e-9
    moved, noise = repeated(error, period)
    assert moved == pytest.approx(1e-9 / np.sqrt(2.0), rel=0.5) and noise == pytest.approx(
        5e-9 / np.sqrt(10.0), rel=0.1
    )
    assert repeated(np.tile(wave, 10), period) == (pytest.approx(1e-9 / np.sqrt(2.0)), pytest.approx(0.0, abs=1e-15))


def metres(time, **signals) -> Recording:
    """Return a recording of displacements, by ``axis_signal``."""
    named = {name.replace("_", "/"): values for name, values in signals.items()}
    return Recording(time, named, dict.fromkeys(named, "m"))


def closed_loops(monkeypatch, **found):
    """Return a situation of axes with these ranges, which follow triangles of 3 µm and 5 µm at 50 Hz."""
    monkeypatch.setattr(loops, "ranges", lambda _: found)
    plans = {
        name: SimpleNamespace(scan_stroke=size, scan_frequency=50.0)
        for name, size in zip(found, (3e-6, 5e-6), strict=False)
    }
    return SimpleNamespace(rate=1000.0, plans=plans, names=tuple(found))


def test_scans_have_the_size_of_their_axis_about_the_middle_of_its_range(monkeypatch):
    """Also where the ranges of the axes are equal; meanwhile the other axis holds."""
    situation = closed_loops(monkeypatch, x=Range(2e-6, 12e-6, 1e-6), y=Range(2e-6, 12e-6, 1e-6))
    found = loops.scans(situation)
    np.testing.assert_array_equal(found.references[[0, -1]], 1e-6)
    for place, (name, size) in enumerate((("x", 3e-6), ("y", 5e-6))):
        part = found.references[found.spans[name]]
        scanned = part[1000:-1000, place].reshape(13, 20)  # after way and hold, 0.5 s each
        np.testing.assert_allclose(scanned, scanned[:1].repeat(13, axis=0), atol=1e-15)
        assert (scanned.min(), scanned.max()) == pytest.approx((7e-6 - 0.5 * size, 7e-6 + 0.5 * size))
        np.testing.assert_allclose(np.abs(np.diff(part[999:-1000, place])), 2.0 * size / 20, rtol=1e-6)
        np.testing.assert_allclose(part[:, 1 - place], 7e-6, rtol=1e-12)
        np.testing.assert_allclose(part[-1], 7e-6, rtol=1e-12)


@pytest.mark.parametrize(("low", "high", "far"), [(-2e-6, 8e-6, 8e-6), (-8e-6, 2e-6, -8e-6)])
def test_steps_go_towards_the_end_of_the_range_that_is_farther_from_rest(monkeypatch, low, high, far):
    situation = closed_loops(monkeypatch, x=Range(low, high, 0.0), y=Range(-1e-6, 4e-6, 0.0))
    found = loops.steps(situation)
    held = found.references[found.spans["x"]].reshape(4, 550, 2)[:, 50:]  # a way of 50 ms, and a hold
    np.testing.assert_allclose(held[:, :, 0], far * np.array([[0.2], [0.3], [0.2], [0.1]]) * np.ones(500), rtol=1e-9)
    np.testing.assert_allclose(held[:, :, 1], 0.1 * 4e-6, rtol=1e-12)


def test_all_axes_together_are_judged_over_whole_sines_of_full_amplitude(monkeypatch):
    """Of 50 Hz and 75 Hz, about the middle of each range, as large as the scans."""
    situation = closed_loops(monkeypatch, x=Range(2e-6, 12e-6, 1e-6), y=Range(-3e-6, 9e-6, 0.0))
    references, judged = loops.together(situation)
    assert judged.stop - judged.start == 4 * 40
    turns = 2.0 * np.pi * np.arange(160) / 1000.0
    expected = [7e-6 + 1.5e-6 * np.sin(50.0 * turns), 3e-6 + 2.5e-6 * np.sin(75.0 * turns)]
    np.testing.assert_allclose(references[judged], np.array(expected).T, atol=1e-12)
    np.testing.assert_allclose(references[[0, -1]], [[1e-6, 0.0]] * 2, atol=1e-18)


def judged_loop(monkeypatch, left, predicted, moved=0.0):
    """Judge steps of x by 1 µm after which these errors are left [m]; y moves by ``moved`` meanwhile."""
    situation = closed_loops(monkeypatch, x=Range(0.0, 10e-6, 0.0), y=Range(0.0, 10e-6, 0.0))
    excursion = loops.steps(situation)
    begin, errors = excursion.spans["x"].start, {}
    for run, size in (("measured", left), ("predicted", predicted)):
        errors[run] = {name: np.zeros(len(excursion.references)) for name in "xy"}
        # in the last tenth of a second of the second step, and ten times as much before
        errors[run]["x"][begin + 550 : begin + 1100] = 10.0 * size
        errors[run]["x"][begin + 1000 : begin + 1100] = size * (-1.0) ** np.arange(100)
    errors["measured"]["y"][begin + 10] = moved
    x, y = excursion.references.T
    measured = metres(np.arange(len(x)) / 1000.0, x_reference=x, y_reference=y)
    monkeypatch.setattr(loops, "predicted", lambda *_: "predicted")
    monkeypatch.setattr(loops, "errors_of", lambda _, run: errors["predicted" if run == "predicted" else "measured"])
    return loops.judge_loop(situation, measured)


def test_a_loop_of_a_stage_may_leave_six_times_its_prediction_or_a_twentieth_of_the_step(monkeypatch):
    for left, predicted in ((49e-9, 0.0), (590e-9, 100e-9)):
        figures = judged_loop(monkeypatch, left, predicted).figures["x"]
        assert figures["rest_rms_m"] == pytest.approx(left) and figures["predicted_rest_rms_m"] == pytest.approx(
            predicted
        )
    for left, predicted in ((51e-9, 0.0), (70e-9, 7e-9), (610e-9, 100e-9)):
        with pytest.raises(CommissioningError, match="axis x: does not settle after a step of x by 1 µm"):
            judged_loop(monkeypatch, left, predicted)
    assert judged_loop(monkeypatch, 0.0, 0.0, 0.24e-6).figures["x"]["moves_y_m"] == pytest.approx(0.24e-6)
    with pytest.raises(CommissioningError, match="axis y: moves by 0.26 µm while x steps by 1 µm"):
        judged_loop(monkeypatch, 0.0, 0.0, 0.26e-6)


@pytest.mark.parametrize(
    ("moved", "model", "noise", "more"),
    [(14e-9, 1e-8, 0.0, False), (16e-9, 1e-8, 0.0, True), (16e-9, 1e-8, 17e-9, False), (1e-9, 0.0, 0.5e-9, True)],
)
def test_the_motion_of_another_axis_is_compared_with_its_prediction_and_the_noise(moved, model, noise, more):
    found = loops.coupling_verdict(moved, model, noise)
    assert found.startswith("MORE than 1.5 x the prediction; the coupling differs") if more else found == "as predicted"


def test_an_axis_that_moves_with_another_more_than_predicted_is_told(monkeypatch):
    (own, crossed) = judged_loop(monkeypatch, 0.0, 0.0, 0.24e-6).lines[:2]
    assert own.startswith("x: settles") and crossed.startswith(
        "x: y moves by at most 240 nm meanwhile, predicted 0 nm: MORE"
    )
    quiet = judged_loop(monkeypatch, 0.0, 0.0).lines[1]
    assert quiet.endswith("predicted 0 nm: as predicted")


def test_the_scan_of_an_axis_is_judged_in_its_last_ten_periods(monkeypatch):
    """Before and after them the error is ten times larger; the other axis moves by 1.4 nm RMS."""
    situation = closed_loops(monkeypatch, x=Range(2e-6, 12e-6, 1e-6), y=Range(2e-6, 12e-6, 1e-6))
    excursion, errors = loops.scans(situation), {}
    for run, size in (("measured", 1.4e-8), ("predicted", 1e-8)):
        errors[run] = {name: 10.0 * size * np.ones(len(excursion.references)) for name in "xy"}
        for place, name in enumerate("xy"):
            begin = excursion.spans[name].start + 1000 + 3 * 20
            errors[run][name][begin : begin + 200] = size * (1 + place)
            wave = np.sqrt(2.0) * np.sin(2.0 * np.pi * np.arange(200) / 20)
            errors[run]["yx"[place]][begin : begin + 200] = 0.1 * size * wave
    run = metres(np.arange(len(excursion.references)) / 1000.0, x_reference=excursion.references[:, 0])
    monkeypatch.setattr(loops, "predicted", lambda *_: "predicted")
    monkeypatch.setattr(loops, "errors_of", lambda _, run: errors["predicted" if run == "predicted" else "measured"])
    outcome = loops.judge_scan(situation, run)
    found = outcome.figures
    assert outcome.lines[1].endswith("of the scan, predicted 1 nm: as predicted")
    errors["predicted"]["y"] *= 0.9
    assert ": MORE than 1.5 x the prediction" in loops.judge_scan(situation, run).lines[1]
    for place, (name, other) in enumerate(("xy", "yx")):
        assert found[name]["rms_error_m"] == pytest.approx(1.4e-8 * (1 + place))
        assert found[name]["predicted_rms_m"] == pytest.approx(1e-8 * (1 + place))
        assert found[name]["ratio"] == pytest.approx(1.4) and found["as_predicted"]
        assert found[name][f"coupling_{other}_rms_m"] == pytest.approx(1.4e-9)
        assert found[name][f"predicted_coupling_{other}_rms_m"] == pytest.approx(1e-9)


def test_the_error_of_an_axis_is_against_its_late_reference_and_without_the_zero_of_its_sensor(tmp_path, monkeypatch):
    configuration = load_configuration(written(tmp_path)).override(
        "motion_controller",
        **{
            "feedforward.type": "static",
            "feedforward.preview": 3,
            "model.preload.force": 2.0,
            "model.preload.A1": 1e-6,
        },
    )
    monkeypatch.setattr(loops, "designed", lambda _: configuration)
    parameters = StageParameters.from_configuration(configuration)
    zero = parameters.axes[0].motion_controller.model.preload.offset
    reference = 1e-6 * np.arange(20.0)
    late = np.maximum(reference - 3e-6, 0.0)
    measured = late - 4e-9 + zero
    both = {"x_reference": reference, "x_measured": measured, "y_reference": reference, "y_measured": measured}
    errors = loops.errors_of(sitting(tmp_path), metres(np.arange(20) * 1e-4, **both))
    assert abs(zero) > 1e-7
    for name in "xy":
        np.testing.assert_allclose(errors[name], 4e-9, rtol=1e-6)


OWN = "\n/y/commissioning:\n  ros__parameters: {minimum: -20.0, maximum: 60.0, small: 0.05, noise_duration: 0.8}\n"


def test_what_a_stage_announces_is_what_each_axis_does(tmp_path, monkeypatch):
    """A twentieth of each range of voltages, 0.569 µm/V; y goes from -20 V to 60 V."""
    situation = sitting(tmp_path, further=OWN)
    words = {name: COUPLED_STAGES[name].words(situation) for name in ("gain", "resonance", "hysteresis")}
    assert words["gain"] == (
        "x: a step of +5 V from 0 V and back, about 2.847 µm; then y: a step of +4 V from 0 V and back, about 2.277 µm"
    )
    assert "; then y: slowly to 20 V, a multisine of ±4 V there" in words["resonance"]
    assert "the whole range -20 … 60 V, about 45.55 µm, in 16 cycles" in words["hysteresis"]
    closed = closed_loops(monkeypatch, x=Range(0.0, 10e-6, 0.0), y=Range(-20e-6, 2e-6, 0.0))
    closed.controller = "pid"
    assert (
        COUPLED_STAGES["loop"]
        .words(closed)
        .endswith("(pid): steps of one axis after the other, at most x 2 µm, y 4 µm")
    )
    assert "13 triangles of one axis after the other at 50 Hz, x 3 µm, y 5 µm" in COUPLED_STAGES["scan"].words(closed)


def test_the_sensors_are_read_for_the_longest_time_of_all_plans(tmp_path, monkeypatch):
    situation, asked, resting = sitting(tmp_path, further=OWN), [], StageSituation.resting
    monkeypatch.setattr(StageSituation, "resting", lambda own, seconds: asked.append(seconds) or resting(own, seconds))
    noise_stage(situation)
    assert asked == [0.8]


def test_a_swing_is_predicted_from_the_size_of_the_small_multisine():
    plans = {"x": SimpleNamespace(small=0.5 * SMALL), "y": SimpleNamespace(small=2.0 * SMALL)}
    measured = {name: {"swing_m": 1e-7} for name in plans}
    found = predicted_swings(SimpleNamespace(plans=plans, figures=lambda stage: measured), 3.0)
    assert found == pytest.approx({"x": 6e-7, "y": 1.5e-7})


def test_the_file_of_a_stage_keeps_the_plans_of_all_axes(tmp_path, monkeypatch):
    situation = sitting(tmp_path, further=OWN)
    monkeypatch.setattr(fitting, "closed_configuration", lambda *_, **__: load_configuration("xy_scanner"))
    monkeypatch.setattr(fitting, "load_configuration", lambda _: situation.configuration)
    found = parse_configuration(fitting.commissioned_text(situation), "stage")
    assert dict(found.entries)["/y/commissioning"]["maximum"] == 60.0
    assert dict(found.entries)[SECTION]["cycle_frequency"] == 100.0


REFUSED = {
    "axis": (("--namespace", "x"), "--namespace and --against are for a single axis"),
    "other models": (("--against", "none"), "--namespace and --against are for a single axis"),
    "external": (("--plant", "external"), "supports no external plants; give each axis a driver"),
    "stage of an axis": (("--stage", "creep"), "no stage creep; there are noise, gain, resonance, multisine"),
    "before its time": (("--stage", "loop"), "loop needs the results of noise, gain"),
    "nobody there": ((), "noise: no terminal to ask for permission to move; give --yes"),
    "unit": (("--scan-stroke", "70V"), "--scan-stroke '70V': is in V"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_stage_cannot_do_is_refused(tmp_path, case):
    words, said = REFUSED[case]
    yes = () if case == "nobody there" else ("--yes",)
    answer = CliRunner().invoke(main, ["commission", str(written(tmp_path)), "--offline", *yes, *words])
    assert answer.exit_code == 2 and said in answer.output, answer.output
    assert not list(tmp_path.glob("*/noise.npz"))


def test_the_command_takes_a_stage_and_writes_its_page(tmp_path):
    answer = CliRunner().invoke(main, ["commission", str(written(tmp_path)), "--offline", "--yes", "--stage", "noise"])
    assert answer.exit_code == 0, answer.output
    assert "all sensors are read at the safe voltages (x 0 V, y 0 V)" in answer.output
    page = (tmp_path / "scanner_commissioning/report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2 and "Commissioning of scanner.yaml" in page
    assert not (tmp_path / "scanner_commissioning" / IDENTIFIED).exists()
