# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Online adaptation of an inverse: recursive least squares on the weights of its model while the axis runs.

The models in question are linear in their weights, displacement = Σ f_i w_i z_i: f_i is the factor on an identified
weight w_i, z_i the play operator (or the voltage) that it multiplies. Each term φ_i = w_i z_i of the voltage that was
really put out goes through the model's creep, linear dynamics and delay, so that neither is taken for hysteresis; terms
and measurement then through one and the same high-pass filter, so that neither an offset nor a drift is taken for gain.
What is left is fitted by least squares that forget exponentially, over the samples k that were used [1]_:

minimise  Σ_k κ (1 - κ)^(n - k) (y_k - Σ f_i φ_ik)² + (f - 1)' R (f - 1)   within  1/range ≤ f_i ≤ range

The normal equations are kept as they are, as running means of φ φ' and φ y: nothing is inverted, nothing can wind up.
R = ε² P⁻¹ is what is believed beforehand (P: one factor common to all weights, one common to those that open the loops,
and one of each): what a reference does not excite follows the rest, and forgets to it. The bounds keep weights
above zero, so that there is an inverse. The minimum is followed by a sweep of coordinate descent a sample, which stays
within the bounds and moves no factor faster than ``rate``. The displacement of the moment stays: the model's offset
takes up what the weights would change, so that the voltage does not jump, and then follows what is slow.

Dead zones behind the sum bend it. Their thresholds go with the gain g = Σ f_i w_i / Σ w_i, so the displacement is
homogeneous in f and by Euler's theorem the sum of its derivatives times f: those are the terms then.

Which weights stand where the models say themselves (:class:`~hysteresis_ros.models.declaration.LinearTerms`).

References
----------
.. [1] Ljung, System Identification, 2nd ed. 1999, section 11.2 (recursive least squares with forgetting).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Chain, called, kernel
from hysteresis_ros.models.creep import FEEDTHROUGH, Creep, creep
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.linear import HELD_INPUT, LinearDynamics, LinearParameters, linear_advance, linear_output
from hysteresis_ros.models.linear_algebra import product, solve

# Layout of p.own.
TERMS = 0
ZONES = 1
CREEP_STATES = 2
FILTER_STATES = 3  # of creep and dynamics together, a term
SLOW_SHARE = 4  # of a sample in the slow parts, which the high-pass filter takes away
KEPT_SHARE = 5  # of a sample in the running means
LARGEST_FACTOR = 6
LARGEST_STEP = 7  # of a factor in a sample
LEAST_POWER = 8  # [m²]
STROKE = 9  # [m]
SETTLING_SAMPLES = 10
OUTPUT_PLACE = 11  # of the last output in the state of the model, and of the offset in its parameters; NOWHERE
OFFSET_PLACE = 12
OFFSET = 13  # identified [m]
OFFSET_SHARE = 14  # of what is missing in the offset that it takes up in a sample
OWN_PARAMETERS = 15

# Layout of x.own.
STATE = 0  # one of those below
TOLD = 1  # 1 while told not to learn
BEGUN = 2  # 1 after the first measurement
WAIT = 3  # samples before anything is learned
POWER = 4  # mean square of the modelled displacement behind the filter [m²]
ERROR_POWER = 5  # mean square of what is left between measurement and model [m²]
LAST = 6  # last measurement [m]
LAST_MODELLED = 7  # [m]
UNUSABLE = 8  # measurements in a row that cannot be one
GAIN = 9  # of all weights, against the identified ones
MOVED = 10  # the offset, against the identified one [m]
ZEROED = 11  # 1 once it is known from where the offset counts
ZERO = 12  # what is measured where the displacement is zero [m]
OWN_STATES = 13

#: What adaptation does: there is none; the weights follow; frozen without excitation, by a service, because the axis is
#: not running or has not for long, because range or slew rate cut the voltage.
OFF, ADAPTING, UNEXCITED, FROZEN, WAITING, SATURATED = range(6)
STATE_NAMES = (
    "off",
    "adapting",
    "frozen: no excitation",
    "frozen: told to",
    "frozen: the axis does not run, or has not for long",
    "frozen: the voltage is at a limit",
)


class AdaptationSettings(NamedTuple):
    """Parameter arrays of an adaptation."""

    own: np.ndarray
    places: np.ndarray  # of the weights in p, of what they multiply in x; of thresholds and slopes of zones in p
    nominal: np.ndarray  # identified weights, then thresholds
    prior: np.ndarray  # R, row by row [m²]
    dynamics: np.ndarray


