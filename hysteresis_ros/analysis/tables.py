# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tables of figures, for pages and terminals: values that stand beside each other have one unit."""

from __future__ import annotations

from collections.abc import Sequence

from hysteresis_ros.analysis.metrics import FIGURES
from hysteresis_ros.analysis.shown_figures import FINER, format_value
from hysteresis_ros.units import FINE


def beside(values: Sequence, unit: str, factor: float) -> tuple[list[str], str]:
    """Return figures for people and their unit: the finer one where even the largest is small.

    Parameters
    ----------
    values : sequence of (float, int or None)
        In SI.
    unit : str
        Of the table of figures.
    factor : float
        Number of them in one SI unit.
    """
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    if unit in FINER and 0.0 < largest * factor < FINE:
        unit, factor = FINER[unit], 1e3 * factor
    return [format_value(value, factor) for value in values], unit


def table_of(columns: Sequence[dict], names: Sequence[tuple] = FIGURES) -> list[dict]:
    """Return the rows of a page's table of figures: label, cells, units, and why a cell has no value.

    Parameters
    ----------
    columns : sequence of dict
        Figures of each span or run; their ``notes``, where they have any, say why a figure is missing.
    names : sequence of (str, str, str, float)
        As :data:`hysteresis_ros.analysis.metrics.FIGURES`.
    """
    rows = []
    for name, label, unit, factor in names:
        cells, finer = beside([figures[name] for figures in columns], unit, factor)
        remarks = dict.fromkeys(figures.get("notes", {}).get(name, "") for figures in columns)
        row = dict(name=name, label=label, cells=cells, shown_unit=finer, unit=unit, factor=factor)
        rows.append(row | dict(remark="; ".join(filter(None, remarks))))
    return rows


def aligned(rows: Sequence[tuple[str, Sequence[str], str]]) -> list[str]:
    """Return rows as lines for a terminal: label, cells and unit below each other.

    Parameters
    ----------
    rows : sequence of (str, sequence of str, str)
    """
    width = max(len(label) for label, *_ in rows)
    cells = [max(len(row[1][i]) for row in rows) for i in range(len(rows[0][1]))]
    return [
        f"{label:<{width}}  "
        + "  ".join(f"{value:>{size}}" for value, size in zip(values, cells, strict=True))
        + (f"  {unit}" if unit else "")
        for label, values, unit in rows
    ]
