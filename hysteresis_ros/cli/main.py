# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The command ``hysteresis``. A subcommand is imported only when it is called, so that ``--help`` is quick."""

from __future__ import annotations

import contextlib
import difflib
import errno
import functools
import gc
import importlib
import pathlib
import re
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, NoReturn

import click
from click.shell_completion import CompletionItem

from hysteresis_ros.cli.interrupt import leave_interrupted
from hysteresis_ros.errors import HysteresisError, shortened

#: Subcommands in the groups of the help: group → name → (module:attribute, one-line description).
GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "Run an axis": {
        "up": ("hysteresis_ros.cli.up:up", "Start the nodes of an axis; record, watch and verify the run."),
        "simulate": ("hysteresis_ros.cli.simulate:simulate", "Run an axis offline, without ROS."),
        "setpoint": (
            "hysteresis_ros.cli.remote:setpoint",
            "Send a setpoint to a running axis; print whether it was accepted.",
        ),
        "move": (
            "hysteresis_ros.cli.remote:move",
            "Move a running axis; print the predicted and the measured time until it is ready.",
        ),
        "quiet": ("hysteresis_ros.cli.remote:quiet", "Hold the command of a running axis without feedback."),
        "status": ("hysteresis_ros.cli.remote:status", "Print nodes, health and position of each running axis."),
        "get": ("hysteresis_ros.cli.remote:get", "Print parameters of a running node."),
        "set": ("hysteresis_ros.cli.remote:set_", "Set parameters of a running node, all or none."),
        "call": (
            "hysteresis_ros.cli.remote:call",
            "Call a service of a node (start, stop, reset …), or change its lifecycle.",
        ),
        "echo": ("hysteresis_ros.cli.remote:echo", "Print the messages of a topic."),
        "demo": (
            "hysteresis_ros.cli.demo:demo",
            "Run an axis in real time and as four processes, and report the results.",
        ),
    },
    "Look at runs": {
        "watch": (
            "hysteresis_ros.laboratory.commands:watch",
            "Show a running axis in the browser, and tune it there.",
        ),
        "report": ("hysteresis_ros.cli.recording:report", "Evaluate recordings: figures, charts, one HTML page."),
        "export": ("hysteresis_ros.cli.recording:export", "Convert a recording to .npz or .csv."),
        "repair": ("hysteresis_ros.cli.recording:repair", "Repair a bag that was cut off or is damaged."),
    },
    "Identify": {
        "excite": (
            "hysteresis_ros.cli.excite:excite",
            "Drive an axis with a signal for identification, and record it.",
        ),
        "identify": ("hysteresis_ros.cli.identify:identify", "Fit a model to a recording, and write a parameter file."),
        "validate": (
            "hysteresis_ros.cli.identify:validate",
            "Check a parameter file on a recording that was not used for the fit.",
        ),
        "frf": ("hysteresis_ros.cli.frf:frf", "Measure a frequency response, or estimate it from a recording."),
        "models": (
            "hysteresis_ros.cli.identify:models",
            "List the hysteresis models with parameters, units and inverses.",
        ),
    },
    "Design": {
        "new": ("hysteresis_ros.cli.commission:new", "Write a safe parameter file for a new axis or stage."),
        "commission": (
            "hysteresis_ros.cli.commission:commission",
            "Take a new axis or stage to a closed loop: identify, design, verify.",
        ),
        "design": (
            "hysteresis_ros.cli.design:design",
            "Design a controller, damping or learning for an identified axis.",
        ),
        "scan": (
            "hysteresis_ros.cli.scan:scan",
            "Compute a scan of a plane: peaks, frame rate within limits, harmonics, path.",
        ),
        "parameters": (
            "hysteresis_ros.cli.describe:parameters",
            "List the parameters of the nodes with unit, range and default.",
        ),
    },
    "Hardware": {
        "emulate": (
            "hysteresis_ros.laboratory.emulation.command:emulate",
            "Emulate a device with a simulated plant and faults.",
        ),
        "ioc": ("hysteresis_ros.laboratory.commands:ioc", "Serve axes as EPICS motor records."),
        "camera": ("hysteresis_ros.cli.camera:camera", "Measure displacements in a video or a folder of pictures."),
        "policy": ("hysteresis_ros.cli.describe:policy", "Write the SROS 2 policy of the nodes."),
        "urdf": ("hysteresis_ros.cli.describe:urdf", "Print an axis as a URDF with its joint and limits."),
    },
    "Study": {
        "compare": (
            "hysteresis_ros.laboratory.commands:compare",
            "Rank controllers and compensators for an axis.",
        ),
        "sweep": (
            "hysteresis_ros.laboratory.commands:sweep",
            "Run an axis with varied parameters: yield and sensitivities.",
        ),
        "benchmark": (
            "hysteresis_ros.laboratory.commands:benchmark",
            "Test models of hysteresis on public recordings and synthetic plants.",
        ),
        "reproduce": (
            "hysteresis_ros.laboratory.commands:reproduce",
            "Repeat a paper's experiments: published and reproduced figures.",
        ),
    },
    "Check": {
        "verify": ("hysteresis_ros.cli.recording:verify", "Compare a recorded run with its offline twin, bit for bit."),
        "doctor": ("hysteresis_ros.cli.doctor:doctor", "Measure which sample rates this machine achieves."),
        "faults": (
            "hysteresis_ros.laboratory.commands:faults",
            "Inject faults into a simulated axis, and report the outcome.",
        ),
    },
}
#: The subcommands by name.
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}

