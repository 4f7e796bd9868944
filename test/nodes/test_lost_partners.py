# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loss of any node at any rate stops the axis, latched; no other node replaces it without ~/start."""

from __future__ import annotations

import re
import signal
import time
import urllib.request

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
    """Return an open-loop axis with simple dynamics at 6 µm, 60 V; any number of single voltages may be late."""
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
    """Four processes in real time, and the plant's state at each sample."""

    def __init__(self, processes, observer, folder, rate: float):
        from sensor_msgs.msg import JointState

        self.path = write_axis(folder / "axis.yaml", axis_at(rate))
        self.processes, self.observer, self.rate = processes, observer, rate
        self.states = observer.listen(JointState, "/plant_simulator/state")
        self.nodes = {name: processes.node(name, self.path) for name in NODES}
        self.start_until_at(SETPOINT)

    def place(self) -> float:
        return self.states[-1].position[0] if self.states else -1.0

    def voltage(self) -> float:
        return self.states[-1].position[2]

    def tripped(self) -> int:
        return int(self.states[-1].position[4]) if self.states else 0

    def until_at(self, place: float) -> None:
        try:
            until(lambda: abs(self.place() - place) < 1e-8 and self.rests(), what=f"the axis at {place:g} m")
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.said()}") from None

    def said(self) -> str:
        return "\n".join(f"{name}:\n{node.output}" for name, node in self.nodes.items())

    def rests(self) -> bool:
        """Return whether the voltage equals that of the previous sample; the displacement follows it later."""
        return len(self.states) < 2 or abs(self.states[-1].position[2] - self.states[-2].position[2]) < 1e-9

    def more(self, samples: int) -> None:
        since = len(self.states)
        until(lambda: len(self.states) > since + samples, what=f"{samples} more samples")

    def at_work(self) -> None:
        """Wait until all nodes count as running, longer than the time in which nodes start."""
        begun, since = time.monotonic() + STARTING + 0.5, len(self.states)
        until(lambda: time.monotonic() > begun and len(self.states) > since + AT_WORK, what="the nodes to be at work")

    def be_patient(self) -> None:
        """Prevent parts from going to safe while a machine that starts more processes is blocked for a moment."""
        waits = {"plant_simulator": "voltage", "hysteresis_compensator": "command", "motion_controller": "measurement"}
        for node, what in waits.items():
            assert self.observer.set_parameters(f"/{node}", **{f"{what}_timeout": 20.0}) == (True, "")

    def until_safe(self) -> None:
        until(lambda: self.tripped() and abs(self.voltage()) < 0.01, what="the axis stopped, and its voltage safe")

    def start(self):
        return self.start_of("plant_simulator")

    def start_until_at(self, place: float) -> None:
        """Start the axis, repeatedly if a node on a busy machine noticed the loss only after the start."""

        def there() -> bool:
            return (abs(self.place() - place) < 1e-8 and self.rests()) or bool(
                self.tripped() and self.start().success and False
            )

        try:
            until(there, what=f"the axis at {place:g} m", every=0.2)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.said()}") from None

    def start_of(self, node: str):
        return self.observer.trigger(f"/{node}/start")


@pytest.fixture
def graph(processes, observer, tmp_path, request):
    return Graph(processes, observer, tmp_path, request.param)


@pytest.mark.parametrize("graph", [10.0], indirect=True)
def test_a_killed_node_stops_a_slow_axis_until_a_person_starts_it(graph):
    a_node_that_is_back_before_its_silence_was_noticed_was_lost(graph, "motion_controller")
    for victim in ("motion_controller", "hysteresis_compensator"):
        killed_stops_the_axis_until_a_person_starts_it(graph, victim)


@pytest.mark.parametrize("graph", [50.0], indirect=True)
def test_a_killed_or_halted_node_gives_the_axis_to_nobody_until_a_person_starts_it(graph, domain):
    killed_stops_the_axis_until_a_person_starts_it(graph, "reference_generator")
    a_pause_of_the_controller_gives_the_axis_to_nobody(graph, domain)
    restarted_plant_stands_still(graph)
    reset_says_that_a_partner_is_still_lost(graph)


