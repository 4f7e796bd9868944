# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inchworm motor: one cycle in closed form, load, missed grips, wear, and the motor as a block."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from inchworm_support import GRIP, LINE, RISE, STACK, STEP, STIFFNESS, TOP, cycle, motor, phase, run

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.parameters import PlantNodeParameters
from hysteresis_ros.models import friction
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.clamp import LagParameters
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.inchworm import (
    EFFORT,
    JOINT_NAMES,
    TRUE_POSITION,
    VELOCITY,
    Inchworm,
)
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import SensorParameters


@pytest.mark.parametrize("load", [0.0, -2.0, 2.0, -3.0])
@pytest.mark.parametrize("hysteresis, stroke", [(LINE, 12e-6), (STACK, 12.3e-6 - 1.5e-6)])
def test_a_cycle_is_the_stroke_less_the_elastic_loss(hysteresis, stroke, load):
    """A forward cycle moves the slider by stroke + load/stiffness, because each grip loads the extender again."""
    made = Inchworm(motor(load, hysteresis), STEP)
    run(made, cycle())  # the hysteresis closes its first loop
    start = made.displacement
    run(made, cycle())
    assert made.displacement - start == pytest.approx(stroke + load / STIFFNESS, abs=1e-9)


@pytest.mark.parametrize("load", [0.0, -2.0])
def test_backward_the_load_is_gained(load):
    made = Inchworm(motor(load), STEP)
    run(made, cycle(forward=False))
    start = made.displacement
    run(made, cycle(forward=False))
    assert made.displacement - start == pytest.approx(-10.8e-6 + load / STIFFNESS, abs=1e-9)


def test_standing_motor_does_not_move():
    made = Inchworm(motor(-6.0), STEP)
    table = run(made, phase(0.0, GRIP, GRIP, 5000))
    assert np.all(table[:, 0] == 0.0) and np.all(table[:, 3] == 0.0)


def test_a_load_above_the_holding_force_slips_back():
    """7.5 N hold at 100 V; one clamp under 7.6 N starts to slide, with the kinetic 6.25 N."""
    assert motor().inchworm.holding_force(GRIP, GRIP) == pytest.approx((7.5, 7.5))
    holds, slips = (Inchworm(motor(force), STEP) for force in (-7.4, -7.6))
    rear_only = phase(0.0, 0.0, GRIP, 250)
    assert np.ptp(run(holds, rear_only)[:, 0]) == 0.0
    position = run(slips, rear_only)[:, 0]
    np.testing.assert_allclose(np.diff(position, 2)[100:], -(7.6 - 6.25) / 0.05 * STEP**2, rtol=1e-6)


def test_wear_weakens_the_grip():
    """20 % weaker clamps hold 6 N: the 7 N that new clamps hold now slip."""
    worn = motor(-7.0, wear=0.8)
    assert worn.inchworm.holding_force(GRIP, GRIP) == pytest.approx((6.0, 6.0))
    assert run(Inchworm(worn, STEP), phase(0.0, 0.0, GRIP, 300))[-1, 0] < -1e-3
    assert run(Inchworm(motor(-7.0), STEP), phase(0.0, 0.0, GRIP, 300))[-1, 0] == 0.0


def test_missed_grip_when_the_front_clamp_closes_too_late():
    """The front clamp, closed after the extension, carries nothing forward and moves the slider back by the stroke."""
    late = [
        phase(RISE, 0.0, GRIP),
        phase(TOP, GRIP, GRIP),
        phase(TOP, 0.0, GRIP),
        phase(RISE[::-1], 0.0, GRIP),
        phase(0.0, GRIP, GRIP),
    ]
    made = Inchworm(motor(), STEP)
    table = run(made, np.vstack(late))
    assert np.all(table[:, 0] == 0.0) and table[:, 1].max() > 12e-6


def test_missed_grip_when_the_rear_clamp_closes_too_late():
    """With both clamps open under a load the slider falls freely until kinetic friction stops it."""
    made = Inchworm(motor(-2.0), STEP)
    table = run(made, np.vstack([phase(0.0, 0.0, 0.0, 40), phase(0.0, 0.0, GRIP)]))
    fallen = np.diff(table[:, 0], 2)
    np.testing.assert_allclose(fallen[10:35], -2.0 / 0.05 * STEP**2, rtol=1e-6)
    assert table[-1, 0] < -1e-4 and np.ptp(table[-100:, 0]) == 0.0


