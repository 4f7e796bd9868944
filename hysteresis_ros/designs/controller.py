# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of the controller of an axis, with the decisions and the output of ``hysteresis design``."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import yaml

from hysteresis_ros.configuration import STAGE, Configuration, dump_configuration, matches, parse_configuration
from hysteresis_ros.control.controller import DESIGNS, ControllerParameters, design_of
from hysteresis_ros.control.damping.inner_loop import KINDS, NONE, modes
from hysteresis_ros.control.feedforward import FeedforwardParameters, designed_preview, mean_delay
from hysteresis_ros.control.laws.pid import LITTLE_DAMPING, pid_state_space
from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.control.linearisation import behind_damping, margins, whole_loop
from hysteresis_ros.control.margins import AIMED, REQUIRED, Margins, judge, plant_state_space
from hysteresis_ros.control.uncertainty import KEPT, ResponseUncertainty, Uncertainty
from hysteresis_ros.designs.damping import DampedDesign, PlantsAround, around_model, judge_damping, with_damping
from hysteresis_ros.designs.gains import Designed, Robustness, Tuned, design_gains, design_robust, tune
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.files import FAST_LOADER
from hysteresis_ros.identification.parameter_file import SECTION, SMALL_LOOP_GAIN
from hysteresis_ros.identification.safe_motion import smooth_approach, with_comments, with_safe_motion
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.loop.reach import reachable_displacements, single_axis
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.linear import StateSpace

NODE = "motion_controller"
#: First words of the comment lines that a new design replaces: LEARNING for a design of learning, FEEDFORWARD for one
#: of a feedforward, HEADERS for one of a controller.
LEARNING = ("# Learning designed by `hysteresis design", "# over the controller of this file:")
FEEDFORWARD = ("# Feedforward designed by `hysteresis design", "# on the model of the stage:")
HEADERS = (
    "# Controller designed by `hysteresis design",
    "# on the model in motion_controller:",
    *LEARNING,
    *FEEDFORWARD,
)


def designed_values(before: dict, parameters: ControllerParameters) -> dict:
    """Return the flat parameters of the controller node: those of the file, in which the design replaces its groups.

    A learned correction is removed, because its filters were designed for the previous controller.
    """
    groups = (*parameters.law.groups, "feedforward", *_damping(before, parameters))
    replaced = tuple(f"{name}." for name in groups)
    gone = (*replaced, "learning.")
    kept = {name: value for name, value in before.items() if not name.startswith(gone) and name != "type"}
    chosen = {"type": parameters.type}
    flat = parameters.to_mapping()
    unused = tuple(f"damping.{kind}." for kind in KINDS if kind != parameters.damping.type)
    flat = {name: value for name, value in flat.items() if not name.startswith(unused)}
    # ROS has no type for an empty array
    chosen |= {name: value for name, value in flat.items() if name.startswith(replaced) and value != ()}
    found = {"type": chosen.pop("type")} | kept | chosen
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}


def _damping(before: dict, parameters: ControllerParameters) -> tuple[str, ...]:
    """Return the group names of the damping; empty without damping, if the file has no such group either."""
    named = any(name.startswith("damping.") for name in before)
    return ("damping",) if named or parameters.damping.type != NONE else ()


def design_text(configuration: Configuration, parameters: ControllerParameters, namespace: str, header: str) -> str:
    """Return the text of the file with the design; only the controller's section changes."""
    return _text(configuration, lambda before: designed_values(before, parameters), namespace, header, HEADERS)


def learning_text(configuration: Configuration, parameters: LearningParameters, namespace: str, header: str) -> str:
    """Return the text of the file with a designed correction; everything else is kept."""
    chosen = {f"learning.{name}": value for name, value in parameters.to_mapping().items()}

    def values(before: dict) -> dict:
        return {name: value for name, value in before.items() if not name.startswith("learning.")} | chosen

    return _text(configuration, values, namespace, header, LEARNING)


def feedforward_text(configuration: Configuration, values: dict, namespace: str, node: str, header: str) -> str:
    """Return the text of the file with new feedforward values in a section; everything else is kept."""
    chosen = {f"feedforward.{name}": value for name, value in values.items()}

    def changed(before: dict) -> dict:
        return {name: value for name, value in before.items() if not name.startswith("feedforward.")} | chosen

    return _text(configuration, changed, namespace, header, FEEDFORWARD, node)


