# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Definition and declaration of a controller: common entries of its arrays, base class, law, design and checks.

A controller is a kernel ``u = kernel(p, x, r, y)``: r is the reference displacement without preload offset [m], y the
measured displacement [m], and u the command to the hysteresis compensator [m]. The first entries of every state array
are the same.
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

#: x[APPLIED]: achieved command of the previous sample [m]. The kernel stores its own command in this entry; before the
#: next call, the loop replaces it by the achieved command.
APPLIED = 0
#: x[ESTIMATED]: displacement estimated by the observer [m]; like the measured displacement, it includes the preload
#: offset.
ESTIMATED = 1
#: x[SWITCHING]: switching function s, in the model's units.
SWITCHING = 2
#: x[COMMAND]: last command [m].
COMMAND = 3
#: x[DISTURBANCE]: estimated constant disturbance of the command [m].
DISTURBANCE = 4
#: x[STARTED]: with 0.0, the next call starts the observer from rest at the measured displacement.
STARTED = 5
#: x[FEEDFORWARD]: command of the feedforward for this sample [m]; the loop writes it before the call.
FEEDFORWARD = 6
#: Number of entries of the common part of x.
HEADER = 7
#: p[FED], the first parameter of every controller: 1.0 if there is a feedforward.
FED = 0

#: Signals are limited to this magnitude, so that products and sums stay finite.
BOUND = 1e60


@kernel
def bounded(value):
    """Return ``value`` limited to ±1e60; NaN becomes 0, but the nodes never pass NaN."""
    if value != value:
        return 0.0
    if value > BOUND:
        return BOUND
    if value < -BOUND:
        return -BOUND
    return value


@composite("void", "controller", "array", "array", "array", "array", "array")
def run_controller(step, p, x, r, y, u):
    """Set ``u[k] = step(p, x, r[k], y[k])`` for every sample k of recorded inputs."""
    for k in range(u.shape[0]):
        u[k] = step(p, x, r[k], y[k])


class Controller(Block):
    """Base class of the controllers: a block with two inputs.

    Parameters
    ----------
    parameters : ControllerParameters
    sample_time : float
        Sample time [s].
    """

    #: Whether the controller continues with the prediction of its observer while the measurement is NaN.
    predicts = False

    #: Whether the controller can process past samples of another controller, as if it had run in parallel.
    runs_beside = False

    def shares_observer(self, other: Controller) -> bool:
        """Return whether another controller has the same observer, so that the observer's state can be taken over."""
        return False

    def continue_from(self, predecessor: Controller) -> None:
        """Take over the observer's state from another controller that has the same observer.

        Raises
        ------
        TypeError
            The law has no observer.
        """
        raise TypeError(f"{type(self).__name__} has no observer to take over")

    def forget(self) -> None:
        """Reset the integrated states: errors during another law's operation do not belong in this law's integral."""

    def settle(self, applied: float) -> bool:
        """Set the integrated states so that the command continues from ``applied`` [m]; False if impossible."""
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
        """Change the gains while running; the caller must arm the hand-over, so that the command does not jump.

        Raises
        ------
        ParameterError
            The parameters are wrong or change the structure; in this case the controller is not changed.
        """
        parameters = parameters.validated()
        if parameters.type != self.parameters.type:
            raise ParameterError([Problem("type", parameters.type, "cannot change in a block; build a new block")])
        packed = np.ascontiguousarray(self.pack(parameters), dtype=np.float64)
        if packed.shape != self.p.shape:
            raise ParameterError(
                [
                    Problem(
                        "model.dynamics.B",
                        parameters.model.dynamics.B,
                        "the order of the model cannot change while running",
                    )
                ]
            )
        self.parameters = parameters
        self.p[:] = packed


#: Parameters of a controller without feedforward.
UNFED: Mapping[str, Any] = {"feedforward.type": "none", "feedforward.preview": 0}


