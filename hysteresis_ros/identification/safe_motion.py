# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Safe speed of an axis: rate limits of voltage and setpoint, written into parameter files with their reasons.

*Slew rate of the voltage*: the smallest of the known limits. Possible limits are the slew rate of the amplifier, twice
the largest slew rate in a recording, and the voltage range divided by one period of the lowest resonance (for a model
without a resonance, by its slowest time constant). If no limit is known, the slew rate is the voltage range divided by
:data:`FIRST_SECONDS`.

*Approach to setpoints*: half of the slew rate is reserved for the setpoint, the other half for feedback and hysteresis.
The approach is a ramp filtered by two moving averages (:mod:`hysteresis_ros.references.approach`). Each average lasts
one period of the resonance and has a zero at the frequency of the resonance. Together they have a double zero there, so
a change of the setpoint causes little vibration even if the frequency is wrong by some per cent.

*The first motion* keeps the limits too if the initial setpoint is not 0 m, and on each axis of a stage: the reference
begins at the rest position instead of at the initial setpoint. A stated `approach.from_rest` is not changed.

*Steps of a waveform* also keep the limits of the approach in a closed loop, unless the file states `approach.steps`,
and always with a feedforward that inverts the dynamics.

A limit above 0 in a file is never replaced.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import yaml

from hysteresis_ros.configuration import dump_configuration, matches, normalised_namespace, parse_configuration
from hysteresis_ros.control.controller import LAWS
from hysteresis_ros.control.damping.inner_loop import modes
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.files import FAST_LOADER
from hysteresis_ros.models.compensator import CompensatorParameters, reachable_commands
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.linear_algebra import eigenvalues
from hysteresis_ros.units import shown_unit

#: Time [s] for the whole voltage range if no limit is known.
FIRST_SECONDS = 1.0
#: Ratio of the slew rate to the largest slew rate in the recording, unless this is slower than the range in
#: FIRST_SECONDS.
ROOM = 2.0
#: Fraction of the slew rate that is reserved for setpoints.
FOR_SETPOINTS = 0.5
#: Damping ratio from which on a mode is not a resonance.
NO_RESONANCE = 0.5
#: Magnitude up to which a pole is part of a delay.
DELAY = 1e-3
#: Length of each moving average without a known resonance, as a fraction of the time to cross the stroke.
UNKNOWN_PART = 0.1
#: Number of digits of written limits; they are not more accurate.
DIGITS = 3
NODES = ("plant_simulator", "hysteresis_compensator")
APPROACH = ("maximum_velocity", "maximum_acceleration", "maximum_jerk")


@dataclass(frozen=True)
class Slew:
    """A slew rate [V/s] and its reason."""

    rate: float
    reason: str


def largest_change(voltage: np.ndarray, sample_time: float) -> float:
    """Return the largest rate of change of a recorded voltage [V/s]; 0 for fewer than two samples."""
    changes = np.abs(np.diff(voltage))
    return float(np.nanmax(changes)) / sample_time if np.isfinite(changes).any() else 0.0


def slowest(dynamics: LinearParameters, sample_time: float) -> tuple[float, bool]:
    """Return the lowest resonance of a model [Hz] and True, or else the rate of its slowest lag [1/s] and False."""
    return slowest_of(dynamics.state_space.A, sample_time) if dynamics.order else (0.0, False)


def slowest_of(A: np.ndarray, sample_time: float) -> tuple[float, bool]:
    """Return the result of :func:`slowest` for a state matrix."""
    poles = np.asarray(eigenvalues(A), dtype=complex)
    resonances = [hertz for hertz, damping in modes(poles, sample_time) if damping < NO_RESONANCE]
    if resonances:
        return min(resonances), True
    sizes = [abs(pole) for pole in poles if DELAY < abs(pole) < 1.0]
    return (-float(np.log(max(sizes))) / sample_time, False) if sizes else (0.0, False)


