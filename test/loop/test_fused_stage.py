# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fused loop of a stage: one thread for all axes, whose run equals the offline twin bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from coupled_stages import configured
from fused_support import change, delay
from loop_support import assert_same_bits
from waiting import until

from hysteresis_ros import signals
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.loop.plant import HALTED, PARTNER_LOST
from hysteresis_ros.loop.stage import WITH_STAGE, Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.watch import STALE, STOPPED
from hysteresis_ros.models.block import COMPILED

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba the loop is too slow for a stage")

#: Both axes move, and every matrix changes if its axes are exchanged.
MOVING = {
    "every": {"time_mode": "fused"},
    "plant_simulator": {"late_limit": -1},
    "stage": {"sensor_matrix": [1.0, 0.02, -0.01, 1.0], "decoupling": [1.0, -0.05, -0.03, 1.0]},
    "x__reference_generator": {"waveform__type": "sine", "waveform__frequency": 100.0, "waveform__amplitude": 2e-6},
    "y__reference_generator": {"waveform__type": "sine", "waveform__frequency": 60.0, "waveform__amplitude": 3e-6},
}
#: Real-time factor that a busy machine can keep.
SLOWLY = 0.05


class Running:
    """A fused stage and readers of its axes from the first sample on."""

    def __init__(self, factor: float, samples: int = 0, faults: tuple[str, ...] = (), **overrides):
        parameters = StageParameters.from_configuration(configured(**(MOVING | overrides)))
        self.parameters = parameters.with_faults("x", faults)
        self.stage = Stage(self.parameters)
        self.loop = FusedLoop(self.stage, factor, samples)
        self._readers = [self.loop.reader(place) for place in range(len(self.stage.axes))]
        self._pieces: list = [[] for _ in self._readers]

    def look(self) -> None:
        """Read all samples so far."""
        for reader, pieces in zip(self._readers, self._pieces, strict=True):
            taken = reader.take()
            assert not taken.lost
            pieces.append(taken.table)

    def await_samples(self, count: int) -> None:
        """Wait for a number of further samples."""
        first = self.loop.sample
        until(lambda: self.loop.sample >= first + count or self.loop.failure)
        self.look()

    def end(self) -> dict[str, dict[str, np.ndarray]]:
        """End the run, and return the signals of each axis, compared with those of the offline twin."""
        self.loop.leave()
        self.look()
        assert not self.loop.failure
        names = [signal.name for signal in signals.ACTUATOR.row]
        made = {
            axis: dict(zip(names, map(np.ascontiguousarray, np.concatenate(pieces, axis=1)), strict=True))
            for axis, pieces in zip(self.stage.names, self._pieces, strict=True)
        }
        setpoints = {axis: one["setpoint"] for axis, one in made.items()}
        changes = {axis: self.loop.changes_of(place) for place, axis in enumerate(self.stage.names)}
        first, *others = made.values()
        assert all(np.array_equal(first["skipped"], other["skipped"]) for other in others)
        twin = Stage(self.parameters).run(setpoints, changes, first["skipped"])
        for axis, one in made.items():
            assert_same_bits(one, twin[axis])
        return made


@pytest.mark.slow
def test_a_run_with_everything_that_can_change_is_repeated_bit_for_bit():
    # a feedforward across the axes without symmetry, whose references begin anew with each stop
    weights = [0.01, -0.03, 0.02, 0.0, -0.02, 0.03, 0.01, -0.02, 0.02, 0.01, -0.04, 0.01, 0.0, 0.02, -0.01, -0.01]
    given = {"feedforward__preview": 2, "feedforward__weights": weights}
    fed = {"motion_controller": {"feedforward__type": "static", "feedforward__preview": 2}}
    one = Running(SLOWLY, stage=MOVING["stage"] | given, **fed)
    loop = one.loop
    loop.start()
    steps = (
        (change("motion_controller", "retune", pid__Ki=1500.0), (0,)),
        (change("motion_controller", "stop"), (1,)),
        (change("motion_controller", "start"), (1,)),
        (change("hysteresis_compensator", "stop"), (0, 1)),
        (change("hysteresis_compensator", "start"), (0, 1)),
        (change("reference_generator", "stop"), (1,)),
        (change("reference_generator", "retune", waveform__type="sine", waveform__amplitude=1e-6), (1,)),
        (change("reference_generator", "start"), (1,)),
        (change("plant_simulator", "halt"), (1,)),
        (change("plant_simulator", "start"), (0, 1)),
        (change("plant_simulator", "reset"), (0, 1)),
    )
    given = []
    for index, (step, places) in enumerate(steps):
        setpoints = {0: 15e-6 + index * 1e-7, 1: 25e-6 - index * 1e-7}
        loop.set_together(setpoints)
        number = loop.apply(step, places)
        given += [(place, number, *step[1:3]) for place in places]
        one.await_samples(8)
    made = one.end()
    log = [(place, entry.sample, *entry[1:3]) for place in (0, 1) for entry in loop.changes_of(place)]
    assert sorted(log) == sorted(given)
    # setpoints of both axes take effect in the same sample
    for index in range(len(steps)):
        begins = [
            np.flatnonzero(made[axis]["setpoint"] == value)[0]
            for axis, value in zip("xy", (15e-6 + index * 1e-7, 25e-6 - index * 1e-7), strict=True)
        ]
        assert begins[0] == begins[1]
    # a stop of one plant stops the other one in the next sample, and both continue together
    halted = {axis: np.flatnonzero(made[axis]["tripped"]) for axis in "xy"}
    assert made["y"]["tripped"][halted["y"][0]] == HALTED and made["x"]["tripped"][halted["x"][0]] == PARTNER_LOST
    assert halted["x"][0] - halted["y"][0] == 1 and halted["x"][-1] == halted["y"][-1] < len(made["x"]["tripped"]) - 8


