# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The learned correction: what is added to a periodic reference, and how it goes from one period to the next.

m_(j+1) = m_j + γ_j (Q m_j + G e_j − m_j), with the error e = r − y of a period of N samples, the robustness filter Q,
of zero phase, and the error filter G = Q L (iterative learning control [1]_, and as a plug-in repetitive control [2]_).
γ_j = 1 is the plain law. A smaller one averages noise over periods and leaves the limit of m where it is.

Both filters look ahead: of the last period everything is known. A sample of m is worked at the moment it is needed, out
of the samples around the one a period before; nothing has to be done at the end of a period.

What cannot be learned from is not a finite number in the ring of errors: where more than a tenth of the filter's weight
meets such samples, around them, the correction repeats itself; where the reason is that commands were not carried out,
it gives way, or it would hold the axis at its limits. A voltage that came a sample too late moves the axis off its path
by what the correction has no part in: nothing is learned from it until its answer has died away, which takes less time
than after limits: one sample is a small knock. A reference that is
not the one of a period before takes the correction back.

References
----------
.. [1] Bristow, Tharayil & Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26 (3), 2006.
.. [2] Hara, Yamamoto, Omata & Nakano, Repetitive control system, IEEE Transactions on Automatic Control 33 (7), 1988.
"""

from __future__ import annotations

import math

from hysteresis_ros.block import called, kernel

# Parameters; then the error filter from its furthest look ahead on, and the robustness filter from its middle on.
PERIOD = 0  # N [samples]
LEAD = 1  # how far the first tap of the error filter looks ahead [samples]
TAPS = 2  # of the error filter
HALF = 3  # taps of the robustness filter beside its middle, on each side
GAIN = 4  # γ at first
LEAST_GAIN = 5
AVERAGING = 6  # n: in the j-th period γ is at most n / j; 0: it stays
MAXIMUM = 7  # [m]
SHORTFALL = 8  # command not carried out above which nothing is learned [m]
RECOVERY = 11  # samples after a command that was not carried out, in which nothing is learned
LATE_ANSWER = 12  # the same after a voltage that came too late
FADE = 9  # part of the correction that comes or goes in a sample
MISSING = 10  # weight of the error filter that may meet samples from which nothing can be learned
FILTERS = 13

# State; then three rings of as many samples as the filters reach back: correction, error, reference [m].
MODE = 0
SAMPLES = 1  # since the beginning
LEARNED = 2  # samples since learning began
WEIGHT = 3  # part of the correction that is in force
CORRECTION = 4  # of the last sample [m]
RECOVERING = 5  # samples until the answer to what was not carried out has died away
LOST = 6  # error of those samples in the ring: LIMITED or NaN
RINGS = 7

#: Modes: the correction repeats itself; it learns; it goes to zero.
FROZEN, LEARNING, FORGETTING = range(3)
MODES = ("frozen", "learning", "forgetting")

#: Error of a sample whose command was not carried out, and part of the correction that gives way around it in a period.
LIMITED, RELIEF = math.inf, 0.25

#: References that differ by less from one period to the next are the same [m].
SAME = 1e-9


@kernel
def shown(p, x, error, shortfall, skipped):
    """Return what a sample shows of the correction: its error [m], ``LIMITED``, or NaN: nothing.

    Parameters
    ----------
    p, x : ndarray
    error : float
        Reference less displacement [m]; NaN: the axis does not follow, or nothing was measured.
    shortfall : float
        What was not carried out of the last command [m].
    skipped : float
        1: the voltage of this sample comes too late, the axis holds the last one.
    """
    if abs(shortfall) > p[SHORTFALL]:
        x[RECOVERING] = p[RECOVERY]
        x[LOST] = LIMITED
    elif skipped != 0.0:
        # one that came while the axis answers for longer to what was not carried out ends nothing of that
        if x[RECOVERING] <= p[LATE_ANSWER]:
            x[RECOVERING] = p[LATE_ANSWER]
            x[LOST] = math.nan
        else:
            x[RECOVERING] -= 1.0
    elif x[RECOVERING] > 0.0:
        x[RECOVERING] -= 1.0
    else:
        return error
    return x[LOST] if error == error else error


@called
def learned_correction(p, x, reference, error):
    """Return what to add to the reference [m] in this sample.

    Parameters
    ----------
    p, x : ndarray
    reference : float
        The one that is followed in this sample, without correction [m].
    error : float
        What the displacement measured in this sample lacks of it [m]; NaN: nothing is to be learned from it.
    """
    period, lead, taps, half = int(p[PERIOD]), int(p[LEAD]), int(p[TAPS]), int(p[HALF])
    length = (x.shape[0] - RINGS) // 3
    corrections, errors, references = RINGS, RINGS + length, RINGS + 2 * length
    now = int(x[SAMPLES]) % length
    before = now - period
    if before < 0:
        before += length
    repeated = x[corrections + before]
    value = repeated
    if x[MODE] == LEARNING:
        place = before + lead
        if place >= length:
            place -= length
        update = missing = limited = 0.0
        for i in range(taps):
            error_then = x[errors + place]
            if error_then - error_then == 0.0:
                update += p[FILTERS + i] * error_then
            else:
                missing += abs(p[FILTERS + i])
                if error_then == LIMITED:
                    limited += abs(p[FILTERS + i])
            place -= 1
            if place < 0:
                place += length
        weights = FILTERS + taps
        update += p[weights] * repeated
        ahead = behind = before
        for i in range(1, half + 1):
            ahead += 1
            if ahead == length:
                ahead = 0
            behind -= 1
            if behind < 0:
                behind += length
            update += p[weights + i] * (x[corrections + ahead] + x[corrections + behind])
        gain = p[GAIN]
        if p[AVERAGING] > 0.0:
            gain = min(gain, max(p[AVERAGING] / (1.0 + x[LEARNED] // period), p[LEAST_GAIN]))
        if missing <= p[MISSING]:
            value = repeated + gain * (update - repeated)
        elif limited > p[MISSING]:
            value = repeated - RELIEF * gain * repeated
        x[LEARNED] += 1.0
    known = x[references + before]
    # before there was a period nothing can differ from it
    if x[MODE] == FORGETTING or abs(reference - known) > SAME:
        x[WEIGHT] = max(x[WEIGHT] - p[FADE], 0.0)
        if x[WEIGHT] == 0.0:
            x[LEARNED] = 0.0  # another reference begins with the whole gain
    else:
        x[WEIGHT] = min(x[WEIGHT] + p[FADE], 1.0)
    value = min(max(x[WEIGHT] * value, -p[MAXIMUM]), p[MAXIMUM])
    x[corrections + now] = value
    x[errors + now] = error
    x[references + now] = reference
    x[SAMPLES] += 1.0
    x[CORRECTION] = value
    return value
