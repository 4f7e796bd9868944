# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A waveform as text equals the waveform with the same numbers in SI; invalid texts are refused by name."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references.recipes import asked_waveform, played
from hysteresis_ros.references.waveforms import WAVEFORMS, WaveformParameters
from hysteresis_ros.units import conversion, quantity, quantity_in, readable


@given(
    st.floats(-1e6, 1e6), st.sampled_from([("um", "m", 1e6), ("nm", "m", 1e9), ("kHz", "Hz", 1e-3), ("mV", "V", 1e3)])
)
def test_a_quantity_is_its_number_over_how_many_make_one_in_si(number, unit):
    written, si, many = unit
    assert quantity(f"{number!r}{written}") == quantity(f" {number!r} {written} ") == (number / many, si)


@pytest.mark.parametrize("text", ["", "um", "nan", "inf m", "1e999", "5 furlongs", "1,5um", "10um/V"])
def test_what_is_no_quantity_is_refused(text):
    with pytest.raises(ValueError, match="finite number|unknown unit"):
        quantity(text)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("2 min", "s", 120.0),
        ("3kV", "V", 3000.0),
        ("5 %", "", 0.05),
        ("180deg", "rad", 3.14159265),
        ("2bar", "Pa", 2e5),
        ("1.5cm", "m", 0.015),
        ("4mm/s^2", "m/s^2", 0.004),
        ("0", "m", 0.0),  # nothing is nothing in any unit
    ],
)
def test_a_quantity_in_other_units_is_that_in_si(text, unit, value):
    assert quantity_in(text, unit) == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("10um/V", ("m", 1e5)), ("2 um/mV", ("m", 500.0)), ("mm/V", ("m", 1e3)), ("10um/A", None), ("0um/V", None)],
)
def test_a_sensitivity_is_what_a_volt_stands_for(unit, factor):
    assert conversion(unit) == (None if factor is None else pytest.approx(factor))


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (-5e-3, "V", "-5 mV"),
        (-2e-5, "s", "-20 µs"),
        (-1.5, "V", "-1.5 V"),
        (-3e-9, "m", "-3 nm"),
        (0.99e-7, "m", "99 nm"),
        (-2.5e-7, "m", "-0.25 µm"),
        (-4e-3, "m", "-4 mm"),
        (0.0, "m", "0 µm"),
        (1.785e-9, "m/s", "1.785 nm/s"),
        (7.0, "", "7"),
    ],
)
def test_a_quantity_is_shown_with_few_zeros_whatever_its_sign(value, unit, text):
    assert readable(value, unit) == text


def test_units_as_people_write_them_are_the_numbers_in_si():
    words = {"amplitude": "70um", "frequency": "5", "offset": "-20 nm", "cycles": "3", "polarity": "symmetric"}
    values = asked_waveform("triangle", words)
    assert values["amplitude"] == 7e-5 and values["frequency"] == 5.0 and values["offset"] == -2e-8
    assert values["cycles"] == 3 and values["polarity"] == "symmetric" and values["type"] == "triangle"
    assert played(values, 1e-3) == pytest.approx(0.6)
    steps = asked_waveform("steps", {"values": "2um,0,1um", "times": "0,100ms,0.2s", "steps.period": "300ms"})
    assert steps["steps.values"] == [2e-6, 0.0, 1e-6] and steps["steps.times"] == [0.0, 0.1, 0.2]
    assert steps["steps.period"] == 0.3


@pytest.mark.parametrize("kind", WAVEFORMS)
def test_nothing_of_the_waveform_before_stays(kind, tmp_path):
    """All parameters of a waveform are given, so that an override keeps none of the file's values."""
    example = WAVEFORMS[kind].example
    own = {} if example is None else {f"{kind}.{name}": value for name, value in example.to_mapping().items()}
    own = {"file.path": str(tmp_path / "a.csv")} if kind == "file" else own
    common = {"amplitude": 1e-6} if WAVEFORMS[kind].extent == "amplitude" else {}
    common |= {"cycles": 2} if kind == "decreasing_triangle" else {}
    units = {row.name: "m" if row.unit == "m" else "" for row in WaveformParameters.table()}
    text = {
        name: ",".join(one if isinstance(one, str) else f"{one!r}{units[name]}" for one in value)
        if isinstance(value, tuple)
        else f"{value}{units[name]}"
        for name, value in {**common, **own}.items()
    }
    values = asked_waveform(kind, text)
    built = WaveformParameters.from_mapping(values)
    assert built == WaveformParameters.from_mapping({"type": kind, **common, **own})
    rows = [row.name for row in WaveformParameters.table() if row.name.startswith(f"{kind}.")]
    assert {*rows, "offset", "cycles"} <= values.keys()


def test_lengths_are_voltages_where_a_gain_makes_them_lengths():
    values = asked_waveform("triangle", {"amplitude": "60V", "offset": "1um"}, gain=1e-7)
    assert values["amplitude"] == 60.0 * 1e-7 and values["offset"] == 1e-6
    with pytest.raises(ParameterError, match="60V or 5um"):
        asked_waveform("triangle", {"amplitude": "60"}, gain=1e-7)
    with pytest.raises(ParameterError, match="is in V"):
        asked_waveform("triangle", {"amplitude": "60V"})
    with pytest.raises(ParameterError, match=r"frequency.*is in V"):
        asked_waveform("triangle", {"amplitude": "60V", "frequency": "5V"}, gain=1e-7)


@pytest.mark.parametrize(
    ("kind", "given_", "expected"),
    [
        ("trinagle", {}, "did you mean triangle"),
        ("triangle", {}, "waveform.amplitude = None: missing"),
        ("steps", {"values": "1um"}, "waveform.steps.times = None: missing"),
        ("steps", {"values": "1um", "times": "0,1,2s"}, "1 of which unit"),
        ("steps", {"values": "1um", "times": "0", "amplitude": "1um"}, "steps has no such parameter"),
        ("sine", {"amplitude": "1um", "polarity": "symmetric"}, "sine has no such parameter"),
        ("square", {"amplitude": "1um", "duti": "0.2"}, "did you mean duty"),
        ("square", {"amplitude": "1um", "duty": "1.5"}, "out of range"),
        ("sine", {"amplitude": "-1um"}, "out of range"),
        ("sine", {"amplitude": "1um", "cycles": "1.5"}, "whole number"),
        ("sine", {"amplitude": "1Hz"}, "is in Hz, must be in m"),
    ],
)
def test_what_a_waveform_is_not_is_refused_by_name(kind, given_, expected):
    with pytest.raises(ParameterError) as refused:
        asked_waveform(kind, given_)
    assert expected in str(refused.value)


@pytest.mark.parametrize(
    ("text", "likely"),
    [("60", "60um or 60nm"), ("5e-6", "5e-6m or 5e-6mm"), ("0.5", "0.5um or 0.5mm"), ("-2000", "-2000nm or -2000um")],
)
def test_a_length_without_a_unit_is_refused_with_its_two_likely_meanings(text, likely):
    with pytest.raises(ValueError, match=f"of which unit. Write {likely}$"):
        quantity_in(text, "m")
    assert quantity_in("0", "m") == 0.0, "zero is the same in any unit"
    assert quantity_in(text, "Hz") == quantity_in(text, "") == float(text), "other numbers are in SI"
    with pytest.raises(ParameterError, match="amplitude.*of which unit"):
        asked_waveform("sine", {"amplitude": text.lstrip("-")})


def test_what_never_ends_has_no_length():
    with pytest.raises(ParameterError, match="has no end"):
        played(asked_waveform("sine", {"amplitude": "1um"}), 1e-3)
