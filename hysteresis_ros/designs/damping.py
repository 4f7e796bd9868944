# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Design of a damping filter for a model: the filter that permits the fastest outer loop, and its performance.

For every filter a PID is designed on the damped model. The zeros of the PID cancel the slowest poles, as in the design
of ``pid``. The largest gain g of the PID follows in closed form on a grid of frequencies: if X is the loop for g = 1,
|1 + g X| ≥ 1/M_s is a quadratic inequality in g at each frequency. A filter is rated by its worst result on several
plants: the model, and plants with lower and higher resonances. The inner loop alone, and the loop with both feedbacks,
cut at the plant, must also have M_s ≤ 2; the latter should tolerate one more sample of delay. Filters are tried on a
grid that is refined around the best filter; the result has four digits.

References
----------
.. [1] Fleming, Aphale & Moheimani, IEEE Trans. Nanotechnology 9 (2010) 438-448 (ranks a damping by the integral gain
   that the damped plant permits).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product as combinations

import numpy as np

from hysteresis_ros.control import state_feedback
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.inner_loop import (
    KINDS,
    NONE,
    DampingParameters,
    InnerLoop,
    closing,
    inner_loop,
    modes,
    require_force,
)
from hysteresis_ros.control.damping.kind import COMMAND, FORCE, Mode
from hysteresis_ros.control.laws.pid import FILTER, PidParameters, pid_state_space, pid_with_zeros, slowest_poles
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import REQUIRED, Margins, judge, margins_of
from hysteresis_ros.control.uncertainty import PossiblePlant, possible_plant
from hysteresis_ros.errors import ConfigurationError, ParameterError, did_you_mean
from hysteresis_ros.models.linear import BOUNDARY, LinearParameters, StateSpace
from hysteresis_ros.models.sensor import ForceParameters

#: M_s at which the search aims, for the law's loop and for the loop cut at the plant.
SENSITIVITY = 1.9
#: Default relative uncertainty of resonance frequencies.
RESONANCE = 0.1
#: Number of grid points in each dimension, for 1, 2 or 3 dimensions; number of refinements.
POINTS = {1: 41, 2: 13, 3: 8}
REFINED = 3
#: Number of grid frequencies on the logarithmic scale, and also on the linear scale.
GRID = 120
#: Number of grid frequencies around each pole of the plants.
AROUND = 41
#: The first test of a filter uses only every FEW-th frequency of the grid.
FEW = 6
#: Damping ratio that suffices for every mode of the inner loop.
WELL = 0.02
#: A mode with a smaller damping ratio is allowed if its damping ratio is at least this multiple of that of the plant's
#: mode.
MUCH = 5.0
#: Allowance for rounded poles: a filter is rejected early only if this factor times its speed does not exceed the best
#: speed so far.
CLEARLY = 1.001
#: Damping ratio above which a mode needs no damping filter.
DAMPED = 0.7


def mode_to_damp(dynamics: LinearParameters, sample_time: float, force: ForceParameters | None = None) -> Mode:
    """Return the least damped resonance of the model.

    Units: ``sample_time`` [s].
    """
    there = [mode for mode in modes(dynamics.matrices.poles.astype(complex), sample_time) if mode[1] < DAMPED]
    if not there:
        remedy = f"has no resonance with damping below {DAMPED:g}: nothing to damp; design without --damping"
        state_feedback.refuse("model.dynamics.A", dynamics.A, remedy)
    gain = dynamics.matrices.dc_gain * dynamics.output_scale / dynamics.resolved_input_scale
    return Mode(*there[0], gain, 0.0 if force is None else force.whole * gain)


def damping_plants(
    dynamics: LinearParameters, sample_time: float, resonance: float = RESONANCE, *, acting: bool = False
) -> tuple[PossiblePlant, ...]:
    """Return the plants on which a damping is evaluated: the model, and plants that are faster and slower.

    Units: ``sample_time`` [s].
    """
    slow = (1.0,) if resonance == 0.0 else (1.0, 1.0 - resonance, 1.0 + resonance)
    return tuple(possible_plant(dynamics, sample_time, 1.0, slowness, acting=acting) for slowness in slow)


