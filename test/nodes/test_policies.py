# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Policies of SROS 2 contain exactly what the nodes use; only the compensator may publish ``voltage``."""

from __future__ import annotations

import contextlib
import os
import pathlib
import subprocess
import sys
import threading
import xml.etree.ElementTree as xml
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

import rclpy  # noqa: E402
from nodes_support import axis_parameters, compose_stage, until  # noqa: E402
from rclpy.context import Context  # noqa: E402
from waiting import PATIENCE  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.laboratory.watch.link import AxisLink  # noqa: E402
from hysteresis_ros.loop.stage_parameters import StageParameters  # noqa: E402
from hysteresis_ros.loop.stage_simulation import with_scan  # noqa: E402
from hysteresis_ros.nodes.domain import entered  # noqa: E402
from hysteresis_ros.nodes.fused import FusedAxis  # noqa: E402
from hysteresis_ros.nodes.launcher import Graph, node_command, node_environment  # noqa: E402
from hysteresis_ros.nodes.remote.client import Client  # noqa: E402
from hysteresis_ros.nodes.security.__main__ import NODES, enclaves_of, used_by  # noqa: E402
from hysteresis_ros.nodes.security.policy import (  # noqa: E402
    WORDS,
    Enclave,
    Profile,
    operator,
    policy_text,
    profile,
)
from hysteresis_ros.signals import ACTUATOR  # noqa: E402

LOOP = {"/left/reference", "/left/command", "/left/applied", "/left/voltage", "/left/joint_states"}

#: Subscribed only while an axis begins: its position, for a restarted node.
AT_THE_BEGINNING = {"reference_generator": ("/left/motion_controller/state",)}


def slow(time_mode: str, **more):
    """Return an axis that a busy machine can run, with all optional interfaces of its nodes."""
    overrides = {"plant_simulator": {"late_limit": -1, "publish_clock": True}, "reference_generator": {}}
    axis = axis_parameters("/left", overrides, sample_rate=100.0, time_mode=time_mode, **more)
    return axis.with_recorder("recording")


@pytest.fixture(scope="module")
def policies():
    """The enclaves of an axis for each way of running it."""
    with entered():
        ways = {mode: enclaves_of([slow(mode)], record=True) for mode in ("realtime", "fused")}
        external = slow("realtime", external_plant=True)
        return ways | {"external": enclaves_of([external], remap=("voltage:=amplifier/voltage",))}


def profiles(enclaves: list[Enclave]) -> dict[str, Profile]:
    return {one.node: one for enclave in enclaves for one in enclave.profiles}


@pytest.mark.parametrize("mode", ["realtime", "fused"])
def test_a_running_axis_uses_what_its_policy_allows_neither_more_nor_less(inside, observer, policies, tmp_path, mode):
    axis, allowed = slow(mode), profiles(policies[mode])
    joined = FusedAxis() if mode == "fused" else None
    names = ["recorder", "plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator"]
    for name in names:
        given = getattr(axis, name)
        given = replace(given, path=str(tmp_path / "bag")) if name == "recorder" else given
        node = inside.add(NODES[name], given, autostart=False, namespace="/left")
        if joined:
            joined.join(node)
    for step in ("configure_now", "activate_now"):
        assert all(getattr(node, step)() for node in inside.nodes)
    inside.spin()
    plant = inside.nodes[1]
    until(lambda: (joined.loop.sample if joined else plant.sample) > 5, what="samples")
    for name in names:
        # the observer is another participant, so it sees what others could use
        seen = lambda name=name: used_by(observer.node, name, "/left")  # noqa: E731
        lasting = tuple(topic for topic in allowed[name].hears if topic not in AT_THE_BEGINNING.get(name, ()))
        wanted = replace(allowed[name], hears=lasting)
        until(lambda seen=seen, wanted=wanted: seen() == wanted, what=f"{name}: {wanted}")
        assert allowed[name].publishes and allowed[name].serves
    compare_with_a_page(observer, allowed["watch"], tmp_path)


