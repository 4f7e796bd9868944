# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of an axis: the parameters of each node, read from a configuration and checked against each other.

The parameters are here and not in the nodes, because the offline twin reads the same parameter files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from hysteresis_ros.configuration import (
    Configuration,
    Parameters,
    dump_configuration,
    group,
    normalised_namespace,
    parameter,
    variants,
)
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.registry import DRIVERS, driver_of, options_of
from hysteresis_ros.hardware.simulated_camera import SimulatedCameraParameters
from hysteresis_ros.hardware.tracker import CameraParameters
from hysteresis_ros.loop.faults import parse_fault
from hysteresis_ros.loop.inchworm_checks import inchworm_problems
from hysteresis_ros.loop.quiet import QuietParameters
from hysteresis_ros.loop.watch import samples_of
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.adaptation import AdaptationParameters
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.calibration import AmplifierCalibration, CalibrationParameters
from hysteresis_ros.models.compensator import CompensatorParameters, commandable, resting_displacements
from hysteresis_ros.models.inchworm import JOINT_NAMES, InchwormParameters, seed_problems
from hysteresis_ros.references.generator import ReferenceParameters
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.moves import ReadyParameters, SettlingParameters
from hysteresis_ros.references.triggers import TriggerParameters, longest_path, trigger_problems
from hysteresis_ros.signals import ACTUATOR, COMPENSATOR, CONTROLLER, INCHWORM, MOTOR_SOURCE, SOURCE, AxisKind, kind_of


