# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Steps and triangles of Kim, Kim & Park 2009 (figures 12, 13, 15, 17), also with one non-ideal condition at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.laboratory.papers.claims import Claim
from hysteresis_ros.laboratory.papers.kim2009 import axis as kim
from hysteresis_ros.laboratory.papers.runs import StepFigures, loop_width, picard_width, step_figures, worst
from hysteresis_ros.models.hysteresis.polynomial import PolynomialParameters
from hysteresis_ros.models.linear_algebra import rounded
from hysteresis_ros.recordings.dataset import Recording

#: Tolerances of the rows "residual at 0 V" and "error on the upper level".
REMOVED = dict(paper="removed", high=kim.GOOD_RESIDUAL)
LEFT: dict[str, Any] = dict(paper=kim.RESIDUAL, low=0.8 * kim.RESIDUAL, high=1.2 * kim.RESIDUAL)
EXACT = dict(high=kim.GOOD_RESIDUAL)
#: Hold time in which the uncontrolled vibration settles [s].
LONG = 1.5


def uncontrolled_claims(perfect: Configuration, run: Recording) -> list[Claim]:
    """Return the rows of the uncontrolled steps, without and with hysteresis."""
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
                reason="the tolerance is the paper's range, extended by half of its last digit",
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
        "residual at 0 V",
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
    """Return four rows with the figures of a run, or with the worst figures of several runs."""

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
        row("residual", "residual at 0 V", "m", *own, **residual),
        row("level_error", "error on the upper level", "m", *own, **level),
    ]


def sliding_mode_claims(alone: Recording, compensated: Recording) -> list[Claim]:
    """Return the rows of sliding mode control with an exact model."""
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED)
    fed_back = dict(
        LEFT, reason="less than uncontrolled (a.hysteresis.residual), because the feedback removes a part of it"
    )
    without = "(c) Sliding mode control without compensator (figure 15)"
    with_it = "(d) Sliding mode control with compensator (figure 17)"
    return [
        *_rows("c", without, [step_figures(alone)], assumed, fed_back, {}),
        *_rows("d", with_it, [step_figures(compensated)], assumed, REMOVED, EXACT),
    ]


