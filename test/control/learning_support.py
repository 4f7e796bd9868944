# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of learning."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.learning import Learning, LearningParameters, learned_correction

RATE, N = 1000.0, 40


REFERENCE = 1e-6 * (np.sin(2.0 * np.pi * np.arange(N) / N) + 0.3 * np.cos(6.0 * np.pi * np.arange(N) / N))


def learning(fade=0.0, **values):
    """Return a correction of period N with G = 1 and Q = 1."""
    values = {"error_filter": (1.0,), "robustness_filter": (1.0,), "maximum": 1e-3, "period": N / RATE} | values
    return Learning(LearningParameters(type="inversion", **values), 1.0 / RATE, fade)


def followed(block, answer, periods, reference=REFERENCE, bad=()):
    """Return corrections and errors, shape (periods, N), in a loop that adds ``answer`` (an impulse response)."""
    asked, m, e = np.zeros(periods * N + 100), [], []
    for k in range(periods * N):
        r = reference[k % N] if len(reference) == N else reference[k]
        # the response in this sample depends on earlier samples only
        y = sum(a * asked[k - i + 100] for i, a in enumerate(answer) if i)
        e.append(r - y)
        m.append(learned_correction(block.p, block.x, r, np.nan if k in bad else e[-1]))
        asked[k + 100] = r + m[-1]
    return np.array(m).reshape(periods, N), np.array(e).reshape(periods, N)