@dataclass(frozen=True)
class NodeParameters(Parameters):
    """Parameters that all nodes of an axis have in common; normally given once, under ``/**``."""

    sample_rate: float = parameter(
        1000.0, unit="Hz", low=1.0e-3, high=1.0e6, read_only=True, description="sample rate of the axis"
    )
    time_mode: str = parameter(
        "realtime",
        choices=("realtime", "lockstep", "fused"),
        read_only=True,
        description="realtime: the plant sets the sample times; lockstep: each sample waits for its answer, without "
        "real time; fused: all nodes are in one process, in which one compiled thread runs the loop in real time",
    )
    joint: str = parameter("extender", read_only=True, description="name of the joint in joint_states")
    force_joint: str = parameter(
        "force", read_only=True, description="joint in joint_states whose effort is the measured force of the stack"
    )
    autostart: bool = parameter(
        True, read_only=True, description="configure and activate the node automatically at its start"
    )
    use_sim_time: bool = parameter(
        False, description="take the time of log lines and diagnostics from /clock; samples have their own stamps"
    )
    exit_at_end: bool = parameter(False, read_only=True, description="exit when the plant publishes the end of the run")
    partner_timeout: float = parameter(
        10.0,
        unit="s",
        low=0.1,
        high=3600.0,
        description="lockstep: time without a message from another node after which the run ends; DDS may take 3 s to "
        "repeat a lost message",
    )
    faults: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="injected faults, each 'NAME:START:DURATION[:VALUE]', with times in seconds of the axis' own time; "
        "for all nodes, under '/**'",
    )
    queue_depth: int = parameter(
        1000,
        low=1,
        high=100000,
        read_only=True,
        description="lockstep: number of messages that each topic keeps for a slow recorder",
    )
    external_plant: bool = parameter(
        False,
        read_only=True,
        description="realtime: your own node publishes joint_states instead of plant_simulator; the reference "
        "generator begins and ends the run; for all nodes, under '/**'",
    )

    measurement_reliability: str = parameter(
        "reliable",
        choices=("reliable", "best_effort"),
        read_only=True,
        description="reliability of the subscription to joint_states: best_effort if your own driver publishes as "
        "best effort; realtime only",
    )

    setpoint_reliability: str = parameter(
        "reliable",
        choices=("reliable", "best_effort"),
        read_only=True,
        description="reliability of the subscription to setpoint: best_effort matches every publisher, but a setpoint "
        "may be lost",
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        if self.measurement_reliability != "reliable" and self.time_mode == "lockstep":
            remedy = "must be reliable in lockstep, which waits for every message: give time_mode: realtime"
            yield Problem("measurement_reliability", self.measurement_reliability, remedy)
        if self.external_plant and self.time_mode != "realtime":
            remedy = "an external plant does not wait for other nodes: give time_mode: realtime"
            yield Problem("external_plant", self.external_plant, remedy)


def part(parameters: Parameters, cls):
    """Return the parameters of class ``cls`` within the parameters of a node; each call returns the same instance."""
    kept = parameters.__dict__.setdefault("_parts", {})
    if cls not in kept:
        kept[cls] = cls(**{item.name: getattr(parameters, item.name) for item in fields(cls)})
    return kept[cls]


#: Default limit of late voltages, as a fraction of the samples in a second.
LATE_PART = 0.05
#: Smallest default limit of late voltages.
LEAST_LATE = 20


#: Largest fraction of a period in which a fused loop may poll the clock. Linux needs some time on each core: with
#: fractions of about 0.75 or more it interrupted the loop for up to 50 ms in each second (measured at 50 kHz).
SPIN_PART = 0.6


@dataclass(frozen=True)
class RealtimeParameters(Parameters):
    """Scheduling of the thread of the fused loop."""

    priority: int = parameter(
        80,
        low=0,
        high=99,
        read_only=True,
        description="fused: priority of the loop's thread, SCHED_FIFO, if permitted; 0: normal scheduling",
    )
    cpu: int = parameter(
        -1, low=-1, high=4095, read_only=True, description="fused: processor core of the loop's thread; -1: any"
    )
    lock_memory: bool = parameter(
        False, read_only=True, description="fused: lock the process in RAM, so that no sample waits for paging"
    )
    spin: float = parameter(
        -1.0,
        unit="s",
        low=-1.0,
        high=0.01,
        read_only=True,
        description="fused: time before each deadline from which the loop's thread polls the clock instead of "
        "sleeping; 0: off; below 0: automatic, about the wake-up time of the core, if priority was permitted and a "
        "core is left for the nodes",
    )
    force: bool = parameter(
        False, read_only=True, description="fused: run even if this machine does not sustain the rate"
    )


#: Parameter classes of the drivers that have parameters of their own, by driver name.
_OWN = {name: item.parameters for name, item in DRIVERS.items() if item.parameters is not ActuatorParameters}


@dataclass(frozen=True)
@variants("driver", _OWN)
class PlantNodeParameters(NodeParameters, ActuatorParameters):
    """Parameters of ``plant_simulator``; an inchworm's extender is the actuator."""

    type: str = parameter(
        "actuator",
        choices=("actuator", "inchworm", "camera"),
        read_only=True,
        description="one actuator; an inchworm motor; or an actuator that a camera observes: the plant publishes "
        "images, from which displacement_camera computes joint_states",
    )
    camera: SimulatedCameraParameters = group(SimulatedCameraParameters, variant_of="type")
    inchworm: InchwormParameters = group(InchwormParameters, variant_of="type")
    driver: str = parameter(
        "",
        choices=("", *DRIVERS),
        paths=True,
        read_only=True,
        description="realtime: driver of the device that replaces the simulated plant: its name, or the path of a "
        "Python file that declares DRIVER or of a shared library; '': none",
        place="start",
    )
    driver_options: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="options of a driver that is given by its path, each 'NAME=VALUE'",
        place="start",
    )
    scan_clock: bool = parameter(
        False,
        read_only=True,
        description="whether the device of a driver outputs the frame, line and pixel clock of a scan",
    )
    trigger_output: bool = parameter(
        False, read_only=True, description="whether the device of a driver outputs the triggers of the axis"
    )
    trigger_input: bool = parameter(
        False, read_only=True, description="whether pulses at the trigger input of a driver's device act on the axis"
    )
    triggers: TriggerParameters = group(TriggerParameters)
    calibration: CalibrationParameters = group(CalibrationParameters)
    real_time_factor: float = parameter(
        1.0, low=1.0e-6, high=1.0e3, read_only=True, description="realtime: simulated seconds per second of wall clock"
    )
    publish_rate: float = parameter(
        100.0,
        unit="Hz",
        low=0.1,
        high=1000.0,
        read_only=True,
        description="fused: rate at which topics and states publish the last sample; a recorder gets all samples",
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="length of a run in samples; 0 = without end"
    )
    safe_voltage: float = parameter(
        0.0, unit="V", low=-1.0e4, high=1.0e4, description="voltage to which the plant goes when no voltages arrive"
    )
    safe_slew_rate: float = parameter(
        1000.0, unit="V/s", low=1.0e-3, high=1.0e9, description="slew rate to the safe voltage"
    )
    voltage_timeout: float = parameter(
        0.5,
        unit="s",
        low=1.0e-3,
        high=3600.0,
        description="realtime: time without a voltage after which the output goes to safe_voltage",
    )
    late_limit: int = parameter(
        0,
        low=-1,
        high=10**9,
        description="allowed number of late voltages, in a row or within a second; above it the axis goes to its safe "
        "state until ~/start; 0: 5 % of the samples in a second, but at least 20; -1: no limit, and voltages that "
        "answer earlier samples are output too",
    )
    overtravel: float = parameter(
        0.0,
        unit="m",
        low=-1.0,
        high=1.0,
        description="actuator: allowed distance of a measurement beyond the static range; above it the axis goes to "
        "its safe state until ~/start; 0: one stroke; below 0: no limit",
    )
    realtime: RealtimeParameters = group(RealtimeParameters)
    publish_clock: bool = parameter(False, read_only=True, description="publish the simulated time on /clock")
    wait_for_recorder: bool = parameter(
        False,
        read_only=True,
        description="begin only when a recorder is running; lockstep: run at most `lead` samples ahead of it",
    )
    lead: int = parameter(
        100,
        low=32,
        high=900,
        read_only=True,
        description="lockstep: number of samples by which the plant may be ahead of the recorder",
    )

    @property
    def allowed_late(self) -> int:
        """Allowed number of late voltages in a row or within a second; 0: no limit."""
        if self.late_limit == 0:
            return max(round(LATE_PART * self.sample_rate), LEAST_LATE)
        return max(self.late_limit, 0)

    @property
    def allowed_travel(self) -> tuple[float, float]:
        """Allowed range of the measurement [m]: the static range of the actuator's model plus ``overtravel``."""
        if self.overtravel < 0.0:
            return -math.inf, math.inf
        low, high = resting_displacements(part(self, ActuatorParameters), 1.0 / self.sample_rate)
        # a step of the whole range makes an undamped stage overshoot by one stroke
        beyond = self.overtravel or high - low
        return low - beyond, high + beyond

    @property
    def driver_parameters(self) -> Parameters:
        """Options of the driver."""
        if self.driver in _OWN:
            return getattr(self, self.driver)
        if self.driver in DRIVERS:
            return part(self, ActuatorParameters)
        return options_of(driver_of(self.driver), self.driver_options)

    @property
    def resting_effort(self) -> float:
        """Effort of the first joint before anything is measured [N]: the preload of an actuator."""
        return 0.0 if self.type == "inchworm" else self.preload.force

    def _driver_problems(self):
        if self.driver in DRIVERS and self.driver_options:
            remedy = f"belong to a driver given by its path; {self.driver} has its own parameters"
            yield Problem("driver_options", self.driver_options, remedy)
        try:
            self.driver_parameters.validated()
        except DriverError as error:
            yield Problem("driver", self.driver, str(error))
        except ParameterError as error:
            # the drivers of the registry are in the table, and their parameters have been checked
            yield from error.problems if self.driver not in DRIVERS else ()

    def _amplifier_problems(self):
        try:
            amplifier = AmplifierCalibration(self.calibration.amplifier)
            amplifier.require_range(self.limits.minimum, self.limits.maximum, "calibration.amplifier.")
        except ParameterError as error:
            yield from error.problems

    def _unfit_for_a_driver(self):
        if self.external_plant:
            yield Problem("driver", self.driver, "the plant is already external: remove driver")
        if self.time_mode == "lockstep":
            remedy = (
                "a device does not wait for nodes: give time_mode: realtime, or remove driver to simulate the plant"
            )
            yield Problem("driver", self.driver, remedy)
        if self.real_time_factor != 1.0:
            yield Problem(
                "real_time_factor", self.real_time_factor, "must be 1 with a driver: a device runs in real time"
            )
        if self.type != "actuator":
            remedy = "drives one actuator (type: actuator); an inchworm motor needs its own node, see docs/hardware.md"
            yield Problem("driver", self.driver, remedy)

    def _trigger_problems(self):
        for name in ("trigger_output", "trigger_input"):
            if getattr(self, name) and not self.driver:
                remedy = "needs the device of a driver; without a driver use the topics trigger_out, trigger_in"
                yield Problem(name, True, remedy)

    def _spin_problems(self):
        spin, most = self.realtime.spin, SPIN_PART / (self.sample_rate * self.real_time_factor)
        if self.time_mode == "fused" and spin > most and not self.realtime.force:
            remedy = (
                f"leaves the system too little time on the core: give at most {SPIN_PART:g} of a period, {most:.3g} s, "
                "or -1 (automatic), or lower sample_rate; on a core that has nothing else to do (isolcpus=, "
                "kernel.sched_rt_runtime_us = -1) also realtime.force: true"
            )
            yield Problem("realtime.spin", spin, remedy, "s")

    def check(self):
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        yield from self._spin_problems()
        yield from self._trigger_problems()
        if not self.limits.minimum <= self.safe_voltage <= self.limits.maximum:
            remedy = (
                f"must lie within limits.minimum … limits.maximum = {self.limits.minimum:g} … {self.limits.maximum:g} V"
            )
            yield Problem("safe_voltage", self.safe_voltage, remedy)
        if self.driver:
            yield from self._driver_problems()
            yield from self._amplifier_problems()
            yield from self._unfit_for_a_driver()
        elif self.driver_options:
            yield Problem("driver_options", self.driver_options, "belong to a driver: give its path as driver")
        if self.type == "camera" and self.time_mode == "fused":
            remedy = "a fused loop has no time to evaluate frames: give time_mode: realtime or lockstep"
            yield Problem("time_mode", self.time_mode, remedy)
        if self.force_sensor.there and self.type != "actuator":
            remedy = f"a force sensor needs type actuator; give 0 with type {self.type}"
            yield Problem("force_sensor.stack_stiffness", self.force_sensor.stack_stiffness, remedy)
        if self.joint == self.force_joint:
            yield Problem("force_joint", self.force_joint, "must differ from joint")
        if self.type == "inchworm":
            yield from seed_problems(self)
            others = JOINT_NAMES[1:]
            if self.joint in others:
                remedy = f"must be the slider's name, other than {', '.join(others)}; write joint: slider under '/**'"
                yield Problem("joint", self.joint, remedy)


