# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Moves over ROS: predicted, measured, refused; on topics, by the command and along a trajectory."""

from __future__ import annotations

import json
import math
import re
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import InProcess, Observer, axis_parameters, compose, until  # noqa: E402
from rcl_interfaces.srv import SetParametersAtomically  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from std_msgs.msg import Bool, Float64, String  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.loop.reach import single_axis  # noqa: E402
from hysteresis_ros.nodes.ready import WAITING, MoveToReady, ReadyTopics  # noqa: E402
from hysteresis_ros.nodes.remote import commands  # noqa: E402
from hysteresis_ros.nodes.remote.__main__ import done  # noqa: E402
from hysteresis_ros.nodes.remote.client import AbsentError, Client  # noqa: E402
from hysteresis_ros.nodes.remote.commands import call, move, set_, setpoint  # noqa: E402
from hysteresis_ros.references.moves import Noise  # noqa: E402

RATE, NOISE = 1000.0, 3e-9
LAG = {"A": (0.7,), "B": (0.3,), "C": (1.0,)}
PI = {"type": "pid", "pid__Ki": 80.0, "pid__Kp": 0.1}
OVERRIDES = {
    "plant_simulator": {"sensor__noise": NOISE, **{f"dynamics__{name}": matrix for name, matrix in LAG.items()}},
    "motion_controller": {**PI, **{f"model__dynamics__{name}": matrix for name, matrix in LAG.items()}},
}
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module")
def axis(domain_of_module):
    """A composed axis in lockstep, whose noise is known."""
    inside = InProcess(domain_of_module)
    *_, source = compose(inside, axis_parameters("/left", OVERRIDES, sample_rate=RATE, time_mode="lockstep"))
    inside.spin()
    until(lambda: source.ready.noise is not None)
    yield inside
    inside.close()


@pytest.fixture(scope="module")
def heard(domain_of_module):
    """Messages of the topics."""
    observer = Observer(domain_of_module)
    kinds = {"ready": Bool, "ready_in": Float64, "reference_generator/moves": String}
    yield {
        name: observer.listen(kind, f"/left/{name}", LATCHED if "/" not in name else 10) for name, kind in kinds.items()
    }
    observer.close()


@pytest.fixture
def client(axis):
    with Client("left", timeout=120.0, context=axis.context) as made:
        yield made


def source(axis):
    return next(one for one in axis.nodes if one.kind == "reference_generator")


def said(heard, name: str) -> list[float]:
    """Values of a key in the states of the moves so far."""
    entries = [json.loads(message.data) for message in heard["reference_generator/moves"]]
    return [entry[name] for entry in entries if name in entry]


def test_a_move_is_predicted_and_then_measured(axis, heard, client, capsys):
    until(lambda: heard["ready"])
    assert move(client, 5e-6, 20e-9, 0.02) == 0
    until(lambda: said(heard, "ready") and said(heard, "predicted"))
    predicted, measured = said(heard, "predicted")[-1], said(heard, "ready")[-1]
    assert 0.02 < measured < 0.2 and abs(predicted - measured) <= max(0.1 * measured, 3.0 / RATE)
    until(lambda: heard["ready"][-1].data and heard["ready_in"][-1].data == 0.0)
    words = capsys.readouterr().out
    assert "ready in " in words and ", predicted" in words and "measured, " in words
    assert source(axis).setpoint == 5e-6


@pytest.mark.parametrize(
    ("value", "tolerance", "dwell", "words"),
    [
        (6e-6, 1e-10, None, r"tolerance 0.1 nm refused: .* within \S+ nm of its mean during 99 % .*; give at least"),
        (6e-6, 20e-9, -1.0, "dwell -1 s refused"),
        (50e-6, 20e-9, None, r"setpoint 50 µm refused: out of range, allowed: 0 … 12 µm"),
    ],
)
def test_a_move_that_cannot_become_ready_moves_nothing(axis, client, value, tolerance, dwell, words):
    kept = source(axis).setpoint
    with pytest.raises(HysteresisError, match=words):
        move(client, value, tolerance, dwell)
    assert source(axis).setpoint == kept


