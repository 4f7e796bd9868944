# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Convert quantities with units (``70um``, ``5 Hz``, ``10um/V``) to SI, and SI values to readable text."""

from __future__ import annotations

import contextlib
import contextvars
import math
import re
from collections.abc import Iterator

from hysteresis_ros.errors import did_you_mean

#: Accepted units in addition to SI units: name → (SI unit, number of these units in one SI unit).
SUBUNITS = {
    "mm": ("m", 1e3),
    "um": ("m", 1e6),
    "µm": ("m", 1e6),
    "μm": ("m", 1e6),
    "nm": ("m", 1e9),
    "ms": ("s", 1e3),
    "us": ("s", 1e6),
    "µs": ("s", 1e6),
    "μs": ("s", 1e6),
    "mV": ("V", 1e3),
}

#: Units of a column: name → (SI unit, number of these units in one SI unit); ``1`` is dimensionless.
UNITS = {
    **SUBUNITS,
    **{unit: (unit, 1.0) for unit in ("s", "m", "V", "A", "N", "rad", "K", "Pa", "Hz", "1", "m/s", "m/s^2")},
    # degC to K needs an offset, not only a factor, so it is not converted
    **{unit: (unit, 1.0) for unit in ("degC", "T", "Nm")},
    "mm/s": ("m/s", 1e3),
    "um/s": ("m/s", 1e6),
    "µm/s": ("m/s", 1e6),
    "μm/s": ("m/s", 1e6),
    "nm/s": ("m/s", 1e9),
    "mm/s^2": ("m/s^2", 1e3),
    "m/s^3": ("m/s^3", 1.0),
    "mm/s^3": ("m/s^3", 1e3),
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
    "mNm": ("Nm", 1e3),
    "mT": ("T", 1e3),
    "kPa": ("Pa", 1e-3),
    "MPa": ("Pa", 1e-6),
    "bar": ("Pa", 1e-5),
    "mrad": ("rad", 1e3),
    "urad": ("rad", 1e6),
    "µrad": ("rad", 1e6),
    "deg": ("rad", 180 / math.pi),
    "%": ("1", 1e2),
    "mHz": ("Hz", 1e3),
    "kHz": ("Hz", 1e-3),
}

#: Names of units, in lower case.
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
    **dict.fromkeys(("°c", "degc", "celsius"), "degC"),
}

#: Powers as users type them, and as they are printed.
_POWERS = {ord("²"): "^2", ord("³"): "^3"}

#: Numbers below this are shown in the next smaller unit: 12.3 nm instead of 0.0123 µm.
FINE = 0.1

_SENSITIVITY = re.compile(
    r"^(?P<factor>(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)?\s*(?P<unit>[^\d\s/*]+)\s*/\s*(?P<per>[^\d\s/*]+)$"
)
_QUANTITY = re.compile(r"^\s*(?P<number>[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>.*?)\s*$")


def conversion(unit: str) -> tuple[str, float] | None:
    """Return the SI unit of a unit, and how many of the given units are one SI unit; None when the unit is unknown.

    ``10um/V`` is a sensitivity: the column is in V, and 1 V is 10 µm.
    """
    unit = unit.strip().translate(_POWERS)
    unit = WORDS.get(unit.lower(), unit)
    if unit in UNITS:
        return UNITS[unit]
    parts = _SENSITIVITY.match(unit)
    if parts is None:
        return None
    of, per = (UNITS.get(WORDS.get(parts[name].lower(), parts[name])) for name in ("unit", "per"))
    factor = float(parts["factor"] or 1.0)
    if of is None or per is None or per[0] != "V" or not 0.0 < factor < math.inf:
        return None
    return of[0], of[1] / (per[1] * factor)


