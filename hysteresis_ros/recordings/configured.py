# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the configuration kept in a recording says about a node."""

from __future__ import annotations

from hysteresis_ros.configuration import Configuration, parse_configuration
from hysteresis_ros.errors import HysteresisError


def described(text: str, node: str, namespace: str = "") -> bool:
    """Tell whether the configuration in a recording has a section of ``node`` itself, not only one for every node."""
    configuration = _parsed(text)
    return configuration is not None and configuration.describes(node, namespace)


def configured(text: str, node: str, namespace: str = "") -> dict:
    """Return the flat dotted parameters of ``node``; empty when the text is empty or no ROS 2 parameter file.

    A recording must stay readable whatever text somebody published on ``configuration``, so nothing is raised.
    """
    configuration = _parsed(text)
    return {} if configuration is None else configuration.node(node, namespace)


def _parsed(text: str) -> Configuration | None:
    if not text:
        return None
    try:
        return parse_configuration(text, "configuration of the recording")
    except HysteresisError:
        return None
