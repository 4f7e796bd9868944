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

#: Seconds between two looks whether somebody wants to leave.
LOOK = 0.05


@click.command(short_help="Show an axis in the browser, and tune it there, while it runs.")
@click.argument("config", required=False, type=ConfigurationName())
@click.option("--namespace", help="Of the axis; with CONFIG, show only the one in it.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Of the first page; 0: any. By default 8642, or any where it is in use.",
)
@click.option(
    "--bind", default="127.0.0.1", show_default=True, help="Address to listen on; beyond this machine with a token."
)
@click.option("--folder", default=".", show_default=True, metavar="DIR", help="Where the page's recordings go.")
def watch(config, namespace, port, bind, folder):
    """Start the axes of CONFIG and serve a page for each; without CONFIG show the axis that runs already.

    The page of an axis that leaves waits for it. Ends with exit code 0 after Ctrl-C, with 1 when a node dies, with 2
    for wrong input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration, normalised_namespace
    from hysteresis_ros.laboratory.watch.serving import PageOptions, Pages
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes
    from hysteresis_ros.nodes.launcher import Graph

    options = PageOptions(port, bind, folder)
    found = [in_time(axis) for axis in axes(load_configuration(config), namespace)] if config else []
    spaces = [axis.namespace for axis in found] or [normalised_namespace(namespace or "")]
    pages = Pages(spaces, options)
    with contextlib.ExitStack() as stack:
        graph = stack.enter_context(Graph(found)) if found else None
        stack.enter_context(pages)
        if graph is not None:
            graph.wait(lambda: bool(requested) or pages.over())
        while graph is None and not requested and not pages.over():
            time.sleep(LOOK)
        raise SystemExit(pages.exit_code())
