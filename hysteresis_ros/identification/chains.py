# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From a fitted hysteresis and what stands behind it to the chain of blocks that the nodes run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.compensation.inverses import InverseParameters
from hysteresis_ros.identification.condensed import condense
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.identified import Identification, PlantModel, grounded
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.linear_stage import LinearStage, fit_stage
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import hysteresis_block

#: The voltage counts as 0 V within this part of its range.
AT_ZERO = 0.002


def chain_of(data, request, hysteresis, part, dynamics, synchronous, offset=0.0) -> PlantModel:
    """Return the chain of a hysteresis that is zero at rest, with the sensor's zero where the recording shows it.

    Parameters
    ----------
    data : IdentificationData
    request : Request
    hysteresis : HysteresisParameters
    part : LinearPart or None
        What stands behind it, where it is known in continuous time.
    dynamics : LinearParameters
        For the sample time of the data.
    synchronous : bool
        A displacement belongs to the voltage of its own sample.
    offset : float
        Constant [m] that the hysteresis does not hold.
    """
    hysteresis, rest = grounded(hysteresis, data.sample_time)
    settled = part is not None and part.settled
    gain = 1.0 if part is None else part.settled_gain
    low, high = data.input_range
    offset = float(offset + rest * gain)
    zero = reading_at_zero(data)
    if zero is not None:
        # the sensor's zero is what it read at 0 V; what the past left there belongs to the hysteresis
        moved = hysteresis.shifted((offset - zero) / gain)
        if moved is not hysteresis:
            hysteresis, offset = moved, zero
    return PlantModel(
        hysteresis=hysteresis,
        creep=CreepParameters() if part is None else part.creep,
        dynamics=dynamics,
        sample_time=data.sample_time,
        # creep never settles within a recording, where the plant starts it settled
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
    """Return what the sensor read at 0 V at the beginning of the recording [m]; None if the voltage was not there.

    Parameters
    ----------
    data : IdentificationData
    """
    away = np.flatnonzero(np.abs(data.input) > AT_ZERO * np.ptp(data.input))
    standing = int(away[0]) if away.size else len(data)
    return float(np.median(data.output[:standing])) if standing else None


def identified(chain: PlantModel, request: Request, found: FittedHysteresis, part: LinearPart) -> Identification:
    """Return the result of an identification, its linear part in figures and words.

    Parameters
    ----------
    chain : PlantModel
    request : Request
    found : FittedHysteresis
    part : LinearPart
    """
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
    """Return the numbers of a linear part, by names with units, and what there is of it, in words.

    Parameters
    ----------
    part : LinearPart
    """
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
    """Fit dynamics of higher order behind the hysteresis; their gain goes to the hysteresis.

    Parameters
    ----------
    data : IdentificationData
    request : Request
        With ``stage``.
    fit : FittedHysteresis
    """
    hysteresis, _ = grounded(fit.hysteresis, data.sample_time)
    skip = request.skip if request.skip is not None else automatic_skip(data)
    request.progress(0, request.stage)
    moved = hysteresis_block(hysteresis, data.sample_time).simulate(data.input)
    initial = request.initial or "estimate"
    found: LinearStage = fit_stage(
        moved, data.output, data.sample_time, request.stage, skip, request.intersample, initial
    )
    chain = chain_of(data, request, hysteresis.scaled(found.gain), None, found.dynamics, False, found.offset)
    chain = replace(chain, initial=initial, transfer_function=found.transfer_function)
    return Identification(
        model=request.model,
        linear=request.stage,
        chain=chain,
        fitted=fit.fitted + found.fitted,
        numbers=found.numbers,
        deviations=dict(fit.deviations),
        warnings=(*fit.warnings, *(f"linear part: {text}" for text in found.warnings)),
        converged=fit.converged and found.converged,
    )


def automatic_skip(data: IdentificationData) -> int:
    """Return how many samples pass before the voltage has been near both ends of its range and the past is wiped out.

    Parameters
    ----------
    data : IdentificationData
    """
    found = condense(data.input, data.output, data.sample_time)
    return found.first * found.factor