def scan_text(configuration: Configuration, chosen: dict, namespace: str) -> str:
    """Return the text of a stage's file with new scan parameters; everything else is kept."""
    chosen = {f"scan.{name}": value for name, value in chosen.items()}
    return _text(configuration, lambda before: before | chosen, namespace, "", (), STAGE)


def _text(
    configuration: Configuration,
    values: Callable[[dict], dict],
    namespace: str,
    header: str,
    replaced,
    node: str = NODE,
) -> str:
    """Return the text of a file in which one section has new values and a new comment."""
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    full = f"{namespace}/{node}"
    root = yaml.compose(configuration.original, Loader=FAST_LOADER)
    sections = [(key, value) for key, value in root.value if _belongs(key.value, full)]
    lines = configuration.original.splitlines(keepends=True)
    kept = 0
    while lines[kept].startswith(replaced):
        kept += 1
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    if not sections:
        section = dump_configuration({f"/**{full}": values(configuration.node(node, namespace))})
        text = comment + "".join(lines[kept:]) + "\n" + section
    else:
        key, value = sections[-1]
        before = next(flat for pattern, flat in reversed(configuration.entries) if pattern == key.value)
        section = dump_configuration({key.value: values(before)})
        first, end = key.start_mark.line, min(value.end_mark.line, len(lines))
        while end > first + 1 and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
            end -= 1
        text = comment + "".join(lines[kept:first]) + section + "".join(lines[end:])
    parse_configuration(text, "the designed file")
    return text


def _belongs(pattern: str, full: str) -> bool:
    return pattern.rsplit("/", 1)[-1] == full.rsplit("/", 1)[-1] and matches(pattern, full)


#: Maximum number of halvings of the bandwidth.
HALVINGS = 18
#: Number of bisections between the last two bandwidths.
RAISED = 3
#: Tried ratios of input noise variance to measurement noise variance; a smaller ratio gives a slower observer.
OBSERVERS = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-5, 1e-7)
#: Response uncertainty of a model without an identification: the model is assumed to be exact.
KNOWN = ResponseUncertainty(np.ones(1), np.zeros(1), np.inf)
#: ``design(bandwidth, q)``.
Design = Callable[[float | None, float | None], Designed]


def response_uncertainty(configuration: Configuration, axis: str = "") -> ResponseUncertainty | None:
    """Return the uncertainty of the response that an identification has written into a parameter file, or None.

    For an identified stage, ``axis`` selects the axis.
    """
    found = next((values for name, values in configuration.entries if name == SECTION), {})
    start = f"{axis}.response." if axis else "response."
    if f"{start}uncertainty" not in found:
        return None
    if found.get(f"{start}ringing") and f"{start}certain_crossover_hz" not in found:
        raise ConfigurationError(
            f"{configuration.source}: {SECTION}: {start}certain_crossover_hz is missing, but {start}ringing requires"
            " it: the highest crossover known to be safe [Hz], 0 if none is; identify again, or remove the entries"
            f" {start}*"
        )
    try:
        frequencies, relative = (np.array(found[start + name], dtype=float) for name in ("frequencies", "uncertainty"))
        known_to = float(found.get(f"{start}known_to", np.inf))
        crossover = float(found[f"{start}certain_crossover_hz"]) if found.get(f"{start}ringing") else np.inf
    except (KeyError, TypeError, ValueError):
        frequencies, relative, known_to, crossover = np.ones(1), np.zeros(0), 0.0, 0.0
    rising = frequencies.shape == relative.shape and frequencies.ndim == 1 and bool(np.all(np.diff(frequencies) > 0.0))
    if not rising or not np.all(relative >= 0.0) or np.isnan(known_to):
        raise ConfigurationError(
            f"{configuration.source}: {SECTION}: {start}frequencies and {start}uncertainty must have the same length,"
            f" frequencies must increase, uncertainties must be ≥ 0; identify again, or remove the entries {start}*"
        )
    higher = found.get(f"metrics.{SMALL_LOOP_GAIN}", 0.0)
    gain = 1.0 + 0.01 * max(float(higher), 0.0) if isinstance(higher, (int, float)) else 1.0
    stated = found.get(f"{start}gain", 1.0)
    if isinstance(stated, (int, float)):
        gain = max(gain, float(stated))
    return ResponseUncertainty(frequencies, relative, known_to, crossover, gain)


