# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lockstep: the nodes give the numbers of the offline twin, bit for bit, under any load of the machine."""

from __future__ import annotations

import collections
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import REAL, SINE, axis_parameters, compose, shortened, until, write_axis  # noqa: E402

SAMPLES = 250
PER_SAMPLE = (
    *("/joint_states", "/reference", "/command", "/applied", "/voltage", "/plant_simulator/state"),
    *("/reference_generator/state", "/motion_controller/state", "/hysteresis_compensator/state"),
)


#: Amplifier, converter and transport of a real axis take a third of a sample, which the controller's model contains.
LATE = {
    "plant_simulator": {"dynamics__delay": 1.1e-4},
    "motion_controller": {
        "model__dynamics__delay": 1e-4,
        "sliding_mode__hyperplane": "lq",
        "sliding_mode__S": [],
        "kalman__gain": "riccati",
        "kalman__L": [],
    },
}


def real_axis(**more):
    overrides = {node: values | LATE.get(node, {}) for node, values in REAL.items()}
    overrides["reference_generator"] = REAL["reference_generator"] | SINE
    return axis_parameters(overrides=overrides, time_mode="lockstep", exit_at_end=True, **more)


@pytest.mark.parametrize(
    ("how", "busy"), [("--composed", False), ("--processes", True)], ids=["composed-idle", "processes-busy"]
)
def test_recorded_run_equals_offline_twin_bit_for_bit(processes, tmp_path, how, busy):
    from hysteresis_ros.loop.simulation import differences, simulate
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.files import load_run

    axis = shortened(real_axis(), SAMPLES)
    path = write_axis(tmp_path / "axis.yaml", axis)
    load = processes.busy() if busy else []
    run = processes.command("up", path, how, "--record", str(tmp_path / "bag"), "--verify")
    until(lambda: "real-time factor" in run.output or run.popen.poll() is not None, what="the end of the run")
    for process in load:  # the comparison needs no load
        process.kill()
    assert run.wait() == 0, run.output
    assert "bit for bit" in run.output
    assert f"{SAMPLES} samples in" in run.output and "real-time factor" in run.output
    bag = read_bag(tmp_path / "bag")
    assert {topic: len(bag.topics[topic].data) for topic in PER_SAMPLE} == dict.fromkeys(PER_SAMPLE, SAMPLES)
    recorded = load_run(tmp_path / "bag")
    assert differences(recorded, axis) == {}
    twin = simulate(axis)
    # the run contains motion, noise, saturation and load
    assert np.ptp(twin.signals["displacement"]) > 3e-6
    assert np.std(twin.signals["measured"] - twin.signals["displacement"]) == pytest.approx(5e-9, rel=0.2)
    assert twin.signals["displacement"][0] == pytest.approx(-0.2 / 0.41 * 1e-6, abs=1e-9)
    # signals without a column are compared from their topics
    table = collections.defaultdict(list)
    for topic, signal in (("/applied", "applied"), ("/voltage", "voltage")):
        from hysteresis_ros.recordings.cdr import decode_float64s

        table[signal] = decode_float64s(bag.topics[topic].data, topic)
    from hysteresis_ros.loop.axis import Axis

    offline = Axis(axis).run(np.zeros(SAMPLES))
    for signal, values in table.items():
        assert np.array_equal(values, offline[signal]), signal


def test_inverse_dynamics_with_preview_are_the_same_in_the_nodes(processes, tmp_path):
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.files import load_run

    axis = shortened(real_axis(), 300)
    ahead = replace(axis.motion_controller.feedforward, type="inverse_dynamics", preview=8)
    axis = replace(axis, motion_controller=replace(axis.motion_controller, type="open_loop", feedforward=ahead))
    path = write_axis(tmp_path / "axis.yaml", axis)
    run = processes.command("up", path, "--composed", "--record", str(tmp_path / "bag"), "--verify")
    assert run.wait() == 0, run.output
    assert "300 samples equal the offline twin bit for bit" in run.output
    assert "warning: motion_controller: feedforward.preview = 8" in run.output
    recorded = load_run(tmp_path / "bag")
    assert differences(recorded, axis) == {}
    # the commands are those of the inverse: neither the received nor the delayed reference
    delayed = np.concatenate([np.full(8, recorded["reference"][0]), recorded["reference"][:-8]])
    assert np.max(np.abs(recorded["command"] - delayed)) > 1e-8
    assert np.max(np.abs(recorded["command"] - recorded["reference"])) > 1e-8


def states(heard):
    return [(m.header.stamp.sec, m.header.stamp.nanosec, *m.position) for m in heard]


def test_reset_of_all_nodes_gives_the_same_numbers_again(inside, observer):
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    axis = shortened(replace(real_axis()), 400, wait_for_recorder=False)
    axis = replace(
        axis, **{n: replace(getattr(axis, n), exit_at_end=False) for n in ("plant_simulator", "motion_controller")}
    )
    plant, compensator, controller, generator = compose(inside, axis)
    for node in inside.nodes:
        node.parameters = replace(node.parameters, exit_at_end=False)
    heard = observer.listen(JointState, "/plant_simulator/state", QoSProfile(depth=2000))
    until(lambda: plant.count_subscribers("/plant_simulator/state"))
    inside.spin()
    until(lambda: plant.end_of_run == 400 and len(heard) == 400, what="first run")
    first = states(heard)
    for name in ("reference_generator", "motion_controller", "hysteresis_compensator", "plant_simulator"):
        assert observer.trigger(f"/{name}/reset").success
    until(lambda: len(heard) == 800, what="second run")
    np.testing.assert_array_equal(states(heard)[400:], first)  # a force that is not measured is NaN
    assert first[0][:2] == (0, 0)
    # and in the middle of a halted run
    assert all(observer.trigger(f"/{n}/reset").success for n in ("reference_generator", "motion_controller"))
    assert all(observer.trigger(f"/{n}/reset").success for n in ("hysteresis_compensator", "plant_simulator"))
    until(lambda: len(heard) > 810)
    assert observer.trigger("/plant_simulator/stop").success
    for name in ("reference_generator", "motion_controller", "hysteresis_compensator", "plant_simulator"):
        assert observer.trigger(f"/{name}/reset").success
    before = len(heard)
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: len(heard) == before + 400, what="fourth run")
    np.testing.assert_array_equal(states(heard)[before:], first)
    assert not any(node.failure for node in inside.nodes)


def test_nodes_activated_in_any_order_and_again(inside, observer):
    """Lifecycle by the standard services; the plant is first, so sample 0 exists before the others are active."""
    axis = shortened(real_axis(autostart=False), 200)
    nodes = compose(inside, axis, autostart=False)
    for node in nodes:
        assert node.autostart is False
    inside.spin()
    names = [f"/{node.get_name()}" for node in nodes]
    for name in names:
        assert observer.transition(name, "configure")
    for node in nodes:
        node.parameters = replace(node.parameters, exit_at_end=False)
    for name in names:
        assert observer.transition(name, "activate")
    until(lambda: nodes[0].end_of_run == 200)
    for name in names:
        assert observer.transition(name, "deactivate")
        assert observer.transition(name, "cleanup")
    for name in reversed(names):
        assert observer.transition(name, "configure")
    for name in reversed(names):
        assert observer.transition(name, "activate")
    until(lambda: nodes[0].end_of_run == 200, what="a second run after cleanup and configure")
    assert not any(node.failure for node in nodes)
