# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common settings of the tests of the motor record."""

from __future__ import annotations

from hysteresis_ros.laboratory.epics.record import MotorSettings

#: An axis of 0 … 12 µm without its own speed limit.
SETTINGS = MotorSettings(
    name="t:m1",
    namespace="",
    source="reference_generator",
    joint="extender",
    low=0.0,
    high=12e-6,
    velocity=0.0,
    acceleration=0.0,
    tolerance=2e-8,
    dwell=0.1,
    timeout=5.0,
    unit="um",
    precision=4,
)
