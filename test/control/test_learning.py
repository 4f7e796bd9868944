# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The learned correction: its law in loops with known responses, its limits, its filters, and its file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_support import RATE, REFERENCE, N, followed, learning

from hysteresis_ros.control import learning as at
from hysteresis_ros.control.learning import (
    FORGETTING,
    FROZEN,
    KIND,
    LEARNING,
    LIMITED,
    Learned,
    learned_correction,
    read_learned,
    shown,
    write_learned,
)
from hysteresis_ros.designs.learning_filters import MARGIN, UNSEEN, Response, design_filters
from hysteresis_ros.errors import ConfigurationError, ParameterError


@pytest.mark.slow
def test_a_delayed_loop_of_wrong_gain_is_inverted_in_one_period_by_a_filter_that_looks_as_far_ahead():
    m, e = followed(learning(error_filter=(1.0 / 0.8,), lead=3), (0.0, 0.0, 0.0, 0.8), 4)
    assert np.max(np.abs(e[0])) > 1e-7
    # the first samples of the first period were measured before the reference began
    np.testing.assert_allclose(m[1, 3:-3], (1.0 / 0.8) * np.roll(e[0], -3)[3:-3], rtol=1e-12)
    np.testing.assert_allclose(e[2, 3:], 0.0, atol=1e-18)
    np.testing.assert_allclose(e[3], 0.0, atol=1e-18)


def test_the_error_falls_by_the_factor_that_contraction_says():
    c, gain, factor = 0.5, 0.9, 0.6
    _, e = followed(learning(error_filter=(c,), lead=1, gain=factor), (0.0, gain), 8)
    for j in range(1, 6):
        np.testing.assert_allclose(e[j + 1], (1.0 - factor * c * gain) * e[j], rtol=1e-9, atol=1e-21)


def test_the_gain_falls_as_the_number_of_periods_says_and_the_limit_stays_where_it_is():
    block = learning(error_filter=(1.0,), lead=1, gain=0.8, averaging=2.0, least_gain=0.1)
    _, e = followed(block, (0.0, 1.0), 30, REFERENCE + 5e-7)
    # nothing is known of a period before the first one: learning begins with the second, j = 2
    expected = [min(0.8, max(2.0 / j, 0.1)) for j in range(2, 31)]
    found = [1.0 - e[j, 5] / e[j - 1, 5] for j in range(2, 12)]
    np.testing.assert_allclose(found, expected[1:11], rtol=1e-6)


def test_the_robustness_filter_has_no_phase():
    block = learning(error_filter=(0.0,), robustness_filter=(0.4, 0.2, 0.1))
    length = (len(block.x) - at.RINGS) // 3
    corrections = block.x[at.RINGS : at.RINGS + length]
    block.x[at.RINGS + length :] = 0.0
    corrections[(20 - N) % length] = 1e-6  # the sample 20 of the previous period
    values = [learned_correction(block.p, block.x, 0.0, 0.0) for _ in range(N)]
    expected = np.zeros(N)
    expected[18:23] = np.array([0.1, 0.2, 0.4, 0.2, 0.1]) * 1e-6
    np.testing.assert_allclose(values, expected, atol=1e-20)


def test_what_was_not_measured_is_not_learned_and_the_rest_is():
    hole = 2 * N + 17
    m, _ = followed(learning(error_filter=(0.1, 0.2, 0.1), lead=1), (0.0, 0.9), 5, bad={hole})
    unlearned = np.flatnonzero(m[3] == m[2])
    np.testing.assert_array_equal(unlearned, [16, 17, 18])


def learned_beside_a_late_voltage(recovery):
    """Return the result of learning when a late voltage disturbs the axis by 0.1 µm, which halves with each sample."""
    block = learning(error_filter=(1.0 / 0.9,), lead=1, recovery=recovery / RATE)
    knocked, late, asked = 0.0, 6 * N + 9, np.zeros(8 * N + 1)
    for k in range(8 * N):
        knocked = 1e-7 if k == late else 0.5 * knocked
        r = REFERENCE[k % N]
        error = shown(block.p, block.x, r - 0.9 * asked[k] - knocked, 0.0, float(k == late))
        asked[k + 1] = r + learned_correction(block.p, block.x, r, error)
    return block.learned().correction


