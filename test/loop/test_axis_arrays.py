# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Many axes in one call: each has the bits of a single axis, for any number of axes, threads and samples per call."""

from __future__ import annotations

import copy
import pathlib
import pickle
import re

import numpy as np
import pytest
from adapting_support import adapting
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_support import HOLD, assert_same_bits, parameters
from stage_support import needs_compiler

import hysteresis_ros as hr
from hysteresis_ros.control.controller import DESIGNS
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.errors import ConfigurationError, HysteresisError, ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_array import MOST_AXES, AxisArray, parameters_of_each
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.signals import ACTUATOR

#: All signals of an axis.
ALL = [signal.name for signal in ACTUATOR.row]
#: Number of axes in most tests, and of samples in their runs.
AXES, SAMPLES = 24, 60


def differing(one, count):
    """Return the parameters of axes with different noise, offset and resolution of their sensors."""
    each = {
        "plant_simulator.sensor.seed": np.arange(1, count + 1),
        "plant_simulator.sensor.offset": np.linspace(-1e-8, 1e-8, count),
        "plant_simulator.sensor.noise": [1e-9] * count,
    }
    return parameters_of_each(one, count, each)


def setpoints_within(one, count, samples):
    """Return setpoints that jump within the range of an axis, different for each axis, shape (count, samples)."""
    low, high = one.generator.minimum, one.generator.maximum
    jumps = np.random.default_rng(3).uniform(low, high, (count, -(-samples // 20)))
    return np.repeat(jumps, 20, axis=1)[:, :samples]


def assert_each_is_the_axis_alone(each, setpoints, threads=1):
    run = AxisArray(each, threads).run(setpoints, signals=ALL)
    for number, one in enumerate(each):
        alone = Axis(one).run(setpoints[number])
        assert_same_bits({name: run[name][number] for name in ALL}, alone)
    return run


@pytest.mark.parametrize(
    "name",
    ["kim2009", "auwal2017", "wang2014", "wang2014_duhem", "wang2014_linear", "picma_stage", "stage700", "fleming2010"],
)
def test_every_shipped_axis_has_the_bits_that_it_has_alone(name):
    one = parameters(name)
    run = assert_each_is_the_axis_alone(differing(one, 3), setpoints_within(one, 3, 200), threads=2)
    moved = run["displacement"]
    assert np.ptp(moved[0]) > 0.0 and not np.array_equal(moved[0], moved[1])


@pytest.mark.parametrize(
    "overrides",
    [
        {"motion_controller": {"type": "open_loop"}},
        {"hysteresis_compensator": {"inverse__type": "none"}},
        {"hysteresis_compensator": {"inverse__type": "general"}},
    ],
)
def test_other_compensators_too(overrides):
    one = parameters(**HOLD, **overrides)
    assert_each_is_the_axis_alone(differing(one, 3), setpoints_within(one, 3, 200))


@pytest.mark.slow
@pytest.mark.parametrize("name", DESIGNS)
def test_every_controller_too(name):
    one = parameters(**HOLD)
    bandwidth = {"pid": 30.0, "super_twisting": 30.0}.get(name)
    found = design_gains(one.motion_controller, name, 1.0 / one.plant_simulator.sample_rate, bandwidth).parameters
    one = parameters(**HOLD, motion_controller={"type": name, **found.to_mapping()})
    assert_each_is_the_axis_alone(differing(one, 3), setpoints_within(one, 3, 200))


@pytest.mark.slow
def test_an_adapting_compensator_too():
    one = adapting()
    run = assert_each_is_the_axis_alone(differing(one, 3), np.full((3, 900), one.generator.initial_setpoint))
    assert np.all(run["adapted_gain"][:, -1] < 0.95) and not np.array_equal(*run["adapted_gain"][:2])


def test_plants_and_controllers_that_differ_in_any_value_too():
    one = parameters(**HOLD)
    each = parameters_of_each(
        one,
        4,
        {
            "plant_simulator.hysteresis.polynomial.scale": [0.9, 1.0, 1.1, 1.2],
            "motion_controller.sliding_mode.phi": [0.93, 0.9, 0.95, 0.93],
            "hysteresis_compensator.hysteresis.polynomial.scale": [1.0, 1.05, 0.95, 1.0],
            "reference_generator.initial_setpoint": [0.0, 1e-6, 2e-6, 3e-6],
        },
    )
    run = assert_each_is_the_axis_alone(each, setpoints_within(one, 4, 100))
    assert len({values.tobytes() for values in run["voltage"]}) == 4


@pytest.fixture(scope="module")
def alone():
    """Parameters of axes, their setpoints, and the signals of each axis run alone."""
    one = parameters(**HOLD)
    each, wanted = differing(one, AXES), setpoints_within(one, AXES, SAMPLES)
    return each, wanted, [Axis(axis).run(row) for axis, row in zip(each, wanted, strict=True)]


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(1, AXES), threads=st.integers(1, 2 * AXES), cuts=st.sets(st.integers(1, SAMPLES - 1), max_size=6)
)
def test_neither_number_of_axes_nor_threads_nor_calls_changes_a_bit(alone, count, threads, cuts):
    each, wanted, expected = alone
    array = AxisArray(each[:count], threads)
    found = []
    for first, last in zip([0, *sorted(cuts)], [*sorted(cuts), SAMPLES], strict=True):
        if last - first == 1:
            array.step(wanted[:count, first])
            found.append({name: array[name][:, None] for name in ALL})
        else:
            found.append(array.run(wanted[:count, first:last], signals=ALL).signals)
    assert array.sample == SAMPLES
    for name in ALL:
        joined = np.concatenate([part[name] for part in found], axis=1)
        for number in range(count):
            np.testing.assert_array_equal(joined[number].view(np.int64), expected[number][name].view(np.int64), name)


def test_a_step_gives_the_voltages_of_its_sample(alone):
    each, wanted, expected = alone
    array = AxisArray(each, 3)
    for k in range(5):
        voltages = array.step(wanted[:, k])
        np.testing.assert_array_equal(voltages, [one["voltage"][k] for one in expected])
    kept = voltages.copy()
    array.step(0.0)
    np.testing.assert_array_equal(voltages, kept)  # the next step must not change the results of the previous one
    assert not np.array_equal(array["voltage"], kept)


@pytest.mark.slow
def test_an_axis_of_a_run_is_the_recording_of_that_axis():
    offsets = [0.0, 2e-8, -1e-8]
    # an amplifier with a smaller range than the compensator: the actuator receives a different voltage
    config = hr.load("kim2009").override("plant_simulator", limits__maximum=40.0)
    wanted = np.full(60, 9e-6)
    run = hr.simulate(config, axes=3, setpoints=wanted, each={"plant_simulator.sensor.offset": offsets}, threads=2)
    for number, offset in enumerate(offsets):
        single = hr.simulate(config.override("plant_simulator", sensor__offset=offset), setpoints=wanted)
        recorded = run.axis(number)
        assert_same_bits(recorded.signals, single.signals)
        assert recorded.metadata == single.metadata
        assert_same_bits(recorded.signals, hr.simulate(recorded, setpoints=wanted).signals)
    assert np.any(run.axis(0)["voltage"] != run.voltage[0])
    assert len(run) == 3 and "3 axes and 60 samples" in repr(run)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run)).voltage, run.voltage)
    np.testing.assert_array_equal(copy.copy(run).voltage, run.voltage)


