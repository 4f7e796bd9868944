# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages of a commissioning in their order: what each is about to move, what it does, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.commissioning import learning, measuring, response, scanning
from hysteresis_ros.commissioning import voltages as volts
from hysteresis_ros.commissioning.fitting import design_stage, identify_stage
from hysteresis_ros.commissioning.outcome import Outcome
from hysteresis_ros.commissioning.plan import Plan
from hysteresis_ros.commissioning.situation import Situation
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import readable


@dataclass(frozen=True)
class Stage:
    """A stage that moves the axis.

    Parameters
    ----------
    title : str
        A few words.
    words : callable
        ``words(situation)``: what is about to move, and how far.
    axis : callable
        ``axis(situation)``: the axis to run, or what is found without moving it.
    judge : callable
        ``judge(situation, recording)``: what was found; raises an error when something looks wrong.
    """

    title: str
    words: Callable[[Situation], str]
    axis: Callable[[Situation], AxisParameters | Outcome]
    judge: Callable[[Situation, Recording], Outcome]


@dataclass(frozen=True)
class Computation:
    """A stage in which nothing moves.

    Parameters
    ----------
    title : str
        A few words.
    compute : callable
        ``compute(situation)``: what was found.
    """

    title: str
    compute: Callable[[Situation], Outcome]


def _driven(stage: str, voltages: Callable[[Plan, float, float], np.ndarray]):
    """Return what makes the axis of a stage in open loop."""

    def axis(situation: Situation) -> AxisParameters:
        return situation.driven_axis(stage, voltages(situation.plan, situation.safe, situation.rate))

    return axis


def _noise_words(situation: Situation) -> str:
    return f"nothing moves: the sensor is read at {situation.safe:g} V"


def _gain_words(situation: Situation) -> str:
    step = volts.step_size(situation.plan, situation.safe)
    way = readable(abs(step) * situation.plan.gain, "m")
    return f"a step of {step:+.4g} V from {situation.safe:g} V and back, about {way}"


def _resonance_words(situation: Situation) -> str:
    plan = situation.plan
    middle, peak = 0.5 * (plan.minimum + plan.maximum), plan.small * plan.span
    way, small = readable(abs(middle - situation.safe) * plan.gain, "m"), readable(2.0 * peak * plan.gain, "m")
    return (
        f"slowly to {middle:.4g} V (about {way}), a multisine of ±{peak:.3g} V there (about {small} from peak to peak, "
        "more in resonance), and back"
    )


def _hysteresis_words(situation: Situation) -> str:
    plan = situation.plan
    way = readable(plan.stroke, "m")
    return (
        f"the whole range {plan.minimum:g} … {plan.maximum:g} V, about {way}, in {volts.WHOLE + volts.DECAYING} cycles"
    )


def _creep_words(situation: Situation) -> str:
    level = volts.creeping_level(situation.plan, situation.safe)
    way = readable(abs(level - situation.safe) * situation.plan.gain, "m")
    return f"a step to {level:.4g} V, about {way}, held for {situation.plan.creep_duration:g} s, and back"


def _loop_words(situation: Situation) -> str:
    stroke = situation.figure("hysteresis", "stroke_m")
    largest = readable(max(scanning.STEPS) * stroke, "m")
    controller = situation.found["design"].figures["controller"]
    return f"the loop is closed ({controller}): small steps up to {largest} and back"


def _response_words(situation: Situation) -> str:
    peak = readable(response.response_peak(situation), "m")
    return f"closed loop: a multisine of ±{peak} at the reference around the middle of what is reached"


def _scan_words(situation: Situation) -> str:
    way = readable(scanning.scan_stroke(situation), "m")
    periods = scanning.UNJUDGED + scanning.JUDGED
    return f"closed loop: {periods} triangles of {way} from peak to peak at {situation.plan.scan_frequency:g} Hz"


def _learn_words(situation: Situation) -> str:
    way = readable(scanning.scan_stroke(situation), "m")
    count, frequency = learning.periods(situation) + scanning.JUDGED, situation.plan.scan_frequency
    return f"closed loop, learning: {count} triangles of {way} from peak to peak at {frequency:g} Hz"


#: The stages by name, in their order; each needs those before it.
STAGES: dict[str, Stage | Computation] = {
    "noise": Stage("sensor at rest", _noise_words, _driven("noise", volts.listening), measuring.judge_noise),
    "gain": Stage("gain and sign", _gain_words, _driven("gain", volts.small_step), measuring.judge_gain),
    "resonance": Stage(
        "resonance", _resonance_words, _driven("resonance", volts.small_multisine), measuring.judge_resonance
    ),
    "hysteresis": Stage(
        "hysteresis", _hysteresis_words, _driven("hysteresis", volts.decaying_cycles), measuring.judge_hysteresis
    ),
    "creep": Stage("creep", _creep_words, _driven("creep", volts.creeping_step), measuring.judge_creep),
    "identify": Computation("model", identify_stage),
    "design": Computation("controller", design_stage),
    "loop": Stage("closed loop", _loop_words, scanning.loop_axis, scanning.judge_loop),
    "response": Stage("margins", _response_words, response.response_axis, response.judge_response),
    "scan": Stage("judged scan", _scan_words, scanning.scan_axis, scanning.judge_scan),
    "learn": Stage("learning over periods", _learn_words, learning.learn_axis, learning.judge_learned),
}
