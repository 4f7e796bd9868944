# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Learning of all axes of a stage together, from run to run of a periodic scan: norm-optimal, harmonic by harmonic.

In run j the corrections M_j of all axes (n complex amplitudes at each harmonic of the common period) are fixed, and the
errors against the undelayed path have the amplitudes E_j = c - T M_j. T (n × n) is the closed loop from references to
displacements, and c is the error without corrections. Neither c nor T is known exactly. Both are estimated at each
harmonic from the model and from all runs:

- *The model's uncertainty* gives mean and covariance of T before any run. They are computed over plants with other
  gains, modes and delays, drawn independently for each actuator and each mode. :data:`UNSEEN` represents effects that
  no model describes.
- *Each run* is a measurement of c - T M_j. The noise of this measurement is known from the differences between the
  periods of the run. A linear minimum-variance estimate combines both sources (a Kalman filter with a constant state).

The corrections of the next run minimise the expected squared error of that run,

    E |c - T M|² = min  ⇒  M = (E[T* T])⁻¹ E[T* c].

This is the lifted norm-optimal learning of Amann, Owens & Rogers [1]_, with periods instead of trials from rest; the
lifted matrices are then diagonal in the harmonics. The covariance of T acts as a weight on the change of the
corrections. Where the model is uncertain, for example at a mode whose frequency is not well known, the steps are small;
they grow as the runs reduce the uncertainty. An error is learned only as far as it exceeds its noise (factor 1 - 4
σ²/|E|², at least 0; 4 is :data:`SIGNIFICANT`).

References
----------
.. [1] Amann, Owens & Rogers, Iterative learning control using optimal feedback and feedforward actions, International
   Journal of Control 65 (2), 1996.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.learning import LONGEST, Learned, LearningParameters, read_learned
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.designs.controller import learning_text
from hysteresis_ros.designs.coupled import require_no_feedforward, with_sections
from hysteresis_ros.designs.learning import COUPLED as KIND
from hysteresis_ros.designs.learning import MAXIMUM, SHORTFALL, LearningRequest
from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.loop.reach import reachable_displacements
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.loop.stage_response import RESTING, controllers_of, scanned_paths
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.recordings.dataset import Recording

#: Assumed standard deviation of each entry of T due to effects that no model describes.
UNSEEN = 0.05
#: Assumed fraction of an error that deviates from c - T M because of the hysteresis.
NONLINEAR = 0.1
#: An error is learned if its square exceeds this multiple of the variance of its noise. Noise alone exceeds the limit
#: in less than 2 % of the cases.
SIGNIFICANT = 4.0
#: The noise of the runs is averaged over this number of harmonics on either side.
SMOOTHED = 15
#: Minimum number of periods of a run: one for settling, and two whose difference shows the noise.
FEWEST = 3
#: Largest allowed fraction of samples of an axis without a measurement; the average over the periods omits them.
MOST_MISSING = 0.01
#: Highest frequency that is learned, as a fraction of the sample rate.
HIGHEST = 0.45
#: Modulus below which a pole counts as a delay.
DELAYING = 0.02
#: Distance below which poles count as equal; poles are left out if the products of their eigenvectors have a condition
#: number of at least the reciprocal of this distance.
EQUAL = 1e-8
#: Number of angles that are computed at once.
BLOCK = 4096


@dataclass(frozen=True, eq=False)
class Loops:
    """Closed loop T from references to displacements at F harmonics: mean and covariance over all possible stages."""

    mean: np.ndarray  #: shape (F, n, n)
    covariance: np.ndarray  #: shape (F, n, n, n); Covariance of each row.

    @property
    def square(self) -> np.ndarray:
        """E[T* T], shape (F, n, n)."""
        return np.einsum("fia,fib->fab", self.mean.conj(), self.mean) + np.einsum("fiba->fab", self.covariance)


