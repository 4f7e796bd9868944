# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inputs and states of a damping filter: no preload, and no state of another filter."""

from __future__ import annotations

import numpy as np
import pytest
from damping_support import CHOSEN, FORCE, T, controller, damping, stage

from hysteresis_ros.control.controller import ControllerParameters, ModelParameters, damping_block
from hysteresis_ros.control.damping import inner_loop
from hysteresis_ros.models.actuator import PreloadParameters

kinds = pytest.mark.parametrize("kind", CHOSEN)


def fed(between, outputs, measured, force=0.0) -> np.ndarray:
    """Return the commands for these outputs of the law and measurements."""
    pairs = zip(outputs, measured, strict=True)
    return np.array([inner_loop.damp(between.p, between.x, float(w), float(y), force) for w, y in pairs])


@kinds
def test_an_axis_under_a_preload_is_damped_as_one_without(kind):
    """The preload moves the zero of the sensor, here by 2 µm, and does not change the dynamics."""
    preload = PreloadParameters(force=3.0, A1=-0.5e-6, B1=-0.5e-6)
    assert preload.offset == pytest.approx(-2e-6)
    model = ModelParameters(dynamics=stage(), force=FORCE, preload=preload)
    loaded = damping_block(ControllerParameters(type="open_loop", model=model, damping=damping(kind)), T)
    free = damping_block(controller(kind), T)
    random = np.random.default_rng(2)
    outputs, moved = 1e-6 * random.standard_normal((2, 400))
    commands = fed(free, outputs, moved)
    np.testing.assert_allclose(fed(loaded, outputs, moved + preload.offset), commands, rtol=0, atol=1e-18)
    assert np.std(commands) > 1e-7


@kinds
@pytest.mark.parametrize("before", CHOSEN)
def test_another_filter_begins_at_rest_whatever_the_one_before_has_seen(before, kind):
    if before == kind:
        pytest.skip("the same filter keeps its state")
    between, fresh = damping_block(controller(before), T), damping_block(controller(kind), T)
    random = np.random.default_rng(4)
    fed(between, *(1e-6 * random.standard_normal((2, 200))))
    between.retune(controller(kind))
    outputs, moved = 1e-6 * random.standard_normal((2, 50))
    np.testing.assert_array_equal(fed(between, outputs, moved), fed(fresh, outputs, moved))


@pytest.mark.parametrize(
    ("kind", "changes"),
    [("irc", {"k": 1200.0}), ("irc", {"feedthrough": -3.5}), ("ppf", {"gains": (0.1, 0.05)})],
)
def test_other_gains_of_the_same_filter_do_not_move_an_axis_that_rests(kind, changes):
    """At rest at 3 µm the command is 3 µm before and after, without a transient."""
    between = damping_block(controller(kind), T)
    rest = np.full(20, 3e-6)
    np.testing.assert_allclose(fed(between, rest, rest), rest, rtol=1e-12)
    between.retune(controller(kind, **changes))
    np.testing.assert_allclose(fed(between, rest, rest), rest, rtol=1e-9)
    # neither where the displacement differs from the output of the law, because the model's gain is wrong
    apart = damping_block(controller(kind), T)
    fed(apart, 0.8 * rest, rest)
    apart.retune(controller(kind, **changes))
    assert np.ptp(fed(apart, 0.8 * rest, rest)) < 1e-15
    # and a filter that was not at rest continues from its state
    other = damping_block(controller(kind), T)
    step = np.concatenate([np.zeros(5), np.full(5, 1e-6)])
    fed(other, step, step)
    kept = other.x.copy()
    other.retune(controller(kind))
    np.testing.assert_array_equal(other.x, kept)


@pytest.mark.parametrize("more", [True, False])
def test_filters_of_the_same_kind_but_another_number_begin_at_rest(more):
    """One notch and two, also in the other order: the law's output of 3 µm passes unchanged before and after."""
    counts = ((1, 2) if more else (2, 1)) + (1,)
    one = {count: {name: values[:count] for name, values in CHOSEN["notch"].items()} for count in (1, 2)}
    between, rest = damping_block(controller("notch", **one[counts[0]]), T), np.full(20, 3e-6)
    random = np.random.default_rng(5)
    fed(between, np.concatenate([3e-6 + 1e-7 * random.standard_normal(40), rest]), np.zeros(60))
    for count in counts[1:]:
        between.retune(controller("notch", **one[count]))
        np.testing.assert_allclose(fed(between, rest, rest), rest, rtol=1e-9)
