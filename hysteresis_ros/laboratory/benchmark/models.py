# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The interface of a model in the benchmark; models of the package, simple models and users' models implement it."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import pathlib
import sys
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.optimize import nnls

from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.identification import workflow
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.registry import AUTO, USUAL
from hysteresis_ros.models.hysteresis import MODELS


class Line:
    """A straight line, fitted by least squares: the stage is assumed to be linear."""

    parameter_count = 2

    def fit(self, data: IdentificationData) -> Line:
        """Fit gain and constant."""
        self.gain, self.constant = np.polyfit(data.input, data.output, 1)
        return self

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the output, shape (N,)."""
        return self.gain * input + self.constant


#: Number of play operators of the classical model.
PLAYS = 20


def plays(input: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the outputs of play operators from rest at input 0, shape (N, thresholds)."""
    found = np.empty((len(input), len(thresholds)))
    state = np.zeros(len(thresholds))
    for k, u in enumerate(input):
        state = np.clip(state, u - thresholds, u + thresholds)
        found[k] = state
    return found


class ClassicalPrandtlIshlinskii:
    """A sum of play operators with weights ≥ 0 and a constant, by least squares.

    The thresholds divide half of the range of the input into equal parts; there are no dynamics.
    """

    parameter_count = PLAYS + 1

    def fit(self, data: IdentificationData) -> ClassicalPrandtlIshlinskii:
        """Fit the weights."""
        half = 0.5 * float(np.ptp(data.input))
        self.thresholds = half * np.arange(PLAYS) / PLAYS
        found = plays(data.input, self.thresholds)
        ones = np.ones((len(found), 1))
        # nnls finds only weights ≥ 0, so the constant has one column per sign, and the output is multiplied by the
        # gain's sign
        self.sign = 1.0 if np.polyfit(data.input, data.output, 1)[0] >= 0 else -1.0
        scale = float(np.ptp(data.output)) or 1.0
        weights, _ = nnls(np.hstack([found / half, ones, -ones]), self.sign * data.output / scale)
        self.weights = scale * weights[:PLAYS] / half
        self.constant = scale * (weights[PLAYS] - weights[PLAYS + 1])
        return self

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the output, shape (N,)."""
        return self.sign * (plays(input, self.thresholds) @ self.weights + self.constant)


#: Tried numbers of delayed outputs and of delayed inputs.
ORDERS = ((1, 1), (2, 2), (3, 3), (2, 4))
#: Tried ridge parameters, relative to the mean square.
RIDGE = (1e-10, 1e-7, 1e-4)
#: Fraction of the fit data, at their end, on which orders and ridge parameter are selected.
HELD_OUT = 0.25
#: Magnitude of the scaled output from which on a free run has diverged.
DIVERGED = 10.0


class Narx:
    """A polynomial of delayed outputs and inputs; least squares fit it one step ahead, and it predicts in a free run.

    The regressors are the delayed outputs and inputs, the change of the input and its absolute value, and all products
    of two of them. Orders and ridge are chosen by the error of a free run on the last quarter of the data.
    """

    def fit(self, data: IdentificationData) -> Narx:
        """Fit all orders with all ridge parameters; keep the combination with the best free run."""
        self.middle = float(np.mean(data.input)), float(np.mean(data.output))
        self.scale = 0.5 * float(np.ptp(data.input)) or 1.0, 0.5 * float(np.ptp(data.output)) or 1.0
        u, y = self._scaled(data.input), (data.output - self.middle[1]) / self.scale[1]
        split = int((1.0 - HELD_OUT) * len(u))
        best = np.inf
        for orders, ridge in itertools.product(ORDERS, RIDGE):
            weights = self._weights(u[:split], y[:split], orders, ridge)
            free = self._run(u, y, orders, weights)
            error = float(np.mean((free[split:] - y[split:]) ** 2))
            if error < best:
                best, self.orders, ridge_chosen = error, orders, ridge
        if not np.isfinite(best):
            raise ValueError("the free run diverges for every order and ridge parameter")
        self.weights = self._weights(u, y, self.orders, ridge_chosen)
        self.parameter_count = len(self.weights)
        return self

    def _scaled(self, input: np.ndarray) -> np.ndarray:
        return (input - self.middle[0]) / self.scale[0]

    @staticmethod
    def _regressors(outputs: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return the regressors, shape (n, …), from delayed outputs (n, a), newest first, and inputs (n, b)."""
        change = inputs[:, :1] - inputs[:, 1:2]
        linear = np.hstack([outputs, inputs, np.abs(change)])
        first, second = np.triu_indices(linear.shape[1])
        return np.hstack([np.ones((len(linear), 1)), linear, linear[:, first] * linear[:, second]])

    @classmethod
    def _weights(cls, u, y, orders, ridge) -> np.ndarray:
        a, b = orders
        begin = max(a, b)
        outputs = np.column_stack([y[begin - i : len(y) - i] for i in range(1, a + 1)])
        inputs = np.column_stack([u[begin - i : len(u) - i] for i in range(b + 1)])
        found = cls._regressors(outputs, inputs)
        square = found.T @ found
        square += ridge * np.trace(square) / len(square) * np.eye(len(square))
        return np.linalg.solve(square, found.T @ y[begin:])

    @classmethod
    def _run(cls, u, y, orders, weights) -> np.ndarray:
        """Return the free run, shape (N,), which starts from the measured outputs ``y``."""
        a, b = orders
        begin = max(a, b)
        found = np.empty(len(u))
        found[:begin] = y[:begin]
        for k in range(begin, len(u)):
            outputs = found[k - a : k][::-1][None]
            found[k] = cls._regressors(outputs, u[k - b : k + 1][::-1][None])[0] @ weights
            if not abs(found[k]) < DIVERGED:
                found[k:] = np.inf
                break
        return found

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the free run, shape (N,), from rest."""
        u = self._scaled(input)
        begin = max(self.orders)
        # at rest before the first sample: the input was constant, equal to its first value
        led = np.concatenate([np.full(begin, u[0]), u])
        rest = np.full(begin, self._resting(u[0]))
        free = self._run(led, np.concatenate([rest, np.empty(len(u))]), self.orders, self.weights)[begin:]
        return self.middle[1] + self.scale[1] * np.where(np.isfinite(free), free, DIVERGED)

    def _resting(self, u: float) -> float:
        """Return the steady-state output for a constant input."""
        y = np.zeros(500)
        found = self._run(np.full(500, u), y, self.orders, self.weights)
        return float(found[-1]) if np.isfinite(found[-1]) else 0.0


#: Number of hidden units.
UNITS = 8
#: Length of a training sequence [samples].
LENGTH = 160
#: Length of the first part of a training sequence, which is not evaluated [samples].
WARM_UP = 40
#: Number of sequences per training step.
BATCH = 32
#: Number of training steps.
STEPS = 600
#: Initial learning rate, which falls to zero during the training.
RATE = 1e-2


class GatedRecurrentUnit:
    """A gated recurrent unit of 8 hidden units in parallel with a straight line, trained through time by Adam (seed 0).

    The inputs of the unit are the scaled input and its change. Cho et al., EMNLP 2014, doi 10.3115/v1/D14-1179.
    """

    parameter_count = 3 * UNITS * (UNITS + 3) + UNITS + 2

    def fit(self, data: IdentificationData) -> GatedRecurrentUnit:
        """Train on random sequences of the recording."""
        random = np.random.default_rng(0)
        self.middle, self.scale = float(np.mean(data.input)), 0.5 * float(np.ptp(data.input)) or 1.0
        self.out_middle, self.out_scale = float(np.mean(data.output)), 0.5 * float(np.ptp(data.output)) or 1.0
        moved = np.diff(data.input, prepend=data.input[0])
        self.change = float(np.std(moved)) or 1.0
        features, target = self._features(data.input), (data.output - self.out_middle) / self.out_scale
        length = min(LENGTH, len(target))
        warm = min(WARM_UP, length // 4)
        size = 3 * UNITS
        self.weights = [
            random.standard_normal((2, size)) * 0.5,
            random.standard_normal((UNITS, size)) / np.sqrt(UNITS),
            np.zeros(size),
            random.standard_normal(UNITS) * 0.1,
            np.array([np.polyfit(features[:, 0], target, 1)[0], float(np.mean(target))]),
        ]
        moments = [[np.zeros_like(w), np.zeros_like(w)] for w in self.weights]
        for step in range(1, STEPS + 1):
            begins = random.integers(0, len(target) - length + 1, BATCH)
            places = begins + np.arange(length)[:, None]
            gradients = self._gradients(features[places], target[places], warm)
            rate = RATE * 0.5 * (1.0 + np.cos(np.pi * step / STEPS))
            norm = np.sqrt(sum(float(np.sum(g**2)) for g in gradients))
            for weight, gradient, (first, second) in zip(self.weights, gradients, moments, strict=True):
                gradient = gradient * min(1.0, 1.0 / max(norm, 1e-12))
                first += 0.1 * (gradient - first)
                second += 0.001 * (gradient**2 - second)
                weight -= rate * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
        return self

    def _features(self, input: np.ndarray) -> np.ndarray:
        moved = np.diff(input, prepend=input[0])
        return np.column_stack([(input - self.middle) / self.scale, moved / self.change])

    def _step(self, x: np.ndarray, h: np.ndarray):
        """Return gates and next state, shapes (batch, units)."""
        W, U, b, _, _ = self.weights
        given, kept = x @ W + b, h @ U
        z = _sigmoid(given[:, :UNITS] + kept[:, :UNITS])
        r = _sigmoid(given[:, UNITS : 2 * UNITS] + kept[:, UNITS : 2 * UNITS])
        c = np.tanh(given[:, 2 * UNITS :] + r * kept[:, 2 * UNITS :])
        return z, r, c, kept[:, 2 * UNITS :], h + z * (c - h)

    def _gradients(self, x: np.ndarray, target: np.ndarray, warm: int) -> list[np.ndarray]:
        """Return the gradients of the mean square error, x of shape (length, batch, 2), target (length, batch)."""
        W, U, _, v, line = self.weights
        length, batch = target.shape
        states: list[np.ndarray] = [np.zeros((batch, UNITS))]
        gates: list[list[np.ndarray]] = []
        for k in range(length):
            *gate, h = self._step(x[k], states[-1])
            gates.append(gate)
            states.append(h)
        hidden = np.array(states[1:])
        error = hidden @ v + line[0] * x[:, :, 0] + line[1] - target
        error[:warm] = 0.0
        error *= 2.0 / error[warm:].size
        dW, dU, db = np.zeros_like(W), np.zeros_like(U), np.zeros(3 * UNITS)
        dh = np.zeros((batch, UNITS))
        for k in range(length - 1, -1, -1):
            z, r, c, kept = gates[k]
            before = states[k]
            dh = dh + error[k][:, None] * v
            dc = dh * z * (1.0 - c**2)
            dz = dh * (c - before) * z * (1.0 - z)
            dr = dc * kept * r * (1.0 - r)
            given = np.hstack([dz, dr, dc])
            recurrent = np.hstack([dz, dr, dc * r])
            dW += x[k].T @ given
            dU += before.T @ recurrent
            db += given.sum(axis=0)
            dh = dh * (1.0 - z) + recurrent @ U.T
        dv = np.einsum("kb,kbu->u", error, hidden)
        return [dW, dU, db, dv, np.array([float(np.sum(error * x[:, :, 0])), float(np.sum(error))])]

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the output, shape (N,), from the state at rest under the first input."""
        x, v, line = self._features(input), self.weights[3], self.weights[4]
        h, found = np.zeros((1, UNITS)), np.empty(len(input))
        for _ in range(WARM_UP):
            *_, h = self._step(x[:1], h)
        for k in range(len(input)):
            *_, h = self._step(x[k : k + 1], h)
            found[k] = h[0] @ v
        return self.out_middle + self.out_scale * (found + line[0] * x[:, 0] + line[1])


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(0.5 * x))