def killed_stops_the_axis_until_a_person_starts_it(graph, victim: str) -> None:
    """Kill a node at work, restart it, and start the axis."""
    graph.at_work()
    graph.nodes[victim].kill()
    graph.until_safe()
    until(lambda: graph.tripped() == PARTNER_LOST, what="the reason")
    said = graph.nodes["plant_simulator"].output.replace(" hysteresis", " /hysteresis")
    assert f"/{victim} is lost" in said
    answer = graph.start()
    assert not answer.success and victim in answer.message and graph.tripped()
    restarted_moves_nothing(graph, victim)
    until(lambda: graph.start().success, what=f"the restarted {victim} heard")
    if victim == "reference_generator":  # it stays where it found the axis until a setpoint arrives
        # the sample after the start tells it that the axis continues
        until(lambda: graph.observer.trigger("/reference_generator/start").success, what="that it works")
    graph.until_at(SETPOINT)


def restarted_moves_nothing(graph, victim: str) -> None:
    """Restart a node: it works again, and nothing moves."""
    heard = graph.observer.listen(*command_topic())
    graph.nodes[victim] = graph.processes.node(victim, graph.path)
    until(lambda: "active" in graph.nodes[victim].output, what=f"the restarted {victim}")
    if victim == "motion_controller":
        heard.clear()
        until(lambda: heard, what="commands of the restarted controller")
    graph.more(10)
    assert graph.tripped() and abs(graph.voltage()) < 0.01


def restarted_plant_stands_still(graph) -> None:
    """Kill the plant and restart it: it stands still until a person starts it."""
    graph.nodes["plant_simulator"].kill()
    until(lambda: "plant_simulator is lost" in graph.nodes["motion_controller"].output, what="the loss")
    graph.states.clear()
    graph.nodes["plant_simulator"] = graph.processes.node("plant_simulator", graph.path)
    until(lambda: graph.states and graph.tripped(), what="the new plant stopped")
    graph.more(15)
    assert graph.tripped() and max(state.position[0] for state in graph.states) < 0.2 * SETPOINT
    graph.start_until_at(SETPOINT)


def reset_says_that_a_partner_is_still_lost(graph) -> None:
    """Kill the controller and reset the plant: the reply names the controller, and the axis stays safe."""
    graph.nodes["motion_controller"].kill()
    graph.until_safe()
    answer = graph.observer.trigger("/plant_simulator/reset")
    assert answer.message == (
        "reset; before the reset it did not run: /motion_controller is lost; it runs only when this is resolved"
    )
    graph.until_safe()


@pytest.mark.parametrize(
    ("victim", "graph"),
    [("motion_controller", 50.0), ("hysteresis_compensator", 50.0), ("plant_simulator", 10.0)],
    indirect=["graph"],
)
def test_a_node_killed_as_soon_as_the_axis_runs_stops_it_too(graph, victim):
    """While nodes start, silence must last longer, and then counts as a loss."""
    graph.nodes[victim].kill()
    others = [graph.nodes[name] for name in NODES if name != victim]
    until(lambda: any(f"{victim} is lost" in other.output for other in others), what="the loss")
    if victim != "plant_simulator":
        graph.until_safe()
        assert graph.tripped() == PARTNER_LOST and not graph.start().success
    graph.states.clear()
    graph.nodes[victim] = graph.processes.node(victim, graph.path)
    until(lambda: graph.states and graph.tripped(), what="the axis stopped")
    until(lambda: "active" in graph.nodes[victim].output, what="the restarted node")
    graph.more(10)
    assert graph.tripped() and max(abs(state.position[2]) for state in graph.states) < 0.01
    until(lambda: graph.start().success, what="the start")


def a_node_that_is_back_before_its_silence_was_noticed_was_lost(graph, victim: str) -> None:
    """At most as long as nodes take to start: messages of its new process are not a continuation."""
    began = len(graph.states)
    graph.nodes[victim].kill()
    graph.nodes[victim] = graph.processes.node(victim, graph.path)
    graph.until_safe()
    until(lambda: "active" in graph.nodes[victim].output, what="the restarted node")
    graph.more(10)
    assert graph.tripped() == PARTNER_LOST and abs(graph.voltage()) < 0.01
    stopped = next(number for number, state in enumerate(graph.states[began:]) if state.position[4])
    held = [state.position[2] for state in graph.states[began + stopped :]]
    assert all(abs(after) <= abs(before) + 1e-9 for before, after in zip(held[:-1], held[1:], strict=True))
    until(lambda: graph.start().success, what="the start")
    graph.until_at(SETPOINT)


