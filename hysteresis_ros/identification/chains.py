# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Conversion of a fitted hysteresis and the dynamics behind it to the chain of blocks that the nodes run.

Lag, delay, modes and creep are fitted together with the hysteresis; other dynamics of second and higher order
(:data:`STAGES`) are fitted here, behind a hysteresis that is already identified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.arx import ArxOrders, fit_arx, suggest_arx_orders
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.frequency_response import welch_response
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.linear_systems import FitError, LinearModel
from hysteresis_ros.identification.matrix_fraction import identify_matrix_fraction
from hysteresis_ros.identification.plant_model import FittedHysteresis, Identification, PlantModel, Request, grounded
from hysteresis_ros.identification.preprocessing import condense
from hysteresis_ros.identification.transfer_function import Structure, fit_transfer_function
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.linear import LinearParameters

#: Poles and zeros of the named continuous models.
CONTINUOUS = {"first_order": (1, 0), "second_order": (2, 0), "second_order_zero": (2, 1), "third_order": (3, 0)}
#: All stages, with descriptions.
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
    """Dynamics of unit DC gain, and their separated gain."""

    dynamics: LinearParameters
    gain: float  #: gain, offset: Output = gain · dynamics(w) + offset, in SI units.
    offset: float
    fitted: int  #: Fitted numbers.
    numbers: dict[str, float]  #: Figures for the user, by names with units.
    transfer_function: tuple[tuple[float, ...], tuple[float, ...]] | None = None  #: With unit DC gain.
    warnings: tuple[str, ...] = ()
    converged: bool = True


def fit_stage(
    w, y, sample_time: float, kind: str, skip: int = 0, intersample: str = "zoh", initial: str = "zero"
) -> LinearStage:
    """Fit the dynamics between the output of the hysteresis and the measurement.

    Units: ``w`` [m], ``y`` [m], ``sample_time`` [s].
    """
    if kind in CONTINUOUS:
        return _continuous_stage(w, y, sample_time, kind, skip, intersample, initial)
    if kind in ("arx", "arx2"):
        w, y = np.asarray(w, dtype=float)[skip:], np.asarray(y, dtype=float)[skip:]
        orders = ArxOrders(2, 2, 1) if kind == "arx2" else suggest_arx_orders(w, y, sample_time, offset=True)
        found = fit_arx(w, y, sample_time, orders, offset=True)
        model, offset = found.model, found.offset / float(np.sum(found.denominator))
        numbers = {**dict(zip(("na", "nb", "delay_samples"), map(float, orders), strict=True)), "fpe_m2": found.fpe}
        return _unit_stage(model, offset, sum(orders[:2]) + 1, numbers, None, found.warnings)
    if kind == "frequency_response":
        w, y = np.asarray(w, dtype=float)[skip:], np.asarray(y, dtype=float)[skip:]
        fraction = identify_matrix_fraction(welch_response(w, y, sample_time))
        model = fraction.model
        offset = float(np.mean(y) - model.dc_gain * np.mean(w))
        numbers = {"order": float(model.order)}
        return _unit_stage(model, offset, 2 * model.order + 1, numbers, None, tuple(fraction.warnings))
    raise IdentificationError(f"linear = {kind!r}: must be one of {', '.join(STAGES)}")


def _continuous_stage(w, y, sample_time, kind, skip, intersample, initial):
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
    return _unit_stage(found.discrete(), found.offset, count, numbers, function, found.warnings, found.converged)


def _unit_stage(model: LinearModel, offset, fitted, numbers, function, warnings, converged=True):
    gain = float(model.dc_gain)
    if not gain > 0.0:
        raise FitError(f"the DC gain of the linear fit is {gain:.3g}: the output moves against the input")
    dynamics = model.linear_parameters()
    return LinearStage(dynamics, gain, float(offset), fitted, numbers, function, tuple(warnings), converged)


#: The voltage counts as 0 V within this part of its range.
AT_ZERO = 0.002