def design_damping(
    kind: str,
    dynamics: LinearParameters,
    sample_time: float,
    plants: tuple[PossiblePlant, ...],
    force: ForceParameters | None = None,
    peak: float = REQUIRED.sensitivity_peak,
) -> DampingParameters:
    """Return the best damping filter of a kind for a model; a lower ``peak`` (largest M_s) gives a weaker damping.

    Units: ``sample_time`` [s].
    """
    search = _Search(kind, dynamics, sample_time, plants, force, peak)
    if KINDS[kind].source == FORCE:
        require_force(kind, force)
    # first search for a filter that tolerates one more sample of delay; without success, one for the modelled delay
    for late in (REQUIRED.delay_margin, 0.0):
        found = search.best(late)
        if found is not None:
            return found
    found_at = f"{search.mode.frequency:.4g} Hz"
    remedy = (
        f"no {kind} damps the resonance at {found_at} on all plants well enough for a PID with M_s ≤ {peak:g};"
        " choose another kind, a higher sample rate or less delay"
    )
    return state_feedback.refuse("model.dynamics.A", dynamics.A, remedy)


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the unit circle, and the response of each plant at these points, shape (N, outputs)."""

    z: np.ndarray
    responses: list[np.ndarray]


class _Search:
    """Search for a filter, with the responses of the plants on a grid of frequencies."""

    def __init__(self, kind: str, dynamics: LinearParameters, sample_time: float, plants, force, peak: float):
        self.mode = mode_to_damp(dynamics, sample_time, force)
        self.force = force
        self.peak = peak  # largest M_s
        self.aimed = SENSITIVITY / REQUIRED.sensitivity_peak * peak
        self.kind, self.dynamics, self.sample_time = KINDS[kind], dynamics, sample_time
        self.plants = plants
        z = np.exp(1j * _angles(plants))
        self.all = _Points(z, [one.plant.response(z)[:, :, 0] for one in plants])
        self.few = _Points(z[::FEW], [P[::FEW] for P in self.all.responses])

    def damping(self, point) -> DampingParameters:
        """Return the parameters of the filter at a point of the search."""
        return replace(DampingParameters(), type=self.kind.name, **{self.kind.name: self.kind.chosen(point, self.mode)})

    def speed(self, point, late: float, least: float) -> float:
        """Return the integral gain [1/s] of the fastest PID around the filter at a point; 0: not above ``least``.

        Units: ``late`` [samples].
        """
        try:
            loop = inner_loop(self.damping(point), self.dynamics, self.sample_time, self.force)
        except (ParameterError, np.linalg.LinAlgError):
            return 0.0
        if not loop.direct > 0.0:
            return 0.0
        found = loop.around(self.plants[0].plant)
        poles = found.poles
        if np.max(np.abs(poles)) >= 1.0 - BOUNDARY:
            return 0.0
        # most filters are much slower than the best one; a quick test with a few frequencies and rounded poles rejects
        # them
        outer, Ki = self._outer(slowest_poles(found, poles.tolist()))
        for largest in (self._bound, self._gain):
            if not largest(loop, outer) * Ki * CLEARLY > least:
                return 0.0
        outer, Ki = self._outer(slowest_poles(found))
        gain = self._gain(loop, outer)
        if not gain * Ki > least or not self._holds(loop, outer.scaled(gain), late):
            return 0.0
        return gain * Ki

    def _outer(self, zeros) -> tuple[StateSpace, float]:
        """Return the PID of unit gain with these zeros, and its integral gain [1/s]."""
        cut_off = FILTER * 2.0 * np.pi / self.sample_time
        Kp, Ki, Kd = pid_with_zeros(zeros, 1.0, self.sample_time, cut_off)
        return pid_state_space(PidParameters(Kp=Kp, Ki=Ki, Kd=Kd, derivative_filter=cut_off), self.sample_time), Ki

    def _loops(self, loop: InnerLoop, outer: StateSpace, points: _Points):
        """Return for each plant 1 + L of the inner loop, and the law's open loop without the inner loop."""
        filtered = loop.feedback.response(points.z)[:, 0, 0]
        forward = outer.response(points.z)[:, 0, 0] * (filtered if loop.source == COMMAND else loop.forward)
        back = 0.0 if loop.source == COMMAND else filtered
        return [(1.0 - back * (P * loop.seen[0]).sum(axis=1), forward * P[:, 0]) for P in points.responses]

    def _bound(self, loop: InnerLoop, outer: StateSpace) -> float:
        """Return an upper bound of the result of :meth:`_gain`, computed at a few frequencies only."""
        loops = self._loops(loop, outer, self.few)
        if max(float(np.max(1.0 / np.abs(left))) for left, _ in loops) > self.peak:
            return 0.0
        return min(_largest(way / left, self.aimed, np.inf) for left, way in loops)

    def _gain(self, loop: InnerLoop, outer: StateSpace) -> float:
        """Return the largest gain of an outer controller on all plants, reduced if the combined loop would exceed M_s.

        The result is 0 if the M_s of the inner loop alone is too large, because no outer controller can reduce it.
        """
        loops = self._loops(loop, outer, self.all)
        if max(float(np.max(1.0 / np.abs(left))) for left, _ in loops) > self.peak:
            return 0.0
        gain = min(_largest(way / left, self.aimed) for left, way in loops)
        whole = max(float(np.max(1.0 / np.minimum(np.abs(left + gain * way), np.abs(left)))) for left, way in loops)
        return gain * min(1.0, (self.aimed / whole) ** 2)

    def _holds(self, loop: InnerLoop, outer: StateSpace, late: float) -> bool:
        """Return whether inner loop, outer loop and the loop cut at the plant meet their requirements on all plants."""
        whole = loop.behind(outer)
        for one in self.plants:
            around = loop.around(one.plant)
            poles = around.poles.astype(complex)
            if np.max(np.abs(poles)) >= 1.0 - BOUNDARY:
                return False
            if loop.source != COMMAND and not self._damps(poles):
                return False
            outside = judge(outer, around, self.sample_time, with_bandwidth=False)
            if not outside.sensitivity_peak <= self.peak:
                return False
            both = judge(whole, one.plant, self.sample_time, with_bandwidth=False)
            if not (both.sensitivity_peak <= self.peak and both.delay_margin >= late):
                return False
        return True

    def _damps(self, poles) -> bool:
        """Return whether every mode of an inner loop is well damped, or far better than the model's resonance."""
        left = modes(poles, self.sample_time)
        return not left or left[0][1] >= min(WELL, MUCH * self.mode.damping)

    def best(self, late: float) -> DampingParameters | None:
        """Return the best damping that tolerates the additional delay ``late`` [samples]; None if no damping does."""
        found, point, box = 0.0, None, None
        for one in self.kind.ranges(self.mode):
            speed, at = self._best_of(one, late, found)
            if at is not None:
                found, point, box = speed, at, one
        if point is None:
            return None
        for _ in range(REFINED):
            box = _around(box, point)
            speed, at = self._best_of(box, late, found)
            if at is not None:
                found, point = speed, at
        return self.damping(point)

    def _best_of(self, box, late: float, least: float):
        best, at = least, None
        for point in combinations(*(_spread(side, POINTS[len(box)]) for side in box)):
            speed = self.speed(point, late, best)
            if speed > best:
                best, at = speed, point
        return best, at


