# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The part of the frequency response that a recording determines, its bounds elsewhere, and the use in designs."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from foreign_plant import ForeignPlant

from hysteresis_ros.cli.main import main
from hysteresis_ros.control.margins import plant_state_space
from hysteresis_ros.control.uncertainty import (
    UNKNOWN,
    UNSEEN,
    ResponseUncertainty,
    fastest_integral,
    integral_controller,
)
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.plant_model import PlantModel
from hysteresis_ros.identification.response_check import check_response, measured_plant, sound_data
from hysteresis_ros.models.creep import CreepParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.proportional import ProportionalParameters
from hysteresis_ros.models.linear import LinearDynamics, StateSpace

RATE = 2000.0
STEP = 1.0 / RATE
EXACT = ResponseUncertainty(np.ones(1), np.zeros(1), np.inf)
MODE = LinearPart(modes=(Mode(280.0, 0.03),), hold=STEP)


def multisine(length: int, highest: int = 800, seed: int = 0) -> np.ndarray:
    """Lines of 1 Hz up to ``highest`` around 50 V."""
    spectrum = np.zeros(1001, dtype=complex)
    spectrum[1:highest] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=highest - 1))
    one = np.fft.irfft(spectrum)
    return 50.0 + 40.0 * np.resize(one / np.abs(one).max(), length)


def chain(part: LinearPart) -> PlantModel:
    """0.1 µm/V before a linear part."""
    gain = HysteresisParameters(type="proportional", proportional=ProportionalParameters(gain=1e-7))
    return PlantModel(gain, CreepParameters(), part.dynamics(STEP), STEP, linear_part=part, voltage_high=100.0)


def recording(part: LinearPart, voltage, noise: float = 2e-9) -> IdentificationData:
    after = LinearDynamics(part.dynamics(STEP), STEP).simulate(1e-7 * voltage)
    measured = np.append(0.0, after[:-1]) + noise * np.random.default_rng(1).standard_normal(voltage.size)
    return IdentificationData(np.arange(voltage.size) * STEP, voltage, measured)


@pytest.mark.slow
def test_a_true_model_is_known_as_far_as_the_voltage_has_content():
    whole = check_response(chain(MODE), recording(MODE, multisine(16000)), 1000)
    # a mode above the content is possible, but it does not affect integral control, so there is no message
    assert 0.4 < whole.uncertainty.known_to * STEP < 0.5 and whole.fit_for_feedback and whole.warnings == ()
    assert np.max(whole.uncertainty.at([2.0, 20.0, 280.0, 600.0])) < 0.05
    half = check_response(chain(MODE), recording(MODE, multisine(16000, 100)), 1000)
    assert half.uncertainty.known_to == pytest.approx(100.0, rel=0.2)
    assert half.uncertainty.at([90.0])[0] < 0.1
    assert half.uncertainty.at([1.01 * UNSEEN * half.uncertainty.known_to])[0] == UNKNOWN
    # a mode just above the content would have changed the response there by more than was observed
    known, near = half.uncertainty.height([90.0, 1.2 * half.uncertainty.known_to])
    assert known == 0.0 and 0.0 < near < 0.2 * UNKNOWN
    assert "dynamics above" in half.warnings[0] and "are unknown" in half.warnings[0]
    # there is no content in this band: designs are limited with a message, but nothing contradicts the model
    assert half.fit_for_feedback and half.certain < 0.5 * half.believed


@pytest.mark.slow
def test_outliers_cost_samples_and_not_the_response():
    slow = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(8000) * STEP)
    clean, exact = (recording(MODE, slow + 0.02 * multisine(8000), noise) for noise in (2e-9, 0.0))
    output, random = clean.output.copy(), np.random.default_rng(2)
    output[random.integers(0, 8000, 20)] += 1e-6 * random.choice([-1.0, 1.0], 20)
    spoilt = replace(clean, output=output)
    sound = sound_data(spoilt, exact.output, 0)
    assert np.max(np.abs(sound.output - clean.output)) < 20e-9 and sound_data(clean, exact.output, 0) is clean
    known = [check_response(chain(MODE), one).uncertainty.known_to for one in (clean, sound, spoilt)]
    assert known[1] > 0.9 * known[0] > 500.0 > 2.0 * known[2]


