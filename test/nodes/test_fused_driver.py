# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A driver in C for a fused axis, as users start it: moved, recorded, verified, and closed in its safe state."""

from __future__ import annotations

import re
import signal

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import diagnostics, until  # noqa: E402
from stage_support import built, listed_library, needs_compiler, running_stage  # noqa: E402

from hysteresis_ros.recordings.align import read_recording  # noqa: E402
from hysteresis_ros.recordings.bag_reader import read_bag  # noqa: E402
from hysteresis_ros.recordings.triggers import triggers_of  # noqa: E402

pytestmark = needs_compiler

#: No pulse comes. With its trigger input the axis has the loop with triggers, which all devices of the tests share.
AXIS = """
/**:
  ros__parameters: {{sample_rate: 1000.0, time_mode: realtime}}
/**/plant_simulator:
  ros__parameters:
    driver: {driver}
    driver_options: ['name={name}']
    late_limit: -1
    realtime: {{priority: 0}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/reference_generator:
  ros__parameters: {{minimum: 0.0, maximum: 10.0e-6, triggers: {{input: {{action: hold}}}}}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
"""

#: A watchdog long enough for a busy machine.
PATIENT = ("--watchdog", "20", "--rate", "5000")


def written(tmp_path, name: str, driver=None) -> str:
    path = tmp_path / "axis.yaml"
    path.write_text(AXIS.format(driver=driver or built() / "libstage.so", name=name))
    return str(path)


def test_setpoints_move_the_stage_and_the_recording_verifies_bit_for_bit(processes, observer, tmp_path):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    with running_stage(*PATIENT) as stage:
        joints = observer.listen(JointState, "/joint_states")
        setpoint = observer.talk(Float64, "/setpoint")
        axis, bag = written(tmp_path, stage.name), str(tmp_path / "bag")
        up = processes.command("up", axis, "--fused", "--record", bag, "--verify")
        until(lambda: joints and setpoint.get_subscription_count(), what="the axis")
        setpoint.publish(Float64(data=5.0e-6))
        # open loop without inverse: 50 V minus the effect of the play
        until(lambda: abs(joints[-1].position[0] - 4.75e-6) < 2e-8, what="the stage where 50 V bring it")
        code, _ = up.leave(signal.SIGINT)
        assert code == 0 and "equal" in up.output, up.output


def test_triggers_are_published_as_they_are_in_the_samples(processes, tmp_path):
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import JointState

    scan = ("--reference", "triangle", "--frequency", "4Hz", "--amplitude", "8um", "--offset", "1um")
    scan += ("--trigger", "start=2um", "--trigger", "step=1um", "--trigger", "stop=8um")
    with running_stage(*PATIENT) as stage:
        asked = ("--duration", "1", "--record", str(tmp_path / "bag"), "--verify")
        run = processes.command("up", written(tmp_path, stage.name), "--fused", *asked, *scan)
        assert run.wait(300.0) == 0, run.output
    # seven positions in each half of a period
    recorded = read_recording(tmp_path / "bag")
    found = triggers_of(recorded)
    stored = read_bag(tmp_path / "bag").topics["/trigger_out"].data
    messages = [deserialize_message(data, JointState) for data in stored]
    assert len(messages) == found.sample.size > 30
    assert found.lost == 0 or recorded["skipped"].any()
    assert [message.position[1] for message in messages] == list(found.position)
    assert set(found.direction) == {-1.0, 1.0}


