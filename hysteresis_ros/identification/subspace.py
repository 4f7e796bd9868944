# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""State space of several inputs and outputs from a frequency response: subspace method and refinement of the modes.

McKelvey's method [1]_ for arbitrary lines finds A and C of a discrete state space from the range of the stacked
response, without iteration and without a canonical form; B and D follow by linear least squares. The model is then
transformed into modal form: A is block-diagonal with 2×2 blocks [[σ, β], [γ, σ]]. β is fixed; Levenberg and Marquardt's
method refines all other parameters on the response. A block represents a conjugate pair (β γ < 0) or two real poles,
and may change from one to the other during the fit.

References
----------
.. [1] McKelvey, Akçay & Ljung, Subspace-based multivariable system identification from frequency response data, IEEE
   Trans. Autom. Control 41 (1996) 960-979, doi:10.1109/9.508900, algorithm 2 (arbitrary lines).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from hysteresis_ros.identification.data import refuse_short
from hysteresis_ros.identification.frequency_response import FrequencyResponse
from hysteresis_ros.identification.levenberg_marquardt import Minimum, minimise
from hysteresis_ros.identification.linear_systems import FitError, LinearModel
from hysteresis_ros.identification.matrix_fraction import refit_input

#: Default of the largest modulus of a pole. Poles outside the unit circle are reflected into it; poles between this
#: radius and the circle are moved to this radius.
RADIUS = 1.0 - 1e-5
#: Smallest half distance of two real poles in a block; closer poles are moved apart to this half distance.
HALF_DISTANCE = 1e-4


