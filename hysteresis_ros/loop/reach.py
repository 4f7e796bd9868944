# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axes of a configuration, and the check that their references stay within stroke and bandwidth.

The range is computed from the models of compensator and controller, because the parameters of a real plant are unknown.

*Stroke*: the range of the compensator's hysteresis model, swept from rest to both voltage limits without creep, times
the DC gain of the controller's model. With inverse ``none`` it is the nominal gain times the limits. Steps that briefly
need more than the stroke are not refused.

*Bandwidth* is checked for waveforms with one fundamental frequency f in closed loop. Open loops, chirps, multisines and
files are experiments and are not checked. The checks are:

- The command that produces the fundamental through the controller's dynamics, amplitude / |G(f)|, must fit into the
  stroke. The limit is the stroke and not the -3 dB frequency, because feedback and inverse dynamics work above that
  frequency as long as the stroke suffices. Waveforms with jumps (square) are steps, and are not checked.
- A response that lags by d samples (the relative degree) has an error of 2 sin(π f d Ts) times the amplitude. Above f =
  1/(6 d Ts) the error is larger than the amplitude. Only the preview of ``inverse_dynamics`` avoids this delay.
- The velocity of the waveform, divided by the mean gain of the model, must be within the slew rate of the voltage.

The last check also gives warnings for other waveforms and in open loop. The velocity of a step is its height divided
by the time until the next step.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import fields, replace

import numpy as np

from hysteresis_ros.configuration import Configuration, Parameters
from hysteresis_ros.control.feedforward import relative_degree
from hysteresis_ros.control.learning import SAME, period_samples, read_learned, shortest_period
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.loop.inchworm_checks import inchworm_warnings
from hysteresis_ros.loop.parameters import AxisParameters, part
from hysteresis_ros.models.compensator import reachable_commands
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.references.waveforms import Waveform
from hysteresis_ros.references.waveforms.file import LARGEST_TABLE
from hysteresis_ros.units import micrometres, readable

#: Allowed distance of a reference beyond the stroke, as a fraction of the stroke, for rounding and integrated sweeps.
TOLERANCE = 1e-4
#: Allowed distance of the fundamental's command beyond the stroke, as a fraction of the stroke; within it, only the
#: peaks of the waveform saturate.
CUT_PEAKS = 0.1
#: Smallest number of samples per period that resolves both extremes.
FEWEST_SAMPLES = 4


def reachable_displacements(axis: AxisParameters) -> tuple[float, float]:
    """Return the smallest and largest displacement [m] at rest, without preload, from the models of the axis."""
    gain = _gain(axis.motion_controller.model.dynamics)
    low, high = reachable_commands(axis.hysteresis_compensator, 1.0 / axis.plant_simulator.sample_rate)
    return min(low * gain, high * gain), max(low * gain, high * gain)


def _gain(dynamics: LinearParameters, turns: float = 0.0) -> float:
    """Return |G| in SI units at ``turns`` cycles per sample; at 0 return the DC gain with its sign."""
    model = dynamics.state_space
    scale = dynamics.output_scale / dynamics.resolved_input_scale
    if turns == 0.0:
        return model.dc_gain * scale
    return float(abs(model.held().response([cmath.exp(2j * math.pi * turns)]).item())) * scale


def check_reach(axis: AxisParameters) -> None:
    """Refuse a reference that the axis cannot follow."""
    if axis.plant_simulator.type != "actuator":
        return  # the reference of an inchworm motor comes from its sequencer
    given = part(axis.generator, ReferenceParameters)
    try:
        generator = ReferenceGenerator(given, 1.0 / axis.plant_simulator.sample_rate)
    except ParameterError as error:
        named = [replace(problem, name=f"reference_generator: {problem.name}") for problem in error.problems]
        raise ParameterError(named) from None
    problems = [*_bare_steps(axis, given), *_beyond_stroke(axis, given, generator)]
    if not problems and axis.motion_controller.law.feedback and given.waveform.shape.periodic:
        problems = [
            *_too_late(axis, given),
            *_too_fast(axis, given, generator, CUT_PEAKS),
            *([] if given.waveform.shape.jumps else _too_steep(axis, given, generator, CUT_PEAKS)),
        ]
    if problems:
        raise ParameterError(problems)


