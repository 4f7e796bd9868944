# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a page shows of an inchworm motor beside its signals over time, and what it may ask of it."""

from __future__ import annotations

import math

from hysteresis_ros import signals
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.watch.memory import Memory
from hysteresis_ros.references.inchworm_layout import ERROR_NAMES, PHASE_NAMES

#: Signals whose last values are told in figures.
TOLD = (
    "phase",
    "direction",
    "speed",
    "arrived",
    "error",
    "steps",
    "total_steps",
    "missed",
    "step_commanded",
    "step_achieved",
    "slip",
    "load_deflection",
    "forward_gain",
    "backward_gain",
)


def about(axis: AxisParameters) -> dict | None:
    """Return what of a motor stays as it is, None where the axis is none.

    Parameters
    ----------
    axis : AxisParameters
    """
    sequencer = axis.inchworm_sequencer
    if sequencer is None:
        return None
    gait, walk = sequencer.gait, sequencer.walk
    fastest = max(gait.speed, walk.fastest(gait)) if walk.continuous else gait.speed
    return {
        "phases": [name.replace("_", " ") for name in PHASE_NAMES],
        "errors": [name.replace("_", " ") for name in ERROR_NAMES],
        "fastest": fastest,
        "learns": walk.continuous,
    }


def told(memory: Memory) -> dict[str, float | None] | None:
    """Return the last values of :data:`TOLD`, SI, None for what nobody knows; None where the axis is no motor.

    Parameters
    ----------
    memory : Memory
    """
    if not memory.motor:
        return None
    values = {name: memory.value(signals.place(name)) for name in TOLD}
    return {name: value if math.isfinite(value) else None for name, value in values.items()}