def test_figures_are_those_of_each_axis():
    run = hr.simulate("kim2009", axes=3, duration=0.5, each={"plant_simulator.sensor.seed": [1, 2, 3]})
    figures = hr.metrics(run)
    for number in range(3):
        expected = hr.metrics(run.axis(number))
        for name, values in figures.items():
            np.testing.assert_equal(values[number], np.nan if expected[name] is None else expected[name], name)
    assert np.all(figures["rms_error_m"] > 0.0) and np.all(figures["steps"] >= 1)


def test_one_setpoint_may_be_for_all_and_the_last_one_holds():
    array, other = (hr.axis_array("kim2009", 2) for _ in range(2))
    run = array.run([1e-6, 2e-6], samples=5)
    expected = other.run([[1e-6] + [2e-6] * 4] * 2)
    np.testing.assert_array_equal(run.reference, expected.reference)
    assert run.time[-1] == pytest.approx(4 / 3000, abs=1e-9) and array.run([0.0]).time[0] == pytest.approx(5 / 3000)


def test_a_fault_is_that_of_every_axis():
    faults = ["offset:0.002:0.003:2e-7"]
    run = hr.simulate("kim2009", axes=2, duration=0.01, faults=faults)
    single = hr.simulate("kim2009", duration=0.01, faults=faults)
    for name in run.signals:
        np.testing.assert_array_equal(run[name], np.array([single[name]] * 2), name)