def stage(time_mode: str) -> StageParameters:
    """Return a stage that follows a scan, with a recorder."""
    configuration = with_scan(load_configuration("xy_scanner"), "lissajous", ("width=2um", "depth=2um", "lines=3"))
    found = StageParameters.from_configuration(configuration.override("", time_mode=time_mode))
    return replace(found, axes=tuple(axis.with_recorder("recording") for axis in found.axes))


@pytest.fixture(scope="module")
def of_a_stage():
    """The enclaves of a stage in each way of running it."""
    with entered():
        given = {mode: stage(mode) for mode in ("lockstep", "fused")}
        return {mode: enclaves_of(list(one.axes), stage=one, record=True) for mode, one in given.items()}


def by_name(enclaves: list[Enclave]) -> dict[tuple[str, str], Profile]:
    return {(one.namespace, one.node): one for enclave in enclaves for one in enclave.profiles}


def test_a_running_stage_uses_what_its_policy_allows_neither_more_nor_less(inside, observer, of_a_stage, tmp_path):
    given, allowed = stage("lockstep"), by_name(of_a_stage["lockstep"])
    text = tmp_path / "stage.yaml"
    text.write_text(given.configuration_text(), encoding="utf-8")
    recorders = {"path": str(tmp_path / "bag"), "configuration": str(text)}
    axes = tuple(replace(axis, recorder=replace(axis.recorder, **recorders)) for axis in given.axes)
    nodes = compose_stage(inside, replace(given, axes=axes), "recorder")
    inside.spin()
    until(lambda: nodes[2].sample > 5, what="samples")
    for node in nodes:
        name, space = node.get_name(), node.get_namespace()
        seen = lambda name=name, space=space: used_by(observer.node, name, space)  # noqa: E731
        until(lambda seen=seen, wanted=allowed[space, name]: seen() == wanted, what=f"{space}/{name}")


def test_a_stage_has_its_operator_and_each_axis_one_that_moves_no_other(of_a_stage):
    apart = {enclave.path: {(p.namespace, p.node) for p in enclave.profiles} for enclave in of_a_stage["lockstep"]}
    for kind in ("recorder", *ACTUATOR.nodes):
        assert apart[f"/{kind}"] == {("/x", kind), ("/y", kind)}
    assert set(apart) == {
        *(f"/{kind}" for kind in ("recorder", *ACTUATOR.nodes, "operator", "monitor", "epics_ioc")),
        *(f"/{axis}/{name}" for axis in "xy" for name in ("operator", "monitor", "watch")),
    }
    fused = {enclave.path: len(enclave.profiles) for enclave in of_a_stage["fused"]}
    assert fused["/hysteresis_stage"] == 10 and "/plant_simulator" not in fused and "/recorder" not in fused
    for mode in ("lockstep", "fused"):
        found = by_name(of_a_stage[mode])
        for axis in "xy":
            said = {name for name, one in found.items() if f"/{axis}/voltage" in one.publishes}
            assert said == {(f"/{axis}", "hysteresis_compensator")}
        assert found["/x", "plant_simulator"].publishes.count("/joint_states") == 1
        assert "/scan_clock" in found["/x", "reference_generator"].publishes
        whole, of_x = found["/", "operator"], found["/x", "operator"]
        moving = {"/setpoints", "/joint_trajectory", "/x/setpoint", "/y/setpoint", "/x/estop", "/y/estop"}
        assert moving <= set(whole.publishes) and "/y/motion_controller/set_parameters" in whole.asks
        assert set(of_x.publishes) & moving == {"/x/setpoint", "/x/estop"}
        assert not any(name.startswith("/y/") for name in (*of_x.publishes, *of_x.asks, *of_x.hears))
        for of_all in (whole, found["/", "monitor"]):
            assert {"/joint_states", "/scan_clock", "/x/voltage", "/y/voltage"} <= set(of_all.hears)
        assert not set(whole.publishes) & {"/joint_states", "/scan_clock", "/x/voltage", "/y/reference"}
        assert set(found["/", "monitor"].publishes) == {"/rosout", "/parameter_events"}
    assert "/scan_clock" in by_name(of_a_stage["lockstep"])["/x", "recorder"].hears
    assert "/scan_clock" not in by_name(of_a_stage["lockstep"])["/y", "recorder"].hears


