# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A whole plant: limits, hysteresis, lag, preload and a noisy sensor."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.models.actuator import Actuator, ActuatorParameters, PreloadParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.models.hysteresis.polynomial import assumed_stack
from hysteresis_ros.models.limits import LimitsParameters
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.sensor import SensorParameters

SAMPLE_TIME = 1.0 / 3000.0
LAG = LinearParameters(A=(0.8,), B=(0.2,), C=(1.0,))
PARAMETERS = ActuatorParameters(
    limits=LimitsParameters(minimum=-30.0, maximum=120.0, slew_rate=2e4, bits=16),
    hysteresis=HysteresisParameters(type="polynomial", polynomial=assumed_stack()),
    dynamics=LAG,
    preload=PreloadParameters(force=5.88, B1=-1e-6 / 0.41),
    sensor=SensorParameters(noise=5e-9, resolution=1e-9, seed=4),
)


def run(actuator, voltages):
    """Return measured displacement and achieved voltage of each sample."""
    return np.array([(actuator.measure(), actuator.advance(v)) for v in voltages])


def drive(count=400):
    return 60.0 + 80.0 * np.sin(2 * np.pi * np.arange(count) / 150.0)


def outputs():
    return run(Actuator(PARAMETERS, SAMPLE_TIME), drive())
