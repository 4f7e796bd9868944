# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Launch one axis, or a stage of coupled axes, that a parameter file describes.

An axis has a plant (or driver), a compensator, a controller and a reference generator (or sequencer).

``ros2 launch hysteresis_ros axis.launch.py config:=kim2009 record:=bags/first namespace:=left``
does what ``hysteresis up`` does; ``ros2 launch hysteresis_ros axis.launch.py -s`` lists the arguments. This file
imports nothing of the package, because ``ros2`` of an apt-installed ROS may run in another Python than the nodes.
"""

from __future__ import annotations

import importlib.util
import json
import pathlib
import shutil
import tempfile

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnShutdown
from launch.events import Shutdown
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

PACKAGE = "hysteresis_ros"
NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller")
CONFIGURATIONS = pathlib.Path(__file__).resolve().parents[1] / "config"
#: Maximum rate on the wall clock at which nodes that exchange messages almost always answer in time [Hz].
MESSAGE_RATE = 300.0
#: Time for the other nodes to exit after one has exited without an error, as at the end of a run [s].
PATIENCE = 5.0

ARGUMENTS = (
    DeclareLaunchArgument(
        "config", default_value="kim2009", description="parameter file, or the name of one that comes with the package"
    ),
    DeclareLaunchArgument("namespace", default_value="", description="namespace of the axis"),
    DeclareLaunchArgument("record", default_value="", description="folder of a new bag; empty: nothing is recorded"),
    DeclareLaunchArgument(
        "composed", default_value="false", choices=["true", "false"], description="true: all nodes in one process"
    ),
    DeclareLaunchArgument(
        "rate",
        default_value="",
        choices=["", "realtime", "lockstep", "fused"],
        description="time mode; empty: that of the parameter file, or fused if messages are too slow for its rate",
    ),
    DeclareLaunchArgument(
        "plant",
        default_value="own",
        choices=["own", "external"],
        description="external: your own node replaces plant_simulator and publishes joint_states",
    ),
    DeclareLaunchArgument(
        "samples", default_value="", description="length of the run [samples]; empty: that of the parameter file"
    ),
    DeclareLaunchArgument(
        "fused", default_value="false", choices=["true", "false"], description="true: the same as rate:=fused"
    ),
    DeclareLaunchArgument(
        "factor",
        default_value="",
        description="seconds of the axis per second of the wall clock; empty: that of the parameter file",
    ),
    DeclareLaunchArgument(
        "autostart",
        default_value="",
        choices=["", "true", "false"],
        description="false: the nodes wait for configure and activate (ros2 lifecycle set); empty: as in the file",
    ),
    DeclareLaunchArgument(
        "description",
        default_value="false",
        choices=["true", "false"],
        description="true: also start robot_state_publisher, for tf and RViz",
    ),
    DeclareLaunchArgument(
        "log_level",
        default_value="info",
        choices=["debug", "info", "warn", "error", "fatal"],
        description="log level of the nodes",
    ),
)


def generate_launch_description():
    """Return the launch description of one axis."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=axis)])