def test_partly_missed_grip_loses_part_of_the_step():
    """The front clamp closes in the middle of the extension, so only the remaining motion is carried."""
    half = np.vstack([phase(RISE, 0.0, 0.0)[:125], phase(RISE, GRIP, 0.0)[125:], phase(TOP, GRIP, 0.0)])
    made = Inchworm(motor(), STEP)
    run(made, phase(0.0, 0.0, GRIP))
    moved = run(made, half)[-1, 0]
    assert 2e-6 < moved < 8e-6


def test_gravity_equals_an_external_force():
    weight = 0.05 * 9.80665
    tilted = Inchworm(motor(slider=dict(inclination=np.pi / 2)), STEP)
    loaded = Inchworm(motor(-weight), STEP)
    np.testing.assert_allclose(run(tilted, cycle()), run(loaded, cycle()), atol=1e-15)


def test_preload_and_creep_of_the_extender_shift_the_tip():
    creep = CreepParameters.from_mapping({"type": "logarithmic", "logarithmic.rate": 0.02})
    extra = dict(preload=PreloadParameters(force=1.0, B1=-1e-6), creep=creep)
    made = Inchworm(motor(initial_voltage=0.0, **extra), STEP)
    assert made.measure()[1] == pytest.approx(-1e-6)
    tip = run(made, phase(100.0, 0.0, 0.0, 5000))[:, 1]
    assert tip[1000] == pytest.approx(1.025e-5 - 1e-6, rel=1e-9)  # 0.1 s: there the step counts
    assert tip[-1] > tip[1000] + 1e-8


def test_joints_are_those_of_one_joint_state():
    made = Inchworm(motor(-2.0), STEP)
    assert JOINT_NAMES == ("slider", "extender", "front_clamp", "rear_clamp")
    voltages = np.vstack([phase(0.0, GRIP, 0.0), phase(RISE, GRIP, 0.0)])[:350]
    made.measure()
    np.testing.assert_array_equal(made.joints[VELOCITY : VELOCITY + 4], 0.0)
    for v in voltages:
        before = made.measure()
        made.advance(*v)
    after = made.measure()
    np.testing.assert_allclose(made.joints[VELOCITY : VELOCITY + 4], (after - before) / STEP, atol=1e-12)
    np.testing.assert_array_equal(after, made.joints[TRUE_POSITION : TRUE_POSITION + 4])  # no noise here
    assert after[0] > 3e-6 - 2.0 / STIFFNESS and np.all(made.joints[VELOCITY : VELOCITY + 2] > 0.0)
    efforts = made.joints[EFFORT : EFFORT + 4]
    assert efforts[0] == efforts[1] == made.slider.x[friction.FRONT_FORCE]  # the front clamp alone carries
    np.testing.assert_allclose(efforts[2:], [4e6 * 6.25e-6, 0.0], rtol=1e-6)
    assert made.voltages == (pytest.approx(voltages[-1, 0]), GRIP, 0.0)


def test_noise_of_the_joints_is_independent():
    made = Inchworm(motor(noise=2e-9), STEP)
    readings = np.array([made.measure() for _ in range(3000)]) - made.joints[TRUE_POSITION : TRUE_POSITION + 4]
    np.testing.assert_allclose(readings.std(axis=0), 2e-9, rtol=0.06)
    correlation = np.corrcoef(readings.T) - np.eye(4)
    assert np.abs(correlation).max() < 0.08
    inchworm = made.parameters.inchworm
    same = replace(inchworm, slider=replace(inchworm.slider, sensor=SensorParameters(noise=2e-9, seed=1)))
    with pytest.raises(ParameterError, match=r"inchworm.slider.sensor.seed = 1: must differ from sensor.seed"):
        Inchworm(replace(made.parameters, inchworm=same), STEP)


def test_compiled_and_interpreted_agree_and_state_restores():
    second = LinearParameters(A=(0.92, 0.38, -0.38, 0.9), B=(0.08, 0.38), C=(1.0, 0.0))
    one, other = (Inchworm(motor(-2.0, noise=2e-9, dynamics=second), STEP) for _ in range(2))
    voltages = cycle()[::3]
    table = run(one, voltages)
    for k, v in enumerate(voltages):
        assert other.measure()[0] == table[k, 2]
        other.advance(*v)
        if k == 200:
            saved = other.state
    assert np.array_equal(one.state, other.state)
    other.state = saved
    np.testing.assert_array_equal(run(other, voltages[201:]), table[201:])
    one.reset()
    np.testing.assert_array_equal(run(one, voltages), table)


