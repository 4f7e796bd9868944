# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A camera that takes a frame of a simulated tip at each sample, and delivers it some frames later."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.parameters import parameter
from hysteresis_ros.sensing.scene import Scene, SceneParameters


@dataclass(frozen=True)
class SimulatedCameraParameters(SceneParameters):
    """What a simulated camera sees, and how late."""

    delay: int = parameter(
        1, unit="frames", low=0, high=100, read_only=True, description="frames that pass until a frame arrives"
    )


class SimulatedCamera:
    """Takes frames of a simulated tip.

    Parameters
    ----------
    parameters : SimulatedCameraParameters
    sample_time : float
        Between two frames [s].
    """

    def __init__(self, parameters: SimulatedCameraParameters, sample_time: float):
        self._scene = Scene(parameters)
        self._sample_time = sample_time
        self.reset()

    def reset(self) -> None:
        """Begin again with the first frame."""
        self._number = 0
        self._way: deque[float] = deque(maxlen=self._scene.parameters.delay + 1)

    def take(self, displacement: float) -> np.ndarray:
        """Take a frame of the tip, and return the one that arrives now: before all others that of the first sample.

        Parameters
        ----------
        displacement : float
            Of the tip now [m].
        """
        self._way.append(displacement)
        number = self._number
        self._number += 1
        return self._scene.frame(self._way[0], number, number * self._sample_time)
