# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs on a model without two light resonances, in loops with plants that have them."""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import close, margins_of
from hysteresis_ros.control.uncertainty import DAMPING, UNKNOWN, UNSEEN, ResponseUncertainty, fastest_integral
from hysteresis_ros.designs import controller as designing
from hysteresis_ros.designs.controller import DesignRequest, design_axis, design_lines, doubts, response_uncertainty
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.linear_systems import LinearPart, Mode
from hysteresis_ros.identification.response_check import MeasuredPlant
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import LinearParameters, StateSpace

RATE = 3000.0
STEP = 1.0 / RATE
LAG = 0.0015
#: Result of slow triangles: the response up to 20 Hz, to 30 %.
SLOW = ResponseUncertainty(np.array([1.0, 5.0, 20.0]), np.array([0.05, 0.1, 0.3]), 20.0)
#: The response is known at all frequencies.
KNOWN = ResponseUncertainty(np.array([1.0, 1500.0]), np.array([0.01, 0.01]), np.inf)
CONTROLLERS = ("pid", "offset_free", "integral_smc")


def axis(step: float = STEP, *modes: Mode):
    """Return an axis whose model is a lag, with modes if given."""
    dynamics = LinearPart(modes=modes, lag=LAG, hold=step).dynamics(step)
    values = {
        f"model.dynamics.{name}": list(value) if isinstance(value, tuple) else value
        for name, value in dynamics.to_mapping().items()
        if value != ()
    } | {"model.dynamics.sample_time": step}
    configuration = load_configuration("kim2009").override("motion_controller", type="open_loop", **values)
    if step != STEP:
        configuration = configuration.override("", sample_rate=1.0 / step)
        configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    return single_axis(configuration, None)


def held(dynamics: LinearParameters, gain: float) -> StateSpace:
    """Return a plant with the input held, and one sample of delay after it."""
    own = dynamics.state_space.held().scaled(gain)
    n = own.order
    A, B, C = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1)), np.zeros((1, n + 1))
    A[:n, :n], A[n, :n], C[0, n] = own.A, own.C[0], 1.0
    B[:n] = own.B
    return StateSpace(A, B, C, np.zeros((1, 1)))


def plants(step: float = STEP):
    """Return plants that equal the model up to 20 Hz, with modes of the smallest assumed damping."""
    for frequency, damping in ((35.0, 0.01), (165.0, DAMPING), (421.0, DAMPING), (900.0, DAMPING)):
        for gain in (0.9, 1.1) if frequency < 0.5 / step else ():
            part = LinearPart(modes=(Mode(frequency, damping),), lag=LAG, hold=step)
            yield frequency, held(part.dynamics(step), gain)


def radius(parameters, plant: StateSpace, step: float = STEP) -> float:
    """Return the largest modulus of the poles of the closed loop."""
    controller, _ = whole_loop(parameters, step)
    return float(np.max(np.abs(np.linalg.eigvals(close(controller, plant).A))))


