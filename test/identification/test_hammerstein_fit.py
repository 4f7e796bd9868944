# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hysteresis, creep, lag and delay are distinguished in synthetic recordings with a known truth."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.dynamics import TURNS, TurnSearch
from hysteresis_ros.identification.generalised_play import GeneralisedPlays
from hysteresis_ros.identification.hammerstein import finished
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.plant_model import simulate_chain
from hysteresis_ros.identification.play_fit import cholesky_factor, radii, smooth_weights
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.prediction import recover_voltage
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.identification.preprocessing import condense
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.play_operators import plays

SAMPLE_TIME = 0.005
RADII = (0.0, 10.0, 20.0, 30.0, 40.0)
WEIGHTS = (60e-9, 8e-9, 8e-9, 8e-9, 8e-9)


def stack(thresholds=(), zone_weights=()):
    parameters = PrandtlIshlinskiiParameters(RADII, WEIGHTS, thresholds, zone_weights)
    return HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters)


def sine(cycles, amplitude=50.0, sample_time=SAMPLE_TIME):
    time = np.arange(round(cycles / sample_time)) * sample_time
    return amplitude * (1.0 - np.cos(2.0 * np.pi * time))


def decaying(sample_time=SAMPLE_TIME):
    time = np.arange(round(8.0 / sample_time)) * sample_time
    return 50.0 - 50.0 * np.exp(-0.3 * time) * np.cos(2.0 * np.pi * time)


def record(hysteresis, linear_part, voltage, noise=0.0, sample_time=SAMPLE_TIME):
    dynamics = linear_part.dynamics(sample_time)
    y = simulate_chain(hysteresis, linear_part.creep, dynamics, voltage, sample_time)
    return y + noise * np.random.default_rng(1).standard_normal(y.size)


def test_play_columns_equal_the_kernel_of_the_nodes():
    voltage = np.random.default_rng(0).normal(0.0, 30.0, 400)
    block = PrandtlIshlinskiiHysteresis(PrandtlIshlinskiiParameters(RADII, WEIGHTS), SAMPLE_TIME)
    np.testing.assert_allclose(
        plays(voltage, np.array(RADII)) @ np.array(WEIGHTS), block.simulate(voltage), rtol=0.0, atol=1e-18
    )


def test_the_kept_response_to_creep_is_that_of_the_filters():
    data = condense(decaying() + 20.0, 1e-7 * decaying(), SAMPLE_TIME, skip=0)
    fit = GeneralisedPlays(data, 6, ("bend", "spread"))
    lagging = LinearPart(lag=0.01, delay=0.002, longest_time=8.0)
    parts = [replace(lagging, creep_rate=rate) for rate in (0.0, 0.01, 0.04)]
    parts += [replace(parts[-1], settled=True), parts[-1], replace(parts[-1], longest_time=80.0), parts[1]]
    for part in parts:
        for bend in (0.0, 0.2, 0.0):
            shape = {"bend": bend, "spread": 0.1}
            expected = part.apply(fit.columns(shape), SAMPLE_TIME)
            np.testing.assert_allclose(fit.moved(part, shape), expected, rtol=0.0, atol=1e-9)


def test_columns_that_are_equal_up_to_rounding_have_a_factor():
    gram = np.ones((3, 3)) - 3e-12 * np.eye(3)  # no longer positive
    factor = cholesky_factor(gram)
    np.testing.assert_allclose(factor @ factor.T, gram, rtol=0.0, atol=2e-10)


def test_weights_come_back_and_are_never_negative():
    voltage = np.concatenate([sine(2), -sine(1), decaying()])
    table = plays(voltage, radii(100.0, 5))
    weights = np.array([5.0, 1.0, 0.8, 0.6, 0.4])
    found, offset, residual, _ = smooth_weights(
        table, np.ones((len(table), 1)), table @ weights - 3.0, np.diff(np.eye(5), 2, axis=0)[1:]
    )
    np.testing.assert_allclose(found, weights, rtol=1e-3)
    np.testing.assert_allclose(offset, -3.0, rtol=1e-3)
    assert np.max(np.abs(residual)) < 1e-2
    pushed, *_ = smooth_weights(
        table, np.ones((len(table), 1)), table @ (weights - 2.0), np.diff(np.eye(5), 2, axis=0)[1:]
    )
    assert np.all(pushed >= 0.0)


