# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Structured arguments of ``hr.simulate`` and ``hr.sweep`` have the same meaning as the texts of the commands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import hysteresis_ros as hr
from hysteresis_ros.configuration import ParameterRow
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.sweeps.plan import parse_range, parse_variations, parse_words
from hysteresis_ros.loop.faults import DELAY, FAULTS, parse_fault
from hysteresis_ros.loop.reach import single_axis


@given(
    name=st.sampled_from(sorted(FAULTS)),
    start=st.floats(0.0, 1e6),
    duration=st.floats(1e-9, 1e6),
    share=st.floats(0.0, 1.0),
)
def test_a_fault_is_the_words_that_it_writes(name, start, duration, share):
    kind = FAULTS[name]
    value = None
    if kind.value is not None:
        value = 1.0 + np.floor(100.0 * share) if kind.action == DELAY else share
    fault = hr.Fault(name, start, duration, value)
    assert parse_fault(str(fault)) == fault and (fault.value is None) == (kind.value is None)


@pytest.mark.parametrize(
    "text", ["stale:0.1:0.3", "offset:0:1", "offset:1e-2:0.5:2e-7", "late:0:2:3", "drop:0.5:1:0.25"]
)
def test_words_are_the_fault(text):
    name, *numbers = text.split(":")
    assert parse_fault(text) == hr.Fault(name, *map(float, numbers)) == parse_fault(str(parse_fault(text)))


def test_a_default_value_is_that_of_the_words():
    assert hr.Fault("spike", 0.0, 1.0).value == FAULTS["spike"].value == parse_fault("spike:0:1").value


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("stail", 0.0, 1.0), "there is no fault 'stail'; did you mean stale"),
        (("stale", -1.0, 1.0), "START must be ≥ 0"),
        (("stale", 0.0, 0.0), "DURATION > 0"),
        (("stale", 0.0, 1.0, 2.0), "stale has no VALUE"),
        (("drop", 0.0, 1.0, 2.0), "VALUE must be within 0 … 1"),
        (("late", 0.0, 1.0, 1.5), "VALUE must be within 1"),
        (("stale", "0.1", 1.0), "start = '0.1': must be a number"),
        (("stale", float("nan"), 1.0), "write NAME:START:DURATION"),
    ],
)
def test_a_wrong_fault_is_refused_when_it_is_made(arguments, message):
    with pytest.raises(HysteresisError, match=message):
        hr.Fault(*arguments)


@pytest.mark.parametrize("single", ["offset:0.01:0.005:2e-7", hr.Fault("offset", 0.01, 0.005, 2e-7)])
def test_a_single_fault_is_a_list_of_one(single):
    several, alone = (hr.simulate("kim2009", duration=0.03, faults=given) for given in ([single], single))
    np.testing.assert_array_equal(alone.measured, several.measured)
    assert hr.axis_array("kim2009", 2, faults=single).parameters[0].plant_simulator.faults == (str(single),)


@pytest.mark.parametrize("more", [{}, {"axes": 2}, {"namespace": "x"}])
def test_a_fault_after_the_end_of_the_run_is_reported(more):
    source = "xy_scanner" if "namespace" in more else "kim2009"
    with pytest.warns(UserWarning, match=r"fault 'stale:0.5:0.1': begins after the end of the run, 0.01 s"):
        hr.simulate(source, duration=0.01, faults="stale:0.5:0.1", **more)


@pytest.mark.parametrize("duration", ["0.01", "10ms", "0.01 s", np.float64(0.01)])
def test_a_duration_may_have_a_unit(duration):
    assert len(hr.simulate("kim2009", duration=duration)) == 30


@pytest.mark.parametrize("duration", ["10 m", "long", [0.01, 0.02], {}])
def test_a_duration_that_is_no_time_is_refused(duration):
    with pytest.raises(HysteresisError, match="duration = .*must be a finite number .s., or a text with its unit"):
        hr.simulate("kim2009", duration=duration)


@pytest.mark.parametrize(
    "given, message",
    [
        ([5.0, 5.0], r"setpoints\[0\] = 5.0 m: must be within 0 … 20 µm.*; setpoints are in m: write 5 µm as 5e-06"),
        ([0.0, 25e-6], r"setpoints\[1\] = 2.5e-05 m: must be within 0 … 20 µm, the range that[^;]*$"),
        ([0.0, np.nan], r"setpoints\[1\] = nan m: must be within"),
        ([-np.inf], r"setpoints\[0\] = -inf m: must be within"),
        ([[1e-6, 2e-6]], r"setpoints has shape \(1, 2\); it must be one-dimensional"),
        ([1j], "setpoints: must be an array of real numbers"),
        ([], "setpoints: must be at least one value"),
    ],
)
def test_setpoints_that_the_axis_would_ignore_are_refused(given, message):
    with pytest.raises(HysteresisError, match=message):
        hr.simulate("stage700", setpoints=given)


