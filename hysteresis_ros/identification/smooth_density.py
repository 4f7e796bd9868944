# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prandtl-Ishlinskii models with a smooth density of the plays and an asymmetric map behind them.

Few numbers instead of a weight for each play: a reversible part (a share ρ of the motion), a density that falls
exponentially with the radius, ``w(r) = B exp(-κ r/h)`` (h: half the range of the voltage), and a cubic map
``s(u) = u + a (u² - 1)/2 + b (u³ - u)/2`` of their sum u, scaled to -1 … 1 over the recording. The map bends both
branches alike, which plays cannot. ρ, κ, a and b are searched with the linear part, scale and constant follow by
least squares.

Loops of one amplitude hardly tell κ from the map: it is held at :data:`PRIOR_DECAY`, what stacks of other makers show,
unless the recording lowers the residual by :data:`SETTLED` with another one. The density is realised by plays, the map
by dead zones, so nodes run the model as any other one of this kind.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.condensed import Condensed
from hysteresis_ros.identification.hammerstein import PartSearch, search_linear_part, split_values
from hysteresis_ros.identification.weights import radii
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters

#: κ where the data cannot tell: the prior, and the range in which it is searched.
PRIOR_DECAY = 1.9
DECAYS = (-1.0, 8.0)
#: Another κ is taken when it lowers the RMS residual by this part.
SETTLED = 0.03
#: Start and range of the other numbers; within them the map rises everywhere.
SHAPE = (
    ("elastic_share", 0.6, 0.02, 1.0),
    ("map_slope", 0.0, -0.7, 0.7),
    ("map_curvature", 0.0, -0.25, 0.4),
)
#: Straight pieces of the map over the recording; bends smaller than this part of a slope are none.
PIECES = 16
TINY = 1e-9


