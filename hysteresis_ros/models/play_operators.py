# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Play operators: the outputs of plays with several radii, which are the regressors of the play models."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models.block import COMPILED, specialised


def plays(voltage, play_radii, start=None) -> np.ndarray:
    """Return the outputs of the play operators, shape (N, m); the outputs begin at ``start``, by default at 0 V.

    Without Numba, all samples between two reversals are processed together: between reversals, the output of a play is
    the running maximum of V - r (rising), or minimum of V + r (falling).

    Units: ``voltage`` [V], ``play_radii`` [V], ``start`` [V].
    """
    voltage = np.ascontiguousarray(voltage, dtype=float)
    z = np.zeros(len(play_radii)) if start is None else np.array(start, dtype=float)
    result = np.empty((voltage.size, len(play_radii)))
    if COMPILED:
        sizes = np.ascontiguousarray(play_radii, dtype=float)
        specialised(run_plays, sizes, z, voltage, result)(sizes, z, voltage, result)
        return result
    direction = np.sign(np.diff(voltage, prepend=voltage[0] - 1.0))
    moving = np.flatnonzero(direction)
    turns = moving[1:][np.diff(direction[moving]) != 0.0]
    edges = sorted({0, min(1, voltage.size), *turns.tolist(), voltage.size})
    for first, last in zip(
        edges, edges[1:], strict=False
    ):  # V is monotone between reversals; the first section is one step
        part = voltage[first:last, None]
        block = np.maximum(part - play_radii, np.minimum(part + play_radii, z))
        result[first:last] = block
        z = block[-1]
    return result


def run_plays(play_radii, z, voltage, result):
    """Fill ``result`` with the outputs of plays; ``z`` holds their outputs before the first sample."""
    for k in range(voltage.shape[0]):
        for p in range(play_radii.shape[0]):
            z[p] = max(voltage[k] - play_radii[p], min(voltage[k] + play_radii[p], z[p]))
            result[k, p] = z[p]