def axis(context):
    """Return the processes of the axis for the given arguments.

    Raises
    ------
    FileNotFoundError
        The parameter file is missing.
    ValueError
        ``samples`` or ``factor`` is not a positive number, or arguments contradict each other or the file.
    """
    given = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    if given["samples"] and not (given["samples"].isdecimal() and int(given["samples"])):
        raise ValueError(f"samples:={given['samples']}: must be a whole number of at least 1, or left out")
    if given["factor"] and not positive(given["factor"]):
        raise ValueError(f"factor:={given['factor']}: must be a number above 0, or left out")
    if given["fused"] == "true":
        if given["rate"] not in ("", "fused"):
            raise ValueError(f"fused:=true with rate:={given['rate']}: leave one of them out")
        given["rate"] = "fused"
    config = configuration(given["config"])
    coupled = coupled_axes(config)
    said = []
    external = given["plant"] == "external"
    for name, usual in (("namespace", ""), ("plant", "own"), ("description", "false")) if coupled else ():
        if given[name] != usual:
            raise ValueError(
                f"{name}:={given[name]}: {given['config']} describes a stage of coupled axes: leave it out"
            )
    if external and given["rate"] not in ("", "realtime"):
        raise ValueError(
            f"rate:={given['rate']} with plant:=external: your own node sets the time, in real time only; leave it out"
        )
    if external and given["factor"]:
        raise ValueError(f"factor:={given['factor']} with plant:=external: your own node sets the time; leave it out")
    chosen = given["rate"] or external or given["composed"] == "true"
    if not chosen and too_fast_for_messages(config, given["factor"]):
        given["rate"] = "fused"
        text = "starts fused: messages between nodes are too slow for its rate in real time (to override: rate:=)"
        said.append(LogInfo(msg=text))
    fused = not external and (given["rate"] == "fused" or describes(config, "time_mode", "fused"))
    composed = given["composed"] == "true" or fused
    motor = has_section(config, given["namespace"], "inchworm_sequencer")
    source = "inchworm_sequencer" if motor else "reference_generator"
    names = ["hysteresis_axis"] if composed else [*NODES[external:], source]
    if has_section(config, given["namespace"], "displacement_camera"):
        names.append("displacement_camera")
    if given["record"] and not fused:
        names.append("recorder")
    folder = pathlib.Path(tempfile.mkdtemp(prefix="axis_launch_"))
    overrides = folder / "overrides.yaml"
    described = folder / "configuration.yaml"
    lockstep = given["rate"] == "lockstep" or (not given["rate"] and describes(config, "time_mode", "lockstep"))
    actions = []
    if coupled:
        values = by_axis(override(given, str(described)), coupled)
        described.write_text(merged(config, values), encoding="utf-8")
        kinds = [""] if composed else [*NODES, source]
        kinds += ["recorder"] if given["record"] and not fused else []
        running = set(kinds)
        for kind in kinds:
            words = [kind] if kind else ["--recorder"] if given["record"] and fused else []
            actions.append(
                Node(
                    package=PACKAGE,
                    executable="hysteresis_stage",
                    arguments=words,
                    parameters=[str(described)],
                    output="screen",
                    ros_arguments=["--log-level", given["log_level"]],
                    on_exit=farewell(kind, running, kind == "recorder" and not lockstep),
                )
            )
        names = []
    else:
        described.write_text(merged(config, override(given, "")), encoding="utf-8")
        overrides.write_text(json.dumps(override(given, str(described))), encoding="utf-8")
        running = set(names)
    for name in names:
        options = dict(
            package=PACKAGE,
            executable=name,
            namespace=given["namespace"],
            parameters=[config, str(overrides)],
            output="screen",
            ros_arguments=["--log-level", given["log_level"]],
            on_exit=farewell(name, running, name == "recorder" and not lockstep),
        )
        if name == "hysteresis_axis" and fused and given["record"]:
            options["arguments"] = ["--recorder"]
        if name == "hysteresis_axis" and external:
            options["arguments"] = ["--external-plant"]
        # hysteresis_axis contains four nodes, which keep their own names.
        actions.append(Node(**options) if name == "hysteresis_axis" else LifecycleNode(name=name, **options))

    if given["description"] == "true":
        actions.append(state_publisher(config, given["namespace"]))

    def clean(event, context):
        shutil.rmtree(folder, ignore_errors=True)

    return [RegisterEventHandler(OnShutdown(on_shutdown=clean)), *said, *actions]


def override(given: dict, config: str) -> dict:
    """Return the parameters that the arguments ``given`` set, as the content of a parameter file (JSON is YAML).

    They are passed in a file, because ``-p node:name:=value`` does not reach a node in a namespace, and the composed
    process has four nodes.
    """
    common, keeper, recorder, source = {}, {}, {}, {}
    if given["rate"]:
        common["time_mode"] = given["rate"]
    if given["plant"] == "external":
        common |= {"external_plant": True, "time_mode": "realtime"}
    if given["description"] == "true":
        source = {"publish_description": False}  # robot_state_publisher publishes it
    if given["autostart"]:
        common["autostart"] = given["autostart"] == "true"
    if given["factor"]:
        keeper["real_time_factor"] = float(given["factor"])
    if given["samples"]:
        common["exit_at_end"] = True
        keeper["samples"] = int(given["samples"])
    if given["record"]:
        # in lockstep the plant waits for the recorder, so that no message is lost
        keeper["wait_for_recorder"] = True
        recorder = {"path": given["record"], "configuration": config}
    # the node that begins and ends the run; with an external plant it is the reference generator
    keeps = "reference_generator" if given["plant"] == "external" else "plant_simulator"
    patterns = {"/**": common, "/**/reference_generator": source, "/**/inchworm_sequencer": source}
    patterns |= {f"/**/{keeps}": {**patterns.get(f"/**/{keeps}", {}), **keeper}, "/**/recorder": recorder}
    return {pattern: {"ros__parameters": values} for pattern, values in patterns.items() if values}


def state_publisher(config: str, namespace: str):
    """Return the robot_state_publisher of the axis.

    Raises
    ------
    ValueError
        robot_state_publisher is not installed.
    """
    try:
        get_package_prefix("robot_state_publisher")
    except PackageNotFoundError:
        raise ValueError(
            "description:=true needs robot_state_publisher (sudo apt install ros-jazzy-robot-state-publisher); "
            "the topic robot_description exists without it"
        ) from None
    command = [ExecutableInPackage("hysteresis", PACKAGE), f" urdf '{config}' --namespace '{namespace}'"]
    prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""
    return Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        namespace=namespace,
        parameters=[
            {"robot_description": ParameterValue(Command(command), value_type=str), "frame_prefix": prefix},
        ],
    )


def coupled_axes(config: str) -> list:
    """Return the names of the axes that the section ``/stage`` of a parameter file couples; empty without one."""
    with open(config, encoding="utf-8") as stream:
        section = (yaml.safe_load(stream) or {}).get("/stage", {})
    return list(section.get("ros__parameters", {}).get("axes", []))


