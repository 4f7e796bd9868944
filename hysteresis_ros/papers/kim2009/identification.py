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

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.identification.frequency_response import FrequencyResponse, multisine_response
from hysteresis_ros.identification.matrix_fraction import MatrixFractionFit, identify_matrix_fraction
from hysteresis_ros.papers.claims import Claim
from hysteresis_ros.papers.kim2009 import axis as kim
from hysteresis_ros.papers.kim2009.recovery import PaperK
from hysteresis_ros.papers.runner import run
from hysteresis_ros.papers.triangles import SAMPLE_TIME
from hysteresis_ros.recordings.dataset import Recording

# What the paper prints, SI units.
MODEL_ERROR = 0.125e-6  # m
ORDER = 3
BAND = (135, 1135)  # Hz: 1 kHz around the resonance

# Assumed here.
EXCITATION = 0.1e-6  # m, peak of the multisine
WORKING_POINT = 4.0e-6  # m
PERIODS, SETTLING = 8, 2  # of 1 s; those left out until the vibration of the start is gone

LOOPS = (
    "truth for K2: Prandtl-Ishlinskii stack of 40 plays, opening 15 % of 12.45 µm; not the polynomial that is fitted; "
    "noise 5 nm rms"
)
DECREASING = "decreasing triangle of 20 cycles from 117 V; the model has not seen it"
MEASURED = (
    "multisine of 1001 lines from 135 to 1135 Hz, 0.1 µm peak around 4 µm, 6 periods of 1 s, through the hysteresis, "
    "with noise 5 nm rms and 16-bit converters"
)
GROUP = "Identification (sections 2.2 to 2.4)"


def run_excitation(configuration: Configuration) -> Recording:
    """Return the open-loop run of a multisine through the whole plant, uncompensated."""
    plant = kim.open_loop(kim.uncompensated(kim.real(configuration, 0.0)))
    values = dict(waveform__type="multisine", waveform__frequency=1.0, waveform__amplitude=EXCITATION)
    values |= dict(waveform__multisine__first_harmonic=BAND[0], waveform__multisine__last_harmonic=BAND[1])
    excited = plant.override("reference_generator", waveform__offset=WORKING_POINT, **values)
    return run(excited, float(PERIODS))


def structure(excited: Recording) -> tuple[FrequencyResponse, MatrixFractionFit]:
    """Return the frequency response of a run of :func:`run_excitation` and what is fitted to it (K4)."""
    period = round(1.0 / excited.sample_time)
    u, y = (excited[name][SETTLING * period :] for name in ("command", "measured"))
    units = dict(input_unit="m", output_unit="m")
    response = multisine_response(u, y, excited.sample_time, period=period, **units).band(BAND[0] - 0.5, BAND[1] + 0.5)
    return response, identify_matrix_fraction(response)


def prediction(case: PaperK) -> Recording:
    """Return the decreasing triangle as a run: the stack's displacement and, as ``estimated``, the model's."""
    time = SAMPLE_TIME * np.arange(case.voltage.size)
    return Recording(time, {"voltage": case.voltage, "displacement": case.truth, "estimated": case.predicted})


def identification_claims(case: PaperK, excited: Recording) -> list[Claim]:
    """Return the rows of loops, preload and frequency response.

    Parameters
    ----------
    case : PaperK
        Loops and preload, identified.
    excited : Recording
        A run of :func:`run_excitation`.
    """
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
