# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants that a design has to be good for besides its own model: other parameters, or another frequency response.

A design sees linear dynamics, because the compensator inverts hysteresis and creep. What it does not invert, because
the slope of a hysteresis depends on amplitude and history, acts on a loop as another gain; so it is drawn as one.

A plant P (1 + Δ) with |Δ| ≤ l at each frequency keeps a loop stable as long as l |T| < 1, and then the distance of its
loop transfer from −1 is at least |1 + L| − l |L|, whose inverse is the worst sensitivity [1]_.

Where nothing is known a model says nothing of the plant, not even how large its response is. There a resonance of
damping :data:`DAMPING` is assumed at whatever frequency suits the loop least: it adds a/(2 DAMPING) of the response at
rest, which feedback meets by its own gain |C|. The part a of the displacement that passes through it is one, or less
just above what is known: at f' below its frequency f it changes the response by a/((f/f')² − 1), which would show.

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

#: Largest part by which gain, slope or times may be off: the sign stays, with a margin.
LARGEST = 0.5
#: Plants in which gain and slope, times and delay are all at an end of their ranges.
CORNERS = 8
#: Most plants, and longest further delay [samples].
MOST = 10_000
LATEST = 16.0


@dataclass(frozen=True)
class Uncertainty:
    """How far plants may be from the model.

    Parameters
    ----------
    gain : float
        Largest part by which the gain is off.
    hysteresis : float
        Largest part by which the slope of the hysteresis that the inverse leaves is off.
    resonance : float
        Largest part by which all times are off: frequencies of resonances, time constants, the model's own delay.
    delay : float
        Largest delay beyond that of the model [samples].
    draws : int
        Number of plants drawn, besides the corners.
    seed : int
        Of the draws; equal seeds give equal plants.

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
        """Refuse ranges that describe no plants."""
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
    """A plant that a design is judged on.

    Parameters
    ----------
    plant : StateSpace
        From command to measured displacement in SI.
    late : float
        Its delay beyond that of the model [samples].
    description : str
        How it differs from the model.
    """

    plant: StateSpace
    late: float = 0.0
    description: str = "the model"

    def closed(self, closing: Callable[[StateSpace], StateSpace]) -> PossiblePlant:
        """Return it with an inner loop around it.

        Parameters
        ----------
        closing : callable
            Returns the damped plant of a plant.
        """
        return replace(self, plant=closing(self.plant))


def judge_worst(controller: StateSpace, plants, sample_time: float, required: Requirements | None = None) -> Judged:
    """Return the bandwidth on the first of the plants, and the worst of everything else on all of them.

    The delay margin counts from the delay of the model, so that a plant that is later is not asked for it twice.

    Parameters
    ----------
    controller : StateSpace
        Inputs (reference, measured), output command.
    plants : sequence of PossiblePlant
        The model first.
    sample_time : float
        [s]
    required : Requirements, optional
        With them the first plant that misses them is the last one looked at.
    """
    found: list[Judged] = []
    for one in plants:
        judged = judge(controller, one.plant, sample_time)
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


def slowed(dynamics: LinearParameters, slowness: float) -> dict:
    """Return what changes of the dynamics with all times longer by a factor: poles z^(1/slowness), and the delay.

    The DC gain stays. Dynamics with a pole on the negative real axis or at zero belong to no continuous model; there
    only the other poles move.

    Parameters
    ----------
    dynamics : LinearParameters
        Discrete dynamics.
    slowness : float
        Factor on every time constant and period.

    Returns
    -------
    dict
        ``A`` and ``B`` as lists where there are matrices, ``delay`` where there is one.
    """
    delayed = {"delay": dynamics.delay * slowness} if dynamics.delay else {}
    model = dynamics.matrices
    if not model.order:
        return delayed
    A, B = model.A, model.B[:, 0]
    poles, vectors = np.linalg.eig(A.astype(complex))
    continuous = (poles.imag != 0.0) | (poles.real > 0.0)
    moved = np.where(continuous, np.exp(np.log(np.where(continuous, poles, 1.0)) / slowness), poles)
    exact = np.real(vectors @ np.diag(moved) @ np.linalg.inv(vectors))
    # logarithms and eigenvectors differ in the last digits from processor to processor
    changed = rounded(exact)
    identity = np.eye(len(A))
    rest = solve(identity - A, B)  # the state at rest per unit of input, which is to stay
    return {"A": changed.ravel().tolist(), "B": product(identity - changed, rest).tolist(), **delayed}


def possible_plant(
    dynamics: LinearParameters,
    sample_time: float,
    gain: float = 1.0,
    slowness: float = 1.0,
    late: float = 0.0,
    *,
    acting: bool = False,
) -> PossiblePlant:
    """Return a plant whose gain, times and delay differ from the model's.

    Parameters
    ----------
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]
    gain, slowness : float
        Factors on the gain and on all times.
    late : float
        Further delay [samples].
    acting : bool
        With the second output of :func:`~hysteresis_ros.control.margins.with_acting`.
    """
    changed = slowed(dynamics, slowness) if slowness != 1.0 else {}
    matrices: dict[str, Any] = {name: tuple(changed[name]) for name in ("A", "B") if name in changed}
    delay = changed.get("delay", dynamics.delay) + late * sample_time
    scale = dynamics.resolved_input_scale
    other = replace(dynamics, **matrices, delay=delay, sample_time=sample_time, input_scale=scale)
    text = f"gain {100.0 * (gain - 1.0):+.3g} %, times {100.0 * (slowness - 1.0):+.3g} %, {late:.3g} samples later"
    return PossiblePlant(plant_state_space(other, acting=acting).scaled(gain), late, text)


def drawn_plants(
    dynamics: LinearParameters, sample_time: float, uncertainty: Uncertainty, *, acting: bool = False
) -> tuple[PossiblePlant, ...]:
    """Return the model, the corners of its uncertainty, and plants drawn evenly within it.

    Parameters
    ----------
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]
    uncertainty : Uncertainty
    acting : bool
        With the second output of :func:`~hysteresis_ros.control.margins.with_acting`.

    Returns
    -------
    tuple of PossiblePlant
        1 + 8 + ``draws`` of them, the model first.
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


