# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Damping in the loop: the kinds by name, the damped plant of a controller, and the running filter.

Let w be the output of the law, y the measured displacement without preload offset, and f the measured force in the
stack. With a filter F(z) of the measurement the command is u = γ w + F y. The factor γ = 1 − F(1) P(1) keeps the DC
gain of the model P, so that gains, inverses and steady states of a law stay valid with damping. With a filter of the
law's output, the command is u = F w; with a filter of the force, it is u = γ w + F f. The force f = (k_a + k_f) d − k_a
y, where d is the quasi-static displacement, passes through the high-pass of the force sensor before the filter; in this
case the plant has the outputs (y, d).

An achieved command u_applied corresponds to the output of the law

w_applied = w + (u_applied − u) / b

where b is the direct gain from w to u. Without saturation, w_applied is exactly w. A filter of a measurement does not
wind up, because its input is measured even while the command is saturated. A filter of the law's output has unit DC
gain, and the effect of a saturation on it decays with its time constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hysteresis_ros.control.damping.kinds  # noqa: F401  (the registry searches its folder)
from hysteresis_ros.configuration import Parameters, parameter, variants
from hysteresis_ros.control.damping.kind import (
    COMMAND,
    FORCE,
    MEASUREMENT,
    MOST_STATES,
    NOTHING,
    DampingKind,
    in_series,
)
from hysteresis_ros.control.law import bounded
from hysteresis_ros.control.margins import with_acting
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block, called, kernel
from hysteresis_ros.models.linear import BOUNDARY, LinearParameters, StateSpace, accumulate, advance
from hysteresis_ros.models.linear_algebra import product, solve
from hysteresis_ros.models.sensor import ForceParameters
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a kind: ``lead = my_package.lead:DAMPING``.
GROUP = "hysteresis_ros.damping"

#: Declaration of each kind, by type; the additional type ``none`` means no damping.
KINDS: dict[str, DampingKind] = discover("hysteresis_ros.control.damping.kinds", "DAMPING", DampingKind, GROUP)

#: Type for no damping.
NONE = "none"


