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
from hysteresis_ros.cli.progress import shown


@click.command()
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", type=click.Path(path_type=pathlib.Path))
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
@click.option(
    "--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead of the table."
)
@click.option("--namespace", help="Which axis, when a bag holds several.")
@click.option("--title", help="Heading of the page; the recording's name by default.")
@click.option("--range", "range_", metavar="FROM:TO", help="Judge this part only, e.g. 0.5s:2s.")
@click.option("--skip", metavar="TIME", help="Leave out the beginning, e.g. 0.5s.")
@click.option("--last-periods", type=click.IntRange(1), metavar="N", help="Judge the last N periods of the reference.")
def report(recordings, output, json_path, namespace, title, range_, skip, last_periods) -> None:
    """Judge recordings (bag folder, .mcap, .db3, .npz or .csv): error, overshoot, settling, loop width, rate, jitter.

    Of an inchworm: each move with its steps, speed, slip and final error. Several recordings stand side by side. Prints
    a table; -o adds a self-contained HTML file with charts to zoom (needs the extra: pip install
    "hysteresis_ros[report]").
    """
    from hysteresis_ros.analysis.several import labels_of, report_several
    from hysteresis_ros.recordings.files import load_run

    if output is not None:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)
    with shown("reading"):
        runs = {
            label: _excerpt(label, load_run(path, namespace, further=True), range_, skip, last_periods)
            for label, path in labels_of(recordings).items()
        }
    if len(runs) > 1:
        with shown(f"judging {len(runs)} runs"):
            figures, table = report_several(runs, output, title)
        write_json({"runs": figures}, json_path, table)
    else:
        ((label, run),) = runs.items()
        _single(run, output, title or label, json_path)
    if output is not None and json_path != "-":
        click.echo(f"report: {output}")


def _single(run, output, title: str, json_path: str | None) -> None:
    """Judge one run, an inchworm's by its moves."""
    from hysteresis_ros.analysis.inchworm_moves import is_inchworm
    from hysteresis_ros.analysis.limited import limited_text

    if is_inchworm(run):
        from hysteresis_ros.analysis.inchworm import format_inchworm as table
        from hysteresis_ros.analysis.inchworm import inchworm_figures as judge
        from hysteresis_ros.analysis.inchworm_report import write_inchworm_report as write
    else:
        from hysteresis_ros.analysis.metrics import compute_metrics as judge
        from hysteresis_ros.analysis.report import write_report as write
        from hysteresis_ros.analysis.shown_figures import format_table as table
    limited = limited_text(run)
    if limited:
        click.echo(f"hysteresis: warning: {limited}", err=True)
    with shown(f"judging {len(run)} samples"):
        figures = judge(run)
        if output is not None:
            write(run, output, title, figures)
    write_json(figures, json_path, table(figures))


def _excerpt(label: str, run, range_: str | None, skip: str | None, periods: int | None):
    """Return the part of a run that is to be judged; a run that lacks it is named."""
    from hysteresis_ros.analysis import excerpt
    from hysteresis_ros.errors import RecordingError

    if sum(option is not None for option in (range_, skip, periods)) > 1:
        raise click.UsageError("--range, --skip and --last-periods exclude each other")
    if range_ is not None and ":" not in range_:
        raise click.UsageError(f"--range {range_}: write FROM:TO, e.g. 0.5s:2s, 0.5: or :2")
    first, _, last = (range_ or f"{skip or 0}:").partition(":")
    option = "--skip" if skip else "--range"
    begin = excerpt.seconds(first or "0", option)
    end = excerpt.seconds(last, option) if last else float("inf")
    try:
        return excerpt.within(run, begin, end) if periods is None else excerpt.last_periods(run, periods)
    except RecordingError as error:
        raise RecordingError(f"{label}: {error}") from None
