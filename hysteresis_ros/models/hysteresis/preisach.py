# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Preisach hysteresis: a discrete Everett map with interpolation and a bounded memory of turning points.

.. math::

   x = x_0 + s V + E(v_1, m_0) - E(v_1, m_1) + E(v_2, m_1) - \cdots

with the stored maxima v and minima m, offset x_0 and reversible slope s. The Everett function ``E(a, b)`` is the change
of the output when the input, coming from below, reverses at ``a`` and falls to ``b``. For any history, a rise from a
minimum m to v adds ``E(v, m)``, and a fall from a maximum M to v subtracts ``E(M, v)`` (congruency). When a loop
closes, it is removed from the memory (wiping-out). The table gives E at the nodes of a triangular grid. Between the
nodes, E is interpolated bilinearly; in the triangles at the diagonal, linearly.

Outside the range of the grid the memory does not change, and the output continues with the slope at the end of the
major loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    DISPLACEMENT,
    MOST_CELLS,
    VOLTAGE,
    Deviation,
    HysteresisModel,
    Option,
    RateIndependentBlock,
    plus,
    times,
)

# Layout of p, followed by the lower triangle of E row by row: E[i, j], a = node i, b = node j <= i.
LOW = 0
HIGH = 1
SPACING = 2
NODES = 3
SLOPE = 4  # reversible part [m/V]
OFFSET = 5
CAPACITY = 6
SLOPE_BELOW = 7  # slopes outside the grid [m/V]
SLOPE_ABOVE = 8
TABLE = 9

# Layout of x, after VOLTAGE and DISPLACEMENT. The voltages of the turning points follow (minimum, maximum, minimum …;
# the first minimum is the lower end of the range), and then the hysteretic outputs at these points.
DEPTH = 2  # number of turning points
RESIDUE = 3  # offset [m] after a retune or a removed loop; it fades out while the voltage travels by RESIDUE_LEFT
RESIDUE_LEFT = 4  # remaining travel of the voltage [V] until the offset is zero
RESIDUE_TRAVEL = 5
STACK = 6


@dataclass(frozen=True)
class PreisachParameters(Parameters):
    """Everett map on a triangular grid, SI units."""

    voltage_low: float = parameter(description="lower end of the grid", unit="V")
    voltage_high: float = parameter(description="upper end of the grid", unit="V")
    everett: tuple[float, ...] = parameter(
        description="E(a, b), a >= b, at n equidistant nodes: a row for each a, in rising order; n (n + 1)/2 numbers",
        unit="m",
    )
    slope: float = parameter(0.0, description="reversible part: slope without hysteresis", unit="m/V", low=0.0)
    offset: float = parameter(0.0, description="displacement at voltage_low in negative saturation", unit="m")
    memory: int = parameter(64, description="number of stored turning points", low=4, high=10000, read_only=True)

    @property
    def nodes(self) -> int:
        """Number of nodes n on each side of the triangle."""
        return int(((8 * len(self.everett) + 1) ** 0.5 - 1) / 2)

    @property
    def structure(self) -> dict[str, int]:
        """Structure that cannot change while running."""
        return {"everett": len(self.everett), "memory": self.memory}

    @property
    def table_of_everett(self) -> np.ndarray:
        """The map as a matrix, shape (n, n), zero above the diagonal."""
        n = self.nodes
        table = np.zeros((n, n))
        table[np.tril_indices(n)] = self.everett
        return table

    def check(self):
        """Yield a Problem for a wrong range or size, a nonzero diagonal, or branches that are not monotone."""
        if not self.voltage_low <= 0.0 < self.voltage_high:
            remedy = (
                "voltage_low … voltage_high must contain 0 V, at which the model starts; voltage_low = "
                f"{self.voltage_low:g}"
            )
            yield Problem("voltage_high", self.voltage_high, remedy)
        n = self.nodes
        if n < 2 or n * (n + 1) // 2 != len(self.everett):
            remedy = "must be n (n + 1)/2 numbers, n >= 2: rows of 1, 2, 3 … values"
            yield Problem("everett", f"{len(self.everett)} numbers", remedy)
            return
        table = self.table_of_everett
        if np.any(np.diag(table) != 0.0):
            yield Problem("everett", "E(a, a)", "must be 0: the last number of each row")
            return
        up = min(np.diff(table[:, j])[j:].min() for j in range(n - 1))
        down = min((-np.diff(table[i, : i + 1])).min() for i in range(1, n))
        smallest = min(up, down)
        if smallest < 0.0 or (smallest == 0.0 and self.slope == 0.0):
            remedy = (
                f"must rise with a and fall with b everywhere (smallest difference of neighbours {smallest:.3g} m); "
                "make it monotone; if it is level somewhere, slope > 0 is sufficient"
            )
            yield Problem("everett", f"{n} x {n} nodes", remedy)