def test_a_resonance_that_the_model_lacks_rings_and_is_named():
    missed = check_response(chain(LinearPart(hold=STEP)), recording(MODE, multisine(16000)), 1000)
    assert missed.ringing and missed.ringing[0] == pytest.approx(280.0, abs=8.0)
    assert not missed.fit_for_feedback and missed.unfit_at == pytest.approx(280.0, rel=0.15)
    assert f"the residual rings at {missed.ringing[0]:.4g} Hz" in missed.warnings
    assert missed.certain < 0.5 * missed.believed and "known only to" in missed.reason
    # the loop that the model alone would permit is unstable on the plant; the loop within the certain band is stable
    assert not stable(MODE, missed.believed) and stable(MODE, missed.certain)


def stable(part: LinearPart, crossover: float) -> bool:
    """Return whether integral control with this crossover [Hz] is stable on a plant."""
    plant, controller = plant_state_space(part.dynamics(STEP)), integral_controller(crossover, STEP)
    column, row, through = controller.B[:, 1:], controller.C, controller.D[:, 1:]
    closed = np.block([[plant.A + plant.B @ through @ plant.C, plant.B @ row], [column @ plant.C, controller.A]])
    return bool(np.all(np.abs(np.linalg.eigvals(closed)) < 1.0))


@pytest.mark.parametrize(("damping", "share"), [(5e-4, 0.005), (3e-3, 0.02), (0.01, 0.1)])
def test_a_light_mode_within_the_known_range_limits_the_loop(damping, share):
    # the mean of its response over a band is small, the loop that the model alone would permit is unstable
    part = LinearPart(modes=(Mode(280.0, damping, share),), hold=STEP)
    found = check_response(chain(LinearPart(hold=STEP)), recording(part, multisine(16000, 990)), 1000)
    assert found.ringing == pytest.approx((280.0,), abs=2.0) and np.isinf(found.uncertainty.known_to)
    assert not found.fit_for_feedback and "rings at 28" in found.reason and "no resonance" in found.reason
    assert not stable(part, found.believed) and stable(part, found.certain) and found.certain > 1.0


@pytest.mark.slow
def test_a_mode_of_the_model_that_the_steps_of_a_converter_excite_is_no_missing_resonance():
    """A slow recording has no content at the mode, so nearly all motion there is that of the 80 mV steps."""
    part = LinearPart(modes=(Mode(280.0, 0.01),), hold=STEP)
    voltage = 50.0 + 45.0 * np.sin(2.0 * np.pi * 0.9 * np.arange(16000) * STEP)
    stepped = replace(recording(part, 8e-2 * np.round(voltage / 8e-2), 1e-10), input=voltage)
    found = check_response(chain(part), stepped, 1000)
    assert found.ringing == () and found.fit_for_feedback
    other = LinearPart(modes=(Mode(320.0, 0.01),), hold=STEP)
    missed = check_response(chain(other), stepped, 1000)
    assert missed.ringing == pytest.approx((280.0,), abs=2.0) and not missed.fit_for_feedback


