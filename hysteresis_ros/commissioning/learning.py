# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stage that learns: the scan again, with a correction that is learned from period to period."""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.analysis.pictures import Picture, line
from hysteresis_ros.commissioning.folder import LEARNING
from hysteresis_ros.commissioning.learned_periods import learned_line
from hysteresis_ros.commissioning.outcome import Outcome, verdict
from hysteresis_ros.commissioning.response import measured_plant
from hysteresis_ros.commissioning.scanning import (
    AS_PREDICTED,
    JUDGED,
    closed_axis,
    designed,
    root_mean_square,
    scan_begin,
    scan_period,
    scan_reference,
    scan_stroke,
)
from hysteresis_ros.commissioning.situation import Situation
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.design_certainty import response_uncertainty
from hysteresis_ros.simulation.learning_design import LearningRequest, design_learning, learning_file
from hysteresis_ros.simulation.run import simulate
from hysteresis_ros.units import readable

#: Periods of learning, fewer where they take longer than these seconds, and least.
LEARNED, LONGEST, LEAST = 30, 20.0, 10
#: How far the stage may be from the model that was identified from itself a minute ago (assumed).
CLOSE = Uncertainty(gain=0.02, hysteresis=0.05, resonance=0.005, delay=0.1, draws=20)
#: The design of the filters.
DESIGN = "inversion"


def periods(situation: Situation) -> int:
    """Return the periods of learning before those that are judged.

    Parameters
    ----------
    situation : Situation
    """
    return int(min(LEARNED, max(LONGEST * situation.plan.scan_frequency, LEAST)))


def learn_axis(situation: Situation) -> AxisParameters | Outcome:
    """Return the axis that learns the scan, and write its file; or why nothing can be learned.

    Parameters
    ----------
    situation : Situation
    """
    configuration, namespace = designed(situation), situation.axis.namespace
    # what another attempt has learned belongs to another loop
    (situation.folder.path / LEARNING).unlink(missing_ok=True)
    try:
        request = LearningRequest(DESIGN, period=scan_period(situation) / situation.rate, possible=CLOSE)
        known = measured_plant(situation) or response_uncertainty(configuration)
        result = design_learning(single_axis(configuration, namespace), request, known)
        text = learning_file(configuration, result, namespace)
    except HysteresisError as error:
        return Outcome([f"nothing is learned: {' '.join(str(error).split())}"])
    write_file(situation.folder.path / LEARNING, text)
    return _axis(situation, _learning(situation))


def _learning(situation: Situation) -> Configuration:
    return load_configuration(situation.folder.path / LEARNING)


def _axis(situation: Situation, configuration: Configuration) -> AxisParameters:
    reference = scan_reference(situation, configuration, periods(situation))
    return closed_axis(situation, configuration, "learn", reference)


def judge_learned(situation: Situation, recording: Recording) -> Outcome:
    """Judge the scan after so many periods of learning, beside its prediction and the scan without.

    Parameters
    ----------
    situation : Situation
    recording : Recording
    """
    configuration, count = _learning(situation), periods(situation)
    learning = single_axis(configuration, situation.axis.namespace).motion_controller.learning
    simulated = simulate(_axis(situation, configuration))
    runs = {"measured": _periods(situation, recording), "predicted": _periods(situation, simulated)}
    found, expected = (root_mean_square(errors[count:]) for errors in runs.values())
    # a folder of an earlier version has the scan's error against the delayed reference only
    before, ratio = situation.found["scan"].figures.get("undelayed_rms_m", math.nan), found / expected
    what = f"triangle of {readable(scan_stroke(situation), 'm')} at {situation.plan.scan_frequency:g} Hz"
    lines = [
        f"{what} after {count} periods: error {1e9 * found:.4g} nm RMS, {1e9 * before:.4g} nm without learning, "
        f"both against the undelayed reference; predicted {1e9 * expected:.4g} nm, ratio {ratio:.3g}: "
        f"{verdict(ratio, AS_PREDICTED)}",
        learned_line(learning, situation.rate, _signals(recording), scan_begin(situation), count),
    ]
    figures = {
        "rms_error_m": found,
        "undelayed_rms_without_m": before,
        "predicted_rms_m": expected,
        "ratio": ratio,
        "as_predicted": ratio <= AS_PREDICTED,
    }
    if recording.has("skipped"):
        kept = in_time(_by_period(situation, recording["skipped"]))[count:]
        undisturbed = root_mean_square(runs["measured"][count:][kept]) if np.any(kept) else math.nan
        lines.append(missed_line(undisturbed, kept))
    numbers = np.arange(1, count + JUDGED + 1)
    falling = [line(name, numbers, 1e9 * np.sqrt(np.mean(each**2, axis=1))) for name, each in runs.items()]
    time = np.arange(scan_period(situation)) / situation.rate
    last = [line(name, time, 1e9 * each[-1]) for name, each in runs.items()]
    pictures = [
        Picture("Error of each period", "period", "RMS error [nm]", falling, "y"),
        Picture("What learning leaves in a period", "time [s]", "reference − measured [nm]", last),
    ]
    return Outcome(lines, figures, pictures)


def in_time(skipped: np.ndarray) -> np.ndarray:
    """Tell which periods have no missed deadline, and do not follow one that has: the axis answers to it for a while.

    Parameters
    ----------
    skipped : ndarray, shape (periods, samples)
        1 at each sample whose time was missed.

    Returns
    -------
    ndarray of bool, shape (periods,)
    """
    late = np.any(skipped > 0.5, axis=1)
    return ~(late | np.concatenate([[False], late[:-1]]))


def missed_line(error: float, kept: np.ndarray) -> str:
    """Say what the error is in the periods that no missed deadline has disturbed.

    Parameters
    ----------
    error : float
        Of those periods [m]; NaN: there is none.
    kept : ndarray of bool, shape (periods,)
    """
    count = np.count_nonzero(kept)
    if not count:
        return f"deadlines were missed in or before each of the {len(kept)} periods: the machine limits the error"
    if count == len(kept):
        return "no deadline was missed"
    return f"deadlines were missed: in the {count} of {len(kept)} periods without, {1e9 * error:.4g} nm RMS"


def _signals(recording: Recording) -> dict[str, np.ndarray]:
    names = ("command", "applied", "measured", "skipped", "seen")
    return {name: recording[name] for name in names if recording.has(name)}


def _periods(situation: Situation, recording: Recording) -> np.ndarray:
    """Return the errors of all periods, shape (periods, samples) [m]: against the undelayed reference, as it learns."""
    offset = single_axis(_learning(situation), situation.axis.namespace).motion_controller.model.preload.offset
    return _by_period(situation, recording["reference"] - (recording["measured"] - offset))


def _by_period(situation: Situation, values: np.ndarray) -> np.ndarray:
    begin, period = scan_begin(situation), scan_period(situation)
    return values[begin : begin + (periods(situation) + JUDGED) * period].reshape(-1, period)
