# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Feedforward inverse of creep: what the hysteresis must give so that both together give the command."""

from __future__ import annotations

from hysteresis_ros.block import kernel
from hysteresis_ros.models.creep import FEEDTHROUGH, crept


@kernel
def creep_inverse(p, x, y):
    """Input [m] at which the creep model gives ``y`` [m] at this sample; its state ``x`` is left as it is.

    Exact at the samples. The model advances by what is really carried out. Without operators the result is ``y``, bit
    for bit.
    """
    return (y - crept(p, x)) / p[FEEDTHROUGH]
