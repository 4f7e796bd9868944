# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis echo``: what is said on a topic, as it comes."""

from __future__ import annotations

import importlib
import time
from collections import deque

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.nodes.discovery import named
from hysteresis_ros.nodes.remote.client import AbsentError, Client


def echo(client: Client, topic: str, count: int | None) -> None:
    """Print the messages of a topic, one a line where they are short.

    Parameters
    ----------
    client : Client
    topic : str
        Relative names are looked for in the namespace.
    count : int or None
        Messages after which to end; None: goes on until nobody publishes any more.

    Raises
    ------
    AbsentError
        Nobody publishes it, nothing comes, or who published has left before as many messages came as were asked for.
    """
    name = client.full_name(topic)
    publishers = client.until(lambda: client.node.get_publishers_info_by_topic(name))
    if not publishers:
        raise AbsentError(_nobody(client, name))
    heard: deque = deque()
    kind = _message_type(publishers[0].topic_type)
    client.node.create_subscription(kind, name, lambda message: heard.append(message), _matching(publishers))
    said, quiet = 0, time.monotonic()
    while count is None or said < count:
        if client.until(lambda: heard, 0.5):
            print(formatted(heard.popleft()), flush=True)
            said, quiet = said + 1, time.monotonic()
        elif not client.node.count_publishers(name):
            if count is None:
                print(f"hysteresis: nobody publishes {name} any more", flush=True)
                return
            raise AbsentError(f"{said} of {count} messages came on {name}, then its publisher left")
        elif time.monotonic() - quiet > client.timeout and (count is not None or not said):
            who = ", ".join(map(named, publishers))
            raise AbsentError(f"nothing came on {name} for {client.timeout:g} s; its publisher is {who}")


def _nobody(client: Client, name: str) -> str:
    """Say that nobody publishes a topic, and what is published."""
    topics = [topic for topic, _ in client.node.get_topic_names_and_types() if client.node.count_publishers(topic)]
    topics = [topic for topic in topics if topic not in ("/rosout", "/parameter_events")]
    there = f"there are {', '.join(topics)}{did_you_mean(name, topics)}" if topics else client.who_is_there()
    return f"nobody publishes {name} within {client.timeout:g} s; {there}"


def _message_type(name: str):
    """Return the class of a message type ``package/msg/Type``.

    Raises
    ------
    HysteresisError
        It is not installed here.
    """
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise HysteresisError(f"messages of type {name} are not installed here") from None


def _matching(publishers) -> QoSProfile:
    """Return a quality of service that every one of the publishers meets."""
    offered = [info.qos_profile for info in publishers]
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=1000,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def formatted(message) -> str:
    """Return a message as people read it.

    Parameters
    ----------
    message : object
        Of any type.
    """
    if isinstance(message, JointState):
        return _joints(message)
    if isinstance(message, DiagnosticArray):
        return "\n".join(
            f"{status.name}: {status.message}; {', '.join(f'{pair.key} {pair.value}' for pair in status.values)}"
            for status in message.status
        )
    plain = _plain(message)
    if isinstance(plain, dict) and list(plain) == ["data"]:
        return str(plain["data"])
    return "---\n" + yaml.safe_dump(plain, sort_keys=False, allow_unicode=True).rstrip()


def _joints(message: JointState) -> str:
    """Return the time of a sample, and what each joint or signal is in SI."""
    stamp = message.header.stamp
    parts = [f"{stamp.sec}.{stamp.nanosec:09d} s"]
    units = ((message.velocity, "m/s"), (message.effort, "N"))
    for index, name in enumerate(message.name):
        words = [f"{name} {message.position[index]:.9g}"] if index < len(message.position) else [name]
        words += [f"{values[index]:.6g} {unit}" for values, unit in units if index < len(values)]
        parts.append(" ".join(words))
    return "  ".join([*parts, *filter(None, [message.header.frame_id])])


def _plain(value):
    """Return a message as dictionaries and lists."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "big")
    if isinstance(value, (str, bool, int, float)):
        return value
    return [_plain(item) for item in value]
