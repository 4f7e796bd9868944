# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The steps of Kim, Kim & Park 2009: uncontrolled (figure 12), under sliding mode control (figures 15 and 17)."""

from __future__ import annotations

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.papers.claims import Claim
from hysteresis_ros.papers.kim2009 import axis as kim
from hysteresis_ros.papers.measurements import StepFigures, step_figures, worst
from hysteresis_ros.recordings.dataset import Recording

#: What the rows "left at 0 V" and "error on the upper level" are judged by.
REMOVED = dict(paper="removed", high=kim.GOOD_RESIDUAL)
LEFT = dict(paper=kim.RESIDUAL, low=0.8 * kim.RESIDUAL, high=1.2 * kim.RESIDUAL)
EXACT = dict(high=kim.GOOD_RESIDUAL)
#: Held long enough for the uncontrolled vibration to settle [s].
LONG = 1.5


def uncontrolled_claims(perfect: Configuration, run: Recording) -> list[Claim]:
    """Return the rows of the uncontrolled steps, without and with hysteresis.

    Parameters
    ----------
    perfect : Configuration
        The axis with a compensator that knows the plant.
    run : Recording
        The uncontrolled run with hysteresis.
    """
    group = f"(a) Uncontrolled steps of {kim.STEP:g} V, {kim.STEP_TIME:g} s each (figure 12)"
    free = kim.open_loop(kim.uncompensated(perfect))
    linear = kim.without_hysteresis(free)
    with_stack = (kim.MODEL, kim.STACK, kim.AMPLIFIED)
    low, high = kim.UNCONTROLLED_PEAK
    settling = kim.UNCONTROLLED_SETTLING
    rows = []
    for name, words, figures, axis, assumed in (
        ("linear", "no hysteresis", step_figures(kim.run_steps(linear)), linear, (kim.MODEL,)),
        ("hysteresis", "with hysteresis", step_figures(run), free, with_stack),
    ):
        rows += [
            Claim(
                f"a.{name}.peak",
                group,
                f"peak, {words}",
                figures.peak,
                "m",
                paper=f"{low * 1e6:g}–{high * 1e6:g}",
                low=low - kim.HALF_DIGIT,
                high=high + kim.HALF_DIGIT,
                assumptions=assumed,
                reason="the tolerance is the paper's range, wider by half of its last digit",
            ),
            Claim(
                f"a.{name}.settling",
                group,
                f"2 % settling, {words}, held for {LONG:g} s",
                step_figures(kim.run_steps(axis, LONG)).settling,
                "s",
                paper=settling,
                low=0.95 * settling,
                high=1.05 * settling,
                assumptions=(*assumed, kim.SETTLED),
            ),
            Claim(
                f"a.{name}.vibration",
                group,
                f"vibration after half a step time, {words}, % of the step",
                100.0 * figures.late_vibration / (kim.DC_GAIN * kim.STEP),
                "%",
                paper="remains",
                low=2.0,
                assumptions=(*assumed, kim.VIBRATING),
            ),
        ]
    reason = "the lower corner of the assumed loop was chosen from this figure of the paper"
    left = Claim(
        "a.hysteresis.residual",
        group,
        "left at 0 V",
        step_figures(run).residual,
        "m",
        assumptions=with_stack,
        reason=reason,
        **LEFT,
    )
    return [*rows, left]


def _rows(
    prefix: str, group: str, figures: list[StepFigures], assumed, residual: dict, level: dict, slow=""
) -> list[Claim]:
    """Return four rows: the worst of several runs, or those of a single one."""

    def row(name, quantity, unit, *own, **more):
        values = [getattr(item, name) for item in figures]
        details = kim.both_ways(values) if len(values) > 1 else {}
        more |= dict(assumptions=(*assumed, *own), details=details)
        return Claim(f"{prefix}.{name}", group, quantity, worst(values), unit, **more)

    own = (kim.CLEAN,) if kim.GOOD_RESIDUAL in (residual.get("high"), level.get("high")) else ()
    settling, peak = kim.CONTROLLED_SETTLING, kim.CONTROLLED_PEAK
    return [
        row("settling", "2 % settling", "s", kim.SETTLED, paper=settling, high=settling, reason=slow),
        row("peak", "peak", "m", paper=peak, high=peak),
        row("residual", "left at 0 V", "m", *own, **residual),
        row("level_error", "error on the upper level", "m", *own, **level),
    ]


def sliding_mode_claims(alone: Recording, compensated: Recording) -> list[Claim]:
    """Return the rows of sliding mode control with perfect knowledge.

    Parameters
    ----------
    alone, compensated : Recording
        Runs without and with the hysteresis compensator.
    """
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED)
    fed_back = dict(LEFT, reason="less than uncontrolled (a.hysteresis.residual): the feedback takes a part of it away")
    without = "(c) Sliding mode control without compensator (figure 15)"
    with_it = "(d) Sliding mode control with compensator (figure 17)"
    return [
        *_rows("c", without, [step_figures(alone)], assumed, fed_back, {}),
        *_rows("d", with_it, [step_figures(compensated)], assumed, REMOVED, EXACT),
    ]


def honest_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of (c) and (d) with a compensator that is off, noise and converters.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    """
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.REAL)
    axes = kim.off_both_ways(kim.real, configuration)
    alone = [step_figures(kim.run_steps(kim.uncompensated(axis))) for axis in axes]
    compensated = [step_figures(kim.run_steps(axis)) for axis in axes]
    trusting = dict(
        EXACT,
        reason="the paper's law has no integral action and takes the gain of the model on trust, so what the gain is "
        "off stays on the upper level; the filter that estimates a disturbance removes it",
    )
    return [
        *_rows("honest.c", "Honest conditions, (c): no compensator", alone, assumed, LEFT, {}),
        *_rows("honest.d", "Honest conditions, (d): with compensator", compensated, assumed, REMOVED, trusting),
    ]


def estimating_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of the Kalman filter that estimates a disturbance: perfect knowledge, then honest conditions.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    """
    reason = (
        "the law's own pole Φ takes most of the 0.02 s; what the compensator leaves is a disturbance that changes with "
        "the step, and finding it prolongs the approach; a larger variance helps only a little (rows settling_fast)"
    )
    rows = []
    for prefix, words, change in (
        ("estimating.c", "no compensator", kim.uncompensated),
        ("estimating.d", "with compensator", lambda axis: axis),
    ):
        for honest in (False, True):
            axes = kim.off_both_ways(kim.real, configuration) if honest else [kim.ideal(configuration)]
            axes = [change(axis) for axis in axes]
            name = f"honest.{prefix}" if honest else prefix
            group = f"Disturbance-estimating Kalman filter, {words}" + (", honest conditions" if honest else "")
            assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.ESTIMATOR, *((kim.REAL,) if honest else ()))
            found = [step_figures(kim.run_steps(kim.estimating(axis))) for axis in axes]
            slow = reason if worst([item.settling for item in found]) > kim.CONTROLLED_SETTLING else ""
            rows += _rows(name, group, found, assumed, REMOVED, EXACT, slow)
            fast = [step_figures(kim.run_steps(kim.estimating(axis, kim.FAST_VARIANCE))).settling for axis in axes]
            rows.append(
                Claim(
                    f"{name}.settling_fast",
                    group,
                    f"2 % settling with a variance of {kim.FAST_VARIANCE:g} V²",
                    worst(fast),
                    "s",
                    assumptions=(*assumed, kim.SETTLED),
                    details=kim.both_ways(fast) if honest else {},
                )
            )
    return rows
