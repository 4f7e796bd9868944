# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Linear systems and their exact simulation: state space, transfer functions, and the dynamics after a hysteresis.

Between its samples an input is assumed held (``zoh``, as by a converter), linear (``linear`` or ``foh``, closest to a
slowly sampled monitor signal) or band-limited (a multisine below the Nyquist frequency, decimated data).

*Linear part* of a Hammerstein model (:class:`LinearPart`): creep, a first-order lag, modes, and a delay. The
displacement is assumed linear between samples, so lags shorter than a sample can be distinguished; dynamics that were
identified for a held voltage (``hold``) are simulated exactly for a held voltage. The filters process all columns of
regressors together (:func:`filtered`), by recursion over the samples. This makes joint fits of hysteresis and dynamics
fast: it takes a fifth of the time of a convolution by FFT, because one sample of all columns stays in the cache.
:func:`undo` inverts the linear part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.models.block import COMPILED, specialised
from hysteresis_ros.models.creep import Creep, CreepParameters, LogarithmicCreepParameters, creep, creep_inverse
from hysteresis_ros.models.linear import BOUNDARY, LinearParameters, StateSpace, zero_order_hold


class FitError(IdentificationError):
    """A fit is impossible with this data and these settings; the message states what to change."""


class Section(NamedTuple):
    """The filter (b0 + b1/z + b2/z²)/(1 + a1/z + a2/z²)."""

    b0: float
    b1: float = 0.0
    b2: float = 0.0
    a1: float = 0.0
    a2: float = 0.0


def filtered(columns, sections: Sequence[Section]) -> np.ndarray:
    """Return the sum of the outputs of all sections, which start at rest, for each column; shape (N, m)."""
    columns = np.ascontiguousarray(columns, dtype=float)
    direct = sum(section.b0 for section in sections)
    recursive = [section for section in sections if any(section[1:])]
    if not recursive:
        return direct * columns
    if not COMPILED:
        return sum(scipy.signal.lfilter(one[:3], (1.0, *one[3:]), columns, axis=0) for one in sections)
    # each section minus its direct part b0: (c1/z + c2/z²)/(1 + a1/z + a2/z²)
    rows = np.array([(one.b1 - one.a1 * one.b0, one.b2 - one.a2 * one.b0, one.a1, one.a2) for one in recursive])
    found = np.empty_like(columns)
    state = np.zeros((2 * len(rows), columns.shape[1]))
    settings = np.array([direct])
    specialised(run_sections, settings, rows, state, columns, found)(settings, rows, state, columns, found)
    return found


def run_sections(settings, rows, state, columns, found):
    """Fill ``found`` with filtered columns; ``settings`` holds the direct part, ``state`` two rows for each section."""
    if columns.shape[1] == 1:  # a single column needs no inner loop
        for k in range(columns.shape[0]):
            now = columns[k, 0]
            total = settings[0] * now
            for s in range(rows.shape[0]):
                before = state[2 * s, 0]
                total += before
                state[2 * s, 0] = rows[s, 0] * now - rows[s, 2] * before + state[2 * s + 1, 0]
                state[2 * s + 1, 0] = rows[s, 1] * now - rows[s, 3] * before
            found[k, 0] = total
        return
    for k in range(columns.shape[0]):
        for p in range(columns.shape[1]):
            found[k, p] = settings[0] * columns[k, p]
        for s in range(rows.shape[0]):
            c1, c2, a1, a2 = rows[s, 0], rows[s, 1], rows[s, 2], rows[s, 3]
            i = 2 * s
            if c2 == 0.0 and a2 == 0.0:
                for p in range(columns.shape[1]):
                    now = state[i, p]
                    found[k, p] += now
                    state[i, p] = c1 * columns[k, p] - a1 * now
            else:
                for p in range(columns.shape[1]):
                    now = state[i, p]
                    found[k, p] += now
                    state[i, p] = c1 * columns[k, p] - a1 * now + state[i + 1, p]
                    state[i + 1, p] = c2 * columns[k, p] - a2 * now


