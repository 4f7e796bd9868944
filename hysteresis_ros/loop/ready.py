# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prediction of the time from which a move is ready: its displacement stays within a tolerance of the setpoint.

The closed loop of the move is simulated in advance; its plant is the model of controller and compensator. The
simulation is repeated for each of four deviations of the plant from this model: gain, width of the hysteresis loop,
slowness and creep. The displacement is assumed to be linear in these deviations. They are estimated from the
measurements of earlier moves (recursive least squares with forgetting), so a model with an error of some percent
predicts well after the first move. Many realisations of the noise at rest are added to the predicted displacement;
the predicted time is the median over these realisations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.parameters import (
    AxisParameters,
    CompensatorNodeParameters,
    ControllerNodeParameters,
    PlantNodeParameters,
    RecorderNodeParameters,
    ReferenceNodeParameters,
)
from hysteresis_ros.loop.simulation import deviating
from hysteresis_ros.loop.tick import WHOLE, ticks
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.adaptation import AdaptationParameters
from hysteresis_ros.models.block import specialised
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.models.sensor import ForceSensorParameters, SensorParameters
from hysteresis_ros.references.moves import Noise
from hysteresis_ros.references.waveforms import WaveformParameters
from hysteresis_ros.signals import SOURCE

#: Relative deviation of the plant from its model for which the loop is simulated.
SIZE = 0.05
#: Factors of gain, loop width, slowness and creep of each simulated plant; the first plant is the model.
PLANTS = (
    (1.0, 1.0, 1.0, 1.0),
    (1.0 + SIZE, 1.0, 1.0, 1.0),
    (1.0, 1.0 + SIZE, 1.0, 1.0),
    (1.0, 1.0, 1.0 + SIZE, 1.0),
    (1.0, 1.0, 1.0, 1.0 + SIZE),
)
#: Error of the linear model as a fraction of the remaining distance to the setpoint.
ROUGHNESS = 0.3
#: Forgetting factor of the estimate: weight of a move relative to the next move.
FORGETTING = 0.98
#: Number of samples in a simulation of the noise at rest.
REST = 8192
#: Number of samples before them in which the loop settles.
SETTLING = 2000
#: Number of realisations of the noise.
REALISATIONS = 32
#: Largest number of samples per call of the simulation, small enough for the thread to release the interpreter soon.
CHUNK = 2048
#: First horizon of a prediction, in addition to the dwell time [samples].
NEAR = 256
#: Longest horizon of a prediction [samples].
AHEAD = 20_000
#: Longest time before a move over which the models follow the axis [samples].
BEHIND = 512


def model_of(
    source: ReferenceNodeParameters, controller: ControllerNodeParameters, compensator: CompensatorNodeParameters
) -> AxisParameters:
    """Return an axis without a waveform, whose plant is the model of controller and compensator.

    Neither its measurements nor its references have the offset of a preload.
    """
    shared: dict[str, Any] = {"time_mode": "lockstep", "faults": (), "external_plant": False}
    plant = PlantNodeParameters(
        sample_rate=source.sample_rate,
        joint=source.joint,
        force_joint=source.force_joint,
        limits=compensator.limits,
        hysteresis=compensator.hysteresis,
        creep=compensator.creep,
        dynamics=controller.model.dynamics,
        force_sensor=ForceSensorParameters.from_mapping(controller.model.force.to_mapping()),
        safe_voltage=compensator.safe_voltage,
        overtravel=-1.0,
        late_limit=-1,
        **shared,
    )
    return AxisParameters(
        namespace="",
        plant_simulator=plant,
        reference_generator=replace(source, waveform=WaveformParameters(), **shared),
        motion_controller=replace(
            controller,
            model=replace(controller.model, preload=PreloadParameters()),
            learning=LearningParameters(),
            **shared,
        ),
        hysteresis_compensator=replace(compensator, adaptation=AdaptationParameters(), **shared),
        recorder=RecorderNodeParameters(),
    )


def deviated(axis: AxisParameters, gain: float, opening: float, slowness: float, creep: float) -> AxisParameters:
    """Return the axis with a plant whose gain, loop width, slowness and creep are these multiples of the model's."""
    plant = axis.plant_simulator
    deviation = Deviation(gain, opening, lambda count=None: np.ones(count or ()))
    changed = deviating(plant, deviation, slowness, creep)
    return replace(axis, plant_simulator=PlantNodeParameters.from_mapping({**plant.to_mapping(), **changed}))


