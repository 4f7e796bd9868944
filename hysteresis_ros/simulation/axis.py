"""An axis: plant, reference generator, controller and compensator built from a configuration, simulated offline."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.block import compiled
from hysteresis_ros.compensation.compensator import Compensator, CompensatorParameters
from hysteresis_ros.configuration import (
    NODE_NAMES,
    Configuration,
    dump_configuration,
    normalised_namespace,
)
from hysteresis_ros.control.controller import (
    ControllerParameters,
    controller_block,
    feedforward_block,
    handover_block,
)
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.parameters import Parameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.simulation.closed_loop import SIGNALS, closed_loop, sample_times
from hysteresis_ros.simulation.inchworm_checks import inchworm_problems
from hysteresis_ros.simulation.node_parameters import (
    NODE_PARAMETERS,
    CompensatorNodeParameters,
    ControllerNodeParameters,
    InchwormSequencerNodeParameters,
    PlantNodeParameters,
    RecorderNodeParameters,
    ReferenceNodeParameters,
    part,
)
from hysteresis_ros.simulation.reach import check_reach


def node_names(inchworm: bool) -> tuple[str, ...]:
    """Return the names of the nodes every axis has; an inchworm's sequencer stands for the reference generator."""
    return tuple("inchworm_sequencer" if inchworm and name == "reference_generator" else name for name in NODE_NAMES)


def _inchworm_mismatches(plant, parts) -> list[Problem]:
    """Return what does not fit between the plant's type, the sequencer and the controller."""
    sequencer = parts["inchworm_sequencer"]
    if (plant.type == "inchworm") != (sequencer is not None):
        allowed = "an inchworm needs a section inchworm_sequencer, and only an inchworm may have one"
        return [Problem("plant_simulator: type", plant.type, allowed)]
    problems = []
    if parts["motion_controller"].use_origin != (sequencer is not None):
        allowed = "must be true with an inchworm_sequencer and false without one"
        problems.append(Problem("motion_controller: use_origin", not sequencer, allowed))
    return problems + list(inchworm_problems(plant, parts) if sequencer else ())


@dataclass(frozen=True)
class AxisParameters:
    """Parameters of all nodes of one axis.

    Parameters
    ----------
    namespace : str
        Namespace with a leading slash; empty for the root.
    plant_simulator, motion_controller, hysteresis_compensator, recorder : NodeParameters
        Typed parameters of each node.
    reference_generator, inchworm_sequencer : NodeParameters or None
        One of the two: an axis with a section ``inchworm_sequencer`` has no reference generator.
    """

    namespace: str
    plant_simulator: PlantNodeParameters
    reference_generator: ReferenceNodeParameters | None
    motion_controller: ControllerNodeParameters
    hysteresis_compensator: CompensatorNodeParameters
    recorder: RecorderNodeParameters
    inchworm_sequencer: InchwormSequencerNodeParameters | None = None

    @classmethod
    def from_configuration(cls, configuration: Configuration, namespace: str = "") -> AxisParameters:
        """Read one axis out of a configuration.

        Raises
        ------
        ParameterError
            Names every wrong parameter of every node, rates or modes in which the nodes differ, and linear dynamics
            for another sample time.
        """
        namespace = normalised_namespace(namespace)
        inchworm = configuration.describes("inchworm_sequencer", namespace)
        absent = "reference_generator" if inchworm else "inchworm_sequencer"
        parts, problems = {absent: None}, []
        for name, parameters_class in NODE_PARAMETERS.items():
            if name == absent:
                continue
            try:
                values = configuration.node(name, namespace)
                parts[name] = parameters_class.from_mapping(values, prefix=f"{name}: ")
            except ParameterError as error:
                problems += error.problems
        if problems:
            raise ParameterError(problems)
        plant = parts["plant_simulator"]
        for name in node_names(inchworm):
            for shared in ("sample_rate", "time_mode", "joint"):
                value, awaited = getattr(parts[name], shared), getattr(plant, shared)
                if value != awaited:
                    allowed = f"must equal the plant_simulator's {awaited!r}; give it once, under '/**'"
                    problems.append(Problem(f"{name}: {shared}", value, allowed))
        sample_time = 1.0 / plant.sample_rate
        for name, dynamics, place in (
            ("plant_simulator", plant.dynamics, "dynamics"),
            ("motion_controller", parts["motion_controller"].model.dynamics, "model.dynamics"),
        ):
            try:
                dynamics.require_sample_time(sample_time, f"{name}: {place}.sample_time")
            except ParameterError as error:
                problems += error.problems
        problems += _inchworm_mismatches(plant, parts)
        if problems:
            raise ParameterError(problems)
        return cls(namespace=namespace, **parts)

    def with_duration(self, duration: float) -> AxisParameters:
        """Return the same axis with a run of ``duration`` seconds of its own time.

        Raises
        ------
        ConfigurationError
            The duration is not a positive number.
        """
        if not 0.0 < duration < float("inf"):
            raise ConfigurationError(f"duration = {duration:g} s: must be a positive number of seconds")
        samples = max(round(duration * self.plant_simulator.sample_rate), 1)
        return replace(self, plant_simulator=replace(self.plant_simulator, samples=samples))

    def configuration_text(self) -> str:
        """Return the parameter file of exactly this axis, every parameter written out under its full node name."""
        nodes = {}
        for name in NODE_PARAMETERS:
            if getattr(self, name) is None:
                continue
            values = getattr(self, name).to_mapping()
            # ROS has no type for an empty array; every array is empty by default where it may be
            nodes[f"{self.namespace}/{name}"] = {key: value for key, value in values.items() if value != ()}
        return dump_configuration(nodes)


