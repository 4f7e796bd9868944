# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Claims of a paper and their reproduction, one row per claim: as a table, as JSON, and as a page with plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.analysis.metrics import judged_reference
from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import data_uri, envelope, new_figure
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening

_MICRO = 1e6
_REFERENCE = "#222222"
#: Colours of the runs in order; the first run, usually the worst, is in the background.
_COLOURS = ("#b8b8b8", "#d1495b", "#1f6fb2", "#2a9d8f", "#e09f3e")


def traces_comparison(runs: dict[str, Recording], window: tuple[float, float]):
    """Return the figure of displacements [µm] in several runs of one reference: whole runs, and a window of time.

    Units: ``window`` [s].
    """
    figure, axes = new_figure(3.8, 2)
    first = next(iter(runs.values()))
    for axis, (start, stop) in zip(axes, ((first.time[0], first.time[-1]), window), strict=True):
        for (label, run), colour in zip(runs.items(), _COLOURS, strict=False):
            shown = (run.time >= start) & (run.time <= stop)
            time, values = envelope(run.time[shown], run["displacement"][shown] * _MICRO)
            axis.plot(time, values, color=colour, linewidth=1.3, label=label)
        shown = (first.time >= start) & (first.time <= stop)
        line = dict(color=_REFERENCE, linewidth=1.0, linestyle=(0, (4, 3)), label="reference", drawstyle="steps-post")
        axis.plot(first.time[shown], judged_reference(first)[shown] * _MICRO, **line)
        axis.set(xlabel="time [s]", ylabel="displacement [µm]", xlim=(start, stop))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4, frameon=False, fontsize=9)
    return figure


def loops_comparison(loops: dict[str, tuple[np.ndarray, np.ndarray]]):
    """Return the figure of loops side by side [µm], with their widths in the titles."""
    figure, axes = new_figure(4.4, len(loops))
    for axis, (label, (reference, displacement)), colour in zip(axes, loops.items(), _COLOURS[1:], strict=False):
        low, high = np.min(reference) * _MICRO, np.max(reference) * _MICRO
        axis.plot([low, high], [low, high], color=_REFERENCE, linewidth=0.8, linestyle=(0, (4, 3)))
        axis.plot(reference * _MICRO, displacement * _MICRO, color=colour, linewidth=1.2)
        opening = loop_opening(reference, displacement)
        width = "no loop" if opening is None else f"{100.0 * opening / np.ptp(reference):.3g} % of stroke"
        axis.set_title(f"{label}: {width}", fontsize=11)
        axis.set(xlabel="reference [µm]", ylabel="displacement [µm]")
    return figure


def loops_overlay(panels: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]):
    """Return the figure of overlaid loops [V, µm], with panels side by side."""
    figure, axes = new_figure(4.4, len(panels))
    for axis, (title, loops) in zip(axes, panels.items(), strict=True):
        for number, ((label, (voltage, displacement)), colour) in enumerate(
            zip(loops.items(), _COLOURS[1:], strict=False)
        ):
            style = dict(linewidth=2.2 - 1.2 * bool(number), linestyle="--" if number else "-")
            axis.plot(voltage, displacement * _MICRO, color=colour, label=label, **style)
        axis.set_title(title, fontsize=11)
        axis.set(xlabel="voltage [V]", ylabel="displacement [µm]")
        axis.legend(frameon=False, fontsize=9)
    return figure


def prediction_figure(run: Recording):
    """Return the figure of the model's and the true displacement versus time, and of the error [µm, s]."""
    figure, (whole, error) = new_figure(3.6, 2)
    for name, colour, width in (("displacement", _COLOURS[0], 2.4), ("estimated", _COLOURS[2], 1.0)):
        label = "truth" if name == "displacement" else "model"
        whole.plot(*envelope(run.time, run[name] * _MICRO), color=colour, linewidth=width, label=label)
    left = (run["estimated"] - run["displacement"]) * _MICRO
    error.plot(*envelope(run.time, left), color=_COLOURS[1], linewidth=0.9)
    whole.set(xlabel="time [s]", ylabel="displacement [µm]")
    whole.legend(frameon=False, fontsize=9)
    error.set(xlabel="time [s]", ylabel="error [µm]")
    return figure


