# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Messages with more content than an axis can use are refused with a reason, at little cost."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from hysteresis_ros.errors import LONGEST, ParameterError  # noqa: E402
from hysteresis_ros.nodes.lockstep import LONGEST_REASON, Lockstep  # noqa: E402
from hysteresis_ros.nodes.responder import MOST_JOINTS, Responder  # noqa: E402
from hysteresis_ros.nodes.trajectories import points_of, tolerances_of  # noqa: E402
from hysteresis_ros.references.moves import Tolerances  # noqa: E402
from hysteresis_ros.references.trajectory import MOST_POINTS  # noqa: E402


def test_a_trajectory_of_too_many_points_is_refused_before_it_is_looked_at():
    # points without positions: a check of the points would report the missing positions
    message = JointTrajectory(joint_names=["tip"], points=[JointTrajectoryPoint()] * (MOST_POINTS + 1))
    with pytest.raises(ParameterError, match=f"{MOST_POINTS + 1} points.*at most {MOST_POINTS}"):
        points_of(message, "tip")
    message.points = [JointTrajectoryPoint(positions=[0.0])] * MOST_POINTS
    assert len(points_of(message, "tip")["positions"]) == MOST_POINTS


def test_joints_and_tolerances_beyond_the_one_are_refused_in_few_words():
    with pytest.raises(ParameterError, match="the joint of this axis") as refusal:
        points_of(JointTrajectory(joint_names=["x" * 1000] * 1000), "tip")
    assert len(str(refusal.value)) < 2 * LONGEST
    one = SimpleNamespace(name="tip", position=1e-6)
    goal = SimpleNamespace(
        path_tolerance=[], goal_tolerance=[one], goal_time_tolerance=SimpleNamespace(sec=0, nanosec=0)
    )
    default = Tolerances(1.0, 1.0, 1.0)
    assert tolerances_of(goal, "tip", default).goal == 1e-6
    goal.goal_tolerance = [one] * 2
    with pytest.raises(ParameterError, match="goal_tolerance = '2 joints'"):
        tolerances_of(goal, "tip", default)


def test_a_joint_is_looked_for_among_a_bounded_number():
    said = []
    node = SimpleNamespace(
        parameters=SimpleNamespace(joint="tip"),
        _joint_index=-1,
        wrong_joint=False,
        runner=SimpleNamespace(exact=True),
        fail=said.append,
        read_trip=lambda message, row: None,
    )
    others = ["other"] * MOST_JOINTS
    message = SimpleNamespace(
        header=SimpleNamespace(frame_id=""), name=[*others, "tip"], position=[1.0] * (MOST_JOINTS + 1)
    )
    assert not Responder.read(node, message, [0.0] * 100)
    assert "joint 'tip' is not in joint_states" in said[0] and len(said[0]) < 2 * LONGEST
    message.name = [*others[1:], "tip"]
    assert Responder.read(node, message, [0.0] * 100)


def test_somebody_elses_failure_is_repeated_in_part():
    said = []
    runner = SimpleNamespace(node=SimpleNamespace(fail=lambda text, announce: said.append(text)))
    Lockstep._on_run_state(runner, SimpleNamespace(data="failed: " + "x" * 10**6))
    assert said == ["x" * LONGEST_REASON]