@kernel
def everett(p, a, b):
    """Return the Everett function [m] for a maximum ``a`` and a minimum ``b`` [V] within the grid."""
    if a <= b:
        return 0.0
    spacing = p[SPACING]
    last = int(p[NODES]) - 2
    place_a, place_b = (a - p[LOW]) / spacing, (b - p[LOW]) / spacing
    i, j = min(int(place_a), last), min(int(place_b), last)
    s, t = place_a - i, place_b - j
    lower = TABLE + (i * (i + 1)) // 2 + j  # E[i, j]
    upper = lower + i + 1  # E[i + 1, j]
    if i == j:
        return p[upper] * (s - t)
    left = p[lower] + s * (p[upper] - p[lower])
    right = p[lower + 1] + s * (p[upper + 1] - p[lower + 1])
    return left + t * (right - left)


@kernel
def _forget(x, travel, value):
    """Add ``value`` [m] to the output and fade it out over ``travel`` [V]."""
    x[RESIDUE] = value
    x[RESIDUE_LEFT] = x[RESIDUE_TRAVEL] = travel


@kernel
def _residue(x, distance):
    left = x[RESIDUE_LEFT]
    if left <= 0.0:
        return 0.0
    left = max(left - distance, 0.0)
    x[RESIDUE_LEFT] = left
    return x[RESIDUE] * (left / x[RESIDUE_TRAVEL])


@kernel
def _inside(p, voltage):
    return max(p[LOW], min(p[HIGH], voltage))


@kernel
def _on_branch(p, x, v):
    """Return the hysteretic output [m] on the branch from the last turning point to ``v``."""
    top = int(x[DEPTH]) - 1
    turn, output = x[STACK + top], x[STACK + int(p[CAPACITY]) + top]
    if top % 2 == 0:
        return output + everett(p, v, turn)
    return output - everett(p, turn, v)


@kernel
def _turn(p, x, v):
    """Make the hysteretic point at ``v`` a turning point; if the memory is full, remove the innermost loop instead."""
    capacity = int(p[CAPACITY])
    depth = int(x[DEPTH])
    output = _on_branch(p, x, v)
    if depth == capacity:
        x[DEPTH] = depth - 1
        present = x[RESIDUE] * (x[RESIDUE_LEFT] / x[RESIDUE_TRAVEL]) if x[RESIDUE_LEFT] > 0.0 else 0.0
        _forget(x, p[HIGH] - p[LOW], present + output - _on_branch(p, x, v))
        return
    x[STACK + depth] = v
    x[STACK + capacity + depth] = output
    x[DEPTH] = depth + 1


@kernel
def preisach(p, x, u):
    """Return the displacement [m] after a monotone change of the voltage to ``u`` [V]; NaN changes nothing."""
    distance = abs(u - x[VOLTAGE])
    if not distance > 0.0:
        return x[DISPLACEMENT]
    before, v = _inside(p, x[VOLTAGE]), _inside(p, u)
    if v > before:
        if int(x[DEPTH]) % 2 == 0:  # the last turning point is a maximum: this is a reversal
            _turn(p, x, before)
        # wiping-out: if v exceeds the last maximum, this maximum and the minimum after it are removed
        while x[DEPTH] >= 3.0 and v >= x[STACK + int(x[DEPTH]) - 2]:
            x[DEPTH] -= 2.0
    elif v < before:
        if int(x[DEPTH]) % 2 == 1:
            _turn(p, x, before)
        while x[DEPTH] >= 4.0 and v <= x[STACK + int(x[DEPTH]) - 2]:
            x[DEPTH] -= 2.0
        if v <= p[LOW]:
            x[DEPTH] = 1.0
    y = p[OFFSET] + _on_branch(p, x, v) + p[SLOPE] * (u - p[LOW])
    if u > v:
        y += p[SLOPE_ABOVE] * (u - v)
    elif u < v:
        y += p[SLOPE_BELOW] * (u - v)
    x[VOLTAGE] = u
    x[DISPLACEMENT] = y + _residue(x, distance)
    return x[DISPLACEMENT]


def everett_of(block, voltage_low: float, voltage_high: float, nodes: int) -> np.ndarray:
    """Return the Everett map of any hysteresis block, from its first-order reversal curves.

    Parameters
    ----------
    block : Block
        Model, or plant without dynamics; it is reset before each curve.
    voltage_low, voltage_high : float
        Range [V].
    nodes : int
        Number of nodes n over the range.

    Returns
    -------
    ndarray, shape (n (n + 1)/2,)
        Values [m] in the order of ``PreisachParameters.everett``.
    """
    grid = np.linspace(voltage_low, voltage_high, nodes)
    rows = []
    for i in range(nodes):
        block.reset()
        block.simulate([voltage_high, voltage_low])
        y = block.simulate(np.append(grid[: i + 1], grid[:i][::-1]))
        rows.append(np.append((y[i] - y[i:])[::-1][:-1], 0.0))
    return np.concatenate(rows)


