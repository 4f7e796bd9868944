# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Many independent axes in one call, such as the actuators of a deformable mirror.

The axes have the same structure: the same kernels, and arrays of the same shapes. Their parameters may differ. All
arrays of an axis are slices of one row of memory, at the same offsets for every axis, so one compiled loop advances
from axis to axis by moving pointers. The loop runs the same tick as for a single axis, so each axis of an array gives
the same bits as an axis alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import parameter
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, did_you_mean
from hysteresis_ros.loop.axis import Axis, sample_times
from hysteresis_ros.loop.parameters import COUNTABLE, NODE_PARAMETERS, AxisParameters, NodeParameters
from hysteresis_ros.loop.reach import check_reach
from hysteresis_ros.loop.simulation import run_metadata
from hysteresis_ros.loop.tick import WHOLE, Parts, tick
from hysteresis_ros.models.block import Stored, contents, direct, displaced, specialised
from hysteresis_ros.recordings.dataset import Recording, note_output, output_tolerance
from hysteresis_ros.references.approach import HIGH, LOW

#: Largest number of axes of an array, and of threads that share the axes.
MOST_AXES, MOST_THREADS = 4096, 256
#: Signals that a run keeps by default.
KEPT = (
    *("reference", "command", "voltage", "displacement", "measured"),
    *("saturated", "tripped", "plant_voltage", "plant_mode"),
)
#: Arrays with more numbers than this are stored at the end of an axis' row, because most of their memory is not used.
LONG = 512
#: Alignment of the rows [numbers], so that two axes never share a cache line.
LINE = 8
#: Node of each field of :class:`.Parts` (``NODES``), and the indices of its kernels in :class:`.Laws` (``OF_PART``).
NODES = {
    "plant": "plant_simulator",
    "source": "reference_generator",
    "controller": "motion_controller",
    "compensator": "hysteresis_compensator",
}
OF_PART = {"plant": slice(0, 3), "source": slice(3, 4), "controller": slice(4, 5), "compensator": slice(5, 7)}


def ticks_of_all(stored, stride, first, rows, setpoints, kept, found):
    """Compute ``setpoints.shape[1]`` samples of each axis; all states and rows are updated in place.

    ``stored`` contains the kernels and the arrays of axis 0; the arrays of axis i begin ``stride`` · i numbers later.
    The first entry of ``rows``, ``setpoints`` and ``found`` belongs to axis ``first``. The signals with the indices
    ``kept`` are copied into ``found``.
    """
    laws, parts = contents(stored)
    for i in range(rows.shape[0]):
        own, row = displaced(parts, (first + i) * stride), rows[i]
        for k in range(setpoints.shape[1]):
            row[at.SETPOINT] = setpoints[i, k]
            row[at.SKIPPED] = 0.0
            tick(laws, own, row, WHOLE)
            for j in range(kept.shape[0]):
                found[i, j, k] = row[int(kept[j])]


