# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Gains of any controller from the model in its own parameters, for a bandwidth that is asked.

Every law declares the designs it has (:mod:`hysteresis_ros.control.law`); here is what they share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control import design
from hysteresis_ros.control.law import DesignTask
from hysteresis_ros.control.linearisation import linear_loop, margins
from hysteresis_ros.control.margins import AIMED, Margins, Requirements
from hysteresis_ros.control.registry import design_of
from hysteresis_ros.control.uncertainty import PossiblePlant
from hysteresis_ros.errors import ParameterError


@dataclass(frozen=True, eq=False)
class Designed:
    """A design: parameters with gains, and what they are worth on the model.

    Parameters
    ----------
    parameters : ControllerParameters
    margins : Margins
    """

    parameters: object
    margins: Margins


def require_minimal(dynamics) -> None:
    """Refuse a model with a state that the input does not move or the output does not show.

    Parameters
    ----------
    dynamics : LinearParameters

    Raises
    ------
    ParameterError
        ``model.dynamics.B`` (uncontrollable), ``model.dynamics.C`` (unobservable) or ``model.dynamics.A`` (unstable).
    """
    problems = [replace(problem, name=f"model.dynamics.{problem.name}") for problem in dynamics.check()]
    if problems:
        raise ParameterError(problems)
    model = dynamics.state_space
    A, B, C = model.A, model.B, model.C
    for value in model.poles:
        text = f"(pole {value:.6g}); identify a model of lower order, or cancel that pole"
        if not design.full_rank(np.hstack([A - value * np.eye(len(A)), B]).T):
            design.refuse("model.dynamics.B", dynamics.B, f"the model is not controllable {text}")
        if not design.full_rank(np.vstack([A - value * np.eye(len(A)), C])):
            design.refuse("model.dynamics.C", dynamics.C, f"the model is not observable {text}")


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
    """Return the controller of the given name for the model in ``parameters``, or for the damped plant.

    Parameters
    ----------
    parameters : ControllerParameters
        Its model is used; what the design does not decide is kept.
    controller : str
        Name of a design, see :data:`hysteresis_ros.control.registry.DESIGNS`.
    sample_time : float
        [s]
    bandwidth : float, optional
        Frequency at which the response to the reference, without feedforward, falls by 3 dB [Hz].
    q : float, optional
        Variance of the input's noise over that of the measurement in the Kalman filter.
    aimed : Requirements, optional
        What a design is to meet, where neither bandwidth nor q leave it no choice.
    plants : tuple of PossiblePlant, optional
        On which it is to meet that, the model first, each with the damping around it; by default the model alone.

    Raises
    ------
    ConfigurationError
        There is no design of that name.
    ParameterError
        The model is unstable, not observable or not controllable, or the bandwidth cannot be reached.
    """
    law, designed = design_of(controller)
    own = parameters.before_damping(sample_time)
    dynamics = own.model.dynamics
    require_minimal(dynamics)
    dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    if bandwidth is not None and not 0.0 < bandwidth < 0.5 / sample_time:
        design.refuse(
            "bandwidth", bandwidth, f"must be above 0 and below half the sample rate, {0.5 / sample_time:g} Hz"
        )
    chosen = replace(own, type=law.name)
    task = DesignTask(chosen, sample_time, bandwidth, q, lambda one: linear_loop(one, sample_time), aimed, plants)
    found = replace(designed(task), model=parameters.model, damping=parameters.damping)
    return Designed(found, margins(found, sample_time))
