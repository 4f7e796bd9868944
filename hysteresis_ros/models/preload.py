# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Offset of a stack's displacement under a preload (K3)."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.parameters import Parameters, parameter


@dataclass(frozen=True)
class PreloadParameters(Parameters):
    """Preload L0 and the coefficients of W = A1 + B1 L0 + B2 L0² (Kim, Kim & Park 2009, eqs 3-5)."""

    force: float = parameter(0.0, description="preload L0, compressing", unit="N", low=0.0)
    A1: float = parameter(0.0, description="offset without preload", unit="m")
    B1: float = parameter(0.0, description="compliance: offset per preload", unit="m/N")
    B2: float = parameter(0.0, description="change of the compliance with the preload", unit="m/N²")

    @property
    def offset(self) -> float:
        """Offset W of the displacement [m]."""
        return self.A1 + self.force * (self.B1 + self.force * self.B2)
