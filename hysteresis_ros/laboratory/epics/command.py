# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis ioc``: axes as EPICS motor records."""

from __future__ import annotations

import signal

import click

from hysteresis_ros.cli.options import ConfigurationName


@click.command(short_help="Serve axes as EPICS motor records.")
@click.argument("config", type=ConfigurationName())
@click.option("--attach", is_flag=True, help="Only serve axes that already run.")
@click.option("--prefix", default="hysteresis:", show_default=True, help="Prefix of the records' names.")
@click.option("--namespace", help="Only the axis in this namespace.")
@click.option("--egu", default="um", show_default=True, help="Engineering unit: um, nm, mm, m …")
@click.option("--precision", default=4, show_default=True, help="Digits after the decimal point.")
@click.option(
    "--tolerance",
    type=float,
    help="Distance from the target within which a move has arrived [EGU]; by default trajectory.goal_tolerance.",
)
@click.option(
    "--timeout",
    default=10.0,
    show_default=True,
    help="Time-out of a move, in addition to its duration at full speed [s].",
)
@click.option(
    "--interface",
    metavar="ADDRESSES",
    help="Addresses to listen on; by default EPICS_CAS_INTF_ADDR_LIST, else 127.0.0.1.",
)
@click.option("--port", type=click.IntRange(1024, 65535), help="Port; by default EPICS_CA_SERVER_PORT, else 5064.")
def ioc(config, *, attach, prefix, namespace, egu, precision, tolerance, timeout, interface, port):
    """Start the axes of CONFIG, which follow setpoints only, and serve each as an EPICS motor record.

    The record of an axis in the namespace `left` is hysteresis:left; the record of an axis without namespace is
    hysteresis:m1. Exit code 0: after Ctrl-C; 1: a node has died; 2: wrong input.
    """
    requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: requested.append(signum))
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.laboratory.epics.record import RecordOptions, at_rest, motor_settings
    from hysteresis_ros.laboratory.epics.server_process import interfaces, serve
    from hysteresis_ros.loop.parameters import in_time
    from hysteresis_ros.loop.reach import axes

    configuration = load_configuration(config)
    configuration = configuration.override("", autostart=True)
    found = [at_rest(axis) for axis in axes(configuration, namespace)]
    record = RecordOptions(prefix, egu, precision, timeout, tolerance)
    motors = [motor_settings(axis, record) for axis in found]
    started = [] if attach else [in_time(axis) for axis in found]
    raise SystemExit(serve(motors, started, interfaces(interface), port, lambda: bool(requested)))
