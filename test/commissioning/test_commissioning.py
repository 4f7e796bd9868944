# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From a new file to a verified loop on a stage of another class than any model; and faults that stop it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from command_support import hysteresis
from commissioning_support import RATE, STAGE, ForeignBench, Willing, sitting

from hysteresis_ros.cli.commissioning import closed_loop
from hysteresis_ros.cli.commissioning import measuring as volts
from hysteresis_ros.cli.commissioning.bench import require_sound
from hysteresis_ros.cli.commissioning.new_file import NewAxis, write_new
from hysteresis_ros.cli.commissioning.situation import COMMISSIONED, CommissioningError, Folder, plan_of
from hysteresis_ros.cli.commissioning.stages import STAGES, NotAllowedError, commission
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.compensator import returned_commands
from hysteresis_ros.recordings.dataset import Recording


class Counting(ForeignBench):
    """A bench whose runs fail from a given number on."""

    def __init__(self, last=99, **options):
        super().__init__(**options)
        self.last = last

    def run(self, axis):
        """Run, or fail."""
        if len(self.runs) >= self.last:
            raise CommissioningError("unplugged")
        return super().run(axis)


def swing(bench, signals):
    """A loose part vibrates once the loop is closed."""
    if bench.runs[-1].motion_controller.type != "open_loop":
        signals["measured"] += 2e-6 * np.sin(0.8 * np.arange(signals["measured"].size))


