# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The recorder waits for late messages, and if it cannot continue, the axis does."""

from __future__ import annotations

import itertools
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.nodes.launcher import Graph, GraphError, NodeProcess

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import (  # noqa: E402
    REAL,
    SINE,
    RecordedRun,
    axis_parameters,
    compose,
    diagnostics,
    shortened,
    until,
)


def change_often(fused, least: int) -> None:
    """Change the controller of a fused axis every few samples, until it has run a number of samples."""
    values = itertools.cycle([0.9, 0.8])
    while fused.loop.sample < least:
        fused.apply("motion_controller", "retune", {"sliding_mode.phi": next(values)})


@pytest.mark.skipif(not COMPILED, reason="without Numba the fused loop is too slow for this axis")
@pytest.mark.parametrize("ending", ["stopped", "killed"])
def test_a_fused_run_verifies_however_it_ends_though_no_message_of_its_log_has_come(
    inside, tmp_path, ending, monkeypatch
):
    """No node is spun, so messages that a busy machine delays do not arrive at all here."""
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.nodes.fused import FusedAxis
    from hysteresis_ros.nodes.recorder import RecorderNode
    from hysteresis_ros.recordings.files import load_run

    overrides = {"plant_simulator": {"late_limit": -1}, "recorder": {"path": str(tmp_path / "bag")}}
    axis = axis_parameters(overrides=overrides, time_mode="fused")
    fused = FusedAxis()
    recorder = fused.join(inside.add(RecorderNode, axis.recorder, autostart=False))
    nodes = [recorder, *(fused.join(node) for node in compose(inside, axis, autostart=False))]
    assert all(node.configure_now() for node in nodes) and all(node.activate_now() for node in nodes)
    fused.loop.set(setpoint=4e-6)
    change_often(fused, 600)
    recorder.take_samples()
    change_often(fused, 1500)
    if ending == "killed":
        recorder.take_samples()
        change_often(fused, 2000)
        # after SIGKILL, only the data already given to the operating system remain
        shutil.copytree(tmp_path / "bag", tmp_path / "left")
    monkeypatch.setattr(type(fused.loop), "missed", property(lambda _: 7))
    for node in reversed(nodes):
        node.leaving = True
        node.release()
    assert fused.loop is None and fused.plant.late == 7  # the last message of the run says it
    left = tmp_path / ("left" if ending == "killed" else "bag")
    run = load_run(left, further=True)
    assert run.metadata["complete"] == (ending == "stopped") and len(run) >= 600
    assert sum(change["sample"] < len(run) for change in run.metadata["changes"]) > 4
    assert differences(run, axis) == {} and run.metadata["missing_changes"] == 0


def test_a_change_that_comes_after_the_last_sample_is_still_recorded(inside, tmp_path):
    """A lost message is repeated, possibly long after the end of the run."""
    from rclpy.parameter import Parameter

    from hysteresis_ros.loop.simulation import differences

    overrides = {node: dict(values) for node, values in REAL.items()}
    overrides["reference_generator"] |= SINE
    axis = shortened(axis_parameters(overrides=overrides, time_mode="lockstep", exit_at_end=True), 150)
    run = RecordedRun(inside, axis, tmp_path / "bag")
    held, publisher = [], run.controller.changes._publisher
    usual, publisher_of_log = publisher.publish, run.controller.changes
    publisher_of_log._publisher = type("Held", (), {"publish": staticmethod(held.append)})
    step = run.controller.after_step

    def change():
        step()
        if run.controller.sample == 60:
            assert run.controller.set_parameters_atomically([Parameter("pid.Ki", value=33.0)]).successful

    run.controller.after_step = change
    inside.spin()
    recorder = run._recorder
    until(lambda: recorder.end_of_run == 150 == min(recorder._counts), what="all samples")
    assert not recorder.is_done() and not recorder.finished
    until(lambda: len(held) == 2, what="the end of the log")
    for message in held:
        usual(message)
    until(lambda: recorder.finished, what="the recorder")
    recorded = run.result()
    assert [entry["parameters"] for entry in recorded.metadata["changes"]] == [{"pid.Ki": 33.0}]
    assert recorded.metadata["missing_changes"] == 0 and differences(recorded, axis) == {}