def possible_loops(parameters: StageParameters, angles: np.ndarray, possible: Uncertainty) -> Loops:
    """Return mean and covariance of the closed loop at ``angles`` [rad], over all stages within an uncertainty.

    Each actuator has its own random gain, slope and delay. Each mode of the structure has its own random factor on its
    time scale.
    """
    random = np.random.default_rng(possible.seed)
    stage, count = parameters.stage, len(parameters.names)
    linear = stage.structure.linear if stage.type == HAMMERSTEIN else stage.structure.small
    held = linear.held()
    modes = _modes(linear)
    sensors, into = stage.matrix("sensor_matrix"), stage.matrix("decoupling")
    draws = []
    for _ in range(possible.draws):
        slowness = 1.0 + possible.resonance * random.uniform(-1.0, 1.0, len(modes))
        gain = 1.0 + possible.gain * random.uniform(-1.0, 1.0, count)
        gain *= 1.0 + possible.hysteresis * random.uniform(-1.0, 1.0, count)
        draws.append((slowness, gain, possible.delay * random.uniform(0.0, 1.0, count)))
    late = [axis.plant_simulator.dynamics for axis in parameters.axes]
    controllers, identity = controllers_of(parameters), np.eye(count)
    means, covariances = [], []
    for begin in range(0, len(angles), BLOCK):
        some = np.maximum(np.abs(angles[begin : begin + BLOCK]), RESTING)
        z = np.exp(1j * some)
        both = np.array([one.response(z)[:, 0] for one in controllers])
        forward, back = (np.swapaxes(both[:, :, place], 0, 1)[:, np.newaxis] for place in (0, 1))
        own = np.array([_acting(one, z) for one in late]).T
        found = []
        whole = held.response(z)
        for slowness, gain, delay in draws:
            plant = whole
            for (pole, residue), factor in zip(modes, slowness, strict=True):
                plant = plant + _slower(pole, residue, factor, z)
                if pole.imag:
                    plant = plant + _slower(pole.conjugate(), residue.conj(), factor, z)
            acting = own * gain * np.exp(-1j * np.outer(some, delay))
            plant = sensors @ (plant * acting[:, np.newaxis]) @ into
            found.append(np.linalg.solve(identity - plant * back, plant * forward))
        loops = np.array(found)
        mean = loops.mean(axis=0)
        apart = loops - mean
        covariance = np.einsum("pfia,pfib->fiab", apart, apart.conj()) / len(loops)
        means.append(mean)
        covariances.append(covariance + UNSEEN**2 * identity)
    return Loops(np.concatenate(means), np.concatenate(covariances))


def _slower(pole: complex, residue: np.ndarray, factor: float, z: np.ndarray) -> np.ndarray:
    """Return the change of the response if a mode becomes slower by a factor and keeps its static gain."""
    moved = pole ** (1.0 / factor)
    change = (1.0 - moved) / (1.0 - pole) / (z - moved) - 1.0 / (z - pole)
    return change[:, np.newaxis, np.newaxis] * residue


def _modes(model: StateSpace) -> list[tuple[complex, np.ndarray]]:
    """Return pole and residue, shape (q, m), of each mode; equal poles are combined.

    Of a conjugate pair, only the pole above the real axis is returned. Poles that count as delays and poles on the
    negative real axis are omitted, because they are not modes in continuous time.
    """
    import scipy.linalg

    poles, left, right = scipy.linalg.eig(model.A, left=True, right=True)
    found, done = [], np.zeros(len(poles), dtype=bool)
    for i, pole in enumerate(poles):
        if done[i] or abs(pole) < DELAYING or pole.imag < 0.0 or (pole.imag == 0.0 and pole.real < 0.0):
            continue
        equal = np.abs(poles - pole) < EQUAL
        done |= equal
        overlap = left[:, equal].conj().T @ right[:, equal]
        if np.linalg.cond(overlap) < 1.0 / EQUAL:
            projector = right[:, equal] @ np.linalg.solve(overlap, left[:, equal].conj().T)
            found.append((complex(pole), model.C @ projector @ model.B))
    return found


def _acting(dynamics, z: np.ndarray) -> np.ndarray:
    """Return the response of an actuator's dynamics and delay, shape (F,)."""
    row, through = dynamics.acting
    model = dynamics.state_space
    return StateSpace(model.A, model.B, row[np.newaxis], np.array([[through]])).response(z)[:, 0, 0]


