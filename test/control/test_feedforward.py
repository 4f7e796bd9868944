# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward: a model driven by its inverse dynamics follows the reference, as far as the preview allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from hysteresis_ros.control.controller import ControllerParameters, feedforward_block
from hysteresis_ros.control.feedforward import (
    designed_preview,
    inverse_filter,
    mean_delay,
    preview_warning,
    relative_degree,
    sufficient_preview,
)
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

KIM = LinearParameters(
    A=(0.5856, 1.3305, -0.9172, -1.3085, 0.0475, -0.1471, -0.7609, 0.0803, -0.0809),
    B=(-0.7318, -0.3533, 0.2288),
    C=(-0.8674, 0.7907, 0.3855),
    output_scale=1e-6,
)
LAG = LinearParameters(A=(0.686131723,), B=(0.313868277,), C=(1.0,), output_scale=1e-6)


def second_order(poles, zero, lead=1.0):
    """Return lead (z - zero) / ((z - poles[0]) (z - poles[1])) in controllable form."""
    a1, a2 = -(poles[0] + poles[1]).real, (poles[0] * poles[1]).real
    return LinearParameters(A=(0.0, 1.0, -a2, -a1), B=(0.0, 1.0), C=(-lead * zero, lead), output_scale=1e-6)


def parameters(dynamics, preview, kind="inverse_dynamics"):
    """Return open-loop control with this feedforward."""
    values = {f"model.dynamics.{name}": value for name, value in dynamics.to_mapping().items()}
    return ControllerParameters.from_mapping(values | {"feedforward.type": kind, "feedforward.preview": preview})


def motion(samples, seed=1):
    """Return a reference that rests, then moves without smoothness, then rests [m]."""
    moving = np.random.default_rng(seed).uniform(0.0, 1e-5, samples)
    return np.concatenate([np.full(20, moving[0]), moving, np.full(60, moving[-1])])


def followed(dynamics, preview, reference, kind="inverse_dynamics"):
    """Return the delayed references, shape (K,), and the model's outputs at the same samples, from rest."""
    block = feedforward_block(parameters(dynamics, preview, kind), 1e-3)
    model = LinearDynamics(dynamics, 1e-3)
    delayed, outputs = np.empty(len(reference)), np.empty(len(reference))
    for k, r in enumerate(reference):
        delayed[k] = block.step(r)
        if k == 0:
            model.settle(block.command)
        outputs[k] = model.output()
        model.step(block.command)
    return delayed, outputs


def commands_of(found, reference):
    """Return the commands u(0) … u(K-1) [m] of an inverse filter from rest; the reference stays at its last value."""
    last = found.first + max(len(found.weights), 1) - 1
    ahead = np.concatenate([reference, np.full(last, reference[-1])])
    state, commands = found.rest * reference[0], np.empty(len(reference))
    for k in range(len(reference)):
        commands[k] = found.weights @ ahead[k + found.first : k + last + 1] + found.C @ state
        state = found.A @ state + found.B * ahead[k + found.first]
    return commands


@pytest.mark.parametrize(
    ("dynamics", "preview"),
    [
        (KIM, 30),
        (LAG, 1),
        (LAG, 7),
        (second_order((0.9, 0.7), 0.5), 1),
        (second_order((0.9, 0.7), -0.8), 3),
        (second_order((0.6 + 0.7j, 0.6 - 0.7j), 1.4, -1.0), 120),
        (LinearParameters(), 1),
        (LinearParameters(A=(0.0, 1.0, -0.72, 1.7), B=(0.0, 1.0), C=(1.0, 0.0), output_scale=1e-6), 2),
        (LinearParameters(A=(0.7,), B=(0.3,), C=(0.9,), D=(0.1,), output_scale=1e-6), 1),
    ],
)
def test_with_enough_preview_the_model_is_at_the_reference_at_every_sample(dynamics, preview):
    delayed, outputs = followed(dynamics, preview, motion(300))
    assert np.max(np.abs(outputs - delayed)) < 1e-9 * 1e-5


def test_the_delayed_reference_is_the_reference_before_preview_samples_and_begins_at_rest():
    reference = motion(50)
    for kind in ("none", "static", "velocity", "inverse_dynamics"):
        delayed, _ = followed(LAG, 5, reference, kind)
        assert np.array_equal(delayed[5:], reference[:-5])
        assert np.all(delayed[:5] == reference[0])


