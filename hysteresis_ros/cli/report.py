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
def report(recording: pathlib.Path, output: pathlib.Path | None, json_path: str | None, namespace: str | None) -> None:
    """Judge RECORDING (bag folder, .mcap, .db3, .npz or .csv): error, overshoot, settling, loop width, rate, jitter.

    Of an inchworm: each move with its steps, speed, slip and final error. Prints a table; -o adds a self-contained HTML
    file with plots (needs the extra: pip install "hysteresis_ros[report]").
    """
    from hysteresis_ros.analysis.inchworm_moves import is_inchworm
    from hysteresis_ros.recordings.files import load_run

    run = load_run(recording, namespace, further=True)
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
        write(run, output, recording.name, figures)
    write_json(figures, json_path, table(figures))
    if output is not None and json_path != "-":
        click.echo(f"report: {output}")
