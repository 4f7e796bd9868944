# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories over ROS: the topic ``joint_trajectory``, and the action ``follow_joint_trajectory``.

The reference generator follows trajectories (:mod:`hysteresis_ros.references.trajectory`); this module reads them from
messages, and reports the result to the sender. The action exists when the package control_msgs is installed. A refused
goal is accepted and aborted immediately, because a goal that ROS 2 rejects carries no reason.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from rclpy.action import ActionServer, CancelResponse
from rclpy.duration import Duration
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.references.moves import Ending, Move, Tolerances
from hysteresis_ros.references.trajectory import MOST_POINTS

#: Interval of the check whether samples are missing during a move [s].
LOOK = 0.1
#: Time for which samples may be missing during a move [s].
SILENCE = 1.0

#: Topics of trajectories: one in the namespace of the axis, and one to which tools of ros2_control send.
TOPICS = ("joint_trajectory", "~/joint_trajectory")

#: Fields that name joints.
JOINTS = ("joint_names", "path_tolerance", "goal_tolerance")

#: Callback that receives how a move ended, and the reason.
Told = Callable[[Ending, str], None]


def seconds(duration) -> float:
    """Return a ``Duration`` or ``Time`` message in seconds."""
    return duration.sec + 1e-9 * duration.nanosec


#: Points of one joint in the form of the generator: ``times``, ``positions``, ``velocities``, ``accelerations``.
Points = dict[str, tuple[float, ...]]


def points_of(message, joint: str) -> Points:
    """Return the points of a ``JointTrajectory`` of one joint; empty without points."""
    names = list(message.joint_names)
    if names != [joint]:
        raise _refused("joint_names", names, f"allowed: ['{joint}'], the joint of this axis")
    return points_by_joint(message, (joint,))[joint]


def points_by_joint(message, joints: Sequence[str]) -> dict[str, Points]:
    """Return the points of each joint that a ``JointTrajectory`` names, which may be a subset of ``joints``."""
    names = list(message.joint_names)
    if not names or len(set(names)) != len(names) or set(names) - set(joints):
        raise _refused("joint_names", names, f"allowed: one or more of {', '.join(joints)}, each once")
    if seconds(message.header.stamp):
        raise _refused("header.stamp", seconds(message.header.stamp), "must be 0; a trajectory begins immediately", "s")
    if len(message.points) > MOST_POINTS:
        raise _refused("points", f"{len(message.points)} points", f"allowed: at most {MOST_POINTS}")
    count = len(names)
    one_each = "one number" if count == 1 else f"{count} numbers, one for each joint"
    times = tuple(seconds(point.time_from_start) for point in message.points)
    found: dict[str, list[list[float]]] = {"positions": [], "velocities": [], "accelerations": []}
    for index, point in enumerate(message.points):
        for name in ("positions", "velocities", "accelerations", "effort"):
            values = list(getattr(point, name))
            allowed = {"positions": (count,), "effort": (0,)}.get(name, (count, 0))
            if len(values) not in allowed:
                text = {"positions": one_each, "effort": "none"}.get(name, f"{one_each}, or none")
                raise _refused(f"points[{index}].{name}", values, f"allowed: {text}")
            if values:
                found[name].append(list(map(float, values)))
    return {
        joint: {"times": times, **{name: tuple(row[place] for row in rows) for name, rows in found.items()}}
        for place, joint in enumerate(names)
    }


def tolerances_of(goal, joint: str, default: Tolerances) -> Tolerances:
    """Return the tolerances of a goal of the action; in the goal 0 means the default, a negative value no limit."""
    return tolerances_by_joint(goal, {joint: default})[joint]


