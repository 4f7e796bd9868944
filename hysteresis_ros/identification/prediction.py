# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Predictions of an identified plant: the displacement for a voltage, and the voltage for a displacement.

The kernels of the nodes simulate the chain, without limits and sensor. With ``zoh`` (a held voltage, as from a
converter) the result equals the measurement of the plant node sample by sample. ``linear`` and ``bandlimited`` assume a
linear or band-limited input between the samples, as for a sampler with its own clock.

The validation of the inverse computes the voltage from the measured displacement and compares it with the applied
voltage. A smoothed derivative inverts the lag (it uses later samples, because this runs offline); the compensator of
the nodes inverts creep and hysteresis. The voltage errors are the errors of the model divided by its local slope.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError, ParameterError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.linear_systems import (
    BANDLIMITED_POINTS,
    METHODS,
    CanonicalSimulation,
    LinearModel,
    simulate_transfer_function,
    undo,
    upsample,
)
from hysteresis_ros.identification.plant_model import PlantModel, pass_through, simulate_chain
from hysteresis_ros.identification.preprocessing import remanent_voltage, wiped_out
from hysteresis_ros.identification.thresholds import PAST_WHILE_PREDICTING
from hysteresis_ros.identification.validation import Validation, validate
from hysteresis_ros.models.compensator import Compensator, CompensatorParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.registry import resolved

#: The voltage may exceed the range of the identification by this fraction of the range on each side.
VOLTAGE_MARGIN = 0.1


@dataclass(frozen=True, eq=False)
class InverseValidation:
    """Result of :func:`recover_voltage`."""

    voltage: np.ndarray  #: shape (N,); Recovered voltage [V].
    error: np.ndarray  #: shape (N - skip,); Recovered minus applied voltage [V].
    rmse: float  #: [V]
    rmse_displacement: float  #: RMS of the voltage error times the model's nominal gain [m].
    rmse_percent: float  #: RMS of the voltage error in % of the range of the applied voltage.


def recover_voltage(
    plant: PlantModel, displacement, voltage, skip: int = 0, free_offset: bool = True
) -> InverseValidation:
    """Invert the model for a measured displacement, and compare with the applied voltage.

    Units: ``displacement`` [m], ``voltage`` [V].
    """
    y, v = (np.ascontiguousarray(values, dtype=np.float64) for values in (displacement, voltage))
    v = v if plant.saturation is None else np.clip(v, *plant.saturation)
    if free_offset:
        y = y - np.mean((y - plant.simulate(v))[skip:])
    wanted = undo(y, plant.continuous, plant.sample_time)
    margin = VOLTAGE_MARGIN * (plant.voltage_high - plant.voltage_low)
    parameters = CompensatorParameters(
        inverse=InverseParameters(type="general"),
        hysteresis=plant.hysteresis,
        creep=plant.creep,
        limits=LimitsParameters(
            minimum=min(plant.voltage_low, 0.0) - margin, maximum=max(plant.voltage_high, 0.0) + margin
        ),
    )
    compensator = Compensator(parameters, plant.sample_time)
    found = compensator.simulate(wanted)
    error = (found - v)[skip:]
    rmse = float(np.sqrt(np.mean(error**2)))
    gain = compensator.hysteresis.gain
    return InverseValidation(found, error, rmse, rmse * gain, 100.0 * rmse / float(np.ptp(v[skip:])))


#: Allowed initial states of a prediction.
INITIAL = ("zero", "periodic", "estimate")
#: Largest relative difference of equal sample times.
SAME_RATE = 1e-4
#: Largest number of states whose free responses can be distinguished from one another.
MOST_FREE = 12