#: Lag of one sample in five and 2.3 samples of delay; a mode; an input that also acts at once.
LATE = replace(LAG, A=(0.8,), B=(0.2,), delay=2.3e-3, sample_time=1e-3)
MODE = LinearParameters(A=(0.0, 1.0, -0.9, 1.5), B=(0.0, 1.0), C=(0.4, 0.0), output_scale=1e-6)
DIRECT = LinearParameters(A=(0.7,), B=(0.3,), C=(0.9,), D=(0.1,), output_scale=1e-6)


@pytest.mark.parametrize(
    ("dynamics", "delay"),
    [
        (LinearParameters(), 1.0),
        (LATE, 5.0 + 2.3),  # 1/(1 - 0.8) samples of a lag
        (MODE, 2.0 + (1.5 - 2.0 * 0.9) / 0.4),  # of 0.4 z⁻²/(1 - 1.5 z⁻¹ + 0.9 z⁻²)
        (DIRECT, 0.9 / (1.0 - 0.7) + 0.1),
        (KIM, None),
    ],
)
def test_velocity_feedforward_follows_ramps_exactly_and_sines_to_second_order(dynamics, delay):
    tau = mean_delay(dynamics)
    assert delay is None or tau == pytest.approx(delay, rel=1e-9)
    ramp = 1e-9 * np.maximum(np.arange(3000) - 500, 0)
    _, outputs = followed(dynamics, 0, ramp, "velocity")
    assert outputs[-1] == pytest.approx(ramp[-1], rel=2e-6)  # the DC gain of KIM is known to six digits
    # the error of a sine falls with the square of its frequency; with a static feedforward it is ω τ
    largest = {}
    for kind in ("velocity", "static"):
        for turn in (0.002, 0.004):
            sine = 1e-6 * np.sin(turn * np.arange(6000))
            _, outputs = followed(dynamics, 0, sine, kind)
            largest[kind, turn] = np.max(np.abs(outputs - sine)[3000:]) / 1e-6
    assert largest["static", 0.002] == pytest.approx(0.002 * abs(tau), rel=0.02)
    assert largest["velocity", 0.004] == pytest.approx(4.0 * largest["velocity", 0.002], rel=0.05)
    assert largest["velocity", 0.004] < 0.1 * largest["static", 0.004]


def test_kims_sampling_zeros_are_the_published_realisations():
    zeros = np.sort(inverse_filter(KIM, 5).zeros.real)
    assert zeros == pytest.approx([-3.09, -0.59], abs=0.005)
    assert relative_degree(KIM) == 1


def test_the_error_dies_out_as_the_outside_zero_to_the_power_of_the_preview():
    errors = [inverse_filter(KIM, preview).error for preview in (3, 4, 5)]
    assert errors[0] / errors[1] == pytest.approx(3.09, abs=0.005) == errors[1] / errors[2]
    enough = sufficient_preview(KIM)
    assert inverse_filter(KIM, enough).error <= 1e-3 < inverse_filter(KIM, enough - 1).error


def test_no_reference_makes_the_command_wrong_by_more_than_the_stated_error():
    exact, cut = inverse_filter(KIM, 60), inverse_filter(KIM, 3)
    reference = motion(2000)
    wrong = np.max(np.abs(commands_of(exact, reference) - commands_of(cut, reference)))
    assert 0.3 * cut.error * 1e-5 < wrong <= cut.error * 1e-5


def test_the_filter_and_the_kernel_give_the_same_commands():
    reference = motion(100)
    block = feedforward_block(parameters(KIM, 6), 1e-3)
    commands = []
    for r in reference:
        block.step(r)
        commands.append(block.command)
    assert np.allclose(commands[6:], commands_of(inverse_filter(KIM, 6), reference)[:-6], rtol=0.0, atol=1e-19)


def test_preview_shorter_than_the_relative_degree_is_named_with_the_one_needed():
    with pytest.raises(ParameterError, match=r"feedforward\.preview = 0: must be at least 1.*need \d"):
        parameters(KIM, 0)
    slow = LinearParameters(A=(0.0, 1.0, -0.72, 1.7), B=(0.0, 1.0), C=(1.0, 0.0))
    with pytest.raises(ParameterError, match=r"feedforward\.preview = 1: must be at least 2"):
        parameters(slow, 1)


