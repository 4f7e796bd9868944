# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Declaration of a hysteresis model, and base classes of rate-independent models.

A model is one file, or one folder, in ``models/hysteresis``. The file contains the parameters, the law and ``MODEL``, a
:class:`HysteresisModel`; the registry of :mod:`hysteresis_ros.models.hysteresis` finds the model. ``docs/extending.md``
shows an example.

A rate-independent model depends only on the order of the voltages, not on their speed. Its kernel takes the voltage at
the end of a monotone step and returns the displacement at that voltage.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from hysteresis_ros.configuration import ParameterRow, Parameters
from hysteresis_ros.errors import IdentificationError, ParameterError, Problem, did_you_mean
from hysteresis_ros.models.block import Block

#: Parts of the linear model that can be identified together with a hysteresis.
PARTS = ("lag", "delay", "creep", "modes")
#: Index of the last output in the state of every model with memory.
DISPLACEMENT_PLACE = 1
#: Value in place of an index, for an entry that the parameters or the state do not have.
NOWHERE = -1
#: Default identification: fits the parameters that a model declares in ``free``, starting at the model's ``guess``.
PARAMETRIC = "hysteresis_ros.identification.procedures:parametric"


@dataclass(frozen=True)
class LinearTerms:
    """Indices for a model that is linear in its weights: the sum Σ p[weight] x[signal] passes through dead zones.

    Parameters
    ----------
    weights : tuple of int
        Indices of the weights in p.
    signals : tuple of int
        Index in x of the signal that each weight multiplies [V]; ``NOWHERE``: the weight multiplies the output voltage.
    opening : tuple of bool
        True for each weight that widens the loops: its signal lags behind the voltage.
    zones : tuple of (int, int)
        Indices in p of threshold [m] and slope of each dead zone after the sum; the thresholds scale with the gain.
    output : int
        Index in x of the last output [m]; ``NOWHERE``: the output is not stored.
    offset : int
        Index in p of the constant part of the output [m]; ``NOWHERE``: there is no such part.
    """

    weights: tuple[int, ...]
    signals: tuple[int, ...]
    opening: tuple[bool, ...]
    zones: tuple[tuple[int, int], ...] = ()
    output: int = DISPLACEMENT_PLACE
    offset: int = NOWHERE


class HysteresisBlock(Block):
    """Base class of the blocks of all hysteresis models, from voltage [V] to displacement [m].

    Subclasses set ``kernel`` and, for a closed form, ``inverse``; they implement ``pack``, ``initial_state``, ``gain``
    and, if the model has memory, ``rebase``.

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    #: Closed-form inverse: a kernel with the arguments of every inverse; None if there is no such inverse.
    inverse = None  # type: Any
    #: Whether the output depends only on the order of the voltages, not on their speed.
    rate_independent = False
    #: Whether, for any history, the output at the end of a step increases with the voltage at the end. Then the model
    #: has an inverse, and linear dynamics follow the hysteresis and are not inside it.
    invertible = False

    @property
    def terms(self) -> LinearTerms | None:
        """Indices of the weights in which the output is linear; None if there are no such weights."""
        return None

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]."""
        raise TypeError(f"{type(self).__name__} does not define gain, its nominal gain")

    def rebase(self) -> None:
        """Continue from the present point after a change of parameters; the default does nothing."""


#: Largest number of plays; a fit with more needs too much memory.
MOST_PLAYS = 1000
#: Largest number of cells on each side of a Preisach map; a fit with more needs too much memory.
MOST_CELLS = 500


