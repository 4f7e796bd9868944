# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a continuous transfer function is fitted with, and what comes out: structure, search, start, result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.identification.continuous import INTERSAMPLE, CanonicalSimulation, simulate_transfer_function
from hysteresis_ros.identification.state_space import FitError, LinearModel

#: Where the state of the model starts.
INITIAL = ("zero", "rest", "periodic", "estimate")


@dataclass(frozen=True)
class Structure:
    """What is fitted, and how it is simulated.

    Parameters
    ----------
    poles, zeros : int
        n ≥ 1 and m ≤ n.
    intersample : str
        ``zoh``, ``foh`` (or ``linear``) or ``bandlimited``.
    initial : str
        ``zero``, ``rest`` (under the first input), ``periodic`` (the data is whole periods) or ``estimate``.
    offset : bool
        Whether a constant is fitted too.
    delay : float
        Known dead time of the input [s].
    """

    poles: int = 2
    zeros: int = 0
    intersample: str = "zoh"
    initial: str = "zero"
    offset: bool = False
    delay: float = 0.0

    @property
    def columns(self) -> int:
        """How many numbers the output is linear in: numerator, offset, initial state."""
        return self.zeros + 1 + bool(self.offset) + (self.poles if self.initial == "estimate" else 0)

    def check(self) -> None:
        """Refuse what cannot be fitted.

        Raises
        ------
        FitError
            A choice is out of range.
        """
        if self.poles < 1 or not 0 <= self.zeros <= self.poles:
            raise FitError(
                f"poles = {self.poles}, zeros = {self.zeros}: there must be at least one pole and no more zeros than "
                "poles"
            )
        if self.intersample not in INTERSAMPLE:
            raise FitError(f"intersample = {self.intersample!r}: must be one of {', '.join(INTERSAMPLE)}")
        if self.initial not in INITIAL:
            raise FitError(f"initial = {self.initial!r}: must be one of {', '.join(INITIAL)}")


@dataclass(frozen=True)
class Search:
    """From where the poles are searched.

    Parameters
    ----------
    starts : int
        How many starts are followed: an ARX fit, the user's, and frequencies and dampings spread over the data's band.
    start_poles : array_like of complex, shape (n,), optional
        A start of the user's [rad/s].
    seed : int
        Of the random starts.
    """

    starts: int = 6
    start_poles: Sequence[complex] | np.ndarray | None = None
    seed: int = 0


@dataclass(frozen=True)
class Start:
    """One start of the search.

    Parameters
    ----------
    poles : tuple of complex
        [rad/s]
    first_rmse, rmse : float
        Before and after, in the output's unit.
    converged : bool
    """

    poles: tuple[complex, ...]
    first_rmse: float
    rmse: float
    converged: bool


@dataclass(frozen=True, eq=False)
class TransferFunctionFit:
    """A continuous transfer function from sampled data.

    Parameters
    ----------
    numerator : ndarray, shape (m + 1,)
        b_m … b_0, highest power first.
    denominator : ndarray, shape (n + 1,)
        1, a_(n-1) … a_0.
    covariance : ndarray, shape (m + 1 + n, m + 1 + n)
        Of b_m … b_0, a_(n-1) … a_0 for white residuals; NaN where the data does not tell them apart.
    offset : float
        Constant of the output, in its unit; 0 when it was not fitted.
    delay : float
        Dead time of the input [s], as given.
    predicted : ndarray, shape (N,)
        Simulated output.
    fit_percent : float
        [%]
    mse, fpe : float
        In the output's unit squared.
    sample_time : float
        Of the data [s].
    intersample : str
        How the input was taken to run between samples.
    starts : tuple of Start
        All starts of the search, best first.
    converged : bool
        Whether the best one converged.
    warnings : tuple of str
        Not converged, at a bound, non-minimum-phase, weakly determined.
    input_unit, output_unit : str
        SI units.
    """

    numerator: np.ndarray
    denominator: np.ndarray
    covariance: np.ndarray
    offset: float
    delay: float
    predicted: np.ndarray
    fit_percent: float
    mse: float
    fpe: float
    sample_time: float
    intersample: str
    starts: tuple[Start, ...]
    converged: bool
    warnings: tuple[str, ...]
    input_unit: str = "V"
    output_unit: str = "m"

    @property
    def poles(self) -> np.ndarray:
        """[rad/s], shape (n,)."""
        return np.roots(self.denominator)

    @property
    def zeros(self) -> np.ndarray:
        """[rad/s]."""
        return np.roots(self.numerator)

    @property
    def dc_gain(self) -> float:
        """b_0/a_0, output unit per input unit."""
        return float(self.numerator[-1] / self.denominator[-1])

    @property
    def standard_deviations(self) -> np.ndarray:
        """Of b_m … b_0, a_(n-1) … a_0."""
        return np.sqrt(np.diag(self.covariance))

    def simulate(self, u, sample_time: float | None = None, initial: str = "zero") -> np.ndarray:
        """Return the output for another input, without the offset, shape (N,).

        Parameters
        ----------
        u : array_like, shape (N,)
        sample_time : float, optional
            [s]; that of the fit by default.
        initial : str
            ``zero``, ``rest`` (at rest under the first input) or ``periodic``.
        """
        return simulate_transfer_function(
            self.numerator,
            self.denominator,
            u,
            sample_time or self.sample_time,
            self.intersample,
            initial,
            self.delay,
        )

    def discrete(self, sample_time: float | None = None) -> LinearModel:
        """Return the state space for an input held over each sample; the delay is not in it.

        Parameters
        ----------
        sample_time : float, optional
            [s]; that of the fit by default.
        """
        step = sample_time or self.sample_time
        return CanonicalSimulation(self.denominator, step, "zoh").model(
            self.numerator, self.input_unit, self.output_unit
        )
