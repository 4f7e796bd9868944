# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a node says of itself on /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue


def warn_of_others(node, publishers) -> None:
    """Say when somebody else publishes what a node publishes."""
    for publisher in publishers:
        count = node.count_publishers(publisher.topic_name)
        if count > 1:
            node.warn(
                "others",
                f"{publisher.topic_name} has {count} publishers: another graph runs in this ROS domain; "
                "stop it, or give one of them another namespace or ROS_DOMAIN_ID",
                every=10.0,
            )


def diagnostics(node) -> DiagnosticArray:
    """Return what a node says of itself: level, words and numbers."""
    rate, jitter = node.pace.read()
    level, text, values = node.health()
    overruns = node.since_report("overruns", node.pace.overruns)
    if node.failure:
        level, text = 2, node.failure
    elif not node.running:
        level, text = max(level, 1), text or "stopped"
    elif overruns and not level:
        level, text = 1, f"{overruns} periods overrun"
    status = DiagnosticStatus()
    status.name = f"{node.get_fully_qualified_name()}: axis"
    status.hardware_id = node.parameters.joint
    status.level = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)[level]
    status.message = text or "OK"
    table = {"rate_hz": f"{rate:.3f}", "jitter_p99_s": f"{jitter:.6f}", "samples": node.pace.total}
    table |= {"overruns": node.pace.overruns} | values
    status.values = [KeyValue(key=key, value=str(value)) for key, value in table.items()]
    message = DiagnosticArray()
    message.header.stamp = node.get_clock().now().to_msg()
    message.status = [status]
    return message


def introduction(node) -> str:
    """Return what a node says when it begins to work: what it is, at what rate, and in which time mode.

    Parameters
    ----------
    node : AxisNode
        Configured.
    """
    values = node.parameters.to_mapping()
    words = [f"{name} {values[name]}" for name in node.identity if values.get(name)]
    return ", ".join(["active", *words, f"{node.parameters.sample_rate:g} Hz", node.parameters.time_mode])
