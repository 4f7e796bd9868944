# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Where the reference of a sample comes from: a generator of waveforms and setpoints, or an inchworm's sequencer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.parameters import InchwormSequencerNodeParameters, ReferenceNodeParameters, part
from hysteresis_ros.loop.watch import RUNNING, STOPPED, TRIPPED
from hysteresis_ros.models.block import by_part, nested
from hysteresis_ros.references import generator as generating
from hysteresis_ros.references import inchworm_layout as gait
from hysteresis_ros.references.generator import (
    GeneratorArrays,
    ReferenceGenerator,
    ReferenceParameters,
    abandon,
    reference_step,
    setpoint_in_force,
)
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer, sequence
from hysteresis_ros.references.inchworm_steps import GAIN, OFFSET
from hysteresis_ros.references.trajectory import HELD, NOWHERE, brake


@by_part
def refer(laws, part, row):
    """Put the reference of a sample into its row, and what else the source of this kind gives."""


@by_part
def rest(laws, part, column):
    """Let a source of this kind hold from this sample on, of which ``column``, shape (row length, 1), is given."""


@by_part
def hold(laws, part, column):
    """Let a motion end from this sample on; setpoints are taken on."""


class GeneratorSourceArrays(NamedTuple):
    """All arrays of a reference generator in the loop."""

    p: GeneratorArrays
    x: GeneratorArrays


@nested
def generate(laws, arrays, row):
    """Reference of a waveform and a setpoint; it stays where it is while the plant has stopped the axis."""
    x = arrays.x.range
    mode = RUNNING
    if row[at.TRIPPED] != 0.0:
        abandon(arrays.p, arrays.x)
        row[at.REFERENCE] = x[generating.OUTPUT]
        mode = TRIPPED
    else:
        row[at.REFERENCE] = reference_step(laws.waveform, arrays.p, arrays.x, row[at.SETPOINT])
        if x[generating.RUNNING] == 0.0:
            mode = STOPPED
    row[at.SETPOINT] = setpoint_in_force(arrays.x, row[at.SETPOINT])
    row[at.SOURCE_MODE] = mode


@nested
def rest_generator(laws, arrays, column):
    """Hold the reference."""
    arrays.x.range[generating.RUNNING] = 0.0
    abandon(arrays.p, arrays.x)


@nested
def hold_generator(laws, arrays, column):
    """Let what moves come to rest, and stay there."""
    brake(arrays.p.trajectory, arrays.x.trajectory, NOWHERE, HELD)


refer.kinds[GeneratorSourceArrays], rest.kinds[GeneratorSourceArrays] = generate, rest_generator
hold.kinds[GeneratorSourceArrays] = hold_generator


class GeneratorSource:
    """The reference generator of an axis."""

    def __init__(self, parameters: ReferenceNodeParameters):
        self.parameters = parameters
        self.generator = ReferenceGenerator(part(parameters, ReferenceParameters), 1.0 / parameters.sample_rate)

    @property
    def arrays(self) -> GeneratorSourceArrays:
        """Arrays of the present waveform."""
        return GeneratorSourceArrays(self.generator.ps, self.generator.xs)

    @property
    def waveform(self):
        """Kernel of the present waveform, for the loop."""
        return self.generator.waveform_kernel

    @property
    def duration_samples(self) -> int:
        """Length of a run that the waveform gives, in samples; 0 when it gives none."""
        return self.generator.waveform.duration_samples

    @property
    def schedule(self) -> np.ndarray:
        """Samples from which on a setpoint holds that nobody gave, and these [m], shape (1, 2)."""
        return np.array([[0.0, self.parameters.initial_setpoint]])

    def setpoints(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] in force at each of the first ``samples`` samples when nobody gives another."""
        return np.full(samples, self.parameters.initial_setpoint)

    def inject(self, faults: tuple[str, ...]) -> None:
        """Do nothing: a generator is given nothing that faults act on."""

    def stop(self) -> None:
        """Hold the reference where it is."""
        self.generator.stop()

    def begin_at(self, position: float) -> None:
        """Begin where an axis is that runs already [m], and stay there until somebody asks for something."""
        self.generator.begin_at(position)

    def follow(self, **points) -> None:
        """Follow a trajectory from the next sample on."""
        self.generator.follow(**points)

    def hold(self) -> None:
        """Let what moves come to rest, and stay there."""
        self.generator.hold()

    def start(self) -> None:
        """Start the waveform from its beginning, without a jump."""
        self.generator.start()

    def reset(self) -> None:
        """Begin again: waveform at its start, setpoint as configured."""
        running = self.generator.running
        self.generator.reset()
        if not running:
            self.generator.stop()

    def retune(self, parameters: ReferenceNodeParameters) -> None:
        """Take another waveform while stopped."""
        self.generator.retune(part(parameters, ReferenceParameters))
        self.parameters = parameters


class SequencerArrays(NamedTuple):
    """Parameter array, or state array, of a sequencer, with those of its faults."""

    sequencer: np.ndarray
    faults: np.ndarray


class SequencerSourceArrays(NamedTuple):
    """All arrays of an inchworm's sequencer in the loop."""

    p: SequencerArrays
    x: SequencerArrays


