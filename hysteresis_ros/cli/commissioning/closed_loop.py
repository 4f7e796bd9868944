# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages in closed loop: small steps, margins, the scan, and the scan again with learning.

Each result is compared with its prediction.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.analysis.metrics import delayed
from hysteresis_ros.cli.commissioning.measuring import MICRO
from hysteresis_ros.cli.commissioning.situation import (
    COMMISSIONED,
    LEARNING,
    OVERTRAVEL,
    CommissioningError,
    Outcome,
    Situation,
    verdict,
)
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.control.learning import LearningParameters, period_samples
from hysteresis_ros.control.margins import Margins, MeasuredLoop
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.designs.controller import response_uncertainty
from hysteresis_ros.designs.frequency_response import AxisResponse, around, axis_response
from hysteresis_ros.designs.learning import LearningRequest, MeasuredPlant, design_learning, learning_file
from hysteresis_ros.errors import HysteresisError, IdentificationError, RecordingError
from hysteresis_ros.identification.excitations import Experiment, Plan, excitation
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import reachable_displacements, single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import following, hold, way, write_samples
from hysteresis_ros.units import readable

#: Displacement of the scan from peak to peak, as a fraction of the stroke, unless the plan gives the displacement.
SCANNED = 0.7
#: Number of periods at the beginning of a scan that are only for settling.
UNJUDGED_PERIODS = 3
#: Number of evaluated periods at the end of a scan.
JUDGED_PERIODS = 10
#: Level before the first small step in closed loop, as a fraction of the distance from rest to the farther end of the
#: range.
FIRST_STEP = 0.1
#: Levels after each small step, as fractions of the same distance; none of them is at rest, because hysteresis may
#: prevent a return to it.
STEPS = (0.2, 0.3, 0.2)
#: Duration of each hold in the small steps and around the scan, and of the slow ramps from and to rest [s].
STEP_HOLD = 0.5
#: Duration of the transition to the next level in a small step [s].
STEP_WAY = 0.05
#: Evaluated part of each hold: this fraction at its end.
JUDGED_PART = 0.2
#: Largest RMS error at the end of a small step, as a multiple of the predicted RMS error.
LEFT = 6.0
#: RMS error at the end of a small step that is always allowed, as a fraction of the step.
RINGING = 0.05
#: Largest error of the scan, relative to the predicted error.
ERROR_AS_PREDICTED = 1.5


def scan_stroke(situation: Situation) -> float:
    """Return the displacement of the scan from peak to peak [m]."""
    return situation.plan.scan_stroke or SCANNED * situation.figure("hysteresis", "stroke_m")


def scan_period(situation: Situation) -> int:
    """Return the number of samples in one triangle of the scan."""
    return max(round(situation.rate / situation.plan.scan_frequency), 4)


def _reach(situation: Situation, configuration: Configuration) -> tuple[float, float]:
    values = configuration.node("reference_generator", situation.axis.namespace)
    return values["minimum"], values["maximum"]


def scan_reference(situation: Situation, configuration: Configuration, unjudged: int = UNJUDGED_PERIODS) -> np.ndarray:
    """Return the scan [m]: the ramp to the low end of the triangles, the triangles, and the ramp back to rest."""
    begin, size = _scanned(situation, configuration)
    period, rate = scan_period(situation), situation.rate
    phase = np.arange(1, (unjudged + JUDGED_PERIODS) * period + 1) / period
    triangle = begin + size * 2.0 * np.abs(phase - np.round(phase))
    rest = _resting_reference(situation, configuration)
    parts = [hold(rest, STEP_HOLD, rate), way(rest, begin, STEP_HOLD, rate), hold(begin, STEP_HOLD, rate), triangle]
    return np.concatenate([*parts, way(begin, rest, STEP_HOLD, rate), hold(rest, STEP_HOLD, rate)])


