# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What runs are worth: the true displacement between the samples, against the undelayed and the delayed reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.analysis.metrics import chattering_figures
from hysteresis_ros.comparison.plants import DrawnPlant
from hysteresis_ros.comparison.tasks import Task
from hysteresis_ros.simulation.between_samples import INSTANTS

#: Delays that are tried, 0 … the longest one; between them a parabola finds the best.
DELAYS = 41
#: A loop that is stable settles into the period of its reference. What differs from one period to the next may be this
#: part of the reference, as RMS; the noise of a stable loop is far below.
LOST = 0.1
#: A limit cycle may lock to that period; then the limits hold it for so large a part of the time at least.
AT_LIMITS = 0.25
#: Instants at which they are tried first.
THIN = 4000


class Followed(NamedTuple):
    """A run of one task on one plant.

    Parameters
    ----------
    time : array, shape (N,)
        Judged instants [s].
    displacement : array, shape (N,)
        True one there [m].
    effort : float
        RMS rate of the voltage [V/s], as in :func:`hysteresis_ros.analysis.metrics.compute_metrics`.
    chattering : float
        ``chattering_m`` of the command [m rms], as there.
    saturated : float
        Part of the judged samples at a limit.
    unstable : bool
        Whether the plant tripped, did not do in one period what it did in the one before, or went from limit to limit.
    """

    time: np.ndarray
    displacement: np.ndarray
    effort: float
    chattering: float
    saturated: float
    unstable: bool

    def error(self, task: Task, delay: float) -> np.ndarray:
        """Return the error [m] against the reference, which is delayed by ``delay`` [s], shape (N,)."""
        return task.reference(self.time - delay) - self.displacement

    def mean_squares(self, task: Task, delays) -> np.ndarray:
        """Return the mean square of the error [m²] for each of the delays [s]."""
        return np.array([np.mean(self.error(task, delay) ** 2) for delay in delays])

    @property
    def thin(self) -> Followed:
        """The same run at fewer instants."""
        stride = max(len(self.time) // THIN, 1) | 1  # odd: all places within a sample
        return self._replace(time=self.time[::stride], displacement=self.displacement[::stride])


def followed(signals: dict[str, np.ndarray], plant: DrawnPlant, task: Task) -> Followed:
    """Look at a run between its samples.

    Parameters
    ----------
    signals : dict of str to array
        Of an :class:`~hysteresis_ros.loop.axis.Axis` that followed the task on this plant from rest.
    plant : DrawnPlant
    task : Task
    """
    sample_time = 1.0 / plant.sample_rate
    judged = signals["time"] >= task.settling - 0.5 * sample_time
    starts = signals["time"][judged][:, np.newaxis]
    time = starts + sample_time * np.arange(1, INSTANTS + 1) / INSTANTS
    displacement = plant.between(signals["plant_voltage"])[judged]
    sampled = signals["time"][judged], signals["reference"][judged], signals["command"][judged]
    smooth = chattering_figures(*sampled, signals["voltage"][judged])
    time, displacement = time.ravel(), displacement.ravel()
    later = time[time > time[0] + 1.0 / task.frequency]
    repeated = np.interp(later, time, displacement) - np.interp(later - 1.0 / task.frequency, time, displacement)
    lost = not np.std(repeated) < LOST * np.std(task.reference(time)) or signals["tripped"].any()
    saturated = float(np.mean(signals["saturated"][judged]))
    return Followed(
        time,
        displacement,
        smooth["voltage_rate_v_s"],
        smooth.get("chattering_m", 0.0),
        saturated,
        bool(lost or saturated > AT_LIMITS),
    )


@dataclass(frozen=True)
class Result:
    """One candidate on one task, over all plants.

    Parameters
    ----------
    rms, maximum : array, shape (plants,)
        RMS and largest error against the reference delayed by the row's own constant delay, as parts of the stroke.
    undelayed : array, shape (plants,)
        RMS error against the reference itself, as parts of the stroke.
    effort : array, shape (plants,)
        RMS rate of the voltage [V/s].
    chattering : array, shape (plants,)
        Of the command [m rms].
    saturated : float
        Part of the judged samples at a limit, the largest of the plants.
    unstable : int
        Plants that it made unstable.
    """

    rms: np.ndarray
    maximum: np.ndarray
    undelayed: np.ndarray
    effort: np.ndarray
    chattering: np.ndarray
    saturated: float
    unstable: int

    @property
    def worst(self) -> float:
        """RMS error on the worst plant, as a part of the stroke."""
        return float(np.max(self.rms))


def best_delay(runs: dict[Task, Sequence[Followed]], longest: float) -> float:
    """Return the constant delay [s] with which the score of the runs is least: one for all references and plants.

    Parameters
    ----------
    runs : dict of Task to sequence of Followed
        Of one candidate, on each of the plants.
    longest : float
        The longest one allowed [s].
    """
    delays = np.linspace(0.0, longest, DELAYS)
    coarse = {task: np.array([run.thin.mean_squares(task, delays) for run in found]) for task, found in runs.items()}
    best = min(max(int(np.argmin(_scores(coarse))), 1), DELAYS - 2)
    # the mean square of one run is a parabola close by; the largest of several, and its logarithm, are not
    around, fine = delays[best - 1 : best + 2], np.linspace(delays[best - 1], delays[best + 1], DELAYS)
    close = {
        task: np.array([_parabola(around, run.mean_squares(task, around), fine) for run in found])
        for task, found in runs.items()
    }
    return float(fine[np.argmin(_scores(close))])


def _scores(mean_squares: dict[Task, np.ndarray]) -> np.ndarray:
    """Return the logarithm of the score at each delay: that of the worst plant, summed over the references."""
    smallest = np.finfo(float).tiny
    return np.sum([np.log(np.maximum(np.max(values, axis=0), smallest)) for values in mean_squares.values()], axis=0)


def _parabola(places, values, fine) -> np.ndarray:
    """Return the parabola through three points at the places ``fine``."""
    middle = places[1]
    return np.polyval(np.polyfit(places - middle, values, 2), fine - middle)


def judged(runs: dict[Task, Sequence[Followed]], delay: float, stroke: float) -> dict[str, Result]:
    """Return the results of the runs of one candidate, by name of the task.

    Parameters
    ----------
    runs : dict of Task to sequence of Followed
        On each of the plants.
    delay : float
        The row's constant delay [s].
    stroke : float
        What errors are parts of [m].
    """
    found = {}
    for task, followed_ in runs.items():
        errors = [run.error(task, delay) / stroke for run in followed_]
        found[task.name] = Result(
            np.array([np.sqrt(np.mean(error**2)) for error in errors]),
            np.array([np.max(np.abs(error)) for error in errors]),
            np.array([np.sqrt(run.mean_squares(task, [0.0])[0]) / stroke for run in followed_]),
            np.array([run.effort for run in followed_]),
            np.array([run.chattering for run in followed_]),
            max(run.saturated for run in followed_),
            sum(run.unstable for run in followed_),
        )
    return found


def merged(results: Sequence[dict[str, Result]]) -> dict[str, Result]:
    """Return the results of one combination on several plants, each with what is around it, as those on all of them.

    Parameters
    ----------
    results : sequence of dict of str to Result
    """
    arrays = ("rms", "maximum", "undelayed", "effort", "chattering")
    found = {}
    for task in results[0]:
        each = [result[task] for result in results]
        joined = [np.concatenate([getattr(result, name) for result in each]) for name in arrays]
        found[task] = Result(*joined, max(one.saturated for one in each), sum(one.unstable for one in each))
    return found
