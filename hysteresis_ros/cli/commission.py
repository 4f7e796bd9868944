# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis new|commission``: take an unknown axis to a verified closed loop."""

from __future__ import annotations

import pathlib
import sys
from dataclasses import replace

import click

from hysteresis_ros.cli.progress import Progress

#: Questions that the terminal asks for missing options: option, question and example.
QUESTIONS = {
    "stroke": ("--stroke", "How far does the actuator move over its voltage range?", "100um"),
    "voltage": ("--voltage", "Which range of voltage may be applied?", "0:100V"),
    "rate": ("--rate", "How many samples per second?", "1kHz"),
}


@click.command(short_help="Write a safe parameter file for a new axis.")
@click.argument("file", type=click.Path(path_type=pathlib.Path))
@click.option(
    "--axes", metavar="NAMES", help="Names of the coupled axes of a stage, such as x,y; by default a single axis."
)
@click.option(
    "--stroke",
    "--range",
    metavar="LENGTH",
    help="Displacement over the voltage range, such as 100um; for several axes also one for each, such as 100um,80um.",
)
@click.option(
    "--voltage",
    metavar="MIN:MAX",
    help="Range of voltage, such as 0:100V or -30..120V; for several axes also one for each, separated by commas.",
)
@click.option("--rate", metavar="FREQUENCY", help="Sample rate, such as 2kHz.")
@click.option("--driver", metavar="NAME|PATH", default="", help="Driver of the device; by default the simulated plant.")
@click.option(
    "--driver-option",
    "options",
    metavar="NAME=VALUE",
    multiple=True,
    help="Option of the driver; repeatable. {axis} in it is the name of the axis of a stage.",
)
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: your own node publishes joint_states instead of plant_simulator.",
)
@click.option("--joint", help="Name of the joint in joint_states.  [stage; for several axes their names]")
def new(file, axes, driver, options, plant, joint, **given):
    """Write FILE, a commented and safe parameter file: open loop, no inverse, small limits, slow motion.

    With --axes the file describes a stage of coupled axes: `hysteresis new stage.yaml --axes x,y --stroke 100um
    --voltage 0:100V --rate 5kHz`. Missing values are asked for on a terminal. The next step is `hysteresis commission
    FILE`.
    """
    from hysteresis_ros.cli.commissioning.new_file import NewAxis, parsed, parsed_range, write_new
    from hysteresis_ros.errors import ConfigurationError

    if file.exists():
        raise ConfigurationError(f"{file}: exists already; choose another name or remove it")
    for name, (option, words, example) in QUESTIONS.items():
        if given[name] is None and sys.stdin.isatty() and sys.stdout.isatty():
            given[name] = click.prompt(words, default=example)
        elif given[name] is None:
            raise ConfigurationError(f"{option} is missing: {words} Give it, such as {option} {example}")
    names = [""] if axes is None else [name.strip() for name in axes.split(",")]
    if axes is not None and (joint is not None or plant == "external"):
        raise ConfigurationError(
            "--axes: the joints of a stage have the names of its axes, and a stage has no external plant: omit --joint "
            "and --plant"
        )
    strokes, ranges = (_for_each(names, option, given[option]) for option in ("stroke", "voltage"))
    made = {}
    for name, stroke, voltage in zip(names, strokes, ranges, strict=True):
        if name in made:
            raise ConfigurationError(f"--axes {axes}: '{name}' occurs more than once: give each axis its own name")
        low, high = parsed_range("--voltage", voltage, "V")
        made[name] = NewAxis(
            stroke=parsed("--stroke", stroke, "m"),
            minimum=low,
            maximum=high,
            sample_rate=parsed("--rate", given["rate"], "Hz"),
            driver=driver,
            driver_options=tuple(option.replace("{axis}", name) if name else option for option in options),
            external=plant == "external",
            joint=joint or "stage",
        )
    write_new(file, made[""] if axes is None else made)
    click.echo(f"{file}: written; next: hysteresis commission {file}")