def test_the_certain_crossover_shrinks_with_the_uncertainty():
    plant = plant_state_space(LinearPart(lag=0.01, hold=STEP).dynamics(STEP))
    fastest = [
        fastest_integral(plant, STEP, ResponseUncertainty(np.ones(1), np.array([size]), known))
        for size, known in ((0.0, np.inf), (0.4, np.inf), (0.4, 30.0), (0.4, 3.0), (0.4, 0.0))
    ]
    assert fastest[0] >= fastest[1] > fastest[2] > fastest[3] > fastest[4] == 0.0
    # M_s of 2 without uncertainty: an integrator and an exactly known lag
    peak = EXACT.borne_by(integral_controller(fastest[0], STEP), plant, STEP)
    assert 0.5 <= peak.nominal < 0.56


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.5])
def test_slow_movement_from_elsewhere_counts_by_its_mean_square(share):
    """Noise of 10 … 30 Hz beside the response to a multisine up to 800 Hz, which moves a hundred times as fast."""
    data = recording(LinearPart(hold=STEP), multisine(16000))
    spectrum = np.fft.rfft(np.random.default_rng(3).standard_normal(len(data)))
    frequency = np.fft.rfftfreq(len(data), STEP)
    slow = np.fft.irfft(np.where((frequency > 10.0) & (frequency < 30.0), spectrum, 0.0), len(data))
    moved = data.output + np.std(data.output) * np.sqrt(share / (1.0 - share)) * slow / np.std(slow)
    found = check_response(chain(LinearPart(hold=STEP)), replace(data, output=moved), 1000)
    # the spectrum is smooth over half an octave, and its slower part weighs more
    assert 0.9 * share < found.foreign < 1.5 * share
    told = [f"{100.0 * found.foreign:.0f} % of the movement (mean square)" in text for text in found.warnings]
    assert any(told) == (share > 0.25)


def test_a_line_of_the_voltage_is_no_ringing_however_wrong_the_model_is_there():
    voltage = multisine(16000, 40) + 5.0 * np.sin(2.0 * np.pi * 300.0 * STEP * np.arange(16000))
    found = check_response(chain(LinearPart(hold=STEP)), recording(LinearPart(lag=4e-3, hold=STEP), voltage), 1000)
    assert found.ringing == ()


def test_a_response_from_a_voltage_and_its_circles_are_scaled_together():
    """0.1 µm/V with circles of 1 %, beside a model of unit gain that is right up to this gain."""
    frequency = np.arange(1.0, 50.0)
    model = 1.0 / (1.0 + 0.01j * frequency)
    circles = SimpleNamespace(single=1e-7 * model, radius=lambda probability: 1e-9 * np.abs(model)[:, None, None])
    found = measured_plant(
        SimpleNamespace(response=SimpleNamespace(input_unit="V", frequency=frequency, **vars(circles))), model
    )
    np.testing.assert_allclose(found.response, model, rtol=1e-9)
    np.testing.assert_allclose(found.uncertainty(model, STEP).relative, 0.01, rtol=1e-6)


def test_displacement_that_passes_through_an_unknown_resonance_does_not_pass_through_the_model():
    """L = -3 at a mode of the model that may not be there: where two thirds of the motion pass elsewhere, L is -1."""
    plant = plant_state_space(LinearPart(modes=(Mode(280.0, 1e-4),), hold=STEP).dynamics(STEP))
    z = np.exp(2j * np.pi * np.linspace(279.5, 280.5, 4001) * STEP)
    peak = z[np.argmax(np.abs(plant.response(z)[:, 0, 0]))]
    feedback = 3.0 / plant.response(peak[None])[0, 0, 0]
    # two taps whose response at the peak is this number
    now, then = np.linalg.solve([[1.0, peak.real], [0.0, -peak.imag]], [feedback.real, feedback.imag])
    controller = StateSpace(np.zeros((1, 1)), np.array([[0.0, 1.0]]), np.array([[then]]), np.array([[0.0, now]]))
    unknown = ResponseUncertainty(np.ones(1), np.zeros(1), 0.0)
    found = unknown.borne_by(controller, plant, STEP)
    assert found.nominal > 0.9 and found.distance < 0.0
    assert EXACT.borne_by(controller, plant, STEP).distance == pytest.approx(found.nominal)


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """Slow triangles of a stage with a resonance, identified by the command: folder and result."""
    folder = tmp_path_factory.mktemp("slow")
    time = np.arange(7000) / RATE
    voltage = 50.0 * (1.0 - (2.0 * np.abs(2.0 * ((1.0 * time) % 1.0) - 1.0) - 1.0) * np.exp(-time / 6.0))
    plant = ForeignPlant(RATE, amplifier=0.0015, modes=((280.0, 0.03, 1.0),), rate=0.02, creep=0.02, noise=5e-9)
    table = np.column_stack([time, voltage, 1e6 * plant.record(voltage)])
    np.savetxt(folder / "slow.csv", table, delimiter=",", header="time_s,voltage_V,position_um", comments="")
    arguments = [
        "identify",
        str(folder / "slow.csv"),
        "-o",
        str(folder / "axis.yaml"),
        "-p",
        "zone_count=0",
        "-p",
        "play_count=8",
    ]
    return folder, CliRunner().invoke(main, arguments)


