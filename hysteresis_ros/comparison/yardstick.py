# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The yardstick: a PI with static feedforward whose gains are tuned on the very plant, as no candidate's may be."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from hysteresis_ros.comparison.candidates import Candidate
from hysteresis_ros.comparison.judging import Followed, best_delay, judged
from hysteresis_ros.comparison.plants import DrawnPlant
from hysteresis_ros.comparison.rows import Row, Trial, run
from hysteresis_ros.comparison.tasks import Task
from hysteresis_ros.compensation.inverses import InverseParameters
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.control.law import UNFED
from hysteresis_ros.control.laws.pid.law import PidParameters
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.models.linear import LinearParameters

#: Its names in the tables.
CONTROLLER, COMPENSATOR = "PI + static feedforward, tuned on the plant", "none"
#: Crossovers [Hz] and proportional gains with which the search begins, its iterations and the tolerance of its simplex.
CROSSOVERS, PROPORTIONAL = (1.0, 3.0, 10.0, 30.0, 100.0), (0.0, 0.5, 2.0)
ITERATIONS, TOLERANCE = 30, 1e-2
#: What counts as a large change of the logarithm of Ki, and of Kp.
SCALES = (3.0, 1.0)
#: A controller refuses gains that its own model does not bear. Here the plant itself judges: none are refused.
SLOW = LinearParameters(A=(0.9,), B=(0.1,), C=(1.0,))
#: The factor by which gains may grow: 6 dB.
GAIN_MARGIN = 2.0


def yardstick(trial: Trial) -> Row:
    """Return the row of the yardstick: tuned on the first of the plants by what the table ranks, run on all of them.

    Parameters
    ----------
    trial : Trial
    """
    gains = _tuned(trial)
    found = Candidate(CONTROLLER, COMPENSATOR, {f"pid.{name}": value for name, value in gains.to_mapping().items()})
    runs = {}
    for task in trial.tasks:
        axis = _axis(trial, gains, task)
        runs[task] = [run(axis, plant, task) for plant in trial.plants]
    return trial.judged(Row(CONTROLLER, COMPENSATOR, candidate=found), runs)


def _axis(trial: Trial, gains: PidParameters, task: Task) -> AxisParameters:
    """Return the axis with a PI and static feedforward, V = command / gain."""
    plain = trial.given.designed(Candidate("", "", dict(UNFED)), task)
    fed, model = FeedforwardParameters(type="static"), replace(plain.motion_controller.model, dynamics=SLOW)
    node = replace(plain.motion_controller, type="pid", pid=gains, model=model, feedforward=fed)
    compensator = replace(plain.hysteresis_compensator, inverse=InverseParameters(type="none"))
    return replace(plain, motion_controller=node, hysteresis_compensator=compensator)


def _tuned(trial: Trial) -> PidParameters:
    """Return the gains with the least score on the first plant among those with the margins of a candidate there.

    They may grow by 6 dB, and bear one sample of delay more.
    """
    plant, axes = trial.plants[0], {task: _axis(trial, PidParameters(), task) for task in trial.tasks}
    late, fastest = plant.later(), max(trial.tasks, key=lambda task: task.frequency)

    def followed(gains: PidParameters, plant: DrawnPlant = plant, task: Task = fastest) -> Followed:
        node = replace(axes[task].motion_controller, pid=gains)
        return run(replace(axes[task], motion_controller=node), plant, task)

    def gains(values, factor: float = 1.0) -> PidParameters:
        return PidParameters(Kp=factor * float(values[1]), Ki=factor * float(np.exp(values[0])))

    def cost(values) -> float:
        if values[1] < 0.0:
            return np.inf
        try:
            if followed(gains(values, GAIN_MARGIN)).unstable or followed(gains(values), late).unstable:
                return np.inf
            runs = {task: [followed(gains(values), task=task)] for task in trial.tasks}
        except ParameterError:  # beyond what a PI does on any plant
            return np.inf
        results = judged(runs, best_delay(runs, trial.conditions.longest_delay), trial.stroke)
        return float(np.mean([np.log(result.worst) for result in results.values()]))

    starts = [np.array([np.log(2.0 * np.pi * f), Kp]) for f, Kp in itertools.product(CROSSOVERS, PROPORTIONAL)]
    settings = SimplexSettings(iterations=ITERATIONS, tolerance=TOLERANCE)
    return gains(restarted_nelder_mead(cost, min(starts, key=cost), scale=SCALES, settings=settings).x)
