# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gains of any controller: designed for a bandwidth, robust to uncertainty, or tuned by simulation.

Every law declares its designs (:mod:`hysteresis_ros.control.law`); this module contains the common part.

A robust design draws all random plants before the search, so equal seeds give equal gains. The search starts with the
model and the corners of its uncertainty. The plant with the worst violation of the requirements is then added, again
and again, until all plants meet the requirements.

The tuning never uses the simulated plant of the file, because a design must not depend on it. Its plant has the
hysteresis, creep and limits of the compensator, the dynamics and preload of the controller's model, and no noise. For
this plant the inverse is perfect, so little more than linear dynamics and limits remains, and the criterion alone would
drive the gains to the stability limit. Therefore the cost is infinite for gains that violate the margins required of
every design, or a delay margin of 1.3 samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.controller import LAWS, ControllerParameters, controller_block, design_of
from hysteresis_ros.control.damping.inner_loop import closing
from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.control.law import DesignTask
from hysteresis_ros.control.linearisation import linear_loop, margins
from hysteresis_ros.control.margins import AIMED, REQUIRED, Margins, Requirements, judge, margins_of
from hysteresis_ros.control.uncertainty import CORNERS, PossiblePlant, Uncertainty, drawn_plants
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.executors import Job, shared
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.models.sensor import ForceSensorParameters, SensorParameters


@dataclass(frozen=True, eq=False)
class Designed:
    """A design: parameters with gains, and their margins on the model."""

    parameters: ControllerParameters
    margins: Margins


def require_minimal(dynamics) -> None:
    """Refuse a model that is not controllable or observable."""
    problems = [replace(problem, name=f"model.dynamics.{problem.name}") for problem in dynamics.check()]
    if problems:
        raise ParameterError(problems)
    model = dynamics.state_space
    A, B, C = model.A, model.B, model.C
    for value in model.poles:
        text = f"(pole {value:.6g}); identify a model of lower order, or cancel that pole"
        if not state_feedback.full_rank(np.hstack([A - value * np.eye(len(A)), B]).T):
            state_feedback.refuse("model.dynamics.B", dynamics.B, f"the model is not controllable {text}")
        if not state_feedback.full_rank(np.vstack([A - value * np.eye(len(A)), C])):
            state_feedback.refuse("model.dynamics.C", dynamics.C, f"the model is not observable {text}")


def design_gains(
    parameters,
    controller: str,
    sample_time: float,
    bandwidth: float | None = None,
    q: float | None = None,
    *,
    aimed: Requirements = AIMED,
    plants: tuple[PossiblePlant, ...] = (),
) -> Designed:
    """Design the named controller for the model in ``parameters``; their damping, if any, is part of the plant.

    Units: ``sample_time`` [s], ``bandwidth`` [Hz].
    """
    law, designed = design_of(controller)
    own = parameters.before_damping(sample_time)
    dynamics = own.model.dynamics
    require_minimal(dynamics)
    dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    if bandwidth is not None and not 0.0 < bandwidth < 0.5 / sample_time:
        state_feedback.refuse(
            "bandwidth", bandwidth, f"must be above 0 and below half the sample rate, {0.5 / sample_time:g} Hz"
        )
    chosen = replace(own, type=law.name)
    task = DesignTask(chosen, sample_time, bandwidth, q, lambda one: linear_loop(one, sample_time), aimed, plants)
    found = replace(designed(task), model=parameters.model, damping=parameters.damping)
    return Designed(found, margins(found, sample_time))


#: A search aims at this fraction of the allowed M_s, because its frequency grid is coarser than that of the margins.
COARSE = 0.99
#: Maximum number of plants that are added to the search.
ROUNDS = 8
#: Maximum number of plants per parallel job.
TOGETHER = 50
#: Approximate computing time of the margins on one plant [s].
SECONDS = 2e-2


