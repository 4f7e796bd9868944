# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Generalised, rate-dependent plays from data, together with lag, delay and creep.

Four structures are compared: plain plays, plays with thresholds that grow with the speed, plays between two envelopes,
and plays with both. The linear part is searched with plain plays and refined with each structure; constrained least
squares gives the weights. A structure with more freedom is chosen only if it predicts held-out blocks of the recording
better (:func:`.hammerstein.survivor`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.hammerstein import (
    HammersteinFit,
    invalid,
    judged_again,
    require_rising,
    robust_fit,
    survivor,
    usable,
    without_drift,
)
from hysteresis_ros.identification.plant_model import stretches
from hysteresis_ros.identification.play_fit import PlayFit, radii
from hysteresis_ros.identification.preprocessing import Condensed, simple_loops
from hysteresis_ros.identification.thresholds import LOOPS_OF_ONE_SIZE, STRUCTURE
from hysteresis_ros.models.block import compiled
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.generalised_play import (
    LARGEST_RATE,
    PLAY,
    GeneralisedPlayHysteresis,
    GeneralisedPlayParameters,
    follow_plays,
)
from hysteresis_ros.recordings.loops import turning_points

PLAYS = 12
#: For each kind of freedom, the parameters searched in addition to the weights; upper limit of the rate, as a fraction
#: of the time between reversals.
FREEDOMS = {"none": (), "rate": ("rate",), "envelopes": ("bend", "spread"), "both": ("rate", "bend", "spread")}
LONGEST_RATE = 0.1
#: Initial value and limits of the mean bend of both envelopes, and of the difference between their bends.
BENDS = {"bend": (0.0, -0.5, 0.5), "spread": (0.05, 0.0, 0.7)}
#: Speeds count as different if the ratio of the largest to the smallest exceeds this value.
DIFFERENT = 2.0
#: Only swings over more than this fraction of the range are compared.
LEAST_SWING = 0.1
#: Smallest slope of the part without hysteresis, as a fraction of the total slope.
LEAST_SLOPE = 1e-6


def fit_generalised_play(
    voltage,
    displacement,
    sample_time: float,
    *,
    play_count: int = PLAYS,
    freedom: str = "auto",
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    history: tuple[float, ...] = (),
    progress=None,
) -> HammersteinFit:
    """Fit voltage → generalised plays → creep → lag and delay.

    Units: ``voltage`` [V], ``displacement`` [m], ``sample_time`` [s].
    """
    if freedom != "auto" and freedom not in FREEDOMS:
        raise IdentificationError(f"freedom = {freedom!r}: must be one of auto, {', '.join(FREEDOMS)}")

    def choose(data):
        return _chosen(data, play_count, freedom, linear, progress)

    def again(before, data, _):
        return judged_again(before.like(data).settle(before, progress), before)

    return robust_fit(voltage, displacement, sample_time, choose, again, skip=skip, history=history)[0]


def _chosen(data: Condensed, play_count: int, freedom: str, linear, progress) -> GeneralisedPlays:
    """Return the fit of the named structure, or of the structure that predicts held-out blocks best."""
    plain = without_drift(lambda data: GeneralisedPlays(data, play_count).fit(linear, progress), data)
    if freedom == "none":
        return plain
    competitors = [plain]
    for names in FREEDOMS.values() if freedom == "auto" else (FREEDOMS[freedom],):
        if names:
            competitors.append(GeneralisedPlays(plain.data, play_count, names).settle(plain, progress))
    if freedom != "auto":
        return competitors[-1]
    competitors = usable(competitors)
    chosen, errors = survivor(competitors, thresholds=(LOOPS_OF_ONE_SIZE if simple_loops(data) else STRUCTURE,))
    chosen.numbers["held_out_rmse_m"] = errors[competitors.index(chosen)]
    return chosen


def competitors(before, progress) -> list[GeneralisedPlays]:
    """Return fits with envelopes and, if the speeds differ, with rate-dependent thresholds.

    The structure of their linear part is the same as in the fit ``before``.

    Fits whose inverse could amplify errors are omitted.
    """
    names = ("envelopes", "rate", "both") if speeds_differ(before.data) else ("envelopes",)
    fits = [GeneralisedPlays(before.data, PLAYS, FREEDOMS[name]).settle(before, progress) for name in names]
    return [fit for fit in fits if invalid(fit) is None and not fit.parameters().chosen.warnings()]


def speeds_differ(data: Condensed) -> bool:
    """Return whether large swings differ in speed; if not, growing thresholds cannot be distinguished from a lag."""
    turns = turning_points(data.voltage)
    swings = np.abs(np.diff(data.voltage[turns]))
    speeds = (swings / np.diff(turns))[swings > LEAST_SWING * data.voltage_range]
    return bool(speeds.size > 1 and speeds.max() > DIFFERENT * speeds.min())


class GeneralisedPlays(PlayFit):
    """Plays with additional freedom, on one set of data."""

    def __init__(self, data: Condensed, play_count: int, names: tuple[str, ...] = ()):
        super().__init__(data)
        self.play_count, self.names = play_count, names
        self.radii = radii(data.voltage_range, play_count, data.reach) + 0.25 * data.voltage_range / play_count
        self.roughness = np.diff(np.eye(len(self.radii) + 1), 2, axis=0)[1:] * play_count**0.5
        half_cycle = data.sample_time * len(data.voltage) / max(len(turning_points(data.voltage)) - 1, 1)
        ranges = {"rate": (0.02 * half_cycle, 0.0, LONGEST_RATE * half_cycle), **BENDS}
        self.extra = tuple((name, *ranges[name]) for name in names)
        self.block: GeneralisedPlayHysteresis | None = None

    def shaped(self, shape, weights, slope: float, offset: float = 0.0) -> GeneralisedPlayParameters:
        """Return the parameters of the block for a given shape.

        Units: ``weights`` [m/V], ``slope`` [m/V], ``offset`` [m].
        """
        return GeneralisedPlayParameters(
            radii=tuple(self.radii.tolist()),
            weights=tuple(np.asarray(weights, dtype=float).tolist()),
            slope=float(slope),
            voltage_low=float(self.data.voltage.min()),
            voltage_high=float(self.data.voltage.max()),
            offset=float(offset),
            **self.shaped_numbers(shape),
        )

    def shaped_numbers(self, shape) -> dict[str, float]:
        """Return the parameters of the block that follow from the shape: bends, rate [s] and memory [s]."""
        bend, spread, rate = (shape.get(name, 0.0) for name in ("bend", "spread", "rate"))
        return {
            "rate": float(rate),
            "memory": float(max(self.data.sample_time, rate / LARGEST_RATE)),
            "rising_bend": float(bend + 0.5 * spread),
            "falling_bend": float(bend - 0.5 * spread),
        }

    def _block(self, shape) -> GeneralisedPlayHysteresis:
        """Return the block for a given shape, with its plays at rest and weights of 1.

        A search uses hundreds of shapes, and checking all parameters takes longer than simulating the plays. The block
        is therefore checked once, and only its shape parameters are replaced.
        """
        if self.block is None:
            self.block = GeneralisedPlayHysteresis(
                self.shaped({}, np.ones(len(self.radii)), 1.0), self.data.sample_time
            )
        self.block.p[:] = self.block.pack(replace(self.block.parameters, **self.shaped_numbers(shape)))
        self.block.reset()
        return self.block

    def columns(self, shape) -> np.ndarray:
        """Return the voltage and the plays, shape (N, 1 + m), zero at rest."""
        data = self.data
        block = self._block(shape)
        rest = block.x[PLAY:].copy()
        if data.history:
            block.simulate(stretches(data.history))
        outputs = np.empty((len(data.voltage), len(self.radii)))
        compiled(follow_plays)(block.p, block.x, data.voltage, outputs)
        found = np.empty((len(outputs), 1 + len(self.radii)))
        found[:, 0] = data.voltage
        np.subtract(outputs, rest, out=found[:, 1:])
        return found

    def like(self, data: Condensed):
        """Return an unfitted model of the same structure for other data."""
        other = GeneralisedPlays(data, self.play_count, self.names)
        other.numbers, other.guess = dict(self.numbers), dict(self.found.values)
        return other

    def parameters(self) -> HysteresisParameters:
        """Return the fit as parameters of the block; plays of weight 0 are omitted."""
        require_rising(float(self.weights.sum()))
        slope = max(float(self.weights[0]), LEAST_SLOPE * float(self.weights.sum()))
        found = self.shaped(self.shape, self.weights[1:], slope)
        moving = self.weights[1:] > 1e-9 * self.weights.sum()
        moving[0] = True
        # the plays start between their envelopes, but the regressors start at zero
        rest = float(np.sum(self.weights[1:])) * self._middle(found)
        found = replace(
            found,
            radii=tuple(self.radii[moving].tolist()),
            weights=tuple(self.weights[1:][moving].tolist()),
            offset=float(self.constants[0]) / self.part.settled_gain - rest,
        )
        return HysteresisParameters(type="generalised_play", generalised_play=found)

    def _middle(self, parameters: GeneralisedPlayParameters) -> float:
        return float(GeneralisedPlayHysteresis(parameters, self.data.sample_time).x[PLAY])
