# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Comparison of all controllers and compensators under the same realistic conditions, to choose one for an axis.

There are two tables: random plants close to the configured plant, for which every candidate is designed from the models
in the configuration; and plants of other classes than any model, for which every candidate is designed from the default
identification of a recording. The runs have sensor noise, converters and limits; the errors are evaluated from the true
displacement, also between the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, did_you_mean, shortened
from hysteresis_ros.executors import Job, executor
from hysteresis_ros.laboratory.comparison.candidates import known, names
from hysteresis_ros.laboratory.comparison.rows import (
    DRAWS,
    Row,
    Trial,
    around,
    compared_with,
    conditions_bench,
    drawn,
    identified,
    joined,
    recorded,
    yardstick,
)
from hysteresis_ros.laboratory.comparison.tasks import (
    ALLOWED_DELAY,
    LEARNING_PERIODS,
    Conditions,
    ForeignPlant,
    ModelledPlant,
    make_tasks,
)
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import reachable_displacements, single_axis
from hysteresis_ros.loop.simulation import mismatched

#: Suffix of the name of a compensator with creep.
WITH_CREEP = " with creep"


@dataclass(frozen=True)
class Table:
    """Candidates on one set of plants."""

    title: str
    summary: str  #: One line about stroke and plants.
    tasks: tuple[str, ...]  #: Names of the references.
    rows: tuple[Row, ...]  #: Ranked rows, best first; then rows without a rank; then refused rows.
    yardstick: Row  #: Row of the benchmark controller.
    assumptions: tuple[str, ...]  #: Sentences about the assumptions of the table.

    def row(self, controller: str, compensator: str) -> Row:
        """Return the row of a combination."""
        for row in self.rows:
            if row.name == (controller, compensator):
                return row
        raise ConfigurationError(f"no row '{controller}' with '{compensator}' in the comparison")


@dataclass(frozen=True)
class Comparison:
    """Both tables."""

    conditions: Conditions
    #: around, others: Tables of random plants close to the configured plant, and of plants of other classes; None if
    #: there are no such plants.
    around: Table | None
    others: Table | None
    configuration: Configuration  #: Configuration of the first table.

    @property
    def tables(self) -> tuple[Table, ...]:
        """The tables that are not None."""
        return tuple(table for table in (self.around, self.others) if table is not None)

    @property
    def best(self) -> Row:
        """The best row of the first table that also has a rank in the second, if there is a second table.

        A row with learning does not count, because learning is designed for the period of one reference.
        """
        for row in self.around.rows if self.around is not None else ():
            learns = row.candidate is not None and row.candidate.learning  # its filters differ for each reference
            if row.ranked and not learns and (self.others is None or _ranked_in(self.others, row)):
                return row
        raise ConfigurationError(
            f"{self.configuration.source}: no combination has a rank in every table; the tables show the unmet "
            "requirements. The first table needs --draws 1 or more"
        )


def _ranked_in(table: Table, row: Row) -> bool:
    """Return whether a combination has a rank in another table or is not part of that table."""
    return all(other.ranked for other in table.rows if other.controller == row.controller and other.results)


class Tried(NamedTuple):
    """Results on a plant of another class, and on variants of it after a drift."""

    seed: int  #: Seed of the plant.
    kind: str  #: Class of its hysteresis.
    stroke: float  #: Stroke [m]; errors are given as fractions of it.
    rows: list[Row]
    yardstick: Row


def table_around(
    axis: AxisParameters, conditions: Conditions, trial: Trial, rows: Sequence[Row], yardstick: Row
) -> Table:
    """Return the table of the random plants close to the configured plant."""
    limits, per_cent = axis.hysteresis_compensator.limits, 100.0 * conditions.mismatch
    task = trial.tasks[0]
    middle = 0.5 * (task.low + task.high)
    low, high = middle - 0.5 * trial.stroke, middle + 0.5 * trial.stroke
    assumptions = (
        f"{conditions.draws} plants close to the configured plant, seeds {conditions.seed} … "
        f"{conditions.seed + conditions.draws - 1}: gain, loop width, each weight of the hysteresis, "
        f"times of the dynamics and creep rate deviate by up to ±{per_cent:g} %, uniformly and independently",
        f"{_seen(conditions)}, limits {limits.minimum:g} … {limits.maximum:g} V",
        "every candidate was designed from the models in the configuration and from the sizes of noise and mismatch",
    )
    return Table(
        "Plants close to the configured plant",
        f"stroke {trial.stroke * 1e6:.4g} µm: every plant reaches {low * 1e6:.4g} … {high * 1e6:.4g} µm",
        tuple(task.name for task in trial.tasks),
        tuple(sorted(compared_with(rows, yardstick), key=lambda row: row.order)),
        yardstick,
        assumptions,
    )


