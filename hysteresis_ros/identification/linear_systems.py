# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear systems and their exact simulation: discrete state space and continuous transfer functions.

An input is held (``zoh``, as a converter does), linear (``linear`` or ``foh``, nearest to a slowly sampled monitor
signal) or band-limited between its samples (a multisine below the Nyquist frequency, decimated data).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.models.linear import BOUNDARY, LinearParameters, StateSpace


class FitError(IdentificationError):
    """A fit is not possible with this data and these settings; the message says what to change."""


@dataclass(frozen=True)
class Mode:
    """One pole (or conjugate pair) of a model."""

    frequency: float  #: Natural frequency [Hz].
    damping: float  #: Damping ratio [1]; 1 for a real pole, negative when unstable.


def propagate(A, inputs, initial=None) -> np.ndarray:
    """Return the states of ``x_(k+1) = A x_k + w_k``.

    The recursion runs in the Schur form of A, as one first-order filter per state: as accurate as the plain recursion
    for poles close to one another or to the unit circle, but without a loop over the samples.
    """
    return _run(A, inputs, initial)[:-1]


def _run(A, inputs, initial):
    A, inputs = np.atleast_2d(np.asarray(A, dtype=float)), np.asarray(inputs, dtype=float)
    N, n = inputs.shape
    triangular, basis = scipy.linalg.schur(A, output="complex")
    driven = inputs @ basis.conj()
    start = np.zeros(n, dtype=complex) if initial is None else basis.conj().T @ np.asarray(initial, dtype=complex)
    states = np.empty((N + 1, n), dtype=complex)
    states[0] = start
    for i in range(n - 1, -1, -1):
        force = driven[:, i] + states[:-1, i + 1 :] @ triangular[i, i + 1 :]
        states[1:, i], _ = scipy.signal.lfilter(
            [1.0], [1.0, -triangular[i, i]], force, zi=[triangular[i, i] * states[0, i]]
        )
    return np.real(states @ basis.T)


def final_state(A, inputs, initial=None) -> np.ndarray:
    """Return x_N of the recursion of :func:`propagate`, shape (n,)."""
    return _run(A, inputs, initial)[-1]


