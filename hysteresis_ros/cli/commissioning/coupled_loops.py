# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The closed-loop stages of coupled axes: steps and scans of one axis after the other, then a path of all axes.

Each run is compared with a prediction by the identified stage with the same controllers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.analysis.metrics import delayed
from hysteresis_ros.cli.commissioning.closed_loop import (
    ERROR_AS_PREDICTED,
    FIRST_STEP,
    JUDGED_PART,
    JUDGED_PERIODS,
    LEFT,
    RINGING,
    SCANNED,
    STEP_HOLD,
    STEP_WAY,
    STEPS,
    UNJUDGED_PERIODS,
    root_mean_square,
)
from hysteresis_ros.cli.commissioning.coupled import DESIGNED, StageSituation
from hysteresis_ros.cli.commissioning.coupled_fitting import closed_configuration, commissioned_text
from hysteresis_ros.cli.commissioning.measuring import MICRO
from hysteresis_ros.cli.commissioning.situation import COMMISSIONED, CommissioningError, Outcome, verdict
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.loop.reach import reachable_displacements
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import hold, way
from hysteresis_ros.units import readable

#: Largest motion of a holding axis, as a fraction of the step of the moving axis.
DISTURBED = 0.25
#: Ratio of peak to RMS of the noise of a holding axis.
NOISE_PEAK = 5.0
#: A motion below this fraction of the noise cannot be distinguished from the noise.
BURIED = 0.2
#: Evaluated periods of the path of all axes together; the amplitude rises in one period before these periods, and falls
#: in one period after them.
TOGETHER = 4


@dataclass(frozen=True, eq=False)
class Excursion:
    """References of all axes, and the samples in which each axis moves."""

    references: np.ndarray  #: shape (N, n) [m]
    spans: dict[str, slice]  #: Samples in which each axis moves while the others hold.


@dataclass(frozen=True)
class Range:
    """Range of the reference of an axis in closed loop [m]."""

    low: float
    high: float
    rest: float  #: Reference at the safe voltages; may be outside the range.

    @property
    def far(self) -> float:
        """End of the range that is farther from ``rest``."""
        return self.high if self.high - self.rest >= self.rest - self.low else self.low


def designed(situation: StageSituation) -> Configuration:
    """Return the identified stage with its controllers, whose simulation predicts each run."""
    situation.figures("design")
    return load_configuration(situation.folder.path / DESIGNED)


def ranges(situation: StageSituation) -> dict[str, Range]:
    """Return the range of each axis by its name."""
    parameters = StageParameters.from_configuration(designed(situation))
    found = {}
    # the references that correspond to the safe voltages: a run from any other reference would begin with a voltage
    # step
    resting = [
        hysteresis_block(axis.hysteresis_compensator.hysteresis, 1.0 / situation.rate).simulate(np.array([safe]))[0]
        for axis, safe in zip(parameters.axes, situation.safe, strict=True)
    ]
    rests = product(parameters.recoupling(), np.array(resting))
    for name, axis, rest in zip(situation.names, parameters.axes, rests, strict=True):
        low, high = reachable_displacements(axis)
        found[name] = Range(axis.generator.minimum, axis.generator.maximum, float(min(max(rest, low), high)))
    return found


def in_turn(
    situation: StageSituation, base: Callable[[Range], float], own: Callable[[str, Range, float], np.ndarray]
) -> Excursion:
    """Return references: all axes move to their bases, each axis in turn follows its own path, then all move back."""
    found, rate, spans = ranges(situation), situation.rate, {}
    places = {name: base(one) for name, one in found.items()}

    def together(begin: dict[str, float], end: dict[str, float]) -> np.ndarray:
        return np.column_stack([way(begin[name], end[name], STEP_HOLD, rate) for name in found])

    rests = {name: one.rest for name, one in found.items()}
    still = [np.column_stack([hold(level[name], STEP_HOLD, rate) for name in found]) for level in (rests, places)]
    parts = [still[0], together(rests, places), still[1]]
    count = sum(len(part) for part in parts)
    for place, (name, one) in enumerate(found.items()):
        path = own(name, one, places[name])
        table = np.tile(list(places.values()), (len(path), 1))
        table[:, place] = path
        parts.append(table)
        spans[name] = slice(count, count + len(path))
        count += len(path)
    parts += [together(places, rests), still[0]]
    return Excursion(np.concatenate(parts), spans)


