# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A run of a sweep with its metrics, and jobs of several runs that any process can execute."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hysteresis_ros
from hysteresis_ros.analysis.inchworm import COMMON_FIGURES, MOVE_FIGURES, RUN_FIGURES, figures_of, inchworm_run
from hysteresis_ros.analysis.metrics import (
    FIGURES,
    TIMELINESS,
    AxisSettings,
    absolute_integral,
    compute_metrics,
    delayed,
    error_figures,
    reference_delay,
)
from hysteresis_ros.analysis.parts import JUMP, scan_start
from hysteresis_ros.errors import ConfigurationError, HysteresisError, did_you_mean
from hysteresis_ros.laboratory.between_samples import INSTANTS, PLACES, displacement_between
from hysteresis_ros.laboratory.sweeps.plan import PLANT, Variation, varied
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import ActuatorPlant
from hysteresis_ros.loop.reach import check_reach
from hysteresis_ros.loop.source import SequencerSource
from hysteresis_ros.models.actuator import Actuator
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters

#: Metric: number of moves that did not arrive.
NOT_ARRIVED = "not_arrived"
#: Figures of moves: function that selects the move to report, and label.
_WORST: dict[str, tuple[Callable, str]] = {
    "final_error_rms_m": (max, "Final error, worst move"),
    "final_error_max_m": (max, "Final error, largest, worst move"),
    "time_s": (max, "Time, longest move"),
    "overshoot_m": (max, "Overshoot, worst move"),
    "walking_speed_m_s": (min, "Speed of walking, slowest move"),
}
#: Figures that are undefined for a motor that did not arrive.
_OF_ARRIVALS = ("final_error_rms_m", "final_error_max_m", "time_s")
#: Figures that follow from the configuration alone.
_OF_GAITS = ("gait_speed_m_s", "stroke_m", "period_s", "clamp_threshold_v")
_OF_RUNS = tuple(row for row in RUN_FIGURES if row[0] not in _OF_GAITS)
_COMMON = tuple(row for row in COMMON_FIGURES if row[0].startswith(("chattering", "command", "voltage")))

#: Metrics of a motor: name → label, displayed unit, factor from SI; the first one is the default.
MOTOR_METRICS: dict[str, tuple[str, str, float]] = {
    **{
        name: (label, unit, factor)
        for name, (_, label) in _WORST.items()
        for row, _, unit, factor in MOVE_FIGURES
        if row == name
    },
    NOT_ARRIVED: ("Moves that did not arrive", "", 1.0),
    **{name: (label, unit, factor) for name, label, unit, factor in (*_OF_RUNS, *_COMMON)},
}


def judged_motor(
    signals: dict[str, np.ndarray], settings: InchwormSequencerParameters, names: Sequence[str]
) -> list[float]:
    """Return metrics of a run of an inchworm motor; an undefined metric is NaN.

    All metrics are defined by :func:`~hysteresis_ros.analysis.inchworm.inchworm_figures`; a metric of moves has the
    value of the worst move to a setpoint. If a move did not arrive, the time and the final errors are undefined.
    """
    recording = Recording(signals["time"], {name: signals[name] for name in signals if name != "time"}, {}, {})
    found = figures_of(inchworm_run(recording, settings), recording)
    moves = [move for move in found["moves"] if move["setpoint_m"] is not None]
    missed = sum(move["outcome"] != "arrived" for move in moves)
    figures = {**found, **found["run"], NOT_ARRIVED: missed}
    for name, (worst, _) in _WORST.items():
        known = [move[name] for move in moves if move[name] is not None]
        figures[name] = None if not known or missed and name in _OF_ARRIVALS else worst(known)
    values = (figures[name] for name in names)
    return [float("nan") if value is None else float(value) for value in values]


#: Figures of clocks, which a simulated run does not have.
_OF_CLOCKS = {"rate_hz", "jitter_p99_s", "missing_samples", *(name for name, *_ in TIMELINESS)}
#: Metrics of an actuator: name → label, displayed unit, factor from SI; the first one is the default.
ACTUATOR_METRICS: dict[str, tuple[str, str, float]] = {
    name: (label, unit, factor) for name, label, unit, factor in FIGURES if name not in _OF_CLOCKS
}
#: Metrics of any axis.
METRICS = MOTOR_METRICS | ACTUATOR_METRICS
#: Metrics that are evaluated also between the samples, at :data:`INSTANTS` points per sample.
BETWEEN = (
    *("rms_error_m", "max_error_m", "iae_m_s", "rms_error_percent_of_stroke", "max_error_percent_of_stroke"),
    "stroke_m",
)


def require_metrics(names: Sequence[str], axis: AxisParameters | None = None) -> tuple[str, ...]:
    """Return the names of metrics, each once; without an axis, the metrics of every kind of axis are known."""
    known, whose = METRICS, ""
    if axis is not None and axis.inchworm_sequencer is not None:
        known, whose = MOTOR_METRICS, " of an inchworm motor"
    elif axis is not None:
        known, whose = ACTUATOR_METRICS, " of an actuator"
    for name in names:
        if name not in known:
            near = did_you_mean(name, known)
            text = f"unknown metric{whose}; there are {', '.join(known)}{near}"
            raise ConfigurationError(f"--metric {name}: {text}")
    return tuple(dict.fromkeys(names or [next(iter(known))]))