def test_what_a_late_voltage_did_to_the_axis_is_not_learned():
    converged = learned_beside_a_late_voltage(N)
    waited = learned_beside_a_late_voltage(25)
    at_once = learned_beside_a_late_voltage(0)
    assert np.max(np.abs(at_once - converged)) > 1e-9
    assert np.max(np.abs(waited - converged)) < 1e-12


def test_where_commands_were_not_carried_out_it_gives_way():
    block = learning(error_filter=(0.5,), lead=1, gain=0.8)
    m, _ = followed(block, (0.0, 0.8), 4)
    held = [learned_correction(block.p, block.x, r, LIMITED) for r in REFERENCE]
    given = np.array([learned_correction(block.p, block.x, r, LIMITED) for r in REFERENCE])
    np.testing.assert_allclose(given[:-1], (1.0 - 0.25 * 0.8) * np.array(held)[:-1], rtol=1e-12)
    assert np.any(m[-1])


def test_a_limited_command_of_little_weight_beside_missing_samples_leaves_the_correction_as_it_is():
    """It gives way only where the limit alone withholds too much of the filter to learn."""
    block = learning(error_filter=(0.9, 0.005), lead=1)
    followed(block, (0.0, 0.8), 4)
    errors = np.where(np.arange(N) % 2, np.nan, LIMITED)
    held = np.array([learned_correction(block.p, block.x, *both) for both in zip(REFERENCE, errors, strict=True)])
    given = np.array([learned_correction(block.p, block.x, r, LIMITED) for r in REFERENCE])
    np.testing.assert_array_equal(given[:-2:2], held[:-2:2])  # 0.9 of it is missing, 0.005 is limited
    np.testing.assert_allclose(given[1:-2:2], 0.75 * held[1:-2:2], rtol=1e-12)  # the other way round


def test_frozen_it_repeats_itself_bit_for_bit_and_forgotten_it_fades_to_nothing():
    block = learning(fade=10 / RATE, error_filter=(0.5,), lead=1)
    followed(block, (0.0, 0.8), 4)
    block.set_mode(FROZEN)
    m, _ = followed(block, (0.0, 0.3), 3)
    assert np.any(m[0]) and np.array_equal(m[0], m[1]) and np.array_equal(m[1], m[2])
    block.set_mode(FORGETTING)
    fading, _ = followed(block, (0.0, 0.8), 2)
    np.testing.assert_allclose(fading[0, :10], m[0, :10] * np.linspace(0.9, 0.0, 10), atol=1e-20)
    assert not np.any(fading[0, 10:]) and not np.any(fading[1])
    block.set_mode(LEARNING)
    again, _ = followed(block, (0.0, 0.8), 3)
    assert np.any(again[2])


