# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold over ROS: the service, the command, pulses of the trigger input, in lockstep bit for bit as offline."""

from __future__ import annotations

import re
import signal

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import until, write_axis  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.axis import Axis  # noqa: E402
from hysteresis_ros.loop.parameters import AxisParameters  # noqa: E402
from hysteresis_ros.loop.watch import QUIET  # noqa: E402


def creeping_axis() -> AxisParameters:
    """Return the measured stage at rest after a step of 20 um, in lockstep, without an end."""
    configuration = load_configuration("picma_stage").override("", time_mode="lockstep")
    configuration = configuration.override("reference_generator", waveform__type="hold", initial_setpoint=20e-6)
    configuration = configuration.override("plant_simulator", sensor__noise=3e-9)
    configuration = configuration.override("motion_controller", quiet__on_trigger=0.25)
    return AxisParameters.from_configuration(configuration)


def test_requests_and_pulses_between_nodes_are_repeated_bit_for_bit(processes, observer, tmp_path):
    from rcl_interfaces.srv import SetParametersAtomically
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Empty

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.files import load_run

    def ask(**values):
        given = [
            Parameter(name, Parameter.Type.DOUBLE if isinstance(value, float) else Parameter.Type.STRING, value)
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in given])
        result = observer.call(SetParametersAtomically, "/motion_controller/quiet", request).result
        return result.successful, result.reason

    def mode() -> int:
        return round(heard[-1].position[heard[-1].name.index("mode")])

    heard = observer.listen(JointState, "/motion_controller/state")
    pulse = observer.talk(Empty, "/trigger_in")
    axis = creeping_axis()
    run = processes.command(
        "up", write_axis(tmp_path / "axis.yaml", axis), "--composed", "--record", str(tmp_path / "bag")
    )
    until(lambda: len(heard) > 400 or run.popen.poll() is not None, what="two seconds of the axis")
    # the tolerance is compared with the creep that the compensator's model has in this state
    success, reason = ask(duration=30.0, tolerance=1e-9)
    assert not success and "allowed now: at most" in reason and "30 % of the predicted creep" in reason
    for wrong in ({"tolerance": 1e-9}, {"duration": "2 s"}, {"duration": 1.0, "time": 1.0}):
        assert not ask(**wrong)[0]
    refused = processes.command("quiet", "30s", "--tolerance", "1nm")
    assert refused.wait() == 2 and "allowed now: at most" in refused.output
    assert not any(round(one.position[one.name.index("mode")]) == QUIET for one in heard)
    # more simulated time than the request needs
    success, reason = ask(duration=5.0, tolerance=1e-6)
    assert success and "predicted drift" in reason, reason
    until(lambda: mode() == QUIET, what="the quiet hold")
    until(lambda: mode() != QUIET, what="its end")
    until(lambda: pulse.get_subscription_count(), what="the trigger input")
    pulse.publish(Empty())
    until(lambda: mode() == QUIET, what="the quiet hold of the pulse")
    until(lambda: mode() != QUIET, what="its end")
    last = len(heard)
    until(lambda: len(heard) > last + 100, what="samples after the last hold")
    assert run.leave(signal.SIGINT)[0] == 0, run.output
    recorded = load_run(tmp_path / "bag", further=True)
    assert [change["parameters"] for change in recorded.metadata["changes"]] == [{"duration": 5.0}, {"duration": 0.25}]
    assert differences(recorded, axis) == {}
    assert np.count_nonzero(recorded["controller_mode"] == QUIET) == 1000 + 50
    # the controller follows the creep of the compensator, which is another node
    same = Axis(axis)
    same.run(recorded["setpoint"][: recorded.metadata["changes"][0]["sample"]])
    told = re.search(r"of the creep of ([\d.]+) nm", reason)
    assert told and float(told[1]) == pytest.approx(1e9 * same.forecast().creep(5.0), rel=0.01)
