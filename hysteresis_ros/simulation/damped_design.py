# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a damping is worth: margins of its inner loop, of both loops together, and what it gains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.design import RESONANCE, damping_plants, design_damping
from hysteresis_ros.control.damping.kind import FORCE
from hysteresis_ros.control.damping.parameters import DampingParameters
from hysteresis_ros.control.damping.plant import closing, inner_loop, modes
from hysteresis_ros.control.damping.registry import KINDS, NONE
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import Margins, margins_of
from hysteresis_ros.control.uncertainty import PossiblePlant
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.models.state_space import StateSpace

#: A damping that makes the loop faster by less than this factor is of little use.
LITTLE = 1.2
#: A law that passes the reference on: what is left is the inner loop.
_PASSED = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[1.0, 0.0]]))


@dataclass(frozen=True, eq=False)
class PlantsAround:
    """Plants on which a damping is judged.

    Parameters
    ----------
    plants : tuple of PossiblePlant
        Without damping, the model first.
    resonance : float
        Part by which the resonances of the others are off.
    """

    plants: tuple[PossiblePlant, ...]
    resonance: float

    def closed(self, control: ControllerParameters, sample_time: float) -> tuple[PossiblePlant, ...]:
        """Return them with the damping of a controller around each.

        Parameters
        ----------
        control : ControllerParameters
        sample_time : float
            [s]
        """
        around = closing(control.damping, control.model.dynamics, sample_time, control.model.force)
        return tuple(one.closed(around) for one in self.plants)


