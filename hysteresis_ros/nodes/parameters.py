# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Interface of a node to its users: parameters from the tables of the blocks, and services that explain a refusal.

A value of the command line (``-p``) overrides parameter files; rcl does not do this for sections with wildcards. A file
name that is set over the graph must be in a folder that the user of the node has allowed. No request stops the node.
"""

from __future__ import annotations

import contextlib
import copy
import os
import pathlib
import sys
from array import array

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ListParametersResult,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from hysteresis_ros.configuration import ARRAY_TYPES, ParameterRow
from hysteresis_ros.errors import LONGEST, HysteresisError, ParameterError, Problem, shortened
from hysteresis_ros.files import BoundsError, read_yaml

#: Begin and end markers of the ROS arguments.
BEGIN, END = "--ros-args", "--"
FLAGS = ("-p", "--param")


def assigned(name: str, full_name: str, arguments: list[str] | None = None) -> dict:
    """Return the values of ``-p [NODE:]NAME:=VALUE`` for a node; the last value of a name takes precedence."""
    values, ours, words = {}, False, iter(sys.argv if arguments is None else arguments)
    for word in words:
        if word in (BEGIN, END):
            ours = word == BEGIN
        elif ours and word in FLAGS:
            left, is_one, value = next(words, "").partition(":=")
            node, _, parameter = left.rpartition(":")
            if is_one and node in ("", name, full_name):
                values[parameter] = _value(value)
    return {parameter: value for parameter, value in values.items() if value is not None}


def _value(text: str):
    """Return a value as in a parameter file; unlike in YAML 1.1, 1e-6 is a number."""
    try:
        value = read_yaml(text)
    except BoundsError:
        return text
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    if isinstance(value, list):
        return [_value(item) if isinstance(item, str) else item for item in value]
    return value


#: Limits that protect the connected device: the end of the parameter's name, and the sign of a change that widens the
#: limit.
WIDER = {"limits.minimum": -1.0, "limits.maximum": 1.0, "limits.slew_rate": 1.0, "safe_slew_rate": 1.0}
#: Environment variable with the allowed folders, separated as in PATH; by default the working folder of the node
#: without hidden files.
FOLDERS = "HYSTERESIS_FILES"


def misplaced(row: ParameterRow, value) -> Problem | None:
    """Return a Problem if a path must not be set over the graph; None if it may.

    Symbolic links and ``..`` are resolved first.
    """
    if row.place == "start" and (row.choices is None or (isinstance(value, str) and "/" in value)):
        remedy = "may load code or any file: set it only in the parameter file or on the command line of the node"
        return Problem(row.name, value, remedy)
    if row.place != "files" or not isinstance(value, str) or not value:
        return None
    stated = os.environ.get(FOLDERS)
    if stated is None:
        folders, where = _working_folder(), "the folder in which the node was started, without hidden files"
    else:
        folders, where = [pathlib.Path(name) for name in stated.split(os.pathsep) if name], FOLDERS
    try:
        path = pathlib.Path(value).expanduser().resolve()
        if any(part.is_symlink() for part in (path, *path.parents)):  # since Python 3.13 a loop raises no error
            raise OSError("a loop of symbolic links")
        below = [path.relative_to(root) for root in _resolved(folders) if path.is_relative_to(root)]
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, an unknown user, or a null byte
        return Problem(row.name, value, f"is not a path: {error}")
    if any(stated is not None or not any(part.startswith(".") for part in found.parts) for found in below):
        return None
    there = ", ".join(map(str, folders)) or "nowhere"
    remedy = (
        f"a file named over the graph must be in {there} ({where}); choose a file there, give it in the parameter "
        f"file of the node, or start the node with {FOLDERS}=FOLDER"
    )
    return Problem(row.name, value, remedy)


def _working_folder() -> list[pathlib.Path]:
    """Return the working folder, or an empty list if it is the root folder, which contains every file."""
    folder = pathlib.Path.cwd()
    return [folder] if folder != pathlib.Path(folder.anchor) else []


def _resolved(folders: list[pathlib.Path]) -> list[pathlib.Path]:
    return [folder.expanduser().resolve() for folder in folders]


#: Types of parameter values, by number.
_SETTABLE = {kind.value: kind.name.lower() for kind in Parameter.Type if kind != Parameter.Type.NOT_SET}


def answered(serve):
    """Return a service callback that reports errors of ``serve`` in its answer."""

    def answer(request, response):
        try:
            return serve(request, response)
        except HysteresisError as error:
            response.success, response.message = False, str(error)
            return response

    return answer


class GuardedServices(Node):
    """A node whose services, including those of rclpy, survive any request; name it before rclpy's node class.

    An exception in a service would end the process without moving the outputs to safe values; for instance, rclpy up to
    7.1.6 raises an exception for a value of an unknown type.
    """

    def create_service(self, srv_type, srv_name, callback, **options):
        """Create a service that answers with the reason if its callback raises an exception."""
        return super().create_service(srv_type, srv_name, self._guarded(srv_type, srv_name, callback), **options)

    def guard_services(self) -> None:
        """Guard the services that rclpy creates without :meth:`create_service`: lifecycle and type description."""
        for service in self._services:
            if not getattr(service.callback, "is_guarded", False):
                service.callback = self._guarded(service.srv_type, service.srv_name, service.callback)

    def _guarded(self, srv_type, name: str, serve):
        def answer(request, response):
            try:
                return answer_checked(request, response)
            except Exception as error:  # no request may stop the node
                reason = _of(error)
                self.get_logger().warning(f"service {name} refused a request: {reason}", throttle_duration_sec=1.0)
                return _refusal(srv_type, request, reason)

        def answer_checked(request, response):
            if srv_type is SetParameters:
                return _set_each(request, response, answer_one)
            if srv_type is SetParametersAtomically:
                reasons = filter(None, map(_why_not, request.parameters))
                if reason := next(reasons, ""):
                    response.result = SetParametersResult(successful=False, reason=reason)
                    return response
            return serve(request, response)

        def answer_one(request):
            try:
                return serve(request, SetParameters.Response()).results
            except Exception as error:
                reason = f"{shortened(request.parameters[0].name)}: {_of(error)}"
                return [SetParametersResult(successful=False, reason=reason)]

        vars(answer)["is_guarded"] = True
        return answer


def _of(error: Exception) -> str:
    """Return the message of an exception as one short line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:LONGEST]}"


