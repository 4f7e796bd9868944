# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The parameters of one axis: those of all its nodes, read out of a configuration and checked against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from hysteresis_ros.block import COMPILED
from hysteresis_ros.compensation.compensator import CompensatorParameters
from hysteresis_ros.compensation.reachable import commandable
from hysteresis_ros.configuration import Configuration, dump_configuration, node_names, normalised_namespace
from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.loop.common_parameters import NodeParameters, part
from hysteresis_ros.loop.faults import parse_fault
from hysteresis_ros.loop.inchworm_checks import inchworm_problems
from hysteresis_ros.loop.node_parameters import (
    NODE_PARAMETERS,
    CompensatorNodeParameters,
    ControllerNodeParameters,
    DisplacementCameraNodeParameters,
    InchwormSequencerNodeParameters,
    RecorderNodeParameters,
    ReferenceNodeParameters,
)
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.loop.watch import samples_of

#: Samples per second of the wall clock up to which nodes that exchange messages answer in time nearly always (0.25 % of
#: the voltages late, docs/real_time.md), and beyond which such a loop is refused (at 1 kHz 3 to 12 % are late).
MESSAGE_RATE, HIGHEST_MESSAGE_RATE = 300.0, 1000.0
#: Samples that a run may have at most: beyond this a counter in double precision skips numbers.
COUNTABLE = 2.0**53


def require_message_rate(sample_rate: float, where: str) -> None:
    """Refuse a real-time loop whose samples [Hz] come faster than messages between nodes can carry them.

    Raises
    ------
    ConfigurationError
        The message begins with ``where`` and names the rate that would do.
    """
    if sample_rate > HIGHEST_MESSAGE_RATE:
        raise ConfigurationError(
            f"{where}: {sample_rate:g} samples/s are too many for messages between nodes, which hold "
            f"{MESSAGE_RATE:g} Hz well and never more than {HIGHEST_MESSAGE_RATE:g} Hz; take a sample rate of "
            f"{MESSAGE_RATE:g} Hz, or a driver (--driver), which runs in one process with the loop"
        )


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


def _camera_mismatches(plant, camera) -> list[Problem]:
    """Return what does not fit between the plant's type and who looks at its images."""
    if plant.type == "camera" and not plant.external_plant and camera is None:
        allowed = "publishes images: a section displacement_camera has to say how the tip is found in them"
        return [Problem("plant_simulator: type", plant.type, allowed)]
    if camera is not None and plant.type != "camera" and not plant.external_plant:
        allowed = "publishes joint_states itself: leave displacement_camera out, or give type: camera"
        return [Problem("plant_simulator: type", plant.type, allowed)]
    return []


def _adaptation_problems(controller, compensator):
    """Yield a Problem where the inverse would take what the controller knows of the dynamics for hysteresis."""
    adaptation = compensator.adaptation
    if adaptation.type != "none" and controller.model.dynamics.order and not adaptation.dynamics.order:
        allowed = "a lag or a delay would be learned as hysteresis: give motion_controller's model.dynamics here too"
        yield Problem("hysteresis_compensator: adaptation.dynamics.A", adaptation.dynamics.A, allowed)
    zero = controller.model.preload.offset
    if adaptation.type != "none" and adaptation.offset == "measured" and adaptation.zero != zero:
        allowed = f"must be what motion_controller's model.preload takes off the measurement, {zero:.9g} m"
        yield Problem("hysteresis_compensator: adaptation.zero", adaptation.zero, allowed)


def _force_problems(plant, controller):
    """Yield a Problem where a damping needs a force that this axis does not measure."""
    simulated = not plant.driver and not plant.external_plant
    if controller.damping.source == FORCE and simulated and not plant.force_sensor.there:
        allowed = (
            f"missing force joint '{plant.force_joint}': nothing measures the force in the stack; give plant_simulator "
            "a force_sensor (stack_stiffness, flexure_stiffness), or a driver that has one, or take irc or ppf"
        )
        yield Problem("motion_controller: damping.type", controller.damping.type, allowed)


#: Time-outs of the nodes, what happens after them, and where the output then goes.
TIMEOUTS = {
    ("motion_controller", "measurement_timeout"): "no usable measurement: command to safe_command",
    ("inchworm_sequencer", "measurement_timeout"): "no joint_states: both clamps close",
    ("hysteresis_compensator", "command_timeout"): "no command: voltage to safe_voltage",
    ("plant_simulator", "voltage_timeout"): "no voltage: voltage to safe_voltage",
}


