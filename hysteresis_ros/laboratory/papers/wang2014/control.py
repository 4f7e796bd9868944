# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Tracking of the axis of Wang, Alici & Tan 2014: linear and hysteresis inverses, then realistic conditions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.laboratory.papers.claims import Claim
from hysteresis_ros.laboratory.papers.wang2014 import axis as wang
from hysteresis_ros.recordings.dataset import Recording

HONEST = "π"  # rad/s of the rows under realistic conditions, unless a row names another frequency
MISMATCHES = (0.01, 0.05)
MISMATCHED_CYCLES = 1.5
MANY_CYCLES = 10
#: Frequency [Hz] → cycles; up to 0.1 Hz the first quarter cycle is not evaluated, above 0.1 Hz the first cycle.
SWEEP = {0.02: 0.75, 0.1: 0.75, 2.0: 4.0, 5.0: 8.0, 10.0: 15.0}
CREEPING_CYCLES = 4
#: Feedback in addition to the feedforward: crossover about 5 Hz, the zero of the PID on the first pole.
FEEDBACK = {
    "pid": dict(type="pid", pid__Kp=0.5, pid__Ki=30.0),
    "ism": dict(
        type="integral_sliding_mode",
        sliding_mode__hyperplane="lq",
        sliding_mode__phi=0.7,
        sliding_mode__rejection_pole=0.5,
        kalman__gain="riccati",
        kalman__q=1e-10,
        kalman__r=1e-10,
        kalman__disturbance="constant",
        kalman__q_disturbance=1e-12,
    ),
}
FEEDBACK_WORDS = {"pid": "PID", "ism": "integral sliding mode, offset-free Kalman filter"}
FED_BACK = "PID: K_p 0.5, K_i 30 /s; sliding mode: Φ 0.7, rejection pole 0.5, disturbance estimated (own design)"


class Figures:
    """Errors of one run, in % of the amplitude of its reference.

    Units: ``frequency`` [Hz], ``amplitude`` [m], ``start`` [s].
    """

    def __init__(self, configuration, recording: Recording, frequency, amplitude, start=None):
        """Evaluate the run; ``harmonics`` is the rms error of its last cycle without the fundamental."""
        error = wang.tracking_error(configuration, recording, 1.0 / frequency if start is None else start)
        self.rms = 100.0 * wang.rms(error) / amplitude
        self.maximum = 100.0 * float(np.max(np.abs(error))) / amplitude
        cycle = round(1.0 / frequency / recording.sample_time)
        last = error[-cycle:]
        turn = np.exp(2j * np.pi * np.arange(cycle) / cycle)
        fundamental = 2.0 * float(np.abs(np.mean(last * turn))) if last.size == cycle else 0.0
        self.harmonics = 100.0 * np.sqrt(max(wang.rms(last) ** 2 - 0.5 * fundamental**2, 0.0)) / amplitude


def _judge(configuration: Configuration, frequency: float, part: float = 1.0, cycles=None, start=None) -> Figures:
    amplitude = part * wang.AMPLITUDE
    recording = wang.run_sine(configuration, frequency, amplitude, cycles)
    return Figures(configuration, recording, frequency, amplitude, start)


def _assumed(key: str, *more: str) -> tuple[str, ...]:
    own = (wang.SAME_CLASS,) if key == wang.BETTER else ()
    return (wang.TRUTH, wang.DYNAMICS, wang.RECORDED, wang.REFERENCE, *own, *more)


def tracking_claims(axes: dict[str, Configuration], runs: dict[str, Recording]) -> list[Claim]:
    """Return the rows of W6 and W7: every controller at three frequencies, at full and at half amplitude."""
    rows = []
    for part, words in ((1.0, "full"), (0.5, "half")):
        for name, frequency in wang.FREQUENCIES.items():
            found = {}
            for key, axis in axes.items():
                clean, amplitude = wang.ideal(axis), part * wang.AMPLITUDE
                recording = wang.run_sine(clean, frequency, amplitude)
                runs[f"{words}.{name}.{key}"] = recording
                found[key] = Figures(clean, recording, frequency, amplitude)
            rows += _tracking_rows(f"w6.{words}", name, found)
    return rows


