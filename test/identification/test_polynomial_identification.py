# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Kim's procedure (K2, K3): coefficients are recovered, other loops are predicted, bad recordings are refused."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.polynomial import identify_polynomial, identify_preload, preload_of_offset
from hysteresis_ros.laboratory.papers.kim2009.identification import KIM_PEAKS, STIFFNESS, paper_k
from hysteresis_ros.laboratory.papers.runs import triangles
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis, assumed_stack

STACK = assumed_stack(voltage_low=0.0)
NAMES = ("virgin", "rising_D", "rising_C1", "rising_C2", "falling_D", "falling_C1", "falling_C2")


def displaced(voltage, parameters=STACK):
    return PolynomialHysteresis(parameters, 1e-3).simulate(voltage)


def assert_same(found, wanted, tolerance):
    """Compare coefficients by their contributions at 120 V."""
    for name in NAMES:
        power = {"D": 0, "1": 1, "2": 2}.get(name[-1], 0)
        volts = 120.0 ** (power + np.arange(3.0))
        difference = (np.array(getattr(found, name)) - np.array(getattr(wanted, name))) * volts
        assert np.max(np.abs(difference)) < tolerance, name


@pytest.mark.parametrize("method", ["samples", "loops"])
def test_loops_of_growing_peak_give_the_coefficients_back(method):
    voltage = triangles(KIM_PEAKS, 60)
    result = identify_polynomial(voltage, displaced(voltage), method=method)
    assert_same(result.parameters, STACK, 1e-12)
    assert result.rms < 1e-13 and result.warnings == () and result.converged
    assert len(result.loops) == 20 and np.isnan(result.loops[-1].C_r2) and not np.isnan(result.loops[0].C_r2)
    assert pytest.approx(0.0125 * 60e-6) == result.loops[9].D
    assert result.loops[9].C_f2 == pytest.approx(-2.0 * 0.15 * 0.1025e-6 / 120.0)


def test_white_noise_is_within_the_covariance():
    voltage = triangles(KIM_PEAKS, 60)
    noisy = displaced(voltage) + 5e-9 * np.random.default_rng(1).standard_normal(voltage.size)
    result = identify_polynomial(voltage, noisy)
    assert result.criterion == "rms"
    assert result.rms == pytest.approx(5e-9, rel=0.1)
    for name in NAMES:
        error = np.array(getattr(result.parameters, name)) - np.array(getattr(STACK, name))
        assert np.all(np.abs(error) <= 4.5 * np.array(result.standard_errors[name]) + 1e-20), name


def test_any_excitation_with_growing_peaks_will_do():
    """Minor loops, repeated loops and sines: the output stays linear in the coefficients."""
    phase = np.linspace(0.0, 2.0 * np.pi * 6.0, 3001)
    voltage = 60.0 * np.linspace(0.3, 1.9, phase.size) * (1.0 - np.cos(phase)) * 0.5
    result = identify_polynomial(voltage, displaced(voltage))
    assert_same(result.parameters, STACK, 1e-10)


def test_one_decreasing_triangle_says_what_it_assumes():
    voltage = triangles(np.linspace(120.0, 12.0, 10), 60)
    result = identify_polynomial(voltage, displaced(voltage))
    assert "1 different V_max" in result.warnings[0] and "assumed" in result.warnings[0]
    np.testing.assert_allclose(displaced(voltage, result.parameters), displaced(voltage), rtol=0.0, atol=1e-11)


def test_history_before_the_recording():
    whole = triangles([120.0, 60.0, 120.0], 60)
    start = 120  # back at 0 V, after the stack has been at 120 V
    result = identify_polynomial(whole[start:], displaced(whole)[start:], history=(120.0,))
    assert result.rms < 1e-12


def test_a_rest_of_the_first_rise_does_not_extrapolate_the_virgin_curve():
    voltage = triangles([120.0, 120.0, 80.0], 200)
    omitted = int(np.argmax(voltage >= 114.0))
    x = displaced(voltage) + 5e-9 * np.random.default_rng(2).standard_normal(voltage.size)
    result = identify_polynomial(voltage[omitted:], x[omitted:], history=voltage[:omitted])
    virgin = result.parameters.virgin
    assert virgin[0] == pytest.approx(displaced(voltage)[np.argmin(voltage[200:500]) + 200], abs=20e-9)
    assert abs(virgin[2]) * 120.0 < 1e-3 * virgin[1] and result.rms < 6e-9


