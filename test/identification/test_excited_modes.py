# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Modes that only a small part of a recording excites, ringing that is no outlier, and lags of held inputs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from foreign_plant import ForeignPlant

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification import dynamics
from hysteresis_ros.identification.dynamics import (
    DAMPING_RANGE,
    LinearStage,
    TurnSearch,
    _less_certain,
    choose_dynamics,
    fit_stage,
    modes_at_bounds,
    segment_spectra,
)
from hysteresis_ros.identification.hammerstein import PartSearch
from hysteresis_ros.identification.linear_systems import Known, LinearPart, Mode, undo
from hysteresis_ros.identification.prandtl_ishlinskii import DECAY_RANGE, DENSITY_SHAPE, PRIOR_DECAY, SmoothDensity
from hysteresis_ros.identification.preprocessing import condense, inliers
from hysteresis_ros.models.linear import LinearParameters

RATE = 1000.0


def loops_then_chirp(size: float, samples: int = 8000, share: float = 0.1) -> np.ndarray:
    """Decaying loops of 100 V at 0.5 Hz, then rest at the middle with a chirp of 10 … 400 Hz in the last ``share``."""
    time = np.arange(samples) / RATE
    count = int(share * samples)
    fade = np.cos(0.5 * np.pi * np.minimum(np.arange(samples) / (samples - count), 1.0)) ** 2
    voltage = 50.0 * (1.0 - np.cos(np.pi * time) * fade)
    own = np.arange(count) / RATE
    voltage[-count:] += size * np.sin(2.0 * np.pi * (10.0 * own + 195.0 * own**2 / own[-1]))
    return voltage


@pytest.mark.slow
@pytest.mark.parametrize(("size", "noise"), [(3.0, 5e-9), (2.0, 2e-8)])
def test_a_chirp_in_the_last_tenth_shows_its_mode_behind_a_hysteresis(size, noise):
    plant = ForeignPlant(RATE, hysteresis=0.3, modes=((180.0, 0.02, 1.0),), noise=noise)
    voltage = loops_then_chirp(size)
    measured = plant.record(voltage)
    spectra = segment_spectra(1.2e-7 * voltage, measured, 1.0 / RATE, late=1)
    modes = choose_dynamics(spectra).part.modes
    assert len(modes) == 1
    assert modes[0].frequency == pytest.approx(180.0, rel=3e-3) and modes[0].damping == pytest.approx(0.02, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "frequency", "size", "noise"), [(0.03, 180.0, 3.0, 5e-9), (0.1, 350.0, 2.0, 2e-8)])
def test_a_mode_that_a_chirp_passes_once_is_found(share, frequency, size, noise):
    # one segment has nearly all content at the mode; held out as a whole, it would leave nothing to predict it from
    plant = ForeignPlant(RATE, hysteresis=0.3, modes=((frequency, 0.02, 1.0),), noise=noise)
    voltage = loops_then_chirp(size, share=share)
    spectra = segment_spectra(1.2e-7 * voltage, plant.record(voltage), 1.0 / RATE, late=1)
    (mode,) = choose_dynamics(spectra).part.modes
    assert mode.frequency == pytest.approx(frequency, rel=4e-3)
    near = np.abs(spectra.frequencies / frequency - 1.0) < 0.1
    power = spectra.input[:, near].sum(axis=1)
    assert np.all(power > 0.05 * power.sum())


def test_what_happens_in_a_quarter_of_the_recording_belongs_to_several_folds():
    voltage = loops_then_chirp(3.0, share=0.25)
    spectra = segment_spectra(1.2e-7 * voltage, 1.2e-7 * voltage, 1.0 / RATE)
    power = spectra.input[:, spectra.frequencies > 30.0].sum(axis=1)
    assert np.count_nonzero(power > 0.05 * power.sum()) >= 3


@pytest.mark.slow
def test_a_mode_that_nothing_excites_is_still_not_found():
    plant = ForeignPlant(RATE, hysteresis=0.0, modes=((180.0, 0.02, 1.0),), noise=2e-9)
    voltage = loops_then_chirp(0.0)
    assert not choose_dynamics(segment_spectra(1.2e-7 * voltage, plant.record(voltage), 1.0 / RATE)).part.modes


