# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Preparation of loops for the Duhem model (W2): remove the lag, make frequencies comparable, extract the branches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.branches import (
    FEWEST_BRANCH_SAMPLES,
    checked_signals,
    require_both_directions,
    split_branches,
)

#: Part of a branch on both sides of a reversal that is looked at for the lag.
WINDOW = 0.25
LAG_CANDIDATES = 41
#: A branch is one of the major loop when it comes this near to both ends, in parts of the range.
NEAR_END = 0.02
#: Branches of a loop that does not close within this part of the range are not one steady loop.
OPEN_END = 0.02
#: Points of a branch.
GRID = 301
COARSEST_GRID = 41


@dataclass(frozen=True)
class PreparedLoops:
    """Recordings as W2 wants them.

    Parameters
    ----------
    voltage : tuple of ndarray
        Input of each recording, delayed by its lag [V].
    displacement : tuple of ndarray
        Output [m], scaled to the amplitude of the first recording.
    delays : tuple of float
        Lag of each recording [s].
    gains : tuple of float
        max |y| of each recording [m]: what the linear part makes of the amplitude.
    """

    voltage: tuple[np.ndarray, ...]
    displacement: tuple[np.ndarray, ...]
    delays: tuple[float, ...]
    gains: tuple[float, ...]


def reversal_delay(voltage, displacement, sample_time: float, longest: float | None = None) -> float:
    """Return by how much the reversals of the displacement come after those of the voltage [s] (Δt of W2).

    Rate-independent hysteresis turns where its input turns, a lag turns later. Around each reversal the displacement is
    described by one parabola of the voltage before and one after it, which meet in the corner; the delay of the voltage
    with which this leaves the least is the lag. The lag of the first harmonic alone would count the hysteresis too.

    Parameters
    ----------
    voltage, displacement : array_like, shape (N,)
        [V], [m].
    sample_time : float
        [s]
    longest : float, optional
        Longest lag that is tried [s]; by default a quarter of the mean time between reversals.

    Raises
    ------
    IdentificationError
        There is no reversal with enough samples on both sides.
    """
    from scipy.optimize import minimize_scalar  # imported here because only fits need it

    voltage, displacement = checked_signals(voltage, displacement)
    branches = split_branches(voltage)
    turns = [
        (before, after)
        for before, after in zip(branches[:-1], branches[1:], strict=True)
        if min(len(before), len(after)) * WINDOW >= FEWEST_BRANCH_SAMPLES
    ]
    if not turns:
        raise IdentificationError(
            f"no reversal of the voltage has {FEWEST_BRANCH_SAMPLES / WINDOW:.0f} samples on both sides; sample faster "
            "or record whole cycles"
        )
    if longest is None:
        longest = 0.25 * sample_time * float(np.mean([len(branch) for turn in turns for branch in turn]))
    samples = np.arange(voltage.size)

    def misfit(delay):
        shift = delay / sample_time
        total = 0.0
        for before, after in turns:
            turn = before.stop + shift
            first = max(int(turn - WINDOW * len(before)), 0)
            last = min(int(turn + WINDOW * len(after)) + 1, voltage.size)
            k = samples[first:last]
            v = np.interp(k - shift, samples, voltage) - voltage[before.stop]
            v /= np.max(np.abs(v)) or 1.0
            left, right = v * (k < turn), v * (k >= turn)
            rows = np.stack([np.ones(k.size), left, left * v, right, right * v], axis=1)
            y = displacement[first:last]
            error = rows @ np.linalg.lstsq(rows, y, rcond=None)[0] - y
            total += float(error @ error)
        return total

    grid = np.linspace(0.0, longest, LAG_CANDIDATES)
    best = int(np.argmin([misfit(delay) for delay in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, LAG_CANDIDATES - 1)]
    return float(minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * sample_time}).x)


def prepare_loops(recordings, sample_time: float, delays=None) -> PreparedLoops:
    """Shift each input by the lag of its recording and give all outputs the amplitude of the first (W2).

    Loops of one amplitude at different frequencies then coincide, if hysteresis is rate independent. Recordings of
    different amplitude must not be mixed here: the scaling would hide how hysteresis depends on the amplitude.

    Parameters
    ----------
    recordings : sequence of (voltage, displacement)
        [V], [m], one pair for each frequency.
    sample_time : float
        [s]
    delays : sequence of float, optional
        Lags [s]; found by :func:`reversal_delay` when not given.

    Raises
    ------
    IdentificationError
        A recording cannot be used, or amplitudes of the voltage differ.
    """
    pairs = [checked_signals(*pair) for pair in recordings]
    if not pairs:
        raise IdentificationError("no recording was given")
    swings = np.array([np.ptp(voltage) for voltage, _ in pairs])
    if swings.max() > 1.05 * swings.min():
        raise IdentificationError(
            f"voltage ranges of {swings.min():g} and {swings.max():g} V: normalising would hide how hysteresis depends "
            "on the amplitude; prepare recordings of one amplitude together"
        )
    if delays is None:
        delays = [reversal_delay(voltage, displacement, sample_time) for voltage, displacement in pairs]
    shifted, scaled, gains = [], [], []
    for (voltage, displacement), delay in zip(pairs, delays, strict=True):
        shift = delay / sample_time
        first = int(np.ceil(shift))
        k = np.arange(voltage.size)
        gains.append(float(np.max(np.abs(displacement))))
        shifted.append(np.interp(k[first:] - shift, k, voltage))
        scaled.append(displacement[first:] * (gains[0] / gains[-1]))
    return PreparedLoops(tuple(shifted), tuple(scaled), tuple(map(float, delays)), tuple(gains))


