# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a sweep has found: a table of its runs, in a file that says which sweep it was."""

from __future__ import annotations

import json
import pathlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from hysteresis_ros.archives import read_arrays
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.files import replacing

PARQUET, NPZ = ".parquet", ".npz"
#: Name of the text in a file that says which sweep it was.
ABOUT = "hysteresis_sweep"
EXTRA = 'needs the extra: pip install "hysteresis_ros[sweep]"'


@dataclass(frozen=True, eq=False)
class Results:
    """The runs of a sweep.

    Parameters
    ----------
    about : dict
        What sweep it was: configuration, variations, seed, design, metrics, version.
    parameters : dict of str to ndarray, shape (runs,)
        What each run stood for, by labels.
    metrics : dict of str to ndarray, shape (runs,)
        In SI; NaN where a metric has no meaning.
    tripped : ndarray of bool, shape (runs,)
        Whether the axis stopped itself.
    refused : ndarray of str, shape (runs,)
        Why an axis could not be built; empty: it was.
    """

    about: dict[str, Any]
    parameters: dict[str, np.ndarray]
    metrics: dict[str, np.ndarray]
    tripped: np.ndarray
    refused: np.ndarray

    def __len__(self) -> int:
        """Return how many runs there are."""
        return len(self.tripped)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns of the table, by name."""
        own = {"run": np.arange(len(self)), "tripped": self.tripped, "refused": self.refused}
        return {"run": own.pop("run"), **self.parameters, **self.metrics, **own}

    @property
    def good(self) -> np.ndarray:
        """Whether each run came to its end, shape (runs,)."""
        return ~self.tripped & (self.refused == "")


def require_kind(path) -> None:
    """Refuse a file that results cannot be written to, before they are made.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    ConfigurationError
        Its ending is neither ``.parquet`` nor ``.npz``, or what writes it is not installed.
    """
    suffix = pathlib.Path(path).suffix
    if suffix not in (PARQUET, NPZ):
        raise ConfigurationError(f"{path}: results are written as F.parquet or F.npz; choose one of them")
    if suffix == PARQUET:
        try:
            import pyarrow  # noqa: F401
        except ImportError:
            raise ConfigurationError(f"{path}: Parquet {EXTRA}; or choose F.npz") from None


def save(results: Results, path) -> None:
    """Write results, whole or not at all.

    Parameters
    ----------
    results : Results
    path : path-like
        ``.parquet`` or ``.npz``.

    Raises
    ------
    ConfigurationError
        It cannot be written.
    """
    path = pathlib.Path(path)
    text = json.dumps(results.about)
    remedy = "all runs are kept in its journal: make room, and give the same command again"
    with replacing(path, ConfigurationError, remedy) as beside, beside.open("wb") as stream:
        if path.suffix == NPZ:
            arrays: dict[str, Any] = {ABOUT: np.array(text), **results.columns}
            np.savez(stream, **arrays)
        else:
            import pyarrow
            import pyarrow.parquet

            table = pyarrow.table(results.columns).replace_schema_metadata({ABOUT: text})
            pyarrow.parquet.write_table(table, stream)


def load(path) -> Results:
    """Read results.

    Parameters
    ----------
    path : path-like
        ``.parquet`` or ``.npz``.

    Raises
    ------
    ConfigurationError
        It cannot be read, or holds no results of a sweep.
    """
    require_kind(path)
    try:
        columns, text = (_npz if pathlib.Path(path).suffix == NPZ else _parquet)(path)
        about = json.loads(text)
        parameters = {name: columns[name] for name in about["labels"]}
        metrics = {name: columns[name] for name in about["metrics"]}
        return Results(about, parameters, metrics, columns["tripped"].astype(bool), columns["refused"].astype(str))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: holds no results of a sweep ({error}); choose another -o") from None


def _npz(path) -> tuple[dict[str, np.ndarray], str]:
    columns = read_arrays(path)
    return columns, str(columns.pop(ABOUT))


def _parquet(path) -> tuple[dict[str, np.ndarray], str]:
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    text = (table.schema.metadata or {})[ABOUT.encode()].decode()
    return {name: table[name].to_numpy() for name in table.column_names}, text
