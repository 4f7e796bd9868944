# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An inchworm's nodes: the offline twin's numbers in lockstep, replayed requests, and clamps that hold in faults."""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import ROOT, shortened, until, write_axis  # noqa: E402

from hysteresis_ros.models.inchworm import POSITION  # noqa: E402
from hysteresis_ros.references import inchworm_layout as at  # noqa: E402
from hysteresis_ros.references.inchworm_sequencer import read_walk  # noqa: E402
from hysteresis_ros.signals import MOTOR_COLUMNS  # noqa: E402

NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "inchworm_sequencer")
GRIP, THRESHOLD = 100.0, 60.0
#: A gait of 140 samples per cycle, for longer walks. It is the limit: with 2 ms the motion throws the slider off.
QUICK = {f"gait__{name}": 1.0e-3 for name in ("release", "grip", "settle")}
QUICK |= {f"gait__{name}": 4.0e-3 for name in ("extend", "contract")}
CYCLE = 140
#: Continuous walking over the phase of its cycle.
WALK = {"walk__continuous": True, "walk__learning_speed": 4.0e-4, "walk__swing": 456.0}


def motor(**common):
    """Return the motor of config/inchworm_travel.yaml with a fast gait, on the way to 0.2 mm."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.parameters import AxisParameters

    configuration = load_configuration(ROOT / "config" / "inchworm_travel.yaml").override("", **common)
    schedule = {"setpoints__values": [2.0e-4], "setpoints__times": [2.0e-3]}
    configuration = configuration.override("inchworm_sequencer", **QUICK, **WALK, **schedule)
    configuration = configuration.override("plant_simulator", real_time_factor=0.05)
    return AxisParameters.from_configuration(configuration)


def compose(inside, axis, **classes):
    """Make the nodes of the axis in this process; returns them by name."""
    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.inchworm_sequencer import InchwormSequencerNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode
    from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode

    made = (PlantSimulatorNode, HysteresisCompensatorNode, MotionControllerNode, InchwormSequencerNode)
    return {name: inside.add(cls, getattr(axis, name)) for name, cls in zip(NODES, made, strict=True)}


@pytest.mark.parametrize(("how", "samples"), [("--processes", 300), ("--composed", 600)])
def test_recorded_run_equals_offline_twin_bit_for_bit(processes, tmp_path, how, samples):
    from hysteresis_ros.recordings.files import load_run

    axis = shortened(motor(time_mode="lockstep", exit_at_end=True), samples)
    path = write_axis(tmp_path / "axis.yaml", axis)
    run = processes.command("up", path, how, "--record", str(tmp_path / "bag"), "--verify")
    assert run.wait() == 0, run.output
    assert f"{samples} samples equal the offline twin bit for bit, none missing" in run.output
    recorded = load_run(tmp_path / "bag")
    assert set(MOTOR_COLUMNS) <= set(recorded.signals)
    # the run contains motion worth comparing
    assert recorded["total_steps"][-1] == pytest.approx(samples / CYCLE, abs=1.5)
    assert recorded["displacement"][-1] == pytest.approx(8.0e-6 * samples / CYCLE, abs=1.2e-5)
    assert np.min(np.maximum(recorded["front_voltage"], recorded["rear_voltage"])) > THRESHOLD


@pytest.fixture
def recorded_run(inside, observer, tmp_path):
    """An endless lockstep run with a recorder; the states of its sequencer, and a function that ends the run."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    from hysteresis_ros.nodes.recorder import RecorderNode
    from hysteresis_ros.recordings.files import load_run

    axis = motor(time_mode="lockstep")
    axis = replace(
        axis,
        plant_simulator=replace(axis.plant_simulator, wait_for_recorder=True),
        recorder=replace(axis.recorder, path=str(tmp_path / "bag"), inchworm=True),
    )
    walk = replace(axis.inchworm_sequencer.walk, save_file=str(tmp_path / "walk.yaml"))
    axis = replace(axis, inchworm_sequencer=replace(axis.inchworm_sequencer, walk=walk))
    recorder = inside.add(RecorderNode, axis.recorder)
    nodes = compose(inside, axis)
    heard = observer.listen(JointState, "/inchworm_sequencer/state", QoSProfile(depth=5000))
    until(lambda: nodes["plant_simulator"].count_subscribers("/inchworm_sequencer/state") == 2)
    inside.spin()

    def end():
        plant = nodes["plant_simulator"]
        plant.running = False
        until(lambda: not plant.runner.is_measured and min(recorder._counts) == plant.sample, what="the last messages")
        recorder.release()
        assert not any(node.failure for node in inside.nodes)
        return axis, load_run(tmp_path / "bag", further=True)

    return nodes, heard, end


