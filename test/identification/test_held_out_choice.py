# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The choice between structures on held-out parts: a structure that is better by chance in one part is not selected."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from hysteresis_ros.identification import hammerstein
from hysteresis_ros.identification.dynamics import (
    CONTINUED,
    SCREENED,
    ModalStructure,
    _best_variants,
    _variants,
)
from hysteresis_ros.identification.hammerstein import (
    PARTS,
    STRETCHES_OF_A_PART,
    PartTrial,
    _less_certain,
    held_out,
    survivor,
)
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.preprocessing import remanent_voltage
from hysteresis_ros.identification.separation import _PastTrials

COUNT = 20 * PARTS * STRETCHES_OF_A_PART
#: Part to which each sample belongs: segments are assigned in turn.
PART = np.repeat(np.arange(PARTS * STRETCHES_OF_A_PART), COUNT // (PARTS * STRETCHES_OF_A_PART)) % PARTS


@dataclass(frozen=True)
class Data:
    """Fitted data: a displacement of zero, in which all samples count."""

    kept: np.ndarray
    displacement: np.ndarray
    first: int = 0
    erased: int | None = None


@dataclass(frozen=True)
class Fit:
    """A structure with a known error on each sample; on samples used in the fit it is smaller by ``seen``."""

    errors: np.ndarray
    seen: float = 1.0
    data: Data = Data(np.ones(COUNT, dtype=bool), np.zeros(COUNT))

    def refitted(self, data):
        return Fit(self.errors, self.seen, data)

    def output(self):
        return -np.where(self.data.kept, self.seen, 1.0) * self.errors


def by_part(*sizes) -> Fit:
    """Return a structure with these RMS errors on the parts."""
    return Fit(np.array(sizes)[PART])


SIMPLE = by_part(*(1.0,) * PARTS)


@pytest.mark.parametrize(
    ("sizes", "taken"),
    [
        # better in every part, by more than 3 %
        ((0.9, 0.9, 0.9, 0.9, 0.9), True),
        ((0.8, 0.85, 0.95, 0.9, 0.9), True),
        # by less than 3 %
        ((0.98, 0.98, 0.98, 0.98, 0.98), False),
        # much better in one part and worse in all others: 6 % less in total, but not significant
        ((0.0, 1.05, 1.05, 1.05, 1.05), False),
        ((1.05, 1.05, 0.0, 1.05, 1.05), False),
        # worse
        ((1.1, 1.1, 1.1, 1.1, 1.1), False),
    ],
)
def test_more_freedom_is_taken_where_it_is_better_by_more_than_the_parts_differ(sizes, taken):
    other = by_part(*sizes)
    chosen, found = survivor([SIMPLE, other])
    assert (chosen is other) == taken
    np.testing.assert_allclose(found, [1.0, np.sqrt(np.mean(np.square(sizes)))], rtol=1e-12)


def test_errors_are_those_on_samples_that_the_fit_had_not_seen():
    """A structure that fits its training samples ten times better is not preferred for that."""
    flexible = Fit(SIMPLE.errors, seen=0.1)
    np.testing.assert_allclose(np.abs(held_out(flexible)), 1.0, rtol=1e-12)
    assert survivor([SIMPLE, flexible])[0] is SIMPLE


def test_outliers_stay_left_out_and_every_other_sample_is_held_out_once():
    kept, seen = np.arange(COUNT) % 7 != 3, []

    class Noted(Fit):
        def refitted(self, data):
            seen.append(data.kept)
            return super().refitted(data)

    assert len(held_out(Noted(SIMPLE.errors, data=Data(kept, np.zeros(COUNT))))) == np.count_nonzero(kept)
    assert len(seen) == PARTS and not any(np.any(one & ~kept) for one in seen)
    np.testing.assert_array_equal(np.sum(~np.array(seen), axis=0)[kept], 1)


def test_a_first_rise_from_rest_is_in_every_fit_and_in_no_error():
    seen, rise = [], COUNT // 5

    class Noted(Fit):
        def refitted(self, data):
            seen.append(data.kept)
            return super().refitted(data)

    everything = Data(np.ones(COUNT, dtype=bool), np.zeros(COUNT), erased=rise)
    assert len(held_out(Noted(SIMPLE.errors, data=everything))) == COUNT - rise
    assert np.all(np.array(seen)[:, :rise])
    np.testing.assert_array_equal(np.sum(~np.array(seen), axis=0)[rise:], 1)


def test_a_lag_alone_is_uncertain_by_what_it_differs_from_that_beside_a_delay():
    """3 ms by the fit and 4 ms to the other explanation are 5 ms; what only one of them has stays as it is."""
    alone = PartTrial({"lag": 10e-3}, np.zeros(3), {"lag": 3e-3, "creep_rate": 0.01}, True)
    both = PartTrial({"lag": 6e-3, "delay": 4e-3, "creep_rate": 0.5}, np.zeros(3), None, True)
    assert _less_certain(alone, both).deviations == pytest.approx({"lag": 5e-3, "creep_rate": 0.01})


@pytest.mark.parametrize("gained", [1.0, 20.0])
def test_structures_of_the_dynamics_are_ordered_by_what_their_parameters_are_worth(gained):
    """Each parameter lowers the cost by less or by more than ln N = 6.9, which it must be worth."""
    fits = []

    def fit(structure, starts, evaluations=None):
        fits.append(evaluations)
        return SimpleNamespace(structure=structure, response=structure, values=starts[0])

    known = {"unpack": lambda structure, values: (1e-3, 1e-3, [(100.0, 0.05)]), "T": 1e-3}
    search = SimpleNamespace(
        **known, fit=fit, cost=lambda structure: -gained * structure.numbers, spectra=SimpleNamespace(samples=1000)
    )
    trial = SimpleNamespace(structure=ModalStructure(True, True, 1), values=None)
    found = [one.structure.numbers for one in _best_variants(search, trial, ("lag", "delay"), True)]
    numbers = sorted(structure.numbers for structure, _ in _variants(search, trial, ("lag", "delay"), True))
    best = numbers[: len(found)] if gained < np.log(1000.0) else numbers[::-1][: len(found)]
    assert found == best
    # all are tried for a few evaluations, and the best of them completely
    assert len(fits) == len(numbers) + CONTINUED and fits.count(SCREENED) == len(numbers)


@pytest.mark.parametrize(("modes", "kept", "judged"), [((), 9, 1.0), ((), 8, 2.0), ((Mode(180.0, 0.02),), 9, 2.0)])
def test_a_held_out_error_belongs_to_the_modes_and_samples_of_its_own_fit(monkeypatch, modes, kept, judged):
    def fit(modes, kept, **numbers):
        data = SimpleNamespace(kept=np.arange(9) < kept)
        return SimpleNamespace(data=data, part=LinearPart(modes=modes), numbers=numbers)

    monkeypatch.setattr(hammerstein, "held_out", lambda _: np.array([2.0]))
    found = hammerstein.judged_again(fit(modes, kept), fit((), 9, held_out_rmse_m=1.0))
    assert found.numbers["held_out_rmse_m"] == judged


@pytest.mark.parametrize(
    ("before", "bipolar"), [(-50.0, True), (-85.0, True), (62.0, True), (62.0, False), (130.0, False)]
)
def test_the_voltage_that_left_an_actuator_remanent_is_found_on_both_sides_of_a_bipolar_one(before, bipolar):
    found, cost = remanent_voltage(lambda voltage: abs(voltage - before), 100.0, bipolar)
    assert found == pytest.approx(before, abs=2.0) and cost < 2.0
    assert remanent_voltage(lambda voltage: abs(voltage + 50.0), 100.0, False)[0] > 0.0


@pytest.mark.parametrize(("first", "rest", "there"), [(3.0, 1.0, True), (14.0, 10.0, True), (20.0, 10.0, False)])
def test_a_start_at_rest_may_be_a_little_worse_than_the_others_or_below_a_hundredth_of_the_stroke(first, rest, there):
    """RMS errors of the beginning and of the remaining samples, in thousandths of the stroke."""
    trials = _PastTrials(SimpleNamespace(stroke=1.0), None)
    trials.error = lambda: 1e-3 * np.where(np.arange(400) < 100, first, rest)
    assert trials.at_rest(100) == there


@pytest.mark.slow
def test_by_chance_a_structure_that_is_no_better_is_taken_as_often_as_the_two_rules_allow():
    """The mean of five parts exceeds one standard error by chance in 19 % (Student's t, 4 degrees of freedom).

    With the threshold of 3 % it is less; with the threshold alone it would be 26 % for errors of equal size.
    """
    random = np.random.default_rng(1)
    taken = 0
    for _ in range(1000):
        one, other = (Fit(random.standard_normal(COUNT)) for _ in range(2))
        taken += survivor([one, other])[0] is other
    assert 100 < taken < 187 + 25
