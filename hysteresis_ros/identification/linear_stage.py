# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamics of second and higher order behind a hysteresis that was identified before them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.frequency_response import welch_response
from hysteresis_ros.identification.least_squares import ArxOrders, fit_arx, suggest_arx_orders
from hysteresis_ros.identification.matrix_fraction import identify_matrix_fraction
from hysteresis_ros.identification.output_error import fit_transfer_function
from hysteresis_ros.identification.state_space import FitError, LinearModel
from hysteresis_ros.identification.transfer_function import Structure
from hysteresis_ros.models.linear import LinearParameters

#: Poles and zeros of the named continuous models.
CONTINUOUS = {"first_order": (1, 0), "second_order": (2, 0), "second_order_zero": (2, 1), "third_order": (3, 0)}
#: All stages, and what each is.
STAGES = {
    "first_order": "continuous, 1 pole, by output error",
    "second_order": "continuous, 2 poles (mass, damper, spring), by output error",
    "second_order_zero": "continuous, 2 poles and 1 zero, by output error",
    "third_order": "continuous, 3 poles, by output error",
    "arx": "discrete, orders chosen by an information criterion, least squares",
    "arx2": "discrete, a1 a2 b0 b1, least squares",
    "frequency_response": "discrete, order chosen, matrix fraction on Welch's frequency response",
}


@dataclass(frozen=True, eq=False)
class LinearStage:
    """Dynamics of unit DC gain, and the gain taken out of them.

    Parameters
    ----------
    dynamics : LinearParameters
    gain, offset : float
        Output = gain · dynamics(w) + offset, in SI units.
    fitted : int
        Fitted numbers.
    numbers : dict of str to float
        What is worth printing.
    transfer_function : (tuple of float, tuple of float), optional
        Of unit DC gain.
    warnings : tuple of str
    converged : bool
    """

    dynamics: LinearParameters
    gain: float
    offset: float
    fitted: int
    numbers: dict[str, float]
    transfer_function: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    warnings: tuple[str, ...] = ()
    converged: bool = True


def fit_stage(
    w, y, sample_time: float, kind: str, skip: int = 0, intersample: str = "zoh", initial: str = "zero"
) -> LinearStage:
    """Fit the dynamics between what the hysteresis puts out and what is measured.

    Parameters
    ----------
    w : array_like, shape (N,)
        Output of the hysteresis [m] (or the voltage).
    y : array_like, shape (N,)
        Measured displacement [m].
    sample_time : float
        [s]
    kind : str
        A name of :data:`STAGES`.
    skip : int
        First samples left out of the error.
    intersample, initial : str
        Of continuous models.

    Raises
    ------
    FitError
        No stable model of positive DC gain comes out, or the choice is unknown.
    DataError
        The data cannot be used.
    """
    if kind in CONTINUOUS:
        return _continuous(w, y, sample_time, kind, skip, intersample, initial)
    if kind in ("arx", "arx2"):
        w, y = np.asarray(w, dtype=float)[skip:], np.asarray(y, dtype=float)[skip:]
        orders = ArxOrders(2, 2, 1) if kind == "arx2" else suggest_arx_orders(w, y, sample_time, offset=True)
        found = fit_arx(w, y, sample_time, orders, offset=True)
        model, offset = found.model, found.offset / float(np.sum(found.denominator))
        numbers = {**dict(zip(("na", "nb", "delay_samples"), map(float, orders), strict=True)), "fpe_m2": found.fpe}
        return _stage(model, offset, sum(orders[:2]) + 1, numbers, None, found.warnings)
    if kind == "frequency_response":
        w, y = np.asarray(w, dtype=float)[skip:], np.asarray(y, dtype=float)[skip:]
        found = identify_matrix_fraction(welch_response(w, y, sample_time))
        model = found.model
        offset = float(np.mean(y) - model.dc_gain * np.mean(w))
        numbers = {"order": float(model.order)}
        return _stage(model, offset, 2 * model.order + 1, numbers, None, tuple(found.warnings))
    raise IdentificationError(f"linear = {kind!r}: must be one of {', '.join(STAGES)}")


def _continuous(w, y, sample_time, kind, skip, intersample, initial):
    poles, zeros = CONTINUOUS[kind]
    found = fit_transfer_function(
        w, y, sample_time, Structure(poles, zeros, intersample, initial, offset=True), skip=skip
    )
    numbers = {}
    for number, pole in enumerate(sorted(found.poles, key=abs)):
        if pole.imag >= 0.0:
            numbers[f"pole_{number + 1}_hz"] = float(abs(pole) / (2.0 * np.pi))
            numbers[f"pole_{number + 1}_damping"] = float(-pole.real / abs(pole))
    if not found.dc_gain > 0.0:
        raise FitError(f"the DC gain of the linear fit is {found.dc_gain:.3g}: the output moves against the input")
    function = (
        tuple((np.asarray(found.numerator) / found.dc_gain).tolist()),
        tuple(np.asarray(found.denominator).tolist()),
    )
    count = poles + zeros + 2
    return _stage(found.discrete(), found.offset, count, numbers, function, found.warnings, found.converged)


def _stage(model: LinearModel, offset, fitted, numbers, function, warnings, converged=True):
    gain = float(model.dc_gain)
    if not gain > 0.0:
        raise FitError(f"the DC gain of the linear fit is {gain:.3g}: the output moves against the input")
    dynamics = model.linear_parameters()
    return LinearStage(dynamics, gain, float(offset), fitted, numbers, function, tuple(warnings), converged)
