# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Late voltages stop the axis, latched; nodes that exit, start or are reset do not count as late."""

from __future__ import annotations

import ctypes
import itertools
import math
import time
from collections import deque
from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import SOON_AT_REST, Observer, axis_parameters, compose, diagnostics, until  # noqa: E402
from std_msgs.msg import Float64, String  # noqa: E402

from hysteresis_ros.loop.watch import RUNNING, TRIPPED  # noqa: E402
from hysteresis_ros.nodes import plant_runners, realtime  # noqa: E402
from hysteresis_ros.nodes.plant_runners import (  # noqa: E402
    ANSWERS,
    LONGEST_SETTLING,
    PUBLISHED,
    SETTLED,
    LockstepPlant,
    RealTimePlant,
)
from hysteresis_ros.nodes.realtime import STARTING  # noqa: E402
from hysteresis_ros.signals import DISPLACEMENT, PLANT_VOLTAGE, SOURCE_MODE  # noqa: E402

SETPOINT = 6.0e-6
NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")


#: Without hysteresis, because a voltage lost by a busy machine would leave plant and inverse on different branches.
LINEAR = {"hysteresis__type": "proportional", "hysteresis__proportional__gain": 1.0e-7}


def slow_axis(**plant):
    """Return an axis with 10 ms of wall time per sample, so that only intended delays are late."""
    plant = {"real_time_factor": 0.5, "safe_slew_rate": 2000.0} | LINEAR | SOON_AT_REST["plant_simulator"] | plant
    overrides = {"plant_simulator": plant, "reference_generator": {"initial_setpoint": SETPOINT}}
    overrides["motion_controller"] = SOON_AT_REST["motion_controller"] | {"safe_slew_rate": 2.0e-4}
    overrides["hysteresis_compensator"] = LINEAR
    return axis_parameters(overrides=overrides, sample_rate=200.0)


@pytest.fixture
def late_axis(inside):
    """Function that composes an axis whose compensator answers ``delay`` samples later."""

    def made(**plant):
        nodes = compose(inside, slow_axis(**plant))
        compensator, waiting = nodes[1], deque()
        usual = compensator.publish_outputs
        compensator.delay = 0

        def publish_later() -> None:
            waiting.append(list(compensator.row))
            now = compensator.row
            while len(waiting) > compensator.delay:
                compensator.row = waiting.popleft()
                usual()
            compensator.row = now

        compensator.publish_outputs = publish_later
        inside.spin()
        return nodes

    return made


def settled(plant):
    def there():
        assert not plant.part.lost, f"{plant.part.lost} is lost"
        return abs(plant.row[DISPLACEMENT] - SETPOINT) < 2e-8 and plant.sample > 40

    until(there, what="the axis at its setpoint")


def more(plant, samples: int) -> None:
    since = plant.sample
    until(lambda: plant.sample > since + samples, what=f"{samples} more samples")


def test_the_remedy_for_late_voltages_is_one_that_the_axis_allows():
    from hysteresis_ros.nodes.plant_runners import remedy_for_late_voltages

    of_device = "lower sample_rate, or run the axis fused"
    assert remedy_for_late_voltages(device=True, alone=False) == of_device
    simulated = "lower sample_rate or real_time_factor, run the nodes composed, or run in lockstep"
    assert remedy_for_late_voltages(device=False, alone=True) == simulated


def test_the_plant_does_not_call_itself_lost():
    from hysteresis_ros.nodes.plant_simulator import explain_loss

    other = explain_loss("/motion_controller", "/plant_simulator")
    assert other == "/motion_controller is lost: it sends no messages; start it again, then call ~/start"
    own = explain_loss("/plant_simulator", "/plant_simulator")
    assert "is lost" not in own and "this node" in own and own.endswith("call ~/start to resume")


