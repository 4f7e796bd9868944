# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis status|get|set|call|echo|setpoint|move|quiet``: operate a running axis, without the command ``ros2``."""

from __future__ import annotations

import math
import os

import click

from hysteresis_ros.cli.options import NodeName, Quantity


def steered(timeout: float = 10.0):
    """Return a decorator that adds the options shared by all commands for a running axis.

    ``timeout`` [s] is the default of the option ``--timeout``.
    """
    words = "Time to wait for the node's answer [s]."
    options = (
        click.option("--timeout", type=Quantity("s"), default=timeout, show_default=True, help=words),
        click.option("--namespace", default="", help="Namespace of the axis."),
    )

    def add(command):
        for option in options:
            command = option(command)
        return command

    return add


def in_graph(command: str, namespace: str, timeout: float, **arguments) -> None:
    """Execute a command in the graph and exit with its code. ``timeout`` [s] limits each wait."""
    import json
    import subprocess
    import sys
    from functools import partial

    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.nodes.remote.door import ask_session

    if not 0.0 < timeout < math.inf:
        raise HysteresisError(f"--timeout {timeout:g}: must be a positive number of seconds")
    request = {"command": command, "namespace": namespace, "timeout": timeout, **arguments}
    code = ask_session(request)
    if code is not None:
        raise SystemExit(code)

    from hysteresis_ros.nodes.launcher import die_with_parent, node_environment, require_ros

    require_ros()
    # a separate process, because the pip wheels of ROS restart the interpreter on import
    words = [sys.executable, "-m", "hysteresis_ros.nodes.remote", json.dumps(request)]
    # in a separate session, so that Ctrl-C reaches only this process, which then ends the other one
    guard = partial(die_with_parent, os.getpid())
    child = subprocess.run(words, env=node_environment(), start_new_session=True, preexec_fn=guard)
    raise SystemExit(child.returncode)


@click.command(short_help="Print nodes, health and position of each running axis.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, in SI.")
@steered()
def status(as_json, namespace, timeout):
    """Print for each axis: its nodes, their lifecycle, rate and health, and the last setpoint, position and voltage.

    Exit code 0: all nodes are healthy; 1: a node is missing, inactive or reports a problem; 2: there is no axis.
    """
    in_graph("status", namespace, timeout, as_json=as_json)


@click.command(short_help="Print parameters of a running node.")
@click.argument("node", type=NodeName())
@click.argument("names", nargs=-1, metavar="[PARAM]...")
@steered()
def get(node, names, namespace, timeout):
    """Print the named parameters of NODE as YAML; without names, all of them."""
    in_graph("get", namespace, timeout, node=node, names=list(names))


@click.command(
    name="set",
    short_help="Set parameters of a running node, all or none.",
    # a negative value must not be read as an option
    context_settings={"ignore_unknown_options": True},
)
@click.argument("node", type=NodeName())
@click.argument("pairs", nargs=-1, required=True, metavar="PARAM VALUE [PARAM VALUE]...")
@steered()
def set_(node, pairs, namespace, timeout):
    """Set parameters of NODE: all of them, or none if NODE refuses one. Values are in SI or have a unit (5um)."""
    if len(pairs) % 2:
        raise click.UsageError(f"{pairs[-1]} has no value: write PARAM VALUE [PARAM VALUE]...")
    in_graph("set", namespace, timeout, node=node, values=dict(zip(pairs[::2], pairs[1::2], strict=True)))


@click.command(short_help="Call a service of a node (start, stop, reset …), or change its lifecycle.")
@click.argument("node", type=NodeName())
@click.argument("action")
@steered()
def call(node, action, namespace, timeout):
    """Call ACTION of NODE: a service (start, stop, reset, home, release, freeze, save …) or a lifecycle transition.

    Transitions: configure, activate, deactivate, cleanup, shutdown.
    """
    in_graph("call", namespace, timeout, node=node, action=action)


@click.command(short_help="Print the messages of a topic.")
@click.argument("topic")
@click.option("--once", is_flag=True, help="End after one message.")
@click.option("--count", type=click.IntRange(1), help="End after this number of messages.")
@steered()
def echo(topic, once, count, namespace, timeout):
    """Print the messages of TOPIC, e.g. joint_states, reference, motion_controller/state; Ctrl-C ends it."""
    if once and count:
        raise click.UsageError("--once and --count exclude each other; give one of them")
    in_graph("echo", namespace, timeout, topic=topic, count=1 if once else count)


@click.command(
    short_help="Send a setpoint to a running axis.",
    # a negative setpoint must not be read as an option
    context_settings={"ignore_unknown_options": True},
)
@click.argument("value")
@steered(timeout=30.0)  # an axis compiles when it starts for the first time
def setpoint(value, namespace, timeout):
    """Send the setpoint VALUE, e.g. 5um or 5.0e-6m, to an axis, and print whether the axis accepts it.

    Exit code 2: the setpoint is refused (it is out of range, or a node is inactive); or a node is stopped, and the axis
    moves to the setpoint as soon as the node is started. Exit code 1: the axis is not found or does not answer, so it
    is unknown whether the setpoint was accepted.
    """
    in_graph("setpoint", namespace, timeout, value=_quantity("setpoint", value, "m"))


def _quantity(name: str, text: str, unit: str) -> float:
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.units import quantity_in

    try:
        return quantity_in(text, unit)
    except ValueError as error:
        raise HysteresisError(f"{name} {text}: {error}") from None


@click.command(
    short_help="Move a running axis; print when it is ready.",
    # a negative setpoint must not be read as an option
    context_settings={"ignore_unknown_options": True},
)
@click.argument("value")
@click.option("--tolerance", help="Largest distance from VALUE, e.g. 5nm; by default ready.tolerance or the noise.")
@click.option("--dwell", help="Time to stay within the tolerance, e.g. 5ms; by default ready.dwell of the axis.")
@steered(timeout=60.0)  # the first prediction may have to be compiled
def move(value, tolerance, dwell, namespace, timeout):
    """Move an axis to VALUE, e.g. 5um; print the predicted time until it is ready, then the measured time.

    An axis is ready when its displacement stays within the tolerance of VALUE. The move is refused if the tolerance is
    smaller than the noise of the axis allows, or VALUE is out of range.

    Exit code 0: ready. 1: the axis is not found, or the move was replaced, stopped or not ready within the time-out. 2:
    the move is refused.
    """
    given = {
        "tolerance": None if tolerance is None else _quantity("--tolerance", tolerance, "m"),
        "dwell": None if dwell is None else _quantity("--dwell", dwell, "s"),
    }
    in_graph("move", namespace, timeout, value=_quantity("setpoint", value, "m"), **given)


@click.command(short_help="Hold the command of a running axis constant, without feedback.")
@click.argument("duration")
@click.option("--tolerance", help="Largest drift by creep, e.g. 5nm; by default any.")
@steered()
def quiet(duration, tolerance, namespace, timeout):
    """Hold the command of an axis constant for DURATION, e.g. 2s or 500ms; 0s ends a quiet hold.

    The noise of the sensor does not reach the actuator, and the model compensates the creep of the actuator. Exit code
    2: the quiet hold is refused, because creep would leave the tolerance or the axis does not run. Exit code 1: the
    axis is not found or does not answer.
    """
    within = None if tolerance is None else _quantity("--tolerance", tolerance, "m")
    in_graph("quiet", namespace, timeout, duration=_quantity("duration", duration, "s"), tolerance=within)
