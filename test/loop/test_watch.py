# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Monitoring of inputs, sample by sample: guards, held voltages, trips; closed forms, properties, and both forms."""

from __future__ import annotations

import math

import loop_support
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from interpreted import interpreted
from watch_support import (
    FAULTS,
    guard,
    hold,
    run_guard,
    run_hold,
    run_put_out,
    run_receive,
    run_trip,
    same_in_both_forms,
    trip,
)

from hysteresis_ros.loop import faults, plant, watch
from hysteresis_ros.loop.watch import guard_parameters, samples_of, towards

NAN, INF = math.nan, math.inf
finite = st.floats(-1e3, 1e3)


# ---------------------------------------------------------------------------------------------------------- accept


def accepted(values, stamps=None, **parameters):
    """Return the values that a guard accepts, and whether the input is stale after each value."""
    return run_guard(guard(**parameters), np.array(values, dtype=float), stamps)


def test_good_values_pass_as_they_are_and_what_is_no_number_does_not():
    got, stale, x = accepted([1.0, NAN, 2.0, INF, 3.0, -INF, 4.0])
    np.testing.assert_array_equal(got, [1.0, NAN, 2.0, NAN, 3.0, NAN, 4.0])
    assert not stale.any() and x[watch.REJECTED] == 3.0 and x[watch.GOOD] == 4.0 and x[watch.AGE] == 0.0


def test_before_the_first_good_value_nothing_is_stale_however_long_it_takes():
    got, stale, x = accepted([NAN] * 50 + [7.0] + [NAN] * 3, timeout=3)
    assert got[50] == 7.0 and x[watch.REJECTED] == 53.0
    np.testing.assert_array_equal(np.flatnonzero(stale), [53])


@pytest.mark.parametrize("timeout", [1, 2, 7])
def test_an_input_is_stale_after_exactly_its_timeout_in_samples(timeout):
    got, stale, _ = accepted([1.0, 2.0] + [NAN] * 10 + [3.0, NAN], timeout=timeout)
    # counted from the first bad sample, number 2, which is the first without a value
    np.testing.assert_array_equal(np.flatnonzero(stale), [*range(1 + timeout, 12), *([13] if timeout == 1 else [])])
    assert got[12] == 3.0


def test_values_that_do_not_follow_the_last_one_are_not_used_until_the_input_is_stale():
    # equal and older stamps are refused; a gap forward is accepted
    got, *_ = accepted([1.0, 2.0, 3.0, 4.0, 5.0], stamps=[0.0, 0.0, 5.0, 4.0, 6.0], timeout=10)
    np.testing.assert_array_equal(got, [1.0, NAN, 3.0, NAN, 5.0])
    # a clock that was set back is accepted after the time-out, and the time counts from there
    got, stale, _ = accepted(range(1, 8), stamps=[100, 1, 2, 3, 4, 5, 5], timeout=3)
    np.testing.assert_array_equal(got, [1.0, NAN, NAN, NAN, 5.0, 6.0, NAN])
    np.testing.assert_array_equal(np.flatnonzero(stale), [3])


@pytest.mark.parametrize("confirm", [2, 3, 5])
def test_a_jump_is_believed_when_it_stays_for_so_many_samples(confirm):
    values = [0.0] + [9.0] * 6 + [9.5]
    got, *_ = accepted(values, spike=1.0, confirm=confirm)
    np.testing.assert_array_equal(got[:confirm], [0.0] + [NAN] * (confirm - 1))
    np.testing.assert_array_equal(got[confirm:], values[confirm:])


def test_spikes_with_good_values_between_them_are_never_believed():
    got, *_ = accepted([0.0, 9.0, 9.0, 0.5, 9.0, 9.0, 1.0, 9.0, 9.0, 1.5], spike=1.0, confirm=3)
    np.testing.assert_array_equal(got, [0.0, NAN, NAN, 0.5, NAN, NAN, 1.0, NAN, NAN, 1.5])


def test_the_largest_believable_change_itself_is_believed_and_without_a_limit_everything_is():
    assert not np.isnan(accepted([0.0, 1.0, 2.0, 1.0], spike=1.0)[0]).any()
    assert np.isnan(accepted([0.0, np.nextafter(1.0, 2.0)], spike=1.0)[0][1])
    assert not np.isnan(accepted([0.0, 1e6, -1e6], spike=0.0)[0]).any()


