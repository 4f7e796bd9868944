# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The open-loop triangle of Kim, Kim & Park 2009 (figure 13) with each inverse, and how far the loop is closed."""

from __future__ import annotations

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.models.hysteresis.polynomial import PolynomialParameters
from hysteresis_ros.papers.claims import Claim
from hysteresis_ros.papers.kim2009 import axis as kim
from hysteresis_ros.papers.measurements import loop_width, picard_width, worst

#: Opening of a closed loop, % of the stroke.
CLOSED = dict(paper="closed", high=0.01)


def _triangle_width(configuration: Configuration, stroke: float, frequency: float = kim.TRIANGLE_FREQUENCY) -> float:
    return loop_width(kim.run_cycles(configuration, "triangle", stroke, frequency))


def _picard_id(rate: float, steps: int) -> str:
    return f"rate_{100.0 * rate:.0f}.picard_{steps}"


def _picard_words(rate: float, steps: int) -> str:
    return f"{steps} Picard step{'' if steps == 1 else 's'}, R g = {rate:g}"


def branch_claims(stack: PolynomialParameters, stroke: float) -> list[Claim]:
    """Return the rows of Picard's iteration on the bare branches.

    Parameters
    ----------
    stack : PolynomialParameters
        The branches.
    stroke : float
        Displacement of the full voltage [m].
    """
    group = f"(b) Picard steps on the branches of the loop to {kim.MAXIMUM_VOLTAGE:g} V, without memory"
    return [
        Claim(
            f"b.branches.{_picard_id(rate, steps)}",
            group,
            f"{_picard_words(rate, steps)}: opening, % of the stroke",
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
    """Return the rows of the triangle through an axis whose plant is its hysteresis element alone.

    Parameters
    ----------
    perfect : Configuration
        The axis with a compensator that knows the plant.
    stroke : float
        Height of the triangle [m].
    """
    group = f"(b) Open-loop triangle of {kim.TRIANGLE_FREQUENCY:g} Hz through the axis, hysteresis element alone"
    element = kim.without_dynamics(perfect)
    assumed = (kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE)
    reason = (
        "the running model remembers where it is, so a trial voltage behind the present one is a reversal and the "
        "steps close the loop further than on the bare branches; the row holds when the loop is no wider than there"
    )

    def row(name, quantity, configuration, **more):
        measured = _triangle_width(configuration, stroke)
        return Claim(f"b.{name}", group, f"{quantity}: opening, % of the stroke", measured, "%", **more)

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
    """Return the rows of the triangle through the whole axis.

    Parameters
    ----------
    perfect : Configuration
        The axis with a compensator that knows the plant.
    stroke : float
        Height of the triangle [m].
    none, exact : float
        Loop widths at the paper's frequency without and with the exact inverse [%].
    """
    fast = f"{kim.TRIANGLE_FREQUENCY:g} Hz"
    group = "(b) Open-loop triangle through the axis, dynamics included"
    assumed = (kim.MODEL, kim.STACK, kim.AMPLIFIED, kim.FULL_STROKE)
    linear = _triangle_width(kim.without_hysteresis(perfect), stroke)
    slow = _triangle_width(perfect, stroke, kim.SLOW_FREQUENCY)
    reason = (
        f"at {fast} the linear part alone, without any hysteresis, opens the loop as far (b.dynamics.linear): its lag "
        "and the resonance that the corners of the triangle excite; no compensator of hysteresis sees these"
    )

    def row(name, quantity, measured, **more):
        quantity = f"{quantity}: opening, % of the stroke"
        if "paper" in more:
            more["assumptions"] = (*assumed, kim.CLOSED)
        return Claim(f"b.dynamics.{name}", group, quantity, measured, "%", **(dict(assumptions=assumed) | more))

    return [
        row("none", f"no inverse, {fast}", none),
        row("slow", f"exact inverse, {kim.SLOW_FREQUENCY:g} Hz", slow, **CLOSED),
        row("exact", f"exact inverse, {fast}", exact, reason=reason, **CLOSED),
        row("linear", f"no hysteresis, {fast}", linear),
        row("excess", f"exact inverse less no hysteresis, {fast}", exact - linear, **CLOSED),
    ]


def honest_claims(configuration: Configuration, stroke: float) -> list[Claim]:
    """Return the rows of the triangle with a compensator that does not know the plant so well, noise and converters.

    Parameters
    ----------
    configuration : Configuration
        The axis.
    stroke : float
        Displacement of the full voltage [m]; the triangle is as high as the worse of the models reaches.
    """
    element = kim.without_dynamics(configuration)
    height = (1.0 - kim.MISMATCH) * stroke
    reason = (
        "a model off by the same part in every coefficient is the plant times a constant: its inverse still closes the "
        "loop and only the stroke is wrong; where the opening of its loop is off, that part of the loop stays open"
    )

    def row(name, quantity, change, then=None, **more):
        axes = [then(item) if then else item for item in kim.off_both_ways(change, element)]
        values = [_triangle_width(axis, height) for axis in axes]
        return Claim(
            f"honest.b.{name}",
            "Honest conditions, (b): hysteresis element alone",
            f"{quantity}: opening, % of the stroke",
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
        row("opening", "exact inverse, only the opening off", kim.real_opening, reason=reason, **CLOSED),
    ]
