# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Real time: setpoints by hand, watchdogs, live parameters, lifecycle and diagnostics, with other publishers."""

from __future__ import annotations

import math
import time

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import Driver, axis_parameters, diagnostics, until, write_axis  # noqa: E402

from hysteresis_ros.nodes import plant_runners, realtime  # noqa: E402

RATE = 200.0
#: Time in which nodes in this process start [s]: no other process has to be loaded.
SOON = 0.5


@pytest.fixture(autouse=True)
def started_soon(monkeypatch):
    for module in (realtime, plant_runners):
        monkeypatch.setattr(module, "STARTING", SOON)


def parameters(node: str, **values):
    return getattr(axis_parameters(overrides={node: values}, sample_rate=RATE), node)


@pytest.fixture
def controller(inside):
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode

    chosen = parameters("motion_controller", type="open_loop", measurement_timeout=0.3, safe_slew_rate=1e-4)
    node = inside.add(MotionControllerNode, chosen)
    inside.spin()
    return node


@pytest.fixture
def compensator(inside):
    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode

    node = inside.add(HysteresisCompensatorNode, parameters("hysteresis_compensator", command_timeout=0.3))
    inside.spin()
    return node


@pytest.fixture
def generator(inside):
    from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode

    node = inside.add(ReferenceGeneratorNode, parameters("reference_generator"))
    inside.spin()
    return node


def at_work():
    """Return a condition that is true once a sender counts as running: longer than nodes take to start."""
    begun = time.monotonic()
    return lambda: time.monotonic() > begun + SOON + 0.3


def keep_sending(send, condition, what: str = "") -> None:
    """Send repeatedly until the condition is true."""
    until(lambda: (send(), condition())[1], what=what)


