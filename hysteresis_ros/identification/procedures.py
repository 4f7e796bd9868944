# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One procedure per model: from checked data and a request to a chain of blocks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hysteresis_ros.identification.ambiguity import find_ambiguity
from hysteresis_ros.identification.chains import chain_of, identified, with_stage
from hysteresis_ros.identification.condensed import condense
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import found_with
from hysteresis_ros.identification.generalised_play import fit_generalised_play, rivals
from hysteresis_ros.identification.identified import Identification
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.preisach import WIDTHS, Density, fit_preisach
from hysteresis_ros.identification.request import FittedHysteresis, Request
from hysteresis_ros.identification.smooth_density import PRIOR_DECAY
from hysteresis_ros.identification.start import find_start
from hysteresis_ros.models.hysteresis.generalised_play import GeneralisedPlayParameters

#: Widths of the densities that trials of the past fit.
TRIED = 10
#: To how many samples data is made coarser for what it cannot tell.
COARSE = 2000


def prandtl_ishlinskii(data: IdentificationData, request: Request) -> Identification:
    """Plays (and dead zones) with lag, delay and creep, found together."""
    return _hammerstein(fit_prandtl_ishlinskii, data, request, _numbers_of_plays)


def usual(data: IdentificationData, request: Request) -> Identification:
    """The same, or plays between envelopes and with growing thresholds where blocks held out are predicted better."""
    return _hammerstein(partial(fit_prandtl_ishlinskii, rivals=rivals), data, request, _numbers_of_plays)


def preisach(data: IdentificationData, request: Request) -> Identification:
    """Everett map with lag, delay and creep, found together."""
    count = int(request.options.get("widths", WIDTHS)) + 3
    return _hammerstein(fit_preisach, data, request, lambda _: count, lambda data: Density(data, TRIED, TRIED))


def generalised_play(data: IdentificationData, request: Request) -> Identification:
    """Plays between envelopes, with thresholds that grow with the rate, with lag, delay and creep."""
    return _hammerstein(fit_generalised_play, data, request, _numbers_of_plays)


def _numbers_of_plays(parameters) -> int:
    """Return how many numbers of plays were fitted: weights, dead zones or envelopes and rate, and a constant."""
    between = 4 if isinstance(parameters, GeneralisedPlayParameters) else len(parameters.zone_weights)
    return len(parameters.weights) + between + 1


def _hammerstein(fit_function, data, request, count, structure=None) -> Identification:
    # a stage holds the lag itself, but the hysteresis must not take it for its own: it is found with one and handed on
    parts = ("lag", "delay") if request.stage else request.parts
    start = find_start(data, request.skip, request.initial, structure)
    voltage, displacement, skip = start.signals(data)
    options = dict(skip=skip, history=start.history, progress=request.report_residual, **request.options)
    fit = found_with(partial(fit_function, **options), voltage, displacement, data.sample_time, parts, skip)
    request = replace(request, model=fit.hysteresis.type)
    if start.kind != "zero":
        request = replace(request, initial=start.kind)
    found = FittedHysteresis(fit.hysteresis, count(fit.hysteresis.chosen), fit.deviations, fit.warnings, fit.converged)
    if request.stage:
        result = with_stage(data, replace(request, skip=start.skip), found)
    else:
        chain = chain_of(data, request, fit.hysteresis, fit.linear_part, fit.dynamics, fit.synchronous)
        result = identified(chain, request, found, fit.linear_part)
    request.progress(0, "what the recording cannot tell")
    coarse = condense(voltage, displacement, data.sample_time, skip, history=start.history, enough=COARSE)
    doubt = find_ambiguity(coarse, fit.linear_part, fit.hysteresis, fit.numbers.get("density_decay") == PRIOR_DECAY)
    numbers = {**result.numbers, **fit.numbers, **(doubt.numbers if doubt else {})}
    warnings = (*result.warnings, *fit.doubts, *(doubt.warnings if doubt else ()))
    return replace(result, numbers=numbers, warnings=warnings, skipped=start.skip, start=start.note, drift=fit.drift)
