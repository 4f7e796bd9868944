# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis: its parts, built from their parameters and run without ROS."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.loop.compensator import CompensatorPart
from hysteresis_ros.loop.controller import ControllerPart
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import PLANTS, CameraPart, Plant, SeenPlant
from hysteresis_ros.loop.quiet import DURATION, QUIET, Forecast
from hysteresis_ros.loop.source import SOURCES, GeneratorSource, SequencerSource
from hysteresis_ros.loop.tick import ANSWER, ANSWERED, BEFORE, CONFIRM, MEASURE, MEASURED, WHOLE, Laws, Parts, ticks
from hysteresis_ros.models.block import specialised_for


def sample_times(first: int, count: int, sample_rate: float) -> np.ndarray:
    """Return the times [s] of samples ``first`` … ``first + count - 1`` at ``sample_rate`` [Hz].

    They are whole nanoseconds, as in the stamps of the nodes.
    """
    return np.rint(np.arange(first, first + count) * 1e9 / sample_rate) / 1e9


#: Steps of a sample after which a change may take effect, in their order.
STEPS = {BEFORE: 0, MEASURED: 1, ANSWERED: 2}


class Change(NamedTuple):
    """A change between two samples of a run."""

    sample: int  #: Number of the first sample with the change, counted from the start of the axis.
    node: str  #: Name of the node whose part changes.
    #: ``start``, ``stop``, ``retune``; for the plant also ``halt``; for a reference generator also ``follow``, ``hold``
    #: and ``begin_at``; for a controller also ``quiet``.
    action: str
    #: With ``retune``: flat dotted parameters with their new values. With ``follow``: ``times``, ``positions``,
    #: ``velocities``, ``accelerations`` of the points of a trajectory. With ``begin_at``: ``position`` [m]. With
    #: ``quiet``: ``duration`` [s], and ``tolerance`` [m] if the drift is limited.
    parameters: dict = {}
    #: Step of the sample after which the change takes effect: ``measured`` for the plant, ``answered`` for a controller
    #: that has not yet received the achieved command; empty: before all steps of the sample.
    after: str = BEFORE


