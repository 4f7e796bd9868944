# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis reproduce``: a paper's experiments; each claim is compared with its reproduction."""

from __future__ import annotations

import contextlib
import importlib
import pathlib

import click

from hysteresis_ros.cli.options import write_json
from hysteresis_ros.cli.progress import shown
from hysteresis_ros.laboratory.papers.experiments import EXPERIMENTS


@click.command()
@click.argument("experiment", type=click.Choice(list(EXPERIMENTS)))
@click.option(
    "--json", "json_path", metavar="FILE", help="JSON file for the rows; '-' prints them instead of the table."
)
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
@click.option(
    "--through",
    "way",
    type=click.Choice(["offline", "ros"]),
    default="offline",
    show_default=True,
    help="Run the axes by simulation, or by their nodes in lockstep, which is slower and gives the same rows.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 50),
    help="With --through ros: number of graphs of nodes that run in parallel; default: number of cores.",
)
def reproduce(experiment: str, json_path: str | None, output: pathlib.Path | None, way: str, jobs: int | None) -> None:
    """Repeat the experiments of a paper; print each published value, its reproduction, and whether the claim holds.

    Rows that do not hold are part of the result and listed with their reason; they do not change the exit code. -o adds
    a self-contained HTML file with plots (needs the extra: pip install "hysteresis_ros[report]").
    """
    from hysteresis_ros.laboratory.papers.claims import format_claims

    if output is not None:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)  # before minutes of work
    module = importlib.import_module(EXPERIMENTS[experiment])
    with contextlib.ExitStack() as stack:
        if way == "offline":
            stack.enter_context(shown(f"repeating the experiments of {experiment}"))
            found = module.reproduce()
        else:
            found = _reproduce_through_nodes(module, jobs)
        if output is not None:
            from hysteresis_ros.laboratory.papers.claims import write_claims_page

            write_claims_page(output, found.page(), module.figures(found))
    rows = found.to_json()
    rows = {"experiment": rows.pop("experiment"), "through": way, **rows}
    write_json(rows, json_path, format_claims(found))
    if output is not None and json_path != "-":
        click.echo(f"\nreport: {output}")


def _reproduce_through_nodes(module, jobs: int | None):
    """Repeat the experiments with the nodes: a simulation first collects all runs, then the nodes execute them."""
    import os

    from hysteresis_ros.laboratory.papers.graph_runner import GraphRunner, describe
    from hysteresis_ros.laboratory.papers.runs import Noting, through

    def show(number, known, axis):
        click.echo(f"run {number} of {known}: {describe(axis)}", err=True)

    runner, noting = GraphRunner(show), Noting()
    with through(noting):
        module.reproduce()
    runner.prepare(noting.axes, jobs or os.cpu_count() or 1)
    with through(runner):
        return module.reproduce()
