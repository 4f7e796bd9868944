# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis demo``: run an axis in real time without and with the inverse, with setpoints, and as processes."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import subprocess
import sys
import time
from dataclasses import replace

import click

from hysteresis_ros.cli.progress import Progress

#: Time [s of axis time] and setpoint [m] of each message: the paper's step of 1 V, then steps over the stroke.
SETPOINTS = ((0.05, 2.05e-6), (0.25, 0.0), (0.45, 5.0e-6), (0.65, 9.0e-6), (0.85, 3.0e-6), (1.05, 0.0))
#: Frequency [Hz], peak-to-peak displacement [m] and number of the triangles.
TRIANGLES = 1.0, 1.0e-5, 2
#: Length of the run in lockstep [s of axis time]: only the beginning of the triangles.
LOCKSTEP = 0.75
#: Time for which the last setpoint is held [s of axis time].
HELD = 0.2
#: Time-out for the publication of all setpoints [s of axis time].
PATIENCE = 60.0

#: Minimum interval of progress messages in a file or pipe [s].
SILENCE = 10.0
#: Length of the run with steps if there are no compiled kernels [s of axis time].
INTERPRETED = 2.4

#: Folders of the recordings.
WITHOUT, WITH, STEPS, PROCESSES = "without_inverse", "with_inverse", "bag", "lockstep"
#: Colours of the runs without and with the inverse in the figure.
COLOURS = ("#d1495b", "#1f3b73")
#: Colour of skipped samples in the figure.
MISSED = "#e08e0b"
MICRO = 1e6


@click.command(short_help="Run Kim's axis in real time and as four processes, and report the results.")
@click.option("-o", "--output", default="demo", show_default=True, help="New folder for bags, report and figures.")
@click.option("--factor", type=click.FloatRange(0.0, 1.0, min_open=True), default=1.0, help="Real-time factor.")
def demo(output, factor):
    """Run the inchworm's propulsion part of Kim 2009 at 3 kHz; write bags, a picture, report.html and metrics.json.

    First, in real time and fused: a triangle without and with the inverse of the hysteresis, and steps by setpoints on
    the topic. Then the triangle runs as four processes in lockstep, and is compared bit for bit with the offline twin.
    """
    # only the results go to stdout
    progress = Progress(err=True, silence=SILENCE)
    progress.say("Kim's axis at 3 kHz: a triangle without and with the inverse of the hysteresis, then steps")
    with progress.during("loading"):
        from hysteresis_ros.nodes.domain import entered
        from hysteresis_ros.nodes.launcher import require_ros

        require_ros()
        folder = _new_folder(output)
        axes = _axes(factor)
    with entered():  # isolated from any running axis of the user
        _compile(axes.values(), progress)
        _run_live(axes, folder, progress)
        _run_processes(axes[WITH], folder, progress)
    runs, proof = _read(folder, progress)
    _report(folder, axes, runs, proof, progress)


def _new_folder(output: str) -> pathlib.Path:
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
    return folder


def _axes(factor: float) -> dict:
    """Return the axes by the folders of their recordings."""
    from hysteresis_ros.configuration import config_path, load_configuration
    from hysteresis_ros.models.block import COMPILED

    configuration = load_configuration(config_path("kim2009"))
    # without compiled kernels no loop is fast enough for real time, so the nodes run in lockstep, as fast as possible
    configuration = configuration.override("", exit_at_end=True, time_mode="fused" if COMPILED else "lockstep")
    # a busy machine skips samples: they are counted and reported, but do not stop the simulated axis
    configuration = configuration.override("plant_simulator", late_limit=-1, real_time_factor=factor)
    frequency, stroke, cycles = TRIANGLES
    triangle = dict(waveform__type="triangle", waveform__frequency=frequency, waveform__cycles=cycles)
    triangle |= dict(waveform__amplitude=stroke)
    open_loop = configuration.override("motion_controller", type="open_loop")
    closed = open_loop.override("reference_generator", **triangle)
    # in the run with steps the setpoints come from the topic, not from the waveform of the file
    steps = configuration.override("reference_generator", waveform__type="hold")
    return {
        WITHOUT: _axis(closed.override("hysteresis_compensator", inverse__type="none"), WITHOUT, cycles / frequency),
        WITH: _axis(closed, WITH, cycles / frequency),
        # in real time the run ends when all setpoints have arrived; a stopped lockstep run ends within a sample
        STEPS: _axis(steps, "steps", None if COMPILED else INTERPRETED),
    }


