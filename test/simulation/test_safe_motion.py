# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Limited steps: the largest step of the voltage is the one that a file states, and written files state limits."""

from __future__ import annotations

import pathlib
import re

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from safe_motion_support import NODES, quantum, stated, steps

from hysteresis_ros.cli.commissioning.new_file import NewAxis, new_text
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.designs import setpoint_step as stepping
from hysteresis_ros.designs.controller import DesignRequest, design_axis, design_file
from hysteresis_ros.designs.coupled import controllers_file, design_controllers
from hysteresis_ros.designs.setpoint_step import overshoot_of, require_gentle, setpoint_step, step_lines
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.safe_motion import (
    largest_change,
    safe_approach,
    safe_slew,
    slowest_of,
    with_safe_motion,
)
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.models.linear import zero_order_hold

RATE = 2000.0
CONFIGURATIONS = sorted(path.stem for path in (pathlib.Path(__file__).resolve().parents[2] / "config").glob("*.yaml"))
#: Walking motors: a sequencer generates their references.
WALKING = ("inchworm_travel",)
#: Stages of coupled axes, which are not single axes.
COUPLED = ("steering_mirror", "xy_scanner")
#: A flexure stage, 380 Hz with 1.5 % damping, 100 µm over 150 V, without stated limits of motion.
A, B = zero_order_hold(
    [[0.0, 1.0], [-((2 * np.pi * 380.0) ** 2), -2 * 0.015 * 2 * np.pi * 380.0]],
    [[0.0], [(2 * np.pi * 380.0) ** 2]],
    1 / RATE,
)
DYNAMICS = (
    f"{{A: {np.ravel(A).tolist()}, B: {np.ravel(B).tolist()}, C: [1.0, 0.0], sample_time: 0.0005, delay: 0.0005}}"
)
MODEL = "{type: proportional, proportional: {gain: 6.667e-07}}"
FLEXURE = f"""\
# A stage.
/**:
  ros__parameters: {{sample_rate: 2000.0, joint: stage}}
/**/plant_simulator:
  ros__parameters:
    limits: {{minimum: 0.0, maximum: 150.0}}   # V
    hysteresis: {MODEL}
    dynamics: {DYNAMICS}
/**/hysteresis_compensator:
  ros__parameters:
    hysteresis: {MODEL}
    limits:
      minimum: 0.0
      maximum: 150.0   # V
    inverse: {{type: exact}}
/**/motion_controller:
  ros__parameters:
    type: open_loop
    model:
      dynamics: {DYNAMICS}
/**/reference_generator:
  ros__parameters:
    minimum: 0.0
    maximum: 99.0e-6
"""


def designed(text: str, controller: str = "pid", **asked) -> str:
    """Return the file of a design."""
    configuration = parse_configuration(text, "stage.yaml")
    result = design_axis(single_axis(configuration), DesignRequest(controller, **asked))
    return design_file(configuration, result, "")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CONFIGURATIONS if name not in WALKING + COUPLED])
@pytest.mark.parametrize("bare", [False, True])
def test_the_largest_step_of_a_shipped_configuration_is_within_what_its_file_states(name, bare):
    configuration = load_configuration(name)
    allowed = stated(configuration.text, single_axis(configuration))
    largest = np.max(np.abs(np.diff(steps(configuration, bare))))
    assert 0.0 < largest <= allowed + 1e-9 + 2.0 * quantum(configuration)


@pytest.mark.slow
@pytest.mark.parametrize("name", COUPLED)
def test_the_largest_step_of_a_shipped_stage_is_within_what_its_file_states(name):
    configuration = load_configuration(name)
    stage = StageParameters.from_configuration(configuration).scanning([])
    for moved, axis in zip(stage.names, stage.axes, strict=True):
        own = axis.reference_generator
        target = max((own.minimum, own.maximum), key=lambda end: abs(end - own.initial_setpoint))
        setpoints = np.full(400, target)
        setpoints[:20] = own.initial_setpoint
        run = simulate_stage(stage, setpoints={moved: setpoints})
        for other, one in zip(stage.names, stage.axes, strict=True):
            limits = one.hysteresis_compensator.limits
            bit = (limits.maximum - limits.minimum) / (2**limits.bits - 1)
            largest = np.max(np.abs(np.diff(run[f"{other}/voltage"])))
            assert largest <= stated(configuration.text, one) + 2.0 * bit
            assert largest > 0.0 or other != moved


