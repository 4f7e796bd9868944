# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Trajectories over ROS: the topic ``joint_trajectory``, and the action ``follow_joint_trajectory`` where it exists.

The reference generator follows them (:mod:`hysteresis_ros.references.trajectory`); here they are taken out of messages,
and whoever sent one hears how it went.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.references.moves import Ending, Move, Tolerances
from hysteresis_ros.references.trajectory import MOST_POINTS

#: How often is looked at moves of an axis that may have stopped [s], and how long its samples may stay away.
LOOK, SILENCE = 0.1, 1.0

#: Where trajectories are awaited: beside the axis, and where tools of ros2_control send those for a controller.
TOPICS = ("joint_trajectory", "~/joint_trajectory")

#: Fields that name joints.
JOINTS = ("joint_names", "path_tolerance", "goal_tolerance")

#: Who is told how a move has ended, and why.
Told = Callable[[Ending, str], None]


def seconds(duration) -> float:
    """Return a ``Duration`` or ``Time`` message in seconds."""
    return duration.sec + 1e-9 * duration.nanosec


def points_of(message, joint: str) -> dict[str, tuple[float, ...]]:
    """Return the points of a ``JointTrajectory`` of one joint, as a generator takes them; without any: empty.

    Raises
    ------
    ParameterError
        Other joints, a beginning that is not now, or points that give something else than positions, velocities and
        accelerations of the one joint.
    """
    names = list(message.joint_names)
    if names != [joint]:
        raise _refused("joint_names", names, f"allowed: ['{joint}'], the joint of this axis")
    if seconds(message.header.stamp):
        raise _refused("header.stamp", seconds(message.header.stamp), "s: must be 0, a trajectory begins at once")
    if len(message.points) > MOST_POINTS:
        raise _refused("points", f"{len(message.points)} points", f"allowed: at most {MOST_POINTS}")
    found: dict[str, list[float]] = {"times": [], "positions": [], "velocities": [], "accelerations": []}
    for index, point in enumerate(message.points):
        found["times"].append(seconds(point.time_from_start))
        for name in ("positions", "velocities", "accelerations", "effort"):
            values = list(getattr(point, name))
            if len(values) > 1 or (name == "positions" and not values) or (name == "effort" and values):
                allowed = {"positions": "one number", "effort": "none"}.get(name, "one number or none")
                raise _refused(f"points[{index}].{name}", values, f"allowed: {allowed}")
            if values:
                found[name].append(float(values[0]))
    return {name: tuple(values) for name, values in found.items()}


def tolerances_of(goal, joint: str, default: Tolerances) -> Tolerances:
    """Return the tolerances of a goal of the action; what it leaves at 0 is the default, below 0 any.

    Raises
    ------
    ParameterError
        A tolerance of another joint, or more than one.
    """
    found = {}
    for name, given in (("path", goal.path_tolerance), ("goal", goal.goal_tolerance)):
        if len(given) > 1:
            raise _refused(f"{name}_tolerance", f"{len(given)} joints", f"allowed: '{joint}', the joint of this axis")
        for one in given:
            if one.name != joint:
                raise _refused(f"{name}_tolerance", one.name, f"allowed: '{joint}', the joint of this axis")
            if one.position:
                found[name] = one.position if one.position > 0.0 else math.inf
    given_time = seconds(goal.goal_time_tolerance)
    if given_time:
        found["goal_time"] = given_time if given_time > 0.0 else math.inf
    return replace(default, **found)


def _refused(name: str, value, text: str) -> ParameterError:
    return ParameterError([Problem(name, value, text)])


class Trajectories:
    """What a reference generator says and hears of trajectories.

    Parameters
    ----------
    node : ReferenceGeneratorNode
        Follows them.
    """

    def __init__(self, node):
        self._node = node
        self._moves: list[tuple[Move, Told]] = []
        self._heard = (0, 0.0)
        self._answers = node.publisher(String, "~/trajectory", setpoint_qos())
        for topic in TOPICS:
            node.subscriber(JointTrajectory, topic, self._on_trajectory, setpoint_qos())

    @property
    def tolerances(self) -> Tolerances:
        """When a move is well done, unless somebody says otherwise."""
        own = self._node.parameters
        goal = own.trajectory.goal_tolerance or 0.01 * (own.maximum - own.minimum)
        return Tolerances(goal, own.trajectory.dwell, own.trajectory.goal_time)

    def begin(self) -> None:
        """Look after moves of an axis whose samples stop."""
        self._node.timer(LOOK, self._look_for_samples)

    def _on_trajectory(self, message) -> None:
        """Topic: follow a trajectory; one without points ends whatever moves."""
        try:
            points = points_of(message, self._node.parameters.joint)
            if points["times"]:
                self.follow(points, self.tolerances)
            else:
                self.hold()
        except HysteresisError as error:
            self.refuse(error)

    def refuse(self, error: HysteresisError) -> None:
        """Say that a trajectory is refused, and why."""
        self._node.refuse("trajectory", f"trajectory refused: {error}")
        self.say(f"refused: {error}")

    def say(self, text: str) -> None:
        """Publish what became of a trajectory."""
        self._answers.publish(String(data=text))

    def follow(self, points: dict[str, tuple[float, ...]], tolerances: Tolerances, told: Told | None = None) -> Move:
        """Follow a trajectory from the next sample on.

        Parameters
        ----------
        points : dict
            As :func:`points_of` returns them.
        tolerances : Tolerances
        told : callable, optional
            Told how it went.

        Raises
        ------
        HysteresisError
            It is refused; nothing is changed then.
        """
        node = self._node
        if not node.active:
            raise _refused("trajectory", len(points["times"]), "refused: the node is not active")
        node.steer("follow", points)
        number, _ = node.part.generator.trajectory
        move = Move(number, tolerances)
        self._moves.append((move, told or (lambda ending, text: None)))
        self._heard = (node.sample, time.monotonic())
        self.say(f"{number} taken: {len(points['times'])} points, {points['times'][-1]:g} s")
        return move

    def hold(self) -> None:
        """Let what moves come to rest."""
        if self._node.active:
            self._node.steer("hold")

    def look(self) -> None:
        """Look at the present sample of moves under way."""
        if not self._moves:
            return
        node = self._node
        row = node.row
        error = row[signals.MEASURED] - row[signals.REFERENCE]
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
        """Timer: nobody waits for the samples of an axis that makes none."""
        sample, since = self._heard
        if self._node.sample != sample:
            self._heard = (self._node.sample, time.monotonic())
        elif time.monotonic() - since > SILENCE:
            self.give_up(f"no sample for {SILENCE:g} s")

    def give_up(self, text: str) -> None:
        """End all moves that are under way."""
        if self._moves:
            self.hold()
        for move, told in tuple(self._moves):
            self._end(move, told, Ending.STOPPED, text)
