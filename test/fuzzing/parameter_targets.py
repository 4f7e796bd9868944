# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files that describe an axis and its learned corrections: YAML and JSON."""

from __future__ import annotations

import functools
from pathlib import Path

import yaml
from judging import Target
from mutations import YAML_WORDS, mutated_text, mutated_value
from table_targets import given

#: A short file of one axis, with entries that do not belong to nodes.
AXIS = """\
/**:
  ros__parameters: {sample_rate: 1000.0, faults: ["spike:0.1:0.2:1e-6"]}
/**/plant_simulator:
  ros__parameters:
    hysteresis: {type: proportional, proportional: {gain: 1.0e-7}}
    limits: {minimum: -10.0, maximum: 150.0}
/**/hysteresis_compensator:
  ros__parameters:
    hysteresis: {type: proportional, proportional: {gain: 1.0e-7}}
    inverse.type: exact
    limits: {minimum: 0.0, maximum: 100.0}
/**/motion_controller:
  ros__parameters: {type: pid, pid: {Kp: 0.1, Ki: 5e1}}
/**/reference_generator:
  ros__parameters: {waveform: {type: sine, amplitude: 1.0e-6}, minimum: 0.0, maximum: 1.0e-5}
"""
FITTED = """\
/commissioning:
  ros__parameters: {minimum: 0.0, maximum: 100.0, stroke: 1.0e-5}
/identification:
  ros__parameters: {voltage_range: [0.0, 100.0], intersample: zoh, continuous: {lag: 1.0e-3, delay: 0.0,
    creep_rate: 0.0, longest_time: 1.0, modes: {frequency: [100.0], damping: [0.1], position: [1.0],
    velocity: [0.0]}, numerator: [1.0], denominator: [1.0, 2.0]}}
"""


def _configurations() -> list[bytes]:
    return [AXIS.encode(), (AXIS + FITTED).encode(), b"a:\n  b:\n    ros__parameters:\n      x: [1, 2.5, .inf]\n"]


def _read_configuration(data: bytes, folder: Path):
    from hysteresis_ros.configuration import load_configuration

    configuration = load_configuration(given(data, folder, "axis.yaml"))
    return configuration.namespaces(), configuration.node("motion_controller", "a")


@functools.cache
def _entries() -> list[bytes]:
    import json

    from hysteresis_ros.configuration import parse_configuration

    return [json.dumps(dict(parse_configuration(text, "axis").entries)).encode() for text in (AXIS, AXIS + FITTED)]


def _read_axis(data: bytes, folder: Path):
    """Values of every type under known names, as they follow from a parameter file after YAML."""
    import json

    from hysteresis_ros.cli.commissioning.situation import plan_of
    from hysteresis_ros.configuration import Configuration
    from hysteresis_ros.loop.parameters import AxisParameters

    configuration = Configuration(tuple(_mappings(json.loads(data)).items()), "", "axis.yaml")
    return plan_of(configuration, AxisParameters.from_configuration(configuration, ""))


def _mappings(content) -> dict[str, dict]:
    content = content if isinstance(content, dict) else {}
    return {name: values for name, values in content.items() if isinstance(values, dict)}


def _read_chain(data: bytes, folder: Path):
    import json

    from hysteresis_ros.configuration import dump_configuration
    from hysteresis_ros.identification.parameter_file import load_chain

    path = folder / "axis.yaml"
    try:
        path.write_text(dump_configuration(_mappings(json.loads(data))), encoding="utf-8")
    except (TypeError, ValueError, AttributeError):
        path.touch()  # JSON content that YAML cannot express
    return load_chain(path)


@functools.cache
def _known_parameters() -> tuple[str, ...]:
    from hysteresis_ros.loop.parameters import NODE_PARAMETERS

    names = [row.name for parameters in NODE_PARAMETERS.values() for row in parameters.table()]
    return (*names[::7], "bouc_wen", "duhem", "sliding_mode", "super_twisting", "triangle", "steps", "file", "camera")


def _corrections() -> list[bytes]:
    values = {
        "configuration": "",
        "period": 0.004,
        "sample_time": 0.001,
        "correction": [1e-9] * 4,
        "reference": [1e-6] * 4,
    }
    return [yaml.safe_dump({"learned_correction": values}).encode()]


def _read_correction(data: bytes, folder: Path):
    from hysteresis_ros.control.learning import read_learned

    return read_learned(given(data, folder, "learned.yaml"))


def _walks() -> list[bytes]:
    return [yaml.safe_dump({"inchworm_walk": {"step": 1e-5, "forward": [1e-9] * 4, "backward": [0.0] * 4}}).encode()]


def _read_walk(data: bytes, folder: Path):
    from hysteresis_ros.references.inchworm_sequencer import read_walk

    return read_walk(given(data, folder, "walk.yaml"), 4, 1e-5, 1e-7)


def _outcomes() -> list[bytes]:
    import json
    from dataclasses import asdict

    from hysteresis_ros.analysis.commissioning_report import Line, Picture
    from hysteresis_ros.cli.commissioning.situation import Outcome

    picture = Picture("a title", "t [s]", "y [µm]", [Line("y", [0.0, 1.0], [1.0, 2.0])])
    return [json.dumps(asdict(Outcome(["done"], {"gain_m_per_V": 1e-7, "rows": [1, 2]}, [picture], 1.5))).encode()]


def _read_outcome(data: bytes, folder: Path):
    from hysteresis_ros.cli.commissioning.situation import STATE, Folder

    place = folder / "stages"
    if not place.exists():
        Folder(place, "", "offline", resumed=False)
    (place / "noise.json").write_bytes(data)
    return Folder(place, "", "offline", resumed=True).outcome("noise"), STATE


def _read_state(data: bytes, folder: Path):
    from hysteresis_ros.cli.commissioning.situation import STATE, Folder

    place = folder / "stages"
    place.mkdir(exist_ok=True)
    (place / STATE).write_bytes(data)
    return Folder(place, "", "offline", resumed=True)


def _states() -> list[bytes]:
    import hashlib
    import json

    return [json.dumps({"file": hashlib.sha256(b"").hexdigest(), "bench": "offline"}).encode()]


WORDS = (*YAML_WORDS, "0x" + "f" * 5000)
TARGETS = (
    Target("parameter files", _read_configuration, _configurations, mutated_text, WORDS, 300, file="axis.yaml"),
    Target("parameters of an axis", _read_axis, _entries, mutated_value, _known_parameters(), 100),
    Target("identified files", _read_chain, _entries, mutated_value, _known_parameters(), 60, file="axis.yaml"),
    Target("learned corrections", _read_correction, _corrections, mutated_text, WORDS, file="learned.yaml"),
    Target("learned walks", _read_walk, _walks, mutated_text, WORDS, file="walk.yaml"),
    Target("outcomes of stages", _read_outcome, _outcomes, mutated_value, file="stages"),
    Target("state of a commissioning", _read_state, _states, mutated_text, file="stages"),
)
