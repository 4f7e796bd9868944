# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages of a commissioning, and their execution in order; finished stages are skipped."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from hysteresis_ros.cli.commissioning import closed_loop, measuring
from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.bench import Bench, held_back, require_sound, run_samples
from hysteresis_ros.cli.commissioning.fitting import design_stage, identify_stage
from hysteresis_ros.cli.commissioning.situation import CommissioningError, Outcome, Plan, Situation
from hysteresis_ros.errors import HysteresisError, did_you_mean
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.units import readable


@dataclass(frozen=True)
class Stage:
    """A stage that moves the axis, or the coupled axes."""

    title: str  #: Title on the page.
    words: Callable[[Any], str]  #: ``words(situation)``: description of the next movement, with its size.
    #: ``axis(situation)``: the axis or the coupled axes to run; or an outcome, if nothing has to move.
    axis: Callable[[Any], AxisParameters | StageParameters | Outcome]
    #: ``judge(situation, recording)``: the outcome; raises an error when a result is implausible.
    judge: Callable[[Any, Recording], Outcome]


@dataclass(frozen=True)
class Computation:
    """A stage without movement."""

    title: str  #: Title on the page.
    compute: Callable[[Any], Outcome]  #: ``compute(situation)``: the outcome.


def _driven(stage: str, voltages: Callable[[Plan, float, float], np.ndarray]):
    """Return the function that builds the axis of a stage in open loop."""

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
    largest = readable(max(closed_loop.STEPS) * stroke, "m")
    controller = situation.found["design"].figures["controller"]
    return f"the loop is closed ({controller}): small steps up to {largest} and back"


def _response_words(situation: Situation) -> str:
    peak = readable(closed_loop.response_peak(situation), "m")
    return f"closed loop: a multisine of ±{peak} at the reference, around the middle of the stroke"


def _scan_words(situation: Situation) -> str:
    way = readable(closed_loop.scan_stroke(situation), "m")
    periods = closed_loop.UNJUDGED_PERIODS + closed_loop.JUDGED_PERIODS
    return f"closed loop: {periods} triangles of {way} from peak to peak at {situation.plan.scan_frequency:g} Hz"


def _learn_words(situation: Situation) -> str:
    way = readable(closed_loop.scan_stroke(situation), "m")
    count, frequency = (
        closed_loop.learning_periods(situation) + closed_loop.JUDGED_PERIODS,
        situation.plan.scan_frequency,
    )
    return f"closed loop, learning: {count} triangles of {way} from peak to peak at {frequency:g} Hz"


#: The stages of a commissioning by name, in order; each stage needs the results of the stages before it.
Procedure = Mapping[str, Stage | Computation]
STAGES: Procedure = {
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
    "loop": Stage("closed loop", _loop_words, closed_loop.loop_axis, closed_loop.judge_loop),
    "response": Stage("margins", _response_words, closed_loop.response_axis, closed_loop.judge_response),
    "scan": Stage("judged scan", _scan_words, closed_loop.scan_axis, closed_loop.judge_scan),
    "learn": Stage("learning over periods", _learn_words, closed_loop.learn_axis, closed_loop.judge_learned),
}


class Attendant(Protocol):
    """Permits or refuses each movement, and receives the outcomes."""

    def may_move(self, stage: str, words: str) -> bool:
        """Announce a movement and return whether it is allowed."""

    def told(self, stage: str, outcome: Outcome, done_before: bool) -> None:
        """Receive the outcome of a stage."""


class NotAllowedError(CommissioningError):
    """The next movement was not allowed."""


def require_stages(stages: Iterable[str], procedure: Procedure = STAGES) -> None:
    """Refuse unknown names of stages."""
    for stage in stages:
        if stage not in procedure:
            there = f"there are {', '.join(procedure)}{did_you_mean(stage, procedure)}"
            raise CommissioningError(f"no stage {stage}; {there}")


def commission(
    situation, bench: Bench, attendant: Attendant, stages: Iterable[str] = (), procedure: Procedure = STAGES
) -> bool:
    """Run the stages in order, except finished ones; return whether all are finished."""
    asked = set(stages)
    names = list(procedure)
    for place, name in enumerate(names):
        before = situation.folder.outcome(name)
        if before is not None and name not in asked:
            situation.found[name] = before
            attendant.told(name, before, True)
            continue
        if asked and name not in asked:
            continue
        missing = [other for other in names[:place] if other not in situation.found]
        if missing:
            raise CommissioningError(f"{name} needs the results of {', '.join(missing)}; run them first, or all stages")
        # outcomes of later stages depend on the repeated stage
        situation.folder.forget(names[place:])
        outcome = _done(situation, bench, attendant, name, procedure[name])
        situation.folder.keep(name, outcome)
        situation.found[name] = outcome
        attendant.told(name, outcome, False)
    return all(situation.folder.outcome(name) is not None for name in names)


def _done(situation, bench: Bench, attendant: Attendant, name: str, stage: Stage | Computation) -> Outcome:
    situation.progress(0, name)
    if isinstance(stage, Computation):
        return stage.compute(situation)
    axis = stage.axis(situation)
    if isinstance(axis, Outcome):
        return axis
    samples = run_samples(axis)
    seconds = samples / situation.rate
    if not attendant.may_move(name, f"{stage.words(situation)}; {seconds:.3g} s"):
        raise NotAllowedError(f"stopped before the stage {name}, before any of its movements; continue with --resume")
    try:
        recording = require_sound(bench.run(axis), samples)
    except HysteresisError as error:
        raise _named(error, f"{name}: {error}") from error
    situation.folder.record(name, recording)
    try:
        outcome = stage.judge(situation, recording)
    except CommissioningError as error:
        raise CommissioningError(f"{name}: {error}") from error
    return replace(outcome, lines=[*outcome.lines, *held_back(recording)], seconds=seconds)


def _named(error: HysteresisError, text: str) -> CommissioningError:
    """Return an error with this text and the exit code of another error."""
    named = CommissioningError(text)
    named.exit_code = getattr(error, "exit_code", 2)
    return named
