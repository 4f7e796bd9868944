# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.
"""The nodes of a stage of coupled axes: the numbers of its offline twin, bit for bit, and a common stop."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import ROOT, until  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.stage_parameters import StageParameters  # noqa: E402
from hysteresis_ros.models.block import COMPILED  # noqa: E402
from hysteresis_ros.nodes.motion_controller import MotionControllerNode  # noqa: E402
from hysteresis_ros.nodes.stage import StageControllerNode, StagePlantNode, StagePlants, StageSources  # noqa: E402

SAMPLES = 200
#: Both axes move within some hundred samples, and every matrix changes if its axes are exchanged.
MOVING = {
    "stage": {
        "sensor_matrix": [1.0, 0.02, -0.01, 1.0],
        "decoupling": [1.0, -0.05, -0.03, 1.0],
        "feedforward.preview": 1,
        "feedforward.weights": [0.01, -0.01, 0.02, -0.02, -0.03, 0.03, 0.04, -0.04],
    },
    "motion_controller": {"feedforward.type": "static", "feedforward.preview": 1},
    "x/reference_generator": {"waveform__type": "sine", "waveform__frequency": 100.0, "waveform__amplitude": 2e-6},
    "y/reference_generator": {"waveform__type": "sine", "waveform__frequency": 60.0, "waveform__amplitude": 3e-6},
}
#: Controllers that wait 2 ms for a measurement.
PATIENT = MOVING["motion_controller"] | {"measurement_timeout": 0.002}


def stage(overrides: dict, samples: int = SAMPLES, **common) -> StageParameters:
    """Return xy_scanner with other values, by node, with double underscores for dots."""
    configuration = load_configuration("xy_scanner").override("", **({"time_mode": "lockstep"} | common))
    for node, values in overrides.items():
        configuration = configuration.override(node, **values)
    one = StageParameters.from_configuration(configuration)
    return one.with_duration(samples / one.sample_rate) if samples else one


def write(path, parameters: StageParameters) -> str:
    path.write_text(parameters.configuration_text(), encoding="utf-8")
    return str(path)


def part_of(tripped=False, with_stage=False) -> SimpleNamespace:
    """Return the plant of an axis, and count how often it is stopped with its stage."""
    found = SimpleNamespace(tripped=tripped, stopped_with_stage=with_stage, count=0)
    found.stop_with_stage = lambda: setattr(found, "count", found.count + 1)
    return found


def test_one_axis_that_is_stopped_stops_all_and_none_stops_none():
    for tripped in ((False, False, False), (False, True, False)):
        nodes = [SimpleNamespace(part=part_of(one)) for one in tripped]
        StagePlants.stop_together(SimpleNamespace(nodes=nodes))
        assert [node.part.count for node in nodes] == [int(any(tripped))] * 3


def test_the_axis_that_has_stopped_the_stage_is_named_and_not_one_that_it_has_stopped():
    def node(name, *part):
        explained = SimpleNamespace(part=part_of(*part))
        explained.get_namespace, explained.explain_trip = lambda: name, lambda: f"why {name}"
        return explained

    asked = node("/z", True, True)
    asked.others = [node("/w"), node("/x", True, True), node("/y", True)]
    assert StagePlantNode.explain_trip(asked) == "/y has stopped the stage: why /y"
    asked.others.pop()
    assert StagePlantNode.explain_trip(asked) == "another axis of the stage was stopped: call ~/start to resume"


def test_setpoints_of_several_axes_are_taken_all_or_none():
    taken, noted = [], []
    fused = SimpleNamespace(loop=SimpleNamespace(set_together=taken.append))

    def node(place):
        generator = SimpleNamespace(refuse=lambda value: "above 40 µm" if value > 40e-6 else "")
        one = SimpleNamespace(is_fused=True, part=SimpleNamespace(generator=generator), note_setpoint=noted.append)
        one.fused = SimpleNamespace(place=place, loop=fused.loop)
        return one

    sources = SimpleNamespace(parameters=SimpleNamespace(names=("x", "y")), nodes=[node(0), node(1)])
    assert StageSources.take(sources, {"x": 1e-6, "y": 50e-6}) == "y: above 40 µm"
    assert "no axis 'z' in the stage: it has x, y" in StageSources.take(sources, {"x": 1e-6, "z": 0.0})
    assert not taken and not noted
    assert StageSources.take(sources, {"x": 1e-6, "y": 2e-6}) == ""
    assert taken == [{0: 1e-6, 1: 2e-6}] and noted == [1e-6, 2e-6]


def test_a_controller_that_is_reset_forgets_its_references_and_those_of_no_other_axis(monkeypatch):
    monkeypatch.setattr(MotionControllerNode, "reset_blocks", lambda node: None)
    known = np.ones(3)
    nodes = [object.__new__(StageControllerNode) for _ in range(3)]
    group = SimpleNamespace(nodes=nodes, coupling=SimpleNamespace(arrays=SimpleNamespace(known=known)))
    nodes[1].group = group
    nodes[1].reset_blocks()
    np.testing.assert_array_equal(known, [1.0, 0.0, 1.0])


@pytest.mark.parametrize("how", ["--composed", "--processes"])
def test_a_recorded_run_of_a_stage_equals_its_offline_twin_bit_for_bit(processes, tmp_path, how):
    from hysteresis_ros.loop.stage_simulation import simulate_stage, stage_differences
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.files import load_run

    parameters = stage(MOVING)
    path, bag = write(tmp_path / "stage.yaml", parameters), tmp_path / "bag"
    twin = simulate_stage(parameters)  # before the run: the first one compiles the loop in a minute
    run = processes.command("up", path, how, "--record", str(bag), "--verify")
    assert run.wait() == 0, run.output
    assert f"{SAMPLES} samples equal the offline twin bit for bit, none missing" in run.output
    assert "axes x, y: in lockstep" in run.output
    # every signal of both axes, from the topics of a single axis
    recorded = load_run(bag, further=True)
    assert recorded.axes == ("x", "y")
    assert recorded.metadata["missing_samples"] == 0
    assert {name for name in twin.signals if name not in recorded} <= {f"{axis}/skipped" for axis in "xy"}
    assert stage_differences(recorded, parameters) == {}
    for name in "xy":
        assert np.ptp(twin[f"{name}/displacement"]) > 15e-6
        assert len(read_bag(bag).topics[f"/{name}/voltage"].data) == SAMPLES
        alone = load_run(bag, name)
        assert np.array_equal(alone["displacement"], recorded[f"{name}/displacement"])
    if how == "--processes":  # the files are the same
        return
    verified = processes.command("verify", str(bag))
    assert verified.wait() == 0, verified.output
    assert "bit for bit" in verified.output
    reported = processes.command("report", str(bag))
    assert reported.wait() == 0, reported.output
    assert "bag x" in reported.output and "bag y" in reported.output


def test_an_axis_that_trips_or_loses_its_measurement_stops_the_stage_in_the_nodes_as_in_the_twin(processes, tmp_path):
    from hysteresis_ros.loop.watch import RUNNING, STALE, STOPPED
    from hysteresis_ros.recordings.files import load_run

    given = MOVING | {"motion_controller": PATIENT, "plant_simulator": {"late_limit": 5}}
    path, samples = write(tmp_path / "stage.yaml", stage(given, 400)), 400
    words = ("--fault", "stale:0.008:0.01", "--fault", "lost_voltage:0.03:0.002", "--namespace", "y")
    run = processes.command("up", path, "--composed", "--record", str(tmp_path / "bag"), "--verify", *words)
    assert run.wait() == 0, run.output
    assert f"{samples} samples equal the offline twin bit for bit" in run.output
    assert "/y has stopped the stage" in run.output
    recorded = load_run(tmp_path / "bag", further=True)
    lost = recorded["y/controller_mode"][:300] == STALE
    assert np.array_equal(np.flatnonzero(lost), np.arange(99, 180))
    # the other axis stops from the next sample on, until the sample after the start
    held = recorded["x/controller_mode"][:300] == STOPPED
    assert np.array_equal(np.flatnonzero(held), np.arange(100, 181))
    for name, waiting in (("y", lost), ("x", held)):
        # towards the safe command, 0
        assert np.max(np.diff(recorded[f"{name}/command"][:300][waiting])) <= 0.0
        assert recorded[f"{name}/controller_mode"][299] == RUNNING
        stopped = np.flatnonzero(recorded[f"{name}/tripped"])
        assert 300 < stopped[0] < 310
        assert stopped[-1] == samples - 1
        # to the safe voltage, 0 V, at the safe slew rate of 0.1 V per sample
        assert np.max(np.diff(recorded[f"{name}/plant_voltage"][stopped])) <= 0.0


def test_a_stage_of_one_axis_gives_the_bits_of_the_axis(processes, tmp_path):
    from hysteresis_ros.loop.axis import Axis
    from hysteresis_ros.loop.parameters import AxisParameters
    from hysteresis_ros.recordings.files import load_run

    mode = {"A": (0.9, 0.42, -0.42, 0.89), "B": (0.095, 0.42), "C": (1.0, 0.0)}
    moving = {"x/reference_generator": MOVING["x/reference_generator"]}
    entries = load_configuration("xy_scanner").entries
    configuration = replace(
        load_configuration("xy_scanner"), entries=tuple(entry for entry in entries if not entry[0].startswith("/y/"))
    ).override("", time_mode="lockstep")
    for node, values in moving.items():
        configuration = configuration.override(node, **values)
    configuration = configuration.override("plant_simulator", dynamics__delay=0.0, dynamics__sample_time=0.0)
    structure = {f"structure__{name}": matrix for name, matrix in mode.items()}
    coupled = configuration.override(
        "stage", axes=["x"], structure__inputs=1, structure__outputs=1, decoupling=[], **structure
    )
    single = replace(configuration, entries=tuple(entry for entry in configuration.entries if entry[0] != "/stage"))
    alone = Axis(
        AxisParameters.from_configuration(
            single.override(
                "plant_simulator",
                dynamics__sample_time=1e-4,
                dynamics__input_scale=1.0,
                **{f"dynamics__{name}": matrix for name, matrix in mode.items()},
            ),
            "/x",
        )
    )
    one = StageParameters.from_configuration(coupled)
    path = write(tmp_path / "stage.yaml", one.with_duration(SAMPLES / one.sample_rate))
    run = processes.command("up", path, "--composed", "--record", str(tmp_path / "bag"))
    assert run.wait() == 0, run.output
    recorded = load_run(tmp_path / "bag")
    expected = alone.run(alone.default_setpoints(SAMPLES))
    for name in ("setpoint", "reference", "command", "voltage", "displacement", "measured"):
        assert np.array_equal(expected[name], recorded[f"x/{name}"]), name


def test_in_real_time_an_emergency_stop_of_one_axis_stops_the_stage_until_a_start(processes, observer, tmp_path):
    from std_msgs.msg import Bool

    from hysteresis_ros.recordings.files import load_run

    heard = {name: observer.listen(JointState, f"/{name}/joint_states") for name in "xy"}
    estop = observer.talk(Bool, "/x/estop")
    # neither late voltages nor a moment without messages, on a busy machine, stop the stage: only the test does
    given = {
        "plant_simulator": {"late_limit": -1, "voltage_timeout": 20.0},
        "hysteresis_compensator": {"command_timeout": 20.0},
        "motion_controller": {"measurement_timeout": 20.0},
    }
    path = write(tmp_path / "stage.yaml", stage(given, 0, time_mode="realtime"))
    run = processes.command("up", path, "--processes", "--factor", "0.01", "--record", str(tmp_path / "bag"))
    until(lambda: all(len(one) > 50 for one in heard.values()), what="samples in real time")
    until(lambda: estop.get_subscription_count(), what="the plant at estop")
    assert {one[-1].header.frame_id for one in heard.values()} == {""}
    estop.publish(Bool(data=True))
    until(lambda: all(one[-1].header.frame_id for one in heard.values()), what="a stage that is stopped")
    counts = {name: len(one) for name, one in heard.items()}
    until(lambda: all(len(one) > counts[name] + 10 for name, one in heard.items()), what="samples of the stopped stage")
    assert observer.trigger("/y/plant_simulator/start").success
    until(lambda: not any(one[-1].header.frame_id for one in heard.values()), what="a stage that goes on")
    # ~/stop of one plant stops the time of both
    assert observer.trigger("/y/plant_simulator/stop").success
    counts = {name: len(one) for name, one in heard.items()}
    assert observer.trigger("/x/plant_simulator/start").success
    until(lambda: all(len(one) > counts[name] + 20 for name, one in heard.items()), what="samples after the start")
    code, _ = run.leave()
    assert code == 0, run.output
    recorded = load_run(tmp_path / "bag", further=True)
    assert recorded.axes == ("x", "y")
    assert len(recorded) > 50
    for name in "xy":
        # the last samples may not have reached the recorder and are then NaN
        stopped = np.flatnonzero(recorded[f"{name}/tripped"] > 0.0)
        assert 0 < stopped.size < len(recorded) - 20
    # the plant of the other axis stops one sample later
    known = np.isfinite(recorded["x/tripped"] + recorded["y/tripped"])
    begins = [np.argmax(recorded[f"{name}/tripped"][known] > 0.0) for name in "xy"]
    assert begins[1] - begins[0] in (0, 1)


@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for a stage")
def test_a_fused_stage_is_steered_and_stopped_as_a_whole_and_repeated_bit_for_bit(processes, observer, tmp_path):
    from std_msgs.msg import Bool, Float64, Float64MultiArray

    from hysteresis_ros.recordings.files import load_run

    states = {name: observer.listen(JointState, f"/{name}/plant_simulator/state") for name in "xy"}
    joints = observer.listen(JointState, "/joint_states")
    estop, setpoint = observer.talk(Bool, "/y/estop"), observer.talk(Float64, "/x/setpoint")
    places = observer.talk(Float64MultiArray, "/setpoints")
    own = {"motion_controller": MOVING["motion_controller"]}
    holding = own | {"reference_generator": {"waveform__type": "hold"}, "plant_simulator": {"late_limit": -1}}
    path = write(tmp_path / "stage.yaml", stage({"stage": MOVING["stage"]} | holding, 0, time_mode="fused"))
    run = processes.command("up", path, "--factor", "0.1", "--record", str(tmp_path / "bag"), "--verify")

    def now(name: str, signal: str) -> float:
        return dict(zip(states[name][-1].name, states[name][-1].position, strict=True))[signal]

    def at(name: str, place: float) -> None:
        until(lambda: abs(now(name, "displacement") - place) < 1e-7, what=f"{name} at {place:g} m")

    def heard() -> bool:
        matched = all(one.get_subscription_count() for one in (estop, setpoint, places))
        return matched and all(len(one) > 10 for one in states.values())

    until(lambda: heard() or run.popen.poll() is not None, what="a fused stage")
    assert "axes x, y: fused, one process" in run.output, run.output
    setpoint.publish(Float64(data=12e-6))
    at("x", 12e-6)
    places.publish(setpoints("y,x", 25e-6, 15e-6))
    at("x", 15e-6)
    at("y", 25e-6)
    assert joints[-1].name == ["x", "y"] and abs(joints[-1].position[1] - 25e-6) < 1e-6
    assert observer.set_parameters("/x/motion_controller", pid__Ki=1500.0) == (True, "")
    refused, reason = observer.set_parameters("/y/motion_controller", pid__Ki=math.inf)
    assert not refused and "pid.Ki" in reason
    assert observer.trigger("/y/motion_controller/stop").success
    until(lambda: now("y", "displacement") < 5e-6, what="y without its controller")
    assert observer.trigger("/y/motion_controller/start").success
    at("y", 25e-6)
    # an emergency stop of one axis stops all axes in the same sample; ~/start of the other axis' plant restarts all
    estop.publish(Bool(data=True))
    until(lambda: all(now(name, "tripped") and abs(now(name, "voltage")) < 0.01 for name in "xy"), what="a safe stage")
    assert "another axis of the stage" in run.output or "emergency stop" in run.output
    assert observer.trigger("/x/plant_simulator/start").success
    at("x", 15e-6)
    at("y", 25e-6)
    assert observer.trigger("/y/plant_simulator/reset").success
    at("x", 20e-6)  # the configured setpoint
    at("y", 20e-6)
    code, _ = run.leave()
    assert code == 0, run.output
    assert "samples equal the offline twin bit for bit, none missing" in run.output
    recorded = load_run(tmp_path / "bag", further=True)
    stops = {name: np.flatnonzero(np.diff((recorded[f"{name}/tripped"] != 0.0).astype(int)) == 1) for name in "xy"}
    assert np.array_equal(stops["x"], stops["y"]) and stops["x"].size >= 1
    begins = [np.flatnonzero(recorded[f"{name}/setpoint"] == place)[0] for name, place in (("x", 15e-6), ("y", 25e-6))]
    assert begins[0] == begins[1]


@pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for a stage")
def test_a_fused_stage_whose_axis_trips_or_loses_its_measurement_is_safe_as_a_whole(processes, tmp_path):
    from hysteresis_ros.loop.watch import STALE, STOPPED
    from hysteresis_ros.recordings.files import load_run

    given = MOVING | {"motion_controller": PATIENT, "plant_simulator": {"late_limit": 5}}
    path = write(tmp_path / "stage.yaml", stage(given, 400))
    words = ("--fault", "stale:0.008:0.01", "--fault", "lost_voltage:0.03:0.002", "--namespace", "x")
    asked = ("--fused", "--factor", "0.01", "--record", str(tmp_path / "bag"), "--verify", *words)
    run = processes.command("up", path, *asked)
    assert run.wait() == 0, run.output
    assert "400 samples equal the offline twin bit for bit, none missing" in run.output
    assert "/x has stopped the stage" in run.output
    recorded = load_run(tmp_path / "bag", further=True)
    assert np.array_equal(np.flatnonzero(recorded["x/controller_mode"] == STALE), np.arange(99, 180))
    assert np.array_equal(np.flatnonzero(recorded["y/controller_mode"] == STOPPED), np.arange(100, 181))
    for name in "xy":
        stopped = np.flatnonzero(recorded[f"{name}/tripped"])
        assert 300 < stopped[0] < 310 and stopped[-1] == 399


@pytest.mark.parametrize(
    ("mode", "killed"),
    [
        ("lockstep", "motion_controller"),
        ("fused", "hysteresis_stage"),
    ],
)
def test_a_killed_process_ends_the_stage_with_an_error_that_names_it(domain, observer, tmp_path, mode, killed):
    from hysteresis_ros.nodes.domain import OWN
    from hysteresis_ros.nodes.launcher import Graph, GraphError

    parameters = stage({} if mode == "lockstep" else {"plant_simulator": {"real_time_factor": 0.01}}, 0, time_mode=mode)
    heard = observer.listen(JointState, "/joint_states")
    environment = {"ROS_DOMAIN_ID": str(domain), OWN: str(domain), "PYTHONPATH": str(ROOT)}
    graph = Graph(list(parameters.axes), stage=parameters, log_level="error", environment=environment)
    with graph:
        until(lambda: len(heard) > 20, what="samples of the stage")
        node = next(node for node in graph.processes if node.name == killed)
        node.process.kill()
        with pytest.raises(GraphError, match=f"{killed} was killed by SIGKILL; the other nodes were stopped"):
            graph.wait()
        assert all(one.process.returncode is not None for one in graph.processes)


def test_in_real_time_the_stage_is_safe_when_a_process_is_killed_and_no_one_stops_the_rest(
    processes, observer, tmp_path
):
    """As with nodes started one by one: no launcher restarts or stops them."""
    states = {name: observer.listen(JointState, f"/{name}/plant_simulator/state") for name in "xy"}
    # late voltages of a busy machine stop no stage, only a lost partner does
    given = {"plant_simulator": {"real_time_factor": 0.01, "late_limit": -1}}
    path = write(tmp_path / "stage.yaml", stage(given, 0, time_mode="realtime"))
    nodes = {
        kind: processes.start(
            [sys.executable, "-m", "hysteresis_ros.nodes.stage", kind, "--ros-args", "--params-file", path], kind
        )
        for kind in ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")
    }

    def now(name: str, signal: str) -> float:
        return dict(zip(states[name][-1].name, states[name][-1].position, strict=True))[signal]

    until(lambda: all(states[name] and now(name, "voltage") > 10.0 for name in "xy"), what="a stage that moves")
    nodes["motion_controller"].kill()
    until(lambda: all(now(name, "tripped") and abs(now(name, "voltage")) < 0.01 for name in "xy"), what="a safe stage")
    assert "motion_controller" in nodes["plant_simulator"].output + nodes["hysteresis_compensator"].output
    answer = observer.trigger("/x/plant_simulator/start")
    assert not answer.success and "lost" in answer.message


def setpoints(label: str, *values: float):
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    made = Float64MultiArray(data=list(values))
    made.layout.dim = [MultiArrayDimension(label=label, size=len(values))]
    return made


def trajectory(names: list[str], *points: tuple[float, list[float]]):
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    made = JointTrajectory(joint_names=names)
    for time, positions in points:
        since = Duration(nanosec=round(1e9 * time))
        made.points.append(JointTrajectoryPoint(positions=positions, time_from_start=since))
    return made


@pytest.mark.parametrize("mode", ["lockstep", "fused"])
def test_setpoints_and_a_trajectory_of_several_axes_move_them_with_one_clock(processes, observer, tmp_path, mode):
    from std_msgs.msg import Float64MultiArray, String
    from trajectory_msgs.msg import JointTrajectory

    from hysteresis_ros.recordings.files import load_run

    if mode == "fused" and not COMPILED:
        pytest.skip("without Numba the loop is too slow for a stage")
    places = observer.talk(Float64MultiArray, "/setpoints")
    trajectories = observer.talk(JointTrajectory, "/joint_trajectory")
    samples = observer.listen(JointState, "/joint_states")
    refused = observer.listen(String, "/x/reference_generator/refused")
    said = {name: observer.listen(String, f"/{name}/reference_generator/trajectory") for name in "xy"}
    given = {"reference_generator": {"waveform__type": "hold"}, "plant_simulator": {"late_limit": -1}}
    path = write(tmp_path / "stage.yaml", stage(given, 0, time_mode=mode))
    how = ("--composed",) if mode == "lockstep" else ("--factor", "0.05")
    run = processes.command("up", path, *how, "--record", str(tmp_path / "bag"), "--verify")

    def heard() -> bool:
        return all(one.get_subscription_count() for one in (places, trajectories)) and len(samples) > 20

    until(lambda: heard() or run.popen.poll() is not None, what="the samples of the stage")
    assert samples[-1].name == ["x", "y"], run.output
    assert len(samples[-1].position) == len(samples[-1].velocity) == len(samples[-1].effort) == 2
    if mode == "lockstep":  # otherwise it computes very many samples meanwhile
        assert observer.trigger("/x/plant_simulator/stop").success
    for wrong in (("x,y", 12e-6, 1.0), ("x,z", 12e-6, 13e-6), ("y", 12e-6, 13e-6)):
        places.publish(setpoints(*wrong))
    until(lambda: len(refused) == 3, what="the refusals of setpoints")
    assert "there is no axis 'z' in the stage" in refused[1].data
    trajectories.publish(trajectory(["x", "z"], (0.02, [24e-6, 17e-6])))
    trajectories.publish(trajectory(["x", "y"], (0.02, [24e-6])))
    trajectories.publish(trajectory(["x", "y"], (0.02, [24e-6, 50e-6])))  # y is out of range: x does not move either
    until(lambda: len(refused) == 6, what="the refusals of trajectories")
    assert "joint_names" in refused[3].data and "points[0].positions" in refused[4].data
    assert "y: trajectory positions = 4.0" in refused[5].data and "out of range" in refused[5].data
    if mode == "lockstep":
        assert observer.trigger("/x/plant_simulator/start").success
    trajectories.publish(trajectory(["y", "x"], (0.01, [17e-6, 22e-6]), (0.02, [17e-6, 24e-6])))
    for name in "xy":
        until(lambda name=name: any("1 arrived" in one.data for one in said[name]), what=f"the arrival of {name}")
    places.publish(setpoints("y,x", 12e-6, 13e-6))
    until(lambda: np.allclose(samples[-1].position, (13e-6, 12e-6), atol=1e-7), what="the axes at their setpoints")
    assert run.leave()[0] == 0, run.output
    assert "samples equal the offline twin bit for bit, none missing" in run.output
    found = load_run(tmp_path / "bag", further=True)
    begins = {name: np.flatnonzero(np.diff(found[f"{name}/setpoint"]))[-1] for name in "xy"}
    assert begins["x"] == begins["y"]
    assert (found["x/setpoint"][-1], found["y/setpoint"][-1]) == (13e-6, 12e-6)
    moves = {name: np.flatnonzero(np.diff(found[f"{name}/reference"][: begins["x"]])) for name in "xy"}
    assert moves["x"][0] == moves["y"][0]
    assert moves["x"].size == 200 and moves["y"].size == 100
    assert [found[f"{name}/reference"][begins["x"]] for name in "xy"] == [24e-6, 17e-6]
