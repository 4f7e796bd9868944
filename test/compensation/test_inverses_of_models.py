# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inverses: inverse ∘ forward is the identity; the compensator with every inverse type and with creep."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.creep import Creep, CreepOperatorsParameters, CreepParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters, multiplicative
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters
from hysteresis_ros.models.hysteresis.duhem import DuhemParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters
from hysteresis_ros.models.hysteresis.preisach import PreisachParameters, everett_of
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.inverses import InverseParameters, general
from hysteresis_ros.models.limits import LimitsParameters

STROKE = 12e-6
KNOTS = np.linspace(-1.0, 1.0, 9)
BOUC_WEN = BoucWenParameters(d_e=0.16e-6, alpha=0.05e-6, beta=6e-3, gamma=4e-3)
PLAYS = PrandtlIshlinskiiParameters(
    radii=tuple(6.0 * np.arange(8)),
    weights=(60e-9, 9e-9, 7e-9, 6e-9, 5e-9, 4e-9, 3e-9, 2e-9),
    thresholds=(2e-6, 6e-6, -1e-6),
    zone_weights=(0.1, -0.3, 0.2),
    offset=0.2e-6,
)


def _preisach():
    plays = hysteresis_block(HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=PLAYS), 1e-3)
    everett = tuple(everett_of(plays, -40.0, 160.0, 21))
    return PreisachParameters(voltage_low=-40.0, voltage_high=160.0, everett=everett, offset=-3e-6)


MODELS = {
    "proportional": ProportionalParameters(gain=1e-7),
    "polynomial": assumed_stack(),
    "bouc_wen": BOUC_WEN,
    "duhem": DuhemParameters(
        alpha=0.03,
        input_low=0.0,
        input_high=120.0,
        output_low=0.0,
        output_high=STROKE,
        shape="spline",
        f_spline=tuple(0.95 * KNOTS + 0.03 * KNOTS**3),
        g_spline=tuple(0.85 + 0.1 * KNOTS**2),
    ),
    "prandtl_ishlinskii": PLAYS,
    "preisach": _preisach(),
}
voltages = st.lists(st.floats(-30.0, 150.0), min_size=1, max_size=12)


def hysteresis(name):
    return HysteresisParameters(type=name, **{name: MODELS[name]})


def settings_of_general(block, low=-60.0, high=200.0):
    return np.array([0.0, 0.0, block.gain, low, high])


def check_identity(block, inverse, wanted, tolerance=1e-9):
    """Drive the model through its inverse; the state must be untouched by the search."""
    p_i, x_i = settings_of_general(block), np.zeros(len(block.x) + 2)
    for displacement in wanted:
        before = block.state
        voltage = inverse(block.kernel, p_i, x_i, block.p, block.x, displacement)
        np.testing.assert_array_equal(block.x, before)
        assert block.step(voltage) == pytest.approx(displacement, abs=tolerance * STROKE)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=40)
@given(drive=voltages)
def test_general_inverse_is_the_identity(name, drive):
    check_identity(
        hysteresis_block(hysteresis(name), 1e-3), general, hysteresis_block(hysteresis(name), 1e-3).simulate(drive)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["proportional", "polynomial", "prandtl_ishlinskii"])
@settings(max_examples=40)
@given(drive=voltages)
def test_closed_form_inverse_is_the_identity(name, drive):
    block = hysteresis_block(hysteresis(name), 1e-3)
    check_identity(block, block.inverse, hysteresis_block(hysteresis(name), 1e-3).simulate(drive))


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [1.0, 2.0])
@settings(max_examples=40)
@given(drive=voltages)
def test_multiplicative_inverse_is_the_identity(exponent, drive):
    size = 8e-6 ** (exponent - 1.0)
    given = dataclasses.replace(BOUC_WEN, exponent=exponent, beta=6e-3 / size, gamma=4e-3 / size)
    check_identity(BoucWenHysteresis(given, 1e-3), multiplicative, BoucWenHysteresis(given, 1e-3).simulate(drive))


@pytest.mark.slow
def test_multiplicative_inverse_of_the_paper_s_actuator():
    """The actuator's loop is not quite monotone at 150 V; below 150 V the inverse is nevertheless exact."""
    paper = BoucWenParameters(d_e=0.206e-6, alpha=8.09e-8, beta=3.80e-3, gamma=-5.40e-3)
    wanted = np.concatenate([np.linspace(0.0, 14.375e-6, 200), np.linspace(14.375e-6, 0.0, 200)])
    check_identity(BoucWenHysteresis(paper, 1e-3), multiplicative, wanted)
    check_identity(BoucWenHysteresis(paper, 1e-3), general, wanted)


