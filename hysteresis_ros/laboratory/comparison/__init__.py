# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Comparison of all controllers and compensators for an axis, under the same conditions.

Start with ``tasks`` (references and plants), ``candidates`` (the designs) and ``rows`` (a candidate on plants);
``compare`` runs the comparison and ``table`` prints it.
"""