def predict(
    chain: PlantModel,
    voltage,
    sample_time: float,
    intersample: str | None = None,
    initial: str | None = None,
    measured=None,
) -> np.ndarray:
    """Return the predicted displacement [m], shape (N,), at the samples of the voltage.

    Units: ``voltage`` [V], ``sample_time`` [s].
    """
    intersample, initial = intersample or chain.intersample, initial or chain.initial
    if intersample not in METHODS or initial not in INITIAL:
        raise IdentificationError(
            f"intersample = {intersample!r}, initial = {initial!r}: intersample must be one of {', '.join(METHODS)}; "
            f"initial must be one of {', '.join(INITIAL)}"
        )
    voltage = np.ascontiguousarray(voltage, dtype=np.float64)
    if chain.saturation is not None:
        voltage = np.clip(voltage, *chain.saturation)
    if not chain.invertible:
        if initial == "estimate":
            raise IdentificationError("initial = 'estimate': an oscillator needs zero or periodic; choose one")
        response = resolved(chain.hysteresis.model.response)
        return response(chain.hysteresis.chosen, voltage, sample_time, intersample, initial) + chain.offset
    chain = at_rate(chain, sample_time)
    if initial == "periodic":
        twice = np.concatenate([voltage, voltage])
        return _forced(chain, twice, intersample, True)[voltage.size :] + chain.offset
    if initial != "estimate" or measured is None:
        return _forced(chain, voltage, intersample, initial == "estimate") + chain.offset
    measured = np.asarray(measured, dtype=float)
    history = _estimated_history(chain, voltage, intersample, measured)
    forced = _forced(chain, voltage, intersample, True, history) + chain.offset
    return forced + _free_response(chain, measured - forced)


def predict_after(chain: PlantModel, voltage, intersample: str | None, history) -> np.ndarray:
    """Return the predicted displacement [m] after rest at 0 V and a history of voltages, at the rate of the chain.

    Units: ``voltage`` and ``history`` [V].
    """
    voltage = np.ascontiguousarray(voltage, dtype=np.float64)
    if chain.saturation is not None:
        voltage = np.clip(voltage, *chain.saturation)
    return _forced(chain, voltage, intersample or chain.intersample, False, history) + chain.offset


def input_repeated(chain: PlantModel, data: IdentificationData, intersample: str | None = None, skip: int = 0) -> bool:
    """Whether an input that was periodic before the recording explains it clearly better than rest at 0 V."""
    starts = ("zero", "periodic")
    predicted = [predict(chain, data.input, data.sample_time, intersample, start) for start in starts]
    rest, repeated = (float(np.std((data.output - values)[skip:])) for values in predicted)
    return PAST_WHILE_PREDICTING.improves(repeated, rest)


def before_dynamics(chain: PlantModel, voltage, sample_time: float, measured=None) -> np.ndarray:
    """Return the output [m] of hysteresis and creep, shape (N,), which is the input of the dynamics.

    Without ``measured`` [m], the chain starts at rest at 0 V. Units: ``voltage`` [V], ``sample_time`` [s].
    """
    bare = replace(
        chain,
        dynamics=LinearParameters(),
        linear_part=replace(chain.continuous, lag=0.0, delay=0.0, modes=(), hold=0.0),
        transfer_function=None,
        sample_time=sample_time,
        synchronous=True,
        offset=0.0,
    )
    return predict(bare, voltage, sample_time, "zoh", None if measured is not None else "zero", measured)


def _estimated_history(chain: PlantModel, voltage, intersample, measured) -> tuple[float, ...]:
    """Return the voltages before the first sample with which the model fits the measurement best."""
    last = wiped_out(voltage)
    v, y = voltage[:last], measured[:last]
    largest = max(abs(chain.voltage_low), abs(chain.voltage_high), float(np.max(np.abs(v))))
    first = float(voltage[0])

    def error(history=()):
        return float(np.std(y - _forced(chain, v, intersample, True, history)))

    before, least = remanent_voltage(lambda before: error((before, first)), largest, chain.voltage_low < 0.0)
    return (before, first) if PAST_WHILE_PREDICTING.improves(least, error()) else ()


