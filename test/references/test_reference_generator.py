# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The generator: sum of approach and waveform, range, stop and start without a jump."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.references import ReferenceGenerator, ReferenceParameters

TS = 1e-3
LIMITED = {"approach.maximum_velocity": 1e-4, "approach.maximum_acceleration": 1e-2, "approach.maximum_jerk": 1.0}
SINE = {"waveform.type": "sine", "waveform.amplitude": 2e-6, "waveform.frequency": 5.0, "waveform.offset": 5e-6}


def build(*mappings, **own):
    merged = {name: value for mapping in mappings for name, value in mapping.items()}
    return ReferenceGenerator(ReferenceParameters.from_mapping({**merged, **own}), TS)


@pytest.mark.slow
def test_reference_is_approach_plus_waveform():
    g = build(SINE)
    k = np.arange(500)
    expected = 1e-6 + 5e-6 + 2e-6 * np.sin(2 * np.pi * 5.0 * k * TS)
    assert g.simulate(np.full(500, 1e-6)) == pytest.approx(expected, abs=1e-18)


def test_setpoint_arrives_bit_equal():
    g = build(LIMITED)
    assert g.simulate(np.full(1000, 7.3e-6))[-1] == 7.3e-6


def test_steps_and_compiled_loop_are_equal_bit_for_bit():
    u = np.repeat([1e-6, 8e-6, 3e-6], 100)
    a, b = build(SINE, LIMITED), build(SINE, LIMITED)
    assert np.array_equal([a.step(value) for value in u], b.simulate(u))
    assert np.array_equal(a.state, b.state)


@pytest.mark.parametrize(
    ("low", "high", "begins", "waveform"),
    [
        (-1e-5, 3e-5, 0.0, {}),
        (-1e-5, 3e-5, 0.0, SINE | {"waveform.offset": 0.0}),
        (2e-6, 3e-5, 0.0, {}),
        (-3e-5, -4e-6, 0.0, {}),
    ],
)
def test_from_rest_the_way_to_the_initial_setpoint_keeps_the_limits(low, high, begins, waveform):
    """The way is the reference without the waveform; at its end it is the initial setpoint itself."""
    there = 0.5 * (low + high)
    given = LIMITED | waveform | {"minimum": low, "maximum": high, "initial_setpoint": there}
    jumps, found = (build(given, **{"approach.from_rest": rest}) for rest in (False, True))
    way = found.simulate(np.full(1000, there)) - (jumps.simulate(np.full(1000, there)) - there)
    assert way[0] == pytest.approx(begins, abs=1e-4 * TS) and way[-1] == pytest.approx(there, abs=1e-18)
    velocity = np.diff(np.concatenate([[begins], way])) / TS
    assert np.max(np.abs(velocity)) <= 1e-4 * (1.0 + 1e-6) and np.max(np.abs(np.diff(velocity))) <= 1e-2 * TS * 1.001
    once = found.simulate(np.full(20, there))
    found.reset()
    again = found.simulate(np.full(1000, there))
    assert once[0] == pytest.approx(jumps.simulate([there])[0]) and again[0] == pytest.approx(begins, abs=1e-4 * TS)


@pytest.mark.parametrize("shaping", [{}, {"shaping.type": "zvd", "shaping.frequency": 50.0}], ids=["plain", "shaped"])
@pytest.mark.parametrize(("low", "high"), [(-1e-5, 3e-5), (2e-6, 3e-5), (-3e-5, -4e-6)])
def test_a_waveform_that_waits_for_its_start_moves_from_rest_as_an_axis_without_a_waveform(low, high, shaping):
    there = 0.5 * (low + high)
    rest = {"minimum": low, "maximum": high, "initial_setpoint": there, "approach.from_rest": True}
    plain, waiting = build(LIMITED, rest, shaping), build(LIMITED, rest, shaping, SINE)
    waiting.wait_for_start()
    assert waiting.moving and waiting.waits and not waiting.unasked
    way = waiting.simulate(np.full(1000, there))
    assert waiting.waits and (not waiting.moving or shaping)
    assert np.array_equal(way, plain.simulate(np.full(1000, there)))
    assert abs(way[0] - there) > 1e-6 and way[-1] == pytest.approx(there, abs=1e-18)


