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
from hysteresis_ros.simulation.closed_loop import SIGNALS, closed_loop
from hysteresis_ros.simulation.node_parameters import (
    NODE_PARAMETERS,
    CompensatorNodeParameters,
    ControllerNodeParameters,
    PlantNodeParameters,
    RecorderNodeParameters,
    ReferenceNodeParameters,
    part,
)


@dataclass(frozen=True)
class AxisParameters:
    """Parameters of all nodes of one axis.

    Parameters
    ----------
    namespace : str
        Namespace with a leading slash; empty for the root.
    plant_simulator, reference_generator, motion_controller, hysteresis_compensator, recorder : NodeParameters
        Typed parameters of each node.
    """

    namespace: str
    plant_simulator: PlantNodeParameters
    reference_generator: ReferenceNodeParameters
    motion_controller: ControllerNodeParameters
    hysteresis_compensator: CompensatorNodeParameters
    recorder: RecorderNodeParameters

    @classmethod
    def from_configuration(cls, configuration: Configuration, namespace: str = "") -> AxisParameters:
        """Read one axis out of a configuration.

        Raises
        ------
        ParameterError
            Names every wrong parameter of every node, and rates or modes in which the nodes differ.
        """
        namespace = normalised_namespace(namespace)
        parts, problems = {}, []
        for name, parameters_class in NODE_PARAMETERS.items():
            try:
                values = configuration.node(name, namespace)
                parts[name] = parameters_class.from_mapping(values, prefix=f"{name}: ")
            except ParameterError as error:
                problems += error.problems
        if problems:
            raise ParameterError(problems)
        plant = parts["plant_simulator"]
        for name in NODE_NAMES:
            for shared in ("sample_rate", "time_mode", "joint"):
                value, awaited = getattr(parts[name], shared), getattr(plant, shared)
                if value != awaited:
                    allowed = f"must equal the plant_simulator's {awaited!r}; give it once, under '/**'"
                    problems.append(Problem(f"{name}: {shared}", value, allowed))
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
        A parameter is wrong.
    """
    spaces = configuration.namespaces() if namespace is None else (namespace,)
    found = [AxisParameters.from_configuration(configuration, space) for space in spaces]
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
        index = np.arange(self.sample, self.sample + len(setpoints))
        self.sample += len(setpoints)
        # the nodes stamp samples in whole nanoseconds, and time is compared bit for bit
        time = np.array([round(k * 1e9 / self.sample_rate) for k in index.tolist()], dtype=np.int64) / 1e9
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
