# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis verify``: compare a recorded run with its offline twin, here and now."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

import click

from hysteresis_ros.cli.progress import shown

if TYPE_CHECKING:
    from hysteresis_ros.recordings.dataset import Recording


@click.command(short_help="Compare a recorded run with its offline twin, bit for bit.")
@click.argument("recording", type=click.Path(path_type=pathlib.Path))
@click.option("--namespace", help="Which axis, when the bag holds several.")
def verify(recording: pathlib.Path, namespace: str | None) -> None:
    """Repeat the run in RECORDING (bag, .npz or .csv) offline from the configuration in it, and compare bit for bit.

    A lockstep run made on one machine is repeated on any other. Ends with exit code 0 when all samples are equal, 1
    when some differ or are missing, 2 when the recording cannot be repeated. Files that parameters name are those in
    the recording, whatever is on the disk by now.
    """
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.recordings.files import load_run
    from hysteresis_ros.simulation.repeated import recorded_axis
    from hysteresis_ros.simulation.run import differences

    with shown(f"reading {recording.name}"):
        run = load_run(recording, namespace)
    with recorded_axis(run, str(recording)) as (axis, notes):
        simulated = run.metadata.get("source") == "offline simulation"
        if not simulated and axis.plant_simulator.time_mode == "realtime":
            raise RecordingError(
                f"{recording}: is a run in real time, which depends on when messages came; only lockstep and "
                "fused runs repeat"
            )
        for note in notes:
            click.echo(f"hysteresis: note: {note}", err=True)
        with shown("repeating the run"):
            found = differences(run, axis)
    wrong = unlike(recording, run, found)
    if wrong:
        click.echo(f"hysteresis: {wrong}", err=True)
        sys.exit(1)
    click.echo(equal(recording, run.time.size))


def unlike(name: object, run: Recording, found: Mapping[str, int]) -> str:
    """Return in one line in what a recording differs from its twin; empty: in nothing.

    Parameters
    ----------
    name : object
        Of the recording.
    run : Recording
        The recording.
    found : mapping of str to int
        Number of differing samples of each signal that differs.
    """
    missing, lacking = (run.metadata.get(what, 0) for what in ("missing_samples", "missing_changes"))
    if not (found or missing or lacking):
        return ""
    wrong = ", ".join(f"{signal}: {count} samples" for signal, count in found.items())
    more = f"; {lacking} entries of the log of changes missing" if lacking else ""
    return f"{name} differs from the offline twin ({wrong or 'no signal'}; {missing} samples missing{more})"


def equal(name: object, samples: int) -> str:
    """Return in one line that a recording of so many samples equals its twin."""
    return f"{name}: {samples} samples equal the offline twin bit for bit, none missing"