@pytest.mark.parametrize("shape", ["steps", "square", "staircase"])
def test_with_approach_steps_a_waveform_keeps_the_limits_and_arrives(shape):
    levels = {"waveform.steps.values": [2e-6, 9e-6, 4e-6], "waveform.steps.times": [0.0, 0.3, 0.7]}
    cycles = {"waveform.frequency": 1.0, "waveform.staircase.steps": 3} if shape != "steps" else {}
    given = {"waveform.type": shape, "waveform.amplitude": 9e-6, **levels, **cycles}
    bare, kept = build(LIMITED, given), build(LIMITED, given, **{"approach.steps": True})
    start = np.zeros(1)
    first, found = (np.concatenate([start, g.simulate(np.zeros(1000))]) for g in (bare, kept))
    assert np.max(np.abs(np.diff(first))) > 1e-6, "a bare waveform jumps"
    limits = [LIMITED[f"approach.maximum_{name}"] for name in ("velocity", "acceleration", "jerk")]
    for order, limit in enumerate(limits, start=1):
        assert np.max(np.abs(np.diff(found, order))) / TS**order <= limit * (1.0 + 1e-6)
    # if the waveform has been constant for long enough, the reference is its level
    late = round(kept.approach.duration(9e-6) / TS)
    stood = [k for k in range(late, 1001) if np.ptp(first[k - late + 1 : k + 1]) == 0.0]
    assert len(stood) > 100 and np.array_equal(found[stood], first[stood])


def test_approach_steps_leave_other_waveforms_and_unlimited_ones_alone():
    plain, kept = build(SINE, LIMITED), build(SINE, LIMITED, **{"approach.steps": True})
    assert np.array_equal(plain.simulate(np.zeros(300)), kept.simulate(np.zeros(300)))
    square = {"waveform.type": "square", "waveform.amplitude": 4e-6, "waveform.frequency": 10.0}
    plain, kept = build(square), build(square, **{"approach.steps": True})
    assert np.array_equal(plain.simulate(np.zeros(300)), kept.simulate(np.zeros(300)))


def test_limited_steps_start_without_a_jump_and_follow_a_new_waveform():
    square = {"waveform.type": "square", "waveform.amplitude": 4e-6, "waveform.frequency": 2.0}
    g = build(LIMITED, square, **{"approach.steps": True})
    g.simulate(np.full(137, 3e-6))
    held = g.step(3e-6)
    g.stop()
    for waveform in (square, SINE, {**square, "waveform.amplitude": 2e-6}):
        parameters = {**g.parameters.to_mapping(), **waveform}
        g.retune(ReferenceParameters.from_mapping(parameters))
        g.start()
        moved = np.concatenate([[held], g.simulate(np.full(700, 3e-6))])
        # setpoint and waveform may move together
        fastest = 2e-4 + 2.0 * np.pi * 5.0 * 2e-6 * (waveform is SINE)
        assert np.max(np.abs(np.diff(moved))) / TS <= fastest * (1.0 + 1e-6)
        held = moved[-1]
        g.stop()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 15.1e-6, -1e-9])
def test_refused_setpoint_says_value_and_range_and_changes_nothing(bad):
    g = build()
    g.step(4e-6)
    message = g.refuse(bad)
    assert f"setpoint {1e6 * bad:g} µm refused" in message and "0 … 15 µm" in message
    assert g.step(bad) == 4e-6
    assert g.setpoint == 4e-6


def test_good_setpoints_are_not_refused():
    g = build()
    assert [g.refuse(value) for value in (0.0, 7e-6, 15e-6)] == [None] * 3


def test_setpoints_leave_room_for_the_waveform():
    g = build(SINE)
    assert g.refuse(8e-6) is None
    assert "with the waveform 3 … 7 µm" in g.refuse(8.1e-6)


@pytest.mark.parametrize(
    ("mapping", "name"),
    [
        ({**SINE, "waveform.amplitude": 5.1e-6}, "waveform.amplitude"),
        ({"waveform.offset": -1e-9}, "waveform.offset"),
        ({"waveform.type": "steps", "waveform.steps.values": [16e-6], "waveform.steps.times": [0.0]},
         "waveform.steps.values"),
    ],
)  # fmt: skip
def test_waveform_that_leaves_the_range_is_refused_with_value_and_range(mapping, name):
    with pytest.raises(ParameterError) as error:
        build(mapping)
    (problem,) = error.value.problems
    assert problem.name == name
    assert "0 µm … 15 µm (minimum … maximum)" in problem.remedy


def test_wrong_ranges_are_refused():
    with pytest.raises(ParameterError, match="maximum"):
        build(minimum=1e-6, maximum=1e-6)
    with pytest.raises(ParameterError, match="initial_setpoint"):
        build(initial_setpoint=16e-6)


def test_stop_freezes_and_setpoints_do_not_move_it():
    g = build(SINE, LIMITED)
    last = g.simulate(np.full(37, 1e-6))[-1]
    g.stop()
    assert not g.running
    assert np.all(g.simulate(np.full(100, 3e-6)) == last)


@pytest.mark.parametrize("limits", [{}, LIMITED])
def test_start_runs_from_the_beginning_without_a_jump(limits):
    g = build(SINE, limits)
    last = g.simulate(np.full(50, 1e-6))[-1]  # the peak of the sine
    g.stop()
    g.simulate(np.full(10, 1e-6))
    g.start()
    y = np.concatenate([[last], g.simulate(np.full(2000, 1e-6))])
    fastest_sine = 2e-6 * 2 * np.pi * 5.0
    fastest_fade = 1.875 * 2e-6 / 0.1 if not limits else 1e-4
    assert np.max(np.abs(np.diff(y))) / TS <= (fastest_sine + fastest_fade) * (1 + 1e-9)
    k = np.arange(1000, 2000)
    assert y[1001:] == pytest.approx(6e-6 + 2e-6 * np.sin(2 * np.pi * 5.0 * k * TS), abs=1e-18)