def test_a_tolerance_of_the_axis_holds_for_setpoints_and_the_deadband_for_moves(axis, heard, client, capsys):
    set_(client, "reference_generator", {"ready.tolerance": "20nm", "ready.deadband": "50nm"})
    known = len(said(heard, "ready"))
    setpoint(client, 8e-6)
    until(lambda: len(said(heard, "ready")) > known and source(axis).ready.move.done)
    until(lambda: len(said(heard, "predicted")) == len(said(heard, "setpoint")))  # it may come after the move
    known = len(said(heard, "move"))
    assert move(client, 8.03e-6, None, None) == 0
    assert "within ready.deadband = 50 nm" in capsys.readouterr().out
    assert source(axis).setpoint == 8e-6 and len(said(heard, "move")) == known
    set_(client, "reference_generator", {"ready.tolerance": "0", "ready.deadband": "0"})
    assert move(client, 7e-6, None, None) == 0
    permitted = 2.0 * source(axis).ready.noise.least_tolerance
    assert re.search(r"predicted; tolerance \d\S* nm\nready after", capsys.readouterr().out)
    assert said(heard, "tolerance")[-1] == pytest.approx(permitted, rel=0.5)


@pytest.mark.parametrize("node", ["motion_controller", "hysteresis_compensator"])
def test_a_setpoint_that_a_stopped_node_does_not_follow_is_an_error(axis, client, node):
    call(client, f"/left/{node}", "stop")
    try:
        for send in (setpoint, partial(move, tolerance=20e-9, dwell=None)):
            with pytest.raises(
                HysteresisError, match=f"has the setpoint but /left/{node} is stopped: `hysteresis call"
            ):
                send(client, value=6e-6)
    finally:
        call(client, f"/left/{node}", "start")


def test_a_refused_move_ends_with_exit_code_2(axis, client, capsys):
    given = {"value": 6e-6, "tolerance": 1e-12, "dwell": None}
    assert done({"command": "move", "namespace": "left", "timeout": 60.0, **given}, lambda *_: nullcontext(client)) == 2
    assert "tolerance 0.001 nm refused" in capsys.readouterr().err


class Monitor:
    """The topics of a node without a graph, whose predictor is replaced and whose thread works when it is told to."""

    def __init__(self, fused: bool = False):
        self.said, self.told = [], {"ready": None, "ready_in": None}
        own = axis_parameters("/left", OVERRIDES, sample_rate=RATE, time_mode="lockstep").generator
        self.node = SimpleNamespace(
            parameters=replace(own, ready=replace(own.ready, tolerance=20e-9, dwell=0.01)),
            publisher=lambda kind, name, qos: SimpleNamespace(publish=lambda message: self.publish(name, message)),
            subscriber=lambda *_: None,
            create_service=lambda *_: None,
            destroy_service=None,
            _topic_handles=[],
            changes_qos=lambda: None,
            is_fused=fused,
            sample=0,
            warn=lambda name, text: self.said.append({"warned": text}),
        )
        self.ready = ReadyTopics(self.node)
        self.ready._thread.run = self.run
        self.jobs, self.learned = [], []
        self.ready._stale = False
        self.ready._predictor = SimpleNamespace(
            predict=lambda *_: 0.004,
            rest_at=lambda setpoint: None,
            follow=lambda samples: None,
            learn=lambda measured, noise: self.learned.append(measured),
            resting=SimpleNamespace(displacement=0.0, error=1.0),
        )

    def publish(self, name, message):
        if name == "~/moves":
            self.said.append(json.loads(message.data))
        else:
            self.told[name] = message.data

    def run(self, job):
        self.jobs.append(job)
        return len(self.jobs) <= WAITING

    def work(self):
        while self.jobs:
            result = self.jobs.pop(0)()
            if result is not None:
                result()
        self.ready._thread.take()

    def samples(self, error, setpoint=5e-6, **values):
        """Take a sample with an error [m]."""
        row = [0.0] * len(signals.SIGNALS)
        row[signals.SETPOINT], row[signals.MEASURED] = setpoint, setpoint + error
        for name, value in values.items():
            row[getattr(signals, name)] = value
        self.ready.look(row, self.node.sample)
        self.node.sample += 1

    def entry(self, name):
        return [one[name] for one in self.said if name in one]


