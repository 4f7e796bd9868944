# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Preisach models from data, together with lag, delay and creep.

One large loop does not determine a Preisach density over two variables. The fit therefore uses a simple density that
such loops determine: a constant reversible slope, and a density that is a free (smooth, non-negative) function of the
width of an elementary loop, and linear in the bias of this loop. Its Everett map is that of plays driven by the mapped
voltage ``g(V) = V + κ ((V - c)²/h - h)`` (c and h: centre and half width of the range). Linear least squares gives the
weights (:mod:`.play_fit`), and κ is searched with the linear part. With equal weights this is Rayleigh's law.

A *free* density (:class:`FreeDensity`) has a weight ≥ 0 for each cell of the plane of thresholds. It describes every
loop with return-point memory and rising branches: loops that saturate, loops with a dead zone, and loops whose branches
differ in shape. Its fit needs loops of several sizes.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.identification.hammerstein import HammersteinFit, require_rising, robust_fit, without_drift
from hysteresis_ros.identification.plant_model import stretches
from hysteresis_ros.identification.play_fit import PlayFit, radii
from hysteresis_ros.identification.preprocessing import Condensed, coarser
from hysteresis_ros.models.declaration import DISPLACEMENT
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.preisach import PreisachHysteresis, PreisachParameters
from hysteresis_ros.models.play_operators import plays

WIDTHS = 24
NODES = 33
#: Default number of cells of a free density along each threshold, over the range of the recording.
FREE_CELLS = 16
#: Largest number of nodes of the map along each threshold.
MOST_NODES = 65
#: Approximate number of samples during the search for the linear part that follows a free density.
SEARCHED = 1500
#: Number of cells along each threshold during the search for the linear part that follows a free density.
SEARCHED_CELLS = 8
#: Fraction of the range by which the map exceeds the data on each side.
BEYOND = 0.01
#: Largest magnitude of κ, the dependence of the density on the bias; g(V) (see above) is monotone for magnitudes up to
#: 0.5.
LARGEST_BIAS = 0.4


def fit_preisach(
    voltage,
    displacement,
    sample_time: float,
    *,
    widths: int = WIDTHS,
    nodes: int = NODES,
    density: str = "linear",
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    history: tuple[float, ...] = (),
    progress=None,
) -> HammersteinFit:
    """Fit voltage → Preisach map → creep → lag and delay.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """

    def structure(data) -> PlayFit:
        return FreeDensity(data) if density == "free" else Density(data, widths, nodes)

    def choose(data):
        return without_drift(lambda data: structure(data).fit(linear, progress), data)

    return robust_fit(voltage, displacement, sample_time, choose, skip=skip, history=history)[0]


class Density(PlayFit):
    """Weights as a function of the width of elementary loops, and their dependence on the bias of the loops."""

    extra = (("bias", 0.0, -LARGEST_BIAS, LARGEST_BIAS),)

    def __init__(self, data: Condensed, widths: int, nodes: int):
        super().__init__(data)
        self.nodes = nodes
        low, high = min(float(data.voltage.min()), 0.0), max(float(data.voltage.max()), 0.0)
        margin = BEYOND * (high - low)
        self.low, self.high = (low - margin if low < 0.0 else 0.0), high + margin
        self.centre, self.half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        spacing = self.half / widths
        self.radii = radii(2.0 * self.half, widths) + 0.5 * spacing
        # second differences of the density, with the width in units of half the range
        self.roughness = np.diff(np.eye(widths + 1), 2, axis=0)[1:] * np.sqrt(widths)

    def bent(self, voltage, bias: float):
        """Return g(V) [V]."""
        offset = np.asarray(voltage, dtype=float) - self.centre
        return voltage + bias * (offset**2 / self.half - self.half)

    def columns(self, shape) -> np.ndarray:
        """Return the regressors, shape (N, 1 + widths): voltage, and plays of g(V), saturated at the lower end."""
        voltage, bias = self.data.voltage, shape["bias"]
        g = self.bent(voltage, bias)
        bottom, rest = self.bent(np.array([self.low, 0.0]), bias)
        # initial state of the Preisach block: the voltage has risen from the lower end of the range to 0 V
        start = np.maximum(bottom + self.radii, rest - self.radii)
        before = plays(self.bent(np.array([0.0, *self.data.history]), bias), self.radii, start)[-1]
        return np.column_stack([voltage, plays(g, self.radii, before) - start])

    def parameters(self) -> HysteresisParameters:
        """Return slope and Everett map E(a, b) = Σ w max(0, g(a) - g(b) - 2 r)."""
        require_rising(float(self.weights.sum()))
        nodes = self.nodes
        voltages = np.linspace(self.low, self.high, nodes)
        grid = self.bent(voltages, self.shape["bias"])
        table = np.zeros((nodes, nodes))
        for weight, radius in zip(self.weights[1:], self.radii, strict=True):
            table += weight * np.maximum(grid[:, None] - grid[None, :] - 2.0 * radius, 0.0)
        slope = max(float(self.weights[0]), 1e-6 * float(self.weights.sum()))
        # the output of the block is relative to its lower end, but the regressors are relative to 0 V
        rest = float(np.interp(0.0, voltages, table[:, 0])) - slope * self.low
        parameters = PreisachParameters(
            voltage_low=self.low,
            voltage_high=self.high,
            everett=tuple(table[np.tril_indices(nodes)].tolist()),
            slope=slope,
            offset=float(self.constants[0]) / self.part.settled_gain - rest,
        )
        return HysteresisParameters(type="preisach", preisach=parameters)


