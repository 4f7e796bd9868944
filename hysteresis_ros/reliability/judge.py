# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Judges: from what was seen to figures, and to what did not hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.reliability.bounds import SAFE, Bounds
from hysteresis_ros.reliability.mishaps import DEVICE, MEASUREMENT, Mishap
from hysteresis_ros.reliability.trace import Samples, Trace

#: A safe command is not quite a safe voltage: so far from it may the inverse of the hysteresis be [part of the range].
COMMANDED = 0.1
#: Rounding of numbers that are compared.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Figures:
    """What a mishap came to, once or at worst.

    Parameters
    ----------
    lowest, highest : float
        Voltages that the plant put out [V].
    step : float
        Largest change between two samples, as a part of what is allowed.
    beyond : float
        How far the displacement left the places between rest and what was asked for, as a part of the stroke.
    safe : float
        Time from the beginning until the voltage was safe and stayed so [s]; NaN where it need not be, infinite where
        it was not.
    recovery : float
        Time from the end until the axis followed a setpoint again [s]; infinite: it did not.
    """

    lowest: float
    highest: float
    step: float
    beyond: float
    safe: float
    recovery: float


@dataclass(frozen=True)
class Verdict:
    """What a mishap came to, and what of its claims did not hold.

    Parameters
    ----------
    trace : Trace
    figures : Figures
    failures : tuple of str
        Empty: all held.
    """

    trace: Trace
    figures: Figures
    failures: tuple[str, ...]


def largest_step(samples: Samples, bounds: Bounds, stalls: bool = False) -> float:
    """Return the largest change of the voltage as a part of what is allowed in the time between two samples.

    Parameters
    ----------
    samples : Samples
        Where some are missing the stamps say how many steps are allowed; another life of the plant begins anew.
    bounds : Bounds
    stalls : bool
        Whether a sample may take longer than its stamps say, as one in which a device does not answer: what counts is
        when it was seen then.
    """
    if samples.time.size < 2:
        return 0.0
    follow = np.diff(samples.life) == 0
    passed = np.maximum(np.diff(samples.stamp), np.diff(samples.time) if stalls else 0.0)
    periods = np.maximum(np.round(passed / bounds.sample_time), 1.0)
    steps = np.abs(np.diff(samples.voltage)) / (periods * bounds.step)
    return float(np.max(steps[follow], initial=0.0))


def time_to_safe(samples: Samples, begun: float, ended: float, bounds: Bounds, part: float = SAFE) -> float:
    """Return the time from the beginning until the voltage is safe and stays so until the end [s]; infinite: never.

    Parameters
    ----------
    samples : Samples
    begun, ended : float
        [s]
    bounds : Bounds
    part : float
        Of the range, within which a voltage is safe.
    """
    inside = samples.between(begun, ended)
    if not inside.time.size:
        return math.inf
    unsafe = np.abs(inside.voltage - bounds.safe) > part * (bounds.maximum - bounds.minimum)
    if unsafe[-1]:
        return math.inf
    last = np.flatnonzero(unsafe)
    return float(inside.time[last[-1] + 1] - begun) if last.size else 0.0


def judged(trace: Trace, mishap: Mishap, bounds: Bounds) -> Verdict:
    """Return what a mishap came to.

    Parameters
    ----------
    trace : Trace
    mishap : Mishap
    bounds : Bounds
    """
    samples = trace.samples
    voltage = samples.voltage if samples.time.size else np.array([math.nan])
    low, high = trace.asked
    places = samples.displacement[np.isfinite(samples.displacement)]  # of a device nobody may know it
    excess = np.maximum(places - high, low - places)
    beyond = float(np.max(excess, initial=0.0)) / bounds.stroke
    safe = math.nan
    if mishap.safe:
        part = COMMANDED if mishap.safe == MEASUREMENT else SAFE
        safe = time_to_safe(samples, trace.begun, trace.ended, bounds, part)
    recovery = trace.recovered - trace.ended if math.isfinite(trace.recovered) else math.inf
    figures = Figures(
        float(np.min(voltage)),
        float(np.max(voltage)),
        largest_step(samples, bounds, mishap.graph == DEVICE),
        beyond,
        safe,
        recovery,
    )
    return Verdict(trace, figures, tuple(_failures(figures, trace, mishap, bounds)))


def _failures(figures: Figures, trace: Trace, mishap: Mishap, bounds: Bounds):
    """Yield what did not hold."""
    yield from trace.broken
    if not trace.samples.time.size:
        yield "nothing was seen of the plant"
        return
    small = ROUNDING * (bounds.maximum - bounds.minimum)
    if not (bounds.minimum - small <= figures.lowest and figures.highest <= bounds.maximum + small):
        allowed = f"{bounds.minimum:g} … {bounds.maximum:g} V"
        yield f"voltages of {figures.lowest:.4g} … {figures.highest:.4g} V leave {allowed}"
    if not figures.step <= 1.0 + 1e-6:
        yield f"a step of the voltage is {figures.step:.3g} times what the slew rate allows"
    if mishap.bounded and not figures.beyond <= bounds.beyond:
        yield f"the displacement goes {100.0 * figures.beyond:.2g} % of the stroke beyond what was asked for"
    if mishap.safe and not figures.safe <= bounds.timeouts[mishap.safe]:
        yield f"safe after {figures.safe:.3g} s, {bounds.timeouts[mishap.safe]:.3g} s are allowed"
    if not math.isfinite(figures.recovery):
        yield "the axis does not follow setpoints again"


def worst(verdicts: list[Verdict]) -> Figures:
    """Return the worst figures of several.

    Parameters
    ----------
    verdicts : list of Verdict
    """
    found = [verdict.figures for verdict in verdicts]
    safe = [figures.safe for figures in found if not math.isnan(figures.safe)]
    return Figures(
        min(figures.lowest for figures in found),
        max(figures.highest for figures in found),
        max(figures.step for figures in found),
        max(figures.beyond for figures in found),
        max(safe, default=math.nan),
        max(figures.recovery for figures in found),
    )
