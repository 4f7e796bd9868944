"""One procedure per model: from checked data and a request to a chain of blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.compensation.compensator import InverseParameters
from hysteresis_ros.compensation.creep import creep_inverse
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.bouc_wen_mechanical import FREE, fit_bouc_wen_mechanical
from hysteresis_ros.identification.bouc_wen_static import NAMES as BOUC_WEN_NAMES
from hysteresis_ros.identification.bouc_wen_static import default_guess, identify_bouc_wen_static
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.duhem import identify_duhem, identify_inverse_duhem
from hysteresis_ros.identification.hammerstein import HammersteinFit, condense
from hysteresis_ros.identification.identified import Chain, Identification, at_rest, grounded, scaled
from hysteresis_ros.identification.inverse import undo_lag
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.linear_stage import LinearStage, fit_stage
from hysteresis_ros.identification.output_error import fit_transfer_function
from hysteresis_ros.identification.polynomial import identify_polynomial
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.models.bouc_wen_mechanical import BoucWenMechanicalParameters
from hysteresis_ros.models.creep import Creep, CreepParameters, creep
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.proportional import ProportionalParameters

#: Numbers of the polynomial model's corner conditions that are free (K2).
POLYNOMIAL_FREE = 9
#: A stage must lower the residual by this part to be taken without being asked for.
WORTH_IT = 0.02


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Parameters
    ----------
    model : str
    parts : tuple of str
        Of ``lag``, ``delay``, ``creep``: what may stand behind the hysteresis.
    stage : str or None
        Dynamics of higher order instead.
    options : dict
        Of the model.
    inverse : str
        Type of the compensator's inverse.
    skip : int or None
        First samples left out of the error; None: those before the past is wiped out.
    intersample : str
    initial : str or None
    progress : callable
        ``progress(number, text)``.
    """

    model: str
    parts: tuple[str, ...]
    stage: str | None
    options: dict
    inverse: str
    skip: int | None
    intersample: str
    initial: str | None
    progress: Callable[[int, str], None]

    def report_residual(self, number: int, rmse: float) -> None:
        """Progress of fits that report a residual [m]."""
        self.progress(number, f"residual {1e6 * rmse:.4g} µm")


def prandtl_ishlinskii(data: IdentificationData, request: Request) -> Identification:
    """Plays (and dead zones) with lag, delay and creep, found together."""
    return _hammerstein(fit_prandtl_ishlinskii, data, request)


def preisach(data: IdentificationData, request: Request) -> Identification:
    """Everett map with lag, delay and creep, found together."""
    return _hammerstein(fit_preisach, data, request)


def _hammerstein(fit_function, data, request) -> Identification:
    # a stage holds the lag itself, but the hysteresis must not take it for its own: it is found with one and handed on
    parts = ("lag", "delay") if request.stage else request.parts
    fit: HammersteinFit = fit_function(
        data.input,
        data.output,
        data.sample_time,
        linear=parts,
        skip=request.skip,
        progress=request.report_residual,
        **request.options,
    )
    chosen = fit.hysteresis.chosen
    if fit.hysteresis.type == "prandtl_ishlinskii":
        fitted = len(chosen.weights) + len(chosen.zone_weights) + 1
    else:
        fitted = int(request.options.get("widths", 24)) + 3
    if request.stage:
        return _with_stage(fit.hysteresis, data, request, fitted, fit.deviations, fit.warnings, fit.converged)
    part = fit.linear_part
    chain = _chain(data, request, fit.hysteresis, part, fit.dynamics, fit.synchronous)
    return _identified(chain, request, fitted + _count(part), part, fit.deviations, fit.warnings, fit.converged)


def polynomial(data: IdentificationData, request: Request) -> Identification:
    """Branch polynomials on data whose lag was undone."""
    data_static, part, notes, constant = _separated(data, request)
    skip = request.skip or 0
    found = identify_polynomial(
        data_static.input[skip:], data_static.output[skip:], history=data_static.input[:skip], **request.options
    )
    hysteresis = HysteresisParameters(type="polynomial", polynomial=found.parameters)
    return _static(
        data, request, hysteresis, part, POLYNOMIAL_FREE, {}, (*notes, *found.warnings), found.converged, constant
    )


