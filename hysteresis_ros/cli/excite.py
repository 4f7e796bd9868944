# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis excite``: drive an axis through its nodes with an identification signal, and record it."""

from __future__ import annotations

import contextlib
import pathlib

import click

from hysteresis_ros.cli.options import (
    ConfigurationName,
    Quantity,
    RunFile,
    reference_options,
    split_options,
    splitting,
)
from hysteresis_ros.cli.progress import Progress
from hysteresis_ros.references.recipes import RECIPES


@click.command(short_help="Drive an axis with an identification signal, and record it.")
@click.argument("config", type=ConfigurationName())
@click.option("--recipe", "name", type=click.Choice(list(RECIPES)), help="Excitation signal; or give --reference.")
@click.option("--record", required=True, metavar="DIR", type=click.Path(path_type=pathlib.Path), help="New bag folder.")
@click.option(
    "--offline", is_flag=True, help="Stage: run its blocks without ROS; --record is then an .npz, .csv or .mcap file."
)
@click.option(
    "--realisations", type=int, help="Stage, multisine: number of realisations.  [default: six for each axis]"
)
@click.option(
    "--periods", type=int, default=2, show_default=True, help="Stage, multisine: evaluated periods of each realisation."
)
@click.option(
    "--settle",
    type=int,
    default=1,
    show_default=True,
    help="Stage, multisine: settling periods before the evaluated ones.",
)
@click.option("--one-by-one", is_flag=True, help="Stage, multisine: excite one axis after the other.")
@click.option("--seed", type=int, default=1, show_default=True, help="Stage, multisine: seed of the phases.")
@split_options
@click.option(
    "--duration", type=Quantity("s"), help="Length of the run [s of axis time]; by default that of the recipe."
)
@click.option(
    "--rate",
    type=click.Choice(["realtime", "lockstep", "fused"]),
    help="Time mode; by default that of the configuration.",
)
@click.option(
    "--processes/--composed",
    "processes",
    default=None,
    help="Run the nodes in four processes or in one; by default in four, or fused if four are too slow.",
)
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: your own running node replaces plant_simulator.",
)
@click.option("--namespace", help="Drive only the axis in this namespace.")
@reference_options
def excite(
    config,
    name,
    record,
    offline,
    realisations,
    periods,
    settle,
    one_by_one,
    seed,
    max_bag_size,
    max_bag_duration,
    duration,
    rate,
    processes,
    plant,
    namespace,
    reference,
):
    """Drive an axis of CONFIG in open loop without inverse, within the compensator's limits, and record a bag.

    `hysteresis identify` reads the bag directly. Recipes: triangles (growing peaks), decaying (minor loops), multisine
    and chirp (dynamics), steps, creep. With a recipe, --amplitude is a factor on the recipe's own amplitude (such as
    0.5), and --frequency is the cycle frequency, the line spacing (multisine) or the initial frequency (chirp). With
    --reference, amplitudes may be in volts (60V), or in metres at the gain of the compensator's model (5um).

    A stage is excited as a whole, in one recording: multisine excites all axes together with orthogonal multisines, the
    other recipes excite one axis after the other.
    """
    from hysteresis_ros.cli.commissioning.bench import require_sound
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes, single_axis
    from hysteresis_ros.models.hysteresis import hysteresis_block
    from hysteresis_ros.nodes.domain import Domain
    from hysteresis_ros.nodes.launcher import Graph
    from hysteresis_ros.recordings.files import load_run
    from hysteresis_ros.references.recipes import driven, in_metres, played, recipe, write_samples

    if bool(name) == bool(reference.kind):
        raise click.UsageError(f"give one of --recipe ({', '.join(RECIPES)}) and --reference")
    if record.exists():
        raise ConfigurationError(f"{record}: exists already; choose another folder for the recording or remove it")
    configuration = load_configuration(config)
    if configuration.stage is not None:
        from hysteresis_ros.designs.stage_excitation import StageExcitation

        if not name or namespace or plant == "external":
            raise click.UsageError("a stage is excited as a whole: give --recipe, without --namespace and --plant")
        factors = _of_recipe(reference)
        asked = StageExcitation(
            name=name,
            amplitude=factors.get("amplitude", 1.0),
            frequency=factors.get("frequency"),
            realisations=realisations,
            periods=periods,
            settle=settle,
            one_by_one=one_by_one,
            duration=duration,
            seed=seed,
        )
        configuration = splitting(configuration, max_bag_size, max_bag_duration)
        _excite_stage(configuration, asked, record, offline, rate, processes)
        return
    if offline or realisations is not None or one_by_one:
        raise click.UsageError(
            "--offline, --realisations and --one-by-one are for a stage: omit them for a single axis"
        )
    if plant == "external":
        configuration = configuration.override("", external_plant=True)
    given = single_axis(configuration, namespace)
    given.require_generator(
        f"{configuration.source}: the recipes need a reference generator, and this file has an inchworm_sequencer "
        "instead; excite the extender alone, in a file with a plant_simulator of type actuator and no sequencer"
    )
    limits, sample_rate = given.hysteresis_compensator.limits, given.plant_simulator.sample_rate
    gain = hysteresis_block(given.hysteresis_compensator.hysteresis, 1.0 / sample_rate).gain
    if name:
        excitation = recipe(
            name, limits.minimum, limits.maximum, sample_rate, duration=duration, **_of_recipe(reference)
        )
        waveform, length = in_metres(excitation, gain), duration or excitation.duration
        if excitation.samples is not None:
            path = record.with_name(record.name + "_waveform.npz")
            waveform["file.path"] = write_samples(path, excitation.samples * gain, sample_rate)
    else:
        waveform = reference.values(gain)
        with reference.named():
            length = duration or played(waveform, 1.0 / sample_rate)
    if rate:
        configuration = configuration.override("", time_mode=rate)
    configuration = splitting(configuration, max_bag_size, max_bag_duration)
    with reference.named():
        axis = axes(driven(configuration, limits, gain, waveform), given.namespace)[0]
    axis = axis.with_duration(length)
    if rate is None and processes is None:
        axis = in_time(axis)
    range_ = f"{limits.minimum:g} … {limits.maximum:g} V"
    mode = axis.plant_simulator.time_mode
    click.echo(f"{name or reference.kind}: {length:.4g} s at {sample_rate:g} Hz, {range_}, {mode} …")
    options = {"composed": processes is False, "record": record, "log_level": "warn"}
    with contextlib.ExitStack() as stack:
        if plant == "own":
            # isolated: a running axis of the user must not receive the commands of this graph
            options["environment"] = stack.enter_context(Domain()).environment
        stack.enter_context(Progress(err=True).during(*_stages(axis, length)))
        stack.enter_context(Graph([axis], **options)).wait()
    click.echo(f"recorded: {record}")
    _say_late(require_sound(load_run(record, axis.namespace, further=True), axis.plant_simulator.samples))


