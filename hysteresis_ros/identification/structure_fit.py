# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Refinement of a structure in the time domain: Gauss-Newton on the error of the simulation.

The fitted error is the error of a simulation that uses only the inputs, because an equation error with a measured z has
a trivial solution with an error of 0. The sensitivities are simulated together with the states:

    dx⁺ = A dx + B_w dw + (∂A x + ∂B u + ∂B_w w),   dz_i = C_z,i dx + ∂C_z,i x + ∂g_i u_i,
    dw_i = Σ_j a_ij dplay_ij + ∂a_ij play_ij,

where dplay = dz ∓ ∂r while a play slides; while it sticks, dplay does not change. Without plays the dynamics are
linear. Outputs are in units of ``scale``, so that all numbers are near 1.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros.identification.levenberg_marquardt import Minimum, minimise
from hysteresis_ros.identification.linear_systems import LinearModel
from hysteresis_ros.identification.subspace import RADIUS, modal_matrix, within
from hysteresis_ros.models.block import compiled, nested, specialised
from hysteresis_ros.models.structure import StructureParameters, packed, run_structure

#: Groups of parameters that affect the states, in the order of the sensitivities; C and D affect only the outputs.
DYNAMIC = ("sigma", "gamma", "B", "B_w", "C_z", "gains", "weights", "radii")
LINEAR_GROUPS = ("sigma", "gamma", "B", "C", "D")
#: Floating-point type of the sensitivities. Their precision affects the path of the search, but not its result, because
#: the error is computed in double precision.
PRECISION = np.float32
#: Number of parameters whose sensitivities are computed together, so that they fit into the cache of a core.
CHUNK = 192
#: JᵀJ uses every k-th sample, with k at most this number; the gradient always uses all samples.
STRIDE = 4
#: The largest k is used that leaves at least this number of values per parameter.
ROWS = 60


class Matrices(NamedTuple):
    """Matrices of a structure in modal form, with n states, m inputs, q outputs, h hystereses and r radii."""

    blocks: np.ndarray  #: shape (n/2, 3); σ, β, γ of each mode.
    B: np.ndarray
    B_w: np.ndarray
    C_z: np.ndarray
    gains: np.ndarray
    radii: np.ndarray
    weights: np.ndarray
    C: np.ndarray
    D: np.ndarray


class Rates(NamedTuple):
    """Matrices that multiply the sensitivities, in the precision of the sensitivities."""

    blocks: np.ndarray
    B_w: np.ndarray
    C_z: np.ndarray
    weights: np.ndarray
    C: np.ndarray


class Varied(NamedTuple):
    """Positions of P parameters: index of the group in :data:`DYNAMIC`, row and column in it; shape (P,) each."""

    kind: np.ndarray
    row: np.ndarray
    column: np.ndarray


class Found(NamedTuple):
    """Results at N samples."""

    y: np.ndarray  #: shape (N, q); Outputs.
    X: np.ndarray  #: shape (N, n); States.
    J: np.ndarray  #: shape (N, q P); Sensitivities of the outputs.


class Room(NamedTuple):
    """Working memory for the states and sensitivities of the present sample."""

    x: np.ndarray  #: n states, n temporary values, w (h), plays (h r).
    S: np.ndarray  #: shape (2 n, P); Sensitivities of the states.
    inner: np.ndarray  #: shape (2 h + h r, P); dz, dw, dplay.


@nested
def _note_sample(model, rates, found, room, now, at):
    """Write the outputs, the states and the sensitivities of the outputs of a sample."""
    x, S, J = room.x, room.S, found.J
    n, m, P = model.B.shape[0], model.B.shape[1], S.shape[1]
    for j in range(n):
        found.X[at, j] = x[j]
    for i in range(model.C.shape[0]):
        total = 0.0
        for j in range(m):
            total += model.D[i, j] * now[j]
        for j in range(n):
            total += model.C[i, j] * x[j]
        found.y[at, i] = total
        first = i * P
        for p in range(P):
            J[at, first + p] = 0.0
        for b in range(0, n, 2):
            c0, c1 = rates.C[i, b], rates.C[i, b + 1]
            for p in range(P):
                J[at, first + p] += c0 * S[b, p] + c1 * S[b + 1, p]