def bouc_wen(data: IdentificationData, request: Request) -> Identification:
    """Static Bouc-Wen element by Nelder-Mead on data whose lag was undone."""
    data_static, part, notes, constant = _separated(data, request)
    skip = request.skip or 0
    v, x = data_static.input[skip:], data_static.output[skip:]
    options = dict(request.options)
    exponent = options.pop("exponent", 1.0)
    given = {name: options.pop(name) for name in BOUC_WEN_NAMES if name in options}
    guess = replace(default_guess(v, x, exponent), **given) if given else None
    if guess is not None:
        options.setdefault("starts", 4)
    iterations = int(options.get("iterations", 2000))

    def progress(run, iteration, cost):
        request.progress(run * iterations + iteration, f"start {run + 1}, cost {cost:.3g}")

    found = identify_bouc_wen_static(
        v, x, guess=guess, exponent=exponent, free_offset=True, progress=progress, **options
    )
    hysteresis = HysteresisParameters(type="bouc_wen", bouc_wen=found.parameters)
    result = _static(
        data,
        request,
        hysteresis,
        part,
        len(BOUC_WEN_NAMES) + 1,
        found.standard_errors,
        (*notes, *found.warnings),
        found.converged,
        offset=found.offset * part.settled_gain + constant,
    )
    return replace(result, trajectory=(BOUC_WEN_NAMES, found.search.runs[found.search.best].trajectory))


def duhem(data: IdentificationData, request: Request) -> Identification:
    """Duhem equation on data whose lag was undone; with its own inverse on request."""
    data_static, part, notes, constant = _separated(data, request)
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
    result = _static(data, request, hysteresis, part, fitted, {}, (*notes, *warnings), converged, constant)
    numbers = {**result.numbers, "alpha_normalised": found.alpha, "opening_percent": 100.0 * found.loop.opening}
    chain = result.chain if inverse is None else replace(result.chain, inverse=inverse)
    return replace(result, chain=chain, numbers=numbers)


def proportional(data: IdentificationData, request: Request) -> Identification:
    """A gain, and dynamics behind it."""
    u, y = data.input, data.output
    skip = request.skip or 0
    gain, constant = np.polyfit(u[skip:], y[skip:], 1)
    if not gain > 0.0:
        raise IdentificationError(f"the gain is {gain:.3g} m/V; it must be above 0")
    hysteresis = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=float(gain)))
    if request.stage:
        return _with_stage(hysteresis, data, request, 1, {}, (), True)
    if not request.parts:
        chain = _chain(data, request, hysteresis, LinearPart(), LinearParameters(), True, float(constant))
        return _identified(chain, request, 2, LinearPart(), {}, (), True)
    # a lag where it helps: output error of one pole against none
    best = float(np.std((y - gain * u - constant)[skip:]))
    found = fit_transfer_function(u, y, data.sample_time, 1, 0, "linear", "rest", offset=True, skip=skip)
    if not np.sqrt(found.mse) < (1.0 - WORTH_IT) * best or not found.dc_gain > 0.0:
        return proportional(data, replace(request, parts=()))
    part = LinearPart(lag=float(-1.0 / found.poles[0].real), settled=True)
    hysteresis = HysteresisParameters(
        type="proportional", proportional=ProportionalParameters(gain=float(found.dc_gain))
    )
    dynamics, synchronous = part.dynamics(data.sample_time), part.lag < 0.5 * data.sample_time
    chain = _chain(data, request, hysteresis, part, dynamics, synchronous, found.offset)
    return _identified(chain, request, 3, part, {}, found.warnings, found.converged)


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
    result = _identified(chain, request, len(FREE) + 1, LinearPart(), fit.deviations, fit.warnings, fit.converged)
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
    found = fit_transfer_function(data.input, data.output, data.sample_time, 2, 0, intersample, initial, offset=True)
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


def _separated(data: IdentificationData, request: Request):
    """Return the data with lag and creep undone, both, and what must be said about them; and the constant taken out.

    A Preisach or a Prandtl-Ishlinskii model finds them, whichever leaves less: they leave the shape of the loops free.
    """
    parts = ("lag", "delay") if request.stage else request.parts
    if not parts:
        return data, LinearPart(), (), 0.0
    # creep is always looked for: without it the search takes slow drifts for the noise a lag has to rise above
    searches = ((fit_preisach, {}), (fit_prandtl_ishlinskii, {"zone_count": 0}))
    fits = [
        search(
            data.input,
            data.output,
            data.sample_time,
            linear=tuple(dict.fromkeys((*parts, "creep"))),
            skip=request.skip,
            progress=request.report_residual,
            **settings,
        )
        for search, settings in searches
    ]
    fit = min(fits, key=lambda item: item.rmse)
    part = fit.linear_part if "creep" in parts else replace(fit.linear_part, creep_rate=0.0, settled=False)
    output, constant = data.output, 0.0
    if part.lag + part.delay >= 0.1 * data.sample_time:
        output = undo_lag(output, part.lag, part.delay, data.sample_time)
    else:
        part = replace(part, lag=0.0, delay=0.0)
    if part.creep.type != "none":
        constant = at_rest(fit.hysteresis, data.sample_time) * part.settled_gain
        output = undo_creep(output - constant, part, data.sample_time)
    return replace(data, output=output), part, fit.warnings, constant


