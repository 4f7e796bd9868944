# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures for human readers: numbers with units, and rows and tables for pages and terminals."""

from __future__ import annotations

from collections.abc import Sequence

from hysteresis_ros.analysis.metrics import FIGURES
from hysteresis_ros.analysis.parts import JUDGED_BY, NOT_JUDGED, Kind
from hysteresis_ros.units import FINE

#: Units of figures, and the unit a thousand times smaller than each.
FINER = {"µm": "nm", "µm s": "nm s", "µm/s": "nm/s", "ms": "µs", "V": "mV"}


def shown(value, unit: str, factor: float) -> tuple[str, str]:
    """Return a figure as text, and its unit; small values get the finer unit: 12.3 nm instead of 0.0123 µm."""
    if value and unit in FINER and abs(value) * factor < FINE:
        return format_value(value, 1e3 * factor), FINER[unit]
    return format_value(value, factor), unit


def shown_row(label: str, value, unit: str, factor: float) -> dict:
    """Return a row of a page's table: label, and the value and unit of :func:`shown`."""
    text, finer = shown(value, unit, factor)
    return dict(label=label, value=text, unit=finer)


#: Short names of the figures of parts of a run.
_SHORT = {
    "rms_error_m": "RMS error",
    "max_error_m": "maximum",
    "loop_width_percent": "loop width",
    "overshoot_percent": "overshoot",
    "settling_time_s": "settling",
    "steady_state_error_m": "final error",
}
_UNITS = {name: (unit.removesuffix(" of stroke"), factor) for name, _, unit, factor in FIGURES}


def part_rows(figures: dict) -> list[dict]:
    """Return the parts of a run as text: ``part``, ``span`` [s], and its figures as ``text``."""
    return [
        dict(part=one["part"], span=f"{one['from_s']:.5g} … {one['to_s']:.5g} s", text=_judgement(one))
        for one in figures.get("parts", ())
    ]


def _judgement(one: dict) -> str:
    kind = Kind(one["part"])
    if kind in NOT_JUDGED:
        return NOT_JUDGED[kind]
    said = []
    for name in JUDGED_BY[kind]:
        if name.endswith("_percent_of_stroke"):
            continue
        if one[name] is None and name in ("loop_width_percent", "overshoot_percent"):
            continue
        share = one.get(name.removesuffix("_m") + "_percent_of_stroke")
        value = "none" if one[name] is None else " ".join(shown(one[name], *_UNITS[name]))
        said.append(f"{_SHORT[name]} {value}" + (f" ({share:.3g} % of stroke)" if share is not None else ""))
        if name == "max_error_m" and "against" in one:
            said[-1] += f" against {one['against']}"
    text = ", ".join(said)
    if kind is Kind.STEPS:
        text += f"; worst of {one['steps']} step{'s' if one['steps'] != 1 else ''}"
        text += f", {one['unsettled']} do not settle" if one.get("unsettled") else ""
    if "periods" in one:
        over = "over" if kind is Kind.SCAN else "repeats for"
        whole = "whole period" if one["periods"] == 1 else "whole periods"
        text += f" {over} {one['periods']} {whole} of {' '.join(shown(one['period_s'], 'ms', 1e3))}"
    return text


def leading(columns: Sequence[dict]) -> tuple:
    """Return :data:`~hysteresis_ros.analysis.metrics.FIGURES`, with the figures of the longest part first."""
    lasting: dict[str, float] = {}
    for one in (one for figures in columns for one in figures.get("parts", ())):
        if one["part"] in (Kind.STEPS, Kind.SCAN, Kind.PATH):
            lasting[one["part"]] = lasting.get(one["part"], 0.0) + one["to_s"] - one["from_s"]
    first = [name for kind in sorted(lasting, key=lasting.__getitem__, reverse=True) for name in JUDGED_BY[Kind(kind)]]
    order = {name: place for place, name in enumerate(dict.fromkeys(first))}
    return tuple(sorted(FIGURES, key=lambda row: order.get(row[0], len(order))))


def format_table(figures: dict) -> str:
    """Return parts and figures as aligned lines for a terminal, then the reasons for missing figures, and the notes."""
    rows = [(label, *shown(figures[name], unit, factor)) for name, label, unit, factor in leading([figures])]
    width = max(len(label) for label, *_ in rows)
    lines = format_parts(figures)
    lines += [f"{label:<{width}}  {value:>9} {unit}".rstrip() for label, value, unit in rows]
    reasons: dict[str, list[str]] = {}
    for name, label, *_ in FIGURES:
        if name in figures["notes"]:
            reasons.setdefault(figures["notes"][name], []).append(label)
    lines += [f"{'; '.join(dict.fromkeys(labels))}: {reason}" for reason, labels in reasons.items()]
    return "\n".join([*lines, *(f"note: {note}" for note in figures["notes"]["recording"])])


def format_parts(figures: dict, name: str = "") -> list[str]:
    """Return the parts of a run as aligned lines for a terminal, preceded by the name of the run if it has one."""
    rows = part_rows(figures)
    wide = max((len(row["part"]) for row in rows), default=0), max((len(row["span"]) for row in rows), default=0)
    before = f"{name}: " if name else ""
    return [f"{before}{row['part']:<{wide[0]}}  {row['span']:>{wide[1]}}  {row['text']}" for row in rows]


def format_value(value, factor: float = 1.0) -> str:
    """Return a number as text: a float with four significant digits, an integer in full, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, int):
        return str(value)
    return f"{value * factor:.4g}"


def beside(values: Sequence, unit: str, factor: float) -> tuple[list[str], str]:
    """Return figures as texts with a common unit: the finer one if even the largest value is small."""
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    if unit in FINER and 0.0 < largest * factor < FINE:
        unit, factor = FINER[unit], 1e3 * factor
    return [format_value(value, factor) for value in values], unit


def table_of(columns: Sequence[dict], names: Sequence[tuple] = FIGURES) -> list[dict]:
    """Return the rows of a page's table of figures: label, cells, units, and reasons for empty cells."""
    rows = []
    for name, label, unit, factor in names:
        cells, finer = beside([figures[name] for figures in columns], unit, factor)
        remarks = dict.fromkeys(figures.get("notes", {}).get(name, "") for figures in columns)
        row = dict(name=name, label=label, cells=cells, shown_unit=finer, unit=unit, factor=factor)
        rows.append(row | dict(remark="; ".join(filter(None, remarks))))
    return rows


def aligned(rows: Sequence[tuple[str, Sequence[str], str]]) -> list[str]:
    """Return rows as aligned lines for a terminal: label, cells and unit."""
    width = max(len(label) for label, *_ in rows)
    cells = [max(len(row[1][i]) for row in rows) for i in range(len(rows[0][1]))]
    return [
        f"{label:<{width}}  "
        + "  ".join(f"{value:>{size}}" for value, size in zip(values, cells, strict=True))
        + (f"  {unit}" if unit else "")
        for label, values, unit in rows
    ]
