# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories over ROS: followed to the end, answered on arrival, replaced, cancelled, refused."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from action_msgs.msg import GoalStatus  # noqa: E402
from builtin_interfaces.msg import Duration  # noqa: E402
from nodes_support import SOON_AT_REST, Goal, StandIn, axis_parameters, compose, until  # noqa: E402
from rclpy.action import CancelResponse  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Bool, Float64, Float64MultiArray, String  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.loop.description import robot_description  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode  # noqa: E402
from hysteresis_ros.nodes.trajectories import Trajectories, TrajectoryAction, action_type  # noqa: E402
from hysteresis_ros.references.trajectory import HELD  # noqa: E402

SOURCE = "reference_generator"
#: Slow enough for a busy machine, and without trips.
SLOW = {
    **SOON_AT_REST,
    "plant_simulator": {"late_limit": -1, **SOON_AT_REST["plant_simulator"]},
    SOURCE: {"trajectory__goal_time": 20.0, "initial_setpoint": 0.0, "settled__time": 0.5},
}


def trajectory(*points, joint="extender", velocities=()) -> JointTrajectory:
    """Return a message of points (time [s], position [m])."""
    message = JointTrajectory(joint_names=[joint] if isinstance(joint, str) else joint)
    for index, (time, position) in enumerate(points):
        point = JointTrajectoryPoint(positions=[position], velocities=list(velocities[index : index + 1]))
        point.time_from_start = Duration(sec=int(time), nanosec=round(1e9 * (time % 1.0)))
        message.points.append(point)
    return message


class Axis:
    """A composed axis at 200 Hz in real time, and a publisher of trajectories."""

    def __init__(self, inside, observer, **source):
        overrides = SLOW | {SOURCE: SLOW[SOURCE] | source}
        axis = axis_parameters(overrides=overrides, sample_rate=200.0, time_mode="realtime")
        self.plant, *_, self.source = compose(inside, axis)
        self.said = observer.listen(String, f"/{SOURCE}/trajectory")
        self.sender = observer.talk(JointTrajectory, "/joint_trajectory")
        self.setpoints = observer.talk(Float64, "/setpoint")
        inside.spin()
        until(lambda: self.sender.get_subscription_count() and self.setpoints.get_subscription_count())
        until(lambda: self.source.count_subscribers(f"/{SOURCE}/trajectory") and self.source.sample > 3)

    def send(self, message, *words: str) -> str:
        """Send a trajectory, and return the next answer that contains one of these words."""
        known = len(self.said)
        self.sender.publish(message)
        return self.hear(known, *words)

    def hear(self, known: int, *words: str) -> str:
        heard = lambda: [m.data for m in self.said[known:] if any(word in m.data for word in words)]  # noqa: E731
        until(heard, what=f"an answer with {words} among {self.said}")
        return heard()[-1]


@pytest.fixture
def axis(inside, observer):
    return Axis(inside, observer)


def test_a_trajectory_is_followed_answered_when_arrived_and_its_end_is_the_setpoint(axis):
    said = axis.send(trajectory((0.1, 3e-6), (0.2, 5e-6), velocities=(4e-5, 0.0)), "arrived")
    assert said.startswith("1 arrived: ") and "1 taken: 2 points, 0.2 s" in [m.data for m in axis.said]
    assert axis.source.part.generator.step(float("nan")) == 5e-6
    until(lambda: axis.source.setpoint == 5e-6)

    known = len(axis.said)
    axis.send(trajectory((60.0, 11e-6)), "2 taken")
    assert axis.send(trajectory((0.05, 4e-6)), "2 replaced") and axis.hear(known, "3 arrived")
    axis.send(trajectory((60.0, 11e-6)), "4 taken")
    assert axis.send(JointTrajectory(joint_names=["extender"]), "4 cancelled: the motion was stopped")
    axis.send(trajectory((60.0, 11e-6)), "5 taken")
    known = len(axis.said)
    axis.setpoints.publish(Float64(data=2e-6))
    assert axis.hear(known, "5 replaced")
    until(lambda: axis.source.setpoint == 2e-6)


def test_positions_on_a_trajectory_trigger_so_that_it_is_a_fly_scan(inside, observer):
    heard = observer.listen(JointState, "/trigger_out")
    axis = Axis(inside, observer, triggers__positions=(2.0e-6, 3.0e-6, 4.0e-6), triggers__direction="up")
    until(lambda: axis.source.count_subscribers("/trigger_out"), what="a listener")
    axis.send(trajectory((0.5, 5e-6)), "1 arrived")
    until(lambda: len({message.position[1] for message in heard}) == 3, what="a trigger at each position")
    axis.send(trajectory((0.5, 0.0)), "2 arrived")
    # on a busy machine the axis may pass a position twice; number, position, direction
    told = [tuple(message.position)[:3] for message in heard]
    assert list(dict.fromkeys(position for _, position, _ in told)) == [2.0e-6, 3.0e-6, 4.0e-6]
    assert [number for number, *_ in told] == list(range(1, len(told) + 1))
    assert {direction for *_, direction in told} == {1.0}, "none on the way down"