@dataclass(frozen=True, eq=False)
class Belief:
    """Estimate of c and T at F harmonics: mean and covariance of the rows (c_i, T_i1 … T_in), shape (F, n, …)."""

    mean: np.ndarray  #: shape (F, n, 1 + n)
    covariance: np.ndarray  #: shape (F, n, 1 + n, 1 + n)

    @classmethod
    def after(cls, loop: Loops, correction, error, variance) -> Belief:
        """Return the estimate after the first run: c = E + T M, with the uncertainty of E and of T."""
        count = correction.shape[1]
        turn = np.broadcast_to(np.eye(1 + count, dtype=complex), (len(correction), 1 + count, 1 + count)).copy()
        turn[:, 0, 1:] = correction
        mean = np.concatenate([error[:, :, np.newaxis], loop.mean], axis=2)
        apart = np.zeros((*mean.shape, 1 + count), dtype=complex)
        apart[:, :, 0, 0], apart[:, :, 1:, 1:] = variance, loop.covariance
        covariance = np.einsum("fab,fibc,fdc->fiad", turn, apart, turn.conj())
        return cls(np.einsum("fab,fib->fia", turn, mean), covariance)

    def given(self, correction, error, variance) -> Belief:
        """Return the estimate after a further run, from corrections, errors and their variance, shape (F, n) each."""
        inputs = np.concatenate([np.ones((len(correction), 1)), -correction], axis=1)[:, np.newaxis]
        # row by row: e_i = inputs · row_i + noise
        carried = np.einsum("fnij,fnj->fni", self.covariance, inputs.conj())
        spread = np.einsum("fni,fni->fn", inputs, carried).real + variance
        gain = carried / spread[:, :, np.newaxis]
        missing = error - np.einsum("fni,fni->fn", inputs, self.mean)
        covariance = self.covariance - gain[..., np.newaxis] * carried.conj()[:, :, np.newaxis]
        return Belief(self.mean + gain * missing[:, :, np.newaxis], covariance)

    def step(self, correction, noise) -> np.ndarray:
        """Return the change of the corrections (F, n) with the least expected error; 0 for errors below the noise."""
        mean, whole = self.mean, self.covariance
        square = np.einsum("fia,fib->fab", mean[:, :, 1:].conj(), mean[:, :, 1:])
        square += np.einsum("fiba->fab", whole[:, :, 1:, 1:])
        inputs = np.concatenate([np.ones((len(correction), 1)), -correction], axis=1)[:, np.newaxis]
        left = np.einsum("fni,fni->fn", inputs, mean)
        # E[conj(T_ia) (c_i - T_i M)], row by row
        shared = np.einsum("fnj,fnja->fna", np.broadcast_to(inputs, mean.shape), whole[:, :, :, 1:])
        crossed = mean[:, :, 1:].conj() * left[:, :, np.newaxis] + shared
        certain = np.maximum(1.0 - SIGNIFICANT * noise / np.maximum(np.abs(left) ** 2, 1e-300), 0.0)
        wanted = np.einsum("fna,fn->fa", crossed, certain)
        return np.linalg.solve(square, wanted[..., np.newaxis])[..., 0]


@dataclass(frozen=True, eq=False)
class Trial:
    """Result of a run of a scan with fixed corrections, for all n axes."""

    correction: np.ndarray  #: shape (n, N) [m]
    error: np.ndarray  #: shape (n, N); Path minus measurement, averaged over the periods [m].
    variance: np.ndarray  #: shape (n, N // 2 + 1); Variance of ``numpy.fft.rfft`` of this error.
    missing: np.ndarray  #: shape (n,); Number of samples without a measurement; the average omits them.


def trial(parameters: StageParameters, run: Recording, correction: np.ndarray) -> Trial:
    """Return the result of a run without its settling periods."""
    paths = scanned_paths(parameters)
    period = paths.shape[1]
    errors, first = [], 1
    for place, (name, axis) in enumerate(zip(parameters.names, parameters.axes, strict=True)):
        measured = np.asarray(run[f"{name}/measured"])
        whole = len(measured) // period
        if whole < FEWEST:
            raise RecordingError(
                f"the run has {len(measured) / period:.3g} periods of the scan: must be {FEWEST} or more, one to "
                "settle and others to distinguish errors from noise; set scan.periods"
            )
        wanted = axis.generator.initial_setpoint + paths[place]
        given = np.asarray(run[f"{name}/reference"])[: whole * period].reshape(whole, period)
        same = np.all(np.abs(given - wanted) <= 1e-9, axis=1)
        # the first motion from rest may take longer than a period
        settled = 1 + int(np.argmax(same[1:])) if axis.generator.approach.from_rest else 1
        if not np.all(same[settled:]) or whole - settled < FEWEST - 1:
            raise RecordingError(
                f"{name}/reference differs from the configured scan; record the scan from its beginning"
            )
        first = max(first, settled)
        errors.append(wanted - measured[: whole * period].reshape(whole, period))
    found = np.array(errors)[:, first:]
    known = np.isfinite(found)
    _require_measured(parameters, known, first)
    mean = np.mean(found, axis=1, where=known)
    apart = np.where(known, found - mean[:, np.newaxis], 0.0)
    count = found.shape[1]
    spread = np.sum(np.abs(np.fft.rfft(apart, axis=2)) ** 2, axis=1) / (count * (count - 1))
    kernel = np.full(2 * SMOOTHED + 1, 1.0)
    weight = np.convolve(np.ones(spread.shape[1]), kernel, "same")
    smooth = np.array([np.convolve(row, kernel, "same") for row in spread]) / weight
    # the spread of a single line may be larger than the spread of its neighbours
    missing = np.count_nonzero(~known, axis=(1, 2))
    return Trial(np.asarray(correction, dtype=float), mean, np.maximum(smooth, spread / count), missing)


