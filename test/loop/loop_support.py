# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of the loop: axes of the shipped configurations with changed parameters, and steps."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.reach import single_axis

#: A constant reference at the setpoint, for kim2009.
HOLD = {"reference_generator": {"waveform__type": "hold"}}
#: A reference of kim2009 with a period of 30 samples, and a controller that learns it.
TRIANGLE = {"waveform__type": "triangle", "waveform__frequency": 100.0, "waveform__amplitude": 4e-6}
LEARNS = {
    "learning__type": "repetitive",
    "learning__period": 0.01,
    "learning__error_filter": (0.05, 0.1, 0.05),
    "learning__lead": 4,
    "learning__robustness_filter": (0.5, 0.25),
    "learning__maximum": 5e-7,
}


def parameters(name="kim2009", **overrides):
    """Return the parameters of an axis; ``overrides`` by node, with double underscores for dots."""
    configuration = load_configuration(name)
    if name == "kim2009":  # as for a device: the file allows more late samples in a simulation
        configuration = configuration.override("plant_simulator", late_limit=0)
    for node, values in overrides.items():
        configuration = configuration.override("" if node == "every" else node, **values)
    return single_axis(configuration)


def axis(name="kim2009", **overrides):
    """Return an axis at rest; arguments as :func:`parameters`."""
    return Axis(parameters(name, **overrides))


def steps(values) -> np.ndarray:
    """Return the change of a signal from each sample to the next."""
    return np.abs(np.diff(values))


def assert_same_bits(one, other, first=0):
    """Refuse two runs of the same length (from sample ``first`` of the second) that differ in any bit."""
    for name, values in one.items():
        there = other[name][first : first + len(values)]
        np.testing.assert_array_equal(np.asarray(values).view(np.int64), there.view(np.int64), err_msg=name)