def by_axis(overrides: dict, axes: list) -> dict:
    """Return overrides of a stage under the full names of its sections, so that no patterns have to be matched."""
    common = overrides.get("/**", {}).get("ros__parameters", {})
    found = {"/stage": dict(common)}
    for axis in axes:
        for node in (*NODES, "reference_generator", "recorder"):
            own = overrides.get(f"/**/{node}", {}).get("ros__parameters", {})
            found[f"/{axis}/{node}"] = {**common, **own}
    return {name: {"ros__parameters": values} for name, values in found.items() if values}


def positive(text: str) -> bool:
    """Return whether a text is a number above zero."""
    try:
        return 0.0 < float(text) < float("inf")
    except ValueError:
        return False


def merged(config: str, overrides: dict) -> str:
    """Return the text of a parameter file with the values of the arguments: the configuration of a recording."""
    with open(config, encoding="utf-8") as stream:
        content = yaml.safe_load(stream) or {}
    for pattern, section in overrides.items():
        place = content.setdefault(pattern, {})
        place["ros__parameters"] = {**place.get("ros__parameters", {}), **section["ros__parameters"]}
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False)


def values_of(content, name: str):
    """Yield every value of a parameter in a parameter file, for any node."""
    for key, value in content.items() if isinstance(content, dict) else ():
        if key == name:
            yield value
        else:
            yield from values_of(value, name)


def describes(config: str, name: str, value) -> bool:
    """Return whether the parameter file gives a parameter this value for any node."""
    with open(config, encoding="utf-8") as stream:
        return value in values_of(yaml.safe_load(stream), name)


def too_fast_for_messages(config: str, factor: str = "") -> bool:
    """Return whether the parameter file requests real time at a rate that is too high for nodes that exchange messages.

    False without Numba, because then nothing is faster. A given ``factor`` replaces that of the file.
    """
    with open(config, encoding="utf-8") as stream:
        content = yaml.safe_load(stream)
    modes = set(values_of(content, "time_mode"))
    slowed = float(factor) if factor else min(values_of(content, "real_time_factor"), default=1.0)
    rate = max(values_of(content, "sample_rate"), default=1000.0) * slowed
    compiled = importlib.util.find_spec("numba") is not None
    return modes <= {"realtime"} and compiled and rate > MESSAGE_RATE


def has_section(config: str, namespace: str, node: str) -> bool:
    """Return whether the parameter file has a section of a node for this namespace.

    An ``inchworm_sequencer`` replaces the reference generator; a ``displacement_camera`` is additional. Sections are
    under ``/**/NODE``, or under the full name of the node, also as nested mappings.
    """
    full = "/".join(["", *namespace.strip("/").split("/"), node]).replace("//", "/")

    def sections(name, content):
        for key, value in content.items() if isinstance(content, dict) else ():
            if key == "ros__parameters":
                yield name
            else:
                yield from sections(f"{name}/{str(key).strip('/')}", value)

    with open(config, encoding="utf-8") as stream:
        found = list(sections("", yaml.safe_load(stream)))
    return any(name.rsplit("/", 1)[-1] == node and (name == full or "*" in name) for name in found)


def configuration(text: str) -> str:
    """Return the path of the parameter file that ``config`` names.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        The file is not a parameter file.
    """
    installed = CONFIGURATIONS / f"{text}.yaml"
    for path in (pathlib.Path(text).expanduser(), installed):
        if path.is_file():
            require_parameters(path)
            return str(path.resolve())
    known = ", ".join(sorted(path.stem for path in CONFIGURATIONS.glob("*.yaml")))
    raise FileNotFoundError(f"config:={text}: no such file; give a path or one of: {known}")


def require_parameters(path: pathlib.Path) -> None:
    """Refuse a file without parameters of ROS 2 nodes.

    Raises
    ------
    ValueError
        The message states why, and what is allowed.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        why = "" if any(values_of(content, "ros__parameters")) else "no ros__parameters in it"
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        why = " ".join(str(error).split())
    if why or not all(isinstance(section, dict) for section in content.values()):
        reason = why or "a section is not a mapping"
        raise ValueError(
            f"config:={path}: not a ROS 2 parameter file ({reason}); give one, or the name of a shipped one"
        )


def farewell(name: str, running: set, dispensable: bool = False):
    """Return the actions when the process ``name`` exits: the other nodes of the axis are stopped.

    A recorder in real time is ``dispensable``: when it dies, recording ends and the axis continues. A recorder that
    fails to start (exit code 2) ends the axis.
    """

    def on_exit(event, context):
        running.discard(name)
        if context.is_shutdown:
            return None
        if dispensable and event.returncode not in (0, 2) and running:
            return [LogInfo(msg=f"{name} died: the recording has ended, the axis continues")]
        if event.returncode != 0:
            # only an exception makes `ros2 launch` itself exit with a code other than 0; an event does not
            raise RuntimeError(f"{name} died with exit code {event.returncode}; the rest of the axis is stopped")
        if not running:
            return [EmitEvent(event=Shutdown(reason="the axis has finished"))]
        message = f"{name} has exited; the rest of the axis is stopped"
        stop = [LogInfo(msg=message), EmitEvent(event=Shutdown(reason=message))]
        return [TimerAction(period=PATIENCE, actions=stop)]

    return on_exit
