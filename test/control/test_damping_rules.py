# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Rules for every design of a damping, tested on single filters: margins by the closed form of the loop."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from damping_support import T, controller, stage

from hysteresis_ros.control.controller import ControllerParameters, ModelParameters
from hysteresis_ros.control.damping.inner_loop import KINDS, DampingParameters, damped, modes
from hysteresis_ros.control.damping.inner_loop import inner_loop as loop_of
from hysteresis_ros.control.damping.kind import Mode
from hysteresis_ros.control.laws.pid import PidParameters
from hysteresis_ros.designs import damping as damping_designs
from hysteresis_ros.designs.damping import (
    RESONANCE,
    DampedDesign,
    _margins,
    around_model,
    damping_plants,
    design_damping,
    judge_damping,
    mode_to_damp,
)
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearParameters, StateSpace, zero_order_hold

IRC = KINDS["irc"]


def design_among(monkeypatch, points, dynamics):
    """Return k and feedthrough that a design selects if only these points exist."""

    def boxes(mode):
        return tuple(tuple((value, value, False) for value in point) for point in points)

    def chosen(point, mode):
        return IRC.parameters(k=point[0], feedthrough=point[1])

    monkeypatch.setitem(KINDS, "irc", replace(IRC, ranges=boxes, chosen=chosen))
    monkeypatch.setattr(damping_designs, "POINTS", {2: 1})
    found = design_damping("irc", dynamics, T, damping_plants(dynamics, T))
    return found.irc.k, found.irc.feedthrough


def inner_loop(point, dynamics):
    """Return M_s of 1/(1 − F P) and the smallest damping of its modes, on the model and with the resonance off by 10 %.

    F = k/(s − k D_f) with s = h (z − 1)/(z + 1), h = 2/T; P from the poles of the stage, both as polynomials in z.
    """
    k, feedthrough = point
    h = 2.0 / T
    above, below = k * np.array([1.0, 1.0]), np.array([h - k * feedthrough, -h - k * feedthrough])
    peaks, dampings = [], []
    for plant in damping_plants(dynamics, T):
        system = plant.plant
        under = np.real(np.poly(system.A))
        over = np.real(np.poly(system.A - system.B @ system.C)) - under
        whole = np.polysub(np.polymul(below, under), np.polymul(above, over))
        z = np.exp(1j * np.linspace(1e-5, np.pi, 40001))
        peaks.append(np.max(np.abs(np.polyval(np.polymul(below, under), z) / np.polyval(whole, z))))
        poles = np.roots(whole)
        logarithms = np.log(poles[(poles.imag > 0.0) & (np.abs(poles) > 1e-3)])
        dampings.append(np.min(-logarithms.real / np.abs(logarithms)))
    return max(peaks), min(dampings)


@pytest.mark.slow
def test_an_inner_loop_of_too_large_a_peak_is_not_taken_however_slow_the_law_in_front_of_it(monkeypatch):
    dynamics = stage()
    lively, calm = (440.0, -1.6), (440.0, -2.5)
    assert inner_loop(lively, dynamics)[0] > 2.5 and inner_loop(calm, dynamics)[0] < 1.7
    assert design_among(monkeypatch, [calm, lively], dynamics) == calm
    with pytest.raises(ParameterError, match="no irc damps the resonance at 700 Hz on all plants"):
        design_among(monkeypatch, [lively], dynamics)


@pytest.mark.slow
def test_a_filter_that_leaves_the_mode_nearly_as_it_was_is_none(monkeypatch):
    """The stage has 1 %; 2 % are required on the plant with the least damping."""
    dynamics = stage()
    little, enough = (60.0, -2.5), (132.0, -2.5)
    assert 0.011 < inner_loop(little, dynamics)[1] < 0.019 and 0.0205 < inner_loop(enough, dynamics)[1] < 0.03
    assert design_among(monkeypatch, [little, enough], dynamics) == enough
    with pytest.raises(ParameterError, match="no irc damps the resonance at 700 Hz"):
        design_among(monkeypatch, [little], dynamics)


