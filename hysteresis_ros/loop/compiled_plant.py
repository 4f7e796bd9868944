# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A device in the plant's place that machine code reads and writes, and the plant of a loop that machine code runs."""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.library import nonsense
from hysteresis_ros.loop.device import (
    ANSWERS,
    CODE,
    FAILED,
    NONSENSE,
    READING,
    SAFE_CODE,
    DevicePlantArrays,
    link_to,
)
from hysteresis_ros.loop.driven import DrivenPlant
from hysteresis_ros.loop.node_parameters import PlantNodeParameters
from hysteresis_ros.loop.plant import (
    DEVICE_FAILED,
    TRIP,
    Plant,
)
from hysteresis_ros.loop.plant_types import PLANTS
from hysteresis_ros.models.limits import limits


class CompiledPlant(DrivenPlant):
    """One actuator that is a device, read and written by machine code.

    Parameters
    ----------
    parameters : PlantNodeParameters
        With a driver that has a compiled form.
    linked : bool
        Whether there is a device. A twin of a recorded run has none: it is given what the device answered.

    Raises
    ------
    DriverError
        The device cannot be opened, is not what the axis needs, or only Python reaches it.
    """

    # places where others have the law of a simulated plant
    kernels = (limits,) * 3

    given = (at.MEASURED, at.TRIPPED, at.FORCE)

    rounding, begins_safe = 0.0, True

    def __init__(self, parameters: PlantNodeParameters, linked: bool = True):
        self._linked = linked
        super().__init__(parameters)
        compiled = joints = None
        if linked:
            compiled, joints = self._device.compiled(), self.capabilities
            if compiled is None:
                self.close()
                problem = "is written in Python, which would wait for its lock in each sample"
                remedy = "run the axis without --fused, or give the driver a compiled form (docs/hardware.md)"
                raise DriverError(f"driver {parameters.driver}:", problem, remedy)
        sizes = (joints.joints + joints.forces, joints.voltages) if joints is not None else (1, 1)
        self.arrays = DevicePlantArrays(
            link_to(compiled),
            np.zeros(ANSWERS, dtype=np.int64),
            *map(np.zeros, sizes),
            self.limits.p,
            self.limits.x,
            self.sensor.p,
            self.sensor.x,
            self.amplifier.p,
            self._watch_p,
            self._watch_x,
        )
        self.reset()

    def _open(self, parameters: PlantNodeParameters) -> None:
        if self._linked:
            super()._open(parameters)

    @property
    def _range(self) -> tuple[float, float]:
        return super()._range if self._linked else (-math.inf, math.inf)

    @property
    def failure(self) -> str:
        """What is wrong with a device that has stopped the axis."""
        if self._watch_x.trip[TRIP] != DEVICE_FAILED or self._failure or not self._linked:
            return self._failure
        failed, code, safe_code = (int(self.arrays.answer[place]) for place in (FAILED, CODE, SAFE_CODE))
        explain = self._device.compiled().explain
        what = "written" if failed not in (READING, NONSENSE) else "read"
        error = nonsense(self.parameters.driver) if failed == NONSENSE else explain(code)
        text = f"driver {self.parameters.driver}: cannot be {what}: {error}"
        if not safe_code:
            return text
        left = f"the output is still at {self.arrays.voltages[0]:.6g} {self.capabilities.voltage_unit}"
        return f"{text}; and it cannot be made safe: {explain(safe_code).problem}: {left}"

    def make_safe(self) -> None:
        """Bring the device to its safe state.

        Raises
        ------
        DriverError
            It does not answer.
        """
        if self._linked:
            self._device.note(float(self.arrays.voltages[0]))
            super().make_safe()

    def close(self) -> str:
        """Let go of the device; return what is wrong with it as it is left, empty when nothing is."""
        return super().close() if self._linked else ""


def fused_plant_of(parameters: PlantNodeParameters, linked: bool = True) -> Plant:
    """Return the plant of an axis that machine code runs: the device of its driver, or the simulated one of its type.

    Parameters
    ----------
    parameters : PlantNodeParameters
    linked : bool
        Whether a device is opened; without it the plant is given what the device answered.

    Raises
    ------
    DriverError
        The device cannot be opened, is not what the axis needs, or only Python reaches it.
    """
    if not parameters.driver:
        return PLANTS[parameters.type](parameters)
    return CompiledPlant(parameters, linked)
