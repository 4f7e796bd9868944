# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Commissioning: from a new parameter file to a verified closed loop, stage by stage; imports no ROS.

Read ``stages`` first (the order of the stages and what each moves), then ``situation`` (the data that all stages
share), and the stages themselves: ``measuring`` (open loop), ``fitting`` (model and controller), ``closed_loop``.
``bench`` runs an axis for a stage; ``new_file`` writes the first parameter file.
"""
