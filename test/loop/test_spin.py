# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The loop polls the clock ahead of a deadline: for how long, on which cores, and without effect on the samples."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from fused_support import ANY_LATE, SLOWLY, assert_twin, change, made_loop, whole
from loop_support import parameters
from waiting import until

from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop import fused, pacing
from hysteresis_ros.models.block import COMPILED

compiled = pytest.mark.skipif(not COMPILED, reason="without Numba no loop polls the clock")


@pytest.fixture(autouse=True)
def own_claims(monkeypatch, tmp_path):
    """Two cores on which no loop of another test polls the clock; sleep states of the processor are unchanged."""
    monkeypatch.setattr(fused, "CLAIM", f"hysteresis_ros/test/{os.getpid()}")
    monkeypatch.setattr(fused, "usable_cores", lambda: 2)
    monkeypatch.setattr(fused, "_DMA_LATENCY", str(tmp_path / "latency"))


def state_with(**values):
    """Return the state of a loop with these entries."""
    state = np.zeros(pacing.STATES, dtype=np.int64)
    for name, value in values.items():
        state[getattr(pacing, name)] = value
    return state


def spinning(spin, **plant):
    """Return overrides for a loop that polls the clock."""
    return ANY_LATE | {"plant_simulator": ANY_LATE["plant_simulator"] | {"realtime__spin": spin, **plant}}


# ---------------------------------------------------------------------------------------------------- in a run


@compiled
@pytest.mark.parametrize("spin", [1e-3, -1.0])
def test_samples_do_not_depend_on_it(monkeypatch, tmp_path, spin):
    monkeypatch.setattr(fused, "has_priority", lambda: True)
    loop, given = made_loop(factor=SLOWLY, **spinning(spin))
    loop.set(setpoint=5e-6)
    loop.start()
    until(lambda: loop.sample > 5)
    loop.apply(change("motion_controller", "retune", handover_time=0.01))
    loop.set(setpoint=4e-6)
    until(lambda: loop.sample > 15)
    loop.leave()
    made = whole(loop)
    assert_twin(loop, made, given)
    found = loop.lateness()
    assert found.looked > 0.0 and (found.ahead == spin if spin > 0.0 else 0.0 <= found.ahead <= 1e-4)
    assert (tmp_path / "latency").read_bytes() == bytes(4)


@compiled
@pytest.mark.parametrize(("spin", "priority", "cores"), [(0.0, True, 2), (-1.0, False, 2), (-1.0, True, 1)])
def test_where_it_is_off_or_no_core_is_to_spare_the_loop_sleeps(monkeypatch, tmp_path, spin, priority, cores):
    monkeypatch.setattr(fused, "has_priority", lambda: priority)
    monkeypatch.setattr(fused, "usable_cores", lambda: cores)
    loop, _ = made_loop(factor=SLOWLY, samples=3, **spinning(spin))
    loop.start()
    loop.join()
    assert loop.lateness().ahead == loop.lateness().looked == 0.0
    assert not (tmp_path / "latency").exists()


@compiled
def test_the_core_is_free_again_when_the_loop_ends(monkeypatch):
    loop, _ = made_loop(factor=1e-3, **spinning(1e-3))
    loop.start()
    until(lambda: loop.lateness().ahead > 0.0)
    with pytest.raises(ConfigurationError, match="other loops poll the clock on all but one of the 2 cores"):
        fused.require_spin(1e-3)
    loop.leave()
    fused.require_spin(1e-3)


# ---------------------------------------------------------------------------------------------------- how long


@pytest.mark.parametrize("longest", [40e3, 400e3])
def test_the_time_ahead_settles_at_a_high_quantile_of_the_wake_up_times(longest):
    state = state_with(MOST_AHEAD=10**9, WAKE=pacing.FIRST_WAKE)
    for wake in np.random.default_rng(1).uniform(0.0, longest, 100_000).astype(int):
        pacing.note_wake(state, wake)
    assert state[pacing.AHEAD] == pytest.approx(0.98 * longest, rel=0.02)