def response_figure(frequency, measured, fitted):
    """Return the Bode plot of a measured frequency response and a fit [Hz, dB, degrees].

    Units: ``frequency`` [Hz].
    """
    figure, (gain, phase) = new_figure(3.6, 2)
    for label, values, colour, width in (
        ("measured", measured, _COLOURS[0], 2.4),
        ("fit", fitted, _COLOURS[1], 1.0),
    ):
        gain.plot(frequency, 20.0 * np.log10(np.abs(values)), color=colour, linewidth=width, label=label)
        angle = np.degrees(np.unwrap(np.angle(values)))
        phase.plot(frequency, angle, color=colour, linewidth=width)
    gain.set(xlabel="frequency [Hz]", ylabel="gain [dB]")
    phase.set(xlabel="frequency [Hz]", ylabel="phase [°]")
    gain.legend(frameon=False, fontsize=9)
    return figure


def errors_comparison(errors: dict[str, tuple[np.ndarray, np.ndarray]], smaller: tuple[str, ...] = ()):
    """Return the figure of errors versus time [µm, s]: first all runs, then the runs without large errors."""
    figure, axes = new_figure(3.6, 2 if smaller else 1)
    for axis, chosen in zip(axes, (tuple(errors), smaller), strict=False):
        axis.axhline(0.0, color=_REFERENCE, linewidth=0.8)
        for (label, (time, error)), colour in zip(errors.items(), _COLOURS, strict=False):
            if label in chosen:
                axis.plot(*envelope(time, error * _MICRO), color=colour, linewidth=1.2, label=label)
        axis.set(xlabel="time [s]", ylabel="error [µm]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4, frameon=False, fontsize=9)
    return figure


def responses_comparison(frequency, responses: dict[str, np.ndarray]):
    """Return the Bode plot of several frequency responses on a logarithmic axis [Hz, dB, degrees].

    Units: ``frequency`` [Hz].
    """
    figure, (gain, phase) = new_figure(3.6, 2)
    for number, ((label, values), colour) in enumerate(zip(responses.items(), _COLOURS, strict=False)):
        style = dict(color=colour, linewidth=1.2 if number else 3.0)
        gain.semilogx(frequency, 20.0 * np.log10(np.abs(values)), label=label, **style)
        phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(values))), **style)
    gain.set(xlabel="frequency [Hz]", ylabel="gain [dB]")
    phase.set(xlabel="frequency [Hz]", ylabel="phase [°]")
    gain.legend(frameon=False, fontsize=9)
    return figure


def history_figure(histories: dict[str, np.ndarray]):
    """Return the figure of training errors versus the number of evaluations, on a logarithmic axis."""
    figure, (axis,) = new_figure(3.0)
    for (label, values), colour in zip(histories.items(), _COLOURS[1:], strict=False):
        axis.semilogy(np.arange(1, len(values) + 1), values, color=colour, linewidth=1.3, label=label)
    axis.set(xlabel="evaluation", ylabel="rms error of ±1")
    axis.legend(frameon=False, fontsize=9)
    return figure


@dataclass(frozen=True)
class ClaimsPage:
    """Content of a page of claims."""

    title: str  #: title, summary: Heading, and the result in one line.
    summary: str
    headings: Sequence[str]  #: Headings of the columns.
    #: Heading of a group → the cells of its rows, and whether the claim of each row holds.
    groups: dict[str, list[tuple[Sequence[str], bool | None]]]
    remarks: Sequence[str]  #: remarks, assumptions: Sentences below the table; assumptions are numbered from 1.
    assumptions: Sequence[str]
    configuration: str = ""  #: Text of the configuration; the page shows it at the end.


