# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Drivers in C: two functions of a shared library, called by machine code, monitored like every plant."""

from __future__ import annotations

import copy
import ctypes
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from driven_loops import assert_equal_to_twin, fused, run
from stage_support import compile_c, listed_library, needs_compiler
from waiting import until

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.errors import LoopError, ParameterError
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.library import FUNCTIONS, LibraryParameters
from hysteresis_ros.hardware.registry import driver_of
from hysteresis_ros.loop.axis import Axis, Change, sample_times
from hysteresis_ros.loop.device import CompiledPlant, DrivenPlant, fused_plant_of
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import DEVICE_FAILED
from hysteresis_ros.loop.simulation import differences
from hysteresis_ros.recordings.dataset import Recording

pytestmark = needs_compiler

#: No pulse comes. With its trigger input the axis has the loop with triggers, which all devices of the tests share.
STAGE = """
/**:
  ros__parameters: {{sample_rate: 3000.0, time_mode: realtime}}
/**/plant_simulator:
  ros__parameters:
    driver: {driver}
    driver_options: [{options}]
    safe_voltage: 5.0
    overtravel: -1.0
    limits: {{minimum: 0.0, maximum: 100.0, slew_rate: 6.0e+4}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/reference_generator:
  ros__parameters:
    minimum: 0.0
    maximum: 10.0e-6
    initial_setpoint: 4.0e-6
    waveform: {{type: sine, amplitude: 3.0e-6, frequency: 20.0}}
    triggers: {{input: {{action: hold}}}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/hysteresis_compensator:
  ros__parameters:
    inverse: {{type: none}}
    limits: {{minimum: 0.0, maximum: 100.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The driver without a device, and the functions that return what it received."""
    path = listed_library(tmp_path_factory.mktemp("driver"))
    found = ctypes.CDLL(str(path))
    for name in ("reads", "writes", "safes", "closes", "clocks", "edges", "triggers", "trigger"):
        getattr(found, f"noted_{name}").restype = ctypes.c_int64
    found.noted_voltage.restype, found.noted_voltage.argtypes = ctypes.c_double, (ctypes.c_int64,)
    found.noted_edges.argtypes = found.noted_trigger.argtypes = ctypes.c_int64, ctypes.c_int64
    found.noted_delay.restype, found.noted_delay.argtypes = ctypes.c_double, (ctypes.c_int64,)
    found.path = path
    return found


def written(library) -> list[float]:
    return [library.noted_voltage(index) for index in range(library.noted_writes())]


def axis_parameters(library, *options: str, **changes) -> AxisParameters:
    text = STAGE.format(driver=library.path, options=", ".join(options))
    configuration = parse_configuration(text, "test").override("plant_simulator", **changes)
    return AxisParameters.from_configuration(configuration)


def parameters(library, *options: str, **changes):
    return axis_parameters(library, *options, **changes).plant_simulator