def _largest(X, peak: float, unlimited: float = 0.0) -> float:
    """Return the largest g up to which |1 + g X| ≥ 1/peak at all points; ``unlimited`` if this holds for every g."""
    square, room = np.abs(X) ** 2, 1.0 - 1.0 / peak**2
    inside = X.real**2 - room * square
    hit = (X.real < 0.0) & (inside > 0.0)
    if not np.any(hit):
        return unlimited
    return float(np.min((-X.real[hit] - np.sqrt(inside[hit])) / square[hit]))


def _angles(plants) -> np.ndarray:
    parts = [np.geomspace(1e-4, np.pi, GRID), np.linspace(0.0, np.pi, GRID)[1:]]
    for one in plants:
        for pole in one.plant.poles:
            width = max(1.0 - abs(pole), 1e-6)
            parts.append(abs(np.angle(pole)) + width * np.sinh(np.linspace(-5.0, 5.0, AROUND)))
    angles = np.unique(np.concatenate(parts))
    return angles[(angles >= 1e-4) & (angles <= np.pi)]


def _spread(side, count: int) -> np.ndarray:
    low, high, logarithmic = side
    if not logarithmic:
        return np.linspace(low, high, count)
    return np.sign(low) * np.geomspace(abs(low), abs(high), count)


def _around(box, point):
    """Return the box between the neighbours of a point on the grid, within the present box."""
    found = []
    for side, value in zip(box, point, strict=True):
        grid = _spread(side, POINTS[len(box)])
        place = int(np.argmin(np.abs(grid - value)))
        found.append((float(grid[max(place - 1, 0)]), float(grid[min(place + 1, len(grid) - 1)]), side[2]))
    return tuple(found)


