# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Injected faults: each follows its description, is refused where it has no meaning, and repeats bit for bit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from loop_support import HOLD, assert_same_bits, axis, parameters

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop import faults, watch
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.faults import FAULTS, fault_parameters, fault_state, parse_fault
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.sensor import generator_state, uniform

FIRST, BEYOND, COUNT = 300, 450, 700
WINDOW = slice(FIRST, BEYOND)
PRELOAD = {"plant_simulator": {"preload__force": 5.88}, "motion_controller": {"model__preload__force": 5.88}}


def run(fault, **more):
    """Return the axis, its run with a fault from sample FIRST to BEYOND, and the same run without it."""
    name, _, value = fault.partition(":")
    given = dict(HOLD, **more)
    given["plant_simulator"] = {"sensor__noise": 5e-9, **given.get("plant_simulator", {})}
    setpoints = np.full(COUNT, 5e-6)
    made = axis(**given)
    made.inject((":".join([name, "0.1", "0.05", *([value] if value else [])]),))
    return made, made.run(setpoints), axis(**given).run(setpoints)


def same_before(table, plain):
    """Refuse a fault that has an effect before it begins."""
    assert_same_bits({name: values[:FIRST] for name, values in table.items()}, plain)


def seen_as(table, expected):
    """Refuse a controller whose measurement differs from the expected one, in the window of the fault or outside."""
    measured = table["measured"].copy()
    measured[WINDOW] = expected
    np.testing.assert_array_equal(table["seen"], measured)


def lost(fault):
    _, table, plain = run(fault)
    same_before(table, plain)
    seen_as(table, math.nan)
    np.testing.assert_array_equal(np.flatnonzero(table["controller_mode"]), np.arange(FIRST, BEYOND))
    assert set(table["controller_mode"]) == {watch.RUNNING, watch.HOLDING}


def spike(fault):
    _, table, plain = run(f"{fault}:2e-6")
    same_before(table, plain)
    expected = table["measured"][WINDOW].copy()
    expected[:: faults.SPIKE_PERIOD] += 2e-6
    seen_as(table, expected)


def frozen(fault):
    _, table, plain = run(fault)
    same_before(table, plain)
    seen_as(table, table["measured"][FIRST])


def late(fault):
    for samples in (1, 7):
        _, table, plain = run(f"{fault}:{samples}")
        same_before(table, plain)
        seen_as(table, table["measured"][FIRST - samples : BEYOND - samples])
    made = axis(**HOLD, plant_simulator={"sensor__noise": 5e-9})
    made.inject((f"{fault}:0:1:4",))
    table = made.run(np.zeros(20))
    assert np.isnan(table["seen"][:4]).all()
    np.testing.assert_array_equal(table["seen"][4:], table["measured"][:-4])


def drop(fault):
    _, table, plain = run(f"{fault}:0.4")
    same_before(table, plain)
    words, gone = generator_state(1), []
    for _ in range(FIRST, BEYOND):
        gone.append(uniform(words) < 0.4)
    assert 0.25 < np.mean(gone) < 0.55
    seen_as(table, np.where(gone, math.nan, table["measured"][WINDOW]))
    assert np.isnan(run(f"{fault}:1")[1]["seen"][WINDOW]).all()
    assert_same_bits(*run(f"{fault}:0")[1:])


def offset(fault):
    _, table, plain = run(f"{fault}:-3e-7")
    same_before(table, plain)
    seen_as(table, table["measured"][WINDOW] + -3e-7)


def disorder(fault):
    _, table, plain = run(fault)
    same_before(table, plain)
    expected = table["measured"][WINDOW].copy()
    expected[1::2] = math.nan  # the previous measurement with its old stamp is not used
    seen_as(table, expected)


def unanswered(fault):
    from hysteresis_ros.loop.controller import UNFOLLOWED_SAMPLES

    quick = {node: dict(values, safe_slew_rate=1.0) for node, values in PRELOAD.items()}
    made, table, plain = run(fault, **quick)
    same_before(table, plain)
    following = np.arange(FIRST + UNFOLLOWED_SAMPLES, BEYOND + 1)
    np.testing.assert_array_equal(np.flatnonzero(table["controller_mode"] == watch.FOLLOWING), following)
    offset = made.controller.parameters.model.preload.offset
    assert offset < -1e-6
    assert made.controller.parameters.safe_slew_rate == 1.0  # its step is larger than the motion of the plant
    np.testing.assert_allclose(table["command"][following], table["seen"][following] - offset, atol=1e-15)


