# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification of the preload curve W(L0) from displacement against preload (Kim, Kim & Park 2009; K3, eqs 3-5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.branches import checked_signals
from hysteresis_ros.models.preload import PreloadParameters

#: Fewest points of the curve.
FEWEST_POINTS = 4


@dataclass(frozen=True)
class PreloadIdentification:
    """Result of :func:`identify_preload`.

    Parameters
    ----------
    parameters : PreloadParameters
        A1, B1 and B2, with the preload in use as ``force``.
    covariance : ndarray, shape (3, 3)
        Of A1, B1 and B2.
    rms : float
        Residual [m].
    stiffness : float
        -1/(B1 + B2 L0 of mid-range) [N/m], at the middle of the recorded preloads.
    largest_force : float
        Largest preload of the data [N].
    warnings : tuple of str
        What to doubt.
    """

    parameters: PreloadParameters
    covariance: np.ndarray
    rms: float
    stiffness: float
    largest_force: float
    warnings: tuple[str, ...]


def identify_preload(force, displacement, *, in_use: float = 0.0) -> PreloadIdentification:
    """Fit W = A1 + B1 L0 + B2 L0² to displacement against preload.

    Parameters
    ----------
    force : array_like, shape (N,)
        Preload L0 [N], at least three different ones.
    displacement : array_like, shape (N,)
        Displacement of the tip at the same voltage [m].
    in_use : float
        Preload [N] to write into the parameters.

    Raises
    ------
    IdentificationError
        Too few points or preloads, values that are not finite, a negative preload.
    """
    force, displacement = checked_signals(force, displacement, ("preload", "displacement"), FEWEST_POINTS)
    if force.min() < 0.0:
        raise IdentificationError(f"preload {force.min():g} N is negative; give compressing forces as positive numbers")
    levels = np.unique(np.round(force / np.ptp(force), 6))
    if levels.size < 3:
        raise IdentificationError(f"{levels.size} different preloads; a quadratic needs at least three")
    unit = float(force.max())
    powers = unit ** np.arange(3)
    matrix = np.vander(force / unit, 3, increasing=True)
    found = np.linalg.lstsq(matrix, displacement, rcond=None)[0]
    residual = matrix @ found - displacement
    variance = float(residual @ residual) / max(force.size - 3, 1)
    covariance = variance * np.linalg.inv(matrix.T @ matrix) / np.outer(powers, powers)
    a1, b1, b2 = (found / powers).tolist()
    warnings = []
    ends = b1 + 2.0 * b2 * np.array([force.min(), force.max()])
    if ends.min() * ends.max() <= 0.0:
        warnings.append(
            f"W(L0) is not monotone between {force.min():g} and {force.max():g} N; a preload does not follow from it"
        )
    if in_use > force.max():
        warnings.append(f"preload {in_use:g} N lies beyond the largest recorded, {force.max():g} N: extrapolated")
    middle = float(np.mean(ends))
    return PreloadIdentification(
        parameters=PreloadParameters(force=float(in_use), A1=a1, B1=b1, B2=b2).validated(),
        covariance=covariance,
        rms=float(np.sqrt(np.mean(residual**2))),
        stiffness=-1.0 / middle if middle != 0.0 else float("inf"),
        largest_force=float(force.max()),
        warnings=tuple(warnings),
    )


def preload_of_offset(preload: PreloadParameters, offset: float) -> float:
    """Return the preload L0 [N] whose W is ``offset`` [m]: the root of eq. 3 next to zero preload.

    Parameters
    ----------
    preload : PreloadParameters
        Curve; its ``force`` is not used.
    offset : float
        Displacement of a recording under preload less that of the same recording without.

    Raises
    ------
    IdentificationError
        The curve never reaches this offset at a preload of 0 or more.
    """
    rise = offset - preload.A1
    discriminant = preload.B1**2 + 4.0 * preload.B2 * rise
    if discriminant >= 0.0 and preload.B1 != 0.0:
        force = 2.0 * rise / (preload.B1 + np.copysign(np.sqrt(discriminant), preload.B1))
        if force >= 0.0:
            return float(force)
    raise IdentificationError(
        f"offset {offset:g} m is not reached by the preload curve A1 = {preload.A1:g}, B1 = {preload.B1:g}, "
        f"B2 = {preload.B2:g} at any preload ≥ 0; check the sign of the displacement"
    )
