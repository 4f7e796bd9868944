# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The reference source of an axis: a generator of waveforms and setpoints, or an inchworm's sequencer."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros import signals as at
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.parameters import InchwormSequencerNodeParameters, ReferenceNodeParameters, part
from hysteresis_ros.loop.watch import RUNNING, STOPPED, TRIPPED
from hysteresis_ros.models.block import by_part, nested
from hysteresis_ros.references import generator as generating
from hysteresis_ros.references import inchworm_layout as gait
from hysteresis_ros.references import triggers as triggering
from hysteresis_ros.references.approach import HIGH, LOW
from hysteresis_ros.references.declaration import COUNTER, END
from hysteresis_ros.references.generator import (
    GeneratorArrays,
    ReferenceGenerator,
    ReferenceParameters,
    abandon,
    begin_waveform,
    reference_step,
    setpoint_in_force,
)
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer, sequence
from hysteresis_ros.references.inchworm_steps import GAIN, OFFSET
from hysteresis_ros.references.trajectory import HELD, NOWHERE, brake
from hysteresis_ros.references.triggers import TriggerArrays, compare, rest_triggers, step_setpoint, trigger_arrays
from hysteresis_ros.references.waveforms.scan import clock_of
from hysteresis_ros.units import micrometres


@by_part
def refer(laws, part, row):
    """Write the reference of a sample, and the other outputs of this kind of source, into its row."""


@by_part
def rest(laws, part, column):
    """Hold the reference, beginning with this sample; ``column``, shape (row length, 1), contains the inputs."""


@by_part
def hold(laws, part, column):
    """Bring the reference to rest and hold it, beginning with this sample; later setpoints are still accepted."""


class GeneratorSourceArrays(NamedTuple):
    """All arrays of a reference generator in the loop."""

    p: GeneratorArrays
    x: GeneratorArrays
    edges: np.ndarray  #: Result of :meth:`.ScanClock.edges`; a single 0 without a scan.


@nested
def generate(laws, arrays, row):
    """Compute the reference from waveform and setpoint; hold it while the plant has stopped the axis."""
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
    # not a separate function, because its call with all arrays of the generator took about 30 ns per sample
    row[at.WAVEFORM_SAMPLE] = -1.0
    row[at.SCAN_EDGES] = 0.0
    row[at.TRIGGER] = row[at.TRIGGER_POSITION] = row[at.TRIGGER_DIRECTION] = row[at.TRIGGER_DELAY] = 0.0
    if mode == RUNNING and x[generating.RUNNING] == generating.WHOLE:
        k, end = arrays.x.waveform[COUNTER] - 1.0, arrays.p.waveform[END]
        row[at.WAVEFORM_SAMPLE] = k
        if arrays.edges.shape[0] > 1 and k >= 0.0 and (end == 0.0 or k < end):
            row[at.SCAN_EDGES] = arrays.edges[int(k % arrays.edges.shape[0])]


class TriggeredSourceArrays(NamedTuple):
    """All arrays of a reference generator with triggers in the loop."""

    p: GeneratorArrays
    x: GeneratorArrays
    edges: np.ndarray  #: As in :class:`GeneratorSourceArrays`.
    triggers: TriggerArrays


@nested
def generate_and_trigger(laws, arrays, row):
    """Act on pulses of the trigger input, compute the reference, and find the trigger of the sample."""
    triggers = arrays.triggers
    action, pulsed = triggers.p[triggering.ACTION], row[at.TRIGGER_IN] > 0.0 and row[at.TRIPPED] == 0.0
    if action == triggering.START and pulsed:
        begin_waveform(laws.waveform, arrays.p, arrays.x)
    if action == triggering.HOLD and pulsed:
        arrays.x.range[generating.RUNNING] = 0.0
        abandon(arrays.p, arrays.x)
    if action == triggering.STEP_SETPOINT:
        step_setpoint(triggers, row)
    generate(laws, arrays, row)
    triggers.x[triggering.IN_FORCE] = row[at.SETPOINT]
    compare(triggers, row)