@pytest.mark.parametrize("delay", [0.0, 0.002, 0.005, 0.0125])
def test_discrete_lag_and_delay_keep_unit_gain_and_total_delay(delay):
    part = LinearPart(lag=0.02, delay=delay)
    model = part.dynamics(SAMPLE_TIME).state_space
    assert model.dc_gain == pytest.approx(1.0, abs=1e-12)
    # the centroid of the impulse response is the sum of lag and delay; the output is read one sample after the input
    x, response = model.B[:, 0], []
    for _ in range(400):
        response.append(model.C[0] @ x)
        x = model.A @ x
    centroid = np.sum(np.arange(1, 401) * response) * SAMPLE_TIME
    assert centroid == pytest.approx(part.lag + part.delay, abs=1e-9)


def test_lag_and_creep_are_told_from_hysteresis():
    truth = LinearPart(lag=0.02, creep_rate=0.015, longest_time=20.0)
    voltage = sine(20)
    y = record(stack(), truth, voltage, noise=2e-9)
    fit = fit_prandtl_ishlinskii(voltage, y, SAMPLE_TIME, zone_count=0, play_count=10)
    assert fit.linear_part.lag + fit.linear_part.delay == pytest.approx(truth.lag, abs=1.5e-3)
    assert fit.linear_part.creep_rate == pytest.approx(truth.creep_rate, rel=0.1)
    assert fit.rmse < 1e-3 * fit.stroke
    # the relevant test: amplitudes that were not recorded
    other = decaying()
    error = fit.simulate(other) - record(stack(), truth, other)
    assert np.std(error[200:]) < 4e-3 * fit.stroke


def test_a_constant_error_goes_into_the_offset_of_the_hysteresis():
    """The creep that has settled multiplies the offset by its gain at rest, here 1.4."""
    part = LinearPart(creep_rate=0.1, longest_time=20.0, settled=True)
    assert part.settled_gain == pytest.approx(1.4, abs=0.1)
    voltage, found = sine(2), {"settled": True, "synchronous": True}
    y = simulate_chain(stack(), part.creep, part.dynamics(SAMPLE_TIME), voltage, SAMPLE_TIME, **found)
    data = SimpleNamespace(
        voltage=voltage, sample_time=SAMPLE_TIME, skipped=0, drifts=False, history=(), stroke=float(np.ptp(y))
    )
    words = {"deviations": {}, "warnings": (), "converged": True, "numbers": {}, "constants": np.zeros(2)}
    fit = SimpleNamespace(data=data, part=part, parameters=stack, **words)
    fit = finished(fit, voltage, y + 3e-6, SAMPLE_TIME)
    np.testing.assert_allclose(fit.simulate(voltage), y + 3e-6, rtol=0.0, atol=1e-15)


@dataclass
class Late:
    """A fit whose dynamics are later than the hysteresis, by a lag, a delay and a mode."""

    linear_part: LinearPart
    dynamics: Any = None
    synchronous: bool = False
    structure: Any = None
    rmse: float = 1.0
    deviations: dict = field(default_factory=dict)

    def simulate(self, voltage):
        return voltage


def test_spectra_are_compared_where_the_movement_is_and_not_where_the_voltage_was(monkeypatch):
    """A delay of 38 ms, half of a lag of 12 ms and half of 2 ζ/ω = 9.5 ms of a mode: 10 samples of 5 ms."""
    part = LinearPart(lag=12e-3, delay=38e-3, modes=(Mode(10.0, 0.3, 0.5),), hold=SAMPLE_TIME)
    late = []
    stage = SimpleNamespace(part=part, numbers={}, deviations={})
    search = TurnSearch(lambda *data, **options: Late(part), sine(2), sine(2), SAMPLE_TIME, ("lag", "modes"), None)
    monkeypatch.setattr(search, "choose", lambda moved, samples: late.append(samples) or stage)
    assert search.settled(Late(part)) and late == [10] * TURNS


