# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gains of the sliding mode controllers from a model, for a bandwidth that is asked."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hysteresis_ros.control import design
from hysteresis_ros.control.law import DesignTask
from hysteresis_ros.control.margins import judge
from hysteresis_ros.control.sliding_design import design_sliding_mode
from hysteresis_ros.control.sliding_search import FASTEST_FILTER, SLOWEST_FILTER, GainSearch, solved, wandering
from hysteresis_ros.linear_algebra import eigenvalues, product

#: Input weight of the LQ problem as a part of the squared DC gain.
INPUT_WEIGHT = 0.025
#: Largest pole that sets a bandwidth, and how closely the bandwidth is met.
SLOWEST = 0.99999
PRECISION = 1e-5
#: Part of the bandwidth asked by which the slowest pole may be too fast.
TOLERANCE = 0.01


def sliding_gains(task: DesignTask, name: str, place: Callable[[Any, float], Any] | None, disturbed: bool = True):
    """Return the parameters of a sliding mode controller with an LQ hyperplane.

    Parameters
    ----------
    task : DesignTask
    name : str
        Of the design, for messages.
    place : callable or None
        ``place(parameters, pole)`` returns them with the pole that sets the bandwidth; None where there is none.
    disturbed : bool
        Whether the Kalman filter is to estimate a disturbance.

    Raises
    ------
    ParameterError
        The model has no state, or the bandwidth cannot be reached.
    """
    given, dynamics = task.parameters, task.parameters.model.dynamics
    if not dynamics.order:
        design.refuse("model.dynamics.A", dynamics.A, f"{name} needs a model with a state; choose pid")
    found = replace(given, sliding_mode=lq_surface(given.sliding_mode, dynamics))
    kept = given.kalman.disturbance if given.kalman.disturbance != "none" else "constant"
    disturbance = kept if disturbed else "none"
    fixed = replace(found, kalman=_kalman(given.kalman, disturbance, task.q))
    if task.bandwidth is not None and place is not None:
        pole = _pole_for(task, partial(place, solved(fixed, task.sample_time)))
        fixed, found, place = place(fixed, pole), place(found, pole), None
    if task.q is not None or fixed.kalman.gain == "given":
        search = GainSearch(fixed, task.sample_time, task.judge, place, task.aimed)
        point = search.best((0.0, 0.0))
        if task.q is not None or search.score(point)[0]:
            return search.at(*point)
    noise = math.sqrt(given.kalman.r) or 1.0
    kalman = wandering(replace(given.kalman, r=noise * noise), disturbance, noise / abs(dynamics.matrices.dc_gain))
    search = GainSearch(replace(found, kalman=kalman), task.sample_time, task.judge, place, task.aimed)
    return search.at(*search.best((SLOWEST_FILTER, FASTEST_FILTER)))


def lq_surface(given, dynamics):
    """Return the parameters with the hyperplane of an LQ problem on output and input.

    Parameters
    ----------
    given : SlidingModeParameters
    dynamics : LinearDynamics
    """
    gain = dynamics.matrices.dc_gain
    empty: dict[str, Any] = {name: () for name in ("S", "poles", "poles_imaginary", "lq_state_weight")}
    return replace(given, tracking="target", hyperplane="lq", lq_input_weight=INPUT_WEIGHT * gain * gain, **empty)


def _kalman(given, disturbance: str, q: float | None):
    """Return the filter: a given gain only survives where it fits and no q is asked."""
    if given.gain == "given" and disturbance == given.disturbance and q is None:
        return given
    noise = given.q if q is None else q * given.r
    Q = given.Q if q is None else ()
    return replace(given, gain="riccati", L=(), disturbance=disturbance, q=noise, Q=Q)


def reaching_law(parameters, pole: float):
    """Return the parameters with Φ of the reaching law.

    Parameters
    ----------
    parameters : ControllerParameters
    pole : float
    """
    return replace(parameters, sliding_mode=replace(parameters.sliding_mode, phi=pole))


def sliding_pole(parameters, pole: float):
    """Return the parameters with the sliding motion's slowest pole; its others are the fastest of the LQ problem.

    Parameters
    ----------
    parameters : ControllerParameters
    pole : float
    """
    model = parameters.model.dynamics.state_space
    n, A, B = model.order, model.A, model.B
    S = design_sliding_mode(parameters.sliding_mode, model).S
    sliding = eigenvalues(A - product(B, product(S, A)[np.newaxis]) / product(S, B).item())
    sizes = sorted(math.sqrt(pole.real * pole.real + pole.imag * pole.imag) for pole in sliding)
    fastest = sizes[1 : n - 1]  # without the pole at 0 that is not of the sliding motion
    poles = (pole, *fastest)
    chosen = replace(parameters.sliding_mode, hyperplane="poles", S=(), poles=poles, poles_imaginary=())
    return replace(parameters, sliding_mode=chosen)


def _pole_for(task: DesignTask, with_pole) -> float:
    """Return the pole that gives the bandwidth, which grows as the pole goes from one to zero."""
    bandwidth = task.bandwidth

    def reached(pole):
        return judge(*task.loop(with_pole(pole)), task.sample_time).bandwidth

    fast, slow = 0.0, SLOWEST
    if not bandwidth <= reached(fast):
        design.refuse("bandwidth", bandwidth, f"this controller reaches at most {reached(fast):.4g} Hz on its model")
    least = reached(slow)
    if bandwidth < least * (1.0 - TOLERANCE):
        allowed = (
            f"this controller reaches no less than {least:.4g} Hz on its model: inside the boundary layer eta and "
            "beta/delta add to the reaching law; lower them, or ask for more"
        )
        design.refuse("bandwidth", bandwidth, allowed)
    while slow - fast > PRECISION * (1.0 - slow):
        middle = 0.5 * (fast + slow)
        if reached(middle) < bandwidth:
            slow = middle
        else:
            fast = middle
    return fast


def surface_row(found) -> tuple[str, str]:
    """Return name and text of the hyperplane, for the table of a design.

    Parameters
    ----------
    found : SlidingModeDesign
    """
    return "hyperplane S", ", ".join(f"{value:.6g}" for value in found.S)


def filter_row(parameters) -> tuple[str, str]:
    """Return name and text of the Kalman filter, for the table of a design.

    Parameters
    ----------
    parameters : ControllerParameters
    """
    kalman = parameters.kalman
    return "Kalman filter", f"q/r {kalman.q / kalman.r:.4g}" if not kalman.L else "given L"


def reaching_rows(parameters, sample_time: float):
    """Return (name, text) of what a design by Φ of the reaching law prints.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    """
    law = parameters.sliding_mode
    found = design_sliding_mode(law, parameters.model.dynamics.state_space)
    gains = ", ".join(f"{value:.6g}" for value in found.K)
    return [surface_row(found), ("linear gain K", gains), ("phi", f"{law.phi:.6g}"), filter_row(parameters)]


def integration_warning(parameters, prefix: str) -> tuple[str, ...]:
    """Return the doubt about a law that integrates what the Kalman filter's model does not explain.

    Parameters
    ----------
    parameters : ControllerParameters
    prefix : str
        Put before the names of the parameters.
    """
    if parameters.kalman.disturbance != "none":
        return ()
    return (
        f"{prefix}kalman.disturbance = none: a disturbance shows to {parameters.type} only through the innovation, "
        "and a part of it stays; choose constant",
    )
