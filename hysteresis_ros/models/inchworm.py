# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inchworm motor: extender, front clamp on its tip, rear clamp on the body, and the slider, moved by friction (K10).

The extender is the actuator of :mod:`hysteresis_ros.models.actuator`. The position of the front clamp is the extender's
free displacement minus F/k, where F is the force on the extender's tip and k the extender's stiffness. The models of
the clamps are in :mod:`hysteresis_ros.models.clamp`, those of slider and friction in
:mod:`hysteresis_ros.models.friction`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import actuator as acting
from hysteresis_ros.models import clamp as clamping
from hysteresis_ros.models import friction
from hysteresis_ros.models.actuator import PRELOAD, Actuator, ActuatorParameters
from hysteresis_ros.models.block import Chain, interpreted, kernel, kernels_of, nested
from hysteresis_ros.models.clamp import Clamp, ClampParameters, contact
from hysteresis_ros.models.creep import creep
from hysteresis_ros.models.friction import Contacts, Slider, SliderParameters, slide, slide_elastically
from hysteresis_ros.models.limits import limits
from hysteresis_ros.models.linear import linear, linear_advance, linear_output
from hysteresis_ros.models.sensor import Sensor, sensor

#: Names of the joints, in the order of ``xs.joints``.
JOINT_NAMES = ("slider", "extender", "front_clamp", "rear_clamp")

# Layout of xs.joints: groups of four numbers, each in the order of JOINT_NAMES.
POSITION = 0  # measured position [m]
VELOCITY = 4  # difference quotient of the last two measured positions [m/s]; 0 at the first measurement
EFFORT = 8  # [N]: friction on the slider; force of the extender on the slider; normal forces of the clamps
TRUE_POSITION = 12  # [m]
STARTED = 16  # 1 after the first measurement
JOINT_STATES = 17
# order of the joints within each group of four
SLIDER_JOINT, EXTENDER_JOINT, FRONT_JOINT, REAR_JOINT = 0, 1, 2, 3

SAMPLE_RATE = 0  # ps.joints[SAMPLE_RATE] [Hz]


class InchwormArrays(NamedTuple):
    """Parameter arrays, or state arrays, of an inchworm motor; the first five belong to the extender."""

    limits: np.ndarray
    hysteresis: np.ndarray
    dynamics: np.ndarray
    sensor: np.ndarray
    creep: np.ndarray
    front_limits: np.ndarray
    front_hysteresis: np.ndarray
    front_lag: np.ndarray
    front_contact: np.ndarray
    rear_limits: np.ndarray
    rear_hysteresis: np.ndarray
    rear_lag: np.ndarray
    rear_contact: np.ndarray
    slider: np.ndarray
    slider_sensor: np.ndarray
    joints: np.ndarray


@kernels_of("kernel", "kernel", "kernel")
class InchwormLaws(NamedTuple):
    """Hysteresis kernels of extender, front clamp and rear clamp."""

    hysteresis: Callable
    front_hysteresis: Callable
    rear_hysteresis: Callable