def is_certain(loop: tuple[StateSpace, StateSpace], response: ResponseUncertainty, sample_time: float) -> bool:
    """Return whether a loop is stable on all plants of an identification and meets the margins at the largest gain.

    ``loop`` consists of controller and plant, see :func:`.whole_loop`. Units: ``sample_time`` [s].
    """
    controller, plant = loop
    if response.borne_by(controller, plant, sample_time).distance < KEPT:
        return False
    if response.gain == 1.0:
        return True
    return judge(controller, plant.scaled(response.gain), sample_time, with_bandwidth=False).meets()


#: Number of tried corner frequencies of a roll-off for each of the CORNER_DECADES decades.
CORNERS = 8
#: The lowest tried corner frequency is this number of decades below half the sample rate.
CORNER_DECADES = 3.5
#: Number of steps of the search for the gain at each corner frequency.
GAIN_STEPS = 12
#: A roll-off is used if it raises the bandwidth by at least this factor, or the integral gain of an uncertain PID by
#: more than this factor.
WORTH = 1.1
#: A requested bandwidth is reached if the achieved bandwidth is at least this fraction of it.
REACHED = 0.97


def rolled_off_design(
    first: Designed, quiet: float, response: ResponseUncertainty, sample_time: float, bandwidth: float | None = None
) -> Designed | None:
    """Return the integral controller with the largest certain gain (:func:`is_certain`) over all roll-offs, or None.

    Units: ``sample_time`` [s]. ``quiet`` is the largest allowed gain from the sensor's noise to the command,
    ``bandwidth`` the largest allowed bandwidth [Hz].
    """
    own = first.parameters.before_damping(sample_time)
    dynamics = own.model.dynamics
    unit, scale = 1.0 / (dynamics.matrices.dc_gain * sample_time), dynamics.resolved_input_scale / dynamics.output_scale
    plant, aimed = plant_state_space(dynamics), replace(AIMED, command_noise_gain=quiet)
    plain = replace(own.pid, Kp=0.0, Kd=0.0, setpoint_weight=1.0, derivative_filter=0.0)

    def found_with(gain: float, corner: float) -> Designed | None:
        gains = replace(plain, Ki=float(f"{unit * gain:.6g}"), roll_off=corner)
        loop = pid_state_space(gains, sample_time).scaled(scale), plant
        judged = judge(*loop, sample_time, with_bandwidth=bandwidth is not None)
        if not judged.meets(aimed) or (bandwidth is not None and judged.bandwidth > bandwidth):
            return None
        if not is_certain(behind_damping(first.parameters, sample_time, *loop), response, sample_time):
            return None
        changed: dict = {"pid": gains}
        return Designed(replace(first.parameters, **changed), first.margins)

    best, largest = None, 0.0
    for corner in np.pi / sample_time * 10.0 ** np.linspace(-CORNER_DECADES, -0.3, int(CORNERS * CORNER_DECADES)):
        rounded = float(f"{corner:.6g}")
        # if the crossover is above a third of the corner, the low-passes leave too little phase
        low, high = largest, min(rounded * sample_time / 3.0, 1.0)
        for _ in range(GAIN_STEPS if high > low else 0):
            middle = float(np.sqrt(max(low, 1e-3 * high) * high))
            found = found_with(middle, rounded)
            if found is None:
                high = middle
            else:
                best, low = found, middle
            if low > 0.98 * high:
                break
        largest = low
    return None if best is None else replace(best, margins=margins(best.parameters, sample_time))


def _pid(
    design: Design, request: DesignRequest, response: ResponseUncertainty, sample_time: float, quiet: float
) -> Designed:
    """Return a PID, with a roll-off if the bandwidth requires it, or if lightly damped modes limit a PID without it."""
    asked = request.bandwidth
    try:
        first = design(asked, request.q)
    except ParameterError:
        if asked is None:
            raise
        plain = design(None, request.q)
        rolled = rolled_off_design(plain, quiet, response, sample_time, asked)
        if rolled is None or rolled.margins.bandwidth <= plain.margins.bandwidth:
            raise
        if rolled.margins.bandwidth < REACHED * asked:
            said = (
                f"a PID reaches at most {rolled.margins.bandwidth:.4g} Hz on this model, with its roll-off; "
                "request a lower bandwidth, or none for the fastest gains"
            )
            raise ParameterError([Problem("bandwidth", asked, said)]) from None
        return rolled
    own = first.parameters.before_damping(sample_time).model.dynamics.state_space
    light = [damping for _, damping in modes(own.poles, sample_time) if damping < LITTLE_DAMPING]
    # a PID cancels one mode; a PID that is not certain is designed again by certain_design
    if (
        asked is not None
        or len(light) < 2
        or not is_certain(whole_loop(first.parameters, sample_time), response, sample_time)
    ):
        return first
    rolled = rolled_off_design(first, quiet, response, sample_time)
    return first if rolled is None or rolled.margins.bandwidth < WORTH * first.margins.bandwidth else rolled


