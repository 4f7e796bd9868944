# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis identify``, ``validate`` and ``models``: from a recording to a parameter file, and its validation."""

from __future__ import annotations

import math
import pathlib

import click

from hysteresis_ros.cli.options import ConfigurationName, Quantity, data_options, format_figures, read, write_json
from hysteresis_ros.cli.progress import Progress, shown
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.units import figure_name

#: Exit code of a fit that did not converge; the best point is written anyway.
NOT_CONVERGED = 3
#: Exit code if the recording shows that the model is accurate enough for an inverse, but not for feedback.
UNFIT = 4
#: Figures that the table shows first.
FIRST = ("model", "linear", "rmse_m", "rmse_percent_of_stroke", "fit_percent", "inverse_rmse_v")
#: Number of progress reports of a fit after which its bar is half full.
UNKNOWN = 60.0


class FitState:
    """Progress of a fit of unknown length: each report fills part of the remaining bar."""

    def __init__(self) -> None:
        self.text = ""
        self.part: float | None = None

    def report(self, number: int, text: str) -> None:
        """Take a report of the fit."""
        self.text = text
        self.part = max(self.part or 0.0, number / (number + UNKNOWN)) if number > 0 else self.part


@click.command(short_help="Identify a model from a recording.")
@click.argument("data", type=click.Path(path_type=pathlib.Path), nargs=-1, required=True)
@click.option(
    "--model",
    default="usual",
    show_default=True,
    help="Model, see `hysteresis models`. By the error on held-out data, usual chooses from prandtl_ishlinskii, "
    "generalised_play and (after a poor fit) preisach, auto from all models.",
)
@click.option(
    "--linear", help="auto (default), none, lag,delay,creep,modes, second_order, arx …; see `hysteresis models`."
)
@click.option("-p", "--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the model; repeatable.")
@click.option("--inverse", help="Inverse of the compensator; by default the first of the model.")
@click.option("-o", "--params", "params", required=True, type=click.Path(path_type=pathlib.Path), help="File to write.")
@click.option(
    "--into",
    metavar="CONFIG",
    type=ConfigurationName(),
    help="For a response of `hysteresis frf`: the axis whose dynamics are fitted to it; the hysteresis of the axis is "
    "kept. For a stage: a configuration whose simulated plants or devices are kept; the rest is taken from the result.",
)
@click.option(
    "--order",
    type=int,
    help="Order of the dynamics that are fitted to a response, or of the structure of a stage; by default the lowest "
    "order with almost the best fit.",
)
@click.option(
    "--loops",
    type=click.Path(path_type=pathlib.Path),
    help="Stage: recording of the hysteresis, in which the actuators move through their ranges one after the other.",
)
@click.option(
    "--type",
    "kind",
    type=click.Choice(["hammerstein", "internal"]),
    help="Stage: hysteresis in front of the structure or inside it; inside by default for several levels.",
)
@click.option("--axes", help="Stage: names of the axes, such as x,y; by default those of the recording.")
@click.option("--period", type=Quantity("s"), help="Stage: period of the inputs; detected by default.")
@click.option(
    "--settle", type=int, help="Stage: periods of each realisation to discard for settling.  [default: 1 of 3]"
)
@click.option("--held-out", type=int, default=1, show_default=True, help="Stage: realisations held out for validation.")
@click.option(
    "--plays", type=int, default=8, show_default=True, help="Stage, internal: number of plays of each hysteresis."
)
@click.option(
    "--hystereses", type=int, default=2, show_default=True, help="Stage, internal: number of hystereses per actuator."
)
@click.option(
    "--steps", type=int, default=20, show_default=True, help="Stage, internal: number of steps of the last search."
)
@click.option("--controller", default="pid", show_default=True, help="Stage: controller to design, or none.")
@click.option("--damping", help="Stage: damping to design.  [default: irc, if it can be designed]")
@click.option("--noise", type=Quantity("m"), help="Stage: RMS noise of the sensors; by default as measured.")
@click.option(
    "--response",
    type=click.Path(path_type=pathlib.Path),
    help="Stage: response matrix of `hysteresis frf` (.npz); the dynamics are fitted to it instead of to the "
    "response matrix of the recording.",
)
@click.option("--report", "report_path", type=click.Path(path_type=pathlib.Path), help="HTML page to write.")
@data_options
@click.pass_context
def identify(
    ctx,
    data,
    model,
    linear,
    options,
    inverse,
    params,
    into,
    order,
    report_path,
    skip,
    offset,
    intersample,
    initial,
    json_path,
    loops,
    kind,
    axes,
    period,
    settle,
    held_out,
    plays,
    hystereses,
    steps,
    controller,
    damping,
    noise,
    response,
    **columns,
):
    """Identify a model from DATA (CSV, text, NPZ, MATLAB file or bag) and write it as a ROS 2 parameter file.

    From several inputs and outputs, or from the recording of a stage, it identifies a stage of coupled axes, with
    decoupling and controllers. Several files are further realisations or levels. An NPY file contains an array
    (samples, columns) or (realisations, samples, columns), whose columns are named 1, 2 …

    The file loads unchanged into plant, compensator and controller. Exit code 3: the fit did not converge, the best
    point was written. 4: the recording shows that the model is not accurate enough for the fastest feedback that the
    model would allow; a message states the crossover frequency that the recording allows, and designs stay below this
    frequency. 2: wrong input.
    """
    from hysteresis_ros.identification.frequency_response import holds_response

    if _is_stage(data, loops, columns):
        from hysteresis_ros.designs.stage_identification import StageRequest
        from hysteresis_ros.identification.stage_data import StageColumns

        if (linear, options, inverse) != (None, (), None) or (model != "usual" and loops is None):
            raise click.UsageError(
                "--model needs --loops for a stage; --linear, -p and --inverse are for a single axis, which is "
                "identified from one recording"
            )
        if columns["input_unit"] or columns["output_unit"]:
            raise click.UsageError("--input-unit and --output-unit are for a single axis; give units as NAME:UNIT")
        asked = StageRequest(
            type=kind,
            axes=() if axes is None else tuple(name.strip() for name in axes.split(",")),
            order=order,
            held_out=held_out,
            model="prandtl_ishlinskii" if model == "usual" else model,
            plays=plays,
            hystereses=hystereses,
            steps=steps,
            controller=controller,
            damping=damping,
            noise=noise,
            response=response,
        )
        chosen_columns = StageColumns(
            columns["input_"], columns["output_"], columns["time"], columns["sample_time"], period, settle
        )
        _stage(data, chosen_columns, asked, loops, into, params, report_path, json_path)
        return
    if response is not None:
        raise click.UsageError(
            "--response is for the recording of a stage; the response of a single axis is DATA: hysteresis identify "
            f"{response} --into CONFIG"
        )
    (data,) = data
    if into is not None or order is not None or holds_response(data):
        _dynamics(data, into, order, params, columns["namespace"], json_path)
        return
    from hysteresis_ros.identification import workflow
    from hysteresis_ros.identification.registry import parse_options

    chosen = parse_options(model, options)
    reading = read(data, **columns)
    click.echo(f"{reading.summary}\n", err=json_path == "-")
    request = dict(linear=linear, options=chosen, inverse=inverse)
    conditions = dict(skip=skip, offset=offset, intersample=intersample, initial=initial)
    progress, state = Progress(err=True), FitState()
    with progress.during(f"identifying {model}", lambda: state.text, lambda: state.part):
        found = workflow.identify(reading, model, progress=state.report, **request, **conditions)
    found.save(params)
    summary = {**found.figures, "parameter_file": str(params), "warnings": list(found.warnings)}
    if report_path is not None:
        from hysteresis_ros.analysis.identification_report import write_identification_report

        with progress.during("writing the page"):
            write_identification_report(report_path, found)
        summary["report"] = str(report_path)
    write_json(summary, json_path, _figures(summary, found))
    if not found.converged:
        click.echo(f"hysteresis: the fit did not converge; {params} contains the best point", err=True)
        ctx.exit(NOT_CONVERGED)
    if found.response is not None and not found.response.fit_for_feedback:
        click.echo(f"hysteresis: {found.response.reason}", err=True)
        ctx.exit(UNFIT)


