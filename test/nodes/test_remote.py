# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A running axis, controlled without `ros2`: each request is executed or refused with an answer, and nothing hangs."""

from __future__ import annotations

import itertools
import json
import signal
import threading
from functools import partial
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import InProcess, axis_parameters, compose  # noqa: E402

from hysteresis_ros.errors import HysteresisError, ParameterError  # noqa: E402
from hysteresis_ros.models.block import COMPILED  # noqa: E402
from hysteresis_ros.nodes.remote.__main__ import done  # noqa: E402
from hysteresis_ros.nodes.remote.client import AbsentError, Client  # noqa: E402
from hysteresis_ros.nodes.remote.commands import (  # noqa: E402
    _axis,
    _lines,
    _require_moving,
    call,  # noqa: E402
    echo,  # noqa: E402
    get,
    set_,
    setpoint,
    stands,
    status,  # noqa: E402
)
from hysteresis_ros.nodes.timing import COMPILING_TEXT  # noqa: E402

RATE = 50.0
#: A client gives up after this time [s] if there is nothing to find.
SHORT = 0.3


@pytest.fixture(scope="module")
def axis(domain_of_module):
    """A composed axis in /left, in real time."""
    inside = InProcess(domain_of_module)
    # late voltages of a busy machine must not stop the axis here
    overrides = {"plant_simulator": {"late_limit": -1}}
    compose(inside, axis_parameters("/left", overrides, sample_rate=RATE, time_mode="realtime"))
    inside.spin()
    yield inside
    inside.close()


@pytest.fixture
def client(axis):
    with Client("left", timeout=20.0, context=axis.context) as made:
        yield made


@pytest.fixture
def hasty(axis):
    with Client("left", timeout=SHORT, context=axis.context) as made:
        yield made


def node(axis, name: str):
    return next(one for one in axis.nodes if one.kind == name)


def test_a_setpoint_is_taken_or_refused_where_it_was_typed(axis, client, capsys):
    setpoint(client, 5.0e-6)
    assert "setpoint 5 µm taken by /left/reference_generator" in capsys.readouterr().out
    assert node(axis, "reference_generator").setpoint == 5.0e-6
    with pytest.raises(HysteresisError, match=r"50 µm refused: out of range, allowed: 0 … 12 µm"):
        setpoint(client, 5.0e-5)
    call(client, "reference_generator", "stop")
    with pytest.raises(HysteresisError, match=r"is stopped: `hysteresis call /left/reference_generator start`"):
        setpoint(client, 4.0e-6)
    call(client, "reference_generator", "start")
    call(client, "motion_controller", "deactivate")
    with pytest.raises(HysteresisError, match="/left/motion_controller is inactive, so the axis would not move"):
        setpoint(client, 4.0e-6)
    assert "active → inactive" in capsys.readouterr().out
    call(client, "motion_controller", "activate")
    setpoint(client, 3.0e-6)


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"mode": 0.0, "phase": 1.0, "error": 0.0}, ""),
        ({"mode": 3.0}, "is stopped: `hysteresis call /x/inchworm_sequencer start`"),
        ({"mode": 4.0}, "`hysteresis call /x/plant_simulator start` resumes it"),
        ({"mode": 0.0, "phase": 1.0, "error": 1.0}, ""),
        ({"mode": 0.0, "phase": 1.0, "error": 4.0}, "has stopped with the error slip: `hysteresis call /x/inch"),
        ({"mode": 0.0, "phase": 9.0, "error": 0.0}, "has released the slider"),
    ],
)
def test_a_source_that_cannot_move_says_why_and_what_to_do(state, words):
    said = stands("/x/inchworm_sequencer", state)
    assert words in said and bool(words) == bool(said)


def test_a_setpoint_without_a_namespace_is_not_awaited_where_axes_have_namespaces(axis):
    with (
        Client(timeout=60.0, context=axis.context) as unnamed,
        pytest.raises(HysteresisError, match="no axis is chosen, and there are /left: give --namespace /left"),
    ):
        setpoint(unnamed, 1e-6)


def test_who_does_not_listen_or_answer_is_named(axis, hasty, client):
    with Client("right", timeout=SHORT, context=axis.context) as nobody:
        with pytest.raises(AbsentError, match="no /right/reference_generator or .* within 0.3 s; .*/left/"):
            setpoint(nobody, 1e-6)
        with pytest.raises(AbsentError, match="no axis in /right"):
            status(nobody, as_json=False)
    with pytest.raises(AbsentError, match=r"no node /left/motion_controler .* did you mean /left/motion_controller"):
        get(hasty, "motion_controler", [])
    with pytest.raises(AbsentError, match=r"/left/jont_states has no publisher .* did you mean /left/joint_states"):
        echo(hasty, "jont_states", 1)
    # a suspended plant: the subscription exists, but no sample arrives
    call(client, "plant_simulator", "deactivate")
    patient = client.timeout
    try:
        client.timeout = 2.0
        with pytest.raises(HysteresisError, match="/left/plant_simulator is inactive"):
            setpoint(client, 2e-6)
        with pytest.raises(AbsentError, match="no message arrived on /left/joint_states for 2 s; .* /left/plant"):
            echo(client, "joint_states", 1)
    finally:
        client.timeout = patient
        call(client, "plant_simulator", "activate")


