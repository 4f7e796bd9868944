# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis run by one compiled thread: controlled and shown over DDS, recorded completely, repeated bit for bit."""

from __future__ import annotations

import re
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, until, write_axis  # noqa: E402
from steered_support import COMPENSATOR, CONTROLLER, PLANT, Steered  # noqa: E402

from hysteresis_ros.models.block import COMPILED  # noqa: E402

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba the fused loop is too slow for these axes")


@pytest.mark.parametrize(("config", "rate"), [("kim2009", 3000), ("inchworm_travel", 10000)])
def test_a_recorded_run_in_real_time_equals_the_offline_twin(processes, tmp_path, config, rate):
    asked = ("--duration", "1", "--record", str(tmp_path / "bag"), "--verify")
    run = processes.command("up", config, "--fused", *asked)
    assert run.wait(300.0) == 0, run.output
    assert f"{rate} samples equal the offline twin bit for bit, none missing" in run.output
    assert not re.search("Traceback|died", run.output)


def test_a_rate_that_this_machine_does_not_hold_is_refused_with_the_figure_and_nothing_moves(processes):
    asked = ("--factor", "1000", "--duration", "1", "--record", str(processes.folder / "bag"))
    run = processes.command("up", "inchworm_travel", "--fused", *asked)
    assert run.wait() == 2, run.output
    assert "real_time_factor 1000: a sample takes" in run.output and "--force" in run.output
    assert "samples in" not in run.output


@pytest.fixture
def steered(processes, observer, tmp_path):
    return Steered(processes, observer, tmp_path)


def test_everything_that_people_ask_of_it_takes_effect_and_is_repeated_bit_for_bit(steered, observer):
    steered.ask(5e-6)
    steered.at(5e-6)
    assert observer.set_parameters(f"/{CONTROLLER}", sliding_mode__phi=0.9) == (True, "")
    accepted, reason = observer.set_parameters(f"/{CONTROLLER}", sliding_mode__phi=2.0)
    assert not accepted and "sliding_mode.phi" in reason
    assert observer.set_parameters(f"/{CONTROLLER}", type="pid", pid__Ki=30.0) == (True, "")
    assert observer.set_parameters(f"/{COMPENSATOR}", hysteresis__polynomial__scale=1.01) == (True, "")
    assert observer.set_parameters(f"/{PLANT}", preload__force=0.1) == (True, "")
    steered.ask(3e-6)
    steered.at(3e-6)
    # a stopped part, and a part whose node is deactivated, goes to safe and returns
    assert observer.trigger(f"/{CONTROLLER}/stop").success
    until(lambda: abs(steered.commands[-1].data) < 1e-12, what="the safe command")
    assert observer.trigger(f"/{CONTROLLER}/start").success
    steered.at(3e-6)
    assert observer.transition(f"/{COMPENSATOR}", "deactivate")
    steered.safe()
    assert observer.transition(f"/{COMPENSATOR}", "activate")
    steered.at(3e-6)
    # resets, and a plant that is deactivated
    assert observer.trigger(f"/{PLANT}/reset").success
    steered.at(0.0)  # the configured setpoint
    steered.ask(4e-6)
    steered.at(4e-6)
    assert not observer.trigger(f"/{CONTROLLER}/reset").success  # alone on a running axis
    assert observer.trigger(f"/{CONTROLLER}/stop").success
    until(lambda: observer.trigger(f"/{CONTROLLER}/reset").success, what="a controller that rests")
    assert observer.trigger(f"/{CONTROLLER}/start").success
    steered.at(4e-6)
    assert observer.transition(f"/{PLANT}", "deactivate")
    silent = len(steered.states)
    assert observer.transition(f"/{PLANT}", "activate")
    until(lambda: len(steered.states) > silent + 10, what="samples of the active plant")
    steered.at(4e-6)
    text = steered.verified()
    assert "equal the offline twin bit for bit, none missing" in text
    assert int(text.split(": ")[1].split()[0]) > 1000


def test_an_emergency_stop_is_latched_until_the_plant_is_started(steered, observer):
    from hysteresis_ros.recordings.files import load_run

    for how in ("estop", "stop"):
        steered.ask(6e-6)
        steered.at(6e-6)
        if how == "estop":
            steered.stop_at_once()
        else:
            answer = observer.trigger(f"/{PLANT}/stop")
            assert answer.success and answer.message == "stopped: the voltage goes to safe_voltage = 0 V"
        until(lambda: steered.now("tripped") != 0.0, what="the stop")
        answer = observer.trigger(f"/{CONTROLLER}/start")
        assert not answer.success and "the plant has stopped the axis" in answer.message
        steered.safe()
        steered.ask(4e-6)  # has no effect
        seen = len(steered.states)
        until(lambda seen=seen: len(steered.states) > seen + 20)
        steered.safe()
        assert steered.joints[-1].header.frame_id == "tripped"
        for node in (PLANT, CONTROLLER, COMPENSATOR):  # at once, before the next sample is published
            answer = observer.trigger(f"/{node}/start")
            assert answer.success and answer.message == "running"
        steered.at(4e-6)
    until(lambda: steered.run.output.count("emergency stop") >= 2, what="both stops in the log")
    steered.verified()
    run = load_run(steered.bag, further=True)
    stops = np.flatnonzero(np.diff((run["tripped"] != 0.0).astype(int)) == 1) + 1
    assert stops.size >= 2  # the exit is one too
    for first in stops:
        # within one sample: if the axis trips, the voltage already moves, by no more than its slew rate
        voltages = run["plant_voltage"][first - 1 : first + 300]
        assert abs(voltages[1]) < abs(voltages[0]) and max(abs(voltages[1:] - voltages[:-1])) <= 1000.0 / 3000.0 + 1e-2