def tolerances_by_joint(goal, defaults: Mapping[str, Tolerances]) -> dict[str, Tolerances]:
    """Return the tolerances of a goal of the action for each of its joints, from the defaults of the joints."""
    found: dict[str, dict[str, float]] = {joint: {} for joint in defaults}
    for name, given in (("path", goal.path_tolerance), ("goal", goal.goal_tolerance)):
        if len(given) > len(defaults):
            allowed = f"allowed: each of {', '.join(defaults)} once"
            raise _refused(f"{name}_tolerance", f"{len(given)} joints", allowed)
        for one in given:
            if one.name not in defaults or name in found[one.name]:
                raise _refused(f"{name}_tolerance", one.name, f"allowed: each of {', '.join(defaults)} once")
            own = getattr(defaults[one.name], name)
            found[one.name][name] = one.position if one.position > 0.0 else math.inf if one.position else own
    given_time = seconds(goal.goal_time_tolerance)
    if given_time:
        for own in found.values():
            own["goal_time"] = given_time if given_time > 0.0 else math.inf
    return {joint: replace(default, **found[joint]) for joint, default in defaults.items()}


def _refused(name: str, value, text: str, unit: str = "") -> ParameterError:
    return ParameterError([Problem(name, value, text, unit)])


class Trajectories:
    """Trajectory topics of a reference generator."""

    def __init__(self, node):
        self._node = node
        self._moves: list[tuple[Move, Told]] = []
        self._heard = (0, 0.0)
        self._answers = node.publisher(String, "~/trajectory", setpoint_qos())
        for topic in TOPICS:
            node.subscriber(JointTrajectory, topic, self._on_trajectory, setpoint_qos())

    @property
    def tolerances(self) -> Tolerances:
        """Default tolerances of a move."""
        own = self._node.parameters
        goal = own.trajectory.goal_tolerance or 0.01 * (own.maximum - own.minimum)
        return Tolerances(goal, own.trajectory.dwell, own.trajectory.goal_time)

    def begin(self) -> None:
        """Start the timer that aborts the moves of an axis that produces no more samples."""
        self._node.timer(LOOK, self._look_for_samples)

    def _on_trajectory(self, message) -> None:
        """Follow a trajectory from the topic; a trajectory without points ends the present move."""
        try:
            points = points_of(message, self._node.parameters.joint)
            if points["times"]:
                self.follow(points, self.tolerances)
            else:
                self.hold()
        except HysteresisError as error:
            self.refuse(error)

    def refuse(self, error: HysteresisError) -> None:
        """Report that a trajectory is refused, and why."""
        self._node.refuse("trajectory", f"trajectory refused: {error}")
        self.say(f"refused: {error}")

    def say(self, text: str) -> None:
        """Publish the result of a trajectory."""
        self._answers.publish(String(data=text))

    def follow(self, points: Points, tolerances: Tolerances, told: Told | None = None) -> Move:
        """Follow a trajectory, beginning with the next sample."""
        if not self._node.active:
            raise _refused("trajectory", len(points["times"]), "refused: the node is not active")
        ready = getattr(self._node, "ready", None)
        first = ready.present if ready is not None else 0
        self._node.steer("follow", points)
        if ready is not None:
            ready.begin(self._node.setpoint, points["positions"][-1], points, first)
        return self.attend(points, tolerances, told)

    def attend(self, points: Points, tolerances: Tolerances, told: Told | None = None) -> Move:
        """Monitor an accepted trajectory, and report later how it ended."""
        node = self._node
        number, _ = node.part.generator.trajectory
        move = Move(number, tolerances)
        self._moves.append((move, told or (lambda ending, text: None)))
        self._heard = (node.sample, time.monotonic())
        self.say(f"{number} taken: {len(points['times'])} points, {points['times'][-1]:g} s")
        return move

    def is_replaced(self, told: Told) -> bool:
        """Return whether a new trajectory has replaced the move with the callback ``told``."""
        number, _ = self._node.part.generator.trajectory
        return any(move.number != number for move, heard in self._moves if heard is told)

    def hold(self) -> None:
        """Bring the present move to rest."""
        if self._node.active:
            self._node.steer("hold")

    def look(self) -> None:
        """Update the moves in progress with the present sample."""
        if not self._moves:
            return
        node = self._node
        row = node.row
        error = row[signals.MEASURED] - node.offset - row[signals.REFERENCE]
        self._heard = (node.sample, time.monotonic())
        trajectory = node.part.generator.trajectory
        for move, told in tuple(self._moves):
            found = move.look(node.sample / node.parameters.sample_rate, trajectory, error)
            if found:
                self._end(move, told, *found)

    def _end(self, move: Move, told: Told, ending: Ending, text: str) -> None:
        self._moves.remove((move, told))
        self.say(f"{move.number} {ending.value}: {text}")
        if ending is Ending.PATH_VIOLATED:
            self.hold()
        told(ending, text)

    def _look_for_samples(self) -> None:
        """Abort the moves of an axis that no longer produces samples (timer callback).

        In lockstep there is no time-out for samples, and the loss of a node ends the run.
        """
        if self._node.runner.exact:
            return
        sample, since = self._heard
        if self._node.sample != sample:
            self._heard = (self._node.sample, time.monotonic())
        elif time.monotonic() - since > SILENCE:
            self.give_up(f"no sample for {SILENCE:g} s")

    def give_up(self, text: str) -> None:
        """Abort all moves in progress."""
        if self._moves:
            self.hold()
        for move, told in tuple(self._moves):
            self._end(move, told, Ending.STOPPED, text)


