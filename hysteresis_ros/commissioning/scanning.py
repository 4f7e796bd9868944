# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages with a closed loop: small steps first, then the scan that is judged, each beside its prediction."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.pictures import Picture, line
from hysteresis_ros.analysis.settings import delayed
from hysteresis_ros.commissioning.folder import COMMISSIONED
from hysteresis_ros.commissioning.measuring import MICRO
from hysteresis_ros.commissioning.outcome import CommissioningError, Outcome, verdict
from hysteresis_ros.commissioning.situation import OVERTRAVEL, Situation
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.ways import hold, way
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.driven_axis import following, write_samples
from hysteresis_ros.simulation.run import simulate
from hysteresis_ros.units import readable

#: Part of the stroke that is scanned by default, and the periods: those that are not judged, and those that are.
SCANNED, UNJUDGED, JUDGED = 0.7, 3, 10
#: Small steps in closed loop, as parts of the stroke, and the seconds each is held and its way lasts. They begin above
#: the end of the stroke: what the past left of it cannot be reached.
FIRST, STEPS, STEP_HOLD, STEP_WAY = 0.1, (0.2, 0.3, 0.2), 0.5, 0.05
#: Part of a hold at whose end it is judged.
JUDGED_PART = 0.2
#: What is left at the end of a small step may be so many times what was predicted, and this part of the step.
LEFT, RINGING = 6.0, 0.05
#: An error may be so many times the predicted one.
AS_PREDICTED = 1.5


def scan_stroke(situation: Situation) -> float:
    """Return the displacement of the scan from peak to peak [m].

    Parameters
    ----------
    situation : Situation
    """
    return situation.plan.scan_stroke or SCANNED * situation.figure("hysteresis", "stroke_m")


def scan_period(situation: Situation) -> int:
    """Return the samples of a triangle of the scan.

    Parameters
    ----------
    situation : Situation
    """
    return max(round(situation.rate / situation.plan.scan_frequency), 4)


def _reach(situation: Situation, configuration: Configuration) -> tuple[float, float]:
    values = configuration.node("reference_generator", situation.axis.namespace)
    return values["minimum"], values["maximum"]


def scan_reference(situation: Situation, configuration: Configuration, unjudged: int = UNJUDGED) -> np.ndarray:
    """Return the scan [m]: the way to its low end, triangles, and the way back to rest.

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
        Of the designed axis.
    unjudged : int
        Triangles before those that are judged.

    Raises
    ------
    CommissioningError
        The stage does not reach as far.
    """
    low, high = _reach(situation, configuration)
    size, rate = scan_stroke(situation), situation.rate
    if size > high - low:
        raise CommissioningError(
            f"a scan of {readable(size, 'm')} was asked for, the stage reaches {readable(high - low, 'm')}; lower "
            "scan_stroke in /commissioning"
        )
    begin = 0.5 * (low + high - size)
    period = scan_period(situation)
    phase = np.arange(1, (unjudged + JUDGED) * period + 1) / period
    triangle = begin + size * 2.0 * np.abs(phase - np.round(phase))
    rest = _rest(low, high)
    parts = [hold(rest, STEP_HOLD, rate), way(rest, begin, STEP_HOLD, rate), hold(begin, STEP_HOLD, rate), triangle]
    return np.concatenate([*parts, way(begin, rest, STEP_HOLD, rate), hold(rest, STEP_HOLD, rate)])


def _rest(low: float, high: float) -> float:
    """Return the reference [m] at which an axis begins and ends."""
    return min(max(0.0, low), high)


def steps_reference(situation: Situation, configuration: Configuration) -> np.ndarray:
    """Return small steps in closed loop [m].

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
        Of the designed axis.
    """
    low, high = _reach(situation, configuration)
    rest, rate = _rest(low, high), situation.rate
    far = high if high - rest >= rest - low else low
    place = rest + FIRST * (far - rest)
    parts = [hold(rest, STEP_HOLD, rate), way(rest, place, STEP_HOLD, rate), hold(place, STEP_HOLD, rate)]
    for part in STEPS:
        target = rest + part * (far - rest)
        parts += [way(place, target, STEP_WAY, rate), hold(target, STEP_HOLD, rate)]
        place = target
    return np.concatenate([*parts, way(place, rest, STEP_HOLD, rate), hold(rest, STEP_HOLD, rate)])


def closed_axis(
    situation: Situation, configuration: Configuration, stage: str, reference: np.ndarray
) -> AxisParameters:
    """Return the designed axis that follows a reference once.

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
    stage : str
    reference : ndarray, shape (N,)
        [m]
    """
    path = write_samples(situation.folder.path / "waveforms" / f"{stage}.npz", reference, situation.rate)
    configuration = following(configuration, path)
    if situation.has_device:
        configuration = configuration.override("plant_simulator", overtravel=OVERTRAVEL * situation.plan.stroke)
    axis = single_axis(configuration, situation.axis.namespace)
    return axis.with_duration(reference.size / situation.rate)


def predicted_scan(situation: Situation, configuration: Configuration) -> Recording:
    """Return the scan as ``hysteresis simulate`` of the file has it.

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
        Of the designed axis.
    """
    return simulate(closed_axis(situation, configuration, "scan", scan_reference(situation, configuration)))


def error_of(configuration: Configuration, namespace: str, recording: Recording) -> np.ndarray:
    """Return reference less measurement [m], the reference as late as its preview, the sensor's zero taken off.

    Parameters
    ----------
    configuration : Configuration
        Of the axis.
    namespace : str
    recording : Recording
    """
    controller = single_axis(configuration, namespace).motion_controller
    wanted = delayed(recording["reference"], controller.feedforward.preview)
    return wanted - (recording["measured"] - controller.model.preload.offset)


