# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Damping in front of a plant: closed forms of its filters, what a law sees of the plant, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from damping_support import CHOSEN, DAMPING, FORCE, OMEGA, T, controller, damping, stage
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control.controller import ControllerParameters, ModelParameters, controller_block, damping_block
from hysteresis_ros.control.damping import inner_loop as block
from hysteresis_ros.control.damping.inner_loop import KINDS, as_output, damped, inner_loop, modes
from hysteresis_ros.control.linearisation import linear_loop, whole_loop
from hysteresis_ros.control.margins import loop_transfer, margins_of
from hysteresis_ros.designs import damping as damping_designs
from hysteresis_ros.designs.damping import damping_plants, design_damping
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.models.sensor import (
    ForceParameters,
    ForceSensorParameters,
    force_reading,
    force_state,
    note_acting,
    pack_force,
)

kinds = pytest.mark.parametrize("kind", CHOSEN)


def test_all_kinds_are_tried_here():
    assert set(KINDS) == set(CHOSEN)


class Sensed:
    """Dynamics whose input pushes a stack with a force sensor."""

    def __init__(self, plant: LinearDynamics, force: ForceParameters):
        values = {name: getattr(force, name) for name in ("stack_stiffness", "flexure_stiffness", "high_pass")}
        self.plant, sensor = plant, ForceSensorParameters(**values)
        self.p, self.x = pack_force(sensor, plant.parameters, plant.sample_time), force_state(sensor)

    def read(self) -> float:
        return force_reading(self.p, self.x, self.plant.output())

    def step(self, command: float) -> None:
        note_acting(self.p, self.x, self.plant.x, command)
        self.plant.step(command)


def response(system, hertz):
    return system.response(np.exp(2j * np.pi * np.atleast_1d(hertz) * T))[0, 0, 0]


def test_a_filter_has_its_continuous_response_at_its_frequency_and_its_gain_at_rest():
    found = damping("irc").filter(T)
    # k/(s − k D_f) with s = h (z − 1)/(z + 1), h = 2/T: exactly the continuous filter at the warped frequency
    s = 2j / T * math.tan(math.pi * 300.0 * T)
    assert response(found, 300.0) == pytest.approx(2000.0 / (s + 5000.0), rel=1e-12)
    assert found.dc_gain == pytest.approx(1.0 / 2.5, rel=1e-12)
    found = damping("ppf", frequencies=(900.0,), damping=(0.4,), gains=(-0.2,)).filter(T)
    assert response(found, 900.0) == pytest.approx(-0.2 / (2j * 0.4), rel=1e-9)
    assert found.dc_gain == pytest.approx(-0.2, rel=1e-12)
    both, one = damping("ppf").filter(T), damping("ppf", frequencies=(900.0,), damping=(0.4,), gains=(0.2,)).filter(T)
    other = damping("ppf", frequencies=(3000.0,), damping=(0.7,), gains=(0.1,)).filter(T)
    assert response(both, 777.0) == pytest.approx(response(one, 777.0) + response(other, 777.0), rel=1e-12)
    found = damping("notch").filter(T)
    assert found.order == 4 and found.dc_gain == pytest.approx(1.0, rel=1e-12)
    assert abs(response(found, 0.5 / T - 1e-6)) == pytest.approx(1.0, rel=1e-9)
    single = damping("notch", frequencies=(700.0,), damping=(0.01,), width=(0.5,)).filter(T)
    assert response(single, 700.0) == pytest.approx(0.02, rel=1e-9)
    other = damping("notch", frequencies=(2100.0,), damping=(0.1,), width=(0.4,)).filter(T)
    assert response(found, 555.0) == pytest.approx(response(single, 555.0) * response(other, 555.0), rel=1e-12)


