# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prandtl-Ishlinskii models from data, with lag, delay and creep: smooth density, classical or modified.

Three structures are compared. A structure with more freedom is chosen only if it predicts held-out blocks of the
recording better (:func:`.hammerstein.survivor`).

*Smooth density* (few parameters): a reversible part (a fraction ρ of the motion) and plays with a density that falls
exponentially with the radius, ``w(r) = B exp(-κ r/h)`` (h: half the range of the voltage). The sum u of both, scaled to
-1 … 1 over the recording, passes through a cubic map ``s(u) = u + a (u² - 1)/2 + b (u³ - u)/2``. The map bends both
branches equally, which plays cannot do. ρ, a, b and possibly κ are searched with the linear part; least squares gives
scale and constant. Loops of a single amplitude hardly distinguish κ from the map. κ therefore keeps the value
:data:`PRIOR_DECAY`, which is typical of piezo stacks, unless another value reduces the residual by
:data:`.thresholds.DENSITY_DECAY`. The density is realised by plays and the map by dead zones, so nodes run this model
like any other Prandtl-Ishlinskii model.

*Non-parametric density*: an individual weight ≥ 0 for each play, by linear least squares (:mod:`.play_fit`).
*Modified*: dead zones in series after the plays bend both branches equally. The output is bilinear in the weights of
plays and dead zones. A few Gauss-Newton steps give the weights; each step is a constrained linear problem.

*Ambiguity* of a recording: let f be the reversible part with the map, and W(r) the sum of the weights of plays up to
radius r. A periodic loop between 0 and V has the slope f'(v) + W(v/2) on its rising branch and f'(v) + W((V - v)/2) on
its falling branch. A change of W that is symmetric about r = V/4 can therefore be compensated by a change of f' and
cannot be observed, although it changes the gain of smaller loops. To find such changes, densities ``exp(-κ r/h)`` with
several κ are fitted with the identified linear part, each with its own map. All densities that fit about as well as the
best one are possible; their differences on smaller loops are the remaining uncertainty.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.hammerstein import (
    HammersteinFit,
    PartSearch,
    PartTrial,
    judged_again,
    require_rising,
    robust_fit,
    search_linear_part,
    split_values,
    survivor,
    usable,
    without_drift,
)
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.parameter_file import SMALL_LOOP_GAIN
from hysteresis_ros.identification.play_fit import SEARCH_STRENGTH, PlayFit, differences, radii, smooth_weights
from hysteresis_ros.identification.preprocessing import Condensed, simple_loops
from hysteresis_ros.identification.thresholds import (
    ANOTHER_KIND,
    DENSITY_DECAY,
    EQUAL_DENSITIES,
    LOOPS_OF_ONE_SIZE,
    NOTABLE_AMBIGUITY,
    POOR,
    STRUCTURE,
)
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters
from hysteresis_ros.recordings.loops import turning_points
from hysteresis_ros.units import readable

GAUSS_NEWTON_STEPS = 6
SEARCH_STEPS = 2
#: The Gauss-Newton steps have converged if the relative change of the residual is below this value.
CONVERGED = 1e-5
#: Smallest slope of the sum of all dead zones, as a fraction of the slope at zero.
LOWEST_SLOPE = 0.2
#: Penalty on the slopes that dead zones add, as a ratio of RMS residual to stroke, so that unnecessary slopes stay near
#: zero.
ZONE_RIDGE = 1e-3