def test_a_jump_is_measured_from_the_last_good_value_and_taken_at_once_after_the_timeout():
    got, stale, _ = accepted([0.0, NAN, NAN, 9.0, 9.5], spike=1.0, confirm=3, timeout=2)
    np.testing.assert_array_equal(got, [0.0, NAN, NAN, 9.0, 9.5])
    np.testing.assert_array_equal(np.flatnonzero(stale), [2])
    assert np.isnan(accepted([0.0, NAN, 9.0], spike=1.0, confirm=3, timeout=2)[0][2])


@pytest.mark.parametrize("frozen", [1, 3])
def test_a_sensor_is_frozen_after_so_many_repetitions_and_free_with_the_next_other_value(frozen):
    values = [1.0] + [2.0] * 6 + [2.5, 2.5]
    got, *_ = accepted(values, frozen=frozen)
    good = np.flatnonzero(~np.isnan(got))
    np.testing.assert_array_equal(good, [*range(1 + frozen), 7, *([8] if frozen > 1 else [])])
    assert not np.isnan(accepted(values, frozen=0)[0]).any()


def test_equal_values_with_a_spike_between_them_are_no_frozen_sensor():
    got, *_ = accepted([1.0, 9.0, 1.0, 1.0, 1.0], spike=1.0, confirm=3, frozen=2)
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(got)), [0, 2, 3])


def test_a_frozen_sensor_goes_stale_and_stays_so_while_it_is_frozen():
    _, stale, _ = accepted([1.0] * 20 + [1.1], frozen=4, timeout=5)
    np.testing.assert_array_equal(np.flatnonzero(stale), range(8, 20))


@pytest.mark.slow
@given(
    st.lists(st.one_of(finite, st.sampled_from([NAN, INF, -INF])), min_size=1, max_size=60),
    st.integers(1, 8),
    st.sampled_from([0.0, 0.5, 100.0]),
    st.integers(2, 5),
    st.integers(0, 4),
)
def test_what_a_guard_lets_through_is_what_came_and_its_age_counts_what_it_did_not(
    values, timeout, spike, confirm, frozen
):
    got, stale, x = accepted(values, timeout=timeout, spike=spike, confirm=confirm, frozen=frozen)
    good = ~np.isnan(got)
    np.testing.assert_array_equal(got[good], np.array(values)[good])
    assert np.all(np.isfinite(got[good])) and x[watch.REJECTED] == np.count_nonzero(~good)
    age, expected = 0, []
    for k, used in enumerate(good):
        age = 0 if used or not good[:k].any() else age + 1
        expected.append(age >= timeout)
    np.testing.assert_array_equal(stale, expected)
    if spike and not frozen:
        # no sequence can delay the acceptance of a value longer than its confirmation takes
        run = longest = 0
        for k, used in enumerate(good):
            run = 0 if used or not np.isfinite(values[k]) or not good[:k].any() else run + 1
            longest = max(longest, run)
        assert longest < confirm


def test_durations_count_in_whole_samples_at_least_one():
    assert samples_of(0.2, 3000.0) == 600.0 and samples_of(1e-9, 1000.0) == 1.0
    assert samples_of(0.0024, 1000.0) == 2.0 and samples_of(0.0026, 1000.0) == 3.0
    np.testing.assert_array_equal(guard_parameters(0.2, 1000.0, 1e-6, 4, 9), [200.0, 1e-6, 4.0, 9.0])
    np.testing.assert_array_equal(guard_parameters(0.2, 1000.0), [200.0, 0.0, 3.0, 0.0])


# --------------------------------------------------------------------------------------------------------- towards


@given(finite, finite, st.floats(1e-6, 1e3))
def test_towards_goes_no_further_than_a_step_and_never_past_the_target(value, target, step):
    moved = towards(value, target, step)
    assert abs(moved - value) <= step * (1 + 1e-9) + 1e-12
    assert min(value, target) - 1e-12 <= moved <= max(value, target) + 1e-12
    if abs(target - value) <= step:
        assert moved == pytest.approx(target, abs=1e-12)
    else:
        assert moved == pytest.approx(value + math.copysign(step, target - value))


# ---------------------------------------------------------------------------------------------------- hold_voltage


def held(voltages, stopped=None, **parameters):
    """Return the output for these voltages."""
    given = np.array(voltages, dtype=float)
    stops = np.zeros(len(given)) if stopped is None else np.array(stopped, dtype=float)
    return run_hold(hold(**parameters), given, stops)


def test_a_voltage_that_comes_is_put_out_and_the_last_one_stays():
    out, _ = held([10.0, 50.0, NAN, NAN, -3.0, INF], timeout=5)
    np.testing.assert_array_equal(out, [10.0, 50.0, 50.0, 50.0, -3.0, -3.0])


