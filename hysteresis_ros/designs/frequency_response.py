# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frequency response of an axis: runs that measure it; plant, loop and margins from a run or a recording."""

from __future__ import annotations

import contextlib
import io
import pathlib
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import Margins, MeasuredLoop, loop_of, loop_transfer, margins_of
from hysteresis_ros.errors import ConfigurationError, HysteresisError, IdentificationError, RecordingError
from hysteresis_ros.files import read_arrays
from hysteresis_ros.identification.excitations import PLACES, Experiment, Plan, excitation
from hysteresis_ros.identification.frequency_response import (
    LEAST_RATIO,
    PROBABILITY,
    Analysis,
    analyse,
    plan_of_recording,
)
from hysteresis_ros.identification.response_check import LOWEST, measured_plant
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.provenance import available
from hysteresis_ros.references.recipes import (
    OPEN,
    PLAYED,
    REST,
    UNFED,
    WAY,
    driven,
    following,
    hold,
    there_and_back,
    write_samples,
)
from hysteresis_ros.units import quantity, readable

#: Default peak amplitude of the excitation, as a fraction of the range.
AMPLITUDE = 0.05
#: Hold time at the operating point before and after the excitation, in which creep decays [s].
WAIT = 1.0


@dataclass(frozen=True)
class ResponseRequest:
    """Options of a measurement."""

    experiment: Experiment
    loop: str = "open"  #: ``open`` or ``closed``.
    at: str | None = None  #: Point of excitation: ``voltage``, ``command`` or ``reference``.
    #: amplitude, offset: Peak amplitude of the excitation, by default :data:`AMPLITUDE`, and operating point, by
    #: default the middle of the range. A number without a unit is a fraction of the range.
    amplitude: str | None = None
    offset: str | None = None

    @property
    def place(self) -> str:
        """Point of excitation."""
        chosen = self.at or PLACES[self.loop][0]
        if chosen not in PLACES[self.loop]:
            raise ConfigurationError(f"--at {chosen}: with --loop {self.loop} must be {' or '.join(PLACES[self.loop])}")
        return chosen


def response_run(
    configuration: Configuration, namespace: str | None, asked: ResponseRequest, path
) -> tuple[AxisParameters, Plan]:
    """Return the axis that outputs the excitation, and the plan of the excitation for the recording."""
    axis, place = single_axis(configuration, namespace), asked.place
    generator = axis.require_generator(
        f"{configuration.source}: the response of an inchworm motor cannot be measured; measure its extender alone, in "
        "a file without inchworm_sequencer"
    )
    if asked.loop == "closed" and not axis.motion_controller.law.feedback:
        raise ConfigurationError(
            f"{configuration.source}: motion_controller of type {axis.motion_controller.type} closes no loop; design "
            "one (hysteresis design), or measure --loop open"
        )
    rate, limits = axis.plant_simulator.sample_rate, axis.hysteresis_compensator.limits
    gain = hysteresis_block(axis.hysteresis_compensator.hysteresis, 1.0 / rate).gain if place == "voltage" else 1.0
    ends = (limits.minimum, limits.maximum) if place == "voltage" else (generator.minimum, generator.maximum)
    shape = _prefilter(axis, 1.0 / rate) if (asked.loop, place) == ("closed", "command") else None
    unit = "V" if place == "voltage" else "m"
    peak = _size("--amplitude", asked.amplitude, unit, gain, ends, AMPLITUDE, 0.0)
    middle = _size("--offset", asked.offset, unit, gain, ends, 0.5, ends[0])
    samples, plan = excitation(asked.experiment, rate, shape)
    moved = middle + peak * samples
    low, high = float(np.min(moved)), float(np.max(moved))
    if not peak > 0.0 or low < ends[0] or high > ends[1]:
        what = "reference" if asked.loop == "closed" else place
        raise ConfigurationError(
            f"--amplitude {readable(peak, unit)} around {readable(middle, unit)}: the {what} would go to "
            f"{readable(low, unit)} … {readable(high, unit)}, beyond {readable(ends[0], unit)} … "
            f"{readable(ends[1], unit)}; the amplitude must be above 0 and stay within this range: "
            "lower it, or move --offset"
        )
    _require_loud(axis, plan, peak * abs(gain) * samples)
    rest = axis.hysteresis_compensator.safe_voltage if place == "voltage" else min(max(0.0, ends[0]), ends[1])
    whole, plan = around(samples, peak, middle, rest, rate, plan)
    plan = replace(plan, loop=asked.loop, at=place)
    path = write_samples(path, whole * gain, rate, plan=plan.text)
    run = single_axis(_configured(configuration, asked.loop, place, path, limits, gain, rest), axis.namespace)
    return run.with_duration(whole.size / rate), plan


