# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Duhem identification (W2-W5, W7): loops, lags, shape functions, α, inverse and the Hammerstein model."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.duhem import (
    LoopOperator,
    identify_duhem,
    identify_duhem_hammerstein,
    identify_inverse_duhem,
    major_loop,
    prepare_loops,
    reversal_delay,
)
from hysteresis_ros.laboratory.papers.wang2014.identification import paper_w, polymer_truth
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

CYCLE = np.sin(2.0 * np.pi * np.arange(600) / 600.0)
MAJOR = np.tile(CYCLE, 3)


def truth(voltage):
    return PrandtlIshlinskiiHysteresis(polymer_truth(20), 1e-3).simulate(voltage)


def decaying():
    voltage = np.concatenate([CYCLE, np.tile(CYCLE, 5) * np.linspace(1.0, 0.05, 3000)])
    return voltage, truth(voltage)


def test_operator_is_the_duhem_equation():
    """Compared with the closed form for f = v, g = b: rising w = v - (1 - b)/α + C exp(-α v), falling mirrored."""
    grid, b = np.linspace(-1.0, 1.0, 81), 0.7
    for alpha in (0.5, 3.0, 80.0):
        operator = LoopOperator(grid, alpha, -1.0)
        w = operator.output(operator.nodes, np.full(operator.nodes.size, b))
        lag = (1.0 - b) / alpha
        up = grid - lag + lag * np.exp(-alpha * (grid + 1.0))
        down = grid[::-1] + lag + (up[-1] - 1.0 - lag) * np.exp(-alpha * (1.0 - grid[::-1]))
        np.testing.assert_allclose(w, np.concatenate([up, down]), rtol=0.0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["network", "spline"])
def test_paper_w(shape):
    """Major loop to 1e-4 of full range, also after the inverse; α from one decaying loop is 5 times better than 80."""
    found = paper_w(shape, size=None if shape == "spline" else 12)
    assert 0.1 < found.opening < 0.2
    for result in (found.identified, found.inverse, found.published):
        assert result.rms < 1e-4
    assert found.compensated < 5e-4
    assert found.decaying_published > 5.0 * found.decaying
    assert found.identified.alpha_source == "minor loops" and 0.5 < found.identified.alpha < 10.0
    assert found.identified.converged and found.identified.warnings == ()
    assert any("wrong way" in warning or "monotone" in warning for warning in found.published.warnings)


def test_the_block_runs_the_loop_that_was_fitted():
    result = identify_duhem(MAJOR, truth(MAJOR), alpha=3.0, shape="spline")
    y = truth(MAJOR)
    error = DuhemHysteresis(result.parameters, 1e-3).simulate(MAJOR)[600:] - y[600:]
    assert np.sqrt(np.mean(error**2)) < 2e-4 * np.ptp(y)


@pytest.mark.slow
def test_training_is_repeatable():
    a, b = (identify_duhem(MAJOR, truth(MAJOR), alpha=3.0, size=4, seed=5).parameters for _ in range(2))
    assert a == b


@pytest.mark.slow
def test_units_do_not_matter():
    v = np.concatenate([MAJOR, decaying()[0]])
    y = truth(v)
    plain = identify_duhem(v, y, shape="spline")
    scaled = identify_duhem(60.0 * (v + 1.0), 1e-2 * y, shape="spline")
    assert scaled.alpha == pytest.approx(plain.alpha, rel=0.01)
    assert scaled.parameters.alpha == pytest.approx(plain.parameters.alpha / 60.0, rel=0.01)
    assert scaled.minor_rms == pytest.approx(plain.minor_rms, rel=1e-3)


def test_noise_does_not_spoil_the_loop():
    """σ = 0.2 % of the range; the branches follow the averaged noise, and networks do not follow single samples."""
    y = truth(MAJOR)
    noisy = y + 2e-3 * np.ptp(y) * np.random.default_rng(0).standard_normal(y.size)
    result = identify_duhem(MAJOR, noisy, alpha=3.0, shape="spline")
    error = DuhemHysteresis(result.parameters, 1e-3).simulate(MAJOR)[600:] - y[600:]
    assert np.sqrt(np.mean(error**2)) < 1e-3 * np.ptp(y)


def test_without_minor_loops_the_paper_s_alpha_is_used_and_told():
    result = identify_duhem(MAJOR, truth(MAJOR), shape="spline")
    assert result.alpha == 80.0 and result.alpha_source == "paper"
    assert "no minor loops" in result.warnings[0]
    assert np.isnan(result.minor_rms)


