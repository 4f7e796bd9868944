# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""A structure with hysteresis inside: closed forms, superposition, shifting modes, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import dlsim

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.models.structure import Structure, StructureParameters, run_structure

SAMPLE_TIME = 1e-3
RNG = np.random.default_rng(7)
#: Two modes, at 60 and 90 Hz, with about 2 % of damping.
BLOCKS = [
    [[r * np.cos(angle), r * np.sin(angle)], [-r * np.sin(angle), r * np.cos(angle)]]
    for r, angle in ((0.99, 2 * np.pi * 0.06), (0.988, 2 * np.pi * 0.09))
]
B = RNG.standard_normal((4, 2))
C = 1e-6 * RNG.standard_normal((2, 4))
D = 1e-7 * RNG.standard_normal((2, 2))


def flat(matrix) -> tuple[float, ...]:
    return tuple(np.ravel(matrix).tolist())


LINEAR = StructureParameters(
    inputs=2, outputs=2, A=flat(BLOCKS), B=flat(B), C=flat(C), D=flat(D), sample_time=SAMPLE_TIME
)
#: The hysteresis acts where the actuators do, and its input is a hundredth of the first state.
HYSTERETIC = replace(
    LINEAR,
    B_w=flat(0.2 * B),
    C_z=flat(np.linalg.pinv(B) * 0.02),
    input_gains=(1.0, 0.8),
    radii=(0.0, 0.1, 0.3),
    weights=(0.2, 0.3, 0.5, 0.1, 0.2, 0.3),
)


def test_without_plays_it_is_the_linear_system():
    u = RNG.standard_normal((300, 2))
    _, expected, _ = dlsim((LINEAR.linear.A, B, C, D, 1.0), u)
    np.testing.assert_allclose(Structure(LINEAR, SAMPLE_TIME).simulate(u), expected, atol=1e-18)


def test_blocks_and_the_full_matrix_give_the_same_bits():
    u = RNG.standard_normal((200, 2))
    full = replace(HYSTERETIC, A=flat(HYSTERETIC.state_matrix))
    assert len(full.A) == 16
    first, second = (Structure(p, SAMPLE_TIME).simulate(u) for p in (HYSTERETIC, full))
    np.testing.assert_array_equal(first, second)


def test_one_input_and_output_is_the_single_axis():
    """The linear block measures before its input changes; the structure has the same advance and output."""
    single = LinearParameters(
        A=flat(BLOCKS[0]), B=(0.3, 0.1), C=(1.0, 2.0), input_scale=1.0, output_scale=1.0, sample_time=SAMPLE_TIME
    )
    structure = StructureParameters(inputs=1, outputs=1, A=single.A, B=single.B, C=single.C)
    u = RNG.standard_normal(200)
    ahead = LinearDynamics(single, SAMPLE_TIME).simulate(u)
    y = Structure(structure, SAMPLE_TIME).simulate(u[:, None])[:, 0]
    np.testing.assert_array_equal(y[1:], ahead[:-1])


