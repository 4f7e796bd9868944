# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Exact sampled simulation of continuous transfer functions, with the input held, straight or band-limited between."""

from __future__ import annotations

import numpy as np
import scipy

from hysteresis_ros.identification.state_space import FitError, LinearModel, final_state, propagate

#: How an input may run between its samples; ``linear`` is another word for ``foh``.
INTERSAMPLE = ("zoh", "foh", "linear", "bandlimited")
#: Where the state of a simulation may start.
KNOWN_STARTS = ("zero", "rest", "periodic")
#: Points a sample that a band-limited input is reconstructed at.
FINER = 8


class CanonicalSimulation:
    """The responses of ``sⁱ/denominator`` to an input, from which every numerator's response is a sum.

    The states of the controllable form are these responses. Time is scaled with the geometric mean of the poles, so
    that the matrix is well scaled for a mirror of 2 kHz and a creep of an hour alike.

    Parameters
    ----------
    denominator : array_like, shape (n + 1,)
        1, a_(n-1) … a_0.
    sample_time : float
        [s]
    intersample : str
        See :data:`INTERSAMPLE`.

    Raises
    ------
    FitError
        The choice is unknown.
    """

    def __init__(self, denominator, sample_time: float, intersample: str = "zoh"):
        if intersample not in INTERSAMPLE:
            raise FitError(f"intersample = {intersample!r}: must be one of {', '.join(INTERSAMPLE)}")
        denominator = np.asarray(denominator, dtype=float)
        n = self.order = len(denominator) - 1
        self.sample_time, self.intersample = float(sample_time), "foh" if intersample == "linear" else intersample
        self.rate = abs(denominator[-1]) ** (1.0 / n) if n and denominator[-1] else 1.0
        # in s/rate the response is rate^(i - n) times that of the states, i.e. the powers are put back in `bases`
        self.scaled = denominator[1:] / self.rate ** np.arange(1, n + 1)
        self.A = np.eye(n, k=1)
        if n:
            self.A[-1] = -self.scaled[::-1]
        self.B = np.zeros((n, 1))
        self.B[-1:] = 1.0
        self.powers = self.rate ** (np.arange(n + 1.0) - n)

    def discrete(self, step: float):
        """Return Ad, B0 and B1 of ``x_(k+1) = Ad x_k + B0 u_k + B1 u_(k+1)`` over ``step`` [s]; B1 = 0 for ``zoh``.

        Parameters
        ----------
        step : float
        """
        n, h = self.order, step * self.rate
        size = np.zeros((n + 2, n + 2))
        size[:n, :n], size[:n, n : n + 1], size[n, n + 1] = self.A * h, self.B * h, 1.0
        both = scipy.linalg.expm(size)
        held, ramp = both[:n, n], both[:n, n + 1]
        return (both[:n, :n], held, 0 * held) if self.intersample == "zoh" else (both[:n, :n], held - ramp, ramp)

    def states(self, u, initial: str = "zero") -> np.ndarray:
        """Return the states at the samples, shape (N, n), in scaled time.

        Parameters
        ----------
        u : ndarray, shape (N,)
        initial : str
            ``zero``, ``rest`` or ``periodic``.
        """
        if self.intersample == "bandlimited":
            fine = _reconstructed(u, initial == "periodic")
            Ad, B0, B1 = self.discrete(self.sample_time / FINER)
            return self._run(Ad, B0, B1, fine, initial)[::FINER][: len(u)]
        return self._run(*self.discrete(self.sample_time), u, initial)

    def _run(self, Ad, B0, B1, u, initial):
        following = np.append(u[1:], u[0] if initial == "periodic" else u[-1])
        drive = np.outer(u, B0) + np.outer(following, B1)
        start = None
        if initial == "rest":
            start = np.linalg.solve(self.A, -self.B[:, 0] * u[0])
        elif initial == "periodic":
            n = self.order
            start = np.linalg.solve(np.eye(n) - np.linalg.matrix_power(Ad, len(u)), final_state(Ad, drive))
        return propagate(Ad, drive, start)

    def bases(self, u, highest: int, initial: str = "zero", delay: float = 0.0) -> np.ndarray:
        """Return the responses of 1/den, s/den … s^highest/den, shape (N, highest + 1).

        Parameters
        ----------
        u : ndarray, shape (N,)
        highest : int
            At most n.
        initial : str
            ``zero``, ``rest`` or ``periodic``.
        delay : float
            Of the input [s]; parts of a sample by straight lines between the responses.

        Raises
        ------
        FitError
            There are more zeros than poles.
        """
        if highest > self.order:
            raise FitError(f"{highest} zeros and {self.order} poles: the transfer function is not causal")
        states = self.states(u, initial)
        if highest == self.order:
            states = np.column_stack([states, u - states @ self.scaled[::-1]])
        columns = states[:, : highest + 1] * self.powers[: highest + 1]
        if delay == 0.0:
            return columns
        N, shift = len(u), delay / self.sample_time
        at = np.arange(N) - shift
        if initial == "periodic":
            columns, at = np.concatenate([columns, columns[:1]]), at % N
        return np.column_stack([np.interp(at, np.arange(len(columns)), column) for column in columns.T])

    def free_responses(self, samples: int) -> np.ndarray:
        """Return n independent responses to initial states without input, shape (samples, n).

        Parameters
        ----------
        samples : int
        """
        Ad = self.discrete(self.sample_time)[0]
        nothing = np.zeros((samples, self.order))
        return np.column_stack([propagate(Ad, nothing, start)[:, 0] for start in np.eye(self.order)])

    def model(self, numerator, input_unit: str = "V", output_unit: str = "m") -> LinearModel:
        """Return the discrete state space for an input held over each sample.

        Parameters
        ----------
        numerator : array_like, shape (m + 1,)
            Highest power first, m ≤ n.
        input_unit, output_unit : str
            SI units.
        """
        n = self.order
        low_first = np.zeros(n + 1)
        low_first[: len(numerator)] = np.asarray(numerator, dtype=float)[::-1]
        low_first *= self.powers
        held = CanonicalSimulation(
            np.r_[1.0, self.scaled * self.rate ** np.arange(1, n + 1)], self.sample_time, "zoh"
        ).discrete(self.sample_time)
        C = (low_first[:n] - low_first[n] * self.scaled[::-1])[None, :]
        D = np.array([[low_first[n]]])
        return LinearModel(held[0], held[1][:, None], C, D, self.sample_time, input_unit, output_unit)


