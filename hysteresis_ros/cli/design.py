# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis design``: design a controller from the identified model in a configuration."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.options import ConfigurationName, Quantity, refuse_values, scan_options
from hysteresis_ros.cli.progress import shown
from hysteresis_ros.control.controller import DESIGNS
from hysteresis_ros.control.damping import inner_loop as damping
from hysteresis_ros.designs.learning import COUPLED
from hysteresis_ros.designs.learning_filters import KINDS


@click.command(short_help="Design a controller from the model in a configuration.")
@click.argument("config", type=ConfigurationName())
@click.option("--controller", metavar="NAME", help=f"Controller to design: {', '.join(sorted(DESIGNS))}.")
@click.option(
    "--learning",
    metavar="NAME",
    help=f"Add iterative learning to the controller of CONFIG: {', '.join(sorted(KINDS))}; of a stage also {COUPLED}.",
)
@click.option(
    "--run",
    "runs",
    multiple=True,
    type=click.Path(path_type=pathlib.Path),
    help=f"With --learning {COUPLED}: a recorded run of the scan to learn from; give all runs, in their order.",
)
@click.option(
    "--damping",
    metavar="NAME",
    help=f"Damp the resonance of the model first, and design for the damped plant: {', '.join(damping.KINDS)}, none.",
)
@click.option(
    "--period", type=Quantity("s"), help="With --learning: period of the reference.  [default: that of the waveform]"
)
@click.option(
    "--maximum",
    type=Quantity("m"),
    help="With --learning: maximum correction.  [default: 10 % of the stroke]",
)
@click.option(
    "--bandwidth",
    type=Quantity("Hz"),
    help="-3 dB bandwidth from reference to displacement; with --learning: bandwidth of the learning; for a stage with "
    "--feedforward but without --controller: frequency up to which its axes are decoupled.",
)
@click.option(
    "--q", type=float, help="Kalman filter: ratio of the input noise variance to the measurement noise variance."
)
@click.option("--noise", type=Quantity("m"), help="RMS noise of the sensor, which limits the bandwidth.")
@click.option(
    "--criterion",
    type=click.Choice(["iae", "ise", "itae"]),
    help="Tune the gains by Nelder-Mead on the waveform (pid).",
)
@click.option("--duration", type=Quantity("s"), help="Length of the run that --criterion evaluates.")
@click.option(
    "--feedforward",
    is_flag=True,
    help="Add the inverse of the dynamics as feedforward; for a stage the inverse of all axes together.",
)
@click.option(
    "--preview",
    type=int,
    help="Preview of the reference [samples], with --feedforward; 0: feedforward by velocity, for smooth references.",
)
@click.option(
    "--robust", is_flag=True, help="Design for the worst of random plants around the model, within the ranges below."
)
@click.option("--gain-range", type=float, help="Relative uncertainty of the gain.  [default: 0.05]")
@click.option(
    "--hysteresis-range", type=float, help="Relative uncertainty of the slope from residual hysteresis.  [default: 0.1]"
)
@click.option("--resonance-range", type=float, help="Relative uncertainty of resonances and lags.  [default: 0.1]")
@click.option("--delay-range", type=float, help="Additional delay beyond that of the model [samples].  [default: 1]")
@click.option("--draws", type=int, help="Number of random plants, in addition to model and corners.  [default: 20]")
@click.option("--seed", type=int, help="Seed of the random plants.  [default: 1]")
@click.option(
    "--response",
    type=click.Path(path_type=pathlib.Path),
    help="NPZ of `hysteresis frf`: design for the measured response, and compute the margins from it.",
)
@scan_options
@click.option("--namespace", default="", help="Axis to use, if the configuration describes several.")
@click.option("-o", "--output", help="Parameter file to write.")
def design(config, namespace, output, response, runs, scan, values, **options):
    """Design a controller for the model in CONFIG (motion_controller: model.dynamics; the plant's model is never used).

    Prints gains, margins and closed-loop poles, and writes CONFIG with the new controller to OUTPUT. With --learning it
    keeps the controller and designs learning for it.

    For a stage it designs the controllers of all axes, or of the axis that --namespace names, and prints how the axes
    interact. With --feedforward it adds the inverse of the coupled dynamics, to the designed or to the present
    controllers. With --learning it designs learning for the period of the stage's scan. The learning starts with
    corrections with which the coupled model follows this scan. With --learning coupled, the axes learn together from
    recorded runs (--run). --scan replaces the scan of CONFIG: `hysteresis design xy_scanner --learning inversion --scan
    raster width=20um depth=20um -o learns.yaml`; the written file contains the new scan. With --controller, the slow
    axis of a raster gets a slow controller. Without --controller, --feedforward and --learning it writes no file.
    """
    from hysteresis_ros.configuration import load_configuration, normalised_namespace
    from hysteresis_ros.designs.controller import (
        OPTIONS,
        DesignRequest,
        design_axis,
        design_file,
        design_lines,
        drawn_around,
        response_uncertainty,
    )
    from hysteresis_ros.designs.learning import asked, design_learning, learning_file, learning_lines, with_known_noise
    from hysteresis_ros.designs.measured import measured_lines, measured_uncertainty
    from hysteresis_ros.designs.setpoint_step import step_lines
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.frequency_response import load_response
    from hysteresis_ros.identification.parameter_file import write_file
    from hysteresis_ros.loop.inchworm_checks import design_warnings
    from hysteresis_ros.loop.reach import single_axis

    configuration = load_configuration(config)
    if scan is None:
        refuse_values(values)
    if configuration.stage is not None:
        if scan is not None:
            configuration = _scanning(configuration, scan, values, options)
        _design_stage(configuration, namespace, output, response, runs, options)
        return
    if scan is not None:
        raise ConfigurationError(
            f"--scan {scan} is for a stage, and {configuration.source} describes a single axis: omit it; a single axis "
            "learns the period of its waveform (--period)"
        )
    if runs or options["learning"] == COUPLED:
        raise ConfigurationError(
            f"--learning {COUPLED} and --run are for a stage, and {configuration.source} describes a single axis: give "
            f"--learning {', '.join(sorted(KINDS))}"
        )
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    axis = single_axis(configuration, namespace or None)
    measured = None if response is None else load_response(response)
    known = response_uncertainty(configuration) if measured is None else measured_uncertainty(axis, measured)
    learns = asked(options)
    if learns is not None:
        with shown("designing"):
            learned = design_learning(with_known_noise(axis, configuration), learns, known)
        write_file(output, learning_file(configuration, learned, normalised_namespace(axis.namespace)))
        for line in learning_lines(learned):
            click.echo(line)
        click.echo(f"{output}: written, learning by {learned.parameters.type}")
        return
    ranges = {name: options.pop(option.replace("-", "_")) for name, option in OPTIONS.items()}
    request = DesignRequest(**options | {"robust": drawn_around(options["robust"], ranges)})
    with shown("designing"):
        result = design_axis(axis, request, known)
    text = design_file(configuration, result, normalised_namespace(axis.namespace))
    lines = step_lines(text, axis.namespace or None, request.feedforward)
    write_file(output, text)
    for line in (*lines, *design_lines(result)):
        click.echo(line)
    if measured is not None:
        for line in measured_lines(axis, result, measured):
            click.echo(line)
    if axis.inchworm_sequencer is not None:
        for warning in design_warnings(axis.plant_simulator, result.margins.gain_crossovers):
            click.echo(f"hysteresis: warning: {warning}", err=True)
    click.echo(f"{output}: written, type {result.parameters.type}")


