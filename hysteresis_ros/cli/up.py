"""``hysteresis up``: start the graph of a configuration."""

from __future__ import annotations

import signal

import click


@click.command(short_help="Start the nodes of a configuration.")
@click.argument("config", type=click.Path(path_type=str))
@click.option("--processes/--composed", "processes", default=True, help="Four processes (default) or one.")
@click.option("--record", metavar="DIR", help="Record everything into this new bag folder.")
@click.option("--duration", type=float, help="Length of the run [s of the axis]; by default until Ctrl-C.")
@click.option("--rate", type=click.Choice(["realtime", "lockstep"]), help="Time mode; the configuration's by default.")
@click.option("--factor", type=float, help="Real-time factor; the configuration's by default.")
@click.option("--namespace", help="Start only the axis in this namespace.")
@click.option("--verify", is_flag=True, help="Compare the recorded lockstep run with the offline twin, bit for bit.")
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME:START:DURATION[:VALUE]",
    help="Make this go wrong; may be repeated.",
)
@click.option(
    "--log-level",
    type=click.Choice(["debug", "info", "warn", "error", "fatal"]),
    default="info",
    help="Log level of the nodes.",
    show_default=True,
)
def up(config, processes, record, duration, rate, factor, namespace, verify, faults, log_level):
    """Start all nodes of CONFIG and bring them down together.

    Ends with exit code 0 after --duration or Ctrl-C, with 1 when a node dies, with 2 for wrong input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.nodes.launcher import Graph
    from hysteresis_ros.simulation.axes import axes
    from hysteresis_ros.simulation.reach import reach_warnings

    configuration = load_configuration(config)
    if rate:
        configuration = configuration.override("", time_mode=rate)
    if factor is not None:
        configuration = configuration.override("plant_simulator", real_time_factor=factor)
    configuration = configuration.override("", exit_at_end=True, autostart=True)
    found = axes(configuration, namespace)
    for axis in found:
        for warning in reach_warnings(axis):
            click.echo(f"hysteresis: warning: {warning}", err=True)
    if faults:
        found = [axis.with_faults(faults) for axis in found]
    if duration is not None:
        found = [axis.with_duration(duration) for axis in found]
    lockstep = all(axis.plant_simulator.time_mode == "lockstep" for axis in found)
    if verify and not (record and lockstep):
        raise click.UsageError("--verify needs --record DIR and --rate lockstep: only lockstep repeats bit for bit")

    if factor is not None and any(axis.plant_simulator.time_mode == "lockstep" for axis in found):
        click.echo("hysteresis: warning: --factor has no effect in lockstep, which runs as fast as it can", err=True)
    if requested:
        click.echo("stopping")
        return
    graph = Graph(found, composed=not processes, record=record, log_level=log_level)
    for axis in found:
        for line in axis.timeouts():
            click.echo(f"{axis.namespace}{': ' if axis.namespace else ''}{line}")
    with graph:
        if graph.wait(lambda: bool(requested)):
            click.echo("the run ended")
        else:
            click.echo("stopping")
    for bag in graph.bags:
        click.echo(f"recorded: {bag}")
    if verify:
        _verify(graph)


def _verify(graph) -> None:
    from hysteresis_ros.cli.verify import differing, equal
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.recordings.align import read_recording
    from hysteresis_ros.simulation.run import differences

    for axis, bag in zip(graph.axes, graph.bags, strict=True):
        recorded = read_recording(bag, axis.namespace, further=True)
        found = differences(recorded, axis)
        missing = recorded.metadata.get("missing_samples", 0)
        if found or missing:
            raise HysteresisError(differing(bag, found, missing))
        click.echo(equal(bag, recorded.time.size))