@pytest.mark.parametrize("delay", [1, 3])
def test_voltages_that_answer_earlier_samples_stop_the_axis_until_it_is_started(late_axis, observer, capfd, delay):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    plant, compensator, controller, source = late_axis()
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    joints = observer.listen(JointState, "/joint_states")
    states = observer.listen(JointState, "/plant_simulator/state")
    settled(plant)
    until(lambda: joints, what="joint_states")
    before = plant.late
    assert not plant.part.tripped and joints[-1].header.frame_id == ""
    compensator.delay = delay
    until(lambda: plant.part.tripped, what="the trip")
    assert plant.late - before >= 10
    until(lambda: joints[-1].header.frame_id == "tripped", what="the stamp's frame")
    until(
        lambda: abs(plant.row[PLANT_VOLTAGE]) < 0.01 and controller.command == 0.0 and abs(compensator.voltage) < 0.01
    )
    modes = [int(controller._mode), int(compensator._mode), int(source.row[SOURCE_MODE])]
    assert modes == [TRIPPED] * 3
    until(lambda: all(diagnostics(reports, f"/{name}") for name in NODES), what="diagnostics")
    until(lambda: all(diagnostics(reports, f"/{name}")[0] == 2 for name in NODES), what="errors of all nodes")
    text = diagnostics(reports, "/plant_simulator")[1]
    for words in (
        "axis stopped",
        "at 100 Hz",
        "which is enough for",
        "lower sample_rate or real_time_factor",
    ):
        assert words in text, text
    assert "in lockstep" in text and "nodes composed" not in text and "~/start" in text and "late_limit" in text
    assert "[ERROR]" in (errors := capfd.readouterr().err) and "axis stopped" in errors
    # latched, although all messages are in time again
    compensator.delay = 0
    more(plant, 30)
    assert plant.part.tripped
    since, before = len(states), plant.late
    assert observer.trigger("/plant_simulator/start").success
    settled(plant)
    more(plant, 30)
    assert not plant.part.tripped and joints[-1].header.frame_id == ""
    assert [int(controller._mode), int(compensator._mode), int(source.row[SOURCE_MODE])] == [RUNNING] * 3
    moved = [state.position[2] for state in states[since - 1 :]]
    # it returns at 2000 V/s, 200 samples per second; voltages that a busy machine delays come at once
    most = 10.01 * (1 + plant.late - before)
    assert max(abs(b - a) for a, b in zip(moved[:-1], moved[1:], strict=True)) <= most


def test_a_voltage_that_answers_an_earlier_sample_is_not_put_out(late_axis, observer):
    from sensor_msgs.msg import JointState

    plant, compensator, _, source = late_axis(late_limit=40)
    states = observer.listen(JointState, "/plant_simulator/state")
    settled(plant)
    compensator.delay = 1
    before = plant.late
    until(lambda: plant.late > before + 2, what="late voltages")
    sent = compensator.voltage
    source.setpoint = 0.5 * SETPOINT
    until(lambda: compensator.voltage < 0.9 * sent and plant.late > before + 10, what="other voltages")
    until(lambda: plant.part.tripped, what="the trip")
    put_out = [state.position[2] for state in states if before + 2 < state.position[5] < plant.late - 1]
    assert len(put_out) > 10 and set(put_out) == {put_out[0]}


def test_without_a_limit_late_voltages_are_only_counted(late_axis):
    plant, compensator, *_ = late_axis(late_limit=-1)
    settled(plant)
    compensator.delay = 1
    before = plant.late
    until(lambda: plant.late > before + 60, what="late voltages")
    assert not plant.part.tripped


def test_lateness_from_the_very_beginning_is_noticed(inside):
    """The first voltage is already late; without the sample that it answers it would count as punctual."""
    axis = slow_axis()
    plant, compensator, *_ = compose(inside, axis)
    usual, waiting, period = compensator.publish_outputs, deque(), plant.runner.period

    def publish_due() -> None:
        now = compensator.row
        while waiting and time.monotonic() > waiting[0][0]:
            compensator.row = waiting.popleft()[1]
            usual()
        compensator.row = now

    compensator.publish_outputs = lambda: waiting.append((time.monotonic() + 1.5 * period, list(compensator.row)))
    compensator.create_timer(0.1 * period, publish_due)
    inside.spin()
    until(lambda: plant.part.tripped, what="the trip")


@pytest.fixture
def started_soon(monkeypatch):
    """Tolerate longer silence of new partners for 0.5 s only: they are in this process."""
    for module in (realtime, plant_runners):
        monkeypatch.setattr(module, "STARTING", 0.5)


def test_a_short_halt_of_the_process_is_no_lost_partner(started_soon, late_axis):
    """A garbage collection in a large process takes this long: messages wait in queues, and no partner is lost."""
    plant, *_ = late_axis(voltage_timeout=0.05, late_limit=-1)
    settled(plant)
    more(plant, 80)  # 0.8 s, longer than the time in which new partners are tolerated
    for pause in (*(0.03,) * 6, *(0.07,) * 6):
        ctypes.PyDLL(None).usleep(int(1e6 * pause))  # it holds the lock of the interpreter
        more(plant, 20)
        assert not plant.part.lost and not plant.part.tripped
    settled(plant)


