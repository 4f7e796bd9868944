# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Separation of a hysteresis from the history before the recording, and from lag, creep, drift and outliers.

A hysteresis has memory, and a recording does not show the voltage before it. If the voltage reaches both ends of its
range and a cycle follows, this memory is erased, and the samples before are omitted. Otherwise the whole recording
counts, and three histories are tried: rest at 0 V, a periodic input, and remanence after an earlier voltage. The memory
that remains after this voltage depends on the model, so the voltage is searched together with the model.

Models without lag and creep are fitted to data from which these are removed (:func:`separated`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import found_with
from hysteresis_ros.identification.linear_systems import LinearPart, undo, undo_creep
from hysteresis_ros.identification.plant_model import Request, at_rest, stretches
from hysteresis_ros.identification.prandtl_ishlinskii import FreeWeights, fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.identification.preprocessing import (
    PASTS,
    Cleaned,
    Condensed,
    cleaned,
    condense,
    remanent_voltage,
    wiped_out,
)
from hysteresis_ros.identification.thresholds import PAST_WHILE_FITTING
from hysteresis_ros.units import readable

#: Number of plays of the trial fits.
TRIED_PLAYS = 10
#: Number of dead zones of the trial fits.
TRIED_ZONES = 3
#: Least number of samples to which a recording is condensed for the trial fits.
COARSE = 1500
#: Fraction of the samples, those with the largest errors (possibly outliers), that the comparison of histories omits.
TRIMMED = 0.1
#: A recording is bipolar if its voltage goes below 0 V by more than this fraction of the largest magnitude.
BIPOLAR = 0.1
#: A start at rest is accepted if the error at the beginning is at most this multiple of the error of the remaining
#: samples.
AS_WELL = 1.5
#: For models whose fit needs the beginning, a start at rest is also accepted if the error at the beginning is at most
#: this fraction of the stroke.
AT_REST = 0.01
#: A remanence is preferred to rest if its error at the beginning is at most this multiple (assumed) of the error of
#: rest, because the trials do not contain the modes, whose response to the first rise is as large as the effect of a
#: small remanence.
REMANENT = 0.8
#: If the error of rest is more than this multiple of the error of the remaining samples, any remanence whose error is
#: not larger than that of rest is preferred.
EXPLAINED = 3.0
#: Assumed: if more than this fraction of the recording would be omitted, a start at rest is tried first.
MOST_OMITTED = 0.3
#: A recording is closed if input and output end within this fraction of their range from their first values.
CLOSED_PART = 0.02


@dataclass(frozen=True)
class Start:
    """Assumed beginning of a recording."""

    kind: str  #: ``zero``, ``periodic`` or ``estimate`` (remanent), as in ``initial``.
    skip: int  #: Number of omitted first samples.
    history: tuple[float, ...] = ()  #: Voltages [V] before the recording, starting from rest at 0 V.
    note: str = ""  #: Sentence about the choice and its reason.

    def signals(self, data: IdentificationData):
        """Return voltage [V] and displacement [m] to fit, and how many to omit; periodic data is repeated once."""
        if self.kind != "periodic":
            return data.input, data.output, self.skip
        return np.tile(data.input, 2), np.tile(data.output, 2), len(data) + self.skip

    def past(self, parts: tuple[str, ...]):
        """Return the key of fits with this history and these parts, by which a separation finds them again."""
        return "fits", parts, self.kind, self.history

    def before(self, voltage) -> np.ndarray:
        """Return the voltages [V], shape (K,), from rest at 0 V up to the first sample that counts."""
        past = voltage if self.kind == "periodic" else stretches(self.history)
        return np.concatenate([past, voltage[: self.skip]])


#: The start of a recording whose first rise shows that the actuator was at rest.
RESTED = Start("zero", 0, (), "at rest at 0 V before the recording, which explains its beginning")


#: The starts of a recording of an oscillator, which has forgotten any other past.
NOT_REPEATED = Start("zero", 0, (), "at rest at 0 V before the recording")
REPEATED = Start("periodic", 0, (), "the input was periodic before, which fits better than rest at 0 V")


#: The start of a prediction if the voltage never erases the memory of earlier voltages.
NOT_ERASED = Start("zero", 0, (), "no samples omitted, although all depend on the voltage before the recording")


def requested(initial: str | None, skip: int | None) -> Start:
    """Return the start that the user states."""
    words = f"the first {skip} samples omitted" if skip else "at rest at 0 V before the recording"
    if initial == "periodic":
        words = "the input was periodic before"
    if initial == "estimate":
        words = "the voltage before the recording and the state are estimated"
    return Start(initial or "zero", skip or 0, (), f"as requested: {words}")


def find_start(
    data: IdentificationData,
    skip: int | None = None,
    initial: str | None = None,
    structure=None,
    *,
    whole: bool = False,
) -> Start:
    """Return the assumed beginning of the recording: as requested, or with the best fit."""
    if initial == "periodic":
        _refuse_open(data)
    if initial in ("periodic", "zero") or (skip is not None and initial is None):
        return requested(initial, skip)
    trials = _PastTrials(data, structure or _tried)
    if initial == "estimate":
        voltage, _ = trials.remanent()
        words = f"as requested: {remanence(voltage)}"
        return Start("estimate", skip or 0, (voltage, float(data.input[0])), words)
    wiped = wiped_out(data.input)
    if wiped is None:
        return _remembered(data, trials)
    rested = trials.at_rest(wiped) if whole else trials.begins_at_rest(wiped)
    return RESTED if rested else without_memory(data, wiped)


def without_memory(data: IdentificationData, wiped: int) -> Start:
    """Return the start at the sample from which earlier voltages no longer matter."""
    note = "no samples omitted: the voltage begins at an end of its range"
    if wiped:
        seconds = f"{wiped * data.sample_time:.3g} s"
        note = f"the first {wiped} samples ({seconds}) omitted, until the voltage had been near both ends of its range"
    return Start("zero", wiped, (), note)


def start_of_prediction(data: IdentificationData, first: int, predicted) -> Start:
    """Return the assumed beginning of a recording for a known model, chosen as for a fit.

    ``first``: sample from which earlier voltages no longer matter; ``predicted(history)``: displacement [m], shape
    (N,), after rest at 0 V and these voltages [V].
    """
    if wiped_out(data.input) is None:
        return NOT_ERASED
    return RESTED if _KnownTrials(data, first, predicted).begins_at_rest(first) else without_memory(data, first)


def rests_behind(data: IdentificationData, first: int, part: LinearPart, structure=None) -> bool:
    """Whether, with known dynamics, a start at rest at 0 V explains the omitted samples before ``first``.

    The trials of :func:`find_start` contain only a lag, so the response of modes to the first rise looks like
    remanence.
    """
    return _PastTrials(data, structure or _tried, len(data)).begins_at_rest(first, part)


def _tried(condensed: Condensed) -> FreeWeights:
    return FreeWeights(condensed, TRIED_PLAYS, TRIED_ZONES)


def _remembered(data: IdentificationData, trials: _PastTrials) -> Start:
    """Choose the history of a recording in which the memory of earlier voltages is never erased."""
    rest = _trimmed(trials.error())
    found = [(rest, Start("zero", 0, (), "at rest at 0 V before the recording: no other history fits better"))]
    if _closed(data):
        note = "the input was periodic before: the recording ends where it begins, and this fits better than rest"
        periodic = Start("periodic", 0, (), note)
        found.append((_trimmed(trials.error(periodic)), periodic))
    voltage, error = trials.remanent(rest)
    found.append((error, _after(voltage, float(data.input[0]))))
    best = min(found, key=lambda row: row[0])
    return best[1] if PAST_WHILE_FITTING.improves(best[0], rest) else found[0][1]


def remanence(voltage: float) -> str:
    """Return a description of a remanent history.

    Units: ``voltage`` [V].
    """
    return f"remanent before the recording, as after {readable(voltage, 'V')}; this voltage was identified with the fit"


class _PastTrials:
    """Fits to a recording, reduced to about ``enough`` samples, with different histories, each with a fitted lag."""

    def __init__(self, data: IdentificationData, structure, enough: int = COARSE):
        self.data, self.structure, self.enough = data, structure, enough

    def condensed(self, start: Start) -> Condensed:
        """Return the condensed recording after a given history."""
        v, y, skip = start.signals(self.data)
        return condense(v, y, self.data.sample_time, skip, history=start.history, enough=self.enough)

    def error(self, start: Start = Start("zero", 0), part=None) -> np.ndarray:
        """Return the residual [m] of the samples after this history, shape (N,) or slightly shorter."""
        condensed = self.condensed(start)
        fit = self.structure(condensed).behind(part or _lag(condensed))
        return np.repeat((condensed.displacement - fit.output())[condensed.first :], condensed.factor)

    def lag(self, start: Start) -> LinearPart | None:
        """Return the lag that fits best after a given history."""
        return _lag(self.condensed(start))

    def at_rest(self, first: int) -> bool:
        """Whether a model that starts at rest at 0 V fits the samples before ``first``.

        True if the error in these samples is at most AS_WELL times that in the later samples, or the fraction AT_REST
        of the stroke.
        """
        error = self.error()
        return first == 0 or _trimmed(error[:first]) <= max(
            AS_WELL * _trimmed(error[first:]), AT_REST * self.data.stroke
        )

    def begins_at_rest(self, first: int, part: LinearPart | None = None) -> bool:
        """Whether a start at rest at 0 V explains the samples before ``first``, which would otherwise be omitted.

        ``part``: the dynamics, if they are known; otherwise a lag is fitted.

        If more than the fraction MOST_OMITTED would be omitted, a fit from rest must explain both parts about as well
        as a fit from ``first`` on explains its samples. The larger of both errors counts, because a fit with a wrong
        history adapts to the longer part, and fails only on the shorter one. Otherwise, the recording must begin at
        0 V, and no remanence may explain these samples clearly better than rest.
        """
        if first == 0:
            return False
        alone = Start("zero", first)
        if first > MOST_OMITTED * len(self.data):
            error = self.error(part=part)
            return max(_trimmed(error[:first]), _trimmed(error[first:])) <= AS_WELL * _trimmed(self.error(alone, part))
        voltage = self.data.input
        if not begins_at_zero(voltage):
            return False
        lag, (largest, bipolar) = part or self.lag(alone), self._largest()
        error = self.error(part=lag)
        rest = _trimmed(error[:first])
        enough = REMANENT * rest if rest <= EXPLAINED * _trimmed(error[first:]) else rest
        pasts = (part * largest for part in PASTS if (bipolar or part > 0.0) and abs(part) <= 1.0)
        return all(enough < _trimmed(self.error(_after(past, float(voltage[0])), lag)[:first]) for past in pasts)

    def _largest(self) -> tuple[float, bool]:
        """Return the largest voltage [V], and whether the recording is bipolar."""
        voltage = self.data.input
        largest = float(np.max(np.abs(voltage)))
        return largest, float(np.min(voltage)) < -BIPOLAR * largest

    def remanent(self, rest: float = np.inf) -> tuple[float, float]:
        """Return the voltage [V] with the best-fitting remanence, and the error [m] of this fit.

        The search ends early if no remanence fits better than ``rest``, the error of a start at rest [m].
        """
        (largest, bipolar), first = self._largest(), float(self.data.input[0])
        found = largest, 0.0
        for _ in range(2):  # fit the lag with the best history so far, then search the history again
            lag = self.lag(_after(found[0], first))
            found = remanent_voltage(
                lambda before, lag=lag: _trimmed(self.error(_after(before, first), lag)), largest, bipolar
            )
            if found[1] >= rest:
                break
        return found


class _KnownTrials(_PastTrials):
    """Predictions of a known model with different histories; a constant is removed from each error."""

    def __init__(self, data: IdentificationData, first: int, predicted):
        super().__init__(data, None)
        self.first, self.predicted = first, predicted

    def error(self, start: Start = Start("zero", 0), part=None) -> np.ndarray:
        """Return the error [m] of the samples after this history, shape (N,)."""
        error = self.data.output - self.predicted(start.history)
        return (error - np.median(error[self.first :]))[start.skip :]

    def lag(self, start: Start) -> None:
        """Return nothing, because the model is known."""


def begins_at_zero(voltage) -> bool:
    """Return whether the first voltage is 0 V, within CLOSED_PART of the range; ``voltage`` [V]."""
    return bool(abs(voltage[0]) <= CLOSED_PART * np.ptp(voltage))


def _after(voltage: float, first: float) -> Start:
    """Return the start of a recording after remanence by ``voltage`` [V]; ``first``: first recorded voltage [V]."""
    return Start("estimate", 0, (voltage, first), remanence(voltage))


def _lag(condensed: Condensed) -> LinearPart:
    """Return the lag that fits best."""
    return FreeWeights(condensed, TRIED_PLAYS, 0).fit(("lag",), None).part


def _trimmed(error) -> float:
    """Return the root mean square of the errors except the largest ones, in their unit."""
    size = np.sort(np.abs(error))
    return float(np.sqrt(np.mean(size[: max(1, int((1.0 - TRIMMED) * len(size)))] ** 2)))


def _closed(data: IdentificationData) -> bool:
    """Return whether the recording may be a whole number of periods.

    Such a recording ends where it begins, and reaches both ends of its range in its first three quarters.
    """
    u, span = data.input, float(np.ptp(data.input))
    reached = [np.flatnonzero(np.abs(u - end) <= CLOSED_PART * span)[0] for end in (u.max(), u.min())]
    return max(reached) <= 0.75 * len(data) and all(
        abs(float(values[-1] - values[0])) <= CLOSED_PART * float(np.ptp(values)) + abs(float(values[1] - values[0]))
        for values in (data.input, data.output)
    )


def _refuse_open(data: IdentificationData) -> None:
    gap, span = abs(float(data.input[-1] - data.input[0])), float(np.ptp(data.input))
    step = float(np.quantile(np.abs(np.diff(data.input)), 0.98))
    if gap > CLOSED_PART * span + 2.0 * step:
        raise IdentificationError(
            f"initial = periodic: the first and last input differ by {readable(gap, 'V')}; cut the data to whole "
            "periods (--range)"
        )


@dataclass(frozen=True, eq=False)
class Separated:
    """A recording without the dynamics after a hysteresis, and without drift."""

    cleaned: Cleaned  #: The recording without outliers and drift.
    output: np.ndarray  #: shape (N,); Output of the cleaned recording [m] without lag and creep.
    part: LinearPart  #: The linear part after the hysteresis.
    start: Start  #: Assumed beginning of the recording.
    warnings: tuple[str, ...]  #: Warnings about the separation.
    constant: float = 0.0  #: Constant that was removed from the output before creep was inverted [m].

    @property
    def voltage(self) -> np.ndarray:
        """Voltage [V] of the samples that count."""
        return self.cleaned.data.input[self.start.skip :]

    @property
    def displacement(self) -> np.ndarray:
        """Output of the hysteresis [m] at the samples that count."""
        return self.output[self.start.skip :]

    @property
    def history(self) -> np.ndarray:
        """Voltages [V] from rest at 0 V to the first sample that counts."""
        return self.start.before(self.cleaned.data.input)


def separated(data: IdentificationData, request: Request) -> Separated:
    """Return the data without lag, creep, outliers and drift, and the assumed history.

    Lag, creep, outliers and drift are identified together with a Preisach or a Prandtl-Ishlinskii model, because these
    models leave the shape of the loops free; the one with the smaller residual is used. Earlier fits of these models to
    the same data are reused. The request stores the result for the next model of the same data.
    """
    asked = request.parts, request.stage is None, request.skip, request.initial
    if asked not in request.separations:
        request.separations[asked] = _separated(data, request)
    return request.separations[asked]


def _separated(data: IdentificationData, request: Request) -> Separated:
    parts = ("lag", "delay") if request.stage else request.parts
    start = find_start(data, request.skip, request.initial, whole=True)
    voltage, displacement, skip = start.signals(data)
    if request.skip is None and request.initial is None and start.kind == "zero":
        skip = None  # the beginning is omitted, because the model affects it more than lag, creep and drift do
    # always search creep too: without it, slow drifts would be noise that hides the lag
    looked_for = tuple(dict.fromkeys((*parts, "creep"))) if parts else ()
    options = dict(skip=skip, history=start.history, progress=request.report_residual)
    searches: tuple[tuple[Any, dict], ...] = ((fit_preisach, {}), (fit_prandtl_ishlinskii, {"zone_count": 0}))
    fits = request.separations.get(start.past(looked_for)) or [
        found_with(partial(search, **options, **settings), voltage, displacement, data.sample_time, looked_for, skip)
        for search, settings in (searches if parts else searches[1:])
    ]
    fit = min(fits, key=lambda item: item.rmse)
    # periodic data does not drift
    drift = 0.0 if start.kind == "periodic" else fit.drift
    clean = cleaned(data, fit.simulate(voltage)[-len(data) :], fit.skipped % len(data), drift)
    part = fit.linear_part if "creep" in parts else replace(fit.linear_part, creep_rate=0.0, settled=False)
    output, constant = clean.data.output, 0.0
    if parts and (part.modes or part.lag + part.delay >= 0.1 * data.sample_time):
        output = undo(output, part, data.sample_time)
    else:
        part = replace(part, lag=0.0, delay=0.0)
    if part.creep.type != "none":
        constant = at_rest(fit.hysteresis, data.sample_time) * part.settled_gain
        output = undo_creep(output - constant, part, data.sample_time)
    return Separated(clean, output, part, start, fit.warnings, constant)


#: Range of the search for the voltage before the recording, as fractions of the best voltage with the first fit.
SEARCHED_PART = (0.6, 1.5)
#: Tolerance of this search, as a fraction of the same voltage.
PAST_TOLERANCE = 3e-3
MOST_PAST_TRIALS = 14


def remembered(static: Separated, fit, block):
    """Return the result of ``fit``, and the separation with the matching history."""
    found = fit(static, None)
    if static.start.kind != "estimate":
        return found, static
    import scipy.optimize  # imported here because only fits need it

    largest, first = float(np.max(np.abs(static.cleaned.data.input))), float(static.cleaned.data.input[0])

    def after(voltage: float) -> Separated:
        start = replace(static.start, history=(voltage, first))
        words = "as requested: " if start.note.startswith("as requested") else ""
        return replace(static, start=replace(start, note=words + remanence(voltage)))

    def error(model, other: Separated) -> float:
        run = block(model)
        run.simulate(other.history)
        return float(np.std(run.simulate(other.voltage) - other.displacement))

    given = static.start.history[0]
    near = min((given, *(part * largest for part in PASTS)), key=lambda voltage: error(found, after(voltage)))
    tried = {given: found}

    def cost(voltage: float) -> float:
        tried[voltage] = fit(after(voltage), found)
        return error(tried[voltage], after(voltage))

    ends = sorted(part * near for part in SEARCHED_PART)
    search = scipy.optimize.minimize_scalar(
        cost, bounds=ends, method="bounded", options={"maxiter": MOST_PAST_TRIALS, "xatol": PAST_TOLERANCE * abs(near)}
    )
    best = min((given, float(search.x)), key=lambda voltage: error(tried[voltage], after(voltage)))
    return tried[best], after(best)