def undo_creep(y, part: LinearPart, sample_time: float) -> np.ndarray:
    """Return the displacement [m], shape (N,), that creeps to ``y``: step by step, as the compensator does it.

    Parameters
    ----------
    y : array_like, shape (N,)
        [m], zero at rest.
    part : LinearPart
        Its creep; ``settled`` says whether it had settled under the first sample.
    sample_time : float
        [s]
    """
    y = np.ascontiguousarray(y, dtype=np.float64)
    block = Creep(part.creep, sample_time)
    block.settle(float(y[0]) / part.settled_gain if part.settled else 0.0)
    found = np.empty_like(y)
    for k in range(y.size):
        found[k] = creep_inverse(block.p, block.x, y[k])
        creep(block.p, block.x, found[k])
    return found


def _static(data, request, hysteresis, part, fitted, deviations, warnings, converged, offset) -> Identification:
    """Finish a hysteresis that was fitted to data without lag and creep."""
    if request.stage:
        return _with_stage(hysteresis, data, request, fitted, deviations, warnings, converged)
    synchronous = part.lag + part.delay < 0.5 * data.sample_time
    chain = _chain(data, request, hysteresis, part, part.dynamics(data.sample_time), synchronous, offset)
    return _identified(chain, request, fitted + _count(part), part, deviations, warnings, converged)


def _with_stage(hysteresis, data, request, fitted, deviations, warnings, converged) -> Identification:
    """Fit dynamics of higher order behind the hysteresis; their gain goes to the hysteresis."""
    hysteresis, _ = grounded(hysteresis, data.sample_time)
    skip = request.skip if request.skip is not None else automatic_skip(data)
    request.progress(0, request.stage)
    moved = hysteresis_block(hysteresis, data.sample_time).simulate(data.input)
    initial = request.initial or "estimate"
    found: LinearStage = fit_stage(
        moved, data.output, data.sample_time, request.stage, skip, request.intersample, initial
    )
    chain = _chain(
        data,
        request,
        scaled(hysteresis, found.gain),
        None,
        found.dynamics,
        False,
        found.offset,
        found.transfer_function,
    )
    chain = replace(chain, initial=initial)
    return Identification(
        model=request.model,
        linear=request.stage,
        chain=chain,
        fitted=fitted + found.fitted,
        numbers=found.numbers,
        deviations=dict(deviations),
        warnings=(*warnings, *(f"linear part: {text}" for text in found.warnings)),
        converged=converged and found.converged,
    )


def _chain(data, request, hysteresis, part, dynamics, synchronous, offset=0.0, transfer_function=None) -> Chain:
    hysteresis, rest = grounded(hysteresis, data.sample_time)
    settled = part is not None and part.settled
    gain = 1.0 if part is None else part.settled_gain
    low, high = data.input_range
    return Chain(
        hysteresis=hysteresis,
        creep=CreepParameters() if part is None else part.creep,
        dynamics=dynamics,
        sample_time=data.sample_time,
        # creep never settles within a recording, where the plant starts it settled
        offset=float(offset + rest * gain),
        linear_part=part,
        transfer_function=transfer_function,
        synchronous=bool(synchronous),
        initial=request.initial or ("estimate" if settled else "zero"),
        intersample=request.intersample,
        voltage_low=low,
        voltage_high=high,
        inverse=InverseParameters(type=request.inverse),
    )


def _identified(chain, request, fitted, part, deviations, warnings, converged) -> Identification:
    numbers = {}
    words = []
    if part.lag > 0.0:
        numbers["lag_s"] = part.lag
        words.append("lag")
    if part.delay > 0.0:
        numbers["delay_s"] = part.delay
        words.append("delay")
    if part.creep.type != "none":
        numbers["creep_rate_per_decade"] = part.creep_rate
        words.append("creep")
    return Identification(
        model=request.model,
        linear=", ".join(words) or "none",
        chain=chain,
        fitted=fitted,
        numbers=numbers,
        deviations=dict(deviations),
        warnings=tuple(warnings),
        converged=converged,
    )


def _count(part: LinearPart) -> int:
    return (part.lag > 0.0) + (part.delay > 0.0) + (part.creep.type != "none")


def automatic_skip(data: IdentificationData) -> int:
    """Return how many samples pass before the voltage has been near both ends of its range and the past is wiped out.

    Parameters
    ----------
    data : IdentificationData
    """
    found = condense(data.input, data.output, data.sample_time)
    return found.first * found.factor
