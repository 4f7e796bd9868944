# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prandtl-Ishlinskii models from data, together with lag, delay and creep: smooth density, classical, and modified.

Three structures compete: an exponential density with a cubic map behind it (:mod:`.smooth_density`, few numbers), plays
with free weights, and these with dead zones behind them (:mod:`.free_weights`). One with more freedom is taken only
where it predicts blocks of the recording better that it was not fitted to (:mod:`.held_out`).
"""

from __future__ import annotations

from dataclasses import replace

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.condensed import Condensed, condense, simple_loops
from hysteresis_ros.identification.finished import finished, without_outliers
from hysteresis_ros.identification.free_weights import FreeWeights
from hysteresis_ros.identification.hammerstein import HammersteinFit
from hysteresis_ros.identification.held_out import WORTH_IT, survivor, without_drift
from hysteresis_ros.identification.smooth_density import SmoothDensity

PLAYS = 20
ZONES = 5
#: Where all loops are of one size nothing held out is new, and freedom has to lower the error by this part.
ALONE = 0.3
#: A model of another kind has to err by less than this part there: it holds no prior.
OF_ANOTHER_KIND = 0.5
#: How the weights of the plays may run over the radius.
DENSITIES = ("auto", "exponential", "free")


def fit_prandtl_ishlinskii(
    voltage,
    displacement,
    sample_time: float,
    *,
    play_count: int = PLAYS,
    zone_count: int | None = None,
    density: str = "auto",
    linear=("lag", "delay", "creep"),
    skip: int | None = None,
    history: tuple[float, ...] = (),
    progress=None,
    rivals=None,
    like=None,
) -> HammersteinFit:
    """Fit voltage → plays → dead zones → creep → lag and delay.

    Parameters
    ----------
    voltage, displacement : array_like, shape (N,)
        [V] and [m], uniformly sampled.
    sample_time : float
        [s]
    play_count : int
        Plays, in equal steps up to half the range of the voltage.
    zone_count : int, optional
        Dead zones behind free weights; 0 for the classical model. By default five, if they survive.
    density : str
        ``exponential``, ``free``, or ``auto``: what predicts blocks held out; free where ``zone_count`` is given.
    linear : sequence of str
        Which of ``lag``, ``delay`` and ``creep`` may be there; each is kept only if it lowers the residual.
    skip : int, optional
        Samples left out of the fit at the start, see :func:`.condensed.condense`.
    history : tuple of float
        Voltages [V] that the hysteresis went through, from rest at 0 V, before the first sample.
    progress : callable, optional
        Called as ``progress(evaluations, rmse)``.
    rivals : callable, optional
        ``rivals(fit, progress)`` returns fits of other kinds that compete too, for a fit with a smooth density.
    like : object, optional
        ``structure`` of a fit before, which is kept.

    Raises
    ------
    IdentificationError
        The data or the settings cannot be used; the message says why.
    """
    if density not in DENSITIES:
        raise IdentificationError(f"density = {density!r}: must be one of {', '.join(DENSITIES)}")
    if density == "exponential" and zone_count is not None:
        raise IdentificationError("zone_count goes with density=free; an exponential density has a map of its own")

    found: list = [] if like is None else [like]

    def once(kept):
        data = condense(voltage, displacement, sample_time, skip, kept=kept, history=history)
        if not found:
            found.append(_chosen(data, play_count, zone_count, density, linear, progress, rivals))
        else:  # without outliers, or behind other dynamics: the same structure
            before = found.pop()
            found.append(before.like(replace(data, drifts=before.data.drifts)).fit(linear, progress))
            found[0].numbers = {**before.numbers, **found[0].numbers}
        return finished(found[0], voltage, displacement, sample_time, kept)

    fit = without_outliers(once, voltage, displacement)
    return replace(fit, structure=found[0])


def _chosen(data: Condensed, play_count: int, zone_count: int | None, density: str, linear, progress, others):
    """Return the fit of the structure that predicts best what it has not seen."""
    if zone_count is not None:
        return without_drift(lambda data: FreeWeights(data, play_count, zone_count).fit(linear, progress), data)
    if density == "free":
        rivals = [without_drift(lambda data: FreeWeights(data, play_count, 0).fit(linear, progress), data)]
    else:
        rivals = [without_drift(lambda data: SmoothDensity(data, play_count).fit(linear, progress), data)]
        if density == "exponential":
            return rivals[0]
        rivals.append(FreeWeights(rivals[0].data, play_count, 0).fit(linear, progress))
    # dead zones behind the linear part that suits best without them; if they survive they get a search of their own
    part = min(rivals, key=lambda fit: fit.rms).part
    zones = FreeWeights(rivals[0].data, play_count, ZONES).behind(part)
    rivals.append(zones)
    alone = simple_loops(data) and density == "auto"
    worth = [ALONE if alone else WORTH_IT] * len(rivals)
    rivals += others(rivals[0], progress) if others else []
    worth += [OF_ANOTHER_KIND if alone else WORTH_IT] * (len(rivals) - len(worth))
    chosen, errors = survivor(rivals, worth_it=worth)
    if chosen is zones:
        zones.fit(linear, progress)
    chosen.numbers["held_out_rmse_m"] = errors[rivals.index(chosen)]
    return chosen
