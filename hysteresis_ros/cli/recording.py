# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis report``, ``verify``, ``export`` and ``repair``: evaluate, compare, convert or repair a recording."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from hysteresis_ros.cli.options import write_json
from hysteresis_ros.cli.progress import shown

if TYPE_CHECKING:
    from hysteresis_ros.recordings.dataset import Recording


@click.command()
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", type=click.Path(path_type=pathlib.Path))
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
@click.option(
    "--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead of the table."
)
@click.option("--namespace", help="Axis to use, if a bag contains several.")
@click.option("--title", help="Heading of the page; by default the name of the recording.")
@click.option("--range", "range_", metavar="FROM:TO", help="Evaluate only this part, e.g. 0.5s:2s.")
@click.option("--skip", metavar="TIME", help="Length of the beginning to omit, e.g. 0.5s.")
@click.option(
    "--last-periods", type=click.IntRange(1), metavar="N", help="Evaluate the last N periods of the reference."
)
def report(recordings, output, json_path, namespace, title, range_, skip, last_periods) -> None:
    """Evaluate recordings (bag, .mcap, .db3, .npz or .csv): error, overshoot, settling, loop width, rate, jitter.

    For an inchworm motor: steps, speed, slip and final error of each move. For a stage that follows a scan: errors in
    the plane, errors along and across the lines for trace and retrace, and a map of the errors. Several recordings are
    shown side by side. Prints a table; -o adds a self-contained HTML file with charts to zoom (needs the extra: pip
    install "hysteresis_ros[report]").
    """
    from hysteresis_ros.analysis.scan_report import format_plane, plane_figures, plane_of
    from hysteresis_ros.analysis.side_by_side import labels_of, report_several
    from hysteresis_ros.recordings.files import load_run

    if output is not None:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)
    with shown("reading"):
        read = {label: load_run(path, namespace, further=True) for label, path in labels_of(recordings).items()}
        runs = {
            label: _excerpt(label, one, range_, skip, last_periods)
            for whole, run in read.items()
            for label, one in _axes(whole, run).items()
        }
    plane = None
    if len(read) == 1 and len(runs) > 1 and last_periods is None:
        ((label, run),) = read.items()
        part = _bounds(range_, skip) if range_ or skip else (None, float("inf"))
        if _scanned(run, runs, output, title or label, json_path, part):
            return
        plane = plane_of(runs)
    if len(runs) > 1:
        with shown(f"evaluating {len(runs)} runs"):
            figures, table = report_several(runs, output, title, plane)
        in_plane = {} if plane is None else {"plane": plane_figures(plane)}
        lines = [table] if plane is None else [format_plane(plane), "", table]
        write_json({**in_plane, "runs": figures}, json_path, "\n".join(lines))
    else:
        ((label, run),) = runs.items()
        _single(run, output, title or label, json_path)
    if output is not None and json_path != "-":
        click.echo(f"report: {output}")


def _axes(label: str, run) -> dict[str, Recording]:
    """Return the axes of a run of a stage, or the run of a single axis, by the labels of the report."""
    from hysteresis_ros.api import stage_axes_of

    return {f"{label} {name}": one for name, one in stage_axes_of(run).items()} if run.axes else {label: run}


def _scanned(run, axes, output, title: str, json_path: str | None, part) -> bool:
    """Evaluate the scan of a stage in the plane; return False if the run does not follow a scan."""
    from hysteresis_ros.analysis.scan_report import format_scan, scan_figures, write_scan_report
    from hysteresis_ros.analysis.side_by_side import report_several
    from hysteresis_ros.api import scan_run

    with shown(f"evaluating {len(run)} samples"):
        scanned = scan_run(run, *part)
        if scanned is None:
            return False
        figures, table = report_several(axes)
        found = scan_figures(scanned)
        if output is not None:
            write_scan_report(output, scanned, title)
    between = f"scan, {scanned.time[0]:.6g} … {scanned.time[-1]:.6g} s:"
    write_json({"scan": found, "runs": figures}, json_path, "\n".join([between, format_scan(found), "", table]))
    if output is not None and json_path != "-":
        click.echo(f"report: {output}")
    return True


def _single(run, output, title: str, json_path: str | None) -> None:
    """Evaluate one run."""
    from hysteresis_ros.analysis.metrics import limited_text
    from hysteresis_ros.analysis.side_by_side import report_of

    report, limited = report_of(run), limited_text(run)
    if limited:
        click.echo(f"hysteresis: warning: {limited}", err=True)
    with shown(f"evaluating {len(run)} samples"):
        figures = report.figures(run)
        if output is not None:
            report.write(run, output, title, figures)
    write_json(figures, json_path, report.table(figures))


def _bounds(range_: str | None, skip: str | None) -> tuple[float, float]:
    """Return the requested part of a run [s]."""
    from hysteresis_ros.analysis import parts

    if range_ is not None and ":" not in range_:
        raise click.UsageError(f"--range {range_}: write FROM:TO, e.g. 0.5s:2s, 0.5: or :2")
    first, _, last = (range_ or f"{skip or 0}:").partition(":")
    option = "--skip" if skip else "--range"
    return parts.seconds(first or "0", option), parts.seconds(last, option) if last else float("inf")


def _excerpt(label: str, run, range_: str | None, skip: str | None, periods: int | None):
    """Return the part of a run to evaluate; the error names the run if it does not contain this part."""
    from hysteresis_ros.analysis import parts
    from hysteresis_ros.errors import RecordingError

    if sum(option is not None for option in (range_, skip, periods)) > 1:
        raise click.UsageError("--range, --skip and --last-periods exclude each other; give one of them")
    begin, end = _bounds(range_, skip)
    try:
        return parts.within(run, begin, end) if periods is None else parts.last_periods(run, periods)
    except RecordingError as error:
        raise RecordingError(f"{label}: {error}") from None