def _scanned(situation: Situation, configuration: Configuration) -> tuple[float, float]:
    """Return the low end of the scan and its peak-to-peak displacement [m]."""
    low, high = _reach(situation, configuration)
    size = scan_stroke(situation)
    if size > high - low:
        raise CommissioningError(
            f"a scan of {readable(size, 'm')} was requested, but the stage reaches {readable(high - low, 'm')}; lower "
            "scan_stroke in /commissioning"
        )
    return 0.5 * (low + high - size), size


def _resting_reference(situation: Situation, configuration: Configuration) -> float:
    """Return the reference [m] at which a run begins and ends; it may be outside the range of the axis."""
    low, high = reachable_displacements(single_axis(configuration, situation.axis.namespace))
    return min(max(0.0, low), high)


def _ends_of_steps(situation: Situation, configuration: Configuration) -> tuple[float, float]:
    """Return the position at rest, and the farther end of the range [m]: the small steps lie between them."""
    low, high = _reach(situation, configuration)
    rest = _resting_reference(situation, configuration)
    return rest, high if high - rest >= rest - low else low


def steps_reference(situation: Situation, configuration: Configuration) -> np.ndarray:
    """Return the setpoints of the small steps in closed loop [m]."""
    (rest, far), rate = _ends_of_steps(situation, configuration), situation.rate
    place = rest + FIRST_STEP * (far - rest)
    parts = [hold(rest, STEP_HOLD, rate), way(rest, place, STEP_HOLD, rate), hold(place, STEP_HOLD, rate)]
    for part in STEPS:
        target = rest + part * (far - rest)
        parts += [way(place, target, STEP_WAY, rate), hold(target, STEP_HOLD, rate)]
        place = target
    return np.concatenate([*parts, way(place, rest, STEP_HOLD, rate), hold(rest, STEP_HOLD, rate)])


def closed_axis(
    situation: Situation, configuration: Configuration, stage: str, reference: np.ndarray, **further
) -> AxisParameters:
    """Return the designed axis, which follows a reference once; ``further`` is stored with the reference.

    Units: ``reference`` [m].
    """
    path = write_samples(situation.folder.path / "waveforms" / f"{stage}.npz", reference, situation.rate, **further)
    configuration = following(configuration, path)
    low, high = _reach(situation, configuration)
    ends = {"minimum": min(low, float(np.min(reference))), "maximum": max(high, float(np.max(reference)))}
    configuration = configuration.override("reference_generator", **ends)
    if situation.has_device:
        configuration = configuration.override("plant_simulator", overtravel=OVERTRAVEL * situation.plan.stroke)
    axis = single_axis(configuration, situation.axis.namespace)
    return axis.with_duration(reference.size / situation.rate)


def predicted_scan(situation: Situation, configuration: Configuration) -> Recording:
    """Return the scan as ``hysteresis simulate`` computes it from the file."""
    return simulate(closed_axis(situation, configuration, "scan", scan_reference(situation, configuration)))


def error_of(configuration: Configuration, namespace: str, recording: Recording) -> np.ndarray:
    """Return the reference, delayed by its preview, minus the measurement relative to the sensor's zero [m]."""
    controller = single_axis(configuration, namespace).motion_controller
    wanted = delayed(recording["reference"], controller.feedforward.preview)
    return wanted - (recording["measured"] - controller.model.preload.offset)


def judged_samples(situation: Situation, configuration: Configuration) -> slice:
    """Return the evaluated samples of the scan: the last periods, delayed by the preview."""
    period = scan_period(situation)
    begin = scan_begin(situation) + UNJUDGED_PERIODS * period
    preview = single_axis(configuration, situation.axis.namespace).motion_controller.feedforward.preview
    return slice(begin + preview, begin + JUDGED_PERIODS * period)


def scan_begin(situation: Situation) -> int:
    """Return the sample at which the first triangle begins."""
    return 3 * max(round(STEP_HOLD * situation.rate), 1)


def scan_error(situation: Situation, configuration: Configuration, recording: Recording) -> float:
    """Return the RMS error [m] of the evaluated periods."""
    error = error_of(configuration, situation.axis.namespace, recording)
    return root_mean_square(error[judged_samples(situation, configuration)])