@pytest.mark.slow
def test_no_mode_is_found_in_what_a_hysteresis_adds():
    # relays switch, so the output has content where a cosine of decaying amplitude has hardly any
    time = np.arange(16000) / (2.0 * RATE)
    wave = np.cos(2.0 * np.pi * time) * np.where(time < 2.0, 1.0, np.exp((2.0 - time) / 6.0))
    voltage = 50.0 * (1.0 - wave)
    measured = ForeignPlant(2.0 * RATE).record(voltage)
    assert not choose_dynamics(segment_spectra(1.2e-7 * voltage, measured, 0.5 / RATE, 100)).part.modes


@pytest.mark.slow
def test_a_mode_is_dropped_alone_when_its_frequency_is_not_accepted():
    plant = ForeignPlant(RATE, hysteresis=0.0, modes=((180.0, 0.02, 1.0),), noise=2e-9)
    voltage = loops_then_chirp(3.0)
    arguments = (1.2e-7 * voltage, plant.record(voltage), 1.0 / RATE, "modes")
    asked: list[float] = []

    def accepted(frequency: float) -> bool:
        asked.append(frequency)
        return frequency < 150.0

    assert not fit_stage(*arguments, late=1, accepted=accepted).part.modes and max(asked) > 170.0
    assert fit_stage(*arguments, late=1, accepted=lambda frequency: frequency > 150.0).part.modes


@pytest.mark.parametrize(("size", "excited"), [(20.0, True), (0.0, False)])
def test_content_at_the_end_of_a_recording_counts(size, excited):
    # 100 cycles at 12.5 Hz, so that 100 Hz is among their first harmonics; then the chirp
    time = np.arange(8000) / RATE
    voltage = 50.0 - 50.0 * np.cos(2.0 * np.pi * 12.5 * time)
    voltage[-400:] = 0.0
    voltage[-400:] += size * np.sin(2.0 * np.pi * (20.0 * time[:400] + 200.0 * time[:400] ** 2))
    search = TurnSearch(None, voltage, 1e-7 * voltage, 1.0 / RATE, ("modes",), 0)
    assert search.excited(90.0) == excited


@pytest.mark.parametrize("fraction", [0.12, 0.2, 0.3, 0.45])
def test_ringing_above_a_tenth_of_the_rate_is_no_outlier(fraction):
    noise = 1e-9 * np.random.default_rng(1).standard_normal(4000)
    error = noise.copy()
    place = np.arange(120)
    for start in range(300, 4000, 700):
        error[start : start + 120] += 3e-8 * np.exp(-place / 30.0) * np.cos(2.0 * np.pi * fraction * place)
    assert np.count_nonzero(~inliers(error, 0)) <= 8  # the last weak ones of six bursts
    # single samples and short intervals are outliers as before
    odd = noise.copy()
    odd[[500, 1500, 1501, 2500]] += 5e-8
    np.testing.assert_array_equal(np.flatnonzero(~inliers(odd, 0)), [500, 1500, 1501, 2500])


def test_the_tip_of_a_smooth_model_error_is_no_outlier():
    """The errors of a model at reversals are tips on a recording almost without noise."""
    place = np.arange(6000)
    tips = -4e-8 * np.maximum(1.0 - np.abs(place % 600 - 300) / 40.0, 0.0)
    error = tips + 5e-9 * np.sin(place / 200.0) + 1e-11 * np.random.default_rng(1).standard_normal(6000)
    assert inliers(error, 0).all()
    error[[1000, 2100]] += 6e-8  # the second one is on a tip
    np.testing.assert_array_equal(np.flatnonzero(~inliers(error, 0)), [1000])  # 2100 is where others are
    error[[2100, 2101]] -= 1.2e-7
    np.testing.assert_array_equal(np.flatnonzero(~inliers(error, 0)), [1000, 2100, 2101])