def lost_command(fault):
    made, table, plain = run(fault, hysteresis_compensator={"command_timeout": 0.01})
    same_before(table, plain)
    np.testing.assert_array_equal(np.flatnonzero(table["compensator_mode"] == watch.HOLDING), FIRST + np.arange(29))
    np.testing.assert_array_equal(
        np.flatnonzero(table["compensator_mode"] == watch.STALE), np.arange(FIRST + 29, BEYOND)
    )
    assert np.ptp(table["voltage"][FIRST - 1 : FIRST + 29]) <= 150.0 / (2**16 - 1)


def lost_voltage(fault):
    _, table, plain = run(fault)
    same_before(table, plain)
    np.testing.assert_array_equal(table["plant_voltage"][WINDOW], table["plant_voltage"][FIRST - 1])
    np.testing.assert_array_equal(table["late"][FIRST - 1 : BEYOND + 1], [*range(151), 150])
    assert set(table["plant_mode"][WINDOW]) == {watch.HOLDING}


def late_voltage(fault):
    _, table, plain = run(f"{fault}:0.2")
    same_before(table, plain)
    missed = np.diff(table["late"]) > 0
    assert 15 < np.count_nonzero(missed) < 45 and not missed[: FIRST - 1].any() and not missed[BEYOND - 1 :].any()
    held = np.flatnonzero(missed) + 1
    np.testing.assert_array_equal(table["plant_voltage"][held], table["plant_voltage"][held - 1])
    kept = np.setdiff1d(np.arange(COUNT), held)
    np.testing.assert_array_equal(table["plant_voltage"][kept], table["voltage"][kept])


def lost_grip(fault):
    plain, weak = axis("inchworm_travel"), axis("inchworm_travel")
    weak.inject((f"{fault}:0.02:0.01:0.4",))
    zeros = np.zeros(400)
    before, table = plain.run(zeros), weak.run(zeros)
    changed = np.flatnonzero(table["front_force"] != before["front_force"])
    # the measurement of sample k is taken before its fault affects the following samples
    np.testing.assert_array_equal(changed, np.arange(201, 301))
    assert np.median(table["front_force"][201:301] / before["front_force"][201:301]) == pytest.approx(0.4, rel=0.05)
    np.testing.assert_allclose(table["rear_force"], before["rear_force"], rtol=0.05)


def lost_force(fault):
    made = axis("stage700")
    made.inject((f"{fault}:0.005:0.01",))
    table = made.run(np.full(400, 4e-6))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(table["force"])), np.arange(100, 300))
    # a controller whose damping does not need the force is not affected
    plain = axis("stage700").run(np.full(400, 4e-6))
    assert_same_bits({name: values for name, values in table.items() if name != "force"}, plain)


def stop(fault):
    _, table, plain = run(fault)
    same_before(table, plain)
    np.testing.assert_array_equal(np.flatnonzero(table["controller_mode"] == watch.STOPPED), np.arange(FIRST, BEYOND))
    assert set(np.delete(table["controller_mode"], np.arange(FIRST, BEYOND))) == {watch.RUNNING}


