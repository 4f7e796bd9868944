# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A stage in the loop: several axes, each with the parts of a single axis, coupled by one structure.

In each sample of a stage every axis measures, and the sensor matrix transforms the readings into degrees of freedom.
Every axis then computes its reference and its command. The decoupling transforms these commands into commands of the
actuators. Every axis compensates its hysteresis and outputs its voltage. Finally the structure advances by one sample.

The row of an axis contains signals of its degree of freedom (``displacement``, ``measured``, ``command``, ``applied``)
and of its actuator (``voltage``, ``plant_voltage``). The compensators receive the product of decoupling and commands;
the inverse of the decoupling transforms their achieved commands back. After each sample the feedforward of the stage
takes the new references of all axes, and adds its contribution to the next commands of the axes
(:class:`.StageFeedforwardParameters`). A stage stops as a whole: when the plant of one axis trips, the other axes stop
too; and while the measurement of one axis is stale, all controllers go to their safe commands.
:mod:`hysteresis_ros.nodes.stage` applies the same rule to the nodes of a stage, in Python, with methods of
:class:`.Plant` and :func:`hold_with_stage`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.control import feedforward as feeding
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.axis import Axis, Change, sample_times
from hysteresis_ros.loop.compensator import compensate, note_output
from hysteresis_ros.loop.controller import RETURNING, STOP, carried_out, control
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import (
    PARTNER_LOST,
    TRIP,
    ActuatorPlant,
    Plant,
    PlantWatchArrays,
    actuate,
    sense,
    told_force,
    watched_voltage,
)
from hysteresis_ros.loop.source import refer
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.watch import is_stale
from hysteresis_ros.models import limits as limiting
from hysteresis_ros.models.actuator import DISPLACEMENT, PRELOAD, ActuatorArrays
from hysteresis_ros.models.block import each, kernel, nested, specialised_for
from hysteresis_ros.models.creep import creep
from hysteresis_ros.models.linear import linear
from hysteresis_ros.models.sensor import MEASURED, OFFSET, sensor
from hysteresis_ros.models.structure import Structure, structure_advance, structure_output


class CoupledPlantArrays(NamedTuple):
    """All arrays of one actuator and one sensor of a stage in the loop."""

    p: ActuatorArrays
    x: ActuatorArrays
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays
    drive: np.ndarray  #: shape (1,); Index of the structure's input that this actuator drives.
    shown: np.ndarray  #: shape (1,); Index of the structure's output that this sensor measures.


@nested
def sense_coupled(laws, arrays, row):
    """Read the sensor of one axis of a stage."""
    faulty.begin_sample(arrays.watch_x.faults)
    displacement = arrays.shown[0] + arrays.p.sensor[PRELOAD]
    arrays.x.sensor[DISPLACEMENT] = displacement
    row[at.MEASURED] = sensor(arrays.p.sensor, arrays.x.sensor, displacement)
    row[at.FORCE] = told_force(arrays.watch_p, arrays.watch_x, math.nan)
    row[at.DISPLACEMENT] = displacement
    row[at.PLANT_VOLTAGE] = arrays.x.limits[limiting.OUTPUT]
    row[at.TRIPPED] = arrays.watch_x.trip[TRIP]


@nested
def actuate_coupled(laws, arrays, row):
    """Hold the voltage on one actuator of a stage, and compute the input of the structure."""
    p, x = arrays.p, arrays.x
    applied = limiting.limits(p.limits, x.limits, watched_voltage(arrays.watch_p, arrays.watch_x, row))
    crept = creep(p.creep, x.creep, laws.hysteresis(p.hysteresis, x.hysteresis, applied))
    # these dynamics are only the delay of amplifier and converter; the rest belongs to the structure
    arrays.drive[0] = linear(p.dynamics, x.dynamics, crept)
    row[at.PLANT_VOLTAGE] = applied


sense.kinds[CoupledPlantArrays], actuate.kinds[CoupledPlantArrays] = sense_coupled, actuate_coupled


