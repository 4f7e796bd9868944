# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The parameter file of an unknown axis: open loop, no inverse, small limits, slow motion."""

from __future__ import annotations

import json
import pathlib
import string
from collections.abc import Mapping
from dataclasses import dataclass

import yaml

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.identification.safe_motion import DIGITS, safe_slew, with_safe_motion
from hysteresis_ros.loop.parameters import require_message_rate
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.units import quantity_in, readable

#: Plausible strokes [m], gains [m/V] and sample rates [Hz]; values outside usually come from a wrong unit.
STROKES, GAINS, RATES = (1e-9, 0.1), (1e-12, 1e-3), (5.0, 1e6)
#: Largest distance from the safe voltage for an unknown axis, as a fraction of the voltage range; also the fraction of
#: the slew rate that a setpoint may use.
FIRST_PART = 0.1

_TEMPLATE = string.Template("""\
# A new, unknown axis, written by `hysteresis new`: open loop, no inverse, ±$percent % of the range, slow.
# `hysteresis commission` measures the rest and writes a file with model and controller. SI units.
/**:
  ros__parameters:
    sample_rate: $rate                # Hz
    time_mode: realtime
    joint: $joint                     # name in joint_states
$external
/**/plant_simulator:                  # the device, or its simulation offline
  ros__parameters:
$driver
    limits: {minimum: $low, maximum: $high, slew_rate: $slew}   # V, V, V/s: $reason
    safe_voltage: $safe               # V: output when commands stop, and at the end
    safe_slew_rate: $slew             # V/s
    hysteresis: {type: proportional, proportional: {gain: $gain}}   # m/V: ASSUMED, stroke over range

/**/reference_generator:
  ros__parameters:
    minimum: $nearest                 # m, within the limits
    maximum: $farthest
    initial_setpoint: $start
    # m/s, m/s², m/s³. Resonances are unknown, so a motion reaches only $percent % of the slew rate, in $ramp s
    approach: {maximum_velocity: $velocity, maximum_acceleration: $acceleration, maximum_jerk: $jerk}

/**/motion_controller:
  ros__parameters:
    type: open_loop

/**/hysteresis_compensator:
  ros__parameters:
    inverse: {type: none}
    limits: {minimum: $low, maximum: $high, slew_rate: $slew}   # V: range of manual commands
    safe_voltage: $safe
    safe_slew_rate: $slew
    hysteresis: {type: proportional, proportional: {gain: $gain}}

# Not a node: the movements that `hysteresis commission` may make.
/commissioning:
  ros__parameters:
    minimum: $minimum                 # V
    maximum: $maximum
    stroke: $stroke                   # m, expected over this range
""")


_STAGE_TEMPLATE = string.Template("""\
# A new, unknown stage of coupled axes, written by `hysteresis new`: open loop, ±$percent % of the ranges, slow.
# `hysteresis commission` measures the rest and writes a file with model and controllers. SI units.
/**:
  ros__parameters:
    sample_rate: $rate                # Hz
    time_mode: realtime

/stage:                               # couples the axes
  ros__parameters:
    axes: $names                      # in the order of the inputs and outputs of the structure
    type: hammerstein                 # hysteresis of each actuator in front of the structure
    # ASSUMED: each actuator moves only its own sensor, one sample later; modes and cross-talk are identified
    structure:
      inputs: $count
      outputs: $count
      A: $zeros
      B: $identity
      C: $identity
      sample_time: $step              # s
    sensor_matrix: []                 # each sensor measures its axis
    decoupling: []                    # each actuator drives its axis
""")


@dataclass(frozen=True)
class NewAxis:
    """Data that the user gives for a new axis."""

    stroke: float  #: Displacement over the range of voltage [m].
    minimum: float  #: minimum, maximum: Range of voltage [V].
    maximum: float
    sample_rate: float  #: [Hz]
    driver: str = ""  #: Name or path of a driver; empty: the simulated plant.
    driver_options: tuple[str, ...] = ()  #: Each ``NAME=VALUE``.
    external: bool = False  #: Whether a node of the user replaces the plant.
    joint: str = "stage"  #: Name in ``joint_states``.


def parsed(option: str, text: str, unit: str) -> float:
    """Return the SI value of a quantity."""
    try:
        return quantity_in(text, unit)
    except ValueError as error:
        raise ConfigurationError(f"{option} {text!r}: {error}") from None


def parsed_range(option: str, text: str, unit: str) -> tuple[float, float]:
    """Return both ends [SI] of a range such as ``0:100V``, ``-30..120 V`` or ``100V`` (from 0)."""
    for mark in ("...", "…", "..", ":"):
        if mark in text:
            low, _, high = text.partition(mark)
            break
    else:
        low, high = "0", text
    ends = parsed(option, low.strip(), unit), parsed(option, high.strip(), unit)
    if not ends[0] < ends[1]:
        raise ConfigurationError(
            f"{option} {text!r}: the first value must be below the second one, such as 0:100{unit}"
        )
    return ends