@nested
def rest_generator(laws, arrays, column):
    """Hold the reference."""
    arrays.x.range[generating.RUNNING] = 0.0
    abandon(arrays.p, arrays.x)


@nested
def hold_generator(laws, arrays, column):
    """Bring the reference to rest and hold it."""
    brake(arrays.p.trajectory, arrays.x.trajectory, NOWHERE, HELD)


refer.kinds[GeneratorSourceArrays], rest.kinds[GeneratorSourceArrays] = generate, rest_generator
hold.kinds[GeneratorSourceArrays] = hold_generator
refer.kinds[TriggeredSourceArrays], rest.kinds[TriggeredSourceArrays] = generate_and_trigger, rest_generator
hold.kinds[TriggeredSourceArrays] = hold_generator


class GeneratorSource:
    """The reference generator of an axis."""

    def __init__(self, parameters: ReferenceNodeParameters):
        self.parameters = parameters
        self.generator = ReferenceGenerator(part(parameters, ReferenceParameters), 1.0 / parameters.sample_rate)
        self._arm()

    def _arm(self) -> None:
        """Create the triggers from the parameters; let a waveform that the trigger input starts wait for a pulse."""
        own = self.parameters
        self.triggers = triggers_of(own)
        self._bound()
        if own.triggers.input.action == "start":
            self.generator.wait_for_start()

    def _bound(self) -> None:
        """Limit setpoint steps by the trigger input to the range that the present waveform leaves."""
        if self.triggers is not None:
            bounds = self.generator.ps.approach[[LOW, HIGH]]
            self.triggers.p[[triggering.LOWEST, triggering.HIGHEST]] = bounds

    @property
    def arrays(self) -> GeneratorSourceArrays | TriggeredSourceArrays:
        """Arrays of the present waveform."""
        ps, xs, edges = self.generator.ps, self.generator.xs, self.generator.waveform.edges
        if self.triggers is None:
            return GeneratorSourceArrays(ps, xs, edges)
        return TriggeredSourceArrays(ps, xs, edges, self.triggers)

    @property
    def waveform(self):
        """Kernel of the present waveform, for the loop."""
        return self.generator.waveform_kernel

    @property
    def duration_samples(self) -> int:
        """Length of a run in samples, as determined by the waveform; 0: no end, or the waveform waits for a trigger."""
        if self.parameters.triggers.input.action == "start":
            return 0
        return self.generator.waveform.duration_samples

    @property
    def setpoint_range(self) -> tuple[float, float]:
        """Smallest and largest accepted setpoint [m]: the range minus what the waveform needs."""
        return self.generator.ps.approach[LOW], self.generator.ps.approach[HIGH]

    @property
    def schedule(self) -> np.ndarray:
        """First samples and values [m] of the configured setpoints, shape (1, 2)."""
        return np.array([[0.0, self.parameters.initial_setpoint]])

    def setpoints(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] at each of the first ``samples`` samples of a run without received setpoints."""
        return np.full(samples, self.parameters.initial_setpoint)

    def inject(self, faults: tuple[str, ...]) -> None:
        """Do nothing, because no fault acts on a generator."""

    def stop(self) -> None:
        """Hold the reference at its present value."""
        self.generator.stop()

    def begin_at(self, position: float) -> None:
        """Begin at the position of a running axis [m], and hold this position until the first request."""
        self.generator.begin_at(position)

    def follow(self, **points) -> None:
        """Follow a trajectory, beginning with the next sample."""
        self.generator.follow(**points)

    def hold(self) -> None:
        """Bring the reference to rest and hold it."""
        self.generator.hold()

    def start(self) -> None:
        """Start the waveform from its beginning, without a jump."""
        self.generator.start()

    def reset(self) -> None:
        """Reset the waveform to its start, and the setpoint to the configured value."""
        running = self.generator.running
        self.generator.reset()
        if self.triggers is not None:
            rest_triggers(self.triggers, self.parameters.initial_setpoint)
        if self.parameters.triggers.input.action == "start":
            self.generator.wait_for_start()
        if not running:
            self.generator.stop()

    def retune(self, parameters: ReferenceNodeParameters) -> None:
        """Apply other triggers, or, while the generator is stopped, another waveform."""
        self.generator.retune(part(parameters, ReferenceParameters))
        before, self.parameters = self.parameters, parameters
        if (parameters.triggers, parameters.waveform) != (before.triggers, before.waveform):
            number = 0.0 if self.triggers is None else self.triggers.x[triggering.NUMBER]
            self.triggers = triggers_of(parameters)
            if self.triggers is not None:
                self.triggers.x[triggering.NUMBER] = number
            self._bound()


def triggers_of(parameters: ReferenceNodeParameters | InchwormSequencerNodeParameters) -> TriggerArrays | None:
    """Return the arrays of the triggers of an axis, or None if it has no triggers."""
    given, step = parameters.triggers, 1.0 / parameters.sample_rate
    if not given.asked:
        return None
    problems = list(parameters.trigger_problems())
    if problems:
        raise ParameterError(problems)
    rearm = given.rearmed(parameters.minimum, parameters.maximum)
    clock = None
    if isinstance(parameters, ReferenceNodeParameters) and given.each != "none":
        clock = clock_of(parameters.waveform, step)
    return trigger_arrays(given, rearm, parameters.initial_setpoint, step, clock)


class SequencerArrays(NamedTuple):
    """Parameter arrays, or state arrays, of a sequencer and of its faults."""

    sequencer: np.ndarray
    faults: np.ndarray


class SequencerSourceArrays(NamedTuple):
    """All arrays of an inchworm's sequencer in the loop."""

    p: SequencerArrays
    x: SequencerArrays