def test_a_stage_that_dies_is_named_and_the_axis_stays_stopped(processes, observer, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    with running_stage(*PATIENT) as stage:
        joints = observer.listen(JointState, "/joint_states")
        reports = observer.listen(DiagnosticArray, "/diagnostics")
        recorded = ("--record", str(tmp_path / "bag"))
        up = processes.command("up", written(tmp_path, stage.name), "--fused", *recorded)
        until(lambda: joints, what="the axis")
        stage.process.kill()
        until(lambda: joints[-1].header.frame_id == "tripped", what="the axis to stop")
        until(lambda: (diagnostics(reports, "/plant_simulator") or [0])[0] == 2)
        assert f"the process of stage {stage.name} has died" in diagnostics(reports, "/plant_simulator")[1]
        assert up.leave(signal.SIGINT)[0] == 1
        assert re.search(r"the device failed at \S+ s; the axis was stopped until the end", up.output)


def test_a_stage_without_its_process_is_refused(processes, tmp_path):
    up = processes.command("up", written(tmp_path, "/nowhere_at_all"), "--fused")
    words = "stage /nowhere_at_all is not there; start `stage_device"
    assert up.wait() == 2 and words in up.output and "Traceback" not in up.output, up.output


#: A driver in Python that notes its voltages, and does not answer while a file exists.
PLUGGED = """
import pathlib
from dataclasses import dataclass

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import Capabilities, Driver, HardwareDriver, Reading


@dataclass(frozen=True)
class Options(Parameters):
    name: str = parameter("", description="folder of its files")


class Plugged(Driver):
    def open(self, parameters, sample_rate):
        folder = pathlib.Path(parameters.name)
        self.unplugged, self.log, self.voltage = folder / "unplugged", (folder / "log").open("w", buffering=1), 0.0
        return Capabilities(1, 1, 0.0, 100.0, highest_rate=1e4)

    def answer(self):
        if self.unplugged.exists():
            raise OSError("no cable")

    def read(self):
        self.answer()
        return Reading((1e-7 * self.voltage,))

    def write(self, voltages):
        self.answer()
        self.voltage = voltages[0]
        print(self.voltage, file=self.log)

    def make_safe(self):
        self.answer()
        self.voltage = 0.0
        print("safe", file=self.log)

    def close(self):
        self.log.close()


DRIVER = HardwareDriver(name="plugged", title="a stage with a cable", parameters=Options, driver=Plugged)
"""


def test_a_driver_in_python_is_fused_above_300_hz_and_made_safe_before_a_start(processes, observer, tmp_path):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64
    from std_srvs.srv import Trigger

    folder, bag = tmp_path / "device", tmp_path / "bag"
    folder.mkdir()
    (folder / "plugged.py").write_text(PLUGGED)
    axis = written(folder, f"{folder}", "./plugged.py")
    joints = observer.listen(JointState, "/joint_states")
    setpoint = observer.talk(Float64, "/setpoint")
    up = processes.command("up", axis, "--record", str(bag), "--verify")
    until(lambda: joints and setpoint.get_subscription_count(), what="the axis")
    assert "fused" in up.output
    setpoint.publish(Float64(data=5.0e-6))
    until(lambda: joints[-1].position[0] > 4.0e-6, what="the stage near 50 V")
    (folder / "unplugged").touch()
    until(lambda: joints[-1].header.frame_id == "tripped", what="the axis to stop")
    log = (folder / "log").read_text().split()
    assert float(log[-1]) > 40.0, "it could not be made safe"
    (folder / "unplugged").unlink()
    assert observer.call(Trigger, "/plant_simulator/start", Trigger.Request()).success
    until(lambda: joints[-1].header.frame_id == "" and joints[-1].position[0] > 4.0e-6, what="the axis to return")
    code, _ = up.leave(signal.SIGINT)
    assert code == 0 and "equal" in up.output, up.output
    table = tmp_path / "table.npz"
    for command in (("verify", bag), ("export", bag, "-o", table), ("verify", table)):
        again = processes.command(*map(str, command))
        assert again.wait() == 0, again.output
    log = (folder / "log").read_text().split()
    voltages = [0.0 if word == "safe" else float(word) for word in log]
    steps = [after - before for before, after in zip(voltages, voltages[1:], strict=False)]
    # one step down only by make_safe of the driver
    assert all(step > -20.0 or word == "safe" for step, word in zip(steps, log[1:], strict=True))


def test_a_driver_that_does_not_return_ends_the_run_by_its_name(processes, tmp_path):
    path = written(tmp_path, "", listed_library(tmp_path))
    axis = (tmp_path / "axis.yaml").read_text().replace("'name='", "'block=300'")
    (tmp_path / "axis.yaml").write_text(axis)
    bag = tmp_path / "bag"
    up = processes.command("up", path, "--fused", "--record", str(bag))
    assert up.wait() == 1, up.output
    said = r"has not returned from sample (\d+) for 0\.5 s: no voltage is sent; the device's own watchdog"
    found = re.search(said, up.output)
    assert found and "Traceback" not in up.output, up.output
    # the recording contains every earlier sample; the driver was not called for skipped ones
    assert int(found[1]) >= 299 and read_recording(str(bag)).time.size == int(found[1])
