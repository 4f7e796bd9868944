"""The controllers and compensators that are compared, each designed on the models in the configuration alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.gain_design import INPUT_WEIGHT
from hysteresis_ros.control.inversion import sufficient_preview
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.models.hysteresis import HYSTERESIS_BLOCKS
from hysteresis_ros.models.linear import dc_gain
from hysteresis_ros.simulation.axis import AxisParameters
from hysteresis_ros.simulation.run import single_axis
from hysteresis_ros.simulation.tuning import tune_pid

#: Closed-loop pole of the sliding controllers: bandwidth as a part of the sample rate.
BANDWIDTH = 0.1
#: A preview is long enough when what the inversion leaves is below this part of the reference, or at its longest.
INVERSION_ERROR = 1e-4
LONGEST_PREVIEW = 64
#: Least measurement noise a design reckons with, as a part of the stroke: a filter needs some.
LEAST_NOISE = 1e-6
#: Without feedforward.
UNFED = {"feedforward.type": "none", "feedforward.preview": 0}
#: Periods of the reference on which a PID is tuned.
TUNING_PERIODS = 8
#: Least mismatch that a design reckons with.
LEAST_MISMATCH = 1e-3


@dataclass(frozen=True)
class Candidate:
    """One combination of controller and compensator.

    Parameters
    ----------
    controller, compensator : str
        Names in the table.
    motion_controller, hysteresis_compensator : dict
        Parameters that differ from the configuration's.
    refused : str
        Why it cannot be designed; empty when it can.
    """

    controller: str
    compensator: str
    motion_controller: dict = field(default_factory=dict)
    hysteresis_compensator: dict = field(default_factory=dict)
    refused: str = ""


def candidates(configuration: Configuration, conditions, tasks, only=None) -> list[Candidate]:
    """Return every combination, designed or refused by name.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    conditions : Conditions
        The noise and the mismatch that the designs reckon with.
    tasks : sequence of Task
        The references, for the tuning and for how fast disturbances change.
    only : collection of (str, str), optional
        Names of the combinations (controller, compensator) to design; all by default.

    Raises
    ------
    ParameterError
        The configuration is wrong.
    """
    axis = single_axis(configuration)
    found, gains = [], {}
    for compensator, changed in compensators(axis).items():
        for controller, design in CONTROLLERS.items():
            if only is not None and (controller, compensator) not in only:
                continue
            try:
                values = design(_Given(configuration, axis, conditions, tasks, changed, gains))
            except HysteresisError as error:
                found.append(Candidate(controller, compensator, refused=" ".join(str(error).split())))
            else:
                found.append(Candidate(controller, compensator, values, changed))
    return found


def compensators(axis: AxisParameters) -> dict[str, dict]:
    """Return the compensators of an axis: none, the best inverse of its model, and that with its creep."""
    given = axis.hysteresis_compensator
    block = HYSTERESIS_BLOCKS[given.hysteresis.type]
    found = {"none": {"inverse.type": "none"}}
    if not getattr(block, "rate_independent", True):
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
class _Given:
    """What a design may know."""

    configuration: Configuration
    axis: AxisParameters
    conditions: object
    tasks: tuple
    compensator: dict
    #: PID gains that were tuned already, by compensator.
    gains: dict

    @property
    def dynamics(self):
        return self.axis.motion_controller.model.dynamics

    def preview(self) -> dict:
        """Return the feedforward with the shortest preview that inverts the model well."""
        preview = min(sufficient_preview(self.dynamics, INVERSION_ERROR), LONGEST_PREVIEW)
        return {"feedforward.type": "inverse_dynamics", "feedforward.preview": preview}

    def change(self) -> float:
        """Return how far the mismatch moves the command's disturbance in a sample [model units]."""
        moved = max((task.high - task.low) * np.pi * task.frequency for task in self.tasks)
        moved /= self.axis.plant_simulator.sample_rate * self.dynamics.resolved_input_scale
        return float(max(self.conditions.mismatch, LEAST_MISMATCH) * moved)

    def kalman(self, disturbance: str = "none") -> dict:
        """Return a filter for the noise, and for disturbances as fast as the mismatch makes them."""
        stroke = max(task.high - task.low for task in self.tasks)
        noise = max(self.conditions.noise, LEAST_NOISE * stroke) / self.dynamics.output_scale
        change = self.change()
        return {
            "kalman.form": "current",
            "kalman.gain": "riccati",
            "kalman.r": float(noise**2),
            # a filter without a disturbance has to believe the measurement, or nothing of the mismatch is seen
            "kalman.q": ((10.0 if disturbance == "none" else 0.1) * change) ** 2,
            "kalman.Q": (),
            "kalman.disturbance": disturbance,
            "kalman.q_disturbance": change**2 if disturbance != "ramp" else (0.1 * change) ** 2,
            "kalman.q_disturbance_rate": (0.3 * change) ** 2,
        }

    def tuned(self) -> dict:
        """Return PID gains for the fastest reference, tuned on what compensator and controller believe.

        Without feedforward, also for a PID beside one: with all that is believed true the feedforward leaves a PID
        nothing to do, and no gain would be worse than another.
        """
        key = tuple(self.compensator.items())
        if key not in self.gains:
            task = max(self.tasks, key=lambda task: task.frequency)
            configuration = self.configuration.override("motion_controller", type="open_loop", **UNFED)
            configuration = configuration.override("hysteresis_compensator", **self.compensator)
            axis = single_axis(configuration.override("reference_generator", **task.overrides()))
            gains = tune_pid(axis, "iae", duration=TUNING_PERIODS / task.frequency).gains
            self.gains[key] = {f"pid.{name}": value for name, value in gains.to_mapping().items()}
        return self.gains[key]

    def sliding(self, **more) -> dict:
        """Return a sliding mode controller whose reaching pole has the bandwidth of the comparison."""
        phi = float(np.exp(-2.0 * np.pi * BANDWIDTH))
        law = {
            "tracking": "target",
            "hyperplane": "lq",
            "S": (),
            "lq_state_weight": (),
            "lq_input_weight": INPUT_WEIGHT * dc_gain(*self.dynamics.matrices) ** 2,
            "phi": phi,
            "eta": 0.0,
            "beta": 0.0,
            "delta": 1.0,
            **more,
        }
        return {"type": "sliding_mode", **{f"sliding_mode.{name}": value for name, value in law.items()}}


