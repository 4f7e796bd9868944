# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Real time has the order of lockstep within a sample: every answer belongs to its own measurement and reference."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, write_axis  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.nodes import realtime  # noqa: E402
from hysteresis_ros.nodes.realtime import GIVE_UP, SUSPICION, AwakeTime, Follower, RealTimeResponder  # noqa: E402
from hysteresis_ros.nodes.responder import Input  # noqa: E402

SAMPLES = 200


def moving_axis():
    """Return an axis that follows a sine with preview alone, at 60 samples per second of wall time."""
    overrides = {
        "reference_generator": {"waveform__type": "sine", "waveform__amplitude": 4.0e-6, "waveform__frequency": 20.0},
        "plant_simulator": {"real_time_factor": 0.02, "late_limit": -1},
    }
    overrides["reference_generator"] |= {"waveform__offset": 5.0e-6}
    # a blocked machine must not count as silence here, because references are then faded to
    overrides["motion_controller"] = {"measurement_timeout": 60.0}
    axis = axis_parameters(overrides=overrides, exit_at_end=True)
    ahead = replace(axis.motion_controller.feedforward, type="inverse_dynamics", preview=3)
    return replace(axis, motion_controller=replace(axis.motion_controller, type="open_loop", feedforward=ahead))


@pytest.mark.parametrize("how", ["--composed", "--processes"])
def test_every_command_answers_the_reference_of_its_own_sample(processes, tmp_path, how):
    from hysteresis_ros.loop.simulation import simulate
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.cdr import decode_joint_states
    from hysteresis_ros.recordings.files import load_run

    axis = moving_axis()
    path = write_axis(tmp_path / "axis.yaml", axis)
    duration = str(SAMPLES / axis.plant_simulator.sample_rate)
    run = processes.command("up", path, how, "--record", str(tmp_path / "bag"), "--duration", duration)
    assert run.wait() == 0, run.output
    bag = read_bag(tmp_path / "bag")
    references = []
    for node in ("reference_generator", "motion_controller"):
        states = decode_joint_states(bag.topics[f"/{node}/state"].data, node)
        references.append(dict(zip(states.stamps.tolist(), states.signal("reference"), strict=True)))
    both = sorted(set(references[0]) & set(references[1]))
    assert len(both) > 0.5 * SAMPLES
    same = np.array([references[0][stamp] == references[1][stamp] for stamp in both])
    # a busy machine may delay some samples; a wrong order would leave no equal sample
    assert np.count_nonzero(same) > 0.5 * len(both)
    # the inverse gives the offline commands; one sample late, the error would be the change in one sample
    recorded, twin = load_run(tmp_path / "bag"), simulate(axis, duration=SAMPLES / axis.plant_simulator.sample_rate)
    shift = min(range(SAMPLES // 3), key=lambda samples: off(recorded["reference"], twin["reference"], samples))
    assert off(recorded["reference"], twin["reference"], shift) == 0.0  # the source begins when it is present
    change = np.median(np.abs(np.diff(twin["command"])))
    assert off(recorded["command"], twin["command"], shift) < 0.1 * change


def off(recorded, twin, shift: int) -> float:
    """Return the median difference from the twin, which began ``shift`` samples earlier.

    The last samples of a busy machine may be missing.
    """
    return float(np.nanmedian(np.abs(recorded[shift:] - twin[: len(recorded) - shift])))


# -- irregular messages, without DDS ---------------------------------------------------------------------------------


def test_awake_time_leaves_out_what_the_process_was_halted_for(monkeypatch):
    moment = 100.0
    monkeypatch.setattr(realtime.time, "monotonic", lambda: moment)
    awake = AwakeTime(longest=0.02)
    for _ in range(10):
        moment += 0.01
        assert awake.look(moment) == pytest.approx(moment - 100.0)
    heard = awake.at(moment)
    # suspended for a second: before and at the next check, at most the longest interval has passed
    assert awake.at(moment + 1.0) - heard == pytest.approx(0.02)
    assert awake.look(moment + 1.0) - heard == pytest.approx(0.02)
    assert awake.at(moment + 1.005) - heard == pytest.approx(0.025)


def test_a_message_waits_for_its_measurement_and_a_measurement_for_its_message():
    follower = Follower(strict=False)
    assert follower.ready and math.isnan(follower.give())  # no node is present, and no node is waited for
    follower.take(0.0)  # belongs to a sample that was answered
    assert not follower.ready
    follower.take(1.0)
    assert follower.ready and follower.give() == 1.0
    follower.expect()
    assert not follower.ready


@pytest.mark.parametrize("strict", [False, True])
def test_a_late_message_is_not_taken_for_the_next_one(strict):
    follower = Follower(strict)
    follower.take(0.0)
    given = follower.give()  # 1.0 is late
    assert math.isnan(given) if strict else given == 0.0
    follower.take(1.0)
    assert not follower.ready  # the next measurement waits for its own message
    follower.take(2.0)
    assert follower.give() == 2.0


def test_a_lost_message_costs_a_few_samples_and_heals():
    follower = Follower(strict=False)
    follower.take(0.0)
    answered = []
    for sample in range(1, 20):
        follower.expect()
        if sample != 5:
            follower.take(float(sample))
        answered.append((sample, follower.give()))
    wrong = [sample for sample, value in answered if value != sample]
    assert wrong == [5]  # missing ones are published at once, with the last received values


def test_who_is_silent_is_given_up_and_waited_for_again_when_he_is_back():
    follower = Follower(strict=False)
    follower.take(1.0)
    for _ in range(GIVE_UP):
        assert not follower.ready
        assert follower.give() == 1.0
    assert not follower.ready
    follower.give()
    assert follower.ready
    follower.take(2.0)
    assert not follower.ready and follower.last == 2.0


def test_a_message_too_many_is_dropped_when_every_measurement_finds_it():
    follower = Follower(strict=False)
    follower.take(0.0)
    follower.take(0.5)  # twice
    for sample in range(SUSPICION + 10):
        follower.expect()
        follower.take(float(sample))
        last = follower.give()
    assert last == SUSPICION + 9.0


class Node:
    """The interface of a node to a RealTimeResponder: a row, inputs, and stored answers."""

    triggered_by_measurement = True
    active = True
    is_stale = False
    patience = math.inf
    trigger = "joint_states"

    def __init__(self):
        self.row, self.answers, self.rejected = [0.0, 0.0], [], 0
        self.inputs = (Input("reference", 1, "reference_generator"),)
        self.parameters = SimpleNamespace(sample_rate=100.0, queue_depth=1000)
        self.pace = SimpleNamespace(tick=lambda: None)
        self.sample = 0

    def get_logger(self):
        return SimpleNamespace(info=lambda text: None)

    def read(self, message, row) -> bool:
        row[0] = message.value
        return True

    def reject(self, row) -> None:
        self.rejected += 1
        row[0] = math.nan

    def warn(self, key, text) -> None:
        assert key == "stamp"

    def take(self, input_, value) -> None:
        self.row[input_.signal] = value

    def refuse_value(self, input_, value) -> None:
        raise AssertionError(f"{input_.topic} {value}")

    def answer(self, stamp) -> None:
        self.answers.append((stamp.nanosec, *self.row))
        self.sample += 1


def measurement(sample: int):
    stamp = SimpleNamespace(sec=0, nanosec=sample)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), value=float(sample))