def _short_timeouts(parts):
    """Yield a Problem for each time-out that is shorter than a sample."""
    for name, timeout in TIMEOUTS:
        node = parts[name]
        if node is not None and getattr(node, timeout) * node.sample_rate < 1.0:
            least = f"shorter than a sample of {1.0 / node.sample_rate:g} s: give at least that"
            yield Problem(f"{name}: {timeout}", getattr(node, timeout), least)


def _fault_problems(plant, inchworm: bool):
    """Yield a Problem for each fault that there is not, or that this axis cannot have."""
    for text in plant.faults:
        try:
            parse_fault(text, plant.sample_rate, inchworm)
        except ConfigurationError as error:
            yield Problem("faults", text, str(error).partition(": ")[2])


def _with_range(controller, compensator, plant) -> ControllerNodeParameters:
    """Return the parameters of a controller whose commands end a stroke beyond what the compensator's model reaches."""
    if controller.command_minimum != controller.command_maximum:
        return controller
    amplifiers = () if plant.external_plant else (plant.limits,)
    given = part(compensator, CompensatorParameters)
    low, high = commandable(given, 1.0 / compensator.sample_rate, *amplifiers)
    low, high = min(low, controller.safe_command), max(high, controller.safe_command)
    return replace(controller, command_minimum=low, command_maximum=high)


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
    displacement_camera : NodeParameters or None
        Who makes joint_states of images.
    """

    namespace: str
    plant_simulator: PlantNodeParameters
    reference_generator: ReferenceNodeParameters | None
    motion_controller: ControllerNodeParameters
    hysteresis_compensator: CompensatorNodeParameters
    recorder: RecorderNodeParameters
    inchworm_sequencer: InchwormSequencerNodeParameters | None = None
    displacement_camera: DisplacementCameraNodeParameters | None = None

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
        if inchworm and configuration.describes("reference_generator", namespace):
            raise ConfigurationError(
                f"{configuration.source}: two sources of the reference: reference_generator and inchworm_sequencer; "
                "keep the sequencer for an inchworm motor, the generator for anything else"
            )
        absent = {"reference_generator" if inchworm else "inchworm_sequencer"}
        if not configuration.describes("displacement_camera", namespace):
            absent.add("displacement_camera")
        parts, problems = dict.fromkeys(absent), []
        for name, parameters_class in NODE_PARAMETERS.items():
            if name in absent:
                continue
            try:
                values = configuration.node(name, namespace)
                parts[name] = parameters_class.from_mapping(values, prefix=f"{name}: ")
            except ParameterError as error:
                problems += error.problems
        if problems:
            raise ParameterError(problems)
        return cls.of_nodes(namespace, parts)

    @classmethod
    def of_nodes(cls, namespace: str, parts: Mapping[str, NodeParameters | None]) -> AxisParameters:
        """Put the parameters of nodes together.

        Parameters
        ----------
        namespace : str
        parts : mapping of str to NodeParameters or None
            By the names of the nodes; of the two sources one is missing or None.

        Raises
        ------
        ParameterError
            Names rates or modes in which the nodes differ, and what does not fit together.
        """
        parts = {"inchworm_sequencer": None, "reference_generator": None, "displacement_camera": None, **parts}
        problems = []
        inchworm = parts["inchworm_sequencer"] is not None
        plant = parts["plant_simulator"]
        camera = parts["displacement_camera"]
        for name in (*node_names(inchworm), *(["displacement_camera"] if camera is not None else [])):
            for shared in ("sample_rate", "time_mode", "joint", "force_joint", "faults", "external_plant"):
                value, awaited = getattr(parts[name], shared), getattr(plant, shared)
                if value != awaited:
                    allowed = f"must equal the plant_simulator's {awaited!r}; give it once, under '/**'"
                    problems.append(Problem(f"{name}: {shared}", value, allowed))
        sample_time = 1.0 / plant.sample_rate
        for name, dynamics, place in (
            ("plant_simulator", plant.dynamics, "dynamics"),
            ("motion_controller", parts["motion_controller"].model.dynamics, "model.dynamics"),
            ("hysteresis_compensator", parts["hysteresis_compensator"].adaptation.dynamics, "adaptation.dynamics"),
        ):
            try:
                dynamics.require_sample_time(sample_time, f"{name}: {place}.sample_time")
            except ParameterError as error:
                problems += error.problems
        problems += _fault_problems(plant, inchworm)
        problems += _short_timeouts(parts)
        problems += _inchworm_mismatches(plant, parts)
        problems += _camera_mismatches(plant, camera)
        problems += _force_problems(plant, parts["motion_controller"])
        problems += _adaptation_problems(parts["motion_controller"], parts["hysteresis_compensator"])
        if problems:
            raise ParameterError(problems)
        parts["motion_controller"] = _with_range(parts["motion_controller"], parts["hysteresis_compensator"], plant)
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
        if duration * self.plant_simulator.sample_rate >= COUNTABLE:
            raise ConfigurationError(f"duration = {duration:g} s: more samples than can be counted; ask for less")
        samples = max(round(duration * self.plant_simulator.sample_rate), 1)
        changed = replace(self, plant_simulator=replace(self.plant_simulator, samples=samples))
        if not self.plant_simulator.external_plant:
            return changed
        if self.reference_generator is None:
            raise ConfigurationError(
                "duration: only plant_simulator ends the run of an inchworm motor; leave it out and end with Ctrl-C"
            )
        return replace(changed, reference_generator=replace(self.reference_generator, samples=samples))

    def with_recorder(self, path: str) -> AxisParameters:
        """Return the same axis, which begins when its recorder is there.

        Parameters
        ----------
        path : str
            Folder of the bag.
        """
        plant, source = self.plant_simulator, self.reference_generator
        return replace(
            self,
            plant_simulator=replace(plant, wait_for_recorder=True),
            reference_generator=replace(source, wait_for_recorder=plant.external_plant) if source else None,
            recorder=replace(self.recorder, path=path),
        )

    def with_time_mode(self, mode: str) -> AxisParameters:
        """Return the same axis in another ``time_mode``.

        Raises
        ------
        ParameterError
            The axis cannot run so.
        """
        nodes = {name: getattr(self, name) for name in NODE_PARAMETERS if getattr(self, name) is not None}
        return replace(self, **{name: replace(node, time_mode=mode) for name, node in nodes.items()})

    def timeouts(self) -> list[str]:
        """Return a line for each time-out: what it is called, how long in samples and seconds, what follows."""
        rate, external = self.plant_simulator.sample_rate, self.plant_simulator.external_plant
        lines = []
        for (name, timeout), what in TIMEOUTS.items():
            node = getattr(self, name)
            if node is not None and not (name == "plant_simulator" and external):
                seconds = getattr(node, timeout)
                samples = samples_of(seconds, rate)
                lines.append(f"{name} {timeout} = {seconds:g} s = {samples:.0f} samples: {what}")
        limit = self.plant_simulator.allowed_late
        if limit and not external:
            many = f"more than {limit} late voltages in a row or within {rate:g} samples (1 s)"
            lines.append(f"plant_simulator late_limit = {limit}: {many}: axis to safe until ~/start")
        watched = self.plant_simulator.type == "actuator" and self.plant_simulator.overtravel >= 0.0
        if watched and not external:
            low, high = self.plant_simulator.allowed_travel
            text = f"plant_simulator overtravel: measured beyond {1e6 * low:.4g} … {1e6 * high:.4g} µm: axis to safe"
            lines.append(f"{text} until ~/start")
        return lines

    def with_faults(self, faults: tuple[str, ...]) -> AxisParameters:
        """Return the same axis with these faults, each ``NAME:START:DURATION[:VALUE]``.

        Raises
        ------
        ConfigurationError
            A fault is unknown, a number wrong, or this axis cannot have it.
        """
        for text in faults:
            parse_fault(text, self.plant_simulator.sample_rate, self.inchworm_sequencer is not None)
        nodes = {name: getattr(self, name) for name in NODE_PARAMETERS if getattr(self, name) is not None}
        return replace(self, **{name: replace(node, faults=tuple(faults)) for name, node in nodes.items()})

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


def require_carried(axis: AxisParameters) -> None:
    """Refuse an axis with a plant of the user's own whose samples come faster than messages can carry them.

    Raises
    ------
    ConfigurationError
        With the rate that would do.
    """
    plant = axis.plant_simulator
    if plant.external_plant and plant.time_mode == "realtime":
        require_message_rate(
            plant.sample_rate * plant.real_time_factor, f"{axis.namespace}/plant_simulator: external_plant"
        )


def in_time(axis: AxisParameters) -> AxisParameters:
    """Return the axis fused when messages between its nodes are too slow for its rate in real time.

    Parameters
    ----------
    axis : AxisParameters
    """
    plant = axis.plant_simulator
    if plant.time_mode != "realtime" or plant.external_plant or not COMPILED:
        return axis
    if plant.driver and not plant.driver_is_compiled:
        return axis
    return axis.with_time_mode("fused") if plant.sample_rate * plant.real_time_factor > MESSAGE_RATE else axis