#: Name of the action in the namespace of the axis.
ACTION = "follow_joint_trajectory"
#: Maximum rate of feedback [Hz].
FEEDBACK = 20.0

#: Names of the result's error codes.
_CODES = {
    Ending.ARRIVED: "SUCCESSFUL",
    Ending.PATH_VIOLATED: "PATH_TOLERANCE_VIOLATED",
    Ending.GOAL_MISSED: "GOAL_TOLERANCE_VIOLATED",
}


def action_type():
    """Return the type of the action; None when the package control_msgs is not installed."""
    try:
        return importlib.import_module("control_msgs.action").FollowJointTrajectory
    except ImportError:
        return None


class TrajectoryAction:
    """Goals of the action.

    rclpy executes a goal only when the move has ended: a callback that waited for the end would need a thread, or a
    turn of the executor in every sample.
    """

    def __init__(self, node, trajectories: Trajectories, kind, name: str = ACTION):
        self._node, self._trajectories, self._kind = node, trajectories, kind
        self._goals: list = []
        self._shown = 0
        self.server = ActionServer(
            node,
            kind,
            name,
            self._answer,
            handle_accepted_callback=self.take,
            cancel_callback=self.cancel,
        )
        self._results: dict = {}

    def take(self, handle) -> None:
        """Follow the trajectory of a goal, or abort it."""
        try:
            self._follow(handle)
        except HysteresisError as error:
            self._trajectories.refuse(error)
            of_joints = isinstance(error, ParameterError) and error.problems[0].name in JOINTS
            self._finish(handle, "INVALID_JOINTS" if of_joints else "INVALID_GOAL", str(error))
            return
        self._goals.append(handle)

    def _follow(self, handle) -> None:
        joint, goal = self._node.parameters.joint, handle.request
        points = points_of(goal.trajectory, joint)
        tolerances = tolerances_of(goal, joint, self._trajectories.tolerances)
        self._trajectories.follow(points, tolerances, lambda ending, text: self._end(handle, ending, text))

    def cancel(self, handle):
        """Bring the axis to rest when its goal is cancelled, unless another goal moves it."""
        if self._goals and handle is self._goals[-1]:
            self._trajectories.hold()
        return CancelResponse.ACCEPT

    def _end(self, handle, ending: Ending, text: str) -> None:
        self._goals.remove(handle)
        self._finish(handle, _CODES.get(ending, "INVALID_GOAL"), f"{ending.value}: {text}{self._ready_words(handle)}")

    def _finish(self, handle, code: str, text: str) -> None:
        result = self._kind.Result()
        result.error_code, result.error_string = getattr(self._kind.Result, code), text
        self._results[id(handle)] = result
        handle.execute()

    def _answer(self, handle):
        """Set the final state of a goal, and return its result."""
        result = self._results.pop(id(handle))
        if result.error_code == self._kind.Result.SUCCESSFUL:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return result

    def tell(self) -> None:
        """At intervals, publish the feedback of the goals in progress."""
        node = self._node
        if not self._goals or 0 <= node.sample - self._shown < node.parameters.sample_rate / FEEDBACK:
            return
        self._shown = node.sample
        for handle in self._goals:
            nodes = self._nodes_of(handle)
            references = [one.row[signals.REFERENCE] for one in nodes]
            measured = [one.row[signals.MEASURED] - one.offset for one in nodes]
            feedback = self._kind.Feedback()
            feedback.joint_names = [one.parameters.joint for one in nodes]
            feedback.desired = JointTrajectoryPoint(positions=references)
            feedback.actual = JointTrajectoryPoint(positions=measured)
            errors = [wanted - found for wanted, found in zip(references, measured, strict=True)]
            feedback.error = JointTrajectoryPoint(positions=errors)
            if len(nodes) == 1:
                self._tell_ready(feedback, nodes[0])
            handle.publish_feedback(feedback)

    def _nodes_of(self, handle) -> list:
        """Return the reference generators of the joints of a goal."""
        return [self._node]

    def _ready_words(self, handle) -> str:
        """Return a text with predicted and measured time until the axis was ready; empty without a prediction."""
        nodes = self._nodes_of(handle)
        move = nodes[0].ready.move if len(nodes) == 1 else None
        if move is None or not math.isfinite(move.predicted):
            return ""
        since = move.readiness.since
        measured = "not yet measured" if math.isnan(since) else f"measured {since:.4g} s"
        return f"; ready: predicted {move.predicted:.4g} s after the start, {measured}"

    @staticmethod
    def _tell_ready(feedback, node) -> None:
        """Write times since the start into the feedback: the predicted time until ready (desired), and now (actual)."""
        move = node.ready.move
        if move is not None and math.isfinite(move.predicted):
            elapsed = len(move.measured) / node.parameters.sample_rate
            for point, time in ((feedback.desired, move.predicted), (feedback.actual, elapsed)):
                point.time_from_start = Duration(seconds=time).to_msg()


