# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Measured frequency responses as files: NPZ, which comes back whole, and CSV and YAML for other programs."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np

from hysteresis_ros.archives import ArchiveError, read_arrays, read_heads
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.files import replacing
from hysteresis_ros.identification.distortion import Distortion
from hysteresis_ros.identification.excitations import KINDS
from hysteresis_ros.identification.frequency_response import FrequencyResponse
from hysteresis_ros.identification.response_analysis import Analysis
from hysteresis_ros.units import UNITS

#: Probability of the circles in tables.
PROBABILITY = 0.95
#: What an NPZ holds, besides the arrays that are not known.
NEEDED = ("frequency", "response", "sample_time", "input_unit", "output_unit", "kind")
SPREADS = ("total_variance", "noise_variance", "coherence", "degrees")
LEVELS = ("noise", "odd", "even")


def require_response_file(path) -> None:
    """Refuse a file that no response can be written to, before anything moves.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    RecordingError
        The suffix is another, or there is no such folder.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() not in WRITERS:
        raise RecordingError(f"{path}: unknown kind of file '{path.suffix}'; write .npz, .csv or .yaml")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{path}: cannot be written: there is no such folder; choose another place")


def save_response(path, found: Analysis, columns: dict[str, np.ndarray], figures: dict) -> None:
    """Write a response; the suffix decides how.

    Parameters
    ----------
    path : path-like
        ``.npz``, ``.csv`` or ``.yaml``.
    found : Analysis
    columns : dict of str to ndarray of shape (F,)
        What else was found at its lines, for tables.
    figures : dict
        Figures by names with units, for YAML.

    Raises
    ------
    RecordingError
        The suffix is another, or the file cannot be written.
    """
    require_response_file(path)
    write = WRITERS[pathlib.Path(path).suffix.lower()]
    with replacing(path, RecordingError) as beside, beside.open("wb") as stream:
        write(stream, found, columns, figures)


def load_response(path) -> Analysis:
    """Return the response of an NPZ file that :func:`save_response` wrote.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    RecordingError
        The file is missing, or holds no response.
    """
    path = pathlib.Path(path)
    try:
        return _response_of(read_arrays(path))
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; give the NPZ file that hysteresis frf wrote") from None
    except (OSError, ValueError, KeyError):
        raise RecordingError(
            f"{path}: holds no frequency response; give the NPZ file that hysteresis frf wrote"
        ) from None


def _response_of(held: dict[str, np.ndarray]) -> Analysis:
    """Return the response that arrays hold; ValueError or KeyError when they hold none."""
    frequency, sample_time = _real(held, "frequency"), _real(held, "sample_time")
    input_unit, output_unit, kind = (str(held[name]) for name in ("input_unit", "output_unit", "kind"))
    if not frequency.size or np.any(np.diff(frequency) <= 0.0) or not (sample_time.size == 1 and sample_time[0] > 0.0):
        raise ValueError("no frequencies or no sample time")
    if not {input_unit, output_unit} <= {unit for unit, _ in UNITS.values()} or kind not in KINDS:
        raise ValueError("unknown units or kind")
    values = np.asarray(held["response"], dtype=complex).reshape(frequency.size, 1, 1)
    response = FrequencyResponse(
        frequency, values, float(sample_time[0]), input_unit=input_unit, output_unit=output_unit
    )
    shapes = {"total_variance": (-1, 1, 1), "noise_variance": (-1, 1, 1), "coherence": (-1, 1)}
    spreads = {name: _real(held, name, frequency.size).reshape(shape) for name, shape in shapes.items() if name in held}
    degrees = float(_real(held, "degrees", 1)[0]) if "degrees" in held else None
    if degrees is not None and not (degrees > 0.0 and {"total_variance", "noise_variance"} & set(spreads)):
        raise ValueError("degrees of freedom of no variance")
    levels = [_real(held, name, frequency.size) for name in LEVELS] if all(name in held for name in LEVELS) else None
    return Analysis(replace(response, **spreads, degrees=degrees), levels and Distortion(*levels), kind)


def _real(held: dict[str, np.ndarray], name: str, size: int | None = None) -> np.ndarray:
    """Return an array of real numbers as a vector; ValueError when it is none, or has another size."""
    array = held[name]
    if (
        array.dtype.kind not in "iuf"
        or size not in (None, array.size)
        or (size is None and np.any(~np.isfinite(array)))
    ):
        raise ValueError(f"{name} is not what it should be")
    return np.asarray(array, dtype=float).ravel()


def holds_response(path) -> bool:
    """Tell whether a file is one that :func:`load_response` reads.

    Parameters
    ----------
    path : path-like
    """
    if pathlib.Path(path).suffix.lower() != ".npz":
        return False
    try:
        return set(NEEDED) <= set(read_heads(path))
    except (OSError, ArchiveError):
        return False


def response_columns(found: Analysis) -> dict[str, np.ndarray]:
    """Return what a table has of a response, by names with units.

    Parameters
    ----------
    found : Analysis
    """
    response = found.response
    unit = f"{response.output_unit}/{response.input_unit}"
    columns = {
        "frequency [Hz]": response.frequency,
        f"magnitude [{unit}]": np.abs(response.single),
        "phase [deg]": np.degrees(np.unwrap(np.angle(response.single))),
    }
    if response.degrees is not None:
        columns[f"radius_{100 * PROBABILITY:g}_percent [{unit}]"] = response.radius(PROBABILITY)[:, 0, 0]
    if found.distortion is not None:
        columns |= {f"{name} [{unit}]": getattr(found.distortion, name) for name in LEVELS}
    if response.coherence is not None:
        columns["coherence [1]"] = response.coherence[:, 0]
    return columns


def _npz(stream, found: Analysis, columns, figures) -> None:
    response = found.response
    arrays = {"kind": np.array(found.kind), "response": response.single}
    arrays |= {name: np.asarray(getattr(response, name)) for name in NEEDED if name not in arrays}
    for name in SPREADS:
        value = getattr(response, name)
        if value is not None:
            arrays[name] = np.squeeze(value) if name != "degrees" else np.array(value)
    if found.distortion is not None:
        arrays |= {name: getattr(found.distortion, name) for name in LEVELS}
    arrays |= {name.split(" ")[0]: values for name, values in columns.items()}
    np.savez(stream, **arrays)


def _csv(stream, found: Analysis, columns, figures) -> None:
    table = response_columns(found) | columns
    stream.write((",".join(table) + "\n").encode())
    np.savetxt(stream, np.column_stack(list(table.values())), delimiter=",", fmt="%.9g")


def _yaml(stream, found: Analysis, columns, figures) -> None:
    import yaml

    table = {name: [float(f"{value:.6g}") for value in values] for name, values in response_columns(found).items()}
    text = yaml.safe_dump({"figures": figures, "lines": table}, sort_keys=False, allow_unicode=True, width=120)
    stream.write(text.encode())


#: How each kind of file is written.
WRITERS = {".npz": _npz, ".csv": _csv, ".yaml": _yaml}