@pytest.mark.slow
def test_machine_code_and_python_drive_it_alike(library):
    k = np.arange(4000)
    voltages = 45.0 + 70.0 * np.sin(k / 40.0) + np.random.default_rng(2).normal(scale=3.0, size=k.size)
    voltages[k % 7 == 3] = math.nan
    voltages[2000:3900] = math.nan  # beyond voltage_timeout
    chosen = parameters(library, late_limit=-1)
    found = []
    for kind in (CompiledPlant, DrivenPlant):
        plant = kind(chosen)
        plant.reset()
        rows = run(plant, voltages)
        found.append((rows, written(library)))
        plant.close()
    (compiled, sent), (python, sent_by_python) = found
    np.testing.assert_array_equal(compiled, python)
    assert sent == sent_by_python == compiled[:, at.PLANT_VOLTAGE].tolist()
    steps = np.diff(sent, prepend=5.0)
    assert np.max(np.abs(steps)) <= 20.0 * (1 + 1e-9) and min(sent) == 0.0 and max(sent) == 100.0


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("fail_read=51", "cannot be read: liblisted.so: lost its sensor; plug it in"),
        ("fail_write=51", "cannot be written: liblisted.so: lost its amplifier; plug it in"),
        ("nonsense=51", "cannot be read: .*: returns a position that is not a number; check the sensor"),
        ("nonsense=52", "cannot be read: .*: returns a position that is not a number"),
    ],
)
def test_one_that_fails_is_made_safe_in_that_sample_and_left_alone_until_start(library, kind, option, said):
    plant = kind(parameters(library, option))
    plant.reset()
    assert np.all(run(plant, [60.0] * 50)[:, at.TRIPPED] == 0.0) and not plant.failure
    safes = library.noted_safes()
    run(plant, [60.0] * 2)
    assert plant.tripped and library.noted_safes() == safes + 1
    with pytest.raises(AssertionError, match=f"driver .*liblisted.so: {said}"):
        raise AssertionError(plant.failure)
    calls = library.noted_reads(), library.noted_writes()
    plant.halt()
    library.mend()
    rows = run(plant, [60.0] * 20)
    assert (library.noted_reads(), library.noted_writes()) == calls, "a safe device must not be called"
    assert set(rows[:, at.TRIPPED]) == {DEVICE_FAILED} and np.isnan(rows[:, at.MEASURED]).all()
    assert set(rows[:, at.PLANT_VOLTAGE]) == {5.0}
    plant.start()
    back = run(plant, [60.0] * 400)
    assert not plant.tripped and not plant.failure and np.isfinite(back[:, at.MEASURED]).all()
    # from the safe voltage, at the safe slew rate
    assert np.max(np.diff(back[:, at.PLANT_VOLTAGE], prepend=5.0)) <= 1000.0 / 3000.0 * (1 + 1e-9)
    assert back[-1, at.PLANT_VOLTAGE] == 60.0
    plant.close()


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_one_that_cannot_be_made_safe_either_is_said_to_be_so(library, kind):
    plant = kind(parameters(library, "fail_read=5", "fail_safe=1"))
    run(plant, [1.0] * 10)
    left = f"does not listen: the output is still at {written(library)[-1]:.6g} V"
    assert plant.failure.endswith(left) and "; the device cannot be made safe: " in plant.failure
    with pytest.raises(DriverError, match=f"{left}; switch the voltage off at the device itself; switch it off"):
        plant.make_safe()
    assert left in plant.close()


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_one_that_cannot_be_made_safe_is_tried_again_until_it_is(library, kind):
    plant = kind(parameters(library, "fail_read=5", "fail_safe=1"))
    plant.insists_every = 0.005
    run(plant, [60.0] * 10)
    assert "cannot be made safe" in plant.failure
    tried = library.noted_safes()
    until(lambda: library.noted_safes() > tried + 2, what="two more attempts")
    voltage = plant.held()
    assert voltage == pytest.approx(written(library)[-1]) != 0.0
    library.mend()
    until(lambda: "cannot be made safe" not in plant.failure, what="the attempt that succeeds")
    safe = library.noted_safes()
    assert plant.tripped and plant.held() == 5.0
    run(plant, [60.0] * 10)
    assert library.noted_safes() == safe, "a device that is safe is not called"
    assert plant.close() == ""


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_a_sample_without_a_measurement_is_no_failure(library, kind):
    plant = kind(parameters(library, "nothing=11"))
    rows = run(plant, [20.0] * 20)
    assert not plant.tripped and np.isfinite(rows[:10, at.MEASURED]).all() and np.isnan(rows[10:, at.MEASURED]).all()
    assert library.noted_writes() == 20
    plant.close()


def test_several_joints_without_a_measurement_have_none_each(library):
    driver = driver_of(str(library.path)).driver()
    driver.open(LibraryParameters(options=("joints=3", "nothing=1")), 1000.0)
    np.testing.assert_array_equal(driver.read().positions, [math.nan] * 3)
    driver.close()


def test_the_fused_loop_reads_and_writes_once_a_sample_and_its_twin_is_the_same_bit_for_bit(library):
    given = axis_parameters(library)
    loop, table = fused(given, 3000)
    assert library.noted_reads() == library.noted_writes() == 3000
    assert written(library) == table[at.PLANT_VOLTAGE].tolist()
    # the measurement is the output of the previous sample
    np.testing.assert_array_equal(table[at.MEASURED, 1:], 1e-7 * table[at.PLANT_VOLTAGE, :-1])
    assert np.ptp(table[at.MEASURED]) > 5e-6
    assert_equal_to_twin(given, loop, table)
    signals = {signal.name: table[place] for place, signal in enumerate(at.ACTUATOR.row)}
    recorded = Recording(sample_times(0, 3000, 3000.0), signals, {}, {})
    assert differences(recorded, given) == {}
    signals["measured"][1500] += 1e-9  # the rest follows from a different measurement
    assert set(differences(recorded, given)) == {"estimated", "seen"}
    loop.axis.plant.close()
    assert library.noted_closes() == 1


