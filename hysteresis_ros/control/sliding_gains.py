# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of the sliding mode controllers for a model: reaching law and Kalman filter for a bandwidth.

Two numbers determine the speed of such a loop: the pole that sets the bandwidth of the response to the reference, and
the bandwidth of the Kalman filter. A faster filter rejects disturbances faster, but reduces the margins. A search
varies both numbers on grids that become finer around the best point. Among the points that meet the requirements, the
best one has the largest product of bandwidth and rejection. A bandwidth above that of the feedback does not count as
better, because tracking above the bandwidth of the feedback depends on the accuracy of the model. If no point meets the
requirements, the point that comes closest to them is returned; its margins show which requirements it does not meet.
The equations of hyperplane and feedback gain are in :mod:`.state_feedback`; the equations of the laws are in ``laws/``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.kalman import KalmanParameters, filter_gain
from hysteresis_ros.control.law import DesignTask
from hysteresis_ros.control.margins import Judged, Requirements, judge
from hysteresis_ros.control.sliding_surface import design_sliding_mode
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models import elementary
from hysteresis_ros.models.linear_algebra import eigenvalues, product

#: Largest bandwidth of the pole [cycles per sample], and maximum number of its halvings.
FASTEST_POLE = 0.25
HALVINGS = 12
#: Slowest and fastest filter, as exponents of two: the change of the disturbance per sample divided by the measurement
#: noise, as the filter assumes both.
SLOWEST_FILTER, FASTEST_FILTER = -12, 14
#: Weight of the penalty on a bandwidth above the bandwidth of the feedback.
IN_VAIN = 0.05
#: Steps of the grids, in exponents of two, from coarse to fine.
STEPS = (2.0, 1.0, 0.5)


def wandering(given: KalmanParameters, disturbance: str, size: float) -> KalmanParameters:
    """Return the filter for a disturbance that changes by about ``size`` [input unit] per sample.

    The ratios of the noises are fixed. Form, measurement noise and disturbance frequency are taken from ``given``;
    ``disturbance`` is the kind of disturbance.
    """
    variance = size * size
    parts: dict[str, dict[str, Any]] = {
        # without an estimated disturbance, the filter must follow the measurement, or the estimate would not show a
        # mismatch
        "none": {"q": 100.0 * variance},
        "constant": {"q": 0.01 * variance, "q_disturbance": variance},
        "ramp": {"q": 0.01 * variance, "q_disturbance": 0.01 * variance, "q_disturbance_rate": 0.09 * variance},
        "periodic": {"q": 0.01 * variance, "q_disturbance": variance, "q_disturbance_periodic": variance},
    }
    return replace(given, gain="riccati", L=(), Q=(), disturbance=disturbance, **parts[disturbance])


def scaled(given: KalmanParameters, size: float) -> KalmanParameters:
    """Return the filter with the RMS of all process noises multiplied by ``size``."""
    names = ("q", "q_disturbance", "q_disturbance_rate", "q_disturbance_periodic")
    noises: dict[str, Any] = {name: getattr(given, name) * size * size for name in names}
    return replace(given, Q=tuple(value * size * size for value in given.Q), **noises)


def solved(parameters, sample_time: float):
    """Return the parameters with hyperplane and filter gain as numbers, so that a search solves no Riccati equation."""
    model = parameters.model.dynamics.state_space
    S = design_sliding_mode(parameters.sliding_mode, model).S
    L = filter_gain(parameters.kalman, model, sample_time)
    return replace(
        parameters,
        sliding_mode=replace(parameters.sliding_mode, hyperplane="given", S=tuple(S.tolist())),
        kalman=replace(parameters.kalman, gain="given", L=tuple(L.tolist())),
    )


