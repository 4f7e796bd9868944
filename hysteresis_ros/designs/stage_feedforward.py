# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamic decoupling: feedforward of a stage by stable inversion, with preview, of the model of all axes.

G is the response from the outputs of the control laws to the displacements of all axes; it includes actuators, dampings
and decoupling. F contains the inverses of the models of the single axes. In addition to F, the stage needs the
feedforward

    X = G⁻¹ - F.

On the unit circle, G⁻¹ is bounded even if G has zeros outside the unit circle. The impulse response of G⁻¹ then extends
into the future; preview makes this non-causal inverse possible. Weighted least squares approximate X by an impulse
response of N samples in both directions. The feedforward shall decouple the axes up to a frequency, the *band*. Up to
the band the error of X is weighted by (band / f)², because references have smaller amplitudes at high frequencies.
Beyond the band X is kept small, because the model is not known there. The samples of the impulse response add up to 0
exactly, because at rest the matrix ``decoupling`` alone decouples the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import STAGE, Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.feedforward import (
    LONGEST_PREVIEW,
    FeedforwardParameters,
    designed_preview,
    inverse_filter,
)
from hysteresis_ros.designs.controller import feedforward_text
from hysteresis_ros.designs.coupled import safe_stage_text
from hysteresis_ros.designs.setpoint_step import AFTER, MOST, SETTLING, at_setpoint, overshoot_of, unlimited
from hysteresis_ros.designs.stage_stability import gain_at_rest, right_decoupling
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageFeedforwardParameters, StageParameters
from hysteresis_ros.loop.stage_response import damped_response
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.waveforms import WaveformParameters
from hysteresis_ros.units import readable

#: Default band, as a fraction of the sample rate; the model of a stage is rarely known near half the sample rate.
BAND = 0.1
#: The default band is multiplied by this factor while no preview is long enough for it.
NARROWER = 0.8
#: Maximum number of bands that are tried.
STEPS = 10
#: Largest allowed coupling up to the band, as a fraction of the reference of the other axis.
REMAINING = 1e-3
#: Step by which a design increases the preview [samples].
STEP = 2
#: Largest static coupling that is left to the feedback.
AT_REST = 0.01
#: Frequencies of the design, as fractions of the sample rate.
GRID = np.linspace(0.0005, 0.5, 1000)
#: Frequency below which the weight is constant, as a fraction of the sample rate; the band must be above it.
FLAT = 0.002
#: Weight of X beyond twice the band, relative to the weight at the band.
BEYOND = 0.01
#: Weight of X between the band and twice the band, relative to the weight at the band.
BETWEEN = 1e-3
#: Control laws with which the axes follow their references; with other laws, each axis follows its own model.
LAWS = ("pid", "open_loop")


@dataclass(frozen=True, eq=False)
class StageFeedforward:
    """A designed feedforward of a stage."""

    parameters: StageParameters  #: The stage with this feedforward.
    band: float  #: Frequency up to which this feedforward decouples [Hz].
    before: float  #: Largest coupling up to the band with the inverses of the single axes only, as a fraction.
    after: float  #: The same coupling with the feedforward of the stage.
    own: float  #: Largest error up to the band with which an axis follows its own reference, as a fraction.

    @property
    def preview(self) -> int:
        """Preview of the references [samples]."""
        return self.parameters.axes[0].motion_controller.feedforward.preview