def test_before_the_first_voltage_the_resting_one_stays_for_ever():
    out, _ = held([NAN] * 40 + [5.0], timeout=3, start=8.0)
    np.testing.assert_array_equal(out, [8.0] * 40 + [5.0])


@pytest.mark.parametrize("timeout", [1, 4])
def test_silence_of_exactly_the_timeout_slews_to_safe_and_back_without_a_jump(timeout):
    out, _ = held([10.0] + [NAN] * 12 + [9.0] * 12 + [20.0, -20.0], timeout=timeout, safe=2.0, step=1.5)
    down = np.maximum(10.0 - 1.5 * np.clip(np.arange(13) - timeout + 1, 0, None), 2.0)
    np.testing.assert_allclose(out[:13], down)
    np.testing.assert_allclose(out[13:25], np.minimum(out[12] + 1.5 * np.arange(1, 13), 9.0))
    # once the output has reached the input, it follows any change at once
    np.testing.assert_array_equal(out[25:], [20.0, -20.0])


@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_the_way_back_to_a_path_that_is_faster_than_the_step_ends_and_nears_it_in_every_sample(missing):
    # 5 Hz over 107 V at 2 kHz are 1070 V/s; the return has 150 V/s
    rate, step = 2000.0, 150.0 / 2000.0
    k = np.arange(6000)
    path = 10.0 + 107.0 * np.abs(2.0 * ((5.0 * k / rate + 0.4) % 1.0) - 1.0)
    voltages = np.where(np.random.default_rng(3).random(k.size) < missing, NAN, path)
    voltages[:20] = NAN
    out, follows = held(voltages, [1.0] * 20 + [0.0] * (k.size - 20), timeout=20, safe=0.0, step=step)
    given_ = voltages.copy()
    for j in range(1, k.size):
        given_[j] = given_[j] if np.isfinite(given_[j]) else given_[j - 1]
    first = int(np.flatnonzero(np.isfinite(given_))[0])
    away = np.abs(out - given_)[first:]
    ended = int(np.argmax(away == 0.0))
    assert away[0] > 15.0
    # the return ends no later than the initial difference divided by the step
    assert 0 < ended <= math.ceil(away[0] / step)
    assert np.all(np.diff(away[: ended + 1]) <= -min(step, away[ended - 1]) + 1e-9)
    assert np.all(away[ended:] == 0.0) and np.all(follows[first + ended :])
    # in addition to the step, the output moves no farther than the path, and never beyond both ends
    moved = np.abs(np.diff(out[first:], prepend=out[first - 1]))
    asked = np.abs(np.diff(given_[first:], prepend=given_[first]))
    assert np.all(moved <= step + asked + 1e-9)


def test_the_first_voltage_and_one_after_the_timeout_say_nothing_of_how_fast_the_path_is():
    out, _ = held([80.0, 80.0, 80.0], [1, 0, 0], safe=0.0, step=1.0)
    np.testing.assert_allclose(out, [0.0, 1.0, 2.0])
    out, _ = held([10.0] + [NAN] * 12 + [90.0, 90.0], timeout=3, safe=0.0, step=1.0)
    np.testing.assert_allclose(out[12:], [0.0, 1.0, 2.0])


def test_stopped_it_goes_to_safe_in_the_same_sample_though_voltages_come():
    out, _ = held([10.0] * 12, [0, 0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0], safe=4.0, step=2.0)
    np.testing.assert_allclose(out, [10, 10, 8, 6, 4, 4, 4, 4, 6, 8, 10, 10])


def test_a_clamp_is_never_opened_for_safety_but_follows_what_is_asked():
    # the safe voltage 5 is below the output, which stays; above the output, it rises
    out, _ = held([9.0, NAN, NAN, NAN, NAN, 3.0] + [3.0] * 8, timeout=2, safe=5.0, step=1.0, keep=True)
    np.testing.assert_allclose(out, [9, 9, 9, 9, 9, 8, 7, 6, 5, 4, 3, 3, 3, 3])
    out, _ = held([1.0, NAN, NAN, NAN, NAN, NAN, NAN], timeout=2, safe=4.0, step=1.0, keep=True)
    np.testing.assert_allclose(out, [1, 1, 2, 3, 4, 4, 4])


