# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Samples of axes for the tests of batches."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hysteresis_ros import signals
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.run_bag import AxisTopics

RATE = 10_000.0
BEGIN = 1_700_000_000_123_456_789
ACTUATOR = AxisTopics(namespace="left", joints=("extender",), sample_rate=RATE, force=5.88)
MOTOR = AxisTopics(joints=("slider", "extender", "front_clamp", "rear_clamp"), sample_rate=RATE, kind=signals.INCHWORM)
AXES = [pytest.param(ACTUATOR, id="actuator"), pytest.param(MOTOR, id="motor")]


def make_samples(axis, count, seed=1):
    """Return stamps, table and joints of some samples, in which the plant sometimes stops the axis."""
    random = np.random.default_rng(seed)
    table = random.normal(size=(len(axis.kind.row), count)) * 1e-6
    table[random.integers(len(table), size=count // 7), random.integers(count, size=count // 7)] = np.nan
    table[signals.TRIPPED] = np.cumsum(random.random(count) < 0.02) % 2
    stamps = BEGIN + np.rint(np.arange(count) * 1e9 / RATE).astype(np.int64)
    return stamps, table, random.normal(size=(12, count)) if axis.kind.motor else None


def write_batches(writer, samples, cuts=(), **further):
    stamps, table, joints = samples
    for begin, end in itertools.pairwise((0, *sorted(cuts), len(stamps))):
        own = {} if joints is None else {"joints": joints[:, begin:end]}
        own |= {name: values[begin:end] for name, values in further.items()}
        writer.write(stamps[begin:end], table[:, begin:end], **own)


def topics_of(path):
    return {name: (topic.type_name, topic.data) for name, topic in read_bag(path).topics.items()}
