# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Integral sliding mode and super-twisting: closed forms on known states, finite time, limits, feedforward."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control import kalman, law, sliding_surface, state_feedback
from hysteresis_ros.control.controller import ControllerParameters, controller_block, feedforward_block
from hysteresis_ros.control.laws import integral_sliding_mode, super_twisting
from hysteresis_ros.errors import ParameterError

SAMPLE_TIME = 1.0 / 3000.0
STEP = 2.05e-6
LINEAR_ONLY = {"sliding_mode.eta": 0.0, "sliding_mode.beta": 0.0}
CONSTANT = {"kalman.disturbance": "constant", "kalman.q_disturbance": 0.01}
INTEGRAL = {"type": "integral_sliding_mode"}
TWISTING = {"type": "super_twisting", "super_twisting.gains": "given"}
TWISTING |= {"super_twisting.k1": 0.1, "super_twisting.k2": 0.1}
TYPES = [{"type": "sliding_mode"}, INTEGRAL, TWISTING, TWISTING | {"super_twisting.discretisation": "explicit"}]

# One measured state, which the current form with L = 1 knows exactly: x+ = 0.9 x + 0.1 (u + d), SI units.
KNOWN = {
    "model.dynamics.A": (0.9,),
    "model.dynamics.B": (0.1,),
    "model.dynamics.C": (1.0,),
    "sliding_mode.hyperplane": "given",
    "sliding_mode.S": (1.0,),
    "sliding_mode.phi": 0.8,
    "kalman.form": "current",
    "kalman.gain": "given",
    "kalman.L": (1.0,),
}


class Known:
    """The controller on the plant with one known state; ``run`` returns σ = s / Λ, the command and x of each sample."""

    def __init__(self, changes, limit=1e9):
        self.controller = controller_block(ControllerParameters.from_mapping(KNOWN | changes), SAMPLE_TIME)
        self.place, self.limit = 0.0, limit

    def run(self, reference, disturbance):
        """Return an array, shape (N, 3)."""
        rows = []
        for r, d in zip(reference, disturbance, strict=True):
            u = self.controller.step(r, self.place)
            rows.append((self.controller.x[law.SWITCHING] / 0.1, u, self.place))
            applied = min(max(u, -self.limit), self.limit)
            self.controller.x[law.APPLIED] = applied
            self.place = 0.9 * self.place + 0.1 * (applied + d)
        return np.array(rows)


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, -0.4])
def test_a_constant_matched_disturbance_is_rejected_with_the_rejection_pole(pole):
    """u1_k = -(1 - ρ^k) d from the first sample on, independent of the nominal controller."""
    found = Known(INTEGRAL | {"sliding_mode.rejection_pole": pole}).run(np.zeros(40), np.full(40, 0.7))
    nominal = -(0.9 - 0.8) / 0.1 * found[:, 2]
    k = np.arange(40)
    assert found[:, 1] - nominal == pytest.approx(-0.7 * (1.0 - np.power(pole, k)), abs=1e-12)
    assert found[:, 0] == pytest.approx(0.7 * (1.0 - np.power(pole, k)) / (1.0 - pole), abs=1e-12)
    assert abs(found[-1, 2]) < 0.1


def test_any_disturbance_is_rejected_one_sample_later_with_the_pole_zero():
    disturbance = np.random.default_rng(1).normal(size=100)
    found = Known(INTEGRAL | {"sliding_mode.rejection_pole": 0.0}).run(np.zeros(100), disturbance)
    rejection = found[:, 1] + (0.9 - 0.8) / 0.1 * found[:, 2]
    assert rejection[1:] == pytest.approx(-disturbance[:-1], abs=1e-12)


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_a_step_of_the_reference_never_leaves_the_integral_surface(loop, form):
    axis = loop(INTEGRAL | {"kalman.form": form})
    s = []
    for k in range(300):
        axis.run([STEP if k > 5 else 0.0])
        s.append(axis.controller.x[law.SWITCHING])
    assert np.max(np.abs(s)) < 1e-13
    assert axis.plant.output() == pytest.approx(STEP, rel=1e-6)


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_integral_switching_function_is_driven_by_the_innovation_alone(loop, model, form):
    """s_(k+1) = ρ s_k + S L ε, with noise, a moving reference, limits and an estimated disturbance."""
    changes = INTEGRAL | LINEAR_ONLY | CONSTANT | {"kalman.form": form, "sliding_mode.rejection_pole": 0.6}
    noise = np.random.default_rng(3).normal(scale=5e-9, size=400)
    axis = loop(changes, disturbance=0.2e-6, noise=noise, carry=lambda u: min(max(u, -1.2e-6), 1.2e-6))
    gain = kalman.filter_gain(axis.controller.parameters.kalman, model)[:3]
    driven = float(np.dot((-1.0744, -0.0904, 0.0781), gain))
    s, innovations = [], []
    axis.noise = None
    for k in range(400):
        axis.offset = noise[k]
        axis.run([STEP * np.sin(0.02 * k)])
        s.append(axis.controller.x[law.SWITCHING])
        innovations.append(axis.controller.x[sliding_surface.OBSERVER + kalman.INNOVATION])
    s, innovations = np.array(s), np.array(innovations)
    late = innovations[:-1] if form == "predictor" else innovations[1:]
    assert s[1:] == pytest.approx(0.6 * s[:-1] + driven * late, abs=1e-12)
    assert np.max(np.abs(s)) > 1e-3