def table_of_others(conditions: Conditions, tried: Sequence[Tried]) -> Table:
    """Return the table of the plants of other classes."""
    tried = sorted(tried)
    plants = [f"plant {one.seed}" for one in tried]
    by_name = [{row.name: row for row in one.rows} for one in tried]
    rows = []
    for name in dict.fromkeys(name for found in by_name for name in found):
        # if no creep was identified, the compensator with creep equals the compensator without creep
        plain = name[0], name[1].removesuffix(WITH_CREEP)
        each = [row for found in by_name if (row := found.get(name, found.get(plain))) is not None]
        if len(each) == len(by_name):
            rows.append(joined(each, plants, name))
    yardstick = joined([one.yardstick for one in tried], plants, tried[0].yardstick.name)
    around = 8 + DRAWS
    assumptions = (
        f"{len(tried)} plants of other classes, seeds {tried[0].seed} … {tried[-1].seed}; after its recording, each "
        f"plant also runs in {around} variants, in which gain, loop width, time constants and creep differ by up to "
        f"±{100.0 * conditions.mismatch:g} %: the 8 corners of gain, loop width and time constants (the creep changes "
        f"as the gain), and {DRAWS} random ones",
        f"{_seen(conditions)}, 2 kHz, 0 … 100 V",
        "every candidate was designed from the default identification of one recording of the plant",
    )
    strokes = ", ".join(f"{one.seed}: {one.kind} {one.stroke * 1e6:.3g} µm" for one in tried)
    return Table(
        "Plants of other classes than the model, which was identified from a recording",
        f"strokes of the plants: {strokes}",
        tuple(tried[0].yardstick.results),
        tuple(sorted(rows, key=lambda row: row.order)),
        yardstick,
        assumptions,
    )


def judgement(conditions: Conditions) -> tuple[str, ...]:
    """Return sentences about the evaluation of the rows."""
    return (
        "errors are those of the true displacement at ten points per sample, in % of the stroke",
        "RMS and worst: against the delayed reference; each design has one constant delay for both references and all "
        f"plants, at most {1e3 * conditions.longest_delay:g} ms ({ALLOWED_DELAY:g} periods of the faster "
        "reference); undelayed: against the reference itself, on the worst plant",
        f"controllers with learning are evaluated from period {LEARNING_PERIODS + 1} on, with filters for the period "
        "of each reference; all other controllers from 2 s on",
        "× PI: error of a PI with static feedforward divided by the error of the row, each on its worst plant; the "
        "PI was tuned on the plant itself by the ranking criterion, tolerates 6 dB more gain and one more sample of "
        "delay, and also has a constant delay",
        "marked rows do not have the required margins on their own model, or exceed M_s = 3 when its gain and times "
        "deviate by the mismatch; marked rows, and rows that were unstable on a plant, have no rank",
    )


def _seen(conditions: Conditions) -> str:
    converters = f"converters of {conditions.bits} bits" if conditions.bits else "converters without steps"
    return f"sensor noise {conditions.noise * 1e9:g} nm rms, {converters}"


#: Dwell at the highest and at the lowest voltage while the range of a plant is measured [s].
REST = 2.0


def reachable(plants: Sequence[ModelledPlant], source: str) -> tuple[float, float]:
    """Return the ends [m] of the range that every plant reaches within its limits, without the preload offset.

    Each plant dwells for :data:`REST` seconds at its highest, then at its lowest voltage.
    """
    lows, highs = [], []
    for plant in plants:
        limits, samples = plant.parameters.limits, round(REST * plant.sample_rate)
        displacement = plant.between([limits.maximum] * samples + [limits.minimum] * samples)[:, -1]
        highs.append(displacement[samples - 1])
        lows.append(displacement[-1])
    low, high = float(max(lows)), float(min(highs))
    if not low < high:
        raise ConfigurationError(
            f"{source}: the plants have no displacement in common between "
            f"{low * 1e6:.4g} and {high * 1e6:.4g} µm: lower the mismatch or widen limits.minimum … limits.maximum"
        )
    return low, high


def drawn_around(configuration: Configuration, conditions: Conditions) -> list[ModelledPlant]:
    """Return random plants close to the configured plant, with converters, each with its own noise sequence."""
    found = []
    for seed in range(conditions.seed, conditions.seed + conditions.draws):
        plant = mismatched(configuration, conditions.mismatch, seed).override(
            "plant_simulator", limits__bits=conditions.bits, sensor__noise=conditions.noise, sensor__seed=seed
        )
        found.append(ModelledPlant(single_axis(plant).plant_simulator))
    return found


