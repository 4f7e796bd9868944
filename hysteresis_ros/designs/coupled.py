# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loops of a stage: margins, and design of the controllers and of the learned corrections of all axes.

**Dynamic decoupling of a scan.** Let R be the references of all axes at a harmonic of the path, and let T be the
coupled closed loop from references to displacements, with unchanged controllers. The corrected references are R + Q
(T⁻¹ - I) R. With Q = I, the displacements of all axes of the model equal R at the samples. The path of a whole
period is known in advance, so T may have zeros outside the unit circle, and its inverse needs no truncation. Q is the
robustness filter of the axis; above the bandwidth of Q nothing is corrected. Learning begins with these corrections,
and continues with the errors that the model does not predict.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.coupling import disk_margins, relative_gain_array, singular_values
from hysteresis_ros.control.damping.inner_loop import NONE
from hysteresis_ros.control.learning import LONGEST, Learned, shortest_period
from hysteresis_ros.control.uncertainty import ResponseUncertainty
from hysteresis_ros.designs.controller import (
    AxisDesign,
    DesignRequest,
    design_axis,
    design_text,
    learning_text,
    response_uncertainty,
    scan_text,
)
from hysteresis_ros.designs.damping import RESONANCE
from hysteresis_ros.designs.learning import LearningDesign, LearningRequest, design_learning
from hysteresis_ros.designs.stage_stability import unmet_together
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.loop.stage_response import (
    SMALLEST,
    path_bandwidths,
    scanned_paths,
    stage_loop,
    stage_plant,
    stage_response,
)
from hysteresis_ros.models.linear_algebra import product

#: Response uncertainty of each axis, by the name of the axis; without an entry, the model of the axis counts as exact.
Uncertainties = Mapping[str, ResponseUncertainty]

#: Tried fractions of the bandwidth that an axis reaches alone, if the loops of the other axes do not permit this
#: bandwidth.
SHARES = (1.0, 0.6, 0.35, 0.2, 0.1, 0.05)
#: Number of these fractions, from the first one on, that are tried with a damping, which is meant for a fast law.
AROUND = 3
#: Largest M_s of each of the weaker dampings that are tried.
PEAKS = (1.7, 1.5, 1.3)
#: Bandwidth of the slow axis of a raster, as a multiple of the larger of the line rate and the bandwidth of its path.
CALM = 10.0
#: Table entry of a loop that is unstable.
UNSTABLE = "none: the loop is unstable"
#: Frequencies of the printed coupling, as fractions of the sample rate.
PRINTED = (1e-3, 1e-2)
#: Frequencies of the singular values, as fractions of the sample rate.
GRID = np.geomspace(1e-4, 0.5, 2000)


def stage_lines(parameters: StageParameters, more: Iterable[tuple[str, str]] = ()) -> list[str]:
    """Return the printed table of a stage: interaction of its axes, margins of its loops, and the rows ``more``."""
    rows = [*stage_rows(parameters), *more]
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {text}" for name, text in rows]


def stage_rows(parameters: StageParameters) -> list[tuple[str, str]]:
    """Return labels and texts of the table of a stage."""
    names, rate = parameters.names, parameters.sample_rate
    stage = parameters.stage
    linear = stage.structure.linear if stage.type == HAMMERSTEIN else stage.structure.small
    gain = product(stage.matrix("sensor_matrix"), linear.dc_gain.reshape(len(names), -1))
    sizes = singular_values(stage_plant(parameters).response(np.exp(2j * np.pi * GRID)))
    worst = int(np.argmax(sizes[:, 0] / sizes[:, -1]))
    margins = disk_margins(stage_loop(parameters), 1.0 / rate)
    rows = [
        (f"relative gains of {name}", ", ".join(f"{value:.4g}" for value in row))
        for name, row in zip(names, relative_gain_array(gain), strict=True)
    ]
    rows += [
        ("singular values at 0 Hz", ", ".join(f"{value:.4g}" for value in sizes[0])),
        ("singular values, worst", f"{sizes[worst, 0]:.4g} … {sizes[worst, -1]:.4g} at {GRID[worst] * rate:.4g} Hz"),
    ]
    coupled = np.abs(stage_response(parameters, 2.0 * np.pi * np.array(PRINTED)))
    for turns, response in zip(PRINTED, coupled, strict=True):
        others = response - np.diag(np.diag(response))
        row, column = np.unravel_index(int(np.argmax(others)), others.shape)
        text = f"{100.0 * others[row, column]:.3g} % of {names[column]} in {names[row]}" if row != column else "none"
        rows.append((f"coupling at {turns * rate:.4g} Hz", text if margins.together.alpha > 0.0 else UNSTABLE))
    for label, margin in [*zip(names, margins.loops, strict=True), ("all jointly", margins.together)]:
        text = f"{margin.gain_margin:.1f} dB, {margin.phase_margin:.0f} deg, at {margin.frequency:.4g} Hz"
        if not margin.alpha > 0.0:
            text = UNSTABLE
        elif np.isinf(margin.gain_margin):
            text = "infinite"
        rows.append((f"disk margin of {label}", text))
    return rows


