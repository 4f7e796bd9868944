# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Which way the output moves when the input rises slowly, and whether the recording tells.

Judged by the gain of slow movement, at which neither lag nor resonance turns the phase. What else moves the output
(other inputs, vibration, drift) is noise here: the gain is that of the narrowest band, from the lowest frequency on, in
which it stands out of its standard deviation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: Part of the input's power in the first band; each further one holds twice as many frequencies.
FIRST_BAND = 0.01
#: The gain is told where it is so many standard deviations away from zero.
CERTAIN = 3.0


class SlowGain(NamedTuple):
    """Gain of slow movement.

    Parameters
    ----------
    gain, deviation : float
        In the output's unit per input's unit.
    highest : float
        End of the band it was seen in [Hz].
    """

    gain: float
    deviation: float
    highest: float

    @property
    def told(self) -> bool:
        """Whether its sign is certain."""
        return abs(self.gain) > CERTAIN * self.deviation


def slow_gain(u, y, sample_time: float) -> SlowGain:
    """Return the gain of the slowest movement that can be told from what else moves the output; else of all of it.

    Parameters
    ----------
    u, y : ndarray, shape (N,)
        Input and output.
    sample_time : float
        [s]
    """
    window = np.hanning(len(u))
    U, Y = (np.fft.rfft(window * (values - values.mean()))[1:] for values in (u, y))
    power = np.abs(U) ** 2
    first = int(np.searchsorted(np.cumsum(power), FIRST_BAND * power.sum())) + 1
    ends = [*(first * 2 ** np.arange(int(np.log2(len(U) / first)) + 1)).tolist(), len(U)]
    for end in ends:
        size = float(power[:end].sum())
        gain = float(np.real(Y[:end] @ np.conj(U[:end]))) / size
        left = np.abs(Y[:end] - gain * U[:end]) ** 2
        found = SlowGain(gain, float(np.sqrt(0.5 * (power[:end] @ left))) / size, end / (len(u) * sample_time))
        if found.told:
            break
    return found