def safe_slew(
    span: float, pace: float = 0.0, resonant: bool = False, excited: float = 0.0, amplifier: float = 0.0
) -> Slew:
    """Return the largest allowed rate of change of the voltage.

    Units: ``span`` [V], ``excited`` [V/s], ``amplifier`` [V/s].
    """
    first = span / FIRST_SECONDS
    known = []
    if amplifier > 0.0:
        known.append(Slew(amplifier, "the slew rate of the amplifier"))
    if excited > 0.0:
        text = f"twice the largest change in the recording, {excited:.{DIGITS}g} {shown_unit('V')}/s"
        slow = f"the range in {FIRST_SECONDS:g} s; the recording had at most {excited:.{DIGITS}g} {shown_unit('V')}/s"
        known.append(Slew(ROOM * excited, text) if ROOM * excited > first else Slew(first, slow))
    if pace > 0.0:
        lag = f"the lag of the model, {1e3 / pace:.{DIGITS}g} ms"
        text = f"one period of the resonance, {pace:.{DIGITS}g} Hz" if resonant else lag
        known.append(Slew(span * pace, f"the range in {text}"))
    return min(
        known or [Slew(first, f"no limit is known, so the whole range takes {FIRST_SECONDS:g} s")],
        key=lambda one: one.rate,
    )


def safe_approach(slew: float, span: float, stroke: float, resonance: float = 0.0) -> tuple[float, float, float]:
    """Return velocity [m/s], acceleration [m/s²] and jerk [m/s³] of the approach to setpoints.

    Units: ``slew`` [V/s], ``span`` [V], ``stroke`` [m], ``resonance`` [Hz].
    """
    velocity = _rounded(FOR_SETPOINTS * slew * stroke / span)
    length = 1.0 / resonance if resonance > 0.0 else UNKNOWN_PART * stroke / velocity
    return velocity, *smooth_approach(velocity, length)


def smooth_approach(velocity: float, length: float) -> tuple[float, float]:
    """Return acceleration [m/s²] and jerk [m/s³] of an approach with moving averages of ``length`` [s] each.

    Units: ``velocity`` [m/s].
    """
    # with velocity V, acceleration A and jerk J, the averages last 2 V/A and 4 V/(2 V/A J), see the approach
    return _rounded(2.0 * velocity / length), _rounded(4.0 * velocity / length**2)


