# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Conditions, references and plants of the comparison, and evaluation of the runs.

No design has access to the plants, see :mod:`hysteresis_ros.laboratory.comparison.candidates`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros.analysis.metrics import chattering_figures
from hysteresis_ros.arguments import Hertz, Metres, Share, check_fields
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.laboratory.between_samples import INSTANTS, displacement_between
from hysteresis_ros.laboratory.foreign import Foreign, ForeignParameters
from hysteresis_ros.loop.parameters import PlantNodeParameters, part
from hysteresis_ros.loop.plant import ActuatorPlant
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.linear import LinearParameters

#: Minimum time [s] and number of periods before the first evaluated sample, in which creep and start-up effects decay.
SETTLING = 2.0
SETTLING_PERIODS = 2
#: Minimum number of periods before the first evaluated sample of a controller with learning.
LEARNING_PERIODS = 10
#: Evaluated time [s], and minimum number of evaluated periods.
JUDGED = 4.0
JUDGED_PERIODS = 4
#: Longest constant delay of the displacement that is not counted as an error, as a fraction of the shortest period.
ALLOWED_DELAY = 0.1


@dataclass(frozen=True)
class Conditions:
    """Conditions of all runs."""

    mismatch: Share = 0.05  #: Largest relative deviation of each parameter of the plants.
    noise: Metres = 5e-9  #: Sensor noise [m rms].
    bits: int = 16  #: Resolution of the converter; 0: unlimited.
    draws: int = 20  #: Number of random plants close to the configured plant.
    others: int = 4  #: Number of plants of other classes.
    seed: int = 1  #: Seed of the first plant; the next plants have the following seeds.
    #: Whether sliding mode controllers are designed for the worst plants within the mismatch, with and without another
    #: sample of delay.
    robust: bool = False
    sine_frequency: Hertz = 1.0  #: sine_frequency, triangle_frequency: Frequencies of the two references [Hz].
    triangle_frequency: Hertz = 10.0
    sine_stroke: float = 0.9  #: sine_stroke, triangle_stroke: Peak-to-peak references, as fractions of the stroke.
    triangle_stroke: float = 0.2

    def __post_init__(self):
        """Refuse impossible conditions."""
        check_fields(self)
        allowed = {
            "mismatch": (0.0 <= self.mismatch <= 0.5, "must be within 0 … 0.5"),
            "noise": (0.0 <= self.noise < 1.0, "must be within 0 … 1 m, 1 excluded"),
            "bits": (0 <= self.bits <= 32, "must be within 0 … 32 (0: unlimited)"),
            "draws": (0 <= self.draws <= 10000, "must be within 0 … 10000 (0: none)"),
            "others": (0 <= self.others <= 1000, "must be within 0 … 1000 (0: none)"),
            "seed": (self.seed >= 0, "must be 0 or more"),
            "sine": (0.0 < self.sine_frequency < np.inf, "must be a frequency in Hz above 0"),
            "triangle": (0.0 < self.triangle_frequency < np.inf, "must be a frequency in Hz above 0"),
        }
        values = {"sine": self.sine_frequency, "triangle": self.triangle_frequency}
        problems = [
            Problem(name, values.get(name, getattr(self, name, None)), text)
            for name, (good, text) in allowed.items()
            if not good
        ]
        if problems:
            raise ParameterError(problems)

    @property
    def longest_delay(self) -> float:
        """Longest constant delay in the evaluation of a row [s]."""
        return ALLOWED_DELAY / max(self.sine_frequency, self.triangle_frequency)

    def require_slow(self, sample_rate: float) -> None:
        """Refuse references that are too fast for the sample rate.

        Units: ``sample_rate`` [Hz].
        """
        for name in ("sine", "triangle"):
            frequency = getattr(self, f"{name}_frequency")
            if frequency > 0.1 * sample_rate:
                remedy = f"must be at most a tenth of the sample rate, {0.1 * sample_rate:g} Hz"
                raise ParameterError([Problem(name, frequency, remedy)])


