# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Procedures of models that are fitted to the recording itself: a gain with dynamics, and an oscillator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.bouc_wen_mechanical import FREE, fit_bouc_wen_mechanical
from hysteresis_ros.identification.chains import chain_of, identified, with_stage
from hysteresis_ros.identification.cleaning import ROUNDS, Cleaned, cleaned
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import gain_and_dynamics
from hysteresis_ros.identification.identified import Identification
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.output_error import fit_transfer_function
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.identification.start import WORTH_IT as PAST_WORTH_IT
from hysteresis_ros.identification.transfer_function import Structure
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.units import readable

#: A lag must lower the residual by this part to be taken without being asked for.
WORTH_IT = 0.02
#: Drifts that differ by less than this part are one.
SAME_DRIFT = 0.01


def _repeated(fit, data: IdentificationData, skip: int) -> Identification:
    """Return what ``fit(data, before)`` finds once what it shows to be outliers and drift was taken out of the data."""
    clean, result = Cleaned(data, 0.0, 0), fit(data, None)
    for _ in range(ROUNDS):
        predicted = predict(result.chain, data.input, data.sample_time, measured=clean.data.output)
        found = cleaned(data, predicted, skip)
        if found.outliers == clean.outliers and abs(found.drift - clean.drift) <= SAME_DRIFT * abs(found.drift):
            break
        clean, result = found, fit(found.data, result)
    numbers, warnings = {**result.numbers, **clean.numbers}, (*result.warnings, *clean.doubts)
    return replace(result, numbers=numbers, warnings=warnings, drift=clean.drift)


def proportional(data: IdentificationData, request: Request) -> Identification:
    """A gain, and dynamics behind it."""
    return _repeated(lambda clean, _: _proportional(clean, request), data, request.skip or 0)


def _proportional(data: IdentificationData, request: Request) -> Identification:
    u, y = data.input, data.output
    skip = request.skip or 0
    if "modes" in request.parts:
        gain, part, constant = gain_and_dynamics(u, y, data.sample_time, request.parts, skip)
        if part.modes or part.delay:
            hysteresis = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=gain))
            chain = chain_of(data, request, hysteresis, part, part.dynamics(data.sample_time), False, constant)
            return identified(chain, request, FittedHysteresis(hysteresis, 2), part)
    if request.stage:
        # a size to start from: the gain is the stage's, behind whose dynamics no line through the samples shows it
        size = ProportionalParameters(gain=data.stroke / float(np.ptp(u)))
        return with_stage(
            data, request, FittedHysteresis(HysteresisParameters(type="proportional", proportional=size), 1)
        )
    gain, constant = np.polyfit(u[skip:], y[skip:], 1)
    if not gain > 0.0:
        raise IdentificationError(f"the gain is {gain:.3g} m/V; it must be above 0")
    hysteresis = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=float(gain)))
    if not request.parts:
        chain = chain_of(data, request, hysteresis, LinearPart(), LinearParameters(), True, float(constant))
        return identified(chain, request, FittedHysteresis(hysteresis, 2), LinearPart())
    # a lag where it helps: output error of one pole against none
    best = float(np.std((y - gain * u - constant)[skip:]))
    found = fit_transfer_function(u, y, data.sample_time, Structure(1, 0, "linear", "rest", offset=True), skip=skip)
    if not np.sqrt(found.mse) < (1.0 - WORTH_IT) * best or not found.dc_gain > 0.0:
        return _proportional(data, replace(request, parts=()))
    part = LinearPart(lag=float(-1.0 / found.poles[0].real), settled=True)
    hysteresis = HysteresisParameters(
        type="proportional", proportional=ProportionalParameters(gain=float(found.dc_gain))
    )
    dynamics, synchronous = part.dynamics(data.sample_time), part.lag < 0.5 * data.sample_time
    chain = chain_of(data, request, hysteresis, part, dynamics, synchronous, found.offset)
    fit = FittedHysteresis(hysteresis, 2, warnings=found.warnings, converged=found.converged)
    return identified(chain, request, fit, part)


