# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of excited responses."""

from __future__ import annotations

import numpy as np
import scipy.signal

RATE = 1000.0


#: 60 Hz with 10 % of damping.
POLES = 2.0 * np.pi * 60.0 * np.array([-0.1 + 1j, -0.1 - 1j])


B, A = scipy.signal.bilinear(*scipy.signal.zpk2tf([], POLES, abs(POLES[0]) ** 2), RATE)


def plant(u, noise, seed):
    """Return the response of the plant, with white noise."""
    return scipy.signal.lfilter(B, A, u) + noise * np.random.default_rng(seed).standard_normal(u.size)


def truth(frequency):
    return scipy.signal.freqz(B, A, frequency, fs=RATE)[1]
