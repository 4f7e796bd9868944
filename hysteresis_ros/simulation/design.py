# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of the controller of an axis: what ``hysteresis design`` does, decides and prints."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, fields, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.plant import modes
from hysteresis_ros.control.damping.registry import NONE
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.control.gain_design import Designed, design_gains
from hysteresis_ros.control.inversion import designed_preview
from hysteresis_ros.control.linearisation import margins
from hysteresis_ros.control.margins import AIMED, REQUIRED, Margins
from hysteresis_ros.control.registry import DESIGNS, design_of
from hysteresis_ros.control.response_uncertainty import ResponseUncertainty
from hysteresis_ros.control.robust import Robustness, design_robust
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.common_parameters import part
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.damped_design import (
    DampedDesign,
    PlantsAround,
    around_model,
    judge_damping,
    with_damping,
)
from hysteresis_ros.simulation.design_certainty import certain_design
from hysteresis_ros.simulation.design_file import design_text
from hysteresis_ros.simulation.reach import reachable_displacements
from hysteresis_ros.simulation.tuning import Tuned, tune

#: Poles below this, delays, are not printed; several of them at 0 are computed no closer.
AT_ZERO = 1e-3


#: RMS of the noise of a sensor that is not known, and how much of the command may be noise, as parts of the stroke.
ASSUMED_NOISE = 1e-4
NOISY_COMMAND = 2e-3


#: Option of the command for each range of the plants of a robust design.
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
    """What is asked of a design.

    Parameters
    ----------
    controller : str
        Name of a design, see :data:`hysteresis_ros.control.registry.DESIGNS`.
    bandwidth : float, optional
        [Hz]
    q : float, optional
        Variance of the input's noise over that of the measurement in the Kalman filter.
    criterion : str, optional
        ``iae``, ``ise`` or ``itae``: tune the gains on the waveform, where the law has some for that.
    duration : float, optional
        Length of the run for that [s].
    feedforward : bool
        Add the inverse of the dynamics.
    preview : int, optional
        Samples of preview of it; by default what the inverse needs.
    noise : float, optional
        RMS of the sensor's noise [m], for how fast a design of its own accord may be; by default
        :data:`ASSUMED_NOISE` of the stroke.
    robust : Uncertainty, optional
        Plants on each of which the requirements are to be met; by default the model alone, with a damping those with
        resonances off by 10 % as well.
    damping : str, optional
        Kind of damping to design first, or ``none``; by default that of the configuration stays.
    """

    controller: str
    bandwidth: float | None = None
    q: float | None = None
    criterion: str | None = None
    duration: float | None = None
    feedforward: bool = False
    preview: int | None = None
    noise: float | None = None
    robust: Uncertainty | None = None
    damping: str | None = None


@dataclass(frozen=True, eq=False)
class AxisDesign:
    """A designed controller.

    Parameters
    ----------
    request : DesignRequest
    parameters : ControllerParameters
    margins : Margins
    sample_time : float
        [s]
    tuned : Tuned, optional
        What the tuning did.
    robustness : Robustness, optional
        What the loop is worth on the plants of a robust design.
    limited : ResponseUncertainty, optional
        What the design was kept slower for.
    damped : DampedDesign, optional
        What the damping in front of which the controller stands is worth.
    """

    request: DesignRequest
    parameters: ControllerParameters
    margins: Margins
    sample_time: float
    tuned: Tuned | None = None
    robustness: Robustness | None = None
    limited: ResponseUncertainty | None = None
    damped: DampedDesign | None = None

    def misses(self) -> tuple[str, ...]:
        """Return what the loop misses of what every design is held to, on the model or on a plant that was drawn."""
        others = (found.misses() for found in (self.robustness, self.damped) if found is not None)
        return self.margins.misses() or next((said for said in others if said), ())


