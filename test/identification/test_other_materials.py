# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings of other materials and sensors: summary, refusals, units, saturation, clipped sensors, free density.

The recordings are each from a law that no model of the package has.

* ``shape_memory``: strain [%] over temperature [degC]. Each phase transforms at a rate that depends on the temperature
  only in its own window, so the loop is wide and saturates at both ends.
* ``brake``: torque [N] over current [A]: Coleman and Hodgdon's equation around tanh of a dead zone.
* ``butterfly``: strain [m] over a bipolar voltage [V]: the square of a polarisation.
* ``elastomer``: stress [N] over strain [%]: relaxations from 0.5 s to 300 s behind a curve that stiffens.
* ``bender``: displacement [m] over voltage [V] by Bouc and Wen's law; its sensor clips at 80 % of the stroke.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import IdentificationData, clipped_samples
from hysteresis_ros.identification.generalised_play import GeneralisedPlays
from hysteresis_ros.identification.hammerstein import invalid, usable
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.parameter_file import load_chain
from hysteresis_ros.identification.prandtl_ishlinskii import FreeWeights, fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import FreeDensity
from hysteresis_ros.identification.preprocessing import cleaned, coarser, condense
from hysteresis_ros.identification.reading import Columns, read_data
from hysteresis_ros.identification.recording_summary import butterfly as turning_input
from hysteresis_ros.identification.recording_summary import slow_gain, summarise
from hysteresis_ros.identification.workflow import as_sensed, identify, validate, within_saturation
from hysteresis_ros.models.hysteresis import hysteresis_block


def decaying(samples: int, low: float, high: float, cycles: int = 8, least: float = 0.2) -> np.ndarray:
    """Return a triangular input from ``low``: two full cycles, then cycles whose amplitude falls to ``least``."""
    place = np.linspace(0.0, cycles, samples)
    size = np.clip(1.0 - (1.0 - least) * (place - 2.0) / (cycles - 2.0), least, 1.0)
    wave = 1.0 - np.abs(2.0 * (place % 1.0) - 1.0) * 2.0
    return 0.5 * (low + high) + 0.5 * (high - low) * size * wave


def _data(step, u, y, units, names, noise: float, seed: int) -> IdentificationData:
    y = y + noise * np.ptp(y) * np.random.default_rng(seed).standard_normal(len(y))
    return IdentificationData(step * np.arange(len(u)), u, y, *units, *names)


def shape_memory(u=None, seed: int = 0) -> IdentificationData:
    """Return a wide loop that saturates, 10 Hz, 20 … 110 degC."""
    u = decaying(4000, 20.0, 110.0) if u is None else u
    transformed, y = 0.0, np.empty(len(u))
    for k, temperature in enumerate(u):
        change = temperature - u[k - 1] if k else 0.0
        if change > 0.0:
            rate = 0.25 * np.exp(-(((temperature - 82.0) / 9.0) ** 2))
            transformed += (1.0 - transformed) * -np.expm1(-rate * change)
        else:
            rate = 0.25 * np.exp(-(((temperature - 55.0) / 8.0) ** 2))
            transformed *= np.exp(rate * change)
        y[k] = 4.0 * transformed + 0.002 * (temperature - 20.0)
    return _data(0.1, u, y, ("degC", "%"), ("temperature", "strain"), 2e-3, seed)


def _hodgdon(u, target, turn: float, slope: float) -> np.ndarray:
    """Return y of y' = turn |u'| (target(u) - y) + slope u'."""
    y = np.empty(len(u))
    y[0] = target(u[0])
    for k in range(1, len(u)):
        change, middle = u[k] - u[k - 1], target(0.5 * (u[k] + u[k - 1]))
        y[k] = middle + (y[k - 1] - middle) * np.exp(-turn * abs(change)) + slope * change
    return y


def brake(u=None, seed: int = 0) -> IdentificationData:
    """Return a loop with a dead zone at small currents and saturation at large ones, 100 Hz, -1 … 1 A."""
    u = decaying(4000, -1.0, 1.0) if u is None else u

    def target(current):
        return 40.0 * np.tanh(3.0 * np.sign(current) * max(abs(current) - 0.2, 0.0))

    return _data(0.01, u, _hodgdon(u, target, 8.0, 2.0), ("A", "N"), ("current", "torque"), 2e-3, seed)


