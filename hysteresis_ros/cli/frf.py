# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis frf``: measure the frequency response of an axis, or estimate it from a recording."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import ConfigurationName, RunFile, write_json
from hysteresis_ros.cli.progress import Progress

#: Suffixes of recordings; a folder is a bag.
RECORDINGS = (".npz", ".csv", ".mcap", ".db3")
#: Options with units, which are also arguments of the experiment: option → unit.
WITH_UNITS = {"low": "Hz", "high": "Hz", "period": "s", "duration": "s"}


@click.command(short_help="Measure the frequency response of an axis.")
@click.argument("source", metavar="CONFIG|RECORDING", type=ConfigurationName())
@click.option(
    "--loop", type=click.Choice(["open", "closed"]), help="Loop to measure; by default open for a configuration."
)
@click.option(
    "--at",
    type=click.Choice(["voltage", "command", "reference"]),
    help="Excited signal: voltage or command in open loop, reference or command in closed loop.",
)
@click.option(
    "--excitation",
    "kind",
    type=click.Choice(["multisine", "stepped", "noise"]),
    help="Odd random-phase multisine (default), stepped sine, or noise; for a recording detected by default.",
)
@click.option(
    "--amplitude", metavar="TEXT", help="Peak, e.g. 2V or 500nm; without unit a fraction of the range.  [0.05]"
)
@click.option(
    "--offset", metavar="TEXT", help="Operating point, e.g. 40V or 30um; without unit a fraction of the range.  [0.5]"
)
@click.option("--low", metavar="FREQUENCY", help="Lowest frequency, e.g. 2Hz.")
@click.option("--high", metavar="FREQUENCY", help="Highest frequency; 0.48 of the sample rate by default.")
@click.option(
    "--period",
    metavar="TIME",
    help="Period of a multisine; length of the blocks of a stepped sine, or of the segments of noise.",
)
@click.option("--duration", metavar="TIME", help="Length of the whole excitation, instead of --period.")
@click.option("--periods", type=int, help="Number of averaged periods (blocks).  [4; stage: 2]")
@click.option(
    "--settle", type=int, help="Number of discarded periods before the averaged periods.  [1; detected in a recording]"
)
@click.option(
    "--realisations",
    type=int,
    help="Realisations of the random phases of a multisine.  [4; stage: six for each axis]",
)
@click.option("--points", type=int, help="Number of frequencies of a stepped sine.  [40]")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of phases, omitted lines and noise.")
@click.option("--offline", is_flag=True, help="Use the simulated plant of the file, without ROS.")
@click.option("--rate", type=click.Choice(["realtime", "lockstep", "fused"]), help="Time mode of the nodes.")
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: your own running node replaces plant_simulator.",
)
@click.option("--namespace", help="Axis to use, if there are several.")
@click.option("--record", type=RunFile(), help="File for the recording of the run: .npz, .csv or .mcap.")
@click.option(
    "-o", "--output", "outputs", multiple=True, type=click.Path(path_type=pathlib.Path),
    help="File for the response: .npz (for design and identify), .csv or .yaml; repeatable.",
)  # fmt: skip
@click.option("--plot", type=click.Path(path_type=pathlib.Path), help="Picture to write: .png.")
@click.option("--report", type=click.Path(path_type=pathlib.Path), help="Page to write: .html.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead.")
def frf(source, outputs, plot, report, json_path, namespace, **options):
    """Measure the frequency response of an axis of CONFIG at an operating point, or estimate it from RECORDING.

    Open loop: from voltage (or command, through the inverse) to displacement. Closed loop: sensitivity, complementary
    sensitivity and loop transfer function, with the measured margins and those of the model. Bands contain the true
    response with 95 % probability; a multisine separates noise, odd and even distortion. Exit code 2: wrong input, or
    an excitation below the noise.

    For a stage, or its recording, it determines the response matrix from all actuator voltages to all displacements
    (open loop, orthogonal multisines), and the condition number of the excitations. With --namespace it evaluates one
    axis of a recording in which only this axis moves.
    """
    from hysteresis_ros.analysis.page import require_page
    from hysteresis_ros.analysis.response_plots import require_picture
    from hysteresis_ros.identification.frequency_response import require_response_file

    # checked before anything moves
    for names, required in ((outputs, require_response_file), ([plot], require_picture), ([report], require_page)):
        for name in filter(None, names):
            required(name)
    path = pathlib.Path(source)
    if path.is_dir() or path.suffix.lower() in RECORDINGS:
        found = _of_recording(path, namespace, options)
    else:
        found = _of_configuration(source, namespace, options)
    _write(found, f"Frequency response of {path.name}", outputs, plot, report)
    write_json(found.figures, json_path, "\n".join(found.lines()))
    for written in (*outputs, plot, report) if json_path != "-" else ():
        if written is not None:
            click.echo(f"written: {written}")


