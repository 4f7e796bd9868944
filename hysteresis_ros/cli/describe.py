# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis parameters|urdf|policy``: descriptions of an axis for other tools: parameters, URDF, SROS 2 policy."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import click

from hysteresis_ros.cli.options import ConfigurationName, NodeName


@click.command(short_help="List the parameters of the nodes with type, default, unit and range.")
@click.argument("node", required=False, type=NodeName())
def parameters(node):
    """Print the parameter table of NODE, or of all nodes, in Markdown."""
    from hysteresis_ros.errors import ConfigurationError, did_you_mean

    known = _tables()
    if node is not None and node not in known:
        near = did_you_mean(node, known)
        raise ConfigurationError(f"no node '{node}'; there are: {', '.join(known)}{near}")
    click.echo("\n".join(parameter_lines([node] if node else list(known))), nl=False)


def _tables() -> dict:
    """Return parameter classes by name: each node, the stage section, and the axis array."""
    from hysteresis_ros.configuration import STAGE
    from hysteresis_ros.loop.axis_array import ArrayNodeParameters
    from hysteresis_ros.loop.parameters import NODE_PARAMETERS
    from hysteresis_ros.loop.stage_parameters import StageNodeParameters

    return {**NODE_PARAMETERS, STAGE: StageNodeParameters, "axis_array": ArrayNodeParameters}


def parameter_lines(nodes: list[str]):
    """Yield the lines of the tables: first the shared parameters of all nodes, then the own ones of each node."""
    from hysteresis_ros.configuration import STAGE
    from hysteresis_ros.loop.parameters import NodeParameters

    shared = {row.name for row in NodeParameters.table()}
    yield "## Every node\n"
    yield from _table(NodeParameters.table())
    for name in nodes:
        yield f"\n## {name}\n"
        rows = [row for row in _tables()[name].table() if row.name not in shared]
        # the parameters of a stage cannot change while it runs
        yield from _table([replace(row, read_only=True) for row in rows] if name == STAGE else rows)
    yield ""


def _table(rows):
    yield "| parameter | type and range | default | live | meaning |"
    yield "|---|---|---|---|---|"
    for row in rows:
        default = "*required*" if row.required else f"`{_yaml(row.default)}`"
        live = "no" if row.read_only else "yes"
        yield f"| `{row.name}` | {row.allowed()} | {default} | {live} | {row.description} |"


def _yaml(value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    return f"'{value}'" if value == "" else str(value)


@click.command(short_help="Print an axis as a URDF, with its joint and limits.")
@click.argument("config", type=ConfigurationName())
@click.option("--namespace", default="", help="Namespace of the axis.")
def urdf(config, namespace):
    """Print the URDF of CONFIG: a base, and a prismatic joint with the limits of the axis.

    A running axis publishes the same text on robot_description.
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.description import robot_description
    from hysteresis_ros.loop.parameters import AxisParameters

    axis = AxisParameters.from_configuration(load_configuration(config), namespace)
    click.echo(robot_description(axis.source), nl=False)


@click.command(short_help="Write the SROS 2 policy of the nodes of a configuration.")
@click.argument("config", type=ConfigurationName())
@click.option("-o", "--output", required=True, type=click.Path(path_type=pathlib.Path), help="Policy file to write.")
@click.option("--processes/--composed", "processes", default=None, help="Processes of the nodes, as with `up`.")
@click.option("--rate", type=click.Choice(["realtime", "lockstep", "fused"]), help="Time mode, as with `up`.")
@click.option("--record", is_flag=True, help="Include a recorder.")
@click.option("--plant", type=click.Choice(["own", "external"]), default="own", show_default=True, help="As with `up`.")
@click.option("--namespace", help="Only the axis in this namespace.")
@click.option("--remap", multiple=True, metavar="FROM:=TO", help="Remapping of the nodes; repeatable.")
def policy(config, output, processes, rate, record, plant, namespace, remap):
    """Write a policy for `ros2 security` that permits only the interfaces that each process of CONFIG uses.

    To find the interfaces, the command creates the nodes in an isolated ROS domain; it opens no device. The policy also
    contains enclaves for an operator (may publish user inputs and call services), a monitor (may only subscribe), watch
    (serves the page) and epics_ioc.
    """
    from hysteresis_ros.nodes.launcher import run_apart

    request = {"config": config, "output": str(output), "namespace": namespace, "rate": rate, "processes": processes}
    request |= {"record": record, "external": plant == "external", "remap": list(remap)}
    raise SystemExit(run_apart("hysteresis_ros.nodes.security", request))
