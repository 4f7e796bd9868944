# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Write an SROS 2 policy of the nodes: ``python -m hysteresis_ros.nodes.security '{"config": …}'``.

The nodes are created and configured in an isolated ROS domain, and their topics and services are listed. No driver is
opened, because the interfaces of a node do not depend on its device. No node is activated, because all interfaces exist
once it is configured. The argument has ``config``, ``output``, ``namespace`` (or null), ``rate`` (or null),
``processes`` (or null: as `up` decides), ``record`` and ``external`` (booleans), ``remap`` (list).
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import pathlib
import sys
import tempfile
from dataclasses import replace

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.loop.parameters import AxisParameters, in_time
from hysteresis_ros.loop.reach import axes
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.nodes.displacement_camera import DisplacementCameraNode
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.fused import FusedAxis
from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
from hysteresis_ros.nodes.inchworm_sequencer import InchwormSequencerNode
from hysteresis_ros.nodes.launcher import require_messages
from hysteresis_ros.nodes.motion_controller import MotionControllerNode
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
from hysteresis_ros.nodes.recorder import RecorderNode
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode
from hysteresis_ros.nodes.remote.client import Client
from hysteresis_ros.nodes.security.policy import (
    MONITOR,
    OPERATOR,
    PAGE,
    RECORDS,
    Enclave,
    Profile,
    enclave_of,
    monitor,
    operator,
    policy_text,
    profile,
    without,
)
from hysteresis_ros.nodes.setpoint_publisher import SetpointPublisher
from hysteresis_ros.nodes.stage import STAGE_INPUTS, stage_nodes
from hysteresis_ros.signals import ACTUATOR

NODES = {
    "plant_simulator": PlantSimulatorNode,
    "reference_generator": ReferenceGeneratorNode,
    "inchworm_sequencer": InchwormSequencerNode,
    "motion_controller": MotionControllerNode,
    "hysteresis_compensator": HysteresisCompensatorNode,
    "displacement_camera": DisplacementCameraNode,
    "recorder": RecorderNode,
}

#: Optional processes beside the nodes: enclave name → function ``profile(axes, context, used_by)`` that returns the
#: profile.
FURTHER = {
    PAGE: "hysteresis_ros.laboratory.watch.link:profile",
    RECORDS: "hysteresis_ros.laboratory.epics.link:profile",
}

#: External plant node, as in ``examples/driver_skeleton.py``.
EXTERNAL = "driver"


def used_by(node, name: str = "", namespace: str = "") -> Profile:
    """Return the present interfaces of a node."""
    name, namespace = name or node.get_name(), namespace or node.get_namespace()

    def names(ask) -> list[str]:
        return [found for found, _ in ask(name, namespace)]

    topics = (names(node.get_publisher_names_and_types_by_node), names(node.get_subscriber_names_and_types_by_node))
    services = (names(node.get_service_names_and_types_by_node), names(node.get_client_names_and_types_by_node))
    return profile(namespace, name, topics, services)


def enclaves_of(
    axes: list[AxisParameters],
    *,
    stage: StageParameters | None = None,
    composed: bool = False,
    record: bool = False,
    remap: tuple[str, ...] = (),
) -> list[Enclave]:
    """Return the enclaves of the processes of a graph with these axes, and of its operators and monitors.

    ``stage`` is the stage of these axes, if there is one; it has a process for each kind of node.
    """
    stay_on_this_machine()
    context = Context()
    rclpy.init(args=["--ros-args", "--log-level", "warn"], context=context)
    with tempfile.TemporaryDirectory() as folder:
        try:
            enclaves = []
            if stage is not None:
                enclaves += _of_stage(stage, context, (composed, record), remap, pathlib.Path(folder) / "stage")
            for number, axis in enumerate(axes if stage is None else ()):
                enclaves += _of_axis(axis, context, (composed, record), remap, pathlib.Path(folder) / str(number))
            return [*enclaves, Enclave(enclave_of("", RECORDS), (_further(RECORDS, axes, context),))]
        finally:
            gc.collect()  # lifecycle nodes are in reference cycles
            context.try_shutdown()


