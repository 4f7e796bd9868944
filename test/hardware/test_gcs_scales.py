# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""GCS controllers whose SVA unit is not a volt, and axes that were never referenced."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from gcs_support import serving_stand
from waiting import until

from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.laboratory.emulation.gcs import Session


@pytest.fixture
def controller():
    with serving_stand() as stand:
        yield stand


def sent(stand) -> np.ndarray:
    """Return the values of all received SVA commands."""
    return np.array([float(line.split()[2]) for line in stand.heard if line.startswith("SVA 1")])


def test_where_a_unit_of_sva_is_ten_volts_the_way_to_safe_begins_where_the_output_is(controller):
    """8 units are 80 V; interpreted as 8 V, the first step to safe would lower the output by 70 V."""
    controller.say("SVA 1 8")
    controller.heard.clear()
    device = controller.open(open_loop_scale=10.0, voltage_tolerance=1000.0, safe_voltage=20.0)
    way = sent(controller)[:20]
    moved = np.diff(way, prepend=8.0)
    assert way[-1] == pytest.approx(2.0) and np.all(moved < 0.0)
    np.testing.assert_allclose(moved, (2.0 - 8.0) / 20, atol=1e-6)
    device.write([50.0])
    until(lambda: controller.controller.axes["1"].open_value == pytest.approx(5.0))
    controller.heard.clear()
    device.make_safe()
    way = sent(controller)
    np.testing.assert_allclose(np.diff(way, prepend=5.0), (2.0 - 5.0) / 20, atol=1e-6)
    device.close()


@pytest.mark.parametrize("referenced", [False, True])
def test_an_axis_that_was_never_referenced_is_refused_before_anything_is_commanded(controller, monkeypatch, referenced):
    """The zero of its positions is unknown."""
    answer = Session.answer

    def answered(self, line):
        if line.upper().startswith("FRF?"):
            return [f"1={int(referenced)}"]
        found = answer(self, line)
        if line.upper().startswith("HLP?") and not any(one.startswith("FRF?") for one in found):
            found.insert(-1, "FRF? get reference state")
        return found

    monkeypatch.setattr(Session, "answer", answered)
    controller.heard.clear()
    if referenced:
        controller.open().close()
        assert sent(controller).size
    else:
        with pytest.raises(DriverError, match="has not referenced axis 1; reference it first"), contextlib.ExitStack():
            controller.open()
        assert not sent(controller).size


@pytest.mark.slow
def test_a_voltage_below_what_is_commanded_is_refused_as_one_above_is(controller):
    """An output lowered by another program moves the stage as far as one raised by another program."""
    for other in ("SVA 1 20", "SVA 1 80"):
        device = controller.open()
        for _ in range(5):
            device.write([50.0])
        until(lambda: controller.controller.axes["1"].open_value == 50.0)
        device.read()
        controller.say(other)
        with pytest.raises(DriverError, match=rf"outputs {other.split()[-1]} V, but 50 V are commanded"):
            until(lambda device=device: device.read() is None)
        device.close()


def test_a_wave_that_somebody_has_started_is_stopped_on_the_way_to_safe(controller):
    device = controller.open()
    axis = controller.controller.axes["1"]
    points = " ".join(["10 20"] * 20)
    controller.say(f"WAV 1 X PNT 1 40 {points}\nWSL 1 1\nWGC 1 0\nWGO 1 1")
    assert axis.generating
    device.make_safe()
    assert not axis.generating
    until(lambda: axis.open_value == 0.0)
    device.close()


def test_a_controller_that_counts_in_millimetres_is_sent_the_same_place(controller):
    controller.say("SPA 1 0x07000601 MM")
    controller.heard.clear()
    device = controller.open(mode="servo", servo_scale=2.0e-6, safe_voltage=5.0)
    targets = [float(line.split()[2]) for line in controller.heard if line.startswith("MOV 1")]
    assert targets[-1] == pytest.approx(0.010)
    device.write([20.0])
    until(lambda: device.read()[0] == pytest.approx(40.0e-6, abs=1e-7))
    device.close()
