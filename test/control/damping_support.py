# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of damping."""

from __future__ import annotations

import math

from hysteresis_ros.control.controller import ControllerParameters, ModelParameters
from hysteresis_ros.control.damping.inner_loop import DampingParameters
from hysteresis_ros.models.linear import LinearParameters, zero_order_hold
from hysteresis_ros.models.sensor import ForceParameters

#: A stage of 700 Hz and 1 % damping at 20 kHz with one sample of delay; its output is in µm, with 2 µm/V.
T, OMEGA, DAMPING = 5e-5, 2.0 * math.pi * 700.0, 0.01


def stage(delay: float = T, frequency: float = 700.0, sample_time: float = T) -> LinearParameters:
    omega = 2.0 * math.pi * frequency
    A, B = zero_order_hold(
        [[0.0, 1.0], [-omega * omega, -2.0 * DAMPING * omega]], [[0.0], [omega * omega]], sample_time
    )
    return LinearParameters(
        A=tuple(A.ravel().tolist()),
        B=tuple(B[:, 0].tolist()),
        C=(2.0, 0.0),
        output_scale=1e-6,
        sample_time=sample_time,
        delay=delay,
    )


#: A stack ten times as stiff as the flexure that it moves, and a force sensor with a high-pass of 3 Hz.
FORCE = ForceParameters(stack_stiffness=2e7, flexure_stiffness=2e6, high_pass=3.0)


CHOSEN = {
    "irc": {"k": 2000.0, "feedthrough": -2.5},
    "ppf": {"frequencies": (900.0, 3000.0), "damping": (0.4, 0.7), "gains": (0.2, 0.1)},
    "iff": {"gain": 3e-5, "leak": 900.0, "high_pass": 600.0},
    "notch": {"frequencies": (700.0, 2100.0), "damping": (0.01, 0.1), "width": (0.5, 0.4)},
}


def damping(kind: str, **changes) -> DampingParameters:
    values = {f"{kind}.{name}": value for name, value in (CHOSEN[kind] | changes).items()}
    return DampingParameters.from_mapping({"type": kind, **values})


def controller(
    kind: str | None = None, dynamics: LinearParameters | None = None, force=FORCE, **changes
) -> ControllerParameters:
    chosen = DampingParameters() if kind is None else damping(kind, **changes)
    model = ModelParameters(dynamics=dynamics or stage(), force=force)
    return ControllerParameters(type="open_loop", model=model, damping=chosen)