def honest_step_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of (c) and (d) with an inaccurate compensator, noise and converters."""
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.REAL)
    axes = kim.off_both_ways(kim.real, configuration)
    alone = [step_figures(kim.run_steps(kim.uncompensated(axis))) for axis in axes]
    compensated = [step_figures(kim.run_steps(axis)) for axis in axes]
    trusting = dict(
        EXACT,
        reason="the paper's law has no integral action and relies on the gain of the model, so the error of the gain "
        "remains on the upper level; the filter that estimates a disturbance removes it",
    )
    return [
        *_rows("honest.c", "Realistic conditions, (c): no compensator", alone, assumed, LEFT, {}),
        *_rows("honest.d", "Realistic conditions, (d): with compensator", compensated, assumed, REMOVED, trusting),
    ]


def estimating_claims(configuration: Configuration) -> list[Claim]:
    """Return the rows of the Kalman filter that estimates a disturbance: exact model, then realistic conditions."""
    reason = (
        "the law's own pole Φ accounts for most of the 0.02 s; the residual of the compensator is a disturbance that "
        "changes with the step, and its estimation prolongs the approach; a larger variance helps only a little "
        "(rows settling_fast)"
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
            group = f"Disturbance-estimating Kalman filter, {words}" + (", realistic conditions" if honest else "")
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


#: Largest width of a loop that counts as closed, % of the stroke.
CLOSED = dict(paper="closed", high=0.01)


def _triangle_width(configuration: Configuration, stroke: float, frequency: float = kim.TRIANGLE_FREQUENCY) -> float:
    return loop_width(kim.run_cycles(configuration, "triangle", stroke, frequency))


def _picard_id(rate: float, steps: int) -> str:
    return f"rate_{100.0 * rate:.0f}.picard_{steps}"


def _picard_words(rate: float, steps: int) -> str:
    return f"{steps} Picard step{'' if steps == 1 else 's'}, R g = {rate:g}"


def branch_claims(stack: PolynomialParameters, stroke: float) -> list[Claim]:
    """Return the rows of Picard's iteration on the branches without memory.

    Units: ``stroke`` [m].
    """
    group = f"(b) Picard steps on the branches of the loop to {kim.MAXIMUM_VOLTAGE:g} V, without memory"
    return [
        Claim(
            f"b.branches.{_picard_id(rate, steps)}",
            group,
            f"{_picard_words(rate, steps)}: loop width, % of the stroke",
            picard_width(stack, kim.MAXIMUM_VOLTAGE, stroke, steps, rate),
            "%",
            paper=expected,
            derived=True,
            low=0.95 * expected,
            high=1.05 * expected,
            assumptions=(kim.STACK, kim.FULL_STROKE, kim.RATE),
        )
        for rate, widths in kim.WIDTHS.items()
        for steps, expected in widths.items()
    ]


def element_claims(perfect: Configuration, stroke: float) -> list[Claim]:
    """Return the rows for the triangle response of an axis whose plant is only the hysteresis element.

    Units: ``stroke`` [m].
    """
    group = f"(b) Open-loop triangle of {kim.TRIANGLE_FREQUENCY:g} Hz through the axis, hysteresis element alone"
    element = kim.without_dynamics(perfect)
    assumed = (kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE)
    reason = (
        "the running model has memory, so a trial voltage below the present one is a reversal, and the steps reduce "
        "the loop width further than on the branches without memory; the row holds if the loop is not wider than on "
        "these branches"
    )

    def row(name, quantity, configuration, **more):
        measured = _triangle_width(configuration, stroke)
        return Claim(f"b.{name}", group, f"{quantity}: loop width, % of the stroke", measured, "%", **more)

    open_width = kim.WIDTHS[1.0][0]
    band = dict(low=0.99 * open_width, high=1.01 * open_width)
    rows = [
        row(
            "none",
            "no inverse",
            kim.uncompensated(element),
            paper=open_width,
            derived=True,
            assumptions=assumed,
            **band,
        )
    ]
    for rate, widths in kim.WIDTHS.items():
        for steps, expected in widths.items():
            if steps:
                axis = kim.picard(element, steps, rate)
                more = dict(
                    paper=expected, derived=True, high=expected, assumptions=(*assumed, kim.RATE), reason=reason
                )
                rows.append(row(_picard_id(rate, steps), _picard_words(rate, steps), axis, **more))
    rows.append(row("exact", "exact inverse", element, assumptions=(*assumed, kim.CLOSED), **CLOSED))
    return rows


def dynamics_claims(perfect: Configuration, stroke: float, none: float, exact: float) -> list[Claim]:
    """Return the rows for the triangle response of the whole axis, with dynamics.

    Units: ``stroke`` [m], ``none`` [%], ``exact`` [%].
    """
    fast = f"{kim.TRIANGLE_FREQUENCY:g} Hz"
    group = "(b) Open-loop triangle through the axis, dynamics included"
    assumed = (kim.MODEL, kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE)
    linear = _triangle_width(kim.without_hysteresis(perfect), stroke)
    slow = _triangle_width(perfect, stroke, kim.SLOW_FREQUENCY)
    reason = (
        f"at {fast} the linear part alone, without any hysteresis, causes a loop of the same width "
        "(b.dynamics.linear), by its lag and by the resonance that the corners of the triangle excite; a hysteresis "
        "compensator does not correct these"
    )

    def row(name, quantity, measured, **more):
        quantity = f"{quantity}: loop width, % of the stroke"
        if "paper" in more:
            more["assumptions"] = (*assumed, kim.CLOSED)
        return Claim(f"b.dynamics.{name}", group, quantity, measured, "%", **(dict(assumptions=assumed) | more))

    return [
        row("none", f"no inverse, {fast}", none),
        row("slow", f"exact inverse, {kim.SLOW_FREQUENCY:g} Hz", slow, **CLOSED),
        row("exact", f"exact inverse, {fast}", exact, reason=reason, **CLOSED),
        row("linear", f"no hysteresis, {fast}", linear),
        row("excess", f"exact inverse minus no hysteresis, {fast}", exact - linear, **CLOSED),
    ]


def honest_triangle_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of the triangle with a less accurate compensator, noise and converters.

    Units: ``stroke`` [m].
    """
    element = kim.without_dynamics(configuration)
    height = (1.0 - kim.MISMATCH) * stroke
    reason = (
        "a model with the same relative error in every coefficient is the plant times a constant: its inverse still "
        "removes the loop, and only the stroke is wrong; if only the loop width of the model is wrong, the "
        "corresponding part of the width remains"
    )

    def row(name, quantity, change, then=None, **more):
        axes = [then(item) if then else item for item in kim.off_both_ways(change, element)]
        values = [_triangle_width(axis, height) for axis in axes]
        return Claim(
            f"honest.b.{name}",
            "Realistic conditions, (b): hysteresis element alone",
            f"{quantity}: loop width, % of the stroke",
            worst(values),
            "%",
            assumptions=(kim.STACK, kim.AMPLIFIED, kim.REACHED, kim.REAL),
            details=kim.both_ways(values),
            **more,
        )

    return [
        row("none", "no inverse", kim.real, kim.uncompensated),
        row("picard_6", _picard_words(1.0, 6), kim.real, lambda axis: kim.picard(axis, 6, 1.0)),
        row("exact", "exact inverse, every coefficient off", kim.real, reason=reason, **CLOSED),
        row("opening", "exact inverse, only the loop width off", kim.real_opening, reason=reason, **CLOSED),
    ]


