"""``hysteresis demo``: four nodes over real DDS, moved by setpoints on a topic, recorded and reported."""

from __future__ import annotations

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace

import click

#: Time [s of the axis] and setpoint [m] of each message: the paper's step of 1 V, then a walk over the stroke.
SETPOINTS = ((0.05, 2.05e-6), (0.25, 0.0), (0.45, 5.0e-6), (0.65, 9.0e-6), (0.85, 3.0e-6), (1.05, 0.0))
#: Length of the demonstration [s of the axis]; the publisher may need some of it to be discovered.
DURATION = 1.6
#: Part of the lockstep rate that is taken for real time: a stack that rings at 635 Hz forgives no late voltage.
MARGIN = 0.2
#: Largest part of the voltages that may come late, and by how much the axis is slowed when more did.
LATE, SLOWER = 0.05, 2.0


@click.command(short_help="Run Kim's axis as four processes, move it, record it, report it.")
@click.option("-o", "--output", default="demo", show_default=True, help="New folder for bag, report and figures.")
@click.option("--factor", type=float, help="Real-time factor; measured on this machine by default.")
def demo(output, factor):
    """Run the inchworm's propulsion part of Kim 2009 in real time and leave a bag, report.html and metrics.json."""
    from hysteresis_ros.configuration import config_path, load_configuration
    from hysteresis_ros.errors import ConfigurationError

    folder = pathlib.Path(output)
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists already; choose another folder with -o or remove it")
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be created: {error.strerror}; choose another folder with -o"
        ) from None
    configuration = load_configuration(config_path("kim2009"))
    configuration = configuration.override("", exit_at_end=True)
    # the waveform of the file stays out: here the setpoints come from outside, on the topic
    configuration = configuration.override("reference_generator", waveform__type="hold")
    # it is simulated, and shows itself on a busy machine too: late voltages are counted and told, nothing is stopped
    configuration = configuration.override("plant_simulator", late_limit=-1)
    from hysteresis_ros.nodes.domain import entered

    with entered():  # a running axis of the user and this one must not hear each other
        _held(configuration, factor, folder)
    _report(folder)


def _held(configuration, factor: float | None, folder: pathlib.Path) -> None:
    """Run the axis at the given factor, or at one that this machine holds."""
    held = _measured_factor(configuration) if factor is None else factor
    late = _run(configuration, held, folder)
    if factor is None and late > LATE:
        click.echo(f"{100.0 * late:.1f} % of the voltages came late: this machine is busy; once more, slower")
        shutil.rmtree(folder / "bag")
        _run(configuration, round(held / SLOWER, 3), folder)


def _axis(configuration):
    """Return the axis in a namespace of its own: another graph may enter the domain while this one runs."""
    from hysteresis_ros.simulation.axes import axes

    return replace(axes(configuration)[0], namespace=f"/demo_{os.getpid()}")


def _run(configuration, factor: float, folder: pathlib.Path) -> float:
    """Run the axis while setpoints are published, and return which part of the voltages came late."""
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.nodes.launcher import Graph, node_environment
    from hysteresis_ros.recordings.files import load_run

    axis = _axis(configuration.override("plant_simulator", real_time_factor=factor)).with_duration(DURATION)
    rate = axis.plant_simulator.sample_rate
    click.echo(f"running {DURATION:g} s of the axis at {rate:g} Hz, real-time factor {factor:g}, four processes …")
    with Graph([axis], record=folder / "bag", log_level="warn") as graph:
        publisher = subprocess.Popen(_publisher_command(axis.namespace), env=node_environment())
        try:
            graph.wait()
        finally:
            code = publisher.poll()
            publisher.kill()
            publisher.wait()
    if code != 0:
        raise HysteresisError(
            "the setpoints could not all be published before the end of the run; try a smaller --factor"
        )
    run = load_run(folder / "bag")
    return run.metadata["late_commands"] / run.time.size


def _publisher_command(namespace: str) -> list[str]:
    times, values = ([repr(item) for item in column] for column in zip(*SETPOINTS, strict=True))
    module = [sys.executable, "-m", "hysteresis_ros.nodes.setpoint_publisher"]
    return [*module, "--namespace", namespace, "--setpoint", *values, "--at", *times]


def _measured_factor(configuration) -> float:
    """Run a moment in lockstep and return the real-time factor this machine holds, at most 1."""
    from hysteresis_ros.nodes.launcher import Graph
    from hysteresis_ros.recordings.files import load_run

    axis = _axis(configuration.override("", time_mode="lockstep"))
    axis = axis.with_duration(1000.0 / axis.plant_simulator.sample_rate)
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        with Graph([axis], record=pathlib.Path(folder) / "bag", log_level="warn") as graph:
            graph.wait()
        reached = load_run(graph.bags[0]).metadata["timing"]["rate_hz"]
    share = MARGIN * reached / axis.plant_simulator.sample_rate
    click.echo(f"this machine answers {reached:.0f} samples a second in four processes")
    return 1.0 if share >= 1.0 else max(round(share, 2), 0.01)


def _report(folder: pathlib.Path) -> None:
    from hysteresis_ros.cli.report import report
    from hysteresis_ros.recordings.files import load_run

    arguments = [str(folder / "bag"), "-o", str(folder / "report.html"), "--json", str(folder / "metrics.json")]
    report.main(arguments, standalone_mode=False)
    run = load_run(folder / "bag")
    reached, rate = run.metadata["timing"]["rate_hz"], 1.0 / run.sample_time
    click.echo(f"real-time factor reached: {reached / rate:.3f} ({reached:.0f} of {rate:.0f} samples a second)")
    click.echo(f"bag, report.html and metrics.json are in {folder}")
