# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Services that say why nothing could be done, and survive any request of their type."""

from __future__ import annotations

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from hysteresis_ros.errors import LONGEST, HysteresisError, shortened

#: Types of a value that a parameter can be set to, by their number.
_SETTABLE = {kind.value: kind.name.lower() for kind in Parameter.Type if kind != Parameter.Type.NOT_SET}


def answered(serve):
    """Return a service that says why nothing could be done."""

    def answer(request, response):
        try:
            return serve(request, response)
        except HysteresisError as error:
            response.success, response.message = False, str(error)
            return response

    return answer


class GuardedServices(Node):
    """A node whose services survive any request, rclpy's own too; stands before rclpy's class of the node.

    An exception in a service ends the process with the outputs where they are: rclpy up to 7.1.6 raises one for a value
    of a type that it does not know, for instance.
    """

    def create_service(self, srv_type, srv_name, callback, **options):
        """Create a service that answers with a reason where its callback raises an exception."""
        return super().create_service(srv_type, srv_name, self._guarded(srv_type, srv_name, callback), **options)

    def guard_services(self) -> None:
        """Guard the services that rclpy made without :meth:`create_service`: of the life cycle, of message types."""
        for service in self._services:
            if not getattr(service.callback, "is_guarded", False):
                service.callback = self._guarded(service.srv_type, service.srv_name, service.callback)

    def _guarded(self, srv_type, name: str, serve):
        def answer(request, response):
            try:
                return answer_checked(request, response)
            except Exception as error:  # whatever a request leads to: the node goes on
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

        answer.is_guarded = True
        return answer


def _of(error: Exception) -> str:
    """Return what an exception says, in a line of bounded length."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:LONGEST]}"


def _why_not(parameter) -> str:
    """Return why a parameter of a request cannot be set, whatever the node; empty: it may be."""
    if not parameter.name:
        return "a parameter without a name cannot be set: give its name"
    if parameter.value.type not in _SETTABLE:
        types = ", ".join(f"{number} {name}" for number, name in _SETTABLE.items())
        return f"{shortened(parameter.name)}: type {parameter.value.type} of its value is not one of {types}"
    return ""


def _set_each(request, response, serve):
    """Set parameters one by one: what one is refused for does not concern the others."""
    for parameter in request.parameters:
        reason = _why_not(parameter)
        refused = [SetParametersResult(successful=False, reason=reason)] if reason else None
        response.results.extend(refused or serve(SetParameters.Request(parameters=[parameter])))
    return response


def _refusal(srv_type, request, reason: str):
    """Return the answer of a service that has not done what it was asked, with the reason where it has a place."""
    response = srv_type.Response()
    if srv_type is SetParametersAtomically:
        response.result.reason = reason
    for name, value in (("success", False), ("successful", False), ("message", reason), ("failure_reason", reason)):
        if hasattr(response, name):
            setattr(response, name, value)
    return response