CREEP_RATE = 0.01  # fraction of the step per decade
COARSE_BITS = 12
LOW_LIMIT = 18.0  # V; the step needs 20 V
FREQUENCIES = (0.02, 0.2, 2.0, 10.0)  # Hz
CYCLES = 10
STEP_CYCLES = 6

ALONE = "one condition at a time; all else as in (d): the compensator knows the plant, no noise, ideal converters"
CREEPING = "the plant creeps by 1 % of the step per decade of time (logarithmic law, from 0.1 s on)"
COARSE = "12-bit converters over −30 … 120 V: 3.8 nm per step"
STRUCTURE = "resonance of the plant off by ±1 % or ±5 % (the worse result is shown), damping ratio and gain kept"
OPENING = "loop width of the compensator's model off by +5 %, sensor noise 5 nm rms, 16-bit converters"


@dataclass(frozen=True)
class Condition:
    """One non-ideal condition."""

    name: str  #: Middle part of the rows' names.
    words: str
    changes: Callable[[Configuration], list[Configuration]]  #: Return the axes; the worst is evaluated.
    assumed: tuple[str, ...] = (ALONE,)
    mismatch: float = 0.0  #: The two axes deviate by ± this mismatch; 0: a single axis.
    reasons: tuple[tuple[str, str], ...] = ()  #: Name of a row, and the reason why it does not hold.


def _both(configuration: Configuration, **values) -> Configuration:
    """Return the axis with the same values in plant and compensator."""
    return configuration.override("plant_simulator", **values).override("hysteresis_compensator", **values)


def _plant(**values) -> Callable[[Configuration], list[Configuration]]:
    return lambda axis: [kim.ideal(axis).override("plant_simulator", **values)]