def _excite_stage(configuration, asked, record, offline: bool, rate: str | None, processes: bool | None) -> None:
    """Excite a stage through its nodes or offline, and record it."""
    from hysteresis_ros.cli.commissioning.bench import require_sound
    from hysteresis_ros.designs.stage_excitation import excited_stage
    from hysteresis_ros.loop.stage_parameters import StageParameters
    from hysteresis_ros.loop.stage_simulation import simulate_stage
    from hysteresis_ros.nodes.domain import Domain
    from hysteresis_ros.nodes.launcher import Graph, require_messages
    from hysteresis_ros.recordings.files import load_run, save_run

    if offline:
        record = RunFile().convert(record, None, click.get_current_context())
    if rate:
        configuration = configuration.override("", time_mode=rate)
    chosen = offline or rate is not None or processes is not None
    if not offline:
        given = StageParameters.from_configuration(configuration)
        require_messages(given if chosen else given.in_time())
    found = excited_stage(configuration, asked, record.with_suffix("") if offline else record)
    stage = found.stage if chosen else found.stage.in_time()
    axis = stage.axes[0]
    how = "offline" if offline else axis.plant_simulator.time_mode
    click.echo(f"{found.words}: {found.duration:.4g} s at {stage.sample_rate:g} Hz, {how} …")
    if offline:
        with Progress(err=True).during("simulating; the first run of a version compiles"):
            recording = simulate_stage(stage, duration=found.duration)
        save_run(recording, record)
    else:
        options = {"composed": processes is False, "record": record, "log_level": "warn"}
        with contextlib.ExitStack() as stack:
            options["environment"] = stack.enter_context(Domain()).environment
            stack.enter_context(Progress(err=True).during(*_stages(axis, found.duration)))
            stack.enter_context(Graph(list(stage.axes), stage=stage, **options)).wait()
        for name in stage.names:
            run = require_sound(load_run(record, name, further=True), axis.plant_simulator.samples)
        _say_late(run)  # the axes of a stage are late together
    click.echo(f"recorded: {record}")


def _say_late(run) -> None:
    """Warn if voltages were late in a run."""
    from hysteresis_ros.cli.commissioning.bench import held_back

    for line in held_back(run, "counts as noise or distortion"):
        click.echo(f"hysteresis: warning: {line}", err=True)


def _stages(axis, length: float):
    """Return a description of the run, and two functions: state as text, and completed fraction in real time."""
    import time

    plant, begun = axis.plant_simulator, time.monotonic()
    needed = length / plant.real_time_factor if plant.time_mode != "lockstep" else None

    def part() -> float | None:
        # an upper bound, because the start of the nodes takes an unknown time
        passed = time.monotonic() - begun
        return None if needed is None or passed > needed else passed / needed

    def state() -> str:
        late = needed is not None and time.monotonic() - begun > needed
        return "still running: it began later, because the first start of a version compiles the loop" if late else ""

    return f"the nodes start and run {length:.4g} s", state, part


def _of_recipe(reference) -> dict:
    """Return the options of a recipe as numbers in SI."""
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.units import quantity

    reference.refuse_others(("amplitude", "frequency"))
    units = {
        "amplitude": ("", "a factor on the recipe's own amplitude, such as 0.5"),
        "frequency": ("Hz", "a frequency"),
    }
    found = {}
    for option, text in reference.given.items():
        unit, words = units[option]
        try:
            found[option], given = quantity(text)
            if given not in ("", unit):
                raise ValueError(f"must be {words}")
        except ValueError as error:
            raise ConfigurationError(f"--{option} = {text!r}: {error}") from None
    return found
