# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sweeps: varied parameters, the same bits for any distribution of the runs, and figures known in closed form."""

from __future__ import annotations

import json
import math
import pathlib
import platform
import resource
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy
from adapting_support import adapting
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from sweep_support import AXIS, PLACE, PRODUCT, asked, axis, same_bits

from hysteresis_ros import executors
from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.laboratory.sweeps.plan import DEVIATIONS, make_plan, parse_variations, varied
from hysteresis_ros.laboratory.sweeps.plan import settings as settings_of
from hysteresis_ros.laboratory.sweeps.study import Study, _unless_it_jumps, judged
from hysteresis_ros.laboratory.sweeps.summary import Summary, interval, parse_bound, sensitivity
from hysteresis_ros.laboratory.sweeps.sweep import SUFFIX, load, sweep
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis import hysteresis_block

GAIN = "plant_simulator.hysteresis.proportional.gain"


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(AXIS)
    return str(path)


def run_command(*words):
    return CliRunner().invoke(main, ["sweep", *map(str, words)])


@pytest.mark.parametrize(
    ("words", "values"),
    [
        ("1um:5um:lin3", [1e-6, 3e-6, 5e-6]),
        ("1um:100um:log3", [1e-6, 1e-5, 1e-4]),
        ("1um, 2000nm,3e-6m", [1e-6, 2e-6, 3e-6]),
    ],
)
def test_levels_are_read_with_their_units(words, values):
    (found,) = parse_variations([f"reference_generator.maximum={words}"], axis())
    assert [found.over.at(i) for i in range(3)] == pytest.approx(values, rel=1e-12)


@pytest.mark.parametrize(
    ("words", "at"),
    [
        ("±5%", {0.0: 0.95e-7, 0.5: 1e-7, 1.0: 1.05e-7}),
        ("+-1e-8", {0.0: 0.9e-7, 1.0: 1.1e-7}),
        ("uniform(1e-7,3e-7)", {0.25: 1.5e-7}),
        ("loguniform(1e-7,4e-7)", {0.5: 2e-7}),
        ("normal(1e-7,1e-9)", {0.5: 1e-7, float(scipy.special.ndtr(2.0)): 1.02e-7}),
        ("normal(±2%)", {float(scipy.special.ndtr(-1.0)): 0.98e-7}),
    ],
)
def test_distributions_are_where_their_distribution_functions_say(words, at):
    variations = parse_variations([f"{GAIN}={words}"], axis())
    for place, value in at.items():
        assert settings_of(axis(), variations, [place])[1] == pytest.approx([value], rel=1e-9)


def test_whole_numbers_are_drawn_with_both_ends():
    (seeds,) = parse_variations(["plant_simulator.sensor.seed=uniform(1,4)"], axis())
    drawn = [seeds.over.at(place) for place in np.linspace(0.0, 1.0, 4001)[:-1]]
    assert np.bincount(drawn).tolist() == [0, 1000, 1000, 1000, 1000]


def test_arrays_vary_as_a_whole_or_one_element():
    stage = single_axis(load_configuration("kim2009"))
    name = "plant_simulator.hysteresis.polynomial.rising_C1"
    before = np.array(stage.plant_simulator.hysteresis.polynomial.rising_C1)
    changes, numbers = settings_of(stage, parse_variations([f"{name}=±10%"], stage), [1.0])
    assert changes["plant_simulator"]["hysteresis.polynomial.rising_C1"] == pytest.approx(1.1 * before)
    assert numbers == pytest.approx([1.1])
    changes, numbers = settings_of(stage, parse_variations([f"{name}[1]=±10%"], stage), [0.0])
    assert changes["plant_simulator"]["hysteresis.polynomial.rising_C1"] == pytest.approx(before * [1.0, 0.9, 1.0])
    assert numbers == pytest.approx([0.9 * before[1]])


