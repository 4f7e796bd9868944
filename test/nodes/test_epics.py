# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A motor record on Channel Access, accessed by caproto's client, and the link from a record to running nodes."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from types import SimpleNamespace

import pytest
from record_support import SETTINGS
from waiting import until

from hysteresis_ros.laboratory.epics.record import (
    SILENT,
    STOPPED,
    Alarm,
    MotorRecord,
    RecordOptions,
    Seen,
    motor_settings,
)


class Stage:
    """An axis that reaches its setpoint after a while; ``still`` holds it on the way."""

    def __init__(self):
        self.setpoint = self.position = 0.0
        self.still, self.alarm, self.asked = threading.Event(), Alarm(), []

    def look(self, now):
        if not self.still.is_set():
            self.position = self.setpoint
        return Seen(self.position, self.setpoint, self.alarm)

    def move(self, setpoint):
        self.asked.append(setpoint)
        self.setpoint = setpoint

    def stop(self):
        self.asked.append("stop")
        self.setpoint = self.position


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def served(monkeypatch):
    """A record on a separate port, and its axis."""
    pytest.importorskip("caproto", reason="caproto is not installed: no EPICS")
    port = str(free_port())
    values = {
        "EPICS_CA_SERVER_PORT": port,
        "EPICS_CAS_SERVER_PORT": port,
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    from hysteresis_ros.laboratory.epics.server import Motor, serve

    stage, over, ready = Stage(), threading.Event(), threading.Event()

    def run():
        motor = Motor(SETTINGS, stage)
        asyncio.run(serve([motor], ["127.0.0.1"], over.is_set, ready.set))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    until(ready.is_set, what="a server")
    yield stage
    over.set()
    thread.join(10.0)
    assert not thread.is_alive()


def read(field: str, kind=None):
    from caproto.sync.client import read as get

    return get(f"t:m1{field}", data_type=kind, repeater=False, timeout=10.0)


def number(field: str):
    return read(field).data[0]


def write(field: str, value, notify: bool = True):
    from caproto.sync.client import write as put

    return put(f"t:m1{field}", value, notify=notify, repeater=False, timeout=20.0)


def test_a_write_that_waits_is_answered_when_the_move_is_over(served):
    write(".VAL", 4.0)
    assert served.asked == [pytest.approx(4e-6)]
    assert number(".DMOV") == 1 and number(".RBV") == pytest.approx(4.0) and number("") == pytest.approx(4.0)
    served.still.set()
    write(".VAL", 9.0, notify=False)
    until(lambda: number(".DMOV") == 0 and number(".MOVN") == 1, what="a move under way")
    write(".STOP", 1)
    until(lambda: number(".DMOV") == 1, what="the end of the move")
    assert served.asked[-1] == "stop" and number(".VAL") == pytest.approx(4.0)


def test_what_is_refused_stands_in_the_alarm_of_value_and_readback(served):
    write(".VAL", 99.0)
    assert served.asked == [] and number(".LVIO") == 1 and number(".VAL") == 0.0
    for field in (".RBV", "", ".VAL"):
        metadata = read(field, "time").metadata
        assert (metadata.severity, metadata.status) == (2, 4)  # MAJOR, HIGH
    served.alarm = SILENT
    until(lambda: read(".RBV", "time").metadata.severity == 3, what="INVALID")
    assert number(".SEVR") == b"INVALID"
    write(".VAL", 1.0)
    assert served.asked == []


READ_ONLY = (".RBV", ".DRBV", ".RRBV", ".DMOV", ".MOVN", ".LVIO", ".DIFF", ".MSTA", ".STAT", ".SEVR", ".TDIR")


@pytest.mark.parametrize("field", READ_ONLY)
def test_what_a_record_only_says_cannot_be_written_and_that_is_no_traceback(served, field, caplog, capfd):
    before = number(field)
    with pytest.raises(Exception, match="cannot write"):
        write(field, 3)
    assert number(field) == before
    write(".VAL", 4.0)
    assert served.asked == [pytest.approx(4e-6)], "the record must not continue the move"
    said = caplog.text + "".join(capfd.readouterr())
    assert "Traceback" not in said and "refused: Forbidden: Client with" in said, said


def test_limits_units_and_digits_are_those_of_the_record(served):
    write(".HLM", 6.0)
    until(lambda: read("", "control").metadata.upper_ctrl_limit == 6.0, what="the new limit")
    control = read("", "control").metadata
    assert (control.lower_ctrl_limit, control.precision, control.units) == (0.0, 4, b"um")
    assert number(".EGU") == b"um" and number(".DHLM") == 6.0
    write(".DIR", "Neg")
    until(lambda: read("", "control").metadata.lower_ctrl_limit == -6.0, what="limits the other way round")
    write(".SPMG", "Pause")
    write(".VAL", -3.0)
    assert served.asked == []
    write(".SPMG", "Go")
    until(lambda: served.asked == [pytest.approx(3e-6)], what="the move")


def test_an_axis_is_silent_until_its_subscription_of_setpoints_is_discovered():
    """A setpoint that is published before would be lost."""
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
    from sensor_msgs.msg import JointState

    from hysteresis_ros.laboratory.epics.link import AxisLink

    count = 0
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(get_subscription_count=lambda: count),
        create_client=lambda *_: None,
        create_subscription=lambda *_: None,
    )
    link = AxisLink(node, SETTINGS)
    link._on_measurement(JointState(name=[SETTINGS.joint], position=[1e-6]))
    link._on_state(JointState(name=["setpoint"], position=[1e-6]))
    assert link.look(time.monotonic()).alarm == SILENT
    count = 1
    assert link.look(time.monotonic()).alarm == Alarm()


