# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What is assumed about the past before a recording, and which samples are left out for it.

A hysteresis remembers, and a recording does not show what was before. Where the voltage reaches both ends of its range
and a cycle follows, the memory is wiped out, and what came before is left out. Elsewhere the whole recording counts,
and three pasts are tried: rest at 0 V; the input had repeated before; a larger voltage had left the actuator remanent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.condensed import Condensed, condense, wiped_out
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.free_weights import FreeWeights
from hysteresis_ros.identification.hammerstein import stretches
from hysteresis_ros.identification.linear_part import LinearPart

#: Plays and dead zones of the trials, and to how many samples they make the data coarser.
PLAYS, ZONES = 10, 3
COARSE = 1500
#: Pasts are judged without this part of the samples, which may be outliers.
TRIMMED = 0.1
#: Another past than rest is believed when it lowers the residual by this part.
WORTH_IT = 0.1
#: Rest explains a beginning whose error is below so many times that of what follows, or below this part of the stroke.
AS_WELL, AT_REST = 1.5, 0.01
#: A recording is closed when input and output come back to their start within this part of their range.
CLOSED = 0.02
#: Voltages a remanent actuator may have seen, as parts of the largest of the recording.
BEYOND = 1.5
TRIALS = (-1.0, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0, BEYOND)


@dataclass(frozen=True)
class Start:
    """How a recording is taken to begin.

    Parameters
    ----------
    kind : str
        ``zero``, ``periodic`` or ``estimate`` (remanent), as in ``initial``.
    skip : int
        First samples left out.
    history : tuple of float
        Voltages [V] that the hysteresis went through before, from rest at 0 V.
    note : str
        What was done and why, in a sentence.
    """

    kind: str
    skip: int
    history: tuple[float, ...] = ()
    note: str = ""

    def signals(self, data: IdentificationData):
        """Return voltage [V] and displacement [m] to fit, and the samples to leave out: periodic data comes twice.

        Parameters
        ----------
        data : IdentificationData
        """
        if self.kind != "periodic":
            return data.input, data.output, self.skip
        return np.tile(data.input, 2), np.tile(data.output, 2), len(data) + self.skip

    def before(self, voltage) -> np.ndarray:
        """Return the voltages [V], shape (K,), from rest at 0 V up to the first sample that counts.

        Parameters
        ----------
        voltage : ndarray, shape (N,)
            Of the recording [V].
        """
        past = voltage if self.kind == "periodic" else stretches(self.history)
        return np.concatenate([past, voltage[: self.skip]])


def find_start(
    data: IdentificationData,
    skip: int | None = None,
    initial: str | None = None,
    structure=None,
    *,
    whole: bool = False,
) -> Start:
    """Return how the recording begins: as asked for, else as its beginning fits best.

    Parameters
    ----------
    data : IdentificationData
    skip : int, optional
        First samples to leave out.
    initial : str, optional
        ``zero``, ``periodic`` or ``estimate``.
    structure : callable, optional
        ``structure(condensed)`` returns what the trials fit, with ``behind(linear_part)`` and ``output()``; plays of
        free weights by default.
    whole : bool
        Leave nothing out where rest at 0 V explains the beginning about as well as the rest of the recording: the first
        rise of a model that starts there says more of it than later loops.

    Raises
    ------
    IdentificationError
        The data cannot be used, or does not repeat where it is said to.
    """
    asked = "as asked for: "
    if initial == "periodic":
        _refuse_open(data)
        return Start("periodic", skip or 0, (), f"{asked}the input had repeated before")
    if initial == "zero" or (skip is not None and initial is None):
        words = f"the first {skip} samples left out" if skip else "at rest at 0 V before the recording"
        return Start("zero", skip or 0, (), asked + words)
    trials = _Trials(data, structure or (lambda condensed: FreeWeights(condensed, PLAYS, ZONES)))
    if initial == "estimate":
        voltage, _ = trials.remanent()
        return Start("estimate", skip or 0, (voltage, float(data.input[0])), asked + remanence(voltage))
    wiped = wiped_out(data.input)
    if wiped is None:
        return _remembered(data, trials)
    if whole and trials.at_rest(wiped):
        return Start("zero", 0, (), "at rest at 0 V before the recording, which explains its beginning")
    seconds = wiped * data.sample_time
    note = (
        f"the first {wiped} samples ({seconds:.3g} s) left out, until the voltage had been near both ends of its range"
    )
    return Start("zero", wiped, (), note if wiped else "nothing left out: it begins at an end of the range")


