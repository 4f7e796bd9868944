# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The thresholds of an identification, in one table with their reasons.

A :class:`Threshold` is the smallest relative reduction of an error with which a richer explanation replaces a simpler
one. Equal values can have different reasons, so each decision has its own row.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Threshold:
    """Smallest relative improvement that justifies a richer explanation."""

    part: float  #: Required reduction as a fraction of the old error, 0 … 1.
    error: str  #: The compared error and its samples.
    reason: str  #: Reason why the threshold is neither smaller nor larger.

    def bound(self, old: float) -> float:
        """Return the error, in the unit of ``old``, below which a richer explanation is justified."""
        return (1.0 - self.part) * old

    def improves(self, new: float, old: float) -> bool:
        """Return whether the error ``new`` is far enough below ``old`` to justify the richer explanation."""
        return bool(new < self.bound(old))


RESIDUAL = "RMS residual of the fitted samples"
HELD_OUT = "RMS error on held-out parts of the recording"

# Linear part after the hysteresis

LINEAR_PART = Threshold(
    0.01,
    RESIDUAL,
    "Each additional parameter lowers the residual a little; the effect must be visible in the recording.",
)
SETTLED_START = Threshold(
    0.05,
    RESIDUAL,
    "Nodes start at rest at 0 V; another start of the creep is chosen only if the data shows it clearly.",
)
DELAY_OR_LAG = Threshold(
    0.05,
    RESIDUAL,
    "Positioners usually have a lag: a delay must be visible, and both together must be better than either alone.",
)
LAG_OF_A_GAIN = Threshold(0.02, RESIDUAL, "An additional lag after a plain gain also fits noise a little.")
FAST_DYNAMICS = Threshold(
    0.03, RESIDUAL, "The simplest of several dynamics is kept unless another one is clearly better."
)

# Structure of the hysteresis

STRUCTURE = Threshold(
    0.03, HELD_OUT, "More freedom always lowers the residual; a structure must also predict held-out parts."
)
#: Smallest improvement on held-out parts, in standard errors, because improvements on single parts may be chance.
STANDARD_ERRORS = 1.0
LOOPS_OF_ONE_SIZE = Threshold(
    0.3,
    HELD_OUT,
    "If all loops have one size, held-out parts contain no new information and favour models with more freedom.",
)
ANOTHER_KIND = Threshold(
    0.5, HELD_OUT, "As LOOPS_OF_ONE_SIZE, for a model of another kind, which has no assumption about smaller loops."
)
#: If the residual of the simplest structure exceeds this fraction of the stroke, a free Preisach density is tried too,
#: because loops may saturate or have branches of different shape. With piezo stacks the residual is far smaller.
POOR = 0.005
DENSITY_DECAY = Threshold(
    0.1,
    RESIDUAL,
    "Loops of one size hardly distinguish the decay of the density from its map, and a decay imitates loops that grow "
    "with the rate (8 % less residual, but larger errors on other loops): the default is kept.",
)
#: Densities describe a recording equally well if their residuals exceed the smallest one by at most this fraction.
EQUAL_DENSITIES = 0.03
NETWORK_SIZE = Threshold(0.2, RESIDUAL, "More shape functions take longer to train and to run.")
FREER_MODEL = Threshold(
    0.03, HELD_OUT, "A generalised play contains plain plays and is never much worse than they are."
)
NO_PRIOR = Threshold(
    0.5, HELD_OUT, "If smaller loops are not determined, the model with the stated prior is kept unless clearly wrong."
)
#: Largest relative increase of the residual by smoothing of the weights; smaller than STRUCTURE.
SMOOTHER_WEIGHTS = 0.01
#: An ambiguity above this fraction of the stroke is reported as a warning.
NOTABLE_AMBIGUITY = 0.002

# Voltage before the recording

PAST_WHILE_FITTING = Threshold(
    0.1,
    RESIDUAL,
    "Rest at 0 V needs no assumption; another history is one more parameter, identified on coarse samples.",
)
PAST_WHILE_PREDICTING = Threshold(
    0.1,
    "standard deviation of the error until earlier voltages no longer matter",
    "As PAST_WHILE_FITTING, with a known model.",
)

# Drift and outliers

DRIFT = Threshold(0.2, HELD_OUT, "A drift is not part of the model, and the shape of loops may resemble a small drift.")
DRIFT_OF_CHANGING_LOOPS = Threshold(
    0.9,
    HELD_OUT,
    "If the loops grow or shrink all the time, an error in their shape looks like a drift: on such loops of other "
    "models without drift, a line improves plays by up to 88 %.",
)
#: The iteration of fit and cleaning has converged if the drift changes by less than this fraction.
SAME_DRIFT = 0.01
#: Outliers are farther from the median than this many standard deviations of the bulk; Gaussian noise hardly ever is …
OUTLYING = 5.0
#: … and largest fraction of outliers; if there are more, the model is wrong.
MOST_OUTLIERS = 0.1
#: Outliers are removed and the fit is repeated if the outliers cause at least this fraction of the squared error.
OUTLIERS_MATTER = 0.01