def _is_stage(data, loops, columns) -> bool:
    """Return whether the request is for several inputs and outputs."""
    from hysteresis_ros.identification.stage_data import is_stage

    several = len(data) > 1 or loops is not None or max(len(columns["input_"]), len(columns["output_"])) > 1
    known = not columns["input_"] and is_stage(data[0])
    if loops is not None and len(data) == 1 and data[0].exists() and not known and not columns["input_"]:
        raise click.UsageError(
            f"--loops is for a stage, and {data[0]} is not the recording of a stage: for a single axis give the loops "
            "as DATA, and its dynamics afterwards (hysteresis frf, identify --into); for a stage name all columns with "
            "--input and --output"
        )
    return several or (columns["namespace"] is None and known)


def _stage(data, columns, request, loops, into, params, report_path, json_path) -> None:
    """Identify a stage, and write its parameter file and its page."""
    from dataclasses import replace

    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.designs.stage_identification import identify_stage
    from hysteresis_ros.identification.stage_data import read_stage, realisations

    state = [""]

    def report(text: str) -> None:
        state[0] = text

    with Progress(err=True).during("identifying a stage", lambda: state[0]):
        reading = read_stage(data, columns)
        found = identify_stage(
            reading,
            realisations(reading, columns),
            replace(request, progress=report),
            None if loops is None else read_stage(loops, columns),
            None if into is None else load_configuration(into),
        )
    found.save(params)
    summary = {**found.figures, "parameter_file": str(params), "warnings": list(found.warnings)}
    lines = [*found.lines(), f"{params}: written"]
    if report_path is not None:
        with Progress(err=True).during("writing the page"):
            _stage_page(report_path, reading.source, found)
        summary["report"] = str(report_path)
        lines.append(f"{report_path}: written")
    write_json(summary, json_path, "\n".join(lines))