@pytest.mark.slow
def test_what_slow_triangles_do_not_show_is_said(slow):
    folder, result = slow
    assert result.exit_code in (0, 4)
    unknown = "Hz are unknown (the voltage contains hardly any power there): without a roll-off a design is limited to"
    assert unknown in result.stdout
    assert "known_to:" in (folder / "axis.yaml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_identify_says_by_line_and_exit_code_that_a_model_is_not_fit_for_feedback(tmp_path):
    plant, voltage = ForeignPlant(RATE, hysteresis=0.0, lag=0.002, modes=((300.0, 0.03, 0.5),)), multisine(8000)
    table = np.column_stack([np.arange(8000) * STEP, voltage, 1e6 * plant.record(voltage)])
    np.savetxt(tmp_path / "fast.csv", table, delimiter=",", header="time_s,voltage_V,position_um", comments="")
    arguments = ["identify", str(tmp_path / "fast.csv"), "--model", "proportional", "-o", str(tmp_path / "axis.yaml")]
    without = CliRunner().invoke(main, [*arguments, "--linear", "lag"])
    assert without.exit_code == 4 and "fit_for_feedback: false" in (tmp_path / "axis.yaml").read_text(encoding="utf-8")
    lines = [line for line in without.stderr.splitlines() if "not fit for feedback with a crossover of" in line]
    assert len(lines) == 1 and "rings at 30" in lines[0]
    (safe,) = re.findall(r"it is fit up to (\S+) Hz", lines[0])
    slowed = design(tmp_path, "axis.yaml", "--controller", "pid")
    assert slowed.exit_code == 0 and f"no crossover above {safe} Hz is known to be safe" in slowed.stdout
    assert CliRunner().invoke(main, arguments).exit_code == 0


def design(folder, name: str, *options: str):
    return CliRunner().invoke(main, ["design", str(folder / name), "-o", str(folder / "designed.yaml"), *options])


@pytest.mark.slow
def test_a_design_keeps_below_what_is_unknown_or_is_refused_with_the_frequency(slow):
    folder, _ = slow
    slowed = design(folder, "axis.yaml", "--controller", "pid")
    assert slowed.exit_code == 0 and "note: bandwidth reduced to" in slowed.stdout
    reached = next(line for line in slowed.stdout.splitlines() if line.startswith("bandwidth reached"))
    assert float(reached.split()[2]) < 10.0
    refused = design(folder, "axis.yaml", "--controller", "pid", "--bandwidth", "60")
    assert refused.exit_code == 2 and "is not accurate enough for this feedback at" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
    # without the entry of the identification, designs are not limited
    text = (folder / "axis.yaml").read_text(encoding="utf-8")
    (folder / "bare.yaml").write_text(text[: text.index("/identification:")], encoding="utf-8")
    assert "slowed down" not in design(folder, "bare.yaml", "--controller", "pid").stdout


@pytest.mark.slow
def test_an_uncertainty_that_is_none_is_refused_by_name(slow):
    folder, _ = slow
    text = (folder / "axis.yaml").read_text(encoding="utf-8")
    (folder / "wrong.yaml").write_text(text.replace("uncertainty: [", "uncertainty: [-1.0, "), encoding="utf-8")
    result = design(folder, "wrong.yaml", "--controller", "pid")
    assert result.exit_code == 2 and "response.uncertainty must have the same length" in result.stderr