def _for_each(names: list[str], option: str, text: str) -> list[str]:
    """Return the text of an option for each axis; the user gives one text for all axes, or comma-separated texts."""
    from hysteresis_ros.errors import ConfigurationError

    texts = text.split(",") if len(names) > 1 else [text]
    if len(texts) not in (1, len(names)):
        raise ConfigurationError(
            f"--{option} {text}: has {len(texts)} values for the {len(names)} axes {', '.join(names)}; give one, "
            "or as many as there are axes"
        )
    return texts * len(names) if len(texts) == 1 else texts


#: Exit code when the scan error is much larger than predicted; the files are written anyway.
UNPREDICTED = 4
#: Maximum interval between two progress messages [s]; short, because a stage takes only some seconds.
SILENCE = 5.0


@click.command(short_help="Take a new axis, or a stage of coupled axes, to a verified closed loop.")
@click.argument("file", type=click.Path(path_type=pathlib.Path))
@click.option(
    "--stage", "stages", metavar="NAME", multiple=True, help="Run only this stage, even if it is finished; repeatable."
)
@click.option("--resume", is_flag=True, help="Continue an earlier commissioning; finished stages are not repeated.")
@click.option("--yes", is_flag=True, help="Move the axis without asking for confirmation.")
@click.option("--directory", metavar="DIR", type=click.Path(path_type=pathlib.Path), help="Folder for all results.")
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    help="external: your own running node replaces plant_simulator; by default as in the file.",
)
@click.option("--offline", is_flag=True, help="Rehearse on the simulated plant of the file, as fast as possible.")
@click.option(
    "--model",
    default="auto",
    show_default=True,
    help="Model to identify; auto: chosen by cross-validation on held-out blocks.",
)
@click.option(
    "--against", metavar="NAME", multiple=True, help="Another model that the controller must tolerate, or `none`."
)
@click.option(
    "--controller",
    default="auto",
    show_default=True,
    help="Controller to design; auto: the one with the smallest error of the scan.",
)
@click.option("--scan-stroke", metavar="LENGTH", help="Peak-to-peak displacement of the scan, such as 70um.")
@click.option("--scan-frequency", metavar="FREQUENCY", help="Frequency of the triangle, such as 5Hz.")
@click.option("--namespace", default="", help="Axis to use, if the file describes several.")
@click.pass_context
def commission(ctx, file, stages, resume, yes, directory, plant, offline, **choices):
    """Measure, model and control the axis, or the coupled axes, of FILE.

    The stages are noise, gain, resonance, hysteresis, creep, identify, design, loop, response, scan and learn; for
    coupled axes they are noise, gain, resonance, multisine, hysteresis, identify, design, loop, scan and judge. Before
    each movement it prints what will move and how far, and asks for confirmation. When a result is implausible it stops
    with safe outputs (exit code 2). It writes commissioned.yaml, all recordings and report.html to DIR, by default
    FILE_commissioning. Exit code 4: the error of the scan is much larger than predicted.
    """
    from hysteresis_ros.analysis.commissioning_report import write_commissioning_report
    from hysteresis_ros.cli.commissioning.coupled_stages import COUPLED_STAGES
    from hysteresis_ros.cli.commissioning.situation import COMMISSIONED
    from hysteresis_ros.cli.commissioning.stages import STAGES, require_stages
    from hysteresis_ros.cli.commissioning.stages import commission as do
    from hysteresis_ros.configuration import load_configuration

    configuration = load_configuration(file)
    coupled = configuration.stage is not None
    procedure = COUPLED_STAGES if coupled else STAGES
    require_stages(stages, procedure)
    directory = directory or file.with_name(f"{file.stem}_commissioning")
    progress = Progress(silence=SILENCE)
    busy = {"text": ""}
    make = _coupled_situation if coupled else _situation
    situation, bench = make(
        configuration, directory, resume or bool(stages) and directory.exists(), plant, offline, choices
    )
    situation.progress = lambda number, text: busy.update(text=text)
    attendant = Terminal(yes, progress)
    try:
        with progress.during("still running", lambda: busy["text"]):
            whole = do(situation, bench, attendant, stages, procedure)
    finally:
        if situation.found:
            page = directory / "report.html"
            titles = {name: procedure[name].title for name in situation.found}
            write_commissioning_report(page, file.name, situation.found, titles)
            click.echo(f"report: {page}")
    if whole:
        seconds = sum(outcome.seconds for outcome in situation.found.values())
        click.echo(f"total time of motion: {seconds:.3g} s")
        click.echo(f"written: {directory / COMMISSIONED}; run it: hysteresis up {directory / COMMISSIONED}")
        judged = ("scan", "judge") if coupled else ("scan",)
        if not all(situation.found[name].figures["as_predicted"] for name in judged):
            ctx.exit(UNPREDICTED)


