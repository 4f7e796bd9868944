# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Shared data of the stages of a commissioning: axis, plan of allowed movements, earlier outcomes.

The plan is the section ``/commissioning`` of a parameter file; no node reads this section. An outcome (figures,
sentences and pictures for a page) is stored as JSON in the folder of the commissioning, with the recordings.
"""

from __future__ import annotations

import hashlib
import json
import pathlib
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Line, Picture
from hysteresis_ros.configuration import Configuration, Parameters, parameter
from hysteresis_ros.errors import ConfigurationError, HysteresisError, Problem
from hysteresis_ros.files import read_json, read_text, write_text
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.references.recipes import driven, write_samples


class CommissioningError(HysteresisError):
    """An implausible result; commissioning stops until the user has checked it."""

    exit_code = 2


@dataclass(frozen=True)
class Outcome:
    """Outcome of a stage."""

    lines: list[str]  #: Sentences for the user.
    figures: dict = field(default_factory=dict)  #: Figures by names that contain their units.
    pictures: list[Picture] = field(default_factory=list)
    seconds: float = 0.0  #: Time for which the axis was driven [s].

    @classmethod
    def from_mapping(cls, mapping: dict) -> Outcome:
        """Return the outcome from a mapping that :func:`dataclasses.asdict` made."""
        lines, figures, seconds = (mapping[name] for name in ("lines", "figures", "seconds"))
        if not (isinstance(lines, list) and isinstance(figures, dict) and isinstance(seconds, (int, float))):
            raise TypeError("an outcome with values of other types")
        pictures = [
            Picture(**{**picture, "lines": [Line(**line) for line in picture["lines"]]})
            for picture in mapping["pictures"]
        ]
        return cls(**{**mapping, "pictures": pictures})


def verdict(ratio: float, most: float) -> str:
    """Return a text that compares the ratio of a result to its prediction with a limit."""
    return "as predicted" if ratio <= most else f"MORE than {most:g} x the prediction"


#: Section of the parameter file with the plan.
SECTION = "/commissioning"


@dataclass(frozen=True)
class Plan(Parameters):
    """Allowed movements of a commissioning."""

    minimum: float = parameter(description="lowest permitted voltage", unit="V", low=-1e4, high=1e4)
    maximum: float = parameter(description="highest permitted voltage", unit="V", low=-1e4, high=1e4)
    stroke: float = parameter(
        description="expected displacement over this range; commissioning stops when the measured one "
        "differs by a factor of 3 or more",
        unit="m",
        low=1e-12,
        high=1.0,
    )
    slew_rate: float = parameter(
        0.0, description="largest slew rate that the amplifier can follow; 0: unlimited", unit="V/s", low=0.0
    )
    current: float = parameter(
        0.0, description="largest current of the amplifier; 0: not known; needs capacitance", unit="A", low=0.0
    )
    capacitance: float = parameter(
        0.0, description="capacitance of the actuator; 0: not known; needs current", unit="F", low=0.0
    )
    noise_duration: float = parameter(4.0, description="duration of the noise measurement", unit="s", low=0.5, high=600)
    step: float = parameter(0.05, description="small step, as a fraction of the range", low=1e-4, high=0.5)
    small: float = parameter(0.02, description="peak of the multisine, as a fraction of the range", low=1e-5, high=0.2)
    cycle_frequency: float = parameter(
        1.0, description="frequency of the decaying cycles", unit="Hz", low=1e-3, high=100.0
    )
    creep_duration: float = parameter(15.0, description="hold time of the creep step", unit="s", low=1.0, high=3600.0)
    scan_frequency: float = parameter(
        5.0, description="frequency of the triangle of the scan", unit="Hz", low=1e-3, high=1e4
    )
    scan_stroke: float = parameter(
        0.0, description="displacement of the scan from peak to peak; 0: 70 % of the measured stroke", unit="m", low=0.0
    )

    def check(self):
        """Yield a Problem when the range is empty, or when only one of current and capacitance is given."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} V)")
        if (self.current > 0.0) != (self.capacitance > 0.0):
            missing = "capacitance" if self.current > 0.0 else "current"
            yield Problem(
                missing, 0.0, "the slew rate follows from current and capacitance together: give both, or neither"
            )

    @property
    def span(self) -> float:
        """Width of the voltage range [V]."""
        return self.maximum - self.minimum

    @property
    def amplifier(self) -> float:
        """Slew rate of the amplifier [V/s]: the smaller of ``slew_rate`` and current / capacitance; 0: not known."""
        charging = self.current / self.capacitance if self.capacitance > 0.0 else 0.0
        return min((rate for rate in (self.slew_rate, charging) if rate > 0.0), default=0.0)

    @property
    def gain(self) -> float:
        """Expected gain [m/V]."""
        return self.stroke / self.span