@dataclass(frozen=True)
class InchwormParameters(Parameters):
    """The parts of an inchworm motor in addition to the actuator: clamps, slider, and stiffness of the extender."""

    extender_stiffness: float = parameter(
        0.41e6, description="stiffness of the extender: force per shortening", unit="N/m", low=1.0, high=1e12
    )
    front_clamp: ClampParameters = group(ClampParameters)
    rear_clamp: ClampParameters = group(ClampParameters)
    slider: SliderParameters = group(SliderParameters)

    def check(self):
        """Yield a Problem if only one contact is compliant, or if a rigid contact has parameters for compliance."""
        compliant = [clamp.compliance > 0.0 for clamp in (self.front_clamp, self.rear_clamp)]
        if compliant[0] != compliant[1]:
            name = "rear_clamp" if compliant[0] else "front_clamp"
            yield Problem(
                f"{name}.compliance",
                0.0,
                "the other contact is compliant: give both a compliance, e.g. 2e-8 m/N, or neither",
            )
        elif not compliant[0]:
            for name, rest in (("damping", 0.0), ("substeps", 1)):
                if getattr(self.slider, name) != rest:
                    remedy = f"is for compliant contacts: set compliance of both clamps, or leave it at {rest}"
                    yield Problem(f"slider.{name}", getattr(self.slider, name), remedy)

    @property
    def contacts(self) -> Contacts:
        """Compliance and kick of the contacts."""
        front, rear = self.front_clamp, self.rear_clamp
        kicks = [clamp.kick / clamp.static_friction if clamp.static_friction else 0.0 for clamp in (front, rear)]
        return Contacts(front.compliance, rear.compliance, *kicks)

    def holding_force(self, front_voltage: float, rear_voltage: float) -> tuple[float, float]:
        """Return the loads [N] that the front clamp alone and the rear clamp alone hold at their grip voltages [V]."""
        return self.front_clamp.holding_force(front_voltage), self.rear_clamp.holding_force(rear_voltage)

    def holding_problems(
        self, front_voltage: float, rear_voltage: float, margin: float = 1.0, prefix: str = "inchworm."
    ):
        """Yield a Problem for each clamp that cannot hold the slider's load at its grip voltage.

        Parameters
        ----------
        front_voltage, rear_voltage : float
            Grip voltages of the gait [V].
        margin : float
            Required holding force, as a multiple of the load. Because the extender is a spring, a suddenly
            applied load oscillates, with a force of up to twice the load. 2 is safe for any gait, 1 is the limit at
            rest.
        prefix : str
            Prefix of the names of the parameters.
        """
        load = margin * abs(self.slider.force)
        for name, voltage in (("front_clamp", front_voltage), ("rear_clamp", rear_voltage)):
            clamp = getattr(self, name)
            holds = clamp.holding_force(voltage)
            if holds <= load:
                remedy = (
                    f"cannot hold the load of {load:.4g} N: at {voltage:g} V static friction holds {holds:.4g} N; "
                    "raise the grip voltage, the stiffness or the friction, or lower the load"
                )
                yield Problem(f"{prefix}{name}.stiffness", clamp.stiffness, remedy)


@dataclass(frozen=True)
class InchwormPlantParameters(ActuatorParameters):
    """Parameters of an inchworm motor as a plant: the extender (an actuator) and the other parts of the motor."""

    inchworm: InchwormParameters = group(InchwormParameters)

    def check(self):
        """Yield a Problem for each noisy sensor whose noise sequence equals the noise of another sensor."""
        yield from super().check()
        yield from seed_problems(self)


def seed_problems(parameters):
    """Yield a Problem for each noisy sensor with the seed of another sensor, because their noises would be equal."""
    motor = parameters.inchworm
    sensors = {
        "sensor": parameters.sensor,
        "inchworm.slider.sensor": motor.slider.sensor,
        "inchworm.front_clamp.sensor": motor.front_clamp.sensor,
        "inchworm.rear_clamp.sensor": motor.rear_clamp.sensor,
    }
    seen: dict[int, str] = {}
    for name, part in sensors.items():
        if part.noise > 0.0:
            if part.seed in seen:
                remedy = f"must differ from {seen[part.seed]}.seed: equal seeds give equal noise"
                yield Problem(f"{name}.seed", part.seed, remedy)
            seen.setdefault(part.seed, name)


@kernel
def inchworm_measure(ps, xs):
    """Return the reading [m] of the slider's sensor at the present sample; fill ``xs.joints`` for all joints.

    ``ps`` and ``xs`` are :class:`InchwormArrays`.
    """
    joints, x, rate = xs.joints, xs.slider, ps.joints[SAMPLE_RATE]
    front, rear = xs.front_contact, xs.rear_contact
    tip = x[friction.TIP]
    joints[TRUE_POSITION] = x[friction.POSITION]
    joints[TRUE_POSITION + 1] = tip
    joints[TRUE_POSITION + 2] = front[clamping.DISPLACEMENT]
    joints[TRUE_POSITION + 3] = rear[clamping.DISPLACEMENT]
    for i in range(4):
        joints[VELOCITY + i] = -joints[POSITION + i]
    joints[POSITION] = sensor(ps.slider_sensor, xs.slider_sensor, x[friction.POSITION])
    joints[POSITION + 1] = sensor(ps.sensor, xs.sensor, tip)
    joints[POSITION + 2] = sensor(ps.front_contact, front, front[clamping.DISPLACEMENT])
    joints[POSITION + 3] = sensor(ps.rear_contact, rear, rear[clamping.DISPLACEMENT])
    for i in range(4):
        joints[VELOCITY + i] = (joints[POSITION + i] + joints[VELOCITY + i]) * rate * joints[STARTED]
    joints[EFFORT] = x[friction.FRONT_FORCE] + x[friction.REAR_FORCE]
    joints[EFFORT + 1] = x[friction.FRONT_FORCE]
    joints[EFFORT + 2] = front[clamping.NORMAL]
    joints[EFFORT + 3] = rear[clamping.NORMAL]
    joints[STARTED] = 1.0
    xs.sensor[acting.DISPLACEMENT] = tip
    return joints[POSITION]


