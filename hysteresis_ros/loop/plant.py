# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The plant as a part of the loop: an actuator, with or without a camera, or an inchworm motor, and its monitoring.

A voltage that is not received in time is late: the last voltage is held, and the sample is counted. After
``voltage_timeout`` without a voltage, the output goes to its safe value; when voltages arrive again, the output returns
without a jump. With more than ``late_limit`` late voltages in a row, or within a second, the loop counts as open: the
plant *trips*, that is, it goes to its safe voltage and stops the axis until the axis is started again. The plant also
trips when the measurement of an actuator is far beyond the static range, which only an unstable loop or a wrong sensor
can cause.

A plant with a camera has no measurement of its own. Offline, this part evaluates each frame in the sample in which the
frame is taken; between nodes, frames are messages. Such samples run in Python, because evaluating a frame takes a
thousand times as long as any other sample.

On a stage, all axes stop when the plant of one axis trips. :func:`hysteresis_ros.loop.stage.stage_ticks` applies this
rule in the compiled loop, and :mod:`hysteresis_ros.nodes.stage` applies it between nodes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.hardware.simulated_camera import SimulatedCamera
from hysteresis_ros.hardware.tracker import CameraParameters, Tracker
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.parameters import DisplacementCameraNodeParameters, PlantNodeParameters, part
from hysteresis_ros.loop.watch import (
    HELD,
    HELD_AGE,
    HELD_BEGUN,
    HOLD_TIMEOUT,
    HOLDING,
    RUNNING,
    STALE,
    TRIPPED,
    hold_state,
    hold_voltage,
    least_beside,
    samples_of,
)
from hysteresis_ros.models import actuator as acting
from hysteresis_ros.models import clamp as clamping
from hysteresis_ros.models import inchworm as motors
from hysteresis_ros.models import limits as limiting
from hysteresis_ros.models.actuator import (
    Actuator,
    ActuatorArrays,
    ActuatorParameters,
    actuator_advance,
    actuator_force,
    actuator_measure,
)
from hysteresis_ros.models.block import by_part, interpreted, kernel, nested
from hysteresis_ros.models.inchworm import (
    Inchworm,
    InchwormArrays,
    InchwormPlantParameters,
    inchworm_advance,
    inchworm_measure,
)


@by_part
def sense(laws, part, row):
    """Measure the present sample of a plant of this kind into its row."""


@by_part
def actuate(laws, part, row):
    """Hold the voltages of a sample until the next sample, if they were received in time."""


@by_part
def tell_joints(laws, part, row):
    """Write the contents of ``joint_states`` of a plant of this kind into an array of JOINT_NUMBERS."""


class PlantWatchArrays(NamedTuple):
    """Parameter arrays, or state arrays, of the monitoring of a plant's voltages."""

    trip: np.ndarray
    faults: np.ndarray
    hold: np.ndarray
    front_hold: np.ndarray
    rear_hold: np.ndarray


class ActuatorPlantArrays(NamedTuple):
    """All arrays of an actuator in the loop."""

    p: ActuatorArrays
    x: ActuatorArrays
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays


class MotorPlantArrays(NamedTuple):
    """All arrays of an inchworm motor in the loop."""

    p: InchwormArrays
    x: InchwormArrays
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays


#: Faults that act on a plant.
TARGETS = (faulty.VOLTAGE, faulty.GRIP, faulty.FORCE)

# Parameters of the trip: allowed number of late voltages (0: no limit); decrease of the decaying count of late voltages
# in each sample; allowed range of the measurement [m]; nominal stiffness of the front clamp, for the fault lost_grip.
LIMIT, FORGIVEN, LOWEST, HIGHEST, STIFFNESS = range(5)
TRIP_PARAMETERS = 5

# Reasons of a trip: too many late voltages; a measurement out of range; an emergency stop; a failed device (kept until
# a start, whatever follows); a lost node of the axis.
NOT_TRIPPED, WITHOUT_VOLTAGE, BEYOND_TRAVEL, HALTED, DEVICE_FAILED, PARTNER_LOST = range(6)
# A relative sensor is being homed: this stop ends without a start, and any other reason replaces it.
FINDING_HOME = -1

# State: reason of the trip, late voltages so far, late voltages in a row, decaying count of late voltages; mode of the
# plant at the last voltage.
TRIP, LATE, IN_ROW, LEVEL, MODE = range(5)
TRIP_STATES = 5