@dataclass(frozen=True)
@variants("type", {name: kind.parameters for name, kind in KINDS.items()})
class DampingParameters(Parameters):
    """Damping between the law and the compensator."""

    type: str = parameter(
        NONE,
        choices=(NONE, *KINDS),
        description="none; " + "; ".join(f"{name}: {kind.description}" for name, kind in KINDS.items()),
    )

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the group of a kind."""

    @property
    def source(self) -> int:
        """Input of the filter, as one of the numbers in :mod:`~hysteresis_ros.control.damping.kind`."""
        return NOTHING if self.type == NONE else KINDS[self.type].source

    def filter(self, sample_time: float) -> StateSpace:
        """Return the filter of the chosen kind, in SI units.

        Raises
        ------
        ParameterError
            The filter cannot run at this sample time; the names in the message begin with ``damping.``.
        """
        try:
            found = KINDS[self.type].filter(getattr(self, self.type), sample_time)
        except ParameterError as error:
            named = [replace(problem, name=f"damping.{self.type}.{problem.name}") for problem in error.problems]
            raise ParameterError(named) from None
        if found.order > MOST_STATES:
            remedy = f"has {found.order} states, at most {MOST_STATES} are allowed"
            raise ParameterError([Problem("damping.type", self.type, remedy)])
        return found


#: Modulus below which a pole counts as a pole of a delay.
AT_ZERO = 1e-3


def modes(poles, sample_time: float) -> list[tuple[float, float]]:
    """Return (frequency [Hz], damping) of each pair of complex poles, the least damped first.

    Parameters
    ----------
    poles : ndarray of complex
        In the z plane.
    sample_time : float
        [s]
    """
    found = []
    for pole in poles:
        if abs(pole) > AT_ZERO and pole.imag > 0.0:
            logarithm = np.log(pole)
            size = float(abs(logarithm))
            found.append((size / (2.0 * np.pi * sample_time), -float(logarithm.real) / size))
    return sorted(found, key=lambda mode: mode[1])


@dataclass(frozen=True, eq=False)
class InnerLoop:
    """A damping filter, its input, and the gain from the law's output to the command.

    Parameters
    ----------
    filter : StateSpace
        In SI units.
    source : int
        Input of the filter.
    forward : float
        γ, weight of the law's output parallel to the filter; 0 if the filter's input is the law's output.
    seen : ndarray, shape (1, q)
        Row that computes the filter's input from the outputs of the plant.
    sensor : StateSpace, optional
        Dynamics of a sensor in front of the filter.
    """

    filter: StateSpace
    source: int
    forward: float
    seen: np.ndarray
    sensor: StateSpace | None = None

    @property
    def feedback(self) -> StateSpace:
        """The sensor followed by the filter."""
        return self.filter if self.sensor is None else in_series((self.sensor, self.filter))

    @property
    def direct(self) -> float:
        """Change of the command divided by the change of the law's output in the same sample."""
        return float(self.filter.D[0, 0]) if self.source == COMMAND else self.forward

    def around(self, plant: StateSpace, scale: float = 1.0) -> StateSpace:
        """Return the damped plant from the law's output to the measured displacement.

        Parameters
        ----------
        plant : StateSpace
            From command to measured displacement, y_k = C x_k. If the filter's input is the force, the second output
            must be the quasi-static displacement.
        scale : float
            Unit of the plant's output in SI, divided by the unit of its input in SI.
        """
        F = self.feedback
        n, m = plant.order, F.order
        if self.source == COMMAND:
            A = np.block([[F.A, np.zeros((m, n))], [product(plant.B, F.C), plant.A]])
            B = np.vstack([F.B, product(plant.B, F.D)])
        else:
            measured = scale * product(self.seen, plant.C)
            back = plant.A + product(plant.B, product(F.D, measured))
            A = np.block([[F.A, product(F.B, measured)], [product(plant.B, F.C), back]])
            B = np.vstack([np.zeros((m, 1)), self.forward * plant.B])
        return StateSpace(A, B, np.hstack([np.zeros((1, m)), plant.C[:1]]), np.zeros((1, 1)))

    def behind(self, controller: StateSpace) -> StateSpace:
        """Return controller and damping as one system, from (reference, outputs of the plant) to command.

        Parameters
        ----------
        controller : StateSpace
            From (reference, measured) to the law's output.
        """
        F = self.feedback
        n, m = controller.order, F.order
        if self.source == COMMAND:
            A = np.block([[controller.A, np.zeros((n, m))], [F.B @ controller.C, F.A]])
            B = np.vstack([controller.B, F.B @ controller.D])
            return StateSpace(A, B, np.hstack([F.D @ controller.C, F.C]), F.D @ controller.D)
        A = np.block([[controller.A, np.zeros((n, m))], [np.zeros((m, n)), F.A]])
        only_seen = np.hstack([[[0.0]], self.seen])
        # the law uses only the displacement
        unseen = (0, 0), (0, self.seen.shape[1] - 1)
        B = np.vstack([np.pad(controller.B, unseen), F.B @ only_seen])
        D = self.forward * np.pad(controller.D, unseen) + F.D @ only_seen
        return StateSpace(A, B, np.hstack([self.forward * controller.C, F.C]), D)


def inner_loop(
    damping: DampingParameters, dynamics: LinearParameters, sample_time: float, force: ForceParameters | None = None
) -> InnerLoop:
    """Return the inner loop of a damping filter around a model; the type of the damping must not be none.

    ParameterError: the filter cannot run at this sample time [s], or it uses the force and ``force`` contains no model
    of the force.
    """
    found, source = damping.filter(sample_time), damping.source
    only_displacement = np.ones((1, 1))
    if source == COMMAND:
        return InnerLoop(found, source, 0.0, only_displacement)
    gain = dynamics.matrices.dc_gain * dynamics.output_scale / dynamics.resolved_input_scale
    if source == MEASUREMENT:
        return InnerLoop(found, source, 1.0 - found.dc_gain * gain, only_displacement)
    require_force(damping.type, force)
    assert force is not None
    seen = np.array([[-force.stack_stiffness, force.whole]])
    if not force.high_pass:
        return InnerLoop(found, source, 1.0 - found.dc_gain * force.flexure_stiffness * gain, seen)
    slow = force.slow_part(sample_time)
    matrices = (np.array([[value]]) for value in (1.0 - slow, slow, -1.0, 1.0))
    return InnerLoop(found, source, 1.0, seen, StateSpace(*matrices))


