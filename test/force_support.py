# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of integral force feedback: the shipped stage with the result of a design for it."""

from __future__ import annotations

IFF = {
    "damping__type": "iff",
    "damping__iff__gain": 6.52e-5,
    "damping__iff__leak": 1360.0,
    "damping__iff__high_pass": 1360.0,
    "pid__Kp": 0.0532177,
    "pid__Ki": 1722.55,
    "pid__Kd": 9.72554e-5,
}
#: Without effects that hide small differences.
CLEAN = {"sensor__noise": 0.0, "force_sensor__noise": 0.0, "limits__bits": 0}


def changed(**values) -> dict[str, float]:
    """Return parameters with the names that a change uses."""
    return {name.replace("__", "."): value for name, value in (IFF | values).items()}