@dataclass(frozen=True)
class CommandRangeParameters(Parameters):
    """Limits of the command."""

    command_minimum: float = parameter(
        0.0,
        unit="m",
        low=-1.0,
        high=1.0,
        description="lower limit of the command; if this and command_maximum are 0: the compensator's range plus one "
        "stroke on each side, or no limit where the other nodes are unknown",
    )
    command_maximum: float = parameter(0.0, unit="m", low=-1.0, high=1.0, description="upper limit of the command")

    @property
    def command_range(self) -> tuple[float, float]:
        """Lower and upper limit of the command [m]."""
        if self.command_minimum == self.command_maximum == 0.0:
            return -math.inf, math.inf
        return self.command_minimum, self.command_maximum

    def check(self):
        """Yield a Problem if the range is empty."""
        yield from super().check()
        low, high = self.command_range
        if not low < high:
            yield Problem("command_maximum", high, f"must be above command_minimum = {low:g} m")


@dataclass(frozen=True)
class ReferenceNodeParameters(NodeParameters, ReferenceParameters):
    """Parameters of ``reference_generator``."""

    settled: SettlingParameters = group(SettlingParameters)
    ready: ReadyParameters = group(ReadyParameters)
    triggers: TriggerParameters = group(TriggerParameters)
    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="external_plant: length of the run in samples; 0: no end"
    )
    wait_for_recorder: bool = parameter(
        False, read_only=True, description="external_plant: begin only when a recorder is running"
    )

    @property
    def fastest(self) -> float:
        """Largest velocity of the reference [m/s]; without a limit, the whole range within a sample."""
        return self.approach.maximum_velocity or (self.maximum - self.minimum) * self.sample_rate

    def trigger_problems(self):
        """Yield a Problem for each trigger that the axis cannot output; on a stage the waveform may be a scan."""
        if self.triggers.makes_events:
            span, step = self.maximum - self.minimum, 1.0 / self.sample_rate
            yield from trigger_problems(
                self.triggers,
                self.minimum,
                self.maximum,
                self.sample_rate,
                lambda: longest_path(self.waveform, self.approach, span, step),
                self.waveform,
            )


