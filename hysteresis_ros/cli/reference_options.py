# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Options of commands that move an axis: what it shall follow, in words, in place of the configuration's waveform."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from dataclasses import dataclass

import click

from hysteresis_ros.cli.arguments import WaveformName

#: Option → parameter of the waveform; of the others ``--waveform NAME=VALUE`` takes care.
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
    "--amplitude": "Its height above the offset, e.g. 70um.",
    "--frequency": "E.g. 5Hz.",
    "--offset": "Added to it, e.g. 10um.",
    "--cycles": "Cycles, after which it rests; 0: endless.",
    "--polarity": "unipolar: from the offset upwards; symmetric: to both sides.",
    "--values": "Levels of steps, e.g. 2um,0,2um.",
    "--times": "When the steps begin, e.g. 0s,0.4s,0.8s.",
    "--file": "CSV, NPZ or NPY file of --reference file.",
}


@dataclass(frozen=True)
class AskedReference:
    """What the options say; nothing where ``kind`` is None.

    Parameters
    ----------
    kind : str or None
        Name of the waveform.
    given : dict of str to str
        Text of each parameter of it.
    """

    kind: str | None
    given: dict[str, str]

    def values(self, gain: float | None = None) -> dict:
        """Return the parameters of the waveform, see :func:`~hysteresis_ros.references.asked.asked_waveform`.

        Parameters
        ----------
        gain : float, optional
            Of an axis in open loop without inverse [m/V]: lengths may be voltages.
        """
        from hysteresis_ros.references.asked import asked_waveform

        with self.named():
            return asked_waveform(str(self.kind), self.given, gain)

    def put_into(self, configuration):
        """Return a configuration whose axes follow the waveform; the same one where none was asked for.

        Parameters
        ----------
        configuration : Configuration

        Raises
        ------
        HysteresisError
            A value is wrong, or an inchworm has no such waveform.
        """
        from hysteresis_ros.errors import ConfigurationError

        if self.kind is None:
            self.refuse_others()
            return configuration
        if any(configuration.describes("inchworm_sequencer", space) for space in configuration.namespaces()):
            raise ConfigurationError(
                f"--reference {self.kind}: {configuration.source} is an inchworm, which walks to setpoints and follows "
                "no waveform; give it setpoints with `hysteresis setpoint`"
            )
        values = {f"waveform.{name}": value for name, value in self.values().items()}
        return configuration.override("reference_generator", **values)

    def refuse_others(self, taken: tuple[str, ...] = ()) -> None:
        """Refuse words about a waveform where none was asked for.

        Parameters
        ----------
        taken : tuple of str
            Parameters that mean something without one.

        Raises
        ------
        click.UsageError
            Names the option that has nothing to belong to.
        """
        for name in self.given:
            if name not in taken:
                raise click.UsageError(f"{_option(name)} belongs to a waveform: give --reference, e.g. triangle")

    @contextlib.contextmanager
    def named(self) -> Iterator[None]:
        """Let what is wrong with the waveform be named by its option and with the words of the command line."""
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
            return Problem("--reference", self.kind, problem.allowed)
        own = name.removeprefix(f"{self.kind}.")
        text = next((self.given[word] for word in (name, own) if word in self.given), problem.value)
        return Problem(_option(own), text, problem.allowed)


def _option(name: str) -> str:
    """Return the option that takes a parameter."""
    return next((option for option, parameter in PARAMETERS.items() if parameter == name), f"--waveform {name}")


def reference_options(command):
    """Add the options to a command, which gets them as ``reference``, an :class:`AskedReference`.

    Parameters
    ----------
    command : callable
    """

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
            "--reference", type=WaveformName(), metavar="WAVEFORM", help="Follow this: triangle, sine, steps, file …"
        ),
        *(
            click.option(option, f"reference_{parameter}", metavar="TEXT", help=HELP[option])
            for option, parameter in PARAMETERS.items()
        ),
        click.option(
            "--waveform", "further", multiple=True, metavar="NAME=VALUE", help="Further parameter of it; repeatable."
        ),
    ]
    for option in reversed(options):
        with_reference = option(with_reference)
    return with_reference
