# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A candidate on a set of plants: design from known data, a run on each plant, and comparison with a benchmark.

A plant of another class is treated as a user would treat it: :func:`recorded` drives the plant and measures with its
sensor; :func:`identified` runs the default identification with this recording and the data sheets of the bench.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.control.law import UNFED
from hysteresis_ros.control.laws.pid import PidParameters
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.identification.workflow import identify
from hysteresis_ros.laboratory.between_samples import INSTANTS
from hysteresis_ros.laboratory.comparison.candidates import Candidate, Known, candidates, known
from hysteresis_ros.laboratory.comparison.tasks import (
    LEARNING_PERIODS,
    SETTLING_PERIODS,
    Conditions,
    DrawnPlant,
    Followed,
    ForeignPlant,
    Result,
    Task,
    best_delay,
    followed,
    judged,
    merged,
)
from hysteresis_ros.laboratory.foreign import HYSTERESES, ForeignParameters
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters, PlantNodeParameters
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import Limits
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import Sensor
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import recipe
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters


@dataclass(frozen=True)
class Row:
    """One candidate: its results, or the reason why it was refused."""

    controller: str  #: controller, compensator: Names in the table.
    compensator: str
    #: Results by name of the task; empty for a refused candidate.
    results: dict[str, Result] = field(default_factory=dict)
    delays: tuple[float, ...] = ()  #: Constant delay of the evaluation [s], one for each design.
    refused: str = ""  #: Reason why there are no results.
    marked: str = ""  #: Unmet margins on the candidate's own model; the candidate is run and shown, but not ranked.
    #: By name of the task: RMS error of the benchmark divided by that of this row, each on its worst plant; the
    #: smallest over the designs.
    better: dict[str, float] = field(default_factory=dict)
    #: Time [s] and error [fraction of the stroke] on the worst plant of the candidate, by name of the task.
    errors: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    candidate: Candidate | None = None  #: The candidate's parameters, if there is only one design.

    @property
    def name(self) -> tuple[str, str]:
        """Names of controller and compensator."""
        return self.controller, self.compensator

    @property
    def unstable(self) -> int:
        """Number of plants on which a run of one of the references was unstable."""
        return max((result.unstable for result in self.results.values()), default=0)

    @property
    def ranked(self) -> bool:
        """Whether the row has a rank: it has the margins required of every design, and was stable on all plants."""
        return bool(self.results) and not (self.refused or self.marked or self.unstable)

    @property
    def score(self) -> float:
        """Geometric mean, over the tasks, of the RMS error on the worst plant; this score determines the rank."""
        if not self.results:
            return float("inf")
        worst = [result.worst for result in self.results.values()]
        return float(np.exp(np.mean(np.log(worst)))) if np.all(np.isfinite(worst)) else float("inf")

    @property
    def order(self) -> tuple[bool, bool, float]:
        """Sort key of rows: ranked rows first, refused rows last."""
        return bool(self.refused), not self.ranked, self.score


@dataclass(frozen=True)
class Trial:
    """The data from which candidates are designed, and the plants on which they are evaluated."""

    given: Known  #: Data for the designs, with conditions and tasks.
    conditions: Conditions
    tasks: tuple[Task, ...]
    stroke: float  #: Stroke [m]; errors are given as fractions of it.
    plants: tuple[DrawnPlant, ...]  #: Plants of the runs.

    def rows(self, only=None) -> list[Row]:
        """Return a row for each candidate, in the order of their design."""
        return [self.row(candidate) for candidate in candidates(self.given, self.conditions, self.tasks, only)]

    def row(self, candidate: Candidate) -> Row:
        """Return the row of a candidate."""
        row = Row(candidate.controller, candidate.compensator, candidate=candidate, marked=candidate.marked)
        if candidate.refused:
            return replace(row, refused=candidate.refused)
        try:
            periods = LEARNING_PERIODS if candidate.learning else SETTLING_PERIODS
            tasks = [replace(task, periods=periods) for task in self.tasks]
            axes = {task: self.given.designed(candidate, task) for task in tasks}
        except (ConfigurationError, ParameterError) as error:
            return replace(row, refused=" ".join(str(error).split()))
        return self.judged(
            row, {task: [run(axis, plant, task) for plant in self.plants] for task, axis in axes.items()}
        )

    def judged(self, row: Row, runs: dict[Task, list[Followed]]) -> Row:
        """Return a row with the results of its runs."""
        delay = best_delay(runs, self.conditions.longest_delay)
        results, errors = judged(runs, delay, self.stroke), {}
        for task, found in runs.items():
            worst = found[int(np.argmax(results[task.name].rms))]
            shown = worst.time <= task.settling + 2.0 / task.frequency
            errors[task.name] = worst.time[shown], worst.error(task, delay)[shown] / self.stroke
        return replace(row, results=results, delays=(delay,), errors=errors)