def with_written_scan(
    configuration: Configuration, kind: str, values: Sequence[str], periods: int = 0
) -> Configuration:
    """Return the configuration of a stage with another scan in the text of the file.

    ``values`` are the parameters of the scan, each ``NAME=VALUE``. If the number of periods in the file is below
    ``periods``, it is set to ``periods``; 0 (endless) is kept.
    """
    chosen: dict = {"kind": kind, "values": tuple(values)}
    own = StageParameters.from_configuration(configuration).stage.scan.periods
    if 0 < own < periods:
        chosen["periods"] = periods
    text = scan_text(configuration, chosen, str(configuration.stage))
    return parse_configuration(text, configuration.source)


def response_uncertainties(configuration: Configuration, parameters: StageParameters) -> Uncertainties:
    """Return, for each axis, the response uncertainty that an identification has written into a parameter file."""
    found = {name: response_uncertainty(configuration, name) for name in parameters.names}
    return {name: known for name, known in found.items() if known is not None}


def design_controllers(
    parameters: StageParameters,
    request: DesignRequest,
    known: Uncertainties,
    chosen: str | None = None,
) -> dict[str, AxisDesign]:
    """Design the controllers of all axes, or of the axis ``chosen``, each for the model of its axis.

    The controllers must meet the requirements also with the loops of all axes closed and, with a damping, with
    deviating resonances. If they do not, the law is made slower, or a requested damping is weakened or omitted; each
    design states the reason. The slow axis of a raster gets a slow law, unless a bandwidth is requested.
    """
    names = parameters.names if chosen is None else (parameters.names[parameters.place(chosen)],)
    designs = {name: design_axis(parameters.axes[parameters.place(name)], request, known.get(name)) for name in names}
    return _adjusted_together(parameters, request, known, _calmed(parameters, request, known, designs))


def calm_bandwidth(parameters: StageParameters) -> tuple[str, float] | None:
    """Return the slow axis of a raster scan and the bandwidth that suffices for it [Hz]; None without a raster.

    The slow axis hardly moves, so a faster loop would only add motion caused by sensor noise.
    """
    scan = parameters.scan
    if scan is None or not scan.slow_axis:
        return None
    bands = path_bandwidths(parameters)
    slow = min(parameters.scanning_axes, key=lambda name: bands[parameters.place(name)])
    following = scan.passes.begin[scan.passes.line == 1]
    lines = scan.rate / float(following[0]) if following.size else scan.rate
    return slow, float(f"{CALM * max(lines, bands[parameters.place(slow)]):.3g}")


def _calmed(
    parameters: StageParameters, request: DesignRequest, known: Uncertainties, designs: dict[str, AxisDesign]
) -> dict[str, AxisDesign]:
    """Return the designs, with a slower law for the slow axis of a raster if this law meets the requirements."""
    calm = calm_bandwidth(parameters)
    if calm is None or not _free(request):
        return designs
    name, band = calm
    if name not in designs or not designs[name].margins.bandwidth > band:
        return designs
    with contextlib.suppress(HysteresisError):
        slower = _designed(parameters, request, known, {name: band})[name]
        if not slower.misses():
            possible = f"although {designs[name].margins.bandwidth:.4g} Hz are possible"
            said = f"the slow axis of the raster needs no more than {band:g} Hz, {possible}: with this bandwidth "
            said += "sensor noise moves it less; --bandwidth requests another bandwidth"
            return {**designs, name: replace(slower, calmed=said)}
    return designs


def _free(request: DesignRequest) -> bool:
    """Return whether a request leaves the bandwidth to the design."""
    return request.bandwidth is None and request.criterion is None and request.robust is None