class AdaptationStates(NamedTuple):
    """State arrays of an adaptation."""

    own: np.ndarray
    factors: np.ndarray
    filters: np.ndarray  # creep and dynamics of each term, then of the offset
    slow: np.ndarray  # slow part of each term, of the offset and of the measurement [m]
    terms: np.ndarray  # behind the high-pass filter [m]
    squares: np.ndarray  # running mean of φ φ', row by row [m²]
    products: np.ndarray  # of φ y [m²]


@kernel
def bent(own, places, p, total, slope):
    """Sum of the terms behind the dead zones [m]; with ``slope`` not 0 the slope there instead."""
    terms, zones = int(own[TERMS]), int(own[ZONES])
    y, steepness = total, 1.0
    for j in range(zones):
        threshold, weight = p[int(places[2 * terms + j])], p[int(places[2 * terms + zones + j])]
        if (threshold >= 0.0 and total > threshold) or (threshold < 0.0 and total < threshold):
            y += weight * (total - threshold)
            steepness += weight
    return steepness if slope != 0.0 else y


@kernel
def signal(places, terms, x_h, voltage, i):
    """What the i-th weight multiplies [V]."""
    place = int(places[terms + i])
    return x_h[place] if place >= 0 else voltage


@kernel
def summed(own, places, p_h, x_h, voltage):
    """Sum of all terms of the model before the dead zones [m]."""
    terms = int(own[TERMS])
    total = 0.0
    for i in range(terms):
        total += p_h[int(places[i])] * signal(places, terms, x_h, voltage, i)
    return total


@called
def drive(settings, states, creep_p, p_h, x_h, voltage):
    """Send the terms of the model at the ``voltage`` [V] that is put out through creep and dynamics to the next sample.

    Parameters
    ----------
    settings : AdaptationSettings
    states : AdaptationStates
    creep_p : ndarray
        Parameters of the compensator's creep.
    p_h, x_h : ndarray
        Parameters and state of the model.
    voltage : float
        [V]
    """
    own, places = settings.own, settings.places
    terms, creeping, length = int(own[TERMS]), int(own[CREEP_STATES]), int(own[FILTER_STATES])
    total = summed(own, places, p_h, x_h, voltage)
    slope = bent(own, places, p_h, total, 1.0)
    weights = 0.0
    for i in range(terms):
        weights += p_h[int(places[i])]
    # by how much the thresholds, which go with the gain, move the displacement
    shared = (bent(own, places, p_h, total, 0.0) - slope * total) / weights
    for i in range(terms):
        term = settings.nominal[i] * (slope * signal(places, terms, x_h, voltage, i) + shared)
        first = i * length
        crept = creep(creep_p, states.filters[first : first + creeping], term)
        linear_advance(settings.dynamics, states.filters[first + creeping : first + length], crept)
    if int(own[OFFSET_PLACE]) >= 0:
        first = terms * length
        crept = creep(creep_p, states.filters[first : first + creeping], p_h[int(own[OFFSET_PLACE])])
        linear_advance(settings.dynamics, states.filters[first + creeping : first + length], crept)


@called
def arrive(settings, states):
    """Return what the terms make that have arrived at the sensor [m]: without what is slow in them, and whole."""
    own, slow, terms, factors = settings.own, states.slow, states.terms, states.factors
    count, creeping, length = int(own[TERMS]), int(own[CREEP_STATES]), int(own[FILTER_STATES])
    share, begun = own[SLOW_SHARE], states.own[BEGUN] != 0.0
    modelled, whole = 0.0, 0.0
    for i in range(count):
        first = i * length + creeping
        term = linear_output(settings.dynamics, states.filters[first : first + length - creeping])
        whole += factors[i] * term
        if not begun:
            slow[i] = term
        terms[i] = term - slow[i]
        slow[i] += share * terms[i]
        modelled += factors[i] * terms[i]
    first = count * length + creeping
    offset = linear_output(settings.dynamics, states.filters[first : first + length - creeping])
    if not begun:
        slow[count] = offset
    slow[count] += share * (offset - slow[count])
    return modelled, whole


