# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A fused axis with a full disk, and with many changes at once."""

from __future__ import annotations

import resource
import signal

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from steered_support import (  # noqa: E402
    COMPENSATOR,
    CONTROLLER,
    PLANT,
    Steered,
    assert_tame,
    at_random,
    tame,
)
from waiting import until  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.reach import axes  # noqa: E402
from hysteresis_ros.loop.simulation import differences  # noqa: E402
from hysteresis_ros.models.block import COMPILED  # noqa: E402
from hysteresis_ros.recordings.files import load_run  # noqa: E402

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba the fused loop is too slow for this axis")

#: Largest file of a process whose disk is nearly full [KiB].
ROOM = 4096


def test_changes_at_random_leave_voltages_within_limits_and_are_repeated_bit_for_bit(processes, observer, tmp_path):
    steered = tame(processes, observer, tmp_path)
    at_random(steered, observer, 30, np.random.default_rng(1))
    for node in (PLANT, CONTROLLER, COMPENSATOR):
        assert observer.trigger(f"/{node}/start").success
    steered.ask(8e-6)
    until(lambda: steered.now("displacement") > 6e-6, what="an axis far from rest")
    for node in (CONTROLLER, COMPENSATOR):  # without the other parts they would cause a jump
        answer = observer.trigger(f"/{node}/reset")
        assert not answer.success and "the axis is running" in answer.message
    assert observer.trigger(f"/{PLANT}/reset").success
    steered.ask(5e-6)
    until(lambda: steered.now("displacement") > 3e-6, what="an axis that goes on after a reset")
    assert "equal the offline twin bit for bit, none missing" in steered.verified()
    assert assert_tame(steered) > 300


def test_a_full_disk_ends_the_recording_and_never_the_axis_and_leaves_what_was_written(processes, observer, tmp_path):
    steered = Steered(processes, observer, tmp_path)
    for process in psutil.Process(steered.run.popen.pid).children(recursive=True):
        # for a writing process, a limit on the file size is like a full disk
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (ROOM * 1024, ROOM * 1024))
    steered.ask(5e-6)
    until(lambda: "cannot be written" in steered.run.output, what="a recording that ends")
    for setpoint in (2e-6, 7e-6):
        steered.ask(setpoint)
        steered.at(setpoint)
    code, _ = steered.run.leave(signal.SIGINT)
    output = steered.run.output
    assert code == 1 and "it ends before the run" in output and "Traceback" not in output, output
    assert abs(steered.now("voltage")) < 0.01  # went to safe before the exit
    run = load_run(steered.bag, further=True)
    assert differences(run, axes(load_configuration(tmp_path / "axis.yaml"))[0]) == {}
    assert run.metadata["missing_samples"] == 0
    # one piece did not fit; about ten pieces fill this disk
    written = max(path.stat().st_size for path in steered.bag.glob("*.mcap"))
    assert written > 0.75 * ROOM * 1024