def with_safe_motion(
    text: str,
    source: str,
    namespace: str = "",
    excited: float = 0.0,
    amplifier: float = 0.0,
    structure: np.ndarray | None = None,
) -> str:
    """Return the text of a parameter file with the missing limits of voltage and setpoint and the reason for each.

    For an axis of a stage, ``structure`` is the state matrix of the stage, from which the resonances are computed.
    """
    configuration, namespace = parse_configuration(text, source), normalised_namespace(namespace)
    if configuration.describes("inchworm_sequencer", namespace):
        return text  # an inchworm motor has its own speeds
    nodes = {name: configuration.node(name, namespace) for name in (*NODES, "motion_controller")}
    plant, compensator = (nodes[name] for name in NODES)
    if not all(f"limits.{end}" in node for node in (plant, compensator) for end in ("minimum", "maximum")):
        return text
    span = float(compensator["limits.maximum"]) - float(compensator["limits.minimum"])
    sample_time = 1.0 / float(plant.get("sample_rate", 1000.0))
    found = [slowest(dynamics, sample_time) for dynamics in _dynamics(nodes)]
    if structure is not None:
        found.append(slowest_of(structure, sample_time))
    paces = [(resonant, pace) for pace, resonant in found if pace > 0.0]
    # a resonance takes precedence over a lag
    resonant, pace = min(paces, key=lambda one: (not one[0], one[1]), default=(False, 0.0))
    stated = [float(node.get("limits.slew_rate", 0.0)) for node in (plant, compensator)]
    slew = safe_slew(span, pace, resonant, excited, amplifier)
    if any(rate > 0.0 for rate in stated):
        slew = Slew(min(rate for rate in stated if rate > 0.0), "the same as in the other node")
    rate = _rounded(slew.rate) if not any(stated) else slew.rate
    for name, own in zip(NODES, stated, strict=True):
        if not own > 0.0:
            text = _with_values(
                text, name, namespace, "limits", {"slew_rate": (rate, f"{shown_unit('V')}/s: {slew.reason}")}
            )
    reference = configuration.node("reference_generator", namespace)
    # a stage begins in the middle of its ranges, the centre of its scans; an axis that reaches only positions above 0 m
    # begins at the lowest of them
    away = configuration.stage is not None or float(reference.get("initial_setpoint", 0.0)) != 0.0
    if away and "approach.from_rest" not in reference:
        why = "the first motion, from rest to the initial setpoint, keeps the limits too"
        text = _with_values(text, "reference_generator", namespace, "approach", {"from_rest": (True, why)})
    why = _reason_for_smooth_steps(nodes["motion_controller"], reference)
    if why:
        text = _with_values(text, "reference_generator", namespace, "approach", {"steps": (True, why)})
    if any(float(reference.get(f"approach.{name}", 0.0)) > 0.0 for name in APPROACH):
        return text
    stroke = float(reference.get("maximum", 0.0)) - float(reference.get("minimum", 0.0))
    if not stroke > 0.0:
        low, high = reachable_commands(_part(compensator, CompensatorParameters), sample_time)
        stroke = high - low
    resonance = pace if resonant else 0.0
    each = (
        f"{resonance:.{DIGITS}g} Hz: each average lasts one period"
        if resonance
        else "each average lasts a tenth of the travel time"
    )
    m = shown_unit("m")
    words = (f"{m}/s: half of the slew rate over the range", f"{m}/s²; {each}", f"{m}/s³, the same")
    limits = safe_approach(rate, span, stroke, resonance)
    chosen = dict(zip(APPROACH, zip(limits, words, strict=True), strict=True))
    return _with_values(text, "reference_generator", namespace, "approach", chosen)


def _reason_for_smooth_steps(controller: dict, reference: dict) -> str:
    """Return why steps of a waveform should keep the limits of the approach; empty if they need not, or already do."""
    feedforward = FeedforwardParameters(type=str(controller.get("feedforward.type", "none")))
    keeps = "steps of a waveform keep the limits too"
    if feedforward.inverts and not reference.get("approach.steps", False):
        return f"{keeps}, because the feedforward inverts the dynamics"
    # after a jump, a fast loop with a limited slew rate can oscillate between its limits although it has its margins
    law = LAWS.get(str(controller.get("type", "")))
    stated = "approach.steps" in reference
    return f"{keeps}, because a jump exceeds the slew rate" if law and law.feedback and not stated else ""


def with_comments(text: str, commented: str) -> str:
    """Return ``text`` with the comments from equal lines of ``commented``."""
    known = dict(line.split("  # ", 1) for line in commented.splitlines() if "  # " in line)
    lines = (f"{line}  # {known[line]}" if line in known else line for line in text.splitlines())
    return "".join(f"{line}\n" for line in lines)


def _dynamics(nodes: dict[str, dict]) -> Iterable[LinearParameters]:
    """Return the dynamics that the parameters of plant and controller contain."""
    for node, prefix in (("plant_simulator", "dynamics."), ("motion_controller", "model.dynamics.")):
        values = {name.removeprefix(prefix): value for name, value in nodes[node].items() if name.startswith(prefix)}
        if values:
            yield LinearParameters.from_mapping(values, prefix=f"{node}: {prefix}")


