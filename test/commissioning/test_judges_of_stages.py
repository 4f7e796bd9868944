# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the stages refuse: too large gains, distant zeros, tripped axes; each compared with an accepted case."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from commissioning_support import sitting

from hysteresis_ros.cli.commissioning import bench as benches
from hysteresis_ros.cli.commissioning import closed_loop as closed
from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.bench import require_sound
from hysteresis_ros.cli.commissioning.closed_loop import (
    JUDGED_PERIODS,
    STEP_HOLD,
    STEP_WAY,
    UNJUDGED_PERIODS,
    closed_axis,
    judged_samples,
    learned_line,
    not_learned,
    scan_begin,
    scan_period,
    scan_reference,
    steps_reference,
)
from hysteresis_ros.cli.commissioning.fitting import MOVED, excited
from hysteresis_ros.cli.commissioning.measuring import judge_gain, judge_hysteresis, judge_noise
from hysteresis_ros.cli.commissioning.situation import CommissioningError, Folder, Outcome
from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.control.margins import MeasuredLoop
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.recordings.dataset import Recording

#: Expected values of the new axis: 100 µm over 100 V, at 2 kHz.
RATE, GAIN = 2000.0, 1e-6
NOISE = 3e-9


def recorded(voltage, gain=GAIN, zero=0.0, **more) -> Recording:
    """Return the recording of a stage without memory under given voltages."""
    random = np.random.default_rng(1)
    measured = zero + gain * voltage + NOISE * random.standard_normal(voltage.size)
    return Recording(
        np.arange(voltage.size) / RATE, {"reference": GAIN * voltage, "voltage": voltage, "measured": measured, **more}
    )


@pytest.fixture
def situation(tmp_path):
    found = sitting(tmp_path)
    found.found["noise"] = Outcome(["quiet"], {"noise_rms_m": NOISE, "sensor_zero_m": 0.0})
    return found


@pytest.mark.parametrize("factor", [0.1, 0.32, 0.4, 1.0, 2.5, 3.3, 10.0])
def test_a_gain_may_be_off_by_a_factor_of_three_to_both_sides(situation, factor):
    step = recorded(volts.small_step(situation.plan, 0.0, RATE), factor * GAIN)
    if 1.0 / 3.0 < factor < 3.0:
        assert judge_gain(situation, step).figures["gain_m_per_v"] == pytest.approx(factor * GAIN, rel=0.01)
    else:
        with pytest.raises(CommissioningError, match="the gain is .* µm/V, but 1 µm/V were expected"):
            judge_gain(situation, step)


def test_without_noise_the_gain_is_exact(situation):
    """Voltage and displacement are compared over the same samples."""
    step = recorded(volts.small_step(situation.plan, 0.0, RATE))
    step.signals["measured"] = GAIN * step["voltage"]
    found = judge_gain(situation, step)
    assert found.figures["gain_m_per_v"] == pytest.approx(GAIN, rel=1e-12)
    assert found.lines == ["+5 V moved the stage by 5 µm: 1 µm/V, the sign is right"]
    measured, scaled = found.pictures[0].lines
    assert max(measured.y) == max(scaled.y) == pytest.approx(5.0), "µm"


@pytest.mark.parametrize("size", [0.3, 0.4])
def test_a_stage_that_still_moves_after_the_step_does_not_settle(situation, size):
    """A quarter of the step is allowed as RMS of what is left, so 0.35 of it as the amplitude of an oscillation."""
    step = recorded(volts.small_step(situation.plan, 0.0, RATE))
    moved = GAIN * volts.step_size(situation.plan, 0.0)
    ringing = np.where(step["voltage"] > 0.0, size * moved * np.sin(2.0 * np.pi * 40.0 * step.time), 0.0)
    step.signals["measured"] = step["measured"] + ringing
    if size < 0.35:
        assert judge_gain(situation, step).figures["gain_m_per_v"] == pytest.approx(GAIN, rel=0.01)
    else:
        with pytest.raises(CommissioningError, match=r"does not settle after a step of \+5 V: .* µm RMS"):
            judge_gain(situation, step)


@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-100.0, 0.0)])
def test_a_reversed_sign_is_refused_whichever_way_the_step_goes(situation, low, high):
    situation.plan = replace(situation.plan, minimum=low, maximum=high)
    voltages = volts.small_step(situation.plan, 0.0, RATE)
    assert judge_gain(situation, recorded(voltages)).figures["gain_m_per_v"] == pytest.approx(GAIN, rel=0.01)
    with pytest.raises(CommissioningError, match="the sign is reversed"):
        judge_gain(situation, recorded(voltages, -GAIN))