@dataclass(frozen=True, eq=False)
class DesignTask:
    """Task of a design: find the gains of a controller for the model in the controller's parameters.

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters with the type of the controller. Their model is minimal and stable. The design keeps all values that
        it does not determine.
    sample_time : float
        [s]
    bandwidth : float or None
        Required -3 dB bandwidth of the response to the reference, without feedforward [Hz].
    q : float or None
        Kalman filter: ratio of the input noise variance to the measurement noise variance.
    loop : callable
        ``loop(parameters)`` returns controller and model, linearised close to rest, as two :class:`StateSpace` for
        :func:`hysteresis_ros.control.margins.judge`.
    aimed : Requirements, optional
        Requirements of a design without a given bandwidth.
    plants : tuple of PossiblePlant, optional
        Plants on which the design must meet the requirements, the model first; by default the model alone.
    """

    parameters: Any
    sample_time: float
    bandwidth: float | None
    q: float | None
    loop: Callable[[Any], tuple[StateSpace, StateSpace]]
    aimed: Requirements = AIMED
    plants: tuple[PossiblePlant, ...] = ()

    def judge(self, parameters) -> Judged:
        """Return the bandwidth on the model and the worst other figures; it stops at the first plant that fails."""
        controller, model = self.loop(parameters)
        return judge_worst(controller, self.plants or (PossiblePlant(model),), self.sample_time, self.aimed)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Gains that can be tuned by a criterion in a simulation of the loop.

    Parameters
    ----------
    gains : tuple of str
        Names of the gains in the controller's own group. Gains that are 0 at the start stay 0.
    start : callable
        ``start(parameters, sample_time)`` returns the parameters with which the tuning starts.
    loop : callable
        ``loop(parameters, sample_time)`` returns controller and model; the margins are computed from them for each
        candidate.
    required : Requirements
        Requirements; gains that do not meet them are rejected.
    """

    gains: tuple[str, ...]
    start: Callable[[Any, float], Any]
    loop: Callable[[Any, float], tuple[StateSpace, StateSpace]]
    required: Requirements = FASTEST


def _no_check(parameters, sample_time: float | None) -> None:
    """Accept everything."""


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
    """A controller: its type, law and parameters, and the functions that other parts of the package call.

    Parameters
    ----------
    name : str
        ``type`` of the motion controller.
    block : type of Controller
        Kernel, state and parameter array.
    description : str
        Short description for the table of parameters.
    groups : mapping of str to type, optional
        Parameter groups of the motion controller that the law uses, by name. A group that has the name of the law and
        that no other law uses is checked only if this law is chosen.
    feedback : bool, optional
        Whether the law uses the measurement. For a law without feedback, the frequency of a reference is not checked.
    check : callable, optional
        ``check(parameters, sample_time)`` raises ParameterError if the parameters give no stable controller; names are
        relative to the parameters of the motion controller. The sample time is None if it is not known.
    warnings : callable, optional
        ``warnings(parameters, prefix)`` returns warnings as sentences, with ``prefix`` in front of the names of
        parameters.
    near_rest : callable, optional
        ``near_rest(parameters)`` receives parameters without preload offset and feedforward, and returns the parameters
        with which the kernel is linear close to rest.
    designs : mapping of str to callable, optional
        Name for ``hysteresis design --controller`` → ``design(task)``, which returns the parameters with gains for a
        :class:`DesignTask`.
    rows : callable, optional
        ``rows(parameters, sample_time)`` returns (name, text) of each row that a design prints about its gains.
    doubts : callable, optional
        ``doubts(parameters, sample_time, tuned)`` returns warnings about a design as sentences.
    tuning : Tuning, optional
        The gains that ``--criterion`` tunes.
    compared : optional
        Obsolete, for laws of other packages: it is ignored with a warning that names its replacement.
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
                f"controller {self.name}: compared = {compared!r} has no effect, because a law no longer "
                "contains its rows of hysteresis compare; remove it and declare the rows by an entry "
                "point of the group "
                '"hysteresis_ros.compared" (docs/extending.md)',
                RuntimeWarning,
                stacklevel=3,
            )
