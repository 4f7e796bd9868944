# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arguments and options that several commands share: configurations, quantities, columns of data, references."""

from __future__ import annotations

import contextlib
import functools
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass

import click
from click.shell_completion import CompletionItem

from hysteresis_ros.cli.progress import Progress


class ConfigurationName(click.ParamType):
    """A parameter file: a path, or the name of a file that comes with the package."""

    name = "config"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the names that come with the package, and the files and folders that begin with the typed text."""
        from hysteresis_ros.configuration import shipped_configurations

        folder, _, begun = incomplete.rpartition("/")
        place = pathlib.Path(folder + "/" if "/" in incomplete else ".").expanduser()
        found = [] if folder else [CompletionItem(name) for name in shipped_configurations() if name.startswith(begun)]
        for path in sorted(place.iterdir()) if place.is_dir() else ():
            if not path.name.startswith(begun) or path.name.startswith(".") and not begun:
                continue
            prefix = incomplete[: len(incomplete) - len(begun)]
            if path.is_dir():
                found.append(CompletionItem(f"{prefix}{path.name}/"))
            elif path.suffix in (".yaml", ".yml"):
                found.append(CompletionItem(f"{prefix}{path.name}"))
        return found


class Quantity(click.ParamType):
    """A number with its unit, such as ``2nm``, ``100Hz``, ``0.5s``; the value is in SI. A length needs its unit."""

    def __init__(self, unit: str):
        self.unit = unit
        self.name = {"m": "length", "s": "time", "Hz": "frequency"}[unit]

    def convert(self, value, param, ctx) -> float:
        """Return the number in SI; click reports a refused text, with exit code 2."""
        from hysteresis_ros.units import quantity_in

        try:
            return quantity_in(value, self.unit) if isinstance(value, str) else float(value)
        except ValueError as error:
            self.fail(f"{value!r}: {error}", param, ctx)


class RunFile(click.ParamType):
    """A file for a run; an unknown suffix is refused before the run begins."""

    name = "file"

    def convert(self, value, param, ctx) -> pathlib.Path:
        """Return the path; click reports a refused suffix, with exit code 2."""
        from hysteresis_ros.errors import RecordingError
        from hysteresis_ros.recordings.files import require_run_file

        try:
            return require_run_file(value)
        except RecordingError as error:
            self.fail(str(error), param, ctx)


class WaveformName(click.ParamType):
    """The name of a waveform; unknown names are refused later, with the list of all waveforms."""

    name = "waveform"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the waveforms with names that begin with the typed text."""
        from hysteresis_ros.references.waveforms import WAVEFORMS

        return [CompletionItem(name) for name in WAVEFORMS if name.startswith(incomplete)]