def test_who_leaves_comes_back_or_is_reset_is_not_called_late(started_soon, late_axis, observer):
    # a busy machine may be late sometimes; the exit must not add late voltages
    plant, *_ = late_axis(voltage_timeout=0.05, late_limit=100)
    settled(plant)
    more(plant, 80)  # 0.8 s, longer than the time in which new partners are tolerated
    for name in NODES[1:]:
        assert observer.transition(f"/{name}", "deactivate")
        more(plant, 30)
        assert not plant.part.tripped, name
        for _ in range(3):
            assert observer.trigger(f"/{name}/reset").success
        assert observer.transition(f"/{name}", "activate")
        settled(plant)
        more(plant, 30)
        assert not plant.part.tripped, name
        answers = [observer.trigger(f"/{name}/reset") for _ in range(3)]
        # alone on a running axis they would cause a jump; on a busy machine the axis may seem to be at rest once
        refused = [answer.message for answer in answers if not answer.success]
        assert bool(refused) == (name != "reference_generator")
        assert all("the axis is running" in message for message in refused)
        more(plant, 30)
        settled(plant)
        assert not plant.part.tripped, name
    for _ in range(3):
        assert observer.trigger("/plant_simulator/reset").success
    settled(plant)
    more(plant, 30)
    assert not plant.part.tripped


def test_a_node_that_joins_or_leaves_does_not_let_the_plant_wait_for_its_voltages(late_axis, domain, monkeypatch):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    plant = late_axis()[0]
    settled(plant)
    waited = []
    for name in ("align", "_align"):
        monkeypatch.setattr(plant.runner, name, partial(waited.append, name))
    other = Observer(domain)
    heard, setpoint = other.listen(JointState, "/plant_simulator/state"), other.talk(Float64, "/setpoint")
    until(lambda: heard and setpoint.get_subscription_count(), what="the second observer")
    more(plant, 10)
    other.close()
    more(plant, 30)
    assert not waited


def pretended_runner(kind=RealTimePlant, given: int = 0, asked: int = 0, **node):
    """Return a runner of a plant without a graph, which has received and expects a number of voltages."""
    runner = object.__new__(kind)
    voltage = SimpleNamespace(
        topic="voltage", partner="hysteresis_compensator", value=0.0, received=1.0, count=20, first=-100.0
    )
    done = []
    part = SimpleNamespace(silent=False, tripped=False, failure="", lost="", late=0)
    part.forgive, part.await_voltages, part.count_late = (partial(done.append, name) for name in CALLED)
    values = {"sample_rate": 200.0, "real_time_factor": 0.5, "allowed_late": 10, "wait_for_recorder": True, "lead": 3}
    values["driver"] = ""
    node = {"executor": None} | node
    own = {"loop_complete": lambda: True, "patience": 0.1, "leaving": False, "sample": 0, "part": part}
    own |= {"receive": lambda input_, value: setattr(input_, "value", value)}
    runner.node = SimpleNamespace(inputs=[voltage], parameters=SimpleNamespace(**values), **(own | node))
    runner._given, runner._asked = {"voltage": given}, asked
    runner._gone, runner._coming, runner._known = set(), set(), set()
    runner._published, runner._answers, runner._answered = [0.0] * PUBLISHED, [0.0] * ANSWERS, 0
    runner._heard, runner._awake_time = {}, SimpleNamespace(at=lambda moment: moment)
    runner._unaligned, runner._settling, runner._unsettled, runner._acknowledged = False, 0, 0, 0
    runner.done = done
    return runner, voltage


#: Methods of a part that a pretended runner reports.
CALLED = ("forgive", "await_voltages", "count_late")


def test_a_voltage_too_many_does_not_answer_the_next_sample():
    runner, voltage = pretended_runner(asked=1)
    assert runner._is_behind(voltage)
    for value in (1.0, 2.0, 3.0):
        runner.voltage(voltage, Float64(data=value))
        assert not runner._is_behind(voltage) and voltage.value == value, "the last one before the deadline counts"
    runner._asked += 1
    assert runner._is_behind(voltage), "only voltages of earlier samples have come"
    runner.voltage(voltage, Float64(data=4.0))
    assert not runner._is_behind(voltage)


def test_a_voltage_of_an_earlier_sample_is_dropped_or_counted_only_in_a_closed_loop():
    for open_loop, allowed, value, called in (
        ({}, 10, math.nan, ["await_voltages"]),
        ({}, 0, 0.0, ["count_late"]),
        ({"loop_complete": lambda: False}, 10, 0.0, []),
    ):
        runner, voltage = pretended_runner(given=3, asked=4, **open_loop)
        runner.node.parameters.allowed_late = allowed
        runner._drop_late()
        assert runner.done == called and math.isclose(voltage.value, value) == (value == value)
    runner, voltage = pretended_runner(given=3, asked=4)
    runner._gone.add("motion_controller")
    runner._drop_late()
    assert not runner.done and voltage.value == 0.0
    runner, voltage = pretended_runner(given=4, asked=4)
    runner._drop_late()
    assert not runner.done


