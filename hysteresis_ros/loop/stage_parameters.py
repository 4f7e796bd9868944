# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of a stage: coupled axes that share one structure, read from a configuration and checked together.

Each axis is one degree of freedom with its actuator and its sensor; like an independent axis, it has its sections in
its own namespace. The section ``stage`` describes the coupling: the structure between the actuators and the sensors,
the matrix from the readings to the degrees of freedom, and the matrix from the commands of the degrees of freedom to
the commands of the actuators.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import STAGE, Configuration, Parameters, dump_configuration, group, parameter
from hysteresis_ros.control.coupling import lost_direction
from hysteresis_ros.control.feedforward import LONGEST_PREVIEW
from hysteresis_ros.control.state_feedback import full_rank
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem, did_you_mean
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, AxisParameters, NodeParameters, in_time, part
from hysteresis_ros.loop.reach import check_reach, reach_warnings, reachable_displacements
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.compensator import resting_displacements
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.models.linear_algebra import inverse, product
from hysteresis_ros.models.structure import StructureParameters
from hysteresis_ros.references.scan import AXES as COORDINATES
from hysteresis_ros.references.scan import Scan, ScanLimits, check_limits
from hysteresis_ros.references.scan_clock import LEVELS
from hysteresis_ros.references.scans import parsed_scan
from hysteresis_ros.references.waveforms.scan import ScanWaveformParameters


@dataclass(frozen=True)
class StageFeedforwardParameters(Parameters):
    """Contribution of the references of all axes to the command of each axis, in addition to its own feedforward.

    The feedforward of a stage, from the references r of all axes to their commands u, is

        u_i(k) = (F_i r_i)(k) + Σ_j Σ_{m=-N}^{N-1} X_ij[m] r_j(k + m).

    F_i is the inverse of the model of axis i alone, :mod:`hysteresis_ros.control.feedforward`, with N samples of
    preview. X is designed from the model of the stage (:mod:`hysteresis_ros.designs.stage_feedforward`), so that F + X
    inverts that model. X is a finite impulse response that also uses future references, because a bounded inverse of a
    stage with zeros outside the unit circle must look ahead.

    X looks ahead one sample less than F, because the references of all axes are exchanged after each sample and used in
    the next one. So no controller waits for another controller within a sample, and the nodes, the fused loop and the
    offline twin compute the same bits. An axis that does not follow its reference (stopped, stale) contributes nothing;
    when it follows again, its earlier references are assumed to equal the first new reference. The weights of X add up
    to 0, so X adds nothing at rest; the matrix ``decoupling`` decouples at rest.
    """

    preview: int = parameter(
        0,
        low=0,
        high=10 * LONGEST_PREVIEW,
        read_only=True,
        description="preview N of the references in samples, equal to feedforward.preview of each axis",
    )
    weights: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="weights X of the references r_j(k-N) … r_j(k+N-1) in the command of axis i, n·n·2·N numbers, row "
        "by row; empty: each axis has only its own feedforward",
    )

    def matrix(self, axes: int) -> np.ndarray:
        """Return the weights, shape (n, n, 2 N); without weights (0, 0, 0)."""
        shape = (axes, axes, 2 * self.preview) if self.weights else (0, 0, 0)
        return np.array(self.weights, dtype=float).reshape(shape)


#: Largest number of axes.
MOST_AXES = 16
#: Kinds of plant: hysteresis before the linear dynamics, or inside them.
HAMMERSTEIN, INTERNAL = "hammerstein", "internal"
#: Parameters that all axes of a stage and the stage itself have in common.
SHARED = ("sample_rate", "time_mode")
#: Parameters of the plants that all axes have in common, because one thread paces the stage.
OF_THE_CLOCK = (
    "real_time_factor",
    "samples",
    *(f"realtime.{name}" for name in ("priority", "cpu", "spin", "lock_memory", "force")),
)


@dataclass(frozen=True)
class StageScanParameters(Parameters):
    """The scan that axes of a stage follow around their setpoints, instead of their own waveforms."""

    kind: str = parameter(
        "", read_only=True, description="kind of the scan, e.g. raster, see `hysteresis scan`; empty: no scan"
    )
    values: tuple[str, ...] = parameter(
        (), read_only=True, description="parameters of the scan, e.g. [width=30um, depth=30um, lines=64, line_rate=5Hz]"
    )
    axes: tuple[str, ...] = parameter(
        (), read_only=True, description="names of the axes that follow x, y and z; empty: the first ones"
    )
    periods: int = parameter(
        2, low=0, read_only=True, description="periods of the path after which the axes hold their position; 0: endless"
    )
    clock: str = parameter(
        "line", choices=LEVELS, read_only=True, description="finest level of the clock on the topic scan_clock"
    )


