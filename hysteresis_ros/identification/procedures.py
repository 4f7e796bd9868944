# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification procedures, one for each model: from checked data and a request to a chain of blocks.

Play-type models are fitted together with lag, delay and creep. Static models (polynomial, Bouc-Wen, Duhem, and every
model that declares ``guess`` and ``free``) are fitted to data from which lag, delay and creep are removed. Two models
are fitted to the recording itself: the Bouc-Wen oscillator, and a gain with dynamics.

For models with declared free parameters (:func:`parametric`), the kernel of the nodes simulates the model under the
recorded voltage. Trust-region steps within the ranges of the parameters, with sensitivities by finite differences,
reduce the output error; the offset of the output is free. A combination of parameters that fails its ``check`` counts
as a large error.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Parameters
from hysteresis_ros.errors import HysteresisError, IdentificationError, ParameterError
from hysteresis_ros.identification.bouc_wen import (
    OSCILLATOR_FREE,
    fit_bouc_wen_mechanical,
    identify_bouc_wen_static,
    static_guess,
)
from hysteresis_ros.identification.bouc_wen import STATIC_FREE as BOUC_WEN_NAMES
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.duhem import identify_duhem, identify_inverse_duhem
from hysteresis_ros.identification.dynamics import MODES, TURNS, fit_stage, found_with
from hysteresis_ros.identification.generalised_play import competitors, fit_generalised_play
from hysteresis_ros.identification.hammerstein import HammersteinFit, without_drift
from hysteresis_ros.identification.linear_systems import FitError, LinearPart
from hysteresis_ros.identification.plant_model import (
    FittedHysteresis,
    Identification,
    Request,
    chain_of,
    grounded,
    identified,
)
from hysteresis_ros.identification.polynomial import identify_polynomial
from hysteresis_ros.identification.prandtl_ishlinskii import PRIOR_DECAY, find_ambiguity, fit_prandtl_ishlinskii
from hysteresis_ros.identification.prediction import input_repeated, predict
from hysteresis_ros.identification.preisach import FREE_CELLS, WIDTHS, Density, FreeDensity, fit_preisach
from hysteresis_ros.identification.preprocessing import Cleaned, automatic_skip, cleaned, condense, repeated, wiped_out
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings
from hysteresis_ros.identification.separation import (
    NOT_REPEATED,
    REPEATED,
    RESTED,
    Separated,
    Start,
    begins_at_zero,
    find_start,
    remembered,
    requested,
    rests_behind,
    separated,
    without_memory,
)
from hysteresis_ros.identification.thresholds import LAG_OF_A_GAIN, PAST_WHILE_FITTING, POOR, SAME_DRIFT
from hysteresis_ros.identification.transfer_function import Structure, fit_transfer_function
from hysteresis_ros.identification.validation import parameter_covariance
from hysteresis_ros.models.declaration import HysteresisModel
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.bouc_wen import BoucWenHysteresis
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters
from hysteresis_ros.models.hysteresis.generalised_play import GeneralisedPlayParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis
from hysteresis_ros.models.hysteresis.preisach import PreisachParameters
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.units import readable, shown_unit

#: Number of widths of the density in the trial fits for the voltage history before the recording.
TRIED_WIDTHS = 10
#: Number of samples for the computation of the ambiguity.
COARSE_SAMPLES = 2000


def prandtl_ishlinskii(data: IdentificationData, request: Request) -> Identification:
    """Fit plays (and dead zones) together with lag, delay and creep."""
    return _hammerstein(fit_prandtl_ishlinskii, data, request, _numbers_of_plays)


def usual(data: IdentificationData, request: Request) -> Identification:
    """Fit plays (and dead zones), or another kind of model if it predicts held-out blocks better.

    Other kinds are generalised plays and, if the simplest structure fits poorly, a free Preisach density.
    """

    def others(before, progress, linear) -> list:
        found: list = list(competitors(before, progress))
        if before.rms > POOR * before.data.stroke:
            # the drift and the dynamics of a poor fit are unreliable
            still = replace(before.data, drifts=False)
            found.append(without_drift(lambda data: FreeDensity(data).fit(linear, progress), still))
        return found

    return _hammerstein(partial(fit_prandtl_ishlinskii, competitors=others), data, request, _numbers_of_plays)