@nested
def _slide(model, rates, varied, room, now):
    """Move the plays of all hystereses and update their sensitivities."""
    x, S, inner = room.x, room.S, room.inner
    kind, row, column = varied.kind, varied.row, varied.column
    n, m, P = model.B.shape[0], model.B.shape[1], S.shape[1]
    h, r = model.weights.shape
    for i in range(h):
        z = model.gains[i] * now[i % m]
        for j in range(n):
            z += model.C_z[i, j] * x[j]
        for p in range(P):
            inner[i, p] = 0.0
            inner[h + i, p] = 0.0
        for b in range(0, n, 2):
            c0, c1 = rates.C_z[i, b], rates.C_z[i, b + 1]
            for p in range(P):
                inner[i, p] += c0 * S[b, p] + c1 * S[b + 1, p]
        for p in range(P):
            if kind[p] == 4 and row[p] == i:
                inner[i, p] += x[column[p]]
            elif kind[p] == 5 and row[p] == i:
                inner[i, p] += now[i % m]
        w = 0.0
        for j in range(r):
            place = 2 * n + h + i * r + j
            value, rate = x[place], 2 * h + i * r + j
            sign = 0.0
            if z - model.radii[j] > value:
                value, sign = z - model.radii[j], 1.0
            elif z + model.radii[j] < value:
                value, sign = z + model.radii[j], -1.0
            if sign != 0.0:
                for p in range(P):
                    inner[rate, p] = inner[i, p]
                for p in range(P):
                    if kind[p] == 7 and row[p] == j:
                        inner[rate, p] -= sign
            x[place] = value
            w += model.weights[i, j] * value
            share = rates.weights[i, j]
            for p in range(P):
                inner[h + i, p] += share * inner[rate, p]
            for p in range(P):
                if kind[p] == 6 and row[p] == i and column[p] == j:
                    inner[h + i, p] += value
        x[2 * n + i] = w


