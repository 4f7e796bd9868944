# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From which periods of a run a correction was learned, and why from the others it was not."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.control.learning.parameters import LearningParameters, period_samples


def after(events: np.ndarray, samples: int) -> np.ndarray:
    """Tell which samples are events, or follow one by at most so many samples.

    Parameters
    ----------
    events : ndarray of bool, shape (N,)
    samples : int
    """
    numbers = np.arange(len(events))
    last = np.maximum.accumulate(np.where(events, numbers, -samples - 1))
    return numbers - last <= samples


def left_out(parameters: LearningParameters, rate: float, signals) -> dict[str, np.ndarray]:
    """Return the samples from which nothing is learned, by reason; the first reason of a sample counts.

    Parameters
    ----------
    parameters : LearningParameters
        Of the learning.
    rate : float
        Samples per second [Hz].
    signals : mapping of str to ndarray, shape (N,)
        Of a recording: ``command``, ``applied``, ``measured``, and where they are known ``skipped`` and ``seen``.
    """
    # what was carried out is known a sample later
    shortfall = np.abs(signals["applied"] - signals["command"]) > parameters.shortfall
    shortfall = np.concatenate([[False], shortfall[:-1]])
    skipped = np.asarray(signals.get("skipped", np.zeros(len(shortfall)))) > 0.5
    unseen = ~np.isfinite(signals.get("seen", signals["measured"]))
    answers, lasts = round(parameters.late_answer * rate), round(parameters.recovery * rate)
    found, known = {}, np.zeros(len(shortfall), dtype=bool)
    for reason, samples in (
        ("late samples", skipped),
        ("what the axis still answered to them", after(skipped, answers)),
        ("commands that limits cut", shortfall),
        ("recovery from those", after(shortfall, lasts)),
        ("measurements that were missing", unseen),
    ):
        found[reason] = samples & ~known
        known |= samples
    return found


def learned_line(parameters: LearningParameters, rate: float, signals, begin: int, count: int) -> str:
    """Say from how many periods was learned, and why from the others was not, or only in part.

    Parameters
    ----------
    parameters : LearningParameters
        Of the learning.
    rate : float
        Samples per second [Hz].
    signals : mapping of str to ndarray, shape (N,)
        See :func:`left_out`.
    begin : int
        First sample of the first period.
    count : int
        Periods.
    """
    period = period_samples(parameters.period, rate)
    reasons = {
        reason: samples[begin : begin + count * period].reshape(-1, period)
        for reason, samples in left_out(parameters, rate, signals).items()
    }
    out = np.sum(list(reasons.values()), axis=(0, 2))
    whole, none = int(np.count_nonzero(out == 0)), int(np.count_nonzero(out == period))
    text = f"learned from {whole} of {len(out)} periods whole"
    if whole == len(out):
        return text
    text += f", from {len(out) - whole - none} in part, from {none} not at all; left out: "
    shares = {reason: float(np.mean(samples)) for reason, samples in reasons.items() if samples.any()}
    return text + ", ".join(f"{100.0 * share:.3g} % of the samples for {reason}" for reason, share in shares.items())
