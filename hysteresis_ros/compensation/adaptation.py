# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Online adaptation of an inverse: its model's weights follow what is measured while the axis runs.

Which weights stand where the models say themselves (:class:`~hysteresis_ros.models.declaration.LinearTerms`); what a
sample does is :mod:`hysteresis_ros.compensation.recursive`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Chain
from hysteresis_ros.compensation import recursive as at
from hysteresis_ros.compensation.recursive import AdaptationSettings, AdaptationStates
from hysteresis_ros.errors import Problem
from hysteresis_ros.linear_algebra import product, solve
from hysteresis_ros.models.creep import FEEDTHROUGH, Creep
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.linear import HELD_INPUT, LinearDynamics, LinearParameters
from hysteresis_ros.parameters import Parameters, group, parameter

#: Most weights that are adapted: what a sample costs grows with their square.
MOST_WEIGHTS = 32
#: Standard deviations believed beforehand: of the gain, of the opening, of each weight besides.
COMMON, OPENING, EACH = 0.3, 0.3, 1.0
#: ε: what the model leaves unexplained, as a part of the stroke.
MISFIT = 1e-4
#: Time constants of the high-pass filter that have to pass after the axis was stopped, before anything is learned.
SETTLING = 5.0
#: Time constant with which the offset of the model follows what is slow, in those of the filter.
OFFSET_TIME = 10.0


def adaptable() -> tuple[str, ...]:
    """Return the names of the models whose weights can be adapted."""
    return tuple(name for name, model in MODELS.items() if model.weighted is not None)


@dataclass(frozen=True)
class AdaptationParameters(Parameters):
    """Online adaptation of the weights of the compensator's model."""

    type: str = parameter(
        "none",
        choices=("none", "recursive"),
        read_only=True,
        description="recursive: least squares on the weights of the model while the axis runs",
    )
    memory: float = parameter(
        30.0, unit="s", low=1e-3, high=1e7, description="time of running after which a measurement is mostly forgotten"
    )
    range: float = parameter(
        2.0, low=1.0, high=10.0, description="largest factor on an identified weight; the smallest is its inverse"
    )
    rate: float = parameter(0.02, unit="1/s", low=1e-9, high=10.0, description="how fast a factor may change at most")
    excitation: float = parameter(
        0.005,
        low=1e-9,
        high=1.0,
        description="RMS of the motion, as a part of the stroke, below which nothing is learned",
    )
    slow: float = parameter(
        0.5, unit="s", low=1e-4, high=1e5, description="what changes more slowly than this counts as offset and drift"
    )
    offset: str = parameter(
        "kept",
        choices=("kept", "measured"),
        read_only=True,
        description="where the displacement counts from: from where the axis was when learning began, or from zero",
    )
    zero: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, read_only=True, description="what is measured where the displacement is zero"
    )
    factors: tuple[float, ...] = parameter(
        (),
        low=0.0,
        read_only=True,
        description="factors on identified weights that are in the weights given already, as ~/save writes them; "
        "empty: all 1",
    )
    save_file: str = parameter(
        "", read_only=True, description="parameter file that ~/save writes; '': none", place="files"
    )
    dynamics: LinearParameters = group(LinearParameters)

    def fits(self, hysteresis: HysteresisParameters, inverse: str):
        """Yield a Problem when the weights of this model, behind this inverse, cannot be adapted.

        Parameters
        ----------
        hysteresis : HysteresisParameters
        inverse : str
            Type of the inverse.
        """
        if self.type == "none":
            return
        name, model = hysteresis.type, hysteresis.model
        if model.weighted is None:
            allowed = f"{name} is not linear in its weights; take a model that is ({', '.join(adaptable())}), or none"
            yield Problem("adaptation.type", self.type, allowed)
            return
        if inverse not in ("exact", "general", "picard_steps"):
            yield Problem("adaptation.type", self.type, f"the inverse {inverse} does not use the weights; take exact")
        terms = hysteresis_block(hysteresis, 1.0).terms
        count = len(terms.weights) if terms else 0
        if count > MOST_WEIGHTS:
            yield Problem("adaptation.type", self.type, f"{name} has {count} weights; at most {MOST_WEIGHTS} adapt")
        if self.factors and len(self.factors) != count:
            yield Problem("adaptation.factors", self.factors, f"must be as many as {name} has weights, {count}")
        elif any(not 1.0 / self.range <= factor <= self.range for factor in self.factors):
            allowed = f"must lie within 1/range … range = {1.0 / self.range:g} … {self.range:g}"
            yield Problem("adaptation.factors", self.factors, allowed)


