# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Bags: MCAP and sqlite files, their metadata, and their messages."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path

import numpy as np
from judging import Target
from mutations import YAML_WORDS, mutated_bytes, mutated_text
from parameter_targets import AXIS
from table_targets import given


@functools.cache
def _bag(storage: str) -> tuple[bytes, bytes, str]:
    """Return the bytes of a small bag's storage, of its metadata, and the name of the former."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    from hysteresis_ros.recordings import cdr

    joints, state = cdr.JointStateEncoder(["extender"]), cdr.JointStateEncoder(["displacement", "voltage"])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with Writer(path, version=9, storage_plugin=getattr(StoragePlugin, storage)) as writer:
            types = cdr.typestore()
            connections = {
                topic: writer.add_connection(topic, kind, typestore=types)
                for topic, kind in (
                    ("/joint_states", cdr.JOINT_STATE),
                    ("/plant_simulator/state", cdr.JOINT_STATE),
                    ("/voltage", cdr.FLOAT64),
                    ("/configuration", cdr.STRING),
                    ("/changes", cdr.STRING),
                )
            }
            writer.write(connections["/configuration"], 0, cdr.encode_string(AXIS))
            writer.write(connections["/changes"], 1, cdr.encode_string('{"sample": 1, "action": "stop"}'))
            for k in range(4):
                stamp = 1_000_000 * (k + 1)
                writer.write(connections["/joint_states"], stamp, joints.encode(stamp, [1e-9 * k]))
                writer.write(connections["/plant_simulator/state"], stamp, state.encode(stamp, [1e-9 * k, 1.0]))
                writer.write(connections["/voltage"], stamp, cdr.encode_float64(1.0 * k))
        (file,) = (child for child in path.iterdir() if child.name != "metadata.yaml")
        return file.read_bytes(), (path / "metadata.yaml").read_bytes(), file.name


def _read_file(data: bytes, folder: Path, name: str):
    from hysteresis_ros.recordings.files import load_run

    return load_run(given(data, folder, name), further=True)


def _replayed(run):
    from hysteresis_ros.recordings.align import setpoints_per_sample
    from hysteresis_ros.recordings.dataset import requests_per_sample

    return len(run) and (setpoints_per_sample(run), requests_per_sample(run))


def _read_folder(data: bytes, folder: Path, storage: str):
    from hysteresis_ros.recordings.files import load_run

    content, _, name = _bag(storage)
    place = folder / "bag"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    (place / name).write_bytes(content)
    (place / "metadata.yaml").write_bytes(data)
    return load_run(place)


def _messages() -> list[bytes]:
    """Return messages, each preceded by a letter that states its type."""
    from hysteresis_ros.recordings import cdr

    types = cdr.typestore()
    kinds = types.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="a")
    value = kinds["diagnostic_msgs/msg/KeyValue"](key="late_commands", value="3")
    status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0, name="/plant_simulator: axis", message="", hardware_id="", values=[value]
    )
    diagnostics = kinds[cdr.DIAGNOSTICS](header=header, status=[status])
    joints = cdr.JointStateEncoder(["extender", "another"], "frame").encode(5, [1.0, 2.0])
    moving = cdr.joint_state_form(["extender"], moving=True).data
    return [
        b"f" + cdr.encode_float64(2.0),
        b"s" + cdr.encode_string("text"),
        b"j" + joints,
        b"j" + moving,
        b"d" + bytes(types.serialize_cdr(diagnostics, cdr.DIAGNOSTICS)),
    ]


def _read_message(data: bytes, folder: Path):
    """A message between two valid messages on its topic, aligned with the others."""
    from hysteresis_ros.recordings import cdr
    from hysteresis_ros.recordings.align import align
    from hysteresis_ros.recordings.bag_reader import Bag

    topics = {
        "f": ("/voltage", cdr.FLOAT64),
        "s": ("/changes", cdr.STRING),
        "j": ("/joint_states", cdr.JOINT_STATE),
        "d": ("/diagnostics", cdr.DIAGNOSTICS),
    }
    name, kind = topics.get(chr(data[0]) if data else "j", topics["j"])
    joints = cdr.JointStateEncoder(["extender"])
    bag = Bag(Path("bag"))
    for k in range(3):
        bag.add("/joint_states", cdr.JOINT_STATE, k, joints.encode(1_000_000 * k, [1e-9]))
        if k == 1:
            bag.add(name, kind, k, data[1:])
    return align(bag, further=True)


def _stamps() -> list[bytes]:
    return [np.arange(1, 9, dtype="<i8").tobytes(), (10**18 + 10**6 * np.arange(8, dtype="<i8")).tobytes()]


def _read_stamps(data: bytes, folder: Path):
    """Arbitrary stamps: valid messages in any order, with any gaps."""
    from hysteresis_ros.recordings import cdr
    from hysteresis_ros.recordings.align import align
    from hysteresis_ros.recordings.bag_reader import Bag

    joints, bag = cdr.JointStateEncoder(["extender"]), Bag(Path("bag"))
    bag.add("/setpoint", cdr.FLOAT64, 0, cdr.encode_float64(1e-6))
    for stamp in np.frombuffer(data[: len(data) // 8 * 8], dtype="<i8").tolist():
        seconds, nanoseconds = divmod(stamp, 10**9)
        bag.add("/joint_states", cdr.JOINT_STATE, stamp, joints.encode((seconds % 2**31) * 10**9 + nanoseconds, [0.0]))
    return _replayed(align(bag))


TARGETS = (
    Target(
        *("mcap bags", functools.partial(_read_file, name="run.mcap"), lambda: [_bag("MCAP")[0]], mutated_bytes),
        suite=80,
        file="run.mcap",
    ),
    Target(
        *("sqlite bags", functools.partial(_read_file, name="run.db3"), lambda: [_bag("SQLITE3")[0]], mutated_bytes),
        suite=60,
        file="run.db3",
    ),
    Target(
        *("metadata of mcap bags", functools.partial(_read_folder, storage="MCAP"), lambda: [_bag("MCAP")[1]]),
        *(mutated_text, YAML_WORDS, 25),
        file="bag",
    ),
    Target(
        *("metadata of sqlite bags", functools.partial(_read_folder, storage="SQLITE3"), lambda: [_bag("SQLITE3")[1]]),
        *(mutated_text, YAML_WORDS, 25),
        file="bag",
    ),
    Target("messages in bags", _read_message, _messages, mutated_bytes, suite=1_000),
    Target("stamps in bags", _read_stamps, _stamps, mutated_bytes, suite=300),
)
