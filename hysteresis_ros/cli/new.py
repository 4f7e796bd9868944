# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis new``: the parameter file of an axis of which nothing is known yet."""

from __future__ import annotations

import pathlib
import sys

import click

#: What is asked on a terminal when its option is missing: the option, the words of the question, and an example.
QUESTIONS = {
    "stroke": ("--stroke", "How far does the actuator move over its range of voltage?", "100um"),
    "voltage": ("--voltage", "Which voltages may be put out?", "0:100V"),
    "rate": ("--rate", "How many samples per second?", "1kHz"),
}


@click.command(short_help="Write a safe parameter file for a new axis.")
@click.argument("file", type=click.Path(path_type=pathlib.Path))
@click.option("--stroke", "--range", metavar="LENGTH", help="Displacement over the range of voltage, such as 100um.")
@click.option("--voltage", metavar="MIN:MAX", help="Range of voltage, such as 0:100V or -30..120V.")
@click.option("--rate", metavar="FREQUENCY", help="Sample rate, such as 2kHz.")
@click.option("--driver", metavar="NAME|PATH", default="", help="Driver of the device; by default the simulated plant.")
@click.option("--driver-option", "options", metavar="NAME=VALUE", multiple=True, help="What the driver is opened with.")
@click.option(
    "--plant",
    type=click.Choice(["own", "external"]),
    default="own",
    show_default=True,
    help="external: a node of yours publishes joint_states in plant_simulator's place.",
)
@click.option("--joint", default="stage", show_default=True, help="Name of the joint in joint_states.")
def new(file, driver, options, plant, joint, **given):
    """Write FILE, a commented parameter file that is safe: open loop, no inverse, small limits, slow.

    What is not given is asked for on a terminal. `hysteresis commission FILE` does the rest.
    """
    from hysteresis_ros.commissioning.new_file import NewAxis, parsed, parsed_range, write_new
    from hysteresis_ros.errors import ConfigurationError

    if file.exists():
        raise ConfigurationError(f"{file}: exists already; choose another name or remove it")
    for name, (option, words, example) in QUESTIONS.items():
        if given[name] is None and sys.stdin.isatty() and sys.stdout.isatty():
            given[name] = click.prompt(words, default=example)
        elif given[name] is None:
            raise ConfigurationError(f"{option} is missing: {words} Give it, such as {option} {example}")
    low, high = parsed_range("--voltage", given["voltage"], "V")
    axis = NewAxis(
        stroke=parsed("--stroke", given["stroke"], "m"),
        minimum=low,
        maximum=high,
        sample_rate=parsed("--rate", given["rate"], "Hz"),
        driver=driver,
        driver_options=options,
        external=plant == "external",
        joint=joint,
    )
    write_new(file, axis)
    click.echo(f"{file}: written; next: hysteresis commission {file}")