def test_the_time_ahead_leaves_a_part_of_the_core_to_the_system():
    state = state_with(MOST_AHEAD=12_000, WAKE=50_000, BUSY=4_000 * 10, HEAD=10)
    pacing.note_wake(state, 60_000)
    assert state[pacing.AHEAD] == 8_000  # minus the computing time of a sample
    state[pacing.BUSY] = 20_000 * 10
    pacing.note_wake(state, 60_000)
    assert state[pacing.AHEAD] == 0


def test_a_fixed_time_does_not_follow():
    state = state_with(AHEAD=7_000)
    pacing.note_wake(state, 60_000)
    assert state[pacing.AHEAD] == 7_000


# ---------------------------------------------------------------------------------------------------- waiting


class Machine:
    """A clock that advances by 10 ns when it is polled, and a sleep with a wake-up time of 3 µs."""

    def __init__(self, monkeypatch):
        self.now, self.slept = 0, []
        monkeypatch.setattr(pacing, "clock", self.clock)
        monkeypatch.setattr(pacing, "sleep_until", self.sleep_until)

    def clock(self, timespec):
        """Return the time [ns]."""
        self.now += 10
        return self.now

    def sleep_until(self, timespec, instant):
        """Sleep."""
        self.slept.append(instant)
        self.now = instant + 3_000


@pytest.mark.parametrize(
    ("ahead", "slept", "begun"), [(0, 50_000, 53_010), (2_000, 48_000, 51_010), (9_000, 41_000, 50_000)]
)
def test_it_sleeps_first_and_then_looks_until_the_deadline(monkeypatch, ahead, slept, begun):
    machine, state = Machine(monkeypatch), state_with(AHEAD=ahead)
    assert pacing.await_deadline(state, None, 50_000) == begun
    assert machine.slept == [slept] and state[pacing.LOOKED] == max(begun - slept - 3_010, 0)


def test_a_wake_up_is_measured_when_it_was_the_last_before_the_deadline(monkeypatch):
    machine, state = Machine(monkeypatch), state_with(AHEAD=9_000, MOST_AHEAD=10**6, WAKE=9_000)
    pacing.await_deadline(state, None, 2 * pacing.PIECE)
    assert len(machine.slept) == 2 and state[pacing.WAKE] == state[pacing.AHEAD] == 9_000 - pacing.SHORTER


@pytest.mark.parametrize("request_", ["LEAVE", "PAUSE"])
def test_it_stops_looking_when_the_end_or_a_pause_is_requested(monkeypatch, request_):
    machine, state = Machine(monkeypatch), state_with(AHEAD=10**12, **{request_: 1})
    assert pacing.await_deadline(state, None, 10**6) == 10 and not machine.slept


# ---------------------------------------------------------------------------------------------------- wrong input


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"usable_cores": lambda: 1}, "a single core, on which the nodes wait"),
        ({"COMPILED": False}, "without Numba"),
        ({"claim_of_a_core": lambda: None}, "the nodes need that one"),
    ],
)
def test_a_time_is_refused_where_the_nodes_need_the_core(monkeypatch, changed, words):
    for name, value in changed.items():
        monkeypatch.setattr(fused, name, value)
    with pytest.raises(ConfigurationError) as refused:
        fused.require_spin(6e-5)
    assert words in str(refused.value) and str(refused.value).startswith("realtime.spin = 6e-05 s: ")
    assert "give 0 (off) or -1 (automatic, off here)" in str(refused.value)
    fused.require_spin(-1.0)
    fused.require_spin(0.0)


def test_a_time_that_takes_the_whole_core_is_refused_unless_it_is_forced():
    plant = parameters().plant_simulator
    plant = replace(plant, time_mode="fused", realtime=replace(plant.realtime, spin=2.1e-4))
    with pytest.raises(ParameterError) as refused:
        plant.validated()
    text = str(refused.value)
    assert "realtime.spin = 0.00021 s" in text and "at most 0.6 of a period, 0.0002 s" in text
    replace(plant, realtime=replace(plant.realtime, force=True)).validated()
    replace(plant, real_time_factor=0.5).validated()
    replace(plant, time_mode="lockstep").validated()


def test_a_processor_whose_sleep_may_not_be_limited_is_left_alone(monkeypatch, tmp_path):
    monkeypatch.setattr(fused, "_DMA_LATENCY", str(tmp_path / "nowhere" / "latency"))
    with fused.shallow_sleep() as held:
        assert not held
