# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the plant: the actuator, the device in its place, limits of the run, and the thread of a fused loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.compensation.reachable import resting_displacements
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.hardware.driver import Driver, DriverError
from hysteresis_ros.hardware.located import driver_of, options_of
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.loop.common_parameters import NodeParameters, part
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.calibration import AmplifierCalibration, CalibrationParameters
from hysteresis_ros.models.inchworm import JOINT_NAMES, InchwormParameters, seed_problems
from hysteresis_ros.parameters import Parameters, group, parameter, variants
from hysteresis_ros.sensing.simulated_camera import SimulatedCameraParameters

#: Late voltages that are allowed by default: part of the samples of a second, and the least number.
LATE_PART, LEAST_LATE = 0.05, 20


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