@dataclass(frozen=True)
class Option:
    """One option of an identification.

    Parameters
    ----------
    kind : type
        int, float or str.
    description : str
    choices : tuple of str
        Allowed values of a str.
    low, high : float, optional
        Range of a number, both ends allowed.
    """

    kind: type
    description: str
    choices: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None

    def convert(self, name: str, text: str):
        """Return the value of ``text``.

        Raises
        ------
        IdentificationError
            The text is not an allowed value; the message states the allowed values.
        """
        try:
            value = self.kind(text)
        except ValueError:
            kind = "a whole number" if self.kind is int else "a number"
            raise IdentificationError(f"option {name} = {text!r}: must be {kind}") from None
        if self.choices and value not in self.choices:
            near = did_you_mean(value, self.choices)
            raise IdentificationError(f"option {name} = {text!r}: must be one of {', '.join(self.choices)}{near}")
        if isinstance(value, float) and not math.isfinite(value):
            raise IdentificationError(f"option {name} = {text!r}: must be finite")
        if self.low is not None and value < self.low:
            raise IdentificationError(f"option {name} = {text!r}: must be {self.low:g} or more")
        if self.high is not None and value > self.high:
            raise IdentificationError(f"option {name} = {text!r}: must be {self.high:g} or less")
        return value


@dataclass(frozen=True)
class Deviation:
    """Deviation of a plant from its model, as factors near 1.

    Parameters
    ----------
    gain : float
        Factor on the displacement.
    opening : float
        Factor on the loop width.
    factor : callable
        ``factor()`` returns one more random factor, ``factor(n)`` an array of n random factors.
    """

    gain: float
    opening: float
    factor: Callable[..., Any]


@dataclass(frozen=True)
class OwnInverse:
    """An inverse that a model declares in addition to the closed form of its block; selected by ``inverse.type``.

    Parameters
    ----------
    kernel : kernel
        ``inverse(hysteresis, p_i, x_i, p_h, x_h, displacement)``; the kernel does not use ``hysteresis``.
    description : str
        Short description for the table of parameters.
    follows_model : bool
        True: the inverse uses the state of this model and works with no other model. False: it has an equation of its
        own, given by ``parameters`` and ``block``, and works with any model.
    parameters : type, optional
        Dataclass of the parameters of the inverse, ``inverse.<name>.*``.
    block : type, optional
        Block for these parameters; its ``p`` and ``x`` are the kernel's arguments ``p_i`` and ``x_i``.
    """

    kernel: Callable
    description: str
    follows_model: bool = True
    parameters: type[Parameters] | None = None
    block: type[Block] | None = None