def certain_design(
    first: Designed,
    design: Design,
    request,
    response: ResponseUncertainty | None,
    sample_time: float,
    quiet: float = np.inf,
) -> Designed:
    """Return a design that is stable on all plants consistent with the identification.

    The parts that the request leaves open are made slower until the design is stable: first the observer, then the
    response to the reference.

    Units: ``sample_time`` [s].
    """
    if response is None:
        return first
    loop = whole_loop(first.parameters, sample_time)
    if is_certain(loop, response, sample_time):
        return first
    certain = response.borne_by(*loop, sample_time)

    observes = request.q is None and "kalman" in first.parameters.law.groups
    observers = OBSERVERS if observes else (request.q,)

    def found_with(bandwidth: float | None) -> Designed | None:
        if observes and not _bears_unknown(design, bandwidth, observers[-1], response, sample_time):
            return None  # a faster observer would have even more gain at this frequency
        for q in observers:
            with contextlib.suppress(ParameterError):  # the law cannot achieve this bandwidth
                found = design(bandwidth, q)
                if is_certain(whole_loop(found.parameters, sample_time), response, sample_time):
                    return found
        return None

    slower, advice = None, "request a lower bandwidth or none"
    if not request.criterion and response.crossover > 0.0:
        asked = request.bandwidth
        slower = found_with(asked)
        if slower is None and asked is None:
            slower = _slower(found_with, min(first.margins.bandwidth, 0.4 / sample_time))
        if first.parameters.type == "pid" and (slower is None or asked is None):
            rolled = rolled_off_design(first, quiet, response, sample_time, asked)
            if rolled is not None and asked is not None and rolled.margins.bandwidth < REACHED * asked:
                advice = f"request a bandwidth of at most {rolled.margins.bandwidth:.3g} Hz or none"
            elif rolled is not None and (
                slower is None or abs(rolled.parameters.pid.Ki) > WORTH * abs(slower.parameters.pid.Ki)
            ):
                slower = rolled
    if slower is not None:
        return slower
    known = response.assumption(sample_time)
    limited = certain.frequency > response.crossover
    if not limited and (certain.frequency <= response.known_to or not known):
        known = f"the response has an uncertainty of {100.0 * certain.uncertainty:.0f} % at this frequency"
    if first.parameters.type != "pid":
        advice += ", choose another controller (pid)"
    raise ConfigurationError(
        f"the model is not accurate enough for this feedback at {certain.frequency:.4g} Hz: {known}; {advice}, or "
        "identify from a recording with content at this frequency (hysteresis excite --recipe multisine)"
    )


def _bears_unknown(design: Design, bandwidth, q, response: ResponseUncertainty, sample_time: float) -> bool:
    """Return whether a design tolerates dynamics unknown to the identification; True without a design."""
    with contextlib.suppress(ParameterError):
        found = response.borne_by(*whole_loop(design(bandwidth, q).parameters, sample_time), sample_time)
        return found.distance >= KEPT or found.frequency <= response.known_to
    return True


def _slower(found_with: Callable[[float], Designed | None], fast: float) -> Designed | None:
    """Return the fastest design below the bandwidth ``fast`` that is stable on all plants of the identification."""
    for _ in range(HALVINGS):
        slow = 0.5 * fast
        best = found_with(slow)
        if best is not None:
            for _ in range(RAISED):
                middle = float(np.sqrt(slow * fast))
                found = found_with(middle)
                slow, fast, best = (slow, middle, best) if found is None else (middle, fast, found)
            return best
        fast = slow
    return None


#: Poles with a smaller modulus are delays and are not printed. Several poles at 0 are computed with about this error.
AT_ZERO = 1e-3


#: Assumed RMS noise of a sensor of unknown noise, and largest allowed RMS noise of the command, as fractions of the
#: stroke.
ASSUMED_NOISE = 1e-4
NOISY_COMMAND = 2e-3


#: Command-line option of each range of a robust design.
OPTIONS = {
    "gain": "gain-range",
    "hysteresis": "hysteresis-range",
    "resonance": "resonance-range",
    "delay": "delay-range",
    "draws": "draws",
    "seed": "seed",
}


