# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis urdf``: an axis as tools of ROS describe robots."""

from __future__ import annotations

import click

from hysteresis_ros.cli.arguments import ConfigurationName


@click.command(short_help="Print an axis as a URDF, with its joint and limits.")
@click.argument("config", type=ConfigurationName())
@click.option("--namespace", default="", help="Namespace of the axis.")
def urdf(config, namespace):
    """Print the URDF of CONFIG: a base, and a prismatic joint with the limits of the axis.

    It is what the source of references publishes on robot_description.
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.axis_parameters import AxisParameters
    from hysteresis_ros.loop.description import robot_description

    axis = AxisParameters.from_configuration(load_configuration(config), namespace)
    source = axis.inchworm_sequencer or axis.reference_generator
    assert source is not None  # every axis has one of them
    click.echo(robot_description(source), nl=False)