@pytest.mark.parametrize("name", MODELS)
def test_displacements_out_of_reach_give_the_end_of_the_search(name):
    block = hysteresis_block(hysteresis(name), 1e-3)
    x_i = np.zeros(len(block.x) + 2)
    for displacement, end in ((1.0, 200.0), (-1.0, -60.0)):
        assert general(block.kernel, settings_of_general(block), x_i, block.p, block.x, displacement) == end


@kernel
def jump(p, x, u):
    return 1.0 if u > 3.3 else -1.0


def test_search_ends_where_there_is_no_solution():
    """At a jump the search ends with the two neighbouring numbers."""
    x_i = np.zeros(4)
    voltage = general(jump, np.array([0.0, 0.0, 1e-3, -60.0, 200.0]), x_i, np.zeros(1), np.zeros(2), 0.3)
    assert voltage == pytest.approx(3.3, abs=1e-14)


def parameters(name, kind, creep=None, **inverse):
    return CompensatorParameters(
        inverse=InverseParameters(type=kind, **inverse),
        hysteresis=hysteresis(name),
        creep=creep or CreepParameters(),
        limits=LimitsParameters(minimum=-30.0, maximum=150.0),
        handover_time=0.002,
    )


CASES = [(name, "general") for name in MODELS] + [
    ("prandtl_ishlinskii", "exact"),
    ("bouc_wen", "multiplicative"),
    ("preisach", "picard_steps"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_compensator_carries_out_the_command(name, kind):
    block = Compensator(parameters(name, kind, picard_steps=30), 1e-3)
    plant = hysteresis_block(hysteresis(name), 1e-3)
    for command in 5e-6 + 4e-6 * np.sin(0.1 * np.arange(150)):
        reached = plant.step(block.step(command))
        assert reached == pytest.approx(block.applied, abs=1e-15)
        assert reached == pytest.approx(command, abs=(1e-3 if kind == "picard_steps" else 1e-9) * STROKE)
        assert not block.saturated
    kept, ahead = block.state, [block.step(command) for command in (1e-6, 9e-6, 3e-6)]
    block.state = kept
    assert [block.step(command) for command in (1e-6, 9e-6, 3e-6)] == ahead
    block.step(1.0)
    assert block.voltage == 150.0 and block.saturated


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_retune_keeps_the_voltage(name, kind):
    block = Compensator(parameters(name, kind), 1e-3)
    for command in (2e-6, 8e-6, 5e-6):
        block.step(command)
    before = block.voltage
    block.retune(parameters(name, kind))
    assert block.step(5e-6) == pytest.approx(before, abs=1e-6)


@pytest.mark.parametrize("kind", ["exact", "general"])
def test_creep_is_fed_forward(kind):
    creep = CreepParameters(type="operators", operators=CreepOperatorsParameters((0.02, 0.03), (0.05, 0.4)))
    block = Compensator(parameters("prandtl_ishlinskii", kind, creep), 1e-3)
    plant, creeping = hysteresis_block(hysteresis("prandtl_ishlinskii"), 1e-3), Creep(creep, 1e-3)
    creeping.settle(plant.step(0.0))
    for command in np.repeat([4e-6, 9e-6, 2e-6], 200):
        reached = creeping.step(plant.step(block.step(command)))
        assert reached == pytest.approx(command, abs=1e-9 * STROKE)
        assert block.applied == pytest.approx(command, abs=1e-9 * STROKE)


@pytest.mark.slow
def test_inverse_duhem_equation_keeps_its_own_point():
    """With f linear and g its slope, both equations are straight lines: V = w/gain, no loop."""
    straight = dict(shape="spline", f_spline=tuple(KNOTS), g_spline=(1.0,) * 9)
    inverse = DuhemParameters(
        alpha=1e5, input_low=0.0, input_high=STROKE, output_low=0.0, output_high=120.0, **straight
    )
    block = Compensator(parameters("proportional", "duhem", duhem=inverse), 1e-3)
    for command in (3e-6, 9e-6, 9e-6, 4e-6):
        assert block.step(command) == pytest.approx(command / 1e-7, rel=1e-9)
    block.reset()
    assert block.step(3e-6) == pytest.approx(30.0, rel=1e-9)


def test_inverses_that_do_not_fit_are_refused_with_the_way_out():
    for name, kind, message in [
        ("bouc_wen", "exact", "no closed-form inverse; use general"),
        ("preisach", "exact", "no closed-form inverse; use general"),
        ("preisach", "multiplicative", "bouc_wen only.*use general"),
    ]:
        with pytest.raises(ParameterError, match=rf"inverse.type = '{kind}'.*{message}"):
            Compensator(parameters(name, kind), 1e-3)
    values = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    oscillator = HysteresisParameters(
        type="bouc_wen_mechanical", bouc_wen_mechanical=BoucWenMechanicalParameters(**values)
    )
    with pytest.raises(ParameterError, match=r"internal dynamics.*use none"):
        Compensator(dataclasses.replace(parameters("proportional", "general"), hysteresis=oscillator), 1e-3)
