"""Structures compared on what they were not fitted to: each block of a recording is predicted by the rest of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

#: Blocks of equal length that are left out one after the other.
BLOCKS = 5
#: A more flexible structure must lower the RMS error on them by this part, and by so many standard errors.
WORTH_IT = 0.03
STANDARD_ERRORS = 1.0


def held_out(fit) -> np.ndarray:
    """Return the errors [m] on samples that the fit had not seen, shape (samples counted,), block after block.

    Parameters
    ----------
    fit : object
        With ``data`` (Condensed), ``refitted(data)`` and ``output()``, shape (N,).
    """
    data = fit.data
    places = np.arange(len(data.kept))
    errors = np.zeros(len(places))
    for block in np.array_split(places, BLOCKS):
        left_out = np.isin(places, block)
        other = fit.refitted(replace(data, kept=data.kept & ~left_out))
        errors[block] = (data.displacement - other.output())[data.first :][block]
    return errors[data.kept]


def survivor(fits):
    """Return the fit to keep, and the RMS errors on blocks held out [m] of all.

    Parameters
    ----------
    fits : sequence of object
        The simplest first; a later one is taken only where it predicts what it has not seen better by
        :data:`WORTH_IT`, and in more than one block by chance.

    Returns
    -------
    object, list of float
    """
    chosen, least, sizes = fits[0], None, []
    for fit in fits:
        errors = held_out(fit)
        sizes.append(float(np.sqrt(np.mean(errors**2))))
        if least is None:
            least = errors
            continue
        gains = np.array([part.mean() for part in np.array_split(least**2 - errors**2, BLOCKS)])
        sure = gains.mean() > STANDARD_ERRORS * gains.std(ddof=1) / np.sqrt(BLOCKS)
        if sizes[-1] < (1.0 - WORTH_IT) * np.sqrt(np.mean(least**2)) and sure:
            chosen, least = fit, errors
    return chosen, sizes


def without_drift(fit, data):
    """Return ``fit(data)``, or the same with a drift beside it if that survives.

    Parameters
    ----------
    fit : callable
        Returns a fit to a Condensed.
    data : Condensed
    """
    return survivor([fit(data), fit(replace(data, drifts=True))])[0]