def test_what_is_refused_is_named_and_moves_nothing(axis):
    for message, words in (
        (trajectory((0.1, 3e-6), joint="elbow"), "joint_names = ['elbow']"),
        (trajectory((0.1, 3e-6), joint=["extender", "elbow"]), "allowed: ['extender']"),
        (trajectory((0.2, 3e-6), (0.1, 4e-6)), "must be later than 0.2 s"),
        (trajectory((0.1, 3e-5)), "out of range"),
        (trajectory((0.1, 3e-6), velocities=(1e-5,)), "because the axis rests there"),
    ):
        assert words in axis.send(message, "refused")
    late = trajectory((0.1, 3e-6))
    late.header.stamp.sec = 5
    assert "must be 0" in axis.send(late, "refused")
    wide = trajectory((0.1, 3e-6))
    wide.points[0].positions = [1e-6, 2e-6]
    assert "points[0].positions" in axis.send(wide, "refused")
    assert axis.source.part.generator.trajectory[0] == 0 and axis.source.setpoint == 0.0


def test_whoever_comes_later_hears_whether_the_axis_has_settled(axis, observer):
    later = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    until(lambda: axis.source.settling.settled, what="an axis that rests where it began")
    heard, described = observer.listen(Bool, "/settled", later), observer.listen(String, "/robot_description", later)
    until(lambda: described and described[0].data == robot_description(axis.source.parameters), what="the URDF")
    until(lambda: heard and heard[-1].data, what="that the axis has settled")
    axis.setpoints.publish(Float64(data=6e-6))
    until(lambda: not all(message.data for message in heard), what="that it moves")
    until(lambda: heard[-1].data, what="that it has settled again")
    row = axis.source.row
    assert axis.source.setpoint == 6e-6 and abs(row[signals.MEASURED] - 6e-6) <= 0.01 * 12e-6
    axis.plant.trigger_deactivate()
    until(lambda: not heard[-1].data, what="that without measurements nothing has settled")


def test_tools_of_ros2_control_drive_the_axis_by_the_topics_of_a_controller(axis, observer):
    commands = observer.talk(Float64MultiArray, f"/{SOURCE}/commands")
    points = observer.talk(JointTrajectory, f"/{SOURCE}/joint_trajectory")
    refused = observer.listen(String, f"/{SOURCE}/refused")
    until(lambda: commands.get_subscription_count() and points.get_subscription_count())
    until(lambda: axis.source.count_subscribers(f"/{SOURCE}/refused"))
    commands.publish(Float64MultiArray(data=[4e-6]))
    until(lambda: axis.source.setpoint == 4e-6, what="the setpoint of an array")
    for wrong, words in (
        ([], "commands has 0 numbers, allowed: one, the position of 'extender' in m; 4 µm is kept"),
        ([1e-6, 2e-6], "commands has 2 numbers"),
        ([float("nan")], "nan"),
        ([1.0], "out of range"),
    ):
        known = len(refused)
        commands.publish(Float64MultiArray(data=wrong))
        until(lambda: len(refused) > known, what=f"the refusal of {wrong}")  # noqa: B023
        assert words in refused[-1].data
    assert axis.source.setpoint == 4e-6
    known = len(axis.said)
    points.publish(trajectory((0.05, 5e-6)))
    assert axis.hear(known, "arrived")