def test_sensor_offset_goes_to_the_constant_terms():
    voltage = triangles(KIM_PEAKS, 40)
    result = identify_polynomial(voltage, displaced(voltage) - 3e-6)
    assert result.parameters.virgin[0] == pytest.approx(-3e-6)
    assert result.parameters.rising_D[0] == result.parameters.falling_D[0] == result.parameters.virgin[0]


def test_corners_meet_for_every_peak():
    """D_r = D_f and x_r(V_max) = x_f(V_max) = x_v(V_max), also for loops of another class."""
    p = paper_k(noise=0.0).model.parameters
    for v_max in np.linspace(6.0, 120.0, 7):
        curves = {}
        for family in ("rising", "falling"):
            d, c1, c2 = (np.polyval(getattr(p, f"{family}_{c}")[::-1], v_max) for c in ("D", "C1", "C2"))
            curves[family] = d, d + v_max * (c1 + v_max * c2)
        np.testing.assert_allclose(curves["rising"], curves["falling"], rtol=0.0, atol=1e-18)
        assert curves["rising"][1] == pytest.approx(np.polyval(p.virgin[::-1], v_max))


def test_paper_k_error_and_preload():
    """Modelling error within 0.125 µm on a decreasing triangle of 12 µm (paper's figure 6); 5.88 N is recovered."""
    found = paper_k()
    assert 11.9e-6 < found.stroke < 12.2e-6
    assert found.maximum < 0.125e-6
    assert found.preload == pytest.approx(5.88, rel=2e-3)
    assert found.preload_curve.stiffness == pytest.approx(STIFFNESS, rel=0.01)
    assert found.model.criterion == "maximum"


def test_branch_that_is_not_monotone_is_mended_and_reported():
    voltage = triangles(KIM_PEAKS, 60)
    bad = assumed_stack(opening=0.6, voltage_low=0.0)
    with_dip = PolynomialHysteresis.__new__(PolynomialHysteresis)  # the model itself refuses such coefficients
    with_dip.parameters, with_dip.p = bad, with_dip.pack(bad)
    with_dip.x = with_dip.initial_state()
    result = identify_polynomial(voltage, with_dip.simulate(voltage))
    assert any("not monotone" in warning for warning in result.warnings)
    result.parameters.validated()


@pytest.mark.parametrize(
    ("voltage", "displacement", "message"),
    [
        (np.linspace(0.0, 100.0, 200), np.linspace(0.0, 1e-5, 200), "rising branch.*whole loop"),
        (np.zeros(200), np.linspace(0.0, 1e-5, 200), "voltage is constant"),
        (triangles([100.0], 4), np.linspace(0.0, 1e-5, 9), "9 samples, too short"),
        (triangles([100.0], 40) - 90.0, triangles([100.0], 40), "from -90 to 10 V.*prandtl_ishlinskii"),
        (triangles([100.0], 40), np.full(81, np.nan), "displacement is not finite at 81"),
        (triangles([100.0], 40), np.arange(80.0), "81 samples and displacement 80"),
    ],
)
def test_bad_recordings_are_refused(voltage, displacement, message):
    with pytest.raises(IdentificationError, match=message):
        identify_polynomial(voltage, displacement)


def test_preload_curve_and_its_inverse():
    truth = PreloadParameters(A1=0.1e-6, B1=-1.0 / STIFFNESS, B2=2e-8)
    force = np.linspace(0.0, 6.0, 31)
    w = truth.A1 + force * (truth.B1 + force * truth.B2)
    result = identify_preload(force, w, in_use=5.88)
    assert pytest.approx(truth.B2) == result.parameters.B2
    assert preload_of_offset(result.parameters, result.parameters.offset) == pytest.approx(5.88)
    assert result.warnings == ()
    assert "extrapolated" in identify_preload(force, w, in_use=9.0).warnings[0]
    with pytest.raises(IdentificationError, match="not reached.*sign"):
        preload_of_offset(result.parameters, 5e-6)
    with pytest.raises(IdentificationError, match="2 different preloads"):
        identify_preload([0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 1.0])
