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

import functools

from hysteresis_ros.configuration import Configuration, dump_configuration, parse_configuration
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.signals import COMPENSATOR, CONTROLLER, PLANT

#: Nodes whose parameters an axis needs, and the one that keeps no log.
LOGGED = {PLANT, CONTROLLER, COMPENSATOR}
OPTIONAL = ("displacement_camera",)


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


def in_force(recording: Recording) -> str:
    """Return the parameter file of what the nodes of a recording were really configured with.

    Their own log knows what a parameter file does not: values of the command line, and what was set before they began.

    Parameters
    ----------
    recording : Recording
        Of any axis; one without such a log gives the configuration in it.
    """
    known = recording.metadata.get("parameters", {})
    if not known.keys() >= LOGGED:
        return recording.configuration
    namespace = recording.metadata.get("namespace", "")
    nodes = {node: configured(recording.configuration, node, namespace) for node in OPTIONAL} | known
    given = {node: {name: value for name, value in values.items() if value != []} for node, values in nodes.items()}
    return dump_configuration({f"{namespace}/{node}": values for node, values in given.items() if values})


@functools.lru_cache(maxsize=4)
def _parsed(text: str) -> Configuration | None:
    # a page asks for the same text a few dozen times, and reading YAML takes longer than anything else of it
    if not text:
        return None
    try:
        return parse_configuration(text, "configuration of the recording")
    except HysteresisError:
        return None
