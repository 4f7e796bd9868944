"""Long recordings, brought down to what carries information before anything is fitted.

A recording of half an hour at 10 kHz repeats what some cycles say, many times over, and most of its samples lie
between two that say as much. So of many cycles those are taken that show most of the loops, and neighbouring samples
are averaged as far as neither signal holds anything above the noise there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy.signal

from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.recordings.loops import turning_points
from hysteresis_ros.recordings.units import readable

#: Recordings of more samples than this are condensed, and none has more afterwards …
MOST_SAMPLES = 100_000
#: … nor fewer than these, where its signals would allow it.
ENOUGH_SAMPLES = 6000
#: Full strokes, to and fro counted one by one, that are enough for a fit, and for one of many different loops.
STROKES = (40.0, 100.0)
#: A stretch that shows this part of the loops that another shows is as good.
AS_GOOD = 0.9
#: Stretches among which is chosen.
STRETCHES = 20
#: Levels at which turning points count as different.
LEVELS = 20
#: What is lost above the new band must be below this part of the signal …
LOST = 3e-4
#: … and the new rate so many times the highest frequency that is kept.
OVERSAMPLING = 8.0
#: Samples over which turning points are looked for, and of a segment of the spectrum; how many segments at least.
OVERVIEW = 500_000
SEGMENT = 1 << 14
SEGMENTS = 24
#: Power above this many noise floors is signal.
ABOVE_FLOOR = 3.0


def condense(data: IdentificationData) -> IdentificationData:
    """Return a stretch of long data, with neighbouring samples averaged, and a note about both; short data as it is.

    Each sample stands for the middle of those that were averaged; :attr:`IdentificationData.factor` says how many.

    Parameters
    ----------
    data : IdentificationData
        Uniform, without missing samples.
    """
    if len(data) <= MOST_SAMPLES:
        return data
    first, last, strokes = _telling_stretch(data.input, len(data))
    highest = max(_highest_frequency(values[first:last], data.sample_time) for values in (data.input, data.output))
    allowed = max(1, int(1.0 / (OVERSAMPLING * highest * data.sample_time))) if highest > 0.0 else last - first
    factor = min(allowed, max(1, (last - first) // ENOUGH_SAMPLES))
    if (last - first) // factor > MOST_SAMPLES:
        first, last, strokes = _telling_stretch(data.input, MOST_SAMPLES * factor)
    whole, rate = len(data), 1.0 / data.sample_time
    count = (last - first) // factor
    last = first + count * factor
    columns = {
        name: getattr(data, name)[first:last].reshape(count, factor).mean(axis=1)
        for name in ("time", "input", "output")
    }
    words = [f"{whole} samples condensed to {count}"]
    if last - first < whole - factor:
        begin, end = data.time[first] - data.time[0], data.time[last - 1] - data.time[0]
        words.append(f"the stretch from {begin:.4g} to {end:.4g} s shows the loops ({strokes:.0f} full strokes in all)")
    if factor > 1:
        held = f"above {readable(highest, 'Hz')} is noise only" if highest > 0.0 else "what is fast is noise only"
        words.append(f"{factor} averaged in one, {rate:.4g} Hz to {rate / factor:.4g} Hz ({held})")
    note = f"{'; '.join(words)}; --all-samples takes every one"
    return replace(data, **columns, first=data.first + first, factor=factor, notes=(*data.notes, note))


def _telling_stretch(voltage, longest: int):
    """Return first and last sample of the stretch of so many that shows most, and the strokes of all."""
    block = math.ceil(voltage.size / OVERVIEW)
    coarse = voltage[: voltage.size // block * block].reshape(-1, block).mean(axis=1)
    turns = turning_points(coarse)
    span = np.ptp(coarse)
    strokes = np.append(0.0, np.cumsum(np.abs(np.diff(coarse[turns])))) / span
    levels = np.rint((coarse[turns] - coarse.min()) / span * LEVELS).astype(int)
    everything = _shown(levels)
    start, end = 0, len(turns) - 1
    for most in STROKES:
        if strokes[-1] <= most and voltage.size <= longest:
            return 0, voltage.size, strokes[-1]
        latest = max(
            int(np.searchsorted(strokes, max(strokes[-1] - most, 0.0))),
            int(np.searchsorted(turns, max(coarse.size - longest // block, 0))),
        )
        found = []
        for first in np.unique(np.linspace(0, latest, STRETCHES).astype(int)):
            last = (
                min(
                    int(np.searchsorted(strokes, strokes[first] + most, side="right")),
                    int(np.searchsorted(turns, turns[first] + longest // block, side="right")),
                )
                - 1
            )
            found.append((_shown(levels[first : last + 1]), first, last))
        best = max(found)[0]
        # of those that show about as much the earliest: it is nearest to rest, and shows how creep begins
        shown, start, end = next(item for item in found if item[0] >= AS_GOOD * best)
        if shown >= AS_GOOD * everything:
            break
    begin = int(turns[start]) * block if start else 0
    # creep between two turning points may be longer than what is wanted
    return begin, min((int(turns[end]) + 1) * block if end > start else voltage.size, begin + longest), strokes[-1]


def _shown(levels) -> float:
    """Return how much turning points at these levels show: different loops, and most of all those to both ends."""
    pairs = {*zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True)}
    reach = np.ptp(levels) / LEVELS
    return reach**4 * len(pairs)


def _highest_frequency(values, sample_time: float) -> float:
    """Return the frequency [Hz] above which there is nothing but noise; 0 where all is."""
    size = min(SEGMENT, values.size // SEGMENTS)
    # more than this tells nothing new about the band
    values = values[: 256 * size]
    frequencies, power = scipy.signal.welch(values, 1.0 / sample_time, nperseg=size, detrend="linear")
    floor = float(np.quantile(power, 0.1))
    signal = np.where(power > ABOVE_FLOOR * floor, power, 0.0)
    above = np.cumsum(signal[::-1])[::-1] * frequencies[1]
    there = np.flatnonzero(above > LOST**2 * np.var(values))
    return float(frequencies[there[-1]]) if there.size else 0.0
