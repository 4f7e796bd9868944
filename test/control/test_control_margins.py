# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Margins: closed forms, scipy.signal and the time domain agree with the linearised kernels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.control.controller import ControllerParameters, ModelParameters, controller_block
from hysteresis_ros.control.laws.pid import PidParameters, pid_state_space
from hysteresis_ros.control.linearisation import at_rest, linear_loop, linearise, margins
from hysteresis_ros.control.margins import Requirements, close, judge, loop_transfer, margins_of, plant_state_space
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters, StateSpace, zero_order_hold

T = 1.0 / 3000.0
#: One entry per type: parameters with which the published axis runs.
TYPES = {
    "pid": {"pid.Kp": -0.1, "pid.Ki": 300.0, "pid.Kd": 4e-5, "pid.derivative_filter": 3000.0},
    "sliding_mode": {},
    "integral_sliding_mode": {"sliding_mode.rejection_pole": 0.5},
    "super_twisting": {"super_twisting.bound": 10.0},
}


def static(**gains):
    """PI on one sample of delay, T = 10 ms."""
    return ControllerParameters.from_mapping({"type": "pid"} | {f"pid.{name}": value for name, value in gains.items()})


def test_integral_control_of_one_sample_of_delay_is_the_closed_form():
    # Kp = Ki T/2 puts the zero on z = 0: L = g/(z - 1), g = Ki T. Pole 1 - g; L(-1) = -g/2;
    # |L| = 1 at 2 sin(w/2) = g with phase -90 deg - w/2; M_s = 1/(1 - g/2) at z = -1
    g, time = 0.5, 0.01
    found = margins(static(Kp=0.5 * g, Ki=g / time), time)
    assert max(found.poles, key=abs) == pytest.approx(1.0 - g)
    assert found.gain_margin == pytest.approx(20.0 * np.log10(2.0 / g))
    assert found.gain_reduction_margin == np.inf
    w = 2.0 * np.arcsin(0.5 * g)
    assert found.gain_crossovers == pytest.approx([w / (2.0 * np.pi * time)])
    assert found.phase_margin == pytest.approx(90.0 - np.degrees(0.5 * w))
    assert found.delay_margin == pytest.approx((0.5 * np.pi - 0.5 * w) / w * time)
    assert found.phase_crossovers == pytest.approx([50.0])
    assert found.sensitivity_peak == pytest.approx(1.0 / (1.0 - 0.5 * g))
    assert found.complementary_peak == pytest.approx(1.0, abs=1e-6)
    # |T|² = g²/(1 - 2 (1 - g) cos w + (1 - g)²) = 1/2
    p = 1.0 - g
    assert found.bandwidth == pytest.approx(np.arccos((1.0 + p * p - 2.0 * g * g) / (2.0 * p)) / (2.0 * np.pi * time))


def test_proportional_control_without_integral_loses_its_gain_margin_at_rest():
    # positive feedback, Kp = -k on one sample of delay: L = -k/z, 1 + c L(1) = 0 at c = 1/k
    found = margins(static(Kp=-0.25), 0.01)
    assert found.gain_margin == pytest.approx(20.0 * np.log10(4.0)) and found.gain_reduction_margin == np.inf
    assert found.phase_crossovers == pytest.approx([0.0])
    assert found.sensitivity_peak == pytest.approx(1.0 / 0.75)


def test_delay_margin_is_where_the_delayed_loop_loses_stability():
    g, time = 0.3, 0.01
    delay = margins(static(Kp=0.5 * g, Ki=g / time), time).delay_margin / time
    pole = [max(abs(np.roots(np.r_[1.0, -1.0, np.zeros(k - 1), g]))) for k in (int(delay), int(delay) + 1)]
    assert pole[0] < 1.0 < pole[1]


def test_a_modelled_delay_is_taken_from_the_delay_margin():
    g, time = 0.3, 0.01
    plain = static(Kp=0.5 * g, Ki=g / time)
    prompt = margins(plain, time)
    for samples in (1.0, 2.0):
        dynamics = LinearParameters(sample_time=time, delay=samples * time)
        late = margins(replace(plain, model=ModelParameters(dynamics=dynamics)), time)
        assert late.delay_margin == pytest.approx(prompt.delay_margin - samples * time)
        assert late.gain_crossovers == pytest.approx(prompt.gain_crossovers)
        assert late.delay_margin_samples == pytest.approx(late.delay_margin / time)


