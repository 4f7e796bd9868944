# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""References: the desired position of an axis at each sample.

Start with :mod:`.generator`, which adds a waveform from ``waveforms/`` (:mod:`.declaration`) to an :mod:`.approach` or
a :mod:`.trajectory`. :mod:`.inchworm_sequencer` converts the setpoints of an inchworm motor to steps; :mod:`.recipes`
contains the excitations for identification; :mod:`.scan` and ``scans/`` contain paths of several axes over a plane.
:mod:`.moves` determines when a motion has arrived or settled; :mod:`.triggers` computes the triggers.

The package has a class for each waveform; its constructor takes the parameters as keywords:
``hysteresis_ros.references.Sine(amplitude=1e-6, frequency=10.0).samples(1000)``. ``dir()`` lists the classes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hysteresis_ros.references.approach import Approach, ApproachParameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters, reference_step
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters

if TYPE_CHECKING:
    from hysteresis_ros.references.classes import Reference

__all__ = [
    "Approach",
    "ApproachParameters",
    "ReferenceGenerator",
    "ReferenceParameters",
    "Waveform",
    "WaveformParameters",
    "reference_step",
]


def __getattr__(name: str) -> type[Reference]:
    """Return the class of a waveform; the class is imported on first use."""
    from hysteresis_ros.registry import find

    # when Python imports a submodule, it also looks up the submodule's name here
    if not name[:1].isupper():
        return find({}, name, __name__)
    from hysteresis_ros.references.classes import CLASSES

    return find(CLASSES, name, __name__)


def __dir__() -> list[str]:
    from hysteresis_ros.references.classes import CLASSES

    return sorted([*CLASSES, *(name for name in globals() if name.startswith("__"))])
