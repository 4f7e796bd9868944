# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The drivers there are: those of the folder ``drivers`` and those that other packages add by an entry point."""

from __future__ import annotations

import hysteresis_ros.hardware.drivers  # noqa: F401  (its folder is searched)
from hysteresis_ros.hardware.declaration import HardwareDriver
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a driver: ``my_stage = my_package.my_stage:DRIVER``.
GROUP = "hysteresis_ros.drivers"

#: What each driver declares, by name.
DRIVERS: dict[str, HardwareDriver] = discover("hysteresis_ros.hardware.drivers", "DRIVER", HardwareDriver, GROUP)
