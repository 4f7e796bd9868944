# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One run of a sweep, and several of them as a job for any process."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hysteresis_ros
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.simulation.reach import check_reach
from hysteresis_ros.sweeps.judging import judged
from hysteresis_ros.sweeps.variations import PLANT, Variation, varied

#: Kernels are compiled, and Python runs, in one thread at a time: the others of a worker wait.
_ONE_AT_A_TIME = threading.Lock()
#: A block of so many bytes is had and given back before the runs: from then on the C library of Linux keeps what the
#: runs give back. Otherwise the system hands out every page of their tables anew, 440 pages a run.
KEPT = 31 * 2**20


class Runs(NamedTuple):
    """What became of some runs that follow each other.

    Parameters
    ----------
    first : int
        Number of the first of them.
    rows : list of list of float
        Metrics of each, and whether its axis tripped.
    refused : dict of int to str
        Number of each run whose axis cannot be built, and why.
    """

    first: int
    rows: list[list[float]]
    refused: dict[int, str]


@dataclass(frozen=True, eq=False)
class Study:
    """What each run of a sweep is.

    Parameters
    ----------
    axis : AxisParameters
        As configured.
    variations : tuple of Variation
    metrics : tuple of str
    version : str
        Of the package whose code is to make the runs.
    """

    axis: AxisParameters
    variations: tuple[Variation, ...]
    metrics: tuple[str, ...]
    version: str = hysteresis_ros.__version__

    @property
    def samples(self) -> int:
        """Samples of a run as configured; 0 when it has no end."""
        return Axis(self.axis).default_samples()

    @functools.cached_property
    def _of_plant(self) -> bool:
        """Whether only the plant varies, which what an axis believes that it can reach does not know."""
        return all(one.node == PLANT for one in self.variations)

    def runs(self, first: int, points: np.ndarray) -> Runs:
        """Make some runs, each of an axis at rest.

        Parameters
        ----------
        first : int
            Number of the first of them.
        points : ndarray, shape (runs, variations)

        Raises
        ------
        ConfigurationError
            This package is of another version than the one that asks.
        """
        if self.version != hysteresis_ros.__version__:
            raise ConfigurationError(
                f"version {hysteresis_ros.__version__} of the package is installed where this should run, "
                f"{self.version} asks: install the same one"
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
        """Return what builds the axis of a run at rest; where only the plant varies, all else is made but once."""
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
        """Return the metrics of a run and whether it tripped; or why it cannot be made."""
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
        with np.errstate(all="ignore"):  # an unstable loop has no bounds
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
    """Make some runs of a study, one after the other, in whatever thread of whatever process.

    Parameters
    ----------
    study : Study
    first : int
        Number of the first of them.
    points : ndarray, shape (runs, variations)
    """
    with _ONE_AT_A_TIME:
        return study.runs(first, points)
