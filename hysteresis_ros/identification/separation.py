"""Lag and creep taken out of a recording, for models that are fitted to what is left."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hysteresis_ros.compensation.creep import creep_inverse
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import found_with
from hysteresis_ros.identification.identified import at_rest
from hysteresis_ros.identification.inverse import undo
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.identification.request import Request
from hysteresis_ros.models.creep import Creep, creep


def separated(data: IdentificationData, request: Request):
    """Return the data with lag and creep undone, both, and what must be said about them; and the constant taken out.

    A Preisach or a Prandtl-Ishlinskii model finds them, whichever leaves less: they leave the shape of the loops free.

    Parameters
    ----------
    data : IdentificationData
    request : Request
    """
    parts = ("lag", "delay") if request.stage else request.parts
    if not parts:
        return data, LinearPart(), (), 0.0
    # creep is always looked for: without it the search takes slow drifts for the noise a lag has to rise above
    searches = ((fit_preisach, {}), (fit_prandtl_ishlinskii, {"zone_count": 0}))
    fits = [
        found_with(
            partial(search, skip=request.skip, progress=request.report_residual, **settings),
            data.input,
            data.output,
            data.sample_time,
            tuple(dict.fromkeys((*parts, "creep"))),
            request.skip,
        )
        for search, settings in searches
    ]
    fit = min(fits, key=lambda item: item.rmse)
    part = fit.linear_part if "creep" in parts else replace(fit.linear_part, creep_rate=0.0, settled=False)
    output, constant = data.output, 0.0
    if part.modes or part.lag + part.delay >= 0.1 * data.sample_time:
        output = undo(output, part, data.sample_time)
    else:
        part = replace(part, lag=0.0, delay=0.0)
    if part.creep.type != "none":
        constant = at_rest(fit.hysteresis, data.sample_time) * part.settled_gain
        output = undo_creep(output - constant, part, data.sample_time)
    return replace(data, output=output), part, fit.warnings, constant


def undo_creep(y, part: LinearPart, sample_time: float) -> np.ndarray:
    """Return the displacement [m], shape (N,), that creeps to ``y``: step by step, as the compensator does it.

    Parameters
    ----------
    y : array_like, shape (N,)
        [m], zero at rest.
    part : LinearPart
        Its creep; ``settled`` says whether it had settled under the first sample.
    sample_time : float
        [s]
    """
    y = np.ascontiguousarray(y, dtype=np.float64)
    block = Creep(part.creep, sample_time)
    block.settle(float(y[0]) / part.settled_gain if part.settled else 0.0)
    found = np.empty_like(y)
    for k in range(y.size):
        found[k] = creep_inverse(block.p, block.x, y[k])
        creep(block.p, block.x, found[k])
    return found