def _remembered(data: IdentificationData, trials: _Trials) -> Start:
    """Choose between the pasts where the memory of them lasts for too long to be left out."""
    rest = _trimmed(trials.error())
    found = [(rest, Start("zero", 0, (), "at rest at 0 V before the recording: nothing else fits better"))]
    if _closed(data):
        note = "the input had repeated before: the recording ends where it begins, and fits that better than rest"
        found.append((_trimmed(trials.error(periodic=True)), Start("periodic", 0, (), note)))
    voltage, error = trials.remanent()
    found.append((error, Start("estimate", 0, (voltage, float(data.input[0])), remanence(voltage))))
    best = min(found, key=lambda row: row[0])
    return best[1] if best[0] < (1.0 - WORTH_IT) * rest else found[0][1]


def remanence(voltage: float) -> str:
    """Return a past in words.

    Parameters
    ----------
    voltage : float
        [V]
    """
    return f"remanent before the recording, as after {voltage:.4g} V: found with the fit"


class _Trials:
    """Fits to a coarse recording under different pasts, each behind a lag of its own."""

    def __init__(self, data: IdentificationData, structure):
        self.data, self.structure = data, structure

    def condensed(self, history, periodic: bool):
        """Return the recording after a past."""
        v, y, skip = self.data.input, self.data.output, 0
        if periodic:
            v, y, skip = np.tile(v, 2), np.tile(y, 2), len(v)
        return condense(v, y, self.data.sample_time, skip, history=history, enough=COARSE)

    def error(self, history=(), periodic: bool = False, part=None) -> np.ndarray:
        """Return what is left [m] of every sample with this past, shape (N,) or a little less."""
        condensed = self.condensed(history, periodic)
        fit = self.structure(condensed).behind(part or _lag(condensed))
        return np.repeat((condensed.displacement - fit.output())[condensed.first :], condensed.factor)

    def at_rest(self, first: int) -> bool:
        """Whether rest at 0 V explains the samples before ``first`` about as well as those after it."""
        error = self.error()
        return first == 0 or _trimmed(error[:first]) <= max(
            AS_WELL * _trimmed(error[first:]), AT_REST * self.data.stroke
        )

    def remanent(self) -> tuple[float, float]:
        """Return the voltage [V] whose remanence fits best, and its error [m]."""
        voltage = self.data.input
        largest, first = float(np.max(np.abs(voltage))), float(voltage[0])
        both = float(np.min(voltage)) < -WORTH_IT * largest
        parts = TRIALS if both else tuple(part for part in TRIALS if part > 0.0)
        place, lag = int(np.searchsorted(parts, 1.0)), None

        def cost(part):
            return _trimmed(self.error((part * largest, first), part=lag))

        for _ in range(2):  # the lag that goes with the best past, then the past again
            lag = _lag(self.condensed((parts[place] * largest, first), False))
            errors = [cost(part) for part in parts]
            place = int(np.argmin(errors))
        ends = parts[max(place - 1, 0)], parts[min(place + 1, len(parts) - 1)]
        fine = scipy.optimize.minimize_scalar(cost, bounds=ends, method="bounded", options={"maxiter": 6})
        error, part = min((errors[place], parts[place]), (float(fine.fun), float(fine.x)))
        return part * largest, error


def _lag(condensed: Condensed) -> LinearPart:
    """Return the lag that fits best."""
    return FreeWeights(condensed, PLAYS, 0).fit(("lag",), None).part


def _trimmed(error) -> float:
    """Root mean square without the largest errors, in their unit."""
    size = np.sort(np.abs(error))
    return float(np.sqrt(np.mean(size[: max(1, int((1.0 - TRIMMED) * len(size)))] ** 2)))


def _closed(data: IdentificationData) -> bool:
    """Whether the recording may be a whole number of periods: it comes back, and has not grown up to its end."""
    u, span = data.input, float(np.ptp(data.input))
    reached = [np.flatnonzero(np.abs(u - end) <= CLOSED * span)[0] for end in (u.max(), u.min())]
    return max(reached) <= 0.75 * len(data) and all(
        abs(float(values[-1] - values[0])) <= CLOSED * float(np.ptp(values)) + abs(float(values[1] - values[0]))
        for values in (data.input, data.output)
    )


def _refuse_open(data: IdentificationData) -> None:
    gap, span = abs(float(data.input[-1] - data.input[0])), float(np.ptp(data.input))
    step = float(np.quantile(np.abs(np.diff(data.input)), 0.98))
    if gap > CLOSED * span + 2.0 * step:
        raise IdentificationError(
            f"initial = periodic: the input ends {gap:.3g} V from where it begins; "
            "cut the data to whole periods (--range)"
        )