def _tracking_rows(prefix: str, frequency: str, found: dict[str, Figures]) -> list[Claim]:
    full = prefix.endswith("full")
    height = "full" if full else "half"
    group = f"{'W6' if full else 'W7'}: tracking of {frequency} rad/s, {height} amplitude (table 4, figures 11 and 13)"
    more = (wang.IDEAL,) if full else (wang.IDEAL, wang.HALF)
    rows = []
    for key, figures in found.items():
        words = wang.WORDS[key]
        common: dict[str, Any] = dict(group=group, unit="%", assumptions=_assumed(key, *more))
        name = f"{prefix}.{frequency}.{key}"
        rows += [
            Claim(f"{name}.rms", quantity=f"{words}: rms, % of amplitude", measured=figures.rms, **common),
            Claim(
                f"{name}.maximum",
                quantity=f"{words}: largest error, % of amplitude",
                measured=figures.maximum,
                paper="about 5" if key == wang.PAPER and full else None,
                high=wang.LARGEST_ERROR if full and key != wang.LINEAR else None,
                **common,
            ),
        ]
        if key == wang.LINEAR:
            rows.append(
                Claim(
                    f"{name}.harmonics",
                    quantity=f"{words}: rms that no linear inverse removes, % of amplitude",
                    measured=figures.harmonics,
                    reason="the error of the last cycle without its fundamental: no linear inverse has a smaller error",
                    **common,
                )
            )
        else:
            reduction = 100.0 * (1.0 - figures.rms / found[wang.LINEAR].rms)
            quantity = f"{words}: reduction of the linear inverse's rms"
            rows.append(
                Claim(
                    f"{name}.reduction",
                    quantity=quantity,
                    measured=reduction,
                    **_expected_reduction(key == wang.PAPER, full),
                    **common,
                )
            )
    return rows


def _expected_reduction(paper: bool, full: bool) -> dict:
    """Return the expected range of a reduction; inside the loop, the paper's model is worse than the linear model."""
    if paper and not full:
        reason = (
            "the model with α = 80 returns at once to the branches of the loop from which it was identified, so it "
            "is wrong inside this loop"
        )
        return dict(paper="worse", derived=True, high=0.0, reason=reason)
    return dict(paper="at least 50" if paper else None, low=wang.REDUCTION)


def _honest_row(name, group, quantity, values, key, *more, reference=None) -> Claim:
    """Return the row with the worst of ``values``, which maps conditions to rms errors in % of the amplitude."""
    high = 0.5 * reference if reference is not None and key == wang.BETTER else None
    return Claim(
        f"honest.{name}.{key}",
        group,
        f"{quantity}, {wang.WORDS[key]}: rms, % of amplitude",
        max(values.values()),
        "%",
        high=high,
        assumptions=_assumed(key, *more),
        details=values if len(values) > 1 else {},
    )


def honest_claims(axes: dict[str, Configuration]) -> list[Claim]:
    """Return the rows of conditions that the paper does not consider, for every controller."""
    frequency = wang.FREQUENCIES[HONEST]
    rows = []

    def add(name, group, quantity, judge, *more, reason=""):
        found = {key: judge(axis) for key, axis in axes.items()}
        reference = max(found[wang.LINEAR].values())
        for key, values in found.items():
            row = _honest_row(name, group, quantity, values, key, *more, reference=reference)
            rows.append(replace(row, reason=reason) if row.holds is False else row)

    group = "Realistic conditions: limits, converters, noise"
    for part, words in ((1.0, "full amplitude"), (0.5, "half amplitude")):
        add(
            f"real.{words[:4]}",
            group,
            f"{HONEST} rad/s, {words}",
            lambda axis, part=part: {"": _judge(wang.real(axis), frequency, part, 2).rms},
            wang.REAL,
        )
    group = f"Realistic conditions: the plant has changed since the identification, {HONEST} rad/s (worse sign)"
    spoilt = (
        "a feedforward relies on the gain of its model, so an error of the gain remains; at 5 % no model of the loop "
        "shape reduces it, but feedback does (rows feedback)"
    )
    for mismatch in MISMATCHES:
        for name, change, words in (("gain", wang.stronger_plant, "gain"), ("loop", wang.wider_plant, "plays")):
            add(
                f"{name}_{100.0 * mismatch:g}",
                group,
                f"{words} off by ±{100.0 * mismatch:g} %",
                lambda axis, change=change, mismatch=mismatch: {
                    f"{sign:+.0%}": _judge(
                        change(wang.real(axis), sign), frequency, cycles=MISMATCHED_CYCLES, start=1.0
                    ).rms
                    for sign in (-mismatch, mismatch)
                },
                wang.REAL,
                reason=spoilt if name == "gain" else "",
            )
    group = "Realistic conditions: many cycles and creep"
    add(
        "cycles",
        group,
        f"2π rad/s, {MANY_CYCLES} cycles, the last",
        lambda axis: {"": _judge(wang.real(axis), 1.0, cycles=MANY_CYCLES, start=MANY_CYCLES - 1.0).rms},
        wang.REAL,
    )
    add(
        "creep",
        group,
        f"{HONEST} rad/s, creep of {100.0 * wang.CREEP:g} % a decade, {CREEPING_CYCLES} cycles",
        lambda axis: {"": _judge(wang.creeping(wang.real(axis)), frequency, cycles=CREEPING_CYCLES).rms},
        wang.REAL,
    )
    return rows