def _axis(configuration, name: str, duration: float | None = None):
    """Return an axis in a separate namespace, because another graph may join the domain while this one runs."""
    from hysteresis_ros.loop.reach import axes

    axis = replace(axes(configuration)[0], namespace=f"/demo_{os.getpid()}/{name}")
    return axis if duration is None else axis.with_duration(duration)


def _compile(axes, progress: Progress) -> None:
    """Compile the loops once, so that the processes find the machine code in the cache."""
    from hysteresis_ros.models.block import COMPILED

    if not COMPILED:
        progress.say("Numba is not installed: nothing is compiled, so the nodes run in lockstep, not in real time")
        progress.say('(real time needs the extra "fast": pip install "hysteresis_ros[fast]")')
        return
    from hysteresis_ros.loop.axis import Axis
    from hysteresis_ros.loop.fused import FusedLoop

    with progress.during("compiling the loop, once for this version"):
        for axis in axes:
            FusedLoop(Axis(axis))


# -- in real time ------------------------------------------------------------------------------------------------


def _run_live(axes: dict, folder: pathlib.Path, progress: Progress) -> None:
    """Run all axes in parallel; the run of the axis that follows setpoints ends after the last setpoint."""
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.nodes.launcher import Graph, node_environment

    plant = axes[STEPS].plant_simulator
    live = plant.time_mode == "fused"
    how = f"in real time, factor {plant.real_time_factor:g}" if live else "in lockstep"
    progress.say(f"three axes at {plant.sample_rate:g} Hz {how}: one process each, all samples recorded")
    command = _publisher_command(axes[STEPS].namespace)
    with contextlib.ExitStack() as stack, progress.during("nodes start, find each other and run"):
        publisher = subprocess.Popen(command, env=node_environment())
        stack.callback(_end, publisher)
        graphs = {name: Graph([axis], composed=True, record=folder / name) for name, axis in axes.items()}
        for graph in graphs.values():
            stack.enter_context(graph)
        begun = time.monotonic()
        while publisher.poll() is None:
            for graph in graphs.values():
                graph.poll()
            if time.monotonic() - begun > PATIENCE / plant.real_time_factor:
                raise HysteresisError(
                    f"the setpoints could not be published within {PATIENCE:g} s; check DDS (hysteresis doctor)"
                )
            time.sleep(0.02)
        if publisher.returncode != 0:
            raise HysteresisError("the setpoints could not all be published; check DDS (hysteresis doctor)")
        if live:
            time.sleep(HELD / plant.real_time_factor)
            graphs.pop(STEPS).stop()
        for graph in graphs.values():
            graph.wait()


def _end(process: subprocess.Popen) -> None:
    process.kill()
    process.wait()


def _publisher_command(namespace: str) -> list[str]:
    times, values = ([repr(item) for item in column] for column in zip(*SETPOINTS, strict=True))
    module = [sys.executable, "-m", "hysteresis_ros.nodes.setpoint_publisher"]
    return [*module, "--namespace", namespace, "--setpoint", *values, "--at", *times]


# -- as processes ------------------------------------------------------------------------------------------------


def _run_processes(axis, folder: pathlib.Path, progress: Progress) -> None:
    """Run the triangle with four processes in lockstep."""
    from hysteresis_ros.nodes.launcher import Graph

    axis = axis.with_time_mode("lockstep").with_duration(LOCKSTEP)
    with progress.during("four processes in lockstep"), Graph([axis], record=folder / PROCESSES) as graph:
        graph.wait()