def test_all_stages_lead_to_a_loop_that_follows_the_scan_and_stay_within_what_they_said(tmp_path, monkeypatch):
    situation, attendant, bench = sitting(tmp_path), Willing(), Counting(last=3)
    with pytest.raises(CommissioningError, match="hysteresis: unplugged"):
        commission(situation, bench, attendant)
    assert list(attendant.heard) == ["noise", "gain", "resonance"]
    # the cable is plugged in again: finished stages are not repeated, but the closed loop rings
    bench.last, bench.spoil = 99, lambda signals: swing(bench, signals)
    resumed = Willing()
    with pytest.raises(CommissioningError, match="loop: the closed loop does not settle"):
        commission(sitting(tmp_path, resumed=True), bench, resumed)
    assert [name for name, (_, before) in resumed.heard.items() if before] == ["noise", "gain", "resonance"]
    assert list(resumed.asked) == ["hysteresis", "creep", "loop"]
    assert "100 V" in resumed.asked["hysteresis"] and "100 µm" in resumed.asked["hysteresis"]
    # the loose part is tightened
    bench.spoil, situation, resumed = None, sitting(tmp_path, resumed=True), Willing()
    learned, design = [], closed_loop.design_learning
    monkeypatch.setattr(closed_loop, "design_learning", lambda *given: learned.append(given[0]) or design(*given))
    assert commission(situation, bench, resumed)
    assert list(resumed.heard) == list(STAGES) and list(resumed.asked) == ["loop", "response", "scan", "learn"]
    assert len(bench.runs) == 10

    # the bandwidth of the learning depends on the scan and on the noise
    (axis,) = learned
    scan = closed_loop.scan_reference(situation, closed_loop.designed(situation))
    wave = axis.generator.waveform
    assert wave.type == "triangle" and wave.frequency == 1.0 / (closed_loop.scan_period(situation) / RATE)
    assert axis.generator.initial_setpoint + wave.amplitude == pytest.approx(np.max(scan))
    assert axis.plant_simulator.sensor.noise == pytest.approx(3e-9, rel=0.1)

    figures = {name: outcome.figures for name, outcome in situation.found.items()}
    assert figures["noise"]["noise_rms_m"] == pytest.approx(3e-9, rel=0.1)
    assert figures["gain"]["gain_m_per_v"] == pytest.approx(0.87e-6, rel=0.05)
    assert figures["resonance"]["resonance_hz"] == pytest.approx(420.0, rel=5e-3)
    assert figures["resonance"]["damping"] == pytest.approx(0.015, rel=0.2)
    # one sample, half a sample because the voltage is held, and the contribution of the mode
    assert figures["resonance"]["delay_s"] == pytest.approx(1.5 / RATE, rel=0.15)
    assert figures["identify"]["mode_1_hz"] == pytest.approx(420.0, rel=2e-3)
    # a lag of a few hundredths of a sample is not distinguished from a delay
    assert figures["identify"]["delay_s"] + figures["identify"].get("lag_s", 0.0) == pytest.approx(1.0 / RATE, rel=0.05)
    # without removal of the delay it would be 0.33 µm; minor loops of the stage are steeper than those of the model
    assert figures["identify"]["rmse_m"] < 0.31e-6
    residual = next(one for one in situation.found["identify"].pictures if "Residual" in one.caption)
    assert np.max(np.abs(residual.lines[0].y)) < 5e9 * figures["identify"]["rmse_m"], "nm, of 100 µm"
    assert figures["identify"]["small_gain_over_model"] == pytest.approx(1.18, rel=0.1)
    assert figures["hysteresis"]["stroke_m"] == pytest.approx(100e-6, rel=0.05)
    assert 0.08 < figures["hysteresis"]["loop_opening_m"] / 100e-6 < 0.16
    assert 0.002 < figures["creep"]["creep_per_decade"] < 0.03
    # the plant is of another class than the model: its minor loops are steeper, so the loop is faster by this ratio
    loop = figures["response"]
    assert loop["as_predicted"] and loop["signal_to_noise_db"] > 20.0
    assert loop["sensitivity_peak_low"] < loop["sensitivity_peak"] < loop["sensitivity_peak_high"]
    assert 0.55 < loop["delay_margin_samples"] / loop["model_delay_margin_samples"] < 0.8
    assert 1.02 < loop["sensitivity_peak"] / loop["model_sensitivity_peak"] < 1.25
    # without feedback and inverse the loop width is 11 µm
    assert figures["scan"]["rms_error_m"] < 0.6e-6
    # learning removes the repeated part of the error of this scan; the remaining 3 nm are noise of the sensor
    learned = figures["learn"]
    assert learned["as_predicted"] and learned["rms_error_m"] < 8e-9 < 0.2 * figures["scan"]["rms_error_m"]
    # both numbers of the sentence are against one reference, and it says how many periods were learned
    assert learned["undelayed_rms_without_m"] == figures["scan"]["undelayed_rms_m"] != figures["scan"]["rms_error_m"]
    text = "\n".join(situation.found["learn"].lines)
    assert "both against the undelayed reference" in text and re.search(
        r"of \d+ periods, \d+ were learned completely", text
    ), text
    assert sum(outcome.seconds for outcome in situation.found.values()) < 60.0

    # in every stage the limits of plant and compensator allowed only the voltages of this stage
    small = [axis.hysteresis_compensator.limits for axis in bench.runs[:2]]
    assert (small[0].maximum, small[1].maximum) == pytest.approx((0.01, 5.01))
    assert all(axis.plant_simulator.limits == axis.hysteresis_compensator.limits for axis in bench.runs[1:])
    assert bench.runs[0].plant_simulator.limits.maximum == 100.0, "the device's range is checked before any motion"
    written = single_axis(load_configuration(situation.folder.path / COMMISSIONED))
    assert written.plant_simulator.limits.slew_rate > 0.0 and written.hysteresis_compensator.limits.slew_rate > 0.0
    assert not written.reference_generator.approach.unlimited
    # the actuator does not return to its zero, and drifts, so the range is the middle part of what it reaches again
    low, high = returned_commands(written.hysteresis_compensator, 1.0 / RATE)
    used = written.generator.minimum, written.generator.maximum
    assert low > 0.0 and used == pytest.approx((0.975 * low + 0.025 * high, 0.025 * low + 0.975 * high), rel=1e-3)
    assert written.generator.initial_setpoint == used[0]
    assert written.recorder.sample_rate == RATE and written.recorder.joint == "stage"
    assert written.motion_controller.type == "pid" and written.plant_simulator.sensor.noise > 2e-9
    # the plant differs from the model: the prediction contains the part that the controller does not know
    assert written.plant_simulator.hysteresis.type == "polynomial"
    assert written.hysteresis_compensator.hysteresis.type == "prandtl_ishlinskii"
    assert figures["scan"]["predicted_rms_m"] == figures["design"]["predicted_rms_m"] > 20e-9
    assert written.hysteresis_compensator.limits.maximum == 100.0 and written.plant_simulator.joint == "stage"

    # one stage is repeated alone; later stages that used its results must be repeated too
    alone = Willing()
    assert not commission(sitting(tmp_path, resumed=True), bench, alone, ["creep"])
    assert list(alone.asked) == ["creep"] and situation.folder.outcome("identify") is None
    with pytest.raises(CommissioningError, match="design needs the results of identify"):
        commission(sitting(tmp_path, resumed=True), bench, Willing(), ["design"])


def reversed_sign(signals):
    """The sensor has the wrong sign."""
    signals["measured"] *= -1.0


def blind(signals):
    """The sensor measures something else."""
    signals["measured"][:] = 3e-9 * np.random.default_rng(1).standard_normal(signals["measured"].size)


