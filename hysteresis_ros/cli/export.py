# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis export``: a recording as a table."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.progress import shown


@click.command()
@click.argument("recording", type=click.Path(path_type=pathlib.Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=pathlib.Path), help="File to write: .npz or .csv."
)
@click.option("--namespace", help="Which axis, when the bag holds several.")
def export(recording: pathlib.Path, output: pathlib.Path, namespace: str | None) -> None:
    """Turn RECORDING (bag folder, .mcap, .db3, .npz or .csv) into a table of eight columns in SI units.

    The columns are time, setpoint, reference, command, voltage, displacement (true), measured, estimated: the same
    that `hysteresis simulate` writes.
    """
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.recordings.files import load_run, save_run

    if output.suffix.lower() not in (".npz", ".csv"):
        raise RecordingError(f"{output}: unknown kind of file '{output.suffix}'; export writes .npz or .csv")
    with shown(f"writing {output.name}"):
        run = load_run(recording, namespace)
        save_run(run, output)
    missing = run.metadata.get("missing_samples", 0)
    click.echo(f"{output}: {len(run)} samples, {missing} missing")
    for note in run.notes:
        click.echo(f"note: {note}", err=True)