class CoupledPlant(ActuatorPlant):
    """One actuator and one sensor of a stage."""

    def __init__(self, parameters: PlantNodeParameters, drive: np.ndarray, shown: np.ndarray, travel):
        self._travel = (float(travel[0]), float(travel[1]))
        super().__init__(parameters)
        self.arrays = CoupledPlantArrays(self.actuator.ps, self.actuator.xs, self._watch_p, self._watch_x, drive, shown)

    @property
    def travel(self) -> tuple[float, float]:
        """Allowed range of the measured degree of freedom [m]."""
        return self._travel

    @property
    def resting_drive(self) -> float:
        """Input of the structure at rest, before any voltage is received."""
        return self.actuator.dynamics.output()

    def note_rest(self, displacement: float) -> None:
        """Set the sensor to the rest position of the structure [m]."""
        p, x = self.actuator.ps.sensor, self.actuator.xs.sensor
        x[DISPLACEMENT] = displacement + p[PRELOAD]
        x[MEASURED] = x[DISPLACEMENT] + p[OFFSET]


class GroupArrays(NamedTuple):
    """Arrays that the axes of a stage share."""

    p: np.ndarray  #: Parameters of the structure.
    x: np.ndarray
    drive: np.ndarray  #: shape (n,); Inputs of the structure.
    shown: np.ndarray  #: shape (n,); Outputs of the structure [m].
    sensor_matrix: np.ndarray  #: shape (n, n), or (0, 0): each sensor measures its axis.
    decoupling: np.ndarray  #: shape (n, n), or (0, 0): each actuator drives its axis.
    recoupling: np.ndarray  #: Inverse of the decoupling, of the same shape.
    commands: np.ndarray  #: shape (n,); Last finite command of each degree of freedom [m].
    asked: np.ndarray  #: shape (n,); Commands of the actuators [m].
    scratch: np.ndarray  #: shape (2 n,); Work space.
    weights: np.ndarray  #: shape (n, n, 2 N), or (0, 0, 0); Weights of the feedforward of the stage.
    references: np.ndarray  #: shape (n, 2 N); Rings of the last references [m].
    places: np.ndarray  #: shape (n,); Index of the oldest reference in each ring.
    known: np.ndarray  #: shape (n,); 0: the ring restarts with the next reference.


@kernel
def combined(matrix, i, values, first):
    """Return row ``i`` of a matrix times the values from index ``first`` on; a factor of 0 ignores even a NaN."""
    total = 0.0
    for j in range(matrix.shape[1]):
        if matrix[i, j] != 0.0:
            total += matrix[i, j] * values[first + j]
    return total


@nested
def to_pose(group, rows):
    """Transform the readings of the sensors, and the true displacements there, into degrees of freedom."""
    n = group.sensor_matrix.shape[0]
    for i in range(n):
        group.scratch[i] = rows[i, at.MEASURED]
        group.scratch[n + i] = rows[i, at.DISPLACEMENT]
    for i in range(n):
        rows[i, at.MEASURED] = combined(group.sensor_matrix, i, group.scratch, 0)
        rows[i, at.DISPLACEMENT] = combined(group.sensor_matrix, i, group.scratch, n)


@nested
def to_actuators(group, rows):
    """Transform commands of degrees of freedom into commands of actuators; a missing command stays missing."""
    n = group.decoupling.shape[0]
    for i in range(n):
        command = rows[i, at.COMMAND]
        group.scratch[i] = command
        if command - command == 0.0:
            group.commands[i] = command
    for i in range(n):
        group.asked[i] = combined(group.decoupling, i, group.commands, 0)
        if group.scratch[i] - group.scratch[i] == 0.0:
            rows[i, at.COMMAND] = group.asked[i]


@nested
def to_axes(group, rows):
    """Transform the actuators' achieved commands into those of the axes; restore the axes' own commands."""
    n = group.decoupling.shape[0]
    for i in range(n):
        missing = rows[i, at.APPLIED] - group.asked[i]
        group.scratch[n + i] = missing if missing - missing == 0.0 else 0.0
    for i in range(n):
        rows[i, at.COMMAND] = group.scratch[i]
        # only the difference from the command is transformed, so that a fully achieved command has no rounding error
        rows[i, at.APPLIED] = group.commands[i] + combined(group.recoupling, i, group.scratch, n)


@kernel
def crossed(weights, references, places, known, i):
    """Return the contribution of a stage's feedforward to the next command of axis ``i`` [m]."""
    total = 0.0
    length = weights.shape[2]
    for j in range(weights.shape[1]):
        if known[j] != 0.0:
            place = int(places[j])
            for m in range(length):
                total += weights[i, j, m] * references[j, place]
                place += 1
                if place == length:
                    place = 0
    return total


