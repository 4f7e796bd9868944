# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The recordings from which the papers identify: triangles of a rate independent element."""

from __future__ import annotations

import numpy as np

SAMPLE_TIME = 1e-3  # of the simulated recordings [s]; the models are rate independent


def triangles(peaks, samples: int = 250) -> np.ndarray:
    """Return triangles from 0 to each of ``peaks`` and back, ``samples`` samples a branch (2 Hz: 250 at 1 kHz)."""
    rise = np.arange(1, samples + 1) / samples
    return np.concatenate([[0.0], *(peak * np.concatenate([rise, 1.0 - rise]) for peak in peaks)])
