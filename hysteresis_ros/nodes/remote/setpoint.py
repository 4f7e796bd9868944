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

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.discovery import named
from hysteresis_ros.nodes.qos import diagnostics_qos
from hysteresis_ros.nodes.remote.client import AbsentError, Client, axis_nodes
from hysteresis_ros.nodes.remote.services import lifecycle_states
from hysteresis_ros.units import readable

#: Nodes that take setpoints and answer, on ``~/set_setpoint``.
SOURCES = (signals.SOURCE, signals.MOTOR_SOURCE)
#: Seconds after which a person wants to know what is waited for.
PATIENCE = 2.0
#: Seconds in which a sample is made.
ANSWER = 5.0


def setpoint(client: Client, value: float) -> None:
    """Give a setpoint to the reference source, and say whether it has been taken.

    The source answers: a setpoint cannot get lost without a word, as it can on a topic.

    Parameters
    ----------
    client : Client
    value : float
        [m]

    Raises
    ------
    HysteresisError
        It was refused, or the axis cannot move; the sentence says which.
    AbsentError
        The source is not there or does not answer: the setpoint is not known to be taken.
    """
    source = _source(client)
    state: dict[str, float] = {}
    client.node.create_subscription(
        JointState,
        f"{source}/state",
        lambda message: state.update(zip(message.name, message.position, strict=False)),
        10,
    )
    _require_active(client, source)
    argument = Parameter("setpoint", Parameter.Type.DOUBLE, value).to_parameter_msg()
    request = SetParametersAtomically.Request(parameters=[argument])
    result = client.ask(SetParametersAtomically, f"{source}/set_setpoint", request).result
    if not result.successful:
        raise HysteresisError(f"{source}: {result.reason}")
    _require_moving(client, source, value, state)
    print(f"setpoint {readable(value, 'm')} taken by {source}", flush=True)


def _source(client: Client) -> str:
    """Return the node that takes the setpoints of an axis: by its name, whoever else subscribes to the topic.

    Raises
    ------
    AbsentError
        It is not there; names who subscribes to the topic.
    """
    wanted = [client.full_name(name) for name in SOURCES]

    def there() -> list[str]:
        return [name for name in client.nodes() if name in wanted]

    if client.timeout > PATIENCE and not client.until(there, PATIENCE):
        print(f"waiting for {' or '.join(wanted)} …", file=sys.stderr, flush=True)
    found = client.until(there)
    if found:
        return found[0]
    topic = client.full_name("setpoint")
    others = sorted({named(one) for one in client.node.get_subscriptions_info_by_topic(topic)})
    heard = f"; {', '.join(others)} on {topic} does not answer setpoints" if others else ""
    raise AbsentError(f"no {' or '.join(wanted)} within {client.timeout:g} s{heard}; {client.who_is_there()}")


def _require_active(client: Client, source: str) -> None:
    """Refuse an axis that cannot move because one of its nodes is not active."""
    space = source.rpartition("/")[0]
    names = [f"{space}/{name}" for name in axis_nodes(client.nodes())[space] if name != "recorder"]
    for name, state in lifecycle_states(client, names).items():
        if state == "silent":
            raise AbsentError(f"{name} did not answer within {client.timeout:g} s, and nothing was sent")
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
    from hysteresis_ros.loop.watch import STOPPED, TRIPPED
    from hysteresis_ros.references import inchworm_layout as at

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


def _require_moving(client: Client, source: str, value: float, state: dict[str, float]) -> None:
    """Wait for a sample that was made with the setpoint, and refuse an axis that does not move.

    Raises
    ------
    HysteresisError
        It stands still; why.
    """

    state.clear()

    def made() -> bool:
        # a motor asked for the same setpoint again takes it with the last digit changed
        return math.isclose(state.get("setpoint", math.nan), value, rel_tol=1e-12, abs_tol=1e-15)

    if not client.until(made, min(ANSWER, client.timeout)):
        if state:
            now = readable(state.get("setpoint", math.nan), "m")
            raise AbsentError(f"{source} took it, but {now} is in force: another one came after it")
        joints = f"{source.rsplit('/', 1)[0]}/joint_states"
        why = f"nobody publishes {joints}" if not client.node.count_publishers(joints) else "time stands still"
        raise AbsentError(f"{source} has the setpoint but has made no sample with it: {why}; see `hysteresis status`")
    if any(round(state.get(name, 0.0)) for name in ("mode", "error", "phase")):
        why = stands(source, state)
        if why:
            raise HysteresisError(f"{source} has the setpoint but {why}{_cause(client, source, state)}")


def _cause(client: Client, source: str, state: dict[str, float]) -> str:
    """Return what the plant says of why it has stopped the axis, after a semicolon; empty where it has not."""
    from hysteresis_ros.loop.watch import TRIPPED

    if round(state.get("mode", 0.0)) != TRIPPED:
        return ""
    plant = f"{source.rpartition('/')[0]}/{signals.PLANT}"
    said: dict[str, str] = {}

    def hear(message: DiagnosticArray) -> None:
        said.update({status.name.removesuffix(": axis"): status.message for status in message.status})

    client.node.create_subscription(DiagnosticArray, "/diagnostics", hear, diagnostics_qos(keeps=True))
    client.until(lambda: "stopped" in said.get(plant, ""), ANSWER)
    return f"; {said[plant]}" if plant in said else ""
