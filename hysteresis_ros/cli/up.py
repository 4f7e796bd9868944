# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis up``: start the graph of a configuration."""

from __future__ import annotations

import contextlib
import pathlib
import signal
import sys

import click

from hysteresis_ros.cli.options import (
    ConfigurationName,
    Quantity,
    laid_under,
    params_file_option,
    reference_options,
    scan_options,
    scanning,
    split_options,
    splitting,
    trigger_option,
    triggering,
)


@click.command(short_help="Start the nodes of a configuration.")
@click.argument("config", type=ConfigurationName())
@params_file_option
@click.option(
    "--processes/--composed",
    "processes",
    default=None,
    help="Run the nodes in four processes or in one; by default in four, or --fused if four are too slow.",
)
@click.option("--record", metavar="DIR", help="Record everything into this new bag folder.")
@split_options
@click.option("--duration", type=Quantity("s"), help="Length of the run [s of axis time]; by default until Ctrl-C.")
@click.option(
    "--rate",
    type=click.Choice(["realtime", "lockstep", "fused"]),
    help="Time mode; by default that of the configuration.",
)
@click.option("--fused", is_flag=True, help="Run the loop in one compiled thread of one process, in real time.")
@click.option("--factor", type=float, help="Real-time factor; by default that of the configuration.")
@click.option("--force", is_flag=True, help="Run fused even at a rate that this machine does not achieve.")
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: your own node replaces plant_simulator and publishes joint_states.",
)
@click.option(
    "--namespace",
    help="Start only the axis in this namespace; for a stage, the axis that gets the faults or the reference.",
)
@click.option("--watch", is_flag=True, help="Show each axis in the browser, as hysteresis watch does.")
@click.option(
    "--verify",
    is_flag=True,
    help="Compare the recorded run with the offline twin, bit for bit; with --fused or --rate lockstep.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME:START:DURATION[:VALUE]",
    help="Inject this fault; repeatable.",
)
@scan_options
@reference_options
@trigger_option
@click.option(
    "--log-level",
    type=click.Choice(["debug", "info", "warn", "error", "fatal"]),
    default="info",
    help="Log level of the nodes.",
    show_default=True,
)
def up(
    config,
    laid_over,
    processes,
    record,
    max_bag_size,
    max_bag_duration,
    duration,
    rate,
    fused,
    factor,
    force,
    plant,
    namespace,
    watch,
    verify,
    faults,
    log_level,
    scan,
    values,
    reference,
    triggers,
):
    """Start all nodes of CONFIG and stop them together.

    A stage may follow a scan, as in `hysteresis simulate`: `hysteresis up xy_scanner --scan raster width=20um
    depth=20um lines=32 line_rate=5Hz`.

    Exit code 0: after --duration or Ctrl-C; 1: a node has died, or the device of a recorded axis has failed and is not
    started again; 2: wrong input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.loop.parameters import in_time, require_carried
    from hysteresis_ros.loop.reach import axes, reach_warnings
    from hysteresis_ros.nodes.launcher import Graph, require_messages

    rate = _time_mode(rate, fused, processes)
    configuration = laid_under(config, laid_over)
    coupled = configuration.stage is not None
    configuration = reference.put_into(configuration, namespace if coupled else None)
    configuration = scanning(configuration, scan, values, reference)
    configuration = triggering(configuration, triggers, namespace if coupled else None)
    configuration = _overridden(configuration, rate, factor, force, plant)
    configuration = splitting(configuration, max_bag_size, max_bag_duration)
    stage = None
    with reference.named():
        if coupled:
            asked = bool(reference.kind or triggers)
            stage = _stage(configuration, faults, namespace, asked, duration)
            stage = stage.in_time() if rate is None and processes is None else stage
            require_messages(stage)
            found = list(stage.axes)
        else:
            found = axes(configuration, namespace)
    for axis in found:
        for warning in reach_warnings(axis):
            click.echo(f"hysteresis: warning: {warning}", err=True)
    if faults and stage is None:
        found = [axis.with_faults(faults) for axis in found]
    if duration is not None and stage is None:
        found = [axis.with_duration(duration) for axis in found]
    if rate is None and processes is None and stage is None:
        found = [in_time(axis) for axis in found]
    for axis in found:
        require_carried(axis)
    _check_together(found, verify, record, factor)
    if requested:
        click.echo("stopping")
        return
    pages = _pages(found) if watch else None
    graph = Graph(found, stage=stage, composed=processes is False, record=record, log_level=log_level)
    if stage is not None:
        click.echo(f"axes {', '.join(stage.names)}: {_what_runs(found[0], processes is False)}")
    ranges = [None] * len(found) if stage is None else stage.travel().tolist()
    for axis, travel in zip(found, ranges, strict=True):
        own = [_what_runs(axis, processes is False)] if stage is None else []
        for line in (*own, *axis.timeouts(travel)):
            click.echo(f"{axis.namespace}{': ' if axis.namespace else ''}{line}")
    with graph, pages or contextlib.nullcontext():
        ended = graph.wait(lambda: bool(requested) or (pages is not None and pages.over()))
        click.echo("the run ended" if ended else "stopping")
    failed = _look_at_runs(graph)
    _say_recorded(graph)
    if pages is not None and pages.exit_code():
        sys.exit(pages.exit_code())
    if verify:
        _verify(graph)
    if failed:
        sys.exit(1)


def _stage(configuration, faults, namespace: str | None, asked: bool, duration: float | None):
    """Return the stage of a configuration, with faults in the axis that ``namespace`` names."""
    from hysteresis_ros.loop.stage_response import scan_warnings
    from hysteresis_ros.loop.stage_simulation import chosen_stage

    stage = chosen_stage(configuration, faults, namespace, asked)
    for warning in scan_warnings(stage):
        click.echo(f"hysteresis: warning: {warning}", err=True)
    return stage if duration is None else stage.with_duration(duration)


def _pages(axes):
    """Return the pages of axes; import the server only when pages are requested."""
    from hysteresis_ros.registry import resolved

    options = resolved("hysteresis_ros.laboratory.watch.server_process:PageOptions")()
    return resolved("hysteresis_ros.laboratory.watch.server_process:Pages")([axis.namespace for axis in axes], options)


def _time_mode(rate: str | None, fused: bool, processes: bool | None) -> str | None:
    """Return the requested time mode."""
    if fused and (rate not in (None, "fused") or processes is not None):
        other = f"--rate {rate}" if processes is None else "--processes or --composed"
        raise click.UsageError(f"--fused and {other} exclude each other; give one of them")
    return "fused" if fused else rate


def _overridden(configuration, rate, factor, force, plant):
    """Return the configuration with the changes of the options."""
    everywhere = {"exit_at_end": True, "autostart": True}
    if rate:
        everywhere["time_mode"] = rate
    if plant == "external":
        everywhere["external_plant"] = True
    configuration = configuration.override("", **everywhere)
    if factor is not None:
        configuration = configuration.override("plant_simulator", real_time_factor=factor)
    return configuration.override("plant_simulator", realtime__force=True) if force else configuration


def _check_together(found, verify: bool, record: str | None, factor: float | None) -> None:
    """Refuse options that are invalid in the time modes of the axes; warn about options without effect."""
    modes = {axis.plant_simulator.time_mode for axis in found}
    if verify and not (record and modes <= {"lockstep", "fused"}):
        raise click.UsageError(
            "--verify needs --record DIR, and --fused or --rate lockstep: only these repeat bit for bit"
        )
    if factor is not None and "lockstep" in modes:
        click.echo("hysteresis: warning: --factor has no effect in lockstep, which runs as fast as it can", err=True)


def _what_runs(axis, composed: bool) -> str:
    """Return a line with the time mode, the rate and the length of the run."""
    plant = axis.plant_simulator
    seconds = plant.samples / plant.sample_rate
    length = f"for {seconds:g} s of axis time" if plant.samples else "until Ctrl-C"
    if plant.time_mode == "lockstep":
        how = "in lockstep, one process" if composed else "in lockstep, a process for each node"
        return f"{how}: {plant.sample_rate:g} Hz of the axis, as fast as it can, {length}"
    how = "fused, one process" if plant.time_mode == "fused" else "in real time, a process for each node"
    how = "in real time, one process" if composed and plant.time_mode == "realtime" else how
    return f"{how}: {plant.sample_rate:g} Hz, real-time factor {plant.real_time_factor:g}, {length}"


#: Maximum size [bytes] of a bag that is evaluated at the end of a run; for a larger bag use `report`.
LOOKED_AT = 300_000_000


def _look_at_runs(graph) -> bool:
    """Warn of outputs that saturated for long; return whether a device had failed at the end."""
    import numpy as np

    from hysteresis_ros.analysis.metrics import limited_text
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.loop.plant import DEVICE_FAILED
    from hysteresis_ros.recordings.align import read_recording

    failed = False
    bags = graph.bags * len(graph.axes) if graph.stage is not None else graph.bags
    for axis, bag in zip(graph.axes, bags, strict=False):
        if sum(path.stat().st_size for path in pathlib.Path(bag).rglob("*")) > LOOKED_AT:
            continue
        try:
            run = read_recording(bag, axis.namespace, further=True)
        except HysteresisError:
            continue  # errors of the bag are reported below, or by the reader of the bag
        name = f"{axis.namespace}: " if axis.namespace else ""
        limited = limited_text(run)
        if limited:
            click.echo(f"hysteresis: warning: {name}{limited}", err=True)
        broken = run["tripped"] == DEVICE_FAILED if run.has("tripped") else np.zeros(len(run), bool)
        if broken[-1]:
            first = len(run) - int(np.argmin(broken[::-1])) if not broken.all() else 0
            when = f"{run.time[first] - run.time[0]:.4g} s"
            click.echo(f"hysteresis: {name}the device failed at {when}; the axis was stopped until the end", err=True)
            failed = True
    return failed


def _say_recorded(graph) -> None:
    """Print the bags. A bag is incomplete if its recorder died or ran out of disk space; this is an error."""
    short = "; it ends before the run; if the bag was cut off, use hysteresis repair" if graph.lost else ""
    for bag in graph.bags:
        click.echo(f"recorded: {bag}{short}")
    if graph.lost:
        sys.exit(1)


def _verify(graph) -> None:
    from hysteresis_ros.cli.recording import equal, unlike
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.loop.stage_simulation import stage_differences
    from hysteresis_ros.recordings.align import read_recording

    if graph.stage is not None:
        (bag,) = graph.bags
        recorded = read_recording(bag, further=True)
        wrong = unlike(bag, recorded, stage_differences(recorded, graph.stage))
        if wrong:
            raise HysteresisError(wrong)
        click.echo(equal(bag, recorded.time.size))
        return
    for axis, bag in zip(graph.axes, graph.bags, strict=True):
        recorded = read_recording(bag, axis.namespace, further=True)
        wrong = unlike(bag, recorded, differences(recorded, axis))
        if wrong:
            raise HysteresisError(wrong)
        click.echo(equal(bag, recorded.time.size))
