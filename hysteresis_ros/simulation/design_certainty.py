# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs that stay stable for all that an identification leaves open of the plant's frequency response."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.control.gain_design import Designed
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.response_uncertainty import KEPT, Borne, ResponseUncertainty
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.identification.parameter_file import SECTION

#: The bandwidth is halved up to so often, and then raised again in so many steps.
HALVINGS, RAISED = 18, 3
#: Variances of the input's noise that are tried for a slower observer, over that of the measurement.
OBSERVERS = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-5, 1e-7)
#: ``design(bandwidth, q)``.
Design = Callable[[float | None, float | None], Designed]


def response_uncertainty(configuration: Configuration) -> ResponseUncertainty | None:
    """Return what an identification wrote into a parameter file about the response; None where it did not.

    Parameters
    ----------
    configuration : Configuration

    Raises
    ------
    ConfigurationError
        What stands there is no uncertainty.
    """
    found = next((values for name, values in configuration.entries if name == SECTION), {})
    if "response.uncertainty" not in found:
        return None
    try:
        frequencies, relative = (
            np.array(found[f"response.{name}"], dtype=float) for name in ("frequencies", "uncertainty")
        )
        known_to = float(found.get("response.known_to", np.inf))
    except (KeyError, TypeError, ValueError):
        frequencies, relative, known_to = np.ones(1), np.zeros(0), 0.0
    rising = frequencies.shape == relative.shape and frequencies.ndim == 1 and bool(np.all(np.diff(frequencies) > 0.0))
    if not rising or not np.all(relative >= 0.0) or np.isnan(known_to):
        raise ConfigurationError(
            f"{configuration.source}: {SECTION}: response.frequencies and response.uncertainty must be as many numbers,"
            " frequencies rising, uncertainties not below 0; identify again, or remove the entries response.*"
        )
    return ResponseUncertainty(frequencies, relative, known_to)


def borne(found: Designed, response: ResponseUncertainty, sample_time: float) -> Borne:
    """Return what is certain of a design.

    Parameters
    ----------
    found : Designed
    response : ResponseUncertainty
    sample_time : float
        [s]
    """
    return response.borne_by(*whole_loop(found.parameters, sample_time), sample_time)


def certain_design(
    first: Designed, design: Design, request, response: ResponseUncertainty | None, sample_time: float
) -> Designed:
    """Return a design that is stable for all plants that the identification leaves possible.

    What was not asked for is slowed down: first the observer, then the response to the reference.

    Parameters
    ----------
    first : Designed
        What is to be certain.
    design : callable
        ``design(bandwidth, q)`` returns another; None for values of its own.
    request : DesignRequest
        What was asked for stays.
    response : ResponseUncertainty, optional
        Without one the first is taken as it is.
    sample_time : float
        [s]

    Raises
    ------
    ConfigurationError
        No design is certain; names the frequency and what would be.
    """
    if response is None:
        return first
    certain = borne(first, response, sample_time)
    if certain.distance >= KEPT:
        return first

    observes = request.q is None and "kalman" in first.parameters.law.groups
    observers = OBSERVERS if observes else (request.q,)

    def found_with(bandwidth: float | None) -> Designed | None:
        if observes and not _bears_unknown(design, bandwidth, observers[-1], response, sample_time):
            return None  # a faster observer has more gain there
        for q in observers:
            with contextlib.suppress(ParameterError):  # the law does not reach this one
                found = design(bandwidth, q)
                if borne(found, response, sample_time).distance >= KEPT:
                    return found
        return None

    slower = None
    if not request.criterion:
        slower = found_with(request.bandwidth)
        if slower is None and request.bandwidth is None:
            slower = _slower(found_with, min(first.margins.bandwidth, 0.4 / sample_time))
    if slower is not None:
        return slower
    known = response.assumption(sample_time)
    if certain.frequency <= response.known_to or not known:
        known = f"the response is known there to {100.0 * certain.uncertainty:.0f} % only"
    raise ConfigurationError(
        f"the model is not fit for this feedback at {certain.frequency:.4g} Hz: {known}; ask for a lower bandwidth or "
        "none, take another controller (pid), or identify from a recording with content there (hysteresis excite "
        "--recipe multisine)"
    )


def _bears_unknown(design: Design, bandwidth, q, response: ResponseUncertainty, sample_time: float) -> bool:
    """Return whether a design leaves room for what may stand where nothing is known; True if there is no design."""
    with contextlib.suppress(ParameterError):
        found = borne(design(bandwidth, q), response, sample_time)
        return found.distance >= KEPT or found.frequency <= response.known_to
    return True


def _slower(found_with: Callable[[float], Designed | None], fast: float) -> Designed | None:
    """Return the fastest design that is certain, from a bandwidth downwards."""
    for _ in range(HALVINGS):
        slow = 0.5 * fast
        best = found_with(slow)
        if best is not None:
            for _ in range(RAISED):
                middle = float(np.sqrt(slow * fast))
                found = found_with(middle)
                slow, fast, best = (slow, middle, best) if found is None else (middle, fast, found)
            return best
        fast = slow
    return None
