"""What a driver declares, so that parameters, the plant's node and the contract test know all of it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from hysteresis_ros.hardware.driver import Driver
from hysteresis_ros.parameters import Parameters


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
        that is named by its path has none.
    """

    name: str
    title: str
    parameters: type[Parameters]
    driver: type[Driver]
    emulator: Callable[[], AbstractContextManager[Parameters]] | None = None