class Axis:
    """The parts of one axis in closed loop, without ROS."""

    def __init__(self, parameters: AxisParameters, plant: Plant | None = None):
        self.parameters = parameters
        self.plant = plant or PLANTS[parameters.plant_simulator.type](parameters.plant_simulator)
        self.camera = None
        if isinstance(self.plant, SeenPlant):
            self.camera = self.plant.eye.part = CameraPart(parameters.camera)
        self.source: SequencerSource | GeneratorSource = SOURCES[parameters.kind.source](parameters.source)
        self.controller = ControllerPart(parameters.motion_controller)
        self.compensator = CompensatorPart(parameters.hysteresis_compensator)
        if self.plant.begins_safe or parameters.plant_simulator.time_mode == "fused":
            self.compensator.follow_plant(self.plant.rounding, self.plant.begins_safe)
        if self.plant.begins_safe:
            self.controller.begin_at(self._resting_displacement)
        self.sample = 0

    def _resting_displacement(self) -> float:
        """Return the displacement [m] of the compensator's model after a reset, at the safe voltage of the plant."""
        return self.compensator.resting_displacement(self.plant.parameters.safe_voltage)

    @property
    def kind(self) -> signals.AxisKind:
        """Kind of the axis: actuator or inchworm motor."""
        return self.parameters.kind

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.plant_simulator.sample_rate

    @property
    def axes(self) -> tuple[Axis, ...]:
        """A tuple with this axis alone."""
        return (self,)

    @property
    def by_node(self) -> dict:
        """The parts by the names of their nodes."""
        return {
            "plant_simulator": self.plant,
            self.kind.source: self.source,
            "motion_controller": self.controller,
            "hysteresis_compensator": self.compensator,
            **({"displacement_camera": self.camera} if self.camera is not None else {}),
        }

    def default_samples(self) -> int:
        """Return the configured length of a run in samples; 0: no end."""
        return self.parameters.plant_simulator.samples or self.source.duration_samples

    def default_setpoints(self, samples: int) -> np.ndarray:
        """Return the configured setpoint [m] at each of the first ``samples`` samples."""
        return self.source.setpoints(samples)

    @property
    def laws(self) -> Laws:
        """The kernels of the present blocks."""
        compensator = self.compensator.compensator
        waveform = self.source.waveform or compensator.hysteresis_kernel
        model, inverse = compensator.hysteresis_kernel, compensator.inverse_kernel
        return Laws(*self.plant.kernels, waveform, self.controller.kernel, model, inverse)

    @property
    def interpreted_laws(self) -> Laws:
        """The kernels for a loop in Python, whose inverse need not be compiled again in each process."""
        return self.laws._replace(inverse=self.compensator.compensator.inverse_step)

    @property
    def parts(self) -> Parts:
        """The arrays of the present blocks."""
        return Parts(self.plant.arrays, self.source.arrays, self.controller.arrays, self.compensator.arrays)

    @property
    def given(self) -> np.ndarray:
        """Column indices of the run's inputs in a sample's row."""
        return np.array([*self.kind.given, *self.plant.given], dtype=float)

    def run(
        self,
        setpoints,
        *,
        requests=None,
        speeds=None,
        changes: Sequence[Change] = (),
        skipped=None,
        pulses=None,
        answers=None,
    ) -> dict[str, np.ndarray]:
        """Simulate ``len(setpoints)`` samples, one for each setpoint [m]."""
        setpoints = np.ascontiguousarray(setpoints, dtype=np.float64)
        count = len(setpoints)
        columns = np.empty((len(self.kind.row), count))
        given = {
            signals.SETPOINT: setpoints,
            signals.SKIPPED: 0.0 if skipped is None else skipped,
            signals.TRIGGER_IN: 0.0 if pulses is None else pulses,
            signals.REQUEST: 0.0 if requests is None else requests,
            signals.SPEED: math.nan if speeds is None else speeds,
        }
        for place in self.kind.given:
            columns[place] = given[place]
        for place in self.plant.given:
            columns[place] = 0.0 if answers is None else answers.get(signals.SIGNALS[place].name, math.nan)
        begin = self.sample
        first = 0
        waiting = sorted(changes, key=lambda change: (change.sample, STEPS[change.after]))
        while waiting:
            until = min(max(waiting[0].sample - begin, first), count)
            self._run(columns[:, first:until])
            first = until
            if waiting[0].after and until < count:
                now = [change for change in waiting if change.sample == waiting[0].sample]
                self._run_sample(columns[:, until : until + 1], now)
                first = until + 1
            else:
                now = waiting[:1]
                self.apply(now[0])
            waiting = waiting[len(now) :]
        self._run(columns[:, first:])
        self.sample = begin + count
        named = {signal.name: columns[index] for index, signal in enumerate(self.kind.row)}
        return {"time": sample_times(begin, count, self.sample_rate), **named}

    def _run(self, columns: np.ndarray, what: int = WHOLE, row: np.ndarray | None = None) -> None:
        """Compute one sample for each column; ``columns`` already contain the inputs."""
        if not columns.shape[1]:
            return
        whole = np.ascontiguousarray(columns)
        row = np.zeros(len(columns)) if row is None else row
        arguments = self.laws, self.parts, self.given, whole, row, what
        run = specialised_for(whole.shape[1], ticks, *arguments) if self.plant.is_compiled else ticks
        if run is ticks:
            arguments = self.interpreted_laws, *arguments[1:]
        with np.errstate(all="ignore"):  # as in machine code
            run(*arguments)
        if whole is not columns:
            columns[:] = whole

    def _run_sample(self, column: np.ndarray, changes: list[Change]) -> None:
        """Compute one sample step by step; the caller may change values between the steps."""
        row = np.zeros(len(column))
        for what, after in ((MEASURE, MEASURED), (ANSWER, ANSWERED), (CONFIRM, None)):
            self._run(column, what, row)
            for change in changes:
                if change.after == after:
                    self.apply(change)

    def with_plant(self, parameters: AxisParameters) -> Axis:
        """Return an axis with a new plant, and with the source, controller and compensator of this axis.

        The new axis takes over the other parts, which saves time when only the plant differs between runs. Do not use
        this axis afterwards.
        """
        other = copy.copy(self)
        other.parameters, other.sample = parameters, 0
        other.plant = PLANTS[parameters.plant_simulator.type](parameters.plant_simulator)
        return other

    def apply(self, change: Change, place: int = 0) -> None:
        """Start, stop or retune a part between two samples; ``place`` is 0 (the index of the only axis)."""
        part = self.by_node[change.node]
        if change.action == "retune":
            present = part.parameters
            part.retune(type(present).from_mapping({**present.to_mapping(), **change.parameters}))
        elif change.action == QUIET:
            self.forecast().require(**change.parameters)
            part.quiet(change.parameters[DURATION])
        else:
            getattr(part, change.action)(**change.parameters)

    def forecast(self) -> Forecast:
        """Return the forecast of the drift in a quiet hold, from the present state of the compensator."""
        return Forecast(self.compensator.compensator.creep, self.controller.parameters.quiet.creep_uncertainty)

    def inject(self, faults: tuple[str, ...]) -> None:
        """Replace the scheduled faults; their times are counted from the present sample."""
        for part in self.by_node.values():
            part.inject(faults)

    def reset(self) -> None:
        """Return all parts to their initial states."""
        for part in self.by_node.values():
            part.reset()
        self.sample = 0