#: A stage of 100 V that moves to safe and back at 150 V/s, and a triangle that requires 850 V/s.
FAST = {
    "plant_simulator": {"safe_slew_rate": 150.0, "voltage_timeout": 0.1, "late_limit": -1},
    "hysteresis_compensator": {"safe_slew_rate": 150.0},
    "reference_generator": {
        "waveform__type": "triangle",
        "waveform__amplitude": 4.25e-6,
        "waveform__frequency": 50.0,
        "initial_setpoint": 5e-6,
    },
}


def fast_axis(library) -> AxisParameters:
    configuration = parse_configuration(STAGE.format(driver=library.path, options=""), "test")
    for node, values in FAST.items():
        configuration = configuration.override(node, **values)
    return AxisParameters.from_configuration(configuration)


def test_a_reference_faster_than_the_way_back_is_reached_and_what_is_recorded_is_what_was_written(library):
    given = fast_axis(library)
    loop, table = fused(given, 6000)
    voltage, applied, reference = table[at.VOLTAGE], table[at.APPLIED], table[at.REFERENCE]
    np.testing.assert_array_equal(voltage, written(library))
    np.testing.assert_array_equal(voltage, table[at.PLANT_VOLTAGE])
    # the device is at its safe 5 V, about 45 V away from the path of 850 V/s, and the command begins there
    away = np.abs(voltage - 1e7 * reference)
    ended = int(np.argmax(away < 1.0))
    assert 0.1 < ended / 3000.0 < 1.0 and np.max(away[ended:]) < 1.0 and np.max(away[-100:]) < 1e-6
    moved = np.abs(np.diff(voltage, prepend=5.0))
    commanded = 1e7 * table[at.COMMAND]
    assert abs(commanded[0] - 5.0) < 1e-9
    assert np.all(moved <= 150.0 / 3000.0 + np.abs(np.diff(commanded, prepend=commanded[0])) + 1e-9)
    # the controller receives the voltage that was given to the actuator
    np.testing.assert_allclose(applied, 1e-7 * voltage, rtol=0.0, atol=1e-7 * 1e-9)
    assert_equal_to_twin(given, loop, table)
    loop.axis.plant.close()


@pytest.mark.parametrize("option", ["fail_read=1000", "fail_write=1000", "nonsense=1001"])
@pytest.mark.parametrize("safe", ["fail_safe=0", "fail_safe=1"])
def test_a_run_in_which_it_fails_and_is_started_again_has_a_twin_too(library, option, safe):
    given = axis_parameters(library, option, safe)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    loop = FusedLoop(axis, math.inf, 2000)
    loop.start()
    assert (
        loop.join(60.0) and axis.plant.tripped and "plug it in" in axis.plant.failure or "sensor" in axis.plant.failure
    )
    assert library.noted_safes() == 1
    left = written(library)[-1] if safe == "fail_safe=1" else 5.0
    failed = loop.take().table
    assert np.all(failed[at.PLANT_VOLTAGE, 1001:] == left) and axis.plant.held() == left
    library.mend()
    rest = FusedLoop(axis, math.inf, 1500)
    started = rest.apply(Change(0, "plant_simulator", "start"))
    rest.start()
    assert rest.join(60.0) and not rest.failure and started == 2000 and not axis.plant.failure
    both = np.concatenate([failed, rest.take().table], axis=1)
    assert np.ptp(both[at.MEASURED, 2500:]) > 5e-6
    assert_equal_to_twin(given, rest, both)
    axis.plant.close()


@pytest.mark.slow
def test_one_that_does_not_return_is_told_to_whoever_asks_and_nothing_waits_for_it(library):
    given = axis_parameters(library, "block=200")
    loop = FusedLoop(Axis(given, fused_plant_of(given.plant_simulator)))
    loop.start()
    until(lambda: loop.is_blocked, what="the driver to block")
    try:
        blocked_is_told(loop)
    finally:
        library.mend()  # otherwise its thread continues in the following tests
        assert loop.leave()
    assert loop.join(60.0) and not loop.is_blocked