@pytest.mark.parametrize("limits", [{}, LIMITED])
@pytest.mark.parametrize("position", [0.0, 3.1e-6, 11.9e-6])
def test_a_beginning_amid_a_run_stays_there_until_somebody_asks(limits, position):
    """At 11.9 µm the waveform would leave the range: there is no setpoint, but the position is kept."""
    g = build(SINE, limits, initial_setpoint=1e-6)
    g.begin_at(position)
    assert g.unasked and g.running and not g.moving
    assert set(g.simulate(np.full(100, g.setpoint))) == {position}
    moved = g.simulate(np.full(3000, 2e-6))
    assert moved[-1] == 2e-6 and not g.unasked and g.waits  # without the waveform
    g.start()
    assert not g.waits
    assert np.ptp(g.simulate(np.full(1000, 2e-6))) > 3.9e-6


@pytest.mark.parametrize("beyond", [-3e-6, 1.8e-5])
def test_an_axis_that_is_beyond_the_range_stays_there_and_moves_into_the_range_without_a_jump(beyond):
    g = build(LIMITED)
    g.begin_at(beyond)
    assert set(g.simulate(np.full(10, g.setpoint))) == {beyond}
    way = np.concatenate([[beyond], g.simulate(np.full(1500, 7e-6))])
    toward = np.sign(7e-6 - beyond) * np.diff(way)
    assert np.min(toward) >= -1e-18 and np.max(toward) <= 1e-4 * TS * (1.0 + 1e-6) and way[-1] == 7e-6
    assert np.max(np.abs(np.diff(toward))) <= 1e-2 * TS**2 * 1.001


@pytest.mark.parametrize("limits", [{}, LIMITED])
@pytest.mark.parametrize("stopped", [False, True])
def test_a_start_after_it_goes_to_the_initial_setpoint_without_a_jump(limits, stopped):
    g = build(SINE, limits, initial_setpoint=1e-6)
    g.begin_at(9e-6)
    g.simulate(np.full(10, 9e-6))
    if stopped:
        g.stop()
        assert g.step(9e-6) == 9e-6
    g.start()
    y = np.concatenate([[9e-6], g.simulate(np.full(3000, 1e-6))])
    assert np.max(np.abs(np.diff(y))) / TS < 2e-6 * 2 * np.pi * 5.0 + 1.875 * 4e-6 / 0.1
    assert not g.unasked and (y[-1000:].min(), y[-1000:].max()) == pytest.approx((4e-6, 8e-6), rel=1e-3)
    g.begin_at(9e-6)
    g.reset()
    assert not g.unasked and g.setpoint == 1e-6


def test_waveform_changes_only_while_stopped():
    g = build(LIMITED, SINE)
    g.simulate(np.full(40, 1e-6))
    other = replace(g.parameters, waveform=replace(g.parameters.waveform, type="triangle"))
    with pytest.raises(ParameterError, match=r"waveform\.type.*stop"):
        g.retune(other)
    g.stop()
    last = g.step(1e-6)
    g.retune(other)
    assert g.step(1e-6) == last
    g.start()
    assert g.step(1e-6) == pytest.approx(last, abs=1e-4 * TS)
    settled = g.simulate(np.full(1999, 1e-6))
    assert (settled[1000:].min(), settled[1000:].max()) == pytest.approx((6e-6, 8e-6))


def test_refused_retune_changes_nothing():
    g = build(LIMITED, SINE)
    g.stop()
    before, kernel = g.parameters, g.waveform_kernel
    with pytest.raises(ParameterError, match=r"waveform\.amplitude"):
        g.retune(replace(before, waveform=replace(before.waveform, amplitude=1.0)))
    with pytest.raises(ParameterError, match="maximum"):
        g.retune(replace(before, maximum=20e-6))
    assert g.parameters is before
    assert g.waveform_kernel is kernel


def test_reset_and_state():
    g = build(SINE, LIMITED, initial_setpoint=1e-6)
    u = np.repeat([2e-6, 4e-6], 60)
    first = g.simulate(u)
    state = g.state
    rest = g.simulate(u)
    g.stop()
    g.state = state
    assert np.array_equal(g.simulate(u), rest)
    g.reset()
    assert np.array_equal(g.simulate(u), first)


def test_table_has_units_and_descriptions():
    for row in ReferenceParameters.table():
        assert row.description
        assert row.unit or row.type is not float or row.name in ("waveform.square.duty", "shaping.damping")
