# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis simulate``: the blocks of a configuration in closed loop, without ROS."""

from __future__ import annotations

from typing import Any

import click

from hysteresis_ros.cli.options import (
    ConfigurationName,
    Quantity,
    RunFile,
    laid_under,
    params_file_option,
    reference_options,
    scan_options,
    scanning,
    trigger_option,
    triggering,
)
from hysteresis_ros.cli.progress import shown
from hysteresis_ros.cli.recording import warn_lost_offsets


@click.command(short_help="Simulate a configuration without ROS.")
@click.argument("config", type=ConfigurationName())
@click.option("-o", "--output", required=True, type=RunFile(), help="File to write: .npz, .csv or .mcap.")
@params_file_option
@click.option("--duration", type=Quantity("s"), help="Length of the run [s]; by default that of the configuration.")
@click.option(
    "--setpoints",
    help="Recording whose setpoints (for an inchworm also requests and speeds) are replayed, sample by sample.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME:START:DURATION[:VALUE]",
    help="Inject this fault; repeatable.",
)
@click.option(
    "--quiet",
    "quiets",
    multiple=True,
    metavar="START:DURATION[:TOLERANCE]",
    help="Hold the command constant, such as 1s:500ms:5nm; repeatable. TOLERANCE: largest drift by creep.",
)
@click.option(
    "--learned", metavar="FILE", help="File for the correction at the end of the run; learning.file can name it."
)
@click.option(
    "--drift",
    type=float,
    nargs=2,
    metavar="GAIN OPENING",
    help="Relative change of gain and loop width of the plant's hysteresis over the run, such as 0.2 -0.1.",
)
@scan_options
@reference_options
@trigger_option
@click.option(
    "--namespace",
    help="Axis to use, if the configuration describes several; in a stage, the axis that gets the faults or the "
    "reference.",
)
def simulate(
    config,
    values,
    output,
    laid_over,
    duration,
    setpoints,
    faults,
    quiets,
    learned,
    drift,
    scan,
    namespace,
    reference,
    triggers,
):
    """Run the blocks of CONFIG in closed loop, bit for bit as the nodes do in lockstep, and write all signals.

    A stage may follow a scan, see `hysteresis scan`: `hysteresis simulate xy_scanner --scan raster width=30um
    depth=30um lines=32 line_rate=5Hz -o run.npz`.
    """
    from hysteresis_ros.loop.quiet import quiets_of
    from hysteresis_ros.loop.reach import reach_warnings, single_axis
    from hysteresis_ros.loop.simulation import mode_lines
    from hysteresis_ros.loop.simulation import simulate as run_offline
    from hysteresis_ros.recordings.align import setpoints_per_sample
    from hysteresis_ros.recordings.dataset import requests_per_sample
    from hysteresis_ros.recordings.files import load_run, save_run

    configuration = reference.put_into(laid_under(config, laid_over), namespace)
    configuration = scanning(configuration, scan, values, reference)
    configuration = triggering(configuration, triggers, namespace)
    if configuration.stage is not None:
        refused = {"--learned": learned, "--drift": drift, "--quiet": quiets}
        for option, value in refused.items():
            if value:
                raise click.UsageError(
                    f"{option} is for a single axis, and {configuration.source} describes a stage: omit it"
                )
        with reference.named():
            asked = bool(reference.kind or triggers)
            _simulate_stage(configuration, output, duration, setpoints, faults, namespace, asked)
        return
    with reference.named():
        parameters = single_axis(configuration, namespace)
    for warning in reach_warnings(parameters):
        click.echo(f"hysteresis: warning: {warning}", err=True)
    if faults:
        parameters = parameters.with_faults(faults)
        for line in parameters.timeouts():
            click.echo(line)
    replay: dict[str, Any] = {"quiet": quiets_of(quiets)}
    if setpoints is not None:
        recorded = load_run(setpoints, namespace)
        replay |= {"setpoints": setpoints_per_sample(recorded), **requests_per_sample(recorded)}
    with shown("simulating; the first run of a version compiles"):
        keep = (lambda axis: axis.controller.save(learned, config)) if learned else None
        recording = run_offline(parameters, duration=duration, drift=drift or (0.0, 0.0), finished=keep, **replay)
    save_run(recording, output)
    warn_lost_offsets(recording, output)
    _warn_unreached(faults, recording, parameters.plant_simulator.sample_rate)
    _warn_limited(recording)
    if faults or quiets or recording["tripped"].any():
        for line in mode_lines(recording):
            click.echo(line)
    rate = parameters.plant_simulator.sample_rate
    click.echo(f"{output}: {recording.time.size} samples at {rate:g} Hz ({recording.time.size / rate:g} s)")
    _say_triggers(recording)
    generator = parameters.reference_generator
    if generator is not None and generator.waveform.type == "hold" and setpoints is None:
        click.echo(
            "note: the axis did not move: the waveform of the configuration is hold; choose a waveform, e.g. "
            "--reference triangle --frequency 5Hz --amplitude 1um",
            err=True,
        )
    if recording.has("error") and recording["error"][-1] != 0.0:
        from hysteresis_ros.references.inchworm_layout import ERROR_NAMES

        name = ERROR_NAMES[int(recording["error"][-1])]
        click.echo(f"hysteresis: warning: the motor stopped with the error {name}; see hysteresis report", err=True)


