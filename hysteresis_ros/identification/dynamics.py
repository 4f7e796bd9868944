# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The dynamics behind a hysteresis, found in turns with it: lag, delay, resonances and creep.

Slow recordings: the hysteresis is found together with lag, delay and creep first, on coarse data; then the dynamics are
chosen anew at the full rate behind it. Fast ones: the dynamics between voltage and displacement stand at the beginning,
because a hysteresis that has to stand for a resonance leads nowhere. Either way hysteresis and the dynamics behind it
are then settled in turns.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from hysteresis_ros.errors import IdentificationError, ParameterError
from hysteresis_ros.identification.condensed import condense
from hysteresis_ros.identification.hammerstein import HammersteinFit, pass_through
from hysteresis_ros.identification.linear_part import Known, LinearPart
from hysteresis_ros.identification.modal_choice import PAIR, choose_dynamics
from hysteresis_ros.identification.segment_spectra import segment_spectra
from hysteresis_ros.models.creep import Creep
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.recordings.loops import turning_points

#: A recording that cannot be made coarser than to so many samples is a fast one.
FAST_SAMPLES = 12000
#: Samples on which creep is searched, and on which weights are settled, in fast recordings.
SEARCHED, SETTLED = 8000, 24000
TURNS = 2
#: Up to this harmonic of the drive loops have a shape of their own; a resonance there needs this part of the voltage's
#: power within this part of its frequency.
HARMONICS, LEAST_POWER, BAND = 10, 1e-3, 0.1
#: Dynamics found later are taken when they lower the RMS residual by this part.
WORTH_IT = 0.03
#: Damping below which a mode is a resonance, which no lag stands for.
SHARP = 0.3


def found_with(fit_function, voltage, displacement, sample_time: float, parts, skip: int | None = None):
    """Fit a hysteresis with what may stand behind it.

    Parameters
    ----------
    fit_function : callable
        ``fit_function(voltage, displacement, sample_time, linear=...)`` returns a :class:`HammersteinFit`.
    voltage, displacement : array_like, shape (N,)
        [V] and [m].
    sample_time : float
        [s]
    parts : tuple of str
        Of ``lag``, ``delay``, ``creep`` and ``modes``.
    skip : int, optional
        First samples left out.
    """
    if "modes" in parts:
        return TurnSearch(fit_function, voltage, displacement, sample_time, parts, skip).run()
    return fit_function(voltage, displacement, sample_time, linear=parts)


def gain_and_dynamics(u, y, sample_time: float, parts, skip: int = 0) -> tuple[float, LinearPart, float]:
    """Return gain, linear part and constant between two signals without hysteresis between them.

    Parameters
    ----------
    u, y : ndarray, shape (N,)
    sample_time : float
        [s]
    parts : tuple of str
        Of ``lag`` and ``delay``, beside modes.
    skip : int
        First samples left out.

    Raises
    ------
    IdentificationError
        The gain is not above 0.
    """
    late, pair = 0, tuple(part for part in PAIR if part in parts)
    for _ in range(TURNS):
        found = choose_dynamics(segment_spectra(u, y, sample_time, skip, late), pair)
        late = max(round(found.part.group_delay / sample_time), 0)
    if not found.gain > 0.0:
        raise IdentificationError(f"the gain is {found.gain:.3g} m/V; it must be above 0")
    part = replace(found.part, settled=True)
    constant = float(np.mean((y - found.gain * part.apply(u, sample_time))[skip:]))
    return found.gain, part, constant


