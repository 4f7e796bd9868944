"""What stands behind the hysteresis in a Hammerstein model: creep, a first-order lag and a delay.

Between samples the displacement is taken as straight, so that lags shorter than a sample are told apart. The filters
act on whole columns of regressors at once (their response is convolved by FFT), which makes fits of hysteresis and
dynamics together cheap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal

from hysteresis_ros.models.creep import CreepParameters, LogarithmicCreepParameters
from hysteresis_ros.models.linear import LinearParameters

#: A lag below this part of the sample time is none.
SHORTEST_LAG = 0.02
#: A creep rate below this is none.
SMALLEST_RATE = 1e-5


def first_order_hold(x, time_constant: float, sample_time: float) -> np.ndarray:
    """Return ``x``, shape (N, ...), behind a lag 1/(τ s + 1), straight between the samples and at rest at zero before.

    Parameters
    ----------
    x : ndarray, shape (N, ...)
    time_constant : float
        τ [s].
    sample_time : float
        [s]
    """
    if time_constant <= SHORTEST_LAG * sample_time:
        return np.array(x, dtype=float)
    decay = np.exp(-sample_time / time_constant)
    part = -np.expm1(-sample_time / time_constant) * time_constant / sample_time
    return scipy.signal.lfilter([1.0 - part, part - decay], [1.0, -decay], x, axis=0)


@dataclass(frozen=True)
class LinearPart:
    """Creep, lag and delay behind a hysteresis.

    Parameters
    ----------
    lag : float
        Time constant τ [s].
    delay : float
        Dead time [s].
    creep_rate : float
        γ of the logarithmic law, a decade.
    longest_time : float
        Time up to which the creep law holds [s].
    settled : bool
        Creep had settled under the first sample; otherwise everything was at rest at zero before it.
    """

    lag: float = 0.0
    delay: float = 0.0
    creep_rate: float = 0.0
    longest_time: float = 100.0
    settled: bool = False

    @property
    def creep(self) -> CreepParameters:
        """Parameters of the creep block."""
        if self.creep_rate < SMALLEST_RATE:
            return CreepParameters()
        law = LogarithmicCreepParameters(rate=float(self.creep_rate), longest_time=float(self.longest_time))
        return CreepParameters(type="logarithmic", logarithmic=law)

    def impulse(self, samples: int, sample_time: float) -> np.ndarray:
        """Return the response, shape (samples,), to one sample of 1 between zeros.

        Parameters
        ----------
        samples : int
        sample_time : float
            [s]
        """
        unit = np.zeros(samples)
        unit[0] = 1.0
        feedthrough, weights, time_constants = self.creep.resolved()
        response = feedthrough * unit
        for weight, time_constant in zip(weights, time_constants, strict=True):
            response += weight * first_order_hold(unit, time_constant, sample_time)
        response = first_order_hold(response, self.lag, sample_time)
        if self.delay > 0.0:
            place = np.arange(samples) - self.delay / sample_time
            response = np.interp(place, np.arange(-1, samples), np.append(0.0, response))
        return response

    def apply(self, columns, sample_time: float) -> np.ndarray:
        """Return the columns, shape (N,) or (N, m), behind the linear part.

        Parameters
        ----------
        columns : ndarray, shape (N,) or (N, m)
        sample_time : float
            [s]
        """
        columns = np.asarray(columns, dtype=float)
        first = columns[:1] if self.settled else np.zeros_like(columns[:1])
        response = self.impulse(len(columns), sample_time)
        shaped = response if columns.ndim == 1 else response[:, None]
        moved = scipy.signal.fftconvolve(columns - first, shaped, axes=0)[: len(columns)]
        return moved + first * self.settled_gain

    @property
    def settled_gain(self) -> float:
        """Gain after an infinite time: feedthrough and all creep operators."""
        feedthrough, weights, _ = self.creep.resolved()
        return feedthrough + float(np.sum(weights))

    def dynamics(self, sample_time: float) -> LinearParameters:
        """Return lag and delay as the discrete block that a node runs, whose input is held between samples.

        Holding delays by half a sample by itself, which is taken off the delay and then off the lag.

        Parameters
        ----------
        sample_time : float
            [s]
        """
        delay = self.delay - 0.5 * sample_time
        lag = max(self.lag + min(delay, 0.0), 0.0)
        delay = max(delay, 0.0) / sample_time
        decay = float(np.exp(-sample_time / lag)) if lag > SHORTEST_LAG * sample_time else 0.0
        whole = int(delay + 1e-9)
        part = delay - whole
        if whole == 0 and part < 1e-9:
            return LinearParameters() if decay == 0.0 else _flat([[decay]], [1.0 - decay], [1.0])
        # states: the lag, then the last inputs, newest first
        order = whole + 2
        A, B, C = np.zeros((order, order)), np.zeros(order), np.zeros(order)
        A[0, 0], C[0], B[1] = decay, 1.0, 1.0
        for i in range(2, order):
            A[i, i - 1] = 1.0
        for steps, share in ((whole, 1.0 - part), (whole + 1, part)):
            if steps == 0:
                B[0] += (1.0 - decay) * share
            else:
                A[0, steps] += (1.0 - decay) * share
        return _flat(A, B, C)


def _flat(A, B, C) -> LinearParameters:
    return LinearParameters(A=tuple(np.ravel(A).tolist()), B=tuple(np.ravel(B).tolist()), C=tuple(np.ravel(C).tolist()))
