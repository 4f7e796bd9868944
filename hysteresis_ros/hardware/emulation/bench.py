# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What stands behind an emulated device, and what a running one says of itself."""

from __future__ import annotations

from dataclasses import dataclass, field

from hysteresis_ros.hardware.emulation.faults import DeviceFaults
from hysteresis_ros.hardware.emulation.plant import assumed_stage
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.parameters import Parameters

#: Time between two samples of an emulated device [s]: slower than a controller, so that Python keeps up beside an axis.
CYCLE = 2.0e-4


@dataclass(frozen=True)
class Bench:
    """The plant behind a device, and what goes wrong with that.

    Parameters
    ----------
    plant : ActuatorParameters
    cycle : float
        Time between two of its samples [s].
    faults : tuple of str
        As :class:`~hysteresis_ros.hardware.emulation.faults.DeviceFaults` takes them.
    """

    plant: ActuatorParameters = field(default_factory=lambda: assumed_stage(CYCLE))
    cycle: float = CYCLE
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Running:
    """A device that runs.

    Parameters
    ----------
    where : str
        What it is and where it is found.
    driver : Parameters
        With which its driver is opened.
    faults : DeviceFaults
        Faults may be added while it runs.
    device : object
        The device itself, to look at what it really does.
    """

    where: str
    driver: Parameters
    faults: DeviceFaults
    device: object = None
