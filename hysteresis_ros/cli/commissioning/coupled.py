# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Shared data of the stages that commission coupled axes: a plan for each axis, and the runs of all axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hysteresis_ros.cli.commissioning.situation import (
    NOTHING,
    OVERTRAVEL,
    SECTION,
    CommissioningError,
    Folder,
    Outcome,
    Plan,
    Situation,
    plan_of,
)
from hysteresis_ros.configuration import STAGE, Configuration
from hysteresis_ros.designs.stage_excitation import played_stage, scoped
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import reachable_displacements
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import following, hold, write_samples

#: File in the folder: the identified stage with its controllers, whose simulation predicts each run.
DESIGNED = "designed.yaml"


def plans_of(configuration: Configuration, parameters: StageParameters) -> dict[str, Plan]:
    """Return the plan of each axis, from the section for all axes and the section in the namespace of the axis.

    A range in these sections replaces the limits of the plant, as for a single axis; a default range must be within
    these limits. By default the cycles are as fast as in `hysteresis excite`.
    """
    found = {}
    for name, axis in zip(parameters.names, parameters.axes, strict=True):
        plan = plan_of(configuration, axis, cycle_frequency=min(parameters.sample_rate / 500.0, 100.0))
        limits = axis.plant_simulator.limits
        sections = (SECTION, f"{axis.namespace}{SECTION}")
        given = {key for section, values in configuration.entries if section in sections for key in values}
        for what, value, beyond in (
            ("minimum", plan.minimum, plan.minimum < limits.minimum),
            ("maximum", plan.maximum, plan.maximum > limits.maximum),
        ):
            if beyond and what not in given:
                raise ConfigurationError(
                    f"{configuration.source}: axis {name}: limits.{what} = {value:g} V of its hysteresis_compensator "
                    f"is beyond limits.{what} = {getattr(limits, what):g} V of its plant_simulator: give {what} of "
                    f"{sections[1]}"
                )
        found[name] = plan
    return found


def within_plant(plan: Plan, axis: AxisParameters) -> bool:
    """Return whether the range of a plan is within the limits of the plant; a plan may exceed these limits."""
    limits = axis.plant_simulator.limits
    return limits.minimum <= plan.minimum and plan.maximum <= limits.maximum