def test_another_reference_takes_the_correction_back_and_the_same_one_again_is_learned_anew():
    block = learning(fade=5 / RATE, error_filter=(1.2,), lead=1)
    followed(block, (0.0, 0.8), 4)
    other = np.concatenate([np.roll(-2.0 * REFERENCE, 7)] * 8)
    m, e = followed(block, (0.0, 0.8), 8, other)
    assert np.max(np.abs(m[0, 6:])) < 1e-3 * np.max(np.abs(m[-1]))
    assert np.max(np.abs(e[-1])) < 1e-4 * np.max(np.abs(e[0]))


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.0, 3.0), st.integers(2, 90), st.integers(0, 2**31))
def test_whatever_the_loop_answers_and_whatever_is_asked_it_stays_within_its_maximum(gain, period, seed):
    random = np.random.default_rng(seed)
    reference = np.concatenate([np.tile(random.normal(size=period), 200 // period + 1)[:200], random.normal(size=200)])
    block = learning(error_filter=(1.0, 1.0), lead=1, maximum=2e-7)
    m, _ = followed(block, (0.0, gain), 10, 1e-6 * reference)
    assert np.all(np.abs(m) <= 2e-7)


def test_a_period_that_is_no_whole_number_of_samples_is_refused_with_its_neighbours():
    with pytest.raises(ParameterError, match=r"40\.3 samples.*0\.04 s \(25 Hz\) and 0\.041 s"):
        learning(period=0.0403)
    for name in ("period", "maximum"):
        with pytest.raises(ParameterError, match=f"{name} = 0.0.*: missing"):
            learning(**{name: 0.0}).parameters.validated()
    with pytest.raises(ParameterError, match=f"is 1 samples; must be 2 … {at.LONGEST}"):
        learning(period=1.0 / RATE)
    with pytest.raises(ParameterError, match="has a lead of 40 samples: must be less than the period of 40"):
        learning(error_filter=(1.0,) * 41, lead=40)


def lags(spread):
    """Return T of a lag with two samples of delay, and of lags slower or faster by up to a fraction."""
    z = np.exp(1j * np.linspace(0.0, np.pi, 2049))

    def closed(gain, pole):
        return gain * (1.0 - pole) * z**-2 / (1.0 - pole / z)

    plants = [closed(1.0 + a, 0.6 + 0.3 * b) for a in (-spread, 0.0, spread) for b in (-spread, 0.0, spread)]
    return Response(closed(1.0, 0.6), np.array(plants))


@pytest.mark.parametrize("kind", ["inversion", "norm_optimal", "repetitive"])
def test_filters_contract_on_all_plants_that_are_possible_and_do_so_in_the_loop(kind):
    response = lags(0.1)
    found = design_filters(kind, response, N)
    assert found.contraction <= 1.0 - MARGIN and found.lead < N and len(found.robustness) <= N
    low_pass, learned = found.responses(np.linspace(0.0, np.pi, 2049))
    assert np.isclose(low_pass[0], 1.0)
    sizes = np.abs(low_pass - learned * response.possible) + UNSEEN * np.abs(learned)
    np.testing.assert_allclose(found.contraction, np.max(sizes), rtol=1e-9)
    assert np.max(sizes) > np.max(sizes[4]) + 1e-3, "the worst plant is not the model"
    given = {"error_filter": tuple(found.error), "lead": found.lead, "robustness_filter": tuple(found.robustness)}
    # the slowest of the lags
    answer = 0.9 * 0.43 * 0.57 ** np.maximum(np.arange(60) - 2, 0) * (np.arange(60) > 1)
    m, e = followed(learning(**given), answer, 40)
    harmonic = np.abs(np.fft.rfft(e, axis=1))[:, 1]
    turn = round(4097 / 2 * 2 / N)
    kept = 1.0 - np.abs(low_pass[turn])
    assert harmonic[-1] < max(4.0 * kept, 1e-3) * harmonic[0]
    assert np.max(np.abs(np.diff(m[-2:], axis=0))) < 1e-3 * np.max(np.abs(m[-1]))


@pytest.mark.slow
def test_a_loop_whose_sign_is_open_is_refused_by_name_and_figure():
    model = lags(0.1).model
    with pytest.raises(ConfigurationError, match=r"inversion: no bandwidth contracts .*reaches 1.* at .* Hz, but at"):
        design_filters("inversion", Response(model, np.array([model, -model])), N, sample_rate=RATE)


def test_the_inverse_is_the_one_of_which_the_worst_plant_is_best():
    # for gains g and 2 g the best inverse is 1 / (1.5 g), which leaves a third of both errors
    model = np.full(1025, 1.0 + 0.0j)
    found = design_filters("inversion", Response(model, np.array([model, 2.0 * model])), N, bandwidth=0.4)
    _, learned = found.responses([1e-3])
    np.testing.assert_allclose(learned.real, 2.0 / 3.0, rtol=0.02)


def test_what_was_learned_is_a_file_that_goes_on_where_it_ended(tmp_path):
    path = tmp_path / "learned.yaml"
    block = learning(error_filter=(1.1,), lead=1)
    m, _ = followed(block, (0.0, 0.8), 5)
    write_learned(path, block.learned(), "an axis")
    again = learning(error_filter=(1.1,), lead=1, file=str(path), active=False)
    repeated, _ = followed(again, (0.0, 0.8), 2)
    assert np.array_equal(repeated, [m[-1], m[-1]])
    # what is saved in the middle of a period begins with the period too
    for k in range(N // 3):
        learned_correction(again.p, again.x, REFERENCE[k], 0.0)
    assert np.array_equal(again.learned().correction, m[-1]) and np.array_equal(again.learned().reference, REFERENCE)


def test_a_file_of_another_axis_is_refused(tmp_path):
    path = tmp_path / "learned.yaml"
    write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, 2e-6), np.zeros(N)))
    for values, words in (
        ({"period": 2 * N / RATE}, "40 samples of 0.001 s, but the axis needs 80 samples"),
        ({"maximum": 1e-6}, "at most learning.maximum = 1e-06 m"),
        ({"file": str(tmp_path / "none.yaml")}, "cannot be read"),
        ({"file": __file__}, "is not a file of a learned correction"),
    ):
        with pytest.raises(ParameterError, match=words):
            learning(**{"file": str(path)} | values)
    write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, -2e-6), np.zeros(N)))
    with pytest.raises(ParameterError, match="a correction of 2e-06 m.*at most learning.maximum = 1e-06 m"):
        learning(file=str(path), maximum=1e-6)
    # as many samples, but of half the period each
    write_learned(path, Learned(0.5 * N / RATE, 0.5 / RATE, np.zeros(N), np.zeros(N)))
    with pytest.raises(ParameterError, match="40 samples of 0.0005 s, but the axis needs 40 samples of 0.001 s"):
        learning(file=str(path))
    for wrong in (np.inf, np.nan):
        for correction, reference in ((wrong, 0.0), (0.0, wrong)):
            write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, correction), np.full(N, reference)))
            with pytest.raises(ParameterError, match="must have the same length and contain finite numbers"):
                learning(file=str(path))
    with pytest.raises(ParameterError, match="no whole period"):
        learning().learned()