@dataclass(frozen=True)
class DesignRequest:
    """Options of a design."""

    controller: str  #: Name of a design, see :data:`hysteresis_ros.control.controller.DESIGNS`.
    bandwidth: float | None = None  #: [Hz]
    q: float | None = None  #: Kalman filter: ratio of input noise variance to measurement noise variance.
    #: ``iae``, ``ise`` or ``itae``: criterion for tuning the gains on the waveform, if the law supports it.
    criterion: str | None = None
    duration: float | None = None  #: Duration of the simulated run for the tuning [s].
    feedforward: bool = False  #: Whether to add the inverse of the dynamics.
    preview: int | None = None  #: Preview of the feedforward [samples]; by default what the inverse needs.
    #: RMS noise of the sensor [m], by default :data:`ASSUMED_NOISE` of the stroke; it limits the bandwidth if no
    #: bandwidth is requested.
    noise: float | None = None
    #: Plants that must meet the requirements. By default these are the model and, with damping, also plants whose
    #: resonances are 10 % lower or higher.
    robust: Uncertainty | None = None
    #: Kind of damping to design before the controller, or ``none``; by default the configured damping is kept.
    damping: str | None = None
    damping_peak: float = REQUIRED.sensitivity_peak  #: Largest M_s with the damping; a lower one weakens the damping.


@dataclass(frozen=True, eq=False)
class AxisDesign:
    """A designed controller."""

    request: DesignRequest
    parameters: ControllerParameters
    margins: Margins
    sample_time: float  #: [s]
    tuned: Tuned | None = None  #: Result of the tuning, if any.
    robustness: Robustness | None = None  #: Margins on the plants of a robust design.
    limited: ResponseUncertainty | None = None  #: Response uncertainty that limited the design.
    gain: float = 1.0  #: Factor on the plant's gain up to which the margins were required.
    damped: DampedDesign | None = None  #: Performance of the damping inside the controller's loop.
    together: str = ""  #: How this design was changed because of the loops of the other axes of a stage.
    calmed: str = ""  #: Why the controller is slower than it could be.
    unmodelled: str = ""  #: What the linear model lacks, so that its margins are not those of the axis.

    def misses(self) -> tuple[str, ...]:
        """Return the unmet requirements of the loop, on the model or on another plant."""
        if self.unmodelled:
            return (self.unmodelled,)
        others = (found.misses() for found in (self.robustness, self.damped) if found is not None)
        return self.margins.misses() or next((said for said in others if said), ())


def drawn_around(robust: bool, ranges: dict) -> Uncertainty | None:
    """Return the uncertainty of a robust design, from the command-line options; None without ``--robust``."""
    given = {name: value for name, value in ranges.items() if value is not None}
    if not robust:
        if given:
            raise ConfigurationError(f"--{OPTIONS[next(iter(given))]} belongs to --robust; give both")
        return None
    try:
        return Uncertainty(**given)
    except ParameterError as error:
        named = [replace(problem, name=f"--{OPTIONS[problem.name]}") for problem in error.problems]
        raise ParameterError(named) from None


def design_axis(
    axis: AxisParameters, request: DesignRequest, response: ResponseUncertainty | None = None
) -> AxisDesign:
    """Design the controller of an axis for the axis' own model."""
    _check_request(axis, request)
    sample_time = 1.0 / axis.motion_controller.sample_rate
    given = part(axis.motion_controller, ControllerParameters)
    around = around_model(given, sample_time, request)
    control = with_damping(given, sample_time, around, request)
    control = replace(control, feedforward=_feedforward(control.before_damping(sample_time), request))
    quiet = _quiet(axis, request.noise)

    def design(bandwidth, q):
        asked = replace(request, bandwidth=bandwidth, q=q, robust=None)
        return _gains(control, asked, sample_time, quiet, around)[0]

    robust = None
    if request.robust is not None or request.criterion or control.damping.type != NONE or request.controller != "pid":
        first, robust = _gains(control, request, sample_time, quiet, around)
    else:
        first = _pid(design, request, response or KNOWN, sample_time, quiet)
    tuned = None
    if request.criterion:
        tuned = _tuned(axis, first.parameters, request, request.criterion)
        law, _ = design_of(request.controller)
        gains: dict = {law.name: tuned.gains}
        final = replace(first.parameters, **gains)
        first = Designed(final, margins(final, sample_time))
    found = certain_design(first, design, request, response, sample_time, quiet)
    damped = None
    if control.damping.type != NONE:
        bandwidth = None
        plain = replace(request, damping=NONE, feedforward=False, preview=None)
        with contextlib.suppress(ParameterError, ConfigurationError):
            bandwidth = design_axis(axis, plain, response).margins.bandwidth
        damped = judge_damping(found.parameters, sample_time, around, bandwidth)
    # the margins found by the robust design do not apply to a design that was made slower afterwards
    kept = {"robustness": robust} if found is first else {"limited": response}
    gain = 1.0 if response is None else response.gain
    return AxisDesign(
        request,
        found.parameters,
        found.margins,
        sample_time,
        tuned,
        damped=damped,
        gain=gain,
        unmodelled=_unmodelled(axis, found.parameters),
        **kept,
    )


