# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.
"""Executable ``hysteresis_stage``: runs the nodes of one kind, or of all kinds, for all axes in one process.

Each axis has four nodes in its own namespace, with the same topics, services and parameters as a single axis. All nodes
of one kind share a process. In the process of the plants the structure couples them, and in that of the compensators
the decoupling; references and controllers are the same as for a single axis. ``hysteresis_stage KIND`` runs the nodes
of one kind; without a kind it runs all of them, and with ``--recorder`` also the recorders. The parameter file of the
stage follows ``--params-file``. With ``time_mode: fused`` one compiled thread runs the loop of all axes, and all nodes
are in this process.

On a stage, all axes stop when the plant of one axis trips, and all controllers go to their safe commands while the
measurement of one axis is stale. This module applies this rule to nodes; :func:`hysteresis_ros.loop.stage.stage_ticks`
applies it in the compiled loop.
"""

from __future__ import annotations

import copy
import math
import sys
import threading
from array import array
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from hysteresis_ros import signals
from hysteresis_ros.control import feedforward as feeding
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.loop.controller import RETURNING, STOP
from hysteresis_ros.loop.stage import (
    WITH_STAGE,
    Coupling,
    advance_structure,
    feed_across,
    hold_with_stage,
    report_reference,
    to_actuators,
    to_axes,
    to_pose,
)
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.watch import is_stale
from hysteresis_ros.nodes.axis import WITH_RECORDER
from hysteresis_ros.nodes.fused import FusedAxis
from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.launcher import require_messages
from hysteresis_ros.nodes.lockstep import LockstepResponder
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_runners import LockstepPlant, RealTimePlant
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode, Stamps
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.realtime import RealTimeResponder
from hysteresis_ros.nodes.recorder import RecorderNode
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.scan_clock import TOPIC as SCAN_CLOCK
from hysteresis_ros.nodes.scan_clock import ScanClockTopic
from hysteresis_ros.nodes.spin import given_configuration, refused, run
from hysteresis_ros.nodes.trajectories import (
    ACTION,
    REST,
    GroupAction,
    Points,
    Told,
    action_type,
    points_by_joint,
)
from hysteresis_ros.recordings.bag_writer import GuardedBag
from hysteresis_ros.references.moves import Ending, Tolerances

#: Topics of a stage that act on several of its axes.
SETPOINTS, JOINT_TRAJECTORY = "setpoints", "joint_trajectory"


class Group:
    """The nodes of one kind of all axes of a stage, in one process; their rows are the rows of one table."""

    def __init__(self, parameters: StageParameters):
        self.parameters = parameters
        self.coupling = Coupling(parameters)
        self.rows = np.zeros((len(parameters.axes), signals.MOTOR_ROW))
        self.nodes: list = []

    @property
    def runners(self) -> list:
        """The runners, which decide when the nodes process a sample; empty until all nodes are configured."""
        configured = len(self.nodes) == len(self.rows) and all(node.parameters is not None for node in self.nodes)
        return [node.runner for node in self.nodes] if configured else []


class StagePlants(Group):
    """The plants of a stage: they compute one sample of all actuators and of the structure that couples them."""

    def __init__(self, parameters: StageParameters):
        super().__init__(parameters)
        self.lock = threading.RLock()
        #: Set while the timing thread stops.
        self.leaving = threading.Event()
        self.stamps: Stamps | None = None
        self._publisher: Any = None

    def settle(self) -> None:
        """Bring the structure to rest at the initial voltages of the plants, as soon as all plants are configured."""
        parts = [node.part for node in self.nodes]
        if len(parts) == len(self.rows) and None not in parts:
            self.coupling.settle(parts)

    def publish_sample(self) -> None:
        """Measure the present sample of all axes and publish it on the topics of the axes and of the stage."""
        for node in self.nodes:
            node.sense()
        to_pose(self.coupling.arrays, self.rows)
        for node in self.nodes:
            node.publish_measured()
        self.publish_joint_states()

    def publish_joint_states(self) -> None:
        """Publish the joints of all axes in one message."""
        messages = [node.joint_states for node in self.nodes]
        whole = JointState(header=messages[0].header, name=[message.name[0] for message in messages])
        for field in ("position", "velocity", "effort"):
            setattr(whole, field, array("d", [getattr(message, field)[0] for message in messages]))
        self._publisher.publish(whole)

    def connect(self, node) -> None:
        """Create the topic of all joints, which the first plant publishes."""
        if node is self.nodes[0]:
            topic = f"{self.parameters.namespace}/joint_states"
            self._publisher = node.publisher(JointState, topic, node.qos())

    def finish_sample(self) -> None:
        """Apply the received voltages of all axes and advance to the next sample."""
        for node in self.nodes:
            node.hold_voltages()
        advance_structure(self.coupling.arrays)
        for node in self.nodes:
            node.close_sample()

    def stop_together(self) -> None:
        """Stop all axes when one axis is stopped."""
        if any(node.part.tripped for node in self.nodes):
            for node in self.nodes:
                node.part.stop_with_stage()


