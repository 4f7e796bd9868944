# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""ROS 2 parameter files of identified models, which nodes load unchanged and which state the origin of their numbers.

Plant, compensator and controller have the usual sections of an axis. The section ``/identification`` belongs to no
node, so ROS ignores it; it contains source, figures, assumptions and warnings.
"""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import (
    Configuration,
    Parameters,
    dump_configuration,
    load_configuration,
    parse_configuration,
)
from hysteresis_ros.errors import ConfigurationError, IdentificationError, ParameterError
from hysteresis_ros.files import write_text
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.plant_model import Identification, PlantModel, at_rest
from hysteresis_ros.identification.prediction import INITIAL
from hysteresis_ros.identification.safe_motion import with_safe_motion
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.compensator import CompensatorParameters, reachable_commands
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.declaration import HysteresisModel
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.units import figure_name

#: Section that no node reads.
SECTION = "/identification"
#: Name of a figure: largest possible excess of the gain of loops over a tenth of the range over the model's gain [%].
SMALL_LOOP_GAIN = "small_loop_gain_high_percent"
#: Sample rate of the example axis for a model [Hz].
EXAMPLE_RATE = 1000.0
#: Highest voltage of the example axis for a model [V].
EXAMPLE_VOLTAGE = 100.0
#: Fields that are written for each mode.
MODE_NUMBERS = ("frequency", "damping", "position", "velocity")
_HEADER = """\
# Identified by `hysteresis identify`; a ROS 2 parameter file for the nodes of an axis. SI units.
# /identification is not a node: it states where the numbers come from.
"""


def limits_of(chain: PlantModel) -> tuple[float, float]:
    """Return the range of the recorded voltage [V], extended to 0 V."""
    return min(chain.voltage_low, 0.0), max(chain.voltage_high, 0.0)


def block_mapping(parameters: Parameters, prefix: str) -> dict:
    """Return the flat parameters of a block, without unused variants and empty arrays."""
    kind = getattr(parameters, "type", None)
    values = {}
    variants = {row.name.split(".")[0] for row in type(parameters).table() if "." in row.name}
    for name, value in parameters.to_mapping().items():
        first = name.split(".")[0]
        if value == () or (first in variants and kind is not None and first != kind):
            continue
        values[prefix + name] = value
    return values


def sections(result: Identification) -> dict[str, dict]:
    """Return the sections of plant, compensator, controller and reference generator of an identified axis."""
    chain = result.chain
    low, high = limits_of(chain)
    limits = {"limits.minimum": low, "limits.maximum": high}
    hysteresis = block_mapping(chain.hysteresis, "hysteresis.")
    creep = {} if chain.creep.type == "none" else block_mapping(chain.creep, "creep.")
    linear = replace(chain.dynamics, sample_time=float(chain.sample_time))
    dynamics = block_mapping(linear, "dynamics.") if linear.order else {}
    offset = {"preload.A1": chain.offset} if chain.offset else {}
    inverse = block_mapping(chain.inverse, "inverse.")
    # used only when adaptation.type is set
    adapts = dynamics and chain.hysteresis.model.weighted is not None
    adaptation = {f"adaptation.{name}": value for name, value in dynamics.items()} if adapts else {}
    adaptation |= {"adaptation.zero": chain.offset} if adapts and chain.offset else {}
    model = {f"model.{name}": value for name, value in {**dynamics, **offset}.items()}
    lowest, highest = _reach(chain, low, high)
    stroke = highest - lowest
    commands = {"command_minimum": min(lowest - stroke, 0.0), "command_maximum": max(highest + stroke, 0.0)}
    # a remanent actuator is not at zero at 0 V, so the reference starts at the actuator's position
    start = {"initial_setpoint": lowest} if lowest > 0.0 else {}
    return {
        "/**": {"sample_rate": rate_of(chain.sample_time)},
        "/**/plant_simulator": {**limits, **hysteresis, **creep, **dynamics, **offset},
        "/**/hysteresis_compensator": {**inverse, **limits, **hysteresis, **creep, **adaptation},
        "/**/motion_controller": {"type": "open_loop", **model, **commands},
        "/**/reference_generator": {"minimum": lowest, "maximum": highest, **start},
    }


def rate_of(sample_time: float) -> float:
    """Return the sample rate [Hz] rounded to 9 digits, the accuracy of time stamps in whole nanoseconds.

    Units: ``sample_time`` [s].
    """
    return float(f"{1.0 / sample_time:.9g}")


def _reach(chain: PlantModel, low: float, high: float) -> tuple[float, float]:
    """Return the lowest and highest displacement [m] at rest and at the ends of the voltage range."""
    if not chain.invertible:
        reach = 2.0 * hysteresis_block(chain.hysteresis, chain.sample_time).gain * max(high, -low)
        return (-reach if low < 0.0 else 0.0), reach
    ends = [at_rest(chain.hysteresis, chain.sample_time)]
    for end in (low, high):
        # from rest in small steps, because some models are integrated along the path
        ends.append(
            float(hysteresis_block(chain.hysteresis, chain.sample_time).simulate(np.linspace(0.0, end, 257))[-1])
        )
    return min(ends), max(ends)


def identification_section(
    result: Identification, data: IdentificationData, metrics: dict, skip: int, extra: dict | None = None
) -> dict:
    """Return the section ``/identification``: source, date, figures, assumptions and warnings."""
    chain = result.chain
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    section = {
        "model": result.model,
        "linear": result.linear,
        "source": data.source or "unnamed",
        "input": f"{data.input_name} [{data.input_unit}]",
        "output": f"{data.output_name} [{data.output_unit}]",
        "date": now.isoformat(),
        "sample_range": (data.first, data.first + len(data)),
        "skipped": skip,
        "converged": result.converged,
        "intersample": chain.intersample,
        "initial": chain.initial,
        "synchronous": chain.synchronous,
        "voltage_range": (float(chain.voltage_low), float(chain.voltage_high)),
    }
    if chain.saturation is not None:
        section["saturation"] = chain.saturation
    if chain.linear_part is not None:
        part = chain.linear_part
        section |= {"continuous.lag": part.lag, "continuous.delay": part.delay, "continuous.settled": part.settled}
        section |= {"continuous.creep_rate": part.creep_rate, "continuous.longest_time": part.longest_time}
        section["continuous.hold"] = part.hold
        for name in MODE_NUMBERS if part.modes else ():
            section[f"continuous.modes.{name}"] = tuple(float(getattr(mode, name)) for mode in part.modes)
    if chain.transfer_function is not None:
        section["continuous.numerator"], section["continuous.denominator"] = chain.transfer_function
    figures = {**result.numbers, **metrics}
    for name, value in figures.items():
        if isinstance(value, (bool, int, float, np.floating)) and math.isfinite(value):
            name = figure_name(name, chain.units)
            section[f"metrics.{name}"] = value if isinstance(value, (bool, int)) else float(value)
    for name, value in result.deviations.items():
        if math.isfinite(value):
            section[f"deviations.{name}"] = float(value)
    if result.start:
        section["start"] = result.start
    for name, texts in (("assumptions", assumptions(result)), ("warnings", result.warnings), ("notes", data.notes)):
        if texts:
            section[name] = list(texts)
    return {**section, **(extra or {})}


def assumptions(result: Identification) -> tuple[str, ...]:
    """Return sentences about the assumptions behind the parameter file."""
    low, high = limits_of(result.chain)
    units = result.chain.units
    found = [
        f"limits {low:.6g} ... {high:.6g} {units[0]}: the range of the recorded voltage, not the amplifier's",
        "no noise, no quantisation: the recording does not show which block causes them",
    ]
    if result.chain.offset:
        found.append("preload.A1 is the zero offset of the sensor: displacements count from there")
    if result.chain.linear_part is not None and result.chain.linear_part.lag > 0.0:
        found.append(
            "the lag is assumed to follow the hysteresis; its cause (amplifier, actuator or sensor) is unknown"
        )
    if result.chain.synchronous:
        found.append("quasi-static recording: an axis reads each displacement one sample later")
    if units != USUAL_UNITS:
        found.append(_other_units(units))
    return (*found, *result.assumptions)


#: Units of input and output for which blocks and nodes are written.
USUAL_UNITS = ("V", "m")


def _other_units(units: tuple[str, str]) -> str:
    """Return a sentence that states which units V and m stand for, if the recording has other units."""
    meant = [f"{there} stands for {own}" for there, own in zip(USUAL_UNITS, units, strict=True) if there != own]
    return f"the parameters, their descriptions and the nodes use V and m: here {' and '.join(meant)}"


def file_text(result: Identification, section: dict, excited: float = 0.0) -> str:
    """Return the text of the parameter file, after a check that plant and compensator can be built from it.

    Units: ``excited`` [V/s].
    """
    nodes = {**sections(result), SECTION: section}
    # copy every array, because YAML would write its second occurrence as an alias, which ROS cannot read
    copied = {
        node: {name: tuple(value) if isinstance(value, tuple) else value for name, value in values.items()}
        for node, values in nodes.items()
    }
    units = result.chain.units
    noted = "" if units == USUAL_UNITS else f"# {_other_units(units)}.\n"
    text = _HEADER + noted + dump_configuration(copied)
    configuration = parse_configuration(text, "the identified model")
    try:
        _block(configuration, "plant_simulator", ActuatorParameters)
        _block(configuration, "hysteresis_compensator", CompensatorParameters)
    except ParameterError as error:
        raise IdentificationError(f"this data gives no usable model: {error}") from None
    return with_safe_motion(text, "the identified model", excited=excited)


def example_text(model: HysteresisModel) -> str:
    """Return the parameter file of an axis that has the example of a model and follows a slow sine in open loop."""
    hysteresis = HysteresisParameters(type=model.name, **{model.name: model.example})
    chain = PlantModel(
        hysteresis=hysteresis,
        creep=CreepParameters(),
        dynamics=LinearParameters(),
        sample_time=1.0 / EXAMPLE_RATE,
        voltage_high=EXAMPLE_VOLTAGE,
        inverse=InverseParameters(type=model.inverses[0]),
    )
    nodes = sections(Identification(model=model.name, linear="none", chain=chain, fitted=0))
    compensator = CompensatorParameters(
        inverse=chain.inverse, hysteresis=hysteresis, limits=LimitsParameters(minimum=0.0, maximum=EXAMPLE_VOLTAGE)
    )
    low, high = reachable_commands(compensator, chain.sample_time)
    nodes["/**/reference_generator"] = {
        "minimum": low,
        "maximum": high,
        "initial_setpoint": float(f"{0.5 * (low + high):.3g}"),
        "waveform.type": "sine",
        "waveform.amplitude": float(f"{0.4 * (high - low):.3g}"),
        "waveform.frequency": 1.0,
    }
    title = f"# An axis with the example of the model {model.name}: {model.title}. SI units.\n"
    return title + dump_configuration(nodes)


def model_warnings(result: Identification) -> tuple[str, ...]:
    """Return the warnings of the blocks about their parameters, for example values outside the valid class."""
    chain = result.chain
    return (*chain.hysteresis.chosen.warnings(), *chain.creep.warnings(), *chain.dynamics.warnings())


def write_file(path, text: str) -> None:
    """Write a parameter file completely or not at all."""
    write_text(path, text, IdentificationError)


def _block(configuration: Configuration, node: str, cls, namespace: str = ""):
    """Return the parameters of a block from the parameters of its node."""
    names = {row.name for row in cls.table()}
    values = {name: value for name, value in configuration.node(node, namespace).items() if name in names}
    return cls.from_mapping(values, prefix=f"{configuration.source}: {node}: ").validated()


def load_chain(source, namespace: str = "") -> tuple[PlantModel, dict]:
    """Return the plant of a parameter file or configuration, and the section ``/identification``."""
    configuration = source if isinstance(source, Configuration) else load_configuration(source)
    path = configuration.source if isinstance(source, Configuration) else source
    configuration.require_independent()
    if "hysteresis.type" not in configuration.node("plant_simulator", namespace):
        raise ConfigurationError(
            f"{path}: has no plant_simulator with hysteresis.type; give a parameter file of an axis"
        )
    plant: ActuatorParameters = _block(configuration, "plant_simulator", ActuatorParameters, namespace)
    inverse = InverseParameters(type="general")
    if "hysteresis.type" in configuration.node("hysteresis_compensator", namespace):
        inverse = _block(configuration, "hysteresis_compensator", CompensatorParameters, namespace).inverse
    section = next((dict(values) for name, values in configuration.entries if name == SECTION), {})
    rate = configuration.node("plant_simulator", namespace).get("sample_rate", 1000.0)
    try:
        return _chain(section, plant, inverse, 1.0 / float(rate)), section
    except (TypeError, ValueError, ArithmeticError) as error:
        text = f"sample_rate of plant_simulator or {SECTION} was not written by an identification: {error}"
        raise ConfigurationError(f"{path}: {text}") from None


def _chain(section: dict, plant: ActuatorParameters, inverse: InverseParameters, sample_time: float) -> PlantModel:
    """Return the model of a plant, with the facts about recording and fit that an identification has written."""
    saturation: Any = section.get("saturation")
    low, high = section.get("voltage_range", (plant.limits.minimum, plant.limits.maximum))
    initial = section.get("initial", "zero")
    return PlantModel(
        hysteresis=plant.hysteresis,
        creep=plant.creep,
        dynamics=plant.dynamics,
        sample_time=sample_time,
        offset=plant.preload.offset,
        linear_part=_linear_part(section, plant),
        transfer_function=_transfer_function(section),
        synchronous=bool(section.get("synchronous", False)),
        initial=initial if initial in INITIAL else "zero",
        intersample=str(section.get("intersample", "zoh")),
        voltage_low=float(low),
        voltage_high=float(high),
        inverse=inverse,
        units=_units(section),
        saturation=None if saturation is None else (float(saturation[0]), float(saturation[1])),
    )


def _units(section: dict) -> tuple[str, str]:
    """Return the units of input and output that an identification has written."""
    found = [re.search(r"\[([^\[\]]+)\]$", str(section.get(role, ""))) for role in ("input", "output")]
    given = [match[1] if match else usual for match, usual in zip(found, USUAL_UNITS, strict=True)]
    return given[0], given[1]


def _linear_part(section: dict, plant: ActuatorParameters) -> LinearPart | None:
    names = {"lag", "delay", "creep_rate", "longest_time"}
    found = {name: section.get(f"continuous.{name}") for name in names}
    values: dict[str, Any] = {name: float(value) for name, value in found.items() if value is not None}
    if len(values) < len(found):
        return None if plant.dynamics.order or plant.creep.type != "none" else LinearPart()
    numbers = [section.get(f"continuous.modes.{name}", ()) for name in MODE_NUMBERS]
    return LinearPart(
        **values,
        settled=bool(section.get("continuous.settled", False)),
        modes=tuple(Mode(*map(float, row)) for row in zip(*numbers, strict=True)),
        hold=float(section.get("continuous.hold", 0.0)),
    )


def _transfer_function(section: dict):
    parts: list[Any] = [section.get(f"continuous.{name}") for name in ("numerator", "denominator")]
    return None if None in parts else tuple(tuple(map(float, part)) for part in parts)
