# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""References that an axis cannot follow are refused by name before any motion: stroke, bandwidth, sample time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.control.learning import Learned, LearningParameters, write_learned
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import axes, reach_warnings, reachable_displacements
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters, StageScanParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.references.approach import Approach, ApproachParameters


def axis(name="kim2009", **nodes):
    """Return the axis of a configuration that comes with the package, with parameters of its nodes changed."""
    configuration = load_configuration(name)
    for node, values in nodes.items():
        configuration = configuration.override(node, **values)
    return axes(configuration)[0]


def sine(amplitude, frequency, offset, kind="sine", **more):
    return {
        "waveform__type": kind,
        "waveform__amplitude": amplitude,
        "waveform__frequency": frequency,
        "waveform__offset": offset,
        **more,
    }


def test_reach_of_the_stack_is_its_major_loop():
    # K7a: upper corner g V_max; lowest value without earlier voltage (V_max = 0): falling branch C1 V + C2 V^2 at -30 V
    low, high = reachable_displacements(axis())
    assert high == pytest.approx(0.1025e-6 * 120.0, rel=1e-9)
    falling = 9.0e-8 * -30.0 - 2.5625e-10 * 900.0
    assert low == pytest.approx(falling, rel=1e-9)


def test_a_model_of_negative_gain_reaches_the_other_side_of_zero():
    configuration = load_configuration("picma_stage")
    turned = configuration.override("motion_controller", model__dynamics__C=[-1.0], model__dynamics__input_scale=1e-6)
    (low, high), (least, most) = (
        reachable_displacements(AxisParameters.from_configuration(one)) for one in (configuration, turned)
    )
    assert (least, most) == pytest.approx((-high, -low), rel=1e-9, abs=1e-12) and least < -40e-6


def test_what_is_within_reach_is_reached_at_rest_and_what_is_refused_is_not():
    low, high = reachable_displacements(axis("picma_stage"))
    held = {"waveform__type": "hold", "maximum": 2.0 * high, "approach__maximum_velocity": 0.0}
    for part, reached in ((0.9, True), (1.1, False)):
        top = low + part * (high - low)
        changed = {"reference_generator": {**held, "waveform__offset": top}}
        if not reached:
            with pytest.raises(ParameterError, match=r"reference_generator: waveform\.offset = .* out of range"):
                axis("picma_stage", **changed)
            continue
        run = simulate(axis("picma_stage", **changed), duration=3.0)
        assert run["displacement"][-1] == pytest.approx(top, rel=1e-3)


@pytest.mark.parametrize(
    ("changed", "name", "value"),
    [
        (sine(7e-6, 2.0, 7e-6, maximum=15e-6), "waveform.amplitude", "14 µm"),
        (sine(2e-6, 2.0, -2e-6, minimum=-5e-6), "waveform.amplitude", "-4 µm"),
        ({"waveform__steps__values": [2e-6, 13e-6, 0.0, 0.0], "maximum": 20e-6}, "waveform.steps.values", "13 µm"),
        ({"waveform__type": "hold", "initial_setpoint": 13e-6, "maximum": 20e-6}, "initial_setpoint", "13 µm"),
        ({**sine(7e-6, 2.0, 2e-6, "triangle"), "initial_setpoint": 4e-6, "maximum": 15e-6}, "amplitude", "13 µm"),
    ],
)
def test_references_beyond_the_stroke_are_named_with_value_and_reach(changed, name, value):
    for kind in ("sliding_mode", "open_loop"):
        with pytest.raises(ParameterError) as error:
            axis(reference_generator=changed, motion_controller={"type": kind})
        (problem,) = error.value.problems
        assert problem.name.startswith("reference_generator: ") and name in problem.name
        assert value in problem.remedy and "-2.93063 … 12.3 µm" in problem.remedy
        assert "-30 … 120 V" in problem.remedy


def test_frequencies_beyond_nyquist_and_beyond_what_a_late_answer_can_follow_are_named():
    with pytest.raises(ParameterError, match=r"reference_generator: waveform\.frequency = 1600.0: must be ≤ 1500 Hz"):
        axis(reference_generator=sine(1e-7, 1600.0, 1e-6))
    with pytest.raises(ParameterError, match=r"waveform\.frequency = 600.0: must be ≤ 500 Hz.*responds a sample late"):
        axis(reference_generator=sine(1e-7, 600.0, 1e-6))
    late = {"motion_controller": {"type": "pid", "pid__Ki": 1.0, "model__dynamics__delay": 2.0 / 3000.0}}
    with pytest.raises(
        ParameterError, match=r"waveform\.frequency = 200.0: must be ≤ 166.667 Hz.*responds 3 samples late"
    ):
        axis(reference_generator=sine(1e-7, 200.0, 1e-6), **late)
    axis(reference_generator=sine(1e-7, 600.0, 1e-6), motion_controller={"type": "open_loop"})
    axis(
        reference_generator=sine(1e-7, 600.0, 1e-6),
        motion_controller={"feedforward__type": "inverse_dynamics", "feedforward__preview": 12},
    )