def test_a_move_is_replaced_stopped_and_withdrawn_while_no_samples_arrive():
    monitor = Monitor()
    monitor.ready.begin(0.0, 5e-6)
    monitor.work()
    assert (monitor.told["ready"], monitor.told["ready_in"]) == (False, 0.004)
    monitor.ready.begin(5e-6, 6e-6)
    assert monitor.entry("ended") == ["replaced"] and math.isnan(monitor.told["ready_in"])
    monitor.samples(0.0, setpoint=6e-6)
    monitor.samples(0.0, setpoint=7e-6)
    assert monitor.entry("ended")[1:] == ["the setpoint was changed without a move"]
    monitor.ready.begin(6e-6, 5e-6)
    monitor.samples(0.0, TRIPPED=1.0)
    assert monitor.entry("ended")[2:] == ["the axis was stopped"]
    for fused, ends in ((False, ["no samples arrive"]), (True, [])):
        monitor = Monitor(fused)
        monitor.node.fused = SimpleNamespace(loop=SimpleNamespace(sample=0))
        monitor.ready.begin(0.0, 5e-6)
        monitor.ready.fall_silent()
        assert monitor.entry("ended") == ends and (monitor.ready.move is None) == bool(ends)


def test_a_fused_axis_that_falls_silent_is_ready_again_when_its_samples_come():
    monitor = Monitor(fused=True)
    monitor.node.fused = SimpleNamespace(loop=SimpleNamespace(sample=0))
    monitor.ready.begin(0.0, 5e-6)
    for _ in range(15):
        monitor.samples(0.0)
    assert (monitor.told["ready"], monitor.told["ready_in"]) == (True, 0.0)
    monitor.ready.fall_silent()
    assert monitor.told["ready"] is False
    monitor.samples(0.0)
    assert monitor.told["ready"] is True
    monitor.samples(1e-6)
    assert monitor.told["ready"] is False and math.isnan(monitor.told["ready_in"])


@pytest.mark.parametrize("skipped", [0, 2])
def test_a_move_with_skipped_samples_is_counted_and_not_learned(skipped):
    monitor = Monitor()
    monitor.ready.begin(0.0, 5e-6)
    monitor.work()
    for number in range(20):
        monitor.samples(0.0, SKIPPED=float(3 <= number < 3 + skipped))
    monitor.work()
    assert monitor.entry("missing") == [skipped] and len(monitor.learned) == (not skipped)


def test_what_cannot_be_predicted_is_said_with_the_reason():
    monitor = Monitor()
    monitor.ready._predictor.predict = lambda *_: math.inf
    monitor.ready.begin(0.0, 5e-6)
    monitor.work()

    def fail(*_):
        raise HysteresisError("one line\nof two")

    monitor.ready._predictor.predict = fail
    monitor.ready.begin(5e-6, 6e-6)
    monitor.work()
    monitor.jobs = [lambda: None] * (WAITING + 1)
    monitor.ready.begin(6e-6, 5e-6)
    unknown = Monitor()
    unknown.ready._predictor = None
    unknown.ready.begin(0.0, 5e-6)
    unknown.work()
    assert "not known yet" in unknown.entry("why")[0]
    assert monitor.entry("predicted") == [None, None, None]
    kept, failed, waiting = monitor.entry("why")
    assert "does not stay within the tolerance" in kept and "one line of two" in failed and "8 moves are" in waiting
    assert "nothing is predicted: one line of two" in monitor.entry("warned")


