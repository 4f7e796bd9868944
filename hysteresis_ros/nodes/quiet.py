# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold over ROS: the service ``~/quiet`` of a motion controller, and pulses of the trigger input.

The drift is predicted by the creep model of the compensator. On a fused axis the controller reads the state of this
model directly. Between nodes it reads the parameters of the model from ``changes``, and advances a copy of the model
with the achieved commands.
"""

from __future__ import annotations

import json
import math

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import Empty, String

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.parameters import CompensatorNodeParameters, part
from hysteresis_ros.loop.quiet import DURATION, QUIET, TOLERANCE, Forecast
from hysteresis_ros.loop.watch import MODE_NAMES, RUNNING
from hysteresis_ros.loop.watch import QUIET as STANDING
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.creep import Creep, CreepParameters, creep, creep_inverse
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.triggers import INPUT

_CREEP, _INVERSE = interpreted(creep), interpreted(creep_inverse)


class QuietHold:
    """Takes requests for quiet holds of a motion controller."""

    def __init__(self, node):
        self._node = node
        #: The creep model of the compensator; None before its parameters are known.
        self._creep: Creep | None = None
        self._given: dict = {}
        service = node.create_service(SetParametersAtomically, f"~/{QUIET}", self._on_quiet)
        node._topic_handles.append((node.destroy_service, service))
        if node.runner.by_message:
            node.subscriber(String, "changes", self._on_change, node.changes_qos())
        if node.parameters.quiet.on_trigger:
            node.subscriber(Empty, INPUT, self._on_pulse, setpoint_qos())

    # -- the creep model, between nodes --------------------------------------------------------------------------

    def _on_change(self, message) -> None:
        """Store the parameters of the compensator."""
        try:
            entry = json.loads(message.data)
            if entry["node"] != signals.COMPENSATOR or entry["action"] not in (signals.CONFIGURED, "retune"):
                return
            self._given |= entry["parameters"]
        except (ValueError, KeyError, TypeError):
            return
        self._take_model(entry["action"] == signals.CONFIGURED)

    def _take_model(self, anew: bool) -> None:
        """Build the creep model at rest, as the compensator starts; unless ``anew``, retune an existing model."""
        try:
            parameters = part(CompensatorNodeParameters.from_mapping(self._given), CompensatorParameters)
        except (ValueError, KeyError, TypeError, HysteresisError):
            return
        if anew or self._creep is None:
            self._creep = Compensator(parameters, 1.0 / self._node.parameters.sample_rate).creep
        else:
            self._creep.retune(parameters.creep)

    def follow(self, applied: float) -> None:
        """Advance the creep model by an achieved command [m]."""
        model = self._creep
        if model is not None and len(model.x) > 1 and math.isfinite(applied):
            _CREEP(model.p, model.x, _INVERSE(model.p, model.x, applied))

    def reset(self) -> None:
        """Return the creep model to rest."""
        self._creep = None
        self._take_model(anew=True)

    @property
    def forecast(self) -> Forecast:
        """Predicted drift of a hold that begins now."""
        node = self._node
        if node.is_fused:
            return node.fused.axis.forecast()
        uncertainty = node.parameters.quiet.creep_uncertainty
        return Forecast(self._creep or Creep(CreepParameters(), 1.0 / node.parameters.sample_rate), uncertainty)

    # -- requests ------------------------------------------------------------------------------------------------

    def _begin(self, duration: float, tolerance: float = 0.0) -> str:
        """Begin a quiet hold of ``duration`` [s], or end it (0); return a description of the hold."""
        node, forecast = self._node, self.forecast
        forecast.require(duration, tolerance)
        hindrance = self._hindrance()
        if hindrance:
            raise HysteresisError(f"not quiet: {hindrance}")
        if node.is_fused:
            node.fused.apply(node.kind, QUIET, {DURATION: duration})
        else:
            node.part.quiet(duration)
            node.log_change(QUIET, {DURATION: duration})
        if not duration:
            return "the quiet hold ends"
        before = 2.0 * max(node.parameters.quiet.average, 2.0 / node.parameters.sample_rate)
        return f"quiet for {duration:g} s, from {before:g} s after the request; {forecast.describe(duration)}"

    def _hindrance(self) -> str:
        """Return why the axis is not in closed loop; empty if it is."""
        node = self._node
        row = node.fused.latest()[1] if node.is_fused else node.row
        mode = int(row[signals.CONTROLLER_MODE])
        running = "" if node.running else "the controller is stopped: call ~/start"
        wrong = f"the controller is {MODE_NAMES[mode]}" if mode not in (RUNNING, STANDING) else ""
        return node.hindrance() or running or wrong

    def _on_quiet(self, request, response):
        """Begin a quiet hold and reply; the request has parameters, because ROS has no service with numbers."""
        values = {one.name: one.value for one in request.parameters}
        numbers = all(value.type == Parameter.Type.DOUBLE.value for value in values.values())
        reason = f"{QUIET} takes the parameters '{DURATION}' [s] and, if wanted, '{TOLERANCE}' [m], of type double"
        success = False
        if DURATION in values and values.keys() <= {DURATION, TOLERANCE} and numbers:
            try:
                reason = self._begin(**{name: value.double_value for name, value in values.items()})
                success = True
            except HysteresisError as error:
                reason = " ".join(str(error).split())
        if not success:
            self._node.warn(QUIET, reason)
        response.result.successful, response.result.reason = success, reason
        return response

    def _on_pulse(self, message) -> None:
        node = self._node
        if not node.active:
            return
        if node.is_fused:
            # if the input has an action of its own, the source passes the pulse to the loop
            if node.fused.source.parameters.triggers.input.action == "none":
                node.fused.pulse()
            return
        duration = node.parameters.quiet.on_trigger
        node.part.quiet(duration)
        node.log_change(QUIET, {DURATION: duration})
