# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis as a device of bluesky: moved, scanned and flown by a RunEngine, over ROS."""

from __future__ import annotations

import asyncio
import pathlib

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
pytest.importorskip("ophyd_async", reason="ophyd-async is not installed: no devices of bluesky")

from bluesky import RunEngine  # noqa: E402
from bluesky import plan_stubs as bps  # noqa: E402
from bluesky.plans import scan  # noqa: E402
from bluesky.utils import FailedStatus  # noqa: E402
from nodes_support import SOON_AT_REST, axis_parameters, compose, until, write_axis  # noqa: E402

from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.laboratory.bluesky import Flight, HysteresisAxis  # noqa: E402

RATE = 50.0
#: Without trips on a busy machine.
SLOW = {
    **SOON_AT_REST,
    "plant_simulator": {"late_limit": -1, **SOON_AT_REST["plant_simulator"]},
    "reference_generator": {"trajectory__goal_time": 20.0, "initial_setpoint": 0.0, "trajectory__dwell": 0.05},
}


class Laboratory:
    """A RunEngine, its documents by kind, and a device of a composed axis."""

    def __init__(self, axis, path):
        self.parameters = axis
        self.engine = RunEngine()
        self.documents: dict[str, list] = {}
        self.engine.subscribe(lambda kind, document: self.documents.setdefault(kind, []).append(document))
        self.stage = HysteresisAxis(path, name="stage", tolerance=0.02, timeout=30.0)
        self.wait(self.stage.connect(timeout=30.0))

    def wait(self, coroutine):
        """Return the result of a coroutine in the loop of the engine."""
        return asyncio.run_coroutine_threadsafe(coroutine, self.engine.loop).result(60.0)

    def data(self, stream: str) -> list[dict]:
        """Return the events of a stream."""
        chosen = {one["uid"] for one in self.documents["descriptor"] if one["name"] == stream}
        found = [one for one in self.documents.get("event", ()) if one["descriptor"] in chosen]
        for page in self.documents.get("event_page", ()):
            if page["descriptor"] in chosen:
                for number in range(len(page["time"])):
                    columns = {what: page[what].items() for what in ("data", "timestamps")}
                    found.append({what: {name: one[number] for name, one in pairs} for what, pairs in columns.items()})
        return found


@pytest.fixture(name="laboratory")
def _laboratory(inside, domain, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    axis = axis_parameters(overrides=SLOW, sample_rate=RATE, time_mode="realtime")
    compose(inside, axis)
    inside.spin()
    made = Laboratory(axis, write_axis(tmp_path / "axis.yaml", axis))
    yield made
    made.stage.close()


def plan_of_the_page():
    """Return the plan ``fly`` of docs/epics.md."""
    page = (pathlib.Path(__file__).parents[2] / "docs" / "epics.md").read_text(encoding="utf-8")
    blocks = [part.partition("```")[0] for part in page.split("```python\n")[1:]]
    (snippet,) = [block for block in blocks if "HysteresisAxis" in block]
    names: dict = {}
    exec(compile(snippet.partition("RE = ")[0], "docs/epics.md", "exec"), names)
    assert names["HysteresisAxis"] is HysteresisAxis
    return names["fly"]


def test_an_axis_is_moved_scanned_and_flown(laboratory):
    """A scan reads where it moved; a flight has a sample at each stamp, on the line that was asked for."""
    stage, engine = laboratory.stage, laboratory.engine
    engine(scan([], stage, 2.0, 6.0, 5))
    readings = [event["data"] for event in laboratory.data("primary")]
    assert [one["stage-setpoint"] for one in readings] == pytest.approx([2.0, 3.0, 4.0, 5.0, 6.0])
    assert [one["stage"] for one in readings] == pytest.approx([2.0, 3.0, 4.0, 5.0, 6.0], abs=0.02)

    laboratory.documents.clear()
    engine(plan_of_the_page()(stage, Flight(3.0, 8.0, 1.0, run_up=0.2)))
    flown = laboratory.data("stage")
    stamps = np.array([event["timestamps"]["stage"] for event in flown])
    position = np.array([event["data"]["stage"] for event in flown])
    assert np.all(np.diff(stamps) > 0.0)
    assert position[0] == pytest.approx(2.5, abs=0.05) and position[-1] == pytest.approx(8.5, abs=0.05)
    line = (position > 3.2) & (position < 7.8)  # 5 um/s; a busy machine delays single samples
    assert np.polyfit(stamps[line] - stamps[0], position[line], 1)[0] == pytest.approx(5.0, rel=0.1)
    assert np.all(np.diff(position[line]) > 0.0) and np.sum(line) > 0.8 * 0.92 * RATE

    until(lambda: laboratory.stage._connected().look().setpoint > 8e-6, what="the end of the flight as setpoint")
    with pytest.raises(FailedStatus) as refused:
        engine(bps.mv(stage, 99.0))
    assert "out of the range of this axis" in str(refused.value.__cause__ or refused.value.args)
    assert laboratory.wait(stage.locate())["setpoint"] == pytest.approx(8.5)


@pytest.mark.parametrize(
    ("flight", "told"),
    [
        (Flight(3.0, 99.0, 1.0), "end 99 um is out of the range"),
        (Flight(11.0, 11.9, 1.0, run_up=1.0), "run-down 12.35 um is out of the range"),
        (Flight(3.0, 3.0, 1.0), "the start and end positions must differ"),
        (Flight(3.0, 4.0, 0.0), "durations and every must be > 0"),
        (Flight(1.0, 11.0, 1e-3, run_up=1e-5), "the approach allows"),
    ],
)
def test_a_flight_that_cannot_be_is_refused_before_anything_moves(tmp_path, flight, told):
    """Without an axis: nothing is sent."""
    limited = {"reference_generator": {"approach__maximum_velocity": 1e-3, "approach__maximum_acceleration": 1.0}}
    stage = HysteresisAxis(write_axis(tmp_path / "axis.yaml", axis_parameters(overrides=limited)), name="stage")
    with pytest.raises(HysteresisError) as refused:
        stage._planned(flight)
    assert told in str(refused.value)


def test_a_device_without_an_axis_says_so(domain, tmp_path, monkeypatch):
    """Within its time-out, with what to look at."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    stage = HysteresisAxis(write_axis(tmp_path / "axis.yaml", axis_parameters()), name="stage")
    with pytest.raises(HysteresisError, match="start it, or use its ROS domain"):
        asyncio.run(stage.connect(timeout=0.2))
    with pytest.raises(HysteresisError, match="not connected"):
        asyncio.run(stage.locate())
