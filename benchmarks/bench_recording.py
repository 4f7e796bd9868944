# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recording of all samples of an axis: in batches, as by a fused axis, and message by message, as by the recorder."""

from __future__ import annotations

import pathlib
import shutil
import tempfile
from dataclasses import dataclass

import common
import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.inchworm import JOINT_NAMES
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import AxisTopics, SampleWriter

#: Largest fraction of a core that the recording of a running axis may use.
SHARE = 0.1
#: Largest ratio of the time in batches to the time message by message.
RATIO = 0.2

#: Time of the axis from one batch to the next [s].
BATCH = 0.05

#: Number of samples recorded in batches, and of samples recorded one by one.
SAMPLES, SINGLE_SAMPLES = 10_000, 1_000


@dataclass(frozen=True)
class Run:
    """Samples to record."""

    axis: AxisTopics
    stamps: np.ndarray
    table: np.ndarray
    joints: np.ndarray | None

    @classmethod
    def simulated(cls, name: str) -> Run:
        """Simulate a configuration; the values of a motor's joints, which a run does not contain, are zero."""
        parameters = single_axis(load_configuration(name))
        rate = parameters.plant_simulator.sample_rate
        run = simulate(parameters, duration=SAMPLES / rate)
        kind = parameters.kind
        names = [signal.name for signal in kind.row]
        joints = (parameters.plant_simulator.joint, *(JOINT_NAMES[1:] if kind.motor else ()))
        return cls(
            AxisTopics(joints=joints, sample_rate=rate, kind=kind),
            np.rint(run.time * 1e9).astype(np.int64),
            np.array([run[name] for name in names]),
            np.zeros((3 * len(joints), SAMPLES)) if kind.motor else None,
        )


def record_in_batches(run: Run, writer: SampleWriter) -> None:
    """Record all samples, a batch at a time."""
    size = round(BATCH * run.axis.sample_rate)
    for begin in range(0, SAMPLES, size):
        part = slice(begin, begin + size)
        writer.write(run.stamps[part], run.table[:, part], joints=None if run.joints is None else run.joints[:, part])
    writer.flush()


def messages_of(path) -> list[tuple[str, str, bytes, int]]:
    """Return the first messages of a bag, as the recorder receives them."""
    found = [
        (order, name, topic.type_name, data, time_ns)
        for name, topic in read_bag(path).topics.items()
        for order, data, time_ns in zip(topic.order, topic.data, topic.times, strict=True)
    ]
    found.sort(key=lambda message: message[0])
    per_sample = len(found) // SAMPLES
    return [message[1:] for message in found[: per_sample * SINGLE_SAMPLES]]


def record_one_by_one(messages, bag: BagWriter) -> None:
    """Record messages one by one."""
    for message in messages:
        bag.write(*message)
    bag.flush()


def measure(name: str, folder: pathlib.Path, repeats: int) -> list[common.Result]:
    """Return the figures of one configuration."""
    run = Run.simulated(name)
    with BagWriter(folder / "batches") as bag, BagWriter(folder / "singles") as singles:
        writer = SampleWriter(bag, run.axis)
        record_in_batches(run, writer)
        messages = messages_of(folder / "batches" / "batches.mcap")
        record_one_by_one(messages, singles)
        ratio, batches, single = common.interleaved(
            lambda: record_in_batches(run, writer), lambda: record_one_by_one(messages, singles), repeats
        )
    each, single_each = 1e6 * batches / SAMPLES, 1e6 * single / SINGLE_SAMPLES
    topics = len(writer.topics)
    detail = f"{each:.2f} us per sample of {topics} messages, {writer.sample_bytes} bytes"
    share = each * 1e-6 * run.axis.sample_rate
    rate = f"{run.axis.sample_rate:g} Hz"
    return [
        common.Result(f"{name}: fraction of a core at {rate}", share, "at most", SHARE, detail),
        common.Result(
            f"{name}: ratio to message by message",
            ratio * SINGLE_SAMPLES / SAMPLES,
            "at most",
            RATIO,
            f"{single_each:.0f} us per sample, {single_each / topics:.1f} us per message",
        ),
    ]


def main() -> int:
    """Run the benchmark; returns the exit code."""
    options = common.parser(__doc__, repeats=9).parse_args()
    results = []
    for name in ("kim2009", "inchworm_travel"):
        folder = pathlib.Path(tempfile.mkdtemp())
        try:
            results += measure(name, folder, options.repeats)
        finally:
            shutil.rmtree(folder)
    return common.report(results, options)


if __name__ == "__main__":
    common.run(main)