class FreeWeights(PlayFit):
    """Individual weights of plays, and dead zones in series after them, fitted to one set of data."""

    def __init__(self, data: Condensed, play_count: int, zone_count: int):
        super().__init__(data)
        self.radii = radii(data.voltage_range, play_count, data.reach)
        self.plays = data.plays(self.radii)
        self.roughness = np.diff(np.eye(len(self.radii)), 2, axis=0)[1:] * play_count**0.5
        self.play_count, self.zone_count = play_count, zone_count

    def columns(self, shape) -> np.ndarray:
        """Return the plays, shape (N, m)."""
        return self.plays

    def search(self, progress) -> PartSearch:
        """Return the search for the linear part; with dead zones, each neighbour's residual is solved separately."""
        if not self.zone_count:
            return super().search(progress)

        def solve(part, shape):
            return self.solve_weights(part, shape, SEARCH_STRENGTH, SEARCH_STEPS)

        return PartSearch(solve, self.data, self.extra, progress)

    def solve_weights(self, part, shape, strength: float | None = None, steps: int = GAUSS_NEWTON_STEPS) -> np.ndarray:
        """Return the residual [m] of the best weights of plays and dead zones."""
        residual = super().solve_weights(part, shape, strength)
        self.thresholds = self.zone_weights = np.zeros(0)
        if self.zone_count:
            residual = self._bend(part, self.data.counted(self.data.displacement), self.strength, residual, steps)
        return residual

    def like(self, data: Condensed):
        """Return an unfitted model of the same structure for other data."""
        other = FreeWeights(data, self.play_count, self.zone_count)
        other.guess = dict(self.found.values)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        x = self.plays @ self.weights
        if self.zone_count:
            x = x + _zones(x, self.thresholds) @ self.zone_weights
        return self.part.apply(x, self.data.sample_time) + self.data.constants @ self.constants

    def _bend(self, part, target, strength, residual, steps):
        """Run Gauss-Newton steps; each step solves for the weights of both plays and dead zones."""
        data = self.data
        x = self.plays @ self.weights
        thresholds = x.min() + np.ptp(x) * np.arange(1, self.zone_count + 1) / (self.zone_count + 1)
        zone_weights = np.zeros(self.zone_count)
        constants = data.counted(data.constants)
        best = (np.std(residual), self.weights, zone_weights, self.constants, residual)
        ridge = ZONE_RIDGE * data.stroke * np.sqrt(len(target))
        before = np.inf
        for _ in range(steps):
            zones = _zones(x, thresholds)
            slope = 1.0 + (zones != 0.0) @ zone_weights
            # linearised: S'(x) Z w + d(x) s = y - offset - [S(x) - S'(x) x - d(x) s], a sum of filtered zones
            kink = ((zones != 0.0) * x[:, None]) @ zone_weights
            table = np.column_stack([slope[:, None] * self.plays, zones, kink])
            table = data.counted(part.apply(table, data.sample_time))
            table, kink = table[:, :-1], table[:, -1]
            free = np.column_stack([table[:, len(self.radii) :], constants])
            weights, coefficients, _, _ = smooth_weights(
                table[:, : len(self.radii)],
                free,
                target + kink,
                self.roughness,
                strength,
                ridge=np.append(np.full(self.zone_count, ridge), np.zeros(constants.shape[1])),
            )
            zone_weights = _monotone(coefficients[: self.zone_count], thresholds)
            x = self.plays @ weights
            bent = data.counted(part.apply(x + _zones(x, thresholds) @ zone_weights, data.sample_time))
            still = np.linalg.lstsq(constants, target - bent, rcond=None)[0]
            residual = target - bent - constants @ still
            size = np.std(residual)
            if size < best[0]:
                best = (size, weights, zone_weights, still, residual)
            if abs(size - before) < CONVERGED * size:
                break
            before = size
        _, self.weights, self.zone_weights, self.constants, residual = best
        self.thresholds = thresholds
        return residual

    def parameters(self) -> HysteresisParameters:
        """Return the fit as parameters of the block."""
        require_rising(float(self.weights.sum()))
        moving = self.weights > 1e-9 * self.weights.sum()
        moving[0] = True
        weights = np.maximum(self.weights, 1e-6 * self.weights.sum() * (np.arange(len(moving)) == 0))
        used = self.zone_weights != 0.0
        parameters = PrandtlIshlinskiiParameters(
            radii=tuple(self.radii[moving].tolist()),
            weights=tuple(weights[moving].tolist()),
            thresholds=tuple(self.thresholds[used].tolist()),
            zone_weights=tuple(self.zone_weights[used].tolist()),
            offset=float(self.constants[0]) / self.part.settled_gain,
        )
        return HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=parameters)