@dataclass(frozen=True, eq=False)
class Robustness:
    """Margins of a loop on all plants within an uncertainty."""

    uncertainty: Uncertainty
    plants: tuple[PossiblePlant, ...]  #: Plants within the uncertainty, the model first.
    margins: tuple[Margins, ...]  #: Margins on each plant; delay margins count from the model's delay.

    @property
    def worst(self) -> int:
        """Index of the first unstable plant; if all plants are stable, index of the plant with the largest M_s."""
        sizes = [found.sensitivity_peak if found.stable else float("inf") for found in self.margins]
        return sizes.index(max(sizes))

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, text) of the printed rows about the margins."""
        ranges, found = self.uncertainty, self.margins[self.worst]
        drawn = (
            f"{len(self.plants)}: gain ±{100.0 * ranges.gain:g} %, hysteresis ±{100.0 * ranges.hysteresis:g} %, times "
            f"±{100.0 * ranges.resonance:g} %, up to {ranges.delay:g} samples later, seed {ranges.seed}"
        )
        least = min(margins.delay_margin_samples for margins in self.margins)
        return [
            ("plants", drawn),
            ("worst plant", self.plants[self.worst].description),
            ("M_s there", f"{found.sensitivity_peak:.3f}" if found.stable else "unstable"),
            ("least gain margin", f"{min(margins.gain_margin for margins in self.margins):.1f} dB"),
            ("least delay margin", f"{least:.3g} samples"),
        ]

    def misses(self, required: Requirements = REQUIRED) -> tuple[str, ...]:
        """Return the first unmet requirement, on the worst plant if possible."""
        order = [self.worst, *range(len(self.plants))]
        for i in order:
            said = self.margins[i].misses(required)
            if said:
                text = said[0].replace("unstable on its own model", "unstable")
                return (f"{text} on a plant with {self.plants[i].description}",)
        return ()


def robustness(parameters, sample_time: float, uncertainty: Uncertainty) -> Robustness:
    """Return the margins of a controller's loop on all plants within the uncertainty.

    Units: ``sample_time`` [s].
    """
    plants = _plants(parameters, sample_time, uncertainty)
    return _robustness(parameters, sample_time, uncertainty, plants)


def _plants(parameters, sample_time: float, uncertainty: Uncertainty) -> tuple[PossiblePlant, ...]:
    """Return the plants within an uncertainty, each with the inner damping loop of the parameters closed."""
    dynamics = parameters.model.dynamics
    around = closing(parameters.damping, dynamics, sample_time, parameters.model.force)
    drawn = drawn_plants(dynamics, sample_time, uncertainty, acting=parameters.damping.source == FORCE)
    return tuple(one.closed(around) for one in drawn)


def _margins(controller, plants, sample_time: float) -> list[Margins]:
    return [margins_of(controller, one.plant, sample_time) for one in plants]


def _robustness(parameters, sample_time: float, uncertainty: Uncertainty, plants) -> Robustness:
    controller, _ = linear_loop(parameters, sample_time)
    pieces = [plants[i : i + TOGETHER] for i in range(0, len(plants), TOGETHER)]
    jobs = [Job(_margins, (controller, piece, sample_time)) for piece in pieces]
    found = [margins for piece in shared(jobs, SECONDS * len(plants)) for margins in piece]
    counted = [
        replace(margins, delay_margin=margins.delay_margin + one.late * sample_time)
        for margins, one in zip(found, plants, strict=True)
    ]
    return Robustness(uncertainty, plants, tuple(counted))


def design_robust(
    parameters,
    controller: str,
    sample_time: float,
    uncertainty: Uncertainty,
    q: float | None = None,
    *,
    aimed: Requirements = REQUIRED,
) -> tuple[Designed, Robustness]:
    """Return gains that meet the requirements on every plant within the uncertainty, and their margins.

    Units: ``sample_time`` [s].
    """
    plants = _plants(parameters, sample_time, uncertainty)
    active = list(plants[: 1 + CORNERS])
    sought = replace(aimed, sensitivity_peak=COARSE * aimed.sensitivity_peak)
    for _ in range(ROUNDS):
        found = design_gains(parameters, controller, sample_time, q=q, aimed=sought, plants=tuple(active))
        judged = _robustness(found.parameters, sample_time, uncertainty, plants)
        missing = [i for i in range(len(plants)) if judged.margins[i].misses(aimed) and plants[i] not in active]
        if not missing:
            break
        active.append(plants[max(missing, key=lambda i: judged.margins[i].sensitivity_peak)])
    return found, judged


#: Criteria: integral of the absolute, the squared, and the time-weighted absolute error, over the time since the start.
CRITERIA = ("iae", "ise", "itae")
#: Iterations and tolerance of the search.
ITERATIONS = 200
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result of :func:`tune`."""

    gains: Parameters  #: Best gains, as the parameter group of the law.
    criterion: str  #: ``iae``, ``ise`` or ``itae``.
    before: float  #: before, after: Value of the criterion for the initial and the final gains [m s, m² s or m s²].
    after: float
    #: shape (iterations + 1, n + 1); The n gains declared by the law, and the criterion, after each iteration.
    history: np.ndarray
    converged: bool  #: False: the search reached the iteration limit; the gains are the best so far.