def test_commands_that_the_lag_makes_larger_than_the_stroke_are_named():
    # the lag of the stage passes 71 % at 12 Hz: 24 µm around the middle need 34 µm, and there are 25 µm
    changed = {"minimum": 0.0, "maximum": 50e-6}
    with pytest.raises(ParameterError, match=r"frequency = 12\.0.*pass 71\.1 % at this frequency: the sine needs"):
        axis("picma_stage", reference_generator=sine(24e-6, 12.0, 25e-6, **changed))
    followed = axis("picma_stage", reference_generator=sine(24e-6, 1.0, 25e-6, **changed))
    assert reach_warnings(followed) == ()
    axis("picma_stage", reference_generator=sine(5e-6, 12.0, 25e-6, **changed))
    (doubt,) = reach_warnings(axis("picma_stage", reference_generator=sine(24e-6, 4.0, 25e-6, **changed)))
    assert "waveform.frequency = 4.0" in doubt


@pytest.mark.parametrize("middle", [38e-6, 12e-6])
def test_the_room_of_a_waveform_is_that_to_the_nearer_end_of_the_stroke(middle):
    """At 12 Hz a sine of 10 µm needs 14 µm to each side, and there are 12 µm to one of them; 5 µm need 7 µm."""
    given = {"minimum": 0.0, "maximum": 50e-6}
    (doubt,) = reach_warnings(axis("picma_stage", reference_generator=sine(10e-6, 12.0, middle, **given)))
    assert "waveform.frequency = 12.0" in doubt
    assert reach_warnings(axis("picma_stage", reference_generator=sine(5e-6, 12.0, middle, **given))) == ()


@pytest.mark.parametrize(
    "excitation",
    [
        {"waveform__type": "chirp", "waveform__chirp__final_frequency": 1400.0, "waveform__chirp__duration": 1.0},
        {"waveform__type": "multisine", "waveform__frequency": 10.0, "waveform__multisine__last_harmonic": 140},
    ],
)
def test_identification_signals_stay_possible_up_to_nyquist(excitation):
    changed = {**excitation, "waveform__amplitude": 3e-6, "waveform__offset": 5e-6}
    assert np.ptp(simulate(axis(reference_generator=changed), duration=0.5)["reference"]) > 4e-6


def test_steps_in_closed_loop_may_ask_for_more_than_the_stroke_for_a_moment():
    low, high = reachable_displacements(axis("picma_stage"))
    changed = {"waveform__steps__values": [high, 0.0], "waveform__steps__times": [0.1, 1.0], "maximum": high}
    axis("picma_stage", reference_generator=changed)


def test_a_range_wider_than_the_reach_is_a_warning():
    assert reach_warnings(axis()) == ()
    low, high = reach_warnings(axis(reference_generator={"minimum": -4e-6, "maximum": 15e-6}))
    assert "minimum = -4 µm" in low and "maximum = 15 µm" in high and "12.3 µm" in high
    # from 20 V on, 0 is beyond the lower end
    limits = {"limits__minimum": 20.0, "safe_voltage": 20.0}
    bounded = axis(
        plant_simulator=limits,
        hysteresis_compensator=limits,
        reference_generator={"minimum": 0.0, "maximum": 8e-6, "initial_setpoint": 4e-6},
    )
    (found,) = reach_warnings(bounded)
    assert "minimum = 0 µm" in found and reachable_displacements(bounded)[0] > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["square", "steps"])
def test_a_warning_names_steps_whose_level_is_not_reached_before_the_next_one(kind):
    limits = {
        f"approach__maximum_{name}": value
        for name, value in zip(("velocity", "acceleration"), (1e-3, 0.2), strict=True)
    }
    given = {"minimum": 0.0, "maximum": 10e-6, "approach__steps": True, "waveform__type": kind, **limits}
    step = 1.0 / axis().plant_simulator.sample_rate
    approach = ApproachParameters(maximum_velocity=1e-3, maximum_acceleration=0.2)
    needed = round(Approach(approach, step, 0.0, 10e-6).duration(4e-6) / step)
    found = []
    for samples in (20, needed - 2, needed + 1, 400):
        time = samples * step
        if kind == "square":
            given |= {"waveform__polarity": "symmetric", "waveform__frequency": 0.5 / time}
            given |= {"waveform__amplitude": 2e-6, "waveform__offset": 4e-6}
        else:
            levels = {"values": (2e-6, 6e-6, 2e-6), "times": (0.0, time, 2.0 * time), "period": 3.0 * time}
            given |= {f"waveform__steps__{name}": value for name, value in levels.items()}
        built = axis(reference_generator=given, motion_controller={"type": "open_loop"})
        warned = [text for text in reach_warnings(built) if "the axis does not reach the level" in text]
        reached = np.ptp(simulate(built, duration=4.0 * time)["reference"][samples:]) > 4e-6 - 1e-15
        assert bool(warned) != reached
        assert all("a step of 4 µm takes " in text and f"comes after {time:.3g} s" in text for text in warned), warned
        found.append(reached)
    assert found[0] is np.False_ and found[-1] is np.True_


