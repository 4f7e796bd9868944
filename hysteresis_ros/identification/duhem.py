# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Duhem models from data: model, inverse, and model followed by linear dynamics (Wang, Alici & Tan 2014; W1-W5).

The loops are prepared first (W2): the lag is removed, loops of different frequencies are scaled to one amplitude, and
the branches of the major loop are extracted. For a given α these branches determine f and g. W3 computes f and g from
the branches *and their slopes*, but the slopes of measured branches are mostly noise. The fit here therefore uses the
integrated equation, whose output is linear in f and g along a known path of the input: f and g, as networks or splines,
are chosen so that the integrated equation follows the measured branches. For exact branches both methods are
equivalent, but the integrated form does not differentiate noise. Input and output of the major loop are normalised to
-1 … +1.

The paper fixes α = 80 (for an input of -1 … 1). With this value the model reproduces only the major loop: after a
reversal inside the loop, the output first moves in the wrong direction. α determines the minor loops, so it is
identified from them if the recordings contain minor loops (W7). The inverse (W4) is identified in the same way, with
input and output exchanged.

A linear part of second order after the hysteresis is fitted by least squares to ``y(t) = -a1 y(t-1) - a2 y(t-2) + b0
w(t-1) + b1 w(t-2)``, where w is the voltage itself (G1, W1) or the output of the identified hysteresis (G2, W5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.arx import ArxFit, fit_arx
from hysteresis_ros.identification.data import checked_signals
from hysteresis_ros.identification.preprocessing import (
    FEWEST_BRANCH_SAMPLES,
    require_both_directions,
    split_branches,
)
from hysteresis_ros.identification.thresholds import NETWORK_SIZE
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.linear import LinearParameters

#: Fraction of a branch, on both sides of a reversal, from which the lag is determined.
WINDOW = 0.25
LAG_CANDIDATES = 41
#: A branch belongs to the major loop if its distance from both ends of the range is at most this fraction of the range.
NEAR_END = 0.02
#: Largest gap between the branches at an end of a steady loop, as a fraction of the range.
OPEN_END = 0.02
#: Largest and smallest number of points of a branch.
LOOP_GRID = 301
COARSEST_GRID = 41


@dataclass(frozen=True)
class PreparedLoops:
    """Recordings prepared as in W2."""

    voltage: tuple[np.ndarray, ...]  #: Input of each recording, delayed by its lag [V].
    displacement: tuple[np.ndarray, ...]  #: Output [m], scaled to the amplitude of the first recording.
    delays: tuple[float, ...]  #: Lag of each recording [s].
    gains: tuple[float, ...]  #: max |y| of each recording [m]; shows how the linear part changes it.


def reversal_delay(voltage, displacement, sample_time: float, longest: float | None = None) -> float:
    """Return the lag [s] of the displacement's reversals behind the voltage's reversals (Δt of W2).

    Rate-independent hysteresis reverses when its input reverses; a lag delays the reversal. The displacement around
    each reversal is fitted by two parabolas in the delayed voltage, one before and one after the reversal, which meet
    at the reversal. The returned lag is the delay with the smallest residual. The phase of the first harmonic is not
    used, because it also includes the hysteresis.

    Units: ``voltage`` [V], ``displacement`` [m].
    """
    from scipy.optimize import minimize_scalar  # imported here because only fits need it

    voltage, displacement = checked_signals(voltage, displacement)
    branches = split_branches(voltage)
    turns = [
        (before, after)
        for before, after in zip(branches[:-1], branches[1:], strict=True)
        if min(len(before), len(after)) * WINDOW >= FEWEST_BRANCH_SAMPLES
    ]
    if not turns:
        raise IdentificationError(
            f"no reversal of the voltage has {FEWEST_BRANCH_SAMPLES / WINDOW:.0f} samples on both sides; sample faster "
            "or record whole cycles"
        )
    if longest is None:
        longest = 0.25 * sample_time * float(np.mean([len(branch) for turn in turns for branch in turn]))
    samples = np.arange(voltage.size)

    def misfit(delay):
        shift = delay / sample_time
        total = 0.0
        for before, after in turns:
            turn = before.stop + shift
            first = max(int(turn - WINDOW * len(before)), 0)
            last = min(int(turn + WINDOW * len(after)) + 1, voltage.size)
            k = samples[first:last]
            v = np.interp(k - shift, samples, voltage) - voltage[before.stop]
            v /= np.max(np.abs(v)) or 1.0
            left, right = v * (k < turn), v * (k >= turn)
            rows = np.stack([np.ones(k.size), left, left * v, right, right * v], axis=1)
            y = displacement[first:last]
            error = rows @ np.linalg.lstsq(rows, y, rcond=None)[0] - y
            total += float(error @ error)
        return total

    grid = np.linspace(0.0, longest, LAG_CANDIDATES)
    best = int(np.argmin([misfit(delay) for delay in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, LAG_CANDIDATES - 1)]
    return float(minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * sample_time}).x)


