# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a run of a sweep is worth: the figures of merit of every report, its errors judged between the samples too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hysteresis_ros.analysis.metrics import FIGURES, TIMELINESS, absolute_integral, compute_metrics, error_figures
from hysteresis_ros.analysis.settings import AxisSettings, delayed
from hysteresis_ros.analysis.steps import JUMP, scan_start
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.plants import ActuatorPlant
from hysteresis_ros.loop.source import SequencerSource
from hysteresis_ros.models.actuator import Actuator
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.between_samples import INSTANTS, PLACES, displacement_between
from hysteresis_ros.sweeps.motors import MOTOR_METRICS, judged_motor

#: Figures of clocks, which a simulated run has not.
_OF_CLOCKS = {"rate_hz", "jitter_p99_s", "missing_samples", *(name for name, *_ in TIMELINESS)}
#: What may be asked of a run of an actuator: name → label, unit for people, factor from SI; the first one by default.
ACTUATOR_METRICS: dict[str, tuple[str, str, float]] = {
    name: (label, unit, factor) for name, label, unit, factor in FIGURES if name not in _OF_CLOCKS
}
#: The same of any axis.
METRICS = MOTOR_METRICS | ACTUATOR_METRICS
#: Judged between the samples, at :data:`INSTANTS` instants of each.
BETWEEN = (
    *("rms_error_m", "max_error_m", "iae_m_s", "rms_error_percent_of_stroke", "max_error_percent_of_stroke"),
    "stroke_m",
)


def require_metrics(names: Sequence[str], axis: AxisParameters | None = None) -> tuple[str, ...]:
    """Return the names of metrics, each once.

    Parameters
    ----------
    names : sequence of str
        None at all: the metric that an axis is judged by otherwise.
    axis : AxisParameters, optional
        Whose metrics they are to be.

    Raises
    ------
    ConfigurationError
        There is no such metric, or the axis has none.
    """
    known, whose = METRICS, ""
    if axis is not None and axis.inchworm_sequencer is not None:
        known, whose = MOTOR_METRICS, " of an inchworm motor"
    elif axis is not None:
        known, whose = ACTUATOR_METRICS, " of an actuator"
    for name in names:
        if name not in known:
            near = did_you_mean(name, known)
            text = f"there is no such metric{whose}; there are {', '.join(known)}{near}"
            raise ConfigurationError(f"--metric {name}: {text}")
    return tuple(dict.fromkeys(names or [next(iter(known))]))


def judged(axis: Axis, signals: dict[str, np.ndarray], names: Sequence[str]) -> list[float]:
    """Return metrics of a run that has just been made; NaN where one has no meaning.

    Errors are those of the true displacement between the samples, less the preload of the controller's model, against
    the reference as late as its preview. That goes in straight lines from sample to sample, but where it jumps.
    All else is defined at the samples (:func:`~hysteresis_ros.analysis.metrics.compute_metrics`), as are the errors of
    a plant that is seen by a camera, and whatever is asked of an inchworm motor
    (:func:`~hysteresis_ros.sweeps.motors.judged_motor`).

    Parameters
    ----------
    axis : Axis
        Its plant is put to rest again.
    signals : dict of str to array
        What it has done.
    names : sequence of str
        Of its kind of axis.
    """
    if isinstance(axis.source, SequencerSource):
        return judged_motor(signals, axis.source.sequencer.parameters, names)
    control = axis.parameters.motion_controller
    settings = AxisSettings(offset=control.model.preload.offset, preview=control.feedforward.preview)
    figures: dict = {}
    dense = type(axis.plant) is ActuatorPlant and len(signals["time"]) > 1
    if isinstance(axis.plant, ActuatorPlant) and dense:
        figures |= _between_samples(axis.plant.actuator, signals, settings, "iae_m_s" in names)
    if not dense or any(name not in BETWEEN for name in names):
        run = Recording(signals["time"], {name: signals[name] for name in signals if name != "time"}, {}, {})
        figures = {**compute_metrics(run, settings, parts=False), **figures}
    values = (figures.get(name) for name in names)
    return [float("nan") if value is None else float(value) for value in values]


def _between_samples(
    actuator: Actuator, signals: dict[str, np.ndarray], settings: AxisSettings, integral: bool
) -> dict[str, float]:
    """Return the figures of the error at :data:`INSTANTS` instants of each sample but the last one.

    Its integral, which takes a good part of the time of a short run, is made only where it is asked for.
    """
    reference = delayed(signals["reference"], settings.preview)
    sample_time = actuator.dynamics.sample_time
    stroke, step = float(np.ptp(reference)), np.diff(reference)
    first = scan_start(reference, signals["displacement"] - settings.offset)
    actuator.reset()
    displacement = displacement_between(actuator, signals["plant_voltage"])[first:-1]
    offset = actuator.parameters.preload.offset - settings.offset
    wanted = reference[first:-1, np.newaxis] + _unless_it_jumps(step, stroke)[first:, np.newaxis] * PLACES
    wanted[:, -1] = reference[first + 1 :]
    wanted -= displacement
    error = wanted.ravel() - offset
    figures = {**error_figures(error, stroke), "stroke_m": stroke}
    if integral:
        figures["iae_m_s"] = absolute_integral(sample_time / INSTANTS * np.arange(error.size), error)
    return figures


def _unless_it_jumps(step: np.ndarray, stroke: float) -> np.ndarray:
    """Return how far the reference goes within each sample: as far as to the next, but nowhere before a jump."""
    around = np.concatenate([[0.0], np.abs(step), [0.0]])
    before, size, after = around[:-2], around[1:-1], around[2:]
    return np.where(size - np.maximum(before, after) > JUMP * stroke, 0.0, step)