@kernel
def watch(p, x, late, measured):
    """Count the sample if its voltage is late (``late`` 1); trip on too many late voltages, or on overtravel.

    An unstable loop oscillates far beyond the range that constant voltages reach.
    """
    x[LATE] += late
    x[IN_ROW] = (x[IN_ROW] + 1.0) * late
    x[LEVEL] = max(x[LEVEL] - p[FORGIVEN], 0.0) + late
    if p[LIMIT] > 0.0 and (x[IN_ROW] > p[LIMIT] or x[LEVEL] > p[LIMIT]):
        x[TRIP] = WITHOUT_VOLTAGE
    if measured < p[LOWEST] or measured > p[HIGHEST]:
        x[TRIP] = BEYOND_TRAVEL


@kernel
def is_missing(x, voltage):
    """Return 1.0 if this sample has no voltage although an earlier sample had one; otherwise 0.0."""
    return 1.0 if x[HELD_BEGUN] != 0.0 and voltage - voltage != 0.0 else 0.0


@kernel
def plant_mode(p, x, trip, late):
    """Return the mode of the plant."""
    if trip[TRIP] != 0.0:
        return TRIPPED
    if x[HELD_AGE] >= p[HOLD_TIMEOUT]:
        return STALE
    return HOLDING if late != 0.0 else RUNNING


@kernel
def put_out(trip_p, trip_x, hold_p, hold_x, voltage, measured):
    """Return the output voltage [V] for the received voltage (NaN: no voltage), after all monitoring.

    This is one function, so that a node needs only one call from Python.
    """
    late = is_missing(hold_x, voltage)
    watch(trip_p, trip_x, late, measured)
    held = hold_voltage(hold_p, hold_x, voltage, trip_x[TRIP], -math.inf)
    trip_x[MODE] = plant_mode(hold_p, hold_x, trip_x, late)
    return held


@nested
def told_force(p, x, force):
    """Return the measured force [N] after fault injection; ``p`` and ``x`` are :class:`PlantWatchArrays`."""
    return faulty.given_instead(p.faults, x.faults, faulty.FORCE, force)


@nested
def sense_actuator(laws, arrays, row):
    """Measure an actuator."""
    faulty.begin_sample(arrays.watch_x.faults)
    row[at.MEASURED] = actuator_measure(arrays.p, arrays.x)
    row[at.FORCE] = told_force(arrays.watch_p, arrays.watch_x, actuator_force(arrays.p, arrays.x))
    row[at.DISPLACEMENT] = arrays.x.sensor[acting.DISPLACEMENT]
    row[at.PLANT_VOLTAGE] = arrays.x.limits[limiting.OUTPUT]
    row[at.TRIPPED] = arrays.watch_x.trip[TRIP]


@nested
def sent(row, place):
    """Return one of the voltages of a row [V]; NaN in a skipped sample, which has no voltage."""
    return math.nan if row[at.SKIPPED] != 0.0 else row[place]


@nested
def watched_voltage(p, x, row):
    """Return the voltage [V] that an amplifier outputs after this sample, and write the plant's mode into the row.

    ``p`` and ``x`` are :class:`PlantWatchArrays`.
    """
    voltage = faulty.given_instead(p.faults, x.faults, faulty.VOLTAGE, sent(row, at.VOLTAGE))
    trip = x.trip
    held = put_out(p.trip, trip, p.hold, x.hold, voltage, row[at.MEASURED])
    row[at.PLANT_MODE] = trip[MODE]
    row[at.LATE] = trip[LATE]
    return held


@nested
def actuate_actuator(laws, arrays, row):
    """Hold the voltage on an actuator."""
    held = watched_voltage(arrays.watch_p, arrays.watch_x, row)
    row[at.PLANT_VOLTAGE] = actuator_advance(laws.hysteresis, arrays.p, arrays.x, held)


@nested
def sense_motor(laws, arrays, row):
    """Measure all joints of a motor."""
    faulty.begin_sample(arrays.watch_x.faults)
    row[at.MEASURED] = inchworm_measure(arrays.p, arrays.x)
    row[at.FORCE] = math.nan
    joints = arrays.x.joints
    row[at.DISPLACEMENT] = joints[motors.TRUE_POSITION + motors.SLIDER_JOINT]
    row[at.EXTENDER] = joints[motors.POSITION + motors.EXTENDER_JOINT]
    row[at.EXTENDER_DISPLACEMENT] = joints[motors.TRUE_POSITION + motors.EXTENDER_JOINT]
    row[at.FRONT_FORCE] = joints[motors.EFFORT + motors.FRONT_JOINT]
    row[at.REAR_FORCE] = joints[motors.EFFORT + motors.REAR_JOINT]
    row[at.TRIPPED] = arrays.watch_x.trip[TRIP]