def write_claims_page(path, page: ClaimsPage, plots) -> None:
    """Write a self-contained page with a table of claims, plots, remarks and assumptions."""
    sources = [dict(caption=caption, source=data_uri(figure)) for caption, figure in plots]
    write_page(path, render_page("claims.html.j2", **vars(page), plots=sources))


#: Displayed units by SI unit: factor, unit, decimals.
SHOWN = {
    "m": (1e6, "µm", 4),
    "s": (1.0, "s", 4),
    "%": (1.0, "%", 4),
    "Hz": (1.0, "Hz", 1),
    "m/V": (1e6, "µm/V", 4),
    "m*s": (1e6, "µm·s", 4),
    "V": (1.0, "V", 2),
    "1/V": (1.0, "1/V", 5),
    "m^2": (1e12, "µm²", 6),
    "N": (1.0, "N", 4),
    "N/m": (1e-6, "N/µm", 4),
    "rad/s": (1.0, "rad/s", 4),
    "1": (1.0, "", 6),
}
HEADINGS = ("row", "quantity", "paper", "here", "unit", "tolerance", "holds", "assumes")


@dataclass(frozen=True)
class Claim:
    """One claim and its reproduction; SI units (``%`` stays per cent)."""

    id: str  #: Name of the row, unique in an experiment.
    group: str  #: Heading of the row.
    quantity: str  #: Reproduced quantity and its conditions.
    measured: float  #: Reproduced value.
    unit: str  #: One of :data:`SHOWN`.
    #: The paper's value, as text if it is not a number; None if the paper gives no value.
    paper: float | str | None = None
    low: float | None = None  #: low, high: Inclusive range of the claim; both None: a row for information.
    high: float | None = None
    #: Whether ``paper`` was computed for the assumed plant instead of published.
    derived: bool = False
    assumptions: tuple[str, ...] = ()  #: Sentences about assumptions where the paper is incomplete.
    reason: str = ""  #: Reason for the result, if needed.
    #: Value of each case, if there are several; ``measured`` is the worst.
    details: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        """Refuse values that neither a table nor JSON can represent."""
        if self.unit not in SHOWN:
            raise ParameterError([Problem(f"{self.id}: unit", self.unit, f"must be one of {', '.join(SHOWN)}")])
        if not math.isfinite(self.measured):
            raise ParameterError([Problem(f"{self.id}: measured", self.measured, "must be finite")])

    @property
    def holds(self) -> bool | None:
        """Whether ``measured`` is within the tolerance; None if there is no tolerance."""
        if self.low is None and self.high is None:
            return None
        above = self.low is None or self.measured >= self.low
        below = self.high is None or self.measured <= self.high
        return above and below

    @property
    def tolerance(self) -> str:
        """The tolerance as text, in the displayed unit; empty for a row for information."""
        if self.low is None:
            return "" if self.high is None else f"≤ {self._bound(self.high)}"
        if self.high is None:
            return f"≥ {self._bound(self.low)}"
        return f"{self._bound(self.low)} … {self._bound(self.high)}"

    def _bound(self, value: float) -> str:
        return f"{value * SHOWN[self.unit][0]:.5g}"

    def to_json(self) -> dict:
        """Return the row as JSON data; numbers in SI units, ``tolerance`` as text and as ``low`` and ``high``."""
        return {
            "id": self.id,
            "group": self.group,
            "quantity": self.quantity,
            "paper": self.paper,
            "derived": self.derived,
            "measured": self.measured,
            "unit": self.unit,
            "tolerance": f"{self.tolerance} {SHOWN[self.unit][1]}".strip(),
            "low": self.low,
            "high": self.high,
            "holds": self.holds,
            "assumptions": list(self.assumptions),
            "reason": self.reason,
            "details": dict(self.details),
        }

    def cells(self) -> tuple[str, ...]:
        """Return the cells of the row up to ``holds``, in displayed units."""
        factor, unit, decimals = SHOWN[self.unit]
        paper = "–"
        if isinstance(self.paper, str):
            paper = self.paper
        elif self.paper is not None:
            paper = self._bound(self.paper)
        holds = {True: "yes", False: "NO", None: "–"}[self.holds]
        # adding zero turns −0.0 into 0.0
        here = f"{round(self.measured * factor, decimals) + 0.0:.{decimals}f}"
        return self.id, self.quantity, paper + ("*" if self.derived else ""), here, unit, self.tolerance or "–", holds