def run_of(situation: StageSituation, stage: str, references: np.ndarray) -> StageParameters:
    """Return the stage that follows references [m], shape (N, n)."""
    return situation.closed(closed_configuration(situation), stage, references)


def predicted(situation: StageSituation, stage: str, references: np.ndarray) -> Recording:
    """Return the response of the identified stage to references [m], shape (N, n)."""
    parameters = situation.closed(designed(situation), f"{stage}_predicted", references)
    return simulate_stage(parameters, duration=len(references) / situation.rate)


def errors_of(situation: StageSituation, recording: Recording) -> dict[str, np.ndarray]:
    """Return, for each axis, the reference minus the measurement relative to the sensor's zero [m]."""
    parameters = StageParameters.from_configuration(designed(situation))
    found = {}
    for name, axis in zip(situation.names, parameters.axes, strict=True):
        controller, run = axis.motion_controller, recording.axis(name)
        wanted = delayed(run["reference"], controller.feedforward.preview)
        found[name] = wanted - (run["measured"] - controller.model.preload.offset)
    return found


def steps(situation: StageSituation) -> Excursion:
    """Return the setpoints of small steps, one axis after the other."""
    rate = situation.rate

    def own(_: str, one: Range, place: float) -> np.ndarray:
        parts, at = [], place
        for target in [*(one.rest + part * (one.far - one.rest) for part in STEPS), place]:
            parts += [way(at, target, STEP_WAY, rate), hold(target, STEP_HOLD, rate)]
            at = target
        return np.concatenate(parts)

    return in_turn(situation, lambda one: one.rest + FIRST_STEP * (one.far - one.rest), own)


def loop_stage(situation: StageSituation) -> StageParameters:
    """Return the stage, configured for small steps in closed loop."""
    return run_of(situation, "loop", steps(situation).references)


def coupling_verdict(moved: float, model: float, noise: float) -> str:
    """Return a text that compares the motion [m] of a holding axis with its prediction.

    A motion below the noise of this axis counts as predicted.
    """
    if moved <= max(ERROR_AS_PREDICTED * model, noise):
        return "as predicted"
    return (
        f"{verdict(np.inf, ERROR_AS_PREDICTED)}; the coupling differs from the identified one: identify it again "
        "(--stage multisine)"
    )


def judge_loop(situation: StageSituation, recording: Recording) -> Outcome:
    """Check that each loop settles after small steps, and that the other axes hold their position."""
    excursion, rate = steps(situation), situation.rate
    errors = errors_of(situation, recording)
    expected = errors_of(situation, predicted(situation, "loop", excursion.references))
    step, held = round(STEP_WAY * rate) + round(STEP_HOLD * rate), round(JUDGED_PART * STEP_HOLD * rate)
    lines, figures, pictures = [], {}, []
    for name, span in excursion.spans.items():
        one = ranges(situation)[name]
        size = (STEPS[0] - FIRST_STEP) * abs(one.far - one.rest)
        ends = [slice(span.start + (k + 1) * step - held, span.start + (k + 1) * step) for k in range(len(STEPS) + 1)]
        for other in sorted(situation.names, key=lambda one: one != name):
            left = max(root_mean_square(errors[other][end]) for end in ends)
            right = max(root_mean_square(expected[other][end]) for end in ends)
            if left > max(LEFT * right, RINGING * size):
                raise CommissioningError(
                    f"axis {other}: does not settle after a step of {name} by {readable(size, 'm')}: the error is "
                    f"{1e9 * left:.3g} nm RMS, but {1e9 * right:.3g} nm in the simulation; the loop rings or drifts. "
                    "Outputs are safe. Design another controller (--stage design --controller NAME), or measure again "
                    "(--stage multisine)"
                )
            if other == name:
                lines.append(f"{name}: settles: error {1e9 * left:.3g} nm RMS, predicted {1e9 * right:.3g} nm")
                figures[name] = {"rest_rms_m": left, "predicted_rest_rms_m": right}
                continue
            moved, model = (float(np.max(np.abs(found[other][span]))) for found in (errors, expected))
            if moved > DISTURBED * size:
                raise CommissioningError(
                    f"axis {other}: moves by {readable(moved, 'm')} while {name} steps by {readable(size, 'm')}, and "
                    f"{readable(model, 'm')} were predicted: the loops disturb each other. Outputs are safe. Measure "
                    "again (--stage multisine)"
                )
            text = f"{other} moves by at most {1e9 * moved:.3g} nm meanwhile, predicted {1e9 * model:.3g} nm"
            lines.append(f"{name}: {text}: {coupling_verdict(moved, model, NOISE_PEAK * left)}")
            figures[name] |= {f"moves_{other}_m": moved, f"predicted_moves_{other}_m": model}
        pictures.append(_tracking(situation, f"Steps of {name}", recording, errors, span))
    return Outcome(lines, figures, pictures)


