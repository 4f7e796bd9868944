# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The error of each period of a run that learned."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.analysis.plots import chart_figure
from hysteresis_ros.analysis.run_charts import judged, learned_chart, period_errors
from hysteresis_ros.recordings.dataset import Recording

LEARNED = "/**/motion_controller:\n  ros__parameters:\n    learning.type: inversion\n    learning.period: 0.02\n"


def recording(text: str, samples: int = 95) -> Recording:
    time = np.arange(samples) * 1e-3
    error = 1e-6 * 0.5 ** (np.arange(samples) // 20)
    signals = {"reference": 3e-6 + error, "displacement": np.full(samples, 3e-6)}
    return Recording(time, signals, {}, {"configuration": text})


def test_it_is_that_of_the_whole_periods():
    ends, errors = period_errors(recording(LEARNED))
    np.testing.assert_allclose(errors, 1e-6 * 0.5 ** np.arange(4), rtol=1e-9)
    np.testing.assert_allclose(ends, [0.019, 0.039, 0.059, 0.079])


def test_it_is_drawn_where_something_was_learned_only():
    pytest.importorskip("matplotlib")
    (axis,) = chart_figure(learned_chart(judged(recording(LEARNED)))).axes
    assert axis.get_yscale() == "log" and len(axis.lines[0].get_ydata()) == 4
    assert learned_chart(judged(recording(LEARNED.replace("inversion", "none")))) is None
    assert learned_chart(judged(recording(LEARNED, samples=50))) is None
