# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motion controller: its laws by name, its parameters and blocks, and bumpless transfer to other laws or gains.

A new law first processes the last samples of the run, as if it had run in parallel with its predecessor, because an
observer that starts from rest would move the command while it settles. Two controllers with the same model and Kalman
filter share the observer and its state. The integrated states of the new law are set so that the command continues from
its present value. If this is impossible, they are set to zero. The hand-over block behind the controller lets the
remaining difference decay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hysteresis_ros.control.laws  # noqa: F401  (the registry searches its folder)
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

#: Declaration of each controller, by type.
LAWS: dict[str, ControllerLaw] = discover("hysteresis_ros.control.laws", "CONTROLLER", ControllerLaw, GROUP)


def _designs() -> dict[str, tuple[ControllerLaw, Callable]]:
    """Return the law and the design function for each name; TypeError if two laws declare a design of the same name."""
    found: dict[str, tuple[ControllerLaw, Callable]] = {}
    for law in LAWS.values():
        for name, function in law.designs.items():
            if name in found:
                raise TypeError(f"controllers {found[name][0].name} and {law.name} both have a design {name!r}")
            found[name] = law, function
    return found


#: Law and design function for each name that ``hysteresis design --controller`` accepts.
DESIGNS = _designs()


def with_groups(cls):
    """Add the parameter groups of all laws to a class (decorator below ``@dataclass(frozen=True)``).

    Groups with the name of a law come first, then the groups that laws share.

    Raises
    ------
    TypeError
        Two laws declare different parameters under the same group.
    """
    found: dict[str, tuple[type[Parameters], list[str]]] = {}
    for law in LAWS.values():
        for name, kind in law.groups.items():
            known, users = found.setdefault(name, (kind, []))
            if known is not kind:
                raise TypeError(
                    f"controllers {users[0]} and {law.name} both have a group {name}, with different parameters"
                )
            users.append(law.name)
    for name in sorted(found, key=lambda name: (name not in LAWS, name)):
        kind, users = found[name]
        cls.__annotations__[name] = kind
        setattr(cls, name, group(kind, variant_of="type" if users == [name] else None))
    return cls


def design_of(name: str):
    """Return law and design function for a name of ``hysteresis design``; ConfigurationError lists the known names."""
    if name not in DESIGNS:
        there = ", ".join(sorted(DESIGNS))
        raise ConfigurationError(f"no controller '{name}' to design; there are: {there}{did_you_mean(name, DESIGNS)}")
    return DESIGNS[name]


#: p[DECAY]: factor of the bias from one sample to the next.
DECAY = 0
#: x[BIAS]: bias added to the input.
BIAS = 0
#: x[LAST]: last output.
LAST = 1
#: x[ARMED]: not 0: the next output must be equal to the last output. 2.0: in addition, x[BIAS] already contains the
#: difference that decays with the time constant.
ARMED = 2
#: x[QUICK]: additional bias that is halved in each sample.
QUICK = 3

#: A bias below this value is set to zero before it becomes a subnormal number, because such numbers slow processors
#: down.
SMALLEST = 1e-300


@kernel
def handover(p, x, u):
    """Return ``u + bias`` and let the bias decay; when armed, choose the bias so that the output does not change."""
    if x[ARMED] != 0.0:
        lasting = x[ARMED] == 2.0
        x[ARMED] = 0.0
        if p[DECAY] > 0.0:
            x[QUICK] = 0.0
            if lasting:
                x[QUICK] = x[LAST] - u - x[BIAS]
            else:
                x[BIAS] = x[LAST] - u
            # return exactly the last output, not u + (last - u), which has a rounding error
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
    """Make the next output equal to ``last``, and fade from it to the input."""
    x[LAST] = last
    x[ARMED] = 1.0


@dataclass(frozen=True)
class HandoverParameters(Parameters):
    """Smoothing of a change of controller."""

    time: float = parameter(
        0.05,
        unit="s",
        low=0.0,
        description="Time constant with which the difference between old and new command decays; 0: immediately",
    )


class Handover(Block):
    """Add a bias to the input; after :func:`arm` the bias decays.

    Parameters
    ----------
    parameters : HandoverParameters
    sample_time : float
        Sample time [s].
    """

    kernel = staticmethod(handover)

    def pack(self, parameters) -> np.ndarray:
        """Return the array [exp(-sample time / time)], [0] if the time is 0."""
        return np.array([elementary.exp(-self.sample_time / parameters.time) if parameters.time > 0.0 else 0.0])

    def initial_state(self) -> np.ndarray:
        """Return the state without bias."""
        return np.zeros(4)


def arm(block: Handover, last: float | None = None, lasting: float | None = None) -> None:
    """Make the next output of ``block`` equal to its last output, and let the difference from the input decay.

    Call this function after a change of controller type or gains, after a stale measurement, and at a start after a
    stop. ``last`` is the value to continue from if another (safe) output was sent after the block's last output.
    ``lasting`` is the mean recent difference between the output and the new input. Only ``lasting`` decays with the
    time constant. The rest of the present difference is mostly noise. It is halved in each sample, because a slowly
    decaying bias from noise would disturb the feedback.
    """
    if last is not None:
        block.x[LAST] = float(last)
    block.x[ARMED] = 1.0
    if lasting is not None:
        block.x[ARMED] = 2.0
        block.x[BIAS] = float(lasting)


@dataclass(frozen=True)
class ModelParameters(Parameters):
    """The controller's own model of the plant."""

    dynamics: LinearParameters = group(LinearParameters)
    preload: PreloadParameters = group(PreloadParameters)
    force: ForceParameters = group(ForceParameters)