def prepare_loops(recordings, sample_time: float, delays=None) -> PreparedLoops:
    """Shift each input by the lag of its recording, and scale all outputs to the amplitude of the first (W2).

    After that, loops of the same amplitude at different frequencies coincide if the hysteresis is rate-independent. Do
    not mix recordings of different amplitude: the scaling would hide how the hysteresis depends on the amplitude.

    Units: ``recordings`` [V], [m], ``sample_time`` [s], ``delays`` [s].
    """
    pairs = [checked_signals(*pair) for pair in recordings]
    if not pairs:
        raise IdentificationError("no recording is given")
    swings = np.array([np.ptp(voltage) for voltage, _ in pairs])
    if swings.max() > 1.05 * swings.min():
        raise IdentificationError(
            f"voltage ranges of {swings.min():g} and {swings.max():g} V: normalising would hide how hysteresis depends "
            "on the amplitude; prepare recordings of one amplitude together"
        )
    if delays is None:
        delays = [reversal_delay(voltage, displacement, sample_time) for voltage, displacement in pairs]
    shifted, scaled, gains = [], [], []
    for (voltage, displacement), delay in zip(pairs, delays, strict=True):
        shift = delay / sample_time
        first = int(np.ceil(shift))
        k = np.arange(voltage.size)
        gains.append(float(np.max(np.abs(displacement))))
        shifted.append(np.interp(k[first:] - shift, k, voltage))
        scaled.append(displacement[first:] * (gains[0] / gains[-1]))
    return PreparedLoops(tuple(shifted), tuple(scaled), tuple(map(float, delays)), tuple(gains))


@dataclass(frozen=True)
class MajorLoop:
    """Both branches of the major loop on one grid, normalised to -1 … 1."""

    grid: np.ndarray  #: shape (n,); Inputs.
    rising: np.ndarray  #: rising, falling: shape (n,); Outputs at the inputs ``grid``.
    falling: np.ndarray
    input_low: float  #: input_low … output_high: Input and output that are normalised to -1 and +1.
    input_high: float
    output_low: float
    output_high: float
    gap: float  #: Larger of the gaps between the branches at the two ends, as a fraction of the output range.
    #: Standard error of the grid values (normalised), from the scatter of the samples around the branches.
    noise: float

    @property
    def opening(self) -> float:
        """Loop width, as a fraction of the output range."""
        return 0.5 * float(np.max(np.abs(self.falling - self.rising)))

    def input(self, u) -> np.ndarray:
        """Return inputs ``u`` normalised."""
        return (np.asarray(u) - self.input_low) * (2.0 / (self.input_high - self.input_low)) - 1.0

    def output(self, y) -> np.ndarray:
        """Return outputs ``y`` normalised."""
        return (np.asarray(y) - self.output_low) * (2.0 / (self.output_high - self.output_low)) - 1.0


