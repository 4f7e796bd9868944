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
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import InProcess, Observer, axis_parameters, compose, until  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from std_msgs.msg import Bool, Float64, String  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.nodes.ready import WAITING, MoveToReady, ReadyTopics  # noqa: E402
from hysteresis_ros.nodes.remote.__main__ import done  # noqa: E402
from hysteresis_ros.nodes.remote.client import Client  # noqa: E402
from hysteresis_ros.nodes.remote.commands import move, set_, setpoint  # noqa: E402
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
        (6e-6, 1e-10, None, r"tolerance 1e-10 m refused: .* within \S+e-09 m during 99 % of the time; give at least"),
        (6e-6, None, None, "needs a tolerance > 0 m: state one, or set ready.tolerance"),
        (6e-6, 20e-9, -1.0, "dwell -1 s refused"),
        (50e-6, 20e-9, None, r"5e-05 m refused: out of range, allowed: 0 … 1.2e-05 m"),
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
    known = len(said(heard, "move"))
    assert move(client, 8.03e-6, None, None) == 0
    assert "within ready.deadband = 50 nm" in capsys.readouterr().out
    assert source(axis).setpoint == 8e-6 and len(said(heard, "move")) == known
    set_(client, "reference_generator", {"ready.tolerance": "0", "ready.deadband": "0"})


def test_a_refused_move_ends_with_exit_code_2(axis, client, capsys):
    given = {"value": 6e-6, "tolerance": 1e-12, "dwell": None}
    assert done({"command": "move", "namespace": "left", "timeout": 60.0, **given}, lambda *_: nullcontext(client)) == 2
    assert "tolerance 1e-12 m refused" in capsys.readouterr().err


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
    assert "does not stay within the tolerance" in kept and "one line of two" in failed and "8 moves wait" in waiting
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


def test_a_move_begins_with_its_setpoint_and_a_trajectory_with_its_first_sample():
    row = [0.0] * len(signals.SIGNALS)
    readiness = SimpleNamespace(look=lambda *_: True)
    assert not MoveToReady(1, 5, 3e-6, readiness, None).look(5, row)
    path = MoveToReady(1, 5, 3e-6, readiness, {"times": (1.0,)})
    assert not path.look(4, row) and path.look(5, row) and len(path.measured) == 1


def test_an_axis_that_has_not_rested_is_not_metered_and_one_that_has_is():
    monitor = Monitor()
    assert monitor.ready.noise is None
    table = [[0.0] * 600 for _ in signals.SIGNALS]
    table[signals.MEASURED] = [NOISE * (-1.0) ** number for number in range(600)]
    monitor.ready.look_at_all(0, np.array(table))
    assert isinstance(monitor.ready.noise, Noise) and monitor.ready.noise.sensor > 0.0
    skipped = Monitor()
    table[signals.SKIPPED] = [1.0] * 600
    skipped.ready.look_at_all(0, np.array(table))
    assert skipped.ready.noise is None
