# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Folders and videos become recordings; the scale of a pixel follows from a known motion or target."""

from __future__ import annotations

import math
import pathlib
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from hysteresis_ros.cli.camera import camera
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.hardware.footage import Footage, numbered, scale_of_motion, scale_of_target
from hysteresis_ros.hardware.simulated_camera import Scene, SceneParameters
from hysteresis_ros.hardware.tracker import FrameError
from hysteresis_ros.recordings.files import load_run

SMALL = {"width": 160, "height": 96, "zero": 80.0, "scale": 0.5e-6}
MOTION = 10.0e-6 * np.sin(np.arange(12) / 2.0)


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """A folder of twelve numbered pictures without the fifth, a video of all, and their motion."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: no pictures and videos")
    folder = tmp_path_factory.mktemp("footage")
    (folder / "pictures").mkdir()
    scene = Scene(SceneParameters(**SMALL))
    video = cv2.VideoWriter(str(folder / "tip.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (160, 96))
    for number, displacement in enumerate(MOTION):
        frame = scene.frame(displacement, number)
        video.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
        if number != 4:
            cv2.imwrite(str(folder / "pictures" / f"tip_{number + 7:03d}.png"), frame)
    video.release()
    rows = [f"{0.04 * number:.17g},{1e6 * place:.17g}\n" for number, place in enumerate(MOTION)]
    (folder / "known.csv").write_text("time [s],displacement [um]\n" + "".join(rows))
    return folder


def called(*words):
    return CliRunner().invoke(camera, [str(word) for word in words])


@pytest.mark.parametrize(("source", "kind"), [("pictures", "csv"), ("tip.avi", "npz"), ("tip.avi", "mcap")])
def test_a_folder_and_a_video_become_a_recording_and_a_lost_frame_stays_lost(footage, tmp_path, source, kind):
    path = tmp_path / f"seen.{kind}"
    done = called(footage / source, "-o", path, "--scale", "0.5um", "--rate", "25")
    assert done.exit_code == 0 and "12 frames at 25 Hz" in done.output
    seen = load_run(path)
    lost = source == "pictures"
    assert np.flatnonzero(np.isnan(seen["measured"])).tolist() == ([4] if lost else [])
    assert ("1 of 12 frames give no displacement: lost or not readable" in done.output) == lost
    error = seen["measured"] - 80.0 * 0.5e-6 - MOTION
    # the compression of a video adds noise
    assert math.sqrt(np.nanmean(error**2)) < (0.02 if lost else 0.05) * 0.5e-6
    assert seen.sample_time == pytest.approx(0.04)


def test_the_command_finds_the_scale_in_a_known_motion_and_a_target(footage, tmp_path):
    import cv2
    import yaml

    done = called(footage / "tip.avi", "--known", footage / "known.csv")
    assert done.exit_code == 0, done.output
    found = yaml.safe_load(done.output)["/**/displacement_camera"]["ros__parameters"]["calibration"]
    assert found["scale"] == pytest.approx(0.5e-6, rel=2e-3) and found["sign"] == 1
    assert found["offset"] == pytest.approx(-40.0e-6, rel=2e-3)
    edges = [SceneParameters(**{**SMALL, "zero": zero, "tilt": 8.0}) for zero in (120.0, 40.0)]
    frames = [Scene(edge).frame(0.0).astype(float) for edge in edges]
    cv2.imwrite(str(tmp_path / "0.png"), np.clip(frames[0] - frames[1] + 40.0, 0.0, 255.0).astype(np.uint8))
    done = called(tmp_path, "--target", "40um")
    assert done.exit_code == 0, done.output
    found = yaml.safe_load(done.output)["/**/displacement_camera"]["ros__parameters"]["calibration"]
    assert found["scale"] == pytest.approx(40e-6 / (80.0 * math.cos(math.radians(8.0))), rel=1e-3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("{0}/tip.avi",), "give one of -o FILE, --known FILE and --target M"),
        (("{0}/tip.avi", "-o", "x.npz"), "give --scale or --config; --known and --target determine it"),
        (("{0}/tip.avi", "-o", "x.npz", "--scale", "5 V"), "--scale 5 V: is in V, must be in m"),
        (("{0}/tip.avi", "-o", "x.npz", "--scale", "1um", "--region", "1,b"), "give four numbers, X,Y,W,H"),
        (
            ("{0}/tip.avi", "-o", "x.npz", "--scale", "1um", "--region", "0,0,500,9"),
            "in any of 12 frames.* does not lie",
        ),
        (("{0}/pictures", "-o", "x.npz", "--scale", "1um"), "has no frame rate: give --rate HZ"),
        (("{0}/known.csv", "-o", "x.npz", "--scale", "1um"), "contains no frames"),
        (("{0}/nowhere", "-o", "x.npz", "--scale", "1um"), "no such file or folder"),
        (("{0}/tip.avi", "-o", "x.txt", "--scale", "1um"), "unknown kind of file '.txt'"),
        (("{0}/tip.avi", "--known", "{0}/known.csv", "--rate", "nan"), "'nan': must be a finite number"),
    ],
)
def test_wrong_words_are_named(footage, words, said):
    done = called(*(word.format(footage) for word in words))
    assert done.exit_code and (done.exit_code == 2 or isinstance(done.exception, HysteresisError))
    with pytest.raises(AssertionError, match=said):
        raise AssertionError(f"{done.output} {done.exception}")


def test_without_opencv_the_message_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(FrameError, match=r'pip install "hysteresis_ros\[camera\]", or python3-opencv'):
        Footage(tmp_path)


def test_a_picture_of_16_bits_keeps_its_fine_grey_levels(tmp_path):
    """White is 255 as in a picture of 8 bits, and steps of a 256th of its grey level are left."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: no pictures and videos")
    deep = np.arange(0, 65536, 16, dtype=np.uint16).reshape(64, 64)
    deep[0, 0] = 65535
    cv2.imwrite(str(tmp_path / "0.png"), deep)
    (found,) = Footage(tmp_path, rate=25.0)
    np.testing.assert_allclose(found, deep * (255.0 / 65535.0), rtol=1e-6)
    assert found.max() == pytest.approx(255.0)


