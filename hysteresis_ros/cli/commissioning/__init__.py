# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Commissioning: from a new parameter file to a verified closed loop, in steps called stages; imports no ROS.

Start with ``stages`` (their order, and what each one moves) and ``situation`` (the data that all stages share). The
stages are in ``measuring`` (open loop), ``fitting`` (model and controller) and ``closed_loop``. ``bench`` runs an axis
for a stage; ``new_file`` writes the first parameter file.
"""
