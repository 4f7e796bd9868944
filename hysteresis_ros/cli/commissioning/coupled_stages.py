# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages of a commissioning of coupled axes, by name and in order."""

from __future__ import annotations

from hysteresis_ros.cli.commissioning import coupled_loops as loops
from hysteresis_ros.cli.commissioning import coupled_measuring as measured
from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.closed_loop import FIRST_STEP, JUDGED_PERIODS, STEPS, UNJUDGED_PERIODS
from hysteresis_ros.cli.commissioning.coupled import StageSituation
from hysteresis_ros.cli.commissioning.coupled_fitting import design_coupled, identify_coupled
from hysteresis_ros.cli.commissioning.stages import Computation, Procedure, Stage
from hysteresis_ros.units import readable


def _noise_words(situation: StageSituation) -> str:
    levels = ", ".join(f"{name} {level:g} V" for name, level in zip(situation.names, situation.safe, strict=True))
    return f"nothing moves: all sensors are read at the safe voltages ({levels})"


def _each(situation: StageSituation, text) -> str:
    """Return a text with a part for each axis."""
    plans = zip(situation.names, situation.plans.values(), situation.safe, strict=True)
    return "; then ".join(f"{name}: {text(plan, safe)}" for name, plan, safe in plans)


def _gain_words(situation: StageSituation) -> str:
    def text(plan, safe):
        step = volts.step_size(plan, safe)
        return f"a step of {step:+.4g} V from {safe:g} V and back, about {readable(abs(step) * plan.gain, 'm')}"

    return _each(situation, text)


def _resonance_words(situation: StageSituation) -> str:
    def text(plan, safe):
        middle, peak = 0.5 * (plan.minimum + plan.maximum), plan.small * plan.span
        return f"slowly to {middle:.4g} V, a multisine of ±{peak:.3g} V there (more motion in resonance), and back"

    return _each(situation, text)


def _multisine_words(situation: StageSituation) -> str:
    swings = measured.predicted_swings(situation, measured.identification_excitation(situation).amplitude)
    most = ", ".join(f"{name} ±{readable(swing, 'm')}" for name, swing in swings.items())
    return (
        "all axes together: slowly to the middle of their ranges, multisines there, at most "
        f"{most} as the small multisines predict, and back"
    )


def _hysteresis_words(situation: StageSituation) -> str:
    def text(plan, _):
        way = readable(plan.stroke, "m")
        count = volts.WHOLE + volts.DECAYING
        return f"the whole range {plan.minimum:g} … {plan.maximum:g} V, about {way}, in {count} cycles"

    return _each(situation, text)


def _loop_words(situation: StageSituation) -> str:
    sizes = [
        f"{name} {readable((max(STEPS) - FIRST_STEP) * abs(one.far - one.rest), 'm')}"
        for name, one in loops.ranges(situation).items()
    ]
    return (
        f"the loops are closed ({situation.controller}): steps of one axis after the other, at most {', '.join(sizes)}"
    )


def _scan_words(situation: StageSituation) -> str:
    sizes = [
        f"{name} {readable(loops.scan_size(situation, name, one), 'm')}"
        for name, one in loops.ranges(situation).items()
    ]
    count = UNJUDGED_PERIODS + JUDGED_PERIODS
    rate = situation.rate / loops.scan_period(situation)
    return f"closed loops: {count} triangles of one axis after the other at {rate:.4g} Hz, {', '.join(sizes)}"


def _judge_words(situation: StageSituation) -> str:
    rate = situation.rate / loops.scan_period(situation)
    return f"closed loops: simultaneous sines on all axes, the lowest at {rate:.4g} Hz, as large as the scans"


#: The stages of coupled axes by name, in order; each stage needs the results of the stages before it.
COUPLED_STAGES: Procedure = {
    "noise": Stage("sensors at rest", _noise_words, measured.noise_stage, measured.judge_noise),
    "gain": Stage("gains and signs", _gain_words, measured.gain_stage, measured.judge_gain),
    "resonance": Stage("small multisines", _resonance_words, measured.resonance_stage, measured.judge_resonance),
    "multisine": Stage("response matrix", _multisine_words, measured.multisine_stage, measured.judge_multisine),
    "hysteresis": Stage("whole range", _hysteresis_words, measured.hysteresis_stage, measured.judge_hysteresis),
    "identify": Computation("model", identify_coupled),
    "design": Computation("controllers", design_coupled),
    "loop": Stage("steps in closed loop", _loop_words, loops.loop_stage, loops.judge_loop),
    "scan": Stage("scans of each axis", _scan_words, loops.scan_stage, loops.judge_scan),
    "judge": Stage("all axes together", _judge_words, loops.judge_stage, loops.judge_together),
}