@nested
def sequenced(laws, arrays, row):
    """Reference, origin and clamp voltages of an inchworm motor.

    While the plant has stopped the axis the sequencer is given no measurement: both clamps close and hold.
    """
    p, x, faults = arrays.p.sequencer, arrays.x.sequencer, arrays.x.faults
    faulty.begin_sample(faults)
    slider = faulty.corrupt(arrays.p.faults, faults, faulty.MEASUREMENT, row[at.MEASURED])
    mode = RUNNING
    if row[at.SKIPPED] != 0.0:
        slider = math.nan
    if row[at.TRIPPED] != 0.0:
        slider = math.nan
        mode = TRIPPED
    if row[at.REQUEST] != 0.0:
        x[gait.REQUEST] = row[at.REQUEST]
    if row[at.SPEED] == row[at.SPEED]:
        x[gait.SPEED] = row[at.SPEED]
    row[at.SPEED] = x[gait.SPEED]
    row[at.REFERENCE] = sequence(p, x, row[at.SETPOINT], slider, row[at.EXTENDER])
    row[at.SOURCE_MODE] = mode
    row[at.ORIGIN] = x[gait.ORIGIN]
    row[at.FRONT_VOLTAGE] = x[gait.FRONT_VOLTAGE]
    row[at.REAR_VOLTAGE] = x[gait.REAR_VOLTAGE]
    row[at.PHASE] = x[gait.PHASE]
    row[at.STEPS] = x[gait.STEPS]
    row[at.DIRECTION] = x[gait.DIRECTION]
    row[at.SLIP] = x[gait.SLIP]
    row[at.ERROR] = x[gait.ERROR]
    row[at.ARRIVED] = x[gait.ARRIVED]
    row[at.TOTAL_STEPS] = x[gait.TOTAL_STEPS]
    row[at.MISSED] = x[gait.MISSED]
    row[at.STEP_COMMANDED] = x[gait.COMMANDED_STEP]
    row[at.STEP_ACHIEVED] = x[gait.ACHIEVED_STEP]
    stroke = p[gait.HIGHEST] - p[gait.LOWEST]
    row[at.LOAD_DEFLECTION] = x[gait.LOAD]
    row[at.FORWARD_GAIN] = x[gait.FORWARD_MODEL + GAIN]
    row[at.BACKWARD_GAIN] = x[gait.BACKWARD_MODEL + GAIN]
    row[at.FORWARD_OFFSET] = stroke * x[gait.FORWARD_MODEL + OFFSET]
    row[at.BACKWARD_OFFSET] = stroke * x[gait.BACKWARD_MODEL + OFFSET]
    row[at.CYCLE_PHASE] = x[gait.CYCLE_PHASE]
    row[at.PATH_ERROR] = x[gait.PATH_ERROR]
    row[at.CORRECTION] = x[gait.CORRECTION]


@nested
def rest_sequencer(laws, arrays, column):
    """Ask for a stop."""
    column[at.REQUEST, 0] = gait.STOP_REQUEST


refer.kinds[SequencerSourceArrays], rest.kinds[SequencerSourceArrays] = sequenced, rest_sequencer
hold.kinds[SequencerSourceArrays] = rest_sequencer


class SequencerSource:
    """The sequencer of an inchworm's axis."""

    def __init__(self, parameters: InchwormSequencerNodeParameters):
        self.parameters = parameters
        given = part(parameters, InchwormSequencerParameters)
        self.sequencer = InchwormSequencer(given, 1.0 / parameters.sample_rate)
        faults = faulty.fault_parameters(parameters.faults, (faulty.MEASUREMENT,), parameters.sample_rate)
        self._connect(faults)

    def _connect(self, faults: np.ndarray) -> None:
        p = SequencerArrays(self.sequencer.p, faults)
        self.arrays = SequencerSourceArrays(p, SequencerArrays(self.sequencer.x, faulty.fault_state(faults)))

    def inject(self, faults: tuple[str, ...]) -> None:
        """Let these faults happen, their times counted from now on, and no others."""
        self._connect(faulty.fault_parameters(faults, (faulty.MEASUREMENT,), self.parameters.sample_rate))

    @property
    def waveform(self):
        """A sequencer has no waveform: its own kernel takes the place, which is never called through it."""
        return None

    @property
    def duration_samples(self) -> int:
        """Length of a run that the schedule gives, in samples; 0 when it gives none."""
        return self.sequencer.duration_samples

    @property
    def schedule(self) -> np.ndarray:
        """Samples from which on a setpoint of the schedule holds, and these [m], shape (N, 2)."""
        given = self.sequencer.parameters
        first = [round(time / self.sequencer.sample_time) for time in given.setpoints.times]
        return np.array([[0.0, given.initial_setpoint], *zip(first, given.setpoints.values, strict=True)], dtype=float)

    def setpoints(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] of the schedule at each of the first ``samples`` samples."""
        return self.sequencer.scheduled(samples)

    def reset(self) -> None:
        """Begin again: both clamps close, steps and learned lengths are forgotten."""
        self.sequencer.reset()
        self.arrays.x.faults[:] = faulty.fault_state(self.arrays.p.faults)

    def retune(self, parameters: InchwormSequencerNodeParameters) -> None:
        """Take new time-outs; everything of the gait is refused under a motor that walks."""
        self.sequencer.retune(part(parameters, InchwormSequencerParameters))
        self.parameters = parameters
