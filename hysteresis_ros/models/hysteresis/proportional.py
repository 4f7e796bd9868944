# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""An actuator without hysteresis: displacement proportional to the voltage.

.. math::

   x = g V

The model has no memory that could keep the output when parameters change. Instead, the compensator prevents a jump of
the voltage (``handover_time``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    NOWHERE,
    Deviation,
    HysteresisModel,
    LinearTerms,
    RateIndependentBlock,
    times,
)

GAIN = 0  # p
OUTPUT = 0  # x


@dataclass(frozen=True)
class ProportionalParameters(Parameters):
    """Gain of an actuator without hysteresis."""

    gain: float = parameter(description="displacement per voltage", unit="m/V", low=1e-15)


@kernel
def proportional(p, x, u):
    """Return the displacement [m] at the voltage ``u`` [V]."""
    x[OUTPUT] = p[GAIN] * u
    return x[OUTPUT]


@kernel
def proportional_inverse(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Return the voltage [V] of :func:`proportional` for ``displacement`` [m]; only the gain ``p_h[0]`` is used."""
    return displacement / p_h[GAIN]


class ProportionalHysteresis(RateIndependentBlock):
    """Displacement [m] proportional to the voltage [V]: the hysteresis block of an actuator without hysteresis.

    Parameters
    ----------
    parameters : ProportionalParameters
        Gain.
    sample_time : float
        Sample time [s], not used.
    """

    kernel = staticmethod(proportional)
    inverse = staticmethod(proportional_inverse)

    def pack(self, parameters: ProportionalParameters) -> np.ndarray:
        """Return p, shape (1,)."""
        return np.array([parameters.gain])

    @property
    def terms(self) -> LinearTerms:
        """The gain."""
        return LinearTerms(weights=(GAIN,), signals=(NOWHERE,), opening=(False,), output=NOWHERE)

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]."""
        return float(self.p[GAIN])


def _scaled(parameters: ProportionalParameters, factor: float) -> ProportionalParameters:
    return times(parameters, factor, "gain")


def _weighted(parameters: ProportionalParameters, factors) -> ProportionalParameters:
    return times(parameters, float(factors[0]), "gain")


def _deviated(parameters: ProportionalParameters, deviation: Deviation) -> ProportionalParameters:
    return times(parameters, deviation.gain, "gain")


MODEL = HysteresisModel(
    name="proportional",
    title="no hysteresis: a gain, for linear dynamics alone",
    data="any excitation; for dynamics a multisine, chirp or steps",
    parameters=ProportionalParameters,
    block=ProportionalHysteresis,
    example=ProportionalParameters(gain=0.1e-6),
    scaled=_scaled,
    deviated=_deviated,
    weighted=_weighted,
    inverses=("exact", "none"),
    identify="hysteresis_ros.identification.procedures:proportional",
    parts=("lag", "delay", "modes"),
)