def test_a_quasi_static_sweep_gets_no_dynamics():
    points = [0.0, 100.0, 0.0, 100.0, 30.0, 70.0, 0.0]
    voltage = np.concatenate([np.linspace(a, b, 150) for a, b in zip(points, points[1:], strict=False)])
    y = PrandtlIshlinskiiHysteresis(stack().prandtl_ishlinskii, 1.0).simulate(voltage)
    y = y + 1e-9 * np.random.default_rng(0).standard_normal(y.size)
    fit = fit_preisach(voltage, y, 1.0)
    assert fit.synchronous and fit.dynamics.order == 0 and fit.creep.type == "none"
    assert fit.rmse < 2e-3 * fit.stroke


@pytest.mark.slow
@pytest.mark.parametrize("fitter", [fit_prandtl_ishlinskii, fit_preisach])
def test_units_and_offset_do_not_matter(fitter):
    voltage = sine(4)
    y = record(stack(), LinearPart(lag=0.02), voltage, noise=5e-9)
    options = dict(linear=("lag",))
    one = fitter(voltage, y, SAMPLE_TIME, **options)
    other = fitter(voltage, 1000.0 * y + 3e-3, SAMPLE_TIME, **options)
    assert other.linear_part.lag == pytest.approx(one.linear_part.lag, rel=1e-3)
    np.testing.assert_allclose(other.simulate(voltage), 1000.0 * one.simulate(voltage) + 3e-3, atol=2e-6)


def test_dead_zones_are_found_where_they_are_needed():
    bent = stack((2e-6, 4e-6, 6e-6), (-0.1, -0.1, -0.1))
    voltage = sine(4)
    y = record(bent, LinearPart(), voltage, noise=2e-9)
    plain = fit_prandtl_ishlinskii(voltage, y, SAMPLE_TIME, linear=("lag",), zone_count=0)
    modified = fit_prandtl_ishlinskii(voltage, y, SAMPLE_TIME, linear=("lag",))
    assert modified.hysteresis.prandtl_ishlinskii.thresholds
    assert modified.rmse < 0.35 * plain.rmse


def test_a_fine_long_recording_is_condensed():
    time = np.arange(60000) / 5000.0
    data = condense(150.0 * np.sin(2.0 * np.pi * time), np.sin(2.0 * np.pi * time), 1.0 / 5000.0)
    assert data.factor == 10 and len(data.voltage) == 6000
    assert data.sample_time == pytest.approx(0.002)


def test_the_voltage_comes_back_from_the_displacement():
    truth = LinearPart(lag=0.02, creep_rate=0.01, longest_time=10.0)
    voltage = sine(6)
    y = record(stack(), truth, voltage)
    fit = fit_prandtl_ishlinskii(voltage, y, SAMPLE_TIME, zone_count=0, play_count=10)
    other = decaying()
    back = recover_voltage(fit, record(stack(), truth, other), other, skip=200)
    assert back.rmse_percent < 0.5


@pytest.mark.parametrize(
    "voltage, displacement, words",
    [
        (np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, 200), "never reverses"),
        (np.zeros(200), np.linspace(0.0, 1.0, 200), "constant"),
        (sine(1), np.where(np.arange(200) == 50, np.nan, sine(1)), "NaN"),
        (sine(1), sine(2), "both must have the same number of samples"),
        (sine(1)[:20], sine(1)[:20], "N ≥ 50"),
    ],
)
def test_bad_data_is_refused_with_the_reason(voltage, displacement, words):
    with pytest.raises(IdentificationError, match=words):
        fit_prandtl_ishlinskii(voltage, displacement, SAMPLE_TIME)


def test_an_unknown_linear_part_is_refused():
    with pytest.raises(IdentificationError, match="lag, delay and creep"):
        fit_preisach(sine(2), sine(2), SAMPLE_TIME, linear=("resonance",))
