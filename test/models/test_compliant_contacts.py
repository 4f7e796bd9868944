# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Contacts that deform before they slide and push as they close, and a step independent of the sample rate."""

from __future__ import annotations

from dataclasses import replace

import inchworm_support as inchworm
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models import friction
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.models.friction import Contacts, Slider, SliderParameters, slide_elastically
from hysteresis_ros.models.inchworm import Inchworm

STEP, MASS, STIFFNESS = 1e-4, 0.05, 0.41e6
COMPLIANCE = 2e-8


def slider(front=(0.0, 0.0), rear=(0.0, 0.0), contacts=None, step=STEP, **parameters):
    """Return a slider at rest between contacts with friction limits (static, kinetic) [N]."""
    contacts = contacts or Contacts(COMPLIANCE, COMPLIANCE)
    given = dict(mass=MASS, minimum=-1.0, maximum=1.0) | parameters
    made = Slider(SliderParameters(**given), step, STIFFNESS, contacts)
    made.x[friction.FRONT_STATIC : friction.REAR_KINETIC + 1] = (*front, *rear)
    made.settle(0.0)
    return made


def forces(random, count):
    """Return free displacements and friction limits of both contacts, shape (count, 3), which sometimes open."""
    walk = np.cumsum(random.normal(0.0, 3e-7, count))
    limits = 6.0 * random.random((count // 50 + 1, 2)) * (random.random((count // 50 + 1, 2)) > 0.3)
    return np.column_stack([walk, np.repeat(limits, 50, axis=0)[:count]])


def walk(made, table, kernel=None):
    """Return the positions for such a table."""
    found = []
    for u, front, rear in table:
        made.x[friction.FRONT_STATIC : friction.REAR_KINETIC + 1] = front, 0.8 * front, rear, 0.8 * rear
        found.append((kernel or made.kernel)(made.p, made.x, u))
    return np.array(found)


@pytest.mark.slow
def test_stiff_contacts_do_what_rigid_ones_do():
    table = forces(np.random.default_rng(2), 1500)
    table[:, 1:] = np.maximum(table[:, 1:], 2.0)  # rigid limits change at once, the others within the sample
    table[:, 1:] = table[0, 1:]
    stiff = slider(contacts=Contacts(1e-14, 1e-14), external_force=-1.0)
    rigid = Slider(SliderParameters(mass=MASS, minimum=-1.0, maximum=1.0, external_force=-1.0), STEP, STIFFNESS)
    for made in (stiff, rigid):
        made.x[friction.FRONT_STATIC : friction.REAR_KINETIC + 1] = 2.0, 1.6, 0.7, 0.56
        made.settle(0.0)
    one, other = (np.array([made.step(u) for u in 5.0 * table[:, 0]]) for made in (stiff, rigid))
    assert np.ptp(other) > 5e-6 and rigid.x[friction.DISSIPATED] > 0.0
    np.testing.assert_allclose(one, other, atol=1e-11)
    assert stiff.x[friction.DISSIPATED] == pytest.approx(rigid.x[friction.DISSIPATED], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("load", [1.0, -2.5])
@pytest.mark.parametrize("side", ["front", "rear"])
def test_a_contact_gives_way_by_its_compliance_and_comes_back(side, load):
    made = slider(**{side: (6.0, 5.0)}, damping=0.3)
    soft = COMPLIANCE + (1.0 / STIFFNESS if side == "front" else 0.0)
    for force in (load, 0.0):
        made.p[friction.FORCE] = force
        assert made.simulate(np.zeros(3000))[-1] == pytest.approx(force * soft, abs=1e-13)
    assert made.x[friction.DISSIPATED] == 0.0


@pytest.mark.parametrize("damping", [0.02, 0.1])
@pytest.mark.parametrize("side", ["front", "rear"])
def test_a_disturbed_slider_rings_down_as_its_damping_says(side, damping):
    """m q'' + 2 ζ ω m q' + k q = 0: the peaks decay by exp(−ζ ω T), ω √(1 − ζ²) T = 2π."""
    made = slider(**{side: (6.0, 5.0)}, damping=damping, step=1e-7)
    stiffness = 1.0 / (COMPLIANCE + (1.0 / STIFFNESS if side == "front" else 0.0))
    omega = np.sqrt(stiffness / MASS)
    made.x[friction.VELOCITY] = 1e-3
    period = 2 * np.pi / (omega * np.sqrt(1.0 - damping**2))
    q = made.simulate(np.zeros(round(3.0 * period / 1e-7)))
    peaks = [q[round(k * period / 1e-7) : round((k + 1) * period / 1e-7)].max() for k in range(3)]
    fall = np.exp(-damping * omega * period)
    assert [b / a for a, b in zip(peaks, peaks[1:], strict=False)] == pytest.approx([fall, fall], rel=0.02)


@pytest.mark.parametrize("side", ["front", "rear"])
def test_stick_limit_is_the_static_force_and_sliding_that_of_the_kinetic(side):
    holds = slider(**{side: (6.0, 5.0)}, external_force=-5.99)
    assert np.ptp(holds.simulate(np.zeros(2000))) < 1e-12 and holds.x[friction.DISSIPATED] == 0.0
    slides = slider(**{side: (6.0, 5.0)}, external_force=-6.01)
    slides.simulate(np.zeros(2000))
    velocity = slides.x[friction.VELOCITY]
    slides.simulate(np.zeros(1000))
    assert slides.x[friction.VELOCITY] - velocity == pytest.approx(-1000 * STEP * (6.01 - 5.0) / MASS, rel=1e-6)


@pytest.mark.parametrize("side", ["front", "rear"])
@pytest.mark.parametrize("kick", [3e-9, -2e-9])
def test_a_closing_clamp_kicks_the_slider_by_its_normal_force(side, kick):
    """20 N at μ_s = 0.3: from the first touch on, the contact moves by 20 N κ, and the slider with it."""
    kicks = {f"{side}_kick": kick / 0.3}
    made = slider(contacts=Contacts(COMPLIANCE, COMPLIANCE, **kicks), damping=0.3)
    place = friction.FRONT_STATIC if side == "front" else friction.REAR_STATIC
    for part in np.linspace(0.0, 1.0, 200):
        made.x[place : place + 2] = 6.0 * part, 5.0 * part
        made.step(0.0)
    assert made.simulate(np.zeros(3000))[-1] == pytest.approx(20.0 * kick, rel=0.02)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.05]), st.integers(1, 5))