@dataclass(frozen=True)
class InchwormSequencerNodeParameters(NodeParameters, InchwormSequencerParameters):
    """Parameters of ``inchworm_sequencer``, which replaces ``reference_generator``."""

    triggers: TriggerParameters = group(TriggerParameters)
    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    extender_joint: str = parameter(
        "extender",
        read_only=True,
        description="name of the extender in joint_states; `joint` names the slider",
    )
    measurement_timeout: float = parameter(
        0.2,
        unit="s",
        low=1.0e-3,
        high=3600.0,
        description="realtime: time without joint_states after which both clamps close",
    )

    @property
    def fastest(self) -> float:
        """Largest velocity of the slider [m/s]."""
        return self.walk.fastest(self.gait) if self.walk.continuous else self.gait.speed

    def trigger_problems(self):
        """Yield a Problem for each trigger that the motor cannot output."""
        if self.triggers.makes_events:
            path, given = self.fastest / self.sample_rate, (self.triggers, self.minimum, self.maximum)
            yield from trigger_problems(*given, self.sample_rate, lambda: (path, "the gait"))


#: Parameters of the node that writes the reference.
SourceParameters = ReferenceNodeParameters | InchwormSequencerNodeParameters


@dataclass(frozen=True)
class ControllerNodeParameters(NodeParameters, ControllerParameters, CommandRangeParameters):
    """Parameters of ``motion_controller``."""

    use_origin: bool = parameter(
        False, read_only=True, description="inchworm: subtract the sequencer's origin from the measurement"
    )

    measurement_timeout: float = parameter(
        0.2,
        unit="s",
        low=1.0e-3,
        high=3600.0,
        description="realtime: time without joint_states after which the command goes to safe_command",
    )
    spike_limit: float = parameter(
        0.0,
        unit="m",
        low=0.0,
        high=1.0,
        description="largest plausible change from one measurement to the next; 0: no limit",
    )
    spike_samples: int = parameter(
        3,
        low=2,
        high=10**6,
        description="number of consecutive measurements beyond spike_limit, of which the last is accepted",
    )
    frozen_samples: int = parameter(
        0,
        low=0,
        high=10**9,
        description="number of equal measurements in a row after which the sensor counts as frozen; 0: never",
    )
    safe_command: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, description="command while the measurement is stale"
    )
    quiet: QuietParameters = group(QuietParameters)
    safe_slew_rate: float = parameter(
        1.0e-4, unit="m/s", low=1.0e-12, high=1.0e3, description="slew rate of the command to safe_command"
    )
    controller_state_rate: float = parameter(
        50.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        read_only=True,
        description="rate of ~/controller_state and ~/pid_state, if control_msgs is installed; 0: not published",
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        low, high = self.command_range
        if low < high and not low <= self.safe_command <= high:
            remedy = f"must lie within command_minimum … command_maximum = {low:g} … {high:g} m"
            yield Problem("safe_command", self.safe_command, remedy)
        if self.use_origin and self.quiet.on_trigger:
            remedy = "an inchworm motor is quiet when its clamps hold it: give 0 s"
            yield Problem("quiet.on_trigger", self.quiet.on_trigger, remedy, "s")


@dataclass(frozen=True)
class CompensatorNodeParameters(NodeParameters, CompensatorParameters):
    """Parameters of ``hysteresis_compensator``."""

    adaptation: AdaptationParameters = group(AdaptationParameters)
    command_timeout: float = parameter(
        0.4,
        unit="s",
        low=1.0e-3,
        high=3600.0,
        description="realtime: time without a command after which the voltage goes to safe_voltage",
    )
    safe_slew_rate: float = parameter(
        1000.0, unit="V/s", low=1.0e-3, high=1.0e9, description="slew rate of the voltage to safe_voltage"
    )

    def check(self):
        """Yield a Problem for each inconsistency."""
        yield from super().check()
        yield from self.adaptation.fits(self.hysteresis, self.inverse.type)


@dataclass(frozen=True)
class DisplacementCameraNodeParameters(NodeParameters, CameraParameters):
    """Parameters of ``displacement_camera``."""

    image_timeout: float = parameter(
        1.0,
        unit="s",
        low=1.0e-3,
        high=3600.0,
        description="realtime: time without an image after which the node reports it",
    )


@dataclass(frozen=True)
class RecorderNodeParameters(NodeParameters):
    """Parameters of ``recorder``."""

    path: str = parameter(
        "recording",
        read_only=True,
        description="folder of the bag; it must not exist",
        place="files",
    )
    configuration: str = parameter(
        "", read_only=True, description="parameter file whose text is stored in the bag", place="files"
    )
    inchworm: bool = parameter(
        False,
        read_only=True,
        description="record an inchworm's topics; a configuration with an inchworm_sequencer sets it automatically",
    )
    topics: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="further topics to record (relative or absolute), each as 'name:package/msg/Type'",
    )
    chunk_time: float = parameter(
        0.25,
        unit="s",
        low=0.01,
        high=0.5,
        read_only=True,
        description="longest interval after which recorded data are written to the operating system",
    )
    max_bag_size: int = parameter(
        0,
        unit="B",
        low=0,
        high=10**15,
        read_only=True,
        description="size of a bag file after which the next one begins; 0: unlimited",
    )
    max_bag_duration: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0e9,
        read_only=True,
        description="duration of a bag file after which the next one begins; 0: unlimited",
    )
    warn_space: int = parameter(
        2 * 10**9,
        unit="B",
        low=0,
        high=10**15,
        description="free space on the disk below which the recorder warns",
    )
    min_space: int = parameter(
        2 * 10**8,
        unit="B",
        low=0,
        high=10**15,
        description="free space on the disk below which the recording ends; the axis continues",
    )


