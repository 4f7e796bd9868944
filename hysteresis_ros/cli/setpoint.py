"""``hysteresis setpoint``: move an axis by hand where there is no ``ros2`` command."""

from __future__ import annotations

import math

import click


@click.command(
    short_help="Publish a setpoint, like ros2 topic pub --once.",
    # a negative setpoint is no option
    context_settings={"ignore_unknown_options": True},
)
@click.argument("value", type=float)
@click.option("--namespace", default="", help="Namespace of the axis.")
@click.option("--timeout", type=float, default=30.0, show_default=True, help="Wait so long for the axis [s].")
def setpoint(value, namespace, timeout):
    """Publish VALUE [m] on the topic setpoint once and wait until it has been received."""
    import subprocess
    import sys

    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.nodes.launcher import node_environment, require_ros

    if not math.isfinite(value):
        raise HysteresisError(f"setpoint {value} m: must be a finite number of metres")
    if not 0.0 < timeout < math.inf:
        raise HysteresisError(f"--timeout {timeout:g}: must be a positive number of seconds")
    require_ros()
    # a process of its own: the pip wheels of ROS restart the interpreter on import
    command = [sys.executable, "-m", "hysteresis_ros.nodes.setpoint_publisher", f"--setpoint={value!r}"]
    command += ["--timeout", repr(timeout)] + (["--namespace", namespace] if namespace else [])
    # in a session of its own: Ctrl-C in a terminal reaches this process only, which takes the other one along
    raise SystemExit(subprocess.run(command, env=node_environment(), start_new_session=True).returncode)