def plan_of(configuration: Configuration, axis: AxisParameters, **defaults) -> Plan:
    """Return the plan in a parameter file; without one, a plan from the limits and the model of the compensator.

    A section in the namespace of the axis takes precedence over a section for all axes.
    """
    axis.require_generator(
        f"{configuration.source}: an inchworm motor cannot be commissioned; commission its extender alone, in a file "
        "without inchworm_sequencer"
    )
    compensator = axis.hysteresis_compensator
    low, high = compensator.limits.minimum, compensator.limits.maximum
    gain = hysteresis_block(compensator.hysteresis, 1.0 / axis.plant_simulator.sample_rate).gain
    given: dict = {}
    for where in (SECTION, f"{axis.namespace}{SECTION}"):
        given |= next((values for name, values in configuration.entries if name == where), {})
    values = {"minimum": low, "maximum": high, "stroke": 1.0, **defaults, **given}
    plan = Plan.from_mapping(values, prefix=f"{SECTION}: ")
    if "stroke" not in given:
        plan = Plan.from_mapping({**values, "stroke": abs(gain) * plan.span}, prefix=f"{SECTION}: ")
    safe = compensator.safe_voltage
    if not plan.minimum <= safe <= plan.maximum:
        raise ConfigurationError(
            f"{configuration.source}: safe_voltage {safe:g} V of hysteresis_compensator must lie "
            f"within minimum … maximum of {SECTION} ({plan.minimum:g} … {plan.maximum:g} V); change one of them"
        )
    return plan


#: File in the folder with the origin: parameter file and bench.
STATE = "state.json"
#: File in the folder with the identified axis.
IDENTIFIED = "identified.yaml"
#: File in the folder with the axis with a controller.
COMMISSIONED = "commissioned.yaml"
#: File in the folder with the axis that also learns.
LEARNING = "learning.yaml"


class Folder:
    """Folder in which a commissioning keeps its data between stages."""

    def __init__(self, path, text: str, bench: str, resumed: bool):
        self.path = pathlib.Path(path)
        self._own = {"file": hashlib.sha256(text.encode()).hexdigest(), "bench": bench}
        state = self.path / STATE
        if self.path.exists() and not self.path.is_dir():
            raise ConfigurationError(f"{self.path}: is a file, but --directory must be a folder; choose another")
        if self.path.exists() and not resumed:
            raise ConfigurationError(
                f"{self.path}: exists already; continue with --resume, choose another --directory or remove it"
            )
        if resumed and not state.is_file():
            raise ConfigurationError(
                f"{self.path}: contains no commissioning to resume; give the folder of one, or a new --directory "
                "without --resume"
            )
        if not resumed:
            try:
                self.path.mkdir(parents=True)
                self._write(STATE, self._own)
            except OSError as error:
                raise ConfigurationError(f"{self.path}: cannot be created: {error.strerror}; choose another") from None
        self._require_same(state)

    def _require_same(self, state: pathlib.Path) -> None:
        kept = self._read(state)
        words = {
            "file": "the parameter file has changed since this commissioning began; start again in another --directory",
            "bench": f"this commissioning began with {kept.get('bench')!r}, not {self._own['bench']!r}; give "
            "the same options",
        }
        for name, text in words.items():
            if kept.get(name) != self._own[name]:
                raise ConfigurationError(f"{self.path}: {text}")

    def _read(self, path: pathlib.Path) -> dict:
        try:
            found = read_json(read_text(path))
            if not isinstance(found, dict):
                raise ValueError("not a mapping")
            return found
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{path}: cannot be read: {error}; start again in another --directory") from None

    def _write(self, name: str, content: dict) -> None:
        write_text(self.path / name, json.dumps(content, indent=1), ConfigurationError)

    def outcome(self, stage: str) -> Outcome | None:
        """Return the outcome of a stage; None when the stage is not done."""
        path = self.path / f"{stage}.json"
        try:
            return Outcome.from_mapping(self._read(path)) if path.exists() else None
        except (TypeError, KeyError):
            raise ConfigurationError(f"{path}: is not an outcome; repeat the stage: --stage {stage}") from None

    def keep(self, stage: str, outcome: Outcome) -> None:
        """Store the outcome of a stage, which marks it as done."""
        self._write(f"{stage}.json", asdict(outcome))

    def forget(self, stages: Iterable[str]) -> None:
        """Mark stages as not done."""
        for stage in stages:
            (self.path / f"{stage}.json").unlink(missing_ok=True)

    def record(self, stage: str, recording: Recording) -> None:
        """Store the recording of a stage."""
        save_run(recording, self.path / f"{stage}.npz")

    def recording(self, stage: str) -> Recording:
        """Return the recording of a stage that is done."""
        path = self.path / f"{stage}.npz"
        if not path.exists():
            raise CommissioningError(f"{path}: is missing; repeat the stage: --stage {stage}")
        return load_run(path)


