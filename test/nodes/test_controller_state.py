# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Topics of a motion controller for tools of ros2_control; with stand-ins that have the fields of the real messages."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from builtin_interfaces.msg import Time  # noqa: E402
from nodes_support import axis_parameters  # noqa: E402
from rclpy.logging import LoggingSeverity, set_logger_level  # noqa: E402

import hysteresis_ros.nodes.motion_controller as module  # noqa: E402
from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.control.laws.pid import INTEGRAL  # noqa: E402
from hysteresis_ros.nodes.motion_controller import MISSING, message_types  # noqa: E402

#: Fields of control_msgs/SingleDOFState, and of control_msgs/PidState in Jazzy and later.
DOF = ("name", "reference", "feedback", "feedback_dot", "error", "error_dot", "time_step", "output")
PID = ("header", "timestep", "error", "error_dot", "p_error", "i_error", "d_error")
PID += ("p_term", "i_term", "d_term", "i_max", "i_min", "output")
LATER = ("header", "timestep", "error", "error_dot", "i_term", "p_gain", "i_gain", "d_gain", "output")


def message(name: str, fields: tuple[str, ...]):
    """Return a message class with exactly these fields, which have initial values."""

    def begin(self):
        for field in fields:
            setattr(self, field, SimpleNamespace(stamp=None) if field == "header" else 0.0)

    return type(name, (), {"__slots__": fields, "__init__": begin})


class Stamped:
    __slots__ = ("header", "dof_state")

    def __init__(self):
        self.header, self.dof_state = SimpleNamespace(stamp=None), message("SingleDOFState", DOF)()


def controller(inside, monkeypatch, pid_fields=PID, **overrides):
    """Return an active controller, and its published messages by topic."""
    told: dict[str, list] = {"~/controller_state": [], "~/pid_state": []}
    own = module.MotionControllerNode.publisher

    def publisher(self, kind, topic, *more, **options):
        if topic not in told:
            return own(self, kind, topic, *more, **options)
        copied = lambda sent: told[topic].append({name: getattr(sent, name) for name in kind.__slots__})  # noqa: E731
        return SimpleNamespace(publish=copied)

    monkeypatch.setattr(module.MotionControllerNode, "publisher", publisher)
    monkeypatch.setattr(module, "message_types", lambda: (Stamped, message("PidState", pid_fields)))
    axis = axis_parameters(sample_rate=200.0, time_mode="realtime", overrides={"motion_controller": overrides})
    return inside.add(module.MotionControllerNode, axis.motion_controller), told


def answer(node, sample: int, reference: float, measured: float, command: float = 0.0):
    node.sample = sample
    places = (signals.REFERENCE, signals.SEEN, signals.COMMAND)
    for place, value in zip(places, (reference, measured, command), strict=True):
        node.row[place] = value
    node.report(Time(sec=sample))


def test_a_pid_controller_shows_its_sample_and_what_it_is_made_of(inside, monkeypatch):
    gains = {"type": "pid", "pid__Kp": 0.001, "pid__Ki": 0.1, "controller_state_rate": 20.0}
    node, told = controller(inside, monkeypatch, **gains)
    node.controller.x[INTEGRAL] = 3e-7
    for sample in range(1, 42):  # at 200 Hz every tenth one is published
        answer(node, sample, 5e-6, 1e-6 + 1e-8 * sample, command=4e-6)
    states, pids = told["~/controller_state"], told["~/pid_state"]
    assert [sent["header"].stamp.sec for sent in pids][-1] == 41 and len(states) == len(pids) == 5
    last = states[-1]["dof_state"]
    assert (last.name, last.reference, last.output, last.time_step) == ("extender", 5e-6, 4e-6, 0.005)
    assert last.feedback == pytest.approx(1.41e-6) and last.error == pytest.approx(3.59e-6)
    assert last.feedback_dot == pytest.approx(2e-6) and last.error_dot == pytest.approx(-2e-6), "1e-8 m in 5 ms"
    pid = pids[-1]
    assert (pid["p_term"], pid["i_term"], pid["d_term"], pid["i_error"]) == (0.001, 0.1, 0.0, 3e-7)
    assert pid["p_error"] == pid["error"] == last.error and pid["d_error"] == pid["error_dot"] == last.error_dot
    assert pid["timestep"].nanosec == 5_000_000 and pid["output"] == 4e-6 and pid["i_max"] == math.inf


def test_fields_that_later_versions_have_renamed(inside, monkeypatch):
    node, told = controller(inside, monkeypatch, LATER, type="pid", pid__Kp=0.001, pid__Ki=0.1)
    node.controller.x[INTEGRAL] = 3e-7
    answer(node, 1, 5e-6, 1e-6)
    (pid,) = told["~/pid_state"]
    assert (pid["p_gain"], pid["i_gain"], pid["i_term"]) == (0.001, 0.1, 3e-7)


def test_other_controllers_have_no_pid_state_and_a_rate_of_zero_nothing_at_all(inside, monkeypatch):
    node, told = controller(inside, monkeypatch, type="open_loop")
    answer(node, 1, 5e-6, 1e-6)
    assert len(told["~/controller_state"]) == 1 and not told["~/pid_state"]
    node, told = controller(inside, monkeypatch, type="open_loop", controller_state_rate=0.0)
    answer(node, 1, 5e-6, 1e-6)
    assert not told["~/controller_state"]


def test_where_the_package_is_missing_a_line_says_how_to_get_it(inside, capfd):
    if message_types() is not None:
        pytest.skip("control_msgs is installed")
    axis = axis_parameters(overrides={"motion_controller": {"type": "open_loop"}})
    set_logger_level("motion_controller", LoggingSeverity.INFO)  # another graph of this process may have changed it
    inside.add(module.MotionControllerNode, axis.motion_controller)
    assert MISSING in capfd.readouterr().err
    assert "apt install ros-jazzy-control-msgs" in MISSING
