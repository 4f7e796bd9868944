# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axis of a campaign, and what its figures must stay within."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis_parameters import MESSAGE_RATE, AxisParameters
from hysteresis_ros.reliability.mishaps import COMMAND, FUSED, MEASUREMENT, VOLTAGE
from hysteresis_ros.simulation.axes import single_axis

#: Seconds of the axis in which the voltage may cross its range, where the configuration sets no slew rate.
CROSSING = 0.25
#: Where the axis is sent, as parts of the way from its lowest to its highest reference.
LOW, HIGH = 0.2, 0.8
#: Part of the stroke by which the displacement may leave the places between rest and what was asked for, beside what
#: the slew rate allows while voltages are late and the plant does not trip yet.
BEYOND = 0.1
#: Part of the stroke within which a setpoint is reached.
REACHED = 0.02
#: Part of the range within which a voltage is safe.
SAFE = 0.01
#: What a machine with other work may take longer [s].
SLACK = 0.5


@dataclass(frozen=True)
class Bounds:
    """What the figures of an axis must stay within; times are those of the wall clock.

    Parameters
    ----------
    minimum, maximum, safe : float
        Voltages [V]: limits, and the safe one.
    step : float
        Largest change of the voltage between two samples [V], one bit of the converter included.
    sample_time : float
        Between two samples, in the axis' own time, that of the stamps [s].
    low, high : float
        Where the axis is sent [m].
    stroke : float
        From the lowest to the highest reference [m].
    timeouts : dict of str to float
        Of :data:`hysteresis_ros.reliability.mishaps.TIMEOUTS` [s], the voltage's return to safe included.
    beyond : float
        So far the displacement may leave the places between rest and what was asked for, as a part of the stroke.
    """

    minimum: float
    maximum: float
    safe: float
    step: float
    sample_time: float
    low: float
    high: float
    stroke: float
    timeouts: dict[str, float]
    beyond: float


def at_rate(configuration: Configuration, rate: float) -> Configuration:
    """Return a configuration at another sample rate [Hz], 0: its own; its dynamics are the same from sample to sample.

    What is tried is what the nodes do about time: the time-outs stay what they are in seconds.
    """
    if not rate:
        return configuration
    configuration = configuration.override("", sample_rate=rate)
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    return configuration.override("motion_controller", model__dynamics__sample_time=0.0)


def prepared(configuration: Configuration, way: str, namespace: str) -> AxisParameters:
    """Return the axis of a configuration as a campaign runs it: simulated, held at setpoints, its slew rate limited.

    Parameters
    ----------
    configuration : Configuration
    way : str
        Of :data:`hysteresis_ros.reliability.mishaps.WAYS`.
    namespace : str
        In which it shall run.

    Raises
    ------
    ConfigurationError
        It holds several axes, or an inchworm motor.
    ParameterError
        A parameter is wrong.
    """
    mode = "fused" if way == FUSED else "realtime"
    simulated = configuration.override("", time_mode=mode, autostart=True, exit_at_end=True, external_plant=False)
    simulated = simulated.override("plant_simulator", driver="", real_time_factor=1.0)
    axis = single_axis(simulated.override("reference_generator", waveform__type="hold"))
    if axis.reference_generator is None:
        raise ConfigurationError(f"{configuration.source}: an inchworm motor; a campaign is for axes of one actuator")
    plant = axis.plant_simulator
    span = plant.limits.maximum - plant.limits.minimum
    slew = plant.limits.slew_rate or span / CROSSING
    limits = {"limits__slew_rate": slew, "safe_slew_rate": min(plant.safe_slew_rate, slew)}
    factor = 1.0 if way == FUSED else min(MESSAGE_RATE / plant.sample_rate, 1.0)
    simulated = simulated.override("reference_generator", waveform__type="hold")
    # the plant trips as a device would, also where the file allows its simulated one more late samples
    simulated = simulated.override("plant_simulator", real_time_factor=factor, late_limit=0, **limits)
    simulated = simulated.override("hysteresis_compensator", **limits)
    return replace(single_axis(simulated), namespace=namespace)


def bounds_of(axis: AxisParameters) -> Bounds:
    """Return what the figures of a prepared axis must stay within.

    Parameters
    ----------
    axis : AxisParameters
    """
    plant, source, compensator = axis.plant_simulator, axis.reference_generator, axis.hysteresis_compensator
    assert source is not None
    limits, factor = plant.limits, plant.real_time_factor
    span, stroke = limits.maximum - limits.minimum, source.maximum - source.minimum
    bit = span / 2**limits.bits if limits.bits else 0.0
    back, controller = span / plant.safe_slew_rate, axis.motion_controller
    waits = {
        MEASUREMENT: controller.measurement_timeout + stroke / controller.safe_slew_rate,
        COMMAND: compensator.command_timeout,
        VOLTAGE: plant.voltage_timeout,
    }
    return Bounds(
        limits.minimum,
        limits.maximum,
        plant.safe_voltage,
        max(limits.slew_rate, plant.safe_slew_rate) / plant.sample_rate + bit,
        1.0 / plant.sample_rate,
        source.minimum + LOW * stroke,
        source.minimum + HIGH * stroke,
        stroke,
        {name: (wait + back) / factor + SLACK for name, wait in waits.items()},
        BEYOND + plant.allowed_late / plant.sample_rate * limits.slew_rate / span,
    )
