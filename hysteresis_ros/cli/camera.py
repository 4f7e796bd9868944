# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis camera``: measure displacements in a video or a folder of pictures."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import Quantity, RunFile


@click.command(short_help="Measure displacements in a video or a folder of pictures.")
@click.argument("frames", type=click.Path(path_type=pathlib.Path))
@click.option("-o", "--output", type=RunFile(), help="File to write: .npz, .csv or .mcap.")
@click.option("--config", help="Take tracking and calibration from displacement_camera in this parameter file.")
@click.option("--namespace", default="", help="Namespace of the axis in that file.")
@click.option("--rate", type=Quantity("Hz"), help="Frame rate, such as 30Hz; by default that of the video.")
@click.option("--method", type=click.Choice(["edge", "pattern"]), help="Tracked feature.")
@click.option("--along", type=click.Choice(["x", "y"]), help="Direction of the motion in the frames.")
@click.option("--region", metavar="X,Y,W,H", help="Evaluated region of the frames [px].")
@click.option("--scale", metavar="M", help="Displacement per pixel, such as 0.5um.")
@click.option(
    "--known", type=click.Path(path_type=pathlib.Path), help="Print the scale, from this table of known displacements."
)
@click.option(
    "--target",
    metavar="M",
    help="Print the scale. M is the distance, such as 100um, between two parallel edges in the first frame.",
)
def camera(frames, output, config, namespace, rate, known, target, **options):
    """Find the tip in FRAMES, a video or a folder of pictures, and write its displacement (measured, in m).

    With --known or --target it prints the scale in metres per pixel instead, as lines for the parameter file.
    """
    from hysteresis_ros.cli.progress import Progress
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.hardware.footage import Footage, follow
    from hysteresis_ros.hardware.tracker import Tracker
    from hysteresis_ros.recordings.files import save_run

    if sum(given is not None for given in (output, known, target)) != 1:
        raise click.UsageError("give one of -o FILE, --known FILE and --target M")
    if rate is not None and not 0.0 < rate < float("inf"):
        raise click.UsageError(f"--rate {rate:g}: must be above 0 Hz")
    parameters = _parameters(config, namespace, calibrating=output is None, **options)
    if output is not None and output.suffix.lower() not in (".npz", ".csv", ".mcap"):
        raise RecordingError(f"{output}: unknown kind of file '{output.suffix}'; write .npz, .csv or .mcap")
    footage = Footage(frames, rate or (1.0 if output is None else None))
    if target is not None:
        _print_scale(_of_target(footage, _metres("--target", target), parameters))
        return
    done, progress = [0], Progress(err=True)
    with progress.during(f"{frames}", lambda: f"frame {done[0]} of {footage.count}"):
        seen = follow(footage, Tracker(parameters), lambda number: done.__setitem__(0, number + 1))
    if known is not None:
        _print_scale(_of_motion(seen, known))
        return
    save_run(seen, output)
    click.echo(f"{output}: {len(seen)} frames at {footage.rate:g} Hz")
    for note in seen.notes:
        click.echo(f"note: {note}", err=True)


def _metres(option: str, text: str) -> float:
    from hysteresis_ros.units import quantity_in

    try:
        value = quantity_in(text, "m")
    except ValueError as error:
        raise click.UsageError(f"{option} {text}: {error}") from None
    if not value > 0.0:
        raise click.UsageError(f"{option} {text}: must be a length above 0")
    return value


def _parameters(config, namespace, calibrating, method, along, region, scale):
    """Return the parameters of the file, changed by the options; with ``calibrating`` the scale is optional."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.hardware.tracker import CameraParameters

    values = load_configuration(config).node("displacement_camera", namespace) if config else {}
    known = {row.name for row in CameraParameters.table() if not (calibrating and row.name.startswith("calibration."))}
    values = {name: value for name, value in values.items() if name in known}
    given = {"tracking.method": method, "tracking.along": along}
    if region is not None:
        try:
            given["tracking.region"] = [float(part) for part in region.split(",")]
        except ValueError:
            raise click.UsageError(f"--region {region}: give four numbers, X,Y,W,H") from None
    if scale is not None:
        given["calibration.scale"] = _metres("--scale", scale)
    elif calibrating:
        given["calibration.scale"] = 1.0e-6
    elif "calibration.scale" not in values:
        raise click.UsageError("the scale is missing: give --scale or --config; --known and --target determine it")
    return CameraParameters.from_mapping(
        {**values, **{name: value for name, value in given.items() if value is not None}}
    )


def _of_motion(seen, known):
    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.hardware.footage import scale_of_motion
    from hysteresis_ros.recordings.files import load_run

    table = load_run(known)
    name = next((name for name in ("displacement", "measured", "position") if name in table), None)
    if name is None:
        raise RecordingError(
            f"{known}: has no column displacement, measured or position; it has {', '.join(table.signals)}"
        )
    return scale_of_motion(seen["pixels"], table[name])


def _of_target(footage, size, parameters):
    from hysteresis_ros.hardware.footage import scale_of_target
    from hysteresis_ros.hardware.tracker import FrameError, fits, looked_at

    first, tracking = next(iter(footage)), parameters.tracking
    if first is None or not fits(first, tracking):
        raise FrameError("the first frame cannot be read, or does not contain the region")
    return scale_of_target(looked_at(first, tracking), size, tracking.smallest_contrast, tracking.largest_blur)


def _print_scale(found) -> None:
    click.echo("/**/displacement_camera:\n  ros__parameters:\n    calibration:")
    click.echo(f"      scale: {found.metres_per_pixel:.9e}    # m/px, ± {found.uncertainty:.1e}")
    if found.offset == found.offset:
        click.echo(f"      sign: {found.sign}\n      offset: {found.offset:.9e}    # m")
        click.echo(f"# RMS residual of the straight line: {1e9 * found.residual:.3g} nm")