@dataclass(frozen=True)
class StageNodeParameters(NodeParameters):
    """Parameters of ``stage``, the section of a file that couples axes."""

    axes: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="names of the axes, which are the namespaces of their sections, in the order of the "
        "inputs and outputs of the structure",
    )
    type: str = parameter(
        HAMMERSTEIN,
        choices=(HAMMERSTEIN, INTERNAL),
        read_only=True,
        description="hysteresis of each actuator before the structure (hammerstein), or inside it (internal), "
        "collocated with the actuators",
    )
    structure: StructureParameters = group(StructureParameters)
    sensor_matrix: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="matrix from the readings of the sensors to the degrees of freedom, n·n numbers row "
        "by row; empty: each sensor measures its axis",
    )
    decoupling: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="matrix from the commands of the degrees of freedom to the commands of the actuators, n·n "
        "numbers row by row; empty: each actuator drives its axis",
    )
    feedforward: StageFeedforwardParameters = group(StageFeedforwardParameters)
    scan: StageScanParameters = group(StageScanParameters)

    def matrix(self, name: str) -> np.ndarray:
        """Return ``sensor_matrix`` or ``decoupling``, shape (n, n)."""
        count, values = len(self.axes), getattr(self, name)
        return np.array(values, dtype=float).reshape(count, count) if values else np.eye(count)

    def check(self):
        """Yield a Problem for each inconsistency within the section."""
        yield from super().check()
        count = len(self.axes)
        if not 1 <= count <= MOST_AXES:
            yield Problem("axes", self.axes, f"must name 1 … {MOST_AXES} axes, e.g. [x, y]")
            return
        wrong = [name for name in self.axes if not re.fullmatch(r"[A-Za-z]\w*", name)]
        if wrong:
            yield Problem("axes", self.axes, f"'{wrong[0]}' is not a valid namespace: use letters, digits, underscores")
        twice = sorted({name for name in self.axes if self.axes.count(name) > 1})
        if twice:
            yield Problem("axes", self.axes, f"'{twice[0]}' is given twice: give each axis its own name")
        for name in ("sensor_matrix", "decoupling"):
            size = len(getattr(self, name))
            if size not in (0, count * count):
                allowed = f"has {size} numbers and must have {count}·{count} = {count * count}, or be empty"
                yield Problem(name, getattr(self, name), allowed)
        fed, needed = self.feedforward, count * count * 2 * self.feedforward.preview
        if fed.weights and len(fed.weights) != needed:
            allowed = f"has {len(fed.weights)} numbers and must have {count}·{count}·2·{fed.preview} = {needed}"
            yield Problem("feedforward.weights", fed.weights, f"{allowed}, or be empty")
        for name, words in (("inputs", "an actuator"), ("outputs", "a sensor")):
            size = getattr(self.structure, name)
            if size != count:
                allowed = f"must be {count}: each of the axes {', '.join(self.axes)} has {words}"
                yield Problem(f"structure.{name}", size, allowed)
        if (self.type == INTERNAL) != bool(self.structure.radii):
            allowed = "must have the radii of the plays" if self.type == INTERNAL else "must be empty"
            yield Problem("structure.radii", self.structure.radii, f"{allowed} with type: {self.type}")

    def large_gain(self) -> np.ndarray:
        """Return the static gain for large motions from the actuators to the degrees of freedom, shape (n, n)."""
        gain = np.reshape(self.structure.large.dc_gain, (len(self.axes), len(self.axes)))
        return product(self.matrix("sensor_matrix"), gain)


def _mode(pole: complex, sample_rate: float) -> str:
    """Return a description of a mode by its frequency."""
    turns = abs(np.angle(pole)) / (2.0 * np.pi)
    return f"the mode at {turns * sample_rate:.4g} Hz" if turns > 1e-9 else f"the pole {pole.real:.6g}"


