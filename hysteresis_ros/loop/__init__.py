# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The compiled sample of an axis, and the offline twin that runs it.

Start with :mod:`.parameters`, then :mod:`.tick`. An axis has four parts: source, plant, controller and compensator;
each is a module of that name. :mod:`.watch` defines how a part reacts to missing input, and :mod:`.faults` defines
faults that replace an input. :mod:`.plant` counts late voltages and stops the axis when there are too many;
:mod:`.quiet` holds the command constant; :mod:`.ready` predicts when a move is ready; :mod:`.device` runs a driver in
the loop. :mod:`.axis` runs the parts from Python, :mod:`.fused` runs them in one thread, and :mod:`.simulation` runs
them offline and compares a recording with the offline run (``hysteresis verify``). :mod:`.stage` runs the axes of a
coupled stage together.
"""
