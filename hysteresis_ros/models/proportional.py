"""An actuator without hysteresis: displacement proportional to the voltage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Block, kernel
from hysteresis_ros.parameters import Parameters, parameter

GAIN = 0  # p
OUTPUT = 0  # x


@dataclass(frozen=True)
class ProportionalParameters(Parameters):
    """Gain of an actuator without hysteresis."""

    gain: float = parameter(description="displacement per voltage", unit="m/V", low=1e-15)


@kernel
def proportional(p, x, u):
    """Displacement [m] at voltage ``u`` [V]."""
    x[OUTPUT] = p[GAIN] * u
    return x[OUTPUT]


@kernel
def proportional_inverse(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] of :func:`proportional` for ``displacement`` [m]; only the gain ``p_h[0]`` is used."""
    return displacement / p_h[GAIN]


class ProportionalHysteresis(Block):
    """Displacement [m] proportional to the voltage [V]: the hysteresis block of an actuator that has none.

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
    def gain(self) -> float:
        """Nominal gain [m/V]."""
        return float(self.p[GAIN])

    def rebase(self) -> None:
        """Do nothing: there is no history to continue from. The compensator hands over in the voltage instead."""
