# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""All readers that are fuzzed, by name."""

from __future__ import annotations

import bag_targets
import device_targets
import node_targets
import parameter_targets
import picture_targets
import table_targets
import word_targets

_MODULES = (table_targets, parameter_targets, bag_targets, device_targets, word_targets, picture_targets, node_targets)

TARGETS = {target.name: target for module in _MODULES for target in module.TARGETS}
