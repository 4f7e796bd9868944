# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Evaluation of a campaign: figures of a trace, and violated claims."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hysteresis_ros.configuration import config_path, load_configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.campaign.judging import (
    Bounds,
    Samples,
    Trace,
    bounds_of,
    judged,
    largest_step,
    prepared,
    time_to_safe,
    worst,
)
from hysteresis_ros.laboratory.campaign.mishaps import CATALOGUE, DEVICE, FUSED, WAYS, Mishap, chosen, chosen_ways
from hysteresis_ros.laboratory.campaign.results import Results, conditions, line, load_results, page

#: 0 … 10 V, 0.1 V per sample of 1 ms, displacements of 0 … 100 µm.
BOUNDS = Bounds(
    0.0, 10.0, 0.0, 0.1, 1e-3, 20e-6, 80e-6, 100e-6, dict.fromkeys(("measurement", "command", "voltage"), 0.5), 0.15
)
MISHAP = Mishap("drop", "Machine", "it falls", "it is safe", "drop", safe="command")
#: 1.5 s: 5 V, from 0.2 s on down to 0 at the slew rate; the fault begins at 0.1 s and ends at 1 s.
TIMES = np.arange(1500) * 1e-3


def samples(voltage=None, **other) -> Samples:
    voltage = np.clip(5.0 - 0.1 * np.arange(-200, 1300), 0.0, 5.0) if voltage is None else voltage
    columns = {"time": TIMES, "stamp": TIMES, "displacement": 1e-5 * voltage, "life": np.zeros(TIMES.size)} | other
    return Samples(voltage=voltage, **columns)


def trace(seen=None, **other) -> Trace:
    seen = samples() if seen is None else seen
    made = Trace("drop", FUSED, 0.0, 1.5, 0.1, 1.0, 1.4, (0.0, 5e-5), seen, said="controller: late")
    return replace(made, **other)


def failures(**other) -> str:
    return " / ".join(judged(trace(**other), MISHAP, BOUNDS).failures)


def test_a_return_at_the_slew_rate_holds_and_its_time_is_that_until_the_last_unsafe_sample():
    verdict = judged(trace(), MISHAP, BOUNDS)
    assert verdict.failures == ()
    # safe means within 1 % of the range, 0.1 V: from 5 V at 0.2 s this takes 49 steps
    assert verdict.figures.safe == pytest.approx(0.2 + 0.049 - 0.1, abs=1.5e-3)
    assert verdict.figures.recovery == pytest.approx(0.4)
    assert verdict.figures.step == pytest.approx(1.0)
    assert (verdict.figures.lowest, verdict.figures.highest, verdict.figures.beyond) == (0.0, 5.0, 0.0)


def test_one_step_that_is_too_large_is_found_wherever_it_is():
    voltage = samples().voltage.copy()
    voltage[700] += 0.11
    assert "1.1 times the allowed one" in failures(seen=samples(voltage))


def test_missing_samples_allow_as_many_steps_as_their_stamps_say():
    voltage = np.array([0.0, 0.1, 0.4, 0.5])
    seen = Samples(np.arange(4.0), np.array([0.0, 1.0, 4.0, 5.0]) * 1e-3, voltage, voltage, np.zeros(4))
    assert largest_step(seen, BOUNDS) == pytest.approx(1.0)
    assert largest_step(replace(seen, stamp=np.arange(4) * 1e-3), BOUNDS) == pytest.approx(3.0)


def test_a_sample_in_which_a_device_stalls_takes_as_long_as_it_is_seen_to():
    seen = Samples(
        np.array([0.0, 0.001, 0.031]), np.arange(3) * 1e-3, np.array([0.0, 0.0, 3.0]), np.zeros(3), np.zeros(3)
    )
    assert largest_step(seen, BOUNDS) == pytest.approx(30.0)
    assert largest_step(seen, BOUNDS, stalls=True) == pytest.approx(1.0)
    for graph, step in ((MISHAP.graph, 30.0), (DEVICE, 1.0)):  # the samples of a simulated plant do not stall
        assert judged(trace(seen), replace(MISHAP, graph=graph), BOUNDS).figures.step == pytest.approx(step)


def test_a_plant_that_begins_again_knows_nothing_of_the_voltage_before():
    voltage, life = np.where(TIMES < 0.7, 5.0, 0.0), (TIMES >= 0.7).astype(float)
    assert largest_step(samples(voltage), BOUNDS) == pytest.approx(50.0)
    assert largest_step(samples(voltage, life=life), BOUNDS) == 0.0


@pytest.mark.parametrize("voltage", [-1e-3, 10.001])
def test_a_voltage_beyond_the_limits_is_not_held(voltage):
    assert "exceed 0 … 10 V" in failures(seen=samples(np.full(1500, voltage)))
    assert "leave" not in failures(seen=samples(np.full(1500, min(max(voltage, 0.0), 10.0))))


def test_a_voltage_that_becomes_safe_too_late_or_not_for_good_is_not_held():
    slow = np.where(TIMES < 0.7, 5.0, 0.0)
    assert "safe after 0.6 s, at most 0.5 s is allowed" in failures(seen=samples(slow))
    assert time_to_safe(samples(np.where(TIMES == 0.9, 1.0, 0.0)), 0.1, 1.0, BOUNDS) == pytest.approx(0.801)
    assert time_to_safe(samples(np.full(1500, 5.0)), 0.1, 1.0, BOUNDS) == math.inf
    unasked = judged(trace(samples(np.full(1500, 5.0))), replace(MISHAP, safe=""), BOUNDS)
    assert unasked.failures == () and math.isnan(unasked.figures.safe)


