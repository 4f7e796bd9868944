# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the nodes: the blocks' own parameters and what a running node needs besides.

They live here and not with the nodes because the offline twin reads the same files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from hysteresis_ros.compensation.adaptation import AdaptationParameters
from hysteresis_ros.compensation.compensator import CompensatorParameters
from hysteresis_ros.compensation.reachable import resting_displacements
from hysteresis_ros.control.command_range import CommandRangeParameters
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.hardware.driver import Driver, DriverError
from hysteresis_ros.hardware.located import driver_of, options_of
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.calibration import AmplifierCalibration, CalibrationParameters
from hysteresis_ros.models.inchworm import JOINT_NAMES, InchwormParameters, seed_problems
from hysteresis_ros.parameters import Parameters, group, parameter, variants
from hysteresis_ros.references.generator import ReferenceParameters
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.settling import SettlingParameters
from hysteresis_ros.sensing.simulated_camera import SimulatedCameraParameters
from hysteresis_ros.sensing.tracker import CameraParameters

#: Late voltages that are allowed by default: part of the samples of a second, and the least number.
LATE_PART, LEAST_LATE = 0.05, 20


@dataclass(frozen=True)
class NodeParameters(Parameters):
    """What every node of an axis needs; normally given once, under ``/**``."""

    sample_rate: float = parameter(
        1000.0, unit="Hz", low=1.0e-3, high=1.0e6, read_only=True, description="samples per second of the axis"
    )
    time_mode: str = parameter(
        "realtime",
        choices=("realtime", "lockstep", "fused"),
        read_only=True,
        description="realtime: the plant keeps the time; lockstep: each sample waits for its answer, as fast as it "
        "can; fused: all nodes in one process, one compiled thread makes the samples in real time",
    )
    joint: str = parameter("extender", read_only=True, description="name of the joint in joint_states")
    force_joint: str = parameter(
        "force", read_only=True, description="joint in joint_states whose effort is the measured force in the stack"
    )
    autostart: bool = parameter(True, read_only=True, description="configure and activate by itself at start")
    use_sim_time: bool = parameter(
        False, description="take the time of log lines and diagnostics from /clock; samples have their own stamps"
    )
    exit_at_end: bool = parameter(
        False, read_only=True, description="leave when the plant has published the end of the run"
    )
    partner_timeout: float = parameter(
        10.0,
        unit="s",
        low=0.1,
        high=3600.0,
        description="lockstep: silence of a partner that ends the run; DDS may take 3 s to repeat what was lost",
    )
    faults: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="faults on purpose, each 'NAME:START:DURATION[:VALUE]', times in seconds of the axis' own time; "
        "for all nodes, under '/**'",
    )
    queue_depth: int = parameter(
        1000, low=1, high=100000, read_only=True, description="lockstep: messages each topic keeps for a slow recorder"
    )
    external_plant: bool = parameter(
        False,
        read_only=True,
        description="realtime: a node of your own publishes joint_states in plant_simulator's place; the source of "
        "references begins and ends the run; for all nodes, under '/**'",
    )

    measurement_reliability: str = parameter(
        "reliable",
        choices=("reliable", "best_effort"),
        read_only=True,
        description="how joint_states are subscribed: best_effort where a driver of your own publishes them so; "
        "realtime only",
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        if self.measurement_reliability != "reliable" and self.time_mode == "lockstep":
            allowed = "must be reliable in lockstep, where each sample is answered: give time_mode: realtime"
            yield Problem("measurement_reliability", self.measurement_reliability, allowed)
        if self.external_plant and self.time_mode != "realtime":
            allowed = "a plant of your own does not wait for anybody: give time_mode: realtime"
            yield Problem("external_plant", self.external_plant, allowed)


@dataclass(frozen=True)
class RealtimeParameters(Parameters):
    """How the thread of the fused loop is scheduled."""

    priority: int = parameter(
        80,
        low=0,
        high=99,
        read_only=True,
        description="fused: priority of the loop's thread, SCHED_FIFO, where that is permitted; 0: a normal one",
    )
    cpu: int = parameter(
        -1, low=-1, high=4095, read_only=True, description="fused: processor core of the loop's thread; -1: any"
    )
    lock_memory: bool = parameter(
        False, read_only=True, description="fused: keep the process in RAM, so that no sample waits for the disk"
    )
    force: bool = parameter(
        False, read_only=True, description="fused: run at a rate that this machine does not hold, too"
    )


#: Drivers that have parameters of their own, and their class.
_OWN = {name: item.parameters for name, item in DRIVERS.items() if item.parameters is not ActuatorParameters}


@dataclass(frozen=True)
@variants("driver", _OWN)
class PlantNodeParameters(NodeParameters, ActuatorParameters):
    """Parameters of ``plant_simulator``; an inchworm's extender is the actuator."""

    type: str = parameter(
        "actuator",
        choices=("actuator", "inchworm", "camera"),
        read_only=True,
        description="one actuator; an inchworm motor; or an actuator that a camera sees: the plant publishes images, "
        "of which displacement_camera makes joint_states",
    )
    camera: SimulatedCameraParameters = group(SimulatedCameraParameters, variant_of="type")
    inchworm: InchwormParameters = group(InchwormParameters, variant_of="type")
    driver: str = parameter(
        "",
        choices=("", *DRIVERS),
        paths=True,
        read_only=True,
        description="realtime: driver of the device that stands in the simulated plant's place, by its name or as the "
        "path of a Python file that declares DRIVER or of a shared library; '': none",
        place="start",
    )
    driver_options: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="what a driver that is given by its path is opened with, 'NAME=VALUE' each",
        place="start",
    )
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
        description="fused: how often topics and states show the last sample; a recorder gets all samples",
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="length of a run in samples; 0 = without end"
    )
    safe_voltage: float = parameter(
        0.0, unit="V", low=-1.0e4, high=1.0e4, description="voltage the plant goes to when commands stop"
    )
    safe_slew_rate: float = parameter(
        1000.0, unit="V/s", low=1.0e-3, high=1.0e9, description="how fast it goes to the safe voltage"
    )
    voltage_timeout: float = parameter(
        0.5, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of voltage that starts the watchdog"
    )
    late_limit: int = parameter(
        0,
        low=-1,
        high=10**9,
        description="late voltages in a row, or together within a second, above which the axis goes to safe until "
        "~/start; 0: a twentieth of the samples of a second, at least 20; -1: any number, and those that answer an "
        "earlier sample are put out",
    )
    overtravel: float = parameter(
        0.0,
        unit="m",
        low=-1.0,
        high=1.0,
        description="actuator: measured so far beyond where it can rest, the axis goes to safe until ~/start; "
        "0: one stroke; below 0: any",
    )
    realtime: RealtimeParameters = group(RealtimeParameters)
    publish_clock: bool = parameter(False, read_only=True, description="publish the simulated time on /clock")
    wait_for_recorder: bool = parameter(
        False, read_only=True, description="begin when a recorder is there; lockstep: run at most `lead` ahead of it"
    )
    lead: int = parameter(
        100, low=32, high=900, read_only=True, description="lockstep: samples the plant may be ahead of the recorder"
    )

    @property
    def allowed_late(self) -> int:
        """Late voltages that are allowed in a row or within a second; 0: any number."""
        if self.late_limit == 0:
            return max(round(LATE_PART * self.sample_rate), LEAST_LATE)
        return max(self.late_limit, 0)

    @property
    def allowed_travel(self) -> tuple[float, float]:
        """Between which measurements [m] an actuator may go on: where its model can rest, and ``overtravel`` beyond."""
        if self.overtravel < 0.0:
            return -math.inf, math.inf
        low, high = resting_displacements(part(self, ActuatorParameters), 1.0 / self.sample_rate)
        # a step of the whole range makes an undamped stage swing one stroke too far
        beyond = self.overtravel or high - low
        return low - beyond, high + beyond

    @property
    def driver_parameters(self) -> Parameters:
        """What the driver is opened with."""
        if self.driver in _OWN:
            return getattr(self, self.driver)
        if self.driver in DRIVERS:
            return part(self, ActuatorParameters)
        return options_of(driver_of(self.driver), self.driver_options)

    @property
    def driver_is_compiled(self) -> bool:
        """Whether machine code reads and writes the device."""
        try:
            return driver_of(self.driver).driver.compiled is not Driver.compiled
        except DriverError:
            return True  # there is none: said elsewhere

    def _driver_problems(self):
        if self.driver in DRIVERS and self.driver_options:
            allowed = f"belong to a driver that is given by its path; {self.driver} has parameters of its own"
            yield Problem("driver_options", self.driver_options, allowed)
        try:
            self.driver_parameters.validated()
        except DriverError as error:
            yield Problem("driver", self.driver, str(error))
        except ParameterError as error:
            # those of the registry stand in the table and have been looked at
            yield from error.problems if self.driver not in DRIVERS else ()

    def _amplifier_problems(self):
        try:
            amplifier = AmplifierCalibration(self.calibration.amplifier)
            amplifier.require_range(self.limits.minimum, self.limits.maximum, "calibration.amplifier.")
        except ParameterError as error:
            yield from error.problems

    def _unfit_for_a_driver(self):
        if self.external_plant:
            yield Problem("driver", self.driver, "the plant is external already: give driver: ''")
        if self.time_mode == "lockstep":
            allowed = (
                "a device does not wait for anybody: give time_mode: realtime, or driver: '' for the simulated plant"
            )
            yield Problem("driver", self.driver, allowed)
        if self.time_mode == "fused" and not self.driver_is_compiled:
            allowed = (
                "is written in Python, which would wait for its lock in each sample: give time_mode: realtime, or a "
                "driver with a compiled form (docs/hardware.md)"
            )
            yield Problem("driver", self.driver, allowed)
        if self.real_time_factor != 1.0:
            yield Problem(
                "real_time_factor", self.real_time_factor, "must be 1 with a driver: a device has its own time"
            )
        if self.type != "actuator":
            allowed = (
                "drives one actuator (type: actuator); an inchworm motor needs a node of its own, see docs/hardware.md"
            )
            yield Problem("driver", self.driver, allowed)

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        if not self.limits.minimum <= self.safe_voltage <= self.limits.maximum:
            allowed = (
                f"must lie within limits.minimum … limits.maximum = {self.limits.minimum:g} … {self.limits.maximum:g} V"
            )
            yield Problem("safe_voltage", self.safe_voltage, allowed)
        if self.driver:
            yield from self._driver_problems()
            yield from self._amplifier_problems()
            yield from self._unfit_for_a_driver()
        elif self.driver_options:
            yield Problem("driver_options", self.driver_options, "belong to a driver: give its path as driver")
        if self.type == "camera" and self.time_mode == "fused":
            allowed = "the thread of a fused loop has no time to look at frames: give time_mode: realtime or lockstep"
            yield Problem("time_mode", self.time_mode, allowed)
        if self.force_sensor.there and self.type != "actuator":
            allowed = f"a force sensor belongs to the stack of type actuator; give 0 with type {self.type}"
            yield Problem("force_sensor.stack_stiffness", self.force_sensor.stack_stiffness, allowed)
        if self.joint == self.force_joint:
            yield Problem("force_joint", self.force_joint, "must be another name than joint")
        if self.type == "inchworm":
            yield from seed_problems(self)
            others = JOINT_NAMES[1:]
            if self.joint in others:
                allowed = f"must be the slider's name, other than {', '.join(others)}; write joint: slider under '/**'"
                yield Problem("joint", self.joint, allowed)