@dataclass(frozen=True, eq=False)
class ArrayRun:  # numpydoc ignore=PR02
    """Signals of a run of many axes, by name: ``run.displacement`` or ``run["displacement"]``, shape (n, N).

    Parameters
    ----------
    time : ndarray, shape (N,)
        Instants [s], the same for all axes.
    signals : dict of str to ndarray, shape (n, N)
        Signals of all axes in SI units.
    parameters : tuple of AxisParameters
        Parameters of each axis.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> run = hr.simulate("kim2009", axes=3, duration=0.01)
    >>> run.displacement.shape, run.axis(2).displacement.shape
    ((3, 30), (30,))
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]
    parameters: tuple[AxisParameters, ...]

    def __len__(self) -> int:
        return len(next(iter(self.signals.values())))

    def __getitem__(self, name: str) -> np.ndarray:
        if name in self.signals:
            return self.signals[name]
        remedy = f"the run has no such signal; it has {', '.join(self.signals)}{did_you_mean(name, self.signals)}"
        raise ParameterError([Problem("signal", name, remedy)])

    def __getattr__(self, name: str) -> np.ndarray:
        # called only for missing attributes; while an object is copied or unpickled, it has no signals yet
        signals = self.__dict__.get("signals", {})
        if name in signals:
            return signals[name]
        raise AttributeError(f"the run has no signal or attribute {name!r}; the signals are {', '.join(signals)}")

    def __repr__(self) -> str:
        return f"ArrayRun of {len(self)} axes and {len(self.time)} samples: {', '.join(self.signals)}"

    def axis(self, number: int, describe: bool = True) -> Recording:
        """Return the run of one axis; ``voltage`` is the voltage that the actuator received.

        Parameters
        ----------
        number : int
            Number of the axis, from 0.
        describe : bool
            Write the configuration of the axis into the recording; this takes most of the time.

        Returns
        -------
        Recording
            Copies of the signals of the axis, for figures, plots and reports.

        Raises
        ------
        ParameterError
            There is no such axis.
        """
        if not 0 <= number < len(self):
            raise ParameterError([Problem("axis", number, f"the axes are 0 … {len(self) - 1}")])
        own = self.parameters[number]
        signals = {name: values[number].copy() for name, values in self.signals.items()}
        if {"plant_voltage", "plant_mode"} <= signals.keys():
            nodes = (own.plant_simulator, own.hysteresis_compensator)
            tolerance = output_tolerance(*(node.to_mapping() for node in nodes))
            note_output(signals, signals["plant_voltage"], signals["plant_mode"], tolerance)
        return Recording(self.time, signals, {}, run_metadata(own, describe))


class AxisArray:
    """Independent axes of the same structure, which one compiled call advances; create it with :func:`.axis_array`.

    Parameters
    ----------
    parameters : sequence of AxisParameters
        Parameters of each axis, 1 … 4096 axes.
    threads : int
        Threads that share the axes. The results do not depend on the number of threads.

    Raises
    ------
    ParameterError
        The number of axes or threads is out of range.
    ConfigurationError
        The axes differ in their structure, or are not simulated actuators; the message names axis and node.

    Examples
    --------
    >>> import numpy as np
    >>> import hysteresis_ros as hr
    >>> mirror = hr.axis_array("kim2009", 64)
    >>> voltages = mirror.step(np.linspace(0.0, 1e-6, 64))
    >>> voltages.shape, mirror["displacement"].shape
    ((64,), (64,))
    """

    def __init__(self, parameters: Sequence[AxisParameters], threads: int = 1):
        count = whole_number("axes", len(parameters), MOST_AXES)
        self.parameters = tuple(parameters)
        self._threads = min(whole_number("threads", threads, MOST_THREADS), count)
        axis = _axis_of(self.parameters[0], 0)
        self._axis = axis
        self.places, self.stride = _places(axis.parts)
        self.memory = np.zeros(count * self.stride)
        self._settle(axis)
        self.rows = np.zeros((count, at.ACTUATOR_ROW))
        self._bounds = np.linspace(0, count, self._threads + 1).astype(int).tolist()
        self._pool = ThreadPoolExecutor(self._threads - 1, "axes") if self._threads > 1 else None
        nothing = np.zeros((1, 1)), np.zeros(0), np.zeros((1, 0, 1))
        self._stored = Stored(axis.laws, _at_places(axis.parts, self.memory, iter(self.places)))
        compute = specialised(ticks_of_all, self._stored, self.stride, 0, self.rows, *nothing)
        self._compute: Callable[..., None] = direct(compute)
        self.sample = 0

    def _settle(self, axis: Axis) -> None:
        """Write the arrays of all axes, at rest, into the memory."""
        table = self.memory.reshape(len(self.parameters), self.stride)
        shapes = [array.shape for _, array in _leaves(axis.parts)]
        built, filled, values = axis, np.zeros(0, dtype=int), np.zeros(0)
        for number, parameters in enumerate(self.parameters):
            if not number or parameters is not built.parameters:
                built = axis if not number else _axis_of(parameters, number, built)
                leaves = list(_leaves(built.parts))
                self._require_same_structure(number, axis, built, shapes)
                # zeros are not written, because the system allocates memory only when it is written
                inside = [np.flatnonzero(array) for _, array in leaves]
                filled = np.concatenate([place + some for place, some in zip(self.places, inside, strict=True)])
                values = np.concatenate([array.flat[some] for (_, array), some in zip(leaves, inside, strict=True)])
            table[number, filled] = values

    def _require_same_structure(self, number: int, first: Axis, axis: Axis, shapes: list[tuple[int, ...]]) -> None:
        """Refuse an axis whose structure differs from the structure of axis 0."""
        found = [(path.partition(".")[0], array) for path, array in _leaves(axis.parts)]
        strange = {part for (part, array), shape in zip(found, shapes, strict=False) if array.shape != shape}
        strange |= {part for part, some in OF_PART.items() if axis.laws[some] != first.laws[some]}
        strange |= {part for part in NODES if type(getattr(axis.parts, part)) is not type(getattr(first.parts, part))}
        if strange:
            names = ", ".join(node for part, node in NODES.items() if part in strange)
            raise ConfigurationError(
                f"axis {number}: {names}: the structure differs from that of axis 0 (its type, order or array "
                "length); only values may differ between the axes of an array"
            )

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self._axis.sample_rate

    @property
    def initial_setpoints(self) -> np.ndarray:
        """The configured setpoint of every axis [m], shape (n,)."""
        return np.array([parameters.generator.initial_setpoint for parameters in self.parameters])

    @property
    def setpoint_range(self) -> np.ndarray:
        """Smallest and largest setpoint that each axis accepts [m], shape (n, 2)."""
        names = [path for path, _ in _leaves(self._axis.parts)]
        first = self.places[names.index("source.p.approach")]
        return self.memory.reshape(len(self), self.stride)[:, [first + LOW, first + HIGH]]

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the last value of a signal on every axis, shape (n,)."""
        return self.rows[:, _signal_place(name)].copy()

    def step(self, setpoints: ArrayLike) -> np.ndarray:
        """Advance every axis by one sample.

        Parameters
        ----------
        setpoints : array_like, shape (n,) or ()
            Setpoint of each axis [m], or one setpoint for all axes.

        Returns
        -------
        ndarray, shape (n,)
            Voltage of each axis [V]. Other signals of the sample are available by name: ``array["displacement"]``.

        Raises
        ------
        ParameterError
            The number of setpoints differs from the number of axes.
        """
        given = _numbers(setpoints)
        if given.shape not in ((), (len(self),)):
            raise ParameterError([_misshapen(given, f"({len(self)},), or one number for all")])
        given = np.ascontiguousarray(np.broadcast_to(given, len(self))).reshape(-1, 1)
        self._advance(given, np.zeros(0), np.empty((len(self), 0, 1)))
        return self["voltage"]

    def run(
        self, setpoints: ArrayLike | None = None, samples: int | None = None, signals: Sequence[str] = KEPT
    ) -> ArrayRun:
        """Advance every axis by many samples.

        Parameters
        ----------
        setpoints : array_like, shape (n, N) or (N,), optional
            Setpoints of each axis [m], or one row for all axes; by default the configured setpoints.
        samples : int, optional
            Number of samples; by default the number of setpoints, or the configured length of a run.
        signals : sequence of str
            Signals to keep.

        Returns
        -------
        ArrayRun
            The signals, shape (n, N).

        Raises
        ------
        ParameterError
            The shape of the setpoints does not fit, or a signal does not exist.
        ConfigurationError
            The run has no end.
        """
        if samples is not None:
            whole_number("samples", samples, int(COUNTABLE))
        if setpoints is None:
            count = self._axis.default_samples() if samples is None else samples
            if count < 1:
                raise ConfigurationError("the run has no end (samples: 0, endless waveform): give its duration")
            given = np.repeat(self.initial_setpoints[:, None], count, axis=1)
        else:
            given = _numbers(setpoints)
            if given.ndim == 1:
                given = np.broadcast_to(given, (len(self), given.size))
            if given.ndim != 2 or len(given) != len(self) or not given.size:
                raise ParameterError([_misshapen(given, f"({len(self)}, N) or (N,)")])
            # as in the run of one axis, the last setpoint is held
            count = given.shape[1] if samples is None else samples
            given = np.ascontiguousarray(given[:, np.minimum(np.arange(count), given.shape[1] - 1)])
        kept = np.array([_signal_place(name) for name in signals], dtype=float)
        found = np.empty((len(self), len(signals), given.shape[1]))
        first = self.sample
        self._advance(given, kept, found)
        time = sample_times(first, given.shape[1], self.sample_rate)
        return ArrayRun(time, {name: found[:, i] for i, name in enumerate(signals)}, self.parameters)

    def _advance(self, setpoints: np.ndarray, kept: np.ndarray, found: np.ndarray) -> None:
        """Compute the samples of all axes; each thread handles a slice of the axes."""

        slices = [slice(*ends) for ends in zip(self._bounds[:-1], self._bounds[1:], strict=True)]
        fixed = self._stored, self.stride
        calls = [(*fixed, own.start, self.rows[own], setpoints[own], kept, found[own]) for own in slices]
        others = [self._pool.submit(self._compute, *call) for call in calls[1:]] if self._pool is not None else []
        try:
            self._compute(*calls[0])
        finally:
            for other in others:
                other.result()
        self.sample += setpoints.shape[1]


