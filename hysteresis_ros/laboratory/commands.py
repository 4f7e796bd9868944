# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Commands of the laboratory: ``compare``, ``sweep``, ``benchmark``, ``reproduce``, ``faults``, ``watch`` and ``ioc``.

Each command imports the code that it runs only when it is called. ``hysteresis emulate`` has the options of the
drivers; it is in :mod:`hysteresis_ros.laboratory.emulation.command`.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import pathlib
import signal
import time

import click

from hysteresis_ros.cli.options import (
    ConfigurationName,
    Quantity,
    laid_under,
    params_file_option,
    reference_options,
    write_json,
)
from hysteresis_ros.cli.progress import Progress, shown
from hysteresis_ros.laboratory.papers import EXPERIMENTS

#: Longest time without output of a command that takes minutes [s].
SILENCE = 10.0
#: Exit code if some runs of a sweep had invalid parameters.
REFUSED = 2
#: Interval at which a request to exit is checked [s].
LOOK = 0.05


@click.command()
@click.argument("config", type=ConfigurationName())
@click.option("--mismatch", default=0.05, show_default=True, help="Largest relative error of each model parameter.")
@click.option("--noise", default=5e-9, show_default=True, help="Sensor noise [m rms].")
@click.option("--bits", default=16, show_default=True, help="Bits of the converters; 0: unlimited.")
@click.option("--draws", default=20, show_default=True, help="Number of plants close to the configured plant; 0: none.")
@click.option("--others", default=4, show_default=True, help="Number of plants of other classes; 0: none.")
@click.option("--seed", default=1, show_default=True, help="Seed of the first plant.")
@click.option("--robust", is_flag=True, help="Design sliding mode controllers for the worst plants around the model.")
@click.option("--sine", default=1.0, show_default=True, help="Frequency of the sine over 90 % of the stroke [Hz].")
@click.option("--triangle", default=10.0, show_default=True, help="Frequency of the triangle over 20 % of stroke [Hz].")
@click.option("--namespace", help="Axis to use, if the configuration describes several.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; default: number of processors.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file; '-' prints it instead of the table.")
@click.option("--best", is_flag=True, help="With -o F.yaml: write CONFIG with the best combination.")
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    type=click.Path(path_type=pathlib.Path),
    help="HTML page; with --best also a YAML file.",
)
def compare(config, *, namespace, workers, json_path, best, outputs, sine, triangle, **others):
    """Rank all controllers and compensators for the axis of CONFIG.

    Each one is designed from the models in CONFIG, and follows a sine and a triangle on random plants around the
    configured plant. For each plant of another class it is designed from a model that was identified from a recording
    of that plant. -o adds a self-contained HTML file with plots (needs the extra: pip install
    "hysteresis_ros[report]").
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.identification.parameter_file import write_file
    from hysteresis_ros.laboratory.comparison import table
    from hysteresis_ros.laboratory.comparison.compare import compare as run
    from hysteresis_ros.laboratory.comparison.tasks import Conditions

    pages, files = _pages_and_files(outputs, best)
    if pages:
        from hysteresis_ros.analysis.page import require_page

        for page in pages:
            require_page(page)  # fail before minutes of work
    conditions = Conditions(sine_frequency=sine, triangle_frequency=triangle, **others)
    progress = Progress(err=True, silence=SILENCE)
    # the bar is shown only after a while, so that an immediate refusal prints just one line
    comparing = f"comparing on {conditions.draws} plants around CONFIG and {conditions.others} of other classes"
    with progress.during(comparing):
        options = {"namespace": namespace, "workers": workers, "progress": lambda text: progress.say(f"  done: {text}")}
        found = run(load_configuration(config), conditions, **options)
    for page in pages:
        table.write_comparison_page(found, page)
    write_json(table.to_json(found), json_path, table.format_comparison(found))
    for file in files:
        write_file(file, table.best_text(found))
    if json_path != "-":
        for what, paths in (("report", pages), ("best", files)):
            for path in paths:
                click.echo(f"\n{what}: {path}")


def _pages_and_files(outputs, best: bool):
    """Return the pages and the parameter files among the outputs."""
    from hysteresis_ros.errors import ConfigurationError

    files = [path for path in outputs if path.suffix in (".yaml", ".yml")]
    if best != bool(files):
        given = "--best" if best else str(files[0])
        raise ConfigurationError(f"{given}: --best and -o FILE.yaml belong together; give both, or neither")
    return [path for path in outputs if path not in files], files


@click.command(short_help="Run an axis many times with varied parameters.")
@click.argument("config", type=ConfigurationName())
@click.option(
    "--vary",
    "varied",
    multiple=True,
    metavar="NODE.PARAMETER=RANGE",
    help="0.1:2:log20, 1um:5um:lin10, 12,14,16, ±5%, uniform(A,B), loguniform(A,B), normal(MEAN,DEVIATION); "
    "repeatable. plant_simulator=±5% varies the plant's gain, loop width (`opening`), time constants (`slowness`) and "
    "creep_rate.",
)
@click.option("--runs", type=click.IntRange(1), help="Total number of runs; by default all levels once, or 1000.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of all draws.")
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="Metric to store; by default rms_error_m, for an inchworm motor final_error_rms_m; repeatable. "
    "Errors include the time after the plant stopped the axis.",
)
@click.option(
    "--bound",
    "bounds",
    multiple=True,
    metavar="NAME=MAXIMUM",
    help="Bound of a metric, or NAME=MINIMUM:MAXIMUM; prints the fraction of axes that meet all bounds; repeatable.",
)
@click.option("--confidence", type=click.FloatRange(0.5, 0.999999), default=0.95, show_default=True)
@click.option(
    "--sensitivity", type=click.Choice(["sobol", "morris"]), help="Sensitivity of the metrics to the varied parameters."
)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    type=click.Path(path_type=pathlib.Path),
    help="File for the results, F.parquet or F.npz; also a page F.html with plots.",
)
@click.option("--json", "json_path", metavar="FILE", help="Summary as JSON; '-' prints it instead of the text.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; default: number of processors.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the sweep, tcp://host:8786.")
@click.option("--duration", type=Quantity("s"), help="Length of each run [s]; the configuration's own by default.")
@params_file_option
@reference_options
@click.option("--namespace", help="Axis to use, if the configuration describes several.")
def sweep(config, varied, *, runs, seed, metrics, bounds, confidence, sensitivity, outputs, json_path, **others):
    """Run CONFIG offline many times with varied parameters, and summarise the metrics.

    All levels are combined with each other, and each combination gets the same draws of the distributions. Only the
    named parameters change: plant_simulator.… does not change the models of compensator and controller. Finished runs
    are stored in F.part; the same command continues from there.
    """
    from hysteresis_ros.laboratory.sweeps import summary
    from hysteresis_ros.laboratory.sweeps import sweep as outcome
    from hysteresis_ros.laboratory.sweeps.plan import RANDOM, make_plan, parse_variations
    from hysteresis_ros.laboratory.sweeps.study import Study, require_metrics
    from hysteresis_ros.laboratory.sweeps.summary import parse_bound, require_library
    from hysteresis_ros.laboratory.sweeps.sweep import sweep as run
    from hysteresis_ros.loop.reach import single_axis

    path, page = _results_and_page(outputs)
    outcome.require_kind(path)
    if sensitivity:
        require_library()
    reference = others["reference"]
    configuration = reference.put_into(laid_under(config, others["laid_over"]))
    with reference.named():
        axis = single_axis(configuration, others["namespace"])
    allowed = tuple(parse_bound(bound, axis) for bound in bounds)
    names = require_metrics([*metrics, *(bound.metric for bound in allowed)], axis)
    if others["duration"] is not None:
        axis = axis.with_duration(others["duration"])
    variations = parse_variations(varied, axis)
    plan = make_plan(variations, runs, seed, sensitivity or RANDOM)
    done = [0]
    progress = Progress(err=True, silence=SILENCE)
    options = dict(
        workers=others["workers"], scheduler=others["scheduler"], progress=lambda count: done.__setitem__(0, count)
    )
    try:
        with progress.during("sweeping", lambda: f"{done[0]} of {plan.runs} runs", lambda: done[0] / plan.runs):
            found = run(Study(axis, variations, names), plan, path, **options)
    except KeyboardInterrupt:
        click.echo(f"{done[0]} of {plan.runs} runs are stored; repeat the same command to continue", err=True)
        raise
    summed = summary.Summary(found, plan, allowed, confidence)
    if page:
        from hysteresis_ros.laboratory.sweeps.page import write

        write(summed, page, str(config))
    write_json(summary.to_json(summed), json_path, "\n".join(summary.lines(summed)))
    if json_path != "-":
        click.echo(f"{path}: {len(found)} runs" + (f"; {page}" if page else ""))
    refused = summary.refusals(found)
    if refused:
        click.echo(f"hysteresis: {refused[0]}", err=True)
        raise SystemExit(REFUSED)


def _results_and_page(outputs):
    """Return the paths of the results and of the page, each None if not given."""
    from hysteresis_ros.errors import ConfigurationError

    pages = [path for path in outputs if path.suffix.lower() in (".html", ".htm")]
    files = [path for path in outputs if path not in pages]
    if len(files) != 1 or len(pages) > 1:
        raise ConfigurationError("-o: give one file for the results, F.parquet or F.npz, and at most one page, F.html")
    if pages:
        from hysteresis_ros.analysis.page import require_page

        require_page(pages[0])
    return files[0], pages[0] if pages else None


@click.command()
@click.argument("manifest", required=False, type=click.Path(path_type=pathlib.Path))
@click.option(
    "--data", type=click.Path(path_type=pathlib.Path), help="Folder of the recordings; default: that of the manifest."
)
@click.option(
    "--synthetic", type=click.IntRange(0), help="Number of synthetic plants; default: 0, or 4 if no recording is found."
)
@click.option("--noise", type=Quantity("m"), default="5nm", show_default=True, help="Noise of the synthetic sensors.")
@click.option("--model", "specs", multiple=True, metavar="NAME|FILE.py:CLASS", help="Model; repeatable.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this recording; repeatable.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share the work; default: number of processors.")
@click.option("--json", "json_path", metavar="FILE", help="JSON file; '-' prints it instead of the table.")
@click.option("--csv", "csv_path", type=click.Path(path_type=pathlib.Path), help="CSV file of the rows.")
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML page.")
@click.option("--list", "listed", is_flag=True, help="Only list recordings (source, licence) and models.")
def benchmark(manifest, *, data, synthetic, noise, specs, only, workers, json_path, csv_path, output, listed):
    """Fit models of hysteresis to recordings and test them on parts that were not used for the fit.

    MANIFEST lists the recordings, with checksums and the parts for fit and test; without it the list of public
    recordings that comes with the package is used. Nothing is downloaded: --list shows where to get the files, --data
    names their folder. Synthetic plants need no files. Your own model is a class with
    fit(data) and predict(input).
    """
    from hysteresis_ros.errors import HysteresisError, RecordingError
    from hysteresis_ros.files import write_text
    from hysteresis_ros.laboratory.benchmark import judging, models, table
    from hysteresis_ros.laboratory.benchmark.manifest import (
        load_manifest,
        missing_files,
        read_task,
        shipped_manifest,
    )
    from hysteresis_ros.laboratory.benchmark.synthetic import synthetic_task

    path = manifest or shipped_manifest()
    entries = load_manifest(path)
    if listed:
        click.echo("\n".join(_recordings_and_models(entries, models.names())))
        return
    if output:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)  # fail before minutes of work
    specs = tuple(dict.fromkeys(specs)) or models.COMPARED
    for spec in specs:
        models.load_model(spec)
    folder = data or path.parent
    if data and not data.is_dir():
        raise HysteresisError(f"--data {data}: the folder does not exist; give the folder of the recordings")
    missing = {entry.name: missing_files(entry, folder) for entry in entries}
    left_out = [
        f"{entry.name}: {', '.join(missing[entry.name])} not found in {folder}; get it from {entry.source}"
        for entry in entries
        if missing[entry.name]
    ]
    if manifest and left_out and not only:
        raise RecordingError(f"{left_out[0]}; give the folder with --data, or choose recordings with --only")
    found = [entry for entry in entries if not missing[entry.name]]
    count = synthetic if synthetic is not None else 0 if found else 4
    seeds = range(1, count + 1)
    _require_known(only, [entry.name for entry in entries] + [f"synthetic_{seed}" for seed in seeds])
    tasks = [read_task(entry, folder) for entry in entries if entry.name in only or (not only and entry in found)]
    tasks += [synthetic_task(seed, noise) for seed in seeds if not only or f"synthetic_{seed}" in only]
    if not tasks:
        raise HysteresisError("no recording to evaluate: give --data, --synthetic 4, or a manifest")
    progress = Progress(err=True, silence=SILENCE)
    with progress.during(f"{len(specs)} models on {len(tasks)} recordings"):
        rows = judging.run(tasks, specs, workers, lambda row: progress.say(f"  done: {row.model} on {row.recording}"))
    judging.require_rows(rows)
    write_json(table.to_json(tasks, rows, left_out), json_path, table.format_table(tasks, rows))
    if csv_path:
        write_text(csv_path, table.to_csv(rows), RecordingError)
    if output:
        table.write_benchmark_page(output, tasks, rows, left_out)
    if json_path != "-":
        for text in left_out:
            click.echo(f"left out: {text}")
        for what, place in (("rows", csv_path), ("page", output)):
            if place:
                click.echo(f"{what}: {place}")


def _require_known(only, names) -> None:
    from hysteresis_ros.errors import HysteresisError, did_you_mean

    for name in only:
        if name not in names:
            raise HysteresisError(f"--only {name}: there are {', '.join(names)}{did_you_mean(name, names)}")


def _recordings_and_models(entries, names) -> list[str]:
    """Return the recordings of a manifest, and the models."""
    lines = []
    for entry in entries:
        files = dict.fromkeys((entry.train.file, entry.test.file))
        lines += [f"{entry.name}: {entry.about}", f"  source   {entry.source}", f"  licence  {entry.licence}"]
        lines += [f"  file     {name}" for name in files]
    return [*lines, f"models: {', '.join(names)}; your own as module:Class or file.py:Class"]


@click.command()
@click.argument("experiment", type=click.Choice(list(EXPERIMENTS)))
@click.option(
    "--json", "json_path", metavar="FILE", help="JSON file for the rows; '-' prints them instead of the table."
)
@click.option("-o", "--output", type=click.Path(path_type=pathlib.Path), help="HTML file to write.")
@click.option(
    "--through",
    "way",
    type=click.Choice(["offline", "ros"]),
    default="offline",
    show_default=True,
    help="Run the axes by simulation, or by their nodes in lockstep, which is slower and gives the same rows.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 50),
    help="With --through ros: number of graphs of nodes that run in parallel; default: number of cores.",
)
def reproduce(experiment: str, json_path: str | None, output: pathlib.Path | None, way: str, jobs: int | None) -> None:
    """Repeat the experiments of a paper; print each published value, its reproduction, and whether the claim holds.

    Rows that do not hold are part of the result and listed with their reason; they do not change the exit code. -o adds
    a self-contained HTML file with plots (needs the extra: pip install "hysteresis_ros[report]").
    """
    from hysteresis_ros.laboratory.papers.claims import format_claims

    if output is not None:
        from hysteresis_ros.analysis.page import require_page

        require_page(output)  # fail before minutes of work
    module = importlib.import_module(EXPERIMENTS[experiment])
    with contextlib.ExitStack() as stack:
        if way == "offline":
            stack.enter_context(shown(f"repeating the experiments of {experiment}"))
            found = module.reproduce()
        else:
            found = _reproduce_through_nodes(module, jobs)
        if output is not None:
            from hysteresis_ros.laboratory.papers.claims import write_claims_page

            write_claims_page(output, found.page(), module.figures(found))
    rows = found.to_json()
    rows = {"experiment": rows.pop("experiment"), "through": way, **rows}
    write_json(rows, json_path, format_claims(found))
    if output is not None and json_path != "-":
        click.echo(f"\nreport: {output}")


def _reproduce_through_nodes(module, jobs: int | None):
    """Repeat the experiments with the nodes: a simulation first collects all runs, then the nodes execute them."""
    import os

    from hysteresis_ros.laboratory.papers.runs import GraphRunner, Noting, describe, through

    def show(number, known, axis):
        click.echo(f"run {number} of {known}: {describe(axis)}", err=True)

    runner, noting = GraphRunner(show), Noting()
    with through(noting):
        module.reproduce()
    runner.prepare(noting.axes, jobs or os.cpu_count() or 1)
    with through(runner):
        return module.reproduce()


@click.command(short_help="Inject faults into a simulated axis, and report the outcome.")
@click.argument("config", type=ConfigurationName(), default="picma_stage")
@click.option("--ways", default="fused,composed,processes", show_default=True, help="How the nodes run.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this fault case, or this group; repeatable.")
@click.option(
    "--rounds",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Number of runs of each case, at new random times.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the random times.")
@click.option(
    "--rate",
    type=click.FloatRange(1.0, 1e5),
    default=None,
    metavar="HZ",
    help="Sample rate; default: that of the file. The cases 'lose …' always use 10, 200 and 3000 Hz.",
)
@click.option("--list", "listed", is_flag=True, help="List the fault cases without running them.")
@click.option("-o", "output", type=click.Path(path_type=pathlib.Path), help="Markdown page for all results.")
@click.option("--json", "figures", type=click.Path(path_type=pathlib.Path), help="JSON file for the figures.")
@click.option(
    "--add", multiple=True, type=click.Path(path_type=pathlib.Path), help="Earlier figures to include in the page."
)
def faults(config, *, ways, only, rounds, seed, rate, listed, output, figures, add):
    """Start the axis of CONFIG with a simulated plant, in a separate ROS domain, and inject faults.

    The faults kill and suspend nodes, lose and forge messages, keep cores busy and fill a disk. Each case checks
    whether the voltage stayed within its limits and became safe in time, and whether the axis recovered. Exit code 0:
    all claims held; 4: some did not; 2: wrong input.
    """
    from hysteresis_ros.laboratory.campaign.mishaps import chosen, chosen_ways
    from hysteresis_ros.laboratory.campaign.results import load_results

    wanted, mishaps = chosen_ways(ways), chosen(only)
    if listed:
        for mishap in mishaps:
            click.echo(f"{mishap.name} [{', '.join(mishap.ways)}]: {mishap.done}")
        return
    for option, path in (("-o", output), ("--json", figures)):
        if path is not None and not path.absolute().parent.is_dir():
            raise click.UsageError(f"{option} {path}: the folder does not exist; choose another one")
    for path in add:
        load_results(path)
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.laboratory.campaign.judging import at_rate, prepared
    from hysteresis_ros.nodes.launcher import run_apart

    configuration = load_configuration(config)
    for way, tried in itertools.product(wanted, {mishap.rate or rate or 0.0 for mishap in mishaps}):
        prepared(at_rate(configuration, tried), way, "/faults")
    request = {"config": config, "ways": wanted, "only": [mishap.name for mishap in mishaps]}
    request |= {"rounds": rounds, "seed": seed, "rate": rate or 0.0, "add": [str(path.absolute()) for path in add]}
    files = {"output": output, "json": figures}
    request |= {name: str(path.absolute()) if path else "" for name, path in files.items()}
    raise SystemExit(run_apart("hysteresis_ros.laboratory.campaign.run", request))


@click.command(short_help="Show and tune a running axis in the browser.")
@click.argument("config", required=False, type=ConfigurationName())
@click.option("--namespace", help="Namespace of the axis; with CONFIG, show only this axis.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port of the first page; 0: any free port. Default: 8642, or any free port when it is in use.",
)
@click.option(
    "--bind", default="127.0.0.1", show_default=True, help="Address to listen on; other machines need a token."
)
@click.option("--folder", default=".", show_default=True, metavar="DIR", help="Folder for the recordings of the page.")
def watch(config, namespace, port, bind, folder):
    """Start the axes of CONFIG and serve a page for each; without CONFIG show the axis that already runs.

    If an axis exits, its page waits until the axis runs again. Exit code: 0 after Ctrl-C, 1 if a node dies, 2 for wrong
    input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration, normalised_namespace
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.laboratory.watch.server_process import PageOptions, Pages
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes
    from hysteresis_ros.loop.stage_parameters import StageParameters
    from hysteresis_ros.nodes.launcher import Graph, require_messages

    options = PageOptions(port, bind, folder)
    configuration = load_configuration(config) if config else None
    stage = None
    if configuration is None:
        found = []
    elif configuration.stage is None:
        found = [in_time(axis) for axis in axes(configuration, namespace)]
    else:
        stage = StageParameters.from_configuration(configuration).in_time()
        require_messages(stage)
        found = list(stage.axes)
    named = normalised_namespace(namespace or "")
    shown = [axis.namespace for axis in found if stage is None or named in ("", axis.namespace)]
    if stage is not None and not shown:
        raise ConfigurationError(f"--namespace {namespace}: the stage has the axes {', '.join(stage.names)}")
    spaces = shown or [named]
    pages = Pages(spaces, options)
    with contextlib.ExitStack() as stack:
        graph = stack.enter_context(Graph(found, stage=stage)) if found else None
        stack.enter_context(pages)
        if graph is not None:
            graph.wait(lambda: bool(requested) or pages.over())
        while graph is None and not requested and not pages.over():
            time.sleep(LOOK)
        raise SystemExit(pages.exit_code())