def _stage_page(path, source: str, found) -> None:
    """Write the page of an identified stage."""
    from hysteresis_ros.analysis.identification_report import ClosedLoops, write_stage_identification_report
    from hysteresis_ros.designs.coupled import GRID, stage_rows
    from hysteresis_ros.loop.stage_response import stage_response

    parameters = found.parameters
    closed = None
    if found.designs:
        closed = ClosedLoops(GRID * parameters.sample_rate, stage_response(parameters, 2.0 * math.pi * GRID))
    write_stage_identification_report(path, source, parameters.names, found, stage_rows(parameters), closed)


def _dynamics(data, into, order, params, namespace, json_path) -> None:
    """Fit dynamics to a frequency response, and write the axis with them."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.designs.measured import with_measured_dynamics
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.frequency_response import load_response
    from hysteresis_ros.identification.parameter_file import write_file

    measured = load_response(data)
    if into is None:
        raise ConfigurationError(
            f"{data}: a frequency response determines only the dynamics; give --into CONFIG, the axis with the "
            "hysteresis"
        )
    with Progress(err=True).during("fitting dynamics to the response"):
        found = with_measured_dynamics(load_configuration(into), namespace, measured, pathlib.Path(data).name, order)
    write_file(params, found.text)
    summary = {**found.figures, "parameter_file": str(params), "warnings": list(found.warnings)}
    write_json(summary, json_path, format_figures(summary))


@click.command(short_help="Validate a parameter file on a recording.")
@click.argument("params", type=ConfigurationName())
@click.argument("data", type=click.Path(path_type=pathlib.Path))
@click.option("--report", "report_path", type=click.Path(path_type=pathlib.Path), help="HTML page to write.")
@click.option("--no-inverse", is_flag=True, help="Do not validate the inverse.")
@data_options
def validate(params, data, report_path, no_inverse, skip, offset, intersample, initial, json_path, **columns):
    """Simulate the plant of PARAMS with the voltage of DATA and compare with the measurement.

    Prints the errors of the model (m, % of stroke, fit %) and the inverse (V, m), and whether the residual is white.
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.identification import workflow
    from hysteresis_ros.identification.stage_data import is_stage

    load_configuration(params).require_independent()
    namespace = columns["namespace"] or ""
    if not namespace and is_stage(data):
        raise ConfigurationError(
            f"{data}: is the recording of a stage, but validate evaluates a single axis: give --namespace AXIS for a "
            "file of one axis; hysteresis identify evaluates a stage on the realisations that --held-out reserves"
        )
    reading = read(data, whole=True, **columns)
    conditions = dict(skip=skip, offset=offset, intersample=intersample, initial=initial)
    with shown("simulating the measured run"):
        found = workflow.validate(params, reading, namespace=namespace, inverse=not no_inverse, **conditions)
    click.echo(f"{reading.summary}\n", err=json_path == "-")
    summary = {**found.figures, "warnings": list(found.warnings)}
    if report_path is not None:
        from hysteresis_ros.analysis.identification_report import write_validation_report

        write_validation_report(report_path, found)
        summary["report"] = str(report_path)
    write_json(summary, json_path, _figures(summary, found))