class NodeName(click.ParamType):
    """The name of a node; completion offers the nodes of an axis."""

    name = "node"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the nodes of an axis whose names begin with the typed text."""
        from hysteresis_ros.configuration import NODE_NAMES, OPTIONAL_NODE_NAMES

        return [CompletionItem(name) for name in NODE_NAMES + OPTIONAL_NODE_NAMES if name.startswith(incomplete)]


#: Options for splitting a recording, as in ``ros2 bag record``; the arguments of the command have the same names.
_SPLITS = (
    click.option(
        "--max-bag-size", type=click.IntRange(1), metavar="BYTES", help="Start a new file of the bag at this size."
    ),
    click.option(
        "--max-bag-duration",
        type=click.FloatRange(0, min_open=True),
        metavar="SECONDS",
        help="Start a new file of the bag after this time.",
    ),
)


def split_options(command):
    """Add the options for splitting a recording to a command."""
    for option in reversed(_SPLITS):
        command = option(command)
    return command


def splitting(configuration, max_bag_size: int | None, max_bag_duration: float | None):
    """Return the configuration with the splitting options of the recorder."""
    given = {"max_bag_size": max_bag_size, "max_bag_duration": max_bag_duration}
    given = {name: value for name, value in given.items() if value is not None}
    return configuration.override("recorder", **given) if given else configuration


#: Option with overlay parameter files; the command gets their names as ``laid_over``.
params_file_option = click.option(
    "--params-file",
    "laid_over",
    multiple=True,
    metavar="FILE",
    help="Parameter file that overrides CONFIG, such as one saved by a node; repeatable.",
)


def laid_under(config: str, laid_over: tuple[str, ...]):
    """Return a configuration with overlaid parameter files."""
    from hysteresis_ros.configuration import load_configuration

    return load_configuration(config).under(*map(load_configuration, laid_over))


#: SI unit of a figure, by the suffix of its name.
ENDINGS = {"_m_per_s": "m/s", "_m": "m", "_v": "V", "_s": "s", "_hz": "Hz", "_percent": "%"}


def data_options(command):
    """Add the options for data to a command; the command gets them as keyword arguments."""
    for option in reversed(
        (
            click.option(
                "--input",
                "input_",
                multiple=True,
                metavar="NAME[:UNIT]",
                help="Input column, e.g. control_V:V; for a stage, repeat it for each actuator.",
            ),
            click.option(
                "--output",
                "output_",
                multiple=True,
                metavar="NAME[:UNIT]",
                help="Output column, e.g. cap_sensor_um:um; for a stage, repeat it for each sensor.",
            ),
            click.option("--input-unit", metavar="UNIT", help="Unit of the input, e.g. A, also in results."),
            click.option("--output-unit", metavar="UNIT", help="Unit of the output, e.g. N, also in results."),
            click.option("--time", metavar="NAME[:UNIT]", help="Time column, e.g. t_ms:ms."),
            click.option(
                "--sample-time", type=Quantity("s"), help="Sample time of data without a time column, such as 1ms."
            ),
            click.option("--namespace", help="Axis to use, if a bag contains several."),
            click.option("--range", "range_", metavar="FIRST:LAST", help="Use only these samples, e.g. 0:6000."),
            click.option("--resample", metavar="SECONDS|auto", help="Resample the data to a uniform grid first."),
            click.option("--negate", is_flag=True, help="Invert the sign of the output."),
            click.option(
                "--all-samples", is_flag=True, help="Use every sample of long data, not only the informative ones."
            ),
            click.option(
                "--skip",
                type=click.IntRange(0),
                help="Exclude the first N samples from the error; the model still simulates them.",
            ),
            click.option(
                "--offset",
                type=click.Choice(["kept", "free"]),
                default="kept",
                help="kept: use the output as recorded; free: remove a constant from it.",
            ),
            click.option(
                "--intersample",
                type=click.Choice(["zoh", "linear", "bandlimited"]),
                help="Assumed course of the input between samples.",
            ),
            click.option("--initial", type=click.Choice(["zero", "periodic", "estimate"]), help="Initial state."),
            click.option(
                "--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them instead."
            ),
        )
    ):
        command = option(command)
    return command


def read(path, *, input_, output_, range_, resample, **columns):
    """Return the checked data of a command; print progress, assumptions and changes to stderr."""
    from hysteresis_ros.identification.reading import Columns, read_data

    chosen = Columns(
        input=_one("--input", input_),
        output=_one("--output", output_),
        range=None if range_ is None else _range(range_),
        resample=None if resample is None else _seconds(resample),
        **columns,
    )
    state = [""]

    def progress(part: float) -> None:
        state[0] = f"{100 * part:.0f} %"

    with Progress(err=True).during(f"reading {path.name}", lambda: state[0]):
        reading = read_data(path, chosen, progress)
    for note in (*reading.guessed, *reading.data.notes):
        click.echo(f"note: {note}", err=True)
    return reading


def _one(option: str, given: tuple[str, ...]) -> str | None:
    """Return the given column, or None if no column is given; refuse several columns."""
    if len(given) > 1:
        raise click.UsageError(f"{option} {' '.join(given)}: this command takes one column; name one")
    return given[0] if given else None


def _range(text: str):
    from hysteresis_ros.errors import IdentificationError

    first, mark, last = text.partition(":")
    try:
        if not mark:
            raise ValueError
        return int(first or 0), int(last) if last else None
    except ValueError:
        raise IdentificationError(f"--range {text}: write FIRST:LAST, e.g. 0:6000 or 400:") from None


def _seconds(text: str):
    from hysteresis_ros.errors import IdentificationError

    if text == "auto":
        return text
    try:
        return float(text)
    except ValueError:
        raise IdentificationError(f"--resample {text}: write a sample time in seconds, or auto") from None


def write_json(figures: dict, path: str | None, table: str) -> None:
    """Print the table, or for ``-`` the figures as JSON; if a file is named, also write the figures to this file."""
    import json

    from hysteresis_ros.errors import RecordingError

    text = json.dumps(figures, indent=2, ensure_ascii=False, allow_nan=False)
    click.echo(text if path == "-" else table)
    if path not in (None, "-"):
        try:
            pathlib.Path(path).write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def format_figures(figures: dict, first: tuple[str, ...] = (), units: tuple[str, ...] = ()) -> str:
    """Return figures as lines ``name value``; the names in ``first`` come first, lists of texts last.

    If the name of a figure ends in its unit, the value is shown with a readable unit: ``rmse_m`` of 2.148e-7 is shown
    as ``rmse  0.2148 µm``. ``units`` are further units with which names may end.
    """
    from hysteresis_ros.units import ending, readable

    known = ENDINGS | {ending(unit): unit for unit in units}
    order = [*(name for name in first if name in figures), *(name for name in figures if name not in first)]
    endings = {name: next((one for one in known if name.endswith(one)), "") for name in order}
    bare = [name.removesuffix(ending) for name, ending in endings.items()]
    labels = {name: text if bare.count(text) == 1 else name for name, text in zip(order, bare, strict=True)}
    width = max(len(label) for label in labels.values())
    lines, texts = [], []
    for name in order:
        value = figures[name]
        if isinstance(value, (list, tuple)):
            texts += [f"{name.rstrip('s')}: {text}" for text in value]
        elif isinstance(value, float):
            shown = readable(value, known[endings[name]]) if endings[name] else f"{value:.6g}"
            lines.append(f"{labels[name]:<{width}}  {shown}")
        else:
            shown = {True: "yes", False: "no"}[value] if isinstance(value, bool) else ("-" if value is None else value)
            lines.append(f"{labels[name]:<{width}}  {shown}")
    return "\n".join(lines + texts)


#: Option → parameter, for the usual parameters of a waveform; ``--waveform NAME=VALUE`` sets any other parameter.
PARAMETERS = {
    "--amplitude": "amplitude",
    "--frequency": "frequency",
    "--offset": "offset",
    "--cycles": "cycles",
    "--polarity": "polarity",
    "--values": "values",
    "--times": "times",
    "--file": "path",
}
HELP = {
    "--amplitude": "Largest distance from the offset, e.g. 70um.",
    "--frequency": "Frequency, e.g. 5Hz.",
    "--offset": "Offset, e.g. 10um.",
    "--cycles": "Number of cycles, after which the reference is constant; 0: endless.",
    "--polarity": "unipolar: from the offset upwards; symmetric: to both sides.",
    "--values": "Levels of steps, e.g. 2um,0,2um.",
    "--times": "Times at which the steps begin, e.g. 0s,0.4s,0.8s.",
    "--file": "CSV, NPZ or NPY file of --reference file.",
}


@dataclass(frozen=True)
class AskedReference:
    """Options of the waveform; ``kind`` is None if the user chose no waveform."""

    kind: str | None  #: Name of the waveform.
    given: dict[str, str]  #: Text of each parameter of the waveform.

    def values(self, gain: float | None = None) -> dict:
        """Return the parameters of the waveform, see :func:`~hysteresis_ros.references.recipes.asked_waveform`.

        Units: ``gain`` [m/V].
        """
        from hysteresis_ros.references.recipes import asked_waveform

        with self.named():
            return asked_waveform(str(self.kind), self.given, gain)

    def put_into(self, configuration, namespace: str | None = None):
        """Return a configuration whose axes follow the waveform; unchanged without a waveform option.

        In a stage, only the axis in ``namespace`` follows the waveform, if a namespace is given.
        """
        from hysteresis_ros.errors import ConfigurationError
        from hysteresis_ros.references.scans import SCANS
        from hysteresis_ros.references.waveforms import WAVEFORMS

        if self.kind is None:
            self.refuse_others()
            return configuration
        if any(configuration.describes("inchworm_sequencer", space) for space in configuration.namespaces()):
            raise ConfigurationError(
                f"--reference {self.kind}: {configuration.source} describes an inchworm motor, which "
                "cannot follow a waveform; give it setpoints with `hysteresis setpoint`"
            )
        if configuration.stage is not None and self.kind in SCANS.keys() - WAVEFORMS.keys():
            raise ConfigurationError(
                f"--reference {self.kind}: is a scan of several axes, not the waveform of one; give --scan {self.kind} "
                "NAME=VALUE …, see hysteresis scan"
            )
        values = {f"waveform.{name}": value for name, value in self.values().items()}
        only = f"{namespace.strip('/')}/" if namespace and configuration.stage is not None else ""
        return configuration.override(f"{only}reference_generator", **values)

    def refuse_others(self, taken: tuple[str, ...] = ()) -> None:
        """Refuse waveform options, except ``taken``, because --reference is missing."""
        for name in self.given:
            if name not in taken:
                raise click.UsageError(f"{_option(name)} belongs to a waveform: give --reference, e.g. triangle")

    @contextlib.contextmanager
    def named(self) -> Iterator[None]:
        """Raise problems of the waveform under the names of the options, with the texts of the command line."""
        from hysteresis_ros.errors import ParameterError

        try:
            yield
        except ParameterError as error:
            if self.kind is None:
                raise
            raise ParameterError([self._by_option(problem) for problem in error.problems]) from None

    def _by_option(self, problem):
        from hysteresis_ros.errors import Problem

        name = problem.name.removeprefix("reference_generator: ")
        if not name.startswith("waveform."):
            return problem
        name = name.removeprefix("waveform.")
        if name == "type":
            return Problem("--reference", self.kind, problem.remedy)
        own = name.removeprefix(f"{self.kind}.")
        text = next((self.given[word] for word in (name, own) if word in self.given), problem.value)
        return Problem(_option(own), text, problem.remedy)


def _option(name: str) -> str:
    """Return the option that sets a parameter."""
    return next((option for option, parameter in PARAMETERS.items() if parameter == name), f"--waveform {name}")


def reference_options(command):
    """Add the options for a waveform to a command, as its argument ``reference``, an :class:`AskedReference`."""

    @functools.wraps(command)
    def with_reference(reference, further, **words):
        given = {parameter: words.pop(f"reference_{parameter}") for parameter in PARAMETERS.values()}
        given = {parameter: text for parameter, text in given.items() if text is not None}
        for word in further:
            name, mark, text = word.partition("=")
            if not mark:
                raise click.UsageError(f"--waveform {word}: write NAME=VALUE, e.g. --waveform duty=0.2")
            given[name.strip()] = text.strip()
        return command(reference=AskedReference(reference, given), **words)

    options = [
        click.option(
            "--reference",
            type=WaveformName(),
            metavar="WAVEFORM",
            help="Waveform to follow: triangle, sine, steps, file …",
        ),
        *(
            click.option(option, f"reference_{parameter}", metavar="TEXT", help=HELP[option])
            for option, parameter in PARAMETERS.items()
        ),
        click.option(
            "--waveform",
            "further",
            multiple=True,
            metavar="NAME=VALUE",
            help="Further parameter of the waveform; repeatable.",
        ),
    ]
    for option in reversed(options):
        with_reference = option(with_reference)
    return with_reference


def scan_options(command):
    """Add the option and the values of a scan to a command; the command gets them as ``scan`` and ``values``."""
    text = "Scan that a stage follows; NAME=VALUE are its parameters, see `hysteresis scan`."
    return click.argument("values", nargs=-1, metavar="[NAME=VALUE]...")(
        click.option("--scan", metavar="KIND", help=text)(command)
    )


def refuse_values(values: tuple[str, ...], remedy: str = "") -> None:
    """Refuse values of a scan if no scan was chosen; ``remedy`` helps if parameters of nodes were meant."""
    if values and "=" in values[0]:
        raise click.UsageError(f"{values[0]} belongs to a scan: choose a scan, for instance --scan raster{remedy}")
    if values:
        raise click.UsageError(f"{values[0]} is neither an option nor NAME=VALUE of a scan{remedy}")


def scanning(configuration, scan: str | None, values: tuple[str, ...], reference: AskedReference):
    """Return the configuration of a stage that follows a scan; unchanged without a scan."""
    from hysteresis_ros.loop.stage_simulation import with_scan

    if scan is None:
        refuse_values(values, "; --params-file FILE overrides values of the configuration")
        return configuration
    if reference.kind:
        raise click.UsageError("--scan and --reference exclude each other: a stage can follow only one of them")
    return with_scan(configuration, scan, values)


def trigger_option(command):
    """Add the option for triggers to a command; the command gets a list of texts ``NAME=VALUE`` as ``triggers``."""
    text = (
        "Trigger at positions or times: start=2um, step=0.5um, stop=8um, positions=2um,3um, direction=up, times=0.1s, "
        "each=line …; repeatable, see docs/triggers.md."
    )
    return click.option("--trigger", "triggers", multiple=True, metavar="NAME=VALUE", help=text)(command)


def triggering(configuration, triggers: tuple[str, ...], namespace: str | None = None):
    """Return a configuration with the triggers that the texts describe.

    In a stage, only the axis in ``namespace`` triggers, if a namespace is given; otherwise all axes do. With ``each``,
    only axes that follow the scan trigger, and the scan clock gets at least the level of ``each``.
    """
    from hysteresis_ros.references.scans import parsed_values
    from hysteresis_ros.references.triggers import TriggerParameters
    from hysteresis_ros.signals import MOTOR_SOURCE, SOURCE

    if not triggers:
        return configuration
    rows = {row.name: row for row in TriggerParameters.table()}
    values = {f"triggers.{name}": value for name, value in parsed_values(triggers, rows).items()}
    only = f"{namespace.strip('/')}/" if namespace and configuration.stage is not None else ""
    each = values.get("triggers.each", "none")
    if configuration.stage is not None and each != "none":
        return _by_scan(configuration, values, each, only)
    motor = any(configuration.describes(MOTOR_SOURCE, space) for space in configuration.namespaces())
    return configuration.override(f"{only}{MOTOR_SOURCE if motor else SOURCE}", **values)


def _by_scan(configuration, values: dict, each: str, only: str):
    """Return a stage's configuration with triggers by the scan on the scanning axes, or on the axis in ``only``."""
    from dataclasses import replace

    from hysteresis_ros.configuration import STAGE
    from hysteresis_ros.loop.stage_parameters import StageParameters
    from hysteresis_ros.references.scan_clock import LEVELS
    from hysteresis_ros.signals import SOURCE

    stage = StageParameters.from_configuration(configuration)
    # without a scan, the axes refuse these triggers later and state the remedy
    for axis in [only] if only else [f"{name}/" for name in stage.scanning_axes] or [""]:
        configuration = configuration.override(f"{axis}{SOURCE}", **values)
    if each not in LEVELS or LEVELS.index(stage.stage.scan.clock) >= LEVELS.index(each):
        return configuration
    entry = f"{configuration.stage}/{STAGE}", {"scan.clock": each}
    return replace(configuration, entries=(*configuration.entries, entry))