def test_only_changes_of_the_loop_make_the_predictor_stale():
    monitor = Monitor()
    for node, action, names, stale in (
        ("reference_generator", "retune", ("ready.tolerance",), False),
        ("plant_simulator", "retune", ("sensor.noise",), False),
        ("motion_controller", "stop", (), False),
        ("reference_generator", "retune", ("shaping.frequency",), True),
        ("motion_controller", "retune", ("pid.Ki",), True),
    ):
        monitor.ready._stale = False
        entry = {"node": node, "action": action, "parameters": dict.fromkeys(names, 1.0)}
        monitor.ready._on_change(String(data=json.dumps(entry)))
        assert monitor.ready._stale is stale, entry


@pytest.mark.parametrize("whole", [False, True])
def test_the_zero_that_a_controller_subtracts_is_no_error_of_a_move(whole):
    """Every identified file has one: the axis is at its setpoint when it measures setpoint and zero."""
    monitor, zero = Monitor(), 7e-6
    entry = {"node": "motion_controller", "action": signals.CONFIGURED, "parameters": {"model.preload.A1": zero}}
    monitor.ready._on_change(String(data=json.dumps(entry)))
    monitor.ready._stale = False
    monitor.ready.begin(0.0, 5e-6)
    if whole:
        table = np.zeros((len(signals.SIGNALS), 15))
        table[signals.SETPOINT], table[signals.MEASURED] = 5e-6, 5e-6 + zero
        monitor.ready.look_at_all(0, table)
    else:
        for _ in range(15):
            monitor.samples(zero)
    assert monitor.told["ready"] is True and len(monitor.entry("ready")) == 1


def test_a_move_begins_with_its_setpoint_and_a_trajectory_with_its_first_sample():
    row = [0.0] * len(signals.SIGNALS)
    readiness = SimpleNamespace(look=lambda *_: True)
    assert not MoveToReady(1, 5, 3e-6, readiness, None).look(5, row, 0.0)
    path = MoveToReady(1, 5, 3e-6, readiness, {"times": (1.0,)})
    assert not path.look(4, row, 0.0) and path.look(5, row, 0.0) and len(path.measured) == 1


def test_an_axis_that_has_not_rested_is_not_metered_and_one_that_has_is():
    monitor = Monitor()
    assert monitor.ready.noise is None
    table = [[0.0] * 600 for _ in signals.SIGNALS]
    table[signals.MEASURED] = [NOISE * (-1.0) ** number for number in range(600)]
    monitor.ready.look_at_all(0, np.array(table))
    assert isinstance(monitor.ready.noise, Noise) and monitor.ready.noise.sensor > 0.0
    # neither in skipped samples nor while the axis is stopped, in blocks or sample by sample
    for why in ("SKIPPED", "TRIPPED"):
        blocks, single = Monitor(), Monitor()
        given = np.array(table)
        given[getattr(signals, why)] = 1.0
        blocks.ready.look_at_all(0, given)
        for number in range(600):
            single.samples(table[signals.MEASURED][number], setpoint=0.0, **{why: 1.0})
        assert blocks.ready.noise is None and single.ready.noise is None


@pytest.mark.parametrize("foreseen", [True, False])
def test_a_move_that_is_replaced_is_learned_and_followed_as_far_as_it_went(foreseen):
    monitor, followed = Monitor(), []
    monitor.ready._predictor.follow = followed.append
    if not foreseen:
        monitor.ready._predictor.predict = lambda *_: math.inf
    monitor.ready.begin(0.0, 5e-6)
    monitor.work()
    for number in range(7):
        monitor.samples(1e-6 * number)
    monitor.ready.begin(5e-6, 6e-6)
    monitor.work()
    assert [len(one) for one in monitor.learned] == ([7] if foreseen else [])
    assert followed == ([7] if foreseen else [])


