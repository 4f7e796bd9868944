# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The kinds of damping there are: those of the folder ``kinds`` and those that other packages add by an entry point."""

from __future__ import annotations

import hysteresis_ros.control.damping.kinds  # noqa: F401  (its folder is searched)
from hysteresis_ros.control.damping.kind import DampingKind
from hysteresis_ros.registry import discover

#: Group of entry points by which a package adds a kind: ``lead = my_package.lead:DAMPING``.
GROUP = "hysteresis_ros.damping"

#: What each kind declares, by type; ``none`` beside them is no damping.
KINDS: dict[str, DampingKind] = discover("hysteresis_ros.control.damping.kinds", "DAMPING", DampingKind, GROUP)

#: Type without damping.
NONE = "none"