def test_phase_margin_is_the_nearer_side_of_minus_one():
    """Positive position feedback of a resonance: the gain crosses one below the resonance with a phase lead."""
    A, B = zero_order_hold([[0.0, 1.0], [-1.0, -0.1]], [[0.0], [1.0]], 0.05)
    plant = StateSpace(A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    feedback = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[0.0, 0.5]]))
    found = margins_of(feedback, plant, 0.05)
    crossing = loop_transfer(feedback, plant, np.exp(2j * np.pi * 0.05 * found.gain_crossovers))
    assert found.stable and np.abs(crossing) == pytest.approx(1.0)
    ahead = np.degrees(np.angle(crossing))
    assert 150.0 < ahead[0] < 180.0, "the phase lead is larger than any phase lag"
    assert found.phase_margin == pytest.approx(180.0 - ahead[0])
    # a loop rotated by this phase passes -1; a delay rotates the other way, by the rest of a turn
    assert np.min(np.abs(1.0 + crossing * np.exp(1j * np.radians(found.phase_margin)))) < 1e-6
    assert found.delay_margin > np.pi / (2.0 * np.pi * found.gain_crossovers[-1])


def test_noise_gains_are_those_of_a_noisy_run():
    g, time = 0.5, 0.01
    chosen = static(Kp=0.5 * g, Ki=g / time)
    found = margins(chosen, time)
    # T = g/(z - 1 + g): the pole p = 1 - g multiplies the variance by g²/(1 - p²)
    assert found.noise_gain == pytest.approx(g / np.sqrt(1.0 - (1.0 - g) ** 2), rel=1e-4)
    noise = np.random.default_rng(3).standard_normal(20000)
    controller, plant = controller_block(at_rest(chosen), time), LinearDynamics(chosen.model.dynamics, time)
    commands, places = [], []
    for value in noise:
        places.append(plant.output())
        commands.append(controller.step(0.0, places[-1] + value))
        plant.step(commands[-1])
    assert np.std(places) == pytest.approx(found.noise_gain, rel=0.02)
    assert np.std(commands) == pytest.approx(found.command_noise_gain, rel=0.02)


@pytest.mark.parametrize(
    ("gain", "samples", "missed"),
    [
        (0.9, 0.0, ()),
        (1.2, 0.0, ("M_s 2.5 above 2", "gain margin 4.44 dB below 6 dB", "delay margin 0.721 samples (7.21 ms)")),
        (0.48, 1.0, ("M_s 2.11 above 2",)),
        (0.4, 1.0, ()),
        (2.1, 0.0, ("unstable on its own model",)),
    ],
)
def test_what_a_loop_misses_is_said(gain, samples, missed):
    time = 0.01
    dynamics = LinearParameters(sample_time=time, delay=samples * time)
    chosen = static(Kp=0.5 * gain, Ki=gain / time)
    loop = pid_state_space(chosen.pid, time), plant_state_space(dynamics)
    found = margins_of(*loop, time)
    said = found.misses()
    assert len(said) == len(missed) and found.meets == (not missed), said
    assert all(text.startswith(start) for text, start in zip(said, missed, strict=True)), said
    assert judge(*loop, time).meets() == found.meets
    assert found.misses(Requirements(1e9, -1e9, 0.0)) == (said if gain > 2.0 else ())


def test_the_published_axis_bears_less_than_a_sample_of_delay(parameters):
    found = margins(parameters({"sliding_mode.beta": 0.0, "sliding_mode.eta": 0.0}), T)
    assert found.sensitivity_peak < 2.0 and found.gain_margin > 6.0
    (said,) = found.misses()
    assert said.startswith("delay margin 0.5") and said.endswith("ms) below 1 sample")


@pytest.mark.parametrize("kind", TYPES)
def test_a_search_judges_like_the_margins(parameters, kind):
    chosen = parameters({"type": kind} | TYPES[kind])
    quick, found = judge(*linear_loop(chosen, T), T), margins(chosen, T)
    assert quick.sensitivity_peak == pytest.approx(found.sensitivity_peak, rel=1e-2)
    assert quick.delay_margin == pytest.approx(found.delay_margin_samples, rel=1e-2)
    assert quick.bandwidth == pytest.approx(found.bandwidth, rel=1e-3)
    assert quick.noise_gain == pytest.approx(found.noise_gain, rel=2e-2)