def butterfly(u=None, seed: int = 0) -> IdentificationData:
    """Return a butterfly over a bipolar voltage, 100 Hz, -200 … 200 V."""
    u = decaying(4000, -200.0, 200.0, least=0.8) if u is None else u
    polarisation = _hodgdon(u, lambda voltage: np.tanh(voltage / 60.0), 0.02, 0.0)
    return _data(0.01, u, 5e-6 * polarisation**2, ("V", "m"), ("voltage", "strain"), 2e-3, seed)


def elastomer(u=None, seed: int = 0) -> IdentificationData:
    """Return the slow stress of an elastomer, 5 Hz, 0 … 40 %."""
    u = decaying(4000, 0.0, 40.0) if u is None else u
    curve = u + 0.4 * (u / 40.0) ** 3 * 40.0
    y, step = 0.6 * curve, 0.2
    for time in (0.5, 5.0, 40.0, 300.0):
        decay, force = np.exp(-step / time), 0.0
        for k in range(len(u)):
            force = decay * force + (curve[k] - curve[k - 1] if k else curve[0]) * (1.0 - decay) * time / step
            y[k] += 0.15 * force
    return _data(step, u, 0.5 * y, ("%", "N"), ("strain", "stress"), 2e-3, seed)


def bender(u=None, seed: int = 0, clip: float | None = 0.8) -> IdentificationData:
    """Return the loops of a bender whose sensor clips at this fraction of the stroke, 200 Hz, 0 … 100 V."""
    u = decaying(4000, 0.0, 100.0) if u is None else u
    s, h = u / 100.0, np.zeros(len(u))
    for k in range(1, len(u)):
        change = s[k] - s[k - 1]
        h[k] = h[k - 1] + 0.5 * change - 5.0 * abs(change) * h[k - 1] - 0.7 * change * abs(h[k - 1])
    data = _data(0.005, u, 300e-6 * (1.05 * s - h), ("V", "m"), ("voltage", "tip"), 5e-4, seed)
    if clip is None:
        return data
    low, high = float(data.output.min()), float(data.output.max())
    return replace(data, output=np.minimum(data.output, low + clip * (high - low)))


def condensed(data: IdentificationData):
    return condense(data.input, data.output, data.sample_time)


def line(data: IdentificationData, label: str) -> str:
    return dict(summarise(data).lines)[label]


def test_a_butterfly_is_refused_before_any_fit_with_the_model_that_comes_closest():
    said = []
    with pytest.raises(IdentificationError) as refused:
        identify(butterfly(), progress=lambda number, text: said.append(text))
    text = str(refused.value)
    assert "butterfly" in text and "closest is prandtl_ishlinskii, with an RMS error of about" in text
    # nothing but the summary was reported, so nothing was fitted
    assert len(said) == len(summarise(butterfly()).lines) and said[0].startswith("recording: ")
    # one side of it is no butterfly
    one = butterfly(decaying(2000, 0.0, 200.0))
    assert not summarise(one).refusal


@pytest.mark.parametrize("material", [shape_memory, brake, elastomer, bender])
def test_other_loops_are_no_butterflies_and_fall_only_when_turned_over(material):
    data = material(decaying(1500, *material().input_range))
    assert not summarise(data).refusal
    with pytest.raises(IdentificationError, match=r"falls with rising input .*--negate"):
        identify(replace(data, output=-data.output), "auto")


@pytest.mark.slow
def test_the_summary_says_units_direction_saturation_repetition_and_content():
    data = shape_memory(decaying(1500, 20.0, 110.0))
    assert line(data, "input") == "temperature: 20 degC … 109.9 degC"
    assert line(data, "output").startswith("strain: ") and " % RMS" in line(data, "output")
    assert line(data, "direction").startswith("the output rises with the input, 0.0") and "%/degC" in line(
        data, "direction"
    )
    assert line(data, "shape").endswith("saturates at the lower end, saturates at the upper end")
    assert line(data, "repetition").startswith("15 reversals, swings of ")
    assert "saturates" not in line(elastomer(), "shape")
    # millivolts that are volts
    strange = replace(bender(clip=None), input=1e-5 * bender(clip=None).input)
    assert "is its unit V instead of mV" in line(strange, "units")
    assert line(bender(clip=None), "units") == "likely" and line(bender(clip=None), "saturation") == "none seen"
    assert "output clipped in 12 % of the samples" in line(bender(), "saturation")


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_loop_that_saturates_at_one_end_is_said_to_saturate_there(end):
    """1 − exp(−4 v) is level at the upper end of 0 … 1, and turned around at the lower one."""
    place = decaying(1500, 0.0, 1.0)
    bent = 1.0 - np.exp(-4.0 * place) if end == "upper" else np.exp(-4.0 * (1.0 - place))
    data = replace(bender(clip=None), input=100.0 * place, output=1e-5 * bent, time=1e-3 * np.arange(place.size))
    found = summarise(data)
    assert found.shapes == (f"saturates at the {end} end",) and found.saturation == (None, None)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turn", [-20.0, 25.0])
