# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Controllers that run in the loop, and the robustness of linear loops.

Start with :mod:`.law` (definition and declaration of a controller) and one file in ``laws/``, then read
:mod:`.controller`, which chooses among the laws. ``damping/`` contains inner loops for any law; :mod:`.learning` and
:mod:`.feedforward` supplement a law. :mod:`.margins` and :mod:`.uncertainty` evaluate loops; designs of gains are in
:mod:`hysteresis_ros.designs`.
"""