def test_the_predictor_rests_before_a_move_after_every_motion_that_it_has_not_foreseen():
    monitor, calls = Monitor(), []
    predictor, own = monitor.ready._predictor, monitor.node.parameters
    predictor.rest_at = lambda setpoint: calls.append(("rest", setpoint))
    predictor.predict = lambda setpoint, after, *_: calls.append((setpoint, after)) or 0.004

    def moved(before, setpoint):
        calls.clear()
        monitor.ready.begin(before, setpoint)
        monitor.work()
        return list(calls)

    assert moved(1e-6, 5e-6) == [("rest", 1e-6), (5e-6, 0)]
    for samples in (7, 4):  # samples since the last move, not since the start
        for _ in range(samples):
            monitor.samples(0.0)
        assert moved(5e-6, 5e-6) == [(5e-6, samples)]

    def not_followed():
        monitor.node.parameters = replace(own, ready=replace(own.ready, tolerance=0.0))
        monitor.ready.begin(5e-6, 6e-6)
        monitor.node.parameters = own

    unforeseen = [
        lambda: monitor.samples(0.0, TRIPPED=1.0),
        lambda: [monitor.samples(0.0), monitor.samples(0.0, setpoint=7e-6)],
        lambda: monitor.ready.stop("reset"),
        not_followed,
    ]
    for happens in unforeseen:
        happens()
        (rested, before), (setpoint, _) = moved(5e-6, 5e-6)
        assert (rested, before, setpoint) == ("rest", 5e-6, 5e-6), "the models must not go on where the axis is not"
        assert len(moved(5e-6, 5e-6)) == 1


def test_a_configuration_replaces_parameters_and_a_retune_changes_some():
    monitor, kept = Monitor(), []
    for action, parameters in (
        (signals.CONFIGURED, {"a": 1, "b": 2}),
        ("retune", {"b": 3}),
        (signals.CONFIGURED, {"a": 4}),
    ):
        entry = {"node": signals.CONTROLLER, "action": action, "parameters": parameters}
        monitor.ready._on_change(String(data=json.dumps(entry)))
        kept.append(monitor.ready._given[signals.CONTROLLER])
    assert kept == [{"a": 1, "b": 2}, {"a": 1, "b": 3}, {"a": 4}]


def requested(given, noise=1e-9, waveform="hold", setpoint=5e-6, moving=False, deadband=0.0, tolerance=20e-9):
    """Return whether a request for a move is accepted, its reason, and tolerance and dwell time while it is taken."""
    monitor, asked = Monitor(), []
    node, own = monitor.node, monitor.node.parameters
    node.parameters = replace(
        own,
        ready=replace(own.ready, tolerance=tolerance, deadband=deadband),
        waveform=replace(own.waveform, type=waveform),
    )
    monitor.ready._meter = SimpleNamespace(
        sensor=math.nan if noise is None else noise, noise=lambda *_: Noise(noise, noise), FEWEST=200
    )
    node.active = node.running = True
    node.setpoint, node.hindrance, node.refuse = setpoint, lambda: "", lambda *_: None
    generator = SimpleNamespace(refuse=lambda value: "out of range" if value > 1e-4 else "", moving=moving)
    node.part = SimpleNamespace(generator=generator)
    node.take_and_tell = lambda value: asked.append(monitor.ready.asked) or ""
    made = [SetParametersAtomically.Request(parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in given])]
    result = monitor.ready._on_move(made[0], SetParametersAtomically.Response()).result
    assert monitor.ready.asked is None
    return result.successful, result.reason, asked


