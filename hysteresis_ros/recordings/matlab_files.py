# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""MATLAB files: every vector in them, also of structures and of the columns of matrices, under a name of its own."""

from __future__ import annotations

import io
import pathlib

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.matlab_elements import is_hdf5, require_sound


def read_matlab(path: pathlib.Path) -> dict[str, np.ndarray]:
    """Return the vectors of a ``.mat`` file of the most frequent length.

    Parameters
    ----------
    path : Path
        Level 4 or 5; since 7.3 MATLAB writes HDF5, which is refused.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        ``name``, ``structure.field``, or ``name_1``, ``name_2`` … for the columns of a matrix.

    Raises
    ------
    RecordingError
        The file cannot be read, or holds no vectors.
    """
    import scipy.io  # a tenth of a second, which only those pay who open such a file

    try:
        data = path.read_bytes()
        if is_hdf5(data):
            raise RecordingError(f"{path}: a MATLAB file of version 7.3; save it with save(…, '-v7')")
        require_sound(data)
        content = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except RecordingError:
        raise
    except Exception as error:  # SciPy raises whatever damaged bytes lead to
        raise RecordingError(f"{path}: not a readable MATLAB file: {error or type(error).__name__}") from None
    vectors = dict(_vectors("", {name: value for name, value in content.items() if not name.startswith("__")}))
    sizes = [values.size for values in vectors.values()]
    if not sizes:
        raise RecordingError(f"{path}: holds no vectors of numbers")
    size = max(set(sizes), key=lambda length: (sizes.count(length), length))
    return {name: values for name, values in vectors.items() if values.size == size}


def _vectors(name, value):
    """Yield name and values of every vector within ``value``."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _vectors(f"{name}.{key}" if name else key, part)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.size < 2 or array.ndim > 2:
        return
    array = np.squeeze(array).astype(float)
    if array.ndim == 1:
        yield name, array
        return
    table = array if array.shape[0] >= array.shape[1] else array.T
    for k in range(table.shape[1]):
        yield f"{name}_{k + 1}", np.ascontiguousarray(table[:, k])
