# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Claims of a paper beside what was found here: one row a claim, as a table for people and as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hysteresis_ros.analysis.comparison import ClaimsPage
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.recordings.dataset import Recording

#: What people read instead of an SI unit: factor, unit, decimals.
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
    """One claim and what was found; SI units (``%`` stays per cent).

    Parameters
    ----------
    id : str
        Name of the row, unique in an experiment.
    group : str
        Heading under which the row stands.
    quantity : str
        What is measured, under which conditions.
    measured : float
        What was found.
    unit : str
        One of :data:`SHOWN`.
    paper : float, str or None
        The paper's value, in words where it gives no number; None where it says nothing.
    low, high : float or None
        Inclusive range in which the claim holds; both None: a row for information.
    derived : bool
        The value beside ``paper`` was worked out for the assumed plant; the paper itself does not print it.
    assumptions : tuple of str
        What the paper leaves open and was assumed, in sentences.
    reason : str
        Why the row comes out as it does, where that needs saying.
    details : dict of str to float
        The cases of which ``measured`` is the worst, where there are several.

    Raises
    ------
    ParameterError
        ``measured`` is not finite or the unit is unknown.
    """

    id: str
    group: str
    quantity: str
    measured: float
    unit: str
    paper: float | str | None = None
    low: float | None = None
    high: float | None = None
    derived: bool = False
    assumptions: tuple[str, ...] = ()
    reason: str = ""
    details: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        """Refuse what no table and no JSON can hold."""
        if self.unit not in SHOWN:
            raise ParameterError([Problem(f"{self.id}: unit", self.unit, f"must be one of {', '.join(SHOWN)}")])
        if not math.isfinite(self.measured):
            raise ParameterError([Problem(f"{self.id}: measured", self.measured, "must be finite")])

    @property
    def holds(self) -> bool | None:
        """Whether ``measured`` is within the tolerance; None without one."""
        if self.low is None and self.high is None:
            return None
        above = self.low is None or self.measured >= self.low
        below = self.high is None or self.measured <= self.high
        return above and below

    @property
    def tolerance(self) -> str:
        """The tolerance in words, in the unit shown; empty for a row for information."""
        if self.low is None and self.high is None:
            return ""
        if self.low is None:
            return f"≤ {self._bound(self.high)}"
        if self.high is None:
            return f"≥ {self._bound(self.low)}"
        return f"{self._bound(self.low)} … {self._bound(self.high)}"

    def _bound(self, value: float) -> str:
        return f"{value * SHOWN[self.unit][0]:.5g}"

    def to_json(self) -> dict:
        """Return everything JSON can hold; numbers in SI units, ``tolerance`` in words and as ``low`` and ``high``."""
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
        """Return the cells of the row up to ``holds``, in units for people."""
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
        Runs that the plots show.
    configuration : str
        Text of the configuration the runs rest on.
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
        """Return the reasons of rows, rows of the same reason together."""
        found: dict[str, list[str]] = {}
        for claim in self.claims:
            if claim.reason:
                found.setdefault(claim.reason, []).append(claim.id)
        return [f"{', '.join(rows)}: {reason}" for reason, rows in found.items()]

    def summary(self) -> str:
        """Return in one line how many claims hold."""
        judged = [claim for claim in self.claims if claim.holds is not None]
        failed = [claim.id for claim in judged if not claim.holds]
        text = f"{len(judged) - len(failed)} of {len(judged)} rows hold"
        return f"{text}; not: {', '.join(failed)}" if failed else text

    def to_json(self) -> dict:
        """Return the whole as JSON holds it; the rows are the list under ``claims``."""
        return {"experiment": self.name, "title": self.title, "claims": [claim.to_json() for claim in self.claims]}

    def page(self) -> ClaimsPage:
        """Return what stands on the HTML page, but for the plots."""
        groups = {
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
        lines.append("* worked out for the assumed plant; the paper itself prints no such number")
    lines += ["", "Remarks", *(f"- {remark}" for remark in reproduction.remarks())]
    lines += ["", "Assumptions", *(f"{i}  {text}" for i, text in enumerate(reproduction.assumptions, 1))]
    return "\n".join(lines)