@pytest.mark.parametrize(
    ("given", "state", "words"),
    [
        ([("tolerance", 1e-8)], {}, "move takes"),
        ([("setpoint", 5)], {}, "move takes"),
        ([("setpoint", 5e-6), ("speed", 1.0)], {}, "move takes"),
        ([("setpoint", 5e-6), ("setpoint", 6e-6)], {}, "move takes"),
        ([("setpoint", 1.0)], {}, "out of range"),
        ([("setpoint", 6e-6)], {"tolerance": 0.0, "noise": 0.0}, "no noise that gives a tolerance: give one"),
        ([("setpoint", 6e-6)], {"tolerance": 0.0, "noise": None}, "not measured yet"),
        ([("setpoint", 6e-6), ("tolerance", 0.0)], {}, "tolerance 0 µm refused: must be > 0"),
        ([("setpoint", 6e-6), ("tolerance", math.inf)], {}, "must be > 0"),
        ([("setpoint", 6e-6), ("tolerance", math.nan)], {}, "must be > 0"),
        ([("setpoint", 6e-6), ("dwell", -1e-3)], {}, "dwell -0.001 s refused"),
        ([("setpoint", 6e-6), ("dwell", math.inf)], {}, "dwell inf s refused"),
        ([("setpoint", 6e-6)], {"waveform": "sine"}, "moves the axis"),
        ([("setpoint", 6e-6)], {"noise": None}, "not measured yet"),
        ([("setpoint", 6e-6), ("tolerance", 2.575e-9)], {}, "give at least that"),
    ],
)
def test_a_move_that_cannot_be_judged_is_refused_with_the_reason(given, state, words):
    successful, reason, asked = requested(given, **state)
    assert not successful and words in reason and not asked


def test_a_move_has_its_own_tolerance_and_dwell_time_or_those_of_the_axis():
    assert requested([("setpoint", 6e-6)])[2] == [(20e-9, 0.01)]
    assert requested([("setpoint", 6e-6), ("dwell", 0.5)])[2] == [(20e-9, 0.5)]


def test_a_move_without_a_tolerance_gets_twice_the_least_one_of_the_noise():
    successful, reason, asked = requested([("setpoint", 6e-6)], tolerance=0.0)
    assert successful, reason
    assert asked == [(pytest.approx(2.0 * 2.5758e-9, rel=1e-4), 0.01)]
    # 99 % of the noise is within 2.576 standard deviations
    assert requested([("setpoint", 6e-6), ("tolerance", 2.5761e-9), ("dwell", 0.0)])[2] == [(2.5761e-9, 0.0)]


def test_a_move_within_the_deadband_of_an_axis_at_rest_moves_nothing():
    near, far = [("setpoint", 5e-6 - 9e-9)], [("setpoint", 5e-6 + 11e-9)]
    successful, reason, asked = requested(near, deadband=10e-9)
    assert successful and json.loads(reason) == {"move": None, "deadband": 10e-9} and not asked
    # an axis that still moves would stay where it is going, not where it is asked to go
    for given, state in ((near, {"moving": True, "deadband": 10e-9}), (far, {"deadband": 10e-9}), (near, {})):
        successful, _, asked = requested(given, **state)
        assert successful and len(asked) == 1
    assert len(requested([("setpoint", 5e-6)])[2]) == 1, "without a deadband every move is one"


class Answering:
    """A client whose axis accepts a move and reports these entries on ``~/moves``; every wait ends at once."""

    timeout = 9.0

    def __init__(self, entries, answer=None):
        self.entries, self.answer, self.request = entries, {"move": 7} if answer is None else answer, None
        self.node = SimpleNamespace(create_subscription=self.hear, count_publishers=lambda topic: 1)

    def hear(self, kind, topic, heard, qos):
        if topic.endswith("/moves"):
            self.heard = heard

    def until(self, condition, *_):
        return condition()

    def ask(self, kind, name, request):
        self.name, self.request = name, {one.name: one.value.double_value for one in request.parameters}
        for entry in self.entries:
            self.heard(String(data=json.dumps(entry)))
        result = SimpleNamespace(successful=True, reason=json.dumps(self.answer))
        return SimpleNamespace(result=result)