def pair(size, angle):
    return [size * np.exp(1j * angle), size * np.exp(-1j * angle)]


def test_zeros_on_the_unit_circle_are_named_where_a_reference_needs_them():
    with pytest.raises(ParameterError, match=r"zeros on the unit circle \(0\.5403"):
        parameters(realised(pair(1.0, 1.0), [*pair(0.9, 0.9), 0.6]), 50)


@pytest.mark.parametrize("samples", [0.0, 1.4])
@pytest.mark.parametrize(
    "zeros",
    [
        pair(1.003, 2.3),
        [*pair(1.0, 1.5), -2.0, 0.4],
        [*pair(1.1, 2.3), *pair(0.99, 2.9)],
        [*pair(1.004, 2.0), *pair(1.02, 2.4)],
        [-1.0],
        [-0.995],
        [-0.96, 0.9],
    ],
    ids=["beside", "on, and one farther out", "and inside", "two pairs", "half", "within half", "and a slow one"],
)
def test_zeros_beside_the_circle_are_left_out_without_phase_error(zeros, samples):
    """f = g g* p: one at rest, zero phase, within one per cent in the stated band, zero at the zeros."""
    resonances = [*pair(0.9, 0.9), *pair(0.97, 2.2), 0.6]
    poles = {1: [0.9, 0.6], 2: [*pair(0.9, 0.9), 0.6]}.get(len(zeros), resonances)
    dynamics = replace(realised(zeros, poles), sample_time=1e-3, delay=samples * 1e-3)
    preview = designed_preview(dynamics)
    found = inverse_filter(dynamics, preview)
    assert preview <= (40 if -2.0 in zeros else 20) and found.left_out is not None
    delayed, outputs = followed(dynamics, preview, np.linspace(0.0, 1e-5, 300).clip(0.0, 5e-6))
    assert abs(outputs[-1] - 5e-6) < 1e-9 * 5e-6
    highest = found.left_out.known_to
    for cycles in (0.25 * highest, 0.9 * highest):
        reference = 1e-5 * np.sin(2.0 * np.pi * cycles * np.arange(900))
        delayed, outputs = (values[400:] for values in followed(dynamics, preview, reference))
        missing = 1.0 - (outputs @ delayed) / (delayed @ delayed)
        # a fractional delay has an additional error
        own = (4.0 * (samples % 1.0) * (1.0 - samples % 1.0) * np.sin(np.pi * cycles) ** 2) ** 4
        assert abs(missing) < 0.011 + own
        assert np.std(outputs - delayed * (1.0 - missing)) < 2e-4 * np.std(delayed)


@pytest.mark.parametrize("zeros", [pair(1.003, 2.3), pair(0.99, 2.3), [-0.995, 0.0]], ids=["outside", "inside", "real"])
def test_a_command_does_not_ring_at_zeros_that_are_left_out(zeros):
    """Once the reference is at rest, so is the command, except for modes of the rest; this plant has no other modes."""
    dynamics = replace(realised(zeros, [*pair(0.9, 0.9), 0.6]), sample_time=1e-3)
    preview = designed_preview(dynamics)
    block = feedforward_block(parameters(dynamics, preview), 1e-3)
    commands = []
    for r in np.repeat([0.0, 1e-5], [100, 300]):
        block.step(r)
        commands.append(block.command)
    assert np.max(np.abs(np.array(commands[:99]))) < 1e-15
    assert np.max(np.abs(np.array(commands[100 + 2 * preview :]) - 1e-5)) < 1e-15
    assert np.max(np.abs(commands)) < 20e-5


