# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The hysteresis models for notebooks: ``hr.models.BoucWen(d_e=…, alpha=…)``, one class per model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.models.declaration import HysteresisBlock
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.registry import block_class, class_name, samples


class Hysteresis(HysteresisBlock):  # numpydoc ignore=PR02
    """A hysteresis model from voltage [V] to displacement [m]; base class of the classes in ``hr.models``.

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s].
    """

    #: Name of the model in the registry: ``hysteresis.type`` of the parameter files.
    type = ""

    @classmethod
    def example(cls, sample_time: float = 1e-3) -> Hysteresis:
        """Return the model with example parameters for 0 … 100 V.

        Parameters
        ----------
        sample_time : float
            [s]

        Returns
        -------
        Hysteresis
            The model, at rest.
        """
        return cls(MODELS[cls.type].example, sample_time=sample_time)

    def simulate(self, u: ArrayLike) -> np.ndarray:
        """Return the displacements for voltages; the state continues from the previous call.

        Parameters
        ----------
        u : array_like, shape (N,)
            Voltage at each sample [V].

        Returns
        -------
        ndarray, shape (N,)
            Displacement [m].

        Raises
        ------
        HysteresisError
            The voltage is not a one-dimensional array of numbers.
        """
        return super().simulate(samples("voltage", u))


def _made(name: str) -> type[Hysteresis]:
    model = MODELS[name]
    title = model.title[:1].upper() + model.title[1:]
    made: type[Hysteresis] = block_class(
        class_name(name),
        (Hysteresis, model.block),
        model.parameters,
        module="hysteresis_ros.models",
        summary=f"{title}.",
        law=model.block,
    )
    made.type = name
    return made


#: The classes by name.
CLASSES: dict[str, type[Hysteresis]] = {class_name(name): _made(name) for name in MODELS}
