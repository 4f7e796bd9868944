# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs: from a model or a measured response to the parameters of a controller.

Start with :mod:`.controller` (``hysteresis design``), which uses :mod:`.gains` and :mod:`.damping`. :mod:`.learning`
designs the learning for periodic references with :mod:`.learning_filters`. :mod:`.frequency_response` measures an axis;
:mod:`.measured` and :mod:`.setpoint_step` verify a design. A design for only one control law is in the module of that
law. Coupled axes: :mod:`.stage_identification`, :mod:`.coupled`, :mod:`.stage_feedforward`, and
:mod:`.coupled_learning`, which learns from run to run.
"""
