# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What made a recording: the versions of software and the machine, as words that go into the bag."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
import time

#: Name of the words in a bag (a metadata record of MCAP).
RECORD = "hysteresis_ros"

#: What decides the bits of a run, or how it was recorded.
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "rosbags", "mcap")

#: What ROS is told by its environment.
_VARIABLES = ("ROS_DISTRO", "RMW_IMPLEMENTATION")


def provenance() -> dict[str, str]:
    """Return versions, machine and time by name."""
    words = {
        "hysteresis_ros": sys.modules[__name__.partition(".")[0]].__version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "machine": platform.machine(),
        "recorded": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    for name in _PACKAGES:
        try:
            words[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return words | {name: os.environ[name] for name in _VARIABLES if name in os.environ}
