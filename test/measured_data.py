# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Measured and benchmark recordings, which are not part of the project.

The recordings are in the folder HYSTERESIS_DATA, or else in ../shared/data beside the repository.
"""

from __future__ import annotations

import os
import pathlib

import pytest

DATA = pathlib.Path(os.environ.get("HYSTERESIS_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))


def measured_data(name: str) -> pathlib.Path:
    """Return the path of a file or folder of the data; if it does not exist, the test is skipped with a message."""
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no {name} in {DATA}; name the folder of the recordings in HYSTERESIS_DATA")
    return path