def test_numbers_in_names_count_frames_unless_they_are_times_or_not_everywhere():
    def names(*texts):
        return [(number, path.name) for number, path in numbered(map(pathlib.Path, texts))]

    assert names("a10.png", "a9.png", "a12.png") == [(0, "a9.png"), (1, "a10.png"), (3, "a12.png")]
    assert names("1700000000.png", "1700000040.png") == [(0, "1700000000.png"), (1, "1700000040.png")]
    assert names("b.png", "a1.png") == [(0, "a1.png"), (1, "b.png")]
    assert names() == []


@given(st.floats(1e-8, 1e-3), st.sampled_from([-1, 1]), st.floats(-1.0, 1.0), st.lists(st.floats(-50, 50), min_size=4))
def test_a_known_motion_gives_its_scale_sign_and_offset_back(scale, sign, offset, places):
    places = np.array([*places, -60.0, 60.0, math.nan])
    found = scale_of_motion(places, sign * scale * places + offset * scale)
    assert found.metres_per_pixel == pytest.approx(scale) and found.sign == sign
    assert found.offset == pytest.approx(offset * scale, abs=1e-9 * scale)


@pytest.mark.parametrize(
    ("pixels", "displacements", "words"),
    [
        ([1.0, 2.0, 3.0], [1e-6, 2e-6], "2 known displacements for 3 frames"),
        ([1.0, math.nan, 3.0], [1e-6, 2e-6, 3e-6], "2 frames have a position .*; 3 are needed"),
        ([1.0, 2.0, 1.5, 1.2], [1e-6, 1.1e-6, 3e-6, 0.0], "do not follow the known displacements"),
        ([1.0, 1.0, 1.0], [1e-6, 2e-6, 3e-6], "do not follow the known displacements"),
        ([1.0, 2.0, 3.0], [1e-6, 1e-6, 1e-6], "do not follow the known displacements"),
    ],
)
def test_a_motion_from_which_no_scale_follows_is_named(pixels, displacements, words):
    with pytest.raises(FrameError, match=words):
        scale_of_motion(pixels, displacements)


def test_a_target_without_two_edges_is_named():
    frame = Scene(SceneParameters(**SMALL)).frame(0.0)
    with pytest.raises(FrameError, match=r"only one edge was found, in column 80\.."):
        scale_of_target(frame, 1e-4, 20.0, 4.0)
    with pytest.raises(FrameError, match="no target: no edge"):
        scale_of_target(np.full_like(frame, 90), 1e-4, 20.0, 4.0)