@called
def believe(settings, states, measured, modelled, whole):
    """Note the displacement [m] that counts as measured, and tell whether it is one.

    Where none was measured, or none that can be true, the model stands in, until it is the model that cannot be true.
    """
    own_p, own, slow = settings.own, states.own, states.slow
    level = int(own_p[TERMS]) + 1
    own[LAST_MODELLED], before = whole, own[LAST_MODELLED]
    if abs(measured - slow[level] - modelled) <= own_p[STROKE]:
        own[UNUSABLE] = 0.0
        own[LAST] = measured
        return True
    own[UNUSABLE] += 1.0
    if measured == measured and own[UNUSABLE] * own_p[SLOW_SHARE] > 1.0:
        slow[level] = measured - modelled
        own[LAST] = measured
    else:
        own[LAST] += whole - before
    return False


@called
def move(settings, states, fast):
    """Let products and squares of the terms take the measurement in [m], and lead the factors to what they say."""
    own, terms, factors = settings.own, states.terms, states.factors
    count, kept = int(own[TERMS]), own[KEPT_SHARE]
    for i in range(count):
        states.products[i] += kept * (terms[i] * fast - states.products[i])
        for j in range(count):
            place = i * count + j
            states.squares[place] += kept * (terms[i] * terms[j] - states.squares[place])
    largest, step = own[LARGEST_FACTOR], own[LARGEST_STEP]
    for i in range(count):
        wanted = states.products[i]
        for j in range(count):
            place = i * count + j
            wanted += settings.prior[place] * (1.0 - factors[j]) - states.squares[place] * factors[j]
        wanted /= states.squares[i * count + i] + settings.prior[i * count + i]
        wanted = max(1.0 / largest, min(largest, factors[i] + wanted)) - factors[i]
        factors[i] += max(-step, min(step, wanted))


@called
def learn(settings, states, measured, usable):
    """Compare a measurement with the terms that have arrived, and move the factors; tell whether they have moved.

    Parameters
    ----------
    settings : AdaptationSettings
    states : AdaptationStates
    measured : float
        [m]; NaN: there is none.
    usable : float
        0: learn nothing from this sample.
    """
    own_p, own, slow = settings.own, states.own, states.slow
    count, share = int(own_p[TERMS]), own_p[SLOW_SHARE]
    modelled, whole = arrive(settings, states)
    if own[BEGUN] == 0.0:
        if measured != measured:
            return False
        own[BEGUN] = 1.0
        own[LAST_MODELLED] = whole
        own[LAST] = slow[count + 1] = measured
    believed = believe(settings, states, measured, modelled, whole)
    fast = own[LAST] - slow[count + 1]
    slow[count + 1] += share * fast
    own[POWER] += share * (modelled * modelled - own[POWER])
    error = fast - modelled
    own[ERROR_POWER] += share * (error * error - own[ERROR_POWER])
    if usable == 0.0 or not believed:
        return False
    if own[POWER] < own_p[LEAST_POWER]:
        own[STATE] = UNEXCITED
        return False
    own[STATE] = ADAPTING
    move(settings, states, fast)
    missing = slow[count + 1] - slow[count]
    for i in range(count):
        missing -= states.factors[i] * slow[i]
    if own[ZEROED] == 0.0:
        own[ZEROED], own[ZERO] = 1.0, missing
    furthest = own_p[LARGEST_STEP] * own_p[STROKE]
    missing = own_p[OFFSET_SHARE] * (missing - own[ZERO])
    own[MOVED] += max(-furthest, min(furthest, missing))
    return True


@called
def put_in(settings, states, p_h, x_h, voltage):
    """Put the factors into the weights of the model, such that its output does not move for their sake.

    The offset makes up for what they would change; the memory of the model stays.
    """
    own, places, nominal = settings.own, settings.places, settings.nominal
    terms, zones, offset = int(own[TERMS]), int(own[ZONES]), int(own[OFFSET_PLACE])
    before = bent(own, places, p_h, summed(own, places, p_h, x_h, voltage), 0.0)
    identified, weights = 0.0, 0.0
    for i in range(terms):
        weight = nominal[i] * states.factors[i]
        p_h[int(places[i])] = weight
        weights += weight
        identified += nominal[i]
    gain = weights / identified
    for j in range(zones):
        p_h[int(places[2 * terms + j])] = nominal[terms + j] * gain
    states.own[GAIN] = gain
    change = bent(own, places, p_h, summed(own, places, p_h, x_h, voltage), 0.0) - before
    if offset >= 0:
        states.own[MOVED] = max(-own[STROKE], min(own[STROKE], states.own[MOVED] - change))
        change -= p_h[offset]
        p_h[offset] = own[OFFSET] + states.own[MOVED]
        change += p_h[offset]
    output = int(own[OUTPUT_PLACE])
    if output >= 0:
        x_h[output] += change