@pytest.mark.slow
def test_a_designed_stage_states_limits_from_the_lowest_mode_of_its_structure():
    text = load_configuration("xy_scanner").text
    bare = re.sub(r"^ +slew_rate: .*\n|^    approach:.*\n(?:      .*\n)+", "", text, flags=re.MULTILINE)
    configuration = parse_configuration(bare, "stage.yaml")
    before = StageParameters.from_configuration(configuration)
    assert not any(axis.hysteresis_compensator.limits.slew_rate for axis in before.axes)
    designs = design_controllers(before, DesignRequest("pid", damping="none"), {})
    written = controllers_file(configuration, designs, "--controller pid")
    assert "V/s: the range in one period of the resonance, 700 Hz" in written
    for axis in StageParameters.from_configuration(parse_configuration(written, "designed.yaml")).axes:
        for node in (axis.plant_simulator, axis.hysteresis_compensator):
            assert node.limits.slew_rate == pytest.approx(700.0 * (node.limits.maximum - node.limits.minimum), rel=0.01)
        approach, own = axis.reference_generator.approach, axis.reference_generator
        assert approach.maximum_velocity == pytest.approx(0.5 * 700.0 * (own.maximum - own.minimum), rel=0.01)
        # each average lasts one period of 700 Hz
        assert 2.0 * approach.maximum_velocity / approach.maximum_acceleration == pytest.approx(1 / 700.0, rel=0.01)


@pytest.mark.slow
def test_a_designed_stage_begins_at_rest_unless_its_file_says_otherwise():
    """A single axis is not changed; an axis that no controller was designed for belongs to the stage too."""
    configuration = load_configuration("xy_scanner")
    stage = StageParameters.from_configuration(configuration)
    assert not any(axis.generator.approach.from_rest for axis in stage.axes)
    designs = design_controllers(stage, DesignRequest(controller="pid"), {}, "x")
    found = parse_configuration(controllers_file(configuration, designs, "--controller pid"), "designed")
    assert all(axis.generator.approach.from_rest for axis in StageParameters.from_configuration(found).axes)
    assert found.text.count("from_rest: true  # the first motion, from rest to the initial setpoint") == 2
    stated = configuration.text.replace("    approach: ", "    approach:\n      from_rest: false")
    kept = parse_configuration(stated, "stated")
    assert controllers_file(kept, designs, "--controller pid").count("from_rest: false") == 1
    assert "from_rest: true" not in controllers_file(kept, designs, "--controller pid")
    assert "from_rest" not in designed(load_configuration("kim2009").text)


@pytest.mark.parametrize("name", WALKING)
def test_a_motor_that_walks_keeps_what_its_file_states_extender_and_clamps(name):
    configuration = load_configuration(name)
    axis = single_axis(configuration)
    run = simulate(axis, duration=0.4, describe=False)
    assert np.ptp(run["displacement"]) > 50e-6, "the motor walks"
    largest = {signal: np.max(np.abs(np.diff(run[signal]))) for signal in ("voltage", "front_voltage", "rear_voltage")}
    assert 0.0 < largest["voltage"] <= stated(configuration.text, axis) + 2.0 * quantum(configuration)
    said = {float(value) for value in re.findall(r"ramps slew: a sample may step by ([0-9.]+) V", configuration.text)}
    assert len(said) == 1 and 0.0 < max(largest["front_voltage"], largest["rear_voltage"]) <= said.pop()


