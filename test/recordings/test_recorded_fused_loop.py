# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A fused loop, recorded in batches while it runs, is repeated offline bit for bit, including skipped samples."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hysteresis_ros import signals
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import differences, simulate
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.recordings.align import read_recording
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter

SAMPLES = 3000


def record(loop, bag, writer):
    """Read the samples of a loop until it ends, and write them."""
    axis, start, first = writer.axis, None, 0
    while True:
        running = loop.running
        made = loop.take()
        count = len(made.times)
        assert made.lost == 0 and (not count or made.first == first)
        if count and start is None:
            start = int(made.times[0])
        if count:
            stamps = start + np.rint(np.arange(first, first + count) * 1e9 / axis.sample_rate).astype(np.int64)
            joints = np.zeros((3 * len(axis.joints), count)) if axis.kind.motor else None
            writer.write(stamps, made.table, joints=joints, times=made.times)
            first += count
        if not running:
            break
        loop.join(0.01)
    assert not loop.failure


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for these rates")
@pytest.mark.parametrize(("name", "factor"), [("kim2009", 1.0), ("kim2009", np.inf), ("inchworm_travel", np.inf)])
def test_a_fused_run_is_recorded_whole_and_repeated_offline(tmp_path, name, factor):
    configuration = load_configuration(name)
    if name == "kim2009":
        configuration = configuration.override("plant_simulator", late_limit=0)  # a busy machine may be late
    parameters = single_axis(configuration)
    plant, kind = parameters.plant_simulator, parameters.kind
    joints = (plant.joint, "extender", "front_clamp", "rear_clamp") if kind.motor else (plant.joint,)
    topics = AxisTopics(joints=joints, sample_rate=plant.sample_rate, kind=kind, force=plant.preload.force)
    loop = FusedLoop(Axis(parameters), factor=factor, samples=SAMPLES)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_string("/configuration", parameters.configuration_text(), time.time_ns())
        writer = SampleWriter(bag, topics)
        loop.start()
        record(loop, bag, writer)
    recorded = read_recording(tmp_path / "bag", further=True)
    assert len(recorded) == SAMPLES and recorded.metadata["missing_samples"] == 0
    assert differences(recorded, parameters) == {}
    assert np.count_nonzero(recorded.signals.get("skipped", 0)) == loop.missed
    columns = {signal.name for signal in kind.row}
    # at a missed deadline the device kept its voltage; the requested voltage is a separate column
    assert set(recorded.signals) - columns <= ({signals.ASKED_VOLTAGE} if loop.missed else set())
    assert columns <= set(recorded.signals)
    assert np.ptp(simulate(parameters, duration=SAMPLES / plant.sample_rate)["displacement"]) > 1e-6