class GainSearch:
    """Search over points; a point is an exponent of two (filter) and a number of halvings (bandwidth of the pole).

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters with the filter to scale.
    sample_time : float
        [s]
    judged : callable
        ``judged(parameters)`` returns a :class:`Judged`.
    place : callable or None
        ``place(parameters, pole)`` returns the parameters with this pole, which sets the bandwidth. None if the
        controller has no such pole.
    aimed : Requirements
    """

    def __init__(self, parameters, sample_time: float, judged: Callable[[Any], Judged], place, aimed: Requirements):
        self.parameters, self.sample_time, self.judged = parameters, sample_time, judged
        self.place, self.aimed = place, aimed
        decays = -np.log(np.maximum(np.abs(parameters.model.dynamics.state_space.poles), 1e-12))
        self.own = float(np.min(decays)) / (2.0 * math.pi * sample_time)
        self._solved: dict[float, Any] = {}
        self._scores: dict[tuple[float, float], tuple] = {}

    def at(self, power: float, halvings: float, parameters=None):
        """Return the parameters that belong to a point."""
        given = parameters or self._filtered(power)
        return self.place(given, pole_of(halvings)) if self.place else given

    def _filtered(self, power: float):
        return replace(self.parameters, kalman=scaled(self.parameters.kalman, power_of_two(power)))

    def score(self, point: tuple[float, float]) -> tuple:
        """Return the merit of a point, for comparison; a point that meets the requirements is better than any other."""
        if point not in self._scores:
            try:
                self._scores[point] = self._score(*point)
            except ParameterError:  # there is no such filter, or the loop is unstable
                self._scores[point] = (False, -math.inf)
        return self._scores[point]

    def _score(self, power: float, halvings: float) -> tuple:
        if power not in self._solved:
            self._solved[power] = solved(self._filtered(power), self.sample_time)
        found = self.judged(self.at(power, halvings, self._solved[power]))
        if not found.meets(self.aimed):
            return False, -excess(found, self.aimed)
        bandwidth = min(found.bandwidth, 0.5 / self.sample_time)
        followed = max(found.feedback, self.own)
        rejected = max(found.rejection, 1e-9 * self.own)
        gained = math.log(rejected) + math.log(min(bandwidth, followed))
        # rounded, so that the last digits, which differ between LAPACK and C libraries, have no effect
        return True, round(gained - IN_VAIN * max(math.log(bandwidth / followed), 0.0), 6)

    def best(self, powers: tuple[float, float]) -> tuple[float, float]:
        """Return the best point whose exponent for the filter is within bounds.

        Parameters
        ----------
        powers : (float, float)
            Lowest and highest exponent.
        """
        low, high = powers
        count = int((high - low) / STEPS[0])
        poles = [STEPS[0] * i for i in range(int(HALVINGS / STEPS[0]) + 1)] if self.place else [0.0]
        point = max(((high - STEPS[0] * i, pole) for i in range(count + 1) for pole in poles), key=self.score)
        for step in STEPS[1:]:
            while True:
                near = [(point[0] + step * i, point[1] + step * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
                allowed = [
                    (i, j) for i, j in near if low <= i <= high and 0.0 <= j <= HALVINGS and (j == 0.0 or self.place)
                ]
                following = max([point, *allowed], key=self.score)
                if following == point:
                    break
                point = following
        return point


def power_of_two(exponent: float) -> float:
    """Return 2 to a power that is a multiple of 0.5, correctly rounded."""
    return math.sqrt(math.ldexp(1.0, round(2.0 * exponent)))


def pole_of(halvings: float) -> float:
    """Return the pole, to four digits, with the bandwidth :data:`FASTEST_POLE` after this number of halvings."""
    angle = 2.0 * math.pi * FASTEST_POLE * power_of_two(-halvings)
    return 1.0 - float(f"{1.0 - elementary.exp(-angle):.4g}")


def excess(found: Judged, aimed: Requirements) -> float:
    """Return the largest factor by which a loop misses a requirement."""
    return max(
        found.sensitivity_peak / aimed.sensitivity_peak,
        aimed.delay_margin / max(found.delay_margin, 1e-12),
        found.command_noise_gain / aimed.command_noise_gain,
        found.late_sensitivity_peak / aimed.late_sensitivity_peak,
    )


#: Input weight of the LQ problem as a fraction of the squared DC gain.
INPUT_WEIGHT = 0.025
#: Largest pole in the search for a requested bandwidth, and relative accuracy of this search.
SLOWEST = 0.99999
PRECISION = 1e-5
#: A requested bandwidth may be below the smallest possible one by at most this fraction.
TOLERANCE = 0.01


def sliding_gains(task: DesignTask, name: str, place: Callable[[Any, float], Any] | None, disturbed: bool = True):
    """Return the parameters of a sliding mode controller with an LQ hyperplane.

    Parameters
    ----------
    task : DesignTask
    name : str
        Name of the design, for messages.
    place : callable or None
        ``place(parameters, pole)`` returns the parameters with this pole, which sets the bandwidth. None if the
        controller has no such pole.
    disturbed : bool
        Whether the Kalman filter estimates a disturbance.

    Raises
    ------
    ParameterError
        The model has no state, or the bandwidth cannot be reached.
    """
    given, dynamics = task.parameters, task.parameters.model.dynamics
    if not dynamics.order:
        state_feedback.refuse(
            "model.dynamics.A", dynamics.A, f"{name} needs a model with at least one state; choose pid"
        )
    found = replace(given, sliding_mode=lq_surface(given.sliding_mode, dynamics))
    kept = given.kalman.disturbance if given.kalman.disturbance != "none" else "constant"
    disturbance = kept if disturbed else "none"
    fixed = replace(found, kalman=_kalman(given.kalman, disturbance, task.q))
    if task.bandwidth is not None and place is not None:
        pole = _pole_for(task, partial(place, solved(fixed, task.sample_time)))
        fixed, found, place = place(fixed, pole), place(found, pole), None
    if task.q is not None or fixed.kalman.gain == "given":
        search = GainSearch(fixed, task.sample_time, task.judge, place, task.aimed)
        point = search.best((0.0, 0.0))
        if task.q is not None or search.score(point)[0]:
            return search.at(*point)
    noise = math.sqrt(given.kalman.r) or 1.0
    kalman = wandering(replace(given.kalman, r=noise * noise), disturbance, noise / abs(dynamics.matrices.dc_gain))
    search = GainSearch(replace(found, kalman=kalman), task.sample_time, task.judge, place, task.aimed)
    return search.at(*search.best((SLOWEST_FILTER, FASTEST_FILTER)))


def lq_surface(given, dynamics):
    """Return the parameters with the hyperplane of an LQ problem that weighs output and input."""
    gain = dynamics.matrices.dc_gain
    empty: dict[str, Any] = {name: () for name in ("S", "poles", "poles_imaginary", "lq_state_weight")}
    return replace(given, tracking="target", hyperplane="lq", lq_input_weight=INPUT_WEIGHT * gain * gain, **empty)


def _kalman(given, disturbance: str, q: float | None):
    """Return the filter; a given gain is kept if its disturbance model stays the same and no q is requested."""
    if given.gain == "given" and disturbance == given.disturbance and q is None:
        return given
    noise = given.q if q is None else q * given.r
    Q = given.Q if q is None else ()
    return replace(given, gain="riccati", L=(), disturbance=disturbance, q=noise, Q=Q)


def reaching_law(parameters, pole: float):
    """Return the parameters with the Φ of the reaching law set to ``pole``."""
    return replace(parameters, sliding_mode=replace(parameters.sliding_mode, phi=pole))


def sliding_pole(parameters, pole: float):
    """Return the parameters with ``pole`` as slowest pole of the sliding motion, together with the fast LQ poles."""
    model = parameters.model.dynamics.state_space
    n, A, B = model.order, model.A, model.B
    S = design_sliding_mode(parameters.sliding_mode, model).S
    sliding = eigenvalues(A - product(B, product(S, A)[np.newaxis]) / product(S, B).item())
    sizes = sorted(math.sqrt(pole.real * pole.real + pole.imag * pole.imag) for pole in sliding)
    fastest = sizes[1 : n - 1]  # without the pole at 0, which does not belong to the sliding motion
    poles = (pole, *fastest)
    chosen = replace(parameters.sliding_mode, hyperplane="poles", S=(), poles=poles, poles_imaginary=())
    return replace(parameters, sliding_mode=chosen)


def _pole_for(task: DesignTask, with_pole) -> float:
    """Return the pole that gives the requested bandwidth; the bandwidth increases as the pole decreases from 1 to 0."""
    bandwidth = task.bandwidth

    def reached(pole):
        return judge(*task.loop(with_pole(pole)), task.sample_time).bandwidth

    fast, slow = 0.0, SLOWEST
    if not bandwidth <= reached(fast):
        state_feedback.refuse(
            "bandwidth", bandwidth, f"this controller reaches at most {reached(fast):.4g} Hz on its model"
        )
    least = reached(slow)
    if bandwidth < least * (1.0 - TOLERANCE):
        remedy = (
            f"the smallest bandwidth of this controller on its model is {least:.4g} Hz, because eta "
            "and beta/delta add to the reaching law inside the boundary layer; lower them, or "
            "request a larger bandwidth"
        )
        state_feedback.refuse("bandwidth", bandwidth, remedy)
    while slow - fast > PRECISION * (1.0 - slow):
        middle = 0.5 * (fast + slow)
        if reached(middle) < bandwidth:
            slow = middle
        else:
            fast = middle
    return fast


def surface_row(found) -> tuple[str, str]:
    """Return name and text of the row for the hyperplane in the table of a design."""
    return "hyperplane S", ", ".join(f"{value:.6g}" for value in found.S)


def filter_row(parameters) -> tuple[str, str]:
    """Return name and text of the row for the Kalman filter in the table of a design."""
    kalman = parameters.kalman
    return "Kalman filter", f"q/r {kalman.q / kalman.r:.4g}" if not kalman.L else "given L"


def reaching_rows(parameters, sample_time: float):
    """Return (name, text) of each row that a design prints if it sets Φ of the reaching law."""
    law = parameters.sliding_mode
    found = design_sliding_mode(law, parameters.model.dynamics.state_space)
    gains = ", ".join(f"{value:.6g}" for value in found.K)
    return [surface_row(found), ("linear gain K", gains), ("phi", f"{law.phi:.6g}"), filter_row(parameters)]


def integration_warning(parameters, prefix: str) -> tuple[str, ...]:
    """Return a warning if the law responds to disturbances only through the innovations of the Kalman filter."""
    if parameters.kalman.disturbance != "none":
        return ()
    return (
        f"{prefix}kalman.disturbance = none: {parameters.type} detects a disturbance only "
        "through the innovation and rejects only a part of it; choose constant",
    )