@nested
def sequenced(laws, arrays, row):
    """Compute reference, origin and clamp voltages of an inchworm motor.

    While the plant has stopped the axis, the sequencer gets no measurement, so both clamps close and hold.
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
    row[at.WAVEFORM_SAMPLE], row[at.SCAN_EDGES] = -1.0, 0.0  # a motor has no waveform
    row[at.TRIGGER] = row[at.TRIGGER_POSITION] = row[at.TRIGGER_DIRECTION] = row[at.TRIGGER_DELAY] = 0.0
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


class TriggeredSequencerArrays(NamedTuple):
    """All arrays of an inchworm's sequencer with triggers in the loop."""

    p: SequencerArrays
    x: SequencerArrays
    triggers: TriggerArrays


@nested
def sequence_and_trigger(laws, arrays, row):
    """Act on pulses of the trigger input, compute the gait, and find the trigger of the sample."""
    triggers = arrays.triggers
    action, pulsed = triggers.p[triggering.ACTION], row[at.TRIGGER_IN] > 0.0 and row[at.TRIPPED] == 0.0
    if action == triggering.START and pulsed:
        row[at.REQUEST] = gait.START_REQUEST
    if action == triggering.HOLD and pulsed:
        row[at.REQUEST] = gait.STOP_REQUEST
    if action == triggering.STEP_SETPOINT:
        step_setpoint(triggers, row)
    sequenced(laws, arrays, row)
    triggers.x[triggering.IN_FORCE] = row[at.SETPOINT]
    compare(triggers, row)


@nested
def rest_sequencer(laws, arrays, column):
    """Request a stop."""
    column[at.REQUEST, 0] = gait.STOP_REQUEST


refer.kinds[SequencerSourceArrays], rest.kinds[SequencerSourceArrays] = sequenced, rest_sequencer
hold.kinds[SequencerSourceArrays] = rest_sequencer
refer.kinds[TriggeredSequencerArrays], rest.kinds[TriggeredSequencerArrays] = sequence_and_trigger, rest_sequencer
hold.kinds[TriggeredSequencerArrays] = rest_sequencer