@nested
def inchworm_advance(laws, ps, xs, voltage, front_voltage, rear_voltage):
    """Hold three voltages [V] until the next sample; return the output voltage of the extender's amplifier [V].

    ``laws`` contains the kernels of :class:`InchwormLaws`. The outputs of the clamps' amplifiers are in
    ``xs.front_limits`` and ``xs.rear_limits``.
    """
    applied = limits(ps.limits, xs.limits, voltage)
    wanted = creep(ps.creep, xs.creep, laws.hysteresis(ps.hysteresis, xs.hysteresis, applied))
    linear_advance(ps.dynamics, xs.dynamics, wanted)
    free = linear_output(ps.dynamics, xs.dynamics) + ps.sensor[PRELOAD]

    put_out = limits(ps.front_limits, xs.front_limits, front_voltage)
    wanted = laws.front_hysteresis(ps.front_hysteresis, xs.front_hysteresis, put_out)
    displacement = linear(ps.front_lag, xs.front_lag, wanted)
    normal = contact(ps.front_contact, xs.front_contact, displacement)
    xs.slider[friction.FRONT_STATIC] = ps.front_contact[clamping.STATIC] * normal
    xs.slider[friction.FRONT_KINETIC] = ps.front_contact[clamping.KINETIC] * normal

    put_out = limits(ps.rear_limits, xs.rear_limits, rear_voltage)
    wanted = laws.rear_hysteresis(ps.rear_hysteresis, xs.rear_hysteresis, put_out)
    displacement = linear(ps.rear_lag, xs.rear_lag, wanted)
    normal = contact(ps.rear_contact, xs.rear_contact, displacement)
    xs.slider[friction.REAR_STATIC] = ps.rear_contact[clamping.STATIC] * normal
    xs.slider[friction.REAR_KINETIC] = ps.rear_contact[clamping.KINETIC] * normal

    if ps.slider[friction.SUBSTEPS] > 0.0:
        slide_elastically(ps.slider, xs.slider, free)
    else:
        slide(ps.slider, xs.slider, free)
    return applied