def entry(error: np.ndarray, tolerance: float, dwell: int) -> float:
    """Return the first sample from which errors [m], shape (N,), stay within a tolerance [m] for ``dwell`` samples.

    Infinite if they never do.
    """
    outside = np.flatnonzero(~(np.abs(error) <= tolerance))
    begins = np.concatenate([[0], outside + 1])
    long_enough = np.concatenate([outside, [len(error)]]) - begins >= max(dwell, 1)
    return float(begins[np.argmax(long_enough)]) if long_enough.any() else math.inf


@dataclass(frozen=True)
class RestingLoop:
    """Simulated response of a loop at rest to sensor noise, scaled to a standard deviation of the noise of 1 m.

    Parameters
    ----------
    trace : ndarray, shape (REST,)
        Displacement relative to its mean [m].
    displacement, error : float
        Standard deviations of the displacement and of the measured error [m].
    """

    trace: np.ndarray
    displacement: float
    error: float


class Predictor:
    """Predicts when a move is ready, and estimates from measurements how far the plant deviates from its model.

    Parameters
    ----------
    axis : AxisParameters
        Parameters of the axis, whose plant is a model, see :func:`model_of`.

    Attributes
    ----------
    resting : RestingLoop
        The model of the loop at rest under noise.
    deviations : ndarray, shape (4,)
        Estimated deviations of gain, loop width, slowness and creep from the model, in units of :data:`SIZE`.

    Raises
    ------
    ParameterError
        The parameters do not make an axis.
    """

    def __init__(self, axis: AxisParameters):
        self.sample_time = 1.0 / axis.plant_simulator.sample_rate
        self._axes = [Axis(axis if factors == PLANTS[0] else deviated(axis, *factors)) for factors in PLANTS]
        for one in self._axes:
            columns = np.empty((len(one.kind.row), 1))
            specialised(ticks, one.laws, one.parts, one.given, columns, np.zeros(len(columns)), WHOLE)
        self.resting = _resting(axis)
        self.deviations = np.zeros(len(PLANTS) - 1)
        self._covariance = np.eye(len(PLANTS) - 1)
        self._setpoint = axis.reference_generator.initial_setpoint if axis.reference_generator is not None else 0.0
        self._states = [_copy(one) for one in self._axes]
        self._followed = 0
        self._given = self._setpoint
        self._traces = np.empty((len(PLANTS), 0))

    def predict(
        self, setpoint: float, after: int, tolerance: float, dwell: float, noise: Noise, path: dict | None = None
    ) -> float:
        """Return the time from the first sample of a move until it is ready [s]; infinite: not within the horizon.

        Parameters
        ----------
        setpoint : float
            Setpoint [m], or last point of the trajectory.
        after : int
            Number of samples from the beginning of the last move to the beginning of this move.
        tolerance : float
            Largest distance of the displacement from the setpoint [m].
        dwell : float
            Time for which the displacement must stay within the tolerance [s].
        noise : Noise
            Measured noise.
        path : dict, optional
            Points of a trajectory to the setpoint, as for :meth:`.ReferenceGenerator.follow`.
        """
        self._begin(setpoint, after, path)
        # a dwell time beyond half of the longest horizon is shortened to it: the error is assumed to stay within the
        # tolerance
        samples, random = min(math.ceil(dwell / self.sample_time - 1e-9), AHEAD // 2), np.random.default_rng(0)
        places = random.integers(REST, size=REALISATIONS)
        jitter, size = self.resting.trace, noise.displacement / max(self.resting.displacement, 1e-300)
        while True:
            self._look_ahead(min(max(NEAR + samples, 2 * self._traces.shape[1]), AHEAD))
            mean = self.expected - setpoint
            times = np.arange(len(mean))
            found = [entry(mean + size * jitter[(place + times) % REST], tolerance, samples) for place in places]
            if np.mean(np.isfinite(found)) > 0.9 or len(mean) >= AHEAD:
                return float(np.median(found)) * self.sample_time

    @property
    def expected(self) -> np.ndarray:
        """Predicted displacement of the present move without noise [m], shape (N,), as far as it has been computed."""
        return self._traces[0] + self.deviations @ self._slopes

    @property
    def _slopes(self) -> np.ndarray:
        """Change of the displacement per unit of each deviation [m], shape (4, N)."""
        return self._traces[1:] - self._traces[0]

    def learn(self, measured, noise: Noise) -> None:
        """Estimate the deviations from the measurements [m] since the first sample of the move, shape (N,)."""
        count = min(len(measured), self._traces.shape[1])
        residual = np.asarray(measured[:count], dtype=float) - self._traces[0, :count]
        known = np.isfinite(residual)
        left = np.maximum.accumulate(np.abs(self._traces[0, :count] - self._setpoint)[::-1])[::-1]
        weight = 1.0 / (max(noise.sensor, 1e-12) ** 2 + (ROUGHNESS * left[known]) ** 2)
        slopes = self._slopes[:, :count][:, known]
        past = FORGETTING * np.linalg.inv(self._covariance)
        self._covariance = np.linalg.inv(past + (slopes * weight) @ slopes.T)
        self.deviations = self._covariance @ (past @ self.deviations + (slopes * weight) @ residual[known])

    def rest_at(self, setpoint: float) -> None:
        """Bring the models to rest at a setpoint [m]."""
        self._begin(setpoint, 0, None)
        self.follow(SETTLING)

    def follow(self, samples: int) -> None:
        """Let the models follow the axis for ``samples`` samples, counted from the beginning of the last move."""
        if samples <= self._followed:
            return
        for one, state in zip(self._axes, self._states, strict=True):
            _restore(one, state)
            for first in range(self._followed, samples, CHUNK):
                one.run(np.full(min(CHUNK, samples - first), self._given))
        self._states = [_copy(one) for one in self._axes]
        self._followed = samples

    def _begin(self, setpoint: float, after: int, path: dict | None) -> None:
        """Bring the models to the state of the axis at the first sample of a move."""
        self.follow(min(after, self._followed + BEHIND))
        for one, state in zip(self._axes, self._states, strict=True):
            _restore(one, state)
            if path is not None:
                one.apply(Change(0, SOURCE, "follow", path))
        self._states = [_copy(one) for one in self._axes]
        self._followed, self._setpoint = 0, setpoint
        # a trajectory does not change the setpoint of the axis
        self._given = self._given if path is not None else setpoint
        self._traces = np.empty((len(PLANTS), 0))

    def _look_ahead(self, samples: int) -> None:
        """Continue the simulation of the move until it has ``samples`` samples."""
        while (left := samples - self._traces.shape[1]) > 0:
            rows = [one.run(np.full(min(left, CHUNK), self._given))["displacement"] for one in self._axes]
            self._traces = np.concatenate([self._traces, np.array(rows)], axis=1)


def _resting(axis: AxisParameters) -> RestingLoop:
    """Simulate the model of an axis at rest, with noise so small that the loop is linear."""
    plant, own = axis.plant_simulator, axis.reference_generator
    if own is None:
        raise ConfigurationError("an inchworm motor has no reference generator: its moves are not predicted")
    size = 1e-4 * (own.maximum - own.minimum)
    runs = []
    for noise in (size, 0.0):
        loop = Axis(replace(axis, plant_simulator=replace(plant, sensor=SensorParameters(noise=noise, seed=1))))
        runs.append(loop.run(np.full(SETTLING + REST, 0.5 * (own.minimum + own.maximum))))
    # approach and creep are the same in both runs, so they cancel
    noisy, clean = runs
    moved, seen = ((noisy[name] - clean[name])[SETTLING:] / size for name in ("displacement", "measured"))
    trace = moved - np.mean(moved)
    return RestingLoop(trace, float(np.std(trace)), float(np.std(seen)))


def _arrays(found) -> Iterator[np.ndarray]:
    """Yield all arrays of nested tuples."""
    if isinstance(found, np.ndarray):
        yield found
    elif isinstance(found, tuple):
        for one in found:
            yield from _arrays(one)


def _copy(axis: Axis) -> list[np.ndarray]:
    """Return copies of all arrays of an axis."""
    return [array.copy() for array in _arrays(tuple(axis.parts))]


def _restore(axis: Axis, state: list[np.ndarray]) -> None:
    """Set the arrays of an axis to copied values."""
    for array, value in zip(_arrays(tuple(axis.parts)), state, strict=True):
        array[:] = value
