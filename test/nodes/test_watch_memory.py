# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page's memory of an axis: losses, errors against the delayed reference, and assembled samples."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from sensor_msgs.msg import JointState  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.laboratory.watch.access import (  # noqa: E402
    Access,  # noqa: E402
    RequestError,
    read_request,
)
from hysteresis_ros.laboratory.watch.memory import (  # noqa: E402
    PART_PATIENCE,
    PLANE_POINTS,
    PLANE_WINDOW,
    Collector,
    Memory,  # noqa: E402
    Plane,
)
from hysteresis_ros.nodes.samples import Block  # noqa: E402

NODES = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")


def block(first: int, **columns) -> Block:
    """Return samples from a number on with these known signals."""
    count = len(next(iter(columns.values())))
    table = np.zeros((len(signals.ACTUATOR.row), count))
    for name, values in columns.items():
        table[signals.place(name)] = values
    numbers = np.arange(first, first + count)
    return Block(numbers * 1_000_000, numbers, table, None)


def test_samples_that_never_came_are_counted_as_lost_and_are_no_error():
    memory = Memory(rate=1000.0)
    assert memory.add(block(0, measured=[1e-6] * 10))
    assert memory.add(block(13, measured=[1e-6] * 5, skipped=[0.0, 1.0, 0.0, 1.0, 0.0]))
    assert memory.lost == 3 and memory.skipped == 2
    error = memory.last("error", 1.0)
    assert error.size == 18 and np.isnan(error[10:13]).all() and np.isfinite(error[13:]).all()
    # a signal that only motors have
    assert memory.value(signals.SKIPPED) == 0.0 and np.isnan(memory.value(signals.MOTOR_ROW - 1))
    # numbers that restart belong to another run
    assert not memory.add(block(2, measured=[0.0]))
    assert memory.lost == 3
    # both counts are those of the whole run
    assert memory.add(block(20, measured=[1e-6] * 4, skipped=[1.0, 0.0, 0.0, 0.0])) and memory.add(
        block(24, measured=[0.0])
    )
    assert memory.lost == 5 and memory.skipped == 3
    memory.restart(1000.0)
    assert memory.lost == memory.skipped == 0


def test_the_error_is_the_root_of_its_mean_square_and_its_largest():
    memory = Memory(rate=1000.0)
    memory.add(block(0, measured=[3e-6, 0.0, 0.0, 0.0, -1e-6]))
    figures = memory.figures()
    assert figures["rms"] == pytest.approx(np.sqrt(10.0 / 5.0) * 1e-6) and figures["largest"] == pytest.approx(3e-6)


def test_the_spectrum_shows_an_error_at_its_frequency():
    memory = Memory(rate=1000.0)
    memory.add(block(0, measured=1e-9 * np.sin(2.0 * np.pi * 125.0 * np.arange(8000) / 1000.0)))
    found = memory.spectrum()
    assert found["frequency"][np.argmax(found["density"])] == pytest.approx(125.0, rel=0.03)


@pytest.mark.parametrize("cut", [1, 4, 9])
def test_under_a_preview_the_error_is_against_the_reference_of_so_many_samples_before(cut):
    """The stage follows the published reference three samples late, without any other error."""
    published = 1e-6 * np.arange(1.0, 11.0)
    measured = np.concatenate([np.zeros(3), published[:-3]])
    memory = Memory(rate=1000.0, preview=3)
    memory.add(block(0, reference=published[:cut], measured=measured[:cut]))
    memory.add(block(cut, reference=published[cut:], measured=measured[cut:]))
    error = memory.last("error", 1.0)
    assert np.isnan(error[:3]).all()
    np.testing.assert_allclose(error[3:], 0.0, atol=1e-18)


def said(number: int, stamp: int, node: str) -> JointState:
    names = list(signals.ACTUATOR.state(node))
    message = JointState(name=names, position=[float(number)] * len(names))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    return message


def test_a_sample_whose_part_never_comes_is_shown_without_it_once_others_are_younger():
    """A node that has exited must not delay the display of the others."""
    collector = Collector(signals.ACTUATOR)
    for number, stamp in enumerate((1_000, 2_000)):
        for node in NODES[:-1]:
            collector.add(node, said(number, stamp, node))
    assert collector.take().numbers.size == 0, "the missing part may still arrive"
    for node in NODES[:-1]:
        collector.add(node, said(2, 2_001 + PART_PATIENCE, node))
    found = collector.take()
    assert found.stamps.tolist() == [1_000, 2_000] and found.table[signals.MEASURED].tolist() == [0.0, 1.0]
    # a part that comes after its sample was shown does not show it again
    assert collector.take().numbers.size == 0
    collector.add(NODES[-1], said(0, 1_000, NODES[-1]))
    collector.add(NODES[0], said(3, 2_002 + 3 * PART_PATIENCE, NODES[0]))
    assert 1_000 not in collector.take().stamps
    assert np.isnan(found.table[signals.VOLTAGE]).all()


