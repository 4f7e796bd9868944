# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Lag, creep, drift and outliers taken out of a recording, for models that are fitted to what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hysteresis_ros.compensation.creep import creep_inverse
from hysteresis_ros.identification.cleaning import Cleaned, cleaned
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import found_with
from hysteresis_ros.identification.identified import at_rest
from hysteresis_ros.identification.inverse import undo
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.identification.request import Request
from hysteresis_ros.identification.start import Start, find_start
from hysteresis_ros.models.creep import Creep, creep


@dataclass(frozen=True, eq=False)
class Separated:
    """A recording without what stands behind a hysteresis and beside it.

    Parameters
    ----------
    cleaned : Cleaned
        The recording without outliers and drift.
    output : ndarray, shape (N,)
        Lag and creep undone too [m].
    part : LinearPart
        What stands behind the hysteresis.
    start : Start
        How the recording is taken to begin.
    warnings : tuple of str
        What is to be doubted of the separation.
    constant : float
        What was taken out of the output before creep was undone [m].
    """

    cleaned: Cleaned
    output: np.ndarray
    part: LinearPart
    start: Start
    warnings: tuple[str, ...]
    constant: float = 0.0

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
        """Voltages [V] from rest at 0 V to the first of these samples."""
        return self.start.before(self.cleaned.data.input)


def separated(data: IdentificationData, request: Request) -> Separated:
    """Return the data with lag and creep undone, outliers and drift taken out, and what is assumed of its past.

    A Preisach or a Prandtl-Ishlinskii model finds them, whichever leaves less: they leave the shape of the loops free.
    What was found is kept in the request, for the next model of the same data.

    Parameters
    ----------
    data : IdentificationData
    request : Request
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
        skip = None  # lag, creep and drift are told better without the beginning, which says more of the model
    # creep is always looked for: without it the search takes slow drifts for the noise a lag has to rise above
    looked_for = tuple(dict.fromkeys((*parts, "creep"))) if parts else ()
    options = dict(skip=skip, history=start.history, progress=request.report_residual)
    searches = ((fit_preisach, {}), (fit_prandtl_ishlinskii, {"zone_count": 0}))
    fits = [
        found_with(partial(search, **options, **settings), voltage, displacement, data.sample_time, looked_for, skip)
        for search, settings in (searches if parts else searches[1:])
    ]
    fit = min(fits, key=lambda item: item.rmse)
    # what repeats does not drift
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
