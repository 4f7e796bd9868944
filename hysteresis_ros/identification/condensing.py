# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Long recordings, brought down to what carries information before anything is fitted.

A recording of half an hour at 10 kHz repeats what some cycles say, many times over, and most of its samples lie
between two that say as much. So of many cycles those are taken that show most of the loops, and neighbouring samples
are averaged as far as neither signal holds anything above the noise there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.recordings.loops import turning_points
from hysteresis_ros.units import readable

#: Recordings of more samples than this are condensed, and have no more afterwards but for sweeps …
MOST_SAMPLES = 100_000
#: … nor fewer than these, where its signals would allow it.
ENOUGH_SAMPLES = 6000
#: Full strokes, to and fro counted one by one, and samples that are tried one after the other until they show as much
#: as all: enough for a fit, for one of many different loops, and for sweeps, of which every part says something else.
STRETCHES = ((40.0, MOST_SAMPLES), (100.0, MOST_SAMPLES), (math.inf, 4 * MOST_SAMPLES))
#: A stretch that shows this part of the loops that another shows is as good.
AS_GOOD = 0.9
#: Beginnings of a stretch among which is chosen.
TRIED = 20
#: Levels at which turning points count as different.
LEVELS = 20
#: What is lost above the new band must be below this part of the signal …
LOST = 3e-4
#: … and the new rate so many times the highest frequency that is kept.
OVERSAMPLING = 8.0
#: Samples over which turning points are looked for, and of a segment of the spectrum; fewest and most segments.
OVERVIEW = 500_000
SEGMENT = 1 << 14
SEGMENTS = 24
MOST_SEGMENTS = 256
#: Power above this many noise floors is signal.
ABOVE_FLOOR = 3.0


def condense(data: IdentificationData, whole: bool = False) -> IdentificationData:
    """Return a stretch of long data, with neighbouring samples averaged, and a note about both; short data as it is.

    Each sample stands for the middle of those that were averaged; :attr:`IdentificationData.factor` says how many.

    Parameters
    ----------
    data : IdentificationData
        Uniform, without missing samples.
    whole : bool
        Average only: all of the data is to be judged.
    """
    if len(data) <= MOST_SAMPLES:
        return data
    size, rate = len(data), 1.0 / data.sample_time
    highest = max(_highest_frequency(values, data.sample_time) for values in (data.input, data.output))
    allowed = max(1, int(rate / (OVERSAMPLING * highest))) if highest > 0.0 else size
    first, last, strokes = (0, size, 0.0) if whole else _telling_stretch(data.input, allowed)
    factor = min(allowed, max(1, (last - first) // ENOUGH_SAMPLES))
    count = (last - first) // factor
    last = first + count * factor
    if (count, factor) == (size, 1):
        return data
    columns = {
        name: getattr(data, name)[first:last].reshape(count, factor).mean(axis=1)
        for name in ("time", "input", "output")
    }
    words = [f"{size} samples condensed to {count}"]
    if last - first < size - factor:
        begin, end = data.time[first] - data.time[0], data.time[last - 1] - data.time[0]
        words.append(f"the stretch from {begin:.4g} to {end:.4g} s shows the loops ({strokes:.0f} full strokes in all)")
    if factor > 1:
        held = f"above {readable(highest, 'Hz')} is noise only" if highest > 0.0 else "what is fast is noise only"
        words.append(f"{factor} averaged in one, {rate:.4g} Hz to {rate / factor:.4g} Hz ({held})")
    note = f"{'; '.join(words)}; --all-samples takes every one"
    return replace(data, **columns, first=data.first + first, factor=factor, notes=(*data.notes, note))


def _telling_stretch(voltage, averaged: int):
    """Return first and last sample of the stretch that shows most, of which so many become one, and all strokes."""
    block = math.ceil(voltage.size / OVERVIEW)
    coarse = voltage[: voltage.size // block * block].reshape(-1, block).mean(axis=1)
    turns = turning_points(coarse)
    span = np.ptp(coarse)
    strokes = np.append(0.0, np.cumsum(np.abs(np.diff(coarse[turns])))) / span
    levels = np.rint((coarse[turns] - coarse.min()) / span * LEVELS).astype(int)
    speeds = np.rint(2.0 * np.log2(np.maximum(np.diff(turns), 1))).astype(int)
    everything = _shown(levels, speeds)
    start, end = 0, len(turns) - 1
    for most, samples in STRETCHES:
        longest = samples * averaged
        if strokes[-1] <= most and voltage.size <= longest:
            return 0, voltage.size, strokes[-1]
        latest = max(
            int(np.searchsorted(strokes, max(strokes[-1] - most, 0.0))),
            int(np.searchsorted(turns, max(coarse.size - longest // block, 0))),
        )
        found = []
        for first in np.unique(np.linspace(0, latest, TRIED).astype(int)):
            last = (
                min(
                    int(np.searchsorted(strokes, strokes[first] + most, side="right")),
                    int(np.searchsorted(turns, turns[first] + longest // block, side="right")),
                )
                - 1
            )
            found.append((_shown(levels[first : last + 1], speeds[first:last]), first, last))
        best = max(found)[0]
        # of those that show about as much the earliest: it is nearest to rest, and shows how creep begins
        shown, start, end = next(item for item in found if item[0] >= AS_GOOD * best)
        if shown >= AS_GOOD * everything:
            break
    begin = int(turns[start]) * block if start else 0
    # creep between two turning points may be longer than what is wanted
    return begin, min((int(turns[end]) + 1) * block if end > start else voltage.size, begin + longest), strokes[-1]


def _shown(levels, speeds) -> float:
    """Return how much turning points at these levels show: different loops and speeds, most of all to both ends."""
    loops = {*zip(levels[:-1].tolist(), levels[1:].tolist(), speeds.tolist(), strict=True)}
    reach = np.ptp(levels) / LEVELS if levels.size else 0.0
    return reach**4 * len(loops)


def _highest_frequency(values, sample_time: float) -> float:
    """Return the frequency [Hz] above which there is nothing but noise; 0 where all is."""
    size = min(SEGMENT, values.size // SEGMENTS)
    # segments from all over: more of them tell nothing new about the band
    starts = np.linspace(0, values.size - size, min(MOST_SEGMENTS, values.size // size)).astype(int)
    values = np.concatenate([values[start : start + size] for start in starts])
    frequencies, power = scipy.signal.welch(values, 1.0 / sample_time, nperseg=size, noverlap=0, detrend="linear")
    floor = float(np.quantile(power, 0.1))
    signal = np.where(power > ABOVE_FLOOR * floor, power, 0.0)
    above = np.cumsum(signal[::-1])[::-1] * frequencies[1]
    there = np.flatnonzero(above > LOST**2 * np.var(values))
    return float(frequencies[there[-1]]) if there.size else 0.0