@dataclass(frozen=True, eq=False)
class LinearModel(StateSpace):
    """Discrete state space of n_u inputs and n_y outputs in SI units, with its sample time."""

    sample_time: float  #: [s]
    input_unit: str = "V"  #: SI unit of u.
    output_unit: str = "m"  #: SI unit of y.

    @property
    def zeros(self) -> np.ndarray:
        """Finite transmission zeros in the z plane of a model with as many inputs as outputs."""
        n, m = self.order, self.D.shape[1]
        if self.D.shape[0] != m:
            return np.empty(0, dtype=complex)
        # scaled, so that "finite" means the same in metres and in micrometres
        b, c = np.linalg.norm(self.B) or 1.0, np.linalg.norm(self.C) or 1.0
        pencil = np.block([[self.A, self.B / b], [self.C / c, self.D / (b * c)]])
        shift = scipy.linalg.block_diag(np.eye(n), np.zeros((m, m)))
        alpha, beta = scipy.linalg.eig(pencil, shift, right=False, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-10 * np.maximum(np.abs(alpha), 1e-300)
        zeros = alpha[finite] / beta[finite]
        return zeros[np.abs(zeros) < 1e8]

    @property
    def minimum_phase(self) -> bool:
        """Whether all zeros are inside the unit circle: the inverse is stable then."""
        return bool(np.all(np.abs(self.zeros) < 1.0 - BOUNDARY))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Natural frequencies and damping ratios of the poles, slowest first, a pair once."""
        poles = self.poles
        poles = poles[(poles.imag >= 0.0) & (np.abs(poles) > 1e-12)]
        s = np.log(poles.astype(complex)) / self.sample_time
        found = [Mode(float(abs(p) / (2 * np.pi)), float(-p.real / abs(p)) if p != 0 else 1.0) for p in s]
        return tuple(sorted(found, key=lambda mode: mode.frequency))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Problems of the model: unstable poles, zeros outside the unit circle, a gain that is not positive."""
        found = list(pole_zero_warnings(self.poles, self.zeros))
        gain = self.dc_gain
        if isinstance(gain, float) and not gain > 0.0:
            found.append(f"the DC gain is {gain:.4g} {self.output_unit}/{self.input_unit}: the output moves against u")
        return tuple(found)

    def frequency_response(self, frequency) -> np.ndarray:
        """Return the response at ``frequency`` [Hz], shape (F, n_y, n_u), complex."""
        return self.response(np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * self.sample_time))

    def simulate(self, u, initial=None) -> np.ndarray:
        """Return the output for the input ``u`` of shape (N,) or (N, n_u), in the same form."""
        columns = np.asarray(u, dtype=float).reshape(len(u), -1)
        y = propagate(self.A, columns @ self.B.T, initial) @ self.C.T + columns @ self.D.T
        return y[:, 0] if np.ndim(u) == 1 else y

    def linear_parameters(self) -> LinearParameters:
        """Return the parameters of the linear block with unit DC gain; the hysteresis has the gain."""
        if self.D.size != 1:
            raise FitError(f"a linear block has one input and one output; this model has {self.D.shape[::-1]}")
        if not self.stable:
            radius = np.max(np.abs(self.poles))
            raise FitError(f"the linear model is unstable (pole of modulus {radius:.6g}) and cannot run")
        gain = self.dc_gain
        if gain == 0.0 or not np.isfinite(gain):
            raise FitError(f"the DC gain of the linear model is {gain}; it cannot be scaled to one")
        if abs(self.D[0, 0]) > 1e-9 * abs(gain):
            raise FitError(f"the linear model has a feedthrough of {self.D[0, 0]:.3g}; fit it without one")
        return LinearParameters(
            A=tuple(map(float, self.A.ravel())),
            B=tuple(map(float, self.B.ravel())),
            C=tuple(map(float, self.C.ravel() / gain)),
        ).validated()


def pole_zero_warnings(poles, zeros, radius: float = 1.0) -> tuple[str, ...]:
    """Return warnings about unstable poles and zeros outside the unit circle of a discrete model."""
    found = []
    outside = [p for p in np.ravel(poles) if abs(p) >= 1.0 - BOUNDARY]
    if outside:
        found.append(f"unstable linear fit: pole(s) {_list(outside)} on or outside the unit circle")
    outside = [z for z in np.ravel(zeros) if abs(z) >= radius - BOUNDARY]
    if outside:
        found.append(
            f"non-minimum-phase linear fit: zero(s) {_list(outside)} on or outside the circle of radius {radius:g}; "
            "the linear part has no stable inverse"
        )
    return tuple(found)


def _list(values):
    return ", ".join(f"{v.real:.4g}" if abs(v.imag) < 1e-12 else f"{v.real:.4g}{v.imag:+.4g}j" for v in values)


METHODS = ("zoh", "linear", "bandlimited")
#: Samples beyond each end over which a band-limited input that is not periodic is mirrored.
MARGIN = 64


def upsample(u, factor: int, method: str = "bandlimited", periodic: bool = False) -> np.ndarray:
    """Return the input at ``factor`` times as many points, shape (N factor,); every factor-th is a sample."""
    u = np.ascontiguousarray(u, dtype=np.float64)
    if method not in METHODS or factor < 1:
        raise IdentificationError(
            f"intersample = {method!r}, factor = {factor}: must be one of {', '.join(METHODS)} and at least 1"
        )
    if factor == 1:
        return u.copy()
    if method == "zoh":
        return np.repeat(u, factor)
    if method == "linear":
        following = np.append(u[1:], u[0] if periodic else u[-1])
        return (u[:, None] + (following - u)[:, None] * (np.arange(factor) / factor)).ravel()
    if periodic:
        spectrum = np.fft.rfft(u)
        if u.size % 2 == 0:
            spectrum[-1] *= 0.5  # the Nyquist bin represents two frequencies of the finer grid
        return np.fft.irfft(spectrum, u.size * factor) * factor
    margin = min(MARGIN, u.size - 1)
    # mirrored about the ends, so that level and slope continue
    head, tail = 2.0 * u[0] - u[margin:0:-1], 2.0 * u[-1] - u[-2 : -margin - 2 : -1]
    longer = scipy.signal.resample_poly(np.concatenate([head, u, tail]), factor, 1, window=("kaiser", 12.0))
    return longer[margin * factor : (margin + u.size) * factor]