@nested
def _advance(model, rates, varied, room, now):
    """Advance the states and sensitivities by one sample."""
    x, S, inner = room.x, room.S, room.inner
    kind, row, column = varied.kind, varied.row, varied.column
    n, m, P = model.B.shape[0], model.B.shape[1], S.shape[1]
    h, r = model.weights.shape
    for b in range(0, n, 2):
        c0, c1, c2 = rates.blocks[b // 2, 0], rates.blocks[b // 2, 1], rates.blocks[b // 2, 2]
        for p in range(P):
            S[n + b, p] = c0 * S[b, p] + c1 * S[b + 1, p]
            S[n + b + 1, p] = c2 * S[b, p] + c0 * S[b + 1, p]
        s, beta, g = model.blocks[b // 2, 0], model.blocks[b // 2, 1], model.blocks[b // 2, 2]
        upper, lower = s * x[b] + beta * x[b + 1], g * x[b] + s * x[b + 1]
        for j in range(m):
            upper += model.B[b, j] * now[j]
            lower += model.B[b + 1, j] * now[j]
        if r:
            for j in range(h):
                upper += model.B_w[b, j] * x[2 * n + j]
                lower += model.B_w[b + 1, j] * x[2 * n + j]
                into, below = rates.B_w[b, j], rates.B_w[b + 1, j]
                for p in range(P):
                    S[n + b, p] += into * inner[h + j, p]
                    S[n + b + 1, p] += below * inner[h + j, p]
        x[n + b], x[n + b + 1] = upper, lower
    for p in range(P):
        i = row[p]
        if kind[p] == 0:
            S[n + 2 * i, p] += x[2 * i]
            S[n + 2 * i + 1, p] += x[2 * i + 1]
        elif kind[p] == 1:
            S[n + 2 * i + 1, p] += x[2 * i]
        elif kind[p] == 2:
            S[n + i, p] += now[column[p]]
        elif kind[p] == 3:
            S[n + i, p] += x[2 * n + column[p]]
    for j in range(n):
        x[j] = x[n + j]
        for p in range(P):
            S[j, p] = S[n + j, p]


def run_sensitivities(model, rates, varied, u, found, room):
    """Fill ``found`` with the results for ``u``; the first rows of ``u``, those in excess of N, are the run-in."""
    run_in = u.shape[0] - found.y.shape[0]
    room.x[:] = 0.0
    room.S[:, :] = 0.0
    room.inner[:, :] = 0.0
    for k in range(u.shape[0]):
        now = u[k]
        if k >= run_in:
            _note_sample(model, rates, found, room, now, k - run_in)
        if model.weights.shape[1]:
            _slide(model, rates, varied, room, now)
        _advance(model, rates, varied, room, now)


@dataclass(frozen=True, eq=False)
class ModalStructure:
    """A structure in modal form during the fit: blocks [[σ, β], [γ, σ]], outputs in units of ``scale`` [m]."""

    sigma: np.ndarray  #: shape (n/2,)
    gamma: np.ndarray  #: shape (n/2,)
    beta: np.ndarray  #: shape (n/2,), fixed.
    B: np.ndarray  #: shape (n, m)
    C: np.ndarray  #: shape (q, n)
    D: np.ndarray  #: shape (q, m)
    B_w: np.ndarray  #: shape (n, h)
    C_z: np.ndarray  #: shape (h, n)
    gains: np.ndarray  #: shape (h,)
    weights: np.ndarray  #: shape (h, r)
    radii: np.ndarray  #: shape (r,) [V]
    sample_time: float  #: [s]
    scale: float  #: [m]

    @classmethod
    def linear(cls, model: LinearModel, scale: float) -> ModalStructure:
        """Return a modal model (:func:`~hysteresis_ros.identification.subspace.modal`) as a structure without plays."""
        n, m = model.B.shape
        return cls(
            np.diag(model.A)[::2].copy(),
            np.diag(model.A, -1)[::2].copy(),
            np.diag(model.A, 1)[::2].copy(),
            model.B,
            model.C / scale,
            model.D / scale,
            np.zeros((n, m)),
            np.zeros((m, n)),
            np.ones(m),
            np.zeros((m, 0)),
            np.zeros(0),
            model.sample_time,
            scale,
        )

    def parameters(self) -> StructureParameters:
        """Return the parameters of the block, in SI units."""
        A = modal_matrix(self.sigma, self.beta, self.gamma)
        blocks = [A[i : i + 2, i : i + 2] for i in range(0, len(A), 2)]
        plays = len(self.radii) > 0
        return StructureParameters(
            inputs=self.B.shape[1],
            outputs=len(self.C),
            A=_flat(blocks),
            B=_flat(self.B),
            C=_flat(self.C * self.scale),
            D=_flat(self.D * self.scale),
            B_w=_flat(self.B_w) if plays else (),
            C_z=_flat(self.C_z) if plays else (),
            input_gains=_flat(self.gains) if plays else (),
            radii=_flat(self.radii),
            weights=_flat(self.weights),
            sample_time=self.sample_time,
        )

    def within(self, radius: float) -> ModalStructure:
        """Return the structure with the poles of its modes within ``radius``, and without negative radii of plays."""
        sigma, gamma = within(self.sigma, self.beta, self.gamma, radius)
        return replace(self, sigma=sigma, gamma=gamma, radii=np.maximum(self.radii, 0.0))

    @property
    def stable(self) -> bool:
        """Whether the structure is stable for motions much larger than all radii."""
        A = modal_matrix(self.sigma, self.beta, self.gamma) + self.B_w * self.weights.sum(axis=1) @ self.C_z
        return bool(np.abs(np.linalg.eigvals(A)).max() < 1.0)


def _flat(values) -> tuple[float, ...]:
    return tuple(np.ravel(values).tolist())


@dataclass(frozen=True, eq=False)
class Experiments:
    """Recordings to fit: inputs with a run-in, and the outputs measured after it."""

    u: np.ndarray  #: shape (R, L + N, m) [V]; the first L samples are the run-in.
    y: np.ndarray  #: shape (R, N, q) [m]
    deviation: np.ndarray  #: shape (R,); Unit [m] of the error of each realisation.

    def part(self, chosen) -> Experiments:
        """Return some of the realisations."""
        return Experiments(self.u[chosen], self.y[chosen], self.deviation[chosen])

    def simulated(self, structure: StructureParameters) -> np.ndarray:
        """Return the outputs of a structure after the run-in from rest, shape (R, N, q) [m]."""
        p = packed(structure)
        found = np.empty_like(self.y)
        whole = np.empty((self.u.shape[1], self.y.shape[2]))
        size = 2 * structure.order + structure.hystereses * (1 + len(structure.radii))
        for one, u in zip(found, self.u, strict=True):
            compiled(run_structure)(p, np.zeros(size), u, whole)
            one[:] = whole[len(whole) - len(one) :]
        return found

    def cost(self, structure: StructureParameters) -> float:
        """Return the mean square error of a structure, in units of ``deviation``."""
        rest = self.simulated(structure) - self.y
        value = float(np.mean((rest / self.deviation[:, None, None]) ** 2))
        return value if np.isfinite(value) else np.inf


def refine_in_time(
    start: ModalStructure,
    data: Experiments,
    groups: Sequence[str],
    *,
    steps: int,
    held_out: Experiments | None = None,
    radius: float = RADIUS,
    patience: int = 3,
    deadline: float = np.inf,
    progress=None,
) -> tuple[ModalStructure, Minimum]:
    """Refine groups of parameters; the error on ``held_out`` ends the search and selects the returned point.

    No step begins after ``deadline``, a time of ``time.perf_counter`` [s].
    """
    shapes = {name: getattr(start, name).shape for name in (*DYNAMIC, "C", "D") if name in groups}
    sizes = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    places = {name: slice(a, b) for name, a, b in zip(shapes, sizes[:-1], sizes[1:], strict=True)}

    def structure(theta) -> ModalStructure:
        return replace(start, **{name: theta[places[name]].reshape(shape) for name, shape in shapes.items()})

    def cost(theta) -> float:
        model = structure(theta)
        return data.cost(model.parameters()) if model.stable else np.inf

    def vector(model: ModalStructure) -> np.ndarray:
        return np.concatenate([np.ravel(getattr(model, name)) for name in shapes])

    def normal(theta):
        return _normal_equations(structure(theta), data, places, shapes)

    def allowed(theta):
        return vector(structure(theta).within(radius))

    theta = allowed(vector(start))
    best, least, passed = theta, np.inf, 0

    def accepted(theta, value) -> bool:
        nonlocal best, least, passed
        judged = value if held_out is None else held_out.cost(structure(theta).parameters())
        if progress is not None:
            progress(f"{value:.6g} {judged:.6g}")
        if judged < least:
            best, least, passed = theta, judged, 0
        else:
            passed += 1
        return passed < patience and time.perf_counter() < deadline

    accepted(theta, cost(theta))
    found = minimise(theta, cost, normal, steps=steps, tolerance=1e-5, allowed=allowed, accepted=accepted)
    return structure(best), found


def _normal_equations(model: ModalStructure, data: Experiments, places, shapes):
    """Return JᵀJ and Jᵀr for the mean square error, as sums over the realisations."""
    (n, m), q, (h, r) = model.B.shape, len(model.C), model.weights.shape
    # the groups that affect the states come first, in the order of their indices in DYNAMIC
    entries = [
        (number, index[0], index[1] if len(index) > 1 else 0)
        for number, name in enumerate(DYNAMIC)
        if name in shapes
        for index in np.ndindex(*shapes[name])
    ]
    numbers = np.array(entries, dtype=np.int64).reshape(-1, 3)
    P, N = len(numbers), data.y.shape[1]
    y, X, x = np.empty((N, q)), np.empty((N, n)), np.empty(2 * n + h + h * r)
    blocks = np.column_stack([model.sigma, model.beta, model.gamma])
    parts = (blocks, model.B, model.B_w, model.C_z, model.gains, model.radii, model.weights, model.C, model.D)
    matrices = Matrices(*map(np.ascontiguousarray, parts))
    rates = Rates(*(getattr(matrices, name).astype(PRECISION) for name in Rates._fields))
    chunks = []
    for first in range(0, max(P, 1), CHUNK):
        some = numbers[first : first + CHUNK]
        sizes = (N, q * len(some)), (2 * n, len(some)), (2 * h + h * r, len(some))
        J, S, inner = (np.empty(size, dtype=PRECISION) for size in sizes)
        varied = Varied(*(np.ascontiguousarray(part) for part in some.T))
        chunks.append((slice(first, first + len(some)), varied, Found(y, X, J), Room(x, S, inner)))
    total = max(part.stop for part in places.values())
    matrix, gradient = np.zeros((total, total)), np.zeros(total)
    stride = int(np.clip(data.y.size // (ROWS * total), 1, STRIDE))
    _, varied, results, room = chunks[0]
    run = specialised(run_sensitivities, matrices, rates, varied, data.u[0], results, room)
    tables = np.empty((q, N, P + n * ("C" in places) + m * ("D" in places)), dtype=PRECISION)
    for u, measured, deviation in zip(data.u, data.y, data.deviation, strict=True):
        for where, varied, results, room in chunks:
            run(matrices, rates, varied, u, results, room)
            tables[:, :, where] = results.J.reshape(N, q, -1).transpose(1, 0, 2)
        share = (model.scale / deviation) ** 2 / data.y.size
        if "C" in places:
            tables[:, :, P : P + n] = X
        if "D" in places:
            tables[:, :, -m:] = u[len(u) - N :]
        for i, table in enumerate(tables):
            columns_of = [np.arange(P)]
            if "C" in places:
                columns_of.append(places["C"].start + i * n + np.arange(n))
            if "D" in places:
                columns_of.append(places["D"].start + i * m + np.arange(m))
            at = np.concatenate(columns_of)
            gradient[at] += share * ((y[:, i] - measured[:, i] / model.scale) @ table)
            some = np.ascontiguousarray(table[::stride])
            matrix[np.ix_(at, at)] += share * stride * (some.T @ some)
    return matrix, gradient