def test_setpoints_of_a_stage_and_of_many_axes_are_refused_by_name():
    with pytest.raises(HysteresisError, match=r"setpoints of y\[1\] = 1.0 m: must be within"):
        hr.simulate("xy_scanner", setpoints={"y": [20e-6, 1.0]})
    with pytest.raises(HysteresisError, match=r"setpoints\[1, 0\] = 1.0 m: must be within"):
        hr.simulate("stage700", axes=2, setpoints=[[0.0], [1.0]])


def test_setpoints_may_be_a_series_a_range_or_one_number():
    pandas = pytest.importorskip("pandas")
    expected = hr.simulate("stage700", setpoints=np.full(20, 2e-6))
    series = pandas.Series(np.full(20, 2e-6), index=range(100, 120))
    for one in (series, (2e-6,) * 20, np.broadcast_to(2e-6, 20)):
        np.testing.assert_array_equal(hr.simulate("stage700", setpoints=one).measured, expected.measured)
    assert len(hr.simulate("stage700", setpoints=2e-6, duration=20 * expected.sample_time)) == 20


def test_a_run_with_a_fault_is_bit_for_bit_that_with_its_words():
    words = hr.simulate("kim2009", duration=0.03, faults=["offset:0.01:0.005:2e-7", "stale:0.02:0.005"])
    objects = [hr.Fault("offset", 0.01, 0.005, 2e-7), hr.Fault("stale", 0.02, 0.005)]
    run = hr.simulate("kim2009", duration=0.03, faults=objects)
    for name in words.signals:
        np.testing.assert_array_equal(run[name], words[name])
    # the fault is in the run and in its configuration, which gives the same run again
    again = hr.simulate(run, duration=0.03)
    np.testing.assert_array_equal(again.measured, run.measured)
    assert not np.array_equal(run.measured, hr.simulate("kim2009", duration=0.03).measured, equal_nan=True)


NUMBER = ParameterRow("gain", float, 1.0, "", None, None, None, "a number", False, False)
LENGTH = ParameterRow("noise", float, 1e-9, "m", None, None, None, "a length", False, False)
WHOLE = ParameterRow("seed", int, 1, "", None, None, None, "a whole number", False, False)
RANGES = {
    "±5%": hr.Within(0.05),
    "±12.5%": hr.Within(0.125),
    "±0.5": hr.Within(0.5, relative=False),
    "normal(±5%)": hr.Normal.around(0.05),
    "normal(±0.5)": hr.Normal.around(0.5, relative=False),
    "normal(2,0.1)": hr.Normal(2.0, 0.1),
    "uniform(0.1,2)": hr.Uniform(0.1, 2.0),
    "loguniform(0.1,2)": hr.LogUniform(0.1, 2.0),
    "12,14,16": hr.Levels([12.0, 14.0, 16.0]),
    "0.1:2:log20": hr.Levels.logarithmic(0.1, 2.0, 20),
    "1:5:lin10": hr.Levels.linear(1.0, 5.0, 10),
}


@pytest.mark.parametrize("words, meant", RANGES.items())
def test_words_of_a_range_are_the_object(words, meant):
    assert parse_words(words, NUMBER) == meant == parse_words(str(meant), NUMBER)
    assert parse_range(words, NUMBER) == meant.over(NUMBER)


def test_lengths_and_whole_numbers_are_the_words_too():
    assert parse_words("±2nm", LENGTH) == hr.Within(2e-9, relative=False)
    assert parse_words("1nm,2nm", LENGTH) == hr.Levels(np.array([1e-9, 2e-9]))
    assert parse_range("uniform(1,99)", WHOLE) == hr.Uniform(1, 99).over(WHOLE)
    assert parse_range("4:16:lin13", WHOLE) == hr.Levels(range(4, 17)).over(WHOLE)


POSITIVE = st.floats(1e-12, 1e12)