CASES = {
    "stale": lost,
    "nan": lost,
    "spike": spike,
    "frozen": frozen,
    "late": late,
    "drop": drop,
    "offset": offset,
    "disorder": disorder,
    "unanswered": unanswered,
    "lost_command": lost_command,
    "lost_voltage": lost_voltage,
    "late_voltage": late_voltage,
    "lost_grip": lost_grip,
    "lost_force": lost_force,
    "stop": stop,
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_does_what_its_description_says(name):
    assert FAULTS[name].description
    CASES[name](name)


@pytest.mark.slow
def test_a_sequencer_and_a_controller_miss_the_same_measurements():
    made = axis("inchworm_travel")
    made.inject(("drop:0:0.05:0.5",))
    for _ in range(500):
        made.run(np.zeros(1))
        own, other = made.controller.arrays.watch_x.faults, made.source.arrays.x.faults
        np.testing.assert_array_equal(own[faults.GENERATOR : faults.RING], other[faults.GENERATOR : faults.RING])


def test_faults_add_up_in_the_order_they_are_given():
    p = fault_parameters(("offset:0:1:2", "spike:0.2:1:10", "frozen:0.5:1"), (faults.MEASUREMENT,), 10.0)
    x = fault_state(p)
    given = []
    for k in range(12):
        faults.begin_sample(x)
        given.append(faults.corrupt(p, x, faults.MEASUREMENT, float(k)))
    np.testing.assert_array_equal(given, [2, 3, 14, 5, 6, 5, 5, 5, 5, 5, 5, 5])


def test_a_part_is_given_only_faults_of_what_it_takes_in():
    every = tuple(f"{name}:0:1" for name in FAULTS)
    made = axis("inchworm_travel")
    made.inject(every)
    targets = {
        "controller": {faults.MEASUREMENT, faults.APPLIED, faults.STOP},
        "compensator": {faults.COMMAND},
        "plant": {faults.VOLTAGE, faults.GRIP, faults.FORCE},
    }
    arrays = {name: getattr(made, name).arrays.watch_p.faults for name in targets}
    targets["source"], arrays["source"] = {faults.MEASUREMENT}, made.source.arrays.p.faults
    for name, expected in targets.items():
        p = arrays[name]
        entries = p[faults.ENTRIES :].reshape(-1, faults.ENTRY)
        assert len(entries) == p[faults.COUNT] == sum(FAULTS[f].target in expected for f in FAULTS), name
        assert set(entries[:, faults.TARGET]) == expected, name


# ------------------------------------------------------------------------------------------------------ what is refused

WRONG = [
    ("stal:0.1:0.1", "there is no fault 'stal'; did you mean stale? there are: stale, nan"),
    ("xyzzyx:0.1:0.1", "there is no fault 'xyzzyx'; there are: stale"),
    ("stale", "write NAME:START:DURATION[:VALUE]"),
    ("stale:0.1", "write NAME:START:DURATION[:VALUE]"),
    ("stale:a:0.1", "write NAME:START:DURATION[:VALUE]"),
    ("stale:nan:0.1", "write NAME:START:DURATION[:VALUE]"),
    ("stale:0:inf", "write NAME:START:DURATION[:VALUE]"),
    ("spike:0:1:1:1", "write NAME:START:DURATION[:VALUE]"),
    ("stale:-0.1:0.1", "START must be ≥ 0"),
    ("stale:0.1:0", "DURATION > 0"),
    ("stale:0.1:1e-4", "DURATION is shorter than a sample; give at least 0.000333333 s"),
    ("stale:0:1:5", "stale has no VALUE; write stale:START:DURATION"),
    ("drop:0:1:1.5", "VALUE must be within 0 … 1"),
    ("late:0:1:0", "VALUE must be within 1 … 10000 samples"),
    ("late:0:1:2.5", "VALUE must be within 1 … 10000 samples"),
    ("lost_grip:0:1", "only an inchworm motor can have this fault"),
]


def hysteresis(*words):
    """Return the exit code and the lines of a command."""
    answer = CliRunner().invoke(main, [str(word) for word in words])
    return answer.exit_code, answer.output.splitlines()


@pytest.mark.parametrize(("text", "said"), WRONG)
def test_a_wrong_fault_gets_one_line_and_exit_code_2(tmp_path, text, said):
    code, lines = hysteresis("simulate", "kim2009", "-o", tmp_path / "x.npz", "--fault", text)
    assert code == 2 and len(lines) == 1 and said in lines[0] and f"'{text}'" in lines[0], lines
    assert not (tmp_path / "x.npz").exists()


@pytest.mark.parametrize(("text", "said"), [WRONG[0], WRONG[2], WRONG[-1]])
def test_up_refuses_a_wrong_fault_before_it_starts_anything(text, said, monkeypatch):
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
    import signal

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    code, lines = hysteresis("up", "kim2009", "--fault", text)
    assert code == 2 and len(lines) == 1 and said in lines[0], lines


def test_simulate_says_what_each_time_out_means_and_what_the_parts_did(tmp_path):
    words = ("--duration", "0.6", "--fault", "stale:0.1:0.3")
    code, lines = hysteresis("simulate", "kim2009", "-o", tmp_path / "x.npz", *words)
    text = "\n".join(lines)
    assert code == 0, text
    assert "motion_controller measurement_timeout = 0.2 s = 600 samples: without a usable measurement" in text
    assert "hysteresis_compensator command_timeout = 0.4 s = 1200 samples" in text
    assert "plant_simulator late_limit = 1500: more than 1500 late voltages in a row or within 3000 samples" in text
    assert "controller: holding from 0.1 to 0.299333 s (599 samples)" in text
    assert "controller: stale from 0.299667 to 0.399667 s (301 samples)" in text


def configuration_of(text: str):
    return single_axis(parse_configuration(text, "axis.yaml"))


def test_faults_stand_in_a_configuration_once_for_all_nodes():
    given = parameters(every={"faults": ["stale:0.01:0.02"]})
    assert given.motion_controller.faults == given.plant_simulator.faults == ("stale:0.01:0.02",)
    table = simulate(given, duration=0.05)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(table["seen"])), np.arange(30, 90))
    assert configuration_of(given.configuration_text()).plant_simulator.faults == ("stale:0.01:0.02",)
    assert given.with_faults(()) == parameters()


@pytest.mark.parametrize(
    ("node", "values", "name", "said"),
    [
        ("motion_controller", {"faults": ["stale:0:1"]}, "motion_controller: faults", "give it once, under '/**'"),
        ("every", {"faults": ["frosen:0:1"]}, "faults", "did you mean frozen?"),
        ("every", {"faults": ["lost_grip:0:1"]}, "faults", "only an inchworm motor can have this fault"),
        ("every", {"faults": ["stale:0:0.0001"]}, "faults", "shorter than a sample"),
    ],
)
def test_faults_that_differ_or_make_no_sense_are_refused_by_name(node, values, name, said):
    with pytest.raises(ParameterError) as error:
        parameters(**{node: values})
    assert any(name in problem.name and said in problem.remedy for problem in error.value.problems), str(error.value)