class SmoothDensity:
    """Exponential density and cubic map on one set of data.

    Parameters
    ----------
    data : Condensed
    play_count : int
        Plays that stand for the density, up to half the range of the voltage.
    """

    def __init__(self, data: Condensed, play_count: int):
        self.data, self.play_count = data, play_count
        step = 0.5 * data.voltage_range / play_count
        self.half = 0.5 * data.voltage_range
        self.radii = radii(data.voltage_range, play_count, data.reach) + 0.5 * step
        self.plays = data.plays(self.radii)
        self.numbers: dict[str, float] = {}

    def fit(self, linear, progress):
        """Search linear part and shape with κ at its prior, then try whether the data settles it.

        Parameters
        ----------
        linear : sequence of str
        progress : callable or None
        """
        self.decay = PRIOR_DECAY
        search = PartSearch(self.solve, self.data, SHAPE, progress)
        kept, base, held = search_linear_part(search, linear)
        found = held
        free = PartSearch(self.solve, self.data, (*SHAPE, ("decay", PRIOR_DECAY, *DECAYS)), progress)
        settled = free.run(kept, held.values, base)
        self.settled = bool(settled.spread < (1.0 - SETTLED) * held.spread)
        if self.settled:
            found, search = settled, free
        self.kept, self.base, self.found = kept, base, found
        self.part, self.shape = split_values(base, found.values)
        self.deviations, self.converged = found.deviations or {}, found.converged
        self.warnings = tuple(search.at_ends(kept, found.values))
        self.rms = float(np.std(self.solve(self.part, self.shape)))
        self.numbers = {"density_decay": self.shape.get("decay", PRIOR_DECAY)}
        return self

    def behind(self, part, decay: float):
        """Fit the shape for a κ and a linear part that are known.

        Parameters
        ----------
        part : LinearPart
        decay : float
            κ.
        """
        self.decay, self.part = decay, part
        search = PartSearch(lambda _, shape: self.solve(part, shape), self.data, SHAPE, None)
        self.shape = search.run([], {}, part).values
        self.rms = float(np.std(self.solve(part, self.shape)))
        return self

    def solve(self, part, shape) -> np.ndarray:
        """Return the residual [m] of the best scale and constant.

        Parameters
        ----------
        part : LinearPart
        shape : dict of str to float
        """
        data = self.data
        table = np.column_stack([part.apply(self.moved(shape), data.sample_time), data.constants])
        table, target = data.counted(table), data.counted(data.displacement)
        solution = np.linalg.lstsq(table, target, rcond=None)[0]
        self.scale, self.constants = float(solution[0]), solution[1:]
        return target - table @ solution

    def moved(self, shape) -> np.ndarray:
        """Return what the linear part gets, shape (N,), at unit scale and zero at rest.

        Parameters
        ----------
        shape : dict of str to float
        """
        weights = self._weights(shape)
        sums = self.data.voltage * weights[0] + self.plays @ weights[1:]
        counted = sums[self.data.first :]
        self.centre, self.span = 0.5 * float(counted.max() + counted.min()), 0.5 * float(np.ptp(counted))
        return self._map(sums, shape) - self._map(0.0, shape)

    def _weights(self, shape) -> np.ndarray:
        """Weights of the voltage and of the plays; both parts move by about their share over the range."""
        density = np.exp(-shape.get("decay", self.decay) * self.radii / self.half)
        moving = np.maximum(2.0 * (self.half - self.radii), 0.0) @ density
        share = shape["elastic_share"]
        return np.append(share / (2.0 * self.half), (1.0 - share) * density / moving)

    def _map(self, sums, shape):
        u = (sums - self.centre) / self.span
        inside = np.clip(u, -1.0, 1.0)  # beyond the recording it goes on straight
        bent = 0.5 * shape["map_slope"] * (inside**2 - 1.0) + 0.5 * shape["map_curvature"] * (inside**3 - inside)
        end = shape["map_slope"] * inside + shape["map_curvature"] * (1.5 * inside**2 - 0.5)
        return u + bent + end * (u - inside)

    def like(self, data: Condensed):
        """Return the same structure for other data, not fitted yet.

        Parameters
        ----------
        data : Condensed
        """
        return SmoothDensity(data, self.play_count)

    def refitted(self, data: Condensed):
        """Return the model fitted to other samples of the recording, from the numbers found.

        Parameters
        ----------
        data : Condensed
        """
        other = copy(self)
        other.data = data
        extra = (*SHAPE, ("decay", PRIOR_DECAY, *DECAYS)) if self.settled else SHAPE
        found = PartSearch(other.solve, data, extra, None).run(self.kept, self.found.values, self.base)
        other.part, other.shape = split_values(self.base, found.values)
        other.solve(other.part, other.shape)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        moved = self.part.apply(self.moved(self.shape), self.data.sample_time)
        return self.scale * moved + self.data.constants @ self.constants

    def parameters(self) -> HysteresisParameters:
        """Return density and map as plays and dead zones.

        Raises
        ------
        IdentificationError
            The displacement falls where the voltage rises.
        """
        if not self.scale > 0.0:
            raise IdentificationError("the displacement falls where the voltage rises; check the columns, or --negate")
        low, high = min(self.centre - self.span, 0.0), max(self.centre + self.span, 0.0)
        width = (high - low) / PIECES
        above, rising = self._pieces(width, high)
        below, falling = self._pieces(-width, low)
        first = float(rising[0]) if len(rising) else float(falling[0])
        # a corner at rest itself belongs to the side above; the side below starts just under it
        corners = np.append(above[1:], np.where(below == 0.0, -TINY * (high - low), below))
        steps = np.append(np.diff(rising), np.diff(falling, prepend=first)) / first
        bends = np.abs(steps) > TINY
        weights = self._weights(self.shape) * first
        parameters = PrandtlIshlinskiiParameters(
            radii=(0.0, *self.radii.tolist()),
            weights=tuple(weights.tolist()),
            thresholds=tuple((first * corners[bends]).tolist()),
            zone_weights=tuple(steps[bends].tolist()),
            offset=float(self.constants[0]) / self.part.settled_gain,
        )
        return HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters)

    def _pieces(self, width: float, end: float):
        """Return inner corners and slopes of the scaled map in straight pieces from rest to ``end``."""
        count = int(np.ceil(end / width - 1e-9))
        corners = width * np.arange(count + 1)
        heights = self.scale * self._map(corners, self.shape)
        return corners[:-1], np.diff(heights) / width