#: Fraction of the stroke by which sensor readings may exceed the expected displacements.
OVERTRAVEL = 0.5
#: Margin of the voltage limits around the voltages of a stage, as a fraction of the range; without it, the limits of a
#: stage without movement would be an empty range.
NOTHING = 1e-4


@dataclass
class Situation:
    """The data that all stages share."""

    configuration: Configuration  #: The parameter file, with the plant of the command line.
    axis: AxisParameters
    plan: Plan
    folder: Folder
    model: str = "auto"  #: model, controller: Model to identify and controller to design, or ``auto``.
    controller: str = "auto"
    #: Other models of the axis that a controller must tolerate; by default the models with almost the same error.
    against: tuple[str, ...] | None = None
    #: Called as ``progress(number, text)`` during long computations.
    progress: Callable[[int, str], None] = lambda number, text: None
    found: dict[str, Outcome] = field(default_factory=dict)  #: Outcomes of earlier stages.

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return self.axis.plant_simulator.sample_rate

    @property
    def safe(self) -> float:
        """The safe voltage [V], at which every stage begins and ends."""
        return self.axis.hysteresis_compensator.safe_voltage

    def figure(self, stage: str, name: str) -> float:
        """Return a figure of an earlier stage."""
        if stage not in self.found:
            raise CommissioningError(f"the stage {stage} is not done yet: run it first (--stage {stage})")
        return self.found[stage].figures[name]

    def driven_axis(self, stage: str, voltages: np.ndarray) -> AxisParameters:
        """Return the axis that outputs voltages in open loop, with limits just outside them.

        Units: ``voltages`` [V].
        """
        room = NOTHING * self.plan.span
        low = max(float(voltages.min()) - room, self.plan.minimum)
        high = min(float(voltages.max()) + room, self.plan.maximum)
        configuration = self.within(self.configuration, low, high)
        if "noise" not in self.found:
            # the first stage has the full range, so a device with a narrower range is refused before any movement
            whole = {"limits.minimum": self.plan.minimum, "limits.maximum": self.plan.maximum}
            configuration = configuration.override("plant_simulator", **whole)
        if self.has_device:
            configuration = configuration.override("plant_simulator", **self._watched())
        # the reference of the file may be out of range with these limits; driven() replaces it
        given = self.axis.hysteresis_compensator.limits
        limits = replace(given, minimum=low, maximum=high, slew_rate=self.plan.amplifier)
        block = hysteresis_block(self.axis.hysteresis_compensator.hysteresis, 1.0 / self.rate)
        path = write_samples(self.folder.path / "waveforms" / f"{stage}.npz", voltages * block.gain, self.rate)
        waveform = {"type": "file", "cycles": 1, "file.path": path, "file.column": "reference"}
        # the waveform is added to the setpoint, which is not 0 if the limits exclude 0 V; the voltages are absolute
        setpoint = min(max(0.0, block.gain * limits.minimum), block.gain * limits.maximum)
        configuration = driven(configuration, limits, block.gain, waveform | {"offset": -setpoint})
        found = single_axis(configuration, self.axis.namespace)
        return found.with_duration(voltages.size / self.rate)

    def _watched(self) -> dict:
        """Return parameters that make the travel monitor of a device valid for any model in the file."""
        # the range of plausible measurements follows from the expected gain
        values = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": self.plan.gain, "overtravel": -1.0}
        values |= {name: () for name in ("dynamics.A", "dynamics.B", "dynamics.C")}
        if "noise" in self.found:  # before the stage "noise" is done, the zero of the sensor is unknown
            values |= {"preload.A1": self.figure("noise", "sensor_zero_m"), "overtravel": OVERTRAVEL * self.plan.stroke}
        return values

    @property
    def has_device(self) -> bool:
        """Whether a real device moves instead of the simulated plant of the file."""
        plant = self.axis.plant_simulator
        return bool(plant.driver) or plant.external_plant

    def within(self, configuration: Configuration, low: float, high: float) -> Configuration:
        """Return a configuration with plant and compensator limited to ``low`` … ``high`` [V]."""
        limits = {"limits.minimum": low, "limits.maximum": high, "limits.slew_rate": self.plan.amplifier}
        for node in ("plant_simulator", "hysteresis_compensator"):
            configuration = configuration.override(node, **limits)
        return configuration