@pytest.mark.slow
def test_a_designed_file_limits_the_bare_step_and_the_setpoint_does_not_hit_the_stage():
    before = parse_configuration(FLEXURE, "stage.yaml")
    text = designed(FLEXURE, feedforward=True)
    configuration = parse_configuration(text, "designed.yaml")
    axis = single_axis(configuration)
    # the range in one period of 380 Hz: 28.5 V in a sample of 0.5 ms
    rate = pytest.approx(150.0 * 380.0, rel=5e-3)
    assert axis.plant_simulator.limits.slew_rate == rate and axis.hysteresis_compensator.limits.slew_rate == rate
    assert np.max(np.abs(np.diff(steps(configuration, bare=True)))) <= 28.5 * 1.005
    found = setpoint_step(axis)
    assert found.share < 1.0 and found.largest == found.asked < 0.75 * 28.5 and found.overshoot < 0.03
    # without the limits the same controller causes a large step
    bare = before.override("motion_controller", **configuration.node("motion_controller"))
    hit = setpoint_step(single_axis(bare))
    assert hit.largest > 100.0 and hit.overshoot > 0.2
    assert [line.split("  ")[0] for line in step_lines(text, None, True)] == [row[0] for row in found.rows()]


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "preview"), [("steps", None), ("square", None), ("square", 0)])
def test_generated_steps_of_a_designed_feedforward_keep_the_approach_as_setpoints_do(shape, preview):
    configuration = parse_configuration(designed(FLEXURE, feedforward=True, preview=preview), "designed.yaml")
    levels = {"waveform.steps.values": [0.0, 30e-6], "waveform.steps.times": [0.0, 0.05]}
    waveform = {"waveform.type": shape, "waveform.amplitude": 30e-6, "waveform.frequency": 5.0, **levels}
    run = simulate(single_axis(configuration.override("reference_generator", **waveform)), duration=0.3, describe=False)
    # without the approach they overshot by 18 %, and the slew rate saturated
    assert np.max(run["displacement"]) < 1.01 * 30e-6 and np.max(np.abs(np.diff(run["voltage"]))) < 0.5 * 28.5
    assert "approach" not in FLEXURE and configuration.node("reference_generator")["approach.steps"] is True
    # a file with its own approach keeps it
    own = FLEXURE.replace("    maximum: 99.0e-6\n", "    maximum: 99.0e-6\n    approach: {maximum_velocity: 0.01}\n")
    stated = parse_configuration(designed(own, feedforward=True), "own.yaml").node("reference_generator")
    assert stated["approach.steps"] is True and stated["approach.maximum_velocity"] == 0.01
    bare = configuration.override("reference_generator", **waveform, **{"approach.steps": False})
    with pytest.raises(ParameterError, match=r"set approach\.steps: true"):
        single_axis(bare)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["pid", "offset_free"])
def test_generated_steps_of_a_closed_loop_do_not_reach_the_slew_rate(controller):
    """At the slew rate a fast loop can oscillate from limit to limit, with all of its margins."""
    configuration = parse_configuration(designed(FLEXURE, controller), "designed.yaml")
    assert configuration.node("reference_generator")["approach.steps"] is True
    square = {"waveform.type": "square", "waveform.amplitude": 95e-6, "waveform.frequency": 5.0}
    configuration = configuration.override("reference_generator", **square)
    slew = single_axis(configuration).plant_simulator.limits.slew_rate / 2000.0
    largest = {
        kept: np.max(np.abs(np.diff(simulate(single_axis(chosen), duration=0.3, describe=False)["voltage"])))
        for kept in (True, False)
        for chosen in [configuration.override("reference_generator", **{"approach.steps": kept})]
    }
    assert largest[True] < 0.8 * slew and largest[False] > 0.99 * slew
    # a file that states its own choice keeps it, and so does an open loop
    own = FLEXURE.replace("    maximum: 99.0e-6\n", "    maximum: 99.0e-6\n    approach: {steps: false}\n")
    assert parse_configuration(designed(own), "own.yaml").node("reference_generator")["approach.steps"] is False
    opened = parse_configuration(with_safe_motion(FLEXURE, "open loop"), "open loop")
    assert "approach.steps" not in opened.node("reference_generator")


