"""All controllers and compensators on one plant under the same honest conditions: which one to choose for an axis.

Every candidate is designed on the models in the configuration. Then it runs on plants drawn around them (fixed seeds),
with sensor noise, converters and the limits of the configuration, and is judged on the true displacement.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hysteresis_ros.analysis.metrics import chattering_figures
from hysteresis_ros.analysis.settings import delayed
from hysteresis_ros.comparison.candidates import Candidate, candidates
from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.node_parameters import part
from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.mismatch import mismatched
from hysteresis_ros.simulation.run import simulate

#: The plant rests this long at each end of the voltage when its reach is measured [s].
REST = 2.0
#: Time before the first judged sample: creep and history of the start have died away then [s], and least periods.
SETTLING = 2.0
SETTLING_PERIODS = 2
#: Time judged [s], and least periods.
JUDGED = 4.0
JUDGED_PERIODS = 4


@dataclass(frozen=True)
class Conditions:
    """What every candidate has to live with.

    Parameters
    ----------
    mismatch : float
        Largest relative deviation of each parameter of the plants.
    noise : float
        Sensor noise [m rms].
    bits : int
        Resolution of the converter; 0: unlimited.
    draws : int
        Number of plants.
    seed : int
        Seed of the first plant; the others follow.
    sine_frequency, triangle_frequency : float
        Frequencies of the two references [Hz].
    sine_stroke, triangle_stroke : float
        Their peak-to-peak parts of the reachable stroke of the worst plant.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    mismatch: float = 0.05
    noise: float = 5e-9
    bits: int = 16
    draws: int = 20
    seed: int = 1
    sine_frequency: float = 1.0
    triangle_frequency: float = 10.0
    sine_stroke: float = 0.9
    triangle_stroke: float = 0.2

    def __post_init__(self):
        """Refuse conditions that describe no experiment."""
        allowed = {
            "mismatch": (0.0 <= self.mismatch <= 0.5, "must be within 0 … 0.5"),
            "noise": (0.0 <= self.noise < 1.0, "must be a noise in metres, 0 or more"),
            "bits": (0 <= self.bits <= 32, "must be within 0 … 32 (0: unlimited)"),
            "draws": (1 <= self.draws <= 10000, "must be within 1 … 10000"),
            "seed": (self.seed >= 0, "must be 0 or more"),
            "sine": (0.0 < self.sine_frequency < np.inf, "must be a frequency in Hz above 0"),
            "triangle": (0.0 < self.triangle_frequency < np.inf, "must be a frequency in Hz above 0"),
        }
        values = {"sine": self.sine_frequency, "triangle": self.triangle_frequency}
        problems = [
            Problem(name, values.get(name, getattr(self, name, None)), text)
            for name, (good, text) in allowed.items()
            if not good
        ]
        if problems:
            raise ParameterError(problems)


