# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""PID: what it declares. Its law is in :mod:`~hysteresis_ros.control.laws.pid.law`, its design beside that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.control.closed_loop import plant_state_space
from hysteresis_ros.control.law import ControllerLaw, DesignTask, Tuning
from hysteresis_ros.control.laws.pid.design import design_pid, slowest_poles
from hysteresis_ros.control.laws.pid.law import Pid, PidParameters, pid_state_space, require_stable_pid

#: A cancelled pole pair with less damping than this goes on ringing when something else than the reference excites it.
LITTLE_DAMPING = 0.1


def designed(task: DesignTask):
    """Return the parameters with the gains of :func:`~hysteresis_ros.control.laws.pid.design.design_pid`.

    Parameters
    ----------
    task : DesignTask
    """
    given = task.parameters
    dynamics, T = given.model.dynamics, task.sample_time
    gains = design_pid(given.pid, dynamics, T, task.bandwidth, plants=task.plants, aimed=task.aimed)
    return replace(given, pid=gains)


def near_rest(parameters):
    """Return the parameters without limits of the controller's own.

    Parameters
    ----------
    parameters : ControllerParameters
    """
    return replace(parameters, pid=replace(parameters.pid, output_minimum=0.0, output_maximum=0.0))


def rows(parameters, sample_time: float):
    """Yield (name, text) of what a design prints.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    """
    gains = parameters.pid
    yield "Kp, Ki, Kd", f"{gains.Kp:.6g}, {gains.Ki:.6g} 1/s, {gains.Kd:.6g} s"
    if gains.Kd:
        yield "derivative filter", f"{gains.derivative_filter:.6g} rad/s"


def doubts(parameters, sample_time: float, tuned: bool):
    """Yield that cancelled poles of little damping are not damped.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    tuned : bool
        Whether gains were tuned after the design, which cancel nothing any more.
    """
    pole = slowest_poles(parameters.model.dynamics.state_space)[0]
    logarithm = np.log(pole) if abs(pole) > 0.0 else -np.inf
    damping = -np.real(logarithm) / abs(logarithm) if np.isfinite(logarithm) else 1.0
    if damping < LITTLE_DAMPING and not tuned:
        hertz = abs(logarithm) / (2.0 * np.pi * sample_time)
        yield (
            f"the pid cancels poles at {hertz:.4g} Hz with damping {damping:.2g}: the reference does not excite "
            "them, but nothing damps them; offset_free does"
        )


def started(parameters, sample_time: float):
    """Return the parameters with which a tuning begins: lambda tuning.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    """
    return replace(parameters, pid=design_pid(parameters.pid, parameters.model.dynamics, sample_time))


def loop(parameters, sample_time: float):
    """Return controller and model in the model's units.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    """
    return pid_state_space(parameters.pid, sample_time), plant_state_space(parameters.model.dynamics, scaled=False)


CONTROLLER = ControllerLaw(
    name="pid",
    block=Pid,
    description="PID with derivative filter, setpoint weights and anti-windup",
    groups={"pid": PidParameters},
    check=require_stable_pid,
    near_rest=near_rest,
    designs={"pid": designed},
    rows=rows,
    doubts=doubts,
    tuning=Tuning(("Kp", "Ki", "Kd"), started, loop),
)