def _require_measured(parameters: StageParameters, known: np.ndarray, first: int) -> None:
    """Refuse a run with too many missing measurements, or with a sample of the scan that was never measured.

    ``known`` has the shape (n, periods, N); it omits the first ``first`` periods of the run.
    """
    period, remedy = known.shape[2], "check the sensor and the machine (hysteresis doctor), and record the run again"
    for name, own in zip(parameters.names, known, strict=True):
        lost = np.flatnonzero(~own)
        if lost.size > MOST_MISSING * own.size:
            raise RecordingError(
                f"{name}/measured: {lost.size} of {own.size} samples after the first {first * period} have no "
                f"measurement, the first at {(first * period + lost[0]) / parameters.sample_rate:.6g} s: must be "
                f"{100.0 * MOST_MISSING:g} % or less; {remedy}"
            )
        never = np.flatnonzero(~own.any(axis=0))
        if never.size:
            raise RecordingError(
                f"{name}/measured: {never.size} samples of the scan have no measurement in any of {len(own)} periods, "
                f"the first {never[0] / parameters.sample_rate:.6g} s after the beginning of a period: {remedy}, or "
                "set scan.periods higher"
            )


@dataclass(frozen=True, eq=False)
class CoupledLearning:
    """Learning of all axes of a stage for the scan of the stage."""

    parameters: StageParameters
    request: LearningRequest
    paths: np.ndarray  #: shape (n, N); Motion that the scan adds to the setpoints of the axes in a period [m].
    places: np.ndarray  #: shape (F,); Harmonics that are learned.
    loops: Loops

    @classmethod
    def of(cls, parameters: StageParameters, request: LearningRequest) -> CoupledLearning:
        """Prepare the learning of a stage; the request gives ranges, bandwidth and largest correction."""
        require_no_feedforward(parameters)
        paths, rate = scanned_paths(parameters), parameters.sample_rate
        period = paths.shape[1]
        if period > LONGEST:
            raise ConfigurationError(
                f"the scan repeats after {period} samples, but learning allows at most {LONGEST}; choose shorter frames"
            )
        highest = HIGHEST * rate if request.bandwidth is None else request.bandwidth
        if not 1.0 <= highest * period / rate < 0.5 * period:
            lowest = rate / period
            raise ConfigurationError(f"--bandwidth {highest:g}: must be {lowest:.4g} … {0.5 * rate:g} Hz")
        places = np.arange(1, int(highest * period / rate) + 1)
        return cls(
            parameters,
            request,
            paths,
            places,
            possible_loops(parameters, 2.0 * np.pi * places / period, request.possible),
        )

    def first(self) -> np.ndarray:
        """Return the corrections of the first run, shape (n, N) [m]; they minimise the expected squared error."""
        lines = np.fft.rfft(self.paths, axis=1)
        wanted = lines[:, self.places].T
        mean = np.swapaxes(self.loops.mean, 1, 2).conj()
        asked = np.linalg.solve(self.loops.square, (mean @ wanted[..., np.newaxis]))[..., 0]
        found = np.zeros_like(lines)
        found[:, self.places] = (asked - wanted).T
        return np.fft.irfft(found, self.paths.shape[1], axis=1)

    def after(self, trials: Sequence[Trial]) -> np.ndarray:
        """Return the corrections of the run after these runs, shape (n, N) [m]."""
        belief: Belief | None = None
        for one in trials:
            given = np.fft.rfft(one.correction, axis=1)[:, self.places].T
            error = np.fft.rfft(one.error, axis=1)[:, self.places].T
            variance = one.variance[:, self.places].T + NONLINEAR**2 * np.abs(error) ** 2
            known = (given, error, variance)
            belief = Belief.after(self.loops, *known) if belief is None else belief.given(*known)
        if belief is None:
            return self.first()
        lines = np.fft.rfft(trials[-1].correction, axis=1)
        present = lines[:, self.places].T
        lines[:, self.places] = (present + belief.step(present, trials[-1].variance[:, self.places].T)).T
        return np.fft.irfft(lines, self.paths.shape[1], axis=1)

    def learned(self, corrections: np.ndarray) -> dict[str, Learned]:
        """Return the corrections of each axis in the form of its file."""
        step = 1.0 / self.parameters.sample_rate
        return {
            name: Learned(len(own) * step, step, own, axis.generator.initial_setpoint + path)
            for name, axis, own, path in zip(
                self.parameters.names, self.parameters.axes, corrections, self.paths, strict=True
            )
        }

    def chosen(self, corrections: np.ndarray, files: dict[str, str]) -> dict[str, LearningParameters]:
        """Return the learning parameters with which each axis applies the correction in its file (``files``)."""
        found = {}
        for name, axis, own in zip(self.parameters.names, self.parameters.axes, corrections, strict=True):
            low, high = reachable_displacements(axis)
            maximum = self.request.maximum if self.request.maximum is not None else MAXIMUM * (high - low)
            largest = float(np.max(np.abs(own)))
            if largest > maximum:
                raise ConfigurationError(
                    f"{name}: the scan needs corrections of {1e6 * largest:.4g} µm, but at most {1e6 * maximum:.4g} "
                    "µm are allowed: give a larger --maximum, or scan more slowly"
                )
            found[name] = LearningParameters(
                type=KIND,
                period=len(own) / self.parameters.sample_rate,
                error_filter=(0.0,),
                robustness_filter=(1.0,),
                maximum=float(f"{maximum:.4g}"),
                shortfall=float(f"{SHORTFALL * (high - low):.4g}"),
                active=False,
                file=files[name],
            ).validated("learning.")
        return found