def reach_warnings(axis: AxisParameters, reach: tuple[float, float] | None = None) -> tuple[str, ...]:
    """Return the warnings about an axis: parameters of its nodes, setpoints that saturate, fast waveforms.

    ``reach`` is the range of its setpoints [m]; by default that of its own actuator.
    """
    parts = {item.name: getattr(axis, item.name) for item in fields(axis)}
    found = [
        text for name, node in parts.items() if isinstance(node, Parameters) for text in node.warnings(f"{name}: ")
    ]
    if axis.inchworm_sequencer is not None:
        return (*found, *inchworm_warnings(axis.plant_simulator, axis.inchworm_sequencer))
    given = part(axis.generator, ReferenceParameters)
    low, high = reach or reachable_displacements(axis)
    slack = TOLERANCE * (high - low)
    for name, beyond in (("minimum", given.minimum < low - slack), ("maximum", given.maximum > high + slack)):
        if beyond:
            found.append(
                f"reference_generator: {name} = {micrometres(getattr(given, name))} is beyond the range of the "
                f"compensator's model, {micrometres(low, high)}: setpoints beyond it saturate"
            )
    generator = ReferenceGenerator(given, 1.0 / axis.plant_simulator.sample_rate)
    if axis.motion_controller.law.feedback and given.waveform.shape.periodic:
        found += [str(problem) for problem in _too_fast(axis, given, generator, TOLERANCE)]
    found += steep_warnings(axis)
    found += _unlearned(axis, given)
    problem = generator.unreached_level()
    return (*found, f"reference_generator: {problem}") if problem else tuple(found)


def _unlearned(axis, given: ReferenceParameters):
    """Yield a warning if a correction is learned for another period or another path than that of the waveform."""
    learning, rate = axis.motion_controller.learning, axis.plant_simulator.sample_rate
    if not learning.in_use or given.waveform.type == "none":
        return
    count, waveform = period_samples(learning.period, rate), Waveform(replace(given.waveform, cycles=0), 1.0 / rate)
    if waveform.period is not None and waveform.period <= LARGEST_TABLE:
        path = waveform.simulate(np.zeros(waveform.period))
        period = shortest_period(path)
        other, path = count % period != 0, np.resize(path, count)
    elif given.waveform.shape.periodic:
        period, path = rate / given.waveform.frequency, waveform.simulate(np.zeros(count))
        other = round(count / period) < 1 or abs(count - round(count / period) * period) > 1.0
    else:
        return
    if other:
        period = rate / given.waveform.frequency if given.waveform.shape.periodic else period
        yield (
            f"motion_controller: learning.period = {readable(learning.period, 's')} is not a whole number of periods "
            f"of the waveform, {readable(period / rate, 's')}: nothing is learned, and a learned correction "
            "is removed; design the learning for this waveform (hysteresis design --learning)"
        )
    elif learning.file and not (given.waveform.shape.jumps and given.approach.steps):
        other_path = _other_path(read_learned(learning.file).reference, given.initial_setpoint + path)
        if other_path:
            after = "learning starts without it" if learning.active else "nothing is learned (learning.active is false)"
            yield f"motion_controller: learning.file {other_path}: its correction is removed, and {after}"


