# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The open-loop stages of coupled axes: one axis after the other, then all together.

Voltages and checks of each axis are the same as for a single axis. In addition, the readings of the other axes' sensors
are checked.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.coupled import StageSituation, columns_of, each_axis, part_of
from hysteresis_ros.cli.commissioning.measuring import EXPECTED, MICRO
from hysteresis_ros.cli.commissioning.situation import OVERTRAVEL, CommissioningError, Outcome, Plan, Situation
from hysteresis_ros.control.coupling import lost_direction, relative_gain_array
from hysteresis_ros.designs.stage_excitation import PERIOD, StageExcitation, multisines
from hysteresis_ros.identification.coupled import StructureData
from hysteresis_ros.identification.excitations import orthogonal_multisines
from hysteresis_ros.identification.frequency_response import response_matrix
from hysteresis_ros.identification.stage_data import (
    StageReading,
    planned_realisations,
    read_stage,
    without_drift,
)
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import EXCITED, REST, SMALL, WAY, there_and_back
from hysteresis_ros.units import readable

#: Length of a period of the small multisine of an axis [samples].
SMALL_PERIOD = 8000
#: Number of periods of the small multisine of an axis; the first one is only for settling.
SMALL_PERIODS = 5
#: An actuator counts as miswired if another sensor moves this many times as far as the actuator's own sensor.
MISTAKEN = 2.0
#: Largest predicted motion about its mean during the identification multisine, as a fraction of the stroke.
SWING = 0.25
#: Largest ratio of noise to response.
NOISY = 0.5


def noise_stage(situation: StageSituation) -> StageParameters:
    """Return the stage at rest with the whole range of the plans, so that a device with a narrower range is refused."""
    stage = situation.driven("noise", situation.resting(max(plan.noise_duration for plan in situation.plans.values())))
    axes = []
    for axis, plan in zip(stage.axes, situation.plans.values(), strict=True):
        plant = axis.plant_simulator
        limits = replace(plant.limits, minimum=plan.minimum, maximum=plan.maximum) if plant.driver else plant.limits
        axes.append(replace(axis, plant_simulator=replace(plant, limits=limits)))
    return replace(stage, axes=tuple(axes))


def judge_noise(situation: StageSituation, recording: Recording) -> Outcome:
    """Check all sensors at rest."""
    return each_axis(situation, recording, volts.judge_noise)


def gain_stage(situation: StageSituation) -> StageParameters:
    """Return the stage, configured for a small step of one axis after the other."""
    return situation.driven("gain", situation.in_turn(volts.small_step)[0])