@pytest.mark.parametrize(
    ("name", "node", "timeout"),
    [
        ("picma_stage", "motion_controller", "measurement_timeout"),
        ("picma_stage", "hysteresis_compensator", "command_timeout"),
        ("picma_stage", "plant_simulator", "voltage_timeout"),
    ],
)
def test_a_time_out_shorter_than_a_sample_is_refused_by_name(name, node, timeout):
    with pytest.raises(ParameterError) as error:
        parameters(name, **{node: {timeout: 0.004}})
    (problem,) = error.value.problems
    assert problem.name == f"{node}: {timeout}" and "must be at least one sample, 0.005 s" in problem.remedy
    assert getattr(getattr(parameters(name, **{node: {timeout: 0.005}}), node), timeout) == 0.005


def test_two_sources_of_the_reference_are_refused():
    text = parameters("inchworm_travel").configuration_text()
    with pytest.raises(ConfigurationError, match="two reference generators"):
        configuration_of(text + "\n/reference_generator:\n  ros__parameters:\n    minimum: 0.0\n")


@pytest.mark.parametrize(
    ("space", "said"), [("", "one axis without a namespace: omit --namespace"), ("/left", "it has /left")]
)
def test_a_namespace_that_is_not_in_the_file_is_refused(space, said):
    text = replace(parameters("kim2009"), namespace=space).configuration_text()
    driven = parse_configuration(text, "axis.yaml").override("reference_generator", waveform__type="hold")
    with pytest.raises(ConfigurationError, match=f"axis.yaml: has no axis in namespace '/foo'; .*{said}"):
        single_axis(driven, "foo")


# --------------------------------------------------------------------------------------------------------- bit for bit

EVERYTHING = tuple(
    f"{name}:{0.002 + 0.004 * number}:0.01" for number, name in enumerate(FAULTS) if not FAULTS[name].motor
)


@pytest.mark.parametrize(("name", "more"), [("kim2009", HOLD), ("inchworm_travel", {})])
def test_a_run_with_faults_repeats_bit_for_bit_and_may_be_cut_in_pieces(name, more):
    made = axis(name, **more, every={"faults": [*EVERYTHING]})
    setpoints = 4e-6 * (np.arange(600) > 100)
    whole = made.run(setpoints)
    made.reset()
    first = 0
    for piece in np.split(setpoints, [1, 2, 133, 407]):
        assert_same_bits(made.run(piece), whole, first)
        first += len(piece)
    assert_same_bits(Axis(made.parameters).run(setpoints), whole)
    assert {watch.RUNNING, watch.HOLDING, watch.STOPPED} <= set(whole["controller_mode"])


def test_injected_faults_count_from_now_replace_those_before_and_equal_configured_ones():
    made = axis(**HOLD)
    made.run(np.zeros(100))
    made.inject(("stale:0.01:0.01",))
    table = made.run(np.full(100, 1e-6))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(table["seen"])), np.arange(30, 60))
    made.inject(("stale:0:0.01",))
    made.inject(("disorder:0:0.01",))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(made.run(np.zeros(60))["seen"])), np.arange(1, 30, 2))
    made.inject(())
    assert not np.isnan(made.run(np.zeros(100))["seen"]).any()
    fresh = axis(**HOLD)
    fresh.inject(EVERYTHING)
    assert_same_bits(
        fresh.run(np.full(300, 2e-6)), axis(**HOLD, every={"faults": [*EVERYTHING]}).run(np.full(300, 2e-6))
    )


def test_a_reset_begins_the_faults_anew():
    made = axis(**HOLD, every={"faults": ["drop:0.01:0.02:0.5", "late_voltage:0.01:0.02:0.5"]})
    first = made.run(np.full(200, 1e-6))
    made.reset()
    assert_same_bits(made.run(np.full(200, 1e-6)), first)


def test_a_fault_lasts_as_many_samples_as_it_says():
    p = fault_parameters(("stale:0.1:0.05", "offset:0:0.0004"), (faults.MEASUREMENT,), 3000.0)
    entries = p[faults.ENTRIES :].reshape(2, faults.ENTRY)
    assert entries[0, faults.FIRST] == 300 and entries[0, faults.BEYOND] == 450
    assert entries[1, faults.FIRST] == 0 and entries[1, faults.BEYOND] == 1
    assert entries[1, faults.VALUE] == FAULTS["offset"].value == parse_fault("offset:0:1").value
