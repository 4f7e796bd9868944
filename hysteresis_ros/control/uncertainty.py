# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants that a design has to be good for besides its own model: other gains, other times, more delay.

A design sees linear dynamics, because the compensator inverts hysteresis and creep. What it does not invert, because
the slope of a hysteresis depends on amplitude and history, acts on a loop as another gain; so it is drawn as one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import product as combinations
from typing import Any

import numpy as np

from hysteresis_ros.control.closed_loop import plant_state_space
from hysteresis_ros.control.margins import UNSTABLE, Judged, Requirements, judge
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import product, rounded, solve
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.state_space import StateSpace

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
        With the second output of :func:`~hysteresis_ros.control.closed_loop.with_acting`.
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
        With the second output of :func:`~hysteresis_ros.control.closed_loop.with_acting`.

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
