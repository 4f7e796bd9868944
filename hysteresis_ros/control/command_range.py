# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an axis may be commanded, whatever its law wants."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class CommandRangeParameters(Parameters):
    """Least and largest command that is sent."""

    command_minimum: float = parameter(
        0.0,
        unit="m",
        low=-1.0,
        high=1.0,
        description="least command that is sent, whatever the law wants; this and command_maximum 0: a stroke of the "
        "compensator's model beyond its ends, where the whole axis is known, else any",
    )
    command_maximum: float = parameter(0.0, unit="m", low=-1.0, high=1.0, description="largest command that is sent")

    @property
    def command_range(self) -> tuple[float, float]:
        """Least and largest command that is sent [m]."""
        if self.command_minimum == self.command_maximum == 0.0:
            return -math.inf, math.inf
        return self.command_minimum, self.command_maximum

    def check(self):
        """Yield a Problem when the range is empty."""
        yield from super().check()
        low, high = self.command_range
        if not low < high:
            yield Problem("command_maximum", high, f"must be above command_minimum = {low:g} m")