def test_below_the_least_voltage_it_waits_and_slews_down_when_it_may():
    p, _ = hold(step=2.0)
    x = watch.hold_state(10.0)
    out = []
    for k in range(10):
        # the other clamp is not closed yet: not below the output
        least = x[watch.HELD] if k < 3 else -INF
        out.append(watch.hold_voltage(p, x, 1.0, 0.0, least))
    np.testing.assert_allclose(out, [10, 10, 10, 8, 6, 4, 2, 1, 1, 1])
    # towards a least voltage below the output it moves by steps too, however fast the received voltage is
    quick = watch.hold_state(10.0)
    found = [watch.hold_voltage(p, quick, voltage, 0.0, 5.0) for voltage in (10.0, 0.0, 0.0)]
    np.testing.assert_allclose(found, [10, 8, 6])
    assert watch.least_beside(x, watch.hold_state(5.0)) == -INF
    waiting = watch.hold_state(5.0)
    waiting[watch.GIVEN] = 6.0
    assert watch.least_beside(x, waiting) == 1.0


voltage = st.one_of(finite, st.just(NAN))


@pytest.mark.slow
@given(
    st.lists(st.tuples(voltage, st.booleans()), min_size=1, max_size=60),
    st.integers(1, 6),
    st.floats(-50.0, 50.0),
    st.floats(0.5, 500.0),
    st.booleans(),
)
def test_whatever_comes_it_either_follows_or_moves_by_no_more_than_a_step(given_, timeout, safe, step, keep):
    voltages, stopped = [v for v, _ in given_], [float(s) for _, s in given_]
    out, follows = held(voltages, stopped, timeout=timeout, safe=safe, step=step, keep=keep)

    def target(last, silent):
        return (max(safe, previous) if keep else safe) if silent else last

    last, age, previous, begun, followed = 0.0, 0, 0.0, False, True
    for k, value in enumerate(voltages):
        moved = abs(value - last) if math.isfinite(value) and begun and age < timeout else 0.0
        if math.isfinite(value):
            last, age, begun = value, 0, True
        elif begun:
            age += 1
        silent = stopped[k] != 0.0 or age >= timeout
        if followed and not silent:
            assert out[k] == last, k
        else:
            more = 0.0 if silent else moved
            assert abs(out[k] - previous) <= (step + more) * (1 + 1e-9) + 1e-9, k
            assert min(previous, target(last, silent)) - 1e-9 <= out[k] <= max(previous, target(last, silent)) + 1e-9
        if silent and keep:
            assert out[k] >= previous - 1e-9, k  # a clamp only closes further
        if silent:
            assert not follows[k]
        assert follows[k] <= (begun or followed)
        followed, previous = bool(follows[k]), out[k]
    assert np.all(np.isfinite(out))


# ------------------------------------------------------------------------------------------------------------ trip


def tripped(late, limit, rate):
    """Return the samples after which the plant has stopped the axis, and the final state."""
    return run_trip(trip(limit, limit / rate), late)


def test_more_than_the_limit_in_a_row_trips_and_the_limit_itself_does_not():
    assert not tripped([1] * 5, 5, 1e9)[0].any()
    stopped, x = tripped([1] * 6 + [0] * 20, 5, 1e9)
    np.testing.assert_array_equal(np.flatnonzero(stopped), range(5, 26))  # latched
    assert x[plant.LATE] == 6.0 and x[plant.IN_ROW] == 0.0


def test_a_trip_lasts_though_everything_is_forgiven_by_then():
    stopped, x = tripped([1] * 6 + [0] * 500, 5, 50)
    assert stopped[5:].all() and x[plant.LEVEL] == 0.0


def test_late_ones_that_come_together_within_a_second_trip_and_spread_ones_do_not():
    rate, limit = 1000, 20
    # one in ten is five times the allowed rate of 100 per second
    stopped, _ = tripped(([1] + [0] * 9) * 100, limit, rate)
    first = int(np.argmax(stopped))
    # level after n late ones, one every ten samples: n - (n - 1) · 10 · limit/rate > limit
    expected = math.floor((limit - 0.2) / 0.8) + 1
    assert stopped.any() and first == 10 * (expected - 1)
    # one in fifty equals the allowed rate, for any time
    assert not tripped(([1] + [0] * 49) * 2000, limit, rate)[0].any()


def test_what_was_late_is_forgiven_after_a_second():
    burst, rate = [1] * 15, 1000
    assert not tripped(burst + [0] * (rate + 1) + burst, 20, rate)[0].any()
    assert tripped(burst + [0] * 100 + burst, 20, rate)[0].any()