#: Points of a trajectory that brings a joint to rest.
REST: Points = {"times": (), "positions": (), "velocities": (), "accelerations": ()}


class GroupAction(TrajectoryAction):
    """Goals for several joints of a stage, which begin in the same sample.

    A goal succeeds when all its joints have arrived. When one joint's move ends in another way, the other joints come
    to rest, and the goal is aborted; the result names that joint.
    """

    def __init__(self, group, kind, name: str):
        self._group = group
        #: Callbacks of the joints that still move, by goal and joint.
        self._moving: dict[int, dict[str, Told]] = {}
        super().__init__(group.nodes[0], group.nodes[0].trajectories, kind, name)

    def _follow(self, handle) -> None:
        nodes, goal = self._group.by_joint, handle.request
        points = points_by_joint(goal.trajectory, list(nodes))
        if not goal.trajectory.points:
            raise _refused("points", "0 points", "a goal needs one or more; cancel a goal to come to rest")
        tolerances = tolerances_by_joint(goal, {joint: nodes[joint].trajectories.tolerances for joint in points})
        told: dict[str, Told] = {joint: partial(self._joint_ended, handle, joint) for joint in points}
        self._group.follow(points, tolerances, told)
        self._moving[id(handle)] = told

    def _joint_ended(self, handle, joint: str, ending: Ending, text: str) -> None:
        moving = self._moving.get(id(handle), {})
        if moving.pop(joint, None) is None or (moving and ending is Ending.ARRIVED):
            return
        del self._moving[id(handle)]
        self._group.rest(moving)
        self._end(handle, ending, f"{joint}: {text}")

    def cancel(self, handle):
        """Bring the joints of a goal to rest when it is cancelled, unless another goal moves them."""
        self._group.rest(self._moving.get(id(handle), {}))
        return CancelResponse.ACCEPT

    def _nodes_of(self, handle) -> list:
        nodes = self._group.by_joint
        return [nodes[joint] for joint in handle.request.trajectory.joint_names]
