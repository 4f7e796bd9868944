# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis scan``: requirements of a scan on its axes, largest frame rate within limits, path as a file."""

from __future__ import annotations

import math
import pathlib
from typing import Any

import click
from click.shell_completion import CompletionItem

from hysteresis_ros.cli.options import Quantity, write_json
from hysteresis_ros.cli.progress import shown

#: Maximum number of samples of a written path.
MOST_SAMPLES = 20_000_000
#: A harmonic below this fraction of the scan size is a rounding error.
ROUNDING = 1e-9


class ScanName(click.ParamType):
    """The name of a scan; unknown names are refused later, when all scans are known."""

    name = "scan"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the scans whose names begin with the typed text."""
        from hysteresis_ros.references.scans import SCANS

        return [
            CompletionItem(name, help=shape.summary) for name, shape in SCANS.items() if name.startswith(incomplete)
        ]


@click.command(short_help="Compute a scan of a plane.")
@click.argument("kind", type=ScanName())
@click.argument("parameters", nargs=-1, metavar="[NAME=VALUE]...")
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="NAME=VALUE",
    help="Limit of the axes: low, high, velocity, acceleration, jerk or bandwidth; one value, or one for each axis.",
)
@click.option("--fastest", is_flag=True, help="Use the largest frame rate within the limits.")
@click.option(
    "--harmonics", "count", type=click.IntRange(1), default=8, show_default=True, help="Number of printed harmonics."
)
@click.option("--rate", type=Quantity("Hz"), help="Sample rate of the written path, e.g. 20kHz.")
@click.option("--frames", type=click.IntRange(1), help="Number of written frames; by default until the path repeats.")
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="File for the path: .csv or .npz.")
@click.option("--plot", type=click.Path(path_type=pathlib.Path), help="Picture to write: .png.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead.")
def scan(kind, parameters, limits, fastest, count, rate, frames, output, plot, json_path):
    """Compute the scan KIND: raster, spiral, lissajous, cycloid, rosette, or file.

    Its parameters are given as NAME=VALUE, lengths with their unit: `hysteresis scan raster width=80um depth=80um`.
    Prints size, peaks of velocity, acceleration and jerk of each axis, the largest frame rate within the limits, and
    harmonics; writes the path with line and pixel of each sample. If the scan exceeds the limits, the command ends with
    exit code 2 and names an allowed frame rate.
    """
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.references.scan import ScanLimits, check_limits, harmonics, largest_frame_rate
    from hysteresis_ros.references.scans import parsed_values, rows_of, scan_of

    values = parsed_values(parameters, rows_of(kind))
    limited = parsed_values(limits, {row.name: row for row in ScanLimits.table()})
    allowed = ScanLimits.from_mapping(limited, "--limit ")
    _require_places(output, plot, rate)
    with shown("computing"):
        made = scan_of(kind, values)
        best = largest_frame_rate(made, allowed)
        if fastest:
            if best == 0.0:
                check_limits(made, allowed)
            if best == math.inf:
                raise ConfigurationError(
                    "--fastest: no limit determines a largest frame rate; give a limit, e.g. --limit velocity=10mm/s"
                )
            values.pop("line_rate", None)
            made = scan_of(kind, values | {"frame_rate": best})
        check_limits(made, allowed)
        found = harmonics(made, count)
        figures = _figures(kind, made, found, best)
        written = [] if output is None else [_write_path(output, made, rate, frames)]
    if plot is not None:
        from hysteresis_ros.analysis.scan_report import scan_picture, write_picture

        with shown("drawing"):
            write_picture(plot, scan_picture(made))
        written.append(f"{plot}: written")
    write_json(figures, json_path, "\n".join(_lines(figures)))
    for line in written if json_path != "-" else ():
        click.echo(line)


def _require_places(output: pathlib.Path | None, plot: pathlib.Path | None, rate: float | None) -> None:
    """Refuse files that cannot be written, before anything is computed."""
    from hysteresis_ros.analysis.response_plots import require_picture
    from hysteresis_ros.errors import RecordingError

    if plot is not None:
        require_picture(plot)
    if output is None:
        if rate is not None:
            raise click.UsageError("--rate is for a written path: give -o path.csv")
        return
    if output.suffix.lower() not in (".csv", ".npz"):
        raise RecordingError(f"{output}: unknown kind of file '{output.suffix}'; write .csv or .npz")
    if not output.absolute().parent.is_dir():
        raise RecordingError(f"{output}: cannot be written: the folder does not exist; choose another place")
    if rate is None or not rate > 0.0:
        raise click.UsageError("-o needs the sample rate of the path: --rate 20kHz")


def _figures(kind: str, made, found, best: float) -> dict[str, Any]:
    """Return the figures in SI; None for a figure that is unlimited or that this kind of scan lacks."""
    from hysteresis_ros.references.scan import AXES

    low, high = made.extent()
    peaks = [made.peak(order) for order in (1, 2, 3)]
    strengths = [
        {"frequency_hz": float(frequency), **dict(zip(AXES, map(_complex, row), strict=False))}
        for frequency, row in zip(found.frequencies, found.amplitudes.T, strict=True)
    ]
    return {
        "scan": kind,
        "size_m": made.size,
        "gap_m": _finite(made.gap),
        "frame_rate_hz": made.rate,
        "frame_time_s": made.frame_time,
        "period_s": made.period,
        "lines": made.lines_per_frame,
        "pixels": made.pixels,
        "constant_share_percent": 100.0 * made.constant_share,
        "line_velocity_m_s": getattr(made, "line_velocity", None),
        "bandwidth_hz": made.bandwidth,
        "largest_frame_rate_hz": _finite(best),
        "axes": {
            name: dict(
                low_m=float(low[i]),
                high_m=float(high[i]),
                velocity_m_s=float(peaks[0][i]),
                acceleration_m_s2=float(peaks[1][i]),
                jerk_m_s3=_finite(float(peaks[2][i])),
            )
            for i, name in enumerate(AXES[: made.axes])
        },
        "harmonics": strengths,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _complex(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]


def _lines(figures: dict[str, Any]) -> list[str]:
    """Return the figures as readable lines."""
    from hysteresis_ros.units import readable

    gap, best = figures["gap_m"], figures["largest_frame_rate_hz"]
    apart = "" if gap is None else f", neighbouring lines up to {readable(gap, 'm')} apart"
    speed = figures["line_velocity_m_s"]
    speed = "" if speed is None else f" ({1e3 * speed:.4g} mm/s)"
    share = figures["constant_share_percent"]
    steady = f"; data at a constant velocity for {share:.4g} % of the time{speed}" if share else ""
    lines = [
        f"{figures['scan']:<11}size {readable(figures['size_m'], 'm')}{apart}",
        f"frame      {readable(figures['frame_time_s'], 's')}, {figures['frame_rate_hz']:.4g} Hz; repeats after "
        f"{readable(figures['period_s'], 's')}",
        f"lines      {figures['lines']} of {figures['pixels']} pixels{steady}",
        f"99.99 % of the power of the motion is below {figures['bandwidth_hz']:.4g} Hz",
        "limits     " + ("set no bound" if best is None else f"allow up to {best:.4g} Hz (frames per second)"),
        "",
        f"{'axis':<6}{'from … to [µm]':>22}{'velocity [mm/s]':>18}{'acceleration [m/s²]':>22}{'jerk [m/s³]':>16}",
    ]
    for name, axis in figures["axes"].items():
        span = f"{1e6 * axis['low_m']:.5g} … {1e6 * axis['high_m']:.5g}"
        jerk = "jumps" if axis["jerk_m_s3"] is None else f"{axis['jerk_m_s3']:.4g}"
        lines.append(
            f"{name:<6}{span:>22}{1e3 * axis['velocity_m_s']:>18.4g}{axis['acceleration_m_s2']:>22.4g}{jerk:>16}"
        )
    names = list(figures["axes"])
    lines += ["", f"{'harmonic [Hz]':<14}" + "".join(f"{f'{name}: amplitude, phase':>26}" for name in names)]
    for one in figures["harmonics"]:
        cells = [_amplitude(complex(*one[name]), figures["size_m"]) for name in names]
        lines.append(f"{one['frequency_hz']:<14.6g}" + "".join(f"{cell:>26}" for cell in cells))
    return lines


def _amplitude(value: complex, size: float) -> str:
    """Return amplitude and phase of a harmonic as text; ``0`` for a rounding error.

    Units: ``size`` [m].
    """
    from hysteresis_ros.units import readable

    return f"{readable(abs(value), 'm')}, {_phase(value):.1f}°" if abs(value) > ROUNDING * size else "0"


def _phase(value: complex) -> float:
    """Return the phase in degrees, without a negative zero."""
    return round(math.degrees(math.atan2(value.imag, value.real)), 1) + 0.0


def _write_path(output: pathlib.Path, made, rate: float, frames: int | None) -> str:
    """Write the path with frame, line and pixel of each sample; return a sentence about the file."""
    import numpy as np

    from hysteresis_ros.errors import RecordingError
    from hysteresis_ros.files import replacing
    from hysteresis_ros.references.scan import AXES

    lasts = (frames or made.frames_per_period) * made.frame_time
    count = max(math.ceil(lasts * rate * (1.0 - 1e-12)), 1)
    if count > MOST_SAMPLES:
        raise RecordingError(f"--rate {rate:g}: {count} samples, allowed: ≤ {MOST_SAMPLES}; write fewer frames")
    time = np.arange(count) / rate
    clock = made.clock(time)
    columns = {"time": time, **dict(zip(AXES, made.position(time), strict=False))}
    whole = {"frame": clock.frame, "line": clock.line, "pixel": clock.pixel, "direction": clock.direction}
    with replacing(output, RecordingError) as beside:
        if output.suffix.lower() == ".npz":
            with beside.open("wb") as stream:
                np.savez(stream, **columns, **whole)
        else:
            units = ["time [s]", *(f"{name} [m]" for name in list(columns)[1:]), *whole]
            table = np.column_stack([*columns.values(), *whole.values()])
            form = ["%.17g"] * len(columns) + ["%d"] * len(whole)
            np.savetxt(beside, table, form, ",", header=",".join(units), comments="")
    return f"{output}: written, {count} samples at {rate:g} Hz"