def a_pause_of_the_controller_gives_the_axis_to_nobody(graph, domain) -> None:
    """Halt the controller while a stranger publishes commands."""
    from std_msgs.msg import Float64

    stranger = Observer(domain)
    try:
        command = stranger.talk(Float64, "/command")
        stranger.node.create_timer(0.02, lambda: command.publish(Float64(data=THEIRS)))
        until(lambda: "refused from" in graph.nodes["hysteresis_compensator"].output, what="the stranger refused")
        since = len(graph.states)
        for pause in (0.2, 0.6, 1.6):
            graph.nodes["motion_controller"].send(signal.SIGSTOP)
            graph.more(round(graph.rate * pause))
            if pause > 0.4:
                graph.until_safe()
            graph.nodes["motion_controller"].send(signal.SIGCONT)
            graph.more(25)
            if pause > 0.4:  # command_timeout
                assert graph.tripped() and abs(graph.voltage()) < 0.01
            graph.start_until_at(SETPOINT)
            graph.more(15)
        assert max(state.position[0] for state in graph.states[since:]) < SETPOINT + 1e-7
    finally:
        stranger.close()


def join(graph, joining: str, folder) -> None:
    """Let a node join the graph, and wait until it is there."""
    if joining == "page":
        page = graph.processes.command("watch", "--port", "0", "--folder", str(folder))
        address = until(lambda: re.search(r"http://\S+(?=/)", page.output), what="the page")[0]
        until(lambda: "html" in urllib.request.urlopen(address, timeout=10.0).read().decode(), what="its text")
        until(lambda: graph.observer.node.count_subscribers("/plant_simulator/state") > 1, what="that the page listens")
    elif joining == "recorder":
        graph.nodes[joining] = graph.processes.node(joining, graph.path, "-p", f"path:={folder / 'bag'}")
        until(lambda: (folder / "bag").exists(), what="the recorder")
    elif joining == "motion_controller":
        assert graph.nodes[joining].leave()[0] == 0  # a regular exit, which is not a loss
        graph.nodes[joining] = graph.processes.node(joining, graph.path)
        until(lambda: "active" in graph.nodes[joining].output, what="the restarted controller")


@pytest.mark.parametrize("graph", [10.0], indirect=True)
def test_a_slow_axis_answers_between_samples_and_loses_none_to_nodes_that_join(graph, domain, tmp_path):
    services_answer_what_has_happened_also_between_two_samples(graph)
    a_node_that_joins_costs_no_sample(graph, domain, tmp_path)
    joining_a_moving_axis_makes_no_larger_step_of_its_voltage(graph, domain, tmp_path)


def a_node_that_joins_costs_no_sample(graph, domain, tmp_path) -> None:
    """Stamps count the samples: all intervals are one period, except for losses caused by a busy machine."""
    graph.be_patient()
    for joining in ("page", "second observer", "recorder", "motion_controller"):
        since = len(graph.states)
        other = None
        if joining == "second observer":
            other = Observer(domain)
            heard = other.listen(*state_topic())
            until(lambda heard=heard: heard, what="the second observer")
        else:
            join(graph, joining, tmp_path)
        graph.more(10)
        if other is not None:
            other.close()
        # it was 0.5 s at 200 Hz and 1.6 s at 10 Hz
        assert longest_gap(graph.states[since - 1 :]) < 0.45, f"{joining} joined"
        if joining != "motion_controller":  # at rest the voltage does not change at all
            assert max(abs(state.position[0] - SETPOINT) for state in graph.states[since:]) < 1e-8
            assert max(abs(state.position[2] - 60.0) for state in graph.states[since:]) < 0.1
        graph.until_at(SETPOINT)