def test_a_run_in_lockstep_that_is_stopped_keeps_its_last_change_however_late_its_message_comes(inside, tmp_path):
    from rclpy.parameter import Parameter

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.nodes import spin
    from hysteresis_ros.recordings.files import load_run

    overrides = {node: dict(values) for node, values in REAL.items()}
    overrides["reference_generator"] |= SINE
    run = RecordedRun(inside, axis_parameters(overrides=overrides, time_mode="lockstep"), tmp_path / "bag")
    held, log = [], run.controller.changes
    publish = log._publisher.publish
    log._publisher = type("Held", (), {"publish": staticmethod(held.append)})
    step = run.controller.after_step

    def change():
        step()
        if run.controller.sample == 60:
            assert run.controller.set_parameters_atomically([Parameter("pid.Ki", value=33.0)]).successful

    drained, found = run._recorder.drained, []

    def silent():
        """The message comes after a silence in which a recorder would have exited."""
        run._recorder._arrived, run._recorder._last_arrival = False, time.monotonic() - 2 * spin.QUIET
        found.append(drained())
        while held and not found[-1]:
            publish(held.pop(0))
        return found[-1]

    run.controller.after_step, run._recorder.drained = change, silent
    while run.controller.sample <= 80:
        inside.executor.spin_once(timeout_sec=0.02)
    spin._leave(inside.executor, inside.nodes, regular=False)
    assert not held and found[-1]  # it exited because everything had arrived, not because of its time-out
    recorded = load_run(tmp_path / "bag", further=True)
    assert [change["parameters"] for change in recorded.metadata["changes"]] == [{"pid.Ki": 33.0}]
    assert len(recorded) > 60 and recorded.metadata["missing_samples"] == 0
    assert differences(recorded, run.axis) == {}


def test_a_full_disk_ends_the_recording_and_not_the_axis(inside, observer, tmp_path, monkeypatch):
    from diagnostic_msgs.msg import DiagnosticArray

    from hysteresis_ros.nodes.recorder import RecorderNode
    from hysteresis_ros.recordings import bag_writer
    from hysteresis_ros.recordings.files import load_run

    slow = {"plant_simulator": {"real_time_factor": 0.05, "late_limit": -1}}
    axis = axis_parameters(overrides=slow, time_mode="realtime")
    axis = replace(axis, recorder=replace(axis.recorder, path=str(tmp_path / "bag"), min_space=1, warn_space=2))
    heard = observer.listen(DiagnosticArray, "/diagnostics")
    monkeypatch.setattr(bag_writer, "LOOK", 0.0)
    recorder = inside.add(RecorderNode, axis.recorder)
    plant, *_ = compose(inside, axis)
    inside.spin()
    until(lambda: min(recorder._counts) > 30, what="samples")
    monkeypatch.setattr(bag_writer, "free_space", lambda path: 1)
    until(lambda: "free on the disk" in (diagnostics(heard, "/recorder") or (0, ""))[1], what="the warning")
    assert diagnostics(heard, "/recorder")[0] == 1 and recorder.bag is not None
    monkeypatch.setattr(bag_writer, "free_space", lambda path: 0)
    until(lambda: "recording ended" in (diagnostics(heard, "/recorder") or (0, ""))[1], what="the error")
    level, text, values = diagnostics(heard, "/recorder")
    assert level == 2 and "less than min_space" in text and values["recording"] == "False"
    now = plant.sample
    until(lambda: plant.sample > now + 20, what="further samples")
    assert not recorder.failure and recorder.exit_code == 0
    assert recorder.trigger_deactivate() is not None and not recorder.failure
    back = load_run(tmp_path / "bag")
    assert back.metadata["complete"] and len(back) > 30
    recorder.leaving = True
    recorder.release()
    assert recorder.failure.startswith("recording ended") and recorder.exit_code == 1