def _why_not(parameter) -> str:
    """Return why no node could set a parameter of a request; empty if it can be set."""
    if not parameter.name:
        return "a parameter without a name cannot be set: give its name"
    if parameter.value.type not in _SETTABLE:
        types = ", ".join(f"{number} {name}" for number, name in _SETTABLE.items())
        return f"{shortened(parameter.name)}: type {parameter.value.type} of its value is not one of {types}"
    return ""


def _set_each(request, response, serve):
    """Set parameters one by one, so that a refusal does not affect the other parameters."""
    for parameter in request.parameters:
        reason = _why_not(parameter)
        refused = [SetParametersResult(successful=False, reason=reason)] if reason else None
        response.results.extend(refused or serve(SetParameters.Request(parameters=[parameter])))
    return response


def _refusal(srv_type, request, reason: str):
    """Return the answer of a service that refuses a request, with the reason if the type has a field for it."""
    response = srv_type.Response()
    if srv_type is SetParametersAtomically:
        response.result.reason = reason
    for name, value in (("success", False), ("successful", False), ("message", reason), ("failure_reason", reason)):
        if hasattr(response, name):
            setattr(response, name, value)
    return response


#: Parameters that ROS declares on every node.
_ROS_OWN = ("use_sim_time", "start_type_description_service")

#: ROS type of each parameter type.
_TYPES = {
    float: ParameterType.PARAMETER_DOUBLE,
    int: ParameterType.PARAMETER_INTEGER,
    bool: ParameterType.PARAMETER_BOOL,
    str: ParameterType.PARAMETER_STRING,
    tuple[float, ...]: ParameterType.PARAMETER_DOUBLE_ARRAY,
    tuple[str, ...]: ParameterType.PARAMETER_STRING_ARRAY,
}


