# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Online adaptation of an inverse: recursive least squares for the weights of its model, while the axis runs.

The models are linear in their weights, displacement = Σ f_i w_i z_i. Here f_i is the adapted factor on an identified
weight w_i, and z_i is the signal that the weight multiplies: the output of a play operator, or the voltage. Each term
φ_i = w_i z_i is computed from the output voltage and passes through the model's creep, linear dynamics and delay, so
that these are not identified as hysteresis. Terms and measurement then pass through the same high-pass filter, so that
an offset or a drift is not identified as gain. The factors are fitted by least squares with exponential forgetting,
over all samples k that are used [1]_:

minimise  Σ_k κ (1 - κ)^(n - k) (y_k - Σ f_i φ_ik)² + (f - 1)' R (f - 1)   within  1/range ≤ f_i ≤ range

The normal equations are stored as running means of φ φ' and φ y. They are not inverted, so the estimates do not wind up
without excitation. R = ε² P⁻¹ represents the prior: weights that the reference does not excite follow the excited ones.
P is the sum of three covariances: of a factor common to all weights, of a factor common to the weights that widen the
loops, and of an individual factor for each weight. The bounds keep the weights above zero, so that an inverse exists.
One sweep of coordinate descent per sample tracks the minimum. No factor leaves its bounds or changes faster than
``rate``. The model's offset compensates the change of the weights, so that the model's present displacement does not
change and the voltage does not jump. Afterwards the offset follows slow changes of the measurement.

Dead zones after the sum make the displacement nonlinear in f. Their thresholds scale with the gain g = Σ f_i w_i / Σ
w_i, so the displacement is homogeneous in f. By Euler's theorem, the displacement is the sum over i of f_i times its
derivative with respect to f_i, and these derivatives are used as the terms.

Each model declares the indices of its weights (:class:`~hysteresis_ros.models.declaration.LinearTerms`).

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
FILTER_STATES = 3  # number of states of creep and dynamics for each term
SLOW_SHARE = 4  # weight of a sample in the slow components, which the high-pass filter removes
KEPT_SHARE = 5  # weight of a sample in the running means
LARGEST_FACTOR = 6
LARGEST_STEP = 7  # largest change of a factor per sample
LEAST_POWER = 8  # [m²]
STROKE = 9  # [m]
SETTLING_SAMPLES = 10
OUTPUT_PLACE = 11  # index of the last output in the model's state, or NOWHERE
OFFSET_PLACE = 12  # index of the offset in the model's parameters, or NOWHERE
OFFSET = 13  # identified [m]
OFFSET_SHARE = 14  # fraction of the offset's error that is corrected per sample
OWN_PARAMETERS = 15

# Layout of x.own.
STATE = 0  # one of the states below
TOLD = 1  # 1 while a service has frozen the adaptation
BEGUN = 2  # 1 after the first measurement
WAIT = 3  # number of samples until learning begins
POWER = 4  # mean square of the high-pass filtered modelled displacement [m²]
ERROR_POWER = 5  # mean square of the error, measurement minus model [m²]
LAST = 6  # last measurement [m]
LAST_MODELLED = 7  # [m]
UNUSABLE = 8  # number of consecutive missing or implausible measurements
GAIN = 9  # sum of the weights, relative to the sum of the identified weights
MOVED = 10  # change of the offset from its identified value [m]
ZEROED = 11  # 1 once the origin of the displacement is known
ZERO = 12  # measurement at zero displacement [m]
OWN_STATES = 13

#: States of the adaptation: off, adapting, or frozen for one of four reasons: the excitation is too small; a service
#: has frozen the adaptation; the axis does not run or has just started; the range or the slew rate limits the voltage.
OFF, ADAPTING, UNEXCITED, FROZEN, WAITING, SATURATED = range(6)
STATE_NAMES = (
    "off",
    "adapting",
    "frozen: no excitation",
    "frozen: by a service",
    "frozen: the axis does not run, or has just started",
    "frozen: the voltage is at a limit",
)


class AdaptationSettings(NamedTuple):
    """Parameter arrays of an adaptation."""

    own: np.ndarray
    #: Indices of the weights in p, of their signals in x, and of thresholds and slopes of the dead zones in p.
    places: np.ndarray
    nominal: np.ndarray  # identified weights, then thresholds
    prior: np.ndarray  # R, row by row [m²]
    dynamics: np.ndarray


class AdaptationStates(NamedTuple):
    """State arrays of an adaptation."""

    own: np.ndarray
    factors: np.ndarray
    filters: np.ndarray  # states of creep and dynamics for each term, then for the offset
    slow: np.ndarray  # slow components of each term, of the offset and of the measurement [m]
    terms: np.ndarray  # high-pass filtered terms [m]
    squares: np.ndarray  # running mean of φ φ', row by row [m²]
    products: np.ndarray  # running mean of φ y [m²]