def around(samples, peak: float, middle: float, rest: float, rate: float, plan: Plan) -> tuple[np.ndarray, Plan]:
    """Return an excitation around an operating point, with a ramp at the beginning and at the end, and its plan.

    Units: ``rate`` [Hz]; ``peak``, ``middle`` and ``rest`` are in volts for an excitation of the voltage, else in
    metres.
    """
    held = hold(middle, WAIT, rate)
    whole = there_and_back(np.concatenate([held, middle + peak * samples, held]), rest, rate)
    first = sum(max(round(seconds * rate), 1) for seconds in (REST, WAY, WAIT))
    return whole, replace(plan, first=first)


def measured_loop_parts(axis: AxisParameters) -> tuple[StateSpace, StateSpace]:
    """Return the linear controller of an axis, including damping, and the controller's linear model of the plant."""
    sample_time = 1.0 / axis.motion_controller.sample_rate
    return whole_loop(part(axis.motion_controller, ControllerParameters), sample_time)


def _prefilter(axis: AxisParameters, sample_time: float):
    """Return a function that gives, for each frequency, the reference amplitude for a command amplitude of 1."""
    controller, _ = measured_loop_parts(axis)

    def shape(frequencies):
        size = np.abs(controller.response(np.exp(2j * np.pi * frequencies * sample_time))[:, 0, 0])
        return 1.0 / np.maximum(size, 1e-12)

    return shape


def _size(option: str, text: str | None, unit: str, gain: float, ends, part_of_range: float, begin: float) -> float:
    """Return an option in the unit of the excitation; a number without a unit is a fraction of the range."""
    span = ends[1] - ends[0]
    if text is None:
        return begin + part_of_range * span
    try:
        value, given = quantity(text)
        if given not in ("", unit, "m"):
            raise ValueError(
                f"must be in {unit} or m, or a fraction of the range without a unit, such as {part_of_range:g}"
            )
    except ValueError as error:
        raise ConfigurationError(f"{option} {text!r}: {error}") from None
    if given == "":
        return begin + value * span
    return value / gain if given == "m" and unit == "V" else value


def _require_loud(axis: AxisParameters, plan: Plan, moved) -> None:
    """Refuse an excitation whose response is too small for the sensor noise in the file."""
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
            f"--amplitude: a motion of {readable(float(np.max(np.abs(moved))), 'm')} is too small for "
            f"the sensor's noise of {readable(noise, 'm')} RMS: the signal-to-noise ratio of the "
            f"response is at most {ratio:.1f} dB, and at least {LEAST_RATIO:g} dB are needed; raise "
            "the amplitude by a factor of "
            f"{10.0 ** ((LEAST_RATIO - ratio) / 20.0):.2g}, or --periods"
        )


def _configured(configuration, loop: str, place: str, path: str, limits, gain: float, rest: float) -> Configuration:
    """Return the configuration of the measurement."""
    if place == "voltage":
        waveform = {"type": "file", "cycles": 1, "file.path": path, "file.column": "reference", "offset": 0.0}
        return driven(configuration, limits, gain, waveform)
    configuration = following(configuration, path, rest).override("motion_controller", **PLAYED)
    if loop == "open":
        configuration = configuration.override("motion_controller", **OPEN)
    elif place == "command":
        # the reference amplitudes were computed for the law without feedforward
        configuration = configuration.override("motion_controller", **UNFED)
    return configuration


#: Printed levels, relative to the response [dB].
LEVELS = {"noise": "noise", "odd": "odd distortion", "even": "even distortion"}