#: Parameter class of each node, by node name.
NODE_PARAMETERS: dict[str, type[NodeParameters]] = {
    "plant_simulator": PlantNodeParameters,
    "reference_generator": ReferenceNodeParameters,
    "motion_controller": ControllerNodeParameters,
    "hysteresis_compensator": CompensatorNodeParameters,
    "recorder": RecorderNodeParameters,
    "inchworm_sequencer": InchwormSequencerNodeParameters,
    "displacement_camera": DisplacementCameraNodeParameters,
}


#: Sample rate in wall-clock time up to which nodes that exchange messages are almost always in time [Hz]: 0.25 % of the
#: voltages are late, docs/real_time.md.
MESSAGE_RATE = 300.0
#: Sample rate in wall-clock time above which a loop of nodes that exchange messages is refused [Hz]: at this rate, 3 to
#: 12 % of the voltages are late.
HIGHEST_MESSAGE_RATE = 1000.0
#: Maximum number of samples of a run; a counter in double precision is not exact for more samples.
COUNTABLE = 2.0**53


def require_message_rate(sample_rate: float, where: str) -> None:
    """Refuse a real-time loop with a sample rate [Hz] too high for messages between nodes."""
    if sample_rate > HIGHEST_MESSAGE_RATE:
        raise ConfigurationError(
            f"{where}: {sample_rate:g} samples/s are too many for messages between nodes, which are reliable up to "
            f"{MESSAGE_RATE:g} Hz and refused above {HIGHEST_MESSAGE_RATE:g} Hz; use a sample rate of {MESSAGE_RATE:g} "
            f"Hz, or a driver (--driver), which runs in one process with the loop"
        )


def _inchworm_mismatches(plant, parts) -> list[Problem]:
    """Return a Problem for each inconsistency of the plant's type, the sequencer and the controller."""
    sequencer = parts["inchworm_sequencer"]
    if (plant.type == "inchworm") != (sequencer is not None):
        remedy = "an inchworm needs a section inchworm_sequencer, and only an inchworm may have one"
        return [Problem("plant_simulator: type", plant.type, remedy)]
    problems = []
    if parts["motion_controller"].use_origin != (sequencer is not None):
        remedy = "must be true with an inchworm_sequencer and false without one"
        problems.append(Problem("motion_controller: use_origin", not sequencer, remedy))
    return problems + list(inchworm_problems(plant, parts) if sequencer else ())