def test_integral_resonant_control_has_the_poles_of_its_characteristic_polynomial():
    # at 2 MHz without delay: (s² + 2 ζ ω s + ω²)(s − k D_f) − k ω² = 0; the hold has no effect at this rate
    fast = 5e-7
    dynamics = stage(delay=0.0, sample_time=fast)
    found = damped(dynamics, damping("irc"), fast)
    polynomial = np.polymul([1.0, 2.0 * DAMPING * OMEGA, OMEGA**2], [1.0, 5000.0])
    wanted = np.roots(np.polysub(polynomial, [2000.0 * OMEGA**2]))
    poles = np.log(found.state_space.poles.astype(complex)) / fast
    assert np.sort_complex(poles) == pytest.approx(np.sort_complex(wanted), rel=2e-3)
    assert -wanted.real.max() > 0.1 * OMEGA  # and they are damped, by at least a tenth


def test_integral_force_feedback_has_the_poles_of_its_characteristic_polynomial_and_preumonts_largest_damping():
    # at 2 MHz without delay: (s² + 2 ζ ω s + ω²)(s + ω_c) + α K (s² + 2 ζ ω s + ω_z²) = 0, ω_z² = ω² k_f/K
    fast, gain, leak = 5e-7, 1.5e-4, 200.0
    whole = FORCE.stack_stiffness + FORCE.flexure_stiffness
    without = ForceParameters(stack_stiffness=FORCE.stack_stiffness, flexure_stiffness=FORCE.flexure_stiffness)
    chosen = damping("iff", gain=gain, leak=leak, high_pass=0.0)
    found = damped(stage(delay=0.0, sample_time=fast), chosen, fast, without)
    zeros = [1.0, 2.0 * DAMPING * OMEGA, OMEGA**2 * FORCE.flexure_stiffness / whole]
    polynomial = np.polymul([1.0, 2.0 * DAMPING * OMEGA, OMEGA**2], [1.0, leak])
    wanted = np.roots(np.polyadd(polynomial, gain * whole * np.array(zeros)))
    poles = np.log(found.state_space.poles.astype(complex)[np.abs(found.state_space.poles) > 0.5]) / fast
    assert np.sort_complex(poles) == pytest.approx(np.sort_complex(wanted), rel=5e-3)
    # with an integrator alone no gain gives more damping than (ω_p − ω_z)/(2 ω_z), reached with α K = ω_p √(ω_p/ω_z)
    soft = ForceParameters(stack_stiffness=2e7, flexure_stiffness=1e7)
    ratio = math.sqrt(soft.flexure_stiffness / soft.whole)

    def reached(level):
        own = damping("iff", gain=level * OMEGA / soft.whole, leak=1.0, high_pass=0.0)
        poles = damped(stage(delay=0.0, sample_time=fast), own, fast, soft).state_space.poles
        return modes(poles.astype(complex), fast)[0][1]

    best, most = math.sqrt(1.0 / ratio), (1.0 - ratio) / (2.0 * ratio)
    assert reached(best) == pytest.approx(most, rel=0.05)
    assert max(reached(0.5 * best), reached(2.0 * best)) < 0.8 * most


@pytest.mark.parametrize("high_pass", [0.0, 600.0])
def test_a_force_at_rest_does_not_move_what_the_law_means(high_pass):
    own = controller("iff", force=replace(FORCE, high_pass=0.0), high_pass=high_pass)
    between, plant = damping_block(own, T), LinearDynamics(stage(), T)
    sensor = Sensed(plant, replace(FORCE, high_pass=0.0))
    for _ in range(6000):
        sensor.step(block.damp(between.p, between.x, 3e-6, plant.output(), sensor.read()))
    assert plant.output() == pytest.approx(3e-6, rel=1e-6)
    assert sensor.read() == pytest.approx(FORCE.flexure_stiffness * 3e-6, rel=1e-6)
    # with the high-pass an offset of the sensor has no effect; without it the axis moves by α/ω_c of the offset
    for _ in range(6000):
        sensor.step(block.damp(between.p, between.x, 3e-6, plant.output(), sensor.read() + 0.5))
    moved = plant.output() - 3e-6
    if high_pass:
        assert abs(moved) < 1e-12
    else:
        assert moved == pytest.approx(-0.5 * 3e-5 / 900.0 / (1.0 + 2e6 * 3e-5 / 900.0), rel=1e-6)