def test_a_time_that_begins_again_shows_nothing_of_the_run_before():
    """An incomplete sample of the earlier run is newer by its stamp than all samples of the new one."""
    collector, late = Collector(signals.ACTUATOR), 10 * PART_PATIENCE
    for node in NODES:
        collector.add(node, said(0, late, node))
    collector.add(NODES[0], said(1, late + 1_000, NODES[0]))
    assert collector.take().stamps.tolist() == [late]
    for node in NODES[:-1]:
        collector.add(node, said(5, 1_000, node))
    assert collector.take().numbers.size == 0, "the missing part may still arrive"
    collector.add(NODES[-1], said(5, 1_000, NODES[-1]))
    found = collector.take()
    assert found.stamps.tolist() == [1_000] and found.numbers.tolist() == [0]
    assert found.table[signals.MEASURED].tolist() == [5.0] == found.table[signals.VOLTAGE].tolist()


@pytest.mark.parametrize(
    "origin",
    ["http://127.0.0.1:8123.evil.example", "http://127.0.0.1:81234", "https://127.0.0.1:8123", "http://127.0.0.1"],
)
def test_an_origin_that_only_begins_like_the_page_is_another_page(origin):
    access = Access("127.0.0.1", "")
    assert "only the page of http://127.0.0.1:8123" in access.refuses_origin(
        {"Origin": origin, "Host": "127.0.0.1:8123"}
    )
    assert not access.refuses_origin({"Origin": "http://127.0.0.1:8123", "Host": "127.0.0.1:8123"})


def test_the_rate_is_that_of_the_samples_between_the_arrivals(monkeypatch):
    """Ten samples per hundredth of a second are 1000 per second; those of the first arrival are from before."""
    memory, now = Memory(rate=1000.0), [100.0]
    monkeypatch.setattr("hysteresis_ros.laboratory.watch.memory.time.monotonic", lambda: now[0])
    for number in range(6):
        memory.add(block(10 * number, measured=[0.0] * 10))
        now[0] += 0.01
    assert memory.rate_seen() == pytest.approx(1000.0, rel=1e-6)


@pytest.mark.parametrize("given", [True, False, "5", None, float("nan"), float("inf"), 0.001, 61])
def test_a_window_is_a_finite_number_within_its_ends(given):
    with pytest.raises(RequestError, match="window = "):
        read_request(json.dumps({"id": 1, "do": "view", "window": given, "columns": 300}))


def test_the_plane_of_two_axes_puts_samples_of_one_stamp_together():
    plane = Plane()
    assert plane.told() is None and plane.axes == ()
    plane.choose({"/s/x": 0, "/s/y": 2})
    numbers = np.arange(10)
    # x arrives earlier than y, and the reference of y is published two samples ahead
    plane.add("/s/x", block(0, reference=1.0 * numbers, measured=1.0 * numbers))
    plane.add("/s/z", block(0, reference=9.0 * numbers, measured=9.0 * numbers))
    plane.add("/s/y", block(4, reference=10.0 * np.arange(6, 9), measured=10.0 * np.arange(4, 7) + 3.0))
    plane.add("/s/y", block(7, reference=10.0 * np.arange(9, 15), measured=10.0 * np.arange(7, 13) - 4.0))
    told = plane.told()
    assert told["names"] == ["x", "y"]
    # the first two references of y are not known
    np.testing.assert_array_equal(told["reference"], [[6, 7, 8, 9], [60, 70, 80, 90]])
    np.testing.assert_array_equal(told["path"], [[6, 7, 8, 9], [63, 66, 76, 86]])
    assert told["error"] == [3, 4, 4, 4] and told["largest"] == 4.0
    assert told["rms"] == pytest.approx(np.sqrt((9 + 3 * 16) / 4))
    # a restarted run is another path
    plane.add("/s/x", block(0, reference=[0.0], measured=[0.0]))
    assert plane.told()["error"] == [] and plane.told()["rms"] is None
    # the first references of y are unknown again, not those of the run before
    plane.add("/s/x", block(1, reference=np.zeros(4), measured=np.zeros(4)))
    plane.add("/s/y", block(0, reference=10.0 * np.arange(2, 7), measured=np.zeros(5)))
    np.testing.assert_array_equal(plane.told()["reference"], [[0, 0, 0], [20, 30, 40]])
    plane.choose({})
    assert plane.told() is None


def test_a_long_path_is_thinned_and_keeps_its_largest_error():
    plane = Plane()
    plane.choose({"/x": 0, "/y": 0})
    measured = np.zeros(20_000)
    measured[19_003] = 7.0
    for first in range(0, 20_000, 1000):
        piece = slice(first, first + 1000)
        plane.add("/x", block(first, reference=np.zeros(1000), measured=measured[piece]))
        plane.add("/y", block(first, reference=np.zeros(1000), measured=np.zeros(1000)))
    told = plane.told()
    # at 1 kHz: the last seconds, in whole blocks
    kept = round(1000 * PLANE_WINDOW) + 1000
    assert PLANE_POINTS / 2 <= len(told["error"]) <= PLANE_POINTS and told["rms"] == pytest.approx(7.0 / np.sqrt(kept))
    assert max(told["error"]) == told["largest"] == 7.0
