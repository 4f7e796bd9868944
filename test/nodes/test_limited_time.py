# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plant and compensator report for a minute, before other messages, how long their output was limited and by what."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, write_axis  # noqa: E402

from hysteresis_ros.nodes.base import diagnostics  # noqa: E402
from hysteresis_ros.nodes.timing import AMPLIFIER, LimitedTime, limited_in_all  # noqa: E402
from hysteresis_ros.signals import COMMAND, PLANT_VOLTAGE, VOLTAGE  # noqa: E402

RATE = 100.0
SAFE = "safe_slew_rate"


def counted(range_=0, safe=0):
    return {AMPLIFIER: range_, SAFE: safe}


def test_what_was_limited_is_said_for_a_minute_and_forgotten_then():
    limited = LimitedTime()
    assert limited.report(counted(), RATE, 0.0) == ""
    assert limited.report(counted(10, 0), RATE, 1.0) == "", "a moment is not reported"
    said = limited.report(counted(11, 300), RATE, 10.0)
    assert said == f"output limited for 3.11 s of the last 10 s, by {SAFE} and {AMPLIFIER}"
    for now in range(11, 60):
        assert limited.report(counted(11, 300), RATE, float(now)).startswith("output limited for 3.11 s of the last ")
    assert limited.report(
        counted(11, 300), RATE, 60.0
    ) == f"output limited for 3.11 s of the last 60 s, by {SAFE} and " + (AMPLIFIER)
    assert limited.report(counted(11, 300), RATE, 62.0).startswith("output limited for 3.01 s of the last 61 s")
    assert limited.report(counted(11, 300), RATE, 71.0) == ""


def test_counters_that_were_reset_count_from_zero():
    limited = LimitedTime()
    assert limited.report(counted(900), RATE, 1.0) == f"output limited for 9 s, by {AMPLIFIER}"
    assert limited.report(counted(5), RATE, 2.0) == ""
    assert limited.report(counted(30), RATE, 3.0) == f"output limited for 0.3 s of the last 1 s, by {AMPLIFIER}"


def assert_on_the_page(node, beginning):
    """Require that the status of a page has the message of a node, which is the headline of the page."""
    pytest.importorskip("aiohttp", reason="aiohttp is not installed: no page")
    from pretended_axis import Pretended

    from hysteresis_ros.laboratory.watch.access import Access
    from hysteresis_ros.laboratory.watch.link import AxisLink
    from hysteresis_ros.laboratory.watch.server import Server

    link = Pretended()
    AxisLink._on_health(link, diagnostics(node))
    (said,) = Server(link, Access("127.0.0.1", "")).status()["health"]
    assert (said["node"], said["level"]) == (node.get_name(), "warning")
    assert said["message"].startswith(beginning) and said["message"].endswith(AMPLIFIER)


def test_plant_and_compensator_count_what_they_hold_back(inside):
    overrides = {
        "plant_simulator": {"safe_slew_rate": 20.0, "voltage_timeout": 0.02, "late_limit": -1},
        "hysteresis_compensator": {"limits__maximum": 50.0},
    }
    plant, compensator, *_ = compose(inside, axis_parameters("", overrides, sample_rate=RATE, time_mode="lockstep"))

    def sample(voltage):
        plant.sense()
        plant.inputs[0].value = voltage
        plant.finish_sample()

    for _ in range(30):
        sample(10.0)
    assert plant.held_back == 0, "the output equals the request"
    for _ in range(120):
        sample(float("nan"))
    assert plant.held_back == 0 and plant.row[PLANT_VOLTAGE] == 0.0, "at its safe voltage, without input"
    for _ in range(80):
        sample(10.0)
    # 10 V at 20 V/s with samples of 10 ms: the last of fifty samples reaches it
    assert plant.held_back == 49
    level, words, values = plant.health()
    assert level == 1 and words == f"output limited for 0.49 s, by {SAFE}" and values["held_back_samples"] == 49
    assert compensator.health()[1] != f"output limited for 0.4 s, by {AMPLIFIER}"
    compensator.sample = 1
    for _ in range(40):
        compensator.row[COMMAND] = 11e-6
        compensator.step()
    assert compensator.row[VOLTAGE] == 50.0
    cut = compensator.compensator.limits.limited_samples
    assert cut >= 39
    level, words, _ = compensator.health()
    assert level == 1 and words.startswith(f"output limited for {cut / RATE:.3g} s") and words.endswith(AMPLIFIER)
    assert_on_the_page(compensator, f"output limited for {cut / RATE:.3g} s")
    plant.part.halt()
    for _ in range(20):
        sample(10.0)
    assert plant.held_back == 49 and plant.health()[1].startswith("axis stopped"), "a stop is reported as a stop"
    assert plant.reset_blocks() is None and plant.held_back == 0 and plant.health()[1] != words


def test_status_says_it_first():
    from hysteresis_ros.nodes.remote.commands import AxisStatus, NodeStatus, _lines

    said = f"output limited for 12.3 s of the last 60 s, by {SAFE}"
    nodes = [
        NodeStatus("/left/plant_simulator", "active", "ok", "", RATE),
        NodeStatus("/left/hysteresis_compensator", "active", "warning", said, RATE),
    ]
    lines = list(_lines(AxisStatus("/left", nodes)))
    assert lines[:2] == ["/left", f"  {said} of hysteresis_compensator"]
    assert lines[3].endswith("warning: output limited, see above")
    nodes[1].message = "voltage saturated"
    lines = list(_lines(AxisStatus("/left", nodes)))
    assert lines[1].split()[0] == "plant_simulator" and lines[2].endswith("warning: voltage saturated")
    lines = list(_lines(AxisStatus("/left", nodes, spin=(42.7, 12.6))))
    assert lines[1] == "  the loop polls the clock from 42.7 µs before each deadline: 13 % of a core"


def test_of_a_whole_run_more_than_a_moment_is_said():
    assert limited_in_all({AMPLIFIER: 20}, 1000, 200.0) == ""
    said = limited_in_all({"safe_slew_rate": 60, AMPLIFIER: 100}, 1000, 200.0)
    assert said.startswith(f"output limited for 0.8 s of 5 s, by {AMPLIFIER} and safe_slew_rate: ")


@pytest.mark.parametrize(
    ("how", "cut"), [("--processes", True), ("--composed", False), ("--fused", True), ("--fused", False)]
)
def test_a_run_that_nobody_recorded_says_at_its_end_that_it_was_cut(processes, tmp_path, how, cut):
    axis = axis_parameters(sample_rate=200.0, overrides={"plant_simulator": {"late_limit": -1}})
    path = write_axis(tmp_path / "axis.yaml", axis)
    slew = 100.0 if cut else 1e6  # a triangle of 10 Hz over about 60 V requires 1200 V/s
    overlay = tmp_path / "slew.yaml"
    overlay.write_text(  # in closed loop a triangle that needs a larger slew rate is refused
        f"/**/hysteresis_compensator:\n  ros__parameters: {{limits: {{slew_rate: {slew}}}}}\n"
        "/**/motion_controller:\n  ros__parameters: {type: open_loop}\n"
    )
    words = ["--reference", "triangle", "--frequency", "10", "--amplitude", "3e-6m", "--duration", "3"]
    up = processes.command("up", path, "--params-file", str(overlay), how, *words)
    assert up.wait(300.0) == 0, up.output  # with a fused axis kernels may be compiled first
    assert ("output limited for" in up.output and "the actuator did not receive" in up.output) == cut, up.output