@kernel
def bent(own, places, p, total, slope):
    """Return the output of the dead zones [m] for the sum ``total`` of the terms, or their slope if ``slope`` != 0."""
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
    """Return the signal that the i-th weight multiplies [V]."""
    place = int(places[terms + i])
    return x_h[place] if place >= 0 else voltage


@kernel
def summed(own, places, p_h, x_h, voltage):
    """Return the sum of all terms of the model before the dead zones [m]."""
    terms = int(own[TERMS])
    total = 0.0
    for i in range(terms):
        total += p_h[int(places[i])] * signal(places, terms, x_h, voltage, i)
    return total


@called
def drive(settings, states, creep_p, p_h, x_h, voltage):
    """Advance creep and dynamics of all terms by one sample with the output ``voltage`` [V].

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
    # the thresholds scale with the gain, so they contribute to every derivative
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
    """Return the sum of the terms at the sensor [m], high-pass filtered and unfiltered."""
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
    """Store the displacement [m] that is used as the measurement; return whether the measurement is plausible.

    A missing or implausible measurement is replaced: the last displacement plus the model's motion since then is used.
    After too many such measurements in a row, the model is assumed to be wrong, and a measurement is used again.
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
    """Update the running means with the filtered measurement ``fast`` [m]; move the factors towards the minimum."""
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
    """Compare a measurement with the terms at the sensor, and move the factors; return whether they have moved.

    Parameters
    ----------
    settings : AdaptationSettings
    states : AdaptationStates
    measured : float
        Measurement [m]; NaN: no measurement.
    usable : float
        0: the adaptation does not learn from this sample.
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
    """Write the factors into the weights of the model, without a jump of its output if the model has an offset.

    The offset compensates the change of the weights within its limits; the memory of the model does not change.
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
    """Learn from a measurement and update the model; for the arguments see :func:`drive` and :func:`learn`.

    A node calls this function from Python, so both steps are combined in one call.
    """
    if learn(settings, states, measured, usable):
        put_in(settings, states, p_h, x_h, voltage)