def test_a_steady_drift_after_the_step_is_creep_and_no_oscillation(situation):
    """In the second half of the hold the stage drifts by the size of the step, and stays in the middle at the step."""
    step = recorded(volts.small_step(situation.plan, 0.0, RATE))
    held = round(volts.STEP_HOLD * RATE)
    end = 2 * held + round(volts.STEP_WAY * RATE)
    drift = GAIN * volts.step_size(situation.plan, 0.0) * np.linspace(-0.5, 0.5, held // 2)
    step.signals["measured"][end - held // 2 : end] += drift
    assert judge_gain(situation, step).figures["gain_m_per_v"] == pytest.approx(GAIN, rel=0.01)


@pytest.mark.parametrize(("low", "high", "words"), [(20e-6, 1.0, "lowest reading of 20"), (-1.0, 8e-5, "highest")])
def test_a_sensor_whose_range_ends_within_that_of_the_stack_is_refused(situation, low, high, words):
    cycles = recorded(volts.decaying_cycles(situation.plan, 0.0, RATE))
    judge_hysteresis(situation, cycles)
    cycles.signals["measured"] = np.clip(cycles["measured"], low, high)
    with pytest.raises(CommissioningError, match=f"the sensor stays at its {words}"):
        judge_hysteresis(situation, cycles)


@pytest.mark.parametrize(("share", "clips"), [(0.015, False), (0.025, True)])
@pytest.mark.parametrize("upper", [True, False])
def test_a_sensor_may_stay_where_the_voltage_does_within_2_percent_of_its_end(situation, share, clips, upper):
    plan = situation.plan
    held = plan.maximum - share * plan.span if upper else plan.minimum + share * plan.span
    voltage = np.clip(volts.decaying_cycles(plan, 0.0, RATE), *((-np.inf, held) if upper else (held, np.inf)))
    cycles = recorded(np.concatenate([voltage, np.full(voltage.size // 10, held)]))
    cycles.signals["measured"] = GAIN * cycles["voltage"]
    if clips:
        with pytest.raises(CommissioningError, match="the sensor stays at its"):
            judge_hysteresis(situation, cycles)
    else:
        assert judge_hysteresis(situation, cycles).figures["stroke_m"] == pytest.approx(1e-4, rel=0.03)


def test_the_response_is_that_of_the_periods_after_the_first_one(situation):
    """In the first period the stage still settles, here from 10 µm beside."""
    period = round(volts.PERIOD * RATE)
    phases = np.exp(2j * np.pi * np.random.default_rng(2).uniform(size=period // 2 + 1))
    one = np.fft.irfft(20.0 * phases)
    rest = np.zeros(round((volts.REST + volts.WAY) * RATE))
    sines = recorded(np.concatenate([rest, np.tile(one, volts.PERIODS), rest]))
    steady, length = volts.steady_periods(situation, sines)
    assert length == period and steady.stop - steady.start == 4 * period
    since = (np.arange(len(sines)) - steady.start + period) / RATE
    sines.signals["measured"] = sines["measured"] + np.where(since >= 0.0, 1e-5 * np.exp(-since / 0.1), 0.0)
    found = volts.judge_resonance(situation, sines)
    assert found.figures["gain_m_per_v"] == pytest.approx(GAIN, rel=1e-3)


def test_the_damping_is_that_of_the_whole_peak_and_not_of_the_noise_at_its_top():
    """The lines of a long period are so close that the peak of 2 % at 310 Hz hardly falls over a few of them."""
    frequency, damping, period, rate = 310.0, 0.02, 8000, 2000.0
    draw = np.random.default_rng(5)
    one = np.zeros(period // 2 + 1, complex)
    one[1 : int(volts.EXCITED * period)] = np.exp(2j * np.pi * draw.uniform(size=int(volts.EXCITED * period) - 1))
    f = np.fft.rfftfreq(period, 1.0 / rate)
    mode = GAIN / (1.0 - (f / frequency) ** 2 + 2j * damping * f / frequency)
    voltage, moved = np.fft.irfft(period * one), np.fft.irfft(period * one * mode)
    measured = np.tile(moved, 4) + draw.normal(0.0, 0.2 * np.std(moved), 4 * period)
    outcome = volts.response_outcome(np.tile(voltage, 4), measured, rate, period)
    found = outcome.figures
    # in its picture the noise of the mean over the periods has its own size, at the frequencies of the response
    response, noise = outcome.pictures[0].lines
    assert response.x == noise.x and min(noise.x) > 0.0 and max(noise.x) <= volts.EXCITED * rate
    excited = np.abs(np.fft.rfft(voltage))[1 : int(volts.EXCITED * period) - 1]
    level = 1e6 * 0.2 * np.std(moved) * np.sqrt(period / 4.0) / np.median(excited)
    assert np.median(noise.y) == pytest.approx(level, rel=0.3)
    assert found["resonance_hz"] == pytest.approx(frequency, rel=2e-3)
    assert found["damping"] == pytest.approx(damping, rel=0.1)


@pytest.mark.parametrize("damping", [0.005, 0.015, 0.05])
@pytest.mark.parametrize("scatter", [0.15, 0.3])
def test_the_damping_is_not_that_of_a_line_that_hysteresis_raises_above_the_peak(damping, scatter):
    """The deviations repeat in each period, so they are no noise; the half-power band of such a line ends beside it."""
    frequency, period, rate = 700.0, 8000, 2000.0
    draw = np.random.default_rng(7)
    lines = int(volts.EXCITED * period)
    one, deviation = np.zeros(period // 2 + 1, complex), np.zeros(period // 2 + 1, complex)
    one[1:lines] = np.exp(2j * np.pi * draw.uniform(size=lines - 1))
    deviation[1:lines] = draw.normal(0.0, scatter / np.sqrt(2.0), (lines - 1, 2)) @ [1.0, 1.0j]
    f = np.fft.rfftfreq(period, 1.0 / rate)
    mode = GAIN * (1.0 + deviation) / (1.0 - (f / frequency) ** 2 + 2j * damping * f / frequency)
    mode[f < 10.0] *= 1.3  # creep
    voltage, moved = np.fft.irfft(period * one), np.fft.irfft(period * one * mode)
    found = volts.response_outcome(np.tile(voltage, 4), np.tile(moved, 4), rate, period).figures
    assert found["resonance_hz"] == pytest.approx(frequency, rel=0.1 * damping)
    assert found["damping"] == pytest.approx(damping, rel=0.15)
    assert found["gain_m_per_v"] == pytest.approx(GAIN, rel=0.1)


@pytest.mark.parametrize(
    ("left", "expected", "settles"),
    [(5e-7, 1e-7, True), (7e-7, 1e-7, False), (4.8e-8, 1e-9, True), (5.2e-8, 1e-9, False)],
)
@pytest.mark.parametrize(("step", "low"), [(0, 0.0), (1, -0.4), (2, 0.0)])
def test_a_loop_settles_if_little_is_left_after_each_step(situation, monkeypatch, step, low, left, expected, settles):
    """Six times the error of the simulation are allowed, and 5 % of the first step, here 50 nm of 1 µm.

    The steps lie between rest and the farther end: a range on the other side of rest changes nothing.
    """
    held, length = round(STEP_HOLD * RATE), round((STEP_HOLD + STEP_WAY) * RATE)
    end = 3 * held + (step + 1) * length
    error = np.zeros(4 * held + len(closed.STEPS) * length)
    error[end - held : end] = 10.0 * left  # what is left is that of the last fifth of the hold
    error[end - held // 5 : end] = left
    errors = iter((error, np.full(error.size, expected)))
    reach = 1e-6 / (closed.STEPS[0] - closed.FIRST_STEP)
    monkeypatch.setattr(closed, "designed", lambda situation: situation.configuration)
    monkeypatch.setattr(closed, "loop_axis", lambda situation: None)
    monkeypatch.setattr(closed, "simulate", lambda axis: None)
    monkeypatch.setattr(closed, "error_of", lambda *run: next(errors))
    monkeypatch.setattr(closed, "_reach", lambda *given: (low * reach, reach))
    run = recorded(np.zeros(error.size))
    if settles:
        found = closed.judge_loop(situation, run)
        assert found.figures == pytest.approx({"rest_rms_m": left, "predicted_rest_rms_m": expected})
        assert found.lines == [f"settles: error {1e9 * left:.3g} nm RMS, predicted {1e9 * expected:.3g} nm"]
    else:
        with pytest.raises(CommissioningError, match="the closed loop does not settle: the error after a step of 1 µm"):
            closed.judge_loop(situation, run)


@pytest.mark.parametrize("factor", [0.3, 0.5, 1.0, 2.0, 3.5])
def test_so_may_the_stroke(situation, factor):
    cycles = recorded(volts.decaying_cycles(situation.plan, 0.0, RATE), factor * GAIN)
    if 1.0 / 3.0 < factor < 3.0:
        assert judge_hysteresis(situation, cycles).figures["stroke_m"] == pytest.approx(factor * 1e-4, rel=0.01)
    else:
        with pytest.raises(CommissioningError, match="the whole range moved the stage by .*, but 100 µm were expected"):
            judge_hysteresis(situation, cycles)


@pytest.mark.parametrize(("repeats", "proposed"), [(1, 20), (4, 40)])
def test_readings_that_never_repeat_for_long_tell_when_a_sensor_sticks(situation, repeats, proposed):
    quiet = recorded(np.zeros(2000))
    held = replace(quiet, signals=quiet.signals | {"measured": np.repeat(quiet["measured"][::repeats], repeats)[:2000]})
    [_, line] = judge_noise(situation, held).lines
    assert f"at most {repeats} readings in a row are equal" in line and f"frozen_samples: {proposed}" in line


@pytest.mark.parametrize("strokes", [-25.0, -15.0, 0.0, 15.0, 25.0])
def test_a_zero_many_strokes_away_is_that_of_another_unit(situation, strokes):
    quiet = recorded(np.zeros(2000), zero=strokes * 1e-4)
    if abs(strokes) < 20.0:
        figures = judge_noise(situation, quiet).figures
        assert figures["sensor_zero_m"] == pytest.approx(strokes * 1e-4, abs=1e-9)
        assert figures["noise_rms_m"] == pytest.approx(NOISE, rel=0.1)
    else:
        with pytest.raises(
            CommissioningError, match="the sensor reads .* at rest, but a stroke of only 100 µm is expected"
        ):
            judge_noise(situation, quiet)


@pytest.mark.parametrize(
    ("code", "why"), [(1.0, "too many voltages came late"), (2.0, "a measurement is outside the range"), (3.0, "")]
)
def test_an_axis_that_stopped_itself_is_no_measurement_and_one_that_is_homed_is(code, why):
    stopped = np.where(np.arange(100) < 60, 0.0, code)
    with pytest.raises(CommissioningError, match=f"the axis tripped after 0.03 s: .*{why}"):
        require_sound(recorded(np.zeros(100), tripped=stopped), 100)
    homed = np.where(np.arange(100) < 60, -1.0, 0.0)
    assert len(require_sound(recorded(np.zeros(100), tripped=homed), 100)) == 100


@pytest.mark.parametrize(
    ("low", "high", "safe", "step", "far"), [(0.0, 100.0, 0.0, 5.0, 80.0), (-100.0, 0.0, 0.0, -5.0, -80.0)]
)
def test_steps_go_to_the_end_that_is_farther_from_safe(situation, low, high, safe, step, far):
    plan = replace(situation.plan, minimum=low, maximum=high)
    assert volts.step_size(plan, safe) == pytest.approx(step)
    assert volts.creeping_level(plan, safe) == pytest.approx(far)
    found = volts.creeping_step(plan, safe, 1000.0)
    assert found[np.argmax(np.abs(found))] == pytest.approx(far)


@pytest.mark.parametrize("missing", [0, 40, 60, 500])
def test_one_measurement_in_twenty_may_be_missing_no_more(missing):
    recording = recorded(np.linspace(0.0, 10.0, 1000))
    places = np.linspace(1, 998, missing).astype(int)
    assert np.unique(places).size == missing
    recording.signals["measured"][places] = np.nan
    if missing <= 50:
        found = require_sound(recording, 1000)["measured"]
        np.testing.assert_allclose(found, GAIN * np.linspace(0.0, 10.0, 1000), atol=6 * NOISE)
    else:
        with pytest.raises(CommissioningError, match=rf"{missing / 10:.1f} % of 1000 samples have no measurement"):
            require_sound(recording, 1000)


def test_samples_at_irregular_times_are_taken_to_regular_ones():
    recording = recorded(np.linspace(0.0, 10.0, 1000))
    late = 2e-4 * np.random.default_rng(3).uniform(size=1000)
    recording.time[1:-1] += late[1:-1]
    recording.signals["measured"] = 0.02 * GAIN * recording.time * RATE
    found = require_sound(recording, 1000)
    assert np.ptp(np.diff(found.time)) < 1e-9
    np.testing.assert_allclose(found["measured"], 0.02 * GAIN * found.time * RATE, atol=1e-12)


@pytest.mark.parametrize("kept", [940, 960])
def test_a_run_that_was_cut_off_lacks_its_last_samples(kept):
    recording = recorded(np.linspace(0.0, 10.0, kept))
    recording.time[:] += 7.0  # wherever the clock begins
    if kept > 950:
        assert len(require_sound(recording, 1000)) == kept
    else:
        with pytest.raises(CommissioningError, match="6.0 % of 1000 samples have no measurement"):
            require_sound(recording, 1000)


@pytest.mark.parametrize("share", [0.02, -0.01])
def test_creep_is_that_of_a_decade_of_time_relative_to_the_step(situation, share):
    """The law is that of the data sheets: the step times 1 + γ lg(t / 0.1 s)."""
    voltage = volts.creeping_step(situation.plan, 0.0, RATE)
    level = volts.creeping_level(situation.plan, 0.0)
    begin = np.argmax(voltage >= level)
    since = np.maximum((np.arange(voltage.size) - begin) / RATE, 0.0) + volts.CREEP_WAY
    crept = recorded(voltage)
    crept.signals["measured"] = crept["measured"] + np.where(
        voltage >= level, GAIN * level * share * np.log10(since / 0.1), 0.0
    )
    # the step itself is the mean of its first tenth of a second, in which it creeps by 0.12 of a decade
    expected = share / (1.0 + 0.12 * share)
    assert volts.judge_creep(situation, crept).figures["creep_per_decade"] == pytest.approx(expected, rel=0.02)


def test_the_amplifier_is_as_fast_as_its_slower_limit(situation):
    def speed(**values):
        return replace(situation.plan, **values).amplifier

    charging = {"current": 0.1, "capacitance": 1e-5}
    assert speed() == 0.0 and speed(slew_rate=2e3) == 2e3 and speed(**charging) == pytest.approx(1e4)
    assert speed(slew_rate=2e3, **charging) == 2e3 and speed(slew_rate=2e4, **charging) == pytest.approx(1e4)
    for given, missing in (("current", "capacitance"), ("capacitance", "current")):
        assert [problem.name for problem in replace(situation.plan, **{given: 1e-5}).check()] == [missing]


def test_a_commissioning_is_resumed_with_the_same_file_on_the_same_bench(tmp_path):
    kept = tmp_path / "kept"
    Folder(kept, "a file", "nodes", False)
    Folder(kept, "a file", "nodes", True)
    for text, bench, words in (
        ("another", "nodes", "file has changed"),
        ("a file", "offline", "'nodes', not 'offline'"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            Folder(kept, text, bench, True)
    with pytest.raises(ConfigurationError, match="exists already"):
        Folder(kept, "a file", "nodes", False)


@pytest.mark.parametrize("preview", [0, 7])
def test_a_scan_is_judged_over_its_last_periods_as_late_as_its_preview(situation, preview):
    given = {"feedforward__type": "static", "feedforward__preview": preview} if preview else {}
    configuration = situation.configuration.override("motion_controller", **given)
    found, period = judged_samples(situation, configuration), scan_period(situation)
    settled = scan_begin(situation) + UNJUDGED_PERIODS * period
    assert (found.start, found.stop) == (settled + preview, settled + JUDGED_PERIODS * period)


def test_learning_omits_each_sample_for_its_first_reason():
    """At 1 kHz: a limited command is known one sample later; limits and late samples still act after their end."""
    given = LearningParameters.from_mapping({"shortfall": 1e-9, "late_recovery": 0.002, "recovery": 0.003})
    command, skipped, seen = np.zeros(40), np.zeros(40), np.zeros(40)
    applied = command.copy()
    applied[[10, 11]] = 2e-9
    skipped[30] = 1.0
    seen[[14, 25]] = np.nan
    signals = {"command": command, "applied": applied, "measured": seen, "skipped": skipped, "seen": seen}
    found = {
        reason: np.flatnonzero(samples).tolist() for reason, samples in not_learned(given, 1000.0, signals).items()
    }
    assert list(found.values()) == [[30], [31, 32], [11, 12], [13, 14, 15], [25]]
    given = replace(given, period=0.01)
    text = learned_line(given, 1000.0, signals, 0, 4)
    assert text.startswith("of 4 periods, 1 were learned completely, 3 in part, 0 not at all; omitted: ")
    assert "2.5 % of the samples because of late samples" in text and "5 % of the samples because of commands" in text


@pytest.mark.parametrize("drift", [0.0, 1e-7, -3e-7])
def test_a_drift_of_the_sensor_is_not_its_noise(situation, drift):
    quiet = recorded(np.zeros(4000))
    quiet.signals["measured"] = quiet["measured"] + drift * quiet.time
    figures = judge_noise(situation, quiet).figures
    assert figures["noise_rms_m"] == pytest.approx(NOISE, rel=0.1)
    assert figures["drift_m_s"] == pytest.approx(drift, abs=5e-10)


@pytest.mark.parametrize("part", [0.019, 0.021])
def test_noise_of_two_percent_of_the_stroke_is_too_much(situation, part):
    noisy = recorded(np.zeros(4000))
    noisy.signals["measured"] = part * situation.plan.stroke * (-1.0) ** np.arange(4000)
    if part < 0.02:
        assert judge_noise(situation, noisy).figures["noise_rms_m"] == pytest.approx(part * 1e-4, rel=1e-6)
    else:
        with pytest.raises(CommissioningError, match="the sensor's noise at rest is"):
            judge_noise(situation, noisy)


def test_the_largest_slew_rate_of_all_movements_counts_as_excited(situation):
    sizes = dict(zip(MOVED, (5.0, 80.0, 20.0, 1.0), strict=True))
    for stage, size in sizes.items():
        situation.folder.record(stage, recorded(np.concatenate([np.zeros(10), np.linspace(size, 0.0, 40)])))
    assert excited(situation) == pytest.approx(80.0 * RATE)


@pytest.mark.parametrize(("low", "high"), [(0.0, 8e-6), (-8e-6, 0.0), (-2e-6, 8e-6), (2e-6, 8e-6)])
def test_references_of_closed_loops_begin_at_rest_and_go_to_the_farther_end(situation, low, high):
    ends = {"minimum": low, "maximum": high, "initial_setpoint": max(0.0, low)}
    configuration = situation.configuration.override("reference_generator", **ends)
    situation.plan = replace(situation.plan, scan_stroke=3e-6)
    rest, period = 0.0, scan_period(situation)
    far = high if high - rest >= rest - low else low
    scan = scan_reference(situation, configuration)
    first, count = scan_begin(situation), UNJUDGED_PERIODS + JUDGED_PERIODS
    assert scan[0] == scan[-1] == rest and min(low, rest) - 1e-15 <= scan.min() and scan.max() <= high + 1e-15
    if low >= 0.0:  # the model reaches 0 … 10 µm; an axis may rest outside its range, and begins there
        followed = closed_axis(situation, configuration, "scan", scan).generator
        assert followed.minimum == rest and followed.maximum == high
    triangles = scan[first : first + count * period].reshape(count, period)
    # about the middle of the range, from peak to peak 3 µm, at a constant speed
    np.testing.assert_allclose(triangles, triangles[:1].repeat(count, axis=0), atol=1e-18)
    assert triangles.min() == pytest.approx(0.5 * (low + high) - 1.5e-6)
    assert triangles.max() == pytest.approx(0.5 * (low + high) + 1.5e-6)
    speed = np.diff(scan[first - 1 : first + count * period])
    np.testing.assert_allclose(np.abs(speed), 6e-6 / period, rtol=1e-6)
    steps = steps_reference(situation, configuration)
    held, moved = round(STEP_HOLD * situation.rate), round(STEP_WAY * situation.rate)
    ends = [3 * held - 1, *(3 * held + k * (held + moved) - 1 for k in (1, 2, 3))]
    levels = rest + np.array([0.1, 0.2, 0.3, 0.2]) * (far - rest)
    np.testing.assert_allclose(steps[ends], levels, atol=1e-18)
    assert steps[0] == steps[-1] == rest and min(low, rest) <= steps.min() and steps.max() <= high
    # every way takes its time, that to the first step and that back to rest too
    assert steps.size == 8 * held + 3 * moved
    assert np.abs(np.diff(steps)).max() < 1.01 * np.pi / 2.0 * 0.2 * abs(far - rest) / min(held, moved)
    assert scan.size - (first + count * period) >= 2 * held and np.all(scan[-held:] == rest)


def test_a_scan_that_is_larger_than_the_range_is_refused(situation):
    configuration = situation.configuration.override("reference_generator", minimum=0.0, maximum=2e-6)
    situation.plan = replace(situation.plan, scan_stroke=2.1e-6)
    with pytest.raises(CommissioningError, match="but the stage reaches 2 µm"):
        scan_reference(situation, configuration)


def test_voltages_of_the_stages_are_those_of_the_page_of_commissioning(situation):
    """From the safe voltage and back to it; the durations [s] and levels [V] are those of the table there."""
    plan = situation.plan
    built = (volts.listening, volts.small_step, volts.small_multisine, volts.decaying_cycles, volts.creeping_step)
    quiet, step, sines, cycles, creep = (function(plan, 0.0, RATE) for function in built)
    found = (quiet, step, sines, cycles, creep)
    assert [round(voltage.size / RATE, 2) for voltage in found] == [0.5, 2.35, 12.0, 10.0, 3.2]
    assert all(voltage[0] == voltage[-1] == 0.0 for voltage in found)
    assert np.ptp(quiet) == 0.0 and step.max() == 0.05 * plan.span and creep.max() == 0.8 * plan.span
    np.testing.assert_array_equal(creep[round(0.6 * RATE) : round(2.6 * RATE)], creep.max())
    # five periods of 2 s about the middle, with a peak of 2 % of the range
    periods = sines[round(1.0 * RATE) :][: round(10.0 * RATE)].reshape(5, -1)
    np.testing.assert_allclose(periods, periods[:1].repeat(5, axis=0), atol=1e-9)
    assert np.max(np.abs(periods - 50.0)) == pytest.approx(0.02 * plan.span, rel=1e-6)
    # two cycles of 0.5 s over the whole range, then fourteen, each of them 1/3.5 of a Neper smaller
    middle = cycles[round(1.0 * RATE) + round(0.25 * RATE) :: round(0.5 * RATE)][:16]
    np.testing.assert_allclose(middle, 50.0 + 50.0 * np.exp(-np.maximum(np.arange(16) - 1.5, 0.0) / 3.5), rtol=1e-9)


@pytest.mark.parametrize("radius", [1.0, 5.0])
def test_the_width_of_a_loop_is_that_of_play(situation, radius):
    """Of a play of radius r the branches are 2 r apart."""
    voltage, follow = volts.decaying_cycles(situation.plan, 0.0, RATE), [0.0]
    for value in voltage[1:]:
        follow.append(min(max(follow[-1], value - radius), value + radius))
    cycles = recorded(voltage)
    cycles.signals["measured"] = GAIN * np.array(follow)
    found = judge_hysteresis(situation, cycles)
    assert found.figures["loop_opening_m"] == pytest.approx(2.0 * radius * GAIN, rel=1e-6)
    sizes = [found.figures[name] for name in ("lowest_m", "highest_m", "stroke_m")]
    assert sizes == pytest.approx([0.0, (100.0 - radius) * GAIN, (100.0 - radius) * GAIN])
    assert f"loop width {200.0 * radius / (100.0 - radius):.2g} % of the stroke" in found.lines[0]


@pytest.mark.parametrize("ratio", [1.49, 1.51])
def test_a_scan_may_have_one_and_a_half_times_the_predicted_error(situation, monkeypatch, ratio):
    """Errors of a square wave, whose RMS is its amplitude; before the judged periods they are ten times larger."""
    configuration = situation.configuration.override("reference_generator", minimum=0.0, maximum=100e-6)
    situation.plan = replace(situation.plan, scan_stroke=50e-6)
    reference = scan_reference(situation, configuration)
    judged = judged_samples(situation, configuration)
    square = np.where(np.arange(reference.size) >= judged.start, 1e-8, 1e-7) * (-1.0) ** np.arange(reference.size)

    def run(size):
        signals = {"reference": reference, "measured": reference - size * square}
        return Recording(np.arange(reference.size) / RATE, signals)

    monkeypatch.setattr(closed, "designed", lambda situation: configuration)
    monkeypatch.setattr(closed, "predicted_scan", lambda *given: run(1.0))
    found = closed.judge_scan(situation, run(ratio))
    expected = {"rms_error_m": ratio * 1e-8, "undelayed_rms_m": ratio * 1e-8, "predicted_rms_m": 1e-8, "ratio": ratio}
    assert {name: found.figures[name] for name in expected} == pytest.approx(expected)
    assert found.figures["as_predicted"] == (ratio < 1.5)
    words = "as predicted" if ratio < 1.5 else "MORE than 1.5 x the prediction"
    start = f"triangle of 50 µm at 5 Hz: error {10.0 * ratio:.4g} nm RMS, predicted 10 nm, ratio {ratio:g}: {words}"
    assert found.lines[0] == start and len(found.lines) == 2
    way, errors = found.pictures
    assert max(way.lines[0].y) == pytest.approx(75.0, rel=0.01), "µm, about the middle of the range"
    assert [max(line.y) for line in errors.lines] == pytest.approx([10.0 * ratio, 10.0]), "nm"
    assert errors.lines[0].x[0] == pytest.approx(judged.start / RATE)


def test_the_error_of_a_scan_is_also_stated_without_periods_that_a_skipped_sample_disturbed(situation, monkeypatch):
    configuration = situation.configuration.override("reference_generator", minimum=0.0, maximum=100e-6)
    situation.plan = replace(situation.plan, scan_stroke=50e-6)
    reference, period = scan_reference(situation, configuration), scan_period(situation)
    judged = judged_samples(situation, configuration)
    skipped, error = np.zeros(reference.size), np.full(reference.size, 1e-8)
    skipped[judged.start + 2 * period + 5] = 1.0
    error[judged.start + 2 * period : judged.start + 4 * period] = 3e-7
    run = Recording(
        np.arange(reference.size) / RATE,
        {"reference": reference, "measured": reference - error, "skipped": skipped},
    )
    monkeypatch.setattr(closed, "designed", lambda situation: configuration)
    monkeypatch.setattr(closed, "predicted_scan", lambda *given: run)
    lines = closed.judge_scan(situation, run).lines
    count = (judged.stop - judged.start) // period
    kept = f"{count - 2} undisturbed of {count} periods"
    assert lines[1] == f"deadlines were missed; error of the {kept}: 10 nm RMS"
    assert lines[2].endswith("predicted 122.3 nm"), "two periods of ten are off by 290 nm: sqrt(290² 1.6 / 9)"


@pytest.mark.parametrize(("peak", "words"), [(2.4, "as predicted"), (2.6, "MORE than 1.25 x the prediction")])
def test_the_measured_margins_are_compared_with_those_of_the_model(situation, monkeypatch, peak, words):
    """Of an integrator with a loop at the distance 1/M_s of -1; the lower end of its range counts."""
    frequency = np.array([10.0, 50.0, 100.0])
    loop = MeasuredLoop(frequency, np.array([-5j, -1.0 + 1.0 / peak, -0.1 - 0.1j]), np.zeros(3), 1.0 / RATE)
    margins = SimpleNamespace(
        sensitivity_peak=2.0, gain_crossovers=[60.0], gain_margin=6.0, phase_margin=60.0, delay_margin_samples=3.0
    )
    response = SimpleNamespace(loop=loop, margins=margins, model_loop=loop.loop, figures={}, limitation="limited")
    monkeypatch.setattr(closed, "_measured_response", lambda *given: response)
    found = closed.judge_response(situation, recorded(np.zeros(100)))
    assert found.lines[0] == f"M_s {peak} ({peak} … {peak}), predicted 2: {words}"
    assert found.figures["as_predicted"] == (peak < 2.5)
    assert [text.split(" ")[0] for text in found.lines[1:]] == ["gain", "gain", "phase", "delay", "limited"]
    assert found.lines[1].endswith("; predicted 60 Hz") and found.lines[2].endswith("; predicted 6.0 dB")
    sensitivities, plane = found.pictures
    heights = [np.array(line.y) for line in sensitivities.lines]
    np.testing.assert_allclose(heights[0], np.abs(1.0 / (1.0 + loop.loop)), rtol=1e-5)
    np.testing.assert_allclose(heights[2], np.abs(loop.loop / (1.0 + loop.loop)), rtol=1e-5)
    np.testing.assert_allclose(heights[1::2], heights[::2], rtol=1e-5, err_msg="the model is the measured loop")
    circles = {line.label: np.array(line.x) + 1j * np.array(line.y) for line in plane.lines}
    np.testing.assert_allclose(np.abs(1.0 / (1.0 + circles["M_s = 2"])), 2.0, rtol=1e-4)
    np.testing.assert_allclose(np.abs(circles["|L| = 1"]), 1.0, rtol=1e-4)


def test_an_external_plant_that_is_too_fast_for_messages_is_refused_before_anything_starts(situation, monkeypatch):
    monkeypatch.setattr(benches, "require_ros", lambda: None)
    monkeypatch.setattr(benches, "Graph", lambda *given, **options: pytest.fail("nodes were started"))
    fast = situation.configuration.override("**", sample_rate=5000.0, external_plant=True)
    with pytest.raises(ConfigurationError, match="external_plant"):
        benches.GraphBench(True).run(single_axis(fast))
