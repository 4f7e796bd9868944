# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Margins from the lines of a measured loop are those of the loop, and lie within the bounds of its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.control.margins import NOWHERE, Interval, MeasuredLoop, loop_of, loop_transfer, margins_of
from hysteresis_ros.control.uncertainty import integral_controller
from hysteresis_ros.models.linear import StateSpace

RATE = 1000.0
#: 120 Hz with 20 % damping, held for one sample, unit gain at rest.
POLE = np.exp((-0.2 + 1j * np.sqrt(1 - 0.04)) * 2.0 * np.pi * 120.0 / RATE)
BARE = StateSpace(
    np.array([[2.0 * POLE.real, -(abs(POLE) ** 2)], [1.0, 0.0]]),
    np.array([[1.0], [0.0]]),
    np.array([[abs(1.0 - POLE) ** 2, 0.0]]),
    np.zeros((1, 1)),
)
PLANT = BARE.held()
CONTROLLER = integral_controller(25.0, 1.0 / RATE)
LINES = np.arange(1.0, 400.0, 1.0)


def measured(radius, frequencies=LINES):
    z = np.exp(2j * np.pi * frequencies / RATE)
    plant = PLANT.response(z)[:, 0, 0]
    return loop_of(CONTROLLER, frequencies, plant, radius * np.abs(plant), 1.0 / RATE)


def test_margins_are_those_of_the_loop():
    model, found = margins_of(CONTROLLER, PLANT, 1.0 / RATE), measured(0.0)
    z = np.exp(2j * np.pi * LINES / RATE)
    np.testing.assert_allclose(found.loop, loop_transfer(CONTROLLER, PLANT, z))
    assert found.gain_crossovers == pytest.approx(model.gain_crossovers, rel=1e-3)
    assert found.gain_margin.value == pytest.approx(model.gain_margin, abs=0.02)
    assert found.phase_margin.value == pytest.approx(model.phase_margin, abs=0.1)
    assert found.delay_margin.value == pytest.approx(model.delay_margin_samples, rel=1e-3)
    assert found.sensitivity_peak.value == pytest.approx(model.sensitivity_peak, rel=1e-3)
    np.testing.assert_allclose(found.sensitivity + found.complementary, 1.0)
    assert len(found.rows()) == len(found.rows(model)) == 5
    assert "; model " in found.rows(model)[0][1]


def test_a_sample_of_delay_costs_a_sample_of_delay_margin():
    late = MeasuredLoop(LINES, measured(0.0).loop * np.exp(-2j * np.pi * LINES / RATE), 0.0 * LINES, 1.0 / RATE)
    assert late.delay_margin.value == pytest.approx(measured(0.0).delay_margin.value - 1.0, abs=1e-3)


def test_margins_of_whatever_lies_in_the_circles_lie_in_their_intervals():
    found, random = measured(0.1), np.random.default_rng(1)
    names = ("gain_margin", "phase_margin", "delay_margin", "sensitivity_peak")
    widest = dict.fromkeys(names, 0.0)
    for _ in range(200):
        # one factor for all lines: another plant within the uncertainty
        factor = 1.0 + 0.1 * random.uniform() * np.exp(2j * np.pi * random.uniform())
        other = MeasuredLoop(LINES, found.loop * factor, found.radius, found.sample_time)
        for name in names:
            interval, value = getattr(found, name), getattr(other, name).value
            # to first order: the change of the crossover is neglected
            slack = 0.3 * (interval.high - interval.low)
            assert interval.low - slack < value < interval.high + slack, name
            widest[name] = max(widest[name], abs(value - interval.value) / (interval.high - interval.low))
    assert all(part > 0.2 for part in widest.values()), widest
    radius = np.abs(found.sensitivity) ** 2 * found.radius
    np.testing.assert_allclose(found.sensitivity_radius, radius)
    error = 1.0 / (1.0 + found.loop * 1.001) - found.sensitivity
    np.testing.assert_allclose(np.abs(error), 0.01 * radius, rtol=0.01)


def test_what_the_band_does_not_show_has_no_value():
    found = measured(0.1, np.arange(200.0, 300.0))
    assert found.phase_margin == found.delay_margin == NOWHERE and found.gain_crossovers.size == 0
    assert found.phase_margin.text() == "none in the band"
    blind = measured(5.0)
    assert np.isinf(blind.sensitivity_peak.high) and "?" in blind.sensitivity_peak.text()
    assert Interval(1.0, 0.5, 2.0).text(".1f", " dB") == "1.0 dB (0.5 … 2.0)"
