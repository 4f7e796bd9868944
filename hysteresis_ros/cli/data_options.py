"""Options that commands over measured data share: which columns, in which units, and how they are judged."""

from __future__ import annotations

import pathlib

import click

#: Names under which recordings elsewhere keep the voltage and the displacement, the most telling first.
INPUT_NAMES = ("voltage", "control", "command", "drive", "input", "excitation", "u", "v", "volt", "amp", "piezo")
OUTPUT_NAMES = (
    *("measured", "displacement", "position", "sensor", "cap", "gauge", "interferometer", "output"),
    *("y", "x", "z", "d", "pos", "disp", "um", "nm"),
)


def data_options(command):
    """Add the options to a command; it gets them as keyword arguments."""
    for option in reversed(
        (
            click.option("--input", "input_", metavar="NAME[:UNIT]", help="Input column, e.g. control_V:V."),
            click.option("--output", "output_", metavar="NAME[:UNIT]", help="Output column, e.g. cap_sensor_um:um."),
            click.option("--time", metavar="NAME[:UNIT]", help="Time column, e.g. t_ms:ms."),
            click.option("--sample-time", type=float, help="Sample time [s] of data without a time column."),
            click.option("--namespace", help="Which axis, when a bag holds several."),
            click.option("--range", "range_", metavar="FIRST:LAST", help="Use these samples only, e.g. 0:6000."),
            click.option("--resample", metavar="SECONDS|auto", help="Bring the data to a uniform grid first."),
            click.option("--negate", is_flag=True, help="Count the output in the other direction."),
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


def read_data(path, *, input_, output_, time, sample_time, namespace, range_, resample, negate):
    """Return the checked data of a command, its report, and tell on stderr what was guessed.

    Raises
    ------
    HysteresisError
        The file or a choice cannot be used; the message says what is allowed.
    """
    from dataclasses import replace

    from hysteresis_ros.errors import IdentificationError
    from hysteresis_ros.identification.data import DataError, load_data
    from hysteresis_ros.identification.data import resample as resampled

    path = pathlib.Path(path)
    if sample_time is not None and not 0.0 < sample_time < float("inf"):
        raise IdentificationError(f"--sample-time {sample_time:g}: must be above 0 s")
    try:
        data = load_data(path, input_, output_, time, sample_time, namespace)
    except DataError as error:
        if error.check != "columns":
            raise
        input_, output_ = _guess(path, input_, output_, error)
        data = load_data(path, input_, output_, time, sample_time, namespace)
    if data.output_unit != "m":
        raise IdentificationError(
            f"output {data.output_name} is in '{data.output_unit}'; it must be a length: give it as "
            f"{data.output_name}:um or whatever it is in"
        )
    if range_ is not None:
        data = data.part(*_range(range_))
    if resample is not None:
        data = resampled(data, _seconds(resample))
    if negate:
        data = replace(data, output=-data.output, notes=(*data.notes, "output counted in the other direction"))
    return data.checked()


def _guess(path: pathlib.Path, input_, output_, error):
    """Choose the columns whose names tell most, or raise ``error``."""
    from hysteresis_ros.recordings.columns import TEXT_SUFFIXES, UNITS, find_time, read_table, split_choice

    if path.suffix.lower() not in (*TEXT_SUFFIXES, ".npz"):
        raise error
    declared = read_table(path)[1]
    taken = {find_time(declared)}
    taken |= {choice if choice in declared else split_choice(choice)[0] for choice in (input_, output_) if choice}
    free = {name: UNITS.get(unit, (unit,))[0] for name, unit in declared.items() if name not in taken}
    chosen, notes = {}, []
    for role, given, names, unit in (("input", input_, INPUT_NAMES, "V"), ("output", output_, OUTPUT_NAMES, "m")):
        if given:
            chosen[role] = given
            continue
        fitting = [name for name in free if free[name] == unit] or [name for name in free if free[name] is None]
        ranked = sorted(fitting, key=lambda name: _rank(name, names))
        best = [name for name in ranked if _rank(name, names) == _rank(ranked[0], names)]
        if len(best) != 1 or _rank(best[0], names) >= len(names):
            raise error
        if free[best[0]] is None:
            raise type(error)(
                "unit", f"{path}: column '{best[0]}' seems to be the {role} but has no unit; give it as "
                f"--{role} {best[0]}:{'V' if unit == 'V' else 'um'} or whatever it is in"
            )  # fmt: skip
        chosen[role] = best[0]
        del free[best[0]]
        notes.append(f"note: {role} is the column '{best[0]}'; choose another with --{role}")
    click.echo("\n".join(notes), err=True)
    return chosen["input"], chosen["output"]


def _rank(name: str, names) -> int:
    """Return how early one of the telling names stands in a column's name."""
    words = name.lower().replace("-", "_").replace(" ", "_").split("_")
    for place, telling in enumerate(names):
        if telling in words or (len(telling) > 3 and telling in name.lower()):
            return place
    return len(names)


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
        return None
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


def finite(figures: dict) -> dict:
    """Return figures for JSON: what is not finite becomes null."""
    import math

    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in figures.items()
    }


def format_figures(figures: dict, first: tuple[str, ...] = ()) -> str:
    """Return figures as lines ``name value``, those named ``first`` in front; lists of texts come last."""
    order = [*(name for name in first if name in figures), *(name for name in figures if name not in first)]
    width = max(len(name) for name in order)
    lines, texts = [], []
    for name in order:
        value = figures[name]
        if isinstance(value, (list, tuple)):
            texts += [f"{name.rstrip('s')}: {text}" for text in value]
        elif isinstance(value, float):
            lines.append(f"{name:<{width}}  {value:.6g}")
        else:
            shown = {True: "yes", False: "no"}[value] if isinstance(value, bool) else ("-" if value is None else value)
            lines.append(f"{name:<{width}}  {shown}")
    return "\n".join(lines + texts)


def inverse_figures(back) -> dict:
    """Return the figures of an inverse validation; None where there is none."""
    if back is None:
        return {"inverse_rmse_v": None, "inverse_rmse_m": None, "inverse_rmse_percent": None}
    return {
        "inverse_rmse_v": back.rmse,
        "inverse_rmse_m": back.rmse_displacement,
        "inverse_rmse_percent": back.rmse_percent,
    }
