# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The motion controller's parameters, and the blocks they describe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hysteresis_ros.block import COMPILED, signature
from hysteresis_ros.control.base import Controller
from hysteresis_ros.control.damping.block import Damping
from hysteresis_ros.control.damping.kind import NOTHING
from hysteresis_ros.control.damping.parameters import DampingParameters
from hysteresis_ros.control.damping.plant import damped
from hysteresis_ros.control.feedforward import Feedforward, FeedforwardParameters
from hysteresis_ros.control.handover import Handover, HandoverParameters
from hysteresis_ros.control.inversion import inverse_filter, preview_warning
from hysteresis_ros.control.learning.parameters import LearningParameters, period_samples
from hysteresis_ros.control.registry import LAWS, with_groups
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.force_sensor import ForceParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.preload import PreloadParameters
from hysteresis_ros.parameters import Parameters, group, parameter


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
