# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The controllers and compensators of the comparison, designed only from the models of an axis.

Designs get a :class:`Known`: a configuration whose plant is built from the axis' own models. So it cannot contain a
random plant (:mod:`hysteresis_ros.laboratory.comparison.tasks`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.inner_loop import modes
from hysteresis_ros.control.feedforward import FeedforwardParameters, designed_preview
from hysteresis_ros.control.law import UNFED
from hysteresis_ros.control.linearisation import margins
from hysteresis_ros.control.margins import Margins, Requirements
from hysteresis_ros.control.uncertainty import LARGEST, ResponseUncertainty, Uncertainty
from hysteresis_ros.designs.controller import DesignRequest, design_axis, response_uncertainty
from hysteresis_ros.designs.damping import DAMPED
from hysteresis_ros.designs.gains import believed_axis, robustness, tune
from hysteresis_ros.designs.learning import LearningRequest, design_learning
from hysteresis_ros.errors import ConfigurationError, HysteresisError, ParameterError
from hysteresis_ros.laboratory.comparison.laws import ROWS
from hysteresis_ros.laboratory.comparison.tasks import Conditions, Task
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.loop.reach import single_axis

#: Kinds of damping by the displacement, in the order in which they are tried; kind of damping by a measured force.
KINDS = ("irc", "ppf")
BY_FORCE = ("iff",)


def has_resonance(axis: AxisParameters) -> bool:
    """Return whether the controller's model has a resonance to damp."""
    node = axis.motion_controller
    poles = node.model.dynamics.matrices.poles.astype(complex)
    return any(damping < DAMPED for _, damping in modes(poles, 1.0 / node.sample_rate))


def has_force(axis: AxisParameters) -> bool:
    """Return whether the controller of an axis has a model of the force in the stack."""
    return axis.motion_controller.model.force.there


def damped_pid(given) -> dict:
    """Return a PID with the first kind of damping for which all loops meet the requirements of a design."""
    return _kept(given, KINDS)


def forced_pid(given) -> dict:
    """Return a PID with damping that uses the measured force."""
    return _kept(given, BY_FORCE)


def _kept(given, kinds: tuple[str, ...]) -> dict:
    key = ("pid", *kinds)
    if key not in given.gains:
        given.gains[key] = _designed(given.axis, kinds)
    return given.gains[key]


def _designed(axis: AxisParameters, kinds: tuple[str, ...]) -> dict:
    plain = replace(axis, motion_controller=replace(axis.motion_controller, feedforward=FeedforwardParameters()))
    reasons = []
    for kind in kinds:
        try:
            found = design_axis(plain, DesignRequest("pid", damping=kind))
        except ParameterError as error:
            reasons.append(f"{kind}: {error}")
            continue
        if not found.misses():
            gains, damping = found.parameters.pid.to_mapping(), found.parameters.damping.to_mapping()
            named = {f"pid.{name}": value for name, value in gains.items()}
            named |= {f"damping.{name}": value for name, value in damping.items() if _is_of(name, kind)}
            return {"type": "pid", **UNFED, **named}
        reasons.append(f"{kind}: {found.misses()[0]}")
    raise ConfigurationError("; ".join(reasons))


def _is_of(name: str, kind: str) -> bool:
    return name == "type" or name.startswith(f"{kind}.")


#: Smallest measurement noise of a design, as a fraction of the stroke; a Kalman filter needs some noise.
LEAST_NOISE = 1e-6
#: Number of reference periods for tuning a PID.
TUNING_PERIODS = 8
#: Pairs of a controller's name and a kind of learning.
LEARNERS = (("PID", "inversion"), ("offset-free", "inversion"), ("offset-free", "norm_optimal"))
#: Smallest mismatch that a design assumes.
LEAST_MISMATCH = 1e-3
#: Largest M_s if gain and times of the model deviate by the mismatch; a design allows the same with one unmodelled
#: sample of delay.
MISMATCHED = Requirements(sensitivity_peak=3.0, gain_margin=0.0, delay_margin=0.0)


@dataclass(frozen=True)
class Known:
    """Data of an axis that a design may use: a configuration whose plant consists of the axis' two models."""

    configuration: Configuration  #: One axis.
    noise: float = 0.0  #: Noise of the sensor [m rms], by its data sheet.
    #: Uncertainty of the identified response (None: unknown); learning is designed with it, as by ``hysteresis
    #: design``.
    response: ResponseUncertainty | None = field(default=None, compare=False)

    @property
    def axis(self) -> AxisParameters:
        """The axis with its own models as plant."""
        return single_axis(self.configuration)

    def designed(self, candidate: Candidate, task: Task | None = None) -> AxisParameters:
        """Return the axis with a candidate's parameters and the reference of a task; without a task, at rest."""
        found = self.configuration.override("motion_controller", **candidate.motion_controller)
        found = found.override("hysteresis_compensator", **candidate.hysteresis_compensator)
        if task is None:
            return single_axis(found.override("reference_generator", waveform__type="hold"))
        found = found.override("reference_generator", **task.overrides())
        if not candidate.learning:
            return single_axis(found)
        request = LearningRequest(candidate.learning, 1.0 / task.frequency)
        noisy = found.override("plant_simulator", sensor__noise=self.noise)
        learned = design_learning(single_axis(noisy), request, self.response).parameters.to_mapping()
        return single_axis(found.override("motion_controller", **{f"learning.{k}": v for k, v in learned.items()}))


def known(configuration: Configuration, bits: int, noise: float = 0.0) -> Known:
    """Return the data of an axis that a design may use; they do not depend on the plant."""
    limited = configuration.override("hysteresis_compensator", limits__bits=bits)
    text = believed_axis(single_axis(limited)).configuration_text()
    return Known(parse_configuration(text, configuration.source), noise, response_uncertainty(configuration))


@dataclass(frozen=True)
class Candidate:
    """One combination of controller and compensator."""

    controller: str  #: controller, compensator: Names in the table.
    compensator: str
    #: motion_controller, hysteresis_compensator: Parameters that differ from the configuration.
    motion_controller: dict = field(default_factory=dict)
    hysteresis_compensator: dict = field(default_factory=dict)
    refused: str = ""  #: Reason why the candidate cannot be designed; empty if it can.
    margins: Margins | None = None  #: Margins of the candidate's loop with its own model.
    #: Unmet requirements of its loop, with its own model or with a mismatch of gain and times; empty if all are met.
    marked: str = ""
    learning: str = ""  #: Kind of learning from period to period; empty: no learning.


def names(axis: AxisParameters) -> list[tuple[str, str]]:
    """Return the names of all combinations for an axis, (controller, compensator)."""
    return [(controller, compensator) for compensator in compensators(axis) for controller in controllers(axis)]


def candidates(given: Known, conditions: Conditions, tasks, only=None) -> list[Candidate]:
    """Return every combination: designed, or with the reason why it is refused."""
    axis, found = given.axis, []
    gains: dict = {}
    learners = {learner(*one): one[1] for one in LEARNERS}
    for compensator, changed in compensators(axis).items():
        for controller, design in controllers(axis).items():
            if only is not None and (controller, compensator) not in only:
                continue
            try:
                values = design(Given(given.configuration, axis, conditions, tasks, changed, gains))
                candidate = Candidate(controller, compensator, values, changed, learning=learners.get(controller, ""))
                found.append(_with_margins(given, candidate, conditions.mismatch))
            except HysteresisError as error:
                found.append(Candidate(controller, compensator, refused=" ".join(str(error).split())))
    return found


def _with_margins(given: Known, candidate: Candidate, mismatch: float) -> Candidate:
    node = given.designed(candidate).motion_controller
    parameters, sample_time = part(node, ControllerParameters), 1.0 / node.sample_rate
    found = margins(parameters, sample_time)
    misses = found.misses()
    if not misses and mismatch and node.law.feedback:
        off = min(mismatch, LARGEST)
        ends = Uncertainty(gain=off, hysteresis=0.0, resonance=off, delay=0.0, draws=0)
        misses = robustness(parameters, sample_time, ends).misses(MISMATCHED)
    return replace(candidate, margins=found, marked="; ".join(misses))


def compensators(axis: AxisParameters) -> dict[str, dict]:
    """Return the compensators of an axis: none, the best inverse of its model, and the same inverse with creep."""
    given = axis.hysteresis_compensator
    block = given.hysteresis.model.block
    found = {"none": {"inverse.type": "none"}}
    if not block.invertible:
        return found
    kind = given.inverse.type
    if kind == "none":
        kind = "exact" if block.inverse is not None else "general"
    name = f"{kind} inverse"
    found[name] = {"inverse.type": kind, "creep.type": "none"}
    if given.creep.type != "none":
        found[f"{name} with creep"] = {"inverse.type": kind}
    return found


@dataclass(frozen=True)
class Given:
    """Data for a design."""

    configuration: Configuration  #: One axis.
    axis: AxisParameters
    conditions: Conditions
    tasks: tuple[Task, ...]  #: The references.
    compensator: dict  #: Parameters of the compensator that differ from the configuration.
    gains: dict  #: Already tuned gains, by law and compensator.

    @property
    def dynamics(self):
        """The linear model of the controller; if there is damping, the model of the damped plant."""
        node = self.axis.motion_controller
        return part(node, ControllerParameters).before_damping(1.0 / node.sample_rate).model.dynamics

    def preview(self) -> dict:
        """Return the feedforward by inverse dynamics, with the shortest sufficient preview."""
        return {"feedforward.type": "inverse_dynamics", "feedforward.preview": designed_preview(self.dynamics)}

    def change(self) -> float:
        """Return the change per sample [model units] of the command disturbance that the mismatch causes."""
        moved = max((task.high - task.low) * np.pi * task.frequency for task in self.tasks)
        moved /= self.axis.plant_simulator.sample_rate * self.dynamics.resolved_input_scale
        return float(max(self.conditions.mismatch, LEAST_MISMATCH) * moved)

    def kalman(self, disturbance: str = "none") -> dict:
        """Return a Kalman filter for the noise and for the disturbances that the mismatch causes."""
        stroke = max(task.high - task.low for task in self.tasks)
        noise = max(self.conditions.noise, LEAST_NOISE * stroke) / self.dynamics.output_scale
        change = self.change()
        return {
            "kalman.form": "predictor" if np.any(self.dynamics.state_space.D) else "current",
            "kalman.gain": "riccati",
            "kalman.r": float(noise**2),
            # without an estimated disturbance, the filter corrects the mismatch only if it weights the measurement
            # strongly
            "kalman.q": ((10.0 if disturbance == "none" else 0.1) * change) ** 2,
            "kalman.Q": (),
            "kalman.disturbance": disturbance,
            "kalman.q_disturbance": change**2 if disturbance != "ramp" else (0.1 * change) ** 2,
            "kalman.q_disturbance_rate": (0.3 * change) ** 2,
        }

    def tuned(self, kind: str) -> dict:
        """Return gains for the fastest reference, tuned on the models of compensator and controller.

        The gains are tuned without feedforward, even if the controller gets one: with exact models, feedforward leaves
        no error, and all gains would be equally good.
        """
        key = (kind, *self.compensator.items())
        if key not in self.gains:
            task = max(self.tasks, key=lambda task: task.frequency)
            configuration = self.configuration.override("motion_controller", type="open_loop", **UNFED)
            configuration = configuration.override("hysteresis_compensator", **self.compensator)
            axis = single_axis(configuration.override("reference_generator", **task.overrides()))
            gains = tune(axis, kind, "iae", duration=TUNING_PERIODS / task.frequency).gains
            self.gains[key] = {f"{kind}.{name}": value for name, value in gains.to_mapping().items()}
        return self.gains[key]


def controllers(axis: AxisParameters) -> dict:
    """Return the design of each controller of the table, by name: as configured, by law, with learning, with damping.

    A design is a function that takes :class:`Given` and returns the parameters of the motion controller that differ
    from the configuration.
    """
    declared = {name: design for name, (_, design) in ROWS.items()}
    learning = {learner(*one): declared[one[0]] for one in LEARNERS}
    damping = {"PID + damping": damped_pid} if has_resonance(axis) else {}
    if damping and has_force(axis):
        damping["PID + force feedback"] = forced_pid
    return {"as configured": lambda given: {}, **declared, **learning, **damping}


def learner(controller: str, kind: str) -> str:
    """Return the name of a controller with learning."""
    return f"{controller} + learning by {kind.replace('_', '-')}"
