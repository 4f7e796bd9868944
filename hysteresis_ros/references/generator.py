# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Reference generator: sum of a waveform and an approach to the setpoint (or a trajectory), limited to a range.

With ``approach.steps``, the jumps of a waveform pass through a second approach with the same limits. If setpoint and
waveform move at the same time, their sum moves up to twice as fast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Chain, compiled, composite, interpreted, nested
from hysteresis_ros.references import trajectory as following
from hysteresis_ros.references.approach import (
    HIGH,
    LOW,
    SETPOINT,
    Approach,
    ApproachParameters,
    Shaper,
    ShapingParameters,
    approach,
    effective_limits,
    rest,
    rest_shaper,
    shaped,
)
from hysteresis_ros.references.trajectory import (
    Bounds,
    Points,
    TrajectoryParameters,
    advance,
    begin_trajectory,
    brake,
    note_motion,
)
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters
from hysteresis_ros.units import micrometres, readable

#: Parameters and state of the range. At a start with an unlimited approach, FADE is the difference between the held
#: reference and the setpoint; it fades out over FADE_SAMPLES. SMOOTHED is 1 if a waveform with jumps passes through an
#: approach.
MINIMUM, MAXIMUM, FADE_SAMPLES, SMOOTHED = range(4)
RUNNING, OUTPUT, FADE, FADE_COUNT = range(4)

#: Values of RUNNING. HELD: the reference is held; WHOLE: waveform and moves run; MOVES: only moves run, and the
#: waveform waits for its start.
HELD, WHOLE, MOVES = 0.0, 1.0, 2.0
#: Largest number of samples in which the steps of a waveform are compared with the duration of an approach.
MOST_SAMPLES = 200_000


@dataclass(frozen=True)
class ReferenceParameters(Parameters):
    """Parameters of the reference generator."""

    minimum: float = parameter(0.0, description="lowest reference", unit="m", read_only=True)
    maximum: float = parameter(15.0e-6, description="highest reference", unit="m", read_only=True)
    initial_setpoint: float = parameter(
        0.0, description="setpoint until the first one is received", unit="m", read_only=True
    )
    waveform: WaveformParameters = group(WaveformParameters)
    approach: ApproachParameters = group(ApproachParameters)
    shaping: ShapingParameters = group(ShapingParameters)
    trajectory: TrajectoryParameters = group(TrajectoryParameters)

    def check(self):
        """Yield a Problem if the range is empty or does not contain the initial setpoint."""
        if not self.minimum < self.maximum:
            yield Problem("maximum", self.maximum, f"must be > minimum = {self.minimum:g} m")
        elif not self.minimum <= self.initial_setpoint <= self.maximum:
            remedy = f"out of range, allowed: {self.minimum:g} … {self.maximum:g} m"
            yield Problem("initial_setpoint", self.initial_setpoint, remedy)


class GeneratorArrays(NamedTuple):
    """Parameter arrays, or state arrays, of a reference generator."""

    approach: np.ndarray
    waveform: np.ndarray
    range: np.ndarray
    trajectory: np.ndarray
    shaping: np.ndarray
    steps: np.ndarray


@nested
def base(ps, xs, setpoint):
    """Return the position [m] of the approach or of the trajectory at this sample, without the waveform.

    After a trajectory, the axis keeps its position until a different setpoint is received.
    """
    p, x = ps.trajectory, xs.trajectory
    is_new = setpoint != x[following.GIVEN] and setpoint != x[following.TARGET]
    is_new = is_new and ps.approach[LOW] <= setpoint <= ps.approach[HIGH]
    x[following.GIVEN] = setpoint
    smooth = p[following.SMOOTH]
    if x[following.ACTIVE] != following.IDLE:
        if is_new and x[following.PENDING] == 0.0:
            if x[following.ACTIVE] == following.FOLLOWING:
                brake(p, x, setpoint, following.REPLACED)
            x[following.AFTER] = setpoint
        position = advance(p, x)
        smooth = 1.0
        if x[following.ACTIVE] == following.IDLE:
            after = x[following.AFTER]
            if after < following.NOWHERE:
                x[following.TARGET] = following.NOWHERE
            rest(ps.approach, xs.approach, position, after if after < following.NOWHERE else position)
            rest_shaper(xs.shaping, position)
    else:
        if is_new:
            x[following.TARGET] = following.NOWHERE
        held = x[following.TARGET] < following.NOWHERE
        position = approach(ps.approach, xs.approach, math.nan if held else setpoint)
        position = shaped(ps.shaping, xs.shaping, position)
    note_motion(p, x, position, smooth)
    return position