def _adjusted_together(
    parameters: StageParameters, request: DesignRequest, known: Uncertainties, first: dict[str, AxisDesign]
) -> dict[str, AxisDesign]:
    """Return designs that meet the requirements with all loops closed; otherwise the first designs with a note."""
    kinds = {design.parameters.damping.type for design in first.values()} - {NONE}
    resonance = RESONANCE if request.robust is None else request.robust.resonance
    resonance = resonance if kinds else 0.0  # a law without damping may cancel its resonance
    unmet = unmet_together(with_designs(parameters, first), resonance)
    if not unmet:
        return first
    kind = ", ".join(sorted(kinds))
    slower = f"the controller around the damping {kind} is slower" if kinds else "the controller is slower"
    ways = [(request, resonance, slower)]
    if request.damping not in (None, NONE):
        # weaker dampings first; no damping last, because the law then cancels resonances whose frequency is uncertain
        ways += [
            (replace(request, damping_peak=peak), resonance, f"the damping {kind} is weaker, its M_s at most {peak:g}")
            for peak in PEAKS
        ]
        ways.append((replace(request, damping=NONE), 0.0, f"no damping: even a weak {kind} violates the requirements"))
    free = _free(request)
    for asked, deviation, words in ways:
        with contextlib.suppress(HysteresisError):  # there is no such damping
            fastest = first
            if asked is not request:
                fastest = _calmed(parameters, asked, known, _designed(parameters, asked, known, first))
            given, kept = with_designs(parameters, fastest), replace(asked, damping=None)
            for share in SHARES[: 1 if not free else AROUND if deviation else None]:
                found = fastest
                if share < 1.0:
                    band = {name: share * design.margins.bandwidth for name, design in fastest.items()}
                    found = _designed(given, kept, known, band)
                if not unmet_together(with_designs(parameters, found), deviation):
                    slower = f", with {share:g} times the bandwidth of the axis alone" if share < 1.0 else ""
                    said = f"{words}{slower}; otherwise {unmet}"
                    return {name: replace(design, together=said) for name, design in found.items()}
    said = f"requirements not met: {unmet}; request a lower --bandwidth, or --damping KIND"
    return {name: replace(design, together=said) for name, design in first.items()}


def _designed(parameters: StageParameters, request: DesignRequest, known: Uncertainties, bands) -> dict:
    """Design the axes in ``bands``, each for its bandwidth [Hz] if that is a number, otherwise as requested."""
    found = {}
    for name, band in bands.items():
        asked = replace(request, bandwidth=band) if isinstance(band, float) else request
        found[name] = design_axis(parameters.axes[parameters.place(name)], asked, known.get(name))
    return found


def with_designs(parameters: StageParameters, designs: Mapping[str, AxisDesign]) -> StageParameters:
    """Return a stage with the designed controllers."""
    axes = list(parameters.axes)
    for name, design in designs.items():
        place = parameters.place(name)
        own = {item.name: getattr(design.parameters, item.name) for item in fields(ControllerParameters)}
        axes[place] = replace(axes[place], motion_controller=replace(axes[place].motion_controller, **own))
    return replace(parameters, axes=tuple(axes))


def controllers_file(configuration: Configuration, designs: dict[str, AxisDesign], words: str) -> str:
    """Return the text of the parameter file with designed controllers, after a check that the stage can be built."""
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    reached = ", ".join(f"{name} {design.margins.bandwidth:.4g} Hz" for name, design in designs.items())
    header = (
        f"Controller designed by `hysteresis design {source} {words}`\n"
        f"on the model in motion_controller: bandwidth {reached}."
    )
    reasons = dict.fromkeys(design.together for design in designs.values() if design.together)
    header += "".join(f"\nAll loops together: {reason}." for reason in reasons)
    return with_sections(
        configuration,
        designs,
        header,
        lambda one, design, head, space: design_text(one, design.parameters, space, head),
    )


def with_sections(configuration: Configuration, designs, header: str, written: Callable) -> str:
    """Return the text of a file with the designed sections, motion limits of each axis, and one header."""
    text, source = configuration.original, configuration.source
    for number, (name, design) in enumerate(designs.items(), start=1):
        now = parse_configuration(text, source)
        head = header if number == len(designs) else ""
        text = written(now, design, head, f"{configuration.stage}/{name}")
    return safe_stage_text(text)


