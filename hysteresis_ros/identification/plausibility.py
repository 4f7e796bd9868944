# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Numbers that a hysteretic actuator hardly has: units that were mistaken, and loops of too few samples."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hysteresis_ros.units import readable

#: Range of the voltage [V], of the displacement [m] and of both together [m/V] that are not asked about.
VOLTAGES = (0.02, 2000.0)
STROKES = (5e-9, 2e-3)
GAINS = (1e-9, 2e-4)
#: Distance of two samples and duration of all [s] that are not asked about.
LONGEST_SAMPLE_TIME = 0.5
SHORTEST_DURATION = 0.1
LONGEST_CYCLE = 500.0
#: Samples a cycle below which the turning points of its loops are not seen.
FEWEST_A_CYCLE = 20.0


def implausible_units(
    sample_time: float, duration: float, u, y, units: tuple[str, str], reversals: int
) -> Iterator[str]:
    """Yield a question for each number that suggests a mistaken unit, with the number.

    Parameters
    ----------
    sample_time, duration : float
        [s]
    u, y : ndarray
        Input and output in SI.
    units : (str, str)
        SI units of input and output; only V and m are asked about.
    reversals : int
        How often the input turns.
    """
    span, stroke = float(np.ptp(u)), float(np.ptp(y))
    gain = stroke / span if span > 0.0 else math.nan
    if units[0] == "V" and not VOLTAGES[0] <= span <= VOLTAGES[1]:
        other = "V instead of mV" if span < VOLTAGES[0] else "mV instead of V"
        yield f"the voltage spans {readable(span, 'V')}: is its unit {other}? give it as --input NAME:UNIT"
    odd = not STROKES[0] <= stroke <= STROKES[1] or (units[0] == "V" and not GAINS[0] <= gain <= GAINS[1])
    if units[1] == "m" and odd:
        small = stroke < STROKES[0] or gain < GAINS[0]
        other = "um instead of nm (or V of mV)" if small else "um instead of mm (or V instead of mV)"
        each = f", {readable(gain, 'm')}/V" if units[0] == "V" else ""
        yield f"the output moves by {readable(stroke, 'm')}{each}: is its unit {other}? give it as --output NAME:UNIT"
    cycle = 2.0 * duration / reversals if reversals > 1 else 0.0
    if sample_time > LONGEST_SAMPLE_TIME or cycle > LONGEST_CYCLE:
        yield (
            f"samples lie {sample_time:.4g} s apart and a cycle takes {cycle:.4g} s: is the unit of time ms instead of "
            "s? give it as --time NAME:UNIT"
        )
    if duration < SHORTEST_DURATION:
        yield (
            f"all samples lie within {readable(duration, 's')}: is the unit of time s instead of ms? give it as --time "
            "NAME:UNIT"
        )


def few_samples_a_cycle(samples: float, reversals: int) -> Iterator[str]:
    """Yield a warning when turning points fall between the samples.

    Parameters
    ----------
    samples : float
        In all.
    reversals : int
        Of the input.
    """
    if reversals < 2:
        return
    each = 2.0 * samples / reversals
    if each < FEWEST_A_CYCLE:
        beyond = 50.0 * (1.0 - math.cos(math.pi / each))
        yield (
            f"{each:.3g} samples a cycle: a sine turns up to {beyond:.2g} % of its range beyond the nearest sample, so "
            f"loops are not seen to their ends; record at least {FEWEST_A_CYCLE:.0f} a cycle, or give --intersample"
        )
