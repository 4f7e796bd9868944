# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Faults in lockstep: nodes give the bits of the offline twin."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import REAL, ROOT, SINE, RecordedRun, axis_parameters, shortened, write_axis  # noqa: E402

from hysteresis_ros.loop.faults import FAULTS  # noqa: E402
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, RUNNING, STALE, STOPPED, TRIPPED  # noqa: E402
from hysteresis_ros.signals import ACTUATOR  # noqa: E402

RATE = 3000.0
NODES = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
#: Time-outs of a few samples, so that a short fault has all its consequences.
QUICK = {
    "plant_simulator": {"voltage_timeout": 6 / RATE, "safe_slew_rate": 6.0e4},
    "motion_controller": {"measurement_timeout": 8 / RATE, "safe_slew_rate": 3.0e-3, "spike_limit": 2.0e-6},
    "hysteresis_compensator": {"command_timeout": 10 / RATE, "safe_slew_rate": 6.0e4},
}


def quick_axis(late_limit: int, **more):
    """Return the noisy axis on a sine, with short time-outs."""
    overrides = {node: REAL.get(node, {}) | QUICK.get(node, {}) for node in (*REAL, *QUICK)}
    overrides["reference_generator"] = REAL["reference_generator"] | SINE
    overrides["plant_simulator"] = overrides["plant_simulator"] | {"late_limit": late_limit}
    return axis_parameters(overrides=overrides, time_mode="lockstep", exit_at_end=True, **more)


def record(processes, tmp_path, path, *options: str):
    """Run, record and verify; return the recording with all fields of ~/state."""
    from hysteresis_ros.recordings.files import load_run

    bag = tmp_path / "bag"
    run = processes.command("up", path, "--rate", "lockstep", "--record", str(bag), "--verify", *options)
    return run, lambda: load_run(bag, further=True)


def fault_options(faults) -> list[str]:
    return [word for fault in faults for word in ("--fault", fault)]


def test_faults_of_a_shipped_configuration_are_verified_bit_for_bit(processes, tmp_path):
    faults = ("stale:0.01:0.01", "spike:0.025:0.01:1e-7", "late:0.035:0.005:3", "drop:0.04:0.01:0.5")
    faults += ("lost_command:0.05:0.003", "late_voltage:0.053:0.006:0.5", "stop:0.06:0.005")
    run, recorded = record(processes, tmp_path, "kim2009", "--processes", "--duration", "0.08", *fault_options(faults))
    assert run.wait() == 0, run.output
    assert "240 samples equal the offline twin bit for bit, none missing" in run.output
    table = recorded()
    names = {signal for node in NODES for signal in ACTUATOR.state(node).values()}
    assert {"seen", "controller_mode", "plant_mode", "late", "tripped"} <= names <= set(table.signals)
    assert np.all(np.isnan(table["seen"][30:60])) and not np.any(np.isnan(table["seen"][60:105]))
    assert {HOLDING, STOPPED} <= set(table["controller_mode"][30:])
    assert set(table["compensator_mode"][150:159]) == {HOLDING}
    assert 0 < table["late"][-1] < 18


def test_faults_of_an_inchworm_are_verified_bit_for_bit(processes, tmp_path):
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.parameters import AxisParameters

    quick = {f"gait__{name}": 1.0e-3 for name in ("release", "grip", "settle")}
    quick |= {f"gait__{name}": 4.0e-3 for name in ("extend", "contract")}
    configuration = load_configuration(ROOT / "config" / "inchworm_travel.yaml")
    schedule = {"setpoints__values": [2.0e-4], "setpoints__times": [2.0e-3]}
    configuration = configuration.override("inchworm_sequencer", **quick, **schedule)
    path = write_axis(tmp_path / "axis.yaml", AxisParameters.from_configuration(configuration))
    faults = fault_options(("lost_grip:0.01:0.02:0.1", "stale:0.035:0.01", "drop:0.05:0.01:0.3"))
    run, recorded = record(processes, tmp_path, path, "--composed", "--duration", "0.07", *faults)
    assert run.wait() == 0, run.output
    assert "equal the offline twin bit for bit, none missing" in run.output
    table = recorded()
    sample = round(0.035 / table.sample_time)
    assert np.all(np.isnan(table["seen"][sample : sample + 50]))
    assert np.max(np.abs(table["slip"])) > 1.0e-7  # without grip the front clamp slips
    assert table["error"][sample + 60] != 0.0 and table["error"][-1] == 0.0


def random_faults(seed: int, windows: int, length: int) -> list[str]:
    """Return one to three faults in each of several windows; the last third of each window is without faults."""
    rng = np.random.default_rng(seed)
    names = [name for name, fault in FAULTS.items() if not fault.motor]
    values = {"spike": 3e-6, "late": 3, "drop": 0.5, "offset": 2e-7, "late_voltage": 0.6}
    found = []
    for window in range(windows):
        for name in rng.choice(names, rng.integers(1, 4), replace=False):
            first = int(rng.integers(0, length // 3))
            samples = int(rng.integers(1, 2 * length // 3 - first + 1))
            value = f":{values[name]}" if name in values else ""
            found.append(f"{name}:{(window * length + first) / RATE:.9g}:{samples / RATE:.9g}{value}")
    return found


def test_a_hundred_random_sequences_of_faults_give_the_bits_of_the_offline_twin(inside, tmp_path):
    """One run; the plant trips sometimes, and is started again some samples later, with or without a measurement."""
    from std_srvs.srv import Trigger

    from hysteresis_ros.loop.simulation import differences

    windows, length = 100, 40
    axis = quick_axis(late_limit=12).with_faults(random_faults(1, windows, length))
    run = RecordedRun(inside, shortened(axis, windows * length), tmp_path / "bag")
    plant, controller = run.plant, run.controller
    finish, step = plant.finish_sample, controller.step

    def start_sometimes(every: int) -> None:
        if plant.part.tripped and plant.sample % every == 0:
            plant._on_start(Trigger.Request(), Trigger.Response())

    plant.finish_sample = lambda: (finish(), start_sometimes(11))
    controller.step = lambda: (start_sometimes(13), step())
    inside.spin()
    recorded = run.result()
    assert differences(recorded, run.axis) == {}
    assert len(recorded) == windows * length
    assert {RUNNING, HOLDING, STALE, STOPPED, TRIPPED, FOLLOWING} == set(recorded["controller_mode"])
    assert {RUNNING, HOLDING, STALE, TRIPPED} == set(recorded["compensator_mode"])
    assert {RUNNING, HOLDING, STALE, TRIPPED} == set(recorded["plant_mode"])
    assert {change["action"] for change in recorded.metadata["changes"]} == {"start"}
    assert len(recorded.metadata["changes"]) > 4
    low, high = axis.plant_simulator.limits.minimum, axis.plant_simulator.limits.maximum
    assert low <= np.min(recorded["plant_voltage"]) and np.max(recorded["plant_voltage"]) <= high