def _warn_unreached(faults, recording, rate: float) -> None:
    """Warn of faults that begin after the end of the run; ``rate`` [Hz]."""
    from hysteresis_ros.loop.faults import unreached

    for warning in unreached(faults, len(recording), rate):
        click.echo(f"hysteresis: warning: {warning}", err=True)


def _warn_limited(recording, axis: str = "") -> None:
    """Warn of an output that was limited for long."""
    from hysteresis_ros.analysis.metrics import limited_text

    limited = limited_text(recording)
    if limited:
        click.echo(f"hysteresis: warning: {axis}{limited}", err=True)


def _say_triggers(recording, axis: str = "") -> None:
    """Print the number of triggers of an axis, if it has any."""
    from hysteresis_ros.recordings.triggers import triggers_of

    found = triggers_of(recording)
    if found.sample.size:
        lost = f"; {found.lost} more were lost because they followed too fast" if found.lost else ""
        first, last = found.time[0], found.time[-1]
        click.echo(f"{axis}{found.sample.size} triggers from {first:.9g} to {last:.9g} s{lost}")


def _simulate_stage(configuration, output, duration, setpoints, faults, namespace, asked) -> None:
    """Run a stage, write its recording, and print the errors of its axes and those due to coupling."""
    from hysteresis_ros.analysis.metrics import STAGE_BEGINS, compute_metrics
    from hysteresis_ros.analysis.scan_report import format_scan, scan_figures
    from hysteresis_ros.api import scan_run, stage_axes_of
    from hysteresis_ros.loop.simulation import mode_lines
    from hysteresis_ros.loop.stage_response import scan_warnings
    from hysteresis_ros.loop.stage_simulation import chosen_stage, coupling_errors, simulate_stage
    from hysteresis_ros.recordings.align import setpoints_per_sample
    from hysteresis_ros.recordings.files import load_run, save_run
    from hysteresis_ros.units import readable

    parameters = chosen_stage(configuration, faults, namespace, asked)
    for warning in (*parameters.warnings(), *scan_warnings(parameters)):
        click.echo(f"hysteresis: warning: {warning}", err=True)
    replayed = None
    if setpoints is not None:
        recorded = load_run(setpoints)
        replayed = {name: setpoints_per_sample(recorded.axis(name)) for name in parameters.names}
    with shown("simulating; the first run of a version compiles"):
        recording = simulate_stage(parameters, duration=duration, setpoints=replayed)
        coupled = [] if faults or replayed or parameters.scan else coupling_errors(parameters, duration)
        scanned = scan_run(recording) if parameters.scan else None
    save_run(recording, output)
    warn_lost_offsets(recording, output)
    rate = parameters.sample_rate
    _warn_unreached(faults, recording, rate)
    click.echo(
        f"{output}: {recording.time.size} samples at {rate:g} Hz ({recording.time.size / rate:g} s), axes "
        f"{', '.join(parameters.names)}"
    )
    for name, axis in stage_axes_of(recording).items():
        figures = compute_metrics(axis, parts=False)
        rms, peak = readable(figures["rms_error_m"], "m"), readable(figures["max_error_m"], "m")
        begin = axis.metadata[STAGE_BEGINS] - axis.time[0]
        click.echo(f"{name}: RMS error {rms}, maximum {peak}" + (f", from {begin:.4g} s on" if begin else ""))
        _warn_limited(axis, f"{name}: ")
        _say_triggers(axis, f"{name}: ")
        if faults or axis["tripped"].any():
            for line in mode_lines(axis):
                click.echo(f"{name}: {line}")
    if scanned is not None:
        click.echo(f"scan from {scanned.time[0]:.6g} s on, including the time between samples:")
        click.echo(format_scan(scan_figures(scanned)))
    for error in coupled:
        rms, peak = readable(error.rms, "m"), readable(error.peak, "m")
        click.echo(
            f"coupling: {error.scanning} scans {readable(error.scanned, 'm')}, {error.held} moves by {rms} RMS, at "
            f"most {peak} ({100.0 * error.part:.2g} % of the scan)"
        )