#: Maximum number of adapted weights, because the computing time grows with the square of their number.
MOST_WEIGHTS = 32
#: Standard deviation of the prior of the common gain.
COMMON = 0.3
#: Standard deviation of the prior of the loop width.
OPENING = 0.3
#: Standard deviation of the prior of each individual weight.
EACH = 1.0
#: ε: assumed residual of the model, as a fraction of the stroke.
MISFIT = 1e-4
#: Waiting time before learning continues after a stop of the axis, in time constants of the high-pass filter.
SETTLING = 5.0
#: Time constant with which the offset follows slow changes, in time constants of the high-pass filter.
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
        30.0, unit="s", low=1e-3, high=1e7, description="time constant of forgetting; it counts only while learning"
    )
    range: float = parameter(
        2.0, low=1.0, high=10.0, description="largest factor on an identified weight; the smallest is 1/range"
    )
    rate: float = parameter(0.02, unit="1/s", low=1e-9, high=10.0, description="largest rate of change of a factor")
    excitation: float = parameter(
        0.005,
        low=1e-9,
        high=1.0,
        description="RMS of the motion, as a fraction of the stroke, below which the adaptation pauses",
    )
    slow: float = parameter(
        0.5,
        unit="s",
        low=1e-4,
        high=1e5,
        description="time constant of the high-pass filter: slower changes are offset or drift",
    )
    offset: str = parameter(
        "kept",
        choices=("kept", "measured"),
        read_only=True,
        description="origin of the displacement; kept: the position at which learning began; measured: `zero`",
    )
    zero: float = parameter(
        0.0, unit="m", low=-1.0, high=1.0, read_only=True, description="measurement at zero displacement"
    )
    factors: tuple[float, ...] = parameter(
        (),
        low=0.0,
        read_only=True,
        description="factors already included in the given weights, as ~/save writes them; empty: all 1",
    )
    save_file: str = parameter(
        "", read_only=True, description="parameter file that ~/save writes; '': none", place="files"
    )
    dynamics: LinearParameters = group(LinearParameters)

    def fits(self, hysteresis: HysteresisParameters, inverse: str):
        """Yield a Problem if the weights of the model ``hysteresis`` cannot be adapted with this inverse.

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
            remedy = (
                f"{name} is not linear in its weights; use type none, or one of the models {', '.join(adaptable())}"
            )
            yield Problem("adaptation.type", self.type, remedy)
            return
        if inverse not in ("exact", "general", "picard_steps"):
            yield Problem("adaptation.type", self.type, f"the inverse {inverse} does not use the weights; use exact")
        terms = hysteresis_block(hysteresis, 1.0).terms
        count = len(terms.weights) if terms else 0
        if count > MOST_WEIGHTS:
            yield Problem(
                "adaptation.type", self.type, f"{name} has {count} weights; at most {MOST_WEIGHTS} can be adapted"
            )
        if self.factors and len(self.factors) != count:
            remedy = f"must contain one factor for each of the {count} weights of {name}"
            yield Problem("adaptation.factors", self.factors, remedy)
        elif any(not 1.0 / self.range <= factor <= self.range for factor in self.factors):
            remedy = f"must lie within 1/range … range = {1.0 / self.range:g} … {self.range:g}"
            yield Problem("adaptation.factors", self.factors, remedy)


class Adaptation(Chain):
    """Adaptation of the weights of a compensator's model.

    Composites use ``settings`` and ``xs`` directly.

    Parameters
    ----------
    parameters : AdaptationParameters
        Parameters of type recursive.
    compensator : Compensator
        The compensator with the model; its parameters already include the factors.

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
        """Compute the numbers that depend on the parameters and on the identified model."""
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
        """Present gain, relative to the identified gain."""
        return float(self.xs.own[GAIN])

    @property
    def condition(self) -> int:
        """State of the adaptation: one of ``STATE_NAMES``."""
        return int(self.xs.own[STATE])

    @property
    def weighted(self) -> HysteresisParameters:
        """The model with the present weights and the identified offset."""
        return self.identified.changed(self.identified.model.weighted(self.identified.chosen, self.xs.factors.copy()))

    @property
    def hysteresis(self) -> HysteresisParameters:
        """The present model, with the present weights and offset."""
        return self.weighted.shifted(float(self.xs.own[MOVED]))

    def freeze(self) -> None:
        """Stop learning."""
        self.xs.own[TOLD] = 1.0

    def resume(self) -> None:
        """Resume learning."""
        self.xs.own[TOLD] = 0.0

    def forget(self) -> None:
        """Reset all factors to 1 and clear the measurements; the caller must reset the model's weights."""
        self.xs.factors[:] = 1.0
        self.xs.squares[:] = 0.0
        self.xs.products[:] = 0.0
        self.xs.own[MOVED] = 0.0
        self.xs.own[GAIN] = 1.0
        self._count_from_zero()

    def reset(self) -> None:
        """Return to rest with the initial factors."""
        for x in self.xs:
            x[:] = 0.0
        self.xs.factors[:] = self._initial
        weights, ones = self.settings.nominal[: len(self._initial)], np.ones(len(self._initial))
        self.xs.own[GAIN] = float(product(weights * self._initial, ones)) / float(product(weights, ones))
        self._rest()
        # the voltage before the reset is not known, so learning waits until its effect has decayed
        self.xs.own[WAIT] = self.settings.own[SETTLING_SAMPLES]
        self._count_from_zero()

    def _count_from_zero(self) -> None:
        self.xs.own[ZEROED] = self.parameters.offset == "measured"
        self.xs.own[ZERO] = self.parameters.zero

    def _rest(self) -> None:
        """Set creep and dynamics of each term to their steady state for the compensator's present state."""
        compensator, length = self.compensator, int(self.settings.own[FILTER_STATES])
        creep, block = Creep(compensator.creep.parameters, self.sample_time), compensator.hysteresis
        self.dynamics.settle(creep.settle(1.0))
        unit = np.concatenate([creep.x, self.dynamics.x])
        drive(self.settings, self.xs, creep.p, block.p, block.x, compensator.voltage)
        filters = self.xs.filters.reshape(-1, length)
        # with zero states, the filters output the terms times the feedthrough
        terms = filters[:, len(creep.x) + HELD_INPUT] / creep.p[FEEDTHROUGH]
        filters[:] = terms[:, np.newaxis] * unit

    def retune(self, parameters: AdaptationParameters, hysteresis: HysteresisParameters) -> None:
        """Change the settings; if the identified model has changed, the factors start again at 1.

        Parameters
        ----------
        parameters : AdaptationParameters
            Parameters; the dynamics must have the same order.
        hysteresis : HysteresisParameters
            The identified model.

        Raises
        ------
        ParameterError
            The order of the dynamics differs; the adaptation then remains unchanged.
        """
        self.dynamics.retune(parameters.dynamics)
        self.parameters = parameters
        if hysteresis != self._given:
            self._given = hysteresis
            self._initial[:] = 1.0
            self.forget()
        self._pack()