def other_structure(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis with the plant's resonance off by ``mismatch``, unknown to the controller."""
    A = np.array(configuration.node("plant_simulator")["dynamics.A"]).reshape(3, 3)
    poles, vectors = np.linalg.eig(A.astype(complex))
    moved = np.where(np.abs(poles.imag) > 0.0, np.exp((1.0 + mismatch) * np.log(poles)), poles)
    other = rounded((vectors @ np.diag(moved) @ np.linalg.inv(vectors)).real)
    return kim.ideal(configuration).override("plant_simulator", dynamics__A=other.ravel().tolist())


_ON_TRUST = (
    "the paper's law relies on the gain of the model, so the error of this gain remains on the upper level; the "
    "filter that estimates a disturbance removes it"
)
_NO_NEGATIVE = "with D > 0 no positive voltage returns the stack to zero, with any controller"
_OUT_OF_REACH = "an amplifier limited to 18 V cannot reach the step with any controller"
_REMEMBERED = (
    "the compensator's model remembers a 20 V peak that the plant never received, so a residual remains at 0 V"
)
_DIGIT = (
    "command and achieved command differ by a constant of at most half a quantisation step of 3.8 nm, and the reaching "
    "law amplifies it up to 1/(1 − Φ) = 14 times"
)
_CREEPS = "the law has no integral action and follows its model, which does not creep; the estimator follows the plant"

_CREEP = dict(creep__type="logarithmic", creep__logarithmic__rate=CREEP_RATE)


def _off_both_ways(mismatch: float) -> Callable[[Configuration], list[Configuration]]:
    """Return a function that gives the axes with the plant's resonance off by ``mismatch`` in both directions."""
    return lambda axis: kim.off_both_ways(other_structure, axis, mismatch)


CONDITIONS = (
    Condition(
        "limits_positive",
        "limits 0 … 120 V",
        lambda axis: [_both(kim.ideal(axis), limits__minimum=0.0)],
        reasons=(("error", _NO_NEGATIVE), ("estimated", _NO_NEGATIVE)),
    ),
    Condition(
        "limits_low",
        f"an amplifier limited to {LOW_LIMIT:g} V, unknown to the controller",
        _plant(limits__maximum=LOW_LIMIT),
        reasons=(("error", _OUT_OF_REACH), ("estimated", _OUT_OF_REACH), ("residual", _REMEMBERED)),
    ),
    Condition(
        "off_1",
        "every coefficient off by ±1 %, noise, 16 bits",
        lambda axis: kim.off_both_ways(kim.real, axis, 0.01),
        assumed=("as in the rows honest.d, but ±1 %",),
        mismatch=0.01,
        reasons=(("error", _ON_TRUST),),
    ),
    *(
        Condition(
            f"structure_{100.0 * mismatch:g}",
            f"resonance of the plant off by ±{100.0 * mismatch:g} %",
            _off_both_ways(mismatch),
            assumed=(ALONE, STRUCTURE),
            mismatch=mismatch,
        )
        for mismatch in (0.01, 0.05)
    ),
    Condition("noise", "sensor noise 5 nm rms", _plant(sensor__noise=kim.NOISE)),
    Condition(
        "coarse",
        f"{COARSE_BITS}-bit converters",
        lambda axis: [_both(axis, limits__bits=COARSE_BITS)],
        assumed=(ALONE, COARSE),
        reasons=(("error", _DIGIT), ("estimated", _DIGIT)),
    ),
    Condition(
        "creep",
        "creep unknown to the controller",
        _plant(**_CREEP),
        assumed=(ALONE, CREEPING),
        reasons=(("settling", _CREEPS), ("error", _CREEPS)),
    ),
    Condition(
        "creep_known",
        "creep inverted by the compensator",
        lambda axis: [_both(kim.ideal(axis), **_CREEP)],
        assumed=(ALONE, CREEPING),
    ),
)


def condition_claims(configuration: Configuration) -> list[Claim]:
    """Return three rows per condition: settling and final error under the paper's law, and with the estimator."""
    rows = []
    for condition in CONDITIONS:
        axes = condition.changes(configuration)
        law = [step_figures(kim.run_steps(axis)) for axis in axes]
        estimated = [step_figures(kim.run_steps(kim.estimating(axis))) for axis in axes]
        assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, *condition.assumed)

        def row(name, quantity, values, unit, *own, condition=condition, assumed=assumed, **more):
            details = kim.both_ways(values, condition.mismatch) if condition.mismatch else {}
            return Claim(
                f"honest.{condition.name}.{name}",
                f"One non-ideal condition, (d): {condition.words}",
                quantity,
                worst(values),
                unit,
                assumptions=(*assumed, *own),
                reason=dict(condition.reasons).get(name, ""),
                details=details,
                **more,
            )

        removed = dict(paper="removed", high=kim.GOOD_RESIDUAL)
        settling = kim.CONTROLLED_SETTLING
        rows += [
            row(
                "settling",
                "2 % settling",
                [item.settling for item in law],
                "s",
                kim.SETTLED,
                paper=settling,
                high=settling,
            ),
            row("error", "error at either level", [_left(item) for item in law], "m", kim.CLEAN, **removed),
            row(
                "estimated",
                "the same, disturbance estimated",
                [_left(item) for item in estimated],
                "m",
                kim.CLEAN,
                kim.ESTIMATOR,
                **removed,
            ),
        ]
        if condition.name == "limits_low":
            for name, words, figures in (
                ("residual", "residual at 0 V afterwards", law),
                ("residual_estimated", "residual at 0 V, estimated disturbance: no wind-up", estimated),
            ):
                rows.append(row(name, words, [item.residual for item in figures], "m", kim.CLEAN, **removed))
    return rows


