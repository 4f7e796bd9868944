# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis with a GCS controller, over TCP and DDS: it moves, loses its link, and continues after the repair."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, diagnostics, until  # noqa: E402

from hysteresis_ros.laboratory.emulation.bench import Bench  # noqa: E402
from hysteresis_ros.laboratory.emulation.gcs import EmulatedControllerParameters, start  # noqa: E402

RATE = 50.0
GAIN = 8.0e-7
TARGET = 10.0e-6


def axis_at(port: int):
    """An axis in open loop at a controller's port."""
    stage = {"hysteresis__type": "proportional", "hysteresis__proportional__gain": GAIN, "limits__minimum": 0.0}
    plant = {"driver": "gcs", "gcs__port": port, "gcs__timeout": 1.0, "gcs__safe_time": 0.02, "late_limit": -1, **stage}
    overrides = {
        "plant_simulator": plant,
        "hysteresis_compensator": {"inverse__type": "none", **stage},
        "motion_controller": {"type": "open_loop"},
    }
    return axis_parameters(overrides=overrides, sample_rate=RATE, time_mode="realtime")


@pytest.fixture
def running():
    """A controller that exists longer than the nodes."""
    with start(EmulatedControllerParameters(port=0), Bench()) as running:
        yield running


def test_an_axis_at_a_controller_moves_is_stopped_by_a_cut_link_and_goes_on_when_started(running, inside, observer):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    plant, *_ = compose(inside, axis_at(running.driver.port))
    inside.spin()
    joints = observer.listen(JointState, "/joint_states")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    setpoint = observer.talk(Float64, "/setpoint")
    until(lambda: joints and setpoint.get_subscription_count(), what="the axis to run")
    setpoint.publish(Float64(data=TARGET))
    # open loop without inverse: the error is the hysteresis of the stage
    until(lambda: abs(joints[-1].position[0] - TARGET) < 0.4 * TARGET, what="the axis near its setpoint")
    running.faults.add("cut:0:1")
    until(lambda: plant.part.tripped, what="the axis to stop")
    until(lambda: joints[-1].header.frame_id == "tripped" and joints[-1].position[0] != joints[-1].position[0])
    until(lambda: (diagnostics(reports, "/plant_simulator") or [0])[0] == 2)
    said = diagnostics(reports, "/plant_simulator")[1]
    assert f"controller at 127.0.0.1:{running.driver.port}" in said and "~/start" in said
    until(lambda: "cut" not in running.faults, what="the repair")
    assert plant.part.tripped, "the axis continued without ~/start"
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: abs(joints[-1].position[0] - TARGET) < 0.4 * TARGET, what="the axis back at its setpoint")


@pytest.fixture
def moving(running, inside, observer):
    """The plant's node of an axis at its setpoint, with its diagnostics and the emulated amplifier."""
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    plant, *_ = compose(inside, axis_at(running.driver.port))
    inside.spin()
    joints = observer.listen(JointState, "/joint_states")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    setpoint = observer.talk(Float64, "/setpoint")
    until(lambda: joints and setpoint.get_subscription_count(), what="the axis to run")
    setpoint.publish(Float64(data=TARGET))
    until(lambda: abs(joints[-1].position[0] - TARGET) < 0.4 * TARGET, what="the axis near its setpoint")
    return plant, lambda: (diagnostics(reports, "/plant_simulator") or (0, ""))[1], running.device.axes["1"]


@pytest.mark.parametrize("happens", ["repeat", "stale", "echo", "drop", "garbage", "half", "close"])
def test_an_axis_whose_controller_says_a_wrong_line_is_safe_and_says_which(running, moving, observer, happens):
    plant, said, amplifier = moving
    running.faults.add(f"{happens}:0:60:1")
    until(lambda: plant.part.tripped, what="the axis to stop")
    until(lambda: "axis stopped" in said(), what="its reason")
    reasons = ("an unexpected line", "answers '", "does not answer '", "has closed the connection at '")
    assert (
        any(reason in said() for reason in reasons)
        and "another program has" not in said()
        and "servo switched" not in said()
        and "still" not in said()
    )
    assert amplifier.open_value == 0.0
    assert observer.trigger("/plant_simulator/start").success
    until(lambda: amplifier.open_value > 5.0, what="the axis to go on")
    plant.leaving = True
    plant.release()
    assert amplifier.open_value == 0.0


@pytest.mark.parametrize("seen", ["/plant_simulator/start", "/plant_simulator/reset"])
def test_a_voltage_that_cannot_be_taken_off_is_reported_until_it_is_acknowledged_and_when_the_node_leaves(
    running, moving, observer, capfd, seen
):
    plant, said, amplifier = moving
    running.faults.add("cut:0:600")
    until(lambda: "the output is still at" in said(), what="the voltage that is left")
    left = amplifier.open_value
    assert left > 5.0 and f"the output is still at {left:.6g} V" in said()
    # the axis stays stopped; actions of a user are tried, and reported again
    answer = observer.trigger(seen)
    assert answer.success == seen.endswith("reset"), "a start tries the device and says that it still fails"
    assert answer.success or "the output is still at" in answer.message
    until(lambda: plant.part.failure and f"the output is still at {left:.6g} V" in plant.part.failure)
    capfd.readouterr()
    plant.leaving = True
    plant.release()
    assert f"the output is still at {left:.6g} V" in capfd.readouterr().err and amplifier.open_value == left