def _unmodelled(axis: AxisParameters, parameters: ControllerParameters) -> str:
    """Return that the dynamics of the axis are in its hysteresis model, where a design does not see them; else ''."""
    hysteresis, rate = axis.hysteresis_compensator.hysteresis, axis.motion_controller.sample_rate
    if parameters.model.dynamics.order or hysteresis_block(hysteresis, 1.0 / rate).invertible:
        return ""
    return f"the dynamics of hysteresis.type {hysteresis.type} are not in model.dynamics"


def _gains(
    control: ControllerParameters, request: DesignRequest, sample_time: float, quiet: float, around: PlantsAround
) -> tuple[Designed, Robustness | None]:
    """Return gains for a request; the damping is that of the parameters."""
    name, q = request.controller, request.q
    if request.robust is not None:
        aimed = replace(REQUIRED, command_noise_gain=quiet)
        return design_robust(control, name, sample_time, request.robust, q, aimed=aimed)
    aimed = replace(AIMED, command_noise_gain=quiet)
    plants = () if control.damping.type == NONE else around.closed(control, sample_time)
    return design_gains(control, name, sample_time, request.bandwidth, q, aimed=aimed, plants=plants), None


def _tuned(axis: AxisParameters, parameters: ControllerParameters, request: DesignRequest, criterion: str) -> Tuned:
    """Return gains tuned on the waveform of the axis, starting from the gains of a design."""
    law, _ = design_of(request.controller)
    start = getattr(parameters, law.name)
    changed = {"feedforward": parameters.feedforward, "damping": parameters.damping, law.name: start}
    fed = replace(axis, motion_controller=replace(axis.motion_controller, type=law.name, **changed))
    return tune(fed, law.name, criterion, start=start, duration=request.duration)


def _check_request(axis: AxisParameters, request: DesignRequest) -> None:
    """Refuse contradictory requests."""
    law, _ = design_of(request.controller)
    if request.criterion and law.tuning is None:
        tunable = " or ".join(sorted(name for name, (law, _) in DESIGNS.items() if law.tuning is not None))
        raise ConfigurationError(f"--criterion tunes a {tunable}, not {request.controller}; omit it")
    if request.criterion and request.bandwidth is not None:
        raise ConfigurationError("--criterion and --bandwidth exclude each other; give one of them")
    if request.criterion:
        axis.require_generator(
            "--criterion tunes on the waveform of reference_generator, but the file has a sequencer instead; omit it"
        )
    if request.duration is not None and not request.criterion:
        raise ConfigurationError(
            "--duration belongs to --criterion: it is the length of the run that is evaluated; give both"
        )
    if "kalman" not in law.groups and request.q is not None:
        raise ConfigurationError(f"--q belongs to the Kalman filter, but {request.controller} has none; omit it")
    if request.q is not None and not request.q > 0.0:
        raise ConfigurationError(f"--q {request.q:g}: must be above 0")
    for name, given in (("--bandwidth", request.bandwidth), ("--criterion", request.criterion)):
        if request.robust is not None and given is not None:
            raise ConfigurationError(
                f"--robust and {name} exclude each other, because --robust also determines it; give one of them"
            )
    if request.preview is not None and not request.feedforward:
        raise ConfigurationError("--preview belongs to --feedforward; give both")


def _quiet(axis: AxisParameters, noise: float | None) -> float:
    """Return the largest allowed gain from the sensor's noise to the command."""
    if noise is not None and not noise > 0.0:
        raise ConfigurationError(f"--noise {noise:g}: must be > 0 m")
    low, high = reachable_displacements(axis)
    return NOISY_COMMAND * (high - low) / (ASSUMED_NOISE * (high - low) if noise is None else noise)