def _configured(given: _Given) -> dict:
    return {}


def _open_loop(given: _Given) -> dict:
    return {"type": "open_loop", **UNFED}


def _feedforward(given: _Given) -> dict:
    return {"type": "open_loop", **given.preview()}


def _pid(given: _Given) -> dict:
    """Tune a PID on the fastest reference, where it has the hardest time, with this compensator in the loop."""
    return {"type": "pid", **UNFED, **given.tuned()}


def _pid_fed(given: _Given) -> dict:
    return {"type": "pid", **given.preview(), **given.tuned()}


def _sliding(given: _Given) -> dict:
    return {**given.sliding(), **given.kalman(), **UNFED}


def _sliding_integral(given: _Given) -> dict:
    return {**given.sliding(tracking="integral"), **given.kalman(), **UNFED}


def _integral_sliding(given: _Given) -> dict:
    law = given.sliding() | {"type": "integral_sliding_mode"}
    return {**law, **given.kalman("constant"), **given.preview()}


def _super_twisting(given: _Given) -> dict:
    law = given.sliding() | {"type": "super_twisting", "super_twisting.gains": "from_bound"}
    bound = given.change() * given.axis.plant_simulator.sample_rate
    return {**law, "super_twisting.bound": bound, **given.kalman("constant"), **given.preview()}


def _offset_free(given: _Given) -> dict:
    return {**given.sliding(), **given.kalman("constant"), **UNFED}


def _offset_free_fed(given: _Given) -> dict:
    return {**given.sliding(), **given.kalman("constant"), **given.preview()}


def _drift_free_fed(given: _Given) -> dict:
    return {**given.sliding(), **given.kalman("ramp"), **given.preview()}


#: Name in the table → design: the parameters of the motion controller that differ from the configuration's.
CONTROLLERS = {
    "as configured": _configured,
    "open loop": _open_loop,
    "feedforward": _feedforward,
    "PID": _pid,
    "PID + feedforward": _pid_fed,
    "sliding mode": _sliding,
    "sliding mode, integral": _sliding_integral,
    "super-twisting + feedforward": _super_twisting,
    "integral sliding mode + feedforward": _integral_sliding,
    "offset-free": _offset_free,
    "offset-free + feedforward": _offset_free_fed,
    "drift-free + feedforward": _drift_free_fed,
}
