# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gains by Nelder-Mead on a criterion of the simulated closed loop, limits and compensator in it.

What is tuned on is never the plant, at which a design may not look: the plant of the simulation is made of what the
controller side believes, the compensator's hysteresis, creep and limits and the dynamics and preload of the
controller's model, without noise. With a perfect inverse of that hysteresis little but linear dynamics and limits
remains, and a criterion alone would drive the gains to the edge of stability: gains that miss the margins
of every design, and a delay margin of 1.3 samples, count as infinitely bad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.margins import Requirements, judge
from hysteresis_ros.control.registry import LAWS
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.models.force_sensor import ForceSensorParameters
from hysteresis_ros.models.sensor import SensorParameters
from hysteresis_ros.parameters import Parameters

#: Criteria: integral of absolute, squared, and time-weighted absolute error; time counts from the start of the run.
CRITERIA = ("iae", "ise", "itae")
#: Iterations and tolerance of the search.
ITERATIONS = 200
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result of :func:`tune`.

    Parameters
    ----------
    gains : Parameters
        The best found, of the law's group.
    criterion : str
        ``iae``, ``ise`` or ``itae``.
    before, after : float
        Criterion at the start and at the end [m s, m² s or m s²].
    history : ndarray, shape (iterations + 1, n + 1)
        The n gains that the law declares and the criterion after each iteration.
    converged : bool
        Without it the iterations ran out, and the gains are still the best found.
    """

    gains: Parameters
    criterion: str
    before: float
    after: float
    history: np.ndarray
    converged: bool


def believed_axis(parameters: AxisParameters) -> AxisParameters:
    """Return the axis whose plant is what compensator and controller believe of it.

    Parameters
    ----------
    parameters : AxisParameters
    """
    compensator, model = parameters.hysteresis_compensator, parameters.motion_controller.model
    plant = replace(
        parameters.plant_simulator,
        limits=compensator.limits,
        hysteresis=compensator.hysteresis,
        creep=compensator.creep,
        dynamics=model.dynamics,
        preload=model.preload,
        sensor=SensorParameters(),
        force_sensor=ForceSensorParameters(**model.force.to_mapping()),
        safe_voltage=compensator.safe_voltage,
    )
    return replace(parameters, plant_simulator=plant)


def criterion_of(name: str, error, sample_time: float) -> float:
    """Return a criterion of an error.

    Parameters
    ----------
    name : str
        One of :data:`CRITERIA`.
    error : ndarray, shape (N,)
        [m]
    sample_time : float
        [s]
    """
    size = np.abs(error)
    if name == "ise":
        size = size * size
    elif name == "itae":
        size = size * (sample_time * np.arange(len(error)))
    return float(np.sum(size) * sample_time)


def _setpoints(axis: Axis, parameters: AxisParameters, duration: float | None) -> np.ndarray:
    """Return the setpoint of every sample of a run [m]."""
    samples = axis.default_samples() if duration is None else parameters.plant_simulator.samples
    if samples < 2:
        raise ConfigurationError("the waveform has no end (samples: 0): say how long to simulate with --duration S")
    return np.full(samples, parameters.reference_generator.initial_setpoint)


def _error(signals: dict, control: ControllerParameters) -> np.ndarray:
    """Return the reference, as late as its preview, less the true displacement [m]."""
    preview = control.feedforward.preview
    wanted = signals["reference"][: len(signals["reference"]) - preview]
    return wanted - (signals["displacement"][preview:] - control.model.preload.offset)


def tune(
    parameters: AxisParameters,
    kind: str = "pid",
    criterion: str = "iae",
    *,
    start: Parameters | None = None,
    duration: float | None = None,
    iterations: int = ITERATIONS,
    required: Requirements | None = None,
) -> Tuned:
    """Tune the controller of an axis on its own waveform.

    Parameters
    ----------
    parameters : AxisParameters
        The axis; its plant is replaced by :func:`believed_axis`.
    kind : str
        Type of the controller, one that declares a :class:`~hysteresis_ros.control.law.Tuning`.
    criterion : str
        One of :data:`CRITERIA`, of delayed reference minus true displacement.
    start : Parameters, optional
        Initial gains, of the law's own group; by default those with which the law declares to begin.
    duration : float, optional
        Length of the run [s]; by default the configuration's own.
    iterations : int
        Most iterations.
    required : Requirements, optional
        Gains that miss it on the model are refused; by default what the law declares.

    Raises
    ------
    ConfigurationError
        The configuration does not say how long its run is, or the criterion is unknown.
    ParameterError
        The initial gains are not stable on the model.
    """
    if criterion not in CRITERIA:
        raise ConfigurationError(f"criterion = {criterion!r}: must be one of {', '.join(CRITERIA)}")
    control = part(parameters.motion_controller, ControllerParameters)
    sample_time = 1.0 / parameters.plant_simulator.sample_rate
    if duration is not None:
        parameters = parameters.with_duration(duration)
    tuning = LAWS[kind].tuning
    required = required or tuning.required
    first = start or getattr(tuning.start(control.before_damping(sample_time), sample_time), kind)

    def with_gains(all_parameters, gains):
        return replace(all_parameters, **{"type": kind, kind: gains})

    node = with_gains(parameters.motion_controller, first)
    axis = Axis(believed_axis(replace(parameters, motion_controller=node)))
    setpoints = _setpoints(axis, parameters, duration)
    initial = [getattr(first, name) for name in tuning.gains]
    tuned = [i for i, gain in enumerate(initial) if gain != 0.0]
    names = [tuning.gains[i] for i in tuned]

    def gains(values) -> Parameters:
        return replace(first, **{name: float(value) for name, value in zip(names, values, strict=True)})

    def cost(values) -> float:
        candidate = with_gains(control, gains(values))
        own = candidate.before_damping(sample_time)
        if not judge(*tuning.loop(own, sample_time), sample_time).meets(required):
            return np.inf
        try:
            axis.controller.install(controller_block(candidate, sample_time))
        except ParameterError:
            return np.inf
        axis.reset()
        return criterion_of(criterion, _error(axis.run(setpoints), control), sample_time)

    begin = np.array([getattr(first, name) for name in names])
    before = cost(begin)
    if not np.isfinite(before):
        controller_block(with_gains(control, first), sample_time)  # names what is wrong with them
        raise ConfigurationError(
            f"the initial gains have a sensitivity peak above {required.sensitivity_peak:g} or a delay margin below "
            f"{required.delay_margin:g} samples; start from lower ones"
        )
    result = restarted_nelder_mead(cost, begin, settings=SimplexSettings(iterations=iterations, tolerance=TOLERANCE))
    history = _history(result.runs[result.best], initial, tuned)
    return Tuned(gains(result.x), criterion, before, result.cost, history, result.converged)


def _history(run, initial, tuned) -> np.ndarray:
    """Return all gains and the cost of each iteration, shape (iterations, gains + 1), from those that were tuned."""
    history = np.tile([*initial, 0.0], (len(run.costs), 1))
    history[:, tuned] = run.trajectory
    history[:, -1] = run.costs
    return history
