# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants around a model, and gains that meet the requirements on each of them."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.margins import judge
from hysteresis_ros.control.uncertainty import (
    ALIASED,
    CORNERS,
    PossiblePlant,
    Uncertainty,
    aliased_plants,
    drawn_plants,
    judge_worst,
    possible_plant,
)
from hysteresis_ros.designs.gains import design_gains, design_robust, robustness
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearParameters, StateSpace, zero_order_hold

T = 1e-3
#: A mode at 40 Hz with 20 % damping, of unit gain.
ANGULAR = 2.0 * np.pi * 40.0
MATRICES = zero_order_hold([[0.0, 1.0], [-(ANGULAR**2), -0.4 * ANGULAR]], [[0.0], [ANGULAR**2]], T)
MODE = LinearParameters(
    A=tuple(MATRICES[0].ravel()),
    B=tuple(MATRICES[1][:, 0]),
    C=(1.0, 0.0),
    input_scale=1e-6,
    output_scale=1e-6,
    sample_time=T,
)
LAG = LinearParameters(A=(0.72,), B=(0.28,), C=(1.0,), output_scale=1e-6, sample_time=0.005)


def parameters(dynamics: LinearParameters) -> ControllerParameters:
    values = {f"model.dynamics.{name}": value for name, value in dynamics.to_mapping().items()}
    return ControllerParameters.from_mapping({name: value for name, value in values.items() if value != ()})


def test_a_plant_differs_by_what_it_says():
    model = drawn_plants(MODE, T, Uncertainty(draws=0))[0].plant
    other = possible_plant(MODE, T, gain=1.2, slowness=1.1, late=2.0).plant
    assert model.dc_gain == pytest.approx(1.0) and other.dc_gain == pytest.approx(1.2)
    z = np.exp(2j * np.pi * np.array([5.0, 40.0 / 1.1, 60.0]) * T)
    slow = possible_plant(MODE, T, slowness=1.1).plant.response(z)[:, 0, 0]
    assert other.response(z)[:, 0, 0] == pytest.approx(1.2 * slow / z**2)

    def highest(plant):
        angles = np.linspace(0.05, 0.5, 4000)
        return angles[np.argmax(np.abs(plant.response(np.exp(1j * angles))[:, 0, 0]))]

    assert highest(model) / highest(other) == pytest.approx(1.1, rel=2e-3)


def test_corners_are_at_the_ends_and_draws_within_and_equal_for_equal_seeds():
    ranges = Uncertainty(gain=0.05, hysteresis=0.2, resonance=0.1, delay=1.5, draws=40, seed=4)
    plants = drawn_plants(MODE, T, ranges)
    assert len(plants) == 1 + CORNERS + 40
    gains = [one.plant.dc_gain for one in plants]
    assert sorted(set(np.round(gains[1 : 1 + CORNERS], 9))) == [0.76, 1.26]
    assert sorted({one.late for one in plants[1 : 1 + CORNERS]}) == [0.0, 1.5]
    turns = [np.max(np.angle(one.plant.poles.astype(complex))) for one in plants[: 1 + CORNERS]]
    assert sorted(set(np.round(turns[1:] / turns[0], 6))) == pytest.approx([1.0 / 1.1, 1.0 / 0.9], rel=1e-3)
    drawn = plants[1 + CORNERS :]
    assert all(0.76 <= round(gain, 9) <= 1.26 for gain in gains) and np.ptp(gains[1 + CORNERS :]) > 0.2
    assert all(0.0 <= one.late <= 1.5 for one in drawn) and np.ptp([one.late for one in drawn]) > 1.0
    again, others = drawn_plants(MODE, T, ranges), drawn_plants(MODE, T, Uncertainty(seed=5))
    assert [one.description for one in again] == [one.description for one in plants]
    assert all(np.array_equal(one.plant.A, other.plant.A) for one, other in zip(plants, again, strict=True))
    assert others[-1].description not in {one.description for one in plants}


def test_a_mode_that_may_be_an_alias_moves_as_the_true_one():
    """A mode at 670 Hz, sampled at 1 kHz, is found at 330 Hz; where it moves by 5 %, that one moves by 10 %."""

    def mode(frequency):
        angular = 2.0 * np.pi * frequency
        A, B = zero_order_hold([[0.0, 1.0], [-(angular**2), -0.04 * angular]], [[0.0], [angular**2]], T)
        return LinearParameters(A=tuple(A.ravel()), B=tuple(B[:, 0]), C=(1.0, 0.0), input_scale=1.0, sample_time=T)

    def poles(A):
        found = np.linalg.eigvals(np.reshape(A, (-1, int(np.sqrt(np.size(A))))))
        return np.sort_complex(found[np.abs(found) > 1e-9])  # one of the plant is its sample of delay

    given = Uncertainty(resonance=0.05)
    plants = aliased_plants(mode(670.0), T, given)
    assert len(plants) == ALIASED and all(one.plant.dc_gain == pytest.approx(1.0) for one in plants)
    for one, slowness in zip(plants, np.linspace(0.95, 1.05, ALIASED), strict=True):
        np.testing.assert_allclose(poles(one.plant.A), poles(mode(670.0 / slowness).A), rtol=1e-9)
    assert aliased_plants(mode(240.0), T, given) == () == aliased_plants(LAG, 0.005, given)


