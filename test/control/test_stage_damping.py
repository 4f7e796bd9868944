# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dampings of coupled axes: the loops of all axes together, on plants whose modes are shared by both directions."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from plain_stage_support import SAMPLE_TIME, stage

from hysteresis_ros.control.coupling import disk_margins
from hysteresis_ros.control.margins import REQUIRED
from hysteresis_ros.designs import coupled as coupled_designs
from hysteresis_ros.designs import damping as dampings
from hysteresis_ros.designs.controller import DesignRequest, design_axis, design_lines, doubts
from hysteresis_ros.designs.coupled import design_controllers, with_designs
from hysteresis_ros.designs.stage_stability import slower_structure, unmet_together
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_response import controllers_of, stage_loop

DAMPING = 0.01


def mode(frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of a mode with unit gain at rest under a held input, from its differential equation."""
    w = 2.0 * np.pi * frequency
    whole = np.zeros((3, 3))
    whole[:2] = [[0.0, w, 0.0], [-w, -2.0 * DAMPING * w, w]]
    found = scipy.linalg.expm(whole * SAMPLE_TIME)
    return found[:2, :2], found[:2, 2]


def coupled(frequencies, cross) -> StageParameters:
    """Return a stage whose actuators and sensors see both modes, decoupled at rest; each axis knows its own mode."""
    into, out = (np.array([[1.0, a], [b, 1.0]]) for a, b in (cross[:2], cross[2:]))
    parts = [mode(frequency) for frequency in frequencies]
    A = scipy.linalg.block_diag(*(part[0] for part in parts))
    B = np.vstack([np.outer(part[1], row) for part, row in zip(parts, into, strict=True)])
    C = np.zeros((2, 4))
    C[:, ::2] = out
    decoupling = np.linalg.inv(C @ np.linalg.solve(np.eye(4) - A, B))
    named = {"A": A, "B": B, "C": C}
    structure = {f"structure__{name}": tuple(np.ravel(value).tolist()) for name, value in named.items()}
    found = stage(structure=structure | {"decoupling": tuple(decoupling.ravel().tolist())})
    axes = []
    for axis, (own, into_own) in zip(found.axes, parts, strict=True):
        control = axis.motion_controller
        matrices = {"A": tuple(own.ravel().tolist()), "B": tuple(into_own.tolist()), "C": (1.0, 0.0)}
        model = replace(control.model, dynamics=replace(control.model.dynamics, **matrices))
        axes.append(replace(axis, motion_controller=replace(control, model=model)))
    return replace(found, axes=tuple(axes))


def matrices(parameters: StageParameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B behind the decoupling, and C."""
    given, shapes = parameters.stage.structure, {"A": (4, 4), "B": (4, 2), "C": (2, 4)}
    A, B, C = (np.reshape(getattr(given, name), shape) for name, shape in shapes.items())
    return A, B @ np.reshape(parameters.stage.decoupling, (2, 2)), C


def closed_loop(parameters: StageParameters, late: int, slowness: float = 1.0) -> np.ndarray:
    """Return the state matrix of plant and controllers, written out sample by sample; ``late`` samples in all."""
    A, B, C = matrices(parameters)
    if slowness != 1.0:
        rest = np.linalg.solve(np.eye(4) - A, B)
        A = np.real(scipy.linalg.expm(scipy.linalg.logm(A) / slowness))
        B = (np.eye(4) - A) @ rest
    controllers = controllers_of(parameters)
    sizes = [one.order for one in controllers]
    total = 4 + 2 * late + sum(sizes)
    found = np.zeros((total, total))
    found[:4, :4] = A
    last = slice(4 + 2 * (late - 1), 4 + 2 * late)
    found[:4, last] = B
    for k in range(1, late):  # the older commands
        found[4 + 2 * k : 6 + 2 * k, 2 + 2 * k : 4 + 2 * k] = np.eye(2)
    place = 4 + 2 * late
    for i, one in enumerate(controllers):
        own = slice(place, place + one.order)
        found[own, own] = one.A
        found[own, :4] = np.outer(one.B[:, 1], C[i])
        found[4 + i, own] = one.C[0]
        found[4 + i, :4] = one.D[0, 1] * C[i]
        place += one.order
    return found


def radius(matrix) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def peak_together(parameters: StageParameters, count: int = 6000) -> float:
    """Return the structured singular value of S of two loops on a grid, in closed form."""
    A, B, C = matrices(parameters)
    angles = np.unique(np.concatenate([np.geomspace(1e-3, np.pi, count), np.linspace(0.2, 0.9, count)]))
    z = np.exp(1j * angles)[:, None, None]
    L = C @ np.linalg.solve(z * np.eye(4) - A, np.broadcast_to(B, (len(z), *B.shape))) / z  # one sample of delay
    for i, one in enumerate(controllers_of(parameters)):
        back = np.broadcast_to(one.B[:, 1:], (len(z), one.order, 1))
        L[:, i] *= -(one.C @ np.linalg.solve(z * np.eye(one.order) - one.A, back) + one.D[:, 1:])[:, 0]
    S = np.linalg.inv(np.eye(2) + L)
    total = np.abs(S[:, 0, 0]) ** 2 + np.abs(S[:, 1, 1]) ** 2 + 2.0 * np.abs(S[:, 0, 1] * S[:, 1, 0])
    size = np.abs(np.linalg.det(S)) ** 2
    return float(np.max(np.sqrt(0.5 * (total + np.sqrt(np.maximum(total**2 - 4.0 * size, 0.0))))))


@pytest.fixture(scope="module")
def designs():
    """Return controllers with integral resonant control for modes at 400 and 800 Hz, each without the other axis."""
    return design_controllers(coupled((400.0, 800.0), (0.0,) * 4), DesignRequest("pid", damping="irc", noise=5e-9), {})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_integral_resonant_control_of_each_axis_is_stable_with_modes_shared_by_both_directions(designs, seed):
    """Cross-talk of 10 to 30 % of actuators and sensors, with either sign."""
    rng = np.random.default_rng(seed)
    cross = rng.uniform(0.1, 0.3, 4) * rng.choice([-1.0, 1.0], 4)
    parameters = with_designs(coupled((400.0, 800.0), cross), designs)
    for slowness in (1.0, 0.9, 0.95, 1.05, 1.1):
        assert radius(closed_loop(parameters, 2, slowness)) < 1.0, slowness
    peak = peak_together(parameters)
    found = disk_margins(stage_loop(parameters), SAMPLE_TIME, skew=1.0).together
    assert 1.0 / found.alpha == pytest.approx(peak, rel=1e-4) and peak < REQUIRED.sensitivity_peak
    assert unmet_together(parameters) == ""
    worst = max(peak_together(slower_structure(parameters, slowness), 1000) for slowness in (0.9, 1.1))
    assert bool(unmet_together(parameters, 0.1)) == (worst > REQUIRED.sensitivity_peak)


def test_a_structure_with_longer_times_is_that_of_its_differential_equation():
    parameters = coupled((400.0, 800.0), (0.2, -0.1, 0.3, 0.1))
    slower = slower_structure(parameters, 1.1)
    (A, B, C), (own, into, _) = matrices(slower), matrices(coupled((400.0 / 1.1, 800.0 / 1.1), (0.2, -0.1, 0.3, 0.1)))
    z = np.exp(1j * np.array([0.01, 0.2, 0.35, 1.0]))[:, None, None] * np.eye(4)
    np.testing.assert_allclose(C @ np.linalg.solve(z - A, B), C @ np.linalg.solve(z - own, into), rtol=1e-6, atol=1e-9)
    # a file may have only the blocks of the state matrix
    blocks = slower_structure(stage(), 0.9).stage.structure.state_matrix
    poles = np.abs(np.log(np.linalg.eigvals(blocks))) / (2.0 * np.pi * SAMPLE_TIME)
    assert np.sort(poles) == pytest.approx([700.0 / 0.9] * 2 + [800.0 / 0.9] * 2)


@pytest.mark.slow
def test_what_is_unmet_together_is_said_in_turn(designs):
    cross = (0.2, 0.2, 0.2, 0.2)
    parameters = coupled((400.0, 800.0), cross)
    crossed = replace(parameters, stage=replace(parameters.stage, decoupling=(0.0, 1.0, 1.0, 0.0)))
    assert radius(closed_loop(with_designs(crossed, designs), 1)) >= 1.0
    assert unmet_together(with_designs(crossed, designs)) == "all loops together are unstable"
    plain = design_controllers(coupled((400.0, 800.0), (0.0,) * 4), DesignRequest("pid", damping="none"), {})
    late = with_designs(coupled((400.0, 800.0), (0.2, -0.2, 0.2, -0.2)), plain)
    assert radius(closed_loop(late, 1)) < 1.0 < radius(closed_loop(late, 2))
    assert unmet_together(late) == "all loops together are unstable with one more sample of delay"
    sharp = next(
        found
        for factor in np.geomspace(1.0, 6.0, 60)
        if peak_together(found := with_designs(parameters, scaled(designs, factor)), 600) > 2.02
    )
    assert radius(closed_loop(sharp, 2)) < 1.0
    assert unmet_together(sharp) == f"M_s {peak_together(sharp):.3g} of all loops together above 2"


@pytest.mark.slow
def test_a_damping_that_the_other_axis_does_not_permit_is_made_weaker(monkeypatch):
    """Positive position feedback of each axis alone has M_s 1.9; with 15 to 30 % of cross-talk both have 2.27."""
    parameters = coupled((400.0, 800.0), (-0.3, 0.15, 0.27, 0.22))
    asked = DesignRequest("pid", damping="ppf", noise=5e-9)
    monkeypatch.setattr(dampings, "POINTS", {3: 4})  # a coarse search: four points of each parameter
    monkeypatch.setattr(coupled_designs, "SHARES", (1.0, 0.6))  # of the slower laws, which do not suffice, only one
    once = functools.cache(design_axis)  # the design of the stage begins with those of the axes alone
    monkeypatch.setattr(coupled_designs, "design_axis", once)
    alone = {name: once(axis, asked, None) for name, axis in zip(parameters.names, parameters.axes, strict=True)}
    first = peak_together(with_designs(parameters, alone))
    assert first > 2.1
    found = design_controllers(parameters, asked, {})
    stage_ = with_designs(parameters, found)
    assert peak_together(stage_) <= 2.0
    for slowness in (1.0, 0.9, 0.95, 1.05, 1.1):
        assert radius(closed_loop(stage_, 2, slowness)) < 1.0, slowness
    for name, design in found.items():
        assert design.parameters.damping.type == "ppf" and design.margins.bandwidth > 100.0
        assert design.parameters.damping != alone[name].parameters.damping
        said = f"; otherwise M_s {first:.3g} of all loops together above 2"
        assert "note: the damping ppf is weaker, its M_s at most " in "\n".join(design_lines(design))
        assert said in "\n".join(design_lines(design))


@pytest.mark.slow
def test_a_law_without_damping_is_stable_with_a_sample_of_delay_in_all_loops():
    """Each law alone is stable with it; with 20 % of cross-talk both together are unstable."""
    parameters = coupled((400.0, 800.0), (0.2, -0.2, 0.2, -0.2))
    found = design_controllers(parameters, DesignRequest("pid", damping="none"), {})
    slower = with_designs(parameters, found)
    assert radius(closed_loop(slower, 1)) < 1.0 and radius(closed_loop(slower, 2)) < 1.0
    assert peak_together(slower) <= 2.0
    said = "otherwise all loops together are unstable with one more sample of delay"
    assert all(one.together.startswith("the controller is slower") and said in one.together for one in found.values())


@pytest.mark.slow
def test_what_a_requested_bandwidth_does_not_permit_together_is_said_and_kept(monkeypatch):
    monkeypatch.setattr(coupled_designs, "unmet_together", lambda *given: "M_s 3 of all loops together above 2")
    found = design_controllers(stage(), DesignRequest("pid", bandwidth=50.0), {}, "x")
    assert found["x"].parameters.damping == stage().axes[0].motion_controller.damping
    assert any(text.startswith("requirements not met: M_s 3 of all loops together") for text in doubts(found["x"]))


def times(control, factor: float):
    """Return a controller with all gains of its law multiplied."""
    gains = {name: factor * getattr(control.pid, name) for name in ("Kp", "Ki", "Kd")}
    return replace(control, pid=replace(control.pid, **gains))


def scaled(designs, factor: float) -> dict:
    return {name: replace(one, parameters=times(one.parameters, factor)) for name, one in designs.items()}
