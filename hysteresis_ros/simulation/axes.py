# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axes that a configuration describes, each with a reference it can follow."""

from __future__ import annotations

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.simulation.reach import check_reach


def axes(configuration: Configuration, namespace: str | None = None) -> list[AxisParameters]:
    """Return every axis of a configuration, or the one in ``namespace``.

    Raises
    ------
    ConfigurationError
        Two of the axes would publish ``/clock``: time may have one source only.
    ParameterError
        A parameter is wrong, or a reference lies beyond what its axis can follow.
    """
    spaces = configuration.namespaces() if namespace is None else (namespace,)
    found = [AxisParameters.from_configuration(configuration, space) for space in spaces]
    for axis in found:
        if axis.inchworm_sequencer is None:
            check_reach(axis)
    clocks = [axis.namespace or "/" for axis in found if axis.plant_simulator.publish_clock]
    if len(clocks) > 1:
        raise ConfigurationError(
            f"{configuration.source}: {' and '.join(clocks)} both set publish_clock; /clock may have one source, "
            "set publish_clock: true for one plant_simulator only"
        )
    return found


def single_axis(configuration: Configuration, namespace: str | None = None) -> AxisParameters:
    """Return the only axis of a configuration, or the one in ``namespace``.

    Raises
    ------
    ConfigurationError
        There are several and none was chosen.
    ParameterError
        A parameter is wrong.
    """
    found = axes(configuration, namespace)
    if len(found) > 1:
        names = ", ".join(axis.namespace for axis in found)
        raise ConfigurationError(f"{configuration.source}: holds several axes ({names}); choose one with --namespace")
    return found[0]
