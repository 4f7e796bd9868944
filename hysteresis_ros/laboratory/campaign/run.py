# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run a campaign: each fault case with the axis fused, composed and as processes.

``python -m hysteresis_ros.laboratory.campaign.run '{"config": "picma_stage", …}'`` runs a campaign. The argument is a
JSON object with the keys ``config``, ``only`` and ``ways`` (lists of names), ``rounds``, ``seed``, ``rate``, ``output``
and ``json`` (paths, or empty), and ``add`` (paths).
"""

from __future__ import annotations

import itertools
import json
import math
import os
import pathlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.campaign.actions import ACTIONS, scheduled
from hysteresis_ros.laboratory.campaign.judging import Samples, Trace, Verdict, at_rate, bounds_of, judged, prepared
from hysteresis_ros.laboratory.campaign.mishaps import CATALOGUE, CLOCK, DEVICE, FUSED, RELAY, SMALL_DISK, WAYS, Mishap
from hysteresis_ros.laboratory.campaign.results import Results, conditions, line, load_results, page
from hysteresis_ros.laboratory.campaign.rig import Clock, Device, Rig, small_disk
from hysteresis_ros.nodes.domain import stay_on_this_machine


@dataclass(frozen=True)
class Campaign:
    """Settings of a campaign."""

    config: str  #: Path or name of the configuration.
    mishaps: tuple[Mishap, ...]
    ways: tuple[str, ...]
    rounds: int  #: Number of repetitions of each case, each at new random times.
    seed: int  #: Seed of the random times.
    folder: pathlib.Path  #: Folder for temporary files.
    rate: float = 0.0  #: Sample rate of cases that do not set their own [Hz]; 0: that of the configuration.

    def run(self, tell: Callable[[Verdict], None]) -> list[Verdict]:
        """Run the campaign; return the verdicts."""
        found: list[Verdict] = []
        rates = dict.fromkeys(mishap.rate or self.rate for mishap in self.mishaps)
        for way, rate in itertools.product(self.ways, rates):
            mishaps = [one for one in self.mishaps if way in one.ways and (one.rate or self.rate) == rate]
            if not mishaps:
                continue
            axis = prepared(at_rate(load_configuration(self.config), rate), way, f"/faults_{os.getpid()}_{way}")
            series = _Series(axis, way, self.config, self.folder / f"{rate:g}", np.random.default_rng(self.seed))
            for verdict in series.of(mishaps, self.rounds):
                tell(verdict)
                found.append(verdict)
        return found


class _Series:
    """Fault cases in one way of running; cases with the same test equipment share an axis as long as it recovers."""

    def __init__(self, axis, way: str, config: str, folder: pathlib.Path, random: np.random.Generator):
        self._axis, self._way, self._config, self._folder, self._random = axis, way, config, folder, random
        self._bounds = bounds_of(axis)
        self._rigs = 0

    def of(self, mishaps: Iterable[Mishap], rounds: int) -> Iterable[Verdict]:
        """Run the cases; yield their verdicts."""
        todo = [(mishap, amount) for mishap in mishaps for amount in mishap.amounts for _ in range(rounds)]
        while todo:
            try:
                rig = self._rig(*todo[0])
            except HysteresisError as error:
                yield self._not_begun(*todo.pop(0), str(error))
                continue
            seen: list[tuple[Mishap, Trace]] = []
            try:
                while not seen or (todo and self._goes_on(seen[-1], todo[0][0])):
                    mishap, amount = todo.pop(0)
                    seen.append((mishap, rig.endure(mishap, amount, ACTIONS[mishap.action])))
                    if self._way != FUSED:
                        yield judged(seen[-1][1], mishap, self._bounds)
            finally:
                left = rig.close()
            if self._way == FUSED:
                samples = rig.recorded()
                for mishap, trace in seen:
                    yield judged(trace.with_samples(samples), mishap, self._bounds)
            if left:
                raise HysteresisError(f"{self._way}, at the end of the axis: {'; '.join(left)}")

    def _not_begun(self, mishap: Mishap, amount: float, reason: str) -> Verdict:
        """Return the verdict of a case whose axis could not be started."""
        now = time.time()
        none = Samples.of(())
        trace = Trace(
            mishap.name, self._way, amount, os.getloadavg()[0], now, now, math.nan, (0.0, 0.0), none, (reason,)
        )
        return judged(trace, mishap, self._bounds)

    def _goes_on(self, last: tuple[Mishap, Trace], following: Mishap) -> bool:
        """Return whether the axis can be used for another case."""
        mishap, trace = last
        alone = self._way == FUSED and (mishap.fault or following.fault)
        return bool(np.isfinite(trace.recovered)) and mishap.graph == following.graph and not alone

    def _rig(self, mishap: Mishap, amount: float) -> Rig:
        """Start an axis with the test equipment of a case."""
        self._rigs += 1
        folder, axis = self._folder / f"{self._way}{self._rigs}", self._axis
        options: dict[str, Any] = {}
        folder.mkdir(parents=True)
        if mishap.fault and self._way == FUSED:
            axis = scheduled(axis, mishap, amount, self._bounds)
        elif mishap.graph == RELAY:
            options["relayed"] = True
        elif mishap.graph == SMALL_DISK:
            options["prefix"] = small_disk()
        elif mishap.graph == DEVICE:
            device = options["beside"] = Device(self._config)
            axis = device.driven(axis)
        elif mishap.graph == CLOCK:
            clock = options["beside"] = Clock(folder)
            options["environment"] = clock.environment
        return Rig(axis, self._way, folder, self._random, **options)


#: Exit code when a claim did not hold.
NOT_HELD = 4


def main() -> int:
    """Run the campaign that the JSON argument describes; return the exit code."""
    request = json.loads(sys.argv[1])
    mishaps = tuple(CATALOGUE[name] for name in request["only"])
    ways = tuple(request["ways"])
    try:
        stay_on_this_machine()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        before = conditions()
        with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
            campaign = Campaign(
                request["config"],
                mishaps,
                ways,
                request["rounds"],
                request["seed"],
                pathlib.Path(folder),
                request["rate"],
            )
            verdicts = campaign.run(lambda verdict: print(line(verdict), flush=True))
        config = f"{request['config']} at {request['rate']:g} Hz" if request["rate"] else request["config"]
        _write(request, mishaps, Results(config, tuple(verdicts), before, conditions()))
    except HysteresisError as error:
        print(f"hysteresis: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    failed = {verdict.trace.mishap for verdict in verdicts if verdict.failures}
    print(f"{len(verdicts)} fault cases: {'all held' if not failed else 'not held: ' + ', '.join(sorted(failed))}")
    return NOT_HELD if failed else 0


def _write(request: dict, mishaps: tuple[Mishap, ...], results: Results) -> None:
    """Write the requested files."""
    if request["json"]:
        results.save(pathlib.Path(request["json"]))
    for path in request["add"]:
        results = results.and_of(load_results(pathlib.Path(path)))
    if request["output"]:
        there = {verdict.trace.way for verdict in results.verdicts}
        names = {verdict.trace.mishap for verdict in results.verdicts} | {mishap.name for mishap in mishaps}
        rows = [mishap for name, mishap in CATALOGUE.items() if name in names]
        text = page(rows, [way for way in WAYS if way in there], results)
        pathlib.Path(request["output"]).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