@pytest.mark.slow
def test_moves_are_smooth_enough_for_feedforward_by_velocity():
    """A setpoint is followed without delay and hardly overshot, and a slow sine with a fraction of the error."""
    text = designed(FLEXURE, feedforward=True, preview=0)
    configuration = parse_configuration(text, "designed.yaml")
    assert configuration.node("motion_controller")["feedforward.type"] == "velocity"
    assert "each moving average lasts at least 7 mean delays of the model, for feedforward by velocity" in text
    assert setpoint_step(single_axis(configuration)).overshoot < 0.015
    sine = {"waveform.type": "sine", "waveform.amplitude": 20e-6, "waveform.frequency": 2.0, "initial_setpoint": 45e-6}
    errors = {}
    for name, file in (("velocity", text), ("none", designed(FLEXURE))):
        axis = single_axis(parse_configuration(file, "designed.yaml").override("reference_generator", **sine))
        run = simulate(axis, duration=2.0, describe=False)
        errors[name] = np.std((run["reference"] - run["displacement"])[len(run["time"]) // 2 :])
    assert errors["velocity"] < 0.1 * errors["none"]
    # an approach that is slower already stays
    slow = FLEXURE.replace(
        "    maximum: 99.0e-6\n",
        "    maximum: 99.0e-6\n"
        "    approach: {maximum_velocity: 1e-4, maximum_acceleration: 1e-4, maximum_jerk: 1e-4}\n",
    )
    kept = parse_configuration(designed(slow, feedforward=True, preview=0), "slow.yaml").node("reference_generator")
    assert kept["approach.maximum_acceleration"] == kept["approach.maximum_jerk"] == 1e-4


@pytest.mark.slow
def test_a_feedforward_that_a_setpoint_drives_beyond_the_slew_rate_is_refused(tmp_path):
    slow = FLEXURE.replace("maximum: 150.0}", "maximum: 150.0, slew_rate: 2000.0}")
    slow = slow.replace("    maximum: 99.0e-6\n", "    maximum: 99.0e-6\n    approach: {maximum_velocity: 0.01}\n")
    text = designed(slow, feedforward=True)
    found = setpoint_step(single_axis(parse_configuration(text, "slow.yaml")))
    assert found.largest <= 1.0 + 1e-9 and found.share > 1.0
    with pytest.raises(
        ConfigurationError, match=r"inverse_dynamics: .* V in a sample, but limits.slew_rate allows 1 V"
    ):
        step_lines(text, None, True)
    # an unrequested change is reported and not refused
    assert "cut" in step_lines(text, None, False)[-1]
    # the command refuses it too, and writes nothing; without the feedforward it prints the step
    given, output = tmp_path / "slow.yaml", tmp_path / "designed.yaml"
    given.write_text(slow, encoding="utf-8")
    words = ["design", str(given), "--controller", "pid", "-o", str(output)]
    result = CliRunner().invoke(main, [*words, "--feedforward"])
    assert result.exit_code == 2 and "limits.slew_rate allows 1 V" in result.output and not output.exists()
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0 and output.exists(), result.output
    for row in ("setpoint step", "overshoot of the step", "largest voltage step", "share of the slew limit"):
        assert re.search(rf"^{row} +\S", result.output, re.MULTILINE), row


def test_limits_that_a_file_states_are_kept_comments_too_and_nothing_is_added_twice():
    text = with_safe_motion(FLEXURE, "stage.yaml")
    assert with_safe_motion(text, "stage.yaml") == text
    for line in FLEXURE.splitlines():
        assert line.removesuffix("   # V").removesuffix("}") in text
    lines = [line for line in text.splitlines() if "slew_rate" in line or "maximum_" in line]
    assert len(lines) == 5 and all("#" in line for line in lines)
    own = FLEXURE.replace("maximum: 150.0   # V", "maximum: 150.0\n      slew_rate: 3000.0")
    values = yaml.safe_load(with_safe_motion(own, "stage.yaml"))
    assert {values[f"/**/{name}"]["ros__parameters"]["limits"]["slew_rate"] for name in NODES} == {3000.0}
    zero = FLEXURE.replace("maximum: 150.0   # V", "maximum: 150.0\n      slew_rate: 0.0")
    values = yaml.safe_load(with_safe_motion(zero, "stage.yaml", amplifier=500.0))
    assert {values[f"/**/{name}"]["ros__parameters"]["limits"]["slew_rate"] for name in NODES} == {500.0}


def test_the_slew_rate_is_the_least_of_what_is_known():
    assert safe_slew(150.0).rate == 150.0
    assert safe_slew(150.0, excited=1e3).rate == 2e3 and "twice" in safe_slew(150.0, excited=1e3).reason
    # a low sample rate is no reason for a slower motion than the one used for an unknown stage
    assert safe_slew(150.0, excited=10.0).rate == 150.0
    assert safe_slew(150.0, 380.0, True, 1e6).rate == 57e3 and "380 Hz" in safe_slew(150.0, 380.0, True, 1e6).reason
    assert safe_slew(150.0, 380.0, True, 1e4, 700.0).rate == 700.0
    assert largest_change(np.array([0.0, 1.0, -2.0, np.nan, 9.0]), 0.5) == 6.0


def test_the_averages_of_the_approach_last_a_period_of_the_resonance():
    velocity, acceleration, jerk = safe_approach(57e3, 150.0, 100e-6, 380.0)
    assert velocity == pytest.approx(0.019) and 2.0 * velocity / acceleration == pytest.approx(1 / 380.0, rel=0.01)
    assert 2.0 * acceleration / jerk == pytest.approx(1 / 380.0, rel=0.01)


def test_a_new_file_limits_what_it_says():
    text = new_text(NewAxis(100e-6, 0.0, 150.0, RATE))
    own = yaml.safe_load(text)["/**/reference_generator"]["ros__parameters"]["approach"]
    assert all(value > 0.0 for value in own.values()) and len(own) == 3 and "Resonances are unknown" in text
    assert np.max(np.abs(np.diff(steps(parse_configuration(text, "new.yaml"), bare=True)))) <= 150.0 / RATE + 1e-12


def test_a_design_does_not_refuse_gentle_steps_and_walkers_have_none():
    require_gentle(None)
    require_gentle(setpoint_step(single_axis(parse_configuration(designed(FLEXURE), "designed.yaml"))))
    assert step_lines(load_configuration("inchworm_travel").text, None, True) == []


def test_a_resonance_goes_before_a_lag_and_of_lags_the_slowest_counts():
    assert slowest_of(np.diag([0.5, 0.9]), 1 / RATE) == (pytest.approx(-np.log(0.9) * RATE), False)
    # a lag of 211/s, slower than the resonance, of which a model of the plant alone knows nothing
    lag = "{A: [0.9], B: [0.1], C: [1.0], sample_time: 0.0005}"
    for plant in (f"    dynamics: {lag}\n", ""):
        text = with_safe_motion(FLEXURE.replace(f"    dynamics: {DYNAMICS}\n", plant, 1), "stage.yaml")
        assert text.count("slew_rate: 57000.0") == 2 and "the resonance, 380 Hz" in text
    lags = with_safe_motion(FLEXURE.replace(DYNAMICS, lag), "stage.yaml")
    assert "the lag of the model, 4.75 ms" in lags and lags.count("slew_rate: 31600.0") == 2


def test_the_approach_is_for_the_range_between_both_ends_and_a_stated_limit_is_kept_alone():
    text = with_safe_motion(FLEXURE.replace("minimum: 0.0\n    maximum: 99", "minimum: 39.0e-6\n    maximum: 99"), "a")
    own = yaml.safe_load(text)["/**/reference_generator"]["ros__parameters"]["approach"]
    # half of 57000 V/s, of 150 V for 60 µm
    assert own["maximum_velocity"] == pytest.approx(0.5 * 57000.0 * 60e-6 / 150.0)
    limited = FLEXURE.replace("    maximum: 99.0e-6\n", "    maximum: 99.0e-6\n    approach: {maximum_jerk: 5.0}\n")
    own = yaml.safe_load(with_safe_motion(limited, "a"))["/**/reference_generator"]["ros__parameters"]["approach"]
    assert own == {"maximum_jerk": 5.0}


def test_of_two_stated_slew_rates_the_slower_one_is_the_limit_of_the_approach():
    two = FLEXURE.replace("maximum: 150.0}", "maximum: 150.0, slew_rate: 2000.0}")
    two = two.replace("maximum: 150.0   # V", "maximum: 150.0\n      slew_rate: 3000.0")
    values = yaml.safe_load(with_safe_motion(two, "a"))
    assert values["/**/plant_simulator"]["ros__parameters"]["limits"]["slew_rate"] == 2000.0
    velocity = values["/**/reference_generator"]["ros__parameters"]["approach"]["maximum_velocity"]
    assert velocity == pytest.approx(0.5 * 2000.0 * 99e-6 / 150.0)


@pytest.mark.parametrize(("start", "size"), [(0.0, 99e-6), (70e-6, 70e-6), (30e-6, 69e-6)])
def test_the_step_of_a_file_is_that_to_the_farther_end_at_the_slower_slew_rate(monkeypatch, start, size):
    run = {"displacement": np.array([start, 50e-6]), "voltage": np.array([0.0, 1.0])}
    heard = []
    monkeypatch.setattr(stepping, "simulate", lambda axis, setpoints, describe: heard.append(setpoints) or run)
    configuration = parse_configuration(FLEXURE, "a").override("reference_generator", initial_setpoint=start)
    for plant, own in ((2000.0, 3000.0), (3000.0, 2000.0), (0.0, 2000.0)):
        nodes = zip(("plant_simulator", "hysteresis_compensator"), (plant, own), strict=True)
        limited = configuration
        for node, rate in nodes:
            limited = limited.override(node, limits__slew_rate=rate)
        found = setpoint_step(single_axis(limited))
        assert found.size == pytest.approx(size) and abs(heard[-1][-1] - heard[-1][0]) == pytest.approx(size)
        assert found.allowed == pytest.approx(2000.0 / RATE)


@pytest.mark.parametrize("move", [1e-6, -1e-6])
@pytest.mark.parametrize("damping", [0.1, 0.4])
def test_the_overshoot_of_a_step_is_that_of_its_damping_in_both_directions(move, damping):
    turn = np.sqrt(1.0 - damping**2)
    time = np.linspace(0.0, 20.0 / damping, 20001)
    step = 1.0 - np.exp(-damping * time) * (np.cos(turn * time) + damping / turn * np.sin(turn * time))
    assert overshoot_of(3e-6 + move * step, move) == pytest.approx(np.exp(-np.pi * damping / turn), rel=1e-3)
