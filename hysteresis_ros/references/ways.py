# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Ways from one level to another, sample by sample, and holds: what stands around an experiment."""

from __future__ import annotations

import numpy as np

#: Seconds of a way from one place to another, and of resting there before anything is measured.
WAY, REST = 0.5, 0.5


def way(begin: float, end: float, seconds: float, rate: float) -> np.ndarray:
    """Return a way that begins and ends at rest, half a cosine; its first sample has left ``begin`` already.

    Parameters
    ----------
    begin, end : float
        [V] or [m]
    seconds : float
    rate : float
        [Hz]
    """
    count = max(round(seconds * rate), 1)
    return begin + (end - begin) * 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))


def hold(level: float, seconds: float, rate: float) -> np.ndarray:
    """Return a level that is held.

    Parameters
    ----------
    level : float
        [V] or [m]
    seconds : float
    rate : float
        [Hz]
    """
    return np.full(max(round(seconds * rate), 1), level)


def there_and_back(middle: np.ndarray, safe: float, rate: float) -> np.ndarray:
    """Return samples with the ways to their first and from their last one.

    Parameters
    ----------
    middle : ndarray, shape (N,)
        [V] or [m]
    safe : float
        Where it begins and ends.
    rate : float
        [Hz]
    """
    parts = [hold(safe, REST, rate), way(safe, middle[0], WAY, rate), middle, way(middle[-1], safe, WAY, rate)]
    return np.concatenate([*parts, hold(safe, REST, rate)])