@pytest.fixture(scope="module", autouse=True)
def known_gains():
    """Compute each gain once: the designs differ in what is known of the response, on which no gain depends."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(designing, "design_gains", functools.cache(designing.design_gains))
        yield


@functools.cache
def designed(controller: str, known: bool = False):
    """Return a design without a bound of the response, or with one that is known at all frequencies."""
    return design_axis(axis(), DesignRequest(controller), *((KNOWN,) if known else ()))


@pytest.fixture(scope="module")
def designs():
    """Return designs of every controller for the result of slow triangles; None if it is refused."""
    found = {}
    for controller in CONTROLLERS:
        try:
            found[controller] = design_axis(axis(), DesignRequest(controller), SLOW)
        except ConfigurationError as error:
            assert "is not accurate enough for this feedback" in str(error) and "damping 0.003" in str(error)
            found[controller] = None
    return found


@pytest.mark.slow
def test_no_controller_is_unstable_on_resonances_that_the_recording_did_not_show(designs):
    assert designs["pid"] is not None
    for controller, design in designs.items():
        if design is not None:
            unstable = [frequency for frequency, plant in plants() if not radius(design.parameters, plant) < 1.0]
            assert not unstable, f"{controller} is unstable with modes at {unstable} Hz"


@pytest.mark.slow
@pytest.mark.parametrize("rate", [4000.0])
def test_no_pid_is_unstable_on_them_at_other_rates(rate):
    """Of seven plants of such modes two were unstable at these rates."""
    step = 1.0 / rate
    design, bold = (design_axis(axis(step), DesignRequest("pid"), *known) for known in ((SLOW,), ()))
    radii = [radius(design.parameters, plant, step) for _, plant in plants(step)]
    assert max(radii) < 1.0, radii
    assert any(radius(bold.parameters, plant, step) > 1.0 for _, plant in plants(step)), "the plants are too easy"


@pytest.mark.slow
def test_without_the_bound_the_same_controllers_are_unstable():
    for controller in ("pid", "offset_free"):
        bold = designed(controller)
        assert any(radius(bold.parameters, plant) > 1.0 for _, plant in plants()), "the plants are too easy"


@pytest.mark.slow
def test_the_gain_of_the_feedback_stays_below_what_is_printed(designs):
    frequencies = np.geomspace(UNSEEN * SLOW.known_to * 1.01, 0.5 * RATE, 300)
    for design in filter(None, designs.values()):
        controller, _ = whole_loop(design.parameters, STEP)
        gain = np.abs(controller.response(np.exp(2j * np.pi * frequencies * STEP))[:, 0, 1])
        assert np.max(gain) < 0.8 / UNKNOWN
        note = next(text for text in doubts(design) if "bandwidth reduced to" in text)
        for words in ("above 20 Hz the plant is unknown", "damping 0.003", "a peak of 167 times", "below 0.0048"):
            assert words in note


def test_the_bound_does_not_follow_the_model_where_nothing_is_known():
    # a model with a steep roll-off does not bound the plant there
    steep = LinearPart(lag=0.02, hold=STEP).dynamics(STEP).state_space.held()
    flat = LinearPart(lag=1e-4, hold=STEP).dynamics(STEP).state_space.held()
    controller = StateSpace(np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((1, 1)), np.array([[0.02, -0.02]]))
    distances = [SLOW.borne_by(controller, plant, STEP).distance for plant in (steep, flat)]
    assert max(distances) < 0.0


def test_a_known_response_is_not_slowed_down():
    whole = ResponseUncertainty(np.array([1.0, 1200.0]), np.array([0.01, 0.02]), np.inf)
    first = designed("pid")
    known = design_axis(axis(), DesignRequest("pid"), whole)
    assert known.margins.bandwidth == first.margins.bandwidth and known.limited is None


# -- in the time domain ------------------------------------------------------------------------------------------------

#: A recording with content up to 0.35 of the sample rate, with an uncertainty of 5 %.
FAST = ResponseUncertainty(np.array([1.0, 0.35 * RATE]), np.array([0.05, 0.05]), 0.35 * RATE)
JUMP, NOISE, SAMPLES = 10e-6, 45e-9, 6000


def crossover_of(parameters) -> float:
    """Return the highest frequency [Hz] at which the loop on the model has a gain of 1."""
    controller, plant = whole_loop(parameters, STEP)
    frequencies = np.geomspace(0.01, 0.499 / STEP, 20000)
    z = np.exp(2j * np.pi * frequencies * STEP)
    gain = np.abs(controller.response(z)[:, 0, 1] * plant.response(z)[:, 0, 0])
    return float(frequencies[np.flatnonzero(gain >= 1.0)[-1]])


@pytest.mark.slow
def test_a_bandwidth_that_needs_a_roll_off_gets_one():
    """A pid cancels one of two light modes, and the other one limits its M_s long before this bandwidth."""
    light = axis(STEP, Mode(250.0, 0.005), Mode(400.0, 0.003))
    design = design_axis(light, DesignRequest("pid", bandwidth=20.0), FAST)
    controller, plant = whole_loop(design.parameters, STEP)
    assert design.parameters.pid.roll_off > 0.0 and not design.misses()
    assert margins_of(controller, plant, STEP).bandwidth == pytest.approx(20.0, rel=0.03)
    assert not [line for line in design_lines(design) if "reduced" in line or "cancels" in line]
    with pytest.raises(ParameterError, match="with its roll-off; request a lower bandwidth, or none") as refused:
        design_axis(light, DesignRequest("pid", bandwidth=290.0))
    most = float(re.search(r"reaches at most ([\d.]+) Hz", str(refused.value))[1])
    assert most > 60.0
    assert design_axis(light, DesignRequest("pid")).margins.bandwidth == pytest.approx(most, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_no_loop_is_faster_than_a_recording_that_rings_permits(controller):
    known = ResponseUncertainty(KNOWN.frequencies, KNOWN.relative, np.inf, crossover=8.4)
    assert crossover_of(designed(controller, known=True).parameters) > 20.0
    found = design_axis(axis(), DesignRequest(controller), known)
    assert 2.0 < crossover_of(found.parameters) < 8.6
    assert found.limited is known and "no crossover above 8.4 Hz is known to be safe" in known.assumption(STEP)
    asked = DesignRequest(controller, bandwidth=100.0)
    if controller == "pid":  # the others are as fast in their response to the reference with less feedback
        with pytest.raises(ConfigurationError, match="above 8.4 Hz is known to be safe; request a bandwidth"):
            design_axis(axis(), asked, known)
    else:
        assert crossover_of(design_axis(axis(), asked, known).parameters) < 8.6
    none = ResponseUncertainty(KNOWN.frequencies, KNOWN.relative, np.inf, crossover=0.0)
    with pytest.raises(ConfigurationError, match="no crossover above 0 Hz is known to be safe"):
        design_axis(axis(), DesignRequest(controller), none)


#: What an identification writes about a response; the rest of the file does not matter here.
WRITTEN = "/identification:\n  ros__parameters:\n    response: {frequencies: [1.0, 2.0], uncertainty: [0.1, 0.1]%s}\n"


def test_a_file_that_rings_without_a_certain_crossover_is_refused_with_the_missing_entry():
    known = response_uncertainty(parse_configuration(WRITTEN % ", ringing: [30.0], certain_crossover_hz: 8.4", "axis"))
    assert known is not None and known.crossover == 8.4
    with pytest.raises(ConfigurationError, match="response.certain_crossover_hz is missing") as refused:
        response_uncertainty(parse_configuration(WRITTEN % ", ringing: [30.0]", "axis"))
    assert "same length" not in str(refused.value)
    without = response_uncertainty(parse_configuration(WRITTEN % "", "axis"))
    assert without is not None and np.isinf(without.crossover)


def largest_late(parameters, plants) -> np.ndarray:
    """Return the largest displacement in the second half of a noisy step of the reference, relative to the step.

    The loops of all plants, which have the same order, are stepped together; an unstable loop has inf.
    """
    controller, _ = whole_loop(parameters, STEP)
    A, B, C = (np.stack([getattr(plant, name) for plant in plants]) for name in "ABC")
    inside, state = np.zeros((len(A), controller.order)), np.zeros((len(A), A.shape[1]))
    noise = NOISE * np.random.default_rng(3).standard_normal(SAMPLES)
    late, bounded, given = np.zeros(len(A)), np.ones(len(A), dtype=bool), np.empty((len(A), 2))
    for k in range(SAMPLES):
        displacement = np.where(bounded, (C @ state[:, :, None])[:, 0, 0], 0.0)
        bounded &= np.abs(displacement) < 1e3 * JUMP
        if k >= SAMPLES // 2:
            late = np.maximum(late, np.abs(displacement))
        given[:, 0], given[:, 1] = JUMP, displacement + noise[k]
        command = inside @ controller.C[0] + given @ controller.D[0]
        inside = inside @ controller.A.T + given @ controller.B.T
        state = (A @ state[:, :, None])[:, :, 0] + B[:, :, 0] * command[:, None]
        inside[~bounded], state[~bounded] = 0.0, 0.0
    return np.where(bounded, late / JUMP, np.inf)


def unseen(frequency: float, damping: float, part: float) -> StateSpace:
    """Return the model with a mode through which a fraction of the displacement passes."""
    lag = held(LinearPart(lag=LAG, hold=STEP).dynamics(STEP), 1.0 - part)
    mode = held(LinearPart(modes=(Mode(frequency, damping),), hold=STEP).dynamics(STEP), part)
    n, m = lag.order, mode.order
    A = np.block([[lag.A, np.zeros((n, m))], [np.zeros((m, n)), mode.A]])
    return StateSpace(A, np.vstack([lag.B, mode.B]), np.hstack([lag.C, mode.C]), np.zeros((1, 1)))


def slow_plants():
    """Return plants with modes above 20 Hz."""
    for frequency in (40.0, 165.0, 421.0, 900.0):
        for damping in (DAMPING, 0.02):
            part = LinearPart(modes=(Mode(frequency, damping),), lag=LAG, hold=STEP)
            yield held(part.dynamics(STEP), 1.0)


def fast_plants():
    """Return plants with modes between 0.35 and 0.5 of the rate that change the known response by at most 5 %."""
    for part_of_rate in (0.4, 0.44, 0.48):
        for damping in (DAMPING, 0.02):
            most = 0.05 * ((part_of_rate / 0.35) ** 2 - 1.0)
            for part in (most, -most):
                yield unseen(part_of_rate * RATE, damping, part)


#: The response is known up to 300 Hz, to 10 %; behind the model's lag an integrator alone is certain to 1.4 Hz.
PARTLY = ResponseUncertainty(np.array([1.0, 300.0]), np.array([0.1, 0.1]), 300.0)
QUICK = 0.0003


def quick_axis():
    """Return an axis at 3 kHz whose model is a short lag."""
    dynamics = LinearPart(lag=QUICK, hold=STEP).dynamics(STEP).to_mapping()
    values = {f"model.dynamics.{name}": dynamics[name] for name in dynamics if dynamics[name] != ()}
    lists = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
    return single_axis(load_configuration("kim2009").override("motion_controller", type="open_loop", **lists), None)


@pytest.fixture(scope="module")
def rolled():
    return design_axis(quick_axis(), DesignRequest("pid"), PARTLY)


def unseen_plants(late: float = 0.0):
    """Return the quick plant with a mode above 1.7 times the known range through which everything passes."""
    for frequency in np.geomspace(1.75 * PARTLY.known_to, 0.49 * RATE, 12):
        part = LinearPart(modes=(Mode(float(frequency), DAMPING),), lag=QUICK, hold=STEP, delay=late * STEP)
        yield float(frequency), held(part.dynamics(STEP), 1.0)


@pytest.mark.slow
def test_a_roll_off_gives_a_crossover_that_an_integrator_alone_does_not_have(rolled):
    alone = fastest_integral(whole_loop(rolled.parameters, STEP)[1], STEP, PARTLY)
    assert rolled.parameters.pid.roll_off > 0.0 and crossover_of(rolled.parameters) > 5.0 * alone > 1.0
    assert rolled.margins.sensitivity_peak < 1.61 and not rolled.misses()
    # the margins and the distance of the unknown resonance again, from the formula of the loop
    f = np.geomspace(0.01, 0.4999 * RATE, 40000)
    z = np.exp(2j * np.pi * f * STEP)
    gains, a = rolled.parameters.pid, np.exp(-rolled.parameters.pid.roll_off * STEP)
    feedback = 0.5 * STEP * gains.Ki * (z + 1.0) / (z - 1.0) * ((1.0 - a) * z / (z - a)) ** 2
    pole = np.exp(-STEP / QUICK)
    loop = feedback * (1.0 - pole) / (z - pole)  # the lag behind the hold, with the sample of the loop
    resonance = np.where(f > 1.75 * PARTLY.known_to, UNKNOWN, 0.0)
    relative = np.where(f > 1.75 * PARTLY.known_to, 1.0, 0.1)
    distance = np.abs(1.0 + loop) - relative * np.abs(loop) - resonance * np.abs(feedback)
    assert np.min(distance) > 0.19 and np.max(1.0 / np.abs(1.0 + loop)) < 1.65


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0, 1.0])
def test_the_rolled_off_loop_is_stable_on_every_resonance_even_a_sample_late(rolled, late):
    for frequency, plant in unseen_plants(late):
        assert radius(rolled.parameters, plant) < 1.0, frequency
    plain = design_axis(quick_axis(), DesignRequest("pid"))
    assert any(radius(plain.parameters, plant) > 1.0 for _, plant in unseen_plants(late)), "the plants are too easy"


@pytest.mark.slow
def test_the_rolled_off_loop_stays_bounded_in_the_time_domain(rolled):
    late = largest_late(rolled.parameters, [plant for _, plant in unseen_plants(1.0)])
    assert max(late) < 2.0, late


@pytest.mark.slow
def test_a_gain_of_small_loops_that_may_be_higher_keeps_the_margins():
    text = WRITTEN % ", fit_for_feedback: true" + "    metrics: {small_loop_gain_high_percent: 100.0}\n"
    known = response_uncertainty(parse_configuration(text, "axis"))
    assert known is not None and known.gain == pytest.approx(2.0)
    higher = ResponseUncertainty(KNOWN.frequencies, KNOWN.relative, np.inf, gain=2.0)
    bold, found = designed("pid", known=True), design_axis(axis(), DesignRequest("pid"), higher)
    peaks = []
    for one in (bold, found):
        controller, plant = whole_loop(one.parameters, STEP)
        peaks.append(margins_of(controller, plant.scaled(2.0), STEP).sensitivity_peak)
    assert peaks[0] > 2.0 and peaks[1] < 2.01
    assert "up to 100 % higher; M_s there" in "".join(design_lines(found))


@pytest.mark.slow
def test_loops_on_modes_that_were_not_seen_stay_bounded(designs):
    for name, design in designs.items():
        if design is not None:
            late = largest_late(design.parameters, [*slow_plants()])
            assert max(late) < 2.0, f"{name}: {late}"


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["pid", "integral_smc"])
def test_loops_on_modes_just_below_half_the_sample_rate_stay_bounded(controller):
    design = design_axis(axis(), DesignRequest(controller), FAST)
    late = largest_late(design.parameters, [*fast_plants()])
    assert max(late) < 2.0, late
    assert max(largest_late(designed(controller).parameters, [*fast_plants()])) == np.inf, "the plants are too easy"


def test_what_an_identification_calls_known_ends_where_the_content_does():
    lines = np.linspace(10.0, 0.4 * RATE, 120)
    measured = MeasuredPlant(lines, np.ones(120, dtype=complex), np.full(120, 0.01))
    assert measured.uncertainty(np.ones(120), STEP).known_to == lines[-1]
    whole = MeasuredPlant(np.linspace(10.0, 0.499 * RATE, 120), np.ones(120, dtype=complex), np.full(120, 0.01))
    assert np.isinf(whole.uncertainty(np.ones(120), STEP).known_to)