def _feedforward(control: ControllerParameters, request: DesignRequest) -> FeedforwardParameters:
    if not request.feedforward:
        return control.feedforward
    preview = request.preview
    if preview is None:
        preview = designed_preview(control.model.dynamics)
    if preview < 0:
        raise ConfigurationError(f"--preview {preview}: must be 0 or more samples")
    if preview == 0:
        return FeedforwardParameters(type="velocity")
    return FeedforwardParameters(type="inverse_dynamics", preview=preview)


def design_file(configuration: Configuration, result: AxisDesign, namespace: str) -> str:
    """Return the text of the parameter file with a design, after a check that the axis can be built from it."""
    request = result.request
    words = [f"--controller {request.controller}"]
    for name in ("bandwidth", "q", "noise", "criterion", "duration", "preview"):
        value = getattr(request, name)
        if value is not None:
            unit = "m" if name == "noise" else ""
            words.append(f"--{name} {value:g}{unit}" if isinstance(value, float) else f"--{name} {value}")
    if request.damping is not None:
        words.append(f"--damping {request.damping}")
    if request.feedforward:
        words.append("--feedforward")
    if request.robust is not None:
        words += ["--robust", *_range_words(request.robust)]
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    reached = (
        "none below half the sample rate" if np.isinf(result.margins.bandwidth) else _hertz(result.margins.bandwidth)
    )
    misses = "".join(f"; MISSES {text}" for text in result.misses())
    header = (
        f"Controller designed by `hysteresis design {source} {' '.join(words)}`\n"
        f"on the model in motion_controller: bandwidth {reached}, M_s {result.margins.sensitivity_peak:.3g}, "
        f"delay margin {_delay(result.margins)}{misses}."
    )
    text = design_text(configuration, result.parameters, namespace, header)
    text = with_safe_motion(text, "the designed file", namespace)
    if result.parameters.feedforward.type == "velocity":
        text = _with_smooth_approach(text, result, namespace)
    Axis(single_axis(parse_configuration(text, "the designed file"), namespace or None))
    return text


#: Duration of each moving average of an approach, in mean delays of the model. With feedforward by velocity, an axis
#: that is a lag or a delay then overshoots a move by at most about 1/(2 SMOOTH²) = 1 %. A lightly damped resonance adds
#: the same overshoot as without feedforward.
SMOOTH = 7.0


def _with_smooth_approach(text: str, result: AxisDesign, namespace: str) -> str:
    """Return the text of a file whose approach is smooth enough for feedforward by velocity."""
    configuration = parse_configuration(text, "the designed file")
    axis, sample_time = single_axis(configuration, namespace or None), result.sample_time
    if axis.reference_generator is None or not axis.generator.approach.maximum_velocity:
        return text
    approach = axis.generator.approach
    dynamics = result.parameters.before_damping(sample_time).model.dynamics
    limits = smooth_approach(approach.maximum_velocity, SMOOTH * mean_delay(dynamics) * sample_time)
    slower = {
        f"approach.{name}": min(limit, getattr(approach, name) or math.inf)
        for name, limit in zip(("maximum_acceleration", "maximum_jerk"), limits, strict=True)
    }
    changed = _text(configuration, lambda before: before | slower, namespace, "", (), "reference_generator")
    reason = f"each moving average lasts at least {SMOOTH:g} mean delays of the model, for feedforward by velocity"
    ends = tuple(f"{name.removeprefix('approach.')}: {value!r}" for name, value in slower.items())
    reasons = "".join(f"{line}  # {reason}\n" for line in changed.splitlines() if line.endswith(ends))
    return with_comments(with_comments(changed, reasons), text)


def _hertz(value: float) -> str:
    return "above half the sample rate" if np.isinf(value) else f"{value:.4g} Hz"