class LockstepStagePlant(LockstepPlant):
    """Publishes sample k of all axes together, and continues with k + 1 when all voltages of k have arrived."""

    def advance(self) -> None:
        """Publish the present sample when the partners and the recorders of all axes are ready."""
        runners = self.node.group.runners
        if runners and all(one.may_begin() for one in runners) and all([one.begin_sample() for one in runners]):
            self.node.group.publish_sample()

    def finish_sample(self) -> None:
        """Advance to the next sample when the voltages of all axes have arrived."""
        runners = self.node.group.runners
        if all(one.is_answered for one in runners):
            for one in runners:
                one.is_measured = False
            self.node.group.finish_sample()
            self.node.group.stop_together()
            self.advance()

    def missing_voltage(self) -> str:
        """Return the partner of this axis whose input for the sample is missing; other plants report their own."""
        return "" if self.is_answered else super().missing_voltage()


class RealTimeStagePlant(RealTimePlant):
    """Starts each sample of all axes at its scheduled time, in one thread that belongs to the first plant."""

    def __init__(self, node):
        super().__init__(node)
        self._leaving = node.group.leaving

    @property
    def _first(self):
        return self.node.group.nodes[0].runner

    @property
    def plants(self) -> list:
        """The plants of all axes."""
        return self.node.group.nodes

    def start_time(self) -> None:
        """Start the timing thread when the plants of all axes are active."""
        if all(node.active for node in self.node.group.nodes):
            RealTimePlant.start_time(self._first)

    def stop_time(self) -> None:
        """Stop the timing thread, because a stage has samples only while all its plants are active."""
        if self._first is not None:
            RealTimePlant.stop_time(self._first)

    def is_awaited(self, recorded: bool) -> bool:
        """Return whether the loops of all axes are complete and, if ``recorded`` is set, the recorders are present."""
        return all(RealTimePlant.is_awaited(one, recorded) for one in self.node.group.runners)

    def align_now(self) -> bool:
        """If the count of voltages of one axis must restart, wait until no voltage of any axis is pending."""
        runners = self.node.group.runners
        if any(one.is_unaligned for one in runners):
            for one in runners:
                one.align()
                RealTimePlant.align_now(one)
            return True
        return False

    def begin_sample(self) -> None:
        """Publish the present sample of all axes; called with the lock held."""
        for one in self.node.group.runners:
            one.ask()
        self.node.group.publish_sample()

    def end_sample(self, behind: bool) -> None:
        """Apply the voltages that have arrived and advance to the next sample; called with the lock held."""
        group = self.node.group
        runners = group.runners
        for one in runners:
            one.close_answers()
        before = [one.node.part.tripped for one in runners]
        group.finish_sample()
        for one, stopped in zip(runners, before, strict=True):
            one.go_to_next(stopped, behind)
        group.stop_together()


