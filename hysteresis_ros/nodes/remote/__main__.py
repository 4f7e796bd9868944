# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Execute a command in the graph: ``python -m hysteresis_ros.nodes.remote '{"command": "status", …}'``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.nodes.remote.client import AbsentError, Client
from hysteresis_ros.nodes.remote.commands import call, echo, get, move, quiet, set_, setpoint, status

#: The commands; each is called with the client and the further arguments.
COMMANDS: dict[str, Callable[..., int | None]] = {
    "status": status,
    "get": get,
    "set": set_,
    "call": call,
    "echo": echo,
    "setpoint": setpoint,
    "move": move,
    "quiet": quiet,
}


def done(request: dict, make_client: Callable[[str, float], Client] = Client) -> int:
    """Execute the command, and return the exit code."""
    arguments = dict(request)
    command = COMMANDS[arguments.pop("command")]
    try:
        with make_client(arguments.pop("namespace"), arguments.pop("timeout")) as client:
            return command(client, **arguments) or 0
    except HysteresisError as error:
        print(f"hysteresis: {' '.join(str(error).split())}", file=sys.stderr)
        # not 2, the code of a refusal, because it is unknown whether the request was accepted; status requests nothing
        return 1 if isinstance(error, AbsentError) and command is not status else 2


def main() -> int:
    """Execute the command of the only argument; return the exit code."""
    try:
        return done(json.loads(sys.argv[1]))
    except BrokenPipeError:  # the reader has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    raise SystemExit(main())