class PreisachHysteresis(RateIndependentBlock):
    """Preisach hysteresis: voltage [V] to displacement [m].

    The model starts at 0 V, on the rising branch from negative saturation.

    The inverse ``general`` is exact to rounding.

    Parameters
    ----------
    parameters : PreisachParameters
        Everett map.
    sample_time : float
        Sample time [s], not used.
    """

    kernel = staticmethod(preisach)

    def pack(self, parameters: PreisachParameters) -> np.ndarray:
        """Return p, shape (9 + n (n + 1)/2,)."""
        low, high, n = parameters.voltage_low, parameters.voltage_high, parameters.nodes
        spacing = (high - low) / (n - 1)
        table = parameters.table_of_everett
        head = [low, high, spacing, n, parameters.slope, parameters.offset, parameters.memory]
        below, above = table[-1, 0] - table[-1, 1], table[-1, 0] - table[-2, 0]
        return np.concatenate([[*head, below / spacing, above / spacing], parameters.everett])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (6 + 2 memory,)."""
        p, capacity = self.p, int(self.p[CAPACITY])
        x = np.zeros(STACK + 2 * capacity)
        x[STACK] = p[LOW]
        x[DEPTH] = 1.0
        x[DISPLACEMENT] = p[OFFSET] + _on_branch(p, x, 0.0) - p[SLOPE] * p[LOW]
        return x

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]: height of the major loop divided by its width."""
        p = self.p
        return float(p[SLOPE] + everett(p, p[HIGH], p[LOW]) / (p[HIGH] - p[LOW]))

    def rebase(self) -> None:
        """Apply the changed map to the stored turning points; the jump of the output fades out.

        It decreases linearly to zero while the voltage travels by the width of the range.
        """
        x, p, capacity = self.x, self.p, int(self.p[CAPACITY])
        depth, output = int(x[DEPTH]), x[DISPLACEMENT]
        x[STACK] = p[LOW]
        x[STACK + capacity] = 0.0
        x[STACK + 1 : STACK + depth] = np.clip(x[STACK + 1 : STACK + depth], p[LOW], p[HIGH])
        for k in range(1, depth):
            x[DEPTH] = k
            x[STACK + capacity + k] = _on_branch(p, x, x[STACK + k])
        x[DEPTH] = depth
        u = x[VOLTAGE]
        v = _inside(p, u)
        outside = (p[SLOPE_ABOVE] if u > v else p[SLOPE_BELOW]) * (u - v)
        model = p[OFFSET] + _on_branch(p, x, v) + p[SLOPE] * (u - p[LOW]) + outside
        _forget(x, p[HIGH] - p[LOW], output - model)


def _scaled(parameters: PreisachParameters, factor: float) -> PreisachParameters:
    return times(parameters, factor, "everett", "slope", "offset")


def _shifted(parameters: PreisachParameters, offset: float) -> PreisachParameters:
    return plus(parameters, offset, "offset")


def _deviated(parameters: PreisachParameters, deviation: Deviation) -> PreisachParameters:
    everett = np.array(parameters.everett) * deviation.gain * deviation.opening
    return replace(parameters, everett=tuple(everett.tolist()), slope=parameters.slope * deviation.gain)


def _example(low: float = -40.0, high: float = 120.0, nodes: int = 9) -> PreisachParameters:
    """Return an example with Rayleigh's law: constant density, E(a, b) = c (a - b)²; displacement 0 at rest at 0 V."""
    spacing, slope, density = (high - low) / (nodes - 1), 70e-9, 0.15e-9
    everett = tuple(density * ((i - j) * spacing) ** 2 for i in range(nodes) for j in range(i + 1))
    offset = slope * low - density * low**2
    return PreisachParameters(voltage_low=low, voltage_high=high, everett=everett, slope=slope, offset=offset)


MODEL = HysteresisModel(
    name="preisach",
    title="discrete Everett map with interpolation, wiping-out and return-point memory",
    data="a voltage that rises and falls; loops of several amplitudes determine the model inside the largest loop",
    parameters=PreisachParameters,
    block=PreisachHysteresis,
    example=_example(),
    scaled=_scaled,
    shifted=_shifted,
    deviated=_deviated,
    inverses=("general", "picard_steps", "none"),
    identify="hysteresis_ros.identification.procedures:preisach",
    options={
        "widths": Option(int, "widths of elementary loops at which the density has a weight", low=1, high=MOST_CELLS),
        "nodes": Option(int, "nodes of the map on each side", low=2, high=MOST_CELLS),
        "density": Option(
            str,
            "linear in the bias of a loop, or free: a weight for each cell, for loops that saturate or are asymmetric",
            choices=("linear", "free"),
        ),
    },
)
