# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Steps: levels at given times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.references.declaration import COUNTER, END, FINAL, OFFSET, OWN, Packed, WaveformShape, head, refuse

COUNT, REPEAT, TABLE = OWN, OWN + 1, OWN + 2  # number of entries, period [samples] (0: none), starts and levels


@dataclass(frozen=True)
class StepsParameters(Parameters):
    """Levels at given times; zero before the first time; the last level is held."""

    values: tuple[float, ...] = parameter(description="levels, added to the offset", unit="m")
    times: tuple[float, ...] = parameter(description="start times of the levels, increasing", unit="s", low=0.0)
    period: float = parameter(
        0.0, description="time after which the levels repeat, to the nearest sample; 0 = never", unit="s", low=0.0
    )

    def check(self):
        """Yield a Problem if the numbers of times and values differ, the order is wrong, or the period is too short."""
        if not self.values or len(self.values) != len(self.times):
            yield Problem(
                "times", self.times, f"must have one time for each of the {len(self.values)} values, and at least one"
            )
        elif any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            yield Problem("times", self.times, "must grow strictly")
        elif self.period and self.period <= self.times[-1]:
            yield Problem(
                "period",
                self.period,
                f"must be 0 (the levels do not repeat) or > {self.times[-1]:g} s, the last entry of times",
            )


@kernel
def steps(p, x, u):
    """Return value i from its start sample on, and zero before the first start; a binary search finds i."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    if p[REPEAT] > 0.0:
        k = k % p[REPEAT]
    count = int(p[COUNT])
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if p[TABLE + middle] <= k:
            low = middle + 1
        else:
            high = middle
    return p[OFFSET] if low == 0 else p[OFFSET] + p[TABLE + count + low - 1]


def pack(parameters, sample_time: float) -> Packed:
    """Return the levels with the samples at which they begin.

    Raises
    ------
    ParameterError
        Two times are less than a sample apart.
    """
    own, p = parameters.steps, head(parameters)
    # the first sample at or after each time; a rounding error of t/Ts must not delay a level
    starts = np.ceil(np.array(own.times) / sample_time - 1e-6)
    repeat = round(own.period / sample_time)
    if np.any(np.diff(starts) <= 0.0) or 0 < repeat <= starts[-1]:
        refuse(
            "steps.times",
            own.times,
            f"must be at least one sample ({sample_time:g} s) apart, and at least one sample before the period",
        )
    levels = np.array(own.values)
    reached = np.append(levels, 0.0) if starts[0] > 0.0 else levels
    p[END] = parameters.cycles * repeat
    p[FINAL] = parameters.offset + levels[-1]
    return Packed(
        np.concatenate([p, [len(own.values), repeat], starts, levels]),
        steps,
        parameters.offset + float(np.min(reached)),
        parameters.offset + float(np.max(reached)),
        repeat if repeat and not parameters.cycles else None,
    )


def duration(p) -> int:
    """Return the length in samples; the last level is assumed to last as long as the previous level."""
    if p[REPEAT] != 0.0:
        return int(p[END])
    starts = p[TABLE : TABLE + int(p[COUNT])]
    return int(2 * starts[-1] - starts[-2]) if starts.size > 1 else 0


WAVEFORM = WaveformShape(
    name="steps",
    jumps=True,
    pack=pack,
    parameters=StepsParameters,
    takes_frequency=False,
    takes_phase=False,
    extent="steps.values",
    duration=duration,
    example=StepsParameters(values=(1e-6, 3e-6), times=(0.1, 0.2), period=0.5),
)
