# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a controller is and declares: the beginning of its arrays, its base class, and its law, design and checks.

A controller is a kernel ``u = kernel(p, x, r, y)``: reference displacement r without preload offset [m], measured
displacement y [m], command u [m] to the hysteresis compensator. The first entries of every state array are the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import InitVar, dataclass, field
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.control.margins import AIMED, FASTEST, Judged, Requirements
from hysteresis_ros.control.uncertainty import PossiblePlant, judge_worst
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block, compiled, composite, kernel
from hysteresis_ros.models.linear import StateSpace

#: x[APPLIED]: command really carried out for the previous sample [m]. The kernel writes its own command there; whoever
#: runs the loop replaces it by what the limits left of it before the next call.
APPLIED = 0
#: x[ESTIMATED]: displacement as the observer sees it [m], comparable with the measured one (preload offset included).
ESTIMATED = 1
#: x[SWITCHING]: switching function s, in the model's units.
SWITCHING = 2
#: x[COMMAND]: last command [m].
COMMAND = 3
#: x[DISTURBANCE]: estimated constant disturbance of the command [m].
DISTURBANCE = 4
#: x[STARTED]: 0.0 makes the next call start the observer from rest at the measured displacement.
STARTED = 5
#: x[FEEDFORWARD]: command of the feedforward for this sample [m]; whoever runs the loop writes it before the call.
FEEDFORWARD = 6
#: Number of entries of the common part of x.
HEADER = 7
#: p[FED]: 1.0 when there is a feedforward, the first entry of the parameters of every controller.
FED = 0

#: Signals beyond this are cut, so that no input ever makes a product or a sum infinite.
BOUND = 1e60


@kernel
def bounded(value):
    """Return ``value`` cut to ±1e60; what is not a number, which nodes refuse before, counts as 0."""
    if value != value:
        return 0.0
    if value > BOUND:
        return BOUND
    if value < -BOUND:
        return -BOUND
    return value


@composite("void", "controller", "array", "array", "array", "array", "array")
def run_controller(step, p, x, r, y, u):
    """Fill ``u[k] = step(p, x, r[k], y[k])`` for all k: a controller fed with a recording."""
    for k in range(u.shape[0]):
        u[k] = step(p, x, r[k], y[k])


