# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Entry point of the executable ``hysteresis``: it handles Ctrl-C, also during the imports that follow."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any, NoReturn

from hysteresis_ros.cli.interrupt import INTERRUPTED, WORDS

#: Time after which a lost interrupt is repeated [s].
AGAIN = 0.05
#: Linear algebra uses one thread unless these variables are set. The arrays are small, and with several threads an
#: identification on a busy machine took three times as long (measured).
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def main() -> None:
    """Run the command, which ends with :class:`SystemExit`."""
    dropped: list[type] = []
    for name in ONE_THREAD:  # before NumPy is imported
        os.environ.setdefault(name, "1")

    def repeat_interrupt(unraisable: Any) -> None:
        """Repeat an interrupt that was lost because Python could not raise it (in a callback or a finalizer)."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)
            return
        dropped.append(unraisable.exc_type)
        repeat = threading.Timer(AGAIN, os.kill, (os.getpid(), signal.SIGINT))
        repeat.daemon = True
        repeat.start()

    sys.unraisablehook = repeat_interrupt
    try:
        from hysteresis_ros.cli.main import main as command

        command(prog_name="hysteresis")
    except (KeyboardInterrupt, Exception) as error:
        # if an interrupt was lost in a callback of the compiler, the compiler fails with another error
        if not dropped and not isinstance(error, KeyboardInterrupt):
            raise
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print(WORDS, file=sys.stderr)
        _leave_at_once()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _leave_at_once()
        raise
    finally:
        # while the interpreter shuts down, an interrupt would only print a traceback
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _leave_at_once() -> NoReturn:
    """Exit immediately with the exit code of Ctrl-C; during a normal exit, the signal could end Python first."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