#: Both plants go to their safe voltage after 50 skipped samples; x then returns at less than its path needs.
CUT = {
    "plant_simulator": {"late_limit": -1, "voltage_timeout": 0.005, "safe_slew_rate": 2000.0},
    "hysteresis_compensator": {"safe_slew_rate": 2000.0},
    "x__reference_generator": {"waveform__type": "triangle", "waveform__frequency": 50.0, "waveform__amplitude": 8e-6},
}


def test_the_recorded_voltage_of_each_axis_is_the_one_that_left_also_where_plants_limit_it():
    """The offline twin of a fused run, within the rounding of converters of 16 bits over 100 V.

    The amplifier of y gives 40 V, and its compensator up to 100 V.
    """
    y = {"waveform__type": "sine", "waveform__frequency": 60.0, "waveform__amplitude": 8e-6}
    given = MOVING | CUT | {"y__plant_simulator": {"limits__maximum": 40.0}, "y__reference_generator": y}
    one = Stage(StageParameters.from_configuration(configured(**given)))
    skipped = np.zeros(3000)
    skipped[1000:1200] = 1.0
    made = one.run({"x": np.full(3000, 20e-6), "y": np.full(3000, 20e-6)}, skipped=skipped)
    for axis, table in made.items():
        np.testing.assert_allclose(table["voltage"], table["plant_voltage"], rtol=0.0, atol=100.0 / 2**16, err_msg=axis)
        held = table["plant_mode"] == STALE
        assert 140 < np.count_nonzero(held) < 160 and np.all(table["saturated"][held] == 1.0)
        assert np.ptp(table["voltage"][1200:]) > 10.0
    at_end = made["y"]["voltage"] >= 40.0 - 1e-9
    assert np.count_nonzero(made["y"]["saturated"][at_end]) > 10
    assert not np.any(made["x"]["saturated"][1:1000]), "an amplifier limits its own axis only"


def test_an_emergency_stop_stops_all_axes_in_the_same_sample():
    one = Running(SLOWLY)
    one.loop.start()
    one.await_samples(20)
    one.loop.halt()
    until(lambda: one.loop.changes_of(1))
    one.await_samples(10)
    made = one.end()
    at = one.loop.changes_of(0)[0].sample
    for place, axis in enumerate("xy"):
        stopped = {(entry.sample, entry.node, entry.action) for entry in one.loop.changes_of(place)}
        assert stopped == {
            (at, "plant_simulator", "halt"),
            (at, "motion_controller", "stop"),
            (at, "hysteresis_compensator", "stop"),
            (at, "reference_generator", "stop"),
        }
        assert np.flatnonzero(made[axis]["tripped"])[0] == at


def test_missed_deadlines_skip_the_same_samples_of_all_axes_and_the_twin_skips_them_too():
    one = Running(SLOWLY)
    one.loop.start()
    one.await_samples(20)
    delay(one.loop, 40)
    until(lambda: one.loop.missed >= 39)
    one.await_samples(10)
    made = one.end()
    skipped = np.flatnonzero(made["x"]["skipped"])
    assert len(skipped) == one.loop.missed
    for axis in "xy":
        np.testing.assert_array_equal(made[axis]["voltage"][skipped], made[axis]["voltage"][skipped - 1])
        assert np.all(np.isnan(made[axis]["seen"][skipped]))


def test_a_lost_measurement_of_one_axis_takes_the_stage_to_safe():
    one = Running(np.inf, 300, ("stale:0.008:0.01",), motion_controller={"measurement_timeout": 0.002})
    one.loop.start()
    one.loop.join()
    made = one.end()
    assert np.array_equal(np.flatnonzero(made["x"]["controller_mode"] == STALE), np.arange(99, 180))
    assert np.array_equal(np.flatnonzero(made["y"]["controller_mode"] == STOPPED), np.arange(100, 181))
    assert WITH_STAGE not in made["y"]["controller_mode"]


def test_a_refused_change_changes_nothing():
    one = Running(SLOWLY)
    one.loop.start()
    with pytest.raises(ParameterError, match="Ki"):
        one.loop.apply(change("motion_controller", "retune", pid__Ki="many"), (1,))
    with pytest.raises(ParameterError, match="only while stopped"):
        one.loop.apply(change("reference_generator", "retune", waveform__type="hold"), (1,))
    one.await_samples(5)
    one.end()
    assert one.loop.changes_of(0) == one.loop.changes_of(1) == []
