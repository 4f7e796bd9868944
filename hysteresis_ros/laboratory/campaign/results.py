# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Results of a campaign: conditions, file of figures, and page."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import math
import os
import pathlib
import platform
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace

import hysteresis_ros
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.campaign.judging import Figures, Samples, Trace, Verdict, worst
from hysteresis_ros.laboratory.campaign.mishaps import ALWAYS, Mishap


@dataclass(frozen=True)
class Conditions:
    """Conditions under which the figures were obtained."""

    date: str
    machine: str  #: System, processors, versions.
    load: float  #: Number of runnable processes, averaged over one minute.
    transports: str  #: Transports of DDS, from the environment.


def conditions() -> Conditions:
    """Return the current conditions."""
    words = [
        f"{platform.system()} {platform.release()}",
        f"{os.cpu_count()} cores",
        f"Python {platform.python_version()}",
        f"hysteresis_ros {hysteresis_ros.__version__}",
    ]
    for name in ("numba", "ros-jazzy-rclpy"):
        try:
            words.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    now = datetime.datetime.now(datetime.UTC)
    transports = os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "the default ones")
    return Conditions(f"{now:%Y-%m-%d %H:%M} UTC", ", ".join(words), os.getloadavg()[0], transports)


@dataclass(frozen=True)
class Results:
    """Results of one campaign, or of several together."""

    config: str  #: Configuration of the axis, with its sample rate if that was changed.
    verdicts: tuple[Verdict, ...]
    before: Conditions  #: before, after: Conditions at the beginning and the end.
    after: Conditions

    def and_of(self, other: Results) -> Results:
        """Return these results together with the results of another campaign."""
        if other.config != self.config:
            raise ConfigurationError(
                f"the results to add are of {other.config}, these are of {self.config}: add results of "
                "the same configuration and rate"
            )
        first = min((self.before, other.before), key=lambda when: when.date)
        last = max((self.after, other.after), key=lambda when: when.date)
        return Results(self.config, other.verdicts + self.verdicts, first, last)

    def save(self, path: pathlib.Path) -> None:
        """Write the results as JSON, with the figures but without the samples."""
        rows = [
            {"figures": asdict(one.figures), "failures": one.failures, "trace": _without_samples(one.trace)}
            for one in self.verdicts
        ]
        table = {"config": self.config, "before": asdict(self.before), "after": asdict(self.after), "verdicts": rows}
        path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _without_samples(trace: Trace) -> dict:
    return {name: value for name, value in vars(trace).items() if name != "samples"}


def load_results(path: pathlib.Path) -> Results:
    """Read a file written by :meth:`Results.save`."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        verdicts = tuple(
            Verdict(_trace(row["trace"]), Figures(**row["figures"]), tuple(row["failures"]))
            for row in table["verdicts"]
        )
        return Results(table["config"], verdicts, Conditions(**table["before"]), Conditions(**table["after"]))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: is not a file of hysteresis faults --json: {error}") from None


def _trace(values: dict) -> Trace:
    made = Trace(samples=Samples.of(()), **values)
    low, high = made.asked
    return replace(made, asked=(low, high), broken=tuple(made.broken), notes=tuple(made.notes))


HEAD = """# Fault cases and their outcome

The command `hysteresis faults` wrote this page. It runs real nodes in a separate ROS domain and injects the faults
below. To test your own axis on your machine, with a simulated plant, run
`hysteresis faults my_axis.yaml -o reliability.md`.

Every case requires the following: {always}.

Each cell states whether these requirements and that of the second column were met when the nodes ran in this way.
"Held" means that they were met; "as above" means that only the requirements above apply. The worst figures follow:

- the range of the output voltages of the plant;
- the largest step of the voltage between two samples, divided by the allowed step;
- the displacement beyond the range between rest and setpoints, as a fraction of the stroke, if it is 5 % or more (a
  tenth is allowed, plus the movement at the slew rate while voltages are late and the plant has not yet tripped);
- if the voltage must become safe, the time until it was safe;
- the time from the end of the fault until the axis reached a new setpoint, including that move.

If the way is fused, every sample of the recording is evaluated; if it is composed or processes, every message of the
plant. A diagnostic message of the run is quoted.
"""


#: Maximum number of characters of a diagnostic message in the table.
QUOTED = 90
#: Smallest displacement beyond the setpoints that the table shows, as a fraction of the stroke.
REMARKABLE = 0.05


def _time(seconds: float) -> str:
    return "never" if math.isinf(seconds) else f"{seconds:.2g} s" if seconds < 9.95 else f"{seconds:.0f} s"


def _figures(figures: Figures) -> str:
    words = [f"{figures.lowest:.3g} … {figures.highest:.3g} V, step {figures.step:.2f}"]
    if figures.beyond >= REMARKABLE:
        words.append(f"{100.0 * figures.beyond:.2g} % beyond")
    if not math.isnan(figures.safe):
        words.append(f"safe after {_time(figures.safe)}")
    words.append(f"back after {_time(figures.recovery)}")
    return ", ".join(words)


def line(verdict: Verdict) -> str:
    """Return one line about a fault case."""
    trace = verdict.trace
    name = f"{trace.way}, {trace.mishap}{f' ({trace.amount:g})' if trace.amount else ''}"
    said = f"; said: {trace.said}" if trace.said else ""
    notes = "".join(f"; {note}" for note in trace.notes)
    held = f"NOT HELD: {'; '.join(verdict.failures)}; " if verdict.failures else "held: "
    return f"{name}: {held}{_figures(verdict.figures)}{notes}{said} (load {trace.load:.1f})"


def _cell(mishap: Mishap, way: str, verdicts: list[Verdict]) -> str:
    """Return the table cell of a fault case for one way of running."""
    if way not in mishap.ways:
        return f"does not apply: {mishap.elsewhere}"
    if not verdicts:
        return "not tried"
    failed = [verdict for verdict in verdicts if verdict.failures]
    words = _figures(worst(verdicts))
    said = next((verdict.trace.said for verdict in verdicts if verdict.trace.said), "")
    notes = {re.sub(r"[\d.]+", "", note): note for verdict in verdicts for note in verdict.trace.notes}
    words += "".join(f"; {note}" for note in notes.values())
    words += f"; “{said.split(';')[0][:QUOTED]}”" if said else ""
    if not failed:
        return f"held: {words}"
    reasons = "; ".join(dict.fromkeys(reason for verdict in failed for reason in verdict.failures))
    return f"**not held, {len(failed)} of {len(verdicts)}**: {reasons}; {words}"


def page(mishaps: Iterable[Mishap], ways: Sequence[str], results: Results) -> str:
    """Return the page of the results."""
    verdicts, before, after = results.verdicts, results.before, results.after
    lines = [HEAD.format(always=ALWAYS)]
    loads = [verdict.trace.load for verdict in verdicts] or [before.load]
    lines.append(
        f"{before.date} … {after.date}; axis `{results.config}`; {before.machine}; "
        f"load {min(loads):.1f} … {max(loads):.1f}; DDS transports: {before.transports}."
    )
    heading = None
    for mishap in mishaps:
        if mishap.group != heading:
            heading = mishap.group
            columns = ["what is done", "what must happen", *ways]
            lines += [f"\n## {heading}\n", f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
        mine = [verdict for verdict in verdicts if verdict.trace.mishap == mishap.name]
        cells = [f"**{mishap.name}**: {mishap.done}", mishap.claim or "as above"]
        cells += [_cell(mishap, way, [one for one in mine if one.trace.way == way]) for way in ways]
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