def trial_around(configuration: Configuration, conditions: Conditions) -> Trial:
    """Return the trial on random plants close to the configured plant."""
    plants = drawn_around(configuration, conditions)
    low, high = reachable(plants, configuration.source)
    given = known(configuration, conditions.bits, conditions.noise)
    tasks = make_tasks(conditions, (low, high))
    return Trial(given, conditions, tasks, high - low, tuple(plants))


def trial_on_other(seed: int, conditions: Conditions) -> Trial:
    """Return the trial on a plant of another class, and on variants of this plant that drifted after its recording.

    The designs and the references depend on the recording alone. The references are within the range of the model,
    reduced by the mismatch.
    """
    bench = conditions_bench(conditions)
    plant = drawn(seed, bench)
    given = identified(recorded(plant, bench, seed), bench)
    low, high = reachable([ModelledPlant(given.axis.plant_simulator)], "the identified model")
    # without an inverse, references are checked with the gain alone; creep and hysteresis may exceed this motion
    alone = given.configuration.override("hysteresis_compensator", inverse__type="none")
    least, most = reachable_displacements(single_axis(alone))
    reach = max(low * (1.0 + conditions.mismatch), least), min(high * (1.0 - conditions.mismatch), most)
    tasks = make_tasks(conditions, reach)
    return Trial(given, conditions, tasks, reach[1] - reach[0], tuple(around(plant, conditions.mismatch, seed)))


# -- work for processes ------------------------------------------------------------------------------------------------


def _rows_around(trial: Trial, compensator: str, only) -> tuple[str, list[Row]]:
    return f"with {compensator}", trial.rows([name for name in only if name[1] == compensator])


def _yardstick_around(trial: Trial) -> tuple[str, Row]:
    return "yardstick", yardstick(trial)


def _rows_on_other(seed: int, conditions: Conditions, only) -> tuple[str, Tried]:
    trial = trial_on_other(seed, conditions)
    plant = trial.plants[0]
    if not isinstance(plant, ForeignPlant):
        raise TypeError(f"{type(plant).__name__}: must be a ForeignPlant")
    measure, kind = yardstick(trial), plant.actuator.hysteresis
    rows = compared_with(trial.rows(only), measure)
    return f"plant {seed} of another class ({kind})", Tried(seed, kind, trial.stroke, rows, measure)


def _require_known(only, possible: Sequence[tuple[str, str]]) -> None:
    """Refuse combinations that the axis cannot use; otherwise the tables would lack them without a message."""
    for pair in [only] if isinstance(only, str) else only:
        if isinstance(pair, str) or len(pair) != 2:
            raise ConfigurationError(
                f"only = {shortened(only)}: must be a list of pairs (controller, compensator), such as {possible[0]!r}"
            )
    for position, kind in enumerate(("controller", "compensator")):
        known_names = list(dict.fromkeys(name[position] for name in possible))
        for name in (combination[position] for combination in only):
            if name not in known_names:
                raise ConfigurationError(
                    f"there is no {kind} {name!r} to compare{did_you_mean(name, known_names)} "
                    f"(there are: {', '.join(known_names)})"
                )


def compare(
    configuration: Configuration,
    conditions: Conditions | None = None,
    *,
    namespace: str | None = None,
    only=None,
    workers: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Run every candidate on every plant and rank them."""
    conditions = conditions or Conditions()
    axis = single_axis(configuration, namespace)
    axis.require_generator(
        f"{configuration.source}: describes an inchworm motor, but the comparison needs a reference generator; give "
        "the configuration of a single actuator"
    )
    if namespace is not None:
        configuration = parse_configuration(axis.configuration_text(), configuration.source)
    conditions.require_slow(axis.plant_simulator.sample_rate)
    if only is not None and conditions.draws:
        _require_known(only, names(axis))
    # the longest jobs first
    jobs = [Job(_rows_on_other, (conditions.seed + i, conditions, only)) for i in range(conditions.others)]
    if conditions.draws:
        trial = trial_around(configuration, conditions)
        chosen = only if only is not None else names(trial.given.axis)
        compensators = dict.fromkeys(compensator for _, compensator in names(trial.given.axis))
        jobs += [Job(_rows_around, (trial, compensator, chosen)) for compensator in compensators]
        jobs.append(Job(_yardstick_around, (trial,)))
    found: dict[str, list] = {job.function.__name__: [] for job in jobs}
    with executor(workers, jobs=len(jobs)) as shared:
        for number, (words, result) in shared.results(jobs):
            progress(words)
            found[jobs[number].function.__name__].append(result)
    first = second = None
    if conditions.draws:
        first = table_around(axis, conditions, trial, sum(found["_rows_around"], []), found["_yardstick_around"][0])
    if conditions.others:
        second = table_of_others(conditions, found["_rows_on_other"])
    return Comparison(conditions, first, second, configuration)