def test_nan_voltages_hold_the_last_ones():
    made = Inchworm(motor(-2.0), STEP)
    table = run(made, np.full((200, 3), np.nan))
    assert np.all(np.isfinite(table)) and np.all(table[:, 0] == 0.0) and made.saturated


VOLTS = st.floats(-50.0, 170.0)


@functools.cache
def short_motor(load):
    """Return a motor of 0.2 mm travel, made once."""
    return Inchworm(motor(load, slider=dict(minimum=-1e-4, maximum=1e-4)), STEP)


@pytest.mark.slow
@given(
    st.lists(st.tuples(VOLTS, VOLTS, VOLTS, st.integers(1, 40)), min_size=1, max_size=8),
    st.sampled_from([-12.0, -2.0, 0.0, 7.0]),
)
def test_nothing_runs_away(pieces, load):
    """Any voltages: the motor stays within limits and travel, and friction only dissipates energy."""
    made = short_motor(load)
    made.reset()
    table = run(made, np.vstack([phase(*piece) for piece in pieces]))
    assert np.all(np.abs(table[:, 0]) <= 1e-4)
    assert np.all(np.diff(table[:, 3]) >= -1e-18)
    assert all(0.0 <= voltage <= 120.0 for voltage in made.voltages)
    assert np.all(np.isfinite(made.state))


def test_retune_takes_a_load_and_refuses_what_cannot_change():
    made = Inchworm(motor(), STEP)
    run(made, cycle())
    position = made.displacement
    made.retune(motor(-2.0))
    run(made, phase(0.0, GRIP, GRIP))
    assert made.displacement == position
    assert made.slider.x[friction.REAR_FORCE] + made.slider.x[friction.FRONT_FORCE] == pytest.approx(2.0, abs=1e-9)
    before, numbers = made.state, [p.copy() for p in made.ps]
    inchworm = made.parameters.inchworm
    wrong = {
        "inchworm.rear_clamp.lag.type": replace(
            inchworm,
            rear_clamp=replace(
                inchworm.rear_clamp,
                lag=LagParameters.from_mapping(
                    {"type": "second_order", "second_order.frequency": 900.0, "second_order.damping": 0.5}
                ),
            ),
        ),
        "inchworm.slider.minimum": replace(inchworm, slider=replace(inchworm.slider, minimum=1e-3, start=1e-3)),
        "inchworm.front_clamp.gap": replace(inchworm, front_clamp=replace(inchworm.front_clamp, gap=2e-5)),
    }
    for name, changed in wrong.items():
        with pytest.raises(ParameterError, match=name):
            made.retune(replace(made.parameters, inchworm=changed))
    with pytest.raises(ParameterError, match="A ="):
        made.retune(replace(motor(-3.0), dynamics=LinearParameters(A=(0.5,), B=(0.5,), C=(1.0,))))
    assert np.array_equal(made.state, before)
    assert all(np.array_equal(p, was) for p, was in zip(made.ps, numbers, strict=True))


def test_a_clamp_that_cannot_hold_the_load_is_named():
    parameters = motor(-7.0).inchworm
    assert list(parameters.holding_problems(GRIP, GRIP)) == []
    assert len(list(parameters.holding_problems(GRIP, GRIP, margin=2.0))) == 2
    (problem,) = parameters.holding_problems(GRIP, 90.0)
    assert problem.name == "inchworm.rear_clamp.stiffness" and "load of 7 N: at 90 V" in problem.remedy


def test_plant_parameters_choose_the_motor():
    """The type is actuator unless the file says otherwise, and then the group ``inchworm`` is not used."""
    actuator = {name: value for name, value in motor().to_mapping().items() if not name.startswith("inchworm.")}
    assert PlantNodeParameters.from_mapping(actuator).type == "actuator"
    with pytest.raises(ParameterError, match="inchworm.slider.mass = None: missing"):
        PlantNodeParameters.from_mapping(actuator | {"type": "inchworm"})
    typed = {"type": "inchworm", "joint": "slider"}
    chosen = PlantNodeParameters.from_mapping(motor().to_mapping() | typed)
    assert chosen.inchworm == motor().inchworm
    with pytest.raises(ParameterError, match="rear_clamp.sensor.seed = 1"):
        noisy = {"sensor.noise": 1e-9, "inchworm.rear_clamp.sensor.noise": 1e-9, "inchworm.rear_clamp.sensor.seed": 1}
        PlantNodeParameters.from_mapping(motor().to_mapping() | typed | noisy)
