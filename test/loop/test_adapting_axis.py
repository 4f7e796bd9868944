# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An adapting inverse in the loop: the same bits in every way of running, frozen when required, saved to a file."""

from __future__ import annotations

import numpy as np
import pytest
from adapting_support import ADAPTATION, CHANGED, adapted_run, adapting
from fused_support import assert_twin, change, whole
from interpreted import interpreted
from loop_support import assert_same_bits, parameters
from waiting import until

from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.compensator import adapted_text
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import drifting
from hysteresis_ros.models import adaptation as states
from hysteresis_ros.models.block import COMPILED

NODE = "hysteresis_compensator"


def run(axis, samples, changes=()):
    return axis.run(axis.default_setpoints(samples), changes=changes)


def factors(axis) -> np.ndarray:
    return np.array(axis.compensator.adaptation.factors)


@pytest.mark.slow
def test_the_error_falls_to_what_a_true_model_leaves():
    axis, fixed = Axis(adapting()), Axis(adapting({"adaptation__type": "none"}))
    made, plain = run(axis, 12000), run(fixed, 12000)
    assert set(plain["adaptation"]) == {states.OFF} and set(plain["adapted_gain"]) == {1.0}
    plant = adapting().plant_simulator.hysteresis.prandtl_ishlinskii
    fresh = {f"hysteresis__prandtl_ishlinskii__{name}": list(getattr(plant, name)) for name in CHANGED}
    true = run(Axis(adapting({"adaptation__type": "none"} | fresh)), 12000)
    none, adapted = (np.std((one["displacement"] - true["displacement"])[-2000:]) for one in (plain, made))
    assert none > 0.3e-6 and adapted < 0.05 * none
    assert made["adapted_gain"][-1] == pytest.approx(sum(plant.weights) / sum(_identified()), abs=0.02)


def _identified():
    return adapting().hysteresis_compensator.hysteresis.prandtl_ishlinskii.weights


@pytest.mark.slow
def test_an_axis_without_feedback_keeps_its_place_or_goes_where_it_is_measured():
    """The model's offset is wrong by 1 µm, and the plant's gain drifts: tested on the mean of the displacement."""
    means = []
    for settings in ({"adaptation__type": "none"}, {}, {"adaptation__offset": "measured"}):
        axis = Axis(adapting(settings | {"hysteresis__prandtl_ishlinskii__offset": 1e-6}))
        made = run(axis, 20000, drifting(axis.parameters, 20000, 0.05))
        error = made["reference"] - made["displacement"]
        means.append([error[1000:1200].mean(), error[-200:].mean()])
    none, kept, measured = means
    assert abs(kept[1] - kept[0]) < 0.5 * abs(none[1] - none[0]) and abs(kept[1]) > 2e-6
    assert abs(measured[1]) < 0.1e-6


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="Numba is not installed: kernels exist in one form only")
def test_interpreted_it_makes_the_same_bits(tmp_path):
    slow = {"adaptation__slow": 0.05}
    there = interpreted("adapting_support", f"adapted_run(adaptation={slow})", tmp_path)
    here = adapted_run(adaptation=slow)
    np.testing.assert_array_equal(here.view(np.int64), there.view(np.int64))
    assert here[1][-1] < 1.0


@pytest.mark.slow
def test_fused_it_is_its_twin_whatever_is_asked_of_it():
    given = adapting({"adaptation__slow": 0.05})
    loop = FusedLoop(Axis(given), 10.0, 0)
    asked = [
        change(NODE, "freeze"),
        change(NODE, "resume"),
        change(NODE, "retune", adaptation__memory=2.0),
        change(NODE, "stop"),
        change(NODE, "start"),
        change(NODE, "retune", handover_time=0.5),
        change(NODE, "forget"),
        change(NODE, "retune", hysteresis__prandtl_ishlinskii__offset=1e-7),
        change(NODE, "reset"),
    ]
    loop.start()
    for one in asked:
        before = loop.sample
        until(lambda before=before: loop.sample >= before + 250, what="further samples")
        loop.apply(one)
    loop.leave()
    made = assert_twin(loop, whole(loop), given)
    assert {states.ADAPTING, states.FROZEN, states.WAITING} <= set(made["adaptation"])
    # the number of samples with adaptation depends on the machine; in each of them the gain changes
    moved = np.diff(made["adapted_gain"])[made["adaptation"][1:] == states.ADAPTING]
    assert moved.size > 20 and np.count_nonzero(moved) > 0.9 * moved.size