def test_the_link_moves_stops_and_judges_running_nodes(inside, observer, monkeypatch):
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
    import rclpy
    from nodes_support import axis_parameters, compose
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Bool

    from hysteresis_ros.laboratory.epics import link
    from hysteresis_ros.laboratory.epics import record as recording

    # a busy machine must not count as a dead axis
    monkeypatch.setattr(link, "SILENCE", 30.0)
    monkeypatch.setattr(recording, "TAKEN", 30.0)
    slow = {
        "plant_simulator": {"late_limit": -1},
        "motion_controller": {"type": "open_loop"},
        "reference_generator": {"approach__maximum_velocity": 8e-6, "trajectory__goal_tolerance": 6e-7},
    }
    axis = axis_parameters(overrides=slow, sample_rate=200.0, time_mode="realtime")
    *_, source = compose(inside, axis)
    node = rclpy.create_node("epics_ioc", context=inside.context)
    executor = SingleThreadedExecutor(context=inside.context)
    executor.add_node(node)
    settings = motor_settings(axis, RecordOptions("t:", "um", 4, 40.0))
    record = MotorRecord(settings, link.AxisLink(node, settings))
    inside.spin()

    def look(condition):
        executor.spin_once(timeout_sec=0.01)
        record.tick(time.monotonic())
        return condition()

    def wait(condition, what):
        until(lambda: look(condition), what=what, every=0.0)

    try:
        wait(lambda: record.alarm == Alarm() and node.count_publishers("/setpoint"), "an axis that is there")
        wait(lambda: all(node.count_subscribers(t) for t in ("/setpoint", "/joint_trajectory")), "who listens")
        record.put("VAL", 2.0, time.monotonic())
        wait(lambda: record.fields["DMOV"] == 1, "the end of a move")
        assert record.alarm == Alarm() and source.setpoint == pytest.approx(2e-6)
        record.put("VAL", 11.0, time.monotonic())
        wait(lambda: record.fields["RBV"] > 3.0, "the axis on its way")
        record.put("STOP", 1, time.monotonic())
        wait(lambda: record.fields["DMOV"] == 1, "the stop")
        assert 2.0 < record.fields["VAL"] < 10.0 and record.alarm == Alarm()  # the measurement differs by its error
        assert source.part.generator.setpoint == source.setpoint == pytest.approx(1e-6 * record.fields["VAL"])
        emergency = node.create_publisher(Bool, "/estop", 10)
        wait(lambda: emergency.get_subscription_count(), "who hears emergencies")
        emergency.publish(Bool(data=True))
        wait(lambda: record.alarm == STOPPED, "the alarm of an axis that was stopped")
        record.put("VAL", 1.0, time.monotonic())
        wait(lambda: record.fields["DMOV"] == 1, "the refusal")
        assert source.setpoint == pytest.approx(1e-6 * record.fields["VAL"])
        assert observer.transition("/plant_simulator", "deactivate")
        monkeypatch.setattr(link, "SILENCE", 0.5)
        wait(lambda: record.alarm == SILENT, "the alarm of an axis that is silent")
    finally:
        executor.shutdown()
        node.destroy_node()