def test_the_processes_of_a_stage_say_whose_key_they_have(monkeypatch):
    started: list = []
    monkeypatch.setattr(
        "hysteresis_ros.nodes.launcher.started", lambda command, *more, **options: started.append(command)
    )
    monkeypatch.setattr("hysteresis_ros.nodes.launcher.session", lambda environment: contextlib.nullcontext())
    for mode in ("lockstep", "fused"):
        given = stage(mode)
        Graph(list(given.axes), stage=given).start()
    named = [command[command.index("--enclave") + 1] for command in started if "--enclave" in command]
    assert named == [*(f"/{kind}" for kind in ACTUATOR.nodes), "/hysteresis_stage"]


def compare_with_a_page(observer, allowed: Profile, folder) -> None:
    """Execute all actions of a page, and compare what it then uses."""
    context, over = Context(), threading.Event()
    rclpy.init(context=context, domain_id=observer.node.context.get_domain_id())
    link = AxisLink("/left", folder, context)
    working = threading.Thread(target=link.run, args=(over,), daemon=True)
    working.start()
    try:
        until(lambda: link.memory.is_live, what="a page that hears samples")
        asked = (
            lambda: link.record(True),
            lambda: link.change("motion_controller", {"sliding_mode.phi": "0.8"}),
            lambda: link.mark("here"),
            link.hold,
            link.start,
            lambda: link.record(False),
        )
        for job in asked:
            link.ask(job).result(PATIENCE)
        own = link.node.get_name()
        lasting = tuple(topic for topic in allowed.hears if topic != "/left/joint_states")  # only as recording begins
        wanted = replace(allowed, hears=lasting, node=own)
        wanted = replace(wanted, serves=tuple(name.replace("_hysteresis_*", own) for name in allowed.serves))
        until(lambda: own in observer.node.get_node_names(), what="a page that is seen")
        until(lambda: used_by(observer.node, own, "/left") == wanted, what=f"a page: {wanted}")
    finally:
        over.set()
        working.join()
        context.try_shutdown()


def test_only_the_compensator_may_say_voltage(policies):
    for mode in ("realtime", "fused"):
        said = {name: set(one.publishes) for name, one in profiles(policies[mode]).items()}
        assert {name for name, topics in said.items() if "/left/voltage" in topics} == {"hysteresis_compensator"}
        assert not (said["operator"] | said["watch"]) & LOOP and "/left/setpoint" in said["operator"]
        assert said["monitor"] == {"/rosout", "/parameter_events"}
        steered = {f"/left/{name}" for name in ("setpoint", "speed", "estop", "marker")}
        assert said["watch"] == steered | {"/parameter_events"}
        assert not any("*" in topic for topics in said.values() for topic in topics)
    watching = profiles(policies["realtime"])["monitor"]
    assert not watching.asks and not watching.calls and "/left/voltage" in watching.hears
    steering = profiles(policies["realtime"])["operator"]
    assert "/left/motion_controller/set_parameters" in steering.asks and "/left/estop" in steering.publishes


def test_processes_have_enclaves_of_their_own_and_a_fused_axis_has_one(policies):
    def nodes(mode):
        return {enclave.path: {one.node for one in enclave.profiles} for enclave in policies[mode]}

    apart = nodes("realtime")
    assert apart["/left/hysteresis_compensator"] == {"hysteresis_compensator"} and "/left/hysteresis_axis" not in apart
    together = nodes("fused")["/left/hysteresis_axis"]
    assert {"hysteresis_compensator", "plant_simulator", "recorder"} < together
    assert apart["/left/operator"] == {"operator", "setpoint_publisher"} and apart["/epics_ioc"] == {"epics_ioc"}


