# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a sweep has done so far, in a file to which each job adds a line: whatever ends the sweep, nothing is lost.

The first line says what sweep it is, each further one holds some runs. Numbers are written such that they are read
as the same doubles. A line that was cut off is left out, and its runs are made again.
"""

from __future__ import annotations

import fcntl
import json
import os
import pathlib
from typing import Any

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.sweeps.study import Runs

#: Added to the name of the results.
SUFFIX = ".part"
#: What a first line begins with.
KIND = "hysteresis sweep 1"


class Journal:
    """The file of a sweep that is not finished.

    Parameters
    ----------
    path : path-like
        Of the results; the journal stands beside them.
    about : dict
        What sweep it is.

    Attributes
    ----------
    found : list of Runs
        What stands in it already.

    Raises
    ------
    ConfigurationError
        It is of another sweep, in use, no journal, or cannot be written.
    """

    def __init__(self, path, about: dict[str, Any]):
        self.path = pathlib.Path(f"{path}{SUFFIX}")
        try:
            self._file = open(self.path, "a+b", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise ConfigurationError(f"{self.path}: cannot be written: {error.strerror}; choose another -o") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise ConfigurationError(f"{self.path}: another sweep writes there; choose another -o, or wait") from None
        try:
            self.found = self._read(about)
        except BaseException:
            self._file.close()
            raise

    def _read(self, about: dict[str, Any]) -> list[Runs]:
        self._file.seek(0)
        whole, _, cut = self._file.read().rpartition(b"\n")
        size = len(whole) + 1 if whole else 0
        if cut:
            if not whole and not (KIND.encode() in cut or len(cut) < len(KIND) + 2):
                raise ConfigurationError(f"{self.path}: is no journal of a sweep; remove it, or choose another -o")
            self._file.truncate(size)
        if not whole:
            self._write({"kind": KIND, **about})
            return []
        try:
            first, *lines = (json.loads(line) for line in whole.split(b"\n"))
            if first.pop("kind") != KIND:
                raise ValueError
            found = [
                Runs(line["first"], line["rows"], {int(number): why for number, why in line["refused"].items()})
                for line in lines
            ]
        except (ValueError, KeyError, TypeError, AttributeError):
            raise ConfigurationError(
                f"{self.path}: is no journal of a sweep; remove it, or choose another -o"
            ) from None
        require_same(self.path, first, about)
        return found

    def add(self, runs: Runs) -> None:
        """Add some runs.

        Parameters
        ----------
        runs : Runs

        Raises
        ------
        ConfigurationError
            It cannot be written; what stands in it stays.
        """
        self._write(runs._asdict())

    def _write(self, content: dict[str, Any]) -> None:
        line, begin = json.dumps(content).encode() + b"\n", os.fstat(self._file.fileno()).st_size
        try:
            written = 0
            while written < len(line):
                written += self._file.write(line[written:])
        except OSError as error:
            self._file.truncate(begin)
            raise ConfigurationError(
                f"{self.path}: cannot be written: {error.strerror}; what was done so far is kept there: make room, and "
                "give the same command again"
            ) from None

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def remove(self) -> None:
        """Remove the file: the results stand elsewhere."""
        self.path.unlink(missing_ok=True)
        self.close()


def require_same(path, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Refuse a file of another sweep.

    Parameters
    ----------
    path : path-like
    found, asked : dict
        What sweep it is, and what is asked for; how many runs may differ where a longer sweep begins with the shorter.

    Raises
    ------
    ConfigurationError
        Names what differs first.
    """
    for name, value in asked.items():
        if found.get(name) != value:
            here, there = (str(text) if len(str(text)) < 100 else "another" for text in (value, found.get(name)))
            raise ConfigurationError(
                f"{path}: holds another sweep, {name}: {there} there, {here} asked; choose another -o, or remove it"
            )
