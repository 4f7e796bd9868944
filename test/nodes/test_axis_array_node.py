# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Many axes in one node: one message for all, recorded, and the bits of the same axes offline."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import until  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String  # noqa: E402

from hysteresis_ros.configuration import load_configuration, parse_configuration  # noqa: E402
from hysteresis_ros.loop.axis_array import ArrayNodeParameters, AxisArray, parameters_of_each  # noqa: E402
from hysteresis_ros.loop.parameters import AxisParameters  # noqa: E402
from hysteresis_ros.models.actuator import PreloadParameters  # noqa: E402
from hysteresis_ros.nodes import axis_array, stage  # noqa: E402
from hysteresis_ros.nodes.axis_array import ArrayRunner, AxisArrayNode  # noqa: E402
from hysteresis_ros.nodes.base import ERROR, OK, WARN  # noqa: E402

AXES, RATE = 12, 200.0


def axis_of(**common) -> AxisParameters:
    """Return an axis that rests: like kim2009, without its resonance, at a rate that a busy machine holds."""
    configuration = load_configuration("kim2009").override("", sample_rate=RATE, **common)
    configuration = configuration.override("reference_generator", waveform__type="hold")
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    return AxisParameters.from_configuration(
        configuration.override("motion_controller", model__dynamics__sample_time=0.0)
    )


def each_of() -> dict[str, np.ndarray]:
    """Return values that differ between the axes."""
    return {"plant_simulator.sensor.offset": np.linspace(-2e-8, 3e-8, AXES)}


def setpoints_of(*values: float, label: str = "") -> Float64MultiArray:
    message = Float64MultiArray(data=list(values))
    if label:
        message.layout.dim = [MultiArrayDimension(label=label, size=len(values))]
    return message


