# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Friction of the slider: closed forms of Coulomb's law, exact sticking, and invariants of any sequence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models import friction
from hysteresis_ros.models.block import COMPILED, interpreted
from hysteresis_ros.models.friction import Slider, SliderParameters, slide

STEP = 1e-4
MASS = 0.05
STIFFNESS = 0.41e6
LONG = 1_000_000 if COMPILED else 20_000  # samples in the tests for drift


def slider(front=(0.0, 0.0), rear=(0.0, 0.0), velocity=0.0, stuck=False, step=STEP, **parameters):
    """Return a slider with friction limits (static, kinetic) [N] of both contacts."""
    given = dict(mass=MASS, minimum=-10.0, maximum=10.0) | parameters
    made = Slider(SliderParameters(**given), step, STIFFNESS)
    made.x[friction.FRONT_STATIC : friction.FRONT_KINETIC + 1] = front
    made.x[friction.REAR_STATIC : friction.REAR_KINETIC + 1] = rear
    made.x[friction.VELOCITY] = velocity
    made.x[[friction.FRONT_STUCK, friction.REAR_STUCK]] = float(stuck)
    return made


@pytest.mark.slow
def test_free_fall():
    """Without a closed clamp the slider falls: q_n = a h² n (n + 1)/2, the implicit sum of a t²/2."""
    falling = slider(external_force=-2.0)
    n = np.arange(1, 501)
    q = falling.simulate(np.zeros(500))
    np.testing.assert_allclose(q, -2.0 / MASS * STEP**2 * n * (n + 1) / 2, rtol=1e-12)
    assert q[-1] == pytest.approx(-2.0 / MASS * (500 * STEP) ** 2 / 2, rel=3e-3)
    assert falling.x[friction.DISSIPATED] == 0.0


@pytest.mark.parametrize("inclination", [0.0, 0.5, -math.pi / 2])
def test_gravity_acts_along_the_travel(inclination):
    given = slider(inclination=inclination, external_force=0.3)
    assert given.p[friction.FORCE] == pytest.approx(0.3 - MASS * 9.80665 * math.sin(inclination))


@pytest.mark.parametrize("side", ["front", "rear"])
def test_stick_limit_is_the_static_force(side):
    """Just below μ_s N nothing ever slides; just above, the slider starts with (F - μ_k N)/m."""
    limits = {side: (6.0, 5.0)}
    holds = slider(**limits, external_force=-5.999)
    holds.settle(0.0)  # the front's spring is loaded already, because a sudden load would cause twice its force
    np.testing.assert_allclose(holds.simulate(np.zeros(2000)), 0.0, atol=1e-18)
    assert holds.x[friction.DISSIPATED] == 0.0
    lets_go = slider(**limits, external_force=-6.001)
    lets_go.settle(0.0)
    lets_go.simulate(np.zeros(3))
    assert lets_go.x[friction.VELOCITY] == pytest.approx(-3 * STEP * (6.001 - 5.0) / MASS, rel=1e-9)


def test_a_sudden_load_swings_to_twice_its_force():
    """On the front clamp 2.9 N hold and 3.1 N slip: the extender is a spring, and the static limit is 6 N."""
    for load, holds in ((2.9, True), (3.1, False)):
        loaded = slider(front=(6.0, 5.0), stuck=True, external_force=-load, step=1e-6)
        loaded.simulate(np.zeros(3000))
        assert (loaded.x[friction.DISSIPATED] == 0.0) == holds


def test_a_load_between_kinetic_and_static_limit_keeps_what_it_finds():
    for velocity, moves in ((0.0, False), (-1e-3, True)):
        tried = slider(rear=(6.0, 5.0), stuck=velocity == 0.0, velocity=velocity, external_force=-5.5)
        q = tried.simulate(np.zeros(100))
        assert (q[-1] != 0.0) == moves


def test_slip_distance_under_kinetic_friction():
    """A body with speed v stops after v²/(2 μ_k N/m), and then stays at rest to the last bit."""
    v, limit = 0.1, 2.5
    sliding = slider(rear=(3.0, limit), velocity=v, step=1e-6)
    q = sliding.simulate(np.zeros(4000))
    assert q[-1] == pytest.approx(v**2 / (2 * limit / MASS), abs=v * 1e-6)
    assert sliding.x[friction.VELOCITY] == 0.0 and np.ptp(q[3000:]) == 0.0
    assert sliding.x[friction.DISSIPATED] == pytest.approx(MASS * v**2 / 2, rel=1e-3)


