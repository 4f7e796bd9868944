# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A controller with saturated commands reports this in its diagnostics, and stops reporting it afterwards."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import Driver, axis_parameters, diagnostics, until  # noqa: E402

PID = {"type": "pid", "pid__Kp": 0.1, "pid__Ki": 20.0, "model__dynamics__A": [], "model__dynamics__B": []}


@pytest.mark.parametrize("changes", [{"type": "open_loop"}, PID | {"model__dynamics__C": []}])
def test_commands_that_are_not_carried_out_are_reported(inside, observer, changes):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64

    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode

    axis = axis_parameters(
        overrides={"motion_controller": changes, "hysteresis_compensator": {"limits__maximum": 50.0}}, sample_rate=200.0
    )
    node = inside.add(MotionControllerNode, axis.motion_controller)
    inside.add(HysteresisCompensatorNode, axis.hysteresis_compensator)
    inside.spin()
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    commands = observer.listen(Float64, "/command")
    applied = observer.listen(Float64, "/applied")
    reference = observer.talk(Float64, "/reference")
    driver = Driver(observer)

    def said():
        return (diagnostics(reports, "/motion_controller") or (0, "", {}))[1]

    def send(wanted):
        reference.publish(Float64(data=wanted))
        driver.send(applied[-1].data if applied else 0.0)

    until(lambda: (send(11.0e-6), "command saturated" in said())[1], what="saturation to be reported")
    words = said().split()
    wanted, carried_out = float(words[3]), float(words[6])
    assert wanted > carried_out > 4.0 and carried_out < 6.0, said()
    assert diagnostics(reports, "/motion_controller")[0] == 1
    assert int(diagnostics(reports, "/motion_controller")[2]["saturated_commands"]) > 0
    until(lambda: (send(2.0e-6), commands[-1].data < 4.0e-6)[1], what="the command to come back")
    until(lambda: (send(2.0e-6), "saturated" not in said())[1], what="the report to end")
    assert node.shortfall.count > 0


def test_an_answer_to_an_earlier_command_is_no_shortfall_and_a_cut_one_is():
    from hysteresis_ros.nodes.motion_controller import LATENESS, Shortfall

    shortfall = Shortfall()
    for k in range(LATENESS):
        shortfall.sent(1e-6 * k)
        shortfall.carried_out(1e-6 * max(k - 3, 0))
    assert shortfall.count == 0 and not shortfall.report()
    shortfall.carried_out(25e-6)
    assert shortfall.count == 1 and "commanded 19 µm, achieved 25 µm" in shortfall.report()
    assert not shortfall.report()
