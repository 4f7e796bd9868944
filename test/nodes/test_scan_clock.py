# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The clock of a scan as a topic: message by message, in blocks of a fused loop, in the bag, and at a device."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import SOON_AT_REST, axis_parameters, compose, until  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver  # noqa: E402
from hysteresis_ros.hardware.registry import DRIVERS  # noqa: E402
from hysteresis_ros.loop.stage_parameters import StageParameters  # noqa: E402
from hysteresis_ros.loop.stage_simulation import with_scan  # noqa: E402
from hysteresis_ros.models.block import COMPILED  # noqa: E402
from hysteresis_ros.nodes.scan_clock import AWAITED, NAMES, ScanClockTopic  # noqa: E402
from hysteresis_ros.references.scan import frame_marks, line_marks, pixel_marks  # noqa: E402
from hysteresis_ros.references.scan_clock import ScanClock  # noqa: E402
from hysteresis_ros.references.scans import parsed_scan  # noqa: E402

#: Lines and pixels begin at samples and between them; a period of 400 samples at 10 kHz.
RASTER = ("width=2um", "depth=1um", "lines=3", "pixels=6", "flyback=1", "frame_rate=25Hz", "turn=0.3")
STEP, PERIOD = 1e-4, 400


def marks_of(count: np.ndarray, scan, level: str = "pixel", periods: int = 0) -> list[tuple]:
    """Return what begins, as (sample, frame, line, pixel, direction, delay), for the waveform's sample of each sample.

    By the functions of the path for recordings, for each piece in which the waveform runs.
    """
    found = []
    runs = np.flatnonzero(count >= 0)
    for piece in np.split(runs, np.flatnonzero((np.diff(runs) != 1) | (np.diff(count[runs]) != 1)) + 1):
        if not piece.size:
            continue
        time = np.arange(count[piece[-1]] + 1) * STEP
        rows = []
        for rank, of in enumerate(
            (frame_marks, line_marks, pixel_marks)[: ("frame", "line", "pixel").index(level) + 1]
        ):
            marks = of(scan, time)
            for k in range(marks.sample.size):
                inside = count[piece[0]] <= marks.sample[k] <= count[piece[-1]]
                if inside and not (periods and marks.sample[k] >= periods * PERIOD):
                    numbers = marks.frame[k], marks.line[k], marks.pixel[k], marks.direction[k]
                    delay = max(marks.sample[k] - marks.place[k], 0.0) * STEP
                    sample = piece[0] + marks.sample[k] - count[piece[0]]
                    rows.append((round(marks.place[k], 6), rank, sample, *numbers, delay))
        found += [row[2:] for row in sorted(rows)]
    return found


def assert_marks(heard: list[tuple], wanted: list[tuple]) -> None:
    assert [row[:5] for row in heard] == [row[:5] for row in wanted]
    np.testing.assert_allclose([row[5] for row in heard], [row[5] for row in wanted], atol=1e-9)


