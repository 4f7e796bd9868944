# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An inchworm motor for tests: its parameters, the voltages of a cycle, and a run."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models import friction
from hysteresis_ros.models.block import specialised
from hysteresis_ros.models.clamp import ClampParameters, FirstOrderParameters, LagParameters
from hysteresis_ros.models.friction import SliderParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.inchworm import (
    POSITION,
    InchwormParameters,
    InchwormPlantParameters,
    inchworm_advance,
    inchworm_measure,
)
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.sensor import SensorParameters

STEP = 1e-4
STIFFNESS = 0.41e6
TOP, GRIP, HOLD = 120.0, 100.0, 250  # [V], [V], samples a process
LIMITS = LimitsParameters(minimum=0.0, maximum=120.0)
STACK = HysteresisParameters(type="polynomial", polynomial=assumed_stack(voltage_low=0.0))
LINE = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=1e-7))
SETTLED = 10 * HOLD


def motor(force=0.0, hysteresis=STACK, wear=1.0, noise=0.0, initial_voltage=GRIP, slider=None, **extender):
    """Return parameters of a motor whose clamps hold 7.5 N each at 100 V."""

    def clamp(seed):
        return ClampParameters(
            limits=LIMITS,
            hysteresis=STACK,
            lag=LagParameters(first_order=FirstOrderParameters(time_constant=2e-4)),
            gap=4e-6,
            stiffness=4e6,
            static_friction=0.3,
            kinetic_friction=0.25,
            wear=wear,
            initial_voltage=initial_voltage,
            sensor=SensorParameters(noise=noise, seed=seed),
        )

    given = dict(mass=0.05, external_force=force, minimum=-1e-2, maximum=1e-2) | (slider or {})
    parts = InchwormParameters(
        extender_stiffness=STIFFNESS,
        front_clamp=clamp(3),
        rear_clamp=clamp(4),
        slider=SliderParameters(sensor=SensorParameters(noise=noise, seed=2), **given),
    )
    sensor = SensorParameters(noise=noise, seed=1)
    return InchwormPlantParameters(limits=LIMITS, hysteresis=hysteresis, sensor=sensor, inchworm=parts, **extender)


def phase(extender, front, rear, count=HOLD):
    """Voltages of one phase, shape (count, 3)."""
    return np.column_stack([np.broadcast_to(extender, count), np.full(count, front), np.full(count, rear)])


RISE = TOP * (1.0 - np.cos(np.linspace(0.0, np.pi, HOLD))) / 2.0


def cycle(forward=True):
    """The six phases of K10, then a rest with both clamps closed."""
    there, back = ((GRIP, 0.0), (0.0, GRIP)) if forward else ((0.0, GRIP), (GRIP, 0.0))
    processes = [
        phase(0.0, *there),  # release one clamp, the other holds
        phase(RISE, *there),  # extend
        phase(TOP, *there),
        phase(TOP, GRIP, GRIP),  # clamp
        phase(TOP, *back),  # release the other
        phase(RISE[::-1], *back),  # contract
        phase(0.0, *back),
        phase(0.0, GRIP, GRIP),  # clamp
    ]
    return np.vstack(processes)


def drive(laws, ps, xs, voltages, table):
    """Drive the motor, and store position, tip, measured position and dissipated energy."""
    for k in range(voltages.shape[0]):
        inchworm_measure(ps, xs)
        inchworm_advance(laws, ps, xs, voltages[k, 0], voltages[k, 1], voltages[k, 2])
        table[k, 0] = xs.slider[friction.POSITION]
        table[k, 1] = xs.slider[friction.TIP]
        table[k, 2] = xs.joints[POSITION]
        table[k, 3] = xs.slider[friction.DISSIPATED]


def run(made, voltages):
    """Return the table of :func:`drive`."""
    table = np.empty((len(voltages), 4))
    arguments = made.hysteresis_kernels, made.ps, made.xs, np.ascontiguousarray(voltages), table
    specialised(drive, *arguments)(*arguments)
    return table