def in_micrometres(signals):
    """The driver returns micrometres."""
    signals["measured"] *= 1e6


def in_kilometres(signals):
    """The driver returns kilometres."""
    signals["measured"] *= 1e-3


def in_tenths(signals):
    """The scaling is wrong by a factor of ten."""
    signals["measured"] *= 0.1


def ringing(signals):
    """Another part vibrates."""
    if signals["voltage"].max() > 1.0:
        signals["measured"] += 3e-6 * np.sin(0.1 * np.arange(signals["measured"].size))


def tripping(signals):
    """The axis tripped."""
    signals["tripped"][100:] = 2.0


def losing(signals):
    """The measurement of every tenth sample is missing."""
    signals["measured"][::10] = np.nan


def stuck(signals):
    """The voltage stays at a limit of the amplifier."""
    np.minimum(signals["voltage"], 1.0, out=signals["voltage"])


def noisy(signals):
    """The cable is noisy."""
    signals["measured"] += 5e-6 * np.random.default_rng(1).standard_normal(signals["measured"].size)


WRONG = {
    reversed_sign: "gain: the sign is reversed",
    blind: "gain: the sensor does not move with the actuator",
    in_micrometres: "noise: the sensor's noise at rest is .* units",
    in_kilometres: "gain: the sensor does not move .* factor is about 0.001: does the driver use other units",
    in_tenths: "gain: the gain is 0.08",
    ringing: "gain: the stage does not settle",
    tripping: "noise: the axis tripped after 0.05 s: a measurement is outside the range",
    losing: "noise: 10.0 % of 1000 samples have no measurement or no voltage",
    stuck: "gain: a step of 5 V was commanded, but only 1 V were applied",
    noisy: "noise: the sensor's noise at rest is",
}


@pytest.mark.parametrize("spoil", WRONG, ids=lambda spoil: spoil.__name__)
def test_what_looks_wrong_is_named_before_anything_large_moves(tmp_path, spoil):
    bench = ForeignBench(spoil=spoil)
    with pytest.raises(CommissioningError, match=WRONG[spoil]) as caught:
        commission(sitting(tmp_path), bench, Willing(), [])
    assert caught.value.exit_code == 2
    assert max(axis.hysteresis_compensator.limits.maximum for axis in bench.runs) < 6.0


def test_single_samples_that_are_missing_are_bridged():
    time = np.arange(200) / 100.0
    kept = np.delete(np.arange(200), [50, 51, 120])
    signals = {name: np.sin(time) for name in ("reference", "voltage", "measured", "command", "applied", "seen")}
    whole = Recording(time, signals)
    signals = {name: np.where(np.arange(197) == 9, np.nan, values[kept]) for name, values in signals.items()}
    signals["voltage"][33] = np.nan  # the answer came too late
    signals["skipped"] = np.arange(197) == 33.0
    found = require_sound(Recording(time[kept], signals), 200)
    assert np.isfinite(found["voltage"]).all() and np.flatnonzero(found["skipped"] > 0.5).tolist() == [33]
    assert found["command"] == pytest.approx(whole["command"], abs=2e-4) and found.has("seen")
    assert found["applied"] == pytest.approx(whole["applied"], abs=2e-4)  # learning needs it
    assert found.time == pytest.approx(whole.time) and found["measured"] == pytest.approx(whole["measured"], abs=2e-4)
    assert require_sound(whole, 200) is whole


def test_samples_for_which_the_machine_was_too_busy_are_said_with_what_was_found(tmp_path):
    def busy(signals):
        signals["late"][100:] = 7.0

    def skipping(signals):
        signals["skipped"][100:107] = 1.0
        for name in ("voltage", "measured"):
            signals[name][100:107] = np.nan

    said = []
    for name, spoil in (("quiet", None), ("busy", busy), ("skipping", skipping)):
        (tmp_path / name).mkdir()
        told = Willing()
        commission(sitting(tmp_path / name), ForeignBench(spoil=spoil), told, ["noise"])
        outcome, _ = told.heard["noise"]
        said.append([line for line in outcome.lines if "too busy" in line])
    assert not said[0]
    for (line,) in said[1:]:
        assert "too busy for 7 of 1000 samples" in line


def clipped(signals):
    """The range of the sensor ends before that of the actuator."""
    np.minimum(signals["measured"], 60e-6, out=signals["measured"])


def test_a_sensor_that_ends_within_the_stroke_is_named(tmp_path):
    with pytest.raises(CommissioningError, match="hysteresis: the sensor stays at its highest reading of 60"):
        commission(sitting(tmp_path), ForeignBench(spoil=clipped), Willing())