@called
def adapt(settings, states, p_h, x_h, voltage, measured, usable):
    """Learn from a measurement, and put what was learned into the model; arguments as above.

    One call, because a node makes it from Python.
    """
    if learn(settings, states, measured, usable):
        put_in(settings, states, p_h, x_h, voltage)


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
            remedy = f"{name} is not linear in its weights; take a model that is ({', '.join(adaptable())}), or none"
            yield Problem("adaptation.type", self.type, remedy)
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
            remedy = f"must lie within 1/range … range = {1.0 / self.range:g} … {self.range:g}"
            yield Problem("adaptation.factors", self.factors, remedy)


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
        self.settings = AdaptationSettings(np.zeros(OWN_PARAMETERS), *empty, self.dynamics.p)
        self.settings.places[:] = places
        self._pack()
        length = int(self.settings.own[FILTER_STATES])
        sizes = OWN_STATES, count, (count + 1) * length, count + 2, count, count * count, count
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
        own[TERMS], own[ZONES] = count, zones
        own[CREEP_STATES] = len(compensator.creep.x)
        own[FILTER_STATES] = len(compensator.creep.x) + len(self.dynamics.x)
        own[SLOW_SHARE] = -elementary.expm1(-time / parameters.slow)
        own[KEPT_SHARE] = -elementary.expm1(-time / parameters.memory)
        own[LARGEST_FACTOR], own[LARGEST_STEP] = parameters.range, parameters.rate * time
        own[LEAST_POWER], own[STROKE] = (parameters.excitation * stroke) ** 2, stroke
        own[SETTLING_SAMPLES] = SETTLING * parameters.slow / time
        own[OUTPUT_PLACE], own[OFFSET_PLACE] = self.terms.output, self.terms.offset
        own[OFFSET] = model.p[self.terms.offset] if self.terms.offset >= 0 else 0.0
        own[OFFSET_SHARE] = -elementary.expm1(-time / (OFFSET_TIME * parameters.slow))
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
        return float(self.xs.own[GAIN])

    @property
    def condition(self) -> int:
        """What it does: one of ``recursive.STATE_NAMES``."""
        return int(self.xs.own[STATE])

    @property
    def weighted(self) -> HysteresisParameters:
        """The model with the weights of now; its offset is the identified one."""
        return self.identified.changed(self.identified.model.weighted(self.identified.chosen, self.xs.factors.copy()))

    @property
    def hysteresis(self) -> HysteresisParameters:
        """The model as it is now."""
        return self.weighted.shifted(float(self.xs.own[MOVED]))

    def freeze(self) -> None:
        """Learn nothing more."""
        self.xs.own[TOLD] = 1.0

    def resume(self) -> None:
        """Learn again."""
        self.xs.own[TOLD] = 0.0

    def forget(self) -> None:
        """Take all factors for 1 again, and nothing for measured; the model's weights are somebody else's matter."""
        self.xs.factors[:] = 1.0
        self.xs.squares[:] = 0.0
        self.xs.products[:] = 0.0
        self.xs.own[MOVED] = 0.0
        self.xs.own[GAIN] = 1.0
        self._count_from_zero()

    def reset(self) -> None:
        """Begin again at rest with the factors of the beginning."""
        for x in self.xs:
            x[:] = 0.0
        self.xs.factors[:] = self._initial
        weights, ones = self.settings.nominal[: len(self._initial)], np.ones(len(self._initial))
        self.xs.own[GAIN] = float(product(weights * self._initial, ones)) / float(product(weights, ones))
        self._rest()
        # wherever it rests, its past is not known
        self.xs.own[WAIT] = self.settings.own[SETTLING_SAMPLES]
        self._count_from_zero()

    def _count_from_zero(self) -> None:
        self.xs.own[ZEROED] = self.parameters.offset == "measured"
        self.xs.own[ZERO] = self.parameters.zero

    def _rest(self) -> None:
        """Let creep and dynamics of each term be at rest where the compensator is."""
        compensator, length = self.compensator, int(self.settings.own[FILTER_STATES])
        creep, block = Creep(compensator.creep.parameters, self.sample_time), compensator.hysteresis
        self.dynamics.settle(creep.settle(1.0))
        unit = np.concatenate([creep.x, self.dynamics.x])
        drive(self.settings, self.xs, creep.p, block.p, block.x, compensator.voltage)
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
