# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of the learned correction of an axis: closed loop, filters with contraction, and the parameter file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.learning import SAME, LearningParameters, period_samples
from hysteresis_ros.control.linearisation import TINY
from hysteresis_ros.control.margins import plant_state_space
from hysteresis_ros.control.uncertainty import (
    UNKNOWN,
    ResponseUncertainty,
    Uncertainty,
    aliased_plants,
    drawn_plants,
)
from hysteresis_ros.designs.controller import OPTIONS, learning_text
from hysteresis_ros.designs.learning_filters import (
    KINDS,
    MARGIN,
    UNSEEN,
    Filters,
    Response,
    contraction,
    design_filters,
)
from hysteresis_ros.errors import ConfigurationError, ParameterError, did_you_mean
from hysteresis_ros.identification.parameter_file import SECTION
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.controller import ControllerPart, answer
from hysteresis_ros.loop.parameters import AxisParameters, ControllerNodeParameters, part
from hysteresis_ros.loop.reach import reachable_displacements, single_axis
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.models.actuator import PreloadParameters

#: Default uncertainty of the plants: gain 5 %; all times 8 %, of which 3 % are due to the identification; residual
#: hysteresis after the inverse; and a fraction of a sample of delay.
POSSIBLE = Uncertainty(gain=0.05, hysteresis=0.1, resonance=0.08, delay=0.25, draws=40)
#: Largest correction, as a fraction of the stroke, unless one is requested.
MAXIMUM = 0.1
#: Largest saturation (command minus achieved command) at which learning continues, as a fraction of the stroke.
SHORTFALL = 5e-3
#: Initial learning gain.
GAIN = 0.7
#: Constant c of the gain c/n in period n, which is used when it is below the initial gain.
AVERAGING = 4.0
#: Lower limit of the learning gain.
LEAST_GAIN = 0.05
#: Number of learning periods after which the error is predicted.
LEARNED = 20
#: Numbers of periods of the runs without learning that give the repeating error; the first run that settles is used.
RUNS = (6, 24, 96)
#: Maximum number of samples of these runs, except the first.
LONGEST_RUN = 1_000_000
#: Minimum number of samples of an impulse response.
SHORTEST = 2**12
#: Maximum number of samples of an impulse response.
LONGEST = 2**17
#: Largest value that may remain in the last sixteenth of an impulse response, as a fraction of its peak.
LEFT = 1e-6
#: Maximum number of frequencies.
MOST = 2**13
#: A closed loop has settled when at most this fraction of its response remains.
SETTLED = 0.02
#: Number of samples before an impulse, in which flags and counters reach their steady values.
BEFORE = 4
#: Relative uncertainty of the response above which nothing is learned, because the error would contract slowly at best.
LEARNABLE = 0.5
#: Directions (phases) in which a relative uncertainty of the response is tried.
DIRECTIONS = np.exp(0.25j * np.pi * np.arange(8))


#: Kind of learning that learns the corrections of all axes of a stage together, from run to run.
COUPLED = "coupled"


@dataclass(frozen=True)
class LearningRequest:
    """Options of a design of learning."""

    kind: str  #: ``inversion``, ``norm_optimal``, ``repetitive`` or ``coupled``.
    period: float | None = None  #: Period of the reference [s]; by default the period of the configured waveform.
    #: Bandwidth of the learning [Hz]; by default the one with the least predicted error; without a prediction, the
    #: highest one with contraction.
    bandwidth: float | None = None
    maximum: float | None = None  #: Largest correction [m]; by default :data:`MAXIMUM` of the stroke.
    possible: Uncertainty = field(default=POSSIBLE)  #: Plants on which the error must contract.


#: Command-line options of a design of learning, except the ranges.
TAKES = ("learning", "period", "bandwidth", "maximum")
#: Command-line options that only a design of learning has, except the ranges.
OWN = ("learning", "period", "maximum")


