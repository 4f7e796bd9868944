# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Under which conditions a campaign ran."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
from dataclasses import dataclass

import hysteresis_ros


@dataclass(frozen=True)
class Conditions:
    """What a reader of figures must know.

    Parameters
    ----------
    date : str
    machine : str
        System, processors, versions.
    load : float
        Processes that want to run, mean of a minute.
    transports : str
        Of DDS, as the environment says.
    """

    date: str
    machine: str
    load: float
    transports: str


def conditions() -> Conditions:
    """Return the conditions of now."""
    words = [
        f"{platform.system()} {platform.release()}",
        f"{os.cpu_count()} cores",
        f"Python {platform.python_version()}",
        f"hysteresis_ros {hysteresis_ros.__version__}",
    ]
    for name in ("numba", "ros-jazzy-rclpy"):
        try:
            words.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    now = datetime.datetime.now(datetime.UTC)
    transports = os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "the default ones")
    return Conditions(f"{now:%Y-%m-%d %H:%M} UTC", ", ".join(words), os.getloadavg()[0], transports)
