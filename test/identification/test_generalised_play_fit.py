# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plays from recordings: thresholds that grow with the rate, and envelopes, are found only where they exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification import separation, workflow
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.generalised_play import fit_generalised_play, speeds_differ
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.plant_model import Request
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preprocessing import condense
from hysteresis_ros.identification.workflow import identify
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.models.hysteresis.generalised_play import GeneralisedPlayHysteresis, GeneralisedPlayParameters

T = 2e-3
#: Decreasing density, plays up to half the range; thresholds widen by 6 V at the highest speed of 10 Hz.
RADII = 4.0 * np.arange(1, 13)
PLAIN = GeneralisedPlayParameters(
    radii=tuple(RADII), weights=tuple(6e-9 * np.exp(-RADII / 30.0)), slope=80e-9, memory=8e-3
)
RATED = replace(PLAIN, rate=2e-3)
ENVELOPES = replace(PLAIN, rising_bend=0.3, falling_bend=-0.2)


def drive(frequency: float, cycles: float) -> np.ndarray:
    """Decaying loops, beginning at 0 V."""
    phase = 2.0 * np.pi * np.arange(int(cycles / (frequency * T))) * frequency * T
    return 50.0 * np.exp(-0.1 * phase / (2.0 * np.pi)) * (1.0 - np.cos(phase))


#: Slow, fast, and slow again.
VOLTAGE = np.concatenate([drive(1.0, 3.0), drive(8.0, 16.0), drive(3.0, 6.0)])
HELD_OUT = drive(5.0, 10.0)


def recorded(truth, voltage=VOLTAGE, noise: float = 3e-9):
    y = GeneralisedPlayHysteresis(truth, T).simulate(voltage)
    return y + noise * np.random.default_rng(1).standard_normal(y.size)


def error(fit, truth) -> float:
    return float(np.std(fit.simulate(HELD_OUT) - recorded(truth, HELD_OUT, 0.0)))


def test_thresholds_that_grow_with_the_rate_are_found_and_predict_another_speed():
    fit = fit_generalised_play(VOLTAGE, recorded(RATED), T, linear=())
    plain = fit_prandtl_ishlinskii(VOLTAGE, recorded(RATED), T, linear=())
    assert fit.hysteresis.chosen.rate == pytest.approx(RATED.rate, rel=0.15)
    assert error(fit, RATED) < 0.2 * error(plain, RATED)
    assert fit.numbers["held_out_rmse_m"] < 7e-9


@pytest.mark.slow
def test_envelopes_are_found_where_they_are():
    fit = fit_generalised_play(VOLTAGE, recorded(ENVELOPES), T, linear=())
    found = fit.hysteresis.chosen
    assert found.rising_bend - found.falling_bend == pytest.approx(0.5, abs=0.1)
    assert error(fit, ENVELOPES) < 0.3 * error(
        fit_prandtl_ishlinskii(VOLTAGE, recorded(ENVELOPES), T, linear=()), PLAIN
    )


def test_plain_plays_stay_plain():
    found = fit_generalised_play(VOLTAGE, recorded(PLAIN, noise=2e-8), T, linear=()).hysteresis.chosen
    assert found.rate == 0.0 and found.rising_bend == found.falling_bend == 0.0


def test_a_lag_is_told_from_thresholds_that_grow():
    late = LinearPart(lag=6e-3).apply(recorded(RATED, noise=0.0), T)
    fit = fit_generalised_play(VOLTAGE, late, T, freedom="rate", linear=("lag",))
    assert fit.linear_part.lag == pytest.approx(6e-3, rel=0.15)
    assert fit.hysteresis.chosen.rate == pytest.approx(RATED.rate, rel=0.4)


def test_an_unknown_freedom_is_refused():
    with pytest.raises(IdentificationError, match="must be one of auto, none, rate"):
        fit_generalised_play(VOLTAGE, recorded(PLAIN), T, freedom="all")


def usual(truth, noise=3e-9, **request):
    data = IdentificationData(np.arange(VOLTAGE.size) * T, VOLTAGE, recorded(truth, noise=noise))
    return identify(data, linear="none", initial="zero", **request)


@pytest.mark.slow
def test_the_usual_model_is_the_one_that_predicts_blocks_held_out():
    """Rate-dependent thresholds are found if speeds differ, plain plays stay plain; options extend the first model."""
    found = usual(RATED)
    assert found.figures["model"] == found.plant.hysteresis.type == "generalised_play"
    assert found.parameters.rate == pytest.approx(RATED.rate, rel=0.15)
    assert "type: generalised_play" in found.text and found.plant.inverse.type == "exact"
    assert usual(PLAIN, 2e-8).figures["model"] == "prandtl_ishlinskii"
    assert usual(RATED, options={"density": "exponential"}).figures["model"] == "prandtl_ishlinskii"


def test_speeds_differ_where_equal_swings_take_different_times():
    slow, fast = (50.0 * (1.0 - np.cos(2.0 * np.pi * rate * np.arange(2000) * T)) for rate in (0.5, 2.0))
    for voltage, differ in ((slow, False), (fast, False), (np.concatenate([slow, fast]), True)):
        assert speeds_differ(condense(voltage, 1e-7 * voltage, T)) is differ


def test_lag_and_creep_are_separated_once_for_all_models_that_have_none(monkeypatch):
    kept, searched = [], []
    monkeypatch.setattr(separation, "_separated", lambda data, request: searched.append(request.parts) or object())

    def identified(data, name, **request):
        kept.append(request["separations"])
        asked = Request(name, ("lag",), None, {}, "exact", None, "zoh", None, print, kept[-1])
        assert separation.separated(data, asked) is separation.separated(data, asked)
        raise IdentificationError("not fitted")

    monkeypatch.setattr(workflow.registry, "identify", identified)
    data = IdentificationData(np.arange(VOLTAGE.size) * T, VOLTAGE, recorded(PLAIN))
    with pytest.raises(IdentificationError, match="no model can be fitted"):
        workflow.choose_model(data, "none")
    # all models fail on the first block, so that none is fitted to the second
    assert len(kept) > 3 and all(found is kept[0] for found in kept) and searched == [("lag",)]


@pytest.mark.parametrize("other, chosen", [(0.99, "preisach"), (0.9, "generalised_play")])
def test_auto_takes_it_only_where_it_predicts_clearly_better(monkeypatch, other, chosen):
    sizes = {"preisach": 1e-7, "generalised_play": other * 1e-7}
    errors = {name: (np.full(100, size**2), 0.0) for name, size in sizes.items()}
    monkeypatch.setattr(workflow, "MODELS", {name: MODELS[name] for name in errors})
    monkeypatch.setattr(workflow, "held_out_squares", lambda _, name, *__, **request: errors[name])
    data = IdentificationData(np.arange(VOLTAGE.size) * T, VOLTAGE, recorded(PLAIN))
    assert workflow.choose_model(data, None)[0] == chosen