def _hidden_parts(model: StateSpace, sample_rate: float):
    """Yield a Problem for each uncontrollable or unobservable mode of a structure."""
    for pole in model.poles[model.poles.imag >= 0.0]:
        still = model.A - pole * np.eye(model.order)
        if not full_rank(np.hstack([still, model.B]).T):
            allowed = f"no actuator excites {_mode(pole, sample_rate)}: remove it, or correct the matrix"
            yield Problem("structure.B", tuple(model.B.ravel()), allowed)
        if not full_rank(np.vstack([still, model.C])):
            allowed = f"no sensor observes {_mode(pole, sample_rate)}: remove it, or correct the matrix"
            yield Problem("structure.C", tuple(model.C.ravel()), allowed)


def _singular(stage: StageNodeParameters):
    """Yield a Problem for each singular matrix."""
    actuators = [f"actuator {name}" for name in stage.axes]
    for name, inputs in (("sensor_matrix", [f"sensor {axis}" for axis in stage.axes]), ("decoupling", stage.axes)):
        lost = lost_direction(stage.matrix(name), inputs)
        if lost:
            yield Problem(name, getattr(stage, name), f"is singular: the direction {lost} is lost")
            return
    for model in (stage.structure.small, stage.structure.large):
        gain = product(stage.matrix("sensor_matrix"), np.reshape(model.dc_gain, (len(actuators), -1)))
        lost = lost_direction(gain, actuators)
        if lost:
            allowed = f"has a singular static gain: the direction {lost} moves no degree of freedom"
            yield Problem("structure.C", stage.structure.C, allowed)
            return


def _other_clock(axis: AxisParameters, first: AxisParameters):
    """Yield a Problem for each timing parameter of an axis that differs from the same parameter of the first axis."""
    own, wanted = axis.plant_simulator.to_mapping(), first.plant_simulator.to_mapping()
    for name in OF_THE_CLOCK:
        if own[name] != wanted[name]:
            allowed = (
                f"must equal that of {first.namespace}, {wanted[name]!r}: give it once, under '/**/plant_simulator'"
            )
            yield Problem(f"{axis.namespace}/plant_simulator: {name}", own[name], allowed)


def without_drivers(configuration: Configuration, axes: Sequence[str]) -> Configuration:
    """Return a configuration without drivers, because the machine that evaluates a recording may not have them."""
    for name in axes:
        plant = f"{configuration.stage}/{name}/plant_simulator".lstrip("/")
        if configuration.node("plant_simulator", f"{configuration.stage}/{name}").get("driver"):
            unused = {"scan_clock": False, "trigger_output": False, "trigger_input": False}
            configuration = configuration.override(plant, driver="", driver_options=[], **unused)
    return configuration


def _other_kind(axis: AxisParameters, first: AxisParameters):
    """Yield a Problem if this axis has a driver and the first axis has none, or vice versa."""
    own, wanted = axis.plant_simulator.driver, first.plant_simulator.driver
    if bool(own) != bool(wanted):
        has = f"has the driver {wanted}" if wanted else "has no driver"
        allowed = f"{first.namespace} {has}: give a driver to every axis of the stage, or to no axis"
        yield Problem("driver", own or "''", allowed)


def _unfit_axis(axis: AxisParameters, stage: StageNodeParameters):
    """Yield a Problem for each property of an axis that a stage does not support."""
    plant = axis.plant_simulator
    if plant.type != "actuator":
        yield Problem("type", plant.type, "an axis of a stage is an actuator")
    if plant.external_plant:
        allowed = "an axis of a stage has a driver, or is simulated: give false, and a driver for each axis"
        yield Problem("external_plant", True, allowed)
    if plant.scan_clock and plant.time_mode != "fused":
        allowed = "the devices of a stage output its clock in the fused loop: give time_mode: fused, or false"
        yield Problem("scan_clock", True, allowed)
    if plant.force_sensor.there:
        given = plant.force_sensor.stack_stiffness
        yield Problem("force_sensor.stack_stiffness", given, "a stage has no force sensors: give 0")
    if plant.dynamics.A:
        allowed = "must be empty: the structure of the stage has the dynamics; an actuator may have only a delay"
        yield Problem("dynamics.A", plant.dynamics.A, allowed)
    if stage.type == INTERNAL and plant.hysteresis.type != "proportional":
        allowed = "must be proportional with type: internal, because the plays of the structure are the hysteresis"
        yield Problem("hysteresis.type", plant.hysteresis.type, allowed)


