# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Goals for the joints of a stage: they arrive together, are refused together, and come to rest together."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from action_msgs.msg import GoalStatus  # noqa: E402
from builtin_interfaces.msg import Duration  # noqa: E402
from nodes_support import Goal, StandIn, compose_stage, until  # noqa: E402
from rclpy.action import CancelResponse  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

import hysteresis_ros.nodes.stage as stages  # noqa: E402
import hysteresis_ros.nodes.trajectories as trajectories  # noqa: E402
from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.stage_parameters import StageParameters  # noqa: E402
from hysteresis_ros.references.trajectory import HELD  # noqa: E402


def trajectory(joints: list[str], *points: tuple[float, list[float]]) -> JointTrajectory:
    """Return a message of points (time [s], positions [m])."""
    made = JointTrajectory(joint_names=joints)
    for time, positions in points:
        since = Duration(sec=int(time), nanosec=round(1e9 * (time % 1.0)))
        made.points.append(JointTrajectoryPoint(positions=positions, time_from_start=since))
    return made


class Stage:
    """xy_scanner in lockstep in the test's own process, and its action without rclpy's server."""

    def __init__(self, inside):
        configuration = load_configuration("xy_scanner").override("", time_mode="lockstep")
        configuration = configuration.override("reference_generator", waveform__type="hold", trajectory__goal_time=1.0)
        parameters = StageParameters.from_configuration(configuration)
        nodes = compose_stage(inside, parameters)
        self.sources = {"x": nodes[6], "y": nodes[7]}
        self.group = nodes[6].group
        self.inbox: list = []
        nodes[6].create_timer(0.01, self._turn, clock=nodes[6].steady)
        inside.spin()
        until(lambda: nodes[6].sample > 10, what="samples")

    def _turn(self) -> None:
        while self.inbox:
            self.inbox.pop(0)()

    def ask(self, message: JointTrajectory, **tolerances) -> Goal:
        goal = Goal(self.group.action, message, **tolerances)
        self.inbox.append(lambda: self.group.action.take(goal))
        return goal

    def end(self, goal: Goal) -> tuple[int, int]:
        until(lambda: goal.status is not None, what="the end of a goal")
        return goal.status, goal.result.error_code

    def outcome(self, name: str) -> tuple[int, int]:
        """Return number and outcome of the last trajectory of an axis."""
        return self.sources[name].part.generator.trajectory


@pytest.fixture
def stage(inside, monkeypatch):
    monkeypatch.setattr(trajectories, "ActionServer", lambda *args, **options: SimpleNamespace(destroy=lambda: None))
    monkeypatch.setattr(trajectories, "FEEDBACK", 1000.0)
    monkeypatch.setattr(stages, "action_type", lambda: StandIn)
    return Stage(inside)


def test_goals_of_several_joints_end_as_their_moves_do(stage):
    succeeded, aborted = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED
    arrived = stage.ask(trajectory(["y", "x"], (0.02, [17e-6, 22e-6])))
    assert stage.end(arrived) == (succeeded, 0)
    assert arrived.result.error_string.startswith(("arrived: x: ", "arrived: y: "))
    for name, place in (("x", 22e-6), ("y", 17e-6)):
        assert stage.sources[name].setpoint == place
    assert arrived.feedback and arrived.feedback[-1].joint_names == ["y", "x"]
    assert len(arrived.feedback[-1].actual.positions) == 2

    # all or none
    before = stage.outcome("x"), stage.outcome("y")
    assert stage.end(stage.ask(trajectory(["x", "z"], (0.02, [22e-6, 17e-6])))) == (aborted, -2)
    beyond = stage.ask(trajectory(["x", "y"], (0.02, [21e-6, 50e-6])))
    assert stage.end(beyond) == (aborted, -1) and "y: trajectory positions" in beyond.result.error_string
    assert stage.end(stage.ask(trajectory(["x", "y"]))) == (aborted, -1)
    stranger = SimpleNamespace(name="z", position=1e-6)
    assert stage.end(stage.ask(trajectory(["x", "y"], (0.02, [21e-6, 18e-6])), goal=[stranger])) == (aborted, -2)
    assert (stage.outcome("x"), stage.outcome("y")) == before

    # one joint leaves its path, so the other one comes to rest too
    tight = SimpleNamespace(name="y", position=1e-12)
    left = stage.ask(trajectory(["x", "y"], (60.0, [30e-6, 10e-6])), path=[tight])
    assert stage.end(left) == (aborted, -4) and "y: " in left.result.error_string
    until(lambda: all(stage.outcome(name)[1] == HELD for name in "xy"), what="a stage that rests")


def test_goals_are_replaced_cancelled_and_stopped_with_all_their_joints(stage):
    aborted, cancelled = GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED
    both = stage.ask(trajectory(["x", "y"], (60.0, [30e-6, 10e-6])))
    until(lambda: stage.outcome("x")[0] == stage.outcome("y")[0] == 1, what="two joints that move")
    alone = stage.ask(trajectory(["x"], (60.0, [10e-6])))
    assert stage.end(both) == (aborted, -1) and "x: another trajectory" in both.result.error_string
    until(lambda: stage.outcome("y") == (1, HELD), what="y at rest")
    assert stage.outcome("x")[0] == 2 and alone.status is None, "the new goal goes on"

    alone.is_cancel_requested = True
    answers: list = []
    stage.inbox.append(lambda: answers.append(stage.group.action.cancel(alone)))
    assert stage.end(alone)[0] == cancelled and answers == [CancelResponse.ACCEPT]
    until(lambda: stage.outcome("x") == (2, HELD), what="x at rest")

    last = stage.ask(trajectory(["x", "y"], (60.0, [30e-6, 10e-6])))
    until(lambda: stage.outcome("x")[0] == 3 and stage.outcome("y")[0] == 2, what="two joints that move again")
    stage.inbox.append(stage.sources["x"].part.stop)
    assert stage.end(last)[0] == aborted and "was stopped or reset" in last.result.error_string
    until(lambda: stage.outcome("y") == (2, HELD), what="y at rest, too")
    action = stage.group.action
    assert not action._goals and not action._results and not action._moving