@nested
def feed_across(group, rows):
    """Take the new references of all axes from :func:`report_reference`; write the resulting commands into the rows."""
    length = group.references.shape[1]
    for j in range(rows.shape[0]):
        place = int(group.places[j])
        if rows[j, at.CONTROLLER_MODE] < 0.0:
            group.known[j] = 0.0
        elif rows[j, at.CONTROLLER_MODE] > 0.0:
            if group.known[j] == 0.0:
                # all earlier references are assumed to equal this reference
                group.known[j] = 1.0
                group.references[j, :] = rows[j, at.TRIPPED]
            group.references[j, place] = rows[j, at.TRIPPED]
            group.places[j] = float(place + 1 if place + 1 < length else 0)
    for i in range(rows.shape[0]):
        rows[i, at.TRIPPED] = crossed(group.weights, group.references, group.places, group.known, i)


@nested
def advance_structure(group):
    """Advance the structure by one sample with held inputs."""
    structure_advance(group.p, group.x, group.drive)
    structure_output(group.p, group.x, group.drive, group.shown)


@each
def measure_axis(laws, parts, row):
    """Measure one axis."""
    sense(laws, parts.plant, row)


@each
def command_axis(laws, parts, row):
    """Compute reference and command of one axis."""
    refer(laws, parts.source, row)
    control(laws, parts.controller, row)


@each
def drive_axis(laws, parts, row):
    """Compute and hold the voltage of one actuator."""
    compensate(laws, parts.compensator, row)
    actuate(laws, parts.plant, row)
    note_output(parts.compensator.watch_p.own, row)


@each
def confirm_axis(laws, parts, row):
    """Give the controller of one axis its achieved command."""
    carried_out(parts.controller, row[at.APPLIED])


@kernel
def report_reference(feedforward, own, row):
    """Write newest reference and number of new references (-1: the axis does not follow) into an axis' row."""
    row[at.TRIPPED] = feedforward[feeding.NEWEST]
    row[at.CONTROLLER_MODE] = -1.0 if own[RETURNING] != 0.0 else feedforward[feeding.CALLS]
    feedforward[feeding.CALLS] = 0.0


@each
def show_reference(laws, parts, row):
    """Report the newest reference of one axis."""
    report_reference(parts.controller.x.feedforward, parts.controller.watch_x.own, row)


@each
def take_command(laws, parts, row):
    """Pass the stage's contribution to an axis' next command to the feedforward of that axis."""
    parts.controller.x.feedforward[feeding.GIVEN] = row[at.TRIPPED]


#: Value of a controller's ``STOP`` while the measurement of another axis is stale (1: stopped by a user).
WITH_STAGE = 2.0


@kernel
def hold_with_stage(own, held):
    """Stop a controller with its stage (``held`` 1), or resume it (0); ``own`` is the controller's state."""
    if held != 0.0 and own[STOP] == 0.0:
        own[STOP] = WITH_STAGE
    elif held == 0.0 and own[STOP] == WITH_STAGE:
        own[STOP] = 0.0
        own[RETURNING] = 1.0


@each
def find_trip(laws, parts, row):
    """Write the reason why the plant is stopped (0: none), and whether the measurement is stale, into a row."""
    row[at.TRIPPED] = parts.plant.watch_x.trip[TRIP]
    row[at.CONTROLLER_MODE] = 0.0
    if is_stale(parts.controller.watch_p.guard, parts.controller.watch_x.guard):
        row[at.CONTROLLER_MODE] = 1.0


@each
def stop_axis(laws, parts, row):
    """Stop one axis because another axis of its stage is stopped."""
    if parts.plant.watch_x.trip[TRIP] == 0.0:
        parts.plant.watch_x.trip[TRIP] = PARTNER_LOST


@each
def hold_axis(laws, parts, row):
    """Stop the controller of one axis while its row reports that the measurement of another axis is stale."""
    hold_with_stage(parts.controller.watch_x.own, row[at.CONTROLLER_MODE])