def test_parameters_are_got_and_set_all_or_none(axis, client, capsys):
    controller = node(axis, "motion_controller")
    get(client, "motion_controller", ["sliding_mode.beta", "kalman.form", "kalman.L"])
    assert capsys.readouterr().out.splitlines() == [
        "sliding_mode.beta: 0.0002",
        "kalman.form: predictor",
        "kalman.L: [0.004, 0.5771, 0.3558]",
    ]
    set_(client, "motion_controller", {"sliding_mode.eta": "3e-3", "sliding_mode.phi": "0.94"})
    assert (controller.parameters.sliding_mode.eta, controller.parameters.sliding_mode.phi) == (0.003, 0.94)
    set_(client, "plant_simulator", {"sensor.noise": "5nm"})
    assert node(axis, "plant_simulator").parameters.sensor.noise == 5e-9
    with pytest.raises(ParameterError, match="sensor.noise = '5e-9'.*of which unit. Write 5e-9m or 5e-9mm"):
        set_(client, "plant_simulator", {"sensor.noise": "5e-9"})
    for values, reason in (
        ({"sliding_mode.eta": "0.001", "sliding_mode.phi": "2"}, "sliding_mode.phi = 2.* allowed"),
        ({"sliding_mode.eta": "0.001", "sample_rate": "5"}, "sample_rate = 5.*read-only while.*nothing was changed"),
        ({"sliding_mode.eta": "0.001", "sliding_mode.hyperplane": "designed"}, "allowed: .* given, lq, poles"),
        ({"sliding_mode.et": "0.001"}, "did you mean sliding_mode.eta"),
        ({"sliding_mode": "0.001"}, "below it there are sliding_mode.S"),
        ({"sliding_mode.eta": "5V"}, "is in V, must be a number"),
    ):
        with pytest.raises((HysteresisError, ParameterError), match=reason):
            set_(client, "motion_controller", values)
        assert controller.parameters.sliding_mode.eta == 0.003
    with pytest.raises(HysteresisError, match="generator refuses: waveform.amplitude.* call stop; nothing was changed"):
        set_(client, "reference_generator", {"waveform.amplitude": "1um"})


def test_services_and_transitions_answer_with_the_node_s_reason(client, capsys):
    call(client, "motion_controller", "stop")
    call(client, "motion_controller", "start")
    said, running = capsys.readouterr().out.splitlines()
    # the target of a command is reported unless the axis is already there
    assert said in (
        "/left/motion_controller: stopped",
        "/left/motion_controller: stopped: the command goes to safe_command = 0 m",
    )
    assert running == "/left/motion_controller: running"
    with pytest.raises(HysteresisError, match="it has forget, freeze, .*, start, stop, .*did you mean start"):
        call(client, "motion_controller", "stat")
    with pytest.raises(HysteresisError, match="refuses to learn: learning.type = 'none': learning is off"):
        call(client, "motion_controller", "learn")
    with pytest.raises(HysteresisError, match="refuses to save: learning.save_file = '': names no file"):
        call(client, "motion_controller", "save")
    with pytest.raises(HysteresisError, match="active: configure is not possible; possible: deactivate and shutdown"):
        call(client, "motion_controller", "configure")


def test_status_says_who_is_there_and_where_the_axis_is(axis, client, capsys):
    assert status(client, as_json=True) in (0, 1)  # a busy machine may cause late voltages
    found = json.loads(capsys.readouterr().out)["/left"]
    assert {name: one["state"] for name, one in found["nodes"].items()} == {
        f"/left/{one.kind}": "active" for one in axis.nodes
    }
    assert all(one["rate_hz"] is not None and one["level"] for one in found["nodes"].values())
    assert found["last"]["setpoint"] == node(axis, "reference_generator").setpoint
    assert {"reference", "displacement", "voltage"} <= found["last"].keys()
    assert found["last"]["offset"] == node(axis, "motion_controller").parameters.model.preload.offset
    call(client, "hysteresis_compensator", "deactivate")
    try:
        assert status(client, as_json=False) == 1
        text = capsys.readouterr().out
        assert "hysteresis_compensator  inactive" in text and "displacement" in text
    finally:
        call(client, "hysteresis_compensator", "activate")