def subspace_model(
    data: FrequencyResponse,
    order: int,
    *,
    blocks: int | None = None,
    weights=None,
    feedthrough: bool = True,
    radius: float = RADIUS,
) -> LinearModel:
    """Return the stable state space of the given order by McKelvey's method.

    ``blocks``: number of block rows of the stacked response, by default three times the minimum for the order;
    ``weights``, shape (F,): weights of the lines; ``radius``: largest modulus of a pole.
    """
    G = data.response
    F, q, m = G.shape
    if order < 1:
        raise FitError(f"order = {order}: a state space has at least one state")
    needed = -(-order // q) + 1
    rows = blocks or 3 * needed
    if rows < needed:
        raise FitError(f"blocks = {rows}: at least {needed} are needed for order {order} and {q} outputs")
    what = f"a subspace model of order {order} (the real and imaginary parts of the response count as samples)"
    refuse_short(2 * F * m, 2 * rows * (q + m), what)
    scale = np.sqrt(np.mean(np.abs(G) ** 2))
    z = np.exp(2j * np.pi * data.frequency * data.sample_time)
    powers = z[:, None] ** np.arange(rows)
    if weights is not None:
        powers = powers * np.asarray(weights, dtype=float)[:, None]
    # a column for each line and input; the rows of the input are above those of the response
    exciting = np.einsum("fr,ij->rifj", powers, np.eye(m)).reshape(rows * m, F * m)
    excited = np.einsum("fr,fij->rifj", powers, G / scale).reshape(rows * q, F * m)
    table = np.concatenate([exciting, excited])
    table = np.concatenate([table.real, table.imag], axis=1)
    (triangle,) = scipy.linalg.qr(table.T, mode="r", overwrite_a=True, check_finite=False)[:1]
    triangle = triangle[: len(table)]
    # the part of the response that the inputs do not explain is in the range of the observability matrix
    left, _, _ = np.linalg.svd(triangle[rows * m :, rows * m :].T)
    seen = left[:, :order]
    A = np.linalg.lstsq(seen[:-q], seen[q:], rcond=None)[0]
    model = LinearModel(
        _stabilised(A, radius), np.zeros((order, m)), seen[:q] * scale, np.zeros((q, m)), data.sample_time
    )
    model = replace(model, input_unit=data.input_unit, output_unit=data.output_unit)
    return refit_input(model, data, None if weights is None else _deviation(weights, G.shape), feedthrough)


def _deviation(weights, shape):
    return np.broadcast_to(1.0 / np.asarray(weights, dtype=float)[:, None, None], shape)


def _stabilised(A, radius: float) -> np.ndarray:
    """Return A with poles outside the unit circle reflected into it, and then all poles moved inside ``radius``."""
    poles, vectors = np.linalg.eig(A)
    size = np.abs(poles)
    if np.all(size <= radius):
        return A
    poles = np.where(size > 1.0, 1.0 / poles.conj(), poles)
    poles = poles * np.minimum(1.0, radius / np.abs(poles))
    return np.real(vectors * poles @ np.linalg.inv(vectors))


def modal(model: LinearModel) -> LinearModel:
    """Return a model of even order in modal form: A has 2×2 blocks, and the part of B for each block has norm 1."""
    if model.order % 2:
        raise FitError(f"order = {model.order}: modes are pairs of poles; choose an even order")
    poles, vectors = np.linalg.eig(model.A)
    blocks, columns = [], []
    real = [(float(p.real), np.real(v)) for p, v in zip(poles, vectors.T, strict=True) if p.imag == 0.0]
    for pole, vector in zip(poles, vectors.T, strict=True):
        if pole.imag > 0.0:
            blocks.append([[pole.real, pole.imag], [-pole.imag, pole.real]])
            columns += [vector.real, vector.imag]
    real.sort(key=lambda item: item[0])
    for (first, v), (second, w) in zip(real[::2], real[1::2], strict=True):
        centre, half = 0.5 * (first + second), max(0.5 * (second - first), HALF_DISTANCE)
        blocks.append([[centre, half], [half, centre]])
        # eigenvectors of the block are (1, -1) and (1, 1)
        columns += [0.5 * (v + w), 0.5 * (w - v)]
    T = np.array(columns).T
    A = scipy.linalg.block_diag(*blocks)
    B, C = np.linalg.solve(T, model.B), model.C @ T
    size = np.repeat(np.linalg.norm(B.reshape(-1, 2 * B.shape[1]), axis=1), 2)
    size[size == 0.0] = 1.0
    return replace(model, A=A, B=B / size[:, None], C=C * size)


class ModalParameters:
    """The free parameters of a modal model as one vector: σ and γ of the blocks, B, C and D; β is constant.

    Without ``feedthrough`` D is zero and not part of the vector.
    """

    def __init__(self, model: LinearModel, feedthrough: bool = True):
        self.template = model if feedthrough else replace(model, D=np.zeros_like(model.D))
        self.feedthrough = feedthrough
        self.blocks, self.inputs, self.outputs = model.order // 2, model.B.shape[1], len(model.C)
        n, m, q = model.order, self.inputs, self.outputs
        self.beta = np.diag(model.A, 1)[::2].copy()
        sizes = np.cumsum([0, self.blocks, self.blocks, n * m, q * n, q * m * feedthrough])
        self.sigma, self.gamma, self.B, self.C, self.D = (
            slice(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )

    def vector(self, model: LinearModel) -> np.ndarray:
        """Return the vector of a model that has the same β."""
        sigma, gamma = np.diag(model.A)[::2], np.diag(model.A, -1)[::2]
        through = model.D.ravel() if self.feedthrough else ()
        return np.concatenate([sigma, gamma, model.B.ravel(), model.C.ravel(), through])

    def model(self, theta) -> LinearModel:
        """Return the model with the parameters in a vector."""
        n, m, q = 2 * self.blocks, self.inputs, self.outputs
        return replace(
            self.template,
            A=modal_matrix(theta[self.sigma], self.beta, theta[self.gamma]),
            B=theta[self.B].reshape(n, m),
            C=theta[self.C].reshape(q, n),
            D=theta[self.D].reshape(q, m) if self.feedthrough else self.template.D,
        )


def modal_matrix(sigma, beta, gamma) -> np.ndarray:
    """Return the matrix A with blocks [[σ, β], [γ, σ]]."""
    n = 2 * len(sigma)
    A = np.zeros((n, n))
    first = np.arange(0, n, 2)
    A[first, first] = A[first + 1, first + 1] = sigma
    A[first, first + 1], A[first + 1, first] = beta, gamma
    return A


def within(sigma, beta, gamma, radius: float):
    """Return σ and γ of blocks [[σ, β], [γ, σ]], with poles beyond ``radius`` moved towards 0."""
    root = np.sqrt(np.asarray(beta * gamma, dtype=complex))
    largest = np.maximum(np.abs(sigma + root), np.abs(sigma - root))
    factor = np.minimum(1.0, radius / np.maximum(largest, 1e-300))
    return sigma * factor, gamma * factor**2


class _ResponseError:
    """Weighted deviation of a modal model from a response, with its derivatives with respect to the parameters."""

    def __init__(self, given: ModalParameters, data: FrequencyResponse, weights, feedthrough: bool):
        self.given, self.feedthrough = given, feedthrough
        self.G = data.response
        self.weights = (
            np.full(self.G.shape, 1.0 / np.sqrt(np.mean(np.abs(self.G) ** 2))) if weights is None else weights
        )
        self.z = np.exp(2j * np.pi * data.frequency * data.sample_time)

    def resolvent(self, theta) -> np.ndarray:
        """Return (z I - A)⁻¹ of each block, shape (F, blocks, 2, 2)."""
        given, z = self.given, self.z
        sigma, gamma = theta[given.sigma], theta[given.gamma]
        off = z[:, None] - sigma
        inverse = 1.0 / (off**2 - given.beta * gamma)
        first = off * inverse
        return np.stack([first, given.beta * inverse, gamma * inverse, first], axis=-1).reshape(len(z), -1, 2, 2)

    def terms(self, theta) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (z I - A)⁻¹ B, C (z I - A)⁻¹ and the weighted error, at each frequency."""
        given, z = self.given, self.z
        blocks, m, q = given.blocks, given.inputs, given.outputs
        R = self.resolvent(theta)
        B, C = theta[given.B].reshape(blocks, 2, m), theta[given.C].reshape(q, blocks, 2)
        X = np.einsum("fbij,bjm->fbim", R, B).reshape(len(z), 2 * blocks, m)
        L = np.einsum("qbi,fbij->fqbj", C, R).reshape(len(z), q, 2 * blocks)
        rest = theta[given.C].reshape(q, -1) @ X + given.model(theta).D - self.G
        return X, L, rest * self.weights

    def cost(self, theta) -> float:
        """Return the sum of the squared errors."""
        rest = self.terms(theta)[2]
        return float(np.sum(rest.real**2 + rest.imag**2))

    def normal(self, theta) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix and right-hand side of the normal equations for a Gauss-Newton step."""
        given = self.given
        X, L, rest = self.terms(theta)
        n, m, q = 2 * given.blocks, given.inputs, given.outputs
        matrix, gradient = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
        states = np.arange(n)
        for i in range(q):
            for j in range(m):
                row, column = L[:, i], X[:, :, j]
                product = row * column
                slopes = [product[:, ::2] + product[:, 1::2], row[:, 1::2] * column[:, ::2], row, column]
                entries = [np.arange(n), given.B.start + states * m + j, given.C.start + i * n + states]
                if self.feedthrough:
                    slopes.append(np.ones((len(self.z), 1)))
                    entries.append(np.array([given.D.start + i * m + j]))
                table = np.concatenate(slopes, axis=1) * self.weights[:, i, j, None]
                real = np.concatenate([table.real, table.imag])
                places = np.concatenate(entries)
                matrix[np.ix_(places, places)] += real.T @ real
                gradient[places] += real.T @ np.concatenate([rest[:, i, j].real, rest[:, i, j].imag])
        return matrix, gradient


def refine_on_response(
    model: LinearModel,
    data: FrequencyResponse,
    weights=None,
    steps: int = 100,
    radius: float = RADIUS,
    feedthrough: bool = True,
) -> tuple[LinearModel, Minimum]:
    """Return the modal model refined on a frequency response, and the result of the search.

    ``weights``, shape (F, q, m): weights of the entries, by default the inverse of the RMS of the whole response;
    ``radius``: largest modulus of a pole; ``feedthrough``: True: D is free; False: D is zero.
    """
    model = modal(model)
    given = ModalParameters(model, feedthrough)
    error = _ResponseError(given, data, weights, feedthrough)

    def allowed(theta):
        theta[given.sigma], theta[given.gamma] = within(theta[given.sigma], given.beta, theta[given.gamma], radius)
        return theta

    start = allowed(given.vector(model))
    found = minimise(start, error.cost, error.normal, steps=steps, tolerance=1e-5, allowed=allowed)
    return given.model(found.parameters), found