class Inchworm(Chain):
    """An inchworm motor with amplifiers and sensors.

    Call :meth:`measure` and then :meth:`advance` once per sample. Composites use ``ps``, ``xs`` and
    ``hysteresis_kernels`` (extender, front clamp, rear clamp) directly.

    Parameters
    ----------
    parameters : InchwormPlantParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        Parameters are wrong; the message states each wrong parameter.
    """

    def __init__(self, parameters: InchwormPlantParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        motor = parameters.inchworm
        self.extender = Actuator(_extender(parameters), sample_time)
        self.front_clamp = Clamp(motor.front_clamp, sample_time)
        self.rear_clamp = Clamp(motor.rear_clamp, sample_time)
        self.slider = Slider(motor.slider, sample_time, motor.extender_stiffness, motor.contacts)
        self.slider_sensor = Sensor(motor.slider.sensor, sample_time)
        own = (self.slider.p, self.slider_sensor.p, np.array([1.0 / self.sample_time]))
        clamps = *self.front_clamp.ps, *self.rear_clamp.ps
        self.ps = InchwormArrays._make((*self.extender.ps[:5], *clamps, *own))
        own = (self.slider.x, self.slider_sensor.x, np.zeros(JOINT_STATES))
        clamps = *self.front_clamp.xs, *self.rear_clamp.xs
        self.xs = InchwormArrays._make((*self.extender.xs[:5], *clamps, *own))
        self.hysteresis_kernels = InchwormLaws(
            *(part.hysteresis_kernel for part in (self.extender, self.front_clamp, self.rear_clamp))
        )
        self._settle()

    def _settle(self) -> None:
        """Set the slider to rest at its initial position; the clamps hold it in their present state."""
        x = self.slider.x
        for clamp, static, kinetic in (
            (self.front_clamp, friction.FRONT_STATIC, friction.FRONT_KINETIC),
            (self.rear_clamp, friction.REAR_STATIC, friction.REAR_KINETIC),
        ):
            x[static] = clamp.ps.contact[clamping.STATIC] * clamp.normal_force
            x[kinetic] = clamp.ps.contact[clamping.KINETIC] * clamp.normal_force
        self.slider.settle(linear_output(self.ps.dynamics, self.xs.dynamics) + self.ps.sensor[PRELOAD])

    def measure(self) -> np.ndarray:
        """Return the measured positions [m] of the joints in the order of JOINT_NAMES, shape (4,).

        Call it once per sample, because each call generates noise. ``joints`` contains velocities and efforts.
        """
        interpreted(inchworm_measure)(self.ps, self.xs)
        return self.joints[POSITION : POSITION + 4].copy()

    def advance(self, voltage: float, front_voltage: float, rear_voltage: float) -> float:
        """Hold three voltages [V] for one sample and return the output of the extender's amplifier [V]."""
        voltages = float(voltage), float(front_voltage), float(rear_voltage)
        return interpreted(inchworm_advance)(self.hysteresis_kernels, self.ps, self.xs, *voltages)

    @property
    def joints(self) -> np.ndarray:
        """Array ``xs.joints``, shape (17,): positions, velocities, efforts, true positions at the last measurement."""
        return self.xs.joints

    @property
    def displacement(self) -> float:
        """True displacement [m] of the slider."""
        return float(self.slider.x[friction.POSITION])

    @property
    def voltages(self) -> tuple[float, float, float]:
        """Output voltages [V] of the amplifiers of extender, front and rear clamp."""
        return self.extender.voltage, self.front_clamp.voltage, self.rear_clamp.voltage

    @property
    def saturated(self) -> bool:
        """Whether the range or the slew rate limited one of the last voltages."""
        return any(part.limits.saturated for part in (self.extender, self.front_clamp, self.rear_clamp))

    def reset(self) -> None:
        """Return to rest at the start, with the hysteresis in its initial state; the noise sequence starts again."""
        for block in (self.extender, self.front_clamp, self.rear_clamp, self.slider, self.slider_sensor):
            block.reset()
        self.joints[:] = 0.0
        self._settle()

    def retune(self, parameters: InchwormPlantParameters) -> None:
        """Change to parameters of the same structure while running; all states continue.

        Raises
        ------
        ParameterError
            The parameters are wrong, change the structure, or set a travel that does not contain the slider; the motor
            then remains unchanged.
        """
        motor = parameters.validated().inchworm
        for name in ("front_clamp", "rear_clamp"):
            try:
                getattr(self, name).check_retune(getattr(motor, name))
            except ParameterError as error:
                found = [replace(item, name=f"inchworm.{name}.{item.name}") for item in error.problems]
                raise ParameterError(found) from None
        self.slider.check_travel(motor.slider)
        self.extender.retune(_extender(parameters))  # the last part that can raise an error
        self.front_clamp.retune(motor.front_clamp)
        self.rear_clamp.retune(motor.rear_clamp)
        self.slider.stiffness, self.slider.contacts = motor.extender_stiffness, motor.contacts
        self.slider.retune(motor.slider)
        self.slider_sensor.retune(motor.slider.sensor)
        self.parameters = parameters


def _extender(parameters: InchwormPlantParameters) -> ActuatorParameters:
    """Return the parameters that belong to the extender itself."""
    return ActuatorParameters(**{item.name: getattr(parameters, item.name) for item in fields(ActuatorParameters)})
