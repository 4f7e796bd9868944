# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Every service of every node, including those of ROS, receives random requests: the node answers and continues."""

from __future__ import annotations

import importlib
import os
import random
import re
from functools import partial

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose_stage, until, write_axis  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters, SetParametersAtomically  # noqa: E402

#: Number of requests to each service, and seed of the random numbers; more requests by hand.
REQUESTS, SEED = int(os.environ.get("ANY_REQUESTS", "8")), int(os.environ.get("ANY_SEED", "1"))
NODES = ("reference_generator", "motion_controller", "hysteresis_compensator", "plant_simulator")
#: Services of every node, without those of an action.
SERVICES = {
    *("set_parameters", "set_parameters_atomically", "get_parameters", "get_parameter_types", "describe_parameters"),
    *("list_parameters", "change_state", "get_state", "get_available_states", "get_available_transitions"),
    *("get_transition_graph", "get_type_description", "start", "stop", "reset"),
}
TEXTS = (
    "",
    " ",
    "/",
    "~",
    "a.b",
    "sample_rate",
    "limits.maximum",
    "use_sim_time",
    "type",
    "ä" * 3,
    "\x01",
    "x" * 70000,
)
RANGES = {"int8": (-(2**7), 2**7 - 1), "uint8": (0, 2**8 - 1), "byte": (0, 2**8 - 1), "octet": (0, 2**8 - 1)}
RANGES |= {f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (16, 32, 64)}
RANGES |= {f"uint{bits}": (0, 2**bits - 1) for bits in (16, 32, 64)}
REALS = (0.0, -0.0, 1.0, -1e-300, 1e308, float("nan"), float("inf"), float("-inf"))


def any_value(kind: str, chance: random.Random):
    """Return any value of the type of a field."""
    if kind == "byte":
        return bytes([chance.randrange(256)])
    if sequence := re.fullmatch(r"sequence<(.*?)(?:, (\d+))?>|(.*)\[(\d+)\]", kind):
        item, count = sequence[1] or sequence[3], sequence[4]
        most = min(int(sequence[2] or 4), 4)
        number = int(count) if count else chance.choice((0, 1, 2, most))
        return [any_value(item, chance) for _ in range(number)]
    if kind in ("boolean", "bool"):
        return chance.random() < 0.5
    if kind in RANGES:
        low, high = RANGES[kind]
        return chance.choice((low, high, min(99, high), chance.randint(low, high), chance.randint(0, 10)))
    if kind in ("float", "double"):
        return chance.choice(REALS) if kind == "double" else chance.choice([x for x in REALS if abs(x) != 1e308])
    if kind.startswith(("string", "wstring")):
        text = chance.choice(TEXTS)
        bound = re.search(r"<(\d+)>", kind)
        return text[: int(bound[1])] if bound else text
    package, name = kind.split("/")[0], kind.split("/")[-1]
    return any_message(getattr(importlib.import_module(f"{package}.msg"), name), chance)


def any_message(cls, chance: random.Random):
    """Return a message of a type with any values in its fields."""
    return cls(**{name: any_value(kind, chance) for name, kind in cls.get_fields_and_field_types().items()})


def stops_the_node(name: str, request) -> bool:
    """Whether a request legitimately ends the work of a node: a possible transition."""
    return name == "change_state" and not request.transition.label and request.transition.id in range(1, 9)


@pytest.fixture
def axis(processes, observer, tmp_path):
    """The nodes of an axis in separate processes, running in real time."""
    from sensor_msgs.msg import JointState

    overrides = {"motion_controller": {"type": "open_loop"}}
    given = axis_parameters(sample_rate=50.0, time_mode="realtime", overrides=overrides)
    file = write_axis(tmp_path / "axis.yaml", given)
    nodes = {name: processes.node(name, file) for name in NODES}
    heard = observer.listen(JointState, "/joint_states")
    until(lambda: len(heard) > 10, what="the axis to run")
    return nodes, heard


def services_of(observer, node: str, namespace: str = "") -> dict[str, str]:
    """Return the services of a node by their last word, with their types, once all services are found."""

    def found():
        if (node, namespace or "/") not in observer.node.get_node_names_and_namespaces():
            return {}
        listed = observer.node.get_service_names_and_types_by_node(node, namespace or "/")
        return {name.rsplit("/", 1)[1]: types[0] for name, types in listed}

    expected = SERVICES if node != "setpoint_publisher" else {name for name in SERVICES if "param" in name}
    until(lambda: found().keys() >= expected, what=f"the services of {node}")
    return found()


def assert_goes_on(observer, nodes, heard, what: str) -> None:
    """Check that all processes are alive and that the axis runs, after it was started again."""
    for name in NODES:
        assert nodes[name].popen.poll() is None, f"{what}: {name} left\n{nodes[name].output[-2000:]}"
    # on a busy machine a partner was silent for too long: the plant is started first, as the message says
    for name in ("plant_simulator", *NODES):
        until(lambda name=name: observer.trigger(f"/{name}/start").success, what=f"a start of {name} after {what}")
    since = len(heard)
    until(lambda: len(heard) > since + 5 and heard[-1].header.frame_id == "", what=f"samples after {what}")


