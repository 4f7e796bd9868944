# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Options that commands over measured data share: which columns, in which units, and how they are judged."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.arguments import Quantity
from hysteresis_ros.cli.progress import Progress

#: Endings of figures' names: in which SI unit the figure is.
ENDINGS = {"_m": "m", "_v": "V", "_s": "s", "_hz": "Hz", "_percent": "%"}


def data_options(command):
    """Add the options to a command; it gets them as keyword arguments."""
    for option in reversed(
        (
            click.option("--input", "input_", metavar="NAME[:UNIT]", help="Input column, e.g. control_V:V."),
            click.option("--output", "output_", metavar="NAME[:UNIT]", help="Output column, e.g. cap_sensor_um:um."),
            click.option("--time", metavar="NAME[:UNIT]", help="Time column, e.g. t_ms:ms."),
            click.option("--sample-time", type=Quantity("s"), help="Of data without a time column, such as 1ms."),
            click.option("--namespace", help="Which axis, when a bag holds several."),
            click.option("--range", "range_", metavar="FIRST:LAST", help="Use these samples only, e.g. 0:6000."),
            click.option("--resample", metavar="SECONDS|auto", help="Bring the data to a uniform grid first."),
            click.option("--negate", is_flag=True, help="Count the output in the other direction."),
            click.option(
                "--all-samples", is_flag=True, help="Take every sample of long data, not what carries information."
            ),
            click.option(
                "--skip",
                type=click.IntRange(0),
                help="Leave the first N samples out of the error; the model sees them.",
            ),
            click.option(
                "--offset", type=click.Choice(["kept", "free"]), default="kept", help="free: remove one constant."
            ),
            click.option(
                "--intersample", type=click.Choice(["zoh", "linear", "bandlimited"]), help="Input between the samples."
            ),
            click.option(
                "--initial", type=click.Choice(["zero", "periodic", "estimate"]), help="Where the state starts."
            ),
            click.option(
                "--json", "json_path", metavar="FILE", help="JSON file for the figures; '-' prints them only."
            ),
        )
    ):
        command = option(command)
    return command


def read(path, *, input_, output_, time, sample_time, namespace, range_, resample, negate, all_samples, whole=False):
    """Return the checked data of a command; say on stderr how far it is, what was guessed and what was done.

    Raises
    ------
    HysteresisError
        The file or a choice cannot be used; the message says what is allowed.
    """
    from hysteresis_ros.identification.reading import Columns, read_data

    columns = Columns(
        input=input_,
        output=output_,
        time=time,
        sample_time=sample_time,
        namespace=namespace,
        range=None if range_ is None else _range(range_),
        resample=None if resample is None else _seconds(resample),
        negate=negate,
        all_samples=all_samples,
        whole=whole,
    )
    state = [""]

    def progress(part: float) -> None:
        state[0] = f"{100 * part:.0f} %"

    with Progress(err=True).during(f"reading {path.name}", lambda: state[0]):
        reading = read_data(path, columns, progress)
    for note in (*reading.guessed, *reading.data.notes):
        click.echo(f"note: {note}", err=True)
    return reading


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
    """Print the table, or the figures as JSON for ``-``; write them to a file besides where one is named.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    import json

    from hysteresis_ros.errors import RecordingError

    text = json.dumps(figures, indent=2, ensure_ascii=False, allow_nan=False)
    click.echo(text if path == "-" else table)
    if path not in (None, "-"):
        try:
            pathlib.Path(path).write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def format_figures(figures: dict, first: tuple[str, ...] = ()) -> str:
    """Return figures as lines ``name value``, those named ``first`` in front; lists of texts come last.

    Where the name of a figure ends in its unit, the value stands in the part of the unit that people use: ``rmse_m`` of
    2.148e-7 is shown as ``rmse  0.2148 µm``.
    """
    from hysteresis_ros.units import readable

    order = [*(name for name in first if name in figures), *(name for name in figures if name not in first)]
    endings = {name: next((ending for ending in ENDINGS if name.endswith(ending)), "") for name in order}
    bare = [name.removesuffix(ending) for name, ending in endings.items()]
    labels = {name: text if bare.count(text) == 1 else name for name, text in zip(order, bare, strict=True)}
    width = max(len(label) for label in labels.values())
    lines, texts = [], []
    for name in order:
        value = figures[name]
        if isinstance(value, (list, tuple)):
            texts += [f"{name.rstrip('s')}: {text}" for text in value]
        elif isinstance(value, float):
            shown = readable(value, ENDINGS[endings[name]]) if endings[name] else f"{value:.6g}"
            lines.append(f"{labels[name]:<{width}}  {shown}")
        else:
            shown = {True: "yes", False: "no"}[value] if isinstance(value, bool) else ("-" if value is None else value)
            lines.append(f"{labels[name]:<{width}}  {shown}")
    return "\n".join(lines + texts)