@dataclass(frozen=True)
class ArrayNodeParameters(NodeParameters):
    """Parameters of ``axis_array``: many independent axes with the parameters of the file's other sections."""

    axes: int = parameter(1, low=1, high=MOST_AXES, read_only=True, description="number of axes")
    threads: int = parameter(1, low=1, high=MOST_THREADS, read_only=True, description="threads that share the axes")
    each: str = parameter(
        "",
        read_only=True,
        description="NPZ file with values that differ between the axes: arrays of one number for each axis, named "
        "NODE.PARAMETER, e.g. plant_simulator.sensor.seed; empty: all axes are equal",
        place="files",
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="length of a run in samples; 0 = without end"
    )
    real_time_factor: float = parameter(
        1.0, low=1.0e-6, high=1.0e3, read_only=True, description="realtime: simulated seconds per second of wall clock"
    )
    wait_for_setpoints: bool = parameter(
        False,
        read_only=True,
        description="lockstep: each sample waits for a new message on setpoints, at most for partner_timeout",
    )
    path: str = parameter(
        "",
        read_only=True,
        description="folder of the bag, which must not exist; empty: nothing is recorded",
        place="files",
    )
    min_space: int = parameter(
        2 * 10**8,
        unit="B",
        low=0,
        high=10**15,
        description="free space on the disk below which the recording ends; the axes continue",
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.time_mode == "fused":
            yield Problem("time_mode", self.time_mode, "must be lockstep or realtime: an array is one node already")
        if self.wait_for_setpoints and self.time_mode != "lockstep":
            yield Problem("wait_for_setpoints", True, f"needs time_mode: lockstep, not {self.time_mode}")


def whole_number(name: str, value, most: int) -> int:
    """Return a whole number within 1 … ``most``; for any other value raise a ParameterError that names ``name``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= most:
        raise ParameterError([Problem(name, value, f"must be a whole number within 1 … {most}")])
    return int(value)


def parameters_of_each(
    parameters: AxisParameters, count: int, each: Mapping[str, Sequence[Any] | np.ndarray] | None = None
) -> list[AxisParameters]:
    """Return the parameters of ``count`` axes; ``each`` maps ``NODE.PARAMETER`` to one value for each axis."""
    whole_number("axes", count, MOST_AXES)
    columns: dict[str, dict[str, list]] = {}
    for target, values in (each or {}).items():
        node, _, name = target.partition(".")
        columns.setdefault(node, {})[name] = _column(parameters, count, target, values)
    if not columns:
        return [parameters] * count
    parts = {name: getattr(parameters, name) for name in NODE_PARAMETERS}
    found = []
    for number in range(count):
        changed = {
            node: parts[node].with_values(
                {name: values[number] for name, values in some.items()}, f"axis {number}: {node}: "
            )
            for node, some in columns.items()
        }
        found.append(AxisParameters.of_nodes(parameters.namespace, {**parts, **changed}))
        if set(columns) != {"plant_simulator"}:
            check_reach(found[-1])
    return found


def _column(parameters: AxisParameters, count: int, target: str, values) -> list:
    """Return the values of one parameter for each axis, in the type of the parameter."""
    node, _, name = target.partition(".")
    present = [known for known in NODE_PARAMETERS if getattr(parameters, known) is not None]
    rows = {row.name: row for row in NODE_PARAMETERS[node].table()} if node in present else {}
    if name not in rows:
        near = did_you_mean(name, rows) if rows else did_you_mean(node, present)
        raise ParameterError([Problem("each", target, f"is not NODE.PARAMETER of this axis{near}")])
    if isinstance(values, str) or np.ndim(values) == 0 or len(values) != count:
        got = values if isinstance(values, str) or np.ndim(values) == 0 else len(values)
        remedy = f"give one value for each of the {count} axes"
        raise ParameterError([Problem(f"each: number of values of {target}", got, remedy)])
    return [
        replace(rows[name], name=f"axis {number}: {target}").convert(np.asarray(value).tolist())
        for number, value in enumerate(values)
    ]


def _axis_of(parameters: AxisParameters, number: int, before: Axis | None = None) -> Axis:
    """Return one axis; if only its plant differs from that of ``before``, it shares all other parts with ``before``."""
    plant = parameters.plant_simulator
    if plant.type != "actuator":
        raise ConfigurationError(
            f"axis {number}: plant_simulator: type = {plant.type!r}: an array contains only simulated actuators; run "
            "an inchworm motor or a camera as a single axis"
        )
    shared = [name for name in NODE_PARAMETERS if name != "plant_simulator"]
    # in a fused axis the compensator depends on the plant
    if before is None or plant.time_mode == "fused":
        return Axis(parameters)
    same = all(getattr(parameters, name) is getattr(before.parameters, name) for name in shared)
    return before.with_plant(parameters) if same else Axis(parameters)


def _leaves(arrays, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of nested named tuples with their paths."""
    for name in arrays._fields:
        value, place = getattr(arrays, name), f"{path}{name}"
        if isinstance(value, tuple):
            yield from _leaves(value, f"{place}.")
        else:
            yield place, value


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _places(parts: Parts) -> tuple[list[int], int]:
    """Return the index in the row of an axis at which each array begins, and the length of the row.

    Arrays that share memory continue to share it.
    """
    leaves = [array for _, array in _leaves(parts)]
    owners = [array if array.base is None else array.base for array in leaves]
    whole = sorted({_address(owner): owner.size for owner in owners}.items(), key=lambda item: item[1] > LONG)
    places, length = {}, 0
    for address, size in whole:
        places[address] = length
        length += size
    found = [
        places[_address(owner)] + (_address(array) - _address(owner)) // array.itemsize
        for array, owner in zip(leaves, owners, strict=True)
    ]
    return found, -(-length // LINE) * LINE


def _at_places(arrays, memory: np.ndarray, places: Iterator[int]):
    """Return the named tuples of axis 0 with their arrays moved into the memory."""
    if isinstance(arrays, tuple):
        return type(arrays)(*(_at_places(array, memory, places) for array in arrays))
    place = next(places)
    return memory[place : place + arrays.size].reshape(arrays.shape)


def _numbers(setpoints: ArrayLike) -> np.ndarray:
    try:
        return np.asarray(setpoints, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError([Problem("setpoints", setpoints, "must be an array of numbers [m]")]) from None


def _misshapen(setpoints: np.ndarray, allowed: str) -> Problem:
    return Problem("setpoints: shape", setpoints.shape, f"does not fit the axes: it must be {allowed}")


def _signal_place(name: str) -> int:
    """Return the index of a signal in a row."""
    names = [signal.name for signal in at.ACTUATOR.row]
    if name not in names:
        raise ParameterError([Problem("signal", name, f"an axis has no such signal{did_you_mean(name, names)}")])
    return names.index(name)
