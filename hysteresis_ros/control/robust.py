# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Robust design: gains whose loop meets the requirements on every plant that the uncertainty allows.

All plants are drawn before the design, so equal seeds give equal gains. The search is made on the model and the corners
of its uncertainty; the plant on which the result misses the requirements most joins them, until none does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.control.damping.plant import closing
from hysteresis_ros.control.gain_design import Designed, design_gains
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import REQUIRED, Margins, Requirements, margins_of
from hysteresis_ros.control.uncertainty import CORNERS, PossiblePlant, Uncertainty, drawn_plants
from hysteresis_ros.executors.executor import shared
from hysteresis_ros.executors.jobs import Job

#: Part of M_s that a search aims at, whose grid of frequencies is coarser than that of the margins.
COARSE = 0.99
#: How often a plant may join those of the search.
ROUNDS = 8
#: Plants of one job, and about what the margins on one take [s].
TOGETHER, SECONDS = 50, 2e-2


@dataclass(frozen=True, eq=False)
class Robustness:
    """What a loop is worth on all plants that were drawn.

    Parameters
    ----------
    uncertainty : Uncertainty
    plants : tuple of PossiblePlant
        The model first.
    margins : tuple of Margins
        On each of them; the delay margin counts from the delay of the model.
    """

    uncertainty: Uncertainty
    plants: tuple[PossiblePlant, ...]
    margins: tuple[Margins, ...]

    @property
    def worst(self) -> int:
        """Place of the plant with the largest M_s, of an unstable one if there is any."""
        sizes = [found.sensitivity_peak if found.stable else float("inf") for found in self.margins]
        return sizes.index(max(sizes))

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, text) of what a design prints of it."""
        ranges, found = self.uncertainty, self.margins[self.worst]
        drawn = (
            f"{len(self.plants)}: gain ±{100.0 * ranges.gain:g} %, hysteresis ±{100.0 * ranges.hysteresis:g} %, times "
            f"±{100.0 * ranges.resonance:g} %, up to {ranges.delay:g} samples later, seed {ranges.seed}"
        )
        least = min(margins.delay_margin_samples for margins in self.margins)
        return [
            ("plants", drawn),
            ("worst plant", self.plants[self.worst].description),
            ("M_s there", f"{found.sensitivity_peak:.3f}" if found.stable else "unstable"),
            ("least gain margin", f"{min(margins.gain_margin for margins in self.margins):.1f} dB"),
            ("least delay margin", f"{least:.3g} samples"),
        ]

    def misses(self, required: Requirements = REQUIRED) -> tuple[str, ...]:
        """Return what is missed on the worst plant of those that miss something, a few words each.

        Parameters
        ----------
        required : Requirements
        """
        order = [self.worst, *range(len(self.plants))]
        for i in order:
            said = self.margins[i].misses(required)
            if said:
                text = said[0].replace("unstable on its own model", "unstable")
                return (f"{text} on a plant with {self.plants[i].description}",)
        return ()


def robustness(parameters, sample_time: float, uncertainty: Uncertainty) -> Robustness:
    """Return what the loop of a controller is worth on all plants that the uncertainty allows.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    uncertainty : Uncertainty

    Raises
    ------
    ParameterError
        No controller can be built of the parameters.
    """
    plants = _plants(parameters, sample_time, uncertainty)
    return _robustness(parameters, sample_time, uncertainty, plants)


def _plants(parameters, sample_time: float, uncertainty: Uncertainty) -> tuple[PossiblePlant, ...]:
    """Return the plants, with the damping of the parameters around each of them."""
    dynamics = parameters.model.dynamics
    around = closing(parameters.damping, dynamics, sample_time, parameters.model.force)
    drawn = drawn_plants(dynamics, sample_time, uncertainty, acting=parameters.damping.source == FORCE)
    return tuple(one.closed(around) for one in drawn)


def _margins(controller, plants, sample_time: float) -> list[Margins]:
    return [margins_of(controller, one.plant, sample_time) for one in plants]


def _robustness(parameters, sample_time: float, uncertainty: Uncertainty, plants) -> Robustness:
    controller, _ = linear_loop(parameters, sample_time)
    pieces = [plants[i : i + TOGETHER] for i in range(0, len(plants), TOGETHER)]
    jobs = [Job(_margins, (controller, piece, sample_time)) for piece in pieces]
    found = [margins for piece in shared(jobs, SECONDS * len(plants)) for margins in piece]
    counted = [
        replace(margins, delay_margin=margins.delay_margin + one.late * sample_time)
        for margins, one in zip(found, plants, strict=True)
    ]
    return Robustness(uncertainty, plants, tuple(counted))


def design_robust(
    parameters,
    controller: str,
    sample_time: float,
    uncertainty: Uncertainty,
    q: float | None = None,
    *,
    aimed: Requirements = REQUIRED,
) -> tuple[Designed, Robustness]:
    """Return gains that meet the requirements on every plant that was drawn, and what they are worth there.

    Parameters
    ----------
    parameters : ControllerParameters
        Its model is used; what the design does not decide is kept.
    controller : str
        Name of a design.
    sample_time : float
        [s]
    uncertainty : Uncertainty
    q : float, optional
        Variance of the input's noise over that of the measurement in the Kalman filter.
    aimed : Requirements, optional
        What every plant has to meet.

    Raises
    ------
    ConfigurationError
        There is no design of that name.
    ParameterError
        No design follows from the model.
    """
    plants = _plants(parameters, sample_time, uncertainty)
    active = list(plants[: 1 + CORNERS])
    sought = replace(aimed, sensitivity_peak=COARSE * aimed.sensitivity_peak)
    for _ in range(ROUNDS):
        found = design_gains(parameters, controller, sample_time, q=q, aimed=sought, plants=tuple(active))
        judged = _robustness(found.parameters, sample_time, uncertainty, plants)
        missing = [i for i in range(len(plants)) if judged.margins[i].misses(aimed) and plants[i] not in active]
        if not missing:
            break
        active.append(plants[max(missing, key=lambda i: judged.margins[i].sensitivity_peak)])
    return found, judged