@pytest.mark.parametrize("durability", ["VOLATILE", "TRANSIENT_LOCAL"])
def test_setpoint_of_a_default_publisher_moves_the_axis_and_bad_ones_are_refused(
    processes, observer, tmp_path, durability
):
    """`ros2 topic pub` is reliable, keeps one message, and is volatile or transient-local, depending on its version."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    axis = axis_parameters(overrides={"plant_simulator": {"late_limit": -1}}, sample_rate=RATE)
    node = processes.node("hysteresis_axis", write_axis(tmp_path / "axis.yaml", axis))
    joints = observer.listen(JointState, "/joint_states")
    references = observer.listen(JointState, "/reference_generator/state")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    setpoint = observer.talk(Float64, "/setpoint", QoSProfile(depth=1, durability=DurabilityPolicy[durability]))
    until(lambda: joints and references and setpoint.get_subscription_count(), what="the axis to run")
    setpoint.publish(Float64(data=5.0e-6))
    until(lambda: abs(joints[-1].position[0] - 5.0e-6) < 1e-8, what="the axis at its setpoint")
    for wrong in (math.nan, math.inf, 1.0):
        setpoint.publish(Float64(data=wrong))
    until(lambda: diagnostics(reports, "/reference_generator"))
    until(lambda: diagnostics(reports, "/reference_generator")[2]["setpoints_refused"] == "3")
    assert references[-1].position[0] == 5.0e-6  # the last valid setpoint is kept
    # throttled: one warning for the three messages, with value and range
    assert node.output.count("refused") == 1
    assert "nan" in node.output and "12 µm" in node.output and "5 µm is kept" in node.output
    names = {f"/{name}" for name in ("plant_simulator", "reference_generator", "motion_controller")}
    until(lambda: all(diagnostics(reports, name) for name in (*names, "/hysteresis_compensator")))
    for name in (*names, "/hysteresis_compensator"):
        table = diagnostics(reports, name)[2]
        assert {"rate_hz", "jitter_p99_s", "samples", "stale"} <= set(table), name
    for name in ("/plant_simulator", "/hysteresis_compensator"):
        assert "saturated_samples" in diagnostics(reports, name)[2]
    assert "late_samples" in diagnostics(reports, "/plant_simulator")[2]


@pytest.mark.parametrize("fault", ["stops", "nan", "goes back", "wrong joint"])
def test_bad_measurement_makes_the_controller_go_safe_and_come_back_without_a_jump(controller, observer, fault):
    """A complete loss of measurements counts as a lost node, which needs ~/start; this test is about bad ones."""
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64

    reports = observer.listen(DiagnosticArray, "/diagnostics")
    commands = observer.listen(Float64, "/command")
    reference = observer.talk(Float64, "/reference")
    driver = Driver(observer)
    keep_sending(lambda: (reference.publish(Float64(data=8.0e-6)), driver.send()), lambda: commands)
    keep_sending(driver.send, at_work())
    assert commands[-1].data == 8.0e-6
    bad = {
        "stops": lambda: None,
        "nan": lambda: driver.send(math.nan),
        "goes back": lambda: driver.send(step=-5_000_000),
        "wrong joint": lambda: driver.send(),
    }[fault]
    if fault == "wrong joint":
        driver.message.name[1] = "extruder"
    since = len(commands)
    start = time.monotonic()
    if fault == "goes back":
        # after its time-out the controller accepts the new time, so the fault may be over before the test looks
        keep_sending(bad, lambda: controller.rejected > 0)
        until(lambda: controller.stale)
    else:
        keep_sending(bad, lambda: controller.stale)
    assert time.monotonic() - start >= 0.2  # not before the time-out
    # bad measurements continue: without any message the sender would count as lost, too
    lost = fault in ("stops", "goes back")
    still = (lambda: None) if lost else bad
    keep_sending(still, lambda: commands[-1].data == 0.0, what="the safe command")
    keep_sending(still, lambda: (diagnostics(reports, "/motion_controller") or [0])[0] == 2)
    assert "stale" in diagnostics(reports, "/motion_controller")[1] or fault == "wrong joint"
    if fault == "wrong joint":
        assert "extender" in diagnostics(reports, "/motion_controller")[1]
        driver.message.name[1] = "extender"
    if lost:
        until(lambda: controller.runner.latched, what="the loss")
        answer = observer.trigger("/motion_controller/start")
        assert not answer.success and "is lost" in answer.message
        since_then = len(commands)
        keep_sending(driver.send, lambda: len(commands) > since_then + 20, what="more commands")
        assert {command.data for command in commands[since_then:]} == {0.0}  # latched
        assert observer.trigger("/motion_controller/start").success
    keep_sending(driver.send, lambda: abs(commands[-1].data - 8.0e-6) < 1e-9, what="the command to come back")
    moved = [c.data for c in commands[since - 1 :]]
    steps = [abs(b - a) for a, b in zip(moved[:-1], moved[1:], strict=True)]
    # down: safe_slew_rate · 0.01 s; up: the hand-over's time constant of 0.05 s at 200 samples per second
    assert max(steps) <= max(1.0e-4 * 0.01, 8.0e-6 * (1 - math.exp(-0.1))) * 1.01
    keep_sending(driver.send, lambda: diagnostics(reports, "/motion_controller")[0] < 2, what="diagnostics to recover")


def test_command_that_stops_makes_the_voltage_go_safe_and_come_back_without_a_jump(compensator, observer):
    from std_msgs.msg import Float64

    voltages = observer.listen(Float64, "/voltage")
    command = observer.talk(Float64, "/command")
    keep_sending(lambda: command.publish(Float64(data=8.0e-6)), at_work())
    high = voltages[-1].data
    since = len(voltages)
    until(lambda: voltages[-1].data == 0.0, what="the safe voltage")
    # a value that is not finite also counts as silence
    for _ in range(3):
        command.publish(Float64(data=math.nan))
    until(lambda: compensator.refused == 3)
    assert voltages[-1].data == 0.0 and (compensator.silent or compensator.runner.latched)
    since_then = len(voltages)
    keep_sending(lambda: command.publish(Float64(data=8.0e-6)), lambda: len(voltages) > since_then + 100)
    assert {voltage.data for voltage in voltages[since_then:]} == {0.0}  # latched until ~/start
    assert observer.trigger("/hysteresis_compensator/start").success
    keep_sending(lambda: command.publish(Float64(data=8.0e-6)), lambda: abs(voltages[-1].data - high) < 0.5)
    moved = [v.data for v in voltages[since - 1 :]]
    steps = [abs(b - a) for a, b in zip(moved[:-1], moved[1:], strict=True)]
    # down 1000 V/s · 0.01 s; up with handover_time 0.1 s at 200 samples per second
    assert max(steps) <= max(10.0, 80.0 * (1 - math.exp(-0.05))) * 1.05
    assert not compensator.failure


def test_voltage_that_stops_lets_the_plant_go_safe_and_follow_again_without_a_jump(inside, observer):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode

    plant = inside.add(PlantSimulatorNode, parameters("plant_simulator", voltage_timeout=0.2, late_limit=-1))
    inside.spin()
    state = observer.listen(JointState, "/plant_simulator/state")
    voltage = observer.talk(Float64, "/voltage")
    keep_sending(lambda: voltage.publish(Float64(data=60.0)), lambda: state and abs(state[-1].position[2] - 60) < 0.01)
    keep_sending(lambda: voltage.publish(Float64(data=60.0)), at_work())
    since = len(state)
    until(lambda: abs(state[-1].position[2]) < 0.01, what="the safe voltage")
    assert plant.part.tripped
    late = plant.late
    assert late > 0  # the output is held for commands that did not come in time, and they are counted
    voltage.publish(Float64(data=math.inf))
    answer = observer.trigger("/plant_simulator/start")
    assert not answer.success and "hysteresis_compensator is lost" in answer.message
    since_then = len(state)
    keep_sending(lambda: voltage.publish(Float64(data=60.0)), lambda: len(state) > since_then + 50)
    assert abs(state[-1].position[2]) < 0.01  # latched until ~/start
    assert observer.trigger("/plant_simulator/start").success
    keep_sending(lambda: voltage.publish(Float64(data=60.0)), lambda: abs(state[-1].position[2] - 60) < 0.01)
    moved = [s.position[2] for s in state[since - 1 :]]
    assert max(abs(b - a) for a, b in zip(moved[:-1], moved[1:], strict=True)) <= 1000.0 / RATE + 0.01
    voltage.publish(Float64(data=20.0))  # once the output has caught up, it follows at once
    until(lambda: abs(state[-1].position[2] - 20) < 0.01)


def test_parameters_change_live_without_a_jump_or_not_at_all(controller, observer):
    from std_msgs.msg import Float64

    commands = observer.listen(Float64, "/command")
    reference = observer.talk(Float64, "/reference")
    driver = Driver(observer)
    keep_sending(lambda: (reference.publish(Float64(data=4.0e-6)), driver.send(4e-6)), lambda: commands)
    keep_sending(lambda: driver.send(4e-6), lambda: commands[-1].data == 4.0e-6)
    node = "/motion_controller"
    # no measurements are sent while a service answers, which takes long on a busy machine
    assert observer.set_parameters(node, measurement_timeout=60.0)[0]
    keep_sending(lambda: driver.send(4e-6), lambda: commands[-1].data == 4.0e-6)
    before = controller.parameters

    for values, words in (
        ({"sliding_mode__phi": 2.0, "handover_time": 0.2}, ("phi", "2.0")),
        ({"type": "fuzzy"}, ("type", "fuzzy", "open_loop", "sliding_mode")),
        ({"measurement_timeout": "soon"}, ("measurement_timeout", "soon", "double")),
        ({"measurement_timeout": -1.0}, ("measurement_timeout", "-1", "0.001")),
        ({"sample_rate": 100.0}, ("sample_rate", "read-only")),
    ):
        values = dict(values, type="sliding_mode") if "sliding_mode__phi" in values else values
        success, reason = observer.set_parameters(node, **values)
        assert not success
        assert all(word in reason for word in words), reason
        assert controller.parameters == before
        for name in values:
            dotted = name.replace("__", ".")
            assert controller.get_parameter(dotted).value == before.to_mapping()[dotted] or not isinstance(
                before.to_mapping()[dotted], (float, str)
            )

    for kind in ("sliding_mode", "open_loop"):
        since = len(commands)
        success, reason = observer.set_parameters(node, type=kind)
        assert success, reason
        assert controller.controller_type == kind
        keep_sending(lambda: driver.send(4e-6), lambda since=since: len(commands) > since + 2)
        # the same as before, except for the rounding of a command that may still have been on the way
        assert commands[since].data == pytest.approx(commands[since - 1].data, abs=1e-18)
        assert max(abs(c.data - 4e-6) for c in commands[since : since + 2]) < 0.2 * 4e-6
    assert observer.set_parameters(node, type="sliding_mode")[0]
    since = len(commands)
    keep_sending(lambda: driver.send(4e-6), lambda: len(commands) > since + 2)
    since = len(commands)
    assert observer.set_parameters(node, sliding_mode__phi=0.9, sliding_mode__delta=0.02)[0]
    keep_sending(lambda: driver.send(4e-6), lambda: len(commands) > since)
    assert commands[since].data == pytest.approx(commands[since - 1].data, abs=1e-18)


def test_model_and_limits_of_the_compensator_change_live_without_a_jump(compensator, observer):
    from std_msgs.msg import Float64

    voltages = observer.listen(Float64, "/voltage")
    command = observer.talk(Float64, "/command")

    def send():
        command.publish(Float64(data=8.0e-6))

    keep_sending(send, lambda: voltages and voltages[-1].data > 50.0)
    # no commands are sent while a service answers, which takes long on a busy machine
    assert observer.set_parameters("/hysteresis_compensator", command_timeout=60.0)[0]
    keep_sending(send, lambda: voltages[-1].data > 50.0)
    for values in ({"hysteresis__polynomial__scale": 1.2}, {"limits__maximum": 100.0, "limits__bits": 12}):
        since = len(voltages)
        before = voltages[-1].data
        success, reason = observer.set_parameters("/hysteresis_compensator", **values)
        assert success, reason
        keep_sending(send, lambda since=since: len(voltages) > since)
        assert abs(voltages[since].data - before) < 0.06  # a step of the 12-bit converter is 0.03 V
    before = compensator.parameters
    success, reason = observer.set_parameters("/hysteresis_compensator", limits__maximum=-40.0, limits__bits=10)
    assert not success and "limits" in reason
    assert compensator.parameters == before
    success, reason = observer.set_parameters("/hysteresis_compensator", hysteresis__type="proportional")
    assert not success and "hysteresis.type" in reason


def test_waveform_changes_only_while_stopped(generator, observer):
    success, reason = observer.set_parameters("/reference_generator", waveform__offset=1e-6)
    assert not success and "waveform.offset" in reason and "stop" in reason
    assert observer.trigger("/reference_generator/stop").success
    assert observer.set_parameters("/reference_generator", waveform__offset=1e-6)[0]
    assert observer.trigger("/reference_generator/start").success
    assert generator.parameters.waveform.offset == 1e-6


def test_parameters_describe_themselves(generator, observer):
    from rcl_interfaces.srv import DescribeParameters

    names = [row.name for row in generator.interface._cls.table()]
    request = DescribeParameters.Request(names=[n for n in names if n != "use_sim_time"])
    answer = observer.call(DescribeParameters, "/reference_generator/describe_parameters", request)
    found = {d.name: d for d in answer.descriptors}
    assert all(d.description and d.additional_constraints for d in found.values())
    assert found["sample_rate"].read_only and "[Hz]" in found["sample_rate"].description
    assert "0.001 … 1e+06 Hz" in found["sample_rate"].additional_constraints


def test_a_transition_that_does_not_fit_is_refused_and_the_node_works_on(controller, observer):
    from lifecycle_msgs.srv import ChangeState
    from std_msgs.msg import Float64

    request = ChangeState.Request()
    for wrong in (1, 2, 3, 5, 10, 99):
        request.transition.id = wrong
        assert not observer.call(ChangeState, "/motion_controller/change_state", request).success
        assert controller.active and not controller.failure
    commands, driver = observer.listen(Float64, "/command"), Driver(observer)
    reference = observer.talk(Float64, "/reference")
    keep_sending(lambda: (reference.publish(Float64(data=1.0e-6)), driver.send()), lambda: commands)
    assert observer.transition("/motion_controller", "deactivate")


def test_a_reference_that_stops_is_reported_and_the_last_one_kept(controller, observer):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64

    reports = observer.listen(DiagnosticArray, "/diagnostics")
    commands, reference = observer.listen(Float64, "/command"), observer.talk(Float64, "/reference")
    driver = Driver(observer)

    def said():
        return (diagnostics(reports, "/motion_controller") or [0, ""])[1]

    def both():
        reference.publish(Float64(data=8.0e-6))
        driver.send()

    keep_sending(both, lambda: commands and commands[-1].data == 8.0e-6)
    keep_sending(driver.send, lambda: "reference no longer received" in said(), what="the warning")
    assert commands[-1].data == 8.0e-6
    reports.clear()
    keep_sending(both, lambda: reports and "nobody" not in said() and said(), what="no warning")


def test_a_controller_that_is_deactivated_lets_the_voltage_slew_to_safe(inside, observer):
    from std_msgs.msg import Float64

    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode

    slow = parameters("hysteresis_compensator", command_timeout=0.1, safe_slew_rate=200.0)
    inside.add(HysteresisCompensatorNode, slow)
    inside.add(MotionControllerNode, parameters("motion_controller", type="open_loop", measurement_timeout=0.3))
    inside.spin()
    voltages = observer.listen(Float64, "/voltage")
    reference, driver = observer.talk(Float64, "/reference"), Driver(observer)
    keep_sending(lambda: (reference.publish(Float64(data=6.0e-6)), driver.send()), lambda: voltages)
    keep_sending(driver.send, lambda: voltages[-1].data > 40.0, what="a voltage")
    since = len(voltages)
    assert observer.transition("/motion_controller", "deactivate")
    until(lambda: abs(voltages[-1].data - slow.safe_voltage) < 1e-9, what="the safe voltage")
    moved = [message.data for message in voltages[since - 1 :]]
    # a watchdog checks every 10 ms
    assert max(abs(b - a) for a, b in zip(moved, moved[1:], strict=False)) < 1.5 * 200.0 * 0.01 + 1e-9


def test_services_answer_in_every_state(inside, observer):
    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode
    from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
    from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode

    axis = axis_parameters(sample_rate=RATE, autostart=False)
    for cls in (PlantSimulatorNode, HysteresisCompensatorNode, MotionControllerNode, ReferenceGeneratorNode):
        name = {PlantSimulatorNode: "plant_simulator", HysteresisCompensatorNode: "hysteresis_compensator"}.get(cls)
        name = name or ("motion_controller" if cls is MotionControllerNode else "reference_generator")
        inside.add(cls, getattr(axis, name), autostart=False)
    inside.spin()
    plant, compensator = inside.nodes[0], inside.nodes[1]
    names = [f"/{node.get_name()}" for node in inside.nodes]
    for name in names:
        for service in ("start", "stop", "reset"):
            answer = observer.trigger(f"{name}/{service}")
            assert not answer.success and "not configured" in answer.message
    for _ in range(2):  # and again after cleanup
        for name in names:
            assert observer.transition(name, "configure")
        for name in names:
            assert observer.transition(name, "activate")
        until(lambda: compensator.sample > 20 and plant.sample > 20, what="the loop to run")
        for name in names:
            assert observer.trigger(f"{name}/stop").message.startswith("stopped")
            assert observer.trigger(f"{name}/reset").message == "reset; stopped: call ~/start to resume"
            assert observer.trigger(f"{name}/start").message == "running"
        until(lambda: compensator.sample > 20 and plant.sample > 20, what="the loop to run again")
        for name in names:
            assert observer.transition(name, "deactivate")
        assert plant.runner.thread is None  # nothing publishes on objects that cleanup destroys
        before = plant.sample
        for name in names:
            assert observer.transition(name, "activate")
        until(lambda before=before: plant.sample > before + 10, what="the loop after reactivation")
        for name in names:
            assert observer.transition(name, "deactivate")
            assert observer.transition(name, "cleanup")
    assert not any(node.failure for node in inside.nodes)


def test_our_names_shadow_nothing_of_rclpy(inside):
    from rclpy.lifecycle import LifecycleNode

    from hysteresis_ros.nodes.base import AxisNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode

    plain = LifecycleNode("plain", context=inside.context)
    theirs = set(vars(plain)) | set(dir(LifecycleNode))
    node = inside.add(MotionControllerNode, parameters("motion_controller"))
    ours = set(vars(node)) - set(vars(plain))
    for cls in type(node).__mro__[: type(node).__mro__.index(LifecycleNode)]:
        ours |= {name for name in vars(cls) if not name.startswith("__")}
    plain.destroy_node()
    hooks = {"on_configure", "on_activate", "on_deactivate", "on_cleanup", "on_shutdown", "destroy_node"}
    hooks |= {"describe_parameter", "list_parameters"}
    hooks |= {"create_service"}  # guarded: nodes.services
    hooks |= {"_LifecycleNodeMixin__on_change_state"}  # guarded: nodes.lifecycle
    assert (ours & theirs) - hooks == set(), AxisNode