def _figures(summary: dict, found) -> str:
    """Return the figures of a comparison as lines, in the units of its recording."""
    units = found.plant.units
    return format_figures(summary, tuple(figure_name(name, units) for name in FIRST), units)


@click.command(short_help="List the models with parameters, units and inverses.")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--yaml", "as_yaml", is_flag=True, help="Print the parameter file of an axis with an example of NAME.")
def models(name, as_json, as_yaml):
    """Print all models, or the details of the model NAME."""
    from hysteresis_ros.identification.registry import find_model
    from hysteresis_ros.models.hysteresis import MODELS

    chosen = {name: find_model(name)} if name else MODELS
    if as_yaml:
        from hysteresis_ros.identification.parameter_file import example_text

        if not name:
            raise ConfigurationError(f"--yaml: the name of the model is missing; there are: {', '.join(MODELS)}")
        click.echo(example_text(chosen[name]), nl=False)
        return
    if as_json:
        import json

        click.echo(json.dumps({key: _entry(model) for key, model in chosen.items()}, indent=2, ensure_ascii=False))
        return
    click.echo("\n".join(line for key, model in chosen.items() for line in _lines(key, model, bool(name))))


def _entry(model) -> dict:
    from hysteresis_ros.identification.registry import linear_words

    return {
        "title": model.title,
        "data": model.data,
        "inverses": list(model.inverses),
        "linear": ["auto", "none", *linear_words(model)],
        "parameters": [
            {"name": row.name, "unit": row.unit, "type": row.type_name, "description": row.description}
            for row in model.rows()
        ],
        "options": {key: option.description for key, option in model.options.items()},
    }


def _lines(name, model, whole):
    from hysteresis_ros.identification.dynamics import STAGES
    from hysteresis_ros.identification.registry import linear_words

    linear = linear_words(model)
    yield f"{name}: {model.title}"
    yield f"  data      {model.data}"
    yield f"  inverse   {', '.join(model.inverses)}"
    if linear:
        yield f"  linear    {', '.join(('auto', 'none', *linear))}"
    yield "  parameters"
    for row in model.rows():
        unit = f" [{row.unit}]" if row.unit else ""
        yield f"    {row.name}{unit}: {row.description}"
    if model.options:
        yield "  options (-p NAME=VALUE)"
        for key, option in model.options.items():
            choices = f" ({', '.join(option.choices)})" if option.choices else ""
            yield f"    {key}: {option.description}{choices}"
    if whole and model.stages:
        yield "  linear stages"
        for key, text in STAGES.items():
            yield f"    {key}: {text}"
    yield ""
