# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the identification of Kim, Kim & Park 2009 recovers from a simulated stack of another class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.identification.frequency_response import welch_response
from hysteresis_ros.identification.matrix_fraction import identify_matrix_fraction
from hysteresis_ros.identification.polynomial import PolynomialIdentification, identify_polynomial
from hysteresis_ros.identification.preload import PreloadIdentification, identify_preload, preload_of_offset
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.papers.triangles import SAMPLE_TIME, triangles

KIM_PEAKS = np.arange(6.0, 120.5, 6.0)
STIFFNESS = 0.41e6  # of the propulsion part [N/m], stated in the paper


def stack_truth(opening: float = 0.15, stroke: float = 12.45e-6, fading: float = 1.0) -> PrandtlIshlinskiiParameters:
    """Return a Prandtl-Ishlinskii stack of 40 plays for 0 … 120 V (assumption; not the class that is fitted).

    Parameters
    ----------
    opening : float
        Opening of the loop to 120 V, as a part of the stroke.
    stroke : float
        Displacement at 120 V [m].
    fading : float
        The density of plays falls as exp(-fading r/120 V); 0 would be Rayleigh's law, which polynomials hit exactly.
    """
    radii = 3.0 * np.arange(40)
    weights = np.exp(-fading * radii / 120.0)
    loop = triangles([120.0, 120.0], 400)

    def stack(elastic):
        weights[0] = elastic
        scaled = PrandtlIshlinskiiParameters(tuple(radii), tuple(weights))
        x = PrandtlIshlinskiiHysteresis(scaled, SAMPLE_TIME).simulate(loop)
        return np.max(x[400:801][::-1] - x[800:1201]) / x.max(), x.max()

    low, high = 1e-3, 1e3
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stack(middle)[0] > opening else (low, middle)
    _, reached = stack(low)
    return PrandtlIshlinskiiParameters(tuple(radii), tuple(weights * (stroke / reached)))


@dataclass(frozen=True)
class PaperK:
    """Polynomial model of a Prandtl-Ishlinskii stack with noise; errors on a decreasing triangle it has not seen.

    Parameters
    ----------
    model : PolynomialIdentification
    stroke, maximum, rms : float
        Of the decreasing triangle: its range, largest and rms error [m]; the paper's largest error is 0.125 µm.
    preload_curve : PreloadIdentification
        W(L0) from noisy points 0 … 6 N.
    preload : float
        What a recording under 5.88 N gives [N].
    voltage, truth, predicted : ndarray, shape (N,)
        The decreasing triangle [V], the stack's displacement and the model's [m], at ``SAMPLE_TIME``.
    """

    model: PolynomialIdentification
    stroke: float
    maximum: float
    rms: float
    preload_curve: PreloadIdentification
    preload: float
    voltage: np.ndarray
    truth: np.ndarray
    predicted: np.ndarray


def paper_k(noise: float = 5e-9, seed: int = 0, **truth) -> PaperK:
    """Identify the polynomial model (K2) and the preload curve (K3) from simulated recordings.

    Parameters
    ----------
    noise : float
        Of the displacement [m rms].
    seed : int
        Of the noise.
    **truth
        Handed to :func:`stack_truth`.
    """
    random = np.random.default_rng(seed)
    stack = stack_truth(**truth)

    def measured(voltage, offset=0.0):
        x = PrandtlIshlinskiiHysteresis(stack, SAMPLE_TIME).simulate(voltage) + offset
        return x + noise * random.standard_normal(x.size)

    voltage = triangles(KIM_PEAKS)
    model = identify_polynomial(voltage, measured(voltage))
    decreasing = triangles(117.0 * np.linspace(1.0, 0.05, 20))
    truth_there = PrandtlIshlinskiiHysteresis(stack, SAMPLE_TIME).simulate(decreasing)
    predicted = PolynomialHysteresis(model.parameters, SAMPLE_TIME).simulate(decreasing)
    error = predicted - truth_there

    forces = np.linspace(0.0, 6.0, 25)
    points = -forces / STIFFNESS + noise * random.standard_normal(forces.size)
    curve = identify_preload(forces, points, in_use=5.88)
    loop = triangles([20.0, 20.0])
    offset = float(np.mean(measured(loop, -5.88 / STIFFNESS) - measured(loop)))
    preload = preload_of_offset(curve.parameters, offset)
    return PaperK(
        model=model,
        stroke=float(np.ptp(truth_there)),
        maximum=float(np.max(np.abs(error))),
        rms=float(np.sqrt(np.mean(error**2))),
        preload_curve=curve,
        preload=preload,
        voltage=decreasing,
        truth=truth_there,
        predicted=predicted,
    )


def paper_k_dynamics(noise: float = 0.02, samples: int = 60000, seed: int = 0) -> tuple[int, float, float]:
    """Identify the stack's structure from a noisy recording by the paper's method (K4).

    Parameters
    ----------
    noise : float
        Standard deviation of the sensor's noise, as a part of the signal's.
    samples : int
        Length of the recording at 3 kHz; the input is white.
    seed : int
        Of input and noise.

    Returns
    -------
    order : int
        As suggested.
    frequency : float
        Of the first pole pair [Hz].
    damping : float
        Of the first pole pair.
    """
    values = load_configuration("kim2009").node("plant_simulator")
    rate = values["sample_rate"]
    structure = {name: tuple(values[f"dynamics.{name}"]) for name in "ABC"}
    random = np.random.default_rng(seed)
    u = random.standard_normal(samples)
    y = LinearDynamics(LinearParameters(**structure, output_scale=1e-6), 1.0 / rate).simulate(u)
    y += noise * y.std() * random.standard_normal(samples)
    # a block answers at the end of its sample: u[k] shows in y[k] and not in the sample after
    response = welch_response(u[1:], y[:-1], 1.0 / rate, segment=8192).band(135.0, 1135.0)
    fit = identify_matrix_fraction(response)
    mode = fit.model.modes[0]
    return fit.suggested_order, mode.frequency, mode.damping
