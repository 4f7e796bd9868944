# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Effects of a campaign on measurements, and executability of every case of the catalogue."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from sensor_msgs.msg import JointState  # noqa: E402
from waiting import until  # noqa: E402

from hysteresis_ros.configuration import config_path, load_configuration  # noqa: E402
from hysteresis_ros.laboratory.campaign import rig  # noqa: E402
from hysteresis_ros.laboratory.campaign import run as campaign  # noqa: E402
from hysteresis_ros.laboratory.campaign.actions import (  # noqa: E402
    ACTIONS,  # noqa: E402
    SCHEDULE,
    scheduled,
)
from hysteresis_ros.laboratory.campaign.judging import bounds_of, prepared  # noqa: E402
from hysteresis_ros.laboratory.campaign.mishaps import (  # noqa: E402
    CATALOGUE,  # noqa: E402
    COMPOSED,
    FUSED,
    GRAPHS,
    RELAY,
    TIMEOUTS,
)
from hysteresis_ros.laboratory.campaign.rig import Clock  # noqa: E402
from hysteresis_ros.laboratory.campaign.witness import FOREIGN, Relay  # noqa: E402
from hysteresis_ros.nodes.launcher import node_environment  # noqa: E402

STROKE = 1e-4


@pytest.fixture
def relay():
    """A relay between lists instead of topics; the published messages are in ``sent``, as numbers."""
    sent: list = []

    def publish(message) -> None:
        stamp = message.header.stamp
        sent.append((round(stamp.sec + 1e-9 * stamp.nanosec, 6), tuple(message.name), tuple(message.position)))

    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=publish), create_subscription=lambda *_: None
    )
    made = Relay(SimpleNamespace(node=node), STROKE, np.random.default_rng(1))
    made.sent = sent
    yield made
    made.close()


def passed(relay, count: int, change: str = "", amount: float = 0.0) -> list:
    """Relay a number of measurements of 1, 2, 3 … µm at 1, 2, 3 … s; return the result."""
    relay.set(change, amount)
    for k in range(1, count + 1):
        message = JointState(name=["stage"], position=[k * 1e-6])
        message.header.stamp.sec = k
        relay._pass(message)
    return relay.sent


def places(sent) -> list[float]:
    return [1e6 * position[0] for _, _, position in sent]


def test_a_relay_passes_on_and_after_a_change_again(relay):
    assert places(passed(relay, 3)) == pytest.approx([1, 2, 3])
    passed(relay, 3, "stopped")
    assert len(relay.sent) == 3
    assert len(passed(relay, 2)) == 5


def test_measurements_that_are_frozen_spiky_not_numbers_or_partial_keep_their_stamps(relay):
    assert places(passed(relay, 3, "frozen")) == pytest.approx([1, 1, 1])
    assert [stamp for stamp, *_ in relay.sent] == [1, 2, 3]
    relay.sent.clear()
    off = np.array(places(passed(relay, 20, "spikes", 0.2))) - np.arange(1, 21)
    assert sorted(off)[-2:] == pytest.approx([20.0, 20.0]) and np.count_nonzero(off > 1e-6) == 2
    relay.sent.clear()
    assert all(math.isnan(place) for place in places(passed(relay, 3, "nan")))
    relay.sent.clear()
    assert [(names, position) for _, names, position in passed(relay, 1, "partial")] == [(("stage",), ())]


def test_measurements_that_are_out_of_order_twice_dropped_or_somebody_elses(relay):
    assert [stamp for stamp, *_ in passed(relay, 4, "disordered")] == [2, 1, 4, 3]
    relay.sent.clear()
    assert [stamp for stamp, *_ in passed(relay, 2, "duplicated")] == [1, 1, 2, 2]
    relay.sent.clear()
    # of 1000 random ones, three times the standard deviation of 14
    assert len(passed(relay, 1000, "dropped", 0.3)) == pytest.approx(700, abs=45)
    relay.sent.clear()
    assert [names[0] for _, names, _ in passed(relay, 2, "foreign")] == ["stage", FOREIGN, "stage", FOREIGN]
    relay.sent.clear()
    assert [stamp for stamp, *_ in passed(relay, 2, "stamped", -10.0)] == [-9, -8]


def test_measurements_that_are_late_come_in_order_and_not_before_their_time(relay):
    begun = time.monotonic()
    passed(relay, 3, "delayed", 0.2)
    until(lambda: len(relay.sent) == 3, what="late measurements")
    assert time.monotonic() - begun >= 0.2
    assert places(relay.sent) == pytest.approx([1, 2, 3])