def find_period(u, tolerance: float = 1e-6) -> int | None:
    """Return the number of samples after which the input repeats itself, None when it does not.

    The input must contain at least two whole periods.
    """
    u = np.asarray(u, dtype=float)
    centred = u - u.mean()
    scale = np.ptp(u)
    if scale == 0.0 or u.size < 8:
        return None
    n = u.size
    power = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    overlap = np.fft.irfft(power)[:n] / np.arange(n, 0, -1)
    candidates = np.flatnonzero(overlap[: n // 2 + 1] > 0.999 * overlap[0])
    for period in candidates[candidates > 1]:
        if np.max(np.abs(u[period:] - u[:-period])) <= tolerance * scale:
            return int(period)
    return None


#: How an input may run between its samples; ``linear`` is another word for ``foh``.
INTERSAMPLE = ("zoh", "foh", "linear", "bandlimited")
#: Known initial states of a simulation.
KNOWN_STARTS = ("zero", "rest", "periodic")
#: Points per sample of a reconstructed band-limited input.
FINER = 8


class CanonicalSimulation:
    """The responses of ``sⁱ/denominator`` to an input; the response of every numerator is a sum of them.

    The states of the controllable form are these responses. Time is scaled with the geometric mean of the poles, so
    that the matrix is well scaled for a mirror of 2 kHz as well as for a creep of an hour.

    Units: ``sample_time`` [s].
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
        """Return Ad, B0 and B1 of ``x_(k+1) = Ad x_k + B0 u_k + B1 u_(k+1)`` over ``step`` [s]; B1 = 0 for ``zoh``."""
        n, h = self.order, step * self.rate
        size = np.zeros((n + 2, n + 2))
        size[:n, :n], size[:n, n : n + 1], size[n, n + 1] = self.A * h, self.B * h, 1.0
        both = scipy.linalg.expm(size)
        held, ramp = both[:n, n], both[:n, n + 1]
        return (both[:n, :n], held, 0 * held) if self.intersample == "zoh" else (both[:n, :n], held - ramp, ramp)

    def states(self, u, initial: str = "zero") -> np.ndarray:
        """Return the states at the samples, shape (N, n), in scaled time."""
        if self.intersample == "bandlimited":
            fine = _reconstructed(u, initial == "periodic")
            Ad, B0, B1 = self.discrete(self.sample_time / FINER)
            return self._run(Ad, B0, B1, fine, initial)[::FINER][: len(u)]
        Ad, B0, B1 = self.discrete(self.sample_time)
        return self._run(Ad, B0, B1, u, initial)

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

        Units: ``delay`` [s].
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
        """Return n independent responses to initial states without input, shape (samples, n)."""
        Ad = self.discrete(self.sample_time)[0]
        nothing = np.zeros((samples, self.order))
        return np.column_stack([propagate(Ad, nothing, start)[:, 0] for start in np.eye(self.order)])

    def model(self, numerator, input_unit: str = "V", output_unit: str = "m") -> LinearModel:
        """Return the discrete state space for an input held over each sample."""
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

    Units: ``sample_time`` [s], ``delay`` [s].
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
    # mirrored about its end points, so that a step at the ends causes no ringing
    pad = min(len(u) - 1, 64)
    head, tail = 2 * u[0] - u[pad:0:-1], 2 * u[-1] - u[-2 : -pad - 2 : -1]
    long = np.concatenate([head, u, tail])
    taps = FINER * scipy.signal.firwin(2 * 32 * FINER + 1, 1.0 / FINER, window=("kaiser", 8.0))
    fine = scipy.signal.resample_poly(long, FINER, 1, window=taps / FINER)
    return fine[pad * FINER : (pad + len(u)) * FINER]