def design_stage_feedforward(
    parameters: StageParameters, preview: int | None = None, band: float | None = None
) -> StageFeedforward:
    """Design the feedforward of a stage up to a band [Hz]; the controllers of the stage do not change.

    By default the preview is the shortest one with which the coupling of the model is at most 0.1 % up to the band,
    found in steps of 2 samples; the band is a tenth of the sample rate, or less if no preview is long enough. Without
    success, a ConfigurationError states the reason.
    """
    rate = parameters.sample_rate
    limits = [BAND * rate * NARROWER**step for step in range(STEPS)] if band is None else [band]
    if not FLAT * rate < limits[0] <= 0.25 * rate:
        raise ConfigurationError(f"--bandwidth {limits[0]:g} Hz: must be {FLAT * rate:g} … {0.25 * rate:g} Hz")
    _require_laws(parameters)
    models = [_model(axis, rate) for axis in parameters.axes]
    shortest = max(designed_preview(model) for model in models) if preview is None else preview
    _require_decoupled(parameters)
    plant = damped_response(parameters, 2.0 * np.pi * GRID)
    lengths = range(shortest, LONGEST_PREVIEW + 1, STEP) if preview is None else [shortest]
    for limit in limits:
        for length in lengths:
            found = _designed(parameters, models, plant, length, limit)
            if found.after <= REMAINING:
                return found
    if preview is None or band is None:
        raise ConfigurationError(
            f"--feedforward: with {length} samples of preview {100.0 * found.after:.3g} % of coupling remain up to "
            f"{limit:g} Hz, at most {100.0 * REMAINING:g} % is allowed: lower --bandwidth, or give it with --preview"
        )
    return found


def _model(axis, rate: float):
    """Return the model of an axis, including damping."""
    return part(axis.motion_controller, ControllerParameters).before_damping(1.0 / rate).model.dynamics


def _require_laws(parameters: StageParameters) -> None:
    for axis in parameters.axes:
        given = axis.motion_controller.type
        if given not in LAWS:
            raise ConfigurationError(
                f"{axis.namespace}/motion_controller: type = {given}: the feedforward of a stage needs "
                f"{' or '.join(LAWS)}, because {given} follows the model of its axis alone; add --controller pid"
            )
        if axis.motion_controller.learning.in_use:
            raise ConfigurationError(
                f"{axis.namespace}/motion_controller: learning.type = {axis.motion_controller.learning.type}: its "
                "corrections were designed without feedforward; give none"
            )


def _require_decoupled(parameters: StageParameters) -> None:
    """Refuse a stage whose axes are coupled at rest."""
    gain = gain_at_rest(parameters)
    share = np.abs(gain - np.diag(np.diag(gain))) / np.abs(np.diag(gain))
    if np.max(share) > AT_REST:
        raise ConfigurationError(
            f"{parameters.namespace}/{STAGE}: decoupling: {100.0 * np.max(share):.3g} % of coupling remains at rest, "
            f"at most {100.0 * AT_REST:g} % is allowed: give {right_decoupling(parameters)}"
        )


def _designed(parameters: StageParameters, models, plant: np.ndarray, preview: int, band: float) -> StageFeedforward:
    """Return the feedforward with this preview; ``plant`` is the plant's response at the frequencies :data:`GRID`."""
    count, z = len(parameters.names), np.exp(2j * np.pi * GRID)
    alone = np.zeros((len(z), count, count), dtype=complex)
    for i, model in enumerate(models):
        alone[:, i, i] = inverse_filter(model, preview).response(z)
    weights, across = np.zeros((0, 0, 0)), np.zeros_like(alone)
    if count > 1:
        weights = finite_response(np.linalg.inv(plant) - alone, preview, band / parameters.sample_rate)
        across = weights @ z[:, np.newaxis, np.newaxis, np.newaxis] ** np.arange(-preview, preview)[:, np.newaxis]
        across = across[..., 0]
    within = band / parameters.sample_rate >= GRID
    outside = ~np.eye(count, dtype=bool)

    def coupling(given, which) -> float:
        return float(np.max(np.abs(plant @ given - np.eye(count))[within][:, which], initial=0.0))

    axes = tuple(
        replace(
            axis,
            motion_controller=replace(
                axis.motion_controller, feedforward=FeedforwardParameters("inverse_dynamics", preview)
            ),
        )
        for axis in parameters.axes
    )
    stage = replace(
        parameters.stage,
        feedforward=StageFeedforwardParameters(preview if weights.size else 0, tuple(map(float, weights.ravel()))),
    )
    return StageFeedforward(
        replace(parameters, stage=stage, axes=axes),
        band,
        coupling(alone, outside),
        coupling(alone + across, outside),
        coupling(alone + across, ~outside),
    )


