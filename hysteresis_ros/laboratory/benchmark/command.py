# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis benchmark``: models of hysteresis on public recordings and synthetic plants, in one table."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import Quantity, write_json
from hysteresis_ros.cli.progress import Progress

#: Longest time without output of a command that takes minutes [s].
SILENCE = 10.0


@click.command()
@click.argument("manifest", required=False, type=click.Path(path_type=pathlib.Path))
@click.option(
    "--data", type=click.Path(path_type=pathlib.Path), help="Folder of the recordings' files; default: the manifest's."
)
@click.option("--synthetic", type=click.IntRange(0), help="Number of synthetic plants; 4 if no recording is found.")
@click.option("--noise", type=Quantity("m"), default="5nm", show_default=True, help="Noise of the synthetic sensors.")
@click.option("--model", "specs", multiple=True, metavar="NAME|FILE.py:CLASS", help="Model; repeatable.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this recording; repeatable.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; as many as processors.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file; '-' prints it instead of the table.")
@click.option("--csv", "csv_path", type=click.Path(path_type=pathlib.Path), help="CSV file of the rows.")
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML page.")
@click.option("--list", "listed", is_flag=True, help="Only list recordings (source, licence) and models.")
def benchmark(manifest, *, data, synthetic, noise, specs, only, workers, json_path, csv_path, output, listed):
    """Fit models of hysteresis to recordings and test them on parts that they have not seen.

    MANIFEST lists the recordings, with checksums and the parts for fit and test; without it the list of public
    recordings that comes with the package is used. Nothing is fetched: --list tells where to get the files, --data
    where they are. Synthetic plants are made on the spot and need no files. Your own model is a class with fit(data)
    and predict(input).
    """
    from hysteresis_ros.errors import HysteresisError, RecordingError
    from hysteresis_ros.files import write_text
    from hysteresis_ros.laboratory.benchmark import judging, models, table
    from hysteresis_ros.laboratory.benchmark.manifest import (
        load_manifest,
        missing_files,
        read_task,
        shipped_manifest,
    )
    from hysteresis_ros.laboratory.benchmark.synthetic import synthetic_task

    path = manifest or shipped_manifest()
    entries = load_manifest(path)
    if listed:
        click.echo("\n".join(_described(entries, models.names())))
        return
    if output:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)  # before minutes of work
    specs = tuple(dict.fromkeys(specs)) or models.COMPARED
    for spec in specs:
        models.load_model(spec)
    folder = data or path.parent
    if data and not data.is_dir():
        raise HysteresisError(f"--data {data}: there is no such folder")
    missing = {entry.name: missing_files(entry, folder) for entry in entries}
    left_out = [
        f"{entry.name}: {', '.join(missing[entry.name])} not found in {folder}; get it from {entry.source}"
        for entry in entries
        if missing[entry.name]
    ]
    if manifest and left_out and not only:
        raise RecordingError(f"{left_out[0]}; give the folder with --data, or choose recordings with --only")
    found = [entry for entry in entries if not missing[entry.name]]
    count = synthetic if synthetic is not None else 0 if found else 4
    seeds = range(1, count + 1)
    _require_known(only, [entry.name for entry in entries] + [f"synthetic_{seed}" for seed in seeds])
    tasks = [read_task(entry, folder) for entry in entries if entry.name in only or (not only and entry in found)]
    tasks += [synthetic_task(seed, noise) for seed in seeds if not only or f"synthetic_{seed}" in only]
    if not tasks:
        raise HysteresisError("no recording is left: give --data, --synthetic 4, or a manifest")
    progress = Progress(err=True, silence=SILENCE)
    with progress.during(f"{len(specs)} models on {len(tasks)} recordings"):
        rows = judging.run(tasks, specs, workers, lambda row: progress.say(f"  done: {row.model} on {row.recording}"))
    judging.require_rows(rows)
    write_json(table.to_json(tasks, rows, left_out), json_path, table.format_table(tasks, rows))
    if csv_path:
        write_text(csv_path, table.to_csv(rows), RecordingError)
    if output:
        table.write_benchmark_page(output, tasks, rows, left_out)
    if json_path != "-":
        for text in left_out:
            click.echo(f"left out: {text}")
        for what, place in (("rows", csv_path), ("page", output)):
            if place:
                click.echo(f"{what}: {place}")


def _require_known(only, names) -> None:
    from hysteresis_ros.errors import HysteresisError, did_you_mean

    for name in only:
        if name not in names:
            raise HysteresisError(f"--only {name}: there are {', '.join(names)}{did_you_mean(name, names)}")


def _described(entries, names) -> list[str]:
    """Return the recordings of a manifest, and the models."""
    lines = []
    for entry in entries:
        files = dict.fromkeys((entry.train.file, entry.test.file))
        lines += [f"{entry.name}: {entry.about}", f"  source   {entry.source}", f"  licence  {entry.licence}"]
        lines += [f"  file     {name}" for name in files]
    return [*lines, f"models: {', '.join(names)}; your own as module:Class or file.py:Class"]
