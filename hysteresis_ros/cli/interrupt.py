# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Handling of Ctrl-C by a command; imports only the standard library, so that it is available from the start."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

#: Exit code after Ctrl-C, as in shells.
INTERRUPTED = 128 + signal.SIGINT
#: Message after Ctrl-C.
WORDS = "hysteresis: interrupted"


def leave_interrupted() -> NoReturn:
    """Print that Ctrl-C has ended the command, and exit with the code of Ctrl-C."""
    print(WORDS, file=sys.stderr)
    raise SystemExit(INTERRUPTED)
