# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an inchworm motor has learned of its walk, as a file."""

from __future__ import annotations

import pathlib
from typing import NamedTuple

import numpy as np
import yaml

from hysteresis_ros.bounded import BoundsError, read_text, read_yaml
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.files import write_text

#: First key of such a file.
KIND = "inchworm_walk"
_HEADER = """\
# The correction of an inchworm's walk over the phase of its cycle; walk.file of inchworm_sequencer loads it.
# step [m]; coefficients [m] of a periodic cubic spline, forward and backward.
"""


class LearnedWalk(NamedTuple):
    """What was learned: the length of a cycle [m] and the coefficients of the correction [m], both shape (splines,)."""

    step: float
    forward: np.ndarray
    backward: np.ndarray


def write_walk(path, learned: LearnedWalk) -> None:
    """Write what was learned; an existing file is replaced as a whole.

    Parameters
    ----------
    path : path-like
    learned : LearnedWalk

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    values = {"step": learned.step, "forward": learned.forward.tolist(), "backward": learned.backward.tolist()}
    text = _HEADER + yaml.safe_dump({KIND: values}, sort_keys=False, default_flow_style=None, width=118)
    write_text(pathlib.Path(path).expanduser(), text, ConfigurationError)


def read_walk(path, splines: int, step: float, bound: float) -> LearnedWalk:
    """Return what a file says was learned.

    Parameters
    ----------
    path : path-like
    splines : int
        How many coefficients there are to be.
    step, bound : float
        Length of a cycle, and the largest coefficient [m].

    Raises
    ------
    ParameterError
        There is no such file, it is of something else, or does not fit.
    """

    def refused(text):
        return ParameterError([Problem("walk.file", str(path), text)])

    try:
        found = read_yaml(read_text(path))[KIND]
        arrays = [np.array(found[name], dtype=float) for name in ("forward", "backward")]
        learned = LearnedWalk(float(found["step"]), *arrays)
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror or error}") from None
    except (BoundsError, KeyError, TypeError, ValueError, OverflowError, UnicodeDecodeError):
        raise refused("is no file of a learned walk, as ~/save of inchworm_sequencer writes it") from None
    if learned.step != step:
        raise refused(f"was learned with steps of {learned.step:g} m; walk.step is {step:g} m: learn anew")
    for array in arrays:
        if array.shape != (splines,):
            raise refused(f"has {array.size} coefficients; walk.splines is {splines}: learn anew")
        if not np.all(np.abs(array) <= bound):
            raise refused(f"has a coefficient beyond walk.bound = {bound:g} m, or one that is not finite")
    return learned