def _other_path(learned: np.ndarray, wanted: np.ndarray) -> str:
    """Return how the path [m] of a learned correction differs from the path of the waveform; empty if it does not."""
    if len(learned) != len(wanted) or np.max(np.abs(learned - wanted)) <= SAME:
        return ""
    # sorted and without its mean, a sampled path is the same for any phase, number of periods and setpoint
    away = np.mean(learned) - np.mean(wanted)
    if np.max(np.abs(np.sort(learned) - np.sort(wanted) - away)) <= SAME:
        if abs(away) > SAME:
            side = "above" if away > 0.0 else "below"
            return f"was learned {readable(abs(away), 'm')} {side} this path (initial_setpoint, waveform.offset)"
        return "was learned with another phase or frequency of the waveform"
    heights = [readable(np.ptp(one), "m") for one in (learned, wanted)]
    if heights[0] == heights[1]:
        return "was learned with another waveform of the same height"
    return f"was learned on a path of {heights[0]}, but the waveform has a path of {heights[1]}"


def _bare_steps(axis, given: ReferenceParameters):
    feedforward, approach = axis.motion_controller.feedforward, given.approach
    if not feedforward.inverts or not given.waveform.shape.jumps or (approach.steps and not approach.unlimited):
        return
    add = "give approach.maximum_velocity, maximum_acceleration and maximum_jerk, and " if approach.unlimited else ""
    remedy = (
        f"jumps, and feedforward.type {feedforward.type} saturates the voltage at a jump: {add}set approach.steps: "
        "true, which applies the limits of the approach to steps, or choose feedforward.type static or none"
    )
    yield Problem("reference_generator: waveform.type", given.waveform.type, remedy)


def _beyond_stroke(axis, given: ReferenceParameters, generator: ReferenceGenerator):
    low, high = reachable_displacements(axis)
    slack = TOLERANCE * (high - low)
    limits, around = axis.hysteresis_compensator.limits, given.initial_setpoint
    reached = f"{micrometres(low, high)} within limits.minimum … maximum = {limits.minimum:g} … {limits.maximum:g} V"
    if not low - slack <= around <= high + slack:
        remedy = f"{micrometres(around)} is out of range: the range of the compensator's model is {reached}"
        yield Problem("reference_generator: initial_setpoint", around, remedy)
        return
    waveform = generator.waveform
    for value in (around + waveform.lowest, around + waveform.highest):
        if not low - slack <= value <= high + slack:
            name = given.waveform.shape.extent
            remedy = (
                f"the waveform {given.waveform.type} around the setpoint {micrometres(around)} goes to "
                f"{micrometres(value)}, out of range: the range of the compensator's model is {reached}; change the "
                "waveform or widen the limits"
            )
            yield Problem(f"reference_generator: waveform.{name}", given.waveform.to_mapping()[name], remedy)
            return


def _too_late(axis, given: ReferenceParameters):
    control, rate = axis.motion_controller, axis.plant_simulator.sample_rate
    if control.feedforward.type == "inverse_dynamics" and control.feedforward.preview:
        return
    degree = relative_degree(control.model.dynamics)
    highest = rate / (6.0 * degree)
    if given.waveform.frequency > highest:
        late = "a sample" if degree == 1 else f"{degree} samples"
        remedy = (
            f"must be ≤ {highest:.6g} Hz: the model responds {late} late, so above this frequency the error is larger "
            "than the waveform; lower it, raise sample_rate, or give feedforward.type: inverse_dynamics with preview"
        )
        yield Problem("reference_generator: waveform.frequency", given.waveform.frequency, remedy)


def _too_fast(axis, given: ReferenceParameters, generator: ReferenceGenerator, margin: float):
    waveform, dynamics = given.waveform, axis.motion_controller.model.dynamics
    if waveform.shape.fundamental is None:
        return
    passed = _gain(dynamics, waveform.frequency / axis.plant_simulator.sample_rate)
    low, high = reachable_commands(axis.hysteresis_compensator, 1.0 / axis.plant_simulator.sample_rate)
    lowest, highest = generator.waveform.lowest, generator.waveform.highest
    middle = (given.initial_setpoint + 0.5 * (lowest + highest)) / _gain(dynamics)
    half = waveform.shape.fundamental(waveform) * 0.5 * (highest - lowest)
    slack = margin * (high - low)
    room = min(middle - low, high - middle) + slack
    if half > passed * room:
        needed = micrometres(middle - half / passed, middle + half / passed) if passed > 0.0 else "any size"
        remedy = (
            f"the dynamics of motion_controller's model pass {100.0 * passed:.3g} % at this frequency: the "
            f"{waveform.type} needs commands of {needed}, but the range is {micrometres(low, high)}; lower frequency "
            "or amplitude"
        )
        yield Problem("reference_generator: waveform.frequency", waveform.frequency, remedy)