def _zones(x, thresholds):
    """Return the outputs of dead zones, shape (N, k): zones with t ≥ 0 act above t, zones with t < 0 below t."""
    inside = x[:, None] - thresholds
    return np.where(thresholds >= 0.0, np.maximum(inside, 0.0), np.minimum(inside, 0.0))


def _monotone(zone_weights, thresholds):
    """Increase the weights of dead zones where the total slope would be too small."""
    result = np.array(zone_weights, dtype=float)
    for side in (np.flatnonzero(thresholds >= 0.0), np.flatnonzero(thresholds < 0.0)[::-1]):
        slope = 1.0
        for i in side:
            result[i] = max(result[i], LOWEST_SLOPE - slope)
            slope += result[i]
    return result


def few_columns(table, target) -> np.ndarray:
    """Return the coefficients of two or three columns by least squares, for targets of shape (N,) or (N, k).

    A QR factorisation and a small system take far less time than a singular value decomposition of all samples.
    """
    basis, triangle = np.linalg.qr(table)
    return np.linalg.lstsq(triangle, basis.T @ target, rcond=None)[0]


#: Default of κ, for data that does not determine it, and range of the search for κ.
PRIOR_DECAY = 1.9
DECAY_RANGE = (-1.0, 8.0)
#: Initial values and ranges of the other shape parameters; within these ranges the map rises everywhere.
DENSITY_SHAPE = (
    ("elastic_share", 0.6, 0.02, 1.0),
    ("map_slope", 0.0, -0.7, 0.7),
    ("map_curvature", 0.0, -0.25, 0.4),
)
#: Number of straight pieces of the map over the range of the recording; smallest change of slope between two pieces.
PIECES = 16
TINY = 1e-9


