# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One sample of an axis, from measurement to voltage: the loop that every runner shares.

plant (measure) → source → controller → compensator → plant (hold the voltage)

Every part reads the other parts' signals from the row of the sample and writes its own signals into it;
:mod:`hysteresis_ros.signals` defines the index of each signal in the row. Offline, a row is a line of the table of the
run; a node has its own row, into which it writes the contents of its messages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hysteresis_ros import signals as at
from hysteresis_ros.loop.compensator import AdaptiveArrays, CompensationArrays, compensate, note_output
from hysteresis_ros.loop.controller import ControllerArrays, carried_out, control
from hysteresis_ros.loop.plant import actuate, sense
from hysteresis_ros.loop.source import (
    GeneratorSourceArrays,
    SequencerSourceArrays,
    TriggeredSequencerArrays,
    TriggeredSourceArrays,
    refer,
)
from hysteresis_ros.models.block import kernels_of, nested


@kernels_of("kernel", "kernel", "kernel", "kernel", "controller", "kernel", "inverse")
class Laws(NamedTuple):
    """The kernels of an axis; an unused entry is a placeholder."""

    hysteresis: Callable
    front_hysteresis: Callable
    rear_hysteresis: Callable
    waveform: Callable
    controller: Callable
    model: Callable
    inverse: Callable


class Parts(NamedTuple):
    """The arrays of an axis, part by part."""

    plant: Any  #: Its class selects the kernel of :data:`sense`.
    source: GeneratorSourceArrays | TriggeredSourceArrays | SequencerSourceArrays | TriggeredSequencerArrays
    controller: ControllerArrays
    compensator: CompensationArrays | AdaptiveArrays


#: Steps of a sample to compute: all, or only the measurement, the command, or the return of the achieved command to the
#: controller.
WHOLE, MEASURE, ANSWER, CONFIRM = range(4)

#: Steps of a sample after which a change may take effect: before all steps, after the measurement, after the command.
BEFORE, MEASURED, ANSWERED = "", "measured", "answered"


@nested
def tick(laws, parts, row, what):
    """Compute one sample in its row, or one step of the sample; all states are updated in place."""
    if what in (WHOLE, MEASURE):
        sense(laws, parts.plant, row)
    if what in (WHOLE, ANSWER):
        refer(laws, parts.source, row)
        control(laws, parts.controller, row)
        compensate(laws, parts.compensator, row)
        actuate(laws, parts.plant, row)
        note_output(parts.compensator.watch_p.own, row)
    if what in (WHOLE, CONFIRM):
        carried_out(parts.controller, row[at.APPLIED])


def ticks(laws, parts, given, columns, row, what):
    """Compute ``columns.shape[1]`` samples of an axis; all states are updated in place."""
    for k in range(columns.shape[1]):
        for i in range(given.shape[0]):
            place = int(given[i])
            row[place] = columns[place, k]
        tick(laws, parts, row, what)
        for i in range(row.shape[0]):
            columns[i, k] = row[i]