@pytest.mark.parametrize("late", [1, 2, 3])
def test_a_command_that_is_cut_after_a_late_voltage_does_not_take_the_correction_back(late):
    block = learning(shortfall=1e-7, recovery=20 / RATE)
    wrong = 1e-8
    entries = [shown(block.p, block.x, wrong, 0.0, float(k < late)) for k in range(late + 1)]
    entries += [shown(block.p, block.x, wrong, 1e-6, 0.0)]  # the axis is far from its path
    entries += [shown(block.p, block.x, wrong, 0.0, 0.0) for _ in range(20)]
    assert np.isnan(entries).all() and shown(block.p, block.x, wrong, 0.0, 0.0) == wrong
    entries = [
        shown(block.p, block.x, wrong, 1e-6, 0.0),
        *(shown(block.p, block.x, wrong, 0.0, 0.0) for _ in range(20)),
    ]
    assert entries == [LIMITED] * 21  # without a late voltage the correction itself is too large


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_learning_pauses_for_the_whole_answer_to_the_last_late_voltage(count):
    block = learning(recovery=5 / RATE, late_recovery=30 / RATE)
    entries = [shown(block.p, block.x, 1e-8, 0.0, float(k < count)) for k in range(count + 40)]
    assert np.isnan(entries[: count + 30]).all() and entries[count + 30 :] == [1e-8] * 10
    # a command that is cut meanwhile does not shorten the pause
    entries = [shown(block.p, block.x, 1e-8, 1e-6 * (k == 1), float(k == 0)) for k in range(41)]
    assert np.isnan(entries[:32]).all() and entries[32:] == [1e-8] * 9


@pytest.mark.parametrize(("late_recovery", "paused"), [(-1.0, 20), (0.0, 0), (3 / RATE, 3)])
def test_the_pause_after_a_late_voltage_may_be_its_own_and_none(late_recovery, paused):
    block = learning(recovery=20 / RATE, late_recovery=late_recovery)
    entries = [shown(block.p, block.x, 1e-8, 0.0, float(k == 0)) for k in range(30)]
    assert np.isnan(entries[: 1 + paused]).all() and entries[1 + paused :] == [1e-8] * (29 - paused)


