# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs of an axis whose frequency response is measured: open loop at the voltage or the command, or closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.excitations import PLACES, Experiment, Plan, excitation
from hysteresis_ros.identification.response_analysis import LEAST_RATIO
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.state_space import StateSpace
from hysteresis_ros.references.ways import REST, WAY, hold, there_and_back
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.driven_axis import OPEN, PLAYED, UNFED, driven, following, write_samples
from hysteresis_ros.units import quantity, readable

#: Peak of the excitation by default, as a part of the range.
AMPLITUDE = 0.05
#: Seconds at the place where it is excited, before and after: creep fades meanwhile.
WAIT = 1.0


@dataclass(frozen=True)
class ResponseRequest:
    """What is asked of a run.

    Parameters
    ----------
    experiment : Experiment
    loop : str
        ``open`` or ``closed``.
    at : str, optional
        Where it is excited: ``voltage``, ``command`` or ``reference``.
    amplitude, offset : str, optional
        Peak of the excitation and the place around which it moves, with units; parts of the range without one. By
        default :data:`AMPLITUDE`, and the middle.
    """

    experiment: Experiment
    loop: str = "open"
    at: str | None = None
    amplitude: str | None = None
    offset: str | None = None

    @property
    def place(self) -> str:
        """Where it is excited.

        Raises
        ------
        ConfigurationError
            The loop has no such place.
        """
        chosen = self.at or PLACES[self.loop][0]
        if chosen not in PLACES[self.loop]:
            raise ConfigurationError(f"--at {chosen}: with --loop {self.loop} must be {' or '.join(PLACES[self.loop])}")
        return chosen


def response_run(
    configuration: Configuration, namespace: str | None, asked: ResponseRequest, path
) -> tuple[AxisParameters, Plan]:
    """Return the axis that is excited, and where its excitation will stand in the recording.

    Parameters
    ----------
    configuration : Configuration
    namespace : str, optional
        Which axis, when it describes several.
    asked : ResponseRequest
    path : path-like
        File for the samples (``.npz``).

    Raises
    ------
    ConfigurationError
        The excitation does not fit the axis: beyond its range, too weak for its sensor, of an inchworm.
    """
    axis, place = single_axis(configuration, namespace), asked.place
    if axis.inchworm_sequencer is not None:
        raise ConfigurationError(
            f"{configuration.source}: an inchworm motor walks; measure its extender alone, in a file without "
            "inchworm_sequencer"
        )
    if asked.loop == "closed" and not axis.motion_controller.law.feedback:
        raise ConfigurationError(
            f"{configuration.source}: motion_controller of type {axis.motion_controller.type} closes no loop; design "
            "one (hysteresis design), or measure --loop open"
        )
    rate, limits = axis.plant_simulator.sample_rate, axis.hysteresis_compensator.limits
    gain = hysteresis_block(axis.hysteresis_compensator.hysteresis, 1.0 / rate).gain if place == "voltage" else 1.0
    generator = axis.reference_generator
    ends = (limits.minimum, limits.maximum) if place == "voltage" else (generator.minimum, generator.maximum)
    shape = _prefilter(axis, 1.0 / rate) if (asked.loop, place) == ("closed", "command") else None
    unit = "V" if place == "voltage" else "m"
    peak = _size("--amplitude", asked.amplitude, unit, gain, ends, AMPLITUDE, 0.0)
    middle = _size("--offset", asked.offset, unit, gain, ends, 0.5, ends[0])
    samples, plan = excitation(asked.experiment, rate, shape)
    moved = middle + peak * samples
    low, high = float(moved.min()), float(moved.max())
    if not peak > 0.0 or low < ends[0] or high > ends[1]:
        what = "reference" if asked.loop == "closed" else place
        raise ConfigurationError(
            f"--amplitude {readable(peak, unit)} around {readable(middle, unit)}: the {what} would go to "
            f"{readable(low, unit)} … {readable(high, unit)}, beyond {readable(ends[0], unit)} … "
            f"{readable(ends[1], unit)}; it must be above 0 and stay within: lower it, or move --offset"
        )
    _require_loud(axis, plan, peak * abs(gain) * samples)
    rest = axis.hysteresis_compensator.safe_voltage if place == "voltage" else min(max(0.0, ends[0]), ends[1])
    whole, plan = around(samples, peak, middle, rest, rate, plan)
    plan = replace(plan, loop=asked.loop, at=place)
    path = write_samples(path, whole * gain, rate, plan=plan.text)
    run = single_axis(_configured(configuration, asked.loop, place, path, limits, gain, rest), axis.namespace)
    return run.with_duration(whole.size / rate), plan