def axes(configuration: Configuration, namespace: str | None = None) -> list[AxisParameters]:
    """Return every axis of a configuration, or the one in ``namespace``.

    Raises
    ------
    ConfigurationError
        Two of the axes would publish ``/clock``: time may have one source only.
    ParameterError
        A parameter is wrong, or a reference lies beyond what its axis can follow.
    """
    spaces = configuration.namespaces() if namespace is None else (namespace,)
    found = [AxisParameters.from_configuration(configuration, space) for space in spaces]
    for axis in found:
        if axis.inchworm_sequencer is None:
            check_reach(axis)
    clocks = [axis.namespace or "/" for axis in found if axis.plant_simulator.publish_clock]
    if len(clocks) > 1:
        raise ConfigurationError(
            f"{configuration.source}: {' and '.join(clocks)} both set publish_clock; /clock may have one source, "
            "set publish_clock: true for one plant_simulator only"
        )
    return found


class Axis:
    """The blocks of one axis in closed loop, without ROS.

    Parameters
    ----------
    parameters : AxisParameters
        Parameters of all nodes.

    Attributes
    ----------
    actuator, generator, feedforward, controller, handover, compensator
        The blocks; their state goes on from one :meth:`run` to the next.
    """

    def __init__(self, parameters: AxisParameters):
        self.parameters = parameters
        plant = parameters.plant_simulator
        sample_time = 1.0 / plant.sample_rate
        self.actuator = Actuator(part(plant, ActuatorParameters), sample_time)
        self.generator = ReferenceGenerator(part(parameters.reference_generator, ReferenceParameters), sample_time)
        control: Parameters = part(parameters.motion_controller, ControllerParameters)
        self.feedforward = feedforward_block(control, sample_time)
        self.controller = controller_block(control, sample_time)
        self.handover = handover_block(control, sample_time)
        self.compensator = Compensator(part(parameters.hysteresis_compensator, CompensatorParameters), sample_time)
        self.sample = 0

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.plant_simulator.sample_rate

    def default_samples(self) -> int:
        """Return the length of a run that the configuration itself gives, in samples; 0 when it gives none."""
        return self.parameters.plant_simulator.samples or self.generator.waveform.duration_samples

    def default_setpoints(self, samples: int) -> np.ndarray:
        """Return the initial setpoint [m] for each of ``samples`` samples."""
        return np.full(samples, self.parameters.reference_generator.initial_setpoint)

    def run(self, setpoints) -> dict[str, np.ndarray]:
        """Simulate ``len(setpoints)`` samples.

        Parameters
        ----------
        setpoints : array_like, shape (N,)
            Setpoint in force at each sample [m].

        Returns
        -------
        dict of str to array, shape (N,)
            ``time`` [s], ``setpoint`` and the signals of :data:`closed_loop.SIGNALS`.
        """
        setpoints = np.ascontiguousarray(setpoints, dtype=np.float64)
        table = np.empty((len(setpoints), len(SIGNALS)))
        compiled(closed_loop)(*self._arguments(), setpoints, table)
        time = sample_times(self.sample, len(setpoints), self.sample_rate)
        self.sample += len(setpoints)
        return {"time": time, "setpoint": setpoints, **{name: table[:, i].copy() for i, name in enumerate(SIGNALS)}}

    def _arguments(self):
        return (
            *(self.actuator.hysteresis_kernel, self.actuator.ps, self.actuator.xs),
            *(self.generator.waveform_kernel, self.generator.ps, self.generator.xs),
            *(self.feedforward.p, self.feedforward.x),
            *(self.controller.kernel, self.controller.p, self.controller.x, self.handover.p, self.handover.x),
            *(self.compensator.hysteresis_kernel, self.compensator.inverse_kernel),
            *(self.compensator.ps, self.compensator.xs),
        )

    def reset(self) -> None:
        """Return all blocks to their beginning."""
        for block in (
            *(self.actuator, self.generator, self.feedforward),
            *(self.controller, self.handover, self.compensator),
        ):
            block.reset()
        self.sample = 0