@dataclass
class StageSituation:
    """The shared data of all stages that commission coupled axes."""

    configuration: Configuration  #: The parameter file.
    parameters: StageParameters
    plans: Mapping[str, Plan]  #: Plans by the names of the axes.
    folder: Folder
    model: str  #: model, controller: Model of the hysteresis to identify, and controller to design.
    controller: str
    #: Called as ``progress(number, text)`` during long computations.
    progress: Callable[[int, str], None] = lambda number, text: None
    #: Outcomes of earlier stages; the figures of each axis are under its name.
    found: dict[str, Outcome] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.parameters.names

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.sample_rate

    @property
    def safe(self) -> tuple[float, ...]:
        """The safe voltage of each axis [V], at which every stage begins and ends."""
        return tuple(axis.hysteresis_compensator.safe_voltage for axis in self.parameters.axes)

    def figures(self, stage: str) -> dict:
        """Return the figures of an earlier stage."""
        if stage not in self.found:
            raise CommissioningError(f"the stage {stage} is not done yet: run it first (--stage {stage})")
        return self.found[stage].figures

    def of_axis(self, name: str) -> Situation:
        """Return the data of one axis, with its own figures of earlier stages."""
        place = self.names.index(name)
        own = {stage: Outcome([], one.figures[name]) for stage, one in self.found.items() if name in one.figures}
        return Situation(
            self.configuration, self.parameters.axes[place], self.plans[name], self.folder, found=own
        )  # the checks of a single axis need no further data

    def within(self) -> Configuration:
        """Return the configuration with the ranges of the plans; each axis holds the middle of its allowed motion.

        An axis that leaves its range of motion by half a stroke stops all axes.
        """
        entries: list[tuple[str, dict]] = []
        for name, axis in zip(self.names, self.parameters.axes, strict=True):
            plan, given = self.plans[name], axis.hysteresis_compensator
            # a new file contains the narrow limits of manual commands, which the plan exceeds
            slew = plan.amplifier or (axis.plant_simulator.limits.slew_rate if within_plant(plan, axis) else 0.0)
            values = {"limits.minimum": plan.minimum, "limits.maximum": plan.maximum, "limits.slew_rate": slew}
            limits = replace(given.limits, minimum=plan.minimum, maximum=plan.maximum)
            narrowed = replace(axis, hysteresis_compensator=replace(given, limits=limits))
            middle = 0.5 * sum(reachable_displacements(narrowed))
            held = {
                "minimum": min(axis.generator.minimum, middle),
                "maximum": max(axis.generator.maximum, middle),
                "waveform.type": "hold",
                "initial_setpoint": middle,
            }
            entries += [
                (f"{axis.namespace}/plant_simulator", {**values, "overtravel": OVERTRAVEL * plan.stroke}),
                (f"{axis.namespace}/hysteresis_compensator", values),
                (f"{axis.namespace}/reference_generator", held),
            ]
        return replace(self.configuration, entries=(*self.configuration.entries, *entries))

    def driven(self, stage: str, voltages: np.ndarray) -> StageParameters:
        """Return the stage that outputs voltages [V], shape (N, n), in open loop, with limits just outside them."""
        ranges = []
        for name, volts in zip(self.names, voltages.T, strict=True):
            plan = self.plans[name]
            room = NOTHING * plan.span
            ranges.append((max(float(volts.min()) - room, plan.minimum), min(float(volts.max()) + room, plan.maximum)))
        return played_stage(self.within(), voltages, self.folder.path / "waveforms" / stage, ranges)

    def in_turn(self, voltages: Callable[[Plan, float, float], np.ndarray]) -> tuple[np.ndarray, dict[str, slice]]:
        """Return voltages [V], shape (N, n), that move one axis after the other, and the samples of each axis."""
        parts, spans, count = [], {}, 0
        for place, name in enumerate(self.names):
            own = voltages(self.plans[name], self.safe[place], self.rate)
            table = np.tile(self.safe, (len(own), 1))
            table[:, place] = own
            parts.append(table)
            spans[name] = slice(count, count + len(own))
            count += len(own)
        return np.concatenate(parts), spans

    def resting(self, seconds: float) -> np.ndarray:
        """Return voltages [V], shape (N, n), that stay at the safe voltages for some time."""
        return np.array([hold(level, seconds, self.rate) for level in self.safe]).T

    def closed(self, configuration: Configuration, stage: str, references: np.ndarray) -> StageParameters:
        """Return the stage, configured to follow references [m], shape (N, n), once."""
        parameters = StageParameters.from_configuration(configuration)
        given = configuration.override(STAGE, scan__kind="")
        for axis, name, reference in zip(parameters.axes, self.names, references.T, strict=True):
            path = write_samples(self.folder.path / "waveforms" / f"{stage}_{name}.npz", reference, self.rate)
            entries = scoped(configuration, following(configuration, path, float(reference[0])), axis.namespace)
            # a run begins and ends where the axis rests at its safe voltage
            ends = {
                "minimum": min(axis.generator.minimum, float(reference.min())),
                "maximum": max(axis.generator.maximum, float(reference.max())),
            }
            entries.append((f"{axis.namespace}/reference_generator", ends))
            given = replace(given, entries=(*given.entries, *entries))
        return StageParameters.from_configuration(given).with_duration(len(references) / self.rate)


def part_of(recording: Recording, span: slice) -> Recording:
    """Return a span of the samples of a recording."""
    signals = {name: values[span] for name, values in recording.signals.items()}
    return Recording(recording.time[span], signals, recording.units, recording.metadata)


def each_axis(
    situation: StageSituation,
    recording: Recording,
    judge: Callable[[Situation, Recording], Outcome],
    spans: Mapping[str, slice] | None = None,
) -> Outcome:
    """Check each axis like a single axis, in its span of samples (by default all samples)."""
    lines, figures, pictures = [], {}, []
    for name in situation.names:
        own = recording.axis(name)
        try:
            outcome = judge(situation.of_axis(name), own if spans is None else part_of(own, spans[name]))
        except CommissioningError as error:
            raise CommissioningError(f"axis {name}: {error}") from None
        lines += [f"{name}: {text}" for text in outcome.lines]
        figures[name] = outcome.figures
        pictures += [replace(one, caption=f"{one.caption}, {name}") for one in outcome.pictures]
    return Outcome(lines, figures, pictures)


def columns_of(situation: StageSituation, recording: Recording, signal: str) -> np.ndarray:
    """Return one signal of all axes, shape (N, n)."""
    return np.column_stack([recording[f"{name}/{signal}"] for name in situation.names])