def _camera_mismatches(plant, camera) -> list[Problem]:
    """Return a Problem for each inconsistency of the plant's type and the camera node."""
    if plant.type == "camera" and not plant.external_plant and camera is None:
        remedy = "publishes images: a section displacement_camera must describe how to find the tip in them"
        return [Problem("plant_simulator: type", plant.type, remedy)]
    if camera is not None and plant.type != "camera" and not plant.external_plant:
        remedy = "publishes joint_states itself: leave displacement_camera out, or give type: camera"
        return [Problem("plant_simulator: type", plant.type, remedy)]
    return []


def _adaptation_problems(controller, compensator):
    """Yield a Problem if the adaptation would learn known dynamics as hysteresis."""
    adaptation = compensator.adaptation
    if adaptation.type != "none" and controller.model.dynamics.order and not adaptation.dynamics.order:
        remedy = "a lag or a delay would be learned as hysteresis: give motion_controller's model.dynamics here too"
        yield Problem("hysteresis_compensator: adaptation.dynamics.A", adaptation.dynamics.A, remedy)
    zero = controller.model.preload.offset
    if adaptation.type != "none" and adaptation.offset == "measured" and adaptation.zero != zero:
        remedy = f"must equal the offset of motion_controller's model.preload, {zero:.9g} m"
        yield Problem("hysteresis_compensator: adaptation.zero", adaptation.zero, remedy)


def _force_problems(plant, controller):
    """Yield a Problem if a damping law needs a force that this axis does not measure."""
    simulated = not plant.driver and not plant.external_plant
    if controller.damping.source == FORCE and simulated and not plant.force_sensor.there:
        remedy = (
            f"missing force joint '{plant.force_joint}': nothing measures the force in the stack; give plant_simulator "
            "a force_sensor (stack_stiffness, flexure_stiffness), or a driver that has one, or use irc or ppf"
        )
        yield Problem("motion_controller: damping.type", controller.damping.type, remedy)


#: Time-outs of the nodes: monitored input, reaction, and safe value of the output.
TIMEOUTS = {
    ("motion_controller", "measurement_timeout"): "without a usable measurement, the command goes to safe_command",
    ("inchworm_sequencer", "measurement_timeout"): "without joint_states, both clamps close",
    ("hysteresis_compensator", "command_timeout"): "without a command, the voltage goes to safe_voltage",
    ("plant_simulator", "voltage_timeout"): "without a voltage, the output goes to safe_voltage",
}


def _device_trigger_problems(plant, name: str, source, controller):
    """Yield a Problem if the triggers that the device outputs are missing, or if its trigger input has no effect."""
    if plant.triggers not in (TriggerParameters(), source.triggers):
        remedy = f"differ from the triggers of {name}: remove them here; those of {name} are then used"
        yield Problem("plant_simulator: triggers", name, remedy)
    if plant.trigger_output and not source.triggers.makes_events:
        remedy = f"the axis has no triggers: give {name} triggers"
        yield Problem("plant_simulator: trigger_output", plant.trigger_output, remedy)
    if plant.trigger_input and source.triggers.input.action == "none" and not controller.quiet.on_trigger:
        remedy = f"has no effect: give {name} triggers.input.action, or motion_controller quiet.on_trigger"
        yield Problem("plant_simulator: trigger_input", plant.trigger_input, remedy)


def _short_timeouts(parts):
    """Yield a Problem for each time-out that is shorter than a sample."""
    for name, timeout in TIMEOUTS:
        node = parts[name]
        if node is not None and getattr(node, timeout) * node.sample_rate < 1.0:
            least = f"must be at least one sample, {1.0 / node.sample_rate:g} s"
            yield Problem(f"{name}: {timeout}", getattr(node, timeout), least)


def _fault_problems(plant, motor: bool):
    """Yield a Problem for each fault that is unknown or that this axis cannot have."""
    for text in plant.faults:
        try:
            parse_fault(text, plant.sample_rate, motor)
        except ConfigurationError as error:
            yield Problem("faults", text, str(error).partition(": ")[2])


def _with_range(controller, compensator, plant) -> ControllerNodeParameters:
    """Return a controller's parameters; by default, commands may exceed the compensator's by one stroke."""
    if controller.command_minimum != controller.command_maximum:
        return controller
    amplifiers = () if plant.external_plant else (plant.limits,)
    given = part(compensator, CompensatorParameters)
    low, high = commandable(given, 1.0 / compensator.sample_rate, *amplifiers)
    low, high = min(low, controller.safe_command), max(high, controller.safe_command)
    return replace(controller, command_minimum=low, command_maximum=high)