class Heard:
    """Stands in for a node: keeps what the topic publishes."""

    def __init__(self, axes: int, level: str = "pixel", periods: int = 0):
        self.rows: list[tuple] = []
        self.runner = SimpleNamespace(keeps=False)
        self.topic = ScanClockTopic(self, "scan_clock", axes)
        self.topic.follow(ScanClock(parsed_scan("raster", RASTER), STEP, level, periods))

    def publisher(self, message_type, topic, qos):
        return SimpleNamespace(topic_name=f"/{topic}", publish=self.keep)

    def keep(self, message: JointState) -> None:
        assert tuple(message.name) == NAMES
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        frame, line, pixel, direction, delay = message.position
        self.rows.append((stamp // 100_000, *map(int, (frame, line, pixel, direction)), delay))


def counted() -> np.ndarray:
    """Return the waveform's samples of a run that is stopped, begun again, held by a trip, and reset."""
    pieces = np.arange(500), np.full(30, -1), np.arange(250), np.full(5, -1), np.arange(250, 900), np.arange(700)
    return np.concatenate(pieces)


@pytest.mark.parametrize("level", ["frame", "line", "pixel"])
def test_messages_and_blocks_tell_the_same_as_the_path(level):
    scan, count = parsed_scan("raster", RASTER), counted()
    wanted = marks_of(count, scan, level, periods=2)
    assert len(wanted) > {"frame": 4, "line": 20, "pixel": 100}[level]
    by_message, by_block = Heard(2, level, 2), Heard(2, level, 2)
    recorded: list = []
    by_block.topic.record = lambda stamp, values: recorded.append((stamp, values))
    for k, sample in enumerate(count.tolist()):
        for axis in (0, 1) if k % 3 else (1, 0):
            by_message.topic.take(k * 100_000, float(sample), axis)
    assert_marks(by_message.rows, wanted)
    table = np.full((signals.ACTUATOR_ROW, count.size), math.nan)
    table[signals.WAVEFORM_SAMPLE] = count
    ends = [0, 1, 17, 480, 531, 532, 1400, count.size]
    for begin, end in zip(ends[:-1], ends[1:], strict=True):
        for axis in (1, 0):
            by_block.topic.take_all(begin, table[:, begin:end], lambda numbers: numbers * 100_000, axis)
    assert_marks(by_block.rows, wanted)
    assert [stamp // 100_000 for stamp, _ in recorded] == [row[0] for row in wanted]


def test_axes_that_are_not_at_the_same_sample_have_no_clock():
    """One of them was stopped alone, so what the stage follows is not the scan."""
    by_message, by_block = Heard(2), Heard(2)
    count = np.arange(1000)
    other = np.where(count < 300, count, count - 200)
    table = np.full((2, signals.ACTUATOR_ROW, 1000), math.nan)
    table[:, signals.WAVEFORM_SAMPLE] = count, other
    for k in range(1000):
        by_message.topic.take(k * 100_000, float(count[k]), 0)
        by_message.topic.take(k * 100_000, float(other[k]), 1)
    for axis in (0, 1):
        by_block.topic.take_all(0, table[axis], lambda numbers: numbers * 100_000, axis)
    wanted = marks_of(count[:300], parsed_scan("raster", RASTER))
    assert_marks(by_message.rows, wanted)
    assert_marks(by_block.rows, wanted)
    # an axis whose samples are missing is not awaited for ever
    for k in range(2000, 2000 + 3 * AWAITED):
        by_message.topic.take(k * 100_000, float(k), 0)
    assert len(by_message.topic._waiting) <= AWAITED


def scanning(mode: str, periods: int, samples: int, nodes: dict | None = None, **overrides) -> StageParameters:
    """Return xy_scanner that follows the raster with its clock at the level of pixels."""
    configuration = with_scan(load_configuration("xy_scanner"), "raster", RASTER).override("", time_mode=mode)
    configuration = configuration.override("stage", scan__clock="pixel", scan__periods=periods)
    configuration = configuration.override("plant_simulator", late_limit=-1, **overrides)
    for node, values in (nodes or {}).items():
        configuration = configuration.override(node, **values)
    found = StageParameters.from_configuration(configuration)
    return found.with_duration(samples * STEP) if samples else found


def rows_of(messages, stamp_of_zero: int) -> list[tuple]:
    """Return messages in the form of :func:`marks_of`."""
    found = Heard(1)
    for message in messages:
        found.keep(message)
    return [(stamp - stamp_of_zero // 100_000, *numbers) for stamp, *numbers in found.rows]


@pytest.mark.parametrize("mode", ["lockstep", "fused"])
def test_the_clock_of_a_stage_is_on_its_topic_and_in_the_bag(processes, observer, tmp_path, mode):
    from rclpy.serialization import deserialize_message
    from std_msgs.msg import Bool

    from hysteresis_ros.loop.stage_simulation import stage_differences
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.files import load_run

    if mode == "fused" and not COMPILED:
        pytest.skip("without Numba the loop is too slow for a stage")
    fused = mode == "fused"
    waiting = {
        "y/reference_generator": {"autostart": False},
        "plant_simulator": {"wait_for_recorder": True},
        "recorder": {"path": str(tmp_path / "bag"), "configuration": str(tmp_path / "stage.yaml")},
        "": {"exit_at_end": True},
    }
    waiting = {} if fused else waiting
    parameters = scanning(mode, 0 if fused else 2, 0 if fused else 1100, waiting)
    path = tmp_path / "stage.yaml"
    path.write_text(parameters.configuration_text(), encoding="utf-8")
    heard, estop = observer.listen(JointState, "/scan_clock"), observer.talk(Bool, "/y/estop")
    if fused:
        run = processes.command("up", str(path), "--factor", "0.05", "--record", str(tmp_path / "bag"), "--verify")
        until(lambda: len(heard) > 20 and estop.get_subscription_count(), what="a scan")
        estop.publish(Bool(data=True))
        states = observer.listen(JointState, "/x/joint_states")
        until(lambda: states and states[-1].header.frame_id, what="a stage that is stopped")
        before = len(heard)
        assert observer.trigger("/x/plant_simulator/start").success
        until(lambda: len(heard) > before + 20, what="a scan that has begun again")
        assert run.leave()[0] == 0, run.output
    else:  # the run begins when the listener is there, with the node that the test starts
        words = "-m", "hysteresis_ros.nodes.stage", "--recorder", "--ros-args", "--params-file", str(path)
        stage = processes.start([sys.executable, *words], "stage")
        until(lambda: observer.node.count_publishers("/scan_clock"), what="the topic of the clock")
        (listening,) = (one for one in observer.node.subscriptions if one.topic_name == "/scan_clock")
        until(listening.get_publisher_count, what="a listener at the clock")
        assert not heard
        for step in ("configure", "activate"):
            assert observer.transition("/y/reference_generator", step)
        assert stage.wait() == 0, stage.output
    found = load_run(tmp_path / "bag", further=True)
    if fused:
        assert "equal the offline twin bit for bit, none missing" in run.output
    else:
        assert found.metadata["missing_samples"] == 0 and stage_differences(found, parameters) == {}
    x, y = (found[f"{name}/waveform_sample"] for name in "xy")
    count = np.where(x == y, x, -1.0).astype(int)
    wanted = marks_of(count, parameters.scan, periods=0 if fused else 2)
    assert len(wanted) > 40
    if fused:
        begins = np.flatnonzero(count == 0)
        assert begins.size == 2, "the scan began again"
    else:
        assert count[-1] == 1099 and PERIOD < wanted[-1][0] < 2 * PERIOD, "behind its end it has no clock"
    stored = read_bag(tmp_path / "bag").topics
    first = deserialize_message(stored["/x/joint_states"].data[0], JointState).header.stamp
    zero = first.sec * 10**9 + first.nanosec
    kept = [deserialize_message(data, JointState) for data in stored["/scan_clock"].data]
    assert_marks(rows_of(kept, zero), wanted)
    # a listener gets the same, from the first message that it hears
    told = rows_of(heard, zero)
    begun = [sample for sample, *_ in wanted]
    assert len(told) > 40 and told[0][0] in begun
    assert fused or len(told) == len(wanted)
    start = begun.index(told[0][0])
    assert_marks(told, wanted[start : start + len(told)])


class Outputs(SimulatedDriver):
    """The simulated actuator with three digital outputs."""

    def open(self, parameters, sample_rate):
        self.edges: list = []
        Outputs.last = self
        return replace(super().open(parameters, sample_rate), clock=True)

    def output_clock(self, edges):
        self.edges.append(edges)


def test_an_axis_tells_its_clock_to_its_device_message_by_message(inside, observer, monkeypatch):
    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Outputs))
    waveform = {"type": "scan", "scan__kind": "raster", "scan__clock": "line", "cycles": 1}
    waveform["scan__values"] = ("width=2um", "depth=1um", "lines=3", "flyback=1", "frame_rate=0.5Hz")
    overrides = {
        **SOON_AT_REST,
        "plant_simulator": {"late_limit": -1, "driver": "simulated", "scan_clock": True},
        "reference_generator": {"initial_setpoint": 5e-6, **{f"waveform__{k}": v for k, v in waveform.items()}},
    }
    given = axis_parameters("", overrides, sample_rate=50.0, time_mode="realtime")
    compose(inside, given)
    heard = observer.listen(JointState, "/scan_clock")
    inside.spin()
    wanted = [signals.Edge.FRAME] + [signals.Edge.LINE] * 6
    until(lambda: len(Outputs.last.edges) >= len(wanted), what="the clock at the device")
    assert Outputs.last.edges[: len(wanted)] == wanted
    assert {message.position[2] for message in heard} == {-1.0}
