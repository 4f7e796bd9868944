# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Partners that vanish, become silent or return, and axes side by side."""

from __future__ import annotations

import signal
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.nodes.lockstep import Lockstep  # noqa: E402

NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")


@pytest.fixture
def running(processes, observer, tmp_path, request):
    """Four running processes in lockstep; name → process."""
    from sensor_msgs.msg import JointState

    timeout = getattr(request, "param", 5.0)
    path = write_axis(tmp_path / "axis.yaml", axis_parameters(time_mode="lockstep", partner_timeout=timeout))
    heard = observer.listen(JointState, "/joint_states")
    started = {name: processes.node(name, path) for name in NODES}
    started["path"] = path
    until(lambda: len(heard) > 100, what="the run to be under way")
    return started


@pytest.mark.parametrize(
    ("victim", "number"),
    [
        ("plant_simulator", signal.SIGKILL),
        ("hysteresis_compensator", signal.SIGSTOP),
        ("motion_controller", signal.SIGTERM),
    ],
)
def test_run_ends_with_an_error_that_names_the_partner(running, victim, number):
    running[victim].send(number)
    for name in NODES:
        if name == victim:
            continue
        process = running[name]
        assert process.wait(20.0) == 1, f"{name}: {process.output}"
        line = next(line for line in process.output.splitlines() if "[ERROR]" in line)
        assert victim in line.split("]: ", 1)[1], f"{name} says: {line}"
        assert "Traceback" not in process.output


@pytest.mark.parametrize(("sample", "seconds", "fails"), [(0, 119, 0), (1, 119, 0), (1, 121, 1), (2, 9, 0), (2, 11, 1)])
def test_who_is_still_loading_at_the_first_sample_is_waited_for(sample, seconds, fails):
    """With a recorder the others begin without a partner that still loads; by then they have finished sample 0."""
    said, now = [], [0]
    node = SimpleNamespace(sample=sample, share=1.0, parameters=SimpleNamespace(partner_timeout=10.0), fail=said.append)
    node.active, node.failure, node.finished, node.holds_time, node.end_of_run = True, "", False, False, -1
    node.steady = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=now[0]))
    node.partners = SimpleNamespace(forget=lambda: None, complaint=lambda sample: "")
    node.missing_partner = lambda: "motion_controller"
    runner = Lockstep(node)
    node.sample, node.end_of_run = sample, -1
    runner.watch_partners()
    now[0] = seconds * 10**9
    runner.watch_partners()
    assert len(said) == fails and all("motion_controller has been silent" in text for text in said)


@pytest.mark.parametrize("running", [60.0], indirect=True)
@pytest.mark.parametrize("victim", ["hysteresis_compensator"])
def test_restarted_node_cannot_silently_rejoin(running, processes, victim):
    running[victim].kill()
    processes.node(victim, running["path"])
    others = [running[name] for name in NODES if name != victim]
    assert [process.wait(20.0) for process in others] == [1, 1, 1], [process.output for process in others]
    told = [process for process in others if victim in process.output]
    assert told and all("start or reset all nodes together" in process.output for process in told)
    # a node that checks late may see only that the informed node has exited
    unaware = [process.output for process in others if process not in told]
    assert all("vanished" in output for output in unaware), unaware


def test_two_axes_side_by_side_equal_their_twins(processes, tmp_path):
    axes = [
        axis_parameters("/left", {"reference_generator": {"waveform__type": "steps"}}, time_mode="lockstep"),
        axis_parameters("/right", {"reference_generator": {"initial_setpoint": 3e-6}}, time_mode="lockstep"),
    ]
    path = tmp_path / "axes.yaml"
    path.write_text("".join(axis.configuration_text() for axis in axes), encoding="utf-8")
    bags = tmp_path / "bags"
    run = processes.command("up", str(path), "--composed", "--duration", "0.1", "--record", str(bags), "--verify")
    assert run.wait() == 0, run.output
    assert run.output.count("300 samples equal the offline twin bit for bit") == 2


def test_remapping_and_simulated_time(processes, observer, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.qos import qos_profile_sensor_data
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    axis = axis_parameters(
        overrides={"plant_simulator": {"publish_clock": True, "late_limit": -1}}, sample_rate=200.0, use_sim_time=True
    )
    clock = observer.listen(Clock, "/clock", qos_profile_sensor_data)
    joints = observer.listen(JointState, "/stage/joint_states")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    path = write_axis(tmp_path / "axis.yaml", axis)
    remap = ("-r", "setpoint:=/hand/target", "-r", "joint_states:=/stage/joint_states")
    node = processes.node("hysteresis_axis", path, *remap)
    target = observer.talk(Float64, "/hand/target")
    until(lambda: joints and target.get_subscription_count())
    target.publish(Float64(data=4e-6))
    until(lambda: abs(joints[-1].position[0] - 4e-6) < 1e-8, what="the axis at its setpoint")
    until(lambda: clock and len(reports) > 4, what="time and diagnostics")
    assert clock[-1].clock.sec < 1000  # simulated time starts at zero
    assert all(report.header.stamp.sec < 1000 for report in reports)
    assert node.leave(signal.SIGTERM)[0] == 0