def _read(folder: pathlib.Path, progress: Progress) -> tuple[dict, list[str]]:
    """Return all recordings by the names of their folders, and lines on their comparison with their offline twins."""
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.recordings.files import load_run

    with progress.during("the offline twins"):
        runs = {name: load_run(folder / name, further=True) for name in (WITHOUT, WITH, STEPS, PROCESSES)}
        for name, run in runs.items():
            if unlike := _unlike_twin(folder / name, run):
                raise HysteresisError(unlike)
    counts = ", ".join(f"{name} {run.time.size}" for name, run in runs.items())
    proof = f"all samples equal the offline twin bit for bit, none missing: {counts}"
    return runs, [proof, _same_as_live(runs[PROCESSES], runs[WITH])]


def _unlike_twin(bag: pathlib.Path, run) -> str:
    """Return the differences of a recorded run from its offline twin; empty when they are equal."""
    from hysteresis_ros.cli.recording import unlike
    from hysteresis_ros.configuration import parse_configuration
    from hysteresis_ros.loop.reach import single_axis
    from hysteresis_ros.loop.simulation import differences

    axis = single_axis(parse_configuration(run.configuration, str(bag)), run.metadata["namespace"])
    return unlike(bag, run, differences(run, axis))


def _same_as_live(processes, loop) -> str:
    """Return a line that states whether processes and loop produced the same displacement."""
    import numpy as np

    size = processes.time.size
    if loop["skipped"][:size].any():
        return "four processes and one loop: the samples differ, because the loop had to skip some"
    same = np.array_equal(processes["displacement"], loop["displacement"][:size])
    return f"four processes and one loop: {'the same' if same else 'not the same'} {size} samples"


# -- results -------------------------------------------------------------------------------------------------------


def _report(folder: pathlib.Path, axes: dict, runs: dict, proof: list[str], progress: Progress) -> None:
    """Write picture, report and figures, if their libraries are installed, and print the results."""
    import numpy as np

    from hysteresis_ros.analysis.metrics import compute_metrics
    from hysteresis_ros.analysis.plots import data_uri, png
    from hysteresis_ros.analysis.report import write_report
    from hysteresis_ros.analysis.tables import format_parts
    from hysteresis_ros.errors import MissingExtraError
    from hysteresis_ros.loop.simulation import simulate

    runs = {name: runs[name] for name in axes}
    with progress.during("the same run offline, where no deadline can be missed"):
        alone = {name: simulate(axes[name]) for name in (WITHOUT, WITH)}
    figures = compute_metrics(runs[STEPS])
    shares = {name: 100.0 * float(np.mean(run["skipped"] != 0.0)) for name, run in runs.items()}
    opened = {name: opening_of_stroke(runs[name]) for name in alone}
    left = {name: opening_of_stroke(run) for name, run in alone.items()}
    figures["demonstration"] = {
        "loop_opening_of_stroke": opened,
        "loop_opening_without_missed_deadlines": left,
        "skipped_samples": {name: int(run["skipped"].sum()) for name, run in runs.items()},
        "skipped_percent": shares,
        "rate_hz": {name: run.metadata["timing"]["rate_hz"] for name, run in runs.items()},
        "real_time_factor": axes[STEPS].plant_simulator.real_time_factor,
        "time_mode": axes[STEPS].plant_simulator.time_mode,
    }
    text = json.dumps(figures, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "metrics.json").write_text(text + "\n", encoding="utf-8")
    here, clean, share = ((of[WITHOUT], of[WITH]) for of in (opened, left, shares))
    said = message(here, clean, share, axes[STEPS].plant_simulator.time_mode == "fused")
    missing = ""
    try:
        with progress.during("picture and report"):
            picture = inverse_figure(*(alone[name] for name in alone), *(runs[name] for name in alone))
            (folder / "inverse.png").write_bytes(png(picture))
            first = [(" ".join(said), data_uri(picture))]
            write_report(runs[STEPS], folder / "report.html", "demo", figures, first)
    except MissingExtraError as error:
        missing = f"no picture and no report.html: {error}"
    lines = [*said, "setpoints on the topic:", *(f"  {line}" for line in format_parts(figures)), *proof, missing]
    click.echo("\n".join(filter(None, lines)))
    files = ", ".join(sorted(path.name for path in folder.iterdir() if path.is_file()))
    click.echo(f"bags, {files}: in {folder}")


