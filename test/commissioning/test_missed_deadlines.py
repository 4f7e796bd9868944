# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Messages about the errors of periods: which deadlines disturbed, and what does not repeat."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.cli.commissioning.closed_loop import in_time, missed_line, repetition_line


def test_a_period_with_a_missed_deadline_and_the_one_after_it_do_not_count():
    skipped = np.zeros((6, 5))
    skipped[1, 4] = skipped[3, 0] = 1.0
    np.testing.assert_array_equal(in_time(skipped), [True, False, False, False, False, True])


def test_it_says_how_many_periods_the_figure_is_of():
    kept = np.array([True, False, False, True, True])
    assert missed_line(1.25e-8, kept) == "deadlines were missed; error of the 3 undisturbed of 5 periods: 12.5 nm RMS"
    assert "no deadline" in missed_line(1e-8, np.ones(3, bool))
    assert "each of the 2 periods" in missed_line(np.nan, np.zeros(2, bool))


def test_what_does_not_repeat_is_told_from_what_does():
    """Deviations of +-a in two periods: the variance about their mean is 2 a² for one degree of freedom."""
    shape = 1e-7 * np.sin(np.linspace(0.0, 6.0, 50))
    measured, predicted = shape + np.array([[3e-9], [-3e-9]]), np.array([[2e-9], [-2e-9]]) + 0.0 * shape
    said = "4.243 nm RMS of the error does not repeat from period to period, predicted 2.828 nm"
    assert repetition_line(measured, 1.01 * predicted) == said.replace("2.828", "2.857")
    more = repetition_line(measured, 0.99 * predicted)
    assert more.startswith(said.replace("2.828", "2.8") + ": disturbances, missed deadlines or jitter")
    # the mean of two such periods still has a² of the variance, which does not count as repeating
    size = 1e9 * np.sqrt(np.mean(shape**2) - 3e-9**2)
    assert more.endswith(f"the accuracy of the model, is {size:.4g} nm RMS, predicted 0 nm")
