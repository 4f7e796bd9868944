# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The choice between structures of the dynamics: by segments that were left out, and by the numbers they need."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.linear_part import Mode
from hysteresis_ros.identification.modal_search import (
    MOST_MODES,
    ModalSearch,
    Structure,
    Trial,
    mode_columns,
)
from hysteresis_ros.identification.segment_spectra import SegmentSpectra

#: Places and dampings at which a mode is tried before it is searched, and how many of the best are followed.
PLACES, DAMPINGS, FOLLOWED = 100, (0.01, 0.05, 0.25), 2
#: Of the structures with equally many modes, so many are judged by segments that were left out.
JUDGED = 3
#: A structure must predict better in so many folds, and where its modes are, within this factor of the frequency.
MAJORITY, NEARBY = 3, 1.4
#: Evaluations when segments are left out: the search starts at its end.
FEW_EVALUATIONS = 6


def choose_dynamics(
    spectra: SegmentSpectra, parts=("lag", "delay"), most_modes: int = MOST_MODES, zeros: bool = True
) -> Trial:
    """Return the dynamics with which left-out segments are predicted best for the numbers they need.

    Parameters
    ----------
    spectra : SegmentSpectra
        Of what the hysteresis puts out and of what is measured.
    parts : tuple of str
        Of ``lag`` and ``delay``: what may be there beside modes.
    most_modes : int
    zeros : bool
        Whether modes may stand beside each other and the lag; otherwise all stand one behind the other.
    """
    search = ModalSearch(spectra)
    plain = [_without_modes(search, *both) for both in itertools.product(*(_choices(part, parts) for part in PAIR))]
    largest = [min(plain, key=lambda trial: search.cost(trial.response))]
    search.weigh(largest[0].response)
    low, high = search.mode_range
    # few samples a cycle leave no room for a mode between the drive and half of the sample rate
    for _ in range(most_modes if 1.2 * low < high else 0):
        largest.append(_with_mode(search, largest[-1]))
    search.weigh(largest[-1].response)
    judged = [_left_out(search, search.fit(trial.structure, [trial.values])) for trial in plain]
    for trial in largest[1:]:
        variants = [search.fit(structure, [start]) for structure, start in _variants(search, trial, parts, zeros)]
        variants.sort(key=lambda found: search.cost(found.response) + _price(spectra) * found.structure.numbers)
        judged += [_left_out(search, found) for found in variants[:JUDGED]]
    return _chosen(judged, spectra)


PAIR = ("lag", "delay")


def _choices(part: str, parts) -> tuple[bool, ...]:
    return (False, True) if part in parts else (False,)


def _price(spectra: SegmentSpectra) -> float:
    """What a number has to gain in twice the logarithm of the likelihood."""
    return float(np.log(spectra.samples))


def _chosen(judged, spectra: SegmentSpectra) -> Trial:
    """Go from few numbers to many, as long as each step pays."""
    price = _price(spectra)
    order = sorted(judged, key=lambda pair: (pair[0].structure.numbers, pair[1].sum()))
    best, least = order[0]
    for trial, errors in order[1:]:
        gain = least - errors
        added = _added_modes(trial.part.modes, best.part.modes)
        near = [np.abs(np.log(spectra.frequencies / mode.frequency)) < np.log(NEARBY) for mode in added]
        more = trial.structure.numbers - best.structure.numbers
        if (
            gain.sum() > price * more
            and np.count_nonzero(gain.sum(axis=1) > 0.0) >= min(MAJORITY, len(gain))
            and all(gain[:, place].sum() > 2.0 * price for place in near)
        ):
            best, least = trial, errors
    if best.structure.delay and not best.structure.lag:
        # a lag is what stages have: nearly as good, it is taken
        for trial, errors in order:
            same = trial.structure == replace(best.structure, lag=True, delay=False)
            if same and errors.sum() - least.sum() < price:
                return trial
    return best


def _added_modes(modes, present) -> list[Mode]:
    """Return those of the modes that were not present before; one that was is the next in frequency of each present."""
    left = list(modes)
    for mode in present if len(modes) > len(present) else ():
        left.remove(min(left, key=lambda other: abs(np.log(other.frequency / mode.frequency))))
    return left


def _without_modes(search: ModalSearch, lag: bool, delay: bool) -> Trial:
    """Fit lag and delay from a grid of both."""
    structure, T = Structure(lag, delay), search.T
    lags = np.geomspace(0.2 * T, search.lag_range[1], 10)
    delays = np.append(0.3 * T, np.geomspace(0.7 * T, search.delay_range[1], 8))
    grid = itertools.product(np.log(lags) if lag else [None], delays / T if delay else [None])
    starts = [np.array([value for value in point if value is not None]) for point in grid]
    starts.sort(key=lambda start: search.cost(search.trial(structure, start).response))
    return search.fit(structure, starts[:FOLLOWED])


def _with_mode(search: ModalSearch, trial: Trial) -> Trial:
    """Add a mode where it lowers the cost most."""
    structure = replace(trial.structure, modes=trial.structure.modes + 1)
    _, delay, _ = search.unpack(trial.structure, trial.values)
    columns = search.columns(trial.structure, trial.values)
    low, high = search.mode_range
    found = []
    for place in itertools.product(np.geomspace(1.05 * low, 0.95 * high, PLACES), DAMPINGS):
        extra = mode_columns(*place, search.f, search.T, delay)
        residual = search.solve(np.concatenate([columns, extra], axis=1))[1]
        found.append((float(residual @ residual), place))
    starts, taken = [], []
    for _, (frequency, damping) in sorted(found):
        if len(starts) < FOLLOWED and all(abs(np.log(frequency / other)) > 0.2 for other in taken):
            taken.append(frequency)
            starts.append(np.append(trial.values, np.log([frequency, damping])))
    return search.fit(structure, starts)


def _variants(search: ModalSearch, trial: Trial, parts, zeros: bool):
    """Yield structures with the same modes, and where their search starts."""
    lag, delay, pairs = search.unpack(trial.structure, trial.values)
    tail = np.log(pairs).ravel()
    places = (False, True) if zeros else (True,)
    for has_lag, has_delay, series in itertools.product(*(_choices(part, parts) for part in PAIR), places):
        head = [np.log(lag or 2.0 * search.T)] * has_lag + [delay / search.T or 0.3] * has_delay
        yield Structure(has_lag, has_delay, trial.structure.modes, series), np.append(head, tail)


def _left_out(search: ModalSearch, trial: Trial) -> tuple[Trial, np.ndarray]:
    """Return the trial and the errors of each fold and frequency under its structure fitted to the other folds."""
    spectra, found = search.spectra, []
    for fold in range(len(spectra.input)):
        others = search.without(fold)
        response = others.fit(trial.structure, [trial.values], FEW_EVALUATIONS).response
        found.append(search.scale * spectra.errors(response)[fold] / search.variance)
    return trial, np.array(found)