def quantity(text: str) -> tuple[float, str]:
    """Return the SI value and the SI unit of a quantity such as ``5 um``; the unit of a bare number is empty."""
    parts = _QUANTITY.match(text)
    value = float(parts["number"]) if parts else math.nan
    if parts is None or not math.isfinite(value):
        raise ValueError("must be a finite number, followed by its unit")
    if not parts["unit"]:
        return value, ""
    found = conversion(parts["unit"])
    if found is None or "/" in parts["unit"] and parts["unit"].translate(_POWERS) not in UNITS:
        raise ValueError(f"unknown unit '{parts['unit']}'{did_you_mean(parts['unit'], UNITS)}")
    return value / found[1], found[0]


def quantity_in(text: str, unit: str) -> float:
    """Return the SI value of a quantity such as ``5 um``.

    A length must have a unit: a user may mean 60 µm or 60 nm by 60, which would be 60 m in SI. Other numbers without a
    unit are in SI.
    """
    value, given = quantity(text)
    if not given and unit == "m" and value != 0.0:
        bare = text.strip()
        # the two units with which the number is closest to a typical displacement, 10 µm
        likely = sorted(("m", "mm", "um", "nm"), key=lambda name: abs(math.log10(abs(value) / UNITS[name][1] / 1e-5)))
        raise ValueError(f"of which unit? Write {bare}{likely[0]} or {bare}{likely[1]}")
    if given not in ("", unit.translate(_POWERS) or "1"):
        raise ValueError(f"is in {given}, must be {f'in {unit}' if unit else 'a number without a unit'}")
    return value


#: Units in which quantities in V and m are shown.
_SHOWN: contextvars.ContextVar[dict[str, str] | None] = contextvars.ContextVar("shown units", default=None)


@contextlib.contextmanager
def shown_in(input_unit: str, output_unit: str) -> Iterator[None]:
    """Within the context, :func:`readable` and :func:`shown_unit` show V as ``input_unit``, and m as ``output_unit``.

    The models call their input a voltage and their output a displacement; a recording may contain other quantities.
    """
    token = _SHOWN.set({"V": input_unit, "m": output_unit})
    try:
        yield
    finally:
        _SHOWN.reset(token)


def shown_unit(unit: str) -> str:
    """Return the unit in which quantities in V or m are shown, see :func:`shown_in`."""
    return (_SHOWN.get() or {}).get(unit, unit)


def ending(unit: str) -> str:
    """Return the ending that a unit adds to the name of a figure, such as ``_m`` or ``_degc``."""
    return "_" + {"%": "in_percent"}.get(unit, unit.replace("/", "_per_").replace("^", "").lower())


def bare_name(column: str) -> str:
    """Return the name of a column without the unit at its end: ``coil`` of ``coil_mA``."""
    name, _, unit = column.rpartition("_")
    return name if name and unit[:1].isalpha() and conversion(unit) is not None else column


def figure_name(name: str, units: tuple[str, str]) -> str:
    """Return the name of a figure in the ``units`` of input and output of a recording, from its name in V and m."""
    for unit, own in zip(("V", "m"), units, strict=True):
        for after in ("", "2", "_per_s"):
            if own != unit and name.endswith(ending(unit) + after):
                return name.removesuffix(ending(unit) + after) + ending(own) + after
    return name


def readable(value: float, unit: str) -> str:
    """Return a readable quantity: four digits and a prefix that leaves few zeros, as in ``0.2148 µm``."""
    if unit.endswith("/s"):
        return f"{readable(value, unit.removesuffix('/s'))}/s"
    unit = shown_unit(unit)
    if unit == "m":
        size = abs(value)
        if 0.0 < size < FINE * 1e-6:
            return f"{1e9 * value:.4g} nm"
        return f"{1e3 * value:.4g} mm" if size >= 1e-3 else f"{1e6 * value:.4g} µm"
    if unit in ("s", "V") and 0.0 < abs(value) < 1.0:
        milli = abs(value) >= 1e-3
        return f"{1e3 * value:.4g} m{unit}" if milli else f"{1e6 * value:.4g} µ{unit}"
    return f"{value:.4g} {unit}".rstrip()


def micrometres(*lengths: float) -> str:
    """Return lengths [m] in µm with six digits, several as a range: ``0 … 12 µm``."""
    return " … ".join(f"{1e6 * length:.6g}" for length in lengths) + " µm"
