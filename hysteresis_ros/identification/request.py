# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What an identification is asked for, and what a fit of a hysteresis gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from hysteresis_ros.models.hysteresis import HysteresisParameters
from hysteresis_ros.units import readable


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Parameters
    ----------
    model : str
    parts : tuple of str
        Of ``lag``, ``delay``, ``creep``: what may stand behind the hysteresis.
    stage : str or None
        Dynamics of higher order instead.
    options : dict
        Of the model.
    inverse : str
        Type of the compensator's inverse.
    skip : int or None
        First samples left out of the error; None: those before the past is wiped out.
    intersample : str
    initial : str or None
    progress : callable
        ``progress(number, text)``.
    separations : dict
        What :func:`.separation.separated` found in this data before, by what was asked for.
    """

    model: str
    parts: tuple[str, ...]
    stage: str | None
    options: dict
    inverse: str
    skip: int | None
    intersample: str
    initial: str | None
    progress: Callable[[int, str], None]
    separations: dict = field(default_factory=dict)

    def report_residual(self, number: int, rmse: float) -> None:
        """Progress of fits that report a residual [m]."""
        self.progress(number, f"residual {readable(rmse, 'm')}")


@dataclass(frozen=True)
class FittedHysteresis:
    """A hysteresis as it was fitted.

    Parameters
    ----------
    hysteresis : HysteresisParameters
    fitted : int
        How many of its numbers were fitted.
    deviations : dict of str to float
        Their standard deviations, where known.
    warnings : tuple of str
    converged : bool
    """

    hysteresis: HysteresisParameters
    fitted: int
    deviations: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    converged: bool = True
