# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples written in batches equal the messages that the nodes publish one by one: byte for byte, for each topic."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import REAL, ROOT, SINE, axis_parameters, shortened, write_axis  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.models.inchworm import JOINT_NAMES, TRUE_POSITION  # noqa: E402

SAMPLES = 300
#: Voltages that are repeatedly late, and the number that the plant accepts before it stops the axis.
FAULTS = ["late_voltage:0.02:1.0:0.5"]
LIMIT = 20


def actuator():
    """Return Kim's axis with noise, limits, preload, and a trip."""
    overrides = {**REAL, "reference_generator": REAL["reference_generator"] | SINE}
    overrides["plant_simulator"] = REAL["plant_simulator"] | {"late_limit": LIMIT}
    return axis_parameters("left", overrides=overrides, faults=FAULTS, time_mode="lockstep", exit_at_end=True)


def motor():
    """Return the moving inchworm, and a trip."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.parameters import AxisParameters

    configuration = load_configuration(ROOT / "config" / "inchworm_travel.yaml")
    configuration = configuration.override("", time_mode="lockstep", exit_at_end=True, faults=FAULTS)
    configuration = configuration.override("plant_simulator", late_limit=LIMIT)
    return AxisParameters.from_configuration(configuration)


def samples_of(axis):
    """Simulate an axis; return stamps, table and the plant's joints (None for an actuator)."""
    from hysteresis_ros.loop.axis import Axis

    run = Axis(axis)
    names = [signal.name for signal in run.kind.row]
    columns, joints = [], []
    for setpoint in run.default_setpoints(SAMPLES):
        made = run.run([setpoint])
        columns.append([made[name][0] for name in names])
        if run.kind.motor:
            joints.append(run.plant.arrays.x.joints[:TRUE_POSITION].copy())
    stamps = [round(k * 1e9 / run.sample_rate) for k in range(SAMPLES)]
    return np.array(stamps), np.transpose(columns), np.transpose(joints) if joints else None


@pytest.mark.parametrize(("axis", "namespace"), [(actuator, "left"), (motor, "")])
def test_batches_give_the_bytes_that_the_nodes_publish(processes, tmp_path, axis, namespace):
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.bag_writer import BagWriter
    from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter

    given = shortened(axis(), SAMPLES)
    run = processes.command(
        "up", write_axis(tmp_path / "axis.yaml", given), "--composed", "--record", str(tmp_path / "one_by_one")
    )
    assert run.wait() == 0, run.output
    plant = given.plant_simulator
    is_motor = given.kind.motor
    topics = AxisTopics(
        namespace=namespace,
        joints=(plant.joint, *JOINT_NAMES[1:]) if is_motor else (plant.joint,),
        sample_rate=plant.sample_rate,
        kind=given.kind,
        force=plant.preload.force,
        durability="transient_local",
    )
    stamps, table, joints = samples_of(given)
    one_by_one = read_bag(tmp_path / "one_by_one").topics
    text = f"{topics.prefix}/configuration"
    with BagWriter(tmp_path / "batches") as bag:
        bag.add_topic(text, "std_msgs/msg/String", "transient_local")
        bag.write(text, "std_msgs/msg/String", one_by_one[text].data[0], 0)
        writer = SampleWriter(bag, topics)
        writer.write(stamps[:123], table[:, :123], joints=joints[:, :123] if is_motor else None)
        writer.write(stamps[123:], table[:, 123:], joints=joints[:, 123:] if is_motor else None)

    batches = read_bag(tmp_path / "batches").topics
    # the axis was stopped during the run, and the comparison includes every field of the messages
    assert 0 < np.count_nonzero(table[signals.TRIPPED]) < SAMPLES
    for topic in writer.topics:
        assert one_by_one[topic].type_name == batches[topic].type_name
        assert len(one_by_one[topic].data) == SAMPLES
        assert one_by_one[topic].data == batches[topic].data, topic
    others = {name for name, topic in one_by_one.items() if name not in writer.topics and topic.data}
    assert others <= {text, "/diagnostics", f"{topics.prefix}/changes"}
    check = processes.command("verify", str(tmp_path / "batches"))
    assert check.wait() == 0, check.output
    assert f"{SAMPLES} samples equal the offline twin bit for bit, none missing" in check.output
