# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motion controller: its laws by name, its parameters and blocks, and how another law or other gains take over.

When another law takes over, it is taken through the last samples of the run first, as if it had run beside its
predecessor all the time: an observer that began from rest instead would move the command while it settles. Two
controllers with one model and one Kalman filter share the observer: its state goes on as it is. What a law has
integrated is set such that it goes on from the present command, or to zero; the hand-over behind the controller fades
the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hysteresis_ros.control.laws  # noqa: F401  (its folder is searched)
from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.control.damping.inner_loop import Damping, DampingParameters, damped
from hysteresis_ros.control.damping.kind import NOTHING
from hysteresis_ros.control.feedforward import Feedforward, FeedforwardParameters, inverse_filter, preview_warning
from hysteresis_ros.control.law import APPLIED, COMMAND, FEEDFORWARD, HEADER, STARTED, Controller, ControllerLaw
from hysteresis_ros.control.learning import LearningParameters, period_samples
from hysteresis_ros.errors import ConfigurationError, ParameterError, did_you_mean
from hysteresis_ros.models import elementary
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.models.block import COMPILED, Block, called, kernel, signature
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import ForceParameters
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a controller: ``lead_lag = my_package.lead_lag:CONTROLLER``.
GROUP = "hysteresis_ros.controllers"

#: What each controller declares, by type.
LAWS: dict[str, ControllerLaw] = discover("hysteresis_ros.control.laws", "CONTROLLER", ControllerLaw, GROUP)


def _designs() -> dict[str, tuple[ControllerLaw, Callable]]:
    """Return law and design of each name; two laws with a design of one name are a mistake, a TypeError."""
    found: dict[str, tuple[ControllerLaw, Callable]] = {}
    for law in LAWS.values():
        for name, function in law.designs.items():
            if name in found:
                raise TypeError(f"controllers {found[name][0].name} and {law.name} both have a design {name!r}")
            found[name] = law, function
    return found


#: Law and design of each name that ``hysteresis design --controller`` takes.
DESIGNS = _designs()


def with_groups(cls):
    """Nest the parameter groups of all laws; stands under ``@dataclass(frozen=True)``.

    Those named as laws come first, then what laws share.

    Raises
    ------
    TypeError
        Two laws mean different parameters by one group.
    """
    found: dict[str, tuple[type[Parameters], list[str]]] = {}
    for law in LAWS.values():
        for name, kind in law.groups.items():
            known, users = found.setdefault(name, (kind, []))
            if known is not kind:
                raise TypeError(f"controllers {users[0]} and {law.name} both have a group {name}, of other parameters")
            users.append(law.name)
    for name in sorted(found, key=lambda name: (name not in LAWS, name)):
        kind, users = found[name]
        cls.__annotations__[name] = kind
        setattr(cls, name, group(kind, variant_of="type" if users == [name] else None))
    return cls


def design_of(name: str):
    """Return law and design of a name that ``hysteresis design --controller`` takes.

    Raises
    ------
    ConfigurationError
        There is none of that name; the message lists what there is.
    """
    if name not in DESIGNS:
        there = ", ".join(sorted(DESIGNS))
        raise ConfigurationError(f"no controller '{name}' to design; there are: {there}{did_you_mean(name, DESIGNS)}")
    return DESIGNS[name]


#: p[DECAY]: factor of the bias from one sample to the next.
DECAY = 0
#: x[BIAS]: what is added to the input.
BIAS = 0
#: x[LAST]: last output.
LAST = 1
#: x[ARMED]: 1.0 when the next output shall equal the last one; 2.0 when x[BIAS] already says how much of that lasts.
ARMED = 2
#: x[QUICK]: what is added besides the bias, and halved from sample to sample.
QUICK = 3

#: Below this the bias is dropped, before it becomes a slow subnormal number.
SMALLEST = 1e-300


@kernel
def handover(p, x, u):
    """Return ``u + bias`` and let the bias decay; when armed, choose the bias such that the output does not move."""
    if x[ARMED] != 0.0:
        lasting = x[ARMED] == 2.0
        x[ARMED] = 0.0
        if p[DECAY] > 0.0:
            x[QUICK] = 0.0
            if lasting:
                x[QUICK] = x[LAST] - u - x[BIAS]
            else:
                x[BIAS] = x[LAST] - u
            # Exactly the last output, not u + (last - u) with its rounding.
            return x[LAST]
        x[BIAS] = 0.0
    bias = x[BIAS] * p[DECAY]
    quick = 0.5 * x[QUICK]
    y = u + bias
    if abs(bias) < SMALLEST or y == u:
        bias = 0.0
    if abs(quick) < SMALLEST or y + quick == y:
        quick = 0.0
    y += quick
    x[BIAS] = bias
    x[QUICK] = quick
    x[LAST] = y
    return y


@kernel
def go_on_from(x, last):
    """Make the next output equal ``last`` and fade from there to the input."""
    x[LAST] = last
    x[ARMED] = 1.0