def test_frozen_by_a_service_by_a_stop_and_at_a_limit_and_the_voltage_does_not_jump():
    changes = [
        Change(3000, NODE, "freeze"),
        Change(3400, NODE, "resume"),
        Change(4000, NODE, "stop"),
        Change(4200, NODE, "start"),
        Change(6000, NODE, "forget"),
        Change(6500, NODE, "retune", {"adaptation.range": 1.05}),
    ]
    made = run(Axis(adapting({"limits__slew_rate": 2.8})), 7000, changes)
    state, gain = made["adaptation"], made["adapted_gain"]
    assert set(state[3000:3400]) == {states.FROZEN} and len(set(gain[2999:3400])) == 1
    assert set(state[4001:4700]) == {states.WAITING} and len(set(gain[4000:4700])) == 1
    assert gain[6000] == pytest.approx(1.0, abs=1e-3) and gain[5999] < 0.95
    limited = made["saturated"][4700:5999] == 1.0
    assert limited.any() and set(state[4701:6000][limited]) == {states.SATURATED}
    running = np.abs(np.diff(made["voltage"]))
    usual = running[1000:2900].max()
    for moment in (3000, 3400, 6000, 6500):
        assert running[moment - 2 : moment + 3].max() < 1.5 * usual


def test_what_was_learned_survives_other_parameters_and_begins_anew_with_another_model_or_a_reset():
    axis = Axis(adapting())
    run(axis, 4000)
    learned = factors(axis)
    axis.apply(Change(4000, NODE, "retune", {"handover_time": 0.2}))
    np.testing.assert_array_equal(factors(axis), learned)
    model = axis.compensator.compensator.hysteresis
    np.testing.assert_array_equal(model.p, model.pack(axis.compensator.adaptation.hysteresis.chosen))
    with pytest.raises(ParameterError, match="A = "):
        axis.apply(Change(4000, NODE, "retune", {f"adaptation.dynamics.{name}": () for name in "ABC"}))
    np.testing.assert_array_equal(factors(axis), learned)
    axis.reset()
    assert_same_bits(run(axis, 3000), run(Axis(adapting()), 3000))
    other = [1.01 * weight for weight in _identified()]
    axis.apply(Change(3000, NODE, "retune", {"hysteresis.prandtl_ishlinskii.weights": other}))
    np.testing.assert_array_equal(factors(axis), 1.0)


def test_the_saved_file_is_a_model_from_which_an_axis_goes_on():
    axis = Axis(adapting())
    run(axis, 9000)
    text = adapted_text("/hysteresis_compensator", axis.compensator)
    given = parse_configuration(adapting().configuration_text(), "axis")
    again = Axis(single_axis(given.under(parse_configuration(text, "saved"))))
    np.testing.assert_array_equal(factors(again), factors(axis))
    kept = axis.compensator.adaptation.weighted
    assert again.parameters.hysteresis_compensator.hysteresis.chosen.weights == kept.chosen.weights
    # the bounds remain those of the identified weights, however often the weights are saved and loaded
    np.testing.assert_allclose(again.compensator.adaptation.settings.nominal[:20], _identified(), rtol=1e-15)
    made = run(again, 1000)
    assert made["adapted_gain"][0] == pytest.approx(axis.compensator.adaptation.gain, rel=1e-12)
    with pytest.raises(ParameterError, match="adaptation is off: start the node with adaptation.type: recursive"):
        Axis(adapting({"adaptation__type": "none"})).apply(Change(0, NODE, "forget"))


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("kim2009", {"adaptation__type": "recursive"}, "polynomial is not linear in its weights"),
        ("picma_stage", {"adaptation__type": "recursive"}, "a lag or a delay would be learned as hysteresis"),
        ("inchworm_travel", {"adaptation__type": "recursive"}, "a motor measures its slider"),
        (
            "picma_stage",
            ADAPTATION | {"adaptation__offset": "measured", "adaptation__zero": 1e-6},
            "adaptation.zero = 1e-06: must equal the offset of motion_controller's model.preload, 0 m",
        ),
        (
            "picma_stage",
            {"adaptation__dynamics__A": [0.5], "adaptation__dynamics__B": [0.5], "adaptation__dynamics__C": [1.0]}
            | {"adaptation__dynamics__sample_time": 1e-3},
            "adaptation.dynamics.sample_time",
        ),
    ],
)
def test_an_axis_that_cannot_adapt_is_refused(name, overrides, said):
    if name == "inchworm_travel":
        hysteresis = {"hysteresis__type": "proportional", "hysteresis__proportional__gain": 1e-7}
        overrides = overrides | hysteresis | {"inverse__type": "exact", "creep__type": "none"}
    with pytest.raises(ParameterError, match=said):
        parameters(name, hysteresis_compensator=overrides)
