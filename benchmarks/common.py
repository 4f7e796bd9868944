# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the benchmarks: ratios from interleaved repeats, the table, the exit code."""

from __future__ import annotations

import argparse
import contextlib
import datetime
import json
import os
import pathlib
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from hysteresis_ros.models.block import COMPILED

#: The axis of most benchmarks: Kim, Kim & Park 2009, with quantiser, compensator and observer.
CONFIGURATION = pathlib.Path(__file__).parent.parent / "config" / "kim2009.yaml"


class BenchmarkError(Exception):
    """A benchmark cannot run; the message names what is missing."""


@dataclass(frozen=True)
class Result:
    """One figure with its target.

    Parameters
    ----------
    name : str
        Name of the measured quantity.
    value : float
        The figure.
    limit : str
        ``at least`` or ``at most``.
    target : float
        The target.
    detail : str
        The figures from which the value was calculated.
    """

    name: str
    value: float
    limit: str
    target: float
    detail: str = ""

    @property
    def holds(self) -> bool:
        """Whether the target is met."""
        return bool(self.value >= self.target if self.limit == "at least" else self.value <= self.target)


def parser(description: str, **defaults) -> argparse.ArgumentParser:
    """Return the parser of the options that all benchmarks have."""
    made = argparse.ArgumentParser(description=description)
    made.add_argument("--json", metavar="F", help="also write the figures to this JSON file")
    repeats = defaults.get("repeats")
    if repeats:
        made.add_argument("--repeats", type=int, default=repeats, help=f"number of repeats (default {repeats})")
    return made


def realtime_parser(description: str, seconds: float, turns: int) -> argparse.ArgumentParser:
    """Return the parser for benchmarks of loops in real time, in turns with a C loop."""
    made = parser(description)
    made.add_argument("--seconds", type=float, default=seconds, help=f"length of a turn [s] (default {seconds:g})")
    made.add_argument("--turns", type=int, default=turns, help=f"number of turns (default {turns})")
    made.add_argument("--priority", type=int, default=80, help="SCHED_FIFO priority; 0: normal (default 80)")
    made.add_argument("--cpu", type=int, default=-1, help="core of the loops; -1: any (default -1)")
    return made


def require_compiled() -> None:
    """Raise BenchmarkError if the kernels are not compiled."""
    if not COMPILED:
        raise BenchmarkError("Numba is missing or switched off: there is no compiled loop to measure")


@contextlib.contextmanager
def busy_core() -> Iterator[None]:
    """Keep one core busy with another program."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        try:
            yield
        finally:
            busy.kill()


def machine() -> dict:
    """Return the date, the machine and the versions, on which the figures depend."""
    processor = platform.processor() or platform.machine()
    info = pathlib.Path("/proc/cpuinfo")
    if info.exists():
        lines = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        processor = lines[0].split(":", 1)[1].strip() if lines else processor
    return {
        "date": datetime.date.today().isoformat(),
        "cores": len(os.sched_getaffinity(0)),
        "processor": processor,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def report(results: list[Result], options) -> int:
    """Print the table, write the JSON file if requested, and return the exit code: 1 if a target is missed."""
    about = machine()
    print(f"{about['date']}, {about['cores']} cores, {about['processor']}, {about['python']}")
    width = max(len(result.name) for result in results)
    for result in results:
        verdict = f"{result.limit} {result.target:<5g}  holds: {'yes' if result.holds else 'NO':3}"
        print(f"{result.name:{width}}  {result.value:8.3g}  {verdict}  {result.detail}")
    if options.json:
        rows = [asdict(result) | {"holds": result.holds} for result in results]
        text = json.dumps({"machine": about, "results": rows}, indent=2)
        pathlib.Path(options.json).write_text(text + "\n", encoding="utf-8")
    return 0 if all(result.holds for result in results) else 1


def run(main) -> None:
    """Run the ``main`` of a benchmark; if it cannot run, print one line with the reason, and exit with code 2."""
    try:
        raise SystemExit(main())
    except BenchmarkError as error:
        print(f"error: {error}")
        raise SystemExit(2) from None


def cpu_seconds(function) -> float:
    """Return the processor time of this thread [s] for ``function()``, on which other programs have little effect."""
    start = time.thread_time_ns()
    function()
    return (time.thread_time_ns() - start) * 1e-9


def interleaved(first, second, repeats: int, seconds=cpu_seconds) -> tuple[float, float, float]:
    """Time two functions in turns and return the median ratio first / second and the median time of each [s].

    The two functions of a pair run directly one after the other, in alternating order, so that other work of the
    machine affects both. A ratio is calculated for each pair.
    """
    times: list[tuple[float, float]] = []
    for index in range(repeats):
        if index % 2:
            later = seconds(second)
            times.append((seconds(first), later))
        else:
            times.append((seconds(first), seconds(second)))
    ratio = statistics.median(a / b for a, b in times)
    return ratio, statistics.median(a for a, _ in times), statistics.median(b for _, b in times)


def resident_megabytes() -> float:
    """Return the resident memory of this process [MB] (Linux)."""
    pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