class StagePlantNode(PlantSimulatorNode):
    """The plant of one axis of a stage; the plants of the other axes are in the same process."""

    lockstep_runner = LockstepStagePlant
    real_time_runner = RealTimeStagePlant

    def __init__(self, group: StagePlants, **options):
        self.group, self.place = group, len(group.nodes)
        super().__init__(**options)
        self.lock = group.lock
        group.nodes.append(self)

    @property
    def others(self) -> list:
        """The plants of the other axes."""
        return [node for node in self.group.nodes if node is not self]

    def build(self, parameters) -> None:
        """Create actuator and sensor of this axis."""
        super().build(parameters)
        self.row = self.group.rows[self.place]
        self.row[:] = 0.0
        # in each sample all axes have the same stamp
        self.stamps = self.group.stamps = self.group.stamps or self.stamps

    def make_part(self, parameters, travel=None):
        """Return the actuator and the sensor of this axis, or its device."""
        if parameters.driver:
            return super().make_part(parameters, self.group.parameters.travel()[self.place])
        return self.group.coupling.plant(self.place, parameters)

    def connect(self) -> None:
        """Create the topics of the axis; the first plant also creates the topic of the stage."""
        super().connect()
        self.group.connect(self)

    def _clear(self) -> None:
        super()._clear()
        self.group.settle()

    def reset_blocks(self) -> None:
        """Restart the plants of all axes at sample 0; in lockstep reset all other nodes first."""
        with self.lock:
            for node in reversed(self.group.nodes):  # the first plant starts the time
                if node is not self:
                    node.runner.clear()
                super(StagePlantNode, node).reset_blocks()

    def on_running(self, running: bool) -> None:
        """Pause the time of the stage (``~/stop`` of any of its plants), or resume it (``~/start``).

        A fused stage stops and starts as a whole.
        """
        for node in self.others:
            if node.parameters is not None and node.running != running:
                node.running = running
                node.pace.restart()
        if self.is_fused:
            super().on_running(running)
            return
        for node in self.group.nodes:
            super(StagePlantNode, node).on_running(running)

    def go_on(self) -> None:
        """Resume the stopped stage, unless one of its nodes is lost."""
        if not any(node.runner.missing_partners() for node in self.group.nodes):
            for node in self.group.nodes:
                super(StagePlantNode, node).go_on()

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis: for a reason of its own, or because another axis has stopped."""
        if not self.part.stopped_with_stage:
            return super().explain_trip()
        cause = next((node for node in self.others if node.part.tripped and not node.part.stopped_with_stage), None)
        if cause is None:
            return "another axis of the stage was stopped: call ~/start to resume"
        return f"{cause.get_namespace()} has stopped the stage: {cause.explain_trip()}"

    def health(self):
        """Report the voltage, late commands and saturation, and which axis has stopped the stage."""
        level, text, values = super().health()
        return level, f"axis stopped: {self.explain_trip()}" if self.part.stopped_with_stage else text, values


class StageCompensators(Group):
    """The compensators of a stage with decoupling: the command of each actuator depends on the commands of all axes."""

    def __init__(self, parameters: StageParameters):
        super().__init__(parameters)
        #: Achieved commands of the actuators [m].
        self.achieved = np.zeros(len(self.rows))

    def answer(self, nodes) -> None:
        """Compute and publish the voltages of these axes from the commands in their rows."""
        for node in self.nodes:
            if node not in nodes:
                node.row[signals.COMMAND] = math.nan
        for node in nodes:
            node.before_step()
        to_actuators(self.coupling.arrays, self.rows)
        for node in nodes:
            node.step()
        self.note_achieved(nodes)
        for node in nodes:
            node.close_answer()

    def note_achieved(self, nodes) -> None:
        """Write the achieved commands of the degrees of freedom into the rows; only ``nodes`` have new values."""
        for node in nodes:
            self.achieved[node.place] = node.row[signals.APPLIED]
        self.rows[:, signals.APPLIED] = self.achieved
        to_axes(self.coupling.arrays, self.rows)


class LockstepTogether(LockstepResponder):
    """Answers sample k of all axes when their measurements and all their other inputs have arrived."""

    def advance(self) -> None:
        """Answer the present sample if the inputs of all axes have arrived."""
        runners = self.node.group.runners
        if runners and all(one.may_answer() for one in runners):
            stamps = [one.take_stamp() for one in runners]
            self.node.group.answer(self.node.group.nodes)
            for one, stamp in zip(runners, stamps, strict=True):
                one.node.report(stamp)


class RealTimeTogether(RealTimeResponder):
    """Answers the commands of all axes when all have arrived.

    An axis misses the sample if its command has not arrived when the next command of another axis arrives. An axis that
    has been silent for its time-out is not waited for.
    """

    has_command = False

    def clear(self) -> None:
        """Restart with the next command."""
        super().clear()
        self.has_command = False

    def _command(self, input_, data: float) -> None:
        """Answer when the commands of all axes have arrived."""
        runners = self.node.group.runners
        if self.has_command:
            self._answer_all(runners)
        if self.take_command(input_, data):
            self.has_command = True
            if all(one.has_command or not one.is_live for one in runners):
                self._answer_all(runners)

    def _answer_all(self, runners) -> None:
        answered = [one for one in runners if one.has_command]
        self.node.group.answer([one.node for one in answered])
        for one in answered:
            one.has_command = False
            one.pair_answer()


class StageCompensatorNode(HysteresisCompensatorNode):
    """The compensator of one axis of a stage with decoupling; the other compensators are in the same process."""

    lockstep_runner = LockstepTogether
    real_time_runner = RealTimeTogether

    def __init__(self, group: StageCompensators, **options):
        self.group, self.place = group, len(group.nodes)
        super().__init__(**options)
        self.row = group.rows[self.place]
        group.nodes.append(self)

    def reset_blocks(self) -> None:
        """Reset the compensator to rest."""
        super().reset_blocks()
        self.group.coupling.arrays.commands[self.place] = self.group.achieved[self.place] = 0.0

    def miss(self, samples: int) -> None:
        """Process samples without a command, and publish the result."""
        for _ in range(samples):
            self.miss_sample()
        self.group.note_achieved([self])
        self.publish_outputs()


class StageControllers(Group):
    """The controllers of a stage: they share a feedforward; while one measurement is stale, all axes are safe."""

    def exchange_references(self) -> None:
        """Add the contribution of the stage's feedforward to the next command of each axis."""
        arrays = self.coupling.arrays
        states = [(node.part.arrays.x.feedforward, node.part.arrays.watch_x.own) for node in self.nodes]
        calls = [1.0 if own[RETURNING] else fed[feeding.CALLS] for fed, own in states]
        # in real time an axis may miss a sample; the other axes wait for it for one sample only
        if not self.nodes[0].runner.exact and min(calls) < 1.0 and max(calls) < 2.0:
            return
        for (fed, own), row in zip(states, self.rows, strict=True):
            report_reference(fed, own, row)
        feed_across(arrays, self.rows)
        for (fed, _), row in zip(states, self.rows, strict=True):
            fed[feeding.GIVEN] = row[signals.TRIPPED]

    def close_sample(self) -> None:
        """Exchange references and detect stale measurements after all controllers have answered a sample."""
        if not self.runners or (self.nodes[0].runner.exact and len({node.sample for node in self.nodes}) > 1):
            return
        # a fused loop exchanges the references itself
        if self.coupling.arrays.weights.size and not self.nodes[0].is_fused:
            self.exchange_references()
        stale = [is_stale(node.part.arrays.watch_p.guard, node.part.arrays.watch_x.guard) for node in self.nodes]
        for node, own in zip(self.nodes, stale, strict=True):
            hold_with_stage(node.part.arrays.watch_x.own, float(any(stale) and not own))