def test_a_mode_at_a_bound_of_its_search_is_reported():
    inside = Mode(200.0, 0.02)
    for damping in DAMPING_RANGE:
        (said,) = modes_at_bounds(LinearPart(modes=(inside, Mode(120.0, 0.9999 * damping)), hold=1e-3))
        assert "mode 120 Hz: damping" in said and "is at a search bound" in said and "--linear" in said
    (said,) = modes_at_bounds(LinearPart(modes=(Mode(489.0, 0.02),), hold=1e-3))
    assert "frequency times sample time = 0.489" in said
    assert modes_at_bounds(LinearPart(modes=(inside,), hold=1e-3)) == () == modes_at_bounds(None)


def test_the_lag_of_a_held_input_has_no_half_sample_of_holding():
    # a lag of 4 ms sampled every millisecond lags a line between the samples by half a sample more
    found = LinearPart(lag=4.5e-3)
    held = found.held(1e-3)
    assert held.lag == pytest.approx(4e-3, rel=0.01) and held.delay == pytest.approx(0.0, abs=2e-5)
    assert held.hold == 1e-3 and held.held(1e-3) is held
    # the block of the nodes is the same, bit for bit
    assert held.dynamics(1e-3) == found.dynamics(1e-3)
    # and so is what is removed from a recording
    y = np.sin(0.05 * np.arange(300))
    np.testing.assert_allclose(undo(y, held, 1e-3)[20:-20], undo(y, found, 1e-3)[20:-20], atol=0.01)


@dataclass(frozen=True)
class Fit:
    """As much of a fit as the search of dynamics looks at."""

    rmse: float
    dynamics: object = None
    synchronous: bool = False
    linear_part: LinearPart = LinearPart(lag=2e-3)
    structure: object = None
    deviations: dict = field(default_factory=dict)

    def simulate(self, voltage):
        return voltage


def search(voltage, displacement, answer) -> TurnSearch:
    """Search whose fits are ``answer(linear)``."""
    parts = ("lag", "delay", "creep", "modes")
    return TurnSearch(lambda *_, linear, **__: answer(linear), voltage, displacement, 1.0 / RATE, parts, None)


@pytest.mark.slow
def test_dynamics_before_a_hysteresis_have_no_lag_in_place_of_its_loops():
    plant = ForeignPlant(RATE, hysteresis=0.3, modes=((180.0, 0.02, 1.0),), noise=5e-9)
    voltage, asked = loops_then_chirp(2.0), []

    def answer(linear):
        asked.append(linear)
        if isinstance(linear, Known):
            raise IdentificationError("not fitted here")
        return Fit(1e-9, synchronous=True)

    search(voltage, plant.record(voltage), answer).run()
    (known,) = [linear.part for linear in asked if isinstance(linear, Known)]
    assert known.lag < 1e-3 and [mode.frequency for mode in known.modes] == pytest.approx([180.0], rel=0.01)


@pytest.mark.slow
def test_without_modes_a_lag_of_a_fast_recording_is_fitted_together_with_the_hysteresis(monkeypatch):
    monkeypatch.setattr(dynamics, "FAST_SAMPLES", 0)
    voltage, asked = loops_then_chirp(0.0), []

    def answer(linear):
        asked.append(linear)
        return Fit(1e-9)

    plant = ForeignPlant(RATE, hysteresis=0.3, noise=2e-9)
    search(voltage, plant.record(voltage), answer).run()
    assert asked == [("lag", "delay", "creep"), Known(LinearPart(lag=2e-3), asked[1].parts)]


#: A chosen mode, and the deviation of its frequency.
RINGING = LinearStage(
    LinearParameters(),
    1.0,
    0.0,
    4,
    {"mode_1_hz": 180.0},
    LinearPart(modes=(Mode(180.0, 0.02),), hold=1e-3),
    deviations={"mode_1_hz": 0.5},
)


def test_of_two_turns_the_better_one_is_kept(monkeypatch):
    monkeypatch.setattr(TurnSearch, "choose", lambda *_: RINGING)
    for sizes in ((1e-9, 3e-9), (3e-9, 1e-9)):
        fits = iter([Fit(size) for size in sizes])
        voltage = loops_then_chirp(3.0)
        (kept,) = search(voltage, 1e-7 * voltage, lambda _, fits=fits: next(fits)).settled(Fit(5e-9))
        assert kept.rmse == 1e-9 and kept.deviations == {"mode_1_hz": 0.5}


