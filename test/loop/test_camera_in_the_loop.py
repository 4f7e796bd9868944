# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A loop closed through rendered frames, offline: measurement, delay, and frames that are not available."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from hysteresis_ros import signals
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.watch import STALE

#: Small frames that take little time; a pixel is 0.5 µm as in the file.
SMALL = {"width": 128, "height": 48, "zero": 40.0}


def configuration(delay: int = 1, **camera):
    given = load_configuration("auwal2017_camera")
    values = {f"camera__{name}": value for name, value in {**SMALL, "delay": delay, **camera}.items()}
    seen = {"tracking__region": (), "calibration__offset": -20.0e-6}
    return given.override("plant_simulator", **values).override("displacement_camera", **seen)


def axis(**camera) -> Axis:
    return Axis(AxisParameters.from_configuration(configuration(**camera)))


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_what_is_seen_is_where_the_tip_was_so_many_frames_before(delay):
    made = axis(delay=delay).run(np.zeros(120))
    true = made["displacement"][: 120 - delay]
    assert np.ptp(true) > 1.0e-6
    assert np.sqrt(np.mean((made["measured"][delay:] - true) ** 2)) < 0.03 * 0.5e-6
    # before the first frame arrives, the tip is at its initial position
    assert np.abs(made["measured"][:delay] - true[0]).max(initial=0.0) < 0.1 * 0.5e-6


@pytest.mark.slow
def test_the_integral_removes_what_the_inverse_does_not_know():
    wrong = configuration().override("hysteresis_compensator", hysteresis__bouc_wen__d_e=0.19e-6)
    errors = {}
    for kind in ("open_loop", "pid"):
        chosen = wrong.override("motion_controller", type=kind).override("reference_generator", waveform__type="hold")
        made = Axis(AxisParameters.from_configuration(chosen)).run(np.full(250, 10.0e-6))
        errors[kind] = abs(made["displacement"][-1] - made["reference"][-1])
    assert errors["open_loop"] > 0.3e-6 and errors["pid"] < 0.01e-6


@pytest.mark.slow
def test_without_an_edge_the_axis_goes_to_its_safe_command():
    made = axis(bright=45.0, dark=40.0).run(np.zeros(60))
    assert np.isnan(made["measured"]).all()
    blind = axis()
    blind.run(np.zeros(50))
    moved = blind.run(np.zeros(10))
    blind.apply(Change(60, "displacement_camera", "retune", {"tracking.smallest_contrast": 250.0}))
    made = blind.run(np.zeros(60))
    assert moved["command"][-1] > 1.0e-6 and np.isnan(made["measured"]).all()
    assert made["controller_mode"][-1] == STALE and made["command"][-1] == 0.0


@pytest.mark.slow
def test_runs_go_on_copies_are_of_their_own_and_a_reset_begins_again():
    whole = axis().run(np.zeros(40))
    parted = axis()
    first = parted.run(np.zeros(25))
    double = copy.deepcopy(parted)
    ends = [one.run(np.zeros(15)) for one in (parted, double)]
    parted.reset()
    again = parted.run(np.zeros(25))
    for name in ("measured", "voltage", "displacement"):
        for end in ends:
            np.testing.assert_array_equal(np.concatenate([first[name], end[name]]), whole[name])
        np.testing.assert_array_equal(again[name], first[name])


def test_the_plant_itself_measures_nothing():
    plant = axis().plant
    plant.eye.part = None
    assert np.isnan(plant.eye.look(1.0e-6)) and plant.eye.frame.shape == (48, 128)
    assert plant.travel == (-np.inf, np.inf)
    assert "measured" in signals.state_signals("plant_simulator")


def without_section(given, name: str):
    entries = tuple(entry for entry in given.entries if not entry[0].endswith(name))
    return given.__class__(entries, given.text, given.source)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: without_section(c, "displacement_camera"), "type = 'camera': publishes images: a section displac"),
        (lambda c: c.override("plant_simulator", type="actuator"), "type = 'actuator': publishes joint_states itself"),
        (lambda c: c.override("", time_mode="fused"), "no time to evaluate frames"),
        (lambda c: c.override("plant_simulator", driver="simulated"), r"drives one actuator \(type: actuator\)"),
        (lambda c: c.override("displacement_camera", sample_rate=30.0), "displacement_camera: sample_rate"),
        (lambda c: c.override("plant_simulator", camera__zero=500.0), "must lie within the frame of width = 128 px"),
        (lambda c: c.override("displacement_camera", calibration__scale=0.0), "scale = 0.0: out of range"),
    ],
)
def test_what_does_not_fit_together_is_named(change, words):
    with pytest.raises((ConfigurationError, ParameterError), match=words):
        AxisParameters.from_configuration(change(configuration()))


@pytest.mark.slow
def test_the_file_that_comes_with_the_package_sees_to_0_02_pixel_one_frame_late():
    given = AxisParameters.from_configuration(load_configuration("auwal2017_camera"))
    made = Axis(given).run(np.zeros(60))
    off = (made["measured"][1:] - made["displacement"][:-1]) / given.plant_simulator.camera.scale
    assert np.ptp(made["displacement"]) > 1.0e-6 and np.sqrt(np.mean(off**2)) <= 0.02