@dataclass(frozen=True)
class Task:
    """A reference that the candidates follow.

    Parameters
    ----------
    name : str
        In words.
    waveform : str
        ``sine`` or ``triangle``.
    frequency : float
        [Hz]
    low, high : float
        Ends [m].
    """

    name: str
    waveform: str
    frequency: float
    low: float
    high: float

    @property
    def settling(self) -> float:
        """Time before judging [s], whole periods."""
        return np.ceil(max(SETTLING * self.frequency, SETTLING_PERIODS)) / self.frequency

    @property
    def duration(self) -> float:
        """Length of a run [s], whole periods."""
        return self.settling + np.ceil(max(JUDGED * self.frequency, JUDGED_PERIODS)) / self.frequency

    def overrides(self) -> dict:
        """Return the parameters of the reference generator."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        values = {
            "minimum": min(self.low, 0.0) - half,
            "maximum": self.high + half,
            "initial_setpoint": 0.0,
            "waveform.type": self.waveform,
            "waveform.frequency": self.frequency,
            "waveform.cycles": 0,
        }
        if self.waveform == "sine":
            # begins at its lower end
            return {**values, "waveform.amplitude": half, "waveform.offset": middle, "waveform.phase": -0.5 * np.pi}
        return {**values, "waveform.amplitude": 2.0 * half, "waveform.offset": self.low}


@dataclass(frozen=True)
class Result:
    """One candidate on one task, over all plants.

    Parameters
    ----------
    rms, maximum : array, shape (draws,)
        RMS and largest error of the true displacement [m].
    effort : array, shape (draws,)
        RMS rate of the voltage [V/s], as in :func:`hysteresis_ros.analysis.metrics.compute_metrics`.
    chattering : array, shape (draws,)
        ``chattering_m`` of the command [m rms], as there.
    saturated : float
        Part of the judged samples at a limit, the largest of the plants.
    """

    rms: np.ndarray
    maximum: np.ndarray
    effort: np.ndarray
    chattering: np.ndarray
    saturated: float


@dataclass(frozen=True)
class Row:
    """One candidate: its results, or why it was refused.

    Parameters
    ----------
    candidate : Candidate
        Controller, compensator and their parameters.
    results : dict of str to Result
        By name of the task; empty for a refused candidate.
    refused : str
        Why there are no results.
    errors : dict of str to (array, array)
        Time [s] and error [m] on the plant on which the candidate did worst, by name of the task.
    """

    candidate: Candidate
    results: dict[str, Result] = field(default_factory=dict)
    refused: str = ""
    errors: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @property
    def score(self) -> float:
        """Geometric mean over the tasks of the RMS error on the worst plant [m]; the ranking goes by it."""
        if not self.results:
            return float("inf")
        worst = [float(np.max(result.rms)) for result in self.results.values()]
        return float(np.exp(np.mean(np.log(worst)))) if np.all(np.isfinite(worst)) else float("inf")


@dataclass(frozen=True)
class Comparison:
    """The whole table.

    Parameters
    ----------
    conditions : Conditions
    tasks : tuple of Task
    stroke : float
        Stroke that every plant reaches [m]; per cents are of it.
    reach : (float, float)
        Its ends [m].
    rows : tuple of Row
        Best first, refused ones last.
    assumptions : tuple of str
        What the table rests on, in sentences.
    configuration : str
        Text of the configuration.
    """

    conditions: Conditions
    tasks: tuple[Task, ...]
    stroke: float
    reach: tuple[float, float]
    rows: tuple[Row, ...]
    assumptions: tuple[str, ...]
    configuration: str = ""

    def row(self, controller: str, compensator: str) -> Row:
        """Return the row of a combination.

        Raises
        ------
        ConfigurationError
            There is none.
        """
        for row in self.rows:
            if (row.candidate.controller, row.candidate.compensator) == (controller, compensator):
                return row
        raise ConfigurationError(f"no row '{controller}' with '{compensator}' in the comparison")

    def percent(self, value: float) -> float:
        """Return a displacement [m] in % of the stroke."""
        return 100.0 * value / self.stroke


def reachable(configuration: Configuration, draws) -> tuple[float, float]:
    """Return the ends [m] of the range that every plant reaches within its limits, preload offset left out.

    Each plant rests :data:`REST` seconds at its highest, then at its lowest voltage.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    draws : iterable of Configuration
        The plants.

    Raises
    ------
    ConfigurationError
        There is no such range.
    """
    lows, highs = [], []
    for drawn in draws:
        plant = single_axis(drawn).plant_simulator
        actuator = Actuator(part(plant, ActuatorParameters), 1.0 / plant.sample_rate)
        ends = []
        for voltage in (plant.limits.maximum, plant.limits.minimum):
            for _ in range(round(REST * plant.sample_rate)):
                actuator.advance(voltage)
            actuator.measure()
            ends.append(actuator.displacement - plant.preload.offset)
        highs.append(ends[0])
        lows.append(ends[1])
    low, high = max(*lows, lows[0]), min(*highs, highs[0])
    if not low < high:
        raise ConfigurationError(
            f"{configuration.source}: the plants have no displacement in common between "
            f"{low * 1e6:.4g} and {high * 1e6:.4g} µm: lower the mismatch or widen limits.minimum … limits.maximum"
        )
    return low, high


def honest(configuration: Configuration, conditions: Conditions) -> list[Configuration]:
    """Return the axis with each of the plants: drawn, with noise of its own, behind converters."""
    found = []
    for seed in range(conditions.seed, conditions.seed + conditions.draws):
        drawn = mismatched(configuration, conditions.mismatch, seed)
        drawn = drawn.override(
            "plant_simulator", limits__bits=conditions.bits, sensor__noise=conditions.noise, sensor__seed=seed
        )
        found.append(drawn.override("hysteresis_compensator", limits__bits=conditions.bits))
    return found


def make_tasks(conditions: Conditions, reach: tuple[float, float]) -> tuple[Task, ...]:
    """Return the two references within the range that every plant reaches."""
    low, high = reach
    middle, stroke = 0.5 * (low + high), high - low

    def task(words, waveform, frequency, fraction):
        half = 0.5 * fraction * stroke
        name = f"{frequency:g} Hz {words}, {100.0 * fraction:g} % of stroke"
        return Task(name, waveform, frequency, middle - half, middle + half)

    return (
        task("sine", "sine", conditions.sine_frequency, conditions.sine_stroke),
        task("triangle", "triangle", conditions.triangle_frequency, conditions.triangle_stroke),
    )


def compare(
    configuration: Configuration,
    conditions: Conditions | None = None,
    *,
    namespace: str | None = None,
    only=None,
    progress=lambda row: None,
) -> Comparison:
    """Run every candidate on every plant and rank them.

    Parameters
    ----------
    configuration : Configuration
        One axis: the plant around which plants are drawn, and the models that compensator and controller know.
    conditions : Conditions, optional
        The usual ones by default.
    namespace : str, optional
        Which axis of several.
    only : collection of (str, str), optional
        Names of the combinations (controller, compensator) to run; all by default.
    progress : callable
        Called with every finished row.

    Raises
    ------
    ConfigurationError
        The configuration holds several axes, or that of an inchworm, or the plants reach no common range.
    ParameterError
        A parameter is wrong, or a reference is too fast for the sample rate.
    """
    conditions = conditions or Conditions()
    axis = single_axis(configuration, namespace)
    if axis.reference_generator is None:
        raise ConfigurationError(
            f"{configuration.source}: an inchworm's sequencer stands in the place of the reference generator, whose "
            "references are compared; give the configuration of a single actuator"
        )
    if namespace is not None:
        configuration = parse_configuration(axis.configuration_text(), configuration.source)
    rate = axis.plant_simulator.sample_rate
    for name in ("sine", "triangle"):
        frequency = getattr(conditions, f"{name}_frequency")
        if frequency > 0.1 * rate:
            allowed = f"must be at most a tenth of the sample rate, {0.1 * rate:g} Hz"
            raise ParameterError([Problem(name, frequency, allowed)])
    plants = honest(configuration, conditions)
    reach = reachable(configuration, plants)
    tasks = make_tasks(conditions, reach)
    rows = []
    for candidate in candidates(configuration, conditions, tasks, only):
        row = _judged(candidate, plants, tasks)
        progress(row)
        rows.append(row)
    rows.sort(key=lambda row: row.score)
    return Comparison(
        conditions, tasks, reach[1] - reach[0], reach, tuple(rows), _assumptions(axis, conditions), configuration.text
    )


def _judged(candidate: Candidate, plants: list[Configuration], tasks: tuple[Task, ...]) -> Row:
    if candidate.refused:
        return Row(candidate, refused=candidate.refused)
    results, errors = {}, {}
    for task in tasks:
        found = []
        for plant in plants:
            axis = plant.override("motion_controller", **candidate.motion_controller)
            axis = axis.override("hysteresis_compensator", **candidate.hysteresis_compensator)
            try:
                parameters = single_axis(axis.override("reference_generator", **task.overrides()))
                run = simulate(parameters, duration=task.duration, describe=False)
            except ParameterError as error:
                return Row(candidate, refused=" ".join(str(error).split()))
            found.append(judge(run, parameters, task))
        worst = max(found, key=lambda judged: judged.rms)
        errors[task.name] = worst.time, worst.error
        columns = ([getattr(judged, name) for judged in found] for name in ("rms", "maximum", "effort", "chattering"))
        results[task.name] = Result(*map(np.array, columns), max(judged.saturated for judged in found))
    return Row(candidate, results=results, errors=errors)


class Judged(NamedTuple):
    """One run: time [s] and error [m] of the judged samples, and the figures of :class:`Result`."""

    time: np.ndarray
    error: np.ndarray
    rms: float
    maximum: float
    effort: float
    chattering: float
    saturated: float


def judge(run: Recording, axis: AxisParameters, task: Task) -> Judged:
    """Return what a run is worth.

    The error is that of the true displacement against the delayed reference, from ``task.settling`` on.
    """
    judged = run.time >= task.settling - 0.5 * run.sample_time
    reference = delayed(run["reference"], axis.motion_controller.feedforward.preview)
    displacement = run["displacement"] - axis.plant_simulator.preload.offset
    error = (reference - displacement)[judged]
    smooth = chattering_figures(run.time[judged], reference[judged], run["command"][judged], run["voltage"][judged])
    return Judged(
        run.time[judged],
        error,
        float(np.sqrt(np.mean(error**2))),
        float(np.max(np.abs(error))),
        smooth["voltage_rate_v_s"],
        smooth.get("chattering_m", 0.0),
        float(np.mean(run["saturated"][judged])),
    )


def _assumptions(axis: AxisParameters, conditions: Conditions) -> tuple[str, ...]:
    limits = axis.hysteresis_compensator.limits
    per_cent = 100.0 * conditions.mismatch
    converters = f"converters of {conditions.bits} bits" if conditions.bits else "converters without steps"
    return (
        f"{conditions.draws} plants around the configured one, seeds {conditions.seed} … "
        f"{conditions.seed + conditions.draws - 1}: gain, opening of the hysteresis and each of its weights, times of "
        f"the dynamics and rate of the creep each off by up to ±{per_cent:g} %, uniform and independent",
        f"sensor noise {conditions.noise * 1e9:g} nm rms, {converters}, limits "
        f"{limits.minimum:g} … {limits.maximum:g} V",
        "errors are those of the true displacement, in % of the stroke that every plant reaches; with preview against "
        "the delayed reference",
        "every candidate was designed on the models in the configuration, knowing the size of noise and mismatch",
    )
