# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Integral force feedback in the loop: its damping, its delay margin, and a force that is lost or missing."""

from __future__ import annotations

import numpy as np
import pytest
from force_support import CLEAN, IFF, changed
from fused_support import ANY_LATE, STAGE_SLOWLY, assert_twin, change, made_loop, whole
from loop_support import assert_same_bits, axis, parameters
from waiting import until

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop import watch
from hysteresis_ros.loop.axis import Change
from hysteresis_ros.signals import ACTUATOR

SETPOINTS = np.repeat([2e-6, 6e-6], 800)


#: Steps without the file's approach, which would leave no vibration.
BARE = {f"approach__maximum_{name}": 0.0 for name in ("velocity", "acceleration", "jerk")}


def stage(plant=None, **controller):
    nodes = {"plant_simulator": CLEAN | (plant or {}), "motion_controller": IFF | controller}
    return axis("stage700", reference_generator=BARE, **nodes)


def test_it_damps_what_the_same_law_alone_leaves_ringing():
    made = stage().run(SETPOINTS)
    assert np.abs(made["displacement"][-200:] - 6e-6).max() < 1e-9
    # the force at rest is that of the flexure minus the sensor's loss at 1 Hz in 80 ms; the law does not need it
    assert 0.6 < made["force"][-1] / (2.5e6 * 6e-6) < 0.8 and np.all(np.isfinite(made["force"]))
    bare = stage(damping__type="none").run(SETPOINTS)
    assert np.abs(bare["displacement"][-200:] - 6e-6).max() > 5e-8


@pytest.mark.parametrize("late, stays", [(4, True), (6, False)])
def test_both_loops_bear_the_delay_that_their_margin_says_and_no_more(late, stays):
    # 4.31 samples of delay at the plant, in addition to the one in the model
    made = stage({"dynamics__delay": (1 + late) * 5e-5}).run(np.full(3000, 4e-6))
    swing = np.ptp(made["displacement"][-300:])
    assert made["tripped"][-1] == 0.0 and swing < 1e-8 if stays else swing > 1e-7 or made["tripped"][-1] != 0.0


@pytest.mark.slow
def test_a_fused_axis_makes_the_samples_of_its_twin_with_force_feedback_that_changes():
    given = {"motion_controller": IFF, **ANY_LATE, "every": {"faults": ["lost_force:0.002:0.001"]}}
    loop, parameters_ = made_loop("stage700", factor=STAGE_SLOWLY, **given)
    loop.set(setpoint=5e-6)
    loop.start()
    until(lambda: loop.sample > 70)
    loop.apply(change("motion_controller", "retune", damping__iff__gain=5e-5))
    with pytest.raises(ParameterError, match=r"damping\.iff = .*inner loop is unstable"):
        loop.apply(change("motion_controller", "retune", damping__iff__gain=2e-3))
    until(lambda: loop.sample > 110)
    loop.apply(change("motion_controller", "retune", damping__type="none", pid__Kp=0.0, pid__Ki=20.0, pid__Kd=0.0))
    until(lambda: loop.sample > 150)
    loop.leave()
    twin = assert_twin(loop, whole(loop), parameters_)
    assert np.ptp(twin["command"]) > 1e-6 and set(twin["controller_mode"][40:60]) == {watch.HOLDING}


def test_without_the_force_nothing_is_answered_and_after_its_time_out_the_axis_goes_safe():
    made, plain = stage(measurement_timeout=0.01, safe_slew_rate=1e-3), stage()
    made.inject(("lost_force:0.02:0.02",))
    found, free = made.run(np.append(SETPOINTS, np.full(9000, 6e-6))), plain.run(SETPOINTS)
    mode, command = found["controller_mode"], found["command"]
    assert_same_bits({name: values[:400] for name, values in found.items()}, free)
    assert np.all(np.isnan(found["force"][400:800])) and np.all(np.isnan(found["seen"][400:800]))
    assert np.all(mode[400:599] == watch.HOLDING) and np.all(command[400:599] == command[399])
    assert np.all(mode[600:800] == watch.STALE) and command[799] == 0.0
    assert np.all(mode[801:] == watch.RUNNING) and abs(command[800]) < 1e-9
    assert np.abs(found["displacement"][-50:] - 6e-6).max() < 1e-8


def test_a_force_that_was_never_there_moves_nothing():
    made = stage()
    made.inject(("lost_force:0:1",))
    found = made.run(SETPOINTS)
    assert not np.any(found["command"]) and not np.any(np.diff(found["plant_voltage"]))
    with pytest.raises(ParameterError, match=r"motion_controller: damping\.type = 'iff': missing force joint 'force'"):
        parameters("stage700", plant_simulator={"force_sensor__stack_stiffness": 0.0}, motion_controller=IFF)
    camera = {"force_joint": "stage"}
    with pytest.raises(ParameterError, match=r"force_joint = 'stage': must differ from joint"):
        parameters("stage700", every=camera)


def test_it_takes_over_live_where_a_force_is_measured_and_is_refused_by_name_where_none_is():
    bare = {"plant_simulator": CLEAN | {"force_sensor__stack_stiffness": 0.0}}
    made, other = axis("stage700", **bare), axis("stage700", **bare)
    made.run(SETPOINTS[:50])
    with pytest.raises(ParameterError, match=r"damping\.type = 'iff': missing force joint 'force'"):
        made.apply(Change(0, "motion_controller", "retune", changed()))
    other.run(SETPOINTS[:50])
    assert_same_bits(made.run(SETPOINTS[50:300]), other.run(SETPOINTS[50:300]))
    made = axis("stage700", plant_simulator=CLEAN)
    first = made.run(SETPOINTS[:600])
    made.apply(Change(0, "motion_controller", "retune", changed()))
    after = made.run(np.full(2000, 2e-6))
    assert after["command"][0] == first["command"][-1]
    assert np.abs(after["displacement"] - 2e-6).max() < 5e-9


def test_resonances_off_by_ten_per_cent_are_damped_as_well():
    for slowness in (1.0 / 1.1, 1.1):
        omega, step = 2.0 * np.pi * 700.0 / slowness, 5e-5
        decay, turn = np.exp(-0.01 * omega * step), omega * step * np.sqrt(1.0 - 0.01**2)
        # a mode with 1 % damping at another frequency and unit gain at rest, in the form of its poles
        c, s = decay * np.cos(turn), decay * np.sin(turn)
        A = np.array([[c, s], [-s, c]])
        C = np.array([1.0, 0.0])
        B = (np.eye(2) - A) @ np.array([1.0, -0.01 / np.sqrt(1.0 - 0.01**2)])
        plant = {"dynamics__A": A.ravel().tolist(), "dynamics__B": B.tolist(), "dynamics__C": C.tolist()}
        made = stage(plant).run(np.full(1600, 4e-6))
        assert made["tripped"][-1] == 0.0
        assert np.abs(made["displacement"][-100:] - 4e-6).max() < 1e-9
    assert "force" in [signal.name for signal in ACTUATOR.row]