#: Number of new objects that starts a garbage collection. Compilation creates millions of objects that stay alive; with
#: Python's default of 700, collections would take a tenth of the time.
COLLECT_AFTER = 50_000
#: Options that name a file to write; endings of parameter files.
WRITTEN = ("-o", "--json", "--csv", "--plot")
PARAMETER_FILES = (".yaml", ".yml")


class LazyGroup(click.Group):
    """A group whose commands are in :data:`COMMANDS`; wrong input ends with one line and exit code 2."""

    #: Names of the imported commands whose callbacks :func:`_keeping_files` has wrapped.
    _checked: ClassVar[set[str]] = set()

    def list_commands(self, ctx) -> list[str]:
        """Return the names of all subcommands in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx, cmd_name: str):
        """Import and return a subcommand; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        command = getattr(importlib.import_module(module), attribute)
        if cmd_name not in self._checked:
            self._checked.add(cmd_name)
            command.callback = _keeping_files(command.callback)
        return command

    def format_commands(self, ctx, formatter) -> None:
        """Write the subcommands in groups, without importing their modules."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(10), line) for name, (_, line) in commands.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the shell completions: matching subcommands with their descriptions, without importing them."""
        named = [(name, line) for name, (_, line) in COMMANDS.items() if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=line) for name, line in named), *options]

    def resolve_command(self, ctx: click.Context, args: list[str]):
        """Find the subcommand that the first word names; for an unknown word suggest a similar name."""
        if (
            args
            and not ctx.resilient_parsing
            and not args[0].startswith("-")
            and self.get_command(ctx, args[0]) is None
        ):
            near = difflib.get_close_matches(args[0], COMMANDS, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(COMMANDS)}"
            ctx.fail(f"no command {args[0]!r}; {hint}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context):
        """Run a subcommand; handle Ctrl-C here, before click prints an empty line."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            leave_interrupted()

    def main(self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any) -> NoReturn:
        """Run the command line and exit; wrong input, Ctrl-C and SIGTERM print one line at most and no traceback."""
        extra["standalone_mode"] = False
        gc.set_threshold(COLLECT_AFTER, *gc.get_threshold()[1:])
        try:
            with _leaving_cleanly():
                code = super().main(args, prog_name, **extra)
        except click.ClickException as error:
            if error.exit_code == 2 and not (args or sys.argv[1:]):
                error.show()  # without arguments, the command shows its help
                sys.exit(error.exit_code)
            _refuse(_usage(error), error.exit_code)
        except HysteresisError as error:
            _refuse(str(error), getattr(error, "exit_code", 2))
        except OSError as error:
            if error.errno not in (errno.ENAMETOOLONG, errno.ELOOP):
                raise
            # if a file name is too long, even the test whether the file exists fails
            _refuse(f"{shortened(error.filename)}: {error.strerror}; give another name", 2)
        except MemoryError as error:
            _refuse(f"not enough memory: {error or 'too many samples'}; choose a shorter run", 2)
        except (click.Abort, KeyboardInterrupt):
            leave_interrupted()
        sys.exit(code or 0)


def _keeping_files(callback):
    """Return a callback that refuses to write a file that the command reads, or two results to one file."""

    @functools.wraps(callback)
    def checked(*values, **named):
        context = click.get_current_context()
        files = list(_files(context))
        for option, path in files:
            others = [other for other, same in files if same == path and other != option]
            # a command may replace the parameter file that it reads, as an editor does
            others = [other for other in others if other in WRITTEN or path.suffix not in PARAMETER_FILES]
            if option in WRITTEN and others:
                name = shortened(path.name)
                if others[0] in WRITTEN:
                    raise click.UsageError(f"{option} and {others[0]} name the same file {name}; give two files")
                raise click.UsageError(f"{option} {name}: the command reads this file and would lose it; give another")
        return callback(*values, **named)

    return checked


def _files(context: click.Context) -> Iterator[tuple[str, pathlib.Path]]:
    """Yield the name of an option or argument and its file, for each value that may be a file."""
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        name = next((option for option in parameter.opts if option in WRITTEN), parameter.human_readable_name)
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, str | pathlib.Path) and str(one) not in ("-", ""):
                with contextlib.suppress(OSError, ValueError):  # a text that is not the name of a file
                    path = pathlib.Path(one).resolve()
                    if name in WRITTEN or path.is_file():
                        yield name, path


def _refuse(text: str, code: int) -> NoReturn:
    """Print an error as one line, and exit."""
    click.echo("hysteresis: " + " ".join(text.split()), err=True)
    sys.exit(code)


def _usage(error: click.ClickException) -> str:
    """Return the error of the command line, and the command that prints help."""
    text = error.format_message().rstrip(".")
    context = getattr(error, "ctx", None)
    if context is None:
        return text
    command = context.command_path.partition(" ")[2]
    where = f"{command}: " if command else ""
    text = f"{where}{text[:1].lower()}{text[1:]}{_nearest_choice(error)}"
    return f"{text}{'' if text.endswith('?') else '.'} Help: {context.command_path} --help"


def _nearest_choice(error: click.ClickException) -> str:
    """Return a suggestion for a value that is not a choice of an option, if a choice is similar."""
    kind = getattr(getattr(error, "param", None), "type", None)
    given = re.match(r"'(.*?)' is not one of", error.message)
    if not isinstance(kind, click.Choice) or given is None:
        return ""
    near = difflib.get_close_matches(given[1], [str(choice) for choice in kind.choices], n=1)
    return f"; did you mean {near[0]}?" if near else ""


@contextlib.contextmanager
def _leaving_cleanly():
    """Let SIGTERM run the ``finally`` clauses, which remove temporary folders and end child processes."""
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
    """Hysteretic actuators under ROS 2: simulate, run, record and evaluate an axis."""


if __name__ == "__main__":
    main(prog_name="hysteresis")
