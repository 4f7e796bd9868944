# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The comparison of Auwal et al. 2017 (section 5, B6): integral of the absolute error of PID and inverse."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.controller import ControllerParameters, controller_block
from hysteresis_ros.control.linearisation import margins
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings, restarted_nelder_mead
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.papers.auwal2017 import axis as auwal
from hysteresis_ros.papers.claims import Claim
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.tuning import criterion_of

ASSUMED = (auwal.TRIANGLE, auwal.SAMPLED, auwal.CORRECTED, auwal.UNLIMITED)
#: Assumptions that one way of driving adds.
FURTHER = {"none": (auwal.GAIN,), "pid": (auwal.FILTERED,), "combined": (auwal.FILTERED,)}


@dataclass(frozen=True, eq=False)
class Tuning:
    """PID gains found by Nelder-Mead from the paper's initial guess.

    Parameters
    ----------
    trajectory : ndarray, shape (iterations + 1, 3)
        K_P, K_I and K_D after each iteration, model units.
    costs : ndarray, shape (iterations + 1,)
        IAE after each iteration [m s].
    published : float
        IAE with the paper's gains [m s].
    published_peak, peak : float
        Sensitivity peaks on G2 of the paper's gains and of those found.
    """

    trajectory: np.ndarray
    costs: np.ndarray
    published: float
    published_peak: float
    peak: float


def tune(configuration: Configuration, iterations: int = auwal.TUNING_ITERATIONS) -> Tuning:
    """Tune the PID on the paper's triangle and the paper's plant, offline as the paper does.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    iterations : int
        Of the simplex.
    """
    parameters = single_axis(auwal.driven(auwal.at_rate(configuration, auwal.SLOW_RATE), "pid"))
    control = part(parameters.motion_controller, ControllerParameters)
    axis = Axis(parameters)
    setpoints = np.zeros(axis.default_samples())
    sample_time = 1.0 / axis.sample_rate

    def with_gains(gains) -> ControllerParameters:
        Kp, Ki, Kd = (float(gain) for gain in gains)
        return replace(control, pid=replace(control.pid, Kp=Kp, Ki=Ki, Kd=Kd))

    def cost(gains) -> float:
        try:
            axis.controller.install(controller_block(with_gains(gains), sample_time))
        except ParameterError:
            return np.inf  # not stable
        axis.reset()
        signals = axis.run(setpoints)
        return criterion_of("iae", signals["reference"] - signals["displacement"], sample_time)

    run = restarted_nelder_mead(
        cost, auwal.PID_GUESS, settings=SimplexSettings(iterations=iterations, tolerance=1e-6)
    ).runs[0]
    peaks = (
        margins(with_gains(gains), sample_time).sensitivity_peak for gains in (auwal.PID_GAINS, run.trajectory[-1])
    )
    return Tuning(run.trajectory, run.costs, cost(auwal.PID_GAINS), *peaks)


def tuning_claims(found: Tuning) -> list[Claim]:
    """Return the rows of the PID's tuning.

    Parameters
    ----------
    found : Tuning
        What :func:`tune` returns.
    """
    group = "Tuning of the PID by Nelder-Mead (section 4.1, table III)"
    assumed = (auwal.TRIANGLE, auwal.CORRECTED, auwal.UNLIMITED, auwal.FILTERED, "sampled at 100 Hz for the tuning")
    gains = ", ".join(f"{value:.4g}" for value in found.trajectory[-1])
    return [
        Claim(
            "tuning.guess",
            group,
            "IAE with the paper's initial guess",
            float(found.costs[0]),
            "m*s",
            assumptions=assumed,
        ),
        Claim(
            "tuning.published",
            group,
            "IAE with the paper's gains: less than with the guess",
            found.published,
            "m*s",
            paper=auwal.IAE["pid"],
            high=float(found.costs[0]),
            assumptions=assumed,
        ),
        Claim(
            "tuning.found",
            group,
            f"IAE after {auwal.TUNING_ITERATIONS} iterations from the paper's guess",
            float(found.costs[-1]),
            "m*s",
            paper=auwal.IAE["pid"],
            high=found.published,
            assumptions=assumed,
            reason=f"gains found here {gains}: without noise, limits or delay little stops the simplex short of the "
            "edge of stability, so the paper's gains are not the optimum of the paper's criterion",
        ),
        Claim(
            "tuning.published.peak",
            group,
            "sensitivity peak with the paper's gains",
            found.published_peak,
            "1",
            assumptions=assumed,
        ),
        Claim(
            "tuning.found.peak", group, "sensitivity peak with the gains found", found.peak, "1", assumptions=assumed
        ),
    ]


def paper_runs(configuration: Configuration) -> dict[str, Recording]:
    """Return the paper's triangle driven by each of its three ways, and by inverse, PID and feedforward together."""
    ways = ("none", "pid", "inverse", "combined")
    return {method: auwal.run_triangle(auwal.driven(configuration, method)) for method in ways}


def comparison_claims(runs: dict[str, Recording]) -> list[Claim]:
    """Return the rows of the paper's table of integrals of the absolute error, and of what beats them.

    Parameters
    ----------
    runs : dict of str to Recording
        What :func:`paper_runs` returns.
    """
    group = "Hysteresis minimisation (section 5, last table)"
    found = {method: auwal.iae(run) for method, run in runs.items()}
    claims = []
    for method, published in auwal.IAE.items():
        band = dict(low=0.99 * published, high=1.01 * published)
        words = f"{auwal.METHODS[method]}: IAE"
        assumed = (*ASSUMED, *FURTHER.get(method, ()))
        claims.append(
            Claim(f"iae.{method}", group, words, found[method], "m*s", paper=published, assumptions=assumed, **band)
        )
    for method, published in auwal.REDUCTION.items():
        band = dict(low=published - 0.1, high=published + 0.1)
        words = f"{auwal.METHODS[method]}: less IAE than without"
        value = auwal.reduction(found[method], found["none"])
        assumed = (*ASSUMED, *FURTHER.get(method, ()))
        claims.append(
            Claim(f"reduction.{method}", group, words, value, "%", paper=published, assumptions=assumed, **band)
        )
    for method in ("pid", "inverse"):
        claims.append(
            Claim(
                f"voltage.{method}",
                group,
                f"{auwal.METHODS[method]}: lowest voltage",
                float(np.min(runs[method]["voltage"])),
                "V",
                paper=-24.0,
                derived=True,
                low=-25.0,
                high=-23.5,
                assumptions=(*ASSUMED, *FURTHER.get(method, ())),
                reason="the stack's data sheet allows 0 … 150 V: the paper's figures need a voltage it must not have",
            )
        )
        highest = float(np.max(runs[method]["voltage"]))
        words = f"{auwal.METHODS[method]}: highest voltage"
        claims.append(Claim(f"voltage.{method}.highest", group, words, highest, "V", assumptions=ASSUMED))
    better = min(found["pid"], found["inverse"])
    claims.append(
        Claim(
            "iae.combined",
            group,
            f"{auwal.METHODS['combined']}: IAE",
            found["combined"],
            "m*s",
            high=better,
            assumptions=(*ASSUMED, *FURTHER["combined"]),
            reason="the tolerance is the better of the paper's two; the inverse makes the plant linear, the reference "
            "itself is the feedforward, and the paper's PID has only the lag left to remove",
        )
    )
    return claims
