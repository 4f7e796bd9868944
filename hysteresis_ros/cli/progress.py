"""Lines that say what a long command does, one at least every two seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

import click

#: Longest silence [s].
SILENCE = 1.5


class Progress:
    """Says what is going on, and that it still does."""

    def __init__(self):
        self._last = time.monotonic()
        self._lock = threading.Lock()

    def say(self, text: str) -> None:
        """Print a line."""
        with self._lock:
            click.echo(text)
            self._last = time.monotonic()

    @contextlib.contextmanager
    def during(self, what: str) -> Iterator[None]:
        """Print that something lasts, and how long it has, whenever nothing was said for a while."""
        begun, over = time.monotonic(), threading.Event()

        def tell():
            while not over.wait(max(self._last + SILENCE - time.monotonic(), 0.05)):
                if time.monotonic() - self._last >= SILENCE:
                    self.say(f"  … {what}: {time.monotonic() - begun:.0f} s")

        thread = threading.Thread(target=tell, name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