def test_a_waveform_that_the_slew_rate_limits_is_named_with_what_it_allows():
    """Kim's model has 0.1015 µm/V between -30 and 120 V; a triangle of 4 µm at 100 Hz needs 7.88 kV/s."""
    low, high = reachable_displacements(axis())
    needed = 2.0 * 4e-6 * 100.0 * 150.0 / (high - low)
    open_loop = {"motion_controller": {"type": "open_loop"}}

    def given(share, kind="triangle", **more):
        limits = {"limits__slew_rate": needed / share}
        return {"plant_simulator": limits, "reference_generator": sine(4e-6, 100.0, 3e-6, kind, **more)}

    assert reach_warnings(axis(**given(0.999))) == ()
    (closed,) = reach_warnings(axis(**given(1.05)))
    with pytest.raises(ParameterError, match=r"reference_generator: waveform\.frequency = 100\.0: the triangle needs"):
        axis(**given(2.0))
    (opened,) = reach_warnings(axis(**given(2.0), **open_loop))
    for text, share in ((closed, 1.05), (opened, 2.0)):
        assert f"lower it to {100.0 / share:.4g} Hz, or amplitude to {4.0 / share:.4g} µm" in text
    # a bare square has half a period for its step; one that the approach shapes is judged by the approach
    (square,) = reach_warnings(axis(**given(2.0, "square")))
    shaped = {"approach__steps": True, "approach__maximum_velocity": 1e-2}
    assert "the square needs" in square and reach_warnings(axis(**given(2.0, "square", **shaped))) == ()


def test_a_period_of_fewer_than_four_samples_is_a_warning():
    changed = {"reference_generator": sine(1e-7, 900.0, 1e-6), "motion_controller": {"type": "open_loop"}}
    (text,) = reach_warnings(axis(**changed))
    assert "frequency = 900.0: 3.33 samples per period do not resolve the sine; lower it to 750 Hz" in text


def test_a_short_preview_is_a_warning_of_the_axis():
    changed = {"feedforward__type": "inverse_dynamics", "feedforward__preview": 2}
    (doubt,) = reach_warnings(axis(motion_controller=changed, reference_generator={"waveform__type": "hold"}))
    assert doubt.startswith("motion_controller: feedforward.preview = 2")


def test_bare_steps_into_an_inverse_of_the_dynamics_are_refused_and_it_is_said_what_to_do():
    changed = {"feedforward__type": "inverse_dynamics", "feedforward__preview": 12}
    limits = {"approach__maximum_velocity": 1e-4, "approach__maximum_jerk": 1.0}
    square = {"waveform__type": "square", "waveform__amplitude": 1e-6, "waveform__frequency": 5.0}
    for waveform in ({}, square):  # the configuration's own are steps
        with pytest.raises(ParameterError, match=r"waveform\.type = '(steps|square)': .* set approach\.steps: true"):
            axis(motion_controller=changed, reference_generator={**limits, **waveform})
        with pytest.raises(ParameterError, match=r"give approach\.maximum_velocity, .* set approach\.steps: true"):
            axis(motion_controller=changed, reference_generator={"approach__steps": True, **waveform})
        axis(motion_controller=changed, reference_generator={**limits, "approach__steps": True, **waveform})
        axis(reference_generator={**limits, **waveform})
    axis(motion_controller=changed, reference_generator=sine(2e-6, 5.0, 5e-6))


def test_dynamics_for_another_sample_time_are_refused_for_plant_and_model():
    with pytest.raises(ParameterError) as error:
        axes(load_configuration("kim2009").override("", sample_rate=2000.0))
    plant, model = error.value.problems
    assert plant.name == "plant_simulator: dynamics.sample_time"
    assert model.name == "motion_controller: model.dynamics.sample_time"
    assert "runs at 0.0005 s (sample_rate 2000 Hz): set sample_rate to 3000" in plant.remedy
    stated = LinearParameters(A=(0.5,), B=(0.5,), C=(1.0,), sample_time=3.33333333e-4)
    LinearDynamics(stated, 1.0 / 3000.0)
    with pytest.raises(ParameterError, match=r"dynamics\.sample_time"):
        LinearDynamics(stated, 3.3334e-4)
    LinearDynamics(LinearParameters(A=(0.5,), B=(0.5,), C=(1.0,)), 1.0)