def test_a_motor_that_walks_in_steps_refuses_to_learn(inside):
    from std_srvs.srv import Trigger

    from hysteresis_ros.nodes.inchworm_sequencer import InchwormSequencerNode
    from hysteresis_ros.nodes.parameters import answered

    given = motor().inchworm_sequencer
    given = replace(given, walk=replace(given.walk, continuous=False))
    sequencer = inside.add(InchwormSequencerNode, given, autostart=False)
    assert sequencer.configure_now()
    answer = answered(sequencer._on_learn)(None, Trigger.Response())
    assert not answer.success and "only continuous walking learns" in answer.message


def test_what_people_ask_takes_effect_safely_and_is_replayed_bit_for_bit(recorded_run, observer, tmp_path):
    from std_msgs.msg import Float64

    from hysteresis_ros.loop.simulation import differences

    nodes, heard, end = recorded_run
    sequencer = nodes["inchworm_sequencer"]
    place = {name: index for index, name in enumerate(sequencer.state_names)}

    def now(name):
        return heard[-1].position[place[name]]

    setpoint, speed = (observer.talk(Float64, topic) for topic in ("/setpoint", "/speed"))
    until(lambda: setpoint.get_subscription_count() and speed.get_subscription_count())
    until(lambda: heard and now("steps") > 2, what="the motor walking")
    assert observer.trigger("/inchworm_sequencer/stop").success
    stopped = sequencer.sample
    until(lambda: sequencer.sample > stopped + 100 and now("phase") == at.HOLDING, what="the motor standing")
    setpoint.publish(Float64(data=1.0e-2))
    setpoint.publish(Float64(data=float("nan")))
    until(lambda: sequencer.refused == 2, what="refusals")
    assert sequencer.setpoint == 2.0e-4
    setpoint.publish(Float64(data=-2.4e-5))
    until(lambda: now("setpoint") == -2.4e-5)
    assert now("steps") == now("total_steps")  # stopped is stopped
    assert observer.trigger("/inchworm_sequencer/start").success
    until(lambda: now("arrived"), what="arrival")
    speed.publish(Float64(data=1.0))
    until(lambda: sequencer.refused == 3, what="a speed beyond the gait is refused")
    speed.publish(Float64(data=4.0e-4))
    assert observer.trigger("/inchworm_sequencer/learn").success
    until(lambda: sequencer.sequencer.x[at.LEARNED_CYCLES] > 2, what="continuous walking that is learned from")
    assert observer.trigger("/inchworm_sequencer/freeze").success
    until(lambda: now("request") == at.FREEZE_REQUEST or not sequencer.sequencer.x[at.LEARNS], what="freezing")
    saved = observer.trigger("/inchworm_sequencer/save")
    assert saved.success and saved.message.endswith("walk.yaml")
    setpoint.publish(Float64(data=-2.4e-5))  # a repeated value counts as a new request
    until(lambda: now("arrived") and now("speed") == 0.0, what="back at the setpoint")
    assert observer.trigger("/inchworm_sequencer/home").success
    until(lambda: now("setpoint") == 0.0 and now("arrived"), what="home")
    assert observer.trigger("/inchworm_sequencer/release").success
    until(lambda: now("phase") == at.RELEASED, what="the front clamp open")
    accepted, reason = observer.set_parameters("/inchworm_sequencer", gait__grip=2.0e-3)
    assert not accepted and "read-only" in reason
    assert observer.set_parameters("/inchworm_sequencer", measurement_timeout=0.3) == (True, "")
    axis, run = end()

    assert differences(run, axis) == {}
    learned = axis.inchworm_sequencer.walk
    read = read_walk(learned.save_file, learned.splines, learned.step, learned.bound)
    assert np.any(read.forward) and not np.any(read.backward)
    np.testing.assert_array_equal(read.forward, sequencer.sequencer.learned_walk.forward)
    assert list(run["request"][run["request"] > 0.0]) == [
        at.STOP_REQUEST,
        at.START_REQUEST,
        at.LEARN_REQUEST,
        at.FREEZE_REQUEST,
        at.HOME_REQUEST,
        at.RELEASE_REQUEST,
    ]
    front, rear = run["front_voltage"], run["rear_voltage"]
    assert np.min(np.maximum(front, rear)) > THRESHOLD
    # stop: both clamps closed within one phase, and the slider at its position
    stop = int(np.flatnonzero(run["request"] == at.STOP_REQUEST)[0])
    start = int(np.flatnonzero(run["request"] == at.START_REQUEST)[0])
    longest = round(4.0e-3 * axis.plant_simulator.sample_rate)
    assert np.all(front[stop + longest : start] == GRIP) and np.all(rear[stop + longest : start] == GRIP)
    held = run["displacement"][stop + longest : start]
    assert abs(held[0] - run["displacement"][stop]) < 8.0e-6 and np.ptp(held) < 1.0e-9
    # released: the rear clamp holds alone
    assert (front[-1], rear[-1]) == (0.0, GRIP)
    # at home, just within the tolerance
    home = int(np.flatnonzero(run["request"] == at.RELEASE_REQUEST)[0])
    assert abs(run["displacement"][home]) < 1.0e-7
    # the same through a file, as `hysteresis simulate --setpoints` takes it
    from hysteresis_ros.loop.simulation import simulate
    from hysteresis_ros.recordings.align import setpoints_per_sample
    from hysteresis_ros.recordings.dataset import requests_per_sample
    from hysteresis_ros.recordings.files import load_run, save_run

    save_run(run, tmp_path / "run.npz")
    table = load_run(tmp_path / "run.npz")
    twin = simulate(axis, setpoints=setpoints_per_sample(table), **requests_per_sample(table))
    assert np.array_equal(twin["displacement"], run["displacement"])
    save_run(twin, tmp_path / "twin.mcap")
    again = load_run(tmp_path / "twin.mcap", namespace="")
    assert all(np.array_equal(again[name], twin[name]) for name in ("origin", "phase", "rear_voltage", "extender"))