@nested
def actuate_motor(laws, arrays, row):
    """Hold three voltages on a motor.

    A safe state never opens a clamp, because a free slider would fall. Each clamp goes to its initial voltage, or keeps
    its present voltage if that is higher. The gait always keeps one clamp closed; after a safe state, a clamp opens
    only when the other clamp has reached the gait's voltage.
    """
    p, x = arrays.watch_p, arrays.watch_x
    voltage = faulty.given_instead(p.faults, x.faults, faulty.VOLTAGE, sent(row, at.VOLTAGE))
    front, rear = sent(row, at.FRONT_VOLTAGE), sent(row, at.REAR_VOLTAGE)
    missing = max(is_missing(x.hold, voltage), is_missing(x.front_hold, front))
    late = max(missing, is_missing(x.rear_hold, rear))
    watch(p.trip, x.trip, late, row[at.MEASURED])
    tripped = x.trip[TRIP]
    grip = faulty.corrupt(p.faults, x.faults, faulty.GRIP, 1.0)
    if p.faults[faulty.COUNT] > 0.0:
        arrays.p.front_contact[clamping.STIFFNESS] = p.trip[STIFFNESS] * grip
    front_least, rear_least = least_beside(x.front_hold, x.rear_hold), least_beside(x.rear_hold, x.front_hold)
    really = inchworm_advance(
        laws,
        arrays.p,
        arrays.x,
        hold_voltage(p.hold, x.hold, voltage, tripped, -math.inf),
        hold_voltage(p.front_hold, x.front_hold, front, tripped, front_least),
        hold_voltage(p.rear_hold, x.rear_hold, rear, tripped, rear_least),
    )
    row[at.PLANT_VOLTAGE] = really
    row[at.FRONT_PLANT_VOLTAGE] = arrays.x.front_limits[limiting.OUTPUT]
    row[at.REAR_PLANT_VOLTAGE] = arrays.x.rear_limits[limiting.OUTPUT]
    row[at.PLANT_MODE] = plant_mode(p.hold, x.hold, x.trip, late)
    row[at.LATE] = x.trip[LATE]


#: Contents of ``joint_states`` of a motor: positions, velocities and efforts of four joints.
JOINT_NUMBERS = motors.TRUE_POSITION


@nested
def no_joints(laws, part, numbers):
    """Do nothing, because the row has all signals of an actuator."""


@nested
def motor_joints(laws, part, numbers):
    """Write positions, velocities and efforts of a motor's joints."""
    for i in range(numbers.shape[0]):
        numbers[i] = part.x.joints[i]


sense.kinds[ActuatorPlantArrays], actuate.kinds[ActuatorPlantArrays] = sense_actuator, actuate_actuator
sense.kinds[MotorPlantArrays], actuate.kinds[MotorPlantArrays] = sense_motor, actuate_motor
tell_joints.kinds[ActuatorPlantArrays], tell_joints.kinds[MotorPlantArrays] = no_joints, motor_joints