def blocked_is_told(loop):
    made = loop.sample
    assert made >= 199 and loop.running
    for action in ("stop", "retune"):
        parameters = {"measurement_timeout": 0.7} if action == "retune" else {}
        with pytest.raises(LoopError, match=f"the device has not returned from sample {made} for 0.5 s"):
            loop.apply(Change(0, "motion_controller", action, parameters))
    assert not loop.leave() and loop.running
    assert loop.sample == made


@pytest.mark.slow
def test_one_that_returns_after_all_stops_the_axis_by_what_it_missed(library):
    given = axis_parameters(library, "block=200", late_limit=1000)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    loop = FusedLoop(axis)
    loop.start()
    until(lambda: loop.is_blocked, what="the driver to block")
    missed = loop.missed
    library.mend()
    try:
        until(lambda: axis.plant.tripped and axis.plant.held() == 5.0, what="the trip and the safe voltage")
    finally:
        assert loop.leave()
    assert loop.missed > missed + 1000


def test_no_copy_of_an_axis_reaches_the_device(library):
    given = axis_parameters(library)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    before = library.noted_reads(), library.noted_writes(), library.noted_safes()
    double = copy.deepcopy(axis)
    for _ in range(2):
        double.run(np.full(50, 4e-6))
        for own, its in zip(axis.plant.arrays, double.plant.arrays, strict=True):
            if not isinstance(own, tuple):
                its[...] = own
    assert (library.noted_reads(), library.noted_writes(), library.noted_safes()) == before
    axis.run(np.full(50, 4e-6))
    assert library.noted_reads() == before[0] + 50
    axis.plant.close()


def test_a_sample_that_was_skipped_does_not_call_it(library):
    given = axis_parameters(library)
    axis = Axis(given, fused_plant_of(given.plant_simulator))
    skipped = np.zeros(100)
    skipped[40:60] = 1.0
    found = axis.run(np.full(100, 4e-6), skipped=skipped)
    assert library.noted_reads() == library.noted_writes() == 80
    assert np.isnan(found["measured"][40:60]).all() and np.isfinite(found["measured"][60:]).all()
    axis.plant.close()


def test_limits_change_within_the_devices_range(library):
    chosen = parameters(library)
    plant = CompiledPlant(chosen)
    plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=50.0)))
    assert run(plant, [100.0] * 400)[-1, at.PLANT_VOLTAGE] == 50.0
    with pytest.raises(ParameterError, match=r"limits\.maximum = 500\.0: must lie within the device's range"):
        plant.retune(replace(chosen, limits=replace(chosen.limits, maximum=500.0)))
    assert run(plant, [100.0] * 20)[-1, at.PLANT_VOLTAGE] == 50.0
    plant.close()


def test_at_the_end_it_goes_to_its_safe_voltage_step_by_step(library):
    plant = CompiledPlant(parameters(library))
    run(plant, [60.0] * 400)
    steps = 0
    while plant.step_to_safe():
        steps += 1
    assert written(library)[-1] == 5.0 and steps == pytest.approx(55.0 / 1000.0 * 3000.0, abs=1.5)
    plant.close()


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_between_samples_it_is_told_its_voltage_again_and_nothing_else_moves(library, kind):
    plant = kind(parameters(library))
    run(plant, [60.0] * 100)
    before, held = library.noted_writes(), written(library)[-1]
    for _ in range(3):
        plant.refresh()
    assert library.noted_writes() == before + 3 and set(written(library)[before:]) == {held}
    step = run(plant, [60.0])[-1, at.PLANT_VOLTAGE] - held
    assert 0.0 <= step <= 1000.0 / 3000.0 * (1 + 1e-9)
    plant.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("keeps_time=1",), "the device sets the sample times itself; the loop must set them"),
        (("unit=mm",), "the device reads 'mm' and outputs 'V'; calibration.sensor.unit is 'm' and"),
        (("joints=2",), "the device has 2 joints; an axis has 1"),
        (("depth=2",), "cannot be opened: liblisted.so: does not know an option; check the device"),
    ],
)
def test_a_device_that_is_not_what_the_axis_needs_is_refused(library, options, words):
    with pytest.raises(DriverError, match=f"driver .*{words}"):
        fused_plant_of(parameters(library, *options))


