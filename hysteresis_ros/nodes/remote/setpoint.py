# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis setpoint``: a setpoint, and whether it was taken."""

from __future__ import annotations

import math
import sys

from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.watch import STOPPED, TRIPPED
from hysteresis_ros.nodes.discovery import named
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.remote.client import SETTLED, AbsentError, Client, axis_nodes
from hysteresis_ros.nodes.remote.services import lifecycle_states
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.units import readable

#: Nodes that answer a setpoint: by their state, or on ``~/refused``.
SOURCES = (signals.SOURCE, signals.MOTOR_SOURCE)
#: Seconds after which both sides know each other; a volatile message sent before is lost.
ACQUAINTANCE = 0.5
#: Seconds after which a person wants to know what is waited for.
PATIENCE = 2.0
#: Seconds in which a sample is made.
ANSWER = 5.0


def setpoint(client: Client, value: float) -> None:
    """Publish a setpoint and wait until the source of the references has taken it.

    Parameters
    ----------
    client : Client
    value : float
        [m]

    Raises
    ------
    HysteresisError
        It was refused, nobody listens, or who listens cannot move the axis; the sentence says which.
    """
    topic = client.full_name("setpoint")
    publisher = client.node.create_publisher(Float64, topic, setpoint_qos())
    source = _source(client, topic)
    said: list[str] = []
    state: dict[str, float] = {}
    if source:
        _require_active(client, source)
        client.node.create_subscription(
            JointState,
            f"{source}/state",
            lambda message: state.update(zip(message.name, message.position, strict=False)),
            10,
        )
        client.node.create_subscription(String, f"{source}/refused", lambda message: said.append(message.data), 10)
    listeners = client.node.count_subscribers(topic)
    client.until(lambda: publisher.get_subscription_count() >= listeners)
    client.until(lambda: False, ACQUAINTANCE)
    publisher.publish(Float64(data=value))
    if not source:
        publisher.wait_for_all_acked(Duration(seconds=client.timeout))
        print(f"setpoint {readable(value, 'm')} sent; who listens does not say whether it was taken", flush=True)
        return
    _answered(client, source, value, state, said)


def _source(client: Client, topic: str) -> str:
    """Return who answers setpoints on a topic; empty where somebody listens who does not.

    Raises
    ------
    AbsentError
        Nobody listens, recorders apart.
    """

    def listeners() -> list[str]:
        found = client.node.get_subscriptions_info_by_topic(topic)
        return [named(one) for one in found if one.node_name != "recorder"]

    def sources() -> list[str]:
        return [name for name in listeners() if name.rsplit("/", 1)[-1] in SOURCES]

    if client.timeout > PATIENCE and not client.until(listeners, PATIENCE):
        print(f"waiting for somebody who listens on {topic} …", file=sys.stderr, flush=True)
    if not client.until(listeners):
        raise AbsentError(f"nobody listens on {topic} within {client.timeout:g} s; {client.who_is_there()}")
    return (client.until(sources, SETTLED) or [""])[0]


def _require_active(client: Client, source: str) -> None:
    """Refuse an axis that cannot move because one of its nodes is not active."""
    space = source.rpartition("/")[0]
    names = [f"{space}/{name}" for name in axis_nodes(client.nodes())[space] if name != "recorder"]
    for name, state in lifecycle_states(client, names).items():
        if state != "active":
            to_do = {"unconfigured": "configure", "inactive": "activate"}.get(state)
            hint = f": `hysteresis call {name} {to_do}`" if to_do else ""
            raise HysteresisError(f"{name} is {state}, the axis would not move{hint}")


def stands(source: str, state: dict[str, float]) -> str:
    """Return why a source does not move although it has the setpoint, and what to do; empty when it does.

    Parameters
    ----------
    source : str
        Full name of the node.
    state : dict of str to float
        Its ``~/state``.
    """
    mode, error = round(state.get("mode", 0.0)), round(state.get("error", 0.0))
    start = f"`hysteresis call {source} start`"
    if mode == TRIPPED:
        plant = f"{source.rpartition('/')[0]}/plant_simulator"
        return f"stands still, because the plant has stopped the axis: `hysteresis call {plant} start` lets it go on"
    if mode == STOPPED:
        return f"is stopped: {start}"
    if error > at.SENSOR_ERROR:  # that one heals itself
        return f"stands with the error {at.ERROR_NAMES[error]}: {start} after repair"
    if round(state.get("phase", 0.0)) == at.RELEASED:
        return f"has let the slider go: {start}"
    return ""


def _answered(client: Client, source: str, value: float, state: dict, said: list[str]) -> None:
    """Wait for the answer of the source, and say it."""

    def refused() -> str:
        return next((text for text in said if text.startswith(f"setpoint {value:g} m refused")), "")

    def taken() -> bool:
        return math.isclose(state.get("setpoint", math.nan), value, rel_tol=1e-12, abs_tol=1e-15)

    client.until(lambda: refused() or taken(), min(ANSWER, client.timeout))
    if refused():
        raise HysteresisError(f"{source}: {refused()}")
    if not taken():
        joints = f"{source.rsplit('/', 1)[0]}/joint_states"
        why = f"nobody publishes {joints}" if not client.node.count_publishers(joints) else "time stands still"
        raise AbsentError(f"{source} has made no sample with the setpoint: {why}; see `hysteresis status`")
    why = stands(source, state)
    if why:
        raise HysteresisError(f"{source} has the setpoint but {why}")
    print(f"setpoint {readable(value, 'm')} taken by {source}", flush=True)
