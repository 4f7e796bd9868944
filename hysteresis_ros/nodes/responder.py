# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Base of source, controller and compensator: nodes that answer each sample with their part of the loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros import signals
from hysteresis_ros.errors import shortened
from hysteresis_ros.nodes.base import AxisNode
from hysteresis_ros.nodes.lockstep import LockstepResponder
from hysteresis_ros.nodes.qos import chosen_qos
from hysteresis_ros.nodes.realtime import RealTimeResponder

#: Frame of ``joint_states`` while the plant has stopped the axis.
TRIPPED_FRAME = signals.TRIPPED_FRAME
#: Number of joints at the beginning of a measurement among which the joint of the axis is searched.
MOST_JOINTS = 1000


@dataclass(frozen=True)
class Input:
    """A Float64 topic that carries one signal of the loop."""

    topic: str
    signal: int  #: Index in the row.
    partner: str  #: Node that publishes the topic.
    previous: bool = False  #: Whether a message belongs to the previous sample, as an achieved command does.
    #: In real time, whether a late message counts as missing; otherwise the last message replaces it.
    strict: bool = False


class Responder(AxisNode):
    """A node that computes its part of the loop in each sample.

    Subclasses set :attr:`part`, and apply their kernel of the loop to the row in :meth:`step`.
    """

    #: Name of the input that triggers an answer in real time.
    trigger = "joint_states"
    #: Whether the trigger is the measurement.
    triggered_by_measurement = True
    #: Subscribed and published Float64 topics, in order.
    inputs: tuple[Input, ...] = ()
    outputs: tuple[tuple[str, int], ...] = ()

    def __init__(self, name: str, **options):
        self.row = [0.0] * signals.MOTOR_ROW
        self.part = None
        self._joint_index = -1
        self.wrong_joint = False
        super().__init__(name, **options)

    lockstep_runner = LockstepResponder
    real_time_runner = RealTimeResponder

    # -- the part of the loop ------------------------------------------------------------------------------------

    def step(self) -> None:
        """Compute this node's part of the loop for the sample in the row."""
        raise TypeError(f"{type(self).__name__} must implement its part of the loop")

    def reset_blocks(self) -> None:
        """Reset the part to rest."""
        self.part.reset()
        self.row[:] = [0.0] * len(self.row)

    def retune(self, parameters) -> None:
        """Apply new parameters without a step of the output."""
        self.part.retune(parameters)

    def on_running(self, running: bool) -> None:
        """Move the part to its safe output (``~/stop``), or resume without a step (``~/start``)."""
        action = "start" if running else "stop"
        if self.is_fused:
            self.fused.apply(self.kind, action)
            return
        getattr(self.part, action)()
        self.log_change(action)

    def _on_start(self, request, response):
        if self.parameters is not None and self.loss:
            self.runner.unlatch()
        return super()._on_start(request, response)

    def hindrance(self) -> str:
        """Return why this node does not run although it was not stopped by the user; empty if it runs."""
        # the last sample, because a fused loop has advanced since it last published
        row = self.fused.latest()[1] if self.is_fused else self.row
        tripped = abs(row[signals.TRIPPED]) > 0.0 and not self.runner.goes_on
        stopped = "the plant has stopped the axis: call ~/start of plant_simulator to resume" if tripped else ""
        return super().hindrance() or self.loss or stopped

    def compile(self) -> None:
        """Run all operations of the part once, so that all kernels are compiled before the loop runs.

        A fused loop has its own machine code for all parts.
        """
        if self.part.parameters.time_mode == "fused":
            return
        for measured in (0.0, math.nan, 0.0):
            for stopping in (None, self.part.stop, self.part.start):
                if stopping is not None:
                    stopping()
                self.row[:] = [0.0] * len(self.row)
                self.row[signals.MEASURED] = self.row[signals.COMMAND] = measured
                self.step()
        self.part.reset()

    # -- messages ------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Create the topics of the loop."""
        self._message = Float64()
        qos = self.qos()
        state = self.state_signals()
        self._state_places = [signals.place(signal) for signal in state.values()]
        self._outputs = [(place, self.publisher(Float64, topic, qos, loop=True)) for topic, place in self.outputs]
        self.subscribe_end()
        if not self.runner.by_message:
            return
        heard = chosen_qos(qos, self.parameters.measurement_reliability)
        self.loop_input(JointState, "joint_states", self.take_measurement, heard, "plant_simulator")
        for place, input_ in enumerate(self.inputs):
            heard = self._heard(place)
            self.loop_input(Float64, input_.topic, heard, qos, input_.partner)

    def _heard(self, place: int):
        def take(message) -> None:
            self.runner.value(place, message.data)

        return take

    @property
    def take_measurement(self):
        """Return the callback of ``joint_states``."""
        return self.runner.measurement

    def read(self, message, row) -> bool:
        """Put the measurement of the joint, or NaN, into a row; return False if the message ends the run."""
        joint, names, index = self.parameters.joint, message.name, self._joint_index
        self.read_trip(message, row)
        row[signals.MEASURED] = math.nan
        if not 0 <= index < len(names) or names[index] != joint:
            self.wrong_joint = joint not in names[:MOST_JOINTS]
            if self.wrong_joint:
                there = shortened(list(names))
                text = f"joint '{joint}' is not in joint_states, which has {there}: set the parameter joint"
                if self.runner.exact:
                    self.fail(text)
                    return False
                self.warn("joint", text, error=True)
                return True
            index = self._joint_index = names.index(joint)
        self.wrong_joint = False
        if index < len(message.position):
            row[signals.MEASURED] = message.position[index]
        return True

    def read_trip(self, message, row) -> None:
        """Put into a row whether the axis is stopped by the plant, or because a partner of this node is lost."""
        tripped = message.header.frame_id == TRIPPED_FRAME
        self.runner.follow_trip(tripped)
        row[signals.TRIPPED] = 1.0 if tripped or self.runner.latched else 0.0

    @property
    def loss(self) -> str:
        """Message about the lost partner that keeps this part safe; empty if no partner is lost."""
        name = self.runner.latched
        return f"{name} is lost: when it is back, call ~/start of plant_simulator to resume" if name else ""

    def reject(self, row) -> None:
        """Remove the measurement from a row."""
        row[signals.MEASURED] = math.nan

    def take(self, input_: Input, data: float) -> None:
        """Store a value of an input."""
        self.row[input_.signal] = data

    def refuse_value(self, input_: Input, data: float) -> None:
        """Log that a value of an input is invalid."""

    # -- answers -------------------------------------------------------------------------------------------------

    def respond(self) -> None:
        """Run the part of the loop and publish its outputs."""
        self.before_step()
        self.step()
        self.close_answer()

    def close_answer(self) -> None:
        """Publish the outputs that are in the row and advance to the next sample."""
        self.publish_outputs()
        self.sample += 1
        self.after_step()

    def before_step(self) -> None:
        """Put the user's requests into the row."""

    def after_step(self) -> None:
        """Handle the results of the part."""

    def answer(self, stamp) -> None:
        """Answer the sample in the row."""
        self.respond()
        self.report(stamp)

    def show(self, stamp, quiet: bool) -> None:
        """Publish the row of a sample of a fused loop; ``quiet``: without log messages."""
        self.publish_outputs()
        self.report(stamp)
        if not quiet:
            self.after_step()

    def report(self, stamp) -> None:
        """Publish ``~/state`` with the stamp of a measurement."""
        self.publish_state(stamp, *self.state_values())

    def state_values(self) -> list[float]:
        """Return the content of ``~/state``."""
        row = self.row
        return [row[place] for place in self._state_places]

    def publish_outputs(self) -> None:
        """Publish the outputs of the part."""
        row, message = self.row, self._message
        for place, publisher in self._outputs:
            message.data = float(row[place])
            publisher.publish(message)

    # -- real time: missing inputs ------------------------------------------------------------------------------

    @property
    def patience(self) -> float:
        """Time without a trigger after which samples are counted by the clock [s]."""
        return self.parameters.measurement_timeout

    @property
    def is_stale(self) -> bool:
        """Whether the input of the part has been missing or unusable for longer than the time-out."""
        return False

    def say_silent(self) -> None:
        """Log that the trigger has stopped."""

    def miss_sample(self) -> None:
        """Process a sample without a trigger."""
        self.row[signals.MEASURED] = self.row[signals.COMMAND] = math.nan
        self.step()
        self.after_missing()

    def miss(self, samples: int) -> None:
        """Process samples without a trigger, and publish the result."""
        for _ in range(samples):
            self.miss_sample()
        self.publish_outputs()

    def after_missing(self) -> None:
        """Handle the results of the part in a sample without a trigger."""
