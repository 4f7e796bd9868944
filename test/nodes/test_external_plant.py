# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A third-party node as plant: the other nodes of the axis are started, drive it and record it."""

from __future__ import annotations

import pathlib
import signal
import sys

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import until  # noqa: E402

from hysteresis_ros.cli.main import main  # noqa: E402
from hysteresis_ros.recordings import load_run  # noqa: E402

STAGE = pathlib.Path(__file__).with_name("external_stage.py")
RATE = 100.0

#: A silence of a busy machine is no loss of a partner, after which no plant of the package could be started again.
AXIS = """
/**:
  ros__parameters: {sample_rate: 100.0, time_mode: realtime}
/**/plant_simulator:
  ros__parameters:
    limits: {minimum: 0.0, maximum: 100.0}
    hysteresis: {type: proportional, proportional: {gain: 1.0e-7}}
/**/reference_generator:
  ros__parameters: {minimum: 0.0, maximum: 10.0e-6}
/**/motion_controller:
  ros__parameters: {type: open_loop, measurement_timeout: 5.0}
/**/hysteresis_compensator:
  ros__parameters:
    command_timeout: 5.0
    inverse: {type: none}
    limits: {minimum: 0.0, maximum: 100.0}
    hysteresis: {type: proportional, proportional: {gain: 1.0e-7}}
"""


@pytest.fixture
def axis(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(AXIS)
    return str(path)


def stage(processes, rate: float = RATE, *more: str):
    return processes.start([sys.executable, str(STAGE), str(rate), *more], "stage")


def recorded_axis(processes, observer, axis, bag, how: str) -> tuple:
    """Start the rest of an axis; return it with its samples, its voltages and a talker when all of it is recorded."""
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    joints = observer.listen(JointState, "/joint_states")
    voltages = observer.listen(Float64, "/voltage")
    until(lambda: joints, what="the stage")
    up = processes.command("up", axis, "--plant", "external", "--record", str(bag), how)
    setpoint = observer.talk(Float64, "/setpoint")
    states = observer.listen(JointState, "/hysteresis_compensator/state")
    until(lambda: voltages and setpoint.get_subscription_count() == 2, what="generator and recorder")
    until(lambda: observer.node.count_subscribers("/hysteresis_compensator/state") == 2, what="the recorder")
    since = len(states)
    until(lambda: len(states) > since + 100, what="answers that are recorded")
    return up, joints, voltages, setpoint


def test_what_it_says_that_it_put_out_is_the_voltage_of_the_recording(processes, observer, tmp_path, axis):
    from std_msgs.msg import Float64

    stage(processes, RATE, "30.0")
    bag = tmp_path / "bag"
    up, joints, _, setpoint = recorded_axis(processes, observer, axis, bag, "--processes")
    setpoint.publish(Float64(data=5.0e-6))  # corresponds to 50 V
    until(lambda: abs(joints[-1].position[0] - 2.75e-6) < 1e-9, what="the stage where 30 V bring it")
    since = len(joints)
    until(lambda: len(joints) > since + 100, what="samples there")
    assert up.leave(signal.SIGINT)[0] == 0, up.output
    recorded = load_run(bag, further=True)
    there = recorded["measured"] > 2.7e-6
    assert np.count_nonzero(there) >= 50 and np.nanmax(recorded["voltage"]) == pytest.approx(30.0)
    assert np.nanmedian(recorded["asked_voltage"][there]) == pytest.approx(50.0)
    assert np.nanmean(recorded["saturated"][there]) > 0.8
    assert "the output was limited" in up.output


def test_the_rest_follows_setpoints_through_it_and_the_recording_goes_into_a_report(
    processes, observer, tmp_path, axis
):
    from std_msgs.msg import Float64

    stage(processes)
    bag = tmp_path / "bag"
    up, joints, voltages, setpoint = recorded_axis(processes, observer, axis, bag, "--composed")
    setpoint.publish(Float64(data=5.0e-6))
    # open loop without inverse: 50 V minus the effect of the play
    until(lambda: abs(joints[-1].position[0] - 4.75e-6) < 1e-9, what="the stage where 50 V bring it")
    since = len(joints)
    until(lambda: len(joints) > since + 100, what="samples there")
    code, _ = up.leave(signal.SIGINT)
    assert code == 0, up.output
    until(lambda: voltages[-1].data == 0.0, what="the safe voltage")
    recorded = load_run(bag)
    assert np.nanmax(recorded["voltage"]) == pytest.approx(50.0)
    assert np.nanmax(recorded["measured"]) == pytest.approx(4.75e-6, abs=1e-8)
    assert any("no true displacement" in note for note in recorded.metadata["notes"])
    report = CliRunner().invoke(main, ["report", str(bag), "-o", str(tmp_path / "report.html")])
    assert report.exit_code == 0, report.output


def test_an_excitation_is_driven_through_it_from_its_beginning_to_its_end(processes, tmp_path):
    rate = 40.0  # late messages have less effect on the agreement
    axis = tmp_path / "slow.yaml"
    axis.write_text(AXIS.replace("sample_rate: 100.0", f"sample_rate: {rate}"))
    stage(processes, rate)
    bag = tmp_path / "bag"
    drive = "excite", str(axis), "--recipe", "decaying", "--duration", "8", "--frequency", "1", "--plant", "external"
    excite = processes.command(*drive, "--record", str(bag))
    assert excite.wait(120.0) == 0, excite.output
    recorded = load_run(bag)
    assert recorded.metadata["messages"]["/reference"] == 8.0 * rate
    # from rest over the full range, and nearly all of it received, on a machine with other work
    reference = recorded["reference"]
    assert len(reference) > 0.8 * 8.0 * rate and np.isfinite(reference).all() and reference[0] == 0.0
    assert reference[: int(2.2 * rate)].max() == pytest.approx(1e-5, rel=1e-2)
    assert np.count_nonzero(np.isfinite(recorded["voltage"])) > 0.8 * 8.0 * rate


def test_a_run_of_given_length_ends_by_itself(processes, tmp_path, axis):
    stage(processes)
    bag = tmp_path / "bag"
    up = processes.command("up", axis, "--plant", "external", "--duration", "1", "--record", str(bag), "--composed")
    assert up.wait(120.0) == 0, up.output
    assert "the run ended" in up.output
    assert load_run(bag).metadata["messages"]["/reference"] == RATE


def test_nothing_begins_without_it_and_another_rate_is_said(processes, observer, axis):
    from std_msgs.msg import Float64

    references = observer.listen(Float64, "/reference")
    up = processes.command("up", axis, "--plant", "external", "--log-level", "info")
    until(lambda: "the run waits for a publisher of joint_states" in up.output, what="the warning")
    assert not references
    stage(processes, 150.0)
    until(lambda: references, what="the beginning")
    until(lambda: "for sample_rate 100 Hz" in up.output, what="the other rate said")
    assert up.leave(signal.SIGINT)[0] == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rate", "lockstep"), "external_plant = True: an external plant does not wait for other nodes"),
        (("--plant", "externl"), "externl"),
        (("--factor", "20"), "2000 samples/s are too many for messages between nodes"),
    ],
)
def test_what_cannot_be_is_refused(processes, axis, options, words):
    up = processes.command("up", axis, "--plant", "external", *options)
    assert up.wait() == 2 and words in up.output and "Traceback" not in up.output


def test_the_plant_of_the_package_refuses_to_be_the_external_one(processes, axis):
    node = processes.node("plant_simulator", axis, "-p", "external_plant:=true")
    assert node.wait() == 2 and "your own node replaces this one" in node.output
