# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an axis has learned, as a file: the correction of one period and the reference it belongs to."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import numpy as np
import yaml

from hysteresis_ros.bounded import BoundsError, read_text, read_yaml
from hysteresis_ros.control.learning.parameters import LONGEST, period_samples
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.files import write_text

#: First key of such a file.
KIND = "learned_correction"
#: Most values of such a file beside the two arrays.
HEAD = 20


@dataclass(frozen=True, eq=False)
class Learned:
    """The correction of one period.

    Parameters
    ----------
    period, sample_time : float
        [s]
    correction, reference : ndarray, shape (N,)
        What is added to the reference, and the reference, from the beginning of the period on [m].
    """

    period: float
    sample_time: float
    correction: np.ndarray
    reference: np.ndarray

    def require(self, period: float, sample_time: float, maximum: float) -> None:
        """Refuse it for an axis that it was not learned on.

        Parameters
        ----------
        period, sample_time : float
            Of the axis [s].
        maximum : float
            Largest correction that the axis allows [m].

        Raises
        ------
        ParameterError
            Period or sample time differ, or it is larger than allowed.
        """
        wanted = period_samples(period, 1.0 / sample_time)
        if len(self.correction) != wanted or abs(self.sample_time - sample_time) > 1e-6 * sample_time:
            have = f"{len(self.correction)} samples of {self.sample_time:g} s"
            allowed = (
                f"holds {have}; the axis has {wanted} of {sample_time:g} s: learn anew, or give the axis of the file"
            )
            raise ParameterError([Problem("learning.file", f"period {self.period:g} s", allowed)])
        largest = float(np.max(np.abs(self.correction)))
        if largest > maximum:
            allowed = f"must be at most learning.maximum = {maximum:g} m"
            raise ParameterError([Problem("learning.file", f"a correction of {largest:g} m", allowed)])


def write_learned(path, learned: Learned, configuration: str = "") -> None:
    """Write what was learned; an existing file is replaced as a whole.

    Parameters
    ----------
    path : path-like
    learned : Learned
    configuration : str
        Name of the configuration of the axis.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    values = {
        KIND: {
            "configuration": configuration,
            "period": learned.period,
            "sample_time": learned.sample_time,
            "correction": learned.correction.tolist(),
            "reference": learned.reference.tolist(),
        }
    }
    text = "# What an axis has learned over periods of its reference; learning.file of motion_controller loads it.\n"
    text += (
        "# period and sample_time [s]; correction and reference [m], sample by sample from the period's beginning.\n"
    )
    text += yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120)
    write_text(pathlib.Path(path).expanduser(), text, ConfigurationError)


def read_learned(path) -> Learned:
    """Return what a file says was learned.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    ParameterError
        There is no such file, or it is no file of a learned correction.
    """

    def refused(text):
        return ParameterError([Problem("learning.file", str(path), text)])

    try:
        found = read_yaml(read_text(path), most=2 * LONGEST + HEAD)[KIND]
        arrays = [np.array(found[name], dtype=float) for name in ("correction", "reference")]
        period, sample_time = float(found["period"]), float(found["sample_time"])
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror or error}") from None
    except (BoundsError, KeyError, TypeError, ValueError, OverflowError, UnicodeDecodeError):
        raise refused("is no file of a learned correction, as `save` of motion_controller writes it") from None
    sizes = {len(array) for array in arrays if array.ndim == 1 and np.all(np.isfinite(array))}
    if len(sizes) != 1 or any(array.ndim != 1 or not np.all(np.isfinite(array)) for array in arrays):
        raise refused("correction and reference must be as many finite numbers")
    if not (0.0 < period < np.inf and 0.0 < sample_time < np.inf):
        raise refused(f"period {period:g} s and sample_time {sample_time:g} s must be above 0")
    return Learned(period, sample_time, *arrays)