def preisach(data: IdentificationData, request: Request) -> Identification:
    """Fit an Everett map together with lag, delay and creep."""
    free = request.options.get("density") == "free"
    count = FREE_CELLS * (FREE_CELLS + 1) // 2 + 2 if free else int(request.options.get("widths", WIDTHS)) + 3
    return _hammerstein(
        fit_preisach, data, request, lambda _: count, lambda data: Density(data, TRIED_WIDTHS, TRIED_WIDTHS)
    )


def generalised_play(data: IdentificationData, request: Request) -> Identification:
    """Fit generalised plays (with envelopes and rate-dependent thresholds) together with lag, delay and creep."""
    return _hammerstein(fit_generalised_play, data, request, _numbers_of_plays)


def _numbers_of_plays(parameters) -> int:
    """Return the number of fitted parameters: weights, a constant, and either dead zones or envelopes and rate."""
    if isinstance(parameters, PreisachParameters):
        return FREE_CELLS * (FREE_CELLS + 1) // 2 + 2
    between = 4 if isinstance(parameters, GeneralisedPlayParameters) else len(parameters.zone_weights)
    return len(parameters.weights) + between + 1


#: Models whose fits are used to separate a hysteresis from the dynamics after it.
SEPARATING = ("prandtl_ishlinskii", "preisach")


def _hammerstein(fit_function, data, request, count, structure=None) -> Identification:
    # the linear stage includes a lag, so the hysteresis is fitted with a lag too; otherwise it would absorb the lag
    parts = ("lag", "delay") if request.stage else request.parts
    start = find_start(data, request.skip, request.initial, structure)

    def found_after(start: Start) -> HammersteinFit:
        voltage, displacement, skip = start.signals(data)
        options = dict(skip=skip, history=start.history, progress=request.report_residual, **request.options)
        return found_with(partial(fit_function, **options), voltage, displacement, data.sample_time, parts, skip)

    fit = found_after(start)
    free = request.skip is None and request.initial is None
    if free and start.skip and fit.linear_part.modes and rests_behind(data, start.skip, fit.linear_part, structure):
        start = RESTED
        fit = found_after(start)
    voltage, displacement, skip = start.signals(data)
    if request.model in SEPARATING and not request.options:
        request.separations.setdefault(start.past(parts), []).append(fit)
    request = replace(request, model=fit.hysteresis.type)
    if request.inverse not in MODELS[request.model].inverses:  # the data has selected another model than requested
        request = replace(request, inverse=MODELS[request.model].inverses[0])
    if start.kind != "zero":
        request = replace(request, initial=start.kind)
    found = FittedHysteresis(fit.hysteresis, count(fit.hysteresis.chosen), fit.deviations, fit.warnings, fit.converged)
    if request.stage:
        result = _with_stage(data, replace(request, skip=start.skip), found)
    else:
        result = identified(data, request, found, fit.linear_part, fit.synchronous)
    request.progress(0, "ambiguity of the recording")
    coarse = condense(voltage, displacement, data.sample_time, skip, history=start.history, enough=COARSE_SAMPLES)
    doubt = find_ambiguity(coarse, fit.linear_part, fit.hysteresis, fit.numbers.get("density_decay") == PRIOR_DECAY)
    numbers = {**result.numbers, **fit.numbers, **(doubt.numbers if doubt else {})}
    numbers |= predicted_error(numbers, len(data) * data.sample_time, fit.kept_rmse)
    warnings = (*result.warnings, *fit.doubts, *(doubt.warnings if doubt else ()))
    return replace(result, numbers=numbers, warnings=warnings, skipped=start.skip, start=start.note, drift=fit.drift)


#: Additional weight of the excess of the held-out mean square error over that of the fit. Held-out parts lie between
#: fitted parts, so errors of the parameters have less effect on them than on other loops. The weight was chosen on 40
#: simulated plants of other model classes, see docs/identification.md.
EXCESS = 2.0


