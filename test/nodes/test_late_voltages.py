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
import time
from collections import deque
from functools import partial

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import SOON_AT_REST, Observer, axis_parameters, compose, diagnostics, until  # noqa: E402

from hysteresis_ros.loop.watch import RUNNING, TRIPPED  # noqa: E402
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
        "run the nodes composed",
    ):
        assert words in text, text
    assert "in lockstep" in text and "~/start" in text and "late_limit" in text
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


@pytest.mark.parametrize("pause", [0.03, 0.07])
def test_a_short_halt_of_the_process_is_no_lost_partner(late_axis, pause):
    """A garbage collection in a large process takes this long: messages wait in queues, and no partner is lost."""
    plant, *_ = late_axis(voltage_timeout=0.05, late_limit=-1)
    settled(plant)
    more(plant, 300)  # longer than the time in which new partners are tolerated
    for _ in range(6):
        ctypes.PyDLL(None).usleep(int(1e6 * pause))  # it holds the lock of the interpreter
        more(plant, 20)
        assert not plant.part.lost and not plant.part.tripped
    settled(plant)


def test_who_leaves_comes_back_or_is_reset_is_not_called_late(late_axis, observer):
    # a busy machine may be late sometimes; the exit must not add late voltages
    plant, *_ = late_axis(voltage_timeout=0.05, late_limit=100)
    settled(plant)
    more(plant, 300)  # longer than the time in which new partners are tolerated
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