class Plant:
    """Base class of the plants of an axis, with the monitoring of their voltages."""

    arrays: Any  #: All arrays of the plant in the loop; their class selects the kernel of :data:`sense`.
    kernels: tuple[Any, Any, Any]  #: Kernels of the hysteresis of the actuators, or placeholders.
    kind = at.ACTUATOR  #: Kind of the axis.
    joint_numbers = 0  #: Number of values of ``joint_states`` that are not in the row.

    def __init__(self, parameters: PlantNodeParameters):
        self.parameters = parameters
        self._watch_p = PlantWatchArrays(
            np.zeros(TRIP_PARAMETERS),
            faulty.fault_parameters(parameters.faults, TARGETS, parameters.sample_rate),
            *(np.zeros(4) for _ in range(3)),
        )
        self._watch_x = PlantWatchArrays(
            np.zeros(TRIP_STATES), faulty.fault_state(self._watch_p.faults), *map(hold_state, self.resting_voltages)
        )
        self._pack(parameters)

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] of the three inputs before a voltage is received; 0 for inputs that an actuator lacks."""
        return 0.0, 0.0, 0.0

    @property
    def safe_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] to which the three inputs go when no voltages are received."""
        return self.parameters.safe_voltage, 0.0, 0.0

    def _pack(self, parameters: PlantNodeParameters) -> None:
        rate = parameters.sample_rate
        p = self._watch_p
        limit = float(parameters.allowed_late)
        p.trip[LIMIT], p.trip[FORGIVEN] = limit, limit / rate
        p.trip[LOWEST], p.trip[HIGHEST] = self.travel
        holds = (p.hold, p.front_hold, p.rear_hold)
        for hold, safe, keeps in zip(holds, self.safe_voltages, (0.0, 1.0, 1.0), strict=True):
            timeout = samples_of(parameters.voltage_timeout, rate)
            hold[:] = safe, parameters.safe_slew_rate / rate, timeout, keeps

    @property
    def travel(self) -> tuple[float, float]:
        """Allowed range of the measurement [m]; an inchworm's slider is monitored by its sequencer."""
        return -math.inf, math.inf

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in ``joint_states``."""
        own = self.parameters.joint
        return (own, self.parameters.force_joint) if self.measures_force else (own,)

    #: Messages: the device error that has stopped the axis, and why the last reading is invalid; empty: neither.
    failure = complaint = ""

    #: The node whose loss has stopped the axis.
    lost = ""

    #: Whether the axis is stopped because its sensor is being homed.
    finding_home = False

    #: Whether the force in the stack is measured in addition to the displacement.
    measures_force = False

    #: Quantisation step [V] of the output that the plant reports before each sample; infinite: no output is reported.
    rounding = math.inf

    #: Whether the first sample starts at the safe voltage, from which the output slews to the received voltage.
    begins_safe = False

    #: Whether the samples of this plant run in machine code.
    is_compiled = True

    #: Whether a sample in machine code calls methods in Python.
    calls_python = False

    #: Duration of a sample after which the device counts as blocked [s].
    patience = 0.5

    #: Indices in the row of the additional inputs that a run with this plant has.
    given: tuple[int, ...] = ()

    @property
    def halted(self) -> bool:
        """Whether an emergency stop has stopped the axis."""
        return bool(self._watch_x.trip[TRIP] == HALTED)

    @property
    def overtravelled(self) -> bool:
        """Whether a measurement out of range has stopped the axis."""
        return bool(self._watch_x.trip[TRIP] == BEYOND_TRAVEL)

    @property
    def tripped(self) -> bool:
        """Whether the plant has stopped the axis."""
        return bool(self._watch_x.trip[TRIP])

    @property
    def stopped_with_stage(self) -> bool:
        """Whether this axis is stopped because another axis of its stage is stopped."""
        return bool(self._watch_x.trip[TRIP] == PARTNER_LOST) and not self.lost

    def stop_with_stage(self) -> None:
        """Stop because another axis of the stage is stopped; an earlier reason of this axis is kept."""
        if not self.tripped:
            self._watch_x.trip[TRIP] = PARTNER_LOST

    @property
    def late(self) -> int:
        """Late voltages so far."""
        return int(self._watch_x.trip[LATE])

    @property
    def silent(self) -> bool:
        """Whether no voltage was received within the time-out."""
        holds = zip(self._watch_p[2:], self._watch_x[2:], strict=True)
        return any(x[HELD_AGE] >= p[HOLD_TIMEOUT] for p, x in holds)

    def await_voltages(self) -> None:
        """Count samples without a voltage as late, even before the first voltage."""
        for x in self._watch_x[2:]:
            x[HELD_BEGUN] = 1.0

    def count_late(self) -> None:
        """Count as late a voltage that is output nevertheless."""
        self._watch_x.trip[LATE] += 1.0

    def held(self, input_: int = 0) -> float:
        """Output voltage [V] on one of the inputs."""
        return float(self._watch_x[2 + input_][HELD])

    def inject(self, faults: tuple[str, ...]) -> None:
        """Replace the scheduled faults; their times are counted from now."""
        p = faulty.fault_parameters(faults, TARGETS, self.parameters.sample_rate)
        self._watch_p = self._watch_p._replace(faults=p)
        self._watch_x = self._watch_x._replace(faults=faulty.fault_state(p))
        self.arrays = self.arrays._replace(watch_p=self._watch_p, watch_x=self._watch_x)

    def start(self) -> None:
        """Restart the axis after a trip."""
        self._watch_x.trip[TRIP] = 0.0
        self.lost = ""
        self.forgive()

    def recover(self) -> bool:
        """Make a device safe before a start, outside the loop's thread; return whether it had not been safe."""
        return False

    def lose(self, name: str) -> None:
        """Stop the axis until it is started again, because one of its nodes is lost; an earlier reason is kept."""
        self.lost = name
        if self._watch_x.trip[TRIP] in (NOT_TRIPPED, WITHOUT_VOLTAGE):
            self._watch_x.trip[TRIP] = PARTNER_LOST

    def halt(self) -> None:
        """Stop the axis immediately, until it is started again."""
        self._watch_x.trip[TRIP] = max(self._watch_x.trip[TRIP], HALTED)

    def forgive(self) -> None:
        """Reset the count of late voltages."""
        self._watch_x.trip[[IN_ROW, LEVEL]] = 0.0

    def reset(self) -> None:
        """Return to the state of rest."""
        x = self._watch_x
        x.trip[:] = 0.0
        self.lost = ""
        x.faults[:] = faulty.fault_state(self._watch_p.faults)
        for hold, voltage in zip(x[2:], self.resting_voltages, strict=True):
            hold[:] = hold_state(voltage)

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Apply new parameters of the same structure while running."""
        self.parameters = parameters
        self._pack(parameters)

    def step_to_safe(self) -> bool:
        """Move the voltage of a device one step towards its safe voltage; False if it is reached."""
        return False

    def home(self) -> None:
        """Find the zero of a relative sensor."""
        raise ParameterError([Problem("driver", "", "a simulated sensor is absolute: there is nothing to home")])

    def refresh(self) -> None:
        """Repeat the output of a device between samples, so that the device's watchdog does not act."""

    def output_clock(self, edges: at.Edge) -> None:
        """Output the scan edges of this sample; a simulated plant has no outputs for them."""

    def output_trigger(self, number: int, delay: float) -> None:
        """Output a trigger that occurred ``delay`` [s] before a sample; a simulated plant has no output for it."""

    def make_safe(self) -> None:
        """Bring a device to its safe state."""

    def close(self) -> str:
        """Release a device; return the problem that remains, or an empty text."""
        return ""