@dataclass(frozen=True, kw_only=True)
class HysteresisModel:
    """Declaration of a hysteresis model.

    Parameters
    ----------
    name : str
        ``hysteresis.type`` in the parameter files, and prefix of the model's parameters there.
    title : str
        Description in one line.
    data : str
        Data that an identification of the model needs.
    parameters : type
        Dataclass of the model's parameters. If it has arrays of variable length, it has a property ``structure``: a
        dict of name to size; the sizes are fixed while running.
    block : type
        Block with the law of the model and its closed-form inverse, if any. The block states whether the model is rate
        independent and invertible.
    example : Parameters
        Example parameters for 0 … 100 V; ``hysteresis models NAME --yaml`` writes an axis with them.
    scaled : callable
        ``scaled(parameters, factor)`` returns parameters with which the displacement is multiplied by ``factor`` > 0.
    shifted : callable, optional
        ``shifted(parameters, offset)`` returns parameters with which the displacement is larger by ``offset`` [m].
        None: the model has no constant term.
    deviated : callable
        ``deviated(parameters, deviation)`` returns the parameters of a plant that deviates by a :class:`Deviation`.
    weighted : callable, optional
        ``weighted(parameters, factors)`` returns parameters with the weights multiplied by the factors, in the order of
        the block's ``terms``. None: the output is not linear in weights, so they cannot be adapted online.
    inverses : tuple of str
        Names of the inverses that work with the model; the first one is the default.
    own_inverses : dict of str to OwnInverse
        Inverses that the model declares itself.
    identify : str
        Dotted path ``package.module:function`` of ``identify(data, request)``, see
        :mod:`hysteresis_ros.identification.procedures`. By default, least squares fit the parameters in ``free``.
    guess : callable, optional
        ``guess(voltage, displacement)`` returns the initial parameters for the default fit.
    free : tuple of str
        Names of the scalar parameters that the default fit changes.
    options : dict of str to Option
        Options of the identification. For the default fit, these are the initial values of its free parameters.
    parts : tuple of str
        Entries of :data:`PARTS` that can be identified together with the model.
    stages : bool
        Whether linear dynamics of higher order can be identified after the hysteresis.
    response : str
        For models with internal dynamics, which are not invertible: dotted path of the function ``response(parameters,
        voltage, sample_time, intersample, initial)`` that returns the displacement [m] at the samples.
    """

    name: str
    title: str
    data: str
    parameters: type[Parameters]
    block: type[HysteresisBlock]
    example: Parameters
    scaled: Callable[[Any, float], Parameters]
    deviated: Callable[[Any, Deviation], Parameters]
    inverses: tuple[str, ...]
    shifted: Callable[[Any, float], Parameters] | None = None
    weighted: Callable[[Any, Any], Parameters] | None = None
    own_inverses: dict[str, OwnInverse] = field(default_factory=dict)
    identify: str = PARAMETRIC
    guess: Callable[[Any, Any], Parameters] | None = None
    free: tuple[str, ...] = ()
    options: dict[str, Option] = field(default_factory=dict)
    parts: tuple[str, ...] = PARTS
    stages: bool = True
    response: str = ""

    def __post_init__(self):
        """Refuse an incomplete declaration."""
        if self.identify == PARAMETRIC:
            if self.guess is None or not self.free:
                raise TypeError(f"{self.name}: must declare guess and free, or identify")
            initial = {row.name: row for row in self.rows() if row.type is float}
            if not set(self.free) <= set(initial):
                raise TypeError(
                    f"{self.name}: free = {self.free}: must be names of scalar parameters: {', '.join(initial)}"
                )
            options = {name: Option(float, f"initial value{_unit(initial[name])}") for name in self.free}
            object.__setattr__(self, "options", options)
        if not self.block.invertible and not self.response:
            raise TypeError(f"{self.name} has internal dynamics: declare response, which predicts its displacement")

    def rows(self) -> list[ParameterRow]:
        """Return the rows of the table of the model's parameters."""
        return self.parameters.table()


def _unit(row: ParameterRow) -> str:
    return f" [{row.unit}]" if row.unit else ""


def times(parameters, factor: float, *names: str):
    """Return parameters in which the values ``names`` (numbers or tuples of numbers) are multiplied by a factor."""
    changed: dict[str, Any] = {}
    for name in names:
        value = getattr(parameters, name)
        changed[name] = tuple(item * factor for item in value) if isinstance(value, tuple) else value * factor
    return replace(parameters, **changed)


def plus(parameters, offset: float, *names: str):
    """Return parameters in which the values ``names`` are increased by an offset."""
    return replace(parameters, **{name: getattr(parameters, name) + offset for name in names})


# the first two entries of x in every model with memory
VOLTAGE = 0  # voltage at the last step [V]
DISPLACEMENT = DISPLACEMENT_PLACE  # the last output [m]


def require_structure(present, wanted) -> None:
    """Raise ParameterError if the structure of parameters (sizes of arrays) differs from the present one.

    Both must be of the same class. A class with arrays of variable length has a ``structure``: a dict of name to size.
    """
    before, after = getattr(present, "structure", {}), getattr(wanted, "structure", {})
    problems = [
        Problem(name, after.get(name), f"is fixed while running: keep {size}; another size needs a new configuration")
        for name, size in before.items()
        if after.get(name) != size
    ]
    if problems:
        raise ParameterError(problems)


class InvertibleBlock(HysteresisBlock):
    """Base class of the models with memory whose output at the end of a step increases with the voltage at the end.

    Their parameters can change while running without a jump of the output, and they have inverses.

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    invertible = True

    def retune(self, parameters) -> None:
        """Change to parameters of the same structure while running; the output does not change.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; the block then remains unchanged.
        """
        require_structure(self.parameters, parameters.validated())
        super().retune(parameters)
        self.rebase()


class RateIndependentBlock(InvertibleBlock):
    """Base class of the rate-independent hysteresis models, from voltage [V] to displacement [m].

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s]; not used by the model itself.
    """

    rate_independent = True