class Fitted(Protocol):
    """A model after its fit.

    It may have ``parameter_count``, the number of fitted parameters.
    """

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the output under an input, from rest.

        Parameters
        ----------
        input : ndarray, shape (N,)
            Input, with the unit and the sample time of the fit data.

        Returns
        -------
        ndarray, shape (N,)
            Output, in the unit of the fit data. Sample k may depend only on the inputs up to sample k.
        """


class Model(Protocol):
    """A model before its fit; its class is called without arguments."""

    def fit(self, data: IdentificationData) -> Fitted:
        """Fit the model; it may return itself.

        Parameters
        ----------
        data : IdentificationData
            ``time`` [s], ``input``, ``output``, ``sample_time`` [s], ``input_unit`` and ``output_unit``; a model gets
            nothing else of the recording.

        Returns
        -------
        Fitted
        """


class PackageModel:
    """A model of the package with its default identification."""

    def __init__(self, name: str):
        self.name = name

    def fit(self, data: IdentificationData) -> PackageModel:
        """Identify the model."""
        self.found = workflow.identify(data, self.name)
        self.parameter_count = self.found.identification.fitted
        return self

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the prediction [m]."""
        return self.found.predict(input)


#: Simple models for comparison.
SIMPLE: dict[str, Callable[[], Any]] = {
    "line": Line,
    "classical_pi": ClassicalPrandtlIshlinskii,
    "narx": Narx,
    "gru": GatedRecurrentUnit,
}
#: Models that are compared if ``--model`` is not given.
COMPARED = (USUAL, *SIMPLE)