def test_the_changes_of_lag_and_delay_are_part_of_their_own_deviations():
    sizes, then = {"lag": 3e-6, "delay": 5e-6}, {"lag_s": 1.004e-3}
    stage = replace(RINGING, numbers={"lag_s": 1e-3, "delay_s": 2e-3}, deviations=sizes)
    before = replace(RINGING, numbers=then | {"delay_s": 1.988e-3})
    assert _less_certain(stage, before) == pytest.approx({"lag": 5e-6, "delay": 13e-6})
    # nothing is known of a delay that the stage before did not have, nor of a stage before the first one
    assert _less_certain(stage, replace(RINGING, numbers=then)) == pytest.approx({"lag": 5e-6, "delay": 5e-6})
    assert _less_certain(stage, None) == pytest.approx(sizes)


def test_the_change_of_a_mode_from_turn_to_turn_is_part_of_its_deviation(monkeypatch):
    turns = iter([RINGING, replace(RINGING, numbers={"mode_1_hz": 181.2})])
    monkeypatch.setattr(TurnSearch, "choose", lambda *_: next(turns))
    fits, voltage = iter([Fit(3e-9), Fit(1e-9)]), loops_then_chirp(3.0)
    (kept,) = search(voltage, 1e-7 * voltage, lambda _: next(fits)).settled(Fit(5e-9))
    assert kept.deviations == pytest.approx({"mode_1_hz": 1.3})  # 0.5 Hz and 1.2 Hz


def test_both_ways_to_the_dynamics_choose_the_structure_of_the_hysteresis_once(monkeypatch):
    """The structure that is chosen behind the modes of the first way is fitted behind those of the second one."""
    monkeypatch.setattr(TurnSearch, "choose", lambda *_, **__: RINGING)
    asked, voltage = [], loops_then_chirp(3.0)

    def fit(*_, linear=(), like=None):
        asked.append(like)
        return Fit(1e-9, structure=like or f"structure {len(asked)}")

    TurnSearch(fit, voltage, 1e-7 * voltage, 1.0 / RATE, ("lag", "creep", "modes"), None).run()
    # together, behind the first modes (chosen, then kept), behind those of the voltage, and behind modes again
    assert asked == [None, None, "structure 2", "structure 1", "structure 2", "structure 2"]


def test_creep_is_searched_again_behind_modes(monkeypatch):
    monkeypatch.setattr(TurnSearch, "choose", lambda *_, **__: RINGING)
    asked = []

    def answer(linear):
        asked.append(linear)
        return Fit(1e-9, linear_part=LinearPart(lag=2e-3, creep_rate=0.05, longest_time=8.0))

    voltage = loops_then_chirp(3.0)
    search(voltage, 1e-7 * voltage, answer).run()
    behind = [linear for linear in asked if isinstance(linear, Known)]
    assert len(behind) == 5 and all(linear.parts == ("creep",) for linear in behind)
    assert all(linear.part.creep_rate == 0.05 for linear in (*behind[:2], *behind[3:]))


def test_the_density_keeps_its_default_where_another_one_is_a_few_percent_better():
    voltage = loops_then_chirp(0.0)
    data = condense(voltage, 1e-7 * voltage, 1.0 / RATE, enough=1500)
    model = SmoothDensity(data, 10).behind(LinearPart(), 0.8)
    noise = 1.3e-7 * np.random.default_rng(0).standard_normal(len(data.voltage))
    model.shape, model.scale = dict(elastic_share=0.6, map_slope=0.0, map_curvature=0.0), 1e-5
    clean = model.scale * model.moved(model.shape)
    for size, kept in ((1.0, True), (0.1, False)):
        fit = SmoothDensity(replace(data, displacement=clean + size * noise), 10).fit((), None)
        free = PartSearch(fit.solve, fit.data, (*DENSITY_SHAPE, ("decay", PRIOR_DECAY, *DECAY_RANGE)), None)
        held = SmoothDensity(fit.data, 10).behind(LinearPart(), PRIOR_DECAY).rms
        ratio = free.run([], {}, LinearPart()).spread / held
        assert (ratio < 0.9) != kept and ratio < 0.97
        assert (fit.numbers["density_decay"] == PRIOR_DECAY) == kept
