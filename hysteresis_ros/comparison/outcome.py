# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a comparison found: a table for each set of plants, and the best combination."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hysteresis_ros.comparison.others import DRAWS
from hysteresis_ros.comparison.rows import Row, Trial, compared_with, joined
from hysteresis_ros.comparison.tasks import ALLOWED_DELAY, LEARNING_PERIODS, Conditions
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis_parameters import AxisParameters

#: How a compensator with creep is called beside the one without.
WITH_CREEP = " with creep"


@dataclass(frozen=True)
class Table:
    """Candidates on one set of plants.

    Parameters
    ----------
    title : str
    summary : str
        Of stroke and plants, in a line.
    tasks : tuple of str
        Names of the references.
    rows : tuple of Row
        Best first; then those without a rank, refused ones last.
    yardstick : Row
        What they are compared with.
    assumptions : tuple of str
        What the table rests on, in sentences.
    """

    title: str
    summary: str
    tasks: tuple[str, ...]
    rows: tuple[Row, ...]
    yardstick: Row
    assumptions: tuple[str, ...]

    def row(self, controller: str, compensator: str) -> Row:
        """Return the row of a combination.

        Raises
        ------
        ConfigurationError
            There is none.
        """
        for row in self.rows:
            if row.name == (controller, compensator):
                return row
        raise ConfigurationError(f"no row '{controller}' with '{compensator}' in the comparison")


@dataclass(frozen=True)
class Comparison:
    """Both tables.

    Parameters
    ----------
    conditions : Conditions
    around, others : Table or None
        Of plants around the configured one, and of plants of other classes; None where none were drawn.
    configuration : Configuration
        What the first is about.
    """

    conditions: Conditions
    around: Table | None
    others: Table | None
    configuration: Configuration

    @property
    def tables(self) -> tuple[Table, ...]:
        """The tables there are."""
        return tuple(table for table in (self.around, self.others) if table is not None)

    @property
    def best(self) -> Row:
        """The first row around the configured plant that has a rank on the plants of other classes too.

        One that learns is none: what learns is designed for the period of one reference.

        Raises
        ------
        ConfigurationError
            There is none.
        """
        for row in self.around.rows if self.around is not None else ():
            learns = row.candidate is not None and row.candidate.learning  # for each reference something else
            if row.ranked and not learns and (self.others is None or _ranked_in(self.others, row)):
                return row
        raise ConfigurationError(
            f"{self.configuration.source}: no combination has a rank on all plants; look at the table for what each "
            "misses, and draw around the configured plant (--draws 1 or more)"
        )


def _ranked_in(table: Table, row: Row) -> bool:
    """Tell whether a combination has a rank in another table; what is not in it is of this configuration alone."""
    return all(other.ranked for other in table.rows if other.controller == row.controller and other.results)


class Tried(NamedTuple):
    """What was tried on one plant of another class and what is around it.

    Parameters
    ----------
    seed : int
        Of the plant.
    kind : str
        Class of its hysteresis.
    stroke : float
        What errors are parts of [m].
    rows : list of Row
    yardstick : Row
    """

    seed: int
    kind: str
    stroke: float
    rows: list[Row]
    yardstick: Row


def table_around(
    axis: AxisParameters, conditions: Conditions, trial: Trial, rows: Sequence[Row], yardstick: Row
) -> Table:
    """Return the table of the plants around the configured one.

    Parameters
    ----------
    axis : AxisParameters
        The configured one.
    conditions : Conditions
    trial : Trial
    rows : sequence of Row
        In any order.
    yardstick : Row
    """
    limits, per_cent = axis.hysteresis_compensator.limits, 100.0 * conditions.mismatch
    task = trial.tasks[0]
    middle = 0.5 * (task.low + task.high)
    low, high = middle - 0.5 * trial.stroke, middle + 0.5 * trial.stroke
    assumptions = (
        f"{conditions.draws} plants around the configured one, seeds {conditions.seed} … "
        f"{conditions.seed + conditions.draws - 1}: gain, opening of the hysteresis and each of its weights, times of "
        f"the dynamics and rate of the creep each off by up to ±{per_cent:g} %, uniform and independent",
        f"{_seen(conditions)}, limits {limits.minimum:g} … {limits.maximum:g} V",
        "every candidate was designed on the models in the configuration, knowing the size of noise and mismatch",
    )
    return Table(
        "Plants around the configured one",
        f"stroke {trial.stroke * 1e6:.4g} µm: every plant reaches {low * 1e6:.4g} … {high * 1e6:.4g} µm",
        tuple(task.name for task in trial.tasks),
        tuple(sorted(compared_with(rows, yardstick), key=lambda row: row.order)),
        yardstick,
        assumptions,
    )


def table_of_others(conditions: Conditions, tried: Sequence[Tried]) -> Table:
    """Return the table of the plants of other classes.

    Parameters
    ----------
    conditions : Conditions
    tried : sequence of Tried
        In any order.
    """
    tried = sorted(tried)
    plants = [f"plant {one.seed}" for one in tried]
    by_name = [{row.name: row for row in one.rows} for one in tried]
    rows = []
    for name in dict.fromkeys(name for found in by_name for name in found):
        # where no creep was found, the compensator with it is the one without
        plain = name[0], name[1].removesuffix(WITH_CREEP)
        each = [found.get(name, found.get(plain)) for found in by_name]
        if None not in each:
            rows.append(joined(each, plants, name))
    yardstick = joined([one.yardstick for one in tried], plants, tried[0].yardstick.name)
    around = 8 + DRAWS
    assumptions = (
        f"{len(tried)} plants of other classes, seeds {tried[0].seed} … {tried[-1].seed}, each also with gain, "
        f"opening, times and creep off by up to ±{100.0 * conditions.mismatch:g} % after it was recorded: {around} "
        "plants around it, of which 8 are corners",
        f"{_seen(conditions)}, 2 kHz, 0 … 100 V",
        "every candidate was designed on what the default identification made of one recording of the plant",
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
    """Return how every row is judged, in sentences.

    Parameters
    ----------
    conditions : Conditions
    """
    return (
        "errors are those of the true displacement at ten instants a sample, in % of the stroke",
        "RMS and worst: against the reference delayed by the row's own constant delay, one for both references and all "
        f"plants of a design, at most {1e3 * conditions.longest_delay:g} ms ({ALLOWED_DELAY:g} periods of the faster "
        "reference); undelayed: against the reference itself, on the worst plant",
        f"who learns from period to period is judged from period {LEARNING_PERIODS + 1} on, each reference learned "
        "with filters for its own period; all others after 2 s",
        "× PI: how many times as large the error of a PI with static feedforward is, whose gains were tuned on the "
        "very plant by what the table ranks; with the same margins and delay allowed, on the worst plant",
        "marked rows miss the margins that every design is held to, on their own model, or M_s 3 where gain and times "
        "of it are off by the mismatch; they and rows that were unstable on a plant have no rank",
    )


def _seen(conditions: Conditions) -> str:
    converters = f"converters of {conditions.bits} bits" if conditions.bits else "converters without steps"
    return f"sensor noise {conditions.noise * 1e9:g} nm rms, {converters}"