def joining_a_moving_axis_makes_no_larger_step_of_its_voltage(graph, domain, folder) -> None:
    """The path requires 12 V/s, the limit is 24 V/s: after a late sample the voltage catches up within this limit."""
    graph.nodes["recorder"].leave()
    graph.be_patient()
    for node in ("hysteresis_compensator", "plant_simulator"):
        assert graph.observer.set_parameters(f"/{node}", limits__slew_rate=24.0, safe_slew_rate=24.0) == (True, "")
    ways = {"waveform__type": "triangle", "waveform__amplitude": 1.2e-6, "waveform__frequency": 0.25}
    assert graph.observer.trigger("/reference_generator/stop").success
    assert graph.observer.set_parameters("/reference_generator", **ways) == (True, "")
    assert graph.start_of("reference_generator").success
    until(lambda: abs(graph.place() - SETPOINT) > 5e-7, what="an axis that moves")
    since = len(graph.states)
    other = Observer(domain)
    heard = other.listen(*state_topic())
    graph.nodes["recorder"] = graph.processes.node("recorder", graph.path, "-p", f"path:={folder / 'moving'}")
    until(lambda: heard and (folder / "moving").exists(), what="both")
    graph.more(10)
    other.close()
    states = graph.states[since:]
    limits = axis_at(graph.rate).plant_simulator.limits
    bit = (limits.maximum - limits.minimum) / (2**limits.bits - 1) if limits.bits else 0.0
    for before, after in zip(states[:-1], states[1:], strict=True):
        allowed = bit + 24.0 * max(stamp_of(after) - stamp_of(before), 1.0 / graph.rate)
        assert abs(after.position[2] - before.position[2]) <= allowed * (1.0 + 1e-6)
    assert longest_gap(states) < 0.45 and not graph.tripped()
    assert max(state.position[2] for state in states) - min(state.position[2] for state in states) > 1.0, "no motion"


def services_answer_what_has_happened_also_between_two_samples(graph) -> None:
    """Stop and start the axis and its parts; each answer is true before the next sample."""
    from std_msgs.msg import Bool

    estop = graph.observer.talk(Bool, "/estop")
    until(lambda: estop.get_subscription_count() > 0, what="the plant at estop")
    for _ in range(2):
        estop.publish(Bool(data=True))
        graph.until_safe()
        until(lambda: not graph.start_of("motion_controller").success, what="a controller that knows it")
        assert "the plant has stopped the axis" in graph.start_of("reference_generator").message
        assert graph.start().success
        for node in NODES[1:]:  # their next sample comes at least 0.1 s later
            answer = graph.start_of(node)
            assert answer.success and answer.message == "running", f"{node}: {answer.message}"
        graph.until_at(SETPOINT)
    trigger = graph.observer.trigger
    assert trigger("/hysteresis_compensator/stop").message == "stopped: the voltage goes to safe_voltage = 0 V"
    until(lambda: abs(graph.voltage()) < 1e-9, what="the safe voltage")
    assert trigger("/hysteresis_compensator/stop").message == "stopped"
    assert trigger("/hysteresis_compensator/reset").message == "reset; stopped: call ~/start to resume"
    assert trigger("/hysteresis_compensator/start").message == "running"
    graph.until_at(SETPOINT)
    assert trigger("/motion_controller/stop").message == "stopped: the command goes to safe_command = 0 m"
    until(lambda: abs(graph.voltage()) < 1e-9, what="the voltage of the safe command")
    assert trigger("/motion_controller/start").message == "running"
    graph.until_at(SETPOINT)
    stopped = trigger("/plant_simulator/stop")
    assert stopped.success and stopped.message == "stopped: no samples are computed, and the voltage stays at 60 V"
    assert trigger("/plant_simulator/start").message == "running"
    graph.more(3)


def longest_gap(states) -> float:
    """Return the longest time between two samples, by their stamps [s]."""
    stamps = [stamp_of(state) for state in states]
    return max(after - before for before, after in zip(stamps[:-1], stamps[1:], strict=True))


def stamp_of(state) -> float:
    return state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec


def command_topic():
    from std_msgs.msg import Float64

    return Float64, "/command"


def state_topic():
    from sensor_msgs.msg import JointState

    return JointState, "/plant_simulator/state"