def predicted_error(numbers: dict[str, float], duration: float, fitted: float) -> dict[str, float]:
    """Return the RMS error [m] expected on another recording of this duration [s]; ``fitted``: RMS error of the fit.

    Two uncertainties are added: the densities that fit equally well (uniformly distributed up to their largest
    difference), and the drift that cannot be distinguished from creep (a line with the standard deviation of the drift
    as slope).
    """
    if "held_out_rmse_m" not in numbers:
        return {}
    square = numbers["held_out_rmse_m"] ** 2
    excess = max(square - fitted**2, 0.0)
    density = numbers.get("ambiguity_rms_m", 0.0) / np.sqrt(3.0)
    line = numbers["drift_deviation_m_per_s"] * duration / np.sqrt(3.0)  # RMS of a straight line that begins at zero
    return {"predicted_rmse_m": float(np.sqrt(square + EXCESS * excess + density**2 + line**2))}


#: Number of free parameters of the polynomial model with its corner conditions (K2).
POLYNOMIAL_FREE = 9


def polynomial(data: IdentificationData, request: Request) -> Identification:
    """Fit branch polynomials to data without the lag."""

    def fit(other: Separated, _):
        return identify_polynomial(other.voltage, other.displacement, history=other.history, **request.options)

    static = _with_first_rise(separated(data, request), request, fit)
    found, static = remembered(static, fit, lambda found: PolynomialHysteresis(found.parameters, data.sample_time))
    hysteresis = HysteresisParameters(type="polynomial", polynomial=found.parameters)
    fitted = FittedHysteresis(hysteresis, POLYNOMIAL_FREE, warnings=found.warnings, converged=found.converged)
    return static_result(data, request, fitted, static)


def _with_first_rise(static: Separated, request: Request, fit) -> Separated:
    """Return the separation with the first rise, unless the later samples are fitted clearly better without it.

    Only the first rise shows the virgin curve. The trial models of the separation have no separate virgin curve, so
    their result for the beginning is not valid for this model.
    """
    data, wiped = static.cleaned.data, wiped_out(static.cleaned.data.input)
    if request.skip is not None or request.initial is not None or static.start.kind != "zero" or not wiped:
        return static
    if static.start.skip and not begins_at_zero(data.input):
        return static
    omitted, rested = (replace(static, start=start) for start in (without_memory(data, wiped), RESTED))

    def later_error(other: Separated) -> float:
        block = PolynomialHysteresis(fit(other, None).parameters, data.sample_time)
        return float(np.std((block.simulate(data.input) - static.output)[wiped:]))

    return omitted if PAST_WHILE_FITTING.improves(later_error(omitted), later_error(rested)) else rested


def bouc_wen(data: IdentificationData, request: Request) -> Identification:
    """Fit the static Bouc-Wen element by Nelder-Mead to data without the lag."""
    static = separated(data, request)
    v, x = static.voltage, static.displacement
    options = dict(request.options)
    exponent = options.pop("exponent", 1.0)
    given = {name: options.pop(name) for name in BOUC_WEN_NAMES if name in options}
    guess = replace(static_guess(v, x, exponent), **given) if given else None
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
    """Fit the Duhem equation to data without the lag; if requested, also its own inverse model."""
    static = separated(data, request)
    v, x = static.voltage, static.displacement
    request.progress(0, "shape functions and alpha")
    found = identify_duhem(v, x, **request.options)
    warnings = list(found.warnings)
    # the output is the only memory of the model, so the recording itself shows the initial state
    first: dict[str, Any] = dict(input_start=float(data.input[0]), output_start=float(static.output[0]))
    hysteresis = HysteresisParameters(type="duhem", duhem=replace(found.parameters, **first))
    fitted = sum(len(shape) for shape in found.parameters.shapes) + 1
    converged = found.converged
    inverse = None
    if request.inverse == "duhem":
        request.progress(1, "inverse")
        rest = grounded(hysteresis, data.sample_time)[1]
        backward = identify_inverse_duhem(v, x - rest, **request.options)
        own: dict[str, Any] = {"duhem": backward.parameters}  # the inverse declares this parameter group
        inverse = InverseParameters(type="duhem", **own)
        converged = converged and backward.converged
        warnings += [f"inverse: {text}" for text in backward.warnings]
    fit = FittedHysteresis(hysteresis, fitted, warnings=tuple(warnings), converged=converged)
    result = static_result(data, request, fit, static)
    numbers = {**result.numbers, "alpha_normalised": found.alpha, "opening_percent": 100.0 * found.loop.opening}
    chain = result.chain if inverse is None else replace(result.chain, inverse=inverse)
    return replace(result, chain=chain, numbers=numbers)