def _given(choices, plan):
    """Return the plan, changed by the scan options of the command line."""
    from hysteresis_ros.cli.commissioning.new_file import parsed

    asked = {"scan_stroke": (choices["scan_stroke"], "m"), "scan_frequency": (choices["scan_frequency"], "Hz")}
    given = {
        name: parsed(f"--{name.replace('_', '-')}", text, unit)
        for name, (text, unit) in asked.items()
        if text is not None
    }
    return replace(plan, **given).validated("/commissioning: ")


def _situation(configuration, directory, resumed, plant, offline, choices):
    """Return the data that all stages share, and the bench."""
    from hysteresis_ros.cli.commissioning.bench import GraphBench, OfflineBench
    from hysteresis_ros.cli.commissioning.situation import Folder, Situation, plan_of
    from hysteresis_ros.loop.parameters import in_time, require_carried
    from hysteresis_ros.loop.reach import single_axis

    if plant is not None:
        configuration = configuration.override("", external_plant=plant == "external")
    axis = single_axis(configuration, choices["namespace"] or None)
    if not offline:
        require_carried(in_time(axis))
    plan = _given(choices, plan_of(configuration, axis))
    bench = OfflineBench() if offline else GraphBench(axis.plant_simulator.external_plant)
    against = tuple(name for name in choices["against"] if name != "none") if choices["against"] else None
    folder = Folder(directory, configuration.original, bench.name, resumed)
    return Situation(configuration, axis, plan, folder, choices["model"], choices["controller"], against), bench


def _coupled_situation(configuration, directory, resumed, plant, offline, choices):
    """Return the data that all stages of coupled axes share, and the bench."""
    from hysteresis_ros.cli.commissioning.bench import GraphBench, OfflineBench
    from hysteresis_ros.cli.commissioning.coupled import StageSituation, plans_of
    from hysteresis_ros.cli.commissioning.situation import Folder
    from hysteresis_ros.errors import ConfigurationError
    from hysteresis_ros.loop.stage_parameters import StageParameters

    source = configuration.source
    if choices["namespace"] or choices["against"]:
        raise ConfigurationError(
            f"--namespace and --against are for a single axis, and {source} describes a stage, whose axes are "
            "commissioned together: leave them out"
        )
    if plant == "external":
        raise ConfigurationError(
            f"--plant external: {source} describes a stage of coupled axes, which supports no external plants; give "
            "each axis a driver, or leave the option out to commission the simulated stage of the file"
        )
    parameters = StageParameters.from_configuration(configuration)
    plans = {name: _given(choices, plan) for name, plan in plans_of(configuration, parameters).items()}
    bench = OfflineBench() if offline else GraphBench(external=False)
    folder = Folder(directory, configuration.original, bench.name, resumed)
    model = "prandtl_ishlinskii" if choices["model"] == "auto" else choices["model"]
    controller = "pid" if choices["controller"] == "auto" else choices["controller"]
    return StageSituation(configuration, parameters, plans, folder, model, controller), bench


class Terminal:
    """Asks the user at the terminal for permission; without a terminal nothing moves unless --yes is given."""

    def __init__(self, yes: bool, progress: Progress):
        self._yes, self._progress = yes, progress

    def may_move(self, stage: str, words: str) -> bool:
        """Print what will move, and ask for permission to move."""
        from hysteresis_ros.errors import ConfigurationError

        self._progress.say(f"{stage}: {words}")
        if self._yes:
            return True
        if not sys.stdin.isatty():
            raise ConfigurationError(f"{stage}: no terminal to ask for permission to move; give --yes")
        with self._progress.paused():
            return click.confirm("  may it move?", default=False)

    def told(self, stage: str, outcome, done_before: bool) -> None:
        """Print the outcome of a stage."""
        if done_before:
            self._progress.say(f"{stage}: already done")
            return
        for text in outcome.lines:
            self._progress.say(f"  {text}")