def test_inverse_takes_metres_and_gives_volt():
    v, y = decaying()
    result = identify_inverse_duhem(MAJOR, truth(MAJOR), minor=(v, y), shape="spline")
    p = result.parameters
    assert p.input_high - p.input_low == pytest.approx(np.ptp(truth(MAJOR)[600:]), rel=1e-3)
    assert p.output_high - p.output_low == pytest.approx(2.0, rel=1e-3)
    assert np.all(result.loop.rising[5:-5] > result.loop.falling[5:-5])


@pytest.mark.parametrize("lag", [0.0, 3.4, 12.0])
def test_lag_is_told_from_hysteresis(lag):
    """The reversals of a hysteretic output coincide with those of its input, for any phase of the first harmonic."""
    k = np.arange(2400)
    v = np.sin(2.0 * np.pi * k / 600.0)
    y = truth(np.sin(2.0 * np.pi * (k - lag) / 600.0))
    assert reversal_delay(v, y, 1e-3) == pytest.approx(1e-3 * lag, abs=0.4e-3)


def test_frequencies_coincide_after_preparation():
    """W2: shift by the lag, and normalise; different amplitudes must not be mixed."""
    recordings = []
    for period, gain, lag in ((600, 1.0, 2.0), (300, 0.8, 2.0)):
        k = np.arange(3 * period)
        y = gain * truth(np.sin(2.0 * np.pi * (k - lag) / period))
        recordings.append((np.sin(2.0 * np.pi * k / period), y))
    prepared = prepare_loops(recordings, 1e-3)
    assert prepared.gains[1] / prepared.gains[0] == pytest.approx(0.8, rel=1e-3)
    a, b = (major_loop([v], [y]) for v, y in zip(prepared.voltage, prepared.displacement, strict=True))
    common = np.linspace(-0.98, 0.98, 50)
    for side in ("rising", "falling"):
        difference = np.interp(common, a.grid, getattr(a, side)) - np.interp(common, b.grid, getattr(b, side))
        assert np.max(np.abs(difference)) < 0.02
    with pytest.raises(IdentificationError, match="voltage ranges.*amplitude"):
        prepare_loops([recordings[0], (0.5 * recordings[1][0], recordings[1][1])], 1e-3)


@pytest.mark.slow
def test_hammerstein_beats_the_linear_model():
    """W5: sines at three frequencies through the truth and a second-order part (assumption)."""
    part = LinearParameters(A=(1.72, -0.735, 1.0, 0.0), B=(1.0, 0.0), C=(0.01, 0.005))
    recordings = []
    for period in (2000, 1000, 500):
        v = np.sin(2.0 * np.pi * np.arange(3 * period) / period)
        recordings.append((v, LinearDynamics(part, 1e-3).simulate(truth(v))))
    minor = np.concatenate([CYCLE, np.tile(CYCLE, 5) * np.linspace(1.0, 0.05, 3000)])
    minor = np.repeat(minor, 3)
    found = identify_duhem_hammerstein(
        recordings,
        1e-3,
        minor=(minor, LinearDynamics(part, 1e-3).simulate(truth(minor))),
        shape="spline",
        minimum_phase=True,
    )
    assert all(rms < 0.5 * only for rms, only in zip(found.rms, found.linear_only_rms, strict=True))
    hysteresis, linear = found.parameters
    linear.validated()
    assert hysteresis.output_high / found.hysteresis.parameters.output_high == pytest.approx(found.linear.model.dc_gain)
    assert np.all(np.abs(found.linear.zeros) < 1.0)


@pytest.mark.parametrize(
    ("voltage", "displacement", "message"),
    [
        (np.linspace(-1.0, 1.0, 300), np.linspace(-1.0, 1.0, 300), "rising branch.*whole loop"),
        (np.concatenate([CYCLE[:300], 2.0 * CYCLE[300:]]), CYCLE, "no rising branch extends from"),
        (MAJOR, -truth(MAJOR), "output falls while the input rises"),
        (MAJOR[:10], MAJOR[:10], "too short"),
    ],
)
def test_bad_recordings_are_refused(voltage, displacement, message):
    with pytest.raises(IdentificationError, match=message):
        identify_duhem(voltage, displacement)


def test_wrong_choices_are_refused():
    with pytest.raises(IdentificationError, match="network or spline"):
        identify_duhem(MAJOR, truth(MAJOR), shape="tree")
    with pytest.raises(IdentificationError, match="alpha = -1"):
        identify_duhem(MAJOR, truth(MAJOR), alpha=-1.0)


def test_a_first_cycle_from_rest_is_told():
    voltage = np.concatenate([np.linspace(0.0, 1.0, 200), np.linspace(1.0, 0.0, 200)])
    result = identify_duhem(voltage, truth(voltage), alpha=3.0, shape="spline")
    assert any("the loop has a gap" in warning for warning in result.warnings)