def test_friction_takes_energy_and_never_gives_any(seed, damping, substeps):
    made = slider(damping=damping, substeps=substeps)
    taken = 0.0
    for row in forces(np.random.default_rng(seed), 300):
        walk(made, [row])
        assert made.x[friction.DISSIPATED] >= taken - 1e-18 and np.isfinite(made.x).all()
        for side, limit in (("FRONT", row[1]), ("REAR", row[2])):
            assert abs(made.x[getattr(friction, f"{side}_FORCE")]) <= limit
        taken = made.x[friction.DISSIPATED]


@pytest.mark.slow
def test_same_bits_compiled_and_interpreted():
    table = forces(np.random.default_rng(3), 200)
    one, other = (slider(damping=0.03, substeps=3, external_force=-0.5) for _ in range(2))
    np.testing.assert_array_equal(walk(one, table), walk(other, table, interpreted(slide_elastically)))
    np.testing.assert_array_equal(one.x, other.x)


def motor(load, rate, **changes):
    """Return the motor of the other tests, with compliant contacts."""
    parameters = inchworm.motor(-load)
    given = {"compliance": COMPLIANCE, "kick": 0.0, "damping": 0.03, "substeps": 0} | changes
    clamp = {name: given[name] for name in ("compliance", "kick")}
    parts = parameters.inchworm
    parts = replace(
        parts,
        front_clamp=replace(parts.front_clamp, **clamp),
        rear_clamp=replace(parts.rear_clamp, **clamp),
        slider=replace(parts.slider, **{name: given[name] for name in ("damping", "substeps")}),
    )
    return Inchworm(replace(parameters, inchworm=parts), 1.0 / rate)


def lost(load, rate, **changes):
    """Return by how much a cycle is shorter than stroke, elastic loss and the contacts' compliance give [m]."""
    made, hold = motor(load, rate, **changes), round(0.025 * rate)
    times = np.minimum(np.arange(8 * hold) * inchworm.HOLD // hold, 8 * inchworm.HOLD - 1)
    voltages = inchworm.cycle()[times]
    inchworm.run(made, voltages)
    start = made.displacement
    inchworm.run(made, voltages)
    soft = 1.0 / STIFFNESS + 2.0 * changes.get("compliance", COMPLIANCE)
    return 10.8e-6 - load * soft - (made.displacement - start)


RIGID = {"compliance": 0.0, "damping": 0.0, "substeps": 1}


@pytest.mark.slow
def test_what_a_motor_holds_no_longer_depends_on_the_sample_rate():
    """Rigid contacts hold 4.4 N at 10 kHz and slip at 40 kHz, because only the step damps them; here ζ does."""
    assert abs(lost(4.4, 1e4, **RIGID)) < 1e-9 and lost(4.4, 4e4, **RIGID) > 1e-6
    for rate in (5e3, 1e4, 4e4):
        assert abs(lost(3.8, rate)) < 3e-8 and lost(4.1, rate) > 1e-6
        assert abs(lost(4.1, rate, damping=0.1)) < 3e-8


def test_a_step_gains_the_kicks_of_both_clamps():
    without, kicked = lost(2.0, 1e4, damping=0.3), lost(2.0, 1e4, damping=0.3, kick=2e-9)
    assert without - kicked == pytest.approx(2 * 25.0 * 2e-9, rel=0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({**RIGID, "kick": 1e-9}, "kick = 1e-09: needs a compliant contact: set compliance"),
        ({**RIGID, "damping": 0.1}, "slider.damping = 0.1: is for compliant contacts"),
        ({**RIGID, "substeps": 4}, "slider.substeps = 4: is for compliant contacts"),
        ({"damping": 0.0}, "substeps = 0: chooses as many steps as slider.damping needs"),
    ],
)
def test_what_does_not_fit_together_is_refused_with_what_to_do(changes, words):
    with pytest.raises(ParameterError) as caught:
        motor(1.0, 1e4, **changes)
    assert words in str(caught.value)


def test_one_contact_alone_cannot_give_way():
    parameters = inchworm.motor()
    stiff = replace(parameters.inchworm.front_clamp, compliance=1e-8)
    with pytest.raises(ParameterError, match="rear_clamp.compliance = 0.0: the other contact is compliant"):
        Inchworm(replace(parameters, inchworm=replace(parameters.inchworm, front_clamp=stiff)), STEP)