@dataclass(frozen=True)
class ReferenceNodeParameters(NodeParameters, ReferenceParameters):
    """Parameters of ``reference_generator``."""

    settled: SettlingParameters = group(SettlingParameters)
    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    samples: int = parameter(
        0, low=0, high=10**12, read_only=True, description="external_plant: length of the run in samples; 0: no end"
    )
    wait_for_recorder: bool = parameter(
        False, read_only=True, description="external_plant: begin when a recorder is there"
    )


@dataclass(frozen=True)
class InchwormSequencerNodeParameters(NodeParameters, InchwormSequencerParameters):
    """Parameters of ``inchworm_sequencer``, which takes the place of ``reference_generator``."""

    publish_description: bool = parameter(
        True, read_only=True, description="publish the joint and its limits as a URDF on robot_description"
    )
    extender_joint: str = parameter(
        "extender", read_only=True, description="name of the extender in joint_states; joint is the slider's"
    )
    measurement_timeout: float = parameter(
        0.2, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of joint_states that closes both clamps"
    )


@dataclass(frozen=True)
class ControllerNodeParameters(NodeParameters, ControllerParameters, CommandRangeParameters):
    """Parameters of ``motion_controller``."""

    use_origin: bool = parameter(
        False, read_only=True, description="inchworm: subtract the sequencer's origin from the measurement"
    )

    measurement_timeout: float = parameter(
        0.2, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of joint_states that makes it go safe"
    )
    spike_limit: float = parameter(
        0.0, unit="m", low=0.0, high=1.0, description="largest believable change of the measurement a sample; 0: any"
    )
    spike_samples: int = parameter(
        3, low=2, high=10**6, description="samples in a row after which a larger change is believed"
    )
    frozen_samples: int = parameter(
        0, low=0, high=10**9, description="equal measurements in a row that count as a frozen sensor; 0: never"
    )
    safe_command: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, description="command while the measurement is stale"
    )
    safe_slew_rate: float = parameter(
        1.0e-4, unit="m/s", low=1.0e-12, high=1.0e3, description="how fast the command goes to safe_command"
    )
    controller_state_rate: float = parameter(
        50.0,
        unit="Hz",
        low=0.0,
        high=1.0e6,
        read_only=True,
        description="how often ~/controller_state and ~/pid_state are published where control_msgs is installed; "
        "0: never",
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        low, high = self.command_range
        if low < high and not low <= self.safe_command <= high:
            allowed = f"must lie within command_minimum … command_maximum = {low:g} … {high:g} m"
            yield Problem("safe_command", self.safe_command, allowed)


@dataclass(frozen=True)
class CompensatorNodeParameters(NodeParameters, CompensatorParameters):
    """Parameters of ``hysteresis_compensator``."""

    adaptation: AdaptationParameters = group(AdaptationParameters)
    command_timeout: float = parameter(
        0.4, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of command that starts the watchdog"
    )
    safe_slew_rate: float = parameter(
        1000.0, unit="V/s", low=1.0e-3, high=1.0e9, description="how fast the voltage goes to safe_voltage"
    )

    def check(self):
        """Yield what does not fit together."""
        yield from super().check()
        yield from self.adaptation.fits(self.hysteresis, self.inverse.type)


@dataclass(frozen=True)
class DisplacementCameraNodeParameters(NodeParameters, CameraParameters):
    """Parameters of ``displacement_camera``."""

    image_timeout: float = parameter(
        1.0, unit="s", low=1.0e-3, high=3600.0, description="realtime: silence of image after which it says so"
    )


@dataclass(frozen=True)
class RecorderNodeParameters(NodeParameters):
    """Parameters of ``recorder``."""

    path: str = parameter(
        "recording",
        read_only=True,
        description="folder of the bag, made anew",
        place="files",
    )
    configuration: str = parameter(
        "", read_only=True, description="parameter file whose text goes into the bag", place="files"
    )
    inchworm: bool = parameter(
        False,
        read_only=True,
        description="record an inchworm's topics; a configuration with an inchworm_sequencer says so by itself",
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
        description="what was recorded is handed to the operating system at least this often",
    )
    max_bag_size: int = parameter(
        0,
        unit="B",
        low=0,
        high=10**15,
        read_only=True,
        description="size of a file of the bag after which the next one begins; 0: any",
    )
    max_bag_duration: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1.0e9,
        read_only=True,
        description="length of a file of the bag after which the next one begins; 0: any",
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
        description="free space on the disk below which it ends the recording, never the axis",
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


def part(parameters: Parameters, cls):
    """Return the block's own parameters, out of the parameters of its node; always the same instance of ``cls``."""
    kept = parameters.__dict__.setdefault("_parts", {})
    if cls not in kept:
        kept[cls] = cls(**{item.name: getattr(parameters, item.name) for item in fields(cls)})
    return kept[cls]