def _part(values: dict, cls):
    """Return the parameters of a block from the parameters of its node."""
    names = {row.name for row in cls.table()}
    return cls.from_mapping({name: value for name, value in values.items() if name in names})


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _with_values(text: str, node: str, namespace: str, group: str, values: dict[str, tuple[float | bool, str]]) -> str:
    """Return the text with new values, and comments on them, in a group of the last section of a node.

    If the group is written in one line, the values are added to that line, and the reasons follow below it.
    """
    full = f"{namespace}/{node}"
    root = yaml.compose(text, Loader=FAST_LOADER)
    sections = [
        (key, value) for key, value in root.value if key.value.rsplit("/", 1)[-1] == node and matches(key.value, full)
    ]
    if not sections:
        given = {f"{group}.{name}": value for name, (value, _) in values.items()}
        comment = "".join(f"# {name}: {reason}\n" for name, (_, reason) in values.items())
        return f"{text.rstrip()}\n{comment}{dump_configuration({f'/**{full}': given})}"
    parameters = next(value for key, value in sections[-1][1].value if key.value == "ros__parameters")
    found = next(((key, value) for key, value in parameters.value if key.value == group), None)
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    if found is None:
        first = parameters.value[0][0].start_mark
        at, inner = first.line, first.column + 2
        added = [f"{' ' * first.column}{group}:\n"]
        added += [f"{' ' * inner}{name}: {_number(value)}  # {reason}\n" for name, (value, reason) in values.items()]
        return "".join(lines[:at] + added + lines[at:])
    mapping = found[1]
    before = {key.value: value for key, value in mapping.value}
    # backwards from the end of the text, so that earlier positions stay valid
    for name in sorted(set(values) & set(before), key=lambda name: before[name].start_mark.line, reverse=True):
        value, reason = values[name]
        mark, end = before[name].start_mark, before[name].end_mark
        line = lines[mark.line]
        rest = line[end.column :].rstrip("\n")
        if mapping.flow_style:
            lines[mark.line] = line[: mark.column] + _number(value) + rest + "\n"
        else:
            lines[mark.line] = f"{line[: mark.column]}{_number(value)}  # {reason}\n"
    new = {name: pair for name, pair in values.items() if name not in before}
    if mapping.flow_style:
        return _in_flow("".join(lines), node, namespace, group, new)
    last_key, last = mapping.value[-1]
    at = last.end_mark.line if last.end_mark.column == 0 else last.end_mark.line + 1
    at = max(at, last_key.start_mark.line + 1)
    indent = " " * last_key.start_mark.column
    added = [f"{indent}{name}: {_number(value)}  # {reason}\n" for name, (value, reason) in new.items()]
    while at > last_key.start_mark.line + 1 and (not lines[at - 1].strip() or lines[at - 1].lstrip().startswith("#")):
        at -= 1
    return "".join(lines[:at] + added + lines[at:])


def _in_flow(text: str, node: str, namespace: str, group: str, new: dict[str, tuple[float | bool, str]]) -> str:
    """Return the text with values inserted before the brace that closes a group."""
    if not new:
        return text
    full = f"{namespace}/{node}"
    sections = [
        value
        for key, value in yaml.compose(text, Loader=FAST_LOADER).value
        if key.value.rsplit("/", 1)[-1] == node and matches(key.value, full)
    ]
    parameters = next(value for key, value in sections[-1].value if key.value == "ros__parameters")
    mark = next(value.end_mark for key, value in parameters.value if key.value == group)
    lines = text.splitlines(keepends=True)
    line = lines[mark.line]
    joined = ", ".join(f"{name}: {_number(value)}" for name, (value, _) in new.items())
    reasons = "; ".join(reason for _, reason in new.values())
    rest = line[mark.column :].rstrip("\n")
    comment = f"{rest}; {reasons}" if "#" in rest else f"{rest}   # {reasons}"
    lines[mark.line] = f"{line[: mark.column - 1]}, {joined}}}{comment}\n"
    return "".join(lines)


def _number(value: float | bool) -> str:
    """Return a number in a form that YAML and ROS both read as a double, or true or false."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
