# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Positions in rendered frames with known motion: to 0.02 pixel, or a refusal with the reason."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.hardware.simulated_camera import Scene, SceneParameters
from hysteresis_ros.hardware.tracker import CameraParameters, Tracker, find_edge

#: A small frame: methods and refusals do not depend on the size.
SMALL = {"width": 160, "height": 96, "zero": 80.0, "scale": 1.0e-6}


def tracker(**values) -> Tracker:
    flat = {name.replace("__", "."): value for name, value in values.items()}
    return Tracker(CameraParameters.from_mapping({"calibration.scale": 1.0e-6, **flat}))


def errors(scene: Scene, eye: Tracker, pixels, zero: float) -> np.ndarray:
    """Return measured minus true position in the frames of a motion [px]; every frame gives one."""
    scale = scene.parameters.scale
    found = []
    for number, place in enumerate(pixels):
        displacement, seen = eye.see(scene.frame(place * scale, number, 0.04 * number))
        assert not seen.refusal and displacement == pytest.approx(1.0e-6 * seen.pixels)
        found.append(seen.pixels - zero - place)
    return np.array(found)


@pytest.mark.parametrize(
    "conditions",
    [
        {},
        {"noise": 5.0},
        {"blur": 0.6, "tilt": 0.0},
        {"blur": 3.0, "tilt": -9.0},
        {"light_drift": 0.3},
        {"bright": 40.0, "dark": 190.0},
    ],
    ids=str,
)
def test_an_edge_is_found_to_0_02_pixel_with_noise_blur_and_drifting_light(conditions):
    scene = Scene(SceneParameters(**conditions))
    pixels = np.random.default_rng(1).uniform(-60.0, 60.0, 8)
    found = errors(scene, tracker(), pixels, scene.parameters.zero)
    assert math.sqrt(np.mean(found**2)) <= 0.02


def test_without_noise_the_edge_is_where_it_was_rendered_to_less_than_a_thousandth():
    scene = Scene(SceneParameters(**SMALL, noise=0.0, light_drift=0.0))
    found = errors(scene, tracker(), np.linspace(-20.0, 20.0, 41), 80.0)
    assert np.max(np.abs(found)) < 2e-3


@pytest.mark.parametrize("conditions", [{}, {"noise": 5.0, "blur": 2.0, "light_drift": 0.3}], ids=str)
def test_a_pattern_is_found_again_to_0_02_pixel(conditions):
    scene = Scene(SceneParameters(texture=0.1, **conditions))
    eye = tracker(tracking__method="pattern", tracking__region=(60.0, 112.0, 200.0, 256.0))
    first = errors(scene, eye, [0.0], 0.0)
    found = errors(scene, eye, np.random.default_rng(1).uniform(-50.0, 50.0, 6), 0.0)
    assert first[0] == pytest.approx(0.0, abs=1e-6) and math.sqrt(np.mean(found**2)) <= 0.02


@given(st.integers(-15, 15), st.floats(-0.5, 0.5))
@settings(max_examples=15, deadline=None)
def test_a_frame_that_is_shifted_by_whole_pixels_shifts_the_place_by_as_many(whole, part):
    frame = Scene(SceneParameters(**SMALL)).frame(part * 1e-6)
    eye = tracker(tracking__frozen_frames=0)
    (_, here), (_, there) = (eye.see(frame[:, first : first + 120]) for first in (20, 20 - whole))
    # rounding may decide whether a pixel at the edge of the fitted range belongs to it: 7e-4 px with NumPy 2.5
    assert there.pixels - here.pixels == pytest.approx(whole, abs=1e-3)


def test_motion_along_the_columns_is_the_same_thing_turned():
    scene = Scene(SceneParameters(**SMALL))
    frame = scene.frame(7.3e-6)
    upright, turned = tracker(), tracker(tracking__along="y")
    assert upright.see(frame)[0] == turned.see(np.ascontiguousarray(frame.T))[0]
    inner = tracker(tracking__along="y", tracking__region=(8.0, 30.0, 80.0, 110.0))
    assert inner.see(frame.T)[0] == pytest.approx(upright.see(frame)[0], abs=0.3e-6), "relative to the frame"


def test_the_uncertainty_is_that_of_the_scatter_of_places():
    scene, eye = Scene(SceneParameters(**SMALL, noise=6.0, light_drift=0.0)), tracker()
    seen = [eye.see(scene.frame(0.0, number))[1] for number in range(60)]
    stated = np.mean([place.uncertainty for place in seen])
    assert np.std([place.pixels for place in seen]) == pytest.approx(stated, rel=0.35)
    assert np.mean([place.blur for place in seen]) == pytest.approx(1.2, rel=0.1)
    assert np.mean([place.contrast for place in seen]) == pytest.approx(150.0, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "displacement", "words"),
    [
        ({"bright": 60.0, "dark": 55.0}, 0.0, "no edge: less than half of the rows have 20 grey levels"),
        ({"blur": 5.0}, 0.0, r"blurred: standard deviation [4-9]"),
        ({"blur": 12.0}, 0.0, "no edge|blurred|only"),
        ({}, 75.0e-6, "at the border|no edge"),
        ({}, 200.0e-6, "no edge"),
        ({"noise": 50.0, "bright": 90.0, "dark": 60.0}, 0.0, "uncertain|rows|no edge|border"),
    ],
)
def test_a_frame_without_a_sharp_edge_gives_no_displacement_and_says_why(changes, displacement, words):
    scene, eye = Scene(SceneParameters(**SMALL, **changes)), tracker()
    found, place = eye.see(scene.frame(displacement))
    assert math.isnan(found) and math.isnan(place.pixels) and eye.refused == 1
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(place.refusal)


