# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Diagnostics of nodes in every state of their lifecycle, and their groups in an aggregator."""

from __future__ import annotations

import importlib
import math
import pathlib
import time
from types import SimpleNamespace

import pytest
import yaml

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from nodes_support import axis_parameters, compose  # noqa: E402

from hysteresis_ros.loop.parameters import NODE_PARAMETERS  # noqa: E402
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, RUNNING, STALE, STOPPED, TRIPPED  # noqa: E402
from hysteresis_ros.nodes.base import START_UP, diagnostics  # noqa: E402
from hysteresis_ros.nodes.plant_simulator import verdict  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
OK, WARN, ERROR, GONE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE


def said(node) -> tuple[bytes, str]:
    (status,) = diagnostics(node).status
    return status.level, status.message


@pytest.fixture
def axis(inside):
    """The four nodes of an axis in real time, active, without received messages, because they are not spun."""
    parameters = axis_parameters(sample_rate=200.0, time_mode="realtime", overrides={"plant_simulator": {}})
    plant, *others = compose(inside, parameters, autostart=False)
    for node in others:
        assert node.configure_now() and node.activate_now()
    assert plant.configure_now()
    return plant, *others


def test_every_state_of_the_life_of_a_node_is_told(inside):
    node = inside.add(ReferenceGeneratorNode, axis_parameters().reference_generator, autostart=False)
    assert said(node) == (WARN, "unconfigured: ros2 lifecycle set /reference_generator configure")
    assert node.configure_now()
    assert said(node) == (WARN, "inactive: ros2 lifecycle set /reference_generator activate")
    assert node.activate_now() and said(node)[0] in (OK, WARN)
    node.trigger_deactivate()
    assert said(node)[0] == WARN and "inactive" in said(node)[1]
    node.trigger_cleanup()
    node.failure = "not configured: a device is missing"
    assert said(node) == (ERROR, node.failure)
    node.failure = ""
    node.trigger_shutdown()
    assert said(node) == (GONE, "left")


def test_what_has_not_come_yet_is_an_error_only_after_the_others_had_time(axis):
    for node in axis[1:]:
        node.active_since = time.monotonic()  # compilation may have taken longer than the start-up time
        assert said(node)[0] == WARN, "the other nodes are starting"
        node.active_since = time.monotonic() - START_UP
        assert said(node)[0] == ERROR
    assert said(axis[1])[1] == "no command has arrived yet"
    assert said(axis[2])[1] == "no measurement of 'extender' has arrived yet"


def test_levels_of_the_modes_of_controller_and_compensator(axis):
    _, compensator, controller, source = axis
    for node in (compensator, controller, source):
        node.sample = 1
    source.pace.tick()
    levels = {RUNNING: OK, HOLDING: OK, STALE: ERROR, STOPPED: WARN, TRIPPED: ERROR, FOLLOWING: ERROR}
    for mode, level in levels.items():
        controller._mode = mode
        assert said(controller)[0] == level, f"mode {mode}: {said(controller)}"
    for mode in (RUNNING, STALE, TRIPPED):
        compensator._mode = mode
        assert said(compensator)[0] == levels[mode]
    controller._mode, controller.running = RUNNING, False
    assert said(controller) == (WARN, "stopped")
    controller._mode = TRIPPED
    assert said(controller) == (ERROR, "the plant has stopped the axis"), "a stop hides no error"
    source.take_and_tell(math.nan)
    level, text = said(source)
    assert level == WARN and "refused" in text
    assert said(source)[0] == OK, "reported once"


def test_late_samples_are_counted_by_the_plant_and_late_inputs_by_the_others(axis):
    for node in axis:
        node.sample = 1
        node.pace.tick()
        node.pace.overruns += 4
    plant, compensator, controller, source = axis
    compensator._mode = controller._mode = RUNNING
    assert "late inputs" not in said(plant)[1]
    for node in (compensator, controller, source):
        level, text = said(node)
        assert level == WARN and text.startswith("4 late inputs"), text
        assert said(node)[0] == OK, "reported once"


