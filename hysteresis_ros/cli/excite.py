"""``hysteresis excite``: drive an axis through its nodes with what an identification needs, and record it."""

from __future__ import annotations

import contextlib
import pathlib

import click

from hysteresis_ros.references.recipes import RECIPES


@click.command(short_help="Drive an axis with what an identification needs.")
@click.argument("config", type=click.Path(path_type=str))
@click.option(
    "--recipe",
    "name",
    required=True,
    type=click.Choice(list(RECIPES)),
    help="What to drive it with.",
)
@click.option("--record", required=True, metavar="DIR", type=click.Path(path_type=pathlib.Path), help="New bag folder.")
@click.option("--frequency", type=float, help="Of triangles and decaying, lines of the multisine, start of the chirp.")
@click.option("--amplitude", type=float, default=1.0, show_default=True, help="Part of the recipe's own amplitude.")
@click.option("--duration", type=float, help="Length of the run [s of the axis]; the recipe's own by default.")
@click.option("--rate", type=click.Choice(["realtime", "lockstep"]), help="Time mode; the configuration's by default.")
@click.option("--processes/--composed", "processes", default=True, help="Four processes (default) or one.")
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: a node of yours, which runs already, stands in plant_simulator's place.",
)
@click.option("--namespace", help="Drive only the axis in this namespace.")
def excite(config, name, record, frequency, amplitude, duration, rate, processes, plant, namespace):
    """Drive an axis of CONFIG in open loop without inverse, within the compensator's limits, and record a bag.

    The bag goes into `hysteresis identify` as it is. Recipes: triangles (growing peaks), decaying (minor loops),
    multisine and chirp (dynamics), steps, creep.
    """
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.nodes.domain import Domain
    from hysteresis_ros.nodes.launcher import Graph
    from hysteresis_ros.references.recipes import recipe
    from hysteresis_ros.simulation.axes import axes, single_axis

    if record.exists():
        raise ConfigurationError(f"{record}: exists already; choose another folder for the recording or remove it")
    configuration = load_configuration(config)
    if plant == "external":
        configuration = configuration.override("", external_plant=True)
    given = single_axis(configuration, namespace)
    if given.inchworm_sequencer is not None:
        raise ConfigurationError(
            f"{configuration.source}: an inchworm_sequencer stands in the place of the reference generator, which "
            "drives the recipes; excite the extender alone: a plant_simulator of type actuator, without sequencer"
        )
    limits, sample_rate = given.hysteresis_compensator.limits, given.plant_simulator.sample_rate
    excitation = recipe(name, limits.minimum, limits.maximum, sample_rate, frequency, amplitude, duration)
    axis = axes(_driven(configuration, given, excitation, record, rate), given.namespace)[0]
    length = duration or excitation.duration
    axis = axis.with_duration(length)
    click.echo(f"{name}: {length:.4g} s at {sample_rate:g} Hz, {limits.minimum:g} … {limits.maximum:g} V …")
    options = {"composed": not processes, "record": record, "log_level": "warn"}
    with contextlib.ExitStack() as stack:
        if plant == "own":
            # nobody steers this graph: a running axis of the user must not hear its commands
            options["environment"] = stack.enter_context(Domain()).environment
        stack.enter_context(Graph([axis], **options)).wait()
    click.echo(f"recorded: {record}")


def _driven(configuration, given, excitation, record: pathlib.Path, rate):
    """Return the configuration in open loop without inverse, with the excitation as waveform."""
    import numpy as np

    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.models.hysteresis import hysteresis_block
    from hysteresis_ros.references.recipes import in_metres

    compensator = given.hysteresis_compensator
    gain = hysteresis_block(compensator.hysteresis, 1.0 / given.plant_simulator.sample_rate).gain
    # whatever the configuration's own waveform says besides
    plain = {
        "cycles": 0,
        "phase": 0.0,
        "steps.period": 0.0,
        "multisine.first_harmonic": 1,
        "multisine.harmonic_step": 1,
    }
    values = {**plain, **in_metres(excitation, gain)}
    waveform = {f"waveform__{name.replace('.', '__')}": value for name, value in values.items()}
    if excitation.samples is not None:
        path = record.with_name(record.name + "_waveform.npz").resolve()
        time = np.arange(excitation.samples.size) / given.plant_simulator.sample_rate
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez(path, time=time, reference=excitation.samples * gain)
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
        waveform["waveform__file__path"] = str(path)
    low, high = (gain * end for end in (compensator.limits.minimum, compensator.limits.maximum))
    configuration = configuration.override("", exit_at_end=True, autostart=True)
    if rate:
        configuration = configuration.override("", time_mode=rate)
    configuration = configuration.override("motion_controller", type="open_loop")
    configuration = configuration.override("hysteresis_compensator", inverse__type="none")
    return configuration.override(
        "reference_generator",
        minimum=low,
        maximum=high,
        initial_setpoint=min(max(0.0, low), high),
        approach__maximum_velocity=0.0,
        approach__maximum_acceleration=0.0,
        approach__maximum_jerk=0.0,
        **waveform,
    )