def _of_axis(axis, context, how: tuple[bool, bool], remap, folder: pathlib.Path) -> list[Enclave]:
    """Return the enclaves of one axis."""
    composed, record = how
    fused, namespace = axis.plant_simulator.time_mode == "fused", axis.namespace
    names = [name for name in axis.kind.nodes if _is_ours(name, axis)]
    names += ["displacement_camera"] * (axis.displacement_camera is not None) + ["recorder"] * record
    arguments = _remapped(remap)
    found = {}
    with contextlib.ExitStack() as stack:
        joined = FusedAxis()
        for name in names:
            node = _configured(name, axis, context, arguments, folder, joined if fused else None)
            stack.callback(_destroyed, node)
            found[name] = used_by(node)
    own = _of_a_command(axis, context)
    everyone = tuple(found.values())
    alone = {"displacement_camera"} if fused else {"displacement_camera", "recorder"}
    together = [name for name in names if name not in alone] if composed or fused else []
    enclaves = []
    if together:
        enclaves.append(Enclave(enclave_of(namespace, "hysteresis_axis"), tuple(found[name] for name in together)))
    enclaves += [Enclave(enclave_of(namespace, name), (found[name],)) for name in names if name not in together]
    if axis.plant_simulator.external_plant:
        external = _of_an_external_plant(axis, context)
        everyone += (external,)
        enclaves.append(Enclave(enclave_of(namespace, EXTERNAL), (external,)))
    return [*enclaves, *_of_people(axis, context, everyone, own)]


def _of_people(axis: AxisParameters, context, everyone: tuple[Profile, ...], own: Profile) -> list[Enclave]:
    """Return the enclaves of operator, monitor and page of an axis whose nodes have these profiles."""
    namespace = axis.namespace
    publisher = _of(lambda: SetpointPublisher([(1.0, 0.0)], context=context, namespace=namespace or "/"))
    steering = operator(namespace, everyone, own), publisher
    return [
        Enclave(enclave_of(namespace, OPERATOR), steering),
        Enclave(enclave_of(namespace, MONITOR), (monitor(namespace, everyone, own),)),
        Enclave(enclave_of(namespace, PAGE), (_further(PAGE, [axis], context),)),
    ]


def _remapped(remap: tuple[str, ...]) -> list[str]:
    return ["--ros-args", *(word for rule in remap for word in ("-r", rule))] if remap else []


def _of_stage(stage: StageParameters, context, how: tuple[bool, bool], remap, folder: pathlib.Path) -> list[Enclave]:
    """Return the enclaves of a stage: those of its processes, operator and monitor, and those of each axis.

    The operator of one axis may not publish setpoints and trajectories of the stage, which also move the other axes.
    """
    composed, record = how
    fused, namespace = stage.stage.time_mode == "fused", stage.namespace
    kinds = ["recorder"] * record + [kind for kind in ACTUATOR.nodes]
    found: dict[str, list[Profile]] = {kind: [] for kind in kinds}
    with contextlib.ExitStack() as stack:
        nodes = []
        for kind, axis, make in stage_nodes(stage, kinds):
            options = _node_options(kind, axis, context, _remapped(remap), folder)
            nodes.append((kind, _made(kind, lambda make=make, options=options: make(**options))))
            stack.callback(_destroyed, nodes[-1][1])
        for kind, node in nodes:
            if not node.configure_now():
                raise HysteresisError(f"{kind} of {node.get_namespace()}: {node.failure}")
        for kind, node in nodes:
            found[kind].append(used_by(node))
    together = kinds if fused else list(ACTUATOR.nodes) if composed else []
    processes = {"hysteresis_stage": together} if together else {}
    processes |= {kind: [kind] for kind in kinds if kind not in together}
    enclaves = [
        Enclave(enclave_of(namespace, name), tuple(one for kind in own for one in found[kind]))
        for name, own in processes.items()
    ]
    command = _of_a_command(stage.axes[0], context, namespace)
    everyone = tuple(one for kind in kinds for one in found[kind])
    enclaves.append(Enclave(enclave_of(namespace, OPERATOR), (operator(namespace, everyone, command),)))
    enclaves.append(Enclave(enclave_of(namespace, MONITOR), (monitor(namespace, everyone, command),)))
    shared = {f"{namespace}/{name}" for name in STAGE_INPUTS}
    for place, axis in enumerate(stage.axes):
        alone = tuple(without(found[kind][place], shared) for kind in kinds)
        enclaves += _of_people(axis, context, alone, _of_a_command(axis, context))
    return enclaves


def _is_ours(name: str, axis: AxisParameters) -> bool:
    return name != "plant_simulator" or not axis.plant_simulator.external_plant


def _configured(name: str, axis: AxisParameters, context, arguments, folder: pathlib.Path, joined: FusedAxis | None):
    """Return a configured node of an axis."""
    options = _node_options(name, axis, context, arguments, folder)
    node = _made(name, lambda: NODES[name](namespace=axis.namespace or "/", **options))
    if joined is not None:
        joined.join(node)
    if not node.configure_now():
        failure = node.failure
        _destroyed(node)
        raise HysteresisError(f"{name}: {failure}")
    return node


