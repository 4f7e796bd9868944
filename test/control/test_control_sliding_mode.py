# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Sliding mode control of the published axis: the paper's step, the reaching law, offsets, limits, units, state."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.control import law, sliding_surface
from hysteresis_ros.control.controller import arm, controller_block, handover_block
from hysteresis_ros.control.kalman import filter_gain
from hysteresis_ros.errors import ParameterError

STEP = 2.05e-6  # one pre-amplifier volt
DISTURBED = {"kalman.disturbance": "constant", "kalman.q_disturbance": 0.01}
INTEGRAL = {
    "sliding_mode.tracking": "integral",
    "sliding_mode.hyperplane": "poles",
    "sliding_mode.poles": (-0.122, -0.7, 0.97),
}
LINEAR_ONLY = {"sliding_mode.eta": 0.0, "sliding_mode.beta": 0.0}


def test_uncontrolled_step_rings_as_published(plant, settling_time):
    y = plant().simulate(np.full(3000, STEP))
    assert y.max() == pytest.approx(3.70e-6, abs=0.01e-6)
    assert settling_time(y, STEP) == pytest.approx(0.51, abs=0.01)


@pytest.mark.parametrize("form", ["predictor", "current"])
def test_controlled_step_settles_within_the_published_time(loop, settling_time, form):
    _, y = loop({"kalman.form": form}).run(np.full(600, STEP))
    assert settling_time(y, STEP) <= 0.02
    assert y.max() < 1.02 * STEP
    assert y[-1] == pytest.approx(STEP, rel=1e-9)


def test_switching_function_decays_by_phi_without_the_nonlinear_part(loop):
    axis = loop(LINEAR_ONLY)
    s = []
    for _ in range(60):
        axis.run([STEP])
        s.append(axis.controller.x[law.SWITCHING])
    assert abs(s[0]) > 0.1
    assert np.array(s[1:]) == pytest.approx(0.93 * np.array(s[:-1]), abs=1e-13)


def test_boundary_layer_adds_its_own_decay(loop):
    axis = loop()
    s = []
    for _ in range(60):
        axis.run([STEP])
        s.append(axis.controller.x[law.SWITCHING])
    s = np.array(s)
    switching_gain = float(np.dot((-1.0744, -0.0904, 0.0781), (-0.7318, -0.3533, 0.2288)))
    nonlinear = (0.002 / switching_gain * np.abs(s) + 0.0002) * s / (np.abs(s) + 0.01)
    assert s[1:] == pytest.approx((0.93 * s - switching_gain * nonlinear)[:-1], abs=1e-13)


def test_mirrored_hyperplane_is_the_same_controller(loop):
    reference = STEP * np.sign(np.sin(np.arange(300) / 30))
    _, y = loop().run(reference)
    _, mirrored = loop({"sliding_mode.S": (1.0744, 0.0904, -0.0781)}).run(reference)
    assert mirrored == pytest.approx(y, abs=1e-18)


def test_zero_boundary_layer_stays_in_its_band(loop):
    axis = loop({"sliding_mode.delta": 0.0})
    _, y = axis.run(np.full(900, STEP))
    assert abs(axis.controller.x[law.SWITCHING]) < 0.0002
    assert y[-1] == pytest.approx(STEP, abs=2e-9)


@pytest.mark.parametrize("variant", [DISTURBED, DISTURBED | {"kalman.form": "current"}, INTEGRAL])
@pytest.mark.parametrize("disturbance", [0.3e-6, -1e-6])
def test_constant_disturbance_leaves_no_offset(loop, variant, disturbance):
    axis = loop(variant, disturbance=disturbance)
    _, y = axis.run(np.full(3000, STEP))
    assert y[-1] == pytest.approx(STEP, abs=1e-15)
    if variant is not INTEGRAL:
        assert axis.controller.x[law.DISTURBANCE] == pytest.approx(disturbance, abs=1e-15)


def test_without_either_the_disturbance_stays(loop):
    _, y = loop(disturbance=0.3e-6).run(np.full(3000, STEP))
    assert abs(y[-1] - STEP) > 0.1e-6


@pytest.mark.parametrize("variant", [DISTURBED, INTEGRAL])
def test_wrong_gain_of_the_model_leaves_no_offset(controller, plant, loop, variant):
    axis = loop(variant)
    axis.plant = plant({"input_scale": 2.05e-6 / 1.05})
    _, y = axis.run(np.full(3000, STEP))
    assert y[-1] == pytest.approx(STEP, abs=1e-14)


