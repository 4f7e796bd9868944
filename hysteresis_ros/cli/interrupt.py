"""How a command answers Ctrl-C; imports nothing, so that it is there from the first moment."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

#: Exit code after Ctrl-C, as shells have it.
INTERRUPTED = 128 + signal.SIGINT
#: The one line.
WORDS = "hysteresis: interrupted"


def leave_interrupted() -> NoReturn:
    """Say in one line that Ctrl-C ended the command, and leave with its exit code."""
    print(WORDS, file=sys.stderr)
    raise SystemExit(INTERRUPTED)
