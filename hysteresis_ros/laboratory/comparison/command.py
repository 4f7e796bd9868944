# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis compare``: every controller and compensator, ranked under realistic conditions."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import ConfigurationName, write_json
from hysteresis_ros.cli.progress import Progress

#: Longest time without output of a command that takes minutes [s].
SILENCE = 10.0


@click.command()
@click.argument("config", type=ConfigurationName())
@click.option("--mismatch", default=0.05, show_default=True, help="Largest relative error of each model parameter.")
@click.option("--noise", default=5e-9, show_default=True, help="Sensor noise [m rms].")
@click.option("--bits", default=16, show_default=True, help="Bits of the converters; 0: unlimited.")
@click.option("--draws", default=20, show_default=True, help="Number of plants close to the configured plant; 0: none.")
@click.option("--others", default=4, show_default=True, help="Number of plants of other classes; 0: none.")
@click.option("--seed", default=1, show_default=True, help="Seed of the first plant.")
@click.option("--robust", is_flag=True, help="Design sliding mode controllers for the worst plants around the model.")
@click.option("--sine", default=1.0, show_default=True, help="Frequency of the sine over 90 % of the stroke [Hz].")
@click.option("--triangle", default=10.0, show_default=True, help="Frequency of the triangle over 20 % of stroke [Hz].")
@click.option("--namespace", help="Axis to use, if the configuration describes several.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; as many as processors.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file; '-' prints it instead of the table.")
@click.option("--best", is_flag=True, help="Let -o F.yaml write CONFIG with the best combination.")
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    type=click.Path(path_type=pathlib.Path),
    help="HTML page; with --best also a YAML file.",
)
def compare(config, *, namespace, workers, json_path, best, outputs, sine, triangle, **others):
    """Rank all controllers and compensators for the axis of CONFIG.

    Each one is designed from the models in CONFIG, and follows a sine and a triangle on random plants around the
    configured plant. For each plant of another class it is designed from a model that was identified from a recording
    of that plant. -o adds a self-contained HTML file with plots (needs the extra: pip install
    "hysteresis_ros[report]").
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.identification.parameter_file import write_file
    from hysteresis_ros.laboratory.comparison import table
    from hysteresis_ros.laboratory.comparison.compare import compare as run
    from hysteresis_ros.laboratory.comparison.tasks import Conditions

    pages, files = _sorted(outputs, best)
    if pages:
        from hysteresis_ros.analysis.page import require_page

        for page in pages:
            require_page(page)  # before minutes of work
    conditions = Conditions(sine_frequency=sine, triangle_frequency=triangle, **others)
    progress = Progress(err=True, silence=SILENCE)
    # the bar is shown only after a while, because an immediate refusal prints just one line
    comparing = f"comparing on {conditions.draws} plants around CONFIG and {conditions.others} of other classes"
    with progress.during(comparing):
        options = {"namespace": namespace, "workers": workers, "progress": lambda text: progress.say(f"  done: {text}")}
        found = run(load_configuration(config), conditions, **options)
    for page in pages:
        table.write_comparison_page(found, page)
    write_json(table.to_json(found), json_path, table.format_comparison(found))
    for file in files:
        write_file(file, table.best_text(found))
    if json_path != "-":
        for what, paths in (("report", pages), ("best", files)):
            for path in paths:
                click.echo(f"\n{what}: {path}")


def _sorted(outputs, best: bool):
    """Return the pages and the parameter files among the outputs."""
    from hysteresis_ros.errors import ConfigurationError

    files = [path for path in outputs if path.suffix in (".yaml", ".yml")]
    if best != bool(files):
        given = "--best" if best else str(files[0])
        raise ConfigurationError(f"{given}: --best and -o FILE.yaml belong together; give both, or neither")
    return [path for path in outputs if path not in files], files
