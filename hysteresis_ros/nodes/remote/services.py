# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis call``: what a node does on request, and its lifecycle."""

from __future__ import annotations

from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Log
from std_srvs.srv import Trigger

from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.nodes.remote.client import Client

#: Transitions that a person asks for.
TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")
#: Seconds in which the node's log says why it refuses.
WORDS = 0.5


def call(client: Client, node: str, action: str) -> None:
    """Ask a node for a service or a transition of its lifecycle, and print what it answers.

    Parameters
    ----------
    client : Client
    node, action : str

    Raises
    ------
    HysteresisError
        It has no such service, or refuses; its reason.
    """
    full = client.find(node)
    if action in TRANSITIONS:
        _change(client, full, action)
        return
    offered = client.until(lambda: _triggers(client, full))
    if action not in offered:
        known = (*offered, *TRANSITIONS)
        raise HysteresisError(
            f"{full} has no service '{action}'; it has {', '.join(offered) or 'none'}, and the transitions "
            f"{', '.join(TRANSITIONS)}{did_you_mean(action, known)}"
        )
    answer = client.ask(Trigger, f"{full}/{action}")
    if not answer.success:
        raise HysteresisError(f"{full} refuses to {action}: {answer.message}")
    print(f"{full}: {answer.message or 'done'}", flush=True)


def lifecycle_states(client: Client, names: list[str]) -> dict[str, str]:
    """Return the state of each node's lifecycle, all asked at once; of one that does not answer ``silent``.

    Parameters
    ----------
    client : Client
    names : list of str
        Full names of nodes.
    """
    asked = {name: client.node.create_client(GetState, f"{name}/get_state") for name in names}
    client.until(lambda: all(one.service_is_ready() for one in asked.values()))
    ready = {name: one for name, one in asked.items() if one.service_is_ready()}
    futures = {name: one.call_async(GetState.Request()) for name, one in ready.items()}
    client.until(lambda: all(future.done() for future in futures.values()))
    answers = {name: future.result().current_state.label for name, future in futures.items() if future.done()}
    return {name: answers.get(name, "silent") for name in names}


def _triggers(client: Client, full: str) -> list[str]:
    """Return the services without arguments that a node has, by their short names."""
    namespace, _, name = full.rpartition("/")
    found = client.node.get_service_names_and_types_by_node(name, namespace or "/")
    own = [(service.removeprefix(f"{full}/"), kinds) for service, kinds in found]
    return sorted(service for service, kinds in own if kinds == ["std_srvs/srv/Trigger"])


def _change(client: Client, full: str, action: str) -> None:
    before = lifecycle_states(client, [full])[full]
    answer = client.ask(GetAvailableTransitions, f"{full}/get_available_transitions")
    possible = [described.transition.label for described in answer.available_transitions]
    if action not in possible:
        raise HysteresisError(f"{full} is {before}: {action} is not possible, {' and '.join(possible)} are")
    said: list[str] = []

    def listen(message: Log) -> None:
        if message.name == full.strip("/").replace("/", ".") and message.level >= 30:
            said.append(message.msg)

    ear = client.node.create_subscription(Log, "/rosout", listen, 100)
    request = ChangeState.Request()
    request.transition.label = action
    try:
        done = client.ask(ChangeState, f"{full}/change_state", request).success
        if not done:
            client.until(lambda: said, WORDS)
            why = "; ".join(said) or "its log says why"
            raise HysteresisError(f"{full} is {before} and refuses to {action}: {why}")
    finally:
        client.node.destroy_subscription(ear)
    # a node that shuts down may leave before it can be asked
    after = "finalized" if action == "shutdown" else lifecycle_states(client, [full])[full]
    print(f"{full}: {before} → {after}", flush=True)