@dataclass(frozen=True)
class Task:
    """A reference that the candidates follow."""

    name: str  #: Description of the reference, which also names its column.
    waveform: str  #: ``sine`` or ``triangle``.
    frequency: float  #: [Hz]
    low: float  #: low, high: Ends [m].
    high: float
    periods: int = SETTLING_PERIODS  #: Least number of periods before the first evaluated sample.

    @property
    def settling(self) -> float:
        """Time before the evaluation [s], in whole periods."""
        return np.ceil(max(SETTLING * self.frequency, self.periods)) / self.frequency

    @property
    def duration(self) -> float:
        """Length of a run [s], in whole periods."""
        return self.settling + np.ceil(max(JUDGED * self.frequency, JUDGED_PERIODS)) / self.frequency

    def overrides(self) -> dict:
        """Return the parameters of the reference generator; both references begin at the setpoint, their lower end."""
        half = 0.5 * (self.high - self.low)
        values = {
            "minimum": min(self.low, 0.0) - half,
            "maximum": self.high + half,
            "initial_setpoint": self.low,
            "waveform.type": self.waveform,
            "waveform.frequency": self.frequency,
            "waveform.cycles": 0,
        }
        if self.waveform == "sine":
            return {**values, "waveform.amplitude": half, "waveform.offset": half, "waveform.phase": -0.5 * np.pi}
        return {**values, "waveform.amplitude": 2.0 * half, "waveform.offset": 0.0}

    def reference(self, time) -> np.ndarray:
        """Return the reference [m] at any times, also between the samples.

        Units: ``time`` [s].
        """
        turns = self.frequency * np.asarray(time)
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        if self.waveform == "sine":
            return middle - half * np.cos(2.0 * np.pi * turns)
        return self.high - 2.0 * half * np.abs(1.0 - 2.0 * (turns - np.floor(turns)))


def make_tasks(conditions: Conditions, reach: tuple[float, float]) -> tuple[Task, ...]:
    """Return the two references within a range of displacements.

    Units: ``reach`` [m].
    """
    low, high = reach
    middle, stroke = 0.5 * (low + high), high - low

    def task(words, waveform, frequency, fraction):
        half = 0.5 * fraction * stroke
        name = f"{frequency:g} Hz {words}, {100.0 * fraction:g} % of stroke"
        return Task(name, waveform, frequency, middle - half, middle + half)

    return (
        task("sine", "sine", conditions.sine_frequency, conditions.sine_stroke),
        task("triangle", "triangle", conditions.triangle_frequency, conditions.triangle_stroke),
    )


class DrawnPlant(ABC):
    """A plant drawn at random."""

    @property
    @abstractmethod
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""

    @abstractmethod
    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""

    @abstractmethod
    def later(self) -> DrawnPlant:
        """Return the plant with one more sample of delay."""

    @abstractmethod
    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest, shape (N, INSTANTS).

        Units: ``voltage`` [V].
        """


@dataclass(frozen=True)
class ModelledPlant(DrawnPlant):
    """A plant of a class that parameter files can describe."""

    parameters: PlantNodeParameters  #: Parameters of type actuator.

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""
        return ActuatorPlant(self.parameters)

    def later(self) -> ModelledPlant:
        """Return the plant with one more sample of delay."""
        sample_time, dynamics = 1.0 / self.sample_rate, self.parameters.dynamics
        dynamics = replace(dynamics, delay=dynamics.delay + sample_time, sample_time=sample_time)
        return ModelledPlant(replace(self.parameters, dynamics=dynamics))

    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest without the preload offset, shape (N, INSTANTS)."""
        return displacement_between(
            Actuator(part(self.parameters, ActuatorParameters), 1.0 / self.sample_rate), voltage
        )