def _too_steep(axis, given: ReferenceParameters, generator: ReferenceGenerator, margin: float):
    waveform, shape, limits = given.waveform, given.waveform.shape, axis.hysteresis_compensator.limits
    if shape.jumps and given.approach.steps and not given.approach.unlimited:
        return  # the approach limits the velocity
    low, high = reachable_displacements(axis)
    gain = (high - low) / (limits.maximum - limits.minimum)
    rates = (node.limits.slew_rate for node in (axis.plant_simulator, axis.hysteresis_compensator))
    slew = min((one for one in rates if one > 0.0), default=math.inf)
    velocity = generator.largest_velocity
    if not velocity > gain * slew * (1.0 + margin):
        return
    name, value = shape.extent, waveform.to_mapping()[shape.extent]
    remedy = "make it slower or smaller"
    if shape.periodic:
        name, value = "frequency", waveform.frequency
        slow = replace(waveform, frequency=1e-3 / generator.sample_time)
        share = gain * slew / ReferenceGenerator(replace(given, waveform=slow), generator.sample_time).largest_velocity
        smaller = readable(waveform.amplitude * gain * slew / velocity, "m")
        remedy = f"lower it to {slow.frequency * share:.4g} Hz, or amplitude to {smaller}"
    yield Problem(
        f"reference_generator: waveform.{name}",
        value,
        f"the {waveform.type} needs {readable(velocity / gain, 'V')}/s, but limits.slew_rate allows "
        f"{readable(slew, 'V')}/s; {remedy}",
    )


def steep_warnings(axis: AxisParameters) -> tuple[str, ...]:
    """Return the warnings about a waveform that the slew rate limits, or that has too few samples per period."""
    given, rate = part(axis.generator, ReferenceParameters), axis.plant_simulator.sample_rate
    found = [*_too_steep(axis, given, ReferenceGenerator(given, 1.0 / rate), TOLERANCE)]
    waveform = given.waveform
    if waveform.shape.periodic and FEWEST_SAMPLES * waveform.frequency > rate:
        remedy = (
            f"{rate / waveform.frequency:.3g} samples per period do not resolve the {waveform.type}; lower it to "
            f"{rate / FEWEST_SAMPLES:g} Hz, or raise sample_rate"
        )
        found.append(Problem("reference_generator: waveform.frequency", waveform.frequency, remedy))
    return tuple(map(str, found))


def axes(configuration: Configuration, namespace: str | None = None) -> list[AxisParameters]:
    """Return every axis of a configuration, or only the axis in ``namespace``."""
    spaces = configuration.namespaces() if namespace is None else (namespace,)
    found = [AxisParameters.from_configuration(configuration, space) for space in spaces]
    for axis in found:
        check_reach(axis)
    clocks = [axis.namespace or "/" for axis in found if axis.plant_simulator.publish_clock]
    if len(clocks) > 1:
        raise ConfigurationError(
            f"{configuration.source}: {' and '.join(clocks)} both set publish_clock; /clock may have only one "
            "publisher: set publish_clock: true for one plant_simulator only"
        )
    return found


def single_axis(configuration: Configuration, namespace: str | None = None) -> AxisParameters:
    """Return the only axis of a configuration, or the axis in ``namespace``."""
    found = axes(configuration, namespace)
    if len(found) > 1:
        names = ", ".join(axis.namespace for axis in found)
        raise ConfigurationError(
            f"{configuration.source}: contains several axes ({names}); choose one with --namespace"
        )
    return found[0]