def bouc_wen_mechanical(data: IdentificationData, request: Request) -> Identification:
    """Grey box: all parameters by output error."""
    skip = request.skip or 0

    def fit(clean, before):
        return _oscillator(clean, request, before)

    result = _repeated(fit, data, skip)
    if request.initial is None:
        predicted = [
            predict(result.chain, data.input, data.sample_time, initial=start) for start in ("zero", "periodic")
        ]
        rest, repeated = (float(np.std((data.output - values)[skip:])) for values in predicted)
        if repeated < (1.0 - PAST_WORTH_IT) * rest:
            request = replace(request, initial="periodic")
            note = "the input had repeated before, which fits better than rest at 0 V"
            return replace(_repeated(fit, data, skip), start=note)
    note = {"zero": "at rest at 0 V before the recording", "periodic": "the input had repeated before"}
    asked = "as asked for: " if request.initial else ""
    return replace(result, start=asked + note[request.initial or "zero"])


def _oscillator(data: IdentificationData, request: Request, before: Identification | None) -> Identification:
    """Fit the oscillator, from initial values or from what was found ``before`` on nearly the same data."""
    options = dict(request.options)
    trials, seed = options.pop("trials", None), options.pop("seed", 0)
    if before is not None:
        start, trials = before.chain.hysteresis.chosen, 0
    else:
        start = replace(_oscillator_guess(data, request), **options)

    def progress(number, rmse):
        request.progress(number + 1, f"start {number + 1}, residual {readable(rmse, 'm')}")

    initial = request.initial or "zero"
    arguments = {} if trials is None else {"trials": trials}
    fit = fit_bouc_wen_mechanical(
        data.input,
        data.output,
        data.sample_time,
        start,
        intersample=request.intersample,
        initial=initial,
        skip=request.skip or 0,
        seed=seed,
        progress=progress,
        **arguments,
    )
    hysteresis = HysteresisParameters(type="bouc_wen_mechanical", bouc_wen_mechanical=fit.parameters)
    error = data.output - fit.simulate(data.input, data.sample_time)
    offset = float(np.mean(error[request.skip or 0 :]))
    chain = chain_of(data, request, hysteresis, LinearPart(), LinearParameters(), False, offset)
    found = FittedHysteresis(hysteresis, len(FREE) + 1, fit.deviations, fit.warnings, fit.converged)
    result = identified(replace(chain, initial=initial), request, found, LinearPart())
    unit = {} if data.input_unit == "V" else {"assumptions": (f"the input is in {data.input_unit}, written as V",)}
    numbers = {"starts_agreeing": float(fit.agreeing)} if before is None else before.numbers
    warnings = result.warnings if before is None else tuple(dict.fromkeys((*before.warnings, *result.warnings)))
    return replace(result, numbers=numbers, warnings=warnings, linear="inside the equation", **unit)


def _oscillator_guess(data, request) -> BoucWenMechanicalParameters:
    """Return initial values from a linear oscillator: half of the stiffness is elastic, half hysteretic."""
    options = request.options
    given = {"mass", "stiffness", "alpha", "beta"} <= set(options)
    if given:
        return BoucWenMechanicalParameters(
            mass=1.0, damping=0.0, stiffness=1.0, alpha=1.0, beta=1.0, gamma=0.5, delta=-0.5
        )
    intersample = request.intersample
    initial = "periodic" if request.initial == "periodic" else "zero"
    structure = Structure(2, 0, intersample, initial, offset=True)
    found = fit_transfer_function(data.input, data.output, data.sample_time, structure)
    # b0/(s² + a1 s + a0) = (1/m)/(s² + c/m s + k/m); near the resonance the hysteretic force is partly saturated
    mass = 1.0 / abs(float(np.ravel(found.numerator)[-1]))
    damping, stiffness = mass * float(found.denominator[1]), mass * float(found.denominator[2])
    return BoucWenMechanicalParameters(
        mass=mass,
        damping=0.5 * damping,
        stiffness=0.6 * stiffness,
        alpha=0.6 * stiffness,
        beta=2.0 / data.stroke,
        gamma=0.8,
        delta=-0.8,
    )