def run(axis: AxisParameters, plant: DrawnPlant, task: Task) -> Followed:
    """Return the run of an axis along a reference on a plant."""
    loop = Axis(axis, plant.in_loop())
    return followed(loop.run(loop.default_setpoints(round(task.duration * plant.sample_rate))), plant, task)


def compared_with(rows: Sequence[Row], yardstick: Row) -> list[Row]:
    """Return the rows with the benchmark's error divided by the row's error, each on its worst plant."""
    return [
        replace(
            row, better={name: yardstick.results[name].worst / result.worst for name, result in row.results.items()}
        )
        for row in rows
    ]


def joined(rows: Sequence[Row], plants: Sequence[str], name: tuple[str, str]) -> Row:
    """Combine the rows of one combination, each designed from the recording of one plant, into one row."""
    pairs = list(zip(rows, plants, strict=True))
    refused = "; ".join(f"{plant}: {row.refused}" for row, plant in pairs if row.refused)
    if refused:
        return Row(*name, refused=refused)
    scores = [row.score for row in rows]
    return Row(
        *name,
        merged([row.results for row in rows]),
        tuple(row.delays[0] for row in rows),
        marked="; ".join(f"{plant}: {row.marked}" for row, plant in pairs if row.marked),
        better={task: min(row.better[task] for row in rows) for task in rows[0].better},
        errors=rows[int(np.argmax(scores))].errors,
    )


#: Name of the controller of the benchmark in the tables.
CONTROLLER = "PI + static feedforward, tuned on the plant"
#: Name of the compensator of the benchmark in the tables.
COMPENSATOR = "none"
#: Initial crossovers of the search [Hz].
CROSSOVERS = (1.0, 3.0, 10.0, 30.0, 100.0)
#: Initial proportional gains of the search.
PROPORTIONAL = (0.0, 0.5, 2.0)
#: Number of iterations of the search.
ITERATIONS = 30
#: Tolerance of the simplex of the search.
TOLERANCE = 1e-2
#: Initial size of the simplex: in the logarithm of Ki, and in Kp.
SCALES = (3.0, 1.0)
#: Slow model with which the law accepts the benchmark's gains, so that the run on the plant decides.
SLOW = LinearParameters(A=(0.9,), B=(0.1,), C=(1.0,))
#: Required gain margin, a factor (6 dB).
GAIN_MARGIN = 2.0


def yardstick(trial: Trial) -> Row:
    """Return the row of the benchmark: tuned on the first plant by the ranking criterion, run on all plants."""
    gains = _tuned(trial)
    found = Candidate(CONTROLLER, COMPENSATOR, {f"pid.{name}": value for name, value in gains.to_mapping().items()})
    runs = {}
    for task in trial.tasks:
        axis = _axis(trial, gains, task)
        runs[task] = [run(axis, plant, task) for plant in trial.plants]
    return trial.judged(Row(CONTROLLER, COMPENSATOR, candidate=found), runs)


def _axis(trial: Trial, gains: PidParameters, task: Task) -> AxisParameters:
    """Return the axis with a PI and static feedforward, V = command / gain."""
    plain = trial.given.designed(Candidate("", "", dict(UNFED)), task)
    fed, model = FeedforwardParameters(type="static"), replace(plain.motion_controller.model, dynamics=SLOW)
    own: dict[str, Any] = {"pid": gains}  # parameters that the law declares
    node = replace(plain.motion_controller, type="pid", model=model, feedforward=fed, **own)
    compensator = replace(plain.hysteresis_compensator, inverse=InverseParameters(type="none"))
    return replace(plain, motion_controller=node, hysteresis_compensator=compensator)