def _tracking(situation: StageSituation, caption: str, recording: Recording, errors, span: slice) -> Picture:
    """Return a plot of all references and measurements in a span of a run."""
    time, traces = recording.time[span] - recording.time[span.start], []
    for name in situation.names:
        reference = recording[f"{name}/reference"][span]
        traces.append(line(f"{name}, reference", time, MICRO * reference))
        traces.append(line(f"{name}, measured", time, MICRO * (reference - errors[name][span])))
    return Picture(caption, "time [s]", "displacement [µm]", traces)


def scan_size(situation: StageSituation, name: str, one: Range) -> float:
    """Return the peak-to-peak displacement of the scan of an axis [m]."""
    size = situation.plans[name].scan_stroke or SCANNED * (one.high - one.low)
    if size > one.high - one.low:
        raise CommissioningError(
            f"axis {name}: a scan of {readable(size, 'm')} was requested, but it reaches "
            f"{readable(one.high - one.low, 'm')}; lower scan_stroke in /commissioning"
        )
    return size


def scan_period(situation: StageSituation) -> int:
    """Return the number of samples in one triangle of the scan."""
    return max(round(situation.rate / next(iter(situation.plans.values())).scan_frequency), 8)


def scans(situation: StageSituation) -> Excursion:
    """Return triangles on one axis after the other, each around the middle of the axis' range."""
    period, rate = scan_period(situation), situation.rate

    def own(name: str, one: Range, place: float) -> np.ndarray:
        size = scan_size(situation, name, one)
        begin = place - 0.5 * size
        phase = np.arange(1, (UNJUDGED_PERIODS + JUDGED_PERIODS) * period + 1) / period
        triangle = begin + size * 2.0 * np.abs(phase - np.round(phase))
        parts = [way(place, begin, STEP_HOLD, rate), hold(begin, STEP_HOLD, rate), triangle]
        return np.concatenate([*parts, way(begin, place, STEP_HOLD, rate), hold(place, STEP_HOLD, rate)])

    return in_turn(situation, lambda one: 0.5 * (one.low + one.high), own)


def scan_stage(situation: StageSituation) -> StageParameters:
    """Return the stage with a scan of one axis after the other."""
    return run_of(situation, "scan", scans(situation).references)


