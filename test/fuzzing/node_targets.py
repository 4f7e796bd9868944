# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inputs of nodes: messages of the right type with any values, and parameters of any type, without DDS."""

from __future__ import annotations

import functools
import importlib
import json
import math
from pathlib import Path

from judging import Target
from mutations import mutated_value

#: Smallest and largest value of each integer type of a message.
WHOLE = {f"{sign}int{bits}": bits for sign in ("", "u") for bits in (8, 16, 32, 64)} | {"octet": 8, "byte": 8}


@functools.cache
def _nodes():
    """Return the nodes of an axis that answer messages, active but never spun, in a separate domain."""
    import rclpy
    from rclpy.context import Context
    from rclpy.parameter import Parameter

    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.parameters import AxisParameters
    from hysteresis_ros.nodes.displacement_camera import DisplacementCameraNode
    from hysteresis_ros.nodes.domain import Domain
    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode
    from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode

    domain, context = Domain().__enter__(), Context()
    rclpy.init(context=context, domain_id=domain.number)
    axis = AxisParameters.from_configuration(load_configuration("kim2009").override("", time_mode="realtime"), "")
    made = {}
    for cls, name in (
        (ReferenceGeneratorNode, "reference_generator"),
        (MotionControllerNode, "motion_controller"),
        (HysteresisCompensatorNode, "hysteresis_compensator"),
        (DisplacementCameraNode, "displacement_camera"),
    ):
        parameters = getattr(axis, name)
        values = {"calibration.scale": 1e-6, "time_mode": "realtime"} if parameters is None else parameters.to_mapping()
        overrides = [
            Parameter(key, value=list(value) if isinstance(value, tuple) else value)
            for key, value in values.items()
            if value != ()
        ]
        node = made[name] = cls(context=context, parameter_overrides=overrides)
        assert node.configure_now() and node.activate_now(), node.failure
    return made


def message_of(kind, values):
    """Return a message of a type with those of the given values that its fields can hold."""
    message = kind()
    values = values if isinstance(values, dict) else {}
    for name, field_type in kind.get_fields_and_field_types().items():
        if name in values:
            value = _value(field_type, values[name])
            if value is not None:
                setattr(message, name, value)
    return message


def _value(field_type: str, value):
    if field_type.startswith("sequence<"):
        items = value if isinstance(value, list) else [value]
        found = [_value(field_type[9:-1].partition(",")[0], item) for item in items]
        return [item for item in found if item is not None]
    if field_type in WHOLE:
        bits, signed = WHOLE[field_type], field_type.startswith("int")
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        return min(max(value, low), high) if isinstance(value, int) else None
    if field_type in ("double", "float"):
        try:
            return float(value) if isinstance(value, (int, float)) else None
        except OverflowError:
            return None
    if field_type == "boolean":
        return value if isinstance(value, bool) else None
    if field_type.startswith("string"):
        return value.encode(errors="replace").decode() if isinstance(value, str) else None
    if "/" in field_type:
        package, name = field_type.split("/")
        return message_of(getattr(importlib.import_module(f"{package}.msg"), name), value)
    return None


def _heard() -> list[bytes]:
    _nodes()  # before anything is timed
    header = {"stamp": {"sec": 1, "nanosec": 5}, "frame_id": ""}
    joints = {"header": header, "name": ["extender"], "position": [1e-6], "velocity": [0.0], "effort": []}
    point = {"positions": [1e-6], "velocities": [], "time_from_start": {"sec": 1, "nanosec": 0}}
    path = {
        "header": {},
        "joint_names": ["extender"],
        "points": [{**point, "time_from_start": {"nanosec": 10**8}}, point],
    }
    image = {"header": header, "height": 40, "width": 48, "step": 48, "encoding": "mono8", "data": [20, 200] * 960}
    heard = [
        *(["reference_generator", "setpoint", {"data": value}] for value in (1.0, -1.0, math.nan, math.inf)),
        *(["reference_generator", "setpoint", {"data": 1e-6}], ["reference_generator", "joint_states", joints]),
        *(["reference_generator", "joint_trajectory", path], ["motion_controller", "joint_states", joints]),
        *(["motion_controller", "reference", {"data": 1e-6}], ["motion_controller", "applied", {"data": 1e-6}]),
        *(["hysteresis_compensator", "command", {"data": 1e-6}], ["hysteresis_compensator", "joint_states", joints]),
        *(["displacement_camera", "image", image], ["motion_controller", "end_of_run", {"data": 3}]),
        ["motion_controller", "", {"sliding_mode.eta": 0.01, "measurement_timeout": 0.1}],
        ["reference_generator", "", {"initial_setpoint": 1e-6, "waveform.type": "sine"}],
        ["hysteresis_compensator", "", {"limits.maximum": 90.0, "adaptation.type": "none"}],
    ]
    return [json.dumps(entry).encode() for entry in heard]


def _hear(data: bytes, folder: Path):
    """No input may raise an exception in a node, end it, or cause an output that is not finite."""
    from rclpy.parameter import Parameter

    entry = json.loads(data)
    if not isinstance(entry, list) or len(entry) != 3:
        return
    name, topic, values = entry
    node = _nodes().get(name if isinstance(name, str) else "")
    if node is None:
        return
    if topic:
        for subscription in node.subscriptions:
            if subscription.topic_name == f"/{topic}":
                subscription.callback(message_of(subscription.msg_type, values))
    elif isinstance(values, dict):
        parameters = []
        for key, value in values.items():
            if not node.has_parameter(key):
                continue  # rclpy's service answers that the parameter does not exist
            try:
                parameters.append(Parameter(key, value=value))
            except (TypeError, ValueError, AssertionError):
                continue  # a value that no message can hold
        for result in node.set_parameters(parameters):
            assert result.successful or result.reason, "refused without a reason"
    assert not node.failure, node.failure
    if name == "reference_generator":
        own = node.parameters
        assert own.minimum <= node.setpoint <= own.maximum, f"a setpoint of {node.setpoint}"
    row = getattr(node, "row", None)
    if row is not None:
        for place, _ in node._outputs:
            assert math.isfinite(row[place]), f"{name} gives {row[place]}"


@functools.cache
def _words() -> tuple[str, ...]:
    from hysteresis_ros.loop.parameters import NODE_PARAMETERS

    names = [row.name for name in ("motion_controller", "reference_generator") for row in NODE_PARAMETERS[name].table()]
    return ("extender", "joint_states", "setpoint", "joint_trajectory", "tripped", *names[::5])


TARGETS = (Target("messages and parameters of nodes", _hear, _heard, mutated_value, _words(), suite=600),)