def new_text(axis: NewAxis) -> str:
    """Return the text of the parameter file of a new axis."""
    if axis.external and axis.driver:
        raise ConfigurationError("--driver and --plant external exclude each other; give one of them")
    if axis.driver_options and not axis.driver:
        raise ConfigurationError("--driver-option belongs to --driver; give both")
    _require_plausible(axis)
    safe = min(max(0.0, axis.minimum), axis.maximum)
    small = FIRST_PART * (axis.maximum - axis.minimum)
    low, high = max(axis.minimum, safe - small), min(axis.maximum, safe + small)
    gain, first = axis.stroke / (axis.maximum - axis.minimum), safe_slew(axis.maximum - axis.minimum)
    slew = first.rate
    velocity, acceleration = FIRST_PART * gain * slew, gain * slew
    # each of the two averages of the approach lasts 2 · velocity / acceleration
    jerk = acceleration**2 / velocity
    numbers = {
        "rate": axis.sample_rate,
        **{"low": low, "high": high, "safe": safe, "slew": slew, "gain": gain},
        **{"nearest": gain * low, "farthest": gain * high, "start": gain * safe},
        **{"velocity": velocity, "acceleration": acceleration, "jerk": jerk},
        **{"minimum": axis.minimum, "maximum": axis.maximum, "stroke": axis.stroke},
    }
    text = _TEMPLATE.substitute(
        {name: _number(value) for name, value in numbers.items()},
        percent=f"{100.0 * FIRST_PART:g}",
        reason=first.reason,
        ramp=f"{4.0 * velocity / acceleration:.{DIGITS}g}",
        joint=_scalar(axis.joint),
        external="    external_plant: true              # your own node publishes joint_states\n"
        if axis.external
        else "",
        driver=_driver_lines(axis),
    )
    return text


def new_stage_text(axes: Mapping[str, NewAxis]) -> str:
    """Return the text of the parameter file of a new stage; each axis has a name, and all have one sample rate."""
    count, rate = len(axes), next(iter(axes.values())).sample_rate
    identity = [float(i == j) for i in range(count) for j in range(count)]
    text = _STAGE_TEMPLATE.substitute(
        percent=f"{100.0 * FIRST_PART:g}",
        rate=_number(rate),
        names=json.dumps(list(axes)),  # quoted, because the parser of ROS reads y as true
        count=count,
        zeros=_scalar([0.0] * count**2),
        identity=_scalar(identity),
        step=_number(1.0 / rate),
    )
    for name, axis in axes.items():
        own = new_text(axis)
        own = own[own.index("/**/plant_simulator") :].replace("/**/", f"/{name}/")
        joint = f"    joint: {json.dumps(name)}                        # name in joint_states"
        text += f"\n/{name}/**:\n  ros__parameters:\n{joint}\n\n"
        text += own.replace("\n/commissioning:", f"\n/{name}/commissioning:")
    for name in axes:
        text = with_safe_motion(text, "the new stage", f"/{name}")
    return text


def _require_plausible(axis: NewAxis) -> None:
    """Refuse implausible values, and values that are not above 0."""
    span = axis.maximum - axis.minimum
    gain = axis.stroke / span
    over = f"{readable(axis.stroke, 'm')} over {span:g} V"
    for option, value, unit, (low, high), words in (
        ("--stroke", axis.stroke, "m", STROKES, ""),
        ("--stroke and --voltage", gain, "m/V", GAINS, f"{over} are "),
        ("--rate", axis.sample_rate, "Hz", RATES, ""),
    ):
        if not low <= value <= high:
            raise ConfigurationError(
                f"{option}: {words}{value:.4g} {unit}: must be {low:g} to {high:g} {unit}; check the units, as in "
                "--stroke 100um --voltage 0:100V --rate 2kHz"
            )
    if axis.external:
        require_message_rate(axis.sample_rate, "--plant external")


def _driver_lines(axis: NewAxis) -> str:
    lines = f"    driver: {_scalar(axis.driver)}          # '': simulated"
    if axis.driver_options:
        options = ", ".join(_scalar(option) for option in axis.driver_options)
        lines += f"\n    driver_options: [{options}]"
    return lines


def _number(value: float) -> str:
    """Return a number in a form that YAML and ROS both read as a double."""
    text = f"{value:.6g}"
    if "e" in text and "." not in text:
        return text.replace("e", ".0e")
    return text if "." in text or "e" in text else f"{text}.0"


def _scalar(value) -> str:
    """Return a text or a list as YAML in one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).splitlines()[0]


def write_new(path, new: NewAxis | Mapping[str, NewAxis]) -> None:
    """Write the parameter file of a new axis, or of a stage with several axes by name.

    The file is deleted if the axis or stage cannot be built from it. An existing file is never overwritten.
    """
    path = pathlib.Path(path)
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"{path}: give a name that ends in .yaml")
    if path.exists():
        raise ConfigurationError(f"{path}: exists already; choose another name or remove it")
    text = new_text(new) if isinstance(new, NewAxis) else new_stage_text(new)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    try:
        # a relative path of a driver is relative to the folder of the file
        configuration = load_configuration(path)
        if isinstance(new, NewAxis):
            single_axis(configuration)
        else:
            StageParameters.from_configuration(configuration)
    except HysteresisError:
        path.unlink()
        raise