def root_mean_square(error: np.ndarray) -> float:
    """Return the RMS of an error [m]."""
    return float(np.sqrt(np.mean(error**2)))


def designed(situation: Situation) -> Configuration:
    """Return the configuration of the designed axis."""
    situation.figure("design", "predicted_rms_m")
    return load_configuration(situation.folder.path / COMMISSIONED)


def loop_axis(situation: Situation) -> AxisParameters:
    """Return the axis, configured for small steps in closed loop."""
    configuration = designed(situation)
    return closed_axis(situation, configuration, "loop", steps_reference(situation, configuration))


def judge_loop(situation: Situation, recording: Recording) -> Outcome:
    """Check that the loop settles after small steps, as in the simulation."""
    configuration, namespace = designed(situation), situation.axis.namespace
    error = error_of(configuration, namespace, recording)
    expected = error_of(configuration, namespace, simulate(loop_axis(situation)))
    rest, far = _ends_of_steps(situation, configuration)
    rate, size = situation.rate, (STEPS[0] - FIRST_STEP) * abs(far - rest)
    held = round(STEP_HOLD * rate)
    stops = [3 * held + (number + 1) * (held + round(STEP_WAY * rate)) for number in range(len(STEPS))]
    ends = [slice(stop - round(JUDGED_PART * held), stop) for stop in stops]
    left = max(float(np.sqrt(np.mean(error[end] ** 2))) for end in ends)
    right = max(float(np.sqrt(np.mean(expected[end] ** 2))) for end in ends)
    if left > max(LEFT * right, RINGING * size):
        raise CommissioningError(
            f"the closed loop does not settle: the error after a step of {readable(size, 'm')} is "
            f"{1e9 * left:.3g} nm RMS, but {1e9 * right:.3g} nm in the simulation; the loop rings or "
            "drifts. Outputs are safe. "
            "Resume with another --controller, or measure the resonance again (--stage resonance)"
        )
    time = recording.time - recording.time[0]
    traces = [
        line("reference", time, MICRO * recording["reference"]),
        line("measured", time, MICRO * (recording["reference"] - error)),
    ]
    lines = [f"settles: error {1e9 * left:.3g} nm RMS, predicted {1e9 * right:.3g} nm"]
    picture = Picture("Small steps in closed loop", "time [s]", "displacement [µm]", traces)
    return Outcome(lines, {"rest_rms_m": left, "predicted_rest_rms_m": right}, [picture])


def scan_axis(situation: Situation) -> AxisParameters:
    """Return the axis of the scan."""
    configuration = designed(situation)
    return closed_axis(situation, configuration, "scan", scan_reference(situation, configuration))


def judge_scan(situation: Situation, recording: Recording) -> Outcome:
    """Compare the scan with its prediction."""
    configuration, namespace = designed(situation), situation.axis.namespace
    simulated = predicted_scan(situation, configuration)
    found, expected = (scan_error(situation, configuration, run) for run in (recording, simulated))
    ratio = found / expected
    what = f"triangle of {readable(scan_stroke(situation), 'm')} at {situation.plan.scan_frequency:g} Hz"
    lines = [
        f"{what}: error {1e9 * found:.4g} nm RMS, predicted {1e9 * expected:.4g} nm, ratio {ratio:.4g}: "
        f"{verdict(ratio, ERROR_AS_PREDICTED)}"
    ]
    judged = judged_samples(situation, configuration)
    delayed, ideal = (
        _by_period(situation, error_of(configuration, namespace, run), UNJUDGED_PERIODS)
        for run in (recording, simulated)
    )
    lines += _missed_lines(situation, recording, delayed)
    lines.append(repetition_line(*(each[UNJUDGED_PERIODS:] for each in (delayed, ideal))))
    time = recording.time - recording.time[0]
    errors = [
        line(label, time[judged], 1e9 * error_of(configuration, namespace, run)[judged])
        for label, run in (("measured", recording), ("predicted", simulated))
    ]
    way_ = [
        line("reference", time, MICRO * recording["reference"]),
        line("measured", time, MICRO * (recording["reference"] - error_of(configuration, namespace, recording))),
    ]
    pictures = [
        Picture(f"Scan: {what}", "time [s]", "displacement [µm]", way_),
        Picture("Error of the scan, evaluated periods", "time [s]", "reference − measured [nm]", errors),
    ]
    undelayed = recording["reference"] - (recording["measured"] - preload_offset(configuration, namespace))
    figures = {
        "rms_error_m": found,
        "undelayed_rms_m": root_mean_square(undelayed[judged]),
        "predicted_rms_m": expected,
        "ratio": ratio,
        "as_predicted": ratio <= ERROR_AS_PREDICTED,
    }
    return Outcome(lines, figures, pictures)


