# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An actuator that is seen by a camera: the plant that makes frames, and the part that makes displacements of them.

The plant measures nothing itself. Offline the part looks at each frame at once; between nodes the frames are messages.
Both run in Python: a frame takes a thousand times as long as a sample of anything else.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.block import interpreted
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.loop.node_parameters import DisplacementCameraNodeParameters
from hysteresis_ros.loop.plant import (
    PlantWatchArrays,
    actuate,
    actuate_actuator,
    no_joints,
    sense,
    sense_actuator,
    tell_joints,
)
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.loop.plants import ActuatorPlant
from hysteresis_ros.models.actuator import ActuatorArrays
from hysteresis_ros.sensing.simulated_camera import SimulatedCamera
from hysteresis_ros.sensing.tracker import CameraParameters, Tracker


class CameraPart:
    """Makes displacements of frames: ``displacement_camera`` as a part of the loop.

    Parameters
    ----------
    parameters : DisplacementCameraNodeParameters
    """

    def __init__(self, parameters: DisplacementCameraNodeParameters):
        self.parameters = parameters
        self.tracker = Tracker(part(parameters, CameraParameters))

    def retune(self, parameters: DisplacementCameraNodeParameters) -> None:
        """Take other limits of what is refused."""
        self.tracker.retune(part(parameters, CameraParameters))
        self.parameters = parameters

    def reset(self) -> None:
        """Begin again with the next frame; a relative place is homed again."""
        self.tracker.reset()

    def inject(self, faults: tuple[str, ...]) -> None:
        """Faults are those of the measurement, where the controller takes it."""


class Eye:
    """The camera of a plant, and who looks at its frames, if anybody does.

    Parameters
    ----------
    camera : SimulatedCamera
    """

    def __init__(self, camera: SimulatedCamera):
        self.camera = camera
        self.part: CameraPart | None = None
        self.frame: np.ndarray | None = None

    def look(self, displacement: float) -> float:
        """Take a frame of a displacement [m] and return what is seen in it [m]; NaN: somebody else looks at it."""
        self.frame = self.camera.take(displacement)
        return math.nan if self.part is None else self.part.tracker.see(self.frame)[0]


class SeenPlantArrays(NamedTuple):
    """All arrays of an actuator that is seen by a camera."""

    p: ActuatorArrays
    x: ActuatorArrays
    watch_p: PlantWatchArrays
    watch_x: PlantWatchArrays
    eye: Eye


_SENSE, _ACTUATE = interpreted(sense_actuator), interpreted(actuate_actuator)


def _sense_seen(laws, arrays, row):
    """Let the camera see the tip."""
    _SENSE(laws, arrays, row)
    row[at.MEASURED] = arrays.eye.look(float(row[at.DISPLACEMENT]))


def _actuate_seen(laws, arrays, row):
    """Hold the voltage on the actuator; the plant itself knows of no measurement."""
    seen, row[at.MEASURED] = row[at.MEASURED], math.nan
    _ACTUATE(laws, arrays, row)
    row[at.MEASURED] = seen


sense.kinds[SeenPlantArrays], actuate.kinds[SeenPlantArrays] = _sense_seen, _actuate_seen
tell_joints.kinds[SeenPlantArrays] = no_joints


class SeenPlant(ActuatorPlant):
    """One actuator that is seen by a camera.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type camera.
    """

    is_compiled = False

    def __init__(self, parameters: PlantNodeParameters):
        super().__init__(parameters)
        self.eye = Eye(SimulatedCamera(parameters.camera, 1.0 / parameters.sample_rate))
        self.arrays = SeenPlantArrays(*self.arrays, self.eye)

    @property
    def travel(self) -> tuple[float, float]:
        """Between which measurements [m] the axis may go on: the plant has none."""
        return -math.inf, math.inf

    def reset(self) -> None:
        """Begin again at rest, with the first frame."""
        super().reset()
        self.eye.camera.reset()