def test_voltages_are_counted_again_after_ten_answered_samples_in_a_row_and_at_the_latest_after_a_hundred():
    for answered, length in ((lambda k: True, SETTLED), (lambda k: k != 6, 7 + SETTLED), (lambda k: k % 2, 100)):
        runner, voltage = pretended_runner(given=0, asked=9)
        runner.settle()
        found = []
        for k in range(2 * LONGEST_SETTLING):
            voltage.value = 1.0 if answered(k) else math.nan
            found.append(runner._settle())
        assert sum(found) == length and all(found[:length])
        # the count begins where it is, and what was missing meanwhile is forgiven
        assert runner._given == {"voltage": 9} and runner.done == ["forgive"] * length


def test_the_rate_that_a_graph_achieves_is_half_of_what_its_answers_allow():
    runner, _ = pretended_runner()
    assert "answers within" not in runner.explain_trip()
    for number in range(ANSWERS):
        runner._answers[number] = 0.5 if number == 0 else 0.01
    runner._answered = 3 * ANSWERS
    text = runner.explain_trip()
    assert "more than 10 voltages" in text and "at 100 Hz" in text
    assert "answers within 10 ms (99 %), which is enough for 50 Hz" in text
    runner._answered = 1
    assert "within 500 ms (99 %), which is enough for 1 Hz" in runner.explain_trip()


def test_an_active_node_is_silent_after_its_time_and_one_that_starts_has_longer():
    now, loss = 1000.0, 0.2
    for count, known, since_first, silence, silent in (
        (20, False, 100.0, 0.9 * loss, False),
        (20, False, 100.0, 1.1 * loss, True),
        # a node that is compiling has sent few voltages, or begins just now
        (9, False, 100.0, 100.0, False),
        (1, True, 100.0, 1.1 * loss, True),
        (0, True, 100.0, 100.0, False),
        (20, False, 0.5 * STARTING, 0.9 * STARTING, False),
        (20, False, 0.5 * STARTING, 1.1 * STARTING, True),
    ):
        # 100 Hz on the wall clock: twice the time of the axis
        runner, voltage = pretended_runner()
        assert runner._loss_time == pytest.approx(loss)
        voltage.count, voltage.received, voltage.first = count, now - silence, now - silence - since_first
        runner._heard = {"voltage": now - silence}
        runner._known = {"hysteresis_compensator"} if known else set()
        assert runner._is_silent(voltage, now) is silent, (count, known, since_first, silence)


def test_a_plant_in_lockstep_is_never_further_ahead_of_its_recorder_than_the_lead():
    runner, _ = pretended_runner(LockstepPlant)
    for acknowledged, begins in ((-1, []), (0, [0, 1, 2]), (4, [0, 1, 2, 3, 4, 5, 6])):
        runner._acknowledged, found = acknowledged, []
        for runner.node.sample in range(10):
            found += [] if runner._recorder_behind() else [runner.node.sample]
        assert found == begins
    runner.node.parameters.wait_for_recorder, runner._acknowledged = False, -1
    assert not runner._recorder_behind()


@pytest.mark.parametrize("recorded", [False, True])
def test_a_run_of_a_given_length_awaits_every_node_and_its_recorder(recorded):
    complete = 4 if recorded else 3  # readers of joint_states
    for readers, publishers, acknowledged in itertools.product((complete - 1, complete), (0, 1), (-1, 0)):
        runner, voltage = pretended_runner(readers=lambda n=readers: n, count_publishers=lambda _, n=publishers: n)
        voltage.full_name, runner._acknowledged = "/voltage", acknowledged
        present = acknowledged >= 0 or not recorded
        assert runner.is_awaited(recorded) is (readers == complete and publishers == 1 and present)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("failure", ["", "unplugged"])
