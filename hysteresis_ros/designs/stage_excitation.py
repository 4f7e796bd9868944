# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Excitation of a stage: all axes together with orthogonal multisines, or one axis after the other, in one run.

The stage runs in open loop, without inverses and without its decoupling, so that each axis drives its own actuator.
Orthogonal multisines form groups of n realisations for n axes; each realisation has settling periods and evaluated
periods. Other recipes move one axis after the other. Meanwhile the other axes stay at 0 V, or at the end of their range
nearest to 0 V.
"""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import STAGE, Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.excitations import orthogonal_multisines
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.references.recipes import (
    SMALL,
    driven,
    recipe,
    there_and_back,
    write_samples,
)
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters

#: Default period of the multisine [samples].
PERIOD = 2000
MULTISINE = "multisine"
#: Default number of realisations per axis. Because of hysteresis the realisations differ, and a design must assume the
#: worst case of the remaining uncertainty. For plants 2 and 8 of ``bench_scan.py``, whose actuators are of other
#: classes than the models, the loops had bandwidths of 0.05 … 24 Hz with three realisations, and of 350 … 660 Hz with
#: six. With twelve, plant 8 gained another 1 %.
REALISATIONS = 6
#: A multisine is too small for an identification if a slew rate reduces it to less than this fraction of its amplitude.
WEAK = 0.1


@dataclass(frozen=True)
class StageExcitation:
    """Settings of an excitation of a stage."""

    name: str = MULTISINE  #: Name of a recipe.
    amplitude: float = 1.0  #: Factor on the amplitude of the recipe.
    frequency: float | None = None  #: Line spacing of the multisine, or cycle frequency of another recipe [Hz].
    realisations: int | None = None  #: Number of realisations; by default :data:`REALISATIONS` for each axis.
    periods: int = 2  #: Number of evaluated periods of each realisation.
    settle: int = 1  #: Number of settling periods before the evaluated periods.
    one_by_one: bool = False  #: Whether the multisines excite one axis after the other.
    duration: float | None = None  #: Duration of the recipe of each axis [s].
    seed: int = 1
    #: Voltages of the axes before and after the excitation [V]; by default 0 V, or the end of the range nearest to 0 V.
    rests: tuple[float, ...] | None = None

    def rest(self, place: int, limits: LimitsParameters) -> float:
        """Return the voltage of an axis before and after the excitation [V]."""
        return min(max(0.0, limits.minimum), limits.maximum) if self.rests is None else self.rests[place]

    def count(self, axes: int) -> int:
        """Return the number of realisations for this number of axes."""
        return REALISATIONS * axes if self.realisations is None else self.realisations


@dataclass(frozen=True, eq=False)
class ExcitedStage:
    """A stage that outputs an excitation."""

    stage: StageParameters
    duration: float  #: [s]
    voltages: np.ndarray  #: shape (N, n) [V]
    words: str  #: Description of the excitation.


def excited_stage(configuration: Configuration, asked: StageExcitation, path) -> ExcitedStage:
    """Return the stage that outputs an excitation; the samples are written to files next to ``path``."""
    parameters = StageParameters.from_configuration(configuration)
    rate = parameters.sample_rate
    if asked.name != MULTISINE and (asked.one_by_one or asked.realisations is not None):
        raise ConfigurationError(f"--realisations and --one-by-one belong to the recipe {MULTISINE}; omit them")
    voltages, words = multisines(parameters, asked) if asked.name == MULTISINE else _in_turn(parameters, asked)
    return ExcitedStage(played_stage(configuration, voltages, path), len(voltages) / rate, voltages, words)


def played_stage(
    configuration: Configuration, voltages: np.ndarray, path, ranges: Sequence[tuple[float, float]] | None = None
) -> StageParameters:
    """Return the stage that outputs ``voltages`` [V], shape (N, n), from files that are written next to ``path``.

    Plants and compensators are limited to ``ranges`` [V], by default the ranges of the configuration.
    """
    parameters = StageParameters.from_configuration(configuration)
    rate, path = parameters.sample_rate, pathlib.Path(path)
    given = configuration.override(STAGE, decoupling=(), feedforward__weights=(), scan__kind="")
    for place, (axis, name, volts) in enumerate(zip(parameters.axes, parameters.names, voltages.T, strict=True)):
        compensator = axis.hysteresis_compensator
        limits = compensator.limits
        if ranges is not None:
            limits = replace(limits, minimum=ranges[place][0], maximum=ranges[place][1])
            narrow = {"limits.minimum": limits.minimum, "limits.maximum": limits.maximum}
            own = [(f"{axis.namespace}/{node}", narrow) for node in ("plant_simulator", "hysteresis_compensator")]
            given = replace(given, entries=(*given.entries, *own))
        gain = hysteresis_block(compensator.hysteresis, 1.0 / rate).gain
        file = write_samples(path.with_name(f"{path.name}_{name}_waveform.npz"), volts * gain, rate)
        rest = gain * min(max(0.0, limits.minimum), limits.maximum)
        waveform = {"type": "file", "cycles": 1, "file.path": file, "file.column": "reference", "offset": 0.0 - rest}
        alone = driven(configuration, limits, gain, waveform)
        given = replace(given, entries=(*given.entries, *scoped(configuration, alone, axis.namespace)))
    return StageParameters.from_configuration(given).with_duration(len(voltages) / rate)


def scoped(configuration: Configuration, changed: Configuration, namespace: str) -> list[tuple[str, dict]]:
    """Return the parameters that a changed configuration adds, with the namespace of an axis."""
    added = changed.entries[len(configuration.entries) :]
    return [(namespace + pattern.removeprefix("/**") if pattern != "/**" else pattern, own) for pattern, own in added]


def multisines(parameters: StageParameters, asked: StageExcitation) -> tuple[np.ndarray, str]:
    """Return orthogonal multisines about the middle of the ranges, shape (N, n) [V], and their description."""
    names, rate, count = parameters.names, parameters.sample_rate, len(parameters.names)
    realisations = asked.count(count)
    for name, value, least in (
        ("realisations", realisations, count),
        ("periods", asked.periods, 1),
        ("settle", asked.settle, 0),
    ):
        if value < least:
            why = f", one for each of the axes {', '.join(names)}" if name == "realisations" else ""
            raise ConfigurationError(f"--{name} {value}: must be at least {least}{why}")
    largest = 0.5 / SMALL
    if not 0.0 < asked.amplitude <= largest:
        raise ConfigurationError(
            f"--amplitude {asked.amplitude:g}: must be above 0 and at most {largest:g} for multisine"
        )
    spacing = asked.frequency or rate / PERIOD
    N = round(rate / spacing)
    # all lines are excited, because a design must assume a resonance where the response is unknown
    lines = np.arange(1, (N + 1) // 2)
    if N < 32:
        raise ConfigurationError(f"--frequency {spacing:g} Hz: must be at most {rate / 32:g} Hz, 32 samples per period")
    if asked.one_by_one:
        # each realisation excites one axis, in turn
        single = orthogonal_multisines(1, N, lines, realisations, asked.seed)[:, :, 0]
        table = np.zeros((realisations, N, count))
        turn = np.arange(realisations) % count
        table[np.arange(realisations), :, turn] = single
    else:
        table = orthogonal_multisines(count, N, lines, realisations, asked.seed)
    played = np.repeat(table[:, None], asked.settle + asked.periods, axis=1).reshape(-1, count)
    columns, slowed, weakest = [], [], 1.0
    for place, (axis, name, samples) in enumerate(zip(parameters.axes, names, played.T, strict=True)):
        limits = axis.hysteresis_compensator.limits
        middle = 0.5 * (limits.minimum + limits.maximum)
        peak = asked.amplitude * SMALL * (limits.maximum - limits.minimum)
        rates = [one.limits.slew_rate for one in (axis.hysteresis_compensator, axis.plant_simulator)]
        slew = min((one for one in rates if one > 0.0), default=np.inf)
        allowed = slew / rate / np.max(np.abs(np.diff(samples)))
        weakest = min(weakest, allowed / peak)
        if allowed < peak:
            slowed.append(f"{name} {100.0 * allowed / peak:.0f} %")
        columns.append(there_and_back(middle + min(peak, allowed) * samples, asked.rest(place, limits), rate))
    how = "one axis after the other" if asked.one_by_one else "orthogonal"
    words = f"multisines, {how}: {realisations} realisations of {asked.settle} + {asked.periods} periods of {N} samples"
    if slowed:
        words += f"; the slew rate reduces the amplitude to: {', '.join(slowed)}"
        if weakest < WEAK:
            words += " (raise limits.slew_rate of plant_simulator and hysteresis_compensator)"
    return np.array(columns).T, words


def _in_turn(parameters: StageParameters, asked: StageExcitation) -> tuple[np.ndarray, str]:
    """Return the voltages that apply a recipe to one axis after the other, shape (N, n) [V], and their description."""
    rate, parts = parameters.sample_rate, []
    rests = [asked.rest(place, axis.hysteresis_compensator.limits) for place, axis in enumerate(parameters.axes)]
    for place, axis in enumerate(parameters.axes):
        limits = axis.hysteresis_compensator.limits
        found = recipe(
            asked.name,
            limits.minimum,
            limits.maximum,
            rate,
            frequency=asked.frequency,
            amplitude=asked.amplitude,
            duration=asked.duration,
        )
        volts = found.samples
        if volts is None:
            waveform = Waveform(WaveformParameters.from_mapping(found.waveform), 1.0 / rate)
            volts = waveform.simulate(np.zeros(round(found.duration * rate)))
        alone = there_and_back(volts, rests[place], rate)
        whole = np.tile(rests, (len(alone), 1))
        whole[:, place] = alone
        parts.append(whole)
    return np.concatenate(parts), f"{asked.name} of one axis after the other ({', '.join(parameters.names)})"