def test_a_plant_of_somebody_else_and_remapped_names(policies):
    found = profiles(policies["external"])
    assert "plant_simulator" not in found and "recorder" not in found
    assert "/left/joint_states" in found["driver"].publishes and "/left/voltage" not in found["driver"].publishes
    assert "/left/amplifier/voltage" in found["hysteresis_compensator"].publishes
    assert "/left/voltage" not in found["hysteresis_compensator"].publishes


def test_a_rule_that_is_none_is_refused():
    with entered(), pytest.raises(HysteresisError, match="plant_simulator: .*voltage"):
        enclaves_of([slow("realtime")], remap=("voltage",))


def test_the_file_is_written_as_ros2_security_reads_it(policies):
    root = xml.fromstring(policy_text(policies["realtime"]))
    assert (
        root.tag == "policy" and root.attrib == {"version": "0.2.0"} and [child.tag for child in root] == ["enclaves"]
    )
    for enclave in root[0]:
        assert enclave.tag == "enclave" and enclave.attrib["path"].startswith("/")
        (all_profiles,) = enclave
        for one in all_profiles:
            assert one.tag == "profile" and set(one.attrib) == {"ns", "node"} and one.attrib["ns"].startswith("/")
            for rules in one:
                ((right, qualifier),) = rules.attrib.items()
                assert (rules.tag[:-1], right) in WORDS.values() and qualifier == "ALLOW"
                assert rules.tag.endswith("s") and {rule.tag for rule in rules} == {rules.tag[:-1]}
                assert len(rules) and all(rule.text.startswith("/") for rule in rules)
    again = {
        (one.attrib["node"], rules.tag, *rules.attrib): tuple(rule.text for rule in rules)
        for one in root.iter("profile")
        for rules in one
    }
    compensator = profiles(policies["realtime"])["hysteresis_compensator"]
    assert again["hysteresis_compensator", "topics", "publish"] == compensator.publishes
    assert again["hysteresis_compensator", "topics", "subscribe"] == compensator.hears
    assert again["hysteresis_compensator", "services", "reply"] == compensator.serves


def test_actions_are_named_as_actions():
    parts = ("feedback", "status"), ("send_goal", "cancel_goal", "get_result")
    topics, services = ([f"/follow/_action/{part}" for part in names] for names in parts)
    served = profile("", "n", (["/a", *topics], []), (["/s", *services], []))
    assert (served.publishes, served.serves, served.executes) == (("/a",), ("/s",), ("/follow",))
    called = profile("", "n", ([], topics), ([], services))
    assert (called.hears, called.asks, called.calls) == ((), (), ("/follow",))
    assert operator("", (served,), called).calls == ("/follow",)


def test_processes_and_commands_say_whose_key_they_have(observer):
    command = node_command("plant_simulator", "/left", pathlib.Path("axis.yaml"))
    assert command[command.index("--enclave") + 1] == "/left/plant_simulator"
    with Client("left", context=None) as client:
        ((name, space, enclave),) = [
            found for found in client.node.get_node_names_and_namespaces_with_enclaves() if found[0].startswith("_hyst")
        ]
    assert (name, space, enclave) == (f"_hysteresis_{os.getpid()}", "/left", "/left/operator")


def test_security_that_is_asked_for_and_not_there_ends_a_node(tmp_path, domain):
    """A node never runs unprotected: without a keystore, or without security in Fast DDS, it does not start."""
    asked = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    environment = node_environment() | asked | {"ROS_SECURITY_KEYSTORE": str(tmp_path), "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, "-m", "hysteresis_ros.nodes.recorder", "--ros-args", "-p", f"path:={tmp_path}/bag"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr and "error:" in done.stderr
    assert not (tmp_path / "bag").exists()
