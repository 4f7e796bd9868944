# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward of a stage: the coupling part, in addition to the inverse dynamics of each axis.

The feedforward of a stage, from the references r of all axes to their commands u, is

    u_i(k) = (F_i r_i)(k) + Σ_j Σ_{m=-N}^{N-1} X_ij[m] r_j(k + m).

F_i is the inverse of the model of axis i alone, :mod:`hysteresis_ros.control.feedforward`, with N samples of preview. X
is designed from the model of the stage (:mod:`hysteresis_ros.designs.stage_feedforward`), so that F + X inverts it. It
is a finite impulse response in both directions of time, because the inverse of a stage with zeros outside the unit
circle is bounded only if it looks ahead.

X reaches one sample less far ahead than F: after each sample the references of all axes are exchanged for the next
sample. So no controller waits for another controller within a sample, and the nodes, the fused loop and the offline
twin compute the same bits. An axis that does not follow its reference (stopped, stale) contributes nothing; when it
returns, its references count as if they had always been constant. The weights of X add up to 0, so X adds nothing at
rest; the matrix ``decoupling`` decouples at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.control.feedforward import LONGEST_PREVIEW


@dataclass(frozen=True)
class StageFeedforwardParameters(Parameters):
    """Commands that references of all axes add to those of the feedforward of each axis."""

    preview: int = parameter(
        0,
        low=0,
        high=10 * LONGEST_PREVIEW,
        read_only=True,
        description="samples N by which the references are ahead, equal to feedforward.preview of each axis",
    )
    weights: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="weights X of the references r_j(k-N) … r_j(k+N-1) in the command of axis i, n·n·2·N numbers, row "
        "by row; empty: each axis only has its own feedforward",
    )

    def matrix(self, axes: int) -> np.ndarray:
        """Return the weights, shape (n, n, 2 N); without weights (0, 0, 0)."""
        shape = (axes, axes, 2 * self.preview) if self.weights else (0, 0, 0)
        return np.array(self.weights, dtype=float).reshape(shape)
