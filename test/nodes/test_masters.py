# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis, one master: an input accepts one publisher, known by its identity; a second one has no effect."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from nodes_support import Observer, axis_parameters, until  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from hysteresis_ros.nodes import masters
from hysteresis_ros.nodes import masters as identified  # noqa: E402
from hysteresis_ros.nodes.base import diagnostics  # noqa: E402
from hysteresis_ros.nodes.masters import LOOK, Master, Masters  # noqa: E402
from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode  # noqa: E402

OURS, THEIRS = b"ours", b"theirs"


class Clock:
    """A steady clock that the test sets."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


class FakeNode:
    """The interface of a node to its masters."""

    patience = 0.2
    parameters = SimpleNamespace(joint="stage")

    def __init__(self):
        self.names = {OURS: "compensator", THEIRS: "stranger"}
        self.publishers, self.warned, self.told, self.loop_topics, self._reported = 2, [], [], [], {}
        self.replaced = []
        self.runner = SimpleNamespace(replaced=lambda topic, name: self.replaced.append((topic, name)))

    def resolve_topic_name(self, topic):
        return f"/{topic}"

    def count_publishers(self, topic):
        return self.publishers

    def get_publishers_info_by_topic(self, topic):
        common = {"node_namespace": "/", "topic_type": "std_msgs/msg/Float64"}
        return [SimpleNamespace(node_name=name, endpoint_gid=list(who), **common) for who, name in self.names.items()]

    def warn(self, key, text, **options):
        self.warned.append(text)

    def get_logger(self):
        return SimpleNamespace(info=self.told.append)

    def since_report(self, key, count):
        before, self._reported[key] = self._reported.get(key, 0), count
        return count - before


@pytest.fixture
def led(monkeypatch):
    """Return a clock, a node, its masters, one of its inputs, and the accepted messages."""
    clock, node, taken = Clock(), FakeNode(), []
    monkeypatch.setattr(masters, "time", clock)
    found = Masters(node)
    master = Master(found, "/voltage", taken.append)
    found._inputs.append(master)
    return SimpleNamespace(clock=clock, node=node, masters=found, master=master, taken=taken)


def pass_time(led, duration: float) -> None:
    """Advance the time of a running process."""
    for _ in range(round(duration / LOOK)):
        led.clock.now += LOOK
        led.masters.look()


def test_a_silent_publisher_gives_its_input_to_nobody_else_before_a_person_allows_it(led):
    led.master.take(1.0, OURS)
    for _ in range(100):
        pass_time(led, 0.1)
        led.master.take(2.0, THEIRS)
        led.master.take(1.0, OURS)
    assert set(led.taken) == {1.0} and led.master.refused == 100
    pass_time(led, 0.19)
    led.master.take(2.0, THEIRS)
    assert led.taken[-1] == 1.0 and not led.node.told
    for _ in range(100):
        pass_time(led, 0.1)  # it has stopped, and the other one continues
        led.master.take(2.0, THEIRS)
    assert led.taken[-1] == 1.0 and not led.node.told
    led.masters.release()
    led.master.take(1.0, OURS)  # it was back before the other one was received
    pass_time(led, 1.0)
    led.master.take(2.0, THEIRS)
    assert led.taken[-1] == 1.0
    led.masters.release()
    pass_time(led, 0.1)
    led.master.take(2.0, THEIRS)
    assert led.taken[-1] == 2.0 and "/voltage is now accepted from /stranger" in led.node.told[0]
    assert "allowed by ~/reset" in led.node.told[0] and not led.node.replaced
    led.master.take(1.0, OURS)  # now it is the second publisher
    assert led.taken[-1] == 2.0


def test_each_input_has_its_own_publisher(led):
    other = masters.Master(led.masters, "/speed", led.taken.append)
    led.masters._inputs.insert(0, other)
    led.master.take(1.0, OURS)
    pass_time(led, 1.0)
    assert led.master.name and led.masters.publisher_of("voltage") == led.master.name
    assert led.masters.publisher_of("speed") == other.name == "" == led.masters.publisher_of("elsewhere")


def test_the_same_node_restarted_follows_a_silent_one(led):
    again = b"again"
    led.master.take(1.0, OURS)
    led.node.names |= {again: "compensator"}
    for _ in range(10):
        pass_time(led, 0.03)
        led.master.take(2.0, THEIRS)
        led.master.take(3.0, again)
    assert led.taken[0] == 1.0 and set(led.taken[1:]) == {3.0}
    assert "has the same node name" in led.node.told[0]
    assert led.node.replaced == [("/voltage", "/compensator")]  # the runner is informed: one may be lost


@pytest.mark.parametrize("known", ["at once", "later"])
def test_who_has_left_the_graph_is_followed_by_another_at_once_and_who_is_in_it_by_nobody(led, known):
    if known == "later":  # the first message comes before the graph contains its publisher
        led.node.names = {THEIRS: "compensator"}
    led.master.take(1.0, OURS)
    led.master.take(2.0, THEIRS)
    led.node.names = {OURS: "compensator", THEIRS: "compensator"}
    if known == "later":
        assert led.taken == [1.0]  # its appearance was not observed, so its exit cannot be observed
        led.masters.complaint()
    for _ in range(3):  # both are present
        pass_time(led, 0.03)
        led.master.take(2.0, THEIRS)
    assert led.taken == [1.0]
    led.node.names = {THEIRS: "stranger"}  # only a publisher of the same name may take its place
    pass_time(led, 0.03)
    led.master.take(2.0, THEIRS)
    assert led.taken == [1.0]
    led.node.names = {THEIRS: "compensator"}
    pass_time(led, 0.03)
    led.master.take(2.0, THEIRS)
    assert led.taken == [1.0, 2.0] and "/voltage is now accepted from /compensator" in led.node.told[0]
    led.node.names |= {OURS: "compensator"}  # and now it is the second publisher
    pass_time(led, 0.03)
    led.master.take(1.0, OURS)
    assert led.taken == [1.0, 2.0]


def test_a_flood_of_somebody_else_does_not_ask_the_graph_for_each_message(led, monkeypatch):
    asked = []
    monkeypatch.setattr(led.masters, "is_there", lambda *of: asked.append(of) or True)
    led.master.take(1.0, OURS)
    for _ in range(1000):
        led.clock.now += 1e-4
        led.master.take(2.0, THEIRS)
    assert led.taken == [1.0] and len(asked) <= 2 + 0.1 / masters.GRAPH_LOOK


def test_both_are_named_as_long_as_there_are_two(led):
    led.node.publishers = 1
    assert led.masters.complaint() == ""
    led.node.publishers = 2  # the second publisher has not sent a message yet
    assert "/voltage is published by /compensator and /stranger: stop one" in led.masters.complaint()
    led.master.take(1.0, OURS)
    led.master.take(2.0, THEIRS)
    words = "/voltage is accepted from /compensator and refused from /stranger: stop one of them"
    assert words in led.masters.complaint() and words in led.node.warned[0]
    led.node.names = {OURS: "_NODE_NAME_UNKNOWN_", THEIRS: "_NODE_NAME_UNKNOWN_"}
    assert "/voltage is published by a node without a known name and a node" in led.masters.complaint()
    led.node.names = {OURS: "compensator", THEIRS: "compensator"}  # killed and started again
    assert led.masters.complaint() == ""
    led.node.publishers = 1
    assert led.masters.complaint() == ""


def test_a_process_that_stood_still_takes_nobody_for_silent(led):
    led.master.take(1.0, OURS)
    led.clock.now += 3.0  # SIGSTOP: both have sent messages meanwhile, and that of the stranger comes first
    led.master.take(2.0, THEIRS)
    led.master.take(1.0, OURS)
    assert led.taken == [1.0, 1.0]
    led.clock.now += 3.0
    led.masters.look()
    led.master.take(2.0, THEIRS)
    led.masters.release()
    led.master.take(2.0, THEIRS)
    assert led.taken == [1.0, 1.0]
    pass_time(led, 0.3)
    led.master.take(2.0, THEIRS)
    assert led.taken == [1.0, 1.0, 2.0]


def test_joint_states_of_other_joints_are_nobodys(led):
    gripper, stage = JointState(name=["gripper"]), JointState(name=["gripper", "stage"])
    led.master.take(gripper, THEIRS)  # is reported as incomplete, but does not lead
    led.master.take(stage, OURS)
    led.master.take(gripper, THEIRS)
    led.master.take(gripper, OURS)
    assert led.taken == [gripper, stage, gripper] and led.master.refused == 0
    led.master.take(stage, THEIRS)
    assert len(led.taken) == 3 and led.master.refused == 1


def test_who_cannot_be_told_apart_is_heard_only_alone(led):
    led.node.publishers = 1
    led.master.take(1.0, b"")
    led.node.publishers = 2
    led.master.take(2.0, b"")
    assert led.taken == [1.0] and led.master.refused == 1
    led.node.publishers = 1
    led.master.take(3.0, b"")
    assert led.taken == [1.0, 3.0]


@pytest.mark.parametrize("executor", ["events", "single"])
def test_messages_come_with_the_identity_of_their_publisher(domain, executor):
    import rclpy
    from rclpy.context import Context
    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile

    context, heard = Context(), []
    rclpy.init(context=context, domain_id=domain)
    nodes = [rclpy.create_node(name, context=context) for name in ("first", "second", "listener")]
    if executor == "events":
        from rclpy.experimental import EventsExecutor

        spun = EventsExecutor(context=context)
    else:
        spun = SingleThreadedExecutor(context=context)
    for node in nodes:
        spun.add_node(node)
    qos, events = QoSProfile(depth=10), SubscriptionEventCallbacks()
    listener = identified.IdentifiedSubscription(
        nodes[2], JointState, "joint_states", lambda *found: heard.append(found), qos, events
    )
    publishers = [node.create_publisher(JointState, "joint_states", 10) for node in nodes[:2]]
    until(lambda: all(publisher.get_subscription_count() for publisher in publishers), what="both matched")
    for number in range(6):
        publishers[number % 2].publish(JointState(name=[f"joint{number}"], position=[float(number)]))
    deadline = time.monotonic() + 30.0
    while len(heard) < 6 and time.monotonic() < deadline:
        spun.spin_once(timeout_sec=0.02)
    known = {bytes(i.endpoint_gid): i.node_name for i in nodes[2].get_publishers_info_by_topic("joint_states")}
    found = {message.name[0]: known[identity] for message, identity in heard}
    assert found == {f"joint{number}": ("first", "second")[number % 2] for number in range(6)}
    assert all(message.position[0] == float(message.name[0][5:]) for message, _ in heard)
    listener._implementation = b"another middleware"
    publishers[0].publish(JointState())
    while len(heard) < 7 and time.monotonic() < deadline:
        spun.spin_once(timeout_sec=0.02)
    assert heard[-1][1] == b""
    context.try_shutdown()


@pytest.fixture
def observers(domain):
    made = [Observer(domain), Observer(domain)]
    yield made
    for one in made:
        one.close()


@pytest.mark.parametrize("told", [True, False])
def test_a_second_sender_of_voltage_moves_nothing_and_diagnostics_name_both(inside, observers, monkeypatch, told):
    """Also if ROS does not identify senders: then no publisher is accepted while there are two."""
    if not told:
        monkeypatch.setattr(identified.ctypes, "PyDLL", lambda name: (_ for _ in ()).throw(OSError(name)))
    overrides = {"plant_simulator": {"voltage_timeout": 600.0, "late_limit": -1, "real_time_factor": 1.0}}
    axis = axis_parameters(sample_rate=50.0, overrides=overrides)
    plant = inside.add(PlantSimulatorNode, axis.plant_simulator)
    inside.spin()
    ours, theirs = (one.talk(Float64, "voltage") for one in observers)
    first, second = (one.node.get_fully_qualified_name() for one in observers)
    until(lambda: ours.get_subscription_count() and theirs.get_subscription_count(), what="both matched")
    until(lambda: plant.count_publishers("voltage") == 2, what="both known")
    seen, receive = [], plant.receive
    plant.receive = lambda given, voltage: (seen.append(voltage), receive(given, voltage))
    ours.publish(Float64(data=3.0))
    master = plant.masters._inputs[0]
    until(lambda: seen == [3.0] if told else master.refused == 1, what="the first voltage")
    theirs.publish(Float64(data=50.0))
    until(lambda: master.refused == 2 - told, what="the voltage of the second one")
    ours.publish(Float64(data=4.0))
    until(lambda: seen == [3.0, 4.0] if told else master.refused == 3, what="the first one's next voltage")

    def both_named() -> bool:
        (status,) = diagnostics(plant).status
        assert status.level == DiagnosticStatus.ERROR
        return first in status.message and second in status.message

    until(both_named, what="both names")
    assert 50.0 not in seen
    observers[0].node.destroy_publisher(ours)
    until(lambda: plant.count_publishers("voltage") == 1, what="the first one to leave")
    if told:
        refused = master.refused
        until(lambda: (theirs.publish(Float64(data=51.0)), master.refused > refused + 20)[1], what="messages refused")
        assert 51.0 not in seen
        assert observers[0].trigger("/plant_simulator/reset").success

    def followed() -> bool:
        theirs.publish(Float64(data=52.0))
        return 52.0 in seen

    until(followed, what="the other one's voltage, long before the time-out")
    assert 50.0 not in seen  # the last 51.0 may have been sent while it was allowed


def test_a_node_does_not_go_to_work_where_somebody_leads(inside, observer, monkeypatch):
    axis = axis_parameters(sample_rate=50.0)
    theirs = observer.talk(Float64, "reference")
    source = inside.add(ReferenceGeneratorNode, axis.reference_generator, autostart=False)
    assert source.configure_now()
    until(lambda: source.count_publishers("reference") == 2, what="the other one")
    name = observer.node.get_fully_qualified_name()
    until(lambda: name in str(masters.rivals(source)), what="its name")
    assert not source.activate_now() and source.exit_code == 2 and not source.active
    observer.node.destroy_publisher(theirs)
    until(lambda: source.count_publishers("reference") == 1, what="the other one to leave")
    other = inside.add(ReferenceGeneratorNode, axis.reference_generator, autostart=False)
    until(lambda: source.get_node_names().count("reference_generator") == 2, what="a node of the same name")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert not source.activate_now() and source.exit_code == 2
    begun = time.monotonic()
    masters.await_discovery([other])
    assert masters.rivals(other) and time.monotonic() - begun < masters.DISCOVERY + 30.0
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert masters.rivals(other) == [] and source.activate_now()


def test_who_has_no_name_keeps_nobody_from_going_to_work(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def node(other: str):
        names = "source", other
        there = [
            SimpleNamespace(node_namespace="/", node_name=name, topic_type="std_msgs/msg/Float64") for name in names
        ]
        return SimpleNamespace(
            get_fully_qualified_name=lambda: "/source",
            loop_topics=("/reference",),
            count_publishers=lambda topic: 2,
            get_publishers_info_by_topic=lambda topic: there,
        )

    assert masters.rivals(node("_NODE_NAME_UNKNOWN_")) == []
    assert masters.rivals(node("another")) == ["/another publishes /reference"]