class StageControllerNode(MotionControllerNode):
    """The controller of one axis of a stage; the other controllers are in the same process."""

    def __init__(self, group: StageControllers, **options):
        self.group = group
        super().__init__(**options)
        group.nodes.append(self)

    def after_missing(self) -> None:
        """Log changes of mode; after the last answer to a sample, also close the sample of the stage."""
        super().after_missing()
        self.group.close_sample()

    def reset_blocks(self) -> None:
        """Reset the controller to rest, and restart its record of references."""
        super().reset_blocks()
        self.group.coupling.arrays.known[self.group.nodes.index(self)] = 0.0

    def health(self):
        """Report stale and rejected measurements, saturated commands, and that another axis keeps this axis safe."""
        found = super().health()
        if self.part.arrays.watch_x.own[STOP] != WITH_STAGE:
            return found
        return 2, "the measurement of another axis is stale: this axis stays safe until it returns", found[2]


class StageSources(Group):
    """The reference generators of a stage, which take setpoints of several axes for the same sample."""

    #: Clock of the scan, which is common to the axes that follow the scan.
    scan_clock: ScanClockTopic | None = None
    #: Action for trajectories of several joints; None without the package control_msgs.
    action: GroupAction | None = None

    def take(self, given: dict[str, float]) -> str:
        """Take all setpoints [m], given by names of axes, or none; return why they are refused, or an empty text."""
        nodes = dict(zip(self.parameters.names, self.nodes, strict=True))
        unknown = [name for name in given if name not in nodes]
        if unknown:
            return f"there is no axis '{unknown[0]}' in the stage: it has {', '.join(nodes)}"
        for name, value in given.items():
            reason = nodes[name].part.generator.refuse(value)
            if reason:
                return f"{name}: {reason}"
        if self.nodes[0].is_fused:
            loop = self.nodes[0].fused.loop
            loop.set_together({nodes[name].fused.place: value for name, value in given.items()})
            for name, value in given.items():
                nodes[name].note_setpoint(value)
            return ""
        sample = max(node.sample for node in self.nodes)
        for name, value in given.items():
            nodes[name].coming.append((sample, partial(nodes[name].take_now, value)))
        return ""

    @property
    def by_joint(self) -> dict[str, Any]:
        """The nodes, which must be configured, by the names of their joints."""
        return {node.parameters.joint: node for node in self.nodes}

    def rest(self, told: Mapping[str, Told]) -> None:
        """Bring joints to rest, except those whose move (with its callback in ``told``) has been replaced."""
        moving = [joint for joint, heard in told.items() if not self.by_joint[joint].trajectories.is_replaced(heard)]
        if moving:
            self.follow(dict.fromkeys(moving, REST))

    def follow(
        self,
        given: Mapping[str, Points],
        tolerances: Mapping[str, Tolerances] | None = None,
        told: Mapping[str, Told] | None = None,
    ) -> None:
        """Start the trajectories of several joints, all or none, at the same sample; a joint without points stops.

        ``tolerances`` are given by joint; by default the configured tolerances apply. The callbacks ``told``, given by
        joint, are called at the end of each move.

        Raises
        ------
        ParameterError
            A trajectory is refused; the message names its joint.
        """
        if len(self.runners) < len(self.rows) or not all(node.active for node in self.nodes):
            raise ParameterError([Problem("trajectory", ", ".join(given), "refused: a node is not active")])
        nodes, heard = self.by_joint, told or {}
        own = tolerances or {joint: nodes[joint].trajectories.tolerances for joint in given}
        for joint, points in given.items():
            try:
                if points["times"]:
                    copy.deepcopy(nodes[joint].part).follow(**points)
            except ParameterError as error:
                named = [replace(problem, name=f"{joint}: {problem.name}") for problem in error.problems]
                raise ParameterError(named) from None
        moved = {nodes[joint]: points for joint, points in given.items()}
        if self.nodes[0].is_fused:
            fused = self.nodes[0].fused
            actions = {node: ("follow", points) if points["times"] else ("hold", {}) for node, points in moved.items()}
            changes = {node.fused: Change(fused.loop.sample, node.kind, *action) for node, action in actions.items()}
            fused.apply_together(changes)
            for joint, points in given.items():
                if points["times"]:
                    nodes[joint].trajectories.attend(points, own[joint], heard.get(joint))
            return
        sample = max(node.sample for node in self.nodes)
        for joint, points in given.items():
            follow = partial(nodes[joint].follow_now, points, own[joint], heard.get(joint))
            nodes[joint].coming.append((sample, follow))