@pytest.mark.slow
@pytest.mark.parametrize("left_out", [FUNCTIONS[:1], FUNCTIONS[:2], FUNCTIONS[2:4]])
def test_a_library_without_the_functions_is_refused_by_their_names_and_nothing_moves(tmp_path, left_out):
    functions = "".join(f"void {name}(void) {{}}\n" for name in FUNCTIONS if name not in left_out)
    (tmp_path / "some.c").write_text(functions)
    path = compile_c(tmp_path / "some.c", tmp_path / "some.so", "-fPIC", "-shared")
    (tmp_path / "some.yaml").write_text(STAGE.format(driver=path, options=""))
    command = [sys.executable, "-m", "hysteresis_ros.cli.entry", "up", str(tmp_path / "some.yaml")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert f"has no function {', '.join(left_out)};" in done.stderr and str(path) in done.stderr


#: A scan whose lines and pixels begin at, before and between samples of 3 kHz; 108 samples a frame.
SCAN = {
    "type": "scan",
    "amplitude": 0.0,
    "cycles": 2,
    "scan__kind": "raster",
    "scan__values": ["width=3um", "depth=2um", "lines=4", "pixels=5", "flyback=2", "frame_rate=27.7777777777778Hz"],
    "scan__clock": "pixel",
}


def scanning_axis(library, *options: str, clock: bool = True, level: str = "pixel") -> AxisParameters:
    configuration = parse_configuration(STAGE.format(driver=library.path, options=", ".join(options)), "test")
    waveform = {f"waveform__{name}": value for name, value in (SCAN | {"scan__clock": level}).items()}
    configuration = configuration.override("reference_generator", **waveform)
    return AxisParameters.from_configuration(configuration.override("plant_simulator", scan_clock=clock))


def clocked(library) -> list[tuple[int, int]]:
    """Return the edges that reached the device, each with the number of voltages before it."""
    return [tuple(library.noted_edges(i, place) for place in (0, 1)) for i in range(library.noted_clocks())]


def test_the_clock_of_a_scan_reaches_the_device_in_its_sample(library):
    from hysteresis_ros.references.scan import frame_marks, line_marks, pixel_marks
    from hysteresis_ros.references.scans import parsed_scan

    given = scanning_axis(library)
    loop, table = fused(given, 300)
    compiled = clocked(library)
    edges = table[at.SCAN_EDGES]
    assert compiled == [(int(edges[k]), k + 1) for k in np.flatnonzero(edges)]
    scan = parsed_scan(SCAN["scan__kind"], SCAN["scan__values"])
    wanted = np.zeros(300)
    for edge, marks in zip(at.Edge, (frame_marks, line_marks, pixel_marks), strict=True):
        begun = marks(scan, np.arange(216) / 3000.0).sample
        wanted[np.unique(begun[begun < 216])] += edge
    np.testing.assert_array_equal(edges, wanted)
    assert {at.Edge.FRAME | at.Edge.LINE | at.Edge.PIXEL, at.Edge.PIXEL} <= set(edges)
    assert_equal_to_twin(given, loop, table)
    loop.axis.plant.close()
    # the same driver called from Python, and not at all unless it is asked for
    for asked in (True, False):
        plant = DrivenPlant(scanning_axis(library, clock=asked).plant_simulator)
        for k in range(300):
            run(plant, [20.0])
            if edges[k]:
                plant.output_clock(at.Edge(int(edges[k])))
        assert clocked(library) == (compiled if asked else [])
        plant.close()
    for options in ({"clock": False}, {"level": "none"}):
        fused(scanning_axis(library, **options), 300)[0].axis.plant.close()
        assert clocked(library) == []
    fused(scanning_axis(library, level="frame"), 300)[0].axis.plant.close()
    assert clocked(library) == [(at.Edge.FRAME, 1), (at.Edge.FRAME, 109)]


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
def test_a_device_that_cannot_output_the_clock_is_stopped_and_its_run_has_a_twin(library, kind):
    given = scanning_axis(library, "fail_clock=9")
    if kind is CompiledPlant:
        loop, table = fused(given, 200)
        assert_equal_to_twin(given, loop, table)
        plant = loop.axis.plant
    else:
        plant = kind(given.plant_simulator)
        for _ in range(12):
            run(plant, [20.0])
            plant.output_clock(at.Edge.PIXEL)
    assert plant.tripped and library.noted_clocks() == 9 and library.noted_safes() == 1
    assert "cannot output the clock of the scan: liblisted.so: lost its outputs; plug them in" in plant.failure
    assert library.noted_writes() == clocked(library)[-1][1], "nothing was written after it"
    plant.close()


def test_a_clock_without_outputs_for_it_is_refused():
    configuration = load_configuration("kim2009").override("", time_mode="realtime")
    asked = {"scan_clock": True, "driver": "simulated"}
    given = AxisParameters.from_configuration(configuration.override("plant_simulator", **asked)).plant_simulator
    with pytest.raises(DriverError, match="driver simulated: the device has no outputs for the clock of a scan; set"):
        DrivenPlant(given)


GRID = {"triggers__start": 2e-6, "triggers__step": 1e-6, "triggers__stop": 6e-6}
STEPPING = {"triggers__input__action": "step", "triggers__input__distance": 0.25e-6}


def triggering_axis(library, *options: str, source=GRID, **plant) -> AxisParameters:
    configuration = parse_configuration(STAGE.format(driver=library.path, options=", ".join(options)), "test")
    configuration = configuration.override("reference_generator", **source).override("plant_simulator", **plant)
    return AxisParameters.from_configuration(configuration)


def triggered(library) -> list[tuple[int, int, float]]:
    """Return number, voltages before it and delay of each trigger that reached the device."""
    return [
        (library.noted_trigger(i, 0), library.noted_trigger(i, 1), library.noted_delay(i))
        for i in range(library.noted_triggers())
    ]


def test_triggers_reach_the_device_in_their_sample_and_its_pulses_step_the_setpoint(library):
    given = triggering_axis(library, "pulse=120", source=GRID | STEPPING, trigger_output=True, trigger_input=True)
    loop, table = fused(given, 300)
    numbers, delays = table[at.TRIGGER], table[at.TRIGGER_DELAY]
    k = np.flatnonzero(numbers)
    assert k.size > 10
    assert triggered(library) == [(int(numbers[i]), i + 1, delays[i]) for i in k]
    # the device is measured one call late, and reads its pulses with each measurement
    assert table[at.TRIGGER_IN].nonzero()[0].tolist() == [119, 239] and set(table[at.TRIGGER_IN]) == {0.0, 2.0}
    assert table[at.SETPOINT, [118, 119, 239]].tolist() == [4e-6, 4.5e-6, 5e-6]
    assert_equal_to_twin(given, loop, table)
    loop.axis.plant.close()
    # the same driver called from Python, and not at all unless it is asked for
    plant = DrivenPlant(given.plant_simulator)
    row = run(plant, [20.0] * 120)
    assert row[:, at.TRIGGER_IN].tolist() == [0.0] * 119 + [2.0]
    plant.output_trigger(7, 1e-4)
    assert triggered(library) == [(7, 120, 1e-4)]
    plant.close()
    fused(triggering_axis(library, "pulse=9"), 300)[0].axis.plant.close()
    assert triggered(library) == []


@pytest.mark.parametrize("kind", [CompiledPlant, DrivenPlant])
@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("fail_trigger=5", "cannot output a trigger: liblisted.so: lost its outputs; plug them in"),
        ("pulse=-50", "cannot read its trigger input: liblisted.so: lost its sensor; plug it in"),
    ],
)
def test_a_device_without_its_trigger_lines_is_stopped_and_its_run_has_a_twin(library, kind, option, said):
    given = triggering_axis(library, option, source=GRID | STEPPING, trigger_output=True, trigger_input=True)
    if kind is CompiledPlant:
        loop, table = fused(given, 200)
        assert_equal_to_twin(given, loop, table)
        plant = loop.axis.plant
    else:
        plant = kind(given.plant_simulator)
        for number in range(60):
            run(plant, [20.0])
            plant.output_trigger(number + 1, 0.0)
    assert plant.tripped and library.noted_safes() == 1 and said in plant.failure
    plant.close()


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (
            {"trigger_output": True},
            "driver simulated: the device has no output for triggers; set trigger_output: false",
        ),
        ({"trigger_input": True}, "driver simulated: the device has no trigger input; set trigger_input: false"),
    ],
)
def test_triggers_without_a_line_for_them_are_refused(asked, said):
    configuration = load_configuration("kim2009").override("", time_mode="realtime")
    configuration = configuration.override("reference_generator", waveform__type="hold", **GRID | STEPPING)
    given = AxisParameters.from_configuration(configuration.override("plant_simulator", driver="simulated", **asked))
    with pytest.raises(DriverError, match=said):
        DrivenPlant(given.plant_simulator)
