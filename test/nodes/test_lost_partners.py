# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A node that is lost stops the axis, latched, whichever it is and at any rate; nobody takes its place unasked."""

from __future__ import annotations

import signal
import time

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import Observer, axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.loop.plant import PARTNER_LOST  # noqa: E402
from hysteresis_ros.nodes.realtime import AT_WORK, STARTING  # noqa: E402

NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")
SETPOINT, THEIRS = 6.0e-6, 1.1e-5
LINEAR = {"hysteresis__type": "proportional", "hysteresis__proportional__gain": 1.0e-7}
LAG = {"A": (0.5,), "B": (0.5,), "C": (1.0,)}


def axis_at(rate: float):
    """Return an axis of simple dynamics in the open loop at 6 µm, 60 V; any number of single voltages may be late."""
    plant = {**LINEAR, "late_limit": 10**6} | {f"dynamics__{name}": matrix for name, matrix in LAG.items()}
    controller = {"type": "open_loop", "safe_slew_rate": 1e-3}
    controller |= {f"model__dynamics__{name}": matrix for name, matrix in LAG.items()}
    overrides = {
        "plant_simulator": plant,
        "motion_controller": controller,
        "hysteresis_compensator": LINEAR,
        "reference_generator": {"initial_setpoint": SETPOINT},
    }
    return axis_parameters(overrides=overrides, sample_rate=rate)


class Graph:
    """Four processes in real time, and what the plant says of each sample."""

    def __init__(self, processes, observer, folder, rate: float):
        from sensor_msgs.msg import JointState

        self.path = write_axis(folder / "axis.yaml", axis_at(rate))
        self.processes, self.observer = processes, observer
        self.states = observer.listen(JointState, "/plant_simulator/state")
        self.nodes = {name: processes.node(name, self.path) for name in NODES}
        self.until_at(SETPOINT)

    def place(self) -> float:
        return self.states[-1].position[0] if self.states else -1.0

    def voltage(self) -> float:
        return self.states[-1].position[2]

    def tripped(self) -> int:
        return int(self.states[-1].position[4])

    def until_at(self, place: float) -> None:
        until(lambda: abs(self.place() - place) < 1e-8, what=f"the axis at {place:g} m")

    def more(self, samples: int) -> None:
        since = len(self.states)
        until(lambda: len(self.states) > since + samples, what=f"{samples} more samples")

    def at_work(self) -> None:
        """Wait until all are taken to be at work: for longer than the time in which nodes start."""
        begun = time.monotonic()
        until(lambda: time.monotonic() > begun + STARTING + 0.5, what="the nodes to be at work")
        self.more(AT_WORK)

    def until_safe(self) -> None:
        until(lambda: self.tripped() and abs(self.voltage()) < 0.01, what="the axis stopped, and its voltage safe")

    def start(self):
        return self.observer.trigger("/plant_simulator/start")


@pytest.fixture
def graph(processes, observer, tmp_path, request):
    return Graph(processes, observer, tmp_path, request.param)


@pytest.mark.parametrize("graph", [10.0, 200.0], indirect=True)
@pytest.mark.parametrize("victim", ["motion_controller", "hysteresis_compensator", "reference_generator"])
def test_a_killed_node_stops_the_axis_until_a_person_starts_it(graph, victim):
    graph.at_work()
    graph.nodes[victim].kill()
    graph.until_safe()
    until(lambda: graph.tripped() == PARTNER_LOST, what="the reason")
    assert f"/{victim} is lost" in graph.nodes["plant_simulator"].output.replace(" hysteresis", " /hysteresis")
    answer = graph.start()
    assert not answer.success and victim in answer.message and graph.tripped()
    graph.nodes[victim] = graph.processes.node(victim, graph.path)
    until(lambda: graph.start().success, what="the restarted node heard")
    if victim == "reference_generator":  # it stays where it found the axis until it is asked
        # the sample after the start says to it that the axis goes on
        until(lambda: graph.observer.trigger("/reference_generator/start").success, what="that it works")
    graph.until_at(SETPOINT)


