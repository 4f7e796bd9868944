# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Procedures of models without lag and creep of their own: fitted to data from which both were taken out."""

from __future__ import annotations

from dataclasses import replace

from hysteresis_ros.compensation.inverses import InverseParameters
from hysteresis_ros.identification.bouc_wen_static import NAMES as BOUC_WEN_NAMES
from hysteresis_ros.identification.bouc_wen_static import default_guess, identify_bouc_wen_static
from hysteresis_ros.identification.chains import chain_of, identified, with_stage
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.duhem import identify_duhem, identify_inverse_duhem
from hysteresis_ros.identification.identified import Identification, grounded
from hysteresis_ros.identification.polynomial import identify_polynomial
from hysteresis_ros.identification.remanent_past import remembered
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings
from hysteresis_ros.identification.separation import Separated, separated
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis

#: Numbers of the polynomial model's corner conditions that are free (K2).
POLYNOMIAL_FREE = 9


def polynomial(data: IdentificationData, request: Request) -> Identification:
    """Branch polynomials on data whose lag was undone."""
    static = separated(data, request)

    def fit(other: Separated, _):
        return identify_polynomial(other.voltage, other.displacement, history=other.history, **request.options)

    found, static = remembered(static, fit, lambda found: PolynomialHysteresis(found.parameters, data.sample_time))
    hysteresis = HysteresisParameters(type="polynomial", polynomial=found.parameters)
    fitted = FittedHysteresis(hysteresis, POLYNOMIAL_FREE, warnings=found.warnings, converged=found.converged)
    return static_result(data, request, fitted, static)


def bouc_wen(data: IdentificationData, request: Request) -> Identification:
    """Static Bouc-Wen element by Nelder-Mead on data whose lag was undone."""
    static = separated(data, request)
    v, x = static.voltage, static.displacement
    options = dict(request.options)
    exponent = options.pop("exponent", 1.0)
    given = {name: options.pop(name) for name in BOUC_WEN_NAMES if name in options}
    guess = replace(default_guess(v, x, exponent), **given) if given else None
    settings = SimplexSettings(**{"starts": 4, **options})

    def progress(run, iteration, cost):
        request.progress(run * settings.iterations + iteration, f"start {run + 1}, cost {cost:.3g}")

    def fit(other: Separated, before):
        again = replace(settings, starts=1)
        return identify_bouc_wen_static(
            other.voltage,
            other.displacement,
            history=other.history,
            guess=before.parameters if before else guess,
            exponent=exponent,
            free_offset=True,
            settings=again if before else settings,
            progress=progress,
        )

    found, static = remembered(static, fit, lambda found: BoucWenHysteresis(found.parameters, data.sample_time))
    hysteresis = HysteresisParameters(type="bouc_wen", bouc_wen=found.parameters)
    fitted = FittedHysteresis(
        hysteresis, len(BOUC_WEN_NAMES) + 1, found.standard_errors, found.warnings, found.converged
    )
    result = static_result(data, request, fitted, static, found.offset)
    return replace(result, trajectory=(BOUC_WEN_NAMES, found.search.runs[found.search.best].trajectory))


def duhem(data: IdentificationData, request: Request) -> Identification:
    """Duhem equation on data whose lag was undone; with its own inverse on request."""
    static = separated(data, request)
    v, x = static.voltage, static.displacement
    request.progress(0, "shape functions and alpha")
    found = identify_duhem(v, x, **request.options)
    warnings = list(found.warnings)
    # its output is all that it remembers, so the recording itself shows where it starts
    first = dict(input_start=float(data.input[0]), output_start=float(static.output[0]))
    hysteresis = HysteresisParameters(type="duhem", duhem=replace(found.parameters, **first))
    fitted = sum(len(shape) for shape in found.parameters.shapes) + 1
    converged = found.converged
    inverse = None
    if request.inverse == "duhem":
        request.progress(1, "inverse")
        rest = grounded(hysteresis, data.sample_time)[1]
        backward = identify_inverse_duhem(v, x - rest, **request.options)
        inverse = InverseParameters(type="duhem", duhem=backward.parameters)
        converged = converged and backward.converged
        warnings += [f"inverse: {text}" for text in backward.warnings]
    fit = FittedHysteresis(hysteresis, fitted, warnings=tuple(warnings), converged=converged)
    result = static_result(data, request, fit, static)
    numbers = {**result.numbers, "alpha_normalised": found.alpha, "opening_percent": 100.0 * found.loop.opening}
    chain = result.chain if inverse is None else replace(result.chain, inverse=inverse)
    return replace(result, chain=chain, numbers=numbers)


def static_result(
    data: IdentificationData, request: Request, found: FittedHysteresis, static: Separated, offset: float = 0.0
) -> Identification:
    """Finish a hysteresis that was fitted to data without lag and creep.

    Parameters
    ----------
    data : IdentificationData
        The recording itself.
    request : Request
    found : FittedHysteresis
    static : Separated
        What it was fitted to.
    offset : float
        Constant of that [m] that the hysteresis does not hold.
    """
    part, start, clean = static.part, static.start, static.cleaned
    found = replace(found, warnings=(*static.warnings, *found.warnings, *clean.doubts))
    if start.kind != "zero":
        request = replace(request, initial=start.kind)
    if request.stage:
        result = with_stage(clean.data, replace(request, skip=start.skip), found)
    else:
        offset = offset * part.settled_gain + static.constant
        synchronous = part.synchronous(data.sample_time)
        chain = chain_of(
            clean.data, request, found.hysteresis, part, part.dynamics(data.sample_time), synchronous, offset
        )
        result = identified(chain, request, found, part)
    numbers = {**result.numbers, **clean.numbers}
    return replace(result, numbers=numbers, skipped=start.skip or None, start=start.note, drift=clean.drift)
