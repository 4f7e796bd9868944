# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis watch``: an axis in the browser, while it runs."""

from __future__ import annotations

import contextlib
import signal
import time

import click

from hysteresis_ros.cli.options import ConfigurationName

#: Interval at which a request to exit is checked [s].
LOOK = 0.05


@click.command(short_help="Show and tune a running axis in the browser.")
@click.argument("config", required=False, type=ConfigurationName())
@click.option("--namespace", help="Namespace of the axis; with CONFIG, show only the axis in it.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port of the first page; 0: any free port. Default: 8642, or any free port when it is in use.",
)
@click.option(
    "--bind", default="127.0.0.1", show_default=True, help="Address to listen on; other machines need a token."
)
@click.option("--folder", default=".", show_default=True, metavar="DIR", help="Folder for the recordings of the page.")
def watch(config, namespace, port, bind, folder):
    """Start the axes of CONFIG and serve a page for each; without CONFIG show the axis that already runs.

    When an axis ends, its page waits for it to return. Exit code: 0 after Ctrl-C, 1 when a node dies, 2 for wrong
    input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration, normalised_namespace
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.laboratory.watch.server_process import PageOptions, Pages
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes
    from hysteresis_ros.loop.stage_parameters import StageParameters
    from hysteresis_ros.nodes.launcher import Graph, require_messages

    options = PageOptions(port, bind, folder)
    configuration = load_configuration(config) if config else None
    stage = None
    if configuration is None:
        found = []
    elif configuration.stage is None:
        found = [in_time(axis) for axis in axes(configuration, namespace)]
    else:
        stage = StageParameters.from_configuration(configuration).in_time()
        require_messages(stage)
        found = list(stage.axes)
    named = normalised_namespace(namespace or "")
    shown = [axis.namespace for axis in found if stage is None or named in ("", axis.namespace)]
    if stage is not None and not shown:
        raise ConfigurationError(f"--namespace {namespace}: the stage has the axes {', '.join(stage.names)}")
    spaces = shown or [named]
    pages = Pages(spaces, options)
    with contextlib.ExitStack() as stack:
        graph = stack.enter_context(Graph(found, stage=stage)) if found else None
        stack.enter_context(pages)
        if graph is not None:
            graph.wait(lambda: bool(requested) or pages.over())
        while graph is None and not requested and not pages.over():
            time.sleep(LOOK)
        raise SystemExit(pages.exit_code())