def applied(parameters: StageParameters) -> np.ndarray:
    """Return the corrections in the files of the axes of a stage, shape (n, N) [m]; 0 for an axis without a file."""
    paths = scanned_paths(parameters)
    found = np.zeros_like(paths)
    for place, axis in enumerate(parameters.axes):
        given = axis.motion_controller.learning
        if not given.in_use:
            continue
        if given.active:
            raise ConfigurationError(
                f"{axis.namespace}/motion_controller: learning.active = true: must be false in a run to learn from, "
                "because its corrections must not change"
            )
        if given.file:
            own = read_learned(given.file).correction
            if paths.shape[1] % len(own):
                raise ConfigurationError(f"{given.file}: its period differs from the period of the scan: learn again")
            found[place] = np.tile(own, paths.shape[1] // len(own))
    return found


def coupled_learning_file(
    configuration: Configuration, chosen: dict[str, LearningParameters], runs: Sequence[str]
) -> str:
    """Return the text of the parameter file with which each axis applies the correction in its file."""
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    learned = f"learned from {', '.join(runs)}" if runs else "those of the coupled model, before any run"
    header = (
        f"Learning designed by `hysteresis design {source} --learning {KIND}`\n"
        f"over the controller of this file: corrections of all axes together, {learned}."
    )
    return with_sections(
        configuration, chosen, header, lambda one, given, head, space: learning_text(one, given, space, head)
    )


def learned_from(
    configuration: Configuration, request: LearningRequest, runs: Sequence[Recording]
) -> tuple[CoupledLearning, np.ndarray, list[Trial]]:
    """Return the learning of a stage, its corrections after the runs in the given order, and the result of each run."""
    parameters = StageParameters.from_configuration(configuration)
    learning = CoupledLearning.of(parameters, request)
    trials = []
    for run in runs:
        if not run.configuration:
            raise RecordingError(
                "a run has no configuration, so it is unknown which corrections it used: give a bag, .mcap or .npz"
            )
        own = StageParameters.from_configuration(parse_configuration(run.configuration, "the run"))
        trials.append(trial(parameters, run, applied(own)))
    return learning, learning.after(trials), trials


def trial_lines(parameters: StageParameters, trials: Sequence[Trial]) -> list[str]:
    """Return the printed lines with the results of each axis in each run."""
    rows = []
    for number, one in enumerate(trials, start=1):
        period = one.error.shape[1]
        for name, error, variance, missing in zip(parameters.names, one.error, one.variance, one.missing, strict=True):
            rms = float(np.sqrt(np.mean((error - error.mean()) ** 2)))
            # rfft returns half of the spectrum, so all amplitudes except the mean count twice
            noise = float(np.sqrt(2.0 * np.sum(variance[1:]))) / period
            omitted = f"; {missing} samples without a measurement are omitted" if missing else ""
            rows.append(
                f"run {number}, {name}: periodic error {1e9 * rms:.4g} nm RMS, of which {1e9 * noise:.3g} nm is "
                f"noise{omitted}"
            )
    return rows