@dataclass(frozen=True)
class ForeignPlant(DrawnPlant):
    """A plant of another class than any model, with the limits and the sensor of a modelled plant."""

    parameters: PlantNodeParameters  #: Limits, sensor and sample rate; other parameters are not used.
    actuator: ForeignParameters

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""
        return _ForeignInLoop(replace(self.parameters, overtravel=-1.0), self.actuator)

    def later(self) -> ForeignPlant:
        """Return the plant with one more sample of delay."""
        return replace(self, actuator=replace(self.actuator, delay=self.actuator.delay + 1.0 / self.sample_rate))

    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest, shape (N, INSTANTS)."""
        return Foreign(replace(self.actuator, steps=INSTANTS), 1.0 / self.sample_rate).between(voltage)


class _ForeignInLoop(ActuatorPlant):
    """An actuator with hysteresis, creep and dynamics of another class, in one block."""

    def __init__(self, parameters: PlantNodeParameters, actuator: ForeignParameters):
        # the block below contains creep and dynamics; those in the file are only models
        super().__init__(replace(parameters, creep=CreepParameters(), dynamics=LinearParameters()))
        block: Any = Foreign(actuator, 1.0 / parameters.sample_rate)  # instead of a hysteresis
        chain = self.actuator
        chain.hysteresis, chain.hysteresis_kernel = block, block.kernel
        chain.ps, chain.xs = chain.ps._replace(hysteresis=block.p), chain.xs._replace(hysteresis=block.x)
        chain.reset()
        self.arrays = self.arrays._replace(p=chain.ps, x=chain.xs)


#: Number of tried delays from 0 to the longest; a parabola interpolates around the best one.
DELAYS = 41
#: Largest RMS difference between two consecutive periods of a stable loop, as a fraction of the reference's standard
#: deviation. A stable loop becomes periodic, and its noise is far smaller.
LOST = 0.1
#: A limit cycle may lock to the period of the reference; it is detected when the voltage is at its limits for at least
#: this fraction of the time.
AT_LIMITS = 0.25
#: Approximate number of points per run in the first search for the delay.
THIN = 4000


class Followed(NamedTuple):
    """A run of one task on one plant."""

    time: np.ndarray  #: shape (N,); Evaluated times [s].
    displacement: np.ndarray  #: shape (N,); True displacement [m].
    effort: float  #: RMS rate of the voltage [V/s], as in :func:`hysteresis_ros.analysis.metrics.compute_metrics`.
    chattering: float  #: Chattering of the command [m rms], ``chattering_m`` of the same function.
    saturated: float  #: Fraction of the evaluated samples at which the voltage is at a limit.
    #: Whether the plant tripped, its motion was not periodic, or the voltage alternated between the limits.
    unstable: bool

    def error(self, task: Task, delay: float) -> np.ndarray:
        """Return the error [m] against the reference, which is delayed by ``delay`` [s], shape (N,)."""
        return task.reference(self.time - delay) - self.displacement

    def mean_squares(self, task: Task, delays) -> np.ndarray:
        """Return the mean square of the error [m²] for each of the delays [s]."""
        return np.array([np.mean(self.error(task, delay) ** 2) for delay in delays])

    @property
    def thin(self) -> Followed:
        """The same run, evaluated at fewer points."""
        stride = max(len(self.time) // THIN, 1) | 1  # an odd stride, so that all instants within a sample occur
        return self._replace(time=self.time[::stride], displacement=self.displacement[::stride])


def followed(signals: dict[str, np.ndarray], plant: DrawnPlant, task: Task) -> Followed:
    """Evaluate a run between its samples."""
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
    """Results of one candidate on one task, for all plants."""

    #: rms, maximum: shape (plants,); RMS and largest error against the reference delayed by the row's own constant
    #: delay, as fractions of the stroke.
    rms: np.ndarray
    maximum: np.ndarray
    undelayed: np.ndarray  #: shape (plants,); RMS error against the reference itself, as fractions of the stroke.
    effort: np.ndarray  #: shape (plants,); RMS rate of the voltage [V/s].
    chattering: np.ndarray  #: shape (plants,); Chattering of the command [m rms].
    saturated: float  #: Fraction of the evaluated samples at a limit, the largest over the plants.
    unstable: int  #: Number of unstable plants.

    @property
    def worst(self) -> float:
        """RMS error on the worst plant, as a fraction of the stroke."""
        return float(np.max(self.rms))


def best_delay(runs: Mapping[Task, Sequence[Followed]], longest: float) -> float:
    """Return the constant delay [s], common to all references and plants, with the smallest score of the runs."""
    delays = np.linspace(0.0, longest, DELAYS)
    coarse = {task: np.array([run.thin.mean_squares(task, delays) for run in found]) for task, found in runs.items()}
    best = min(max(int(np.argmin(_scores(coarse))), 1), DELAYS - 2)
    # the mean square of one run is nearly a parabola in the delay; the maximum over several runs, and its logarithm,
    # are not
    around, fine = delays[best - 1 : best + 2], np.linspace(delays[best - 1], delays[best + 1], DELAYS)
    close = {
        task: np.array([_parabola(around, run.mean_squares(task, around), fine) for run in found])
        for task, found in runs.items()
    }
    return float(fine[np.argmin(_scores(close))])


def _scores(mean_squares: dict[Task, np.ndarray]) -> np.ndarray:
    """Return the log of the score at each delay: log mean square error on the worst plant, summed over references."""
    smallest = np.finfo(float).tiny
    return np.sum([np.log(np.maximum(np.max(values, axis=0), smallest)) for values in mean_squares.values()], axis=0)


def _parabola(places, values, fine) -> np.ndarray:
    """Return the values, at the positions ``fine``, of the parabola through three points."""
    middle = places[1]
    return np.polyval(np.polyfit(places - middle, values, 2), fine - middle)


def judged(runs: Mapping[Task, Sequence[Followed]], delay: float, stroke: float) -> dict[str, Result]:
    """Return the results of the runs of one candidate, by name of the task.

    Units: ``delay`` [s], ``stroke`` [m].
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
    """Return the results of one combination on several groups of plants as one result."""
    arrays = ("rms", "maximum", "undelayed", "effort", "chattering")
    found = {}
    for task in results[0]:
        each = [result[task] for result in results]
        joined: dict[str, Any] = {name: np.concatenate([getattr(result, name) for result in each]) for name in arrays}
        saturated, unstable = max(one.saturated for one in each), sum(one.unstable for one in each)
        found[task] = Result(**joined, saturated=saturated, unstable=unstable)
    return found