def test_only_an_open_loop_starts_again_by_itself_after_late_voltages(closed, before, failure):
    started, moved = [], []
    runner, _ = pretended_runner(loop_complete=lambda: closed, finish=lambda: moved.append("finished"))
    runner._look_for_losses = lambda: None
    runner._ended = False
    part, node = runner.node.part, runner.node
    part.tripped, part.failure, part.start = True, failure, lambda: started.append(1)
    node.parameters.samples = 100
    node.stamps = SimpleNamespace(are_off_clock=False, go_on=moved.append)
    node.sample = 99
    runner.go_to_next(before, behind=False)
    assert bool(started) is (not closed and not before and not failure)
    assert not moved and not runner._ended
    node.sample = 100
    runner.go_to_next(before, behind=True)
    assert moved == [100, "finished"] and runner._ended


def presence(runner, text):
    runner._on_presence(String(data=text))


def with_partners(**state):
    """Return a pretended runner whose node reports what it loses."""
    lost = []
    runner, voltage = pretended_runner(active=True, running=True, lock=nullcontext(), **state)
    runner.node.kind = "plant_simulator"
    runner.node.lose = lambda name: lost.append(name) or setattr(runner.node.part, "lost", name)
    runner.node.warn = lambda *_, **__: None
    runner._lost = {}
    return runner, voltage, lost


def test_nodes_that_announce_their_stop_and_return_are_not_lost_and_voltages_are_counted_anew():
    runner, voltage, lost = with_partners()
    presence(runner, "gone motion_controller")
    assert runner._gone == {"motion_controller"} and runner._is_open and not runner._settling
    presence(runner, "gone recorder")
    assert runner._gone == {"motion_controller"}, "only a node that closes the loop opens it"
    runner._settling, voltage.first = 0, -100.0
    presence(runner, "here motion_controller")
    assert not runner._gone and runner._coming == runner._known == {"motion_controller"} and not runner._is_open
    assert runner._settling == SETTLED and voltage.first > 0.0, "its silence counts from now on"
    presence(runner, "gone plant_simulator")
    assert not runner._gone and not lost


@pytest.mark.parametrize("state", ["lost", "heard"])
def test_a_loss_that_another_node_reports_stops_an_axis_that_runs(state):
    for active, running, reporter, tripped in itertools.product(
        (True, False), (True, False), ("motion_controller", "plant_simulator"), (True, False)
    ):
        runner, _, lost = with_partners()
        runner.node.active, runner.node.running, runner.node.part.tripped = active, running, tripped
        presence(runner, f"{state} plant_simulator {reporter} hysteresis_compensator")
        heard = active and running and reporter != "plant_simulator"
        # repeated for a plant that was restarted and may have missed the first message
        assert lost == (["hysteresis_compensator"] if heard and (state == "lost" or not tripped) else [])
        assert runner._lost == ({reporter: "hysteresis_compensator"} if heard and state == "lost" else {})
        runner.node.inputs = []
        assert runner.missing_partners() == ("hysteresis_compensator" if runner._lost else "")
        presence(runner, f"here {reporter}")
        assert reporter == "plant_simulator" or not runner._lost


@pytest.mark.parametrize("why", ["", "other topic", "first voltage", "announced", "coming", "stopped", "lost before"])
def test_voltages_of_another_process_are_those_of_a_lost_node_unless_it_has_announced_its_stop(why):
    runner, voltage, lost = with_partners()
    voltage.full_name = "/voltage"
    voltage.count = 0 if why == "first voltage" else 20
    runner._gone = {voltage.partner} if why == "announced" else set()
    runner._coming = {voltage.partner} if why == "coming" else set()
    runner.node.running = why != "stopped"
    runner.node.part.lost = "motion_controller" if why == "lost before" else ""
    runner.replaced("/command" if why == "other topic" else "/voltage", "")
    assert lost == ([] if why else ["hysteresis_compensator"])


@pytest.mark.parametrize("why", ["", "voltages come", "announced", "leaving", "reported", "lost before"])
def test_voltages_that_stop_unannounced_stop_the_axis_once(why):
    runner, voltage, lost = with_partners()
    repeated = []
    runner._awake_time = SimpleNamespace(look=lambda now: 1000.0)
    runner._heard, voltage.received, voltage.first = {"voltage": 0.0}, 100.0, 0.0
    part, node = runner.node.part, runner.node
    part.silent, part.lose = why != "voltages come", repeated.append
    runner._gone = {"motion_controller"} if why == "announced" else set()
    node.leaving = why == "leaving"
    runner._lost = {"motion_controller": "hysteresis_compensator"} if why == "reported" else {}
    part.lost = "motion_controller" if why == "lost before" else ""
    runner._look_for_losses()
    assert lost == ([] if why else ["hysteresis_compensator"])
    # late voltages since then are no other reason
    assert repeated == {"": ["hysteresis_compensator"], "lost before": ["motion_controller"]}.get(why, [])
