# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Client node of a command: finds the nodes of an axis, calls services and listens, always with a time-out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from hysteresis_ros.configuration import NODE_NAMES, OPTIONAL_NODE_NAMES, normalised_namespace
from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.qos import diagnostics_qos
from hysteresis_ros.nodes.security.policy import OPERATOR, enclave_of
from hysteresis_ros.nodes.timing import COMPILING_TEXT

#: Duration of one check of the graph [s].
LOOK = 0.02
#: Time without a change after which discovery counts as complete [s].
SETTLED = 0.5
#: Topic of the diagnostics.
DIAGNOSTICS = "/diagnostics"


class AbsentError(HysteresisError):
    """A node is missing or does not answer."""


class Client:
    """A client node; use it in a ``with`` statement. ``timeout`` [s] limits every wait."""

    def __init__(
        self,
        namespace: str = "",
        timeout: float = 5.0,
        context: Context | None = None,
        make_executor: Callable[[], Any] | None = None,
        name: str = "",
    ):
        self.namespace, self.timeout = normalised_namespace(namespace), timeout
        self._context, self._name = context, name or str(os.getpid())
        self._own = context is None
        self._make_executor = make_executor or (lambda: SingleThreadedExecutor(context=self._context))
        self._clients: dict[str, Any] = {}
        #: Time without a change after which discovery counts as complete [s].
        self.settles = SETTLED

    def __enter__(self) -> Client:
        """Enter the graph."""
        if self._own:
            stay_on_this_machine()
            self._context = Context()
        try:
            if self._own:
                enclave = enclave_of(self.namespace, OPERATOR)
                rclpy.init(args=["--ros-args", "--enclave", enclave], context=self._context)
            self.node = rclpy.create_node(
                f"_hysteresis_{self._name}",  # a name with an underscore is hidden
                namespace=self.namespace or "/",
                context=self._context,
                start_parameter_services=False,
                enable_rosout=False,
            )
        except Exception as error:  # rclpy has an error class of its own for each kind of wrong name
            self._leave()
            raise HysteresisError(f"namespace {self.namespace}: {str(error).splitlines()[0]}") from None
        self._executor = self._make_executor()
        self._executor.add_node(self.node)
        return self

    def __exit__(self, *exception) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._leave()

    def _leave(self) -> None:
        if self._own and self._context is not None:
            self._context.try_shutdown()

    def until(self, condition: Callable[[], Any], seconds: float | None = None) -> Any:
        """Spin until a condition holds or the time-out has passed; return the last value of the condition."""
        deadline = time.monotonic() + (self.timeout if seconds is None else seconds)
        while True:
            found = condition()
            if found or time.monotonic() >= deadline:
                return found
            self.hear()

    def hear(self) -> None:
        """Take a message that is pending, or wait for a moment."""
        self._executor.spin_once(timeout_sec=LOOK)

    def full_name(self, name: str) -> str:
        """Return a name with the namespace in front, unless it is a full name."""
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def nodes(self) -> list[str]:
        """Return the full names of the present nodes, except the nodes of commands."""
        found = self.node.get_node_names_and_namespaces()
        return sorted({f"{space.rstrip('/')}/{name}" for name, space in found if not name.startswith("_")})

    def settle(self) -> list[str]:
        """Wait until there is a node of an axis and no further node appears; return the present nodes."""
        known: list[str] = []
        since = time.monotonic()

        def still() -> bool:
            nonlocal known, since
            found = self.nodes()
            if found != known:
                known, since = found, time.monotonic()
            return bool(axis_nodes(found)) and time.monotonic() - since > self.settles

        self.until(still)
        return known

    def find(self, name: str) -> str:
        """Wait until a node is present, and return its full name."""
        wanted = self.full_name(name)
        if not self.until(lambda: wanted in self.nodes()):
            raise AbsentError(f"no node {wanted} within {self.timeout:g} s; {self.who_is_there(wanted)}")
        return wanted

    def who_is_there(self, wanted: str = "") -> str:
        """Return a text with the present nodes, and with the node whose name is similar to ``wanted``."""
        found = self.nodes()
        if not found:
            return f"no node is in the ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}: is an axis running?"
        return f"there are {', '.join(found)}{did_you_mean(wanted, found) if wanted else ''}"

    def make_client(self, kind, service: str):
        """Return the client of a service; clients are kept, because finding a service takes longer than using it."""
        return self._clients.get(service) or self._clients.setdefault(service, self.node.create_client(kind, service))

    def ask(self, kind, service: str, request=None, seconds: float | None = None):
        """Return the answer of a service."""
        client = self.make_client(kind, service)
        allowed = self.timeout if seconds is None else seconds
        owner = service.rsplit("/", 1)[0]
        if not self.until(client.service_is_ready, allowed):
            raise AbsentError(f"{owner} offers no {service} within {allowed:g} s; is it a node of an axis?")
        future = client.call_async(request or kind.Request())
        if not self.until(future.done, allowed):
            raise AbsentError(f"{owner} does not answer within {allowed:g} s: {self.why_silent(owner)}")
        return future.result()

    def why_silent(self, full: str) -> str:
        """Return why a node does not answer, from its last diagnostics."""
        busy = self.last_report(full, SETTLED, bool) == COMPILING_TEXT
        return COMPILING_TEXT if busy else "it hangs or has been killed"

    def last_report(self, full: str, seconds: float, wanted: Callable[[str], bool]) -> str:
        """Return the message of a node's diagnostics: the first that is wanted, or the last within ``seconds`` [s]."""
        said: dict[str, str] = {}

        def hear(message: DiagnosticArray) -> None:
            said.update({status.name.removesuffix(": axis"): status.message for status in message.status})

        ear = self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, hear, diagnostics_qos(keeps=True))
        self.until(lambda: wanted(said.get(full, "")), seconds)
        self.node.destroy_subscription(ear)
        return said.get(full, "")


def axis_nodes(names) -> dict[str, list[str]]:
    """Return the names of the nodes of an axis for each namespace with such nodes."""
    found: dict[str, list[str]] = {}
    for full in names:
        namespace, _, name = full.rpartition("/")
        if name in NODE_NAMES + OPTIONAL_NODE_NAMES:
            found.setdefault(namespace, []).append(name)
    return found