def test_missing_measurement_closes_both_clamps_until_it_is_back(inside, observer):
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    nodes = compose(inside, shortened(motor(time_mode="lockstep"), 700))
    plant = nodes["plant_simulator"]
    sense = plant.sense

    def lossy():
        sense()
        if 200 <= plant.sample < 400:
            plant.part.arrays.x.joints[POSITION] = math.nan

    plant.sense = lossy
    heard = observer.listen(JointState, "/inchworm_sequencer/state", QoSProfile(depth=2000))
    until(lambda: plant.count_subscribers("/inchworm_sequencer/state"))
    inside.spin()
    until(lambda: len(heard) == 700, what="the run")
    table = np.array([message.position for message in heard])
    columns = dict(zip(nodes["inchworm_sequencer"].state_names, table.T, strict=True))
    assert not any(node.failure for node in inside.nodes)
    assert set(columns["error"][215:400]) == {at.SENSOR_ERROR} and columns["error"][400] == at.NO_ERROR
    both = np.minimum(columns["front_voltage"], columns["rear_voltage"])
    assert np.all(both[240:400] == GRIP)
    assert np.min(np.maximum(columns["front_voltage"], columns["rear_voltage"])) > THRESHOLD
    assert columns["total_steps"][-1] > columns["total_steps"][400]  # it continues to walk
    assert nodes["motion_controller"].rejected == 200


def test_plant_that_lacks_one_clamp_voltage_names_the_sequencer(inside):
    nodes = compose(inside, motor(time_mode="lockstep", partner_timeout=2.0))
    plant, sequencer = nodes["plant_simulator"], nodes["inchworm_sequencer"]
    inside.spin()
    until(lambda: plant.sample > 20)
    sequencer._outputs = sequencer._outputs[:3]
    until(lambda: plant.failure)
    assert "inchworm_sequencer (topic rear_clamp/voltage) has been silent" in plant.failure
    until(lambda: all(node.failure for node in inside.nodes), what="everybody told")