class SmoothDensity:
    """Exponential density and cubic map on one set of data."""

    def __init__(self, data: Condensed, play_count: int):
        self.data, self.play_count = data, play_count
        step = 0.5 * data.voltage_range / play_count
        self.half = 0.5 * data.voltage_range
        self.radii = radii(data.voltage_range, play_count, data.reach) + 0.5 * step
        self.plays = data.plays(self.radii)
        self.numbers: dict[str, float] = {}
        self.guess: dict[str, float] = {}
        self.played: tuple[float, np.ndarray] | None = None
        self.centre, self.span = 0.0, 1.0

    def search(self, progress, with_decay: bool = False) -> PartSearch:
        """Return the search for the linear part and the shape, including κ if ``with_decay``."""
        shape = (*DENSITY_SHAPE, ("decay", PRIOR_DECAY, *DECAY_RANGE)) if with_decay else DENSITY_SHAPE
        return PartSearch(self.solve, self.data, shape, progress, self.slopes)

    def fit(self, linear, progress):
        """Search the linear part and the shape with the default of κ, then test whether the data determines κ."""
        self.decay = PRIOR_DECAY
        search = self.search(progress)
        kept, base, held = search_linear_part(search, linear, self.guess)
        return self._finish(search, kept, base, held, progress)

    def settle(self, before, progress):
        """Search the shape, and the parameters of a linear part with known structure; then test κ like :meth:`fit`."""
        self.decay = PRIOR_DECAY
        search = self.search(progress)
        held = search.run(before.kept, before.found.values, before.base)
        return self._finish(search, before.kept, before.base, held, progress)

    def _finish(self, search: PartSearch, kept, base: LinearPart, held: PartTrial, progress):
        found, free = held, self.search(progress, with_decay=True)
        settled = free.run(kept, held.values, base)
        self.settled = DENSITY_DECAY.improves(settled.spread, held.spread)
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
        """Fit the shape for a known κ and a known linear part."""
        self.decay, self.part = decay, part
        self.shape = self.search(None).run([], {}, part).values
        self.rms = float(np.std(self.solve(part, self.shape)))
        return self

    def solve(self, part, shape) -> np.ndarray:
        """Return the residual [m] with the best scale and constant."""
        data = self.data
        moved = data.counted(part.apply(self.moved(shape), data.sample_time))
        table, target = np.column_stack([moved, data.counted(data.constants)]), data.counted(data.displacement)
        solution = few_columns(table, target)
        self.scale, self.constants, self.table = float(solution[0]), solution[1:], table
        return target - table @ solution

    def slopes(self, part, shape, neighbours) -> np.ndarray:
        """Return the changes of the residual [m] from this point to k neighbours, shape (N, k).

        Each neighbour is a pair (linear part, shape parameters).

        Scale and constants are solved again for each neighbour (variable projection as simplified by Kaufman, BIT 15,
        1975; the gradient of the squared residual remains exact).
        """
        table, frame = self.table, (self.centre, self.span)
        changes = self.scale * self.data.counted(
            differences(part, shape, neighbours, self.moved, self.data.sample_time)
        )
        self.centre, self.span = frame
        return table @ few_columns(table, changes) - changes

    def moved(self, shape) -> np.ndarray:
        """Return the input of the linear part, shape (N,), for a scale of 1; it is zero at rest."""
        share = shape["elastic_share"]
        sums = (share / (2.0 * self.half)) * self.data.voltage + (1.0 - share) * self._played(shape)
        counted = sums[self.data.first :]
        self.centre, self.span = 0.5 * float(counted.max() + counted.min()), 0.5 * float(np.ptp(counted))
        return self._map(sums, shape) - self._map(0.0, shape)

    def _weights(self, shape) -> np.ndarray:
        """Return weights of voltage and plays with which each part moves by about its fraction of the motion."""
        density = np.exp(-shape.get("decay", self.decay) * self.radii / self.half)
        moving = np.maximum(2.0 * (self.half - self.radii), 0.0) @ density
        share = shape["elastic_share"]
        return np.append(share / (2.0 * self.half), (1.0 - share) * density / moving)

    def _played(self, shape) -> np.ndarray:
        """Return the sum of the plays, shape (N,), which depends only on κ."""
        decay = shape.get("decay", self.decay)
        if self.played is None or self.played[0] != decay:
            self.played = decay, self.plays @ self._weights({**shape, "elastic_share": 0.0})[1:]
        return self.played[1]

    def _map(self, sums, shape):
        u = (sums - self.centre) / self.span
        inside = np.clip(u, -1.0, 1.0)  # linear beyond the recording
        square = inside * inside
        bent = (0.5 * shape["map_slope"] + 0.5 * shape["map_curvature"] * inside) * (square - 1.0)
        end = shape["map_slope"] * inside + shape["map_curvature"] * (1.5 * square - 0.5)
        return u + bent + end * (u - inside)

    def like(self, data: Condensed):
        """Return an unfitted model of the same structure for other data."""
        other = SmoothDensity(data, self.play_count)
        other.guess = dict(self.found.values)
        return other

    def refitted(self, data: Condensed):
        """Return the model fitted to other samples of the recording, starting from the present parameters."""
        other = copy(self)
        other.data = data
        found = other.search(None, self.settled).run(self.kept, self.found.values, self.base)
        other.part, other.shape = split_values(self.base, found.values)
        other.solve(other.part, other.shape)
        return other

    def output(self) -> np.ndarray:
        """Return the modelled displacement [m], shape (N,)."""
        moved = self.part.apply(self.moved(self.shape), self.data.sample_time)
        return self.scale * moved + self.data.constants @ self.constants

    def parameters(self) -> HysteresisParameters:
        """Return density and map as plays and dead zones."""
        require_rising(self.scale)
        low, high = min(self.centre - self.span, 0.0), max(self.centre + self.span, 0.0)
        width = (high - low) / PIECES
        above, rising = self._pieces(width, high)
        below, falling = self._pieces(-width, low)
        first = float(rising[0]) if len(rising) else float(falling[0])
        # a corner at the rest position belongs to the upper side; the lower side starts just below this position
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
        """Return inner corners and slopes of the scaled map as straight pieces from rest to ``end``."""
        count = int(np.ceil(end / width - 1e-9))
        corners = width * np.arange(count + 1)
        heights = self.scale * self._map(corners, self.shape)
        return corners[:-1], np.diff(heights) / width


PLAYS = 20
ZONES = 5
#: Forms of the weights as a function of the radius.
DENSITIES = ("auto", "exponential", "free")