@pytest.mark.slow
def test_the_fastest_filter_is_left_where_a_slower_one_tolerates_a_sample_of_delay_more(monkeypatch):
    """Without such a filter the fastest one is used."""
    dynamics = stage(delay=0.0, frequency=5000.0)
    fast, slow = (3142.0, -2.5), (31416.0, -6.0)
    assert design_among(monkeypatch, [fast, slow], dynamics) == slow
    assert design_among(monkeypatch, [fast], dynamics) == fast
    # one more sample of delay: only the slower filter is accepted
    late = stage(delay=T, frequency=5000.0)
    with pytest.raises(ParameterError, match="no irc damps the resonance at 5000 Hz"):
        design_among(monkeypatch, [fast], late)


@pytest.mark.slow
def test_a_law_is_slowed_down_where_both_loops_together_would_have_too_large_a_peak(monkeypatch):
    """Its own loop would have M_s = 1.9, and both loops 2.34; two thirds of its gain leave 1.94 for both."""
    filtered = (1400.0, -6.0)
    assert design_among(monkeypatch, [filtered], stage()) == filtered


def test_modes_come_by_their_damping_the_least_damped_first():
    wanted = [(700.0, 0.3), (2000.0, 0.01), (900.0, 0.05)]
    omega = 2.0 * np.pi * np.array([frequency for frequency, _ in wanted])
    zeta = np.array([damping for _, damping in wanted])
    poles = np.exp(T * omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2)))
    found = modes(np.concatenate([poles, poles.conj(), [0.5, 0.0]]), T)
    np.testing.assert_allclose(found, [(2000.0, 0.01), (900.0, 0.05), (700.0, 0.3)], rtol=1e-9)
    # the design damps this mode, whatever its place in the model
    assert mode_to_damp(stage(), T).frequency == pytest.approx(700.0, rel=1e-6)


@pytest.mark.parametrize(("damping", "there"), [(0.65, True), (0.75, False)])
def test_a_mode_that_is_damped_by_itself_needs_no_filter(damping, there):
    """Two poles of 700 Hz, complex below critical damping: the step overshoot is 7 % at 0.65 and 3 % at 0.75."""
    omega = 2.0 * np.pi * 700.0
    A, B = zero_order_hold([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]], [[0.0], [omega**2]], T)
    dynamics = replace(stage(), A=tuple(A.ravel().tolist()), B=tuple(B[:, 0].tolist()))
    if there:
        assert mode_to_damp(dynamics, T).damping == pytest.approx(damping, rel=1e-6)
    else:
        with pytest.raises(ParameterError, match="nothing to damp"):
            mode_to_damp(dynamics, T)


def test_all_resonances_off_to_both_sides_are_judged():
    """Slower and faster by the requested fraction: the frequency of the mode over 1 − part and 1 + part."""
    found = [modes(one.plant.poles.astype(complex), T)[0][0] for one in damping_plants(stage(), T, 0.2)]
    np.testing.assert_allclose(np.sort(found) / 700.0, [1 / 1.2, 1.0, 1 / 0.8], rtol=1e-3)
    assert found[0] == pytest.approx(700.0, rel=1e-6)


@pytest.mark.parametrize("k", [1.0, 2000.0])
def test_a_filter_whose_gain_at_rest_outweighs_the_plant_is_refused(k):
    """γ = 1 − F(1) P(1) is below zero: positive feedback above one, slow or fast."""
    chosen = replace(DampingParameters(), type="irc", irc=IRC.parameters(k=k, feedthrough=-0.9))
    still = LinearParameters(A=(0.5,), B=(0.5,), C=(1.0,), sample_time=T)
    with pytest.raises(ParameterError, match=r"damping\.irc"):
        damped(still, chosen, T)


@pytest.mark.parametrize("gain", [-0.5, 0.0])
def test_a_filter_of_the_command_that_reverses_or_withholds_it_is_refused(monkeypatch, gain):
    """It is stable, as the plant is; an achieved command divided by this gain would be the output of the law."""
    none = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    monkeypatch.setitem(
        KINDS, "notch", replace(KINDS["notch"], filter=lambda given, T: StateSpace(*none, np.array([[gain]])))
    )
    with pytest.raises(ParameterError, match=rf"damping\.notch = .*reverses the sign of the plant \(γ = {gain:g}\)"):
        damped(stage(), replace(DampingParameters(), type="notch"), T)