class FreeDensity(PlayFit):
    """Weights of the cells of the Preisach plane, and a reversible slope."""

    def __init__(self, data: Condensed, cells: int = FREE_CELLS):
        super().__init__(data)
        self.cell_count = cells
        low, high = float(data.voltage.min()), float(data.voltage.max())
        # the map includes 0 V, where a model starts; only cells within the recording have weights
        spacing = max((high - low) / cells, (max(high, 0.0) - min(low, 0.0)) / (MOST_NODES - 2))
        below, above = np.ceil(max(low, 0.0) / spacing), np.ceil(max(high - low, -low) / spacing - 1e-9)
        self.low, self.nodes = float(low - spacing * below), int(below + above) + 1
        self.high, self.span = float(self.low + spacing * (self.nodes - 1)), high - low
        first, last = int(below), int(below + np.ceil((high - low) / spacing - 1e-9))
        self.cells = [(i, j) for i in range(first, last) for j in range(first, i + 1)]
        place = {cell: number + 1 for number, cell in enumerate(self.cells)}
        rows = []
        for i, j in self.cells:  # second differences along both thresholds
            for before, after in (((i - 1, j), (i + 1, j)), ((i, j - 1), (i, j + 1))):
                if before in place and after in place:
                    row = np.zeros(len(self.cells) + 1)
                    row[[place[before], place[i, j], place[after]]] = 1.0, -2.0, 1.0
                    rows.append(row)
        self.roughness = np.array(rows).reshape(-1, len(self.cells) + 1) * np.sqrt(cells)
        self.table: np.ndarray | None = None

    def like(self, data: Condensed):
        """Return an unfitted model of the same structure for other data."""
        other = FreeDensity(data, self.cell_count)
        other.guess = dict(self.found.values)
        return other

    def fit(self, linear, progress):
        """Search the linear part with few cells on coarse data, then compute all weights on all data."""
        if self.cell_count <= SEARCHED_CELLS:
            return super().fit(linear, progress)
        return self._with(self._coarse().fit(linear, progress))

    def settle(self, before, progress):
        """Search the parameters of a linear part with known structure, first with few cells as :meth:`fit` does."""
        if self.cell_count <= SEARCHED_CELLS:
            return super().settle(before, progress)
        return self._with(self._coarse().settle(before, progress))

    def _coarse(self) -> FreeDensity:
        """Return a fit with few cells on coarse data."""
        found = FreeDensity(coarser(self.data, SEARCHED), SEARCHED_CELLS)
        found.guess = self.guess
        return found

    def _with(self, found: FreeDensity):
        """Compute all weights with the linear part of the fit ``found``."""
        self.kept, self.base, self.found, self.part, self.shape = (
            found.kept, found.base, found.found, found.part, found.shape
        )  # fmt: skip
        self.deviations, self.converged, self.warnings = found.deviations, found.converged, found.warnings
        self.rms = float(np.std(self.solve_weights(self.part, self.shape)))
        return self

    def columns(self, shape) -> np.ndarray:
        """Return the voltage divided by its range, and the output of each cell with weight 1, shape (N, 1 + cells)."""
        if self.table is None:
            found = [self.data.voltage / self.span]
            for number in range(len(self.cells)):
                weights = np.zeros(len(self.cells))
                weights[number] = 1.0
                block = PreisachHysteresis(self.map(weights, 1.0), self.data.sample_time)
                rest = float(block.x[DISPLACEMENT])
                block.simulate(stretches(self.data.history))
                found.append(block.simulate(self.data.voltage) - rest - self.data.voltage)
            self.table = np.column_stack(found)
        return self.table

    def map(self, weights, slope: float, offset: float = 0.0) -> PreisachParameters:
        """Return the Everett map for the weights of the cells."""
        density = np.zeros((self.nodes, self.nodes))
        for weight, (i, j) in zip(weights, self.cells, strict=True):
            density[i + 1, j] = weight
        table = np.cumsum(np.cumsum(density, axis=0)[:, ::-1], axis=1)[:, ::-1]
        everett = tuple(np.tril(table, -1)[np.tril_indices(self.nodes)].tolist())
        return PreisachParameters(self.low, self.high, everett, float(slope), float(offset))

    def parameters(self) -> HysteresisParameters:
        """Return slope and Everett map."""
        require_rising(float(self.weights.sum()))
        slope = max(float(self.weights[0]), 1e-6 * float(self.weights.sum())) / self.span
        bare = PreisachHysteresis(self.map(self.weights[1:], slope), self.data.sample_time)
        offset = float(self.constants[0]) / self.part.settled_gain - float(bare.x[DISPLACEMENT])
        return HysteresisParameters(type="preisach", preisach=self.map(self.weights[1:], slope, offset))