def fit_prandtl_ishlinskii(
    voltage,
    displacement,
    sample_time: float,
    *,
    play_count: int = PLAYS,
    zone_count: int | None = None,
    density: str = "auto",
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    history: tuple[float, ...] = (),
    progress=None,
    competitors=None,
    like=None,
) -> HammersteinFit:
    """Fit voltage → plays → dead zones → creep → lag and delay.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """
    if density not in DENSITIES:
        raise IdentificationError(f"density = {density!r}: must be one of {', '.join(DENSITIES)}")
    if density == "exponential" and zone_count is not None:
        raise IdentificationError("zone_count: not with density=exponential, which has its own map")

    def choose(data):
        return _chosen(data, play_count, zone_count, density, linear, progress, competitors)

    def again(before, data, settled):  # used for a repeated fit without outliers, or with other dynamics
        other = before.like(data)
        return judged_again(other.settle(before, progress) if settled else other.fit(linear, progress), before)

    fit, structure = robust_fit(
        voltage, displacement, sample_time, choose, again, skip=skip, history=history, before=like
    )
    return replace(fit, structure=structure)


def _chosen(data: Condensed, play_count: int, zone_count: int | None, density: str, linear, progress, others):
    """Return the fit of the structure that predicts held-out blocks best."""
    if zone_count is not None:
        return without_drift(lambda data: FreeWeights(data, play_count, zone_count).fit(linear, progress), data)
    if density == "free":
        competitors = [without_drift(lambda data: FreeWeights(data, play_count, 0).fit(linear, progress), data)]
    else:
        competitors = [without_drift(lambda data: SmoothDensity(data, play_count).fit(linear, progress), data)]
        if density == "exponential":
            return competitors[0]
        competitors.append(FreeWeights(competitors[0].data, play_count, 0).fit(linear, progress))
    # dead zones are fitted with the best linear part found without them; if they are accepted, it is searched again
    nearest = min(competitors, key=lambda fit: fit.rms)
    zones = FreeWeights(competitors[0].data, play_count, ZONES).behind(nearest.part)
    competitors.append(zones)
    alone = simple_loops(data) and density == "auto"
    thresholds = [LOOPS_OF_ONE_SIZE if alone else STRUCTURE] * len(competitors)
    competitors += others(competitors[0], progress, linear) if others else []
    thresholds += [ANOTHER_KIND if alone else STRUCTURE] * (len(competitors) - len(thresholds))
    kept = usable(competitors)
    thresholds = [row for fit, row in zip(competitors, thresholds, strict=True) if fit in kept]
    competitors = kept
    chosen, errors = survivor(competitors, thresholds=thresholds)
    if chosen is zones:
        zones.settle(nearest, progress)
    chosen.numbers["held_out_rmse_m"] = errors[competitors.index(chosen)]
    return chosen


#: Tried values of κ, and number of plays of each density.
TRIED_DECAYS = (-1.0, 0.0, 1.0, 1.5, 1.9, 2.5, 3.2, 4.2, 6.0)
TRIED_PLAYS = 20
#: Number of swings of the decaying loops on which densities are compared.
SWINGS = 16
#: Number of points of a swing.
POINTS = 40
#: Size of the small loop whose gain is compared, as a fraction of the range.
SMALL = 0.1
#: The speed is determined from the reversals of the voltage by more than this fraction of the range.
LARGE = 0.5
#: A recorded loop ends where the voltage reverses by more than this fraction of the range.
REVERSED = 0.05