def _design_stage(configuration, namespace: str, output: str | None, response, runs, options: dict) -> None:
    """Design controllers or learning of a stage, and print how its axes interact."""
    from hysteresis_ros.configuration import parse_configuration
    from hysteresis_ros.control.learning import write_learned
    from hysteresis_ros.designs.controller import OPTIONS, DesignRequest, design_lines, drawn_around
    from hysteresis_ros.designs.coupled import (
        controllers_file,
        design_controllers,
        design_stage_learning,
        response_uncertainties,
        stage_learning_file,
        stage_lines,
    )
    from hysteresis_ros.designs.learning import asked, learning_lines
    from hysteresis_ros.designs.measured import measured_lines, measured_uncertainty
    from hysteresis_ros.designs.stage_feedforward import voltage_step_rows, voltage_steps, without_stage_feedforward
    from hysteresis_ros.designs.stage_frequency_response import command_responses, load_stage_response
    from hysteresis_ros.designs.stage_stability import require_stable
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.parameter_file import write_file
    from hysteresis_ros.loop.stage_parameters import StageParameters

    parameters = StageParameters.from_configuration(configuration)
    known = response_uncertainties(configuration, parameters)
    wanted = options.get("controller") or options.get("learning")
    measured = {}
    if response is not None:
        if not wanted:
            raise ConfigurationError("--response: nothing to design: give --controller NAME or --learning NAME")
        measured = command_responses(parameters, *load_stage_response(response))
        known = {
            name: measured_uncertainty(axis, measured[name])
            for name, axis in zip(parameters.names, parameters.axes, strict=True)
        }
    if options["feedforward"] and not options["learning"]:
        configuration = without_stage_feedforward(configuration)
        parameters = StageParameters.from_configuration(configuration)
    if options["feedforward"] and not wanted:
        _design_stage_feedforward(configuration, output, options)
        return
    if not wanted:
        given = [name for name, value in options.items() if value]
        if output is not None or given:
            raise ConfigurationError("nothing to design: give --controller NAME, --feedforward or --learning NAME")
        for line in stage_lines(parameters):
            click.echo(line)
        require_stable(parameters, configuration.source)
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    learns = asked(options)
    if runs and (learns is None or learns.kind != COUPLED):
        raise ConfigurationError(f"--run belongs to --learning {COUPLED}; give both")
    if learns is not None:
        require_stable(parameters, configuration.source)
        if learns.period is not None:
            raise ConfigurationError("the scan of a stage determines the period: omit --period")
        if learns.kind == COUPLED:
            _learn_together(configuration, learns, runs, output)
            return
        with shown("designing"):
            result = design_stage_learning(parameters, learns, known)
        place = pathlib.Path(output).expanduser().resolve()
        files = {name: f"{place.with_suffix('')}_{name}.yaml" for name in result.designs}
        for name, correction in result.corrections.items():
            write_learned(files[name], correction, configuration.source)
        text = stage_learning_file(configuration, result, files)
        write_file(output, text)
        for name, learned in result.designs.items():
            click.echo("\n".join([f"axis {name}", *learning_lines(learned), ""]))
        for name, why in result.left.items():
            click.echo(f"hysteresis: warning: axis {name} does not learn: {why}", err=True)
        click.echo(f"{output}: written, learning by {learns.kind}; begins with {', '.join(files.values())}")
        return
    ranges = {name: options.pop(option.replace("-", "_")) for name, option in OPTIONS.items()}
    request = DesignRequest(**options | {"robust": drawn_around(options["robust"], ranges)})
    if parameters.stage.feedforward.weights:
        raise ConfigurationError(
            f"{configuration.source}: its feedforward was designed for its present controllers: give --feedforward too"
        )
    if request.feedforward and namespace:
        raise ConfigurationError("--feedforward of a stage is designed for all axes together: omit --namespace")
    with shown("designing"):
        designs = design_controllers(parameters, request, known, namespace or None)
        text = controllers_file(configuration, designs, f"--controller {request.controller}")
        designed = StageParameters.from_configuration(parse_configuration(text, "the designed file"))
        require_stable(designed, configuration.source)
        if request.feedforward:
            text, fed = _with_feedforward(text, configuration.source, request.preview, None)
            lines = [*stage_lines(designed), *fed]
        else:
            lines = stage_lines(designed, voltage_step_rows(voltage_steps(designed)))
    write_file(output, text)
    for name, design in designs.items():
        axis = parameters.axes[parameters.place(name)]
        further = measured_lines(axis, design, measured[name]) if measured else []
        click.echo("\n".join([f"axis {name}", *design_lines(design), *further, ""]))
    click.echo("\n".join(["stage", *lines]))
    click.echo(f"{output}: written, type {request.controller}")


