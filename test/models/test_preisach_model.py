# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Preisach: a discrete Everett map replaces another model, limited memory, what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.hysteresis.preisach import DEPTH, PreisachHysteresis, PreisachParameters, everett, everett_of

#: Its corners lie on the nodes of a grid of 5 V, where interpolation is exact.
PLAYS = PrandtlIshlinskiiParameters(radii=(0.0, 5.0, 15.0, 30.0), weights=(60e-9, 20e-9, 15e-9, 10e-9))


def parameters(nodes=25, **changes):
    plays = PrandtlIshlinskiiHysteresis(PLAYS, 1e-3)
    return PreisachParameters(
        voltage_low=0.0, voltage_high=120.0, everett=tuple(everett_of(plays, 0.0, 120.0, nodes)), **changes
    )


def saturated(block):
    """Bring a play model to the initial state of the Preisach model: rising from its lower end."""
    block.simulate([120.0, 0.0])
    return block


@pytest.mark.slow
@settings(max_examples=60)
@given(turns=st.lists(st.integers(0, 24), min_size=1, max_size=12))
def test_map_of_a_play_model_gives_its_outputs(turns):
    voltages = 5.0 * np.array(turns)
    plays = saturated(PrandtlIshlinskiiHysteresis(PLAYS, 1e-3))
    expected = plays.simulate(voltages) - saturated(PrandtlIshlinskiiHysteresis(PLAYS, 1e-3)).x[1]
    np.testing.assert_allclose(PreisachHysteresis(parameters(), 1e-3).simulate(voltages), expected, atol=1e-18)


def relays(voltages, table):
    """Outputs of the sum of relays that Preisach's model is: each is switched up at its a, down at its b ≤ a.

    The weight of the relay whose a and b lie in the cell is the mixed difference of the Everett map, E(a, b) being the
    change of the output from all relays that a rise from b to a switches.
    """
    n = len(table)
    up = np.zeros((n, n), dtype=bool)
    weights = np.zeros((n, n))
    for i in range(1, n):  # up from node i on, down from node j on
        for j in range(i):
            weights[i, j] = (table[i, j] - table[i - 1, j]) - (table[i, j + 1] - table[i - 1, j + 1])
    outputs, before = [], 0
    for v in voltages:
        for node in range(before + 1, v + 1):
            up[node, :] = True
        for node in range(before - 1, v - 1, -1):
            up[:, node] = False
        before = v
        outputs.append(weights[up].sum())
    return np.array(outputs)


@pytest.mark.parametrize("memory", [7, 64])  # at most 7 turning points
def test_loops_within_loops_are_those_of_relays(memory):
    """With every number of turning points, every next voltage and every one after it: on them and between them."""
    given = parameters(nodes=13, memory=memory)
    # Weights that differ from cell to cell: those of plays would hide a turning point that was not removed.
    cells = np.tril(np.random.default_rng(2).uniform(0.0, 1e-7, (13, 13)), -1)
    table = np.zeros((13, 13))
    for i, j in zip(*np.tril_indices(13, -1), strict=True):
        table[i, j] = cells[: i + 1, j:].sum()
    block = PreisachHysteresis(dataclasses.replace(given, everett=tuple(table[np.tril_indices(13)])), 1e-3)
    turns = [11, 3, 9, 5, 7]
    for depth in range(1, len(turns) + 1):
        for following in range(13):
            for last in (0, 2, 5, 8, 10, 12):
                nodes = [*turns[:depth], following, last]
                block.reset()
                np.testing.assert_allclose(block.simulate(10.0 * np.array(nodes)), relays(nodes, table), atol=1e-18)


def test_between_the_nodes_it_interpolates():
    plays = saturated(PrandtlIshlinskiiHysteresis(PLAYS, 1e-3))
    start = plays.x[1]
    drive = 60.0 + 60.0 * np.cos(0.01 * np.arange(3000)) * np.exp(-0.001 * np.arange(3000))
    error = PreisachHysteresis(parameters(), 1e-3).simulate(drive) - (plays.simulate(drive) - start)
    assert np.abs(error).max() < 0.02 * 12e-6


def test_everett_function_is_zero_on_the_diagonal_and_continuous_across_cells():
    p = PreisachHysteresis(parameters(nodes=5), 1e-3).p
    rng = np.random.default_rng(3)
    assert everett(p, 47.0, 47.0) == 0.0
    for a, b in np.sort(rng.uniform(0.0, 120.0, (200, 2)))[:, ::-1]:
        assert abs(everett(p, min(a + 1e-7, 120.0), b) - everett(p, a, b)) < 1e-13
    for node in (30.0, 60.0, 90.0):
        assert everett(p, node + 1e-9, 10.0) == pytest.approx(everett(p, node - 1e-9, 10.0), abs=1e-15)


def test_memory_is_bounded_and_forgetting_is_continuous():
    block = PreisachHysteresis(parameters(memory=6), 1e-3)
    amplitudes = np.linspace(60.0, 1.0, 40)
    turns = 60.0 + amplitudes * np.where(np.arange(40) % 2, -1.0, 1.0)
    drive = np.concatenate([np.linspace(a, b, 200)[1:] for a, b in zip(turns, turns[1:], strict=False)])
    block.step(drive[0])
    y = block.simulate(drive)
    assert block.x[DEPTH] <= 6
    assert np.abs(np.diff(y)).max() < 2.0 * 0.12e-6 * np.abs(np.diff(drive)).max()
    unlimited = PreisachHysteresis(parameters(), 1e-3)
    unlimited.step(drive[0])
    assert np.abs(y - unlimited.simulate(drive)).max() < 0.2 * 12e-6
    block.simulate(np.linspace(block.x[0], 0.0, 500))
    block.simulate(np.linspace(0.0, 120.0, 500))
    assert block.x[1] == pytest.approx(block.gain * 120.0, rel=1e-12)


def test_outside_the_grid_it_goes_on_without_memory():
    block = PreisachHysteresis(parameters(slope=1e-9), 1e-3)
    up = block.simulate(np.linspace(100.0, 160.0, 61))
    assert np.all(np.diff(up) > 0.0)
    np.testing.assert_allclose(block.simulate(np.linspace(160.0, 120.0, 41)), up[20:][::-1], rtol=1e-13)
    down = block.simulate(np.linspace(120.0, -40.0, 161))
    assert np.all(np.diff(down) < 0.0)
    np.testing.assert_allclose(block.simulate(np.linspace(-40.0, 0.0, 41)), down[120:][::-1], atol=1e-18)


def test_what_is_wrong_is_named():
    good = parameters(nodes=5)
    with pytest.raises(ParameterError, match=r"everett = '14 numbers'.*n \(n \+ 1\)/2"):
        PreisachHysteresis(dataclasses.replace(good, everett=good.everett[:-1]), 1e-3)
    with pytest.raises(ParameterError, match=r"everett.*must be 0"):
        PreisachHysteresis(dataclasses.replace(good, everett=(1e-9, *good.everett[1:])), 1e-3)
    falling = list(good.everett)
    falling[6] = 0.5 * falling[3]
    with pytest.raises(ParameterError, match=r"everett.*rise with a"):
        PreisachHysteresis(dataclasses.replace(good, everett=tuple(falling)), 1e-3)
    with pytest.raises(ParameterError, match=r"voltage_high.*contain 0 V"):
        PreisachHysteresis(dataclasses.replace(good, voltage_low=10.0), 1e-3)