def major_loop(inputs, outputs) -> MajorLoop:
    """Return the branches between the ends of the input range, averaged over all cycles and recordings.

    The first branch of a recording begins at rest, not on the loop, so it is used only if there is no other branch.
    """
    low, high = min(u.min() for u in inputs), max(u.max() for u in inputs)
    near = NEAR_END * (high - low)
    kept: dict[bool, list] = {True: [], False: []}
    spare: dict[bool, list] = {True: [], False: []}
    for u, y in zip(inputs, outputs, strict=True):
        branches = split_branches(u)
        require_both_directions(branches, "loop model")
        for place, branch in enumerate(branches):
            if branch.low < low + near and branch.high > high - near and len(branch) >= FEWEST_BRANCH_SAMPLES:
                store = spare if place == 0 and branch.start == 0 else kept
                store[branch.rising].append((u[branch.samples], y[branch.samples]))
    for rising, name in ((True, "rising"), (False, "falling")):
        kept[rising] = kept[rising] or spare[rising]
        if not kept[rising]:
            raise IdentificationError(
                f"no {name} branch extends from {low:g} to {high:g}, the ends of the input range; a Duhem model needs "
                "a complete major loop: record at least one and a half cycles of full amplitude"
            )
    ends = np.array([(v.min(), v.max()) for side in kept.values() for v, _ in side])
    v_low, v_high = float(np.median(ends[:, 0])), float(np.median(ends[:, 1]))
    shortest = min(sum(v.size for v, _ in side) for side in kept.values())
    grid = np.linspace(-1.0, 1.0, int(np.clip(shortest // 3, COARSEST_GRID, LOOP_GRID)))
    sides, scatter, used = {}, 0.0, 0
    for rising, side in kept.items():
        v, y = (np.concatenate(part) for part in zip(*side, strict=True))
        v = (v - v_low) * (2.0 / (v_high - v_low)) - 1.0
        sides[rising], misfit = _on_grid(grid, v, y)
        scatter, used = scatter + misfit, used + v.size
    up, down = sides[True], sides[False]
    bottom, top = 0.5 * (up[0] + down[0]), 0.5 * (up[-1] + down[-1])
    if not top > bottom:
        raise IdentificationError("the output falls while the input rises; change the sign of one column")
    scale = 2.0 / (top - bottom)
    deviation = np.sqrt(scatter / max(used - 2 * grid.size, 1))
    return MajorLoop(
        grid=grid,
        rising=(up - bottom) * scale - 1.0,
        falling=(down - bottom) * scale - 1.0,
        input_low=v_low,
        input_high=v_high,
        output_low=float(bottom),
        output_high=float(top),
        gap=0.5 * scale * float(max(abs(up[0] - down[0]), abs(up[-1] - down[-1]))),
        noise=float(scale * deviation * np.sqrt(2 * grid.size / used)),
    )


def _on_grid(grid, v, y):
    """Return the piecewise linear curve over ``grid`` that is nearest to the samples, and its sum of squared errors."""
    from scipy.linalg import solveh_banded  # imported here because only fits need it

    n = grid.size
    place = np.clip((v + 1.0) * (0.5 * (n - 1)), 0.0, n - 1.0)
    i = np.minimum(place.astype(int), n - 2)
    t = place - i
    middle = float(np.mean(y))
    z = y - middle
    bands = np.zeros((3, n))
    bands[2] = np.bincount(i, (1.0 - t) ** 2, n) + np.bincount(i + 1, t * t, n)
    bands[1, 1:] = np.bincount(i, t * (1.0 - t), n)[: n - 1]
    right = np.bincount(i, (1.0 - t) * z, n) + np.bincount(i + 1, t * z, n)
    # a small penalty on curvature keeps the equations solvable where there are no samples
    stiffness = 1e-6 * v.size / n
    for offsets, value in (((0, 0), 1.0), ((1, 1), 4.0), ((2, 2), 1.0)):
        bands[2, offsets[0] : n - 2 + offsets[0]] += stiffness * value
    bands[1, 1 : n - 1] -= 2.0 * stiffness
    bands[1, 2:n] -= 2.0 * stiffness
    bands[0, 2:] += stiffness
    values = solveh_banded(bands, right)
    error = values[i] * (1.0 - t) + values[i + 1] * t - z
    return values + middle, float(error @ error)


#: Longest substep of the integration, in 1/α.
SUBSTEP_ALPHA = 0.25
#: Largest α (normalised), because exponentials overflow with larger values. Even with a much smaller α, a branch
#: reaches the other one within 1 % of the range.
LARGEST_ALPHA = 300.0
#: Penalties, relative to the residual, on the roughness of splines and on the size of network weights. They are so
#: small that they only decide between equally good fits.
ROUGHNESS_WEIGHT = 1e-5
SIZE_WEIGHT = 1e-5
#: Numbers of network units and of spline knots, tried in order until the residual is small or no longer decreases.
UNITS = (4, 8, 12, 18, 24)
KNOTS = (8, 12, 18, 26, 38, 56)
#: Residual (rms, as a fraction of half the range) below which no larger number is tried.
SMALL_RESIDUAL = 4e-5
TRAINING_STARTS = 2
TRAINING_STEPS = 150
#: Residual below which networks count as trained, even if the training did not converge.
TRAINED = 2e-4

# Gauss-Legendre rule of three points on 0 … 1; the kernel of the model uses the same rule.
_POINTS = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True)
class Shapes:
    """f and g of one loop."""

    kind: str  #: ``network`` or ``spline``.
    f: np.ndarray  #: f, g: As in :class:`~hysteresis_ros.models.hysteresis.duhem.DuhemParameters`.
    g: np.ndarray
    rms: float  #: rms, maximum: Residual of the loop with these functions, as a fraction of half the range.
    maximum: float
    converged: bool  #: Whether the training converged or reached :data:`TRAINED`; true for splines.


class LoopOperator:
    """The Duhem equation integrated up and then down a grid: ``w = constant + on_f f(nodes) + on_g g(nodes)``."""

    def __init__(self, grid, alpha, start):
        longest = float(np.max(np.diff(grid)))
        parts = max(1, math.ceil(alpha * longest / SUBSTEP_ALPHA))
        n = len(grid)
        edges = np.interp(np.arange((n - 1) * parts + 1) / parts, np.arange(n), grid)
        lengths = np.diff(edges)
        self.alpha = alpha
        self.nodes = (edges[:-1, None] + lengths[:, None] * _POINTS).ravel()
        weights = (lengths[:, None] * _WEIGHTS).ravel()
        # exp(-α (v - node)) = exp(-α (v + 1)) exp(α (node + 1)): integrals become running sums
        self._group = 3 * parts
        self._up = (weights * np.exp(alpha * (self.nodes - grid[0])))[:, None]
        self._down = (weights * np.exp(alpha * (grid[-1] - self.nodes)))[:, None]
        self._decay_up = np.exp(-alpha * (grid - grid[0]))
        self._decay_down = np.exp(-alpha * (grid[-1] - grid[::-1]))
        # the falling branch starts where the rising one ends
        self.constant = start * np.concatenate([self._decay_up, self._decay_down * self._decay_up[-1]])

    def _apply(self, values, sign) -> np.ndarray:
        columns = np.reshape(values, (self.nodes.size, -1))
        up = self._running(columns * self._up, self._decay_up)
        down = sign * self._running((columns * self._down)[::-1], self._decay_down)
        down += self._decay_down[:, None] * up[-1]
        return np.concatenate([up, down]).reshape((-1, *np.shape(values)[1:]))

    def _running(self, columns, decay) -> np.ndarray:
        pieces = columns.reshape(-1, self._group, columns.shape[1]).sum(axis=1)
        sums = np.zeros((len(pieces) + 1, columns.shape[1]))
        np.cumsum(pieces, axis=0, out=sums[1:])
        return decay[:, None] * sums

    def on_f(self, values) -> np.ndarray:
        """Return the contribution of f at the nodes, shape (m,) or (m, k), to the output, shape (2 n,) or (2 n, k)."""
        return self.alpha * self._apply(values, 1.0)

    def on_g(self, values) -> np.ndarray:
        """Return the contribution of g at the nodes, like :meth:`on_f`."""
        return self._apply(values, -1.0)

    def output(self, f, g) -> np.ndarray:
        """Return w, shape (2 n,), for values f and g at the nodes, shape (m,)."""
        return self.constant + self.on_f(f) + self.on_g(g)


def _solve_normal(rows, wanted) -> np.ndarray:
    """Solve a well-conditioned least-squares problem by its normal equations, without multithreaded routines."""
    normal = np.einsum("ij,ik->jk", rows, rows)
    return np.linalg.solve(normal, np.einsum("ij,i->j", rows, wanted))


def fit_splines(operator: LoopOperator, target, knots: int) -> Shapes:
    """Return the splines with ``knots`` values whose loop is nearest to ``target``, shape (2 n,)."""
    from scipy.interpolate import CubicSpline  # imported here because only fits need it

    basis = CubicSpline(np.linspace(-1.0, 1.0, knots), np.eye(knots))(operator.nodes)
    matrix = np.hstack([operator.on_f(basis), operator.on_g(basis)])
    bend = np.diff(np.eye(knots), 2, axis=0) * ROUGHNESS_WEIGHT * knots**1.5
    rows = np.vstack([matrix, np.kron(np.eye(2), bend)])
    wanted = np.concatenate([target - operator.constant, np.zeros(2 * len(bend))])
    found = _solve_normal(rows, wanted)
    residual = matrix @ found + operator.constant - target
    return _shapes("spline", found[:knots], found[knots:], residual, True)


def fit_networks(operator: LoopOperator, target, units: int, random, noise: float = 0.0) -> Shapes:
    """Return the best networks, with ``units`` tanh units each, from a few trainings with seeded starts."""
    from scipy.optimize import least_squares  # imported here because only fits need it

    v = operator.nodes[:, None]
    size = 3 * units + 1
    best = None

    def network(numbers):
        a, b, c, d = numbers[:units], numbers[units : 2 * units], numbers[2 * units : -1], numbers[-1]
        hidden = np.tanh(a * v + b)
        return hidden, c, hidden @ c + d

    def residual(numbers):
        _, _, f = network(numbers[:size])
        _, _, g = network(numbers[size:])
        return np.concatenate([operator.output(f, g) - target, SIZE_WEIGHT * numbers])

    def jacobian(numbers):
        blocks = []
        for apply, part in ((operator.on_f, numbers[:size]), (operator.on_g, numbers[size:])):
            hidden, c, _ = network(part)
            slope = (1.0 - hidden**2) * c
            blocks.append(apply(np.hstack([slope * v, slope, hidden, np.ones_like(v)])))
        return np.vstack([np.hstack(blocks), SIZE_WEIGHT * np.eye(2 * size)])

    for _ in range(TRAINING_STARTS):
        numbers = _first_networks(operator, target, units, random)
        found = least_squares(residual, numbers, jacobian, method="lm", x_scale="jac", max_nfev=TRAINING_STEPS)
        errors = residual(found.x)[: len(target)]
        trained = found.status > 0 or np.sqrt(np.mean(errors**2)) <= max(TRAINED, noise)
        shapes = _shapes("network", found.x[:size], found.x[size:], errors, trained)
        if best is None or shapes.rms < best.rms:
            best = shapes
        if best.rms <= max(SMALL_RESIDUAL, noise):
            break
    if best is None:
        raise IdentificationError("no training has run")
    return best


def _first_networks(operator, target, units, random) -> np.ndarray:
    """Return initial parameters: units spread over the range, output weights by least squares."""
    parts = []
    for _ in range(2):
        centres = np.linspace(-1.0, 1.0, units) + 0.5 / units * random.standard_normal(units)
        a = 0.5 * units * (0.5 + random.random(units)) + 0.5
        parts.append((a, -a * centres))
    hidden = [
        np.hstack([np.tanh(operator.nodes[:, None] * a + b), np.ones((operator.nodes.size, 1))]) for a, b in parts
    ]
    matrix = np.hstack([operator.on_f(hidden[0]), operator.on_g(hidden[1])])
    rows = np.vstack([matrix, 1e-3 * np.eye(matrix.shape[1])])
    wanted = np.concatenate([target - operator.constant, np.zeros(matrix.shape[1])])
    out = _solve_normal(rows, wanted).reshape(2, units + 1)
    return np.concatenate([np.concatenate([*part, weights]) for part, weights in zip(parts, out, strict=True)])


def fit_shapes(operator: LoopOperator, target, kind: str, size: int | None, random, noise: float = 0.0) -> Shapes:
    """Return f and g of the given kind: networks or splines."""

    def fit(number):
        if kind == "spline":
            return fit_splines(operator, target, number)
        return fit_networks(operator, target, number, random, noise)

    if size is not None:
        return fit(size)
    best, enough = None, max(SMALL_RESIDUAL, noise)
    for number in KNOTS if kind == "spline" else UNITS:
        if 6 * number > len(target):
            break
        shapes = fit(number)
        if best is not None and shapes.rms > NETWORK_SIZE.bound(best.rms) and best.rms < 1e-3:
            break
        if best is None or shapes.rms < best.rms:
            best = shapes
        if best.rms <= enough:
            break
    if best is None:
        raise IdentificationError(f"{len(target)} points of the loop are too few for any shape; record more samples")
    return best


def _shapes(kind, f, g, residual, converged) -> Shapes:
    rms, maximum = float(np.sqrt(np.mean(residual**2))), float(np.max(np.abs(residual)))
    return Shapes(kind, np.asarray(f), np.asarray(g), rms, maximum, bool(converged))


#: The paper's α, for a normalised input of -1 … 1.
PUBLISHED_ALPHA = 80.0
#: Initial values of α, and number of knots of the splines during the search.
ALPHAS = np.geomspace(0.05, 100.0, 23)
SEARCH_KNOTS = 26
#: Largest number of samples of the minor loops in the search.
SEARCH_SAMPLES = 800
ALPHA_TOLERANCE = 1e-3
#: A minor loop determines α only if its reversal is at least this fraction of the range away from both ends of the
#: range.
SMALLEST_MINOR = 0.1


@dataclass(frozen=True)
class DuhemIdentification:
    """Result of :func:`identify_duhem` and :func:`identify_inverse_duhem`."""

    parameters: DuhemParameters  #: The model, in the units of the recording.
    alpha: float  #: α for the normalised input, as in the paper.
    alpha_source: str  #: ``given``, ``minor loops`` or ``paper``.
    loop: MajorLoop  #: The branches used for the fit.
    rms: float  #: rms, maximum: Residual of the major loop, as a fraction of its full range.
    maximum: float
    #: Residual of the recording with minor loops, as a fraction of the full range; NaN without minor loops.
    minor_rms: float
    converged: bool  #: Whether the training of f and g converged, and the search for α ended inside its range.
    warnings: tuple[str, ...]  #: Warnings about uncertain results, as sentences.


def identify_duhem(
    voltage,
    displacement,
    *,
    alpha: float | None = None,
    minor=None,
    shape: str = "network",
    size: int | None = None,
    seed: int = 0,
) -> DuhemIdentification:
    """Identify f, g and α of the Duhem model from slow or prepared loops (W2, W3).

    Units: ``voltage`` [V], ``displacement`` [m].
    """
    settings = dict(alpha=alpha, minor=minor, shape=shape, size=size, seed=seed)
    return _identify(("voltage", "displacement"), (voltage, displacement), **settings)


def identify_inverse_duhem(
    voltage,
    displacement,
    *,
    alpha: float | None = None,
    minor=None,
    shape: str = "network",
    size: int | None = None,
    seed: int = 0,
) -> DuhemIdentification:
    """Identify F, G and α of the inverse Duhem model, displacement to voltage (W4).

    The arguments are those of :func:`identify_duhem`; the returned model has an input in metres and an output in volts.
    """
    if minor is not None:
        minor = (minor[1], minor[0])
    settings = dict(alpha=alpha, minor=minor, shape=shape, size=size, seed=seed)
    return _identify(("displacement", "voltage"), (displacement, voltage), **settings)


def _identify(names, signals, *, alpha, minor, shape, size, seed) -> DuhemIdentification:
    """Identify f, g and α from ``signals``; ``names`` are the names of input and output."""
    inputs, outputs = signals
    if shape not in ("network", "spline"):
        raise IdentificationError(f"shape = {shape!r}: must be network or spline")
    if alpha is not None and not 0.0 < alpha <= LARGEST_ALPHA:
        raise IdentificationError(f"alpha = {alpha:g}: must be > 0 and ≤ {LARGEST_ALPHA:g} (normalised input)")
    if np.ndim(inputs[0]) == 0:
        inputs, outputs = [inputs], [outputs]
    pairs = [checked_signals(u, y, names) for u, y in zip(inputs, outputs, strict=True)]
    loop = major_loop([u for u, _ in pairs], [y for _, y in pairs])
    warnings = []
    if loop.gap > OPEN_END:
        warnings.append(
            f"the loop has a gap of {100.0 * loop.gap:.2g} % of the range at one end: drift, "
            "creep, or a first cycle from rest; record further cycles"
        )
    if loop.opening < 1e-3:
        warnings.append(
            f"the loop width is only {100.0 * loop.opening:.2g} % of the range: there is hardly any hysteresis"
        )
    if minor is not None:
        input_, output = minor
        minor = checked_signals(input_, output, names)
    else:
        minor = next((pair for pair in pairs if _has_minor_loops(pair[0])), None)

    converged, source, minor_rms = True, "given", float("nan")
    if alpha is None and minor is not None:
        alpha, converged = _search_alpha(loop, minor)
        source = "minor loops"
        if not converged:
            warnings.append(f"alpha = {alpha:.3g} lies at a bound of the search: the minor loops do not determine it")
    elif alpha is None:
        alpha, source = PUBLISHED_ALPHA, "paper"
        warnings.append(
            f"no minor loops: alpha = {alpha:g} is the paper's value; it reproduces only the major loop, and after a "
            "reversal inside it the output first moves in the wrong direction; record loops of decaying amplitude"
        )
    operator, target = _operator(loop, alpha)
    shapes = fit_shapes(operator, target, shape, size, np.random.default_rng(seed), loop.noise)
    if not shapes.converged:
        converged = False
        warnings.append(f"the training of f and g did not converge: residual {50.0 * shapes.rms:.2g} % of the range")
    parameters = _parameters(loop, alpha, shapes, pairs[0][0][0], pairs[0][1][0])
    if minor is not None:
        minor_rms = _minor_rms(parameters, loop, minor)
    warnings += parameters.validated().warnings()
    return DuhemIdentification(
        parameters=parameters,
        alpha=float(alpha),
        alpha_source=source,
        loop=loop,
        rms=0.5 * shapes.rms,
        maximum=0.5 * shapes.maximum,
        minor_rms=minor_rms,
        converged=converged,
        warnings=tuple(warnings),
    )


def _operator(loop: MajorLoop, alpha):
    """Return the operator and the target of its output: the rising branch, then the falling branch."""
    return LoopOperator(loop.grid, alpha, loop.rising[0]), np.concatenate([loop.rising, loop.falling[::-1]])


def _parameters(loop: MajorLoop, alpha, shapes: Shapes, input_start, output_start) -> DuhemParameters:
    numbers = {f"f_{shapes.kind}": tuple(shapes.f.tolist()), f"g_{shapes.kind}": tuple(shapes.g.tolist())}
    return DuhemParameters(
        alpha=float(alpha * 2.0 / (loop.input_high - loop.input_low)),
        input_low=loop.input_low,
        input_high=loop.input_high,
        output_low=loop.output_low,
        output_high=loop.output_high,
        shape=shapes.kind,
        input_start=float(input_start),
        output_start=float(output_start),
        **numbers,
    )


def _has_minor_loops(u) -> bool:
    """Return whether a reversal lies well inside the range of ``u``."""
    low, high = u.min(), u.max()
    inside = SMALLEST_MINOR * (high - low)
    # the beginning and the end of the recording are not reversals
    turns = [u[branch.start] for branch in split_branches(u)[1:]]
    return any(low + inside < turn < high - inside for turn in turns)


def _minor_rms(parameters: DuhemParameters, loop: MajorLoop, minor) -> float:
    """Return the residual for recording ``minor`` from its first reversal on, as a fraction of the full range."""
    u, y = minor
    block = DuhemHysteresis(replace(parameters, input_start=float(u[0]), output_start=float(y[0])), 1.0)
    first = split_branches(u)[0]
    # if the first branch starts inside the range, the initial state of the model is unknown
    inside = min(abs(u[0] - loop.input_low), abs(u[0] - loop.input_high)) > NEAR_END * (
        loop.input_high - loop.input_low
    )
    error = (block.simulate(u) - y)[first.stop if inside else 0 :]
    return float(np.sqrt(np.mean(error**2))) / (loop.output_high - loop.output_low)


def _thinned(u, y):
    """Return a subset of the samples with all reversals; a rate-independent model needs no other samples."""
    step = max(1, u.size // SEARCH_SAMPLES)
    turns = [branch.stop for branch in split_branches(u)]
    kept = np.union1d(np.arange(0, u.size, step), np.array(turns, dtype=int))
    return u[kept], y[kept]


def _search_alpha(loop: MajorLoop, minor):
    """Return the α that best reproduces the minor loops, and whether it lies inside the searched range."""
    from scipy.optimize import minimize_scalar  # imported here because only fits need it

    random = np.random.default_rng(0)
    minor = _thinned(*minor)

    def misfit(logarithm):
        alpha = float(np.exp(logarithm))
        operator, target = _operator(loop, alpha)
        knots = min(SEARCH_KNOTS, len(target) // 6)
        shapes = fit_shapes(operator, target, "spline", knots, random)
        value = _minor_rms(_parameters(loop, alpha, shapes, 0.0, 0.0), loop, minor)
        return value if np.isfinite(value) else np.inf

    grid = np.log(ALPHAS)
    best = int(np.argmin([misfit(value) for value in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    found = minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": ALPHA_TOLERANCE})
    inside = low + 5 * ALPHA_TOLERANCE < found.x < high - 5 * ALPHA_TOLERANCE
    return float(np.exp(found.x)), bool(found.success and (inside or 0 < best < grid.size - 1))


#: With ``minimum_phase``, the magnitude of the zero is limited to this value.
LARGEST_ZERO = 0.98


@dataclass(frozen=True)
class DuhemHammerstein:
    """Result of :func:`identify_duhem_hammerstein`."""

    hysteresis: DuhemIdentification  #: Voltage to displacement, at the amplitude of the first recording.
    linear: ArxFit  #: Linear part G2 after the hysteresis.
    linear_only: ArxFit  #: G1, the linear model without hysteresis, for comparison.
    prepared: PreparedLoops  #: Lags and gains of the recordings.
    rms: tuple[float, ...]  #: Simulation error of the whole model for each recording [m].
    linear_only_rms: tuple[float, ...]  #: Simulation error of G1 for each recording [m].
    converged: bool  #: Whether the fit of the hysteresis converged.
    warnings: tuple[str, ...]  #: Warnings of both parts.

    @property
    def parameters(self) -> tuple[DuhemParameters, LinearParameters]:
        """Both parts as parameters of an actuator: the gain is in the hysteresis, the linear part has unit DC gain."""
        gain = self.linear.model.dc_gain
        hysteresis = self.hysteresis.parameters
        scaled = {name: gain * getattr(hysteresis, name) for name in ("output_low", "output_high", "output_start")}
        return replace(hysteresis, **scaled), self.linear.model.linear_parameters()


def identify_duhem_hammerstein(
    recordings,
    sample_time: float,
    *,
    minor=None,
    minimum_phase: bool = False,
    delays=None,
    **duhem,
) -> DuhemHammerstein:
    """Identify v → Duhem → G2 from sines of one amplitude and several frequencies (W2, W3, W5).

    Units: ``recordings`` [V], [m], ``sample_time`` [s], ``delays`` [s].
    """
    recordings = [checked_signals(*pair) for pair in recordings]
    prepared = prepare_loops(recordings, sample_time, delays)
    if minor is not None:
        alone = prepare_loops([minor], sample_time)
        # both recordings begin with the same large reversals, so the ratio of their amplitudes is the gain of the
        # linear part
        minor = (alone.voltage[0], alone.displacement[0] * (prepared.gains[0] / alone.gains[0]))
    hysteresis = identify_duhem(prepared.voltage, prepared.displacement, minor=minor, **duhem)
    block = DuhemHysteresis(hysteresis.parameters, sample_time)
    inputs, outputs, raw = [], [], []
    for voltage, displacement in recordings:
        block.reset()
        passed = block.simulate(voltage)
        # the first branch begins at rest, where the state of the hysteresis is unknown
        settled = split_branches(voltage)[0].stop
        inputs.append(passed[settled:])
        outputs.append(displacement[settled:])
        raw.append(voltage[settled:])
    radius = LARGEST_ZERO if minimum_phase else None
    linear = fit_arx(inputs, outputs, sample_time, zero_radius=radius, units=("m", "m"))
    linear_only = fit_arx(raw, outputs, sample_time, zero_radius=radius)
    return DuhemHammerstein(
        hysteresis=hysteresis,
        linear=linear,
        linear_only=linear_only,
        prepared=prepared,
        rms=_simulation_rms(linear, inputs, outputs),
        linear_only_rms=_simulation_rms(linear_only, raw, outputs),
        converged=hysteresis.converged,
        warnings=hysteresis.warnings + tuple(f"linear part: {warning}" for warning in linear.warnings),
    )


def _simulation_rms(fit: ArxFit, inputs, outputs) -> tuple[float, ...]:
    """Return the rms simulation error of the linear model for each recording, started from its first two outputs."""
    found = []
    for w, y in zip(inputs, outputs, strict=True):
        start = (y[0], y[1] + fit.denominator[1] * y[0] - fit.numerator[0] * w[0])
        found.append(float(np.sqrt(np.mean((fit.model.simulate(w, start) - y) ** 2))))
    return tuple(found)
