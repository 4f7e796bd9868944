# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Polynomial branch hysteresis (Kim, Kim & Park 2009): declaration; the law is in :mod:`.law`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros.models.declaration import Deviation, HysteresisModel, Option, times
from hysteresis_ros.models.hysteresis.polynomial.law import PolynomialHysteresis
from hysteresis_ros.models.hysteresis.polynomial.parameters import PolynomialParameters, assumed_stack

__all__ = ["MODEL", "PolynomialHysteresis", "PolynomialParameters", "assumed_stack"]


def _scaled(parameters: PolynomialParameters, factor: float) -> PolynomialParameters:
    return times(parameters, factor, "scale")


def _shifted(parameters: PolynomialParameters, offset: float) -> PolynomialParameters:
    constant = offset / parameters.scale
    curves = {name: getattr(parameters, name) for name in ("virgin", "rising_D", "falling_D")}
    moved: dict[str, Any] = {name: (curve[0] + constant, *curve[1:]) for name, curve in curves.items()}
    return replace(parameters, **moved)


def _deviated(parameters: PolynomialParameters, deviation: Deviation) -> PolynomialParameters:
    """Scale all coefficients by the gain and the difference of the branches by the opening; the corners stay joined."""
    changed: dict = {}
    for name in ("C1", "C2"):
        rising, falling = (np.array(getattr(parameters, f"{branch}_{name}")) for branch in ("rising", "falling"))
        middle, half = 0.5 * (rising + falling), 0.5 * (rising - falling)
        changed[f"rising_{name}"] = tuple((middle + deviation.opening * half).tolist())
        changed[f"falling_{name}"] = tuple((middle - deviation.opening * half).tolist())
    return replace(parameters, scale=parameters.scale * deviation.gain, **changed)


MODEL = HysteresisModel(
    name="polynomial",
    title="branch polynomials with coefficients that are quadratics of the peak voltage (Kim et al. 2009)",
    data="loops from about 0 V to positive peaks; three or more peaks that grow, e.g. triangles to 6, 12 … 120 V",
    parameters=PolynomialParameters,
    block=PolynomialHysteresis,
    example=assumed_stack(),
    scaled=_scaled,
    shifted=_shifted,
    deviated=_deviated,
    inverses=("exact", "general", "picard_steps", "none"),
    identify="hysteresis_ros.identification.static_procedures:polynomial",
    options={
        "method": Option(str, "fit to all samples, or through the coefficients of each loop", ("samples", "loops")),
        "criterion": Option(str, "what is made small", ("automatic", "rms", "maximum")),
    },
)
