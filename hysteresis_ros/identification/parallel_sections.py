# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Filters of many columns at once: a sum of sections of first and second order, by recursion over the samples.

Fits filter the regressors of all plays for each trial of a lag, a creep or a mode. The recursion needs a fifth of the
time of a convolution by FFT, because a sample of all columns stays in the cache.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.models.block import COMPILED, specialised


class Section(NamedTuple):
    """The filter (b0 + b1/z + b2/z²)/(1 + a1/z + a2/z²)."""

    b0: float
    b1: float = 0.0
    b2: float = 0.0
    a1: float = 0.0
    a2: float = 0.0


def filtered(columns, sections: Sequence[Section]) -> np.ndarray:
    """Return the sum of the responses of sections, initially at rest, to each column, shape (N, m)."""
    columns = np.ascontiguousarray(columns, dtype=float)
    direct = sum(section.b0 for section in sections)
    recursive = [section for section in sections if any(section[1:])]
    if not recursive:
        return direct * columns
    if not COMPILED:
        return sum(scipy.signal.lfilter(one[:3], (1.0, *one[3:]), columns, axis=0) for one in sections)
    # each section without its direct part b0: (c1/z + c2/z²)/(1 + a1/z + a2/z²)
    rows = np.array([(one.b1 - one.a1 * one.b0, one.b2 - one.a2 * one.b0, one.a1, one.a2) for one in recursive])
    found = np.empty_like(columns)
    state = np.zeros((2 * len(rows), columns.shape[1]))
    settings = np.array([direct])
    specialised(run_sections, settings, rows, state, columns, found)(settings, rows, state, columns, found)
    return found


def run_sections(settings, rows, state, columns, found):
    """Fill ``found``; ``settings`` holds the direct part, ``state`` two rows for each section."""
    if columns.shape[1] == 1:  # without loops over a single column
        for k in range(columns.shape[0]):
            now = columns[k, 0]
            total = settings[0] * now
            for s in range(rows.shape[0]):
                before = state[2 * s, 0]
                total += before
                state[2 * s, 0] = rows[s, 0] * now - rows[s, 2] * before + state[2 * s + 1, 0]
                state[2 * s + 1, 0] = rows[s, 1] * now - rows[s, 3] * before
            found[k, 0] = total
        return
    for k in range(columns.shape[0]):
        for p in range(columns.shape[1]):
            found[k, p] = settings[0] * columns[k, p]
        for s in range(rows.shape[0]):
            c1, c2, a1, a2 = rows[s, 0], rows[s, 1], rows[s, 2], rows[s, 3]
            i = 2 * s
            if c2 == 0.0 and a2 == 0.0:
                for p in range(columns.shape[1]):
                    now = state[i, p]
                    found[k, p] += now
                    state[i, p] = c1 * columns[k, p] - a1 * now
            else:
                for p in range(columns.shape[1]):
                    now = state[i, p]
                    found[k, p] += now
                    state[i, p] = c1 * columns[k, p] - a1 * now + state[i + 1, p]
                    state[i + 1, p] = c2 * columns[k, p] - a2 * now