#: Damping of the resonance that is assumed where nothing is known, and its height over the response at rest. Bare
#: stacks and flexures of metal without glue have dampings down to this.
DAMPING = 0.003
UNKNOWN = 1.0 / (2.0 * DAMPING)
#: A resonance nearer to what is known than this factor, through which all of the displacement passes, would show there
#: by half of the response.
UNSEEN = 1.0 / (1.0 - 1.0 / 1.5) ** 0.5
#: A resonance nearer to it than this part is not told from what is known.
NEAREST = 0.12
#: Distance from −1 that a loop keeps whatever the plant is within its uncertainty.
KEPT = 0.2
#: Points of the grid, over so many decades below half the sample rate, and around each pole.
POINTS, DECADES, AROUND = 500, 5.0, 41
#: Steps in which the fastest loop is searched for, over the same decades.
STEPS = 100


class Borne(NamedTuple):
    """How a loop bears an uncertainty.

    Parameters
    ----------
    distance : float
        Least distance of the loop transfer from −1 that is certain; not above 0: stability is not.
    frequency : float
        Where that is [Hz].
    uncertainty : float
        l there.
    nominal : float
        Least distance on the model itself, 1/M_s.
    """

    distance: float
    frequency: float
    uncertainty: float
    nominal: float


@dataclass(frozen=True, eq=False)
class ResponseUncertainty:
    """Largest relative error l of a model's frequency response, and what may stand where none is known.

    Parameters
    ----------
    frequencies : ndarray, shape (n,)
        [Hz], rising.
    relative : ndarray, shape (n,)
        l at each; below the first it is that of the first, above the last nothing is known.
    known_to : float
        Frequency [Hz] above which nothing is known; infinite where all is.
    """

    frequencies: np.ndarray
    relative: np.ndarray
    known_to: float

    def at(self, frequencies) -> np.ndarray:
        """Return l, shape (n,), straight between the points; where nothing is known with the height of a resonance.

        Parameters
        ----------
        frequencies : array_like, shape (n,)
            [Hz]
        """
        f = np.asarray(frequencies, dtype=float)
        known = np.interp(f, self.frequencies, self.relative)
        return np.where(f > self.known_to, np.maximum(known, self.height(f)), known)

    def share(self, frequencies) -> np.ndarray:
        """Return which part of the displacement may pass through a resonance that nobody saw, shape (n,); 0 if known.

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
        """Return how high a resonance may stand over the response at rest, shape (n,); 0 where it is known.

        Parameters
        ----------
        frequencies : array_like, shape (n,)
            [Hz]
        """
        return UNKNOWN * self.share(frequencies)

    def assumption(self, sample_time: float) -> str:
        """Return in words what is assumed where nothing is known, and which gain of the feedback follows; or nothing.

        Parameters
        ----------
        sample_time : float
            [s]
        """
        highest = 0.5 / sample_time
        if self.known_to >= highest:
            return ""
        frequencies = np.geomspace(max(self.known_to, 1e-3 * highest), highest, POINTS)[1:]
        height = self.height(frequencies)
        most = float(np.max(height))
        onwards = float(frequencies[np.argmax(height >= 0.99 * most)])
        return (
            f"above {self.known_to:.3g} Hz nothing is known of the plant; a resonance of damping {DAMPING:g} is "
            f"assumed anywhere there, from {onwards:.3g} Hz on {most:.3g} times as high as the response at rest "
            f"(nearer ones would have shown), which keeps the gain of feedback there below {(1.0 - KEPT) / most:.2g}"
        )

    def borne_by(self, controller: StateSpace, plant: StateSpace, sample_time: float) -> Borne:
        """Return what is certain of a loop.

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
        # what passes through a resonance that nobody saw is missing where the model has it
        relative = np.maximum(np.interp(frequencies, self.frequencies, self.relative), share)
        gain = np.abs(feedback[:, 0]) * abs(plant.response(np.ones(1))[0, 0, 0])
        distance = np.abs(1.0 + values) - relative * np.abs(parts[:, 0]) - UNKNOWN * share * gain
        place = int(np.argmin(distance))
        nominal = float(np.min(np.abs(1.0 + values)))
        found = float(distance[place]), float(frequencies[place]), float(self.at(frequencies[place : place + 1])[0])
        return Borne(*found, nominal)


def integral_controller(crossover: float, sample_time: float) -> StateSpace:
    """Return an integrator whose loop would cross gain one at a frequency, were the plant one.

    Parameters
    ----------
    crossover : float
        [Hz]
    sample_time : float
        [s]
    """
    gain = 2.0 * np.pi * crossover * sample_time
    both = np.array([[gain, -gain]])
    return StateSpace(np.eye(1), both, np.eye(1), both)


def fastest_integral(plant: StateSpace, sample_time: float, uncertainty: ResponseUncertainty) -> float:
    """Return the highest crossover [Hz] of integral control with M_s ≤ 2 that is certain to be stable, or 0.

    Parameters
    ----------
    plant : StateSpace
        The model, of unit DC gain.
    sample_time : float
        [s]
    uncertainty : ResponseUncertainty
    """
    fastest = 0.0
    for crossover in 0.25 / sample_time * 10.0 ** np.linspace(-DECADES, 0.0, STEPS):
        borne = uncertainty.borne_by(integral_controller(crossover, sample_time), plant, sample_time)
        if borne.nominal < 1.0 / REQUIRED.sensitivity_peak or borne.distance < KEPT:
            break
        fastest = float(crossover)
    return fastest
