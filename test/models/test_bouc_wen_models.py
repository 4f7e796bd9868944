# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bouc-Wen: the figures of paper B, the ODE itself, warnings; the mechanical oscillator against SciPy's integrator."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters, H
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters, BoucWenOscillator
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import zero_order_hold

integrate = pytest.importorskip("scipy.integrate")

PAPER = BoucWenParameters(d_e=0.206e-6, alpha=8.09e-8, beta=3.80e-3, gamma=-5.40e-3)


def oscillator(sample_time=1.0 / 750.0, **changes):
    values = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1, **changes)
    return BoucWenOscillator(BoucWenMechanicalParameters(**values), sample_time)


def test_paper_s_actuator_reaches_the_published_displacement_at_150_volt():
    """17.19 µm (data sheet 17.4 ± 2.0 µm), with h instead of V in the second term of the equation."""
    assert BoucWenHysteresis(PAPER, 1e-3).step(150.0) == pytest.approx(17.19e-6, abs=0.01e-6)


def test_paper_s_loop_ratchets_and_says_so():
    block = BoucWenHysteresis(PAPER, 1e-3)
    peaks = [block.simulate([150.0, 0.0])[0] for _ in range(4)]
    assert np.all(np.diff(peaks) > 0.3e-6)
    warnings = HysteresisParameters(type="bouc_wen", bouc_wen=PAPER).warnings("plant: ")
    assert len(warnings) == 1
    assert "plant: bouc_wen.beta" in warnings[0] and "-0.0016" in warnings[0] and "ratchet" in warnings[0]


def test_bounded_class_gives_no_warning_and_closed_loops():
    block = BoucWenHysteresis(BoucWenParameters(d_e=0.16e-6, alpha=0.05e-6, beta=0.06, gamma=0.04), 1e-3)
    assert block.parameters.warnings() == ()
    block.simulate([150.0, 0.0] * 20)
    peak = block.step(150.0)
    assert block.simulate([0.0, 150.0])[1] == pytest.approx(peak, rel=1e-12)
    assert abs(block.x[H]) == pytest.approx(0.05e-6 / 0.1, rel=1e-6)


def test_loops_that_are_not_monotone_are_told():
    steep = BoucWenParameters(d_e=0.1e-6, alpha=0.08e-6, beta=5e-3, gamma=1e-3)
    assert "not monotone" in steep.warnings()[0]
    with pytest.raises(ParameterError, match=r"alpha.*below d_e"):
        BoucWenHysteresis(BoucWenParameters(d_e=0.1e-6, alpha=0.1e-6, beta=0.01, gamma=0.0), 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exponent", "points", "tolerance"),
    [(1.0, 1, 1e-13), (1.5, 1, 1e-6), (1.5, 300, 1e-8), (2.0, 1, 1e-8), (3.0, 300, 1e-9)],
)
def test_equation_is_solved(exponent, points, tolerance):
    size = 8e-6 ** (exponent - 1.0)
    given = BoucWenParameters(d_e=0.206e-6, alpha=8e-8, beta=6e-3 / size, gamma=4e-3 / size, exponent=exponent)
    block, h, voltage = BoucWenHysteresis(given, 1e-3), 0.0, 0.0
    for turn in (150.0, -40.0, 120.0, 0.0, 60.0):
        sign = np.sign(turn - voltage)

        def slope(_, h, sign=sign):
            power = abs(h) ** exponent
            return sign * (given.alpha - given.gamma * power) - given.beta * np.sign(h) * power

        options = dict(method="DOP853", rtol=1e-12, atol=1e-20, max_step=0.5)
        h = integrate.solve_ivp(slope, (0.0, abs(turn - voltage)), [h], **options).y[0, -1]
        block.simulate(np.linspace(voltage, turn, points + 1)[1:])
        assert block.x[H] == pytest.approx(h, abs=tolerance * 20e-6)
        voltage = turn


@pytest.mark.parametrize("intersample", ["linear", "zoh"])
@pytest.mark.parametrize(("substeps", "tolerance"), [(4, 2e-4), (32, 5e-6)])
def test_oscillator_follows_its_equations(intersample, substeps, tolerance):
    block = oscillator(intersample=intersample, substeps=substeps)
    Ts, count = block.sample_time, 150
    force = 150.0 * np.sin(2.0 * np.pi * 20.0 * Ts * np.arange(count)) + 60.0 * np.sin(1.3 * np.arange(count))
    z = [0.0, 0.0, 0.0]
    expected = [0.0]
    for k in range(count - 1):
        slope = (force[k + 1] - force[k]) / Ts if intersample == "linear" else 0.0

        def rates(t, s, start=force[k], slope=slope):
            y, v, z = s
            pull = start + slope * t - 10.0 * v - 5e4 * y - z
            return [v, pull / 2.0, 5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z))]

        options = dict(method="DOP853", rtol=1e-10, atol=1e-14, max_step=Ts / 4.0)
        z = integrate.solve_ivp(rates, (0.0, Ts), z, **options).y[:, -1]
        expected.append(z[0])
    np.testing.assert_allclose(block.response(force), expected, rtol=0.0, atol=tolerance * np.ptp(expected))


def test_oscillator_without_hysteresis_is_linear():
    values = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=0.0, beta=0.0, gamma=0.0, delta=0.0, substeps=64)
    block = BoucWenOscillator(BoucWenMechanicalParameters(**values), 1.0 / 750.0)
    A, B = zero_order_hold([[0.0, 1.0], [-2.5e4, -5.0]], [0.0, 0.5], 1.0 / 750.0)
    force = np.sin(0.3 * np.arange(200))
    state, expected = np.zeros(2), []
    for u in force:
        expected.append(state[0])
        state = A @ state + B[:, 0] * u
    np.testing.assert_allclose(block.response(force), expected, rtol=0.0, atol=1e-9 * np.ptp(expected))


def test_oscillator_is_the_whole_plant_of_an_actuator():
    """Held voltages act exactly like held forces; there are no dynamics after the oscillator."""
    block = oscillator(force_per_input=3.0)
    plant = Actuator(
        ActuatorParameters(
            limits=LimitsParameters(minimum=-100.0, maximum=100.0),
            hysteresis=HysteresisParameters(type="bouc_wen_mechanical", bouc_wen_mechanical=block.parameters),
        ),
        block.sample_time,
    )
    voltages = 80.0 * np.sin(0.2 * np.arange(100))
    measured = []
    for voltage in voltages:
        measured.append(plant.measure())
        plant.advance(voltage)
    np.testing.assert_array_equal(measured, block.response(voltages))


def test_too_few_substeps_are_refused():
    with pytest.raises(ParameterError, match=r"substeps = 1.*at least 2"):
        oscillator(sample_time=0.01, substeps=1)


def test_unbounded_hysteretic_force_is_told():
    values = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=-0.8, delta=0.1)
    assert "unbounded" in BoucWenMechanicalParameters(**values).warnings()[0]