#: A damping is of little use if it raises the bandwidth by less than this factor.
LITTLE = 1.2
#: A law that only outputs the reference, so that the inner loop alone remains.
_PASSED = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[1.0, 0.0]]))


@dataclass(frozen=True, eq=False)
class PlantsAround:
    """Plants on which a damping is evaluated."""

    plants: tuple[PossiblePlant, ...]  #: Plants without damping, the model first.
    resonance: float  #: Relative deviation of the resonances in the other plants.

    def closed(self, control: ControllerParameters, sample_time: float) -> tuple[PossiblePlant, ...]:
        """Return the plants with the damping loop of a controller closed.

        Units: ``sample_time`` [s].
        """
        around = closing(control.damping, control.model.dynamics, sample_time, control.model.force)
        return tuple(one.closed(around) for one in self.plants)


@dataclass(frozen=True, eq=False)
class DampedDesign:
    """A damping and the controller around it, evaluated on the model and on plants with deviating resonances."""

    damping: DampingParameters
    before: tuple[float, float]  #: Frequency [Hz] and damping of the model's least damped resonance.
    reached: tuple[float, ...]  #: Damping of the least damped mode of the inner loop on each plant, the model first.
    #: inner, outer, whole: Margins on each plant, for the inner loop alone, for the law's loop on the damped plant, and
    #: for both loops, cut at the plant.
    inner: tuple[Margins, ...]
    outer: tuple[Margins, ...]
    whole: tuple[Margins, ...]
    resonance: float  #: Relative deviation of the resonances in the other plants.
    undamped: float | None  #: Bandwidth of the same design without damping [Hz]; None if no such design was found.

    def misses(self) -> tuple[str, ...]:
        """Return the first unmet requirement of the law's loop or of both loops, on any plant."""
        for found, words in ((self.outer, "of the law's loop"), (self.whole, "of both loops")):
            for number, margins in enumerate(found):
                said = margins.misses()
                if said:
                    where = "" if not number else f" with resonances off by {100.0 * self.resonance:g} %"
                    return (f"{said[0].replace('unstable on its own model', 'unstable')} {words}{where}",)
        return ()

    @property
    def times(self) -> float:
        """Ratio of the bandwidth to that of the same design without damping; infinite without such a design."""
        return self.outer[0].bandwidth / self.undamped if self.undamped else np.inf

    def doubts(self) -> tuple[str, ...]:
        """Return a warning if the damping is of little use."""
        if self.times >= LITTLE:
            return ()
        return (
            f"{self.damping.type} is of little use here: the bandwidth is {self.times:.3g} times the bandwidth without "
            "damping; choose another kind or none, or state the delay (model.dynamics.delay) if it is "
            "missing, because the sign of the gain depends on the delay",
        )

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, text) of the printed rows."""
        kind = self.damping.type
        values = getattr(self.damping, kind).to_mapping()
        given = ", ".join(f"{name} {_numbers(value)}" for name, value in values.items())
        off = f"resonances ±{100.0 * self.resonance:g} %"
        frequency, damping = self.before
        slowest = min(margins.bandwidth for margins in self.outer)
        worst = max(margins.sensitivity_peak for margins in self.outer)
        both = max(margins.sensitivity_peak for margins in self.whole)
        late = min(margins.delay_margin_samples for margins in self.whole)
        found = [
            ("damping", f"{kind}: {given}"),
            ("resonance", f"{frequency:.4g} Hz, damping {damping:.2g}"),
            ("damping reached", f"{self.reached[0]:.2g}; {off}: {min(self.reached):.2g}"),
            ("inner loop", _margins(self.inner[0])),
            ("both loops, at the plant", _margins(self.whole[0])),
            (off, f"bandwidth {slowest:.4g} Hz, M_s {worst:.3f}, of both {both:.3f}, delay margin {late:.3g} samples"),
        ]
        if self.undamped is not None:
            words = f"{self.undamped:.4g} Hz; with damping {self.times:.3g} times this bandwidth"
            found.append(("bandwidth without damping", words))
        return found


def around_model(control: ControllerParameters, sample_time: float, request) -> PlantsAround:
    """Return the model, and plants with lower and with higher resonance frequencies.

    Units: ``sample_time`` [s].
    """
    resonance = RESONANCE if request.robust is None else request.robust.resonance
    kind = control.damping.type if request.damping is None else request.damping
    acting = kind in KINDS and KINDS[kind].source == FORCE
    return PlantsAround(damping_plants(control.model.dynamics, sample_time, resonance, acting=acting), resonance)


def _require(name: str) -> None:
    """Refuse an unknown kind of damping."""
    if name not in (NONE, *KINDS):
        there = ", ".join((NONE, *KINDS))
        raise ConfigurationError(f"--damping {name}: unknown damping; there are {there}{did_you_mean(name, KINDS)}")


def with_damping(
    control: ControllerParameters, sample_time: float, around: PlantsAround, request
) -> ControllerParameters:
    """Return the parameters with the requested damping; unchanged without a request.

    Units: ``sample_time`` [s].
    """
    if request.damping is None:
        return control
    _require(request.damping)
    if request.damping == NONE:
        return replace(control, damping=DampingParameters())
    own = control.model.dynamics, sample_time, around.plants, control.model.force
    found = design_damping(request.damping, *own, request.damping_peak)
    return replace(control, damping=found)


def judge_damping(
    parameters: ControllerParameters, sample_time: float, plants: PlantsAround, undamped: float | None
) -> DampedDesign:
    """Return the performance of a controller with damping.

    Units: ``sample_time`` [s], ``undamped`` [Hz].
    """
    dynamics = parameters.model.dynamics
    loop = inner_loop(parameters.damping, dynamics, sample_time, parameters.model.force)
    controller, _ = linear_loop(parameters, sample_time)
    bare = [one.plant for one in plants.plants]
    around = [loop.around(plant) for plant in bare]
    least = [modes(plant.poles.astype(complex), sample_time) for plant in around]
    inner, both = loop.behind(_PASSED), loop.behind(controller)
    before = modes(dynamics.matrices.poles.astype(complex), sample_time)
    return DampedDesign(
        parameters.damping,
        before[0] if before else (0.0, 1.0),
        tuple(found[0][1] if found else 1.0 for found in least),
        tuple(margins_of(inner, plant, sample_time) for plant in bare),
        tuple(margins_of(controller, plant, sample_time) for plant in around),
        tuple(margins_of(both, plant, sample_time) for plant in bare),
        plants.resonance,
        undamped,
    )


def _numbers(value) -> str:
    return ", ".join(f"{item:.4g}" for item in (value if isinstance(value, tuple) else (value,)))


def _margins(found: Margins) -> str:
    gain = "infinite" if np.isinf(found.gain_margin) else f"{found.gain_margin:.1f} dB"
    delay = "infinite"
    if not np.isinf(found.delay_margin):
        delay = f"{found.delay_margin_samples:.3g} samples, {1e3 * found.delay_margin:.4g} ms"
    return f"M_s {found.sensitivity_peak:.3f}, gain margin {gain}, delay margin {delay}"