def require_force(kind: str, force: ForceParameters | None) -> None:
    """Raise ParameterError for damping with force feedback if there is no model of the force."""
    if force is None or not force.there:
        remedy = (
            f"missing force joint: damping {kind} needs a force sensor in series with the stack; give the stiffness of "
            "stack and flexure (model.force.…), or use irc or ppf"
        )
        raise ParameterError([Problem("model.force.stack_stiffness", 0.0, remedy)])


def closing(
    damping: DampingParameters, dynamics: LinearParameters, sample_time: float, force: ForceParameters | None = None
) -> Callable[[StateSpace], StateSpace]:
    """Return a function from a plant in SI units to the damped plant; without damping it returns the plant unchanged.

    Parameters
    ----------
    damping : DampingParameters
    dynamics : LinearParameters
        The model.
    sample_time : float
        [s]
    force : ForceParameters, optional
        The model of the force in the stack.
    """
    if damping.source == NOTHING:
        return lambda plant: plant.shown
    return inner_loop(damping, dynamics, sample_time, force).around


def undamped(dynamics: LinearParameters) -> StateSpace:
    """Return a minimal model from command to measured displacement, in the units of ``dynamics``."""
    model = dynamics.state_space
    return model.held() if model.D.item() != 0.0 else model


def damped(
    dynamics: LinearParameters, damping: DampingParameters, sample_time: float, force: ForceParameters | None = None
) -> LinearParameters:
    """Return the model of the damped plant, in the units of the model.

    Parameters
    ----------
    dynamics : LinearParameters
        The model, with its delay.
    damping : DampingParameters
    sample_time : float
        [s]
    force : ForceParameters, optional
        The model of the force in the stack.

    Raises
    ------
    ParameterError
        ``damping.…``: the filter cannot run at this sample time, or the inner loop is unstable on the model.
    """
    if damping.source == NOTHING:
        return dynamics
    loop = inner_loop(damping, dynamics, sample_time, force)
    scale = dynamics.output_scale / dynamics.resolved_input_scale
    plant = undamped(dynamics)
    found = loop.around(with_acting(dynamics, plant) if damping.source == FORCE else plant, scale)
    radius = float(np.max(np.abs(found.poles)))
    if not radius < 1.0 - BOUNDARY or not loop.direct > 0.0:
        values = tuple(getattr(damping, damping.type).to_mapping().items())
        given = ", ".join(f"{name} {value}" for name, value in values)
        if radius < 1.0:
            remedy = f"reverses the sign of the plant (γ = {loop.direct:.4g}); lower the gain of the damping"
        else:
            remedy = (
                f"the inner loop is unstable on model.dynamics: largest pole {radius:.6g}, must be below 1; lower the "
                "gain of the damping, or let `hysteresis design --damping` find it"
            )
        raise ParameterError([Problem(f"damping.{damping.type}", given, remedy)])
    return replace(
        dynamics,
        A=tuple(found.A.ravel().tolist()),
        B=tuple(found.B[:, 0].tolist()),
        C=tuple(found.C[0].tolist()),
        D=(),
        input_scale=dynamics.resolved_input_scale,
        sample_time=dynamics.sample_time or sample_time,
        delay=0.0,
    )


# Parameter array: a head, then A (n·n, row by row), B, C and the steady state for an input of 1 (n each).
SOURCE = 0
ORDER = 1
PRELOAD = 2  # offset of the measurement [m]
FORWARD = 3  # γ
THROUGH = 4  # feedthrough of the filter
DIRECT = 5  # b
MATRICES = 6
PARAMETERS = MATRICES + MOST_STATES * (MOST_STATES + 3)