@pytest.mark.slow
@given(low=POSITIVE, high=POSITIVE, relative=st.booleans(), thousandths=st.integers(1, 99_999))
def test_every_range_is_read_back_from_what_it_writes(low, high, relative, thousandths):
    assume(low < high)
    width = thousandths / 1000.0 / 100.0 if relative else high
    ranges = [
        hr.Uniform(low, high),
        hr.LogUniform(low, high),
        hr.Normal(low, high),
        hr.Levels([low, high]),
        hr.Within(width, relative),
        hr.Normal.around(width, relative),
    ]
    for row in (NUMBER, LENGTH):
        for meant in ranges:
            assert parse_words(meant.words(row.unit), row) == meant


@pytest.mark.parametrize(
    "over, row, message",
    [
        (hr.Within(5.0), NUMBER, "±500%: must be above 0 and below 100 %"),
        (hr.Within(0.05), WHOLE, "is a whole number"),
        (hr.Uniform(2.0, 1.0), NUMBER, "second end must be above"),
        (hr.LogUniform(0.0, 1.0), NUMBER, "both ends must be above 0"),
        (hr.Normal(1.0, 0.0), NUMBER, "deviation must be above 0"),
        (hr.Levels([1.5]), WHOLE, "must be a whole number"),
        (hr.Levels(["much"]), NUMBER, "must be a finite number"),
        (hr.Levels([]), NUMBER, "has no levels"),
    ],
)
def test_a_range_that_the_parameter_cannot_have_is_refused(over, row, message):
    with pytest.raises(ValueError, match=message):
        over.over(row)


def test_variations_by_names_are_those_of_the_words():
    axis = single_axis(hr.load("kim2009"))
    words = parse_variations(["plant_simulator=±5%", "plant_simulator.sensor.noise=1nm,2nm"], axis)
    assert words == parse_variations(
        {"plant_simulator": hr.Within(0.05), "plant_simulator.sensor.noise": [1e-9, 2e-9]}, axis
    )
    assert words == parse_variations({"plant_simulator": "±5%", "plant_simulator.sensor.noise": "1nm,2nm"}, axis)
    with pytest.raises(HysteresisError, match="sensor.nois"):
        parse_variations({"plant_simulator.sensor.nois": hr.Within(0.05)}, axis)
    with pytest.raises(HysteresisError, match="mapping from NODE.PARAMETER"):
        parse_variations("plant_simulator=±5%", axis)


def test_a_range_of_one_number_is_refused():
    with pytest.raises(HysteresisError, match="sensor.noise = 0.5: must be several values, a text such as"):
        hr.sweep("kim2009", {"plant_simulator.sensor.noise": 0.5}, duration=0.01)


def test_a_sweep_takes_objects():
    found = hr.sweep("kim2009", {"plant_simulator": hr.Within(0.05)}, runs=3, duration=0.01, workers=1)
    words = hr.sweep("kim2009", ["plant_simulator=±5%"], runs=3, duration=0.01, workers=1)
    for name, values in words.results.metrics.items():
        np.testing.assert_array_equal(found.results.metrics[name], values)