def _with_stage(data: IdentificationData, request: Request, fit: FittedHysteresis) -> Identification:
    """Fit dynamics of higher order after the hysteresis, and move their gain to the hysteresis."""
    stage = request.stage
    if stage is None:
        raise IdentificationError("no linear stage is given: choose one with --linear")
    hysteresis, _ = grounded(fit.hysteresis, data.sample_time)
    skip = request.skip if request.skip is not None else automatic_skip(data)
    request.progress(0, stage)
    moved = hysteresis_block(hysteresis, data.sample_time).simulate(data.input)
    initial = request.initial or "estimate"
    between = request.intersample
    found = fit_stage(moved, data.output, data.sample_time, stage, skip, intersample=between, initial=initial)
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


def static_result(
    data: IdentificationData, request: Request, found: FittedHysteresis, static: Separated, offset: float = 0.0
) -> Identification:
    """Complete the result for a hysteresis that was fitted to data without lag and creep."""
    part, start, clean = static.part, static.start, static.cleaned
    found = replace(found, warnings=(*static.warnings, *found.warnings, *clean.doubts))
    if start.kind != "zero":
        request = replace(request, initial=start.kind)
    if request.stage:
        result = _with_stage(clean.data, replace(request, skip=start.skip), found)
    else:
        offset = offset * part.settled_gain + static.constant
        result = identified(clean.data, request, found, part, part.synchronous(data.sample_time), offset)
    numbers = {**result.numbers, **clean.numbers}
    return replace(result, numbers=numbers, skipped=start.skip or None, start=start.note, drift=clean.drift)


#: Error of refused parameters at every sample, as a multiple of the stroke.
REFUSED = 10.0
#: Largest number of simulations per free parameter.
MOST_EVALUATIONS = 200
#: Relative step of the finite differences; with a smaller one, such as the usual square root of the machine precision,
#: kinks of a model act like noise.
RELATIVE_STEP = 1e-6


def parametric(data, request: Request) -> Identification:
    """Identify a model with ``guess`` and ``free`` on data without lag and creep."""
    model = MODELS[request.model]
    if model.guess is None:
        raise IdentificationError(f"model {model.name} has no initial values for the search")
    static = separated(data, request)
    try:
        start = replace(model.guess(static.voltage, static.displacement), **request.options).validated()
    except ParameterError as error:
        raise IdentificationError(f"initial values of {model.name}: {error}") from None

    def fit(other: Separated, before):
        search = _ParametricSearch(model, other)
        return search, search.run(before[1][0] if before else start, request.progress)

    (search, (found, deviations, offset, converged)), static = remembered(
        static, fit, lambda found: model.block(found[1][0], 1.0)
    )
    hysteresis = HysteresisParameters(type=model.name, **{model.name: found})
    fitted = FittedHysteresis(hysteresis, len(model.free) + 1, deviations, search.warnings, converged)
    return static_result(data, request, fitted, static, offset)


class _ParametricSearch:
    """The search on one recording, with free parameters divided by the magnitude of their initial values."""

    def __init__(self, model: HysteresisModel, static: Separated):
        self.model, self.first = model, len(static.history)
        self.voltage, self.displacement = np.concatenate([static.history, static.voltage]), static.displacement
        self.stroke = float(np.ptp(self.displacement))
        self.evaluations = 0
        self.warnings: tuple[str, ...] = ()

    def error(self, parameters: Parameters) -> np.ndarray:
        """Return the predicted minus the measured displacement [m], including its mean."""
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
            diff_step=RELATIVE_STEP,
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


def _robust(fit, data: IdentificationData, skip: int) -> Identification:
    """Return ``fit(data, before)``, repeated after removing the outliers and the drift that the fit shows."""

    def look(result: Identification, clean: Cleaned) -> Cleaned | None:
        predicted = predict(result.chain, data.input, data.sample_time, measured=clean.data.output)
        found = cleaned(data, predicted, skip)
        same = found.outliers == clean.outliers and abs(found.drift - clean.drift) <= SAME_DRIFT * abs(found.drift)
        return None if same else found

    clean, result = repeated(lambda clean, before: fit(clean.data, before), look, Cleaned(data, 0.0, 0))
    numbers, warnings = {**result.numbers, **clean.numbers}, (*result.warnings, *clean.doubts)
    return replace(result, numbers=numbers, warnings=warnings, drift=clean.drift)