def test_nothing_moves_that_nobody_allows(tmp_path):
    class Unwilling(Willing):
        def may_move(self, stage, words):
            return stage == "noise"

    bench = ForeignBench()
    with pytest.raises(NotAllowedError, match="stopped before the stage gain, before any of its movements"):
        commission(sitting(tmp_path), bench, Unwilling())
    assert len(bench.runs) == 1


def test_a_resumed_sitting_is_of_the_same_file_and_bench(tmp_path):
    sitting(tmp_path)
    with pytest.raises(ConfigurationError, match="exists already; continue with --resume"):
        sitting(tmp_path)
    path = tmp_path / "stage.yaml"
    text = path.read_text()
    with pytest.raises(ConfigurationError, match="began with 'foreign', not 'offline'"):
        Folder(tmp_path / "kept", text, "offline", True)
    path.write_text(text.replace("maximum: 100.0", "maximum: 120.0"))
    with pytest.raises(ConfigurationError, match="the parameter file has changed"):
        sitting(tmp_path, resumed=True)
    with pytest.raises(ConfigurationError, match="no commissioning to resume"):
        Folder(tmp_path / "other", text, "foreign", True)


def test_a_plan_with_a_mistake_is_named(tmp_path):
    with pytest.raises(ParameterError, match="/commissioning: noise_durations.*did you mean"):
        sitting(tmp_path, plan="    noise_durations: 1.0\n")


@pytest.mark.parametrize("stage", ["small_step", "small_multisine", "decaying_cycles", "creeping_step", "listening"])
@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-30.0, 120.0), (-100.0, 0.0), (20.0, 60.0)])
def test_voltages_begin_and_end_at_safe_and_stay_in_the_range(tmp_path, stage, low, high):
    safe = min(max(0.0, low), high)
    write_new(tmp_path / "stage.yaml", NewAxis(100e-6, low, high, 1000.0))
    configuration = load_configuration(tmp_path / "stage.yaml")
    plan = plan_of(configuration, single_axis(configuration))
    found = getattr(volts, stage)(plan, safe, 1000.0)
    assert found[0] == safe and found[-1] == pytest.approx(safe, abs=1e-9)
    assert low - 1e-9 <= found.min() and found.max() <= high + 1e-9
    if stage != "small_multisine":  # nothing jumps
        assert np.abs(np.diff(found)).max() < 0.05 * plan.span


def test_the_damping_of_a_resonance_is_read_whatever_it_is(tmp_path):
    """Any damping is found: compared with the formula of the mode, from the recording of a stage without hysteresis."""
    for damping in (0.005, 0.03):
        stage = replace(STAGE, opening=0.0, dampings=(damping, 0.02))
        folder = tmp_path / f"{damping}"
        folder.mkdir()
        situation = sitting(folder)
        for name in ("noise", "gain", "resonance"):
            commission(situation, ForeignBench(stage), Willing(), [name])
        found = situation.found["resonance"]
        assert found.figures["damping"] == pytest.approx(damping, rel=0.15)
        seen = re.fullmatch(r"resonance at (\S+) Hz, damping (\S+) %", found.lines[0])
        assert [float(text) for text in seen.groups()] == pytest.approx([420.0, 100.0 * damping], rel=0.15)


@pytest.mark.parametrize(("first", "last"), [(0.0, 10.0), (20.0, 30.0), (-3.0, 4.0)])
def test_the_voltages_of_a_stage_leave_as_they_were_planned_also_far_from_0_v(tmp_path, first, last):
    situation = sitting(tmp_path)
    voltages = np.clip(np.linspace(first, last, 400), situation.plan.minimum, situation.plan.maximum)
    for node in ("plant_simulator", "hysteresis_compensator"):
        situation.configuration = situation.configuration.override(node, safe_voltage=float(np.mean(voltages)))
    setpoint = float(np.mean(voltages)) * situation.plan.gain
    ends = {"minimum": -1e-4, "maximum": 1e-4, "initial_setpoint": setpoint}
    situation.configuration = situation.configuration.override("reference_generator", **ends)
    run = simulate(situation.driven_axis("gain", voltages), describe=False)
    assert run["voltage"] == pytest.approx(voltages, abs=0.01)


@pytest.mark.parametrize("name", ["stage700", "picma_stage"])
def test_the_reference_of_a_file_is_not_judged_by_the_limits_of_a_stage(tmp_path, name):
    """The waveform and the setpoint of the file are out of reach of the voltages of one stage, and are replaced."""
    said = hysteresis("commission", name, "--offline", "--yes", "--stage", "noise", "--directory", tmp_path / "stage")
    assert "noise " in said and "RMS" in said