def test_another_time_of_fading_counts_from_the_next_sample():
    block = learning(error_filter=(0.5,), lead=1)
    m, _ = followed(block, (0.0, 0.8), 4)
    block.take(block.changed(block.parameters, 10 / RATE))
    block.set_mode(FORGETTING)
    fading, _ = followed(block, (0.0, 0.8), 1)
    assert np.all(np.abs(fading[0, 10:]) == 0.0) and np.count_nonzero(fading[0, :9]) == 9


def test_what_was_not_measured_is_weighed_by_its_part_of_the_filter():
    """The taps nearly cancel; a hole of 2 % of their weight changes little, and one of half of it a lot."""
    m, _ = followed(learning(error_filter=(0.5, -0.45, 0.02), lead=1), (0.0, 0.9), 5, bad={2 * N + 17})
    np.testing.assert_array_equal(np.flatnonzero(m[3] == m[2]), [16, 17])


def test_the_correction_of_a_file_is_repeated_until_there_are_errors_to_learn_from(tmp_path):
    path, random = tmp_path / "learned.yaml", np.random.default_rng(1)
    correction = 1e-7 * random.standard_normal(N)
    write_learned(path, Learned(N / RATE, 1.0 / RATE, correction, REFERENCE))
    block = learning(robustness_filter=(0.6, 0.2), file=str(path))
    m, _ = followed(block, (0.0, 0.8), 2)
    np.testing.assert_array_equal(m[0], correction)
    assert not np.any(m[1] == correction)


@pytest.mark.parametrize("learns", [False, True])
def test_what_a_file_knows_stays_while_the_axis_approaches_its_path(tmp_path, learns):
    """The errors on the way are not those of the path."""
    path, way = tmp_path / "learned.yaml", 12
    correction = 1e-7 * np.random.default_rng(1).standard_normal(N)
    write_learned(path, Learned(N / RATE, 1.0 / RATE, correction, REFERENCE))
    block = learning(fade=4 / RATE, lead=0, file=str(path), active=learns)
    given = np.tile(REFERENCE, 3)
    given[:way] += np.linspace(-2e-5, -1e-6, way)
    m, _ = followed(block, (0.0, 0.8), 3, given)
    np.testing.assert_allclose(m[0, :4], correction[:4] * [0.75, 0.5, 0.25, 0.0], rtol=1e-12, atol=1e-20)
    assert not np.any(m[0, 4:way])
    np.testing.assert_allclose(m[0, way : way + 4], correction[way : way + 4] * [0.25, 0.5, 0.75, 1.0], rtol=1e-12)
    np.testing.assert_array_equal(m[0, way + 4 :], correction[way + 4 :])
    np.testing.assert_array_equal(m[1, :way], correction[:way])
    assert learns == bool(np.any(m[2, :way] != correction[:way]))
    assert learns or np.array_equal(m[2], correction)


@pytest.mark.parametrize("fade", [0.0, 4 / RATE])
def test_what_a_file_knows_stays_during_an_approach_of_several_periods(tmp_path, fade):
    """The axis first rests at the first value of the path, then approaches it until the middle of the fourth period."""
    path, rest, way = tmp_path / "learned.yaml", 2 * N, 7 * N // 2
    correction = 1e-7 * np.random.default_rng(1).standard_normal(N)
    write_learned(path, Learned(N / RATE, 1.0 / RATE, correction, REFERENCE))
    block = learning(fade=fade, lead=0, file=str(path))
    given = np.tile(REFERENCE, 7)
    given[:rest] = REFERENCE[0]
    given[rest:way] += np.linspace(-2e-5, -1e-6, way - rest)
    m, _ = followed(block, (0.0, 0.8), 7, given)
    np.testing.assert_array_equal(m[3, N // 2 + 4 :], correction[N // 2 + 4 :])
    np.testing.assert_array_equal(m[4, : N // 2], correction[: N // 2])
    assert np.any(m[5] != correction)


def test_another_path_than_that_of_a_file_is_learned_once_it_repeats(tmp_path):
    path = tmp_path / "learned.yaml"
    write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, 1e-7), REFERENCE))
    given = np.concatenate([np.linspace(0.0, 1e-5, 2 * N), np.tile(2.0 * REFERENCE, 6)])
    m, e = followed(learning(lead=1, file=str(path)), (0.0, 0.8), 8, given)
    assert not np.any(m[1:3]) and np.any(m[4])
    assert np.abs(e[7]).max() < 0.1 * np.abs(e[3]).max()


def test_a_file_of_another_path_is_phased_out_for_good(tmp_path):
    path = tmp_path / "learned.yaml"
    write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, 1e-7), REFERENCE))
    m, _ = followed(learning(error_filter=(0.0,), file=str(path)), (0.0, 0.8), 4, REFERENCE + 1e-6)
    assert np.array_equal(m, np.zeros((4, N)))


