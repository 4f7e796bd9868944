# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Scans of a plane: each is a file or folder in this folder and is found automatically; a name selects one.

:mod:`hysteresis_ros.references.scan` describes the declaration of a scan.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from hysteresis_ros.configuration import ParameterRow
from hysteresis_ros.errors import ParameterError, Problem, did_you_mean
from hysteresis_ros.references.recipes import parameter_value
from hysteresis_ros.references.scan import Scan, ScanShape
from hysteresis_ros.registry import discover

#: The scans, by name. Other packages add scans by an entry point: ``zigzag = my_package.zigzag:SCAN``.
SCANS: dict[str, ScanShape] = discover(__name__, "SCAN", ScanShape, "hysteresis_ros.scans")


def scan_of(kind: str, values: Mapping[str, Any]) -> Scan:
    """Return a scan after a check of its parameters.

    Parameters
    ----------
    kind : str
        One of :data:`SCANS`.
    values : mapping of str to object
        Parameters of the scan in SI units; omitted parameters have their defaults.

    Returns
    -------
    Scan

    Raises
    ------
    ParameterError
        The scan does not exist, or a parameter is unknown, missing or out of range, or two parameters contradict each
        other.
    """
    scan = shape_of(kind).parameters.from_mapping(values)
    if values.get("line_rate") and "frame_rate" in values and not math.isclose(scan.frame_rate, scan.rate):
        allowed = f"line_rate = {values['line_rate']:g} Hz gives {scan.rate:.6g} frames per second: omit one of them"
        raise ParameterError([Problem("frame_rate", scan.frame_rate, allowed)])
    return scan


def shape_of(kind: str) -> ScanShape:
    """Return the declaration of a scan, one of :data:`SCANS`; ParameterError if there is no such scan."""
    if kind not in SCANS:
        allowed = f"there is no such scan; the scans are {', '.join(SCANS)}{did_you_mean(kind, SCANS)}"
        raise ParameterError([Problem("scan", kind, allowed)])
    return SCANS[kind]


def rows_of(kind: str) -> dict[str, ParameterRow]:
    """Return the parameters of a scan, one of :data:`SCANS`, by name: its own, then the shared ones."""
    shared = {row.name for row in Scan.table()}
    rows = shape_of(kind).parameters.table()
    return {row.name: row for row in sorted(rows, key=lambda row: row.name in shared)}


def parsed_values(words: Iterable[str], rows: Mapping[str, ParameterRow]) -> dict[str, Any]:
    """Return parameters in SI units from texts ``NAME=VALUE``, with a unit for a length: ``width=80um``.

    ``rows`` contains the existing parameters, as :func:`rows_of` returns them. ParameterError: a text has another form,
    or a parameter is unknown or invalid.
    """
    found, problems = {}, []
    for word in words:
        name, mark, text = (part.strip() for part in word.partition("="))
        if not mark:
            problems.append(Problem(word, None, f"write NAME=VALUE; names are {', '.join(rows)}"))
        elif name not in rows:
            allowed = f"there is no such parameter; the parameters are {', '.join(rows)}{did_you_mean(name, rows)}"
            problems.append(Problem(name, text, allowed))
        else:
            try:
                found[name] = parameter_value(rows[name], text)
            except ValueError as error:
                problems.append(Problem(name, text, str(error)))
    if problems:
        raise ParameterError(problems)
    return found


def parsed_scan(kind: str, words: Iterable[str]) -> Scan:
    """Return a scan from texts ``NAME=VALUE``, as they occur in a parameter file or on the command line.

    ParameterError: there is no such scan, or a parameter is unknown, missing or out of range.
    """
    return scan_of(kind, parsed_values(words, rows_of(kind)))


def scan_words(scan: Scan) -> tuple[str, tuple[str, ...]]:
    """Return the kind of a scan and its parameters as texts; :func:`parsed_scan` restores the scan from them.

    ParameterError: the scan is not one of :data:`SCANS`.
    """
    kind = next((name for name, shape in SCANS.items() if type(scan) is shape.parameters), None)
    if kind is None:
        raise ParameterError([Problem("scan", type(scan).__name__, f"must be one of {', '.join(SCANS)}")])
    rows = rows_of(kind)
    given = {name: value for name, value in scan.to_mapping().items() if value != rows[name].default}
    return kind, tuple(
        f"{name}={value!r}{rows[name].unit}" if isinstance(value, float) else f"{name}={value}"
        for name, value in given.items()
    )
