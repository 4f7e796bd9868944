# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the identification of Wang, Alici & Tan 2014 recovers from an element of another class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.identification.duhem import (
    PUBLISHED_ALPHA,
    DuhemIdentification,
    identify_duhem,
    identify_inverse_duhem,
)
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.papers.triangles import SAMPLE_TIME


def polymer_truth(plays: int = 40) -> PrandtlIshlinskiiParameters:
    """Return a modified Prandtl-Ishlinskii element for ±1 V (W7; assumption, the paper's numbers are lost)."""
    radii = np.arange(plays) / plays
    weights = np.exp(-1.5 * radii) / plays
    weights[0] = 0.6
    thresholds = np.concatenate([-np.linspace(0.05, 0.7, 12)[::-1], np.linspace(0.05, 0.7, 12)])
    zones = np.concatenate([np.full(12, 0.008), np.full(12, -0.013)])
    scale = 1e-3  # the tip of the polymer bends by about a millimetre
    return PrandtlIshlinskiiParameters(tuple(radii), tuple(scale * weights), tuple(scale * thresholds), tuple(zones))


@dataclass(frozen=True)
class PaperW:
    """Duhem model of a modified Prandtl-Ishlinskii element; errors in parts of the full range.

    Parameters
    ----------
    identified, published : DuhemIdentification
        With α from a decaying loop, and with the paper's α = 80.
    inverse : DuhemIdentification
        W4.
    opening : float
        Of the loop.
    compensated : float
        Largest error of the truth behind the inverse along the major loop.
    decaying, decaying_published : float
        Rms error on decaying loops that were not used: with the identified α and with the paper's.
    """

    identified: DuhemIdentification
    published: DuhemIdentification
    inverse: DuhemIdentification
    opening: float
    compensated: float
    decaying: float
    decaying_published: float


def paper_w(shape: str = "network", size: int | None = None, seed: int = 0) -> PaperW:
    """Identify the Duhem model, its inverse and α (W3, W4, W7) from sines and one decaying loop."""
    truth = polymer_truth()

    def passed(voltage):
        return PrandtlIshlinskiiHysteresis(truth, SAMPLE_TIME).simulate(voltage)

    cycle = np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)
    major = np.tile(cycle, 3)
    decaying = np.concatenate([cycle, np.tile(cycle, 6) * np.linspace(1.0, 0.02, 6000)])
    unseen = np.concatenate([cycle, np.tile(cycle, 10) * np.exp(-np.arange(10000) / 4000.0)])
    arguments = dict(minor=(decaying, passed(decaying)), shape=shape, size=size, seed=seed)
    identified = identify_duhem(major, passed(major), **arguments)
    published = identify_duhem(major, passed(major), alpha=PUBLISHED_ALPHA, **arguments)
    inverse = identify_inverse_duhem(major, passed(major), **arguments)

    y = passed(major)
    full = float(np.ptp(y))
    wanted = y[1000:]
    block = DuhemHysteresis(inverse.parameters, SAMPLE_TIME)
    drive = block.simulate(y)
    reached = passed(drive)[1000:]

    def misfit(result):
        after = slice(250, None)  # the first quarter cycle comes from rest
        error = DuhemHysteresis(result.parameters, SAMPLE_TIME).simulate(unseen) - passed(unseen)
        return float(np.sqrt(np.mean(error[after] ** 2))) / full

    return PaperW(
        identified=identified,
        published=published,
        inverse=inverse,
        opening=identified.loop.opening,
        compensated=float(np.max(np.abs(reached - wanted))) / full,
        decaying=misfit(identified),
        decaying_published=misfit(published),
    )