def finite_response(wanted: np.ndarray, preview: int, band: float) -> np.ndarray:
    """Return weights of r(k-N) … r(k+N-1), with sum 0, that approximate the response ``wanted``, shape (n, n, 2 N).

    ``wanted``, shape (F, n, n), is given at the frequencies :data:`GRID`; N is ``preview``; ``band`` is a fraction of
    the sample rate.
    """
    shifts = np.arange(-preview, preview)
    # combinations of such differences have the sum 0
    differences = np.eye(len(shifts))[:, 1:] - np.eye(len(shifts))[:, :-1]
    basis = np.exp(2j * np.pi * np.outer(GRID, shifts)) @ differences
    within = band >= GRID
    beyond = np.where(2.0 * band < GRID, BEYOND, BETWEEN)
    size = np.where(within, (band / np.maximum(GRID, FLAT)) ** 2, beyond)
    left, right = basis * size[:, np.newaxis], wanted.reshape(len(GRID), -1) * (size * within)[:, np.newaxis]
    matrix, columns = (np.vstack([side.real, side.imag]) for side in (left, right))
    found = differences @ np.linalg.lstsq(matrix, columns, rcond=1e-10)[0]
    return np.ascontiguousarray(found.T.reshape(*wanted.shape[1:], len(shifts)))


#: A setpoint is reached when the axis has covered this fraction of the move.
REACHED = 0.98


@dataclass(frozen=True)
class VoltageSteps:
    """Largest change of any voltage of a stage in one sample, without slew rates."""

    what: str  #: Motion that needs this change.
    asked: float  #: Largest change in one sample [V].
    allowed: float  #: Change in one sample that the slew rate allows [V]; inf without a slew rate.
    span: float  #: Range of the voltage [V].
    overshoot: float | None = None  #: Overshoot of a setpoint, as a fraction; None: no setpoint, or not reached.


def voltage_steps(parameters: StageParameters) -> list[VoltageSteps]:
    """Return the largest voltage changes, for a step of each axis to its farthest setpoint and for the waveforms."""
    rate, found = parameters.sample_rate, []
    settled = round(SETTLING * rate)  # samples of the first motion, from 0 V to the initial setpoint
    free = replace(parameters, axes=tuple(at_setpoint(unlimited(axis)) for axis in parameters.axes))
    still = free.scanning([])
    for name, axis in zip(parameters.names, still.axes, strict=True):
        source = replace(axis.generator, waveform=WaveformParameters())
        approach = ReferenceGenerator(part(source, ReferenceParameters), 1.0 / rate).approach
        start, over, rows = source.initial_setpoint, None, []
        for target in sorted((source.minimum, source.maximum), key=lambda end: -abs(end - start)):
            moving = round(approach.duration(target - start) * rate)
            setpoints = np.full(min(settled + moving + AFTER, MOST), target)
            setpoints[:settled] = start
            run = simulate_stage(still, setpoints={name: setpoints})
            way = f"a setpoint {readable(abs(target - start), 'm')} away in {name}"
            rows.append(_largest(parameters, run, settled, way))
            displacement = run[f"{name}/displacement"][settled - 1 :]
            # because of hysteresis the voltage may reach its limit before the axis reaches the end of its range; then
            # the other end is tried
            if abs(displacement[-1] - displacement[0]) > REACHED * abs(target - start):
                over = overshoot_of(displacement, target - start)
                break
        found.append(replace(max(rows, key=lambda row: row.asked), overshoot=over))
    if any(parameters.waveform(name) != "hold" for name in parameters.names):
        samples = min(max(Stage(free).default_samples(), 2 * settled), MOST)
        run = simulate_stage(free, duration=samples / rate)
        found.append(_largest(parameters, run, settled, "the configured waveforms"))
    return found