@settings(max_examples=10, deadline=None)
@given(phi=st.floats(0.1, 0.99), noise=st.floats(0.0, 1e-8))
def test_a_varied_axis_is_the_one_of_a_file_with_these_values(phi, noise):
    """The direct change of the parameters gives the same axis, and the model is unchanged."""
    configuration = load_configuration("kim2009")
    names = {"motion_controller": ("sliding_mode.phi", phi), "plant_simulator": ("sensor.noise", noise)}
    stage = single_axis(configuration)
    found = varied(
        stage,
        parse_variations(
            [
                f"{node}.{name}={value!r}{'m' if name == 'sensor.noise' else ''}"
                for node, (name, value) in names.items()
            ],
            stage,
        ),
        [0, 0],
    )
    for node, (name, value) in names.items():
        configuration = configuration.override(node, **{name: value})
    assert found == single_axis(configuration)
    assert found.hysteresis_compensator == stage.hysteresis_compensator


def test_a_plant_that_deviates_leaves_the_models_alone():
    stage = single_axis(load_configuration("kim2009"))
    variations = parse_variations(["plant_simulator=±5%"], stage)
    assert [one.name for one in variations] == ["gain", "opening", "slowness"]  # the plant has no creep
    found = varied(stage, variations, [1.0, 0.5, 0.5])
    assert found.motion_controller == stage.motion_controller
    assert found.hysteresis_compensator == stage.hysteresis_compensator
    voltage = np.linspace(0.0, 100.0, 20)
    larger, before = (hysteresis_block(one.plant_simulator.hysteresis, 1.0).simulate(voltage) for one in (found, stage))
    assert larger == pytest.approx(1.05 * before)
    assert not set(DEVIATIONS) & {row.name for row in PlantNodeParameters.table()}


def test_all_levels_meet_the_same_draws_and_a_longer_sweep_begins_with_the_shorter():
    variations = parse_variations(["plant_simulator.limits.bits=12,14,16", *PRODUCT], axis())
    points = make_plan(variations, 30, 7).points(range(30))
    assert points[:, 0].tolist() == [0, 1, 2] * 10
    assert np.array_equal(points[0::3, 1:], points[1::3, 1:]) and np.array_equal(points[0::3, 1:], points[2::3, 1:])
    assert len(np.unique(points[:, 1])) == 10
    longer = make_plan(variations, 3000, 7)
    assert np.array_equal(longer.points(range(11, 25)), points[11:25])
    assert not np.array_equal(make_plan(variations, 30, 8).points(range(30)), points)


def test_each_run_begins_at_rest_whatever_the_one_before_has_left_behind():
    """An adapting inverse would continue from run to run if it were not reset."""
    stage = adapting(plant_simulator={"samples": 900})
    variations = parse_variations(["plant_simulator=±20%"], stage)
    study = Study(stage, variations, ("rms_error_m", "max_error_m", "iae_m_s"))
    points = make_plan(variations, 4).points(range(4))
    found = study.runs(0, points)
    for point, row in zip(points, found.rows, strict=True):
        alone = Axis(varied(stage, variations, point))
        made = alone.run(alone.default_setpoints(900))
        assert np.any(made["adapted_gain"] != made["adapted_gain"][0])
        assert row == [*judged(alone, made, study.metrics), 0.0]
    assert len({row[0] for row in found.rows}) == 4 and not found.refused


def test_errors_between_the_samples_are_those_of_the_closed_form():
    found = sweep(*asked())
    gain, place = (found.parameters[name] for name in ("plant_simulator.gain", "reference_generator.initial_setpoint"))
    for values in found.metrics.values():
        assert values == pytest.approx(place * (gain - 1.0), rel=1e-9)


