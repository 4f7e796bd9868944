# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Uncertainty of the plant in a design: parameters, or a frequency response, that differ from the model.

A design uses linear dynamics, because the compensator inverts hysteresis and creep. The slope of residual hysteresis
depends on amplitude and history. It acts on a loop like a deviation of the gain, and is represented as one.

With a plant P (1 + Δ), |Δ| ≤ l at each frequency, a loop stays stable as long as l |T| < 1. The distance of the plant's
loop transfer function from −1 is at least |1 + L| − l |L|; the inverse of this bound is the worst sensitivity [1]_.

Above the highest known frequency not even the magnitude of the plant's response is known. There, a resonance with the
damping ratio :data:`DAMPING` is assumed at the worst frequency. The resonance adds a/(2 DAMPING) times the static
response to the response of the plant, and the loop multiplies this addition by the feedback gain |C|. Here a, the
fraction of the displacement that passes through the resonance, is assumed to be 1. Just above the known range a smaller
fraction is assumed: a resonance at f changes the response at f' < f by a/((f/f')² − 1), and the measurement would have
shown a large change.

References
----------
.. [1] Skogestad & Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, section 7.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import product as combinations
from typing import Any, NamedTuple

import numpy as np

from hysteresis_ros.control.margins import REQUIRED, UNSTABLE, Judged, Requirements, judge, plant_state_space
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear import LinearParameters, StateSpace
from hysteresis_ros.models.linear_algebra import product, rounded, solve

#: Largest relative deviation of gain, slope or times that is allowed; it is below 1, so that no sign changes.
LARGEST = 0.5
#: Number of corners: plants in which gain and slope, times, and delay are each at an end of their range.
CORNERS = 8
#: Maximum number of plants, and largest additional delay [samples].
MOST = 10_000
LATEST = 16.0