@nested
def setpoint_in_force(xs, setpoint):
    """Return the setpoint in force [m]; the end of a trajectory replaces the previous setpoint."""
    x = xs.trajectory
    target, after = x[following.TARGET], x[following.AFTER]
    if x[following.ACTIVE] != following.IDLE and after < following.NOWHERE:
        return after
    return target if target < following.NOWHERE else setpoint


@nested
def abandon(ps, xs):
    """Abort the trajectory and stay at the present position."""
    x = xs.trajectory
    if x[following.ACTIVE] != following.IDLE:
        if x[following.ACTIVE] == following.FOLLOWING:
            x[following.OUTCOME] = following.STOPPED
        x[following.ACTIVE] = following.IDLE
        x[following.TARGET] = x[following.POSITION]
        rest(ps.approach, xs.approach, x[following.POSITION], x[following.POSITION])
        rest_shaper(xs.shaping, x[following.POSITION])


@nested
def reference_step(waveform, ps, xs, setpoint):
    """Return the reference [m] of this sample: approach or trajectory, plus waveform, clipped to minimum … maximum.

    If the last reference lies outside this range, it replaces the nearer limit, so the reference moves into the range
    without a jump.

    ``ps``, ``xs`` are :class:`GeneratorArrays`. While the generator is stopped, reference and states do not change.
    """
    p, x = ps.range, xs.range
    if x[RUNNING] == HELD:
        return x[OUTPUT]
    reference = base(ps, xs, setpoint)
    if x[RUNNING] == WHOLE:
        added = waveform(ps.waveform, xs.waveform, 0.0)
        if p[SMOOTHED] != 0.0:
            added = approach(ps.steps, xs.steps, added)
        reference += added
    if x[FADE_COUNT] < p[FADE_SAMPLES]:
        # minimum-jerk blend 1 → 0
        s = x[FADE_COUNT] / p[FADE_SAMPLES]
        reference += x[FADE] * (1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0)))
        x[FADE_COUNT] += 1.0
    reference = min(max(reference, min(p[MINIMUM], x[OUTPUT])), max(p[MAXIMUM], x[OUTPUT]))
    x[OUTPUT] = reference
    return reference


@nested
def begin_waveform(waveform, ps, xs):
    """Run the waveform from its beginning, without a jump of the reference (:meth:`ReferenceGenerator.start`)."""
    x, counter = xs.range, xs.waveform
    for i in range(counter.shape[0]):
        counter[i] = 0.0
    first = waveform(ps.waveform, counter, 0.0)
    for i in range(counter.shape[0]):
        counter[i] = 0.0
    rest(ps.steps, xs.steps, first, xs.steps[SETPOINT])
    position, x[FADE], x[FADE_COUNT] = x[OUTPUT] - first, 0.0, 0.0
    setpoint = xs.approach[SETPOINT]
    if ps.trajectory[following.SMOOTH] == 0.0:  # unlimited: the difference from the setpoint fades out
        x[FADE] = position - setpoint
        rest(ps.approach, xs.approach, setpoint, setpoint)
    else:
        rest(ps.approach, xs.approach, position, setpoint)
    x[RUNNING] = WHOLE
    xs.trajectory[following.POSITION] = position - x[FADE]
    rest_shaper(xs.shaping, xs.trajectory[following.POSITION])


