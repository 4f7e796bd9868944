# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Progress of a long command: a bar on terminals, elsewhere lines at growing intervals."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import click

#: Maximum interval of progress messages on a terminal [s].
SILENCE = 1.5
#: Maximum interval of progress messages in files and pipes [s]; the interval doubles until it reaches this value.
LONGEST_SILENCE = 60.0
#: Time after which a bar is shown [s].
SHORT = 0.5
#: Update interval of a bar [s].
LOOK = 0.1


def _bar(err: bool) -> Any:
    """Return a bar for a terminal; None if there is no terminal or the library is not installed."""
    if not (sys.stderr if err else sys.stdout).isatty():
        return None
    try:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    except ImportError:
        return None
    words = (TextColumn(text, markup=False) for text in ("  ", "{task.description}", "{task.fields[state]}"))
    indent, what, state = words
    columns = (indent, SpinnerColumn(), what, BarColumn(), TimeElapsedColumn(), state)
    return Progress(*columns, console=Console(stderr=err), transient=True)


def shown(what: str) -> contextlib.AbstractContextManager[None]:
    """Show a bar, on terminals only, during an operation that is usually short; callers print results afterwards."""
    return Progress(err=True, bars_only=True).during(what)


class Progress:
    """Reports an operation and its progress on terminals, in files and through pipes."""

    def __init__(self, err: bool = False, silence: float = SILENCE, bars_only: bool = False, steady: bool = False):
        self._err, self._silence, self._bars_only, self._steady = err, silence, bars_only, steady
        self._last = time.monotonic()
        self._lock = threading.Lock()
        self._bar: Any = None
        self._paused = False

    def say(self, text: str) -> None:
        """Print a line."""
        with self._lock:
            if self._bar is not None:
                self._bar.console.print(text, markup=False, highlight=False)
            else:
                click.echo(text, err=self._err)
            self._last = time.monotonic()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Hide the bar while the user is asked."""
        with self._lock:
            self._paused = True
            if self._bar is not None:
                self._bar.stop()
        try:
            yield
        finally:
            with self._lock:
                self._paused = False
                self._last = time.monotonic()
                if self._bar is not None:
                    self._bar.start()

    @contextlib.contextmanager
    def during(
        self, what: str, state: Callable[[], str] = str, part: Callable[[], float | None] = lambda: None
    ) -> Iterator[None]:
        """Show an operation with its elapsed time and state."""
        over = threading.Event()
        thread = threading.Thread(target=self._tell, args=(what, state, part, over), name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def _tell(self, what: str, state, part, over: threading.Event) -> None:
        begun = time.monotonic()
        while over.wait(SHORT) or self._paused:
            if over.is_set():
                return
        bar = _bar(self._err)
        if bar is not None:
            self._show(bar, what, state, part, over)
        if bar is not None or self._bars_only:
            return
        silence = self._silence
        while not over.wait(max(self._last + silence - time.monotonic(), 0.05)):
            if time.monotonic() - self._last >= silence and not self._paused:
                done = part()
                share = "" if done is None else f"{100.0 * done:.0f} %"
                words = (f"{what}: {time.monotonic() - begun:.0f} s", share, state())
                self.say("  … " + ", ".join(filter(None, words)))
                silence = silence if self._steady else min(2.0 * silence, LONGEST_SILENCE)

    def _show(self, bar, what: str, state, part, over: threading.Event) -> None:
        """Update a bar, and remove it at the end."""
        with bar:
            task = bar.add_task(what, total=None, state=state())
            with self._lock:
                self._bar = bar
            try:
                while not over.wait(LOOK):
                    done = part()
                    bar.update(task, total=None if done is None else 1.0, completed=done or 0.0, state=state())
            finally:
                with self._lock:
                    self._bar = None
