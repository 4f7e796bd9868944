# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is asked of every candidate: the conditions, and references that are known at every instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import ParameterError, Problem

#: Time before the first judged sample: creep and history of the start have died away then [s], and least periods.
SETTLING = 2.0
SETTLING_PERIODS = 2
#: Least periods before the first judged sample of who learns from one to the next.
LEARNING_PERIODS = 10
#: Time judged [s], and least periods.
JUDGED = 4.0
JUDGED_PERIODS = 4
#: The longest constant delay of the displacement that is forgiven, as a part of the fastest reference's period.
ALLOWED_DELAY = 0.1


@dataclass(frozen=True)
class Conditions:
    """What every candidate has to live with.

    Parameters
    ----------
    mismatch : float
        Largest relative deviation of each parameter of the plants.
    noise : float
        Sensor noise [m rms].
    bits : int
        Resolution of the converter; 0: unlimited.
    draws : int
        Number of plants around the configured one.
    others : int
        Number of plants of other classes.
    seed : int
        Seed of the first plant; the others follow.
    robust : bool
        Whether sliding modes are designed for the worst of plants as far from the model as the mismatch, and a sample
        later.
    sine_frequency, triangle_frequency : float
        Frequencies of the two references [Hz].
    sine_stroke, triangle_stroke : float
        Their peak-to-peak parts of the stroke.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    mismatch: float = 0.05
    noise: float = 5e-9
    bits: int = 16
    draws: int = 20
    others: int = 4
    seed: int = 1
    robust: bool = False
    sine_frequency: float = 1.0
    triangle_frequency: float = 10.0
    sine_stroke: float = 0.9
    triangle_stroke: float = 0.2

    def __post_init__(self):
        """Refuse conditions that describe no experiment."""
        allowed = {
            "mismatch": (0.0 <= self.mismatch <= 0.5, "must be within 0 … 0.5"),
            "noise": (0.0 <= self.noise < 1.0, "must be a noise in metres, 0 or more"),
            "bits": (0 <= self.bits <= 32, "must be within 0 … 32 (0: unlimited)"),
            "draws": (0 <= self.draws <= 10000, "must be within 0 … 10000 (0: none)"),
            "others": (0 <= self.others <= 1000, "must be within 0 … 1000 (0: none)"),
            "seed": (self.seed >= 0, "must be 0 or more"),
            "sine": (0.0 < self.sine_frequency < np.inf, "must be a frequency in Hz above 0"),
            "triangle": (0.0 < self.triangle_frequency < np.inf, "must be a frequency in Hz above 0"),
        }
        values = {"sine": self.sine_frequency, "triangle": self.triangle_frequency}
        problems = [
            Problem(name, values.get(name, getattr(self, name, None)), text)
            for name, (good, text) in allowed.items()
            if not good
        ]
        if problems:
            raise ParameterError(problems)

    @property
    def longest_delay(self) -> float:
        """The longest constant delay that a row is judged with [s]."""
        return ALLOWED_DELAY / max(self.sine_frequency, self.triangle_frequency)

    def require_slow(self, sample_rate: float) -> None:
        """Refuse references that are too fast for the samples.

        Parameters
        ----------
        sample_rate : float
            [Hz]

        Raises
        ------
        ParameterError
            A frequency is above a tenth of the sample rate.
        """
        for name in ("sine", "triangle"):
            frequency = getattr(self, f"{name}_frequency")
            if frequency > 0.1 * sample_rate:
                allowed = f"must be at most a tenth of the sample rate, {0.1 * sample_rate:g} Hz"
                raise ParameterError([Problem(name, frequency, allowed)])


@dataclass(frozen=True)
class Task:
    """A reference that the candidates follow.

    Parameters
    ----------
    name : str
        In words.
    waveform : str
        ``sine`` or ``triangle``.
    frequency : float
        [Hz]
    low, high : float
        Ends [m].
    periods : int
        Least number of them before the first judged sample.
    """

    name: str
    waveform: str
    frequency: float
    low: float
    high: float
    periods: int = SETTLING_PERIODS

    @property
    def settling(self) -> float:
        """Time before judging [s], whole periods."""
        return np.ceil(max(SETTLING * self.frequency, self.periods)) / self.frequency

    @property
    def duration(self) -> float:
        """Length of a run [s], whole periods."""
        return self.settling + np.ceil(max(JUDGED * self.frequency, JUDGED_PERIODS)) / self.frequency

    def overrides(self) -> dict:
        """Return the parameters of the reference generator; both begin at their lower end, which is its setpoint."""
        half = 0.5 * (self.high - self.low)
        values = {
            "minimum": min(self.low, 0.0) - half,
            "maximum": self.high + half,
            "initial_setpoint": self.low,
            "waveform.type": self.waveform,
            "waveform.frequency": self.frequency,
            "waveform.cycles": 0,
        }
        if self.waveform == "sine":
            return {**values, "waveform.amplitude": half, "waveform.offset": half, "waveform.phase": -0.5 * np.pi}
        return {**values, "waveform.amplitude": 2.0 * half, "waveform.offset": 0.0}

    def reference(self, time) -> np.ndarray:
        """Return the reference [m] at any instants, also between the samples.

        Parameters
        ----------
        time : array_like
            [s] since the start.
        """
        turns = self.frequency * np.asarray(time)
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        if self.waveform == "sine":
            return middle - half * np.cos(2.0 * np.pi * turns)
        return self.high - 2.0 * half * np.abs(1.0 - 2.0 * (turns - np.floor(turns)))


def make_tasks(conditions: Conditions, reach: tuple[float, float]) -> tuple[Task, ...]:
    """Return the two references within a range of displacements.

    Parameters
    ----------
    conditions : Conditions
    reach : (float, float)
        Ends [m].
    """
    low, high = reach
    middle, stroke = 0.5 * (low + high), high - low

    def task(words, waveform, frequency, fraction):
        half = 0.5 * fraction * stroke
        name = f"{frequency:g} Hz {words}, {100.0 * fraction:g} % of stroke"
        return Task(name, waveform, frequency, middle - half, middle + half)

    return (
        task("sine", "sine", conditions.sine_frequency, conditions.sine_stroke),
        task("triangle", "triangle", conditions.triangle_frequency, conditions.triangle_stroke),
    )
