# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Base of the reference sources: they take setpoints and requests, and report why a request is refused."""

from __future__ import annotations

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray, String

from hysteresis_ros import signals
from hysteresis_ros.loop.description import robot_description
from hysteresis_ros.loop.parameters import SourceParameters
from hysteresis_ros.nodes.qos import chosen_qos, latched_qos, loop_qos, setpoint_qos
from hysteresis_ros.nodes.responder import Responder
from hysteresis_ros.nodes.triggers import INPUT, TriggerTopic
from hysteresis_ros.nodes.triggers import NAMES as TRIGGER_NAMES
from hysteresis_ros.units import micrometres

#: Interval of the check for missing samples [s].
LOOK = 0.1
#: Time for which samples may be missing [s], unless three sample times are longer.
SILENCE = 0.3


def nanoseconds(stamp) -> int:
    """Return a stamp [ns]."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


#: Queue depth of the accepted setpoints for a recorder.
KEPT = 1000
#: Service that takes a setpoint and replies.
SET_SETPOINT = "set_setpoint"
#: The only parameter of a request of this service.
ARGUMENT = "setpoint"


class ReferenceSource(Responder):
    """A node that takes setpoints on topics, and by a service.

    Every accepted setpoint is published on ``~/taken``, which is recorded. The reason of a refusal is published on
    ``~/refused``, because a publisher of setpoints gets no answer.
    """

    parameters: SourceParameters
    #: Number of refusals so far.
    refused = 0
    #: Present setpoint [m].
    setpoint = 0.0
    #: Last published value of ``settled``; None: no value yet; False while the topic does not exist, so that nothing is
    #: published.
    _told: bool | None = False
    #: Topic of the triggers; None: the axis makes no triggers.
    trigger_out: TriggerTopic | None = None
    #: Number of pulses of the trigger input for the next sample.
    pulses = 0

    def connect(self) -> None:
        """Create the topics."""
        super().connect()
        self._settled = self.publisher(Bool, "settled", latched_qos())
        self._told = None
        if self.parameters.publish_description:
            self._description = self.publisher(String, "robot_description", latched_qos())
            self._description.publish(String(data=robot_description(self.parameters)))
        self.tell_settled(False)
        self._refusals = self.publisher(String, "~/refused", setpoint_qos())
        self._taken = self.publisher(Float64, "~/taken", loop_qos(self.runner.keeps, KEPT))
        service = self.create_service(SetParametersAtomically, f"~/{SET_SETPOINT}", self._on_set_setpoint)
        self._topic_handles.append((self.destroy_service, service))
        heard = chosen_qos(setpoint_qos(), self.parameters.setpoint_reliability)
        self.subscriber(Float64, "setpoint", self._on_setpoint, heard)
        self.subscriber(Float64MultiArray, "~/commands", self._on_commands, setpoint_qos())
        self.trigger_out, self.pulses = None, 0
        self.offer_triggers(self.parameters)
        if self.parameters.triggers.input.action != "none":
            self.subscriber(Empty, INPUT, self._on_pulse, setpoint_qos())

    def begin(self) -> None:
        """Start the check for missing samples, because an axis without measurements has not settled."""
        self.timer(LOOK, self._look_for_samples)

    def _look_for_samples(self) -> None:
        if self.lacks_samples:
            self.forget_settled()
            self.tell_settled(False)

    @property
    def lacks_samples(self) -> bool:
        """Whether no sample has arrived for some time, in real time."""
        return not self.runner.exact and self.pace.age > max(SILENCE, 3.0 / self.parameters.sample_rate)

    def forget_settled(self) -> None:
        """Restart the settling detection."""

    def look_at(self, rows) -> None:
        """Update the settling detection with samples."""
        raise TypeError(f"{type(self).__name__} must implement when its axis has settled")

    def show_all(self, first: int, table) -> None:
        """Take the new samples of a fused loop, beginning with number ``first``, shape (row length, N)."""
        self.look_at(table.T.tolist())
        if self.trigger_out is not None:
            self.recorded(self.trigger_out, TRIGGER_NAMES)
            self.trigger_out.take_all(first, table, self.fused.plant.stamps.of_all)
        if table[signals.TRIGGER_IN].any():
            self.note_pulses()

    def offer_triggers(self, parameters) -> None:
        """Create the topic of the triggers if the parameters make triggers and it does not exist yet."""
        if parameters.triggers.makes_events and self.trigger_out is None:
            self.trigger_out = TriggerTopic(self)

    def recorded(self, topic, names) -> None:
        """Let the recorder of a fused axis write the content of a topic directly from the loop."""
        recorder = self.fused.nodes.get("recorder")
        if recorder is not None:
            topic.record = lambda stamp, values: recorder.write_message(topic.name, stamp, names, values)

    def note_pulses(self) -> None:
        """Update the node after pulses of the trigger input, from the row of the last sample."""

    def _on_pulse(self, message) -> None:
        if not self.active:
            return
        if self.is_fused:
            self.fused.pulse()
        else:
            self.pulses += 1

    def before_step(self) -> None:
        """Put the pulses of the trigger input into the row."""
        self.row[signals.TRIGGER_IN], self.pulses = float(self.pulses), 0

    def after_step(self) -> None:
        """Update the node after pulses of the trigger input."""
        if self.row[signals.TRIGGER_IN] > 0.0:
            self.note_pulses()

    def miss_sample(self) -> None:
        """Process a sample without a measurement, and without pulses of the trigger input."""
        self.row[signals.TRIGGER_IN] = 0.0
        super().miss_sample()

    def report(self, stamp) -> None:
        """Publish the trigger of the sample, then ``~/state``."""
        if self.trigger_out is not None and self.runner.by_message:
            self.trigger_out.take(nanoseconds(stamp), self.row)
        super().report(stamp)

    def reset_blocks(self) -> None:
        """Reset the part, and count triggers from 1 again."""
        super().reset_blocks()
        if self.trigger_out is not None:
            self.trigger_out.restart()

    def tell_settled(self, settled: bool) -> None:
        """Publish whether the axis has settled, when this has changed."""
        if settled != self._told:
            self._told = settled
            self._settled.publish(Bool(data=settled))

    def release(self) -> None:
        """Publish that the axis has not settled."""
        if self.parameters is not None:
            self.tell_settled(False)

    def take_setpoint(self, value: float) -> str:
        """Take a setpoint [m]; return why it is refused, or an empty text if it is taken."""
        raise TypeError(f"{type(self).__name__} must implement how it takes setpoints")

    def take_and_tell(self, value: float) -> str:
        """Take a setpoint [m] and publish it, or refuse it and publish the reason; return the reason."""
        reason = self.take_setpoint(value)
        if reason:
            reason = f"{reason}; {micrometres(self.setpoint)} is kept"
            self.refuse("setpoint", reason)
        else:
            self._taken.publish(Float64(data=value))
        return reason

    def _on_setpoint(self, message) -> None:
        self.take_and_tell(message.data)

    def _on_set_setpoint(self, request, response):
        """Take a setpoint and reply; the request sets a parameter, because ROS has no service with one number."""
        given = [(one.name, one.value) for one in request.parameters]
        if [name for name, _ in given] != [ARGUMENT] or given[0][1].type != Parameter.Type.DOUBLE.value:
            reason = f"{SET_SETPOINT} takes one parameter '{ARGUMENT}' of type double [m]"
        else:
            reason = self.take_and_tell(given[0][1].double_value)
        response.result.successful, response.result.reason = not reason, reason
        return response

    def _on_commands(self, message) -> None:
        """Take a setpoint in the form of ros2_control position controllers: an array with one number per joint."""
        if len(message.data) == 1:
            self.take_and_tell(message.data[0])
        else:
            allowed = f"allowed: one, the position of '{self.parameters.joint}' in m"
            self.refuse(
                "commands", f"commands has {len(message.data)} numbers, {allowed}; {micrometres(self.setpoint)} is kept"
            )

    def refuse(self, key: str, reason: str) -> None:
        """Count, log and publish a refusal."""
        self.refused += 1
        self.warn(key, reason)
        self._refusals.publish(String(data=reason))