def _tuned(trial: Trial) -> PidParameters:
    """Return the gains with the smallest score on the first plant, provided that they have the margins of a candidate.

    The loop must tolerate 6 dB more gain, and one more sample of delay.
    """
    plant, axes = trial.plants[0], {task: _axis(trial, PidParameters(), task) for task in trial.tasks}
    late, fastest = plant.later(), max(trial.tasks, key=lambda task: task.frequency)

    def followed(gains: PidParameters, plant: DrawnPlant = plant, task: Task = fastest) -> Followed:
        own: dict[str, Any] = {"pid": gains}
        node = replace(axes[task].motion_controller, **own)
        return run(replace(axes[task], motion_controller=node), plant, task)

    def gains(values, factor: float = 1.0) -> PidParameters:
        return PidParameters(Kp=factor * float(values[1]), Ki=factor * float(np.exp(values[0])))

    def cost(values) -> float:
        if values[1] < 0.0:
            return np.inf
        try:
            if followed(gains(values, GAIN_MARGIN)).unstable or followed(gains(values), late).unstable:
                return np.inf
            runs = {task: [followed(gains(values), task=task)] for task in trial.tasks}
        except ParameterError:  # the controller does not accept these gains
            return np.inf
        results = judged(runs, best_delay(runs, trial.conditions.longest_delay), trial.stroke)
        return float(np.mean([np.log(result.worst) for result in results.values()]))

    starts = [np.array([np.log(2.0 * np.pi * f), Kp]) for f, Kp in itertools.product(CROSSOVERS, PROPORTIONAL)]
    settings = SimplexSettings(iterations=ITERATIONS, tolerance=TOLERANCE)
    return gains(restarted_nelder_mead(cost, min(starts, key=cost), scale=SCALES, settings=settings).x)


#: Number of random plants around each plant, in addition to the plant itself and its corners.
DRAWS = 3
#: Indices of the factors by which a plant deviates; :func:`_deviated` applies them to :class:`ForeignParameters`. The
#: factor at TIMES multiplies lag and delay, and divides the frequencies.
GAIN, OPENING, TIMES, CREEP = range(4)


@dataclass(frozen=True)
class Bench:
    """Data sheets of amplifier, converters and sensor."""

    sample_rate: float = 2000.0  #: [Hz]
    voltage: float = 100.0  #: Highest voltage of the amplifier [V]; the lowest is 0.
    bits: int = 16  #: Resolution of the converter; 0: unlimited.
    noise: float = 5e-9  #: noise, resolution: Noise and resolution of the sensor [m].
    resolution: float = 1e-9

    def node(self, seed: int) -> PlantNodeParameters:
        """Return limits and sensor as the parameters of a plant."""
        return PlantNodeParameters.from_mapping(
            {
                "sample_rate": self.sample_rate,
                "limits.minimum": 0.0,
                "limits.maximum": self.voltage,
                "limits.bits": self.bits,
                "sensor.noise": self.noise,
                "sensor.resolution": self.resolution,
                "sensor.seed": seed,
                "hysteresis.type": "proportional",
                "hysteresis.proportional.gain": 1e-7,
            }
        )


def drawn(seed: int, bench: Bench) -> ForeignPlant:
    """Return a plant of another class; the seed selects the class of its hysteresis cyclically."""
    random = np.random.default_rng((seed, 1))
    sample_time = 1.0 / bench.sample_rate

    def between(low, high):
        return float(low * (high / low) ** random.uniform())

    actuator = ForeignParameters(
        hysteresis=HYSTERESES[seed % len(HYSTERESES)],
        stroke=between(15e-6, 60e-6),
        voltage=bench.voltage,
        opening=between(0.1, 0.16),
        asymmetry=between(0.1, 0.2),
        rate=between(0.2, 0.6),
        creep=between(0.02, 0.05),
        exponent=between(0.12, 0.3),
        lag=between(0.5e-3, 2e-3),
        lag_before=bool(random.integers(2)),
        delay=between(1.0, 1.8) * sample_time,
        frequencies=(between(180.0, 450.0), between(1100.0, 1900.0)),
        dampings=(between(0.02, 0.04), between(0.01, 0.03)),
        share=between(0.03, 0.12),
        steps=INSTANTS,
    )
    return ForeignPlant(bench.node(seed), actuator)