def _scanning(configuration, scan: str, values: tuple[str, ...], options: dict):
    """Return the configuration with the scan for which controllers or learning are designed, also in its file."""
    from hysteresis_ros.designs.coupled import with_written_scan
    from hysteresis_ros.designs.coupled_learning import FEWEST
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.loop.stage_parameters import StageParameters
    from hysteresis_ros.loop.stage_response import check_scan

    if not options["learning"] and not options["controller"]:
        raise ConfigurationError(f"--scan {scan} belongs to --controller or --learning; give one of them")
    periods = FEWEST if options["learning"] == COUPLED else 0
    configuration = with_written_scan(configuration, scan, values, periods)
    check_scan(StageParameters.from_configuration(configuration))
    return configuration


def _with_feedforward(text: str, source: str, preview: int | None, band: float | None) -> tuple[str, list[str]]:
    """Return the parameter file of a stage with a feedforward of all axes, and the lines to print."""
    from hysteresis_ros.configuration import parse_configuration
    from hysteresis_ros.designs.stage_feedforward import (
        design_stage_feedforward,
        require_gentle_steps,
        stage_feedforward_file,
        stage_feedforward_lines,
        voltage_steps,
    )
    from hysteresis_ros.designs.stage_stability import require_stable
    from hysteresis_ros.loop.stage_parameters import StageParameters

    configuration = parse_configuration(text, source)
    parameters = StageParameters.from_configuration(configuration)
    require_stable(parameters, source)
    found = design_stage_feedforward(parameters, preview, band)
    steps = voltage_steps(found.parameters)
    require_gentle_steps(steps)
    text = stage_feedforward_file(configuration, found, "--feedforward")
    return text, stage_feedforward_lines(found, steps)


