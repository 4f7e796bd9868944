# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The past of a model found together with it, where the recording begins remanent.

Free loops tell that an actuator was remanent, and after about which voltage; how much of that another model remembers
is its own affair.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.separation import Separated
from hysteresis_ros.identification.start import TRIALS, remanence

#: The past is searched between these parts of the voltage that goes with the first fit, to this part of it.
NEAR, FINE = (0.6, 1.5), 3e-3
MOST_TRIALS = 14


def remembered(static: Separated, fit, block):
    """Return what ``fit`` finds, and the separation with the past that goes with it.

    Parameters
    ----------
    static : Separated
    fit : callable
        ``fit(static, before)`` returns the model; ``before``: what was found with another past, to start from.
    block : callable
        ``block(found)`` returns its block, at rest.
    """
    found = fit(static, None)
    if static.start.kind != "estimate":
        return found, static
    import scipy.optimize  # imported here because only fits need it

    largest, first = float(np.max(np.abs(static.cleaned.data.input))), float(static.cleaned.data.input[0])

    def after(voltage: float) -> Separated:
        start = replace(static.start, history=(voltage, first))
        words = "as asked for: " if start.note.startswith("as asked for") else ""
        return replace(static, start=replace(start, note=words + remanence(voltage)))

    def error(model, other: Separated) -> float:
        run = block(model)
        run.simulate(other.history)
        return float(np.std(run.simulate(other.voltage) - other.displacement))

    given = static.start.history[0]
    near = min((given, *(part * largest for part in TRIALS)), key=lambda voltage: error(found, after(voltage)))
    tried = {given: found}

    def cost(voltage: float) -> float:
        tried[voltage] = fit(after(voltage), found)
        return error(tried[voltage], after(voltage))

    ends = sorted(part * near for part in NEAR)
    search = scipy.optimize.minimize_scalar(
        cost, bounds=ends, method="bounded", options={"maxiter": MOST_TRIALS, "xatol": FINE * abs(near)}
    )
    best = min((given, float(search.x)), key=lambda voltage: error(tried[voltage], after(voltage)))
    return tried[best], after(best)