@pytest.mark.parametrize(("wild", "why"), [(2.0, 0), (2.01, 2), (-1.0, 0), (-1.01, 2), (NAN, 0), (INF, 2), (-INF, 2)])
def test_a_measurement_beyond_the_travel_trips_in_its_sample_and_stays_so(wild, why):
    assert plant.BEYOND_TRAVEL == 2
    stopped, _ = run_trip(trip(5, 0.1, -1.0, 2.0), [0] * 9, [0.0] * 4 + [wild] + [0.0] * 4)
    np.testing.assert_array_equal(stopped, [0] * 4 + [why] * 5)


def test_without_a_limit_nothing_trips():
    stopped, x = tripped([1] * 5000, 0.0, 1000)
    assert not stopped.any() and x[plant.LATE] == 5000.0


@pytest.mark.parametrize(
    ("late_limit", "rate", "allowed"), [(0, 3000.0, 150), (0, 100.0, 20), (-1, 3000.0, 0), (7, 3000.0, 7)]
)
def test_what_late_limit_allows(late_limit, rate, allowed):
    from hysteresis_ros.loop.parameters import PlantNodeParameters

    axis = loop_support.parameters(plant_simulator={"late_limit": late_limit})
    values = {**axis.plant_simulator.to_mapping(), "late_limit": late_limit, "sample_rate": rate}
    assert PlantNodeParameters.from_mapping(values).allowed_late == allowed


@given(st.lists(st.booleans(), min_size=1, max_size=200), st.integers(1, 10))
def test_a_trip_is_latched_and_needs_more_than_the_limit(late, limit):
    stopped, x = tripped(late, limit, 50.0)
    assert np.all(np.diff(stopped) >= 0) and x[plant.LATE] == sum(late)
    assert np.count_nonzero(late[: int(np.argmax(stopped)) + 1]) > limit or not stopped.any()


def test_received_in_one_call_is_corrupted_and_then_accepted_as_in_three():
    random = np.random.default_rng(2)
    values = random.normal(size=250)
    missing = (random.random(250) < 0.1).astype(float)
    p = guard(timeout=5, spike=1.5)
    got, x, faults_x = run_receive(p, values, missing, FAULTS)
    faults_p = faults.fault_parameters(FAULTS, (faults.MEASUREMENT,), 1000.0)
    other, own = faults.fault_state(faults_p), np.zeros(watch.GUARD_STATES)
    expected = []
    for value, lost in zip(values, missing, strict=True):
        faults.begin_sample(other)
        corrupted = faults.corrupt(faults_p, other, faults.MEASUREMENT, value)
        expected.append(watch.accept(p, own, math.nan if lost else corrupted, other[faults.STAMP]))
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(x, own)
    np.testing.assert_array_equal(faults_x, other)
    assert 0 < np.count_nonzero(np.isnan(got)) < 250


def test_without_faults_nothing_is_received_but_what_came():
    assert run_receive(guard(), [1.0, 2.0, 3.0], [0.0, 1.0, 0.0], ())[0].tolist() == pytest.approx(
        [1.0, math.nan, 3.0], nan_ok=True
    )
    none = faults.fault_parameters((), (faults.VOLTAGE,), 1000.0)
    assert faults.given_instead(none, faults.fault_state(none), faults.VOLTAGE, 4.0) == 4.0
    lost = faults.fault_parameters(("lost_voltage:0:1",), (faults.VOLTAGE,), 1000.0)
    state = faults.fault_state(lost)
    faults.begin_sample(state)
    assert math.isnan(faults.given_instead(lost, state, faults.VOLTAGE, 4.0))


def test_a_plant_puts_out_holds_slews_to_safe_and_trips_and_says_which():
    missing = math.nan
    voltages = [2.0, missing, missing, missing, 2.0, 2.0, 2.0, 2.0]
    measured = [0.0] * 6 + [9.0, 0.0]
    out, modes, trip_x, _ = run_put_out(trip(0.0, 0.0, -5.0, 5.0), hold(0.0, 1.0, 2)[0], voltages, measured)
    # from the second missing voltage on: stale, a step per sample; 9.0 is outside the travel and trips at once, latched
    assert out.tolist() == [2.0, 2.0, 1.0, 0.0, 1.0, 2.0, 1.0, 0.0]
    running, holding, stale, tripped = watch.RUNNING, watch.HOLDING, watch.STALE, watch.TRIPPED
    assert modes.tolist() == [running, holding, stale, stale, running, running, tripped, tripped]
    assert trip_x[plant.TRIP] == plant.BEYOND_TRAVEL and trip_x[plant.LATE] == 3.0


@pytest.mark.slow
def test_compiled_and_interpreted_the_watch_has_the_same_bits(tmp_path):
    np.testing.assert_array_equal(same_in_both_forms(), interpreted("watch_support", "same_in_both_forms()", tmp_path))