@pytest.mark.parametrize("changes", TYPES)
@pytest.mark.parametrize("form", ["predictor", "current"])
def test_with_an_estimated_disturbance_no_law_leaves_an_offset(loop, plant, changes, form):
    axis = loop(changes | CONSTANT | {"kalman.form": form, "sliding_mode.beta": 0.0}, disturbance=-0.3e-6)
    axis.plant = plant({"input_scale": 2.05e-6 / 1.05})
    _, y = axis.run(np.full(4000, STEP))
    # the explicit law oscillates around zero by the step of its sign function, k2 T, times the gain to the output
    tolerance = 5e-9 if changes.get("super_twisting.discretisation") == "explicit" else 1e-14
    assert np.max(np.abs(y[-500:] - STEP)) < tolerance


@pytest.mark.parametrize("disturbance", [0.4, -0.05])
def test_implicit_super_twisting_stops_dead_with_its_integral_at_the_disturbance(disturbance):
    axis = Known(TWISTING | {"super_twisting.k1": 0.2, "super_twisting.k2": 30.0})
    found = axis.run(np.zeros(400), np.full(400, disturbance))
    assert np.max(np.abs(found[-100:, 0])) < 1e-13
    assert axis.controller.x[super_twisting.TWIST] == pytest.approx(-disturbance, abs=1e-13)
    assert np.max(np.abs(np.diff(found[-100:, 1]))) < 1e-13


def test_explicit_super_twisting_circles_and_its_command_chatters_by_the_step_of_its_sign():
    changes = TWISTING | {"super_twisting.k1": 0.2, "super_twisting.k2": 30.0}
    found = Known(changes | {"super_twisting.discretisation": "explicit"}).run(np.zeros(2000), np.full(2000, 0.4))
    step = 30.0 * SAMPLE_TIME
    last = found[-500:]
    assert 0.0 < np.max(np.abs(last[:, 0])) < 5.0 * step
    assert np.max(np.abs(np.diff(last[:, 1]))) > step


@pytest.mark.parametrize("reference", [0.5, 2.0, 20.0])
@pytest.mark.parametrize("k1", [0.1, 0.3])
def test_super_twisting_reaches_the_surface_in_finite_time(reference, k1):
    """Without a disturbance the integral only helps in the approach: √σ falls by about k1/2 per sample."""
    found = Known(TWISTING | {"super_twisting.k1": k1, "super_twisting.k2": 0.3}).run(
        np.full(3000, reference), np.zeros(3000)
    )
    sigma = found[:, 0]
    crossed = np.flatnonzero(np.sign(sigma) != np.sign(sigma[0]))[0]
    bound = 2.0 * np.sqrt(abs(sigma[0])) / k1
    # near the end, backward Euler falls slightly slower than k1/2: by the logarithm of the distance
    assert crossed <= bound + 2.0 * np.log2(2.0 + abs(sigma[0]) / (k1 * k1))
    assert np.max(np.abs(sigma[-100:])) < 1e-12


@pytest.mark.parametrize("discretisation", ["implicit", "explicit"])
def test_gains_from_a_bound_hold_a_disturbance_of_that_rate(discretisation):
    """|σ| stays within a few times the change of the disturbance in one sample, L T."""
    bound, k = 50.0, np.arange(6000)
    frequency = 5.0
    disturbance = bound / (2 * np.pi * frequency) * np.sin(2 * np.pi * frequency * k * SAMPLE_TIME)
    changes = {"type": "super_twisting", "super_twisting.bound": bound}
    axis = Known(changes | {"super_twisting.discretisation": discretisation})
    p = axis.controller.p
    assert p[super_twisting.ROOT_GAIN] == pytest.approx(1.5 * np.sqrt(bound * SAMPLE_TIME))
    assert p[super_twisting.STEP] == pytest.approx(1.1 * bound * SAMPLE_TIME)
    found = axis.run(np.zeros(len(k)), disturbance)
    assert np.max(np.abs(found[1000:, 0])) < 5.0 * bound * SAMPLE_TIME
    assert axis.controller.x[super_twisting.TWIST] == pytest.approx(-disturbance[-1], abs=5.0 * bound * SAMPLE_TIME)


