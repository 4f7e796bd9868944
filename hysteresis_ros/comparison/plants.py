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
from hysteresis_ros.models.creep import OUTPUT, CreepParameters
from hysteresis_ros.models.foreign import Foreign, ForeignParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters

#: Instants a sample at which the displacement is judged.
INSTANTS = 10
#: Eigenvectors that are conditioned worse than this are those of a pole that stands twice: they give no coordinates.
WORST_CONDITION = 1e10


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
        """Return the displacement [m] from rest without the preload offset, shape (N, INSTANTS).

        The linear dynamics go on continuously while their input is held, so that at the samples it is that of the loop.
        """
        actuator = Actuator(part(self.parameters, ActuatorParameters), 1.0 / self.sample_rate)
        rest = float(actuator.creep.x[OUTPUT])
        crept = actuator.creep.simulate(actuator.hysteresis.simulate(voltage))
        return between_samples(self.parameters.dynamics, 1.0 / self.sample_rate, rest, crept)


def between_samples(parameters: LinearParameters, sample_time: float, rest: float, held) -> np.ndarray:
    """Return the output [m] of linear dynamics between their samples, shape (N, INSTANTS).

    Where the dynamics belong to no continuous model (poles at zero, or negative ones), the output goes in a straight
    line from sample to sample.

    Parameters
    ----------
    parameters : LinearParameters
    sample_time : float
        [s]
    rest : float
        Input [m] under which the dynamics are at rest before.
    held : array, shape (N,)
        Input [m], held from each sample to the next.
    """
    dynamics = LinearDynamics(parameters, sample_time)
    dynamics.settle(rest)
    begin, ends = dynamics.output(), dynamics.simulate(held)
    model, (whole, part) = parameters.matrices, parameters.delayed_samples
    order = model.order
    poles, vectors = np.linalg.eig(model.A.astype(complex))
    continuous = np.all((poles.imag != 0.0) | (poles.real > 0.0))
    continuous &= not order or np.linalg.cond(vectors) < WORST_CONDITION
    places = np.arange(1, INSTANTS + 1) / INSTANTS
    if not continuous:
        starts = np.concatenate([[begin], ends[:-1]])
        return starts[:, np.newaxis] + (ends - starts)[:, np.newaxis] * places
    # what acts in a sample under a delay is a mixture of what was held in two samples before
    acting = np.concatenate([np.full(whole + 1, rest), held])
    acting = (1.0 - part) * acting[1 : 1 + len(held)] + part * acting[: len(held)]
    drive = acting / parameters.resolved_input_scale
    # x(k + j) = A^j x(k) + (I - A^j) x_rest u, in the coordinates of the poles
    unit = np.linalg.solve(vectors, np.linalg.solve(np.eye(order) - model.A, model.B[:, 0]))
    states, state = np.empty((len(held), order), dtype=complex), unit * rest / parameters.resolved_input_scale
    for k, u in enumerate(drive):
        states[k] = state
        state = poles * state + (1.0 - poles) * unit * u
    out, found = model.C[0] @ vectors, np.empty((len(held), INSTANTS))
    for j, place in enumerate(places):
        decay = poles**place
        found[:, j] = np.real(states @ (out * decay) + out @ ((1.0 - decay) * unit) * drive)
    return (found + model.D.item() * drive[:, np.newaxis]) * parameters.output_scale


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