def proportional(data: IdentificationData, request: Request) -> Identification:
    """Fit a gain, and dynamics after it."""
    return _robust(lambda clean, _: _proportional(clean, request), data, request.skip or 0)


def _proportional(data: IdentificationData, request: Request) -> Identification:
    u, y, step = data.input, data.output, data.sample_time
    skip, late = request.skip or 0, 0

    def gain(value: float) -> HysteresisParameters:
        return HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=value))

    if "modes" in request.parts:
        for _ in range(TURNS):
            stage = fit_stage(u, y, step, MODES, skip, parts=request.parts, late=late)
            late = max(round(stage.part.group_delay / step), 0)
        _refuse_gain(stage.gain)
        part = replace(stage.part, settled=True)
        if part.modes or part.delay:
            constant = float(np.mean((y - stage.gain * part.apply(u, step))[skip:]))
            found = FittedHysteresis(gain(stage.gain), 2, stage.deviations)
            return identified(data, request, found, part, False, constant)
    if request.stage:
        # only an initial value: with dynamics after the gain, a line through the samples does not give the gain
        return _with_stage(data, request, FittedHysteresis(gain(data.stroke / float(np.ptp(u))), 1))
    slope, constant = map(float, np.polyfit(u[skip:], y[skip:], 1))
    _refuse_gain(slope)
    plain = identified(data, request, FittedHysteresis(gain(slope), 2), LinearPart(), True, constant)
    if not request.parts:
        return plain
    # add a lag only if it clearly reduces the output error
    best = float(np.std((y - slope * u - constant)[skip:]))
    try:
        stage = fit_stage(u, y, step, "first_order", skip, intersample="linear", initial="rest")
    except FitError:
        return plain
    if stage.transfer_function is None or not LAG_OF_A_GAIN.improves(stage.rmse, best):
        return plain
    part = LinearPart(lag=1.0 / stage.transfer_function[1][-1], settled=True)
    fit = FittedHysteresis(gain(stage.gain), 2, warnings=stage.warnings, converged=stage.converged)
    return identified(data, request, fit, part, part.synchronous(step), stage.offset)


def _refuse_gain(gain: float) -> None:
    if not gain > 0.0:
        raise IdentificationError(f"the gain is {readable(gain, 'm')}/{shown_unit('V')}; it must be above 0")


def bouc_wen_mechanical(data: IdentificationData, request: Request) -> Identification:
    """Fit all parameters of the mechanical Bouc-Wen model by output error (grey box)."""
    skip = request.skip or 0

    def fit(clean, before):
        return _oscillator(clean, request, before)

    result = _robust(fit, data, skip)
    if request.initial is None:
        if input_repeated(result.chain, data, skip=skip):
            request = replace(request, initial="periodic")
            return replace(_robust(fit, data, skip), start=REPEATED.note)
        return replace(result, start=NOT_REPEATED.note)
    return replace(result, start=requested(request.initial, None).note)


def _oscillator(data: IdentificationData, request: Request, before: Identification | None) -> Identification:
    """Fit the oscillator from initial values, or from an earlier result ``before`` for nearly the same data."""
    options = dict(request.options)
    trials, seed = options.pop("trials", None), options.pop("seed", 0)
    if before is not None:
        start, trials = before.chain.hysteresis.chosen, 0
        if not isinstance(start, BoucWenMechanicalParameters):
            raise TypeError(f"{type(start).__name__}: no oscillator")
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
    found = FittedHysteresis(hysteresis, len(OSCILLATOR_FREE) + 1, fit.deviations, fit.warnings, fit.converged)
    result = identified(data, request, found, LinearPart(), False, offset)
    numbers = {"starts_agreeing": float(fit.agreeing)} if before is None else before.numbers
    warnings = result.warnings if before is None else tuple(dict.fromkeys((*before.warnings, *result.warnings)))
    return replace(result, numbers=numbers, warnings=warnings, linear="inside the equation")


def _oscillator_guess(data, request) -> BoucWenMechanicalParameters:
    """Return initial values from a fitted linear oscillator: 60 % of its stiffness is elastic, and 60 % hysteretic."""
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
    # b0/(s² + a1 s + a0) = (1/m)/(s² + c/m s + k/m); the sum of both stiffnesses exceeds k, because the hysteretic
    # force is partly saturated near the resonance
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