def _unfit_feedforward(axis: AxisParameters, stage: StageNodeParameters):
    """Yield a Problem if the feedforward of an axis does not match the feedforward of its stage."""
    own = axis.motion_controller.feedforward
    if stage.feedforward.weights and own.type == "none":
        allowed = "must be inverse_dynamics or static, because the stage has feedforward.weights"
        yield Problem("feedforward.type", own.type, allowed)
    if stage.feedforward.weights and own.preview != stage.feedforward.preview:
        allowed = f"must equal feedforward.preview of the stage, {stage.feedforward.preview}"
        yield Problem("feedforward.preview", own.preview, allowed)


@dataclass(frozen=True)
class StageParameters:
    """Parameters of a stage and of all its axes."""

    namespace: str  #: Namespace of the stage; the namespaces of the axes are below it.
    stage: StageNodeParameters
    axes: tuple[AxisParameters, ...]  #: Axes in the order of ``stage.axes``.

    @classmethod
    def from_configuration(cls, configuration: Configuration) -> StageParameters:
        """Read the stage of a configuration.

        Raises
        ------
        ConfigurationError
            The file describes no stage, or its axes differ from the axes that the stage names.
        ParameterError
            A parameter is wrong, or parameters are inconsistent; the message names the section of every problem.
        """
        namespace = configuration.stage
        if namespace is None:
            raise ConfigurationError(f"{configuration.source}: has no section '/{STAGE}', which couples its axes")
        values = configuration.node(STAGE, namespace)
        stage = StageNodeParameters.from_mapping(values, prefix=f"{namespace}/{STAGE}: ")
        described = [space for space in configuration.namespaces() if space]
        wanted = [f"{namespace}/{name}" for name in stage.axes]
        for space in wanted:
            if space not in described:
                near = did_you_mean(space, described)
                raise ConfigurationError(f"{configuration.source}: the stage has no sections of its axis {space}{near}")
        left = [space for space in described if space not in wanted]
        if left:
            raise ConfigurationError(
                f"{configuration.source}: {left[0]} is not an axis of the stage: add it to {namespace}/{STAGE} axes, "
                "or move it to its own file"
            )
        axes: list[AxisParameters] = []
        problems: list[Problem] = []
        # checked first, because an axis at another rate causes further problems
        for space in wanted:
            for shared in SHARED:
                value = configuration.node("plant_simulator", space).get(shared, getattr(NodeParameters, shared))
                if value != getattr(stage, shared):
                    allowed = f"must equal that of the stage, {getattr(stage, shared)!r}: give it once, under '/**'"
                    problems.append(Problem(f"{space}/plant_simulator: {shared}", value, allowed))
        if problems:
            raise ParameterError(problems)
        for space in wanted:
            try:
                axes.append(AxisParameters.from_configuration(configuration, space, coupled=True))
            except ParameterError as error:
                problems += [replace(problem, name=f"{space}/{problem.name}") for problem in error.problems]
        if problems:
            raise ParameterError(problems)
        found = cls(namespace, stage, tuple(axes)).following(stage.scan)
        found._require_fit()
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.stage.axes

    @property
    def sample_rate(self) -> float:
        """Samples per second of all axes [Hz]."""
        return self.stage.sample_rate

    @property
    def is_driven(self) -> bool:
        """Whether devices replace the simulated stage."""
        return bool(self.axes[0].plant_simulator.driver)

    @property
    def scan(self) -> Scan | None:
        """The scan that axes follow around their setpoints."""
        given = self.stage.scan
        return parsed_scan(given.kind, given.values) if given.kind else None

    @property
    def scanning_axes(self) -> tuple[str, ...]:
        """Names of the axes that follow the scan's x, y and, if the plane is tilted, z; empty without a scan."""
        scan = self.scan
        return () if scan is None else (self.stage.scan.axes or self.names)[: scan.axes]

    def following(self, given: StageScanParameters) -> StageParameters:
        """Return the same stage with axes that follow a scan.

        A scan that is invalid, or that the axes cannot follow, is refused; the reference generators of the axes contain
        the range and the limits of the motion.
        """
        where = f"{self.namespace}/{STAGE}: scan"
        found = replace(self, stage=replace(self.stage, scan=given))
        try:
            scan, names = found.scan, found.scanning_axes
        except ParameterError as error:
            raise ParameterError(
                [replace(problem, name=f"{where}.values: {problem.name}") for problem in error.problems]
            ) from None
        if scan is None:
            return found
        wrong = [name for name in names if name not in self.names]
        if wrong or len(set(names)) < scan.axes:
            allowed = f"must name {scan.axes} different axes out of {', '.join(self.names)}"
            raise ParameterError([Problem(f"{where}.axes", given.axes or self.names, allowed)])
        axes = list(self.axes)
        for name, coordinate in zip(names, COORDINATES, strict=False):
            place = self.names.index(name)
            source = axes[place].generator
            own: dict[str, Any] = {"scan": ScanWaveformParameters(given.kind, given.values, coordinate, given.clock)}
            own |= {"type": "scan", "cycles": given.periods, "offset": 0.0, "phase": 0.0}
            waveform = replace(source.waveform, **own)
            axes[place] = replace(axes[place], reference_generator=replace(source, waveform=waveform))
        sources = [axes[self.names.index(name)].generator for name in names]
        limits: dict[str, Any] = {
            what: tuple(getattr(source.approach, f"maximum_{what}") or np.inf for source in sources)
            for what in ("velocity", "acceleration", "jerk")
        }
        # sampled signals contain no frequencies above half the sample rate
        limits["bandwidth"] = 0.5 * self.sample_rate
        limits["low"] = tuple(source.minimum - source.initial_setpoint for source in sources)
        limits["high"] = tuple(source.maximum - source.initial_setpoint for source in sources)
        try:
            check_limits(scan, ScanLimits(**limits))
        except ParameterError as error:
            words = f"{where} on axes {', '.join(names)} (positions relative to initial_setpoint): "
            raise ParameterError([replace(problem, name=words + problem.name) for problem in error.problems]) from None
        return replace(found, axes=tuple(axes))

    def _require_fit(self) -> None:
        """Refuse axes that do not fit together or do not fit the structure."""
        problems: list[Problem] = []
        joints: dict[str, str] = {}
        for axis in self.axes:
            where = f"{axis.namespace}/plant_simulator"
            problems += [replace(found, name=f"{where}: {found.name}") for found in _unfit_axis(axis, self.stage)]
            control = f"{axis.namespace}/motion_controller"
            source = f"{axis.namespace}/reference_generator"
            for one in axis.generator.trigger_problems():
                # the axes of a stage use the clock of its scan
                clock = one.name == "waveform.scan.clock"
                label = f"{self.namespace}/{STAGE}: scan.clock" if clock else f"{source}: {one.name}"
                if not clock or label not in (problem.name for problem in problems):
                    problems.append(replace(one, name=label))
            unfit = _unfit_feedforward(axis, self.stage)
            problems += [replace(found, name=f"{control}: {found.name}") for found in unfit]
            joint = axis.plant_simulator.joint
            if joint in joints:
                allowed = (
                    f"is already the joint of {joints[joint]}: give each axis its own, e.g. under '{axis.namespace}/**'"
                )
                problems.append(Problem(f"{where}: joint", joint, allowed))
            joints.setdefault(joint, axis.namespace)
            problems += _other_clock(axis, self.axes[0])
            problems += [replace(one, name=f"{where}: {one.name}") for one in _other_kind(axis, self.axes[0])]
        where = f"{self.namespace}/{STAGE}: "
        try:
            self.stage.structure.require_sample_time(1.0 / self.sample_rate, f"{where}structure.sample_time")
        except ParameterError as error:
            problems += error.problems
        own = [*_hidden_parts(self.stage.structure.small, self.sample_rate), *_singular(self.stage)]
        problems += [replace(found, name=where + found.name) for found in own]
        if problems:
            raise ParameterError(problems)
        for axis in self.axes:
            try:
                check_reach(axis)
            except ParameterError as error:
                named = [replace(problem, name=f"{axis.namespace}/{problem.name}") for problem in error.problems]
                raise ParameterError(named) from None

    def warnings(self) -> tuple[str, ...]:
        """Return one sentence per warning about the axes."""
        each = zip(self.axes, self._reach(), strict=True)
        return tuple(f"{axis.namespace}/{text}" for axis, reach in each for text in reach_warnings(axis, reach))

    def _reach(self) -> list[tuple[float, float]]:
        """Return the range of the setpoint [m] of each axis: what the actuators reach at rest, wherever the others are.

        A decoupling distributes each setpoint over the actuators.
        """
        shares = self.recoupling()
        low, high = np.array([reachable_displacements(axis) for axis in self.axes]).T
        least, most = np.minimum(shares * low, shares * high), np.maximum(shares * low, shares * high)
        return list(zip(least.sum(axis=1).tolist(), most.sum(axis=1).tolist(), strict=True))

    def travel(self) -> np.ndarray:
        """Return the allowed range of the measurement [m] of each axis, shape (n, 2).

        The range consists of all positions at which the stage can rest, whatever the voltages of the other axes, plus
        ``overtravel``.
        """
        gain = self.stage.large_gain()
        ends = np.array(
            [
                resting_displacements(part(axis.plant_simulator, ActuatorParameters), 1.0 / self.sample_rate)
                for axis in self.axes
            ]
        )
        preloads = np.array([axis.plant_simulator.preload.offset for axis in self.axes])
        ends -= preloads[:, None]
        offsets = product(self.stage.matrix("sensor_matrix"), preloads)
        low = np.minimum(gain * ends[:, 0], gain * ends[:, 1]).sum(axis=1) + offsets
        high = np.maximum(gain * ends[:, 0], gain * ends[:, 1]).sum(axis=1) + offsets
        allowed = np.array([axis.plant_simulator.overtravel for axis in self.axes])
        beyond = np.where(allowed < 0.0, np.inf, np.where(allowed > 0.0, allowed, high - low))
        return np.column_stack([low - beyond, high + beyond])

    def recoupling(self) -> np.ndarray:
        """Return the inverse of the decoupling, shape (n, n)."""
        return inverse(self.stage.matrix("decoupling"))

    def with_duration(self, duration: float) -> StageParameters:
        """Return the same stage with a run of ``duration`` seconds."""
        return replace(self, axes=tuple(axis.with_duration(duration) for axis in self.axes))

    def with_time_mode(self, mode: str) -> StageParameters:
        """Return the same stage in another ``time_mode``."""
        axes = tuple(axis.with_time_mode(mode) for axis in self.axes)
        return replace(self, stage=replace(self.stage, time_mode=mode), axes=axes)

    def in_time(self) -> StageParameters:
        """Return the stage, in fused mode if it runs in real time at a rate too high for messages between its nodes."""
        fused = any(in_time(axis).plant_simulator.time_mode == "fused" for axis in self.axes)
        return self.with_time_mode("fused") if fused else self

    def with_faults(self, name: str, faults: tuple[str, ...]) -> StageParameters:
        """Return the same stage with these faults, each ``NAME:START:DURATION[:VALUE]``, in one of its axes."""
        place = self.place(name)
        axes = list(self.axes)
        axes[place] = axes[place].with_faults(faults)
        return replace(self, axes=tuple(axes))

    def place(self, name: str) -> int:
        """Return the index of an axis by its name."""
        name = name.strip("/").removeprefix(self.namespace.strip("/")).strip("/")
        if name not in self.names:
            near = did_you_mean(name, self.names)
            raise ConfigurationError(f"there is no axis '{name}' in the stage: it has {', '.join(self.names)}{near}")
        return self.names.index(name)

    def waveform(self, name: str) -> str:
        """Return the type of the waveform of an axis."""
        return self.axes[self.place(name)].generator.waveform.type

    def scanning(self, names: Sequence[str]) -> StageParameters:
        """Return the same stage, but only these axes follow their waveforms; the other axes hold their setpoints."""
        axes = []
        for name, axis in zip(self.names, self.axes, strict=True):
            source = axis.generator
            if name not in names:
                source = replace(source, waveform=replace(source.waveform, type="hold"))
            axes.append(replace(axis, reference_generator=source))
        return replace(self, axes=tuple(axes))

    def configuration_text(self) -> str:
        """Return a complete parameter file of this stage, with every parameter under its full name."""
        nodes = {f"{self.namespace}/{STAGE}": self.stage}
        for axis in self.axes:
            found = {name: getattr(axis, name) for name in NODE_PARAMETERS}
            nodes |= {f"{axis.namespace}/{name}": node for name, node in found.items() if node is not None}
        # empty arrays are left out, because ROS has no type for them; arrays that may be empty are so by default
        return dump_configuration(
            {
                name: {key: value for key, value in node.to_mapping().items() if value != ()}
                for name, node in nodes.items()
            }
        )