def test_a_node_that_is_cleaned_up_ends_the_loop_safely_and_a_new_one_begins_with_it(steered, observer):
    topics_show_samples_at_their_rate_with_their_stamps(steered)
    for node in (CONTROLLER, PLANT):
        steered.ask(5e-6)
        steered.at(5e-6)
        for transition in ("deactivate", "cleanup"):
            assert observer.transition(f"/{node}", transition)
        assert observer.trigger(f"/{node}/reset") is not None
        if node == CONTROLLER:
            assert abs(steered.now("voltage")) < 0.01
        silent = len(steered.states)
        for transition in ("configure", "activate"):
            assert observer.transition(f"/{node}", transition)
        until(lambda silent=silent: len(steered.states) > silent + 10, what="samples of a new loop")
        steered.ask(4e-6)
        steered.at(4e-6)
    code, _ = steered.run.leave(signal.SIGINT)
    assert code == 0 and "Traceback" not in steered.run.output, steered.run.output


def topics_show_samples_at_their_rate_with_their_stamps(steered) -> None:
    """Compare the stamps of the states with the rate of the loop and the rate of the topics."""
    until(lambda: len(steered.states) > 50)
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in steered.states]
    samples = [(stamp - stamps[0]) * 3000 / 1e9 for stamp in stamps]
    assert all(abs(sample - round(sample)) < 1e-3 for sample in samples)
    steps = sorted(b - a for a, b in zip(samples, samples[1:], strict=False))
    assert steps[0] > 0 and abs(steps[len(steps) // 2] - 30) < 15  # 100 of 3000 per second


def test_sigkill_leaves_a_recording_that_is_whole_up_to_its_last_half_second(processes, observer, tmp_path):
    from sensor_msgs.msg import JointState

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.files import load_run

    axis = axis_parameters(overrides={PLANT: {"late_limit": -1}}, time_mode="fused")
    axis = replace(axis, recorder=replace(axis.recorder, path=str(tmp_path / "bag")))
    path = write_axis(tmp_path / "axis.yaml", axis)
    text = tmp_path / "configuration.yaml"
    text.write_text(axis.configuration_text(), encoding="utf-8")
    axis = replace(axis, recorder=replace(axis.recorder, configuration=str(text)))
    write_axis(tmp_path / "axis.yaml", axis)
    command = [sys.executable, "-m", "hysteresis_ros.nodes.axis", "--recorder", "--ros-args", "--params-file", path]
    states = observer.listen(JointState, f"/{PLANT}/state")
    axis_process = processes.start(command, "axis")
    until(lambda: len(states) > 300, what="three seconds of samples")
    axis_process.send(signal.SIGKILL)
    axis_process.wait()
    last = states[-1].header.stamp
    run = load_run(tmp_path / "bag", further=True)
    assert differences(run, axis) == {} and run.metadata["missing_samples"] == 0
    begun = run.metadata["start_time_ns"]
    reached = (last.sec * 10**9 + last.nanosec - begun) / 1e9
    assert reached - run.time[-1] < 0.5


def test_a_node_of_a_fused_axis_cannot_be_alone(processes, tmp_path):
    path = write_axis(tmp_path / "axis.yaml", axis_parameters(time_mode="fused"))
    node = processes.node("motion_controller", path)
    assert node.wait() == 2
    assert "time_mode" in node.output and "hysteresis_axis" in node.output and "Traceback" not in node.output


def test_options_that_exclude_each_other_are_refused(processes):
    run = processes.command("up", "kim2009", "--fused", "--rate", "lockstep")
    assert run.wait() == 2 and "--fused" in run.output


def test_an_emergency_stop_works_without_a_loop_too(inside, observer):
    from std_msgs.msg import Bool

    axis = axis_parameters(overrides={PLANT: {"real_time_factor": 0.1, "late_limit": -1}})
    plant, *_ = compose(inside, axis)
    stop = observer.talk(Bool, "/estop")
    inside.spin()
    until(lambda: stop.get_subscription_count() and plant.sample > 10)
    stop.publish(Bool(data=False))
    stop.publish(Bool(data=True))
    until(lambda: plant.part.tripped, what="the stop")
    assert plant.part.halted
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: not plant.part.tripped)