def opening_of_stroke(run) -> float:
    """Return the loop width of displacement versus reference, as a fraction of the reference's stroke."""
    from hysteresis_ros.recordings.loops import loop_opening

    opening = loop_opening(run["reference"], run["displacement"]) or 0.0
    return opening / float(run["reference"].max() - run["reference"].min())


def message(here, alone, skipped, live: bool) -> list[str]:
    """Return the results as sentences: first from the offline runs, then from the runs on this machine."""
    without, inverse = (f"{100.0 * part:.2g} %" for part in alone)
    said = [
        f"The hysteresis loop is {without} of the stroke wide without the inverse of the hysteresis, {inverse} with it "
        f"(offline, where no deadline is missed)."
    ]
    if not live:
        return [*said, f"The runs in lockstep here: {100.0 * here[0]:.2g} % and {100.0 * here[1]:.2g} %."]
    if not any(skipped):
        return [*said, "This machine skipped no sample of either run: the results in real time at 3 kHz are the same."]
    return [
        *said,
        f"This machine skipped {skipped[0]:.2g} % and {skipped[1]:.2g} % of the samples of the two runs: "
        f"the loop is {100.0 * here[0]:.2g} % wide without the inverse, {100.0 * here[1]:.2g} % with it.",
    ]


def inverse_figure(without, with_inverse, *here):
    """Return the figure of displacement and error versus reference [µm], for all runs.

    The first branch is omitted, because it starts at rest and belongs to no loop.
    """
    import numpy as np

    from hysteresis_ros.analysis.plots import new_figure
    from hysteresis_ros.recordings.loops import turning_points

    figure, (loop, error) = new_figure(4.4, 2)
    marked = False
    runs = zip((without, with_inverse), here or (None, None), COLOURS, ("without", "with"), strict=True)
    for run, made, colour, words in runs:
        first = int(turning_points(run["reference"])[1])
        reference, displacement = run["reference"][first:] * MICRO, run["displacement"][first:] * MICRO
        label = f"{words} inverse: loop width {100.0 * opening_of_stroke(run):.2g} % of the stroke"
        loop.plot(reference, displacement, color=colour, linewidth=1.3, label=label)
        error.plot(reference, displacement - reference, color=colour, linewidth=1.3)
        missed = np.flatnonzero(made["skipped"][first:]) + first if made is not None else np.zeros(0, dtype=int)
        if made is not None and missed.size:
            x, y = made["reference"][missed] * MICRO, made["displacement"][missed] * MICRO
            style = dict(color=MISSED, marker="x", markersize=5, linewidth=0.0, zorder=4)
            loop.plot(x, y, label=None if marked else "samples skipped by this machine", **style)
            error.plot(x, y - x, **style)
            marked = True
    loop.plot(loop.get_xlim(), loop.get_xlim(), color="#9a9a9a", linestyle=(0, (4, 3)), linewidth=0.9, zorder=1)
    error.axhline(0.0, color="#9a9a9a", linestyle=(0, (4, 3)), linewidth=0.9, zorder=1)
    loop.set(xlabel="reference [µm]", ylabel="displacement [µm]")
    error.set(xlabel="reference [µm]", ylabel="displacement − reference [µm]")
    loop.legend(loc="upper left", frameon=False, fontsize=9)
    return figure
