# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""File: samples from CSV, NPZ or NPY."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import kernel
from hysteresis_ros.parameters import Parameters, parameter
from hysteresis_ros.references.cycle import COUNTER, END, FINAL, OFFSET, OWN
from hysteresis_ros.references.declaration import PREFIX, Packed, WaveformShape, head
from hysteresis_ros.references.samples import read_samples

COUNT, REPEAT, TABLE = OWN, OWN + 1, OWN + 2  # entries, samples after which it repeats, samples


@dataclass(frozen=True)
class FileParameters(Parameters):
    """Samples from CSV, NPZ or NPY, repeated every cycle."""

    path: str = parameter(
        description="CSV (header names units), NPZ or NPY file",
        place="files",
    )
    column: str = parameter("reference", description="column of the CSV (without unit) or array of the NPZ")
    sample_time: float = parameter(
        0.0,
        description="sample time of the file, interpolated linearly; 0 = must be the generator's",
        unit="s",
        low=0.0,
    )


@kernel
def file(p, x, u):
    """Samples of a table, repeated."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[TABLE + int(k % p[REPEAT])]


def pack(parameters, sample_time: float) -> Packed:
    """Return the samples of the file.

    Parameters
    ----------
    parameters : WaveformParameters
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        The file is missing or does not fit.
    """
    own, p = parameters.file, head(parameters)
    table = read_samples(own.path, own.column, own.sample_time, sample_time, f"{PREFIX}file.")
    p[END] = parameters.cycles * table.size
    p[FINAL] = parameters.offset + table[-1]
    return Packed(
        np.concatenate([p, [table.size, table.size], table]),
        file,
        parameters.offset + float(np.min(table)),
        parameters.offset + float(np.max(table)),
        None if parameters.cycles else table.size,
    )


WAVEFORM = WaveformShape(
    name="file",
    pack=pack,
    parameters=FileParameters,
    takes_frequency=False,
    takes_phase=False,
    extent="file.path",
)