def test_a_mode_above_the_rate_of_the_reference_does_not_swing_between_the_samples():
    """A held mode with 1.5 % damping has a zero at -0.986: its inverse alternates for hundreds of samples."""
    mode = ([[0.0, 1.0], [-1.0, -0.03]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    A, B, C, _, _ = cont2discrete([np.array(matrix) for matrix in mode], 1.32)
    values = {"A": tuple(A.ravel()), "B": tuple(B.ravel()), "C": tuple(C.ravel())}
    dynamics = LinearParameters(**values, output_scale=1e-6, sample_time=1e-3)
    assert np.min(np.abs(inverse_filter(dynamics, 30).zeros + 0.986)) < 1e-3
    block = feedforward_block(parameters(dynamics, 30), 1e-3)
    ramp = np.concatenate([np.zeros(50), 1e-7 * np.arange(200.0)])
    commands = []
    for r in ramp:
        block.step(r)
        commands.append(block.command)
    alternating = np.diff(commands, 2)[120:] * (-1.0) ** np.arange(len(ramp) - 122)
    assert np.max(np.abs(alternating)) < 1e-4 * 1e-7


def test_a_zero_that_a_slower_one_hides_is_inverted():
    """Terms of the inverse are distinguished by size: a large slow term is kept, and so is a smaller fast one."""
    dynamics = replace(realised([-0.9, 0.97], [*pair(0.9, 0.9), 0.6]), sample_time=1e-3)
    assert inverse_filter(dynamics, 3).left_out is None


def test_what_is_left_out_is_said_and_what_cannot_be_is_refused():
    dynamics = replace(realised(pair(1.003, 2.3), [*pair(0.9, 0.9), 0.6]), sample_time=1e-3)
    preview = designed_preview(dynamics)
    (text,) = preview_warning(dynamics, preview)
    assert "366.1 Hz) are not inverted" in text and "the error of the command is below 1 % up to 5" in text
    with pytest.raises(ParameterError, match=r"must be at least 13: .*next to the unit circle needs 12 more"):
        inverse_filter(dynamics, 10)
    slow = realised(pair(1.003, 0.5), [*pair(0.9, 0.9), 0.6])
    assert inverse_filter(slow, 30).left_out is None
    with pytest.raises(ParameterError, match=r"needs \d+ samples of preview, more than 64"):
        designed_preview(slow)


def test_what_a_short_preview_leaves_is_a_warning_and_a_long_one_none():
    assert preview_warning(KIM, sufficient_preview(KIM)) == () == parameters(KIM, 20).warnings()
    (text,) = parameters(KIM, 2).warnings()
    assert "feedforward.preview = 2" in text and f"preview {sufficient_preview(KIM)} brings" in text
    assert parameters(KIM, 2, "static").warnings() == ()


def test_without_dynamics_the_inverse_is_the_identity():
    reference = motion(30)
    for preview in (0, 1, 4):
        block = feedforward_block(parameters(LinearParameters(), preview), 1e-3)
        commands = []
        for r in reference:
            block.step(r)
            commands.append(block.command)
        late = max(preview - 1, 0)
        assert np.array_equal(commands[late:], reference[: len(reference) - late])


def test_new_gains_do_not_move_a_command_at_rest_and_the_same_ones_change_nothing():
    block = feedforward_block(parameters(KIM, 8), 1e-3)
    for r in motion(100):
        block.step(r)
    twin = feedforward_block(parameters(KIM, 8), 1e-3)
    twin.state = block.state
    twin.retune(parameters(KIM, 8))
    assert np.array_equal(twin.state, block.state) and np.array_equal(twin.p, block.p)
    rest = block.command
    other = LinearParameters(A=tuple(0.99 * np.array(KIM.A)), B=KIM.B, C=KIM.C, output_scale=1e-6)
    block.retune(parameters(other, 8))
    outputs = []
    for _ in range(200):
        block.step(motion(100)[-1])
        outputs.append(block.command)
    assert np.max(np.abs(np.array(outputs) - rest)) < 1e-9 * abs(rest)


def test_structure_cannot_change_live():
    block = feedforward_block(parameters(KIM, 8), 1e-3)
    before = block.p.copy()
    for changed, name in (
        (parameters(KIM, 9), "preview"),
        (parameters(KIM, 8, "static"), "type"),
        (parameters(LAG, 8), "model.dynamics.A"),
    ):
        with pytest.raises(ParameterError, match=name):
            block.retune(changed)
    assert np.array_equal(block.p, before)


inside = st.floats(-0.9, 0.9)
angle = st.floats(0.1, 3.0)
#: No zero is near enough to -1 to be left out.
zero = st.one_of(st.floats(-0.86, 0.9), st.floats(1.3, 20.0), st.floats(-20.0, -1.3))


@st.composite
def models(draw):
    """Draw a stable model of order 1 to 4 with any zeros away from the circle, in coordinates of any kind."""
    poles = []
    for _ in range(draw(st.integers(0, 1))):
        radius, phase = draw(st.floats(0.1, 0.9)), draw(angle)
        poles += [radius * np.exp(1j * phase), radius * np.exp(-1j * phase)]
    poles += draw(st.lists(inside, min_size=0 if poles else 1, max_size=2))
    return realised(draw(st.lists(zero, max_size=len(poles) - 1)), poles)


def realised(zeros, poles):
    """Return dynamics with these zeros and poles, in coordinates that show none of them."""
    from scipy.signal import zpk2ss

    A, B, C, _ = zpk2ss(zeros, poles, 1.0)
    gain = float((C @ np.linalg.solve(np.eye(len(A)) - A, B))[0, 0])
    mix = np.eye(len(A)) + 0.3 * np.tri(len(A), k=-1)
    A, B, C = mix @ A @ np.linalg.inv(mix), mix @ B, C @ np.linalg.inv(mix) / gain
    return LinearParameters(A=tuple(A.ravel()), B=tuple(B.ravel()), C=tuple(C.ravel()), output_scale=1e-6)


@pytest.mark.parametrize("samples", [2.0, 0.25, 1.5, 0.9])
@pytest.mark.parametrize("dynamics", [LAG, LinearParameters()], ids=["lag", "nothing"])
def test_a_delay_is_taken_back_also_by_parts_of_a_sample(dynamics, samples):
    """Whole samples exactly; for a fraction f the amplitude error is (4 f (1 - f) sin²(ω/2))⁴, without phase error."""
    late, part = replace(dynamics, sample_time=1e-3, delay=samples * 1e-3), samples % 1.0
    preview = sufficient_preview(late)
    assert preview == relative_degree(late) + (4 if part else 0) == 1 + int(samples) + (4 if part else 0)
    for cycles in (1.0 / 20.0, 1.0 / 6.0):
        reference = 1e-5 * np.sin(2.0 * np.pi * cycles * np.arange(400))
        delayed, outputs = followed(late, preview, reference)
        missed = (4.0 * part * (1.0 - part) * np.sin(np.pi * cycles) ** 2) ** 4
        assert outputs[200:] == pytest.approx((1.0 - missed) * delayed[200:], abs=1e-8 * 1e-5)
    with pytest.raises(ParameterError, match=f"must be at least {preview}"):
        inverse_filter(late, preview - 1)


def test_a_reference_at_rest_is_held_under_half_a_sample_of_delay():
    late = replace(LAG, sample_time=1e-3, delay=0.5e-3)
    delayed, outputs = followed(late, sufficient_preview(late), np.full(30, 2e-6))
    assert delayed == pytest.approx(np.full(30, 2e-6)) and outputs == pytest.approx(np.full(30, 2e-6), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(models())
def test_any_stable_model_is_followed_exactly_with_enough_preview(dynamics):
    preview = sufficient_preview(dynamics, 1e-14)
    delayed, outputs = followed(dynamics, preview, motion(100))
    assert np.max(np.abs(outputs - delayed)) < 1e-8 * 1e-5


def test_modes_that_coincide_at_zero_cost_no_digits():
    """Besides a zero outside the circle, three modes of the inverse are at 0."""
    dynamics = realised([-2.0, 0.0], [0.3125 * np.exp(0.25j), 0.3125 * np.exp(-0.25j), 0.5, 0.5])
    chosen = inverse_filter(dynamics, relative_degree(dynamics))
    assert commands_of(chosen, np.full(50, 3e-6)) == pytest.approx(np.full(50, 3e-6), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(models(), st.integers(0, 30))
def test_a_command_for_a_reference_at_rest_holds_it_at_any_preview(dynamics, more):
    preview = relative_degree(dynamics) + more
    chosen = inverse_filter(dynamics, preview)
    # zeros that nearly coincide cost digits: up to 1e-8 in 4000 drawn models
    assert commands_of(chosen, np.full(50, 3e-6)) == pytest.approx(np.full(50, 3e-6), rel=1e-6)
