# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""All controllers and compensators under the same honest conditions: which one to choose for an axis.

Two tables: plants drawn around the configured one, on which every candidate is designed on the models in the
configuration; and plants of other classes than any model, on each of which every candidate is designed on what the
default identification makes of a recording of it. The runs have sensor noise, converters and limits, and are judged on
the true displacement between the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hysteresis_ros.comparison.candidates import known, names
from hysteresis_ros.comparison.others import around, conditions_bench, drawn, identified, recorded
from hysteresis_ros.comparison.outcome import Comparison, Tried, table_around, table_of_others
from hysteresis_ros.comparison.plants import ModelledPlant
from hysteresis_ros.comparison.rows import Row, Trial, compared_with
from hysteresis_ros.comparison.tasks import Conditions, make_tasks
from hysteresis_ros.comparison.yardstick import yardstick
from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.executors.executor import executor
from hysteresis_ros.executors.jobs import Job
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.mismatch import mismatched

#: The plant rests this long at each end of the voltage when its reach is measured [s].
REST = 2.0


def reachable(plants: Sequence[ModelledPlant], source: str) -> tuple[float, float]:
    """Return the ends [m] of the range that every plant reaches within its limits, preload offset left out.

    Each plant rests :data:`REST` seconds at its highest, then at its lowest voltage.

    Parameters
    ----------
    plants : sequence of ModelledPlant
    source : str
        Of the configuration, for the message.

    Raises
    ------
    ConfigurationError
        There is no such range.
    """
    lows, highs = [], []
    for plant in plants:
        limits, samples = plant.parameters.limits, round(REST * plant.sample_rate)
        displacement = plant.between([limits.maximum] * samples + [limits.minimum] * samples)[:, -1]
        highs.append(displacement[samples - 1])
        lows.append(displacement[-1])
    low, high = float(max(lows)), float(min(highs))
    if not low < high:
        raise ConfigurationError(
            f"{source}: the plants have no displacement in common between "
            f"{low * 1e6:.4g} and {high * 1e6:.4g} µm: lower the mismatch or widen limits.minimum … limits.maximum"
        )
    return low, high


def drawn_around(configuration: Configuration, conditions: Conditions) -> list[ModelledPlant]:
    """Return plants around the configured one, each with noise of its own, behind converters.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    conditions : Conditions
    """
    found = []
    for seed in range(conditions.seed, conditions.seed + conditions.draws):
        plant = mismatched(configuration, conditions.mismatch, seed).override(
            "plant_simulator", limits__bits=conditions.bits, sensor__noise=conditions.noise, sensor__seed=seed
        )
        found.append(ModelledPlant(single_axis(plant).plant_simulator))
    return found


def trial_around(configuration: Configuration, conditions: Conditions) -> Trial:
    """Return the trial on plants around the configured one.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    conditions : Conditions
    """
    plants = drawn_around(configuration, conditions)
    low, high = reachable(plants, configuration.source)
    given, tasks = known(configuration, conditions.bits), make_tasks(conditions, (low, high))
    return Trial(given, conditions, tasks, high - low, tuple(plants))


def trial_on_other(seed: int, conditions: Conditions) -> Trial:
    """Return the trial on a plant of another class, and on what may have become of it since it was recorded.

    All but the plants follows from the recording: the references too, within what the model reaches less the mismatch.

    Parameters
    ----------
    seed : int
        Of the plant and of the noise in its recording.
    conditions : Conditions
    """
    bench = conditions_bench(conditions)
    plant = drawn(seed, bench)
    given = identified(recorded(plant, bench, seed), bench)
    low, high = reachable([ModelledPlant(given.axis.plant_simulator)], "the identified model")
    reach = low * (1.0 + conditions.mismatch), high * (1.0 - conditions.mismatch)
    tasks = make_tasks(conditions, reach)
    return Trial(given, conditions, tasks, reach[1] - reach[0], tuple(around(plant, conditions.mismatch, seed)))


# -- work for processes ------------------------------------------------------------------------------------------------


def _rows_around(trial: Trial, compensator: str, only) -> tuple[str, list[Row]]:
    return f"with {compensator}", trial.rows([name for name in only if name[1] == compensator])


def _yardstick_around(trial: Trial) -> tuple[str, Row]:
    return "yardstick", yardstick(trial)


def _rows_on_other(seed: int, conditions: Conditions, only) -> tuple[str, Tried]:
    trial = trial_on_other(seed, conditions)
    measure, kind = yardstick(trial), trial.plants[0].actuator.hysteresis
    rows = compared_with(trial.rows(only), measure)
    return f"plant {seed} of another class ({kind})", Tried(seed, kind, trial.stroke, rows, measure)


def _require_known(only, possible: Sequence[tuple[str, str]]) -> None:
    """Refuse combinations that the axis does not have: they would be missing from the tables without a word."""
    for position, kind in enumerate(("controller", "compensator")):
        known_names = list(dict.fromkeys(name[position] for name in possible))
        for name in (combination[position] for combination in only):
            if name not in known_names:
                raise ConfigurationError(
                    f"there is no {kind} {name!r} to compare{did_you_mean(name, known_names)} "
                    f"(there are: {', '.join(known_names)})"
                )


def compare(
    configuration: Configuration,
    conditions: Conditions | None = None,
    *,
    namespace: str | None = None,
    only=None,
    workers: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
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
    workers : int, optional
        Processes that share the work; by default as many as there are processors.
    progress : callable
        Called with what is finished, in words.

    Raises
    ------
    ConfigurationError
        The configuration holds several axes, or that of an inchworm, or the plants reach no common range; or
        ``only`` asks for a combination that the axis does not have.
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
    conditions.require_slow(axis.plant_simulator.sample_rate)
    if only is not None and conditions.draws:
        _require_known(only, names(axis))
    # what takes longest first
    jobs = [Job(_rows_on_other, (conditions.seed + i, conditions, only)) for i in range(conditions.others)]
    if conditions.draws:
        trial = trial_around(configuration, conditions)
        chosen = only if only is not None else names(trial.given.axis)
        compensators = dict.fromkeys(compensator for _, compensator in names(trial.given.axis))
        jobs += [Job(_rows_around, (trial, compensator, chosen)) for compensator in compensators]
        jobs.append(Job(_yardstick_around, (trial,)))
    found: dict[str, list] = {job.function.__name__: [] for job in jobs}
    with executor(workers, jobs=len(jobs)) as shared:
        for number, (words, result) in shared.results(jobs):
            progress(words)
            found[jobs[number].function.__name__].append(result)
    first = second = None
    if conditions.draws:
        first = table_around(axis, conditions, trial, sum(found["_rows_around"], []), found["_yardstick_around"][0])
    if conditions.others:
        second = table_of_others(conditions, found["_rows_on_other"])
    return Comparison(conditions, first, second, configuration)