@pytest.mark.parametrize("variant", [{}, DISTURBED, INTEGRAL])
def test_preload_offset_belongs_to_the_measurement_not_to_the_reference(loop, variant):
    preload = {"model.preload.force": 5.88, "model.preload.B1": -1e-6 / 0.41}
    commands, _ = loop(variant).run(np.full(300, STEP))
    axis = loop(variant | preload, offset=-5.88e-6 / 0.41)
    shifted, y = axis.run(np.full(300, STEP))
    assert shifted == pytest.approx(commands, abs=1e-15)
    assert axis.controller.x[law.ESTIMATED] == pytest.approx(y[-1], abs=1e-15)


def limited(u):
    return min(max(u, -0.7 * STEP), 0.7 * STEP)


def test_integral_holds_at_the_limit(loop, settling_time):
    reference = np.append(np.full(1500, STEP), np.full(1500, 0.5 * STEP))
    results = {}
    for threshold in (0.1, 1e9):
        axis = loop(INTEGRAL | {"sliding_mode.anti_windup_threshold": threshold}, carry=limited)
        _, y = axis.run(reference)
        results[threshold] = settling_time(y[1500:], 0.5 * STEP)
    assert results[0.1] < 0.1
    assert results[1e9] > 2 * results[0.1]


def test_integral_is_not_held_by_a_coarse_converter(loop):
    quantum = 5e-9
    axis = loop(INTEGRAL, disturbance=0.3e-6, carry=lambda u: quantum * round(u / quantum))
    _, y = axis.run(np.full(4000, STEP))
    assert abs(np.mean(y[-1000:]) - STEP) < quantum


def test_published_units_and_metres_are_the_same_controller(controller, loop):
    """PAPERS K7: with g = DC gain x 1 um, S, K, eta and phi are the same; C/2.05, q/r x 2.05^2, beta and delta x g."""
    gain = controller().p[sliding_surface.INPUT_SCALE]
    metres = {
        "model.dynamics.C": tuple(c * 1e-6 / gain for c in (-0.8674, 0.7907, 0.3855)),
        "model.dynamics.output_scale": 1.0,
        "model.dynamics.input_scale": 1.0,
        "sliding_mode.beta": 0.0002 * gain,
        "sliding_mode.delta": 0.01 * gain,
        "kalman.q": 0.685 * (gain * 1e6) ** 2,
    }
    reference = STEP * np.sign(np.sin(np.arange(400) / 40))
    noise = np.random.default_rng(2).normal(scale=5e-9, size=400)
    commands, _ = loop(noise=noise).run(reference)
    in_metres, _ = loop(metres, noise=noise).run(reference)
    assert in_metres == pytest.approx(commands, abs=1e-11 * STEP)
    published, si = controller(), controller(metres)
    assert si.p[sliding_surface.GAINS :][:6] == pytest.approx(published.p[sliding_surface.GAINS :][:6])


def test_command_is_bumpless_through_handover(controller, parameters, loop, plant):
    axis = loop()
    transfer = handover_block(parameters(), axis.controller.sample_time)
    commands, _ = axis.run(np.full(300, STEP))
    transfer.simulate(commands)
    # From sliding mode to open loop with another reference, and back with different gains.
    passing = controller({"type": "open_loop"})
    arm(transfer)
    first = transfer.step(passing.step(2 * STEP, STEP))
    assert first == commands[-1]
    axis.controller.retune(parameters({"sliding_mode.phi": 0.5}))
    arm(transfer)
    assert transfer.step(axis.controller.step(0.0, STEP)) == first


def test_stale_measurement_restarts_from_rest_at_the_new_one(controller):
    block = controller()
    for _ in range(10):
        block.step(STEP, 0.0)
    block.x[law.STARTED] = 0.0
    assert block.step(STEP, STEP) == pytest.approx(STEP, rel=1e-9)
    assert block.x[law.ESTIMATED] == pytest.approx(STEP)