FORESEEN = {"move": 7, "tolerance": 5e-9, "predicted": 0.004}
UNFORESEEN = {"move": 7, "predicted": None, "why": "too many moves"}
READY = {"move": 7, "ready": 0.003, "missing": 0}
OTHER = [{"move": 6, "ended": "replaced"}, {"move": 6, "predicted": 0.1}, {"move": 8, "ready": 0.2, "missing": 0}]


@pytest.mark.parametrize(
    ("entries", "code", "words"),
    [
        (
            [FORESEEN, {"move": 7, "ready": 0.005, "missing": 0}],
            0,
            ("ready in 4 ms, predicted", "5 ms, measured, +25 %"),
        ),
        ([FORESEEN, {"move": 7, "ready": 0.003, "missing": 0}], 0, ("ready after 3 ms, measured, -25 %",)),
        ([UNFORESEEN, READY | {"missing": 2}], 0, ("not predicted: too many moves", "; 2 samples")),
        ([FORESEEN, {"move": 7, "ended": "replaced"}], 1, ("ready in 4 ms", "not ready: replaced")),
        ([{"move": 7, "ended": "replaced"}], 1, ("not predicted: replaced", "not ready: replaced")),
        ([FORESEEN], 1, ("ready in 4 ms", "not ready within 9 s")),
    ],
)
def test_a_move_is_reported_by_its_own_entries(monkeypatch, capsys, entries, code, words):
    monkeypatch.setattr(commands, "_source", lambda client: "/left/reference_generator")
    monkeypatch.setattr(commands, "_require_active", lambda client, source: None)
    client = Answering([*OTHER[:2], *entries, *OTHER[2:]])
    assert move(client, 5e-6, 1e-8, 0.25) == code
    assert client.request == {"setpoint": 5e-6, "tolerance": 1e-8, "dwell": 0.25}
    printed = capsys.readouterr().out
    assert all(text in printed for text in words), printed
    assert ("% from" in printed) is ("%" in words[-1])
    with pytest.raises(AbsentError, match="has not predicted it"):
        move(Answering(OTHER), 5e-6, None, None)
    assert move(Answering([], {"move": None, "deadband": 1e-8}), 5e-6, None, None) == 0
    assert "within ready.deadband = 10 nm" in capsys.readouterr().out


def test_a_zero_is_sent_and_what_is_not_given_is_not(monkeypatch, capsys):
    """A setpoint of 0, a dwell time of 0, and a quiet hold of 0 s, which ends one."""
    monkeypatch.setattr(commands, "_source", lambda client: "/left/reference_generator")
    monkeypatch.setattr(commands, "_require_active", lambda client, source: None)
    moved, held = Answering([FORESEEN, READY]), Answering([], {})
    assert move(moved, 0.0, None, 0.0) == 0 and moved.request == {"setpoint": 0.0, "dwell": 0.0}
    assert "ready in 4 ms, predicted; tolerance 5 nm\n" in capsys.readouterr().out
    held.find = lambda name: f"/left/{name}"
    for given, sent in (((0.0, None), {"duration": 0.0}), ((2.0, 1e-9), {"duration": 2.0, "tolerance": 1e-9})):
        commands.quiet(held, *given)
        assert held.request == sent and held.name == "/left/motion_controller/quiet"


def test_the_prediction_of_each_axis_that_can_move_is_compiled_before_a_loop_with_a_driver_in_python(monkeypatch):
    """Compiled at the first move, it would hold Python's lock, which the driver needs in each sample."""
    from hysteresis_ros.nodes.fused import FusedAxis

    made: list = []
    monkeypatch.setattr("hysteresis_ros.loop.ready.Predictor", made.append)
    given = load_configuration("stage700")
    axes = [single_axis(given.override("reference_generator", waveform__type=kind)) for kind in ("hold", "sine")]
    together = [SimpleNamespace(present_parameters=partial(replace, axis)) for axis in axes]
    FusedAxis._compile_predictions(SimpleNamespace(together=together))
    assert [axis.motion_controller.type for axis in made] == [axes[0].motion_controller.type]
