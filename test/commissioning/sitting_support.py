# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of commissioning."""

from __future__ import annotations

from commissioning_support import RATE, ForeignBench

from hysteresis_ros.cli.commissioning.new_file import NewAxis, write_new
from hysteresis_ros.cli.commissioning.situation import Folder, Situation, plan_of
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis

#: Entries of the plan that make a commissioning short.
SHORT = "    noise_duration: 0.5\n    cycle_frequency: 2.0\n    creep_duration: 2.0\n"


def sitting(folder, resumed=False, plan="", **choices):
    """Return the situation of a commissioning of a new axis."""
    path = folder / "stage.yaml"
    if not path.exists():
        write_new(path, NewAxis(100e-6, 0.0, 100.0, RATE))
        path.write_text(path.read_text() + SHORT + plan)
    configuration = load_configuration(path)
    axis = single_axis(configuration)
    kept = Folder(folder / "kept", configuration.text, ForeignBench.name, resumed)
    choices = {"model": "prandtl_ishlinskii", "controller": "pid", "against": ("polynomial",), **choices}
    return Situation(configuration, axis, plan_of(configuration, axis), kept, **choices)
