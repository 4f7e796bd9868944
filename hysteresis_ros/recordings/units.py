# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Names of columns and the units they declare, such as ``[Volt]``, ``(µm)``, ``control_V`` and ``ai0:10um/V``."""

from __future__ import annotations

import re

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.signals import UNITS as SIGNAL_UNITS
from hysteresis_ros.units import UNITS, conversion

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({<](?P<unit>[^\[\](){}<>]+)[\])}>]$")
_AFTER = re.compile(r"^(?P<name>.+?)(?:\s*/\s*|\s+in\s+|\s*:\s*|,\s*|\s+)(?P<unit>\S+)$")


def named_column(cell: str) -> tuple[str, str | None]:
    """Split a cell of a header into the column's name and the unit it declares, None where nothing tells it.

    Parameters
    ----------
    cell : str
        ``time [s]``, ``Spannung / V``, ``ai0:10um/V``, ``control_V`` …
    """
    cell = cell.strip()
    for pattern in (_BRACKETS, _AFTER):
        found = pattern.match(cell)
        if found and (pattern is _BRACKETS or conversion(found["unit"])):
            return found["name"].strip(), column_unit(found["name"].strip(), found["unit"].strip())
    return cell, column_unit(cell)


def column_unit(name: str, header_unit: str | None = None) -> str | None:
    """Return the unit a column declares: in its header, by a known signal name, or as suffix (``control_V``).

    Parameters
    ----------
    name : str
        Name of the column.
    header_unit : str, optional
        What stood beside the name.

    Returns
    -------
    str or None
        A unit that :func:`conversion` knows, or whatever stood in the header; None where nothing tells the unit.
    """
    suffix = name.rsplit("_", 1)[-1] if "_" in name else ""
    return header_unit or SIGNAL_UNITS.get(name) or (suffix if suffix[:1].isalpha() and conversion(suffix) else None)


def si_unit(unit: str | None) -> str | None:
    """Return the SI unit of a declared unit; what is unknown stays what it is.

    Parameters
    ----------
    unit : str or None
    """
    return None if unit is None else (conversion(unit) or (unit,))[0]


def split_choice(choice: str) -> tuple[str, str | None]:
    """Split ``name:unit`` into name and unit; the unit is None when there is no colon.

    Raises
    ------
    RecordingError
        The unit is unknown; the message lists the known ones.
    """
    name, colon, unit = choice.rpartition(":")
    if not colon:
        return choice, None
    known_conversion(name, unit)
    return name, unit


def known_conversion(name: str, unit: str) -> tuple[str, float]:
    """Return what :func:`conversion` does, or refuse.

    Parameters
    ----------
    name : str
        The column, for the message.
    unit : str

    Raises
    ------
    RecordingError
        The unit is unknown; the message lists the known ones.
    """
    found = conversion(unit)
    if found is None:
        raise RecordingError(f"column '{name}': unknown unit '{unit}'; known are {', '.join(UNITS)}, and 10um/V")
    return found
