# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A recording that is switched on and off on the page: a bag like that of the node ``recorder``."""

from __future__ import annotations

import pathlib
import time

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.samples import Block
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.batch_writer import AxisTopics, SampleWriter
from hysteresis_ros.recordings.guarded_bag import GuardedBag, require_space
from hysteresis_ros.recordings.provenance import RECORD, provenance

#: Topic of markers.
MARKER = "marker"
#: Seconds after which what was recorded is handed to the operating system.
FLUSH = 0.25


class PageRecording:
    """One bag, from the press of a button to the next.

    Parameters
    ----------
    folder : pathlib.Path
        In which the bag is made, named by the time.
    axis : AxisParameters
        What is written as its configuration.
    joints : tuple of str
        Names in ``joint_states``.

    Raises
    ------
    RecordingError
        There is no room, or the folder cannot be written.
    """

    def __init__(self, folder: pathlib.Path, axis: AxisParameters, joints: tuple[str, ...]):
        plant, prefix = axis.plant_simulator, axis.namespace
        path = _unused(folder / time.strftime("watch_%Y%m%d_%H%M%S"))
        require_space(path, axis.recorder.min_space)
        bag = BagWriter(path)
        bag.describe(RECORD, provenance())
        self._bag = GuardedBag(bag, FLUSH)
        self._space = axis.recorder.min_space
        for topic in ("configuration", "changes", MARKER):
            bag.add_topic(f"{prefix}/{topic}", "std_msgs/msg/String", "transient_local")
        bag.write_string(f"{prefix}/configuration", axis.configuration_text(), time.time_ns())
        motor = axis.inchworm_sequencer is not None
        force = 0.0 if motor else plant.preload.force
        topics = AxisTopics(prefix, joints, plant.sample_rate, motor, force, not plant.driver)
        self._samples = SampleWriter(bag, topics, chunk_time=FLUSH)
        self._prefix = prefix

    @property
    def path(self) -> pathlib.Path:
        """The bag."""
        return self._bag.path

    @property
    def stopped(self) -> str:
        """Why nothing is recorded any more; empty while all is well."""
        return self._bag.stopped

    @property
    def samples(self) -> int:
        """Samples so far."""
        return self._samples.sample_count

    def write(self, block: Block) -> None:
        """Write samples.

        Parameters
        ----------
        block : Block
        """
        self._bag.attempt(lambda bag: self._samples.write(block.stamps, block.table, joints=block.joints))
        self._bag.tend(self._space)

    def say(self, topic: str, text: str) -> None:
        """Write a text.

        Parameters
        ----------
        topic : str
            ``changes`` or ``marker``.
        text : str
        """
        self._bag.attempt(lambda bag: bag.write_string(f"{self._prefix}/{topic}", text, time.time_ns()))

    def finish(self) -> None:
        """End the bag in order; what goes wrong stands in :attr:`stopped`."""
        try:
            self._bag.finish()
        except RecordingError as error:
            self._bag.stopped = str(error)


def _unused(path: pathlib.Path) -> pathlib.Path:
    """Return a path at which there is nothing yet."""
    found, number = path, 1
    while found.exists():
        number += 1
        found = path.with_name(f"{path.name}_{number}")
    return found
