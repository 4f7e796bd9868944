# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis report``: figures and plots of a recording."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.data_options import write_json


@click.command()
@click.argument("recording", type=click.Path(path_type=pathlib.Path))
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
@click.option(
    "--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead of the table."
)
@click.option("--namespace", help="Which axis, when the bag holds several.")
@click.option("--title", help="Heading of the page; the recording's name by default.")
@click.option("--range", "range_", metavar="FROM:TO", help="Judge this part only, e.g. 0.5s:2s.")
@click.option("--skip", metavar="TIME", help="Leave out the beginning, e.g. 0.5s.")
@click.option("--last-periods", type=click.IntRange(1), metavar="N", help="Judge the last N periods of the reference.")
def report(recording, output, json_path, namespace, title, range_, skip, last_periods) -> None:
    """Judge RECORDING (bag folder, .mcap, .db3, .npz or .csv): error, overshoot, settling, loop width, rate, jitter.

    Of an inchworm: each move with its steps, speed, slip and final error. Prints a table; -o adds a self-contained HTML
    file with plots (needs the extra: pip install "hysteresis_ros[report]").
    """
    from hysteresis_ros.analysis.inchworm_moves import is_inchworm
    from hysteresis_ros.recordings.files import load_run

    run = _excerpt(load_run(recording, namespace, further=True), range_, skip, last_periods)
    if is_inchworm(run):
        from hysteresis_ros.analysis.inchworm import format_inchworm as table
        from hysteresis_ros.analysis.inchworm import inchworm_figures as judge
        from hysteresis_ros.analysis.inchworm_report import write_inchworm_report as write
    else:
        from hysteresis_ros.analysis.metrics import compute_metrics as judge
        from hysteresis_ros.analysis.metrics import format_table as table
        from hysteresis_ros.analysis.report import write_report as write
    figures = judge(run)
    if output is not None:
        write(run, output, title or recording.resolve().name, figures)
    write_json(figures, json_path, table(figures))
    if output is not None and json_path != "-":
        click.echo(f"report: {output}")


def _excerpt(run, range_: str | None, skip: str | None, periods: int | None):
    """Return the part of a run that is to be judged."""
    from hysteresis_ros.analysis import excerpt

    if sum(option is not None for option in (range_, skip, periods)) > 1:
        raise click.UsageError("--range, --skip and --last-periods exclude each other")
    if periods is not None:
        return excerpt.last_periods(run, periods)
    if range_ is not None and ":" not in range_:
        raise click.UsageError(f"--range {range_}: write FROM:TO, e.g. 0.5s:2s, 0.5: or :2")
    first, _, last = (range_ or f"{skip or 0}:").partition(":")
    option = "--skip" if skip else "--range"
    begin = excerpt.seconds(first or "0", option)
    return excerpt.within(run, begin, excerpt.seconds(last, option) if last else float("inf"))