def _left(figures) -> float:
    return max(figures.residual, figures.level_error)


def task_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of other tasks: half the step, several cycles, triangles of several frequencies and heights.

    Units: ``stroke`` [m].
    """
    real = kim.real(configuration, kim.MISMATCH)
    half = step_figures(kim.run_steps(real, size=0.5 * kim.STEP))
    many = step_figures(kim.run_steps(real, cycles=STEP_CYCLES))
    group = "Other steps, realistic conditions, (d): with compensator, coefficients off by +5 %"
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.REAL)
    removed: dict[str, Any] = dict(paper="removed", high=kim.GOOD_RESIDUAL)
    settling = kim.CONTROLLED_SETTLING
    rows = []
    for name, words, figures in (
        ("half", "half the step", half),
        ("many", f"{STEP_CYCLES} cycles", many),
    ):
        rows += [
            Claim(
                f"honest.{name}.settling",
                group,
                f"2 % settling, {words}",
                figures.settling,
                "s",
                paper=settling,
                high=settling,
                assumptions=(*assumed, kim.SETTLED),
            ),
            Claim(
                f"honest.{name}.residual",
                group,
                f"residual at 0 V, {words}",
                figures.residual,
                "m",
                assumptions=(*assumed, kim.CLEAN),
                **removed,
            ),
        ]
    return [*rows, *_triangle_claims(configuration, stroke)]


def _triangle_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of triangles with dynamics, for information, because the paper has only one frequency."""
    axis = kim.real_opening(configuration, kim.MISMATCH)

    def row(name, words, height, frequency, cycles=2):
        run = kim.run_cycles(axis, "triangle", height * stroke, frequency, cycles)
        return Claim(
            f"honest.triangle.{name}",
            "Open-loop triangles, exact inverse, dynamics included, realistic conditions",
            f"{frequency:g} Hz, {words}: loop width, % of the stroke",
            loop_width(run),
            "%",
            assumptions=(kim.MODEL, kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE, OPENING),
        )

    return [
        *(row(f"{frequency:g}_hz", "full stroke", 1.0, frequency) for frequency in FREQUENCIES),
        *(row(f"half.{frequency:g}_hz", "half stroke", 0.5, frequency) for frequency in FREQUENCIES[1:]),
        row("cycles", f"full stroke, {CYCLES} cycles", 1.0, kim.TRIANGLE_FREQUENCY, CYCLES),
    ]