@pytest.mark.parametrize("graph", [10.0], indirect=True)
def test_a_restarted_node_moves_nothing_by_itself(graph):
    graph.at_work()
    graph.nodes["motion_controller"].kill()
    graph.until_safe()
    graph.processes.node("motion_controller", graph.path)
    commands = graph.observer.listen(*command_topic())
    until(lambda: commands, what="commands of the restarted controller")
    graph.more(20)
    assert graph.tripped() and abs(graph.voltage()) < 0.01


@pytest.mark.parametrize("graph", [10.0, 200.0], indirect=True)
def test_a_restarted_plant_stands_still_until_a_person_starts_it(graph):
    graph.at_work()
    graph.nodes["plant_simulator"].kill()
    until(lambda: "plant_simulator is lost" in graph.nodes["motion_controller"].output, what="the loss")
    graph.states.clear()
    graph.nodes["plant_simulator"] = graph.processes.node("plant_simulator", graph.path)
    until(lambda: graph.states and graph.tripped(), what="the new plant stopped")
    graph.more(15)
    assert graph.tripped() and max(state.position[0] for state in graph.states) < 0.2 * SETPOINT
    until(lambda: graph.start().success, what="the start")
    graph.until_at(SETPOINT)


@pytest.mark.parametrize("graph", [200.0], indirect=True)
@pytest.mark.parametrize("pause", [0.2, 0.6, 1.6])
def test_a_pause_of_the_controller_gives_the_axis_to_nobody(graph, domain, pause):
    from std_msgs.msg import Float64

    stranger = Observer(domain)
    try:
        command = stranger.talk(Float64, "/command")
        stranger.node.create_timer(0.02, lambda: command.publish(Float64(data=THEIRS)))
        until(lambda: "nothing of" in graph.nodes["hysteresis_compensator"].output, what="the stranger refused")
        graph.at_work()
        since = len(graph.states)
        graph.nodes["motion_controller"].send(signal.SIGSTOP)
        graph.more(round(200 * pause))
        if pause > 0.4:
            graph.until_safe()
        graph.nodes["motion_controller"].send(signal.SIGCONT)
        graph.more(100)
        if pause > 0.4:  # command_timeout
            assert graph.tripped() and abs(graph.voltage()) < 0.01
        if graph.tripped():
            until(lambda: graph.start().success, what="the start")
        graph.until_at(SETPOINT)
        graph.more(50)
        assert max(state.position[0] for state in graph.states[since:]) < SETPOINT + 1e-7
    finally:
        stranger.close()


@pytest.mark.parametrize("graph", [10.0, 200.0], indirect=True)
@pytest.mark.parametrize("joining", ["recorder", "second observer", "motion_controller"])
def test_a_node_that_joins_costs_no_sample(graph, domain, tmp_path, joining):
    """Stamps count the samples: all periods between them are one, but for what a busy machine loses by itself."""
    graph.at_work()
    since = len(graph.states)
    other = None
    if joining == "second observer":
        other = Observer(domain)
        heard = other.listen(*state_topic())
        until(lambda: heard, what="the second observer")
    elif joining == "recorder":
        graph.processes.node("recorder", graph.path, "-p", f"path:={tmp_path / 'bag'}")
        until(lambda: (tmp_path / "bag").exists(), what="the recorder")
    else:
        assert graph.nodes[joining].leave()[0] == 0  # in order: nothing is lost
        graph.nodes[joining] = graph.processes.node(joining, graph.path)
        until(lambda: "active" in graph.nodes[joining].output, what="the restarted controller")
    graph.more(20)
    if other is not None:
        other.close()
    assert longest_gap(graph.states[since - 1 :]) < 0.3
    if joining != "motion_controller":
        assert max(abs(state.position[0] - SETPOINT) for state in graph.states[since:]) < 1e-8
    graph.until_at(SETPOINT)


def longest_gap(states) -> float:
    """Return the longest time between two samples, by their stamps [s]."""
    stamps = [state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in states]
    return max(after - before for before, after in zip(stamps[:-1], stamps[1:], strict=True))


def command_topic():
    from std_msgs.msg import Float64

    return Float64, "/command"


def state_topic():
    from sensor_msgs.msg import JointState

    return JointState, "/plant_simulator/state"
