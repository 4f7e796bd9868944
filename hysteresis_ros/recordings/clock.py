# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Time columns of anybody's making: rounded, repeated or missing instants become an axis that increases strictly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.units import readable

#: Instants may lie this many roundings beside a uniform grid.
ROUNDED = 1.01
#: A larger part of the samples shares the instant of the one before when instants are rounded; where all of those
#: repeat the values too, rows were written twice, unless it is so many of them.
SHARED = 0.05
#: Time that goes back is taken for jitter while no instant lies farther beside a uniform grid than this part of all.
DISORDERED = 0.005
WRITTEN_TWICE = 0.4


@dataclass(frozen=True, eq=False)
class Clock:
    """A time axis.

    Parameters
    ----------
    time : ndarray, shape (N,)
        [s], finite and strictly increasing.
    kept : ndarray of bool, shape (M,), optional
        Which rows of the table are samples; all where it is None.
    notes, warnings : tuple of str
        What was done to the instants.
    """

    time: np.ndarray
    kept: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def mend_clock(time: np.ndarray, signals) -> Clock:
    """Return the time axis that a column of instants means.

    Rows without an instant are left out. Instants that were rounded until several rows share one are put on the uniform
    grid between them; a row that repeats the one before is left out, and so is one with its instant but other values.

    Parameters
    ----------
    time : ndarray, shape (M,)
        [s]
    signals : list of ndarray, shape (M,)
        The other columns, which tell a row that was written twice.

    Raises
    ------
    RecordingError
        Time goes back as no jitter makes it, with the row where it does; or it stands still.
    """
    warnings = []
    finite = np.isfinite(time)
    kept = None if finite.all() else finite
    if kept is not None:
        count = int(np.count_nonzero(~finite))
        warnings.append(f"{count} rows without an instant left out, the first is row {int(np.argmin(finite))}")
    instants = time if kept is None else time[kept]
    distances = np.diff(instants)
    if np.all(distances > 0.0):
        return Clock(instants, kept, (), tuple(warnings))
    if np.any(distances < 0.0):
        grid = np.linspace(instants[0], instants[-1], len(instants))
        beside = float(np.max(np.abs(instants - grid)))
        if not beside <= DISORDERED * (grid[-1] - grid[0]):
            k = int(np.argmax(distances < 0.0))
            raise RecordingError(
                f"time goes back from {instants[k]:.9g} s to {instants[k + 1]:.9g} s after row {k}; give a range of "
                "one run"
            )
        warnings.append(
            f"time goes back {np.count_nonzero(distances < 0.0)} times, by up to {readable(-distances.min(), 's')}: "
            f"the rows are taken as uniform, {readable(grid[1] - grid[0], 's')} apart (instants lie up to "
            f"{readable(beside, 's')} beside); lags shorter than that are not known"
        )
        return Clock(grid, kept, (), tuple(warnings))
    if len(instants) < 2 or instants[-1] == instants[0]:
        raise RecordingError(f"all {len(instants)} instants are {instants[0]:.9g} s; give the sample time instead")
    again = np.append(False, distances == 0.0)
    columns = [values if kept is None else values[kept] for values in signals]
    same = again.copy()
    for values in columns:
        same[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    rounding = float(np.min(distances[distances > 0.0]))
    grid = np.linspace(instants[0], instants[-1], len(instants))
    beside = np.max(np.abs(instants - grid))
    if beside <= ROUNDED * rounding and np.mean(again) > (WRITTEN_TWICE if np.all(same == again) else SHARED):
        share = len(instants) / np.count_nonzero(~again)
        note = f"time is rounded to {readable(rounding, 's')}, {share:.3g} samples share an instant: taken as uniform, "
        return Clock(grid, kept, (note + f"{readable(grid[1] - grid[0], 's')} apart",), tuple(warnings))
    twice, other = int(np.count_nonzero(same)), int(np.count_nonzero(again & ~same))
    at = int(np.argmax(again))
    words = [f"{twice} rows that repeat the one before"] if twice else []
    words += [f"{other} rows with the instant of the one before and other values"] if other else []
    warnings.append(f"{' and '.join(words)} left out, the first at {instants[at]:.9g} s (row {at})")
    if kept is None:
        kept = ~again
    else:
        kept[np.flatnonzero(kept)[again]] = False
    return Clock(instants[~again], kept, (), tuple(warnings))