def test_rear_clamp_holds_without_drift():
    held = slider(rear=(6.0, 5.0), stuck=True, external_force=-5.9, start=1.2345e-3)
    q = held.simulate(1e-6 * np.sin(0.1 * np.arange(LONG)))  # the open extender moves
    assert np.ptp(q) == 0.0 and q[0] == 1.2345e-3


def test_front_clamp_carries_without_drift():
    """A million samples of motion: the distance between slider and tip is constant."""
    carried = slider(front=(6.0, 5.0), stuck=True, external_force=-2.0, start=5e-3)
    carried.settle(0.0)
    grip = carried.x[friction.GRIP]
    carried.simulate(5e-6 * (1.0 - np.cos(2e-3 * np.pi * np.arange(LONG))))
    x = carried.x
    assert x[friction.GRIP] == grip and x[friction.DISSIPATED] == 0.0
    assert x[friction.POSITION] - x[friction.TIP] == pytest.approx(grip, abs=2e-18)
    carried.simulate(np.zeros(3000))
    assert x[friction.TIP] == pytest.approx(-2.0 / STIFFNESS, abs=1e-14)
    assert x[friction.POSITION] == pytest.approx(5e-3, abs=1e-14)


def test_two_closed_clamps_fight_and_the_weaker_slips():
    move = np.linspace(0.0, 50e-6, 2000)
    rear_wins = slider(front=(3.0, 2.5), rear=(6.0, 5.0), stuck=True)
    assert np.ptp(rear_wins.simulate(move)) == 0.0
    assert rear_wins.x[friction.TIP] == pytest.approx(50e-6 - 2.5 / STIFFNESS, rel=1e-12)
    assert rear_wins.x[friction.FRONT_FORCE] == 2.5 and rear_wins.x[friction.REAR_FORCE] == -2.5
    front_wins = slider(front=(6.0, 5.0), rear=(3.0, 2.5), stuck=True)
    q = front_wins.simulate(np.append(move, np.full(2000, 50e-6)))
    assert 50e-6 - 3.0 / STIFFNESS < q[-1] <= 50e-6
    assert front_wins.x[friction.POSITION] == front_wins.x[friction.TIP]


def test_open_front_clamp_leaves_the_extender_alone():
    moved = slider(rear=(6.0, 5.0))
    for u in (1e-6, 7e-6, -3e-6):
        moved.step(u)
        assert moved.x[friction.TIP] == u


def test_end_stops_are_rigid():
    q = slider(external_force=3.0, velocity=0.2, maximum=1e-3).simulate(np.zeros(300))
    assert q.max() == 1e-3 and np.all(q[-200:] == 1e-3)
    stopped = slider(external_force=-3.0, minimum=-1e-3)
    stopped.simulate(np.zeros(2000))
    assert stopped.x[friction.POSITION] == -1e-3 and stopped.x[friction.STOP_FORCE] == pytest.approx(3.0)
    stopped.step(0.0)
    assert stopped.x[friction.VELOCITY] == 0.0


finite = dict(allow_nan=False, allow_infinity=False)
LIMIT = st.sampled_from([0.0, 0.0, 0.5, 4.0]) | st.floats(0.0, 20.0, **finite)
SAMPLE = st.tuples(st.floats(-2e-5, 2e-5, **finite), LIMIT, LIMIT)


