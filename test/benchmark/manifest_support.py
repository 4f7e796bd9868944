# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A recording in a file, and a manifest of it."""

from __future__ import annotations

import hashlib
import pathlib

import numpy as np
import yaml


def written(folder, name: str = "run.csv", samples: int = 400):
    """Write a table of triangles; return its SHA-256."""
    k = np.arange(samples)
    u = 10.0 + 10.0 * np.abs((k / 50.0) % 2.0 - 1.0)
    text = "t_s,drive_V,gauge_um\n" + "\n".join(
        f"{1e-3 * i:.3f},{v:.6f},{0.3 * v + 0.01 * i % 7:.6f}" for i, v in enumerate(u)
    )
    (folder / name).write_text(text + "\n")
    return hashlib.sha256((folder / name).read_bytes()).hexdigest()


def entry(checksum: str, **changes) -> dict:
    """Return a recording that is split at sample 200."""
    part = {"file": "run.csv", "sha256": checksum}
    given = {
        "input": "drive_V:V",
        "output": "gauge_um:um",
        "source": "a shelf",
        "train": {**part, "range": ":200"},
        "test": {**part, "range": "200:390"},
        "skip": 10,
    }
    for key, value in changes.items():
        given = {**given, key: value} if value is not None else {k: v for k, v in given.items() if k != key}
    return given


def manifest(folder, given) -> pathlib.Path:
    """Write a manifest of one recording."""
    (folder / "manifest.yaml").write_text(yaml.safe_dump({"recordings": {"shelf": given}}))
    return folder / "manifest.yaml"
