# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The displacement of an actuator between its samples, while the voltage is held."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from hysteresis_ros.models.actuator import Actuator
from hysteresis_ros.models.creep import OUTPUT
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

#: Number of evaluated points per sample.
INSTANTS = 10
#: Largest condition number of the eigenvectors; a larger one means a double pole, for which modal coordinates do not
#: exist.
WORST_CONDITION = 1e10
#: Times of the points, as fractions of a sample.
PLACES = np.arange(1, INSTANTS + 1) / INSTANTS


def displacement_between(actuator: Actuator, voltage) -> np.ndarray:
    """Return the displacement [m] of an actuator without the preload offset, shape (N, INSTANTS).

    The linear dynamics continue while their input is held; at the samples, the result equals the loop's displacement.

    Units: ``voltage`` [V].
    """
    rest = float(actuator.creep.x[OUTPUT])
    crept = actuator.creep.simulate(actuator.hysteresis.simulate(voltage))
    return between_samples(actuator.parameters.dynamics, actuator.dynamics.sample_time, rest, crept)


def between_samples(parameters: LinearParameters, sample_time: float, rest: float, held) -> np.ndarray:
    """Return the output [m] of linear dynamics between their samples, shape (N, INSTANTS).

    If the dynamics have no continuous equivalent (poles at zero or on the negative real axis), the output is
    interpolated linearly.

    Units: ``sample_time`` [s].
    """
    matrices: dict[str, Any] = {name: tuple(map(float, getattr(parameters, name))) for name in "ABCD"}
    modes = modes_of(replace(parameters, **matrices))
    if modes is None:
        dynamics = LinearDynamics(parameters, sample_time)
        dynamics.settle(rest)
        begin, ends = dynamics.output(), dynamics.simulate(held)
        starts = np.concatenate([[begin], ends[:-1]])
        return starts[:, np.newaxis] + (ends - starts)[:, np.newaxis] * PLACES
    # with a fractional delay, two held inputs act within a sample
    whole, part = parameters.delayed_samples
    acting = np.concatenate([np.full(whole + 1, rest), held])
    acting = (1.0 - part) * acting[1 : 1 + len(held)] + part * acting[: len(held)]
    states = np.empty((len(held), 2 * len(modes.poles)))
    for i, (pole, unit) in enumerate(zip(modes.poles, modes.units, strict=True)):
        first, driven = unit * rest, (1.0 - pole) * unit * acting
        after = scipy.signal.lfilter([1.0], [1.0, -pole], driven, zi=[pole * first])[0]
        states[0, 2 * i : 2 * i + 2] = first.real, first.imag
        states[1:, 2 * i], states[1:, 2 * i + 1] = after.real[:-1], after.imag[:-1]
    found = states @ modes.free
    found += acting[:, np.newaxis] * modes.forced
    return found


class Modes(NamedTuple):
    """Linear dynamics in modal coordinates, with one pole of each conjugate pair."""

    poles: np.ndarray  #: poles, units: shape (M,); Poles, and steady states for an input of one metre.
    units: np.ndarray
    #: shape (2 M, INSTANTS); Output [m] between the samples for the real and the imaginary part of each state.
    free: np.ndarray
    forced: np.ndarray  #: shape (INSTANTS,); Output [m] for an input of one metre held since the sample.


@functools.lru_cache(maxsize=8)
def modes_of(parameters: LinearParameters) -> Modes | None:
    """Return the modal form of linear dynamics; None if they have no continuous equivalent.

    In modal coordinates, x(k + j) = A^j x(k) + (I - A^j) x_rest u for fractions j of a sample.
    """
    model = parameters.matrices
    # poles of the real matrix: pairs are exactly conjugate, and real poles are real
    poles, vectors = (found.astype(complex) for found in np.linalg.eig(model.A))
    continuous = np.all((poles.imag != 0.0) | (poles.real > 0.0))
    if not continuous or model.order and np.linalg.cond(vectors) >= WORST_CONDITION:
        return None
    units = np.linalg.solve(vectors, np.linalg.solve(np.eye(model.order) - model.A, model.B[:, 0]))
    units = units / parameters.resolved_input_scale
    decay, out = poles[:, np.newaxis] ** PLACES, (model.C[0] @ vectors)[:, np.newaxis] * parameters.output_scale
    through = model.D.item() * parameters.output_scale / parameters.resolved_input_scale
    forced = np.real(np.sum(out * (1.0 - decay) * units[:, np.newaxis], axis=0)) + through
    # one pole of each pair suffices: the other pole contributes the conjugate
    kept = poles.imag >= 0.0
    free = (out * decay * np.where(poles.imag > 0.0, 2.0, 1.0)[:, np.newaxis])[kept]
    rows = np.stack([free.real, -free.imag], axis=1).reshape(2 * len(free), INSTANTS)
    return Modes(poles[kept], units[kept], rows, forced)
