# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The linear dynamics behind the hysteresis in a Hammerstein model: creep, a first-order lag, modes, and a delay.

The displacement is assumed linear between samples, which distinguishes lags shorter than a sample; dynamics identified
for the held voltage itself (``hold``) are exact for it. The filters act on whole columns of regressors at once
(convolution by FFT), which makes joint fits of hysteresis and dynamics fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.models.creep import CreepParameters, LogarithmicCreepParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, zero_order_hold

#: Smallest lag, as a part of the sample time; smaller ones are neglected.
SHORTEST_LAG = 0.02
#: A creep rate below this is neglected.
SMALLEST_RATE = 1e-5
#: Number of cached responses.
RESPONSES = 16


def first_order_hold(x, time_constant: float, sample_time: float) -> np.ndarray:
    """Return ``x``, shape (N, ...), behind a lag 1/(τ s + 1), linear between the samples and initially at rest at zero.

    Units: ``time_constant`` [s], ``sample_time`` [s].
    """
    if time_constant <= SHORTEST_LAG * sample_time:
        return np.array(x, dtype=float)
    decay = np.exp(-sample_time / time_constant)
    part = -np.expm1(-sample_time / time_constant) * time_constant / sample_time
    return scipy.signal.lfilter([1.0 - part, part - decay], [1.0, -decay], x, axis=0)


@dataclass(frozen=True)
class Mode:
    """One resonance: (position ω² + velocity ω s)/(s² + 2 ζ ω s + ω²), in parallel with the lag."""

    frequency: float  #: ω/2π [Hz], undamped.
    damping: float  #: ζ, below 1.
    #: position, velocity: Numerator; ``position`` is the part of the displacement at rest that passes through the
    #: mode.
    position: float = 1.0
    velocity: float = 0.0

    def state_space(self):
        """Return the continuous A, shape (2, 2), B, shape (2,), and C, shape (2,), in rad/s: a decaying rotation."""
        omega = 2.0 * np.pi * self.frequency
        real, turn = -self.damping * omega, omega * np.sqrt(1.0 - self.damping**2)
        A = np.array([[real, turn], [-turn, real]])
        return (
            A,
            np.array([0.0, omega]),
            np.array([(self.position * omega + self.velocity * real) / turn, self.velocity]),
        )


