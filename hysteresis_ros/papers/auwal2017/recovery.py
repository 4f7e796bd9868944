# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the identification of Auwal et al. 2017 recovers: Bouc-Wen parameters, and the reduced transfer function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.identification.bouc_wen_static import (
    NAMES,
    PUBLISHED_GUESS,
    BoucWenIdentification,
    identify_bouc_wen_static,
)
from hysteresis_ros.identification.reduction import dominant_second_order, mass_spring_damper
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.papers.triangles import SAMPLE_TIME, triangles

PUBLISHED_BOUC_WEN = BoucWenParameters(d_e=0.206e-6, alpha=8.09e-8, beta=3.80e-3, gamma=-5.40e-3)
#: Numerator and denominator of G4 (B2), and the m, b, K that the paper reads off G2.
PUBLISHED_G4 = ((3400.0, 62060.0), (1.0, 572.5, 10120.0, 61670.0, 539200.0))
PUBLISHED_MASS_SPRING_DAMPER = {"m": 0.1348, "b": 0.4313, "K": 8.6957}


@dataclass(frozen=True)
class PaperB:
    """Bouc-Wen parameters from 400 noisy samples.

    Parameters
    ----------
    model : BoucWenIdentification
    errors : dict
        Relative error of each parameter.
    iterations : int
        Of the simplex (the paper's: 262).
    """

    model: BoucWenIdentification
    errors: dict[str, float]
    iterations: int


def paper_b(noise: float = 10e-9, seed: int = 0, peak: float = 150.0) -> PaperB:
    """Identify Bouc-Wen's parameters (B3) from one loading and unloading, from the paper's initial guess."""
    voltage = triangles([peak], 200)[1:]
    x = BoucWenHysteresis(PUBLISHED_BOUC_WEN, SAMPLE_TIME).simulate(voltage)
    x = x + noise * np.random.default_rng(seed).standard_normal(x.size)
    model = identify_bouc_wen_static(voltage, x, guess=PUBLISHED_GUESS)
    errors = {n: getattr(model.parameters, n) / getattr(PUBLISHED_BOUC_WEN, n) - 1.0 for n in NAMES}
    return PaperB(model, errors, model.search.runs[model.search.best].iterations)


def paper_b_reduction() -> dict[str, float]:
    """Return by how much m, b and K of the reduced G4 differ from the paper's (B2), as parts of the paper's."""
    reduced = dominant_second_order(*PUBLISHED_G4)
    found = mass_spring_damper(reduced.numerator, reduced.denominator)
    values = {"m": found.mass, "b": found.damping, "K": found.stiffness}
    return {name: value / PUBLISHED_MASS_SPRING_DAMPER[name] - 1.0 for name, value in values.items()}