def test_goals_of_the_action_end_as_their_moves_do(axis, monkeypatch):
    """With a replacement of the message class and of rclpy's server, in the thread of the node."""
    import hysteresis_ros.nodes.trajectories as module

    monkeypatch.setattr(module, "ActionServer", lambda *arguments, **options: SimpleNamespace(destroy=lambda: None))
    source = axis.source
    action = TrajectoryAction(source, source.trajectories, StandIn)
    source.action = action
    inbox, ended = [], {}

    def turn():
        while inbox:
            inbox.pop(0)()

    source.create_timer(0.01, turn, clock=source.steady)

    def ask(message, **tolerances):
        goal = Goal(action, message, **tolerances)
        inbox.append(lambda: action.take(goal))
        return goal

    def end(goal):
        until(lambda: goal.status is not None, what="the end of a goal")
        ended[goal.status] = goal.result.error_string
        return goal.status, goal.result.error_code

    arrived = ask(trajectory((0.2, 5e-6), velocities=(0.0,)))
    assert end(arrived) == (GoalStatus.STATUS_SUCCEEDED, 0) and "from the last point" in arrived.result.error_string
    assert arrived.feedback and arrived.feedback[-1].joint_names == ["extender"]
    assert "ready" not in arrived.result.error_string
    ready = replace(source.parameters.ready, tolerance=1e-7)
    inbox.append(lambda: setattr(source, "parameters", replace(source.parameters, ready=ready)))
    inbox.append(lambda: source.ready._thread.run(source.ready._prepare))
    until(lambda: source.ready._predictor is not None, 180.0, "a predictor, which may have to be compiled")
    for target in (4e-6, 5e-6) * 10:  # a prediction may come after the end of its move
        foreseen = ask(trajectory((0.2, target), velocities=(0.0,)))
        assert end(foreseen) == (GoalStatus.STATUS_SUCCEEDED, 0)
        told = foreseen.feedback[-1]
        found = re.search(
            r"; ready: predicted (0\.[12]\d*) s after the start, (not yet )?measured", foreseen.result.error_string
        )
        if found and told.desired.time_from_start.nanosec:
            break
    else:
        raise AssertionError(foreseen.result.error_string)
    assert 1e-9 * told.desired.time_from_start.nanosec == pytest.approx(float(found[1]), rel=1e-3)
    assert told.actual.time_from_start.nanosec > 0
    assert end(ask(trajectory((0.1, 5e-6), joint="elbow"))) == (GoalStatus.STATUS_ABORTED, -2)
    assert end(ask(trajectory((0.1, 5e-5)))) == (GoalStatus.STATUS_ABORTED, -1)
    elbow = SimpleNamespace(name="elbow", position=1e-6)
    assert end(ask(trajectory((0.1, 5e-6)), goal=[elbow])) == (GoalStatus.STATUS_ABORTED, -2)
    tight = SimpleNamespace(name="extender", position=1e-12)
    assert end(ask(trajectory((60.0, 9e-6)), path=[tight])) == (GoalStatus.STATUS_ABORTED, -4)
    until(lambda: source.part.generator.trajectory[1] == HELD, what="an axis that rests")

    first = ask(trajectory((60.0, 11e-6)))
    second = ask(trajectory((60.0, 1e-6)))
    assert end(first) == (GoalStatus.STATUS_ABORTED, -1) and "taken its place" in first.result.error_string
    second.is_cancel_requested = True
    inbox.append(lambda: answers.append(action.cancel(second)))
    answers: list = []
    assert end(second)[0] == GoalStatus.STATUS_CANCELED and answers == [CancelResponse.ACCEPT]
    last = ask(trajectory((60.0, 11e-6)))
    until(lambda: action._goals == [last])
    inbox.append(source.part.stop)
    assert end(last)[0] == GoalStatus.STATUS_ABORTED and "stopped" in last.result.error_string
    assert not action._goals and not action._results


def test_the_real_action_moves_the_axis(axis, observer):
    kind = action_type()
    if kind is None:
        pytest.skip("control_msgs is not installed: no action")
    from rclpy.action import ActionClient

    client = ActionClient(observer.node, kind, "/follow_joint_trajectory")
    until(client.server_is_ready, what="the action")

    def send(message):
        sent = client.send_goal_async(kind.Goal(trajectory=message))
        until(sent.done, what="a goal that is accepted")
        result = sent.result().get_result_async()
        return sent.result(), result

    _, result = send(trajectory((0.2, 5e-6), velocities=(0.0,)))
    until(result.done, what="the result")
    assert result.result().status == GoalStatus.STATUS_SUCCEEDED and result.result().result.error_code == 0
    handle, result = send(trajectory((60.0, 11e-6)))
    handle.cancel_goal_async()
    until(result.done, what="the end of a cancelled goal")
    assert result.result().status == GoalStatus.STATUS_CANCELED
    _, result = send(trajectory((0.1, 1.0)))
    until(result.done, what="the refusal")
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert "out of range" in result.result().result.error_string


def test_the_zero_that_a_controller_subtracts_is_no_error_of_the_path_and_does_not_keep_an_axis_from_settling():
    """An identified axis measures the zero of its sensor in addition to the position on its path."""
    row, zero, seen, errors = [0.0] * len(signals.SIGNALS), 7e-6, [], []
    row[signals.SETPOINT] = row[signals.REFERENCE] = 5e-6
    row[signals.MEASURED] = 5e-6 + zero
    settling = SimpleNamespace(look=lambda *given: seen.append(given), settled=True)
    node = SimpleNamespace(settling=settling, offset=zero, tell_settled=lambda settled: None, row=row, sample=3)
    ReferenceGeneratorNode.look_at(node, [row])
    assert seen == [(5e-6, 5e-6, pytest.approx(5e-6, rel=1e-12), False)]
    node.part = SimpleNamespace(generator=SimpleNamespace(trajectory=(1, HELD)))
    node.parameters = SimpleNamespace(sample_rate=100.0)
    move = SimpleNamespace(look=lambda time, trajectory, error: errors.append(error))
    following = SimpleNamespace(_moves=[(move, None)], _node=node)
    Trajectories.look(following)
    assert errors == [pytest.approx(0.0, abs=1e-20)]