@dataclass(frozen=True)
class AxisParameters:
    """Parameters of all nodes of one axis."""

    namespace: str  #: Namespace with a leading slash; empty for the root.
    #: plant_simulator, motion_controller, hysteresis_compensator, recorder: Typed parameters of each node.
    plant_simulator: PlantNodeParameters
    #: reference_generator, inchworm_sequencer: An axis has one of the two, the second if it has a section
    #: ``inchworm_sequencer``.
    reference_generator: ReferenceNodeParameters | None
    motion_controller: ControllerNodeParameters
    hysteresis_compensator: CompensatorNodeParameters
    recorder: RecorderNodeParameters
    inchworm_sequencer: InchwormSequencerNodeParameters | None = None
    displacement_camera: DisplacementCameraNodeParameters | None = (
        None  #: The node that computes joint_states from images.
    )

    @classmethod
    def from_configuration(
        cls, configuration: Configuration, namespace: str = "", coupled: bool = False
    ) -> AxisParameters:
        """Read one axis from a configuration; ``coupled``: the axis shares the plant of a stage with other axes."""
        namespace = normalised_namespace(namespace)
        if not coupled:
            configuration.require_independent()
        sources = [name for name in (SOURCE, MOTOR_SOURCE) if configuration.describes(name, namespace)]
        if len(sources) > 1:
            raise ConfigurationError(
                f"{configuration.source}: two reference generators: reference_generator and inchworm_sequencer; keep "
                "the sequencer for an inchworm motor, the generator for any other axis"
            )
        absent = {SOURCE, MOTOR_SOURCE} - {kind_of(sources).source}
        if not configuration.describes("displacement_camera", namespace):
            absent.add("displacement_camera")
        parts: dict[str, NodeParameters | None] = dict.fromkeys(absent)
        problems: list[Problem] = []
        for name, parameters_class in NODE_PARAMETERS.items():
            if name in absent:
                continue
            try:
                values = configuration.node(name, namespace)
                parts[name] = parameters_class.from_mapping(values, prefix=f"{name}: ")
            except ParameterError as error:
                problems += error.problems
        # only these two: options of a command may add sections of other nodes to every namespace
        described = any(configuration.describes(name, namespace) for name in (CONTROLLER, COMPENSATOR))
        there = configuration.namespaces()
        if problems and not described and namespace not in there:
            known = ", ".join(filter(None, there)) or "one axis without a namespace: omit --namespace"
            raise ConfigurationError(f"{configuration.source}: has no axis in namespace '{namespace}'; it has {known}")
        if problems:
            raise ParameterError(problems)
        return cls.of_nodes(namespace, parts, coupled)

    @classmethod
    def of_nodes(
        cls, namespace: str, parts: Mapping[str, NodeParameters | None], coupled: bool = False
    ) -> AxisParameters:
        """Combine the parameters of nodes; a stage checks the triggers of ``coupled`` axes later, with its scan."""
        absent = dict.fromkeys(("inchworm_sequencer", "reference_generator", "displacement_camera"))
        found: dict[str, Any] = {**absent, **parts}  # one instance of each class in NODE_PARAMETERS
        problems: list[Problem] = []
        kind = kind_of({name for name, node in found.items() if node is not None})
        plant, controller = found["plant_simulator"], found["motion_controller"]
        camera, compensator = found["displacement_camera"], found["hysteresis_compensator"]
        for name in (*kind.nodes, *(["displacement_camera"] if camera is not None else [])):
            for shared in ("sample_rate", "time_mode", "joint", "force_joint", "faults", "external_plant"):
                value, awaited = getattr(found[name], shared), getattr(plant, shared)
                if value != awaited:
                    remedy = f"must equal the plant_simulator's {awaited!r}; give it once, under '/**'"
                    problems.append(Problem(f"{name}: {shared}", value, remedy))
        source = found[kind.source]
        if plant.trigger_output or plant.trigger_input:
            problems += _device_trigger_problems(plant, kind.source, source, controller)
            plant = found["plant_simulator"] = replace(plant, triggers=source.triggers)
        if not coupled:
            problems += [replace(item, name=f"{kind.source}: {item.name}") for item in source.trigger_problems()]
        sample_time = 1.0 / plant.sample_rate
        for name, dynamics, place in (
            ("plant_simulator", plant.dynamics, "dynamics"),
            ("motion_controller", controller.model.dynamics, "model.dynamics"),
            ("hysteresis_compensator", compensator.adaptation.dynamics, "adaptation.dynamics"),
        ):
            try:
                dynamics.require_sample_time(sample_time, f"{name}: {place}.sample_time")
            except ParameterError as error:
                problems += error.problems
        problems += _fault_problems(plant, kind.motor)
        problems += _short_timeouts(found)
        problems += _inchworm_mismatches(plant, found)
        problems += _camera_mismatches(plant, camera)
        problems += _force_problems(plant, controller)
        problems += _adaptation_problems(controller, compensator)
        if problems:
            raise ParameterError(problems)
        found["motion_controller"] = _with_range(controller, compensator, plant)
        return cls(namespace=namespace, **found)

    def with_duration(self, duration: float) -> AxisParameters:
        """Return the same axis with a run of ``duration`` seconds in the time of the axis."""
        if not 0.0 < duration < float("inf"):
            raise ConfigurationError(f"duration = {duration:g} s: must be a positive number of seconds")
        if duration * self.plant_simulator.sample_rate >= COUNTABLE:
            raise ConfigurationError(f"duration = {duration:g} s: too many samples to count; give a shorter duration")
        samples = max(round(duration * self.plant_simulator.sample_rate), 1)
        changed = replace(self, plant_simulator=replace(self.plant_simulator, samples=samples))
        if not self.plant_simulator.external_plant:
            return changed
        source = self.require_generator(
            "duration: only plant_simulator ends the run of an inchworm motor; omit the duration, and end with Ctrl-C"
        )
        return replace(changed, reference_generator=replace(source, samples=samples))

    @property
    def kind(self) -> AxisKind:
        """Kind of the axis: actuator or inchworm motor."""
        return ACTUATOR if self.inchworm_sequencer is None else INCHWORM

    @property
    def source(self) -> SourceParameters:
        """Parameters of the node that writes the reference."""
        found: SourceParameters = getattr(self, self.kind.source)
        return found

    def require_generator(self, refusal: str) -> ReferenceNodeParameters:
        """Return the parameters of the reference generator; raise a ConfigurationError for an inchworm motor."""
        if self.reference_generator is None:
            raise ConfigurationError(refusal)
        return self.reference_generator

    @property
    def generator(self) -> ReferenceNodeParameters:
        """Parameters of the reference generator; raises ConfigurationError if the axis has no reference generator."""
        return self.require_generator(
            "an inchworm motor has no reference_generator: its sequencer generates the reference"
        )

    @property
    def camera(self) -> DisplacementCameraNodeParameters:
        """Parameters of the camera; raises ConfigurationError if the axis has no camera."""
        if self.displacement_camera is None:
            raise ConfigurationError("the axis has no displacement_camera: its plant publishes the measurement")
        return self.displacement_camera

    def with_recorder(self, path: str) -> AxisParameters:
        """Return the same axis with a recorder; its run begins only when the recorder is running."""
        plant, source = self.plant_simulator, self.reference_generator
        return replace(
            self,
            plant_simulator=replace(plant, wait_for_recorder=True),
            reference_generator=replace(source, wait_for_recorder=plant.external_plant) if source else None,
            recorder=replace(self.recorder, path=path),
        )

    def with_time_mode(self, mode: str) -> AxisParameters:
        """Return the same axis in another ``time_mode``."""
        nodes = {name: getattr(self, name) for name in NODE_PARAMETERS if getattr(self, name) is not None}
        return replace(self, **{name: replace(node, time_mode=mode) for name, node in nodes.items()})

    def timeouts(self, travel: tuple[float, float] | None = None) -> list[str]:
        """Return a line for each time-out, with its name, its length in seconds and samples, and its effect.

        On a stage, ``travel`` is the axis' allowed range of the measurement [m], which depends on the other axes.
        """
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
            lines.append(f"plant_simulator late_limit = {limit}: {many} keep the axis safe until ~/start")
        watched = self.plant_simulator.type == "actuator" and self.plant_simulator.overtravel >= 0.0
        if watched and not external:
            low, high = travel or self.plant_simulator.allowed_travel
            text = f"plant_simulator overtravel: a measurement beyond {1e6 * low:.4g} … {1e6 * high:.4g} µm"
            lines.append(f"{text} keeps the axis safe until ~/start")
        return lines

    def with_faults(self, faults: tuple[str, ...]) -> AxisParameters:
        """Return the same axis with these faults, each ``NAME:START:DURATION[:VALUE]``."""
        for text in faults:
            parse_fault(text, self.plant_simulator.sample_rate, self.kind.motor)
        nodes = {name: getattr(self, name) for name in NODE_PARAMETERS if getattr(self, name) is not None}
        return replace(self, **{name: replace(node, faults=tuple(faults)) for name, node in nodes.items()})

    def configuration_text(self) -> str:
        """Return a complete parameter file of this axis, with every parameter under its full node name."""
        nodes = {}
        for name in NODE_PARAMETERS:
            if getattr(self, name) is None:
                continue
            values = getattr(self, name).to_mapping()
            # empty arrays are left out, because ROS has no type for them and the default of such parameters is empty
            nodes[f"{self.namespace}/{name}"] = {key: value for key, value in values.items() if value != ()}
        return dump_configuration(nodes)


def require_carried(axis: AxisParameters) -> None:
    """Refuse an axis with an external plant and a sample rate too high for messages."""
    plant = axis.plant_simulator
    if plant.external_plant and plant.time_mode == "realtime":
        require_message_rate(
            plant.sample_rate * plant.real_time_factor, f"{axis.namespace}/plant_simulator: external_plant"
        )


def in_time(axis: AxisParameters) -> AxisParameters:
    """Return the axis, in fused mode if it runs in real time at a rate too high for messages between its nodes."""
    plant = axis.plant_simulator
    if plant.time_mode != "realtime" or plant.external_plant or not COMPILED:
        return axis
    return axis.with_time_mode("fused") if plant.sample_rate * plant.real_time_factor > MESSAGE_RATE else axis
