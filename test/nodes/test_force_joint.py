# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A force joint in the graph: nodes give the bits of the offline twin, and without the joint nothing moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from force_support import IFF  # noqa: E402
from nodes_support import RecordedRun, compose, shortened, until  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.reach import single_axis  # noqa: E402
from hysteresis_ros.loop.simulation import differences  # noqa: E402
from hysteresis_ros.models.sensor import ForceSensorParameters  # noqa: E402


def lockstep_axis(samples: int):
    configuration = load_configuration("stage700").override("", time_mode="lockstep", exit_at_end=True)
    return shortened(single_axis(configuration.override("motion_controller", **IFF)), samples)


def test_the_force_is_published_recorded_and_fed_back_bit_for_bit(inside, observer, tmp_path):
    from sensor_msgs.msg import JointState

    joints = observer.listen(JointState, "/joint_states")
    run = RecordedRun(inside, lockstep_axis(400), tmp_path / "bag")
    inside.spin()
    recorded = run.result()
    assert not differences(recorded, run.axis)
    assert np.all(np.isfinite(recorded["force"])) and np.ptp(recorded["force"]) > 1.0
    assert np.ptp(recorded["command"]) > 1e-6
    until(lambda: joints, what="joint_states")
    assert list(joints[-1].name) == ["stage", "force"]
    assert joints[-1].effort[0] == 0.0 and joints[-1].effort[1] in recorded["force"]


def test_without_the_force_joint_the_run_is_refused_by_its_name(inside):
    axis = lockstep_axis(400)
    # like a third-party node of which no file says that it has no force
    nothing = replace(axis.plant_simulator, force_sensor=ForceSensorParameters())
    _, _, controller, _ = compose(inside, replace(axis, plant_simulator=nothing))
    inside.spin()
    until(lambda: controller.failure, what="the refusal")
    assert "missing force joint 'force': it is not in joint_states, which has ['stage']" in controller.failure
    assert controller.command == 0.0 and controller.sample == 0
