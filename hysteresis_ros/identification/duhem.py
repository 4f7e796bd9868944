# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification of the Duhem model and of its inverse (Wang, Alici & Tan 2014; W2-W4).

The branches of the major loop give f and g for a given α. The paper fixes α = 80 (for an input of -1 … 1), with which
the model reproduces the major loop and nothing else: after a reversal inside it the output first moves the wrong way. α
is what minor loops are made of, so it is identified from them (W7) wherever the recordings hold any.

The inverse (W4) is the same with input and output exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.branches import checked_signals, split_branches
from hysteresis_ros.identification.duhem_loops import NEAR_END, OPEN_END, MajorLoop, major_loop
from hysteresis_ros.identification.shape_functions import LARGEST_ALPHA, LoopOperator, Shapes, fit_shapes
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters

#: The paper's α, for a normalised input of -1 … 1.
PUBLISHED_ALPHA = 80.0
#: α among which the search starts, and the knots of the splines it uses.
ALPHAS = np.geomspace(0.05, 100.0, 23)
SEARCH_KNOTS = 26
#: Samples of the minor loops the search looks at.
SEARCH_SAMPLES = 800
ALPHA_TOLERANCE = 1e-3
#: Smallest part of the range that a minor loop must differ from the major one to say anything about α.
SMALLEST_MINOR = 0.1


@dataclass(frozen=True)
class DuhemIdentification:
    """Result of :func:`identify_duhem` and :func:`identify_inverse_duhem`.

    Parameters
    ----------
    parameters : DuhemParameters
        The model, in the units of the recording.
    alpha : float
        α for the normalised input, as the paper counts it.
    alpha_source : str
        ``given``, ``minor loops`` or ``paper``.
    loop : MajorLoop
        The branches it was made of.
    rms, maximum : float
        Residual of the major loop, in parts of its full range.
    minor_rms : float
        Residual of the recording α comes from, in parts of the full range; NaN without minor loops.
    converged : bool
        The training of f and g and the search for α ended by themselves; α does not lie at a bound.
    warnings : tuple of str
        What to doubt.
    """

    parameters: DuhemParameters
    alpha: float
    alpha_source: str
    loop: MajorLoop
    rms: float
    maximum: float
    minor_rms: float
    converged: bool
    warnings: tuple[str, ...]


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

    Parameters
    ----------
    voltage, displacement : array_like, shape (N,), or sequences of such
        Recordings [V], [m] with at least one whole major loop; see
        :func:`~hysteresis_ros.identification.duhem_loops.prepare_loops` for several frequencies.
    alpha : float, optional
        α for an input normalised to -1 … 1 (:data:`PUBLISHED_ALPHA` for the paper's case). Without it α comes from
        minor loops if there are any, and is the paper's otherwise.
    minor : (voltage, displacement), optional
        Recording with minor loops, e.g. of decaying amplitude; by default the first of the recordings that has some.
    shape : str
        ``network`` or ``spline``.
    size : int, optional
        Units of each network or knots of each spline; chosen automatically when not given.
    seed : int
        Of the training.

    Raises
    ------
    IdentificationError
        Unusable data, a single branch, no whole loop, an α out of range.
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

    The arguments are those of :func:`identify_duhem`; the parameters that come back take metres and give volt.

    Raises
    ------
    IdentificationError
        As for :func:`identify_duhem`, or a branch whose displacement is not monotone, which has no inverse.
    """
    if minor is not None:
        minor = (minor[1], minor[0])
    settings = dict(alpha=alpha, minor=minor, shape=shape, size=size, seed=seed)
    return _identify(("displacement", "voltage"), (displacement, voltage), **settings)


def _identify(names, signals, *, alpha, minor, shape, size, seed) -> DuhemIdentification:
    """Identify from ``signals``, input and output called ``names``."""
    inputs, outputs = signals
    if shape not in ("network", "spline"):
        raise IdentificationError(f"shape = {shape!r}: must be network or spline")
    if alpha is not None and not 0.0 < alpha <= LARGEST_ALPHA:
        raise IdentificationError(f"alpha = {alpha:g}: must be in 0 … {LARGEST_ALPHA:g}, not 0 (normalised input)")
    if np.ndim(inputs[0]) == 0:
        inputs, outputs = [inputs], [outputs]
    pairs = [checked_signals(u, y, names) for u, y in zip(inputs, outputs, strict=True)]
    loop = major_loop([u for u, _ in pairs], [y for _, y in pairs])
    warnings = []
    if loop.gap > OPEN_END:
        warnings.append(
            f"the branches miss each other by {100.0 * loop.gap:.2g} % of the range at an end of the loop: drift, "
            "creep, or a first cycle from rest; record further cycles"
        )
    if loop.opening < 1e-3:
        warnings.append(f"the loop opens by {100.0 * loop.opening:.2g} % of its range only; there is hardly hysteresis")
    if minor is not None:
        minor = checked_signals(*minor, names)
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
            f"no minor loops: alpha = {alpha:g} is the paper's; it reproduces the major loop only, after a reversal "
            "inside it the output first moves the wrong way; record loops of decaying amplitude"
        )
    operator, target = _operator(loop, alpha)
    shapes = fit_shapes(operator, target, shape, size, np.random.default_rng(seed), loop.noise)
    if not shapes.converged:
        converged = False
        warnings.append(f"the training of f and g was ended with a residual of {50.0 * shapes.rms:.2g} % of the range")
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
    """Return the operator and the outputs it should give: up the rising and down the falling branch."""
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
    """Tell whether some reversal lies well inside the range of ``u``."""
    low, high = u.min(), u.max()
    inside = SMALLEST_MINOR * (high - low)
    # where the recording begins and ends is no reversal
    turns = [u[branch.start] for branch in split_branches(u)[1:]]
    return any(low + inside < turn < high - inside for turn in turns)


def _minor_rms(parameters: DuhemParameters, loop: MajorLoop, minor) -> float:
    """Return the residual of a recording, in parts of the full range, from its first reversal on."""
    u, y = minor
    block = DuhemHysteresis(replace(parameters, input_start=float(u[0]), output_start=float(y[0])), 1.0)
    first = split_branches(u)[0]
    # a first branch from the middle of the range comes from rest, which the model does not know
    inside = min(abs(u[0] - loop.input_low), abs(u[0] - loop.input_high)) > NEAR_END * (
        loop.input_high - loop.input_low
    )
    error = (block.simulate(u) - y)[first.stop if inside else 0 :]
    return float(np.sqrt(np.mean(error**2))) / (loop.output_high - loop.output_low)


def _thinned(u, y):
    """Return fewer samples of a recording, its reversals among them: rate independence allows it."""
    step = max(1, u.size // SEARCH_SAMPLES)
    turns = [branch.stop for branch in split_branches(u)]
    kept = np.union1d(np.arange(0, u.size, step), np.array(turns, dtype=int))
    return u[kept], y[kept]


def _search_alpha(loop: MajorLoop, minor):
    """Return the α whose major loop also gives the minor loops, and whether it lies inside the searched range."""
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