def chain_of(data, request, hysteresis, part, dynamics, synchronous, offset=0.0) -> PlantModel:
    """Return the chain of a hysteresis that is zero at rest, with the sensor's zero if the recording shows it."""
    hysteresis, rest = grounded(hysteresis, data.sample_time)
    settled = part is not None and part.settled
    gain = 1.0 if part is None else part.settled_gain
    low, high = data.input_range
    offset = float(offset + rest * gain)
    zero = reading_at_zero(data)
    if zero is not None:
        # the sensor's zero is its reading at 0 V; a remanent displacement belongs to the hysteresis
        moved = hysteresis.shifted((offset - zero) / gain)
        if moved is not hysteresis:
            hysteresis, offset = moved, zero
    return PlantModel(
        hysteresis=hysteresis,
        creep=CreepParameters() if part is None else part.creep,
        dynamics=dynamics,
        sample_time=data.sample_time,
        # the plant starts with settled creep, but creep never settles within a recording
        offset=offset,
        linear_part=part,
        synchronous=bool(synchronous),
        initial=request.initial or ("estimate" if settled else "zero"),
        intersample=request.intersample,
        voltage_low=low,
        voltage_high=high,
        inverse=InverseParameters(type=request.inverse),
    )


def reading_at_zero(data: IdentificationData) -> float | None:
    """Return the reading at 0 V at the beginning of the recording [m]; None if the voltage was not 0 V there."""
    away = np.flatnonzero(np.abs(data.input) > AT_ZERO * np.ptp(data.input))
    standing = int(away[0]) if away.size else len(data)
    return float(np.median(data.output[:standing])) if standing else None


def identified(chain: PlantModel, request: Request, found: FittedHysteresis, part: LinearPart) -> Identification:
    """Return the result of an identification, with its linear part as figures and text."""
    numbers, words = described(part)
    return Identification(
        model=request.model,
        linear=", ".join(words) or "none",
        chain=chain,
        fitted=found.fitted + len(words) + 3 * len(part.modes),
        numbers=numbers,
        deviations=dict(found.deviations),
        warnings=tuple(found.warnings),
        converged=found.converged,
    )


def described(part: LinearPart) -> tuple[dict[str, float], list[str]]:
    """Return the figures of a linear part, by names with units, and its description."""
    numbers = {}
    words = []
    if part.lag > 0.0:
        numbers["lag_s"] = part.lag
        words.append("lag")
    if part.delay > 0.0:
        numbers["delay_s"] = part.delay
        words.append("delay")
    for number, mode in enumerate(sorted(part.modes, key=lambda mode: mode.frequency), start=1):
        numbers |= {f"mode_{number}_hz": mode.frequency, f"mode_{number}_damping": mode.damping}
    if part.modes:
        words.append("1 mode" if len(part.modes) == 1 else f"{len(part.modes)} modes")
    if part.creep.type != "none":
        numbers["creep_rate_per_decade"] = part.creep_rate
        words.append("creep")
    return numbers, words


def with_stage(data: IdentificationData, request: Request, fit: FittedHysteresis) -> Identification:
    """Fit dynamics of higher order behind the hysteresis; their gain goes to the hysteresis."""
    stage = request.stage
    if stage is None:
        raise IdentificationError("no stage is named: give one of the linear stages")
    hysteresis, _ = grounded(fit.hysteresis, data.sample_time)
    skip = request.skip if request.skip is not None else automatic_skip(data)
    request.progress(0, stage)
    moved = hysteresis_block(hysteresis, data.sample_time).simulate(data.input)
    initial = request.initial or "estimate"
    found: LinearStage = fit_stage(moved, data.output, data.sample_time, stage, skip, request.intersample, initial)
    chain = chain_of(data, request, hysteresis.scaled(found.gain), None, found.dynamics, False, found.offset)
    chain = replace(chain, initial=initial, transfer_function=found.transfer_function)
    return Identification(
        model=request.model,
        linear=stage,
        chain=chain,
        fitted=fit.fitted + found.fitted,
        numbers=found.numbers,
        deviations=dict(fit.deviations),
        warnings=(*fit.warnings, *(f"linear part: {text}" for text in found.warnings)),
        converged=fit.converged and found.converged,
    )


def automatic_skip(data: IdentificationData) -> int:
    """Return the number of samples until the voltage has been near both ends of its range, which erases the past."""
    found = condense(data.input, data.output, data.sample_time)
    return found.first * found.factor
