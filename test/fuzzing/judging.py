# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The required result of every input: a valid object or the project's own error, soon, with little memory."""

from __future__ import annotations

import contextlib
import resource
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

from mutations import LARGEST, mutated_bytes

from hysteresis_ros.errors import HysteresisError

#: Processor time that one input may take [s], and memory that it may take in addition to that of the process [bytes].
LONGEST, MEMORY = 5.0, 1 << 30
#: Longest error message, with its mark of omission: one line, for any content of the file.
LONGEST_MESSAGE = 4010


@dataclass(frozen=True)
class Target:
    """A reader, its valid inputs, and the generation of other inputs from these.

    Parameters
    ----------
    name : str
    read : callable
        ``read(data, folder)`` reads bytes, from a file in the folder where files are read.
    seeds : callable
        Returns small valid inputs.
    mutate : callable
        ``mutate(random, seed, seeds, words)`` returns an input.
    words : tuple of str
        Words with a meaning for this reader.
    suite : int
        Number of inputs in the tests; ``run.py`` takes more.
    refusals : tuple of type
        Errors that are valid answers. They name the file if there is one.
    file : str
        Name of the file that is written and read; empty without a file.
    """

    name: str
    read: Callable[[bytes, Path], object]
    seeds: Callable[[], list[bytes]]
    mutate: Callable[..., bytes] = mutated_bytes
    words: tuple[str, ...] = ()
    suite: int = 1_000
    refusals: tuple[type[Exception], ...] = (HysteresisError,)
    file: str = ""

    def inputs(self, first: int, count: int, seed: int = 0) -> Iterator[bytes]:
        """Yield the inputs with these numbers; the first numbers are the valid inputs themselves."""
        seeds = self.seeds()
        for number in range(first, first + count):
            if number < len(seeds):
                yield seeds[number]
            else:
                random = Random((seed << 40) | number)
                data = self.mutate(random, random.choice(seeds), seeds, self.words)
                yield data if len(data) <= 2 * LARGEST else random.choice(seeds)


class Hang(BaseException):
    """An input took too long; a reader that catches all exceptions of a damaged file must not catch this one."""


class Fault(AssertionError):
    """A forbidden result of an input.

    Parameters
    ----------
    target : Target
    kind : str
        Common description of faults with the same cause.
    text : str, optional
        Further information.
    """

    def __init__(self, target: Target, kind: str, text: str = ""):
        super().__init__(f"{target.name}: {kind}\n{text}")
        self.kind = kind


def judged(target: Target, data: bytes, folder: Path) -> bool:
    """Give an input to a reader; return True if it was accepted, False if it was refused.

    Raises
    ------
    Fault
        Any other result.
    """
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        target.read(data, folder)
        taken = True
    except target.refusals as error:
        _require_message(str(error), target)
        taken = False
    except Hang:
        raise Fault(target, f"longer than {LONGEST:g} s") from None
    except Exception as error:
        raise Fault(target, _kind(error), "".join(traceback.format_exception(error))[-3000:]) from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    left = {path.name for path in folder.iterdir()} - {target.file}
    if left:
        raise Fault(target, f"left {', '.join(sorted(left))} behind")
    return taken


def _require_message(text: str, target: Target) -> None:
    if not text.strip() or len(text) > LONGEST_MESSAGE or not text.isprintable():
        raise Fault(target, "a message that is empty, too long or no line", f"{len(text)} characters: {text[:300]!r}")
    if target.file and target.file.partition("/")[0] not in text:
        raise Fault(target, "a message that does not name the file", text)


def _kind(error: Exception) -> str:
    """Return the name of an error and the last place in the package that it passed through."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "hysteresis_ros" in frame.filename]
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "outside"
    return f"{type(error).__name__} at {place}"


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Limit time and memory of readers within the context; warnings are ignored."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, _stop)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


def _stop(number, frame):
    raise Hang