def test_everything_in_the_catalogue_can_be_done():
    axis = prepared(load_configuration(config_path("picma_stage")), FUSED, "/faults")
    bounds = bounds_of(axis)
    for mishap in CATALOGUE.values():
        assert mishap.action in ACTIONS, mishap.name
        assert mishap.graph in ("", *GRAPHS) and mishap.safe in ("", *TIMEOUTS), mishap.name
        assert mishap.graph != RELAY or hasattr(Relay, f"_{mishap.victim}"), mishap.name
        for amount in mishap.amounts if mishap.fault else ():
            (text,) = scheduled(axis, mishap, amount, bounds).plant_simulator.faults
            assert text.startswith(f"{mishap.fault}:{SCHEDULE:g}:"), mishap.name


def test_the_same_is_done_by_the_loop_as_by_the_relay():
    axis = prepared(load_configuration(config_path("picma_stage")), FUSED, "/faults")

    def value(name: str, amount: float) -> float:
        (text,) = scheduled(axis, CATALOGUE[name], amount, bounds_of(axis)).plant_simulator.faults
        return float(text.split(":")[3])

    assert value("measurement delayed", 0.05) == 10.0  # samples at 200 Hz
    assert value("measurement delayed", 0.001) == 1.0
    assert value("measurement spikes", 0.2) == pytest.approx(0.2 * 44e-6)
    assert value("measurement dropped", 0.3) == 0.3


def test_a_time_of_day_that_is_set_jumps_for_its_processes_and_steady_clocks_go_on(tmp_path):
    clock = Clock(tmp_path)
    words = "import time; input(); print(time.time_ns(), time.time(), time.monotonic(), flush=True)"
    command, pipes = [sys.executable, "-c", words + "; " + words], dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    environment = node_environment() | clock.environment
    with subprocess.Popen(command, env=environment, text=True, **pipes) as process:
        for offset in (3600, -3600):
            clock.set(offset)
            before = time.time(), time.monotonic()
            process.stdin.write("\n")
            process.stdin.flush()
            told_ns, told, steady = map(float, process.stdout.readline().split())
            after = time.time(), time.monotonic()
            for seen in (1e-9 * told_ns, told):
                assert before[0] - 1e-3 <= seen - offset <= after[0] + 1e-3
            assert before[1] <= steady <= after[1]


def test_a_group_whose_disk_is_full_may_say_so_when_it_leaves_and_no_other(tmp_path, monkeypatch):
    """Only the exit of the processes matters here."""
    leave = "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(1)); print('there', flush=True); "
    command = [sys.executable, "-c", leave + "signal.pause()"]
    monkeypatch.setattr(rig, "node_command", lambda *given, **options: command)
    axis = prepared(load_configuration(config_path("picma_stage")), FUSED, "/faults")
    for number, (prefix, expected) in enumerate(
        ((("env",), []), ((), ["hysteresis_axis ended with exit code 1: there"]))
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        made = rig.Group(axis, COMPOSED, folder, prefix=prefix)
        until(lambda made=made: "there" in made.printed(), what="a process that is there")
        assert made.codes() == [None] and made.close() == expected and made.codes() == [1]


def test_each_mishap_is_done_at_its_own_rate_and_the_others_at_that_of_the_campaign(monkeypatch, tmp_path):
    done: list = []
    folders: list = []

    class Series:
        def __init__(self, axis, way, config, folder, random):
            self.axis = axis
            folders.append((way, folder))

        def of(self, mishaps, rounds):
            done.extend((mishap.name, self.axis.plant_simulator.sample_rate) for mishap in mishaps)
            return ()

    monkeypatch.setattr(campaign, "_Series", Series)
    names = ("kill motion_controller", "lose motion_controller at 10 Hz", "lose motion_controller at 3000 Hz")
    mishaps = tuple(CATALOGUE[name] for name in names)
    own = load_configuration("picma_stage").node("plant_simulator")["sample_rate"]
    for rate, expected in ((50.0, 50.0), (0.0, own)):
        done.clear()
        folders.clear()
        campaign.Campaign("picma_stage", mishaps, ("fused", "processes"), 1, 1, tmp_path, rate).run(print)
        assert done == list(zip(names, (expected, 10.0, 3000.0), strict=True))
        assert len(set(folders)) == len(folders) == 3
