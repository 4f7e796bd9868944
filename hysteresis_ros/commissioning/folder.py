# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The folder of a commissioning: what was done, what it was done from, and everything that came out of it."""

from __future__ import annotations

import hashlib
import json
import pathlib
from collections.abc import Iterable
from dataclasses import asdict

from hysteresis_ros.bounded import read_json, read_text
from hysteresis_ros.commissioning.outcome import CommissioningError, Outcome
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.files import write_text
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run

#: Files in the folder: what it belongs to, the identified axis, the one with a controller, and that which also learns.
STATE, IDENTIFIED, COMMISSIONED, LEARNING = "state.json", "identified.yaml", "commissioned.yaml", "learning.yaml"


class Folder:
    """What is kept between the stages of a commissioning.

    Parameters
    ----------
    path : path-like
    text : str
        Text of the parameter file that is commissioned.
    bench : str
        Name of the bench.
    resumed : bool
        Go on with what is there; otherwise nothing may be there.

    Raises
    ------
    ConfigurationError
        Something is there already or cannot be made, or what is there belongs to another file or bench.
    """

    def __init__(self, path, text: str, bench: str, resumed: bool):
        self.path = pathlib.Path(path)
        self._own = {"file": hashlib.sha256(text.encode()).hexdigest(), "bench": bench}
        state = self.path / STATE
        if self.path.exists() and not resumed:
            raise ConfigurationError(
                f"{self.path}: exists already; go on with --resume, choose another --directory or remove it"
            )
        if resumed and not state.is_file():
            raise ConfigurationError(f"{self.path}: no commissioning to resume there; begin without --resume")
        if not resumed:
            try:
                self.path.mkdir(parents=True)
                self._write(STATE, self._own)
            except OSError as error:
                raise ConfigurationError(f"{self.path}: cannot be made: {error.strerror}; choose another") from None
        self._require_same(state)

    def _require_same(self, state: pathlib.Path) -> None:
        kept = self._read(state)
        words = {
            "file": "the parameter file has changed since it began; begin anew in another --directory",
            "bench": f"it began with {kept.get('bench')!r}, not {self._own['bench']!r}; give the same options",
        }
        for name, text in words.items():
            if kept.get(name) != self._own[name]:
                raise ConfigurationError(f"{self.path}: {text}")

    def _read(self, path: pathlib.Path) -> dict:
        try:
            found = read_json(read_text(path))
            if not isinstance(found, dict):
                raise ValueError("no mapping")
            return found
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{path}: cannot be read: {error}; begin anew in another --directory") from None

    def _write(self, name: str, content: dict) -> None:
        write_text(self.path / name, json.dumps(content, indent=1), ConfigurationError)

    def outcome(self, stage: str) -> Outcome | None:
        """Return what a stage found; None when it is not done.

        Parameters
        ----------
        stage : str

        Raises
        ------
        ConfigurationError
            What is kept cannot be read.
        """
        path = self.path / f"{stage}.json"
        try:
            return Outcome.from_mapping(self._read(path)) if path.exists() else None
        except (TypeError, KeyError):
            raise ConfigurationError(f"{path}: is no outcome; do the stage again: --stage {stage}") from None

    def keep(self, stage: str, outcome: Outcome) -> None:
        """Keep what a stage found: it is done.

        Parameters
        ----------
        stage : str
        outcome : Outcome
        """
        self._write(f"{stage}.json", asdict(outcome))

    def forget(self, stages: Iterable[str]) -> None:
        """Let stages count as not done.

        Parameters
        ----------
        stages : iterable of str
        """
        for stage in stages:
            (self.path / f"{stage}.json").unlink(missing_ok=True)

    def record(self, stage: str, recording: Recording) -> None:
        """Keep the recording of a stage.

        Parameters
        ----------
        stage : str
        recording : Recording
        """
        save_run(recording, self.path / f"{stage}.npz")

    def recording(self, stage: str) -> Recording:
        """Return the recording of a stage that is done.

        Parameters
        ----------
        stage : str

        Raises
        ------
        CommissioningError
            It is gone.
        """
        path = self.path / f"{stage}.npz"
        if not path.exists():
            raise CommissioningError(f"{path}: is gone; do the stage again: --stage {stage}")
        return load_run(path)