def stage_ticks(laws, parts, group, given, columns, rows):
    """Compute ``columns.shape[2]`` samples of all axes; all states are updated in place.

    The body of the loop is one sample of the stage; ``laws`` and ``parts`` are tuples with an entry for each axis.
    """
    for k in range(columns.shape[2]):
        for i in range(rows.shape[0]):
            for j in range(given.shape[0]):
                place = int(given[j])
                rows[i, place] = columns[i, place, k]
        measure_axis(laws, parts, rows)
        to_pose(group, rows)
        command_axis(laws, parts, rows)
        to_actuators(group, rows)
        drive_axis(laws, parts, rows)
        to_axes(group, rows)
        advance_structure(group)
        confirm_axis(laws, parts, rows)
        for i in range(rows.shape[0]):
            for j in range(rows.shape[1]):
                columns[i, j, k] = rows[i, j]
        if group.weights.shape[0] > 0:
            show_reference(laws, parts, rows)
            feed_across(group, rows)
            take_command(laws, parts, rows)
        find_trip(laws, parts, rows)
        stopped = stale = 0.0
        for i in range(rows.shape[0]):
            stopped = max(stopped, abs(rows[i, at.TRIPPED]))
            stale = max(stale, rows[i, at.CONTROLLER_MODE])
        if stopped != 0.0:
            stop_axis(laws, parts, rows)
        for i in range(rows.shape[0]):
            rows[i, at.CONTROLLER_MODE] = stale - rows[i, at.CONTROLLER_MODE]
        hold_axis(laws, parts, rows)


class Coupling:
    """The coupling of the axes of a stage: the structure between actuators and sensors, and the matrices."""

    def __init__(self, parameters: StageParameters):
        count, stage, none = len(parameters.axes), parameters.stage, np.zeros((0, 0))
        weights = stage.feedforward.matrix(count)
        self.structure = Structure(stage.structure, 1.0 / parameters.sample_rate)
        self._travel = parameters.travel()
        self.arrays = GroupArrays(
            p=self.structure.p,
            x=self.structure.x,
            drive=np.zeros(count),
            shown=np.zeros(count),
            sensor_matrix=stage.matrix("sensor_matrix") if stage.sensor_matrix else none,
            decoupling=stage.matrix("decoupling") if stage.decoupling else none,
            recoupling=parameters.recoupling() if stage.decoupling else none,
            commands=np.zeros(count),
            asked=np.zeros(count),
            scratch=np.zeros(2 * count),
            weights=weights,
            references=np.zeros((count, weights.shape[2])),
            places=np.zeros(count),
            known=np.zeros(count),
        )

    def plant(self, place: int, parameters: PlantNodeParameters) -> CoupledPlant:
        """Return the actuator and the sensor of the axis with this index."""
        own = slice(place, place + 1)
        return CoupledPlant(parameters, self.arrays.drive[own], self.arrays.shown[own], self._travel[place])

    def settle(self, plants: Sequence[Plant]) -> None:
        """Bring the structure to rest at the initial voltages of all plants; devices need no structure."""
        group = self.arrays
        coupled = [plant for plant in plants if isinstance(plant, CoupledPlant)]
        group.commands[:] = group.asked[:] = group.known[:] = 0.0
        if not coupled:
            return
        group.drive[:] = [plant.resting_drive for plant in coupled]
        self.structure.settle(group.drive)
        structure_output(group.p, group.x, group.drive, group.shown)
        for plant, displacement in zip(coupled, group.shown, strict=True):
            plant.note_rest(float(displacement))


