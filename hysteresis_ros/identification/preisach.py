# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Preisach models from data, together with lag, delay and creep.

One large loop does not determine a Preisach density over two variables, so the fit uses the simplest density for such
loops: a constant reversible slope, and a density that is a free (smooth, non-negative) function of the width of an
elementary loop and linear in its bias. The Everett map of such a density is that of plays driven by the mapped voltage
``g(V) = V + κ ((V - c)²/h - h)`` (c and h: centre and half width of the range): the weights follow by linear least
squares (:mod:`.play_fit`), and κ is searched with the linear part. With equal weights this is Rayleigh's law.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.identification.hammerstein import HammersteinFit, robust_fit, without_drift
from hysteresis_ros.identification.play_fit import PlayFit, radii
from hysteresis_ros.identification.preprocessing import Condensed, plays
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.preisach import PreisachParameters

WIDTHS = 24
NODES = 33
#: Fraction of the range by which the map exceeds the data on each side.
BEYOND = 0.01
#: Largest magnitude of κ, the dependence of the density on the bias. g(V), see above, is monotone up to 0.5.
LARGEST_BIAS = 0.4


def fit_preisach(
    voltage,
    displacement,
    sample_time: float,
    *,
    widths: int = WIDTHS,
    nodes: int = NODES,
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    history: tuple[float, ...] = (),
    progress=None,
) -> HammersteinFit:
    """Fit voltage → Preisach map → creep → lag and delay.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """

    def choose(data):
        return without_drift(lambda data: Density(data, widths, nodes).fit(linear, progress), data)

    return robust_fit(voltage, displacement, sample_time, choose, skip=skip, history=history)[0]


class Density(PlayFit):
    """Weights over the width of elementary loops, and their dependence on the bias."""

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
        # second differences of the density, for steps of the width in units of half the range
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
        # from the lower end up to 0 V: the initial state of the Preisach block
        start = np.maximum(bottom + self.radii, rest - self.radii)
        before = plays(self.bent(np.array([0.0, *self.data.history]), bias), self.radii, start)[-1]
        return np.column_stack([voltage, plays(g, self.radii, before) - start])

    def parameters(self) -> HysteresisParameters:
        """Return slope and Everett map E(a, b) = Σ w max(0, g(a) - g(b) - 2 r)."""
        nodes = self.nodes
        voltages = np.linspace(self.low, self.high, nodes)
        grid = self.bent(voltages, self.shape["bias"])
        table = np.zeros((nodes, nodes))
        for weight, radius in zip(self.weights[1:], self.radii, strict=True):
            table += weight * np.maximum(grid[:, None] - grid[None, :] - 2.0 * radius, 0.0)
        slope = max(float(self.weights[0]), 1e-6 * float(self.weights.sum()))
        # the block's output is relative to its lower end, the regressors are relative to 0 V
        rest = float(np.interp(0.0, voltages, table[:, 0])) - slope * self.low
        parameters = PreisachParameters(
            voltage_low=self.low,
            voltage_high=self.high,
            everett=tuple(table[np.tril_indices(nodes)].tolist()),
            slope=slope,
            offset=float(self.constants[0]) / self.part.settled_gain - rest,
        )
        return HysteresisParameters(type="preisach", preisach=parameters)
