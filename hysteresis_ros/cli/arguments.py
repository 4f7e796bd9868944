# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arguments that several commands have, and what a shell offers for them."""

from __future__ import annotations

import pathlib

import click
from click.shell_completion import CompletionItem


class ConfigurationName(click.ParamType):
    """A parameter file: a path, or the name of one that comes with the package."""

    name = "config"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the names that come with the package, and files and folders beside what was typed."""
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
    """A number with its unit, such as ``2nm``, ``100Hz``, ``0.5s``; its value is in SI. A length needs its unit."""

    def __init__(self, unit: str):
        self.unit = unit
        self.name = {"m": "length", "s": "time", "Hz": "frequency"}[unit]

    def convert(self, value, param, ctx) -> float:
        """Return the number in SI; click reports what is refused, with exit code 2."""
        from hysteresis_ros.units import quantity_in

        try:
            return quantity_in(value, self.unit) if isinstance(value, str) else float(value)
        except ValueError as error:
            self.fail(f"{value!r}: {error}", param, ctx)


class WaveformName(click.ParamType):
    """The name of a waveform; what is none is refused where all waveforms are known."""

    name = "waveform"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the waveforms whose names begin so."""
        from hysteresis_ros.references.waveforms import WAVEFORMS

        return [CompletionItem(name) for name in WAVEFORMS if name.startswith(incomplete)]


class NodeName(click.ParamType):
    """The name of a node of an axis, or of any other."""

    name = "node"

    def shell_complete(self, ctx, param, incomplete: str) -> list[CompletionItem]:
        """Return the nodes of an axis whose names begin so."""
        from hysteresis_ros.configuration import NODE_NAMES, OPTIONAL_NODE_NAMES

        return [CompletionItem(name) for name in NODE_NAMES + OPTIONAL_NODE_NAMES if name.startswith(incomplete)]


#: How a recording is split, as ``ros2 bag record`` does; the command gets both under these names.
_SPLITS = (
    click.option("--max-bag-size", type=click.IntRange(1), metavar="BYTES", help="Begin another file of the bag then."),
    click.option(
        "--max-bag-duration",
        type=click.FloatRange(0, min_open=True),
        metavar="SECONDS",
        help="Begin another file of the bag after so long.",
    ),
)


def split_options(command):
    """Give a command the options of how a recording is split."""
    for option in reversed(_SPLITS):
        command = option(command)
    return command


def splitting(configuration, max_bag_size: int | None, max_bag_duration: float | None):
    """Return the configuration whose recorder splits as the options say.

    Parameters
    ----------
    configuration : Configuration
    max_bag_size : int or None
        Bytes of a file.
    max_bag_duration : float or None
        Seconds of a file.
    """
    given = {"max_bag_size": max_bag_size, "max_bag_duration": max_bag_duration}
    given = {name: value for name, value in given.items() if value is not None}
    return configuration.override("recorder", **given) if given else configuration


#: Parameter files that are laid over the configuration; the command gets their names as ``laid_over``.
params_file_option = click.option(
    "--params-file",
    "laid_over",
    multiple=True,
    metavar="FILE",
    help="Parameter file whose values win over those of CONFIG, as one that a node has saved; may be repeated.",
)


def laid_under(config: str, laid_over: tuple[str, ...]):
    """Return a configuration with the parameter files that are laid over it.

    Parameters
    ----------
    config : str
    laid_over : tuple of str
        The later one wins.

    Raises
    ------
    ConfigurationError
        One of them cannot be read.
    """
    from hysteresis_ros.configuration import load_configuration

    return load_configuration(config).under(*map(load_configuration, laid_over))