@dataclass(frozen=True)
class Reproduction:
    """A repeated experiment.

    Parameters
    ----------
    name : str
        Name of the experiment on the command line.
    title : str
        The paper.
    claims : tuple of Claim
        All rows, in order; rows of one group follow each other.
    runs : dict of str to Recording
        Runs for the plots.
    configuration : str
        Text of the configuration of the runs.
    """

    name: str
    title: str
    claims: tuple[Claim, ...]
    runs: dict[str, Recording]
    configuration: str = ""

    def __str__(self) -> str:
        return format_claims(self)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """All assumptions in order of first use; the table numbers them from 1."""
        return tuple(dict.fromkeys(text for claim in self.claims for text in claim.assumptions))

    def groups(self) -> dict[str, list[Claim]]:
        """Return the rows under their headings."""
        found: dict[str, list[Claim]] = {}
        for claim in self.claims:
            found.setdefault(claim.group, []).append(claim)
        return found

    def cells(self, claim: Claim) -> tuple[str, ...]:
        """Return one cell for each of :data:`HEADINGS`."""
        numbers = [str(self.assumptions.index(text) + 1) for text in claim.assumptions]
        return (*claim.cells(), " ".join(numbers))

    def remarks(self) -> list[str]:
        """Return the reasons, each with the names of all rows that it explains."""
        found: dict[str, list[str]] = {}
        for claim in self.claims:
            if claim.reason:
                found.setdefault(claim.reason, []).append(claim.id)
        return [f"{', '.join(rows)}: {reason}" for reason, rows in found.items()]

    def summary(self) -> str:
        """Return one line with the number of claims that hold."""
        judged = [claim for claim in self.claims if claim.holds is not None]
        failed = [claim.id for claim in judged if not claim.holds]
        text = f"{len(judged) - len(failed)} of {len(judged)} rows hold"
        return f"{text}; not: {', '.join(failed)}" if failed else text

    def to_json(self) -> dict:
        """Return the reproduction as JSON data; the rows are the list under ``claims``."""
        return {"experiment": self.name, "title": self.title, "claims": [claim.to_json() for claim in self.claims]}

    def page(self) -> ClaimsPage:
        """Return the content of the HTML page without the plots."""
        groups: dict[str, list[tuple[Sequence[str], bool | None]]] = {
            name: [(self.cells(claim), claim.holds) for claim in claims] for name, claims in self.groups().items()
        }
        return ClaimsPage(
            self.title, self.summary(), HEADINGS, groups, self.remarks(), self.assumptions, self.configuration
        )


def format_claims(reproduction: Reproduction) -> str:
    """Return the table for a terminal: rows under their headings, then remarks and assumptions."""
    rows = {claim.id: reproduction.cells(claim) for claim in reproduction.claims}
    widths = [max(map(len, column)) for column in zip(HEADINGS, *rows.values(), strict=True)]

    def line(cells):
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        padded[3] = cells[3].rjust(widths[3])
        return "  ".join(padded).rstrip()

    lines = [reproduction.title, "", line(HEADINGS), line(["-" * width for width in widths])]
    for heading, claims in reproduction.groups().items():
        lines += [heading, *(line(rows[claim.id]) for claim in claims), ""]
    lines.append(reproduction.summary())
    if any(claim.derived for claim in reproduction.claims):
        lines.append("* calculated for the assumed plant; the paper itself prints no such number")
    lines += ["", "Remarks", *(f"- {remark}" for remark in reproduction.remarks())]
    lines += ["", "Assumptions", *(f"{i}  {text}" for i, text in enumerate(reproduction.assumptions, 1))]
    return "\n".join(lines)