class StageReferenceNode(ReferenceGeneratorNode):
    """The reference generator of one axis of a stage; the other generators are in the same process."""

    def __init__(self, group: StageSources, **options):
        self.group, self.place = group, len(group.nodes)
        #: Requests that affect several axes together: first affected sample, and function to call before this sample.
        self.coming: deque = deque()
        super().__init__(**options)
        group.nodes.append(self)

    def connect(self) -> None:
        """Create the topics of the axis; the first reference generator also creates the topics of the stage."""
        super().connect()
        if self is self.group.nodes[0]:
            topic = f"{self.group.parameters.namespace}/{SETPOINTS}"
            self.subscriber(Float64MultiArray, topic, self._on_setpoints, setpoint_qos())
            topic = f"{self.group.parameters.namespace}/{JOINT_TRAJECTORY}"
            self.subscriber(JointTrajectory, topic, self._on_joint_trajectory, setpoint_qos())
            kind = action_type()
            if kind is not None:
                self.group.action = GroupAction(self.group, kind, f"{self.group.parameters.namespace}/{ACTION}")

    def unbuild(self) -> None:
        """Remove the action of the axis; the first reference generator also removes the action of the stage."""
        super().unbuild()
        if self.place == 0 and self.group.action is not None:
            self.group.action.server.destroy()
            self.group.action = None

    def after_step(self) -> None:
        """Update the pending moves, and the feedback of the goals of the stage."""
        super().after_step()
        if self.place == 0 and self.group.action is not None:
            self.group.action.tell()

    @property
    def scan_axis(self) -> int:
        """Index of this axis among the axes that follow the scan of the stage; -1: it follows no scan."""
        parameters = self.group.parameters
        name = parameters.names[self.place]
        return parameters.scanning_axes.index(name) if name in parameters.scanning_axes else -1

    @property
    def scan_clock(self) -> ScanClockTopic | None:
        """Clock of the scan of the stage, for an axis that follows it."""
        return self.group.scan_clock if self.scan_axis >= 0 else None

    @scan_clock.setter
    def scan_clock(self, clock: ScanClockTopic | None) -> None:
        if self.scan_axis >= 0:
            self.group.scan_clock = clock

    def make_scan_clock(self) -> ScanClockTopic | None:
        """Return the topic of the clock of the stage, for an axis that follows its scan."""
        parameters = self.group.parameters
        if self.scan_axis < 0:
            return None
        return ScanClockTopic(self, f"{parameters.namespace}/{SCAN_CLOCK}", len(parameters.scanning_axes))

    def reset_blocks(self) -> None:
        """Reset the waveform to its start, and the setpoint to the configured one."""
        super().reset_blocks()
        self.coming.clear()

    def note_setpoint(self, value: float) -> None:
        """Publish a setpoint [m] that the loop of the stage has taken."""
        self.setpoint = value
        self._taken.publish(Float64(data=value))

    def before_step(self) -> None:
        """Write the setpoint into the row."""
        while self.coming and self.coming[0][0] <= self.sample:
            self.coming.popleft()[1]()
        super().before_step()

    def take_now(self, value: float) -> None:
        """Take a setpoint [m] for the present sample."""
        self.take_and_tell(value)

    def follow_now(self, points: Points, tolerances: Tolerances, told: Told | None) -> None:
        """Follow a trajectory, beginning with the present sample; without points, end the present one at rest."""
        trajectories = self.trajectories
        assert trajectories is not None  # from configuration to cleanup
        try:
            if points["times"]:
                trajectories.follow(points, tolerances, told)
            else:
                trajectories.hold()
        except HysteresisError as error:
            trajectories.refuse(error)
            if told is not None:
                told(Ending.STOPPED, str(error))

    def _on_joint_trajectory(self, message) -> None:
        """Follow a trajectory of several joints, given by their names; the other joints do not move."""
        if len(self.group.runners) < len(self.group.rows) or self.trajectories is None:
            return
        try:
            self.group.follow(points_by_joint(message, [node.parameters.joint for node in self.group.nodes]))
        except HysteresisError as error:
            self.trajectories.refuse(error)

    def _on_setpoints(self, message) -> None:
        """Take setpoints of the axes that the label names, separated by commas; without a label, of all axes."""
        if len(self.group.runners) < len(self.group.rows):
            return
        label = message.layout.dim[0].label if message.layout.dim else ""
        names = [name.strip() for name in label.split(",")] if label else list(self.group.parameters.names)
        if len(set(names)) != len(names) or len(names) != len(message.data):
            reason = (
                f"setpoints has {len(message.data)} numbers for {', '.join(names)}; give one number "
                "for each, and no name twice"
            )
        else:
            reason = self.group.take(dict(zip(names, message.data, strict=True)))
        if reason:
            self.refuse("setpoints", f"{reason}; all setpoints are kept")


