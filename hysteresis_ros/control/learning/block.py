# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The learned correction of an axis as a block: its arrays, what people ask of it, and what it has learned."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hysteresis_ros.block import Block
from hysteresis_ros.control.learning import correction as at
from hysteresis_ros.control.learning.correction import learned_correction
from hysteresis_ros.control.learning.file import Learned, read_learned
from hysteresis_ros.control.learning.parameters import LearningParameters, period_samples
from hysteresis_ros.errors import ParameterError, Problem

#: Part of the error filter's weight that may meet samples from which nothing can be learned: the margin of contraction.
UNLEARNED = 0.1


class Learning(Block):
    """Correction of a periodic reference; without a type it has no arrays and is not worked.

    Parameters
    ----------
    parameters : LearningParameters
    sample_time : float
        [s]
    fade : float
        Time in which a correction comes or goes [s].

    Raises
    ------
    ParameterError
        The period is no whole number of samples, a filter looks ahead by a period, or the file does not fit.
    """

    kernel = staticmethod(learned_correction)

    def __init__(self, parameters: LearningParameters, sample_time: float, fade: float = 0.0):
        self._fade = fade
        self._loaded: Learned | None = None
        if parameters.in_use and parameters.file:
            self._loaded = read_learned(parameters.file)
            self._loaded.require(parameters.period, sample_time, parameters.maximum)
        super().__init__(parameters, sample_time)

    def pack(self, parameters: LearningParameters) -> np.ndarray:
        """Return the parameter array; empty where nothing is learned."""
        if not parameters.in_use:
            return np.zeros(0)
        period = period_samples(parameters.period, 1.0 / self.sample_time)
        half = len(parameters.robustness_filter) - 1
        for name, ahead in (("lead", parameters.lead), ("robustness_filter", half)):
            if ahead >= period:
                allowed = f"looks {ahead} samples ahead; must be less than the period of {period} samples"
                raise ParameterError([Problem(f"learning.{name}", getattr(parameters, name), allowed)])
        head = np.zeros(at.FILTERS)
        head[at.PERIOD], head[at.LEAD] = period, parameters.lead
        head[at.TAPS], head[at.HALF] = len(parameters.error_filter), half
        head[at.GAIN], head[at.LEAST_GAIN] = parameters.gain, parameters.least_gain
        head[at.AVERAGING], head[at.MAXIMUM] = parameters.averaging, parameters.maximum
        head[at.SHORTFALL] = parameters.shortfall
        head[at.RECOVERY] = round(parameters.recovery / self.sample_time)
        head[at.LATE_ANSWER] = round(parameters.late_answer / self.sample_time)
        head[at.MISSING] = UNLEARNED * sum(map(abs, parameters.error_filter))
        head[at.FADE] = 1.0 / max(round(self._fade / self.sample_time), 1)
        return np.concatenate([head, parameters.error_filter, parameters.robustness_filter])

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample: what the file says, or nothing."""
        if not len(self.p):
            return np.zeros(0)
        period, back = int(self.p[at.PERIOD]), int(self.p[at.TAPS] - 1 - self.p[at.LEAD])
        length = period + max(back, int(self.p[at.HALF])) + 1
        # before it begins the axis was at rest, without error; what was learned waits for the first period's
        rings = np.zeros((3, length))
        rings[2] = math.nan
        if self._loaded is not None:
            rings[1] = math.nan
            # the sample before the first one stands in the last place of a ring
            places = np.arange(-length, 0) % period
            rings[0], rings[2] = self._loaded.correction[places], self._loaded.reference[places]
        state = np.zeros(at.RINGS)
        state[at.MODE] = at.LEARNING if self.parameters.active else at.FROZEN
        state[at.WEIGHT] = 1.0
        return np.concatenate([state, rings.ravel()])

    def changed(self, parameters: LearningParameters, fade: float) -> Learning:
        """Return a block of other parameters, to be taken over by :meth:`take` once nothing can be refused any more.

        Parameters
        ----------
        parameters : LearningParameters
        fade : float
            Time in which a correction comes or goes [s].

        Raises
        ------
        ParameterError
            They are wrong, or of another structure.
        """
        for name in ("type", "period", "error_filter", "lead", "robustness_filter", "file"):
            value, present = getattr(parameters, name), getattr(self.parameters, name)
            if value != present:
                raise ParameterError([Problem(f"learning.{name}", value, "is fixed while running")])
        return Learning(replace(parameters, file=""), self.sample_time, fade)

    def take(self, other: Learning) -> None:
        """Go on with the parameters of another block of the same structure.

        Parameters
        ----------
        other : Learning
        """
        self.parameters = replace(other.parameters, file=self.parameters.file)
        self.p[:] = other.p

    def set_mode(self, mode: int) -> None:
        """Learn, repeat, or forget from the next sample on.

        Parameters
        ----------
        mode : int
            ``LEARNING``, ``FROZEN`` or ``FORGETTING``.

        Raises
        ------
        ParameterError
            There is no correction.
        """
        self._require_use()
        if mode == at.LEARNING:
            self.x[at.LEARNED] = 0.0
        self.x[at.MODE] = mode

    def _require_use(self) -> None:
        if not self.parameters.in_use:
            allowed = "nothing learns; let `hysteresis design --learning` write its filters"
            raise ParameterError([Problem("learning.type", self.parameters.type, allowed)])

    @property
    def mode(self) -> int:
        """``LEARNING``, ``FROZEN`` or ``FORGETTING``; frozen where there is no correction."""
        return int(self.x[at.MODE]) if len(self.x) else at.FROZEN

    @property
    def missed(self) -> int:
        """Samples of the last period from which nothing could be learned."""
        return int(np.count_nonzero(~np.isfinite(self._last_period(self.x, 1)))) if len(self.x) else 0

    @property
    def at_maximum(self) -> bool:
        """Whether the correction has reached its limit somewhere in the last period."""
        return bool(len(self.x)) and bool(np.max(np.abs(self._last_period(self.x, 0))) >= self.p[at.MAXIMUM])

    def learned(self) -> Learned:
        """Return the correction of the last period.

        Raises
        ------
        ParameterError
            There is none, or no whole period was seen yet.
        """
        self._require_use()
        # in one go: a loop that runs beside writes one sample at a time
        x = self.x.copy()
        reference = self._last_period(x, 2)
        if not np.all(np.isfinite(reference)):
            allowed = f"no whole period of {self.parameters.period:g} s has been followed yet; wait for one"
            raise ParameterError([Problem("learning", "nothing learned", allowed)])
        return Learned(self.parameters.period, self.sample_time, self._last_period(x, 0), reference)

    def _last_period(self, x: np.ndarray, ring: int) -> np.ndarray:
        """Return the last period of a ring, from the sample whose number is a multiple of the period on."""
        length, period, now = (len(x) - at.RINGS) // 3, int(self.p[at.PERIOD]), int(x[at.SAMPLES])
        numbers = np.arange(now - period, now)
        values = x[at.RINGS + ring * length + numbers % length]
        return values[np.argsort(numbers % period)]