class Part:
    """The evaluated part of a plant."""

    tripped = silent = saturated = finding_home = halted = overtravelled = False
    failure = complaint = lost = ""
    travel = (-1e-6, 2e-5)


class Runner:
    by_message, exact = True, False
    late_samples = 0
    node = SimpleNamespace(get_fully_qualified_name=lambda: "/plant_simulator")

    def explain_trip(self):
        return "late"


def test_levels_of_a_plant():
    driven = [type("Input", (), {"topic": "voltage", "received": 1.0})]
    silent = [type("Input", (), {"topic": "voltage", "received": 0.0})]

    def judged(inputs=driven, late=0, limited="", **state):
        part = Part()
        for name, value in state.items():
            setattr(part, name, value)
        return verdict(part, Runner(), inputs, late, limited)

    ok, warn, error = (level[0] for level in (OK, WARN, ERROR))
    assert judged() == (ok, "")
    assert judged(inputs=silent) == (warn, "no voltage received yet: no node drives the axis")
    assert judged(late=3) == (warn, "3 samples late")
    assert judged(saturated=True) == (warn, "voltage saturated")
    assert judged(complaint="outside of the calibration")[0] == warn
    cut = "output limited for 2 s of the last 9 s, by safe_slew_rate"
    assert judged(limited=cut, late=3, saturated=True) == (warn, cut), "reported first"
    assert judged(limited=cut, complaint="outside of the calibration") == (warn, f"{cut}; outside of the calibration")
    assert judged(limited=cut, silent=True) == (error, "voltage is stale")
    assert judged(silent=True) == (error, "voltage is stale")
    for state in ({"halted": True}, {"overtravelled": True}, {"failure": "device: gone"}, {"lost": "/it"}, {}):
        level, words = judged(tripped=True, **state)
        assert level == error and words.startswith("axis stopped: ")
    assert judged(tripped=True, finding_home=True)[0] == warn, "an axis continues by itself after homing"


def test_an_overtravel_names_late_samples_first_where_there_were_some():
    from hysteresis_ros.nodes.plant_simulator import explain_trip

    part, runner = Part(), Runner()
    part.overtravelled = True
    assert "which an unstable loop or a wrong sensor can cause" in explain_trip(part, runner)
    runner.late_samples = 7
    words = explain_trip(part, runner)
    assert words.index("after 7 late samples") < words.index("gains") and "only" not in words


def matches(section: dict, name: str) -> bool:
    """Return whether a GenericAnalyzer accepts a status, by the rule of diagnostic_aggregator."""
    return name in section.get("expected", ()) or any(name.startswith(one) for one in section.get("startswith", ()))


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_an_aggregator_groups_the_nodes_of_an_axis(inside, namespace):
    text = (ROOT / "config" / "diagnostics" / "axis.yaml").read_text(encoding="utf-8")
    given = yaml.safe_load(text.replace("'/", f"'{namespace}/"))["analyzers"]["ros__parameters"]
    section = given["axis"]
    assert section["type"] == "diagnostic_aggregator/GenericAnalyzer" and isinstance(section["timeout"], float)
    names = set()
    for kind in NODE_PARAMETERS:
        module = importlib.import_module(f"hysteresis_ros.nodes.{kind}")
        cls = getattr(module, "".join(word.capitalize() for word in kind.split("_")) + "Node")
        node = cls(context=inside.context, namespace=namespace)
        inside.nodes.append(node)
        inside.executor.add_node(node)
        status = diagnostics(node).status[0]
        names.add(status.name)
        assert status.name == f"{namespace}/{kind}: axis" and matches(section, status.name)
        assert status.hardware_id == f"{namespace}/extender".strip("/")
    assert set(section["expected"]) < names
    assert len(section["startswith"]) == len(names)
    assert not matches(section, "/right/motion_controller: axis")
    assert not matches(section, "/battery: charge")