@pytest.mark.parametrize("axes", [0, -1, MOST_AXES + 1, 2.0, "3", True, None])
def test_a_wrong_number_of_axes_is_refused(axes):
    with pytest.raises(ParameterError, match=r"axes = .*: must be a whole number"):
        hr.axis_array("kim2009", axes)


@pytest.mark.parametrize("threads", [0, 1.5, 257])
def test_a_wrong_number_of_threads_is_refused(threads):
    with pytest.raises(ParameterError, match=r"threads = .*: must be a whole number"):
        hr.simulate("kim2009", axes=2, duration=0.01, threads=threads)


@pytest.mark.parametrize(
    "each, message",
    [
        ({"plant_simulator.sensor.seed": [1, 2]}, r"number of values of plant_simulator.sensor.seed = 2: .* 3 axes"),
        ({"plant_simulator.sensor.seed": 4}, r"number of values of plant_simulator.sensor.seed = 4"),
        ({"plant_simulator.sensor.seed": "123"}, r"number of values of plant_simulator.sensor.seed = '123'"),
        ({"plant_simulator.sensor.sed": [1, 2, 3]}, r"plant_simulator.sensor.sed'.*did you mean sensor.seed"),
        ({"plant_simulater.sensor.seed": [1, 2, 3]}, "did you mean plant_simulator"),
        ({"plant_simulator": [1, 2, 3]}, r"is not NODE\.PARAMETER"),
        ({"plant_simulator.sensor.noise": [0.0, 1e-9, -1.0]}, r"axis 2: plant_simulator.sensor.noise = -1.0: out of"),
        ({"plant_simulator.sensor.seed": [1, 2, 0.5]}, r"axis 2: plant_simulator.sensor.seed = 0.5: wrong type"),
        ({"plant_simulator.limits.minimum": [0.0, 0.0, 500.0]}, r"axis 2: plant_simulator: limits"),
        ({"plant_simulator.sample_rate": [3e3, 3e3, 4e3]}, r"sample_rate"),
        ({"reference_generator.initial_setpoint": [0.0, 0.0, 1e-3]}, r"initial_setpoint"),
    ],
)
def test_wrong_values_of_the_axes_are_refused_by_their_names(each, message):
    with pytest.raises(HysteresisError, match=message):
        hr.axis_array(hr.load("kim2009").override("reference_generator", waveform__type="hold"), 3, each=each)


@pytest.mark.parametrize(
    "each, message",
    [
        ({"motion_controller.type": ["sliding_mode", "open_loop"]}, "axis 1: motion_controller: the structure differs"),
        (
            {"reference_generator.waveform.type": ["steps", "hold"]},
            "reference_generator: the structure differs",
        ),
        # of the same parameters and states, so that only the law differs
        ({"reference_generator.waveform.type": ["sine", "hold"]}, "axis 1: reference_generator: the structure differs"),
        (
            {"hysteresis_compensator.inverse.type": ["exact", "none"]},
            "axis 1: hysteresis_compensator: the structure differs",
        ),
    ],
)
def test_axes_of_another_structure_are_refused(each, message):
    with pytest.raises(ConfigurationError, match=message):
        hr.axis_array("kim2009", 2, each=each)


@pytest.mark.parametrize("given", [[0.0, 0.0], np.zeros((3, 1)), "x"])
def test_setpoints_of_a_step_are_one_for_each_axis(given):
    with pytest.raises(ParameterError, match="setpoints"):
        hr.axis_array("kim2009", 3).step(given)


