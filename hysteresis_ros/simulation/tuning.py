"""PID gains by Nelder-Mead on a criterion of the simulated closed loop, limits and compensator in it.

What is tuned on is never the plant, at which a design may not look: the plant of the simulation is made of what the
controller side believes, the compensator's hysteresis, creep and limits and the dynamics and preload of the
controller's model, without noise. With a perfect inverse of that hysteresis little but linear dynamics and limits
remains, and a criterion alone would drive the gains to the edge of stability: gains whose sensitivity peak is above
``largest_sensitivity`` count as infinitely bad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.margins import plant_state_space, sensitivity_peak
from hysteresis_ros.control.pid import PidParameters
from hysteresis_ros.control.pid_design import LARGEST_SENSITIVITY, design_pid, error_state_space
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.nelder_mead import nelder_mead
from hysteresis_ros.models.sensor import SensorParameters
from hysteresis_ros.simulation.axis import Axis, AxisParameters
from hysteresis_ros.simulation.node_parameters import part

#: Criteria: integral of absolute, squared, and time-weighted absolute error; time counts from the start of the run.
CRITERIA = ("iae", "ise", "itae")
#: Iterations and tolerance of the search.
ITERATIONS = 200
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result of :func:`tune_pid`.

    Parameters
    ----------
    gains : PidParameters
        The best found.
    criterion : str
        ``iae``, ``ise`` or ``itae``.
    before, after : float
        Criterion at the start and at the end [m s, m² s or m s²].
    history : ndarray, shape (iterations + 1, 4)
        K_p, K_i, K_d and the criterion after each iteration.
    converged : bool
        Without it the iterations ran out, and the gains are still the best found.
    """

    gains: PidParameters
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


def tune_pid(
    parameters: AxisParameters,
    criterion: str = "iae",
    *,
    start: PidParameters | None = None,
    duration: float | None = None,
    iterations: int = ITERATIONS,
    largest_sensitivity: float = LARGEST_SENSITIVITY,
) -> Tuned:
    """Tune the PID of an axis on its own waveform.

    Parameters
    ----------
    parameters : AxisParameters
        The axis; its plant is replaced by :func:`believed_axis`.
    criterion : str
        One of :data:`CRITERIA`, of delayed reference minus true displacement.
    start : PidParameters, optional
        Initial gains; by default those of lambda tuning (:func:`hysteresis_ros.control.pid_design.design_pid`).
    duration : float, optional
        Length of the run [s]; by default the configuration's own.
    iterations : int
        Most iterations.
    largest_sensitivity : float
        Gains with a higher sensitivity peak on the model are refused.

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
    dynamics = control.model.dynamics
    if duration is not None:
        parameters = parameters.with_duration(duration)
    first = start or design_pid(control.pid, dynamics, sample_time)
    node = replace(parameters.motion_controller, type="pid", pid=first)
    axis = Axis(believed_axis(replace(parameters, motion_controller=node)))
    samples = axis.default_samples() if duration is None else parameters.plant_simulator.samples
    if samples < 2:
        raise ConfigurationError("the waveform has no end (samples: 0): say how long to simulate with --duration S")
    setpoints = np.full(samples, parameters.reference_generator.initial_setpoint)
    offset, preview = control.model.preload.offset, control.feedforward.preview
    plant = plant_state_space(dynamics, scaled=False)
    tuned = [i for i, gain in enumerate((first.Kp, first.Ki, first.Kd)) if gain != 0.0]
    names = [("Kp", "Ki", "Kd")[i] for i in tuned]

    def gains(values) -> PidParameters:
        return replace(first, **{name: float(value) for name, value in zip(names, values, strict=True)})

    def cost(values) -> float:
        candidate = gains(values)
        linear = error_state_space(candidate, sample_time)
        if sensitivity_peak(linear, plant) > largest_sensitivity:
            return np.inf
        try:
            axis.controller = controller_block(replace(control, type="pid", pid=candidate), sample_time)
        except ParameterError:
            return np.inf
        axis.reset()
        signals = axis.run(setpoints)
        error = signals["reference"][: samples - preview] - (signals["displacement"][preview:] - offset)
        return criterion_of(criterion, error, sample_time)

    begin = np.array([getattr(first, name) for name in names])
    before = cost(begin)
    if not np.isfinite(before):
        controller_block(replace(control, type="pid", pid=first), sample_time)  # names what is wrong with them
        raise ConfigurationError(
            f"the initial gains have a sensitivity peak above {largest_sensitivity:g}; start from lower ones"
        )
    result = nelder_mead(cost, begin, iterations=iterations, tolerance=TOLERANCE)
    run = result.runs[result.best]
    history = np.tile([first.Kp, first.Ki, first.Kd, 0.0], (len(run.costs), 1))
    history[:, tuned] = run.trajectory
    history[:, 3] = run.costs
    return Tuned(gains(result.x), criterion, before, result.cost, history, result.converged)