@dataclass(frozen=True)
class Mode:
    """A real pole or a pole pair; as a term of a sum: (position ω² + velocity ω s)/(s² + 2 ζ ω s + ω²)."""

    frequency: float  #: Natural frequency ω/2π [Hz], undamped.
    damping: float  #: Damping ratio ζ; below 1 for a pair, 1 for a real pole, negative if unstable.
    #: position, velocity: Numerator coefficients, if the mode is a term of a sum; ``position`` is the fraction of the
    #: static displacement that passes through the mode.
    position: float = 1.0
    velocity: float = 0.0

    def state_space(self):
        """Return the continuous A, shape (2, 2), B, shape (2,), and C, shape (2,) [rad/s]; A is a decaying rotation."""
        omega = 2.0 * np.pi * self.frequency
        real, turn = -self.damping * omega, omega * np.sqrt(1.0 - self.damping**2)
        A = np.array([[real, turn], [-turn, real]])
        return (
            A,
            np.array([0.0, omega]),
            np.array([(self.position * omega + self.velocity * real) / turn, self.velocity]),
        )


def propagate(A, inputs, initial=None) -> np.ndarray:
    """Return the states of ``x_(k+1) = A x_k + w_k``.

    The recursion runs in the Schur form of A, as one first-order filter per state. This is as accurate as the plain
    recursion, also for poles close to one another or to the unit circle, but needs no loop over the samples.
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
        # scaled so that the test for finite zeros does not depend on the units
        b, c = np.linalg.norm(self.B) or 1.0, np.linalg.norm(self.C) or 1.0
        pencil = np.block([[self.A, self.B / b], [self.C / c, self.D / (b * c)]])
        shift = scipy.linalg.block_diag(np.eye(n), np.zeros((m, m)))
        alpha, beta = scipy.linalg.eig(pencil, shift, right=False, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-10 * np.maximum(np.abs(alpha), 1e-300)
        zeros = alpha[finite] / beta[finite]
        return zeros[np.abs(zeros) < 1e8]

    @property
    def minimum_phase(self) -> bool:
        """Whether all zeros are inside the unit circle, that is, the inverse is stable."""
        return bool(np.all(np.abs(self.zeros) < 1.0 - BOUNDARY))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Natural frequencies and damping ratios of the poles, lowest frequency first; a pole pair has one entry."""
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
        """Return the output for the input ``u`` of shape (N,) or (N, n_u), with the same number of dimensions."""
        columns = np.asarray(u, dtype=float).reshape(len(u), -1)
        y = propagate(self.A, columns @ self.B.T, initial) @ self.C.T + columns @ self.D.T
        return y[:, 0] if np.ndim(u) == 1 else y

    def linear_parameters(self) -> LinearParameters:
        """Return the parameters of the linear block, scaled to unit DC gain; the hysteresis contains the gain."""
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


#: Assumptions about an input between its samples; ``foh`` is another name of ``linear``.
METHODS = ("zoh", "linear", "bandlimited")
INTERSAMPLE = (*METHODS, "foh")
#: Number of samples by which a band-limited, non-periodic input is mirrored beyond each end.
MARGIN = 64
#: Interpolation of a band-limited input that is the more accurate one up to a quarter of the sample rate: number of
#: samples on each side, and β of the Kaiser window.
CLOSE = (10, 12.0)
#: The same two numbers for inputs up to nearly half the sample rate.
SHARP = (32, 8.0)