def preload_offset(configuration: Configuration, namespace: str) -> float:
    """Return the measurement offset [m] that the preload causes."""
    return float(single_axis(configuration, namespace).motion_controller.model.preload.offset)


#: Excitation: odd harmonics of 2 Hz; five realisations of three periods each, the first of which is for settling.
EXPERIMENT = Experiment(period=0.5, periods=2, settle=1, realisations=5)
#: Largest M_s, relative to the predicted M_s.
MARGIN_AS_PREDICTED = 1.25
#: Largest magnitude of the loop transfer function that is drawn in the Nyquist plot.
PLANE = 3.0


def _played_reference(situation: Situation, configuration: Configuration) -> tuple[np.ndarray, Plan, float]:
    """Return the reference [m], the plan of its excitation, and the peak of this excitation [m]."""
    low, high = _reach(situation, configuration)
    samples, plan = excitation(EXPERIMENT, situation.rate)
    peak = situation.plan.small * (high - low)
    rest = _resting_reference(situation, configuration)
    reference, plan = around(samples, peak, 0.5 * (low + high), rest, situation.rate, plan)
    return reference, replace(plan, loop="closed", at="reference"), peak


def response_peak(situation: Situation) -> float:
    """Return the peak of the reference's excitation [m]."""
    return _played_reference(situation, designed(situation))[2]


def response_axis(situation: Situation) -> AxisParameters:
    """Return the closed-loop axis with an excited reference."""
    configuration = designed(situation)
    reference, plan, _ = _played_reference(situation, configuration)
    return closed_axis(situation, configuration, "response", reference, plan=plan.text)


def _measured_response(situation: Situation, recording: Recording) -> AxisResponse:
    configuration = designed(situation)
    plan = _played_reference(situation, configuration)[1]
    return axis_response(recording, plan, single_axis(configuration, situation.axis.namespace))


def measured_plant(situation: Situation) -> MeasuredPlant | None:
    """Return the ratio of the plant measured in closed loop to its model; None if there is no usable response."""
    try:
        found = _measured_response(situation, situation.folder.recording("response"))
    except (IdentificationError, RecordingError):
        return None
    loop = cast("MeasuredLoop", found.loop)
    # both loops differ only in the plant, so all other elements cancel in the ratio
    return MeasuredPlant(loop.frequency, loop.loop / cast("np.ndarray", found.model_loop))


def judge_response(situation: Situation, recording: Recording) -> Outcome:
    """Compare the measured margins of the closed loop with the predicted margins."""
    try:
        found = _measured_response(situation, recording)
    except (IdentificationError, RecordingError) as error:
        # no exception, because later stages do not depend on this result
        return Outcome([f"margins not measured: {error}; `small` in /commissioning sets the amplitude"])
    # the margins are not None, because the plan closes the loop and the axis is known
    known = found.loop, found.margins, found.model_loop
    loop, margins, model = cast("tuple[MeasuredLoop, Margins, np.ndarray]", known)
    peak, expected = loop.sensitivity_peak, margins.sensitivity_peak
    ratio = peak.low / expected
    lines = [f"M_s {peak.text('.3g')}, predicted {expected:.3g}: {verdict(ratio, MARGIN_AS_PREDICTED)}"]
    lines += [f"{name} {text}".replace("model", "predicted") for name, text in loop.rows(margins)[:-1]]
    lines += filter(None, [found.limitation])
    return Outcome(
        lines, {**found.figures, "as_predicted": ratio <= MARGIN_AS_PREDICTED}, _response_pictures(loop, model)
    )