@pytest.mark.parametrize("looked_first", [False, True])
@pytest.mark.parametrize("waiting", [1, 30])
def test_measurements_that_waited_while_the_process_stood_still_are_not_answered(monkeypatch, looked_first, waiting):
    now = [0.0]
    monkeypatch.setattr(realtime.time, "monotonic", lambda: now[0])
    node = Node()
    node.patience, node.inputs = 0.2, ()
    runner = RealTimeResponder(node)
    node.say_silent = lambda: None
    node.is_stale, node.miss = True, lambda samples: None
    sample = 0

    def live(samples):
        nonlocal sample
        for _ in range(samples):
            now[0] += 0.01
            runner.watch()
            sample += 1
            runner.measurement(measurement(sample))

    live(20)
    assert len(node.answers) == 20
    now[0] += 1.5
    if looked_first:
        runner.watch()
    for _ in range(waiting):
        sample += 1
        runner.measurement(measurement(sample))
        now[0] += 1e-4
    assert len(node.answers) == 20
    live(20)
    # all except possibly the first one, which does not wait any longer
    assert len(node.answers) >= 39 and node.answers[-1][0] == sample


def test_a_silent_plant_or_a_short_delay_lets_no_measurement_go(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(realtime.time, "monotonic", lambda: now[0])
    node = Node()
    node.patience, node.inputs = 0.2, ()
    runner = RealTimeResponder(node)
    node.say_silent = lambda: None
    node.is_stale, node.miss = True, lambda samples: None
    for sample in range(1, 6):
        for _ in range(100 if sample == 3 else 1):
            now[0] += 0.01
            runner.watch()
        runner.measurement(measurement(sample))
    now[0] += 0.19
    for sample in range(6, 20):
        runner.measurement(measurement(sample))
    assert len(node.answers) == 19


def deliver(order: str) -> Node:
    """Deliver measurements (m) and references (r), each numbered from 1; M and R are lost."""
    node = Node()
    runner = RealTimeResponder(node)
    counts = dict.fromkeys("mr", 0)
    for letter in order:
        counts[letter.lower()] += 1
        if letter == "m":
            runner.measurement(measurement(counts["m"]))
        elif letter == "r":
            runner.value(0, float(counts["r"]))
    return node


@pytest.mark.parametrize("order", ["mr" * 30, "mr" + "rm" * 30, "mr" + "mrrm" * 15])
def test_whichever_of_measurement_and_reference_comes_first_they_meet(order):
    answers = deliver(order).answers
    assert answers[1:] == [(k, float(k), float(k)) for k in range(2, len(answers) + 1)]
    assert len(answers) >= order.count("m") - 1


def test_a_reference_that_comes_after_the_next_measurement_is_late_and_only_once():
    answers = deliver("mr" * 5 + "mmrr" + "mr" * 20).answers
    wrong = [answer for answer in answers[1:] if answer[1] != answer[2]]
    assert wrong == [(6, 6.0, 5.0)]
    assert [answer[0] for answer in answers] == list(range(1, 28))


@pytest.mark.parametrize(
    "order", ["mr" * 5 + "mR" + "mr" * 30, "mr" * 5 + "Mr" + "mr" * 80, "mr" * 5 + "r" + "mr" * 80]
)
def test_what_is_lost_or_comes_twice_heals(order):
    answers = deliver(order).answers
    stamps = [answer[0] for answer in answers]
    assert stamps == sorted(set(stamps))
    shift = answers[-1][2] - answers[-1][1]
    assert shift == (1.0 if "rr" in order and "M" not in order else 0.0)  # duplicates shift the numbers
    assert all(answer[2] - answer[1] == shift for answer in answers[-15:])
    assert deliver(order + "m").answers[-1] == answers[-1]  # and it waits for its own message again


def test_a_source_that_stops_and_comes_back_is_followed_again():
    node = deliver("mr" * 10 + "mR" * 20 + "mr" * 20)
    answers = node.answers
    assert len(answers) >= 49
    assert all(answer[2] == 10.0 for answer in answers[10:29])  # the last message is used
    assert all(answer[1] == answer[2] for answer in answers[33:])


def test_a_measurement_with_an_old_stamp_is_rejected_and_answered_all_the_same():
    node = deliver("mrmr")
    runner = RealTimeResponder(node)
    for sample in (1, 2, 3, 2, 4):
        runner.measurement(measurement(sample))
    assert node.rejected == 1 and math.isnan(node.answers[-2][1]) and node.answers[-1][1] == 4.0


@pytest.mark.parametrize("started_between_samples", [True, False])
@pytest.mark.parametrize("returned", [True, False])
def test_a_node_that_lost_a_partner_resumes_although_the_plant_was_started_before_a_measurement_showed_the_stop(
    started_between_samples, returned
):
    node = Node()
    node.row = [0.0] * len(signals.SIGNALS)
    node.publisher = lambda *_: SimpleNamespace(publish=said.append)
    node.kind, node.warn = "hysteresis_compensator", lambda *_, **__: None
    node.qos, node.subscriber, said = None, lambda *_: None, []
    runner = RealTimeResponder(node)
    runner.connect()
    runner._lose("motion_controller", "/axis/motion_controller", "a new process has replaced it")
    if returned:
        runner._note(1, "motion_controller")
        runner._look_for_losses(0.0)
    if started_between_samples:
        runner._on_presence(String(data="started plant_simulator"))
    runner.follow_trip(False)
    assert bool(runner.latched) is not (started_between_samples and returned)
    if not (started_between_samples and returned):
        assert not returned or not runner._lost  # without a start it stays safe
        said.clear()
        runner.follow_trip(True)
        runner._note(1, "motion_controller")
        runner._look_for_losses(0.0)
        runner.follow_trip(False)
        assert not runner.latched and said[0].data.split()[0] == ("here" if returned else "heard")
