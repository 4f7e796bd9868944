"""``hysteresis compare``: every controller and compensator on one plant, ranked under honest conditions."""

from __future__ import annotations

import pathlib
import sys

import click

from hysteresis_ros.cli.data_options import write_json


@click.command()
@click.argument("config", type=click.Path(path_type=str))
@click.option("--mismatch", default=0.05, show_default=True, help="Largest relative error of each model parameter.")
@click.option("--noise", default=5e-9, show_default=True, help="Sensor noise [m rms].")
@click.option("--bits", default=16, show_default=True, help="Bits of the converters; 0: unlimited.")
@click.option("--draws", default=20, show_default=True, help="Number of plants drawn.")
@click.option("--seed", default=1, show_default=True, help="Seed of the first plant.")
@click.option("--sine", default=1.0, show_default=True, help="Frequency of the sine over 90 % of the stroke [Hz].")
@click.option("--triangle", default=10.0, show_default=True, help="Frequency of the triangle over 20 % of it [Hz].")
@click.option("--namespace", help="Which axis of the configuration, when it describes several.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file; '-' prints it instead of the table.")
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
def compare(config, mismatch, noise, bits, draws, seed, sine, triangle, namespace, json_path, output):
    """Rank all controllers and compensators on the plant of CONFIG.

    Each is designed on the models in CONFIG, then follows a sine and a triangle on plants drawn around the configured
    one. -o adds a self-contained HTML file with plots (needs the extra: pip install "hysteresis_ros[report]").
    """
    from hysteresis_ros.comparison import table
    from hysteresis_ros.comparison.compare import Conditions
    from hysteresis_ros.comparison.compare import compare as run
    from hysteresis_ros.configuration import load_configuration

    if output is not None:
        from hysteresis_ros.analysis.report import require_page

        require_page(output)  # now and not after minutes
    conditions = Conditions(mismatch, noise, bits, draws, seed, sine, triangle)
    configuration = load_configuration(config)
    quiet = not sys.stderr.isatty()

    def progress(row):
        if not quiet:
            click.echo(f"  {table.label(row)}", err=True)

    found = run(configuration, conditions, namespace=namespace, progress=progress)
    if output is not None:
        table.write_page(found, output)
    write_json(table.to_json(found), json_path, table.format_comparison(found))
    if output is not None and json_path != "-":
        click.echo(f"\nreport: {output}")