def _response_pictures(loop: MeasuredLoop, model: np.ndarray) -> list[Picture]:
    f, predicted = loop.frequency, 1.0 / (1.0 + model)
    curves = [
        line("S, measured", f, np.abs(loop.sensitivity)),
        line("S, predicted", f, np.abs(predicted)),
        line("T, measured", f, np.abs(loop.complementary)),
        line("T, predicted", f, np.abs(1.0 - predicted)),
    ]
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
    bound = -1.0 + 0.5 * turn
    near = np.abs(loop.loop) < PLANE
    plane = [
        line("loop, measured", loop.loop[near].real, loop.loop[near].imag),
        line("M_s = 2", bound.real, bound.imag),
        line("loop, predicted", model[np.abs(model) < PLANE].real, model[np.abs(model) < PLANE].imag),
        line("|L| = 1", turn.real, turn.imag),
    ]
    return [
        Picture("Sensitivity S and complementary sensitivity T", "frequency [Hz]", "magnitude [1]", curves, "xy"),
        Picture("Nyquist", "Re L", "Im L", plane, equal=True),
    ]


def at_or_after(events: np.ndarray, samples: int) -> np.ndarray:
    """Return whether each sample is an event, or follows an event within ``samples`` samples."""
    numbers = np.arange(len(events))
    last = np.maximum.accumulate(np.where(events, numbers, -samples - 1))
    return numbers - last <= samples


def not_learned(parameters: LearningParameters, rate: float, signals) -> dict[str, np.ndarray]:
    """Return the samples that learning omits, by reason; a sample with several reasons counts under the first reason.

    Units: ``rate`` [Hz].
    """
    # the achieved command of a sample is known one sample later
    shortfall = np.abs(signals["applied"] - signals["command"]) > parameters.shortfall
    shortfall = np.concatenate([[False], shortfall[:-1]])
    skipped = np.asarray(signals.get("skipped", np.zeros(len(shortfall)))) > 0.5
    unseen = ~np.isfinite(signals.get("seen", signals["measured"]))
    answers, lasts = round(parameters.late_answer * rate), round(parameters.recovery * rate)
    found, known = {}, np.zeros(len(shortfall), dtype=bool)
    for reason, samples in (
        ("late samples", skipped),
        ("the response of the axis to late samples", at_or_after(skipped, answers)),
        ("commands limited by range or slew rate", shortfall),
        ("the recovery from limited commands", at_or_after(shortfall, lasts)),
        ("missing measurements", unseen),
    ):
        found[reason] = samples & ~known
        known |= samples
    return found


def learned_line(parameters: LearningParameters, rate: float, signals, begin: int, count: int) -> str:
    """Return a sentence: how many periods were learned completely, and why samples of the others were omitted.

    Units: ``rate`` [Hz].
    """
    period = period_samples(parameters.period, rate)
    reasons = {
        reason: samples[begin : begin + count * period].reshape(-1, period)
        for reason, samples in not_learned(parameters, rate, signals).items()
    }
    out = np.sum(list(reasons.values()), axis=(0, 2))
    whole, none = int(np.count_nonzero(out == 0)), int(np.count_nonzero(out == period))
    text = f"of {len(out)} periods, {whole} were learned completely"
    if whole == len(out):
        return text
    text += f", {len(out) - whole - none} in part, {none} not at all; omitted: "
    shares = {reason: float(np.mean(samples)) for reason, samples in reasons.items() if samples.any()}
    return text + ", ".join(
        f"{100.0 * share:.3g} % of the samples because of {reason}" for reason, share in shares.items()
    )


