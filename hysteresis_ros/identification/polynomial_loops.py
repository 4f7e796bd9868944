# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loops of a recording as branch parabolas, before polynomials of the peak voltage are drawn through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.identification.branches import FEWEST_BRANCH_SAMPLES, split_branches

#: Peaks that differ by more than this part of the largest are different loops.
DIFFERENT_PEAKS = 0.02


@dataclass(frozen=True)
class LoopCoefficients:
    """Branch parabolas of one loop (eqs 1-2; figure 4 of the paper), SI units.

    Parameters
    ----------
    v_max : float
        Peak [V].
    D : float
        Lower corner D_r = D_f [m].
    C_r1, C_r2 : float
        Rising branch [m/V, m/V²]; NaN where the recording does not rise again after this peak.
    C_f1, C_f2 : float
        Falling branch.
    rms : float
        Residual [m].
    """

    v_max: float
    D: float
    C_r1: float
    C_r2: float
    C_f1: float
    C_f2: float
    rms: float


def loop_table(voltage, displacement, branches):
    """Return the loops (normalised units) and the virgin samples as (v, x)."""
    loops, virgin, reached = [], [], 0.0
    for place, branch in enumerate(branches):
        if not branch.rising or branch.high <= reached:
            continue
        rise = slice(branch.start, branch.stop + 1)
        fresh = voltage[rise] >= reached
        virgin.append(np.stack([voltage[rise][fresh], displacement[rise][fresh]]))
        grown = branch.high > (1.0 + DIFFERENT_PEAKS) * reached
        reached = branch.high
        after = branches[place + 1 : place + 3]
        if not grown or not after or len(after[0]) < FEWEST_BRANCH_SAMPLES:
            continue
        fall, again = after[0], after[1] if len(after) == 2 and len(after[1]) >= FEWEST_BRANCH_SAMPLES else None
        loops.append(_one_loop(voltage, displacement, reached, fall, again))
    return loops, np.concatenate(virgin, axis=1) if virgin else np.zeros((2, 0))


def _one_loop(voltage, displacement, v_max, fall, rise) -> LoopCoefficients:
    """Fit D, the upper corner X and the bends: x = D + (X - D) V/V_max + C2 V (V - V_max) on each branch."""
    parts = [(2, fall)] + ([(3, rise)] if rise is not None else [])
    rows, wanted = [], []
    for column, branch in parts:
        v, x = voltage[branch.samples], displacement[branch.samples]
        below = v <= v_max
        v = v[below]
        matrix = np.zeros((v.size, 4))
        matrix[:, 0], matrix[:, 1], matrix[:, column] = 1.0 - v / v_max, v / v_max, v * (v - v_max)
        rows.append(matrix)
        wanted.append(x[below])
    matrix, wanted = np.concatenate(rows), np.concatenate(wanted)
    found = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    corner, top, c_f2, c_r2 = found
    rms = float(np.sqrt(np.mean((matrix @ found - wanted) ** 2)))
    mean = (top - corner) / v_max
    if rise is None:
        c_r2 = np.nan
    return LoopCoefficients(v_max, corner, mean - c_r2 * v_max, c_r2, mean - c_f2 * v_max, c_f2, rms)


def distinct_peaks(v, reversal) -> list[float]:
    """Return the values V_max takes, those that hardly differ once."""
    peaks = []
    for branch in split_branches(v, reversal):
        if branch.high > (1.0 + DIFFERENT_PEAKS) * (peaks[-1] if peaks else 0.0):
            peaks.append(branch.high)
    return peaks


def in_units(loop, v_unit, x_unit) -> LoopCoefficients:
    """Return a loop in SI units that was fitted in units of ``v_unit`` [V] and ``x_unit`` [m]."""
    one, two = x_unit / v_unit, x_unit / v_unit**2
    return LoopCoefficients(
        v_max=float(loop.v_max * v_unit),
        D=float(loop.D * x_unit),
        C_r1=float(loop.C_r1 * one),
        C_r2=float(loop.C_r2 * two),
        C_f1=float(loop.C_f1 * one),
        C_f2=float(loop.C_f2 * two),
        rms=float(loop.rms * x_unit),
    )