def test_preview_and_inverse_dynamics_bring_the_loop_to_the_delayed_reference():
    changed = {"feedforward__type": "inverse_dynamics", "feedforward__preview": 20, "type": "open_loop"}
    moved = axis(motion_controller=changed, reference_generator=sine(2e-6, 100.0, 5e-6))
    moved = Axis(moved)
    table = moved.run(np.zeros(6000))
    delayed = np.concatenate([np.full(20, table["reference"][0]), table["reference"][:-20]])
    late = slice(4500, None)  # the plant starts at 0, not at the reference, and its resonance rings for a second
    error = table["displacement"][late] - delayed[late]
    without = table["displacement"][late] - table["reference"][late]
    assert np.std(error) < 0.02 * np.std(without)


LEARNS = {
    "learning__type": "repetitive",
    "learning__period": 0.01,
    "learning__error_filter": (0.05, 0.1, 0.05),
    "learning__robustness_filter": (0.5, 0.25),
    "learning__maximum": 5e-7,
}


@pytest.mark.parametrize(("frequency", "warned"), [(100.0, False), (200.0, False), (50.0, True), (130.0, True)])
def test_a_correction_for_another_period_is_named(frequency, warned):
    """It is learned for 10 ms."""
    found = reach_warnings(axis(reference_generator=sine(1e-7, frequency, 1e-6), motion_controller=LEARNS))
    assert sum("learning.period = 10 ms is not a whole number of periods" in text for text in found) == warned


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, None),
        ({"waveform__amplitude": 1.05e-7}, "on a path of 0.1989 µm, but the waveform has a path of 0.2088 µm"),
        ({"waveform__type": "triangle"}, "on a path of 0.1989 µm, but the waveform has a path of 0.1 µm"),
        ({"waveform__frequency": 200.0}, "with another phase or frequency of the waveform"),
        ({"waveform__phase": math.pi}, "with another phase or frequency of the waveform"),
        ({"waveform__offset": 1.2e-6}, "0.2 µm below this path (initial_setpoint, waveform.offset)"),
        ({"initial_setpoint": 2e-7}, "0.2 µm below this path (initial_setpoint, waveform.offset)"),
        ({"initial_setpoint": 2e-7, "waveform__offset": 0.8e-6}, None),
    ],
)
@pytest.mark.parametrize("active", [True, False])
def test_a_file_that_was_learned_on_another_path_is_named(changed, words, active, tmp_path):
    """Learned with a sine of 100 nm around 1 µm."""
    sample_time = 1.0 / axis().plant_simulator.sample_rate
    count = round(0.01 / sample_time)
    path = 1e-6 + 1e-7 * np.sin(2.0 * np.pi * np.arange(count) / count)
    write_learned(tmp_path / "learned.yaml", Learned(0.01, sample_time, np.zeros(count), path))
    learns = LEARNS | {"learning__file": str(tmp_path / "learned.yaml"), "learning__active": active}
    moved = sine(1e-7, 100.0, 1e-6) | changed
    found = [
        text for text in reach_warnings(axis(reference_generator=moved, motion_controller=learns)) if "learning" in text
    ]
    assert len(found) == (words is not None) and all(words in text for text in found)
    assert all(("learning starts without it" in text) == active for text in found)


def test_a_correction_for_another_line_rate_of_a_scan_is_named():
    """The fast axis repeats after a line, the slow axis after a frame of six lines and two of flyback."""
    parameters = StageParameters.from_configuration(load_configuration("xy_scanner"))
    lines = ("width=16um", "depth=8um", "lines=6", "flyback=2", "slow=ramped")
    rasters = [StageScanParameters("raster", (*lines, f"line_rate={rate}Hz")) for rate in (20, 25)]
    scanned = [parameters.following(raster) for raster in rasters]
    for place, period in enumerate((0.05, 0.4)):
        own = {key.removeprefix("learning__"): value for key, value in LEARNS.items()}
        learning = LearningParameters(**own | {"period": period})
        for stage, warned in zip(scanned, (False, True), strict=True):
            axis_learns = replace(stage.axes[place].motion_controller, learning=learning)
            found = reach_warnings(replace(stage.axes[place], motion_controller=axis_learns))
            assert sum("learning.period" in text for text in found) == warned
