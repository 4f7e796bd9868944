# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The thresholds that decide what an identification believes: one table, each with its reason.

A :class:`Threshold` says by which part an error must fall before a richer explanation replaces a simpler one. Equal
values have different reasons, so each decision has a row of its own.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Threshold:
    """Smallest relative improvement that decides for a richer explanation."""

    part: float  #: Part of the old error, 0 … 1.
    error: str  #: Which error is compared, on which samples.
    reason: str  #: Why it is not smaller, and not larger.

    def bound(self, old: float) -> float:
        """Return the error that a richer explanation must undercut, in the unit of ``old``."""
        return (1.0 - self.part) * old

    def improves(self, new: float, old: float) -> bool:
        """Return whether an error ``new`` is so much below ``old`` that the richer explanation is taken."""
        return bool(new < self.bound(old))


RESIDUAL = "RMS residual of the fitted samples"
HELD_OUT = "RMS error on parts of the recording that were not fitted"

# Linear part behind the hysteresis

LINEAR_PART = Threshold(
    0.01, RESIDUAL, "Each further number lowers the residual a little; the part must be visible in the recording."
)
SETTLED_START = Threshold(
    0.05, RESIDUAL, "Nodes start at rest at 0 V; another start of the creep is taken only where the data is clear."
)
DELAY_OR_LAG = Threshold(
    0.05, RESIDUAL, "Stages have lags: a delay must be visible, and both together must be better than either alone."
)
LAG_OF_A_GAIN = Threshold(0.02, RESIDUAL, "A lag behind a plain gain that was not requested also fits noise a little.")
FAST_DYNAMICS = Threshold(
    0.03, RESIDUAL, "Of hystereses fitted behind different dynamics the simplest is kept unless another is better."
)

# Structure of the hysteresis

STRUCTURE = Threshold(
    0.03, HELD_OUT, "More freedom always lowers the residual; a structure must also predict what it has not seen."
)
#: The gain on held-out parts must also exceed this many of its standard errors: one part alone may be luck.
STANDARD_ERRORS = 1.0
LOOPS_OF_ONE_SIZE = Threshold(
    0.3, HELD_OUT, "Where all loops have one size, held-out parts show nothing new and favour freedom."
)
ANOTHER_KIND = Threshold(
    0.5, HELD_OUT, "As LOOPS_OF_ONE_SIZE, for a model of another kind, which holds no prior for smaller loops."
)
DENSITY_DECAY = Threshold(
    0.03, RESIDUAL, "Loops of one size hardly distinguish the decay of the density from its map: the prior is kept."
)
NETWORK_SIZE = Threshold(0.2, RESIDUAL, "More shape functions take longer to train and to run.")
FREER_MODEL = Threshold(
    0.03, HELD_OUT, "A generalised play contains plain plays and is never much worse than they are."
)
NO_PRIOR = Threshold(
    0.5, HELD_OUT, "Where smaller loops are not settled, the model with the stated prior is kept unless clearly wrong."
)
#: The residual of weights may grow by this part for the sake of smoothness: less than STRUCTURE.
SMOOTHER_WEIGHTS = 0.01
#: An ambiguity of this part of the stroke is reported as a warning.
NOTABLE_AMBIGUITY = 0.002

# What was before the recording

PAST_WHILE_FITTING = Threshold(
    0.1, RESIDUAL, "Rest at 0 V needs no assumption; another past is one more number, found on coarse samples."
)
PAST_WHILE_PREDICTING = Threshold(
    0.1,
    "standard deviation of the error until the past is wiped out",
    "As PAST_WHILE_FITTING, with a known model.",
)

# Drift and outliers

DRIFT = Threshold(
    0.2, HELD_OUT, "A drift is no part of the model, and the shape of loops may look like a little of it."
)
#: Drifts that differ by less than this part are one: the rounds of fitting and cleaning have converged.
SAME_DRIFT = 0.01
#: Outliers are further from the median than this many standard deviations of the bulk: Gaussian noise has none …
OUTLYING = 5.0
#: … and are at most this part of the samples; a model that misses more of them is the wrong model.
MOST_OUTLIERS = 0.1
#: They are left out, and the fit is repeated, where they make up this part of the squared error.
OUTLIERS_MATTER = 0.01
