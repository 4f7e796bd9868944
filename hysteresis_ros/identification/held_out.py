# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Structures compared on what they were not fitted to: each part of a recording is predicted by the rest of it.

A part is several stretches spread over the recording. One stretch alone could be the only one with large loops, and
what is asked is not how a structure extrapolates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.cleaning import DRIFTING

#: Parts that are left out one after the other, and stretches of each.
PARTS, STRETCHES = 5, 4
#: A more flexible structure must lower the RMS error on them by this part, and by so many standard errors.
WORTH_IT = 0.03
STANDARD_ERRORS = 1.0


def held_out(fit, stretches: int = STRETCHES) -> np.ndarray:
    """Return the errors [m] on samples that the fit had not seen, shape (samples counted,).

    Parameters
    ----------
    fit : object
        With ``data`` (Condensed), ``refitted(data)`` and ``output()``, shape (N,).
    stretches : int
        Of each part.
    """
    data = fit.data
    places = np.arange(len(data.kept))
    errors = np.zeros(len(places))
    for part in _parts(places, stretches):
        left_out = np.zeros(len(places), dtype=bool)
        left_out[part] = True
        other = fit.refitted(replace(data, kept=data.kept & ~left_out))
        errors[part] = (data.displacement - other.output())[data.first :][part]
    return errors[data.kept]


def _parts(places, stretches: int) -> list[np.ndarray]:
    """Return the places of each part."""
    found = np.array_split(places, PARTS * stretches)
    return [np.concatenate(found[part::PARTS]) for part in range(PARTS)]


def survivor(fits, stretches: int = STRETCHES, worth_it=WORTH_IT):
    """Return the fit to keep, and the RMS errors on parts held out [m] of all.

    Parameters
    ----------
    fits : sequence of object
        The simplest first; a later one is taken only where it predicts what it has not seen better by
        ``worth_it``, and by more than the parts differ.
    stretches : int
        Of each part.
    worth_it : float or sequence of float
        Part of the RMS error, for all or for each.

    Returns
    -------
    object, list of float
    """
    chosen, least, sizes = fits[0], None, []
    for fit, part_of_it in zip(fits, np.broadcast_to(worth_it, len(fits)), strict=True):
        errors = held_out(fit, stretches)
        sizes.append(float(np.sqrt(np.mean(errors**2))))
        if least is None:
            least = errors
            continue
        gain = least**2 - errors**2
        gains = np.array([np.mean(gain[part]) for part in _parts(np.arange(len(gain)), stretches)])
        sure = gains.mean() > STANDARD_ERRORS * gains.std(ddof=1) / np.sqrt(PARTS)
        if sizes[-1] < (1.0 - part_of_it) * np.sqrt(np.mean(least**2)) and sure:
            chosen, least = fit, errors
    return chosen, sizes


def without_drift(fit, data):
    """Return ``fit(data)``, or the same with a drift beside it if that survives: a drift has to go on in whole blocks.

    Parameters
    ----------
    fit : callable
        Returns a fit to a Condensed.
    data : Condensed
    """
    return survivor([fit(data), fit(replace(data, drifts=True))], stretches=1, worth_it=DRIFTING)[0]