def ask_anything(observer, node: str, chance: random.Random, namespace: str = "", requests: int = REQUESTS) -> int:
    """Send each service of a node some requests and wait for the answers; return the number of requests."""
    asked = 0
    for name, kind in services_of(observer, node, namespace).items():
        package, _, service = kind.split("/")
        cls = getattr(importlib.import_module(f"{package}.srv"), service)
        observer.keep_client(cls, f"{namespace}/{node}/{name}")
        for _ in range(requests):
            request = any_message(cls.Request, chance)
            if not stops_the_node(name, request):
                observer.call(cls, f"{namespace}/{node}/{name}", request)
                asked += 1
    return asked


def test_a_node_survives_any_request_of_any_of_its_services(axis, observer):
    nodes, heard = axis
    chance, asked = random.Random(SEED), 0
    for node in NODES:
        asked += ask_anything(observer, node, chance)
        assert_goes_on(observer, nodes, heard, f"requests to {node}")
    print(f"{asked} requests, no node left")
    assert asked > len(NODES) * len(SERVICES) * REQUESTS / 2
    assert not any("Traceback" in nodes[name].output for name in NODES)


@pytest.mark.parametrize("kind", ["recorder", "inchworm_sequencer", "displacement_camera", "setpoint_publisher"])
def test_the_other_nodes_survive_them_too(inside, observer, kind):
    from hysteresis_ros.nodes import displacement_camera, inchworm_sequencer, recorder, setpoint_publisher

    made = {
        "recorder": recorder.RecorderNode,
        "inchworm_sequencer": inchworm_sequencer.InchwormSequencerNode,
        "displacement_camera": displacement_camera.DisplacementCameraNode,
        "setpoint_publisher": partial(setpoint_publisher.SetpointPublisher, []),
    }
    inside.executor.add_node(node := made[kind](context=inside.context))
    if hasattr(node, "release"):  # the publisher of setpoints is not a node of an axis
        inside.nodes.append(node)
    inside.spin()
    some = {"set_parameters", "set_parameters_atomically"}
    assert ask_anything(observer, kind, random.Random(SEED)) > REQUESTS * len(some)


def test_the_nodes_of_a_stage_survive_them_too(inside, observer):
    """The nodes of one axis receive the requests; then both axes continue together."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.stage_parameters import StageParameters

    configuration = load_configuration("xy_scanner").override("", time_mode="realtime")
    configuration = configuration.override("plant_simulator", real_time_factor=0.005, late_limit=-1)
    made = compose_stage(inside, StageParameters.from_configuration(configuration))
    inside.spin()
    chance = random.Random(SEED)
    for kind in NODES:
        assert ask_anything(observer, kind, chance, "/y", REQUESTS // 4 or 1) > len(SERVICES) / 2
    for node in made:
        assert observer.trigger(f"{node.get_fully_qualified_name()}/start").success, node.get_name()
    for node in made:
        since = node.sample
        until(lambda node=node, since=since: node.sample > since + 5, what=f"samples of {node.get_name()}")


@pytest.mark.parametrize("atomically", [False, True])
def test_a_parameter_without_a_name_or_of_no_type_is_refused_by_name(axis, observer, atomically):
    nodes, heard = axis
    cls = SetParametersAtomically if atomically else SetParameters
    service = f"/plant_simulator/set_parameters{'_atomically' if atomically else ''}"

    def said(*parameters):
        answer = observer.call(cls, service, cls.Request(parameters=list(parameters)))
        return [answer.result] if atomically else answer.results

    (nameless,) = said(Parameter(name="", value=ParameterValue(type=99)))
    assert not nameless.successful and "without a name" in nameless.reason
    (nameless,) = said(Parameter(name="", value=ParameterValue(type=3, double_value=1.0)))
    assert not nameless.successful and "without a name" in nameless.reason
    for number in (0, 99, 255):
        (odd,) = said(Parameter(name="limits.maximum", value=ParameterValue(type=number)))
        assert not odd.successful and f"'limits.maximum': type {number} of its value" in odd.reason
        assert "3 double" in odd.reason
    odd = Parameter(name="voltage_timeout", value=ParameterValue(type=99))
    good = Parameter(name="voltage_timeout", value=ParameterValue(type=3, double_value=0.75))
    assert [result.successful for result in said(odd, good)] == ([False] if atomically else [False, True])
    assert_goes_on(observer, nodes, heard, "odd parameters")


def test_a_service_whose_callback_breaks_says_so_and_the_node_goes_on(inside, observer):
    from std_srvs.srv import Trigger

    from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode

    given = axis_parameters(time_mode="realtime").reference_generator
    node = inside.add(ReferenceGeneratorNode, given, autostart=False)

    def breaks(request, response):
        raise ValueError("no such thing")

    node.create_service(Trigger, "~/breaks", breaks)
    inside.spin()
    answer = observer.trigger("/reference_generator/breaks")
    assert not answer.success and answer.message == "ValueError: no such thing"
    assert observer.trigger("/reference_generator/start").message == "not configured yet"