def around(plant: ForeignPlant, mismatch: float, seed: int) -> list[ForeignPlant]:
    """Return the plant and its variants after a drift, at the corners of the deviations and at random.

    Gain, loop width, all times (of lag, delay and modes) and creep deviate by at most the mismatch. At a corner, the
    first three deviate by exactly the mismatch, and the creep by the same factor as the gain.
    """
    random = np.random.default_rng((seed, 2))
    signs = [(*corner, corner[0]) for corner in itertools.product((-1.0, 1.0), repeat=3)]
    signs += list(random.uniform(-1.0, 1.0, (DRAWS, 4)))
    found = [plant]
    for number, factors in enumerate(1.0 + mismatch * np.array(signs), 1):
        sensor = replace(plant.parameters.sensor, seed=seed + 1000 * number)
        parameters = replace(plant.parameters, sensor=sensor)
        found.append(replace(plant, parameters=parameters, actuator=_deviated(plant.actuator, factors)))
    return found


def _deviated(actuator: ForeignParameters, factors) -> ForeignParameters:
    return replace(
        actuator,
        stroke=actuator.stroke * factors[GAIN],
        opening=actuator.opening * factors[OPENING],
        lag=actuator.lag * factors[TIMES],
        delay=actuator.delay * factors[TIMES],
        frequencies=tuple(frequency / factors[TIMES] for frequency in actuator.frequencies),
        creep=actuator.creep * factors[CREEP],
    )


def excitation(bench: Bench) -> np.ndarray:
    """Return the voltages [V] of a typical recording: minor loops, then a multisine, then steps."""
    rate = bench.sample_rate
    sample_time, parts = 1.0 / rate, []
    for name, changes in (
        ("decaying", {"frequency": 6.0}),
        ("multisine", {"frequency": 1.0, "duration": 2.0}),
        ("steps", {"duration": 1.5}),
    ):
        made = recipe(name, 0.0, bench.voltage, rate, **changes)
        if made.samples is None:
            waveform = Waveform(WaveformParameters.from_mapping(made.waveform), sample_time)
            parts.append(waveform.simulate(np.zeros(round(made.duration * rate))))
        else:
            parts.append(made.samples)
    return np.concatenate(parts)


def recorded(plant: ForeignPlant, bench: Bench, seed: int) -> Recording:
    """Return the recording of a plant under the excitation, with converter steps and sensor noise."""
    sample_time, node = 1.0 / bench.sample_rate, bench.node(seed)
    voltage = Limits(node.limits, sample_time).simulate(excitation(bench))
    # a measurement responds to earlier voltages only
    displacement = np.concatenate([[0.0], plant.between(voltage)[:-1, -1]])
    measured = Sensor(node.sensor, sample_time).simulate(displacement)
    units = {"voltage": "V", "measured": "m"}
    return Recording(np.arange(len(voltage)) * sample_time, {"voltage": voltage, "measured": measured}, units, {})


def identified(recording: Recording, bench: Bench) -> Known:
    """Return the data for designs: the model that the default identification finds, and limits and converter bits."""
    found = identify(recording)
    configuration = parse_configuration(found.text, "the identified model")
    limits = {"limits__minimum": 0.0, "limits__maximum": bench.voltage}
    configuration = configuration.override("hysteresis_compensator", **limits)
    # a jump to the first reference would reach the limit of the slew rate; no task evaluates this motion
    return known(configuration.override("reference_generator", approach__from_rest=True), bench.bits, bench.noise)


def conditions_bench(conditions: Conditions) -> Bench:
    """Return the default bench under these conditions."""
    return Bench(bits=conditions.bits, noise=conditions.noise)