RISE = 1e-3 * np.arange(100.0)
MEASURED = hr.Run(RISE, {"voltage": 1e3 * RISE, "measured": 1e-4 * RISE})
STAGE = {"plant_simulator.sensor.noise": [1e-9]}


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: hr.simulate(None), "configuration = None: must be a parameter file"),
        (lambda: hr.simulate(""), "the path is empty"),
        (lambda: hr.load(""), "path = '': must be a text or a path"),
        (lambda: hr.validate(3, MEASURED), "configuration = 3: must be a parameter file"),
        (lambda: hr.simulate("kim2009", namespace=3), "namespace = 3: must be a text"),
        (lambda: hr.simulate("kim2009", threads="2"), "threads = '2': must be a whole number"),
        (lambda: hr.simulate("kim2009", duration=0.01, faults=3), "faults = 3: must be a fault"),
        (lambda: hr.simulate("kim2009", duration=0.01, requests=[1]), "requests and speeds are for an inchworm"),
        (lambda: hr.simulate("kim2009", duration=0.01, speeds=[1.0]), "and this is a piezo axis: leave them out"),
        (lambda: hr.simulate("kim2009", duration=0.01, quiet="0:1ms"), "quiet = '0:1ms': must be a list"),
        (lambda: hr.simulate("kim2009", duration=0.01, quiet=[(0.0, "a")]), "quiet: duration = 'a': must be"),
        (lambda: hr.simulate("kim2009", duration=0.01, quiet=(0.0, 0.1)), "quiet 0.0: give .start, duration"),
        (lambda: hr.validate("kim2009", "loops.csv", inverse="no"), "inverse = 'no': must be True or False"),
        (lambda: hr.identify("loops.csv", ["bouc_wen"]), "model = .'bouc_wen'.: must be a text"),
        (lambda: hr.identify("loops.csv", linear=["lag"]), "linear = .'lag'.: must be a text"),
        (lambda: hr.identify(MEASURED, options={"play_count": 10**7}), "play_count = .*must be 1000 or less"),
        (lambda: hr.design("kim2009", "pid", robust=True), "robust is of type bool: must be Uncertainty"),
        (lambda: hr.design("kim2009", "pid", bandwidth="10nm"), "bandwidth = '10nm': is in m, must be in Hz"),
        (lambda: hr.design("kim2009", "pid", duration=1.0), "--duration belongs to --criterion"),
        (lambda: hr.design_learning("kim2009", "inversion", period=np.nan), "period = nan: must be a finite number"),
        (lambda: hr.design_learning("kim2009", ["inversion"]), "learning = .'inversion'.: must be a text"),
        (lambda: hr.mismatched("kim2009", seed=-1), "seed = -1: must be 0 or more"),
        (lambda: hr.report(hr.Run([0.0, 1.0], {"voltage": [0.0, 1.0]}), 3), "path = 3: must be a text or a path"),
        (
            lambda: hr.metrics({1: hr.Run([0.0, 1.0], {"voltage": [0.0, 1.0]})}),
            "the name of a run is 1: must be a text",
        ),
        (lambda: hr.plot("run.npz", ["loops"]), "kind = .'loops'.: must be a text"),
        (lambda: hr.Run([0.0, 1.0], {"voltage": [0.0, 1j]}), "signal 'voltage' must consist of real numbers"),
        (lambda: hr.StageColumns(settle=0.0), "settle = 0.0: must be a whole number"),
        (lambda: hr.StructureEstimator(order="a"), "order = 'a': must be a whole number or a sequence"),
        (lambda: hr.StructureData("a", "b", 1e-3, 16), "input: must be an array of real numbers"),
        (lambda: hr.compare("kim2009", only=("PID", "none")), "only = .*: must be a list of pairs"),
        (lambda: hr.compare("kim2009", mismatch="5V"), "mismatch = '5V': is in V"),
    ],
)
def test_a_wrong_argument_is_refused_by_name(call, message):
    with pytest.raises(HysteresisError, match=message):
        call()


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"runs": 2.5}, "runs = 2.5: must be a whole number"),
        ({"seed": -1}, "seed = -1: must be 0 or more"),
        ({"workers": 0}, "workers = 0: must be 1 or more"),
        ({"bounds": [3]}, "bound = 3: must be a text"),
        ({"bounds": "final_error_rms_m=1um"}, "unknown metric of an actuator; there are rms_error_m"),
        ({"vary": 3}, "must be a list of NODE.PARAMETER=RANGE"),
    ],
)
def test_a_wrong_argument_of_a_sweep_is_refused_by_name(wrong, message):
    with pytest.raises(HysteresisError, match=message):
        hr.sweep(**{"config": "kim2009", "vary": STAGE, "duration": 0.01, **wrong})


def test_an_unknown_sensitivity_is_refused_by_name():
    pytest.importorskip("SALib")
    with pytest.raises(HysteresisError, match="sensitivity = 'sobl': must be sobol or morris; did you mean sobol"):
        hr.sweep("kim2009", STAGE, sensitivity="sobl", runs=2)


def test_quantities_with_units_are_accepted():
    assert hr.mismatched("kim2009", "5%").entries == hr.mismatched("kim2009", 0.05).entries
    swept = hr.sweep("kim2009", STAGE, metrics="max_error_m", bounds="rms_error_m=1m", duration="10ms", workers=1)
    assert set(swept.results.metrics) == {"max_error_m", "rms_error_m"}
    quiet = [hr.simulate("stage700", duration=0.3, quiet=[one]) for one in ((0.1, 0.05), ("100ms", "50ms"))]
    np.testing.assert_array_equal(quiet[0].command, quiet[1].command)


@pytest.mark.slow
def test_a_design_accepts_quantities_with_units():
    plain, texts = (
        hr.design("kim2009", "pid", bandwidth=one, noise=two) for one, two in ((20.0, 2e-9), ("20Hz", "2nm"))
    )
    assert plain.parameters == texts.parameters