@composite("void", "kernel", GeneratorArrays, GeneratorArrays, "array", "array")
def run_reference(waveform, ps, xs, setpoints, references):
    """Set ``references[k]`` for the setpoint of every sample k."""
    for k in range(setpoints.shape[0]):
        references[k] = reference_step(waveform, ps, xs, setpoints[k])


class ReferenceGenerator(Chain):
    """Generator of the reference from setpoints and a waveform; it runs from construction on.

    Parameters
    ----------
    parameters : ReferenceParameters
        Range, waveform and approach.
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    ps, xs : GeneratorArrays
        Parameters and states of approach, waveform, range and trajectory, for :func:`reference_step`.
    waveform : Waveform
        The waveform, with ``crest_factor``, ``period``, ``lowest`` and ``highest``.

    Raises
    ------
    ParameterError
        A parameter is wrong, or the waveform around the initial setpoint leaves minimum … maximum.
    """

    def __init__(self, parameters: ReferenceParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.waveform = self._build_waveform(parameters, parameters.initial_setpoint)
        low, high = parameters.minimum, parameters.maximum
        self.approach = Approach(parameters.approach, sample_time, low, high, parameters.initial_setpoint)
        smoothing = parameters.approach if parameters.approach.steps else ApproachParameters()
        self._steps = Approach(smoothing, sample_time, low, high)
        self._steps.p[[LOW, HIGH]] = -math.inf, math.inf
        self.shaper = Shaper(parameters.shaping, sample_time)
        fade = 0
        if parameters.approach.unlimited:
            fade = round(parameters.approach.start_time / self.sample_time)
        self._range = np.array([low, high, float(fade), 0.0]), np.zeros(4)
        deceleration = effective_limits(parameters.approach, high - low)[1]
        smooth = float(not parameters.approach.unlimited)
        path = [self.sample_time, smooth, deceleration if math.isfinite(deceleration) else 0.0, low, high]
        self._trajectory = np.array(path), following.initial_state(parameters.initial_setpoint)
        self._adopt()
        self._begun = math.nan
        self.reset()

    def _build_waveform(self, parameters: ReferenceParameters, setpoint: float) -> Waveform:
        waveform = Waveform(parameters.waveform, self.sample_time)
        low, high = parameters.minimum, parameters.maximum
        tolerance = 1e-12 * (high - low)
        for value in (waveform.lowest + setpoint, waveform.highest + setpoint):
            if not low - tolerance <= value <= high + tolerance:
                kind, name = parameters.waveform.type, parameters.waveform.shape.extent
                given = parameters.waveform.to_mapping()[name]
                around, reached, least, most = (readable(one, "m") for one in (setpoint, value, low, high))
                text = (
                    f"the waveform {kind} around the setpoint {around} reaches {reached}, allowed: "
                    f"{least} … {most} (minimum … maximum); change amplitude, offset or values, or widen the range"
                )
                raise ParameterError([Problem(f"waveform.{name}", given, text)])
        return waveform

    def _adopt(self) -> None:
        """Connect the present waveform."""
        low, high = self.parameters.minimum, self.parameters.maximum
        # the sum of setpoint and waveform must stay within the range
        self.approach.p[LOW] = low - self.waveform.lowest
        self.approach.p[HIGH] = high - self.waveform.highest
        self._trajectory[0][following.LOWEST :] = self.approach.p[LOW], self.approach.p[HIGH]
        own = self.parameters
        self._range[0][SMOOTHED] = float(own.approach.steps and own.waveform.shape.jumps)
        rest = self._range, self._trajectory, (self.shaper.p, self.shaper.x), (self._steps.p, self._steps.x)
        self.ps = GeneratorArrays(self.approach.p, self.waveform.p, *(p for p, _ in rest))
        self.xs = GeneratorArrays(self.approach.x, self.waveform.x, *(x for _, x in rest))

    @property
    def waveform_kernel(self):
        """Kernel of the present waveform, for :func:`reference_step`."""
        return self.waveform.kernel

    @property
    def running(self) -> bool:
        """Whether the generator runs; False while :meth:`stop` holds the reference."""
        return bool(self._range[1][RUNNING])

    @property
    def moving(self) -> bool:
        """Whether a motion to a setpoint, or a trajectory, is in progress."""
        x = self.xs.trajectory
        if x[following.ACTIVE] != following.IDLE or not self.shaper.resting:
            return True
        return bool(x[following.POSITION] != self.setpoint and x[following.TARGET] >= following.NOWHERE)

    @property
    def setpoint(self) -> float:
        """The last accepted setpoint [m]."""
        return float(self.approach.x[SETPOINT])

    def step(self, setpoint: float) -> float:
        """Return the reference [m] of this sample; a setpoint that is refused changes nothing."""
        return interpreted(reference_step)(self.waveform_kernel, self.ps, self.xs, float(setpoint))

    def simulate(self, setpoints) -> np.ndarray:
        """Return the reference [m] of each sample for the setpoint [m] of each sample, both of shape (N,)."""
        setpoints = np.ascontiguousarray(setpoints, dtype=np.float64)
        references = np.empty_like(setpoints)
        compiled(run_reference)(self.waveform_kernel, self.ps, self.xs, setpoints, references)
        return references

    def refuse(self, setpoint: float) -> str | None:
        """Return why a setpoint [m] is refused, with its value and the range; None if it is accepted."""
        low, high = self.approach.p[LOW], self.approach.p[HIGH]
        if low <= setpoint <= high:
            return None
        waveform = self.waveform
        around = ""
        if waveform.lowest != 0.0 or waveform.highest != 0.0:
            around = f" with the waveform {micrometres(waveform.lowest, waveform.highest)} added"
        reason = "out of range" if math.isfinite(setpoint) else "not a finite number"
        return f"setpoint {micrometres(setpoint)} refused: {reason}, allowed: {micrometres(low, high)}{around}"

    @property
    def waits(self) -> bool:
        """Whether the waveform still waits for its start; setpoints and trajectories move the reference meanwhile."""
        return bool(self._range[1][RUNNING] == MOVES)

    @property
    def unasked(self) -> bool:
        """Whether no setpoint or trajectory was received since :meth:`begin_at`."""
        return bool(self.xs.trajectory[following.TARGET] == self._begun)

    @property
    def largest_velocity(self) -> float:
        """Largest velocity of the waveform without an approach [m/s]; a step takes the time until the next step."""
        distances, available = self._changes()
        return float(np.max(distances / available, initial=0.0))

    def _changes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the changes of the waveform without an approach [m], and the time from each change to the next [s].

        A continuous waveform changes with every sample.
        """
        own, shape = self.parameters, self.parameters.waveform.shape
        waveform = Waveform(own.waveform, self.sample_time)
        samples = waveform.period or waveform.duration_samples
        if not samples and shape.takes_frequency:
            samples = round(1.0 / (own.waveform.frequency * self.sample_time))
        # two periods, because the first step of a period begins at the last level of the previous period
        levels = waveform.simulate(np.zeros(min(2 * samples, MOST_SAMPLES)))
        starts = np.flatnonzero(np.diff(levels)) + 1
        return np.abs(levels[starts] - levels[starts - 1])[:-1], np.diff(starts) * self.sample_time

    def unreached_level(self) -> Problem | None:
        """Return a Problem if the limits of the approach do not let a step of the waveform reach its level in time."""
        own, shape = self.parameters, self.parameters.waveform.shape
        if not shape.jumps or not own.approach.steps or own.approach.unlimited:
            return None
        distances, available = self._changes()
        if not distances.size:
            return None
        needed = np.array([self.approach.duration(distance) for distance in distances.tolist()])
        worst = int(np.argmax(needed - available))
        if needed[worst] <= available[worst]:
            return None
        name = "frequency" if shape.takes_frequency else shape.extent
        remedy = (
            f"a step of {micrometres(distances[worst])} takes {needed[worst]:.3g} s within the limits of the approach "
            f"(approach.steps: true), and the next step comes after {available[worst]:.3g} s: the axis does not reach "
            "the level; make steps slower or smaller, or raise approach.maximum_velocity, maximum_acceleration and "
            "maximum_jerk"
        )
        return Problem(f"waveform.{name}", own.waveform.to_mapping()[name], remedy)

    def begin_at(self, position: float) -> None:
        """Begin at rest at the axis' position [m], also outside the range; the waveform waits for :meth:`start`."""
        self.reset()
        rest(self.approach.p, self.approach.x, position, position)
        self.shaper.rest_at(position)
        for place in (following.POSITION, following.GIVEN, following.TARGET):
            self.xs.trajectory[place] = position
        self._range[1][:] = (MOVES, position, 0.0, 0.0)
        self._begun = position

    def wait_for_start(self) -> None:
        """Begin at rest at the initial setpoint, and let the waveform wait for :meth:`start`.

        With ``approach.from_rest``, the reference instead begins at 0 m, as after :meth:`reset`, and moves to the
        initial setpoint while the waveform waits.
        """
        setpoint = self.parameters.initial_setpoint
        self.begin_at(setpoint)
        if not self.parameters.approach.from_rest:
            return
        position = self._range[1][OUTPUT] = 0.0
        if self.parameters.approach.unlimited:
            self._range[1][FADE] = position - setpoint
            return
        rest(self.approach.p, self.approach.x, position, setpoint)
        self.shaper.rest_at(position)
        self.xs.trajectory[following.POSITION] = position
        # the reference moves to the setpoint; it does not wait for a first request
        self.xs.trajectory[following.TARGET] = following.NOWHERE

    def stop(self) -> None:
        """Hold the reference at its last value; setpoints have no effect until :meth:`start`."""
        self._range[1][RUNNING] = HELD
        interpreted(abandon)(self.ps, self.xs)

    def follow(self, times, positions, velocities=(), accelerations=()) -> None:
        """Follow a trajectory from the next sample on, in place of the present motion.

        The end of the trajectory becomes the setpoint. Positions alone are connected by lines, positions and velocities
        by cubics, positions, velocities and accelerations by quintics.

        Parameters
        ----------
        times : sequence of float, shape (N,)
            Time of each point since the beginning [s]; a first point at 0 must be at the axis' position.
        positions : sequence of float, shape (N,)
            Positions [m]; the waveform is added to them.
        velocities, accelerations : sequence of float, shape (N,), optional
            [m/s], [m/s²]

        Raises
        ------
        ParameterError
            The generator is stopped, the points are not a trajectory, or the path exceeds the range or the limits of
            the approach (velocity, acceleration). Nothing is changed then.
        """
        if not self.running:
            text = "refused, because the generator is stopped; call start"
            raise ParameterError([Problem("trajectory", len(times), text, "points")])
        points = Points(times, positions, velocities, accelerations)
        own = self.parameters
        x = self.xs.trajectory
        if points.times[0] == 0.0 and not abs(points.positions[0] - x[following.POSITION]) <= self.start_tolerance:
            text = (
                f"the axis is at {x[following.POSITION]:g} m; a first point at 0 s must be within "
                f"{self.start_tolerance:g} m of it (trajectory.start_tolerance); give the first point a later time"
            )
            raise ParameterError([Problem("trajectory positions", float(points.positions[0]), text, "m")])
        segments = points.segments(*x[following.POSITION : following.ACCELERATION + 1].tolist())
        low, high = self.approach.p[LOW], self.approach.p[HIGH]
        limits = own.approach.maximum_velocity, own.approach.maximum_acceleration
        bounds = Bounds(float(low), float(high), *limits, self.sample_time)
        bounds.check(segments, points.times[-1], x[following.VELOCITY])
        begin_trajectory(x, segments, points, self.sample_time)

    @property
    def start_tolerance(self) -> float:
        """Largest allowed distance between a first point at time 0 and the axis' position [m]."""
        own = self.parameters
        return own.trajectory.start_tolerance or 0.01 * (own.maximum - own.minimum)

    def hold(self) -> None:
        """Bring the present motion to rest, from the next sample on, and stay at rest; the waveform continues."""
        interpreted(brake)(self.ps.trajectory, self.xs.trajectory, following.NOWHERE, following.HELD)

    @property
    def trajectory(self) -> tuple[int, int]:
        """Number of the last trajectory, counted from 1, and its outcome (a code of ``trajectory``)."""
        x = self.xs.trajectory
        return int(x[following.NUMBER]), int(x[following.OUTCOME])

    def start(self) -> None:
        """Run the waveform from its beginning, without a jump of the reference.

        The approach begins at rest at the held reference minus the waveform's first sample, so that their sum does not
        jump, and moves to the setpoint within its limits. Steps of a waveform that pass through an approach begin in
        the same way. An unlimited approach jumps to the setpoint instead, and the difference fades out over
        ``approach.start_time``. If no setpoint was received since :meth:`begin_at`, the initial setpoint is used.
        """
        if self.unasked:
            self.approach.x[SETPOINT] = self.parameters.initial_setpoint
        self._begun = math.nan
        interpreted(begin_waveform)(self.waveform_kernel, self.ps, self.xs)

    def _first_value(self) -> float:
        return self.waveform.kernel(self.waveform.p, np.zeros(1), 0.0)

    def reset(self) -> None:
        """Return to the state after construction: waveform at its beginning, axis at rest at the initial setpoint.

        With ``approach.from_rest``, the motion to the initial setpoint begins at 0 m, also outside the range.
        """
        self._begun = math.nan
        self.approach.reset()
        self.shaper.rest_at(self.parameters.initial_setpoint)
        self.waveform.reset()
        number = self.xs.trajectory[following.NUMBER]
        self.xs.trajectory[:] = following.initial_state(self.parameters.initial_setpoint)
        self.xs.trajectory[following.NUMBER], self.xs.trajectory[following.OUTCOME] = number, following.STOPPED
        # steps of a waveform that pass through an approach begin where the axis rests
        self._steps.rest_at(0.0)
        waveform = 0.0 if self._range[0][SMOOTHED] else self._first_value()
        first = self.parameters.initial_setpoint + waveform
        low, high = self.parameters.minimum, self.parameters.maximum
        self._range[1][:] = (WHOLE, min(max(first, low), high), 0.0, 0.0)
        if self.parameters.approach.from_rest:
            self._range[1][OUTPUT] = 0.0
            interpreted(begin_waveform)(self.waveform_kernel, self.ps, self.xs)

    def retune(self, parameters: ReferenceParameters) -> None:
        """Change the waveform while the generator is stopped, or the input shaping while no move is in progress.

        Raises
        ------
        ParameterError
            The generator runs (for a change of the shaping: a move is in progress), the new parameters are wrong, or
            another parameter differs. Nothing is changed then.
        """
        parameters.validated()
        old, new = self.parameters.to_mapping(), parameters.to_mapping()
        changed = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
        problems = []
        for name in changed:
            if name.startswith("shaping."):
                if self.moving:
                    problems.append(Problem(name, new.get(name), "can change only while no move is in progress; wait"))
            elif not name.startswith("waveform."):
                problems.append(
                    Problem(name, new.get(name), "fixed while the node is configured; clean up and configure again")
                )
            elif self.running:
                problems.append(Problem(name, new.get(name), "can change only while stopped; call stop"))
        if problems:
            raise ParameterError(problems)
        if parameters.shaping != self.parameters.shaping:
            self.shaper.retune(parameters.shaping)
            self.shaper.rest_at(self.xs.trajectory[following.POSITION])
        if any(name.startswith("waveform.") for name in changed):
            waveform = self._build_waveform(parameters, self.setpoint)
            self.parameters, self.waveform = parameters, waveform
            self._adopt()
        self.parameters = parameters