def test_a_butterfly_turns_where_its_slope_changes_sign_whichever_way_its_wings_point(turn, sign):
    voltage = decaying(1500, -100.0, 100.0)
    assert turning_input(voltage, sign * 1e-9 * (voltage - turn) ** 2) == pytest.approx(turn, abs=3.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_direction_of_an_output_is_that_of_its_slow_movement_in_noise_and_behind_a_resonance(sign):
    """At the resonance the output is opposite to the input, and moves more than the slow one."""
    time = np.arange(8000) * 1e-3
    slow, fast = np.sin(2.0 * np.pi * 1.0 * time), np.sin(2.0 * np.pi * 90.0 * time)
    noise = np.random.default_rng(1).standard_normal(time.size)
    found = slow_gain(10.0 * slow + 5.0 * fast, sign * (10.0 * slow - 50.0 * fast) + 5.0 * noise, 1e-3)
    assert found.certain and found.gain == pytest.approx(sign, rel=0.2) and found.highest < 50.0
    # of two noises the direction is certain by chance: in eight bands, in 0.3 % each
    random = np.random.default_rng(2)
    alone = [slow_gain(*random.standard_normal((2, 4000)), 1e-3).certain for _ in range(300)]
    assert sum(alone) < 16


@pytest.mark.slow
def test_an_amplifier_that_saturates_below_the_end_of_the_range_is_noticed():
    voltage = decaying(4000, 0.0, 100.0)
    data = replace(bender(np.minimum(voltage, 80.0), clip=None), input=voltage)
    found = summarise(data)
    assert found.saturation[0] is None and found.saturation[1] == pytest.approx(80.0, abs=2.0)
    limited = within_saturation(data, found)
    assert limited.input_range[1] == pytest.approx(80.0, abs=0.5)
    assert "the output stays level above" in limited.warnings[-1] and "saturates there" in limited.warnings[-1]
    # a loop that saturates gradually is not cut, nor one that does not saturate
    for other in (brake(), shape_memory(), bender(clip=None), bender()):
        assert summarise(other).saturation == (None, None)
        assert within_saturation(other, summarise(other)) is other


def test_samples_of_a_clipped_sensor_are_left_out_of_the_fit_and_of_its_figures():
    data, whole = bender(), bender(clip=None)
    clipped = clipped_samples(data.output, data.input)
    assert np.all(data.output[clipped] == data.output.max()) and 0.1 < clipped.mean() < 0.15
    fit = fit_prandtl_ishlinskii(data.input, data.output, data.sample_time, zone_count=5, linear=())
    beyond = (fit.simulate(data.input) - whole.output)[fit.skipped :]
    # the model continues where the sensor did not: within 1 % of the stroke, where clipping took 20 %
    assert np.std(beyond) < 0.01 * whole.stroke and fit.rmse < 0.006 * whole.stroke
    assert "outliers" not in fit.numbers
    # the prediction is compared as the sensor would show it
    shown = as_sensed(data, fit.simulate(data.input))
    assert shown.max() == data.output.max() and np.std((shown - data.output)[fit.skipped :]) < 0.006 * whole.stroke
    # models without plays get the prediction in place of what was clipped
    filled = cleaned(data, whole.output).data.output
    assert np.max(np.abs(filled - whole.output)) < 0.02 * whole.stroke


def test_a_rival_without_weights_drops_out_and_alone_names_the_reason():
    data = condensed(bender(decaying(800, 0.0, 100.0), clip=None))
    falling = replace(data, displacement=-data.displacement)
    good = GeneralisedPlays(data, 6).behind(LinearPart())
    bad = [kind.behind(LinearPart()) for kind in (GeneralisedPlays(falling, 6), FreeWeights(falling, 6, 0))]
    assert usable([*bad, good]) == [good] and invalid(good) is None
    for fit in bad:
        with pytest.raises(IdentificationError, match="falls where the voltage rises; check the columns, or use"):
            usable([fit])


@pytest.mark.parametrize(("material", "worse"), [(shape_memory, 15.0), (brake, 2.5)])
def test_a_free_density_describes_loops_that_plays_do_not(material, worse):
    data = condensed(material(decaying(1200, *material().input_range)))
    plays = FreeWeights(data, 20, 5).behind(LinearPart())
    free = FreeDensity(data).behind(LinearPart())
    assert free.rms < 0.012 * data.stroke and plays.rms > worse * free.rms
    # the block has the output of the fit
    block = hysteresis_block(free.parameters(), data.sample_time)
    np.testing.assert_allclose(block.simulate(data.voltage), free.output(), atol=1e-5 * data.stroke)


def test_data_become_coarser_without_losing_what_is_left_out():
    data = condensed(shape_memory(decaying(3000, 20.0, 110.0)))
    kept = data.kept.copy()
    kept[100:103] = False
    data = replace(data, kept=kept)
    coarse = coarser(data, 700)
    assert len(coarse.voltage) == 1000 and coarse.sample_time == pytest.approx(0.3) and coarse.factor == 3
    assert coarse.first == -(-data.first // 3) and len(coarse.kept) == 1000 - coarse.first
    assert 1 <= np.count_nonzero(~coarse.kept) <= 2
    np.testing.assert_allclose(coarse.voltage[0], data.voltage[:3].mean())
    assert coarser(data, 3000) is data


@pytest.mark.slow
def test_units_of_input_and_output_are_kept_to_the_end(tmp_path):
    data = brake(decaying(1000, -1.0, 1.0))
    table = np.column_stack([data.time, 1e3 * data.input, data.output])
    path = tmp_path / "brake.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,coil_mA,torque", comments="")
    columns = Columns(input="coil_mA", output="torque", output_unit="N")
    reading = read_data(path, columns)
    assert (reading.data.input_unit, reading.data.output_unit) == ("A", "N")
    found = identify(reading, "proportional", linear="none")
    assert {"rmse_n", "stroke_n", "inverse_rmse_a", "sensor_zero_n"} <= set(found.figures)
    assert not any(name.endswith(("_m", "_v")) for name in found.figures)
    assert "V stands for A and m stands for N" in found.text and "rmse_n: " in found.text
    assert "A/s" in found.text and "V/s" not in found.text
    found.save(tmp_path / "axis.yaml")
    assert load_chain(tmp_path / "axis.yaml")[0].units == ("A", "N")
    again = validate(tmp_path / "axis.yaml", reading)
    assert again.figures["rmse_n"] == pytest.approx(found.figures["rmse_n"], rel=1e-6)
    with pytest.raises(IdentificationError, match="recording is in V and m, but the model was identified in A and N"):
        validate(tmp_path / "axis.yaml", bender(clip=None))


@pytest.mark.slow
def test_the_page_has_the_units_of_the_recording(tmp_path):
    pytest.importorskip("matplotlib")
    from hysteresis_ros.analysis.identification_report import (
        inverse_figure,
        loops_figure,
        residual_figure,
        traces_figure,
        write_identification_report,
    )

    found = identify(brake(decaying(1000, -1.0, 1.0)), "proportional", linear="none")
    drawn = [
        loops_figure(found.data, found.predicted, found.validation),
        traces_figure(found.data, found.predicted, found.validation),
        residual_figure(found.data, found.validation),
        inverse_figure(found.data, found.inverse),
    ]
    labels = {text for figure in drawn for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel())}
    assert {"current [A]", "torque [N]", "residual [N]", "input error [A]"} <= labels
    write_identification_report(tmp_path / "page.html", found)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The recording, before any fit" in page and "µm" not in page and "the output rises with the input" in page
    assert "residual versus the current" in page and "RMS error of the current from the inverse" in page
    assert not any("voltage" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("header", "options", "units"),
    [
        ("time_s,temperature_degC,strain (%)", {}, ("degC", "%")),
        ("time_s,current_A,force_N", {}, ("A", "N")),
        ("time_s,strain,stress", dict(input="strain", input_unit="%", output_unit="kPa"), ("%", "Pa")),
    ],
)
def test_units_come_from_the_columns_or_from_options(tmp_path, header, options, units):
    data = elastomer(decaying(400, 0.0, 40.0))
    np.savetxt(
        tmp_path / "a.csv",
        np.column_stack([data.time, data.input, data.output]),
        delimiter=",",
        header=header,
        comments="",
        encoding="utf-8",
    )
    reading = read_data(tmp_path / "a.csv", Columns(**options))
    assert (reading.data.input_unit, reading.data.output_unit) == units
    np.testing.assert_allclose(reading.data.input, data.input, atol=1e-9)
    with pytest.raises(IdentificationError, match="has the unit um, not N"):
        read_data(tmp_path / "a.csv", Columns(output="force:um", output_unit="N"))