@pytest.mark.parametrize(("states", "fits"), [(8, True), (9, False)])
def test_a_filter_of_more_states_than_the_loop_has_room_for_is_refused(monkeypatch, states, fits):
    lags = StateSpace(0.5 * np.eye(states), np.ones((states, 1)), np.full((1, states), 0.1), np.eye(1))
    monkeypatch.setitem(KINDS, "notch", replace(KINDS["notch"], filter=lambda given, T: lags))
    chosen = replace(DampingParameters(), type="notch")
    if fits:
        assert chosen.filter(T).order == states
    else:
        with pytest.raises(ParameterError, match=r"damping\.type = 'notch': has 9 states, at most 8 are allowed"):
            chosen.filter(T)


def margins(bandwidth, peak, late, said=()):
    """Return what a design prints of a loop, and the requirements that it does not meet."""
    values = {"gain_margin": 9.0, "delay_margin": late * T, "delay_margin_samples": late, "misses": lambda: said}
    return SimpleNamespace(bandwidth=bandwidth, sensitivity_peak=peak, **values)


def judged(undamped=20.0, **changes):
    """Return a damping judged on the model and on two plants around it, of which each is the worst of something."""
    outer = (margins(100.0, 1.7, 3.0), margins(80.0, 1.8, 3.0), margins(120.0, 1.9, 3.0))
    whole = (margins(90.0, 1.5, 2.0), margins(90.0, 1.75, 1.5), margins(90.0, 1.6, 1.2))
    values = {"inner": whole, "outer": outer, "whole": whole, "resonance": 0.1, "undamped": undamped} | changes
    return DampedDesign(replace(DampingParameters(), type="irc"), (700.0, 0.01), (0.3, 0.2, 0.25), **values)


def test_a_design_prints_the_worst_of_its_plants():
    rows = dict(judged().rows())
    assert rows["resonances ±10 %"] == "bandwidth 80 Hz, M_s 1.900, of both 1.750, delay margin 1.2 samples"
    assert rows["damping reached"] == "0.3; resonances ±10 %: 0.2"
    assert rows["bandwidth without damping"] == "20 Hz; with damping 5 times this bandwidth"
    assert judged(None).times == np.inf and "bandwidth without damping" not in dict(judged(None).rows())


def test_margins_that_do_not_exist_are_infinite_and_others_have_their_units():
    found = margins(100.0, 1.7, 3.0)
    assert _margins(found) == f"M_s 1.700, gain margin 9.0 dB, delay margin 3 samples, {3e3 * T:.4g} ms"
    found.gain_margin = found.delay_margin = np.inf
    assert _margins(found) == "M_s 1.700, gain margin infinite, delay margin infinite"


def test_a_search_of_irc_has_feedback_of_both_signs_and_leaves_a_gain_margin():
    """At rest the filter has the gain f/G of a plant of gain G; a loop of f < 0.5 has more than 6 dB."""
    mode = Mode(500.0, 0.01, 2.0, 0.0)
    (low, high, _), (most, least, _) = (feedback for feedback, _ in IRC.ranges(mode))
    assert 0.0 < low < high < 0.5 and most < least < 0.0
    for feedback, (slow, fast, _) in IRC.ranges(mode):
        assert 0.0 < slow < 2.0 * np.pi * mode.frequency < fast
        for place in feedback[:2]:
            found = IRC.filter(IRC.chosen((place, slow), mode), T)
            assert found.stable and found.dc_gain * mode.gain == pytest.approx(place, rel=1e-2)


def corners(box):
    """Return the middle and all corners of a box of a search."""
    low, high = np.array([(one, other) for one, other, _ in box]).T
    return [np.sign(low) * np.sqrt(low * high), *itertools.product(*zip(low, high, strict=True))]


