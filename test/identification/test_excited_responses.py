# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frequency responses lie inside their bands as often as stated; noise, odd and even distortion are distinguished."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from excited_support import RATE, A, B, plant, truth

from hysteresis_ros.errors import ConfigurationError, IdentificationError
from hysteresis_ros.identification.excitations import Experiment, Plan, excitation, uniform
from hysteresis_ros.identification.frequency_response import analyse, plan_of_recording

#: One case each; number of seeds; which lines are counted, because neighbouring lines of a noise excitation are
#: correlated; and by how much more often than stated the band of one realisation may contain the response, because
#: absent distortion is estimated as zero or more.
KINDS = {
    "one realisation": (Experiment(period=0.4, realisations=1, periods=6), 60, 1, 0.06),
    "realisations": (Experiment(period=0.2, realisations=3, periods=3), 150, 1, 0.0),
    "stepped": (Experiment("stepped", low=4.0, period=0.1, points=25, settle=2), 60, 1, 0.0),
    "noise": (Experiment("noise", duration=16.0, period=1.0), 40, 3, 0.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_known_response_lies_inside_its_band_as_often_as_stated(kind):
    asked, seeds, apart, more = KINDS[kind]
    inside, count = {0.5: 0, 0.95: 0}, 0
    for seed in range(seeds):
        u, plan = excitation(replace(asked, seed=seed), RATE)
        found = analyse(plan, 1.0 / RATE, u, plant(u, 0.03, seed)).response.band(4.0, 300.0)
        error = np.abs(found.single - truth(found.frequency))[::apart]
        count += error.size
        for probability in inside:
            inside[probability] += np.count_nonzero(error < found.radius(probability)[::apart, 0, 0])
    for probability, number in inside.items():
        # four standard deviations of the count (exceeded in one of 16 000 such tests) and one per cent: the number of
        # independent averages of overlapping segments is itself an estimate
        slack = 4.0 * np.sqrt(probability * (1.0 - probability) / count) + 0.01
        assert -slack < number / count - probability < slack + more, (probability, number / count)
    assert count > 800


def test_a_sample_of_delay_is_seen_in_the_phase():
    u, plan = excitation(Experiment(period=0.4), RATE)
    y = plant(u, 0.01, 1)
    found = analyse(plan, 1.0 / RATE, u, np.roll(y, 1)).response.band(20.0, 150.0)
    late = np.exp(-2j * np.pi * found.frequency / RATE)
    radius = found.radius(0.999)[:, 0, 0]
    assert np.mean(np.abs(found.single - truth(found.frequency) * late) < radius) > 0.97
    assert not np.any(np.abs(found.single - truth(found.frequency)) < radius)


def play(u, radii=(0.02, 0.1, 0.3)):
    """Return play operators in parallel, the last of which is wider than the excitation."""
    found = np.zeros(u.size)
    for radius in radii:
        w = 0.0
        for k, value in enumerate(u):
            w = min(max(w, value - radius), value + radius)
            found[k] += w
    return found


#: The nonlinear element, and the distortion that it causes.
NONLINEAR = {
    "cubic": (lambda u: u + 0.2 * u**3, "odd"),
    "quadratic": (lambda u: u + 0.1 * u**2, "even"),
    "hysteresis": (lambda u: u + play(u), "odd"),
    "none": (lambda u: u, None),
}


@pytest.mark.parametrize("nonlinear", NONLINEAR)
@pytest.mark.parametrize("kind", ["one realisation", "stepped"])
def test_distortion_is_odd_or_even_as_the_plant_is_and_noise_is_noise(kind, nonlinear):
    law, expected = NONLINEAR[nonlinear]
    asked = replace(KINDS[kind][0], realisations=1 if kind == "stepped" else 3)
    u, plan = excitation(asked, RATE)
    sigma = 1e-3
    found = analyse(plan, 1.0 / RATE, u, plant(law(u), sigma, 3))
    low = found.response.frequency < 40.0
    levels = {name: np.sqrt(np.mean(getattr(found.distortion, name)[low] ** 2)) for name in ("noise", "odd", "even")}
    # for one line: the noise averaged over the periods, over the input there
    size = np.sqrt(np.mean(u**2) * 2.0 / (len(plan.lines) if kind != "stepped" else 1)) / 2.0
    samples = plan.samples[0] if kind != "stepped" else np.array(plan.samples)[low]
    assert levels["noise"] == pytest.approx(np.sqrt(np.mean(sigma**2 / samples / plan.periods)) / size, rel=0.35)
    for name in ("odd", "even"):
        if name == expected:
            assert levels[name] > 10.0 * levels["noise"], levels
        else:
            # up to 0.1 % of the largest level: after two periods the play operators have not settled completely
            assert levels[name] < 2.0 * levels["noise"] + 1e-3 * max(levels.values()), levels


def test_the_band_holds_the_distortion_of_the_realisations():
    # the best linear approximation of a cubic c is known: it adds 3 c σ² (Bussgang, for a Gaussian input)
    inside = []
    for seed in range(20):
        u, plan = excitation(Experiment(period=0.4, realisations=6, seed=10 * seed + 1), RATE)
        found = analyse(plan, 1.0 / RATE, u, plant(u + 0.5 * u**3, 1e-4, seed)).response
        best = truth(found.frequency) * (1.0 + 1.5 * np.mean(u**2))
        noise_alone = replace(found, total_variance=None, degrees=18.0)
        error = np.abs(found.single - best)
        inside.append([np.mean(error < one.radius()[:, 0, 0]) for one in (found, noise_alone)])
    both = np.mean(inside, axis=0)
    assert 0.91 < both[0] < 0.98 and both[1] < 0.2, both


def closed_loop(reference, noise, gain=0.05):
    """Return input and output of an integral controller around the plant, with noise at the output."""
    # y = P u + v, u = C (r - y): the closed loop as polynomials
    controller = np.array([0.0, gain]), np.array([1.0, -1.0])
    over = np.polymul(controller[0], B)
    under = np.polymul(controller[1], A)
    whole = np.polyadd(over, under)
    sensitivity = scipy.signal.lfilter(np.polymul(controller[0], A), whole, reference - noise)
    return sensitivity, scipy.signal.lfilter(B, A, sensitivity) + noise


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["noise", "multisine"])
def test_in_a_closed_loop_the_estimate_is_unbiased_where_that_of_input_and_output_alone_is_not(kind):
    asked = Experiment(kind, duration=200.0, period=0.5 if kind == "noise" else None, high=40.0, realisations=40)
    r, plan = excitation(asked, RATE)
    v = 0.5 * scipy.signal.lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(r.size))
    u, y = closed_loop(r, v)
    right = analyse(plan, 1.0 / RATE, u, y, r).response
    wrong = analyse(plan, 1.0 / RATE, u, y).response
    G = truth(right.frequency)
    errors = [np.abs(np.mean(found.single / G - 1.0)) for found in (right, wrong)]
    deviation = np.sqrt(np.mean(right.total_variance[:, 0, 0] / np.abs(G) ** 2) / G.size)
    assert errors[0] < 4.0 * deviation
    assert errors[1] > 8.0 * deviation
    assert np.mean(np.abs(right.single - G) < right.radius()[:, 0, 0]) > 0.85