def design_lines(result: AxisDesign) -> list[str]:
    """Return the printed table: gains, margins, bandwidth, poles, warnings."""
    found, own = result.margins, result.parameters.before_damping(result.sample_time)
    rows = list(own.law.rows(own, result.sample_time))
    if result.tuned is not None:
        tuned = result.tuned
        state = "converged" if tuned.converged else "not converged; best gains found"
        rows.append((f"{tuned.criterion.upper()} before, after", f"{tuned.before:.4g}, {tuned.after:.4g} ({state})"))
    asked = result.request.bandwidth
    rows += [
        ("bandwidth asked", "-" if asked is None else _hertz(asked)),
        ("bandwidth reached", _hertz(found.bandwidth)),
        ("gain margin", _decibel(found.gain_margin)),
        ("gain reduction margin", _decibel(found.gain_reduction_margin)),
        ("phase margin", "infinite" if np.isinf(found.phase_margin) else f"{found.phase_margin:.1f} deg"),
        ("delay margin", _delay(found)),
        ("gain crossover", ", ".join(f"{value:.4g}" for value in found.gain_crossovers) + " Hz"),
        ("phase crossover", ", ".join(f"{value:.4g}" for value in found.phase_crossovers) + " Hz"),
        ("sensitivity peak M_s", f"{found.sensitivity_peak:.3f}"),
        ("complementary peak M_t", f"{found.complementary_peak:.3f}"),
        ("noise in displacement", f"{found.noise_gain:.3g} times the sensor's noise"),
        ("noise in command", f"{found.command_noise_gain:.3g} times the sensor's noise"),
        ("requirements", f"NOT MET: {'; '.join(result.misses())}" if result.misses() else f"met ({_required()})"),
        (
            "closed-loop poles",
            ", ".join(_pole(pole) for pole in found.poles if pole.imag >= 0.0 and abs(pole) > AT_ZERO),
        ),
    ]
    if result.gain > 1.0:
        controller, plant = whole_loop(result.parameters, result.sample_time)
        scaled = plant.scaled(result.gain)
        peak = judge(controller, scaled, result.sample_time, with_bandwidth=False).sensitivity_peak
        rows.append(("gain of small loops", f"up to {100.0 * (result.gain - 1.0):.3g} % higher; M_s there {peak:.3f}"))
    least = modes(found.poles.astype(complex), result.sample_time)[:1]
    rows += [("least damped mode", f"{hertz:.4g} Hz, damping {damping:.2g}") for hertz, damping in least]
    for further in (result.damped, result.robustness):
        if further is not None:
            rows += further.rows()
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:<{width}}  {'none' if text == ' Hz' else text}" for name, text in rows]
    return lines + [f"note: {text}" for text in doubts(result)]


def _range_words(given: Uncertainty) -> list[str]:
    """Return the command-line options for these ranges."""
    return [f"--{OPTIONS[item.name]} {getattr(given, item.name):g}" for item in fields(given)]


def _required() -> str:
    least = f"gain margin {REQUIRED.gain_margin:g} dB, delay margin {REQUIRED.delay_margin:g} sample"
    return f"M_s ≤ {REQUIRED.sensitivity_peak:g}, {least}"


def _delay(found: Margins) -> str:
    if np.isinf(found.delay_margin):
        return "infinite"
    return f"{found.delay_margin_samples:.3g} samples, {1e3 * found.delay_margin:.4g} ms"


def _decibel(value: float) -> str:
    return "infinite" if np.isinf(value) else f"{value:.1f} dB"


def _pole(value: complex) -> str:
    return f"{value.real:.4f}" if value.imag == 0.0 else f"{value.real:.4f}±{value.imag:.4f}i"


def doubts(result: AxisDesign) -> list[str]:
    """Return warnings about a design."""
    parameters = result.parameters
    found = list(parameters.warnings())
    if result.unmodelled:
        return [
            *found,
            f"requirements not met: {result.unmodelled}, so the margins are not those of the axis and the closed loop "
            "may be unstable; identify a model with linear dynamics",
        ]
    if not parameters.model.dynamics.order:
        found.append(
            "model.dynamics.A is empty: the design assumes that the axis responds within a sample; "
            "identify the dynamics of the axis"
        )
    misses = result.misses()
    if misses:
        found.append(
            f"requirements not met: {'; '.join(misses)}; the loop tolerates only small errors of the model "
            "or the delay, and hysteresis compare does not rank it; choose another bandwidth or q"
        )
    if result.limited is not None:
        rests = result.limited.assumption(result.sample_time) or "the recording does not determine the response"
        asked, reached = result.request.bandwidth, result.margins.bandwidth
        change = f"bandwidth reduced to {_hertz(reached)}"
        if asked is not None and reached >= REACHED * asked:
            change = "a roll-off was added"
        found.append(
            f"{change}, so that the loop is stable with every plant consistent with the recording: {rests}; "
            "a recording with content at these frequencies (hysteresis excite --recipe multisine) may allow more"
        )
    if result.damped is not None:
        found += result.damped.doubts()
    found += [text for text in (result.together, result.calmed) if text]
    own = parameters.before_damping(result.sample_time)
    found += own.law.doubts(own, result.sample_time, result.tuned is not None)
    return found
