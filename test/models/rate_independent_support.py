# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One of each rate-independent hysteresis model, with the stroke of a stack, and paths for them."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.hysteresis.preisach import PreisachHysteresis, PreisachParameters, everett_of

STROKE = 12e-6
KNOTS = np.linspace(-1.0, 1.0, 9)


def bouc_wen(scale=1.0, exponent=1.0):
    size = (8e-6 * scale) ** (exponent - 1.0)
    return BoucWenParameters(
        d_e=0.16e-6 * scale, alpha=0.05e-6 * scale, beta=6e-3 / size, gamma=4e-3 / size, exponent=exponent
    )


def duhem(scale=1.0, shape="network"):
    weights = (1.5, 1.2, 0.3, -0.4, 0.5, 0.4, 0.02), (1.0, -1.0, 0.9, 0.9, 0.05, 0.05, 0.8)
    splines = tuple(0.95 * KNOTS + 0.03 * KNOTS**3), tuple(0.85 + 0.1 * KNOTS**2)
    return DuhemParameters(
        alpha=0.04,
        input_low=0.0,
        input_high=120.0,
        output_low=0.0,
        output_high=STROKE * scale,
        output_start=0.1e-6 * scale,
        shape=shape,
        f_network=weights[0],
        g_network=weights[1],
        f_spline=splines[0],
        g_spline=splines[1],
    )


def prandtl_ishlinskii(scale=1.0):
    return PrandtlIshlinskiiParameters(
        radii=tuple(6.0 * np.arange(8)),
        weights=tuple(scale * np.array([60e-9, 9e-9, 7e-9, 6e-9, 5e-9, 4e-9, 3e-9, 2e-9])),
        thresholds=tuple(scale * np.array([2e-6, 6e-6, -1e-6])),
        zone_weights=(0.1, -0.3, 0.2),
        offset=0.2e-6 * scale,
    )


def preisach(scale=1.0):
    block = PrandtlIshlinskiiHysteresis(prandtl_ishlinskii(scale), 1e-3)
    return PreisachParameters(
        voltage_low=-40.0, voltage_high=160.0, everett=tuple(everett_of(block, -40.0, 160.0, 21)), offset=-3e-6 * scale
    )


MODELS = {
    "bouc_wen": (BoucWenHysteresis, bouc_wen),
    "bouc_wen_squared": (BoucWenHysteresis, lambda scale=1.0: bouc_wen(scale, exponent=2.0)),
    "duhem_network": (DuhemHysteresis, duhem),
    "duhem_spline": (DuhemHysteresis, lambda scale=1.0: duhem(scale, "spline")),
    "prandtl_ishlinskii": (PrandtlIshlinskiiHysteresis, prandtl_ishlinskii),
    "preisach": (PreisachHysteresis, preisach),
}


def built(name, scale=1.0):
    cls, parameters = MODELS[name]
    return cls(parameters(scale), 1e-3)


def ramps(turns, points):
    turns = [0.0, *turns]
    return np.concatenate([np.linspace(a, b, points + 1)[1:] for a, b in zip(turns, turns[1:], strict=False)])


def outputs():
    rng = np.random.default_rng(5)
    wave = ramps(rng.uniform(-40.0, 160.0, 12), 9)
    return np.array([built(name).simulate(wave) for name in MODELS])