class TurnSearch:
    """The search on one recording, see :func:`found_with`."""

    def __init__(self, fit_function, voltage, displacement, sample_time: float, parts, skip: int | None):
        self.fit_function, self.sample_time, self.parts = fit_function, sample_time, tuple(parts)
        self.voltage, self.displacement = (np.asarray(values, dtype=float) for values in (voltage, displacement))
        coarse = condense(self.voltage, self.displacement, sample_time, skip)
        self.first, self.samples = coarse.first * coarse.factor, len(coarse.voltage)

    def run(self) -> HammersteinFit:
        """Return what leaves the smallest residual."""
        found = []
        if self.samples <= FAST_SAMPLES:
            together = self.fit(linear=tuple(part for part in self.parts if part != "modes"))
            found.append(together)
            # where no step is resolved, nothing faster is
            if not together.synchronous:
                found += self.settled(together, sharp=True)
        start = self.choose(self.voltage)
        if start.modes or not found:
            creep = tuple(part for part in self.parts if part == "creep")
            with contextlib.suppress(ParameterError):
                found += self.settled(self.fit(SEARCHED, linear=Known(start, creep)))
        if not found:
            raise IdentificationError(
                "no hysteresis goes with the dynamics that were found; try --linear lag,delay,creep"
            )
        best, *others = found
        for fit in others:  # the simplest comes first
            best = fit if fit.rmse < (1.0 - WORTH_IT) * best.rmse else best
        return best

    def fit(self, longest: int | None = None, **options) -> HammersteinFit:
        """Fit the hysteresis, to no more than the first ``longest`` samples in which the range is gone through."""
        v, count = self.voltage, None
        if longest is not None:
            near = 0.02 * np.ptp(v)
            reached = max(np.flatnonzero(v >= v.max() - near)[0], np.flatnonzero(v <= v.min() + near)[0])
            count = max(longest, int(reached) + longest // 4, self.first + longest)
        return self.fit_function(v[:count], self.displacement[:count], self.sample_time, **options)

    def choose(self, moved, late: int = 0) -> LinearPart:
        """Choose the dynamics between a movement before them, shape (N,), and the measured one."""
        spectra = segment_spectra(moved, self.displacement, self.sample_time, self.first, late)
        parts = tuple(part for part in PAIR if part in self.parts)
        found = choose_dynamics(spectra, parts).part
        if all(self.excited(mode.frequency) for mode in found.modes):
            return found
        return choose_dynamics(spectra, parts, most_modes=0).part

    def excited(self, frequency: float) -> bool:
        """Return whether a resonance there can be told from the shape of the loops.

        Among the first harmonics of the drive the hysteresis moves by itself: the voltage has to have power there.
        """
        v = self.voltage[self.first :]
        cycles = 0.5 * max(len(turning_points(v)) - 1, 1)
        if frequency > HARMONICS * cycles / (len(v) * self.sample_time):
            return True
        power = np.abs(np.fft.rfft((v - v.mean()) * np.hanning(len(v)))) ** 2
        near = np.abs(np.fft.rfftfreq(len(v), self.sample_time) / frequency - 1.0) < BAND
        return float(power[near].sum()) > LEAST_POWER * float(power.sum())

    def settled(self, fit: HammersteinFit, sharp: bool = False) -> list[HammersteinFit]:
        """Choose the dynamics anew behind the hysteresis, and fit it again in front of them, in turns.

        With ``sharp`` only where there is a resonance that the fit so far had no place for. The first turn chooses the
        structure of the hysteresis.
        """
        found: list[HammersteinFit] = []
        for _ in range(TURNS):
            late = max(round(fit.linear_part.group_delay / self.sample_time), 0)
            part = self.choose(output_of(fit, self.voltage), late)
            if sharp and not any(mode.damping < SHARP for mode in part.modes):
                break
            before = fit.linear_part
            creep = dict(creep_rate=before.creep_rate, longest_time=before.longest_time, settled=before.settled)
            kept = {"like": fit.structure} if found and fit.structure is not None else {}
            try:
                fit = self.fit(SETTLED, linear=Known(replace(part, **creep)), **kept)
            except ParameterError:  # dynamics with which no weights go
                break
            found = [fit]
        return found


def output_of(fit: HammersteinFit, voltage) -> np.ndarray:
    """Return the displacement [m] behind hysteresis and creep, shape (N,).

    Parameters
    ----------
    fit : HammersteinFit
    voltage : ndarray, shape (N,)
        [V]
    """
    front, behind = hysteresis_block(fit.hysteresis, fit.sample_time), Creep(fit.creep, fit.sample_time)
    pass_through(front, fit.history)
    behind.settle(front.step(voltage[0] if fit.linear_part.settled else 0.0))
    return behind.simulate(front.simulate(voltage))
