# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The contract of a model in the benchmark, the models of the package behind it, and models from other files."""

from __future__ import annotations

import importlib
import importlib.util
import pathlib
import sys
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.identification import workflow
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.registry import AUTO, USUAL
from hysteresis_ros.laboratory.benchmark import simple_models
from hysteresis_ros.models.hysteresis import MODELS


class Fitted(Protocol):
    """A model after its fit.

    It may have ``parameter_count``, the number of fitted parameters.
    """

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the output under an input, from rest.

        Parameters
        ----------
        input : ndarray, shape (N,)
            In the unit of the data of the fit, with the same sample time.

        Returns
        -------
        ndarray, shape (N,)
            In the unit of the output. Sample k may depend on the inputs up to sample k only.
        """


class Model(Protocol):
    """A model before its fit; it is made without arguments."""

    def fit(self, data: IdentificationData) -> Fitted:
        """Fit the model; it may return itself.

        Parameters
        ----------
        data : IdentificationData
            ``time`` [s], ``input``, ``output``, ``sample_time`` [s], ``input_unit`` and ``output_unit``; a model sees
            nothing else of the recording.

        Returns
        -------
        Fitted
        """


class PackageModel:
    """A model of the package with its default identification."""

    def __init__(self, name: str):
        self.name = name

    def fit(self, data: IdentificationData) -> PackageModel:
        """Identify the model."""
        self.found = workflow.identify(data, self.name)
        self.parameter_count = self.found.identification.fitted
        return self

    def predict(self, input: np.ndarray) -> np.ndarray:
        """Return the prediction [m]."""
        return self.found.predict(input)


#: The simple models to compare with.
SIMPLE: dict[str, Callable[[], Any]] = {
    "line": simple_models.Line,
    "classical_pi": simple_models.ClassicalPrandtlIshlinskii,
    "narx": simple_models.Narx,
    "gru": simple_models.GatedRecurrentUnit,
}
#: The models of a run without ``--model``.
COMPARED = (USUAL, *SIMPLE)


def names() -> tuple[str, ...]:
    """Return the names of all models of the package and of the simple models."""
    return (USUAL, AUTO, *MODELS, *SIMPLE)


def load_model(spec: str):
    """Return a model before its fit.

    Parameters
    ----------
    spec : str
        A name of :func:`names`; or ``module:Class`` or ``path/to/file.py:Class`` of a class with ``fit``.

    Raises
    ------
    HysteresisError
        There is no such model; the message states why.
    """
    if ":" in spec:
        return _foreign(spec)
    if spec in SIMPLE:
        return SIMPLE[spec]()
    if spec not in names():
        raise HysteresisError(
            f"--model {spec}: there are {', '.join(names())}{did_you_mean(spec, names())}; or your own class as "
            "module:Class or file.py:Class"
        )
    return PackageModel(spec)


def _foreign(spec: str):
    place, _, name = spec.rpartition(":")
    try:
        if place.endswith(".py"):
            path = pathlib.Path(place)
            found = importlib.util.spec_from_file_location(f"benchmark_{path.stem}", path)
            assert found is not None and found.loader is not None
            module = importlib.util.module_from_spec(found)
            sys.modules[found.name] = module
            found.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
        model = getattr(module, name)()
    except Exception as error:  # whatever the file of a user raises
        raise HysteresisError(f"--model {spec}: cannot be loaded: {type(error).__name__}: {error}") from None
    if not callable(getattr(model, "fit", None)):
        raise HysteresisError(f"--model {spec}: has no method fit(data); see docs/benchmark.md")
    return model