#: Largest number of learned periods.
MOST_PERIODS = 30
#: Longest total time of the learned periods [s], unless FEWEST_PERIODS periods take longer.
LONGEST_LEARNING = 20.0
#: Smallest number of learned periods, even if they take longer than LONGEST_LEARNING.
FEWEST_PERIODS = 10
#: Assumed uncertainty of a model that was identified from the same stage a minute ago.
CLOSE_TO_MODEL = Uncertainty(gain=0.02, hysteresis=0.05, resonance=0.005, delay=0.1, draws=20)
#: Designed kind of learning.
FILTER_DESIGN = "inversion"


def learning_periods(situation: Situation) -> int:
    """Return the number of periods of learning before the evaluated periods."""
    return int(min(MOST_PERIODS, max(LONGEST_LEARNING * situation.plan.scan_frequency, FEWEST_PERIODS)))


def learn_axis(situation: Situation) -> AxisParameters | Outcome:
    """Return the axis that learns the scan, and write its file; or return why learning is not possible."""
    configuration, namespace = designed(situation), situation.axis.namespace
    # a correction of an earlier attempt belongs to another loop
    (situation.folder.path / LEARNING).unlink(missing_ok=True)
    try:
        period = scan_period(situation) / situation.rate
        request = LearningRequest(FILTER_DESIGN, period, possible=CLOSE_TO_MODEL)
        known = measured_plant(situation) or response_uncertainty(configuration)
        begin, size = _scanned(situation, configuration)
        wave = {"type": "triangle", "frequency": 1.0 / period, "amplitude": size, "offset": 0.0, "cycles": 0}
        scan = {f"waveform.{name}": value for name, value in wave.items()}
        scanning = configuration.override("reference_generator", initial_setpoint=begin, **scan)
        result = design_learning(single_axis(scanning, namespace), request, known)
        text = learning_file(configuration, result, namespace)
    except HysteresisError as error:
        return Outcome([f"no learning: {' '.join(str(error).split())}"])
    write_file(situation.folder.path / LEARNING, text)
    return _learning_axis(situation, _learning_configuration(situation))


def _learning_configuration(situation: Situation) -> Configuration:
    return load_configuration(situation.folder.path / LEARNING)


def _learning_axis(situation: Situation, configuration: Configuration) -> AxisParameters:
    reference = scan_reference(situation, configuration, learning_periods(situation))
    return closed_axis(situation, configuration, "learn", reference)


def judge_learned(situation: Situation, recording: Recording) -> Outcome:
    """Compare the scan after learning with its prediction and with the scan without learning."""
    configuration, count = _learning_configuration(situation), learning_periods(situation)
    learning = single_axis(configuration, situation.axis.namespace).motion_controller.learning
    simulated = simulate(_learning_axis(situation, configuration))
    runs = {"measured": _period_errors(situation, recording), "predicted": _period_errors(situation, simulated)}
    found, expected = (root_mean_square(errors[count:]) for errors in runs.values())
    # folders written by earlier versions contain only the error against the delayed reference
    before, ratio = situation.found["scan"].figures.get("undelayed_rms_m", math.nan), found / expected
    what = f"triangle of {readable(scan_stroke(situation), 'm')} at {situation.plan.scan_frequency:g} Hz"
    lines = [
        f"{what} after {count} periods: error {1e9 * found:.4g} nm RMS, {1e9 * before:.4g} nm without learning, "
        f"both against the undelayed reference; predicted {1e9 * expected:.4g} nm, ratio {ratio:.4g}: "
        f"{verdict(ratio, ERROR_AS_PREDICTED)}",
        learned_line(learning, situation.rate, _signals(recording), scan_begin(situation), count),
    ]
    figures = {
        "rms_error_m": found,
        "undelayed_rms_without_m": before,
        "predicted_rms_m": expected,
        "ratio": ratio,
        "as_predicted": ratio <= ERROR_AS_PREDICTED,
    }
    lines += _missed_lines(situation, recording, runs["measured"])
    lines.append(repetition_line(*(errors[count:] for errors in runs.values())))
    numbers = np.arange(1, count + JUDGED_PERIODS + 1)
    falling = [line(name, numbers, 1e9 * np.sqrt(np.mean(each**2, axis=1))) for name, each in runs.items()]
    time = np.arange(scan_period(situation)) / situation.rate
    last = [line(name, time, 1e9 * each[-1]) for name, each in runs.items()]
    pictures = [
        Picture("Error of each period", "period", "RMS error [nm]", falling, "y"),
        Picture("Error of a period after learning", "time [s]", "reference − measured [nm]", last),
    ]
    return Outcome(lines, figures, pictures)