def test_killed_sequencer_is_named_by_everybody(processes, observer, tmp_path):
    from sensor_msgs.msg import JointState

    path = write_axis(tmp_path / "axis.yaml", motor(time_mode="lockstep", partner_timeout=5.0))
    heard = observer.listen(JointState, "/joint_states")
    started = {name: processes.node(name, path) for name in NODES}
    until(lambda: len(heard) > 50, what="the run to be under way")
    assert list(heard[-1].name) == ["slider", "extender", "front_clamp", "rear_clamp"]
    started["inchworm_sequencer"].send(signal.SIGKILL)
    for name in NODES[:3]:
        process = started[name]
        assert process.wait(20.0) == 1, f"{name}: {process.output}"
        line = next(line for line in process.output.splitlines() if "[ERROR]" in line)
        assert "inchworm_sequencer" in line.split("]: ", 1)[1], f"{name} says: {line}"


def test_realtime_walks_and_closes_the_clamps_whoever_leaves(inside, observer):
    from rclpy.qos import QoSProfile
    from std_msgs.msg import Float64

    axis = motor(time_mode="realtime")
    # 100 samples a second, which a busy machine holds too
    slow = replace(axis.plant_simulator, real_time_factor=0.01, voltage_timeout=0.01, safe_slew_rate=1.0e5)
    slow = replace(slow, late_limit=-1)
    # late voltages of a busy machine let the slider slip, which is not the subject
    guard = replace(axis.inchworm_sequencer.guard, runaway=1.0, still_steps=1000)
    unguarded = replace(axis.inchworm_sequencer, guard=guard)
    nodes = compose(inside, replace(axis, plant_simulator=slow, inchworm_sequencer=unguarded))
    plant, sequencer = nodes["plant_simulator"], nodes["inchworm_sequencer"]
    voltages = {
        name: observer.listen(Float64, f"/{name}/voltage", QoSProfile(depth=1000))
        for name in ("front_clamp", "rear_clamp")
    }
    until(lambda: plant.count_subscribers("/front_clamp/voltage") == 2)
    inside.spin()
    # two steps, and more on a busy machine: late voltages shorten them
    until(lambda: sequencer.sequencer.x[at.STEPS] >= 2.0 and plant.part.motor.displacement > 8.0e-6, what="two steps")
    # the sequencer freezes during a step: the plant closes open clamps, the controller holds, and the axis stops
    until(lambda: sequencer.sequencer.phase == "carrying")
    sequencer.active = False
    until(lambda: nodes["motion_controller"].unpaired, what="the controller without a command")
    until(lambda: plant.part.lost, what="the plant's watchdog")
    until(lambda: min(plant.part.motor.voltages[1:]) > GRIP - 0.01, what="both clamps closed")
    assert plant.health()[0] == 2 and "inchworm_sequencer is lost" in plant.health()[1]
    # it returns, and continues to walk once somebody has started the axis
    sequencer.active = True
    until(lambda: not plant.part.silent, what="voltages again")
    where = plant.part.motor.displacement
    until(lambda: observer.trigger("/plant_simulator/start").success, what="the axis started again")
    until(lambda: plant.part.motor.displacement > where + 8.0e-6, what="walking again")
    until(lambda: not nodes["motion_controller"].unpaired, what="the controller with its commands")
    # regular exit: both clamps closed, voltages on
    until(lambda: sequencer.sequencer.phase == "carrying")
    assert observer.transition("/inchworm_sequencer", "deactivate")
    until(lambda: all(heard[-1].data == GRIP for heard in voltages.values()), what="closing voltages")
    assert sequencer.sequencer.phase == "holding"
    # and when measurements stop
    assert observer.transition("/inchworm_sequencer", "activate")
    until(lambda: sequencer.sequencer.phase == "carrying")
    assert observer.trigger("/plant_simulator/stop").success
    until(lambda: sequencer.stale and sequencer.sequencer.phase == "holding", what="the sequencer's watchdog")
    until(
        lambda: all(heard[-1].data == GRIP for heard in voltages.values()), what="closing voltages without measurements"
    )
    assert "joint_states is stale" in sequencer.health()[1]