@dataclass(frozen=True)
class HandoverParameters(Parameters):
    """How a change of controller is smoothed."""

    time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which the difference between old and new command fades; 0: at once",
    )


class Handover(Block):
    """Adds a decaying bias to its input after :func:`arm`.

    Parameters
    ----------
    parameters : HandoverParameters
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(handover)

    def pack(self, parameters) -> np.ndarray:
        """Return [decay], decay = exp(-sample time / time), 0 when the time is 0."""
        return np.array([elementary.exp(-self.sample_time / parameters.time) if parameters.time > 0.0 else 0.0])

    def initial_state(self) -> np.ndarray:
        """Return the state without bias."""
        return np.zeros(4)


def arm(block: Handover, last: float | None = None, lasting: float | None = None) -> None:
    """Make the next output of ``block`` equal its last one and fade from there to the input.

    Used after a change of controller type, live gains, a stale measurement, and at start after stop.

    Parameters
    ----------
    block : Handover
    last : float, optional
        Where to go on from, when something else (a safe output) was sent since the block's last output.
    lasting : float, optional
        How far the output was from what the input would have been lately, on average. Only this part fades with the
        time constant; what the present sample deviates from it, noise mostly, is halved from sample to sample. A
        feedback that gets noise as a bias for long would be led away by it.
    """
    if last is not None:
        block.x[LAST] = float(last)
    block.x[ARMED] = 1.0
    if lasting is not None:
        block.x[ARMED] = 2.0
        block.x[BIAS] = float(lasting)


@dataclass(frozen=True)
class ModelParameters(Parameters):
    """What the controller believes of the plant: a model of its own, never the plant's."""

    dynamics: LinearParameters = group(LinearParameters)
    preload: PreloadParameters = group(PreloadParameters)
    force: ForceParameters = group(ForceParameters)


@dataclass(frozen=True)
@with_groups
class ControllerParameters(Parameters):
    """Motion controller: what kind, its model, how it takes over, and the groups of gains that the laws declare."""

    type: str = parameter(
        "open_loop",
        choices=tuple(LAWS),
        description="; ".join(f"{name}: {law.description}" for name, law in LAWS.items()),
    )
    model: ModelParameters = group(ModelParameters)
    feedforward: FeedforwardParameters = group(FeedforwardParameters)
    damping: DampingParameters = group(DampingParameters)
    handover_time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which a change of controller or gains fades in; 0: at once",
    )
    learning: LearningParameters = group(LearningParameters)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return a group that a law declares."""

    @property
    def law(self):
        """What the chosen controller declares, a :class:`~hysteresis_ros.control.law.ControllerLaw`."""
        return LAWS[self.type]

    @property
    def without_preload(self) -> ControllerParameters:
        """The same for measurements of which the preload's offset was taken off; always the same instance."""
        if "_without_preload" not in self.__dict__:
            self.model.preload.validated("model.preload.")
            model = replace(self.model, preload=PreloadParameters())
            self.__dict__["_without_preload"] = replace(self, model=model)
        return self.__dict__["_without_preload"]

    def before_damping(self, sample_time: float):
        """Return the parameters as the law has them: the plant in its model is the damped one.

        Parameters
        ----------
        sample_time : float
            [s]

        Raises
        ------
        ParameterError
            The damping cannot run at this sample time, or is unstable on the model.
        """
        if self.damping.source == NOTHING:
            return self
        kept = self.__dict__.setdefault("_before_damping", {})
        if sample_time not in kept:
            dynamics = damped(self.model.dynamics, self.damping, sample_time, self.model.force)
            model = replace(self.model, dynamics=dynamics)
            kept[sample_time] = replace(self, model=model, damping=DampingParameters())
        return kept[sample_time]

    def check(self):
        """Yield what keeps the chosen controller from being designed."""
        yield from super().check()
        rate = getattr(self, "sample_rate", None)  # the node's parameters, which contain these, know it
        sample_time = 1.0 / rate if rate else None
        known = sample_time or self.model.dynamics.sample_time
        if rate and self.learning.in_use and not self.learning.problems():
            try:
                period_samples(self.learning.period, rate)
            except ParameterError as error:
                yield from error.problems
        try:
            own = self.before_damping(known) if known else self
            if self.feedforward.type == "inverse_dynamics":
                inverse_filter(own.model.dynamics, self.feedforward.preview)
        except ParameterError as error:
            yield from error.problems
            if self.damping.source != NOTHING:
                return
        try:
            own.law.check(own, sample_time)
        except ParameterError as error:
            yield from error.problems

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return doubts about the parameters: those of groups and law, and of a preview that cuts much off."""
        found = super().warnings(prefix)
        if self.feedforward.type == "inverse_dynamics":
            found += preview_warning(self.model.dynamics, self.feedforward.preview, prefix)
        return found + tuple(self.law.warnings(self, prefix))


def controller_block(parameters: ControllerParameters, sample_time: float) -> Controller:
    """Return the controller that ``parameters`` describe, with the damped plant as its model where there is a damping.

    Raises
    ------
    ParameterError
        A parameter is out of range, no stable controller follows from the parameters, or the model is for another
        sample time.
    """
    parameters.validated().model.dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    own = parameters.before_damping(sample_time)
    return own.law.block(own, sample_time)


def damping_block(parameters: ControllerParameters, sample_time: float) -> Damping:
    """Return the damping behind the controller.

    Raises
    ------
    ParameterError
        It cannot run at this sample time, or is unstable on the model.
    """
    return Damping(parameters, sample_time)


def prepare_controllers() -> None:
    """Compile the kernels of all controllers, so that any of them can take over within a sample."""
    if COMPILED:
        for law in LAWS.values():
            law.block.kernel.compile(signature("scalar", "array", "array", "scalar", "scalar").args)


def feedforward_block(parameters: ControllerParameters, sample_time: float) -> Feedforward:
    """Return the feedforward in front of the controller.

    Raises
    ------
    ParameterError
        The model cannot be inverted as the parameters ask for.
    """
    return Feedforward(parameters.before_damping(sample_time), sample_time)


def handover_block(parameters: ControllerParameters, sample_time: float) -> Handover:
    """Return the hand-over with the controller's ``handover_time``."""
    return Handover(HandoverParameters(time=parameters.handover_time), sample_time)


