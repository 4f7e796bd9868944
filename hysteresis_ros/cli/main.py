"""The command ``hysteresis``. A subcommand is imported only when it is called, so that ``--help`` is quick."""

from __future__ import annotations

import contextlib
import importlib
import signal
import sys
import threading

import click

from hysteresis_ros.errors import HysteresisError

#: Subcommands: name → (module:attribute, what it does in one line).
COMMANDS = {
    "demo": ("hysteresis_ros.cli.demo:demo", "Run Kim's axis as four processes, move it, record it, report it."),
    "up": ("hysteresis_ros.cli.up:up", "Start the nodes of a configuration, record and report."),
    "setpoint": ("hysteresis_ros.cli.setpoint:setpoint", "Move an axis by hand, like ros2 topic pub --once."),
    "simulate": ("hysteresis_ros.cli.simulate:simulate", "Run a configuration offline, without ROS."),
    "parameters": (
        "hysteresis_ros.cli.parameters:parameters",
        "List the parameters of the nodes with type, default, unit and range.",
    ),
    "identify": ("hysteresis_ros.cli.identify:identify", "Identify a model from a recording."),
    "validate": ("hysteresis_ros.cli.validate:validate", "Validate a parameter file on a recording."),
    "models": ("hysteresis_ros.cli.models:models", "List the models with parameters, units and inverses."),
    "excite": ("hysteresis_ros.cli.excite:excite", "Drive an axis with what an identification needs."),
    "export": ("hysteresis_ros.cli.export:export", "Turn a recording into .npz or .csv."),
    "design": ("hysteresis_ros.cli.design:design", "Design a controller from the model in a configuration."),
    "report": ("hysteresis_ros.cli.report:report", "Judge a recording: figures, plots, HTML."),
    "compare": ("hysteresis_ros.cli.compare:compare", "Rank all controllers and compensators for an axis."),
    "reproduce": ("hysteresis_ros.cli.reproduce:reproduce", "Repeat a paper's experiments: paper, here, holds."),
}


class LazyGroup(click.Group):
    """A group whose commands are looked up in :data:`COMMANDS`; wrong input ends in one line and exit code 2."""

    def list_commands(self, ctx) -> list[str]:
        """Return the names of all subcommands in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx, cmd_name: str):
        """Import and return a subcommand, None when there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        return getattr(importlib.import_module(module), attribute)

    def format_commands(self, ctx, formatter) -> None:
        """Write the list of subcommands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])

    def invoke(self, ctx):
        """Run a subcommand; answer wrong input with one line, and Ctrl-C and SIGTERM without words."""
        try:
            with _leaving_cleanly():
                return super().invoke(ctx)
        except HysteresisError as error:
            click.echo("hysteresis: " + " ".join(str(error).split()), err=True)
            ctx.exit(getattr(error, "exit_code", 2))
        except KeyboardInterrupt:
            ctx.exit(128 + signal.SIGINT)


@contextlib.contextmanager
def _leaving_cleanly():
    """Let SIGTERM end the process through its ``finally`` clauses: temporary folders go, child processes too."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _show_version(ctx, parameter, value) -> None:
    if value and not ctx.resilient_parsing:
        from hysteresis_ros import __version__

        click.echo(f"hysteresis {__version__}")
        ctx.exit()


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the version and exit.",
)
def main() -> None:
    """Hysteretic actuators under ROS 2: simulate, run, record and judge an axis."""


if __name__ == "__main__":
    main(prog_name="hysteresis")