def test_integral_of_super_twisting_holds_at_the_limits():
    reference = np.append(np.full(1500, 2.0), np.full(1500, 0.3))
    settled = {}
    for threshold in (0.1, 1e9):
        axis = Known(TWISTING | {"super_twisting.k2": 3.0, "sliding_mode.anti_windup_threshold": threshold}, limit=1.0)
        found = axis.run(reference, np.zeros(3000))
        settled[threshold] = np.flatnonzero(np.abs(found[1500:, 2] - 0.3) > 0.006)[-1]
    assert settled[0.1] < 150
    assert settled[1e9] > 3 * settled[0.1]


def test_super_twisting_leaves_the_limit_as_it_leaves_any_other_level():
    """A slow law that was saturated for long returns as fast as in an ordinary step from this level."""
    slow = {"type": "super_twisting", "super_twisting.bound": 1.0}
    settled = []
    for level in (0.95, 2.0):
        found = Known(slow, limit=1.0).run(np.append(np.full(20000, level), np.full(6000, 0.3)), np.zeros(26000))
        settled.append(np.flatnonzero(np.abs(found[20000:, 2] - 0.3) > 0.014)[-1])
    assert settled[1] < 1.3 * settled[0]


def test_integral_sliding_mode_takes_no_limit_for_a_disturbance():
    axis = Known(INTEGRAL, limit=1.0)
    found = axis.run(np.append(np.full(500, 2.0), np.full(200, 0.3)), np.zeros(700))
    assert np.max(np.abs(found[:, 0])) < 1e-12
    assert np.flatnonzero(np.abs(found[500:, 2] - 0.3) > 0.006)[-1] < 60


@pytest.fixture
def fed(parameters):
    """Return a function: measured and delayed reference, shape (N,), with feedforward and feedback, from rest."""

    def run(changes, reference, plant):
        entries = {"feedforward.type": "inverse_dynamics", "feedforward.preview": 30} | changes
        controller = controller_block(parameters(entries), SAMPLE_TIME)
        ahead = feedforward_block(parameters(entries), SAMPLE_TIME)
        y, delayed = np.empty(len(reference)), np.empty(len(reference))
        for k, r in enumerate(reference):
            y[k] = plant.output()
            delayed[k] = ahead.step(r)
            controller.x[law.FEEDFORWARD] = ahead.command
            plant.step(controller.step(delayed[k], y[k]))
        return y, delayed

    return run


@pytest.mark.parametrize("changes", TYPES[:3])
@pytest.mark.parametrize("form", ["predictor", "current"])
def test_a_perfect_model_follows_exactly_under_feedforward_with_feedback_on(fed, plant, changes, form):
    moving = np.cumsum(np.random.default_rng(5).normal(scale=2e-8, size=600))
    reference = np.concatenate([np.zeros(10), moving, np.full(60, moving[-1])])
    y, delayed = fed(changes | CONSTANT | {"kalman.form": form}, reference, plant())
    assert np.max(np.abs(y - delayed)) < 1e-9 * np.ptp(reference)


@pytest.mark.parametrize("changes", TYPES[:3])
def test_feedforward_with_a_gain_error_leaves_no_steady_error(fed, plant, changes):
    reference = np.concatenate([np.zeros(10), np.linspace(0.0, STEP, 600), np.full(3000, STEP)])
    y, delayed = fed(changes | CONSTANT, reference, plant({"input_scale": 2.05e-6 / 1.05}))
    assert np.max(np.abs(y - delayed)[-100:]) < 1e-14
    assert np.max(np.abs(y - delayed)) > 1e-10


def test_feedforward_and_feedback_track_better_than_either(fed, plant):
    k = np.arange(1800)
    reference = STEP * (1.0 - np.cos(2 * np.pi * 5 * k * SAMPLE_TIME)) / 2
    wrong = {"input_scale": 2.05e-6 / 1.05}
    left = {}
    for name, changes in (
        ("both", CONSTANT),
        ("feedback", CONSTANT | {"feedforward.type": "none"}),
        ("feedforward", {"type": "open_loop"}),
    ):
        y, delayed = fed(changes, reference, plant(wrong))
        left[name] = np.sqrt(np.mean((y - delayed)[500:] ** 2))
    assert left["both"] < 0.5 * min(left["feedback"], left["feedforward"])