@kinds
def test_what_a_law_sees_is_the_plant_behind_the_kernel(kind):
    own = controller(kind)
    seen = own.before_damping(T).model.dynamics
    assert seen.order <= 8 + 4 and seen.delay == 0.0
    assert seen.matrices.dc_gain / seen.resolved_input_scale * seen.output_scale == pytest.approx(1.0, rel=1e-9)
    plant, model = LinearDynamics(stage(), T), LinearDynamics(seen, T)
    sensor = Sensed(plant, FORCE)
    between = damping_block(own, T)
    random = np.random.default_rng(3)
    # it begins at rest with the first sample
    for output in [0.0, *(1e-6 * random.standard_normal(300)).tolist()]:
        measured = plant.output()
        assert measured == pytest.approx(model.output(), abs=1e-15)
        sensor.step(block.damp(between.p, between.x, output, measured, sensor.read()))
        model.step(output)
    assert abs(plant.output()) > 1e-8


@kinds
def test_at_rest_at_a_displacement_the_filter_begins_at_rest(kind):
    between = damping_block(controller(kind), T)
    commands = [block.damp(between.p, between.x, 3e-6, 3e-6, 0.0) for _ in range(50)]
    assert commands == pytest.approx([3e-6] * 50, rel=1e-12)


def test_without_damping_nothing_is_touched():
    between = damping_block(controller(), T)
    assert block.damp(between.p, between.x, 0.1, math.nan, math.nan) == 0.1
    assert as_output(between.p, between.x, 0.3) == 0.3 and not np.any(between.x)


@kinds
@settings(max_examples=25)
@given(st.floats(-1e-5, 1e-5), st.floats(-1e-5, 1e-5), st.floats(-1e-5, 1e-5))
def test_what_was_carried_out_is_heard_as_the_output_that_would_have_led_to_it(kind, output, measured, cut):
    between = damping_block(controller(kind), T)
    block.damp(between.p, between.x, 1e-6, 2e-6, 0.0)
    before = between.x.copy()
    command = block.damp(between.p, between.x, output, measured, 0.0)
    assert as_output(between.p, between.x, command) == output
    heard = as_output(between.p, between.x, command - cut)
    again = damping_block(controller(kind), T)
    again.x[:] = before
    carried = block.damp(again.p, again.x, heard, measured, 0.0)
    assert carried == pytest.approx(command - cut, abs=1e-18 + 1e-12 * abs(cut))


@pytest.mark.parametrize(
    ("kind", "changes", "named"),
    [
        ("irc", {"k": 2000.0, "feedthrough": -0.9}, r"damping\.irc = .*largest pole 1\.\d+"),
        ("irc", {"k": 0.0}, r"irc\.k = 0"),
        ("irc", {"k": -2000.0}, r"irc\.k = -2000.*must have the opposite sign of feedthrough = -2.5"),
        ("ppf", {"gains": (0.2, 0.9)}, r"damping\.ppf = .*inner loop is unstable"),
        ("ppf", {"frequencies": (900.0, 10000.0)}, r"damping\.ppf\.frequencies = .*half the sample rate, 10000 Hz"),
        ("ppf", {"frequencies": ()}, r"ppf\.frequencies = .*1 … 2 numbers"),
        ("ppf", {"damping": (0.4,)}, r"ppf\.damping = .*2 numbers"),
        ("ppf", {"gains": (0.2,)}, r"ppf\.gains = .*2 numbers"),
        ("iff", {"gain": 3e-3}, r"damping\.iff = .*inner loop is unstable.*largest pole 1\.\d+"),
        ("iff", {"gain": 0.0}, r"iff\.gain = 0.*must not be 0"),
        ("iff", {"force": ForceParameters()}, r"model\.force\.stack_stiffness = 0.*missing force joint"),
        ("notch", {"frequencies": (700.0, 12000.0)}, r"damping\.notch\.frequencies = .*half the sample rate"),
        ("notch", {"damping": (0.01,)}, r"notch\.damping = .*2 numbers"),
        ("notch", {"width": (0.5,)}, r"notch\.width = .*2 numbers"),
    ],
)
def test_what_cannot_work_is_refused_by_name_and_figure(kind, changes, named):
    with pytest.raises(ParameterError, match=named):
        controller_block(controller(kind, **changes), T)