@dataclass(frozen=True)
@with_groups
class ControllerParameters(Parameters):
    """Motion controller: type, model, hand-over, and the parameter groups that the laws declare."""

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
        description="Time constant with which the command moves to the command of a new controller or new gains; "
        "0: immediately",
    )
    learning: LearningParameters = group(LearningParameters)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return a parameter group that one of the laws declares."""

    @property
    def law(self):
        """Declaration of the chosen controller, a :class:`~hysteresis_ros.control.law.ControllerLaw`."""
        return LAWS[self.type]

    @property
    def without_preload(self) -> ControllerParameters:
        """These parameters with a preload offset of 0, for measurements without offset; always the same instance."""
        if "_without_preload" not in self.__dict__:
            self.model.preload.validated("model.preload.")
            model = replace(self.model, preload=PreloadParameters())
            self.__dict__["_without_preload"] = replace(self, model=model)
        return self.__dict__["_without_preload"]

    def before_damping(self, sample_time: float):
        """Return the parameters of the law, with the damped plant as model.

        Raises
        ------
        ParameterError
            The damping filter cannot run at this sample time, or the inner loop is unstable on the model.
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
        """Yield a Problem for each reason why the chosen controller cannot be computed."""
        yield from super().check()
        rate = getattr(self, "sample_rate", None)  # only the parameters of a node contain a sample rate
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
        """Return the warnings of the groups and the law, and a warning about a preview that truncates the inverse."""
        found = super().warnings(prefix)
        if self.feedforward.type == "inverse_dynamics":
            found += preview_warning(self.model.dynamics, self.feedforward.preview, prefix)
        return found + tuple(self.law.warnings(self, prefix))


def controller_block(parameters: ControllerParameters, sample_time: float) -> Controller:
    """Return the controller of ``parameters``; with damping, the model of this controller is the damped plant.

    ParameterError: a parameter is out of range, there is no stable controller, or the model is for another sample time.
    """
    parameters.validated().model.dynamics.require_sample_time(sample_time, "model.dynamics.sample_time")
    own = parameters.before_damping(sample_time)
    return own.law.block(own, sample_time)


def damping_block(parameters: ControllerParameters, sample_time: float) -> Damping:
    """Return the damping block, which runs after the controller.

    ParameterError: the filter cannot run at this sample time, or the inner loop is unstable on the model.
    """
    return Damping(parameters, sample_time)


def prepare_controllers() -> None:
    """Compile the kernels of all controllers, so that a change of controller takes effect within a sample."""
    if COMPILED:
        for law in LAWS.values():
            law.block.kernel.compile(signature("scalar", "array", "array", "scalar", "scalar").args)


def feedforward_block(parameters: ControllerParameters, sample_time: float) -> Feedforward:
    """Return the feedforward block, which runs before the controller; ParameterError if the inverse does not exist."""
    return Feedforward(parameters.before_damping(sample_time), sample_time)


def handover_block(parameters: ControllerParameters, sample_time: float) -> Handover:
    """Return the hand-over block with the ``handover_time`` of the controller."""
    return Handover(HandoverParameters(time=parameters.handover_time), sample_time)


#: Number of stored samples; they are enough for an observer to settle.
SAMPLES = 500
#: Number of last samples over which the difference between the commands of two controllers is averaged.
AVERAGED = 50


# State of a history: number of entries, then a ring of the last samples with four numbers each.
ENTRIES = 0
APPLIED_THEN, REFERENCE_THEN, FED_THEN, MEASURED_THEN = range(4)
ENTRY = 4


@called
def note(x, applied, reference, fed, measured):
    """Store one sample in the history ``x``.

    Parameters
    ----------
    x : ndarray
        State of a :class:`History`.
    applied : float
        Achieved command of the previous sample [m].
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
    """The inputs of a controller in the last ``SAMPLES`` samples of a run.

    Attributes
    ----------
    p, x : ndarray
        Empty parameters, and the state for :func:`note`.
    """

    def __init__(self):
        self.p = np.zeros(0)
        self.x = np.zeros(1 + ENTRY * SAMPLES)

    def reset(self) -> None:
        """Clear the history, because there is a gap before the next sample."""
        self.x[ENTRIES] = 0.0

    @property
    def samples(self) -> np.ndarray:
        """The stored samples in order of time, shape (n, 4): applied, reference, fed, measured [m]."""
        count = int(self.x[ENTRIES])
        ring = self.x[1:].reshape(SAMPLES, ENTRY)
        if count <= SAMPLES:
            return ring[:count].copy()
        return np.roll(ring, -(count % SAMPLES), axis=0)


def successor(
    parameters: ControllerParameters, sample_time: float, predecessor: Controller, history: History
) -> tuple[Controller, float | None]:
    """Return the controller of ``parameters`` that continues after the last sample of ``predecessor``, and ``lasting``.

    ``predecessor`` is not changed. If ``history``, which contains the last samples, is empty, the observer starts from
    rest at the next measurement. ``lasting`` is the mean recent difference between the achieved command and the command
    of the new controller [m], for :func:`hysteresis_ros.control.controller.arm`. It is None if this difference is
    unknown, or if the new controller continues from the present command. ParameterError: no controller can be built
    from the parameters.
    """
    made = controller_block(parameters, sample_time)
    lasting = None
    if made.runs_beside and len(history.samples):
        wanted = _beside(made, history)
        # the achieved command of a sample is known one sample later
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
    """Run a controller with the samples of a history and return its commands."""
    wanted = []
    for applied, reference, fed, measured in history.samples.tolist():
        controller.x[APPLIED] = controller.x[COMMAND] = applied
        controller.x[FEEDFORWARD] = fed
        wanted.append(controller.kernel(controller.p, controller.x, reference, measured))
        controller.forget()
    return wanted
