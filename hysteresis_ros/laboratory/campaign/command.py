# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis faults``: inject the faults of a real bench into a separate axis, and report the outcome."""

from __future__ import annotations

import itertools
import pathlib

import click

from hysteresis_ros.cli.options import ConfigurationName


@click.command(short_help="Inject faults into a simulated axis, and report the outcome.")
@click.argument("config", type=ConfigurationName(), default="picma_stage")
@click.option("--ways", default="fused,composed,processes", show_default=True, help="How the nodes run.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this fault case, or this group; repeatable.")
@click.option(
    "--rounds", type=click.IntRange(1), default=1, show_default=True, help="Number of rounds, each at other times."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the random times.")
@click.option(
    "--rate",
    type=click.FloatRange(1.0, 1e5),
    default=None,
    metavar="HZ",
    help="Sample rate instead of that of the file; losses of nodes are also tested at 10, 200 and 3000 Hz.",
)
@click.option("--list", "listed", is_flag=True, help="List the fault cases without running them.")
@click.option("-o", "output", type=click.Path(path_type=pathlib.Path), help="Markdown page for all results.")
@click.option("--json", "figures", type=click.Path(path_type=pathlib.Path), help="JSON file for the figures.")
@click.option(
    "--add", multiple=True, type=click.Path(path_type=pathlib.Path), help="Earlier figures to include in the page."
)
def faults(config, *, ways, only, rounds, seed, rate, listed, output, figures, add):
    """Start the axis of CONFIG with a simulated plant, in a separate ROS domain, and inject faults.

    Nodes are killed and suspended, messages lost and forged, cores and disks occupied. Each case checks whether the
    voltage stayed within its limits and became safe in time, and whether the axis recovered. Exit code 0: all claims
    held; 4: some did not; 2: wrong input.
    """
    from hysteresis_ros.laboratory.campaign.mishaps import chosen, chosen_ways
    from hysteresis_ros.laboratory.campaign.results import load_results

    wanted, mishaps = chosen_ways(ways), chosen(only)
    if listed:
        for mishap in mishaps:
            click.echo(f"{mishap.name} [{', '.join(mishap.ways)}]: {mishap.done}")
        return
    for option, path in (("-o", output), ("--json", figures)):
        if path is not None and not path.absolute().parent.is_dir():
            raise click.UsageError(f"{option} {path}: the folder does not exist; choose another one")
    for path in add:
        load_results(path)
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.laboratory.campaign.judging import at_rate, prepared
    from hysteresis_ros.nodes.launcher import run_apart

    configuration = load_configuration(config)
    for way, tried in itertools.product(wanted, {mishap.rate or rate or 0.0 for mishap in mishaps}):
        prepared(at_rate(configuration, tried), way, "/faults")
    request = {"config": config, "ways": wanted, "only": [mishap.name for mishap in mishaps]}
    request |= {"rounds": rounds, "seed": seed, "rate": rate or 0.0, "add": [str(path.absolute()) for path in add]}
    files = {"output": output, "json": figures}
    request |= {name: str(path.absolute()) if path else "" for name, path in files.items()}
    raise SystemExit(run_apart("hysteresis_ros.laboratory.campaign", request))