class StageRecorders(Group):
    """The recorders of a stage: one for the topics of each axis, with one common bag."""

    def __init__(self, parameters: StageParameters):
        super().__init__(parameters)
        self.recording: GuardedBag | None = None
        self.at_work: set = set()


class StageRecorderNode(RecorderNode):
    """Records the topics of one axis of a stage; the other recorders use the same process and bag."""

    def __init__(self, group: StageRecorders, **options):
        self.group = group
        self.hears_diagnostics = not group.nodes
        super().__init__(**options)
        group.nodes.append(self)

    def open_bag(self, parameters):
        """Return the bag of the stage, which the first recorder creates."""
        if self.group.recording is None or self.group.recording.bag is None:
            self.group.recording = super().open_bag(parameters)
        return self.group.recording

    @property
    def scan_clock(self) -> str:
        """Topic of the scan clock of the stage for the first recorder, which records it; empty for the others."""
        parameters = self.group.parameters
        return f"{parameters.namespace}/{SCAN_CLOCK}" if parameters.scan and self is self.group.nodes[0] else ""

    @property
    def described(self) -> tuple[str, ...]:
        """Namespaces of the axes whose files are in the bag."""
        return tuple(axis.namespace for axis in self.group.parameters.axes)

    def begin(self) -> None:
        """Write the configuration first, then allow the plant of the axis to begin."""
        self.group.at_work.add(self)
        super().begin()

    def finish_bag(self) -> None:
        """Finish the bag when no other recorder is active."""
        self.group.at_work.discard(self)
        if not self.group.at_work:
            super().finish_bag()


