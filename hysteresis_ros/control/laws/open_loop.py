# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The simplest controller: it outputs the reference, or the command of the feedforward."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.law import (
    APPLIED,
    COMMAND,
    ESTIMATED,
    FED,
    FEEDFORWARD,
    HEADER,
    STARTED,
    Controller,
    ControllerLaw,
)
from hysteresis_ros.models.block import kernel


@kernel
def open_loop(p, x, reference, measured):
    """Return the feedforward's command, or the reference without feedforward; the estimate is the measurement."""
    command = x[FEEDFORWARD] if p[FED] != 0.0 else reference
    x[ESTIMATED] = measured
    x[STARTED] = 1.0
    x[COMMAND] = command
    x[APPLIED] = command
    return command


class OpenLoop(Controller):
    """Controller that outputs the reference, or the command of the feedforward."""

    kernel = staticmethod(open_loop)
    runs_beside = True

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array: whether there is a feedforward."""
        return np.array([parameters.feedforward.type != "none"], dtype=float)

    def initial_state(self) -> np.ndarray:
        """Return the state at rest: the common part only."""
        return np.zeros(HEADER)


CONTROLLER = ControllerLaw(
    name="open_loop",
    block=OpenLoop,
    description="passes on the reference, or the command of the feedforward",
    feedback=False,
)