class Controller(Block):
    """Base of the controllers: a block with two inputs.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s].
    """

    #: Whether it goes on by what its observer foresees while the measurement is NaN.
    predicts = False

    #: Whether it can be taken through samples of another controller, as if it had run beside it all the time.
    runs_beside = False

    def shares_observer(self, other: Controller) -> bool:
        """Tell whether the observer of another controller is the same, so that its state can go on."""
        return False

    def continue_from(self, predecessor: Controller) -> None:
        """Take over the observer of a controller that shares it.

        Raises
        ------
        TypeError
            The law has no observer.
        """
        raise TypeError(f"{type(self).__name__} has no observer to take over")

    def forget(self) -> None:
        """Drop what the law has integrated while another one is in charge, whose errors these are."""

    def settle(self, applied: float) -> bool:
        """Set what the law integrates so that the command goes on from ``applied`` [m]; False when it cannot."""
        return False

    def step(self, reference: float, measured: float) -> float:
        """Return the command [m] for one sample of reference and measured displacement [m]."""
        return self.kernel(self.p, self.x, float(reference), float(measured))

    def simulate(self, reference, measured) -> np.ndarray:
        """Return the commands, shape (N,) [m], for recorded ``reference`` and ``measured``, shape (N,) [m]."""
        reference = np.ascontiguousarray(reference, dtype=np.float64)
        measured = np.ascontiguousarray(measured, dtype=np.float64)
        command = np.empty_like(reference)
        compiled(run_controller)(self.kernel, self.p, self.x, reference, measured, command)
        return command

    def retune(self, parameters) -> None:
        """Take new gains while running; arm the hand-over beside it, so that the command does not jump.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; the controller is unchanged then.
        """
        parameters = parameters.validated()
        if parameters.type != self.parameters.type:
            raise ParameterError([Problem("type", parameters.type, "changes the controller; build a new block of it")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [Problem("model.dynamics.B", parameters.model.dynamics.B, "the order of the model cannot change live")]
            )
        self.parameters = parameters
        self.p[:] = packed


#: Parameters of the motion controller without feedforward, for a comparison.
UNFED: Mapping[str, Any] = {"feedforward.type": "none", "feedforward.preview": 0}


@dataclass(frozen=True, eq=False)
class DesignTask:
    """What a design is asked: gains of a controller for the model in its parameters.

    Parameters
    ----------
    parameters : ControllerParameters
        Of the type that is designed. The model in it is minimal and stable; what the design does not decide is kept.
    sample_time : float
        [s]
    bandwidth : float or None
        Frequency at which the response to the reference, without feedforward, is to fall by 3 dB [Hz].
    q : float or None
        Variance of the input's noise over that of the measurement in the Kalman filter.
    loop : callable
        ``loop(parameters)`` returns controller and model, two :class:`StateSpace`, close to rest; for
        :func:`hysteresis_ros.control.margins.judge`.
    aimed : Requirements, optional
        What a design of its own accord, without a bandwidth, has to meet.
    plants : tuple of PossiblePlant, optional
        Plants on which it has to meet that, the model first; by default the model alone.
    """

    parameters: Any
    sample_time: float
    bandwidth: float | None
    q: float | None
    loop: Callable[[Any], tuple[StateSpace, StateSpace]]
    aimed: Requirements = AIMED
    plants: tuple[PossiblePlant, ...] = ()

    def judge(self, parameters) -> Judged:
        """Return bandwidth on the model, and the worst of everything else on all plants up to one that misses the aim.

        Parameters
        ----------
        parameters : ControllerParameters
        """
        controller, model = self.loop(parameters)
        return judge_worst(controller, self.plants or (PossiblePlant(model),), self.sample_time, self.aimed)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Gains that can be tuned on a criterion of the simulated loop.

    Parameters
    ----------
    gains : tuple of str
        Names of the numbers in the controller's own group; those that are 0 at the start stay 0.
    start : callable
        ``start(parameters, sample_time)`` returns the parameters to begin with.
    loop : callable
        ``loop(parameters, sample_time)`` returns controller and model by whose margins candidates are judged.
    required : Requirements
        Gains that miss it are refused.
    """

    gains: tuple[str, ...]
    start: Callable[[Any, float], Any]
    loop: Callable[[Any, float], tuple[StateSpace, StateSpace]]
    required: Requirements = FASTEST


def _no_check(parameters, sample_time: float | None) -> None:
    """Find nothing wrong."""


def _as_it_is(parameters):
    return parameters


def _no_rows(parameters, sample_time: float):
    return ()


def _no_doubts(parameters, sample_time: float, tuned: bool):
    return ()


def _no_warnings(parameters, prefix: str):
    return ()


@dataclass(frozen=True, eq=False)
class ControllerLaw:
    """A controller: its type, law and parameters, and what the rest of the package asks of it.

    Parameters
    ----------
    name : str
        ``type`` of the motion controller.
    block : type of Controller
        Kernel, state and parameter array.
    description : str
        A few words for the table of parameters.
    groups : mapping of str to type, optional
        Groups of the motion controller's parameters that it uses, by name. A group with the name of the law that no
        other law uses is checked only while the law is chosen.
    feedback : bool, optional
        Whether it uses the measurement: without that, nothing limits the bandwidth of a reference.
    check : callable, optional
        ``check(parameters, sample_time)`` raises ParameterError, with names relative to the motion controller's
        parameters, where no stable controller follows; the sample time is None where it is not known.
    warnings : callable, optional
        ``warnings(parameters, prefix)`` returns sentences about doubts; prefix stands before names of parameters.
    near_rest : callable, optional
        ``near_rest(parameters)`` returns parameters with which the kernel is linear close to rest; the preload offset
        and the feedforward are off already.
    designs : mapping of str to callable, optional
        Name for ``hysteresis design --controller`` → ``design(task)``, which returns parameters with gains for a
        :class:`DesignTask`.
    rows : callable, optional
        ``rows(parameters, sample_time)`` returns (name, text) of what a design prints of its gains.
    doubts : callable, optional
        ``doubts(parameters, sample_time, tuned)`` returns sentences about what a user should know of a design.
    tuning : Tuning, optional
        Which gains ``--criterion`` tunes.
    compared : optional
        No part of a law any more, for laws of other packages: given, it is passed over with a warning that says where
        the rows of ``hysteresis compare`` stand instead.
    """

    name: str
    block: type[Controller]
    description: str
    groups: Mapping[str, type[Parameters]] = field(default_factory=dict)
    feedback: bool = True
    check: Callable[[Any, float | None], None] = _no_check
    warnings: Callable[[Any, str], Collection[str]] = _no_warnings
    near_rest: Callable[[Any], Any] = _as_it_is
    designs: Mapping[str, Callable[[DesignTask], Any]] = field(default_factory=dict)
    rows: Callable[[Any, float], Collection[tuple[str, str]]] = _no_rows
    doubts: Callable[[Any, float, bool], Collection[str]] = _no_doubts
    tuning: Tuning | None = None
    compared: InitVar[Any] = None

    def __post_init__(self, compared: Any) -> None:
        if compared is not None:
            warnings.warn(
                f"controller {self.name}: compared = {compared!r} has no effect: a law does not hold its rows of "
                "hysteresis compare any more; leave it out and declare them by an entry point of the group "
                '"hysteresis_ros.compared" (docs/extending.md)',
                RuntimeWarning,
                stacklevel=3,
            )