@pytest.mark.slow
@given(
    st.lists(SAMPLE, min_size=1, max_size=30),
    st.floats(-10.0, 10.0, **finite),
    st.floats(0.1, 1.0, **finite),
    st.sampled_from([1e-3, 0.05, 10.0]),
    st.sampled_from([1e-5, 1e-4, 1e-2]),
)
def test_no_sequence_breaks_the_laws(samples, force, ratio, mass, step):
    """Force balance, limits, friction against the slip, sticking without motion, travel, and energy."""
    tried = slider(external_force=force, mass=mass, step=step, minimum=-3e-5, maximum=4e-5)
    x = tried.x
    free = 0.0
    for u, front, rear in samples:
        before = x.copy()
        x[friction.FRONT_STATIC : friction.REAR_KINETIC + 1] = front, ratio * front, rear, ratio * rear
        tried.step(u)
        lambda_f, lambda_r, stop = x[[friction.FRONT_FORCE, friction.REAR_FORCE, friction.STOP_FORCE]]
        scale = mass * (abs(x[friction.VELOCITY]) + abs(before[friction.VELOCITY])) / step + 50.0
        inertia = mass * (x[friction.VELOCITY] - before[friction.VELOCITY]) / step
        assert inertia == pytest.approx(force + lambda_f + lambda_r + stop, abs=1e-11 * scale)
        assert abs(lambda_f) <= front and abs(lambda_r) <= rear
        noise = 1e-17 + 4e-16 * abs(lambda_f) / STIFFNESS
        assert lambda_f * x[friction.FRONT_SLIP] <= front * noise
        assert lambda_r * x[friction.REAR_SLIP] <= 0.0
        if x[friction.FRONT_STUCK]:
            moved = x[friction.POSITION] - before[friction.POSITION]
            assert x[friction.FRONT_SLIP] == 0.0
            assert x[friction.TIP] - before[friction.TIP] == pytest.approx(moved, abs=1e-19 + 1e-15 * 4e-5)
        elif front > 0.0:
            assert abs(lambda_f) == ratio * front  # slides: kinetic
        if x[friction.REAR_STUCK]:
            assert x[friction.POSITION] == before[friction.POSITION] and x[friction.VELOCITY] == 0.0
        assert -3e-5 <= x[friction.POSITION] <= 4e-5
        assert (stop <= 1e-9 * scale) if x[friction.POSITION] == 4e-5 else True
        assert (stop >= -1e-9 * scale) if x[friction.POSITION] == -3e-5 else True

        def energy(state):
            return mass * state[friction.VELOCITY] ** 2 / 2 + state[friction.FRONT_FORCE] ** 2 / (2 * STIFFNESS)

        work = force * (x[friction.POSITION] - before[friction.POSITION]) + lambda_f * (u - free)
        lost = x[friction.DISSIPATED] - before[friction.DISSIPATED]
        gained = energy(x) - energy(before)
        assert lost >= -front * noise
        size = abs(work) + energy(x) + energy(before) + scale * 1e-5
        assert gained + lost <= work + 1e-9 * size
        free = u


@pytest.mark.slow
@given(
    st.floats(-0.1, 0.1, **finite),
    st.floats(-2e-5, 2e-5, **finite),
    LIMIT,
    LIMIT,
    st.floats(-10.0, 10.0, **finite),
)
def test_velocity_solves_the_inclusion(velocity, lead, front, rear, force):
    """The closed form, compared with bisection of the monotone function of which it is the zero."""
    p = slider(external_force=force).p
    found = friction.slider_velocity(p, velocity, lead, front, rear)

    def residual(v, sign):
        carried = min(max(STIFFNESS * (lead - STEP * v), -front), front)
        return MASS * (v - velocity) / STEP - force - carried + sign * rear

    scale = 1e-9 * (MASS * abs(velocity) / STEP + abs(force) + front + rear + 1.0)
    if found == 0.0:
        assert residual(0.0, -1.0) <= scale and residual(0.0, 1.0) >= -scale
    else:
        assert abs(residual(found, math.copysign(1.0, found))) <= scale


def test_same_bits_compiled_and_interpreted():
    random = np.random.default_rng(3)
    one, other = (slider(external_force=-1.0, mass=0.02) for _ in range(2))
    for u, front, rear in zip(
        1e-5 * random.random(300), 5 * random.random(300), 5 * random.integers(0, 2, 300), strict=True
    ):
        for made in (one, other):
            made.x[friction.FRONT_STATIC : friction.REAR_KINETIC + 1] = front, 0.8 * front, rear, 0.8 * rear
        one.step(u)
        interpreted(slide)(other.p, other.x, u)
        assert np.array_equal(one.x, other.x)


@pytest.mark.parametrize(
    "wrong, name",
    [
        (dict(mass=0.0), "mass"),
        (dict(minimum=1.0, maximum=-1.0), "minimum"),
        (dict(start=11.0), "start"),
        (dict(inclination=2.0), "inclination"),
        (dict(external_force=math.nan), "external_force"),
    ],
)
def test_wrong_parameters_are_named(wrong, name):
    with pytest.raises(ParameterError, match=rf"^{name} = "):
        slider(**wrong)
