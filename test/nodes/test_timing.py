# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Pace and pairing of samples: pure arithmetic, no ROS."""

import random
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hysteresis_ros.loop.pacing import Lateness  # noqa: E402
from hysteresis_ros.nodes import plant_simulator, timing  # noqa: E402
from hysteresis_ros.nodes.fused import skipped_text  # noqa: E402
from hysteresis_ros.nodes.timing import Pace, Pairing  # noqa: E402


def play(events):
    """Return the pairs (stamp, answer) for events (time, kind, number)."""
    pairing, pairs = Pairing(), []
    for now, kind, number in events:
        partner = getattr(pairing, kind)(number, now)
        if partner is not None:
            pairs.append((number, partner) if kind == "measurement" else (partner, number))
    return pairs


def test_answers_meet_their_measurements_in_any_order():
    order = random.Random(1)
    events = []
    for k in range(500):
        first, second = order.sample(["measurement", "answer"], 2)
        events += [(k * 1e-3, first, k), (k * 1e-3 + 2e-4, second, k)]
    assert play(events) == [(k, k) for k in range(500)]


def test_an_answer_may_be_later_than_the_next_measurement():
    events = sorted(
        [(k * 1e-3, "measurement", k) for k in range(9)] + [(k * 1e-3 + 1.4e-3, "answer", k) for k in range(9)]
    )
    assert play(events) == [(k, k) for k in range(9)]


def test_a_measurement_that_is_never_answered_does_not_shift_what_follows_for_long():
    events = [
        (k * 1e-3 + 1e-4 * late, kind, k) for k in range(300) for late, kind in enumerate(("measurement", "answer"))
    ]
    pairs = play([event for event in events if event[1:] != ("answer", 50)])
    assert pairs[:50] == [(k, k) for k in range(50)]
    assert pairs[-100:] == [(k, k) for k in range(200, 300)]


def test_a_pause_is_forgotten():
    events = [(0.0, "answer", -1), (1.0, "measurement", 0), (1.001, "answer", 0)]
    assert play(events) == [(0, 0)]


def test_the_first_answer_belongs_to_the_last_measurement_after_nobody_answered():
    pairing = Pairing()
    assert [pairing.measurement(k, k * 1e-3) for k in range(200)] == [None] * 200
    pairing.begin()
    assert pairing.answer("a", 0.2) == 199 and pairing.measurement(200, 0.2) is None


def test_answers_that_run_ahead_fall_back():
    """Answer k was assigned to measurement k + 1, so every later measurement finds an answer already waiting."""
    events = [(0.0, "answer", 0)] + [
        (k * 1e-3 + 1e-4 * late, kind, k) for k in range(1, 300) for late, kind in enumerate(("measurement", "answer"))
    ]
    pairs = play(events)
    assert pairs[:3] == [(1, 0), (2, 1), (3, 2)]
    assert pairs[-100:] == [(k, k) for k in range(200, 300)]


@pytest.mark.parametrize(("factor", "keeps_time", "expected"), [(1.0, False, 3), (0.1, False, 3), (0.1, True, 999)])
def test_who_does_not_keep_the_time_counts_overruns_by_the_usual_interval(monkeypatch, factor, keeps_time, expected):
    now = [1]
    monkeypatch.setattr(timing.time, "monotonic_ns", lambda: now[0])
    pace = Pace(1e-3, keeps_time=keeps_time)
    for k in range(1000):
        pace.tick()
        now[0] += round(1e6 / factor * (2.0 if k in (100, 500, 900) else 1.0))
    rate, jitter = pace.read()
    assert rate == pytest.approx(1000.0 * factor, rel=0.01)
    assert pace.overruns == expected
    assert jitter < 1e-9, "three of 999 intervals are less than a hundredth"


def test_a_burst_is_no_rate(monkeypatch):
    """Messages that a busy machine delivers together after a pause do not change the measured rate."""
    now = [1]
    monkeypatch.setattr(timing.time, "monotonic_ns", lambda: now[0])
    pace = Pace(1e-2, keeps_time=False)
    for _ in range(4):
        now[0] += 999_000_000
        for _ in range(100):
            pace.tick()
            now[0] += 10_000  # 100 samples in 1 ms
        assert pace.read()[0] < 110.0
    assert pace.read()[0] == pytest.approx(100.0, rel=0.05)
    for _ in range(3):  # the same for frequent queries
        now[0] += 1_000_000
        pace.tick()
        assert pace.read()[0] == pytest.approx(100.0, rel=0.05)


def test_a_silence_takes_the_rate_away(monkeypatch):
    now = [1]
    monkeypatch.setattr(timing.time, "monotonic_ns", lambda: now[0])
    pace = Pace(1e-2)
    for _ in range(150):
        pace.tick()
        now[0] += 10_000_000
    assert pace.read()[0] == pytest.approx(100.0, rel=0.05)
    for _ in range(2):
        now[0] += 2_000_000_000
        rate = pace.read()[0]
    assert rate == 0.0


def test_the_rate_of_a_run_counts_to_its_last_sample_and_not_to_the_end_of_its_device(monkeypatch):
    """Making devices safe and closing them took as long as a short run, whose rate was halved by it."""
    clock, said = [5.0], []
    monkeypatch.setattr(plant_simulator, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    node = SimpleNamespace(
        sample=0,
        late=0,
        stamps=SimpleNamespace(begin=lambda origin: None),
        parameters=SimpleNamespace(sample_rate=1000.0, time_mode="fused"),
        row=[],
        _message=SimpleNamespace(header=SimpleNamespace(stamp=None)),
        _state_places=(),
        _limited_counts=lambda: {},
        publish_state=lambda stamp, *values: None,
        get_logger=lambda: SimpleNamespace(info=said.append, warning=said.append),
    )
    monkeypatch.setattr(plant_simulator, "limited_in_all", lambda *given: "")
    plant_simulator.PlantSimulatorNode.begin_run(node, 0)
    clock[0], node.sample = 7.0, 2000
    plant_simulator.PlantSimulatorNode._publish_row(node)
    clock[0] = 9.0  # the device is closed
    plant_simulator.PlantSimulatorNode._tell(node)
    assert said[0].startswith("2000 samples in 2.000 s: 1000.0 Hz, real-time factor 1,")


def test_skipped_samples_are_blamed_on_the_driver_only_if_it_was_slow():
    def said(longest: float, driver: str) -> str:
        found = Lateness(0.0, 0.0, 40e-6, 0.0, 2.0, 4000, 20000, 1e-5, longest, 0.0, 0.0)
        return skipped_text(2000.0, 100, found, driver)

    slow, busy, simulated = said(2.0, "./stage.py"), said(100e-6, "./stage.py"), said(2.0, "")
    assert "(4000 so far; the longest sample took 2 s): the calls of the driver ./stage.py in a sample" in slow
    assert "within its period, 500 µs; if they do, give the loop a core" in slow
    for text in (busy, simulated):
        assert "driver" not in text and "99 % of all samples began within 40 µs): give the loop a" in text