class ActuatorPlant(Plant):
    """One actuator."""

    def __init__(self, parameters: PlantNodeParameters):
        self.actuator = Actuator(part(parameters, ActuatorParameters), 1.0 / parameters.sample_rate)
        super().__init__(parameters)
        self.arrays = ActuatorPlantArrays(self.actuator.ps, self.actuator.xs, self._watch_p, self._watch_x)

    @property
    def kernels(self):
        """Kernels of the hysteresis for the loop, with placeholders for the clamps."""
        return (self.actuator.hysteresis_kernel,) * 3

    @property
    def measures_force(self) -> bool:
        """Whether there is a force sensor."""
        return self.parameters.force_sensor.there

    @property
    def rounding(self) -> float:
        """Quantisation step [V] of the output voltage."""
        return float(self.arrays.p.limits[limiting.STEP])

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] before the first voltage is received."""
        return self.actuator.voltage, 0.0, 0.0

    @property
    def travel(self) -> tuple[float, float]:
        """Allowed range of the measurement [m]."""
        return self.parameters.allowed_travel

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited the last voltage."""
        return self.actuator.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far in which range or slew rate limited the voltage."""
        return self.actuator.limits.limited_samples

    def reset(self) -> None:
        """Return to the state of rest."""
        self.actuator.reset()
        super().reset()

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Apply new parameters of the same structure while running."""
        self.actuator.retune(part(parameters, ActuatorParameters))
        super().retune(parameters)