def test_a_displacement_beyond_what_was_asked_for_is_not_held_where_it_is_bounded():
    seen = samples(displacement=np.where(TIMES == 0.5, -1.6e-5, 0.0))
    assert "setpoints by 16 % of the stroke" in failures(seen=seen)
    assert judged(trace(seen), replace(MISHAP, bounded=False), BOUNDS).failures == ()
    assert "exceeds the setpoints" not in failures(seen=samples(displacement=np.where(TIMES == 0.5, -1.4e-5, 0.0)))
    assert "exceeds the setpoints" not in failures(seen=samples(displacement=np.full(1500, np.nan)))
    unknown = np.where(TIMES > 0.5, np.nan, 6.6e-5)  # if a device reports a position, it counts
    assert "setpoints by 16 % of the stroke" in failures(seen=samples(displacement=unknown))


def test_what_is_broken_what_was_not_seen_and_what_does_not_recover_is_not_held():
    assert "a traceback is printed" in failures(broken=("a traceback is printed",))
    assert "does not follow" in failures(recovered=math.nan)
    assert "no samples of the plant" in failures(seen=Samples.of(()))


def test_a_recording_takes_the_place_of_what_was_seen_within_the_time_of_the_mishap():
    replaced = trace(Samples.of(())).with_samples(samples())
    assert replaced.samples.time[0] == pytest.approx(0.1) and abs(replaced.samples.time[-1] - 1.4) < 1.5e-3
    assert trace(recovered=math.nan).with_samples(samples()).samples.time[-1] == TIMES[-1]


def test_the_page_has_a_row_for_each_mishap_with_the_worst_figures_of_each_way(tmp_path):
    good, bad = judged(trace(), MISHAP, BOUNDS), judged(trace(recovered=math.nan, way="composed"), MISHAP, BOUNDS)
    late = judged(trace(recovered=1.9), MISHAP, BOUNDS)
    assert worst([good, late]).recovery == pytest.approx(0.9)
    mishap = replace(MISHAP, ways=("fused", "composed"), elsewhere="it cannot fall")
    earlier = Results("stage", (bad,), conditions(), conditions())
    earlier.save(tmp_path / "earlier.json")
    results = Results("stage", (good, late), conditions(), conditions()).and_of(load_results(tmp_path / "earlier.json"))
    text = page([mishap], WAYS, results)
    row = next(row for row in text.splitlines() if row.startswith("| **drop**"))
    _, _, fused, composed, processes = (cell.strip() for cell in row.strip("| ").split(" | "))
    assert fused.startswith("held: 0 … 5 V, step 1.00, safe after 0.15 s, back after 0.9 s") and "late" in fused
    assert composed.startswith("**not held, 1 of 1**: the axis does not follow")
    assert processes == "does not apply: it cannot fall"
    with pytest.raises(ConfigurationError, match="the results to add are of another"):
        results.and_of(replace(earlier, config="another"))
    assert "NOT HELD" in line(bad) and "NOT HELD" not in line(good)


@pytest.mark.parametrize(("config", "way", "factor"), [("picma_stage", "processes", 1.0), ("kim2009", "composed", 0.1)])
def test_the_axis_of_a_campaign_is_simulated_holds_setpoints_and_has_a_slew_rate(config, way, factor):
    configuration = load_configuration(config_path(config)).override("plant_simulator", driver="gcs")
    axis = prepared(configuration, way, "/faults")
    plant, bounds = axis.plant_simulator, bounds_of(axis)
    assert (plant.driver, plant.time_mode, axis.namespace) == ("", "realtime", "/faults")
    assert axis.reference_generator.waveform.type == "hold"
    assert plant.real_time_factor == pytest.approx(factor)
    crossing = (bounds.maximum - bounds.minimum) / plant.limits.slew_rate
    assert crossing == pytest.approx(0.25) and axis.hysteresis_compensator.limits.slew_rate == plant.limits.slew_rate
    # the waiting time and the return, in wall time
    least = (plant.voltage_timeout + (bounds.maximum - bounds.minimum) / plant.safe_slew_rate) / factor
    assert least <= bounds.timeouts["voltage"] <= least + 1.0
    # 20 of 200 samples per second, or 150 of 3000, may be late before it trips
    assert bounds.beyond == pytest.approx(0.1 + {"picma_stage": 0.1, "kim2009": 0.05}[config] / crossing)


def test_every_mishap_can_be_chosen_by_its_name_or_group_and_what_is_none_is_refused():
    assert [mishap.name for mishap in chosen(())] == list(CATALOGUE)
    assert chosen(("kill all",)) == (CATALOGUE["kill all"],)
    assert {mishap.group for mishap in chosen(("Machine",))} == {"Machine"}
    with pytest.raises(ConfigurationError, match="no fault case 'kil all'; did you mean kill all"):
        chosen(("kil all",))
    assert chosen_ways("fused, processes") == ["fused", "processes"]
    with pytest.raises(ConfigurationError, match="no way 'fusd'; did you mean fused"):
        chosen_ways("fusd")
    with pytest.raises(ConfigurationError, match="--ways: name at least one of"):
        chosen_ways(" , ")
    for mishap in CATALOGUE.values():
        assert set(mishap.ways) <= set(WAYS) and bool(mishap.elsewhere) == (set(mishap.ways) != set(WAYS))