def judged(axis: Axis, signals: dict[str, np.ndarray], names: Sequence[str]) -> list[float]:
    """Return metrics of a run; an undefined metric is NaN.

    An error is the reference minus the true displacement, also between the samples. The preload
    offset of the controller's model is subtracted from the displacement. The reference is delayed by its preview,
    unless the controller learns; it is linear between samples, except at jumps. Unlike in a report, errors include the
    time after the plant stopped the axis, so that all runs are evaluated over the same time. The other metrics, the
    errors of a plant with a camera and all metrics of an inchworm motor are defined at the samples
    (:func:`~hysteresis_ros.analysis.metrics.compute_metrics`,
    :func:`~hysteresis_ros.laboratory.sweeps.study.judged_motor`).
    """
    if isinstance(axis.source, SequencerSource):
        return judged_motor(signals, axis.source.sequencer.parameters, names)
    control = axis.parameters.motion_controller
    late = reference_delay(control.feedforward.preview, control.learning.type)
    settings = AxisSettings(offset=control.model.preload.offset, preview=late)
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
    """Return the figures of the error at :data:`INSTANTS` instants of each sample except the last.

    The integral is computed only on request, because it takes a large part of the computing time of a short run.
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
    """Return the change of the reference from each sample to the next; 0 where the reference jumps."""
    around = np.concatenate([[0.0], np.abs(step), [0.0]])
    before, size, after = around[:-2], around[1:-1], around[2:]
    return np.where(size - np.maximum(before, after) > JUMP * stroke, 0.0, step)


#: Lock for compilation and Python code: only one thread of a worker runs them at a time.
_ONE_AT_A_TIME = threading.Lock()
#: A block of this size [bytes] is allocated and freed before the runs. The C library of Linux then keeps memory that a
#: run frees; otherwise the system would map every page of the tables again for the next run, 440 pages per run.
KEPT = 31 * 2**20


class Runs(NamedTuple):
    """Results of consecutive runs."""

    first: int  #: Number of the first run.
    rows: list[list[float]]  #: Metrics of each run, and whether the axis tripped in it.
    refused: dict[int, str]  #: Numbers of the runs for which the axis cannot be built, with reasons.


@dataclass(frozen=True, eq=False)
class Study:
    """Definition of the runs of a sweep."""

    axis: AxisParameters  #: As configured.
    variations: tuple[Variation, ...]
    metrics: tuple[str, ...]
    version: str = hysteresis_ros.__version__  #: Version of the package for the runs.

    @property
    def samples(self) -> int:
        """Configured number of samples of a run; 0: endless."""
        return Axis(self.axis).default_samples()

    @functools.cached_property
    def _of_plant(self) -> bool:
        """Whether only the plant varies; the expected range of the axis then stays the same."""
        return all(one.node == PLANT for one in self.variations)

    def runs(self, first: int, points: np.ndarray) -> Runs:
        """Execute some runs, each from rest."""
        if self.version != hysteresis_ros.__version__:
            raise ConfigurationError(
                f"version {hysteresis_ros.__version__} of the package is installed on the worker, but the "
                f"sweep needs {self.version}: install the same version"
            )
        np.empty(KEPT, dtype=np.uint8)
        found = Runs(first, [], {})
        build = self._builder()
        for number, point in enumerate(points, first):
            row, why = self._run(point, build)
            found.rows.append(row)
            if why:
                found.refused[number] = why
        return found

    def _builder(self) -> Callable[[AxisParameters], Axis]:
        """Return the function that builds the axis of a run; if only the plant varies, the rest is built once."""
        if not self._of_plant or self.axis.displacement_camera is not None:
            return Axis
        kept = Axis(self.axis)
        arrays = list(_leaves((kept.source.arrays, kept.controller.arrays, kept.compensator.arrays)))
        beginning = [array.copy() for array in arrays]

        def build(parameters: AxisParameters) -> Axis:
            for array, begun in zip(arrays, beginning, strict=True):
                array[:] = begun
            return kept.with_plant(parameters)

        return build

    def _run(self, point: np.ndarray, build: Callable[[AxisParameters], Axis]) -> tuple[list[float], str]:
        """Return the metrics of a run and whether it tripped, or the reason why it cannot be executed."""
        try:
            parameters = varied(self.axis, self.variations, point)
            if not self._of_plant:
                check_reach(parameters)
            axis = build(parameters)
            samples = axis.default_samples()
            if samples < 1:
                raise ConfigurationError("the run has no end (samples: 0, endless waveform)")
        except HysteresisError as error:
            return [float("nan")] * (len(self.metrics) + 1), str(error)
        with np.errstate(all="ignore"):  # an unstable loop may overflow
            signals = axis.run(axis.default_setpoints(samples))
            return [*judged(axis, signals, self.metrics), float(np.any(signals["tripped"] != 0.0))], ""


def _leaves(arrays: tuple | np.ndarray) -> Iterator[np.ndarray]:
    """Yield every array of nested tuples of arrays."""
    if isinstance(arrays, tuple):
        for part in arrays:
            yield from _leaves(part)
    else:
        yield arrays


def make_runs(study: Study, first: int, points: np.ndarray) -> Runs:
    """Execute some runs of a study, one after the other, in any thread of any process."""
    with _ONE_AT_A_TIME:
        return study.runs(first, points)