class SequencerSource:
    """The sequencer of an inchworm's axis."""

    def __init__(self, parameters: InchwormSequencerNodeParameters):
        self.parameters = parameters
        given = part(parameters, InchwormSequencerParameters)
        self.sequencer = InchwormSequencer(given, 1.0 / parameters.sample_rate)
        self.triggers = triggers_of(parameters)
        if self.triggers is not None:
            self.triggers.p[[triggering.LOWEST, triggering.HIGHEST]] = parameters.minimum, parameters.maximum
        faults = faulty.fault_parameters(parameters.faults, (faulty.MEASUREMENT,), parameters.sample_rate)
        self._connect(faults)

    def _connect(self, faults: np.ndarray) -> None:
        p, x = SequencerArrays(self.sequencer.p, faults), SequencerArrays(self.sequencer.x, faulty.fault_state(faults))
        self.arrays: SequencerSourceArrays | TriggeredSequencerArrays = SequencerSourceArrays(p, x)
        if self.triggers is not None:
            self.arrays = TriggeredSequencerArrays(p, x, self.triggers)

    def inject(self, faults: tuple[str, ...]) -> None:
        """Replace the scheduled faults; their times are counted from now."""
        self._connect(faulty.fault_parameters(faults, (faulty.MEASUREMENT,), self.parameters.sample_rate))

    @property
    def waveform(self):
        """Placeholder for the kernel of a waveform, which a sequencer does not have."""
        return None

    @property
    def duration_samples(self) -> int:
        """Length of a run in samples, as determined by the schedule; 0: no end."""
        return self.sequencer.duration_samples

    @property
    def setpoint_range(self) -> tuple[float, float]:
        """Smallest and largest accepted setpoint [m]."""
        return self.parameters.minimum, self.parameters.maximum

    @property
    def schedule(self) -> np.ndarray:
        """First samples and values [m] of the scheduled setpoints, shape (N, 2)."""
        given = self.sequencer.parameters
        first = [round(time / self.sequencer.sample_time) for time in given.setpoints.times]
        return np.array([[0.0, given.initial_setpoint], *zip(first, given.setpoints.values, strict=True)], dtype=float)

    def setpoints(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] of the schedule at each of the first ``samples`` samples."""
        return self.sequencer.scheduled(samples)

    def reset(self) -> None:
        """Reset the sequencer: both clamps close, and steps and learned lengths are cleared."""
        self.sequencer.reset()
        self.arrays.x.faults[:] = faulty.fault_state(self.arrays.p.faults)
        if self.triggers is not None:
            rest_triggers(self.triggers, self.parameters.initial_setpoint)

    def retune(self, parameters: InchwormSequencerNodeParameters) -> None:
        """Apply new time-outs; refuse changes of the gait and of the triggers while the sequencer is configured."""
        if parameters.triggers != self.parameters.triggers:
            text = "cannot change while the sequencer is configured; clean up and configure again"
            raise ParameterError([Problem("triggers", parameters.triggers.to_mapping(), text)])
        self.sequencer.retune(part(parameters, InchwormSequencerParameters))
        self.parameters = parameters


def require_accepted(name: str, setpoints: np.ndarray, low: ArrayLike, high: ArrayLike) -> None:
    """Refuse setpoints [m] outside ``low`` … ``high`` [m], which a running axis would ignore."""
    refused = ~((low <= setpoints) & (setpoints <= high))
    if not refused.any():
        return
    place = tuple(np.argwhere(refused)[0])
    value, least, most = (float(np.broadcast_to(part, refused.shape)[place]) for part in (setpoints, low, high))
    remedy = f"must be within {micrometres(least, most)}, the range that the waveform leaves for setpoints"
    if least <= 1e-6 * value <= most and abs(value) > 1e3 * max(abs(least), abs(most)):
        remedy += f"; setpoints are in m: write {value:g} µm as {1e-6 * value:g}"
    raise ParameterError([Problem(f"{name}[{', '.join(map(str, place))}]", value, remedy, "m")])


#: Source of each node.
SOURCES: dict[str, type[Any]] = {at.SOURCE: GeneratorSource, at.MOTOR_SOURCE: SequencerSource}
