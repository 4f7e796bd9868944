# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The steps and triangles of Kim, Kim & Park 2009 where one thing at a time is not ideal, or the task is another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.linear_algebra import rounded
from hysteresis_ros.papers.claims import Claim
from hysteresis_ros.papers.kim2009 import axis as kim
from hysteresis_ros.papers.measurements import loop_width, step_figures, worst

CREEP_RATE = 0.01  # of the step a decade
COARSE_BITS = 12
LOW_LIMIT = 18.0  # V; the step needs 20 V
FREQUENCIES = (0.02, 0.2, 2.0, 10.0)  # Hz
CYCLES = 10
STEP_CYCLES = 6

ALONE = "one condition at a time; all else as in (d): the compensator knows the plant, no noise, ideal converters"
CREEPING = "creep of the plant 1 % of the step a decade of time (logarithmic law, from 0.1 s on)"
COARSE = "12-bit converters over −30 … 120 V: 3.8 nm a digit"
STRUCTURE = "resonance of the plant off by ±1 % or ±5 % (the worse shown), damping ratio and gain kept"
OPENING = "opening of the compensator's loop off by +5 %, sensor noise 5 nm rms, 16-bit converters"


@dataclass(frozen=True)
class Condition:
    """One thing that is not ideal.

    Parameters
    ----------
    name : str
        Middle of the rows' names.
    words : str
    changes : callable
        Configuration → the axes of which the worst is shown.
    assumed : tuple of str
    mismatch : float
        By how much two axes are off both ways; 0: a single axis.
    reasons : tuple of (str, str)
        Row, and why it does not hold.
    """

    name: str
    words: str
    changes: Callable[[Configuration], list[Configuration]]
    assumed: tuple[str, ...] = (ALONE,)
    mismatch: float = 0.0
    reasons: tuple[tuple[str, str], ...] = ()


def _both(configuration: Configuration, **values) -> Configuration:
    """Return the axis with the same values in plant and compensator."""
    return configuration.override("plant_simulator", **values).override("hysteresis_compensator", **values)


def _plant(**values) -> Callable[[Configuration], list[Configuration]]:
    return lambda axis: [kim.ideal(axis).override("plant_simulator", **values)]


def other_structure(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis whose plant has its resonance off by ``mismatch``; the controller does not know."""
    A = np.array(configuration.node("plant_simulator")["dynamics.A"]).reshape(3, 3)
    poles, vectors = np.linalg.eig(A.astype(complex))
    moved = np.where(np.abs(poles.imag) > 0.0, np.exp((1.0 + mismatch) * np.log(poles)), poles)
    other = rounded((vectors @ np.diag(moved) @ np.linalg.inv(vectors)).real)
    return kim.ideal(configuration).override("plant_simulator", dynamics__A=other.ravel().tolist())


_ON_TRUST = (
    "the paper's law takes the gain of the model on trust: what it is off stays on the upper level; the filter that "
    "estimates a disturbance removes it"
)
_FINDING = "finding the disturbance prolongs the approach"
_NO_NEGATIVE = "with D > 0 no positive voltage returns the stack to zero; no controller can"
_OUT_OF_REACH = "18 V do not reach the step; no controller can"
_REMEMBERED = "the compensator's model remembers a peak of 20 V that the plant never saw, and returns too far"
_DIGIT = (
    "what a digit of 3.8 nm leaves between command and what is carried out stays, and the reaching law amplifies such "
    "a constant difference up to 1/(1 − Φ) = 14 times"
)
_CREEPS = "the law has no integral action and follows its model, which does not creep; the estimator follows the plant"

_CREEP = dict(creep__type="logarithmic", creep__logarithmic__rate=CREEP_RATE)
CONDITIONS = (
    Condition(
        "limits_positive",
        "limits 0 … 120 V",
        lambda axis: [_both(kim.ideal(axis), limits__minimum=0.0)],
        reasons=(("error", _NO_NEGATIVE), ("estimated", _NO_NEGATIVE)),
    ),
    Condition(
        "limits_low",
        f"an amplifier that ends at {LOW_LIMIT:g} V, which nobody knows",
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
            lambda axis, mismatch=mismatch: kim.off_both_ways(other_structure, axis, mismatch),
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
        "creep that nobody knows",
        _plant(**_CREEP),
        assumed=(ALONE, CREEPING),
        reasons=(("settling", _CREEPS), ("error", _CREEPS)),
    ),
    Condition(
        "creep_known",
        "creep that the compensator inverts",
        lambda axis: [_both(kim.ideal(axis), **_CREEP)],
        assumed=(ALONE, CREEPING),
    ),
)


def condition_claims(configuration: Configuration) -> list[Claim]:
    """Return three rows a condition: settling and what is finally left under the paper's law, and with the estimator.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    """
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
                f"One thing not ideal, (d): {condition.words}",
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
            row("error", "left at either level", [_left(item) for item in law], "m", kim.CLEAN, **removed),
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
                ("residual", "left at 0 V afterwards", law),
                ("residual_estimated", "the same, disturbance estimated: no wind-up", estimated),
            ):
                rows.append(row(name, words, [item.residual for item in figures], "m", kim.CLEAN, **removed))
    return rows


def _left(figures) -> float:
    return max(figures.residual, figures.level_error)


def task_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of other tasks: half the step, several cycles, triangles of several frequencies and heights.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    stroke : float
        Height of the full triangle [m].
    """
    real = kim.real(configuration, kim.MISMATCH)
    half = step_figures(kim.run_steps(real, size=0.5 * kim.STEP))
    many = step_figures(kim.run_steps(real, cycles=STEP_CYCLES))
    group = "Other steps, honest conditions, (d): with compensator, coefficients off by +5 %"
    assumed = (kim.MODEL, kim.LAW, kim.STACK, kim.AMPLIFIED, kim.REAL)
    removed = dict(paper="removed", high=kim.GOOD_RESIDUAL)
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
                f"left at 0 V, {words}",
                figures.residual,
                "m",
                assumptions=(*assumed, kim.CLEAN),
                **removed,
            ),
        ]
    return [*rows, *_triangle_claims(configuration, stroke)]


def _triangle_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of triangles with dynamics; for information, since the paper shows one frequency only."""
    axis = kim.real_opening(configuration, kim.MISMATCH)

    def row(name, words, height, frequency, cycles=2):
        run = kim.run_cycles(axis, "triangle", height * stroke, frequency, cycles)
        return Claim(
            f"honest.triangle.{name}",
            "Open-loop triangles, exact inverse, dynamics included, honest conditions",
            f"{frequency:g} Hz, {words}: opening, % of the stroke",
            loop_width(run),
            "%",
            assumptions=(kim.MODEL, kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE, OPENING),
        )

    return [
        *(row(f"{frequency:g}_hz", "full stroke", 1.0, frequency) for frequency in FREQUENCIES),
        *(row(f"half.{frequency:g}_hz", "half stroke", 0.5, frequency) for frequency in FREQUENCIES[1:]),
        row("cycles", f"full stroke, {CYCLES} cycles", 1.0, kim.TRIANGLE_FREQUENCY, CYCLES),
    ]
