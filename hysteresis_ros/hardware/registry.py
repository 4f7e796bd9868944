"""The drivers there are: those of the folder ``drivers`` and those that other packages add by an entry point."""

from __future__ import annotations

import hysteresis_ros.hardware.drivers  # noqa: F401  (its folder is searched)
from hysteresis_ros.hardware.declaration import HardwareDriver
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a driver: ``my_stage = my_package.my_stage:DRIVER``.
GROUP = "hysteresis_ros.drivers"

#: What each driver declares, by name.
DRIVERS: dict[str, HardwareDriver] = discover("hysteresis_ros.hardware.drivers", "DRIVER", HardwareDriver, GROUP)
