# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The example of a stage for trials of commissioning: both forms are the same stage, which keeps its state."""

from __future__ import annotations

import ctypes
import pathlib

import numpy as np
import pytest

from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.registry import driver_of, options_of
from hysteresis_ros.models.block import COMPILED

PATH = pathlib.Path(__file__).resolve().parents[2] / "examples" / "foreign_stage.py"
VOLTAGES = 50.0 + 50.0 * np.sin(np.arange(300) / 20.0)


def opened(*options):
    """Return an open stage."""
    declared = driver_of(str(PATH))
    stage = declared.driver()
    stage.open(options_of(declared, options), 2000.0)
    return stage


def driven(stage):
    """Return the measurement before each voltage."""
    found = []
    for voltage in VOLTAGES:
        found.append(stage.read().positions[0])
        stage.write((voltage,))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="Numba is missing: the stage has no compiled form")
def test_as_machine_code_it_is_the_same_stage():
    expected, stage = driven(opened()), opened()
    compiled = stage.compiled()
    place = ctypes.POINTER(ctypes.c_double)
    read, write = (ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, place)(one) for one in compiled[:2])
    value, found = ctypes.c_double(), []
    for voltage in VOLTAGES:
        assert read(compiled.device, value) == 0
        found.append(value.value)
        assert write(compiled.device, ctypes.c_double(voltage)) == 0
    assert np.array_equal(found, expected) and np.ptp(expected) > 80e-6


def test_it_goes_on_where_it_was_left(tmp_path):
    memory = f"memory={tmp_path / 'stage.npy'}"
    stage = opened(memory, "noise=0")
    driven(stage)
    stage.make_safe()
    stage.close()
    again = opened(memory, "noise=0")
    stage.write((0.0,))
    assert again.read() == stage.read()
    # the same voltages give another path, because the first path began at rest
    assert not np.array_equal(driven(again), driven(opened("noise=0")))
    (tmp_path / "stage.npy").write_bytes(b"nonsense")
    with pytest.raises(DriverError, match="holds no state"):
        opened(memory)


def test_its_polarity_and_unit_are_those_that_are_asked_for():
    plain, turned = driven(opened("noise=0")), driven(opened("noise=0", "polarity=-1", "unit=1e6"))
    assert turned == pytest.approx(-1e6 * plain, rel=1e-12)