def drawn_around(robust: bool, ranges: dict) -> Uncertainty | None:
    """Return the plants of a robust design, from the options of the command.

    Parameters
    ----------
    robust : bool
        Whether one is asked.
    ranges : dict
        Values by the names of :data:`OPTIONS`; None where nothing is given.

    Raises
    ------
    ConfigurationError
        A range is given without a robust design.
    ParameterError
        A range is out of bounds; it is named by its option.
    """
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
    """Design the controller of an axis from the model in its own parameters.

    Parameters
    ----------
    axis : AxisParameters
    request : DesignRequest
    response : ResponseUncertainty, optional
        Of the model's response, see :func:`.response_uncertainty`: what was not asked for is slowed down until the loop
        is stable for all plants within it.

    Raises
    ------
    ConfigurationError
        There is no such controller, requests exclude each other, or the model is not fit for what is asked.
    ParameterError
        No design follows from the model; names what keeps it.
    """
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

    first, robust = _gains(control, request, sample_time, quiet, around)
    tuned = None
    if request.criterion:
        tuned = _tuned(axis, first.parameters, request)
        law, _ = design_of(request.controller)
        final = replace(first.parameters, **{law.name: tuned.gains})
        first = Designed(final, margins(final, sample_time))
    found = certain_design(first, design, request, response, sample_time)
    damped = None
    if control.damping.type != NONE:
        bandwidth = None
        plain = replace(request, damping=NONE, feedforward=False, preview=None)
        with contextlib.suppress(ParameterError, ConfigurationError):
            bandwidth = design_axis(axis, plain, response).margins.bandwidth
        damped = judge_damping(found.parameters, sample_time, around, bandwidth)
    # what was slowed down for what is unknown is no longer what was searched for
    kept = {"robustness": robust} if found is first else {"limited": response}
    return AxisDesign(request, found.parameters, found.margins, sample_time, tuned, damped=damped, **kept)


def _gains(
    control: ControllerParameters, request: DesignRequest, sample_time: float, quiet: float, around: PlantsAround
) -> tuple[Designed, Robustness | None]:
    """Return gains for what is asked, in front of the damping of the parameters."""
    name, q = request.controller, request.q
    if request.robust is not None:
        aimed = replace(REQUIRED, command_noise_gain=quiet)
        return design_robust(control, name, sample_time, request.robust, q, aimed=aimed)
    aimed = replace(AIMED, command_noise_gain=quiet)
    plants = () if request.damping in (None, NONE) else around.closed(control, sample_time)
    return design_gains(control, name, sample_time, request.bandwidth, q, aimed=aimed, plants=plants), None


def _tuned(axis: AxisParameters, parameters: ControllerParameters, request: DesignRequest) -> Tuned:
    """Return gains tuned on the waveform of the axis, from those of a design on."""
    law, _ = design_of(request.controller)
    start = getattr(parameters, law.name)
    changed = {"feedforward": parameters.feedforward, "damping": parameters.damping, law.name: start}
    fed = replace(axis, motion_controller=replace(axis.motion_controller, type=law.name, **changed))
    return tune(fed, law.name, request.criterion, start=start, duration=request.duration)


def _check_request(axis: AxisParameters, request: DesignRequest) -> None:
    """Refuse requests that exclude each other."""
    law, _ = design_of(request.controller)
    if request.criterion and law.tuning is None:
        tunable = " or ".join(sorted(name for name, (law, _) in DESIGNS.items() if law.tuning is not None))
        raise ConfigurationError(f"--criterion tunes a {tunable}, not {request.controller}; leave it out")
    if request.criterion and request.bandwidth is not None:
        raise ConfigurationError("--criterion and --bandwidth exclude each other; give one of them")
    if request.criterion and axis.reference_generator is None:
        raise ConfigurationError(
            "--criterion tunes on the waveform of a reference generator, and a sequencer is in its place; leave it out"
        )
    if "kalman" not in law.groups and request.q is not None:
        raise ConfigurationError(f"--q is of the Kalman filter, which {request.controller} has not; leave it out")
    if request.q is not None and not request.q > 0.0:
        raise ConfigurationError(f"--q {request.q:g}: must be above 0")
    for name, given in (("--bandwidth", request.bandwidth), ("--criterion", request.criterion)):
        if request.robust is not None and given is not None:
            raise ConfigurationError(f"--robust and {name} exclude each other: the plants decide; give one of them")
    if request.preview is not None and not request.feedforward:
        raise ConfigurationError("--preview belongs to --feedforward; give both")