class TabledParameters(Node):
    """Mixin that describes a node's parameters to other nodes; name it before rclpy's node class."""

    interface: ParameterInterface

    def describe_parameter(self, name: str):
        """Return the description of a parameter, with its range and whether it can be changed."""
        return self.interface.described(super().describe_parameter(name))

    def list_parameters(self, prefixes: list, depth: int):
        """List the parameters that have a value, so that a dump can be loaded again."""
        return self.interface.with_values(super().list_parameters(prefixes, depth))


class ParameterInterface:
    """Declares a parameter table on a node and keeps the typed parameters consistent with it.

    A value of the command line (``-p``) overrides every matching section of parameter files.
    """

    def __init__(self, node, cls, apply):
        self._node, self._cls, self._apply = node, cls, apply
        self._rows = {row.name: row for row in cls.table()}
        self.typed = None
        given = {name: override.value for name, override in node._parameter_overrides.items()}
        given |= assigned(node.get_name(), node.get_fully_qualified_name())
        self._at_start: dict = {}
        for row in self._rows.values():
            if node.has_parameter(row.name):  # use_sim_time: rclpy declares it
                continue
            default = list(row.default) if isinstance(row.default, tuple) else row.default
            value = self._typed(row, given.get(row.name, None if row.required else default), row.name in given)
            node.declare_parameter(row.name, value, _declared(row), ignore_override=True)
            self._at_start[row.name] = self._value(row.name, value)
        node.add_pre_set_parameters_callback(self._converted)
        node.add_on_set_parameters_callback(self._check)

    def read(self):
        """Return the typed parameters."""
        values = self._values()
        for name, override in self._node._parameter_overrides.items():
            if name not in values and name not in _ROS_OWN and not name.startswith("qos_overrides."):
                values.setdefault(name, override.value)
        self.typed = self._cls.from_mapping(values)
        return self.typed

    def described(self, descriptor: ParameterDescriptor) -> ParameterDescriptor:
        """Return the published description of a parameter, with its type, its range and whether it can be changed.

        rclpy itself does not get type and range, because it would refuse values without naming the allowed ones.
        """
        row = self._rows.get(descriptor.name)
        if row is None:
            return descriptor
        full = copy.deepcopy(descriptor)
        full.type, full.read_only = _TYPES[row.type], row.read_only
        low, high = row.low, row.high
        if row.type is float and (low is not None or high is not None):
            full.floating_point_range = [
                FloatingPointRange(
                    from_value=-sys.float_info.max if low is None else float(low),
                    to_value=sys.float_info.max if high is None else float(high),
                )
            ]
        elif row.type is int and (low is not None or high is not None):
            full.integer_range = [
                IntegerRange(
                    from_value=-(2**63) if low is None else int(low),
                    to_value=2**63 - 1 if high is None else int(high),
                    step=1,
                )
            ]
        return full

    def with_values(self, listed: ListParametersResult) -> ListParametersResult:
        """Remove parameters without a value from a list, because a file cannot express a missing value."""
        listed.names = [name for name in listed.names if self._is_set(name)]
        return listed

    def _is_set(self, name: str) -> bool:
        return self._node.get_parameter(name).type_ != Parameter.Type.NOT_SET

    def _values(self) -> dict:
        return {
            name: self._value(name, self._node.get_parameter(name).value) for name in self._rows if self._is_set(name)
        }

    def _value(self, name: str, value):
        """Return a value in plain Python types; ROS returns an empty array of unknown type as None or as bytes."""
        if isinstance(value, (str, bool, int, float)):
            return value
        if not value and self._rows[name].type in ARRAY_TYPES:
            return ()
        return value if value is None else list(value)

    def _typed(self, row: ParameterRow, value, is_given: bool = True):
        """Return a value in the type of its row, converted from an integer or from the text of a number.

        ``ros2 param`` applies YAML 1.1, which reads 5e-7 as text, 1 as an integer and [] as no value.
        """
        if row.type is float and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                return shortened(value)  # remains a text, which is refused later with the parameter's name
            except (TypeError, ValueError):
                return value
        if row.type is str and isinstance(value, int) and not isinstance(value, bool):
            return str(value)
        if row.type in ARRAY_TYPES and is_given and not value and not isinstance(value, (bool, int, float, str)):
            return []
        if row.type == tuple[float, ...] and isinstance(value, (list, array)) and value:
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                return array("d", map(float, value))
        return value

    def _converted(self, changes):
        """Convert values to the types in the parameter table before they are set; other values are refused later."""
        return [
            Parameter(change.name, value=self._typed(self._rows[change.name], change.value))
            if change.name in self._rows
            else change
            for change in changes
        ]

    def _check(self, changes) -> SetParametersResult:
        changed = {
            change.name: self._value(change.name, change.value) for change in changes if change.name in self._rows
        }
        own = [name for name in changed if name in _ROS_OWN]
        if not changed or own == list(changed):
            return SetParametersResult(successful=True)
        try:
            self._refuse_misplaced(changed)
            self._refuse_beyond_start(changed)
            if own or len(changed) < len(changes):
                # not atomic: another callback may refuse its parameters after this one has applied the others
                raise ParameterError([Problem(", ".join(own), "", "set it alone, not together with other parameters")])
            if self.typed is None:
                for name, value in changed.items():
                    self._rows[name].convert(value)
            else:
                self._refuse_read_only(changed)
                # no other callback handles these names, so the accepted values are set immediately and atomically
                typed = self._cls.from_mapping(self._values() | changed)
                self._apply(typed)
                self.typed = typed
        except HysteresisError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _refuse_beyond_start(self, changed: dict) -> None:
        """To protect the connected device, refuse voltage limits that are wider than at the start of the node."""
        beyond = [name for name, value in changed.items() if self._is_beyond(name, value, self._at_start.get(name))]
        if beyond:
            raise ParameterError(
                Problem(
                    name,
                    changed[name],
                    f"beyond its start value of {self._at_start[name]:g} {self._rows[name].unit}; give the wider limit "
                    f"in the parameter file, or with -p {name}:=…, and restart the node",
                )
                for name in beyond
            )

    def _is_beyond(self, name: str, value, limit) -> bool:
        """Return whether a value allows more voltage, or a faster change of it, than the limit at the start."""
        sign = WIDER.get(".".join(name.split(".")[-2:]), 0.0)
        if not sign or self._rows[name].unit not in ("V", "V/s"):
            return False
        if not isinstance(value, (int, float)) or not isinstance(limit, (int, float)):
            return False
        if name.endswith("limits.slew_rate"):  # 0: unlimited
            return limit > 0.0 and (value == 0.0 or value > limit)
        return sign * value > sign * limit

    def _refuse_misplaced(self, changed: dict) -> None:
        """Refuse paths that must not be set over the graph; the initial values are always allowed."""
        new = {name: value for name, value in changed.items() if value != self._at_start.get(name)}
        problems = [misplaced(self._rows[name], value) for name, value in new.items()]
        if any(problems):
            raise ParameterError(filter(None, problems))

    def _refuse_read_only(self, changed: dict) -> None:
        """Refuse changes of read-only parameters while the node is configured; setting the present value is allowed."""
        now = self._values()
        fixed = [name for name in changed if self._rows[name].read_only]
        problems = [
            Problem(
                name,
                changed[name],
                f"read-only while the node is configured: still {now.get(name)}; set it in the parameter file, or "
                f"after `ros2 lifecycle set {self._node.get_fully_qualified_name()} cleanup`",
            )
            for name in fixed
            if name not in now or self._rows[name].convert(changed[name]) != self._rows[name].convert(now[name])
        ]
        if problems:
            raise ParameterError(problems)


def _declared(row: ParameterRow) -> ParameterDescriptor:
    """Return the descriptor of a parameter for rclpy."""
    return ParameterDescriptor(
        name=row.name,
        description=f"{row.description} [{row.unit}]" if row.unit else row.description,
        additional_constraints=row.allowed(),
        dynamic_typing=True,
    )
