# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What stands in the plant's place: it can be driven in the loop and, afterwards, looked at between the samples.

No candidate gets one of these, see :mod:`hysteresis_ros.comparison.candidates`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.loop.plants import ActuatorPlant
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.foreign import Foreign, ForeignParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.simulation.between_samples import INSTANTS, displacement_between


class DrawnPlant(ABC):
    """A plant that was drawn."""

    @property
    @abstractmethod
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""

    @abstractmethod
    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""

    @abstractmethod
    def later(self) -> DrawnPlant:
        """Return the plant with one sample of delay more."""

    @abstractmethod
    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest, shape (N, INSTANTS).

        Parameters
        ----------
        voltage : array, shape (N,)
            What its amplifier put out from each sample to the next [V]; row k holds what follows the k-th.
        """


@dataclass(frozen=True)
class ModelledPlant(DrawnPlant):
    """A plant of the classes that parameter files know.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type actuator.
    """

    parameters: PlantNodeParameters

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""
        return ActuatorPlant(self.parameters)

    def later(self) -> ModelledPlant:
        """Return the plant with one sample of delay more."""
        sample_time, dynamics = 1.0 / self.sample_rate, self.parameters.dynamics
        dynamics = replace(dynamics, delay=dynamics.delay + sample_time, sample_time=sample_time)
        return ModelledPlant(replace(self.parameters, dynamics=dynamics))

    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest without the preload offset, shape (N, INSTANTS)."""
        return displacement_between(
            Actuator(part(self.parameters, ActuatorParameters), 1.0 / self.sample_rate), voltage
        )


@dataclass(frozen=True)
class ForeignPlant(DrawnPlant):
    """A plant of another class than any model, behind the limits and the sensor of a modelled one.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Limits, sensor and sample rate; nothing else of it is used.
    actuator : ForeignParameters
    """

    parameters: PlantNodeParameters
    actuator: ForeignParameters

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    def in_loop(self) -> ActuatorPlant:
        """Return the plant at rest, for an axis."""
        return _ForeignInLoop(replace(self.parameters, overtravel=-1.0), self.actuator)

    def later(self) -> ForeignPlant:
        """Return the plant with one sample of delay more."""
        return replace(self, actuator=replace(self.actuator, delay=self.actuator.delay + 1.0 / self.sample_rate))

    def between(self, voltage) -> np.ndarray:
        """Return the displacement [m] from rest, shape (N, INSTANTS)."""
        return Foreign(replace(self.actuator, steps=INSTANTS), 1.0 / self.sample_rate).between(voltage)


class _ForeignInLoop(ActuatorPlant):
    """An actuator whose hysteresis, creep and dynamics are those of another class, all in one block."""

    def __init__(self, parameters: PlantNodeParameters, actuator: ForeignParameters):
        # what the file has for creep and dynamics is a model of these
        super().__init__(replace(parameters, creep=CreepParameters(), dynamics=LinearParameters()))
        block, chain = Foreign(actuator, 1.0 / parameters.sample_rate), self.actuator
        chain.hysteresis, chain.hysteresis_kernel = block, block.kernel
        chain.ps, chain.xs = chain.ps._replace(hysteresis=block.p), chain.xs._replace(hysteresis=block.x)
        chain.reset()
        self.arrays = self.arrays._replace(p=chain.ps, x=chain.xs)