@dataclass(frozen=True)
class Uncertainty:
    """Ranges of the plants around the model.

    Parameters
    ----------
    gain : float
        Largest relative deviation of the gain.
    hysteresis : float
        Largest relative deviation of the slope of residual hysteresis.
    resonance : float
        Largest relative deviation of all times: periods of resonances, time constants, and the delay of the model.
    delay : float
        Largest delay beyond the delay of the model [samples].
    draws : int
        Number of random plants, in addition to the corners.
    seed : int
        Seed of the random plants; equal seeds give equal plants.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    gain: float = 0.05
    hysteresis: float = 0.1
    resonance: float = 0.1
    delay: float = 1.0
    draws: int = 20
    seed: int = 1

    def __post_init__(self):
        """Refuse values out of range."""
        highest = {"delay": LATEST, "draws": MOST, "seed": 2**32 - 1}
        problems = [
            Problem(item.name, getattr(self, item.name), f"must be within 0 … {highest.get(item.name, LARGEST):g}")
            for item in fields(self)
            if not 0.0 <= getattr(self, item.name) <= highest.get(item.name, LARGEST)
        ]
        if problems:
            raise ParameterError(problems)


@dataclass(frozen=True, eq=False)
class PossiblePlant:
    """A plant on which a design is judged.

    Parameters
    ----------
    plant : StateSpace
        From command to measured displacement, in SI units.
    late : float
        Delay in addition to the delay of the model [samples].
    description : str
        How the plant differs from the model.
    """

    plant: StateSpace
    late: float = 0.0
    description: str = "the model"

    def closed(self, closing: Callable[[StateSpace], StateSpace]) -> PossiblePlant:
        """Return the plant with its inner loop closed.

        Parameters
        ----------
        closing : callable
            Function that takes a plant and returns the damped plant.
        """
        return replace(self, plant=closing(self.plant))


def judge_worst(
    controller: StateSpace,
    plants,
    sample_time: float,
    required: Requirements | None = None,
    *,
    with_bandwidth: bool = True,
) -> Judged:
    """Return the bandwidth on the first plant (the model), and the worst value of every other figure over all plants.

    The delay margin is counted from the delay of the model, so that it includes an additional delay of a plant.
    ``controller`` has the inputs (reference, measured) and the output command. If ``required`` is given, the evaluation
    ends at the first plant that does not meet it. Without ``with_bandwidth``, the bandwidth is NaN. Units:
    ``sample_time`` [s].
    """
    found: list[Judged] = []
    for one in plants:
        judged = judge(controller, one.plant, sample_time, with_bandwidth=with_bandwidth and not found)
        if judged is UNSTABLE:
            return UNSTABLE
        found.append(judged._replace(delay_margin=judged.delay_margin + one.late))
        if required is not None and not found[-1].meets(required):
            break
    return Judged(
        found[0].bandwidth,
        max(judged.sensitivity_peak for judged in found),
        min(judged.delay_margin for judged in found),
        max(judged.noise_gain for judged in found),
        max(judged.command_noise_gain for judged in found),
        min(judged.rejection for judged in found),
        min(judged.feedback for judged in found),
        max(judged.late_sensitivity_peak for judged in found),
    )


def slowed(dynamics: LinearParameters, slowness: float, *, aliased: bool = False) -> dict:
    """Return the parameters that change if all times of the dynamics grow by a factor: poles z^(1/slowness), and delay.

    The DC gain is kept. Poles on the negative real axis or at zero have no continuous-time counterpart and are kept
    too. The result contains ``A`` and ``B`` as lists if there are matrices, and ``delay`` if there is a delay. With
    ``aliased``, a mode at a frequency f above a quarter of the sample rate f_s is assumed to be at f_s - f in the
    plant, so that it moves in the other direction.
    """
    delayed = {"delay": dynamics.delay * slowness} if dynamics.delay else {}
    model = dynamics.matrices
    if not model.order:
        return delayed
    A, B = model.A, model.B[:, 0]
    poles, vectors = np.linalg.eig(A.astype(complex))
    continuous = (poles.imag != 0.0) | (poles.real > 0.0)
    exponents = np.log(np.where(continuous, poles, 1.0))
    if aliased:
        exponents = exponents - 2j * np.pi * np.sign(exponents.imag) * (np.abs(exponents.imag) > 0.5 * np.pi)
    moved = np.where(continuous, np.exp(exponents / slowness), poles)
    exact = np.real(vectors @ np.diag(moved) @ np.linalg.inv(vectors))
    # rounded, because the last digits of logarithms and eigenvectors differ between processors
    changed = rounded(exact)
    identity = np.eye(len(A))
    rest = solve(identity - A, B)  # the steady state for an input of 1, which must not change
    return {"A": changed.ravel().tolist(), "B": product(identity - changed, rest).tolist(), **delayed}


def possible_plant(
    dynamics: LinearParameters,
    sample_time: float,
    gain: float = 1.0,
    slowness: float = 1.0,
    late: float = 0.0,
    *,
    acting: bool = False,
    aliased: bool = False,
) -> PossiblePlant:
    """Return a plant whose gain, times and delay differ from the model's.

    ``gain`` and ``slowness`` are factors on the gain and on all times; ``acting`` adds the second output of
    :func:`~hysteresis_ros.control.margins.with_acting`; ``aliased`` is passed to :func:`slowed`. Units: ``sample_time``
    [s], ``late`` [samples].
    """
    changed = slowed(dynamics, slowness, aliased=aliased) if slowness != 1.0 else {}
    matrices: dict[str, Any] = {name: tuple(changed[name]) for name in ("A", "B") if name in changed}
    delay = changed.get("delay", dynamics.delay) + late * sample_time
    scale = dynamics.resolved_input_scale
    other = replace(dynamics, **matrices, delay=delay, sample_time=sample_time, input_scale=scale)
    text = f"gain {100.0 * (gain - 1.0):+.3g} %, times {100.0 * (slowness - 1.0):+.3g} %, {late:.3g} samples later"
    return PossiblePlant(plant_state_space(other, acting=acting).scaled(gain), late, text)


def drawn_plants(
    dynamics: LinearParameters, sample_time: float, uncertainty: Uncertainty, *, acting: bool = False
) -> tuple[PossiblePlant, ...]:
    """Return the model, the 8 corners of its uncertainty, and ``draws`` plants that are uniformly random within it.

    ``acting`` adds the second output of :func:`~hysteresis_ros.control.margins.with_acting`. Units: ``sample_time``
    [s].
    """
    found = [PossiblePlant(plant_state_space(dynamics, acting=acting))]
    largest = (1.0 + uncertainty.gain) * (1.0 + uncertainty.hysteresis)
    least = (1.0 - uncertainty.gain) * (1.0 - uncertainty.hysteresis)
    times = (1.0 - uncertainty.resonance, 1.0 + uncertainty.resonance)
    for gain, slowness, late in combinations((least, largest), times, (0.0, uncertainty.delay)):
        found.append(possible_plant(dynamics, sample_time, gain, slowness, late, acting=acting))
    random = np.random.default_rng(uncertainty.seed)
    for _ in range(uncertainty.draws):
        gain, slope, slowness = random.uniform(-1.0, 1.0, 3)
        found.append(
            possible_plant(
                dynamics,
                sample_time,
                float((1.0 + uncertainty.gain * gain) * (1.0 + uncertainty.hysteresis * slope)),
                float(1.0 + uncertainty.resonance * slowness),
                float(uncertainty.delay * random.uniform()),
                acting=acting,
            )
        )
    return tuple(found)


#: Number of factors on the times for which plants with aliased modes are computed; there are many, because the
#: resonances are narrow.
ALIASED = 11


def aliased_plants(
    dynamics: LinearParameters, sample_time: float, uncertainty: Uncertainty
) -> tuple[PossiblePlant, ...]:
    """Return plants within the range of times; their modes above a quarter of the sample rate are aliases.

    The result is empty if there are no such modes. A sampled response does not show whether a mode is at f or at f_s -
    f, and a small relative deviation of f_s - f corresponds to a larger relative deviation of f. Units: ``sample_time``
    [s].
    """
    model = dynamics.matrices
    poles = np.linalg.eigvals(model.A) if model.order else np.zeros(0)
    if not np.any((poles.real < 0.0) & (poles.imag != 0.0)):
        return ()
    times = np.linspace(1.0 - uncertainty.resonance, 1.0 + uncertainty.resonance, ALIASED)
    return tuple(possible_plant(dynamics, sample_time, slowness=float(one), aliased=True) for one in times)


#: Damping ratio of the resonance that is assumed above the known range, and height of its peak relative to the static
#: response. Bare stacks, and metal flexures without glue, have damping ratios down to DAMPING.
DAMPING = 0.003
UNKNOWN = 1.0 / (2.0 * DAMPING)
#: If a resonance carries the whole displacement and its frequency is below this multiple of the known range, it changes
#: the known response by more than half.
UNSEEN = 1.0 / (1.0 - 1.0 / 1.5) ** 0.5
#: Lower bound of (f/f')² − 1 for a resonance at f just above the end f' of the known range.
NEAREST = 0.12
#: Required distance of the loop transfer function from −1, for every plant within the uncertainty.
KEPT = 0.2
#: Number of points of the grid.
POINTS = 500
#: Number of decades that the grid covers below half the sample rate.
DECADES = 5.0
#: Number of further points of the grid around each pole.
AROUND = 41
#: Number of gains that are tried, from the model's gain to the largest gain.
GAINS = 9
#: Number of steps of the search for the fastest loop, over the same decades.
STEPS = 100
#: Tolerance factor on the highest crossover, which is stored with few digits and compared on a grid of frequencies.
ROUNDED = 1.02


class Borne(NamedTuple):
    """Robustness of a loop to an uncertainty.

    Parameters
    ----------
    distance : float
        Guaranteed distance of the loop transfer function from −1; ≤ 0: stability is not guaranteed.
    frequency : float
        Frequency at which this distance occurs [Hz].
    uncertainty : float
        l at this frequency.
    nominal : float
        Smallest distance on the model itself, 1/M_s.
    """

    distance: float
    frequency: float
    uncertainty: float
    nominal: float


@dataclass(frozen=True, eq=False)
class ResponseUncertainty:
    """Largest relative error l of a model's frequency response, and an assumed resonance above the known range.

    Parameters
    ----------
    frequencies : ndarray, shape (n,)
        [Hz], rising.
    relative : ndarray, shape (n,)
        l at each frequency. It is constant below the first frequency; above the last frequency the response is unknown.
    known_to : float
        Frequency [Hz] above which the response is unknown; infinite if it is known everywhere.
    crossover : float
        Highest crossover [Hz] that a loop may have. It is finite if the recording shows a movement (ringing) that the
        model does not describe and that l does not bound. 0: no crossover is known to be safe; infinite: only l limits
        the loop.
    gain : float
        Largest factor on the gain of the plant that the recording does not rule out, for hysteresis loops of a tenth of
        the range; at least 1.
    """

    frequencies: np.ndarray
    relative: np.ndarray
    known_to: float
    crossover: float = np.inf
    gain: float = 1.0

    def at(self, frequencies) -> np.ndarray:
        """Return l, shape (n,), linearly interpolated; above the known range it includes the assumed resonance.

        Parameters
        ----------
        frequencies : array_like, shape (n,)
            [Hz]
        """
        f = np.asarray(frequencies, dtype=float)
        known = np.interp(f, self.frequencies, self.relative)
        return np.where(f > self.known_to, np.maximum(known, self.height(f)), known)

    def share(self, frequencies) -> np.ndarray:
        """Return the fraction of displacement that may pass through an unknown resonance, shape (n,); 0 where known.

        Parameters
        ----------
        frequencies : array_like, shape (n,)
            [Hz]
        """
        f = np.asarray(frequencies, dtype=float)
        if self.known_to <= 0.0:
            return np.ones_like(f)
        above = f / self.known_to
        shown = self.relative[-1] * np.maximum(above**2 - 1.0, NEAREST)
        return np.where(above > UNSEEN, 1.0, np.where(above > 1.0, np.minimum(shown, 1.0), 0.0))

    def height(self, frequencies) -> np.ndarray:
        """Return the largest height of an unknown resonance relative to the static response, shape (n,); 0 where known.

        Parameters
        ----------
        frequencies : array_like, shape (n,)
            [Hz]
        """
        return UNKNOWN * self.share(frequencies)

    def assumption(self, sample_time: float) -> str:
        """Return as text what limits the loop: the highest crossover, the assumed resonance, or nothing (empty)."""
        if self.crossover < np.inf:
            return (
                "the recording shows a movement that the model lacks, so no crossover above "
                f"{self.crossover:.3g} Hz is known to be safe"
            )
        highest = 0.5 / sample_time
        if self.known_to >= highest:
            return ""
        frequencies = np.geomspace(max(self.known_to, 1e-3 * highest), highest, POINTS)[1:]
        height = self.height(frequencies)
        most = float(np.max(height))
        onwards = float(frequencies[np.argmax(height >= 0.99 * most)])
        return (
            f"above {self.known_to:.3g} Hz the plant is unknown; a resonance of damping {DAMPING:g} is "
            f"assumed anywhere there, with a peak of {most:.3g} times the response at rest from {onwards:.3g} Hz on "
            "(nearer resonances would be visible), so the gain of the feedback there must be below "
            f"{(1.0 - KEPT) / most:.2g}"
        )

    def borne_by(self, controller: StateSpace, plant: StateSpace, sample_time: float) -> Borne:
        """Return the guaranteed robustness of a loop.

        Parameters
        ----------
        controller : StateSpace
            Inputs (reference, measured), output command.
        plant : StateSpace
            The model.
        sample_time : float
            [s]
        """
        angles = np.pi * 10.0 ** np.linspace(-DECADES, 0.0, POINTS)
        poles = plant.poles[np.abs(plant.poles) > 0.1]
        near = [abs(np.angle(pole)) + 5.0 * abs(np.log(abs(pole))) * np.linspace(-1.0, 1.0, AROUND) for pole in poles]
        angles = np.unique(np.concatenate([angles, *near]))
        angles = angles[(angles > 0.0) & (angles <= np.pi)]
        z = np.exp(1j * angles)
        feedback = controller.response(z)[:, 0, 1:]
        parts = -feedback * plant.response(z)[:, :, 0]
        values = np.sum(parts, axis=1)
        frequencies = angles / (2.0 * np.pi * sample_time)
        share = self.share(frequencies)
        # displacement that passes through an unknown resonance does not also pass through the modelled dynamics
        relative = np.maximum(np.interp(frequencies, self.frequencies, self.relative), share)
        gain = np.abs(feedback[:, 0]) * abs(plant.response(np.ones(1))[0, 0, 0])
        rest = relative * np.abs(parts[:, 0]) + UNKNOWN * share * gain
        # try gains from the model's gain to the largest gain: the smallest distance may occur between them
        distance = np.min([np.abs(1.0 + k * values) - k * rest for k in np.linspace(1.0, self.gain, GAINS)], axis=0)
        place = int(np.argmin(distance))
        nominal = float(np.min(np.abs(1.0 + values)))
        least = float(distance[place])
        above = np.flatnonzero((self.gain * np.abs(values) >= 1.0) & (frequencies > ROUNDED * self.crossover))
        if above.size:
            place, least = int(above[-1]), min(least, 0.0)
        return Borne(least, float(frequencies[place]), float(self.at(frequencies[place : place + 1])[0]), nominal)


def integral_controller(crossover: float, sample_time: float) -> StateSpace:
    """Return an integral controller whose loop with a plant of gain 1 has its crossover at a given frequency.

    Units: ``crossover`` [Hz], ``sample_time`` [s].
    """
    gain = 2.0 * np.pi * crossover * sample_time
    both = np.array([[gain, -gain]])
    return StateSpace(np.eye(1), both, np.eye(1), both)


def fastest_integral(plant: StateSpace, sample_time: float, uncertainty: ResponseUncertainty) -> float:
    """Return the highest crossover [Hz] of integral control with M_s ≤ 2 and guaranteed stability, or 0.

    ``plant`` is the model, with unit DC gain. Units: ``sample_time`` [s].
    """
    fastest = 0.0
    for crossover in 0.25 / sample_time * 10.0 ** np.linspace(-DECADES, 0.0, STEPS):
        borne = uncertainty.borne_by(integral_controller(crossover, sample_time), plant, sample_time)
        if borne.nominal < 1.0 / REQUIRED.sensitivity_peak or borne.distance < KEPT:
            break
        fastest = float(crossover)
    return fastest
