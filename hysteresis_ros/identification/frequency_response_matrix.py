# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Frequency response matrix of several inputs and outputs, from several experiments with periods.

Experiments are arrays of shape (R, P N, channels): R realisations of P periods of N samples, in steady state. Each line
needs as many independent experiments as there are inputs: orthogonal multisines (realisations in groups of m, whose
phases differ by an orthogonal matrix), or R ≥ m random phases for each input. The best linear approximation is the
least-squares solution of Y = G U at each line [1]_.

Noise and nonlinear distortion are told apart: what differs between the periods of a realisation is noise, what differs
between realisations is both. Both are kept as covariances of the outputs, because what disturbs one sensor disturbs
its neighbours too.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, sections 2.7 and 4.3 (several
   inputs, best linear approximation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import DataError, finite_array
from hysteresis_ros.identification.frequency_response import FrequencyResponse, multisine_response

#: Condition number of the inputs' spectra at a line above which they count as correlated: noise in the direction that
#: is excited least is multiplied by it.
MOST_CONDITION = 1e3


@dataclass(frozen=True, eq=False)
class ResponseMatrix:
    """The response from all inputs to all outputs at the excited lines, with what scatters around it."""

    response: FrequencyResponse  #: Response, shape (F, q, m), with the variances of its entries.
    #: shape (F, q, q), complex; covariance of the noise in the output spectrum of a realisation, averaged over its
    #: periods [m²]; None with one period.
    noise: np.ndarray | None
    #: shape (F, q, q), complex; the same of noise and nonlinear distortion together; None with m realisations.
    total: np.ndarray | None
    condition: np.ndarray  #: shape (F,); Condition number of the inputs' spectra over the realisations.

    def level(self, covariance) -> np.ndarray:
        """Return the RMS value [m] in the outputs, shape (q,), of a covariance over the lines."""
        return np.sqrt(2.0 * np.einsum("fii->i", covariance).real)


def experiments_of(name: str, values, period: int) -> np.ndarray:
    """Return signals of shape (R, P N, channels) as periods, shape (R, P, channels, N)."""
    array = finite_array(name, values)
    if array.ndim != 3:
        raise DataError("shape", f"{name} has shape {array.shape}; it must be (realisations, samples, channels)")
    if period < 16 or array.shape[1] % period or not array.size:
        raise DataError(
            "shape",
            f"{name} has {array.shape[1]} samples, no whole number of periods of {period} (at least 16) samples; leave "
            "the start out, not the end of a period",
        )
    realisations, samples, channels = array.shape
    return array.reshape(realisations, samples // period, period, channels).transpose(0, 1, 3, 2)


def response_matrix(u, y, sample_time: float, period: int, input_unit: str = "V", output_unit: str = "m"):
    """Return the frequency response matrix (:class:`ResponseMatrix`) from experiments.

    Shapes: ``u`` (R, P N, m), ``y`` (R, P N, q) with N = ``period``. Units: ``sample_time`` [s].
    """
    inputs, outputs = experiments_of("input", u, period), experiments_of("output", y, period)
    if inputs.shape[:2] != outputs.shape[:2]:
        raise DataError("shape", f"input {np.shape(u)} and output {np.shape(y)} differ in realisations or samples")
    realisations, periods, m, N = inputs.shape
    if realisations < m:
        raise DataError("short", f"{realisations} experiments cannot separate {m} inputs; at least {m} are needed")
    _require_independent(inputs, sample_time)
    found = multisine_response(inputs, outputs, sample_time, input_unit=input_unit, output_unit=output_unit)
    lines = np.rint(found.frequency * N * sample_time).astype(int)
    U, Y = (np.fft.rfft(part, axis=3)[..., lines] / N for part in (inputs, outputs))
    mean_u, mean_y = (part.mean(axis=1).transpose(2, 1, 0) for part in (U, Y))
    noise = total = None
    if periods > 1:
        rest = (Y - Y.mean(axis=1, keepdims=True)) - np.einsum(
            "fij,rpjf->rpif", found.response, U - U.mean(axis=1, keepdims=True)
        )
        noise = np.einsum("rpif,rpjf->fij", rest, rest.conj()) / (realisations * (periods - 1) * periods)
    if realisations > m:
        rest = mean_y - found.response @ mean_u
        total = rest @ rest.conj().transpose(0, 2, 1) / (realisations - m)
    return ResponseMatrix(found, noise, total, np.linalg.cond(mean_u))


def _require_independent(inputs, sample_time: float) -> None:
    """Refuse inputs whose spectra are nearly dependent at a line that is excited."""
    N = inputs.shape[3]
    U = np.fft.rfft(inputs.mean(axis=1), axis=2)[..., 1 : (N + 1) // 2].transpose(2, 1, 0) / N
    strength = np.abs(U).max(axis=(1, 2))
    if not strength.max() > 0.0:
        raise DataError("constant", "the inputs are constant; a frequency response needs inputs that move")
    # the same lines as those of the response: others hold rounding only
    excited = strength > 1e-3 * strength.max()
    condition = np.linalg.cond(U[excited])
    worst = int(np.argmax(condition))
    if not condition[worst] <= MOST_CONDITION:
        line = (np.flatnonzero(excited)[worst] + 1) / (N * sample_time)
        raise IdentificationError(
            f"the excitations are correlated: condition number {condition[worst]:.3g} of the inputs at {line:.5g} Hz, "
            f"at most {MOST_CONDITION:g} is allowed; excite with orthogonal multisines, or with other random phases "
            "at each input and in each realisation"
        )
