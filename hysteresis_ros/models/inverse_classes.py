# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inverses for notebooks: ``hr.inverses.General(model, maximum=120.0)``, one class per inverse."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.declaration import HysteresisBlock
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters
from hysteresis_ros.models.inverses import NAMES
from hysteresis_ros.registry import (
    KeywordError,
    class_name,
    described,
    find,
    from_keywords,
    keywords_of,
    missing,
    samples,
    signature_of,
)

#: Names of classes for which the generated name would be invalid or unclear.
CLASS_NAMES = {"none": "Gain"}


class Inverse(Compensator):  # numpydoc ignore=PR02
    """A hysteresis compensator from commanded displacement [m] to voltage [V]; base class in ``hr.inverses``.

    Parameters
    ----------
    parameters : CompensatorParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    #: Name of the inverse: ``inverse.type`` of the parameter files.
    type = ""

    def simulate(self, displacement: ArrayLike) -> np.ndarray:
        """Return the voltages for commanded displacements; the state continues from the previous call.

        Parameters
        ----------
        displacement : array_like, shape (N,)
            Commanded displacement of the hysteresis element at each sample [m].

        Returns
        -------
        ndarray, shape (N,)
            Voltage within the limits [V].

        Raises
        ------
        HysteresisError
            The displacement is not a one-dimensional array of numbers.
        """
        wanted = samples("displacement", displacement)
        return np.fromiter(map(self.step, wanted.tolist()), dtype=np.float64, count=len(wanted))


def hysteresis_of(model: Any) -> HysteresisParameters:
    """Return the type and the parameters of a hysteresis model in the form of the parameter files.

    Parameters
    ----------
    model : HysteresisBlock or HysteresisParameters
        A model such as ``hr.models.BoucWen(…)``, or the type and the parameters of a model.

    Returns
    -------
    HysteresisParameters
        The type and the parameters of the model.

    Raises
    ------
    KeywordError
        The argument is not a hysteresis model.
    """
    if isinstance(model, HysteresisParameters):
        return model
    if isinstance(model, HysteresisBlock):
        for name, declared in MODELS.items():
            if isinstance(model, declared.block):
                return HysteresisParameters(type=name, **{name: model.parameters})
    raise KeywordError(f"model = {model!r}: must be a hysteresis model, such as hr.models.BoucWen(…)")


def _made(kind: str) -> type[Inverse]:
    name = CLASS_NAMES.get(kind, class_name(kind))
    others = tuple(f"inverse.{other}." for other in NAMES if other != kind)
    rows = keywords_of(
        (
            row
            for row in CompensatorParameters.table()
            if not row.name.startswith(("hysteresis.", *others)) and row.name != "inverse.type"
        ),
        own=("limits",),
    )
    some_model = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": 1e-7}
    required = missing(CompensatorParameters, {"inverse.type": kind, **some_model})

    def __init__(self: Any, model: Any, *, sample_time: float | None = None, **values: Any) -> None:
        hysteresis = hysteresis_of(model)
        fixed = {f"hysteresis.{key}": value for key, value in hysteresis.to_mapping().items()} | {"inverse.type": kind}
        fixed = {key: value for key, value in fixed.items() if _concerns(key, hysteresis.type)}
        period = getattr(model, "sample_time", 1e-3) if sample_time is None else sample_time
        given = from_keywords(name, CompensatorParameters, fixed, rows, values)
        super(made, self).__init__(given, period)

    own_self, given = (inspect.Parameter(word, inspect.Parameter.POSITIONAL_OR_KEYWORD) for word in ("self", "model"))
    period = inspect.Parameter("sample_time", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=float)
    vars(__init__)["__signature__"] = signature_of(rows, required, own_self, given, period)
    document = f"""Compensator with the inverse {kind}.

Parameters
----------
model : Hysteresis or HysteresisParameters
    The compensator's own model of the actuator; its state is separate.
{described(rows, required)}
sample_time : float, optional
    Sample time [s]; by default, the sample time of the model.

Raises
------
ParameterError
    A parameter is missing, mistyped or out of range, or the inverse does not fit the model.
KeywordError
    The parameter does not exist; the message names the nearest one.
"""
    members = {"__init__": __init__, "__doc__": document, "__module__": __name__, "keywords": rows, "type": kind}
    made: Any = type(name, (Inverse,), members)
    return made


def _concerns(name: str, model: str) -> bool:
    """Return whether a dotted name belongs to the chosen model and not to another one."""
    parts = name.split(".")
    return len(parts) < 3 or parts[1] == model


#: The classes by name.
CLASSES: dict[str, type[Inverse]] = {CLASS_NAMES.get(kind, class_name(kind)): _made(kind) for kind in NAMES}


def __getattr__(name: str) -> type[Inverse]:
    """Return the compensator class for an inverse, by its name."""
    return find(CLASSES, name, "hysteresis_ros.inverses")


def __dir__() -> list[str]:
    return sorted(CLASSES)