@dataclass(frozen=True)
class LinearPart:
    """Creep, then a lag in parallel with modes, then a delay."""

    lag: float = 0.0  #: Time constant τ [s].
    delay: float = 0.0  #: Dead time [s].
    creep_rate: float = 0.0  #: γ of the logarithmic law, per decade.
    longest_time: float = 100.0  #: Time up to which the creep law holds [s].
    #: Creep had settled under the first sample; otherwise everything was at rest at zero before it.
    settled: bool = False
    modes: tuple[Mode, ...] = ()  #: Modes; the remaining part of the displacement passes through the lag.
    #: Sample time of the held voltage [s] for which lag, modes and delay were identified; they are then those of the
    #: stage itself. 0: linear between the samples; the delay then includes the half sample of holding.
    hold: float = 0.0

    @property
    def creep(self) -> CreepParameters:
        """Parameters of the creep block."""
        if self.creep_rate < SMALLEST_RATE:
            return CreepParameters()
        law = LogarithmicCreepParameters(rate=float(self.creep_rate), longest_time=float(self.longest_time))
        return CreepParameters(type="logarithmic", logarithmic=law)

    def impulse(self, samples: int, sample_time: float) -> np.ndarray:
        """Return the response, shape (samples,), to one sample of 1 between zeros.

        Units: ``sample_time`` [s].
        """
        unit = np.zeros(samples)
        unit[0] = 1.0
        feedthrough, weights, time_constants = self.creep.resolved()
        response = feedthrough * unit
        for weight, time_constant in zip(weights, time_constants, strict=True):
            response += weight * first_order_hold(unit, time_constant, sample_time)
        if self.hold and abs(self.hold - sample_time) < 1e-6 * sample_time:
            block = LinearDynamics(self.dynamics(sample_time), sample_time)
            return np.append(block.output(), block.simulate(response)[:-1])
        behind = (1.0 - sum(mode.position for mode in self.modes)) * first_order_hold(response, self.lag, sample_time)
        for mode in self.modes:
            behind += _mode_filter(mode, response, sample_time)
        delay = self.delay + 0.5 * self.hold
        if delay > 0.0:
            place = np.arange(samples) - delay / sample_time
            behind = np.interp(place, np.arange(-1, samples), np.append(0.0, behind))
        return behind

    def apply(self, columns, sample_time: float) -> np.ndarray:
        """Return the columns, shape (N,) or (N, m), behind the linear part.

        Units: ``sample_time`` [s].
        """
        columns = np.asarray(columns, dtype=float)
        first = columns[:1] if self.settled else np.zeros_like(columns[:1])
        length, response = _spectrum(self, len(columns), sample_time)
        shaped = response if columns.ndim == 1 else response[:, None]
        spectra = scipy.fft.rfft(columns - first, length, axis=0)
        moved = scipy.fft.irfft(spectra * shaped, length, axis=0)[: len(columns)]
        return moved + first * self.settled_gain

    @property
    def group_delay(self) -> float:
        """Delay of slow movement [s], without creep."""
        omega = 2.0 * np.pi * np.array([mode.frequency for mode in self.modes])
        late = [2.0 * mode.damping * mode.position - mode.velocity for mode in self.modes]
        direct = 1.0 - sum(mode.position for mode in self.modes)
        return self.delay + direct * self.lag + float(np.sum(np.array(late) / omega))

    def synchronous(self, sample_time: float) -> bool:
        """Return whether each displacement belongs to the voltage of the same sample.

        Units: ``sample_time`` [s].
        """
        return not self.hold and self.lag + self.delay < 0.5 * sample_time

    @property
    def settled_gain(self) -> float:
        """Gain after an infinite time: feedthrough and all creep operators."""
        feedthrough, weights, _ = self.creep.resolved()
        return feedthrough + float(np.sum(weights))

    def dynamics(self, sample_time: float) -> LinearParameters:
        """Return lag, modes and delay as the discrete block of a node, whose input is held between samples.

        The delay by holding is subtracted from the delay, then from the lag, so that slow movement has the same delay.

        Units: ``sample_time`` [s].
        """
        lag, delay = (self.lag, self.delay) if self.hold else self._without_holding(sample_time)
        whole = int(delay / sample_time + 1e-9) if self.modes else 0
        part = max(delay / sample_time - whole, 0.0) if self.modes else 0.0
        A, B, C, through = self._continuous(lag if lag > SHORTEST_LAG * sample_time else 0.0)
        n = len(A)
        if part < 1e-9:
            A, B = zero_order_hold(A, B, sample_time) if n else (A, B)
            return _flat(A, B, C, through, sample_time, whole * sample_time if self.modes else delay)
        # the input may change within a sample: x⁺ = A x + late u_k + early u_(k-1), with u_(k-1) as a state
        step, both = zero_order_hold(A, B, sample_time)
        late = zero_order_hold(A, B, (1.0 - part) * sample_time)[1]
        A, B = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
        A[:n, :n], A[:n, n], A[n + 1, n] = step, (both - late)[:, 0], 1.0
        B[:n], B[n] = late[:, 0], 1.0
        C = np.concatenate([C, [through * (1.0 - part), through * part]])
        kept = slice(None) if through else slice(n + 1)
        return _flat(A[kept, kept], B[kept], C[kept], 0.0, sample_time, whole * sample_time)

    def _without_holding(self, sample_time: float) -> tuple[float, float]:
        """Return lag and delay behind a held input, read before it changes; its delay is T/(1 - e^(-T/τ)), not τ."""
        lag = self.lag if self.lag > SHORTEST_LAG * sample_time else 0.0
        late = sample_time / -np.expm1(-sample_time / lag) if lag else sample_time
        delay = self.lag + self.delay - late
        if delay >= 0.0:
            return lag, delay
        rest = (self.lag + self.delay) / sample_time - 1.0
        return (sample_time / np.log1p(1.0 / rest) if rest > 0.0 else 0.0), 0.0

    def _continuous(self, lag: float):
        """Return the continuous A, B, C of lag and modes, and the feedthrough."""
        direct = 1.0 - sum(mode.position for mode in self.modes)
        if abs(direct) < 1e-9:
            direct = 0.0
        blocks = [mode.state_space() for mode in self.modes]
        if lag and direct:
            blocks.insert(0, (np.array([[-1.0 / lag]]), np.array([1.0 / lag]), np.array([direct])))
            direct = 0.0
        if not blocks:
            return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros(0), direct
        A = scipy.linalg.block_diag(*(block[0] for block in blocks))
        B, C = (np.concatenate([block[i] for block in blocks]) for i in (1, 2))
        return A, B[:, None], C, direct


@lru_cache(maxsize=RESPONSES)
def _spectrum(part: LinearPart, samples: int, sample_time: float) -> tuple[int, np.ndarray]:
    """Return the length of the transforms and that of the response; cached for searches."""
    length = scipy.fft.next_fast_len(2 * samples - 1, real=True)
    return length, scipy.fft.rfft(part.impulse(samples, sample_time), length)


class Known(NamedTuple):
    """A known linear part for the fit of a hysteresis."""

    part: LinearPart
    parts: tuple[str, ...] = ()  #: Parts of lag, delay and creep that are searched nevertheless.


def _mode_filter(mode: Mode, x, sample_time: float) -> np.ndarray:
    """Return ``x`` behind a mode, linear between the samples."""
    A, B, C = mode.state_space()
    system = scipy.signal.cont2discrete((A, B[:, None], C[None], np.zeros((1, 1))), sample_time, method="foh")
    numerator, denominator = scipy.signal.ss2tf(*system[:4])
    return scipy.signal.lfilter(np.ravel(numerator), denominator, x)


def _flat(A, B, C, D: float, sample_time: float, delay: float) -> LinearParameters:
    A, B, C = (tuple(np.ravel(value).tolist()) for value in (A, B, C))
    if not A and not delay:
        return LinearParameters()
    return LinearParameters(A, B, C, D=(float(D),) if D else (), sample_time=sample_time, delay=float(delay))
