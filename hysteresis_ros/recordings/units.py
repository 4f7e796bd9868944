"""Units as people write them: ``[Volt]``, ``(µm)``, ``control_V``, ``ai0:10um/V`` … all brought to SI."""

from __future__ import annotations

import re

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.tables import SUBUNITS
from hysteresis_ros.signals import UNITS as SIGNAL_UNITS

#: Units a column may have: name → (SI unit, number of them in one SI unit); ``1`` is dimensionless.
UNITS = {
    **SUBUNITS,
    **{unit: (unit, 1.0) for unit in ("s", "m", "V", "A", "N", "rad", "K", "Pa", "Hz", "1", "m/s", "m/s^2")},
    "min": ("s", 1 / 60),
    "ns": ("s", 1e9),
    "cm": ("m", 1e2),
    "pm": ("m", 1e12),
    "uV": ("V", 1e6),
    "µV": ("V", 1e6),
    "kV": ("V", 1e-3),
    "mA": ("A", 1e3),
    "mN": ("N", 1e3),
    "kN": ("N", 1e-3),
    "mrad": ("rad", 1e3),
    "urad": ("rad", 1e6),
    "µrad": ("rad", 1e6),
    "deg": ("rad", 180 / np.pi),
    "%": ("1", 1e2),
}

#: Words for units, in small letters.
WORDS = {
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
    **dict.fromkeys(("second", "seconds", "sec", "secs", "sekunde", "sekunden"), "s"),
    **dict.fromkeys(("millisecond", "milliseconds", "msec", "millisekunden"), "ms"),
    **dict.fromkeys(("microsecond", "microseconds", "usec", "µsec", "mikrosekunden"), "us"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(
        ("micrometre", "micrometres", "micrometer", "micrometers", "micron", "microns", "mikrometer", "mikron"), "um"
    ),
    **dict.fromkeys(("nanometre", "nanometres", "nanometer", "nanometers"), "nm"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("ampere", "amperes", "amps"), "A"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
}

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({<](?P<unit>[^\[\](){}<>]+)[\])}>]$")
_AFTER = re.compile(r"^(?P<name>.+?)(?:\s*/\s*|\s+in\s+|\s*:\s*|,\s*|\s+)(?P<unit>\S+)$")
_SENSITIVITY = re.compile(
    r"^(?P<factor>[0-9.]+(?:[eE][-+]?[0-9]+)?)?\s*(?P<unit>[^\d\s/*]+)\s*/\s*(?P<per>[^\d\s/*]+)$"
)


def conversion(unit: str) -> tuple[str, float] | None:
    """Return SI unit of a unit and the number of them in one SI unit; None where the unit is unknown.

    ``10um/V`` is a sensitivity: what stands in the column is in V, and 1 V is 10 µm.

    Parameters
    ----------
    unit : str
        A key of :data:`UNITS`, a word for one, or a sensitivity.
    """
    unit = unit.strip()
    unit = WORDS.get(unit.lower(), unit)
    if unit in UNITS:
        return UNITS[unit]
    parts = _SENSITIVITY.match(unit)
    if parts is None:
        return None
    of, per = (UNITS.get(WORDS.get(parts[name].lower(), parts[name])) for name in ("unit", "per"))
    factor = float(parts["factor"] or 1.0)
    if of is None or per is None or per[0] != "V" or not factor > 0.0:
        return None
    return of[0], of[1] / (per[1] * factor)


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


def readable(value: float, unit: str) -> str:
    """Return a number for people: four digits and the part of the unit that leaves few zeros, as ``0.2148 µm``.

    Parameters
    ----------
    value : float
        In SI.
    unit : str
        SI unit; lengths from nm to mm are in µm, so that one column compares.
    """
    if unit == "m":
        size = abs(value)
        if 0.0 < size < 1e-9:
            return f"{1e9 * value:.4g} nm"
        return f"{1e3 * value:.4g} mm" if size >= 1e-3 else f"{1e6 * value:.4g} µm"
    if unit in ("s", "V") and 0.0 < abs(value) < 1.0:
        milli = abs(value) >= 1e-3
        return f"{1e3 * value:.4g} m{unit}" if milli else f"{1e6 * value:.4g} µ{unit}"
    return f"{value:.4g} {unit}".rstrip()