def _design_stage_feedforward(configuration, output: str | None, options: dict) -> None:
    """Design the feedforward of a stage for its present controllers, and write the parameter file."""
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.parameter_file import write_file

    others = [name for name, value in options.items() if value and name not in ("feedforward", "preview", "bandwidth")]
    if others:
        raise ConfigurationError(
            f"--{others[0].replace('_', '-')} does not belong to --feedforward alone: omit it, or add --controller NAME"
        )
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    with shown("designing"):
        text, lines = _with_feedforward(
            configuration.original, configuration.source, options["preview"], options["bandwidth"]
        )
    write_file(output, text)
    click.echo("\n".join(lines))
    click.echo(f"{output}: written, feedforward of the stage")


def _learn_together(configuration, request, runs, output: str) -> None:
    """Learn corrections for all axes of a stage from recorded runs; write the corrections and a file that uses them."""
    from hysteresis_ros.control.learning import write_learned
    from hysteresis_ros.designs.coupled_learning import coupled_learning_file, learned_from, trial_lines
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.identification.parameter_file import write_file
    from hysteresis_ros.recordings.files import load_run

    place = pathlib.Path(output).expanduser().resolve()
    with shown("learning"):
        recordings = [load_run(path) for path in runs]
        learning, corrections, trials = learned_from(configuration, request, recordings)
        files = {name: f"{place.with_suffix('')}_{name}.yaml" for name in learning.parameters.names}
        # the next design needs the corrections of the earlier runs, so their files must not be replaced
        for path, recording in zip(runs, recordings, strict=True):
            if any(file in recording.metadata["configuration"] for file in files.values()):
                raise ConfigurationError(
                    f"-o {output}: would replace the corrections of the run {path}: give another name"
                )
        chosen = learning.chosen(corrections, files)
        for name, learned in learning.learned(corrections).items():
            write_learned(files[name], learned, configuration.source)
        text = coupled_learning_file(configuration, chosen, [path.name for path in runs])
    write_file(output, text)
    for line in trial_lines(learning.parameters, trials):
        click.echo(line)
    click.echo(
        f"{output}: written, learning {request.kind}, from {len(runs)} runs; corrections in {', '.join(files.values())}"
    )