@pytest.mark.parametrize("given", [np.zeros((2, 5)), np.zeros((3, 0)), np.zeros((3, 2, 2)), 1.0, []])
def test_setpoints_of_a_run_are_a_row_for_each_axis(given):
    with pytest.raises(ParameterError, match=r"setpoints: shape = .*\(3, N\) or \(N,\)"):
        hr.axis_array("kim2009", 3).run(given)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"config": "inchworm_travel", "axes": 2}, "type = 'inchworm': an array contains only simulated actuators"),
        ({"config": "auwal2017_camera", "axes": 2}, "type = 'camera': an array contains only simulated actuators"),
        ({"config": "xy_scanner", "axes": 2}, "this is a stage of coupled axes"),
        ({"config": "kim2009", "axes": 2, "requests": [1.0]}, "setpoints by names are for a single run"),
        ({"config": "kim2009", "axes": 2, "setpoints": {"x": [0.0]}}, "setpoints by names are for a single run"),
        ({"config": "kim2009", "each": {"plant_simulator.sensor.seed": [1]}}, "each needs axes, the number of axes"),
    ],
)
def test_what_has_no_array_is_refused(arguments, message):
    with pytest.raises(HysteresisError, match=message):
        hr.simulate(**arguments)


def test_an_unknown_signal_or_axis_is_named():
    array = hr.axis_array("kim2009", 2)
    with pytest.raises(ParameterError, match="signal = 'volt': .*did you mean voltage"):
        array["volt"]
    run = array.run([0.0], signals=("voltage",))
    with pytest.raises(ParameterError, match=r"axis = -1: the axes are 0 … 1"):
        run.axis(-1)
    for ask in (lambda: run["displacement"], lambda: run.axis(2), lambda: array.run([0.0], signals=("front_force",))):
        with pytest.raises(ParameterError, match=r"signal = |axis = 2: the axes are 0 … 1"):
            ask()
    with pytest.raises(AttributeError, match="the signals are voltage"):
        _ = run.displacement


def test_an_array_without_an_end_needs_samples():
    config = hr.load("kim2009").override("reference_generator", waveform__type="hold")
    with pytest.raises(ConfigurationError, match="no end"):
        hr.axis_array(config, 2).run()
    assert hr.axis_array(config, 2).run(samples=3).voltage.shape == (2, 3)


@pytest.mark.slow
def test_the_page_about_many_axes_runs():
    text = (pathlib.Path(__file__).parents[2] / "docs" / "scale.md").read_text(encoding="utf-8")
    snippets = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    names: dict = {}
    for snippet in snippets:
        exec(compile(snippet, "docs/scale.md", "exec"), names)
    assert len(snippets) == 2 and names["voltages"].shape == (1024,) and names["run"].voltage.shape == (64, 300)


def test_every_axis_has_its_own_range_of_setpoints():
    one, most = parameters(**HOLD), [5e-6, 7e-6, 6e-6]
    array = AxisArray(parameters_of_each(one, 3, {"reference_generator.maximum": most}))
    np.testing.assert_array_equal(array.setpoint_range, [[one.generator.minimum, end] for end in most])


@pytest.mark.slow
@needs_compiler
@pytest.mark.skipif(not COMPILED, reason="Numba is not installed: there is no compiled loop to compare with")
def test_the_loops_in_c_of_the_benchmark_make_the_same_bits(tmp_path, monkeypatch):
    """A change of a kernel or of a layout leaves the loops in C behind, and the benchmark compares something else."""
    monkeypatch.syspath_prepend(str(pathlib.Path(__file__).parents[2] / "benchmarks"))
    bench_axis_array = pytest.importorskip("bench_axis_array", reason="an installed package has no benchmarks")
    monkeypatch.setattr(bench_axis_array, "AXES", 3)
    ours, in_c = bench_axis_array.axes(), bench_axis_array.InC(tmp_path)
    jumps = np.repeat(np.random.default_rng(4).uniform(0.0, 10e-6, (3, 30)), 20, axis=1)
    for _ in range(2):
        ours.run(jumps, signals=())
        in_c.run(jumps)
    np.testing.assert_array_equal(ours.memory.view(np.int64), in_c.array.memory.view(np.int64))
    np.testing.assert_array_equal(ours.rows, in_c.array.rows)
    assert np.ptp(ours["voltage"]) > 1.0