def asked(options: dict) -> LearningRequest | None:
    """Return the learning request in command-line options; None if they request a controller."""
    given = {name: value for name, value in options.items() if value is not None and value is not False}
    ranges = {
        name: given.pop(option.replace("-", "_"))
        for name, option in OPTIONS.items()
        if option.replace("-", "_") in given
    }
    for name in OWN:
        options.pop(name)
    kind = given.get("learning")
    if kind is None:
        if "controller" not in given:
            raise ConfigurationError("nothing to design: give --controller NAME or --learning NAME")
        for name in OWN:
            if name in given:
                raise ConfigurationError(f"--{name} belongs to --learning; give both")
        return None
    for name in given:
        if name not in TAKES:
            raise ConfigurationError(
                f"--{name} and --learning exclude each other, because learning uses the controller of the "
                "file; design the controller first"
            )
    kinds = (*sorted(KINDS), COUPLED)
    if kind not in kinds:
        known = ", ".join(kinds)
        raise ConfigurationError(f"--learning {kind}: unknown design; there are {known}{did_you_mean(kind, kinds)}")
    maximum = given.get("maximum")
    if maximum is not None and not 0.0 < maximum <= 1.0:
        raise ConfigurationError(f"--maximum {maximum:g}: must be > 0 m and ≤ 1 m")
    possible = {item.name: getattr(POSSIBLE, item.name) for item in fields(POSSIBLE)}
    try:
        plants = Uncertainty(**possible | ranges)
    except ParameterError as error:
        named = [replace(problem, name=f"--{OPTIONS[problem.name]}") for problem in error.problems]
        raise ParameterError(named) from None
    return LearningRequest(kind, given.get("period"), given.get("bandwidth"), maximum, plants)


@dataclass(frozen=True, eq=False)
class LearningDesign:
    """A designed correction."""

    request: LearningRequest
    parameters: LearningParameters
    filters: Filters
    response: Response  #: The closed loop of the design.
    sample_time: float  #: [s]
    #: Whether the bandwidth was chosen without regard to sensor noise, because the reference is unknown.
    unweighed: bool = False

    def rate(self, possible: np.ndarray) -> float:
        """Return the factor by which the slowest part of the error falls in a period, at the initial learning gain."""
        angles = np.linspace(0.0, np.pi, possible.shape[1])
        low_pass, learning = self.filters.responses(angles)
        return float(np.max(contraction(low_pass, learning, possible, self.parameters.gain)))


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """Measured response of a plant, divided by the response of its model."""

    frequency: np.ndarray  #: shape (F,) [Hz], rising.
    ratio: np.ndarray  #: shape (F,); Ratio at the lines; beyond them, at() uses the nearest line.

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """Return the interpolated ratio at any frequencies.

        Units: ``frequency`` [Hz].
        """
        parts = (np.interp(frequency, self.frequency, part) for part in (self.ratio.real, self.ratio.imag))
        real, imaginary = parts
        return real + 1j * imaginary