@dataclass(frozen=True, eq=False)
class DampedDesign:
    """A damping with a controller in front of it, on the model and on plants around it.

    Parameters
    ----------
    damping : DampingParameters
    before : tuple of float
        Frequency [Hz] and damping of the model's least damped resonance.
    reached : tuple of float
        Damping of the least damped mode of the inner loop, on each plant, the model first.
    inner, outer, whole : tuple of Margins
        On each plant: of the inner loop alone, of the law on the damped plant, of both cut at the plant.
    resonance : float
        Part by which the resonances of these plants are off.
    undamped : float or None
        Bandwidth of the same design without damping [Hz]; None where there is none.
    """

    damping: DampingParameters
    before: tuple[float, float]
    reached: tuple[float, ...]
    inner: tuple[Margins, ...]
    outer: tuple[Margins, ...]
    whole: tuple[Margins, ...]
    resonance: float
    undamped: float | None

    def misses(self) -> tuple[str, ...]:
        """Return what is missed by the law's loop or by both loops, on the model or with resonances off."""
        for found, words in ((self.outer, "of the law's loop"), (self.whole, "of both loops")):
            for number, margins in enumerate(found):
                said = margins.misses()
                if said:
                    where = "" if not number else f" with resonances off by {100.0 * self.resonance:g} %"
                    return (f"{said[0].replace('unstable on its own model', 'unstable')} {words}{where}",)
        return ()

    @property
    def times(self) -> float:
        """Bandwidth over that of the same design without damping; infinite where there is none."""
        return self.outer[0].bandwidth / self.undamped if self.undamped else np.inf

    def doubts(self) -> tuple[str, ...]:
        """Return that a damping is of little use, where it is."""
        if self.times >= LITTLE:
            return ()
        return (
            f"{self.damping.type} is of little use here: {self.times:.3g} times the bandwidth without damping; take "
            "another kind or none; a delay that is not stated (model.dynamics.delay) hides the sign that damps",
        )

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, text) of what a design prints of it."""
        kind = self.damping.type
        values = getattr(self.damping, kind).to_mapping()
        given = ", ".join(f"{name} {_numbers(value)}" for name, value in values.items())
        off = f"resonances ±{100.0 * self.resonance:g} %"
        frequency, damping = self.before
        slowest = min(margins.bandwidth for margins in self.outer)
        worst = max(margins.sensitivity_peak for margins in self.outer)
        both = max(margins.sensitivity_peak for margins in self.whole)
        late = min(margins.delay_margin_samples for margins in self.whole)
        found = [
            ("damping", f"{kind}: {given}"),
            ("resonance", f"{frequency:.4g} Hz, damping {damping:.2g}"),
            ("damping reached", f"{self.reached[0]:.2g}; {off}: {min(self.reached):.2g}"),
            ("inner loop", _margins(self.inner[0])),
            ("both loops, at the plant", _margins(self.whole[0])),
            (off, f"bandwidth {slowest:.4g} Hz, M_s {worst:.3f}, of both {both:.3f}, delay margin {late:.3g} samples"),
        ]
        if self.undamped is not None:
            words = f"{self.undamped:.4g} Hz; with it {self.times:.3g} times that"
            found.append(("bandwidth without damping", words))
        return found


def around_model(control: ControllerParameters, sample_time: float, request) -> PlantsAround:
    """Return the model and what it is with resonances off to both sides.

    Parameters
    ----------
    control : ControllerParameters
    sample_time : float
        [s]
    request : DesignRequest
        Its ``robust`` says how far they may be off.
    """
    resonance = RESONANCE if request.robust is None else request.robust.resonance
    kind = control.damping.type if request.damping is None else request.damping
    acting = kind in KINDS and KINDS[kind].source == FORCE
    return PlantsAround(damping_plants(control.model.dynamics, sample_time, resonance, acting=acting), resonance)


def _require(name: str) -> None:
    """Refuse a name that no damping has.

    Raises
    ------
    ConfigurationError
    """
    if name not in (NONE, *KINDS):
        there = ", ".join((NONE, *KINDS))
        raise ConfigurationError(
            f"--damping {name}: there is no such damping; there are {there}{did_you_mean(name, KINDS)}"
        )


def with_damping(
    control: ControllerParameters, sample_time: float, around: PlantsAround, request
) -> ControllerParameters:
    """Return the parameters with the damping that is asked for, designed; without any asked those given.

    Parameters
    ----------
    control : ControllerParameters
    sample_time : float
        [s]
    around : PlantsAround
        On which it is to work.
    request : DesignRequest

    Raises
    ------
    ParameterError
        The model has no resonance, or nothing of this kind damps it.
    ConfigurationError
        There is no such damping.
    """
    if request.damping is None:
        return control
    _require(request.damping)
    if request.damping == NONE:
        return replace(control, damping=DampingParameters())
    found = design_damping(request.damping, control.model.dynamics, sample_time, around.plants, control.model.force)
    return replace(control, damping=found)


def judge_damping(
    parameters: ControllerParameters, sample_time: float, plants: PlantsAround, undamped: float | None
) -> DampedDesign:
    """Return what a controller with damping is worth.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        [s]
    plants : PlantsAround
    undamped : float or None
        Bandwidth of the same design without damping [Hz].
    """
    dynamics = parameters.model.dynamics
    loop = inner_loop(parameters.damping, dynamics, sample_time, parameters.model.force)
    controller, _ = linear_loop(parameters, sample_time)
    bare = [one.plant for one in plants.plants]
    around = [loop.around(plant) for plant in bare]
    least = [modes(plant.poles.astype(complex), sample_time) for plant in around]
    inner, both = loop.behind(_PASSED), loop.behind(controller)
    before = modes(dynamics.matrices.poles.astype(complex), sample_time)
    return DampedDesign(
        parameters.damping,
        before[0] if before else (0.0, 1.0),
        tuple(found[0][1] if found else 1.0 for found in least),
        tuple(margins_of(inner, plant, sample_time) for plant in bare),
        tuple(margins_of(controller, plant, sample_time) for plant in around),
        tuple(margins_of(both, plant, sample_time) for plant in bare),
        plants.resonance,
        undamped,
    )


def _numbers(value) -> str:
    return ", ".join(f"{item:.4g}" for item in (value if isinstance(value, tuple) else (value,)))


def _margins(found: Margins) -> str:
    gain = "infinite" if np.isinf(found.gain_margin) else f"{found.gain_margin:.1f} dB"
    delay = "infinite"
    if not np.isinf(found.delay_margin):
        delay = f"{found.delay_margin_samples:.3g} samples, {1e3 * found.delay_margin:.4g} ms"
    return f"M_s {found.sensitivity_peak:.3f}, gain margin {gain}, delay margin {delay}"
