# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis parameters``: the parameter tables of the nodes, as people read them and as docs/parameters.md."""

from __future__ import annotations

import click

from hysteresis_ros.cli.arguments import NodeName


@click.command(short_help="List the parameters of the nodes with type, default, unit and range.")
@click.argument("node", required=False, type=NodeName())
def parameters(node):
    """Print the parameter table of NODE, or of all nodes, in Markdown."""
    from hysteresis_ros.errors import ConfigurationError, did_you_mean
    from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS

    if node is not None and node not in NODE_PARAMETERS:
        near = did_you_mean(node, NODE_PARAMETERS)
        raise ConfigurationError(f"no node '{node}'; there are: {', '.join(NODE_PARAMETERS)}{near}")
    click.echo("\n".join(lines([node] if node else list(NODE_PARAMETERS))), nl=False)


def lines(nodes: list[str]):
    """Yield the lines of the tables: first what all nodes share, then each node's own."""
    from hysteresis_ros.loop.common_parameters import NodeParameters
    from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS

    shared = {row.name for row in NodeParameters.table()}
    yield "## Every node\n"
    yield from _table(NodeParameters.table())
    for name in nodes:
        yield f"\n## {name}\n"
        yield from _table([row for row in NODE_PARAMETERS[name].table() if row.name not in shared])
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