class Stage:
    """The parts of all axes of a stage in closed loop, without ROS.

    ``devices`` replace the simulated plants of all axes and the structure that couples them.
    """

    def __init__(self, parameters: StageParameters, devices: Sequence[Plant] = ()):
        self.parameters = parameters
        self._coupling = Coupling(parameters)
        self.plants: tuple[Any, ...] = tuple(devices) or tuple(
            self._coupling.plant(i, axis.plant_simulator) for i, axis in enumerate(parameters.axes)
        )
        self.axes = tuple(Axis(axis, plant) for axis, plant in zip(parameters.axes, self.plants, strict=True))
        self.sample = 0
        self._coupling.settle(self.plants)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.parameters.names

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    @property
    def kind(self) -> at.AxisKind:
        """Kind of the axes: a stage has actuators."""
        return at.ACTUATOR

    @property
    def laws(self) -> tuple:
        """The kernels of the present blocks of each axis."""
        return tuple(axis.laws for axis in self.axes)

    @property
    def parts(self) -> tuple:
        """The arrays of the present blocks of each axis."""
        return tuple(axis.parts for axis in self.axes)

    @property
    def group(self) -> GroupArrays:
        """The arrays that the axes share."""
        return self._coupling.arrays

    @property
    def given(self) -> np.ndarray:
        """Column indices of the run's inputs in an axis' row."""
        return np.array([*self.kind.given, *self.plants[0].given], dtype=float)

    def default_samples(self) -> int:
        """Return the configured length of a run in samples: the longest of all axes; 0: no end."""
        return max(axis.default_samples() for axis in self.axes)

    def default_setpoints(self, samples: int) -> dict[str, np.ndarray]:
        """Return the configured setpoint [m] of each axis at each of the first ``samples`` samples."""
        return {name: axis.default_setpoints(samples) for name, axis in zip(self.names, self.axes, strict=True)}

    def run(
        self,
        setpoints: Mapping[str, Sequence[float] | np.ndarray],
        changes: Mapping[str, Sequence[Change]] | None = None,
        skipped: np.ndarray | None = None,
        pulses: Mapping[str, np.ndarray] | None = None,
        answers: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    ) -> dict[str, dict[str, np.ndarray]]:
        """Simulate one sample for each setpoint [m]; return the signals of each axis, including ``time``.

        The keys of all mappings are the names of the axes. ``pulses`` are the pulses at the trigger inputs; ``answers``
        are the answers of each axis' device in the repeated run. ``skipped`` is 1 for a sample that all axes skip,
        otherwise 0.
        """
        waiting = self._sorted(changes or {})
        given = self.given
        columns = np.zeros((len(self.axes), at.ACTUATOR_ROW, self._length(setpoints)))
        for i, name in enumerate(self.names):
            columns[i, at.SETPOINT] = setpoints[name]
            columns[i, at.SKIPPED] = 0.0 if skipped is None else skipped
            columns[i, at.TRIGGER_IN] = (pulses or {}).get(name, 0.0)
            for place in self.plants[i].given:
                columns[i, place] = (answers or {}).get(name, {}).get(at.SIGNALS[place].name, math.nan)
        begin, count, first = self.sample, columns.shape[2], 0
        rows = np.zeros(columns.shape[:2])
        for change, place in waiting:
            until = min(max(change.sample - begin, first), count)
            self._run(columns, first, until, given, rows)
            first = until
            self.apply(change, place)
        self._run(columns, first, count, given, rows)
        self.sample = begin + count
        time = sample_times(begin, count, self.sample_rate)
        listed = at.ACTUATOR.row
        return {
            name: {"time": time, **{signal.name: columns[i, j] for j, signal in enumerate(listed)}}
            for i, name in enumerate(self.names)
        }

    def _length(self, setpoints) -> int:
        """Return the number of samples of a run with these setpoints."""
        if set(setpoints) != set(self.names):
            given = ", ".join(setpoints) or "none"
            raise ConfigurationError(f"setpoints are given for {given}: give them for {', '.join(self.names)}")
        lengths = {name: len(values) for name, values in setpoints.items()}
        if len(set(lengths.values())) > 1:
            text = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise ConfigurationError(f"setpoints have different lengths ({text}): give the same number for each axis")
        return next(iter(lengths.values()))

    def apply(self, change: Change, place: int) -> None:
        """Start, stop or retune a part of axis number ``place`` between two samples."""
        self.axes[place].apply(change)
        if (change.node, change.action) == ("plant_simulator", "reset"):
            self._coupling.settle(self.plants)
        elif (change.node, change.action) == ("motion_controller", "reset"):
            self.group.known[place] = 0.0

    def _sorted(self, changes) -> list[tuple[Change, int]]:
        """Return the changes of all axes, each with the index of its axis, in the order of their samples."""
        found = [(change, self.parameters.place(name)) for name, some in changes.items() for change in some]
        within = next((change for change, _ in found if change.after), None)
        if within is not None:
            raise ConfigurationError(
                f"a change of {within.node} takes effect within sample {within.sample}: a stage accepts changes "
                f"only between two samples"
            )
        return sorted(found, key=lambda item: item[0].sample)

    def _run(self, columns, first: int, until: int, given, rows) -> None:
        """Compute the samples ``first`` … ``until`` - 1 of the columns, which already contain the inputs."""
        if until == first:
            return
        some = np.ascontiguousarray(columns[:, :, first:until])
        arguments = self.laws, self.parts, self.group, given, some, rows
        run = specialised_for(some.shape[-1] * len(self.axes), stage_ticks, *arguments)
        if run is stage_ticks:
            arguments = tuple(axis.interpreted_laws for axis in self.axes), *arguments[1:]
        with np.errstate(all="ignore"):  # as in machine code
            run(*arguments)
        columns[:, :, first:until] = some

    def start(self) -> None:
        """Restart all axes after an axis has stopped the stage."""
        for axis in self.axes:
            axis.plant.start()

    def reset(self) -> None:
        """Return all parts to their initial states."""
        for axis in self.axes:
            axis.reset()
        self._coupling.structure.reset()
        self._coupling.settle(self.plants)
        self.sample = 0