def test_a_static_feedforward_keeps_the_rest_point(fed, plant):
    reference = STEP * np.sign(np.sin(np.arange(300) / 30))
    static, _ = fed({"feedforward.type": "static"}, reference, plant())
    without, _ = fed({"feedforward.type": "none"}, reference, plant())
    assert (static == without).all()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        (INTEGRAL | {"sliding_mode.rejection_pole": 1.0}, "sliding_mode.rejection_pole"),
        (INTEGRAL | {"sliding_mode.rejection_pole": -0.9, "sliding_mode.eta": 0.2}, "sliding_mode.eta"),
        (INTEGRAL | {"sliding_mode.S": (1.0, 2.0)}, "sliding_mode.S"),
        (INTEGRAL | {"sliding_mode.S": (-0.8674, 0.7907, 0.3855)}, "sliding_mode.S"),
        (INTEGRAL | {"sliding_mode.tracking": "integral", "sliding_mode.hyperplane": "lq"}, "sliding_mode.tracking"),
        (TWISTING | {"sliding_mode.tracking": "integral", "sliding_mode.hyperplane": "lq"}, "sliding_mode.tracking"),
        (TWISTING | {"super_twisting.k1": 0.0}, "super_twisting.k1"),
        (TWISTING | {"super_twisting.k2": 0.0}, "super_twisting.k2"),
        ({"type": "super_twisting", "super_twisting.bound": 0.0}, "super_twisting.bound"),
        (TWISTING | {"kalman.L": (5.0, 5.0, 5.0), "kalman.gain": "given"}, "kalman.L"),
        (TWISTING | {"model.dynamics.A": (), "model.dynamics.B": (), "model.dynamics.C": ()}, "model.dynamics.A"),
    ],
)
def test_designs_that_cannot_work_are_refused_by_name(parameters, changes, name):
    with pytest.raises(ParameterError) as caught:
        parameters(changes)
    assert [problem.name for problem in caught.value.problems] == [name]


def test_a_law_that_the_filter_tells_nothing_of_disturbances_is_doubted(parameters):
    for changes in (INTEGRAL, TWISTING):
        assert any("kalman.disturbance" in text for text in parameters(changes).warnings())
        assert not any("kalman.disturbance" in text for text in parameters(changes | CONSTANT).warnings())


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(TYPES),
    st.sampled_from([{}, CONSTANT, {"kalman.disturbance": "ramp"}, {"kalman.disturbance": "periodic"}]),
    st.sampled_from(["none", "inverse_dynamics"]),
    st.lists(st.tuples(*[st.floats()] * 4), min_size=1, max_size=30),
)
def test_any_input_gives_finite_signals(parameters, changes, disturbed, feedforward, samples):
    ahead = {"feedforward.type": feedforward, "feedforward.preview": 5}
    block = controller_block(parameters(changes | disturbed | ahead), SAMPLE_TIME)
    for reference, measured, applied, ahead in samples:
        block.x[law.FEEDFORWARD] = ahead
        assert np.isfinite(block.step(reference, measured))
        block.x[law.APPLIED] = applied
        held = np.delete(block.x, [law.APPLIED, law.FEEDFORWARD])
        assert np.isfinite(held).all()


@pytest.mark.parametrize("changes", TYPES[1:])
def test_restored_state_goes_on_identically(controller, changes):
    reference, measured = np.random.default_rng(3).normal(scale=1e-6, size=(2, 100))
    one, other = controller(changes | CONSTANT), controller(changes | CONSTANT)
    one.simulate(reference, measured)
    other.state = one.state
    assert (other.simulate(reference, measured) == one.simulate(reference, measured)).all()


def test_nominal_state_feedback_is_the_published_gain(parameters, model):
    packed = integral_sliding_mode.packed_integral_sliding_mode(parameters(INTEGRAL))
    first = sliding_surface.GAINS
    assert packed[first : first + 3] == pytest.approx([0.5130, -1.6069, 1.1001], abs=2e-4)
    equivalent = super_twisting.packed_super_twisting(parameters(TWISTING), SAMPLE_TIME)[first : first + 3]
    A, B = model.A, model.B
    poles = np.sort(np.linalg.eigvals(A - B @ equivalent[None]).real)
    assert poles == pytest.approx([-0.700, -0.122, 1.0], abs=1e-3)
    assert state_feedback.spectral_radius(A - B @ packed[first : first + 3][None]) < 1.0