def test_the_offset_of_the_model_belongs_to_the_measurement_and_that_of_the_plant_to_the_error():
    """2 µm are asked of a gain 1.2 times as large, with offsets of 0.3 µm of the plant and 0.1 µm of the model."""
    stage = axis()
    gain = replace(stage.plant_simulator.hysteresis.proportional, gain=1.2e-7)
    plant = replace(
        stage.plant_simulator,
        hysteresis=replace(stage.plant_simulator.hysteresis, proportional=gain),
        preload=replace(stage.plant_simulator.preload, A1=0.3e-6),
    )
    model = stage.motion_controller.model
    control = replace(stage.motion_controller, model=replace(model, preload=replace(model.preload, A1=0.1e-6)))
    offset = Axis(replace(stage, plant_simulator=plant, motion_controller=control))
    found = judged(offset, offset.run(offset.default_setpoints(20)), ("rms_error_m", "max_error_m"))
    assert found == pytest.approx([0.6e-6, 0.6e-6], rel=1e-9)


def test_a_run_whose_reference_is_beyond_its_range_is_refused():
    study, plan = asked(("hysteresis_compensator.limits.maximum=10,100",), runs=2)
    found = sweep(study, plan)
    # 10 V are 1 µm, and the setpoint is 2 µm
    assert "out of range" in found.refused[0] and found.refused[1] == "" and np.isnan(found.metrics["rms_error_m"][0])


def test_a_run_without_an_end_is_refused():
    study, plan = asked(("plant_simulator.samples=0,20",), runs=2)
    found = sweep(study, plan)
    assert "the run has no end" in found.refused[0] and np.isnan(found.metrics["rms_error_m"][0])
    assert found.refused[1] == "" and found.metrics["rms_error_m"][1] >= 0.0


@pytest.mark.parametrize("preview", [0, 3])
def test_a_ramp_is_judged_between_the_samples_and_as_late_as_its_preview(preview):
    """The voltage is held while the reference continues: r(t) − r_k grows from zero to a step within each sample."""
    stage, step = axis(), 8e-6 / 1000.0
    waveform = replace(stage.reference_generator.waveform, type="triangle", frequency=1.0, amplitude=4e-6)
    source = replace(stage.reference_generator, initial_setpoint=0.0, waveform=waveform)
    fed = replace(stage.motion_controller.feedforward, preview=preview)  # the delay with which it follows
    control = replace(stage.motion_controller, feedforward=fed)
    ramp = Axis(replace(stage, reference_generator=source, motion_controller=control).with_duration(0.4))
    found = judged(ramp, ramp.run(ramp.default_setpoints(400)), ("rms_error_m", "max_error_m", "stroke_m"))
    rms = step * math.sqrt(np.mean((np.arange(1, 11) / 10) ** 2) * (399 - preview) / 399)
    assert found == pytest.approx([rms, step, (399 - preview) * step], rel=1e-6)


def test_a_ramp_that_begins_and_ends_within_the_run_has_no_jump():
    ramp = np.clip(np.arange(20.0) - 5.0, 0.0, 8.0)
    steps, jump = np.diff(ramp), np.where(np.arange(19) == 15, 4.0, 0.0)
    np.testing.assert_array_equal(_unless_it_jumps(steps, 8.0), steps)
    np.testing.assert_array_equal(_unless_it_jumps(steps + jump, 12.0), steps)
    np.testing.assert_array_equal(_unless_it_jumps(-steps - jump, 12.0), -steps)


def test_a_jump_is_no_ramp():
    """A jump cannot be followed before it occurs: the error begins at the instant of its sample."""
    stage = axis()
    steps = replace(stage.reference_generator.waveform.steps, values=(0.0, 4e-6), times=(0.0, 0.01))
    waveform = replace(stage.reference_generator.waveform, type="steps", steps=steps)
    source = replace(stage.reference_generator, initial_setpoint=0.0, waveform=waveform)
    jump = Axis(replace(stage, reference_generator=source))
    found = judged(jump, jump.run(jump.default_setpoints(20)), ("rms_error_m", "max_error_m"))
    assert found == pytest.approx([4e-6 / math.sqrt(190), 4e-6], rel=1e-9)


# -- the same bits -----------------------------------------------------------------------------------------------------


