# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The action ``control_msgs/FollowJointTrajectory`` of a reference generator; needs the package control_msgs.

A goal is accepted and, when it is refused, aborted at once: a rejected one of ROS 2 could not say why.
"""

from __future__ import annotations

import importlib

from rclpy.action import ActionServer, CancelResponse
from trajectory_msgs.msg import JointTrajectoryPoint

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError
from hysteresis_ros.nodes.trajectories import JOINTS, Trajectories, points_of, tolerances_of
from hysteresis_ros.references.moves import Ending

#: Name of the action, beneath the namespace of the axis.
ACTION = "follow_joint_trajectory"
#: Feedback at most so often [Hz].
FEEDBACK = 20.0

#: Names of the result's error codes.
_CODES = {
    Ending.ARRIVED: "SUCCESSFUL",
    Ending.PATH_VIOLATED: "PATH_TOLERANCE_VIOLATED",
    Ending.GOAL_MISSED: "GOAL_TOLERANCE_VIOLATED",
}


def action_type():
    """Return the action's type, None where the package control_msgs is not installed."""
    try:
        return importlib.import_module("control_msgs.action").FollowJointTrajectory
    except ImportError:
        return None


class TrajectoryAction:
    """Goals of the action.

    A goal waits without being executed in rclpy's sense, and is executed at its end: a callback that waits would cost a
    thread, or a turn of the executor at every sample.

    Parameters
    ----------
    node : ReferenceGeneratorNode
    trajectories : Trajectories
        What follows them.
    kind : type
        FollowJointTrajectory.
    """

    def __init__(self, node, trajectories: Trajectories, kind):
        self._node, self._trajectories, self._kind = node, trajectories, kind
        self._goals: list = []
        self._shown = 0
        self.server = ActionServer(
            node,
            kind,
            ACTION,
            self._answer,
            handle_accepted_callback=self.take,
            cancel_callback=self.cancel,
        )
        self._results: dict = {}

    def take(self, handle) -> None:
        """Follow the trajectory of a goal, or abort it."""
        joint, goal = self._node.parameters.joint, handle.request
        try:
            points = points_of(goal.trajectory, joint)
            tolerances = tolerances_of(goal, joint, self._trajectories.tolerances)
            self._trajectories.follow(points, tolerances, lambda ending, text: self._end(handle, ending, text))
        except HysteresisError as error:
            self._trajectories.refuse(error)
            of_joints = isinstance(error, ParameterError) and error.problems[0].name in JOINTS
            self._finish(handle, "INVALID_JOINTS" if of_joints else "INVALID_GOAL", str(error))
            return
        self._goals.append(handle)

    def cancel(self, handle):
        """Let the axis come to rest when its goal is cancelled, unless another one moves it."""
        if self._goals and handle is self._goals[-1]:
            self._trajectories.hold()
        return CancelResponse.ACCEPT

    def _end(self, handle, ending: Ending, text: str) -> None:
        self._goals.remove(handle)
        self._finish(handle, _CODES.get(ending, "INVALID_GOAL"), f"{ending.value}: {text}")

    def _finish(self, handle, code: str, text: str) -> None:
        result = self._kind.Result()
        result.error_code, result.error_string = getattr(self._kind.Result, code), text
        self._results[id(handle)] = result
        handle.execute()

    def _answer(self, handle):
        """Put a goal into its last state, and return its result."""
        result = self._results.pop(id(handle))
        if result.error_code == self._kind.Result.SUCCESSFUL:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return result

    def tell(self) -> None:
        """Publish the feedback of goals under way, now and then."""
        node = self._node
        if not self._goals or 0 <= node.sample - self._shown < node.parameters.sample_rate / FEEDBACK:
            return
        self._shown = node.sample
        reference, measured = node.row[signals.REFERENCE], node.row[signals.MEASURED]
        feedback = self._kind.Feedback()
        feedback.joint_names = [node.parameters.joint]
        feedback.desired = JointTrajectoryPoint(positions=[reference])
        feedback.actual = JointTrajectoryPoint(positions=[measured])
        feedback.error = JointTrajectoryPoint(positions=[reference - measured])
        for handle in self._goals:
            handle.publish_feedback(feedback)