def at_rate(chain: PlantModel, sample_time: float) -> PlantModel:
    """Return the chain for another sample time.

    Units: ``sample_time`` [s].
    """
    if abs(sample_time - chain.sample_time) <= SAME_RATE * chain.sample_time:
        return chain
    if chain.linear_part is not None:
        dynamics = chain.linear_part.dynamics(sample_time)
    elif chain.transfer_function is not None:
        numerator, denominator = (np.array(part) for part in chain.transfer_function)
        held = CanonicalSimulation(denominator, sample_time, "zoh")
        model: LinearModel = held.model(numerator)
        dynamics = model.linear_parameters()
    elif not chain.dynamics.order:
        dynamics = chain.dynamics
    else:
        raise IdentificationError(
            f"the model's dynamics are valid for a sample time of {chain.sample_time:g} s, but the data has "
            f"{sample_time:g} s; resample the data to the model's sample time, or identify with --linear lag or "
            "second_order"
        )
    return replace(chain, dynamics=dynamics, sample_time=sample_time)


def _forced(chain: PlantModel, voltage, intersample, settled, history=()) -> np.ndarray:
    if intersample == "zoh":
        return simulate_chain(
            chain.hysteresis,
            chain.creep,
            chain.dynamics,
            voltage,
            chain.sample_time,
            settled=settled,
            synchronous=chain.synchronous,
            history=history,
        )
    if chain.linear_part is None and chain.transfer_function is None and chain.dynamics.order:
        raise IdentificationError(
            f"intersample = {intersample!r}: the model's dynamics are known only for a held voltage; use zoh"
        )
    factor = BANDLIMITED_POINTS if intersample == "bandlimited" else 1
    fine = upsample(voltage, factor, intersample)
    step = chain.sample_time / factor
    front = hysteresis_block(chain.hysteresis, step)
    pass_through(front, history)
    static = front.simulate(fine)
    if chain.transfer_function is not None:
        start = "rest" if settled else "zero"
        return simulate_transfer_function(*chain.transfer_function, static, step, "linear", start)[::factor]
    part = replace(chain.continuous, settled=settled)
    return part.apply(static, step)[::factor][: voltage.size]


def _free_response(chain: PlantModel, residual) -> np.ndarray:
    """Return the free response of the dynamics by least squares; a constant is fitted too, but discarded."""
    if chain.synchronous or not 0 < chain.dynamics.order <= MOST_FREE:
        return np.zeros_like(residual)
    model = chain.dynamics.state_space
    table = np.empty((residual.size, chain.dynamics.order + 1))
    row = model.C[0]
    for k in range(residual.size):
        table[k, :-1] = row
        row = row @ model.A
    table[:, -1] = 1.0
    solution = np.linalg.lstsq(table, residual, rcond=1e-9)[0]
    return table[:, :-1] @ solution[:-1]


def judge(
    chain: PlantModel,
    data: IdentificationData,
    predicted,
    *,
    skip: int = 0,
    free_offset: bool = False,
    fitted: int = 0,
    inverse: bool = True,
) -> tuple[Validation, InverseValidation | None, dict, list[str]]:
    """Compare prediction and measurement, and recovered and applied voltage; return both results, figures and notes.

    Units: ``predicted`` [m].
    """
    found = validate(data.output, predicted, data.input, parameters=fitted, skip=skip, free_offset=free_offset)
    figures = found.to_dict()
    notes = figures.pop("warnings")
    back = _recovered(chain, data, skip, free_offset) if inverse else None
    if isinstance(back, str):
        notes.append(f"no inverse validation: {back}")
        back = None
    figures["inverse_rmse_v"] = back and back.rmse
    figures["inverse_rmse_m"] = back and back.rmse_displacement
    figures["inverse_rmse_percent"] = back and back.rmse_percent
    return found, back, figures, notes


def _recovered(chain: PlantModel, data: IdentificationData, skip: int, free_offset: bool) -> InverseValidation | str:
    """Return the validation of the inverse, or the reason why it is missing."""
    if not chain.invertible:
        return f"{chain.hysteresis.type} includes dynamics and has no inverse"
    try:
        back = recover_voltage(chain, data.output - chain.offset, data.input, skip, free_offset)
    except ParameterError as error:
        return " ".join(str(error).split())
    return back if np.isfinite(back.rmse) else "the inverse overflows"
