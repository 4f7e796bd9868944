# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a measured frequency response says of a model: how far off it is, and linear dynamics fitted to the lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.control.response_uncertainty import UNKNOWN, ResponseUncertainty
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.matrix_fraction import MatrixFractionFit, identify_matrix_fraction
from hysteresis_ros.identification.response_analysis import Analysis
from hysteresis_ros.identification.response_check import WHOLE
from hysteresis_ros.identification.response_file import PROBABILITY
from hysteresis_ros.models.linear import LinearParameters

#: Lowest lines by which the gain of a response to a voltage is compared with the model's.
LOWEST = 10
#: Iterations by which the lines of a fit are weighted as its own denominator says.
ITERATIONS = 10


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """A response from command to displacement.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        [Hz]
    response : ndarray of complex, shape (F,)
        [m/m]
    radius : ndarray, shape (F,)
        Of the circles that hold the true one with 95 %.
    """

    frequency: np.ndarray
    response: np.ndarray
    radius: np.ndarray

    def uncertainty(self, model, sample_time: float) -> ResponseUncertainty:
        """Return how far a model may be off: what was measured, and what the circles leave open.

        Parameters
        ----------
        model : ndarray of complex, shape (F,)
            Of the model at the lines.
        sample_time : float
            [s]
        """
        relative = (np.abs(self.response - model) + self.radius) / np.maximum(np.abs(model), 1e-12)
        last = float(self.frequency[-1])
        # the next line would be at or beyond half the sample rate
        spacing = float(self.frequency[-1] - self.frequency[-2]) if self.frequency.size > 1 else 0.0
        known_to = np.inf if (last + spacing) * sample_time >= WHOLE else last
        return ResponseUncertainty(self.frequency, np.minimum(relative, UNKNOWN), known_to)


def measured_plant(found: Analysis, model) -> MeasuredPlant:
    """Return the response from the command; of one from a voltage with the model's gain at the lowest lines.

    The model's gain is that of the whole stroke, and small movements of a hysteresis have another one.

    Parameters
    ----------
    found : Analysis
    model : ndarray of complex, shape (F,)
        Of the model at the lines.
    """
    response = found.response
    radius = response.radius(PROBABILITY)[:, 0, 0]
    scale = 1.0
    if response.input_unit == "V":
        scale = float(np.median(np.abs(model[:LOWEST])) / np.median(np.abs(response.single[:LOWEST])))
    return MeasuredPlant(response.frequency, scale * response.single, scale * radius)


def dynamics_of(found: Analysis, order: int | None = None) -> tuple[LinearParameters, MatrixFractionFit]:
    """Return linear dynamics of unit DC gain that fit a response, and the fit.

    Parameters
    ----------
    found : Analysis
    order : int, optional
        Of the dynamics; by default the lowest that fits about as well as any.

    Raises
    ------
    IdentificationError
        No stable dynamics fit, or the order is none.
    """
    if order is not None and not 1 <= order <= found.response.frequency.size // 4:
        raise IdentificationError(
            f"order {order}: must be within 1 … {found.response.frequency.size // 4}, a quarter of the lines"
        )
    fit = identify_matrix_fraction(found.response, order, iterations=ITERATIONS)
    return fit.model.linear_parameters(), fit
