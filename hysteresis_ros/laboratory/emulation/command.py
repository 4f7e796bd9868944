# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis emulate``: an emulated device with a plant inside, for any program."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace

import click

from hysteresis_ros.configuration import ParameterRow
from hysteresis_ros.hardware.driver import EmulatedDevice, HardwareDriver
from hysteresis_ros.hardware.registry import DRIVERS
from hysteresis_ros.laboratory.emulation.bench import FAULTS

_FAULT_HELP = "Inject this fault: " + "; ".join(f"{name}: {kind.description}" for name, kind in FAULTS.items())


def _option(row: ParameterRow) -> click.Option:
    """Return the option for a parameter of a device."""
    kind = click.Choice(row.choices) if row.choices else row.type
    name = f"--{row.name.replace('_', '-')}"
    unit = f" [{row.unit}]" if row.unit else ""
    given = {"required": True} if row.required else {"default": row.default, "show_default": True}
    return click.Option([name, row.name], type=kind, help=row.description + unit, **given)


def _command(declared: HardwareDriver, device: EmulatedDevice) -> click.Command:
    """Return the command that starts the device of a driver."""

    def run(plant, faults, **values) -> None:
        from hysteresis_ros.laboratory.emulation.bench import Bench

        given = device.parameters.from_mapping(values)
        bench = replace(Bench() if plant is None else _bench_of(plant), faults=faults)
        with device.start(given, bench) as running:
            click.echo(
                f"{declared.name}: {running.where}. Each input line adds a fault (NAME:START:DURATION[:VALUE]); "
                "Ctrl-C ends."
            )
            _take_faults(running)

    options: list[click.Parameter] = [
        *map(_option, device.parameters.table()),
        click.Option(["--plant"], metavar="CONFIG", help="Use the plant of this axis; by default an assumed stage."),
        click.Option(["--fault", "faults"], multiple=True, metavar="NAME:START:DURATION[:VALUE]", help=_FAULT_HELP),
    ]
    return click.Command(declared.name, callback=run, params=options, help=f"Emulate {declared.title}.")


def _bench_of(config: str):
    """Return the plant of an axis, with its sample time."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.laboratory.emulation.bench import Bench
    from hysteresis_ros.loop.parameters import part
    from hysteresis_ros.loop.reach import single_axis
    from hysteresis_ros.models.actuator import ActuatorParameters

    axis = single_axis(load_configuration(config), None).plant_simulator
    return Bench(part(axis, ActuatorParameters), 1.0 / axis.sample_rate)


def _take_faults(running) -> None:
    """Read faults from standard input until the end of the command."""
    from hysteresis_ros.errors import ConfigurationError

    for line in sys.stdin:
        try:
            if line.strip():
                running.faults.add(line.strip())
                click.echo(f"from now on: {line.strip()}")
        except ConfigurationError as error:
            click.echo(f"hysteresis: {error}", err=True)
    threading.Event().wait()  # after the last line of input, wait for a signal


@click.group(short_help="Emulate a device, with a plant inside and faults.")
def emulate() -> None:
    """Emulate a device for its driver or for other programs, with a plant inside that has its own clock."""


for _declared in DRIVERS.values():
    if (_device := _declared.emulated) is not None:
        emulate.add_command(_command(_declared, _device))