def test_status_tells_the_offset_of_the_displacement_from_the_setpoints():
    names, last = ["motion_controller", "plant_simulator"], {"setpoint": 43e-6, "displacement": 50e-6}
    for offset, said in (("7e-06", "displacement 50 µm including an offset of 7 µm"), ("0", "displacement 50 µm")):
        reports = {"/x/motion_controller": (0, "OK", {"offset_m": offset})}
        found = _axis(SimpleNamespace(timeout=1.0), "/x", names, {}, reports, last)
        assert found.last == {**last, "offset": float(offset)} and "offset" not in last
        line = list(_lines(found))[-1]
        assert said in line and ("offset" in line) == (offset != "0")


def test_echo_ends_after_as_many_messages_as_were_asked_for(client, capsys):
    echo(client, "joint_states", 2)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 and all(" extender " in line and " m/s " in line for line in lines)
    echo(client, "/diagnostics", 1)
    assert ": axis: " in capsys.readouterr().out
    echo(client, "reference", 1)
    float(capsys.readouterr().out)


def test_echo_ends_when_its_publisher_leaves(axis, capsys):
    from rclpy.node import Node
    from std_msgs.msg import Float64

    publisher_node = Node("somebody", context=axis.context, namespace="/left")
    publisher = publisher_node.create_publisher(Float64, "passing", 10)
    with Client("left", timeout=20.0, context=axis.context) as client:
        heard = threading.Thread(target=echo, args=(client, "passing", None))
        heard.start()
        for number in itertools.count():
            publisher.publish(Float64(data=float(number)))
            heard.join(0.02)
            if publisher.get_subscription_count() and number > 10:
                break
        publisher_node.destroy_publisher(publisher)
        heard.join(20.0)
        assert not heard.is_alive()
    publisher_node.destroy_node()
    assert "/left/passing has no publisher any more" in capsys.readouterr().out


def test_commands_end_with_a_line_and_their_exit_code(processes):
    """In separate processes: a missing axis is wrong input, and Ctrl-C is handled."""
    waiting = processes.command("echo", "joint_states", "--timeout", "100")
    alone = processes.command("setpoint", "1um", "--timeout", "0.5")
    assert alone.wait() == 1, alone.output
    assert "no /reference_generator or /inchworm_sequencer within 0.5 s; no node is in the ROS" in alone.output
    code, _ = waiting.leave(signal.SIGINT)
    assert code == 130 and waiting.output == "hysteresis: interrupted\n"


def test_a_namespace_that_is_none_is_refused_in_a_line():
    with pytest.raises(HysteresisError, match="namespace /a b: "), Client("a b", SHORT):
        raise AssertionError("such a namespace")


def test_a_setpoint_is_the_source_s_to_take_and_not_a_listener_s(axis, client, hasty, capsys):
    """A page or a recorder that subscribes does not accept setpoints: without the source, acceptance is unknown."""
    from rclpy.node import Node
    from std_msgs.msg import Float64

    page = Node("page", context=axis.context, namespace="/right")
    page.create_subscription(Float64, "setpoint", lambda message: None, 10)
    try:
        without = pytest.raises(AbsentError, match="no /right/reference_gen.*; /right/page on /right/setpoint does not")
        with Client("right", timeout=SHORT, context=axis.context) as nobody, without:
            setpoint(nobody, 1e-6)
    finally:
        page.destroy_node()
    assert not capsys.readouterr().out


def test_a_source_that_does_not_answer_has_not_taken_the_setpoint(axis, capsys):
    from rclpy.node import Node
    from std_msgs.msg import Float64

    heard: list = []
    source = Node("reference_generator", context=axis.context, namespace="/mute")
    source.create_subscription(Float64, "setpoint", heard.append, 10)
    try:
        refused = pytest.raises(AbsentError, match="/mute/reference_generator did not answer within 0.3 s, and nothing")
        with Client("mute", timeout=SHORT, context=axis.context) as asking, refused:
            setpoint(asking, 7e-6)
    finally:
        source.destroy_node()
    assert not heard and "taken" not in capsys.readouterr().out


@pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")
def test_an_axis_that_compiles_says_so_to_commands(inside, monkeypatch, capsys):
    """While a loop compiles, its nodes answer nothing, but their reports arrive."""
    from hysteresis_ros.nodes import fused

    answers: list = []

    def asked_meanwhile(given):
        with Client(timeout=20.0, context=inside.context) as patient:
            said = patient.until(lambda: patient.why_silent("/motion_controller") == COMPILING_TEXT)
        request = {"command": "call", "namespace": "", "node": "plant_simulator", "action": "activate"}
        make = partial(Client, context=inside.context)
        answers.append((said, done({**request, "timeout": SHORT}, make), capsys.readouterr().err))

    monkeypatch.setattr(fused, "COMPILING", 0.0)
    monkeypatch.setattr(fused, "require_speed", asked_meanwhile)
    joined = fused.FusedAxis()
    overrides = {"plant_simulator": {"late_limit": -1}}
    axis = axis_parameters(overrides=overrides, time_mode="fused")
    nodes = [joined.join(one) for one in compose(inside, axis, autostart=False)]
    assert all(one.configure_now() for one in nodes) and all(one.activate_now() for one in nodes)
    [(said, code, words)] = answers
    assert said and code == 1 and "/plant_simulator does not answer within 0.3 s: compiling the loop" in words


def test_the_service_of_a_setpoint_survives_what_is_no_setpoint(axis, client):
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParametersAtomically

    before = node(axis, "reference_generator").setpoint
    good = Parameter(name="setpoint", value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=2e-6))
    text = Parameter(name="setpoint", value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="2e-6"))
    strange = Parameter(name="setpoint", value=ParameterValue(type=99))
    asked = "one parameter 'setpoint' of type double"
    nameless = Parameter(name="", value=good.value)
    given_and_refused = (
        ([], asked),
        ([good, good], asked),
        ([text], asked),
        ([strange], "type 99"),
        ([nameless], "name"),
    )
    for given, reason in given_and_refused:
        request = SetParametersAtomically.Request(parameters=given)
        result = client.ask(SetParametersAtomically, "/left/reference_generator/set_setpoint", request).result
        assert not result.successful and reason in result.reason
    assert node(axis, "reference_generator").setpoint == before


def test_a_node_whose_messages_come_is_not_absent(axis, client, capsys, monkeypatch):
    """Discovery may find a node late; its report shows that it is present."""
    known = Client.nodes

    monkeypatch.setattr(Client, "nodes", lambda self: [name for name in known(self) if "compensator" not in name])
    status(client, as_json=True)
    found = json.loads(capsys.readouterr().out)["/left"]["nodes"]["/left/hysteresis_compensator"]
    assert found["state"] == "active" and found["rate_hz"] is not None


def test_status_waits_until_every_node_is_found(axis, client, capsys, monkeypatch):
    """It waits for the node that discovery finds last, however long the others are known."""
    import time

    known, begun = Client.nodes, time.monotonic()
    monkeypatch.setattr("hysteresis_ros.nodes.remote.commands.DIAGNOSTICS", "/unheard")

    def late(self):
        return [name for name in known(self) if "compensator" not in name or time.monotonic() - begun > 2.0]

    monkeypatch.setattr(Client, "nodes", late)
    status(client, as_json=True)
    nodes = json.loads(capsys.readouterr().out)["/left"]["nodes"]
    assert nodes["/left/hysteresis_compensator"]["state"] == "active"


def test_status_says_how_long_it_looked_for_a_node(axis, client, capsys, monkeypatch):
    known = Client.nodes
    monkeypatch.setattr("hysteresis_ros.nodes.remote.commands.DIAGNOSTICS", "/unheard")
    monkeypatch.setattr(Client, "nodes", lambda self: [name for name in known(self) if "compensator" not in name])
    client.timeout = 1.0
    assert status(client, as_json=False) == 1
    assert "hysteresis_compensator  absent                    not found within 1 s" in capsys.readouterr().out


@pytest.mark.parametrize("setpoints", [(1e-6, 5e-6), (5e-6 * (1.0 + 1e-15),), (1e-6,), ()])
def test_a_setpoint_is_in_force_when_a_sample_has_it_and_not_when_a_sample_has_any(setpoints):
    state: dict[str, float] = {}
    coming = list(setpoints)

    def until(made, seconds):
        while coming:
            state["setpoint"] = coming.pop(0)
            if made():
                return True
        return False

    publishers = SimpleNamespace(count_publishers=lambda topic: 0)
    client = SimpleNamespace(timeout=1.0, until=until, node=publishers)
    if setpoints == (1e-6,):
        with pytest.raises(AbsentError, match=r"another setpoint replaced it: it is now 1 µm"):
            _require_moving(client, "/a/reference_generator", 5e-6, state)
    elif not setpoints:
        with pytest.raises(AbsentError, match=r"/a/joint_states has no publisher"):
            _require_moving(client, "/a/reference_generator", 5e-6, state)
    else:
        _require_moving(client, "/a/reference_generator", 5e-6, state)
        assert not coming and state["setpoint"] == pytest.approx(5e-6)