def upsample(
    u, factor: int, method: str = "bandlimited", periodic: bool = False, window: tuple[int, float] = CLOSE
) -> np.ndarray:
    """Return the input with ``factor`` times as many points, shape (N factor,); every factor-th point is a sample."""
    u = np.ascontiguousarray(u, dtype=np.float64)
    if method not in METHODS or factor < 1:
        raise IdentificationError(
            f"intersample = {method!r}, factor = {factor}: intersample must be one of {', '.join(METHODS)}, "
            "and factor at least 1"
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
    # mirrored about the ends, so that level and slope are continuous
    head, tail = 2.0 * u[0] - u[margin:0:-1], 2.0 * u[-1] - u[-2 : -margin - 2 : -1]
    taps = scipy.signal.firwin(2 * window[0] * factor + 1, 1.0 / factor, window=("kaiser", window[1]))
    longer = scipy.signal.resample_poly(np.concatenate([head, u, tail]), factor, 1, window=taps)
    return longer[margin * factor : (margin + u.size) * factor]


def find_period(u, tolerance: float = 1e-6) -> int | None:
    """Return the number of samples after which the input repeats; None if it is not periodic.

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


#: Known initial states of a simulation.
KNOWN_STARTS = ("zero", "rest", "periodic")
#: Number of points per sample to which a band-limited input is interpolated.
BANDLIMITED_POINTS = 8


class CanonicalSimulation:
    """The responses of ``sⁱ/denominator`` to an input; the response for any numerator is a linear combination of them.

    The states of the controllable form are these responses. Time is scaled with the geometric mean of the poles, so
    that the matrix is well conditioned both for a mirror of 2 kHz and for creep over an hour.

    Units: ``sample_time`` [s].
    """

    def __init__(self, denominator, sample_time: float, intersample: str = "zoh"):
        if intersample not in INTERSAMPLE:
            raise FitError(f"intersample = {intersample!r}: must be one of {', '.join(INTERSAMPLE)}")
        denominator = np.asarray(denominator, dtype=float)
        n = self.order = len(denominator) - 1
        self.sample_time, self.intersample = float(sample_time), "foh" if intersample == "linear" else intersample
        self.rate = abs(denominator[-1]) ** (1.0 / n) if n and denominator[-1] else 1.0
        # in time units of 1/rate, the i-th response is rate^(i - n) times the state; `bases` applies these powers
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
            fine = upsample(u, BANDLIMITED_POINTS, "bandlimited", initial == "periodic", SHARP)
            Ad, B0, B1 = self.discrete(self.sample_time / BANDLIMITED_POINTS)
            return self._run(Ad, B0, B1, fine, initial)[::BANDLIMITED_POINTS][: len(u)]
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
        """Return n independent responses without input, one for each initial state, shape (samples, n)."""
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


#: Smallest lag, as a fraction of the sample time; smaller lags are neglected.
SHORTEST_LAG = 0.02
#: Smallest creep rate; smaller rates are neglected.
SMALLEST_RATE = 1e-5
#: Number of modes whose filter sections are cached.
RESPONSES = 16


@dataclass(frozen=True)
class LinearPart:
    """Creep, then a lag in parallel with modes, then a delay."""

    lag: float = 0.0  #: Time constant τ [s].
    delay: float = 0.0  #: Dead time [s].
    creep_rate: float = 0.0  #: γ of the logarithmic law, per decade.
    longest_time: float = 100.0  #: Time [s] up to which the creep law holds.
    #: True: creep has settled at the first sample; false: the system was at rest at zero before the first sample.
    settled: bool = False
    modes: tuple[Mode, ...] = ()  #: Modes; the remaining displacement passes through the lag.
    #: Sample time [s] of the held voltage for which lag, modes and delay were identified; they do not include the delay
    #: of the hold. 0: the input was assumed linear between the samples, so the delay includes the half-sample delay of
    #: the hold.
    hold: float = 0.0

    @property
    def creep(self) -> CreepParameters:
        """Parameters of the creep block."""
        if self.creep_rate < SMALLEST_RATE:
            return CreepParameters()
        law = LogarithmicCreepParameters(rate=float(self.creep_rate), longest_time=float(self.longest_time))
        return CreepParameters(type="logarithmic", logarithmic=law)

    def impulse(self, samples: int, sample_time: float) -> np.ndarray:
        """Return the response, shape (samples,), to a single sample of 1.

        Units: ``sample_time`` [s].
        """
        unit = np.zeros(samples)
        unit[0] = 1.0
        return replace(self, settled=False).apply(unit, sample_time)

    def apply(self, columns, sample_time: float) -> np.ndarray:
        """Return the columns, shape (N,) or (N, m), filtered by the linear part.

        Units: ``sample_time`` [s].
        """
        return self.behind_creep(self.crept(columns, sample_time), columns, sample_time)

    def crept(self, columns, sample_time: float) -> np.ndarray:
        """Return the columns filtered by creep alone, shape (N, m); with ``settled``, relative to the first row."""
        table = _table(columns)
        moved = table - table[:1] if self.settled else table
        if self.creep_rate < SMALLEST_RATE:
            return moved
        return filtered(moved, _creep_sections(self.creep, sample_time))

    def behind_creep(self, crept, columns, sample_time: float) -> np.ndarray:
        """Return the response to ``columns``, with the same shape; ``crept`` is their response to creep alone."""
        columns = np.asarray(columns, dtype=float)
        held = bool(self.hold) and abs(self.hold - sample_time) < 1e-6 * sample_time
        sections, late = _held_stage(self, sample_time) if held else _linear_stage(self, sample_time)
        moved = _delayed(filtered(crept, sections), late)
        if self.settled:
            moved = moved + _table(columns)[:1] * self.settled_gain
        return moved.reshape(columns.shape)

    @property
    def group_delay(self) -> float:
        """Delay of slow movement [s] due to lag, modes and dead time, without creep."""
        omega = 2.0 * np.pi * np.array([mode.frequency for mode in self.modes])
        late = [2.0 * mode.damping * mode.position - mode.velocity for mode in self.modes]
        direct = 1.0 - sum(mode.position for mode in self.modes)
        return self.delay + direct * self.lag + float(np.sum(np.array(late) / omega))

    def synchronous(self, sample_time: float) -> bool:
        """Return whether each displacement responds to the voltage of the same sample.

        Units: ``sample_time`` [s].
        """
        return not self.hold and self.lag + self.delay < 0.5 * sample_time

    @property
    def settled_gain(self) -> float:
        """Gain after infinite time, when all creep operators have settled."""
        feedthrough, weights, _ = self.creep.resolved()
        return feedthrough + float(np.sum(weights))

    def described(self) -> tuple[dict[str, float], list[str]]:
        """Return the figures, by names with units, and the names of the parts."""
        numbers = {}
        words = []
        if self.lag > 0.0:
            numbers["lag_s"] = self.lag
            words.append("lag")
        if self.delay > 0.0:
            numbers["delay_s"] = self.delay
            words.append("delay")
        for number, mode in enumerate(sorted(self.modes, key=lambda mode: mode.frequency), start=1):
            numbers |= {f"mode_{number}_hz": mode.frequency, f"mode_{number}_damping": mode.damping}
        if self.modes:
            words.append("1 mode" if len(self.modes) == 1 else f"{len(self.modes)} modes")
        if self.creep.type != "none":
            numbers["creep_rate_per_decade"] = self.creep_rate
            words.append("creep")
        return numbers, words

    def dynamics(self, sample_time: float) -> LinearParameters:
        """Return lag, modes and delay as the discrete block of a node; the input of this block is held between samples.

        Holding the input adds a delay. This delay is subtracted from the dead time and, if the dead time is too short,
        from the lag too, so that the total delay of slow movement does not change.

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
        # the input may change within a sample period: x⁺ = A x + late u_k + early u_(k-1), with u_(k-1) as a state
        step, both = zero_order_hold(A, B, sample_time)
        late = zero_order_hold(A, B, (1.0 - part) * sample_time)[1]
        A, B = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
        A[:n, :n], A[:n, n], A[n + 1, n] = step, (both - late)[:, 0], 1.0
        B[:n], B[n] = late[:, 0], 1.0
        C = np.concatenate([C, [through * (1.0 - part), through * part]])
        kept = slice(None) if through else slice(n + 1)
        return _flat(A[kept, kept], B[kept], C[kept], 0.0, sample_time, whole * sample_time)

    def held(self, sample_time: float) -> LinearPart:
        """Return the linear part for an input that is held between the samples; its discrete block is the same.

        Lag and delay then do not include the half-sample delay of the hold.

        Units: ``sample_time`` [s].
        """
        if self.hold or self.modes or not self.lag + self.delay:
            return self
        lag, delay = self._without_holding(sample_time)
        return replace(self, lag=float(lag), delay=float(delay), hold=float(sample_time))

    def _without_holding(self, sample_time: float) -> tuple[float, float]:
        """Return lag and delay without the effect of the hold; a held lag delays by T/(1 - e^(-T/τ)), not τ."""
        lag = self.lag if self.lag > SHORTEST_LAG * sample_time else 0.0
        late = sample_time / -np.expm1(-sample_time / lag) if lag else sample_time
        delay = self.lag + self.delay - late
        if delay >= 0.0:
            return lag, delay
        rest = (self.lag + self.delay) / sample_time - 1.0
        return (sample_time / np.log1p(1.0 / rest) if rest > 0.0 else 0.0), 0.0

    def _continuous(self, lag: float):
        """Return the continuous A, B, C of lag and modes, and the direct feedthrough."""
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


@lru_cache(maxsize=16)
def _creep_sections(creep: CreepParameters, sample_time: float) -> tuple[Section, ...]:
    """Return direct part and operators of a creep law; cached, because a search uses the same law many times."""
    feedthrough, weights, time_constants = creep.resolved()
    sections = [_lag_section(*one, sample_time) for one in zip(time_constants, weights, strict=True)]
    return Section(feedthrough), *sections


def _table(columns) -> np.ndarray:
    """Return columns, shape (N,) or (N, m), as a table, shape (N, m)."""
    columns = np.asarray(columns, dtype=float)
    return columns[:, None] if columns.ndim == 1 else columns


def _delayed(columns, samples: float) -> np.ndarray:
    """Return the columns, shape (N, m), delayed by linear interpolation; they are zero before their first sample."""
    whole = int(samples + 1e-9)
    part = max(samples - whole, 0.0)
    if not whole and part < 1e-9:
        return columns
    found = np.empty_like(columns)
    kept = max(len(columns) - whole, 0)
    found[:whole] = 0.0
    if part < 1e-9:
        found[whole:] = columns[:kept]
    else:
        np.multiply(columns[:kept], 1.0 - part, out=found[whole:])
        found[whole + 1 :] += part * columns[: max(kept - 1, 0)]
    return found


def _linear_stage(part: LinearPart, sample_time: float) -> tuple[list[Section], float]:
    """Return lag and modes for an input that is linear between the samples, and the delay [samples]."""
    direct = 1.0 - sum(mode.position for mode in part.modes)
    sections = [_lag_section(part.lag, direct, sample_time), *(_mode_section(mode, sample_time) for mode in part.modes)]
    return sections, (part.delay + 0.5 * part.hold) / sample_time


def _held_stage(part: LinearPart, sample_time: float) -> tuple[list[Section], float]:
    """Return lag and modes for an input that is held over a sample, and the delay [samples] of the measurement."""
    samples = part.delay / sample_time
    if not part.modes:
        return [_held_section(part.lag, sample_time)], 1.0 + samples
    whole = int(samples + 1e-9)
    early = max(samples - whole, 0.0)
    early = early if early >= 1e-9 else 0.0
    direct = 1.0 - sum(mode.position for mode in part.modes)
    sections = [_held_mode(mode, sample_time, early) for mode in part.modes]
    if abs(direct) >= 1e-9:
        sections.append(_held_section(part.lag, sample_time, early, direct))
    return sections, 1.0 + whole


def _lag_section(time_constant: float, weight: float, sample_time: float) -> Section:
    """Return a lag for an input that is linear between the samples, times ``weight``."""
    if time_constant <= SHORTEST_LAG * sample_time:
        return Section(weight)
    decay = np.exp(-sample_time / time_constant)
    part = -np.expm1(-sample_time / time_constant) * time_constant / sample_time
    return Section(weight * (1.0 - part), weight * (part - decay), a1=-decay)


def _held_section(lag: float, sample_time: float, early: float = 0.0, weight: float = 1.0) -> Section:
    """Return a lag for a held input that changes after the fraction ``early`` of a sample, times ``weight``."""
    if lag <= SHORTEST_LAG * sample_time:
        return Section(weight * (1.0 - early), weight * early)
    decay = np.exp(-sample_time / lag)
    late = -np.expm1(-(1.0 - early) * sample_time / lag)
    return Section(weight * late, weight * (1.0 - decay - late), a1=-decay)


@lru_cache(maxsize=RESPONSES)
def _mode_section(mode: Mode, sample_time: float) -> Section:
    """Return a mode for an input that is linear between the samples."""
    A, B, C = mode.state_space()
    system = scipy.signal.cont2discrete((A, B[:, None], C[None], np.zeros((1, 1))), sample_time, method="foh")
    numerator, denominator = scipy.signal.ss2tf(*system[:4])
    return Section(*np.ravel(numerator).tolist(), *denominator[1:].tolist())


@lru_cache(maxsize=RESPONSES)
def _held_mode(mode: Mode, sample_time: float, early: float) -> Section:
    """Return a mode for a held input that changes after the fraction ``early`` of a sample."""
    A, B, C = mode.state_space()
    step, both = zero_order_hold(A, B, sample_time)
    late = zero_order_hold(A, B, (1.0 - early) * sample_time)[1][:, 0]
    trace, determinant = float(np.trace(step)), float(np.linalg.det(step))
    # C (z - A)^-1 b = (C b/z + (C A b - tr(A) C b)/z^2)/(1 - tr(A)/z + det(A)/z^2)
    first, other = ((C @ b, C @ step @ b - trace * (C @ b)) for b in (late, both[:, 0] - late))
    return Section(float(first[0]), float(first[1] + other[0]), float(other[1]), -trace, determinant)


class Known(NamedTuple):
    """A linear part that is already known when a hysteresis is fitted."""

    part: LinearPart
    parts: tuple[str, ...] = ()  #: Lag, delay or creep that are searched nevertheless.


def _flat(A, B, C, D: float, sample_time: float, delay: float) -> LinearParameters:
    A, B, C = (tuple(np.ravel(value).tolist()) for value in (A, B, C))
    if not A and not delay:
        return LinearParameters()
    return LinearParameters(A, B, C, D=(float(D),) if D else (), sample_time=sample_time, delay=float(delay))


#: Window length of the smoothed derivative in :func:`undo_lag`, as a multiple of the lag, and least number of samples
#: in the window.
LAG_WINDOW = 3.0
FEWEST_IN_WINDOW = 5
#: Magnitude of the response below which dynamics with modes are no longer fully inverted.
SMALLEST_RESPONSE = 0.1


def undo(y, part: LinearPart, sample_time: float) -> np.ndarray:
    """Return the input, shape (N,), for which lag, delay and modes give the output ``y``.

    ``y`` is smoothed only as much as the inversion needs.

    Units: ``y`` [m], ``sample_time`` [s].
    """
    if not part.modes:
        return undo_lag(y, part.lag, part.delay + 0.5 * part.hold, sample_time)
    y = np.asarray(y, dtype=float)
    # mirrored about the ends, so that level and slope continue
    longer = np.concatenate([2.0 * y[0] - y[:0:-1], y, 2.0 * y[-1] - y[-2::-1]])
    response = np.fft.rfft(replace(part, creep_rate=0.0).impulse(longer.size, sample_time))
    spectrum = np.fft.rfft(longer - y[0]) * response.conj() / (np.abs(response) ** 2 + SMALLEST_RESPONSE**2)
    found = np.fft.irfft(spectrum, longer.size) * (1.0 + SMALLEST_RESPONSE**2)
    return found[y.size - 1 : 2 * y.size - 1] + y[0]


def undo_lag(y, lag: float, delay: float, sample_time: float) -> np.ndarray:
    """Return the input, shape (N,), for which a lag and a delay in series give the output ``y``.

    ``y`` is smoothed only as much as its derivative needs.

    Units: ``lag`` [s], ``delay`` [s], ``sample_time`` [s].
    """
    y = np.asarray(y, dtype=float)
    if lag + delay < 0.1 * sample_time:
        return y.copy()
    samples = max(FEWEST_IN_WINDOW, 2 * int(0.5 * LAG_WINDOW * lag / sample_time) + 1)
    samples = min(samples, y.size - 1 + y.size % 2)
    smooth = scipy.signal.savgol_filter(y, samples, 2)
    slope = scipy.signal.savgol_filter(y, samples, 2, deriv=1, delta=sample_time)
    early = smooth + lag * slope
    place = np.arange(y.size) + delay / sample_time
    return np.interp(place, np.arange(y.size), early)


def undo_creep(y, part: LinearPart, sample_time: float) -> np.ndarray:
    """Return the displacement [m], shape (N,), that becomes ``y`` by creep, sample by sample as in the compensator.

    Units: ``sample_time`` [s].
    """
    y = np.ascontiguousarray(y, dtype=np.float64)
    block = Creep(part.creep, sample_time)
    block.settle(float(y[0]) / part.settled_gain if part.settled else 0.0)
    found = np.empty_like(y)
    for k in range(y.size):
        found[k] = creep_inverse(block.p, block.x, y[k])
        creep(block.p, block.x, found[k])
    return found