def safe_stage_text(text: str) -> str:
    """Return the text of a designed stage with motion limits of all axes, after a check that the stage can be built."""
    source = "the designed file"
    given = StageParameters.from_configuration(parse_configuration(text, source))
    stage = given.stage
    structure = (stage.structure.linear if stage.type == HAMMERSTEIN else stage.structure.small).A
    for name in given.names:
        text = with_safe_motion(text, source, f"{given.namespace}/{name}", structure=structure)
    Stage(StageParameters.from_configuration(parse_configuration(text, source)))
    return text


@dataclass(frozen=True, eq=False)
class StageLearning:
    """Designed corrections of the axes of a stage that follows a scan."""

    designs: dict[str, LearningDesign]  #: Designs by the names of the axes.
    corrections: dict[str, Learned]  #: Corrections with which the model of the stage follows the scan exactly.
    left: dict[str, str]  #: Axes without learning, with the reason.


def require_no_feedforward(parameters: StageParameters) -> None:
    """Refuse a feedforward, because the corrections of the reference already invert the loops."""
    for axis in parameters.axes:
        given = axis.motion_controller.feedforward.type
        if given != "none":
            raise ConfigurationError(
                f"{axis.namespace}/motion_controller: feedforward.type = {given}: must be none, because the correction "
                "inverts the loops of all axes itself"
            )


def decoupled(parameters: StageParameters, paths: np.ndarray) -> np.ndarray:
    """Return the corrections with which the linear model of a stage follows periodic paths, shape (n, N) [m]."""
    require_no_feedforward(parameters)
    count = paths.shape[1]
    lines = np.fft.rfft(paths, axis=1)
    size = np.max(np.abs(lines), axis=0)
    places = np.flatnonzero(size > SMALLEST * np.max(size[1:]))
    places = places[(places > 0) & (2 * places < count)]
    closed = stage_response(parameters, 2.0 * np.pi * places / count)
    corrected = np.zeros_like(lines)
    wanted = lines[:, places].T[:, :, np.newaxis]
    corrected[:, places] = (np.linalg.solve(closed, wanted) - wanted)[:, :, 0].T
    return np.fft.irfft(corrected, count, axis=1)


def design_stage_learning(parameters: StageParameters, request: LearningRequest, known: Uncertainties) -> StageLearning:
    """Design the learning of every axis that scans, for the period of its own path, and its initial corrections."""
    paths, rate = scanned_paths(parameters), parameters.sample_rate
    corrections = decoupled(parameters, paths)
    found = StageLearning({}, {}, {})
    for name in parameters.scanning_axes:
        place = parameters.names.index(name)
        axis, period = parameters.axes[place], shortest_period(paths[place])
        if period > LONGEST:
            found.left[name] = f"its path repeats after {period} samples, but learning stores at most {LONGEST}"
            continue
        design = design_learning(axis, replace(request, period=period / rate), known.get(name))
        low_pass = design.filters.responses(2.0 * np.pi * np.arange(period // 2 + 1) / period)[0]
        # averaged over the periods of this axis: the effect of another axis with a longer period differs between them
        own = corrections[place].reshape(-1, period).mean(axis=0)
        own = np.fft.irfft(np.fft.rfft(own) * low_pass, period)
        largest = float(np.max(np.abs(own)))
        if largest > design.parameters.maximum:
            found.left[name] = (
                f"its model needs corrections of {1e6 * largest:.4g} µm, but at most "
                f"{1e6 * design.parameters.maximum:.4g} µm are allowed: give a larger --maximum, or scan more slowly"
            )
            continue
        setpoint = axis.generator.initial_setpoint
        found.designs[name] = design
        found.corrections[name] = Learned(period / rate, 1.0 / rate, own, setpoint + paths[place][:period])
    if not found.designs:
        raise ConfigurationError("; ".join(f"{name}: {why}" for name, why in found.left.items()))
    return found


def stage_learning_file(configuration: Configuration, result: StageLearning, files: dict[str, str]) -> str:
    """Return the text of the parameter file with designed learning, which starts from the corrections in ``files``."""
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    kind = next(iter(result.designs.values())).parameters.type
    reached = ", ".join(
        f"{name} {design.filters.bandwidth / design.sample_time:.4g} Hz" for name, design in result.designs.items()
    )
    header = (
        f"Learning designed by `hysteresis design {source} --learning {kind}`\n"
        f"over the controller of this file: bandwidth {reached}; begins with the corrections of the coupled model."
    )
    chosen = {name: replace(design.parameters, file=files[name]) for name, design in result.designs.items()}
    return with_sections(
        configuration, chosen, header, lambda one, given, head, space: learning_text(one, given, space, head)
    )