class MotorPlant(Plant):
    """An inchworm motor: three voltages, four joints."""

    kind = at.INCHWORM
    joint_numbers = JOINT_NUMBERS

    def __init__(self, parameters: PlantNodeParameters):
        self.motor = Inchworm(part(parameters, InchwormPlantParameters), 1.0 / parameters.sample_rate)
        super().__init__(parameters)
        self.arrays = MotorPlantArrays(self.motor.ps, self.motor.xs, self._watch_p, self._watch_x)

    def _pack(self, parameters: PlantNodeParameters) -> None:
        super()._pack(parameters)
        self._watch_p.trip[STIFFNESS] = self.motor.ps.front_contact[clamping.STIFFNESS]

    @property
    def kernels(self):
        """Hysteresis of extender, front and rear clamp, for the loop."""
        return self.motor.hysteresis_kernels

    @property
    def resting_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] before the first voltage is received."""
        return self.motor.voltages

    @property
    def safe_voltages(self) -> tuple[float, float, float]:
        """Voltages [V] to which the inputs go without commands; a clamp keeps its present voltage if that is higher."""
        motor = self.parameters.inchworm
        return self.parameters.safe_voltage, motor.front_clamp.initial_voltage, motor.rear_clamp.initial_voltage

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in ``joint_states``."""
        return (self.parameters.joint, *motors.JOINT_NAMES[1:])

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited one of the last voltages."""
        return self.motor.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far in which range or slew rate limited a voltage, summed over the three amplifiers."""
        motor = self.motor
        return sum(item.limits.limited_samples for item in (motor.extender, motor.front_clamp, motor.rear_clamp))

    def reset(self) -> None:
        """Return to the state of rest, with the clamps at their initial voltages."""
        self.motor.reset()
        super().reset()

    def retune(self, parameters: PlantNodeParameters) -> None:
        """Apply new parameters of the same structure while running."""
        self.motor.retune(part(parameters, InchwormPlantParameters))
        super().retune(parameters)


class CameraPart:
    """Converts frames to displacements: ``displacement_camera`` as a part of the loop."""

    def __init__(self, parameters: DisplacementCameraNodeParameters):
        self.parameters = parameters
        self.tracker = Tracker(part(parameters, CameraParameters))

    def retune(self, parameters: DisplacementCameraNodeParameters) -> None:
        """Apply new limits for the rejection of frames."""
        self.tracker.retune(part(parameters, CameraParameters))
        self.parameters = parameters

    def reset(self) -> None:
        """Restart with the next frame, which defines the zero of relative positions again."""
        self.tracker.reset()

    def inject(self, faults: tuple[str, ...]) -> None:
        """Do nothing, because faults of the measurement act at the controller."""


class Eye:
    """The camera of a plant, and the part that evaluates its frames unless a camera node evaluates them."""

    def __init__(self, camera: SimulatedCamera):
        self.camera = camera
        self.part: CameraPart | None = None
        self.frame: np.ndarray | None = None

    def look(self, displacement: float) -> float:
        """Take a frame at a displacement [m] and return the displacement in it [m]; NaN: a node evaluates it."""
        self.frame = self.camera.take(displacement)
        return math.nan if self.part is None else self.part.tracker.see(self.frame)[0]


class SeenPlantArrays(NamedTuple):
    """All arrays of an actuator with a camera."""

    p: ActuatorArrays
    x: ActuatorArrays
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays
    eye: Eye


_SENSE, _ACTUATE = interpreted(sense_actuator), interpreted(actuate_actuator)


def _sense_seen(laws, arrays, row):
    """Measure the tip by the camera."""
    _SENSE(laws, arrays, row)
    row[at.MEASURED] = arrays.eye.look(float(row[at.DISPLACEMENT]))


def _actuate_seen(laws, arrays, row):
    """Hold the voltage on the actuator; the plant itself has no measurement."""
    seen, row[at.MEASURED] = row[at.MEASURED], math.nan
    _ACTUATE(laws, arrays, row)
    row[at.MEASURED] = seen


sense.kinds[SeenPlantArrays], actuate.kinds[SeenPlantArrays] = _sense_seen, _actuate_seen
tell_joints.kinds[SeenPlantArrays] = no_joints


class SeenPlant(ActuatorPlant):
    """One actuator with a camera."""

    is_compiled = False

    def __init__(self, parameters: PlantNodeParameters):
        super().__init__(parameters)
        self.eye = Eye(SimulatedCamera(parameters.camera, 1.0 / parameters.sample_rate))
        self.arrays = SeenPlantArrays(self.actuator.ps, self.actuator.xs, self._watch_p, self._watch_x, self.eye)

    @property
    def travel(self) -> tuple[float, float]:
        """Allowed range of the measurement [m]: unlimited, because the plant has no measurement."""
        return -math.inf, math.inf

    def reset(self) -> None:
        """Return to the state of rest; the next frame counts as the first."""
        super().reset()
        self.eye.camera.reset()


#: Plant of each ``type``.
PLANTS = {"actuator": ActuatorPlant, "inchworm": MotorPlant, "camera": SeenPlant}