@dataclass(frozen=True)
class Ambiguity:
    """Other models that fit about as well as the chosen one."""

    decays: tuple[float, float]  #: Lowest and highest κ that fit about as well as the best.
    #: Lowest and highest gain, over all possible models, for loops over a tenth of the range, relative to the gain of
    #: the chosen model.
    gain: tuple[float, float]
    error: float  #: Largest RMS difference of a possible model from the chosen one on loops of decaying amplitude [m].
    stroke: float  #: Stroke of the recording [m].
    held: bool  #: Whether κ has its default value.
    smallest: float  #: Smallest swing of the recorded voltage, as a fraction of its range.

    @property
    def numbers(self) -> dict[str, float]:
        """Figures for the parameter file, by names with units."""
        low, high = (100.0 * (gain - 1.0) for gain in self.gain)
        return {
            "density_decay_low": self.decays[0],
            "density_decay_high": self.decays[1],
            "small_loop_gain_low_percent": low,
            SMALL_LOOP_GAIN: high,
            "ambiguity_rms_m": self.error,
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warning about the ambiguity, with a remedy; empty if the recording determines the model."""
        if self.error < NOTABLE_AMBIGUITY * self.stroke:
            return ()
        low, high = (100.0 * (gain - 1.0) for gain in self.gain)
        return (
            f"the recording does not determine the gain of small loops: {low:+.2g} … {high:+.2g} % at a tenth of the "
            f"range, {readable(self.error, 'm')} on decaying loops; {self._held()}{self._remedy()}",
        )

    def _held(self) -> str:
        return f"the density keeps the default κ = {PRIOR_DECAY:g}; " if self.held else ""

    def _remedy(self) -> str:
        how = "(hysteresis excite --recipe decaying)"
        if self.smallest > SMALL:
            return f"its smallest loop spans {100.0 * self.smallest:.0f} % of the range: record decaying loops {how}"
        return f"its small loops are too few or too noisy: record more decaying loops {how}"


def find_ambiguity(data: Condensed, part: LinearPart, chosen: HysteresisParameters, held: bool) -> Ambiguity | None:
    """Compare the model with other densities that fit equally well; return None if no density can be compared."""
    fits = [SmoothDensity(data, TRIED_PLAYS).behind(part, decay) for decay in TRIED_DECAYS]
    least = min(fit.rms for fit in fits)
    if chosen.type == "preisach" and least > POOR * data.stroke:
        return None  # these densities cannot describe such loops
    voltage = _decaying(float(data.voltage.min()), float(data.voltage.max()))
    # at the speed of the recorded loops, because the loops of a rate-dependent model change with the speed
    sample_time = float(np.mean(np.abs(np.diff(voltage)))) / _speed(data)
    own = _response(chosen, voltage, sample_time)
    decays, gains, errors = [], [1.0], [0.0]
    for fit in fits:
        if fit.rms > (1.0 + EQUAL_DENSITIES) * least:
            continue
        try:
            other = _response(fit.parameters(), voltage, sample_time)
        except IdentificationError:
            continue
        decays.append(fit.decay)
        gains.append(_small_gain(other) / _small_gain(own))
        difference = (other - own)[2 * POINTS : -POINTS]
        errors.append(float(np.std(difference)))
    if not decays:
        return None
    turns = data.voltage[turning_points(data.voltage, REVERSED)[1:-1]]
    smallest = float(np.min(np.abs(np.diff(turns)), initial=np.ptp(data.voltage)) / np.ptp(data.voltage))
    return Ambiguity((min(decays), max(decays)), (min(gains), max(gains)), max(errors), data.stroke, held, smallest)


def _decaying(low: float, high: float) -> np.ndarray:
    """Return a voltage [V] with one full sweep, decaying loops, and a small loop."""
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    sizes = [1.0, 1.0, *(1.0 - np.arange(1, SWINGS + 1) / SWINGS)]
    ends = [centre + half * size * (-1.0) ** k for k, size in enumerate(sizes)]
    ends += [centre - SMALL * half, centre + SMALL * half]
    return np.concatenate([np.linspace(a, b, POINTS + 1)[1:] for a, b in zip([0.0, *ends], ends, strict=False)])


def _speed(data: Condensed) -> float:
    """Return the speed [V/s] of the voltage between the ends of its large loops: the median over the branches."""
    turns = turning_points(data.voltage, LARGE)
    return float(np.median(np.abs(np.diff(data.voltage[turns])) / np.diff(turns))) / data.sample_time


def _response(hysteresis: HysteresisParameters, voltage, sample_time: float) -> np.ndarray:
    return hysteresis_block(hysteresis, sample_time).simulate(voltage)


def _small_gain(response) -> float:
    return float(response[-1] - response[-POINTS - 1])