@dataclass(frozen=True)
class MajorLoop:
    """Both branches of the largest loop on one grid, normalised to -1 … 1.

    Parameters
    ----------
    grid : ndarray, shape (n,)
        Inputs.
    rising, falling : ndarray, shape (n,)
        Outputs at the inputs ``grid``.
    input_low, input_high, output_low, output_high : float
        What -1 and +1 stand for.
    gap : float
        By how much the branches miss each other at the worse end, in parts of the output range.
    noise : float
        Standard error of the grid values (normalised), from the scatter of the samples around the branches.
    """

    grid: np.ndarray
    rising: np.ndarray
    falling: np.ndarray
    input_low: float
    input_high: float
    output_low: float
    output_high: float
    gap: float
    noise: float

    @property
    def opening(self) -> float:
        """Largest opening, in parts of the output range."""
        return 0.5 * float(np.max(np.abs(self.falling - self.rising)))

    def input(self, u) -> np.ndarray:
        """Return inputs ``u`` normalised."""
        return (np.asarray(u) - self.input_low) * (2.0 / (self.input_high - self.input_low)) - 1.0

    def output(self, y) -> np.ndarray:
        """Return outputs ``y`` normalised."""
        return (np.asarray(y) - self.output_low) * (2.0 / (self.output_high - self.output_low)) - 1.0


def major_loop(inputs, outputs) -> MajorLoop:
    """Return the branches between the ends of the input range, averaged over all cycles and recordings.

    The very first branch of a recording comes from rest, not from the loop; it counts only where nothing else is there.

    Parameters
    ----------
    inputs, outputs : sequence of ndarray
        One or several recordings.

    Raises
    ------
    IdentificationError
        There is no rising or no falling branch from end to end.
    """
    low, high = min(u.min() for u in inputs), max(u.max() for u in inputs)
    near = NEAR_END * (high - low)
    kept = {True: [], False: []}
    spare = {True: [], False: []}
    for u, y in zip(inputs, outputs, strict=True):
        branches = split_branches(u)
        require_both_directions(branches, "loop model")
        for place, branch in enumerate(branches):
            if branch.low < low + near and branch.high > high - near and len(branch) >= FEWEST_BRANCH_SAMPLES:
                store = spare if place == 0 and branch.start == 0 else kept
                store[branch.rising].append((u[branch.samples], y[branch.samples]))
    for rising, name in ((True, "rising"), (False, "falling")):
        kept[rising] = kept[rising] or spare[rising]
        if not kept[rising]:
            raise IdentificationError(
                f"no {name} branch runs from {low:g} to {high:g}, the ends of the input range; a Duhem model needs one "
                "whole major loop: record at least one and a half cycles of full amplitude"
            )
    ends = np.array([(v.min(), v.max()) for side in kept.values() for v, _ in side])
    v_low, v_high = float(np.median(ends[:, 0])), float(np.median(ends[:, 1]))
    shortest = min(sum(v.size for v, _ in side) for side in kept.values())
    grid = np.linspace(-1.0, 1.0, int(np.clip(shortest // 3, COARSEST_GRID, GRID)))
    sides, scatter, used = {}, 0.0, 0
    for rising, side in kept.items():
        v, y = (np.concatenate(part) for part in zip(*side, strict=True))
        v = (v - v_low) * (2.0 / (v_high - v_low)) - 1.0
        sides[rising], misfit = _on_grid(grid, v, y)
        scatter, used = scatter + misfit, used + v.size
    up, down = sides[True], sides[False]
    bottom, top = 0.5 * (up[0] + down[0]), 0.5 * (up[-1] + down[-1])
    if not top > bottom:
        raise IdentificationError("the output falls while the input rises; change the sign of one column")
    scale = 2.0 / (top - bottom)
    deviation = np.sqrt(scatter / max(used - 2 * grid.size, 1))
    return MajorLoop(
        grid=grid,
        rising=(up - bottom) * scale - 1.0,
        falling=(down - bottom) * scale - 1.0,
        input_low=v_low,
        input_high=v_high,
        output_low=float(bottom),
        output_high=float(top),
        gap=0.5 * scale * float(max(abs(up[0] - down[0]), abs(up[-1] - down[-1]))),
        noise=float(scale * deviation * np.sqrt(2 * grid.size / used)),
    )


def _on_grid(grid, v, y):
    """Return the polygon over ``grid`` nearest to the samples, and its sum of squares; empty places are bridged."""
    from scipy.linalg import solveh_banded  # imported here because only fits need it

    n = grid.size
    place = np.clip((v + 1.0) * (0.5 * (n - 1)), 0.0, n - 1.0)
    i = np.minimum(place.astype(int), n - 2)
    t = place - i
    middle = float(np.mean(y))
    z = y - middle
    bands = np.zeros((3, n))
    bands[2] = np.bincount(i, (1.0 - t) ** 2, n) + np.bincount(i + 1, t * t, n)
    bands[1, 1:] = np.bincount(i, t * (1.0 - t), n)[: n - 1]
    right = np.bincount(i, (1.0 - t) * z, n) + np.bincount(i + 1, t * z, n)
    # a whiff of straightness makes the system regular where there are no samples
    stiffness = 1e-6 * v.size / n
    for offsets, value in (((0, 0), 1.0), ((1, 1), 4.0), ((2, 2), 1.0)):
        bands[2, offsets[0] : n - 2 + offsets[0]] += stiffness * value
    bands[1, 1 : n - 1] -= 2.0 * stiffness
    bands[1, 2:n] -= 2.0 * stiffness
    bands[0, 2:] += stiffness
    values = solveh_banded(bands, right)
    error = values[i] * (1.0 - t) + values[i + 1] * t - z
    return values + middle, float(error @ error)
