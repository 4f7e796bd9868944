# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A driver as plant, over real DDS: it behaves like the simulated plant, and its failure is safe."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, diagnostics, until, write_axis  # noqa: E402

from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver  # noqa: E402
from hysteresis_ros.hardware.registry import DRIVERS  # noqa: E402

RATE = 100.0
TARGET = 6.0e-6


def driven(**plant):
    """An axis in real time with a driver as plant."""
    # a busy machine may be late, which is not tested here
    plant = {"driver": "simulated", "late_limit": -1, **plant}
    return axis_parameters(overrides={"plant_simulator": plant}, sample_rate=RATE)


class Stage(SimulatedDriver):
    """The simulated actuator, which stores its calls and fails on request."""

    failing = ""
    heard: list = []
    closed = 0

    def read(self):
        if self.failing == "read":
            raise OSError("unplugged")
        return super().read()

    def write(self, voltages):
        if self.failing == "write":
            raise OSError("unplugged")
        self.heard.append(voltages[0])
        super().write(voltages)

    def make_safe(self):
        self.heard.append("safe")
        super().make_safe()

    def close(self):
        Stage.closed += 1


@pytest.fixture
def stage(monkeypatch):
    """Register a driver of the test."""
    for name, value in (("failing", ""), ("heard", []), ("closed", 0)):
        monkeypatch.setattr(Stage, name, value)
    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Stage))
    return Stage


def moved(observer, target: float = TARGET):
    """Send a setpoint until the axis reaches it; return the following messages."""
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    joints = observer.listen(JointState, "/joint_states")
    setpoint = observer.talk(Float64, "/setpoint")
    until(lambda: joints and setpoint.get_subscription_count(), what="the axis to run")
    setpoint.publish(Float64(data=target))
    until(lambda: abs(joints[-1].position[0] - target) < 1e-8, what="the axis at its setpoint")
    return joints


def test_an_axis_behind_a_driver_follows_a_setpoint_and_says_so_without_a_true_displacement(
    processes, observer, tmp_path
):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    node = processes.node("hysteresis_axis", write_axis(tmp_path / "axis.yaml", driven()))
    states = observer.listen(JointState, "/plant_simulator/state")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    joints = moved(observer)
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in joints[-50:]]
    assert [b - a for a, b in zip(stamps[:-1], stamps[1:], strict=True)] == pytest.approx([1e9 / RATE] * 49, abs=2)
    assert list(states[-1].name) == ["measured", "voltage", "mode", "tripped", "late", "skipped", "force"]
    until(lambda: diagnostics(reports, "/plant_simulator"))
    assert diagnostics(reports, "/plant_simulator")[2]["tripped"] == "False"
    assert "driver simulated: -30 … 120 V" in node.output and "no watchdog of its own" in node.output
    code, _ = node.leave()
    assert code == 0 and "Traceback" not in node.output


@pytest.mark.parametrize("call", ["read", "write"])
def test_a_driver_that_fails_stops_the_axis_which_says_why_and_goes_on_when_started(inside, observer, stage, call):
    from diagnostic_msgs.msg import DiagnosticArray

    plant, *_ = compose(inside, driven())
    inside.spin()
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    joints = moved(observer)
    stage.failing = call
    until(lambda: plant.part.tripped, what="the axis to stop")
    until(lambda: joints[-1].header.frame_id == "tripped")
    assert joints[-1].position[0] != joints[-1].position[0], "a position without a measurement is published"
    until(lambda: (diagnostics(reports, "/plant_simulator") or [0])[0] == 2)
    said = diagnostics(reports, "/plant_simulator")[1]
    assert said.startswith("axis stopped: driver simulated: cannot be ") and "OSError: unplugged" in said
    assert "~/start" in said and stage.heard[-1] == "safe"
    for _ in range(2):  # no node starts while the device fails, and each answer says so
        answer = observer.trigger("/plant_simulator/start")
        assert not answer.success and "OSError: unplugged" in answer.message and plant.part.tripped
    answer = observer.trigger("/motion_controller/start")
    assert not answer.success and "the plant has stopped the axis" in answer.message
    stage.failing = ""
    since = len(joints)
    until(lambda: len(joints) > since + 20)
    assert stage.heard[-1] == "safe" and plant.part.tripped, "the axis continued without ~/start"
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: abs(joints[-1].position[0] - TARGET) < 1e-8, what="the axis back at its setpoint")
    until(lambda: diagnostics(reports, "/plant_simulator")[0] < 2)
    assert all(-30.0 <= voltage <= 120.0 for voltage in stage.heard if voltage != "safe")


def test_while_the_time_is_held_the_device_hears_of_the_node(inside, observer, stage):
    """The watchdog of the device would count the pause as a failure."""
    plant, *_ = compose(inside, driven())
    inside.spin()
    moved(observer)
    assert observer.trigger("/plant_simulator/stop").success
    until(lambda: plant.holds_time)
    since = len(stage.heard)
    until(lambda: len(stage.heard) > since + 20, what="the device to hear of the node")
    held = plant.part.held()  # a sample may have been in progress at the stop
    assert set(stage.heard[since + 2 :]) == {held} and not plant.part.tripped