class Adaptation(Chain):
    """Adaptation of the weights of a compensator's model.

    Composites use ``settings`` and ``xs`` directly.

    Parameters
    ----------
    parameters : AdaptationParameters
        Of type recursive.
    compensator : Compensator
        Whose model it adapts; its parameters hold the factors already.

    Attributes
    ----------
    settings : AdaptationSettings
    xs : AdaptationStates
    """

    def __init__(self, parameters: AdaptationParameters, compensator):
        self.parameters = parameters
        self.compensator = compensator
        self.sample_time = compensator.sample_time
        self.dynamics = LinearDynamics(parameters.dynamics, self.sample_time)
        self.terms = compensator.hysteresis.terms
        count = len(self.terms.weights)
        self._initial = np.array(parameters.factors or (1.0,) * count)
        self._given = compensator.parameters.hysteresis
        zones = np.array(self.terms.zones, dtype=float).reshape(-1, 2)
        places = np.concatenate([self.terms.weights, self.terms.signals, *zones.T])
        empty = (np.zeros(len(places)), np.zeros(count + len(zones)), np.zeros(count * count))
        self.settings = AdaptationSettings(np.zeros(at.OWN_PARAMETERS), *empty, self.dynamics.p)
        self.settings.places[:] = places
        self._pack()
        length = int(self.settings.own[at.FILTER_STATES])
        sizes = at.OWN_STATES, count, (count + 1) * length, count + 2, count, count * count, count
        self.xs = AdaptationStates(*map(np.zeros, sizes))
        self.reset()

    def _pack(self) -> None:
        """Fill in the numbers that follow from parameters and identified model."""
        parameters, compensator, time = self.parameters, self.compensator, self.sample_time
        self.identified = self._given.changed(self._given.model.weighted(self._given.chosen, 1.0 / self._initial))
        model = hysteresis_block(self.identified, time)
        limits = compensator.parameters.limits
        stroke = model.gain * (limits.maximum - limits.minimum)
        count, zones = len(self.terms.weights), len(self.terms.zones)
        own = self.settings.own
        own[at.TERMS], own[at.ZONES] = count, zones
        own[at.CREEP_STATES] = len(compensator.creep.x)
        own[at.FILTER_STATES] = len(compensator.creep.x) + len(self.dynamics.x)
        own[at.SLOW_SHARE] = -elementary.expm1(-time / parameters.slow)
        own[at.KEPT_SHARE] = -elementary.expm1(-time / parameters.memory)
        own[at.LARGEST_FACTOR], own[at.LARGEST_STEP] = parameters.range, parameters.rate * time
        own[at.LEAST_POWER], own[at.STROKE] = (parameters.excitation * stroke) ** 2, stroke
        own[at.SETTLING_SAMPLES] = SETTLING * parameters.slow / time
        own[at.OUTPUT_PLACE], own[at.OFFSET_PLACE] = self.terms.output, self.terms.offset
        own[at.OFFSET] = model.p[self.terms.offset] if self.terms.offset >= 0 else 0.0
        own[at.OFFSET_SHARE] = -elementary.expm1(-time / (OFFSET_TIME * parameters.slow))
        places = [*self.terms.weights, *(threshold for threshold, _ in self.terms.zones)]
        self.settings.nominal[:] = model.p[places]
        opening = np.array(self.terms.opening, dtype=float)
        believed = np.full((count, count), COMMON**2) + EACH**2 * np.eye(count)
        believed += OPENING**2 * opening[:, np.newaxis] * opening
        self.settings.prior[:] = (MISFIT * stroke) ** 2 * solve(believed, np.eye(count)).ravel()

    @property
    def factors(self) -> tuple[float, ...]:
        """Present factors on the identified weights."""
        return tuple(self.xs.factors.tolist())

    @property
    def gain(self) -> float:
        """Present gain as a part of the identified one."""
        return float(self.xs.own[at.GAIN])

    @property
    def condition(self) -> int:
        """What it does: one of ``recursive.STATE_NAMES``."""
        return int(self.xs.own[at.STATE])

    @property
    def weighted(self) -> HysteresisParameters:
        """The model with the weights of now; its offset is the identified one."""
        return self.identified.changed(self.identified.model.weighted(self.identified.chosen, self.xs.factors.copy()))

    @property
    def hysteresis(self) -> HysteresisParameters:
        """The model as it is now."""
        return self.weighted.shifted(float(self.xs.own[at.MOVED]))

    def freeze(self) -> None:
        """Learn nothing more."""
        self.xs.own[at.TOLD] = 1.0

    def resume(self) -> None:
        """Learn again."""
        self.xs.own[at.TOLD] = 0.0

    def forget(self) -> None:
        """Take all factors for 1 again, and nothing for measured; the model's weights are somebody else's matter."""
        self.xs.factors[:] = 1.0
        self.xs.squares[:] = 0.0
        self.xs.products[:] = 0.0
        self.xs.own[at.MOVED] = 0.0
        self.xs.own[at.GAIN] = 1.0
        self._count_from_zero()

    def reset(self) -> None:
        """Begin again at rest with the factors of the beginning."""
        for x in self.xs:
            x[:] = 0.0
        self.xs.factors[:] = self._initial
        weights, ones = self.settings.nominal[: len(self._initial)], np.ones(len(self._initial))
        self.xs.own[at.GAIN] = float(product(weights * self._initial, ones)) / float(product(weights, ones))
        self._rest()
        # wherever it rests, its past is not known
        self.xs.own[at.WAIT] = self.settings.own[at.SETTLING_SAMPLES]
        self._count_from_zero()

    def _count_from_zero(self) -> None:
        self.xs.own[at.ZEROED] = self.parameters.offset == "measured"
        self.xs.own[at.ZERO] = self.parameters.zero

    def _rest(self) -> None:
        """Let creep and dynamics of each term be at rest where the compensator is."""
        compensator, length = self.compensator, int(self.settings.own[at.FILTER_STATES])
        creep, block = Creep(compensator.creep.parameters, self.sample_time), compensator.hysteresis
        self.dynamics.settle(creep.settle(1.0))
        unit = np.concatenate([creep.x, self.dynamics.x])
        at.drive(self.settings, self.xs, creep.p, block.p, block.x, compensator.voltage)
        filters = self.xs.filters.reshape(-1, length)
        # what has come through empty filters is the terms themselves, but for the feedthrough
        terms = filters[:, len(creep.x) + HELD_INPUT] / creep.p[FEEDTHROUGH]
        filters[:] = terms[:, np.newaxis] * unit

    def retune(self, parameters: AdaptationParameters, hysteresis: HysteresisParameters) -> None:
        """Take new settings; with another identified model the factors begin anew.

        Parameters
        ----------
        parameters : AdaptationParameters
            With dynamics of the same order.
        hysteresis : HysteresisParameters
            The model that was given.

        Raises
        ------
        ParameterError
            The dynamics are of another order; nothing is changed then.
        """
        self.dynamics.retune(parameters.dynamics)
        self.parameters = parameters
        if hysteresis != self._given:
            self._given = hysteresis
            self._initial[:] = 1.0
            self.forget()
        self._pack()
