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

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from hysteresis_ros.nodes.timing import OVERRUN

#: Levels: as it should be; somebody ought to look at it; the axis does not do what is asked; nobody says anything.
OK, WARN, ERROR, STALE = range(4)

#: What of a node a status is about; stands behind its name, as tools that gather diagnostics expect.
ITEM = "axis"

#: Seconds after which it is an error that a node still has nothing to work on.
START_UP = 10.0


def diagnostics(node) -> DiagnosticArray:
    """Return what a node says of itself: level, words and numbers.

    Parameters
    ----------
    node : AxisNode
        In any state of its life.
    """
    level, text, table = _at_work(node) if node.active else _at_rest(node)
    status = DiagnosticStatus()
    status.name = f"{node.get_fully_qualified_name()}: {ITEM}"
    status.hardware_id = f"{node.get_namespace()}/{node.get_parameter('joint').value}".strip("/")
    status.level = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE)[level]
    status.message = text or "OK"
    status.values = [KeyValue(key=key, value=str(value)) for key, value in table.items()]
    message = DiagnosticArray()
    message.header.stamp = node.get_clock().now().to_msg()
    message.status = [status]
    return message


def _at_rest(node) -> tuple[int, str, dict]:
    """Return level, words and numbers of a node that is not active."""
    name = node.get_fully_qualified_name()
    if node.failure:
        return ERROR, node.failure, {}
    if node.leaving or node.finished:
        return STALE, "left", {}
    if node.parameters is None:
        return WARN, f"unconfigured: ros2 lifecycle set {name} configure", {}
    return WARN, f"inactive: ros2 lifecycle set {name} activate", {}


def _at_work(node) -> tuple[int, str, dict]:
    """Return level, words and numbers of a node that is active."""
    rate, jitter = node.pace.read()
    level, text, values = node.health()
    # late samples are counted once, by the plant; other nodes say what of their input came late
    counted = node.kind == "plant_simulator" or node.is_fused
    late = 0 if counted else node.since_report("late_inputs", node.pace.overruns)
    if node.failure:
        level, text = ERROR, node.failure
    elif not node.running:
        level, text = max(level, WARN), text or "stopped"
    elif level == ERROR and not node.sample and time.monotonic() - node.active_since < START_UP:
        level = WARN  # the others are only coming
    elif late and not level:
        level, text = WARN, f"{late} late inputs: more than {OVERRUN:g} periods after the one before"
    contested = "" if node.runner.exact else node.masters.complaint()  # in lockstep that ends the run
    if contested:
        node.warn("others", contested, every=10.0, error=True)
        level, text = ERROR, f"{text}; {contested}" if text else contested
    unconnected = node.compatibility.complaint()
    if unconnected:
        level, text = max(level, WARN), f"{text}; {unconnected}" if text else unconnected
    table = {"rate_hz": f"{rate:.3f}", "jitter_p99_s": f"{jitter:.6f}", "samples": node.pace.total}
    return level, text, table | ({} if counted else {"late_inputs": node.pace.overruns}) | values


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
