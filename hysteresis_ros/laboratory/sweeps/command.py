# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis sweep``: many runs with varied parameters."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import (
    ConfigurationName,
    Quantity,
    laid_under,
    params_file_option,
    reference_options,
    write_json,
)
from hysteresis_ros.cli.progress import Progress

#: Maximum interval of progress messages without a bar [s].
SILENCE = 10.0
#: Exit code when some of the runs had invalid parameters.
REFUSED = 2


@click.command(short_help="Run an axis many times with varied parameters.")
@click.argument("config", type=ConfigurationName())
@click.option(
    "--vary",
    "varied",
    multiple=True,
    metavar="NODE.PARAMETER=RANGE",
    help="0.1:2:log20, 1um:5um:lin10, 12,14,16, ±5%, uniform(A,B), loguniform(A,B), normal(MEAN,DEVIATION); "
    "repeatable. plant_simulator=±5% varies gain, opening, slowness and creep_rate of the plant.",
)
@click.option("--runs", type=click.IntRange(1), help="Total number of runs; by default all levels once, or 1000.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of all draws.")
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="Metric to store; by default rms_error_m, for an inchworm motor final_error_rms_m; repeatable.",
)
@click.option(
    "--bound",
    "bounds",
    multiple=True,
    metavar="NAME=MAXIMUM",
    help="Bound of a metric, or NAME=MINIMUM:MAXIMUM; prints the share of the axes that meets all bounds; repeatable.",
)
@click.option("--confidence", type=click.FloatRange(0.5, 0.999999), default=0.95, show_default=True)
@click.option(
    "--sensitivity", type=click.Choice(["sobol", "morris"]), help="Sensitivity of the metrics to the varied parameters."
)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    type=click.Path(path_type=pathlib.Path),
    help="File for the results, F.parquet or F.npz; also a page F.html with pictures.",
)
@click.option("--json", "json_path", metavar="FILE", help="Summary as JSON; '-' prints it instead of the text.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; as many as processors.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the sweep, tcp://host:8786.")
@click.option("--duration", type=Quantity("s"), help="Length of each run [s]; the configuration's own by default.")
@params_file_option
@reference_options
@click.option("--namespace", help="Axis to use, if the configuration describes several.")
def sweep(config, varied, *, runs, seed, metrics, bounds, confidence, sensitivity, outputs, json_path, **others):
    """Run CONFIG offline many times with varied parameters, and summarise the metrics.

    All levels are combined with each other, and each combination gets the same draws of the distributions. Only the
    named parameters change: plant_simulator.… does not change the models of compensator and controller. Finished runs
    are stored in F.part; the same command continues from there.
    """
    from hysteresis_ros.laboratory.sweeps import summary
    from hysteresis_ros.laboratory.sweeps import sweep as outcome
    from hysteresis_ros.laboratory.sweeps.plan import RANDOM, make_plan, parse_variations
    from hysteresis_ros.laboratory.sweeps.study import Study, require_metrics
    from hysteresis_ros.laboratory.sweeps.summary import parse_bound, require_library
    from hysteresis_ros.laboratory.sweeps.sweep import sweep as run
    from hysteresis_ros.loop.reach import single_axis

    path, page = _sorted(outputs)
    outcome.require_kind(path)
    if sensitivity:
        require_library()
    allowed = tuple(map(parse_bound, bounds))
    reference = others["reference"]
    configuration = reference.put_into(laid_under(config, others["laid_over"]))
    with reference.named():
        axis = single_axis(configuration, others["namespace"])
    names = require_metrics([*metrics, *(bound.metric for bound in allowed)], axis)
    if others["duration"] is not None:
        axis = axis.with_duration(others["duration"])
    variations = parse_variations(varied, axis)
    plan = make_plan(variations, runs, seed, sensitivity or RANDOM)
    done = [0]
    progress = Progress(err=True, silence=SILENCE)
    options = dict(
        workers=others["workers"], scheduler=others["scheduler"], progress=lambda count: done.__setitem__(0, count)
    )
    try:
        with progress.during("sweeping", lambda: f"{done[0]} of {plan.runs} runs", lambda: done[0] / plan.runs):
            found = run(Study(axis, variations, names), plan, path, **options)
    except KeyboardInterrupt:
        click.echo(f"{done[0]} of {plan.runs} runs are stored; repeat the same command to continue", err=True)
        raise
    summed = summary.Summary(found, plan, allowed, confidence)
    if page:
        from hysteresis_ros.laboratory.sweeps.page import write

        write(summed, page, str(config))
    write_json(summary.to_json(summed), json_path, "\n".join(summary.lines(summed)))
    if json_path != "-":
        click.echo(f"{path}: {len(found)} runs" + (f"; {page}" if page else ""))
    refused = summary.refusals(found)
    if refused:
        click.echo(f"hysteresis: {refused[0]}", err=True)
        raise SystemExit(REFUSED)


def _sorted(outputs):
    """Return the paths of the results and of the page, each None if not given."""
    from hysteresis_ros.errors import ConfigurationError

    pages = [path for path in outputs if path.suffix.lower() in (".html", ".htm")]
    files = [path for path in outputs if path not in pages]
    if len(files) != 1 or len(pages) > 1:
        raise ConfigurationError("-o: give one file for the results, F.parquet or F.npz, and at most one page, F.html")
    if pages:
        from hysteresis_ros.analysis.page import require_page

        require_page(pages[0])
    return files[0], pages[0] if pages else None