def test_a_model_without_a_resonance_has_nothing_to_damp():
    lag = LinearParameters(A=(0.9,), B=(0.1,), C=(1.0,), sample_time=T)
    with pytest.raises(ParameterError, match=r"model\.dynamics\.A = .*nothing to damp"):
        design_damping("irc", lag, T, damping_plants(lag, T))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["irc", "iff"])
def test_a_designed_damping_makes_the_pid_five_times_as_fast_with_the_resonance_off_to_both_sides(kind):
    dynamics = stage()
    plants = damping_plants(dynamics, T, acting=kind == "iff")
    own = design_damping(kind, dynamics, T, plants, FORCE)
    found = ControllerParameters(type="pid", model=ModelParameters(dynamics=dynamics, force=FORCE), damping=own)
    loop = inner_loop(found.damping, dynamics, T, FORCE)
    closed = tuple(one.closed(loop.around) for one in plants)
    with_it = design_gains(found, "pid", T, plants=closed).parameters
    without = design_gains(ControllerParameters(model=found.model), "pid", T, plants=damping_plants(dynamics, T))
    outer, _ = linear_loop(with_it, T)
    both, bare = whole_loop(with_it, T)
    assert bare.order == plants[0].plant.order
    # a loop that is cut at the plant contains both feedbacks
    z = np.exp(1j * np.array([0.01, 0.1, 0.22, 1.0]))
    P, fed = bare.response(z)[:, :, 0], loop.feedback.response(z)[:, 0, 0]
    parts = loop.forward * outer.response(z)[:, 0, 1] * P[:, 0], fed * (P @ loop.seen[0])
    assert loop_transfer(both, bare, z) == pytest.approx(-parts[0] - parts[1], rel=1e-9)
    for one, around in zip(plants, closed, strict=True):
        slowest, whole = margins_of(outer, around.plant, T), margins_of(both, one.plant, T)
        assert slowest.bandwidth >= 5.0 * without.margins.bandwidth
        assert slowest.sensitivity_peak <= 2.0 and whole.sensitivity_peak <= 2.0
        assert whole.delay_margin_samples >= 1.0
        # the poles of the loop do not depend on the point at which it is opened
        assert np.sort(np.abs(slowest.poles))[-4:] == pytest.approx(np.sort(np.abs(whole.poles))[-4:], rel=1e-6)
        assert modes(around.plant.poles.astype(complex), T)[0][1] > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["irc", "ppf"])
def test_filters_that_are_clearly_slower_need_no_exact_poles_and_do_not_change_the_best(kind, monkeypatch):
    dynamics, found, exact, counts = stage(), [], [], []
    plants = damping_plants(dynamics, T)
    slowest = damping_designs.slowest_poles

    def noted(plant, poles=None):
        if poles is None:
            exact.append(plant)
        return slowest(plant, poles)

    monkeypatch.setattr(damping_designs, "slowest_poles", noted)
    monkeypatch.setattr(damping_designs, "POINTS", {2: 7, 3: 5})
    for clearly in (damping_designs.CLEARLY, np.inf):
        exact.clear()
        monkeypatch.setattr(damping_designs, "CLEARLY", clearly)
        found.append(design_damping(kind, dynamics, T, plants))
        counts.append(len(exact))
    assert found[0] == found[1] and counts[0] < 0.4 * counts[1]