def around(samples, peak: float, middle: float, rest: float, rate: float, plan: Plan) -> tuple[np.ndarray, Plan]:
    """Return an excitation around a place with the ways from and to rest, and its plan there.

    Parameters
    ----------
    samples : ndarray, shape (N,)
        Of peak one.
    peak, middle, rest : float
        [V] or [m]
    rate : float
        [Hz]
    plan : Plan
        As if it began at sample 0.
    """
    held = hold(middle, WAIT, rate)
    whole = there_and_back(np.concatenate([held, middle + peak * samples, held]), rest, rate)
    first = sum(max(round(seconds * rate), 1) for seconds in (REST, WAY, WAIT))
    return whole, replace(plan, first=first)


def measured_loop_parts(axis: AxisParameters) -> tuple[StateSpace, StateSpace]:
    """Return the controller of an axis, its damping in it, and the model that it has of its plant, both linear.

    Parameters
    ----------
    axis : AxisParameters
    """
    sample_time = 1.0 / axis.motion_controller.sample_rate
    return whole_loop(part(axis.motion_controller, ControllerParameters), sample_time)


def _prefilter(axis: AxisParameters, sample_time: float):
    """Return how large a reference has to be at each frequency for its part of the command to be of size one."""
    controller, _ = measured_loop_parts(axis)

    def shape(frequencies):
        size = np.abs(controller.response(np.exp(2j * np.pi * frequencies * sample_time))[:, 0, 0])
        return 1.0 / np.maximum(size, 1e-12)

    return shape


def _size(option: str, text: str | None, unit: str, gain: float, ends, part_of_range: float, begin: float) -> float:
    """Return an option in the unit of the excitation; without a unit it is a part of the range."""
    span = ends[1] - ends[0]
    if text is None:
        return begin + part_of_range * span
    try:
        value, given = quantity(text)
        if given not in ("", unit, "m"):
            raise ValueError(f"must be in {unit}, in m, or a part of the range such as {part_of_range:g}")
    except ValueError as error:
        raise ConfigurationError(f"{option} {text!r}: {error}") from None
    if given == "":
        return begin + value * span
    return value / gain if given == "m" and unit == "V" else value


def _require_loud(axis: AxisParameters, plan: Plan, moved) -> None:
    """Refuse an excitation that the sensor's noise, where the file states it, hides whatever the plant does."""
    noise = axis.plant_simulator.sensor.noise
    if axis.plant_simulator.driver or axis.plant_simulator.external_plant or not noise > 0.0:
        return
    if plan.kind == "noise":
        segment, whole = plan.samples
        lines, averages = plan.lines[1] - plan.lines[0] + 1, 2.0 * whole / segment
        noise_lines = segment / 2
    else:
        lines, noise_lines = (
            (len(plan.lines), plan.samples[0] / 2) if plan.kind == "multisine" else (1, min(plan.samples) / 2)
        )
        averages = plan.periods * plan.realisations
    ratio = 10.0 * np.log10(np.mean(moved**2) / lines / (noise**2 / noise_lines / averages))
    if ratio < LEAST_RATIO:
        raise ConfigurationError(
            f"--amplitude: {readable(float(np.max(np.abs(moved))), 'm')} are too weak an excitation for the "
            f"{readable(noise, 'm')} RMS of the sensor's noise: signal-to-noise ratio of the response {ratio:.1f} dB "
            f"at most, at least {LEAST_RATIO:g} dB are needed; raise it by a factor of "
            f"{10.0 ** ((LEAST_RATIO - ratio) / 20.0):.2g}, or --periods"
        )


def _configured(configuration, loop: str, place: str, path: str, limits, gain: float, rest: float) -> Configuration:
    """Return the configuration of the run."""
    if place == "voltage":
        waveform = {"type": "file", "cycles": 1, "file.path": path, "file.column": "reference", "offset": 0.0}
        return driven(configuration, limits, gain, waveform)
    configuration = following(configuration, path, rest).override("motion_controller", **PLAYED)
    if loop == "open":
        configuration = configuration.override("motion_controller", **OPEN)
    elif place == "command":
        # the reference was shaped for the law alone
        configuration = configuration.override("motion_controller", **UNFED)
    return configuration