def test_excitations_are_what_they_say():
    u, plan = excitation(Experiment(period=0.5, low=10.0, high=200.0), RATE)
    assert np.max(np.abs(u)) == pytest.approx(1.0) and plan.length == u.size
    table = u.reshape(4, 5, 500)
    np.testing.assert_allclose(table[:, 0], table[:, 4], atol=1e-12)
    spectrum = np.abs(np.fft.rfft(table[1, 0]))
    lines = np.array(plan.lines)
    assert np.all(lines % 2 == 1) and lines[0] == 5 and lines[-1] == 99
    excited = np.flatnonzero(spectrum > 1e-9 * spectrum.max())
    np.testing.assert_array_equal(excited, lines)
    left = np.setdiff1d(np.arange(5, 100, 2), lines)
    np.testing.assert_array_equal((left - 7) // 8, np.arange(11), err_msg="one of every four odd lines is left out")
    assert np.abs(np.corrcoef(table[0, 0], table[1, 0])[0, 1]) < 0.5, "each realisation has different phases"
    steps, plan = excitation(Experiment("stepped", low=10.0, high=400.0, points=6), RATE)
    frequencies = np.array(plan.lines) / np.array(plan.samples) * RATE
    np.testing.assert_allclose(frequencies, np.geomspace(10.0, 400.0, 6), rtol=0.01)
    assert plan.length == steps.size and np.max(np.abs(steps)) <= 1.0
    noise, plan = excitation(Experiment("noise", low=50.0, high=100.0, duration=20.0), RATE)
    f, power = scipy.signal.welch(noise, RATE, nperseg=1000)
    assert power[(f > 45) & (f < 105)].sum() > 0.95 * power.sum() and np.max(np.abs(noise)) <= 1.1
    assert Plan.from_text(plan.text) == plan
    assert uniform(1, 3) == pytest.approx(uniform(1, 5)[:3])


def test_a_shape_is_kept():
    for kind in ("multisine", "stepped", "noise"):
        flat, _ = excitation(Experiment(kind, low=10.0, high=100.0), RATE)
        bent, _ = excitation(Experiment(kind, low=10.0, high=100.0), RATE, lambda f: f / 50.0)
        sizes = [np.abs(np.fft.rfft(part)) for part in (flat, bent)]
        f = np.fft.rfftfreq(flat.size, 1.0 / RATE)
        for low, high in ((15.0, 25.0), (80.0, 95.0)):
            band = (f > low) & (f < high)
            ratio = np.sqrt(np.sum(sizes[1][band] ** 2) / np.sum(sizes[0][band] ** 2))
            assert low / 50.0 < ratio < high / 50.0, kind


@pytest.mark.parametrize(
    "asked, said",
    [
        (Experiment(high=501.0), "--high 501 Hz: must be above 0 and below half the sample rate, 500 Hz"),
        (Experiment(low=0.4), "a period of 2 s resolves nothing below 0.5 Hz"),
        (Experiment("noise", low=0.4, period=1.0), "a segment of 1 s resolves nothing below 1 Hz"),
        (Experiment("stepped", low=1.0, duration=20.0), "a block of 0.1 s resolves nothing below 10 Hz"),
        (Experiment(low=90.0, high=80.0), "must be below --high 80 Hz"),
        (Experiment(low=10.0, high=12.0, period=1.0), "contains 1 lines"),
        (Experiment(period=1.0, duration=1.0), "exclude each other"),
        (Experiment(duration=1e-3), "--duration 0.001 s: must be at least 0.008 s"),
        (Experiment(periods=1), "--periods 1: must be at least 2"),
        (Experiment("sine"), "must be one of multisine, stepped, noise"),
    ],
)
def test_what_cannot_be_excited_is_refused(asked, said):
    with pytest.raises(ConfigurationError, match=said.replace("(", r"\(")):
        excitation(asked, RATE)


@pytest.mark.parametrize("kind", ["multisine", "stepped", "noise"])
def test_too_weak_an_excitation_is_refused_with_its_ratio(kind):
    u, plan = excitation(Experiment(kind, period=0.4, low=5.0), RATE)
    found = analyse(plan, 1.0 / RATE, u, plant(u, 30.0, 1))
    with pytest.raises(
        IdentificationError, match=r"signal-to-noise ratio of the response is -?\d+\.\d dB.*at least 6 dB"
    ):
        found.require_excited()
    analyse(plan, 1.0 / RATE, u, plant(u, 0.01, 1)).require_excited()
    with pytest.raises(IdentificationError, match="the recording was cut off"):
        analyse(plan, 1.0 / RATE, u[:-1], u[:-1])


def test_a_recording_of_which_nobody_knows_the_excitation_is_periodic_or_noise():
    u, plan = excitation(Experiment(period=0.4, realisations=1), RATE)
    before = np.zeros(333)
    found = plan_of_recording(np.concatenate([before, u]), 1.0 / RATE)
    assert (found.kind, found.samples, found.lines) == ("multisine", (400,), plan.lines)
    assert found.first == 333 and found.settle == 1 and found.periods == 4
    every = np.tile(
        np.sin(2.0 * np.pi * np.outer(np.arange(400), np.arange(1, 40)) / 400.0 + np.arange(39) ** 2).sum(1), 6
    )
    levels = analyse(
        plan_of_recording(every, 1.0 / RATE), 1.0 / RATE, every, plant(every + every**3, 1e-3, 1)
    ).distortion
    assert np.isnan(levels.odd).all() and np.isnan(levels.even).all(), "even lines are excited: no distortion"
    noise, _ = excitation(Experiment("noise", duration=10.0), RATE)
    assert plan_of_recording(noise, 1.0 / RATE).kind == "noise"
    assert plan_of_recording(noise, 1.0 / RATE, 0.5).samples == (500, noise.size)
    late = np.concatenate([before, u])
    late[1500:1505] = late[1500]  # held, because the next samples were late
    assert plan_of_recording(late, 1.0 / RATE).samples == (400,)
    assert plan_of_recording(u, 1.0 / RATE, 0.2, "noise").samples == (200, u.size)
    for asked, said in (((7.0, "multisine"), "must contain at least two"), ((None, "multisine"), "is not periodic")):
        with pytest.raises(IdentificationError, match=said):
            plan_of_recording(noise, 1.0 / RATE, *asked)
    with pytest.raises(IdentificationError, match="made by hysteresis frf"):
        plan_of_recording(noise, 1.0 / RATE, kind="stepped")


@pytest.mark.slow
def test_segments_too_short_for_a_resonance_say_so():
    sharp = 2.0 * np.pi * 60.0 * np.array([-0.01 + 1j, -0.01 - 1j])
    over, under = scipy.signal.bilinear(*scipy.signal.zpk2tf([], sharp, abs(sharp[0]) ** 2), RATE)
    for period, blurred in ((0.5, True), (8.0, False)):
        u, plan = excitation(Experiment("noise", duration=120.0, period=period), RATE)
        y = scipy.signal.lfilter(over, under, u) + 1e-3 * np.random.default_rng(0).standard_normal(u.size)
        warnings = analyse(plan, 1.0 / RATE, u, y).response.warnings
        assert any("blur the response at 6" in text for text in warnings) == blurred
