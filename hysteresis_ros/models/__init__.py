# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Models as blocks that work on plain arrays: hysteresis and dynamics of an actuator, their inverses, and sensors.

Start with :mod:`.block` (kernels and blocks), :mod:`.declaration` and one law in ``hysteresis/``. Then read
:mod:`.actuator`, which combines hysteresis, :mod:`.creep` and :mod:`.linear` dynamics, and :mod:`.compensator`, which
inverts hysteresis and creep. :mod:`.friction`, :mod:`.clamp` and :mod:`.inchworm` model the inchworm motor.

The package has a class for each hysteresis model; its constructor takes the parameters as keywords:
``hysteresis_ros.models.BoucWen(d_e=…, alpha=…, beta=…, gamma=…).simulate(voltage)``. ``dir()`` lists the classes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hysteresis_ros.models.classes import Hysteresis


def __getattr__(name: str) -> type[Hysteresis]:
    """Return the class of a hysteresis model; the class is imported on first use."""
    from hysteresis_ros.registry import find

    # when Python imports a submodule, it also looks up the submodule's name here
    if not name[:1].isupper():
        return find({}, name, __name__)
    from hysteresis_ros.models.classes import CLASSES

    return find(CLASSES, name, __name__)


def __dir__() -> list[str]:
    from hysteresis_ros.models.classes import CLASSES

    return sorted([*CLASSES, *(name for name in globals() if name.startswith("__"))])
