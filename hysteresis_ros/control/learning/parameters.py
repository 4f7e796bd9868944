# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters of the learned correction."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import Parameters, parameter

#: Most taps of a filter, and the longest period [samples].
MOST_TAPS, LONGEST = 256, 100_000
#: A period this close to whole samples, in samples, is one of whole samples.
WHOLE = 1e-6


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """What is learned from one period of the reference to the next, and how."""

    type: str = parameter(
        "none",
        choices=("none", "inversion", "norm_optimal", "repetitive"),
        read_only=True,
        description="none, or how the filters were designed (hysteresis design --learning): as the inverse of the "
        "closed loop, by weights on error and correction, or as a repetitive controller with phase lead",
    )
    period: float = parameter(
        0.0, unit="s", low=0.0, read_only=True, description="period of the reference, a whole number of samples"
    )
    error_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of Q L, from the one on the furthest error ahead to the one on the oldest",
    )
    lead: int = parameter(
        0, low=0, high=LONGEST, read_only=True, description="samples that the first tap of error_filter looks ahead"
    )
    robustness_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of Q, of zero phase: the one in the middle, then those on both of its sides",
    )
    gain: float = parameter(
        1.0, low=0.0, high=1.0, description="part of what a period has shown that goes into the correction, at first"
    )
    averaging: float = parameter(
        0.0, low=0.0, high=1e6, description="n: in the j-th period of learning the gain is at most n / j; 0: it stays"
    )
    least_gain: float = parameter(0.0, low=0.0, high=1.0, description="below this the gain does not fall")
    maximum: float = parameter(
        0.0, unit="m", low=0.0, high=1.0, description="largest correction of the reference, either way"
    )
    shortfall: float = parameter(
        1e-7,
        unit="m",
        low=0.0,
        high=1.0,
        description="nothing is learned while what is carried out of the command differs from it by more",
    )
    recovery: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1e3,
        description="nor so long after that, while the axis still answers to it",
    )
    late_recovery: float = parameter(
        -1.0,
        unit="s",
        low=-1.0,
        high=1e3,
        description="nor so long after a voltage that came too late: one sample is a small knock; below 0: as recovery",
    )
    active: bool = parameter(True, description="whether it learns from the beginning; `learn` and `freeze` change it")
    file: str = parameter(
        "", read_only=True, description="file of what was learned, to begin with; '': nothing", place="files"
    )
    save_file: str = parameter(
        "", read_only=True, description="file that the service `save` writes; '': none", place="files"
    )

    @property
    def in_use(self) -> bool:
        """Whether there is a correction."""
        return self.type != "none"

    @property
    def late_answer(self) -> float:
        """Time [s] after a voltage that came too late in which nothing is learned."""
        return self.late_recovery if self.late_recovery >= 0.0 else self.recovery

    def check(self):
        """Yield what does not fit together."""
        if not self.in_use:
            return
        if not self.period:
            yield Problem("period", self.period, "missing; give the period of the reference [s]")
        if not self.maximum:
            yield Problem("maximum", self.maximum, "missing; give the largest correction [m]")
        for name in ("error_filter", "robustness_filter"):
            taps = getattr(self, name)
            if not 1 <= len(taps) <= MOST_TAPS:
                allowed = f"must be 1 … {MOST_TAPS} taps; `hysteresis design --learning {self.type}` finds them"
                yield Problem(name, taps, allowed)


def period_samples(period: float, sample_rate: float, name: str = "learning.period") -> int:
    """Return a period in samples.

    Parameters
    ----------
    period : float
        [s]
    sample_rate : float
        [Hz]
    name : str
        Of the parameter, for the message.

    Raises
    ------
    ParameterError
        It is no whole number of samples, too short, or too long.
    """
    samples = period * sample_rate
    count = round(samples)
    if abs(samples - count) > WHOLE * max(samples, 1.0):
        low, high = (whole / sample_rate for whole in (int(samples), int(samples) + 1))
        allowed = (
            f"is {samples:.6g} samples; must be a whole number of them: the nearest at {sample_rate:g} Hz are "
            f"{low:.9g} s ({1.0 / low:.9g} Hz) and {high:.9g} s ({1.0 / high:.9g} Hz)"
            if low
            else f"is shorter than a sample at {sample_rate:g} Hz"
        )
        raise ParameterError([Problem(name, period, allowed)])
    if not 2 <= count <= LONGEST:
        raise ParameterError([Problem(name, period, f"is {count} samples; must be 2 … {LONGEST}")])
    return count