@dataclass(frozen=True, eq=False)
class AxisResponse:
    """The measured response of an axis."""

    plan: Plan
    #: Response from voltage or command to the measured displacement. For a closed loop with an unknown controller, the
    #: input is reference − measured.
    plant: Analysis
    loop: MeasuredLoop | None = None  #: Loop transfer function, for a measurement in closed loop.
    model: np.ndarray | None = None  #: shape (F,); Response of the controller's model of the plant at the lines.
    model_loop: np.ndarray | None = None  #: shape (F,); Loop of the controller with this model, at the lines.
    margins: Margins | None = None  #: Margins of the controller on its own model.
    limited: float = 0.0  #: Share of the excitation's samples in which range or slew rate limited the voltage [%].

    @property
    def limitation(self) -> str:
        """Why the response is not that of the linear loop; empty if no voltage was limited."""
        if not self.limited:
            return ""
        return (
            f"the range or the slew rate limited the voltage in {self.limited:.3g} % of the samples, so this is not "
            "the response of the linear loop: give a smaller amplitude or a lower upper frequency"
        )

    @property
    def figures(self) -> dict:
        """The available figures; their names contain the units."""
        response = self.plant.response
        found: dict = {
            "excitation": self.plan.kind,
            "loop": self.plan.loop,
            "at": self.plan.at,
            "lines": int(response.frequency.size),
            "lowest_hz": float(response.frequency[0]),
            "highest_hz": float(response.frequency[-1]),
            "signal_to_noise_db": self.plant.ratio,
            "limited_percent": self.limited,
        }
        for name, level in self._levels().items():
            found[f"{name}_db"] = level
        if self.loop is not None:
            intervals = {
                "gain_margin_db": self.loop.gain_margin,
                "phase_margin_deg": self.loop.phase_margin,
                "delay_margin_samples": self.loop.delay_margin,
                "sensitivity_peak": self.loop.sensitivity_peak,
            }
            for name, one in intervals.items():
                found |= {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}
        if self.margins is not None:
            found |= {
                "model_gain_margin_db": self.margins.gain_margin,
                "model_phase_margin_deg": self.margins.phase_margin,
                "model_delay_margin_samples": self.margins.delay_margin_samples,
                "model_sensitivity_peak": self.margins.sensitivity_peak,
            }
        return {name: value for name, value in found.items() if not isinstance(value, float) or np.isfinite(value)}

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Further columns at the frequency lines, besides the response; their names contain the units."""
        found = {}
        if self.loop is not None:
            responses = {"loop": self.loop.loop, "sensitivity": self.loop.sensitivity}
            responses["complementary"] = self.loop.complementary
            for name, values in responses.items():
                found[f"{name}_real [1]"], found[f"{name}_imag [1]"] = values.real, values.imag
            found["loop_radius [1]"] = self.loop.radius
            found["sensitivity_radius [1]"] = self.loop.sensitivity_radius
        return found

    def lines(self) -> list[str]:
        """Return the printed table."""
        response, unit = self.plant.response, self.plant.response.input_unit
        kind = {"open": f"{self.plan.at} → displacement", "closed": f"closed loop, excited at the {self.plan.at}"}
        rows = [
            ("response", f"{kind[self.plan.loop]}, {self.plan.kind}"),
            (
                "lines",
                f"{response.frequency.size}, {response.frequency[0]:.4g} … {response.frequency[-1]:.4g} Hz",
            ),
            ("signal-to-noise ratio", f"{self.plant.ratio:.1f} dB (median of the lines)"),
        ]
        low = float(np.median(np.abs(response.single[:LOWEST])))
        if unit == "V":
            rows.append(("gain of the lowest lines", f"{readable(low, 'm')}/V"))
        if self._levels():
            levels = ", ".join(
                f"{LEVELS[name]} {f'{level:.1f} dB' if np.isfinite(level) else 'not above the noise'}"
                for name, level in self._levels().items()
            )
            rows.append(("of the response", levels))
        if self.loop is not None:
            rows += self.loop.rows(self.margins)
        width = max(len(name) for name, _ in rows)
        notes = [*filter(None, [self.limitation]), *response.warnings]
        return [f"{name:<{width}}  {text}" for name, text in rows] + [f"note: {text}" for text in notes]

    def _levels(self) -> dict[str, float]:
        """Return the median over the lines of noise and distortion, relative to the response [dB]."""
        levels, size = self.plant.distortion, np.abs(self.plant.response.single)
        if levels is None:
            return {}
        with np.errstate(divide="ignore"):
            return {
                name: float(np.median(20.0 * np.log10(getattr(levels, name) / size)))
                for name in LEVELS
                if np.isfinite(getattr(levels, name)).all()
            }


def axis_response(recording: Recording, plan: Plan, axis: AxisParameters | None = None) -> AxisResponse:
    """Return the response of an axis from a recording of an excitation; ``axis`` gives controller and model."""
    sample_time, y = recording.sample_time, recording["measured"]
    if plan.loop == "open":
        u = recording[plan.at]
        plant = analyse(plan, sample_time, u, y, input_unit="V" if plan.at == "voltage" else "m")
    else:
        reference = recording["reference"]
        if recording.has("seen"):
            # the controller's input, which may be delayed relative to the measurement, closes the loop
            y = np.where(np.isfinite(recording["seen"]), recording["seen"], y)
        u = recording["command"] if axis is not None else reference - y
        plant = analyse(plan, sample_time, u, y, reference, "m")
    _require_finite(plant)
    plant.require_excited()
    response = plant.response
    loop = None
    if plan.loop == "closed":
        radius = response.radius(PROBABILITY)[:, 0, 0]
        if axis is None:
            loop = MeasuredLoop(response.frequency, response.single, radius, sample_time)
        else:
            controller, model = measured_loop_parts(axis)
            loop = loop_of(controller, response.frequency, response.single, radius, sample_time, model)
    limited = 0.0
    if recording.has("saturated"):
        limited = 100.0 * float(np.mean(recording["saturated"][plan.first : plan.first + plan.length] > 0.0))
    found = AxisResponse(plan, plant, loop, limited=limited)
    return found if axis is None else _with_model(found, axis)


def _require_finite(plant: Analysis) -> None:
    if not np.all(np.isfinite(plant.response.single)):
        raise IdentificationError("the recording has NaN samples within the excitation; record it again")


def _with_model(found: AxisResponse, axis: AxisParameters) -> AxisResponse:
    """Return the response with that of the axis' model and, in closed loop, the model's loop and margins."""
    controller, plant = measured_loop_parts(axis)
    response, sample_time = found.plant.response, 1.0 / axis.motion_controller.sample_rate
    z = np.exp(2j * np.pi * response.frequency * sample_time)
    model = plant.response(z)[:, 0, 0]
    # here the model is scaled to the measured gain; elsewhere the measured response is scaled to the gain of the model
    shown = measured_plant(found.plant, model)
    model = model * abs(response.single[0] / shown.response[0])
    if found.loop is None:
        return replace(found, model=model)
    margins = margins_of(controller, plant, sample_time)
    return replace(found, model=model, model_loop=loop_transfer(controller, plant, z), margins=margins)


def plan_file(recording) -> pathlib.Path:
    """Return the path of the file, next to the recording, that contains the plan of the excitation."""
    recording = pathlib.Path(recording)
    return recording.with_name(f"{recording.stem}_excitation.npz")


def read_plan(path) -> Plan:
    """Return the plan of an excitation."""
    try:
        return Plan.from_text(str(read_arrays(path)["plan"]))
    except (OSError, ValueError, KeyError):
        raise RecordingError(
            f"{path}: contains no excitation plan; give the file …_excitation.npz that hysteresis frf wrote"
        ) from None


def contained_plan(recording: Recording) -> Plan | None:
    """Return the plan of the excitation in the waveform file of a recorded run; None without a plan."""
    for content in available(recording.metadata.get("files", {})):
        with contextlib.suppress(OSError, ValueError, KeyError):
            return Plan.from_text(str(read_arrays(io.BytesIO(content), lambda name: name == "plan")["plan"]))
    return None


def recorded_response(
    recording: Recording,
    plan: Plan | None,
    loop: str | None = None,
    at: str | None = None,
    period: float | None = None,
    kind: str | None = None,
) -> AxisResponse:
    """Return the response of the axis in a recording; without ``plan``, the recorded or a detected plan is used."""
    axis = _axis(recording)
    if plan is None and period is None and kind is None:
        plan = contained_plan(recording)
    if plan is None:
        feedback = axis is not None and axis.motion_controller.law.feedback
        loop = loop or ("closed" if feedback else "open")
        at = at or PLACES[loop][0]
        if at not in PLACES[loop]:
            raise ConfigurationError(f"--at {at}: with --loop {loop} must be {' or '.join(PLACES[loop])}")
        drive = recording["reference" if loop == "closed" else at]
        plan = replace(plan_of_recording(drive, recording.sample_time, period, kind), loop=loop, at=at)
    elif (loop or plan.loop, at or plan.at) != (plan.loop, plan.at):
        raise ConfigurationError(
            f"--loop, --at: the recording was made with --loop {plan.loop} --at {plan.at}; omit them"
        )
    known = axis if axis is not None and (plan.loop == "open" or axis.motion_controller.law.feedback) else None
    return axis_response(recording, plan, known)


def _axis(recording: Recording) -> AxisParameters | None:
    """Return the axis of a recording; None if the recording has no valid configuration."""
    if not recording.configuration:
        return None
    try:
        configuration = parse_configuration(recording.configuration, "configuration of the recording")
        axis = AxisParameters.from_configuration(configuration, str(recording.metadata.get("namespace") or ""))
    except HysteresisError:
        return None
    return axis if axis.inchworm_sequencer is None else None
