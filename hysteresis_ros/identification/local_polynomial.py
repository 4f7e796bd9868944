# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Response matrix and noise covariance from inputs that do not repeat, by the local polynomial method.

Around each line k, the response and the transient are smooth in frequency; the spectra of inputs and noise are not.
Over the lines k + r, |r| ≤ n, the model

    Y(k + r) = Σ_s r^s G_s U(k + r) + Σ_s r^s T_s + V(k + r),  s = 0 … R,

is linear in G_s and T_s; G_0 is the response at line k. The covariance of the residual estimates the covariance of the
noise; its degrees of freedom are the number of equations (lines in the window times experiments) minus the number of
unknowns [1]_. Each experiment has its own transient.

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

#: Default degree of the polynomials.
DEGREE = 2
#: By default, the degrees of freedom of the covariance exceed the number of outputs by this number.
FREEDOM = 10
#: Number of frequency lines whose equations are solved together.
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
    u : array_like, shape (E, N, m)
        Inputs of E experiments.
    y : array_like, shape (E, N, q)
        Outputs.
    sample_time : float
        [s]
    degree : int
        Even degree of the polynomials, R in the equation above.
    freedom : int, optional
        Degrees of freedom of the covariance at each line. More degrees of freedom widen the window, and thus increase
        the error of the polynomials at narrow resonances. By default the number of outputs plus :data:`FREEDOM`.
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
    N, q = outputs.shape[1:]
    half = _half_width(inputs.shape, degree, q, q + FREEDOM if freedom is None else freedom)
    last = (N - 1) // 2
    # (lines, experiments, channels); the line of the mean is left out
    U, Y = (np.fft.rfft(one, axis=1)[:, 1 : last + 1].transpose(1, 0, 2) / N for one in (inputs, outputs))
    frequency = np.arange(1, last + 1) / (N * sample_time)
    lines = _excited(U, frequency, 2 * half + 1, band)
    blocks = [
        _fit_lines(U, Y, lines[begin : begin + CHUNK], half, degree, frequency) for begin in range(0, lines.size, CHUNK)
    ]
    response, noise, spread, condition = (
        np.concatenate(one) for one in zip(*(found for found, _ in blocks), strict=True)
    )
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
        float(blocks[0][1]),
    )
    return ResponseMatrix(found, None, noise, condition)


def _half_width(shape: tuple[int, int, int], degree: int, q: int, free: int) -> int:
    """Return the number of lines on each side of the window that leaves ``free`` degrees of freedom."""
    experiments, N, m = shape
    if degree < 0 or degree % 2:
        raise IdentificationError(f"degree = {degree}: must be an even number ≥ 0")
    if free < 1:
        raise IdentificationError(f"freedom = {free}: must be ≥ 1")
    unknowns = (degree + 1) * (m + experiments)
    half = -(-(-(-(unknowns + free) // experiments) - 1) // 2)
    window, last = 2 * half + 1, (N - 1) // 2
    if last < 2 * window:
        raise DataError(
            "short", f"{N} samples have {last} lines, but windows of {window} lines need {2 * window}: record longer"
        )
    return half


def _excited(U: np.ndarray, frequency: np.ndarray, window: int, band) -> np.ndarray:
    """Return the indices of the excited lines in a band."""
    if not np.abs(U).max() > 0.0:
        raise DataError("constant", "the inputs are constant; a frequency response needs inputs that move")
    # the power is averaged over neighbouring lines, because the power of noise at a single line may be small by chance
    kernel = np.ones(window) / window
    power = np.convolve((np.abs(U) ** 2).sum(axis=(1, 2)), kernel, mode="same")
    chosen = power > EXCITED**2 * power.max()
    if band is not None:
        chosen &= (frequency >= band[0]) & (frequency <= band[1])
    lines = np.flatnonzero(chosen)
    if not lines.size:
        raise DataError("band", f"no excited line in {band[0]:g} … {band[1]:g} Hz" if band else "no line is excited")
    return lines


def _fit_lines(U, Y, lines: np.ndarray, half: int, degree: int, frequency: np.ndarray):
    """Fit the polynomials around the given lines.

    Return response, covariance of the output, variances of the response for unit covariance, condition numbers (each
    with one row per line), and the degrees of freedom.
    """
    experiments, m, q, window = U.shape[1], U.shape[2], Y.shape[2], 2 * half + 1
    # near the ends of the band, the window is not centred on the line
    first = np.clip(lines - half, 0, len(U) - window)
    places = first[:, None] + np.arange(window)
    r = (places - lines[:, None]) / half
    powers = r[..., None] ** np.arange(degree + 1)
    now, then = U[places], Y[places]
    condition = np.linalg.cond(now.reshape(len(lines), -1, m))
    if not np.max(condition) <= MOST_CONDITION:
        worst = int(np.argmax(condition))
        raise IdentificationError(
            f"the excitations are correlated: condition number {condition[worst]:.3g} of the inputs around "
            f"{frequency[lines[worst]]:.5g} Hz, at most {MOST_CONDITION:g} is allowed; excite them independently"
        )
    forced = np.einsum("fws,fwem->fwesm", powers, now).reshape(len(lines), window * experiments, -1)
    own = np.einsum("fws,ed->fweds", powers, np.eye(experiments)).reshape(len(lines), window * experiments, -1)
    scale = np.sqrt(np.mean(np.abs(forced) ** 2, axis=1))
    table = np.concatenate([forced / scale[:, None], own], axis=2)
    Q, triangle = np.linalg.qr(table)
    wanted = then.reshape(len(lines), -1, q)
    seen = np.conj(Q).transpose(0, 2, 1) @ wanted
    solved = np.linalg.solve(triangle, seen)
    rest = wanted - Q @ seen
    freedoms = table.shape[1] - table.shape[2]
    response = (solved[:, :m] / scale[:, :m, None]).transpose(0, 2, 1)
    noise = rest.transpose(0, 2, 1) @ rest.conj() / freedoms
    spread = np.sum(np.abs(np.linalg.inv(triangle)[:, :m]) ** 2, axis=2) / scale[:, :m] ** 2
    return (response, noise, spread, condition), freedoms