# State array: a head, then n states and n entries of scratch.
STARTED = 0  # 0.0: the next call starts the filter in steady state
OUTPUT = 1  # last output of the law, w [m]
COMMAND_PLACE = 2  # last command, u [m]
FILTERED = 3  # last input of the filter [m] or [N]
STATE = 4
STATES = STATE + 2 * MOST_STATES


@called
def damp(p, x, output, measured, force):
    """Return the command [m] for the law's ``output`` [m], the ``measured`` displacement [m] and ``force`` [N]."""
    if p[SOURCE] == NOTHING:
        return output
    n = int(p[ORDER])
    column = MATRICES + n * n
    filtered = output
    if p[SOURCE] == MEASUREMENT:
        filtered = bounded(measured - p[PRELOAD])
    elif p[SOURCE] == FORCE:
        filtered = force
    if x[STARTED] == 0.0:
        x[STARTED] = 1.0
        for i in range(n):
            x[STATE + i] = p[column + 2 * n + i] * filtered
    command = accumulate(p[FORWARD] * output + p[THROUGH] * filtered, p, column + n, x, STATE, n)
    advance(p, MATRICES, column, x, STATE, n, filtered)
    x[OUTPUT] = output
    x[COMMAND_PLACE] = command
    x[FILTERED] = filtered
    return command


@kernel
def as_output(p, x, command):
    """Return the output of the law [m] that corresponds to ``command`` [m], the achieved value of the last command."""
    if p[SOURCE] == NOTHING:
        return command
    return x[OUTPUT] + (command - x[COMMAND_PLACE]) / p[DIRECT]


class Damping(Block):
    """The damping of a motion controller.

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters, of which ``damping`` and ``model`` are used.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        The filter cannot run at this sample time, or the inner loop is unstable on the model.
    """

    kernel = staticmethod(damp)

    def pack(self, parameters) -> np.ndarray:
        """Return the parameter array, shape (94,)."""
        damping, p = parameters.damping, np.zeros(PARAMETERS)
        p[SOURCE], p[DIRECT] = damping.source, 1.0
        if damping.source == NOTHING:
            return p
        loop = inner_loop(damping, parameters.model.dynamics, self.sample_time, parameters.model.force)
        found = loop.filter
        p[ORDER], p[PRELOAD], p[FORWARD] = found.order, parameters.model.preload.offset, loop.forward
        p[THROUGH], p[DIRECT] = found.D.item(), loop.direct
        rest = solve(np.eye(found.order) - found.A, found.B[:, 0])
        matrices = np.concatenate([found.A.ravel(), found.B[:, 0], found.C[0], rest])
        p[MATRICES : MATRICES + len(matrices)] = matrices
        return p

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample."""
        return np.zeros(STATES)

    @property
    def direct(self) -> float:
        """Change of the command divided by the change of the law's output in the same sample."""
        return float(self.p[DIRECT])

    def retune(self, parameters) -> None:
        """Change the filter, or its kind, while running; the caller must then arm the hand-over behind the damping.

        The states of a filter of the same kind and order continue; they are shifted by the change that the new filter
        causes in their steady state at the present input. A filter of another kind or order starts in its steady state.

        Raises
        ------
        ParameterError
            The parameters are wrong, or the inner loop would be unstable. In this case nothing is changed.
        """
        packed = self.pack(parameters.validated())
        same = parameters.damping.type == self.parameters.damping.type and packed[ORDER] == self.p[ORDER]
        n = int(packed[ORDER])
        rest = slice(MATRICES + n * (n + 2), MATRICES + n * (n + 3))
        if same:
            self.x[STATE : STATE + n] += (packed[rest] - self.p[rest]) * self.x[FILTERED]
        else:
            self.x[:] = 0.0
        self.parameters = parameters
        self.p[:] = packed
