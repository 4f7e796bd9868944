# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which runs a sweep makes: all levels together, draws at each of them, or the points that a sensitivity asks for.

Run i stands at level i mod L of the L combinations of levels and takes draw i div L of the distributions, so that all
levels meet the same draws, and a longer sweep begins with the shorter one. Draw j of D distributions is numbers j D …
(j + 1) D - 1 of the PCG64 generator of the seed: a point depends on seed and number only, not on who computes it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.sweeps.ranges import Levels
from hysteresis_ros.sweeps.variations import Variation

#: Runs where there are distributions and nobody says how many.
DRAWS = 1000
#: Most runs of one sweep.
MOST_RUNS = 10**9
RANDOM, SOBOL, MORRIS = "random", "sobol", "morris"
MORRIS_LEVELS = 4


@dataclass(frozen=True)
class Plan:
    """The points of a sweep.

    Parameters
    ----------
    variations : tuple of Variation
    runs : int
        How many.
    seed : int
        Of the draws.
    design : str
        ``random``, or ``sobol`` or ``morris`` for a sensitivity.
    """

    variations: tuple[Variation, ...]
    runs: int
    seed: int = 1
    design: str = RANDOM

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of levels of the variations that have some."""
        return tuple(len(one.over.values) for one in self.variations if isinstance(one.over, Levels))

    @property
    def combinations(self) -> int:
        """How many combinations of levels there are."""
        return math.prod(self.counts)

    @property
    def spreads(self) -> int:
        """How many distributions there are."""
        return len(self.variations) - len(self.counts)

    def points(self, numbers: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the points of some runs, shape (runs, variations): numbers of levels and places in distributions.

        Parameters
        ----------
        numbers : sequence of int, or ndarray
            Ascending, without gaps.
        """
        numbers = np.arange(int(numbers[0]), int(numbers[-1]) + 1)
        found = np.empty((len(numbers), len(self.variations)))
        if self.design != RANDOM:
            found[:] = self.designed[numbers]
            for i, one in enumerate(self.variations):
                if isinstance(one.over, Levels):
                    count = len(one.over.values)
                    found[:, i] = np.minimum(np.floor(found[:, i] * count), count - 1)
            return found
        stepped = [isinstance(one.over, Levels) for one in self.variations]
        if self.counts:
            found[:, stepped] = np.transpose(np.unravel_index(numbers % self.combinations, self.counts))
        if self.spreads:
            draws = numbers // self.combinations
            first = int(draws[0])
            generator = np.random.PCG64(self.seed).advance(first * self.spreads)
            places = np.random.Generator(generator).random((int(draws[-1]) - first + 1, self.spreads))
            found[:, np.logical_not(stepped)] = places[draws - first]
        return found

    @property
    def problem(self) -> dict:
        """The variations as SALib names them, on the unit cube."""
        count = len(self.variations)
        return {"num_vars": count, "names": [one.label for one in self.variations], "bounds": [[0.0, 1.0]] * count}

    @functools.cached_property
    def designed(self) -> np.ndarray:
        """The points that a sensitivity asks for, on the unit cube, shape (runs, variations)."""
        from SALib.sample import morris, sobol

        if self.design == SOBOL:
            base = self.runs // (len(self.variations) + 2)
            return sobol.sample(self.problem, base, calc_second_order=False, seed=self.seed)
        trajectories = self.runs // (len(self.variations) + 1)
        return morris.sample(self.problem, trajectories, num_levels=MORRIS_LEVELS, seed=self.seed)


def make_plan(variations: tuple[Variation, ...], runs: int | None = None, seed: int = 1, design: str = RANDOM) -> Plan:
    """Return the plan of a sweep.

    Parameters
    ----------
    variations : tuple of Variation
    runs : int, optional
        How many; by default all levels once, or :data:`DRAWS` where there are distributions. A sensitivity takes the
        largest number that its design has below.
    seed : int
    design : str

    Raises
    ------
    ConfigurationError
        Nothing varies, there are more levels than runs, or too few runs for a sensitivity.
    """
    if not variations:
        raise ConfigurationError("nothing varies: give --vary NODE.PARAMETER=RANGE")
    plan = Plan(variations, 0, seed, design)
    levels, spreads = plan.combinations, plan.spreads
    asked = runs if runs is not None else (max(DRAWS, levels) if spreads or design != RANDOM else levels)
    if not 1 <= asked <= MOST_RUNS:
        raise ConfigurationError(f"--runs {asked}: must be 1 … {MOST_RUNS:.0e}; the levels are {levels} together")
    if design == RANDOM:
        if asked < levels:
            raise ConfigurationError(
                f"--runs {asked}: the levels are {levels} together: give at least so many runs, or fewer levels"
            )
        return Plan(variations, asked if spreads else levels, seed, design)
    count = len(variations)
    if design == SOBOL:
        base = 2 ** int(math.log2(max(asked // (count + 2), 1)))  # the sequence is even for powers of two only
        least, made = 4 * (count + 2), base * (count + 2)
    else:
        least, made = 4 * (count + 1), asked // (count + 1) * (count + 1)
    if made < least:
        raise ConfigurationError(f"--runs {asked}: --sensitivity {design} of {count} variations needs at least {least}")
    return Plan(variations, made, seed, design)