@click.command(short_help="Compare a recorded run with its offline twin, bit for bit.")
@click.argument("recording", type=click.Path(path_type=pathlib.Path))
@click.option("--namespace", help="Axis to use, if the bag contains several.")
def verify(recording: pathlib.Path, namespace: str | None) -> None:
    """Repeat the run in RECORDING (bag, .npz or .csv) offline from the configuration in it, and compare bit for bit.

    A lockstep run of one machine can be verified on any other machine. Exit code 0: all samples are equal; 1: some
    differ or are missing; 2: the recording cannot be repeated. Files named by parameters are read from the recording,
    not from the disk.
    """
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.loop.repeated import recorded_axis, recorded_stage
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.loop.stage_simulation import stage_differences
    from hysteresis_ros.recordings.files import load_run

    with shown(f"reading {recording.name}"):
        run = load_run(recording, namespace, further=True)
    repeated: Any = recorded_stage if run.axes else recorded_axis
    compared: Any = stage_differences if run.axes else differences
    with repeated(run, str(recording)) as (found, notes):
        mode = found.stage.time_mode if run.axes else found.plant_simulator.time_mode
        if not run.is_simulated and mode == "realtime":
            raise RecordingError(
                f"{recording}: was run in real time, so its result depends on the times of messages; only lockstep and "
                "fused runs can be repeated"
            )
        for note in notes:
            click.echo(f"hysteresis: note: {note}", err=True)
        with shown("repeating the run"):
            unequal = compared(run, found)
    wrong = unlike(recording, run, unequal)
    if wrong:
        click.echo(f"hysteresis: {wrong}", err=True)
        sys.exit(1)
    click.echo(equal(recording, run.time.size))


def unlike(name: object, run: Recording, found: Mapping[str, int]) -> str:
    """Return a line: what a recording lacks, or else how it differs from its twin; empty if it is equal."""
    missing, lacking = (run.metadata.get(what, 0) for what in ("missing_samples", "missing_changes"))
    parts = [f"{missing} samples"] * bool(missing) + [f"{lacking} entries of the change log"] * bool(lacking)
    if parts:
        # samples after a gap have wrong indices, so the comparison with the twin would be meaningless
        return f"{name} lacks {' and '.join(parts)}, so it cannot be compared with the offline twin"
    if not found:
        return ""
    wrong = ", ".join(f"{signal}: {count} samples" for signal, count in found.items())
    return f"{name} differs from the offline twin ({wrong})"


def equal(name: object, samples: int) -> str:
    """Return a line stating that a recording equals its twin, with the number of samples."""
    return f"{name}: {samples} samples equal the offline twin bit for bit, none missing"


def warn_lost_offsets(run: Recording, output) -> None:
    """Warn of preload offsets that the file ``output`` does not contain."""
    from hysteresis_ros.analysis.metrics import lost_offsets

    for warning in lost_offsets(run, output):
        click.echo(f"hysteresis: warning: {warning}", err=True)


@click.command()
@click.argument("recording", type=click.Path(path_type=pathlib.Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=pathlib.Path), help="File to write: .npz or .csv."
)
@click.option("--namespace", help="Axis to use, if the bag contains several.")
def export(recording: pathlib.Path, output: pathlib.Path, namespace: str | None) -> None:
    """Convert RECORDING (bag folder, .mcap, .db3, .npz or .csv) to a table in SI units.

    The columns are time; setpoint, reference, command, voltage, displacement (true), measured and estimated, as far as
    they were recorded; and further signals such as modes and skipped samples, as `hysteresis simulate` writes them.
    """
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.recordings.files import load_run, save_run

    if output.suffix.lower() not in (".npz", ".csv"):
        raise RecordingError(f"{output}: unknown kind of file '{output.suffix}'; export writes .npz or .csv")
    with shown(f"writing {output.name}"):
        run = load_run(recording, namespace, further=True)
        save_run(run, output)
    missing = run.metadata.get("missing_samples", 0)
    click.echo(f"{output}: {len(run)} samples, {missing} missing")
    for note in run.notes:
        click.echo(f"note: {note}", err=True)
    warn_lost_offsets(run, output)


@click.command(short_help="Repair a bag that was cut off or is damaged.")
@click.argument("bag", type=click.Path(path_type=pathlib.Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=pathlib.Path), help="Folder to create; BAG_repaired by default."
)
def repair(bag: pathlib.Path, output: pathlib.Path | None) -> None:
    """Write the readable part of BAG (a folder, .mcap or .db3) to a new folder that every tool can read.

    All complete messages are kept; index, statistics and metadata.yaml are rebuilt, so that ros2 bag, Foxglove and
    rosbags open it. BAG itself is not changed. Reports of this package can also be made of a truncated bag, without
    repair.
    """
    from hysteresis_ros.recordings import repair as repairing

    with shown(f"repairing {bag.name}"):
        done = repairing.repair(bag, output)
    if done.path is None:
        click.echo(f"{bag}: is complete, {done.messages} messages; nothing to repair")
        return
    for line in done.lost:
        click.echo(f"left out: {line}", err=True)
    mended = f"{', '.join(done.mended)} repaired" if done.mended else "metadata.yaml rebuilt"
    click.echo(f"{done.path}: {done.messages} messages; {mended}")
