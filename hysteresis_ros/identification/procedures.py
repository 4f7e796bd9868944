"""One procedure per model: from checked data and a request to a chain of blocks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hysteresis_ros.compensation.inverses import InverseParameters
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.ambiguity import find_ambiguity
from hysteresis_ros.identification.bouc_wen_mechanical import FREE, fit_bouc_wen_mechanical
from hysteresis_ros.identification.bouc_wen_static import NAMES as BOUC_WEN_NAMES
from hysteresis_ros.identification.bouc_wen_static import default_guess, identify_bouc_wen_static
from hysteresis_ros.identification.condensed import condense
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.duhem import identify_duhem, identify_inverse_duhem
from hysteresis_ros.identification.dynamics import found_with, gain_and_dynamics
from hysteresis_ros.identification.identified import Identification, PlantModel, grounded
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.linear_stage import LinearStage, fit_stage
from hysteresis_ros.identification.output_error import fit_transfer_function
from hysteresis_ros.identification.polynomial import identify_polynomial
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import WIDTHS, Density, fit_preisach
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.identification.restarted_nelder_mead import SimplexSettings
from hysteresis_ros.identification.separation import separated
from hysteresis_ros.identification.smooth_density import PRIOR_DECAY
from hysteresis_ros.identification.start import find_start
from hysteresis_ros.identification.transfer_function import Structure
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.linear import LinearParameters

#: Numbers of the polynomial model's corner conditions that are free (K2).
POLYNOMIAL_FREE = 9
#: Widths of the densities that trials of the past fit.
TRIED = 10
#: To how many samples data is made coarser for what it cannot tell.
COARSE = 2000
#: The voltage counts as 0 V within this part of its range.
AT_ZERO = 0.002
#: A stage must lower the residual by this part to be taken without being asked for.
WORTH_IT = 0.02


def prandtl_ishlinskii(data: IdentificationData, request: Request) -> Identification:
    """Plays (and dead zones) with lag, delay and creep, found together."""
    return _hammerstein(fit_prandtl_ishlinskii, data, request, lambda p: len(p.weights) + len(p.zone_weights) + 1)


def preisach(data: IdentificationData, request: Request) -> Identification:
    """Everett map with lag, delay and creep, found together."""
    count = int(request.options.get("widths", WIDTHS)) + 3
    return _hammerstein(fit_preisach, data, request, lambda _: count, lambda data: Density(data, TRIED, TRIED))


def _hammerstein(fit_function, data, request, count, structure=None) -> Identification:
    # a stage holds the lag itself, but the hysteresis must not take it for its own: it is found with one and handed on
    parts = ("lag", "delay") if request.stage else request.parts
    start = find_start(data, request.skip, request.initial, structure)
    voltage, displacement, skip = start.signals(data)
    options = dict(skip=skip, history=start.history, progress=request.report_residual, **request.options)
    fit = found_with(partial(fit_function, **options), voltage, displacement, data.sample_time, parts, skip)
    if start.kind != "zero":
        request = replace(request, initial=start.kind)
    found = FittedHysteresis(fit.hysteresis, count(fit.hysteresis.chosen), fit.deviations, fit.warnings, fit.converged)
    if request.stage:
        result = _with_stage(data, replace(request, skip=start.skip), found)
    else:
        chain = _chain(data, request, fit.hysteresis, fit.linear_part, fit.dynamics, fit.synchronous)
        result = _identified(chain, request, found, fit.linear_part)
    request.progress(0, "what the recording cannot tell")
    coarse = condense(voltage, displacement, data.sample_time, skip, history=start.history, enough=COARSE)
    doubt = find_ambiguity(coarse, fit.linear_part, fit.hysteresis, fit.numbers.get("density_decay") == PRIOR_DECAY)
    numbers = {**result.numbers, **fit.numbers, **(doubt.numbers if doubt else {})}
    warnings = (*result.warnings, *fit.doubts, *(doubt.warnings if doubt else ()))
    return replace(result, numbers=numbers, warnings=warnings, skipped=start.skip, start=start.note, drift=fit.drift)


def polynomial(data: IdentificationData, request: Request) -> Identification:
    """Branch polynomials on data whose lag was undone."""
    data_static, part, notes, constant = separated(data, request)
    skip = request.skip or 0
    found = identify_polynomial(
        data_static.input[skip:], data_static.output[skip:], history=data_static.input[:skip], **request.options
    )
    hysteresis = HysteresisParameters(type="polynomial", polynomial=found.parameters)
    warnings = (*notes, *found.warnings)
    fitted = FittedHysteresis(hysteresis, POLYNOMIAL_FREE, warnings=warnings, converged=found.converged)
    return static_result(data, request, fitted, part, constant)


def bouc_wen(data: IdentificationData, request: Request) -> Identification:
    """Static Bouc-Wen element by Nelder-Mead on data whose lag was undone."""
    data_static, part, notes, constant = separated(data, request)
    skip = request.skip or 0
    v, x = data_static.input[skip:], data_static.output[skip:]
    options = dict(request.options)
    exponent = options.pop("exponent", 1.0)
    given = {name: options.pop(name) for name in BOUC_WEN_NAMES if name in options}
    guess = replace(default_guess(v, x, exponent), **given) if given else None
    settings = SimplexSettings(**{"starts": 4, **options})

    def progress(run, iteration, cost):
        request.progress(run * settings.iterations + iteration, f"start {run + 1}, cost {cost:.3g}")

    found = identify_bouc_wen_static(
        v, x, guess=guess, exponent=exponent, free_offset=True, settings=settings, progress=progress
    )
    hysteresis = HysteresisParameters(type="bouc_wen", bouc_wen=found.parameters)
    fitted = FittedHysteresis(
        hysteresis, len(BOUC_WEN_NAMES) + 1, found.standard_errors, (*notes, *found.warnings), found.converged
    )
    result = static_result(data, request, fitted, part, found.offset * part.settled_gain + constant)
    return replace(result, trajectory=(BOUC_WEN_NAMES, found.search.runs[found.search.best].trajectory))


def duhem(data: IdentificationData, request: Request) -> Identification:
    """Duhem equation on data whose lag was undone; with its own inverse on request."""
    data_static, part, notes, constant = separated(data, request)
    skip = request.skip or 0
    v, x = data_static.input[skip:], data_static.output[skip:]
    request.progress(0, "shape functions and alpha")
    found = identify_duhem(v, x, **request.options)
    warnings = list(found.warnings)
    hysteresis = HysteresisParameters(type="duhem", duhem=found.parameters)
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
    fit = FittedHysteresis(hysteresis, fitted, warnings=(*notes, *warnings), converged=converged)
    result = static_result(data, request, fit, part, constant)
    numbers = {**result.numbers, "alpha_normalised": found.alpha, "opening_percent": 100.0 * found.loop.opening}
    chain = result.chain if inverse is None else replace(result.chain, inverse=inverse)
    return replace(result, chain=chain, numbers=numbers)


def proportional(data: IdentificationData, request: Request) -> Identification:
    """A gain, and dynamics behind it."""
    u, y = data.input, data.output
    skip = request.skip or 0
    if "modes" in request.parts:
        gain, part, constant = gain_and_dynamics(u, y, data.sample_time, request.parts, skip)
        if part.modes or part.delay:
            hysteresis = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=gain))
            chain = _chain(data, request, hysteresis, part, part.dynamics(data.sample_time), False, constant)
            return _identified(chain, request, FittedHysteresis(hysteresis, 2), part)
    if request.stage:
        # a size to start from: the gain is the stage's, behind whose dynamics no line through the samples shows it
        size = ProportionalParameters(gain=data.stroke / float(np.ptp(u)))
        return _with_stage(
            data, request, FittedHysteresis(HysteresisParameters(type="proportional", proportional=size), 1)
        )
    gain, constant = np.polyfit(u[skip:], y[skip:], 1)
    if not gain > 0.0:
        raise IdentificationError(f"the gain is {gain:.3g} m/V; it must be above 0")
    hysteresis = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=float(gain)))
    if not request.parts:
        chain = _chain(data, request, hysteresis, LinearPart(), LinearParameters(), True, float(constant))
        return _identified(chain, request, FittedHysteresis(hysteresis, 2), LinearPart())
    # a lag where it helps: output error of one pole against none
    best = float(np.std((y - gain * u - constant)[skip:]))
    found = fit_transfer_function(u, y, data.sample_time, Structure(1, 0, "linear", "rest", offset=True), skip=skip)
    if not np.sqrt(found.mse) < (1.0 - WORTH_IT) * best or not found.dc_gain > 0.0:
        return proportional(data, replace(request, parts=()))
    part = LinearPart(lag=float(-1.0 / found.poles[0].real), settled=True)
    hysteresis = HysteresisParameters(
        type="proportional", proportional=ProportionalParameters(gain=float(found.dc_gain))
    )
    dynamics, synchronous = part.dynamics(data.sample_time), part.lag < 0.5 * data.sample_time
    chain = _chain(data, request, hysteresis, part, dynamics, synchronous, found.offset)
    fit = FittedHysteresis(hysteresis, 2, warnings=found.warnings, converged=found.converged)
    return _identified(chain, request, fit, part)


def bouc_wen_mechanical(data: IdentificationData, request: Request) -> Identification:
    """Grey box: all parameters by output error."""
    options = dict(request.options)
    trials, seed = options.pop("trials", None), options.pop("seed", 0)
    start = replace(_oscillator_guess(data, request), **options)

    def progress(number, rmse):
        request.progress(number + 1, f"start {number + 1}, residual {1e6 * rmse:.4g} µm")

    initial = request.initial or "zero"
    arguments = {} if trials is None else {"trials": trials}
    fit = fit_bouc_wen_mechanical(
        data.input,
        data.output,
        data.sample_time,
        start,
        intersample=request.intersample,
        initial=initial,
        seed=seed,
        progress=progress,
        **arguments,
    )
    hysteresis = HysteresisParameters(type="bouc_wen_mechanical", bouc_wen_mechanical=fit.parameters)
    offset = float(np.mean(data.output - fit.simulate(data.input, data.sample_time)))
    chain = replace(_chain(data, request, hysteresis, LinearPart(), LinearParameters(), False, offset), initial=initial)
    found = FittedHysteresis(hysteresis, len(FREE) + 1, fit.deviations, fit.warnings, fit.converged)
    result = _identified(chain, request, found, LinearPart())
    unit = {} if data.input_unit == "V" else {"assumptions": (f"the input is in {data.input_unit}, written as V",)}
    return replace(result, numbers={"starts_agreeing": float(fit.agreeing)}, linear="inside the equation", **unit)


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


def static_result(
    data: IdentificationData, request: Request, found: FittedHysteresis, part: LinearPart, offset: float
) -> Identification:
    """Finish a hysteresis that was fitted to data without lag and creep.

    Parameters
    ----------
    data : IdentificationData
        The recording itself.
    request : Request
    found : FittedHysteresis
    part : LinearPart
        What :func:`separated` took out.
    offset : float
        Constant of the recording [m] that the hysteresis does not hold.
    """
    if request.stage:
        return _with_stage(data, request, found)
    synchronous = part.synchronous(data.sample_time)
    chain = _chain(data, request, found.hysteresis, part, part.dynamics(data.sample_time), synchronous, offset)
    return _identified(chain, request, found, part)


def _with_stage(data: IdentificationData, request: Request, fit: FittedHysteresis) -> Identification:
    """Fit dynamics of higher order behind the hysteresis; their gain goes to the hysteresis."""
    hysteresis, _ = grounded(fit.hysteresis, data.sample_time)
    skip = request.skip if request.skip is not None else automatic_skip(data)
    request.progress(0, request.stage)
    moved = hysteresis_block(hysteresis, data.sample_time).simulate(data.input)
    initial = request.initial or "estimate"
    found: LinearStage = fit_stage(
        moved, data.output, data.sample_time, request.stage, skip, request.intersample, initial
    )
    chain = _chain(data, request, hysteresis.scaled(found.gain), None, found.dynamics, False, found.offset)
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


def _chain(data, request, hysteresis, part, dynamics, synchronous, offset=0.0) -> PlantModel:
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


def _identified(chain: PlantModel, request: Request, found: FittedHysteresis, part: LinearPart) -> Identification:
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


def automatic_skip(data: IdentificationData) -> int:
    """Return how many samples pass before the voltage has been near both ends of its range and the past is wiped out.

    Parameters
    ----------
    data : IdentificationData
    """
    found = condense(data.input, data.output, data.sample_time)
    return found.first * found.factor
