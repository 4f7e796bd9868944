# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Response matrix from inputs that do not repeat: the local polynomial method, with the covariance of the noise.

Around each line k, the response and the transient are smooth in frequency; the spectra of inputs and noise are not.
Over the lines k + r, |r| ≤ n, the model

    Y(k + r) = Σ_s r^s G_s U(k + r) + Σ_s r^s T_s + V(k + r),  s = 0 … R,

is linear in G_s and T_s; G_0 is the response at the line. The covariance of the residual is that of the noise. Its
degrees of freedom are the lines of the window minus the unknowns [1]_. Each experiment has a transient of its own.

References
----------
.. [1] Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2012, sections 7.2.2 and 7.2.3;
   Pintelon, Schoukens, Vandersteen & Barbé, Estimation of nonparametric noise and FRF models for
   multivariable systems, part I, Mech. Syst. Signal Process. 24(3), 2010.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import DataError, finite_array
from hysteresis_ros.identification.frequency_response import (
    EXCITED,
    MOST_CONDITION,
    FrequencyResponse,
    ResponseMatrix,
)

#: Degree of the polynomials, and degrees of freedom of the covariance beyond the number of outputs.
DEGREE, FREEDOM = 2, 10
#: Number of lines whose equations are solved at once.
CHUNK = 512


def local_polynomial_response(
    u,
    y,
    sample_time: float,
    *,
    degree: int = DEGREE,
    freedom: int | None = None,
    band: tuple[float, float] | None = None,
    input_unit: str = "V",
    output_unit: str = "m",
) -> ResponseMatrix:
    """Return the response matrix from inputs that need not repeat.

    Parameters
    ----------
    u : array_like, shape (R, N, m)
        Inputs of R experiments.
    y : array_like, shape (R, N, q)
        Outputs.
    sample_time : float
        [s]
    degree : int
        Degree R of the polynomials, even.
    freedom : int, optional
        Degrees of freedom of the covariance at each line. More of them widen the window, and thus increase the error of
        the polynomials at narrow resonances. By default the number of outputs plus :data:`FREEDOM`.
    band : tuple of float, optional
        Lowest and highest frequency [Hz]; all excited lines by default.
    input_unit, output_unit : str
        SI units.

    Returns
    -------
    ResponseMatrix
        ``total`` is the covariance of noise and nonlinear distortion together in a spectrum of N samples; ``noise`` is
        None.

    Raises
    ------
    DataError, IdentificationError
        Shapes do not fit, the recording is too short, or the inputs are correlated.
    """
    inputs, outputs = finite_array("input", u), finite_array("output", y)
    if inputs.ndim != 3 or outputs.ndim != 3 or inputs.shape[:2] != outputs.shape[:2]:
        raise DataError(
            "shape", f"input {inputs.shape} and output {outputs.shape}: both must be (experiments, samples, channels)"
        )
    experiments, N, m = inputs.shape
    q = outputs.shape[2]
    if degree < 0 or degree % 2:
        raise IdentificationError(f"degree = {degree}: must be an even number ≥ 0")
    free = q + FREEDOM if freedom is None else freedom
    if free < 1:
        raise IdentificationError(f"freedom = {free}: must be ≥ 1")
    unknowns = (degree + 1) * (m + experiments)
    half = -(-(-(-(unknowns + free) // experiments) - 1) // 2)
    window = 2 * half + 1
    last = (N - 1) // 2
    if last < 2 * window:
        raise DataError(
            "short", f"{N} samples have {last} lines, but windows of {window} lines need {2 * window}: record longer"
        )
    # (lines, experiments, channels); the line of the mean is left out
    U, Y = (np.fft.rfft(one, axis=1)[:, 1 : last + 1].transpose(1, 0, 2) / N for one in (inputs, outputs))
    strength = np.abs(U).max(axis=(1, 2))
    if not strength.max() > 0.0:
        raise DataError("constant", "the inputs are constant; a frequency response needs inputs that move")
    frequency = np.arange(1, last + 1) / (N * sample_time)
    # the power is averaged over neighbours, because a single line of noise may be small by chance
    kernel = np.ones(window) / window
    power = np.convolve((np.abs(U) ** 2).sum(axis=(1, 2)), kernel, mode="same")
    chosen = power > EXCITED**2 * power.max()
    if band is not None:
        chosen &= (frequency >= band[0]) & (frequency <= band[1])
    lines = np.flatnonzero(chosen)
    if not lines.size:
        raise DataError("band", f"no excited line in {band[0]:g} … {band[1]:g} Hz" if band else "no line is excited")
    response = np.empty((lines.size, q, m), dtype=complex)
    noise = np.empty((lines.size, q, q), dtype=complex)
    spread = np.empty((lines.size, m))
    condition = np.empty(lines.size)
    for begin in range(0, lines.size, CHUNK):
        part = slice(begin, begin + CHUNK)
        some = lines[part]
        # at the ends of the band, the window extends to one side only
        first = np.clip(some - half, 0, last - window)
        places = first[:, None] + np.arange(window)
        r = (places - some[:, None]) / half
        powers = r[..., None] ** np.arange(degree + 1)
        now, then = U[places], Y[places]
        condition[part] = np.linalg.cond(now.reshape(len(some), -1, m))
        if not np.max(condition[part]) <= MOST_CONDITION:
            worst = int(np.argmax(condition[part]))
            raise IdentificationError(
                f"the excitations are correlated: condition number {condition[part][worst]:.3g} of the inputs around "
                f"{frequency[some[worst]]:.5g} Hz, at most {MOST_CONDITION:g} is allowed; excite them independently"
            )
        forced = np.einsum("fws,fwem->fwesm", powers, now).reshape(len(some), window * experiments, -1)
        own = np.einsum("fws,ed->fweds", powers, np.eye(experiments)).reshape(len(some), window * experiments, -1)
        scale = np.sqrt(np.mean(np.abs(forced) ** 2, axis=1))
        table = np.concatenate([forced / scale[:, None], own], axis=2)
        Q, triangle = np.linalg.qr(table)
        wanted = then.reshape(len(some), -1, q)
        seen = np.conj(Q).transpose(0, 2, 1) @ wanted
        solved = np.linalg.solve(triangle, seen)
        rest = wanted - Q @ seen
        freedoms = table.shape[1] - table.shape[2]
        response[part] = (solved[:, :m] / scale[:, :m, None]).transpose(0, 2, 1)
        noise[part] = rest.transpose(0, 2, 1) @ rest.conj() / freedoms
        inverse = np.linalg.inv(triangle)
        spread[part] = np.sum(np.abs(inverse[:, :m]) ** 2, axis=2) / scale[:, :m] ** 2
    variance = np.einsum("fii->fi", noise).real[:, :, None] * spread[:, None, :]
    found = FrequencyResponse(
        frequency[lines],
        response,
        sample_time,
        variance,
        None,
        None,
        input_unit,
        output_unit,
        ("the inputs are not periodic: noise and nonlinear distortion are not separated",),
        float(freedoms),
    )
    return ResponseMatrix(found, None, noise, condition)