@pytest.mark.parametrize("variant", [{}, DISTURBED | {"kalman.form": "current"}, INTEGRAL])
def test_restored_state_goes_on_identically(loop, controller, variant):
    generator = np.random.default_rng(3)
    reference, measured = generator.normal(scale=1e-6, size=(2, 100))
    one, other = controller(variant), controller(variant)
    one.simulate(reference, measured)
    other.state = one.state
    again = one.simulate(reference, measured)
    assert (other.simulate(reference, measured) == again).all()
    one.reset()
    assert (one.simulate(reference, measured) == controller(variant).simulate(reference, measured)).all()


def test_retune_is_atomic_and_keeps_the_structure(controller, parameters):
    block = controller()
    before = block.p.copy()
    with pytest.raises(ParameterError, match="type"):
        block.retune(parameters({"type": "open_loop"}))
    other = {"model.dynamics.A": (0.9,), "model.dynamics.B": (0.1,), "model.dynamics.C": (1.0,)}
    with pytest.raises(ParameterError, match="order"):
        block.retune(parameters(other | {"sliding_mode.S": (1.0,)}))
    assert (block.p == before).all()
    estimate = block.step(STEP, 0.0), block.estimate
    block.retune(parameters({"sliding_mode.phi": 0.5}))
    assert (block.estimate == estimate[1]).all()
    assert block.x[law.STARTED] == 1.0
    block.retune(parameters({"model.preload.A1": 1e-6}))
    assert block.x[law.STARTED] == 0.0


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from([{}, DISTURBED, INTEGRAL, {"type": "open_loop"}]),
    st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=1, max_size=30),
)
def test_finite_input_gives_finite_signals(parameters, variant, samples):
    block = controller_block(parameters(variant), 1 / 3000)
    for reference, measured, applied in samples:
        assert np.isfinite(block.step(reference, measured))
        block.x[law.APPLIED] = applied
        assert np.isfinite(block.x).all()


def test_open_loop_passes_the_reference_through(controller):
    block = controller({"type": "open_loop"})
    reference = np.linspace(-1e-5, 1e-5, 20)
    assert (block.simulate(reference, np.zeros(20)) == reference).all()
    assert block.x[law.APPLIED] == block.x[law.COMMAND] == reference[-1]


SCRIPT = """
import json, sys
import numpy as np
from hysteresis_ros.control.controller import ControllerParameters, controller_block
for entries in json.load(sys.stdin):
    generator = np.random.default_rng(4)
    reference, measured = generator.normal(scale=1e-6, size=(2, 300))
    block = controller_block(ControllerParameters.from_mapping(entries), 1 / 3000)
    print(block.simulate(reference, measured).tobytes().hex(), block.state.tobytes().hex())
"""


@pytest.mark.slow
def test_compiled_and_interpreted_controllers_give_the_same_bits(parameters, model, tmp_path):
    import json

    import hysteresis_ros.models.block

    ramp = parameters({"kalman.disturbance": "ramp"}).kalman
    ramp_gain = tuple(filter_gain(ramp, model).tolist())
    # Given gains, because LAPACK may give different bits in two processes.
    gains = {"kalman.gain": "given", "sliding_mode.hyperplane": "given"}
    whole = {**gains, "sliding_mode.tracking": "integral", "sliding_mode.S": (-1.2725, -0.1099, 0.0923, -0.0199)}
    cases = [
        gains | {"kalman.L": (0.0040, 0.5771, 0.3558)},
        gains | {"kalman.form": "current", "kalman.L": (-0.4540, 0.3634, 0.2329)},
        whole | {"kalman.L": (0.0040, 0.5771, 0.3558)},
        gains | {"type": "integral_sliding_mode", "kalman.L": (0.0040, 0.5771, 0.3558)},
        gains | {"type": "super_twisting", "kalman.L": (0.0040, 0.5771, 0.3558)},
        gains
        | {"type": "super_twisting", "super_twisting.discretisation": "explicit"}
        | {"kalman.disturbance": "ramp", "kalman.L": ramp_gain},
    ]
    given = json.dumps([parameters(case).to_mapping() for case in cases])
    root = os.path.dirname(os.path.dirname(os.path.dirname(hysteresis_ros.models.block.__file__)))
    outputs = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT],
            input=given,
            env=os.environ | {"PYTHONPATH": root, "NUMBA_DISABLE_JIT": disabled},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for disabled in ("0", "1")
    ]
    assert outputs[0] == outputs[1]
    assert len(outputs[0].splitlines()) == len(cases)