def cut_short(study, plan, path, after, **options):
    """Begin a sweep, and interrupt it after a number of runs."""

    def interrupt(done):
        if done >= after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(study, plan, path, workers=1, progress=interrupt, **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".parquet", ".npz"])
def test_a_sweep_goes_on_where_it_was_left_with_the_same_bits(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("hysteresis_ros.laboratory.sweeps.sweep.JOB_RUNS", 5)
    path, whole = tmp_path / f"f{kind}", sweep(*asked(runs=40), workers=1)
    cut_short(*asked(runs=40), path, after=20)
    journal = tmp_path / f"f{kind}{SUFFIX}"
    kept = journal.read_bytes()
    assert not path.exists() and 20 <= sum(len(json.loads(line)["rows"]) for line in kept.splitlines()[1:]) < 40
    journal.write_bytes(kept[:-7])  # killed during a write
    with pytest.raises(ConfigurationError, match="contains another sweep, with seed 1 instead of 2"):
        sweep(*asked(runs=40, seed=2), path, workers=1)
    cut_short(*asked(runs=40), path, after=30)
    assert all(map(json.loads, journal.read_text().splitlines()))
    counted = []
    assert same_bits(sweep(*asked(runs=40), path, workers=1, progress=counted.append), whole)
    assert counted[0] >= 10 and not journal.exists()
    assert same_bits(load(path), whole)
    assert same_bits(sweep(*asked(runs=40), path), whole)  # nothing remains to do
    assert same_bits(sweep(*asked(runs=25), path), whole)  # a shorter sweep is part of it
    longer = sweep(*asked(runs=55), path, workers=1)
    assert same_bits(longer, sweep(*asked(runs=55), workers=1))


@pytest.mark.slow
def test_two_processes_find_what_one_does(tmp_path):
    varied_ = (*PRODUCT, "plant_simulator.sensor.noise=0,1nm", "plant_simulator.sensor.seed=uniform(1,99)")
    metrics = ("rms_error_m", "voltage_variation_v", "overshoot_percent")
    one = sweep(*asked(varied_, metrics=metrics), workers=1)
    assert same_bits(sweep(*asked(varied_, metrics=metrics), tmp_path / "two.npz", workers=2), one)
    assert np.all(np.isnan(one.metrics["overshoot_percent"]))  # there are no steps


def test_a_run_of_a_sweep_is_that_of_simulate():
    stage = single_axis(load_configuration("kim2009")).with_duration(0.1)
    variations = parse_variations(["plant_simulator=±5%", "plant_simulator.sensor.noise=1nm"], stage)
    study = Study(stage, variations, ("voltage_variation_v", "chattering_m", "voltage_rate_v_s"))
    points = make_plan(variations, 3, 1).points(range(3))
    for row, point in zip(study.runs(0, points).rows, points, strict=True):
        alone = compute_metrics(simulate(varied(stage, variations, point)))
        assert row == [*(alone[name] for name in study.metrics), 0.0] and row[0] > 1.0


#: Prints the number of memory pages that the system provides for each of 30 runs, after as many other runs.
PAGES = """
import resource, sys
sys.path.insert(0, {folder!r})
from sweep_support import asked
study, plan = asked(runs=30)
study = type(study)(study.axis.with_duration(3.0), study.variations, study.metrics)
counted = [(study.runs(0, plan.points(range(30))), resource.getrusage(resource.RUSAGE_SELF).ru_minflt) for _ in "two"]
print((counted[-1][1] - counted[-2][1]) / 30)
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc" or not COMPILED, reason="only glibc has this setting")
def test_memory_of_a_run_serves_the_next_one():
    """Tables of 3000 samples are more than 200 pages: provided for each run, they take a quarter of its time."""
    script = PAGES.format(folder=str(pathlib.Path(__file__).parent))
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(found.stdout) < 100.0


# -- what is found -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("runs", [1, 7, 50])
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_the_interval_covers_every_share(runs, confidence):
    """Summed over all possible observations: never less than the stated confidence, for any true fraction."""
    ends = np.array([interval(good, runs, confidence) for good in range(runs + 1)])
    for share in np.linspace(0.01, 0.99, 99):
        chances = scipy.special.comb(runs, np.arange(runs + 1)) * share ** np.arange(runs + 1)
        chances *= (1.0 - share) ** np.arange(runs, -1, -1)
        covered = (ends[:, 0] <= share) & (share <= ends[:, 1])
        assert np.sum(chances[covered]) >= confidence - 1e-12


@pytest.mark.slow
def test_the_yield_is_that_of_the_distribution():
    """For an error with uniform distribution; runs that are unstable, refused or without a value are not good."""
    study, plan = asked(("plant_simulator.gain=uniform(1.0,1.4)",), runs=500)
    summed = Summary(sweep(study, plan), plan, (parse_bound(f"max_error_m={0.25 * PLACE}m"),))
    assert summed.yield_.low < 0.25 / 0.4 < summed.yield_.high and summed.yield_.high - summed.yield_.low < 0.1
    assert summed.results.metrics["max_error_m"][summed.worst("max_error_m")] == max(
        summed.results.metrics["max_error_m"]
    )


def test_a_sensitivity_takes_as_many_of_the_runs_as_its_points_allow():
    """Saltelli's points of two parameters: four for each of a power of two; Morris' trajectories have three points."""
    variations = parse_variations(PRODUCT, axis())
    for runs in range(16, 300):
        sobol, morris = (make_plan(variations, runs, 1, design).runs for design in ("sobol", "morris"))
        assert sobol % 4 == 0 and (sobol // 4).bit_count() == 1 and sobol <= runs < 2 * sobol
        assert morris % 3 == 0 and morris <= runs < morris + 3


@pytest.mark.slow
def test_sensitivities_after_sobol_are_those_of_a_product():
    """The error is setpoint times deviation: E[XY | X] and the variances of a product are known."""
    ranges = ("plant_simulator.gain=uniform(1.0,1.5)", "reference_generator.initial_setpoint=uniform(0um,2um)")
    study, plan = asked(ranges, runs=1024, design="sobol", metrics=("rms_error_m",))
    found = sensitivity(plan, "rms_error_m", sweep(study, plan).metrics["rms_error_m"])
    means, variances = np.array([0.25, 1.0]), np.array([0.5**2, 2.0**2]) / 12.0
    whole = np.prod(means**2 + variances) - np.prod(means**2)
    first = variances * means[::-1] ** 2 / whole
    assert found.columns["first"] == pytest.approx(first, abs=0.05)
    assert found.columns["total"] == pytest.approx(first + np.prod(variances) / whole, abs=0.05)


@pytest.mark.slow
def test_effects_after_morris_are_the_slopes():
    study, plan = asked(
        (*PRODUCT, "plant_simulator.sensor.seed=uniform(1,9)"), runs=80, design="morris", metrics=("rms_error_m",)
    )
    found = sensitivity(plan, "rms_error_m", sweep(study, plan).metrics["rms_error_m"])
    # over the width of each: 0.2 · setpoint, deviation · 1 µm, and no effect of a seed without noise
    assert found.columns["mean"] == pytest.approx([0.2 * 1.5e-6, 0.2e-6, 0.0], rel=0.25)


# -- what is wrong -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--vary", f"{GAIN}=±5%", "--metric", "rms_eror_m"], "did you mean rms_error_m?"),
        (["--vary", f"{GAIN}=±5%", "--metric", "lateness_p99_s"], "lateness_p99_s"),
        (["--vary", "plant_simulator.hysteresis.proportional.gian=±5%"], "did you mean hysteresis.proportional.gain?"),
        (["--vary", "plant_simulatr.gain=±5%"], "did you mean plant_simulator?"),
        (["--vary", f"{GAIN}=1e-7,-1e-7,2e-7"], "out of range"),
        (["--vary", f"{GAIN}=1um:5um:lin3"], "is in m, must be in m/V"),
        (["--vary", f"{GAIN}=0.1:2:exp3"], "write 0.1:2:log20"),
        (["--vary", "plant_simulator.gain=±60%"], "0.5 … 1.5"),
        (["--vary", "plant_simulator.sensor.noise=±5%"], "configured as 0"),
        (["--vary", "plant_simulator.sensor.noise=±1nm"], "out of range"),
        (["--vary", "plant_simulator.sensor.noise=60"], "of which unit? Write 60um or 60nm"),
        (["--vary", "plant_simulator.limits.bits=12.5"], "whole number"),
        (["--vary", f"{GAIN}=±5%", "--vary", f"{GAIN}=±2%"], "is given twice"),
        (["--vary", "reference_generator.waveform.steps.values=1um"], "is an array"),
        ([], "no varied parameter"),
        (
            ["--vary", f"{GAIN}=1e-7:2e-7:lin9", "--vary", "plant_simulator=±1%", "--runs", "5"],
            "there are 9 combinations",
        ),
        (["--vary", f"{GAIN}=±5%", "--bound", "rms_error_m=1V"], "is in V"),
        (["--vary", f"{GAIN}=±5%", "--bound", "rms_error_m=60"], "of which unit? Write 60um or 60nm"),
        (["--vary", f"{GAIN}=±5%", "--runs", "3", "--sensitivity", "sobol"], "needs at least"),
        (["--vary", f"{GAIN}=±5%", "-o", "g.npz"], "one file"),
        (["--vary", f"{GAIN}=±5%", "--scheduler", "tcp://127.0.0.1:9"], "no scheduler answers"),
    ],
)
def test_the_command_names_what_is_wrong(config, tmp_path, monkeypatch, words, named):
    monkeypatch.setattr(executors, "CONNECT", 0.3)
    answer = run_command(config, *words, "-o", tmp_path / "f.npz")
    assert answer.exit_code == 2 and named in answer.output and "Traceback" not in answer.output
    assert len(answer.output.strip().splitlines()) == 1


def test_results_of_another_sweep_are_left_alone(config, tmp_path):
    words = [config, "--vary", "plant_simulator.gain=±5%", "--runs", "5", "-o", tmp_path / "f.npz"]
    assert run_command(*words).exit_code == 0
    kept = (tmp_path / "f.npz").read_bytes()
    for other, named in (
        (["--seed", "2"], "with seed 1 instead of 2"),
        (["--metric", "iae_m_s"], "metrics"),
        (["--duration", "1"], "configuration"),
    ):
        answer = run_command(*words, *other)
        assert answer.exit_code == 2 and "contains another sweep" in answer.output and named in answer.output
    assert (tmp_path / "f.npz").read_bytes() == kept
    (tmp_path / "f.npz").write_bytes(b"something else")
    answer = run_command(*words)
    assert answer.exit_code == 2 and "does not contain results of a sweep" in answer.output


def test_a_run_that_no_axis_can_make_is_named_and_the_others_are_kept(config, tmp_path):
    """Each end of a range is allowed, but not every combination."""
    words = [
        "--vary",
        "plant_simulator.limits.minimum=-10,-20,300",
        "--metric",
        "max_error_m",
        "-o",
        tmp_path / "f.npz",
    ]
    answer = run_command(config, *words)
    assert answer.exit_code == 2 and "1 of 3 runs were refused; run 2: plant_simulator: " in answer.output
    found = load(tmp_path / "f.npz")
    assert np.isfinite(found.metrics["max_error_m"]).tolist() == [True, True, False]
    assert found.refused[2] and found.good.tolist() == [True, True, False]
    assert run_command(config, *words).exit_code == 2


@pytest.mark.slow
def test_a_full_disk_loses_nothing(tmp_path, monkeypatch):
    """The file size is limited here; the content of the file stays, and the sweep continues with more space."""
    monkeypatch.setattr("hysteresis_ros.laboratory.sweeps.sweep.JOB_RUNS", 5)
    path, before = tmp_path / "f.npz", resource.getrlimit(resource.RLIMIT_FSIZE)
    cut_short(*asked(runs=40), path, after=5)
    journal = tmp_path / f"f.npz{SUFFIX}"
    resource.setrlimit(resource.RLIMIT_FSIZE, (journal.stat().st_size + 300, before[1]))
    try:
        with pytest.raises(ConfigurationError, match="cannot be written.*stored"):
            sweep(*asked(runs=40), path, workers=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert journal.read_bytes().endswith(b"\n") and not path.exists()
    assert same_bits(sweep(*asked(runs=40), path, workers=1), sweep(*asked(runs=40), workers=1))


def test_two_sweeps_do_not_write_into_one_file(tmp_path):
    path = tmp_path / "f.npz"

    def meanwhile(done):
        with pytest.raises(ConfigurationError, match="another sweep is writing this file"):
            sweep(*asked(), path, workers=1)

    sweep(*asked(), path, workers=1, progress=meanwhile)


@pytest.mark.slow
def test_a_sweep_is_shown(config, tmp_path):
    words = ["--vary", "plant_simulator.gain=0.9:1.1:lin3", "--vary", "plant_simulator.sensor.noise=uniform(0,1nm)"]
    words += ["--runs", "30", "--bound", "rms_error_m=100nm", "--json", tmp_path / "f.json"]
    answer = run_command(config, *words, "-o", tmp_path / "f.parquet", "-o", tmp_path / "f.html")
    assert answer.exit_code == 0, answer.output
    found = json.loads((tmp_path / "f.json").read_text())
    assert [one["good"] for one in found["levels"]] == [0, 10, 0] and found["yield"]["share"] == pytest.approx(1 / 3)
    page = (tmp_path / "f.html").read_text()
    assert page.count("<img") == 3 and "plant_simulator.gain" in page


def test_what_is_refused_before_anything_is_made_is_a_parameter():
    with pytest.raises(ParameterError, match="--vary plant_simulator.gain"):
        parse_variations(["plant_simulator.gain=2"], axis())


@pytest.mark.parametrize(("fault", "tripped"), [(False, 0.0), (True, 1.0)])
def test_a_run_whose_axis_is_stopped_on_its_way_counts_as_tripped(fault, tripped):
    values = {"faults": ["lost_voltage:0.005:0.015"] if fault else [], "late_limit": 3}
    own = {"late_limit": values.pop("late_limit")}
    configuration = parse_configuration(AXIS, "axis.yaml").override("", **values).override("plant_simulator", **own)
    one = single_axis(configuration)
    variations = parse_variations(PRODUCT, one)
    found = Study(one, variations, ("rms_error_m",)).runs(0, np.array([[0.5, 0.5]]))
    assert [row[-1] for row in found.rows] == [tripped] and not found.refused


@pytest.mark.slow
def test_errors_of_a_run_that_trips_include_the_time_after_it_unlike_a_report():
    """A sample of delay that the controller does not know makes the loop unstable."""
    waveform = dict(waveform__type="sine", waveform__frequency=20.0, waveform__amplitude=5e-6, waveform__offset=5e-6)
    configuration = load_configuration("kim2009").override("plant_simulator", dynamics__delay=1.0 / 3000.0)
    one = single_axis(configuration.override("reference_generator", **waveform)).with_duration(0.3)
    variations = parse_variations(["plant_simulator.sensor.offset=0m,1e-12m"], one)
    point = np.array([0.5])
    ((error, tripped),) = Study(one, variations, ("rms_error_m",)).runs(0, point[np.newaxis]).rows
    run = simulate(varied(one, variations, point))
    assert tripped and error == pytest.approx(np.sqrt(np.mean((run["reference"] - run["displacement"]) ** 2)), rel=0.1)
    assert compute_metrics(run)["rms_error_m"] < 0.6 * error