@pytest.mark.parametrize("kind", TYPES)
def test_linear_loop_is_what_kernel_and_plant_do(parameters, kind):
    """A small step of the reference, sample by sample, compared with the linear closed loop."""
    changes = {"type": kind, "sliding_mode.beta": 0.0, "sliding_mode.eta": 0.0} | TYPES[kind]
    chosen = parameters(changes)
    whole = close(*linear_loop(chosen, T))
    step = 1e-18
    _, (linear,) = scipy.signal.dimpulse((whole.A, whole.B, whole.C, whole.D, 1.0), n=120)
    controller, plant = controller_block(at_rest(chosen), T), LinearDynamics(chosen.model.dynamics, T)
    controller.step(0.0, 0.0)
    measured = []
    for _ in range(120):
        measured.append(plant.output())
        plant.step(controller.step(step, measured[-1]))
    expected = step * np.cumsum(linear[:, 0])
    assert np.array(measured) == pytest.approx(expected, rel=1e-6, abs=1e-6 * step)


@pytest.mark.parametrize("kind", TYPES)
def test_frequency_response_is_scipys(parameters, kind):
    controller, plant = linear_loop(parameters({"type": kind} | TYPES[kind]), T)
    w = np.linspace(0.05, 3.1, 40)
    _, expected = scipy.signal.dfreqresp(scipy.signal.dlti(plant.A, plant.B, plant.C, plant.D, dt=1.0), w)
    assert plant.response(np.exp(1j * w))[:, 0, 0] == pytest.approx(expected, rel=1e-8)
    system = scipy.signal.dlti(controller.A, controller.B[:, 1:], controller.C, controller.D[:, 1:], dt=1.0)
    _, expected = scipy.signal.dfreqresp(system, w)
    scale = np.abs(expected).max()
    assert controller.response(np.exp(1j * w))[:, 0, 1] == pytest.approx(expected, rel=1e-6, abs=1e-9 * scale)


def test_pid_kernel_is_linearised_to_its_state_space(parameters):
    chosen = parameters({"type": "pid"} | TYPES["pid"])
    gains = chosen.pid
    z = np.exp(1j * np.linspace(0.01, 3.0, 30))
    scale = chosen.model.dynamics.resolved_input_scale / chosen.model.dynamics.output_scale
    found = linearise(controller_block(at_rest(chosen), T)).response(z)[:, 0, 1]
    assert found == pytest.approx(scale * pid_state_space(gains, T).response(z)[:, 0, 1], rel=1e-9)


def test_separation_poles_of_the_published_axis_are_controllers_and_filters(parameters):
    found = margins(parameters({"sliding_mode.beta": 0.0, "sliding_mode.eta": 0.0}), T)
    for pole in (0.930, -0.122, -0.700):  # K7
        assert np.min(np.abs(found.poles - pole)) < 1e-3
    assert found.stable
    assert len(found.poles[np.abs(found.poles) > 1e-6]) == 6


def test_boundary_layer_counts_with_its_slope_at_zero(parameters):
    # s+ = (phi - (beta / delta) Lambda) s inside the layer
    found = margins(parameters({"sliding_mode.eta": 0.0}), T)
    switching = -1.0744 * -0.7318 + 0.0904 * 0.3533 + 0.0781 * 0.2288
    assert np.min(np.abs(found.poles - (0.93 - 0.0002 / 0.01 * switching))) < 1e-3


def test_feedforward_limits_and_preload_do_not_change_the_loop(parameters):
    plain = {"type": "pid"} | TYPES["pid"]
    more = {"feedforward.type": "static", "pid.output_minimum": 0.0, "pid.output_maximum": 5.0}
    one, other = margins(parameters(plain), T), margins(parameters(plain | more | {"model.preload.A1": 1e-6}), T)
    assert other.sensitivity_peak == one.sensitivity_peak and other.bandwidth == one.bandwidth


def test_without_feedback_there_is_nothing_to_lose(parameters):
    found = margins(parameters({"type": "open_loop"}), T)
    assert found.gain_margin == found.phase_margin == found.delay_margin == np.inf
    assert found.sensitivity_peak == 1.0 and found.complementary_peak == 0.0


def test_units_of_the_model_do_not_matter(parameters):
    chosen = parameters({"type": "pid"} | TYPES["pid"])
    dynamics = chosen.model.dynamics
    scaled = replace(dynamics, B=tuple(1e3 * value for value in dynamics.B), output_scale=1e-9)
    other = replace(chosen, model=replace(chosen.model, dynamics=scaled), pid=_scaled(chosen.pid, 1e-3))
    assert margins(other, T).sensitivity_peak == pytest.approx(margins(chosen, T).sensitivity_peak, rel=1e-9)


def _scaled(gains: PidParameters, factor: float) -> PidParameters:
    return replace(gains, Kp=gains.Kp * factor, Ki=gains.Ki * factor, Kd=gains.Kd * factor)
