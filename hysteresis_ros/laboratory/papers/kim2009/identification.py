# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The identification of Kim, Kim & Park 2009: loops (section 2.2), preload (2.3) and frequency response (2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.identification.frequency_response import FrequencyResponse, multisine_response, welch_response
from hysteresis_ros.identification.matrix_fraction import MatrixFractionFit, identify_matrix_fraction
from hysteresis_ros.identification.polynomial import (
    PolynomialIdentification,
    PreloadIdentification,
    identify_polynomial,
    identify_preload,
    preload_of_offset,
)
from hysteresis_ros.laboratory.papers.claims import Claim
from hysteresis_ros.laboratory.papers.kim2009 import axis as kim
from hysteresis_ros.laboratory.papers.runs import SAMPLE_TIME, run, triangles
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.recordings.dataset import Recording

KIM_PEAKS = np.arange(6.0, 120.5, 6.0)
STIFFNESS = 0.41e6  # of the propulsion part [N/m], stated in the paper


def stack_truth(opening: float = 0.15, stroke: float = 12.45e-6, fading: float = 1.0) -> PrandtlIshlinskiiParameters:
    """Return a Prandtl-Ishlinskii stack of 40 play operators for 0 … 120 V (assumed; not the class that is fitted).

    Units: ``stroke`` [m].
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
    """Polynomial model of a noisy Prandtl-Ishlinskii stack, and its errors on a held-out decreasing triangle."""

    model: PolynomialIdentification
    #: stroke, maximum, rms: Range of the decreasing triangle, and the model's largest and rms error on it [m]; the
    #: paper's largest error is 0.125 µm.
    stroke: float
    maximum: float
    rms: float
    preload_curve: PreloadIdentification  #: W(L0) from noisy points 0 … 6 N.
    preload: float  #: Preload [N] identified from the displacement that a preload of 5.88 N causes.
    #: voltage, truth, predicted: shape (N,); The decreasing triangle [V], and the displacements of the stack and of the
    #: model [m], at ``SAMPLE_TIME``.
    voltage: np.ndarray
    truth: np.ndarray
    predicted: np.ndarray


def paper_k(noise: float = 5e-9, seed: int = 0, **truth) -> PaperK:
    """Identify the polynomial model (K2) and the preload curve (K3) from simulated recordings."""
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
    """Identify the stack's structure from a noisy recording by the paper's method (K4)."""
    values = load_configuration("kim2009").node("plant_simulator")
    rate = values["sample_rate"]
    structure: dict[str, Any] = {name: tuple(values[f"dynamics.{name}"]) for name in "ABC"}
    random = np.random.default_rng(seed)
    u = random.standard_normal(samples)
    y = LinearDynamics(LinearParameters(**structure, output_scale=1e-6), 1.0 / rate).simulate(u)
    y += noise * y.std() * random.standard_normal(samples)
    # a block returns the response at the end of a sample, so u[k] already affects y[k]
    response = welch_response(u[1:], y[:-1], 1.0 / rate, segment=8192).band(135.0, 1135.0)
    fit = identify_matrix_fraction(response)
    mode = fit.model.modes[0]
    return fit.suggested_order, mode.frequency, mode.damping


# Printed values of the paper, in SI units.
MODEL_ERROR = 0.125e-6  # m
ORDER = 3
BAND = (135, 1135)  # Hz: 1 kHz around the resonance

# Assumed here.
EXCITATION = 0.1e-6  # m, peak of the multisine
WORKING_POINT = 4.0e-6  # m
PERIODS = 8  # periods of a run, each 1 s long
SETTLING = 2  # first periods, which are not evaluated because vibrations decay in them

LOOPS = (
    "truth for K2: Prandtl-Ishlinskii stack of 40 plays, not the fitted polynomial; loop width 15 % of 12.45 µm; "
    "noise 5 nm rms"
)
DECREASING = "decreasing triangle of 20 cycles from 117 V, not used for the fit"
MEASURED = (
    "multisine of 1001 lines from 135 to 1135 Hz, 0.1 µm peak around 4 µm, 6 evaluated periods of 1 s, through the "
    "hysteresis, with noise 5 nm rms and 16-bit converters"
)
GROUP = "Identification (sections 2.2 to 2.4)"


def run_excitation(configuration: Configuration) -> Recording:
    """Return the open-loop run of a multisine on the whole plant, without compensation."""
    plant = kim.open_loop(kim.uncompensated(kim.real(configuration, 0.0)))
    values = dict(waveform__type="multisine", waveform__frequency=1.0, waveform__amplitude=EXCITATION)
    values |= dict(waveform__multisine__first_harmonic=BAND[0], waveform__multisine__last_harmonic=BAND[1])
    excited = plant.override("reference_generator", waveform__offset=WORKING_POINT, **values)
    return run(excited, float(PERIODS))


def structure(excited: Recording) -> tuple[FrequencyResponse, MatrixFractionFit]:
    """Return the frequency response of a run of :func:`run_excitation`, and its fit (K4)."""
    period = round(1.0 / excited.sample_time)
    u, y = (excited[name][SETTLING * period :] for name in ("command", "measured"))
    units = dict(input_unit="m", output_unit="m")
    response = multisine_response(u, y, excited.sample_time, period=period, **units).band(BAND[0] - 0.5, BAND[1] + 0.5)
    return response, identify_matrix_fraction(response)


def prediction(case: PaperK) -> Recording:
    """Return the decreasing triangle as a run, with the stack's displacement and the model's (``estimated``)."""
    time = SAMPLE_TIME * np.arange(case.voltage.size)
    return Recording(time, {"voltage": case.voltage, "displacement": case.truth, "estimated": case.predicted})


def identification_claims(case: PaperK, excited: Recording) -> list[Claim]:
    """Return the rows of loops, preload and frequency response."""
    return [*_static_claims(case), *_dynamic_claims(excited)]


def _static_claims(case: PaperK) -> list[Claim]:
    """Return the rows of loops and preload."""
    return [
        Claim(
            "identification.model_error",
            GROUP,
            "polynomial model from 20 loops, decreasing triangle: largest error",
            case.maximum,
            "m",
            paper=MODEL_ERROR,
            high=MODEL_ERROR,
            assumptions=(LOOPS, DECREASING),
        ),
        Claim(
            "identification.stiffness",
            GROUP,
            "stiffness from 25 preloads of 0 … 6 N",
            case.preload_curve.stiffness,
            "N/m",
            paper=kim.STIFFNESS,
            low=0.999 * kim.STIFFNESS,
            high=1.001 * kim.STIFFNESS,
            assumptions=(kim.COMPLIANCE, LOOPS),
        ),
        Claim(
            "identification.preload",
            GROUP,
            "preload from the shift of a loop of 20 V",
            case.preload,
            "N",
            paper=kim.PRELOAD,
            low=0.999 * kim.PRELOAD,
            high=1.001 * kim.PRELOAD,
            assumptions=(kim.COMPLIANCE, LOOPS),
        ),
    ]


def _dynamic_claims(excited: Recording) -> list[Claim]:
    """Return the rows of the frequency response."""
    _, fit = structure(excited)
    return [
        Claim(
            "identification.order",
            GROUP,
            "order of the fit to the frequency response",
            float(fit.suggested_order),
            "1",
            paper=float(ORDER),
            low=ORDER,
            high=ORDER,
            assumptions=(kim.MODEL, kim.STACK, MEASURED),
        ),
        Claim(
            "identification.resonance",
            GROUP,
            "resonance of the fit",
            fit.model.modes[0].frequency,
            "Hz",
            paper=kim.RESONANCE,
            low=0.998 * kim.RESONANCE,
            high=1.002 * kim.RESONANCE,
            assumptions=(kim.MODEL, kim.STACK, MEASURED),
        ),
    ]