@pytest.mark.parametrize(
    "changes", [{"gain": 0.6}, {"hysteresis": -0.1}, {"resonance": 0.51}, {"delay": 17.0}, {"draws": -1}, {"seed": -1}]
)
def test_ranges_out_of_bounds_are_refused_by_name(changes):
    with pytest.raises(ParameterError, match="must be within 0 … ") as caught:
        Uncertainty(**changes)
    assert [problem.name for problem in caught.value.problems] == list(changes)


def test_the_worst_of_plants_counts_and_delay_only_once():
    integral = StateSpace(np.eye(1), np.array([[1.0, -1.0]]), np.array([[0.3]]), np.array([[0.3, -0.3]]))
    plants = [possible_plant(LinearParameters(sample_time=T), T, gain, 1.0, late) for gain, late in ((1, 0), (1.4, 1))]
    alone = [judge(integral, one.plant, T) for one in plants]
    worst = judge_worst(integral, plants, T)
    assert worst.sensitivity_peak == max(one.sensitivity_peak for one in alone) == alone[1].sensitivity_peak
    for name in ("late_sensitivity_peak", "noise_gain", "command_noise_gain"):
        assert (
            getattr(worst, name) == max(getattr(one, name) for one in alone) > min(getattr(one, name) for one in alone)
        )
    assert worst.bandwidth == alone[0].bandwidth
    assert worst.delay_margin == pytest.approx(min(alone[0].delay_margin, alone[1].delay_margin + 1.0))
    unstable = PossiblePlant(plants[0].plant.scaled(9.0))
    assert judge_worst(integral, [*plants, unstable], T).sensitivity_peak == np.inf


def test_plants_that_are_only_later_have_the_delay_margin_of_the_model():
    """A delay of the plant is already used when it is measured: the margin counts from the delay of the model."""
    found = design_gains(parameters(LAG), "pid", 0.005).parameters
    later = robustness(found, 0.005, Uncertainty(gain=0.0, hysteresis=0.0, resonance=0.0, delay=1.0, draws=0))
    assert {one.late for one in later.plants} == {0.0, 1.0}
    margins = [one.delay_margin_samples for one in later.margins]
    np.testing.assert_allclose(margins, margins[0], rtol=1e-6)


@pytest.mark.parametrize("gain", [0.02, 0.04])
def test_a_search_knows_the_peak_of_a_loop_with_one_more_sample_of_delay(gain):
    integral = StateSpace(np.eye(1), np.array([[1.0, -1.0]]), np.array([[gain]]), np.array([[gain, -gain]]))
    prompt, late = (possible_plant(MODE, T, late=delay).plant for delay in (0.0, 1.0))
    found = judge(integral, prompt, T)
    assert found.late_sensitivity_peak == pytest.approx(judge(integral, late, T).sensitivity_peak, rel=1e-2)
    assert found.late_sensitivity_peak > 1.01 * found.sensitivity_peak


@pytest.mark.parametrize("slowness", [0.7, 1.4])
def test_where_all_times_are_longer_the_delay_is_too(slowness):
    """The response of the slower plant at f/slowness has the phase of the model at f; the sample of holding is kept."""
    lag = LinearParameters(A=(np.exp(-0.05),), B=(1.0 - np.exp(-0.05),), C=(1.0,), sample_time=T, delay=6.0 * T)
    prompt = LinearParameters(A=lag.A, B=lag.B, C=lag.C, sample_time=T)
    z = np.exp(2j * np.pi * np.array([4.0, 9.0, 30.0]) * T)
    late, plain = (possible_plant(one, T, slowness=slowness).plant.response(z)[:, 0, 0] for one in (lag, prompt))
    np.testing.assert_allclose(np.angle(late / plain * z ** (6.0 * slowness)), 0.0, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["pid", "offset_free"])
def test_robust_gains_meet_on_every_plant_what_others_miss_on_some(controller):
    ranges = Uncertainty(gain=0.1, hysteresis=0.2, draws=2)
    usual = design_gains(parameters(LAG), controller, 0.005)
    missed = robustness(usual.parameters, 0.005, ranges).misses()
    assert usual.margins.meets and len(missed) == 1 and "on a plant with gain +32 %" in missed[0]
    found, worth = design_robust(parameters(LAG), controller, 0.005, ranges)
    assert worth.misses() == () and all(margins.meets for margins in worth.margins)
    # no farther from the limit than one step of the search
    assert 1.6 < worth.margins[worth.worst].sensitivity_peak < 2.003
    assert found.margins.sensitivity_peak < usual.margins.sensitivity_peak
    if controller == "pid":
        assert design_robust(parameters(LAG), controller, 0.005, ranges)[0].parameters == found.parameters


@pytest.mark.slow
def test_a_resonance_that_may_be_elsewhere_costs_bandwidth():
    certain = Uncertainty(gain=0.0, hysteresis=0.0, resonance=0.0, delay=0.0, draws=0)
    moving = Uncertainty(gain=0.0, hysteresis=0.0, resonance=0.3, delay=0.0, draws=4)
    sure, _ = design_robust(parameters(MODE), "pid", T, certain)
    wary, worth = design_robust(parameters(MODE), "pid", T, moving)
    assert wary.parameters.pid.Ki < 0.9 * sure.parameters.pid.Ki
    assert "times" in worth.plants[worth.worst].description and worth.misses() == ()
    assert "times" in robustness(sure.parameters, T, moving).misses()[0]