def judged_samples(situation: Situation, configuration: Configuration) -> slice:
    """Return the samples of the scan that are judged: the last periods, as late as the preview.

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
        Of the designed axis.
    """
    period = scan_period(situation)
    begin = scan_begin(situation) + UNJUDGED * period
    preview = single_axis(configuration, situation.axis.namespace).motion_controller.feedforward.preview
    return slice(begin + preview, begin + JUDGED * period)


def scan_begin(situation: Situation) -> int:
    """Return the sample at which the first triangle begins.

    Parameters
    ----------
    situation : Situation
    """
    return 3 * max(round(STEP_HOLD * situation.rate), 1)


def scan_error(situation: Situation, configuration: Configuration, recording: Recording) -> float:
    """Return the RMS error [m] of the periods that are judged.

    Parameters
    ----------
    situation : Situation
    configuration : Configuration
        Of the designed axis.
    recording : Recording
    """
    error = error_of(configuration, situation.axis.namespace, recording)
    return root_mean_square(error[judged_samples(situation, configuration)])


def root_mean_square(error: np.ndarray) -> float:
    """Return the RMS of an error [m].

    Parameters
    ----------
    error : ndarray, shape (N,)
        [m]
    """
    return float(np.sqrt(np.mean(error**2)))


def designed(situation: Situation) -> Configuration:
    """Return the configuration of the designed axis.

    Parameters
    ----------
    situation : Situation
    """
    situation.figure("design", "predicted_rms_m")
    return load_configuration(situation.folder.path / COMMISSIONED)


def loop_axis(situation: Situation) -> AxisParameters:
    """Return the axis of the small steps in closed loop.

    Parameters
    ----------
    situation : Situation
    """
    configuration = designed(situation)
    return closed_axis(situation, configuration, "loop", steps_reference(situation, configuration))


def judge_loop(situation: Situation, recording: Recording) -> Outcome:
    """Judge small steps: whether the loop comes to rest, as the simulation does.

    Parameters
    ----------
    situation : Situation
    recording : Recording

    Raises
    ------
    CommissioningError
        It rings, or stays away.
    """
    configuration, namespace = designed(situation), situation.axis.namespace
    error = error_of(configuration, namespace, recording)
    expected = error_of(configuration, namespace, simulate(loop_axis(situation)))
    rate, size = situation.rate, (STEPS[0] - FIRST) * np.ptp(_reach(situation, configuration))
    held = round(STEP_HOLD * rate)
    stops = [3 * held + (number + 1) * (held + round(STEP_WAY * rate)) for number in range(len(STEPS))]
    ends = [slice(stop - round(JUDGED_PART * held), stop) for stop in stops]
    left = max(float(np.sqrt(np.mean(error[end] ** 2))) for end in ends)
    right = max(float(np.sqrt(np.mean(expected[end] ** 2))) for end in ends)
    if left > max(LEFT * right, RINGING * size):
        raise CommissioningError(
            f"the closed loop does not come to rest: {1e9 * left:.3g} nm RMS are left after a step of "
            f"{readable(size, 'm')}, {1e9 * right:.3g} nm in the simulation; it rings or drifts. Outputs are safe. "
            "Resume with another --controller, or measure the resonance again (--stage resonance)"
        )
    time = recording.time - recording.time[0]
    traces = [
        line("reference", time, MICRO * recording["reference"]),
        line("measured", time, MICRO * (recording["reference"] - error)),
    ]
    lines = [f"comes to rest: {1e9 * left:.3g} nm RMS are left, {1e9 * right:.3g} nm predicted"]
    picture = Picture("Small steps in closed loop", "time [s]", "displacement [µm]", traces)
    return Outcome(lines, {"rest_rms_m": left, "predicted_rest_rms_m": right}, [picture])


def scan_axis(situation: Situation) -> AxisParameters:
    """Return the axis of the scan.

    Parameters
    ----------
    situation : Situation
    """
    configuration = designed(situation)
    return closed_axis(situation, configuration, "scan", scan_reference(situation, configuration))


def judge_scan(situation: Situation, recording: Recording) -> Outcome:
    """Judge the scan beside its prediction.

    Parameters
    ----------
    situation : Situation
    recording : Recording
    """
    configuration, namespace = designed(situation), situation.axis.namespace
    simulated = predicted_scan(situation, configuration)
    found, expected = (scan_error(situation, configuration, run) for run in (recording, simulated))
    ratio = found / expected
    what = f"triangle of {readable(scan_stroke(situation), 'm')} at {situation.plan.scan_frequency:g} Hz"
    lines = [
        f"{what}: error {1e9 * found:.4g} nm RMS, predicted {1e9 * expected:.4g} nm, ratio {ratio:.3g}: "
        f"{verdict(ratio, AS_PREDICTED)}"
    ]
    judged = judged_samples(situation, configuration)
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
        Picture("Its error, in the periods that are judged", "time [s]", "reference − measured [nm]", errors),
    ]
    undelayed = recording["reference"] - (recording["measured"] - preload_offset(configuration, namespace))
    figures = {
        "rms_error_m": found,
        "undelayed_rms_m": root_mean_square(undelayed[judged]),
        "predicted_rms_m": expected,
        "ratio": ratio,
        "as_predicted": ratio <= AS_PREDICTED,
    }
    return Outcome(lines, figures, pictures)


def preload_offset(configuration: Configuration, namespace: str) -> float:
    """Return what the preload adds to the measurement [m].

    Parameters
    ----------
    configuration : Configuration
        Of the designed axis.
    namespace : str
    """
    return float(single_axis(configuration, namespace).motion_controller.model.preload.offset)