def repeated(error: np.ndarray, period: int) -> tuple[float, float]:
    """Return the RMS [m] of the periodic part without its mean, and of the noise in the average period."""
    table = error[: len(error) // period * period].reshape(-1, period)
    noise = float(np.mean(np.var(table, axis=0, ddof=1))) / len(table)
    return float(np.sqrt(max(np.var(table.mean(axis=0)) - noise, 0.0))), float(np.sqrt(noise))


def judge_scan(situation: StageSituation, recording: Recording) -> Outcome:
    """Compare the error of each scan, and the motion of the other axes, with their predictions."""
    excursion, period = scans(situation), scan_period(situation)
    both = (recording, predicted(situation, "scan", excursion.references))
    errors, expected = (errors_of(situation, run) for run in both)
    lines: list[str] = []
    figures: dict = {}
    pictures = []
    for name, span in excursion.spans.items():
        begin = span.start + 2 * round(STEP_HOLD * situation.rate) + UNJUDGED_PERIODS * period
        judged = slice(begin, begin + JUDGED_PERIODS * period)
        size = scan_size(situation, name, ranges(situation)[name])
        found, model = (root_mean_square(one[name][judged]) for one in (errors, expected))
        ratio = found / model
        what = f"triangle of {readable(size, 'm')} at {situation.rate / period:.4g} Hz"
        lines.append(
            f"{name}: {what}: error {1e9 * found:.4g} nm RMS, predicted {1e9 * model:.4g} nm, ratio {ratio:.4g}: "
            f"{verdict(ratio, ERROR_AS_PREDICTED)}"
        )
        figures[name] = {"rms_error_m": found, "predicted_rms_m": model, "ratio": ratio}
        for other in situation.names:
            if other != name:
                moved, noise = repeated(errors[other][judged], period)
                modelled, _ = repeated(expected[other][judged], period)
                least = BURIED * noise
                shown = f"{1e9 * moved:.2g} nm" if moved > least else f"less than {1e9 * least:.2g} nm"
                percent = 100.0 * max(moved, least) / size
                judgement = coupling_verdict(moved, modelled, np.sqrt(JUDGED_PERIODS) * noise)
                lines.append(
                    f"{name}: its scan moves {other} by {shown} RMS, {percent:.2g} % of the scan, predicted "
                    f"{1e9 * modelled:.2g} nm: {judgement}"
                )
                figures[name] |= {f"coupling_{other}_rms_m": moved, f"predicted_coupling_{other}_rms_m": modelled}
        time = recording.time[judged]
        traces = [
            line(label, time, 1e9 * one[name][judged]) for label, one in (("measured", errors), ("predicted", expected))
        ]
        pictures.append(Picture(f"Error of the scan of {name}", "time [s]", "reference − measured [nm]", traces))
    figures["as_predicted"] = all(figures[name]["ratio"] <= ERROR_AS_PREDICTED for name in situation.names)
    return Outcome(lines, figures, pictures)


def together(situation: StageSituation) -> tuple[np.ndarray, slice]:
    """Return simultaneous sines [m], shape (N, n), one frequency for each axis, and the evaluated samples.

    Frequencies are 1, 1.5, 2 … times the frequency of the scan, so the path repeats after two periods of the scan.
    """
    rate, period = situation.rate, 2 * scan_period(situation)
    index = np.arange((TOGETHER + 2) * period)
    envelope = np.clip(np.minimum(index / period, (len(index) - index) / period), 0.0, 1.0)
    envelope = 0.5 * (1.0 - np.cos(np.pi * envelope))
    columns = []
    for place, (name, one) in enumerate(ranges(situation).items()):
        middle, size = 0.5 * (one.low + one.high), scan_size(situation, name, one)
        path = middle + 0.5 * size * envelope * np.sin(2.0 * np.pi * (place + 2) * index / period)
        parts = [hold(one.rest, STEP_HOLD, rate), way(one.rest, middle, STEP_HOLD, rate), path]
        columns.append(
            np.concatenate([*parts, way(middle, one.rest, STEP_HOLD, rate), hold(one.rest, STEP_HOLD, rate)])
        )
    begin = 2 * round(STEP_HOLD * rate) + period
    return np.column_stack(columns), slice(begin, begin + TOGETHER * period)


def judge_stage(situation: StageSituation) -> StageParameters:
    """Return the stage, configured to move all axes simultaneously."""
    return run_of(situation, "judge", together(situation)[0])


def judge_together(situation: StageSituation, recording: Recording) -> Outcome:
    """Compare a path that neither identification nor design has used with its prediction; write the parameter file."""
    references, judged = together(situation)
    errors = errors_of(situation, recording)
    expected = errors_of(situation, predicted(situation, "judge", references))
    lines: list[str] = []
    figures: dict = {}
    for name in situation.names:
        found, model = (root_mean_square(one[name][judged]) for one in (errors, expected))
        ratio = found / model
        lines.append(
            f"{name}: error {1e9 * found:.4g} nm RMS, predicted {1e9 * model:.4g} nm, ratio {ratio:.4g}: "
            f"{verdict(ratio, ERROR_AS_PREDICTED)}"
        )
        figures[name] = {"rms_error_m": found, "predicted_rms_m": model, "ratio": ratio}
    figures["as_predicted"] = all(figures[name]["ratio"] <= ERROR_AS_PREDICTED for name in situation.names)
    pictures = []
    if len(situation.names) > 1:
        first, second = situation.names[:2]
        paths = [
            line(
                label,
                *(MICRO * (recording[f"{name}/reference"] - part * errors[name])[judged] for name in (first, second)),
            )
            for label, part in (("reference", 0.0), ("measured", 1.0))
        ]
        pictures.append(Picture("Path of all axes together", f"{first} [µm]", f"{second} [µm]", paths, equal=True))
    write_file(situation.folder.path / COMMISSIONED, commissioned_text(situation))
    return Outcome(lines, figures, pictures)