def simulate_transfer_function(
    numerator,
    denominator,
    u,
    sample_time: float,
    intersample: str = "zoh",
    initial: str = "zero",
    delay: float = 0.0,
) -> np.ndarray:
    """Return the response of a continuous transfer function to a sampled input, exact for ``zoh`` and ``foh``.

    Parameters
    ----------
    numerator, denominator : array_like
        Highest power first; at most as many zeros as poles.
    u : array_like, shape (N,)
    sample_time : float
        [s]
    intersample : str
        ``zoh`` (held), ``foh`` or ``linear`` (straight between samples), ``bandlimited``.
    initial : str
        ``zero``, ``rest`` or ``periodic``.
    delay : float
        [s]

    Raises
    ------
    FitError
        A choice is unknown, or there are more zeros than poles.
    """
    denominator = np.atleast_1d(np.asarray(denominator, dtype=float))
    numerator = np.atleast_1d(np.asarray(numerator, dtype=float)) / denominator[0]
    if initial not in KNOWN_STARTS:
        raise FitError(f"initial = {initial!r}: must be one of {', '.join(KNOWN_STARTS)}")
    simulation = CanonicalSimulation(denominator / denominator[0], sample_time, intersample)
    return simulation.bases(np.asarray(u, dtype=float), len(numerator) - 1, initial, delay) @ numerator[::-1]


def _reconstructed(u, periodic):
    """Return ``u`` at FINER points a sample, as the band-limited signal through its samples."""
    if periodic:
        return scipy.signal.resample(u, FINER * len(u))
    # mirrored about its end points, so that no step at the ends rings into the record
    pad = min(len(u) - 1, 64)
    head, tail = 2 * u[0] - u[pad:0:-1], 2 * u[-1] - u[-2 : -pad - 2 : -1]
    long = np.concatenate([head, u, tail])
    taps = FINER * scipy.signal.firwin(2 * 32 * FINER + 1, 1.0 / FINER, window=("kaiser", 8.0))
    fine = scipy.signal.resample_poly(long, FINER, 1, window=taps / FINER)
    return fine[pad * FINER : (pad + len(u)) * FINER]