def _node_options(name: str, axis: AxisParameters, context, arguments, folder: pathlib.Path) -> dict:
    """Return the options with which a node of an axis is created without opening a driver."""
    given = getattr(axis, name)
    if name == "plant_simulator":
        given = replace(given, driver="", driver_options=())
    if name == "recorder":
        given = replace(given, path=str(folder), configuration=_described(axis, folder), inchworm=axis.kind.motor)
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in given.to_mapping().items()}
    overrides = [Parameter(key, value=value) for key, value in values.items() if value != []]
    options = {"context": context, "parameter_overrides": overrides, "cli_args": arguments}
    return options | {"enable_logger_service": False}


def _described(axis: AxisParameters, folder: pathlib.Path) -> str:
    """Return the path of an axis' parameter file if the topics of the recorder depend on it; otherwise empty."""
    if axis.reference_generator is None or axis.reference_generator.waveform.type != "scan":
        return ""
    path = folder.with_name(f"{folder.name}.yaml")
    path.write_text(axis.configuration_text(), encoding="utf-8")
    return str(path)


def _made(name: str, make):
    """Return a node; refuse a wrong remapping with the name of the node."""
    try:
        return make()
    except Exception as error:  # rclpy has an error class of its own for each kind of wrong rule
        raise HysteresisError(f"{name}: {' '.join(str(error).split(', at /')[0].split())}") from None


def _destroyed(node) -> None:
    node.release()
    node.destroy_node()


def _of_a_command(axis: AxisParameters, context, namespace: str | None = None) -> Profile:
    """Return the interfaces of a command's node, of this package or ``ros2``; ``*`` replaces the number in its name."""
    with Client(axis.namespace if namespace is None else namespace, context=context) as client:
        own = used_by(client.node)
        numbered = f"_hysteresis_{os.getpid()}"
    there = {name.replace(numbered, "_hysteresis_*") for name in own.serves}
    # the commands of ros2 are nodes in the root namespace and publish their log
    there |= {"/_ros2cli_*/get_type_description"}
    return replace(own, serves=tuple(sorted(there)), publishes=tuple(sorted({*own.publishes, "/rosout"})))


def _further(name: str, axes: list[AxisParameters], context) -> Profile:
    """Return the profile of an optional process; imports its module."""
    module, _, function = FURTHER[name].partition(":")
    return getattr(importlib.import_module(module), function)(axes, context, used_by)


def _of(make) -> Profile:
    """Return the interfaces of a temporary plain node."""
    node = make()
    try:
        return used_by(node)
    finally:
        node.destroy_node()


def _of_an_external_plant(axis: AxisParameters, context) -> Profile:
    """Return the interfaces of an external plant node that answers voltages with measurements."""
    space = axis.namespace
    plain = _of(lambda: rclpy.create_node(EXTERNAL, namespace=space or "/", context=context))
    return replace(
        plain,
        publishes=tuple(sorted({*plain.publishes, f"{space}/joint_states"})),
        hears=tuple(sorted({*plain.hears, f"{space}/voltage"})),
    )


def main() -> int:
    """Execute the request of the only argument; return the exit code."""
    request = json.loads(sys.argv[1])
    try:
        (found, stage), processes, record = _axes(request), request["processes"], request["record"]
        how = {"stage": stage, "composed": processes is False, "record": record}
        enclaves = enclaves_of(found, **how, remap=tuple(request["remap"]))
        write_file(request["output"], policy_text(enclaves))
    except HysteresisError as error:
        print(f"hysteresis: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(f"{request['output']}: {', '.join(enclave.path for enclave in enclaves)}")
    return 0


def _axes(request: dict) -> tuple[list[AxisParameters], StageParameters | None]:
    """Return the axes that `up` would start with these options, and the stage that couples them."""
    everywhere = {"time_mode": request["rate"]} if request["rate"] else {}
    if request["external"]:
        everywhere["external_plant"] = True
    configuration = load_configuration(request["config"]).override("", **everywhere)
    as_is = request["rate"] is not None or request["processes"] is not None
    stage = None
    if configuration.stage is not None:
        if request["namespace"]:
            text = "the nodes of a stage share processes: omit --namespace"
            raise ConfigurationError(f"--namespace {request['namespace']}: {text}")
        stage = StageParameters.from_configuration(configuration)
        stage = stage if as_is else stage.in_time()
        require_messages(stage)
    found = list(stage.axes) if stage is not None else axes(configuration, request["namespace"])
    if request["record"]:
        found = [axis.with_recorder("recording") for axis in found]
    if stage is not None:
        return found, replace(stage, axes=tuple(found))
    return (found if as_is else [in_time(axis) for axis in found]), None


if __name__ == "__main__":
    raise SystemExit(main())
