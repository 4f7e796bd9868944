# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The controllers for notebooks: ``hr.controllers.Pid(Kp=…, A=…, B=…, C=…)``, one class per controller."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.control.controller import LAWS, ControllerParameters
from hysteresis_ros.control.law import Controller
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.registry import block_class, class_name, find, samples


class MotionController(Controller):  # numpydoc ignore=PR02
    """A controller from reference and measured displacement [m] to the command [m]; base of ``hr.controllers``.

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    def simulate(self, reference: ArrayLike, measured: ArrayLike) -> np.ndarray:
        """Return the commands of the controller for recorded signals; the state continues from the previous call.

        Parameters
        ----------
        reference : array_like, shape (N,)
            Reference at each sample [m].
        measured : array_like, shape (N,)
            Measured displacement at each sample [m].

        Returns
        -------
        ndarray, shape (N,)
            Command to the compensator [m].

        Raises
        ------
        HysteresisError
            The signals are not arrays of numbers of equal length.
        """
        wanted, seen = samples("reference", reference), samples("measured", measured)
        if wanted.shape != seen.shape:
            raise HysteresisError(f"reference has {wanted.size} samples, measured {seen.size}; give equal numbers")
        return super().simulate(wanted, seen)


def _made(kind: str) -> type[MotionController]:
    law = LAWS[kind]
    others = tuple(f"{name}." for other in LAWS.values() for name in other.groups if name not in law.groups)
    return block_class(
        class_name(kind),
        (MotionController, law.block),
        ControllerParameters,
        module=__name__,
        summary=f"The controller {kind.replace('_', ' ')}: {law.description}. Gains are in the units of its model.",
        fixed={"type": kind},
        own=(kind,),
        hidden=lambda name: name.startswith(others),
        law=law.block,
    )


#: The classes, by name.
CLASSES: dict[str, type[MotionController]] = {class_name(kind): _made(kind) for kind in LAWS}


def __getattr__(name: str) -> type[MotionController]:
    """Return the class of a controller by its name."""
    return find(CLASSES, name, "hysteresis_ros.controllers")


def __dir__() -> list[str]:
    return sorted(CLASSES)