@click.command(short_help="Serve axes as EPICS motor records.")
@click.argument("config", type=ConfigurationName())
@click.option("--attach", is_flag=True, help="Only serve axes that already run.")
@click.option("--prefix", default="hysteresis:", show_default=True, help="Prefix of the records' names.")
@click.option("--namespace", help="Only the axis in this namespace.")
@click.option("--egu", default="um", show_default=True, help="Engineering unit: um, nm, mm, m …")
@click.option("--precision", default=4, show_default=True, help="Digits after the decimal point.")
@click.option(
    "--tolerance",
    type=float,
    help="Distance from the target within which a move is complete [EGU]; by default trajectory.goal_tolerance.",
)
@click.option(
    "--timeout",
    default=10.0,
    show_default=True,
    help="Time-out of a move, in addition to its duration at full speed [s].",
)
@click.option(
    "--interface",
    metavar="ADDRESSES",
    help="Addresses to listen on; by default EPICS_CAS_INTF_ADDR_LIST, else 127.0.0.1.",
)
@click.option("--port", type=click.IntRange(1024, 65535), help="Port; by default EPICS_CA_SERVER_PORT, else 5064.")
def ioc(config, *, attach, prefix, namespace, egu, precision, tolerance, timeout, interface, port):
    """Start the axes of CONFIG, which follow setpoints only, and serve each as an EPICS motor record.

    The record of an axis in the namespace `left` is hysteresis:left; the record of an axis without namespace is
    hysteresis:m1. A stage has a record for each degree of freedom, such as hysteresis:x and hysteresis:y.

    Exit code 0: after Ctrl-C; 1: a node has died; 2: wrong input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.laboratory.epics.record import RecordOptions, at_rest, motor_settings, stage_at_rest
    from hysteresis_ros.laboratory.epics.server_process import interfaces, serve
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes

    configuration = load_configuration(config)
    configuration = configuration.override("", autostart=True)
    stage = stage_at_rest(configuration)
    if stage is None:
        found = [at_rest(axis) for axis in axes(configuration, namespace)]
    elif namespace is None:
        found = list(stage.axes)
    else:
        found = [stage.axes[stage.place(namespace.strip("/"))]]
    record = RecordOptions(prefix, egu, precision, timeout, tolerance)
    motors = [motor_settings(axis, record) for axis in found]
    if attach:
        started, stage = [], None
    else:
        started = [in_time(axis) for axis in found] if stage is None else list(stage.axes)
    raise SystemExit(serve(motors, started, interfaces(interface), port, lambda: bool(requested), stage))
