# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``--model auto``: models that need no initial values, compared on the thirds of a recording left out of the fit."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.errors import HysteresisError, IdentificationError
from hysteresis_ros.identification import registry
from hysteresis_ros.identification.ambiguity import NOTABLE
from hysteresis_ros.identification.condensed import wiped_out
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.models.hysteresis import MODELS

#: Part of the recording that is held out, once at its end and once at its beginning.
HELD_OUT = 1.0 / 3.0
#: Fewest samples to compare on.
FEWEST = 50
#: Taken where the recording does not settle smaller loops, unless another error is below this part of its own.
PRIOR, MUCH_BETTER = "prandtl_ishlinskii", 0.5
#: Models of more freedom than the others have to err by this part less.
FREER, WORTH_IT = ("generalised_play",), 0.03


def choose_model(data: IdentificationData, linear: str | None, progress=None, **conditions):
    """Return the name of the model that predicts best what it was not fitted to, and the RMS errors of all.

    Each is fitted to the first and to the last two thirds, and predicts the third left out there, where the voltage
    stays within the range of the fit; a constant is free. Models that cannot be fitted are passed over, one of more
    freedom has to be better by three per cent. Where the recording does not settle smaller loops than its own
    (:mod:`.ambiguity`), what is left out shows nothing new: then the model that holds a stated prior is taken, unless
    another one errs by less than half.

    Parameters
    ----------
    data : IdentificationData
    linear : str, optional
        What stands behind the hysteresis.
    progress : callable, optional
        Called as ``progress(number, text)``.
    **conditions
        ``intersample`` and ``initial``.

    Returns
    -------
    str, dict of str to float
        [m]

    Raises
    ------
    IdentificationError
        No model can be fitted.
    """
    found: dict[str, float] = {}
    separations: tuple[dict, dict] = {}, {}
    doubts: dict[str, float] = {}
    reasons = []
    for number, (name, model) in enumerate(MODELS.items()):
        if not model.block.invertible:
            continue
        if progress is not None:
            progress(number, f"{name} on blocks held out")
        try:
            found[name], doubts[name] = held_out_error(data, name, separations=separations, linear=linear, **conditions)
        except HysteresisError as error:
            reasons.append(f"{name}: {' '.join(str(error).split())}")
    if not found:
        raise IdentificationError(
            f"model {registry.AUTO}: no model can be fitted to two thirds of this data; {reasons[0]}"
        )
    best = min(found, key=lambda name: found[name] / ((1.0 - WORTH_IT) if name in FREER else 1.0))
    if doubts.get(PRIOR, 0.0) > NOTABLE * data.stroke and found[best] > MUCH_BETTER * found[PRIOR]:
        best = PRIOR
    return best, found


def held_out_error(data: IdentificationData, model: str, separations=(None, None), **request) -> tuple[float, float]:
    """Return the RMS error [m] of a model on the thirds it was not fitted to, and what the data cannot tell of it [m].

    Parameters
    ----------
    data : IdentificationData
    model : str
    separations : pair of dict or None
        For the first and the last two thirds, see :func:`.registry.identify`.
    **request
        See :func:`.registry.identify`.

    Raises
    ------
    HysteresisError
        It cannot be fitted.
    """
    edge = round(HELD_OUT * len(data))
    known = wiped_out(data.input) or 0
    squares: list[np.ndarray] = []
    doubt = 0.0
    for part, rest, separated in (
        (slice(0, len(data) - edge), slice(len(data) - edge, None), separations[0]),
        (slice(edge, None), slice(known, edge), separations[1]),
    ):
        fit = registry.identify(data.part(*part.indices(len(data))[:2]), model, separations=separated, **request)
        doubt = max(doubt, fit.numbers.get("ambiguity_rms_m", 0.0))
        predicted = predict(fit.chain, data.input, data.sample_time, measured=data.output)
        voltage = data.input[part]
        inside = (data.input[rest] >= voltage.min()) & (data.input[rest] <= voltage.max())
        error = (data.output - predicted)[rest][inside]
        if error.size >= FEWEST:
            squares.append((error - error.mean()) ** 2)
    if not squares:
        raise IdentificationError("too few samples are left to compare models on")
    return float(np.sqrt(np.mean(np.concatenate(squares)))), doubt