def sweep_claims(axes: dict[str, Configuration]) -> list[Claim]:
    """Return the rows of frequencies from 0.02 to 10 Hz; from 5 Hz on the amplitude is halved."""
    rows = []
    for frequency, cycles in SWEEP.items():
        part = 1.0 if frequency <= 2.0 else 0.5
        found = {}
        for key in (wang.LINEAR, wang.PAPER, wang.BETTER):
            axis = wang.real(axes[key])
            found[key] = _judge(axis, frequency, part, cycles, (0.25 if cycles < 1.0 else 1.0) / frequency)
        for key, figures in found.items():
            rows.append(
                _honest_row(
                    f"sweep_{frequency:g}",
                    "Realistic conditions: 0.02 … 10 Hz (half amplitude from 5 Hz on)",
                    f"{frequency:g} Hz",
                    {"": figures.rms},
                    key,
                    wang.REAL,
                    reference=found[wang.LINEAR].rms,
                )
            )
    return rows


def feedback_claims(axes: dict[str, Configuration]) -> list[Claim]:
    """Return the rows of feedback and feedforward together, on plants that differ from the model."""
    frequency = wang.FREQUENCIES[HONEST]
    conditions = {
        "real": ("as identified", lambda axis: axis),
        "gain_5": ("gain off by +5 %", lambda axis: wang.stronger_plant(axis, 0.05)),
        "loop_5": ("plays off by +5 %", lambda axis: wang.wider_plant(axis, 0.05)),
        "creep": (f"creep of {100.0 * wang.CREEP:g} % a decade", wang.creeping),
    }
    rows = []
    for name, (words, change) in conditions.items():
        paper = _judge(change(wang.real(axes[wang.PAPER])), frequency, cycles=2).rms
        better = wang.real(axes[wang.BETTER])
        group = f"Feedback and feedforward together: {words}, {HONEST} rad/s"
        values = {"paper": paper, "none": _judge(change(better), frequency, cycles=2).rms}
        quantities = {
            "paper": f"no feedback, {wang.WORDS[wang.PAPER]}",
            "none": f"no feedback, {wang.WORDS[wang.BETTER]}",
        }
        for kind, parameters in FEEDBACK.items():
            fed_back = change(better.override("motion_controller", **parameters))
            values[kind] = _judge(fed_back, frequency, cycles=2).rms
            quantities[kind] = f"{FEEDBACK_WORDS[kind]}, {wang.WORDS[wang.BETTER]}"
        for kind, value in values.items():
            more = (wang.REAL, FED_BACK) if kind in FEEDBACK else (wang.REAL,)
            rows.append(
                Claim(
                    f"feedback.{name}.{kind}",
                    group,
                    f"{quantities[kind]}: rms, % of amplitude",
                    value,
                    "%",
                    high=paper if kind in FEEDBACK else None,
                    assumptions=_assumed(wang.PAPER if kind == "paper" else wang.BETTER, *more),
                )
            )
    return rows