#: Samples that are kept: long enough for an observer to settle.
SAMPLES = 500
#: Samples at their end over which two controllers are compared.
AVERAGED = 50


# State of a history: entries so far, then a ring of the last samples, four numbers each.
ENTRIES = 0
APPLIED_THEN, REFERENCE_THEN, FED_THEN, MEASURED_THEN = range(4)
ENTRY = 4


@called
def note(x, applied, reference, fed, measured):
    """Keep one sample in the history ``x``.

    Parameters
    ----------
    x : ndarray
        State of a :class:`History`.
    applied : float
        Command carried out for the sample before [m].
    reference, fed, measured : float
        Delayed reference, command of the feedforward and measured displacement of this sample [m].
    """
    length = (x.shape[0] - 1) // ENTRY
    place = 1 + ENTRY * (int(x[ENTRIES]) % length)
    x[place + APPLIED_THEN] = applied
    x[place + REFERENCE_THEN] = reference
    x[place + FED_THEN] = fed
    x[place + MEASURED_THEN] = measured
    x[ENTRIES] += 1.0


class History:
    """The last samples of a run, as many as ``SAMPLES``: what every controller would have been given.

    Attributes
    ----------
    p, x : ndarray
        Empty parameters, and the state for :func:`note`.
    """

    def __init__(self):
        self.p = np.zeros(0)
        self.x = np.zeros(1 + ENTRY * SAMPLES)

    def reset(self) -> None:
        """Forget everything: the next sample does not follow the last one."""
        self.x[ENTRIES] = 0.0

    @property
    def samples(self) -> np.ndarray:
        """The samples in order, shape (n, 4): applied, reference, fed, measured [m]."""
        count = int(self.x[ENTRIES])
        ring = self.x[1:].reshape(SAMPLES, ENTRY)
        if count <= SAMPLES:
            return ring[:count].copy()
        return np.roll(ring, -(count % SAMPLES), axis=0)


def successor(
    parameters: ControllerParameters, sample_time: float, predecessor: Controller, history: History
) -> tuple[Controller, float | None]:
    """Return the controller of ``parameters``, ready for the sample after the last one of ``predecessor``.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s].
    predecessor : Controller
        It is not changed.
    history : History
        The last samples; without any the observer starts from rest at the next measurement.

    Returns
    -------
    controller : Controller
    lasting : float or None
        How far what was carried out lately is from what the controller would have wanted, on average [m]; for
        :func:`hysteresis_ros.control.controller.arm`. None when it is not known, or begins from the present command.

    Raises
    ------
    ParameterError
        No controller follows from the parameters.
    """
    made = controller_block(parameters, sample_time)
    lasting = None
    if made.runs_beside and len(history.samples):
        wanted = _beside(made, history)
        # what was carried out for a sample is known one sample later
        carried_out = history.samples[1:, APPLIED_THEN].tolist() + [predecessor.x[APPLIED]]
        recent = list(zip(carried_out, wanted, strict=True))[-AVERAGED:]
        lasting = math.fsum(one - other for one, other in recent) / len(recent)
    if made.shares_observer(predecessor):
        made.continue_from(predecessor)
    if made.x[STARTED] != 0.0 and made.settle(predecessor.x[APPLIED]):
        lasting = None
    started = made.x[STARTED]
    made.x[:HEADER] = predecessor.x[:HEADER]
    made.x[STARTED] = started
    return made, lasting


def _beside(controller: Controller, history: History) -> list[float]:
    """Take a controller through the last samples and return what it would have wanted."""
    wanted = []
    for applied, reference, fed, measured in history.samples.tolist():
        controller.x[APPLIED] = controller.x[COMMAND] = applied
        controller.x[FEEDFORWARD] = fed
        wanted.append(controller.kernel(controller.p, controller.x, reference, measured))
        controller.forget()
    return wanted