def names() -> tuple[str, ...]:
    """Return the names of all models of the package and of the simple models."""
    return (USUAL, AUTO, *MODELS, *SIMPLE)


def load_model(spec: str):
    """Return a model before its fit.

    Parameters
    ----------
    spec : str
        A name of :func:`names`; or ``module:Class`` or ``path/to/file.py:Class`` of a class with ``fit``.

    Raises
    ------
    HysteresisError
        There is no such model, or it cannot be loaded; the message states the reason.
    """
    if ":" in spec:
        return _foreign(spec)
    if spec in SIMPLE:
        return SIMPLE[spec]()
    if spec not in names():
        raise HysteresisError(
            f"--model {spec}: must be one of {', '.join(names())}, or your own class as module:Class or "
            f"file.py:Class{did_you_mean(spec, names())}"
        )
    return PackageModel(spec)


def _foreign(spec: str):
    place, _, name = spec.rpartition(":")
    try:
        if place.endswith(".py"):
            path = pathlib.Path(place)
            found = importlib.util.spec_from_file_location(f"benchmark_{path.stem}", path)
            assert found is not None and found.loader is not None
            module = importlib.util.module_from_spec(found)
            sys.modules[found.name] = module
            found.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
        model = getattr(module, name)()
    except Exception as error:  # a user's file may raise anything
        raise HysteresisError(f"--model {spec}: cannot be loaded: {type(error).__name__}: {error}") from None
    if not callable(getattr(model, "fit", None)):
        raise HysteresisError(f"--model {spec}: has no method fit(data); see docs/benchmark.md")
    return model