def _write(found, title: str, outputs, plot, report) -> None:
    """Write the files, the picture and the page of the response of an axis or of a stage."""
    from hysteresis_ros.designs.stage_frequency_response import StageResponse, save_stage_response
    from hysteresis_ros.identification.frequency_response import save_response

    for output in outputs:
        if isinstance(found, StageResponse):
            save_stage_response(output, found)
        else:
            save_response(output, found.plant, found.columns, found.figures)
    if plot is None and report is None:
        return
    from hysteresis_ros.analysis.response_plots import (
        write_matrix_picture,
        write_matrix_report,
        write_response_picture,
        write_response_report,
    )

    of_stage = isinstance(found, StageResponse)
    with Progress(err=True).during("drawing"):
        if plot is not None:
            (write_matrix_picture if of_stage else write_response_picture)(plot, found)
        if report is not None:
            (write_matrix_report if of_stage else write_response_report)(report, title, found)


def _with_units(options: dict) -> dict:
    """Return the options with units, in SI."""
    from hysteresis_ros.cli.commissioning.new_file import parsed

    given = {name: options[name] for name in WITH_UNITS if options[name] is not None}
    return {name: parsed(f"--{name}", text, WITH_UNITS[name]) for name, text in given.items()}


def _of_recording(path: pathlib.Path, namespace, options: dict):
    """Return the response of a recording."""
    from hysteresis_ros.cli.commissioning.bench import require_sound
    from hysteresis_ros.designs.frequency_response import plan_file, read_plan, recorded_response
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.recordings.files import load_run

    for name in ("amplitude", "offset", "low", "high", "duration", "points", "record", "rate"):
        if options[name] is not None:
            raise ConfigurationError(
                f"--{name}: {path} is a recording, whose excitation cannot be changed; omit the option"
            )
    plan = read_plan(plan_file(path)) if plan_file(path).exists() else None
    with Progress(err=True).during(f"reading {path.name}"):
        period = _with_units(options).get("period")
        if _of_stage_whole(path, namespace):
            return _of_stage_recording(path, plan, period, options)
        run = load_run(path, namespace, further=True)
        # a table from another program may have no other columns than the required ones
        run = require_sound(run, len(run)) if run.has("voltage") and run.has("reference") else run
        return recorded_response(run, plan, options["loop"], options["at"], period, options["kind"])


def _of_stage_whole(path: pathlib.Path, namespace) -> bool:
    """Return whether the response matrix of a stage is requested; refuse a single axis if others are excited too."""
    import numpy as np

    from hysteresis_ros.errors import ConfigurationError, RecordingError
    from hysteresis_ros.identification.stage_data import INPUT, STILL, is_stage
    from hysteresis_ros.recordings.files import load_run

    try:
        if not is_stage(path):
            return False
    except RecordingError:
        return False  # a bag of independent axes
    whole = load_run(path)
    if not whole.axes:
        return False  # a table from another program
    if not namespace:
        return True
    chosen = namespace.rsplit("/", 1)[-1]
    sizes = {axis: float(np.nanstd(whole[f"{axis}/{INPUT}"])) for axis in whole.axes}
    others = [axis for axis, size in sizes.items() if axis != chosen and size > STILL * sizes.get(chosen, 0.0)]
    if chosen in sizes and others:
        raise ConfigurationError(
            f"{path}: is the recording of a stage, and {', '.join(others)} moves too, so a response of {chosen} alone "
            "would be wrong: omit --namespace for the response matrix of all axes"
        )
    return False


def _of_stage_recording(path: pathlib.Path, plan, period: float | None, options: dict):
    """Return the response matrix from a recording of a stage."""
    from hysteresis_ros.designs.stage_frequency_response import recorded_stage_response
    from hysteresis_ros.identification.stage_data import read_stage

    _require_open(path, options)
    return recorded_stage_response(read_stage(path), plan, period, options["settle"])