def _largest(parameters: StageParameters, run, first: int, what: str) -> VoltageSteps:
    """Return the voltage change, from sample ``first`` on, that is the largest part of its range, over all axes."""
    rows = []
    for name, axis in zip(parameters.names, parameters.axes, strict=True):
        limits = axis.hysteresis_compensator.limits
        slew = [node.limits.slew_rate for node in (axis.plant_simulator, axis.hysteresis_compensator)]
        allowed = min((one / parameters.sample_rate for one in slew if one > 0.0), default=np.inf)
        asked = float(np.max(np.abs(np.diff(run[f"{name}/voltage"][first:]))))
        rows.append(VoltageSteps(what, asked, allowed, limits.maximum - limits.minimum))
    return max(rows, key=lambda row: row.asked / row.span)


def require_gentle_steps(steps: list[VoltageSteps]) -> None:
    """Refuse a feedforward that needs the whole range in one sample, or for a setpoint more than the slew rate."""
    for step in steps:
        if step.asked >= step.span or (step.asked > step.allowed and step.what.startswith("a setpoint")):
            allowed = f"{step.allowed:.3g} V" if step.asked < step.span else f"less than the range of {step.span:.3g} V"
            raise ConfigurationError(
                f"--feedforward: {step.what} needs a change of {step.asked:.3g} V in a sample, and limits allow "
                f"{allowed}: lower the limits of approach or the frequency of the waveform in reference_generator, "
                "or give a lower --bandwidth"
            )


def stage_feedforward_lines(found: StageFeedforward, steps: list[VoltageSteps]) -> list[str]:
    """Return the printed table of a designed feedforward."""
    milliseconds = 1e3 * found.preview / found.parameters.sample_rate
    rows = [("preview", f"{found.preview} samples, {milliseconds:.3g} ms")]
    if found.before > 0.0:
        rows += [
            ("decoupled up to", f"{found.band:.4g} Hz"),
            ("coupling, model", f"{100.0 * found.after:.3g} %; {100.0 * found.before:.3g} % with the inverses alone"),
        ]
    rows.append(("error of an axis, model", f"{100.0 * found.own:.3g} % up to {found.band:.4g} Hz"))
    rows += voltage_step_rows(steps)
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {text}" for name, text in rows]


def voltage_step_rows(steps: list[VoltageSteps]) -> list[tuple[str, str]]:
    """Return the printed rows of the largest voltage steps."""
    rows = []
    for step in steps:
        share = "" if np.isinf(step.allowed) else f", {100.0 * step.asked / step.allowed:.3g} % of the slew limit"
        over = ", not reached: the voltage is at its limit" if step.what.startswith("a setpoint") else ""
        if step.overshoot is not None:
            over = f", overshoot {100.0 * step.overshoot:.3g} %"
        rows.append(("largest voltage step", f"{step.asked:.3g} V in a sample for {step.what}{share}{over}"))
    return rows


def without_stage_feedforward(configuration: Configuration) -> Configuration:
    """Return the configuration of a stage without the feedforward between axes."""
    if not StageParameters.from_configuration(configuration).stage.feedforward.weights:
        return configuration
    text = feedforward_text(configuration, {}, str(configuration.stage), STAGE, "")
    return parse_configuration(text, configuration.source)


def stage_feedforward_file(configuration: Configuration, found: StageFeedforward, words: str) -> str:
    """Return the text of the parameter file with a designed feedforward, after a check that the stage can be built."""
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    header = (
        f"Feedforward designed by `hysteresis design {source} {words}`\n"
        f"on the model of the stage: preview {found.preview} samples, decoupled up to {found.band:.4g} Hz."
    )
    fed, space = found.parameters.stage.feedforward, str(configuration.stage)
    values = {"preview": fed.preview, "weights": fed.weights} if fed.weights else {}
    text = feedforward_text(configuration, values, space, STAGE, header)
    for name, axis in zip(found.parameters.names, found.parameters.axes, strict=True):
        own = axis.motion_controller.feedforward.to_mapping()
        given = parse_configuration(text, configuration.source)
        text = feedforward_text(given, own, f"{space}/{name}", "motion_controller", header)
    return safe_stage_text(text)