def test_what_a_file_knows_is_forgotten_in_the_first_period_as_in_any_other(tmp_path):
    path = tmp_path / "learned.yaml"
    write_learned(path, Learned(N / RATE, 1.0 / RATE, np.full(N, 1e-7), REFERENCE))
    block = learning(error_filter=(0.0,), fade=4 / RATE, file=str(path))
    block.set_mode(FORGETTING)
    first, _ = followed(block, (0.0, 0.8), 1)
    np.testing.assert_allclose(first[0, :5], 1e-7 * np.array([0.75, 0.5, 0.25, 0.0, 0.0]), rtol=1e-12, atol=1e-20)
    block.set_mode(LEARNING)
    later, _ = followed(block, (0.0, 0.8), 3)
    assert not np.any(later[0, 4:]) and np.all(np.abs(later[:, :4]) <= np.abs(first[0, :4]))


@pytest.mark.parametrize(
    "other",
    [{"lead": 0}, {"error_filter": (0.5,)}, {"robustness_filter": (0.9,)}, {"period": 2 * N / RATE}],
    ids=lambda other: next(iter(other)),
)
def test_filters_and_period_are_fixed_while_running(other):
    block = learning(lead=1)
    with pytest.raises(ParameterError, match=rf"learning\.{next(iter(other))} = .*is fixed while running"):
        block.changed(replace(block.parameters, **other), 0.0)
    block.take(block.changed(replace(block.parameters, gain=0.5), 0.0))
    assert block.p[at.GAIN] == 0.5


def test_the_limit_is_reached_when_the_correction_is_there_whatever_the_errors_are():
    frozen, learns = (learning(error_filter=(1.0,), lead=1, maximum=2e-7, active=active) for active in (False, True))
    down = learning(error_filter=(1.0,), lead=1, maximum=2e-7)
    for block, there, sign in ((frozen, False, 1.0), (learns, True, 1.0), (down, True, -1.0)):
        _, e = followed(block, (0.0, 0.3), 5, sign * np.abs(REFERENCE))
        assert np.max(np.abs(e[-1])) > 2e-7 and block.at_maximum == there


def test_another_kind_of_learning_is_refused():
    with pytest.raises(ParameterError, match="magic"):
        replace(at.LearningParameters(), type="magic").validated()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"correction": [0.0, 1e-9]}, "the same length"),
        ({"correction": [0.0, 1e-9, float("nan")]}, "finite numbers"),
        ({"reference": [0.0, float("inf"), 2e-6]}, "finite numbers"),
        ({"correction": 1e-9, "reference": 1e-6}, "the same length"),
        ({"period": 0.0}, "must be above 0"),
        ({"sample_time": float("inf")}, "must be above 0"),
        ({"period": "soon"}, "is not a file of a learned correction"),
    ],
)
def test_a_file_of_a_learned_correction_has_two_finite_signals_of_one_length(tmp_path, changed, said):
    whole = {"correction": [0.0, 1e-9, -1e-9], "reference": [0.0, 1e-6, 2e-6], "period": 3e-3, "sample_time": 1e-3}
    path = tmp_path / "learned.yaml"
    path.write_text(yaml.safe_dump({KIND: whole}))
    found = read_learned(path)
    assert (found.period, found.sample_time) == (3e-3, 1e-3)
    np.testing.assert_array_equal([found.correction, found.reference], [whole["correction"], whole["reference"]])
    path.write_text(yaml.safe_dump({KIND: whole | changed}))
    with pytest.raises(ParameterError, match=said):
        read_learned(path)