def _require_open(source, options: dict) -> None:
    """Refuse options that the response matrix of a stage does not have."""
    from hysteresis_ros.errors import ConfigurationError

    allowed = {"loop": "open", "at": "voltage", "kind": "multisine"}
    for name in (*allowed, "offset", "low", "high", "duration", "points"):
        value = allowed.get(name)
        if options[name] not in (None, value):
            option = "excitation" if name == "kind" else name
            raise ConfigurationError(
                f"--{option} {options[name]}: {source} is of a stage, whose response matrix is measured in open loop "
                "at the voltages, about the middle of the ranges, with multisines up to half the sample rate: omit it"
            )


def _of_configuration(source, namespace, options: dict):
    """Excite an axis and return its response."""
    import contextlib
    import tempfile

    from hysteresis_ros.cli.commissioning.bench import GraphBench, OfflineBench, require_sound
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.designs.frequency_response import ResponseRequest, axis_response, plan_file, response_run
    from hysteresis_ros.identification.excitations import Experiment
    from hysteresis_ros.loop.reach import single_axis
    from hysteresis_ros.recordings.files import save_run

    configuration = load_configuration(source)
    if configuration.stage is not None:
        return _of_stage(configuration, namespace, options)
    names = ("periods", "settle", "realisations", "points", "seed")
    kind = options["kind"] or "multisine"
    given = {name: options[name] for name in names if options[name] is not None}
    experiment = Experiment(kind, **given, **_with_units(options))
    chosen = {name: options[name] for name in ("at", "amplitude", "offset")}
    asked = ResponseRequest(experiment, options["loop"] or "open", **chosen)
    external = options["plant"] == "external"
    if external:
        configuration = configuration.override("", external_plant=True)
    if options["rate"]:
        configuration = configuration.override("", time_mode=options["rate"])
    with contextlib.ExitStack() as stack:
        kept = options["record"]
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hysteresis_")))
        axis, plan = response_run(
            configuration, namespace, asked, plan_file(kept) if kept else folder / "excitation.npz"
        )
        bench = OfflineBench() if options["offline"] else GraphBench(external)
        samples, rate = axis.plant_simulator.samples, axis.plant_simulator.sample_rate
        words = f"{plan.kind} at the {plan.at}, {samples / rate:.4g} s at {rate:g} Hz"
        click.echo(f"{words} …", err=True)
        stack.enter_context(Progress(err=True).during(words))
        run = require_sound(_said_late(bench.run(axis)), samples)
        if kept:
            save_run(run, kept)
        own = single_axis(configuration, namespace)
        return axis_response(run, plan, own)


def _said_late(run):
    """Return the run of a bench; print a line if voltages were late in it."""
    from hysteresis_ros.cli.commissioning.bench import held_back

    for line in held_back(run, "counts as noise or distortion"):
        click.echo(line, err=True)
    return run


def _of_stage(configuration, namespace, options: dict):
    """Excite all axes of a stage together, and return its response matrix."""
    import tempfile

    from hysteresis_ros.cli.commissioning.bench import GraphBench, OfflineBench, require_sound, run_samples
    from hysteresis_ros.designs.frequency_response import plan_file
    from hysteresis_ros.designs.stage_frequency_response import recorded_stage_response, stage_response_run
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.stage_data import read_stage
    from hysteresis_ros.recordings.files import save_run
    from hysteresis_ros.references.recipes import write_samples

    source, kept = configuration.source, options["record"]
    if namespace or options["plant"] == "external":
        raise ConfigurationError(f"{source}: a stage is excited as a whole: omit --namespace and --plant")
    _require_open(source, options)
    if options["rate"]:
        configuration = configuration.override("", time_mode=options["rate"])
    more = {name: options[name] for name in ("periods", "settle", "realisations", "seed") if options[name] is not None}
    period = _with_units(options).get("period")
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        path = pathlib.Path(folder) / "multisine"
        found, plan = stage_response_run(configuration, options["amplitude"], period, more, path)
        bench = OfflineBench() if options["offline"] else GraphBench(False)
        words = f"{found.words}: {found.duration:.4g} s at {found.stage.sample_rate:g} Hz"
        click.echo(f"{words} …", err=True)
        with Progress(err=True).during("measuring the response matrix"):
            run = require_sound(_said_late(bench.run(found.stage)), run_samples(found.stage))
        if kept:
            save_run(run, kept)
            write_samples(plan_file(kept), found.voltages[:, 0], found.stage.sample_rate, plan=plan.text)
        return recorded_stage_response(read_stage(run), plan)