def _quiet(axis: AxisParameters, noise: float | None) -> float:
    """Return by which factor the sensor's noise may reach the command."""
    if noise is not None and not noise > 0.0:
        raise ConfigurationError(f"--noise {noise:g}: must be a noise in metres above 0")
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
    return FeedforwardParameters(type="inverse_dynamics", preview=preview)


def design_file(configuration: Configuration, result: AxisDesign, namespace: str) -> str:
    """Return the text of the parameter file of a design, checked: the axis can be built from it.

    Parameters
    ----------
    configuration : Configuration
        What was designed from.
    result : AxisDesign
    namespace : str
        Of the axis.

    Raises
    ------
    ParameterError
        The axis cannot be built.
    """
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
    Axis(single_axis(parse_configuration(text, "the designed file"), namespace or None))
    return text


def _hertz(value: float) -> str:
    return "above half the sample rate" if np.isinf(value) else f"{value:.4g} Hz"


def design_lines(result: AxisDesign) -> list[str]:
    """Return the table that the command prints: gains, margins, bandwidth, poles, doubts.

    Parameters
    ----------
    result : AxisDesign
    """
    found, own = result.margins, result.parameters.before_damping(result.sample_time)
    rows = list(own.law.rows(own, result.sample_time))
    if result.tuned is not None:
        tuned = result.tuned
        state = "converged" if tuned.converged else "not converged, the best found"
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
        ("noise in displacement", f"{found.noise_gain:.3g} of the sensor's"),
        ("noise in command", f"{found.command_noise_gain:.3g} of the sensor's"),
        ("requirements", f"NOT MET: {'; '.join(result.misses())}" if result.misses() else f"met ({_required()})"),
        (
            "closed-loop poles",
            ", ".join(_pole(pole) for pole in found.poles if pole.imag >= 0.0 and abs(pole) > AT_ZERO),
        ),
    ]
    least = modes(found.poles.astype(complex), result.sample_time)[:1]
    rows += [("least damped mode", f"{hertz:.4g} Hz, damping {damping:.2g}") for hertz, damping in least]
    for further in (result.damped, result.robustness):
        if further is not None:
            rows += further.rows()
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:<{width}}  {'none' if text == ' Hz' else text}" for name, text in rows]
    return lines + [f"note: {text}" for text in doubts(result)]


def _range_words(given: Uncertainty) -> list[str]:
    """Return the options by which a command has these plants."""
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
    """Return sentences about what a user should know of a design.

    Parameters
    ----------
    result : AxisDesign
    """
    parameters = result.parameters
    found = list(parameters.warnings())
    if not parameters.model.dynamics.order:
        found.append("model.dynamics.A is empty: designed for an axis that answers within a sample; identify its model")
    misses = result.misses()
    if misses:
        found.append(
            f"marked, a comparison does not rank it: {'; '.join(misses)}; little room for a wrong model or delay, "
            "ask for another bandwidth or q"
        )
    if result.limited is not None:
        rests = result.limited.assumption(result.sample_time) or "the recording leaves the response open"
        found.append(
            f"slowed down to a bandwidth of {_hertz(result.margins.bandwidth)}, to be stable for every plant that the "
            f"recording allows: {rests}; a recording with content there (hysteresis excite --recipe multisine) may "
            "allow a faster one"
        )
    if result.damped is not None:
        found += result.damped.doubts()
    own = parameters.before_damping(result.sample_time)
    found += own.law.doubts(own, result.sample_time, result.tuned is not None)
    return found
