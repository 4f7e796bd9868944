# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs a campaign: way by way, mishap by mishap."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.campaign.actions import ACTIONS
from hysteresis_ros.nodes.campaign.rig import Rig
from hysteresis_ros.reliability.bounds import prepared
from hysteresis_ros.reliability.judge import Verdict, judged
from hysteresis_ros.reliability.mishaps import FUSED, Mishap
from hysteresis_ros.reliability.trace import Trace


@dataclass(frozen=True)
class Campaign:
    """What is to be done, to which axis.

    Parameters
    ----------
    configuration : Configuration
    mishaps : tuple of Mishap
    ways : tuple of str
    rounds : int
        How often each is done, at other moments.
    seed : int
        Of the moments.
    folder : pathlib.Path
        For files that are not kept.
    """

    configuration: Configuration
    mishaps: tuple[Mishap, ...]
    ways: tuple[str, ...]
    rounds: int
    seed: int
    folder: pathlib.Path

    def run(self, tell: Callable[[Verdict], None]) -> list[Verdict]:
        """Do it all; return what came of it.

        Parameters
        ----------
        tell : callable
            Gets each verdict as soon as it is known; of a fused axis that is when its recording is complete.

        Raises
        ------
        ConfigurationError, ParameterError
            The configuration cannot be run so.
        HysteresisError
            An axis does not start.
        """
        found: list[Verdict] = []
        for way in self.ways:
            axis = prepared(self.configuration, way, f"/faults_{os.getpid()}_{way}")
            mishaps = [mishap for mishap in self.mishaps if way in mishap.ways]
            series = _Series(axis, way, self.folder, np.random.default_rng(self.seed))
            for verdict in series.of(mishaps, self.rounds):
                tell(verdict)
                found.append(verdict)
        return found


class _Series:
    """Mishaps on one axis in one way of running; an axis that does not recover is replaced by a new one."""

    def __init__(self, axis, way: str, folder: pathlib.Path, random: np.random.Generator):
        self._axis, self._way, self._folder, self._random = axis, way, folder, random
        self._rigs = 0

    def of(self, mishaps: Iterable[Mishap], rounds: int) -> Iterable[Verdict]:
        """Do them; yield what came of each."""
        todo = [(mishap, amount) for mishap in mishaps for amount in mishap.amounts for _ in range(rounds)]
        while todo:
            rig = self._rig()
            seen: list[tuple[Mishap, Trace]] = []
            try:
                while todo and (not seen or np.isfinite(seen[-1][1].recovered)):
                    mishap, amount = todo.pop(0)
                    seen.append((mishap, rig.endure(mishap, amount, ACTIONS[mishap.action])))
                    if self._way != FUSED:
                        yield judged(seen[-1][1], mishap, rig.bounds)
            finally:
                left = rig.close()
            if self._way == FUSED:
                samples = rig.recorded()
                for mishap, trace in seen:
                    yield judged(trace.with_samples(samples), mishap, rig.bounds)
            if left:
                raise HysteresisError(f"{self._way}, at the end: {'; '.join(left)}")

    def _rig(self) -> Rig:
        self._rigs += 1
        return Rig(self._axis, self._way, self._folder / f"{self._way}{self._rigs}", self._random)