def test_parameters_versions_and_the_twin_are_in_the_bag_itself(inside, tmp_path):
    """The recorder gets no parameter file, and one parameter differs from all other places."""
    from rclpy.parameter import Parameter

    from hysteresis_ros.configuration import parse_configuration
    from hysteresis_ros.loop.reach import single_axis
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.provenance import in_force

    overrides = {node: dict(values) for node, values in REAL.items()}
    overrides["reference_generator"] |= SINE
    axis = shortened(axis_parameters(overrides=overrides, time_mode="lockstep"), 120)
    run = RecordedRun(inside, axis, tmp_path / "bag")
    controller = run.controller
    assert controller.trigger_deactivate() is not None and controller.trigger_cleanup() is not None
    assert controller.set_parameters_atomically([Parameter("sliding_mode.phi", value=0.9)]).successful
    assert controller.configure_now() and controller.activate_now()
    inside.spin()
    recorded = run.result()
    assert recorded.metadata["parameters"]["motion_controller"]["sliding_mode.phi"] == 0.9
    assert recorded.metadata["provenance"]["hysteresis_ros"]
    twin = single_axis(parse_configuration(in_force(recorded), "bag"), recorded.metadata["namespace"])
    assert differences(recorded, twin) == {} and differences(recorded, axis) != {}


def sleeper():
    """Start an idle process instead of a node."""
    return subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"], start_new_session=True)


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_killed_recorder_ends_a_run_in_lockstep_only(tmp_path, mode):
    said = []
    axis = axis_parameters(time_mode=mode)
    graph = Graph([axis], record=tmp_path / "bag", warn=said.append)
    graph.processes = [NodeProcess(name, "", sleeper()) for name in ("recorder", "plant_simulator")]
    with graph._stack:
        recorder = graph.processes[0]
        try:
            assert graph.poll()
            recorder.process.send_signal(signal.SIGKILL)
            recorder.process.wait()
            if mode == "lockstep":
                with pytest.raises(GraphError, match="/recorder was killed by SIGKILL; the other nodes were stopped"):
                    graph.poll()
            else:
                assert graph.poll() and graph.poll()
                assert said == ["/recorder was killed by SIGKILL: the recording has ended, the axis continues"]
                assert graph.lost == [recorder]
        finally:
            graph.stop()


def test_every_setpoint_that_was_taken_is_in_the_bag_and_no_other(inside, tmp_path):
    """For each way of sending: by service, by topic, and from a publisher that left before the recorder knew it."""
    from rclpy.serialization import deserialize_message
    from std_msgs.msg import Float64

    from hysteresis_ros.nodes.recorder import RecorderNode

    overrides = {"plant_simulator": {"late_limit": -1}, "recorder": {"path": str(tmp_path / "bag")}}
    axis = axis_parameters(overrides=overrides, sample_rate=50.0, time_mode="realtime")
    recorder = inside.add(RecorderNode, axis.recorder)
    source = compose(inside, axis)[-1]
    written, write = [], recorder.bag.write

    def noted(topic, type_name, data, *rest):
        if topic == "/setpoint":
            written.append(deserialize_message(data, Float64).data)
        write(topic, type_name, data, *rest)

    recorder.bag.write = noted
    inside.spin()
    until(lambda: source._taken.get_subscription_count() and recorder.sample > 3, what="a recorded axis")
    asked = [1e-6, 2e-6, 5e-2, 2e-6, 3e-6, 4e-6]  # one is outside the range
    for value in asked:
        source.take_and_tell(value)
    until(lambda: len(written) >= 5, what="setpoints in the bag")
    assert written == [value for value in asked if value < 1e-3]
