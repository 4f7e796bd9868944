# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is in a recording beside what the voltage moves: samples far off, and a drift; told by what a fit leaves.

Both are taken out of the data before a model is fitted again that has no term for them. A sample far off is put where
the fit expects it, between what its neighbours deviate by.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.identification.data import IdentificationData

#: Outliers are further off than this many standard deviations (of the bulk, from the median) …
OUTLYING = 5.0
#: … and are at most this part of the samples; a model that misses more of them is the wrong model.
MOST_OUTLIERS = 0.1
#: They are left out, and the fit is repeated, where they make up this part of the squared error.
MATTERING = 0.01
#: A stretch of samples of which most are far off are no outliers.
STRETCH = 11
#: A drift must lower the error on blocks held out by this part: it is no part of the model, and the shape of loops may
#: look like a little of it. Number of the blocks.
DRIFTING, BLOCKS = 0.2, 5
#: How often a model without terms of its own for these is fitted at most.
ROUNDS = 3


class Cleaned(NamedTuple):
    """A recording without what does not belong to the movement.

    Parameters
    ----------
    data : IdentificationData
    drift : float
        What was taken out [m/s].
    outliers : int
        How many samples were moved to where they were expected.
    """

    data: IdentificationData
    drift: float
    outliers: int

    @property
    def doubts(self) -> tuple[str, ...]:
        """What was kept out of the model, in sentences."""
        return doubts(self.drift, self.outliers)

    @property
    def numbers(self) -> dict[str, float]:
        """The figures, where there is something."""
        drift = {"drift_m_per_s": self.drift} if self.drift else {}
        return drift | ({"outliers": float(self.outliers)} if self.outliers else {})


def doubts(drift: float, outliers: int) -> tuple[str, ...]:
    """Return in sentences what was kept out of a model.

    Parameters
    ----------
    drift : float
        [m/s]
    outliers : int
    """
    found = []
    if drift:
        found.append(f"the output drifts by {1e6 * drift:.3g} µm/s beside creep: fitted too, but no part of the model")
    if outliers:
        found.append(f"{outliers} outliers left out of the fit")
    return tuple(found)


def near(error, first: int) -> np.ndarray:
    """Return which samples are no outliers, shape (N,) of bool; those before ``first`` are none.

    Far off are single samples and short stretches: what is far off for long is what a fit has no shape for.

    Parameters
    ----------
    error : ndarray, shape (N,)
    first : int
        First sample that counts.
    """
    # what is far off for long is what the fit has no shape for
    alone = error - scipy.ndimage.median_filter(error, STRETCH, mode="nearest")
    return _within(error, first) | _within(alone, first)


def _within(error, first: int) -> np.ndarray:
    size = np.abs(error - np.median(error[first:]))
    good = size <= OUTLYING * 1.4826 * float(np.median(size[first:]))
    good[:first] = True
    return good


def matter(error, added, used) -> bool:
    """Tell whether samples far off make up a notable part of the squared error.

    Parameters
    ----------
    error : ndarray, shape (N,)
        Without its median.
    added, used : ndarray of bool or int
        Those far off, and all that the fit used.
    """
    share = float(np.sum(error[added] ** 2)) / max(float(np.sum(error[used] ** 2)), 1e-300)
    return share >= MATTERING


def drift_of(error, kept) -> float:
    """Return by how much an error, shape (N,), grows from sample to sample; 0 where that predicts no blocks held out.

    Parameters
    ----------
    error : ndarray, shape (N,)
    kept : ndarray of int
        Places of the samples that count.
    """
    place = kept / len(error)
    line = np.column_stack([np.ones(len(kept)), place])
    left = {1: 0.0, 2: 0.0}
    for block in np.array_split(np.arange(len(kept)), BLOCKS):
        others = np.delete(np.arange(len(kept)), block)
        for columns in left:
            found = np.linalg.lstsq(line[others, :columns], error[kept][others], rcond=None)[0]
            left[columns] += float(np.sum((error[kept][block] - line[block, :columns] @ found) ** 2))
    if not left[2] < (1.0 - DRIFTING) ** 2 * left[1]:
        return 0.0
    return float(np.linalg.lstsq(line, error[kept], rcond=None)[0][1]) / len(error)


def cleaned(data: IdentificationData, predicted, first: int = 0, drift: float | None = None) -> Cleaned:
    """Return a recording without outliers and drift, as a prediction of it shows them.

    Parameters
    ----------
    data : IdentificationData
    predicted : ndarray, shape (N,)
        Without a drift [m].
    first : int
        First sample that counts.
    drift : float, optional
        [m/s], where it is known; else what the error shows.
    """
    error = data.output - predicted
    places = np.arange(len(data))
    if drift is None:
        kept = np.flatnonzero(near(error, first)[first:]) + first
        drift = drift_of(error, kept) / data.sample_time
    slope = drift * data.sample_time * places
    error = error - slope
    good = near(error, first)
    count = int(np.count_nonzero(~good))
    centred = error - np.median(error[first:])
    if count > MOST_OUTLIERS * (len(data) - first) or not matter(centred, ~good, places >= first):
        return Cleaned(replace(data, output=data.output - slope) if drift else data, drift, 0)
    error = np.interp(places, places[good], error[good])
    return Cleaned(replace(data, output=predicted + error), drift, count)
