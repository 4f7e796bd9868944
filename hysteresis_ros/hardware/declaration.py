# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a driver declares, so that parameters, the plant's node and the contract test know all of it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from hysteresis_ros.hardware.driver import Driver
from hysteresis_ros.parameters import Parameters
from hysteresis_ros.registry import resolved


@dataclass(frozen=True, eq=False)
class EmulatedDevice:
    """A device that runs by itself, for ``hysteresis emulate``: the driver, or a program of others, is its master.

    Parameters
    ----------
    parameters : type of Parameters
        Options of the command besides the plant and its faults.
    start : callable
        ``start(parameters, bench)``, with a :class:`hysteresis_ros.hardware.emulation.bench.Bench`, returns a context
        manager that gives the running device, a :class:`hysteresis_ros.hardware.emulation.bench.Running`.
    """

    parameters: type[Parameters]
    start: Callable[[Any, Any], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class HardwareDriver:
    """A driver: its name, class and parameters.

    Parameters
    ----------
    name : str
        ``driver`` of the plant's node.
    title : str
        A few words.
    parameters : type of Parameters
        What it is opened with: a group of the driver's name. One that wants nothing but what the plant's node has
        anyway names that class, for instance ``ActuatorParameters``, and has no group.
    driver : type of Driver
        Made without arguments.
    emulator : callable, optional
        ``emulator()`` returns a context manager that stands in for the device, or for its like, and gives the
        parameters to open it with: to try the driver without the device, and for the contract test. Only a library
        that is named by its path has none. :func:`hysteresis_ros.registry.later` imports its module only when it is
        called.
    device : EmulatedDevice or str, optional
        The like as a device of its own, or the dotted path ``package.module:DEVICE`` of it.
    package : str
        Module that it needs beyond those of the package, which the extra of the driver's name installs; '': none.
    """

    name: str
    title: str
    parameters: type[Parameters]
    driver: type[Driver]
    emulator: Callable[[], AbstractContextManager[Parameters]] | None = None
    device: EmulatedDevice | str | None = None
    package: str = ""

    @property
    def emulated(self) -> EmulatedDevice | None:
        """The device, imported where only its path is named."""
        return resolved(self.device) if isinstance(self.device, str) else self.device