#: Inputs of a stage that act on several of its axes.
STAGE_INPUTS = (SETPOINTS, JOINT_TRAJECTORY, ACTION)


def stage_factories(parameters: StageParameters, kinds) -> list:
    """Return the factories of the nodes of these kinds for all axes; the first node exits last."""
    return [make for _, _, make in stage_nodes(parameters, kinds)]


def stage_nodes(parameters: StageParameters, kinds) -> list:
    """Return kind, axis and factory of each node of these kinds for all axes."""
    plants, recorders = StagePlants(parameters), StageRecorders(parameters)
    compensators, sources = StageCompensators(parameters), StageSources(parameters)
    controllers = StageControllers(parameters)
    axes: list[FusedAxis] = []
    for _ in parameters.axes if parameters.stage.time_mode == "fused" else ():
        axes.append(FusedAxis(axes[0] if axes else None, parameters))

    def compensator(**options):
        if not parameters.stage.decoupling:
            return HysteresisCompensatorNode(**options)
        return StageCompensatorNode(compensators, **options)

    made = {
        "recorder": lambda **options: StageRecorderNode(recorders, **options),
        "plant_simulator": lambda **options: StagePlantNode(plants, **options),
        "hysteresis_compensator": compensator,
        "motion_controller": lambda **options: StageControllerNode(controllers, **options),
        "reference_generator": lambda **options: StageReferenceNode(sources, **options),
    }

    def factory(kind: str, place: int):
        def make(**options):
            node = made[kind](namespace=parameters.axes[place].namespace, **options)
            return axes[place].join(node) if axes else node

        return make

    return [
        (kind, axis, factory(kind, place))
        for kind in made
        if kind in kinds
        for place, axis in enumerate(parameters.axes)
    ]


#: Kinds of nodes that an axis of a stage has.
KINDS = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")


def main(arguments=None) -> int:
    """Run the nodes of one kind, or of all kinds, for all axes; return the exit code."""
    arguments = list(sys.argv if arguments is None else arguments)
    kinds = [word for word in arguments if word in (*KINDS, "recorder")]
    if WITH_RECORDER in arguments:
        arguments.remove(WITH_RECORDER)
        kinds = [*KINDS, "recorder"]
    try:
        parameters = StageParameters.from_configuration(given_configuration(arguments, "stage"))
        require_messages(parameters)
        factories = stage_factories(parameters, kinds or KINDS)
    except HysteresisError as error:
        return refused(error)
    steered = "reference_generator" in (kinds or KINDS)
    return run(factories, [word for word in arguments if word not in kinds], steered)


if __name__ == "__main__":
    raise SystemExit(main())
