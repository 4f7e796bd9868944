# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Least-squares fit of the free parameters that a hysteresis model declares, from the guess that it declares.

The model is simulated by the kernel of the nodes under the recorded voltage; trust-region steps within the ranges of
the parameters, with sensitivities by finite differences, lower the output error. A constant of the output is left free.
What the parameters refuse together (their ``check``) counts as a large error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.errors import HysteresisError, IdentificationError, ParameterError
from hysteresis_ros.identification.identified import Identification
from hysteresis_ros.identification.remanent_past import remembered
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.identification.separation import Separated, separated
from hysteresis_ros.identification.static_procedures import static_result
from hysteresis_ros.identification.validation import parameter_covariance
from hysteresis_ros.models.declaration import HysteresisModel
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters
from hysteresis_ros.parameters import Parameters
from hysteresis_ros.units import readable

#: Parameters that are refused count as an error of this many strokes everywhere.
REFUSED = 10.0
#: Most evaluations of the model for each free parameter.
MOST_EVALUATIONS = 200
#: Relative step of the finite differences: with the square root of the rounding, kinks of a model would show as noise.
STEP = 1e-6


def identify(data, request: Request) -> Identification:
    """Identify a model with ``guess`` and ``free`` on data whose lag and creep were undone.

    Parameters
    ----------
    data : IdentificationData
    request : Request
        Its options are initial values of free parameters.

    Raises
    ------
    IdentificationError
        The initial values are not allowed.
    """
    model = MODELS[request.model]
    static = separated(data, request)
    try:
        start = replace(model.guess(static.voltage, static.displacement), **request.options).validated()
    except ParameterError as error:
        raise IdentificationError(f"initial values of {model.name}: {error}") from None

    def fit(other: Separated, before):
        search = _Search(model, other)
        return search, search.run(before[1][0] if before else start, request.progress)

    (search, (found, deviations, offset, converged)), static = remembered(
        static, fit, lambda found: model.block(found[1][0], 1.0)
    )
    hysteresis = HysteresisParameters(type=model.name, **{model.name: found})
    fit = FittedHysteresis(hysteresis, len(model.free) + 1, deviations, search.warnings, converged)
    return static_result(data, request, fit, static, offset)


class _Search:
    """The search on one recording: free parameters, each divided by its size at the start."""

    def __init__(self, model: HysteresisModel, static: Separated):
        self.model, self.first = model, len(static.history)
        self.voltage, self.displacement = np.concatenate([static.history, static.voltage]), static.displacement
        self.stroke = float(np.ptp(self.displacement))
        self.evaluations = 0
        self.warnings: tuple[str, ...] = ()

    def error(self, parameters: Parameters) -> np.ndarray:
        """Return the predicted less the measured displacement [m], with its mean."""
        try:
            predicted = self.model.block(parameters, 1.0).simulate(self.voltage)
        except ParameterError:
            return np.full(self.displacement.size, REFUSED * self.stroke)
        error = predicted[self.first :] - self.displacement
        return np.nan_to_num(error, nan=REFUSED * self.stroke, posinf=REFUSED * self.stroke, neginf=-self.stroke)

    def run(self, start: Parameters, progress):
        """Return the parameters, their standard deviations, the constant [m] and whether the search converged."""
        from scipy.optimize import least_squares  # imported here because only fits need it

        names, rows = self.model.free, {row.name: row for row in self.model.rows()}
        first = np.array([getattr(start, name) for name in names], dtype=float)
        size = np.where(first != 0.0, np.abs(first), 1.0)
        low = np.array([-np.inf if rows[name].low is None else rows[name].low for name in names]) / size
        high = np.array([np.inf if rows[name].high is None else rows[name].high for name in names]) / size

        def at(values) -> Parameters:
            within = np.clip(np.asarray(values), low, high) * size
            return replace(start, **dict(zip(names, within.tolist(), strict=True)))

        def residual(values):
            self.evaluations += 1
            error = self.error(at(values)) / self.stroke
            error -= 0.0 if np.all(error == REFUSED) else error.mean()
            progress(self.evaluations, f"residual {readable(self.stroke * float(np.std(error)), 'm')}")
            return error

        found = least_squares(
            residual,
            np.clip(first / size, low, high),
            bounds=(low, high),
            x_scale="jac",
            diff_step=STEP,
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
            max_nfev=MOST_EVALUATIONS * len(names),
        )
        self.warnings = tuple(
            f"{name} lies at the end of its range" for name, side in zip(names, found.active_mask, strict=True) if side
        )
        parameters = at(found.x)
        offset = -float(self.error(parameters).mean())
        return parameters, self._deviations(found, size), offset, bool(found.status > 0)

    def _deviations(self, found, size) -> dict[str, float]:
        try:
            covariance = parameter_covariance(found.jac, found.fun)
        except HysteresisError as error:
            self.warnings += (f"the parameters are not determined: {error}",)
            return {}
        return dict(zip(self.model.free, (np.sqrt(np.diag(covariance)) * size).tolist(), strict=True))