def closed_loop(
    node: ControllerNodeParameters, possible: Uncertainty, response: ResponseUncertainty | MeasuredPlant | None = None
) -> Response:
    """Return the closed loop from reference to displacement, for the model and for all possible plants.

    u_r and u_d are the commands of the controller (feedforward, law and all other blocks) after an impulse of the
    reference and of the measurement, with the model P as plant. For another plant P' the closed loop is T' = P' u_r /
    (1 − u_d (P' − P)).
    """
    sample_time, dynamics = 1.0 / node.sample_rate, node.model.dynamics
    model, observed = plant_state_space(dynamics), plant_state_space(dynamics, acting=True)
    count = SHORTEST
    while True:
        answers = [_impulse(node, observed, count, *one) for one in ((TINY, 0.0), (0.0, TINY))]
        if all(np.max(np.abs(u[-count // 16 :])) <= LEFT * np.max(np.abs(u)) for u in answers):
            break
        count *= 2
        if count > LONGEST:
            raise ConfigurationError(
                "the closed loop does not settle with its own model, so learning is not possible; design the "
                "controller first (hysteresis design --controller)"
            )
    every = max(count // (2 * MOST), 1)
    angles = np.linspace(0.0, np.pi, count // 2 + 1)[::every]
    z = np.exp(1j * np.maximum(angles, 1e-7))
    asked, disturbed = (np.fft.rfft(u)[::every] for u in answers)
    own = model.response(z)[:, 0, 0]
    plants = (*drawn_plants(dynamics, sample_time, possible), *aliased_plants(dynamics, sample_time, possible))
    others = [one.plant.response(z)[:, 0, 0] for one in plants]
    centre = own
    if isinstance(response, MeasuredPlant):
        ratio = response.at(angles / (2.0 * np.pi * sample_time))
        others, centre = [other * ratio for other in others], own * ratio
    elif response is not None:
        unknown = response.at(angles / (2.0 * np.pi * sample_time))
        unknown = np.where(unknown > LEARNABLE, UNKNOWN, unknown)
        others += [own * (1.0 + unknown * direction) for direction in DIRECTIONS]
    model, *found = (other * asked / (1.0 - disturbed * (other - own)) for other in (centre, *others))
    noise = 1.0 + own * disturbed
    return Response(model, np.array(found), own * asked, own * noise, noise)


def _impulse(node: ControllerNodeParameters, model, count: int, reference: float, measured: float) -> np.ndarray:
    """Return the closed loop's commands, shape (count,), after an impulse, divided by :data:`TINY`.

    ``reference`` and ``measured`` are the impulse heights in these signals: :data:`TINY` in one, 0 in the other.
    ``model`` is the linear plant.
    """
    control, sample_time = part(node, ControllerParameters), 1.0 / node.sample_rate
    resting = replace(control, model=replace(control.model, preload=PreloadParameters()), learning=LearningParameters())
    resting = resting.law.near_rest(resting)
    loop = ControllerPart(replace(node, **{item.name: getattr(resting, item.name) for item in fields(resting)}))
    laws, arrays = Laws(*(loop.kernel,) * len(Laws._fields)), loop.arrays
    for _ in range(BEFORE):
        answer(laws, arrays, 0.0, 0.0, 0.0)
    A, B, C, force = model.A, model.B[:, 0], model.C, resting.model.force
    slow_part, slow = force.slow_part(sample_time), 0.0
    x, commands = np.zeros(len(A)), np.empty(count)
    for k in range(count):
        displacement, acting = C @ x
        displacement += measured
        # the force in the stack decreases with the displacement, and the force sensor removes its slow part
        pressed = force.whole * acting - force.stack_stiffness * displacement - slow
        slow += slow_part * pressed
        commands[k] = answer(laws, arrays, displacement, reference, pressed)
        x = A @ x + B * commands[k]
        reference = measured = 0.0
    return commands / TINY


def design_learning(
    axis: AxisParameters, request: LearningRequest, response: ResponseUncertainty | MeasuredPlant | None = None
) -> LearningDesign:
    """Design the correction of an axis for its own controller and model."""
    node = axis.motion_controller
    rate = node.sample_rate
    period = request.period if request.period is not None else waveform_period(axis)
    samples = period_samples(period, rate, "--period" if request.period is not None else "waveform.frequency")
    bandwidth = request.bandwidth
    if bandwidth is not None and not 0.0 < bandwidth < 0.5 * rate:
        raise ConfigurationError(
            f"--bandwidth {bandwidth:g}: must be above 0 and below half the sample rate, {rate / 2:g} Hz"
        )
    loop = closed_loop(node, request.possible, response)
    error = None if bandwidth is not None else expected_error(axis, request.possible, loop, samples)
    filters = design_filters(request.kind, loop, samples, None if bandwidth is None else bandwidth / rate, rate, error)
    low, high = reachable_displacements(axis)
    maximum = request.maximum if request.maximum is not None else MAXIMUM * (high - low)
    parameters = LearningParameters(
        type=request.kind,
        period=samples / rate,
        error_filter=tuple(filters.error.tolist()),
        lead=filters.lead,
        robustness_filter=tuple(filters.robustness.tolist()),
        gain=GAIN,
        averaging=AVERAGING,
        least_gain=LEAST_GAIN,
        maximum=float(f"{maximum:.4g}"),
        recovery=settling(loop) / rate,
        late_recovery=min(knocked(loop), settling(loop)) / rate,
        shortfall=float(f"{SHORTFALL * (high - low):.4g}"),
    )
    unweighed = bandwidth is None and error is None and axis.plant_simulator.sensor.noise > 0.0
    return LearningDesign(request, parameters.validated("learning."), filters, loop, 1.0 / rate, unweighed)


def with_known_noise(axis: AxisParameters, configuration: Configuration) -> AxisParameters:
    """Return the axis with the sensor noise of its identification, unless its sensor already has noise."""
    found = next((values for name, values in configuration.entries if name == SECTION), {}).get("metrics.noise_rms_m")
    plant = axis.plant_simulator
    if plant.sensor.noise or not isinstance(found, float) or not 0.0 < found < np.inf:
        return axis
    return replace(axis, plant_simulator=replace(plant, sensor=replace(plant.sensor, noise=found)))


def expected_error(
    axis: AxisParameters, possible: Uncertainty, loop: Response, period: int
) -> Callable[[Filters], float] | None:
    """Return a function that predicts the RMS error [m] of filters after :data:`LEARNED` periods of learning.

    The result is None if the sensor has no noise, because then the highest bandwidth is the best. It is also None if
    the reference of the axis does not repeat with the period, because then the error is unknown. The repeating error
    without learning is taken from a run of the axis on its own plant. Errors due to the inverse's model and due to
    another linear response are added, according to the ranges of the possible plants. Learning leaves (1 − Q)/(1 − Q +
    G T) of the repeating error, and adds the noise that its averaging does not remove.

    Units: ``period`` [samples].
    """
    sensor = axis.plant_simulator.sensor
    variance = sensor.noise**2 + sensor.resolution**2 / 12.0
    found = None if not variance or axis.reference_generator is None else _repeated(axis, period)
    if found is None:
        return None
    reference, error = found
    inverse = axis.hysteresis_compensator.inverse
    if inverse.type != "none":
        plain = replace(axis.hysteresis_compensator, inverse=replace(inverse, type="none"))
        without = _repeated(replace(axis, hysteresis_compensator=plain), period)
        error = np.hypot(np.abs(error), possible.hysteresis * np.abs(error if without is None else without[1]))
    grid, lines = np.linspace(0.0, np.pi, len(loop.model)), 2.0 * np.pi * np.arange(period // 2 + 1) / period
    off = np.interp(lines, grid, np.max(np.abs(loop.possible - loop.model), axis=0))
    power = np.abs(error) ** 2 + np.abs(off * reference) ** 2
    power[1 : (period + 1) // 2] *= 2.0
    power /= period**2
    closed = np.interp(lines, grid, loop.model.real) + 1j * np.interp(lines, grid, loop.model.imag)
    assert loop.noise is not None
    passed = np.abs(loop.model * loop.noise) ** 2 * variance
    gains = np.minimum(GAIN, AVERAGING / np.arange(1, LEARNED + 1))

    def expected(filters: Filters) -> float:
        low_pass, learning = filters.responses(lines)
        learned = 1.0 - low_pass + learning * closed  # per period, for a gain of 1
        remains = np.prod(1.0 - gains[:, np.newaxis] * learned, axis=0)
        limit = (1.0 - low_pass) / np.where(np.abs(learned) > TINY, learned, TINY)
        left = np.abs(limit + (1.0 - limit) * remains)
        low_pass, learning = filters.responses(grid)
        averaged, learned = np.zeros(len(grid)), 1.0 - low_pass + learning * loop.model
        for gain in gains:
            averaged = np.abs(1.0 - gain * learned) ** 2 * averaged + gain**2
        noise = np.mean(passed * np.abs(learning) ** 2 * averaged)
        return float(np.sqrt(np.sum(power * left**2) + noise))

    return expected


def _repeated(axis: AxisParameters, period: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the spectra of reference and error in a period without learning and noise, shape (N // 2 + 1,).

    None if the reference is at rest, or does not repeat with the period.
    """
    plant, node = axis.plant_simulator, axis.motion_controller
    silent = replace(plant, sensor=replace(plant.sensor, noise=0.0, resolution=0.0))
    made = Axis(replace(axis, plant_simulator=silent, motion_controller=replace(node, learning=LearningParameters())))
    for periods in RUNS:  # longer runs if the axis is still approaching its reference
        if periods > RUNS[0] and periods * period > LONGEST_RUN:
            break
        run = made.run(made.default_setpoints(periods * period))
        reference, measured = (run[name][-2 * period :].reshape(2, period) for name in ("reference", "measured"))
        error = reference[1] - measured[1]
        if np.max(np.abs(np.diff(reference, axis=0))) < SAME and np.all(np.isfinite(error)):
            return None if np.ptp(reference) < SAME else (np.fft.rfft(reference[1]), np.fft.rfft(error))
    return None


def settling(loop: Response) -> int:
    """Return the settling time of the identified closed loop after a step [samples]."""
    assert loop.identified is not None
    answer = np.cumsum(np.abs(np.fft.irfft(loop.identified)))
    return int(np.searchsorted(answer, (1.0 - SETTLED) * answer[-1]))


def knocked(loop: Response) -> int:
    """Return the time in which the identified closed loop recovers from a single wrong voltage [samples].

    The loop has recovered when the response stays below :data:`SETTLED` of its largest value.
    """
    assert loop.pushed is not None
    answer = np.abs(np.fft.irfft(loop.pushed))
    return int(np.flatnonzero(answer > SETTLED * np.max(answer))[-1]) + 1


def waveform_period(axis: AxisParameters) -> float:
    """Return the period of the configured waveform [s]."""
    missing = "--period is missing: {} has no period; give the period of the reference [s]"
    waveform = axis.require_generator(missing.format("a sequencer")).waveform
    if waveform.type not in PERIODIC or not waveform.frequency > 0.0:
        raise ConfigurationError(missing.format(f"waveform.type {waveform.type}"))
    return 1.0 / waveform.frequency


#: Waveforms whose period is 1/``frequency``.
PERIODIC = ("sine", "triangle", "square")


def learning_lines(result: LearningDesign) -> list[str]:
    """Return the printed table."""
    filters, given, ranges = result.filters, result.parameters, result.request.possible
    rate, worst = 1.0 / result.sample_time, result.rate(result.response.possible)
    nominal = result.rate(result.response.model[np.newaxis])
    noisy = f"; it contracts up to {filters.highest * rate:.4g} Hz, but noise would add more" if filters.highest else ""
    if result.unweighed:
        noisy = f"; noise is weighed only for waveforms {', '.join(PERIODIC)} of {given.period:g} s in the file"
    limited = f"|Q - G T| + {UNSEEN:g} |G|, at most {1.0 - MARGIN:g}"
    rows = [
        ("learning", given.type),
        ("period", f"{given.period:g} s, {round(given.period * rate)} samples"),
        ("bandwidth of learning", f"{filters.bandwidth * rate:.4g} Hz{noisy}"),
        ("taps", f"{len(filters.error)} of the error, {2 * len(filters.robustness) - 1} of Q"),
        ("lead of the filter", f"{filters.lead} samples"),
        ("contraction", f"{filters.contraction:.3f} at {filters.worst * rate:.4g} Hz ({limited})"),
        ("on the model", f"{filters.nominal:.3f}"),
        ("plants", f"{len(result.response.possible)}: {_ranges(ranges)}"),
        ("error falls", f"to {worst:.3f} or less per period, with gain {given.gain:g}; {nominal:.3f} on the model"),
        ("periods to a tenth", f"{periods_to(worst)} at most, {periods_to(nominal)} on the model"),
        ("largest correction", f"{1e6 * given.maximum:.4g} µm"),
    ]
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {text}" for name, text in rows]


def periods_to(rate: float, part_left: float = 0.1) -> int:
    """Return the number of periods in which an error falls to ``part_left``; ``rate`` is the factor per period."""
    return math.ceil(math.log(part_left) / math.log(rate))


def _ranges(ranges: Uncertainty) -> str:
    return (
        f"gain ±{100.0 * ranges.gain:g} %, hysteresis ±{100.0 * ranges.hysteresis:g} %, times "
        f"±{100.0 * ranges.resonance:g} %, up to {ranges.delay:g} samples later, seed {ranges.seed}"
    )


def learning_file(configuration: Configuration, result: LearningDesign, namespace: str) -> str:
    """Return the text of the parameter file with a designed correction, after a check that the axis can be built."""
    rate, filters = 1.0 / result.sample_time, result.filters
    source = configuration.source.replace("\\", "/").rsplit("/", 1)[-1]
    words = (
        f"Learning designed by `hysteresis design {source} --learning {filters.kind} --period "
        f"{result.parameters.period:g}`\n"
        f"over the controller of this file: bandwidth {filters.bandwidth * rate:.4g} Hz, contraction "
        f"{filters.contraction:.3f} with {_ranges(result.request.possible)}."
    )
    text = learning_text(configuration, result.parameters, namespace, words)
    text = with_safe_motion(text, "the designed file", namespace)
    Axis(single_axis(parse_configuration(text, "the designed file"), namespace or None))
    return text