def in_time(skipped: np.ndarray) -> np.ndarray:
    """Return whether each period is undisturbed: no deadline was missed in it or in the previous period."""
    late = np.any(skipped > 0.5, axis=1)
    return ~(late | np.concatenate([[False], late[:-1]]))


def _missed_lines(situation: Situation, recording: Recording, errors: np.ndarray) -> list[str]:
    """Return the sentence about missed deadlines, if these are recorded; ``errors`` [m], shape (periods, samples)."""
    if not recording.has("skipped"):
        return []
    unjudged = len(errors) - JUDGED_PERIODS
    kept = in_time(_by_period(situation, recording["skipped"], unjudged))[unjudged:]
    undisturbed = root_mean_square(errors[unjudged:][kept]) if np.any(kept) else math.nan
    return [missed_line(undisturbed, kept)]


def missed_line(error: float, kept: np.ndarray) -> str:
    """Return a sentence about the error in the undisturbed periods, see :func:`in_time`.

    Units: ``error`` [m].
    """
    count = np.count_nonzero(kept)
    if not count:
        return f"deadlines were missed in or just before each of the {len(kept)} periods: the machine limits the error"
    if count == len(kept):
        return "no deadline was missed"
    return f"deadlines were missed; error of the {count} undisturbed of {len(kept)} periods: {1e9 * error:.4g} nm RMS"


def unrepeated(errors: np.ndarray) -> float:
    """Return the RMS deviation [m] of the periods from their average; ``errors`` [m], shape (periods, samples)."""
    return float(np.sqrt(np.mean(np.var(errors, axis=0, ddof=1))))


def repetition_line(measured: np.ndarray, predicted: np.ndarray) -> str:
    """Return a sentence about the part of the error that neither a better model nor learning removes.

    Units: both [m], shape (periods, samples).
    """
    found, expected = unrepeated(measured), unrepeated(predicted)
    said = f"{1e9 * found:.4g} nm RMS of the error does not repeat from period to period"
    said += f", predicted {1e9 * expected:.4g} nm"
    if found <= ERROR_AS_PREDICTED * expected:
        return said
    causes = "disturbances, missed deadlines or jitter"
    rest, modelled = (
        math.sqrt(max(float(np.mean(errors**2)) - varying**2, 0.0))
        for errors, varying in ((measured, found), (predicted, expected))
    )
    return (
        f"{said}: {causes}; the part that repeats, which shows the accuracy of the model, is {1e9 * rest:.4g} nm RMS, "
        f"predicted {1e9 * modelled:.4g} nm"
    )


def _signals(recording: Recording) -> dict[str, np.ndarray]:
    names = ("command", "applied", "measured", "skipped", "seen")
    return {name: recording[name] for name in names if recording.has(name)}


def _period_errors(situation: Situation, recording: Recording) -> np.ndarray:
    """Return the errors of all periods against the undelayed reference, shape (periods, samples) [m]."""
    offset = single_axis(
        _learning_configuration(situation), situation.axis.namespace
    ).motion_controller.model.preload.offset
    error = recording["reference"] - (recording["measured"] - offset)
    return _by_period(situation, error, learning_periods(situation))


def _by_period(situation: Situation, values: np.ndarray, unjudged: int) -> np.ndarray:
    """Return values of the scan, one row for each period (settling or evaluated), shape (periods, samples)."""
    begin, period = scan_begin(situation), scan_period(situation)
    return values[begin : begin + (unjudged + JUDGED_PERIODS) * period].reshape(-1, period)
