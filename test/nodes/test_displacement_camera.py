# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The camera in the graph: frames over DDS close the loop as offline; images without the target are reported."""

from __future__ import annotations

import contextlib
import math

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import RecordedRun, diagnostics, shortened, until  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.hardware.simulated_camera import Scene, SceneParameters  # noqa: E402
from hysteresis_ros.loop.parameters import AxisParameters  # noqa: E402
from hysteresis_ros.loop.simulation import differences  # noqa: E402
from hysteresis_ros.nodes import launcher  # noqa: E402
from hysteresis_ros.nodes.launcher import Graph  # noqa: E402

SMALL = {"width": 128, "height": 48, "zero": 40.0}


def seen_axis(**common) -> AxisParameters:
    """The paper's axis with small frames that take little time."""
    given = load_configuration("auwal2017_camera").override("", **common)
    given = given.override("plant_simulator", **{f"camera__{name}": value for name, value in SMALL.items()})
    seen = {"tracking__region": (), "calibration__offset": -20.0e-6}
    return AxisParameters.from_configuration(given.override("displacement_camera", **seen))


def test_in_lockstep_the_loop_through_frames_is_its_offline_twin_bit_for_bit(inside, tmp_path):
    from hysteresis_ros.nodes.displacement_camera import DisplacementCameraNode

    axis = shortened(seen_axis(time_mode="lockstep"), 80)
    eye = inside.add(DisplacementCameraNode, axis.displacement_camera)
    run = RecordedRun(inside, axis, tmp_path / "bag")
    inside.spin()
    recorded = run.result()
    assert eye.sample == 80 and len(recorded) == 80
    assert abs(recorded["seen"][-1] - recorded["displacement"][-2]) < 0.1 * 0.5e-6 < recorded["displacement"][-1]
    assert differences(recorded, run.axis) == {}


def image(frame, number: int, encoding: str = "mono8"):
    from sensor_msgs.msg import Image

    message = Image(encoding=encoding, height=frame.shape[0], width=frame.shape[1], step=frame.shape[1])
    message.header.stamp.sec, message.header.frame_id = number, "camera"
    message.data = frame.tobytes()
    return message


def test_images_that_show_no_place_give_no_measurement_and_are_named(inside, observer):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import Image, JointState

    from hysteresis_ros.nodes.displacement_camera import DisplacementCameraNode

    axis = seen_axis()
    node = inside.add(DisplacementCameraNode, axis.displacement_camera)
    inside.spin()
    joints = observer.listen(JointState, "/joint_states")
    states = observer.listen(JointState, "/displacement_camera/state")
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    camera = observer.talk(Image, "/image")
    until(lambda: camera.get_subscription_count() and node.all_matched(), what="the graph")
    scene = Scene(SceneParameters(**SMALL))
    numbers = iter(range(1, 10**6))

    def shown(frame, encoding="mono8"):
        number = next(numbers)
        camera.publish(image(frame, number, encoding))
        until(lambda: joints and joints[-1].header.stamp.sec == number, what="an answer")
        assert joints[-1].header.frame_id == ""
        return joints[-1].position[0]

    assert shown(scene.frame(3.0e-6, 1)) == pytest.approx(3.0e-6, abs=0.05e-6)
    assert shown(scene.frame(3.0e-6, 9)) == pytest.approx(3.0e-6, abs=0.05e-6)
    # stamps a second apart, at 25 frames a second
    node.tell_health()  # it does so each second
    until(lambda: any(report.status[0].message == "24 frames lost" for report in reports), what="the loss")
    assert diagnostics(reports, "/displacement_camera")[2]["lost_frames"] == "24"
    assert list(joints[-1].name) == ["stack"]
    until(lambda: states)
    assert states[0].position[1] == pytest.approx(46.0, abs=0.1) and states[0].name[1] == "pixels"
    empty, dim = scene.frame(0.0, 2), Scene(SceneParameters(**SMALL, bright=50.0)).frame(0.0)
    for frame, encoding, words in (
        (dim, "mono8", "frame refused: no edge"),
        (empty, "bayer_rggb8", "frame refused: encoding 'bayer_rggb8' is not supported"),
        (empty[:40], "mono8", "frame refused: the frame has 128 x 40 px, but the first one had 128 x 48"),
    ):
        assert math.isnan(shown(frame, encoding))
        node.tell_health()
        until(lambda words=words: (diagnostics(reports, "/displacement_camera") or [0, ""])[1].startswith(words))
        assert diagnostics(reports, "/displacement_camera")[0] == 2
    for _ in range(6):
        last = shown(empty)
    assert math.isnan(last)
    node.tell_health()
    until(lambda: "frozen: 6 frames" in diagnostics(reports, "/displacement_camera")[1])
    assert shown(scene.frame(1.0e-6, 3)) == pytest.approx(1.0e-6, abs=0.05e-6)
    until(lambda: "no image on /image for" in diagnostics(reports, "/displacement_camera")[1], what="the silence")


def test_the_graph_of_such_an_axis_has_the_camera_beside_the_others(monkeypatch, tmp_path):
    started = []
    monkeypatch.setattr(Graph, "_spawn", lambda self, name, *rest: started.append(name))
    monkeypatch.setattr(launcher, "session", lambda environment: contextlib.nullcontext())
    for composed, external in ((False, False), (True, False), (False, True)):
        Graph([seen_axis(external_plant=external)], composed=composed).start()
    three = ["reference_generator", "motion_controller", "hysteresis_compensator"]
    camera = "displacement_camera"
    assert started == ["plant_simulator", *three, camera, "hysteresis_axis", camera, *three, camera]
