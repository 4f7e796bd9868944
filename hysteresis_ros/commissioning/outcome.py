# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a stage found: figures, sentences and pictures for a page, all of which JSON can hold."""

from __future__ import annotations

from dataclasses import dataclass, field

from hysteresis_ros.analysis.pictures import Line, Picture
from hysteresis_ros.errors import HysteresisError


class CommissioningError(HysteresisError):
    """Something looks wrong: nothing goes on before a person has looked."""

    exit_code = 2


@dataclass(frozen=True)
class Outcome:
    """What a stage found.

    Parameters
    ----------
    lines : list of str
        What a person is told.
    figures : dict
        By names with units.
    pictures : list of Picture
    seconds : float
        How long the axis was driven.
    """

    lines: list[str]
    figures: dict = field(default_factory=dict)
    pictures: list[Picture] = field(default_factory=list)
    seconds: float = 0.0

    @classmethod
    def from_mapping(cls, mapping: dict) -> Outcome:
        """Return the outcome that :func:`dataclasses.asdict` gave.

        Parameters
        ----------
        mapping : dict

        Raises
        ------
        TypeError, KeyError
            It is another mapping.
        """
        lines, figures, seconds = (mapping[name] for name in ("lines", "figures", "seconds"))
        if not (isinstance(lines, list) and isinstance(figures, dict) and isinstance(seconds, (int, float))):
            raise TypeError("an outcome with values of other types")
        pictures = [
            Picture(**{**picture, "lines": [Line(**line) for line in picture["lines"]]})
            for picture in mapping["pictures"]
        ]
        return cls(**{**mapping, "pictures": pictures})


def verdict(ratio: float, most: float) -> str:
    """Return in words whether something is as it was predicted.

    Parameters
    ----------
    ratio : float
        Found over predicted.
    most : float
        Up to which it is.
    """
    return "as predicted" if ratio <= most else f"MORE than {most:g} x the prediction"