def test_points_of_a_search_are_filters_relative_to_the_mode_and_its_gains():
    """By the closed forms, for a mode of 500 Hz with 2 m/m and 3 MN/m; the feedback at rest leaves 6 dB."""
    mode = Mode(500.0, 0.01, 2.0, 3e6)
    signs = {}
    for kind in ("ppf", "iff", "notch"):
        boxes = KINDS[kind].ranges(mode)
        signs[kind] = [np.sign(one[0][0]) for one in boxes]
        for box, point in [(one, point) for one in boxes for point in corners(one)]:
            found = KINDS[kind].filter(KINDS[kind].chosen(point, mode), T)
            if kind == "ppf":
                gain, frequency, damping = point
                assert box[1][0] < mode.frequency < box[1][1] and gain < 0.5
                assert found.dc_gain * mode.gain == pytest.approx(gain, rel=1e-3)
                expected = gain / mode.gain / (2j * damping)
            elif kind == "iff":
                gain, corner = point
                assert box[1][0] < 1.0 < box[1][1]
                frequency, expected = mode.frequency, -1j * gain / (1j + corner) ** 2 / mode.force
                assert abs(found.dc_gain) < 1e-9 * abs(expected), "a force at rest has no effect"
            else:
                frequency, damping, width = point
                assert box[0][0] < mode.frequency < box[0][1] and box[1][0] <= mode.damping
                assert found.dc_gain == pytest.approx(1.0, rel=1e-9)
                expected = damping / width
            reached = found.response(np.exp(2j * np.pi * np.array([frequency]) * T))[0, 0, 0]
            assert reached == pytest.approx(expected, rel=2e-2), (kind, point)
    # feedback with the opposite sign damps where the delay is long; a notch has no sign
    assert signs == {"ppf": [1.0, -1.0], "iff": [1.0, -1.0], "notch": [1.0]}


@pytest.mark.parametrize(("kind", "beside", "most"), [("notch", "width", 4), ("ppf", "gains", 2)])
def test_a_chain_of_filters_has_its_largest_number(kind, beside, most):
    def given(count):
        values = {"frequencies": (700.0,) * count, "damping": (0.1,) * count, beside: (0.1,) * count}
        return [problem.name for problem in KINDS[kind].parameters(**values).check()]

    assert given(most) == [] and given(0) == given(most + 1) == ["frequencies"]


def test_a_damping_of_little_use_is_warned_of_and_another_is_not():
    much, alone, little = (judged(undamped).doubts() for undamped in (20.0, None, 90.0))
    assert much == () == alone and len(little) == 1
    assert "irc is of little use here: the bandwidth is 1.11 times" in little[0]


@pytest.mark.parametrize("place", [0, 2])
@pytest.mark.parametrize(("which", "words"), [("outer", "of the law's loop"), ("whole", "of both loops")])
def test_what_a_loop_does_not_meet_is_said_with_its_loop_and_plant(place, which, words):
    loops = [margins(100.0, 1.5, 3.0) for _ in range(3)]
    loops[place] = margins(100.0, 2.5, 3.0, ("M_s 2.5 is above 2",))
    where = " with resonances off by 10 %" if place else ""
    assert judged(**{which: tuple(loops)}).misses() == (f"M_s 2.5 is above 2 {words}{where}",)
    assert judged().misses() == ()


def test_plants_around_the_model_are_as_far_from_it_as_was_asked():
    control = ControllerParameters(model=ModelParameters(dynamics=stage()))
    for robust, part in ((None, RESONANCE), (SimpleNamespace(resonance=0.2), 0.2)):
        found = around_model(control, T, SimpleNamespace(robust=robust, damping="irc"))
        assert found.resonance == part
        turns = [modes(one.plant.poles.astype(complex), T)[0][0] for one in found.plants]
        np.testing.assert_allclose(np.sort(turns) / 700.0, [1 / (1 + part), 1.0, 1 / (1 - part)], rtol=1e-3)


@pytest.mark.slow
def test_the_loops_of_a_damping_are_cut_where_their_names_say():
    """1 - F P of the inner loop, 1 + C γ P/(1 - F P) of the law's loop, 1 + (γ C - F) P of both, on each plant."""
    control = replace(controller("irc"), type="pid", pid=PidParameters(Kp=0.1, Ki=200.0))
    around = around_model(control, T, SimpleNamespace(robust=None, damping=None))
    found = judge_damping(control, T, around, None)
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 20001))
    loop = loop_of(control.damping, control.model.dynamics, T)
    F = loop.filter.response(z)[:, 0, 0]
    # the gain is that of the model, in volts per micrometre
    C = (0.1 + 200.0 * T * 0.5 * (z + 1.0) / (z - 1.0)) * control.model.dynamics.resolved_input_scale / 1e-6
    for number, one in enumerate(around.plants):
        P = one.plant.response(z)[:, 0, 0]
        differences = {
            "inner": 1.0 - F * P,
            "outer": 1.0 + C * loop.forward * P / (1.0 - F * P),
            "whole": 1.0 + (loop.forward * C - F) * P,
        }
        for name, difference in differences.items():
            peak = getattr(found, name)[number].sensitivity_peak
            assert peak == pytest.approx(np.max(1.0 / np.abs(difference)), rel=2e-3), name