def test_deactivated_the_device_goes_to_safe_and_cleaned_up_it_is_let_go(inside, observer, stage):
    plant, *_ = compose(inside, driven(safe_slew_rate=500.0))
    inside.spin()
    moved(observer)
    since = len(stage.heard) - 1
    assert stage.heard[since] > 20.0
    assert observer.transition("/plant_simulator", "deactivate")
    assert stage.heard[-1] == "safe" and stage.heard[-2] == 0.0
    way = [value for value in stage.heard[since:] if value != "safe"]
    assert min(b - a for a, b in zip(way[:-1], way[1:], strict=True)) >= -500.0 / RATE * (1 + 1e-9)
    assert stage.closed == 0
    assert observer.transition("/plant_simulator", "cleanup") and stage.closed == 1
    assert observer.transition("/plant_simulator", "configure")
    assert observer.transition("/plant_simulator", "activate")
    if plant.part.lost:  # on a busy machine it was away for longer than the others wait
        assert observer.trigger("/plant_simulator/start").success
    moved(observer)
    assert not plant.part.tripped


#: A third-party package with a driver for a device that does not exist.
ABSENT = """
import contextlib
from dataclasses import replace
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.simulated import DRIVER as GIVEN, SimulatedDriver

class Absent(SimulatedDriver):
    def open(self, parameters, sample_rate):
        raise DriverError("absent 7", "does not answer", "switch it on")

DRIVER = replace(GIVEN, name="absent", driver=Absent)
"""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"driver: ''": "driver: absent"}, "driver absent: cannot be opened: absent 7 does not answer; switch it on"),
        ({"driver: ''": "driver: absend"}, "driver = 'absend': unknown choice"),
        ({"driver: ''": "driver: absent", "time_mode: realtime": "time_mode: lockstep"}, "driver = 'absent': a device"),
    ],
)
def test_a_driver_that_cannot_be_opened_ends_the_node_in_one_line(processes, tmp_path, monkeypatch, changes, said):
    (tmp_path / "others.py").write_text(ABSENT)
    information = tmp_path / "others-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[hysteresis_ros.drivers]\nabsent = others:DRIVER\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    axis = axis_parameters(sample_rate=RATE, time_mode="realtime")
    text = axis.configuration_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    node = processes.node("plant_simulator", str(path))
    assert node.wait() == 2
    lines = [line for line in node.output.splitlines() if line.strip()]
    assert len(lines) == 1 and "not configured: " in lines[0] and said in lines[0], node.output


#: A driver that does not return from its 100th voltage, and shortens the patience of its process.
STUCK = """import pathlib
import threading
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.hardware.driver import Capabilities, Driver, HardwareDriver, Reading
from hysteresis_ros.nodes import plant_runners

plant_runners.METHOD_PATIENCE = 0.5


@dataclass(frozen=True)
class Options(Parameters):
    pass


class Stuck(Driver):
    written, voltage = 0, 0.0

    def open(self, parameters, sample_rate):
        return Capabilities(1, 1, -30.0, 120.0, highest_rate=3000.0)

    def read(self):
        return Reading((1e-7 * self.voltage,))

    def write(self, voltages):
        self.written, self.voltage = self.written + 1, voltages[0]
        if self.written >= 100:
            pathlib.Path(__file__).with_name("stuck").touch()
            threading.Event().wait()

    def make_safe(self):
        pass

    def close(self):
        pass


DRIVER = HardwareDriver(name="stuck", title="does not return", parameters=Options, driver=Stuck)
"""


@pytest.mark.parametrize("how", ["--composed", "--processes"])
def test_a_driver_that_does_not_return_ends_the_run_by_its_name(processes, tmp_path, how):
    (tmp_path / "stuck.py").write_text(STUCK)
    text = axis_parameters(sample_rate=RATE, time_mode="realtime").configuration_text()
    path = tmp_path / "axis.yaml"
    path.write_text(text.replace("driver: ''", f"driver: {tmp_path / 'stuck.py'}"))
    run = processes.command("up", str(path), how)
    assert run.wait() == 1, run.output
    assert (tmp_path / "stuck").exists()
    assert "has not returned from sample" in run.output and "so the device keeps its last voltage" in run.output


def test_up_refuses_a_driver_in_lockstep(processes, tmp_path):
    path = write_axis(tmp_path / "axis.yaml", driven())
    command = processes.command("up", path, "--rate", "lockstep")
    assert command.wait() == 2
    lines = command.output.splitlines()
    assert len(lines) == 1 and "driver = 'simulated': a device does not wait for nodes" in lines[0]


def test_a_relative_sensor_is_homed_by_the_service_where_the_axis_is_safe(inside, observer, stage):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Bool, Float64

    relative = {"calibration__sensor__reference": "relative", "calibration__sensor__home": 1.0e-6}
    plant, *_ = compose(inside, driven(**relative))
    inside.spin()
    joints = observer.listen(JointState, "/joint_states")
    setpoint, estop = observer.talk(Float64, "/setpoint"), observer.talk(Bool, "/estop")
    until(lambda: joints and setpoint.get_subscription_count() and estop.get_subscription_count())
    setpoint.publish(Float64(data=TARGET))
    until(lambda: joints[-1].position[0] > 4.0e-6, what="the axis to move")
    refused = observer.trigger("/plant_simulator/home")
    assert not refused.success and "home is the position at safe_voltage = 0 V: stop the axis" in refused.message
    estop.publish(Bool(data=True))
    until(lambda: plant.part.tripped and plant.part.held() == 0.0, what="the axis at its safe voltage")
    until(lambda: abs(joints[-1].position[0] - 1.0e-6) > 1e-8, what="the place where hysteresis leaves it")
    assert observer.trigger("/plant_simulator/home").success
    until(lambda: abs(joints[-1].position[0] - 1.0e-6) < 5e-9, what="home under its name")
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: joints[-1].position[0] > 4.0e-6, what="the axis to move again")
