"""Lines that say what a long command does, one at least every so many seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

import click

#: Longest silence of a command that people watch [s].
SILENCE = 1.5


class Progress:
    """Says what is going on, and that it still does, on terminals, in files and through pipes alike.

    Parameters
    ----------
    err : bool
        Say it on stderr: stdout is for results.
    silence : float
        Longest silence [s].
    """

    def __init__(self, err: bool = False, silence: float = SILENCE):
        self._err, self._silence = err, silence
        self._last = time.monotonic()
        self._lock = threading.Lock()

    def say(self, text: str) -> None:
        """Print a line."""
        with self._lock:
            click.echo(text, err=self._err)
            self._last = time.monotonic()

    @contextlib.contextmanager
    def during(self, what: str, state: Callable[[], str] = str) -> Iterator[None]:
        """Print that something lasts, how long it has and its state, whenever nothing was said for a while."""
        begun, over = time.monotonic(), threading.Event()

        def tell():
            while not over.wait(max(self._last + self._silence - time.monotonic(), 0.05)):
                if time.monotonic() - self._last >= self._silence:
                    self.say("  … " + ", ".join(filter(None, (f"{what}: {time.monotonic() - begun:.0f} s", state()))))

        thread = threading.Thread(target=tell, name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