def by_hand(p: StructureParameters, u):
    """The equations of the module in NumPy, implemented for the test."""
    linear, x, plays = p.linear, np.zeros(p.order), np.zeros((p.hystereses, len(p.radii)))
    found = []
    for now in u:
        found.append(linear.C @ x + linear.D @ now)
        driven = np.tile(now, p.hystereses // p.inputs)
        z = (p.gains * driven + p.hysteresis_motion @ x)[:, None]
        plays = np.clip(plays, z - np.array(p.radii), z + np.array(p.radii))
        x = linear.A @ x + linear.B @ now + p.hysteresis_input @ (p.play_weights * plays).sum(axis=1)
    return np.array(found)


#: Each actuator with a second hysteresis, of its joint, that depends on the motion alone.
JOINTED = replace(
    HYSTERETIC,
    B_w=flat(np.hstack([0.2 * B, 0.1 * B])),
    C_z=flat(np.vstack([np.linalg.pinv(B) * 0.02, np.linalg.pinv(B) * 0.03])),
    input_gains=(1.0, 0.8, 0.0, 0.0),
    weights=(*HYSTERETIC.weights, 0.1, 0.2, 0.3, 0.2, 0.1, 0.1),
)


@pytest.mark.parametrize("parameters", [HYSTERETIC, JOINTED])
def test_the_equations_hold_compiled_interpreted_and_step_by_step(parameters):
    u = RNG.standard_normal((250, 2))
    expected = by_hand(parameters, u)
    block = Structure(parameters, SAMPLE_TIME)
    y = block.simulate(u)
    np.testing.assert_allclose(y, expected, atol=1e-12 * np.abs(expected).max())
    plain = np.empty_like(y)
    interpreted(run_structure)(block.p, block.initial_state(), u, plain)
    np.testing.assert_allclose(plain, y, atol=1e-12 * np.abs(y).max())
    block.reset()
    np.testing.assert_array_equal(np.array([block.step(now) for now in u]), y)


def test_a_state_that_is_restored_goes_on_with_the_same_bits():
    u = RNG.standard_normal((100, 2))
    block = Structure(HYSTERETIC, SAMPLE_TIME)
    block.simulate(u)
    kept, after = block.state, block.simulate(u)
    block.state = kept
    np.testing.assert_array_equal(block.simulate(u), after)


def test_small_and_large_motions_have_their_linear_limits():
    """Far below the smallest radius, and far above the largest, the structure is linear with other modes."""
    u = RNG.standard_normal((400, 2))
    p = JOINTED
    for scale, limit, tolerance in ((1e-4, p.small, 1e-12), (1e6, p.large, 1e-4)):
        y = Structure(p, SAMPLE_TIME).simulate(scale * u)
        _, expected, _ = dlsim((limit.A, limit.B, limit.C, limit.D, 1.0), scale * u)
        np.testing.assert_allclose(y, expected, atol=tolerance * np.abs(expected).max())
    small, large = (np.sort(np.abs(np.angle(system.poles)))[::2] for system in (p.small, p.large))
    assert np.all(np.abs(large - small) > 5e-4 * small)


def test_a_rest_point_stays_and_is_where_a_slow_ramp_ends():
    target = np.array([0.7, -0.4])
    block = Structure(HYSTERETIC, SAMPLE_TIME)
    block.settle(target)
    held = block.simulate(np.tile(target, (50, 1)))
    np.testing.assert_allclose(held, np.tile(held[0], (50, 1)), rtol=1e-9)
    ramp = np.linspace(0.0, 1.0, 60000)[:, None] * target
    moving = Structure(HYSTERETIC, SAMPLE_TIME)
    end = moving.simulate(np.concatenate([ramp, np.tile(target, (5000, 1))]))[-1]
    np.testing.assert_allclose(end, held[0], rtol=2e-2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"B": flat(B)[:-1]}, r"B = .*must be n·2 numbers"),
        ({"A": flat(np.eye(3) * 0.5)}, r"A = .*must be 16 numbers, as B has 4 rows, or 8 numbers"),
        ({"C": (1.0,)}, r"C = .*has 1 numbers and must have q·n = 8"),
        ({"weights": (1.0,)}, r"weights = .*must have 6 numbers, or a multiple"),
        ({"radii": (0.0, -0.1, 0.3)}, r"radii = .*must be ≥ 0 V"),
        ({"A": flat(1.02 * np.array(BLOCKS))}, r"A = .*is unstable without hysteresis"),
        ({"C_z": flat(np.linalg.pinv(B) * 5.0)}, r"A = .*is unstable for (small|large) motions"),
        ({"outputs": 17}, r"outputs = 17"),
        ({"B": (*flat(B)[:-1], float("nan"))}, r"B = .*must be finite"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_size(changes, words):
    with pytest.raises(ParameterError, match=words):
        replace(HYSTERETIC, **changes).validated()


def test_another_sample_time_and_another_number_of_inputs_are_refused():
    with pytest.raises(ParameterError, match="set its rate to 1000 Hz"):
        Structure(HYSTERETIC, 2e-3)
    with pytest.raises(ParameterError, match=r"must have shape \(N, 2\)"):
        Structure(HYSTERETIC, SAMPLE_TIME).simulate(np.zeros((5, 3)))