def static_gains(situation: StageSituation, recording: Recording) -> np.ndarray:
    """Return the static gains [m/V], shape (n, n), with a row for each sensor and a column for each actuator."""
    spans = situation.in_turn(volts.small_step)[1]
    count = round(volts.STEP_HOLD * situation.rate)
    second = count + round(volts.STEP_WAY * situation.rate)
    before, after = (slice(end - count // 2, end) for end in (count, second + count))
    found = np.empty((len(spans), len(spans)))
    for place, (name, span) in enumerate(spans.items()):
        own = part_of(recording, span)
        measured = columns_of(situation, own, "measured")
        step = volts.step_size(situation.plans[name], situation.safe[place])
        found[:, place] = (measured[after].mean(axis=0) - measured[before].mean(axis=0)) / step
    return found


def judge_gain(situation: StageSituation, recording: Recording) -> Outcome:
    """Check which sensor each actuator moves, the sign and the size of the gains, and that no direction is lost."""
    names, gain = situation.names, static_gains(situation, recording)
    for j, name in enumerate(names):
        other = names[int(np.argmax(np.abs(gain[:, j])))]
        step = abs(volts.step_size(situation.plans[name], situation.safe[j]))
        most = float(np.abs(gain[:, j]).max()) * step
        # compared with the motion of the actuator's own sensor; a smaller motion of another sensor is cross-talk
        if most > max(MISTAKEN * abs(gain[j, j]), situation.plans[name].gain / EXPECTED) * step and other != name:
            raise CommissioningError(
                f"{step:.3g} V at the actuator of {name} move the sensor of {other} by {readable(most, 'm')} and its "
                f"own by {readable(abs(float(gain[j, j])) * step, 'm')}: swap the cables, or name the axes differently"
            )
    outcome = each_axis(situation, recording, volts.judge_gain, situation.in_turn(volts.small_step)[1])
    lost = lost_direction(gain, [f"actuator {name}" for name in names])
    if lost:
        raise CommissioningError(
            f"the gains are singular: the direction {lost} moves no sensor; check the sensors "
            "and their directions of measurement"
        )
    relative = relative_gain_array(gain)
    if np.min(np.diag(relative)) <= 0.0:
        worst = names[int(np.argmin(np.diag(relative)))]
        raise CommissioningError(
            f"the relative gain of {worst} is {np.min(np.diag(relative)):.3g}: closing the other loops reverses the "
            "sign of its gain; pair actuators and sensors differently"
        )
    lines = list(outcome.lines)
    for name, row in zip(names, gain, strict=True):
        shown = ", ".join(f"{MICRO * value:.4g} of {other}" for other, value in zip(names, row, strict=True))
        lines.append(f"{name} moves by [µm/V]: {shown}")
    lines.append(f"relative gains of the pairs: {', '.join(f'{value:.4g}' for value in np.diag(relative))}")
    return Outcome(lines, {**outcome.figures, "gain_m_per_v": gain.tolist()}, outcome.pictures)


def small_multisine(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return a small multisine around the middle of the range of an axis, with ramps to it and back [V]."""
    lines = np.arange(1, int(EXCITED * SMALL_PERIOD) + 1)
    one = orthogonal_multisines(1, SMALL_PERIOD, lines, 1)[0, :, 0]
    voltages = 0.5 * (plan.minimum + plan.maximum) + plan.small * plan.span * np.tile(one, SMALL_PERIODS)
    return there_and_back(voltages, safe, rate)


def resonance_stage(situation: StageSituation) -> StageParameters:
    """Return the stage, configured for a small multisine on one axis after the other."""
    return situation.driven("resonance", situation.in_turn(small_multisine)[0])


def judge_resonance(situation: StageSituation, recording: Recording) -> Outcome:
    """Evaluate the small multisines, and how far each axis moves."""
    spans = situation.in_turn(small_multisine)[1]
    first = round(REST * situation.rate) + round(WAY * situation.rate) + SMALL_PERIOD
    steady = slice(first, first + (SMALL_PERIODS - 1) * SMALL_PERIOD)

    def judge(one: Situation, own: Recording) -> Outcome:
        # creep after the move to the middle is not part of the response
        measured = without_drift(own["measured"][np.newaxis, steady, np.newaxis], SMALL_PERIOD)[0, :, 0]
        found = volts.response_outcome(own["voltage"][steady], measured, one.rate, SMALL_PERIOD)
        swing = {"swing_m": float(np.max(np.abs(measured - measured.mean())))}
        return Outcome(found.lines, found.figures | swing, found.pictures)

    return each_axis(situation, recording, judge, spans)


def predicted_swings(situation: StageSituation, amplitude: float) -> dict[str, float]:
    """Return the predicted motion [m] of each axis about its mean during the identification multisine."""
    small = situation.figures("resonance")
    return {name: amplitude * SMALL / plan.small * small[name]["swing_m"] for name, plan in situation.plans.items()}


def identification_excitation(situation: StageSituation) -> StageExcitation:
    """Return the identification excitation, reduced if the small multisines predict too large a motion."""
    whole = predicted_swings(situation, 1.0)
    level = min(1.0, *(SWING * situation.plans[name].stroke / swing for name, swing in whole.items()))
    return StageExcitation(amplitude=float(f"{level:.3g}"), rests=situation.safe)


def multisine_stage(situation: StageSituation) -> StageParameters:
    """Return the stage, configured for simultaneous orthogonal multisines on all axes."""
    parameters = StageParameters.from_configuration(situation.within())
    return situation.driven("multisine", multisines(parameters, identification_excitation(situation))[0])


def reading_of(recording: Recording, source: str) -> StageReading:
    """Return the voltages and measurements of a recording, ready for identification."""
    found = read_stage(recording)
    return StageReading(found.inputs, found.outputs, found.runs, found.sample_time, source, found.axes)


def identification_data(situation: StageSituation, recording: Recording) -> tuple[StageReading, StructureData]:
    """Return the multisines as planned, including periods that lack a sample."""
    asked = identification_excitation(situation)
    reading = reading_of(recording, "multisine.npz")
    first = round(REST * situation.rate) + round(WAY * situation.rate)
    count = asked.count(len(situation.names))
    return reading, planned_realisations(reading, first, PERIOD, asked.settle, asked.periods, count)


def judge_multisine(situation: StageSituation, recording: Recording) -> Outcome:
    """Check the response matrix: noise, and whether the motion was as predicted."""
    _, data = identification_data(situation, recording)
    found = response_matrix(data.u, data.y, data.sample_time, data.period)
    response, names = found.response, situation.names
    predicted = predicted_swings(situation, identification_excitation(situation).amplitude)
    lines, figures, traces = [], {}, []
    for i, name in enumerate(names):
        size = np.abs(response.response[:, i, i])
        noise = np.sqrt(np.asarray(response.noise_variance)[:, i, i])
        ratio = float(np.median(noise / size))
        if ratio > NOISY:
            raise CommissioningError(
                f"axis {name}: the response to the multisine is below its noise: check the sensor, or raise `small` "
                "in /commissioning"
            )
        swing = float(np.max(np.abs(data.y[:, :, i] - data.y[:, :, i].mean(axis=1, keepdims=True))))
        figures[name] = {"swing_m": swing, "predicted_swing_m": predicted[name], "noise_to_response": ratio}
        lines.append(
            f"{name}: moved by ±{readable(swing, 'm')} (at most ±{readable(predicted[name], 'm')} was expected), noise "
            f"{100.0 * ratio:.2g} % of the response"
        )
        if swing > predicted[name]:
            lines.append(
                f"warning: {name}: moved {swing / predicted[name]:.3g} times as far as expected, because its gain "
                "grows with the size of the motion, or because something else moved it. Stages stop only if a sensor "
                f"reads more than {readable(OVERTRAVEL * situation.plans[name].stroke, 'm')} beyond "
                "the range of their voltages. For a better prediction raise `small` in /commissioning"
            )
        for j, other in enumerate(names):
            label = f"{name} from {other}"
            traces.append(line(label, response.frequency, MICRO * np.abs(response.response[:, i, j])))
    lines.append(f"condition of the inputs {float(found.condition.max()):.3g} at most")
    picture = Picture("Response matrix", "frequency [Hz]", "gain [µm/V]", traces, "xy")
    return Outcome(lines, figures, [picture])


def hysteresis_stage(situation: StageSituation) -> StageParameters:
    """Return the stage with decaying cycles of one axis after the other."""
    return situation.driven("hysteresis", situation.in_turn(volts.decaying_cycles)[0])


def judge_hysteresis(situation: StageSituation, recording: Recording) -> Outcome:
    """Evaluate the decaying cycles of each axis, and how far the other axes move meanwhile."""
    spans = situation.in_turn(volts.decaying_cycles)[1]
    outcome = each_axis(situation, recording, volts.judge_hysteresis, spans)
    lines = list(outcome.lines)
    for name in situation.names:
        moved = columns_of(situation, part_of(recording, spans[name]), "measured")
        stroke = outcome.figures[name]["stroke_m"]
        shares = [
            f"{other} by {100.0 * float(np.ptp(values)) / stroke:.2g} %"
            for other, values in zip(situation.names, moved.T, strict=True)
            if other != name
        ]
        if shares:
            lines.append(f"{name}: its whole stroke moves {', '.join(shares)} of this stroke")
    return Outcome(lines, outcome.figures, outcome.pictures)