def messages_of(bag, topic: str) -> list[tuple]:
    """Return the times [ns] and the messages of a topic, as any tool for bags reads them."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        chosen = [one for one in reader.connections if one.topic == f"/{topic}"]
        return [(time, reader.deserialize(data, one.msgtype)) for one, time, data in reader.messages(chosen)]


def assert_repeated(bag, axis: AxisParameters, each, count: int) -> dict[str, np.ndarray]:
    """Compare a bag with the same axes offline, bit for bit; return its signals, shape (axes, samples)."""
    joints, voltages, setpoints = (messages_of(bag, topic) for topic in ("joint_states", "voltages", "setpoints"))
    joints = [message for _, message in joints]
    stamps = np.array([one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in joints])
    assert np.all(np.diff(stamps) > 0)
    found = {
        "measured": np.array([one.position for one in joints]).T,
        "voltage": np.array([message.data for _, message in voltages]).T,
    }
    # the setpoints of a sample are the last ones that were recorded up to its stamp
    given = np.array([message.data for _, message in setpoints])
    place = np.searchsorted(np.array([time for time, _ in setpoints]), stamps, "right") - 1
    run = AxisArray(parameters_of_each(axis, count, each)).run(given[place].T, signals=("measured", "voltage"))
    for name, values in found.items():
        np.testing.assert_array_equal(values, run[name], err_msg=name)
    velocities = np.array([one.velocity for one in joints]).T
    np.testing.assert_array_equal(velocities[:, 1:], np.diff(found["measured"]) * RATE)
    return found | {"setpoints": given[place].T}


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_setpoints_of_all_or_some_axes_move_them_and_the_run_is_that_of_the_array_offline(
    inside, observer, tmp_path, mode
):
    axis, bag = axis_of(), tmp_path / "bag"
    np.savez(tmp_path / "each.npz", **each_of())
    given = {"axes": AXES, "each": str(tmp_path / "each.npz"), "path": str(bag), "time_mode": mode, "sample_rate": RATE}
    samples = observer.listen(JointState, "/joint_states")
    voltages = observer.listen(Float64MultiArray, "/voltages")
    refused = observer.listen(String, "/axis_array/refused")
    sender = observer.talk(Float64MultiArray, "/setpoints")
    node = inside.add(partial(AxisArrayNode, axis, "text"), ArrayNodeParameters.from_mapping(given))
    inside.spin()
    until(
        lambda: len(samples) > 5 and sender.get_subscription_count() and node.count_subscribers("/axis_array/refused")
    )
    assert samples[-1].name[:2] == ["extender_00", "extender_01"] and len(samples[-1].position) == AXES
    assert voltages[-1].layout.dim[0].size == len(voltages[-1].data) == AXES
    assert observer.trigger("/axis_array/stop").success  # otherwise it computes very many samples in lockstep
    for wrong, words in (
        (setpoints_of(1e-6, 2e-6), "2 numbers for 12 axes"),
        (setpoints_of(1e-6, 2e-6, label="3, 12"), "label '3, 12' is not a list of different axes 0 … 11"),
        (setpoints_of(1e-6, 2e-6, label="3, 3"), "is not a list of different axes"),
        (setpoints_of(1e-6, 1.0, label="3,5"), "axis 5: setpoint 1e+06 µm is out of range, allowed: 0 … 12 µm"),
        (setpoints_of(math.nan), "axis 0: setpoint nan µm"),
    ):
        known = len(refused)
        sender.publish(wrong)
        until(lambda known=known: len(refused) > known, what="a refusal")
        assert words in refused[-1].data and refused[-1].data.endswith("all setpoints are kept")

    def at(places) -> bool:
        return bool(np.all(np.abs(np.array(samples[-1].position) - places) < 5e-8))

    wanted = np.linspace(2e-6, 8e-6, AXES)
    sender.publish(setpoints_of(*wanted))
    assert observer.trigger("/axis_array/start").success
    until(lambda: at(wanted + 0.0), what="axes at their setpoints")
    sender.publish(setpoints_of(9e-6, 1e-6, label="7, 0"))
    wanted[[7, 0]] = 9e-6, 1e-6
    until(lambda: at(wanted), what="two axes at other setpoints")
    assert observer.trigger("/axis_array/stop").success
    until(lambda: not node.running)
    there = node.sample
    sender.publish(setpoints_of(3e-6))
    assert observer.trigger("/axis_array/start").success
    until(lambda: node.sample > there and at(3e-6), what="axes that go on")
    assert observer.transition("/axis_array", "deactivate") and observer.transition("/axis_array", "cleanup")
    found = assert_repeated(bag, axis, each_of(), AXES)
    assert len(np.unique(found["setpoints"], axis=1).T) == 4, "configured, all, two, one for all"
    assert messages_of(bag, "configuration")[0][1].data == "text"


def test_the_executable_runs_a_number_of_samples_and_exits(processes, tmp_path):
    axis, path, bag = axis_of(time_mode="lockstep"), tmp_path / "axis.yaml", tmp_path / "bag"
    path.write_text(axis.configuration_text(), encoding="utf-8")
    command = [sys.executable, "-m", "hysteresis_ros.nodes.axis_array", "--ros-args", "--params-file", str(path)]
    values = {
        "axes": 3,
        "samples": 150,
        "exit_at_end": "true",
        "path": bag,
        "time_mode": "lockstep",
        "sample_rate": RATE,
    }
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    run = processes.start([*command, *words], "array")
    assert run.wait() == 0, run.output
    assert "150 samples of 3 axes, 0 of them late" in run.output
    assert assert_repeated(bag, axis, {}, 3)["measured"].shape == (3, 150)
    # the text of the file is in the bag
    stored = messages_of(bag, "configuration")[0][1].data
    assert AxisParameters.from_configuration(parse_configuration(stored, "bag")) == axis


def answer(observer, gain: float):
    """Let an observer answer each sample with setpoints that depend on its measurements; return what it has sent."""
    sender = observer.talk(Float64MultiArray, "/setpoints")
    sent: list = []

    def reply(message: JointState) -> None:
        sent.append(4e-6 + gain * np.array(message.position))
        sender.publish(Float64MultiArray(data=sent[-1].tolist()))

    kept = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    observer.node.create_subscription(JointState, "/joint_states", reply, kept)
    return sent


def test_each_sample_waits_for_its_setpoints_when_asked_to(inside, observer, tmp_path):
    axis, bag = axis_of(), tmp_path / "bag"
    given = {"axes": 3, "samples": 80, "time_mode": "lockstep", "sample_rate": RATE, "path": str(bag)}
    given |= {"wait_for_setpoints": True, "partner_timeout": 30.0}
    node = inside.add(partial(AxisArrayNode, axis), ArrayNodeParameters.from_mapping(given))
    sent = answer(observer, -0.2)
    inside.spin()
    until(lambda: node.end_of_run == 80 or node.failure, what="the end of the run")
    assert not node.failure
    assert observer.transition("/axis_array", "deactivate") and observer.transition("/axis_array", "cleanup")
    found = assert_repeated(bag, axis, {}, 3)
    # sample k + 1 has the setpoints that the source computed from sample k
    np.testing.assert_array_equal(found["setpoints"][:, 1:], 4e-6 - 0.2 * found["measured"][:, :-1])
    assert len(sent) >= 79


def test_a_source_that_stops_answering_ends_the_run_with_an_error(inside, observer):
    given = {"axes": 3, "time_mode": "lockstep", "sample_rate": RATE}
    given |= {"wait_for_setpoints": True, "partner_timeout": 0.5}
    node = inside.add(partial(AxisArrayNode, axis_of()), ArrayNodeParameters.from_mapping(given))
    observer.listen(JointState, "/joint_states")
    observer.talk(Float64MultiArray, "/setpoints")
    inside.spin()
    until(lambda: node.failure, what="the failure")
    assert "no setpoints after sample 0 for 0.5 s (partner_timeout): start their publisher" in node.failure


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"axes": 5000}, "axes = 5000: "),
        ({"wait_for_setpoints": True}, "wait_for_setpoints = True: needs time_mode: lockstep, not realtime"),
        ({"time_mode": "fused"}, "time_mode = 'fused': must be lockstep or realtime"),
        ({"sample_rate": 100.0}, "sample_rate = 100.0 Hz: must equal that of plant_simulator, 200 Hz"),
        ({"each": "there/is/none.npz"}, "each = 'there/is/none.npz': cannot be read"),
        ({"each": "uneven"}, "each: number of values of plant_simulator.sensor.offset = 12: give one value for each"),
    ],
)
def test_what_does_not_fit_is_refused(inside, tmp_path, capfd, values, words):
    np.savez(tmp_path / "each.npz", **each_of())
    if values.get("each") == "uneven":
        values = {"each": str(tmp_path / "each.npz")}
    from rclpy.parameter import Parameter

    given = {"axes": 3, "sample_rate": RATE} | values
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    node = AxisArrayNode(axis_of(), context=inside.context, parameter_overrides=overrides)
    inside.executor.add_node(node)
    inside.nodes.append(node)
    assert not node.configure_now() and node.exit_code == 2
    assert words in node.failure


def test_a_reset_begins_again_at_rest_with_the_configured_setpoints_and_is_recorded(inside, tmp_path):
    """Samples are computed here, one by one, without a thread and without other nodes."""
    axis, bag = axis_of(), tmp_path / "bag"
    axis = replace(axis, plant_simulator=replace(axis.plant_simulator, preload=PreloadParameters(force=2.0)))
    given = {"axes": 3, "time_mode": "lockstep", "sample_rate": RATE, "path": str(bag)}
    node = inside.add(partial(AxisArrayNode, axis, "text"), ArrayNodeParameters.from_mapping(given), autostart=False)
    assert node.configure_now()
    assert list(node._joints.effort) == [2.0] * 3, "the force of the preload [N]"

    def computed(count: int) -> np.ndarray:
        found = []
        for _ in range(count):
            node.compute_sample()
            found.append(node.array["measured"])
        return np.array(found)

    first = computed(10)
    node._on_setpoints(setpoints_of(3e-6))
    moved = computed(10)
    assert np.all(np.abs(moved[-1] - first[-1]) > 1e-6) and node.sample == 20
    node.reset_blocks()
    assert node.sample == 0
    np.testing.assert_array_equal(computed(10), first)
    node.unbuild()
    # in lockstep the array is the source of time, which begins again at 0, and bags are read by time
    kept = [(time, list(message.data)) for time, message in messages_of(bag, "setpoints")]
    rest = list(AxisArray(parameters_of_each(axis, 3)).initial_setpoints)
    assert kept == [(0, rest), (0, rest), (round(1e9 * 10 / RATE), [3e-6] * 3)]


def reported(tripped, late=0, refused=0, lost=""):
    """Return level and text of the health of an array in which these axes are stopped."""
    bag = SimpleNamespace(stopped=lost, bag=None) if lost else None
    node = SimpleNamespace(
        array={"tripped": np.array(tripped, dtype=float), "saturated": np.array([1.0, 0.0, 1.0])},
        parameters=SimpleNamespace(axes=3),
        late=late,
        refused=refused,
        recording=bag,
        has_lost=bool(lost),
        since_report=lambda name, value: value,
    )
    level, text, values = AxisArrayNode.health(node)
    assert values["saturated_axes"] == 2 and values["stopped_axes"] == np.count_nonzero(tripped)
    return level, text


def test_the_health_of_an_array_tells_the_worst_first():
    assert reported([0, 0, 0]) == (OK, "")
    assert reported([0, 0, 0], late=2) == (WARN, "2 samples late, 0 messages on setpoints refused")
    assert reported([0, 0, 0], refused=1) == (WARN, "0 samples late, 1 messages on setpoints refused")
    assert reported([0, 3, 1], late=2) == (ERROR, "2 axes are stopped (1, 2): call ~/reset")
    assert reported([0, 3, 1], lost="disk full") == (ERROR, "recording ended: disk full")


@pytest.mark.parametrize(("pause", "late", "shifts"), [(0.015, 0, 1), (0.055, 4, 1), (0.5, 1, 2)])
def test_late_samples_are_counted_and_a_schedule_far_behind_is_shifted(monkeypatch, pause, late, shifts):
    """A sample of 1 ms each 10 ms, and one that lasts longer: the following ones catch up, or all come later."""
    now, ran = [100.0], []
    monkeypatch.setattr("hysteresis_ros.nodes.axis_array.time.monotonic", lambda: now[0])

    def compute() -> None:
        ran.append(now[0])
        now[0] += pause if node.sample == 5 else 0.001
        node.sample += 1

    def wait(seconds: float) -> None:
        now[0] += seconds

    begun: list[int] = []
    node = SimpleNamespace(
        parameters=SimpleNamespace(samples=30, wait_for_setpoints=False, sample_rate=100.0),
        sample=0,
        running=True,
        lock=contextlib.nullcontext(),
        answered=threading.Event(),
        compute_sample=compute,
        stamps=SimpleNamespace(go_on=begun.append),
        late=0,
        finish=lambda: None,
    )
    runner = ArrayRunner.__new__(ArrayRunner)
    runner.node, runner.exact = node, False
    runner._leaving = SimpleNamespace(is_set=lambda: False, wait=wait)
    runner._run_samples()
    assert node.sample == 30, "no sample is dropped"
    assert node.late == late and len(begun) == shifts
    # without a shift the last samples are where they would have been
    assert ran[-1] == pytest.approx(100.29 if shifts == 1 else 100.05 + 0.5 + 0.23, abs=1e-9)


@pytest.mark.parametrize("module", [axis_array, stage])
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file"),
        (b"\xff", "is not a text in UTF-8"),
        (b"a: [", "not readable as YAML"),
        ("", "has no parameters"),
    ],
)
def test_a_file_of_parameters_that_cannot_be_read_is_one_line(module, content, said, tmp_path, capsys):
    path = tmp_path / "given.yaml"
    if content:
        path.write_bytes(content)
    assert module.main(["node", "--ros-args", *(() if content == "" else ("--params-file", str(path)))]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and said in line