def believed_axis(parameters: AxisParameters) -> AxisParameters:
    """Return the axis with a plant built from the models of its compensator and controller."""
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
    """Return the criterion ``name`` of an error.

    Units: ``error`` [m], ``sample_time`` [s].
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
        raise ConfigurationError(
            "the waveform has no end (samples: 0): give the duration of the simulation with --duration S"
        )
    return np.full(samples, parameters.generator.initial_setpoint)


def _error(signals: dict, control: ControllerParameters) -> np.ndarray:
    """Return the error [m]: reference delayed by the preview, minus true displacement, without the preload offset."""
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
    """Tune the controller of an axis on the waveform of the axis.

    Units: ``duration`` [s].
    """
    if criterion not in CRITERIA:
        raise ConfigurationError(f"criterion = {criterion!r}: must be one of {', '.join(CRITERIA)}")
    control = part(parameters.motion_controller, ControllerParameters)
    sample_time = 1.0 / parameters.plant_simulator.sample_rate
    if duration is not None:
        parameters = parameters.with_duration(duration)
    tuning = LAWS[kind].tuning
    if tuning is None:
        raise ConfigurationError(f"{kind}: has no gains that can be tuned by a criterion")
    required = required or tuning.required
    sought = replace(required, sensitivity_peak=COARSE * required.sensitivity_peak)
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
        if not judge(*tuning.loop(own, sample_time), sample_time=sample_time, with_bandwidth=False).meets(sought):
            return np.inf
        try:
            # the loop subtracts the preload's offset before it calls the law
            axis.controller.install(controller_block(candidate.without_preload, sample_time))
        except ParameterError:
            return np.inf
        axis.reset()
        return criterion_of(criterion, _error(axis.run(setpoints), control), sample_time)

    begin = np.array([getattr(first, name) for name in names])
    before = cost(begin)
    if not np.isfinite(before):
        controller_block(with_gains(control, first), sample_time)  # raises the error about invalid gains
        raise ConfigurationError(
            f"the initial gains have a sensitivity peak above {required.sensitivity_peak:g} or a delay margin below "
            f"{required.delay_margin:g} samples; start from lower gains"
        )
    result = restarted_nelder_mead(cost, begin, settings=SimplexSettings(iterations=iterations, tolerance=TOLERANCE))
    history = _history(result.runs[result.best], initial, tuned)
    return Tuned(gains(result.x), criterion, before, result.cost, history, result.converged)


def _history(run, initial, tuned) -> np.ndarray:
    """Return all gains and the cost of each iteration, shape (iterations, gains + 1)."""
    history = np.tile([*initial, 0.0], (len(run.costs), 1))
    history[:, tuned] = run.trajectory
    history[:, -1] = run.costs
    return history