def test_a_frame_half_of_whose_rows_are_covered_is_refused_and_a_little_dust_is_not():
    frame = Scene(SceneParameters(**SMALL)).frame(0.0)
    clean = tracker().see(frame)[1].pixels
    dusty = frame.copy()
    dusty[20:30, 60:100] = 20
    dusty[60:70, 70:90] = 40  # a notch in the edge
    assert tracker().see(dusty)[1].pixels == pytest.approx(clean, abs=0.03)
    frame[:60] = 100
    assert math.isnan(tracker().see(frame)[0])


def test_a_pattern_that_is_blurred_covered_or_gone_is_refused():
    sharp = Scene(SceneParameters(**SMALL, texture=0.1))
    eye = tracker(tracking__method="pattern", tracking__region=(15.0, 10.0, 48.0, 72.0))
    assert eye.see(sharp.frame(0.0))[0] == pytest.approx(0.0, abs=1e-12)
    _, place = eye.see(gaussian_filter(sharp.frame(0.0, 1).astype(float), 4.0))
    assert place.refusal.startswith("blurred: ") and math.isnan(place.pixels)
    for frame in (np.full((96, 160), 128, np.uint8), sharp.frame(0.0, 2)[::-1]):
        assert "pattern of the first frame is not found again" in eye.see(np.ascontiguousarray(frame))[1].refusal
    assert eye.see(sharp.frame(2.0e-6, 3))[0] == pytest.approx(2.0e-6, abs=0.05e-6), "the edge is not found again"
    blank = tracker(tracking__method="pattern")
    assert "shows no pattern that can be tracked" in blank.see(np.full((96, 160), 128, np.uint8))[1].refusal


def test_a_frozen_camera_and_a_size_that_changes_are_named():
    scene, eye = Scene(SceneParameters(**SMALL)), tracker(tracking__frozen_frames=3)
    frame = scene.frame(0.0)
    seen = [eye.see(frame.copy())[1].refusal for _ in range(5)]
    assert seen[:3] == [""] * 3 and seen[3] == "frozen: 4 frames in a row are identical"
    assert not eye.see(scene.frame(0.0, 1))[1].refusal, "another noise is another frame"
    assert eye.see(frame[:, :100])[1].refusal == "the frame has 100 x 96 px, but the first one had 160 x 96"
    assert not eye.see(scene.frame(0.0, 2))[1].refusal and eye.refused == 3


def test_a_relative_place_counts_from_the_first_frames():
    scene = Scene(SceneParameters(**SMALL))
    eye = tracker(calibration__reference="relative", calibration__home=1.0e-6, calibration__homing_samples=4)
    homing = [eye.see(scene.frame(5.0e-6, number)) for number in range(4)]
    assert all(math.isnan(found) and place.refusal == "homing" for found, place in homing)
    assert eye.see(scene.frame(8.0e-6, 5))[0] == pytest.approx(4.0e-6, abs=0.05e-6)
    eye.reset()
    assert eye.see(scene.frame(8.0e-6, 6))[1].refusal == "homing"


@pytest.mark.parametrize(("straight", "found"), [(9, False), (10, True)])
def test_an_edge_that_less_than_half_of_the_rows_show_is_refused(straight, found):
    """Of 20 rows one shows an edge 4 pixels beside, and the others none."""
    rows, columns = 7 * np.arange(120)[:, np.newaxis] % 20, np.arange(90)
    place = np.where(rows < straight, 40, np.where(rows == straight, 44, 90))
    frame = gaussian_filter(np.where(columns >= place, 160.0, 60.0), (0.0, 1.0))
    edge = find_edge(frame, 20.0, 3.0)
    assert edge.pixels == pytest.approx(39.5, abs=1e-6) if found else "only 45% of the rows" in edge.refusal


def test_the_renderer_covers_as_many_pixels_as_the_tip_is_long():
    """The light of each row follows from its length, for any blur: the frame shows the given displacement."""
    for blur in (0.4, 3.0):
        scene = Scene(SceneParameters(**SMALL, blur=blur, noise=0.0, light_drift=0.0, tilt=0.0))
        for pixels in (-7.25, 0.0, 3.6):
            covered = (scene.frame(pixels * 1e-6).astype(float) - 40.0) / 150.0
            assert covered.sum(axis=1).mean() == pytest.approx(80.5 + pixels, abs=0.02)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"tracking.region": [0.0, 0.0, 10.0]}, "four whole numbers"),
        ({"tracking.region": [0.0, 0.5, 10.0, 10.0]}, "four whole numbers"),
        ({"tracking.region": [0.0, 0.0, 0.0, 10.0]}, "above 0"),
        ({"calibration.scale": 1.0}, "is 1 m per px: give the displacement per px"),
        ({"tracking.method": "pattren"}, "did you mean pattern"),
    ],
)
def test_parameters_that_make_no_sense_are_named(values, words):
    with pytest.raises(ParameterError, match=words):
        CameraParameters.from_mapping({"calibration.scale": 1.0e-6, **values})


def test_a_region_beyond_the_frame_is_named():
    eye = tracker(tracking__region=(100.0, 0.0, 100.0, 96.0))
    assert "does not lie within 160 x 96 px" in eye.see(Scene(SceneParameters(**SMALL)).frame(0.0))[1].refusal
