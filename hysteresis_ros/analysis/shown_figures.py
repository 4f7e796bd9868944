# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures as people read them: numbers in their units, rows and a table."""

from __future__ import annotations

from hysteresis_ros.analysis.metrics import FIGURES
from hysteresis_ros.units import FINE

#: Units of figures and the next finer ones, a thousand times as many.
FINER = {"µm": "nm", "µm s": "nm s", "µm/s": "nm/s", "ms": "µs", "V": "mV"}


def shown(value, unit: str, factor: float) -> tuple[str, str]:
    """Return a figure for people and its unit: small ones in the finer unit, 12.3 nm and not 0.0123 µm.

    Parameters
    ----------
    value : float, int or None
        In SI.
    unit : str
        Of the table of figures.
    factor : float
        Number of them in one SI unit.
    """
    if value and unit in FINER and abs(value) * factor < FINE:
        return format_value(value, 1e3 * factor), FINER[unit]
    return format_value(value, factor), unit


def shown_row(label: str, value, unit: str, factor: float) -> dict:
    """Return a row of a page's table: label, value and unit for people, see :func:`shown`.

    Parameters
    ----------
    label : str
    value : float, int or None
        In SI.
    unit : str
    factor : float
    """
    text, finer = shown(value, unit, factor)
    return dict(label=label, value=text, unit=finer)


def format_table(figures: dict) -> str:
    """Return the figures as aligned lines for a terminal, in the units people use; below why one has no meaning."""
    rows = [(label, *shown(figures[name], unit, factor)) for name, label, unit, factor in FIGURES]
    width = max(len(label) for label, *_ in rows)
    lines = [f"{label:<{width}}  {value:>9} {unit}".rstrip() for label, value, unit in rows]
    reasons: dict[str, list[str]] = {}
    for name, label, *_ in FIGURES:
        if name in figures["notes"]:
            reasons.setdefault(figures["notes"][name], []).append(label)
    lines += [f"{'; '.join(dict.fromkeys(labels))}: {reason}" for reason, labels in reasons.items()]
    return "\n".join([*lines, *(f"note: {note}" for note in figures["notes"]["recording"])])


def format_value(value, factor: float = 1.0) -> str:
    """Return a number for people: four significant digits, whole numbers as they are, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, int):
        return str(value)
    return f"{value * factor:.4g}"
